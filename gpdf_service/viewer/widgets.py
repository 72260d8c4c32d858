"""Small tools for the page's widgets."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import viser

T = TypeVar("T")


def put(widget: Any, value: Any) -> None:  # noqa: ANN401 - viser's setters have a type that mypy cannot read
    """Set what a widget shows."""
    widget.value = value


def by_hand(act: Callable[[], None]) -> Callable[[viser.GuiEvent[Any]], None]:
    """Act only when a person changed a widget, not the page itself."""

    def on_update(event: viser.GuiEvent[Any]) -> None:
        if event.client is not None:
            act()

    return on_update


def with_file(file: viser.UploadedFile, read: Callable[[Path], T]) -> T:
    """Let something that reads files read what the browser sent."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / Path(file.name).name
        path.write_bytes(file.content)
        return read(path)

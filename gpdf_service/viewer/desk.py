"""What every part of the page has at hand, and small tools for what its widgets do."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import viser

from gpdf_service.viewer.frame import Frame
from gpdf_service.viewer.link import Link
from gpdf_service.viewer.panel import Panel
from gpdf_service.viewer.worker import Worker

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Desk:
    """Slow work runs on two workers, so that plans do not wait for maps.

    Attributes:
        server: Where the page is served.
        panel: The widgets.
        link: The service.
        maps: Does what concerns scenes and layers.
        plans: Does what concerns plans and logs.
        frame: Where the page's zero is.
    """

    server: viser.ViserServer
    panel: Panel
    link: Link
    maps: Worker
    plans: Worker
    frame: Frame = field(default_factory=Frame)


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

"""The state folder belongs to one service: a marker says that it is ours, and a lock who uses it now."""

from __future__ import annotations

import fcntl
import re
from pathlib import Path
from typing import BinaryIO

from gpdf_service.errors import ConfigError

MARKER = "GPDF_STATE"
"""A folder without this file is not ours: nothing in it is read, written or deleted."""
WORDS = (
    b"Ready scenes, their places and what waits to be built, of one gpdf service. Delete the whole folder or nothing.\n"
)
OURS = re.compile(r"\.?[A-Za-z0-9][A-Za-z0-9_.-]*(@\d+\.gpdf(\..*)?|\.places\.json)|\.?last_version|\.fetch-.*|journal")
"""What a folder of a service without a marker, from before there were markers, may hold."""
LEFT = re.compile(r"\.[A-Za-z0-9][A-Za-z0-9_.-]*(@\d+\.gpdf(\..*)?|\.places\.json)|\.last_version|\.fetch-.*")
"""What a crash in mid-write leaves."""


class StateFolder:
    """A folder that is ours alone until `close`, or until this process ends, however it does.

    Args:
        path: Made if it is not there; marked as ours if it is empty.

    Raises:
        ConfigError: it holds what is not ours, or another service uses it.
        OSError: it cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        path.mkdir(parents=True, exist_ok=True)
        marker = path / MARKER
        if not marker.is_file():
            _refuse_strangers(path)
            marker.write_bytes(WORDS)
        self._lock: BinaryIO = marker.open("rb")
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            self._lock.close()
            raise ConfigError("state_dir", f"{path} is used by another service", "Give each its own.") from error
        for left in path.iterdir():
            if LEFT.fullmatch(left.name) and left.is_file():
                left.unlink()

    def close(self) -> None:
        """Let others use it."""
        self._lock.close()


def _refuse_strangers(path: Path) -> None:
    strangers = sorted(item.name for item in path.iterdir() if not OURS.fullmatch(item.name))
    if strangers:
        found = f"{path} has no {MARKER} and holds what is not ours ({', '.join(strangers[:3])})"
        raise ConfigError("state_dir", found, "Name a new or an empty folder.")

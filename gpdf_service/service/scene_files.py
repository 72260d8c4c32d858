"""The folder of ready scenes: acknowledged ones are there after a crash; those that left memory are loaded again."""

from __future__ import annotations

import logging
import os
import re
import shutil
import time
from pathlib import Path

log = logging.getLogger(__name__)

SUFFIX = ".gpdf"
STORED = re.compile(r"(?P<name>[^@]+)@(?P<version>\d+)" + re.escape(SUFFIX))
COUNTER = "last_version"
BUILT = ".built"


class SceneFiles:
    """One file a scene, NAME@VERSION.gpdf, and the last version that was given out. Not for several threads at once."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def known(self) -> dict[str, Path]:
        """The newest file of each name; older ones, left by a crash, go."""
        found: dict[str, Path] = {}
        for path in sorted((path for path in self.folder.iterdir() if STORED.fullmatch(path.name)), key=version_of):
            name = path.name.partition("@")[0]
            if name in found:
                found[name].unlink()
            found[name] = path
        return found

    def next_version(self, at_least: int = 1) -> int:
        """A version that no scene of this folder ever had; when this returns, that is on the disk."""
        version = max(at_least, 1 + max([self._last(), *map(version_of, self.known().values())]))
        write_whole(self.folder / COUNTER, str(version).encode())
        return version

    def _last(self) -> int:
        counter = self.folder / COUNTER
        if not counter.is_file():
            return 0
        try:
            return int(counter.read_text())
        except ValueError:  # seconds count faster than builds: whatever was given out is less
            log.error("%s cannot be read; versions go on from the time of day", counter)
            return int(time.time())

    def path_of(self, name: str, version: int) -> Path:
        """Where a scene's file is, or would be."""
        return self.folder / f"{name}@{version}{SUFFIX}"

    def built(self, name: str, version: int) -> Path:
        """Where it is until `publish`; what a crash leaves there was never ready."""
        return self.folder / f".{name}@{version}{SUFFIX}{BUILT}"

    def publish(self, built: Path) -> Path:
        """Give a scene's file its name; when this returns, that is on the disk."""
        path = self.folder / built.name[1:].removesuffix(BUILT)
        built.replace(path)
        sync_folder(self.folder)
        return path

    def drop(self, name: str) -> None:
        """Forget a scene."""
        for path in self.folder.iterdir():
            if STORED.fullmatch(path.name) and path.name.partition("@")[0] == name:
                path.unlink()


def version_of(path: Path) -> int:
    """The version in a file's name."""
    match = STORED.fullmatch(path.name)
    return int(match["version"]) if match else -1


def write_whole(file: Path, data: bytes) -> None:
    """All of it or nothing, also if the power fails."""
    partial = file.with_name(f".{file.name}")
    with partial.open("wb") as stream:
        stream.write(data)
        stream.flush()
        os.fsync(stream.fileno())
    partial.replace(file)
    sync_folder(file.parent)


def short_of_room(folder: Path, spare_bytes: float) -> str:
    """Why nothing more may be written there, in words; empty if so much is free."""
    free = shutil.disk_usage(folder).free
    return f"the disk has {free / 1e6:.0f} MB left, {spare_bytes / 1e6:.0f} stay free" if free < spare_bytes else ""


def sync_folder(folder: Path) -> None:
    """Bring the names of a folder to the disk."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)

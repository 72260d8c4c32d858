"""The folder of ready scenes: acknowledged ones are there after a crash; those that left memory are loaded again."""

from __future__ import annotations

import re
from pathlib import Path

from gpdf_service.scene import Scene

SUFFIX = ".gpdf"
STORED = re.compile(r"(?P<name>[^@]+)@(?P<version>\d+)" + re.escape(SUFFIX))
COUNTER = "last_version"


class SceneFiles:
    """One file a scene, NAME@VERSION.gpdf, and the last version that was given out. Not for several threads at once."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        for left in folder.glob(".*"):  # by a crash in mid-write
            left.unlink()

    def known(self) -> dict[str, Path]:
        """The newest file of each name; older ones, left by a crash, go."""
        found: dict[str, Path] = {}
        for path in sorted(self.folder.glob(f"*@*{SUFFIX}"), key=version_of):
            name = path.name.partition("@")[0]
            if name in found:
                found[name].unlink()
            found[name] = path
        return found

    def next_version(self, at_least: int) -> int:
        """A version that no scene of this folder ever had."""
        counter = self.folder / COUNTER
        last = max([int(counter.read_text()) if counter.is_file() else 0, *map(version_of, self.known().values())])
        version = max(at_least, last + 1)
        partial = self.folder / f".{COUNTER}"
        partial.write_text(str(version))
        partial.replace(counter)
        return version

    def put(self, name: str, scene: Scene) -> Path:
        """Write a scene; when this returns, it is on the disk."""
        path = self.path_of(name, scene.version)
        scene.save(path)
        return path

    def path_of(self, name: str, version: int) -> Path:
        """Where a scene's file is, or would be."""
        return self.folder / f"{name}@{version}{SUFFIX}"

    def drop(self, name: str) -> None:
        """Forget a scene."""
        for path in self.folder.glob(f"{name}@*{SUFFIX}"):
            path.unlink()


def version_of(path: Path) -> int:
    """The version in a file's name."""
    match = STORED.fullmatch(path.name)
    return int(match["version"]) if match else -1

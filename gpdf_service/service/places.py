"""Named places of scenes: they outlive a restart and a new version of the scene, not its unloading."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from pathlib import Path

import msgspec

from gpdf_service.errors import RequestError, SceneFileError
from gpdf_service.service.scene_files import write_whole

SUFFIX = ".places.json"
MAX_PLACES = 1000
"""Of one scene: every door of a hospital; a reply with all of them stays far below a megabyte."""
MAX_NAME = 64
"""Letters in a name: it is spoken."""
Named = dict[str, list[float]]


class Places:
    """Places by scene and name; safe for many threads.

    Args:
        folder: Where they are kept, a file a scene; without one they are in memory alone.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self._folder = folder
        self._known: dict[str, Named] = {}
        self._lock = threading.Lock()

    def of(self, scene: str) -> Named:
        """Position (x, y) or (x, y, z of the ground) [m] by name.

        Raises:
            SceneFileError: their file cannot be read.
        """
        with self._lock:
            return dict(self._read(scene))

    def put(self, scene: str, name: str, position: Sequence[float]) -> Named:
        """Name a place, anew if the name is known; when this returns, it is on the disk.

        Raises:
            RequestError: the name cannot be one, the position is none, or there are too many.
            SceneFileError: the file cannot be read or written.
        """
        if not _is_name(name):
            words = f"Give 1 to {MAX_NAME} letters without a comma, none of them invisible, not blank at an end."
            raise RequestError("name", repr(name[: 2 * MAX_NAME]), words)
        if len(position) not in (2, 3):
            raise RequestError("position", f"{len(position)} numbers", "Give (x, y) or (x, y, z of the ground) [m].")
        with self._lock:
            places = {**self._read(scene), name: list(position)}
            if len(places) > MAX_PLACES:
                raise RequestError("name", f"{name!r}, one more than {MAX_PLACES}", "Remove one first.")
            return self._write(scene, places)

    def remove(self, scene: str, name: str) -> Named:
        """Forget a place.

        Raises:
            KeyError: there is none of that name; its argument is all that there are.
            SceneFileError: the file cannot be read or written.
        """
        with self._lock:
            places = dict(self._read(scene))
            if places.pop(name, None) is None:
                raise KeyError(sorted(places))
            return self._write(scene, places)

    def forget(self, scene: str) -> None:
        """Forget all places of a scene: the next scene of its name may be another building."""
        with self._lock:
            self._known.pop(scene, None)
            if self._folder is not None:
                self._file(scene).unlink(missing_ok=True)

    def _read(self, scene: str) -> Named:
        if scene not in self._known and self._folder is not None and self._file(scene).is_file():
            file = self._file(scene)
            try:
                self._known[scene] = msgspec.json.decode(file.read_bytes(), type=Named)
            except (OSError, msgspec.MsgspecError) as error:
                raise SceneFileError(f"places of scene {scene!r}", str(error), f"Mend or delete {file}.") from error
        return self._known.get(scene, {})

    def _write(self, scene: str, places: Named) -> Named:
        if self._folder is not None:
            file = self._file(scene)
            try:
                write_whole(file, msgspec.json.format(msgspec.json.encode(places)))
            except OSError as error:
                raise SceneFileError(f"places of scene {scene!r}", str(error), f"Make room for {file}.") from error
        self._known[scene] = places
        return dict(places)

    def _file(self, scene: str) -> Path:
        assert self._folder is not None
        return self._folder / f"{scene}{SUFFIX}"


def _is_name(name: str) -> bool:
    return 0 < len(name) <= MAX_NAME and name.isprintable() and name == name.strip() and "," not in name

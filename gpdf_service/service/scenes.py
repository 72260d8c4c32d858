"""The map service's shelf: scenes by name, built in the background, replaced only when the new one is ready."""

from __future__ import annotations

import logging
import re
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gpdf_service.errors import GpdfError
from gpdf_service.perception import read_cloud
from gpdf_service.pipeline import Progress, build_scene
from gpdf_service.scene import Scene, load_scene
from gpdf_service.types import BoolArray, FloatArray

log = logging.getLogger(__name__)

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")
MAX_UPLOAD_POINTS = 20_000_000
"""Points that one upload may have: 0.5 GB."""
SCENE_SUFFIX = ".gpdf"
MAX_UPLOADS = 64
"""Unfinished uploads that are kept at once."""
Build = Callable[[Progress], Scene]


@dataclass(slots=True)
class Entry:
    """A scene, or why there is none yet."""

    scene: Scene | None = None
    pending: int = 0
    error: str = ""
    stage: tuple[str, float] = ("", 0.0)
    """What the build does, and the share of it that is done."""

    def note(self, stage: str, done: float) -> None:
        """Take the build's progress."""
        self.stage = stage, done

    @property
    def building(self) -> bool:
        """Whether a build waits or runs; the scene is the newest only when none does."""
        return self.pending > 0


class Shelf:
    """All scenes of a service; safe for many threads. Builds run on one thread of their own, in order."""

    def __init__(self, scenes_dir: Path, on_ready: Callable[[str, Scene], None] = lambda name, scene: None) -> None:
        self.scenes_dir = scenes_dir.resolve()
        self._entries: dict[str, Entry] = {}
        self._uploads: dict[str, dict[int, tuple[FloatArray, BoolArray | None]]] = {}
        self._version = 0
        self._lock = threading.Lock()
        self._builder = ThreadPoolExecutor(1, thread_name_prefix="gpdf-build")
        self._on_ready = on_ready

    def close(self) -> None:
        """Let the running build end and start no other."""
        self._builder.shutdown(wait=True, cancel_futures=True)

    def get(self, name: str) -> Entry | None:
        """What is known of a scene."""
        with self._lock:
            return self._entries.get(name)

    def facts(self) -> dict[str, dict[str, Any]]:
        """Facts of every scene, by name."""
        with self._lock:
            entries = dict(self._entries)
        return {name: describe(entry) for name, entry in entries.items()}

    def load_file(self, name: str, file: str | Path, *, inside: bool = True) -> None:
        """Start to load a cloud or a scene file.

        Args:
            name: Name to give it.
            file: The file; a name within the scenes folder when `inside`.
            inside: Refuse what lies outside the scenes folder (requests); False for the operator's command line.

        Raises:
            ValueError: the name is no name, or the file is not there.
        """
        path = (self.scenes_dir / file).resolve() if inside else Path(file)
        if inside and not path.is_relative_to(self.scenes_dir):
            raise ValueError(f"file {str(file)!r} lies outside the scenes folder. Name a file in it.")
        if not _is_file(path):
            raise ValueError(f"file {str(file)!r} is not in the scenes folder. Put it there, or upload the points.")

        def build(progress: Progress) -> Scene:
            progress("read the file", 0.0)
            if path.suffix == SCENE_SUFFIX:
                return load_scene(path)
            cloud = read_cloud(path)
            return build_scene(cloud.points, cloud.ground, progress=progress)

        self._start(name, build)

    def add_part(
        self, name: str, upload_id: str, part: int, parts: int, points: FloatArray, ground: BoolArray | None
    ) -> bool:
        """Take one part of an upload; True when it was the last, and the build has begun.

        Raises:
            ValueError: the part does not fit.
        """
        if not 0 <= part < parts or parts > MAX_UPLOAD_POINTS:
            raise ValueError(f"part {part} of {parts} is none. Parts count from 0.")
        if len(points) == 0:
            raise ValueError(f"part {part} has no points. Send at least one a part.")
        key = f"{name}/{upload_id}"
        with self._lock:
            if part > 0 and key not in self._uploads:
                raise ValueError(
                    f"part {part} belongs to no upload that is under way: part 0 comes first, and "
                    "uploads that stay unfinished make room for others. Send it again."
                )
            kept = self._uploads.setdefault(key, {})
            kept[part] = (points, ground)
            while (
                self._waiting() > MAX_UPLOAD_POINTS or len(self._uploads) > MAX_UPLOADS
            ):  # uploads that nobody finished go first, the oldest ahead
                oldest = next(iter(self._uploads))
                del self._uploads[oldest]
                if oldest == key:
                    raise ValueError(f"it has more than {MAX_UPLOAD_POINTS} points. Thin the cloud, or load a file.")
            if len(kept) < parts:
                return False
            del self._uploads[key]
        cloud = np.concatenate([kept[i][0] for i in range(parts)])
        labels = [kept[i][1] for i in range(parts)]
        given = [label for label in labels if label is not None]
        if given and len(given) != parts:
            raise ValueError("some parts have ground labels and some have none. Send them with all parts or none.")
        mask = np.concatenate(given) if given else None
        self._start(name, lambda progress: build_scene(cloud, mask, progress=progress))
        return True

    def _waiting(self) -> int:
        return sum(len(points) for upload in self._uploads.values() for points, _ in upload.values())

    def unload(self, name: str) -> bool:
        """Forget a scene; False if there was none."""
        with self._lock:
            return self._entries.pop(name, None) is not None

    def _start(self, name: str, build: Build) -> None:
        if not NAME.fullmatch(name):
            raise ValueError(f"{name!r} is no name for a scene. Use letters, digits, '_', '-' and '.', at most 64.")
        with self._lock:
            entry = self._entries.setdefault(name, Entry())
            entry.pending += 1
            entry.error = ""
        self._builder.submit(self._build, name, entry, build)

    def _build(self, name: str, entry: Entry, build: Build) -> None:
        try:
            scene = build(entry.note)
        except GpdfError as error:
            log.warning("scene %s: %s", name, error)
            with self._lock:
                entry.pending, entry.error = entry.pending - 1, str(error)
        except Exception:
            log.exception("scene %s", name)
            with self._lock:
                entry.pending -= 1
                entry.error = "the build failed inside the service; its log says more."
        else:
            with self._lock:
                self._version = scene.version = max(scene.version, self._version + 1)  # never the same, never back
                entry.scene, entry.pending, entry.error = scene, entry.pending - 1, ""
            log.info("scene %s is ready: %d points, digest %s", name, len(scene.points), scene.digest)
            self._on_ready(name, scene)


def describe(entry: Entry) -> dict[str, Any]:
    """Facts of one entry, ready for the wire."""
    state = "ready" if entry.scene else ("building" if entry.building else "failed")
    facts: dict[str, Any] = {"state": state, "building": entry.building, "error": entry.error}
    if entry.building:
        facts |= {"stage": entry.stage[0], "done": entry.stage[1]}
    return facts if entry.scene is None else facts | entry.scene.info()


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:  # a name that no file can have
        return False

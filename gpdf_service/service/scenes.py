"""The shelf: scenes by name, built in the background, replaced only when the new one is ready, kept on disk."""

from __future__ import annotations

import logging
import re
import threading
import time
from collections.abc import Callable, Collection
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gpdf_service.config import Config
from gpdf_service.errors import GpdfError, RequestError, SceneFileError
from gpdf_service.perception import read_cloud
from gpdf_service.pipeline import Progress, build_scene
from gpdf_service.scene import Scene, load_scene
from gpdf_service.service.changes import Change, changed
from gpdf_service.service.memory import held_bytes
from gpdf_service.service.places import Places
from gpdf_service.service.scene_files import SUFFIX, SceneFiles
from gpdf_service.service.uploads import Uploads
from gpdf_service.types import BoolArray, FloatArray

log = logging.getLogger(__name__)

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")
MAX_WAITING_POINTS = 5_000_000
"""Of changes to one scene that wait for the build of its next version: a minute of a laser scanner."""
MAX_CLOUD_POINTS = 20_000_000
"""Of uploaded clouds that wait for their builds, 0.5 GB: as much as one upload may have."""
MAX_SCENES = 1000
"""Scenes at once: the floors of a town's houses; each has a line in every list, and a file."""
MAX_BUILDS = 2 * MAX_SCENES
"""That wait or run: every scene and its next version."""
Build = Callable[[Progress], Scene]


class FullError(GpdfError):
    """What was sent finds no room now; later it may."""


@dataclass(slots=True)
class Entry:
    """A scene, or why there is none yet.

    Attributes:
        scene: In memory; None when it is not ready, or was evicted.
        file: Where it is on disk.
        facts: What it tells of itself; empty until it is ready.
        pending: Builds that wait or run.
        error: Why the last build failed.
        used: When it was last asked for, on `time.monotonic` [s].
    """

    scene: Scene | None = None
    file: Path | None = None
    facts: dict[str, Any] = field(default_factory=dict)
    pending: int = 0
    error: str = ""
    used: float = 0.0
    lock: threading.Lock = field(default_factory=threading.Lock)
    stage: tuple[str, float] = ("", 0.0)
    """What the build does, and the share of it that is done."""
    changes: list[Change] = field(default_factory=list)
    """That wait for a build; all of them become one version."""

    def note(self, stage: str, done: float) -> None:
        """Take the build's progress."""
        self.stage = stage, done

    @property
    def building(self) -> bool:
        """Whether a build waits or runs; the scene is the newest only when none does."""
        return self.pending > 0

    @property
    def ready(self) -> bool:
        """Whether there is a scene to plan in."""
        return bool(self.facts)


class Shelf:
    """All scenes of a service; safe for many threads. Builds run on one thread of their own, in order.

    Args:
        scenes_dir: Folder of the files that clients may load.
        on_ready: Told the name and the scene when a version is ready.
        config: Settings of what is built.
        state_dir: Folder to keep ready scenes in; without one they are in memory alone, and stay there.
        memory_bytes: Of all scenes together; the least recently used leave memory first.
    """

    def __init__(
        self,
        scenes_dir: Path,
        on_ready: Callable[[str, Scene], None] = lambda name, scene: None,
        config: Config | None = None,
        *,
        state_dir: Path | None = None,
        memory_bytes: float = float("inf"),
    ) -> None:
        self.scenes_dir = scenes_dir.resolve()
        self.files = None if state_dir is None else SceneFiles(state_dir)
        self.places = Places(state_dir)
        self._config, self._memory_bytes = config, memory_bytes
        self._entries: dict[str, Entry] = {}
        self._uploads = Uploads()
        self._version = self._builds = self._cloud_points = 0  # points of uploads that wait for their builds
        self._lock = threading.Lock()
        self._builder = ThreadPoolExecutor(1, thread_name_prefix="gpdf-build")
        self._on_ready = on_ready

    def close(self) -> None:
        """Let the running build end and start no other."""
        self._builder.shutdown(wait=True, cancel_futures=True)

    def restore(self, without: Collection[str] = ()) -> None:
        """Start to load what is in the state folder: every scene that was ready when the service ended, or died.

        Args:
            without: Names that come anew; nobody shall be answered from their old versions.
        """
        for name, path in (self.files.known() if self.files else {}).items():
            if name not in without:
                self._start(name, lambda _, path=path: load_scene(path), path)  # type: ignore[misc]

    def settle(self) -> None:
        """Wait for the builds that were begun."""
        self._builder.submit(lambda: None).result()

    def get(self, name: str) -> Entry | None:
        """What is known of a scene."""
        with self._lock:
            return self._entries.get(name)

    def scene(self, entry: Entry) -> Scene:
        """The last complete version of a ready scene, loaded from disk if it had left memory."""
        entry.used = time.monotonic()
        with entry.lock:  # who comes second waits for the first one's load
            if entry.scene is None:
                assert entry.file is not None
                entry.scene = load_scene(entry.file)
                log.info("a scene is loaded", extra={"file": entry.file.name})
                found = entry.scene
            else:
                return entry.scene
        self.trim()
        return found

    def hold(self, name: str, file: Path) -> Entry:
        """A ready scene whose file somebody else keeps, in the place of an older one of that name."""
        with self._lock:
            entry = self._entries.get(name)
            if entry is None or entry.file != file:
                entry = self._entries[name] = Entry(file=file)
            return entry

    def held(self, name: str) -> Entry:
        """What `hold` gave."""
        with self._lock:
            return self._entries[name]

    def forget_gone(self) -> list[str]:
        """Forget the scenes whose files are not there any more; their names."""
        with self._lock:
            gone = [name for name, entry in self._entries.items() if entry.file is None or not entry.file.is_file()]
            for name in gone:
                del self._entries[name]
        return gone

    def trim(self) -> float:
        """Let scenes leave memory until the rest fits, the least recently used ahead, not the last; bytes held."""
        with self._lock:
            entries = sorted(self._entries.items(), key=lambda item: item[1].used)
        sizes = {name: held_bytes(entry.scene) for name, entry in entries}
        total = sum(sizes.values())
        kept = [(name, entry) for name, entry in entries if entry.scene is not None]
        for name, entry in kept[:-1]:
            if total <= self._memory_bytes:
                break
            if entry.file is not None and entry.lock.acquire(blocking=False):
                entry.scene = None
                entry.lock.release()
                total -= sizes[name]
                log.info("scene %s left memory", name, extra={"bytes": sizes[name]})
        if total > self._memory_bytes and kept and kept[-1][1].scene is not None:
            kept[-1][1].scene.forget_agents()
        return total

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
            FullError: too many builds wait already.
            RequestError: the name is none, or there are too many scenes.
            ValueError: the file is not there.
        """
        self._admit(name)
        path = (self.scenes_dir / file).resolve() if inside else Path(file)
        if inside and not path.is_relative_to(self.scenes_dir):
            raise ValueError(f"file {str(file)!r} lies outside the scenes folder. Name a file in it.")
        if not _is_file(path):
            words = "is not in the scenes folder. Put it there, or upload the points." if inside else "is not there."
            raise ValueError(f"file {str(file)!r} {words}")

        def build(progress: Progress) -> Scene:
            progress("read the file", 0.0)
            if path.suffix == SUFFIX:
                return load_scene(path)
            cloud = read_cloud(path)
            return build_scene(cloud.points, cloud.ground, self._config, progress=progress)

        self._start(name, build)

    def add_part(
        self, name: str, upload_id: str, part: int, parts: int, points: FloatArray, ground: BoolArray | None
    ) -> bool:
        """Take one part of an upload; True when it was the last, and the build has begun.

        Raises:
            FullError: too many points or builds wait already; this part is not taken.
            RequestError: the name is none, or there are too many scenes.
            ValueError: the part does not fit.
        """
        self._admit(name)
        if self._cloud_points + len(points) > MAX_CLOUD_POINTS:
            raise FullError(f"scene {name!r}", "clouds come faster than they are built", "Send it again in a moment.")
        whole = self._uploads.add(f"{name}/{upload_id}", part, parts, points, ground)
        if whole is None:
            return False
        self._wait_for_build(len(whole[0]))

        def build(progress: Progress) -> Scene:
            self._wait_for_build(-len(whole[0]))
            return build_scene(*whole, self._config, progress=progress)

        self._start(name, build)
        return True

    def _wait_for_build(self, points: int) -> None:
        """So many more points wait, or less."""
        with self._lock:
            self._cloud_points += points

    def _admit(self, name: str) -> None:
        """Refuse what is no name, and a scene too many, before there is any work for it."""
        if not NAME.fullmatch(name):
            words = "Use letters, digits, '_', '-' and '.', at most 64."
            raise RequestError("scene", f"{name[:100]!r} is no name", words)
        with self._lock:
            if name not in self._entries and len(self._entries) >= MAX_SCENES:
                raise RequestError("scene", f"there are {MAX_SCENES} already", "Unload one that nobody needs.")
            if self._builds >= MAX_BUILDS:
                raise FullError(f"scene {name!r}", f"{MAX_BUILDS} builds are waiting", "Send it again in a moment.")

    def add_change(
        self, name: str, upload_id: str, part: int, parts: int, points: FloatArray, gone: BoolArray, radius: float
    ) -> bool:
        """Take one part of a change to a scene; True when it was the last, and the next version is begun, or soon is.

        Raises:
            FullError: too much waits already; this part is not taken.
            ValueError: the part does not fit, or there is no such scene.
        """
        entry = self.get(name)
        if entry is None:
            raise ValueError(f"there is no scene {name!r}. Load it first.")
        if sum(change.size for change in entry.changes) + len(points) > MAX_WAITING_POINTS:
            raise FullError(f"scene {name!r}", "changes come faster than they are built", "Send it again in a moment.")
        whole = self._uploads.add(f"change of {name}/{upload_id}", part, parts, points, gone)
        if whole is None:
            return False
        every, taken = whole
        assert taken is not None
        with self._lock:
            entry.changes.append(Change(every[~taken], every[taken], radius))
            waits = len(entry.changes) > 1
        if not waits:  # else that build takes this change as well
            self._start(name, lambda progress: self._next(entry, progress))
        return True

    def _next(self, entry: Entry, progress: Progress) -> Scene:
        with self._lock:
            changes, entry.changes = entry.changes, []
        if not entry.ready:
            raise SceneFileError("a change", "the scene that it belongs to could not be built", "Load the scene first.")
        return changed(self.scene(entry), changes, progress)

    def place(self, name: str, scene: Scene, path: Path) -> None:
        """Put a ready scene there, with its file in the state folder, in the place of the one before."""
        with self._lock:
            entry = self._entries.setdefault(name, Entry())
            entry.pending += 1
        self._finish(name, entry, scene, path)

    def unload(self, name: str) -> bool:
        """Forget a scene; False if there was none."""
        with self._lock:
            if name in self._entries:
                self.places.forget(name)  # ahead of the scene: a crash between must not leave them to the next one
                if self.files is not None:
                    self.files.drop(name)
            return self._entries.pop(name, None) is not None

    def _start(self, name: str, build: Build, file: Path | None = None) -> None:
        with self._lock:
            entry = self._entries.setdefault(name, Entry())
            entry.pending += 1
            entry.error = ""
            self._builds += 1
        self._builder.submit(self._build, name, entry, build, file)

    def _build(self, name: str, entry: Entry, build: Build, file: Path | None) -> None:
        try:
            scene = build(entry.note)
        except GpdfError as error:
            log.warning("scene %s: %s", name, error)
            self._fail(entry, str(error))
        except Exception:
            log.exception("scene %s", name)
            self._fail(entry, "the build failed inside the service; its log says more.")
        else:
            self._finish(name, entry, scene, file)
        finally:
            with self._lock:
                self._builds -= 1

    def _fail(self, entry: Entry, why: str) -> None:
        with self._lock:
            entry.pending, entry.error = entry.pending - 1, why

    def _finish(self, name: str, entry: Entry, scene: Scene, file: Path | None) -> None:
        if file is None:
            scene.version = self._next_version(scene.version)
            file = self._keep(name, scene)
        with entry.lock, self._lock:  # nobody is loading the old version from its file
            current = self._entries.get(name) is entry
            older = entry.file if current else file  # unloaded meanwhile: nobody will ask for the new one
            entry.scene, entry.file, entry.facts = scene, file, scene.info()
            entry.pending, entry.error, entry.used = entry.pending - 1, "", time.monotonic()
            self._version = max(self._version, scene.version)
            if older is not None and (older != file or not current):
                older.unlink(missing_ok=True)
        if not current:
            return
        facts = {"points": len(scene.points), "version": scene.version, "digest": scene.digest}
        log.info("scene %s is ready", name, extra=facts)
        self._on_ready(name, scene)
        self.trim()

    def _next_version(self, at_least: int) -> int:
        """Never the same, never back."""
        at_least = max(at_least, self._version + 1)
        try:
            return at_least if self.files is None else self.files.next_version(at_least)
        except OSError as error:
            log.error("the last version cannot be kept: %s", error)
            return at_least

    def _keep(self, name: str, scene: Scene) -> Path | None:
        """Save the scene before it is acknowledged; None, loudly, if the disk does not take it."""
        try:
            return None if self.files is None else self.files.put(name, scene)
        except OSError as error:
            log.error("NOT KEPT: scene %s is in memory alone, a restart loses it: %s", name, error)
            return None


def describe(entry: Entry) -> dict[str, Any]:
    """Facts of one entry, ready for the wire."""
    state = "ready" if entry.ready else ("building" if entry.building else "failed")
    facts: dict[str, Any] = {"state": state, "building": entry.building, "error": entry.error}
    if entry.building:
        facts |= {"stage": entry.stage[0], "done": entry.stage[1]}
    scene = entry.scene
    return (
        facts
        | (entry.facts if scene is None else scene.info())
        | {
            "in_memory": scene is not None,
            "kept": entry.file is not None,
        }
    )


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:  # a name that no file can have
        return False

"""The shelf: scenes by name, built in the background, replaced only when the new one is ready, kept on disk."""

from __future__ import annotations

import dataclasses
import logging
import re
import tempfile
import time
from collections.abc import Callable, Collection, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from msgspec.structs import replace
from numpy.typing import NDArray

from gpdf_service.config import Config
from gpdf_service.errors import GpdfError, RequestError
from gpdf_service.pipeline import Progress
from gpdf_service.scene import Scene, load_scene
from gpdf_service.service.held import Entry as Entry
from gpdf_service.service.held import Held
from gpdf_service.service.held import describe as describe
from gpdf_service.service.journal import Journal, Kind, Task
from gpdf_service.service.moving import Moving
from gpdf_service.service.places import Places
from gpdf_service.service.scene_files import SceneFiles, short_of_room, version_of
from gpdf_service.service.state_folder import StateFolder
from gpdf_service.service.uploads import Uploads
from gpdf_service.service.words import public
from gpdf_service.service.workshop import MAKE_ROOM, BuildError, EndedError, Job, NotKeptError, Workshop
from gpdf_service.types import Agent, BoolArray, FloatArray

log = logging.getLogger(__name__)

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")
MAX_WAITING_POINTS = 5_000_000
"""Of changes to one scene that wait for the build of its next version: a minute of a laser scanner."""
LEAST_CHANGE = 1000
"""[points] That a change counts for: it is a file, and a tree of the points that go."""
MAX_CLOUD_POINTS = 20_000_000
"""Of uploaded clouds that wait for their builds, 0.5 GB: as much as one upload may have."""
MAX_SCENES = 1000
"""Scenes at once: the floors of a town's houses; each has a line in every list, and a file."""
MAX_BUILDS = 2 * MAX_SCENES
"""That wait or run: every scene and its next version."""
JOURNAL = "journal"
"""Folder in the state folder: what was acknowledged and is not built yet."""
RETRY_S = 60.0
"""[s] Until what was acknowledged, and could not be kept when it was built, is built again."""
Build = Callable[[Job, Progress], Path]
"""What has a job done: a `Workshop`, or a `Builder` whose workshop is in another process."""


class FullError(GpdfError):
    """What was sent finds no room now; later it may."""


class Shelf:
    """All scenes of a service; safe for many threads. Builds run one after the other, in order.

    Args:
        scenes_dir: Folder of the files that clients may load.
        on_ready: Told the name and the scene when a version is ready.
        config: Settings of what is built here.
        state_dir: Folder to keep ready scenes in; without one they go with the shelf.
        memory_bytes: Of all scenes together; the least recently used leave memory first.
        spare_bytes: That stay free on the disk, for others.
        build: Has jobs done; without it they are done here, with `config`.

    Attributes:
        moving: What moves in them; it is not kept on disk.
        trouble: Why what is sent cannot be kept now; empty when all is well.
        lost: What was acknowledged and cannot be read again, in words.

    Raises:
        ConfigError: the state folder is not ours.
    """

    def __init__(
        self,
        scenes_dir: Path,
        on_ready: Callable[[str, Scene], None] = lambda name, scene: None,
        config: Config | None = None,
        *,
        state_dir: Path | None = None,
        memory_bytes: float = float("inf"),
        spare_bytes: float = 0.0,
        build: Build | None = None,
    ) -> None:
        self.scenes_dir = scenes_dir.resolve()
        self._temporary = None if state_dir else tempfile.TemporaryDirectory(prefix="gpdf-")
        folder = Path(self._temporary.name) if self._temporary else state_dir
        assert folder is not None
        self._state = StateFolder(folder)
        self.files, self.journal, self.places = SceneFiles(folder), Journal(folder / JOURNAL), Places(folder)
        self.moving = Moving()
        self._held = Held(memory_bytes, self.moving)
        self._lock, self._entries = self._held.lock, self._held.entries
        self._uploads = Uploads()
        self._builds = self._cloud_points = 0  # points of clouds that wait for their builds
        self._retry_at = 0.0
        self._builder = ThreadPoolExecutor(1, thread_name_prefix="gpdf-build")
        self._spare_bytes = spare_bytes
        self._build = build or Workshop(config, memory_bytes).build
        self._on_ready = on_ready
        self.trouble, self.lost = "", list[str]()

    def close(self) -> None:
        """Let the running build end and start no other; what waits is built when the shelf is next restored."""
        self._builder.shutdown(wait=True, cancel_futures=True)
        self._state.close()
        if self._temporary is not None:
            self._temporary.cleanup()

    def restore(self, without: Collection[str] = ()) -> None:
        """Start to load what is in the state folder: every scene that was ready when the service ended, or died.

        What was acknowledged and not yet built is built now.

        Args:
            without: Names that come anew; nobody shall be answered from their old versions.
        """
        known = self.files.known()
        for name, path in known.items():
            if name not in without:
                self._begin(name, lambda entry, name=name, path=path: self._load(name, entry, path))  # type: ignore[misc]
        waiting, self.lost = self.journal.waiting()
        for task in waiting:
            is_built = task.scene in known and 0 < task.version <= version_of(known[task.scene])
            if is_built or task.scene in without:
                self.journal.done(task)
            else:
                self._take(task)

    def after_builds(self, call: Callable[[], None]) -> None:
        """Call it once what was begun until now is built, or could not be."""
        self._builder.submit(call)

    def settle(self) -> None:
        """Wait for the builds that were begun."""
        self._builder.submit(lambda: None).result()

    def get(self, name: str) -> Entry | None:
        """What is known of a scene."""
        return self._held.get(name)

    def scene(self, entry: Entry) -> Scene:
        """The last complete version of a ready scene, loaded from disk if it had left memory."""
        return self._held.scene(entry)

    def facts(self) -> dict[str, dict[str, Any]]:
        """Facts of every scene, by name."""
        return self._held.facts()

    def trim(self) -> float:
        """Let scenes leave memory until the rest fits; bytes held."""
        return self._held.trim()

    def load_file(self, name: str, file: str | Path, *, inside: bool = True) -> None:
        """Start to load a cloud or a scene file.

        Args:
            name: Name to give it.
            file: The file; a name within the scenes folder when `inside`.
            inside: Refuse what lies outside the scenes folder (requests); False for the operator's command line, which
                says it again at the next start.

        Raises:
            FullError: too many builds wait already.
            NotKeptError: the state folder does not take it.
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
        if inside:
            self._take(self._write_down("file", name, {"file": str(path)}))
        else:
            self._begin(name, lambda entry: self._make(name, entry, [], file=str(path)))

    def add_part(
        self,
        name: str,
        upload_id: str,
        part: int,
        parts: int,
        points: FloatArray,
        ground: BoolArray | None,
        origins: FloatArray | None = None,
    ) -> bool:
        """Take one part of an upload; True when it was the last: the whole is on the disk, and its build has begun.

        Raises:
            FullError: too many points or builds wait already; this part is not taken.
            NotKeptError: the state folder does not take it.
            RequestError: the name is none, or there are too many scenes.
            ValueError: the part does not fit.
        """
        self._admit(name)
        if self._cloud_points + len(points) > MAX_CLOUD_POINTS:
            raise FullError(f"scene {name!r}", "clouds come faster than they are built", "Send it again in a moment.")
        sent = _given(points=points, ground=ground, origins=origins)
        whole = self._uploads.add(f"{name}/{upload_id}", part, parts, sent)
        if whole is None:
            return False
        self._take(self._write_down("cloud", name, {}, **whole))
        return True

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
        self,
        name: str,
        upload_id: str,
        part: int,
        parts: int,
        points: FloatArray,
        gone: BoolArray,
        radius: float,
        origins: FloatArray | None = None,
        thin: float = 0.0,
    ) -> bool:
        """Take one part of a change to a scene; True when it was the last, and the next version is begun, or soon is.

        Raises:
            FullError: too much waits already; this part is not taken.
            NotKeptError: the state folder does not take it.
            ValueError: the part does not fit, or there is no such scene.
        """
        entry = self.get(name)
        if entry is None:
            raise ValueError(f"there is no scene {name!r}. Load it first.")
        waiting = sum(max(task.size, LEAST_CHANGE) for task in entry.waiting if task.kind == "change")
        if waiting + len(points) > MAX_WAITING_POINTS:
            raise FullError(f"scene {name!r}", "changes come faster than they are built", "Send it again in a moment.")
        sent = _given(points=points, gone=gone, origins=origins)
        whole = self._uploads.add(f"change of {name}/{upload_id}", part, parts, sent)
        if whole is None:
            return False
        self._take(self._write_down("change", name, {"radius": radius, "thin": thin}, **whole), entry)
        return True

    def _write_down(self, kind: Kind, name: str, facts: Mapping[str, Any], **arrays: NDArray[Any]) -> Task:
        """On the disk before it is acknowledged."""
        try:
            size = sum(array.nbytes for array in arrays.values())
            if short := short_of_room(self.files.folder, self._spare_bytes + size):
                raise OSError(short)
            return self.journal.put(kind, name, facts, **arrays)
        except OSError as error:
            self.trouble = f"scene {name!r}: what was sent cannot be kept ({error.strerror or error})"
            raise NotKeptError(f"{self.trouble}. {MAKE_ROOM}.") from error

    def _take(self, task: Task, belongs_to: Entry | None = None) -> None:
        """Let a task wait for its build; changes that wait together become one version.

        Raises:
            ValueError: the scene that it belongs to was unloaded meanwhile.
        """
        with self._lock:
            if belongs_to is not None and self._entries.get(task.scene) is not belongs_to:
                self.journal.done(task)
                raise ValueError(f"there is no scene {task.scene!r} any more. Load it first.")
            entry = self._entries.setdefault(task.scene, Entry())
            joins = task.kind == "change" and bool(entry.waiting) and entry.waiting[-1].kind == "change"
            entry.waiting.append(task)
            self._cloud_points += _cloud_points([task])
            if not (joins and entry.pending):
                self._submit_next(task.scene, entry)

    def _submit_next(self, name: str, entry: Entry) -> None:
        self._submit(name, entry, lambda entry: self._make_next(name, entry))

    def _make_next(self, name: str, entry: Entry) -> None:
        """The next version, from the first that waits, or the first changes."""
        with self._lock:
            count = 1
            if entry.waiting and entry.waiting[0].kind == "change":
                count = next((i for i, task in enumerate(entry.waiting) if task.kind != "change"), len(entry.waiting))
            entry.taken, entry.waiting = entry.waiting[:count], entry.waiting[count:]
            self._cloud_points -= _cloud_points(entry.taken)
        if entry.taken:  # else it was unloaded meanwhile, or is in the version before
            self._make(name, entry, entry.taken)

    def _make(self, name: str, entry: Entry, tasks: list[Task], file: str = "") -> None:
        """Build one version, and forget the tasks that are in it, unless the disk alone is why there is none."""
        try:
            job = self._job(name, entry, tasks, file)
            self._publish(name, entry, self._build(job, entry.note))
        except EndedError:
            raise
        except NotKeptError:
            self._put_back(entry)
            raise
        except BaseException:
            self._forget(entry)
            raise
        self._forget(entry)

    def _put_back(self, entry: Entry) -> None:
        """What was taken waits again, ahead of what came since: no later version may do without it."""
        with self._lock:
            self._cloud_points += _cloud_points(entry.taken)
            entry.waiting, entry.taken = [*entry.taken, *entry.waiting], []
            self._retry_at = time.monotonic() + RETRY_S

    def try_again(self) -> None:
        """Build what was acknowledged and could not be kept, after a while."""
        with self._lock:
            if time.monotonic() >= self._retry_at:
                for name, entry in self._unkept():
                    self._submit_next(name, entry)

    def _unkept(self) -> list[tuple[str, Entry]]:
        """Scenes of which something was acknowledged that the disk did not take when it was built."""
        return [(name, entry) for name, entry in self._entries.items() if entry.waiting and not entry.pending]

    def _job(self, name: str, entry: Entry, tasks: list[Task], file: str) -> Job:
        try:
            version = self.files.next_version()
            with self._lock:
                entry.taken = tasks = [self.journal.promise(task, version) for task in tasks if task in entry.taken]
        except OSError as error:
            raise NotKeptError(f"it cannot be kept ({error.strerror or error}). {MAKE_ROOM}") from error
        agents = list(map(dataclasses.asdict, entry.bodies))
        job = Job(name, version, str(self.files.folder), file, agents=agents, spare_bytes=self._spare_bytes)
        if not tasks:
            return job
        first = tasks[0]
        if first.kind == "change":
            changes = [(str(task.path), task.facts["radius"], task.facts.get("thin", 0.0)) for task in tasks]
            return replace(job, base=str(entry.file or ""), changes=changes)
        return replace(job, cloud=str(first.path)) if first.kind == "cloud" else replace(job, file=first.facts["file"])

    def _forget(self, entry: Entry) -> None:
        with self._lock:
            for task in entry.taken:
                self.journal.done(task)
            entry.taken = []

    def place(self, name: str, scene: Scene, path: Path) -> None:
        """Put a ready scene there, with its file in the state folder, in the place of the one before."""
        with self._lock:
            entry = self._entries.setdefault(name, Entry())
        self._put(name, entry, scene, path)

    def unload(self, name: str) -> bool:
        """Forget a scene, not what moves there: it may be for the next of its name; False if there was none."""
        with self._lock:
            entry = self._entries.get(name)
            if entry is None:
                return False
            for task in (*entry.taken, *entry.waiting):
                self.journal.done(task)
            self._cloud_points -= _cloud_points(entry.waiting)
            entry.taken, entry.waiting = [], []
            self.places.forget(name)  # ahead of the scene: a crash between must not leave them to the next one
            self.files.drop(name)
            del self._entries[name]
            self.moving.let_go(name)
            return True

    def note_body(self, name: str, body: Agent) -> None:
        """A body of that kind moves in a scene: its free space comes with the next version."""
        with self._lock:
            if (entry := self._entries.get(name)) is not None:
                entry.note_body(body)

    def _begin(self, name: str, work: Callable[[Entry], None]) -> None:
        with self._lock:
            self._submit(name, self._entries.setdefault(name, Entry()), work)

    def _submit(self, name: str, entry: Entry, work: Callable[[Entry], None]) -> None:
        """Let a build wait for its turn; the lock is held."""
        entry.pending += 1
        entry.error = ""
        self._builds += 1
        self._builder.submit(self._run, name, entry, work)

    def _run(self, name: str, entry: Entry, work: Callable[[Entry], None]) -> None:
        """One build, whatever becomes of it."""
        error = ""
        try:
            work(entry)
        except EndedError:
            return  # what it was to build is in the journal
        except NotKeptError as found:
            error = f"{public(str(found))}; if it was acknowledged, it is tried again, also after a restart."
            self.trouble = f"scene {name!r}: {error}"
            log.error("NOT KEPT: scene %s: %s", name, found)
        except (GpdfError, BuildError) as found:
            log.warning("scene %s: %s", name, found)
            error = public(str(found))
        except Exception:
            log.exception("scene %s", name)
            error = "the build failed inside the service; its log says more."
        with self._lock:
            entry.pending, entry.error = entry.pending - 1, error
            self._builds -= 1
            if not error and entry.waiting and not entry.pending:  # it was put back, and came with another one's turn
                self._submit_next(name, entry)

    def _publish(self, name: str, entry: Entry, built: Path) -> None:
        """Make what was built the scene's next version, unless it was unloaded meanwhile."""
        with self._lock:
            if self._entries.get(name) is not entry:
                built.unlink()
                return
            try:
                file = self.files.publish(built)
            except OSError as error:
                raise NotKeptError(f"it cannot be kept ({error.strerror or error})") from error
        self._load(name, entry, file)

    def _load(self, name: str, entry: Entry, file: Path) -> None:
        self._put(name, entry, load_scene(file), file)

    def _put(self, name: str, entry: Entry, scene: Scene, file: Path) -> None:
        with entry.lock, self._lock:  # nobody is loading the old version from its file
            current = self._entries.get(name) is entry
            older = entry.file if current else file  # unloaded meanwhile: nobody will ask for the new one
            if current:
                entry.scene, entry.file, entry.facts, entry.used = scene, file, scene.info(), time.monotonic()
            if older is not None and (older != file or not current):
                older.unlink(missing_ok=True)
        if not current:
            return
        with self._lock:
            self.trouble = next((f"scene {name!r}: {entry.error}" for name, entry in self._unkept()), "")
        facts = {"points": len(scene.points), "version": scene.version, "digest": scene.digest}
        log.info("scene %s is ready", name, extra=facts)
        self._on_ready(name, scene)
        self.trim()


def _given(**arrays: NDArray[Any] | None) -> dict[str, NDArray[Any]]:
    """Those that are."""
    return {name: each for name, each in arrays.items() if each is not None}


def _cloud_points(tasks: Collection[Task]) -> int:
    return sum(task.size for task in tasks if task.kind == "cloud")


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:  # a name that no file can have
        return False

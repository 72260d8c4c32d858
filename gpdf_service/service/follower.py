"""A planner's side of the map: fetch every ready scene in parts, keep it by version, follow what changes."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import zenoh
from gpdf_client import Client
from gpdf_client.results import ClientError
from gpdf_schemas import DecodeError, FileReply, FileRequest, SceneRequest, ScenesReply, Status, keys

from gpdf_service.errors import GpdfError, SceneFileError
from gpdf_service.scene import load_scene
from gpdf_service.service.answers import RefusedError
from gpdf_service.service.scenes import NAME, Shelf
from gpdf_service.service.words import public
from gpdf_service.service.workshop import MAKE_ROOM

log = logging.getLogger(__name__)

LEAST_S = 0.05
"""[s] Between two looks."""
RESYNC_S = 5.0
"""[s] Between looks at the map's list, for what was published while the link was cut."""
ASK_S = 10.0
"""[s] For one answer of the map service."""


class Follower:
    """Keeps a planner's shelf as the map service's; while that cannot be reached, the shelf stays as it is.

    Args:
        session: A session that leads to the map service.
        shelf: The planner's, with a state folder.
        on_synced: Called once, when the shelf is as the map's for the first time.
        on_gone: Told the name of a scene that the map has no more.

    Attributes:
        trouble: Why it may be stale now; empty when all is well.
        absent: Scenes that the map has, or will have, and the shelf has not: the status and the words for who asks.
    """

    def __init__(
        self,
        session: zenoh.Session,
        shelf: Shelf,
        on_synced: Callable[[], None],
        on_gone: Callable[[str], None] = lambda name: None,
    ) -> None:
        self._map, self._shelf, self._files = Client(session), shelf, shelf.files
        self._on_synced, self._on_gone = on_synced, on_gone
        self._awaited: set[str] | None = None  # built by the map when it first answered, and still
        self.trouble = "the map service has not answered yet"
        self.absent: dict[str, tuple[Status, str]] = {}
        self._news, self._ended = threading.Event(), threading.Event()
        self._busy = threading.Lock()
        self._looked = 0.0
        self._subscriber = session.declare_subscriber(keys.changed("*"), lambda _: self._news.set())
        self._thread = threading.Thread(target=self._run, name="gpdf-follow", daemon=True)

    @property
    def complete(self) -> bool:
        """Whether what the map has was here, all of it, when last asked; not what it began to build since."""
        return self._awaited == set() and all(status is not Status.UNAVAILABLE for status, _ in self.absent.values())

    def start(self) -> None:
        """Follow from now on."""
        self._thread.start()

    def close(self) -> None:
        """Follow no more."""
        self._ended.set()
        self._news.set()
        self._thread.join()

    def look_for(self, name: str, timeout_s: float) -> None:
        """Bring the shelf up to date for a scene that is not on it; return when it is, or after `timeout_s`.

        Raises:
            RefusedError: the map has it, and why it is not here.
        """
        asked = time.monotonic()
        if self._busy.acquire(timeout=min(max(0.0, timeout_s), threading.TIMEOUT_MAX)):
            try:
                failed = name in self.absent and self.absent[name][0] is Status.UNAVAILABLE  # it is tried every 5 s
                if self._looked < asked and not failed:
                    self._sync()
            finally:
                self._busy.release()
        if name in (absent := self.absent):
            raise RefusedError(*absent[name])

    def _run(self) -> None:
        self._shelf.restore()
        self._shelf.settle()
        while not self._ended.is_set():
            self._news.clear()
            try:
                with self._busy:
                    self._sync()
            except Exception as error:  # whatever the map says, the next time it may make sense
                log.exception("the map's answer")
                self._complain(f"what the map service says makes no sense ({error!r})")
            self._ended.wait(LEAST_S)  # whoever publishes news without end does not keep both at it
            self._news.wait(RESYNC_S)

    def _sync(self) -> None:
        began = time.monotonic()
        try:
            theirs = self._map.ask(keys.SCENES, SceneRequest(), ScenesReply, ASK_S).scenes
        except (ClientError, DecodeError) as error:
            self._complain(str(error))
            return
        for name in set(self._shelf.facts()) - set(theirs):
            self._shelf.unload(name)
            self._on_gone(name)
            log.info("scene %s is gone", name)
        self._shelf.trouble = ""
        absent = {name: self._get(name, facts) for name, facts in theirs.items()}
        self.absent = {name: why for name, why in absent.items() if why is not None}
        self._complain("")
        self._looked = began
        building = {name for name, (status, _) in self.absent.items() if status is Status.BUILDING}
        if self._awaited is None:
            self._awaited = building
            self._on_synced()
        self._awaited = self._awaited & building

    def _get(self, name: str, facts: Mapping[str, Any]) -> tuple[Status, str] | None:
        """Let a scene of the map be here, too; why it is not, if it is not."""
        if not NAME.fullmatch(name):
            return Status.UNAVAILABLE, f"{name[:100]!r} is no name of a scene. Ask another planner."
        if facts["state"] == "building":
            return Status.BUILDING, f"scene {name!r} is being built. Ask again."
        if facts["state"] == "failed":
            return Status.BUILD_FAILED, f"scene {name!r}: {facts['error']}"
        if self._is_here(name, facts["version"], facts["digest"]):
            return None
        try:
            self._fetch(name, facts["version"], facts["digest"])
        except OSError as error:
            self._shelf.trouble = f"scene {name!r}: it cannot be kept ({error.strerror}). {MAKE_ROOM}"
            words = self._shelf.trouble
        except (ClientError, DecodeError, GpdfError) as error:  # the other scenes are not to wait
            words = f"scene {name!r} cannot be fetched: {public(str(error)).rstrip('.')}"
        else:
            return None
        log.warning("%s", words)
        return Status.UNAVAILABLE, f"{words}. Ask another planner."

    def _complain(self, trouble: str) -> None:
        if trouble and trouble != self.trouble:
            log.warning("not as the map service: %s", trouble)
        self.trouble = trouble

    def _is_here(self, name: str, version: int, digest: str) -> bool:
        entry = self._shelf.get(name)
        return entry is not None and (entry.facts.get("version"), entry.facts.get("digest")) == (version, digest)

    def _fetch(self, name: str, version: int, digest: str) -> None:
        """Get the file part by part, look whether it is whole, and put it on the shelf."""
        partial, began = self._files.folder / f".fetch-{name}", time.monotonic()
        try:
            self._receive(partial, name, version)
            scene = load_scene(partial)
            if scene.digest != digest:
                raise SceneFileError(name, f"its digest is {scene.digest}, the map service said {digest}", "Ask again.")
            path = self._files.path_of(name, version)
            partial.replace(path)
        finally:
            partial.unlink(missing_ok=True)
        self._shelf.place(name, scene, path)
        seconds = round(time.monotonic() - began, 3)
        log.info(
            "scene %s is fetched", name, extra={"version": version, "bytes": path.stat().st_size, "seconds": seconds}
        )

    def _receive(self, partial: Path, name: str, version: int) -> None:
        """All parts of a scene's file."""
        with partial.open("wb") as file:
            size = 1
            while file.tell() < size:
                request = FileRequest(scene=name, version=version, offset=file.tell())
                reply = self._map.ask(keys.SCENE_FILE, request, FileReply, ASK_S)
                if not reply.data:
                    raise SceneFileError(name, f"it ended after {file.tell()} of {reply.size} bytes", "Ask again.")
                file.write(reply.data)
                size = reply.size

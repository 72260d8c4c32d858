"""A planner's side of the map: fetch every ready scene in parts, keep it by version, follow what changes."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable

import zenoh
from gpdf_client import Client
from gpdf_client.results import ClientError
from gpdf_schemas import DecodeError, FileReply, FileRequest, SceneRequest, ScenesReply, keys

from gpdf_service.errors import GpdfError
from gpdf_service.scene import load_scene
from gpdf_service.service.scenes import Shelf

log = logging.getLogger(__name__)

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

    Attributes:
        synced: Whether the shelf was ever as the map's.
        trouble: Why it may be stale now; empty when all is well.
    """

    def __init__(self, session: zenoh.Session, shelf: Shelf, on_synced: Callable[[], None]) -> None:
        assert shelf.files is not None
        self._map, self._shelf, self._files = Client(session), shelf, shelf.files
        self._on_synced = on_synced
        self.synced, self.trouble = False, "the map service has not answered yet"
        self._news, self._ended = threading.Event(), threading.Event()
        self._busy = threading.Lock()
        self._looked = 0.0
        self._subscriber = session.declare_subscriber(keys.changed("*"), lambda _: self._news.set())
        self._thread = threading.Thread(target=self._run, name="gpdf-follow", daemon=True)

    def start(self) -> None:
        """Follow from now on."""
        self._thread.start()

    def close(self) -> None:
        """Follow no more."""
        self._ended.set()
        self._news.set()
        self._thread.join()

    def look_for(self, timeout_s: float) -> None:
        """Bring the shelf up to date; return when it is, or after `timeout_s`."""
        asked = time.monotonic()
        if self._busy.acquire(timeout=min(max(0.0, timeout_s), threading.TIMEOUT_MAX)):
            try:
                if self._looked < asked:  # nobody has looked since
                    self._sync()
            finally:
                self._busy.release()

    def _run(self) -> None:
        self._shelf.restore()
        self._shelf.settle()
        while not self._ended.is_set():
            self._news.clear()
            with self._busy:
                self._sync()
            self._news.wait(RESYNC_S)

    def _sync(self) -> None:
        began, troubles = time.monotonic(), list[str]()
        try:
            theirs = self._map.ask(keys.SCENES, SceneRequest(), ScenesReply, ASK_S).scenes
        except (ClientError, DecodeError) as error:
            self._complain(str(error))
            return
        for name in set(self._shelf.facts()) - set(theirs):
            self._shelf.unload(name)
            log.info("scene %s is gone", name)
        for name, facts in theirs.items():
            if facts["state"] == "ready" and not self._is_here(name, facts["version"], facts["digest"]):
                try:
                    self._fetch(name, facts["version"], facts["digest"])
                except (ClientError, DecodeError, GpdfError, OSError) as error:  # the other scenes are not to wait
                    troubles.append(f"scene {name!r}: {error}")
        self._complain(" ".join(troubles))
        self._looked = began
        if not self.synced:
            self.synced = True
            self._on_synced()

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
        with partial.open("wb") as file:
            size = 1
            while file.tell() < size:
                request = FileRequest(scene=name, version=version, offset=file.tell())
                reply = self._map.ask(keys.SCENE_FILE, request, FileReply, ASK_S)
                if not reply.data:
                    raise OSError(f"scene {name!r} ended after {file.tell()} of {reply.size} bytes")
                file.write(reply.data)
                size = reply.size
        scene = load_scene(partial)
        if scene.digest != digest:
            raise OSError(f"scene {name!r} came with digest {scene.digest}, the map service said {digest}")
        path = self._files.path_of(name, version)
        partial.replace(path)
        self._shelf.place(name, scene, path)
        seconds = round(time.monotonic() - began, 3)
        log.info("scene %s is fetched", name, extra={"version": version, "bytes": size, "seconds": seconds})

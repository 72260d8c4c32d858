"""The running service: an embedded Zenoh router, queryables that only hand over, workers that answer, a recorder."""

from __future__ import annotations

import json
import logging
import queue
import threading
import time
import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import TracebackType

import zenoh
from gpdf_schemas import PlanReply, Reply, Status, encode, keys

from gpdf_service.fields.threads import worker_count
from gpdf_service.scene import Scene
from gpdf_service.service.handlers import Handlers
from gpdf_service.service.recorder import Recorder
from gpdf_service.service.scenes import Shelf

log = logging.getLogger(__name__)

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
QUEUE_SIZE = 128
"""Requests waiting for a worker: half of what Zenoh holds before it blocks the link. Beyond, the answer is BUSY."""


@dataclass(frozen=True, slots=True)
class Options:
    """How to serve.

    Attributes:
        endpoint: Where to listen.
        scenes_dir: Folder of the files that clients may load.
        log_dir: Folder for the logs.
        workers: Threads that answer; the kernels release the GIL.
    """

    endpoint: str = DEFAULT_ENDPOINT
    scenes_dir: Path = Path("scenes")
    log_dir: Path = Path("log")
    workers: int = worker_count()


@dataclass(frozen=True, slots=True)
class _Job:
    query: zenoh.Query
    key: str
    payload: bytes
    received: float
    received_ns: int


class Server:
    """Map service and planner service in one process. A context manager: leaving it drains and closes the log.

    Args:
        options: How to serve.
        scenes: Names and files to load before the first request is taken.
    """

    def __init__(self, options: Options, scenes: Sequence[tuple[str, Path]] = ()) -> None:
        self.options, self._scenes = options, scenes
        self.planner_id = uuid.uuid4().hex[:12]
        options.log_dir.mkdir(parents=True, exist_ok=True)
        stamp = time.strftime("%Y%m%dT%H%M%S", time.gmtime())
        self.log_path = options.log_dir / f"gpdf_{stamp}_{self.planner_id}.mcap"
        metadata = {"planner": self.planner_id, "endpoint": options.endpoint, "workers": str(options.workers)}
        self.recorder = Recorder(self.log_path, metadata)
        self.shelf = Shelf(options.scenes_dir, self._on_ready)
        self.handlers = Handlers(self.shelf, self.planner_id)
        self._jobs: queue.Queue[_Job | None] = queue.Queue(QUEUE_SIZE)
        self._workers = [
            threading.Thread(target=self._work, name=f"gpdf-worker-{i}", daemon=True) for i in range(options.workers)
        ]
        self._session: zenoh.Session | None = None
        self._alive: zenoh.LivelinessToken | None = None

    def __enter__(self) -> Server:
        try:
            for name, path in self._scenes:  # before anybody can ask for them
                self.shelf.load_file(name, path, inside=False)
            self._session = zenoh.open(_router_config(self.options.endpoint))
        except BaseException:
            self.shelf.close()
            self.recorder.close()
            raise
        for worker in self._workers:
            worker.start()
        for key in self.handlers.by_key:
            self._session.declare_queryable(key, partial(self._take, key), complete=True)
        self._alive = self._session.liveliness().declare_token(  # dropped, it would be undeclared
            f"{keys.ALIVE}/{self.planner_id}"
        )
        log.info("listening on %s, logging to %s", self.options.endpoint, self.log_path)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for _ in self._workers:
            self._jobs.put(None)  # behind the requests that wait: they are answered first
        for worker in self._workers:
            worker.join()
        self.shelf.close()
        if self._session is not None:
            self._session.close()  # type: ignore[no-untyped-call]
        self.recorder.close()
        log.info("ended, log closed")

    def _on_ready(self, name: str, scene: Scene) -> None:
        self.recorder.scene(name, scene.points, scene.info())

    def _take(self, key: str, query: zenoh.Query) -> None:
        """Zenoh's callback: runs serially, so it only hands over; a full queue is answered here."""
        payload = query.payload.to_bytes() if query.payload is not None else b""
        job = _Job(query, key, payload, time.monotonic(), time.time_ns())
        try:
            self._jobs.put_nowait(job)
        except queue.Full:
            kind = self.handlers.by_key[key][1]
            words = f"{QUEUE_SIZE} requests are waiting. Ask again in a moment."
            self._reply(job, self.handlers.refuse(kind, Status.BUSY, words))

    def _work(self) -> None:
        while (job := self._jobs.get()) is not None:
            try:
                self._reply(job, self.handlers.answer(job.key, job.payload, job.received))
            except Exception:
                log.exception("reply on %s", job.key)

    def _reply(self, job: _Job, reply: Reply) -> None:
        data = encode(reply)
        stamp = time.time_ns()
        if job.key != keys.SCENE_DRAW:  # megabytes that the scene's digest, which is in the log, stands for
            self.recorder.exchange(job.key, job.payload, data, job.received_ns, stamp)
        with job.query:  # dropped after the reply, or the client waits for its time-out
            job.query.reply(job.key, data)
        if isinstance(reply, PlanReply):
            self.recorder.plan(reply, stamp)


def _router_config(endpoint: str) -> zenoh.Config:
    config = zenoh.Config()
    config.insert_json5("mode", '"router"')
    config.insert_json5("listen/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    return config

"""The running service: a Zenoh session, queryables that only hand over, workers that answer, a recorder."""

from __future__ import annotations

import gc
import json
import logging
import platform
import threading
import time
import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from types import TracebackType
from typing import Literal

import zenoh
from gpdf_schemas import (
    MAX_REQUEST_BYTES,
    MovingObstacles,
    Reply,
    SceneChanged,
    Status,
    StatusReply,
    TrajectoryCut,
    decode,
    encode,
    keys,
)
from gpdf_schemas.moving import stacked

from gpdf_service import __version__
from gpdf_service.config import Config
from gpdf_service.scene import Scene
from gpdf_service.service.builder import Builder
from gpdf_service.service.fair_queue import FairQueue
from gpdf_service.service.follower import Follower
from gpdf_service.service.handlers import Handlers
from gpdf_service.service.memory import TIDY_S
from gpdf_service.service.metrics import Metrics
from gpdf_service.service.network import session_config, set_up_threads
from gpdf_service.service.options import Options as Options
from gpdf_service.service.options import plain
from gpdf_service.service.outbox import Outbox
from gpdf_service.service.pool import Pool, Settings
from gpdf_service.service.prometheus import Endpoint
from gpdf_service.service.recorder import Recorder
from gpdf_service.service.scenes import NAME, Shelf
from gpdf_service.warm import Warming

log = logging.getLogger(__name__)

PACKAGES = ("numpy", "scipy", "numba", "eclipse-zenoh", "msgspec", "mcap")
"""Whose versions the log keeps beside our own: they can change an answer or its bytes."""
SENDERS = 64
"""Answers on their way, beside those that are made: who does not read them holds up nobody else."""
MAX_CLIENT_BYTES = 64
"""Of a client's name for itself beside its requests: four times a Zenoh id."""


@dataclass(frozen=True, slots=True)
class _Job:
    query: zenoh.Query
    key: str  # what is asked, one of `gpdf_schemas.keys`
    wire_key: str  # where it was asked: that, or a key of this planner alone
    payload: bytes
    received: float
    received_ns: int
    client: str = ""  # what it calls itself, in hexadecimal


class Server:
    """Map service, planner service, or both in one process. A context manager: leaving it drains and closes the log.

    Args:
        options: How to serve.
        scenes: Names and files to load before the first request is taken.
        config: Settings of what is built here.
    """

    def __init__(self, options: Options, scenes: Sequence[tuple[str, Path]] = (), config: Config | None = None) -> None:
        config = config or Config()
        self.options, self._scenes = options, scenes
        self.planner_id = uuid.uuid4().hex[:12]
        options.log_dir.mkdir(parents=True, exist_ok=True)
        self._builder = None if options.role == "planner" else Builder.of(options, config)
        self.shelf = Shelf(
            options.scenes_dir,
            self._on_ready,
            config,
            state_dir=options.state,
            memory_bytes=options.memory_bytes,
            spare_bytes=options.spare_bytes,
            build=None if self._builder is None else self._builder.build,
        )
        stamp = time.strftime("%Y%m%dT%H%M%S", time.gmtime())
        self.recorder = Recorder(options, f"{stamp}_{self.planner_id}", self._metadata(config))
        self.metrics = Metrics()
        self._epoch_ns = time.time_ns() - time.monotonic_ns()
        self._pool = self._make_pool()
        tell = self._on_unload, self._look_for, self._on_cut
        self.handlers = Handlers(self.shelf, self.planner_id, *tell, self._pool)
        self._jobs = FairQueue[_Job](options.queue)
        self._workers = [
            threading.Thread(target=self._work, name=f"gpdf-worker-{i}", daemon=True)
            for i in range(options.workers + SENDERS)
        ]
        self._outbox = Outbox()
        self._seats = threading.Semaphore(options.workers)  # of those that make answers
        self._ended = threading.Event()
        self._keeper = threading.Thread(target=self._keep_memory, name="gpdf-memory", daemon=True)
        self._warmed, self._loaded = threading.Event(), threading.Event()
        self._warmer = threading.Thread(target=self._warm_kernels, name="gpdf-warm", daemon=True)
        self._session: zenoh.Session | None = None
        self._endpoint: Endpoint | None = None  # for Prometheus
        self._follower: Follower | None = None
        self._tokens: list[zenoh.LivelinessToken] = []  # dropped, they would be undeclared
        self._queryables: list[zenoh.Queryable[None]] = []

    @property
    def state(self) -> Literal["configured", "warming", "active", "draining"]:
        """Where the service is in its life; once active, a plan takes what plans take, whatever is built beside."""
        if self._ended.is_set():
            return "draining"
        if not self._tokens and self._follower is None:
            return "configured"
        loaded = self._loaded.is_set() if self._follower is None else self._follower.complete
        warm = self._warmed.is_set() if self._pool is None else self._pool.ready
        return "active" if loaded and warm else "warming"

    @property
    def processes(self) -> list[int]:
        """The system's numbers of the processes that plan for this one."""
        return [] if self._pool is None else self._pool.pids

    @property
    def load(self) -> float:
        """Requests that wait or are at work, over the workers."""
        return self._jobs.unfinished / self.options.workers

    def __enter__(self) -> Server:
        try:
            if self._pool is not None:
                self._pool.start()
            if self._builder is not None:
                self._builder.start()
            self._outbox.start()
            set_up_threads()
            self._session = zenoh.open(session_config(self.options))  # a port that is taken is told before any work
            self._session.declare_queryable(keys.status_of(self.planner_id), self._answer_status, complete=True)
            if self.options.metrics_port:
                self._endpoint = Endpoint(self.options.metrics_port, self.status)
            if self.options.role != "planner":
                self._load_scenes()  # before anybody can ask for them
        except BaseException:
            self._close_parts()
            raise
        for thread in (*self._workers, self._keeper, self._warmer):
            thread.start()
        if self.options.role == "planner":
            self._follower = Follower(self._session, self.shelf, self._serve_plans, self._on_unload)
            self._follower.start()
        else:
            self._serve({key: key for key in self.handlers.map_keys}, f"{keys.MAP_ALIVE}/{self.planner_id}")
        if self.options.role == "both":
            self._serve_plans()
        words = {"role": self.options.role, "id": self.planner_id, "log": self.recorder.path.name}
        log.info("listening on %s", self.options.endpoint or ", ".join(self.options.connect), extra=words)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._ended.is_set():  # ended by hand, inside its own `with`
            return
        self._ended.set()
        self._close_doors()
        self._jobs.close()  # the requests that wait are answered first
        for thread in (*self._workers, self._keeper, self._warmer):
            thread.join()
        self._close_parts()
        log.info("ended, log closed")

    def _close_parts(self) -> None:
        """What is not built stays in the journal for the next start."""
        self._ended.set()
        if self._endpoint is not None:
            self._endpoint.close()
        if self._pool is not None:
            self._pool.close()
        if self._builder is not None:
            self._builder.close()
        if self._follower is not None:
            self._follower.close()
        self.handlers.in_use.close()
        self.shelf.close()
        self._outbox.close()
        if self._session is not None:
            self._session.close()  # type: ignore[no-untyped-call]
        self.recorder.close()

    def _close_doors(self) -> None:
        """Clients ask others from now on."""
        for token in self._tokens:
            token.undeclare()  # type: ignore[no-untyped-call]
        for queryable in self._queryables:
            queryable.undeclare()  # type: ignore[no-untyped-call]

    def _make_pool(self) -> Pool | None:
        """Processes that plan, where there are several cores to plan on."""
        options = self.options
        if not options.processes:
            return None
        return Pool(
            options.processes, Settings(self.planner_id, options.memory_bytes, options.log_format, options.bodies)
        )

    def _load_scenes(self) -> None:
        self.shelf.restore({name for name, _ in self._scenes})
        for name, path in self._scenes:
            self.shelf.load_file(name, path, inside=False)
        self.shelf.after_builds(self._loaded.set)

    def _serve_plans(self) -> None:
        """Begin to answer plans, on the key of all planners and on our own."""
        names = self.handlers.planner_keys
        own = {keys.of_planner(self.planner_id, key): key for key in names}
        assert self._session is not None
        self._session.declare_subscriber(keys.obstacles("*"), self._hear_of_obstacles)
        self.handlers.in_use.start()
        self._serve({**own, **{key: key for key in names}}, f"{keys.ALIVE}/{self.planner_id}")

    def _serve(self, wire_keys: Mapping[str, str], token: str) -> None:
        """Answer on each of the keys what is asked by the key behind it; then say that we are there."""
        assert self._session is not None
        for wire_key, key in wire_keys.items():
            take = partial(self._take, key, wire_key)
            self._queryables.append(self._session.declare_queryable(wire_key, take, complete=True))
        self._tokens.append(self._session.liveliness().declare_token(token))

    def _metadata(self, config: Config) -> dict[str, str]:
        """What a log must say of the process that wrote it."""
        versions = {name: version(name) for name in PACKAGES} | {"python": platform.python_version()}
        return {
            "planner": self.planner_id,
            "versions": json.dumps(versions),
            "config": json.dumps(plain(self.options, config)),
        }

    def _warm_kernels(self) -> None:
        """Load what plans run, where they run in this process; it is nobody's garbage, and no plan waits for a look."""
        if self.options.role != "map" and self._pool is None:
            Warming().plans()
            gc.freeze()
        self._warmed.set()

    def _on_ready(self, name: str, scene: Scene) -> None:
        self.recorder.scene(name, scene.points, scene.info())
        self._announce(SceneChanged(scene=name, version=scene.version, digest=scene.digest))
        entry = self.shelf.get(name)
        if self._pool is not None and entry is not None and entry.file is not None:
            self._pool.warm(name, str(entry.file))
        elif self.options.role != "map":
            for body in self.options.bodies:
                scene.prepare(body)

    def _on_unload(self, name: str) -> None:
        self.recorder.forget(name)
        if self._pool is not None:
            self._pool.forget(name)
        self._announce(SceneChanged(scene=name, version=0))

    def _on_cut(self, cut: TrajectoryCut) -> None:
        assert self._session is not None
        key, data = keys.cut(cut.scene), encode(cut)
        self._session.put(key, data)
        self.recorder.publication(key, data, self._stamp_ns(time.monotonic()))

    def _hear_of_obstacles(self, sample: zenoh.Sample) -> None:
        """Zenoh's callback: what was published on a scene's key; what cannot be read is told on stderr alone.

        Of a scene that nobody loaded it is kept, if not for long, but not recorded: strangers' names fill no disk.
        """
        key = str(sample.key_expr)
        scene = key.split("/")[-2]
        try:
            if not NAME.fullmatch(scene):
                raise ValueError("no scene can have that name")
            if len(sample.payload) > MAX_REQUEST_BYTES:
                raise ValueError(f"{len(sample.payload)} bytes, at most {MAX_REQUEST_BYTES} are taken")
            data = sample.payload.to_bytes()
            record = partial(self._record_moving, scene, key, data)
            self.handlers.moving.publish(scene, decode(data, MovingObstacles).obstacles, record)
        except ValueError as error:
            log.warning("obstacles on %s: %s", key[:200], error)
            self.metrics.count_bad_publication()
        self.handlers.in_use.look(scene)

    def _record_moving(self, scene: str, key: str, data: bytes, at: float) -> None:
        """A publication with the moment from which on plans know of it."""
        if self.shelf.get(scene) is None:
            return
        kept = self.recorder.evidence.publication(key, data)
        if kept is None:
            return
        self.recorder.publication(*kept, self._stamp_ns(at))
        if kept[0] == key and self.recorder.evidence.may_draw:
            points = stacked(list(self.handlers.moving.points(scene).values()))
            self.recorder.moving(scene, points, self._stamp_ns(at))

    def _stamp_ns(self, moment: float) -> int:
        """A moment of `time.monotonic` [s] for the log: one clock for all, which nobody sets while it runs."""
        return self._epoch_ns + round(1e9 * moment)

    def _announce(self, news: SceneChanged) -> None:
        if self._session is not None and self.options.role != "planner":
            self._session.put(keys.changed(news.scene), encode(news))

    def _look_for(self, name: str, timeout_s: float) -> None:
        if self._follower is not None:
            self._follower.look_for(name, timeout_s)

    def _take(self, key: str, wire_key: str, query: zenoh.Query) -> None:
        """Zenoh's callback: runs serially, so it only hands over; what is too long or too much is answered here."""
        body = query.payload or zenoh.ZBytes(b"")
        size, fits = len(body), len(body) <= MAX_REQUEST_BYTES
        payload = body.to_bytes() if fits else b""
        client, received = _name_of(query), time.monotonic()
        job = _Job(query, key, wire_key, payload, received, self._stamp_ns(received), client)
        if str(query.key_expr) != wire_key:  # a wildcard asks all that there is at once, and changes what it must not
            self._refuse(job, Status.INVALID_REQUEST, f"{str(query.key_expr)[:100]!r} is no key. Ask {wire_key}.")
            return
        if not fits:
            self._refuse(
                job, Status.INVALID_REQUEST, f"{size} bytes, at most {MAX_REQUEST_BYTES} are taken. Send it in parts."
            )
            return
        if (refused := self._jobs.put(job, client)) is None:
            return
        if self._ended.is_set():
            self._refuse(refused, Status.UNAVAILABLE, "this service ends. Ask another one.")
        else:
            self._refuse(refused, Status.BUSY, f"{self.options.queue} requests are waiting. Ask again in a moment.")

    def _refuse(self, job: _Job, status: Status, words: str) -> None:
        """Answer ahead of those that wait."""
        data = self.handlers.refuse(job.key, status, words, self.load)
        self._outbox.put(partial(self._reply, job, data, patient=False), job.client, len(job.query.payload or b""))

    def _work(self) -> None:
        """Make answers one after another; while one is sent, another thread has the seat."""
        while True:
            with self._seats:
                if (job := self._jobs.get()) is None:
                    return
                try:
                    data = self.handlers.answer(job.key, job.payload, job.received, self.load)
                finally:
                    self._jobs.done()
            try:
                with self._jobs.sending(job.client):
                    self._reply(job, data)
            except Exception:
                log.exception("reply on %s", job.key)

    def _reply(self, job: _Job, data: bytes, *, patient: bool = True) -> None:
        stamp, status = self._stamp_ns(time.monotonic()), decode(data, Reply).status
        kept = self.recorder.evidence.of(job.client, job.key, status, job.payload, data)
        if kept is not None:
            self.recorder.exchange(*kept, job.received_ns, stamp, patient=patient)
        self.metrics.count(status, time.monotonic() - job.received)  # who has the answer finds it counted
        with job.query:  # dropped after the reply, or the client waits for its time-out
            job.query.reply(job.wire_key, data)
        if job.key == keys.PLAN and kept is not None and kept[0] == keys.PLAN:
            self.recorder.plan(data, stamp)

    def _answer_status(self, query: zenoh.Query) -> None:
        """Answered past the queue: a service whose queue is full is asked first of all how it is."""

        def reply() -> None:
            with query:
                query.reply(keys.status_of(self.planner_id), encode(self.status()))

        self._outbox.put(reply, _name_of(query), len(query.payload or b""))

    def status(self) -> StatusReply:
        """Health, readiness and metrics now."""
        facts = self.shelf.facts()
        stopped = [one.name for one in self._workers if one.ident is not None and not one.is_alive()]
        problems = [f"the thread {name} has ended" for name in stopped]
        problems += [f"nothing is recorded: {self.recorder.trouble}"] if self.recorder.trouble else []
        losses = [self.shelf.trouble] if self.shelf.trouble else []
        losses += [f"what was acknowledged is lost: {words}" for words in self.shelf.lost]
        problems += losses
        if self.recorder.evidence.thrifty:
            problems.append("the log is full of what may not be deleted yet: bodies are recorded as hashes")
        problems += [f"scene {name!r}: {entry['error']}" for name, entry in facts.items() if entry["error"]]
        state, builders = self.state, [] if self._builder is None else self._builder.pids
        if self._follower is not None:
            problems += [f"the map may be stale: {self._follower.trouble}"] if self._follower.trouble else []
            problems += [words for status, words in self._follower.absent.values() if status is Status.UNAVAILABLE]
        return StatusReply(
            planner=self.planner_id,
            load=self.load,
            role=self.options.role,
            software=__version__,
            healthy=not (stopped or losses or self.recorder.trouble),
            state=state,
            ready=state == "active",
            problems=problems,
            metrics={
                **self.metrics.numbers([*self.processes, *builders]),
                "process_restarts": float(0 if self._pool is None else self._pool.restarts),
                "load": self.load,
                "workers": float(self.options.workers),
                "scenes": float(len(facts)),
                "scenes_in_memory": float(sum(entry["in_memory"] for entry in facts.values())),
                "messages_lost": float(self.recorder.lost),
            },
        )

    def _keep_memory(self) -> None:
        while not self._ended.wait(TIDY_S):
            self.shelf.trim()
            self.shelf.try_again()


def _name_of(query: zenoh.Query) -> str:
    """What who asks calls itself, in hexadecimal."""
    sender = query.attachment
    return "" if sender is None else sender.to_bytes()[:MAX_CLIENT_BYTES].hex()

"""The client, synchronous and asyncio."""

from __future__ import annotations

import asyncio
import json
import math
import os
import random
import time
import uuid
from collections.abc import Callable, Collection, Sequence
from types import TracebackType
from typing import Any, TypeVar

import gpdf_schemas
import msgspec
import numpy as np
import zenoh
from gpdf_schemas import (
    Array,
    DistanceReply,
    DistanceRequest,
    DrawReply,
    DrawRequest,
    LoadRequest,
    MovingObstacle,
    MovingObstacles,
    PlanReply,
    PlanRequest,
    Reply,
    SceneReply,
    SceneRequest,
    ScenesReply,
    Status,
    StatusReply,
    UploadRequest,
    decode,
    encode,
    keys,
)
from numpy.typing import ArrayLike

from gpdf_client.planners import Planners
from gpdf_client.results import (
    ClientError,
    DecodeError,
    Distances,
    Drawing,
    InvalidRequestError,
    PlanResult,
    ServiceBusyError,
    ServiceError,
    UnavailableError,
    raise_for,
    to_drawing,
    to_result,
    unpack,
)

DEFAULT_ENDPOINT = os.environ.get("GPDF_ENDPOINT") or "tcp/127.0.0.1:7447"
BACK_OFF_S = 0.05
"""[s] Between tries when nobody answers or the service is busy."""
LONGEST_S = 3600.0
"""[s] The longest that one try waits; Zenoh takes a time-out that overflows its clock for a negative one."""
TRY_S = 5.0
"""[s] Before a plan is asked of another planner: several times what the slowest takes, once its free space is built."""
LATER = (Status.BUSY, Status.UNAVAILABLE)
"""Answers after which to ask again: a full queue, a service that is about to end."""
PART_POINTS = 40_000
"""Points in one part of an upload: 1 MB as f8, which keeps small queries quick beside it."""

R = TypeVar("R", bound=Reply)
Progress = Callable[[float], None]
Agent = str | dict[str, Any]


def client_config(endpoint: str) -> zenoh.Config:
    """Zenoh's configuration of a client that talks to `endpoint` and looks for nobody else."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    return config


class Client:
    """One connection to a planning service; may be shared between threads.

    Use it as a context manager. Every call raises `UnavailableError` when nobody answers in time, and a
    `ServiceError` with the service's own words when the service refuses.
    """

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._planners = Planners(session, random.Random())
        self._watchers: list[zenoh.Subscriber[Any]] = []  # dropped, they would end

    @classmethod
    def connect(
        cls, endpoint: str = DEFAULT_ENDPOINT, *, timeout_s: float = 5.0, config: zenoh.Config | None = None
    ) -> Client:
        """Connect to a service's endpoint; tried again until `timeout_s` has passed.

        Args:
            endpoint: Zenoh locator of the service or of a router that leads to it.
            timeout_s: Seconds to wait for it.
            config: A Zenoh configuration of your own (credentials, certificates); `endpoint` is not looked at then.

        Raises:
            UnavailableError: nothing listens there.
        """
        config = config or client_config(endpoint)
        until = time.monotonic() + timeout_s
        while True:
            try:
                return cls(zenoh.open(config))
            except zenoh.ZError as error:
                if time.monotonic() > until:
                    raise UnavailableError(f"no service at {endpoint} ({error}). Start one: gpdf serve …") from error
                time.sleep(BACK_OFF_S)

    @property
    def session(self) -> zenoh.Session:
        """The Zenoh session, to publish and subscribe beside the service's requests."""
        return self._session

    def close(self) -> None:
        """End the connection."""
        self._session.close()  # type: ignore[no-untyped-call]

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def plan(
        self,
        scene: str,
        start: Sequence[float],
        goal: Sequence[float],
        agent: Agent = "human",
        *,
        method: str = "dual_gpdf",
        deadline_s: float = 30.0,
        request_id: str = "",
        obstacles: Sequence[MovingObstacle] = (),
    ) -> PlanResult:
        """Ask for a trajectory from `start` to `goal`, (x, y) or (x, y, z of the ground) [m], clear of `obstacles`.

        `method` is "dual_gpdf", or one of the paper's baselines for comparison: "single_gpdf", "astar", "prm".
        """
        request = PlanRequest(
            scene=scene,
            start=[float(v) for v in start],
            goal=[float(v) for v in goal],
            agent=agent,
            method=method,
            deadline_s=deadline_s,
            request_id=request_id,
            obstacles=list(obstacles),
        )
        return to_result(self.ask_planner(keys.PLAN, request, PlanReply, deadline_s))

    def publish_obstacles(self, scene: str, obstacles: Sequence[MovingObstacle]) -> None:
        """Tell every planner what moves in a scene; nobody answers, and what is not told again ends by itself."""
        self._session.put(keys.obstacles(scene), encode(MovingObstacles(obstacles=list(obstacles))))

    def distance(
        self, scene: str, field: str, points: ArrayLike, agent: Agent = "human", *, deadline_s: float = 30.0
    ) -> Distances:
        """Ask the "ground" field at points (m, 3), or the "obstacle" field of an agent at (m, 2) or (m, 3) [m]."""
        packed = Array.pack(np.asarray(points))
        request = DistanceRequest(scene=scene, field=field, points=packed, agent=agent, deadline_s=deadline_s)
        reply = self.ask_planner(keys.DISTANCE, request, DistanceReply, deadline_s)
        if reply.distance is None or reply.gradient is None or reply.valid is None:
            raise ServiceError(reply)
        parts = unpack(reply.distance), unpack(reply.gradient), unpack(reply.valid) > 0
        return Distances(*parts, reply.scene_version)

    def draw(
        self,
        scene: str,
        what: str,
        agent: Agent = "human",
        *,
        limit: int = 300_000,
        progress: Progress = lambda share: None,
    ) -> Drawing:
        """Fetch what a picture shows: "cloud", "ground", or the "obstacles" or free "leaves" of an agent.

        Args:
            scene: Name of a loaded scene.
            what: What to draw.
            agent: The body, for obstacles and leaves.
            limit: Most places to fetch; points are thinned evenly, of the leaves the largest are kept.
            progress: Told the share that is there.
        """
        replies: list[DrawReply] = []
        while not replies or len(replies) < replies[0].parts:
            request = DrawRequest(scene=scene, what=what, agent=agent, limit=limit, part=len(replies))
            reply = self.ask(keys.SCENE_DRAW, request, DrawReply, request.deadline_s)
            if replies and reply.scene_version != replies[0].scene_version:  # the scene was replaced meanwhile
                replies = []
                continue
            replies.append(reply)
            progress(len(replies) / reply.parts)
        return to_drawing(replies)

    def scenes(self) -> dict[str, dict[str, Any]]:
        """Facts of every scene by name."""
        return self.ask(keys.SCENES, SceneRequest(), ScenesReply, 30.0).scenes

    def info(self, scene: str) -> dict[str, Any]:
        """Facts of one scene."""
        return self.ask(keys.SCENE_INFO, SceneRequest(scene=scene), SceneReply, 30.0).info

    def unload_scene(self, scene: str) -> None:
        """Let the service forget a scene."""
        self.ask(keys.SCENE_UNLOAD, SceneRequest(scene=scene), SceneReply, 30.0)

    def load_scene(
        self,
        name: str,
        file: str | None = None,
        *,
        upload: ArrayLike | None = None,
        ground: ArrayLike | None = None,
        timeout_s: float = 300.0,
        progress: Progress = lambda share: None,
    ) -> dict[str, Any]:
        """Load a file of the service's scenes folder, or send points; returns the scene's facts when it is ready.

        Args:
            name: Name to give it; a scene of that name is replaced when the new one is ready.
            file: A file's name in the service's scenes folder.
            upload: Points (n, 3) [m] to send instead.
            ground: Which of them are ground (n,), if known.
            timeout_s: Seconds to wait until it is ready.
            progress: Told the share of the upload that is done.
        """
        if (file is None) == (upload is None):
            raise ValueError("load_scene takes either file= or upload=")
        if file is not None:
            self.ask(keys.SCENE_LOAD, LoadRequest(scene=name, file=file), SceneReply, 30.0, {Status.BUILDING})
        else:
            self._upload(name, np.asarray(upload, dtype=np.float64), ground, progress)
        return self.wait_for_scene(name, timeout_s=timeout_s)

    def _upload(self, name: str, points: np.ndarray[Any, Any], ground: ArrayLike | None, progress: Progress) -> None:
        labels = None if ground is None else np.asarray(ground, dtype=np.float32)
        parts = max(1, -(-len(points) // PART_POINTS))
        upload_id = uuid.uuid4().hex
        for part in range(parts):
            rows = slice(part * PART_POINTS, (part + 1) * PART_POINTS)
            request = UploadRequest(
                scene=name,
                upload_id=upload_id,
                part=part,
                parts=parts,
                points=Array.pack(points[rows]),
                ground=None if labels is None else Array.pack(labels[rows], "f4"),
            )
            self.ask(keys.SCENE_UPLOAD, request, SceneReply, 30.0, {Status.BUILDING})
            progress((part + 1) / parts)

    def wait_for_scene(self, name: str, *, timeout_s: float = 300.0) -> dict[str, Any]:
        """Wait until a scene is ready; its facts.

        Raises:
            ServiceError: the build failed, or the scene is unknown.
            UnavailableError: it was not ready in time.
        """
        until = time.monotonic() + timeout_s
        while time.monotonic() < until:
            reply = self.ask(keys.SCENE_INFO, SceneRequest(scene=name), SceneReply, 30.0, {Status.BUILDING})
            if reply.status is Status.OK:
                return reply.info
            time.sleep(BACK_OFF_S)
        raise UnavailableError(f"scene {name!r} was not ready after {timeout_s:.0f} s. Wait longer.")

    def status(self, *, timeout_s: float = 5.0) -> list[StatusReply]:
        """Health, readiness and metrics of every service that answers."""
        answers = self._session.get(
            keys.status_of("*"),
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=timeout_s,
        )
        found = [decode(answer.ok.payload.to_bytes(), StatusReply) for answer in answers if answer.ok is not None]
        return sorted(found, key=lambda reply: (reply.role, reply.planner))

    def wait_for_service(self, *, timeout_s: float = 30.0) -> None:
        """Wait until a service answers."""
        self.ask(keys.SCENES, SceneRequest(), ScenesReply, timeout_s)

    def watch(self, on_change: Callable[[str, bool], None]) -> None:
        """Hear of services that come and go, also of those that are there already.

        Args:
            on_change: Told a service's id and whether it is there, on a thread of Zenoh's; it must return soon. Zenoh
                finds a service again by itself when it comes back at the same endpoint.
        """

        def hear(sample: zenoh.Sample) -> None:
            on_change(str(sample.key_expr).rsplit("/", 1)[-1], sample.kind == zenoh.SampleKind.PUT)

        liveliness = self._session.liveliness()
        self._watchers.append(liveliness.declare_subscriber(f"{keys.ALIVE}/*", hear, history=True))

    def ask(
        self,
        key: str,
        request: msgspec.Struct,
        kind: type[R],
        deadline_s: float,
        fine: Collection[Status] = (),
    ) -> R:
        """One request and its reply; asked again while nobody answers or the queue is full.

        Every try carries the same `request_id`, so that whoever answers can tell a repetition from a new request.

        Args:
            key: One of `gpdf_schemas.keys`.
            request: Its message; it gets a `request_id` if it has none.
            kind: The type of its reply.
            deadline_s: Seconds to keep asking.
            fine: Statuses that are no failure to the caller, though they would be to others.

        Raises:
            UnavailableError: nobody answered in time.
            DecodeError: the answer is not the message that it should be.
            ServiceError: the service refused.
        """
        payload, until = encode(_checked(request, deadline_s)), time.monotonic() + deadline_s
        answer: Reply | None = None
        while (left := until - time.monotonic()) > 0:
            answer = self._try(key, payload, kind, left) or answer
            if answer is not None and answer.status not in LATER:
                return self._fine(answer, fine)  # type: ignore[return-value]
            time.sleep(BACK_OFF_S)
        raise _late(key, deadline_s, answer)

    def ask_planner(self, key: str, request: msgspec.Struct, kind: type[R], deadline_s: float) -> R:
        """One request to whichever planner is least loaded; to another one if it dies, freezes or is busy.

        Args:
            key: What all planners answer: `keys.PLAN` or `keys.DISTANCE`.
            request: Its message.
            kind: The type of its reply.
            deadline_s: Seconds to keep asking.
        """
        payload, until = encode(_checked(request, deadline_s)), time.monotonic() + deadline_s
        answer: Reply | None = None
        tried: set[str] = set()
        while (left := until - time.monotonic()) > 0:
            planner = self._planners.pick(tried)
            if planner is None and tried:  # everybody had a turn
                tried.clear()
                time.sleep(BACK_OFF_S)
                continue
            others = len(self._planners.alive()) > 1
            where = key if planner is None else keys.of_planner(planner, key)  # none known: whoever answers for all
            found = self._try(where, payload, kind, min(left, TRY_S) if others else left)
            if found is not None:
                self._planners.learn(found.planner, found.load)
                answer = found
                if found.status not in LATER:
                    return self._fine(found, ())
            if planner is None:
                time.sleep(BACK_OFF_S)
            else:
                tried.add(planner)
        raise _late(key, deadline_s, answer)

    def _try(self, key: str, payload: bytes, kind: type[R], timeout_s: float) -> R | None:
        """Ask once; None if nobody answered."""
        for answer in self._session.get(key, payload=payload, timeout=min(timeout_s, LONGEST_S)):
            if answer.ok is not None:  # not Zenoh's own time-out
                return _decode(answer.ok.payload.to_bytes(), kind)
        return None

    @staticmethod
    def _fine(reply: R, fine: Collection[Status]) -> R:
        if reply.status not in fine:
            raise_for(reply)
        return reply


def _late(key: str, deadline_s: float, answer: Reply | None) -> ClientError:
    """Nobody answered in time, or all were busy all the time."""
    if answer is not None and answer.status is Status.BUSY:
        return ServiceBusyError(answer)
    return UnavailableError(f"no answer on {key} within {deadline_s:.1f} s. Is the service running?")


def _checked(request: msgspec.Struct, deadline_s: float) -> msgspec.Struct:
    """The request with an id, so that it is the same one in every try."""
    if not 0 < deadline_s < math.inf:
        words = f"deadline_s = {deadline_s}. Give a positive, finite number of seconds."
        raise InvalidRequestError(Reply(status=Status.INVALID_REQUEST, message=words))
    if not getattr(request, "request_id", ""):
        request = msgspec.structs.replace(request, request_id=uuid.uuid4().hex)
    return request


def _decode(data: bytes, kind: type[R]) -> R:
    try:
        return decode(data, kind)
    except gpdf_schemas.DecodeError as error:
        raise DecodeError(str(error)) from error


class AsyncClient:
    """`Client` for asyncio: the same calls, awaited; each runs in a thread, so the event loop is never blocked."""

    def __init__(self, client: Client) -> None:
        self.sync = client

    @classmethod
    async def connect(
        cls, endpoint: str = DEFAULT_ENDPOINT, *, timeout_s: float = 5.0, config: zenoh.Config | None = None
    ) -> AsyncClient:
        """See `Client.connect`."""
        return cls(await asyncio.to_thread(Client.connect, endpoint, timeout_s=timeout_s, config=config))

    async def close(self) -> None:
        """See `Client.close`."""
        await asyncio.to_thread(self.sync.close)

    async def __aenter__(self) -> AsyncClient:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def plan(
        self,
        scene: str,
        start: Sequence[float],
        goal: Sequence[float],
        agent: Agent = "human",
        *,
        method: str = "dual_gpdf",
        deadline_s: float = 30.0,
        request_id: str = "",
    ) -> PlanResult:
        """See `Client.plan`."""
        return await asyncio.to_thread(
            self.sync.plan, scene, start, goal, agent, method=method, deadline_s=deadline_s, request_id=request_id
        )

    async def distance(
        self, scene: str, field: str, points: ArrayLike, agent: Agent = "human", *, deadline_s: float = 30.0
    ) -> Distances:
        """See `Client.distance`."""
        return await asyncio.to_thread(self.sync.distance, scene, field, points, agent, deadline_s=deadline_s)

    async def scenes(self) -> dict[str, dict[str, Any]]:
        """See `Client.scenes`."""
        return await asyncio.to_thread(self.sync.scenes)

    async def info(self, scene: str) -> dict[str, Any]:
        """See `Client.info`."""
        return await asyncio.to_thread(self.sync.info, scene)

    async def load_scene(
        self,
        name: str,
        file: str | None = None,
        *,
        upload: ArrayLike | None = None,
        ground: ArrayLike | None = None,
        timeout_s: float = 300.0,
        progress: Progress = lambda share: None,
    ) -> dict[str, Any]:
        """See `Client.load_scene`; `progress` is called from another thread."""
        return await asyncio.to_thread(
            self.sync.load_scene, name, file, upload=upload, ground=ground, timeout_s=timeout_s, progress=progress
        )

    async def unload_scene(self, scene: str) -> None:
        """See `Client.unload_scene`."""
        await asyncio.to_thread(self.sync.unload_scene, scene)

    async def wait_for_scene(self, name: str, *, timeout_s: float = 300.0) -> dict[str, Any]:
        """See `Client.wait_for_scene`."""
        return await asyncio.to_thread(self.sync.wait_for_scene, name, timeout_s=timeout_s)

    async def wait_for_service(self, *, timeout_s: float = 30.0) -> None:
        """See `Client.wait_for_service`."""
        await asyncio.to_thread(self.sync.wait_for_service, timeout_s=timeout_s)

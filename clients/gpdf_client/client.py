"""The client, synchronous and asyncio."""

from __future__ import annotations

import asyncio
import json
import time
import uuid
from collections.abc import Callable, Collection, Sequence
from types import TracebackType
from typing import Any, TypeVar

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
    PlanReply,
    PlanRequest,
    Reply,
    SceneReply,
    SceneRequest,
    ScenesReply,
    Status,
    UploadRequest,
    decode,
    encode,
    keys,
)
from numpy.typing import ArrayLike

from gpdf_client.results import (
    Distances,
    Drawing,
    PlanResult,
    ServiceError,
    UnavailableError,
    raise_for,
    to_drawing,
    to_result,
)

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
BACK_OFF_S = 0.05
"""[s] Between tries when nobody answers or the service is busy."""
PART_POINTS = 40_000
"""Points in one part of an upload: 1 MB as f8, which keeps small queries quick beside it."""

R = TypeVar("R", bound=Reply)
Progress = Callable[[float], None]
Agent = str | dict[str, Any]


class Client:
    """One connection to a planning service; may be shared between threads.

    Use it as a context manager. Every call raises `UnavailableError` when nobody answers in time, and a
    `ServiceError` with the service's own words when the service refuses.
    """

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
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
        if config is None:
            config = zenoh.Config()
            config.insert_json5("mode", '"client"')
            config.insert_json5("connect/endpoints", json.dumps([endpoint]))
            config.insert_json5("scouting/multicast/enabled", "false")
        until = time.monotonic() + timeout_s
        while True:
            try:
                return cls(zenoh.open(config))
            except zenoh.ZError as error:
                if time.monotonic() > until:
                    raise UnavailableError(f"no service at {endpoint} ({error}). Start one: gpdf serve …") from error
                time.sleep(BACK_OFF_S)

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
    ) -> PlanResult:
        """Ask for a trajectory from `start` to `goal`, (x, y) or (x, y, z of the ground) [m]."""
        request = PlanRequest(
            scene=scene,
            start=[float(v) for v in start],
            goal=[float(v) for v in goal],
            agent=agent,
            method=method,
            deadline_s=deadline_s,
            request_id=request_id or uuid.uuid4().hex,
        )
        return to_result(self.ask(keys.PLAN, request, PlanReply, deadline_s))

    def distance(self, scene: str, field: str, points: ArrayLike, agent: Agent = "human") -> Distances:
        """Ask the "ground" field at points (m, 3), or the "obstacle" field of an agent at (m, 2) or (m, 3) [m]."""
        request = DistanceRequest(scene=scene, field=field, points=Array.pack(np.asarray(points)), agent=agent)
        reply = self.ask(keys.DISTANCE, request, DistanceReply, request.deadline_s)
        if reply.distance is None or reply.gradient is None or reply.valid is None:
            raise ServiceError(reply)
        return Distances(reply.distance.unpack(), reply.gradient.unpack(), reply.valid.unpack() > 0)

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

        Args:
            key: One of `gpdf_schemas.keys`.
            request: Its message.
            kind: The type of its reply.
            deadline_s: Seconds to keep asking.
            fine: Statuses that are no failure to the caller, though they would be to others.
        """
        payload, until = encode(request), time.monotonic() + deadline_s
        busy: Reply | None = None
        while (left := until - time.monotonic()) > 0:
            for answer in self._session.get(key, payload=payload, timeout=left):
                if answer.ok is None:
                    continue  # Zenoh's own time-out
                reply = decode(answer.ok.payload.to_bytes(), kind)
                if reply.status is Status.BUSY:
                    busy = reply
                    break
                if reply.status not in fine:
                    raise_for(reply)
                return reply
            time.sleep(BACK_OFF_S)
        if busy is not None:
            raise_for(busy)
        raise UnavailableError(f"no answer on {key} within {deadline_s:.1f} s. Is the service running?")


class AsyncClient:
    """`Client` for asyncio: the same calls, awaited; each runs in a thread, so the event loop is never blocked."""

    def __init__(self, client: Client) -> None:
        self.sync = client

    @classmethod
    async def connect(cls, endpoint: str = DEFAULT_ENDPOINT, *, timeout_s: float = 5.0) -> AsyncClient:
        """See `Client.connect`."""
        return cls(await asyncio.to_thread(Client.connect, endpoint, timeout_s=timeout_s))

    async def __aenter__(self) -> AsyncClient:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await asyncio.to_thread(self.sync.close)

    async def plan(
        self,
        scene: str,
        start: Sequence[float],
        goal: Sequence[float],
        agent: Agent = "human",
        **options: Any,  # noqa: ANN401
    ) -> PlanResult:
        """See `Client.plan`."""
        return await asyncio.to_thread(self.sync.plan, scene, start, goal, agent, **options)

    async def distance(self, scene: str, field: str, points: ArrayLike, agent: Agent = "human") -> Distances:
        """See `Client.distance`."""
        return await asyncio.to_thread(self.sync.distance, scene, field, points, agent)

    async def scenes(self) -> dict[str, dict[str, Any]]:
        """See `Client.scenes`."""
        return await asyncio.to_thread(self.sync.scenes)

    async def load_scene(self, name: str, file: str | None = None, **options: Any) -> dict[str, Any]:  # noqa: ANN401
        """See `Client.load_scene`."""
        return await asyncio.to_thread(lambda: self.sync.load_scene(name, file, **options))

    async def unload_scene(self, scene: str) -> None:
        """See `Client.unload_scene`."""
        await asyncio.to_thread(self.sync.unload_scene, scene)

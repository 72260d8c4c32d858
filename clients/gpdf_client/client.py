"""The client, synchronous and asyncio."""

from __future__ import annotations

import asyncio
import atexit
import contextlib
import json
import math
import os
import random
import re
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
    MAX_REQUEST_BYTES,
    Array,
    DistanceReply,
    DistanceRequest,
    DrawReply,
    DrawRequest,
    LoadRequest,
    MovingObstacle,
    MovingObstacles,
    PlaceRequest,
    PlacesReply,
    PlanReply,
    PlanRequest,
    Reply,
    SceneChanged,
    SceneReply,
    SceneRequest,
    ScenesReply,
    Status,
    StatusReply,
    TrajectoryCut,
    UpdateRequest,
    UploadRequest,
    decode,
    encode,
    keys,
)
from gpdf_schemas.moving import MAX_POINTS, FloatArray, points_of
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
    UnknownPlaceError,
    raise_for,
    to_drawing,
    to_result,
    unpack,
)
from gpdf_client.trajectory import Trajectory

DEFAULT_ENDPOINT = os.environ.get("GPDF_ENDPOINT") or "tcp/127.0.0.1:7447"
LEASE_MS = 2_000
"""[ms] A frozen process, or a cut link, counts as dead after this; a process that is killed, at once."""
PLACE_IN_ZENOH = re.compile(r"\s+at /\S+\.rs:\d+")
"""Where in its sources Zenoh met an error: it stands in the middle of the error's words."""
RETRY = {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 2}
"""Between tries of Zenoh to connect again: a link that comes back is found within half a second."""
BACK_OFF_S = 0.05
"""[s] Between tries when nobody answers or the service is busy."""
LONGEST_S = 3600.0
"""[s] The longest that one try waits; Zenoh takes a time-out that overflows its clock for a negative one."""
PROBE_S = 1.0
"""[s] To find out whether a service is there that did not answer."""
TRY_S = 5.0
"""[s] Before a plan is asked of another planner: several times what the slowest takes, once its free space is built."""
LATER = (Status.BUSY, Status.UNAVAILABLE)
"""Answers after which to ask again: a full queue, a service that is about to end."""
PART_POINTS = 40_000
"""Points in one part of an upload: 1 MB as f8, which keeps small queries quick beside it."""

R = TypeVar("R", bound=Reply)
T = TypeVar("T")
Progress = Callable[[float], None]
Agent = str | dict[str, Any]
Place = str | Sequence[float]
"""A named place of the scene, or (x, y) or (x, y, z of the ground there) [m]."""


def client_config(endpoint: str) -> zenoh.Config:
    """Zenoh's configuration of a client that talks to `endpoint` and looks for nobody else."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    try:
        config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    except zenoh.ZError as error:
        raise UnavailableError(f"{endpoint!r} is no endpoint. Give one like tcp/127.0.0.1:7447.") from error
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("transport/shared_memory/enabled", "false")  # its pool is a third of a light client's memory
    config.insert_json5("transport/link/tx/lease", json.dumps(LEASE_MS))
    config.insert_json5("connect/retry", json.dumps(RETRY))
    return config


class Client:
    """One connection to a planning service; may be shared between threads.

    Use it as a context manager. Every call raises `UnavailableError` when nobody answers in time, and a
    `ServiceError` with the service's own words when the service refuses.
    """

    def __init__(self, session: zenoh.Session) -> None:
        self._session, self._id = session, str(session.info.zid())  # by its id the service is fair between clients
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
            UnavailableError: nothing listens there, or it is no endpoint.
        """
        if config is None:
            config = client_config(endpoint)
        else:
            endpoint = config.get_json("connect/endpoints")
        until = time.monotonic() + timeout_s
        while True:
            try:
                session = zenoh.open(config)
            except zenoh.ZError as error:
                if time.monotonic() > until:
                    why = PLACE_IN_ZENOH.sub("", str(error)).rstrip("!. ")
                    raise UnavailableError(f"no service at {endpoint} ({why}). Start one: gpdf serve …") from error
                time.sleep(BACK_OFF_S)
            else:
                client = cls(session)
                atexit.register(client.close)  # an interpreter that ends before its session hangs
                return client

    @property
    def session(self) -> zenoh.Session:
        """The Zenoh session, to publish and subscribe beside the service's requests."""
        return self._session

    def close(self) -> None:
        """End the connection."""
        atexit.unregister(self.close)
        self._session.close()  # type: ignore[no-untyped-call]
        self._planners.join()

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def plan(
        self,
        scene: str,
        start: Place,
        goal: Place,
        agent: Agent = "human",
        *,
        method: str = "dual_gpdf",
        via: Sequence[Place] = (),
        other_goals: Sequence[Place] = (),
        snap: float = 0.0,
        warm_start: Trajectory | None = None,
        start_heading: float | None = None,
        goal_heading: float | None = None,
        prefer: str | None = None,
        alternatives: int = 0,
        deadline_s: float = 30.0,
        request_id: str = "",
        obstacles: Sequence[MovingObstacle] = (),
    ) -> PlanResult:
        """Ask for a trajectory from `start` to `goal`, clear of `obstacles`.

        Args:
            scene: Name of a loaded scene.
            start: Where the body is: (x, y) or (x, y, z of the ground) [m], or the name of one of the scene's places.
            goal: Where it wants to be, in the same way.
            agent: A name, or measures; with `discs`, the body faces where it goes and passes narrow doors.
            method: "dual_gpdf", or one of the paper's baselines for comparison: "single_gpdf", "astar", "prm".
            via: Places that the path goes through, in this order, in the same way.
            other_goals: More goals, in the same way; the one with the shortest way is taken, `details["goal"]` is its
                number.
            snap: How far a place where the body cannot be may be moved to the nearest one where it can [m]; `message`
                says it.
            warm_start: The trajectory that the body follows now: taken up if it is still clear and ends near the goal.
            start_heading: Where a body of discs faces at the start [rad], to turn there if it must; free if None.
            goal_heading: The same at the goal.
            prefer: "quickest", "level" or "wide"; None for the way that a sighted companion would take.
            alternatives: How many more ways are wanted that differ.
            deadline_s: Seconds that the answer may take.
            request_id: Chosen by the caller, or made here.
            obstacles: What else is in the way, for this plan alone.
        """
        request = PlanRequest(
            scene=scene,
            start=self.where(scene, start),
            goal=self.where(scene, goal),
            agent=agent,
            method=method,
            via=[self.where(scene, place) for place in via],
            other_goals=[self.where(scene, place) for place in other_goals],
            snap=float(snap),
            warm_start=None if warm_start is None else Array.pack(warm_start.ground),
            start_heading=start_heading,
            goal_heading=goal_heading,
            prefer=prefer or "",
            alternatives=alternatives,
            deadline_s=deadline_s,
            request_id=request_id,
            obstacles=list(obstacles),
        )
        return to_result(self.ask_planner(keys.PLAN, request, PlanReply, deadline_s))

    def publish_obstacles(self, scene: str, obstacles: Sequence[MovingObstacle]) -> None:
        """Tell every planner and guide what moves in a scene; what is not told again ends by itself.

        Nobody answers, so what no service would take is refused here.

        Raises:
            InvalidRequestError: an obstacle has no sense, or all together are too many points or bytes.
        """
        self._session.put(keys.obstacles(scene), _publishable(scene, obstacles))

    def watch_cuts(self, scene: str, on_cut: Callable[[TrajectoryCut], None]) -> None:
        """Hear of trajectories that something that moves has cut; compare `request_id` with your plan's.

        Args:
            scene: Name of the scene.
            on_cut: Told each one, on a thread of Zenoh's, again while it lasts; it must return soon.
        """
        self._subscribe(keys.cut(scene), TrajectoryCut, on_cut)

    def distance(
        self, scene: str, field: str, points: ArrayLike, agent: Agent = "human", *, deadline_s: float = 30.0
    ) -> Distances:
        """Ask the "ground" field at points (m, 3), or the "obstacle" field of an agent at (m, 2) or (m, 3) [m]."""
        packed = Array.pack(np.asarray(points))
        request = DistanceRequest(scene=scene, field=field, points=packed, agent=agent, deadline_s=deadline_s)
        reply = self.ask_planner(keys.DISTANCE, request, DistanceReply, deadline_s)
        if reply.distance is None or reply.gradient is None or reply.valid is None:
            raise ServiceError(reply)
        distance, valid = unpack(reply.distance), unpack(reply.valid) > 0
        deviation = np.where(valid, np.inf if reply.deviation is None else unpack(reply.deviation), np.inf)
        return Distances(distance, unpack(reply.gradient), valid, deviation, reply.scene_version)

    def draw(
        self,
        scene: str,
        what: str,
        agent: Agent = "human",
        *,
        limit: int = 300_000,
        near: ArrayLike | None = None,
        reach: float = 0.0,
        progress: Progress = lambda share: None,
    ) -> Drawing:
        """Fetch what a picture shows: "cloud", "ground", or the "obstacles" or free "leaves" of an agent.

        Args:
            scene: Name of a loaded scene.
            what: What to draw.
            agent: The body, for obstacles and leaves.
            limit: Most places to fetch; points are thinned evenly, of the leaves the largest are kept.
            near: Places (k, 2) or (k, 3) [m], as of a path: only what is near one of them in plan; None: everything.
            reach: How near [m].
            progress: Told the share that is there.
        """
        replies: list[DrawReply] = []
        around = None if near is None else Array.pack(np.asarray(near, dtype=np.float64))
        while not replies or len(replies) < replies[0].parts:
            request = DrawRequest(
                scene=scene, what=what, agent=agent, limit=limit, part=len(replies), near=around, reach=reach
            )
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

    def places(self, scene: str) -> dict[str, list[float]]:
        """Named places of a scene: (x, y) or (x, y, z of the ground there) [m] by name."""
        return self.ask(keys.SCENE_PLACES, SceneRequest(scene=scene), PlacesReply, 30.0).places

    def set_place(self, scene: str, name: str, position: Sequence[float]) -> dict[str, list[float]]:
        """Name a place, (x, y) or (x, y, z of the ground there) [m], for all clients; all places then."""
        request = PlaceRequest(scene=scene, name=name, position=[float(v) for v in position])
        return self.ask(keys.SCENE_PLACE, request, PlacesReply, 30.0).places

    def remove_place(self, scene: str, name: str) -> dict[str, list[float]]:
        """Forget a place; all places that are left.

        Raises:
            UnknownPlaceError: there is none of that name.
        """
        return self.ask(keys.SCENE_PLACE, PlaceRequest(scene=scene, name=name), PlacesReply, 30.0).places

    def where(self, scene: str, place: Place) -> list[float]:
        """Position of a named place [m]; a position is given back as it is.

        Raises:
            UnknownPlaceError: the scene has no place of that name.
            InvalidRequestError: it is neither numbers nor a name.
        """
        if not isinstance(place, str):
            try:
                return [float(v) for v in place]
            except (TypeError, ValueError) as error:
                words = f"{place!r} is no place. Pass (x, y) or (x, y, z) in metres, or the name of one."
                raise InvalidRequestError(Reply(status=Status.INVALID_REQUEST, message=words, scene=scene)) from error
        places = self.places(scene)
        if place not in places:
            words = f"there is no place {place!r} in scene {scene!r}. Known: {', '.join(sorted(places)) or 'none'}."
            raise UnknownPlaceError(Reply(status=Status.UNKNOWN_PLACE, message=words, scene=scene))
        return places[place]

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
        colours: ArrayLike | None = None,
        origins: ArrayLike | None = None,
        timeout_s: float = 300.0,
        progress: Progress = lambda share: None,
    ) -> dict[str, Any]:
        """Load a file of the service's scenes folder, or send points; returns the scene's facts when it is ready.

        Args:
            name: Name to give it; a scene of that name is replaced when the new one is ready.
            file: A file's name in the service's scenes folder.
            upload: Points (n, 3) [m] to send instead.
            ground: Which of them are ground (n,), if known.
            colours: Their red, green and blue of 0 to 255, (n, 3), for pictures alone.
            origins: Where the rays to them began [m], (3,) or (n, 3), if known: the scanner's stations.
            timeout_s: Seconds to wait until it is ready.
            progress: Told the share of the upload that is done.
        """
        if (file is None) == (upload is None):
            raise ValueError("load_scene takes either file= or upload=")
        if file is not None:
            self.ask(keys.SCENE_LOAD, LoadRequest(scene=name, file=file), SceneReply, 30.0, {Status.BUILDING})
        else:
            points = np.asarray(upload, dtype=np.float64)
            sent = points if colours is None else np.column_stack([points, np.asarray(colours, dtype=np.float64)])
            self._upload(name, sent, ground, _origins(origins, len(points)), progress)
        return self.wait_for_scene(name, timeout_s=timeout_s)

    def _upload(
        self,
        name: str,
        points: np.ndarray[Any, Any],
        ground: ArrayLike | None,
        origins: FloatArray | None,
        progress: Progress,
    ) -> None:
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
                origins=_of_part(origins, rows),
            )
            self.ask(keys.SCENE_UPLOAD, request, SceneReply, 30.0, {Status.BUILDING})
            progress((part + 1) / parts)

    def update_scene(
        self,
        name: str,
        insert: ArrayLike | None = None,
        *,
        remove: ArrayLike | None = None,
        radius: float = 0.05,
        pose: ArrayLike | None = None,
        origins: ArrayLike | None = None,
        thin: float = 0.0,
        wait: bool = True,
        timeout_s: float = 300.0,
    ) -> dict[str, Any]:
        """Change a scene by a further scan; plans are answered from the version before until the next one is built.

        Args:
            name: Name of a loaded scene.
            insert: Points (k, 3) [m] that are new.
            remove: Points (j, 3) [m] where nothing is any more.
            radius: What was within this of such a point is gone [m].
            pose: From the points' frame to the scene's, (4, 4); without one they are in the scene's.
            origins: Where the rays to the new points began [m], (3,) or (k, 3), in the points' frame: (0, 0, 0) of a
                sensor's own scan. They tell what is free between samples, in a scene that was built with origins.
            thin: Of the new points only those are taken, one each, in whose voxel of this width [m] the scene has none:
                so it does not grow where it is scanned over and over. All if it is 0.
            wait: Whether to wait until the next version is ready. Who streams scans does not: see `watch_scenes`.
            timeout_s: Seconds to wait.

        Returns:
            The facts of the next version; nothing without waiting.
        """
        new, old = (_placed([] if cloud is None else cloud, pose) for cloud in (insert, remove))
        if not len(new) and not len(old):
            raise ValueError("update_scene takes insert=, remove= or both, at least one point")
        points, gone = np.concatenate([old, new]), np.arange(len(old) + len(new)) < len(old)
        began = _origins(origins, len(new))
        if began is not None:
            began = _placed(began, pose)
            began = began if len(began) == 1 else np.concatenate([old, began])  # no ray is asked of what is gone
        upload_id, parts = uuid.uuid4().hex, -(-len(points) // PART_POINTS)
        for part in range(parts):
            rows = slice(part * PART_POINTS, (part + 1) * PART_POINTS)
            request = UpdateRequest(
                scene=name,
                upload_id=upload_id,
                part=part,
                parts=parts,
                points=Array.pack(points[rows]),
                gone=Array.pack(gone[rows], "f4"),
                radius=radius,
                origins=_of_part(began, rows),
                thin=thin,
            )
            self.ask(keys.SCENE_UPDATE, request, SceneReply, timeout_s, {Status.BUILDING})
        return self.wait_for_scene(name, timeout_s=timeout_s) if wait else {}

    def watch_scenes(self, on_change: Callable[[SceneChanged], None]) -> None:
        """Hear of new versions of scenes, and of scenes that are unloaded (version 0).

        Args:
            on_change: Told each one, on a thread of Zenoh's; it must return soon.
        """
        self._subscribe(keys.changed("*"), SceneChanged, on_change)

    def _subscribe(self, key: str, kind: type[T], told: Callable[[T], None]) -> None:
        def hear(sample: zenoh.Sample) -> None:
            with contextlib.suppress(gpdf_schemas.DecodeError):  # of a later version: nothing that we understand
                told(decode(sample.payload.to_bytes(), kind))

        self._watchers.append(self._session.declare_subscriber(key, hear))

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
        payload, until = _packed(request, deadline_s), time.monotonic() + deadline_s
        answer: Reply | None = None
        while (left := until - time.monotonic()) > 0:
            answer = self._try(key, payload, kind, left) or answer
            if answer is not None and answer.status not in LATER:
                return self._fine(answer, fine)  # type: ignore[return-value]
            time.sleep(BACK_OFF_S)
        raise self._late(key, deadline_s, answer)

    def ask_planner(self, key: str, request: msgspec.Struct, kind: type[R], deadline_s: float) -> R:
        """One request to whichever planner is least loaded; to another one if it dies, freezes or is busy.

        Args:
            key: What all planners answer: `keys.PLAN` or `keys.DISTANCE`.
            request: Its message.
            kind: The type of its reply.
            deadline_s: Seconds to keep asking.
        """
        payload, until = _packed(request, deadline_s), time.monotonic() + deadline_s
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
        raise self._late(key, deadline_s, answer)

    def _late(self, key: str, deadline_s: float, answer: Reply | None) -> ClientError:
        """Nobody answered in time, or all were busy all the time."""
        if answer is not None and answer.status is Status.BUSY:
            return ServiceBusyError(answer)
        if answer is not None:
            return UnavailableError(f"{answer.message} That was the last answer on {key} within {deadline_s:g} s.")
        if self._planners.alive() or self._is_map_there():
            return UnavailableError(f"the service did not answer on {key} within {deadline_s:g} s. Give it more time.")
        return UnavailableError(f"no answer on {key} within {deadline_s:g} s. Is the service running?")

    def _is_map_there(self) -> bool:
        """Whether a map service says that it is alive."""
        try:
            found = self._session.liveliness().get(f"{keys.MAP_ALIVE}/*", timeout=PROBE_S)
            return any(answer.ok is not None for answer in found)
        except zenoh.ZError:  # the session has ended
            return False

    def _try(self, key: str, payload: bytes, kind: type[R], timeout_s: float) -> R | None:
        """Ask once; None if nobody answered."""
        wait = min(timeout_s, LONGEST_S)
        try:
            answers = self._session.get(key, payload=payload, attachment=self._id, timeout=wait)
        except zenoh.ZError as error:
            raise UnavailableError(f"{key} cannot be asked: {error}.") from error
        for answer in answers:
            if answer.ok is not None:  # not Zenoh's own time-out
                return _decode(answer.ok.payload.to_bytes(), kind)
        return None

    @staticmethod
    def _fine(reply: R, fine: Collection[Status]) -> R:
        if reply.status not in fine:
            raise_for(reply)
        return reply


def _packed(request: msgspec.Struct, deadline_s: float) -> bytes:
    """The request's bytes, with an id, so that it is the same one in every try.

    Raises:
        InvalidRequestError: no service would take it; a long one would not even be answered.
    """
    if not 0 < deadline_s < math.inf:
        words = f"deadline_s = {deadline_s}. Give a positive, finite number of seconds."
        raise InvalidRequestError(Reply(status=Status.INVALID_REQUEST, message=words))
    if not getattr(request, "request_id", ""):
        request = msgspec.structs.replace(request, request_id=uuid.uuid4().hex)
    payload = encode(request)
    if len(payload) > MAX_REQUEST_BYTES:
        words = f"{len(payload)} bytes, at most {MAX_REQUEST_BYTES} are taken. Send it in parts."
        raise InvalidRequestError(Reply(status=Status.INVALID_REQUEST, message=words))
    return payload


def _placed(points: ArrayLike, pose: ArrayLike | None) -> FloatArray:
    """Points (n, 3) in the scene's frame.

    Raises:
        ValueError: the points or the pose have another shape.
    """
    cloud = np.asarray(points, dtype=np.float64)
    if cloud.size and (cloud.ndim > 2 or cloud.shape[-1] != 3):
        raise ValueError(f"points of shape {cloud.shape}: each has x, y and z alone")
    cloud = cloud.reshape(-1, 3)
    matrix = np.eye(4) if pose is None else np.asarray(pose, dtype=np.float64)
    if matrix.shape != (4, 4) or not np.array_equal(matrix[3], [0.0, 0.0, 0.0, 1.0]):
        raise ValueError("pose takes a (4, 4) matrix that ends with (0, 0, 0, 1)")
    placed: FloatArray = cloud @ matrix[:3, :3].T + matrix[:3, 3]
    return placed


def _origins(origins: ArrayLike | None, count: int) -> FloatArray | None:
    """Where rays to so many points began, (1, 3) for all of them or (count, 3).

    Raises:
        ValueError: it is neither.
    """
    if origins is None:
        return None
    began = np.asarray(origins, dtype=np.float64)
    if began.shape not in ((3,), (count, 3)):
        raise ValueError(f"origins of shape {began.shape}: give (3,) for all points, or one for each, ({count}, 3)")
    return began.reshape(-1, 3)


def _of_part(origins: FloatArray | None, rows: slice) -> Array | None:
    """The origins of some points, to be sent."""
    return None if origins is None else Array.pack(origins if len(origins) == 1 else origins[rows])


def _publishable(scene: str, obstacles: Sequence[MovingObstacle]) -> bytes:
    """The message, if a service would take it."""
    try:
        count = sum(len(points_of(obstacle)) for obstacle in obstacles)
        if count > MAX_POINTS:
            raise ValueError(f"{count} points move, at most {MAX_POINTS} can. Thin them.")
        data = encode(MovingObstacles(obstacles=list(obstacles)))
        if len(data) > MAX_REQUEST_BYTES:
            raise ValueError(f"{len(data)} bytes, at most {MAX_REQUEST_BYTES} are taken. Publish in parts, or as f4.")
    except ValueError as error:
        raise InvalidRequestError(Reply(status=Status.INVALID_REQUEST, message=str(error), scene=scene)) from error
    return data


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
        start: Place,
        goal: Place,
        agent: Agent = "human",
        *,
        method: str = "dual_gpdf",
        via: Sequence[Place] = (),
        other_goals: Sequence[Place] = (),
        snap: float = 0.0,
        warm_start: Trajectory | None = None,
        start_heading: float | None = None,
        goal_heading: float | None = None,
        prefer: str | None = None,
        alternatives: int = 0,
        deadline_s: float = 30.0,
        request_id: str = "",
        obstacles: Sequence[MovingObstacle] = (),
    ) -> PlanResult:
        """See `Client.plan`."""
        return await asyncio.to_thread(
            self.sync.plan,
            scene,
            start,
            goal,
            agent,
            method=method,
            via=via,
            other_goals=other_goals,
            snap=snap,
            warm_start=warm_start,
            start_heading=start_heading,
            goal_heading=goal_heading,
            prefer=prefer,
            alternatives=alternatives,
            deadline_s=deadline_s,
            request_id=request_id,
            obstacles=obstacles,
        )

    async def publish_obstacles(self, scene: str, obstacles: Sequence[MovingObstacle]) -> None:
        """See `Client.publish_obstacles`."""
        await asyncio.to_thread(self.sync.publish_obstacles, scene, obstacles)

    async def watch_cuts(self, scene: str, on_cut: Callable[[TrajectoryCut], None]) -> None:
        """See `Client.watch_cuts`; `on_cut` is called from another thread."""
        await asyncio.to_thread(self.sync.watch_cuts, scene, on_cut)

    async def watch_scenes(self, on_change: Callable[[SceneChanged], None]) -> None:
        """See `Client.watch_scenes`; `on_change` is called from another thread."""
        await asyncio.to_thread(self.sync.watch_scenes, on_change)

    async def watch(self, on_change: Callable[[str, bool], None]) -> None:
        """See `Client.watch`; `on_change` is called from another thread."""
        await asyncio.to_thread(self.sync.watch, on_change)

    async def status(self, *, timeout_s: float = 5.0) -> list[StatusReply]:
        """See `Client.status`."""
        return await asyncio.to_thread(self.sync.status, timeout_s=timeout_s)

    async def draw(
        self,
        scene: str,
        what: str,
        agent: Agent = "human",
        *,
        limit: int = 300_000,
        near: ArrayLike | None = None,
        reach: float = 0.0,
        progress: Progress = lambda share: None,
    ) -> Drawing:
        """See `Client.draw`; `progress` is called from another thread."""
        return await asyncio.to_thread(
            self.sync.draw, scene, what, agent, limit=limit, near=near, reach=reach, progress=progress
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
        colours: ArrayLike | None = None,
        origins: ArrayLike | None = None,
        timeout_s: float = 300.0,
        progress: Progress = lambda share: None,
    ) -> dict[str, Any]:
        """See `Client.load_scene`; `progress` is called from another thread."""
        sent = {"upload": upload, "ground": ground, "colours": colours, "origins": origins}
        return await asyncio.to_thread(self.sync.load_scene, name, file, **sent, timeout_s=timeout_s, progress=progress)

    async def places(self, scene: str) -> dict[str, list[float]]:
        """See `Client.places`."""
        return await asyncio.to_thread(self.sync.places, scene)

    async def set_place(self, scene: str, name: str, position: Sequence[float]) -> dict[str, list[float]]:
        """See `Client.set_place`."""
        return await asyncio.to_thread(self.sync.set_place, scene, name, position)

    async def remove_place(self, scene: str, name: str) -> dict[str, list[float]]:
        """See `Client.remove_place`."""
        return await asyncio.to_thread(self.sync.remove_place, scene, name)

    async def where(self, scene: str, place: Place) -> list[float]:
        """See `Client.where`."""
        return await asyncio.to_thread(self.sync.where, scene, place)

    async def update_scene(
        self,
        name: str,
        insert: ArrayLike | None = None,
        *,
        remove: ArrayLike | None = None,
        radius: float = 0.05,
        pose: ArrayLike | None = None,
        origins: ArrayLike | None = None,
        thin: float = 0.0,
        wait: bool = True,
        timeout_s: float = 300.0,
    ) -> dict[str, Any]:
        """See `Client.update_scene`."""
        return await asyncio.to_thread(
            self.sync.update_scene,
            name,
            insert,
            remove=remove,
            radius=radius,
            pose=pose,
            origins=origins,
            thin=thin,
            wait=wait,
            timeout_s=timeout_s,
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

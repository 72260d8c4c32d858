"""What each key does: request in, reply out. Every failure becomes a reply with a status and a sentence."""

from __future__ import annotations

import os
import time
from collections import OrderedDict
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
from gpdf_schemas import (
    Array,
    DistanceReply,
    DistanceRequest,
    DrawReply,
    DrawRequest,
    FileReply,
    FileRequest,
    LoadRequest,
    PlaceRequest,
    PlacesReply,
    PlanReply,
    PlanRequest,
    Reply,
    SceneReply,
    SceneRequest,
    ScenesReply,
    Status,
    TrajectoryCut,
    TrajectoryMessage,
    UpdateRequest,
    UploadRequest,
    decode,
    encode,
    keys,
)

from gpdf_service.errors import RequestError, SceneFileError
from gpdf_service.scene import Scene
from gpdf_service.service.answers import Answer, Answers, RefusedError, answer, refuse
from gpdf_service.service.drawing import OF_BODIES, draw_part
from gpdf_service.service.in_use import InUse
from gpdf_service.service.places import Named
from gpdf_service.service.planning import Planning, agent_of, to_trajectory
from gpdf_service.service.pool import Ask, Pool
from gpdf_service.service.scenes import Entry, Shelf, describe
from gpdf_service.types import LARGEST_BODY, BoolArray, FloatArray, resolve_agent

PLANNER_KEYS = keys.PLAN, keys.DISTANCE
"""What a planner answers."""
MOST_TAKEN = 1000
"""Last parts of uploads and changes that are known again when they are repeated, because their replies were lost."""
PART_BYTES = 1_000_000
"""Of a scene file in one reply: a small request behind it waits a few milliseconds."""


class _Given(Reply, frozen=True, kw_only=True):
    """Of a plan's reply what is remembered of it."""

    trajectory: TrajectoryMessage | None = None


class Handlers:
    """The service's answers; holds the scenes and the service's id.

    Args:
        shelf: The scenes.
        planner_id: The service's id.
        on_unload: Told the name of a scene that was unloaded.
        look_for: Asked to bring the shelf up to date when a scene is not on it, within some seconds; it may know why.
        on_cut: Told of trajectories that something that moves has cut.
        pool: Processes that plan; without them, plans are made here.
    """

    def __init__(
        self,
        shelf: Shelf,
        planner_id: str,
        on_unload: Callable[[str], None] = lambda name: None,
        look_for: Callable[[str, float], None] = lambda name, timeout_s: None,
        on_cut: Callable[[TrajectoryCut], None] = lambda cut: None,
        pool: Pool | None = None,
    ) -> None:
        self.shelf, self.planner_id, self._pool = shelf, planner_id, pool
        self._on_unload, self._look_for = on_unload, look_for
        self.moving = shelf.moving
        self._planning = Planning(self._scene, self.moving, planner_id)
        self.in_use = InUse(self.moving.points, on_cut, planner_id)
        self._taken: OrderedDict[tuple[object, ...], bool] = OrderedDict()  # parts, and whether each was the last
        self.by_key: Answers = {
            **self.planner_keys,
            **self.map_keys,
        }

    @property
    def planner_keys(self) -> Answers:
        """What a planner answers."""
        return {
            keys.PLAN: (PlanRequest, PlanReply, self.plan),
            keys.DISTANCE: (DistanceRequest, DistanceReply, self._planning.distance),
        }

    @property
    def map_keys(self) -> Answers:
        """What the map service answers."""
        return {
            keys.SCENES: (SceneRequest, ScenesReply, self.scenes),
            keys.SCENE_INFO: (SceneRequest, SceneReply, self.info),
            keys.SCENE_LOAD: (LoadRequest, SceneReply, self.load),
            keys.SCENE_UPLOAD: (UploadRequest, SceneReply, self.upload),
            keys.SCENE_UPDATE: (UpdateRequest, SceneReply, self.update),
            keys.SCENE_UNLOAD: (SceneRequest, SceneReply, self.unload),
            keys.SCENE_PLACES: (SceneRequest, PlacesReply, self.places),
            keys.SCENE_PLACE: (PlaceRequest, PlacesReply, self.place),
            keys.SCENE_FILE: (FileRequest, FileReply, self.file),
            keys.SCENE_DRAW: (DrawRequest, DrawReply, self.draw),
        }

    def answer(self, key: str, payload: bytes, received: float, load: float = 0.0) -> bytes:
        """The reply's bytes to one request; never raises.

        Args:
            key: What is asked.
            payload: The request's bytes.
            received: When it arrived, on `time.monotonic` [s].
            load: Of the service.
        """
        request_kind, reply_kind, handle = self.by_key[key]

        def by_process(request: PlanRequest | DistanceRequest) -> Reply | bytes:
            return self._by_process(Ask(key, payload, received, load, request.scene, ""), request) or handle(request)

        hands_over = self._pool is not None and key in PLANNER_KEYS
        by: Answer[Reply | bytes] = request_kind, reply_kind, by_process if hands_over else handle
        return answer(by, self.planner_id, payload, received, load)

    def refuse(self, key: str, status: Status, message: str, load: float) -> bytes:
        """A reply to what was asked by a key that only says why there is none."""
        return encode(refuse(self.by_key[key][1], self.planner_id, status, message, load=load))

    def _by_process(self, ask: Ask, request: PlanRequest | DistanceRequest) -> bytes:
        """The reply's bytes by one of the processes; none if there is no file that they could load the scene from."""
        assert self._pool is not None
        until = time.monotonic() + request.deadline_s
        entry = self._ready(request.scene, request.deadline_s)
        while (file := entry.file) is not None:
            if found := self._pool.ask(msgspec.structs.replace(ask, file=str(file)), self.moving.look, until):
                if isinstance(request, PlanRequest):
                    self._remember(request, decode(found, _Given))
                return found
            if entry.file == file:  # it is there and cannot be read: who tries here, learns why
                break
        return b""

    def plan(self, request: PlanRequest) -> PlanReply:
        """A trajectory, planned in this process."""
        reply = self._planning.plan(request)
        self._remember(request, reply)
        return reply

    def _remember(self, request: PlanRequest, reply: _Given | PlanReply) -> None:
        """Who follows what was given out is told when something cuts it."""
        if reply.status is Status.OK and reply.trajectory is not None:
            body = resolve_agent(agent_of(request.agent))
            self.shelf.note_body(request.scene, body)
            self.in_use.remember(request.scene, request.request_id, body, to_trajectory(reply.trajectory))

    def scenes(self, request: SceneRequest) -> ScenesReply:
        """Facts of all scenes."""
        return ScenesReply(request_id=request.request_id, planner=self.planner_id, scenes=self.shelf.facts())

    def info(self, request: SceneRequest) -> SceneReply:
        """Facts of one scene; BUILDING or BUILD_FAILED where it is not ready."""
        entry = self._entry(request.scene)
        if entry.building:
            status, message = Status.BUILDING, f"scene {request.scene!r} is being built. Ask again."
        elif entry.error:
            status, message = Status.BUILD_FAILED, f"scene {request.scene!r}: {entry.error}"
        else:
            status, message = Status.OK, ""
        return self._scene_reply(request, status, message, describe(entry))

    def load(self, request: LoadRequest) -> SceneReply:
        """Start to load a file of the scenes folder."""
        self.shelf.load_file(request.scene, request.file)
        return self._scene_reply(request, Status.BUILDING, f"scene {request.scene!r} is being built.")

    def upload(self, request: UploadRequest) -> SceneReply:
        """Take a part of a cloud; the build starts with the last."""
        points = _points(request.points, (3, 6))
        ground = None if request.ground is None else _labels("ground", request.ground, len(points))
        part = request.upload_id, request.part, request.parts
        cloud = points, ground, _origins(request.origins, len(points))
        return self._take_part(request, lambda: self.shelf.add_part(request.scene, *part, *cloud))

    def update(self, request: UpdateRequest) -> SceneReply:
        """Take a part of a change; the build of the next version starts with the last."""
        self._entry(request.scene)
        if not 0 < request.radius <= LARGEST_BODY:
            raise RequestError("radius", f"{request.radius}", f"Give more than 0, at most {LARGEST_BODY} m.")
        if not 0.0 <= request.thin < LARGEST_BODY:
            raise RequestError("thin", f"{request.thin}", "Give 0 to take all points, or the width of voxels [m].")
        points = _points(request.points)
        gone = _labels("gone", request.gone, len(points))
        part = request.upload_id, request.part, request.parts
        change, how = (points, gone, request.radius), (_origins(request.origins, len(points)), request.thin)
        return self._take_part(request, lambda: self.shelf.add_change(request.scene, *part, *change, *how))

    def _take_part(self, request: UploadRequest | UpdateRequest, take: Callable[[], bool]) -> SceneReply:
        """Take a part, but once: who asks again with the same `request_id` has not heard the reply."""
        asked = type(request), request.scene, request.upload_id, request.part, request.request_id
        done = self._taken.get(asked) if request.request_id else None
        if done is None:
            done = self._taken[asked] = take()
            while len(self._taken) > MOST_TAKEN:
                self._taken.popitem(last=False)
        if done:
            return self._scene_reply(request, Status.BUILDING, f"scene {request.scene!r} is being built.")
        return self._scene_reply(request, Status.OK, f"part {request.part + 1} of {request.parts}")

    def unload(self, request: SceneRequest) -> SceneReply:
        """Forget a scene."""
        if not self.shelf.unload(request.scene):
            raise RefusedError(Status.UNKNOWN_SCENE, self._unknown(request.scene))
        self.moving.forget(request.scene)
        self._on_unload(request.scene)
        return self._scene_reply(request, Status.OK, f"scene {request.scene!r} is unloaded.")

    def places(self, request: SceneRequest) -> PlacesReply:
        """All named places of a scene."""
        self._entry(request.scene)
        return self._places_reply(request, self.shelf.places.of(request.scene))

    def place(self, request: PlaceRequest) -> PlacesReply:
        """Name a place, or forget it."""
        self._entry(request.scene)
        if request.position is not None:
            return self._places_reply(request, self.shelf.places.put(request.scene, request.name, request.position))
        try:
            return self._places_reply(request, self.shelf.places.remove(request.scene, request.name))
        except KeyError as error:
            words = f"there is no place {request.name!r} in scene {request.scene!r}. Known: {error.args[0]}."
            raise RefusedError(Status.UNKNOWN_PLACE, words) from error

    def _places_reply(self, request: SceneRequest | PlaceRequest, places: Named) -> PlacesReply:
        return PlacesReply(request_id=request.request_id, scene=request.scene, planner=self.planner_id, places=places)

    def file(self, request: FileRequest) -> FileReply:
        """A part of a ready scene's file."""
        entry = self.shelf.get(request.scene)
        if entry is None or entry.file is None or entry.facts.get("version") != request.version:
            words = f"scene {request.scene!r} has no file of version {request.version}. Ask which version there is."
            raise RefusedError(Status.UNKNOWN_SCENE, words)
        try:
            with entry.file.open("rb") as file:
                size = os.fstat(file.fileno()).st_size
                if not 0 <= request.offset <= size:
                    raise RequestError("offset", f"{request.offset}", f"Give 0 to {size}.")
                file.seek(request.offset)
                data = file.read(PART_BYTES)
        except FileNotFoundError as error:  # a new version has just taken its place
            raise RefusedError(Status.UNKNOWN_SCENE, f"scene {request.scene!r} has changed. Ask again.") from error
        return FileReply(
            request_id=request.request_id,
            scene=request.scene,
            scene_version=request.version,
            planner=self.planner_id,
            data=data,
            size=size,
        )

    def draw(self, request: DrawRequest) -> DrawReply:
        """One part of what a picture shows."""
        scene = self._scene(request.scene, request.deadline_s)
        near = None if request.near is None else request.near.unpack()
        agent = agent_of(request.agent)
        made = draw_part(scene, request.what, agent, request.limit, request.part, near, request.reach)
        entry = self.shelf.get(request.scene)
        if request.what in OF_BODIES and request.part == 0 and self._pool and entry is not None and entry.file:
            self._pool.prepare(request.scene, str(entry.file), encode(request))  # who looks at it plans for it next
        return DrawReply(
            request_id=request.request_id,
            scene=request.scene,
            scene_version=scene.version,
            planner=self.planner_id,
            part=request.part,
            parts=made.parts,
            origin=made.origin.tolist(),
            columns=list(made.columns),
            rows=Array.pack(made.rows, "f4"),
        )

    def _scene_reply(
        self,
        request: SceneRequest | LoadRequest | UploadRequest | UpdateRequest,
        status: Status,
        message: str,
        info: dict[str, Any] = {},  # noqa: B006
    ) -> SceneReply:
        return SceneReply(
            request_id=request.request_id,
            status=status,
            message=message,
            scene=request.scene,
            scene_version=int(info.get("version", 0)),
            planner=self.planner_id,
            info=info,
        )

    def _ready(self, name: str, timeout_s: float) -> Entry:
        """A scene that has a complete version."""
        entry = self.shelf.get(name)
        if entry is None or not (entry.ready or entry.building):
            self._look_for(name, timeout_s)
            entry = self.shelf.get(name)
        if entry is None:
            raise RefusedError(Status.UNKNOWN_SCENE, self._unknown(name))
        if not entry.ready:
            if entry.building:
                raise RefusedError(Status.BUILDING, f"scene {name!r} is being built. Ask again.")
            raise RefusedError(Status.BUILD_FAILED, f"scene {name!r}: {entry.error}")
        return entry

    def _scene(self, name: str, timeout_s: float) -> Scene:
        """The last complete version of a scene."""
        try:
            return self.shelf.scene(self._ready(name, timeout_s))
        except SceneFileError as error:
            raise RefusedError(Status.BUILD_FAILED, f"scene {name!r}: {error}") from error

    def _entry(self, name: str) -> Entry:
        """What the shelf has of that name, ready or not."""
        entry = self.shelf.get(name)
        if entry is None:
            raise RefusedError(Status.UNKNOWN_SCENE, self._unknown(name))
        return entry

    def _unknown(self, name: str) -> str:
        known = ", ".join(sorted(self.shelf.facts())) or "none"
        return f"there is no scene {name!r}. Loaded: {known}."


def _points(array: Array, columns: tuple[int, ...] = (3,)) -> FloatArray:
    points = array.unpack()
    if points.ndim != 2 or points.shape[1] not in columns:
        raise RequestError("points", f"an array of shape {points.shape}", "Send an array of shape (n, 3).")
    return points


def _origins(array: Array | None, count: int) -> FloatArray | None:
    """Where the rays to each point began, shape (count, 3)."""
    if array is None:
        return None
    origins = array.unpack()
    if origins.shape not in ((1, 3), (count, 3)):
        words = f"Send (1, 3) for all points of the part, or one a point: ({count}, 3)."
        raise RequestError("origins", f"an array of shape {origins.shape}", words)
    spread: FloatArray = np.broadcast_to(origins, (count, 3))
    return spread


def _labels(name: str, array: Array, count: int) -> BoolArray:
    labels = array.unpack()
    if labels.shape != (count,):
        raise RequestError(name, f"an array of shape {labels.shape}", f"Send one number a point: ({count},).")
    return labels > 0

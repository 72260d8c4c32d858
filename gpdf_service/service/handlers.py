"""What each key does: request in, reply out. Every failure becomes a reply with a status and a sentence."""

from __future__ import annotations

import dataclasses
import logging
import os
import time
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
from gpdf_schemas import (
    MAX_REQUEST_BYTES,
    Array,
    CertificateMessage,
    DecodeError,
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
    keys,
)

from gpdf_service.errors import GpdfError, RequestError, SceneFileError
from gpdf_service.pipeline import plan
from gpdf_service.scene import Scene
from gpdf_service.service.drawing import draw_part
from gpdf_service.service.in_use import InUse
from gpdf_service.service.moving import Moving
from gpdf_service.service.places import Named
from gpdf_service.service.scenes import Entry, FullError, Shelf, describe
from gpdf_service.types import Agent, BoolArray, FloatArray, PlanResult, Trajectory, resolve_agent
from gpdf_service.types import Status as PlanStatus

log = logging.getLogger(__name__)
MAX_DISTANCE_POINTS = 100_000
"""Places in one distance request: 4 MiB holds 170 k of them."""

SMALLEST_BODY, LARGEST_BODY = 0.05, 5.0
"""[m] Of a body that a request describes: the finest cell of the ground, and a lorry. Free space of a body a tenth as
wide costs a hundred times the memory, so that one request could take all there is."""

PART_BYTES = 1_000_000
"""Of a scene file in one reply: a small request behind it waits a few milliseconds."""
Answers = dict[str, tuple[type[Any], type[Reply], Callable[[Any], Reply]]]


class Handlers:
    """The service's answers; holds the scenes and the service's id.

    Args:
        shelf: The scenes.
        planner_id: The service's id.
        on_unload: Told the name of a scene that was unloaded.
        look_for: Asked to get a scene that is not on the shelf, within some seconds.
        on_cut: Told of trajectories that something that moves has cut.
    """

    def __init__(
        self,
        shelf: Shelf,
        planner_id: str,
        on_unload: Callable[[str], None] = lambda name: None,
        look_for: Callable[[str, float], None] = lambda name, timeout_s: None,
        on_cut: Callable[[TrajectoryCut], None] = lambda cut: None,
    ) -> None:
        self.shelf, self.planner_id = shelf, planner_id
        self._on_unload, self._look_for = on_unload, look_for
        self.moving = Moving()
        self.in_use = InUse(self.moving.points, on_cut, planner_id)
        self.by_key: Answers = {
            **self.planner_keys,
            **self.map_keys,
        }

    @property
    def planner_keys(self) -> Answers:
        """What a planner answers."""
        return {
            keys.PLAN: (PlanRequest, PlanReply, self.plan),
            keys.DISTANCE: (DistanceRequest, DistanceReply, self.distance),
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

    def answer(self, key: str, payload: bytes, received: float) -> Reply:
        """Answer one request; never raises.

        Args:
            key: The key that was asked.
            payload: The request's bytes.
            received: When it arrived, on `time.monotonic` [s]; its deadline counts from there.
        """
        request_kind, reply_kind, handle = self.by_key[key]
        request_id = ""
        try:
            request = decode(payload, request_kind, limit=MAX_REQUEST_BYTES)
            request_id = request.request_id
            waited = time.monotonic() - received
            if waited >= request.deadline_s:
                words = f"the request waited {waited:.2f} s, its deadline was {request.deadline_s:.2f} s. Ask later."
                return self.refuse(reply_kind, Status.TIMEOUT, words, request_id)
            return handle(msgspec.structs.replace(request, deadline_s=request.deadline_s - waited))
        except (DecodeError, RequestError, ValueError) as error:
            return self.refuse(reply_kind, Status.INVALID_REQUEST, str(error), request_id)
        except _NoSuchError as error:
            return self.refuse(reply_kind, error.status, str(error), request_id)
        except FullError as error:
            return self.refuse(reply_kind, Status.BUSY, str(error), request_id)
        except GpdfError as error:
            return self.refuse(reply_kind, Status.INVALID_REQUEST, str(error), request_id)
        except Exception:
            log.exception("request %s on %s", request_id, key)
            return self.refuse(reply_kind, Status.INTERNAL, "the service failed; its log says more.", request_id)

    def refuse(self, kind: type[Reply], status: Status, message: str, request_id: str = "") -> Reply:
        """A reply that only says why there is none."""
        return kind(request_id=request_id, status=status, message=message, planner=self.planner_id)

    def plan(self, request: PlanRequest) -> PlanReply:
        """A trajectory."""
        scene = self.moving.merged(request.scene, self._scene(request.scene, request.deadline_s), request.obstacles)
        result = plan(
            scene,
            request.start,
            request.goal,
            agent_of(request.agent),
            method=request.method,  # type: ignore[arg-type]
            via=request.via,
            other_goals=request.other_goals,
            snap=request.snap,
            warm_start=None if request.warm_start is None else request.warm_start.unpack(),
            start_heading=request.start_heading,
            goal_heading=request.goal_heading,
            deadline_s=request.deadline_s,
        )
        if result.trajectory is not None and result.status is PlanStatus.OK:
            body = resolve_agent(agent_of(request.agent))
            self.in_use.remember(request.scene, request.request_id, body, result.trajectory)
        return self._plan_reply(request, scene, result)

    def _plan_reply(self, request: PlanRequest, scene: Scene, result: PlanResult) -> PlanReply:
        return PlanReply(
            request_id=request.request_id,
            status=Status(result.status.value),
            message=result.message,
            scene=request.scene,
            scene_version=scene.version,
            planner=self.planner_id,
            timings=result.timings,
            trajectory=None if result.trajectory is None else _trajectory(result.trajectory),
            certificate=None if result.certificate is None else CertificateMessage(**_plain(result.certificate)),
            details=result.details,
            costs=Array.pack(result.costs) if len(result.costs) else None,
        )

    def distance(self, request: DistanceRequest) -> DistanceReply:
        """Distances of a field."""
        points = request.points.unpack()
        if len(points) > MAX_DISTANCE_POINTS:
            raise RequestError("points", f"{len(points)} of them", f"Ask at most {MAX_DISTANCE_POINTS} at once.")
        scene = self.moving.merged(request.scene, self._scene(request.scene, request.deadline_s))
        if request.field == "ground":
            sample = scene.ground_field.query(points)
        elif request.field == "obstacle":
            sample = scene.obstacle_field(agent_of(request.agent)).query(points)
        else:
            raise RequestError("field", f"{request.field!r}", "Ask the 'ground' or the 'obstacle' field.")
        return DistanceReply(
            request_id=request.request_id,
            scene=request.scene,
            scene_version=scene.version,
            planner=self.planner_id,
            distance=Array.pack(sample.distance),
            gradient=Array.pack(sample.gradient),
            valid=Array.pack(sample.valid, "f4"),
        )

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
        points = _points(request.points)
        ground = None if request.ground is None else _labels("ground", request.ground, len(points))
        done = self.shelf.add_part(request.scene, request.upload_id, request.part, request.parts, points, ground)
        return self._part_reply(request, done)

    def update(self, request: UpdateRequest) -> SceneReply:
        """Take a part of a change; the build of the next version starts with the last."""
        self._entry(request.scene)
        if not 0 < request.radius <= LARGEST_BODY:
            raise RequestError("radius", f"{request.radius}", f"Give more than 0, at most {LARGEST_BODY} m.")
        points = _points(request.points)
        gone = _labels("gone", request.gone, len(points))
        part = request.upload_id, request.part, request.parts
        return self._part_reply(request, self.shelf.add_change(request.scene, *part, points, gone, request.radius))

    def _part_reply(self, request: UploadRequest | UpdateRequest, done: bool) -> SceneReply:
        if done:
            return self._scene_reply(request, Status.BUILDING, f"scene {request.scene!r} is being built.")
        return self._scene_reply(request, Status.OK, f"part {request.part + 1} of {request.parts}")

    def unload(self, request: SceneRequest) -> SceneReply:
        """Forget a scene."""
        if not self.shelf.unload(request.scene):
            raise _NoSuchError(Status.UNKNOWN_SCENE, self._unknown(request.scene))
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
            raise _NoSuchError(Status.UNKNOWN_PLACE, words) from error

    def _places_reply(self, request: SceneRequest | PlaceRequest, places: Named) -> PlacesReply:
        return PlacesReply(request_id=request.request_id, scene=request.scene, planner=self.planner_id, places=places)

    def file(self, request: FileRequest) -> FileReply:
        """A part of a ready scene's file."""
        entry = self.shelf.get(request.scene)
        if entry is None or entry.file is None or entry.facts["version"] != request.version:
            words = f"scene {request.scene!r} has no file of version {request.version}. Ask which version there is."
            raise _NoSuchError(Status.UNKNOWN_SCENE, words)
        try:
            with entry.file.open("rb") as file:
                size = os.fstat(file.fileno()).st_size
                if not 0 <= request.offset <= size:
                    raise RequestError("offset", f"{request.offset}", f"Give 0 to {size}.")
                file.seek(request.offset)
                data = file.read(PART_BYTES)
        except FileNotFoundError as error:  # a new version has just taken its place
            raise _NoSuchError(Status.UNKNOWN_SCENE, f"scene {request.scene!r} has changed. Ask again.") from error
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
        made = draw_part(scene, request.what, agent_of(request.agent), request.limit, request.part)
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

    def _scene(self, name: str, timeout_s: float) -> Scene:
        """The last complete version of a scene."""
        entry = self.shelf.get(name)
        if entry is None or not (entry.ready or entry.building):
            self._look_for(name, timeout_s)
            entry = self.shelf.get(name)
        if entry is None:
            raise _NoSuchError(Status.UNKNOWN_SCENE, self._unknown(name))
        if not entry.ready:
            if entry.building:
                raise _NoSuchError(Status.BUILDING, f"scene {name!r} is being built. Ask again.")
            raise _NoSuchError(Status.BUILD_FAILED, f"scene {name!r}: {entry.error}")
        try:
            return self.shelf.scene(entry)
        except SceneFileError as error:
            raise _NoSuchError(Status.BUILD_FAILED, f"scene {name!r}: {error}") from error

    def _entry(self, name: str) -> Entry:
        """What the shelf has of that name, ready or not."""
        entry = self.shelf.get(name)
        if entry is None:
            raise _NoSuchError(Status.UNKNOWN_SCENE, self._unknown(name))
        return entry

    def _unknown(self, name: str) -> str:
        known = ", ".join(sorted(self.shelf.facts())) or "none"
        return f"there is no scene {name!r}. Loaded: {known}."


class _NoSuchError(Exception):
    def __init__(self, status: Status, message: str) -> None:
        super().__init__(message)
        self.status = status


def agent_of(agent: str | dict[str, Any]) -> str | Agent:
    """The body that a request means: a name, or an `Agent` from its measures."""
    if isinstance(agent, str):
        return agent
    fields = dataclasses.fields(Agent)
    needed = [field.name for field in fields if field.default is dataclasses.MISSING]
    if not set(needed) <= set(agent) <= {field.name for field in fields}:
        raise RequestError(
            "agent",
            f"a map with {', '.join(sorted(map(str, agent)))}",
            f"Give all of {', '.join(needed)}; discs if any.",
        )
    numbers = {key: value for key, value in agent.items() if key not in ("name", "discs")}
    discs = agent.get("discs", 1)
    if not isinstance(discs, int) or isinstance(discs, bool):
        raise RequestError("agent", f"discs = {discs!r}", "Give how many as an integer.")
    if not all(isinstance(value, int | float) and not isinstance(value, bool) for value in numbers.values()):
        raise RequestError("agent", "a measure that is no number", "Give metres, radians and seconds as numbers.")
    for key in ("height", "width", "length"):
        if not SMALLEST_BODY <= numbers[key] <= LARGEST_BODY:
            raise RequestError("agent", f"{key} = {numbers[key]!r}", f"Give {SMALLEST_BODY} to {LARGEST_BODY} m.")
    return Agent(name=str(agent["name"]), **{key: float(value) for key, value in numbers.items()}, discs=discs)


def _points(array: Array) -> FloatArray:
    points = array.unpack()
    if points.ndim != 2 or points.shape[1] != 3:
        raise RequestError("points", f"an array of shape {points.shape}", "Send an array of shape (n, 3).")
    return points


def _labels(name: str, array: Array, count: int) -> BoolArray:
    labels = array.unpack()
    if labels.shape != (count,):
        raise RequestError(name, f"an array of shape {labels.shape}", f"Send one number a point: ({count},).")
    return labels > 0


def _trajectory(path: Trajectory) -> TrajectoryMessage:
    return TrajectoryMessage(*(Array.pack(part) for part in (path.positions, path.ground, path.times, path.headings)))


def _plain(record: Any) -> dict[str, Any]:  # noqa: ANN401 - any dataclass of arrays and numbers
    values = {field.name: getattr(record, field.name) for field in dataclasses.fields(record)}
    return {key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in values.items()}

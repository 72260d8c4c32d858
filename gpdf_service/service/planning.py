"""What a planner does: a trajectory, distances. It sees scenes and what moves in them, and no network."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from gpdf_schemas import (
    Alternative,
    Array,
    CertificateMessage,
    DistanceReply,
    DistanceRequest,
    PlanReply,
    PlanRequest,
    Status,
    TrajectoryMessage,
    keys,
)

from gpdf_service.errors import RequestError
from gpdf_service.pipeline import plan
from gpdf_service.scene import Scene
from gpdf_service.service.answers import LOOKED, Answers
from gpdf_service.service.moving import Moving
from gpdf_service.types import Agent, PlanResult, Trajectory, resolve_agent

MAX_AGENT_NAME = 64
"""[characters] Of a body that is described: it is kept with what was planned for it."""
MAX_DISTANCE_POINTS = 100_000
"""Places in one distance request: 4 MiB holds 170 k of them."""


class Planning:
    """Plans and distances.

    Args:
        scene_of: The scene of a name, got within some seconds; it may raise `RefusedError`.
        moving: What moves in the scenes.
        planner_id: The service's id.
    """

    def __init__(self, scene_of: Callable[[str, float], Scene], moving: Moving, planner_id: str) -> None:
        self._scene_of, self._moving, self._planner_id = scene_of, moving, planner_id
        self.answers: Answers = {
            keys.PLAN: (PlanRequest, PlanReply, self.plan),
            keys.DISTANCE: (DistanceRequest, DistanceReply, self.distance),
        }

    def plan(self, request: PlanRequest) -> PlanReply:
        """A trajectory."""
        standing = self._scene_of(request.scene, request.deadline_s)
        looked, living = self._moving.look(request.scene)
        scene = self._moving.merged(request.scene, standing, request.obstacles, living)
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
            prefer=request.prefer or None,  # type: ignore[arg-type]
            alternatives=request.alternatives,
            deadline_s=request.deadline_s,
        )
        return self._plan_reply(request, scene, result, looked)

    def _plan_reply(self, request: PlanRequest, scene: Scene, result: PlanResult, looked: float) -> PlanReply:
        return PlanReply(
            request_id=request.request_id,
            status=Status(result.status.value),
            message=result.message,
            scene=request.scene,
            scene_version=scene.version,
            planner=self._planner_id,
            timings={**result.timings, LOOKED: looked},
            trajectory=None if result.trajectory is None else _trajectory(result.trajectory),
            certificate=None if result.certificate is None else CertificateMessage(**_plain(result.certificate)),
            details=result.details,
            costs=Array.pack(result.costs) if len(result.costs) else None,
            alternatives=[_alternative(other) for other in result.alternatives],
        )

    def distance(self, request: DistanceRequest) -> DistanceReply:
        """Distances of a field."""
        points = request.points.unpack()
        if len(points) > MAX_DISTANCE_POINTS:
            raise RequestError("points", f"{len(points)} of them", f"Ask at most {MAX_DISTANCE_POINTS} at once.")
        scene = self._moving.merged(request.scene, self._scene_of(request.scene, request.deadline_s))
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
            planner=self._planner_id,
            distance=Array.pack(sample.distance),
            gradient=Array.pack(sample.gradient),
            valid=Array.pack(sample.valid, "f4"),
            deviation=Array.pack(np.where(sample.valid, sample.deviation, 0.0), "f4"),
        )


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
    name = str(agent["name"])
    if len(name) > MAX_AGENT_NAME:
        raise RequestError("agent", f"a name of {len(name)} characters", f"Give at most {MAX_AGENT_NAME}.")
    return resolve_agent(Agent(**{**agent, "name": name}))


def _alternative(result: PlanResult) -> Alternative:
    assert result.trajectory is not None
    assert result.certificate is not None
    proof = CertificateMessage(**_plain(result.certificate))
    return Alternative(trajectory=_trajectory(result.trajectory), certificate=proof, details=result.details)


def to_trajectory(message: TrajectoryMessage) -> Trajectory:
    """From the wire."""
    return Trajectory(*(part.unpack() for part in (message.positions, message.ground, message.times, message.headings)))


def _trajectory(path: Trajectory) -> TrajectoryMessage:
    return TrajectoryMessage(*(Array.pack(part) for part in (path.positions, path.ground, path.times, path.headings)))


def _plain(record: Any) -> dict[str, Any]:  # noqa: ANN401 - any dataclass of arrays and numbers
    values = {field.name: getattr(record, field.name) for field in dataclasses.fields(record)}
    return {key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in values.items()}

"""What a client gets: typed results and typed errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from gpdf_schemas import CertificateMessage, DrawReply, PlanReply, Reply, Status
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


class ClientError(Exception):
    """Root of the client's errors."""


class UnavailableError(ClientError):
    """Nobody answered: no service at the endpoint, or it died; tried again until the time was up."""


class ServiceError(ClientError):
    """The service refused or failed; `status` and the service's own words."""

    def __init__(self, reply: Reply) -> None:
        super().__init__(f"{reply.status.value}: {reply.message}")
        self.status, self.reply = reply.status, reply


class InvalidRequestError(ServiceError):
    """The service could not understand the request."""


class UnknownSceneError(ServiceError):
    """No scene of that name is loaded, or it is still being built."""


class ServiceBusyError(ServiceError):
    """The service's queue was full each time that it was asked."""


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Positions of the body's top (n, 3), contact points (n, 3) [m], times (n,) [s], headings (n,) [rad]."""

    positions: FloatArray
    ground: FloatArray
    times: FloatArray
    headings: FloatArray

    @property
    def length(self) -> float:
        """Length of the path of the body's top [m]."""
        return float(np.linalg.norm(np.diff(self.positions, axis=0), axis=1).sum())

    @property
    def duration(self) -> float:
        """Time from start to goal [s]."""
        return float(self.times[-1])


Certificate = CertificateMessage


@dataclass(frozen=True, slots=True)
class PlanResult:
    """Answer to a plan: `trajectory` is there exactly when `status` is OK."""

    status: Status
    message: str
    trajectory: Trajectory | None
    certificate: Certificate | None
    scene_version: int
    planner: str
    timings: dict[str, float] = field(default_factory=dict)
    request_id: str = ""


@dataclass(frozen=True, slots=True)
class Distances:
    """Distances (m,) [m], gradients (m, dim), validity (m,); where not valid the distance is 0."""

    distance: FloatArray
    gradient: FloatArray
    valid: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Drawing:
    """What a picture of a scene shows.

    Attributes:
        scene_version: Version of the scene that it shows.
        origin: To add to the places, (3,) [m].
        places: Relative to `origin` [m], (n, 3).
        columns: What is known of each place, by name (see `gpdf_schemas.DrawReply`), each (n,).
    """

    scene_version: int
    origin: FloatArray
    places: FloatArray
    columns: dict[str, FloatArray]


_ERRORS: dict[Status, type[ServiceError]] = {
    Status.INVALID_REQUEST: InvalidRequestError,
    Status.UNKNOWN_SCENE: UnknownSceneError,
    Status.BUSY: ServiceBusyError,
    Status.BUILDING: UnknownSceneError,
    Status.BUILD_FAILED: ServiceError,
    Status.INTERNAL: ServiceError,
    Status.UNAVAILABLE: ServiceError,
}


def raise_for(reply: Reply) -> None:
    """Raise the service's failures; a planner's "no" is a result, not a failure."""
    if reply.status in _ERRORS:
        raise _ERRORS[reply.status](reply)


def to_result(reply: PlanReply) -> PlanResult:
    """Unpack a plan's reply."""
    path = reply.trajectory
    trajectory = None
    if path is not None:
        trajectory = Trajectory(*(part.unpack() for part in (path.positions, path.ground, path.times, path.headings)))
    return PlanResult(
        reply.status,
        reply.message,
        trajectory,
        reply.certificate,
        reply.scene_version,
        reply.planner,
        reply.timings,
        reply.request_id,
    )


def to_drawing(replies: Sequence[DrawReply]) -> Drawing:
    """Join the parts of a drawing."""
    first = replies[0]
    rows = np.concatenate([reply.rows.unpack() for reply in replies if reply.rows is not None])
    columns = dict(zip(first.columns, rows.T, strict=True))
    return Drawing(first.scene_version, np.array(first.origin), rows[:, :3], columns)

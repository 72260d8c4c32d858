"""What a client gets: typed results and typed errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import gpdf_schemas
import numpy as np
from gpdf_schemas import Array, CertificateMessage, DrawReply, PlanReply, Reply, Status, TrajectoryMessage
from numpy.typing import NDArray

from gpdf_client.trajectory import FloatArray, Trajectory


class ClientError(Exception):
    """Root of the client's errors."""


class UnavailableError(ClientError):
    """Nobody answered: no service at the endpoint, or it died; tried again until the time was up."""


class DecodeError(ClientError, gpdf_schemas.DecodeError):
    """The reply is not the message that it should be: the service is of another version, or it is no such service."""


class ServiceError(ClientError):
    """The service refused or failed; `status` and the service's own words."""

    def __init__(self, reply: Reply) -> None:
        super().__init__(f"{reply.status.value}: {reply.message}")
        self.status, self.reply = reply.status, reply


class InvalidRequestError(ServiceError):
    """The service could not understand the request."""


class UnknownSceneError(ServiceError):
    """No scene of that name is loaded, or it is still being built."""


class UnknownPlaceError(ServiceError):
    """The scene has no place of that name; the message lists those that it has."""


class ServiceBusyError(ServiceError):
    """The service's queue was full each time that it was asked."""


Certificate = CertificateMessage


@dataclass(frozen=True, slots=True)
class PlanResult:
    """Answer to a plan: `trajectory` is there when `status` is OK; follow it only then.

    A baseline that was asked for by name also sends a path that is UNCERTIFIED, to be measured and drawn. `details` are
    numbers by name, and `costs` (k,) those of the optimiser, both as in `PlanReply`. `alternatives` are more ways that
    differ, if they were asked for, the best first.
    """

    status: Status
    message: str
    trajectory: Trajectory | None
    certificate: Certificate | None
    scene_version: int
    planner: str
    timings: dict[str, float] = field(default_factory=dict)
    request_id: str = ""
    details: dict[str, float] = field(default_factory=dict)
    costs: FloatArray = field(default_factory=lambda: np.zeros(0))
    alternatives: tuple[PlanResult, ...] = ()


@dataclass(frozen=True, slots=True)
class Distances:
    """What a field says at m places.

    Attributes:
        distance: To the nearest surface [m], shape (m,); 0 where it is not valid.
        gradient: Of the distance, shape (m, dim).
        valid: Whether the data supports an answer, shape (m,).
        deviation: Standard deviation of the distance [m], shape (m,): the truth lies within two of them in at least
            95 % of queries; infinite where the answer is not valid, or the service does not say.
        scene_version: Of the scene that was asked.
    """

    distance: FloatArray
    gradient: FloatArray
    valid: NDArray[np.bool_]
    deviation: FloatArray
    scene_version: int = 0


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
    Status.UNKNOWN_PLACE: UnknownPlaceError,
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


def unpack(array: Array) -> FloatArray:
    """The numbers of an array in a reply.

    Raises:
        DecodeError: its bytes do not fit its shape, or a number is not finite.
    """
    try:
        return array.unpack()
    except ValueError as error:
        raise DecodeError(f"array in the reply: {error}. See schemas/CONVENTIONS.md.") from error


def to_result(reply: PlanReply) -> PlanResult:
    """Unpack a plan's reply."""
    known = reply.scene_version, reply.planner, reply.timings, reply.request_id
    others = (
        PlanResult(Status.OK, "", to_trajectory(other.trajectory), other.certificate, *known, other.details)
        for other in reply.alternatives
    )
    return PlanResult(
        reply.status,
        reply.message,
        None if reply.trajectory is None else to_trajectory(reply.trajectory),
        reply.certificate,
        *known,
        reply.details,
        np.zeros(0) if reply.costs is None else unpack(reply.costs),
        tuple(others),
    )


def to_trajectory(path: TrajectoryMessage) -> Trajectory:
    """Unpack a trajectory."""
    return Trajectory(*map(unpack, (path.positions, path.ground, path.times, path.headings)))


def to_drawing(replies: Sequence[DrawReply]) -> Drawing:
    """Join the parts of a drawing."""
    first = replies[0]
    rows = np.concatenate([reply.rows.unpack() for reply in replies if reply.rows is not None])
    columns = dict(zip(first.columns, rows.T, strict=True))
    return Drawing(first.scene_version, np.array(first.origin), rows[:, :3], columns)

"""Ask again what a log recorded, and compare the answers."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from gpdf_schemas import MovingObstacle, MovingObstacles, PlanReply, PlanRequest, decode, keys
from mcap.records import Channel, Message, Metadata

from gpdf_service.service.answers import LOOKED
from gpdf_service.service.record import records_of

IDENTICAL = 1e-9
"""[m] Trajectories closer than this are the same but for the last bits of a sum."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """One request: both statuses, lengths and clearances, the largest distance between the trajectories [m]."""

    request_id: str
    status: tuple[str, str]
    length: tuple[float, float]
    clearance: tuple[float, float]
    deviation: float

    @property
    def same(self) -> bool:
        """Whether nothing differs."""
        return self.status[0] == self.status[1] and self.deviation <= IDENTICAL


@dataclass(frozen=True, slots=True)
class Planned:
    """A plan in a log: when it looked at what moves [ns], the request and the reply, as they were on the wire."""

    stamp_ns: int
    request: PlanRequest
    reply: PlanReply


@dataclass(frozen=True, slots=True)
class Moved:
    """A publication of what moves in a scene, and when it came [ns]."""

    stamp_ns: int
    scene: str
    obstacles: list[MovingObstacle]


def recorded_plans(path: Path) -> Iterator[tuple[PlanRequest, PlanReply]]:
    """Every plan in a log: the request and the reply, as they were on the wire."""
    return ((event.request, event.reply) for event in _events(path) if isinstance(event, Planned))


def recorded_events(path: Path, damage: list[str] | None = None) -> list[Planned | Moved]:
    """What moved, and plans as they were begun, in their order: a plan knows what moved when it was begun.

    Args:
        path: The log.
        damage: Told in words what is left out.
    """
    return sorted(_events(path, damage), key=lambda event: event.stamp_ns)


def _events(path: Path, damage: list[str] | None = None) -> Iterator[Planned | Moved]:
    """In the order of the log: a request stands right before its reply, and there when it was answered."""
    topics: dict[int, str] = {}
    request: Message | None = None
    for record in records_of(path, damage):
        if isinstance(record, Channel):
            topics[record.id] = record.topic
        if not isinstance(record, Message):
            continue
        topic = topics.get(record.channel_id, "")
        if topic == f"{keys.PLAN}/request":
            request = record
        elif topic == f"{keys.PLAN}/reply" and request is not None:
            reply = decode(record.data, PlanReply)
            if reply.status not in ("INVALID_REQUEST", "BUSY", "UNAVAILABLE"):
                looked_s = reply.timings.get(LOOKED, reply.timings.get("waited", 0.0))
                yield Planned(request.log_time + round(1e9 * looked_s), decode(request.data, PlanRequest), reply)
            request = None
        elif topic.startswith(keys.SCENES) and topic.endswith("/obstacles"):
            yield Moved(record.log_time, topic.split("/")[-2], decode(record.data, MovingObstacles).obstacles)


def recorded_scenes(path: Path) -> dict[tuple[str, int], str]:
    """Digest of every scene in a log, by its name and version."""
    found: dict[tuple[str, int], str] = {}
    for record in records_of(path):
        if isinstance(record, Metadata) and record.name.startswith("scene/"):
            facts = json.loads(record.metadata["facts"])
            found[record.name.removeprefix("scene/"), int(facts["version"])] = facts["digest"]
    return found


def compare(request: PlanRequest, was: PlanReply, now: PlanReply) -> Comparison:
    """Compare two answers to one request."""
    paths = [reply.trajectory.positions.unpack() if reply.trajectory else np.zeros((0, 3)) for reply in (was, now)]
    lengths = [float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum()) for path in paths]
    room = [reply.certificate.min_clearance if reply.certificate else 0.0 for reply in (was, now)]
    if len(paths[0]) == len(paths[1]):
        deviation = float(np.abs(paths[0] - paths[1]).max(initial=0.0))
    else:
        deviation = _apart(*paths)
    return Comparison(
        request.request_id,
        (was.status.value, now.status.value),
        (lengths[0], lengths[1]),
        (room[0], room[1]),
        deviation,
    )


def _apart(a: np.ndarray, b: np.ndarray) -> float:  # type: ignore[type-arg]
    """Largest distance from a waypoint of one path to the nearest of the other; inf if one is empty."""
    if len(a) == 0 or len(b) == 0:
        return float("inf")
    gap = np.linalg.norm(a[:, None] - b[None], axis=2)
    return float(max(gap.min(axis=0).max(), gap.min(axis=1).max()))

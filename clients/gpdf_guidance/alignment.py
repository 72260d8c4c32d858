"""From a phone's own tracking (WebXR, "local-floor": x right, y up, z back) to the scene: where it is, how well known.

A phone knows only how it has moved. It is tied to the map at a marked place: the person stands there and faces another
one. From then on it drifts: of 19 m, ARCore lost 0.5 m along a corridor (Z. Wang, "Drifting error comparison of ARCore
and ARKit", 2020), ARKit 2 cm a second (Kim et al., Sensors 22, 2022, 9873), which is as much for a person who walks.
So what is believed of a pose falls with each metre, until the person is at a place again and says so.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import atan2, cos, hypot, sin

from gpdf_schemas import PoseMessage

MARKED = 0.05
"""[m] One standard deviation of where a person stands who stands at a marked place."""
DRIFT = 0.026
"""Metres that tracking loses in a metre, one standard deviation."""
NOT_TRACKED = 10.0
"""[m] Of a pose that the phone itself says it has made up."""
AHEAD = 0.3
"""[m] A phone that is held out, or hangs on the chest, is so far before the middle of the body."""
LEVEL = 0.5
"""A camera whose direction is shorter than this in plan looks down or up: then its upper edge points ahead."""

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class Tracked:
    """What the phone says: position [m], orientation (x, y, z, w), stamp [s], whether it is tracked, counted steps."""

    position: Vector
    orientation: Quaternion
    stamp: float
    tracked: bool = True
    steps: int | None = None

    @property
    def heading(self) -> float:
        """Where it looks in plan, counter-clockwise from x [rad]."""
        forward = _turned(self.orientation, (0.0, 0.0, -1.0))
        if hypot(forward[0], forward[2]) < LEVEL:
            forward = _turned(self.orientation, (0.0, 1.0, 0.0))
        return atan2(-forward[2], forward[0])

    @property
    def body(self) -> tuple[float, float]:
        """The middle of the body in plan: x, and -z [m]."""
        return (
            self.position[0] - AHEAD * cos(self.heading),
            -self.position[2] - AHEAD * sin(self.heading),
        )


@dataclass(frozen=True, slots=True)
class Alignment:
    """How a phone's tracking lies in the scene.

    Attributes:
        turn: Of the tracking into the scene [rad].
        shift: What is then added (x, y, z) [m].
        drift: Metres lost in a metre.
        walked: Since the last place that was known [m].
        last: Where the body was then, in the tracking's plan [m].
    """

    turn: float
    shift: Vector
    drift: float = DRIFT
    walked: float = 0.0
    last: tuple[float, float] = (0.0, 0.0)

    @property
    def accuracy(self) -> float:
        """One standard deviation of the place [m]."""
        return hypot(MARKED, self.drift * self.walked)


def align(seen: Tracked, place: Vector, facing: float | None, known: Alignment | None, drift: float) -> Alignment:
    """Tie a phone to the scene.

    Args:
        seen: The phone, now.
        place: Where its person stands (x, y, z of the ground) [m].
        facing: Where he looks [rad]; None keeps the direction that is known.
        known: How it lay until now.
        drift: Metres lost in a metre.

    Raises:
        ValueError: neither the direction is given, nor one known.
    """
    if facing is None and known is None:
        raise ValueError("where the person looks is not known yet. Say which place he faces.")
    turn = known.turn if facing is None and known is not None else (facing or 0.0) - seen.heading
    x, y = _rotated(seen.body, turn)
    return Alignment(turn, (place[0] - x, place[1] - y, place[2] - seen.position[1]), drift, 0.0, seen.body)


def walk_on(known: Alignment, seen: Tracked) -> Alignment:
    """The alignment after a pose: the further it went, the less it is worth."""
    x, y = seen.body
    return replace(known, walked=known.walked + hypot(x - known.last[0], y - known.last[1]), last=(x, y))


def to_pose(known: Alignment, seen: Tracked) -> PoseMessage:
    """The body in the scene."""
    x, y = _rotated(seen.body, known.turn)
    place = [x + known.shift[0], y + known.shift[1], seen.position[1] + known.shift[2]]
    accuracy = known.accuracy if seen.tracked else NOT_TRACKED
    return PoseMessage(
        position=place, heading=seen.heading + known.turn, stamp=seen.stamp, accuracy=accuracy, steps=seen.steps
    )


@dataclass(slots=True)
class Clock:
    """A phone's clock beside ours: messages are late, never early, so the least difference is the clocks' own."""

    offset: float = float("inf")

    def to_ours(self, theirs: float, now: float) -> float:
        """When something was, that the phone stamped `theirs` and that came `now` [s]."""
        self.offset = min(self.offset, now - theirs)
        return theirs + self.offset

    def to_theirs(self, ours: float) -> float | None:
        """A time of ours on the phone's clock [s]; None as long as nothing has come from it."""
        return ours - self.offset if self.offset < float("inf") else None


def _rotated(place: tuple[float, float], turn: float) -> tuple[float, float]:
    x, y = place
    return x * cos(turn) - y * sin(turn), x * sin(turn) + y * cos(turn)


def _turned(q: Quaternion, v: Vector) -> Vector:
    """A vector turned by a unit quaternion (x, y, z, w)."""
    x, y, z, w = q
    tx, ty, tz = 2 * (y * v[2] - z * v[1]), 2 * (z * v[0] - x * v[2]), 2 * (x * v[1] - y * v[0])
    return (
        v[0] + w * tx + y * tz - z * ty,
        v[1] + w * ty + z * tx - x * tz,
        v[2] + w * tz + x * ty - y * tx,
    )

"""How a person meets stairs: square to the first edge, and off the last one straight on.

Who cannot see stops at the foot, faces the stairs, and finds the first edge with the cane. A path that is the shortest
comes onto them in a curve, over a corner of the lowest tread. So a way over stairs is asked for once more, through a
place before each flight and one behind it, in its line.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import atan2, cos, hypot, sin

import numpy as np
from numpy.typing import NDArray

from gpdf_guidance.features import Feature, find_flights, wrap

FloatArray = NDArray[np.float64]
Field = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""Distance (m,) and its gradient (m, 3) to the ground at (m, 3); infinite where nothing is known."""

ROOM_TO_STAND = 0.05
"""[m] A place to go through needs this much beside the body: the search keeps a margin of its own."""
LEAST_EDGE = 0.1
"""[m] A first step that is lower is a sill, which one may cross at any angle."""
FEET = (0.6, 0.45, 0.3)
"""[m] One stands this far before the first edge: a pace, at least what the toes need; the most that has room."""
ENDS = 3
"""Steps at each end that say a flight's direction there: of a scan's single one it is 10° wrong, and winders turn."""
BESIDE = (0.05, 0.08, 0.11)
"""[m] So far before a step's face, half-way up, the nearest ground is that face: within a tread, beyond its noise."""
GATE = 0.2
"""[m] To either side of the line in which stairs are begun and left: the sway of a pace, the scatter of a pose."""
SQUARE = np.radians(20)
"""[rad] A path that crosses an edge within this of square is in the line of the stairs."""
STRAIGHT_FLIGHT = np.radians(30)
"""[rad] A flight that turns by less has one line; more are winders, which are met where the path meets them."""


@dataclass(frozen=True, slots=True)
class Flight:
    """Stairs on a path.

    Attributes:
        start: Arc length of the first edge [m].
        end: Of the last one [m].
        enter: Direction in which one walks square over the first edge [rad].
        leave: The same of the last one.
        rise: Mean height of a step, negative going down [m].
        foot: Place on the first edge in the line of the stairs (x, y) [m].
        head: The same on the last one.
    """

    start: float
    end: float
    enter: float
    leave: float
    rise: float
    foot: tuple[float, float]
    head: tuple[float, float]

    def before(self, x: float, y: float) -> tuple[float, float]:
        """How far a place is before the first edge [m], and how far to the left of the line [m]."""
        ahead, aside = self.foot[0] - x, self.foot[1] - y
        c, s = cos(self.enter), sin(self.enter)
        return ahead * c + aside * s, ahead * s - aside * c


def find_stairs(path: FloatArray, s: FloatArray, field: Field) -> tuple[Flight, ...]:
    """The flights on a path, contact points (n, 3) at arc lengths (n,), with the directions of their ends."""
    flights = [steps for steps in find_flights(path[:, 2], s) if abs(steps[0].amount) >= LEAST_EDGE]
    return tuple(_flight(path, s, steps, field) for steps in flights)


def _flight(path: FloatArray, s: FloatArray, steps: list[Feature], field: Field) -> Flight:
    """A straight flight has the line that its middle shows, wherever the path begins and leaves it.

    Beside a corner of a tread the nearest ground is the corner, so the ends are looked at again in that line; where it
    does not meet them squarely either, they are winders, and are met where the path meets them.
    """
    edges = np.array([at(path, s, step.start)[:2] for step in steps])
    along = at(path, s, steps[-1].end + BESIDE[-1]) - at(path, s, steps[0].start - BESIDE[-1])
    quarter = len(steps) // 4
    on_path = _faces(path, s, steps, edges, _tangents(path, s, steps), field)
    line = _unit(on_path[quarter : len(steps) - quarter].sum(axis=0), along[:2])
    middle = at(path, s, 0.5 * (steps[0].start + steps[-1].end))[:2]
    in_line = middle + ((edges - middle) @ line)[:, None] * line
    faces = _faces(path, s, steps, in_line, np.tile(line, (len(steps), 1)), field)
    ends = [_unit(faces[rows].sum(axis=0), line) for rows in (slice(ENDS), slice(-ENDS, None))]
    if min(float(end @ line) for end in ends) > cos(STRAIGHT_FLIGHT):
        edges, ends = in_line, [_unit(faces.sum(axis=0), line)] * 2
    else:
        ends = [_unit(on_path[rows].sum(axis=0), along[:2]) for rows in (slice(ENDS), slice(-ENDS, None))]
    enter, leave = (atan2(end[1], end[0]) for end in ends)
    rise = float(np.mean([step.amount for step in steps]))
    foot, head = ((float(x), float(y)) for x, y in edges[[0, -1]])
    return Flight(steps[0].start, steps[-1].end, enter, leave, rise, foot, head)


def _faces(
    path: FloatArray, s: FloatArray, steps: list[Feature], edges: FloatArray, ways: FloatArray, field: Field
) -> FloatArray:
    """Square to each step's face at a place on its edge, as one walks; shorter where the field is unsure, (k, 2)."""
    up = float(np.sign(steps[0].amount))
    height = np.array([at(path, s, step.start - up * BESIDE[-1])[2] + 0.5 * abs(step.amount) for step in steps])
    places = edges[:, None, :] - up * np.array(BESIDE)[:, None] * ways[:, None, :]
    z = np.broadcast_to(height[:, None, None], (*places.shape[:2], 1))
    distance, gradient = field(np.concatenate([places, z], axis=2).reshape(-1, 3))
    away = np.where(np.isfinite(distance)[:, None], gradient[:, :2], 0.0)  # down the stairs
    faces: FloatArray = -up * away.reshape(len(steps), len(BESIDE), 2).sum(axis=1)
    return faces


def _tangents(path: FloatArray, s: FloatArray, steps: list[Feature]) -> FloatArray:
    moves = [at(path, s, step.start + BESIDE[-1]) - at(path, s, step.start - BESIDE[-1]) for step in steps]
    return np.array([_unit(move[:2], move[:2]) for move in moves])


def _unit(vector: FloatArray, otherwise: FloatArray) -> FloatArray:
    """The direction of a vector; of the other one where it points backwards, or nowhere."""
    chosen = vector if vector @ otherwise > 0.0 else otherwise
    return chosen / max(hypot(*chosen), 1e-9)


def at(path: FloatArray, s: FloatArray, where: float) -> FloatArray:
    """The contact point at an arc length, shape (3,)."""
    return np.array([np.interp(where, s, path[:, k]) for k in range(3)])


def obliqueness(path: FloatArray, s: FloatArray, flights: tuple[Flight, ...]) -> float:
    """How far from square the path crosses the first or last edge of a flight, at worst [rad]."""
    edges = [edge for flight in flights for edge in ((flight.start, flight.enter), (flight.end, flight.leave))]
    return max((abs(wrap(_crossed(path, s, edge) - facing)) for edge, facing in edges), default=0.0)


def as_walked(path: FloatArray, s: FloatArray, flights: tuple[Flight, ...]) -> tuple[Flight, ...]:
    """The flights, met as the path does where it could not be square."""
    walked = []
    for flight in flights:
        start, end = _crossed(path, s, flight.start), _crossed(path, s, flight.end)
        if abs(wrap(start - flight.enter)) > SQUARE:
            x, y, _ = at(path, s, flight.start).tolist()
            flight = replace(flight, enter=start, foot=(x, y))
        if abs(wrap(end - flight.leave)) > SQUARE:
            x, y, _ = at(path, s, flight.end).tolist()
            flight = replace(flight, leave=end, head=(x, y))
        walked.append(flight)
    return tuple(walked)


def _crossed(path: FloatArray, s: FloatArray, edge: float) -> float:
    """The direction in which a path crosses an edge [rad]."""
    move = at(path, s, edge + BESIDE[-1]) - at(path, s, edge - BESIDE[-1])
    return atan2(move[1], move[0])


def places_to_stand(
    path: FloatArray, s: FloatArray, flights: tuple[Flight, ...], room: Callable[[FloatArray], FloatArray]
) -> list[tuple[FloatArray, bool]]:
    """Before and behind each flight a place in its line, (3,), in order; left out where there is no room for one.

    With each, whether the way from there leads over stairs.

    Args:
        path: Contact points [m], shape (n, 3).
        s: Their arc lengths [m].
        flights: On it.
        room: That the body has at places (m, 3) [m].
    """
    places: list[tuple[FloatArray, bool]] = []
    for i, flight in enumerate(flights):
        before = flight.start - flights[i - 1].end if i > 0 else np.inf
        behind = flights[i + 1].start - flight.end if i + 1 < len(flights) else 2 * (float(s[-1]) - flight.end)
        foot = np.array([*flight.foot, at(path, s, flight.start - BESIDE[-1])[2]])
        head = np.array([*flight.head, at(path, s, flight.end + BESIDE[-1])[2]])
        ahead, aside = flight.before(*path[0, :2])
        if i == 0 and ahead <= FEET[0] and abs(aside) <= GATE:
            before = 0.0  # one who stands there already
        for edge, facing, sign, gap in ((foot, flight.enter, -1.0, before), (head, flight.leave, 1.0, behind)):
            feet = np.array([back for back in FEET if back <= 0.5 * gap])
            steps = sign * feet[:, None] * np.array([cos(facing), sin(facing), 0.0])
            if len(feet) and len(free := np.flatnonzero(room(edge + steps) >= ROOM_TO_STAND)):
                places.append((edge + steps[free[0]], sign < 0.0))
    return places

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
Room = Callable[[FloatArray], FloatArray]
"""Free room around a body that stands at (m, 3): distance to what stops it less its radius [m], shape (m,)."""

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
ELBOW_ROOM = 0.35
"""[m] To either side of the body a person walks at ease."""
ASIDE = np.linspace(-ELBOW_ROOM, ELBOW_ROOM, 15)
"""[m] To either side of a flight's line, every 5 cm, where one that has more room is looked for."""
TURNED = np.radians(10)
"""[rad] The line that the faces of a coarse or noisy stair show is turned by up to this."""
NEXT_TREAD = (0.35, 0.45, 0.55)
"""[m] So far behind an edge there is the next tread, if it is no landing: more than a tread is deep, up to `TREAD`."""
OTHER_GROUND = 0.4
"""[-] A share of a step: what is this far from the ground of a place is another floor."""
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


def find_stairs(path: FloatArray, s: FloatArray, field: Field, room: Room) -> tuple[Flight, ...]:
    """The flights on a path, with the directions of their ends.

    Args:
        path: Contact points [m], shape (n, 3).
        s: Their arc lengths [m], shape (n,).
        field: Of the ground.
        room: Of the person.
    """
    pieces = [steps for steps in find_flights(path[:, 2], s) if abs(steps[0].amount) >= LEAST_EDGE]
    flights: list[tuple[list[Feature], Flight]] = []
    for steps in pieces:
        flight = _flight(path, s, steps, field, room)
        if flights and _goes_on(path, s, *flights[-1], steps, flight, field):
            steps = flights.pop()[0] + steps
            flight = _flight(path, s, steps, field, room)
        flights.append((steps, flight))
    return tuple(flight for _, flight in flights)


def _goes_on(
    path: FloatArray, s: FloatArray, first: list[Feature], a: Flight, then: list[Feature], b: Flight, field: Field
) -> bool:
    """Whether two pieces are one flight, on a tread of which the path goes aside: a tread on, there is the next step.

    Behind a landing, or round a corner, there is none: a landing is longer.
    """
    if a.rise * b.rise < 0.0:
        return False
    if len(first) >= len(then):  # the longer one knows the line
        x, y, facing, z, rise = *a.head, a.leave, at(path, s, a.end + BESIDE[-1])[2], a.rise
    else:
        x, y, facing, z, rise = *b.foot, b.enter + np.pi, at(path, s, b.start - BESIDE[-1])[2], -b.rise
    on = np.array(NEXT_TREAD)
    places = np.column_stack([x + on * cos(facing), y + on * sin(facing), np.full(len(on), z + rise)])
    return bool(field(places)[0].min() < OTHER_GROUND * abs(rise))


def _flight(path: FloatArray, s: FloatArray, steps: list[Feature], field: Field, room: Room) -> Flight:
    """A straight flight has the line that its middle shows, wherever the path begins and leaves it.

    The faces say only roughly where it leads to, and the path not where its middle is: its sides do. Beside a corner of
    a tread the nearest ground is the corner, so the ends are looked at again in that line; where it does not meet them
    squarely either, they are winders, and are met where the path meets them.
    """
    edges = np.array([at(path, s, step.start)[:2] for step in steps])
    along = at(path, s, steps[-1].end + BESIDE[-1]) - at(path, s, steps[0].start - BESIDE[-1])
    quarter = len(steps) // 4
    on_path = _faces(path, s, steps, edges, _tangents(path, s, steps), field)
    line = _unit(on_path[quarter : len(steps) - quarter].sum(axis=0), along[:2])
    middle = at(path, s, 0.5 * (steps[0].start + steps[-1].end))[:2]
    in_line, line = _with_most_room(path, s, steps, middle + ((edges - middle) @ line)[:, None] * line, line, room)
    faces = _faces(path, s, steps, in_line, np.tile(line, (len(steps), 1)), field)
    ends = [_unit(faces[rows].sum(axis=0), line) for rows in (slice(ENDS), slice(-ENDS, None))]
    if min(float(end @ line) for end in ends) > cos(STRAIGHT_FLIGHT):
        edges, ends = in_line, [line, line]
    else:
        ends = [_unit(on_path[rows].sum(axis=0), along[:2]) for rows in (slice(ENDS), slice(-ENDS, None))]
    enter, leave = (atan2(end[1], end[0]) for end in ends)
    rise = float(np.mean([step.amount for step in steps]))
    foot, head = ((float(x), float(y)) for x, y in edges[[0, -1]])
    return Flight(steps[0].start, steps[-1].end, enter, leave, rise, foot, head)


def _with_most_room(
    path: FloatArray, s: FloatArray, steps: list[Feature], edges: FloatArray, line: FloatArray, room: Room
) -> tuple[FloatArray, FloatArray]:
    """Where a line near that of a flight crosses its edges (k, 2), and its direction: the line with most room.

    The sum over the treads counts, so that a thing beside one of them does not turn the line; of what is more than
    `ELBOW_ROOM` nothing, so that on wide stairs the line is that of the faces, where the path is.
    """
    places = np.array([edges[0] - FEET[-1] * line, *(edges[:-1] + edges[1:]) / 2, edges[-1] + FEET[-1] * line])
    starts = np.array([step.start for step in steps])
    between = [starts[0] - BESIDE[-1], *(starts[:-1] + starts[1:]) / 2, starts[-1] + BESIDE[-1]]
    z = np.array([at(path, s, where)[2] for where in between])
    normal = np.array([-line[1], line[0]])
    beside = np.empty((len(places), len(ASIDE), 3))
    beside[..., :2], beside[..., 2] = places[:, None, :] + ASIDE[:, None] * normal, z[:, None]
    free = np.minimum(room(beside.reshape(-1, 3)).reshape(beside.shape[:2]), ELBOW_ROOM)
    along = (places - places[0]) @ line
    share = along / along[-1]
    first, last = (ends.ravel() for ends in np.meshgrid(np.arange(len(ASIDE)), np.arange(len(ASIDE)), indexing="ij"))
    column = np.rint(first[:, None] + (last - first)[:, None] * share).astype(int)
    gained = free[np.arange(len(places)), column].sum(axis=1)
    turned = np.abs(ASIDE[last] - ASIDE[first]) > along[-1] * sin(TURNED)
    moved = np.abs(ASIDE[first]) + np.abs(ASIDE[last])
    best = np.lexsort((moved, -gained, turned))[0]
    a, b = ASIDE[first[best]], ASIDE[last[best]]
    shift = a + (b - a) * ((edges - places[0]) @ line) / along[-1]
    direction = along[-1] * line + (b - a) * normal
    return edges + shift[:, None] * normal, direction / hypot(*direction)


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
    path: FloatArray, s: FloatArray, flights: tuple[Flight, ...], room: Room
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

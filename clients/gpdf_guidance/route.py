"""A trajectory as a person walks it: arc length, the corridor to either side, and what lies on the way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import isfinite

import numpy as np
from gpdf_client import Trajectory
from numpy.typing import NDArray

from gpdf_guidance.features import Feature, find_features, wrap
from gpdf_guidance.stairs import GATE, SQUARE, Field, Flight, as_walked, find_stairs

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
Room = Callable[[FloatArray], FloatArray]
"""Free room around a body that stands at (m, 3): distance to what stops it less its radius [m], shape (m,)."""

SPACING = 0.1
"""[m] Between samples of a route: half of what a person sways."""
FINER = 5
"""Places a sample (odd) at which the room on the path itself is asked for: what juts out 1 cm is seen."""
MARGIN = 0.1
"""[m] Room that a corridor leaves beside it: a swinging arm; in a tight place half of the path's own room."""
WIDEST = 0.8
"""[m] A corridor is looked for this far to either side; more changes no instruction."""
ELBOW_ROOM = 0.35
"""[m] To either side of the body a person walks at ease."""
FOOTING = 0.15
"""[m] Half of a stance: on stairs the middle of the body stays so far from their sides."""
OTHER_GROUND = 0.7
"""[-] A share of a step: what is this far from the ground of a place is another tread or floor, not a field's error."""
KEEP_OFF = 0.35
"""[m] Half a pace: elsewhere one keeps so far from the edges of stairs, but in their line."""
INTO_STAIRS = 0.6
"""[m] The line goes on over the first treads, and begins before the last ones: two of them."""
BACK, AHEAD = 1.5, 2.5
"""[m] A pose is looked for this far behind and ahead of the last one: a path that passes itself is not confused."""


@dataclass(frozen=True, slots=True)
class Pose:
    """A person's place (x, y, z of the ground) [m], heading [rad], when it was measured [s], and how well [m]."""

    position: tuple[float, float, float]
    heading: float
    stamp: float
    accuracy: float = 0.0

    @property
    def is_finite(self) -> bool:
        """Whether all of its numbers are."""
        return all(map(isfinite, (*self.position, self.heading, self.stamp, self.accuracy)))


@dataclass(frozen=True, slots=True)
class Progress:
    """Where a pose is on a route: arc length `s` [m], `offset` to the left of the path [m]."""

    s: float
    offset: float


@dataclass(frozen=True, slots=True, eq=False)
class Route:
    """A path every `SPACING` [m]: ground (n, 3), arc length in plan (n,), heading (n,), and the corridor around it.

    Attributes:
        ground: Contact points [m].
        s: Arc length in plan [m].
        heading: Direction of the path, unwrapped [rad].
        room: Free room beside the body on the path [m].
        disc: The body's centre may be this far from the path in any direction [m].
        left: And this far to the left [m].
        right: And this far to the right [m].
        shift: The corridor's middle is this far to the left, where there is less than `ELBOW_ROOM` on one side [m].
        features: What a person is told of, in order.
        radius: Of the person's body [m].
        version: Of the scene that it was planned in.
        flights: Stairs, and how they are met squarely.
    """

    ground: FloatArray
    s: FloatArray
    heading: FloatArray
    room: FloatArray
    disc: FloatArray
    left: FloatArray
    right: FloatArray
    shift: FloatArray
    features: tuple[Feature, ...]
    radius: float
    version: int = 0
    flights: tuple[Flight, ...] = ()

    @property
    def length(self) -> float:
        """Length in plan [m]."""
        return float(self.s[-1])

    def at(self, s: float) -> FloatArray:
        """The contact point at arc length `s`, shape (3,)."""
        return np.array([np.interp(s, self.s, self.ground[:, k]) for k in range(3)])

    def middle_at(self, s: float) -> FloatArray:
        """Where to walk at arc length `s`, shape (2,): the path, moved to the corridor's middle where it is tight."""
        shift, heading = np.interp(s, self.s, self.shift), self.heading_at(s)
        middle: FloatArray = self.at(s)[:2] + shift * np.array([-np.sin(heading), np.cos(heading)])
        return middle

    def heading_at(self, s: float) -> float:
        """The path's direction at arc length `s` [rad]."""
        return float(np.interp(s, self.s, self.heading))

    def locate(self, pose: Pose, near: float) -> Progress:
        """Where a pose is on the path, close to arc length `near` [m]."""
        rows = self._window(near)
        a, b = self.ground[rows][:-1], self.ground[rows][1:]
        along = b - a
        share = ((np.array(pose.position) - a) * along).sum(axis=1) / np.maximum((along**2).sum(axis=1), 1e-12)
        share = np.clip(share, 0.0, 1.0)
        foot = a + share[:, None] * along
        away = np.array(pose.position) - foot
        i = int((away**2).sum(axis=1).argmin())
        s = float(self.s[rows][i] + share[i] * (self.s[rows][i + 1] - self.s[rows][i]))
        side = along[i, 0] * away[i, 1] - along[i, 1] * away[i, 0]
        return Progress(s, float(np.copysign(np.hypot(*away[i, :2]), side)))

    def inside(self, places: FloatArray, near: float, slack: float = 0.0) -> BoolArray:
        """Whether the body's centre may be at `places` (m, 2): in the path's corridor, close to arc length `near`."""
        rows = self._window(near)
        away = places[:, None, :] - self.ground[None, rows, :2]
        forward = np.column_stack([np.cos(self.heading[rows]), np.sin(self.heading[rows])])
        along = (away * forward).sum(axis=2)
        across = forward[:, 0] * away[:, :, 1] - forward[:, 1] * away[:, :, 0]
        in_disc = np.hypot(along, across) <= self.disc[rows] + slack + 1e-9
        beside = np.abs(along) <= 0.5 * SPACING + 1e-9
        in_width = (across <= self.left[rows] + slack + 1e-9) & (across >= -self.right[rows] - slack - 1e-9)
        inside: BoolArray = (in_disc | (beside & in_width)).any(axis=1)
        return inside

    def _window(self, near: float) -> slice:
        first = int(np.searchsorted(self.s, near - BACK))
        last = int(np.searchsorted(self.s, near + AHEAD)) + 1
        return slice(min(first, len(self.s) - 2), max(last, first + 2))


def build_route(
    trajectory: Trajectory,
    room: Room,
    *,
    facing: float | None = None,
    room_low: Room | None = None,
    radius: float,
    field: Field | None = None,
    version: int = 0,
) -> Route:
    """Build the route of a trajectory.

    Args:
        trajectory: From the service.
        room: Free room around the person at places.
        facing: Where the person looks before the first step [rad]; the turn into the path is the first feature.
        room_low: The same for a body that ends at the hip: what it has more is head-height obstacles.
        radius: Of the person's body [m].
        field: The ground's; without it nothing is known of how stairs lie.
        version: Of the scene that the trajectory was planned in.
    """
    rough = arc_length(trajectory.ground)
    s = np.linspace(0.0, rough[-1], max(3, round(rough[-1] / SPACING) + 1))
    ground = np.column_stack([np.interp(s, rough, trajectory.ground[:, k]) for k in range(3)])
    heading = np.interp(s, rough, np.unwrap(trajectory.headings))
    free = _scan(ground, heading, room)
    middle = free.shape[1] // 2
    clear = _least_room(s, np.column_stack([trajectory.ground, rough]), room)
    margin = np.clip(0.5 * clear, 0.0, MARGIN)
    disc = np.maximum(clear - margin, 0.0)
    left, right = (np.maximum(_reach(side, margin), disc) for side in (free[:, middle:], free[:, middle::-1]))
    flights = find_stairs(trajectory.ground, rough, field) if field is not None else ()
    flights = as_walked(trajectory.ground, rough, flights)
    if field is not None and flights:
        nearest = np.abs(rough[None, :] - s[:, None]).argmin(axis=1)  # half-way up a step is no ground
        standing = np.column_stack([ground[:, :2], trajectory.ground[nearest, 2]])
        disc, left, right = _on_own_ground(standing, s, heading, flights, field, (disc, left, right))
        disc, left, right = (_through_gates(width, s, heading, flights) for width in (disc, left, right))
    over = _scan(ground, heading, room_low) - free if room_low is not None else np.zeros_like(free)
    features = find_features(
        _plan_and_height(trajectory.ground, rough), s, heading, left + right + 2 * (radius + margin), free, over, facing
    )
    return Route(ground, s, heading, clear, disc, left, right, _shift(left, right), features, radius, version, flights)


def _plan_and_height(ground: FloatArray, s: FloatArray) -> FloatArray:
    """(n, 4): x, y, z, arc length."""
    return np.column_stack([ground, s])


def arc_length(ground: FloatArray) -> FloatArray:
    """Arc length in plan of contact points (n, 3) [m], shape (n,)."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(ground[:, :2], axis=0).T))])


def _least_room(s: FloatArray, rough: FloatArray, room: Room) -> FloatArray:
    """Free room on the path around each sample, halfway to the next ones: what juts out between them counts."""
    fine = np.linspace(s[0], s[-1], FINER * (len(s) - 1) + 1)
    around = room(np.column_stack([np.interp(fine, rough[:, 3], rough[:, k]) for k in range(3)]))
    padded = np.pad(around, FINER // 2, mode="edge")
    least: FloatArray = np.lib.stride_tricks.sliding_window_view(padded, FINER)[::FINER].min(axis=1)
    return least


def _scan(ground: FloatArray, heading: FloatArray, room: Room) -> FloatArray:
    """Free room at offsets from right to left of each sample, shape (n, k), k odd."""
    places = _places_beside(ground, heading)
    return room(places.reshape(-1, 3)).reshape(places.shape[:2])


def _places_beside(ground: FloatArray, heading: FloatArray) -> FloatArray:
    """Places from right to left of each sample, up to `WIDEST`, shape (n, k, 3), k odd."""
    offsets = np.arange(-round(WIDEST / SPACING * 2), round(WIDEST / SPACING * 2) + 1) * SPACING / 2
    normal = np.column_stack([-np.sin(heading), np.cos(heading), np.zeros(len(heading))])
    places: FloatArray = ground[:, None, :] + offsets[None, :, None] * normal[:, None, :]
    return places


def _reach(free: FloatArray, margin: FloatArray) -> FloatArray:
    """How far from the first column all leave the margin [m], shape (n,)."""
    blocked = free < margin[:, None]
    blocked[:, 0] = False  # the path itself is certified
    first = np.where(blocked.any(axis=1), blocked.argmax(axis=1), free.shape[1])
    reach: FloatArray = (first - 1) * SPACING / 2
    return reach


def _on_own_ground(
    ground: FloatArray,
    s: FloatArray,
    heading: FloatArray,
    flights: tuple[Flight, ...],
    field: Field,
    widths: tuple[FloatArray, FloatArray, FloatArray],
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Disc, left and right of a corridor without ground of another height than the path's, near stairs.

    A body that climbs them may stand on the lowest tread from its side, or with half a foot over the rim of a landing;
    a person who cannot see may not.
    """
    disc, left, right = (width.copy() for width in widths)
    near = np.any([(s >= f.start - AHEAD) & (s <= f.end + AHEAD) for f in flights], axis=0)
    on = np.any([(s >= f.start) & (s <= f.end) for f in flights], axis=0)[near]
    keep_off, here = np.where(on, FOOTING, KEEP_OFF), ground[near]
    step = min(abs(flight.rise) for flight in flights)
    around = [_places_beside(here, heading[near] + angle) for angle in np.linspace(0.0, np.pi, 4, endpoint=False)]
    places = np.concatenate(around, axis=1)
    other = field(places.reshape(-1, 3))[0].reshape(places.shape[:2]) > OTHER_GROUND * step
    edges = places[other]
    for row, (place, off) in enumerate(zip(here, keep_off + OTHER_GROUND * step, strict=True)):
        beside = edges[np.abs(edges[:, 2] - place[2]) < 0.5 * step, :2] - place[:2]
        gap = float(np.hypot(*beside.T).min(initial=np.inf))
        disc[np.flatnonzero(near)[row]] = min(disc[near][row], max(gap - off, 0.5 * gap))
    middle = around[0].shape[1] // 2
    for side, columns in ((left, slice(middle, 2 * middle + 1)), (right, slice(middle, None, -1))):
        reach = _reach(np.where(other[:, columns], -1.0, 1.0), np.zeros(len(here)))
        footing = np.maximum(reach - keep_off - OTHER_GROUND * step, 0.5 * reach)
        side[near] = np.where(reach < WIDEST - 1e-9, np.minimum(side[near], footing), side[near])
    return disc, left, right


def _through_gates(width: FloatArray, s: FloatArray, heading: FloatArray, flights: tuple[Flight, ...]) -> FloatArray:
    """A corridor's width, at most `GATE` where the path is straight before, on and behind the ends of stairs."""
    narrowed = width.copy()
    for flight in flights:
        for edge, facing, sign in ((flight.start, flight.enter, 1.0), (flight.end, flight.leave, -1.0)):
            inward = sign * (s - edge)
            straight = np.abs([wrap(angle - facing) for angle in heading]) <= SQUARE
            bent = inward[(inward < 0.0) & ~straight].max(initial=-np.inf)
            gate = (inward > max(bent, -AHEAD)) & (inward <= INTO_STAIRS)
            narrowed[gate] = np.minimum(narrowed[gate], GATE)
    return narrowed


def _shift(left: FloatArray, right: FloatArray) -> FloatArray:
    """How far to the left of the path there is `ELBOW_ROOM` on both sides, or as much on one as on the other [m]."""
    lack_left, lack_right = np.maximum(ELBOW_ROOM - left, 0.0), np.maximum(ELBOW_ROOM - right, 0.0)
    shift: FloatArray = np.clip(0.5 * (left - right), -lack_left, lack_right)
    return shift

"""A trajectory as a person walks it: arc length, the corridor to either side, and what lies on the way."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite

import numpy as np
from gpdf_client import Trajectory
from numpy.typing import NDArray

from gpdf_guidance.corridor import (
    SPACING,
    beside_steps,
    least_room,
    margin_of,
    middle_of,
    on_own_ground,
    other_ground,
    scan,
    through_gates,
    where_there_is_room,
)
from gpdf_guidance.features import Feature, find_features
from gpdf_guidance.landmarks import with_places
from gpdf_guidance.stairs import Field, Flight, Room, as_walked, find_stairs

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

BACK, AHEAD = 1.5, 2.5
"""[m] A pose is looked for this far behind and ahead of the last one: a path that passes itself is not confused."""


@dataclass(frozen=True, slots=True)
class Pose:
    """A person's place (x, y, z of the ground) [m], heading [rad], when it was measured [s], and how well [m].

    `steps` are those made since the stream began, None where nothing counts them.
    """

    position: tuple[float, float, float]
    heading: float
    stamp: float
    accuracy: float = 0.0
    steps: int | None = None

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
        hidden_height: What stands no higher than this over the ground may be on the way unseen [m].
        places: Named places of the scene [m].
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
    hidden_height: float = 0.0
    places: Mapping[str, Sequence[float]] = dataclasses.field(default_factory=dict)

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
    room_level: Room | None = None,
    field: Field | None = None,
    version: int = 0,
    places: Mapping[str, Sequence[float]] | None = None,
) -> Route:
    """Build the route of a trajectory.

    Args:
        trajectory: From the service.
        room: Free room around the person at places.
        facing: Where the person looks before the first step [rad]; the turn into the path is the first feature.
        room_low: The same for a body that ends at the hip: what it has more is head-height obstacles.
        radius: Of the person's body [m].
        room_level: The same for one that takes no step; without it nothing keeps off steps beside the path.
        field: The ground's; without it nothing is known of how stairs lie.
        version: Of the scene that the trajectory was planned in.
        places: Named places of the scene [m]; those on the way are told of.
    """
    rough = arc_length(trajectory.ground)
    s = np.linspace(0.0, rough[-1], max(3, round(rough[-1] / SPACING) + 1))
    ground = np.column_stack([np.interp(s, rough, trajectory.ground[:, k]) for k in range(3)])
    heading = np.interp(s, rough, np.unwrap(trajectory.headings))
    free = scan(ground, heading, room)
    clear = least_room(s, trajectory.ground, rough, room)
    corridor = where_there_is_room(free, clear)
    width = corridor.left + corridor.right + 2 * (radius + margin_of(clear))
    flights: tuple[Flight, ...] = ()
    if field is not None and (flights := find_stairs(trajectory.ground, rough, field, room)):
        flights = as_walked(trajectory.ground, rough, flights)
        nearest = np.abs(rough[None, :] - s[:, None]).argmin(axis=1)  # half-way up a step is no ground
        standing = np.column_stack([ground[:, :2], trajectory.ground[nearest, 2]])
        corridor = on_own_ground(corridor, standing, s, heading, flights, field)
        corridor = through_gates(corridor, s, heading, flights)
    if room_level is not None:
        away = scan(ground, heading, room_level) + radius
        corridor = beside_steps(corridor, away, s, ground, flights, other_ground(ground, heading, field))
    over = scan(ground, heading, room_low) - free if room_low is not None else np.zeros_like(free)
    features = find_features(np.column_stack([trajectory.ground, rough]), s, heading, width, free, over, facing)
    features = with_places(features, ground, s, heading, places or {})
    shift = middle_of(corridor)
    return Route(ground, s, heading, clear, *corridor, shift, features, radius, version, flights, places=places or {})


def arc_length(ground: FloatArray) -> FloatArray:
    """Arc length in plan of contact points (n, 3) [m], shape (n,)."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(ground[:, :2], axis=0).T))])


def join(legs: list[Trajectory]) -> Trajectory:
    """One trajectory of several, each of which begins where the one before it ends."""
    ends = np.cumsum([0.0, *(leg.duration for leg in legs)])
    times = [leg.times - leg.times[0] + end for leg, end in zip(legs, ends, strict=False)]
    parts = [(leg.positions, leg.ground, time, leg.headings) for leg, time in zip(legs, times, strict=True)]
    joined = [
        np.concatenate([part[1 if i else 0 :] for i, part in enumerate(column)]) for column in zip(*parts, strict=True)
    ]
    return Trajectory(*joined)

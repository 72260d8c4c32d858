"""The corridor around a path: how far from it the middle of the body may be, by the room and by the ground's edges."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gpdf_guidance.features import wrap
from gpdf_guidance.stairs import ELBOW_ROOM, GATE, LEAST_EDGE, OTHER_GROUND, SQUARE, Field, Flight, Room

FloatArray = NDArray[np.float64]
SPACING = 0.1
"""[m] Between samples of a route: half of what a person sways."""
FINER = 5
"""Places a sample (odd) at which the room on the path itself is asked for: what juts out 1 cm is seen."""
MARGIN = 0.1
"""[m] Room that a corridor leaves beside it: a swinging arm; in a tight place half of the path's own room."""
WIDEST = 0.8
"""[m] A corridor is looked for this far to either side; more changes no instruction."""
FOOTING = 0.15
"""[m] Half of a stance: on stairs the middle of the body stays so far from their sides."""
OTHER_TREAD = 0.7
"""[-] A share of a step: what is this far from a tread, which is rough at its own edges, is another one."""
KEEP_OFF = 0.35
"""[m] Half a pace: elsewhere one keeps so far from the edges of stairs, but in their line."""
EDGE_SEEN = 0.075
"""[m] Columns 5 cm apart find an edge of points up to 14 cm apart, if one is this near to it."""
INTO_STAIRS = 0.6
"""[m] The line goes on over the first treads, and begins before the last ones: two of them."""
BESIDE_STAIRS = 2.5
"""[m] So far before and behind them the ground's edges are looked for: a pose is looked for as far ahead."""
DIRECTIONS = 4
"""Lines through each sample on which other ground is looked for: with those of its neighbours, every 5 cm or so."""


class Corridor(NamedTuple):
    """The middle of the body may be so far from a path's samples [m], shape (n,): around, to the left, to the right."""

    disc: FloatArray
    left: FloatArray
    right: FloatArray


def scan(ground: FloatArray, heading: FloatArray, room: Room) -> FloatArray:
    """Free room at offsets from right to left of each sample, shape (n, k), k odd."""
    places = _places_beside(ground, heading)
    return room(places.reshape(-1, 3)).reshape(places.shape[:2])


def least_room(s: FloatArray, path: FloatArray, rough: FloatArray, room: Room) -> FloatArray:
    """Free room on the path around each sample, halfway to the next ones: what juts out between them counts.

    Args:
        s: Arc lengths of the samples [m], shape (n,).
        path: Contact points [m], shape (m, 3).
        rough: Their arc lengths [m], shape (m,).
        room: See `Room`.
    """
    fine = np.linspace(s[0], s[-1], FINER * (len(s) - 1) + 1)
    around = room(np.column_stack([np.interp(fine, rough, path[:, k]) for k in range(3)]))
    padded = np.pad(around, FINER // 2, mode="edge")
    least: FloatArray = np.lib.stride_tricks.sliding_window_view(padded, FINER)[::FINER].min(axis=1)
    return least


def where_there_is_room(free: FloatArray, clear: FloatArray, most: float = MARGIN) -> Corridor:
    """The corridor of the room alone, from `scan` and `least_room`, with at most so much left beside it [m]."""
    middle, margin = free.shape[1] // 2, margin_of(clear, most)
    disc = np.maximum(clear - margin, 0.0)
    left, right = (np.maximum(_reach(side < margin[:, None]), disc) for side in (free[:, middle:], free[:, middle::-1]))
    return Corridor(disc, left, right)


def margin_of(clear: FloatArray, most: float = MARGIN) -> FloatArray:
    """Room that a corridor leaves beside it where the path has `clear`, at most `most` [m]."""
    margin: FloatArray = np.clip(0.5 * clear, 0.0, most)
    return margin


def beside_steps(
    corridor: Corridor,
    away: FloatArray,
    s: FloatArray,
    ground: FloatArray,
    flights: tuple[Flight, ...],
    falls: NDArray[np.bool_],
) -> Corridor:
    """A corridor that ends half a pace before steps that the path passes; nobody takes one unheard.

    A path may begin right beside a ledge: only where its own height changes does it go over one, and only on the side
    of the other ground does the ledge end its corridor.

    Args:
        corridor: That of the room.
        away: Distance to all that stops who takes no step, at the places of `scan` [m], shape (n, k).
        s: Arc lengths of the samples [m], shape (n,).
        ground: Contact points there [m], shape (n, 3).
        flights: On the path; near them `on_own_ground` says more.
        falls: See `other_ground`.
    """
    middle = away.shape[1] // 2
    clear = away[:, middle]
    rise = np.abs(np.interp(s + SPACING, s, ground[:, 2]) - np.interp(s - SPACING, s, ground[:, 2]))
    at_edge = clear <= 0.5 * SPACING
    passed = ~at_edge | (rise < LEAST_EDGE)
    for flight in flights:
        passed &= (s < flight.start - BESIDE_STAIRS) | (s > flight.end + BESIDE_STAIRS)
    margin = margin_of(clear, KEEP_OFF)
    widths = [np.maximum(clear - margin, 0.0)]
    for side, other in ((away[:, middle:], falls[:, 0]), (away[:, middle::-1], falls[:, 1])):
        blocked = side < np.maximum(margin, EDGE_SEEN)[:, None]
        follows = at_edge[:, None] & np.logical_and.accumulate(blocked, axis=1)  # the ledge that it goes along
        reach = np.where(at_edge & other, 0.0, _reach(blocked & ~follows))
        widths.append(np.maximum(reach, widths[0]))
    return Corridor(*(np.where(passed, np.minimum(a, b), a) for a, b in zip(corridor, widths, strict=True)))


def other_ground(ground: FloatArray, heading: FloatArray, field: Field | None) -> NDArray[np.bool_]:
    """Whether within half a pace to the left and to the right of a path the ground has another height, shape (n, 2).

    Where nothing is known of the ground, it has. At a ledge's corner its foot is near: so half a pace of path counts.
    """
    if field is None:
        return np.ones((len(ground), 2), dtype=bool)
    places = _places_beside(ground, heading)
    middle, near = places.shape[1] // 2, round(2 * KEEP_OFF / SPACING)
    places = places[:, middle - near : middle + near + 1]
    other = field(places.reshape(-1, 3))[0].reshape(places.shape[:2]) > LEAST_EDGE
    sides = np.column_stack([other[:, near:].any(axis=1), other[:, : near + 1].any(axis=1)])
    along = round(KEEP_OFF / SPACING)
    padded = np.pad(sides, ((along, along), (0, 0)), mode="edge")
    found: NDArray[np.bool_] = np.any([padded[i : i + len(sides)] for i in range(2 * along + 1)], axis=0)
    return found


def on_own_ground(
    corridor: Corridor,
    ground: FloatArray,
    s: FloatArray,
    heading: FloatArray,
    flights: tuple[Flight, ...],
    field: Field,
) -> Corridor:
    """A corridor without ground of another height than the path's, near stairs.

    A body that climbs them may stand on the lowest tread from its side, or with half a foot over the rim of a landing;
    a person who cannot see may not.
    """
    near = np.any([(s >= f.start - BESIDE_STAIRS) & (s <= f.end + BESIDE_STAIRS) for f in flights], axis=0)
    on = np.any([(s >= f.start - SPACING) & (s <= f.end + SPACING) for f in flights], axis=0)[near]
    step = min(abs(flight.rise) for flight in flights)
    least = step * np.where(on, OTHER_TREAD, OTHER_GROUND)
    keep_off = np.where(on, FOOTING, KEEP_OFF) + least  # an edge is seen that far behind itself
    angles = np.linspace(0.0, np.pi, DIRECTIONS, endpoint=False)
    places = np.stack([_places_beside(ground[near], heading[near] + angle) for angle in angles])
    away = [_from_ground(places, np.interp(s[near] + shift, s, ground[:, 2]), field) for shift in (-SPACING, SPACING)]
    other = np.minimum(*away) > least[:, None]  # at a step's face, its foot and its tread are both own ground
    gap = _nearest_edge(ground[near], places[other], step)
    middle = places.shape[2] // 2
    sides = [_reach(other[0, :, middle:]), _reach(other[0, :, middle::-1])]
    narrowed = [width.copy() for width in corridor]
    for width, reach in zip(narrowed, (gap, *sides), strict=True):
        edge = reach < WIDEST
        footing = np.maximum(reach - keep_off, 0.5 * reach)
        width[near] = np.where(edge, np.minimum(width[near], footing), width[near])
    return Corridor(*narrowed)


def through_gates(corridor: Corridor, s: FloatArray, heading: FloatArray, flights: tuple[Flight, ...]) -> Corridor:
    """A corridor at most `GATE` to either side where the path is straight before, on and behind the ends of stairs."""
    gate = np.zeros(len(s), dtype=bool)
    for flight in flights:
        for edge, facing, sign in ((flight.start, flight.enter, 1.0), (flight.end, flight.leave, -1.0)):
            inward = sign * (s - edge)
            straight = np.abs([wrap(angle - facing) for angle in heading]) <= SQUARE
            bent = inward[(inward < 0.0) & ~straight].max(initial=-BESIDE_STAIRS)
            gate |= (inward > bent) & (inward <= INTO_STAIRS)
    return Corridor(*(np.where(gate, np.minimum(width, GATE), width) for width in corridor))


def middle_of(corridor: Corridor) -> FloatArray:
    """How far to the left of the path there is `ELBOW_ROOM` on both sides, or as much on one as on the other [m]."""
    lack_left, lack_right = (np.maximum(ELBOW_ROOM - side, 0.0) for side in (corridor.left, corridor.right))
    shift: FloatArray = np.clip(0.5 * (corridor.left - corridor.right), -lack_left, lack_right)
    return shift


def _places_beside(ground: FloatArray, heading: FloatArray) -> FloatArray:
    """Places from right to left of each sample, up to `WIDEST`, shape (n, k, 3), k odd."""
    offsets = np.arange(-round(WIDEST / SPACING * 2), round(WIDEST / SPACING * 2) + 1) * SPACING / 2
    normal = np.column_stack([-np.sin(heading), np.cos(heading), np.zeros(len(heading))])
    places: FloatArray = ground[:, None, :] + offsets[None, :, None] * normal[:, None, :]
    return places


def _reach(blocked: NDArray[np.bool_]) -> FloatArray:
    """How far from the first column, the path itself, the way aside is free, columns (n, k) from there on [m]."""
    blocked = blocked.copy()
    blocked[:, 0] = False  # it is certified
    first = np.where(blocked.any(axis=1), blocked.argmax(axis=1), blocked.shape[1])
    reach: FloatArray = (first - 1) * SPACING / 2
    return reach


def _from_ground(places: FloatArray, heights: FloatArray, field: Field) -> FloatArray:
    """Distance to the ground of places (d, n, k, 3) at other heights (n,) [m], shape (d, n, k)."""
    moved = places.copy()
    moved[..., 2] = heights[:, None]
    return field(moved.reshape(-1, 3))[0].reshape(places.shape[:3])


def _nearest_edge(ground: FloatArray, edges: FloatArray, step: float) -> FloatArray:
    """Distance in plan of each place (n, 3) to the nearest of (k, 3) that is other ground for its height [m]."""
    nearest = np.empty(len(ground))
    for row, (x, y, z) in enumerate(ground):  # not all pairs at once: that takes a wearable's memory
        same = np.abs(edges[:, 2] - z) < 0.5 * step
        nearest[row] = np.hypot(edges[same, 0] - x, edges[same, 1] - y).min(initial=np.inf)
    return nearest

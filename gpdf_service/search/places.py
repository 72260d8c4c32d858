"""Obstacle places in plan: those that stand, in one tree, and those that move, in another one; what keeps off them.

A motion is proven over its whole length, against the places themselves. A pose is (x, y, θ). A disc that lies o ahead
of the body's centre moves by at most |ab| + |o| |Δθ| while the body moves evenly from pose a to pose b, and distances
are 1-Lipschitz: it keeps at least (d(a) + d(b) − |ab| − |o| |Δθ|) / 2 of room. Where that does not settle it, halve. A
place (x, y) is a pose of a single disc, which faces nowhere.
"""

from __future__ import annotations

from math import cos, hypot, pi, sin
from typing import NamedTuple

import numpy as np
from numba import njit

from gpdf_service.fields import Tree, find_nearest
from gpdf_service.fields.traversal import nearest_along, nearest_at, segment_distance2
from gpdf_service.fields.tree import NO_POINTS, Place, Scratch, make_scratch
from gpdf_service.kernel_cache import lean
from gpdf_service.types import FloatArray, IntArray


class Places(NamedTuple):
    """Two trees that are asked as one; either may be without points. Rows of what moves come after the others."""

    standing: Tree
    moving: Tree = NO_POINTS


@lean()
def nearest_of(places: Places, x: Place, scratch: Scratch) -> tuple[float, int]:
    """Exact distance to the nearest of the places [m], and its row before it was in a tree; 0 and −1 for none."""
    distance, row = 0.0, -1
    if len(places.standing.begin) >= 2:
        distance, at = nearest_along(places.standing, x, scratch)
        row = places.standing.order[at]
    if len(places.moving.begin) >= 2:
        near, at = nearest_at(places.moving, x, scratch)
        if row < 0 or near < distance:
            distance, row = near, len(places.standing.points) + places.moving.order[at]
    return distance, row


@lean()
def distance_at(places: Places, x: Place, scratch: Scratch) -> float:
    """Exact distance to the nearest of the places [m], 0 from what is no place, or where there are none."""
    return float(nearest_of(places, x, scratch)[0])


@njit(cache=True, nogil=True)
def nearest_to(places: Places, xy: FloatArray) -> tuple[float, int]:
    """`nearest_of` for a single place in plan, shape (2,)."""
    return nearest_of(places, (xy[0], xy[1], 0.0), make_scratch())


def nearest_places(places: Places, xy: FloatArray) -> tuple[FloatArray, IntArray]:
    """Exact distance from each of `xy`, shape (m, 2), to the nearest place [m], and its row before it was in a tree."""
    standing, moving = places
    xy = np.ascontiguousarray(xy)
    distance, row = find_nearest(standing, xy)
    row = standing.order[row]
    if len(moving.points):
        near, other = find_nearest(moving, xy)
        nearer = near < distance
        distance, row = np.minimum(distance, near), np.where(nearer, len(standing.points) + moving.order[other], row)
    return distance, row


RESOLUTION = 1e-3
"""[m] A motion is called blocked when a piece of this length cannot be proven clear."""
_RUN = 32
"""Pieces of a polyline that are looked at together first."""


@lean()
def disc_distance(obstacles: Places, pose: FloatArray, offset: float, scratch: Scratch) -> float:
    """Distance from the centre of the disc that lies `offset` ahead of a pose (3,) to the nearest obstacle [m]."""
    place = pose[0] + offset * cos(pose[2]), pose[1] + offset * sin(pose[2]), 0.0
    return float(distance_at(obstacles, place, scratch))


@njit(cache=True, nogil=True)
def is_clear(obstacles: Places, a: FloatArray, b: FloatArray, radius: float) -> bool:
    """Whether the whole segment from place a to place b, (2,), keeps `radius` from every obstacle, exactly.

    As with distances, nothing is clear where there are no obstacles at all: then nothing is known.
    """
    return is_straight_clear(obstacles, a, b, radius, make_scratch())


@lean()
def is_straight_clear(obstacles: Places, a: FloatArray, b: FloatArray, radius: float, scratch: Scratch) -> bool:
    """`is_clear` for a loop, which makes the scratch once."""
    limit, known = radius * radius, False
    for tree in obstacles:
        if len(tree.begin) >= 2:
            known = True
            if segment_distance2(tree, a, b, limit, limit, scratch)[0] < limit:
                return False
    return known


@njit(cache=True, nogil=True)
def is_motion_clear(obstacles: Places, a: FloatArray, b: FloatArray, offsets: FloatArray, radius: float) -> bool:
    """Whether all discs keep `radius` from every obstacle while the body moves evenly from pose a to pose b, (3,)."""
    for offset in offsets:  # noqa: SIM110 - compiled
        if not _is_disc_clear(obstacles, a, b, offset, radius):
            return False
    return True


@njit(cache=True, nogil=True)
def _is_disc_clear(obstacles: Places, a: FloatArray, b: FloatArray, offset: float, radius: float) -> bool:
    pieces, scratch = (np.empty((64, 2, 3)), np.empty((64, 2)), np.empty(3)), make_scratch()
    stack, room, _ = pieces
    stack[0] = 0.0
    stack[0, 0, : len(a)], stack[0, 1, : len(b)] = a, b
    for end in (0, 1):
        room[0, end] = disc_distance(obstacles, stack[0, end], offset, scratch)
        if room[0, end] < radius:
            return False
    top = 1
    while top > 0:
        top -= 1
        moved = farthest_moved(stack[top, 0], stack[top, 1], offset)
        if room[top, 0] + room[top, 1] - moved >= 2.0 * radius:
            continue
        if moved <= RESOLUTION or _halve(obstacles, pieces, top, offset, scratch) < radius:
            return False
        top += 2
    return True


@lean()
def farthest_moved(a: FloatArray, b: FloatArray, offset: float) -> float:
    """How far the disc that lies `offset` ahead moves at most from pose a to pose b, (3,) [m]."""
    return float(hypot(b[0] - a[0], b[1] - a[1]) + abs(offset * (b[2] - a[2])))


@lean()
def _halve(
    obstacles: Places, pieces: tuple[FloatArray, FloatArray, FloatArray], top: int, offset: float, scratch: Scratch
) -> float:
    """Put both halves of the piece at `top` there and behind it; the distance at its middle, which is written [m].

    The `pieces` are the poses at their ends (n, 2, 3), the room there (n, 2) [m], and room for a pose.
    """
    stack, room, middle = pieces
    for k in range(3):
        middle[k] = 0.5 * (stack[top, 0, k] + stack[top, 1, k])
        stack[top + 1, 0, k], stack[top + 1, 1, k], stack[top, 1, k] = middle[k], stack[top, 1, k], middle[k]
    between: float = disc_distance(obstacles, middle, offset, scratch)
    room[top + 1, 0], room[top + 1, 1], room[top, 1] = between, room[top, 1], between
    return between


@njit(cache=True, nogil=True)
def least_distance(
    obstacles: Places, poses: FloatArray, offsets: FloatArray, resolution: float
) -> tuple[float, FloatArray]:
    """Lower bound of the distance of all discs to the obstacles on a way through poses (n, 3) [m], and where (2,) [m].

    The body moves evenly from pose to pose. The bound is within `resolution` of the least that was found; of a
    cylinder, whose way is straight from pose to pose, it is that.
    """
    if len(offsets) == 1 and offsets[0] == 0.0:
        return _least_of_straight(obstacles, poses)
    at, scratch = np.zeros((len(offsets), len(poses))), make_scratch()
    best, found, disc = np.inf, poses[0].copy(), 0.0
    for k in range(len(offsets)):
        for i in range(len(poses)):
            at[k, i] = at[k, i - 1] - farthest_moved(poses[i - 1], poses[i], offsets[k]) if i > 0 else -np.inf
            if at[k, i] >= best:  # at least so far away, which is all that needs to be known
                continue
            at[k, i] = disc_distance(obstacles, poses[i], offsets[k], scratch)
            if at[k, i] < best:
                best, disc, found[:] = at[k, i], offsets[k], poses[i]
    pieces = stack, room, middle = np.empty((64, 2, 3)), np.empty((64, 2)), np.empty(3)
    for k in range(len(offsets)):
        for i in range(len(poses) - 1):
            stack[0, 0], stack[0, 1], room[0, 0], room[0, 1], top = poses[i], poses[i + 1], at[k, i], at[k, i + 1], 1
            while top > 0:
                top -= 1
                if (
                    0.5 * (room[top, 0] + room[top, 1] - farthest_moved(stack[top, 0], stack[top, 1], offsets[k]))
                    >= best - resolution
                ):
                    continue
                between = _halve(obstacles, pieces, top, offsets[k], scratch)
                if between < best:
                    best, disc, found[:] = between, offsets[k], middle
                top += 2
    where = np.array([found[0] + disc * cos(found[2]), found[1] + disc * sin(found[2])])
    return best - resolution, where


@njit(cache=True, nogil=True)
def _least_of_straight(obstacles: Places, poses: FloatArray) -> tuple[float, FloatArray]:
    """`least_distance` of the polyline itself.

    A run of it that is L long lies within √(L² − c²)/2 of its chord of length c. It is passed over if nothing is so
    near to the chord that it could hold the least, else it is halved.
    """
    where, along, runs = (
        poses[0, :2].copy(),
        np.zeros(len(poses)),
        np.empty((len(poses) // _RUN + 2 * _RUN, 2), np.int64),
    )
    best: float = _find_least(obstacles, poses, along, runs, make_scratch(), where)
    return best, where


@lean()
def _find_least(
    obstacles: Places, poses: FloatArray, along: FloatArray, runs: IntArray, scratch: Scratch, where: FloatArray
) -> float:
    """See `_least_of_straight`: the least, which is written `where`; `along` is 0, and the `runs` are those waiting."""
    for i in range(1, len(poses)):
        along[i] = along[i - 1] + hypot(poses[i, 0] - poses[i - 1, 0], poses[i, 1] - poses[i - 1, 1])
    best, top = distance_at(obstacles, (where[0], where[1], 0.0), scratch), 0
    for first in range(0, len(poses) - 1, _RUN):
        runs[top, 0], runs[top, 1], top = first, min(first + _RUN, len(poses) - 1), top + 1
    while top > 0:
        top -= 1
        first, last = runs[top]
        a, b, single = poses[first], poses[last], last == first + 1
        far2 = (b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2
        aside = 0.0 if single else 0.5 * np.sqrt(max((along[last] - along[first]) ** 2 - far2, 0.0))
        limit = (best + aside) ** 2
        least, share = limit, 0.0
        for tree in obstacles:
            found, at = segment_distance2(tree, a, b, least, 0.0 if single else limit, scratch)
            if found < least:
                least, share = found, at
        if least < limit and single:
            best = np.sqrt(least)
            where[0], where[1] = a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])
        elif least < limit:
            middle = (first + last) // 2
            runs[top, 0], runs[top, 1], runs[top + 1, 0], runs[top + 1, 1], top = first, middle, middle, last, top + 2
    return float(best)


@njit(cache=True, nogil=True)
def turned(pose: FloatArray, heading: float) -> FloatArray:
    """The pose turned on the spot to `heading`, the short way round."""
    made = pose.copy()
    made[2] += (heading - pose[2] + pi) % (2.0 * pi) - pi
    return made


@njit(cache=True, nogil=True)
def leap(a: FloatArray, b: FloatArray) -> FloatArray:
    """From pose a to pose b by a turn, a straight piece and a turn: the three poses after a."""
    made = np.empty((3, 3))
    made[0] = turned(a, np.arctan2(b[1] - a[1], b[0] - a[0]))
    made[1, :2], made[1, 2] = b[:2], made[0, 2]
    made[2] = turned(made[1], b[2])
    return made


@njit(cache=True, nogil=True)
def is_leap_clear(obstacles: Places, a: FloatArray, b: FloatArray, offsets: FloatArray, radius: float) -> bool:
    """Whether the body may go from pose a to pose b by a `leap`."""
    before, way = a, leap(a, b)
    for i in range(len(way)):  # a loop over its rows themselves would not know that they are in one piece
        if not is_motion_clear(obstacles, before, way[i], offsets, radius):
            return False
        before = way[i]
    return True

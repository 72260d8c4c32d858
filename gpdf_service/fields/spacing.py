"""How far apart the points on a surface are, and thinning to that."""

from __future__ import annotations

from math import pi, sqrt
from typing import NamedTuple

import numpy as np
from numba import njit

from gpdf_service.fields.heights import Sums, make_sums, quadric_rest
from gpdf_service.fields.order import corners_of, is_before, order_by
from gpdf_service.fields.shapes import EDGE, MOST, add, fit_axis, fit_pair, fit_plane, gather, nearest_half
from gpdf_service.fields.threads import run_chunked
from gpdf_service.fields.tree import Tree, build_tree, from_root, make_look, make_scratch, next_leaf, place_of
from gpdf_service.kernel_cache import lean
from gpdf_service.types import FloatArray, IntArray

SAMPLE = 4000
"""Points whose neighbours are looked at: the median's error is then about 1 %."""
NEIGHBOURS = 8
"""Of those, the one whose distance counts: it evens out scan lines."""


def estimate_spacing(points: FloatArray, tree: Tree | None = None) -> float:
    """Median distance between neighbours on the same surface [m]; 0 when all points are equal.

    The distance to the k-th neighbour on a surface with one point every s² is s √(k/π). Points have shape (n, 2 or 3).
    """
    k = min(NEIGHBOURS, len(points) - 1)
    if k < 1:
        return 0.0
    tree = build_tree(points) if tree is None else tree
    picked = np.ascontiguousarray(points[:: max(1, len(points) // SAMPLE)], dtype=np.float64)
    distance = np.empty(len(picked))
    run_chunked(lambda a, b: _kth_range(tree, picked[a:b], k, distance[a:b]), len(picked))
    return float(np.median(distance) * np.sqrt(np.pi / k))


@njit(cache=True, nogil=True)
def _kth_range(tree: Tree, places: FloatArray, k: int, distance: FloatArray) -> None:
    """Distance from each place to its k-th neighbour [m], where the place itself is the 0th."""
    scratch, near = make_scratch(), np.empty(k + 1)
    for i in range(len(places)):
        x, top = place_of(places[i]), from_root(scratch)
        near[:] = np.inf
        while True:
            leaf, top = next_leaf(tree.boxes, x, x, near[k], scratch, top)
            if leaf < 0:
                break
            for j in range(tree.begin[leaf + 1] - tree.begin[leaf]):
                block, square = tree.blocks[leaf], 0.0
                for axis in range(3):
                    square += (block[axis, j] - x[axis]) ** 2
                keep_least(near, square)
        distance[i] = sqrt(near[k])


@lean()
def keep_least(least: FloatArray, value: float) -> None:
    """Put a value among the `least` ones so far, which ascend, where it belongs; the largest one goes."""
    at = len(least) - 1
    if value >= least[at]:
        return
    while at > 0 and least[at - 1] > value:
        least[at] = least[at - 1]
        at -= 1
    least[at] = value


def local_shape(tree: Tree, rows: IntArray, spacing: float, noise: FloatArray) -> FloatArray:
    """The surface around each of `rows`: a disc (normal, radius, gap, bend) [m], shape (k, 6).

    A point stands for the surface up to half of the gap around it, the distance between neighbours on the surface. Its
    disc is smaller where the neighbourhood is nearly as thick as wide, no wider than that (a cable has none), and
    smaller by two deviations of `noise`, shape (k,) [m]: a point that may be so much too near needs none. The gap, at
    least `spacing`, is told by the number of points within `REACH` spacings, itself included: in 3D a surface of one
    point every s² has π r²/s² of them, in 2D a line has 2 r/s. The bend is half of the thickness there:
    0 on a plane, 0.3 spacings at a right-angled edge, whose true place may be that far beyond the nearest point. So may
    a rim be: there the neighbours' mean is more than chance aside.
    """
    discs = np.zeros((len(rows), 6))
    run_chunked(lambda a, b: _shape_range(tree, rows[a:b], spacing, noise[a:b], discs[a:b]), len(rows))
    return discs


_BENT = 40.0
"""[-] Ratio of two variances beyond which no edge is within a spacing."""
REACH = 3.0
"""[-] Spacings: 28 points on an even surface; their number is then known to a fifth."""


class Room(NamedTuple):
    """What telling the surface around a point needs; made once a batch.

    Attributes:
        near: Offsets of the points around it, itself included, in front [m], shape (MOST, 3).
        side: Of two half planes which each is of, shape (MOST,).
        pair: The half planes, shape (3, 9).
        moments: Sums over the offsets, shape (10,).
        vectors: Mean offset, normal and axis [m], shape (3, 3).
        sums: For a quadric.
    """

    near: FloatArray
    side: IntArray
    pair: FloatArray
    moments: FloatArray
    vectors: FloatArray
    sums: Sums


@njit(cache=True, nogil=True)
def make_room() -> Room:
    """Fresh room for one thread."""
    own = np.zeros((MOST, 3)), np.zeros(MOST, np.int64), np.zeros((3, 9)), np.zeros(10), np.zeros((3, 3))
    return Room(*own, make_sums())


@njit(cache=True, nogil=True)
def _shape_range(tree: Tree, rows: IntArray, spacing: float, noise: FloatArray, discs: FloatArray) -> None:
    solid, room, look = tree.points.shape[1] == 3, make_room(), make_look()
    for r in range(len(rows)):
        count = gather(tree, tree.points[rows[r]], REACH * spacing, room.near, look)
        shape_around(room, count, solid, spacing, noise[r], discs[r])


@njit(cache=True, nogil=True)
def shape_around(room: Room, count: int, solid: bool, spacing: float, noise: float, disc: FloatArray) -> None:
    """Write the disc, shape (6,), of a point with `count` offsets in the room, of those within `REACH` spacings [m]."""
    radius = REACH * spacing
    near, moments, mean, normal, axis = room.near, room.moments, room.vectors[0], room.vectors[1], room.vectors[2]
    moments[:] = 0.0
    for i in range(count):
        add(moments, near[i, 0], near[i, 1], near[i, 2])
    low, middle, high = fit_plane(moments, mean, normal)
    gap = max(radius * sqrt(pi / moments[0]) if solid else 2.0 * radius / moments[0], spacing)
    if not solid:  # a line in the plane: its normal lies in it
        fit_axis(moments, high, axis)
        normal[0], normal[1], normal[2] = -axis[1], axis[0], 0.0
        low, middle = max(middle, 0.0), high
    elif _BENT * low > middle and low > noise**2:
        rest = fit_pair(near, count, normal, room.side, room.pair)
        if rest < EDGE * quadric_rest(near, count, normal, room.sums):
            normal[:] = room.pair[nearest_half(room.pair, mean * 0.0), 3:6]
    disc[:3], disc[4] = normal, gap
    wide = min(0.5 * gap, sqrt(max(middle, 0.0))) * (1.0 - low / middle) if middle > low else 0.0
    disc[3] = max(wide - 2.0 * noise, 0.0)
    aside = max(sqrt(mean[0] ** 2 + mean[1] ** 2 + mean[2] ** 2) - 0.25 * radius, 0.0)
    disc[5] = 0.5 * sqrt(low + aside * aside)


def thin(points: FloatArray, cell: float) -> IntArray:
    """Rows of the point nearest to the mean of each cubic cell: real points, no averages; (k,), sorted."""
    if cell <= 0:
        return np.unique(points, axis=0, return_index=True)[1].astype(np.int64)
    flat = _flat_cells(points, cell)
    rows: IntArray = np.sort(_nearest_to_means(points, flat, order_by(flat)))
    return rows


@njit(cache=True, nogil=True)
def _flat_cells(points: FloatArray, cell: float) -> IntArray:
    """A number for the cubic cell of each point: cells lie at multiples of their width, wherever the points end."""
    flat, (lowest, highest) = np.zeros(len(points), np.int64), corners_of(points)
    for k in range(points.shape[1]):
        low = np.floor(lowest[k] / cell)
        cells = int(np.floor(highest[k] / cell) - low) + 1
        for i in range(len(points)):
            flat[i] = flat[i] * cells + int(np.floor(points[i, k] / cell) - low)
    return flat


_ROUNDING = 1e-6
"""[-] Squared distances that differ by less are equal: far more than the order of a sum changes one."""


@njit(cache=True, nogil=True)
def _nearest_to_means(points: FloatArray, flat: IntArray, order: IntArray) -> IntArray:
    """The row nearest to the mean of each run of equal cells in `order`, which keeps that of the rows within a cell.

    Two points are as near to their mean: of those within rounding the one that is least in x, then y, z, whichever came
    first.
    """
    dim, mean = points.shape[1], np.zeros(3)
    found, used, begin = np.empty(len(order), np.int64), 0, 0
    while begin < len(order):
        end = begin + 1
        while end < len(order) and flat[order[end]] == flat[order[begin]]:
            end += 1
        rows = order[begin:end]
        mean[:] = 0.0
        for row in rows:
            for k in range(dim):
                mean[k] += points[row, k]
        best, found[used] = np.inf, rows[0]
        for row in rows:
            off = 0.0
            for k in range(dim):
                off += (points[row, k] - mean[k] / len(rows)) ** 2
            if off < (1.0 - _ROUNDING) * best or (
                off <= (1.0 + _ROUNDING) * best and is_before(points, row, found[used])
            ):
                best, found[used] = off, row
        used, begin = used + 1, end
    return found[:used].copy()

"""Where noisy ground may hide the treads of a stair, and its points set onto them.

The cure at a place sees half a metre all around: of a stair under 5 cm of noise that is half a ramp, steeper than
people stand on. So where ground is as steep as stairs are, it is looked at along its edges, a whole flight at once.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from math import ceil
from typing import NamedTuple

import numpy as np
from numba import njit
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from gpdf_service.denoise.cells import (
    Cells,
    begin_sweep,
    rows_in_plan,
    runs_within,
    some_of,
    sort_into_cells,
    sum_cells,
)
from gpdf_service.denoise.cloud import HIDDEN
from gpdf_service.denoise.treads import EDGE_ERROR, Treads, log_density, look_for_treads, settle_treads
from gpdf_service.fields.threads import run_chunked
from gpdf_service.types import BoolArray, FloatArray, IntArray

_VOXEL = 0.2
"""[m] Ground is averaged over this before its slope is looked at: less than a tread."""
_AROUND = 0.5
"""[m] Radius of the plane that says how steep it is: three treads."""
_RINGS = 3
"""Voxels to either side that may hold some of it."""
_FEWEST_VOXELS, _WIDE = 4, 1e-2
"""Voxels that tell that plane, and how wide they must lie across: of the square of how far they lie in all [-]."""
_BESIDE = 40
"""Points that tell the slope of a core."""
_SHALLOW, _STEEP = 0.3, 1.1
"""[-] Slopes of the shallowest and the steepest stairs: 12 cm on 40 cm, and 22 cm on 20 cm."""
_TURN = 0.94
"""[-] Cosine of the most (20°) that the way up turns between two voxels of one flight."""
_LONGEST, _WIDEST = 4.0, 5.0
"""[m] Of a piece that is fitted as one: a flight of a storey, as wide as any stairs in a house; more is cut."""
_CORE = 0.7
"""[m] Width in which a flight is looked for: less than any stair's."""
_SLICE = 0.1
"""[m] By which a flight grows along its edges."""
_LEAST_VOXELS = 6
"""Of a flight: two treads of half a metre."""
_TALLEST = 0.25
"""[m] Rise of a step; ground further off the ramp is another flight."""
_OFF = 3.5
"""[-] Standard deviations: a point further off a stair is not of it."""
_FOOT = 0.15
"""[m] To either side along an edge, or twice that to one: points of a riser there say together whether it is one."""
_WALL = 5.0
"""[-] Standard deviations from the last ground points, 2.5 beyond a wall, to where no point of the wall is."""
_SURE = 3.5
"""[-] Standard errors by which a riser's points may be off it together."""
_FEWEST = 12
"""Points that tell a riser from a thing."""


class Flight(NamedTuple):
    """Treads about an origin in plan, shape (2,) [m], from `low` to `high`: along the way up, and along the edges."""

    treads: Treads
    origin: FloatArray
    low: tuple[float, float]
    high: tuple[float, float]

    def within(self, points: FloatArray, cells: Cells, beyond: float = 0.0) -> tuple[IntArray, FloatArray, FloatArray]:
        """The rows of `points` (n, 3) over or under it, and their places up and along its edges [m].

        With those up to `beyond` [m] before and behind it; the points are asked for by their `cells`.
        """
        (left, near), (right, far) = self.low, self.high
        low, high = np.array([left - beyond, near]), np.array([right + beyond, far])
        way = np.array([np.cos(self.treads.angle), np.sin(self.treads.angle)])
        rows = rows_in_plan(cells, *_bounds(self.origin, way, low, high))
        u, v = self.treads.along(points[rows, :2] - self.origin)
        inside = (u >= low[0]) & (u <= high[0]) & (v >= low[1]) & (v <= high[1])
        return rows[inside], u[inside], v[inside]

    def reaches(self, place: FloatArray) -> bool:
        """Whether a core at `place`, shape (2,) [m], would be of this flight."""
        v = float(self.treads.along((place - self.origin)[None])[1][0])
        return self.low[1] - 0.5 * _CORE <= v <= self.high[1] + 0.5 * _CORE


def onto_treads(points: FloatArray, noise: float, moved: FloatArray, left: FloatArray) -> list[Flight]:
    """Set those of the ground `points`, shape (n, 3) [m], that are on a flight's treads onto them.

    They were measured with that `noise` [m]. Where they are `moved` to and what is `left` of it, (n,) [m], is written.

    Returns:
        The flights.
    """
    if len(points) == 0:
        return []
    cells = sort_into_cells(points, _VOXEL)
    flights = list(_flights(points, cells, noise))
    for flight in flights:
        rows, u, _ = flight.within(points, cells)
        z, reach = points[rows, 2], _OFF * noise
        mine = z >= flight.treads.height_at(u - reach) - reach
        mine &= z <= flight.treads.height_at(u + reach) + reach
        moved[rows[mine], :2] = points[rows[mine], :2]
        moved[rows[mine], 2] = flight.treads.height_at(u[mine])
        left[rows[mine]] = HIDDEN * noise
    return flights


def onto_risers(flights: list[Flight], points: FloatArray, noise: float, moved: FloatArray, left: FloatArray) -> None:
    """Set those of the other `points`, shape (n, 3) [m], that are of a riser of the `flights` onto it.

    A point is of the nearest riser if that is near, and if those beside it along the edge lie together as a riser's do:
    as often before it as behind it, not thicker than the noise, and not higher. A thing on a tread is before it.
    `moved` and `left` are as in `onto_treads`.
    """
    if len(points) == 0:
        return
    cells, reach = sort_into_cells(points, _VOXEL), _OFF * noise
    for flight in flights:
        angle, edges, heights, sigma = flight.treads
        way, side = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        rows, u, v = flight.within(points, cells, reach)
        order = np.argsort(v)
        rows, u, v = rows[order], u[order], v[order]
        z = points[rows, 2]
        off = u[:, None] - edges
        over = np.maximum(np.maximum(heights[:-1] - z[:, None], z[:, None] - heights[1:]), 0.0)
        distance = np.hypot(off, over)
        nearest = np.where(distance.min(axis=1) <= reach, distance.argmin(axis=1), -1)
        for k in np.flatnonzero((edges >= flight.low[0]) & (edges <= flight.high[0])):
            mine = np.flatnonzero(nearest == k)
            rise = float(heights[k + 1] - heights[k])
            share = (z[mine] - heights[k]) / rise
            mine = mine[_as_riser(v[mine], off[mine, k], share, sigma, rise, (flight.low[1], flight.high[1]))]
            moved[rows[mine], :2] = flight.origin + edges[k] * way + v[mine, None] * side
            moved[rows[mine], 2] = np.clip(z[mine], heights[k], heights[k + 1])
            left[rows[mine]] = HIDDEN * noise


def _as_riser(
    v: FloatArray, off: FloatArray, share: FloatArray, sigma: float, rise: float, ends: tuple[float, float]
) -> BoolArray:
    """Which points of a riser, at v along its edge, rising, and `off` it [m], lie among others as a riser's do.

    They have a `share` of its `rise` under them, and the noise `sigma` [m]. The others are those to either side, or,
    near the flight's `ends` along its edges [m], where a wall can be, those further in.
    """
    sums = np.cumsum(np.stack([np.ones_like(v), off, off * off, share]), axis=1)
    sums = np.concatenate([np.zeros((4, 1)), sums], axis=1)
    found = np.zeros(len(v), dtype=bool)
    side = _FOOT + _WALL * sigma
    for before, behind, where in (
        (_FOOT, _FOOT, np.ones_like(found)),
        (2.0 * _FOOT, 0.0, v > ends[1] - side),
        (0.0, 2.0 * _FOOT, v < ends[0] + side),
    ):
        begin, end = np.searchsorted(v, v - before), np.searchsorted(v, v + behind, side="right")
        number, *totals = sums[:, end] - sums[:, begin]
        mean, square, middle = totals / np.maximum(number, 1.0)
        few = 1.0 / np.maximum(number, 1.0)
        level = np.abs(mean) <= _SURE * np.sqrt(sigma**2 * few + EDGE_ERROR**2)
        thin = square <= sigma**2 * (1.0 + _SURE * np.sqrt(2.0 * few)) + EDGE_ERROR**2
        low = middle <= 0.5 + _SURE * np.sqrt((1.0 / 12.0 + (sigma / rise) ** 2) * few)
        found |= where & level & thin & low & (number >= _FEWEST)
    return found


class _Piece(NamedTuple):
    """A part of steep ground: the way up (2,), from low to high up and aside, and on which sides it goes on."""

    way: FloatArray
    low: FloatArray
    high: FloatArray
    ramp: FloatArray
    goes_on: tuple[bool, bool]


def _steep_pieces(cells: Cells) -> Iterator[_Piece]:
    """Parts of the ground, in voxels, that are as steep as stairs, one way up, cut to what is fitted as one."""
    means, gradient = _gradients(cells)
    slope = np.hypot(gradient[:, 0], gradient[:, 1])
    steep = np.flatnonzero((slope >= _SHALLOW) & (slope <= _STEEP))
    if len(steep) < _LEAST_VOXELS:
        return
    ways = gradient[steep] / slope[steep, None]
    pairs = cKDTree(means[steep]).query_pairs(2.0 * _VOXEL, output_type="ndarray")
    pairs = pairs[np.einsum("ij,ij->i", ways[pairs[:, 0]], ways[pairs[:, 1]]) >= _TURN]
    graph = coo_matrix((np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1])), shape=(len(steep), len(steep)))
    label = connected_components(graph, directed=False)[1]
    parts = np.split(steep[np.argsort(label, kind="stable")], np.cumsum(np.bincount(label))[:-1])
    for part in parts:
        if len(part) >= _LEAST_VOXELS:
            yield from _cut(means[part], gradient[part])


def _gradients(cells: Cells) -> tuple[FloatArray, FloatArray]:
    """Mean of the points in each cell, (m, 3) [m], and gradient of the plane through those around, (m, 2), or 0."""
    sums, gradient = sum_cells(cells), np.zeros((len(cells.key), 2))
    voxels = some_of(cells, np.ones(len(gradient), dtype=bool))
    voxels = voxels._replace(places=voxels.places + sums[:, 1:4] / sums[:, :1])
    run_chunked(lambda a, b: _gradient_range(voxels, sums[:, 0], a, b, gradient), len(gradient))
    return cells.corner + voxels.places, gradient


@njit(cache=True, nogil=True)
def _gradient_range(voxels: Cells, weight: FloatArray, begin: int, end: int, gradient: FloatArray) -> None:
    """Write the gradient around each of the voxels, which hold one place each, of all within `_AROUND`."""
    at, runs = begin_sweep(voxels, voxels.key[begin], _RINGS), np.empty(((2 * _RINGS + 1) ** 2, 2), np.int64)
    for c in range(begin, end):
        count, n, x, y, z, xx, xy, yy, xz, yz = 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for run in runs[: runs_within(voxels, voxels.key[c], _RINGS, at, runs)]:
            for j in range(run[0], run[1]):
                a, b = voxels.places[j, 0] - voxels.places[c, 0], voxels.places[j, 1] - voxels.places[c, 1]
                h = voxels.places[j, 2] - voxels.places[c, 2]
                if a * a + b * b + h * h <= _AROUND**2:
                    w = weight[j]
                    count, n, x, y, z = count + 1, n + w, x + w * a, y + w * b, z + w * h
                    xx, xy, yy = xx + w * a * a, xy + w * a * b, yy + w * b * b
                    xz, yz = xz + w * a * h, yz + w * b * h
        xx, xy, yy, xz, yz = xx - x * x / n, xy - x * y / n, yy - y * y / n, xz - x * z / n, yz - y * z / n
        whole = xx * yy - xy * xy
        if count >= _FEWEST_VOXELS and whole > _WIDE * (xx + yy) ** 2:
            gradient[c, 0], gradient[c, 1] = (xz * yy - yz * xy) / whole, (yz * xx - xz * xy) / whole


def _cut(means: FloatArray, gradient: FloatArray) -> Iterator[_Piece]:
    """Pieces of one steep part, from the means and gradients of its voxels."""
    way = gradient.mean(axis=0)
    way = way / max(float(np.hypot(*way)), 1e-12)
    u, v = means[:, :2] @ way, means[:, :2] @ np.array([-way[1], way[0]])
    low, high = np.array([u.min(), v.min()]) - 0.5 * _VOXEL, np.array([u.max(), v.max()]) + 0.5 * _VOXEL
    rows, columns = ceil((high[0] - low[0]) / _LONGEST), ceil((high[1] - low[1]) / _WIDEST)
    size = (high - low) / [rows, columns]
    row = np.minimum(((u - low[0]) / size[0]).astype(np.int64), rows - 1)
    column = np.minimum(((v - low[1]) / size[1]).astype(np.int64), columns - 1)
    for i, j in product(range(rows), range(columns)):
        mine = (row == i) & (column == j)
        if mine.sum() >= _LEAST_VOXELS:
            design = np.column_stack([u[mine], np.ones(int(mine.sum()))])
            ramp, corner = np.linalg.lstsq(design, means[mine, 2], rcond=None)[0], low + size * [i, j]
            yield _Piece(way, corner, corner + size, ramp, (i > 0, i < rows - 1))


def _bounds(origin: FloatArray, way: FloatArray, low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least and greatest x and y [m] of a rectangle about an origin, from `low` to `high` up its `way` and aside."""
    axes = np.stack([way, [-way[1], way[0]]])
    corners = origin + np.array(list(product((low[0], high[0]), (low[1], high[1])))) @ axes
    return corners.min(axis=0), corners.max(axis=0)


def _flights(points: FloatArray, cells: Cells, noise: float) -> Iterator[Flight]:
    """All flights of the ground, each looked for in cores beside each other, and grown along its edges."""
    for piece in _steep_pieces(cells):
        axes = np.stack([piece.way, [-piece.way[1], piece.way[0]]])
        low, high = piece.low - _CORE, piece.high + _CORE  # a core beyond its voxels
        near = points[rows_in_plan(cells, *_bounds(np.zeros(2), piece.way, low, high))]
        u, v = near[:, :2] @ axes[0], near[:, :2] @ axes[1]
        ramp = piece.ramp[0] * np.clip(u, piece.low[0], piece.high[0]) + piece.ramp[1]
        mine = np.abs(near[:, 2] - ramp) <= _TALLEST + _OFF * noise
        mine &= (u >= low[0]) & (u <= high[0]) & (v >= low[1]) & (v <= high[1])
        near, found = near[mine], list[Flight]()
        blocks = ceil((piece.high[1] - piece.low[1]) / _CORE)
        for share in (np.arange(blocks) + 0.5) / blocks:
            origin = (piece.low + [0.5, share] * (piece.high - piece.low)) @ axes
            if not any(flight.reaches(origin) for flight in found):
                flight = _fitted(near, piece, origin, noise)
                found += [] if flight is None else [flight]
        yield from found


def _fitted(points: FloatArray, piece: _Piece, origin: FloatArray, noise: float) -> Flight | None:
    """The flight through `origin`, shape (2,) [m], if there is one whose way up is about that of its piece."""
    half, near, way = 0.5 * (piece.high[0] - piece.low[0]), points - np.append(origin, 0.0), piece.way
    u, v = near[:, :2] @ way, near[:, :2] @ np.array([-way[1], way[0]])
    near, u, v = (part[np.abs(u) <= half + _AROUND] for part in (near, u, v))
    core = np.abs(v) <= 0.5 * _CORE
    own = core & (np.abs(u) <= half)
    if own.sum() < _BESIDE:
        return None
    slope, height = np.polyfit(u[own], near[own, 2], 1)
    if not _SHALLOW <= slope <= _STEEP:
        return None
    end = half + 0.5 * _AROUND
    ends = [near[core & beyond, 2] for beyond in (u < -end, u > end)]
    floor, ceiling = (
        float(np.median(z)) if len(z) else height + slope * side * half
        for z, side in zip(ends, (-1.0, 1.0), strict=True)
    )
    treads = look_for_treads(near[core], noise, np.append(slope * way, height), floor, ceiling)
    if treads is None:
        return None
    grown = _grown(near, treads)
    for part in (grown, core):
        settled = settle_treads(near[part], treads, noise)
        if settled is not None:
            return _bounded(near[part], settled, origin, half, piece.goes_on)
    return None


def _grown(points: FloatArray, treads: Treads) -> BoolArray:
    """Which of the `points` are of a core's treads, as far along the edges as these go on."""
    _, v = treads.along(points)
    density = log_density(points, treads)
    core = np.abs(v) <= 0.5 * _CORE
    usual, spread = float(density[core].mean()), float(density[core].std())
    ends = []
    for side in (-1.0, 1.0):
        end = 0.5 * _CORE
        while True:
            slice_ = density[(side * v > end) & (side * v <= end + _SLICE)]
            if len(slice_) >= _FEWEST and slice_.mean() < usual - _SURE * spread / np.sqrt(len(slice_)):
                break
            end += _SLICE
            if len(slice_) < _FEWEST:
                break
        ends.append(end)
    grown: BoolArray = (v >= -ends[0]) & (v <= ends[1])
    return grown


def _bounded(points: FloatArray, treads: Treads, origin: FloatArray, half: float, goes_on: tuple[bool, bool]) -> Flight:
    """A flight as far as its `points` and its piece, `half` [m] to either side, go."""
    u, v = treads.along(points)
    low = max(float(u.min()), treads.edges[0] - _AROUND, -half if goes_on[0] else -np.inf)
    high = min(float(u.max()), treads.edges[-1] + _AROUND, half if goes_on[1] else np.inf)
    return Flight(treads, origin, (low, float(v.min())), (high, float(v.max())))

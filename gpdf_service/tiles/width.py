"""How wide cells are: as far apart as the samples of a floor ask for."""

from __future__ import annotations

import numpy as np
from numba import njit
from scipy.spatial import cKDTree

from gpdf_service.config import PerceptionConfig
from gpdf_service.fields.spacing import keep_least
from gpdf_service.fields.threads import run_chunked
from gpdf_service.tiles.columns import by_cell, compacted
from gpdf_service.tiles.rows import bounds_of, cells_of, chosen_rows
from gpdf_service.types import FloatArray, IntArray

MIN_CELL = 0.05
"""[m] Finer than a wheel or a foot feels, and a quarter of the smallest body's radius."""
STEP = 0.1 * MIN_CELL
"""[m] What is measured of a whole cloud counts in steps: its cells then stay when a part of it changes."""
_SAMPLE = 4000
"""Points of a floor whose neighbours are looked at: the median's error is then about 1 %."""
_NEIGHBOUR = 8
"""Which neighbour's distance tells the spacing: how near the first few are is mostly chance."""
_REFLECTED = 0.05
"""[-] Of the points of a column, those that may lie under its floor: reflections."""
_COLUMN = 0.5
"""[m] Wide enough to hold several floor points of any cloud that a body can be planned in."""


def widest_cell(config: PerceptionConfig) -> float:
    """Widest cells in whose middle the ground is no further than the widest gap from a sample anywhere in them [m].

    Cells that must be as wide as this do not close the gaps of a floor: its samples are too far apart.
    """
    return exact(float(np.floor(np.sqrt(2.0) * config.widest_gap / STEP)) * STEP)


def cell_width_of(points: FloatArray, config: PerceptionConfig) -> float:
    """Cell width at which nearly every cell of a sampled floor is hit, `widest_cell` at most [m].

    Density is not uniform: a dense chair must not speak for a sparse floor. So only the lowest points of each column
    `_COLUMN` wide are looked at, which are floor nearly everywhere. At 1.5 × their spacing s (the mean distance to the
    k-th neighbour is s √(k/π)) one cell in ten of a Poisson sample stays empty, which the height map closes.
    """
    corner, far = bounds_of(points)
    shape = columns_over(corner, far, _COLUMN)
    key, count, _ = compacted(cells_of(points, corner, _COLUMN, shape), shape[0] * shape[1])
    z = np.ascontiguousarray(points[:, 2])
    floor = column_floors(*by_cell(key, count), z, _REFLECTED)
    floor_points = chosen_rows(points, np.abs(z - floor[key]) <= MIN_CELL)
    k = min(_NEIGHBOUR, len(floor_points) - 1)
    if k < 1:
        return exact(MIN_CELL)
    picked = np.arange(0, len(floor_points), max(1, len(floor_points) // _SAMPLE))
    distance = _median_to(k, floor_points, picked, corner, far, 2.0 * MIN_CELL)
    if distance > 2.0 * MIN_CELL:
        distance = _median_to(k, floor_points, picked, corner, far, _COLUMN)
    if distance > _COLUMN:
        distance = float(np.median(cKDTree(floor_points).query(floor_points[picked], k=k + 1, workers=-1)[0][:, k]))
    return min(exact(max(MIN_CELL, in_steps(1.5 * distance * float(np.sqrt(np.pi / k))))), widest_cell(config))


def exact(width: float) -> float:
    """A width whose multiples are no rounded numbers: a cell has the same corners in each box of a grid [m].

    It is no wider than asked for, so that as many cells are in a length as are in it: five of 5 cm in a foot's 25 cm.
    """
    near = np.float32(width)
    return float(near if float(near) <= width else np.nextafter(near, np.float32(0.0)))


def columns_over(corner: FloatArray, far: FloatArray, width: float) -> tuple[int, int]:
    """How many columns of `width` there are from one corner to the other [m]."""
    x, y = np.floor((far - corner) / width).astype(np.int64) + 1
    return int(x), int(y)


def _median_to(
    k: int, points: FloatArray, picked: IntArray, corner: FloatArray, far: FloatArray, width: float
) -> float:
    """Median distance of the `picked` points to their `k`-th neighbour [m]; exact if it is at most `width`.

    Infinite where the columns are too many for the points, most of them empty.
    """
    shape, each = columns_over(corner, far, width), np.empty(len(picked))
    cell, count, held = compacted(cells_of(points, corner, width, shape), shape[0] * shape[1])
    if len(held):
        return np.inf
    columns = by_cell(cell, count)
    own = points, columns, (corner, width, shape)
    run_chunked(lambda a, b: kth_beside(*own, picked[a:b], k, each[a:b]), len(picked))
    return float(np.median(each))


def in_steps(length: float, step: float = STEP) -> float:
    """A measured length rounded up to whole steps [m]: a cloud that changes a little is measured as before."""
    return float(np.ceil(round(length / step, 6))) * step


def layer_gap(width: float, config: PerceptionConfig) -> float:
    """Room between two layers of columns that are `width` wide [m]."""
    return max(config.min_headroom, 1.5 * width)


def column_floors(start: IntArray, order: IntArray, z: FloatArray, share: float) -> FloatArray:
    """Height under which a `share` of the points of each column lies [m], shape (cells,); NaN in an empty one."""
    floor = np.full(len(start) - 1, np.nan)
    run_chunked(lambda a, b: _write_floors(start[a : b + 1], order, z, share, floor[a:b]), len(floor))
    return floor


@njit(cache=True, nogil=True)
def _write_floors(start: IntArray, order: IntArray, z: FloatArray, share: float, floor: FloatArray) -> None:
    for c in range(len(floor)):
        count = start[c + 1] - start[c]
        if count > 0:
            at = int(share * count)
            floor[c] = np.partition(z[order[start[c] : start[c + 1]]], at)[at]


@njit(cache=True, nogil=True)
def kth_beside(
    points: FloatArray,
    columns: tuple[IntArray, IntArray],
    grid: tuple[FloatArray, float, tuple[int, int]],
    picked: IntArray,
    k: int,
    distance: FloatArray,
) -> None:
    """Distance of each `picked` row to its `k`-th neighbour in its column and those around [m].

    What is no further than a column is wide is exact, for all columns are looked at that may hold a nearer one.

    Args:
        points: Shape (n, 3) [m].
        columns: Where each column begins, and the rows in that order.
        grid: Lower corner [m], width [m] and shape of the columns.
        picked: Rows, shape (m,).
        k: Which neighbour.
        distance: Where it is written, shape (m,).
    """
    (start, order), (corner, width, shape), near = columns, grid, np.empty(k + 1)
    for i in range(len(picked)):
        row = picked[i]
        at_x, at_y = (points[row, 0] - corner[0]) / width, (points[row, 1] - corner[1]) / width
        x, y = int(np.floor(at_x)), int(np.floor(at_y))
        near[:] = np.inf
        for dx, dy in _OWN_FIRST:
            u, v = x + dx, y + dy
            if not (0 <= u < shape[0] and 0 <= v < shape[1]):
                continue
            off = max(u - at_x, at_x - u - 1.0, 0.0) ** 2 + max(v - at_y, at_y - v - 1.0, 0.0) ** 2
            if off * width**2 >= near[k]:
                continue
            for e in range(start[u * shape[1] + v], start[u * shape[1] + v + 1]):
                other, square = order[e], 0.0
                for axis in range(3):
                    square += (points[other, axis] - points[row, axis]) ** 2
                keep_least(near, square)
        distance[i] = np.sqrt(near[k])


_OWN_FIRST = ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1), (-1, -1), (-1, 1), (1, -1), (1, 1))
"""A column and those around it, the one that likely holds the nearest neighbours first: most others are passed over."""

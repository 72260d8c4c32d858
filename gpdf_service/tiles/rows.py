"""Compiled loops over the rows of arrays of points: which are where, and what they span."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gpdf_service.fields.threads import run_chunked
from gpdf_service.fields.tree import longer
from gpdf_service.tiles.boxes import span
from gpdf_service.types import BoolArray, ByteArray, FloatArray, IntArray

INDEX: Any = np.int32
"""Kind of the numbers of points, nodes and cells where they are many: half of the memory."""
_NO_POINTS: FloatArray = np.zeros((0, 3))
_BLOCK = 4096
"""Rows for which room is made at once: what is found is few, and memory that nobody touches costs nothing."""


@njit(cache=True, nogil=True)
def hashed(points: NDArray[np.uint64], kind: ByteArray, rows: IntArray) -> NDArray[np.uint64]:
    """One number for each of some rows, shape (m,): the same for the same point and kind.

    Args:
        points: The bits of their coordinates, shape (n, 3).
        kind: Shape (n,).
        rows: Shape (m,).
    """
    made = np.empty(len(rows), np.uint64)
    for i in range(len(rows)):
        mixed = np.uint64(kind[rows[i]]) * _MIX[3]
        for k in range(3):
            mixed += points[rows[i], k] * _MIX[k]
        made[i] = mixed ^ (mixed >> np.uint64(29))
    return made


_MIX = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9, 0xD6E8FEB86659FD93], dtype=np.uint64)
"""Odd numbers without a pattern: two points get one sum of products with a chance of 2⁻⁶⁴."""


@njit(cache=True, nogil=True)
def more_now(key: NDArray[np.uint64], was: int) -> IntArray:
    """How many more of the keys from number `was` on than of those before are that of each key, shape (n,)."""
    slots = 1
    while slots < 2 * len(key):
        slots *= 2
    first, more, slot = np.full(slots, -1), np.zeros(slots, np.int64), np.empty(len(key), np.int64)
    for i in range(len(key)):
        at = np.int64(key[i] & np.uint64(slots - 1))
        while first[at] >= 0 and key[first[at]] != key[i]:
            at = (at + 1) & (slots - 1)
        first[at] = i if first[at] < 0 else first[at]
        more[at] += 1 if i >= was else -1
        slot[i] = at
    return more[slot]


@njit(cache=True, nogil=True)
def rows_in_cells(points: FloatArray, origin: FloatArray, cell_width: float, wanted: BoolArray) -> IntArray:
    """Rows of the points (n, 3) in the `wanted` cells, shape (nx, ny), of a grid; sorted."""
    found, used, (left, right, near, far) = np.empty(1024, np.int64), 0, span(wanted)
    low = origin + np.array([left - 1, near - 1]) * cell_width  # around the cells: most points are seen to lie outside
    high = origin + np.array([right + 1, far + 1]) * cell_width
    for row in _rows_between(points, low, high):
        i = int(np.floor((points[row, 0] - origin[0]) / cell_width))
        j = int(np.floor((points[row, 1] - origin[1]) / cell_width))
        if 0 <= i < wanted.shape[0] and 0 <= j < wanted.shape[1] and wanted[i, j]:
            if used == len(found):
                found = longer(found, 2 * used)
            found[used] = row
            used += 1
    return found[:used]


def rows_by_cell(wanted: BoolArray, start: IntArray) -> IntArray:
    """Rows of the points in the `wanted` cells, shape (nx, ny), of points by cell, where each begins at its `start`."""
    cells = np.flatnonzero(wanted)
    return rows_of_runs(start[cells], start[cells + 1])


def rows_of_runs(first: IntArray, behind: IntArray) -> IntArray:
    """Rows of runs one after another: of each the first, and the one behind the last."""
    count = behind - first
    rows: IntArray = np.arange(count.sum()) + np.repeat(first - (np.cumsum(count) - count), count)
    return rows


@njit(cache=True, nogil=True)
def _rows_between(points: FloatArray, low: FloatArray, high: FloatArray) -> IntArray:
    found, used, count = np.empty(2 * _BLOCK, np.int64), 0, len(points)
    left, right, near, far = low[0], high[0], low[1], high[1]
    for begin in range(0, count, _BLOCK):
        if used + _BLOCK > len(found):
            found = longer(found, 2 * len(found))
        for row in range(begin, min(begin + _BLOCK, count)):  # no branch: half of all would be guessed wrong
            x, y = points[row, 0], points[row, 1]
            found[used] = row
            used += int((x >= left) & (x <= right) & (y >= near) & (y <= far))
    return found[:used].copy()


def taken(points: FloatArray, rows: IntArray) -> FloatArray:
    """The points (n, 3) in these rows: half the time of NumPy's `take`."""
    made = np.empty((len(rows), 3))
    _take_rows(points, rows, made)
    return made


@njit(cache=True, nogil=True)
def _take_rows(points: FloatArray, rows: IntArray, made: FloatArray) -> None:
    for i in range(len(rows)):
        row = rows[i]
        made[i, 0], made[i, 1], made[i, 2] = points[row, 0], points[row, 1], points[row, 2]  # a loop: twice the time


def chosen_rows(points: FloatArray, chosen: BoolArray, fresh: FloatArray = _NO_POINTS) -> FloatArray:
    """The points (n, 3) that are `chosen`, and the `fresh` ones (k, 3) after them, four times as fast as by NumPy."""
    count = np.count_nonzero(chosen)
    made = np.empty((count + len(fresh) + 1, 3))  # by NumPy, which asks for large pages: a quarter of the time
    _keep_rows(points, chosen, made)
    made[count:-1] = fresh
    return made[:-1]


def rows_among(values: IntArray, others: IntArray) -> IntArray:
    """The row of each value among others that ascend, −1 of one that is not among them."""
    if len(others) == 0:
        return np.full(len(values), -1)
    row = np.minimum(np.searchsorted(others, values), len(others) - 1)
    return np.where(others[row] == values, row, -1)


def is_among(values: IntArray, others: IntArray) -> BoolArray:
    """Which of the values are among others that ascend."""
    found: BoolArray = np.zeros(len(values), dtype=bool)
    if len(others):
        found = others[np.minimum(np.searchsorted(others, values), len(others) - 1)] == values
    return found


def rows_spliced(values: NDArray[Any], gone: IntArray, fresh: NDArray[Any]) -> NDArray[Any]:
    """The values (n, …) but for the rows that are gone, ascending, and the `fresh` ones after them: copied in runs."""
    first, last = np.append(0, gone + 1), np.append(gone, len(values))
    some = np.flatnonzero(last > first)
    return np.concatenate([*(values[a:b] for a, b in zip(first[some], last[some], strict=True)), fresh])


@njit(cache=True, nogil=True)
def _keep_rows(points: FloatArray, keep: BoolArray, made: FloatArray) -> None:
    used = 0
    for i in range(len(points)):
        for k in range(3):  # written, and kept or not: a guess would be wrong
            made[used, k] = points[i, k]
        used += keep[i]


@njit(cache=True, nogil=True)
def _write_between(
    cell: IntArray, z: FloatArray, low: NDArray[np.floating], high: NDArray[np.floating], found: BoolArray
) -> None:
    for i in range(len(cell)):
        c = cell[i]
        found[i] = c < len(low) and low[c] < z[i] <= high[c]


@njit(cache=True, nogil=True)
def bounds_of(points: FloatArray, chosen: BoolArray | None = None) -> tuple[FloatArray, FloatArray]:
    """Least and greatest (x, y) [m] of points (n, 3), of the `chosen` ones where they are given."""
    left, right, near, far = np.inf, -np.inf, np.inf, -np.inf
    for row in range(len(points)):
        if chosen is not None and not chosen[row]:
            continue
        x, y = points[row, 0], points[row, 1]
        left, right, near, far = min(left, x), max(right, x), min(near, y), max(far, y)
    return np.array([left, near]), np.array([right, far])


@njit(cache=True, nogil=True)
def extent_of(points: FloatArray) -> tuple[float, float]:
    """How wide points (n, 3) are in x or y, and the largest of all coordinates, inf if any is not finite."""
    low, high, most = np.full(3, np.inf), np.full(3, -np.inf), 0.0
    for row in range(len(points)):
        for k in range(3):
            value = points[row, k]
            low[k], high[k] = min(low[k], value), max(high[k], value)
            most = max(most, abs(value)) if np.isfinite(value) else np.inf
    return max(high[0] - low[0], high[1] - low[1]), most


def rows_over(points: FloatArray, origin: FloatArray, width: float) -> tuple[int, int]:
    """The first and the last row of cells that points (n, 3) lie in; the first for none."""
    if len(points) == 0:
        return 0, 0
    low, high = bounds_of(points)
    return int((low[0] - origin[0]) / width), int((high[0] - origin[0]) / width)


def cells_of(points: FloatArray, origin: FloatArray, width: float, shape: tuple[int, int]) -> IntArray:
    """Flat cell of each point (n, 3), which must lie on the grid, shape (n,)."""
    cell = np.empty(len(points), np.int64)
    ends = np.zeros(2, np.int64), np.array(shape)
    run_chunked(lambda a, b: _write_in_box(points[a:b], origin, width, *ends, cell[a:b]), len(points))
    return cell


def cells_in_box(points: FloatArray, origin: FloatArray, width: float, first: IntArray, last: IntArray) -> IntArray:
    """Flat cell of each point (n, 3) in a box of cells, from `first` to `last`; those outside are in one more."""
    cell = np.empty(len(points), INDEX)
    run_chunked(lambda a, b: _write_in_box(points[a:b], origin, width, first, last, cell[a:b]), len(points))
    return cell


@njit(cache=True, nogil=True)
def _write_in_box(
    points: FloatArray, origin: FloatArray, width: float, first: IntArray, last: IntArray, cell: IntArray
) -> None:
    wide = last[1] - first[1]
    for i in range(len(points)):
        x, y = int(np.floor((points[i, 0] - origin[0]) / width)), int(np.floor((points[i, 1] - origin[1]) / width))
        inside = first[0] <= x < last[0] and first[1] <= y < last[1]
        cell[i] = (x - first[0]) * wide + y - first[1] if inside else (last[0] - first[0]) * wide


def extent_within(cell: IntArray, z: FloatArray, low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest z of the points in each cell that are over its `low` and not over its `high`; inf, −inf.

    The cells are those of a grid, shape (nx, ny); points of the cell after the last one are in none.
    """
    least, most = np.full(low.shape, np.inf), np.full(low.shape, -np.inf)
    _write_extents(cell, z, low.ravel(), high.ravel(), least.ravel(), most.ravel())
    return least, most


@njit(cache=True, nogil=True)
def _write_extents(
    cell: IntArray, z: FloatArray, low: FloatArray, high: FloatArray, least: FloatArray, most: FloatArray
) -> None:
    for i in range(len(cell)):
        c = cell[i]
        if c < len(low) and low[c] < z[i] <= high[c]:
            least[c], most[c] = min(least[c], z[i]), max(most[c], z[i])


def between(cell: IntArray, z: FloatArray, low: NDArray[np.floating], high: NDArray[np.floating]) -> BoolArray:
    """Which points are over the `low` of their cell and not over its `high`, shape (n,): see `extent_within`."""
    found, ends = np.empty(len(cell), dtype=bool), (low.ravel(), high.ravel())
    run_chunked(lambda a, b: _write_between(cell[a:b], z[a:b], *ends, found[a:b]), len(cell))
    return found


def under(heights: NDArray[np.floating]) -> FloatArray:
    """The next smaller numbers: what is not over them is under the heights."""
    made: FloatArray = np.nextafter(heights.astype(np.float64), -np.inf)
    return made

"""Points in cubic cells, the sums of their powers, and sweeps over each cell and the 26 around it.

Cells are kept by one number each, ascending; a neighbour's is that number and a constant. So sweeps over all cells find
their neighbours by pointers that only go forward: work and memory are those of the points, however far these lie apart.
"""

from __future__ import annotations

from math import floor
from typing import NamedTuple

import numpy as np
from numba import njit

from gpdf_service.fields.order import corners_of, order_by
from gpdf_service.fields.shapes import add
from gpdf_service.fields.threads import run_chunked
from gpdf_service.kernel_cache import lean
from gpdf_service.types import BoolArray, FloatArray, IntArray

AROUND = 27
"""A cell and those that touch it."""
_MARGIN = 3
"""Empty cells around all, so that a neighbour of the last one in a row is not the first of the next."""
_MOST = 1 << 19
"""Cells along a side: three of them make a number of 57 bits."""


class Cells(NamedTuple):
    """Points by their cells.

    Attributes:
        order: Rows of the points, cell by cell, shape (n,).
        places: The points in that order, from `corner` [m], shape (n, 3).
        begin: Where each cell's points begin there, shape (m + 1,).
        key: Number of each cell, ascending, shape (m,).
        corner: Lower corner of cell 0 [m], shape (3,).
        width: Of the cells [m].
        strides: By how much the number grows with a cell in x, and in y, shape (2,).
    """

    order: IntArray
    places: FloatArray
    begin: IntArray
    key: IntArray
    corner: FloatArray
    width: float
    strides: IntArray


def sort_into_cells(points: FloatArray, width: float) -> Cells:
    """Points, shape (n, 3) [m], in cells of at least `width` [m], which a part of a cloud has where all of it does."""
    lowest, highest = corners_of(points)
    width = max(width, float((highest - lowest).max()) / _MOST)
    corner = (np.floor(lowest / width) - _MARGIN) * width
    counts = np.floor((highest - corner) / width).astype(np.int64) + 1 + _MARGIN
    strides = np.array([counts[1] * counts[2], counts[2]])
    key = np.empty(len(points), np.int64)
    run_chunked(lambda a, b: _keys(points[a:b], corner, width, strides, key[a:b]), len(points))
    order = order_by(key)
    key, places = key[order], points.take(order, 0)
    places -= corner
    begin = np.flatnonzero(np.diff(key, prepend=-1))
    return Cells(order, places, np.append(begin, len(key)), key[begin], corner, width, strides)


def rows_around(points: FloatArray, asked: BoolArray, width: float) -> IntArray:
    """Rows of the points in the cells of that `width` [m] that hold one that is `asked` for, or are beside such."""
    cells = sort_into_cells(points, width)
    return np.sort(cells.order[np.repeat(cells_around(cells, asked), np.diff(cells.begin))])


def rows_in_plan(cells: Cells, low: FloatArray, high: FloatArray) -> IntArray:
    """Rows of the points in columns of cells that meet a rectangle from `low` to `high` [m], (2,) each, ascending."""
    (x, y), (right, far) = (np.floor((end - cells.corner[:2]) / cells.width).astype(np.int64) for end in (low, high))
    across = cells.strides[0] // cells.strides[1]
    row = np.arange(max(x, 0), right + 1) * cells.strides[0]
    first, last = (np.searchsorted(cells.key, row + np.clip(at, 0, across) * cells.strides[1]) for at in (y, far + 1))
    runs = [cells.order[a:b] for a, b in zip(cells.begin[first], cells.begin[last], strict=True)]
    return np.sort(np.concatenate([np.zeros(0, np.int64), *runs]))


@njit(cache=True, nogil=True)
def _keys(points: FloatArray, corner: FloatArray, width: float, strides: IntArray, key: IntArray) -> None:
    for i in range(len(points)):
        x, y = floor((points[i, 0] - corner[0]) / width), floor((points[i, 1] - corner[1]) / width)
        key[i] = x * strides[0] + y * strides[1] + floor((points[i, 2] - corner[2]) / width)


def sum_cells(cells: Cells) -> FloatArray:
    """Sums over each cell's points of 1, x, y, z, x², y², z², xy, xz, yz from its centre, shape (m, 10)."""
    moments = np.zeros((len(cells.key), 10))
    run_chunked(lambda a, b: _sum_range(cells, moments, a, b), len(moments))
    return moments


@lean()
def _sum_range(cells: Cells, moments: FloatArray, begin: int, end: int) -> None:
    for c in range(begin, end):
        x, y, z = centre_of(cells, c)
        for i in range(cells.begin[c], cells.begin[c + 1]):
            add(moments[c], cells.places[i, 0] - x, cells.places[i, 1] - y, cells.places[i, 2] - z)


@lean()
def centre_of(cells: Cells, c: int) -> tuple[float, float, float]:
    """Centre of cell c from the corner [m]."""
    x, rest = divmod(cells.key[c], cells.strides[0])
    y, z = divmod(rest, cells.strides[1])
    width = cells.width
    return (x + 0.5) * width, (y + 0.5) * width, (z + 0.5) * width


@njit(cache=True, nogil=True)
def begin_sweep(cells: Cells, own: int, rings: int = 1) -> IntArray:
    """What a sweep goes on from, shape (2, (2 rings + 1)²): where the columns at most `rings` off a cell begin.

    And by how much the number of the lowest cell in such a column exceeds that of the cell, `own`.
    """
    at = np.empty((2, (2 * rings + 1) ** 2), np.int64)
    for j in range(at.shape[1]):
        x, y = divmod(j, 2 * rings + 1)
        at[1, j] = (x - rings) * cells.strides[0] + (y - rings) * cells.strides[1] - rings
        at[0, j] = np.searchsorted(cells.key, own + at[1, j])
    return at


@lean()
def look_around(cells: Cells, c: int, at: IntArray, near: IntArray) -> None:
    """Write which cells are `near` c, shape (27,), −1 where there is none; x changes least often, z most.

    Cell c is no less than in the call before; the sweep goes on from `at`, of `begin_sweep`.
    """
    key, m = cells.key, len(cells.key)
    for j in range(9):
        p = _begin_of(key, key[c], at, j)
        for k in range(3):
            there = p < m and key[p] == key[c] + at[1, j] + k
            near[3 * j + k] = p if there else -1
            p += there


@lean()
def offset_of(cells: Cells, j: int) -> tuple[float, float, float]:
    """From a cell's centre to that of the j-th of `look_around` [m]."""
    return (j // 9 - 1) * cells.width, (j // 3 % 3 - 1) * cells.width, (j % 3 - 1) * cells.width


@lean()
def sum_window(cells: Cells, moments: FloatArray, near: IntArray, total: FloatArray) -> None:
    """Write the sums over a cell and those around it from its centre, shape (10,)."""
    total[:] = 0.0
    for j in range(AROUND):
        if near[j] < 0:
            continue
        a, b, c = offset_of(cells, j)
        m = moments[near[j]]
        n = m[0]
        total[0] += n
        total[1] += m[1] + n * a
        total[2] += m[2] + n * b
        total[3] += m[3] + n * c
        total[4] += m[4] + a * (2.0 * m[1] + n * a)
        total[5] += m[5] + b * (2.0 * m[2] + n * b)
        total[6] += m[6] + c * (2.0 * m[3] + n * c)
        total[7] += m[7] + a * m[2] + b * m[1] + n * a * b
        total[8] += m[8] + a * m[3] + c * m[1] + n * a * c
        total[9] += m[9] + b * m[3] + c * m[2] + n * b * c


@lean()
def look_at(cells: Cells, c: int, near: IntArray, most: int, about: FloatArray) -> int:
    """Write the places in the cells `near` from the middle of cell c [m], one coordinate after the other; how many.

    Every k-th is, if there are more than the `most`.
    """
    total, passed, found, (x, y, z) = 0, 0, 0, centre_of(cells, c)
    for j in near:
        if j >= 0:
            total += cells.begin[j + 1] - cells.begin[j]
    stride = 1 + (total - 1) // most
    for j in near:
        if j >= 0:
            for i in range(cells.begin[j], cells.begin[j + 1]):
                if passed % stride == 0:
                    p = cells.places[i]
                    about[0, found], about[1, found], about[2, found] = p[0] - x, p[1] - y, p[2] - z
                    found += 1
                passed += 1
    return found


@lean()
def holds_any(cells: Cells, c: int, asked: BoolArray) -> bool:
    """Whether cell c holds a point that is `asked` for, shape (n,) in the order of the input."""
    found = False
    for i in range(cells.begin[c], cells.begin[c + 1]):
        found |= asked[cells.order[i]]
    return bool(found)


def cells_around(cells: Cells, asked: BoolArray) -> BoolArray:
    """Which cells hold a point that is `asked` for, shape (n,), or are beside one that does, shape (m,)."""
    found = np.zeros(len(cells.key), dtype=bool)
    run_chunked(lambda a, b: _around_range(cells, asked, a, b, found), len(cells.key))
    return found


@njit(cache=True, nogil=True)
def _around_range(cells: Cells, asked: BoolArray, begin: int, end: int, found: BoolArray) -> None:
    near, at = np.empty(AROUND, np.int64), begin_sweep(cells, cells.key[begin])
    for c in range(begin, end):
        if holds_any(cells, c, asked):
            look_around(cells, c, at, near)
            for j in near:
                if j >= 0:
                    found[j] = True


def some_of(cells: Cells, which: BoolArray) -> Cells:
    """The cells that `which` says, shape (m,), for sweeps without the rest: each holds its own row and its middle."""
    cell = np.flatnonzero(which)
    x, rest = np.divmod(cells.key[cell], cells.strides[0])
    middle = (np.column_stack([x, *np.divmod(rest, cells.strides[1])]) + 0.5) * cells.width
    return cells._replace(order=cell, places=middle, begin=np.arange(len(cell) + 1), key=cells.key[cell])


@lean()
def runs_within(cells: Cells, own: int, rings: int, at: IntArray, runs: IntArray) -> int:
    """Write where places in the cells at most `rings` off the one numbered `own` begin and end, by column; how many.

    It is no less than in the call before; the sweep goes on from `at`, of `begin_sweep` with as many rings.
    """
    found = 0
    for column in range(at.shape[1]):
        first, highest = _begin_of(cells.key, own, at, column), own + at[1, column] + 2 * rings
        last = first
        for _ in range(2 * rings + 1):
            last += last < len(cells.key) and cells.key[last] <= highest
        runs[found, 0], runs[found, 1] = cells.begin[first], cells.begin[last]
        found += first < last
    return found


@lean()
def count_in(runs: IntArray) -> int:
    """How many places some runs hold."""
    count = 0
    for run in runs:
        count += run[1] - run[0]
    return count


@lean()
def _begin_of(key: IntArray, own: int, at: IntArray, column: int) -> int:
    """Where a column around a cell begins."""
    first, lowest = at[0, column], own + at[1, column]
    while first < len(key) and key[first] < lowest:
        first += 1
    at[0, column] = first
    return int(first)

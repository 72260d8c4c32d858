"""Boxes of cells of a grid, and cells around others."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gpdf_service.fields.threads import run_chunked
from gpdf_service.types import BoolArray

Box = tuple[slice, slice]
"""Rows and columns of a grid."""
WHOLE: Box = (slice(None), slice(None))
SIDES = np.array([[0, 1, 0], [1, 0, 1], [0, 1, 0]], dtype=bool)
"""The four neighbours of a cell, without itself."""


def corner_of(box: Box) -> tuple[int, int]:
    """Its first cell."""
    return box[0].start or 0, box[1].start or 0


def window(cells: BoolArray, by: int) -> Box:
    """The rows and columns that hold all `cells`, shape (nx, ny), and `by` cells more on each side."""
    left, right, near, far = span(cells)
    nx, ny = cells.shape
    return slice(max(left - by, 0), min(right + by, nx)), slice(max(near - by, 0), min(far + by, ny))


@njit(cache=True, nogil=True)
def span(cells: BoolArray) -> tuple[int, int, int, int]:
    """First row and behind the last, first column and behind the last of the cells."""
    left, right, near, far = cells.shape[0], 0, cells.shape[1], 0
    for x in range(cells.shape[0]):
        row, some = cells[x], False
        for y in range(len(row)):  # no way out: so it is done in vectors
            some |= row[y]
        if not some:
            continue
        first, last = 0, len(row)
        while not row[first]:
            first += 1
        while not row[last - 1]:
            last -= 1
        left, right = min(left, x), x + 1
        near, far = min(near, first), max(far, last)
    return left, right, near, far


def over_blocks(values: NDArray[Any], side: int, end: np.ufunc, none: float) -> NDArray[Any]:
    """The least or the greatest of the values, (nx, ny), in each block of `side` by `side` cells, as `end` tells.

    A NaN counts for nothing; where there is nothing it is `none`.
    """
    nx, ny = (-(-cells // side) for cells in values.shape)
    pad = [(0, -cells % side) for cells in values.shape]
    blocks = np.pad(values, pad, constant_values=np.nan).reshape(nx, side, ny, side)
    made: NDArray[Any] = end.reduce(blocks, axis=(1, 3), initial=none)
    return made


@njit(cache=True, nogil=True)
def widened(cells: BoolArray, by: int) -> BoolArray:
    """The cells and all within `by` cells of them along each axis."""
    made, (left, right, near, far), (nx, ny) = np.zeros_like(cells), span(cells), cells.shape
    begin, end = max(near - by, 0), max(min(far + by, ny), near)
    wide = np.zeros((max(right - left, 0), max(end - begin, 0)), np.bool_)
    for x in range(left, right):
        written = begin
        for y in range(near, far):
            if cells[x, y]:
                for k in range(max(written, y - by), min(y + by + 1, ny)):
                    wide[x - left, k - begin] = True
                written = min(y + by + 1, ny)
    for step, first, last in ((1, left, min(right + by, nx)), (-1, right - 1, max(left - by, 0) - 1)):
        away = np.full(wide.shape[1], by + 1)  # rows since one that is wide there
        for x in range(first, last, step):
            row = made[x, begin : begin + len(away)]
            if left <= x < right:
                own = wide[x - left]
                for y in range(len(away)):
                    away[y] = 0 if own[y] else away[y] + 1
                    row[y] |= away[y] <= by
            else:
                for y in range(len(away)):
                    away[y] += 1
                    row[y] |= away[y] <= by
    return made


def lowest_around(values: NDArray[Any], rings: int) -> NDArray[Any]:
    """The lowest of the `values`, floats and none NaN, within so many cells along each axis, shape (nx, ny)."""
    return -highest_around(-values, rings)


def highest_around(values: NDArray[Any], rings: int) -> NDArray[Any]:
    """The highest of the `values` within so many cells along each axis, (nx, ny): floats, none NaN, or none below 0."""
    made, least = np.empty(values.shape, values.dtype), values.dtype.type(-np.inf if values.dtype.kind == "f" else 0)
    values = np.ascontiguousarray(values)
    run_chunked(lambda a, b: _highest_in_rows(values, rings, least, a, b, made), values.shape[0])
    run_chunked(lambda a, b: _highest_in_columns(made, rings, least, a, b), values.shape[1])
    return made


_ABREAST = 128
"""Columns that are looked at together: in vectors, and in a core's cache."""


@njit(cache=True, nogil=True)
def _highest_in_rows(values: NDArray[Any], rings: int, least: Any, begin: int, end: int, made: NDArray[Any]) -> None:  # noqa: ANN401
    """Write the highest of so many cells before and behind in some rows; none is under the `least`.

    It is that of 2, 4, 8 … cells from each one on, and at last of two such that overlap.
    """
    cells, size = values.shape[1], 2 * rings + 1
    high, now = np.empty(cells + 2 * rings, values.dtype), np.empty(cells + 2 * rings, values.dtype)
    for x in range(begin, end):
        high[:rings], high[cells + rings :] = least, least
        high[rings : cells + rings] = values[x]
        span = 1
        while 2 * span <= size:
            _higher(high, high[span:], now[: len(high) - span])
            high, now, span = now, high, 2 * span
        _higher(high, high[size - span :], made[x])


@njit(cache=True, nogil=True)
def _highest_in_columns(made: NDArray[Any], rings: int, least: Any, begin: int, end: int) -> None:  # noqa: ANN401
    """The same in some columns, written over the values."""
    cells, size = len(made), 2 * rings + 1
    for first in range(begin, end, _ABREAST):
        last, span = min(first + _ABREAST, end), 1
        high = np.empty((cells + 2 * rings, last - first), made.dtype)
        high[:rings], high[cells + rings :] = least, least
        high[rings : cells + rings] = made[:, first:last]
        while 2 * span <= size:
            for i in range(len(high) - span):
                _higher(high[i], high[i + span], high[i])
            span *= 2
        for i in range(cells):
            _higher(high[i], high[i + size - span], made[i, first:last])


@njit(cache=True, nogil=True)
def _higher(one: NDArray[Any], other: NDArray[Any], made: NDArray[Any]) -> None:
    """Write the higher ones of two rows."""
    for i in range(len(made)):
        made[i] = one[i] if one[i] > other[i] else other[i]

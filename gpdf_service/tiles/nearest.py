"""The nearest of some cells of a grid to each cell, exactly: in each column first, then along each row."""

from __future__ import annotations

import numpy as np
from numba import njit

from gpdf_service.tiles.rows import INDEX
from gpdf_service.types import BoolArray, FloatArray, IntArray


def nearest_of(cells: BoolArray) -> tuple[FloatArray, IntArray]:
    """Distance [cells] to the nearest of the `cells`, shape (nx, ny), inf where there is none, and its flat index, -1.

    Of equally near ones it is that of the least column, then row.
    """
    distance, index = np.empty(cells.shape), np.empty(cells.shape, INDEX)
    _along_rows(_in_columns(np.ascontiguousarray(cells)), distance, index)
    return distance, index


@njit(cache=True, nogil=True)
def _in_columns(cells: BoolArray) -> IntArray:
    """Row of the nearest cell in each one's column, -1 where there is none, shape (nx, ny)."""
    nx, ny = cells.shape
    row = np.full((nx, ny), -1, INDEX)
    for x in range(nx):
        for y in range(ny):
            if cells[x, y]:
                row[x, y] = x
            elif x > 0:
                row[x, y] = row[x - 1, y]
    for x in range(nx - 2, -1, -1):
        for y in range(ny):
            behind = row[x + 1, y]
            if behind >= 0 and (row[x, y] < 0 or behind - x < x - row[x, y]):
                row[x, y] = behind
    return row


@njit(cache=True, nogil=True)
def _along_rows(row: IntArray, distance: FloatArray, index: IntArray) -> None:
    """The lower envelope of the parabolas (y − column)² + (x − row)² over each row of cells."""
    nx, ny = row.shape
    column, first, off = np.empty(ny, np.int64), np.empty(ny, np.int64), np.empty(ny, np.int64)
    for x in range(nx):
        used = 0
        for y in range(ny):
            if row[x, y] < 0:
                continue
            off[y] = (row[x, y] - x) ** 2
            while used > 0:
                last, at = column[used - 1], first[used - 1]
                if (at - last) ** 2 + off[last] <= (at - y) ** 2 + off[y]:
                    break
                used -= 1
            begin = 0
            if used > 0:  # from here on y is nearer than the last one, in whole numbers
                apart, more = y * y - last * last + off[y] - off[last], 2 * (y - last)
                begin = (apart >> 1 if more == 2 else apart // more) + 1  # nearly all are: a division takes longer
            if begin < ny:
                column[used], first[used] = y, begin
                used += 1
        if used == 0:
            distance[x], index[x] = np.inf, -1
        for y in range(ny - 1, -1 if used > 0 else ny - 1, -1):
            while first[used - 1] > y:
                used -= 1
            own = column[used - 1]
            distance[x, y], index[x, y] = np.sqrt(float((own - y) ** 2 + off[own])), row[x, own] * ny + own

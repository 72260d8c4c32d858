"""Boxes of cells of a grid, and cells around others."""

from __future__ import annotations

import numpy as np
from numba import njit
from scipy import ndimage

from gpdf_service.types import BoolArray

Box = tuple[slice, slice]
"""Rows and columns of a grid."""
WHOLE: Box = (slice(None), slice(None))
NOWHERE: Box = (slice(0, 0), slice(0, 0))


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


def widened(cells: BoolArray, by: int) -> BoolArray:
    """The cells and all within `by` cells of them along each axis."""
    made = np.zeros_like(cells)
    if cells.any():
        box = window(cells, by)
        made[box] = ndimage.maximum_filter(cells[box], size=2 * by + 1, mode="constant")
    return made


def eroded(cells: BoolArray, by: int) -> BoolArray:
    """The first cells of all squares of `by` + 1 cells a side that hold nothing else; beyond the grid is nothing."""
    for _ in range(by):
        rows = np.zeros_like(cells)
        rows[:-1] = cells[:-1] & cells[1:]
        cells = np.zeros_like(cells)
        cells[:, :-1] = rows[:, :-1] & rows[:, 1:]
    return cells


def dilated(cells: BoolArray, by: int) -> BoolArray:
    """The squares of `by` + 1 cells a side of which the `cells` are the first; so an opening is `dilated(eroded)`."""
    for _ in range(by):
        rows = cells.copy()
        rows[1:] |= cells[:-1]
        cells = rows.copy()
        cells[:, 1:] |= rows[:, :-1]
    return cells

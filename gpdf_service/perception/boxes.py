"""Boxes of cells of a grid, and cells around others."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

from gpdf_service.types import BoolArray

Scalar = TypeVar("Scalar", bound=np.generic)
Box = tuple[slice, slice]
"""Rows and columns of a grid."""
WHOLE: Box = (slice(None), slice(None))
NOWHERE: Box = (slice(0, 0), slice(0, 0))


def corner_of(box: Box) -> tuple[int, int]:
    """Its first cell."""
    return box[0].start or 0, box[1].start or 0


def pasted(whole: NDArray[Scalar], part: NDArray[Scalar], inner: Box, outer: Box) -> NDArray[Scalar]:
    """A grid with the cells of the `inner` box from a `part` of it, which is that of the `outer` box."""
    made = whole.copy()
    made[inner] = part[tuple(slice(i.start - o.start, i.stop - o.start) for i, o in zip(inner, outer, strict=True))]
    return made


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

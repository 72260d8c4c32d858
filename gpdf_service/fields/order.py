"""Morton order: places that are near each other in space come near each other in memory."""

from __future__ import annotations

import numpy as np
from numba import njit

from gpdf_service.types import FloatArray, IntArray

_BITS = 10
"""A thousand cells a side put queries of a batch in order; finer does not save a cache miss more."""


@njit(cache=True, nogil=True)
def morton(cell: IntArray, bits: int = 30) -> IntArray:
    """Interleave the low `bits` of each row, shape (m, dim) → (m,): cells of one quadtree node are one range."""
    dim = cell.shape[1]
    code = np.zeros(len(cell), np.int64)
    for row in range(len(cell)):
        for bit in range(bits):
            for axis in range(dim):
                code[row] |= ((cell[row, axis] >> bit) & 1) << (dim * bit + dim - 1 - axis)
    return code


def spatial_order(places: FloatArray) -> IntArray:
    """Rows of `places`, shape (m, dim), so that neighbours in the order are neighbours in space; shape (m,)."""
    low, high = places.min(axis=0), places.max(axis=0)
    cells = 2**_BITS
    scaled = (places - low) * (cells / max(float((high - low).max()), np.finfo(float).tiny))
    return np.argsort(morton(np.minimum(scaled, cells - 1).astype(np.int64), _BITS))

"""Morton order: places that are near each other in space come near each other in memory."""

from __future__ import annotations

import numpy as np
from numba import njit

from gpdf_service.types import FloatArray, IntArray

_BITS = 5
"""Of each coordinate: 15 bits are sorted ten times faster than 30, and 32 cells a side save the same cache misses."""


@njit(cache=True, nogil=True)
def morton(cell: IntArray, bits: int = 30) -> IntArray:
    """Interleave the low `bits` of each row, shape (m, dim) → (m,): cells of one quadtree node are one range."""
    dim = cell.shape[1]
    code = np.zeros(len(cell), np.int64)
    if dim == 2:
        low = (np.int64(1) << bits) - 1
        for i in range(len(cell)):
            code[i] = _apart(cell[i, 0] & low) << 1 | _apart(cell[i, 1] & low)
        return code
    for i in range(len(cell)):
        for bit in range(bits):
            for axis in range(dim):
                code[i] |= ((cell[i, axis] >> bit) & 1) << (dim * bit + dim - 1 - axis)
    return code


@njit(cache=True, nogil=True)
def _apart(value: int) -> int:
    """The bits of a number below 2³¹ with a zero before each."""
    value = (value | value << 16) & 0x0000FFFF0000FFFF
    value = (value | value << 8) & 0x00FF00FF00FF00FF
    value = (value | value << 4) & 0x0F0F0F0F0F0F0F0F
    value = (value | value << 2) & 0x3333333333333333
    return (value | value << 1) & 0x5555555555555555


def spatial_order(places: FloatArray) -> IntArray:
    """Rows of `places`, shape (m, dim), so that neighbours in the order are neighbours in space; shape (m,)."""
    return np.argsort(morton(_cells(places), _BITS).astype(np.int16), kind="stable")


@njit(cache=True, nogil=True)
def _cells(places: FloatArray) -> IntArray:
    """Cell of each place in a cube around all of them."""
    dim, side = places.shape[1], 0.0
    low = np.empty(dim)
    for k in range(dim if len(places) else 0):
        low[k] = places[:, k].min()
        side = max(side, places[:, k].max() - low[k])
    scale = (1 << _BITS) / side if side > 0.0 else 0.0
    cell = np.empty(places.shape, np.int64)
    for i in range(len(places)):
        for k in range(dim):
            cell[i, k] = min(int((places[i, k] - low[k]) * scale), (1 << _BITS) - 1)
    return cell

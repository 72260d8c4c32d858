"""Morton order: places that are near each other in space come near each other in memory."""

from __future__ import annotations

import numpy as np
from numba import njit

from gpdf_service.types import FloatArray, IntArray

_BITS = 5
"""Of each coordinate: 15 bits are sorted ten times faster than 30, and 32 cells a side save the same cache misses."""
_DIGIT = 11
"""Bits that are sorted by at once: their counts fit the nearest cache."""


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


@njit(cache=True, nogil=True)
def corners_of(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least and greatest coordinates of points (n, dim), each of shape (dim,); inf and −inf of none."""
    dim = points.shape[1]
    lowest, highest = np.empty(dim), np.empty(dim)
    for k in range(dim):
        low, high = np.inf, -np.inf
        for i in range(len(points)):
            low, high = min(low, points[i, k]), max(high, points[i, k])
        lowest[k], highest[k] = low, high
    return lowest, highest


@njit(cache=True, nogil=True)
def order_by(key: IntArray) -> IntArray:
    """Rows by `key`, shape (n,), not negative; equal ones stay in their order: counted digit by digit."""
    order, moved = np.arange(len(key)), np.empty(len(key), np.int64)
    most = key.max() if len(key) else 0
    for shift in range(0, 63, _DIGIT):
        if most >> shift == 0:
            break
        place = np.zeros((1 << _DIGIT) + 1, np.int64)
        for i in range(len(key)):
            place[(key[i] >> shift & (1 << _DIGIT) - 1) + 1] += 1
        for digit in range(1 << _DIGIT):
            place[digit + 1] += place[digit]
        for row in order:
            digit = key[row] >> shift & (1 << _DIGIT) - 1
            moved[place[digit]] = row
            place[digit] += 1
        order, moved = moved, order
    return order


def spatial_order(places: FloatArray) -> IntArray:
    """Rows of `places`, shape (m, dim), so that neighbours in the order are neighbours in space; shape (m,)."""
    return np.argsort(morton(_cells(places), _BITS).astype(np.int16), kind="stable")


@njit(cache=True, nogil=True)
def _cells(places: FloatArray) -> IntArray:
    """Cell of each place in a cube around all of them."""
    low, high = corners_of(places)
    dim, side = places.shape[1], (high - low).max()
    scale = (1 << _BITS) / side if side > 0.0 else 0.0
    cell = np.empty(places.shape, np.int64)
    for i in range(len(places)):
        for k in range(dim):
            cell[i, k] = min(int((places[i, k] - low[k]) * scale), (1 << _BITS) - 1)
    return cell


@njit(cache=True, nogil=True)
def is_before(points: FloatArray, one: int, other: int) -> bool:
    """Whether a row of points (n, dim) is less than another one in x, then y, z."""
    for k in range(points.shape[1]):
        if points[one, k] != points[other, k]:
            return bool(points[one, k] < points[other, k])
    return False

"""Heights over a plane: the plane or the quadric h = a + bx + cy + dx² + exy + fy² through them by least squares."""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
from numba import njit

from gpdf_service.fields.shapes import tangents
from gpdf_service.fields.tree import Tree, from_root, make_scratch, next_leaf, place_of
from gpdf_service.types import FloatArray


class Sums(NamedTuple):
    """What a fit of heights h = a + bx + cy + dx² + exy + fy² within each of several radii needs.

    Attributes:
        number: Of points, shape (scales,).
        moments: Of the products of two of 1, x, y, x², xy, y²: 1, x, y, x², xy, y², x³, …, y⁴, shape (scales, 15).
        heights: Of the first six with h, shape (scales, 6).
        square: Sum of h², shape (scales,).
    """

    number: FloatArray
    moments: FloatArray
    heights: FloatArray
    square: FloatArray


@njit(cache=True, nogil=True)
def make_sums(scales: int) -> Sums:
    """Room for the sums; made once a batch."""
    return Sums(np.zeros(scales), np.zeros((scales, 15)), np.zeros((scales, 6)), np.zeros(scales))


@njit(cache=True, nogil=True)
def sum_heights(tree: Tree, x: FloatArray, normal: FloatArray, radii: FloatArray, half: float, sums: Sums) -> None:
    """Fill the sums of the points around x, `half` [m] to either side along `normal`; x and y in units of radii[-1]."""
    blocks, boxes, limit, unit = tree.blocks, tree.boxes, radii[-1] ** 2, 1.0 / radii[-1]
    stack, bound, near_box = make_scratch()
    first, second = np.zeros(3), np.zeros(3)
    tangents(normal, first, second)
    number, moments, heights, square = sums
    number[:], moments[:], heights[:], square[:] = 0.0, 0.0, 0.0, 0.0
    place, top = place_of(x), from_root(stack, bound)
    while True:
        leaf, _, top = next_leaf(boxes, place, place, limit, stack, bound, near_box, top)
        if leaf < 0:
            break
        for j in range(tree.begin[leaf + 1] - tree.begin[leaf]):
            a, b, c = blocks[leaf, 0, j] - x[0], blocks[leaf, 1, j] - x[1], blocks[leaf, 2, j] - x[2]
            off, h = a * a + b * b + c * c, a * normal[0] + b * normal[1] + c * normal[2]
            if off > limit or abs(h) > half:
                continue
            ring = 0
            while off > radii[ring] ** 2:
                ring += 1
            u = (a * first[0] + b * first[1] + c * first[2]) * unit
            v = (a * second[0] + b * second[1] + c * second[2]) * unit
            add_height(sums, ring, u, v, h)
    for ring in range(1, len(radii)):
        number[ring] += number[ring - 1]
        square[ring] += square[ring - 1]
        heights[ring] += heights[ring - 1]
        moments[ring] += moments[ring - 1]


@njit(cache=True, nogil=True)
def add_height(sums: Sums, ring: int, u: float, v: float, h: float) -> None:
    """Add the height h at (u, v)."""
    uu, uv, vv = u * u, u * v, v * v
    m, t = sums.moments, sums.heights
    sums.number[ring] += 1.0
    sums.square[ring] += h * h
    m[ring, 0] += 1.0
    m[ring, 1] += u
    m[ring, 2] += v
    m[ring, 3] += uu
    m[ring, 4] += uv
    m[ring, 5] += vv
    m[ring, 6] += uu * u
    m[ring, 7] += uu * v
    m[ring, 8] += u * vv
    m[ring, 9] += vv * v
    m[ring, 10] += uu * uu
    m[ring, 11] += uu * uv
    m[ring, 12] += uu * vv
    m[ring, 13] += uv * vv
    m[ring, 14] += vv * vv
    t[ring, 0] += h
    t[ring, 1] += u * h
    t[ring, 2] += v * h
    t[ring, 3] += uu * h
    t[ring, 4] += uv * h
    t[ring, 5] += vv * h


_PRODUCT = ((0,), (1, 3), (2, 4, 5), (3, 6, 7, 10), (4, 7, 8, 11, 12), (5, 8, 9, 12, 13, 14))
"""Which moment the product of two of the six terms is."""
_TABLE = np.array([[row[l] if l < len(row) else -1 for l in range(6)] for row in _PRODUCT])


@njit(cache=True, nogil=True)
def quadric_rest(near: FloatArray, count: int, normal: FloatArray) -> float:
    """Squares [m²] that a quadric over the plane across `normal` leaves of the first `count` rows of `near`."""
    first, second, sums = np.zeros(3), np.zeros(3), make_sums(1)
    tangents(normal, first, second)
    far = 1e-12
    for i in range(count):
        far = max(far, sqrt(near[i, 0] ** 2 + near[i, 1] ** 2 + near[i, 2] ** 2))
    for i in range(count):
        u, v, h = 0.0, 0.0, 0.0
        for k in range(3):
            u += near[i, k] * first[k] / far
            v += near[i, k] * second[k] / far
            h += near[i, k] * normal[k]
        add_height(sums, 0, u, v, h)
    return fit_heights(sums, 0)[1][2]


Height = tuple[float, float, float]
"""Height at the origin [m], its variance over that of a point, sum of the squares that are left [m²]."""


@njit(cache=True, nogil=True)
def fit_heights(sums: Sums, scale: int) -> tuple[Height, Height]:
    """The plane and the quadric of the heights within one radius; the squares are inf where there is none.

    With the Cholesky factor L of the products, z = L⁻¹ heights and w = L⁻¹ (1, 0, …): the height at the origin is w·z,
    its variance w·w, and each z² is what its term takes off the squares. The first three terms are the plane.
    """
    L, z, w = np.zeros((6, 6)), np.zeros(6), np.zeros(6)
    height, variance, left = 0.0, 0.0, sums.square[scale]
    plane = (0.0, 0.0, np.inf)
    for k in range(6):
        for l in range(k + 1):
            part = sums.moments[scale, _TABLE[k, l]]
            for m in range(l):
                part -= L[k, m] * L[l, m]
            if l < k:
                L[k, l] = part / L[l, l]
            elif part <= 1e-12 * sums.number[scale]:
                return plane, (0.0, 0.0, np.inf)
            else:
                L[k, k] = sqrt(part)
        z[k], w[k] = sums.heights[scale, k], 1.0 if k == 0 else 0.0
        for m in range(k):
            z[k] -= L[k, m] * z[m]
            w[k] -= L[k, m] * w[m]
        z[k], w[k] = z[k] / L[k, k], w[k] / L[k, k]
        height, variance, left = height + w[k] * z[k], variance + w[k] ** 2, left - z[k] ** 2
        if k == 2:
            plane = (height, variance, max(left, 0.0))
    return plane, (height, variance, max(left, 0.0))

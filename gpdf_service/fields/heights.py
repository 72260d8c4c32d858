"""Heights over a plane: the quadric h = a + bx + cy + dx² + exy + fy² through them by least squares."""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
from numba import njit

from gpdf_service.fields.shapes import tangents
from gpdf_service.fields.tree import Look, Tree, from_root, next_leaf, place_of, rows_within
from gpdf_service.types import FloatArray


class Sums(NamedTuple):
    """What a fit of heights h = a + bx + cy + dx² + exy + fy² needs.

    Attributes:
        moments: Of the products of two of 1, x, y, x², xy, y²: 1, x, y, x², xy, y², x³, …, y⁴, shape (15,).
        heights: Of the first six with h, and of h², shape (7,).
        factor: Room for a fit, shape (8, 6).
    """

    moments: FloatArray
    heights: FloatArray
    factor: FloatArray


@njit(cache=True, nogil=True)
def make_sums() -> Sums:
    """Room for the sums; made once a batch."""
    return Sums(np.zeros(15), np.zeros(7), np.zeros((8, 6)))


@njit(cache=True, nogil=True)
def sum_heights(tree: Tree, x: FloatArray, normal: FloatArray, radius: float, sums: Sums, look: Look) -> None:
    """Fill the sums of the points within a `radius` [m] of x, which is their unit, over the plane across `normal`."""
    limit, unit = radius**2, 1.0 / radius
    nx, ny, nz = normal[0], normal[1], normal[2]
    ux, uy, uz, vx, vy, vz = tangents(normal)
    clear(sums)
    place, top = place_of(x), from_root(look.walk)
    while True:
        leaf, top = next_leaf(tree.boxes, place, place, limit, look.walk, top)
        if leaf < 0:
            return
        for j in look.row[: rows_within(tree, leaf, place, limit, look)]:
            a, b, c = look.offset[0, j], look.offset[1, j], look.offset[2, j]
            u, v = (a * ux + b * uy + c * uz) * unit, (a * vx + b * vy + c * vz) * unit
            add_height(sums, u, v, a * nx + b * ny + c * nz)


@njit(cache=True, nogil=True)
def clear(sums: Sums) -> None:
    """Begin anew."""
    sums.moments[:], sums.heights[:] = 0.0, 0.0


@njit(cache=True, nogil=True)
def add_height(sums: Sums, u: float, v: float, h: float) -> None:
    """Add the height h at (u, v)."""
    uu, uv, vv = u * u, u * v, v * v
    m, t = sums.moments, sums.heights
    m[0] += 1.0
    m[1] += u
    m[2] += v
    m[3] += uu
    m[4] += uv
    m[5] += vv
    m[6] += uu * u
    m[7] += uu * v
    m[8] += u * vv
    m[9] += vv * v
    m[10] += uu * uu
    m[11] += uu * uv
    m[12] += uu * vv
    m[13] += uv * vv
    m[14] += vv * vv
    t[0] += h
    t[1] += u * h
    t[2] += v * h
    t[3] += uu * h
    t[4] += uv * h
    t[5] += vv * h
    t[6] += h * h


_PRODUCT = ((0,), (1, 3), (2, 4, 5), (3, 6, 7, 10), (4, 7, 8, 11, 12), (5, 8, 9, 12, 13, 14))
"""Which moment the product of two of the six terms is."""
_TABLE = np.array([[row[l] if l < len(row) else -1 for l in range(6)] for row in _PRODUCT])


@njit(cache=True, nogil=True)
def quadric_rest(near: FloatArray, count: int, normal: FloatArray, sums: Sums) -> float:
    """Squares [m²] that a quadric over the plane across `normal` leaves of the first `count` rows of `near`."""
    nx, ny, nz = normal[0], normal[1], normal[2]
    ux, uy, uz, vx, vy, vz = tangents(normal)
    clear(sums)
    far = 1e-12
    for i in range(count):
        far = max(far, sqrt(near[i, 0] ** 2 + near[i, 1] ** 2 + near[i, 2] ** 2))
    for i in range(count):
        a, b, c = near[i, 0], near[i, 1], near[i, 2]
        u, v = a * ux / far + b * uy / far + c * uz / far, a * vx / far + b * vy / far + c * vz / far
        add_height(sums, u, v, a * nx + b * ny + c * nz)
    return fit_heights(sums)[2]


@njit(cache=True, nogil=True)
def fit_heights(sums: Sums) -> tuple[float, float, float]:
    """Of the quadric through the heights: the height at the origin [m], its variance over that of a point, the rest.

    That is the sum of the squares which it leaves [m²], inf where there is none. With the Cholesky factor L of the
    products, z = L⁻¹ heights and w = L⁻¹ (1, 0, …): the height at the origin is w·z, its variance w·w, and each z² is
    what its term takes off the squares.
    """
    L = sums.factor
    height, variance, left = 0.0, 0.0, sums.heights[6]
    for k in range(6):
        for l in range(k + 1):
            part = sums.moments[_TABLE[k, l]]
            for m in range(l):
                part -= L[k, m] * L[l, m]
            if l < k:
                L[k, l] = part / L[l, l]
            elif part <= 1e-12 * sums.moments[0]:
                return 0.0, 0.0, np.inf
            else:
                L[k, k] = sqrt(part)
        L[6, k], L[7, k] = sums.heights[k], 1.0 if k == 0 else 0.0
        for m in range(k):
            L[6, k] -= L[k, m] * L[6, m]
            L[7, k] -= L[k, m] * L[7, m]
        L[6, k], L[7, k] = L[6, k] / L[k, k], L[7, k] / L[k, k]
        height, variance, left = height + L[7, k] * L[6, k], variance + L[7, k] ** 2, left - L[6, k] ** 2
    return height, variance, max(left, 0.0)

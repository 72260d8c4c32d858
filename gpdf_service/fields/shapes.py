"""What a neighbourhood of points is, from its sums: a plane, two sheets or a pole.

A plane is the direction of least spread. A pole's cross-section is a ring of radius R seen with the error σ: with ρ the
distance from the axis, E ρ² = R² + 2σ² and Var ρ² = 4σ²R² + 4σ⁴, so both follow from the moments.
"""

from __future__ import annotations

from math import acos, cos, pi, sqrt

import numpy as np
from numba import njit

from gpdf_service.fields.tree import Look, Tree, from_root, next_leaf, place_of, rows_within
from gpdf_service.kernel_cache import lean
from gpdf_service.types import FloatArray

FEWEST = 8
"""Neighbours that a plane needs: three fix it, the others say how well."""
MOST = 2048
"""Neighbours that are looked at one by one: several times what the cure expects."""
TURNS = 6
"""Assignments of points to two planes: after five, few points change sides."""


@lean()
def gather(tree: Tree, x: FloatArray, radius: float, near: FloatArray, look: Look) -> int:
    """Write the offsets of the points within `radius` [m] of x into `near`, shape (MOST, 3); how many there are."""
    found, limit = 0, radius * radius
    place, top = place_of(x), from_root(look.walk)
    while True:
        leaf, top = next_leaf(tree.boxes, place, place, limit, look.walk, top)
        if leaf < 0:
            break
        for i in range(min(rows_within(tree, leaf, place, limit, look), MOST - found)):
            j = look.row[i]
            near[found, 0], near[found, 1], near[found, 2] = look.offset[0, j], look.offset[1, j], look.offset[2, j]
            found += 1
    return found


@lean()
def add(m: FloatArray, a: float, b: float, c: float) -> None:
    """Add one offset to the sums m, shape (10,): 1, the offset and its products."""
    m[0] += 1.0
    m[1] += a
    m[2] += b
    m[3] += c
    m[4] += a * a
    m[5] += b * b
    m[6] += c * c
    m[7] += a * b
    m[8] += a * c
    m[9] += b * c


@lean()
def ring_of(square: float, radii: FloatArray) -> int:
    """Which is the first of the radii that are not less than √`square`: without a branch, for it is by chance."""
    ring = 0
    for k in range(len(radii) - 1):
        ring += square > radii[k] ** 2
    return ring


@lean()
def sum_rings(tree: Tree, x: FloatArray, radii: FloatArray, moments: FloatArray, look: Look) -> None:
    """Sums over the neighbours within each radius, shape (scales, 10): 1, the offset from x and its products."""
    limit, moments[:] = radii[-1] ** 2, 0.0
    place, top = place_of(x), from_root(look.walk)
    while True:
        leaf, top = next_leaf(tree.boxes, place, place, limit, look.walk, top)
        if leaf < 0:
            break
        for i in range(rows_within(tree, leaf, place, limit, look)):
            j = look.row[i]
            add(moments[ring_of(look.square[j], radii)], look.offset[0, j], look.offset[1, j], look.offset[2, j])
    for ring in range(1, len(radii)):
        for k in range(moments.shape[1]):
            moments[ring, k] += moments[ring - 1, k]


@lean()
def fit_plane(m: FloatArray, mean: FloatArray, normal: FloatArray) -> tuple[float, float, float]:
    """Eigenvalues of the covariance, ascending; writes the mean offset and the direction of least spread.

    Closed form for a symmetric 3 × 3 matrix; Smith 1961.
    """
    n = m[0]
    for k in range(3):
        mean[k] = m[1 + k] / n
    xx, yy, zz = m[4] / n - mean[0] ** 2, m[5] / n - mean[1] ** 2, m[6] / n - mean[2] ** 2
    xy, xz, yz = m[7] / n - mean[0] * mean[1], m[8] / n - mean[0] * mean[2], m[9] / n - mean[1] * mean[2]
    q = (xx + yy + zz) / 3.0
    off = xy * xy + xz * xz + yz * yz
    p = sqrt(max(((xx - q) ** 2 + (yy - q) ** 2 + (zz - q) ** 2 + 2.0 * off) / 6.0, 1e-300))
    a, b, c, d, e, f = (xx - q) / p, (yy - q) / p, (zz - q) / p, xy / p, xz / p, yz / p
    half = (a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e)) / 2.0
    angle = acos(min(max(half, -1.0), 1.0)) / 3.0
    high = q + 2.0 * p * cos(angle)
    low = q + 2.0 * p * cos(angle + 2.0 * pi / 3.0)
    across((xx, yy, zz, xy, xz, yz), low, normal)
    return max(low, 0.0), 3.0 * q - high - low, high


@lean()
def across(spread: tuple[float, float, float, float, float, float], value: float, vector: FloatArray) -> None:
    """Write the eigenvector of `value`: the rows of A − λ I span what is normal to it, their longest product is it.

    The `spread` is A: xx, yy, zz, xy, xz, yz.
    """
    xx, yy, zz, xy, xz, yz = spread
    rows = ((xx - value, xy, xz), (xy, yy - value, yz), (xz, yz, zz - value))
    best = 0.0
    for i in range(3):
        u, v = rows[i], rows[(i + 1) % 3]
        cx, cy, cz = u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]
        length = cx * cx + cy * cy + cz * cz
        if length > best:
            best = length
            length = sqrt(length)
            vector[0], vector[1], vector[2] = cx / length, cy / length, cz / length
    if best == 0.0:
        vector[0], vector[1], vector[2] = 0.0, 0.0, 1.0


@njit(cache=True, nogil=True)
def split_sheets(near: FloatArray, count: int, normal: FloatArray, mean: FloatArray) -> float:
    """Variance [m²] within two sheets across `normal`, each half of the points taken for one; by turns, too.

    Of a single sheet with a Gaussian error it is 1 − 2/π of the whole.
    """
    cut, left = 0.0, 0.0
    for _ in range(TURNS):
        n, total, square = np.zeros(2), np.zeros(2), 0.0
        for i in range(count):
            h = 0.0
            for k in range(3):
                h += (near[i, k] - mean[k]) * normal[k]
            n[int(h > cut)] += 1.0
            total[int(h > cut)] += h
            square += h * h
        if min(n[0], n[1]) < FEWEST:
            return np.inf
        cut = 0.5 * (total[0] / n[0] + total[1] / n[1])
        left = (square - total[0] ** 2 / n[0] - total[1] ** 2 / n[1]) / (count - 4.0)
    return max(left, 0.0)


@njit(cache=True, nogil=True)
def fit_ring(near: FloatArray, count: int, mean: FloatArray, axis: FloatArray) -> tuple[float, float]:
    """Squared radius of a pole along `axis` and the variance of its points' errors [m²]."""
    first, second = 0.0, 0.0
    for i in range(count):
        square, along = 0.0, 0.0
        for k in range(3):
            offset = near[i, k] - mean[k]
            square += offset * offset
            along += offset * axis[k]
        first += (square - along * along) / count
        second += (square - along * along) ** 2 / count
    variance = 0.5 * (first - sqrt(max(2.0 * first * first - second, 0.0)))
    return max(first - 2.0 * variance, 0.0), variance


@lean()
def fit_axis(m: FloatArray, value: float, axis: FloatArray) -> None:
    """Write the direction in which the spread of the sums m is `value` [m²]: its eigenvector."""
    n = m[0]
    a, b, c = m[1] / n, m[2] / n, m[3] / n
    xx, yy, zz, xy, xz, yz = m[4] / n, m[5] / n, m[6] / n, m[7] / n, m[8] / n, m[9] / n
    across((xx - a * a, yy - b * b, zz - c * c, xy - a * b, xz - a * c, yz - b * c), value, axis)


@lean()
def tangents(normal: FloatArray) -> tuple[float, float, float, float, float, float]:
    """Two unit vectors across `normal` and each other."""
    nx, ny, nz = normal[0], normal[1], normal[2]
    if abs(nx) < 0.6:
        a, b, c = 1.0 - nx * nx, 0.0 - nx * ny, 0.0 - nx * nz
    else:
        a, b, c = 0.0 - ny * nx, 1.0 - ny * ny, 0.0 - ny * nz
    length = sqrt(a**2 + b**2 + c**2)
    a, b, c = a / length, b / length, c / length
    return a, b, c, ny * c - nz * b, nz * a - nx * c, nx * b - ny * a

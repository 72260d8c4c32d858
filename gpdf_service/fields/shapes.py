"""What a neighbourhood of points is: a plane, a quadric, two planes that meet, or a pole.

A plane is the direction of least spread. Two planes are found by turns: each point goes to the nearer half plane, each
half plane is fitted to its points; they end where they meet, so that an edge stays an edge. A pole's cross-section is
a ring of radius R seen with the error σ: with ρ the distance from the axis, E ρ² = R² + 2σ² and
Var ρ² = 4σ²R² + 4σ⁴, so both follow from the moments.
"""

from __future__ import annotations

from math import acos, cos, pi, sqrt
from typing import NamedTuple

import numpy as np
from numba import njit

from gpdf_service.fields.traversal import STACK
from gpdf_service.fields.tree import Tree, box_distance2
from gpdf_service.types import FloatArray, IntArray

FEWEST = 8
"""Neighbours that a plane needs: three fix it, the others say how well."""
MOST = 2048
"""Neighbours that are looked at one by one: several times what the cure expects."""
_TURNS = 6
"""Assignments of points to two planes: after five, few points change sides."""
_PARALLEL = 0.2
"""[-] Sine of an angle (12°) below which two planes are taken for parallel: where they meet is not known."""
_FOLD = 0.7
"""[-] Cosine of the least angle (45°) between two half planes."""
_STARTS = 4
"""Directions along which a neighbourhood is cut in two at first: 45° apart, so one of them is within 23° of an edge."""


@njit(cache=True, nogil=True)
def gather(tree: Tree, x: FloatArray, radius: float, near: FloatArray) -> int:
    """Write the offsets of the points within `radius` [m] of x into `near`, shape (MOST, 3); how many there are."""
    nodes, found, limit = tree.begin.shape[0], 0, radius * radius
    stack = np.empty(STACK, np.int64)
    stack[0], top = 0, 1
    while top > 0:
        top -= 1
        node = stack[top]
        if box_distance2(tree.low, tree.high, node, x) > limit:
            continue
        if 2 * node + 1 < nodes:
            stack[top], stack[top + 1] = 2 * node + 1, 2 * node + 2
            top += 2
            continue
        for i in range(tree.begin[node], tree.end[node]):
            a, b, c = tree.points[i, 0] - x[0], tree.points[i, 1] - x[1], tree.points[i, 2] - x[2]
            if a * a + b * b + c * c <= limit and found < MOST:
                near[found, 0], near[found, 1], near[found, 2] = a, b, c
                found += 1
    return found


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
def sum_rings(
    tree: Tree, x: FloatArray, radii: FloatArray, normal: FloatArray, half: float, moments: FloatArray
) -> None:
    """Sums over the neighbours within each radius, shape (scales, 10): 1, the offset from x and its products.

    Of the neighbours only those in the slab around x across `normal`, `half` [m] to either side; all if it is zero.
    """
    nodes = tree.begin.shape[0]
    stack = np.empty(STACK, np.int64)
    moments[:] = 0.0
    limit = radii[-1] ** 2
    stack[0], top = 0, 1
    while top > 0:
        top -= 1
        node = stack[top]
        if box_distance2(tree.low, tree.high, node, x) > limit:
            continue
        if 2 * node + 1 < nodes:
            stack[top], stack[top + 1] = 2 * node + 1, 2 * node + 2
            top += 2
            continue
        for i in range(tree.begin[node], tree.end[node]):
            a, b, c = tree.points[i, 0] - x[0], tree.points[i, 1] - x[1], tree.points[i, 2] - x[2]
            square = a * a + b * b + c * c
            if square > limit or abs(a * normal[0] + b * normal[1] + c * normal[2]) > half:
                continue
            ring = 0
            while square > radii[ring] ** 2:
                ring += 1
            add(moments[ring], a, b, c)
    for ring in range(1, len(radii)):
        moments[ring] += moments[ring - 1]


@njit(cache=True, nogil=True)
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
    across(xx, yy, zz, xy, xz, yz, low, normal)
    return max(low, 0.0), 3.0 * q - high - low, high


@njit(cache=True, nogil=True)
def across(xx: float, yy: float, zz: float, xy: float, xz: float, yz: float, value: float, vector: FloatArray) -> None:
    """Write the eigenvector of `value`: the rows of A − λ I span what is normal to it, their longest product is it."""
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
def fit_pair(near: FloatArray, count: int, normal: FloatArray, side: IntArray, pair: FloatArray) -> float:
    """Fit two half planes to the first `count` rows of `near`; the squares that are left [m²], inf if there are none.

    Args:
        near: Offsets [m], shape (MOST, 3).
        count: How many of them.
        normal: Of one plane through all of them.
        side: Room for which half plane each is of, shape (MOST,).
        pair: Where the best is written, shape (3, 9): `_meet`.
    """
    best = np.inf
    first, second, mine = np.zeros(3), np.zeros(3), np.zeros((3, 9))
    tangents(normal, first, second)
    for start in range(_STARTS):
        cut = first * cos(pi * start / _STARTS) + second * cos(pi * start / _STARTS - pi / 2.0)
        middle = 0.0
        for i in range(count):
            middle += (near[i, 0] * cut[0] + near[i, 1] * cut[1] + near[i, 2] * cut[2]) / count
        for i in range(count):
            side[i] = near[i, 0] * cut[0] + near[i, 1] * cut[1] + near[i, 2] * cut[2] > middle
        left = _by_turns(near, count, side, mine)
        if left < best:
            best = left
            pair[:] = mine
    return best


@njit(cache=True, nogil=True)
def _by_turns(near: FloatArray, count: int, side: IntArray, pair: FloatArray) -> float:
    moments, mean, left = np.zeros((2, 10)), np.zeros(3), np.inf
    for _ in range(_TURNS):
        moments[:] = 0.0
        for i in range(count):
            add(moments[side[i]], near[i, 0], near[i, 1], near[i, 2])
        if min(moments[0, 0], moments[1, 0]) < FEWEST:
            return np.inf
        for k in range(2):
            _, pair[k, 7], _ = fit_plane(moments[k], mean, pair[k, 3:6])
            pair[k, 0:3], pair[k, 6] = mean, moments[k, 0]
        if not meet(pair):
            return np.inf
        left, changed = 0.0, 0
        for i in range(count):
            a, b = from_half(pair, 0, near[i]), from_half(pair, 1, near[i])
            changed += (b < a) != side[i]
            side[i] = b < a
            left += min(a, b)
        if changed == 0:
            break
    return left


@njit(cache=True, nogil=True)
def meet(pair: FloatArray) -> bool:
    """Complete two planes, rows 0 and 1 of (mean, normal, count, variance along, side), by the line where they meet.

    That is row 2: a point of the line and its direction. The last number of rows 0 and 1 says on which side of it they
    are. False if they are nearly parallel or fold back on each other: two layers of noise do that.
    """
    n, o = pair[0, 3:6], pair[1, 3:6]
    ux, uy, uz = n[1] * o[2] - n[2] * o[1], n[2] * o[0] - n[0] * o[2], n[0] * o[1] - n[1] * o[0]
    square = ux * ux + uy * uy + uz * uz
    if square <= _PARALLEL**2:
        return False
    g = n[0] * pair[0, 0] + n[1] * pair[0, 1] + n[2] * pair[0, 2]
    h = o[0] * pair[1, 0] + o[1] * pair[1, 1] + o[2] * pair[1, 2]
    pair[2, 0] = (g * (o[1] * uz - o[2] * uy) + h * (uy * n[2] - uz * n[1])) / square
    pair[2, 1] = (g * (o[2] * ux - o[0] * uz) + h * (uz * n[0] - ux * n[2])) / square
    pair[2, 2] = (g * (o[0] * uy - o[1] * ux) + h * (ux * n[1] - uy * n[0])) / square
    length = sqrt(square)
    pair[2, 3], pair[2, 4], pair[2, 5] = ux / length, uy / length, uz / length
    for k in range(2):
        pair[k, 8] = 1.0
        if beside(pair, k, pair[k, 0:3]) < 0.0:
            pair[k, 8] = -1.0
    # Along the half planes, across the line: (u × n)·(u × o) = n·o.
    fold = pair[0, 8] * pair[1, 8] * (n[0] * o[0] + n[1] * o[1] + n[2] * o[2])
    return fold < _FOLD


@njit(cache=True, nogil=True)
def beside(pair: FloatArray, k: int, x: FloatArray) -> float:
    """How far x is from the line on the side of half plane k, along it [m]; negative beyond its end."""
    u, n = pair[2, 3:6], pair[k, 3:6]
    s = (x[0] - pair[2, 0]) * (u[1] * n[2] - u[2] * n[1])
    s += (x[1] - pair[2, 1]) * (u[2] * n[0] - u[0] * n[2])
    s += (x[2] - pair[2, 2]) * (u[0] * n[1] - u[1] * n[0])
    return s * pair[k, 8]


@njit(cache=True, nogil=True)
def from_half(pair: FloatArray, k: int, x: FloatArray) -> float:
    """Squared distance of x from half plane k [m²]."""
    n = pair[k, 3:6]
    a = n[0] * (x[0] - pair[k, 0]) + n[1] * (x[1] - pair[k, 1]) + n[2] * (x[2] - pair[k, 2])
    s = min(beside(pair, k, x), 0.0)
    return a * a + s * s


@njit(cache=True, nogil=True)
def split_sheets(near: FloatArray, count: int, normal: FloatArray, mean: FloatArray) -> float:
    """Variance [m²] within two sheets across `normal`, each half of the points taken for one; by turns, too.

    Of a single sheet with a Gaussian error it is 1 − 2/π of the whole.
    """
    cut, left = 0.0, 0.0
    for _ in range(_TURNS):
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


@njit(cache=True, nogil=True)
def fit_axis(m: FloatArray, value: float, axis: FloatArray) -> None:
    """Write the direction in which the spread of the sums m is `value` [m²]: its eigenvector."""
    n = m[0]
    a, b, c = m[1] / n, m[2] / n, m[3] / n
    xx, yy, zz, xy, xz, yz = m[4] / n, m[5] / n, m[6] / n, m[7] / n, m[8] / n, m[9] / n
    across(xx - a * a, yy - b * b, zz - c * c, xy - a * b, xz - a * c, yz - b * c, value, axis)


@njit(cache=True, nogil=True)
def onto_half(pair: FloatArray, k: int, x: FloatArray, place: FloatArray) -> None:
    """Write the point of half plane k that is nearest to x."""
    n, u = pair[k, 3:6], pair[2, 3:6]
    if beside(pair, k, x) >= 0.0:
        place[:] = x - ((x - pair[k, 0:3]) * n).sum() * n
    else:
        place[:] = pair[2, 0:3] + ((x - pair[2, 0:3]) * u).sum() * u


class Sums(NamedTuple):
    """What a fit of heights h = a + bx + cy + dx² + exy + fy² within each of several radii needs.

    Attributes:
        count: Points, shape (scales,).
        products: Of (1, x, y, x², xy, y²) with itself, shape (scales, 6, 6).
        heights: Of it with h, shape (scales, 6).
        square: Sum of h², shape (scales,).
    """

    count: FloatArray
    products: FloatArray
    heights: FloatArray
    square: FloatArray


@njit(cache=True, nogil=True)
def make_sums(scales: int) -> Sums:
    """Room for the sums; made once a batch."""
    return Sums(np.zeros(scales), np.zeros((scales, 6, 6)), np.zeros((scales, 6)), np.zeros(scales))


@njit(cache=True, nogil=True)
def sum_heights(tree: Tree, x: FloatArray, normal: FloatArray, radii: FloatArray, half: float, sums: Sums) -> None:
    """Fill the sums of the points around x, `half` [m] to either side along `normal`; x and y in units of radii[-1]."""
    nodes, stack, limit, unit = tree.begin.shape[0], np.empty(STACK, np.int64), radii[-1] ** 2, 1.0 / radii[-1]
    first, second = np.zeros(3), np.zeros(3)
    tangents(normal, first, second)
    count, products, heights, square = sums
    count[:], products[:], heights[:], square[:] = 0.0, 0.0, 0.0, 0.0
    stack[0], top = 0, 1
    while top > 0:
        top -= 1
        node = stack[top]
        if box_distance2(tree.low, tree.high, node, x) > limit:
            continue
        if 2 * node + 1 < nodes:
            stack[top], stack[top + 1] = 2 * node + 1, 2 * node + 2
            top += 2
            continue
        for i in range(tree.begin[node], tree.end[node]):
            a, b, c = tree.points[i, 0] - x[0], tree.points[i, 1] - x[1], tree.points[i, 2] - x[2]
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
        count[ring] += count[ring - 1]
        square[ring] += square[ring - 1]
        heights[ring] += heights[ring - 1]
        products[ring] += products[ring - 1]


@njit(cache=True, nogil=True)
def add_height(sums: Sums, ring: int, u: float, v: float, h: float) -> None:
    """Add the height h at (u, v)."""
    basis = (1.0, u, v, u * u, u * v, v * v)
    sums.count[ring] += 1.0
    sums.square[ring] += h * h
    for k in range(6):
        sums.heights[ring, k] += basis[k] * h
        for l in range(k + 1):
            sums.products[ring, k, l] += basis[k] * basis[l]


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
            part = sums.products[scale, k, l]
            for m in range(l):
                part -= L[k, m] * L[l, m]
            if l < k:
                L[k, l] = part / L[l, l]
            elif part <= 1e-12 * sums.count[scale]:
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


@njit(cache=True, nogil=True)
def tangents(normal: FloatArray, first: FloatArray, second: FloatArray) -> None:
    """Write two unit vectors across `normal` and each other."""
    lean = 0 if abs(normal[0]) < 0.6 else 1
    for k in range(3):
        first[k] = (1.0 if k == lean else 0.0) - normal[lean] * normal[k]
    length = sqrt(first[0] ** 2 + first[1] ** 2 + first[2] ** 2)
    for k in range(3):
        first[k] /= length
    for k in range(3):
        a, b = (k + 1) % 3, (k + 2) % 3
        second[k] = normal[a] * first[b] - normal[b] * first[a]

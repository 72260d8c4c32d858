"""What a neighbourhood of points is: a plane, two sheets, a pole, from its sums; or two half planes that meet, an edge.

A plane is the direction of least spread. A pole's cross-section is a ring of radius R seen with the error σ: with ρ the
distance from the axis, E ρ² = R² + 2σ² and Var ρ² = 4σ²R² + 4σ⁴, so both follow from the moments. An edge is found by
turns: each point goes to the nearer half plane, and each half plane, up to where they meet, is fitted to its points.
"""

from __future__ import annotations

from math import acos, cos, pi, sqrt

import numpy as np
from numba import njit

from gpdf_service.fields.tree import Look, Tree, from_root, next_leaf, place_of, rows_within
from gpdf_service.kernel_cache import lean
from gpdf_service.types import FloatArray, IntArray

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


_PARALLEL = 0.2
"""[-] Sine of an angle (12°) below which two planes are taken for parallel: where they meet is not known."""
_FOLD = 0.7
"""[-] Cosine of the least angle (45°) between two half planes."""
_EQUAL = 1e-9
"""[m] Lengths that differ by less are equal: else the order of a sum decides, which is that of the tree."""
EDGE = 0.6
"""[-] Variance about two half planes over that about a quadric, below which it is an edge; noise alone gives 0.75."""
_STARTS = 4
"""Directions along which a neighbourhood is cut in two at first: 45° apart, so one of them is within 23° of an edge."""


@njit(cache=True, nogil=True)
def fit_pair(near: FloatArray, count: int, normal: FloatArray, side: IntArray, pair: FloatArray) -> float:
    """Fit two half planes to the first `count` rows of `near`; the squares that are left [m²], inf if there are none.

    The `normal` is that of one plane through all of them; which half plane each is of is written to `side`, (MOST,),
    the best two to `pair`, (3, 9): see `meet`.
    """
    best = np.inf
    mine = np.zeros((3, 9))
    ux, uy, uz, vx, vy, vz = tangents(normal)
    for start in range(_STARTS):
        u, v, middle = cos(pi * start / _STARTS), cos(pi * start / _STARTS - pi / 2.0), 0.0
        a, b, c = ux * u + vx * v, uy * u + vy * v, uz * u + vz * v
        for i in range(count):
            middle += (near[i, 0] * a + near[i, 1] * b + near[i, 2] * c) / count
        for i in range(count):
            side[i] = near[i, 0] * a + near[i, 1] * b + near[i, 2] * c > middle + _EQUAL
        left = _by_turns(near, count, side, mine)
        if left < best - _EQUAL**2:
            best = left
            pair[:] = mine
    return best


@njit(cache=True, nogil=True)
def _by_turns(near: FloatArray, count: int, side: IntArray, pair: FloatArray) -> float:
    moments, mean, left = np.zeros((2, 10)), np.zeros(3), np.inf
    for _ in range(TURNS):
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
        left, changed, level = 0.0, 0, is_second_more_level(pair)
        first, second = _inwards(pair, 0), _inwards(pair, 1)
        for i in range(count):
            one, other = _from_half(pair, 0, first, near[i]), _from_half(pair, 1, second, near[i])
            nearest = _nearer(one, other, level)
            changed += nearest != side[i]
            side[i] = nearest
            left += other if nearest else one
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
    return bool(fold < _FOLD)


@njit(cache=True, nogil=True)
def _inwards(pair: FloatArray, k: int) -> tuple[float, float, float]:
    """The way along half plane k, across the line."""
    u, n, sign = pair[2, 3:6], pair[k, 3:6], pair[k, 8]
    return (u[1] * n[2] - u[2] * n[1]) * sign, (u[2] * n[0] - u[0] * n[2]) * sign, (u[0] * n[1] - u[1] * n[0]) * sign


@njit(cache=True, nogil=True)
def beside(pair: FloatArray, k: int, x: FloatArray) -> float:
    """How far x is from the line on the side of half plane k, along it [m]; negative beyond its end."""
    a, b, c = _inwards(pair, k)
    return float((x[0] - pair[2, 0]) * a + (x[1] - pair[2, 1]) * b + (x[2] - pair[2, 2]) * c)


@njit(cache=True, nogil=True)
def _from_half(pair: FloatArray, k: int, inwards: tuple[float, float, float], x: FloatArray) -> float:
    """Squared distance of x from half plane k [m²]."""
    (a, b, c), n = inwards, pair[k, 3:6]
    off = n[0] * (x[0] - pair[k, 0]) + n[1] * (x[1] - pair[k, 1]) + n[2] * (x[2] - pair[k, 2])
    s = min((x[0] - pair[2, 0]) * a + (x[1] - pair[2, 1]) * b + (x[2] - pair[2, 2]) * c, 0.0)
    return float(off * off + s * s)


@njit(cache=True, nogil=True)
def is_second_more_level(pair: FloatArray) -> bool:
    """Whether the second half plane leans less than the first, or as much and more along x."""
    o, n = pair[0, 3:6], pair[1, 3:6]
    more = abs(n[2]) - abs(o[2])
    return bool(more > _EQUAL or (more >= -_EQUAL and abs(n[0]) > abs(o[0]) + _EQUAL))


@njit(cache=True, nogil=True)
def nearest_half(pair: FloatArray, x: FloatArray) -> int:
    """The half plane that is nearer to x; on the line where they meet the more level one."""
    one, other = _from_half(pair, 0, _inwards(pair, 0), x), _from_half(pair, 1, _inwards(pair, 1), x)
    return _nearer(one, other, is_second_more_level(pair))


@njit(cache=True, nogil=True)
def _nearer(one: float, other: float, level: bool) -> int:
    """Which of two squared distances is less; of equal ones the second, if that is the more level one."""
    more = other - one
    return int(more < -(_EQUAL**2) or (more <= _EQUAL**2 and level))

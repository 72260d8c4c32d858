"""Two half planes that meet: an edge, found by turns.

Each point goes to the nearer half plane, and each half plane is fitted to its points. They end where they meet, so that
an edge stays an edge.
"""

from __future__ import annotations

from math import cos, pi, sqrt

import numpy as np
from numba import njit

from gpdf_service.fields.shapes import FEWEST, TURNS, add, fit_plane, tangents
from gpdf_service.types import FloatArray, IntArray

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

    Args:
        near: Offsets [m], shape (MOST, 3).
        count: How many of them.
        normal: Of one plane through all of them.
        side: Room for which half plane each is of, shape (MOST,).
        pair: Where the best is written, shape (3, 9): `_meet`.
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
    lean = abs(n[2]) - abs(o[2])
    return bool(lean > _EQUAL or (lean >= -_EQUAL and abs(n[0]) > abs(o[0]) + _EQUAL))


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

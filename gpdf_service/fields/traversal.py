"""One nearest-first walk through the tree: nearest point, kernel sum and its gradient.

With δ = the squared distance of the nearest point seen so far, the walk keeps
    S = Σ αᵢ exp(−(‖x − xᵢ‖² − δ) / 2l²)   and   M = Σ αᵢ exp(−(‖x − xᵢ‖² − δ) / 2l²) (xᵢ − x),
rescaled whenever δ shrinks, and leaves out every box beyond ‖x − xᵢ‖² > δ + (R l)². Then
    r(o)² = −2l² log o = δ − 2l² log S   and   ∇d = −(M/S) / d,
the reverting function of Uttsha et al. 2024 (after Le Gentil et al. 2023) in the log domain: no underflow at any range.
A leaf's points are worked on as vectors: the loops over them have no branch and no call. A place
in 2D is one in 3D whose third coordinate weighs nothing, so that all loops are straight.
"""

from __future__ import annotations

from math import exp, log, sqrt
from typing import NamedTuple

import numpy as np
from numba import njit

from gpdf_service.fields.tree import LEAF_SIZE, Tree, box_distance2
from gpdf_service.types import FloatArray, IntArray

CUT_RADIUS = 4.5
"""R: terms beyond R length scales change the distance by at most 0.7 mm against R = 8 (measured in an office)."""
STACK = 128
"""Nodes waiting at once: two a level, and 2^60 points do not exist."""
_VECTORS = {"reassoc", "contract", "nsz", "arcp"}
"""Sums may be reordered into vectors; NaN and inf keep their meaning."""


Place = tuple[float, float, float]
"""(x, y, z) [m]; in 2D the last is not looked at."""


class FieldArrays(NamedTuple):
    """All that a compiled loop needs to ask a field."""

    points: FloatArray
    alpha: FloatArray
    gap2: FloatArray
    begin: IntArray
    end: IntArray
    low: FloatArray
    high: FloatArray
    length_scale: float


def nearest_only(tree: Tree) -> FieldArrays:
    """A field without a Gaussian process: the exact distance to the nearest point."""
    count = len(tree.points)
    return FieldArrays(
        tree.points,
        np.zeros(count),
        np.zeros(count),
        tree.begin,
        tree.end,
        tree.low,
        tree.high,
        np.finfo(float).tiny ** 0.25,
    )


class Scratch(NamedTuple):
    """What one walk needs to remember; made once a batch."""

    stack: IntArray
    bound: FloatArray
    squares: FloatArray


@njit(cache=True, nogil=True)
def make_scratch() -> Scratch:
    """Fresh scratch for one thread."""
    return Scratch(np.empty(STACK, np.int64), np.empty(STACK), np.empty(LEAF_SIZE))


@njit(cache=True, nogil=True, fastmath=_VECTORS)
def walk(field: FieldArrays, x: Place, scratch: Scratch) -> tuple[float, int, float, Place]:
    """δ, the row of the nearest point, S, and M at one place."""
    points, alpha, low, high = field.points, field.alpha, field.low, field.high
    stack, bound, squares = scratch.stack, scratch.bound, scratch.squares
    nodes, last = field.begin.shape[0], points.shape[1] - 1
    third = 1.0 if last == 2 else 0.0
    x0, x1, x2 = x
    rate = 1.0 / (2.0 * field.length_scale * field.length_scale)
    reach = (CUT_RADIUS * field.length_scale) ** 2
    delta, row, total, m0, m1, m2 = np.inf, 0, 0.0, 0.0, 0.0, 0.0
    stack[0], bound[0], top = 0, 0.0, 1
    while top > 0:
        top -= 1
        node, near = stack[top], bound[top]
        while 2 * node + 1 < nodes and near <= delta + reach:
            left = 2 * node + 1
            a = max(low[left, 0] - x0, 0.0, x0 - high[left, 0]) ** 2
            a += max(low[left, 1] - x1, 0.0, x1 - high[left, 1]) ** 2
            a += max(low[left, last] - x2, 0.0, x2 - high[left, last]) ** 2 * third
            b = max(low[left + 1, 0] - x0, 0.0, x0 - high[left + 1, 0]) ** 2
            b += max(low[left + 1, 1] - x1, 0.0, x1 - high[left + 1, 1]) ** 2
            b += max(low[left + 1, last] - x2, 0.0, x2 - high[left + 1, last]) ** 2 * third
            node, other, near, far = (left, left + 1, a, b) if a <= b else (left + 1, left, b, a)
            if far <= delta + reach:
                stack[top], bound[top] = other, far
                top += 1
        if near > delta + reach:
            continue
        for first in range(field.begin[node], field.end[node], LEAF_SIZE):
            count = min(LEAF_SIZE, field.end[node] - first)
            least = np.inf
            for j in range(count):
                i = first + j
                square = (points[i, 0] - x0) ** 2 + (points[i, 1] - x1) ** 2 + third * (points[i, last] - x2) ** 2
                squares[j] = square
                least = min(least, square)
            if least > delta + reach:
                continue
            if least < delta:
                shrink = exp((least - delta) * rate) if total != 0.0 else 0.0
                total, m0, m1, m2 = total * shrink, m0 * shrink, m1 * shrink, m2 * shrink
                delta = least
                for j in range(count):
                    if squares[j] == least:
                        row = first + j
            s, n0, n1, n2 = 0.0, 0.0, 0.0, 0.0
            for j in range(count):
                i = first + j
                weight = alpha[i] * decay(min((squares[j] - delta) * rate, _STEEPEST))
                weight = weight if squares[j] <= delta + reach else 0.0
                s += weight
                n0 += weight * (points[i, 0] - x0)
                n1 += weight * (points[i, 1] - x1)
                n2 += weight * (points[i, last] - x2)
            total, m0, m1, m2 = total + s, m0 + n0, m1 + n1, m2 + n2
    return delta, row, total, (m0, m1, m2)


_STEEPEST = CUT_RADIUS**2 / 2.0 + 1.0
"""Exponents beyond the cut are multiplied by zero; this keeps them in the polynomial's range."""


@njit(cache=True, nogil=True, fastmath=_VECTORS, inline="always")
def decay(t: float) -> float:
    """exp(−t) for 0 ≤ t ≤ 12 within 1e-7 of itself up to t = 4 and 4e-5 beyond: (a polynomial of t/16)^16, no call."""
    u = t * 0.0625
    e = 1.0 - u * (1.0 - u * (1 / 2 - u * (1 / 6 - u * (1 / 24 - u * (1 / 120 - u * (1 / 720 - u / 5040))))))
    e *= e
    e *= e
    e *= e
    return e * e


@njit(cache=True, nogil=True)
def sample(field: FieldArrays, x: Place, scratch: Scratch, gradient: FloatArray) -> tuple[float, int, float]:
    """Distance at one place, the row of the nearest point, and how much less the distance may be [m].

    Writes the gradient, shape (dim,). The bracket: never more room than to the nearest point, √δ; never less than
    √(δ − gap²), the least that a surface through points no further apart than the gap allows. Where the sums say
    nothing (S ≤ 0, or more room than to the nearest point) that point gives the direction: an edge, whose true place
    may be a gap beyond that point.
    """
    delta, row, total, moment = walk(field, x, scratch)
    distance2 = delta - 2.0 * field.length_scale * field.length_scale * log(total) if total > 0.0 else delta
    floor2 = max(delta - field.gap2[row], 0.0)
    inside = total > 0.0 and distance2 <= delta
    distance = sqrt(min(max(distance2, floor2), delta))
    norm = 0.0
    for k in range(len(gradient)):
        gradient[k] = -moment[k] / total if inside else x[k] - field.points[row, k]
        norm += gradient[k] * gradient[k]
    norm = max(distance, sqrt(norm))
    for k in range(len(gradient)):
        gradient[k] = gradient[k] / norm if norm > 0.0 else 0.0
    return distance, row, sqrt(delta) - sqrt(floor2) if inside else min(distance, sqrt(field.gap2[row]))


@njit(cache=True, nogil=True)
def sample_one(field: FieldArrays, x: FloatArray, gradient: FloatArray) -> float:
    """Distance at one place [m]; writes the gradient, shape (dim,)."""
    return sample(field, (x[0], x[1], x[-1]), make_scratch(), gradient)[0]


@njit(cache=True, nogil=True)
def sample_range(
    field: FieldArrays,
    queries: FloatArray,
    order: IntArray,
    begin: int,
    end: int,
    distance: FloatArray,
    gradient: FloatArray,
    row: IntArray,
    bracket: FloatArray,
) -> None:
    """`sample` for the queries order[begin..end]."""
    scratch = make_scratch()
    for i in order[begin:end]:
        place = (queries[i, 0], queries[i, 1], queries[i, -1])
        distance[i], row[i], bracket[i] = sample(field, place, scratch, gradient[i])


@njit(cache=True, nogil=True)
def nearest_one(tree: Tree, x: FloatArray) -> tuple[float, int]:
    """Exact nearest point: its distance [m] and its row in `tree.points`."""
    stack = np.empty(STACK, np.int64)
    bound = np.empty(STACK)
    nodes = tree.begin.shape[0]
    delta, index = np.inf, 0
    stack[0], bound[0], top = 0, box_distance2(tree.low, tree.high, 0, x), 1
    while top > 0:
        top -= 1
        node = stack[top]
        if bound[top] >= delta:
            continue
        left = 2 * node + 1
        if left < nodes:
            a, b = box_distance2(tree.low, tree.high, left, x), box_distance2(tree.low, tree.high, left + 1, x)
            near, far = (left, left + 1) if a <= b else (left + 1, left)
            stack[top], bound[top] = far, max(a, b)
            stack[top + 1], bound[top + 1] = near, min(a, b)
            top += 2
            continue
        for i in range(tree.begin[node], tree.end[node]):
            distance2 = 0.0
            for k in range(x.shape[0]):
                gap = x[k] - tree.points[i, k]
                distance2 += gap * gap
            if distance2 < delta:
                delta, index = distance2, i
    return sqrt(delta), index


@njit(cache=True, nogil=True)
def nearest_range(
    tree: Tree, queries: FloatArray, first: int, last: int, distance: FloatArray, index: IntArray
) -> None:
    """`nearest_one` for the rows first..last of `queries`."""
    for q in range(first, last):
        distance[q], index[q] = nearest_one(tree, queries[q])

"""One nearest-first walk through the tree: nearest point, kernel sum and its gradient.

With δ = the squared distance of the nearest point seen so far, the walk keeps
    S = Σ αᵢ exp(−(‖x − xᵢ‖² − δ) / 2l²)   and   M = Σ αᵢ exp(−(‖x − xᵢ‖² − δ) / 2l²) (xᵢ − x),
rescaled whenever δ shrinks, and leaves out every box beyond ‖x − xᵢ‖² > δ + (R l)². Then
    r(o)² = −2l² log o = δ − 2l² log S   and   ∇d = −(M/S) / d,
the reverting function of Uttsha et al. 2024 (after Le Gentil et al. 2023) in the log domain: no underflow at any range.
A leaf's points are worked on as vectors: the loops over them have no branch, no call and one length. That is why they
index arrays and take no views of them: a view is counted, which costs more than what is done with it.
"""

from __future__ import annotations

from math import exp, log, sqrt
from typing import NamedTuple

import numpy as np
from numba import njit

from gpdf_service.fields.tree import (
    LEAF_SIZE,
    VECTORS,
    Place,
    Scratch,
    Tree,
    from_root,
    lesser,
    make_scratch,
    next_leaf,
    place_of,
)
from gpdf_service.types import FloatArray, IntArray

CUT_RADIUS = 4.5
"""R: terms beyond R length scales change the distance by at most 0.7 mm against R = 8 (measured in an office)."""
_STEEPEST = CUT_RADIUS**2 / 2.0 + 1.0
"""Exponents beyond the cut are multiplied by zero; this keeps them in the polynomial's range."""


class FieldArrays(NamedTuple):
    """All that a compiled loop needs to ask a field: of the tree, and α and the squared gap around each point.

    Attributes:
        points: [m], shape (n, dim).
        begin: First row of each leaf, and n, shape (leaves + 1,).
        blocks: The leaves' points [m], shape (leaves, 3, 32).
        boxes: The nodes' boxes [m], shape (nodes, 6, 8).
        weights: α of the leaves' points, 0 for what is repeated, shape (leaves, 32).
        gap2: [m²], shape (n,).
        length_scale: [m].
    """

    points: FloatArray
    begin: IntArray
    blocks: FloatArray
    boxes: FloatArray
    weights: FloatArray
    gap2: FloatArray
    length_scale: float


@njit(cache=True, nogil=True)
def by_leaf(tree: Tree, values: FloatArray) -> FloatArray:
    """Values of the points, shape (n,), leaf by leaf, 0 where there is no point; shape (leaves, 32)."""
    made = np.zeros((len(tree.begin) - 1, LEAF_SIZE))
    for leaf in range(len(made)):
        for i in range(tree.begin[leaf], tree.begin[leaf + 1]):
            made[leaf, i - tree.begin[leaf]] = values[i]
    return made


@njit(cache=True, nogil=True, fastmath=VECTORS)
def walk(field: FieldArrays, x: Place, scratch: Scratch) -> tuple[float, int, float, Place]:
    """δ, the row of the nearest point, S, and M at one place."""
    blocks, weights, boxes = field.blocks, field.weights, field.boxes
    stack, bound, near = scratch.stack, scratch.bound, scratch.near
    x0, x1, x2 = x
    rate = 1.0 / (2.0 * field.length_scale * field.length_scale)
    reach = (CUT_RADIUS * field.length_scale) ** 2
    delta, nearest, total, m0, m1, m2 = np.inf, 0, 0.0, 0.0, 0.0, 0.0
    top = from_root(stack, bound)
    while True:
        leaf, box2, top = next_leaf(boxes, x, x, delta + reach, stack, bound, near, top)
        if leaf < 0:
            break
        if box2 < delta:
            least = least_square(blocks, leaf, x0, x1, x2)
            if least < delta:
                shrink = exp((least - delta) * rate)
                total, m0, m1, m2 = total * shrink, m0 * shrink, m1 * shrink, m2 * shrink
                delta, nearest = least, leaf
        s, n0, n1, n2 = 0.0, 0.0, 0.0, 0.0
        for j in range(LEAF_SIZE):
            a, b, c = blocks[leaf, 0, j] - x0, blocks[leaf, 1, j] - x1, blocks[leaf, 2, j] - x2
            t = (a * a + b * b + c * c - delta) * rate
            weight = weights[leaf, j] * decay(lesser(t, _STEEPEST))
            weight = weight if t <= reach * rate else 0.0
            s += weight
            n0 += weight * a
            n1 += weight * b
            n2 += weight * c
        total, m0, m1, m2 = total + s, m0 + n0, m1 + n1, m2 + n2
    return delta, row_of_nearest(field.begin, blocks, nearest, x0, x1, x2), total, (m0, m1, m2)


@njit(cache=True, nogil=True, fastmath=VECTORS, inline="always")
def least_square(blocks: FloatArray, leaf: int, x0: float, x1: float, x2: float) -> float:
    """Squared distance to a leaf's nearest point [m²]."""
    least = np.inf
    for j in range(LEAF_SIZE):
        a, b, c = blocks[leaf, 0, j] - x0, blocks[leaf, 1, j] - x1, blocks[leaf, 2, j] - x2
        least = lesser(least, a * a + b * b + c * c)
    return least


@njit(cache=True, nogil=True)
def row_of_nearest(begin: IntArray, blocks: FloatArray, leaf: int, x0: float, x1: float, x2: float) -> int:
    """Row of a leaf's nearest point: looked for once, because vectors do not know where their least is."""
    least, found = np.inf, 0
    for j in range(LEAF_SIZE):
        a, b, c = blocks[leaf, 0, j] - x0, blocks[leaf, 1, j] - x1, blocks[leaf, 2, j] - x2
        square = a * a + b * b + c * c
        if square < least:
            least, found = square, j
    return begin[leaf] + found


_DECAY = tuple(
    float(c)
    for c in np.polynomial.Chebyshev.interpolate(lambda u: np.exp(-u), 6, domain=[0.0, _STEEPEST / 16.0])
    .convert(kind=np.polynomial.Polynomial)
    .coef
)


@njit(cache=True, nogil=True, fastmath=VECTORS, inline="always")
def decay(t: float) -> float:
    """exp(−t) for 0 ≤ t ≤ `_STEEPEST` within 4e-8 of itself: (a polynomial of t/16)^16, no call."""
    u = t * 0.0625
    e = _DECAY[6]
    for k in range(5, -1, -1):
        e = e * u + _DECAY[k]
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
    return sample(field, place_of(x), make_scratch(), gradient)[0]


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
        distance[i], row[i], bracket[i] = sample(field, place_of(queries[i]), scratch, gradient[i])


@njit(cache=True, nogil=True)
def nearest_one(tree: Tree, x: FloatArray) -> tuple[float, int]:
    """Exact nearest point: its distance [m] and its row in `tree.points`."""
    return _nearest(tree, place_of(x), make_scratch())


@njit(cache=True, nogil=True, fastmath=VECTORS)
def _nearest(tree: Tree, x: Place, scratch: Scratch) -> tuple[float, int]:
    boxes, blocks, stack, bound, near = tree.boxes, tree.blocks, scratch.stack, scratch.bound, scratch.near
    x0, x1, x2 = x
    delta, nearest = np.inf, 0
    top = from_root(stack, bound)
    while True:
        leaf, _, top = next_leaf(boxes, x, x, delta, stack, bound, near, top)
        if leaf < 0:
            break
        least = least_square(blocks, leaf, x0, x1, x2)
        if least < delta:
            delta, nearest = least, leaf
    return sqrt(delta), row_of_nearest(tree.begin, blocks, nearest, x0, x1, x2)


@njit(cache=True, nogil=True)
def nearest_range(
    tree: Tree, queries: FloatArray, first: int, last: int, distance: FloatArray, index: IntArray
) -> None:
    """`nearest_one` for the rows first..last of `queries`."""
    scratch = make_scratch()
    for q in range(first, last):
        distance[q], index[q] = _nearest(tree, place_of(queries[q]), scratch)

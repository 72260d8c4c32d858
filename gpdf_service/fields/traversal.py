"""Walks through the tree: to the nearest point, then over the kernel's sum and its gradient around it; along a segment.

With δ = the squared distance of the nearest point, the second walk sums
    S = Σ αᵢ exp(−(‖x − xᵢ‖² − δ) / 2l²)   and   M = Σ αᵢ exp(−(‖x − xᵢ‖² − δ) / 2l²) (xᵢ − x),
and leaves out every box beyond ‖x − xᵢ‖² > δ + (R l)². Then
    r(o)² = −2l² log o = δ − 2l² log S   and   ∇d = −(M/S) / d,
the reverting function of Uttsha et al. 2024 (after Le Gentil et al. 2023) in the log domain: no underflow at any range.
A leaf's points are worked on as vectors: the loops over them have no branch, no call and one length. That is why they
index arrays and take no views of them: a view is counted, which costs more than what is done with it. Nor is a tuple of
arrays counted here, as none is made or kept (`lean`): from call to call that took four fifths of an answer.
"""

from __future__ import annotations

from math import isfinite, log, sqrt
from typing import NamedTuple

import numpy as np
from numba import njit

from gpdf_service.fields.tree import (
    FANOUT,
    LEAF_SIZE,
    VECTORS,
    Place,
    Scratch,
    Tree,
    from_root,
    larger,
    lesser,
    make_scratch,
    next_leaf,
    write_apart,
)
from gpdf_service.kernel_cache import lean
from gpdf_service.types import FloatArray, IntArray

CUT_RADIUS = 4.5
"""R: terms beyond R length scales change the distance by at most 0.7 mm against R = 8 (measured in an office)."""
STEEPEST = CUT_RADIUS**2 / 2.0 + 1.0
"""Exponents beyond the cut are multiplied by zero; this keeps them in the polynomial's range."""


class FieldArrays(NamedTuple):
    """All that a compiled loop needs to ask a field: of the tree, and α and the disc around each point.

    Attributes:
        begin: First row of each leaf, and n, shape (leaves + 1,).
        blocks: The leaves' points [m], shape (leaves, 3, 32).
        boxes: The nodes' boxes [m], shape (nodes, 6, 8).
        weights: α of the leaves' points, 0 for what is repeated, shape (leaves, 32).
        discs: `spacing.local_shape`, shape (n, 6).
        length_scale: [m].
    """

    begin: IntArray
    blocks: FloatArray
    boxes: FloatArray
    weights: FloatArray
    discs: FloatArray
    length_scale: float


def nearest_only(tree: Tree) -> FieldArrays:
    """A field without a Gaussian process: the exact distance to the nearest point."""
    nothing, short = np.zeros((len(tree.begin) - 1, LEAF_SIZE)), np.finfo(float).tiny ** 0.25
    return FieldArrays(tree.begin, tree.blocks, tree.boxes, nothing, np.zeros((len(tree.points), 6)), short)


@njit(cache=True, nogil=True)
def by_leaf(tree: Tree, values: FloatArray) -> FloatArray:
    """Values of the points, shape (n,), leaf by leaf, 0 where there is no point; shape (leaves, 32)."""
    made = np.zeros((len(tree.begin) - 1, LEAF_SIZE))
    for leaf in range(len(made)):
        for i in range(tree.begin[leaf], tree.begin[leaf + 1]):
            made[leaf, i - tree.begin[leaf]] = values[i]
    return made


@lean(fastmath=VECTORS)
def nearest_leaf(tree: Tree | FieldArrays, x: Place, scratch: Scratch, known: int = -1) -> tuple[float, int, int]:
    """δ, the leaf of the nearest point, and which of its points that is; δ is inf where there is none.

    A point that is `known`, by its place among the blocks, spares the walk what is further away than that.
    """
    blocks, delta, nearest, which = tree.blocks, np.inf, 0, 0
    if 0 <= known < LEAF_SIZE * len(blocks):
        nearest, which = known // LEAF_SIZE, known % LEAF_SIZE
        a, b, c = blocks[nearest, 0, which] - x[0], blocks[nearest, 1, which] - x[1], blocks[nearest, 2, which] - x[2]
        square = a * a + b * b + c * c
        delta = square if square < np.inf else np.inf  # a NaN compares false
    top = from_root(scratch)
    while True:
        leaf, top = next_leaf(tree.boxes, x, x, delta, scratch, top)
        if leaf < 0:
            return delta, nearest, which
        least, j = nearest_in(blocks, leaf, x[0], x[1], x[2])
        if least < delta:
            delta, nearest, which = least, leaf, j


@lean(fastmath=VECTORS)
def sums_around(field: FieldArrays, x: Place, delta: float, scratch: Scratch) -> tuple[float, Place]:
    """S and M at one place whose δ is known."""
    _, blocks, boxes, weights, _, length_scale = field
    stack, near, (x0, x1, x2) = scratch.stack, scratch.near, x
    rate = 1.0 / (2.0 * length_scale * length_scale)
    reach = (CUT_RADIUS * length_scale) ** 2
    nodes, limit, top = boxes.shape[0], delta + reach, 1
    total, m0, m1, m2 = 0.0, 0.0, 0.0, 0.0
    stack[0] = 0
    while top > 0:
        top -= 1
        node = stack[top]
        if node < nodes:
            write_apart(boxes, node, x, x, near)
            for k in range(FANOUT):
                stack[top] = FANOUT * node + 1 + k
                top += near[k] <= limit  # where there is no child it is inf
            continue
        leaf = node - nodes
        s, n0, n1, n2 = 0.0, 0.0, 0.0, 0.0
        for j in range(LEAF_SIZE):
            a, b, c = blocks[leaf, 0, j] - x0, blocks[leaf, 1, j] - x1, blocks[leaf, 2, j] - x2
            t = (a * a + b * b + c * c - delta) * rate
            weight = weights[leaf, j] * decay(lesser(t, STEEPEST))
            weight = weight if t <= reach * rate else 0.0
            s += weight
            n0 += weight * a
            n1 += weight * b
            n2 += weight * c
        total, m0, m1, m2 = total + s, m0 + n0, m1 + n1, m2 + n2
    return total, (m0, m1, m2)


@lean(fastmath=VECTORS)
def nearest_in(blocks: FloatArray, leaf: int, x0: float, x1: float, x2: float) -> tuple[float, int]:
    """Squared distance to a leaf's nearest point [m²], and which it is.

    The bits of squares order as the squares do, so their last five make room for the number of the point, and the least
    whole number tells both: vectors can do that, and cannot remember where their least was.
    """
    least = np.int64(2**63 - 1)
    for j in range(LEAF_SIZE):
        a, b, c = blocks[leaf, 0, j] - x0, blocks[leaf, 1, j] - x1, blocks[leaf, 2, j] - x2
        square = np.float64(a * a + b * b + c * c)
        least = min(least, (square.view(np.int64) & -LEAF_SIZE) | j)
    found = int(least & (LEAF_SIZE - 1))
    a, b, c = blocks[leaf, 0, found] - x0, blocks[leaf, 1, found] - x1, blocks[leaf, 2, found] - x2
    return a * a + b * b + c * c, found


_E0, _E1, _E2, _E3, _E4, _E5, _E6 = (
    float(c)
    for c in np.polynomial.Chebyshev.interpolate(lambda u: np.exp(-u), 6, domain=[0.0, STEEPEST / 16.0])
    .convert(kind=np.polynomial.Polynomial)
    .coef
)


@njit(cache=True, nogil=True, fastmath=VECTORS, inline="always")
def decay(t: float) -> float:
    """exp(−t) for 0 ≤ t ≤ `STEEPEST` within 4e-8 of itself: (a polynomial of t/16)^16, no call."""
    u = t * 0.0625
    e = _E0 + u * (_E1 + u * (_E2 + u * (_E3 + u * (_E4 + u * (_E5 + u * _E6)))))
    e *= e
    e *= e
    e *= e
    return e * e


@lean()
def bracket(field: FieldArrays, x: Place, scratch: Scratch) -> tuple[float, int, float, float, Place]:
    """Of the distance at one place: δ, the nearest point's row, both ends squared [m²], and the way from its disc."""
    begin, blocks, _, _, discs, _ = field
    delta, leaf, j = nearest_leaf(field, x, scratch, scratch.last[0])
    if delta == np.inf:
        return delta, 0, 0.0, np.inf, x
    scratch.last[0] = LEAF_SIZE * leaf + j
    row = min(begin[leaf] + j, begin[leaf + 1] - 1)  # a copy of the last point stands for it
    gap = discs[row, 4]
    off = x[0] - blocks[leaf, 0, j], x[1] - blocks[leaf, 1, j], x[2] - blocks[leaf, 2, j]
    away = from_disc(discs, row, off)
    least2 = min(away[0] * away[0] + away[1] * away[1] + away[2] * away[2], delta)
    return delta, row, min(max(delta - gap * gap, 0.0), least2), least2, away


@lean()
def sample(field: FieldArrays, x: Place, scratch: Scratch, enough: float) -> tuple[float, int, float, Place]:
    """Distance at one place, the row of the nearest point, how much less the distance may be [m], and the gradient.

    The bracket: never more room than to the disc around the nearest point, which is never further than that point, √δ;
    never less than √(δ − gap²), the least that a surface through points no further apart than the gap allows. Where the
    sums say nothing (S ≤ 0, or more room than to the disc) the disc gives the direction: near the surface, or at an
    edge. Without a disc that one's true place may be a gap beyond the point. A place that is no place (NaN, or so far
    that squares overflow) has no room at all.

    Where the bracket alone tells that there is `enough` room [m], its lower end is the distance, and no gradient is
    told (NaN): that takes a third of the time.
    """
    discs, length_scale = field.discs, field.length_scale
    delta, row, floor2, least2, away = bracket(field, x, scratch)
    if delta == np.inf:
        return 0.0, 0, np.inf, (0.0, 0.0, 0.0)
    if floor2 >= enough * enough:
        return sqrt(floor2), row, sqrt(delta) - sqrt(floor2), (np.nan, np.nan, np.nan)
    total, (g0, g1, g2) = sums_around(field, x, delta, scratch)
    distance2 = delta - 2.0 * length_scale * length_scale * log(total) if total > 0.0 else delta
    inside = total > 0.0 and distance2 <= least2
    distance = sqrt(min(max(distance2, floor2), least2))
    if inside:
        g0, g1, g2 = -g0 / total, -g1 / total, -g2 / total
    else:
        g0, g1, g2 = away
    norm = max(distance, sqrt(g0 * g0 + g1 * g1 + g2 * g2))
    scale = 1.0 / norm if norm > 0.0 else 0.0
    told = inside or discs[row, 3] > 0.0
    slack = sqrt(delta) - sqrt(floor2) if told else min(distance, discs[row, 4])
    return distance, row, slack, (scale * g0, scale * g1, scale * g2)


@njit(cache=True, nogil=True, inline="always")
def from_disc(discs: FloatArray, row: int, off: Place) -> Place:
    """What is left of an offset from a point [m] when it starts at the nearest place of the disc around that point."""
    n0, n1, n2, radius = discs[row, 0], discs[row, 1], discs[row, 2], discs[row, 3]
    high = off[0] * n0 + off[1] * n1 + off[2] * n2
    s0, s1, s2 = off[0] - high * n0, off[1] - high * n1, off[2] - high * n2
    aside = sqrt(s0 * s0 + s1 * s1 + s2 * s2)
    rest = 1.0 - radius / aside if aside > radius else 0.0
    return high * n0 + rest * s0, high * n1 + rest * s1, high * n2 + rest * s2


NearerArrays = tuple[FieldArrays, ...]
"""Fields in one, what stands and what moves, or a single one: the nearer one answers. One may be without points."""


@lean()
def sample_at(fields: NearerArrays, x: Place, scratch: Scratch, gradient: FloatArray, enough: float = np.inf) -> float:
    """Distance at one place [m]; writes the gradient, shape (dim,). Of `enough` room less is told: see `sample`."""
    least, slope, asked = 0.0, (0.0, 0.0, 0.0), False
    for field in fields:
        if len(field.begin) >= 2:
            distance, _, _, own = sample(field, x, scratch, enough)
            if not asked or distance < least:
                least, slope, asked = distance, own, True
    for k in range(len(gradient)):
        gradient[k] = slope[k]
    return float(least)


@lean()
def bracket_at(fields: NearerArrays, x: Place, scratch: Scratch) -> tuple[float, float]:
    """Between what `sample_at` of a single field is at a place [m], in a third of its time; 0 and inf at no place."""
    _, _, floor2, least2, _ = bracket(fields[0], x, scratch)
    return sqrt(floor2), sqrt(least2)


@njit(cache=True, nogil=True)
def sample_range(
    field: FieldArrays,
    queries: FloatArray,
    rows: IntArray,
    noise: FloatArray,
    made: tuple[FloatArray, FloatArray, FloatArray],
) -> None:
    """`sample` for some rows of the `queries`: distance, gradient and deviation.

    The deviation is the nearest point's noise and half the bracket.
    """
    distance, gradient, deviation = made
    scratch, dim = make_scratch(), queries.shape[1]
    for i in rows:
        x = queries[i, 0], queries[i, 1], queries[i, 2] if dim == 3 else 0.0
        scratch.last[0] = -1  # no answer depends on those before it
        distance[i], row, slack, slope = sample(field, x, scratch, np.inf)
        deviation[i] = sqrt(noise[row] ** 2 + 0.25 * slack * slack)
        for k in range(dim):
            gradient[i, k] = slope[k]


@lean()
def nearest_along(tree: Tree, x: Place, scratch: Scratch) -> tuple[float, int]:
    """`nearest_at` of places along a way: from the last answer's point on. Of points as near any one may be told."""
    delta, leaf, j = nearest_leaf(tree, x, scratch, scratch.last[0])
    if delta == np.inf:
        return 0.0, 0
    scratch.last[0] = LEAF_SIZE * leaf + j
    return sqrt(delta), min(tree.begin[leaf] + j, tree.begin[leaf + 1] - 1)


@lean()
def nearest_at(tree: Tree, x: Place, scratch: Scratch) -> tuple[float, int]:
    """Exact nearest point: its distance [m], 0 from what is no place, and its row in `tree.points`."""
    delta, leaf, j = nearest_leaf(tree, x, scratch)
    return (sqrt(delta), min(tree.begin[leaf] + j, tree.begin[leaf + 1] - 1)) if delta < np.inf else (0.0, 0)


@njit(cache=True, nogil=True)
def nearest_range(tree: Tree, queries: FloatArray, distance: FloatArray, index: IntArray) -> None:
    """Write `nearest_at` of the queries, shape (m, dim)."""
    scratch = make_scratch()
    for q in range(len(queries)):
        x = queries[q, 0], queries[q, 1], queries[q, 2] if queries.shape[1] == 3 else 0.0
        distance[q], index[q] = nearest_at(tree, x, scratch)


@lean(fastmath=VECTORS)
def segment_distance2(
    tree: Tree, a: FloatArray, b: FloatArray, limit: float, enough: float, scratch: Scratch
) -> tuple[float, float]:
    """Squared distance from the segment ab, places (≥ 2,), to the nearest point in plan, and where on it that is.

    One walk, whatever its length: a box of points is left out where it is apart from the segment, by more than the
    limit, along x, along y or across the segment (separating axes, Gottschalk et al. 1996). Points from the squared
    `limit` on do not count [m²]; the walk ends with the first leaf that is nearer than `enough` [m²].

    Returns:
        The squared distance, `limit` where there is nothing below it [m²], 0 from what is no place; and how far along
        ab that is [-].
    """
    if not (isfinite(a[0]) and isfinite(a[1]) and isfinite(b[0]) and isfinite(b[1])):
        return 0.0, 0.0
    boxes, stack, near, a0, a1, b0, b1 = tree.boxes, scratch.stack, scratch.near, a[0], a[1], b[0], b[1]
    length = sqrt((b0 - a0) * (b0 - a0) + (b1 - a1) * (b1 - a1))
    u0, u1 = ((b0 - a0) / length, (b1 - a1) / length) if length > 0.0 else (1.0, 0.0)
    low0, low1, high0, high1 = min(a0, b0), min(a1, b1), max(a0, b0), max(a1, b1)
    nodes, least, share, far, top = boxes.shape[0], limit, 0.0, sqrt(limit), 1
    stack[0] = 0
    while top > 0 and least >= enough:
        top -= 1
        node = stack[top]
        if node >= nodes:
            found, along = _nearest_in(tree.blocks, node - nodes, (a0, a1), (u0, u1), length)
            if found < least:
                least, share, far = found, along / length if length > 0.0 else 0.0, sqrt(found)
            continue
        for k in range(FANOUT):
            apart0 = larger(boxes[node, 0, k] - high0, low0 - boxes[node, 3, k])
            apart1 = larger(boxes[node, 1, k] - high1, low1 - boxes[node, 4, k])
            near[k] = larger(apart0, apart1)
        for k in range(FANOUT):
            if near[k] <= far and near[k] < np.inf:  # where there is no child it is inf
                half0 = 0.5 * (boxes[node, 3, k] - boxes[node, 0, k])
                half1 = 0.5 * (boxes[node, 4, k] - boxes[node, 1, k])
                c0, c1 = boxes[node, 0, k] + half0 - a0, boxes[node, 1, k] + half1 - a1
                if abs(c0 * u1 - c1 * u0) <= far + half0 * abs(u1) + half1 * abs(u0):
                    stack[top] = FANOUT * node + 1 + k
                    top += 1
    return least, share


@lean(fastmath=VECTORS)
def _nearest_in(
    blocks: FloatArray, leaf: int, a: tuple[float, float], u: tuple[float, float], length: float
) -> tuple[float, float]:
    """Squared distance to a leaf's point that is nearest to the segment [m²], and how far along that is [m].

    The segment begins at `a` and goes along the unit vector `u`.
    """
    least, (a0, a1), (u0, u1) = np.int64(2**63 - 1), a, u
    for j in range(LEAF_SIZE):
        x, y = blocks[leaf, 0, j] - a0, blocks[leaf, 1, j] - a1
        along = lesser(larger(x * u0 + y * u1, 0.0), length)
        e0, e1 = x - along * u0, y - along * u1
        square = np.float64(e0 * e0 + e1 * e1)
        least = min(least, (square.view(np.int64) & -LEAF_SIZE) | j)  # as `nearest_in` finds the least
    found = int(least & (LEAF_SIZE - 1))
    x, y = blocks[leaf, 0, found] - a0, blocks[leaf, 1, found] - a1
    along = min(max(x * u0 + y * u1, 0.0), length)
    e0, e1 = x - along * u0, y - along * u1
    return e0 * e0 + e1 * e1, along

"""α = (K + σ² I)⁻¹ 1, by conjugate gradients on pieces of the tree.

K⁻¹ forgets what is far, so a piece with a halo around it is enough: pieces are independent, and none is larger than
`PIECE`, so the time grows with the points and the memory does not. A change of the points is solved by the same
routine, for the rows that it touches; what is known beyond them takes the place of the halo. A piece's rows are shared
out in parts, which all cores work on: what is in a part is stored once, what is between two parts by each of them.
"""

from __future__ import annotations

from itertools import pairwise
from math import exp, sqrt
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gpdf_service.errors import FieldError
from gpdf_service.fields.order import is_before
from gpdf_service.fields.threads import run_parallel
from gpdf_service.fields.traversal import CUT_RADIUS, decay
from gpdf_service.fields.tree import LEAF_SIZE, Tree, from_root, lesser, longer, make_scratch, next_leaf, place_of
from gpdf_service.types import BoolArray, Float32Array, FloatArray, IntArray

HALO = 9.0
"""[-] Width of the halo in length scales: two cuts of the kernel; α is then within 1e-3 of that of one piece."""
PIECE = 100_000
"""Points solved at once: the halo adds a tenth to them, and half of their matrix takes 50 MB."""
PART = 6000
"""Rows of a part, at most: a room has four; a step over one takes as long as ten wake-ups, and few pairs leave it."""
NEAR = 4
"""Points that each is told from in the approximate inverse: then 16 steps are enough. With 6 there are 12, with 8 there
are 10, but these take as long, and so does finding the points."""
TOLERANCE = 1e-5
"""Relative residual of the solve. With 1e-4 the distance is off by under 0.01 mm, but by 1.2 mm right at the surface,
where it is the root of a difference (at two in 10⁵ places within 2 cm of a floor); with 1e-5 by 0.25 mm."""


def solve_all(tree: Tree, length_scale: float, noise_variance: float) -> FloatArray:
    """α of every row of `tree.points`, shape (n,)."""
    unknown = np.full(len(tree.points), np.nan)
    made = np.empty_like(unknown)
    for rows in np.array_split(np.arange(len(made)), -(-len(made) // PIECE)):
        together = rows if len(rows) == len(made) else within(tree, rows, HALO * length_scale)
        solved = solve_rows(tree, together, unknown, length_scale, noise_variance)
        made[rows] = solved[np.searchsorted(together, rows)]
    return made


class Part(NamedTuple):
    """Some rows of K + σ² I.

    Attributes:
        begin: The first of them.
        start: Where what stands in each row begins, shape (k + 1,).
        middle: Where what stands in the columns of other parts begins, shape (k,).
        column: Above the diagonal, counted from `begin`; the columns of other parts, counted from 0, come after these.
        weight: What stands there.
        near: Columns of a triangular G such that GᵀG is about the inverse of K + σ² I: of each row the nearest points
            that are further in x, then y, z, or itself where there are fewer, shape (k, `NEAR`).
        inverse: What stands there, and after it what stands on G's diagonal, shape (k, `NEAR` + 1).
    """

    begin: int
    start: IntArray
    middle: IntArray
    column: NDArray[np.uint32]
    weight: Float32Array
    near: IntArray
    inverse: Float32Array


_System = tuple[Tree, IntArray, NDArray[np.int32], FloatArray, float, float, FloatArray, FloatArray]
"""What `solve_rows` is given, behind its rows the number of each point among them, −1 of others, shape (n,); then the
right-hand side and a guess, shapes (k,)."""


def solve_rows(tree: Tree, rows: IntArray, alpha: FloatArray, length_scale: float, noise_variance: float) -> FloatArray:
    """α of `rows`, shape (k,), sorted, where the others keep their `alpha`, shape (n,); NaN where none is known.

    Raises:
        FieldError: the solve did not converge.
    """
    place: NDArray[np.int32] = np.full(len(tree.points), -1, np.int32)
    place[rows] = np.arange(len(rows))
    right, guess = np.ones(len(rows)), np.empty(len(rows))
    system = tree, rows, place, alpha, length_scale, noise_variance, right, guess
    leaves = -(-len(rows) // LEAF_SIZE)
    bounds = np.minimum(np.linspace(0, leaves, -(-len(rows) // PART) + 1).astype(np.int64) * LEAF_SIZE, len(rows))
    parts = run_parallel(lambda ends: _assemble(system, *ends), list(pairwise(bounds)))
    return _conjugate_gradients(parts, noise_variance, right, guess)


def within(tree: Tree, rows: IntArray, radius: float) -> IntArray:
    """Rows of all points within `radius` [m] of any of `rows`, sorted; shape (k,)."""
    found = np.zeros(len(tree.points), np.bool_)
    _mark(tree, rows, radius, found)
    return np.flatnonzero(found)


@njit(cache=True, nogil=True)
def _mark(tree: Tree, rows: IntArray, radius: float, found: BoolArray) -> None:
    """Coarse on purpose: a box around each leaf's share of `rows`, so that the cost is one walk a leaf."""
    scratch = make_scratch()
    for first in range(0, len(rows), LEAF_SIZE):
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for i in rows[first : first + LEAF_SIZE]:
            x = place_of(tree.points[i])
            for k in range(3):
                low[k], high[k] = min(low[k], x[k]), max(high[k], x[k])
        least, largest = place_of(low), place_of(high)
        top = from_root(scratch)
        while True:
            leaf, top = next_leaf(tree.boxes, least, largest, radius * radius, scratch, top)
            if leaf < 0:
                break
            found[tree.begin[leaf] : tree.begin[leaf + 1]] = True


@njit(cache=True, nogil=True)
def _assemble(system: _System, begin: int, end: int) -> Part:
    """The rows from `begin` to `end`; takes off the right-hand side what the points outside add, and writes a guess.

    The guess is α on even ground, one over the sum of the row of K + σ² I; so is an α outside that is not known. A
    leaf whose points are all in this part needs no look from a later leaf: K is symmetric.
    """
    tree, rows, place, alpha, length_scale, noise_variance, right, guess = system
    blocks, scratch = tree.blocks, make_scratch()
    rate, reach = 1.0 / (2.0 * length_scale * length_scale), (CUT_RADIUS * length_scale) ** 2
    size = end - begin
    start, middle, capacity = np.zeros(size + 1, np.int64), np.zeros(size, np.int64), 64 * size + 1024
    column, weight = np.empty(capacity, np.uint32), np.empty(capacity, np.float32)
    total, unknown = np.full(size, noise_variance + 1.0), np.zeros(size)
    values, inner = np.empty(LEAF_SIZE, np.float32), _inner_leaves(tree.begin, place, begin, end)
    used, own = 0, 0
    for r in range(size):
        row, mine, apart = rows[begin + r], total[r], False
        x = x0, x1, x2 = place_of(tree.points[row])
        while tree.begin[own + 1] <= row:
            own += 1
        top = from_root(scratch)
        while True:
            leaf, top = next_leaf(tree.boxes, x, x, reach, scratch, top)
            if leaf < 0:
                break
            if leaf < own and inner[leaf]:
                continue
            for j in range(LEAF_SIZE):
                a, b, c = blocks[leaf, 0, j] - x0, blocks[leaf, 1, j] - x1, blocks[leaf, 2, j] - x2
                t = (a * a + b * b + c * c) * rate
                values[j] = decay(lesser(t, reach * rate)) if t <= reach * rate else 0.0
            if used + LEAF_SIZE > capacity:
                capacity *= 2
                column, weight = longer(column, capacity), longer(weight, capacity)
            first, count = tree.begin[leaf], tree.begin[leaf + 1] - tree.begin[leaf]
            if inner[leaf]:
                for j in range(row + 1 - first if leaf == own else 0, count):
                    other = place[first] - begin + j  # written, and kept or not: a guess would be wrong too often
                    column[used], weight[used] = other, values[j]
                    mine += values[j]
                    total[other] += values[j]
                    used += int(values[j] > 0.0)
                continue
            for j in range(count):
                i, value = first + j, values[j]
                other = place[i] - begin
                if 0 <= other <= r or value == 0.0:
                    continue
                mine += value
                if 0 <= other < size:
                    column[used], weight[used] = other, value
                    total[other] += value
                    used += 1
                elif place[i] >= 0:
                    column[used], weight[used] = size + place[i], value
                    used, apart = used + 1, True
                elif np.isnan(alpha[i]):
                    unknown[r] += value
                else:
                    right[begin + r] -= value * alpha[i]
        total[r], start[r + 1] = mine, used
        middle[r] = _own_first(column, weight, start[r], used, size) if apart else used
    for r in range(size):
        guess[begin + r] = 1.0 / total[r]
        right[begin + r] -= unknown[r] * guess[begin + r]
    further = _nearest_further(tree.points, rows, (start, middle, column, weight), begin)
    inverse = _approximate_inverse(tree.points, rows, further, begin, rate, noise_variance)
    return Part(begin, start, middle, column[:used], weight[:used], further, inverse)


@njit(cache=True, nogil=True)
def _own_first(column: NDArray[np.uint32], weight: Float32Array, first: int, last: int, size: int) -> int:
    """Put the columns of a row that are less than `size` before the others; where these begin."""
    middle = first
    for e in range(first, last):
        if column[e] < size:
            column[middle], column[e] = column[e], column[middle]
            weight[middle], weight[e] = weight[e], weight[middle]
            middle += 1
    return middle


@njit(cache=True, nogil=True)
def _inner_leaves(first: IntArray, place: NDArray[np.int32], begin: int, end: int) -> BoolArray:
    """Leaves whose points all have a place from `begin` to `end`, which then are one after another."""
    inner = np.zeros(len(first) - 1, np.bool_)
    for leaf in range(len(inner)):
        a, b = first[leaf], first[leaf + 1] - 1
        inner[leaf] = b >= a and place[a] >= begin and place[b] - place[a] == b - a and place[b] < end
    return inner


def _conjugate_gradients(parts: list[Part], noise_variance: float, right: FloatArray, guess: FloatArray) -> FloatArray:
    """Solve (K + σ² I) x = b from a guess until ‖r‖ ≤ `TOLERANCE` ‖1‖.

    With GᵀG, an approximate inverse, 16 steps are enough where blocks of 32 rows, each solved by itself, took 45.
    """
    x, p, z, Kp = guess, np.zeros_like(guess), np.empty_like(guess), np.empty_like(guess)

    def apply(to: FloatArray) -> float:
        return sum(run_parallel(lambda part: _apply(part, noise_variance, to, Kp), parts))

    near, inverse = (np.concatenate(each) for each in zip(*((part.near, part.inverse) for part in parts), strict=True))
    apply(x)
    r, step, rz, enough = right - Kp, 0.0, np.inf, TOLERANCE * TOLERANCE * len(x)
    for _ in range(20 * int(np.sqrt(len(x))) + 200):
        rr = sum(run_parallel(lambda part: _descend(part, step, p, Kp, x, r), parts))  # noqa: B023
        if rr <= enough:
            return x
        fresh = _precondition(near, inverse, r, z)
        p *= fresh / rz
        p += z
        rz, step = fresh, fresh / apply(p)
    raise FieldError("fit", "the solve did not converge", "Raise fields.noise_variance.")


@njit(cache=True, nogil=True)
def _descend(part: Part, step: float, p: FloatArray, Kp: FloatArray, x: FloatArray, r: FloatArray) -> float:
    """A step along p in the rows of a part; r · r."""
    own, rr = slice(part.begin, part.begin + len(part.middle)), 0.0
    p, Kp, x, r = p[own], Kp[own], x[own], r[own]
    for i in range(len(r)):
        x[i] += step * p[i]
        r[i] -= step * Kp[i]
        rr += r[i] * r[i]
    return rr


@njit(cache=True, nogil=True)
def _nearest_further(
    points: FloatArray,
    rows: IntArray,
    held: tuple[IntArray, IntArray, NDArray[np.uint32], Float32Array],
    begin: int,
) -> IntArray:
    """What is `near` in a `Part`. Places have an order of their own: they may come in any other.

    A pair stands in the row of one of the two: `held` are the first numbers of the part, from its start on.
    """
    start, middle, column, weight = held
    count = len(middle)
    near, most = np.empty((count, NEAR), np.int64), np.zeros((count, NEAR), np.float32)
    for r in range(count):
        near[r] = begin + r
    for r in range(count):
        for e in range(start[r], start[r + 1]):
            other = begin + int(column[e]) if e < middle[r] else int(column[e]) - count
            first = is_before(points, rows[begin + r], rows[other])
            own, far = (r, other) if first else (other - begin, begin + r)
            if not (0 <= own < count) or weight[e] <= most[own, NEAR - 1]:
                continue
            at = NEAR - 1
            while at > 0 and most[own, at - 1] < weight[e]:
                most[own, at], near[own, at] = most[own, at - 1], near[own, at - 1]
                at -= 1
            most[own, at], near[own, at] = weight[e], far
    return near


@njit(cache=True, nogil=True)
def _approximate_inverse(
    points: FloatArray, rows: IntArray, near: IntArray, begin: int, rate: float, noise_variance: float
) -> Float32Array:
    """G's rows from `begin` on, see `Part`: each solves K + σ² I of its point and those near.

    Kolotilina and Yeremin 1993; in the terms of the GP each point is told from its nearest ones alone, Vecchia 1988.
    """
    count, dim = len(near), points.shape[1]
    made, own = np.zeros((count, NEAR + 1), np.float32), np.zeros((NEAR + 1, 3))
    low, g = np.empty((NEAR + 1, NEAR + 1)), np.empty(NEAR + 1)
    for r in range(count):
        m = 0
        while m < NEAR and near[r, m] != begin + r:
            m += 1
        for a in range(m + 1):
            row = rows[near[r, a] if a < m else begin + r]
            for k in range(dim):
                own[a, k] = points[row, k]
        for c in range(m + 1):  # Cholesky
            for a in range(c, m + 1):
                square = 0.0
                for k in range(dim):
                    square += (own[a, k] - own[c, k]) ** 2
                value = exp(-square * rate) + (noise_variance if a == c else 0.0)
                for q in range(c):
                    value -= low[a, q] * low[c, q]
                low[a, c] = sqrt(max(value, noise_variance)) if a == c else value / low[c, c]
        g[m] = 1.0 / low[m, m]  # L⊤ g is the last unit vector
        for a in range(m - 1, -1, -1):
            value = 0.0
            for q in range(a + 1, m + 1):
                value -= low[q, a] * g[q]
            g[a] = value / low[a, a]
        made[r, :m], made[r, NEAR] = g[:m], g[m]
    return made


@njit(cache=True, nogil=True)
def _precondition(near: IntArray, inverse: Float32Array, r: FloatArray, z: FloatArray) -> float:
    """Write z = GᵀG r; gives z · r. On one core, as two would write to the same rows; it is a fifth of a step."""
    product = 0.0
    z[:] = 0.0
    for i in range(len(r)):
        own = inverse[i, NEAR] * r[i]
        for k in range(NEAR):
            own += inverse[i, k] * r[near[i, k]]
        product += own * own
        z[i] += inverse[i, NEAR] * own
        for k in range(NEAR):
            z[near[i, k]] += inverse[i, k] * own
    return product


@njit(cache=True, nogil=True)
def _apply(part: Part, noise_variance: float, p: FloatArray, Kp: FloatArray) -> float:
    """Write the rows of a part of (K + σ² I) p; gives p · that, summed over them.

    A loop: NumPy's dot product wakes threads that then spin for nothing.
    """
    start, middle, column, weight = part.start, part.middle, part.column, part.weight
    count, product = len(middle), 0.0
    own, mine = p[part.begin : part.begin + count], Kp[part.begin : part.begin + count]
    for i in range(count):
        mine[i] = (1.0 + noise_variance) * own[i]
    for i in range(count):
        total = 0.0
        for e in range(start[i], middle[i]):
            j = column[e]
            total += weight[e] * own[j]
            mine[j] += weight[e] * own[i]
        for e in range(middle[i], start[i + 1]):
            total += weight[e] * p[column[e] - count]
        mine[i] += total
    for i in range(count):
        product += mine[i] * own[i]
    return product

"""α = (K + σ² I)⁻¹ 1, by conjugate gradients on pieces of the tree.

K⁻¹ forgets what is far, so a piece with a halo around it is enough: pieces are independent, solved in parallel, and
none is larger than `PIECE`, so the time grows with the points and the memory does not. A change of the points is solved
by the same routine, for the rows that it touches; what is known beyond them takes the place of the halo.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gpdf_service.errors import FieldError
from gpdf_service.fields.threads import run_parallel
from gpdf_service.fields.traversal import CUT_RADIUS, decay
from gpdf_service.fields.tree import LEAF_SIZE, VECTORS, Tree, from_root, lesser, make_scratch, next_leaf, place_of
from gpdf_service.types import BoolArray, FloatArray, IntArray

HALO = 9.0
"""[-] Width of the halo in length scales: two cuts of the kernel; α is then within 1e-3 of that of one piece."""
PIECE = 100_000
"""Points solved at once: the halo adds a tenth to them, and half of their matrix takes 50 MB."""
_TOLERANCE = 1e-5
"""Relative residual of the solve. With 1e-4 the distance is off by under 0.01 mm, but by 1.2 mm right at the surface,
where it is the root of a difference (at two in 10⁵ places within 2 cm of a floor); with 1e-5 by 0.25 mm."""


def solve_all(tree: Tree, length_scale: float, noise_variance: float) -> FloatArray:
    """α of every row of `tree.points`, shape (n,)."""
    unknown = np.full(len(tree.points), np.nan)
    made = np.empty_like(unknown)

    def one(rows: IntArray) -> None:
        together = rows if len(rows) == len(made) else within(tree, rows, HALO * length_scale)
        solved = solve_rows(tree, together, unknown, length_scale, noise_variance)
        made[rows] = solved[np.searchsorted(together, rows)]

    run_parallel(one, np.array_split(np.arange(len(made)), -(-len(made) // PIECE)))
    return made


def solve_rows(tree: Tree, rows: IntArray, alpha: FloatArray, length_scale: float, noise_variance: float) -> FloatArray:
    """α of `rows`, shape (k,), where the others keep theirs.

    Args:
        tree: All points.
        rows: Which of them, sorted.
        alpha: What is known of the others, shape (n,); NaN where nothing is.
        length_scale: [m].
        noise_variance: σ² [-].

    Raises:
        FieldError: the solve did not converge.
    """
    place: NDArray[np.int32] = np.full(len(tree.points), -1, np.int32)
    place[rows] = np.arange(len(rows))
    start, column, weight, right, guess = _assemble(tree, rows, place, alpha, length_scale, noise_variance)
    solved, converged = _conjugate_gradients(start, column, weight, noise_variance, right, guess)
    if not converged:
        raise FieldError("fit", "the solve did not converge", "Raise fields.noise_variance.")
    return solved


def within(tree: Tree, rows: IntArray, radius: float) -> IntArray:
    """Rows of all points within `radius` [m] of any of `rows`, sorted; shape (k,)."""
    found = np.zeros(len(tree.points), np.bool_)
    _mark(tree, rows, radius, found)
    return np.flatnonzero(found)


@njit(cache=True, nogil=True)
def _mark(tree: Tree, rows: IntArray, radius: float, found: BoolArray) -> None:
    """Coarse on purpose: a box around each leaf's share of `rows`, so that the cost is one walk a leaf."""
    boxes, limit = tree.boxes, radius * radius
    stack, bound, near = make_scratch()
    for first in range(0, len(rows), LEAF_SIZE):
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for i in rows[first : first + LEAF_SIZE]:
            x = place_of(tree.points[i])
            for k in range(3):
                low[k], high[k] = min(low[k], x[k]), max(high[k], x[k])
        least, largest = place_of(low), place_of(high)
        top = from_root(stack, bound)
        while True:
            leaf, _, top = next_leaf(boxes, least, largest, limit, stack, bound, near, top)
            if leaf < 0:
                break
            found[tree.begin[leaf] : tree.begin[leaf + 1]] = True


@njit(cache=True, nogil=True)
def _assemble(
    tree: Tree, rows: IntArray, place: NDArray[np.int32], alpha: FloatArray, length_scale: float, noise_variance: float
) -> tuple[IntArray, NDArray[np.uint32], NDArray[np.float32], FloatArray, FloatArray]:
    """K above its diagonal as compressed rows, the right-hand side less what the points outside add, and a guess.

    The guess is α on even ground, one over the sum of the row of K + σ² I; so is an α outside that is not known. A
    leaf whose points are all among `rows` needs no look from a later leaf: K is symmetric.
    """
    blocks, boxes = tree.blocks, tree.boxes
    rate, reach = 1.0 / (2.0 * length_scale * length_scale), (CUT_RADIUS * length_scale) ** 2
    start = np.zeros(len(rows) + 1, np.int64)
    capacity = 64 * len(rows) + 1024
    column, weight = np.empty(capacity, np.uint32), np.empty(capacity, np.float32)
    right, total, unknown = np.ones(len(rows)), np.full(len(rows), noise_variance + 1.0), np.zeros(len(rows))
    stack, bound, near = make_scratch()
    values, inner = np.empty(LEAF_SIZE, np.float32), _inner_leaves(tree.begin, place)
    used, own = 0, 0
    for r in range(len(rows)):
        x = x0, x1, x2 = place_of(tree.points[rows[r]])
        while tree.begin[own + 1] <= rows[r]:
            own += 1
        top = from_root(stack, bound)
        while True:
            leaf, _, top = next_leaf(boxes, x, x, reach, stack, bound, near, top)
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
                column, weight = _grown(column, capacity), _grown(weight, capacity)
            first, count = tree.begin[leaf], tree.begin[leaf + 1] - tree.begin[leaf]
            if inner[leaf]:
                for j in range(rows[r] + 1 - first if leaf == own else 0, count):
                    other = place[first] + j  # written, and kept or not: a guess would be wrong every third time
                    column[used], weight[used] = other, values[j]
                    total[r] += values[j]
                    total[other] += values[j]
                    used += int(values[j] > 0.0)
                continue
            for j in range(count):
                i, value = first + j, values[j]
                if place[i] > r and value > 0.0:
                    column[used], weight[used] = place[i], value
                    total[r] += value
                    total[place[i]] += value
                    used += 1
                elif place[i] < 0:
                    total[r] += value
                    if np.isnan(alpha[i]):
                        unknown[r] += value
                    else:
                        right[r] -= value * alpha[i]
        start[r + 1] = used
    guess = 1.0 / total
    return start, column[:used], weight[:used], right - unknown * guess, guess


@njit(cache=True, nogil=True)
def _inner_leaves(begin: IntArray, place: NDArray[np.int32]) -> BoolArray:
    """Leaves whose points all have a place, which then are one after another."""
    inner = np.zeros(len(begin) - 1, np.bool_)
    for leaf in range(len(inner)):
        a, b = begin[leaf], begin[leaf + 1] - 1
        inner[leaf] = b >= a and place[a] >= 0 and place[b] - place[a] == b - a
    return inner


@njit(cache=True, nogil=True)
def _grown(values: NDArray[Any], capacity: int) -> NDArray[Any]:
    more = np.empty(capacity, values.dtype)
    more[: len(values)] = values
    return more


@njit(cache=True, nogil=True)
def _conjugate_gradients(
    start: IntArray,
    column: NDArray[np.uint32],
    weight: NDArray[np.float32],
    noise_variance: float,
    right: FloatArray,
    x: FloatArray,
) -> tuple[FloatArray, bool]:
    """Solve (K + σ² I) x = b from the guess `x` until ‖r‖ ≤ `_TOLERANCE` ‖1‖.

    Each leaf is solved by itself in every step (block Jacobi): half as many steps are needed.
    """
    r, Kp, z = right.copy(), np.empty(len(right)), np.empty(len(right))
    blocks = _invert_blocks(start, column, weight, noise_variance)
    _apply(start, column, weight, noise_variance, x, Kp)
    rr = 0.0
    for i in range(len(r)):
        r[i] -= Kp[i]
        rr += r[i] * r[i]
    p = np.zeros(len(right))
    enough, rz = _TOLERANCE * _TOLERANCE * len(r), 1.0
    for _ in range(20 * int(np.sqrt(len(r))) + 200):
        if rr <= enough:
            return x, True
        fresh = _solve_blocks(blocks, r, z)
        for i in range(len(r)):
            p[i] = z[i] + (fresh / rz) * p[i]
        rz = fresh
        step = rz / _apply(start, column, weight, noise_variance, p, Kp)
        rr = 0.0
        for i in range(len(r)):
            x[i] += step * p[i]
            r[i] -= step * Kp[i]
            rr += r[i] * r[i]
    return x, rr <= enough


@njit(cache=True, nogil=True)
def _invert_blocks(
    start: IntArray, column: NDArray[np.uint32], weight: NDArray[np.float32], noise_variance: float
) -> NDArray[np.float32]:
    """A⁻¹ = L⁻ᵀ L⁻¹ of the blocks A of `LEAF_SIZE` rows on the diagonal of K + σ² I; beyond the last row it is I."""
    count = len(start) - 1
    made = np.zeros((-(-count // LEAF_SIZE), LEAF_SIZE, LEAF_SIZE), np.float32)
    upper, inverse = np.empty((LEAF_SIZE, LEAF_SIZE)), np.empty((LEAF_SIZE, LEAF_SIZE))
    for b in range(len(made)):
        first, last = b * LEAF_SIZE, min((b + 1) * LEAF_SIZE, count)
        upper[:], inverse[:] = 0.0, 0.0
        for i in range(LEAF_SIZE):
            upper[i, i], inverse[i, i] = 1.0 + noise_variance if first + i < last else 1.0, 1.0
        for r in range(first, last):
            for e in range(start[r], start[r + 1]):
                if column[e] < last:
                    upper[r - first, column[e] - first] = weight[e]
        for k in range(LEAF_SIZE):
            upper[k] /= np.sqrt(max(upper[k, k], noise_variance))
            for j in range(k + 1, LEAF_SIZE):
                for i in range(j, LEAF_SIZE):
                    upper[j, i] -= upper[k, j] * upper[k, i]
        for k in range(LEAF_SIZE):
            for m in range(k):
                for i in range(m + 1):
                    inverse[k, i] -= upper[m, k] * inverse[m, i]
            inverse[k] /= upper[k, k]
        upper[:] = 0.0
        for k in range(LEAF_SIZE):
            for i in range(k + 1):
                for j in range(k + 1):
                    upper[i, j] += inverse[k, i] * inverse[k, j]
        made[b] = upper
    return made


@njit(cache=True, nogil=True, fastmath=VECTORS)
def _solve_blocks(blocks: NDArray[np.float32], r: FloatArray, z: FloatArray) -> float:
    """Write z = A⁻¹ r, block by block; gives z · r."""
    product, solved = 0.0, np.empty(LEAF_SIZE, np.float32)
    for b in range(len(blocks)):
        first = b * LEAF_SIZE
        solved[:] = 0.0
        for k in range(min(LEAF_SIZE, len(r) - first)):
            own = np.float32(r[first + k])
            for i in range(LEAF_SIZE):
                solved[i] += own * blocks[b, k, i]
        for i in range(min(LEAF_SIZE, len(r) - first)):
            z[first + i] = solved[i]
            product += z[first + i] * r[first + i]
    return product


@njit(cache=True, nogil=True)
def _apply(
    start: IntArray,
    column: NDArray[np.uint32],
    weight: NDArray[np.float32],
    noise_variance: float,
    p: FloatArray,
    Kp: FloatArray,
) -> float:
    """Write (K + σ² I) p; gives p · that. A loop: NumPy's dot product wakes threads that then spin for nothing."""
    product = 0.0
    for i in range(len(p)):
        Kp[i] = (1.0 + noise_variance) * p[i]
    for i in range(len(p)):
        total = 0.0
        for e in range(start[i], start[i + 1]):
            j = column[e]
            total += weight[e] * p[j]
            Kp[j] += weight[e] * p[i]
        Kp[i] += total
    for i in range(len(p)):
        product += Kp[i] * p[i]
    return product

"""α = (K + σ² I)⁻¹ 1, by conjugate gradients on pieces of the tree.

K⁻¹ forgets what is far, so a piece with a halo around it is enough: pieces are independent, and none is larger than
`PIECE`, so the time grows with the points and the memory does not. A change of the points is solved by the same
routine, for the rows that it touches; what is known beyond them takes the place of the halo. A piece's rows are shared
out in parts, which all cores work on: what is in a part is stored once, what is between two parts by each of them.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any, NamedTuple

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
PART = 6000
"""Rows of a part, at most: a room has four; a step over one takes as long as ten wake-ups, and few pairs leave it."""
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
        blocks: Inverses of its `LEAF_SIZE` rows on the diagonal, one after another.
    """

    begin: int
    start: IntArray
    middle: IntArray
    column: NDArray[np.uint32]
    weight: NDArray[np.float32]
    blocks: NDArray[np.float32]


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
    right, guess = np.ones(len(rows)), np.empty(len(rows))
    own = tree, rows, place, alpha, length_scale, noise_variance, right, guess
    leaves = -(-len(rows) // LEAF_SIZE)
    bounds = np.minimum(np.linspace(0, leaves, -(-len(rows) // PART) + 1).astype(np.int64) * LEAF_SIZE, len(rows))
    parts = run_parallel(lambda ends: _assemble(*own, *ends), list(pairwise(bounds)))
    return _conjugate_gradients(parts, noise_variance, right, guess)


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
    tree: Tree,
    rows: IntArray,
    place: NDArray[np.int32],
    alpha: FloatArray,
    length_scale: float,
    noise_variance: float,
    right: FloatArray,
    guess: FloatArray,
    begin: int,
    end: int,
) -> Part:
    """The rows from `begin` to `end`; takes off the right-hand side what the points outside add, and writes a guess.

    The guess is α on even ground, one over the sum of the row of K + σ² I; so is an α outside that is not known. A
    leaf whose points are all in this part needs no look from a later leaf: K is symmetric.
    """
    blocks, boxes = tree.blocks, tree.boxes
    rate, reach = 1.0 / (2.0 * length_scale * length_scale), (CUT_RADIUS * length_scale) ** 2
    size = end - begin
    start, middle, capacity = np.zeros(size + 1, np.int64), np.zeros(size, np.int64), 64 * size + 1024
    column, weight = np.empty(capacity, np.uint32), np.empty(capacity, np.float32)
    total, unknown = np.full(size, noise_variance + 1.0), np.zeros(size)
    stack, bound, near = make_scratch()
    values, inner = np.empty(LEAF_SIZE, np.float32), _inner_leaves(tree.begin, place, begin, end)
    used, own = 0, 0
    for r in range(size):
        row, mine, apart = rows[begin + r], total[r], False
        x = x0, x1, x2 = place_of(tree.points[row])
        while tree.begin[own + 1] <= row:
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
    column, weight = column[:used], weight[:used]
    return Part(begin, start, middle, column, weight, _invert_blocks(start, middle, column, weight, noise_variance))


@njit(cache=True, nogil=True)
def _own_first(column: NDArray[np.uint32], weight: NDArray[np.float32], first: int, last: int, size: int) -> int:
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


@njit(cache=True, nogil=True)
def _grown(values: NDArray[Any], capacity: int) -> NDArray[Any]:
    more = np.empty(capacity, values.dtype)
    more[: len(values)] = values
    return more


def _conjugate_gradients(parts: list[Part], noise_variance: float, right: FloatArray, guess: FloatArray) -> FloatArray:
    """Solve (K + σ² I) x = b from a guess until ‖r‖ ≤ `TOLERANCE` ‖1‖.

    Each leaf is solved by itself in every step (block Jacobi): half as many steps are needed.
    """
    x, p, z, Kp = guess, np.zeros_like(guess), np.empty_like(guess), np.empty_like(guess)

    def apply(to: FloatArray) -> float:
        return sum(run_parallel(lambda part: _apply(part, noise_variance, to, Kp), parts))

    apply(x)
    r, step, rz, enough = right - Kp, 0.0, np.inf, TOLERANCE * TOLERANCE * len(x)
    for _ in range(20 * int(np.sqrt(len(x))) + 200):
        sums = run_parallel(lambda part: _descend(part, step, p, Kp, x, r, z), parts)  # noqa: B023
        rr, fresh = (sum(each) for each in zip(*sums, strict=True))
        if rr <= enough:
            return x
        p *= fresh / rz
        p += z
        rz, step = fresh, fresh / apply(p)
    raise FieldError("fit", "the solve did not converge", "Raise fields.noise_variance.")


@njit(cache=True, nogil=True)
def _descend(
    part: Part, step: float, p: FloatArray, Kp: FloatArray, x: FloatArray, r: FloatArray, z: FloatArray
) -> tuple[float, float]:
    """A step along p in the rows of a part, and what each leaf by itself would do next, z = A⁻¹ r; r · r and z · r."""
    own, rr = slice(part.begin, part.begin + len(part.middle)), 0.0
    p, Kp, x, r, z = p[own], Kp[own], x[own], r[own], z[own]
    for i in range(len(r)):
        x[i] += step * p[i]
        r[i] -= step * Kp[i]
        rr += r[i] * r[i]
    return rr, _solve_blocks(part.blocks, r, z)


@njit(cache=True, nogil=True)
def _invert_blocks(
    start: IntArray,
    middle: IntArray,
    column: NDArray[np.uint32],
    weight: NDArray[np.float32],
    noise_variance: float,
) -> NDArray[np.float32]:
    """The blocks of `LEAF_SIZE` rows on the diagonal of K + σ² I, inverted by Gauss and Jordan's elimination.

    Beyond the last row a block is I. Such a matrix needs no search for pivots.
    """
    count = len(start) - 1
    made = np.empty((-(-count // LEAF_SIZE), LEAF_SIZE, LEAF_SIZE), np.float32)
    block, pivot = np.empty((LEAF_SIZE, LEAF_SIZE)), np.empty(LEAF_SIZE)
    for b in range(len(made)):
        first, last = b * LEAF_SIZE, min((b + 1) * LEAF_SIZE, count)
        block[:] = 0.0
        for i in range(LEAF_SIZE):
            block[i, i] = 1.0 + noise_variance if first + i < last else 1.0
        for r in range(first, last):
            for e in range(start[r], middle[r]):
                if column[e] < last:
                    block[r - first, column[e] - first] = block[column[e] - first, r - first] = weight[e]
        for k in range(LEAF_SIZE):
            scale, block[k, k] = 1.0 / max(block[k, k], noise_variance), 1.0
            pivot[:] = scale * block[k]
            block[k] = 0.0
            for i in range(LEAF_SIZE):
                factor = block[i, k]
                block[i, k] = 0.0
                for j in range(LEAF_SIZE):
                    block[i, j] -= factor * pivot[j]
            block[k] = pivot
        made[b] = block
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

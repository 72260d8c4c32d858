"""A packed tree of boxes over the points: leaves of 32 points as vectors, nodes that test their eight children at once.

The points are put in an order in which every run of 32, of 256, of 2048 … is compact, so a node is a range of leaves
and there are no pointers: node i has the children 8i+1 … 8i+8, and the leaves come after the last node.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gpdf_service.kernel_cache import lean
from gpdf_service.types import BoolArray, FloatArray, IntArray

LEAF_SIZE = 32
"""Points in a leaf, four vectors of eight: with 16 the walk costs more than the points, with 64 too many are far."""
FANOUT = 8
"""Children of a node: their boxes are tested in one straight loop."""
STACK = 128
"""Nodes waiting at once: seven a level and eight, and 8^17 leaves do not exist."""
VECTORS = {"reassoc", "contract", "nsz", "arcp"}
"""Sums may be reordered into vectors; NaN and inf keep their meaning."""

Place = tuple[float, float, float]
"""(x, y, z) [m]; z is 0 in 2D."""


class Tree(NamedTuple):
    """Points in the tree's order, cut into leaves.

    Attributes:
        points: Reordered points [m], shape (n, dim).
        order: Row of the original array for each row of `points`, shape (n,).
        begin: First row of each leaf, and n, shape (leaves + 1,).
        blocks: x, y and z of each leaf's points [m], its last point repeated, z = 0 in 2D; shape (leaves, 3, 32).
        boxes: Least x, y, z and largest x, y, z of each child of each node [m], shape (nodes, 6, 8); where there is no
            child, or none with points, the least are inf and the largest −inf.
    """

    points: FloatArray
    order: IntArray
    begin: IntArray
    blocks: FloatArray
    boxes: FloatArray


class Scratch(NamedTuple):
    """What one walk needs to remember; made once a batch.

    Attributes:
        stack: Nodes that wait, shape (128,).
        bound: Squared distance of each of them [m²], shape (128,).
        near: The same of a node's children, shape (8,).
        last: The point that a field's last answer was nearest to, by its place among the blocks; −1 for none. Places
            along a path are beside each other, so the next walk has little left to look at. Shape (1,).
    """

    stack: IntArray
    bound: FloatArray
    near: FloatArray
    last: IntArray


class Look(NamedTuple):
    """What looking at all points around a place needs: a walk, and the points of one leaf as that place sees them.

    Attributes:
        walk: Of the tree.
        offset: Of each point from the place [m], shape (3, 32).
        square: Its squared distance [m²], shape (32,).
        row: Those that are near, in front; shape (32,).
    """

    walk: Scratch
    offset: FloatArray
    square: FloatArray
    row: IntArray


def build_tree(points: FloatArray) -> Tree:
    """Build the tree over `points`, shape (n, dim), n ≥ 1: O(n log n), cut near the median of the longest side."""
    points = np.ascontiguousarray(points, dtype=np.float64)
    order = np.arange(len(points))
    _arrange(points, order, _room(len(points)))
    leaves = -(-len(points) // LEAF_SIZE)
    return tree_of(points[order], order, np.minimum(LEAF_SIZE * np.arange(leaves + 1), len(points)))


def tree_of(points: FloatArray, order: IntArray, begin: IntArray) -> Tree:
    """The tree over `points`, shape (n, dim), that are in its order already and cut into leaves at `begin`."""
    leaves = len(begin) - 1
    nodes = (_room(LEAF_SIZE * leaves) * FANOUT // LEAF_SIZE - 1) // (FANOUT - 1)
    blocks, boxes = np.empty((leaves, 3, LEAF_SIZE)), np.empty((nodes, 6, FANOUT))
    boxes[:, :3], boxes[:, 3:] = np.inf, -np.inf
    if leaves:  # a module makes one without points: it need not load the kernel
        _fill(points, begin, blocks, boxes)
    return Tree(points, order, begin, blocks, boxes)


def _room(count: int) -> int:
    """Points that a child of the root has room for, so that its eight children hold `count`."""
    room = LEAF_SIZE
    while room * FANOUT < count:
        room *= FANOUT
    return room


def change_tree(tree: Tree, keep: BoolArray, added: FloatArray) -> tuple[Tree, IntArray]:
    """The tree without the rows where `keep`, shape (n,), is false and with `added`, shape (k, dim), in it.

    New points come in leaves of their own after the others; when half of the leaves' room would be empty, all is built
    again: so it happens once in as many changes as there are leaves.

    Returns:
        The tree, and where each of its rows comes from: a row of the old tree, or −1 − a row of `added`.
    """
    source, begin = np.flatnonzero(keep), np.append(0, np.cumsum(keep))[tree.begin]
    points = tree.points.take(source, axis=0)
    if len(added):
        fresh = build_tree(added)
        points, source = np.concatenate([points, fresh.points]), np.concatenate([source, -1 - fresh.order])
        begin = np.concatenate([begin, begin[-1] + fresh.begin[1:]])
    if (len(begin) - 2) * LEAF_SIZE > 2 * len(points):
        built = build_tree(points)
        return built, source[built.order]
    return tree_of(points, np.arange(len(points)), begin), source


@njit(cache=True, nogil=True)
def _arrange(points: FloatArray, order: IntArray, room: int) -> None:
    """Order the points so that every run that a node stands for is compact: halves of its children, then theirs.

    The coordinates go along with the order: so what is compared lies side by side, however many there are.
    """
    along = points.T.copy()
    todo = [(0, len(points), room)]
    while todo:
        a, b, room = todo.pop()
        while b - a <= room and room > LEAF_SIZE:
            room //= FANOUT
        if b - a <= LEAF_SIZE:
            continue
        axis, widest = 0, -1.0
        for k in range(len(along)):
            low, high = np.inf, -np.inf
            for i in range(a, b):
                low, high = min(low, along[k, i]), max(high, along[k, i])
            if high - low > widest:
                axis, widest = k, high - low
        children = (b - a + room - 1) // room
        middle = a + (children + 1) // 2 * room
        _select(along, order, axis, a, b - 1, middle)
        todo.append((a, middle, room))
        todo.append((middle, b, room))


@njit(cache=True, nogil=True)
def _select(along: FloatArray, order: IntArray, axis: int, left: int, right: int, target: int) -> None:
    """Hoare's quickselect: put the `target`-th smallest along `axis` in its place within columns left..right."""
    key = along[axis]
    while left < right:
        pivot = key[(left + right) // 2]
        i, j = left, right
        while i <= j:
            while key[i] < pivot:
                i += 1
            while key[j] > pivot:
                j -= 1
            if i <= j:
                for k in range(len(along)):
                    along[k, i], along[k, j] = along[k, j], along[k, i]
                order[i], order[j] = order[j], order[i]
                i += 1
                j -= 1
        if target <= j:
            right = j
        elif target >= i:
            left = i
        else:
            return


@njit(cache=True, nogil=True)
def _fill(points: FloatArray, begin: IntArray, blocks: FloatArray, boxes: FloatArray) -> None:
    """The blocks of the leaves, and all boxes."""
    nodes, dim = boxes.shape[0], points.shape[1]
    for leaf in range(blocks.shape[0]):
        node, child = (nodes + leaf - 1) // FANOUT, (nodes + leaf - 1) % FANOUT
        first, count = begin[leaf], begin[leaf + 1] - begin[leaf]
        for k in range(3):
            low, high = np.inf, -np.inf
            for j in range(LEAF_SIZE):
                value = points[first + min(j, count - 1), k] if count > 0 and k < dim else 0.0
                blocks[leaf, k, j] = value
                low, high = lesser(value, low), larger(value, high)
            boxes[node, k, child] = low if count > 0 else np.inf
            boxes[node, 3 + k, child] = high if count > 0 else -np.inf
    for node in range(nodes - 1, 0, -1):
        parent, child = (node - 1) // FANOUT, (node - 1) % FANOUT
        for k in range(3):
            boxes[parent, k, child] = boxes[node, k].min()
            boxes[parent, 3 + k, child] = boxes[node, 3 + k].max()


@njit(cache=True, nogil=True)
def longer(values: NDArray[Any], capacity: int) -> NDArray[Any]:
    """The values (n, …) with room behind them for `capacity` in all."""
    made = np.empty((capacity, *values.shape[1:]), values.dtype)
    made[: len(values)] = values
    return made


@njit(cache=True, nogil=True)
def make_scratch() -> Scratch:
    """Fresh scratch for one thread."""
    return Scratch(np.empty(STACK, np.int64), np.empty(STACK), np.empty(FANOUT), np.full(1, -1))


@njit(cache=True, nogil=True)
def make_look() -> Look:
    """Room for one look at a time; made once a batch."""
    return Look(make_scratch(), np.empty((3, LEAF_SIZE)), np.empty(LEAF_SIZE), np.empty(LEAF_SIZE, np.int64))


@lean()
def place_of(x: FloatArray) -> Place:
    """A row of 2 or 3 coordinates as a place."""
    return x[0], x[1], x[2] if len(x) == 3 else 0.0


@njit(cache=True, nogil=True, fastmath=VECTORS | {"nnan"})
def lesser(a: float, b: float) -> float:
    """The smaller number, of two that are none of them NaN: so that a minimum over a loop becomes vectors."""
    return a if a < b else b


@njit(cache=True, nogil=True, fastmath=VECTORS | {"nnan"})
def larger(a: float, b: float) -> float:
    """The larger number, of two that are none of them NaN."""
    return a if a > b else b


_Y, _Z, _HIGH = np.uint64(FANOUT), np.uint64(2 * FANOUT), np.uint64(3 * FANOUT)
"""Numbers from a child's least x to its least y, least z and largest x: unsigned, for these are never behind an end."""


@njit(cache=True, nogil=True, fastmath=VECTORS, inline="always")
def write_apart(boxes: FloatArray, node: int, low: Place, high: Place, near: FloatArray) -> None:
    """Write squared distances of a node's children from the box between `low` and `high` [m²].

    A loop whose length is not known, over numbers that are all told by one, becomes vectors.
    """
    first = np.uint64(2) * _HIGH * np.uint64(node)
    for k in range(len(near)):
        x = first + np.uint64(k)
        y, z = x + _Y, x + _Z
        a = larger(larger(boxes[0, 0, x] - high[0], low[0] - boxes[0, 0, x + _HIGH]), 0.0)
        b = larger(larger(boxes[0, 0, y] - high[1], low[1] - boxes[0, 0, y + _HIGH]), 0.0)
        c = larger(larger(boxes[0, 0, z] - high[2], low[2] - boxes[0, 0, z + _HIGH]), 0.0)
        near[k] = a * a + b * b + c * c


@lean(fastmath=VECTORS)
def next_leaf(boxes: FloatArray, low: Place, high: Place, limit: float, scratch: Scratch, top: int) -> tuple[int, int]:
    """One step of a walk, nearest first: the next leaf within √`limit` of the box from `low` to `high`.

    Who wants a place passes it twice. The limit may fall from step to step. Start with `top` = `from_root(…)` and pass
    on what is returned. What asks for no order, as `sums_around`, walks by itself.

    Returns:
        The leaf, −1 when there is none left; `top` for the next step.
    """
    stack, bound, near, _ = scratch
    nodes = boxes.shape[0]
    while top > 0:
        top -= 1
        node = stack[top]
        if bound[top] > limit:
            continue
        if node >= nodes:
            return node - nodes, top
        write_apart(boxes, node, low, high, near)
        base = top
        for k in range(FANOUT):
            distance2 = near[k]
            if distance2 <= limit and distance2 < np.inf:
                at = top
                while at > base and bound[at - 1] < distance2:
                    stack[at], bound[at] = stack[at - 1], bound[at - 1]
                    at -= 1
                stack[at], bound[at] = FANOUT * node + 1 + k, distance2
                top += 1
    return -1, 0


@lean()
def rows_within(tree: Tree, leaf: int, x: Place, limit: float, look: Look) -> int:
    """Write which of a leaf's points are within √`limit` of x; how many they are."""
    offset, square, row = look.offset, look.square, look.row
    for j in range(LEAF_SIZE):
        a, b, c = tree.blocks[leaf, 0, j] - x[0], tree.blocks[leaf, 1, j] - x[1], tree.blocks[leaf, 2, j] - x[2]
        offset[0, j], offset[1, j], offset[2, j] = a, b, c
        square[j] = a * a + b * b + c * c
    count = 0
    for j in range(tree.begin[leaf + 1] - tree.begin[leaf]):
        row[count] = j
        count += square[j] <= limit
    return count


@lean()
def from_root(scratch: Scratch) -> int:
    """`top` of a walk that begins at the root."""
    scratch.stack[0], scratch.bound[0] = 0, 0.0
    return 1


NO_POINTS = tree_of(np.zeros((0, 2)), np.zeros(0, np.int64), np.zeros(1, np.int64))
"""A tree without points: nothing is near to any place."""

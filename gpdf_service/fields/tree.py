"""A balanced k-d tree in flat arrays: every node is a contiguous range of reordered points with its bounding box."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from gpdf_service.types import BoolArray, FloatArray, IntArray

LEAF_SIZE = 16
"""Points in a leaf: below it, walking the tree costs more than comparing the points."""


class Tree(NamedTuple):
    """Node i has the children 2i+1 and 2i+2; the tree is complete, so there are no pointers.

    Attributes:
        points: Reordered points [m], shape (n, dim), columns contiguous (Fortran order): a leaf's x are one vector.
        order: Row of the original array for each row of `points`, shape (n,).
        begin: First point of each node, shape (nodes,).
        end: One past the last point of each node, shape (nodes,).
        low: Lower corner of each node's box [m], shape (nodes, dim).
        high: Upper corner, shape (nodes, dim).
    """

    points: FloatArray
    order: IntArray
    begin: IntArray
    end: IntArray
    low: FloatArray
    high: FloatArray


def build_tree(points: FloatArray) -> Tree:
    """Build the tree over `points`, shape (n, dim), n ≥ 1: O(n log n), halves cut at the median of the longest side."""
    points = np.ascontiguousarray(points, dtype=np.float64)
    count, dim = points.shape
    depth = 0
    while count > LEAF_SIZE << depth:
        depth += 1
    nodes = (2 << depth) - 1
    order = np.arange(count, dtype=np.int64)
    begin, end = np.zeros(nodes, np.int64), np.zeros(nodes, np.int64)
    low, high = np.zeros((nodes, dim)), np.zeros((nodes, dim))
    _split(points, order, begin, end, low, high)
    return Tree(np.asfortranarray(points[order]), order, begin, end, low, high)


def change_tree(tree: Tree, keep: BoolArray, added: FloatArray) -> tuple[Tree, IntArray]:
    """The tree without the rows where `keep`, shape (n,), is false and with `added`, shape (k, dim), in it.

    New points join the leaf whose box they are nearest to, so the rest of the tree stays as it is; when a leaf would
    outgrow `_CROWDED`, all is built again.

    Returns:
        The tree, and where each of its rows comes from: a row of the old tree, or −1 − a row of `added`.
    """
    nodes = len(tree.begin)
    leaves = np.arange(nodes // 2, nodes)  # all at one depth, so in the order of their points
    kept = np.concatenate([[0], np.cumsum(keep)])
    home = _leaves_for(tree, np.ascontiguousarray(added))
    joined = np.bincount(home, minlength=nodes)[leaves]
    size = kept[tree.end[leaves]] - kept[tree.begin[leaves]] + joined
    by_leaf = np.argsort(home, kind="stable")
    source = np.insert(np.flatnonzero(keep), kept[tree.end[home[by_leaf]]], -1 - by_leaf)
    points = np.concatenate([tree.points, added[::-1]])[source]  # row −1 − i is `added[i]`
    if size.max() > _CROWDED or len(source) < len(leaves):
        built = build_tree(points)
        return built, source[built.order]
    begin, end = np.zeros(nodes, np.int64), np.zeros(nodes, np.int64)
    end[leaves] = np.cumsum(size)
    begin[leaves] = end[leaves] - size
    low, high = tree.low.copy(), tree.high.copy()
    changed = np.zeros(nodes, dtype=bool)
    changed[leaves] = (joined > 0) | (size < tree.end[leaves] - tree.begin[leaves])
    points = np.asfortranarray(points)
    _fit_boxes(points, begin, end, low, high, changed)
    return Tree(points, np.arange(len(points)), begin, end, low, high), source


_CROWDED = 8 * LEAF_SIZE
"""Points in a leaf after which the tree is built anew."""


@njit(cache=True, nogil=True)
def _leaves_for(tree: Tree, added: FloatArray) -> IntArray:
    nodes = tree.begin.shape[0]
    leaf = np.zeros(len(added), np.int64)
    for i in range(len(added)):
        node = 0
        while 2 * node + 1 < nodes:
            left = 2 * node + 1
            a = box_distance2(tree.low, tree.high, left, added[i])
            b = box_distance2(tree.low, tree.high, left + 1, added[i])
            node = left if a <= b else left + 1
        leaf[i] = node
    return leaf


@njit(cache=True, nogil=True)
def _fit_boxes(
    points: FloatArray, begin: IntArray, end: IntArray, low: FloatArray, high: FloatArray, changed: BoolArray
) -> None:
    """Ranges of the inner nodes, and boxes of the changed leaves and of all above them, from the leaves up."""
    nodes, dim = low.shape
    for node in range(nodes - 1, -1, -1):
        left = 2 * node + 1
        if left < nodes:
            begin[node], end[node] = begin[left], end[left + 1]
            if not (changed[left] or changed[left + 1]):
                continue
            changed[node] = True
            for k in range(dim):
                low[node, k] = min(low[left, k], low[left + 1, k])
                high[node, k] = max(high[left, k], high[left + 1, k])
        elif changed[node]:
            for k in range(dim):
                low[node, k], high[node, k] = np.inf, -np.inf
                for i in range(begin[node], end[node]):
                    low[node, k] = min(low[node, k], points[i, k])
                    high[node, k] = max(high[node, k], points[i, k])


@njit(cache=True, nogil=True)
def _split(
    points: FloatArray, order: IntArray, begin: IntArray, end: IntArray, low: FloatArray, high: FloatArray
) -> None:
    nodes, dim = low.shape
    end[0] = points.shape[0]
    for node in range(nodes):
        a, b = begin[node], end[node]
        axis, widest = 0, -1.0
        for k in range(dim):
            low[node, k], high[node, k] = np.inf, -np.inf
            for i in range(a, b):
                value = points[order[i], k]
                low[node, k] = min(low[node, k], value)
                high[node, k] = max(high[node, k], value)
            if high[node, k] - low[node, k] > widest:
                axis, widest = k, high[node, k] - low[node, k]
        if 2 * node + 1 < nodes:
            middle = (a + b) // 2
            _select(points, order, axis, a, b - 1, middle)
            begin[2 * node + 1], end[2 * node + 1] = a, middle
            begin[2 * node + 2], end[2 * node + 2] = middle, b


@njit(cache=True, nogil=True)
def _select(points: FloatArray, order: IntArray, axis: int, left: int, right: int, target: int) -> None:
    """Hoare's quickselect: put the `target`-th smallest along `axis` in its place within order[left..right]."""
    while left < right:
        pivot = points[order[(left + right) // 2], axis]
        i, j = left, right
        while i <= j:
            while points[order[i], axis] < pivot:
                i += 1
            while points[order[j], axis] > pivot:
                j -= 1
            if i <= j:
                order[i], order[j] = order[j], order[i]
                i += 1
                j -= 1
        if target <= j:
            right = j
        elif target >= i:
            left = i
        else:
            return


@njit(cache=True, nogil=True, inline="always")
def box_distance2(low: FloatArray, high: FloatArray, node: int, x: FloatArray) -> float:
    """Squared distance from `x` to a node's box; 0 inside."""
    total = 0.0
    for k in range(x.shape[0]):
        gap = max(low[node, k] - x[k], 0.0, x[k] - high[node, k])
        total += gap * gap
    return total

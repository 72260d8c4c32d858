"""A quadtree of the free space that knows the body: a leaf is free if the body's centre may be there.

With d the exact distance from a leaf's centre to the nearest obstacle (1-Lipschitz), r the radius, b half its diagonal:
d − b ≥ r: all of the leaf is free; d + b < r: none of it; else split, down to `least_width`; there the centre decides.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
from numba import njit

from gpdf_service.fields import Tree, morton
from gpdf_service.fields.traversal import nearest_at
from gpdf_service.fields.tree import longer, make_scratch, place_of
from gpdf_service.kernel_cache import lean
from gpdf_service.tiles import HeightMap
from gpdf_service.tiles.boxes import span
from gpdf_service.tiles.surface import Cells, is_known, turned
from gpdf_service.tiles.width import exact
from gpdf_service.types import BoolArray, FloatArray, IntArray

MIN_WIDTH = 0.014
"""[m] Half its diagonal is 1 cm: a gap with 1 cm to spare on either side holds a leaf's centre."""
CELL_SHARE = 0.2
"""[-] Of a cell of the ground, which is wider than its points are apart: what is finer was not measured."""
ANCHORED = 1 << 12
"""Smallest cells of whose multiples the root's corner is one, 57 m: it stays where the ground goes on a little."""


class Quadtree(NamedTuple):
    """The leaves, in Morton order; together they tile the root square. Kernels take it as it is.

    Attributes:
        origin: Lower corner of the root [m], shape (2,).
        width: Width of the smallest cell [m].
        corner: Lower corner of each leaf in smallest cells, shape (k, 2).
        size: Width of each leaf in smallest cells, shape (k,).
        clearance: Distance from its centre to the nearest obstacle [m], shape (k,).
        free: Whether the body's centre may be at the leaf's centre, shape (k,).
        whole: Whether it may be anywhere in the leaf, shape (k,).
        code: Morton code of the lower corner, ascending, shape (k,).
    """

    origin: FloatArray
    width: float
    corner: IntArray
    size: IntArray
    clearance: FloatArray
    free: BoolArray
    whole: BoolArray
    code: IntArray

    @property
    def center(self) -> FloatArray:
        """Centres of the leaves [m], shape (k, 2)."""
        made = np.empty((len(self.size), 2))
        _write_centers(self, made)
        return made

    @property
    def half_size(self) -> FloatArray:
        """Half the width of each leaf [m], shape (k,)."""
        made: FloatArray = (0.5 * self.width * self.size).astype(np.float64)
        return made

    @property
    def standing(self) -> Quadtree:
        """Without what moves."""
        return self

    @property
    def numbers(self) -> IntArray:
        """Of all leaves."""
        return np.arange(len(self.size))

    def find(self, xy: FloatArray) -> IntArray:
        """Leaf that holds each place, shape (m, 2) [m]; -1 outside the root. Shape (m,)."""
        return self.find_cell(np.floor((xy - self.origin) / self.width).astype(np.int64))

    def find_one(self, xy: FloatArray) -> int:
        """`find` of a single place, shape (2,)."""
        found: int = _find_one(self, xy)
        return found

    def within(self, xy: FloatArray, reach: float) -> IntArray:
        """Leaves that meet a square of half-width `reach` [m] around a place (2,) [m], in time by their number."""
        low, high = (xy - reach - self.origin) / self.width, (xy + reach - self.origin) / self.width
        found: IntArray = _within(self, np.floor(low), np.ceil(high))
        return found

    def find_cell(self, cell: IntArray) -> IntArray:
        """Leaf that holds each smallest cell, shape (m, 2); -1 outside the root."""
        found: IntArray = _find(self, cell)
        return found


_NONE = np.zeros(0, np.int64)
NO_LEAVES = Quadtree(np.zeros(2), 1.0, np.zeros((0, 2), np.int64), _NONE, np.zeros(0), _NONE > 0, _NONE > 0, _NONE)
"""A tree of nothing."""


@lean()
def side_of(tree: Quadtree) -> int:
    """Width of the root in smallest cells: the last leaf in Morton order is its upper corner."""
    return int(tree.corner[-1, 0] + tree.size[-1])


@lean()
def center_of(tree: Quadtree, leaf: int) -> tuple[float, float]:
    """Where a leaf's centre is [m]."""
    x, y = tree.corner[leaf, 0] + 0.5 * tree.size[leaf], tree.corner[leaf, 1] + 0.5 * tree.size[leaf]
    return tree.origin[0] + x * tree.width, tree.origin[1] + y * tree.width


@lean()
def _write_centers(tree: Quadtree, made: FloatArray) -> None:
    for leaf in range(len(tree.size)):
        made[leaf, 0], made[leaf, 1] = center_of(tree, leaf)


@njit(cache=True, nogil=True)
def touching(tree: Quadtree, leaves: BoolArray) -> BoolArray:
    """Which leaves are among the `leaves`, shape (k,), or share a side or a corner with one of them."""
    found = np.zeros(len(leaves), np.bool_)
    for i in np.flatnonzero(leaves):
        for j in _within(tree, tree.corner[i] - 0.5, tree.corner[i] + tree.size[i] + 0.5):
            found[j] = True
    return found


@njit(cache=True, nogil=True)
def _find(tree: Quadtree, cell: IntArray) -> IntArray:
    """See `Quadtree.find_cell`."""
    side, leaf = side_of(tree), np.searchsorted(tree.code, morton(cell), side="right") - 1
    for i in range(len(cell)):
        if not (0 <= cell[i, 0] < side and 0 <= cell[i, 1] < side):
            leaf[i] = -1
    return leaf


@njit(cache=True, nogil=True)
def _find_one(tree: Quadtree, xy: FloatArray) -> int:
    """See `Quadtree.find_one`."""
    cell = np.empty((1, 2), np.int64)
    for k in range(2):
        cell[0, k] = int(np.floor((xy[k] - tree.origin[k]) / tree.width))
    return int(_find(tree, cell)[0])


@njit(cache=True, nogil=True)
def _within(tree: Quadtree, low: FloatArray, high: FloatArray) -> IntArray:
    """Leaves that meet a box of smallest cells: down from the root; a square of n × n cells is n² codes in a row."""
    found = [0 for _ in range(0)]
    stack = [(0, 0, side_of(tree), 0, len(tree.code))]
    while len(stack) > 0:
        i, j, n, first, last = stack.pop()
        if i >= high[0] or j >= high[1] or i + n <= low[0] or j + n <= low[1]:
            continue
        if last - first == 1:
            found.append(first)
            continue
        h, ends = n // 2, quarters(tree.code, n, first, last)
        for k in range(4):
            stack.append((i + (k >> 1) * h, j + (k & 1) * h, h, ends[k], ends[k + 1]))
    return np.array(found)


@njit(cache=True, nogil=True)
def quarters(code: IntArray, n: int, first: int, last: int) -> tuple[int, int, int, int, int]:
    """Where the leaves of each quarter of a square of n × n smallest cells begin, which are n² codes, and the end."""
    own, share = code[first:last], n * n // 4
    one, two = np.searchsorted(own, code[first] + share), np.searchsorted(own, code[first] + 2 * share)
    return first, first + one, first + two, first + np.searchsorted(own, code[first] + 3 * share), last


def least_width(surface: HeightMap) -> float:
    """Width of the smallest cells over a ground [m]."""
    return exact(max(MIN_WIDTH, CELL_SHARE * surface.cell_width))


def root_of(surface: HeightMap) -> tuple[FloatArray, int]:
    """Lower corner [m] of the root over a ground, and how often it is halved down to the smallest cells."""
    width = least_width(surface)
    low = np.asarray(surface.origin, dtype=np.float64) / width
    corner = np.floor(low / ANCHORED) * ANCHORED
    side = np.max(low - corner + np.array(surface.state.shape) * (surface.cell_width / width))
    return corner * width, max(0, int(np.ceil(np.log2(side))))


Former = tuple[Quadtree, Tree | None, Cells]
"""The tree of the version before, the obstacles that came or went since [m], if any did, and which cells became known
or unknown, see `turned`."""
ROUNDING = 1e-9
"""[m] Far more than two ways to compute a distance differ by, far less than matters."""


def build_quadtree(surface: HeightMap, obstacles: Tree, radius: float, former: Former | None = None) -> Quadtree:
    """The tree over a level's ground, of a body whose centre keeps a `radius` [m] from all `obstacles` in plan [m].

    What it is in a `former` version is copied from there. A node's distance to the obstacles is another only if a place
    that changed is as near as its old distance, which a leaf knows, and which is less than the radius and half the
    diagonal where the node was split; that of what is in it is at most half a diagonal more, from a centre half a
    diagonal nearer.
    """
    width, (origin, depth) = least_width(surface), root_of(surface)
    if former is None or (origin != former[0].origin).any() or side_of(former[0]) != 1 << depth:
        former = NO_LEAVES, None, turned(surface, surface)
    old, places, felt = former
    trees = obstacles, obstacles if places is None else places, places is not None
    made = _split(old, trees, (origin, width, depth, radius), surface.arrays, felt)
    return Quadtree(origin, width, *made, morton(made[0]))


_Leaves = tuple[IntArray, IntArray, FloatArray, BoolArray, BoolArray]
"""Corner, size and clearance of leaves, whether they are free, and wholly: see `Quadtree`."""


@njit(cache=True, nogil=True)
def _split(
    old: Quadtree,
    trees: tuple[Tree, Tree, bool],
    measures: tuple[FloatArray, float, int, float],
    ground: Cells,
    felt: Cells,
) -> _Leaves:
    """The leaves in Morton order; what is as it was is copied from `old`.

    A node's `first` is its first old leaf, or −1 where there was none inside.
    """
    obstacles, places, moved = trees
    origin, width, depth, radius = measures
    rows, columns = _sides(felt, origin, width)
    capacity, count = len(old.size) + _MORE, 0
    corner, size, clearance = np.empty((capacity, 2), np.int64), np.empty(capacity, np.int64), np.empty(capacity)
    free, whole = np.empty(capacity, np.bool_), np.empty(capacity, np.bool_)
    stack, bound = np.empty((4 * depth + 4, 4), np.int64), np.empty(4 * depth + 4)
    stack[0, 0], stack[0, 1], stack[0, 2], stack[0, 3] = 0, 0, 1 << depth, 0 if len(old.size) > 0 else -1
    bound[0] = -np.inf if moved else np.inf  # a place that changed is no nearer to the node's centre
    top, x, scratch = 1, np.empty(2), make_scratch()
    while top > 0:
        top -= 1
        i, j, n, first = stack[top]
        nearest = bound[top]
        x[0], x[1] = origin[0] + (i + 0.5 * n) * width, origin[1] + (j + 0.5 * n) * width
        half_diagonal = 0.5 * sqrt(2.0) * n * width
        leaf = first >= 0 and old.size[first] == n
        split, copied = False, False
        if first >= 0:
            reach = (old.clearance[first] if leaf else radius + half_diagonal) + ROUNDING
            if nearest <= reach:
                nearest = nearest_at(places, place_of(x), scratch)[0]
            split = not leaf and nearest > reach
            copied = leaf and nearest > reach and not is_known(felt, x[0], x[1])
            if split and nearest > reach + 2.0 * half_diagonal and (_apart(i, n, rows) or _apart(j, n, columns)):
                last = np.searchsorted(old.code, old.code[first] + n * n)
                begin, count = count, count + last - first
                if count > len(size):
                    corner, size, clearance, free, whole = _with_room(corner, size, clearance, free, whole, 2 * count)
                corner[begin:count], size[begin:count] = old.corner[first:last], old.size[first:last]
                clearance[begin:count] = old.clearance[first:last]
                free[begin:count], whole[begin:count] = old.free[first:last], old.whole[first:last]
                continue
        distance = old.clearance[first] if copied else 0.0
        if not split and not copied:
            distance = nearest_at(obstacles, place_of(x), scratch)[0]
            split = is_split(distance, half_diagonal, radius, n)
        if split:
            h = n // 2
            for k in range(3, -1, -1):
                stack[top, 0], stack[top, 1], stack[top, 2] = i + (k >> 1) * h, j + (k & 1) * h, h
                stack[top, 3] = -1
                if first >= 0 and not leaf:
                    stack[top, 3] = np.searchsorted(old.code, old.code[first] + k * h * h)
                bound[top] = nearest - 0.5 * half_diagonal
                top += 1
            continue
        if count == len(size):
            corner, size, clearance, free, whole = _with_room(corner, size, clearance, free, whole, 2 * count)
        corner[count, 0], corner[count, 1], size[count], clearance[count] = i, j, n, distance
        if copied:
            free[count], whole[count] = old.free[first], old.whole[first]
        else:
            free[count], whole[count] = is_free(distance, half_diagonal, radius, is_known(ground, x[0], x[1]))
        count += 1
    if len(size) > capacity:  # it grew: much room may be left
        corner, size, clearance = corner[:count].copy(), size[:count].copy(), clearance[:count].copy()
        free, whole = free[:count].copy(), whole[:count].copy()
    return corner[:count], size[:count], clearance[:count], free[:count], whole[:count]


_MORE = 1 << 14
"""Leaves that there is room for beside as many as before."""


@njit(cache=True, nogil=True)
def _with_room(
    corner: IntArray, size: IntArray, clearance: FloatArray, free: BoolArray, whole: BoolArray, capacity: int
) -> _Leaves:
    return (
        longer(corner, capacity),
        longer(size, capacity),
        longer(clearance, capacity),
        longer(free, capacity),
        longer(whole, capacity),
    )


@njit(cache=True, nogil=True)
def is_split(distance: float, half_diagonal: float, radius: float, n: int) -> bool:
    """Whether some of a node of n × n smallest cells is free, and some is not."""
    return distance - half_diagonal < radius <= distance + half_diagonal and n > 1


@njit(cache=True, nogil=True)
def is_free(distance: float, half_diagonal: float, radius: float, seen: bool) -> tuple[bool, bool]:
    """Whether a leaf is free at its centre, and wholly."""
    return seen and distance >= radius, seen and distance - half_diagonal >= radius


@njit(cache=True, nogil=True)
def _sides(felt: Cells, origin: FloatArray, width: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """Where rows and columns of cells that are felt begin and end, in smallest cells, and one of the ground's more."""
    left, right, near, far = span(felt.state > 0)
    share, x, y = felt.width / width, felt.origin[0] - origin[0], felt.origin[1] - origin[1]
    rows = x / width + (left - 1) * share, x / width + (right + 1) * share
    return rows, (y / width + (near - 1) * share, y / width + (far + 1) * share)


@njit(cache=True, nogil=True)
def _apart(i: int, n: int, side: tuple[float, float]) -> bool:
    """Whether n smallest cells, from the i-th on, are beside a stretch of them."""
    return i + n <= side[0] or i >= side[1]

"""A quadtree of the free space that knows the body: a leaf is free if the body's centre may be there.

With d the exact distance from a leaf's centre to the nearest obstacle (1-Lipschitz), r the radius, b half its diagonal:
d − b ≥ r: all of the leaf is free; d + b < r: none of it; else split, down to `least_width`; there the centre decides.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import sqrt

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gpdf_service.fields import Tree, morton
from gpdf_service.fields.traversal import nearest_at
from gpdf_service.fields.tree import longer, make_scratch, place_of
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


@dataclass(frozen=True)
class Quadtree:
    """The leaves, in Morton order; together they tile the root square.

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

    @cached_property
    def center(self) -> FloatArray:
        """Centres of the leaves [m], shape (k, 2)."""
        made = np.empty((len(self.size), 2))
        _write_centers(self.corner, self.size, self.origin, self.width, made)
        return made

    @cached_property
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
        found: int = _find_one(self.code, self.corner, self.size, self.origin, self.width, xy)
        return found

    @property
    def side(self) -> int:
        """Width of the root in smallest cells: the last leaf in Morton order is its upper corner."""
        return int(self.corner[-1, 0] + self.size[-1])

    def within(self, xy: FloatArray, reach: float) -> IntArray:
        """Leaves that meet a square of half-width `reach` [m] around a place (2,) [m], in time by their number."""
        low, high = (xy - reach - self.origin) / self.width, (xy + reach - self.origin) / self.width
        found: IntArray = _within(self.code, self.side, np.floor(low), np.ceil(high))
        return found

    def find_cell(self, cell: IntArray) -> IntArray:
        """Leaf that holds each smallest cell, shape (m, 2); -1 outside the root."""
        found: IntArray = _find(self.code, self.side, cell)
        return found

    def touching(self, leaves: BoolArray) -> BoolArray:
        """Which leaves are among the `leaves`, shape (k,), or share a side or a corner with one of them."""
        found: BoolArray = _touching(self.code, self.side, self.corner, self.size, leaves)
        return found


@njit(cache=True, nogil=True)
def _write_centers(corner: IntArray, size: IntArray, origin: FloatArray, width: float, made: FloatArray) -> None:
    for i in range(len(size)):
        for k in range(2):
            made[i, k] = origin[k] + (corner[i, k] + 0.5 * size[i]) * width


@njit(cache=True, nogil=True)
def _touching(code: IntArray, side: int, corner: IntArray, size: IntArray, leaves: BoolArray) -> BoolArray:
    found = np.zeros(len(leaves), np.bool_)
    for i in np.flatnonzero(leaves):
        for j in _within(code, side, corner[i] - 0.5, corner[i] + size[i] + 0.5):
            found[j] = True
    return found


@njit(cache=True, nogil=True)
def _find(code: IntArray, side: int, cell: IntArray) -> IntArray:
    """See `Quadtree.find_cell`."""
    leaf = np.searchsorted(code, morton(cell), side="right") - 1
    for i in range(len(cell)):
        if not (0 <= cell[i, 0] < side and 0 <= cell[i, 1] < side):
            leaf[i] = -1
    return leaf


@njit(cache=True, nogil=True)
def _find_one(
    code: IntArray, corner: IntArray, size: IntArray, origin: FloatArray, width: float, xy: FloatArray
) -> int:
    """See `Quadtree.find_one`."""
    cell = np.empty((1, 2), np.int64)
    for k in range(2):
        cell[0, k] = int(np.floor((xy[k] - origin[k]) / width))
    return int(_find(code, corner[-1, 0] + size[-1], cell)[0])


@njit(cache=True, nogil=True)
def _within(code: IntArray, side: int, low: FloatArray, high: FloatArray) -> IntArray:
    """Leaves that meet a box of smallest cells: down from the root; a square of n × n cells is n² codes in a row."""
    found = [0 for _ in range(0)]
    stack = [(0, 0, side, 0, len(code))]
    while len(stack) > 0:
        i, j, n, first, last = stack.pop()
        if i >= high[0] or j >= high[1] or i + n <= low[0] or j + n <= low[1]:
            continue
        if last - first == 1:
            found.append(first)
            continue
        h, ends = n // 2, quarters(code, n, first, last)
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


def build_quadtree(surface: HeightMap, obstacles: Tree, radius: float) -> Quadtree:
    """The tree over a level's ground, of a body whose centre keeps a `radius` [m] from all `obstacles` in plan [m]."""
    none = np.zeros(0, np.int64)
    nothing = np.zeros((0, 2), np.int64), none, np.zeros(0), np.zeros(0, np.uint8), none
    return _grow(nothing, surface, obstacles, radius, None, turned(surface, surface))


ROUNDING = 1e-9
"""[m] Far more than two ways to compute a distance differ by, far less than matters."""


def change_quadtree(
    old: Quadtree, surface: HeightMap, obstacles: Tree, radius: float, places: Tree | None, felt: Cells
) -> Quadtree:
    """The tree that `build_quadtree` makes, from the one before.

    A node's distance to the obstacles is another only if a place that changed is as near as its old distance, which a
    leaf knows, and which is less than the radius and half the diagonal where the node was split; that of what is in it
    is at most half a diagonal more, from a centre half a diagonal nearer. All else is copied.

    The `places` are the obstacles that came or went [m], if any did; `felt` says which cells became known or unknown,
    see `turned`.
    """
    corner, depth = root_of(surface)
    if (corner != old.origin).any() or old.side != 1 << depth:
        return build_quadtree(surface, obstacles, radius)
    state = old.free.astype(np.uint8) + old.whole
    return _grow((old.corner, old.size, old.clearance, state, old.code), surface, obstacles, radius, places, felt)


Leaves = tuple[IntArray, IntArray, FloatArray, NDArray[np.uint8], IntArray]
"""Corner, size, clearance, state (0 blocked, 1 centre free, 2 whole) and Morton code of the leaves of a tree."""


def _grow(
    old: Leaves, surface: HeightMap, obstacles: Tree, radius: float, places: Tree | None, felt: Cells
) -> Quadtree:
    width, (origin, depth) = least_width(surface), root_of(surface)
    corner, size, clearance, state = _split(
        old,
        (obstacles, obstacles if places is None else places, places is not None),
        (origin, width, depth, radius),
        surface.arrays,
        felt,
    )
    return Quadtree(origin, width, corner, size, clearance, state > 0, state == 2, morton(corner))


@njit(cache=True, nogil=True)
def _split(
    old: Leaves,
    trees: tuple[Tree, Tree, bool],
    measures: tuple[FloatArray, float, int, float],
    ground: Cells,
    felt: Cells,
) -> tuple[IntArray, IntArray, FloatArray, NDArray[np.uint8]]:
    """Corner, size, clearance and state of the leaves, in Morton order; what is as it was is copied from `old`.

    A node's `first` is its first old leaf, or −1 where there was none inside.
    """
    corner_was, size_was, clearance_was, state_was, code_was = old
    obstacles, places, moved = trees
    origin, width, depth, radius = measures
    rows, columns = _sides(felt, origin, width)
    capacity, count = len(size_was) + _MORE, 0
    corner, size = np.empty((capacity, 2), np.int64), np.empty(capacity, np.int64)
    clearance, state = np.empty(capacity), np.empty(capacity, np.uint8)
    stack, bound = np.empty((4 * depth + 4, 4), np.int64), np.empty(4 * depth + 4)
    stack[0, 0], stack[0, 1], stack[0, 2], stack[0, 3] = 0, 0, 1 << depth, 0 if len(size_was) > 0 else -1
    bound[0] = -np.inf if moved else np.inf  # a place that changed is no nearer to the node's centre
    top, x, scratch = 1, np.empty(2), make_scratch()
    while top > 0:
        top -= 1
        i, j, n, first = stack[top]
        nearest = bound[top]
        x[0], x[1] = origin[0] + (i + 0.5 * n) * width, origin[1] + (j + 0.5 * n) * width
        half_diagonal = 0.5 * sqrt(2.0) * n * width
        leaf = first >= 0 and size_was[first] == n
        split, copied = False, False
        if first >= 0:
            reach = (clearance_was[first] if leaf else radius + half_diagonal) + ROUNDING
            if nearest <= reach:
                nearest = nearest_at(places, place_of(x), scratch)[0]
            split = not leaf and nearest > reach
            copied = leaf and nearest > reach and not is_known(felt, x[0], x[1])
            if split and nearest > reach + 2.0 * half_diagonal and (_apart(i, n, rows) or _apart(j, n, columns)):
                last = np.searchsorted(code_was, code_was[first] + n * n)
                more = last - first
                if count + more > len(size):
                    corner, size, clearance, state = _with_room(corner, size, clearance, state, 2 * (count + more))
                corner[count : count + more], size[count : count + more] = corner_was[first:last], size_was[first:last]
                clearance[count : count + more] = clearance_was[first:last]
                state[count : count + more] = state_was[first:last]
                count += more
                continue
        distance = clearance_was[first] if copied else 0.0
        if not split and not copied:
            distance = nearest_at(obstacles, place_of(x), scratch)[0]
            split = is_split(distance, half_diagonal, radius, n)
        if split:
            h = n // 2
            for k in range(3, -1, -1):
                stack[top, 0], stack[top, 1], stack[top, 2] = i + (k >> 1) * h, j + (k & 1) * h, h
                stack[top, 3] = -1
                if first >= 0 and not leaf:
                    stack[top, 3] = np.searchsorted(code_was, code_was[first] + k * h * h)
                bound[top] = nearest - 0.5 * half_diagonal
                top += 1
            continue
        if count == len(size):
            corner, size, clearance, state = _with_room(corner, size, clearance, state, 2 * count)
        corner[count, 0], corner[count, 1], size[count], clearance[count] = i, j, n, distance
        if copied:
            state[count] = state_was[first]
        else:
            state[count] = state_of(distance, half_diagonal, radius, is_known(ground, x[0], x[1]))
        count += 1
    if len(size) > capacity:  # it grew: much room may be left
        return corner[:count].copy(), size[:count].copy(), clearance[:count].copy(), state[:count].copy()
    return corner[:count], size[:count], clearance[:count], state[:count]


_MORE = 1 << 14
"""Leaves that there is room for beside as many as before."""


@njit(cache=True, nogil=True)
def _with_room(
    corner: IntArray, size: IntArray, clearance: FloatArray, state: NDArray[np.uint8], capacity: int
) -> tuple[IntArray, IntArray, FloatArray, NDArray[np.uint8]]:
    return longer(corner, capacity), longer(size, capacity), longer(clearance, capacity), longer(state, capacity)


@njit(cache=True, nogil=True)
def is_split(distance: float, half_diagonal: float, radius: float, n: int) -> bool:
    """Whether some of a node of n × n smallest cells is free, and some is not."""
    return distance - half_diagonal < radius <= distance + half_diagonal and n > 1


@njit(cache=True, nogil=True)
def state_of(distance: float, half_diagonal: float, radius: float, seen: bool) -> int:
    """Of a leaf: 0 blocked, 1 free at its centre, 2 wholly."""
    return 0 if not seen or distance < radius else (2 if distance - half_diagonal >= radius else 1)


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

"""A quadtree of the free space that knows the body: a leaf is free if the body's centre may be there.

With d the exact distance from a leaf's centre to the nearest obstacle (1-Lipschitz), r the radius, b half its diagonal:
d − b ≥ r: all of the leaf is free; d + b < r: none of it; else split, down to `MIN_WIDTH`; there the centre decides.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gpdf_service.fields import Tree, morton, nearest_one
from gpdf_service.perception import HeightMap
from gpdf_service.types import BoolArray, FloatArray, IntArray

MIN_WIDTH = 0.014
"""[m] Half its diagonal is 1 cm: a gap with 1 cm to spare on either side holds a leaf's centre."""


@dataclass(frozen=True, slots=True)
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

    @property
    def center(self) -> FloatArray:
        """Centres of the leaves [m], shape (k, 2)."""
        made: FloatArray = self.origin + (self.corner + 0.5 * self.size[:, None]) * self.width
        return made

    @property
    def half_size(self) -> FloatArray:
        """Half the width of each leaf [m], shape (k,)."""
        made: FloatArray = (0.5 * self.width * self.size).astype(np.float64)
        return made

    def find(self, xy: FloatArray) -> IntArray:
        """Leaf that holds each place, shape (m, 2) [m]; -1 outside the root. Shape (m,)."""
        cell = np.floor((xy - self.origin) / self.width).astype(np.int64)
        return self.find_cell(cell)

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
        inside = np.logical_and.reduce((cell >= 0) & (cell < self.side), axis=1)
        code = morton(np.where(inside[:, None], cell, 0))
        return np.where(inside, np.searchsorted(self.code, code, side="right") - 1, -1)


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
        h, base = n // 2, code[first]
        for quarter in range(4):
            end = first + np.searchsorted(code[first:last], base + (quarter + 1) * h * h)
            stack.append((i + (quarter >> 1) * h, j + (quarter & 1) * h, h, first, end))
            first = end
    return np.array(found)


def build_quadtree(surface: HeightMap, obstacles: Tree, radius: float) -> Quadtree:
    """Build the tree over the known ground of one level.

    Args:
        surface: The level's ground.
        obstacles: All obstacle places of the body in plan [m].
        radius: Least distance of the body's centre from any of them [m].
    """
    extent = surface.cell_width * max(surface.height.shape)
    depth = max(0, int(np.ceil(np.log2(extent / MIN_WIDTH))))
    capacity = 1 << 16
    while True:
        corner, size = np.zeros((capacity, 2), np.int64), np.zeros(capacity, np.int64)
        clearance, state = np.zeros(capacity), np.zeros(capacity, np.uint8)
        known = surface.state.astype(np.uint8)
        count = _split(
            obstacles,
            surface.origin,
            MIN_WIDTH,
            depth,
            radius,
            known,
            surface.cell_width,
            corner,
            size,
            clearance,
            state,
        )
        if count >= 0:
            break
        capacity *= 4
    code = morton(corner[:count])
    order = np.argsort(code)
    state = state[:count][order]
    return Quadtree(
        np.asarray(surface.origin, dtype=np.float64),
        MIN_WIDTH,
        corner[:count][order],
        size[:count][order],
        clearance[:count][order],
        state > 0,
        state == 2,
        code[order],
    )


@njit(cache=True, nogil=True)
def _split(
    obstacles: Tree,
    origin: FloatArray,
    width: float,
    depth: int,
    radius: float,
    known: NDArray[np.uint8],
    cell_width: float,
    corner: IntArray,
    size: IntArray,
    clearance: FloatArray,
    state: NDArray[np.uint8],
) -> int:
    """Fill the leaves; returns how many, -1 if the arrays are too short. State: 0 blocked, 1 centre free, 2 whole."""
    stack = np.empty((4 * depth + 4, 3), np.int64)
    stack[0, 0], stack[0, 1], stack[0, 2] = 0, 0, 1 << depth
    top, count = 1, 0
    x = np.empty(2)
    while top > 0:
        top -= 1
        i, j, n = stack[top]
        x[0], x[1] = origin[0] + (i + 0.5 * n) * width, origin[1] + (j + 0.5 * n) * width
        ix, iy = int((x[0] - origin[0]) / cell_width), int((x[1] - origin[1]) / cell_width)
        seen = 0 <= ix < known.shape[0] and 0 <= iy < known.shape[1] and known[ix, iy] > 0
        distance, _ = nearest_one(obstacles, x)
        half_diagonal = 0.5 * sqrt(2.0) * n * width
        whole = distance - half_diagonal >= radius
        if not whole and n > 1 and distance + half_diagonal >= radius:
            h = n // 2
            for a in range(2):
                for b in range(2):
                    stack[top, 0], stack[top, 1], stack[top, 2] = i + a * h, j + b * h, h
                    top += 1
            continue
        if count == corner.shape[0]:
            return -1
        corner[count, 0], corner[count, 1], size[count] = i, j, n
        clearance[count] = distance
        state[count] = 0 if not seen or distance < radius else (2 if whole else 1)
        count += 1
    return count


_ROUNDING = 1e-9
"""[m] Far more than two ways to compute a distance differ by, far less than matters."""


def change_quadtree(
    old: Quadtree, surface: HeightMap, obstacles: Tree, radius: float, places: Tree | None, changed: BoolArray
) -> Quadtree:
    """The tree that `build_quadtree` makes, from the one before.

    A node's distance to the obstacles is another only if a place that changed is as near as its old distance, which a
    leaf knows, and which is less than the radius and half the diagonal where the node was split. All else is copied.

    Args:
        old: The tree before, over a surface of the same grid.
        surface: The level's ground.
        obstacles: All obstacle places now [m].
        radius: Least distance of the body's centre from any of them [m].
        places: The obstacle places that came or went [m]; None where there are none.
        changed: Cells that became known or unknown, shape (nx, ny).
    """
    extent = surface.cell_width * max(surface.height.shape)
    depth = max(0, int(np.ceil(np.log2(extent / MIN_WIDTH))))
    known = surface.state.astype(np.uint8)
    state = old.free.astype(np.uint8) + old.whole
    capacity = 2 * len(old.size) + (1 << 16)
    while True:
        corner, size = np.zeros((capacity, 2), np.int64), np.zeros(capacity, np.int64)
        clearance, fresh = np.zeros(capacity), np.zeros(capacity, np.uint8)
        count = _split_again(
            (old.size, old.clearance, state, old.code),
            (obstacles, obstacles if places is None else places, places is not None),
            (surface.origin, MIN_WIDTH, depth, radius, surface.cell_width),
            known,
            changed,
            (corner, size, clearance, fresh),
        )
        if count >= 0:
            break
        capacity *= 4
    corner, size, clearance, fresh = corner[:count], size[:count], clearance[:count], fresh[:count]
    origin = np.asarray(surface.origin, dtype=np.float64)
    return Quadtree(origin, MIN_WIDTH, corner, size, clearance, fresh > 0, fresh == 2, morton(corner))


@njit(cache=True, nogil=True)
def _split_again(
    old: tuple[IntArray, FloatArray, NDArray[np.uint8], IntArray],
    trees: tuple[Tree, Tree, bool],
    measures: tuple[FloatArray, float, int, float, float],
    known: NDArray[np.uint8],
    changed: BoolArray,
    made: tuple[IntArray, IntArray, FloatArray, NDArray[np.uint8]],
) -> int:
    """`_split` that copies what is as it was. Nodes come in Morton order; `first` is a node's first old leaf, or −1."""
    size_was, clearance_was, state_was, code_was = old
    obstacles, places, moved = trees
    origin, width, depth, radius, cell_width = measures
    corner, size, clearance, state = made
    stack, bound = np.empty((4 * depth + 4, 4), np.int64), np.empty(4 * depth + 4)
    stack[0, 0], stack[0, 1], stack[0, 2], stack[0, 3] = 0, 0, 1 << depth, 0
    bound[0] = -np.inf if moved else np.inf  # a place that changed is no nearer to the node's centre
    top, count, x = 1, 0, np.empty(2)
    while top > 0:
        top -= 1
        i, j, n, first = stack[top]
        nearest = bound[top]
        x[0], x[1] = origin[0] + (i + 0.5 * n) * width, origin[1] + (j + 0.5 * n) * width
        ix, iy = int((x[0] - origin[0]) / cell_width), int((x[1] - origin[1]) / cell_width)
        within = 0 <= ix < known.shape[0] and 0 <= iy < known.shape[1]
        half_diagonal = 0.5 * sqrt(2.0) * n * width
        leaf = first >= 0 and size_was[first] == n
        if first >= 0:
            reach = (clearance_was[first] if leaf else radius + half_diagonal) + _ROUNDING
            if nearest <= reach:
                nearest = nearest_one(places, x)[0]
            split = not leaf and nearest > reach
            copied = leaf and nearest > reach and not (within and changed[ix, iy])
        else:
            split, copied = False, False
        if copied:
            if count == len(size):
                return -1
            corner[count, 0], corner[count, 1], size[count] = i, j, n
            clearance[count], state[count] = clearance_was[first], state_was[first]
            count += 1
            continue
        distance = 0.0
        if not split:
            distance = nearest_one(obstacles, x)[0]
            split = distance - half_diagonal < radius and n > 1 and distance + half_diagonal >= radius
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
            return -1
        seen = within and known[ix, iy] > 0
        corner[count, 0], corner[count, 1], size[count] = i, j, n
        clearance[count] = distance
        state[count] = 0 if not seen or distance < radius else (2 if distance - half_diagonal >= radius else 1)
        count += 1
    return count

"""The quadtree with something more in the way: only the leaves that it touches are split again."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import sqrt

import numpy as np
from numba import njit

from gpdf_service.fields import morton
from gpdf_service.fields.traversal import nearest_at
from gpdf_service.fields.tree import make_scratch, place_of
from gpdf_service.search.layered import Layered
from gpdf_service.search.places import Places, distance_at
from gpdf_service.search.quadtree import ROUNDING, Quadtree, is_free, is_split, quarters, side_of
from gpdf_service.tiles import HeightMap
from gpdf_service.tiles.rows import is_among
from gpdf_service.tiles.surface import Cells, is_known
from gpdf_service.types import BoolArray, FloatArray, IntArray

FELT = 5.0
"""[-] Times the body's radius: obstacles further from a leaf's centre are felt by nobody, see `ways.WIDE`."""


def _both(name: str) -> cached_property[Layered]:
    """What a `Quadtree` says of each leaf, by its number; a clearance where that is near enough to matter."""
    return cached_property(lambda tree: Layered(getattr(tree.standing, name), getattr(tree.fresh, name), tree.start))


@dataclass(frozen=True)
class SplitQuadtree:
    """Leaves by number, as of a `Quadtree`: those that stand, and from `start` on the fresh ones.

    Attributes:
        standing: The quadtree of what stands.
        gone: Leaves of it that are none any more, ascending, shape (g,).
        fresh: The free leaves in their place.
        start: Number of the first fresh leaf.
    """

    standing: Quadtree
    gone: IntArray
    fresh: Quadtree
    start: int

    @property
    def origin(self) -> FloatArray:
        """Lower corner of the root [m], shape (2,)."""
        return self.standing.origin

    @property
    def width(self) -> float:
        """Width of the smallest cell [m]."""
        return self.standing.width

    corner = _both("corner")
    size = _both("size")
    half_size = _both("half_size")
    clearance = _both("clearance")
    free = _both("free")
    whole = _both("whole")

    @property
    def numbers(self) -> IntArray:
        """Of all leaves that there are."""
        stay = np.ones(len(self.standing.size), dtype=bool)
        stay[self.gone] = False
        return np.concatenate([np.flatnonzero(stay), self.start + np.arange(len(self.fresh.size))])

    @property
    def within_gone(self) -> IntArray:
        """The leaf that each fresh one was a part of, shape (f,)."""
        made: IntArray = self.gone[np.searchsorted(self.standing.code[self.gone], self.fresh.code, side="right") - 1]
        return made

    def find(self, xy: FloatArray) -> IntArray:
        """Leaf that holds each place, shape (m, 2) [m]; -1 outside the root, and where what is fresh is not free."""
        return self.find_cell(np.floor((xy - self.origin) / self.width).astype(np.int64))

    def find_one(self, xy: FloatArray) -> int:
        """`find` of a single place, shape (2,)."""
        leaf = self.standing.find_one(xy)
        return int(self.find(xy[None])[0]) if is_among(np.array([leaf]), self.gone)[0] else leaf

    def find_cell(self, cell: IntArray) -> IntArray:
        """The same of smallest cells, shape (m, 2)."""
        found = self.standing.find_cell(cell)
        lost = np.flatnonzero(is_among(found, self.gone))
        found[lost] = self._fresh_at(cell[lost])
        return found

    def _fresh_at(self, cell: IntArray) -> IntArray:
        """The fresh leaf that holds each smallest cell, shape (m, 2); −1 for none."""
        if len(self.fresh.size) == 0:
            return np.full(len(cell), -1)
        row = np.searchsorted(self.fresh.code, morton(cell), side="right") - 1
        off = cell - self.fresh.corner[row]
        held = (row >= 0) & (off >= 0).all(axis=1) & (off < self.fresh.size[row][:, None]).all(axis=1)
        return np.where(held, self.start + row, -1)

    def within(self, xy: FloatArray, reach: float) -> IntArray:
        """Leaves that meet a square of half-width `reach` [m] around a place (2,) [m]."""
        found, half = self.standing.within(xy, reach), self.fresh.half_size
        meets = (np.abs(self.fresh.center - xy) < reach + half[:, None]).all(axis=1)
        return np.concatenate([found[~is_among(found, self.gone)], self.start + np.flatnonzero(meets)])


Leaves = Quadtree | SplitQuadtree
"""What tells leaves by their numbers."""


def centers(tree: Leaves, leaves: IntArray) -> FloatArray:
    """Centres of some leaves [m], shape (m, 2)."""
    made: FloatArray = tree.origin + (tree.corner[leaves] + 0.5 * tree.size[leaves][:, None]) * tree.width
    return made


def split_again(tree: Quadtree, surface: HeightMap, places: Places, radius: float) -> tuple[IntArray, Quadtree]:
    """Leaves that what moves touches, ascending, and the free ones in their place.

    A leaf is touched if a moving place is so near to its centre that it would be split, blocked, or less roomy than it
    was, where that is felt. The tree is that of what stands, a body's centre keeps a `radius` [m] from all places.
    """
    gone = _touched(tree, places, radius)
    corner, size, clearance, whole = _split_leaves(tree, gone, places, radius, surface.arrays)
    free = np.ones(len(size), dtype=bool)
    return gone, Quadtree(tree.origin, tree.width, corner, size, clearance, free, whole, morton(corner))


@njit(cache=True, nogil=True)
def _touched(tree: Quadtree, places: Places, radius: float) -> IntArray:
    """See `split_again`; down from the root, where something may be near enough."""
    origin, width, clearance, free = tree.origin, tree.width, tree.clearance, tree.free
    found, scratch, x = [0 for _ in range(0)], make_scratch(), np.empty(2)
    stack = [(0, 0, side_of(tree), 0, len(tree.code), -np.inf)]
    while len(stack) > 0:
        i, j, n, first, last, near = stack.pop()  # what moves is as near as that, at least
        half_diagonal, is_leaf = 0.5 * sqrt(2.0) * n * width, last - first == 1
        felt = max(FELT * radius, radius + half_diagonal)
        reach = felt + half_diagonal
        if is_leaf:
            reach = min(clearance[first], felt) if free[first] else -np.inf
            if free[first] and not tree.whole[first]:  # its edges are proven by obstacles that near to places in it
                reach = max(reach, radius + 2.2 * half_diagonal)
        if near >= reach:
            continue
        x[0], x[1] = origin[0] + (i + 0.5 * n) * width, origin[1] + (j + 0.5 * n) * width
        near = nearest_at(places.moving, place_of(x), scratch)[0]
        if near >= reach:
            continue
        if is_leaf:
            found.append(first)
            continue
        h, ends, near = n // 2, quarters(tree.code, n, first, last), near - 0.5 * half_diagonal - ROUNDING
        for k in range(4):
            stack.append((i + (k >> 1) * h, j + (k & 1) * h, h, ends[k], ends[k + 1], near))
    return np.sort(np.array(found))


@njit(cache=True, nogil=True)
def _split_leaves(
    tree: Quadtree, leaves: IntArray, places: Places, radius: float, ground: Cells
) -> tuple[IntArray, IntArray, FloatArray, BoolArray]:
    """Corner, size, clearance of the free leaves in these leaves, and which are wholly free, in Morton order."""
    origin, width = tree.origin, tree.width
    found, scratch, x = [(0, 0, 0, 0.0, True) for _ in range(0)], make_scratch(), np.empty(2)
    stack = [(0, 0, 0) for _ in range(0)]
    for leaf in leaves:
        stack.append((tree.corner[leaf, 0], tree.corner[leaf, 1], tree.size[leaf]))
        while len(stack) > 0:
            i, j, n = stack.pop()
            x[0], x[1] = origin[0] + (i + 0.5 * n) * width, origin[1] + (j + 0.5 * n) * width
            half_diagonal = 0.5 * sqrt(2.0) * n * width
            near = nearest_at(places.moving, place_of(x), scratch)[0]
            if near + half_diagonal < radius:
                continue
            distance = distance_at(places, place_of(x), scratch)
            if is_split(distance, half_diagonal, radius, n):
                h = n // 2
                for k in range(3, -1, -1):
                    stack.append((i + (k >> 1) * h, j + (k & 1) * h, h))
                continue
            free, wholly = is_free(distance, half_diagonal, radius, is_known(ground, x[0], x[1]))
            if free:
                found.append((i, j, n, distance, wholly))
    corner, size = np.empty((len(found), 2), np.int64), np.empty(len(found), np.int64)
    room, whole = np.empty(len(found)), np.empty(len(found), np.bool_)
    for k in range(len(found)):
        corner[k, 0], corner[k, 1], size[k], room[k], whole[k] = found[k]
    return corner, size, room, whole

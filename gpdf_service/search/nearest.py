"""The nearest place where a body fits: down the quadtree, the nearer quarter first, past what cannot be nearer."""

from __future__ import annotations

from math import isnan, sqrt
from typing import NamedTuple

import numpy as np
from numba import njit

from gpdf_service.kernel_cache import lean
from gpdf_service.search.free_space import FreeSpace
from gpdf_service.search.quadtree import Quadtree, quarters, side_of
from gpdf_service.search.resplit import SplitQuadtree
from gpdf_service.tiles.surface import BLOCK, Cells, height_of
from gpdf_service.types import Float32Array, FloatArray, IntArray

INSIDE = 1e-6
"""[m] A place on the edge of a leaf is moved this far into it, so that rounding leaves it there."""


class _Asked(NamedTuple):
    """A place (x, y, z) [m] and how far the ground may be above or below it; the component, −1 for any."""

    x: float
    y: float
    z: float
    off: float
    component: int


def nearest_free(space: FreeSpace, place: FloatArray, off: float, component: int | None = None) -> FloatArray | None:
    """The nearest place (x, y, z of the ground) [m] where the body fits, the centre of a leaf that is not wholly free.

    Of a place (x, y, z) the ground is no further than `off` above or below it [m]. It is of the graph's `component`, if
    that is given.
    """
    z, wanted = (float(place[2]) if len(place) == 3 else np.nan), -1 if component is None else component
    asked = _Asked(float(place[0]), float(place[1]), z, off, wanted)
    found = np.array([np.nan, np.nan, np.nan, np.inf])
    grounds = [own.surface.arrays for own in space.levels]
    apart = np.abs([height_of(ground, asked.x, asked.y) - z for ground in grounds])  # NaN comes last
    for level in np.argsort(apart, kind="stable").tolist():  # what is found on the level that is there bounds the rest
        own, ground = space.levels[level], grounds[level]
        tree, first, standing = own.quadtree, own.offset, own.quadtree.standing
        of = space.graph.standing.component[first : first + len(standing.size)]
        gone = tree.gone if isinstance(tree, SplitQuadtree) else np.zeros(0, np.int64)
        _descend(standing, of, gone, (ground, own.surface.ends), asked, found)
        if isinstance(tree, SplitQuadtree) and len(tree.fresh.size):
            fresh = np.asarray(space.graph.component[first + tree.start + np.arange(len(tree.fresh.size))])
            _look_at_all(tree.fresh, fresh, ground, asked, found)
    return found[:3] if np.isfinite(found[3]) else None


@njit(cache=True, nogil=True)
def _look(tree: Quadtree, component: IntArray, leaf: int, ground: Cells, asked: _Asked, found: FloatArray) -> None:
    """Write the place of a leaf that is nearest to the one asked for and its distance, if that is less than `found`.

    Of each leaf the `component` is given, shape (k,).
    """
    if not tree.free[leaf] or (asked.component >= 0 and component[leaf] != asked.component):
        return
    half = 0.5 * tree.width * tree.size[leaf]
    x = tree.origin[0] + tree.corner[leaf, 0] * tree.width + half
    y = tree.origin[1] + tree.corner[leaf, 1] * tree.width + half
    if tree.whole[leaf]:
        half = max(half - INSIDE, 0.0)
        x, y = min(max(asked.x, x - half), x + half), min(max(asked.y, y - half), y + half)
    far = sqrt((x - asked.x) ** 2 + (y - asked.y) ** 2)
    if far >= found[3]:
        return
    z = height_of(ground, x, y)
    if isnan(z) or abs(z - asked.z) > asked.off:  # a NaN compares false: then any height will do
        return
    found[0], found[1], found[2], found[3] = x, y, z, far


@njit(cache=True, nogil=True)
def _look_at_all(tree: Quadtree, component: IntArray, ground: Cells, asked: _Asked, found: FloatArray) -> None:
    for leaf in range(len(tree.size)):
        _look(tree, component, leaf, ground, asked, found)


@njit(cache=True, nogil=True)
def _descend(
    tree: Quadtree,
    component: IntArray,
    gone: IntArray,
    on: tuple[Cells, Float32Array],
    asked: _Asked,
    found: FloatArray,
) -> None:
    """`_look` at the leaves of a tree but for those that are `gone`; a square of n × n cells is n² codes in a row.

    It is passed over where no ground has the height that is asked for, by the ends of its blocks, which come with it.
    """
    ground, ends = on
    x, y = (asked.x - tree.origin[0]) / tree.width, (asked.y - tree.origin[1]) / tree.width
    stack = [(0, 0, side_of(tree), 0, len(tree.code))]
    while len(stack) > 0:
        i, j, n, first, last = stack.pop()
        far = sqrt(max(i - x, x - i - n, 0.0) ** 2 + max(j - y, y - j - n, 0.0) ** 2) * tree.width
        if far >= found[3] or last == first:
            continue
        if last - first == 1:
            row = np.searchsorted(gone, first)
            if row == len(gone) or gone[row] != first:
                _look(tree, component, first, ground, asked, found)
            continue
        if not _is_as_high(tree, i, j, n, ground, ends, asked):
            continue
        h, part = n // 2, quarters(tree.code, n, first, last)
        nearest = 2 * int(x >= i + h) + int(y >= j + h)
        for quarter in (nearest ^ 3, nearest ^ 1, nearest ^ 2, nearest):  # the nearest one is looked at first
            stack.append((i + (quarter >> 1) * h, j + (quarter & 1) * h, h, part[quarter], part[quarter + 1]))


@lean()
def _is_as_high(tree: Quadtree, i: int, j: int, n: int, ground: Cells, ends: Float32Array, asked: _Asked) -> bool:
    """Whether ground within a cell of a square of n × n smallest cells may be as high as is asked for."""
    if isnan(asked.z):
        return True
    block, width = BLOCK * ground.width, tree.width
    x, y = tree.origin[0] - ground.origin[0] + i * width, tree.origin[1] - ground.origin[1] + j * width
    reach = n * width + ground.width
    for u in range(max(int((x - ground.width) / block), 0), min(int((x + reach) / block) + 1, ends.shape[0])):
        for v in range(max(int((y - ground.width) / block), 0), min(int((y + reach) / block) + 1, ends.shape[1])):
            if ends[u, v, 0] <= asked.z + asked.off and ends[u, v, 1] >= asked.z - asked.off:
                return True
    return False

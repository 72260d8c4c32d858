"""Stances, where a body can stand, and the strides between them: gaps, nosings and open risers need no rules of theirs.

A stance is a place on a surface that a foot stands on and where nothing is beside the body's legs and hips. A stride
joins two stances that a step parts, or a gap no wider than one steps over. A shelf's boards or a chair under a desk
are no stances, as something stands beside each of them at the height of a hip.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gpdf_service.config import PerceptionConfig
from gpdf_service.fields.threads import run_chunked
from gpdf_service.ground.foot import SECTORS, SOLE, STRIDE, sector_of
from gpdf_service.kernel_cache import lean
from gpdf_service.tiles.boxes import widened
from gpdf_service.tiles.layers import Layers
from gpdf_service.tiles.pairs import AROUND, Columns
from gpdf_service.types import BoolArray, FloatArray, IntArray

BODY = 0.2
"""[m] Radius of the disc that is free around a stance: half the width of a slim person's hips and arms."""
LEGS = 0.3, 0.7
"""[m] Over the stance where that disc is free: over the next tread, and up to the height of the lowest body that
steps, a Spot."""


def find_stances(layers: Layers, among: BoolArray) -> BoolArray:
    """Which of the nodes `among` all have nothing within `BODY` of them in plan at the height of `LEGS`, shape (k,)."""
    made, nodes = np.zeros(len(among), dtype=bool), np.flatnonzero(among)
    own = layers.columns, layers.top, BODY / layers.cell_width, made
    run_chunked(lambda a, b: _stances(nodes[a:b], *own), len(nodes))
    return made


@njit(cache=True, nogil=True)
def _chords(reach: float) -> IntArray:
    """How many cells on each side of the middle are within `reach` [cells] of it, in its row and those after it."""
    made = np.zeros(int(reach) + 1, np.int64)
    for away in range(len(made)):
        while away**2 + (made[away] + 1) ** 2 <= reach**2:
            made[away] += 1
    return made


@njit(cache=True, nogil=True)
def _stances(nodes: IntArray, columns: Columns, top: FloatArray, reach: float, made: BoolArray) -> None:
    (cell, start, (nx, ny), height, thickness), rings, wide = columns, int(reach), _chords(reach)
    for i in nodes:
        x, y, free = cell[i] // ny, cell[i] % ny, True
        low, high = height[i] + LEGS[0], height[i] + LEGS[1]
        for u in range(max(x - rings, 0), min(x + rings + 1, nx)):
            aside = wide[abs(u - x)]
            for j in range(start[u * ny + max(y - aside, 0)], start[u * ny + min(y + aside + 1, ny)]):
                free &= (top[j] <= low) | (top[j] - thickness[j] >= high)
            if not free:
                break
        made[i] = free


@njit(cache=True, nogil=True)
def find_strides(
    columns: Columns, stance: BoolArray, part: IntArray, reach: float, rise: float
) -> tuple[IntArray, IntArray]:
    """Pairs of stances of different parts, at most `reach` cells apart in plan and `rise` [m] in height.

    Of each stance at the rim of its part the nearest one of each other part is taken.
    """
    cell, start, (nx, ny), height, _ = columns
    one, other = [0 for _ in range(0)], [0 for _ in range(0)]
    rim = np.zeros(len(cell), np.bool_)
    for i in range(len(cell)):
        if stance[i]:
            rim[i] = not _inside(i, columns, stance, part)
    rings, wide = int(reach), _chords(reach)
    best, far = np.empty(64, np.int64), np.empty(64)
    for i in range(len(cell)):
        x, y, used = cell[i] // ny, cell[i] % ny, 0
        if not rim[i]:
            continue
        for u in range(x, min(x + rings + 1, nx)):  # only nodes after it are looked at
            begin = start[u * ny + max(y - wide[u - x], 0)] if u > x else i + 1
            for j in range(begin, start[u * ny + min(y + wide[u - x] + 1, ny)]):
                if not rim[j] or part[j] == part[i] or abs(height[j] - height[i]) > rise:
                    continue
                away = (u - x) ** 2 + (cell[j] - u * ny - y) ** 2
                used = _nearest(best, far, used, j, float(away), part)
        for k in range(used):
            one.append(i)
            other.append(best[k])
    return np.array(one, np.int64), np.array(other, np.int64)


@njit(cache=True, nogil=True)
def _nearest(best: IntArray, far: FloatArray, used: int, node: int, away: float, part: IntArray) -> int:
    """Keep the node if it is the nearest of its part; how many are kept."""
    for k in range(used):
        if part[best[k]] == part[node]:
            if away < far[k]:
                best[k], far[k] = node, away
            return used
    if used < len(best):
        best[used], far[used] = node, away
        return used + 1
    return used


@lean()
def _inside(i: int, columns: Columns, stance: BoolArray, part: IntArray) -> bool:
    """Whether all eight cells around a stance hold stances of its part."""
    cell, start, shape, _, _ = columns
    x, y = cell[i] // shape[1], cell[i] % shape[1]
    for dx, dy in AROUND:
        if not (0 <= x + dx < shape[0] and 0 <= y + dy < shape[1]):
            return False
        there, found = (x + dx) * shape[1] + y + dy, False
        for j in range(start[there], start[there + 1]):
            found |= stance[j] and part[j] == part[i]
        if not found:
            return False
    return True


INNER = 2.0 / (3.0 * np.pi)
"""[-] Distance of the centroid of what is seen around a place from it, over the radius: half of that at a straight rim,
where it is that of half a disc."""


def find_between(
    layers: Layers, stance: BoolArray, tread: BoolArray, asked: BoolArray, config: PerceptionConfig
) -> BoolArray:
    """Which of the nodes `asked` lie between a stance above and one below, on either side within a stride, shape (k,).

    One of the two is of a `tread`. So the rough, worn or smeared ones of a flight are ground, too: who steps from the
    one stance to the other goes over them.

    Args:
        layers: The nodes.
        stance: Which are stances of the ground, shape (k,).
        tread: Which of these are treads, shape (k,).
        asked: Shape (k,).
        config: Limits.
    """
    made, width = np.zeros(len(asked), dtype=bool), layers.cell_width
    near = np.zeros(layers.shape, dtype=bool)
    near.ravel()[layers.cell[stance & tread]] = True
    nodes = np.flatnonzero(asked & widened(near, int(STRIDE / width)).ravel()[layers.cell])
    kind, level = stance * (np.int8(1) + tread), width * float(np.tan(config.steepest))
    own = layers.columns, kind, STRIDE / width, (config.max_step, level), made
    run_chunked(lambda a, b: _between(nodes[a:b], *own), len(nodes))
    return made


@njit(cache=True, nogil=True)
def _between(
    nodes: IntArray,
    columns: Columns,
    kind: NDArray[np.int8],
    reach: float,
    limits: tuple[float, float],
    made: BoolArray,
) -> None:
    """See `find_between`; a stance is of `kind` 1, of a tread 2, and the `limits` are a step and a slope in a cell."""
    (cell, start, (nx, ny), height, _), (rise, level) = columns, limits
    rings, sides = int(reach), np.zeros((2, SECTORS), np.int8)
    for i in nodes:
        sides[:] = 0
        x, y = cell[i] // ny, cell[i] % ny
        for u in range(max(x - rings, 0), min(x + rings + 1, nx)):
            for v in range(max(y - rings, 0), min(y + rings + 1, ny)):
                if not 0 < (u - x) ** 2 + (v - y) ** 2 <= reach**2:
                    continue
                sector = sector_of(u - x, v - y)
                for j in range(start[u * ny + v], start[u * ny + v + 1]):
                    over = height[j] - height[i]
                    if kind[j] > 0 and abs(over) <= rise:
                        if over >= -level:
                            sides[0, sector] = max(sides[0, sector], kind[j] + np.int8(2) * np.int8(over > level))
                        if over <= level:
                            sides[1, sector] = max(sides[1, sector], kind[j] + np.int8(2) * np.int8(over < -level))
        for s in range(SECTORS):
            for across in range(SECTORS // 4, 3 * SECTORS // 4 + 1):
                up, down = sides[0, s], sides[1, (s + across) % SECTORS]
                treads = up == 2 or up == 4 or down == 2 or down == 4
                made[i] |= up > 0 and down > 0 and treads and (up > 2 or down > 2)


def find_footing(layers: Layers, among: BoolArray, asked: BoolArray, rise: float, need: int) -> BoolArray:
    """Which of the nodes `asked` hold a foot though a scan from far shows but some of the cells around, shape (k,).

    More than `need` of the nodes `among` are on their slope, of at most `rise` [m] a cell, within a `SOLE`; and not on
    one side of them only, as at the rim of a surface.

    Args:
        layers: The nodes.
        among: Shape (k,).
        asked: Shape (k,).
        rise: [m].
        need: Nodes.
    """
    made, nodes = np.zeros(len(asked), dtype=bool), np.flatnonzero(asked)
    own = layers.columns, among, (SOLE / layers.cell_width, rise, need), made
    run_chunked(lambda a, b: _footing(nodes[a:b], *own), len(nodes))
    return made


@njit(cache=True, nogil=True)
def _footing(
    nodes: IntArray, columns: Columns, among: BoolArray, limits: tuple[float, float, int], made: BoolArray
) -> None:
    """See `find_footing`; the `limits` are a sole in cells, the rise and the need."""
    (cell, start, (nx, ny), height, _), (reach, rise, need) = columns, limits
    rings = int(reach)
    for i in nodes:
        x, y, found, mean_x, mean_y = cell[i] // ny, cell[i] % ny, 0, 0.0, 0.0
        for u in range(max(x - rings, 0), min(x + rings + 1, nx)):
            for v in range(max(y - rings, 0), min(y + rings + 1, ny)):
                away = np.hypot(u - x, v - y)
                if away > reach + 0.5:
                    continue
                for j in range(start[u * ny + v], start[u * ny + v + 1]):
                    if among[j] and abs(height[j] - height[i]) <= rise * away:
                        found, mean_x, mean_y = found + 1, mean_x + u - x, mean_y + v - y
                        break
        made[i] = found > need and np.hypot(mean_x, mean_y) <= INNER * found * (reach + 0.5)

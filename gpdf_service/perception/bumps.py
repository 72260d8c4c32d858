"""Low things that the ground was joined up to: the feet of a chair, a bag, the base of a lamp; a lid, a box, a pallet.

A foot of 6 cm in a floor of 5 cm cells is a slope like any other. What tells it from ground is its size: it falls off
to either side within the width of a person, so nobody stands on it. A sill, or a bump across a road, does so, too, but
on and on; rough ground does so everywhere; a narrow tread leads further up. A box is wider, but narrower than a place
to go to: it falls off to either side within a landing, in a step all round, which a rise of the ground does not.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from gpdf_service.config import PerceptionConfig
from gpdf_service.fields.threads import run_chunked
from gpdf_service.perception.beside import Beside
from gpdf_service.perception.boxes import lowest_around
from gpdf_service.perception.layers import HALF, Layers
from gpdf_service.perception.nodes import components, extents_in_plan
from gpdf_service.perception.pairs import pairs_around
from gpdf_service.perception.told import Told
from gpdf_service.types import BoolArray, FloatArray, IntArray

LEAST_BUMP = 0.02
"""[m] What a wheel rolls over and a good scanner's floor may be off by."""
ROUGH = 4.0
"""[-] Over the upper quartile of the bumps around: 99 % of those of rubble are less than 3.6 of it, whatever its relief
(2 to 5 cm, correlated over 5 to 15 cm)."""
LANDING = 1.2
"""[m] What falls off to both sides and is narrower is no place to go to: a landing is 48 inches deep, by the
International Building Code, 1011.6."""
STEPPED = 0.75
"""[-] Of a box's rim, in pairs of nodes: a platform's corner has 0.65 at most, a lid in noise of a sixth of its height
0.87 at least."""
RISING = 0.05
"""[-] Of a box's rim that may lie under other ground: strays. A tread's rim has a third."""
LONG = 3.0
"""[-] Length over depth of what crosses the way, a sill or a ridge; what stands about is rounder."""


def low_things(near: Beside, ground: BoolArray, raised: FloatArray, config: PerceptionConfig) -> BoolArray:
    """Which nodes of the `ground`, shape (k,), are narrow bumps on it, and not of its own roughness, shape (k,).

    How rough it is around each bump is remembered: it stays where no ground around is another or `raised` otherwise.

    Args:
        near: The nodes.
        ground: Which are ground.
        raised: `raised_over_sides`.
        config: Limits.
    """
    layers = near.layers
    grid = layers.cell, layers.start, layers.shape, layers.height
    slope, found = layers.cell_width * float(np.tan(config.steepest)), raised > LEAST_BUMP
    nodes = np.flatnonzero(found)
    other, rough = near.felt("rough", (ground, raised)), np.full(len(ground), np.nan)
    reach = 2 * _reach(layers, config)
    pieces = _pieces(nodes, grid, found, slope)
    around = _around(nodes, *grid, ground, pieces, raised, reach, other, *(near.last("rough") or (rough,)))
    rough[nodes] = around
    near.known["rough"] = Told((ground, raised), (rough,))
    nodes = nodes[raised[nodes] > ROUGH * around]
    found = np.zeros_like(ground)
    found[nodes] = True
    if len(nodes) == 0:
        return found
    piece = _pieces(nodes, grid, found, slope)
    length, depth = extents_in_plan(layers.cell[nodes], layers.shape[1], found[nodes], piece, layers.cell_width)
    rim, steps, up = _rims(near, nodes, piece, len(depth), ground & ~found, raised, config)
    crosses = (length >= config.standing_width) & (length >= LONG * depth)
    thing = (steps > STEPPED * rim) & (up == 0) & ~crosses
    found[nodes[~thing[piece]]] = False
    return found


def _rims(
    near: Beside,
    nodes: IntArray,
    piece: IntArray,
    count: int,
    beside: BoolArray,
    raised: FloatArray,
    config: PerceptionConfig,
) -> tuple[IntArray, IntArray, IntArray]:
    """Pairs of a piece's `nodes` with those `beside` it, of them those with a step down, and those with one up."""
    height, layers = near.layers.height, near.layers
    a, b = pairs_around(nodes, layers.cell, layers.start, layers.shape, height, beside, 0.0, config.max_step)
    drop = height[nodes[a]] - height[b]
    kinds = np.isfinite(drop), drop >= 0.5 * raised[nodes[a]], drop < -LEAST_BUMP
    rim, steps, up = (np.bincount(piece[a[kind]], minlength=count) for kind in kinds)
    return rim, steps, up


def boxes(near: Beside, ground: BoolArray, config: PerceptionConfig) -> BoolArray:
    """Which nodes of the `ground`, shape (k,), are boxes and lids on it, that one could step onto, shape (k,).

    Each is higher than a slope rises in a cell, ends in a step at `STEPPED` of its rim, and leads no further up. What a
    landing's width cuts off at the corner of a platform is none: the ground goes on at two fifths of its rim.
    """
    layers, slope = near.layers, near.layers.cell_width * float(np.tan(config.steepest))
    raised = _raised_within(near, ground, slope, config.max_step)
    found: BoolArray = raised > slope
    nodes = np.flatnonzero(found)
    if len(nodes) == 0:
        return found
    grid = layers.cell, layers.start, layers.shape, layers.height
    piece = _pieces(nodes, grid, found, slope)
    depth = extents_in_plan(layers.cell[nodes], layers.shape[1], found[nodes], piece, layers.cell_width)[1]
    rim, steps, up = _rims(near, nodes, piece, len(depth), ground & ~found, raised, config)
    box = (depth >= config.standing_width) & (steps > STEPPED * rim) & (up < RISING * rim)
    found[nodes[~box[piece]]] = False
    return found


def _raised_within(near: Beside, ground: BoolArray, least: float, most: float) -> FloatArray:
    """How much higher each node of the `ground` is than that to both sides of it, within a landing's width in all [m].

    What is no more than the `least` may count for nothing; `most` is as in `raised_over_sides`.
    """
    width = max(2, int(LANDING / near.layers.cell_width))

    def answer(layers: Layers, asked: BoolArray, ground: BoolArray) -> tuple[FloatArray]:
        raised, nodes = np.zeros(len(ground)), _over_ground(layers, ground, width, least, asked)
        grid = layers.cell, layers.start, layers.shape, layers.height, ground
        run_chunked(lambda a, b: _raise_within(nodes[a:b], *grid, width, least, most, raised), len(nodes))
        return (raised,)

    return near.around("raised within", width, answer, ground)[0]


def _over_ground(layers: Layers, ground: BoolArray, reach: int, least: float, asked: BoolArray) -> IntArray:
    """Nodes `asked` of the `ground` with some lower by more than the `least` [m] within so many cells, shape (m,)."""
    nodes, lowest = np.flatnonzero(ground), np.full(layers.shape, np.inf)
    lowest.ravel()[layers.cell[nodes[::-1]]] = layers.height[nodes[::-1]]  # the last one that is written stays
    lowest = lowest_around(lowest, reach)
    nodes = nodes[asked[nodes]]
    found: IntArray = nodes[layers.height[nodes] - lowest.ravel()[layers.cell[nodes]] > least]
    return found


@njit(cache=True, nogil=True)
def _raise_within(
    nodes: IntArray,
    cell: IntArray,
    start: IntArray,
    shape: tuple[int, int],
    height: FloatArray,
    ground: BoolArray,
    width: int,
    least: float,
    most: float,
    raised: FloatArray,
) -> None:
    """Write `_raised_within` of the `nodes`: in the direction in which it is most, of all ways to share the width."""
    drop = np.zeros((2, width + 1))
    for i in nodes:
        x, y, level = cell[i] // shape[1], cell[i] % shape[1], height[i]
        for dx, dy in HALF:
            cells = width if dx * dy == 0 else int(np.sqrt(0.5) * width)
            for side in range(2):
                for k in range(1, cells):
                    u, v = x + (2 * side - 1) * k * dx, y + (2 * side - 1) * k * dy
                    drop[side, k] = max(drop[side, k - 1], _drop_to(u, v, start, shape, height, ground, level, most))
                if drop[side, cells - 1] <= max(raised[i], least):
                    break
            else:
                for k in range(1, cells):
                    raised[i] = max(raised[i], min(drop[0, k], drop[1, cells - k]))


def raised_over_sides(near: Beside, ground: BoolArray, config: PerceptionConfig) -> FloatArray:
    """How much higher each node of the `ground` is than the ground to both sides of it [m], shape (k,)."""
    reach = _reach(near.layers, config)

    def answer(layers: Layers, asked: BoolArray, ground: BoolArray) -> tuple[FloatArray]:
        raised, nodes = np.zeros(len(ground)), _over_ground(layers, ground, reach, LEAST_BUMP / ROUGH, asked)
        grid = layers.cell, layers.start, layers.shape, layers.height, ground
        run_chunked(lambda a, b: _raise(nodes[a:b], *grid, reach, config.max_step, raised), len(nodes))
        return (raised,)

    return near.around("raised", reach, answer, ground)[0]


def _reach(layers: Layers, config: PerceptionConfig) -> int:
    """Cells to either side that are as wide as half a person."""
    return max(1, int(0.5 * config.standing_width / layers.cell_width))


def _pieces(
    nodes: IntArray, grid: tuple[IntArray, IntArray, tuple[int, int], FloatArray], found: BoolArray, slope: float
) -> IntArray:
    """Connected piece of each of the `nodes`, shape (m,), which are all that are `found`, shape (k,)."""
    a, b = pairs_around(nodes, *grid, found, slope, 0.0)
    pieces: IntArray = components(a, np.searchsorted(nodes, b), found[nodes])
    return pieces


@njit(cache=True, nogil=True)
def _nearest(first: int, last: int, height: FloatArray, ground: BoolArray, level: float, most: float) -> int:
    """The ground node among those of a cell that is nearest to a level, within `most` [m], or -1."""
    best, found = most, -1
    for j in range(first, last):
        if ground[j] and abs(height[j] - level) <= best:
            best, found = abs(height[j] - level), j
    return found


@njit(cache=True, nogil=True)
def _drop_to(
    u: int,
    v: int,
    start: IntArray,
    shape: tuple[int, int],
    height: FloatArray,
    ground: BoolArray,
    level: float,
    most: float,
) -> float:
    """How much lower than a level the ground is in a cell [m]; 0 where there is none, or none within `most` [m]."""
    if not (0 <= u < shape[0] and 0 <= v < shape[1]):
        return 0.0
    there = u * shape[1] + v
    j = _nearest(start[there], start[there + 1], height, ground, level, most)
    return level - height[j] if j >= 0 else 0.0


@njit(cache=True, nogil=True)
def _raise(
    nodes: IntArray,
    cell: IntArray,
    start: IntArray,
    shape: tuple[int, int],
    height: FloatArray,
    ground: BoolArray,
    reach: int,
    most: float,
    raised: FloatArray,
) -> None:
    """How much higher each node is than the ground to both sides of it, in the direction in which that is most [m].

    What is so little that neither it nor a quartile of such tells a bump is not looked at closer.
    """
    for i in nodes:
        x, y, level = cell[i] // shape[1], cell[i] % shape[1], height[i]
        for dx, dy in HALF:
            cells = reach if dx * dy == 0 else max(1, int(np.sqrt(0.5) * reach))
            least = np.inf
            for side in (-1, 1):
                drop = 0.0
                for k in range(1, cells + 1):
                    u, v = x + side * k * dx, y + side * k * dy
                    drop = max(drop, _drop_to(u, v, start, shape, height, ground, level, most))
                least = min(least, drop)
                if least <= max(raised[i], LEAST_BUMP / ROUGH):
                    break
            else:
                raised[i] = least


@njit(cache=True, nogil=True)
def _around(
    nodes: IntArray,
    cell: IntArray,
    start: IntArray,
    shape: tuple[int, int],
    height: FloatArray,
    ground: BoolArray,
    piece: IntArray,
    raised: FloatArray,
    reach: int,
    other: BoolArray,
    before: FloatArray,
) -> FloatArray:
    """Upper quartile of what the ground is `raised` at and around the piece of each of the `nodes` [m], shape (m,).

    It is as `before`, shape (k,), where none of the cells is an `other` than then, shape (nx, ny).
    """
    box = np.empty((len(nodes), 4), np.int64)
    for n in range(len(nodes)):
        box[n] = shape[0], -1, shape[1], -1
    for n in range(len(nodes)):
        i = nodes[n]
        x, y, own = cell[i] // shape[1], cell[i] % shape[1], box[piece[n]]
        own[0], own[1], own[2], own[3] = min(own[0], x), max(own[1], x), min(own[2], y), max(own[3], y)
    made, done = np.zeros(len(nodes)), np.full(len(nodes), -1.0)
    for n in range(len(nodes)):
        i, own = nodes[n], box[piece[n]]
        if done[piece[n]] < 0.0:
            left, right = max(0, own[0] - reach), min(shape[0], own[1] + reach + 1)
            near, far = max(0, own[2] - reach), min(shape[1], own[3] + reach + 1)
            if not other[left:right, near:far].any():
                done[piece[n]] = before[i]
        if not done[piece[n]] >= 0.0:  # nor was it known
            values = []
            for x in range(left, right):
                for y in range(near, far):
                    there = x * shape[1] + y
                    j = _nearest(start[there], start[there + 1], height, ground, height[i], np.inf)
                    if j >= 0:
                        values.append(raised[j])
            done[piece[n]] = np.quantile(np.array(values), 0.75)
        made[n] = done[piece[n]]
    return made

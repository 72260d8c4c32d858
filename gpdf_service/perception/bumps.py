"""Low things that the ground was joined up to: the feet of a chair, a bag, the base of a lamp; a lid, a box, a pallet.

A foot of 6 cm in a floor of 5 cm cells is a slope like any other. What tells it from ground is its size: it falls off
to either side within the width of a person, so nobody stands on it. A sill, or a bump across a road, does so, too, but
on and on; rough ground does so everywhere; a narrow tread leads further up; a platform's corner is joined to more
ground as high. A box may be wider, but is narrower than a place to go to: it falls off to either side within a landing,
in a step all round, which a rise of the ground does not.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from gpdf_service.config import PerceptionConfig
from gpdf_service.fields.threads import run_chunked
from gpdf_service.ground.foot import SOLE
from gpdf_service.kernel_cache import lean
from gpdf_service.tiles.beside import Beside, Strips
from gpdf_service.tiles.boxes import lowest_around
from gpdf_service.tiles.layers import HALF, Layers, flat
from gpdf_service.tiles.nodes import extents_of, numbered, plan_sums, unite
from gpdf_service.tiles.pairs import AROUND, FAR, Columns, pairs_around
from gpdf_service.tiles.rows import INDEX
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
"""[-] Of a box's rim that may lie under other ground: strays. A tread has a third, a step before a door a fifth."""
LONG = 3.0
"""[-] Length over depth of what crosses the way, a sill or a ridge; what stands about is rounder. So no thing
that is narrower than a person is larger than three of a person's squares; a platform's corner is."""

_Spans = tuple[tuple[int, int], tuple[int, int]]
"""Along a row and along a diagonal: cells that each side goes on for at most, and both together."""


def low_things(near: Beside, ground: Strips, relief: FloatArray, config: PerceptionConfig) -> Strips:
    """Which nodes of the `ground` are narrow bumps on it, over its `relief`, and not of its own roughness.

    Each leads no further up, does not cross the way, and is joined to no more ground, half as high over what is beside
    it, than so narrow a thing has: a platform's corner is.

    Args:
        near: The nodes.
        ground: Which are ground.
        relief: Of the ground [m], shape (k,), or (1,) where it is the same everywhere.
        config: Limits.
    """
    layers, on, high = near.layers, flat(ground), flat(raised_over_sides(near, ground, config))
    slope = layers.cell_width * float(np.tan(config.steepest))
    nodes, most, piece = _raised(layers, LEAST_BUMP, high, slope)
    rough = most > ROUGH * _roughness(layers, nodes, piece, on, high, config)
    nodes, most = nodes[rough], most[rough]
    if len(nodes) == 0:
        return near.among("low things", nodes)
    piece = _pieces(nodes, layers.columns, slope)
    length, depth = _extents(layers, nodes, piece)
    stays = (length >= config.standing_width) & (length >= LONG * depth)
    a, drop = _drops_beside(layers, nodes, on, config)
    stays[piece[a[drop < -LEAST_BUMP]]] = True
    left, top = _tops(most, piece, ~stays)
    stays[left] = _are_places(layers, nodes[top], most[top], on, config)
    least = relief if len(relief) == 1 else relief[nodes]
    return near.among("low things", nodes[~stays[piece] & (most > least)])


def boxes(near: Beside, ground: Strips, config: PerceptionConfig) -> Strips:
    """Which nodes of the `ground` are boxes and lids on it, that one could step onto.

    Each is higher than a slope rises in a cell, ends in a step at `STEPPED` of its rim, leads no further up, and does
    not cross the way; if it is narrower than a person, it is no narrower than a sole. What a landing's width cuts off
    at the corner of a platform is none: the ground goes on at two fifths of its rim. What so narrow a thing is joined
    to at its height is of it, whether or not the scan shows ground behind.
    """
    layers, on, slope = near.layers, flat(ground), near.layers.cell_width * float(np.tan(config.steepest))
    straight = max(2, int(LANDING / layers.cell_width))
    diagonal = int(np.sqrt(0.5) * straight)
    spans = (straight - 1, straight), (diagonal - 1, diagonal)
    raised = _ask(near, "raised within", spans, (slope, config.max_step), ground)
    nodes, most, piece = _raised(layers, slope, flat(raised), slope)
    if len(nodes) == 0:
        return near.among("boxes", nodes)
    nodes, most, piece = _with_tops(layers, nodes, most, piece, on, config)
    length, depth = _extents(layers, nodes, piece)
    a, drop = _drops_beside(layers, nodes, on, config)
    rim, steps, up = (
        np.bincount(piece[a[kind]], minlength=len(depth))
        for kind in (drop < np.inf, drop >= 0.5 * most[a], drop < -LEAST_BUMP)
    )
    box, wide = (steps > STEPPED * rim) & (up < RISING * rim), depth >= config.standing_width
    narrow = box & ~wide & (depth >= SOLE) & (length < LONG * depth) & (up == 0)
    box &= wide
    left, top = _tops(most, piece, narrow)
    box[left] = ~_are_places(layers, nodes[top], most[top], on, config)
    return near.among("boxes", nodes[box[piece]])


def _are_places(
    layers: Layers, tops: IntArray, raised: FloatArray, ground: BoolArray, config: PerceptionConfig
) -> BoolArray:
    """Which pieces are joined to more ground than so narrow a thing has, by their `tops`, shape (p,); see `_from_tops`.

    That is as high as half of what these are `raised` [m], shape (p,).
    """
    return _from_tops(layers, tops, raised, ground, config)[0]


def _with_tops(
    layers: Layers, nodes: IntArray, raised: FloatArray, piece: IntArray, ground: BoolArray, config: PerceptionConfig
) -> tuple[IntArray, FloatArray, IntArray]:
    """The same, and what pieces that are no places are joined to at their height: nodes, how much, and pieces."""
    _, last = _tops(raised, piece, np.ones(int(piece.max()) + 1, dtype=bool))
    _, made = _from_tops(layers, nodes[last], raised[last], ground, config)
    made[nodes] = raised
    nodes = np.flatnonzero(made > 0.0)
    return nodes, made[nodes], _pieces(nodes, layers.columns, layers.cell_width * float(np.tan(config.steepest)))


def _from_tops(
    layers: Layers, tops: IntArray, raised: FloatArray, ground: BoolArray, config: PerceptionConfig
) -> tuple[BoolArray, FloatArray]:
    """Which `tops` are of places, shape (p,), and how much what is joined to the others is raised [m], shape (k,).

    A place has more cells than a thing that is narrower than a person, and within one around; see `LONG`.
    """
    narrow = config.standing_width / layers.cell_width
    limits = int(LANDING / layers.cell_width), int((narrow + 2.0) * (LONG * narrow + 2.0))
    made: tuple[BoolArray, FloatArray] = _join_tops(tops, layers.columns, ground, raised, limits, config.max_step)
    return made


def _tops(raised: FloatArray, piece: IntArray, asked: BoolArray) -> tuple[IntArray, IntArray]:
    """The pieces that are `asked` about, (pieces,), and of each the row of the node raised most, the last of such."""
    left, most, top = np.flatnonzero(asked), np.zeros(len(asked)), np.empty(len(asked), np.int64)
    np.maximum.at(most, piece, raised)
    rows = np.flatnonzero(raised == most[piece])
    top[piece[rows]] = rows  # the last one that is written stays
    return left, top[left]


def _raised(layers: Layers, least: float, raised: FloatArray, slope: float) -> tuple[IntArray, FloatArray, IntArray]:
    """Nodes that are raised by more than the `least` [m], shape (m,), by how much, and the piece of each."""
    nodes = np.flatnonzero(raised > least)
    return nodes, raised[nodes], _pieces(nodes, layers.columns, slope)


def _roughness(
    layers: Layers, nodes: IntArray, piece: IntArray, ground: BoolArray, raised: FloatArray, config: PerceptionConfig
) -> FloatArray:
    """Upper quartile of how much the ground is `raised` [m] around the piece of each of the `nodes`, shape (m,)."""
    first = np.unique(piece, return_index=True)[1]  # pieces are numbered by their first nodes
    boxes = _boxes_around(layers, nodes, piece, len(first), 2 * _reach(layers, config))
    made: FloatArray = _around(nodes[first], boxes, layers.columns, ground, raised)[piece]
    return made


def _ask(near: Beside, name: str, spans: _Spans, limits: tuple[float, float], ground: Strips) -> Strips:
    """How much higher each node of the `ground` is than that to both sides of it [m], within so many cells.

    What is no more than the first of the `limits` may count for nothing; what differs by more than the second is no
    ground beside it [m].
    """
    reach = spans[0][0]

    def answer(layers: Layers, asked: BoolArray, ground: BoolArray) -> tuple[FloatArray]:
        raised, nodes = np.zeros(len(ground)), _over_ground(layers, ground, reach, limits[0], asked)
        run_chunked(lambda a, b: _raise(nodes[a:b], layers.columns, ground, spans, limits, raised), len(nodes))
        return (raised,)

    return near.around(name, reach, answer, ground)[0]


def _over_ground(layers: Layers, ground: BoolArray, reach: int, least: float, asked: BoolArray) -> IntArray:
    """Nodes `asked` of the `ground` with some lower by more than the `least` [m] within so many cells, shape (m,)."""
    nodes, lowest = np.flatnonzero(ground), np.full(layers.shape, np.inf)
    lowest.ravel()[layers.cell[nodes[::-1]]] = layers.height[nodes[::-1]]  # the last one that is written stays
    lowest = lowest_around(lowest, reach)
    nodes = nodes[asked[nodes]]
    found: IntArray = nodes[layers.height[nodes] - lowest.ravel()[layers.cell[nodes]] > least]
    return found


def _boxes_around(layers: Layers, nodes: IntArray, piece: IntArray, count: int, by: int) -> IntArray:
    """First row and behind the last, first column and behind the last, within `by` cells of each piece, (count, 4)."""
    boxes = np.empty((count, 4), np.int64)
    for axis, (place, size) in enumerate(zip(divmod(layers.cell[nodes], layers.shape[1]), layers.shape, strict=True)):
        low, high = np.full(count, size), np.zeros(count, np.int64)
        np.minimum.at(low, piece, place)
        np.maximum.at(high, piece, place)
        boxes[:, 2 * axis], boxes[:, 2 * axis + 1] = np.maximum(low - by, 0), np.minimum(high + by + 1, size)
    return boxes


def raised_over_sides(near: Beside, ground: Strips, config: PerceptionConfig) -> Strips:
    """How much higher each node of the `ground` is than the ground to both sides of it [m]."""
    limits = LEAST_BUMP / ROUGH, config.max_step  # less tells no bump, and nor does a quartile of such
    straight = _reach(near.layers, config)
    diagonal = max(1, int(np.sqrt(0.5) * straight))
    return _ask(near, "raised", ((straight, 2 * straight), (diagonal, 2 * diagonal)), limits, ground)


def _reach(layers: Layers, config: PerceptionConfig) -> int:
    """Cells to either side that are as wide as half a person."""
    return max(1, int(0.5 * config.standing_width / layers.cell_width))


@njit(cache=True, nogil=True)
def _pieces(nodes: IntArray, columns: Columns, slope: float) -> IntArray:
    """Connected piece of each of the `nodes`, shape (m,), ascending, by slopes of so much a cell [m]."""
    cell, start, (nx, ny), height, _ = columns
    row, parent = np.full(len(cell), -1, INDEX), np.arange(len(nodes)).astype(INDEX)
    for n in range(len(nodes)):
        row[nodes[n]] = n
    for n in range(len(nodes)):
        i = nodes[n]
        x, y = divmod(cell[i], ny)
        for k in range(4, 8):  # half of those around: each pair once
            u, v, most = x + AROUND[k][0], y + AROUND[k][1], slope * FAR[k]
            if u < nx and 0 <= v < ny:
                for j in range(start[u * ny + v], start[u * ny + v + 1]):
                    if row[j] >= 0 and abs(height[i] - height[j]) <= most:
                        unite(parent, n, row[j])
    return numbered(parent)


def _extents(layers: Layers, nodes: IntArray, piece: IntArray) -> tuple[FloatArray, FloatArray]:
    """Length and depth of each piece of the `nodes` in plan, shape (pieces,) [m]."""
    sums = plan_sums(layers.cell[nodes], layers.shape[1], np.ones(len(nodes), dtype=bool), piece, int(piece.max()) + 1)
    return extents_of(sums, layers.cell_width)


def _drops_beside(
    layers: Layers, nodes: IntArray, ground: BoolArray, config: PerceptionConfig
) -> tuple[IntArray, FloatArray]:
    """Other `ground` beside the `nodes` and within a step of them: row of the node, and how much lower it is [m]."""
    others = ground.copy()
    others[nodes] = False
    a, b = pairs_around(nodes, layers.columns, others, 0.0, config.max_step)
    return a, layers.height[nodes[a]] - layers.height[b]


@lean()
def _nearest(there: int, columns: Columns, ground: BoolArray, level: float, most: float) -> int:
    """The ground node among those of a cell that is nearest to a level, within `most` [m], or -1."""
    best, found = most, -1
    for j in range(columns.start[there], columns.start[there + 1]):
        if ground[j] and abs(columns.height[j] - level) <= best:
            best, found = abs(columns.height[j] - level), j
    return found


@lean()
def _drop_to(u: int, v: int, columns: Columns, ground: BoolArray, level: float, most: float) -> float:
    """How much lower than a level the ground is in a cell [m]; 0 where there is none, or none within `most` [m]."""
    nx, ny = columns.shape
    if not (0 <= u < nx and 0 <= v < ny):
        return 0.0
    j = _nearest(u * ny + v, columns, ground, level, most)
    return level - columns.height[j] if j >= 0 else 0.0


@njit(cache=True, nogil=True)
def _raise(
    nodes: IntArray, columns: Columns, ground: BoolArray, spans: _Spans, limits: tuple[float, float], raised: FloatArray
) -> None:
    """See `_ask`: in the direction in which it is most, of all ways to share the width of a span."""
    (enough, most), ny, drop = limits, columns.shape[1], np.zeros((2, spans[0][0] + 1))
    for i in nodes:
        x, y, level = columns.cell[i] // ny, columns.cell[i] % ny, columns.height[i]
        for dx, dy in HALF:
            reach, width = spans[abs(dx * dy)]
            for side in range(2):
                for k in range(1, reach + 1):
                    u, v = x + (2 * side - 1) * k * dx, y + (2 * side - 1) * k * dy
                    drop[side, k] = max(drop[side, k - 1], _drop_to(u, v, columns, ground, level, most))
                if drop[side, reach] <= max(raised[i], enough):
                    break
            else:
                for k in range(width - reach, reach + 1):
                    raised[i] = max(raised[i], min(drop[0, k], drop[1, width - k]))


@njit(cache=True, nogil=True)
def _around(first: IntArray, boxes: IntArray, columns: Columns, ground: BoolArray, raised: FloatArray) -> FloatArray:
    """Upper quartile of what the ground in each of the boxes (m, 4) is `raised` at [m], as its `first` node sees it."""
    made, ny = np.empty(len(first)), columns.shape[1]
    for n in range(len(first)):
        level, (left, right, near, far) = columns.height[first[n]], boxes[n]
        values, used, even = np.empty((right - left) * (far - near)), 0, 0
        for x in range(left, right):
            for y in range(near, far):
                j = _nearest(x * ny + y, columns, ground, level, np.inf)
                if j >= 0:
                    values[used], used, even = raised[j], used + 1, even + int(raised[j] == 0.0)
        made[n] = np.quantile(values[:used], 0.75) if even <= np.ceil(0.75 * (used - 1)) else 0.0
    return made


@njit(cache=True, nogil=True)
def _join_tops(
    nodes: IntArray, columns: Columns, ground: BoolArray, raised: FloatArray, limits: tuple[int, int], most: float
) -> tuple[BoolArray, FloatArray]:
    """Which of the nodes are joined to more cells than the second of the `limits`, within the first, shape (m,).

    That is ground half as high as the node is `raised` or higher, by `most` at most [m], with the cells beside it, for
    between the rings of a scan are cells without a point. What is joined to any other node, and nearly as high, is
    raised as much: how much, shape (k,). Not so where it goes on upwards: that is a tread.
    """
    many, made, reach = np.zeros(len(nodes), np.bool_), np.zeros(len(ground)), limits[0]
    width = 2 * reach + 1
    space = np.empty((width, width), np.bool_), np.empty((width * width, 2), np.int64), np.empty(width**2, np.int64)
    for n in range(len(nodes)):
        top = columns.height[nodes[n]]
        found, met = _flood(nodes[n], columns, ground, (top - 0.5 * raised[n], most), space, limits[1])
        many[n], cells = met > limits[1], space[2][:found]
        if many[n] or columns.height[cells].max() > top + LEAST_BUMP:
            continue
        for i in cells:
            if columns.height[i] > top - 0.25 * raised[n]:
                made[i] = max(made[i], raised[n])
    return many, made


_Space = tuple[BoolArray, IntArray, IntArray]
"""Cells within a reach: which were met, (w, w), which are asked, (w², 2), and their nodes, (w²,)."""


@lean()
def _flood(
    node: int, columns: Columns, ground: BoolArray, ends: tuple[float, float], space: _Space, enough: int
) -> tuple[int, int]:
    """Write into the `space` what ground, joined to a node, is at least as high, and within how much more; how many.

    Both are the `ends` [m]. And how many cells with those beside them; where these are more than `enough`, not all.
    """
    (nx, ny), (least, most), (seen, asked, joined) = columns.shape, ends, space
    width = len(seen)
    left, near = columns.cell[node] // ny - width // 2, columns.cell[node] % ny - width // 2
    seen[:] = False
    seen[width // 2, width // 2] = True
    asked[0] = width // 2
    at, count, found = 0, 1, 0
    while at < count <= enough:
        x, y = asked[at]
        at += 1
        there = _nearest((left + x) * ny + near + y, columns, ground, least + 0.5 * most, 0.5 * most)
        if there < 0:
            continue
        joined[found] = there
        found += 1
        for u in range(max(x - 1, 0, -left), min(x + 2, width, nx - left)):
            for v in range(max(y - 1, 0, -near), min(y + 2, width, ny - near)):
                if not seen[u, v]:
                    seen[u, v] = True
                    asked[count] = u, v
                    count += 1
    return found, count

"""Parts of the ground, the strides that join them, and which of them are ground: what one can walk to and turn on."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from gpdf_service.config import PerceptionConfig
from gpdf_service.errors import NoGroundError
from gpdf_service.ground.foot import HALF_FOOT, SOLE, STRIDE
from gpdf_service.perception.bumps import LANDING
from gpdf_service.perception.strides import find_strides
from gpdf_service.tiles.beside import Answer, Beside, Strips
from gpdf_service.tiles.layers import HALF, Layers, Pairs, connect, flat, steady
from gpdf_service.tiles.nearest import nearest_of
from gpdf_service.tiles.nodes import (
    components,
    extents_of,
    nodes_over,
    plan_sums,
    rises_beside,
)
from gpdf_service.tiles.pieces import Pieces, find_pieces
from gpdf_service.types import BoolArray, FloatArray, IntArray

OVER_SHARE = 0.2
"""Share of a part that may lie over other ground: a scan's stray points, not a table."""
TABLE_OVER_SHARE = 0.05
"""The same of what is no larger than a table, or narrower than a landing, and leads no further up."""
TABLE_AREA = 4.0
"""[m²] Furniture is no larger than a conference table for eight."""
ROOM_AREA = 6.5
"""[m²] No storey is smaller than the least room that one may live in, by the International Residential Code, R304."""
BULK_SHARE = 0.3
"""Of the largest ground that has nothing below most of it (a ceiling has): what is smaller is not the floor that one
starts from."""
COVERED_SHARE = 0.5
"""Of an upper storey that has a ceiling over it: tall furniture stands on the rest, or a roof window is over it."""


@dataclass(frozen=True, slots=True)
class Parts:
    """Sets of flat nodes that slopes join; nodes of none have the number after the last, which counts for nothing.

    Attributes:
        name: Of what is asked of them.
        pieces: Part of each node.
        flat: Which nodes are in one.
        keep: Which of these have headroom to step.
        inner: Which nodes have all eight neighbours on their slope: they say whether a part lies over ground.
        size: How many nodes with headroom each part has, shape (parts + 1,).
        depth: Of each part in plan, across its length [m], shape (parts + 1,).
        standable: Which a body stands on by itself: the others are treads, shape (parts + 1,).
        level: Mean height [m], shape (parts + 1,).
        rise: Between two neighbouring cells of a part at most [m].
    """

    name: str
    pieces: Pieces
    flat: Strips
    keep: Strips
    inner: Strips
    size: IntArray
    depth: FloatArray
    standable: BoolArray
    level: FloatArray
    rise: float

    def counts(self, name: str, *kinds: Strips) -> IntArray:
        """How many nodes of each of the `kinds` each part has, shape (kinds, parts + 1)."""
        counts = self.pieces.counts(f"{name} of {self.name}", *kinds)
        return np.column_stack([counts, np.zeros(len(counts), np.int64)])


def share(held: IntArray, all_: IntArray) -> FloatArray:
    """For how many of all nodes of a part it is so, shape (parts + 1,)."""
    made: FloatArray = held / np.maximum(all_, 1)
    return made


def build_parts(
    near: Beside, name: str, flat: Strips, keep: Strips, inner: Strips, rise: float, config: PerceptionConfig
) -> Parts:
    """The parts that slopes of at most `rise` [m] a cell make of the `flat` nodes."""
    layers, pieces = near.layers, find_pieces(near, name, flat, rise)
    room = near.each(f"room of {name}", np.logical_and, flat, keep)

    def add(own: slice, label: IntArray, labels: int, room: BoolArray) -> FloatArray:
        plan = plan_sums(layers.cell[own], layers.shape[1], room, label, labels)
        height = np.bincount(label, layers.height[own], labels)
        return np.column_stack([np.bincount(label, minlength=labels), height, plan])

    sums = np.pad(pieces.totals(name, add, room), ((0, 1), (0, 0)))
    size, depth = sums[:, 2].astype(np.int64), extents_of(sums[:, 2:], layers.cell_width)[1]
    standable, level = (depth >= config.standing_width) & (size > 0), sums[:, 1] / np.maximum(sums[:, 0], 1.0)
    return Parts(name, pieces, flat, room, inner, size, depth, standable, level, rise)


def join_parts(near: Beside, parts: Parts, stance: Strips, config: PerceptionConfig) -> Pairs:
    """Pairs of parts that a stride between their stances joins.

    What is no larger than a table counts as high as it is in the mean, unless it is on a way between storeys: a sofa's
    low front edge must not make its back a platform, but treads that a scan ran into one are a flight.
    """
    reach, pieces = STRIDE / near.layers.cell_width, parts.pieces

    def strides(layers: Layers, stance: BoolArray, part: IntArray) -> Pairs:
        found: Pairs = find_strides(layers.columns, stance, part, reach, config.max_step)
        return found

    layers, names = near.layers, steady(near.layers, pieces.start)
    named = pieces.chosen(f"names of {parts.name}", names)
    nodes = near.joins(f"strides of {parts.name}", int(reach) + 1, strides, stance, named)
    one, other = (pieces.at(each) for each in nodes)
    count, heights = len(parts.size), [layers.height[each] for each in nodes]
    small = parts.size * layers.cell_width**2 <= TABLE_AREA
    high, low = (
        np.where(small[part], parts.level[part], height) for part, height in zip((one, other), heights, strict=True)
    )
    key = np.minimum(one, other) * count + np.maximum(one, other)
    pairs, rows = np.unique(key, return_inverse=True)
    level = np.bincount(rows, np.abs(high - low) <= config.max_step, len(pairs)) > 0
    one, other = np.divmod(pairs, count)
    good = level | _between_storeys(parts, (one, other), small, config.max_step)
    return one[good], other[good]


def _between_storeys(parts: Parts, joins: Pairs, small: BoolArray, step: float) -> BoolArray:
    """Which joins are of `small` parts that lead from one large part to another which is more than a `step` higher."""
    count = len(small)
    cluster, ends = components(*joins, small), np.array([np.inf, -np.inf])[:, None] * np.ones(count)
    for one, other in (joins, joins[::-1]):
        edge = small[one] & ~small[other]
        np.minimum.at(ends[0], cluster[one[edge]], parts.level[other[edge]])
        np.maximum.at(ends[1], cluster[one[edge]], parts.level[other[edge]])
    leads = np.where(np.isfinite(ends[0]), ends[1] - ends[0], 0.0) > step
    a, b = joins
    made: BoolArray = (leads[cluster[a]] & small[a]) | (leads[cluster[b]] & small[b])
    return made


def accept_parts(
    near: Beside, parts: Parts, joins: Pairs, nodes: tuple[Strips, Strips, Strips], config: PerceptionConfig
) -> BoolArray:
    """Which parts are ground, shape (parts + 1,): what strides join to the bulk, and storeys by themselves.

    Parts that lead nowhere are dropped, one after another: a box or a board that is joined to the floor alone, and a
    table, which lies over ground, with headroom or without, and from which one gets down alone, or to a box. Of the
    `nodes` it is told which are level enough, which have headroom to step, and which are undersides.
    """
    alive, layers = parts.size > 0, near.layers
    table, dead = _tables(near, parts, joins, nodes, config), alive
    largest = TABLE_AREA / layers.cell_width**2
    while dead.any():
        dead = _dead_ends(parts, joins, alive, table, largest)
        alive = alive & ~dead
    if not alive.any():
        return alive
    group, bulk = _bulk(near, parts, joins, alive, config)
    main = alive & (group == bulk)
    accepted: BoolArray = main | (alive & _apart(near, parts, group, main, config)[group])
    return accepted


def without_crumbs(layers: Layers, parts: Parts, joins: Pairs) -> Parts:
    """The parts of a noisy cloud but for treads, with their fragments, too small for half a foot.

    Noise lifts and sinks single cells at the rim of a seat, and each would be a tread up to it.
    """
    unit = _units(parts, joins, (parts.size > 0) & ~parts.standable)
    area = np.bincount(unit, parts.size, len(unit)) * layers.cell_width**2
    return replace(parts, size=np.where(area[unit] < HALF_FOOT, 0, parts.size))


def _units(parts: Parts, joins: Pairs, among: BoolArray) -> IntArray:
    """Number of what each part belongs to, shape (parts + 1,): those `among` all that are level and joined are one.

    Fragments of a tread are a tread, tables that stand together a table.
    """
    a, b = joins
    same = np.abs(parts.level[a] - parts.level[b]) <= parts.rise
    unit: IntArray = components(a[same], b[same], among)
    return unit


def _tables(
    near: Beside, parts: Parts, joins: Pairs, nodes: tuple[Strips, Strips, Strips], config: PerceptionConfig
) -> BoolArray:
    """Parts higher than one that they are joined to, and over ground with less headroom than a step's, (parts + 1,).

    Looked at is a sole from the rim, which is as far in as one sees the floor below a board; the rim by itself, as one
    cell of it may hold both grounds of a step. Only what is narrower than a landing is one by its rim.
    """
    high = np.zeros(len(parts.size), dtype=bool)
    for one, other in (joins, joins[::-1]):
        high[one[parts.level[one] - parts.level[other] > parts.rise]] = True
    width = near.layers.cell_width
    soles = max(1, round(SOLE / width))

    def rims(layers: Layers, _: BoolArray, high: BoolArray, room: BoolArray, *nodes: BoolArray) -> Answer:
        core, keep, under = nodes
        own, ground = room & high, room | (core & ~keep & ~under)
        a, b = connect(layers, own, parts.rise)
        rim = own & (np.bincount(a, minlength=len(own)) + np.bincount(b, minlength=len(own)) < 2 * len(HALF))
        inner, lies = rim.copy(), np.zeros(len(own), dtype=bool)
        for _ring in range(soles):
            inner[np.concatenate([a[inner[b]], b[inner[a]]])] = True
        rows = np.flatnonzero(inner)
        lies[rows] = nodes_over(rows, layers.cell, layers.height, ground, config.step_headroom)
        inner &= ~rim
        return rim, rim & lies, inner, inner & lies

    asked = parts.pieces.chosen("high", high), parts.keep, *nodes
    rim, rim_over, inner, inner_over = parts.counts("rims", *near.around("rims", soles + 1, rims, *asked))
    narrow, inside = parts.depth < LANDING, share(inner_over, inner)
    small = narrow | (parts.size * width**2 <= TABLE_AREA)
    table: BoolArray = inside > np.where(small, TABLE_OVER_SHARE, OVER_SHARE)
    table |= narrow & (share(rim_over, rim) > OVER_SHARE)
    return table


def _bulk(near: Beside, parts: Parts, joins: Pairs, alive: BoolArray, config: PerceptionConfig) -> tuple[IntArray, int]:
    """The group of each part, and which group is the ground that one starts from: the lowest of the large ones.

    What mostly lies over something is a storey, and only the bulk where there is nothing else. A ceiling is never: it
    lies over something more than a step below, as large as half a foot, which reflections are not, and nothing rises
    from it as walls do from a floor. Shelves hide most of a shop's floor from who scans it, and nothing of its ceiling.

    Raises:
        NoGroundError: there are but ceilings.
    """
    group, reach = components(*joins, alive), int(HALF_FOOT / near.layers.cell_width**2) + 1  # as long is as large
    told = partial(_over_and_under, parts=parts, step=config.max_step)
    kinds = near.around("bulk", reach, told, parts.keep, parts.inner)
    room, over, inner, inner_over, inner_hangs, rises = parts.counts("bulk", parts.keep, *kinds)
    size = np.bincount(group, parts.size * alive)
    lies, within, hangs = (
        np.bincount(group, share * parts.size * alive)
        for share in (share(over, room), share(inner_over, inner), share(inner_hangs, inner))
    )
    asked = (hangs > 0.0) & (size >= BULK_SHARE * size.max())
    risen = np.bincount(group, rises * alive)
    ceiling = asked & (risen < OVER_SHARE * within)
    if not (size > 0)[~ceiling].any():
        raise NoGroundError("ground", "all that is level and wide enough is a ceiling", "Was the floor scanned?")
    own = np.where(ceiling | (2 * lies >= size), 0, size)
    own = own if own.any() else np.where(ceiling, 0, size)
    large = np.flatnonzero((own > 0) & (own >= BULK_SHARE * own.max()))
    if len(large) == 1:
        return group, int(large[0])
    nodes = np.concatenate(parts.keep)
    of_node, height = group[parts.pieces.whole[nodes]], near.layers.height[nodes]
    return group, int(min(large, key=lambda i: float(np.median(height[of_node == i]))))


def _over_and_under(
    layers: Layers, asked: BoolArray, room: BoolArray, inner: BoolArray, parts: Parts, step: float
) -> Answer:
    """Of nodes with `room` which lie over another one, which are `inner` ones, and which of these lie over some.

    Further, which of these lie over something more than a `step` [m] below that is as large as half a foot, and from
    which nodes something rises by more than a step, or beside them.
    """
    over = room & np.r_[False, layers.cell[1:] == layers.cell[:-1]]
    hangs = over.copy()
    hangs[1:] &= np.diff(layers.height) > step
    piece = components(*connect(layers, hangs, parts.rise), hangs)
    hangs &= (np.bincount(piece, hangs) * layers.cell_width**2 >= HALF_FOOT)[piece]
    rises, nodes = np.zeros(len(room), dtype=bool), np.flatnonzero(room & asked)
    rises[nodes] = rises_beside(nodes, layers.columns, layers.top, step)
    inner = room & inner
    return over, inner, inner & over, inner & hangs, rises


def _dead_ends(parts: Parts, joins: Pairs, alive: BoolArray, table: BoolArray, largest: float) -> BoolArray:
    """Parts that lead nowhere, shape (parts + 1,).

    A tread joins ground above to ground below, a sill joins two floors, and what is level with a floor is of it.
    Fragments of one tread beside each other count as one, and so do a table's. A `table` is what a body stands on, but
    leads no further up: one gets over it to a crate beside a board, or to a chest, and not on from there. Nor does
    what joins it to the floor alone.
    """
    both, count = alive[joins[0]] & alive[joins[1]], len(alive)
    (a, b), narrow, table = (end[both] for end in joins), alive & ~parts.standable, alive & parts.standable & table
    unit = _units(parts, joins, alive & (table | (parts.size <= largest)))
    one, other = np.concatenate([unit[a], unit[b]]), np.concatenate([unit[b], unit[a]])
    one, other = np.divmod(np.unique((one * count + other)[one != other]), count)
    high, stands = np.zeros(count), np.zeros(count, dtype=bool)
    high[unit] = parts.level  # those of a unit are level
    stands[unit[alive & parts.standable]] = True
    rise = high[one] - high[other]
    size, tables = (np.bincount(unit, parts.size * kind, count) for kind in (alive, table))
    table = 2 * tables >= size
    joined, below, floors, goes_on = (
        np.bincount(one[kind], minlength=count)
        for kind in (
            one >= 0,
            rise > parts.rise,
            (stands & ~table)[other],
            stands[other] & (np.abs(rise) <= parts.rise),
        )
    )
    leads = (goes_on > 0) | ((joined >= 2) & ((below < joined) | (floors >= 2)))
    peak = stands & (below == joined) & (size <= largest)
    nowhere = np.bincount(one[peak[other]], minlength=count) + below >= joined
    dead: BoolArray = alive & np.where(table[unit], nowhere[unit], narrow & ~leads[unit])
    return dead


def _apart(near: Beside, parts: Parts, group: IntArray, main: BoolArray, config: PerceptionConfig) -> BoolArray:
    """Which groups are ground by themselves, though no way to them was seen, shape (groups,).

    They are larger than furniture, and the ground that one starts from is not close below them. What is within a step
    of the ground beside it goes on behind a shelf or a fence. A storey is under a ceiling, and either vast or the level
    floor of a room high over the ground beside it, which a tree's crown is not. What is open, and in whose cells that
    ground is not, is a pit, a track bed or a court where it is lower than the ground beside it, and a platform where it
    is vast and lower than a roof that people live under.
    """
    layers, count = near.layers, int(group.max()) + 1
    size = np.bincount(group, parts.size, count).astype(np.int64)
    area, vast = size * layers.cell_width**2, size >= BULK_SHARE * size[group[main]].max()
    large = area > TABLE_AREA
    large[np.append(group[main], group[-1])] = False
    if not large.any():
        return large
    ground, told = parts.pieces.chosen("main", main), partial(_over_and_open, headroom=config.storey_headroom)
    kinds = parts.counts("apart", *near.around("apart", 0, told, parts.keep, ground))
    under, over, beside = (np.bincount(group, each, count) for each in kinds)
    large &= over <= OVER_SHARE * size
    storey, open_ = under >= COVERED_SHARE * size, beside >= (1.0 - OVER_SHARE) * size
    sure: BoolArray = large & storey & vast
    asked = large & (open_ | storey) & ~sure
    if not asked.any():
        return sure
    even, sunk, low, lofty = _over_main(near, parts, group, ground, asked, config)
    storey &= lofty & (area >= ROOM_AREA)
    found: BoolArray = sure | (asked & (even | storey | (open_ & (sunk | vast & low))))
    return found


def _over_main(
    near: Beside, parts: Parts, group: IntArray, ground: Strips, asked: BoolArray, config: PerceptionConfig
) -> list[BoolArray]:
    """Of the groups that are `asked` about which are within a step of the main `ground` beside them, and below it.

    Further, which are lower over it than a storey, and which are level and no lower than that; shape (groups,).
    """
    layers, step, there = near.layers, config.max_step, parts.pieces.chosen("asked apart", asked[group])
    keep = flat(parts.keep)
    nodes = np.flatnonzero(keep & flat(there))
    height, own, middle = layers.height[nodes], group[parts.pieces.at(nodes)], np.zeros(len(asked))
    ours = np.flatnonzero(keep & flat(ground))
    rise = height - _beside(layers, ours, layers.cell[nodes])
    for k in np.flatnonzero(asked):
        middle[k] = np.median(height[own == k])
    level, tall = np.abs(height - middle[own]) <= step, rise >= config.storey_headroom
    size = np.maximum(np.bincount(group, parts.size, len(asked)).astype(np.int64), 1)
    kinds = np.abs(rise) <= step, rise < -step, rise < config.storey_headroom, level & tall
    return [np.bincount(own[kind], minlength=len(asked)) / size >= 1.0 - OVER_SHARE for kind in kinds]


def _over_and_open(layers: Layers, _: BoolArray, room: BoolArray, main: BoolArray, headroom: float) -> Answer:
    """Of nodes with `room` which have a ceiling over them, and which lie over the `main` ground, or in no cell of it.

    Over it with less than the `headroom` [m].
    """
    ours, nodes, over = room & main, np.flatnonzero(room), np.zeros(len(room), dtype=bool)
    over[nodes] = nodes_over(nodes, layers.cell, layers.height, ours, headroom)
    under = room & (layers.headroom >= headroom) & np.isfinite(layers.headroom)
    return under, over, room & ~_holding(layers, ours)[layers.cell]


def _holding(layers: Layers, ours: BoolArray | IntArray) -> BoolArray:
    """Which cells hold one of `ours`, shape (cells,)."""
    holds = np.zeros(len(layers.start) - 1, dtype=bool)
    holds[layers.cell[ours]] = True
    return holds


def _beside(layers: Layers, ours: IntArray, cells: IntArray) -> FloatArray:
    """Height of the highest of the nodes `ours` in the nearest cell to each of the `cells` that holds one [m], (m,)."""
    high = np.zeros(len(layers.start) - 1)
    high[layers.cell[ours]] = layers.height[ours]  # the highest: nodes are sorted by their height in a cell
    made: FloatArray = high[nearest_of(_holding(layers, ours).reshape(layers.shape))[1].ravel()[cells]]
    return made

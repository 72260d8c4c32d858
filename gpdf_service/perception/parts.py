"""Parts of the ground, the strides that join them, and which of them are ground: what one can walk to and turn on."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from gpdf_service.config import PerceptionConfig
from gpdf_service.errors import NoGroundError
from gpdf_service.perception.beside import Beside
from gpdf_service.perception.bumps import LANDING
from gpdf_service.perception.layers import HALF, Layers, Pairs, connect, steady
from gpdf_service.perception.nodes import (
    components,
    counts_of,
    extents_in_plan,
    nodes_over,
    numbered_among,
    rises_beside,
    sizes_and_means,
    touched_by,
)
from gpdf_service.perception.pairs import pairs_within
from gpdf_service.perception.strides import HALF_FOOT, SOLE, STRIDE, find_strides
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
        label: Part of each node, shape (k,).
        flat: Which nodes are in one, shape (k,).
        keep: Which of these have headroom to step, shape (k,).
        inner: Which have all eight neighbours on their slope: they say whether a part lies over ground, shape (k,).
        over: Which nodes have another one below them in their cell, shape (k,).
        size: How many nodes with headroom each part has, shape (parts + 1,).
        depth: Of each part in plan, across its length [m], shape (parts + 1,).
        standable: Which a body stands on by itself: the others are treads, shape (parts + 1,).
        level: Mean height [m], shape (parts + 1,).
        rise: Between two neighbouring cells of a part at most [m].
    """

    label: IntArray
    flat: BoolArray
    keep: BoolArray
    inner: BoolArray
    over: BoolArray
    size: IntArray
    depth: FloatArray
    standable: BoolArray
    level: FloatArray
    rise: float

    def share(self, true: BoolArray, among: BoolArray) -> FloatArray:
        """Of the nodes `among` all of each part, for how many it is `true`, shape (parts + 1,)."""
        held, all_ = counts_of(self.label, true, among, len(self.size))
        made: FloatArray = held / np.maximum(all_, 1)
        return made


def build_parts(
    near: Beside, flat: BoolArray, keep: BoolArray, inner: BoolArray, rise: float, config: PerceptionConfig
) -> Parts:
    """The parts that slopes of at most `rise` [m] a cell make of the `flat` nodes, shape (k,)."""
    layers = near.layers
    label, count = numbered_among(near.pieces(flat, rise)[0], flat)
    room = flat & keep
    size, level = sizes_and_means(label, room, layers.height, count + 1)
    depth = extents_in_plan(layers.cell, layers.shape[1], room, label, layers.cell_width)[1]
    depth = np.pad(depth, (0, count + 1 - len(depth)))
    over = np.r_[False, layers.cell[1:] == layers.cell[:-1]]
    standable = (depth >= config.standing_width) & (size > 0)
    return Parts(label, flat, room, inner, over, size, depth, standable, level, rise)


def join_parts(near: Beside, parts: Parts, stance: BoolArray, config: PerceptionConfig) -> Pairs:
    """Pairs of parts that a stride between their stances joins.

    What is no larger than a table counts as high as it is in the mean, unless it is on a way between storeys: a sofa's
    low front edge must not make its back a platform, but treads that a scan ran into one are a flight.
    """
    layers, reach = near.layers, STRIDE / near.layers.cell_width

    def strides(layers: Layers, _: BoolArray, stance: BoolArray, part: IntArray) -> Pairs:
        found: Pairs = find_strides(layers.columns, stance, part, reach, config.max_step)
        return found

    a, b = near.pairs_around("strides", int(reach) + 1, strides, stance, steady(layers, parts.label))
    count, one, other = len(parts.size), parts.label[a], parts.label[b]
    small = parts.size * layers.cell_width**2 <= TABLE_AREA
    high, low = (np.where(small[part], parts.level[part], layers.height[node]) for part, node in ((one, a), (other, b)))
    key = np.minimum(one, other) * count + np.maximum(one, other)
    pairs, rows = np.unique(key, return_inverse=True)
    level = np.bincount(rows, np.abs(high - low) <= config.max_step, len(pairs)) > 0
    one, other = np.divmod(pairs, count)
    good = level | _between_storeys(parts, (one, other), small, config.max_step)
    return one[good], other[good]


def _between_storeys(parts: Parts, joins: Pairs, small: BoolArray, step: float) -> BoolArray:
    """Which joins are of `small` parts that lead from one large part to another which is more than a `step` higher."""
    count = len(small)
    cluster, ends = _groups(joins, small), np.array([np.inf, -np.inf])[:, None] * np.ones(count)
    for one, other in (joins, joins[::-1]):
        edge = small[one] & ~small[other]
        np.minimum.at(ends[0], cluster[one[edge]], parts.level[other[edge]])
        np.maximum.at(ends[1], cluster[one[edge]], parts.level[other[edge]])
    leads = np.where(np.isfinite(ends[0]), ends[1] - ends[0], 0.0) > step
    a, b = joins
    made: BoolArray = (leads[cluster[a]] & small[a]) | (leads[cluster[b]] & small[b])
    return made


def accept_parts(near: Beside, parts: Parts, joins: Pairs, low: BoolArray, config: PerceptionConfig) -> BoolArray:
    """Which parts are ground, shape (parts + 1,): what strides join to the bulk, and storeys by themselves.

    Parts that lead nowhere are dropped, one after another: a box or a board that is joined to the floor alone, and a
    table, which lies over ground, with or without headroom (`low`), and from which one gets down alone, or to a box.
    """
    alive, layers = parts.size > 0, near.layers
    table, dead = _tables(near, parts, joins, low, config), alive
    largest = TABLE_AREA / layers.cell_width**2
    while dead.any():
        dead = _dead_ends(parts, joins, alive, table, largest)
        alive = alive & ~dead
    if not alive.any():
        return alive
    group, bulk = _bulk(near, parts, joins, alive, config)
    main = alive & (group == bulk)
    accepted: BoolArray = main | (alive & _apart(layers, parts, group, main, config)[group])
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
    a, b = pairs_within(*joins, among, True)
    same = np.abs(parts.level[a] - parts.level[b]) <= parts.rise
    unit: IntArray = components(a[same], b[same], among)
    return unit


def _tables(near: Beside, parts: Parts, joins: Pairs, low: BoolArray, config: PerceptionConfig) -> BoolArray:
    """Parts higher than one that they are joined to, and over ground with less headroom than a step's, (parts + 1,).

    Looked at is a sole from the rim, which is as far in as one sees the floor below a board; the rim by itself, as one
    cell of it may hold both grounds of a step. Only what is narrower than a landing is one by its rim.
    """
    high = np.zeros(len(parts.size), dtype=bool)
    for one, other in (joins, joins[::-1]):
        high[one[parts.level[one] - parts.level[other] > parts.rise]] = True
    width = near.layers.cell_width
    soles = max(1, round(SOLE / width))

    def rims(layers: Layers, _: BoolArray, own: BoolArray, ground: BoolArray) -> tuple[BoolArray, BoolArray, BoolArray]:
        a, b = connect(layers, own, parts.rise)
        rim = own & (np.bincount(a, minlength=len(own)) + np.bincount(b, minlength=len(own)) < 2 * len(HALF))
        inner, lies = rim.copy(), np.zeros(len(own), dtype=bool)
        for _ring in range(soles):
            inner |= touched_by(a, b, own, inner)
        nodes = np.flatnonzero(inner)
        lies[nodes] = nodes_over(nodes, layers.cell, layers.height, ground, config.step_headroom)
        return rim, inner & ~rim, lies

    rim, inner, lies = near.around("rims", soles + 1, rims, parts.keep & high[parts.label], parts.keep | low)
    narrow, inside = parts.depth < LANDING, parts.share(lies, inner)
    small = narrow | (parts.size * width**2 <= TABLE_AREA)
    table: BoolArray = inside > np.where(small, TABLE_OVER_SHARE, OVER_SHARE)
    table |= narrow & (parts.share(lies, rim) > OVER_SHARE)
    return table


def _groups(joins: Pairs, alive: BoolArray) -> IntArray:
    """Connected component of each part over the strides between those that are alive."""
    (a, b), count = pairs_within(*joins, alive, True), len(alive)
    pairs = coo_array((np.ones(len(a)), (a, b)), (count, count))
    group: IntArray = connected_components(pairs, directed=False)[1]
    return group


def _bulk(near: Beside, parts: Parts, joins: Pairs, alive: BoolArray, config: PerceptionConfig) -> tuple[IntArray, int]:
    """The group of each part, and which group is the ground that one starts from: the lowest of the large ones.

    What mostly lies over something is a storey, and only the bulk where there is nothing else. A ceiling is never: it
    lies over something more than a step below, as large as half a foot, which reflections are not, and nothing rises
    from it as walls do from a floor. Shelves hide most of a shop's floor from who scans it, and nothing of its ceiling.

    Raises:
        NoGroundError: there are but ceilings.
    """
    group, layers = _groups(joins, alive), near.layers
    size = np.bincount(group, parts.size * alive)
    lies, inner, hangs = (
        np.bincount(group, parts.share(kind, among) * parts.size * alive)
        for kind, among in (
            (parts.over, parts.keep),
            (parts.over, parts.keep & parts.inner),
            (_over_things(near, parts, config.max_step), parts.keep & parts.inner),
        )
    )
    asked = (hangs > 0.0) & (size >= BULK_SHARE * size.max())
    rises = _rises(near, parts.keep, config.max_step)
    risen = np.bincount(group, np.bincount(parts.label[rises], minlength=len(group)) * alive)
    ceiling = asked & (risen < OVER_SHARE * inner)
    if not (size > 0)[~ceiling].any():
        raise NoGroundError("ground", "all that is level and wide enough is a ceiling", "Was the floor scanned?")
    own = np.where(ceiling | (2 * lies >= size), 0, size)
    own = own if own.any() else np.where(ceiling, 0, size)
    large = np.flatnonzero((own > 0) & (own >= BULK_SHARE * own.max()))
    if len(large) == 1:
        return group, int(large[0])
    of_node = group[parts.label[parts.keep]]
    height = layers.height[parts.keep]
    return group, int(min(large, key=lambda i: float(np.median(height[of_node == i]))))


def _over_things(near: Beside, parts: Parts, step: float) -> BoolArray:
    """Nodes of parts over something more than a `step` [m] below them that is as large as half a foot, shape (k,)."""
    over, area = parts.over & parts.keep, near.layers.cell_width**2
    over[1:] &= np.diff(near.layers.height) > step

    def answer(layers: Layers, _: BoolArray, over: BoolArray) -> tuple[BoolArray]:
        piece = components(*connect(layers, over, parts.rise), over)
        return (over & (np.bincount(piece, over) * area >= HALF_FOOT)[piece],)

    return near.around("over things", int(HALF_FOOT / area) + 1, answer, over)[0]  # what is as long is as large


def _rises(near: Beside, among: BoolArray, step: float) -> BoolArray:
    """Which nodes, of `among`, have something rise from them, or beside them, by more than a `step` [m], shape (k,)."""

    def answer(layers: Layers, asked: BoolArray, among: BoolArray) -> tuple[BoolArray]:
        rises, nodes = np.zeros(len(among), dtype=bool), np.flatnonzero(among & asked)
        grid = layers.cell, layers.start, layers.shape, layers.height, layers.top
        rises[nodes] = rises_beside(nodes, *grid, step)
        return (rises,)

    return near.around("rises", 1, answer, among)[0]


def _dead_ends(parts: Parts, joins: Pairs, alive: BoolArray, table: BoolArray, largest: float) -> BoolArray:
    """Parts that lead nowhere, shape (parts + 1,).

    A tread joins ground above to ground below, a sill joins two floors, and what is level with a floor is of it.
    Fragments of one tread beside each other count as one, and so do a table's. A `table` is what a body stands on, but
    leads no further up: one gets over it to a crate beside a board, or to a chest, and not on from there. Nor does
    what joins it to the floor alone.
    """
    (a, b), count = pairs_within(*joins, alive, True), len(alive)
    narrow, table = alive & ~parts.standable, alive & parts.standable & table
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


def _apart(layers: Layers, parts: Parts, group: IntArray, main: BoolArray, config: PerceptionConfig) -> BoolArray:
    """Which groups are ground by themselves, though no way to them was seen, shape (groups,).

    They are larger than furniture, and the ground that one starts from is not close below them. What is within a step
    of the ground beside it goes on behind a shelf or a fence. A storey is under a ceiling, and either vast or the level
    floor of a room high over the ground beside it, which a tree's crown is not. What is open, and in whose cells that
    ground is not, is a pit, a track bed or a court where it is lower than the ground beside it, and a platform where it
    is vast and lower than a roof that people live under.
    """
    count, of_node, ours = int(group.max()) + 1, group[parts.label], parts.keep & main[parts.label]
    size = np.bincount(of_node[parts.keep], minlength=count)
    area, vast = size * layers.cell_width**2, size >= BULK_SHARE * size[group[main]].max()
    large = area > TABLE_AREA
    large[np.append(group[main], group[-1])] = False
    nodes = np.flatnonzero(parts.keep & large[of_node])

    def share(kind: BoolArray) -> FloatArray:
        made: FloatArray = np.bincount(of_node[nodes[kind]], minlength=count) / np.maximum(size, 1)
        return made

    under = share((layers.headroom[nodes] >= config.storey_headroom) & np.isfinite(layers.headroom[nodes]))
    large &= share(nodes_over(nodes, layers.cell, layers.height, ours, config.storey_headroom)) <= OVER_SHARE
    holds = _holding(layers, ours)
    storey, open_ = under >= COVERED_SHARE, share(~holds[layers.cell[nodes]]) >= 1.0 - OVER_SHARE
    asked = large & (open_ | storey)
    nodes = nodes[asked[of_node[nodes]]]
    if not len(nodes):
        return asked
    rise = layers.height[nodes] - _beside(layers, ours, holds)[layers.cell[nodes]]
    level = np.abs(layers.height[nodes] - _medians(layers.height[nodes], of_node[nodes], count)) <= config.max_step
    even, sunk, low, lofty = (
        share(kind) >= 1.0 - OVER_SHARE
        for kind in (
            np.abs(rise) <= config.max_step,
            rise < -config.max_step,
            rise < config.storey_headroom,
            level & (rise >= config.storey_headroom),
        )
    )
    storey &= vast | (lofty & (area >= ROOM_AREA))
    found: BoolArray = asked & (even | storey | (open_ & (sunk | vast & low)))
    return found


def _holding(layers: Layers, ours: BoolArray) -> BoolArray:
    """Which cells hold one of `ours`, shape (cells,)."""
    holds = np.zeros(len(layers.start) - 1, dtype=bool)
    holds[layers.cell[ours]] = True
    return holds


def _beside(layers: Layers, ours: BoolArray, holds: BoolArray) -> FloatArray:
    """Height of the highest of `ours` in the nearest cell that `holds` one [m], shape (cells,)."""
    high = np.zeros(layers.shape)
    high.ravel()[layers.cell[ours]] = layers.height[ours]  # the highest: nodes are sorted by their height in a cell
    nearest = ndimage.distance_transform_edt(~holds.reshape(layers.shape), return_distances=False, return_indices=True)
    made: FloatArray = high[tuple(nearest)].ravel()
    return made


def _medians(values: FloatArray, group: IntArray, count: int) -> FloatArray:
    """Of each value the median of its group, shape (n,)."""
    middle = np.zeros(count)
    for one in np.unique(group):
        middle[one] = np.median(values[group == one])
    return middle[group]


def undersides(
    near: Beside, parts: Parts, core: BoolArray, smooth: Pairs, config: PerceptionConfig
) -> tuple[BoolArray, Parts, BoolArray]:
    """Nodes `core` of slabs that are seen from below, the parts without them, and which of these are what was left.

    An underside is the next below nodes of parts, by no more than a step, as wide as a body (a stair's tread goes on
    beneath the next one by its nosing alone), and more of it has something below it than strays are: the floor has not.
    What is left of a part of which that is the most, and what that is around, are pieces by themselves: where the
    slab's top has holes in its scan, and a stair's last tread, where that is as high as the underside beside it. See
    `without_ceilings`.
    """
    layers, under = near.layers, np.zeros(len(core), dtype=bool)
    rows = np.flatnonzero(~parts.keep[:-1] & parts.keep[1:] & parts.over[1:])
    rows = rows[layers.height[rows + 1] - layers.height[rows] <= config.max_step]
    under[rows] = True
    a, b = pairs_within(*smooth, under, False)
    region = np.full(len(core), len(rows))
    region[rows] = np.unique(components(a, b, under)[rows], return_inverse=True)[1]
    depth = extents_in_plan(layers.cell, layers.shape[1], under, region, layers.cell_width)[1]
    lies, size = (np.bincount(region[kind], minlength=len(depth)) for kind in (under & parts.over, under))
    aloft = lies > OVER_SHARE * size
    under[rows] = ((depth >= config.standing_width) & aloft)[region[rows]]
    hangs = parts.share(under, np.ones(len(core), dtype=bool)) >= 0.5
    hangs[-1] = False
    rest = parts.keep & hangs[parts.label]
    under |= hangs[parts.label] & ~rest
    if not under.any():
        return under, parts, np.zeros_like(hangs)
    left = build_parts(near, parts.flat & ~under, parts.keep & ~under, parts.inner, parts.rise, config)
    touches = touched_by(*smooth, left.keep, under)
    scraps = left.share(touches, left.keep & (touches | ~parts.inner)) >= 0.5
    scraps[left.label[rest]] = True
    scraps[-1] = False
    return under, left, scraps


def without_ceilings(
    layers: Layers, parts: Parts, joins: Pairs, under: BoolArray, scraps: BoolArray, config: PerceptionConfig
) -> tuple[BoolArray, Parts, Pairs]:
    """What is left of undersides, `scraps` of shape (parts + 1,), is one as well but for treads: one steps down there.

    Through a hole in the scan of a slab's top nothing is within a stride below. Where that hole is beside a tread, the
    tread is what is as near to the one below it as that is deep, at most a stride: a ramp is no tread.
    """
    if not scraps.any():
        return under, parts, joins
    lost = scraps[parts.label]
    high, low = (np.concatenate(ends) for ends in zip(joins, joins[::-1], strict=True))
    down = scraps[high] & ~scraps[low] & (parts.level[high] - parts.level[low] > parts.rise)
    down &= parts.size[low] * layers.cell_width**2 >= HALF_FOOT
    for scrap, below in zip(high[down], low[down], strict=True):
        rise = parts.level[scrap] - layers.height  # a ramp and both its storeys are one part
        tread = (parts.label == below) & (rise > 0.0) & (rise <= config.max_step)
        own, beneath = np.flatnonzero(parts.label == scrap), np.flatnonzero(tread)
        off = cKDTree(layers.place[beneath]).query(layers.place[own])[0]
        lost[own[off <= min(parts.depth[below], STRIDE) + layers.cell_width]] = False
    label = np.where(lost, len(parts.size) - 1, parts.label)
    flat, keep = parts.flat & ~lost, parts.keep & ~lost
    size = np.bincount(label[keep], minlength=len(parts.size))
    good = (size[joins[0]] > 0) & (size[joins[1]] > 0)
    left = replace(parts, label=label, flat=flat, keep=keep, size=size)
    return under | lost, left, (joins[0][good], joins[1][good])

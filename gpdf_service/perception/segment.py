"""Which points are ground: layers that a body can stand on, joined by steps that it takes, from the walkable bulk."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import coo_array

from gpdf_service.config import PerceptionConfig
from gpdf_service.errors import NoGroundError
from gpdf_service.fields.threads import run_beside, run_chunked
from gpdf_service.perception.beside import Beside, beside, beside_now
from gpdf_service.perception.boxes import window
from gpdf_service.perception.bumps import Former, low_things, raised_over_sides
from gpdf_service.perception.columns import Runs, by_cell
from gpdf_service.perception.layers import (
    APART,
    HALF,
    SPREAD,
    Layers,
    Pairs,
    build_layers,
    carried,
    cell_width_of,
    cells_around,
    connect,
    crop_layers,
    in_steps,
    kept_nodes,
    layer_gap,
)
from gpdf_service.perception.nodes import (
    components,
    drops_beside,
    extents_in_plan,
    half_way,
    held_by,
    joined_to,
    lowest_beside,
    mean_gradients,
    medians_of,
    nodes_over,
    off_ground,
    over_kept,
    stepped,
    with_rims,
)
from gpdf_service.perception.pairs import medians_around, pairs_over_gaps, pairs_within
from gpdf_service.perception.read import check_points
from gpdf_service.types import BoolArray, FloatArray, IntArray

NO_SURFACE = ("ground", "no surface in the cloud is wide and level enough to stand on", "Is z up?")
"""What was looked for, what was found, what to try."""
ROBUST = 1.4826
"""[-] Standard deviation over the median of what normal residuals are off by."""
LEAST_SCATTER = 0.02
"""[m] Scatter of a good scanner's floor; three robust standard deviations of the residuals where that is more."""
NOISY = 2.8
"""[-] Cells are as wide as the root of this by noise and width, so that two deviations of the difference of neighbours,
each the median of its points, stay under the steepest slope: w tan(0.7) ≥ 2 · √2 · 1.25 σ (w₀ / 1.5) / w."""
OVER_SHARE = 0.2
"""Share of a patch that may lie over other ground: a scan's stray points, not a table."""
TABLE_OVER_SHARE = 0.05
"""The same of what is no larger than a table and stood on: the floor seen below one side of it; noise makes none."""
TABLE_AREA = 4.0
"""[m²] Furniture is no larger than a conference table for eight."""
BULK_SHARE = 0.3
"""Of the largest surface that has nothing below most of it (a ceiling has): what is smaller is furniture, a landing or
a shelf, not the floor that one starts from."""
ROOF_SHARE = 0.2
"""[-] Of a roof's rim that ground can touch, the rest being a drop: a terrace at one corner, a neighbour's wall."""
COVERED_SHARE = 0.5
"""Of an upper storey that has a ceiling over it: tall furniture stands on the rest, or a roof window is over it."""


def segment_ground(points: ArrayLike, config: PerceptionConfig | None = None) -> BoolArray:
    """Tell ground from the rest in an unlabelled cloud.

    Columns of the cloud are cut into layers; layers that are surfaces, not a wall's face, are joined into patches; from
    the bulk, the lowest of the large patches, the ground grows over steps. See `find_ground`.

    Args:
        points: The cloud, z up [m], shape (n, 3).
        config: Limits.

    Returns:
        Shape (n,).

    Raises:
        CloudError: the cloud cannot be used.
        NoGroundError: nothing in it is walkable.
    """
    cloud, config = check_points(points), config or PerceptionConfig()
    return segment(cloud, first_layers(cloud, config), config)[0]


class Found(NamedTuple):
    """What the ground of some nodes was found from.

    Attributes:
        near: Their pairs.
        reached: Which the ground was joined up to, shape (k,).
        slope: Of those [rad], shape (k,).
        ground: Which are ground or a low thing on it, shape (k,).
        raised: `raised_over_sides` of that [m], shape (k,).
        rough: Around low things [m], see `low_things`, shape (k,).
    """

    near: Beside
    reached: BoolArray
    slope: FloatArray
    ground: BoolArray
    raised: FloatArray
    rough: FloatArray

    def carried(self, near: Beside, kept: Runs) -> Found:
        """What is known of the nodes of `near`, which are those that were `kept`; NaN of the others."""
        return Found(near, *(carried(values, kept) for values in self[1:]))


@dataclass(frozen=True, slots=True)
class Segmentation:
    """What was found of the columns of a cloud.

    Attributes:
        layers: Their nodes.
        low: Lowest that the ground is within each node's cell [m], inf where the node is none, shape (k,).
        high: Highest, -inf where the node is none.
        beside: Height of the ground beside a node that may reach into its cell [m], inf where there is none.
        found: What its ground was found from.
        deviation: Standard deviation of the points of the ground around it [m].
    """

    layers: Layers
    low: FloatArray
    high: FloatArray
    beside: FloatArray
    found: Found
    deviation: float

    @property
    def scatter(self) -> float:
        """How near to the ground a point of it is [m]."""
        return scatter_of(self.deviation)

    def holds(self, z: FloatArray, node: IntArray) -> BoolArray:
        """Whether points at heights `z` [m] in the nodes `node` are ground, shape (n,)."""
        held = np.empty(len(z), dtype=bool)
        own = z, node, self.low, self.high, self.beside, self.scatter
        run_chunked(lambda a, b: held_by(*own, a, b, held), len(z))
        return held


def first_layers(cloud: FloatArray, config: PerceptionConfig, width: float | None = None) -> Layers:
    """Layers of a whole cloud (n, 3) for a first look; the cells' width [m] is measured when it is not given."""
    width = cell_width_of(cloud) if width is None else width
    return build_layers(cloud, width, layer_gap(width, config))


def segment(cloud: FloatArray, layers: Layers, config: PerceptionConfig) -> tuple[BoolArray, Segmentation | None]:
    """`segment_ground` of points (n, 3) in their `first_layers`: which are ground, and what that was found from.

    None where the ground is so rough or noisy that a second look with wider cells was needed.
    """
    z, width = cloud[:, 2], layers.cell_width
    found = segment_layers(layers, config, z)
    wider = float(np.sqrt(NOISY * found.deviation * width))
    if wider <= width:
        return found.holds(z, layers.node_of_point), found
    layers = build_layers(cloud, wider, layer_gap(wider, config), found.deviation)
    return segment_layers(layers, config, z, found.deviation).holds(z, layers.node_of_point), None


def segment_layers(
    layers: Layers, config: PerceptionConfig, z: FloatArray | None = None, noise: float = 0.0, deviation: float = 0.0
) -> Segmentation:
    """Find the ground in the layers.

    Args:
        layers: Of a cloud.
        config: Limits.
        z: Heights of the points of the layers [m], shape (n,), that tell the deviation; else it is as given.
        noise: Standard deviation of the points that the layers allow for [m].
        deviation: Of the points of the ground around it [m].
    """
    ground, found = find_ground(layers, config, noise)
    smooth = _smoothed(layers, ground)
    if z is not None:
        deviation = ROBUST * float(np.median(off_ground(z, layers.node_of_point, ground, smooth)))
    return Segmentation(layers, *_extents(layers, ground, smooth, scatter_of(deviation), config), found, deviation)


def change_segmentation(
    old: Segmentation, layers: Layers, cells: BoolArray, config: PerceptionConfig
) -> tuple[Segmentation, BoolArray]:
    """`segment_layers` of `layers` that differ from the `old` ones in the columns `cells`, shape (nx, ny).

    Which nodes are ground is decided from all; how high the ground is at a node by its neighbours and theirs.

    Returns:
        The segmentation, and the cells whose points can be something else by it, shape (nx, ny).
    """
    kept = kept_nodes(old.layers, layers, cells)
    near = beside_now(old.found.near, layers, _rise_of_steps(layers, config), cells)
    ground, found = find_ground(layers, config, known=(old.found.carried(near, kept), cells))
    values = [carried(before, kept) for before in (old.low, old.high, old.beside)]
    felt = cells_around(layers, ground != np.isfinite(values[0]), 2, cells)
    part, nodes = crop_layers(layers, window(felt, 2))
    inside = felt.ravel()[layers.cell[nodes]]
    fresh = _extents(part, ground[nodes], _smoothed(part, ground[nodes]), old.scatter, config)
    other = cells.copy()
    for made, again in zip(values, fresh, strict=True):
        differ = nodes[inside & (made[nodes] != again)]
        made[nodes[inside]] = again[inside]
        other.ravel()[layers.cell[differ]] = True
    low, high, beneath = values
    return Segmentation(layers, low, high, beneath, found, old.deviation), other


def scatter_of(deviation: float) -> float:
    """How near to the ground a point of it is [m], where the ground's have this standard deviation [m]."""
    return max(LEAST_SCATTER, in_steps(3.0 * deviation))


def _extents(
    layers: Layers, ground: BoolArray, smooth: FloatArray, scatter: float, config: PerceptionConfig
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """`low`, `high` and `beside` of a `Segmentation`."""
    beneath, across = run_beside(
        partial(_ground_beside, layers, ground, smooth, scatter), partial(_across, layers, ground, smooth, config)
    )
    return *across, beneath


def _across(
    layers: Layers, ground: BoolArray, smooth: FloatArray, config: PerceptionConfig
) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest the ground is within each ground node's cell: half-way to its neighbours on the same slope."""
    rise = layers.cell_width * float(np.tan(config.steepest))
    a, b = connect(replace(layers, height=smooth), ground, rise)
    low, high = half_way(smooth, a, b)
    return np.where(ground, low, np.inf), np.where(ground, high, -np.inf)


def _ground_beside(layers: Layers, ground: BoolArray, smooth: FloatArray, scatter: float) -> FloatArray:
    """Height of the lowest ground in the cells beside each node that spans it, inf where there is none.

    The foot of a wall or of a table's leg shares its cell with the floor that it stands on, and the end of a stair's
    tread with the face of the next one.
    """
    return lowest_beside(layers.start, layers.shape, ground, smooth, layers.height, layers.thickness + scatter)


def _smoothed(layers: Layers, ground: BoolArray) -> FloatArray:
    """Median height of each ground node and its neighbours on the same slope: a wheel on the floor does not lift it."""
    a, b = connect(layers, ground, 2.0 * layers.cell_width)
    return medians_around(layers.height, ground, a, b)


def find_ground(
    layers: Layers, config: PerceptionConfig, noise: float = 0.0, known: tuple[Found, BoolArray] | None = None
) -> tuple[BoolArray, Found]:
    """Which nodes are ground, shape (k,), and what that was found from: what is `known` of an earlier version.

    That has other nodes in some columns, shape (nx, ny).

    Patches are sets of nodes joined by walkable slopes. From the bulk, the ground grows patch by patch over steps that
    a body takes, to patches that a foot fits on and that do not lie, as a bench does, over ground already found. What a
    patch is to a step, and whether a body stands on it, its parts say: it may be a flight.
    """
    surface = layers.thickness <= config.max_step + SPREAD * noise  # with the face of a step in it, too
    rise = layers.cell_width * float(np.tan(config.steepest))
    near = beside(layers, _rise_of_steps(layers, config)) if known is None else known[0].near
    smooth = near.degrees(surface, rise)
    core = surface & (smooth >= 5)  # what a strip two cells wide has: a tread is that wide, a wall's top is not
    if not core.any():
        raise NoGroundError(*NO_SURFACE)
    keep = surface & (layers.headroom >= config.step_headroom)
    piece, loose, steps = near.pieces(core & keep, rise, surface, keep, config.max_step)
    wide, patch = with_rims(core, keep, piece, *loose)
    gentle = near.degrees(surface, layers.cell_width * float(np.tan(config.standable_slope))) >= 5
    parts = _parts(near, core & ((smooth > 5) | gentle), wide, rise)
    over = np.r_[False, layers.cell[1:] == layers.cell[:-1]]
    aloft = _mostly(over, patch, wide)
    (under, below), joins = run_beside(
        partial(_undersides, layers, surface & ~wide, wide, patch, over, aloft, loose, config),
        partial(_joins, near, config, wide, smooth == 8, patch, parts, steps),
    )
    joins = joins.but(below, patch)
    plain, own = joins.beside(), np.where(aloft, 0, joins.size)
    least = BULK_SHARE * (own if own.any() else joins.size).max()
    large = {int(i): joins.nodes_of(int(i)) for i in np.flatnonzero(joins.size >= least)}
    height = {i: float(np.median(layers.height[nodes])) for i, nodes in large.items()}
    bulk = min(large, key=height.__getitem__)
    storeys = [i for i, nodes in large.items() if i == bulk or _is_storey(layers, nodes, patch == bulk, config)]
    seen = np.zeros(len(joins.size), dtype=bool)
    seen[storeys] = True
    ground = wide & seen[patch]
    loose = pairs_within(*pairs_within(*loose, core | wide, True), ~ground, False)  # that is so, or out of reach
    # Without a step the ground reaches where only a low body fits. Nothing is entered from there over a step: what is
    # low beside a stair's tread is its soffit. Patches not yet seen are no ground, so each of their pieces is one node.
    while True:
        low = joined_to(ground, core & ~wide, piece, *loose)
        ground = _spread(layers, config, ground, low, patch, joins, seen)
        among = core & ~(wide & seen[patch])
        among[:-1] &= ~(under[:-1] & ground[1:])
        reached = joined_to(ground, among, piece, *loose)  # and what lies behind
        seen[patch[reached & wide]] = True
        if not len(_next_patches(reached, plain, seen)):  # what is behind leads nowhere by itself: no round for gaps
            break
        ground = reached
    slope = _slope(layers, reached, config, known)
    level = reached & (slope <= config.standable_slope)
    found: BoolArray = reached & ~_roofs(near, reached, level, [large[i] for i in storeys], joins, config)
    before = None if known is None else Former(known[0].ground, known[0].raised, known[0].rough, known[1])
    raised = raised_over_sides(layers, found, config, before)
    low, rough = low_things(layers, found, raised, config, before)
    ground = found & ~low
    if not ground.any():
        raise NoGroundError(*NO_SURFACE)
    return ground, Found(near, reached, slope, found, raised, rough)


def steps_over_gaps(
    near: Beside, keep: BoolArray, label: IntArray, config: PerceptionConfig
) -> tuple[Pairs, FloatArray]:
    """Steps between kept nodes with another `label` each that a gap parts, and how wide it is [m].

    Less than a foot fits in; see `pairs_over_gaps`.
    """
    layers, reach, step = near.layers, config.tread_depth, config.max_step
    own, nodes = (layers.cell, layers.start, layers.shape, layers.height, keep, step), near.ends(keep, step)
    found = [
        pairs_over_gaps(nodes[k], *own, HALF[k], int(reach / (APART[k] * layers.cell_width))) for k in range(len(HALF))
    ]
    a, b = (np.concatenate(ends) for ends in zip(*(pairs[:2] for pairs in found), strict=True))
    wide = np.concatenate([pairs[2] * APART[k] for k, pairs in enumerate(found)])
    other = label[a] != label[b]
    return (a[other], b[other]), wide[other] * layers.cell_width


def _rise_of_steps(layers: Layers, config: PerceptionConfig) -> float:
    """As much as is asked for between two nodes: a step, or 2 √2 of the slope of a cell [m]."""
    return max(config.max_step, 3.0 * layers.cell_width * float(np.tan(config.steepest)))


def _roofs(
    near: Beside,
    ground: BoolArray,
    flat: BoolArray,
    storeys: list[IntArray],
    joins: _Joins,
    config: PerceptionConfig,
) -> BoolArray:
    """Nodes of pieces reached only over ground too steep to stand on, and that end in the air nearly all round.

    A pitched roof whose eaves a terrace reaches is such a piece. A steep bank has ground above and below.
    """
    rise = near.layers.cell_width * float(np.tan(config.steepest))
    steps = pairs_within(joins.a, joins.b, ground, True)
    piece, loose, _ = near.pieces(flat, rise, ground, more=pairs_within(*steps, flat, True))
    a, b = (np.concatenate(ends) for ends in zip(loose, steps, strict=True))
    main = _within_reach(near, flat, storeys, piece, a, b, config)
    off = ground & ~main
    if not off.any():
        return off
    a, b = pairs_within(a, b, off, False)
    level = stepped(main, a, b)
    apart = np.zeros(piece.max() + 1, dtype=bool)
    apart[piece[off]] = True
    piece = components(piece[a], piece[b], apart)[piece]
    count = [
        np.bincount(piece[off & kind], minlength=piece.max() + 1) for kind in (level, _drops(near.layers, off, config))
    ]
    roof: BoolArray = off & (count[0] < ROOF_SHARE * (count[0] + count[1]))[piece]
    return roof


def _within_reach(
    near: Beside,
    flat: BoolArray,
    storeys: list[IntArray],
    piece: IntArray,
    a: IntArray,
    b: IntArray,
    config: PerceptionConfig,
) -> BoolArray:
    """Nodes `flat` enough to stand on that are reached from the storeys; over steps, too, that coarse cells rounded."""
    seen = np.zeros(piece.max() + 1, dtype=bool)
    for storey in storeys:
        if flat[storey].any():
            seen[np.bincount(piece[storey[flat[storey]]]).argmax()] = True
    a, b = pairs_within(a, b, ~(flat & seen[piece]), False)
    rings = max(1, round(config.max_step / (near.layers.cell_width * float(np.tan(config.steepest)))))
    while True:
        reach = flat & seen[piece]
        for _ in range(rings + 1):
            reach = stepped(reach, a, b)
        fresh = piece[reach & flat & ~seen[piece]]
        if not len(fresh):
            return flat & seen[piece]
        seen[fresh] = True


def _slope(
    layers: Layers, ground: BoolArray, config: PerceptionConfig, known: tuple[Found, BoolArray] | None = None
) -> FloatArray:
    """Slope at each ground node [rad], of the mean gradient of it and its neighbours on the same slope.

    What was found of another ground, and of other nodes in some cells, is `known`: neighbours of neighbours decide.
    """
    rise = 2.0 * layers.cell_width * float(np.tan(config.steepest))  # or noise would flatten it
    if known is None:
        return _slopes(layers, connect(layers, ground, rise))
    before, cells = known
    felt = cells_around(layers, before.reached != ground, 2, cells)
    if not felt.any():
        return before.slope
    part, nodes = crop_layers(layers, window(felt, 2))
    inside, made = felt.ravel()[layers.cell[nodes]], before.slope.copy()
    made[nodes[inside]] = _slopes(part, connect(part, ground[nodes], rise))[inside]
    return made


def _slopes(layers: Layers, pairs: Pairs) -> FloatArray:
    """Slope at each node [rad], where the pairs are those on the same slope."""
    gradient = mean_gradients(layers.height, layers.cell, layers.shape[1], *pairs)
    made: FloatArray = np.arctan(gradient / layers.cell_width)
    return made


def _drops(layers: Layers, among: BoolArray, config: PerceptionConfig) -> BoolArray:
    """Which nodes, of `among`, have nothing go on in one direction, and something more than a step further down."""
    rise = layers.cell_width * float(np.tan(config.steepest))
    grid = layers.cell, layers.start, layers.shape
    return drops_beside(np.flatnonzero(among), *grid, layers.height, layers.thickness, rise, config.max_step)


def _is_storey(layers: Layers, nodes: IntArray, bulk: BoolArray, config: PerceptionConfig) -> bool:
    """Whether a large surface is a floor by itself: under a ceiling, and as far over the ground; a roof has the sky."""
    room = layers.headroom[nodes]
    covered = (room >= config.storey_headroom) & np.isfinite(room)
    over = nodes_over(nodes, layers.cell, layers.height, bulk, config.storey_headroom)
    return bool(covered.mean() >= COVERED_SHARE and over.mean() <= OVER_SHARE)


@dataclass(frozen=True, slots=True)
class _Joins:
    """Steps from node `a` up or down to node `b` of another patch, and what the patches are.

    Attributes:
        a: Nodes.
        b: Nodes.
        to: Their patches.
        over: Which are over a gap.
        standable: Which patches a body stands on.
        small: Which are no larger than a table.
        size: How many nodes each patch has.
        inner: Nodes with all eight neighbours on their slope, shape (k,).
        level: Its mean height [m].
        start: Where the nodes of each patch begin in `members`.
        members: Nodes, by patch.
    """

    a: IntArray
    b: IntArray
    to: IntArray
    over: BoolArray
    standable: BoolArray
    small: BoolArray
    size: IntArray
    inner: BoolArray
    level: FloatArray
    start: IntArray
    members: IntArray

    def nodes_of(self, patch: int) -> IntArray:
        """Nodes of a patch, sorted."""
        return self.members[self.start[patch] : self.start[patch + 1]]

    def but(self, below: IntArray, patch: IntArray) -> _Joins:
        """Without steps down to a patch that `below` tells of, as `_undersides` does, each node being of a `patch`."""
        if not len(below):
            return self
        return self._chosen(~np.isin(self.to * len(self.size) + patch[self.a], below))

    def beside(self) -> _Joins:
        """Without those over gaps."""
        return self._chosen(~self.over)

    def _chosen(self, good: BoolArray) -> _Joins:
        return replace(self, a=self.a[good], b=self.b[good], to=self.to[good], over=self.over[good])


def _parts(near: Beside, firm: BoolArray, wide: BoolArray, rise: float) -> tuple[BoolArray, IntArray]:
    """Parts of the patches that `firm` nodes join: which of the `wide` nodes are in one, and in which.

    A strip two cells wide that is steeper than a body stands on is not firm: it is no way from tread to tread, but the
    board along a flight's side, which makes one patch of the treads.
    """
    piece, rims, _ = near.pieces(firm & wide, rise, wide)
    return with_rims(firm, wide, piece, *rims)


def _joins(
    near: Beside,
    config: PerceptionConfig,
    wide: BoolArray,
    inner: BoolArray,
    patch: IntArray,
    parts: tuple[BoolArray, IntArray],
    steps: Pairs,
) -> _Joins:
    """The steps between the patches, those over gaps last, from part to part of them."""
    layers, (firm, part) = near.layers, parts
    steps = pairs_within(*steps, firm, True, patch)
    gaps, hidden = steps_over_gaps(near, firm, patch, config)
    standable, tread = _shapes(layers, wide, patch, parts, gaps, hidden, config)
    start, members = by_cell(patch, len(standable))
    count = np.bincount(patch[wide], minlength=len(standable))
    small = count * layers.cell_width**2 <= TABLE_AREA
    level: FloatArray = np.bincount(patch, layers.height, len(count)).astype(np.float64)
    a, b = np.concatenate([*steps, *gaps]), np.concatenate([*steps[::-1], *gaps[::-1]])
    over = np.arange(len(a)) >= 2 * len(steps[0])
    rise = np.abs(layers.height[a] - _level_of_furniture(layers, small[patch], part, b))
    allowed = np.where(standable[patch[b]], config.max_step, np.where(tread[patch[b]], config.stair_step, -1.0))
    join = rise <= allowed
    a, b, mean = a[join], b[join], level / np.maximum(count, 1)
    return _Joins(a, b, patch[b], over[join], standable, small, count, inner, mean, start, members)


def _undersides(
    layers: Layers,
    hidden: BoolArray,
    wide: BoolArray,
    patch: IntArray,
    over: BoolArray,
    aloft: BoolArray,
    smooth: Pairs,
    config: PerceptionConfig,
) -> tuple[BoolArray, IntArray]:
    """Where slabs are seen from below, and which patches are that, seen through a hole in the scan of a slab's top.

    An underside is the next below nodes of patches, by no more than a step, as wide as a body (a stair's tread goes
    on beneath the next one by its nosing alone), and most of it has something below it: the floor has not. Nodes that
    have are `over` it, and patches of which most nodes are, `aloft`.

    Returns:
        Which of the `hidden` nodes are of undersides, shape (k,), and pairs of patches: the number of one that is an
        underside, times the count of all, plus that of one that lies on its slab.
    """
    count = int(patch.max()) + 1
    rows = np.flatnonzero(hidden[:-1] & wide[1:] & over[1:])
    rows = rows[layers.height[rows + 1] - layers.height[rows] <= config.max_step]
    under = np.zeros(len(wide), dtype=bool)
    under[rows] = True
    a, b = pairs_within(*smooth, under, False)
    part = np.full(len(wide), len(rows))
    part[rows] = np.unique(components(a, b, under)[rows], return_inverse=True)[1]
    depth = extents_in_plan(layers.cell, layers.shape[1], under, part, layers.cell_width)[1]
    slab = (depth >= config.standing_width)[part[rows]] & _mostly(over, part, under)[part[rows]]
    under[rows] = slab
    rows = rows[slab]
    if not len(rows):
        return under, rows
    a, b = np.concatenate([a, b]), np.concatenate([b, a])
    beside = wide[a] & under[b] & aloft[patch[a]]
    lower, upper = (
        coo_array((np.ones(len(i), dtype=bool), (i, j)), (count, len(depth))).tocsr()
        for i, j in ((patch[a[beside]], part[b[beside]]), (patch[rows + 1], part[rows]))
    )
    lower, upper = (lower @ upper.T).nonzero()
    return under, lower.astype(np.int64) * count + upper


def _mostly(true: BoolArray, label: IntArray, among: BoolArray) -> BoolArray:
    """For which labels it is true of at least half of the nodes `among` all."""
    count = np.bincount(label[among], minlength=label.max() + 1)
    held: BoolArray = 2 * np.bincount(label[among & true], minlength=len(count)) >= np.maximum(count, 1)
    return held


def _next_patches(ground: BoolArray, joins: _Joins, seen: BoolArray) -> IntArray:
    """Patches not yet seen that a step joins to the ground."""
    found = np.zeros(len(seen), dtype=bool)
    found[joins.to[ground[joins.a]]] = True
    return np.flatnonzero(found & ~seen)


def _spread(
    layers: Layers,
    config: PerceptionConfig,
    ground: BoolArray,
    low: BoolArray,
    patch: IntArray,
    joins: _Joins,
    seen: BoolArray,
) -> BoolArray:
    """Grow over steps; patches that were looked at are marked in `seen`.

    `inner` nodes have all eight neighbours on their slope. Only they say whether a patch lies over ground: the edge of
    a stair's tread shares its cells with the tread below. What a body stands on, by itself, is no platform over the
    ground with `low` room, either: a coffee table; a stair's treads may be.
    """
    share, inner = np.where(joins.standable & joins.small, TABLE_OVER_SHARE, OVER_SHARE), joins.inner
    grid, headroom = (layers.cell, layers.height), config.step_headroom
    ground = ground.copy()
    while len(fresh := _next_patches(ground, joins, seen)):
        nodes = np.concatenate([joins.nodes_of(i) for i in fresh])
        own = np.repeat(np.arange(len(fresh)), joins.size[fresh])
        over = nodes_over(nodes, *grid, low, headroom) & joins.standable[patch[nodes]]
        over = inner[nodes] & (over | nodes_over(nodes, *grid, ground, headroom))
        size = np.bincount(own[inner[nodes]], minlength=len(fresh))
        refused = np.bincount(own[over], minlength=len(fresh)) > share[fresh] * size
        seen[fresh] = True
        ground[nodes[~refused[own]]] = True
    ground = _without_dead_ends(layers, config, ground, patch, joins)
    return ground & ~over_ground(layers, ground, headroom)


def _level_of_furniture(layers: Layers, small: BoolArray, part: IntArray, nodes: IntArray) -> FloatArray:
    """Height that counts for a step onto each of the `nodes`: of a `small` patch its part's median, else its own.

    A sofa's low front edge must not make its back a platform.
    """
    asked = np.zeros(int(part.max()) + 1, dtype=bool)
    asked[part[nodes[small[nodes]]]] = True
    own = np.flatnonzero(asked[part])
    level = medians_of(layers.height[own], *by_cell(part[own], len(asked)), asked)[part[nodes]]
    return np.where(small[nodes], level, layers.height[nodes])


def _without_dead_ends(
    layers: Layers, config: PerceptionConfig, ground: BoolArray, patch: IntArray, joins: _Joins
) -> BoolArray:
    """Drop treads that lead nowhere: a stair's tread joins ground above to ground below, a sill joins two floors.

    A box on the floor joins one; so does a board, but where the scan of the floor has gaps it joins it to scraps.
    """
    a, b, standable = joins.a, joins.b, joins.standable
    level = joins.level
    rise, narrow = layers.cell_width * float(np.tan(config.steepest)), ~standable[patch]
    a, b = pairs_within(a, b, narrow, False)
    left, ground = np.flatnonzero(ground & narrow), ground.copy()
    while True:
        here, count = ground[a] & ground[b], len(level)
        one, other = patch[a[here]], patch[b[here]]
        one, other = np.divmod(np.unique(np.concatenate([one * count + other, other * count + one])), count)
        stepped_down = level[one] - level[other] > rise
        joined, below, floors = (
            np.bincount(one[kind], minlength=len(level)) for kind in (one >= 0, stepped_down, standable[other])
        )
        leads = (joined >= 2) & ((below < joined) | (floors >= 2))
        dead = ~leads[patch[left]]
        if not dead.any():
            return ground
        ground[left[dead]] = False
        left = left[~dead]


def _shapes(
    layers: Layers,
    wide: BoolArray,
    patch: IntArray,
    parts: tuple[BoolArray, IntArray],
    gaps: Pairs,
    hidden: FloatArray,
    config: PerceptionConfig,
) -> tuple[BoolArray, BoolArray]:
    """Patches with a part that a body stands on, and those as large as a stair's tread, by their principal extents.

    What is `hidden` of a tread, the width of the gap under a higher one [m], is a part of it.
    """
    ny, (firm, part) = layers.shape[1], parts
    length, depth = extents_in_plan(layers.cell, ny, wide, patch, layers.cell_width)
    a, b = gaps
    behind, standable = np.zeros(len(depth)), np.zeros(len(depth), dtype=bool)
    np.maximum.at(behind, patch[np.where(layers.height[a] < layers.height[b], a, b)], hidden)
    treads = (length >= config.tread_length) & (depth + behind >= config.tread_depth)
    deep = extents_in_plan(layers.cell, ny, firm, part, layers.cell_width)[1] >= config.standing_width
    standable[patch[firm & deep[part]]] = True
    return standable, treads


def over_ground(layers: Layers, ground: BoolArray, headroom: float) -> BoolArray:
    """Nodes with ground under them at less than `headroom` [m]: with that of a body that steps, benches and tables."""
    over: BoolArray = over_kept(layers.cell, layers.height, ground, headroom)
    return over

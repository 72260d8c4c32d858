"""Which points are ground: layers that a body can stand on, joined by steps that it takes, from the walkable bulk."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from gpdf_service.config import PerceptionConfig
from gpdf_service.errors import NoGroundError
from gpdf_service.fields.threads import run_beside, run_chunked
from gpdf_service.perception.bumps import cells_around, low_things, raised_over_sides
from gpdf_service.perception.columns import by_cell, medians_around
from gpdf_service.perception.layers import (
    Beside,
    Layers,
    beside,
    beside_now,
    build_layers,
    cell_width_of,
    connect,
    crop_layers,
    in_steps,
    layer_gap,
)
from gpdf_service.perception.limits import widened, window
from gpdf_service.perception.nodes import (
    add_rims,
    components,
    degrees,
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
    pairs_within,
    stepped,
)
from gpdf_service.perception.read import check_points
from gpdf_service.types import BoolArray, FloatArray, IntArray

NOWHERE = ("ground", "no surface in the cloud is wide and level enough to stand on", "Is z up?")
"""What was looked for, what was found, what to try."""
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
"""Of the largest surface: what is smaller is furniture, a landing or a shelf, not the floor that one starts from."""
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
    """

    near: Beside
    reached: BoolArray
    slope: FloatArray
    ground: BoolArray
    raised: FloatArray

    def spliced(self, near: Beside, stay: BoolArray, now: BoolArray) -> Found:
        """What is known of the nodes of `near`, which `now`, shape (k,), are those that `stay`; NaN of the others."""
        made = Found(near, np.zeros_like(now), np.full(len(now), np.nan), np.zeros_like(now), np.full(len(now), np.nan))
        for old, new in zip(self[1:], made[1:], strict=True):
            new[now] = old[stay]
        return made


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
        deviation = 1.4826 * float(np.median(off_ground(z, layers.node_of_point, ground, smooth)))
    return Segmentation(layers, *_extents(layers, ground, smooth, scatter_of(deviation), config), found, deviation)


def change_segmentation(
    old: Segmentation, layers: Layers, cells: BoolArray, config: PerceptionConfig
) -> tuple[Segmentation, BoolArray]:
    """`segment_layers` of `layers` that differ from the `old` ones in the columns `cells`, shape (nx, ny).

    Which nodes are ground is decided from all; how high the ground is at a node by its neighbours and theirs.

    Returns:
        The segmentation, and the cells whose points can be something else by it, shape (nx, ny).
    """
    stay, now = ~cells.ravel()[old.layers.cell], ~cells.ravel()[layers.cell]
    near = beside_now(old.found.near, layers, _rise_of_steps(layers, config), cells)
    ground, found = find_ground(layers, config, known=old.found.spliced(near, stay, now))
    felt = cells.copy()
    felt.ravel()[layers.cell[now][ground[now] != np.isfinite(old.low[stay])]] = True
    felt = widened(felt, 2)
    part, nodes = crop_layers(layers, window(felt, 2))
    inside = felt.ravel()[layers.cell[nodes]]
    fresh = _extents(part, ground[nodes], _smoothed(part, ground[nodes]), old.scatter, config)
    other, made = cells.copy(), []
    for before, again in zip((old.low, old.high, old.beside), fresh, strict=True):
        values = np.empty(len(layers.cell))
        values[now] = before[stay]
        differ = nodes[inside & (values[nodes] != again)]
        values[nodes[inside]] = again[inside]
        other.ravel()[layers.cell[differ]] = True
        made.append(values)
    low, high, beneath = made
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
    layers: Layers, config: PerceptionConfig, noise: float = 0.0, known: Found | None = None
) -> tuple[BoolArray, Found]:
    """Which nodes are ground, shape (k,), and what that was found from: what is `known` of an earlier version.

    Patches are sets of nodes joined by walkable slopes. From the bulk, the ground grows patch by patch over steps that
    a body takes, to patches that a foot fits on and that do not lie, as a bench does, over ground already found.
    """
    surface = layers.thickness <= config.max_step + 4.0 * noise  # a step's face, from the lowest point to the highest
    rise = layers.cell_width * float(np.tan(config.steepest))
    near = beside(layers, _rise_of_steps(layers, config)) if known is None else known.near
    a, b = near.slopes(surface, rise)
    smooth = degrees(a, b, len(surface))
    core = surface & (smooth >= 5)  # what a strip two cells wide has: a tread is that wide, a wall's top is not
    if not core.any():
        raise NoGroundError(*NOWHERE)
    roomy = layers.headroom >= config.step_headroom
    wide, patch = _patches(core, surface & roomy, a, b)
    size = np.bincount(patch[wide], minlength=patch.max() + 1)
    large = {int(i): patch == i for i in np.flatnonzero(size >= BULK_SHARE * size.max())}
    height = {i: float(np.median(layers.height[nodes])) for i, nodes in large.items()}
    bulk = min(large, key=height.__getitem__)
    storeys = [i for i, nodes in large.items() if i == bulk or _is_storey(layers, nodes, large[bulk], config)]
    joins = _joins(near, config, wide, patch)
    seen = np.zeros(patch.max() + 1, dtype=bool)
    seen[storeys] = True
    ground = wide & seen[patch]
    loose = pairs_within(a, b, ~ground, False)  # what is ground at first is ground or out of reach
    while True:
        low = _under_furniture(ground, wide & ~ground, core, *loose)
        ground = _spread(layers, config, ground, low, smooth == 8, patch, joins, seen)
        reached = _under_furniture(ground, wide & seen[patch] & ~ground, core, *loose)
        seen[patch[reached & wide]] = True
        if not _beside(reached, patch, joins, seen).any():
            break
        ground = reached
    parts = [large[i] for i in storeys]
    slope = _slope(near, reached, config, known and known[1:3])
    level = reached & (slope <= config.standable_slope)
    found: BoolArray = reached & ~_roofs(near, reached, level, parts, (a, b), (joins.a, joins.b), config)
    raised = raised_over_sides(layers, found, config, known and known[3:])
    ground = found & ~low_things(layers, found, raised, config)
    if not ground.any():
        raise NoGroundError(*NOWHERE)
    return ground, Found(near, reached, slope, found, raised)


def _rise_of_steps(layers: Layers, config: PerceptionConfig) -> float:
    """As much as is asked for between two nodes: a step, or 2 √2 of the slope of a cell [m]."""
    return max(config.max_step, 3.0 * layers.cell_width * float(np.tan(config.steepest)))


def _roofs(
    near: Beside,
    ground: BoolArray,
    flat: BoolArray,
    storeys: list[BoolArray],
    smooth: tuple[IntArray, IntArray],
    steps: tuple[IntArray, IntArray],
    config: PerceptionConfig,
) -> BoolArray:
    """Nodes of pieces reached only over ground too steep to stand on, and that end in the air nearly all round.

    A pitched roof whose eaves a terrace reaches is such a piece. A steep bank has ground above and below.
    """
    parts = (pairs_within(*pairs, ground, True) for pairs in (smooth, steps))
    a, b = (np.concatenate(ends) for ends in zip(*parts, strict=True))
    main = _within_reach(near, flat, storeys, a, b, config)
    off = ground & ~main
    piece = components(a, b, off)
    level = stepped(main, a, b)
    count = [
        np.bincount(piece[off & kind], minlength=piece.max() + 1) for kind in (level, _drops(near.layers, off, config))
    ]
    roof: BoolArray = off & (count[0] < ROOF_SHARE * (count[0] + count[1]))[piece]
    return roof


def _within_reach(
    near: Beside, flat: BoolArray, storeys: list[BoolArray], a: IntArray, b: IntArray, config: PerceptionConfig
) -> BoolArray:
    """Nodes `flat` enough to stand on that are reached from the storeys; over steps, too, that coarse cells rounded."""
    piece = components(a, b, flat)
    seen = np.zeros(piece.max() + 1, dtype=bool)
    for storey in storeys:
        if (storey & flat).any():
            seen[np.bincount(piece[storey & flat]).argmax()] = True
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
    near: Beside, ground: BoolArray, config: PerceptionConfig, known: tuple[BoolArray, FloatArray] | None = None
) -> FloatArray:
    """Slope at each ground node [rad], of the mean gradient of it and its neighbours on the same slope.

    What was found of another ground is `known`, NaN for nodes that were none: neighbours of neighbours decide on it.
    """
    layers = near.layers
    rise = 2.0 * layers.cell_width * float(np.tan(config.steepest))  # or noise would flatten it
    if known is None:
        return _slopes(layers, near.slopes(ground, rise))
    before, slope = known
    felt = cells_around(layers, (before != ground) | np.isnan(slope), 2)
    if not felt.any():
        return slope
    part, nodes = crop_layers(layers, window(felt, 2))
    inside, made = felt.ravel()[layers.cell[nodes]], slope.copy()
    made[nodes[inside]] = _slopes(part, connect(part, ground[nodes], rise))[inside]
    return made


def _slopes(layers: Layers, pairs: tuple[IntArray, IntArray]) -> FloatArray:
    """Slope at each node [rad], where the pairs are those on the same slope."""
    gradient = mean_gradients(layers.height, layers.cell, layers.shape[1], *pairs)
    made: FloatArray = np.arctan(gradient / layers.cell_width)
    return made


def _drops(layers: Layers, among: BoolArray, config: PerceptionConfig) -> BoolArray:
    """Which nodes, of `among`, have nothing go on in one direction, and something more than a step further down."""
    rise = layers.cell_width * float(np.tan(config.steepest))
    grid = layers.cell, layers.start, layers.shape
    return drops_beside(np.flatnonzero(among), *grid, layers.height, layers.thickness, rise, config.max_step)


def _patches(core: BoolArray, keep: BoolArray, a: IntArray, b: IntArray) -> tuple[BoolArray, IntArray]:
    """Connected `core` nodes among those to `keep`, each patch with its rim: which nodes are in one, and in which.

    Patches are numbered by their first nodes; those that are in none have the number after the last.
    """
    wide = core & keep
    patch = components(a, b, wide)
    add_rims(a, b, core, keep, wide, patch)
    used = np.zeros(len(patch) + 1, dtype=bool)
    used[patch[wide]] = True
    number = np.cumsum(used) - 1  # what is in no patch has the number after the last one
    return wide, np.where(wide, number[patch], number[-1] + 1)


def _under_furniture(ground: BoolArray, apart: BoolArray, core: BoolArray, a: IntArray, b: IntArray) -> BoolArray:
    """Let the ground reach, without a step, where only a low body fits, and what lies behind; not onto `apart`.

    Nothing is entered from there over a step: what is low beside a stair's tread is its soffit.
    """
    reached: BoolArray = joined_to(ground, core & ~apart, a, b)
    return reached


def _is_storey(layers: Layers, nodes: BoolArray, bulk: BoolArray, config: PerceptionConfig) -> bool:
    """Whether a large surface is a floor by itself: under a ceiling, and as far over the ground; a roof has the sky."""
    room = layers.headroom[nodes]
    covered = (room >= config.storey_headroom) & np.isfinite(room)
    over = over_ground(layers, bulk, config.storey_headroom)[nodes]
    return bool(covered.mean() >= COVERED_SHARE and over.mean() <= OVER_SHARE)


@dataclass(frozen=True, slots=True)
class _Joins:
    """Steps from node `a` up or down to node `b` of another patch, and what the patches are.

    Attributes:
        a: Nodes.
        b: Nodes.
        standable: Which patches a body stands on.
        area: Of each patch [m²].
        level: Its mean height [m].
        start: Where the nodes of each patch begin in `members`.
        members: Nodes, by patch.
    """

    a: IntArray
    b: IntArray
    standable: BoolArray
    area: FloatArray
    level: FloatArray
    start: IntArray
    members: IntArray


def _joins(near: Beside, config: PerceptionConfig, wide: BoolArray, patch: IntArray) -> _Joins:
    layers = near.layers
    standable, tread = _shapes(layers, wide, patch, config)
    start, members = by_cell(patch, len(standable))
    count = np.bincount(patch[wide], minlength=len(standable))
    area = np.asarray(count * layers.cell_width**2, dtype=np.float64)
    level: FloatArray = np.bincount(patch, layers.height, len(count)).astype(np.float64)
    a, b = near.steps(wide, config.max_step, patch)
    a, b = np.concatenate([a, b]), np.concatenate([b, a])
    rise = np.abs(layers.height[a] - _level_of_furniture(layers, area <= TABLE_AREA, start, members, patch, b))
    allowed = np.where(standable[patch[b]], config.max_step, np.where(tread[patch[b]], config.stair_step, -1.0))
    return _Joins(a[rise <= allowed], b[rise <= allowed], standable, area, level / np.maximum(count, 1), start, members)


def _beside(ground: BoolArray, patch: IntArray, joins: _Joins, seen: BoolArray) -> IntArray:
    """Patches not yet seen that a step joins to the ground."""
    found = np.zeros(len(seen), dtype=bool)
    found[patch[joins.b[ground[joins.a]]]] = True
    return np.flatnonzero(found & ~seen)


def _spread(
    layers: Layers,
    config: PerceptionConfig,
    ground: BoolArray,
    low: BoolArray,
    inner: BoolArray,
    patch: IntArray,
    joins: _Joins,
    seen: BoolArray,
) -> BoolArray:
    """Grow over steps; patches that were looked at are marked in `seen`.

    `inner` nodes have all eight neighbours on their slope. Only they say whether a patch lies over ground: the edge of
    a stair's tread shares its cells with the tread below. What a body stands on, by itself, is no platform over the
    ground with `low` room, either: a coffee table; a stair's treads may be.
    """
    share = np.where(joins.standable & (joins.area <= TABLE_AREA), TABLE_OVER_SHARE, OVER_SHARE)
    under = over_ground(layers, low, config.step_headroom) & joins.standable[patch]
    size = np.bincount(patch[inner], minlength=len(seen))
    ground = ground.copy()
    while len(fresh := _beside(ground, patch, joins, seen)):
        nodes = np.concatenate([joins.members[joins.start[i] : joins.start[i + 1]] for i in fresh])
        own = np.searchsorted(fresh, patch[nodes])
        over = under[nodes] | nodes_over(nodes, layers.cell, layers.height, ground, config.step_headroom)
        refused = np.bincount(own[inner[nodes] & over], minlength=len(fresh)) > (share * size)[fresh]
        seen[fresh] = True
        ground[nodes[~refused[own]]] = True
    ground = _without_dead_ends(layers, config, ground, patch, joins)
    return ground & ~over_ground(layers, ground, config.step_headroom)


def _level_of_furniture(
    layers: Layers, small: BoolArray, start: IntArray, members: IntArray, patch: IntArray, nodes: IntArray
) -> FloatArray:
    """Height that counts for a step onto each of the `nodes`: of a `small` patch its median, else its own.

    A sofa's low front edge must not make its back a platform.
    """
    asked = np.zeros(len(small), dtype=bool)
    asked[patch[nodes]] = True
    level = medians_of(layers.height, start, members, asked & small)[patch[nodes]]
    return np.where(np.isnan(level), layers.height[nodes], level)


def _without_dead_ends(
    layers: Layers, config: PerceptionConfig, ground: BoolArray, patch: IntArray, joins: _Joins
) -> BoolArray:
    """Drop treads that lead nowhere: a stair's tread joins ground above to ground below, a sill joins two floors.

    A box on the floor joins one; so does a board, but where the scan of the floor has gaps it joins it to scraps.
    """
    a, b, standable = joins.a, joins.b, joins.standable
    level = joins.level
    rise = layers.cell_width * float(np.tan(config.steepest))
    while True:
        here, count = ground[a] & ground[b], len(level)
        one, other = patch[a[here]], patch[b[here]]
        one, other = np.divmod(np.unique(np.concatenate([one * count + other, other * count + one])), count)
        stepped_down = level[one] - level[other] > rise
        joined, below, floors = (
            np.bincount(one[kind], minlength=len(level)) for kind in (one >= 0, stepped_down, standable[other])
        )
        leads = (joined >= 2) & ((below < joined) | (floors >= 2))
        dead = ground & (~standable & ~leads)[patch]
        if not dead.any():
            return ground
        ground = ground & ~dead


def _shapes(layers: Layers, wide: BoolArray, patch: IntArray, config: PerceptionConfig) -> tuple[BoolArray, BoolArray]:
    """Which patches a body stands on, and which are long enough for a stair's tread, by their principal extents."""
    length, depth = extents_in_plan(layers.cell, layers.shape[1], wide, patch, layers.cell_width)
    return depth >= config.standing_width, (length >= config.tread_length) & (depth >= config.tread_depth)


def over_ground(layers: Layers, ground: BoolArray, headroom: float) -> BoolArray:
    """Nodes with ground under them at less than `headroom` [m]: with that of a body that steps, benches and tables."""
    over: BoolArray = over_kept(layers.cell, layers.height, ground, headroom)
    return over

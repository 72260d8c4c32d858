"""Which points are ground: layers that a body can stand on, joined by steps that it takes, from the walkable bulk."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from gpdf_service.config import PerceptionConfig
from gpdf_service.errors import NoGroundError
from gpdf_service.fields.threads import run_beside, run_chunked
from gpdf_service.perception.beside import Beside, beside, beside_now
from gpdf_service.perception.budget import LAYER_BYTES, check_grid
from gpdf_service.perception.bumps import boxes, low_things, raised_over_sides
from gpdf_service.perception.cloud import Cloud, change_layers
from gpdf_service.perception.layers import (
    APART,
    HALF,
    Layers,
    Pairs,
    build_layers,
    cell_width_of,
    connect,
    in_steps,
    layer_gap,
    nodes_of,
    widest_cell,
)
from gpdf_service.perception.nodes import (
    drops_beside,
    half_way,
    held_by,
    lowest_beside,
    mean_gradients,
    numbered_among,
    off_ground,
    over_kept,
    touched_by,
    with_rims,
)
from gpdf_service.perception.pairs import medians_around, pairs_over_gaps
from gpdf_service.perception.parts import (
    TABLE_AREA,
    accept_parts,
    build_parts,
    join_parts,
    undersides,
    without_ceilings,
    without_crumbs,
)
from gpdf_service.perception.read import check_points
from gpdf_service.perception.strides import BODY, HALF_FOOT, SOLE, STRIDE, find_between, find_footing, find_stances
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
LEVEL = np.zeros(1)
"""[m] Relief of a clean cloud's ground: what was seen is there."""
ROOF_SHARE = 0.2
"""[-] Of a roof's rim that ground can touch, the rest being a drop: a terrace at one corner, a neighbour's wall."""


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


@dataclass(frozen=True, slots=True)
class Segmentation:
    """What was found of the columns of a cloud.

    Attributes:
        near: Their nodes, and what its ground was found from.
        low: Lowest that the ground is within each node's cell [m], inf where the node is none, shape (k,).
        high: Highest, -inf where the node is none.
        beside: Height of the ground beside a node that may reach into its cell [m], inf where there is none.
        deviation: Standard deviation of the points of the ground around it [m].
        relief: What is no higher is of the ground [m], shape (k,), or (1,) where it is the same everywhere.
    """

    near: Beside
    low: FloatArray
    high: FloatArray
    beside: FloatArray
    deviation: float
    relief: FloatArray

    @property
    def layers(self) -> Layers:
        """The nodes."""
        return self.near.layers

    @property
    def scatter(self) -> FloatArray:
        """How near to the ground a point of it is [m], shape (k,), or (1,) where it is the same everywhere."""
        return scatter_of(self.deviation, self.relief)

    def lasting(self) -> Segmentation:
        """The same without what only the build needed."""
        return replace(self, near=self.near.lasting())

    def holds(self, points: FloatArray, node: IntArray) -> BoolArray:
        """Which of the points (n, 3) [m] in the nodes `node` are ground, shape (n,)."""
        held = np.empty(len(points), dtype=bool)
        ground = self.low, self.high, self.beside, np.broadcast_to(self.scatter, len(self.low)).copy()
        run_chunked(lambda a, b: held_by(points[a:b], node[a:b], ground, held[a:b]), len(points))
        return held


def first_layers(cloud: FloatArray, config: PerceptionConfig, width: float | None = None) -> Layers:
    """Layers of a whole cloud (n, 3) for a first look; the cells' width [m] is measured when it is not given."""
    check_grid(cloud, len(cloud), widest_cell(config), LAYER_BYTES, config)
    width = cell_width_of(cloud, config) if width is None else width
    check_grid(cloud, len(cloud), width, LAYER_BYTES, config)
    return build_layers(cloud, width, layer_gap(width, config))


def segment(
    cloud: FloatArray, layers: Layers, config: PerceptionConfig, noise: FloatArray | None = None
) -> tuple[BoolArray, Segmentation | None]:
    """`segment_ground` of points (n, 3) in their `first_layers`: which are ground, and what that was found from.

    None where the ground is so rough or noisy that a second look with wider cells was needed. What is no higher over
    the ground than the `noise` [m], shape (n,), that the points had there is no thing: so much can be left of it.
    """
    found, node = _segment_points(cloud, layers, config, noise)
    width = layers.cell_width
    wider = float(np.sqrt(NOISY * found.deviation * width))
    if wider <= width:
        return found.holds(cloud, node), found.lasting()
    layers = build_layers(cloud, wider, layer_gap(wider, config), found.deviation)
    found, node = _segment_points(cloud, layers, config, noise)
    return found.holds(cloud, node), None


def _segment_points(
    cloud: FloatArray, layers: Layers, config: PerceptionConfig, noise: FloatArray | None
) -> tuple[Segmentation, IntArray]:
    """What is found of the points in their layers, and the node of each."""
    node, relief = nodes_of(layers, cloud), LEVEL
    if noise is not None:
        relief = np.zeros(len(layers.cell))
        np.maximum.at(relief, node, noise)
    return segment_layers(beside(layers, _rise_of_steps(layers, config)), config, (cloud, node), relief=relief), node


def segment_layers(
    near: Beside,
    config: PerceptionConfig,
    held: tuple[FloatArray, IntArray] | None = None,
    deviation: float = 0.0,
    relief: FloatArray = LEVEL,
) -> Segmentation:
    """Find the ground in layers.

    Args:
        near: Pairs of their nodes.
        config: Limits.
        held: The points (n, 3) [m] and their nodes, which tell the deviation; else it is as given.
        deviation: Of the points of the ground around it [m].
        relief: What is no higher is of the ground [m], shape (k,), or (1,) where it is the same everywhere.
    """
    ground = find_ground(near, config, relief)
    (smooth,) = near.around("smooth", 1, _smoothed, ground)
    if held is not None:
        deviation = ROBUST * float(np.median(off_ground(*held, ground, smooth)))
    extents = partial(_extents, scatter=scatter_of(deviation, relief), config=config)
    low, high, beside = near.around("extents", 1, extents, ground, smooth)
    return Segmentation(near, low, high, beside, deviation, relief)


def change_segmentation(
    old: Segmentation, cloud: Cloud, before: BoolArray, config: PerceptionConfig
) -> tuple[Segmentation, BoolArray]:
    """The segmentation of a changed cloud, and its ground, where `before` is what it was, shape (n,)."""
    layers, cells = change_layers(old.layers, cloud, cloud.points.there, config)
    near = beside_now(old.near, layers, cells)
    found = segment_layers(near, config, deviation=old.deviation, relief=old.relief)
    rows, points = cloud.part(layers, near.other_answers("extents"))
    ground = before.copy()
    ground[rows] = found.holds(points, nodes_of(layers, points))
    return found, ground


def scatter_of(deviation: float, relief: FloatArray) -> FloatArray:
    """How near to the ground a point of it is [m], where its points have this standard deviation, or relief [m]."""
    return np.maximum(max(LEAST_SCATTER, in_steps(3.0 * deviation)), relief)


def _extents(
    layers: Layers, _: BoolArray, ground: BoolArray, smooth: FloatArray, scatter: FloatArray, config: PerceptionConfig
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


def _ground_beside(layers: Layers, ground: BoolArray, smooth: FloatArray, scatter: FloatArray) -> FloatArray:
    """Height of the lowest ground in the cells beside each node that spans it, inf where there is none.

    The foot of a wall or of a table's leg shares its cell with the floor that it stands on, and the end of a stair's
    tread with the face of the next one.
    """
    return lowest_beside(layers.columns, ground, smooth, layers.thickness + scatter)


def _smoothed(layers: Layers, _: BoolArray, ground: BoolArray) -> tuple[FloatArray]:
    """Median height of each ground node and its neighbours on the same slope: a wheel on the floor does not lift it."""
    a, b = connect(layers, ground, 2.0 * layers.cell_width)
    return (medians_around(layers.height, ground, a, b),)


def find_ground(near: Beside, config: PerceptionConfig, relief: FloatArray = LEVEL) -> BoolArray:
    """Which nodes are ground, shape (k,); a low thing on it is higher than the `relief` [m].

    Parts are sets of nodes that are joined by slopes which a body stands on. Strides between their stances join parts.
    What is joined to the bulk is ground, but for what leads nowhere: a tread or a table by itself; and so are storeys
    to which no stair was seen. Steeper ground beside it is ground, too, but for roofs.
    """
    layers, width = near.layers, near.layers.cell_width
    rise, need = width * float(np.tan(config.steepest)), _support(width)
    every = np.ones(len(layers.cell), dtype=bool)
    keep = layers.headroom >= config.step_headroom
    open_ = keep | ~over_ground(layers, every, config.step_headroom)  # or it is in a full shelf, or beneath a sofa
    smooth = near.degrees("degrees", open_, rise)
    core = open_ & (smooth >= need)
    core |= _footing(near, "footing", open_, open_ & ~core, rise)
    if not (core & keep).any():
        raise NoGroundError(*NO_SURFACE)
    stands = width * float(np.tan(config.standable_slope))
    gentle = near.degrees("gentle degrees", open_, stands) >= need
    gentle |= _footing(near, "gentle", open_, core & ~gentle, stands)
    slope = _slope(near, core, config)
    flat = core & ((smooth > need) | gentle) & (slope <= config.standable_slope)
    parts = build_parts(near, flat, keep, smooth == 8, rise, config)
    if not parts.size.any():
        raise NoGroundError(*NO_SURFACE)
    loose = near.pieces(parts.keep, rise, every)[1]
    under, parts, scraps = undersides(near, parts, core, loose, config)
    joins = join_parts(near, parts, _stances(near, parts.keep), config)
    under, parts, joins = without_ceilings(layers, parts, joins, under, scraps, config)
    if relief.any():
        parts = without_crumbs(layers, parts, joins)
    kept = accept_parts(near, parts, joins, core & ~keep & ~under, config)
    seeds = parts.flat & kept[parts.label]
    wide, low = _grown(near, core & ~under, keep, seeds, rise, config)
    asked = (wide | (keep & ~over_ground(layers, wide, config.step_headroom))) & ~seeds & ~under
    treads = seeds & ~parts.standable[parts.label]
    flight = treads | _between(near, seeds, treads, asked, config)
    found = (wide | low) & ~_roofs(near, wide | low | core, seeds, rise, config) | flight
    raised = raised_over_sides(near, found, config)
    low = low_things(near, found, raised, config) & (raised > relief)
    ground = found & ~((low | boxes(near, found, config)) & ~flight)
    if not ground.any():
        raise NoGroundError(*NO_SURFACE)
    return ground


def _stances(near: Beside, among: BoolArray) -> BoolArray:
    """`find_stances`, remembered."""
    reach = int(np.ceil(BODY / near.layers.cell_width))

    def answer(layers: Layers, asked: BoolArray, among: BoolArray) -> tuple[BoolArray]:
        return (find_stances(layers, among & asked),)

    return near.around("stances", reach, answer, among)[0]


def _footing(near: Beside, name: str, among: BoolArray, asked: BoolArray, rise: float) -> BoolArray:
    """`find_footing`, remembered."""
    width = near.layers.cell_width

    def answer(layers: Layers, again: BoolArray, among: BoolArray, asked: BoolArray) -> tuple[BoolArray]:
        return (find_footing(layers, among, asked & again, rise, _support(width)),)

    return near.around(name, int(SOLE / width) + 1, answer, among, asked)[0]


def _between(
    near: Beside, stance: BoolArray, tread: BoolArray, asked: BoolArray, config: PerceptionConfig
) -> BoolArray:
    """`find_between`, remembered."""
    reach = int(STRIDE / near.layers.cell_width)

    def answer(
        layers: Layers, again: BoolArray, stance: BoolArray, tread: BoolArray, asked: BoolArray
    ) -> tuple[BoolArray]:
        return (find_between(layers, stance, tread, asked & again, config),)

    return near.around("between", reach, answer, stance, tread, asked)[0]


def _support(width: float) -> int:
    """How many of a node's eight neighbours go on with it so that half a foot has ground, in cells so wide [m]."""
    return int(np.clip(np.ceil(HALF_FOOT / width**2 - 1e-6) - 1, 2, 5))


def _grown(
    near: Beside, core: BoolArray, keep: BoolArray, seeds: BoolArray, rise: float, config: PerceptionConfig
) -> tuple[BoolArray, BoolArray]:
    """What slopes join to the `seeds` among the `core` nodes and their rims: with headroom, and where a low body fits.

    Both of shape (k,). What lies over ground with headroom at less than that is no ground: a bench.
    """
    piece, loose, _ = near.pieces(core, rise, np.ones(len(core), dtype=bool))
    seeded = np.zeros(piece.max() + 1, dtype=bool)
    seeded[piece[seeds]] = True
    grown = core & seeded[piece]
    wide, _ = with_rims(grown, keep, piece, *loose)
    return wide & ~over_ground(near.layers, wide, config.step_headroom), grown & ~keep


def steps_over_gaps(
    near: Beside, keep: BoolArray, label: IntArray, config: PerceptionConfig
) -> tuple[Pairs, FloatArray]:
    """Steps between kept nodes with another `label` each that a gap parts, and how wide it is [m].

    Less than a foot fits in; see `pairs_over_gaps`.
    """
    layers, reach, step = near.layers, config.tread_depth, config.max_step
    far = (reach / (APART * layers.cell_width)).astype(int)
    found = [pairs_over_gaps(layers.columns, keep, step, HALF[k], far[k]) for k in range(len(HALF))]
    a, b = (np.concatenate(ends) for ends in zip(*(pairs[:2] for pairs in found), strict=True))
    wide = np.concatenate([pairs[2] * APART[k] for k, pairs in enumerate(found)])
    other = label[a] != label[b]
    return (a[other], b[other]), wide[other] * layers.cell_width


def _rise_of_steps(layers: Layers, config: PerceptionConfig) -> float:
    """As much as is asked for between two nodes: a step, or 2 √2 of the slope of a cell [m]."""
    return max(config.max_step, 3.0 * layers.cell_width * float(np.tan(config.steepest)))


def _roofs(near: Beside, smooth: BoolArray, flat: BoolArray, rise: float, config: PerceptionConfig) -> BoolArray:
    """Nodes of `smooth` pieces beside `flat` ground that are none, and end in the air nearly all round, shape (k,).

    A pitched roof whose eaves a terrace reaches is such a piece. A steep bank has ground above and below.
    """
    off = smooth & ~flat
    piece, loose, _ = near.pieces(off, rise, smooth)
    nodes, (piece, count) = np.flatnonzero(off), numbered_among(piece, off)
    own = piece[nodes]
    large = np.bincount(own, minlength=count) * near.layers.cell_width**2 > TABLE_AREA  # or it is the side of a tread
    if not large.any():
        return np.zeros(len(off), dtype=bool)
    touching = touched_by(*loose, off, flat)
    rim, ends = (np.bincount(own[kind[nodes]], minlength=count) for kind in (touching, _drops(near, off, config)))
    roof: BoolArray = np.zeros(len(off), dtype=bool)
    roof[nodes] = (large & (rim < ROOF_SHARE * (rim + ends)))[own]
    return roof


def _slope(near: Beside, ground: BoolArray, config: PerceptionConfig) -> FloatArray:
    """Slope at each ground node [rad], of the mean gradient of it and its neighbours on the same slope."""
    rise = 2.0 * near.layers.cell_width * float(np.tan(config.steepest))  # or noise would flatten it

    def answer(layers: Layers, _: BoolArray, ground: BoolArray) -> tuple[FloatArray]:
        pairs = connect(layers, ground, rise)
        gradient = mean_gradients(layers.height, layers.cell, layers.shape[1], *pairs)
        return (np.arctan(gradient / layers.cell_width),)

    return near.around("slope", 2, answer, ground)[0]


def _drops(near: Beside, among: BoolArray, config: PerceptionConfig) -> BoolArray:
    """Which nodes, of `among`, have nothing go on in one direction, and something more than a step further down."""
    rise = near.layers.cell_width * float(np.tan(config.steepest))

    def answer(layers: Layers, asked: BoolArray, among: BoolArray) -> tuple[BoolArray]:
        return (drops_beside(np.flatnonzero(among & asked), layers.columns, rise, config.max_step),)

    return near.around("drops", 1, answer, among)[0]


def over_ground(layers: Layers, ground: BoolArray, headroom: float) -> BoolArray:
    """Nodes with ground under them at less than `headroom` [m]: with that of a body that steps, benches and tables."""
    over: BoolArray = over_kept(layers.cell, layers.height, ground, headroom)
    return over

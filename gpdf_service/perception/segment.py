"""Which points are ground: layers that a body can stand on, joined by steps that it takes, from the walkable bulk."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from math import ceil
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from gpdf_service.clouds.read import check_points
from gpdf_service.config import PerceptionConfig
from gpdf_service.errors import NoGroundError
from gpdf_service.fields.threads import run_beside, run_chunked
from gpdf_service.ground.foot import HALF_FOOT, SOLE, STRIDE
from gpdf_service.perception.budget import LAYER_BYTES, check_grid
from gpdf_service.perception.bumps import boxes, low_things
from gpdf_service.perception.cloud import Cloud, change_layers
from gpdf_service.perception.parts import (
    TABLE_AREA,
    accept_parts,
    build_parts,
    join_parts,
    without_crumbs,
)
from gpdf_service.perception.slabs import undersides, without_ceilings
from gpdf_service.perception.strides import BODY, find_between, find_footing, find_stances
from gpdf_service.tiles.beside import Beside, Strips, beside, beside_now
from gpdf_service.tiles.layers import HALF, Layers, build_layers, connect, nodes_of
from gpdf_service.tiles.nodes import (
    degrees,
    drops_beside,
    half_way,
    held_by,
    joined_to,
    lowest_beside,
    mean_gradients,
    nodes_over,
    off_ground,
)
from gpdf_service.tiles.pairs import medians_around
from gpdf_service.tiles.pieces import find_pieces
from gpdf_service.tiles.width import cell_width_of, in_steps, layer_gap, widest_cell
from gpdf_service.types import BoolArray, FloatArray, IntArray

NO_SURFACE = ("ground", "no surface in the cloud is wide and level enough to stand on", "Is z up?")
"""What was looked for, what was found, what to try."""
ROBUST = 1.4826
"""[-] Standard deviation over the median of what normal residuals are off by."""
LEAST_SCATTER = 0.02
"""[m] Scatter of a good scanner's floor; three robust standard deviations of the residuals where that is more."""
LEVEL = np.zeros(1)
"""[m] Relief of a clean cloud's ground: what was seen is there."""
HALF_RISER = 0.07
"""[m] Half of a stair's lowest riser, 0.14 by DIN 18065: a cell that holds a face alone is half-way between treads."""
ROOF_SHARE = 0.2
"""[-] Of a roof's rim that ground can touch, the rest being a drop: a terrace at one corner, a neighbour's wall."""


def segment_ground(points: ArrayLike, config: PerceptionConfig | None = None) -> BoolArray:
    """Tell ground from the rest in an unlabelled cloud.

    Columns of the cloud are cut into layers; layers that are surfaces, not a wall's face, are joined into patches; from
    the bulk, the lowest of the large patches, the ground grows over steps. See `find_ground`. A noisy cloud is taken as
    it is; `build_scene` takes the noise out first.

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
    return segment(cloud, config)[0]


class Grain(NamedTuple):
    """What is told once, from all of a cloud, and kept while it changes a little.

    Attributes:
        width: Of the cells that it is looked at in [m]; None where that is to be measured.
        deviation: Standard deviation of the points of its ground around it [m]; None where that is to be measured.
        pitch: Of the voxels whose centres its points are [m]; 0 where they are none.
    """

    width: float | None = None
    deviation: float | None = None
    pitch: float = 0.0


ANY = Grain()
"""Of a cloud of which nothing is known."""


@dataclass(frozen=True, slots=True)
class Segmentation:
    """What was found of the columns of a cloud.

    Attributes:
        near: Their nodes, and what its ground was found from.
        extents: For the nodes the lowest that the ground is within each one's cell [m], inf where the node is none; the
            highest, -inf where it is none; and the height of the ground beside it that may reach into its cell [m], inf
            where there is none.
        grain: What the next versions keep of all of it.
        relief: What is no higher is of the ground [m], shape (k,), or (1,) where it is the same everywhere.
    """

    near: Beside
    extents: tuple[Strips, ...]
    grain: Grain
    relief: FloatArray

    @property
    def layers(self) -> Layers:
        """The nodes."""
        return self.near.layers

    @property
    def scatter(self) -> FloatArray:
        """How near to the ground a point of it is [m], shape (k,), or (1,) where it is the same everywhere."""
        return scatter_of(self.grain.deviation, self.relief)

    def lasting(self) -> Segmentation:
        """The same without what only the build needed."""
        return replace(self, near=self.near.lasting())

    def holds(self, points: FloatArray, node: IntArray | None = None) -> BoolArray:
        """Which of the points (n, 3) [m] that the layers were built from are ground, shape (n,).

        The `node` of each, shape (n,), is looked up when it is not given.
        """
        node, held = nodes_of(self.layers, points) if node is None else node, np.empty(len(points), dtype=bool)
        begin, end = self.near.strips_of(points)
        low, high, under = (np.concatenate(each[begin:end]) for each in self.extents)
        first = int(self.near.first[begin])
        ground = low, high, under, np.broadcast_to(self.scatter, len(self.layers.cell))[first : first + len(low)].copy()
        run_chunked(lambda a, b: held_by(points[a:b], node[a:b], first, ground, held[a:b]), len(points))
        return held


def first_layers(cloud: FloatArray, config: PerceptionConfig, width: float | None = None) -> Layers:
    """Layers of a whole cloud (n, 3) for a first look; the cells' width [m] is measured when it is not given."""
    check_grid(cloud, len(cloud), widest_cell(config), LAYER_BYTES, config)
    width = cell_width_of(cloud, config) if width is None else width
    check_grid(cloud, len(cloud), width, LAYER_BYTES, config)
    return build_layers(cloud, width, layer_gap(width, config))


def segment(
    cloud: FloatArray,
    config: PerceptionConfig,
    grain: Grain = ANY,
    noise: FloatArray | None = None,
) -> tuple[BoolArray, Segmentation]:
    """`segment_ground` of points (n, 3) of that `grain`, and what it was found from.

    What is no higher over the ground than the `noise` [m], shape (n,), that the points had there is no thing: so much
    can be left of it.
    """
    layers, relief = first_layers(cloud, config, grain.width), LEVEL
    node = nodes_of(layers, cloud)
    if noise is not None:
        relief = _relief_of(layers, node, noise)
    found = segment_layers(beside(layers), config, relief, grain, (cloud, node))
    return found.holds(cloud, node), found.lasting()


def segment_layers(
    near: Beside,
    config: PerceptionConfig,
    relief: FloatArray,
    grain: Grain,
    held: tuple[FloatArray, IntArray] | None = None,
) -> Segmentation:
    """Find the ground in layers.

    Args:
        near: Their nodes.
        config: Limits.
        relief: What is no higher is of the ground [m], shape (k,), or (1,) where it is the same everywhere.
        grain: Of the points.
        held: These (n, 3) [m], and the node of each, shape (n,), which tell the deviation where it is not known.
    """
    ground = find_ground(near, config, relief)
    (smooth,) = near.around("smooth", 1, _smoothed, ground)
    if held is not None and grain.deviation is None:
        low = np.concatenate(ground) & (near.layers.thickness <= config.max_step)  # a wall's foot tells no scatter
        off = off_ground(*held, low, np.concatenate(smooth))
        grain = grain._replace(deviation=ROBUST * float(np.median(off)) if len(off) else 0.0)
    least = scatter_of(grain.deviation, relief)
    told = (near.given("scatter", least),) if len(least) > 1 else ()
    extents = partial(_extents, config=config, least=least)
    *ends, under = near.around("extents", 2, extents, ground, smooth, *told)
    if grain.pitch > 0.0:
        ends[:] = near.around("rungs", 1, partial(_with_rungs, pitch=grain.pitch), ground, *ends)
    return Segmentation(near, (*ends, under), grain._replace(width=near.layers.cell_width), relief)


def change_segmentation(
    old: Segmentation, cloud: Cloud, before: BoolArray, config: PerceptionConfig, noise: FloatArray | None = None
) -> tuple[Segmentation, BoolArray]:
    """The segmentation of a changed cloud, and its ground, where `before` is what it was, shape (n,).

    The `noise` [m], (n,), is that which the points had there, if it was taken out; see `segment`.
    """
    layers, cells = change_layers(old.layers, cloud, cloud.points.there, config)
    relief = old.relief if noise is None else _relief_now(old, layers, cloud, cells, noise)
    found = old
    if layers is not old.layers or relief is not old.relief:
        now = beside_now(old.near, layers, cells)
        found = segment_layers(now, config, relief, old.grain)
        cells |= found.near.unlike(found.extents, old.near, old.extents)
    rows, points = cloud.part(layers, cells)
    ground = before.copy()
    ground[rows] = found.holds(points)
    return found, ground


def _relief_of(layers: Layers, node: IntArray, noise: FloatArray) -> FloatArray:
    """The most noise that the points of each node had [m], shape (k,), where these have that `node` and `noise`."""
    relief = np.zeros(len(layers.cell))
    np.maximum.at(relief, node, noise)
    return relief


def _relief_now(old: Segmentation, layers: Layers, cloud: Cloud, cells: BoolArray, noise: FloatArray) -> FloatArray:
    """`_relief_of` nodes of which those in the `cells` may be others than before; the former array where none is."""
    rows, points = cloud.part(layers, cells)
    relief, asked = _relief_of(layers, nodes_of(layers, points), noise[rows]), cells.ravel()
    relief[~asked[layers.cell]] = old.relief[~asked[old.layers.cell]]
    return old.relief if np.array_equal(relief, old.relief) else relief


def scatter_of(deviation: float | None, relief: FloatArray) -> FloatArray:
    """How near to the ground a point of it is [m], where its points have this standard deviation, or relief [m]."""
    return np.maximum(max(LEAST_SCATTER, in_steps(3.0 * (deviation or 0.0))), relief)


def _extents(
    layers: Layers,
    _: BoolArray,
    ground: BoolArray,
    smooth: FloatArray,
    *told: FloatArray,
    least: FloatArray,
    config: PerceptionConfig,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """`extents` of a `Segmentation`; the scatter is `told` for each node, or the `least` everywhere.

    The foot of a wall or of a table's leg shares its cell with the floor that it stands on, and the end of a stair's
    tread with the face of the next one: such a node spans the ground of the cells beside it.
    """
    scatter = told[0] if told else least
    beneath, across = run_beside(
        partial(lowest_beside, layers.columns, ground, smooth, layers.thickness + scatter),
        partial(_across, layers, ground, smooth, config),
    )
    low, high = across
    return np.where(_grooves(layers, ground, low - scatter), layers.height, low), high, beneath


def _with_rungs(
    layers: Layers, _: BoolArray, ground: BoolArray, low: FloatArray, high: FloatArray, pitch: float
) -> tuple[FloatArray, FloatArray]:
    """Ends `low` and `high` of the ground within each node's cell [m], with both rungs of a floor between two."""
    both, top = ground & _between_rungs(layers, pitch), layers.top
    return np.where(both, np.minimum(low, top - layers.thickness), low), np.where(both, np.maximum(high, top), high)


def _between_rungs(layers: Layers, pitch: float) -> BoolArray:
    """Nodes on two rungs of voxels, one of which all cells around show: a floor between these has points on both.

    At a step each rung has its side, and beneath what is wider than a cell nobody sees the floor.
    """
    every, columns, top = np.ones(len(layers.cell), dtype=bool), layers.columns, layers.top
    both: BoolArray = np.abs(layers.thickness - pitch) < 0.5 * pitch
    bottom, lid = (
        degrees(columns._replace(height=rung), every, 0.25 * pitch) == 2 * len(HALF)
        for rung in (top - layers.thickness, top)
    )
    both &= bottom | lid
    return both


def _grooves(layers: Layers, ground: BoolArray, low: FloatArray) -> BoolArray:
    """Ground nodes that are under the `low` end of the ground around [m] in a row: one by itself is an outlier."""
    sunk = ground & (layers.top < low)
    return sunk & (degrees(layers.columns, sunk, layers.cell_width) > 1)


def _across(
    layers: Layers, ground: BoolArray, smooth: FloatArray, config: PerceptionConfig
) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest the ground is within each ground node's cell: half-way to its neighbours on the same slope."""
    rise = layers.cell_width * float(np.tan(config.steepest))
    a, b = connect(replace(layers, height=smooth), ground, rise)
    low, high = half_way(smooth, a, b)
    return np.where(ground, low, np.inf), np.where(ground, high, -np.inf)


def _smoothed(layers: Layers, _: BoolArray, ground: BoolArray) -> tuple[FloatArray]:
    """Median height of each ground node and its neighbours on the same slope: a wheel on the floor does not lift it."""
    a, b = connect(layers, ground, 2.0 * layers.cell_width)
    return (medians_around(layers.height, ground, a, b),)


def find_ground(near: Beside, config: PerceptionConfig, relief: FloatArray = LEVEL) -> Strips:
    """Which nodes are ground; a low thing on it is higher than the `relief` [m], shape (k,), or (1,).

    Parts are sets of nodes that are joined by slopes which a body stands on. Strides between their stances join parts.
    What is joined to the bulk is ground, but for what leads nowhere: a tread or a table by itself; and so are storeys
    to which no stair was seen. Steeper ground beside it is ground, too, but for roofs.
    """
    width = near.layers.cell_width
    rise, foot = width * float(np.tan(config.steepest)), int(SOLE / width) + 1
    core, keep, flat, inner = near.around("surfaces", foot + 2, partial(_surfaces, rise=rise, config=config))
    if not any((a & b).any() for a, b in zip(core, keep, strict=True)):
        raise NoGroundError(*NO_SURFACE)
    gentle = max(HALF_RISER, width * float(np.tan(config.standable_slope)))  # or a face joins two treads in wide cells
    parts = build_parts(near, "parts", flat, keep, inner, min(rise, gentle), config)
    if not parts.size.any():
        raise NoGroundError(*NO_SURFACE)
    under, parts, scraps = undersides(near, parts, config)
    joins = join_parts(near, parts, _stances(near, parts.keep), config)
    under, parts, joins = without_ceilings(near, parts, joins, under, scraps, config)
    if relief.any():
        parts = without_crumbs(near.layers, parts, joins)
    kept = accept_parts(near, parts, joins, (core, keep, under), config)
    seeds, stands = parts.pieces.chosen("seeds", kept), parts.pieces.chosen("stands", parts.standable)
    wide, low = _grown(near, core, keep, under, seeds, rise)
    given = wide, keep, under, seeds, stands
    (flight,) = near.around("flight", int(STRIDE / width), partial(_flight, config=config), *given)
    smooth = near.each("over", lambda wide, low, core: wide | low | core, wide, low, core)
    roof = _roofs(near, smooth, seeds, rise, config)
    told = wide, low, roof, flight
    found = near.each("found", lambda wide, low, roof, flight: (wide | low) & ~roof | flight, *told)
    low = low_things(near, found, relief, config)
    told = found, low, boxes(near, found, config), flight
    ground = near.each("ground", lambda found, low, box, flight: found & ~((low | box) & ~flight), *told)
    if not any(each.any() for each in ground):
        raise NoGroundError(*NO_SURFACE)
    return ground


def _stances(near: Beside, room: Strips) -> Strips:
    """Which nodes with headroom, `room`, are stances: see `find_stances`."""

    def answer(layers: Layers, asked: BoolArray, room: BoolArray) -> tuple[BoolArray]:
        return (find_stances(layers, room & asked),)

    return near.around("stances", ceil(BODY / near.layers.cell_width), answer, room)[0]


def _surfaces(
    layers: Layers, asked: BoolArray, rise: float, config: PerceptionConfig
) -> tuple[BoolArray, BoolArray, BoolArray, BoolArray]:
    """Which nodes a foot stands on: all, with headroom to step, gentle ones, and those that go on to all sides."""
    width, need = layers.cell_width, _support(layers.cell_width)
    every = np.ones(len(layers.cell), dtype=bool)
    keep = layers.headroom >= config.step_headroom
    open_ = keep | ~over_ground(layers, every, config.step_headroom)  # or it is in a full shelf, or beneath a sofa
    smooth = degrees(layers.columns, open_, rise)
    core = open_ & (smooth >= need)
    core |= find_footing(layers, open_, open_ & ~core, rise, need)
    stands = width * float(np.tan(config.standable_slope))
    gentle = degrees(layers.columns, open_, stands) >= need
    gentle |= find_footing(layers, open_, asked & core & ~gentle, stands, need)
    slope = _slope(layers, core, config)
    flat = core & ((smooth > need) | gentle) & (_level(layers, core) | (slope <= config.standable_slope))
    return core, keep, flat, smooth == 8


def _flight(layers: Layers, again: BoolArray, *given: BoolArray, config: PerceptionConfig) -> tuple[BoolArray]:
    """Treads among the `seeds`, on which no body `stands` by itself, and what lies between; see `find_between`."""
    wide, keep, under, seeds, stands = given
    asked = (wide | (keep & ~over_ground(layers, wide, config.step_headroom))) & ~seeds & ~under
    treads = seeds & ~stands
    return (treads | find_between(layers, seeds, treads, asked & again, config),)


def _support(width: float) -> int:
    """How many of a node's eight neighbours go on with it so that half a foot has ground, in cells so wide [m]."""
    return int(np.clip(np.ceil(HALF_FOOT / width**2 - 1e-6) - 1, 2, 5))


def _grown(near: Beside, core: Strips, keep: Strips, under: Strips, seeds: Strips, rise: float) -> tuple[Strips, ...]:
    """What slopes join to the `seeds` in the `core` and at its rims: with headroom, and where a low body fits."""
    inner = near.each("inner", lambda core, under: core & ~under, core, under)
    pieces = find_pieces(near, "grown", inner, rise)
    (seeded,) = pieces.counts("seeded", seeds)
    grown = pieces.chosen("grown", seeded > 0)

    def answer(layers: Layers, _: BoolArray, grown: BoolArray, keep: BoolArray) -> tuple[BoolArray, BoolArray]:
        inner = grown & keep
        return inner | joined_to(layers.columns, keep, inner, rise), grown & ~keep

    return near.around("wide", 1, answer, grown, keep)


def _roofs(near: Beside, smooth: Strips, flat: Strips, rise: float, config: PerceptionConfig) -> Strips:
    """Nodes of `smooth` pieces beside `flat` ground that are none, and end in the air nearly all round.

    A pitched roof whose eaves a terrace reaches is such a piece. A steep bank has ground above and below.
    """

    def rims(layers: Layers, asked: BoolArray, smooth: BoolArray, flat: BoolArray) -> tuple[BoolArray, ...]:
        off = smooth & ~flat
        drops = drops_beside(np.flatnonzero(off & asked), layers.columns, rise, config.max_step)
        return off, joined_to(layers.columns, off, flat, rise), drops

    off, touching, drops = near.around("rims of roofs", 1, rims, smooth, flat)
    pieces = find_pieces(near, "roofs", off, rise)
    size, rim, ends = pieces.counts("roofs of", off, touching, drops)
    large = size * near.layers.cell_width**2 > TABLE_AREA  # or it is the side of a tread
    return pieces.chosen("roofs", large & (rim < ROOF_SHARE * (rim + ends)))


def _level(layers: Layers, ground: BoolArray) -> BoolArray:
    """Ground nodes with which half of the cells around are level: treads, though in wide cells a flight is a slope."""
    return degrees(layers.columns, ground, LEAST_SCATTER) >= len(HALF)


def _slope(layers: Layers, ground: BoolArray, config: PerceptionConfig) -> FloatArray:
    """Slope at each ground node [rad], of the mean gradient of it and its neighbours on the same slope."""
    pairs = connect(layers, ground, 2.0 * layers.cell_width * float(np.tan(config.steepest)))  # or noise flattens it
    gradient = mean_gradients(layers.height, layers.cell, layers.shape[1], *pairs)
    return np.arctan(gradient / layers.cell_width)


def over_ground(layers: Layers, ground: BoolArray, headroom: float) -> BoolArray:
    """Nodes with ground under them at less than `headroom` [m]: with that of a body that steps, benches and tables."""
    over: BoolArray = nodes_over(np.arange(len(ground)), layers.cell, layers.height, ground, headroom)
    return over

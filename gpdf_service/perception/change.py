"""What a change of a clean cloud does to its ground and its levels: only what it touches is looked at again.

What a cell holds depends on the points of its column and on cells within a known reach. So cells whose input changed
are marked, marks are widened by the reach of each stage, and only the points in marked cells are read again. What
depends on connections (which surfaces are ground, which are one sheet, what a hole is shut off by) is decided anew from
the cells of the whole scene, not from a window of it. So the result is that of the whole cloud by construction.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpdf_service.config import PerceptionConfig
from gpdf_service.fields.threads import run_parallel
from gpdf_service.perception.beside import beside_now
from gpdf_service.perception.boxes import NOWHERE, Box, widened, window
from gpdf_service.perception.columns import by_cell, runs_of, starts_spliced, values_spliced
from gpdf_service.perception.holes import MAX_HOLE_RADIUS, find_voids
from gpdf_service.perception.layers import (
    Layers,
    build_layers,
    grid_of,
    layer_gap,
    same_nodes,
    splice_layers,
)
from gpdf_service.perception.levels import (
    GroundLevel,
    Levels,
    Survey,
    Voids,
    alone,
    complete,
    find_ledges,
    find_portals,
    ground_reach,
    held_in,
    in_order,
    ledge_reach,
    lowest_and_highest,
    measure,
    sheet_part,
    sheet_surface,
    within_reach,
)
from gpdf_service.perception.notches import FLIGHT
from gpdf_service.perception.rows import (
    bounds_of,
    cells_in_box,
    more_now,
    rows_by_cell,
    rows_in_box,
    rows_in_cells,
    rows_of_cells,
    taken,
)
from gpdf_service.perception.segment import Segmentation, change_segmentation
from gpdf_service.perception.sheets import OVERLAP, split_sheets
from gpdf_service.perception.strays import find_strays
from gpdf_service.perception.surface import OBSERVED, HeightMap, changed, differ, nearest_seen, without
from gpdf_service.perception.told import Grid
from gpdf_service.types import BoolArray, FloatArray, IntArray

Touched = tuple[BoolArray | None, ...]
"""For each level the cells in which anything is another than before, shape (nx, ny), None where nothing is."""


@dataclass(frozen=True, slots=True)
class Perceived:
    """All that is known of a clean cloud; what a change starts from.

    Attributes:
        points: The cloud [m], shape (n, 3).
        ground: Which points are ground, shape (n,).
        segmentation: What the ground was found from; None where it was given.
        levels: The sheets of ground.
        survey: What they were made of.
        touched: Where the last change made anything another; empty after a build.
    """

    points: FloatArray
    ground: BoolArray
    segmentation: Segmentation | None
    levels: Levels
    survey: Survey
    touched: Touched = ()

    def lasting(self) -> Perceived:
        """The same without what only the build needed."""
        found, survey = self.segmentation, replace(self.survey, near=self.survey.near.lasting())
        return replace(self, segmentation=None if found is None else found.lasting(), survey=survey)


class WholeError(Exception):
    """The change asks for a look at the whole cloud."""


def change(
    old: Perceived, cloud: FloatArray, keep: BoolArray, labels: BoolArray | None, config: PerceptionConfig
) -> Perceived:
    """What is known after a change.

    Args:
        old: What was known.
        cloud: The points that stay and, after them, those that are new [m], shape (n, 3).
        keep: Which of the old points stay, shape (m,).
        labels: Which points of `cloud` are ground; None where the segmentation says so.
        config: Limits.

    Raises:
        WholeError: the cloud has other bounds, or another number of levels; build it as a whole.
        NoGroundError: nothing in it is walkable.
    """
    fresh = len(cloud) - int(np.count_nonzero(keep))
    places = np.concatenate([taken(old.points, np.flatnonzero(~keep)), cloud[len(cloud) - fresh :]])
    if len(places) == 0:
        return replace(old, touched=tuple(None for _ in old.levels.levels))
    known = _Cloud(cloud, places[:, :2].min(axis=0) - _AT_HAND, places[:, :2].max(axis=0) + _AT_HAND)
    before = np.concatenate([old.ground[keep], np.zeros(fresh, dtype=bool)])
    segmentation, ground = old.segmentation, labels
    if ground is None:
        if segmentation is None:
            raise WholeError
        segmentation, ground = _change_segmentation(segmentation, known, before, places, config)
    places = np.concatenate([places, cloud[np.flatnonzero(before != ground)]])
    stray = np.concatenate([old.survey.stray[keep], np.zeros(fresh, dtype=bool)])
    again = _change_strays(stray, known, ground, places, alone(old.survey.layers.cell_width))
    places = np.concatenate([places, cloud[np.flatnonzero(again != stray)]])
    _check_grid(cloud, ground, old.survey.layers, places)
    levels, survey, touched = _change_levels(old, known, ground, again, places, config)
    return Perceived(cloud, ground, segmentation, levels, survey, touched).lasting()


def _cells_with(places: FloatArray, layers: Layers) -> BoolArray:
    """Cells that hold any of `places`, shape (nx, ny)."""
    index = np.floor((places[:, :2] - layers.origin) / layers.cell_width).astype(np.int64)
    index = index[np.logical_and.reduce((index >= 0) & (index < layers.shape), axis=1)]
    found = np.zeros(layers.shape, dtype=bool)
    found[index[:, 0], index[:, 1]] = True
    return found


def _check_grid(cloud: FloatArray, chosen: BoolArray | None, layers: Layers, places: FloatArray) -> None:
    """The `chosen` points must have the grid that they had, or all else would be moved: all, if there is no choice."""
    index = np.floor((places[:, :2] - layers.origin) / layers.cell_width)
    if ((index >= _RIM) & (index < np.array(layers.shape) - _RIM)).all():
        return
    if chosen is not None and not chosen.any():
        raise WholeError
    origin, shape = grid_of(*bounds_of(cloud, chosen), layers.cell_width)
    if (origin != layers.origin).any() or shape != layers.shape:
        raise WholeError


_RIM = 3
"""Cells at a grid's rim that hold the outermost points: see `grid_of`."""


class _Cloud:
    """The changed cloud, with the points around the change at hand by their cells: they are asked for again and again.

    Attributes:
        points: All [m], shape (n, 3).
        low: Lower corner of what is at hand [m], shape (2,).
        high: Upper corner [m], shape (2,).
    """

    def __init__(self, points: FloatArray, low: FloatArray, high: FloatArray) -> None:
        self.points, self.low, self.high = points, low, high
        self._rows: IntArray = rows_in_box(points, low, high)
        self._near = taken(points, self._rows)
        self._sorted: dict[tuple[Any, ...], tuple[Box, IntArray, IntArray]] = {}

    def rows_in(self, grid: Layers | HeightMap, wanted: BoolArray) -> IntArray:
        """Rows of the points in the `wanted` cells of a grid, shape (nx, ny); sorted."""
        if not wanted.any():
            return np.zeros(0, np.int64)
        x, y = window(wanted, 1)
        low, high = (grid.origin + grid.cell_width * np.array(end) for end in ((x.start, y.start), (x.stop, y.stop)))
        if (low < self.low).any() or (high > self.high).any():
            whole: IntArray = rows_in_cells(self.points, grid.origin, grid.cell_width, wanted)
            return whole
        at_hand, start, order = self._by_cell(grid, wanted.shape)
        return self._rows[rows_of_cells(wanted[at_hand].ravel(), start, order)]

    def rows_in_box(self, low: FloatArray, high: FloatArray) -> IntArray:
        """Rows of the points between `low` and `high` in plan [m], shape (2,); sorted."""
        if (low < self.low).any() or (high > self.high).any():
            whole: IntArray = rows_in_box(self.points, low, high)
            return whole
        return self._rows[rows_in_box(self._near, low, high)]

    def _by_cell(self, grid: Layers | HeightMap, shape: tuple[int, ...]) -> tuple[Box, IntArray, IntArray]:
        """The box of cells at hand, where each begins, and the points at hand in their order."""
        key = (*grid.origin, *shape)
        if key not in self._sorted:
            first, last = (np.floor((end - grid.origin) / grid.cell_width).astype(int) for end in (self.low, self.high))
            first, last = np.clip(first, 0, shape), np.clip(last + 1, 0, shape)
            box = slice(first[0], last[0]), slice(first[1], last[1])
            flat = cells_in_box(self._near, grid.origin, grid.cell_width, first, last)
            self._sorted[key] = box, *by_cell(flat, int((last - first).prod()) + 1)
        return self._sorted[key]


_AT_HAND = 2.0 * OVERLAP
"""[m] Around a change; what is looked at again lies within it nearly always: of a house's requests 99 in 100 did."""


def _columns(cloud: _Cloud, rows: IntArray, layers: Layers, config: PerceptionConfig) -> Layers:
    """Layers of whole columns, the points `rows` of `cloud`, on the grid of `layers`."""
    return build_layers(taken(cloud.points, rows), layers.cell_width, layer_gap(layers.cell_width, config), like=layers)


def _change_layers(layers: Layers, cloud: _Cloud, rows: IntArray, cells: BoolArray, config: PerceptionConfig) -> Layers:
    fresh = _columns(cloud, rows, layers, config) if len(rows) else None
    return splice_layers(layers, cells.ravel(), fresh)


def _nodes_of(local: Layers, whole: Layers) -> IntArray:
    """Node in `whole` of each point that `local`, some of its columns, was built from."""
    nodes = whole.start[local.cell] + np.arange(len(local.cell)) - local.start[local.cell]
    made: IntArray = nodes[local.node_of_point]
    return made


def _change_segmentation(
    old: Segmentation, cloud: _Cloud, before: BoolArray, places: FloatArray, config: PerceptionConfig
) -> tuple[Segmentation, BoolArray]:
    """The segmentation of the changed cloud, and its ground, where `before` is what it was, shape (n,)."""
    _check_grid(cloud.points, None, old.layers, places)
    cells = widened(_cells_with(places, old.layers), 1)  # a node's height asks those beside
    layers = _change_layers(old.layers, cloud, cloud.rows_in(old.layers, cells), cells, config)
    found, cells = change_segmentation(old, layers, cells, config)
    rows = cloud.rows_in(layers, cells)
    ground = before.copy()
    if len(rows):
        ground[rows] = found.holds(cloud.points[rows, 2], _nodes_of(_columns(cloud, rows, layers, config), layers))
    return found, ground


def _change_strays(stray: BoolArray, cloud: _Cloud, ground: BoolArray, places: FloatArray, width: float) -> BoolArray:
    """Stray points, where those in voxels near `places` may be others than before; see `find_strays`."""
    voxel = np.floor(places[:, :2] / width)
    low, high = voxel.min(axis=0), voxel.max(axis=0) + 1.0
    near = cloud.rows_in_box((low - 3.0) * width, (high + 3.0) * width)
    points = taken(cloud.points, near)
    column = np.floor(points[:, :2] / width)  # one on, another may be alone now, and asks one further
    inside = (column >= low - 1.0) & (column < high + 1.0)
    sure = inside[:, 0] & inside[:, 1]
    made = stray.copy()
    made[near[sure]] = find_strays(points, width)[sure]
    return made & ~ground


def _change_levels(
    old: Perceived,
    cloud: _Cloud,
    ground: BoolArray,
    stray: BoolArray,
    places: FloatArray,
    config: PerceptionConfig,
) -> tuple[Levels, Survey, Touched]:
    layers = old.survey.layers
    cells = widened(_cells_with(places, layers), 1)
    rows = cloud.rows_in(layers, cells)
    rows = rows[ground[rows]]
    layers = _change_layers(layers, cloud, rows, cells, config)
    near, sheets = old.survey.near, old.survey.sheets
    if not same_nodes(layers, near.layers):  # as where something was put onto the ground
        near = beside_now(near, layers, cells)
        sheets = split_sheets(near, config)
    if len(sheets) != len(old.levels.levels):
        raise WholeError

    def one(i: int) -> tuple[GroundLevel, Voids, Grid, IntArray, BoolArray | None]:
        survey, level, (own, inside) = old.survey, old.levels.levels[i], sheet_part(layers, sheets[i])
        if own.shape != level.surface.height.shape or (own.origin != level.surface.origin).any():
            raise WholeError
        corner = np.round((own.origin - layers.origin) / layers.cell_width).astype(int)
        felt = cells[corner[0] : corner[0] + own.shape[0], corner[1] : corner[1] + own.shape[1]]
        grid = survey.grids[i].now(np.zeros_like(felt))
        seen = sheet_surface(grid, own, np.flatnonzero(inside), config.max_step)
        part = _Part(cloud, ground, stray, own, inside, seen, grid, felt)
        return _change_level(level, survey.voids[i], survey.first[i], part, config)

    known, voids, grids, first, touched = zip(*run_parallel(one, range(len(sheets))), strict=True)
    survey = Survey(near, stray, sheets, voids, grids, first)
    return Levels(known, find_portals(layers, sheets)), survey, touched


@dataclass(frozen=True, slots=True)
class _Part:
    """What one level is made of.

    Attributes:
        cloud: After the change.
        ground: Which of its points are ground, shape (n,).
        stray: Which count for nothing, shape (n,).
        layers: Of the ground points.
        inside: Which of their nodes are of this level, shape (k,).
        seen: Its ground as it was seen.
        grid: What was asked of its cells.
        cells: Columns that hold other points than before, and those beside, shape (nx, ny).
    """

    cloud: _Cloud
    ground: BoolArray
    stray: BoolArray
    layers: Layers
    inside: BoolArray
    seen: HeightMap
    grid: Grid
    cells: BoolArray

    def rest(self, cells: BoolArray, config: PerceptionConfig) -> FloatArray:
        """Points in `cells` that are not of this sheet."""
        rows = self.cloud.rows_in(self.layers, cells)
        rows = rows[~self.stray[rows]]
        mine = self.ground[rows]
        if mine.any():
            mine[mine] = self.inside[_nodes_of(_columns(self.cloud, rows[mine], self.layers, config), self.layers)]
        rest: FloatArray = taken(self.cloud.points, rows[~mine])
        return rest


def _change_level(
    old: GroundLevel, voids: Voids, first: IntArray, part: _Part, config: PerceptionConfig
) -> tuple[GroundLevel, Voids, Grid, IntArray, BoolArray | None]:
    width, seen = part.seen.cell_width, part.seen
    was = without(old.surface, old.surface.state != OBSERVED)  # as it was seen
    moved = differ(was.height, seen.height)
    cells = part.cells | _felt(was, seen, moved)
    box, rest = _around(cells, width), part.rest(cells, config)
    fresh = within_reach(rest, seen, box)
    now = _change_voids(voids, cells, find_voids(seen, rest, config.max_step, box=box), box)
    other, ledge, begin = old.other_points, old.ledge, first
    gone = rows_by_cell(cells, first)
    lost = taken(other, gone)
    swapped = _other_cells(seen, lost, fresh)
    before = np.column_stack([lost, ledge[gone]])
    if swapped.any():
        (fresh, new), flat = in_order(fresh, seen), cells.ravel()
        begin, runs = starts_spliced(flat, first, new), runs_of(flat, first, new)
        other = values_spliced(runs, other, fresh)
        ledge = values_spliced(runs, ledge, np.full(len(fresh), np.inf, np.float32))
    surface, measured, limits = old.surface, old.measured, old.limits
    again = moved.any() or swapped.any() or any((a != b).any() for a, b in zip(now, voids, strict=True))
    grid = replace(part.grid, others=swapped)
    if again:
        surface, guarded = complete(grid, seen, partial(held_in, other, begin, seen), now, config)
        measured, limits = measure(grid, surface, guarded)
    else:
        grid = replace(grid, known=grid.former)
    other_ground = changed(old.surface, surface)
    asked = rows_by_cell(cells | _ledge_cells(part, surface, other_ground), begin)
    places = taken(other, asked)
    found = _ledges_of(part, surface, places, config)
    after = cells[surface.cells(places)[:2]]
    stepped = _cells_with(places[ledge[asked] != found], part.layers) & ~cells
    stepped |= _other_cells(surface, before, np.column_stack([places[after], found[after]]))
    ledge = ledge.copy()
    ledge[asked] = found
    touched = widened(stepped | other_ground, 1) | grid.other_answers("measured", "edges")  # all that limits tell
    if not touched.any():
        return old, now, grid.lasting(), begin, None
    return GroundLevel(surface, other, ledge, limits, measured), now, grid.lasting(), begin, touched


def _around(cells: BoolArray, width: float) -> Box:
    """The cells whose ground says what the points in `cells` are to a level, of cells `width` wide [m]."""
    return window(cells, int(np.ceil(max(OVERLAP, MAX_HOLE_RADIUS) / width)) + _FILTERS)


_FILTERS = 4
"""Cells that two filters after another reach."""


def _felt(was: HeightMap, now: HeightMap, moved: BoolArray) -> BoolArray:
    """Cells whose points can be something else to a level because its ground `moved` near them."""
    if not moved.any():
        return moved
    box = _around(widened(moved, int(np.ceil(MAX_HOLE_RADIUS / now.cell_width))), now.cell_width)
    (low, high), (low_now, high_now) = (lowest_and_highest(surface, box) for surface in (was, now))
    near, near_now = (nearest_seen(surface, box) for surface in (was, now))
    hole, hole_now = ((part.distance <= MAX_HOLE_RADIUS) & (part.distance > 0.0) for part in (near, near_now))
    felt = widened(moved, max(_FILTERS, int(FLIGHT / now.cell_width)))
    felt[box] |= (low != low_now) | (high != high_now) | (hole != hole_now)
    felt[box] |= (hole | hole_now) & differ(near.height, near_now.height)
    return felt


def _change_voids(voids: Voids, cells: BoolArray, found: Voids, box: Box) -> Voids:
    """The voids with those that were `found` in a box, where they are asked for in `cells`."""
    made = [old.copy() for old in voids]
    for whole, part in zip(made, found, strict=True):
        whole[box] = np.where(cells[box], part, whole[box])
    through, pit, walls = made
    return through, pit, walls


def _other_cells(surface: HeightMap, was: FloatArray, now: FloatArray) -> BoolArray:
    """Cells that hold other points than before: rows of x, y, z and what else tells them apart."""
    both = np.concatenate([was, now])
    found = np.zeros(surface.height.shape, dtype=bool)
    ix, iy, _ = surface.cells(both[more_now(hashed(both), len(was)) != 0])
    found[ix, iy] = True
    return found


def hashed(rows: FloatArray) -> NDArray[np.uint64]:
    """One number for each row of up to four columns, shape (n,): the same for the same row."""
    mixed = (rows.view(np.uint64) * _MIX[: rows.shape[1]]).sum(axis=1, dtype=np.uint64)
    made: NDArray[np.uint64] = mixed ^ (mixed >> np.uint64(29))
    return made


_MIX = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9, 0xD6E8FEB86659FD93], dtype=np.uint64)
"""Odd numbers without a pattern: two points get one sum of products with a chance of 2⁻⁶⁴."""


def _ledge_cells(part: _Part, surface: HeightMap, other: BoolArray) -> BoolArray:
    """Cells in which a ledge can be another than before, because the ground is in the `other` cells."""
    return widened(part.cells | widened(other, ledge_reach(surface)), ground_reach(surface))


def _ledges_of(part: _Part, surface: HeightMap, other: FloatArray, config: PerceptionConfig) -> NDArray[np.float32]:
    cells = np.zeros(surface.state.shape, dtype=bool)
    cells[surface.cells(other)[:2]] = True
    reach = ground_reach(surface)
    rows = part.cloud.rows_in(part.layers, widened(cells, reach))
    box = window(cells, reach + ledge_reach(surface)) if len(other) else NOWHERE
    ground = taken(part.cloud.points, rows[part.ground[rows]])
    return find_ledges(surface, ground, other, config.max_step, box=box)

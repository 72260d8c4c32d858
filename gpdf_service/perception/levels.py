"""Levels: each sheet of the ground with what a body could touch on it, and where they meet."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from math import ceil
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gpdf_service.config import PerceptionConfig
from gpdf_service.errors import NoGroundError
from gpdf_service.fields.threads import run_beside, run_chunked, run_parallel
from gpdf_service.perception.budget import KEPT_BYTES, LEVEL_BYTES, check_grid, give_back
from gpdf_service.perception.cloud import Cloud, Rows, change_layers
from gpdf_service.perception.footing import (
    FLIGHT_RISE,
    bridged,
    flights,
    footing_reach,
    ridges,
    ridges_reach,
    rings_of,
)
from gpdf_service.perception.hidden import faces_reach, find_faces, hidden_reach, without_hidden
from gpdf_service.perception.holes import (
    MAX_HOLE_RADIUS,
    Voids,
    fill_holes,
    find_rims,
    find_voids,
    standing,
)
from gpdf_service.perception.ledges import LEAST_OBSTACLE, find_ledges, ground_reach, ledge_reach, ledges_felt
from gpdf_service.perception.limits import (
    GroundLimits,
    Measured,
    find_limits,
    limits_reach,
    neighbourhood,
    smoothed,
    step_and_slope,
)
from gpdf_service.perception.notches import FLIGHT, NOTCH_DEPTH, between_treads
from gpdf_service.perception.overhead import Columns, over_head, unseen_asks, unseen_beneath
from gpdf_service.perception.rays import Rays, seen_by_rays
from gpdf_service.perception.segment import LEAST_SCATTER
from gpdf_service.perception.sheets import OVERLAP, split_sheets
from gpdf_service.perception.smooth import RESOLVED_STEP, to_centres, with_rims
from gpdf_service.perception.strays import find_strays
from gpdf_service.tiles.beside import Beside, beside, beside_now
from gpdf_service.tiles.boxes import WHOLE, Box, highest_around, lowest_around, widened, window
from gpdf_service.tiles.columns import (
    by_cell,
    ends_in_plan,
    put_heights_in_plan,
    runs_of,
    starts_spliced,
    take_out,
    unlike_cells,
    values_spliced,
)
from gpdf_service.tiles.layers import (
    BLOCK,
    Layers,
    build_layers,
    cell_width_of,
    layer_gap,
    widest_cell,
)
from gpdf_service.tiles.points import Points, points_of
from gpdf_service.tiles.rows import INDEX, between, chosen_rows, extent_within, rows_by_cell, taken, under
from gpdf_service.tiles.surface import (
    OBSERVED,
    UNKNOWN,
    HeightMap,
    Nearest,
    cells_within,
    changed,
    cropped,
    first_cell,
    is_same_ground,
    nearest_seen,
    placed,
)
from gpdf_service.tiles.told import Grid, boxes_of, grown, moved, new_grid, shared
from gpdf_service.types import BoolArray, FloatArray, IntArray

ALONE = 0.25
"""[m] A point with no other in the voxels of this width around its own is a reflection; even a thin cable has more."""
ASKED = 16
"""Of so many nodes of a sheet one is asked of which level before it is."""
PICKED = 0.4
"""[-] Share of the cells of a cloud from which on all points are read: to pick one out takes as long as to read two."""
TALLEST = 3.0
"""[m] Material higher than this over the ground is out of every body's reach."""


@dataclass(frozen=True)
class GroundLevel:
    """One sheet of ground.

    Attributes:
        surface: Its height map.
        other_points: What is not this ground and within reach over it [m], shape (m, 3).
        ledge: Height of the lowest point of this ground that is as high as each of them, within `face_reach` in plan
            [m], shape (m,), inf where there is none: a step's face has the step's top beside it.
        measured: Steps and slopes of the ground, the same for all bodies.
        edges: Cells in which material guards the ground's edge, and those on a ridge, each of shape (nx, ny).
    """

    surface: HeightMap
    other_points: FloatArray
    ledge: NDArray[np.float32]
    measured: Measured
    edges: tuple[BoolArray, BoolArray]

    @cached_property
    def limits(self) -> GroundLimits:
        """Where the ground itself stops a body."""
        return self.limits_in(np.ones(self.surface.state.shape, dtype=bool))

    def limits_in(self, cells: BoolArray) -> GroundLimits:
        """Where it does so in some cells, shape (nx, ny)."""
        return find_limits(self.surface, self.edges[0], self.measured, self.edges[1], cells)

    @property
    def ground_points(self) -> FloatArray:
        """Centres of the known cells, for the Ground GPDF [m], shape (n, 3)."""
        return self.surface.centres(self.surface.state != UNKNOWN)

    @property
    def inferred(self) -> BoolArray:
        """Which of the `ground_points` nobody has seen, shape (n,)."""
        state = self.surface.state
        guessed: BoolArray = state[state != UNKNOWN] != OBSERVED
        return guessed


@dataclass(frozen=True, slots=True)
class Portal:
    """Where the sheets `a` and `b` are the same ground: points [m], shape (k, 3)."""

    a: int
    b: int
    points: FloatArray


@dataclass(frozen=True, slots=True)
class Levels:
    """All sheets, and the portals between them."""

    levels: tuple[GroundLevel, ...]
    portals: tuple[Portal, ...]


Held = tuple[IntArray, FloatArray, FloatArray]
"""Flat cell and height [m] of each other point, shape (m,), and the lowest of each cell [m]."""


@dataclass(frozen=True, slots=True)
class Made:
    """A level, and what it was made of.

    Attributes:
        level: The level.
        grid: What was asked of its cells.
        first: Where the other points of each cell begin, shape (cells + 1,): they are in this order.
        touched: Cells in which anything is another than in the version before, shape (nx, ny); None where nothing is.
    """

    level: GroundLevel
    grid: Grid
    first: IntArray
    touched: BoolArray | None


@dataclass(frozen=True, slots=True)
class Survey:
    """What levels were made of, kept for the next version of a scene.

    Attributes:
        near: Layers of the ground points, and what was asked of their nodes.
        stray: Which points of the cloud count for nothing, shape (n,).
        sheets: Which nodes are of each level, shape (k,).
        made: Each level.
        former: Which level of the version before each was made from, -1 where there was none.
    """

    near: Beside
    stray: BoolArray
    sheets: tuple[BoolArray, ...]
    made: tuple[Made, ...]
    former: tuple[int, ...]

    @property
    def layers(self) -> Layers:
        """Of the ground points."""
        return self.near.layers


@dataclass(frozen=True, slots=True)
class _Site:
    """What all levels of a cloud are made of.

    Attributes:
        cloud: Its points, by numbers up to n.
        ground: Which of them are ground, shape (n,).
        stray: Which count for nothing, shape (n,).
        layers: Of the ground points.
        cells: The columns that hold other points than in the version before, and those beside; in a build all.
        config: Limits.
        noise: Standard deviation that the points had before they were cured [m].
        rays: Of the scan, where they are known.
    """

    cloud: Cloud
    ground: BoolArray
    stray: BoolArray
    layers: Layers
    cells: BoolArray
    config: PerceptionConfig
    noise: float = 0.0
    rays: Rays | None = None


def survey_levels(
    points: FloatArray,
    ground: BoolArray,
    config: PerceptionConfig,
    *,
    width: float | None = None,
    noise: float = 0.0,
    rays: Rays | None = None,
    held: Points | None = None,
) -> tuple[Levels, Survey]:
    """Build the sheets from labelled points, and say what they were made of.

    Args:
        points: The cloud [m], shape (n, 3).
        ground: Which points are ground, shape (n,).
        config: Limits.
        width: Of the cells [m]; measured on the ground when not given.
        noise: Standard deviation that the points had before they were cured [m].
        rays: Of the scan, where they are known: they tell what inferred ground is free, and not rules.
        held: The same points, where the versions that follow share them.

    Raises:
        NoGroundError: no point is ground.
    """
    if not ground.any():
        raise NoGroundError(
            "ground", "no point of the cloud is labelled ground", "Check the labels, or leave them out."
        )
    floor = chosen_rows(points, ground)
    check_grid(floor, len(points), widest_cell(config), LEVEL_BYTES, config)
    width = cell_width_of(floor, config) if width is None else width
    check_grid(floor, len(points), width, LEVEL_BYTES, config)

    def find_sheets(floor: FloatArray) -> tuple[Beside, tuple[BoolArray, ...]]:
        near = beside(build_layers(floor, width, layer_gap(width, config)))
        return near, split_sheets(near, config)

    (near, sheets), stray = run_beside(partial(find_sheets, floor), partial(find_strays, points, alone(width)))
    if not sheets:
        found = f"no piece of the ground is as large as three by three cells of {width:.2g} m"
        raise NoGroundError("ground", found, "Are its samples further apart than a foot bridges? Scan it more densely.")
    kept = sum(np.prod(part_of(near.layers, sheet).shape) for sheet in sheets) / np.prod(near.layers.shape) - 1.0
    check_grid(floor, len(points), width, LEVEL_BYTES + KEPT_BYTES * max(kept, 0.0), config)
    stray &= ~ground
    del floor
    cells = np.ones(near.layers.shape, dtype=bool)
    return _levels_of(
        _Site(Cloud(held or points_of(points), points[:0]), ground, stray, near.layers, cells, config, noise, rays),
        near,
        sheets,
    )


def change_levels(
    old: Survey, cloud: Cloud, ground: BoolArray, stray: BoolArray, config: PerceptionConfig
) -> tuple[Levels, Survey]:
    """`survey_levels` of a changed cloud.

    Raises:
        WholeError: the ground has other bounds.
    """
    layers, cells = change_layers(old.layers, cloud, ground, config)
    near, sheets = old.near, old.sheets
    if layers is not near.layers:
        near = beside_now(near, layers, cells)
        sheets = split_sheets(near, config)
    return _levels_of(_Site(cloud, ground, stray, layers, cells, config), near, sheets, old.made)


def _levels_of(
    site: _Site, near: Beside, sheets: tuple[BoolArray, ...], before: tuple[Made, ...] = ()
) -> tuple[Levels, Survey]:
    """The levels of the sheets, each made from the one before that has most of its ground, if there is one."""
    parts = [part_of(site.layers, sheet) for sheet in sheets]
    former = _former_of(site.layers, parts, [each.level.surface for each in before])

    def make(i: int) -> Made:
        return _make_level(site, sheets[i], parts[i], before[former[i]] if former[i] >= 0 else None)

    made = tuple(run_parallel(make, range(len(sheets))))
    levels = Levels(tuple(each.level for each in made), find_portals(near.layers, sheets))
    return levels, Survey(near, site.stray, sheets, made, tuple(former))


def _former_of(layers: Layers, parts: list[Part], before: list[HeightMap]) -> list[int]:
    """Number of the ground before with which each part shares most, for each another one; −1 where none is left."""
    if len(parts) == len(before) and all(map(_same_box, before, parts)):
        return list(range(len(parts)))
    same, former = np.array([[_shared(layers, part, each) for each in before] for part in parts]), [-1] * len(parts)
    while same.size and same.max() > 0:
        i, k = np.unravel_index(same.argmax(), same.shape)
        same[i], same[:, k], former[i] = 0, 0, int(k)
    return former


def _same_box(surface: HeightMap, part: Part) -> bool:
    """Whether a height map's cells are those of a part."""
    return surface.state.shape == part.shape and bool((surface.origin == part.origin).all())


def _shared(layers: Layers, part: Part, surface: HeightMap) -> int:
    """How many of some nodes of a part a height map has for the same ground."""
    nodes, (x, y) = part.nodes[::ASKED], first_cell(surface, part.origin)
    i, j = np.divmod(layers.cell[nodes], layers.shape[1])
    i, j, (nx, ny) = i - (part.first[0] - x), j - (part.first[1] - y), surface.state.shape
    inside = (i >= 0) & (i < nx) & (j >= 0) & (j < ny)
    height = surface.height[i[inside], j[inside]]
    return int(np.count_nonzero(is_same_ground(height, layers.height[nodes[inside]], surface.cell_width)))


def find_portals(layers: Layers, sheets: tuple[BoolArray, ...]) -> tuple[Portal, ...]:
    """Where sheets are the same ground."""
    portals = []
    for a in range(len(sheets)):
        for b in range(a + 1, len(sheets)):
            both = np.flatnonzero(sheets[a] & sheets[b])
            if len(both):
                flat = np.column_stack(np.divmod(layers.cell[both], layers.shape[1]))
                centres = layers.origin + (flat + 0.5) * layers.cell_width
                portals.append(Portal(a, b, np.column_stack([centres, layers.height[both]])))
    return tuple(portals)


def alone(width: float) -> float:
    """Width of the voxels that a stray point is alone in [m], beside cells of `width`."""
    return max(ALONE, 3.0 * width)


def count_undecided(level: GroundLevel, noise: float = 0.0) -> int:
    """Points at the ground that are not called ground though they lie within twice its scatter: ground, or a sill.

    Args:
        level: One sheet.
        noise: Standard deviation of the cloud's points [m].
    """
    ix, iy, _ = level.surface.cells(level.other_points)
    off = np.abs(level.other_points[:, 2] - level.surface.height[ix, iy])  # NaN, where it is unknown, compares false
    return int(np.count_nonzero(off <= 2.0 * max(LEAST_SCATTER, 3.0 * noise)))


class Part(NamedTuple):
    """The nodes of a sheet, and the box of cells that holds it: its lower corner [m], first cell and shape."""

    nodes: IntArray
    origin: FloatArray
    first: tuple[int, int]
    shape: tuple[int, int]


def part_of(layers: Layers, sheet: BoolArray) -> Part:
    """The box that holds the sheet of these nodes, shape (k,), and what decides on it.

    What stands beside a sheet counts within `OVERLAP`, and no hole in it is wider. The box is one of whole blocks of
    cells: so it stays where the ground changes a little.
    """
    nodes, by = np.flatnonzero(sheet), ceil(OVERLAP / layers.cell_width) + 1
    (x, end_x), (y, end_y) = (
        (max((low - by) // BLOCK * BLOCK, 0), min(((high + by) // BLOCK + 1) * BLOCK, size))
        for (low, high), size in zip(ends_in_plan(layers.cell, layers.shape[1], nodes), layers.shape, strict=True)
    )
    return Part(nodes, layers.origin + layers.cell_width * np.array([x, y]), (x, y), (end_x - x, end_y - y))


def _make_level(site: _Site, sheet: BoolArray, part: Part, before: Made | None) -> Made:
    """The level of the nodes of a `sheet`. A build is a change from `_nothing`.

    What a cell holds depends on the points of its column and on cells within a known reach: so only the cells are
    looked at, and the points in them read, for which any of this is another than before.
    """
    (x, y), (nx, ny), config = part.first, part.shape, site.config
    was, columns = before or _nothing(part, site.layers.cell_width), np.ones(part.shape, dtype=bool)
    fresh = np.zeros_like(columns)
    if before is not None:
        columns = site.cells[x : x + nx, y : y + ny]
        if not _same_box(before.level.surface, part):
            was = _moved(before, part)
            fresh = was.grid.others
    grid = was.grid.now(columns | fresh)
    seen = sheet_surface(grid, site.layers, part, config.max_step, site.noise)
    if not grid.felt("seen", 0, *grid.known["seen"].given, points=True).any():
        return replace(was, touched=None)
    near = Nearest(*grid.whole("near", lambda *_: nearest_seen(seen), seen.height, seen.state))
    held = _find_others(site, sheet, seen, near, grid, was)
    grid = replace(grid, others=held.unlike)
    surface, measured, both = was.level.surface, was.level.measured, was.level.edges
    if (grid.felt("voids", 0, *grid.known["voids"].given, points=True) | grid.other_answers("seen", "voids")).any():
        holds = partial(held_in, held.points, held.first, seen)
        surface, guarded = complete(grid, seen, holds, grid.known["voids"].made, near, site)
        del near, holds
        if before is None:
            give_back(len(site.ground))
        *told, ridge = measure(grid, surface)
        measured, both = (told[0], told[1]), (guarded, ridge)
    else:  # they are told by nothing else
        grid = replace(grid, known=was.grid.known | grid.known)
    other = changed(was.level.surface, surface) | fresh
    surface = surface if other.any() else was.level.surface  # versions share it
    felt = columns | ledges_felt(other, was.level.surface, surface) | widened(fresh, ledge_reach(surface))
    asked = widened(felt, ground_reach(surface)) | held.unlike
    ledge = _find_ledges_in(site, surface, held, asked)
    stepped = held.unlike | unlike_cells(asked, was.first, was.level.ledge[:, None], held.first, ledge[:, None])
    touched = widened(stepped | other, 1) | grid.other_answers("measured", "ridges", "edges")  # all that limits tell
    if not touched.any():
        return Made(was.level, grid.lasting(), held.first, None)
    return Made(GroundLevel(surface, held.points, ledge, measured, both), grid.lasting(), held.first, touched)


def _moved(made: Made, part: Part) -> Made:
    """What a level was made of, in the box of a `part`; the `others` of its grid are cells that never were asked."""
    level, ground = made.level, made.level.surface
    by = first_cell(ground, part.origin)
    inside = np.zeros(ground.state.shape, dtype=bool)
    inside[shared(by, inside.shape, part.shape)[0]] = True
    rows = rows_by_cell(inside, made.first)
    count = moved(np.diff(made.first).reshape(inside.shape), by, part.shape, 0)
    surface = placed(ground, part.origin, part.shape)
    level = replace(level, surface=surface, other_points=taken(level.other_points, rows), ledge=level.ledge[rows])
    return Made(level, made.grid.moved(by, part.shape), np.concatenate([[0], np.cumsum(count)]), None)


def _nothing(part: Part, width: float) -> Made:
    """What is known of a level before anything was scanned, in cells of that `width` [m]."""
    height, count = np.full(part.shape, np.nan, np.float32), part.shape[0] * part.shape[1]
    surface = HeightMap(part.origin, width, height, np.zeros(part.shape, np.uint8))
    measured, edges = (np.zeros(0), np.zeros(0)), (np.zeros(0, dtype=bool), np.zeros(0, dtype=bool))
    level = GroundLevel(surface, np.zeros((0, 3)), np.zeros(0, np.float32), measured, edges)
    return Made(level, new_grid(part.shape), np.zeros(count + 1, np.int64), None)


class _Others(NamedTuple):
    """The other points of a level [m], shape (m, 3), and their ledges; where those of each cell begin.

    Beside these the cells that hold others than before, shape (nx, ny).
    """

    points: FloatArray
    ledge: NDArray[np.float32]
    first: IntArray
    unlike: BoolArray


def _read(site: _Site, cells: BoolArray) -> BoolArray:
    """The cells, or all of their grid where most of the cloud is in them: then to pick out points costs more."""
    return np.ones_like(cells) if np.count_nonzero(cells) > PICKED * site.cells.size else cells


def _near_cells(high: FloatArray, width: float, config: PerceptionConfig) -> BoolArray:
    """Cells whose points can tell a level anything, (nx, ny), by the `high` ground within `OVERLAP` of each [m].

    No void is further from ground than `MAX_HOLE_RADIUS`, which is less, and no underside further than `widest_gap`
    from what is over the ground there.
    """
    return widened(np.isfinite(high), rings_of(config.widest_gap, width))


def _columns_in(site: _Site, sheet: BoolArray, seen: HeightMap, cells: BoolArray, near: BoolArray) -> Columns:
    """The points in some cells `near` the ground, but for strays and the ground of a `sheet`: these are in no cell."""
    box, (rows, points) = window(cells, 0), site.cloud.part(seen, _read(site, cells & near))
    cell, stray, ground = cells_within(points, seen, box), site.stray[rows], site.ground[rows]
    nodes = site.layers.grid_of(points), sheet, seen.state[box].size
    run_chunked(lambda a, b: take_out(points[a:b], stray[a:b], ground[a:b], *nodes, cell[a:b]), len(points))
    return Columns(box, cell, points, ground)


def _flat_cells(box: Box, cells: BoolArray) -> IntArray:
    """Flat cell in the grid of each in a box, and behind them that of none; so is that of all but the `cells`."""
    (rows, columns), (nx, ny) = grown(box, 0, cells.shape), cells.shape
    flat = np.add.outer(np.arange(rows.start * ny, rows.stop * ny, ny), np.arange(columns.start, columns.stop))
    made: IntArray = np.append(np.where(cells[box], flat, nx * ny).ravel(), nx * ny).astype(INDEX)
    return made


def _find_others(site: _Site, sheet: BoolArray, seen: HeightMap, near: Nearest, grid: Grid, was: Made) -> _Others:
    """The points within reach over the seen ground of a `sheet`, and into the grid its voids, see `find_voids`."""
    width, max_step = seen.cell_width, site.config.max_step

    def answer(_: Box, height: NDArray[np.float32], state: NDArray[np.uint8]) -> tuple[NDArray[Any], ...]:
        part = replace(seen, height=height, state=state)
        treads = (state != UNKNOWN) & flights(part, max_step, FLIGHT)
        return *lowest_and_highest(part), treads, find_rims(part)

    reach = ceil(max(OVERLAP, FLIGHT) / width) + 3
    low, high, treads, rim = grid.around("span", reach, answer, seen.height, seen.state)
    beside = np.where(near.distance <= MAX_HOLE_RADIUS, near.height, np.float32(np.nan))
    own = grid.known["seen"].given[0], beside
    asked, within = unseen_asks(grid, *own, width, site.config), _near_cells(high, width, site.config)
    columns = _columns_in(site, sheet, seen, asked, within)
    hidden = unseen_beneath(grid, columns, *own, width, site.config)
    given = *own, seen.height, low, high, treads, rim, hidden
    cells = grid.felt("voids", 0, *given, points=True)
    box, cell, points, ground = columns if asked.all() else _columns_in(site, sheet, seen, cells, within)
    part, shown, z = cropped(seen, box), Nearest(near.distance[box], near.height[box]), points[:, 2]
    near_by, found = run_beside(
        partial(between, cell, z, under(low[box] - width), high[box] + TALLEST),
        partial(find_voids, part, shown, treads[box], rim[box], cell, z, max_step),
    )
    grid.put("voids", given, cells, [(box, found)] if cells.any() else [])
    over = np.where(hidden[box], over_head(beside[box], site.config), np.inf)
    deep = between(np.where(ground, cell, cell.dtype.type(over.size)), z, over, np.full(over.shape, np.inf))
    cell, out = _flat_cells(box, cells)[np.where(near_by, cell, over.size)], cells.size
    begin, order = by_cell(cell, out + 1)
    fresh, begin = taken(points, order[: begin[-2]]), begin[:-1]
    fresh[deep[order[: len(fresh)]], 2] -= max_step  # ground over head counts as what it may reach down to
    unlike = cells if cells.all() else unlike_cells(cells, was.first, was.level.other_points, begin, fresh)
    places = unlike.ravel(), was.first, begin
    first, runs = starts_spliced(*places), runs_of(*places)
    other = values_spliced(runs, was.level.other_points, fresh)
    ledge = values_spliced(runs, was.level.ledge, np.full(len(fresh), np.inf, np.float32))
    return _Others(other, ledge, first, unlike)


def _find_ledges_in(site: _Site, surface: HeightMap, held: _Others, asked: BoolArray) -> NDArray[np.float32]:
    """The ledges, `find_ledges`, with those in the cells that are `asked` for told anew, box after box."""
    ledge, shape = held.ledge.copy(), surface.state.shape
    reach = max(shape) if site.noise > 0.0 else ground_reach(surface) + ledge_reach(surface)  # noise asks others, too
    for box in boxes_of(asked, reach):
        outer, cells = grown(box, reach, shape), np.zeros(shape, dtype=bool)
        cells[grown(box, ground_reach(surface), shape)] = True
        own, floor = rows_in(held.first, box, shape), site.cloud.chosen(surface, _read(site, cells), site.ground)
        ledge[own] = find_ledges(surface, floor, held.points[own], site.config.max_step, site.noise, outer)
    return ledge


def measure(grid: Grid, surface: HeightMap) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Steps and slopes of a level's ground, and its ridges, each of shape (nx, ny)."""

    def steps(_: Box, height: NDArray[np.float32], state: NDArray[np.uint8]) -> tuple[FloatArray, FloatArray]:
        return step_and_slope(replace(surface, height=height, state=state))

    def over(
        _: Box, height: NDArray[np.float32], state: NDArray[np.uint8], pits: NDArray[np.float32], *drops: BoolArray
    ) -> tuple[BoolArray]:
        return (ridges(replace(surface, height=height, state=state), FLIGHT_RISE, pits, drops[0] | drops[1]),)

    given, pits, drops = (surface.height, surface.state), grid.known["seen"].made[1], grid.known["voids"].made[:2]
    step, slope = grid.around("measured", limits_reach(surface), steps, *given)
    (ridge,) = grid.around("ridges", ridges_reach(surface), over, *given, pits, *drops)
    return step, slope, ridge


def sheet_surface(grid: Grid, layers: Layers, part: Part, max_step: float, noise: float = 0.0) -> HeightMap:
    """The ground of a sheet as it was seen, at the centres of its cells; the `noise` is that before the cure [m].

    What a flight is tells `max_step` [m], see `bridged`.
    """
    nodes, origin = part.nodes, part.origin
    height, off = np.full(part.shape, np.nan, np.float32), np.zeros((*part.shape, 2), np.float32)
    for rest, first, last in layers.strips(part.first[0], part.first[0] + part.shape[0]):
        a, b = np.searchsorted(nodes, [first, last]).tolist()
        own = layers.columns, nodes[a:b], rest.place, first, origin, layers.cell_width, part.first
        put_heights_in_plan(*own, height, off)
    pairs = off.view(np.complex64)[..., 0]  # each two in one, to be compared at once
    whole = HeightMap(part.origin, layers.cell_width, height, np.zeros(part.shape, np.uint8))

    def answer(
        box: Box, height: NDArray[np.float32], pairs: NDArray[np.complex64]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint8]]:
        off = np.ascontiguousarray(pairs)[..., None].view(np.float32)
        state = np.where(np.isnan(height), UNKNOWN, OBSERVED).astype(np.uint8)
        seen = replace(cropped(whole, box), height=height, state=state)
        surface = without_outliers(seen, RESOLVED_STEP * noise)
        if surface is not seen:  # a median's place is the middle of its cells
            off = np.where((surface.height != height)[..., None], np.float32(0.0), off)
        made = with_rims(to_centres(surface, off, noise), noise)
        height = bridged(made, max_step).height
        return height, made.height, np.where(np.isnan(height), UNKNOWN, OBSERVED).astype(np.uint8)

    reach = max(whole.state.shape) if noise > 0.0 else 1 + footing_reach(whole)  # noise is smoothed further off
    height, _, state = grid.around("seen", reach, answer, height, pairs)
    return replace(whole, height=height, state=state)


def without_outliers(surface: HeightMap, most: float) -> HeightMap:
    """Cells that are off the median of their neighbourhood by `most` [m] at most take it if they are off it alone.

    A cell that fewer than three of its neighbours are with, nearer to it than to the median, is no corner of a step.
    Beside empty cells the median of a slope is off by a cell's rise; there the middles of two opposite ones count, too.
    """
    if most == 0.0:
        return surface
    around = neighbourhood(surface)
    median = smoothed(surface)
    own = surface.height.astype(np.float64)
    middles = np.where(np.isnan(around).any(axis=0), 0.5 * (around[:4] + around[:4:-1]), np.nan)
    told = np.concatenate([around, middles])
    with_it = (np.abs(told - own) < np.abs(told - median)).sum(axis=0) - (own != median)  # itself is one of the nine
    alone = (with_it < 3) & (np.abs(own - median) <= most)
    return HeightMap(surface.origin, surface.cell_width, np.where(alone, median, own).astype(np.float32), surface.state)


def complete(
    grid: Grid,
    seen: HeightMap,
    held: Callable[[Box], Held],
    voids: Voids,
    near: Nearest,
    site: _Site,
) -> tuple[HeightMap, BoolArray]:
    """The ground with what its surroundings and the other points explain, and in which cells these guard an edge.

    Holes are filled in the whole level. What edges, faces and things that may stand behind them make of a cell is
    decided by what is within a known reach of it.

    Args:
        grid: What was asked of its cells.
        seen: The ground as it was seen.
        held: Says which other points are in a box of cells.
        voids: See `find_voids`.
        near: Where the ground was seen, `nearest_seen`.
        site: Its rays tell what may stand on inferred ground where they are known; else fronts do.
    """
    config = site.config

    def stood(box: Box, beside: NDArray[np.float32]) -> tuple[FloatArray, BoolArray, BoolArray]:
        cell, z, lowest = held(box)
        return lowest, *standing(beside, lowest, cell, z, seen.cell_width)

    def edges(
        box: Box, height: NDArray[np.float32], state: NDArray[np.uint8], lowest: FloatArray
    ) -> tuple[BoolArray, BoolArray]:
        cell, z, _ = held(box)
        return guard_edges(HeightMap(seen.origin, seen.cell_width, height, state), lowest, cell, z, config)

    lowest, material, at_floor = grid.around("stood", 0, stood, near.height, points=True)
    filled = fill_holes(seen, grid, near, (material, at_floor), voids, config, site.noise)
    own = filled.height, filled.state, lowest
    stair, guarded = grid.around("edges", notch_reach(seen), edges, *own, points=True)
    if site.rays is not None:
        return seen_by_rays(filled, site.rays, config, site.noise), guarded

    def faces(box: Box, height: NDArray[np.float32], state: NDArray[np.uint8], stair: BoolArray) -> tuple[BoolArray]:
        cell, z, _ = held(box)
        part = HeightMap(seen.origin, seen.cell_width, height, state)
        return (find_faces(part, cell, z, config.min_headroom) & ~stair,)  # a flight's treads were seen to its walls

    def shown(
        box: Box, height: NDArray[np.float32], state: NDArray[np.uint8], lowest: FloatArray, face: BoolArray
    ) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        part = without_hidden(HeightMap(seen.origin, seen.cell_width, height, state), lowest, face)
        return part.height, part.state

    (face,) = grid.around("faces", faces_reach(seen), faces, filled.height, filled.state, stair, points=True)
    height, state = grid.around("shown", hidden_reach(seen), shown, *own, face)
    return replace(seen, height=height, state=state), guarded


def in_order(other: FloatArray, surface: HeightMap) -> tuple[FloatArray, IntArray]:
    """The `other` points (m, 3) in the order of their cells, and where each cell begins, shape (cells + 1,)."""
    first, order = by_cell(cells_within(other, surface), surface.state.size)
    return taken(other, order), first


def rows_in(first: IntArray, box: Box, shape: tuple[int, ...]) -> Rows:
    """Rows of the points in a box of cells of a grid, where those of each cell begin at `first`: they are in order."""
    (rows, columns), ny = grown(box, 0, shape), shape[1]
    if (columns.start, columns.stop) == (0, ny):
        return slice(first[rows.start * ny], first[rows.stop * ny])
    cells = np.zeros(shape, dtype=bool)
    cells[box] = True
    return rows_by_cell(cells, first)


def held_in(other: FloatArray, first: IntArray, surface: HeightMap, box: Box) -> Held:
    """Flat cell and height [m] of each of the `other` points (m, 3), `in_order`, in a box, and the lowest of a cell."""
    held = other[rows_in(first, box, surface.state.shape)]
    cell, z = cells_within(held, surface, box), np.ascontiguousarray(held[:, 2])
    ends = np.full(surface.state[box].shape, np.inf)
    return cell, z, extent_within(cell, z, -ends, ends)[0]


def notch_reach(surface: HeightMap) -> int:
    """Cells within which the ground decides what guards an edge."""
    return int(np.ceil(NOTCH_DEPTH / surface.cell_width))


def guard_edges(
    surface: HeightMap, lowest: FloatArray, cell: IntArray, z: FloatArray, config: PerceptionConfig
) -> tuple[BoolArray, BoolArray]:
    """Cells of stairs, and those where material guards an edge by itself.

    That does only what the lowest body cannot pass under. The wall of a drop does not; but what is seen below a shadow
    in a stair, with treads on either side, is the stair.

    Args:
        surface: The ground.
        lowest: Of the other points in each cell [m], shape (nx, ny).
        cell: Flat cell of each other point, shape (m,).
        z: Its height [m], shape (m,).
        config: Limits.
    """
    known, reach = surface.state != UNKNOWN, notch_reach(surface)
    high, low = np.where(known, surface.height, -np.inf), np.where(known, surface.height, np.inf)
    beside, foot = highest_around(high, 1) + config.min_headroom, lowest_around(low, reach)
    shut, stair = lowest <= beside, highest_around(high, reach) - foot > 2.0 * surface.cell_width

    over, beside = (foot + LEAST_OBSTACLE).astype(np.float64), beside.astype(np.float64)
    guards = np.isfinite(extent_within(cell, z, over, beside)[0])
    return stair, guards | between_treads(surface, shut & stair & ~known, config.stair_step)


def within_reach(points: FloatArray, surface: HeightMap, box: Box = WHOLE) -> FloatArray:
    """Points between a cell under the lowest known ground near them and `TALLEST` over the highest.

    The `box` of cells holds all points, and `OVERLAP` around them.
    """
    low, high = lowest_and_highest(surface, box)
    cell = cells_within(points, surface, box)
    return chosen_rows(points, between(cell, points[:, 2], under(low - surface.cell_width), high + TALLEST))


def lowest_and_highest(surface: HeightMap, box: Box = WHOLE) -> tuple[FloatArray, FloatArray]:
    """Height of the lowest and of the highest known ground within `OVERLAP` [m], shape (nx, ny), in a box of cells."""
    rings = int(np.ceil(OVERLAP / surface.cell_width))
    known, height = surface.state[box] != UNKNOWN, surface.height[box]
    low = lowest_around(np.where(known, height, np.inf), rings)
    high = highest_around(np.where(known, height, -np.inf), rings)
    return low, high

"""Levels: each sheet of the ground with what a body could touch on it, and where they meet."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from gpdf_service.config import PerceptionConfig
from gpdf_service.errors import NoGroundError
from gpdf_service.fields.threads import run_beside, run_parallel
from gpdf_service.ground import GroundLevel, Levels, Portal
from gpdf_service.ground.footing import FLIGHT_RISE, ridges, ridges_reach
from gpdf_service.ground.limits import Measured, limits_reach, step_and_slope
from gpdf_service.perception.budget import KEPT_BYTES, LEVEL_BYTES, check_grid, give_back
from gpdf_service.perception.cloud import Cloud, change_layers, find_strays
from gpdf_service.perception.complete import complete
from gpdf_service.perception.ledges import ground_reach, ledge_reach, ledges_felt, others_reach
from gpdf_service.perception.others import Others, find_ledges_in, find_others, held_in
from gpdf_service.perception.rays import Rays
from gpdf_service.perception.seen import part_of, sheet_surface
from gpdf_service.perception.segment import LEAST_SCATTER
from gpdf_service.perception.sheets import split_sheets
from gpdf_service.perception.site import Made, Part, Site
from gpdf_service.perception.voids import Voids
from gpdf_service.tiles.beside import Beside, beside, beside_now
from gpdf_service.tiles.boxes import Box, widened
from gpdf_service.tiles.columns import unlike_cells
from gpdf_service.tiles.layers import Layers, build_layers
from gpdf_service.tiles.points import Points
from gpdf_service.tiles.rows import chosen_rows, rows_by_cell, taken
from gpdf_service.tiles.surface import HeightMap, Nearest, changed, first_cell, is_same_ground, nearest_seen, placed
from gpdf_service.tiles.told import Grid, moved, new_grid, shared
from gpdf_service.tiles.width import cell_width_of, layer_gap, widest_cell
from gpdf_service.types import BoolArray, ByteArray, Float32Array, FloatArray

ALONE = 0.25
"""[m] A point with no other in the voxels of this width around its own is a reflection; even a thin cable has more."""
ASKED = 16
"""Of so many nodes of a sheet one is asked of which level before it is."""


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


def survey_levels(
    points: Points,
    ground: BoolArray,
    config: PerceptionConfig,
    *,
    width: float | None = None,
    noise: float = 0.0,
    rays: Rays | None = None,
) -> tuple[Levels, Survey]:
    """Build the sheets from labelled points, and say what they were made of.

    Args:
        points: The cloud, by numbers up to n.
        ground: Which points are ground, shape (n,); none that is not there.
        config: Limits.
        width: Of the cells [m]; measured on the ground when not given.
        noise: Standard deviation that the points had before they were cured [m].
        rays: Of the scan, where they are known: they tell what inferred ground is free, and not rules.

    Raises:
        NoGroundError: no point is ground.
    """
    if not ground.any():
        raise NoGroundError(
            "ground", "no point of the cloud is labelled ground", "Check the labels, or leave them out."
        )
    floor, own = chosen_rows(points.base.points, ground), points.present
    check_grid(floor, len(own), widest_cell(config), LEVEL_BYTES, config)
    width = cell_width_of(floor, config) if width is None else width
    check_grid(floor, len(own), width, LEVEL_BYTES, config)

    (near, sheets), reflected = run_beside(
        partial(_find_sheets, floor, width, config), partial(find_strays, own, alone(width))
    )
    kept = sum(np.prod(part_of(near.layers, sheet).shape) for sheet in sheets) / np.prod(near.layers.shape) - 1.0
    check_grid(floor, len(own), width, LEVEL_BYTES + KEPT_BYTES * max(kept, 0.0), config)
    stray = np.zeros(len(ground), dtype=bool)
    stray[points.there] = reflected
    stray &= ~ground
    cells, cloud = np.ones(near.layers.shape, dtype=bool), Cloud(points, own[:0], rays)
    del floor, own
    return _levels_of(Site(cloud, ground, stray, near.layers, cells, config, noise), near, sheets)


def _find_sheets(floor: FloatArray, width: float, config: PerceptionConfig) -> tuple[Beside, tuple[BoolArray, ...]]:
    """Nodes of the ground points, shape (n, 3) [m], in cells of that `width` [m], and which are of each sheet."""
    near = beside(build_layers(floor, width, layer_gap(width, config)))
    sheets = split_sheets(near, config)
    if not sheets:
        found = f"no piece of the ground is as large as three by three cells of {width:.2g} m"
        raise NoGroundError("ground", found, "Are its samples further apart than a foot bridges? Scan it more densely.")
    return near, sheets


def change_levels(
    old: Survey, cloud: Cloud, ground: BoolArray, stray: BoolArray, config: PerceptionConfig, noise: float = 0.0
) -> tuple[Levels, Survey]:
    """`survey_levels` of a changed cloud, whose points had that `noise` before they were cured [m].

    Raises:
        WholeError: the ground has other bounds.
    """
    layers, cells = change_layers(old.layers, cloud, ground, config)
    near, sheets = old.near, old.sheets
    if layers is not near.layers:
        near = beside_now(near, layers, cells)
        sheets = split_sheets(near, config)
    return _levels_of(Site(cloud, ground, stray, layers, cells, config, noise), near, sheets, old.made)


def _levels_of(
    site: Site, near: Beside, sheets: tuple[BoolArray, ...], before: tuple[Made, ...] = ()
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


def _make_level(site: Site, sheet: BoolArray, part: Part, before: Made | None) -> Made:
    """The level of the nodes of a `sheet`. A build is a change from `_nothing`.

    What a cell holds depends on the points of its column and on cells within a known reach: so only the cells are
    looked at, and the points in them read, for which any of this is another than before.
    """
    config, (was, columns, fresh) = site.config, _asked_of(site, part, before)
    grid = was.grid.now(columns | fresh)
    seen = sheet_surface(grid, site.layers, part, config.max_step, site.noise)
    if not (site.cloud.seen_anew or grid.felt("seen", 0, *grid.known["seen"].given, points=True).any()):
        return replace(was, touched=None)
    near = Nearest(*grid.whole("near", lambda *_: nearest_seen(seen), seen.height, seen.state))
    held = find_others(site, sheet, seen, near, grid, was)
    grid = replace(grid, others=held.unlike)
    surface, measured, both = was.level.surface, was.level.measured, was.level.edges
    other = grid.felt("voids", 0, *grid.known["voids"].given, points=True) | grid.other_answers("seen", "voids")
    if site.cloud.seen_anew or other.any():
        holds = partial(held_in, held.points, held.first, seen)
        surface, guarded = complete(grid, seen, holds, Voids(*grid.known["voids"].made), near, site)
        del near, holds
        if before is None:
            give_back(len(site.ground))
        measured, ridge = measure(grid, surface)
        both = guarded, ridge
    else:  # they are told by nothing else
        grid = replace(grid, known=was.grid.known | grid.known)
    other = changed(was.level.surface, surface) | fresh
    surface = surface if other.any() else was.level.surface  # versions share it
    felt = columns | ledges_felt(other, was.level.surface, surface, site.noise)
    felt |= widened(fresh, ledge_reach(surface, site.noise))
    ledge, stepped = _ledges_of(site, surface, held, felt, was)
    touched = widened(stepped | other, 1) | grid.other_answers("measured", "ridges", "edges")  # all that limits tell
    if not touched.any():
        return Made(was.level, grid.lasting(), held.first, None)
    return Made(GroundLevel(surface, held.points, ledge, measured, both), grid.lasting(), held.first, touched)


def _ledges_of(
    site: Site, surface: HeightMap, held: Others, felt: BoolArray, was: Made
) -> tuple[Float32Array, BoolArray]:
    """The ledges of the other points, which the ground in the `felt` cells may tell otherwise than before.

    Also the cells that hold other points, or ledges, shape (nx, ny).
    """
    asked = widened(felt, ground_reach(surface, site.noise))
    asked |= widened(held.unlike, others_reach(surface, site.noise))
    ledge = find_ledges_in(site, surface, held, asked)
    return ledge, held.unlike | unlike_cells(asked, was.first, was.level.ledge[:, None], held.first, ledge[:, None])


def _asked_of(site: Site, part: Part, before: Made | None) -> tuple[Made, BoolArray, BoolArray]:
    """What a level is made from, in the box of a `part`; the columns that changed, and those that are new to it."""
    if before is None:
        return _nothing(part, site.layers.cell_width), np.ones(part.shape, dtype=bool), np.zeros(part.shape, dtype=bool)
    (x, y), (nx, ny) = part.first, part.shape
    columns = site.cells[x : x + nx, y : y + ny]
    if _same_box(before.level.surface, part):
        return before, columns, np.zeros_like(columns)
    was = _moved(before, part)
    return was, columns, was.grid.others


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


def measure(grid: Grid, surface: HeightMap) -> tuple[Measured, BoolArray]:
    """Steps and slopes of a level's ground, and its ridges, each of shape (nx, ny)."""

    def steps(_: Box, asked: BoolArray, height: Float32Array, state: ByteArray) -> tuple[FloatArray, FloatArray]:
        return step_and_slope(replace(surface, height=height, state=state), asked)

    def over(_: Box, height: Float32Array, state: ByteArray, pits: Float32Array, *drops: BoolArray) -> tuple[BoolArray]:
        return (ridges(replace(surface, height=height, state=state), FLIGHT_RISE, pits, drops[0] | drops[1]),)

    given, pits, drops = (surface.height, surface.state), grid.known["seen"].made[1], grid.known["voids"].made[:2]
    step, slope = grid.around("measured", limits_reach(surface), steps, *given, asked=True)
    (ridge,) = grid.around("ridges", ridges_reach(surface), over, *given, pits, *drops)
    return (step, slope), ridge


def count_undecided(level: GroundLevel, noise: float = 0.0) -> int:
    """Points at the ground that are not called ground though they lie within twice its scatter: ground, or a sill.

    Args:
        level: One sheet.
        noise: Standard deviation of the cloud's points [m].
    """
    ix, iy, _ = level.surface.cells(level.other_points)
    off = np.abs(level.other_points[:, 2] - level.surface.height[ix, iy])  # NaN, where it is unknown, compares false
    return int(np.count_nonzero(off <= 2.0 * max(LEAST_SCATTER, 3.0 * noise)))

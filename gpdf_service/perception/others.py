"""The other points of a level: what is not its ground and within reach over it, cell by cell.

Of a tread or a floor over head that was seen from above alone nobody knows how far down it reaches.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from math import ceil
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gpdf_service.config import PerceptionConfig
from gpdf_service.fields.threads import run_beside, run_chunked
from gpdf_service.ground.foot import LEAST_OBSTACLE
from gpdf_service.ground.footing import flights, rings_of
from gpdf_service.ground.level import OVERLAP, TALLEST, lowest_and_highest
from gpdf_service.perception.cloud import Rows
from gpdf_service.perception.ledges import find_ledges, ground_reach, ledge_reach, others_reach
from gpdf_service.perception.notches import FLIGHT
from gpdf_service.perception.site import Made, Site
from gpdf_service.perception.voids import MAX_HOLE_RADIUS, find_rims, find_voids
from gpdf_service.tiles.boxes import Box, lowest_around, widened, window
from gpdf_service.tiles.columns import by_cell, runs_of, starts_spliced, take_out, unlike_cells, values_spliced
from gpdf_service.tiles.rows import INDEX, between, extent_within, rows_by_cell, taken, under
from gpdf_service.tiles.surface import UNKNOWN, HeightMap, Nearest, cells_within, cropped
from gpdf_service.tiles.told import Grid, boxes_of, grown, within
from gpdf_service.types import BoolArray, ByteArray, Float32Array, FloatArray, IntArray

PICKED = 0.4
"""[-] Share of the cells of a cloud from which on all points are read: to pick one out takes as long as to read two."""
Held = tuple[IntArray, FloatArray]
"""Flat cell and height [m] of each other point, shape (m,)."""


class Columns(NamedTuple):
    """Points in some cells: the box that holds these, flat cell in it, points (n, 3) [m], and which are ground.

    Those of the cell after the last one are of none.
    """

    box: Box
    cell: IntArray
    points: FloatArray
    ground: BoolArray


class Others(NamedTuple):
    """The other points of a level [m], shape (m, 3), and their ledges; where those of each cell begin.

    Beside these the cells that hold others than before, shape (nx, ny).
    """

    points: FloatArray
    ledge: Float32Array
    first: IntArray
    unlike: BoolArray


def _read(site: Site, cells: BoolArray) -> BoolArray:
    """The cells, or all of their grid where most of the cloud is in them: then to pick out points costs more."""
    return np.ones_like(cells) if np.count_nonzero(cells) > PICKED * site.cells.size else cells


def _columns_in(site: Site, sheet: BoolArray, seen: HeightMap, cells: BoolArray, near: BoolArray) -> Columns:
    """The points in some cells `near` the ground, but for strays and the ground of a `sheet`: these are in no cell."""
    box, (rows, points) = window(cells, 0), site.cloud.part(seen, _read(site, cells & near))
    cell, stray, ground = cells_within(points, seen, box), site.stray[rows], site.ground[rows]
    nodes = site.layers.grid_of(points), sheet, seen.state[box].size
    run_chunked(lambda a, b: take_out(points[a:b], stray[a:b], ground[a:b], *nodes, cell[a:b]), len(points))
    return Columns(box, cell, points, ground)


def _in_grid(cell: IntArray, box: Box, cells: BoolArray) -> IntArray:
    """Flat cells in a box as those in the grid, shape (n,); of all but the `cells` as the one after the last."""
    if cells.all():
        return cell
    (rows, columns), (nx, ny) = grown(box, 0, cells.shape), cells.shape
    flat = np.add.outer(np.arange(rows.start * ny, rows.stop * ny, ny), np.arange(columns.start, columns.stop))
    made: IntArray = np.append(np.where(cells[box], flat, nx * ny).ravel(), nx * ny).astype(INDEX)[cell]
    return made


def find_others(site: Site, sheet: BoolArray, seen: HeightMap, near: Nearest, grid: Grid, was: Made) -> Others:
    """The points within reach over the seen ground of a `sheet`, and into the grid its voids, see `find_voids`."""
    width, config = seen.cell_width, site.config
    low, high, treads, rim = _span(grid, seen, config.max_step)
    beside = np.where(near.distance <= MAX_HOLE_RADIUS, near.height, np.float32(np.nan))
    own = grid.known["seen"].given[0], beside
    rings = rings_of(config.widest_gap, width)
    asked, told = widened(grid.felt("treads", 0, *own, points=True), rings), widened(np.isfinite(high), rings)
    held = _columns_in(site, sheet, seen, asked, told)
    hidden = unseen_beneath(grid, held, *own, rings, config)
    given = *own, seen.height, low, high, treads, rim, hidden
    cells = grid.felt("voids", 0, *given, points=True)
    box, cell, points, _ = held = held if asked.all() else _columns_in(site, sheet, seen, cells, told)
    part, shown, z = cropped(seen, box), Nearest(near.distance[box], near.height[box]), points[:, 2]
    near_by, found = run_beside(
        partial(between, cell, z, under(low[box] - width), high[box] + TALLEST),
        partial(find_voids, part, shown, treads[box], rim[box], cell, z, config.max_step),
    )
    grid.put("voids", given, cells, [(box, found)] if cells.any() else [])
    begin, order = by_cell(_in_grid(np.where(near_by, cell, part.state.size), box, cells), cells.size + 1)
    order = order[: begin[-2]]  # without those of the cell after the last one
    fresh = taken(points, order)
    if hidden[box].any():
        fresh[_reaching_down(held, hidden[box], beside[box], config)[order], 2] -= config.max_step
    return _changed(was, cells, begin[:-1], fresh)


def _span(grid: Grid, seen: HeightMap, max_step: float) -> tuple[NDArray[Any], ...]:
    """The `lowest_and_highest` ground around each cell, cells of flights, and `find_rims`."""

    def answer(_: Box, height: Float32Array, state: ByteArray) -> tuple[NDArray[Any], ...]:
        part = replace(seen, height=height, state=state)
        treads = (state != UNKNOWN) & flights(part, max_step, FLIGHT)
        return *lowest_and_highest(part), treads, find_rims(part)

    return grid.around("span", ceil(max(OVERLAP, FLIGHT) / seen.cell_width) + 3, answer, seen.height, seen.state)


def over_head(floor: Float32Array, config: PerceptionConfig) -> FloatArray:
    """What is over head over the `floor` [m], (nx, ny), is higher than this: it leaves the lowest body room anyhow."""
    over = floor.astype(np.float64) + config.max_step + config.min_headroom
    return np.where(np.isnan(floor), np.inf, over)


def unseen_beneath(
    grid: Grid, held: Columns, sheet: Float32Array, floor: Float32Array, rings: int, config: PerceptionConfig
) -> BoolArray:
    """Cells in which nobody saw an underside of ground over head, shape (nx, ny): it may be a step thick.

    A flight is as deep under a tread as its riser and its waist, a floor as its slab: no more than `max_step`. An
    underside, or the face of a rim, is a point within that under the lowest tread around; it is known, as ground is, as
    far as `widest_gap`. Over head is what leaves the lowest body room even so.

    `held` are the points in the cells that it asks. The `sheet`'s own ground, which holds none of these, and the
    `floor` to stand on have heights [m], shape (nx, ny), NaN where there is none; `rings` of cells are `widest_gap`.
    """
    box, cell, points, ground = held
    over, z, outer = over_head(floor[box], config), points[:, 2], grown(box, rings, floor.shape)
    rows = np.flatnonzero(ground & (cell < over.size))  # of other sheets: few, or none
    own, none = (cell[rows], z[rows]), np.full(over.shape, np.inf)
    top = extent_within(*own, over, extent_within(*own, over, none)[0] + config.max_step)[1]  # a board is one tread
    felt, top = grid.felt("treads", 0, sheet, floor, points=True), np.where(np.isfinite(top), top, np.inf)
    (top,) = grid.put("treads", (sheet, floor), felt, [(box, (top,))] if felt.any() else [])
    low, shown = lowest_around(top[outer], rings)[within(box, outer)], np.zeros(over.shape, dtype=bool)
    if np.isfinite(low).any():
        shown = np.isfinite(extent_within(cell, z, low - config.max_step, under(low - LEAST_OBSTACLE))[0])
    felt = grid.felt("undersides", rings, sheet, top, points=True)
    (shown,) = grid.put("undersides", (sheet, top), felt, [(box, (shown,))] if felt.any() else [])

    def answer(_: Box, top: FloatArray, shown: BoolArray) -> tuple[BoolArray]:
        return (np.isfinite(lowest_around(top, rings)) & ~widened(shown, rings),)

    (hidden,) = grid.around("unseen beneath", rings, answer, top, shown)
    return hidden


def _reaching_down(held: Columns, hidden: BoolArray, floor: Float32Array, config: PerceptionConfig) -> BoolArray:
    """Which points are ground over head that is `hidden` from below, shape (n,): it may reach a step further down."""
    _, cell, points, ground = held
    over = np.where(hidden, over_head(floor, config), np.inf)
    return ground & between(cell, points[:, 2], over, np.full(over.shape, np.inf))


def _changed(was: Made, cells: BoolArray, begin: IntArray, fresh: FloatArray) -> Others:
    """The other points of a level with those in some `cells` told anew: `fresh` ones, where each cell's `begin`."""
    unlike = cells if cells.all() else unlike_cells(cells, was.first, was.level.other_points, begin, fresh)
    places = unlike.ravel(), was.first, begin
    first, runs = starts_spliced(*places), runs_of(*places)
    other = values_spliced(runs, was.level.other_points, fresh)
    ledge = values_spliced(runs, was.level.ledge, np.full(len(fresh), np.inf, np.float32))
    return Others(other, ledge, first, unlike)


def find_ledges_in(site: Site, surface: HeightMap, held: Others, asked: BoolArray) -> Float32Array:
    """The ledges, `find_ledges`, with those in the cells that are `asked` for told anew, box after box."""
    ledge, shape, noise = held.ledge.copy(), surface.state.shape, site.noise
    aside, ground = others_reach(surface, noise), ground_reach(surface, noise)
    reach = aside + ground + ledge_reach(surface, noise)
    for box in boxes_of(asked, reach):
        near, outer, cells = grown(box, aside, shape), grown(box, reach, shape), np.zeros(shape, dtype=bool)
        cells[grown(near, ground, shape)] = True
        floor, others = site.cloud.chosen(surface, _read(site, cells), site.ground), rows_in(held.first, near, shape)
        found = find_ledges(surface, floor, held.points[others], site.config.max_step, noise, outer)
        if near == box:
            ledge[others] = found
        else:
            own, all_ = (np.arange(len(ledge))[rows] for rows in (rows_in(held.first, box, shape), others))
            ledge[own] = found[np.searchsorted(all_, own)]
    return ledge


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
    """Flat cell and height [m] of each of the `other` points (m, 3), `in_order`, in a box."""
    held = other[rows_in(first, box, surface.state.shape)]
    return cells_within(held, surface, box), np.ascontiguousarray(held[:, 2])

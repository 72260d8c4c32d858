"""A level's ground with what its surroundings explain: holes filled, and hidden again what things may stand on."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpdf_service.config import PerceptionConfig
from gpdf_service.ground.foot import LEAST_OBSTACLE
from gpdf_service.perception.hidden import (
    Squares,
    faces_reach,
    find_faces,
    hidden_reach,
    room_behind,
    room_reach,
    without_hidden,
)
from gpdf_service.perception.holes import fill_faces, fill_holes, standing
from gpdf_service.perception.notches import NOTCH_DEPTH, between_treads
from gpdf_service.perception.others import Held
from gpdf_service.perception.rays import seen_by_rays
from gpdf_service.perception.site import Site
from gpdf_service.perception.voids import Voids
from gpdf_service.tiles.boxes import Box, highest_around, lowest_around
from gpdf_service.tiles.rows import extent_within
from gpdf_service.tiles.surface import UNKNOWN, HeightMap, Nearest
from gpdf_service.tiles.told import Grid
from gpdf_service.types import BoolArray, ByteArray, Float32Array, FloatArray, IntArray


def complete(
    grid: Grid, seen: HeightMap, held: Callable[[Box], Held], voids: Voids, near: Nearest, site: Site
) -> tuple[HeightMap, BoolArray]:
    """The ground with what its surroundings and the other points explain, and in which cells these guard an edge.

    Holes are filled in the whole level. What edges, faces and things that may stand behind them make of a cell is
    decided by what is within a known reach of it.

    The ground as it was `seen` has `near` for `nearest_seen`. `held` says which other points are in a box of cells. The
    rays of the `site` tell what may stand on inferred ground where they are known; else fronts do.
    """
    config, as_map = site.config, partial(HeightMap, seen.origin, seen.cell_width)

    def stood(box: Box, beside: Float32Array) -> tuple[FloatArray, BoolArray, BoolArray, BoolArray]:
        cell, z = held(box)
        ends = np.full(beside.shape, np.inf)
        lowest = extent_within(cell, z, -ends, ends)[0]
        return lowest, *standing(beside, lowest, cell, z, seen.cell_width)

    def edges(box: Box, height: Float32Array, state: ByteArray, lowest: FloatArray) -> tuple[NDArray[Any], ...]:
        other = lowest, *held(box)
        made = fill_faces(as_map(height, state), *other, config.max_step)
        return made.height, made.state, *guard_edges(made, *other, config)

    lowest, thing, at_floor, over = grid.around("stood", 0, stood, near.height, points=True)
    filled = fill_holes(seen, grid, near, (thing, at_floor, over), voids, config, site.noise)
    own = filled.height, filled.state, lowest
    height, state, stair, guarded = grid.around("edges", notch_reach(seen) + 1, edges, *own, points=True)
    filled = as_map(height, state)
    if site.rays is not None:
        return seen_by_rays(filled, site.rays, config, site.noise), guarded
    return _known_to_be_free(grid, filled, held, lowest, stair, config.min_headroom), guarded


def _known_to_be_free(
    grid: Grid, filled: HeightMap, held: Callable[[Box], Held], lowest: FloatArray, stair: BoolArray, headroom: float
) -> HeightMap:
    """The `filled` ground but for what a thing may stand on of which only a front was seen; see `without_hidden`."""
    as_map = partial(HeightMap, filled.origin, filled.cell_width)

    def faces(box: Box, height: Float32Array, state: ByteArray, stair: BoolArray) -> tuple[BoolArray]:
        # a flight's treads were seen to its walls
        return (find_faces(as_map(height, state), *held(box), headroom) & ~stair,)

    def behind(_: Box, height: Float32Array, state: ByteArray, lowest: FloatArray, face: BoolArray) -> tuple[Squares]:
        return (room_behind(as_map(height, state), lowest, face),)

    def shown(
        _: Box, asked: BoolArray, height: Float32Array, state: ByteArray, room: Squares, face: BoolArray
    ) -> tuple[Float32Array, ByteArray]:
        part = without_hidden(as_map(height, state), room, face, asked)
        return part.height, part.state

    own = filled.height, filled.state
    (face,) = grid.around("faces", faces_reach(filled), faces, *own, stair, points=True)
    (room,) = grid.around("behind", room_reach(filled), behind, *own, lowest, face)
    return as_map(*grid.around("shown", hidden_reach(filled), shown, *own, room, face, asked=True))


def notch_reach(surface: HeightMap) -> int:
    """Cells within which the ground decides what guards an edge."""
    return int(np.ceil(NOTCH_DEPTH / surface.cell_width))


def guard_edges(
    surface: HeightMap, lowest: FloatArray, cell: IntArray, z: FloatArray, config: PerceptionConfig
) -> tuple[BoolArray, BoolArray]:
    """Cells of stairs, and those where material guards an edge by itself.

    That does only what is over the ground beside and the lowest body cannot pass under. A step's face and the wall of a
    drop do not; but what is seen below a shadow in a stair, with treads on either side, is the stair.

    Each other point, by its flat `cell`, shape (m,), has a height `z` [m]; `lowest` is that of each cell, (nx, ny).
    """
    known, reach = surface.state != UNKNOWN, notch_reach(surface)
    high, low = np.where(known, surface.height, -np.inf), np.where(known, surface.height, np.inf)
    beside, foot = highest_around(high, 1), lowest_around(low, reach)
    shut = lowest <= beside + config.min_headroom
    stair = highest_around(high, reach) - foot > 2.0 * surface.cell_width

    top = beside.astype(np.float64)
    guards = np.isfinite(extent_within(cell, z, top + LEAST_OBSTACLE, top + config.min_headroom)[0])
    return stair, guards | between_treads(surface, shut & stair & ~known, config.stair_step)

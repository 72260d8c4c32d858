"""A level's ground with what its surroundings explain, without that on which the unseen back of a thing may stand."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

from gpdf_service.config import PerceptionConfig
from gpdf_service.ground.foot import HALF_FOOT, LEAST_OBSTACLE
from gpdf_service.perception.holes import CEILING, fill_faces, fill_holes, standing
from gpdf_service.perception.notches import NOTCH_DEPTH, between_treads
from gpdf_service.perception.others import Held
from gpdf_service.perception.site import Site
from gpdf_service.perception.visibility import seen_by_rays
from gpdf_service.perception.voids import MAX_HOLE_RADIUS, Voids
from gpdf_service.tiles.boxes import SIDES, Box, highest_around, lowest_around
from gpdf_service.tiles.nearest import nearest_of
from gpdf_service.tiles.rows import extent_within
from gpdf_service.tiles.surface import INFERRED, OBSERVED, UNKNOWN, HeightMap, Nearest, count_cells, count_in, without
from gpdf_service.tiles.told import Grid
from gpdf_service.types import BoolArray, ByteArray, Float32Array, FloatArray, IntArray

Squares = NDArray[np.int32]
"""Squared distances [cells²]: whole numbers."""
_FACE_REACH = 2
"""Cells within which the ground decides how high a point is."""


def complete(
    grid: Grid, seen: HeightMap, held: Callable[[Box], Held], voids: Voids, near: Nearest, site: Site
) -> tuple[HeightMap, BoolArray]:
    """The ground with what its surroundings and the other points explain, and in which cells these guard an edge.

    Holes are filled in the whole level. What edges, faces and things that may stand behind them make of a cell is
    decided by what is within a known reach of it.

    The ground as it was `seen` has `near` for `nearest_seen`. `held` says which other points are in a box of cells. The
    rays of the cloud tell what may stand on inferred ground where they are known; else fronts do.
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
    if (rays := site.cloud.rays) is not None:
        return seen_by_rays(grid, filled, rays, site.layers.origin, config, site.noise), guarded
    return _known_to_be_free(grid, filled, held, lowest, stair, config.min_headroom), guarded


def _known_to_be_free(
    grid: Grid, filled: HeightMap, held: Callable[[Box], Held], lowest: FloatArray, stair: BoolArray, headroom: float
) -> HeightMap:
    """The `filled` ground but for what a thing may stand on of which only a front was seen; see `without_hidden`."""
    as_map = partial(HeightMap, filled.origin, filled.cell_width)

    def faces(box: Box, height: Float32Array, state: ByteArray, stair: BoolArray) -> tuple[BoolArray]:
        return (find_faces(as_map(height, state), *held(box), headroom) & ~stair,)  # treads were seen to their walls

    def behind(_: Box, height: Float32Array, state: ByteArray, lowest: FloatArray, face: BoolArray) -> tuple[Squares]:
        return (room_behind(as_map(height, state), lowest, face),)

    def shown(
        _: Box, asked: BoolArray, height: Float32Array, state: ByteArray, room: Squares, face: BoolArray
    ) -> tuple[Float32Array, ByteArray]:
        part = without_hidden(as_map(height, state), room, face, asked)
        return part.height, part.state

    own, deepest = (filled.height, filled.state), int(np.ceil(MAX_HOLE_RADIUS / filled.cell_width))
    (face,) = grid.around("faces", _FACE_REACH + _foot_cells(filled), faces, *own, stair, points=True)
    (room,) = grid.around("behind", deepest + 2, behind, *own, lowest, face)  # a disc's radius, and its front
    return as_map(*grid.around("shown", deepest + 1, shown, *own, room, face, asked=True))


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


def room_behind(surface: HeightMap, lowest: FloatArray, face: BoolArray) -> Squares:
    """Squared radius of the largest disc in the unseen around each cell that touches a front [cells²], shape (nx, ny).

    It is 0 where none does. How deep a thing is of which only a front was seen nobody knows; but where ground or a top
    was seen it is not. Discs of one cell are the scan's spacing.

    Args:
        surface: After `fill_holes`.
        lowest: Of the other points in each cell [m], inf where there is none, shape (nx, ny).
        face: Cells in which material goes up from the ground, see `find_faces`.
    """
    beside = highest_around(np.where(surface.state != UNKNOWN, surface.height, -np.inf), 1)
    top = np.isfinite(lowest) & (lowest < beside + CEILING)
    clear = ((surface.state == OBSERVED) | top) & ~face
    room, front = nearest_of(clear)[0], nearest_of(face)[0]
    shown = (room > 1.0) & (room <= MAX_HOLE_RADIUS / surface.cell_width) & (front <= room + 1.0)
    return np.rint(np.where(shown, room * room, 0.0)).astype(np.int32)


def without_hidden(surface: HeightMap, room: Squares, face: BoolArray, told: BoolArray) -> HeightMap:
    """Take back inferred ground that a thing of which only a front was seen may stand on, in the cells that are `told`.

    Any disc in the unseen that touches the front may belong to it: behind a trunk as deep as it is wide, behind a long
    wall up to half-way to the seen ground and as far beyond. But a cell of which all four neighbours were seen, as
    ground or as the front, is the scan's spacing.

    Args:
        surface: After `fill_holes`.
        room: `room_behind`, shape (nx, ny).
        face: Cells in which material goes up from the ground, see `find_faces`.
        told: Shape (nx, ny).
    """
    wide = ndimage.binary_dilation((surface.state != OBSERVED) & ~face, SIDES)
    asked = (surface.state == INFERRED) & wide & told
    return without(surface, _discs(np.ascontiguousarray(np.argwhere(room > 0)), room, count_cells(asked)) & asked)


def find_faces(surface: HeightMap, cell: IntArray, z: FloatArray, headroom: float) -> BoolArray:
    """Cells in which other points go up, without a gap, from the ground to twice the `headroom` [m], shape (nx, ny).

    A step's face ends at the ground above it; what has a gap is a table's edge; two points at much the same height go
    nowhere. But where nobody has seen the ground, nobody has seen the gap either: what goes up there by as much as the
    `headroom`, at any height, may go down. And what is lower than twice that, and as large as half a foot, is a box on
    the floor of which a scan from afar may show some of the top alone.

    Each of the points, by its flat `cell`, shape (m,), has a height `z` [m].
    """
    known = surface.state != UNKNOWN
    beside = highest_around(np.where(known, surface.height, -np.inf), _FACE_REACH).astype(float)
    low, high = extent_within(cell, z, beside, beside + 2.0 * headroom)
    face = (low <= beside + headroom) & (high > beside + headroom) & (high - low >= headroom)
    bottom, top = extent_within(cell, z, beside, beside + CEILING)
    face |= (surface.state != OBSERVED) & (top - bottom >= headroom)
    piece, _ = ndimage.label(np.isfinite(low), np.ones((3, 3)))
    large = np.bincount(piece.ravel()) >= _foot_cells(surface)
    found: BoolArray = face | (large[piece] & (piece > 0))
    return found


def _foot_cells(surface: HeightMap) -> int:
    """Cells that make half a foot."""
    return int(np.ceil(HALF_FOOT / surface.cell_width**2))


@njit(cache=True, nogil=True)
def _discs(centres: IntArray, square: Squares, asked: NDArray[np.int32]) -> BoolArray:
    """Cells nearer to any of the `centres`, (k, 2), than its radius, of those `asked`, shape (nx, ny).

    Radii are told by their `square` [cells²], shape (nx, ny), and who is asked by `count_cells`: a disc in whose square
    there is none is passed over.
    """
    nx, ny = square.shape
    covered = np.zeros((nx, ny), np.bool_)
    for x, y in centres:
        reach = np.sqrt(float(square[x, y]))
        far = int(reach)
        left, right, near, behind = max(x - far, 0), min(x + far + 1, nx), max(y - far, 0), min(y + far + 1, ny)
        if count_in(asked, left, right, near, behind) == 0:
            continue
        for u in range(left, right):
            for v in range(near, behind):
                covered[u, v] |= (u - x) ** 2 + (v - y) ** 2 < reach * reach
    return covered

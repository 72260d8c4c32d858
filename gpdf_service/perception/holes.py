"""Holes in seen ground: which are voids, and which their surroundings explain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import ceil

import numpy as np
from numba import njit
from scipy import ndimage

from gpdf_service.config import PerceptionConfig
from gpdf_service.fields.threads import run_chunked
from gpdf_service.ground.foot import LEAST_OBSTACLE
from gpdf_service.ground.footing import flights
from gpdf_service.perception.notches import FLIGHT, bites_reach, fill_bites, fill_notches, notches_reach
from gpdf_service.perception.smooth import FINE, FLAT, REACH, RINGS, onto_bends
from gpdf_service.perception.voids import MAX_HOLE_RADIUS, RING_SHARE, Voids, near_hollow, walled_down
from gpdf_service.tiles.boxes import Box, highest_around, lowest_around, window
from gpdf_service.tiles.columns import by_cell
from gpdf_service.tiles.layers import HALF
from gpdf_service.tiles.rows import extent_within, under
from gpdf_service.tiles.surface import INFERRED, OBSERVED, UNKNOWN, HeightMap, Nearest, nearest_seen
from gpdf_service.tiles.told import Grid
from gpdf_service.tiles.width import widest_cell
from gpdf_service.types import BoolArray, ByteArray, Float32Array, FloatArray, IntArray

GAP_CELLS = 4
"""Empty cells side by side that chance alone explains, at one in ten empty."""
RING = 2
"""Cells around a hole whose ground tells of it."""
PLANE_SHARE = 0.5
"""[-] Of the ground around a hole that must lie on that plane; the rest, higher, is a chair's feet or a step up."""
OPEN_SHARE = 0.5
"""[-] Of the rim of a hole under the open that must be ground: what furniture and walls close off can hold anything."""
CEILING = 1.9
"""[m] What is higher over the ground beside is a ceiling or a lamp, no furniture whose shadow is the hole."""
_ROUNDING = float(np.finfo(np.float64).eps)
"""[-] Of a least-squares fit, a row: a singular value below this times the rows over the largest counts as 0."""

Material = tuple[BoolArray, BoolArray, BoolArray]
"""Cells with points that may be a thing's, and those of them where all lie at the ground's height, and where some lie
over it; see `standing`."""
Ground = tuple[Float32Array, ByteArray]
"""Heights [m] and states of cells, shape (nx, ny)."""


def fill_holes(
    surface: HeightMap,
    grid: Grid,
    near: Nearest,
    material: Material,
    voids: Voids,
    config: PerceptionConfig,
    noise: float,
) -> HeightMap:
    """Infer ground where its surroundings explain it, and mark it.

    A hole is a connected set of unknown cells bounded by known ground and things, shut off from the map's rim, with no
    place further than `MAX_HOLE_RADIUS` from seen ground, and with the ground around it on one plane within a cell's
    slope or higher: an edge that drops is not bridged. Nor is a void, nor a hole as near to ground under which a pit's
    bottom was seen: the rays may have gone through it. Nor what lies under a thing: its legs and its back nobody sees.
    But a single cell in a hole with points at the ground's height alone holds no thing: rays met the floor there. A
    notch in a flight is filled with the treads beside it, and the gap between two treads with the lower one.
    Nothing is filled where the samples of the ground are so far apart that cells had to be as wide as they may be: what
    is empty then is no chance, and what is around it explains nothing.

    The `surface` is the ground as it was seen, `near` its `nearest_seen`, `material` of `standing`, `voids` of
    `find_voids`; the points had that `noise` before they were cured [m].
    """
    if surface.cell_width >= widest_cell(config):
        return surface
    height, state = _fill_gaps(grid, "gaps", surface.height, surface.state, surface, noise)

    def flight(_: Box, height: Float32Array, state: ByteArray) -> tuple[BoolArray]:
        return (flights(replace(surface, height=height, state=state), config.max_step, FLIGHT),)

    def bites(
        _: Box, asked: BoolArray, height: Float32Array, treads: BoolArray, beneath: BoolArray, stands: BoolArray
    ) -> tuple[Float32Array]:
        return (fill_bites(replace(surface, height=height), treads & asked, beneath, stands),)

    def notched(
        _: Box, height: Float32Array, state: ByteArray, bitten: Float32Array, treads: BoolArray, beneath: BoolArray
    ) -> tuple[Float32Array, ByteArray]:
        made = fill_notches(replace(surface, height=height, state=state), bitten, treads, beneath, config)
        return made.height, made.state

    (held, at_floor, over), beneath = material, voids.through | voids.pit
    (treads,) = grid.around("flights", int(FLIGHT / surface.cell_width) + 1, flight, height, state)
    (bitten,) = grid.around("bites", bites_reach(surface), bites, height, treads, beneath, over, asked=True)
    given = height, state, bitten, treads, beneath
    height, state = grid.around("notches", notches_reach(surface, config), notched, *given)
    known = state != UNKNOWN
    ends = _no_holes(grid, surface, near, voids)
    height, state = _fill_planes(grid, ends, surface.cell_width, (height, state), ~known & ~held, known)
    height, state = _fill_single(np.flatnonzero(at_floor & (state == UNKNOWN)), height, state)
    height, state = _fill_gaps(grid, "gaps left", height, state, surface, noise)  # of larger ones
    return replace(surface, height=height, state=state)


def _no_holes(grid: Grid, surface: HeightMap, near: Nearest, voids: Voids) -> BoolArray:
    """Cells that are in no hole which ground fills, see `fill_holes`, shape (nx, ny)."""
    (walled,) = grid.whole("walled down", lambda *_: (walled_down(surface, voids.walls),), voids.walls, surface.state)
    ends: BoolArray = voids.through | voids.pit | walled | (near.distance > MAX_HOLE_RADIUS)
    ends |= near_hollow(surface, voids.hollow)
    ends[[0, -1]] = ends[:, [0, -1]] = True
    return ends


def standing(beside: Float32Array, lowest: FloatArray, cell: IntArray, z: FloatArray, cell_width: float) -> Material:
    """Cells with points under a ceiling's height; where all lie as high as the ground `beside`; where some lie over it.

    The nearest seen ground is that high `beside` [m], (nx, ny). Each other point, by its flat `cell`, shape (m,), has a
    height `z` [m]; `lowest` is that of each cell, inf where there is none. What is off by a `cell_width` is as high.
    """
    ground = beside.astype(np.float64)
    over = extent_within(cell, z, ground + cell_width, under(ground + CEILING))[0]
    material = lowest < ground + CEILING
    return material, material & (lowest >= ground - cell_width) & np.isinf(over), np.isfinite(over)


def fill_faces(surface: HeightMap, lowest: FloatArray, cell: IntArray, z: FloatArray, max_step: float) -> HeightMap:
    """Infer the lower ground of a step under its face, where that fills a cell alone.

    All points of the cell are between the ground on both sides of it. On the level they may be a thing's foot.

    Each other point, by its flat `cell`, shape (m,), has a height `z` [m]; `lowest` is that of each cell, inf where
    there is none, shape (nx, ny). No face is higher than `max_step` [m].
    """
    known = surface.state != UNKNOWN
    low = lowest_around(np.where(known, surface.height, np.float32(np.inf)), 1)
    high = highest_around(np.where(known, surface.height, np.float32(-np.inf)), 1)
    face = ~known & np.isfinite(lowest) & (lowest >= low - LEAST_OBSTACLE) & _between(known, HALF)
    face &= (high - low > LEAST_OBSTACLE) & (high - low <= max_step)
    top = np.where(face, high + LEAST_OBSTACLE, np.inf).astype(np.float64)
    face &= np.isinf(extent_within(cell, z, top, np.full(top.shape, np.inf))[0])  # nothing over it
    height, state = np.where(face, low, surface.height), np.where(face, INFERRED, surface.state)
    return replace(surface, height=height, state=state)


def _fill_gaps(
    grid: Grid, name: str, height: Float32Array, state: ByteArray, surface: HeightMap, noise: float
) -> Ground:
    """Fill cells that spacing, or noise along a rim, left empty: of the bend around, or as high as the cell beside."""
    reach = max(RINGS, ceil(REACH * noise / surface.cell_width))

    def fill(_: Box, height: Float32Array, state: ByteArray, seen: Float32Array) -> Ground:
        height, state, observed = height.copy(), state.copy(), np.where(np.isnan(seen), UNKNOWN, OBSERVED)
        near = nearest_seen(replace(surface, height=seen, state=observed.astype(np.uint8)))
        empty = state == UNKNOWN
        gaps = _small(empty, near.distance, surface.cell_width)
        if noise > 0.0:
            gaps |= _small(empty & _between(~empty, HALF[:2]), near.distance, surface.cell_width)
        small = np.flatnonzero(gaps)
        made = near.height.ravel()[small]
        run_chunked(lambda a, b: onto_bends(seen, reach, max(FINE, FLAT * noise), small[a:b], made[a:b]), len(small))
        height.ravel()[small], state.ravel()[small] = made, INFERRED
        return height, state

    height, state = grid.around(name, GAP_CELLS + 1 + reach, fill, height, state, surface.height)
    return height, state


def _small(holes: BoolArray, distance: FloatArray, cell_width: float) -> BoolArray:
    """Connected cells of holes that are `GAP_CELLS` at most, none further than a cell from seen ground."""
    label, count = ndimage.label(holes)
    size, far = (np.bincount(label[cells], minlength=count + 1) for cells in (holes, holes & (distance > cell_width)))
    found: BoolArray = ((size <= GAP_CELLS) & (far == 0))[label] & holes
    return found


def _fill_single(cells: IntArray, height: Float32Array, state: ByteArray) -> Ground:
    """The ground with those of the flat `cells` filled that have ground on all four sides, with the mean of that."""
    cells = np.column_stack(np.unravel_index(cells, height.shape))
    x, y = cells[((cells > 0) & (cells < np.array(height.shape) - 1)).all(axis=1)].T
    beside = np.array([height[x - 1, y], height[x + 1, y], height[x, y - 1], height[x, y + 1]])
    held = ~np.isnan(beside).any(axis=0)
    if not held.any():
        return height, state
    height, state = height.copy(), state.copy()
    height[x[held], y[held]], state[x[held], y[held]] = beside[:, held].mean(axis=0), INFERRED
    return height, state


def _between(known: BoolArray, ways: Sequence[tuple[int, int]]) -> BoolArray:
    """Cells with a known one on either side in one of the `ways`."""
    made, wide, (nx, ny) = np.zeros_like(known), np.pad(known, 1), known.shape
    for x, y in ways:
        made |= wide[1 + x : nx + 1 + x, 1 + y : ny + 1 + y] & wide[1 - x : nx + 1 - x, 1 - y : ny + 1 - y]
    return made


def _fill_planes(
    grid: Grid, ends: BoolArray, cell_width: float, ground: Ground, holes: BoolArray, known: BoolArray
) -> Ground:
    """The ground with the `holes` that have none of the `ends` on the plane of the `known` ground around each."""
    name, given = "holes under planes", (holes, known, ends, *ground)
    again = grid.felt(name, RING, *given)
    parts: list[tuple[Box, Ground]] = []
    if again.any():
        filled = grid.former[name].made[1] != ground[1] if name in grid.former else np.zeros_like(holes)
        box, label, shut = _pieces_near(holes, ends, again, filled)
        made, labelled = (ground[0][box].copy(), ground[1][box].copy()), (label, *by_cell(label.ravel(), len(shut)))
        _fill(made, labelled, np.flatnonzero(shut), np.ascontiguousarray(known[box]), cell_width)
        parts.append((box, made))
    height, state = grid.put(name, given, again, parts)
    return height, state


def _pieces_near(
    cells: BoolArray, ends: BoolArray, again: BoolArray, changed: BoolArray
) -> tuple[Box, IntArray, BoolArray]:
    """A box, the number of each of the `cells`' connected pieces in it, and which of these are asked and have no end.

    A piece that is asked about `again` is marked there as a whole. One that has no end, or had none before, as what of
    it is `changed` tells, is in the box wholly, with `RING` cells around.
    """
    by, (nx, ny) = 4 * RING, cells.shape
    while True:
        box = rows, columns = window(again, by)
        label, count = ndimage.label(cells[box])
        rim = np.zeros(label.shape, dtype=bool)
        rim[: RING * (rows.start > 0)] = rim[label.shape[0] - RING * (rows.stop < nx) :] = True
        rim[:, : RING * (columns.start > 0)] = rim[:, label.shape[1] - RING * (columns.stop < ny) :] = True
        kinds = again[box], ends[box], rim, rim & changed[box]
        asked, ended, cut, was = (np.bincount(label[kind], minlength=count + 1) > 0 for kind in kinds)
        asked[0] = False
        if not (asked & np.where(ended, was, cut)).any():
            again[box] |= asked[label]
            return box, label, asked & ~ended
        by *= 4


@njit(cache=True, nogil=True)
def _fill(
    ground: Ground, labelled: tuple[IntArray, IntArray, IntArray], holes: IntArray, known: BoolArray, cell_width: float
) -> None:
    """Fill the `holes` by number: the label of each cell, and where the cells with each one begin in their order."""
    (height, state), (label, start, order), ny = ground, labelled, known.shape[1]
    met = np.zeros(height.shape, np.int64)
    for hole in holes:
        cells = order[start[hole] : start[hole + 1]]
        places, heights, share = _ring(cells, hole, label, known, height, met)
        if len(heights) < 3 or share < OPEN_SHARE:
            continue
        plane, held = _plane_under(places, heights, cell_width)
        for c in cells if held else cells[:0]:
            x, y = c // ny, c % ny
            height[x, y] = (x - cells[0] // ny) * plane[0] + (y - cells[0] % ny) * plane[1] + plane[2]
            state[x, y] = INFERRED


@njit(cache=True, nogil=True)
def _ring(
    cells: IntArray, hole: int, label: IntArray, known: BoolArray, height: Float32Array, met: IntArray
) -> tuple[FloatArray, FloatArray, float]:
    """Places (x, y, 1) and heights [m] of the known cells within `RING` of a hole, and how much of its rim is known.

    What was `met` around it is marked by twice its number, and right beside it by one more.
    """
    nx, ny = label.shape
    left, top = cells[0] // ny, cells[0] % ny
    ring, heights = np.ones((25 * len(cells), 3)), np.empty(25 * len(cells))  # of each cell the 5 × 5 around, at most
    count, beside, ground = 0, 0, 0
    for c in cells:
        x, y = c // ny, c % ny
        for u in range(max(x - RING, 0), min(x + RING + 1, nx)):
            for v in range(max(y - RING, 0), min(y + RING + 1, ny)):
                if label[u, v] == hole:
                    continue
                if known[u, v] and met[u, v] < 2 * hole:
                    ring[count, 0], ring[count, 1], heights[count] = u - left, v - top, height[u, v]
                    count += 1
                met[u, v] = max(met[u, v], 2 * hole)
                if abs(u - x) + abs(v - y) == 1 and met[u, v] == 2 * hole:
                    met[u, v] = 2 * hole + 1
                    beside += 1
                    ground += known[u, v]
    return ring[:count], heights[:count], ground / max(beside, 1)


@njit(cache=True, nogil=True)
def _plane_under(places: FloatArray, heights: FloatArray, cell_width: float) -> tuple[FloatArray, bool]:
    """The plane that most of the ground around a hole lies on or over, but for a box or a step up, if there is one."""
    on = heights <= np.median(heights) + cell_width
    plane: FloatArray = np.zeros(3)
    over: FloatArray = heights
    for _ in range(2):
        plane = np.linalg.lstsq(places[on], heights[on], _ROUNDING * len(heights))[0].astype(np.float64)
        over = heights - places @ plane
        on = np.abs(over) <= cell_width
        if not on.any():
            break
    return plane, on.mean() >= PLANE_SHARE and (over < -cell_width).mean() <= 1.0 - RING_SHARE

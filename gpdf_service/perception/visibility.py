"""What the rays of a scan saw of inferred ground: what they passed low over stays, holes that they fell into do not.

A change counts the rays that came and went, and all of them only in cells whose ground is another.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

from gpdf_service.config import PerceptionConfig
from gpdf_service.perception.follow import Counts, Follow
from gpdf_service.perception.rays import Bundle, Rays
from gpdf_service.perception.voids import MAX_HOLE_RADIUS
from gpdf_service.tiles.boxes import SIDES, Box, widened, window
from gpdf_service.tiles.nodes import components
from gpdf_service.tiles.surface import INFERRED, OBSERVED, Cells, HeightMap, cells_within, without
from gpdf_service.tiles.told import Grid
from gpdf_service.types import BoolArray, ByteArray, Float32Array, FloatArray, IntArray

ENOUGH = 2
"""Rays that show a place to be free: one can be off by the scanner's noise, or graze a corner of the cell."""
LOW = 0.5
"""[-] Of the height of the lowest body: so low must a ray pass, as others may pass over a thing."""
SECTORS = 72
"""Of 5° around an origin: as wide as a foot at a metre. In each it is told how near to itself the scanner saw."""
STATION = 0.1
"""[m] Origins within cells of this width are one station: the blind spot under it is ten times as wide."""
TALLEST_STATION = 3.0
"""[m] A scanner that stands, or is carried, is no higher over its ground; from a drone's nadir nothing is known."""
ENDS_BEFORE = 3.0
"""[-] Standard deviations of the noise before its point that a ray is surely free, and not yet in what it hit."""

_Told = tuple[Float32Array, BoolArray]
"""How high a ray may pass over each cell [m], and whether it is beside a step down, shape (nx, ny)."""


def seen_by_rays(
    grid: Grid, filled: HeightMap, rays: Rays, corner: FloatArray, config: PerceptionConfig, noise: float
) -> HeightMap:
    """Take back inferred ground that no ray shows to be free, and holes that a ray fell into.

    What hides behind a thing, or in it, no ray has passed over as low as half the lowest body is high. A scanner's own
    blind spot is no shadow: nothing nearer to its nadir than the nearest that it saw in that direction can have cast
    one. Single cells with seen ground on all four sides are the scan's spacing. Beside a step up the step itself casts
    a shadow, so there a ray need only be lower than its upper edge. Beside a step down a ray that fell passed the edge.

    The ground is `filled` by `fill_holes`, in cells that are counted from a `corner` [m], the same in all versions; the
    points of the `rays` have that `noise` [m].
    """
    as_map, width = partial(HeightMap, filled.origin, filled.cell_width), filled.cell_width

    def steps(_: Box, asked: BoolArray, height: Float32Array, state: ByteArray) -> tuple[NDArray[Any], ...]:
        part = as_map(height, state)
        beside = ndimage.minimum_filter(state == OBSERVED, footprint=SIDES, mode="constant")
        return *_steps_beside(part, asked & (state == INFERRED), config), beside

    def holes(height: Float32Array, state: ByteArray, fell: Counts, edge: BoolArray) -> tuple[BoolArray]:
        into, low = (fell > 0) & ~edge, LOW * config.min_headroom
        return (_of_one_hole(as_map(height, state), state == INFERRED, into, low) if into.any() else into,)

    def shown(_: Box, height: Float32Array, state: ByteArray, *told: NDArray[Any]) -> tuple[Float32Array, ByteArray]:
        single, low, blind, hole = told
        free = (single | (low >= ENOUGH) | blind) & ~hole
        part = without(as_map(height, state), (state == INFERRED) & ~free)
        return part.height, part.state

    own, before = (filled.height, filled.state), max(2.0 * width, ENDS_BEFORE * noise)
    room, edge, single = grid.around("steps beside", _step_reach(width, config), steps, *own, asked=True)
    low, fell = _count(grid, filled, room, rays, Follow(corner, width, before, config.max_step))
    blind = _blind(grid, filled, rays)
    (hole,) = grid.whole("holes fallen through", holes, *own, fell, edge)
    return as_map(*grid.around("shown by rays", 0, shown, *own, single, low, blind, hole))


def _of_one_hole(surface: HeightMap, asked: BoolArray, cells: BoolArray, apart: float) -> BoolArray:
    """The `asked` cells that hang together with one of the `cells` over no step higher than `apart` [m], (nx, ny)."""
    number, steepest, pairs = np.arange(asked.size).reshape(asked.shape), max(apart, surface.cell_width), []
    for one, other in (((slice(1, None),), (slice(-1),)), ((..., slice(1, None)), (..., slice(-1)))):
        flat = np.abs(surface.height[one] - surface.height[other]) <= steepest  # never so where one is unknown
        pairs.append(np.stack([number[one][flat], number[other][flat]]))
    a, b = np.concatenate(pairs, axis=1)
    label = components(a, b, asked.ravel())
    made: BoolArray = np.isin(label, label[cells.ravel()]).reshape(asked.shape)
    return made


def _step_reach(width: float, config: PerceptionConfig) -> int:
    """Cells of that `width` [m] within which a step decides how high a ray may pass."""
    return int(np.ceil(config.widest_gap / width))


def _steps_beside(surface: HeightMap, asked: BoolArray, config: PerceptionConfig) -> tuple[Float32Array, BoolArray]:
    """How high a ray may pass over `asked` ground to show it free [m], as high as a step beside; what is by a drop."""
    low, reach = LOW * config.min_headroom, _step_reach(surface.cell_width, config)
    seen = np.where(surface.state == OBSERVED, surface.height, np.float32(np.nan))
    room, edge = np.full(asked.shape, low, np.float32), np.zeros_like(asked)
    _look_beside((surface.height, seen), np.argwhere(asked), reach, (low, config.max_step), (room, edge))
    return room, edge


@njit(cache=True, nogil=True)
def _look_beside(
    ground: tuple[Float32Array, Float32Array], cells: IntArray, reach: int, steps: tuple[float, float], told: _Told
) -> None:
    """The highest seen ground within `reach` cells that is a step up, and whether some is a step down, of each cell."""
    (height, seen), (least, most), (room, edge) = ground, steps, told
    nx, ny = height.shape
    for x, y in cells:
        for i in range(max(x - reach, 0), min(x + reach + 1, nx)):
            for j in range(max(y - reach, 0), min(y + reach + 1, ny)):
                over = seen[i, j] - height[x, y]
                if room[x, y] < over <= most:
                    room[x, y] = over
                edge[x, y] |= least < -over <= most


def _count(grid: Grid, filled: HeightMap, room: Float32Array, rays: Rays, follow: Follow) -> tuple[Counts, Counts]:
    """How many rays passed low over each inferred cell, and how many fell into it, both (nx, ny)."""
    given, inferred = (filled.height, filled.state, room), filled.state == INFERRED
    felt = grid.felt("rays", 0, *given)
    made = follow.over(rays.bundles, filled, room, inferred & felt)
    if rays.news is not None and "rays" in grid.former:
        came, went = (follow.over([each], filled, room, inferred & ~felt) for each in rays.news)
        other = (came != went).any(axis=-1)
        made[other] = np.stack([was[other] for was in grid.former["rays"].made], axis=-1) + (came - went)[other]
        felt |= other
    box = window(felt, 0)
    low, fell = grid.put("rays", given, felt, [(box, tuple(np.ascontiguousarray(made[box][..., k]) for k in (0, 1)))])
    return low, fell


def _blind(grid: Grid, filled: HeightMap, rays: Rays) -> BoolArray:
    """Inferred cells in a station's blind spot, shape (nx, ny)."""
    given, reach = (filled.height, filled.state), _blind_reach(filled)
    felt = grid.felt("blind", reach, *given)
    if rays.news is not None:
        other = np.zeros(felt.size + 1, dtype=bool)
        for each in rays.news:
            other[cells_within(each.origins[np.isfinite(each.origins).all(axis=1)], filled)] = True
        felt |= widened(other[:-1].reshape(felt.shape), reach)
    box = window(felt, 0)
    made = _blind_spots(filled, felt & (filled.state == INFERRED), rays)
    (blind,) = grid.put("blind", given, felt, [(box, (np.ascontiguousarray(made[box]),))])
    return blind


def _blind_reach(surface: HeightMap) -> int:
    """Cells around one within which any ray of a station begins in whose blind spot it is."""
    return int((MAX_HOLE_RADIUS + STATION) / surface.cell_width) + 3


def _blind_spots(surface: HeightMap, asked: BoolArray, rays: Rays) -> BoolArray:
    """The `asked` cells nearer to a station's nadir than what it saw below itself in that direction, shape (nx, ny)."""
    blind = np.zeros(asked.shape, dtype=bool)
    if not asked.any():
        return blind
    over = widened(asked, _blind_reach(surface))
    runs = [_runs_over(each, surface.arrays, over) for each in rays.bundles]
    own = np.concatenate([each.origins[first] for each, (first, _) in zip(rays.bundles, runs, strict=True)])
    if len(own) == 0:
        return blind
    _, number = np.unique(np.floor(own / STATION).astype(np.int64) @ _KEYS, return_inverse=True)
    at = np.full((number.max() + 1, 3), np.inf)
    np.minimum.at(at, number, own)
    nearest, begin = np.full((len(at), SECTORS), MAX_HOLE_RADIUS), 0
    for each, (first, run) in zip(rays.bundles, runs, strict=True):
        _nearest_seen_below(at, each.ends, number[begin : begin + len(first)], run, nearest)
        begin += len(first)
    _mark_blind(at, nearest, surface.arrays, blind)
    return blind & asked


_KEYS: IntArray = np.array([1, 1 << 21, 1 << 42])
"""A number for each station: 200 km at 0.1 m fit into 21 bits."""


@njit(cache=True, nogil=True)
def _runs_over(rays: Bundle, ground: Cells, over: BoolArray) -> tuple[IntArray, IntArray]:
    """The first of each run of rays from one place over some cells, and of each ray its run, −1 where it is in none."""
    (origins, ends, there), corner, width = rays, ground.origin, ground.width
    first, run, last, inside = np.empty(len(ends), np.int64), np.full(len(ends), -1), -1, False
    count = 0
    for i in range(len(ends)):
        if not there[i]:
            continue
        k = i if len(origins) > 1 else 0
        x, y, z = origins[k]
        if last < 0 or x != origins[last, 0] or y != origins[last, 1] or z != origins[last, 2]:
            inside, last = False, k
            if np.isfinite(x + y + z):
                u, v = int(np.floor((x - corner[0]) / width)), int(np.floor((y - corner[1]) / width))
                inside = 0 <= u < over.shape[0] and 0 <= v < over.shape[1] and over[u, v]
            if inside:
                first[count] = k
                count += 1
        if inside:
            run[i] = count - 1
    return first[:count].copy(), run


@njit(cache=True, nogil=True)
def _sector(x: float, y: float) -> int:
    return min(int((np.arctan2(y, x) + np.pi) / (2.0 * np.pi) * SECTORS), SECTORS - 1)


@njit(cache=True, nogil=True)
def _nearest_seen_below(at: FloatArray, ends: FloatArray, number: IntArray, run: IntArray, nearest: FloatArray) -> None:
    """How near to each station, by the `number` of each run, it saw something below itself in each sector [m]."""
    for i in range(len(ends)):
        if run[i] < 0:
            continue
        s = number[run[i]]
        if ends[i, 2] >= at[s, 2]:
            continue
        x, y = ends[i, 0] - at[s, 0], ends[i, 1] - at[s, 1]
        away = np.hypot(x, y)
        if away < MAX_HOLE_RADIUS:
            k = _sector(x, y)
            for beside in (k - 1, k, k + 1):
                nearest[s, beside % SECTORS] = min(nearest[s, beside % SECTORS], away)


@njit(cache=True, nogil=True)
def _mark_blind(at: FloatArray, nearest: FloatArray, ground: Cells, blind: BoolArray) -> None:
    height, corner, width = ground.height, ground.origin, ground.width
    (nx, ny), reach = height.shape, int(MAX_HOLE_RADIUS / width) + 1
    for s in range(len(at)):
        u, v = int(np.floor((at[s, 0] - corner[0]) / width)), int(np.floor((at[s, 1] - corner[1]) / width))
        for i in range(max(u - reach, 0), min(u + reach + 1, nx)):
            for j in range(max(v - reach, 0), min(v + reach + 1, ny)):
                x, y = corner[0] + (i + 0.5) * width - at[s, 0], corner[1] + (j + 0.5) * width - at[s, 1]
                if 0.0 < at[s, 2] - height[i, j] <= TALLEST_STATION:
                    blind[i, j] |= np.hypot(x, y) - width < nearest[s, _sector(x, y)]

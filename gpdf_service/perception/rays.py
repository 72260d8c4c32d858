"""What the rays of a scan saw on their way: inferred ground that they passed low over, and holes that they fell into.

A ray is free from its origin to the point that it hit. It is followed in plan from cell to cell, and only where it is
as low as the ground: of a ray to a wall that is nowhere, of one to the floor it is its last part.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from gpdf_service.config import PerceptionConfig
from gpdf_service.errors import CloudError
from gpdf_service.fields.threads import run_parallel
from gpdf_service.perception.voids import MAX_HOLE_RADIUS
from gpdf_service.tiles.boxes import SIDES, over_blocks, widened
from gpdf_service.tiles.nodes import components
from gpdf_service.tiles.surface import INFERRED, OBSERVED, Cells, HeightMap, cells_within, without
from gpdf_service.types import BoolArray, ByteArray, Float32Array, FloatArray, IntArray

SHARES = 4
"""Parts of the rays, each counted by itself, so that the sum is the same however many cores there are."""
TILE = 16
"""Cells along the side of a tile, which a ray that is over its ground crosses in one step."""
STEPS = 32
"""Tiles that a ray is followed through on average: where they are longer, every other one is left out, or more."""
SAMPLE = 10_000
"""Rays that tell how many tiles they go through."""
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

_Walk = tuple[IntArray, IntArray, FloatArray, FloatArray]
"""Of a walk over a grid: the cell, the way to go along each axis, the share of the ray where the next one begins, and
how much more it is to that behind it; each (2,)."""
_Cells = tuple[FloatArray, float, tuple[int, int]]
"""Of cells: their lower corner [m], their width [m] and how many there are along each axis."""
_Ray = tuple[FloatArray, FloatArray]
"""From where to where a ray goes [m]."""
_Told = tuple[Float32Array, BoolArray]
"""How high a ray may pass over each cell [m], and whether it is beside a step down, shape (nx, ny)."""


class Rays(NamedTuple):
    """Rays of a scan.

    Attributes:
        origins: Where they began [m], shape (1, 3) for all of them, or (n, 3); NaN where that is not known.
        ends: What they hit [m], shape (n, 3).
    """

    origins: FloatArray
    ends: FloatArray

    def chosen(self, rows: NDArray[np.generic], ends: FloatArray, fresh: FloatArray | None = None) -> Rays:
        """Those of the `rows`, then the `fresh` ones, by their origins (k, 3), which hit the `ends`, shape (m, 3)."""
        if fresh is None and len(self.origins) == 1:
            return Rays(self.origins, ends)
        own = np.broadcast_to(self.origins, self.ends.shape)[rows]
        return Rays(own if fresh is None else np.concatenate([own, fresh]), ends)


def check_origins(origins: ArrayLike, points: FloatArray) -> Rays:
    """The rays to the `points`, shape (n, 3), from one origin, shape (3,), or from one for each, shape (n, 3) [m].

    Raises:
        CloudError: another shape, or not finite.
    """
    try:
        made = np.ascontiguousarray(origins, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise CloudError("origins", f"no array of numbers ({error})", "Pass (3,) or (n, 3), in metres.") from error
    if made.shape not in ((3,), points.shape):
        raise CloudError("origins", f"an array of shape {made.shape}", f"Pass (3,), or {points.shape}: one a point.")
    if not np.isfinite(made).all():
        raise CloudError("origins", "not all of them are finite", "Leave them out if they are not known.")
    return Rays(made.reshape(-1, 3), points)


def seen_by_rays(filled: HeightMap, rays: Rays, config: PerceptionConfig, noise: float) -> HeightMap:
    """Take back inferred ground that no ray shows to be free, and holes that a ray fell into.

    What hides behind a thing, or in it, no ray has passed over as low as half the lowest body is high. A scanner's own
    blind spot is no shadow: nothing nearer to its nadir than the nearest that it saw in that direction can have cast
    one. Single cells with seen ground on all four sides are the scan's spacing. Beside a step up the step itself casts
    a shadow, so there a ray need only be lower than its upper edge. Beside a step down a ray that fell passed the edge.

    The ground is `filled` by `fill_holes`; the points of the `rays` have that `noise` [m].
    """
    asked = filled.state == INFERRED
    if not asked.any():
        return filled
    room, edge = _steps_beside(filled, asked, config)
    grid = _grid_of(filled, asked, room, max(2.0 * filled.cell_width, ENDS_BEFORE * noise))
    passed, fell = _follow(grid, rays, config.max_step)
    beside = ndimage.minimum_filter(filled.state == OBSERVED, footprint=SIDES, mode="constant")
    shown = (passed >= ENOUGH) | beside | _blind_spots(filled, asked, rays)
    return without(filled, asked & (~shown | _of_one_hole(filled, asked, fell & ~edge, LOW * config.min_headroom)))


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


def _follow(grid: _Grid, rays: Rays, max_step: float) -> tuple[IntArray, BoolArray]:
    """How many rays passed low over each of the cells that are asked about, and into which one fell, both (nx, ny)."""
    sampled = max(1, len(rays.ends) // SAMPLE)
    tiles = _tiles_along(rays, grid, sampled) * sampled
    every = max(1, int(np.ceil(tiles / (STEPS * max(len(rays.ends), 1)))))
    shares = run_parallel(lambda k: _cast(rays, grid, max_step, k * every, SHARES * every), range(SHARES))
    counts, through = zip(*shares, strict=True)
    return np.sum(counts, axis=0, dtype=np.int64), np.any(through, axis=0)


class _Grid(NamedTuple):
    """Cells that are asked about: their height, NaN of the others, and how high a ray may pass over them [m].

    Of each tile of them the lowest height and the highest top. The box from `corner` to `far` [m], shape (3,), holds
    all. A ray counts as far as that much `before` its point [m].
    """

    height: Float32Array
    top: Float32Array
    lowest: Float32Array
    highest: Float32Array
    corner: FloatArray
    far: FloatArray
    width: float
    before: float


def _grid_of(surface: HeightMap, asked: BoolArray, room: Float32Array, before: float) -> _Grid:
    height, top = (np.where(asked, each, np.nan).astype(np.float32) for each in (surface.height, surface.height + room))
    lowest, highest = over_blocks(height, TILE, np.fmin, np.inf), over_blocks(top, TILE, np.fmax, -np.inf)
    width = surface.cell_width
    corner = np.append(surface.origin, float(np.nanmin(height)) - width)
    far = np.append(surface.origin + width * (np.array(asked.shape) - 1e-6), float(np.nanmax(top)))
    return _Grid(height, top, lowest, highest, corner, far, width, before)


def _steps_beside(surface: HeightMap, asked: BoolArray, config: PerceptionConfig) -> tuple[Float32Array, BoolArray]:
    """How high a ray may pass over `asked` ground to show it free [m], as high as a step beside; what is by a drop."""
    low = LOW * config.min_headroom
    seen = np.where(surface.state == OBSERVED, surface.height, np.float32(np.nan))
    reach = int(np.ceil(config.widest_gap / surface.cell_width))
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


@njit(cache=True, nogil=True)
def _part_at_ground(a: FloatArray, b: FloatArray, grid: _Grid) -> tuple[float, float]:
    """Where a ray from a to b enters and leaves the heights and the plan that are asked about, as shares of it."""
    length = np.sqrt((b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2 + (b[2] - a[2]) ** 2)
    if not grid.before < length < np.inf:
        return 1.0, 0.0
    first, last = 0.0, 1.0 - grid.before / length
    for k in range(3):
        least, most, along = grid.corner[k], grid.far[k], b[k] - a[k]
        if abs(along) < 1e-12:
            if not least <= a[k] <= most:
                return 1.0, 0.0
            continue
        one, other = (least - a[k]) / along, (most - a[k]) / along
        first, last = max(first, min(one, other)), min(last, max(one, other))
    return first, last


@njit(cache=True, nogil=True)
def _tiles_along(rays: Rays, grid: _Grid, step: int) -> float:
    """Tiles that every `step`-th ray goes through."""
    tiles, (origins, ends) = 0.0, rays
    for i in range(0, len(ends), step):
        a, b = origins[i % len(origins)], ends[i]
        first, last = _part_at_ground(a, b, grid)
        if first < last:
            tiles += 1.0 + (last - first) * (abs(b[0] - a[0]) + abs(b[1] - a[1])) / (TILE * grid.width)
    return tiles


@njit(cache=True, nogil=True)
def _enter(ray: _Ray, t: float, cells: _Cells, walk: _Walk) -> None:
    """Where a ray is at the share t of it, and when it comes to the next cell along each axis."""
    (a, b), (corner, width, shape), (at, ahead, cross, each) = ray, cells, walk
    for k in range(2):
        along = b[k] - a[k]
        at[k] = min(max(int(np.floor((a[k] + t * along - corner[k]) / width)), 0), shape[k] - 1)
        ahead[k] = 1 if along > 0.0 else -1
        cross[k], each[k] = np.inf, np.inf
        if abs(along) > 1e-12:
            cross[k] = (corner[k] + width * (at[k] + (along > 0.0)) - a[k]) / along
            each[k] = width / abs(along)


@njit(cache=True, nogil=True)
def _go_on(shape: tuple[int, int], walk: _Walk) -> bool:
    """To the next cell, if there is one."""
    at, ahead, cross, each = walk
    k = 0 if cross[0] <= cross[1] else 1
    at[k] += ahead[k]
    cross[k] += each[k]
    return bool(0 <= at[k] < shape[k])


@njit(cache=True, nogil=True)
def _cast(rays: Rays, grid: _Grid, max_step: float, begin: int, step: int) -> tuple[ByteArray, BoolArray]:
    """How many of every `step`-th ray were in each cell between its ground and its top, 255 at most; where one fell.

    It fell from or to deeper under the ground than `max_step` [m]. In tiles that are as low it goes from cell to cell.
    """
    origins, ends = rays
    tiles = grid.corner, TILE * grid.width, grid.lowest.shape
    seen = passed, fell = np.zeros(grid.height.shape, np.uint8), np.zeros(grid.height.shape, np.bool_)
    walk = np.zeros(2, np.int64), np.zeros(2, np.int64), np.zeros(2), np.zeros(2)
    inner = walk[0].copy(), walk[1].copy(), walk[2].copy(), walk[3].copy()
    for i in range(begin, len(ends), step):
        a, b = origins[i % len(origins)], ends[i]
        t, last = _part_at_ground(a, b, grid)
        if not t < last:
            continue
        deep = min(a[2], b[2]) + max_step
        _enter((a, b), t, tiles, walk)
        while t < last:
            x, y = walk[0]
            leave = max(min(min(walk[2][0], walk[2][1]), last), t)
            z, behind = a[2] + t * (b[2] - a[2]), a[2] + leave * (b[2] - a[2])
            if min(z, behind) <= grid.highest[x, y] and max(z, behind) >= grid.lowest[x, y]:
                _look_along((a, b), (t, leave), grid, deep, inner, seen)
            t = leave
            if not _go_on(tiles[2], walk):
                break
    return passed, fell


@njit(cache=True, nogil=True)
def _look_along(
    ray: _Ray, part: tuple[float, float], grid: _Grid, deep: float, walk: _Walk, seen: tuple[ByteArray, BoolArray]
) -> None:
    """`_cast` of the part of a ray between two shares of it (Amanatides and Woo, 1987)."""
    (a, b), (t, last), (passed, fell) = ray, part, seen
    shape, at = grid.height.shape, walk[0]
    _enter(ray, t, (grid.corner, grid.width, shape), walk)
    while t < last:
        leave = max(min(min(walk[2][0], walk[2][1]), last), t)
        ground = grid.height[at[0], at[1]]
        if ground == ground:
            z, behind = a[2] + t * (b[2] - a[2]), a[2] + leave * (b[2] - a[2])
            lowest, highest = min(z, behind), max(z, behind)
            if lowest <= grid.top[at[0], at[1]] and highest >= ground and passed[at[0], at[1]] < 255:
                passed[at[0], at[1]] += 1
            if lowest < ground <= highest and deep < ground:
                fell[at[0], at[1]] = True
        t = leave
        if not _go_on(shape, walk):
            break


def _blind_spots(surface: HeightMap, asked: BoolArray, rays: Rays) -> BoolArray:
    """Cells nearer to a station's nadir than anything that it saw below itself in that direction, shape (nx, ny)."""
    blind, many = np.zeros(asked.shape, dtype=bool), len(rays.origins) > 1
    known = np.flatnonzero(np.isfinite(rays.origins).all(axis=1))
    if not len(known):
        return blind
    own = rays.origins[known]
    another = np.r_[True, (own[1:] != own[:-1]).any(axis=1)]  # a station's rays come one after another
    runs = np.flatnonzero(another)
    key = np.floor(own[runs] / STATION).astype(np.int64) @ _KEYS
    _, first, number = np.unique(key, return_index=True, return_inverse=True)
    at = own[runs[first]]
    wanted = widened(asked, int(MAX_HOLE_RADIUS / surface.cell_width))
    over = np.append(wanted.ravel(), False)[cells_within(at, surface)]
    station = np.where(over, np.cumsum(over) - 1, -1)
    of_ray = np.full(len(rays.ends), -1 if many else station[0])
    if many:
        of_ray[known] = station[number][np.cumsum(another) - 1]
    at = at[over]
    nearest = np.full((len(at), SECTORS), MAX_HOLE_RADIUS)
    _nearest_seen_below(at, rays.ends, of_ray, nearest)
    _mark_blind(at, nearest, surface.arrays, blind)
    return blind & asked


_KEYS: IntArray = np.array([1, 1 << 21, 1 << 42])
"""A number for each station: 200 km at 0.1 m fit into 21 bits."""


@njit(cache=True, nogil=True)
def _sector(x: float, y: float) -> int:
    return min(int((np.arctan2(y, x) + np.pi) / (2.0 * np.pi) * SECTORS), SECTORS - 1)


@njit(cache=True, nogil=True)
def _nearest_seen_below(at: FloatArray, ends: FloatArray, of_ray: IntArray, nearest: FloatArray) -> None:
    for i in range(len(ends)):
        s = of_ray[i]
        if s < 0 or ends[i, 2] >= at[s, 2]:
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

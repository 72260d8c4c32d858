"""Where a foot rests on rough treads: it does not sink into what is narrower than itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numba import njit
from scipy import ndimage

from gpdf_service.config import PerceptionConfig
from gpdf_service.fields.threads import run_chunked
from gpdf_service.ground.foot import SOLE, STRIDE
from gpdf_service.tiles.boxes import highest_around, lowest_around, widened, window
from gpdf_service.tiles.layers import HALF
from gpdf_service.tiles.surface import UNKNOWN, Cells, HeightMap, cell_of, cropped, rise_around
from gpdf_service.types import BoolArray, Float32Array, FloatArray, IntArray

_LIMITS = PerceptionConfig()
FLIGHT_RISE = _LIMITS.max_step
"""[m] Ground that differs by more within a stride is a flight."""
ROUGH = 0.075
"""[m] What is no higher over a tread is of it: half of what a surface in a wide cell is thick at most."""
_DROP = np.float32(-1e6)
"""[m] Height of what lies lower than all ground."""


def bridged(surface: HeightMap, max_step: float) -> HeightMap:
    """The ground of flights, with pits narrower than a foot closed: behind a nose a scan sags, the tread does not.

    Greyscale closing by a disc of `SOLE`. It leaves a staircase, which only rises one way, as it is. A flight is where
    the ground changes by more than a step, `max_step` [m], within a stride. A ridge closes nothing: the corner between
    a riser and a stringer is no pit.
    """
    known = surface.state != UNKNOWN
    flight = known & flights(surface, max_step)
    if not flight.any():
        return surface
    rings = rings_of(SOLE, surface.cell_width)
    disc = np.hypot(*np.mgrid[-rings : rings + 1, -rings : rings + 1]) <= rings + 0.5
    dilated = np.where(known, ndimage.maximum_filter(_without_ridges(surface, flight), footprint=disc), np.inf)
    closed = np.fmax(surface.height, ndimage.minimum_filter(dilated, footprint=disc))
    return replace(surface, height=np.where(flight, closed, surface.height).astype(np.float32))


def footholds(surface: HeightMap, max_step: float) -> FloatArray:
    """Height of the ground, in flights without what is narrower than a foot [m], shape (nx, ny), -inf where unknown.

    A step leads up to a tread, not to the stringer beside it. A sill on a floor is narrower, too, and one steps over
    it. A flight is as in `bridged`, and goes on a stride further: its lowest treads are no step over the floor.
    """
    return _without_ridges(surface, _flight_and_stride(surface, max_step)).astype(np.float64)


def ridges(surface: HeightMap, max_step: float, pits: Float32Array, drops: BoolArray) -> BoolArray:
    """Cells of flights that are over their `footholds`, shape (nx, ny), and as many in one piece as a tread is deep.

    They are stringers, and tips of treads at a free side; a single cell is a smear of what stands beside. Beside a
    stringer, the gap between two flights is no foothold, nor is that through which a room beneath was seen.

    The `pits` are the ground before it was `bridged` [m], NaN where it was not seen, the `drops` unknown cells under
    which something was seen deeper than a step, shape (nx, ny) each.
    """
    beside = np.where(drops & (surface.state == UNKNOWN), _DROP, pits)
    flight = _flight_and_stride(surface, max_step)
    over = surface.height > _without_ridges(surface, flight)  # NaN, where it is unknown, compares false
    over |= surface.height > _without_ridges(surface, flight, beside)
    piece, count = ndimage.label(over, np.ones((3, 3)))
    long = np.bincount(piece.ravel(), minlength=count + 1) * surface.cell_width >= _LIMITS.tread_depth - 1e-6
    found: BoolArray = over & long[piece]
    return found


def _flight_and_stride(surface: HeightMap, max_step: float) -> BoolArray:
    return widened(flights(surface, max_step), rings_of(STRIDE, surface.cell_width))


def _without_ridges(surface: HeightMap, flight: BoolArray, beside: Float32Array | None = None) -> Float32Array:
    """The ground [m], -inf where unknown; that of a `flight`, (nx, ny), without what is narrower than a foot, (nx, ny).

    A ridge is narrower than `SOLE` in some direction, and over all that is to either side within a foot's length by
    more than a tread is rough, but for what is a step higher. A nose is none: where heights `beside` it are given [m],
    which show the room behind a shadow, too, the way up must be along the ridge.
    """
    made = np.where(surface.state != UNKNOWN, surface.height, np.float32(-np.inf))
    cells = np.flatnonzero(flight & np.isfinite(made))
    own = surface.arrays, surface.height if beside is None else beside, beside is not None
    run_chunked(lambda a, b: _lower_ridges(*own, cells[a:b], made), len(cells))
    return made


@njit(cache=True, nogil=True)
def _lower_ridges(ground: Cells, beside: Float32Array, along: bool, cells: IntArray, made: Float32Array) -> None:
    for cell in cells:
        x, y = cell // beside.shape[1], cell % beside.shape[1]
        own = ground.height[x, y]
        low, high, lowered = own - np.float32(ROUGH), own + np.float32(FLIGHT_RISE), float(own)
        for dx, dy in HALF:
            sole = SOLE / (ground.width * np.hypot(dx, dy))
            widest, foot = max(1, round(sole)), max(1, round(2.0 * sole))
            for ahead in range(1, widest + 1):
                side = _highest_along(beside, (x, y), (dx, dy), (ahead, foot), high)
                if side >= low:
                    continue
                for behind in range(1, widest + 2 - ahead):
                    other = _highest_along(beside, (x, y), (-dx, -dy), (behind, foot), high)
                    if other < low:
                        lowered = min(lowered, max(side, other))
        if lowered < low and (not along or _falls_aside(beside, ground, (x, y))):
            made[x, y] = lowered


@njit(cache=True, nogil=True)
def _falls_aside(height: Float32Array, ground: Cells, at: tuple[int, int]) -> bool:
    """Whether ground more than a step lower within a foot's length lies beside a flight, under 45° across its way up.

    The way up is that of the plane through the treads on the other side, but for what is narrower than a foot.
    """
    reach, (x, y), own = rings_of(STRIDE, ground.width), at, ground.height[at]
    rows, columns = 0.0, 0.0
    for u in range(max(x - reach, 0), min(x + reach + 1, height.shape[0])):
        for v in range(max(y - reach, 0), min(y + reach + 1, height.shape[1])):
            if height[u, v] < own - FLIGHT_RISE and np.hypot(u - x, v - y) * ground.width <= 2.0 * SOLE:
                rows, columns = rows + u - x, columns + v - y
    away = max(np.hypot(rows, columns), 1e-9)
    rows, columns = rows / away, columns / away
    count, place, total, square = 0, np.zeros(3), np.zeros(3), np.zeros((3, 3))
    for u in range(max(x - reach, 0), min(x + reach + 1, height.shape[0])):
        for v in range(max(y - reach, 0), min(y + reach + 1, height.shape[1])):
            inside = -(rows * (u - x) + columns * (v - y)) * ground.width
            if inside > 0.5 * SOLE and abs(height[u, v] - own) <= FLIGHT_RISE:
                place[0], place[1], place[2] = u - x, v - y, height[u, v] - own
                for k in range(3):
                    total[k] += place[k]
                    square[k] += place[k] * place
                count += 1
    spread = square - total * total.reshape(3, 1) / max(count, 1)
    up = spread[1, 1] * spread[0, 2] - spread[0, 1] * spread[1, 2]
    aside = spread[0, 0] * spread[1, 2] - spread[0, 1] * spread[0, 2]
    across: float = up * rows + aside * columns
    found: bool = across * across < 0.5 * (up * up + aside * aside)
    return found


@njit(cache=True, nogil=True)
def _highest_along(
    height: Float32Array, at: tuple[int, int], by: tuple[int, int], cells: tuple[int, int], most: float
) -> float:
    """Highest ground up to `most` in a line, from the first of the `cells` on so many, inf where none is known."""
    found, (first, count) = -np.inf, cells
    for k in range(first, first + count):
        u, v = at[0] + k * by[0], at[1] + k * by[1]
        if 0 <= u < height.shape[0] and 0 <= v < height.shape[1] and found < height[u, v] <= most:  # NaN: false
            found = float(height[u, v])
    return found if found > -np.inf else np.inf


def flights(surface: HeightMap, max_step: float, reach: float = STRIDE) -> BoolArray:
    """Cells around which known ground differs by more than a step, `max_step`, within a `reach` [m], shape (nx, ny)."""
    known, rings = surface.state != UNKNOWN, rings_of(reach, surface.cell_width)
    low, high = (np.where(known, surface.height, none) for none in (np.inf, -np.inf))
    found: BoolArray = highest_around(high, rings) - lowest_around(low, rings) > max_step
    return found


def by_treads(touched: BoolArray, reach: int, grounds: tuple[HeightMap, HeightMap], strides: int) -> BoolArray:
    """Cells within `reach` cells of the `touched` ones, (nx, ny), that ground is uneven around, now or before.

    As far as footholds and treads are told, ground decides on nothing else: of a flight within so many `strides`.
    """
    found, length = widened(touched, reach), strides * STRIDE
    box = window(found, rings_of(length, grounds[0].cell_width))
    one, other = (flights(cropped(ground, box), ROUGH, length) for ground in grounds)
    found[box] &= one | other
    return found


def on_treads(z: FloatArray, cell: IntArray, surface: HeightMap, max_step: float) -> BoolArray:
    """Which points are of the treads of a flight, shape (m,): no more than `ROUGH` over where a foot rests beside them.

    A foot rests on what is as wide as itself, at most a step higher, and within a sole: the same tread, which wear
    makes rough, or the next. At a flight's side, where no ground goes on within a sole, stands its stringer: there
    nothing is of a tread. A tread is `is_tread` within a stride.

    The points have heights z [m] and flat cells, shape (m,) each. The body takes steps up to `max_step` [m].
    """
    found, width = np.zeros(len(z), dtype=bool), surface.cell_width
    height = np.where(surface.state != UNKNOWN, surface.height, np.float32(np.nan))
    own = height, footholds(surface, max_step), (width, max_step)
    run_chunked(lambda a, b: _on_treads(z[a:b], cell[a:b], *own, found[a:b]), len(z))
    return found


@njit(cache=True, nogil=True)
def _on_treads(
    z: FloatArray,
    cell: IntArray,
    height: Float32Array,
    rests: FloatArray,
    limits: tuple[float, float],
    found: BoolArray,
) -> None:
    (nx, ny), (width, max_step) = height.shape, limits
    sole, stride, here = SOLE / width + 0.5, rings_of(STRIDE, width), -1
    top, around, reach = 0.0, False, int(sole)
    for m in range(len(z)):
        x, y = cell[m] // ny, cell[m] % ny
        own = float(height[x, y])
        if not z[m] <= own + max_step + ROUGH:  # a NaN compares false
            continue
        if cell[m] != here:  # points of one cell follow one another
            here, top, around = cell[m], own, is_tread(height, x, y, stride)
            for u in range(max(x - reach, 0), min(x + reach + 1, nx)):
                for v in range(max(y - reach, 0), min(y + reach + 1, ny)):
                    if (u - x) ** 2 + (v - y) ** 2 <= sole * sole:
                        around = around and height[u, v] >= own - max_step
                        if top < rests[u, v] <= own + max_step:
                            top = rests[u, v]
        found[m] = around and z[m] <= top + ROUGH


@njit(cache=True, nogil=True)
def is_tread(height: Float32Array, x: int, y: int, stride: int) -> bool:
    """Whether a cell is in a flight, with ground higher by more than `ROUGH` within so many cells, and lower."""
    own, (low, high) = float(height[x, y]), ends_around(height, x, y, stride)
    return high - own > ROUGH and own - low > ROUGH and high - low > FLIGHT_RISE


@njit(cache=True, nogil=True)
def ends_around(height: Float32Array, x: int, y: int, rings: int) -> tuple[float, float]:
    """Lowest and highest ground within so many cells, inf and -inf where there is none."""
    (nx, ny), low, high = height.shape, np.float32(np.inf), np.float32(-np.inf)
    for u in range(max(x - rings, 0), min(x + rings + 1, nx)):
        for v in range(max(y - rings, 0), min(y + rings + 1, ny)):
            there = height[u, v]  # a NaN is neither
            low, high = there if there < low else low, there if there > high else high
    return float(low), float(high)


def crosses_flight(path: FloatArray, surface: HeightMap, radius: float) -> bool:
    """Whether a body on a path is over a tread of this ground as `on_treads` means it: on a flight, or a steep ramp.

    Contact points of the `path` [m], (n, 3), count where they lie on this level. A disc of that `radius` [m] holds it.
    """
    stride = rings_of(STRIDE, surface.cell_width)
    return bool(_crosses_flight(path, surface.arrays, surface.ends, 0.5 * radius, stride))


@njit(cache=True, nogil=True)
def _crosses_flight(path: FloatArray, ground: Cells, ends: Float32Array, every: float, stride: int) -> bool:
    """See `crosses_flight`; the path is looked at `every` so many metres, half the radius, and at its end."""
    reach, due, last = int(2.5 * every / ground.width) + 1, 0.0, len(path) - 2
    if not rise_around(path, (reach + stride + 1) * ground.width, ground, ends) > FLIGHT_RISE:
        return False
    for i in range(last + 1):
        dx, dy, dz = path[i + 1, 0] - path[i, 0], path[i + 1, 1] - path[i, 1], path[i + 1, 2] - path[i, 2]
        length = np.hypot(dx, dy)
        while due < length or (i == last and due < length + every):
            t = min(due / length, 1.0) if length > 0.0 else 1.0
            x, y, z = path[i, 0] + t * dx, path[i, 1] + t * dy, path[i, 2] + t * dz
            if _is_by_tread(ground, x, y, z, reach, stride):
                return True
            due += every
        due -= length
    return False


@njit(cache=True, nogil=True)
def _is_by_tread(ground: Cells, x: float, y: float, z: float, reach: int, stride: int) -> bool:
    """Whether a tread is within `reach` cells of a contact, if that is on this ground."""
    height, (i, j) = ground.height, cell_of(ground, x, y)
    if i < 0 or not abs(height[i, j] - z) <= FLIGHT_RISE:
        return False
    low, high = ends_around(height, i, j, reach + stride)
    if not high - low > FLIGHT_RISE:
        return False  # nearly everywhere, and cheaper than to ask each cell
    for u in range(max(i - reach, 0), min(i + reach + 1, height.shape[0])):
        for v in range(max(j - reach, 0), min(j + reach + 1, height.shape[1])):
            if (u - i) ** 2 + (v - j) ** 2 <= reach * reach and is_tread(height, u, v, stride):
                return True
    return False


def footing_reach(surface: HeightMap) -> int:
    """Cells within which the ground decides on what is `bridged`, and on `footholds`."""
    return max(2 * rings_of(STRIDE, surface.cell_width), 5 * rings_of(SOLE, surface.cell_width))


def ridges_reach(surface: HeightMap) -> int:
    """Cells within which the ground decides on `ridges`: a piece is told to be long by that many cells of it."""
    return footing_reach(surface) + rings_of(_LIMITS.tread_depth, surface.cell_width) + 1


@njit(cache=True, nogil=True)
def rings_of(length: float, width: float) -> int:
    """How many cells of that `width` a `length` is, at least one."""
    return max(1, int(length / width))

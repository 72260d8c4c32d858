"""Where the ground itself stops a body: steps, slopes, and the edge of what is known."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

from gpdf_service.config import PerceptionConfig
from gpdf_service.fields.threads import run_chunked
from gpdf_service.ground.foot import HALF_FOOT, SECTORS, STRIDE, sector_of
from gpdf_service.ground.footing import ROUGH, flights
from gpdf_service.tiles.boxes import highest_around, window
from gpdf_service.tiles.surface import UNKNOWN, HeightMap
from gpdf_service.types import BoolArray, ByteArray, Float32Array, FloatArray, IntArray

FOOT = 0.1
"""[m] Half a foot's length, and a wheel's contact: slopes are measured over it, so that a stair's tread stays flat."""
LEAST_STEP = 0.01
"""[m] Below the smallest `max_step` of any body; a lower step stops nobody."""
_LIMITS = PerceptionConfig()
STANDABLE = _LIMITS.standable_slope
"""[rad] What no body here stands on is steeper."""
TALL = 2.0 * _LIMITS.max_step
"""[m] What rises by more within two strides is a flight: a seat with something on it is lower."""


class ObstacleKind(IntEnum):
    """What stops a body at a place."""

    MATERIAL = 0
    STEP = 1
    SLOPE = 2
    UNKNOWN = 3


Measured = tuple[FloatArray, FloatArray]
"""Height of the step [m] and slope of the ground [rad] at each cell, each of shape (nx, ny)."""


@dataclass(frozen=True, slots=True)
class GroundLimits:
    """Places where the ground stops bodies whose limit is below `value`.

    Attributes:
        points: Shape (k, 3) [m].
        kind: Of `ObstacleKind`, shape (k,); MATERIAL is a ridge that no foot rests on.
        value: Height of the step or drop [m], slope [rad], or inf, shape (k,).
    """

    points: FloatArray
    kind: ByteArray
    value: FloatArray


NO_LIMITS = GroundLimits(np.zeros((0, 3)), np.zeros(0, np.uint8), np.zeros(0))


def find_limits(
    surface: HeightMap, material: BoolArray, measured: Measured, ridge: BoolArray, cells: BoolArray
) -> GroundLimits:
    """Limits of a piece of ground in some `cells`; its `material` holds other points, shape (nx, ny) each.

    It is `measured` by `step_and_slope`, its `ridge` by `ridges`.
    """
    box = rows, columns = window(cells, 1)
    cells, height, known = cells[box], surface.height[box].astype(np.float64), surface.state[box] != UNKNOWN
    beside, (step, slope) = highest_around(np.where(known, height, -np.inf), 1), (each[box] for each in measured)
    told = (
        (ObstacleKind.STEP, known & (step > LEAST_STEP), height, step),
        (ObstacleKind.SLOPE, known & (slope > 0.0), height, slope),
        (ObstacleKind.UNKNOWN, ~known & ~material[box] & (beside > -np.inf), beside, np.inf),
        (ObstacleKind.MATERIAL, ridge[box], height, np.inf),
    )
    points, kinds, values = [], [], []
    for kind, where, z, value in told:
        x, y = at = np.nonzero(where & cells)
        plan = surface.origin + (np.column_stack([x + rows.start, y + columns.start]) + 0.5) * surface.cell_width
        points.append(np.column_stack([plan, z[at]]))
        kinds.append(np.full(len(x), kind, np.uint8))
        values.append(np.broadcast_to(value, cells.shape)[at])
    return GroundLimits(*map(np.concatenate, (points, kinds, values)))


def limits_reach(surface: HeightMap) -> int:
    """Cells within which the ground decides on those of a cell: the slope's reach, three medians, and a stride.

    Wide cells ask for flights, two strides further.
    """
    width = surface.cell_width
    return max(1, round(FOOT / width)) + 6 + int((3.0 if _wide(width) else 1.0) * STRIDE / width)


def _wide(width: float) -> bool:
    """Whether a tread may show in one cell of that `width` [m]."""
    return 3.0 * width > _LIMITS.tread_depth


def step_and_slope(surface: HeightMap, asked: BoolArray | None = None) -> Measured:
    """Height of the step [m] and slope of the ground [rad] at each cell, shape (nx, ny); 0 where unknown.

    If only some cells are `asked` about, shape (nx, ny), the others are told nothing of.

    The slope along an axis is the smaller of the rises to either side, over a foot's length or over one cell, whichever
    is flatter: it is flat on a tread, however short, and true on a hillside. The step is the rise across a cell,
    neighbour to neighbour, less what the slope around explains: a scanned step's face lies in one cell, whose own
    height says little. A slanted face is a step, too: see `_slanted`.
    """
    known = surface.state != UNKNOWN
    height = smoothed(surface)
    width = surface.cell_width
    reach = max(1, round(FOOT / width))
    gradient2, short2 = np.zeros_like(height), np.zeros_like(height)
    step = np.zeros_like(height)
    flight = flights(surface, TALL, 2.0 * STRIDE) if _wide(width) else np.zeros_like(known)
    for axis in (0, 1):
        narrow = flight & _is_narrow_tread(surface.height, width, axis) if flight.any() else flight
        rise = np.where(narrow, 0.0, np.fmin(*_rises_beside(height, reach, axis)))  # at the rim, the side that is known
        gradient2 += np.nan_to_num(rise / (reach * width)) ** 2
        short2 += np.where(narrow, 0.0, np.nan_to_num(np.fmin(*_rises_beside(height, 1, axis)) / width)) ** 2
        usual = median_around(np.nan_to_num(rise / (reach * width)), 2, known if asked is None else known & asked)
        across = np.abs(_shift(surface.height, -1, axis) - _shift(surface.height, 1, axis)) - 2.0 * width * usual
        one = np.fmax(*_rises_beside(surface.height, 1, axis)) - width * usual
        step = np.fmax(step, np.nan_to_num(np.fmax(np.where(narrow, 0.0, across), one)))
    flatter = np.minimum(median_around(gradient2, 1, known), median_around(short2, 1, known))
    slope = np.arctan(np.sqrt(flatter))
    rise = _slanted(surface, np.where(known, slope, np.inf))
    slanted = np.isfinite(rise)
    step, slope = np.where(slanted, np.fmax(step, rise), step), np.where(slanted, 0.0, slope)
    return np.where(known, step, 0.0), np.where(known, slope, 0.0)


def _is_narrow_tread(height: Float32Array, width: float, axis: int) -> BoolArray:
    """Cells between two risers of a stair along an axis, with level ground beyond either: a tread that shows in one."""
    beyond, level = [_shift(height, by, axis) for by in (-2, -1, 1, 2)], width * np.tan(STANDABLE)
    up, down = beyond[1] - height, height - beyond[2]
    one_way = (np.minimum(up, down) > level) | (np.maximum(up, down) < -level)  # a NaN compares false
    risers = np.maximum(np.abs(up), np.abs(down)) <= _LIMITS.stair_step + ROUGH
    ends = np.maximum(np.abs(beyond[0] - beyond[1]), np.abs(beyond[2] - beyond[3])) <= level
    found: BoolArray = one_way & risers & ends
    return found


def _slanted(surface: HeightMap, slope: FloatArray) -> FloatArray:
    """Rise of the step whose slanted face each cell is on [m], inf where it is on none, shape (nx, ny).

    It is too steep to stand on, between places for a foot above and below, at most a stride apart: a worn tread.
    """
    level = slope <= STANDABLE
    need = int(np.ceil(HALF_FOOT / surface.cell_width**2 - 1e-6))
    around = ndimage.uniform_filter(level.astype(np.float32), 3, mode="constant") * 9.0
    level &= around >= np.clip(need, 3, 6) - 0.5
    rise = np.full(slope.shape, np.inf)
    asked = np.isfinite(slope) & ~level
    cells = np.flatnonzero(asked)
    if len(cells) and level.any():
        height, reach = surface.height.astype(np.float64), STRIDE / surface.cell_width
        run_chunked(lambda a, b: _rises(height, level, cells[a:b], reach, rise), len(cells))
    return np.where(asked & (slope > STANDABLE), rise, np.inf)


@njit(cache=True, nogil=True)
def _rises(height: FloatArray, level: BoolArray, cells: IntArray, reach: float, rise: FloatArray) -> None:
    """Of the nearest `level` cells above and below in each direction, at most `reach` cells apart: the least rise."""
    nx, ny = height.shape
    rings = int(reach)
    far, there = np.empty((2, SECTORS)), np.empty((2, SECTORS))
    for cell in cells:
        x, y = cell // ny, cell % ny
        far[:] = np.inf
        for u in range(max(x - rings, 0), min(x + rings + 1, nx)):
            for v in range(max(y - rings, 0), min(y + rings + 1, ny)):
                away = float((u - x) ** 2 + (v - y) ** 2)
                if not level[u, v] or not 0.0 < away <= reach**2:
                    continue
                s, side = sector_of(u - x, v - y), int(height[u, v] < height[x, y])
                if away < far[side, s]:
                    far[side, s], there[side, s] = away, height[u, v]
        for s in range(SECTORS):
            for across in range(3 * SECTORS // 8, 5 * SECTORS // 8 + 1):  # the other side, within 45 degrees
                t = (s + across) % SECTORS
                if np.sqrt(far[0, s]) + np.sqrt(far[1, t]) <= reach:
                    rise[x, y] = min(rise[x, y], there[0, s] - there[1, t])


def neighbourhood(surface: HeightMap) -> FloatArray:
    """Heights of each cell and its eight neighbours, shape (9, nx, ny), NaN where unknown."""
    height = surface.height.astype(np.float64)
    return np.stack([_shift(_shift(height, i, 0), j, 1) for i in (-1, 0, 1) for j in (-1, 0, 1)])


def smoothed(surface: HeightMap) -> FloatArray:
    """Heights after a 3 × 3 median over the known cells: takes single outliers, keeps edges."""
    known = surface.state != UNKNOWN
    return median_around(np.where(known, surface.height, np.nan).astype(np.float64), 1, known)


def median_around(values: FloatArray, reach: int, wanted: BoolArray) -> FloatArray:
    """Median of the values, shape (nx, ny), within `reach` cells along each axis of the `wanted` cells; else NaN.

    A NaN counts for nothing; beyond the rim the values are mirrored.
    """
    made, own = np.full(values.shape, np.nan), (values, (reach, _network((2 * reach + 1) ** 2)), wanted)
    run_chunked(lambda a, b: _medians(*own, a, b, made), len(values))
    return made


@lru_cache(maxsize=2)
def _network(count: int) -> IntArray:
    """Pairs of places, shape (k, 2), that put so many values in order, one after another.

    Batcher's odd-even merge sort: 26 pairs for 9 values, 138 for 25.
    """
    pairs = []
    for p in (1 << k for k in range(count.bit_length())):
        for k in (p >> i for i in range(p.bit_length())):
            for j in range(k % p, count - k, 2 * k):
                ends = range(j, j + min(k, count - j - k))
                pairs += [(i, i + k) for i in ends if i // (2 * p) == (i + k) // (2 * p)]
    return np.array(pairs)


_ABREAST = 64
"""Cells of a row whose medians are told at once, in vectors."""


@njit(cache=True, nogil=True)
def _medians(
    values: FloatArray, window: tuple[int, IntArray], wanted: BoolArray, begin: int, end: int, made: FloatArray
) -> None:
    """The medians of some rows, by a window's reach and network: what is unknown comes last in order."""
    (nx, ny), (reach, network) = values.shape, window
    size = (2 * reach + 1) ** 2
    around, known = np.zeros((size, _ABREAST)), np.zeros(_ABREAST, np.int64)
    for x in range(begin, end):
        for first in range(0, ny, _ABREAST):
            count, k = min(_ABREAST, ny - first), 0
            if not wanted[x, first : first + count].any():
                continue
            known[:] = 0
            for i in range(x - reach, x + reach + 1):
                row = values[_mirrored(i, nx)]
                for shift in range(-reach, reach + 1):
                    own, left = around[k], first + shift
                    if 0 <= left <= ny - count:
                        own[:count] = row[left : left + count]
                    else:
                        for j in range(count):
                            own[j] = row[_mirrored(left + j, ny)]
                    for j in range(_ABREAST):
                        known[j] += own[j] == own[j]  # a NaN is not
                        own[j] = own[j] if own[j] == own[j] else np.inf
                    k += 1
            for e in range(len(network)):
                low, high = around[network[e, 0]], around[network[e, 1]]
                for j in range(_ABREAST):
                    one, other = low[j], high[j]
                    low[j] = one if one < other else other
                    high[j] = other if one < other else one
            for j in range(count):
                if wanted[x, first + j] and known[j] > 0:
                    made[x, first + j] = 0.5 * (around[(known[j] - 1) // 2, j] + around[known[j] // 2, j])


@njit(cache=True, nogil=True, inline="always")
def _mirrored(i: int, count: int) -> int:
    """The cell that stands for one beyond the rim."""
    return -1 - i if i < 0 else (2 * count - 1 - i if i >= count else i)


def _rises_beside(values: NDArray[np.floating], by: int, axis: int) -> tuple[FloatArray, FloatArray]:
    """How much they differ from those so many cells ahead and behind along `axis`."""
    return np.abs(_shift(values, -by, axis) - values), np.abs(_shift(values, by, axis) - values)


def _shift(values: NDArray[np.floating], by: int, axis: int) -> FloatArray:
    """Values moved by `by` cells along `axis`; NaN comes in at the rim."""
    moved = np.roll(values, by, axis).astype(np.float64, copy=False)
    moved.swapaxes(0, axis)[slice(by, None) if by < 0 else slice(by)] = np.nan
    return moved

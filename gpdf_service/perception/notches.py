"""What a shadow bites out of a flight of treads, and what of each tread the nose above hides."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gpdf_service.config import PerceptionConfig
from gpdf_service.perception.surface import INFERRED, UNKNOWN, HeightMap
from gpdf_service.types import BoolArray, FloatArray, IntArray

NOTCH_SPAN = 1.0
"""[m] Longest piece of a flight that a shadow bites out: five treads."""
STEEPEST_FLIGHT = 1.3
"""[-] Rise over run of the steepest stair, 52°; what rises more between two pieces of ground is another storey."""
NOTCH_DEPTH = 0.35
"""[m] How far a shadow is filled beside seen treads: less than half of the narrowest stair."""


def fill_notches(
    height: NDArray[np.float32],
    state: NDArray[np.uint8],
    void: BoolArray,
    distance: FloatArray,
    cell_width: float,
    config: PerceptionConfig,
) -> None:
    """Fill what a shadow bites out of a flight: uphill and downhill there is ground, and the tread itself beside.

    The whole back of a tread is hidden by the nose of the next one: such a gap is the lower tread's, where a third
    tread shows that they are a flight. So is a strip of a tread that was seen before and behind it, which is between
    what that nose hides and what lies at a tripod's own foot, where the flight goes on up and down. On the level this
    is left to `_fill`: there the edge of a platform looks the same. A notch in a flight that lies across the grid at an
    angle stays as it was seen.
    """
    open_ = (state == UNKNOWN) & ~void & (distance <= NOTCH_DEPTH)
    filled = _treads(height, open_, np.float32(cell_width), cell_width, config.tread_depth, config.stair_step)
    explained = ~np.isnan(filled)
    height[explained] = filled[explained]
    state[explained] = INFERRED


@njit(cache=True, nogil=True)
def _treads(
    height: NDArray[np.float32],
    open_: BoolArray,
    rounded: np.float32,
    cell_width: float,
    tread_depth: float,
    stair_step: float,
) -> NDArray[np.float32]:
    """Height of the tread of each `open_` cell that lies in a flight, NaN elsewhere.

    `rounded` is the width of a cell as heights are kept.
    """
    (nx, ny), most, least = height.shape, int(NOTCH_SPAN / cell_width) + 1, 2.0 * cell_width
    depth, foot = int(NOTCH_DEPTH / cell_width), int(tread_depth / cell_width)
    filled = np.full((nx, ny), np.float32(np.nan), np.float32)
    for x in range(nx):
        for y in range(ny):
            if not open_[x, y]:
                continue
            for dx, dy in ((1, 0), (0, 1)):
                low, high, steps = _both_sides(height, x, y, dx, dy, most, most)
                run, rise = steps * cell_width, float(high - low)
                strip = _strip(height, x, y, dx, dy, 0.5 * cell_width, least, stair_step, foot, 2 * depth)
                if np.isnan(filled[x, y]) and not np.isnan(strip):
                    (left, a), (right, b) = [_next_known(height, x, y, way * dy, way * dx, most) for way in (-1, 1)]
                    if a > 0 and b > 0 and max(abs(left - strip), abs(right - strip)) <= cell_width:
                        filled[x, y] = strip
                if not (0.0 < run <= NOTCH_SPAN and rise > least):
                    continue
                for way in (-1, 1):
                    tread, beside = _next_known(height, x, y, way * dy, way * dx, depth)
                    between = tread > low + np.float32(0.5) * rounded and tread < high - np.float32(0.5) * rounded
                    explained = beside > 0 and between and rise <= STEEPEST_FLIGHT * run
                    if explained and np.isnan(filled[x, y]):
                        filled[x, y] = tread
                gap = np.isnan(filled[x, y]) and steps <= foot + 1 and rise <= stair_step
                if gap and _goes_on(height, x, y, dx, dy, least, stair_step, foot, 2 * depth):
                    filled[x, y] = low
    return filled


@njit(cache=True, nogil=True)
def _goes_on(
    height: NDArray[np.float32], x: int, y: int, dx: int, dy: int, least: float, most: float, gap: int, span: int
) -> bool:
    """Whether beyond one of the two treads beside (x, y) on a line there is a third, one step further on.

    A step is from `least` to `most` [m] high. No more than `gap` cells in a row are unknown, of a `span` of them.
    """
    for way in (-1, 1):
        here, _ = _next_known(height, x, y, way * dx, way * dy, gap)
        there, _ = _next_known(height, x, y, -way * dx, -way * dy, gap)
        rise = _next_step(height, x, y, way * dx, way * dy, least, gap, span)
        if 0.0 < (rise if here > there else -rise) <= most:
            return True
    return False


@njit(cache=True, nogil=True)
def _strip(
    height: NDArray[np.float32],
    x: int,
    y: int,
    dx: int,
    dy: int,
    same: float,
    least: float,
    most: float,
    gap: int,
    span: int,
) -> np.float32:
    """Height of the tread on both sides of (x, y) on a line, if the next step is up on one and down on the other.

    NaN if not. Heights that differ by `same` at most are one; a step is from `least` to `most` [m] high. No more than
    `gap` cells in a row are unknown, of a `span` of them.
    """
    low, high, steps = _both_sides(height, x, y, dx, dy, gap, gap + 1)
    if steps == 0 or high - low > same:
        return np.float32(np.nan)
    ahead = _next_step(height, x, y, dx, dy, least, gap, span)
    behind = _next_step(height, x, y, -dx, -dy, least, gap, span)
    climbs = ahead * behind < 0.0 and max(abs(ahead), abs(behind)) <= most
    return low if climbs else np.float32(np.nan)


@njit(cache=True, nogil=True)
def _next_step(
    height: NDArray[np.float32], x: int, y: int, dx: int, dy: int, least: float, gap: int, span: int
) -> float:
    """How far up the first step from the next known cell on is [m], on a line from (x, y); 0 where there is none."""
    here, first = _next_known(height, x, y, dx, dy, gap)
    unknown = 0
    for step in range(first, span if first > 0 else 0):
        u, v = x + step * dx, y + step * dy
        if not (0 <= u < height.shape[0] and 0 <= v < height.shape[1]) or unknown > gap:
            break
        if np.isnan(height[u, v]):
            unknown += 1
            continue
        rise, unknown = float(height[u, v] - here), 0
        if abs(rise) > least:
            return rise
    return 0.0


def between_treads(surface: HeightMap, asked: BoolArray, stair_step: float) -> BoolArray:
    """Which of the `asked` cells, shape (nx, ny), have ground at hand on both sides that one flight joins.

    The open side of a flight has none, or that of the floor below. Two treads beside each other differ by `stair_step`
    at most [m].
    """
    found, most = np.zeros_like(asked), int(NOTCH_DEPTH / surface.cell_width)
    _between_treads(surface.height, np.argwhere(asked), most, surface.cell_width, stair_step, found)
    return found


@njit(cache=True, nogil=True)
def _between_treads(
    height: NDArray[np.float32], asked: IntArray, most: int, cell_width: float, stair_step: float, found: BoolArray
) -> None:
    """Mark the `asked` cells, shape (k, 2), between ground within `most` cells each way along a line."""
    for k in range(len(asked)):
        x, y = asked[k]
        for dx, dy in ((1, 0), (0, 1), (1, 1), (1, -1)):
            low, high, steps = _both_sides(height, x, y, dx, dy, most, 2 * most)
            run = steps * cell_width * np.hypot(dx, dy)
            found[x, y] |= steps > 0 and high - low <= max(stair_step, STEEPEST_FLIGHT * run)


@njit(cache=True, nogil=True)
def _both_sides(
    height: NDArray[np.float32], x: int, y: int, dx: int, dy: int, most: int, span: int
) -> tuple[np.float32, np.float32, int]:
    """Heights of the next known cells before and behind (x, y) on a line, the lower first, and the steps between them.

    There are 0 steps where one of the two is more than `most` away, or both more than a `span` apart.
    """
    ahead, on = _next_known(height, x, y, dx, dy, most)
    behind, back = _next_known(height, x, y, -dx, -dy, min(most, span - on)) if on > 0 else (ahead, 0)
    return min(ahead, behind), max(ahead, behind), on + back if back > 0 else 0


@njit(cache=True, nogil=True)
def _next_known(height: NDArray[np.float32], x: int, y: int, dx: int, dy: int, most: int) -> tuple[np.float32, int]:
    """Height of the next known cell from (x, y) on in a direction, and how many cells away; 0 if none within `most`."""
    for step in range(1, most + 1):
        u, v = x + step * dx, y + step * dy
        if not (0 <= u < height.shape[0] and 0 <= v < height.shape[1]):
            break
        if not np.isnan(height[u, v]):
            return height[u, v], step
    return np.float32(np.nan), 0

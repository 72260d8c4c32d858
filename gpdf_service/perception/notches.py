"""What a shadow bites out of a flight of treads, and what of each tread the nose above hides."""

from __future__ import annotations

from typing import NamedTuple

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
OPENING = 0.1
"""[m] Between what is seen of a tread and the next one, at most, where what is below shows: a stair may be as open."""


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
    tread shows that they are a flight. Where it shows what is below, it must be no wider than a stair may be open, and
    the tread go on at both of its ends. So is a strip of a tread that was seen before and behind it, which is between
    what that nose hides and what lies at a tripod's own foot, where the flight goes on up and down. On the level this
    is left to `_fill`: there the edge of a platform looks the same. A notch in a flight that lies across the grid at an
    angle stays as it was seen.
    """
    open_ = (state == UNKNOWN) & (distance <= NOTCH_DEPTH)
    gap, span = int(config.tread_depth / cell_width), 2 * int(NOTCH_DEPTH / cell_width)
    filled = _treads(height, open_, void, cell_width, _Flight(2.0 * cell_width, config.stair_step, gap, span))
    explained = ~np.isnan(filled)
    height[explained] = filled[explained]
    state[explained] = INFERRED


class _Flight(NamedTuple):
    """What a flight is, on a line of cells.

    Attributes:
        least: Lowest step from tread to tread [m].
        most: Highest [m].
        gap: Most cells in a row of a tread that are unknown.
        span: Cells within which the next step comes.
    """

    least: float
    most: float
    gap: int
    span: int


@njit(cache=True, nogil=True)
def _treads(
    height: NDArray[np.float32], open_: BoolArray, void: BoolArray, cell_width: float, flight: _Flight
) -> NDArray[np.float32]:
    """Height of the tread of each `open_` cell that lies in a flight, NaN elsewhere."""
    (nx, ny), most, depth = height.shape, int(NOTCH_SPAN / cell_width) + 1, int(NOTCH_DEPTH / cell_width)
    filled, half = np.full((nx, ny), np.float32(np.nan), np.float32), np.float32(0.5) * np.float32(cell_width)
    for x in range(nx):
        for y in range(ny):
            for dx, dy in ((1, 0), (0, 1)):
                if not (open_[x, y] and np.isnan(filled[x, y])):
                    break
                ahead, on, behind, back = _both_sides(height, x, y, dx, dy, most, most)
                steps = on + back
                if steps == 0:
                    continue
                low, high = min(ahead, behind), max(ahead, behind)
                run, rise = steps * cell_width, float(high - low)
                narrow = run <= OPENING if void[x, y] else steps <= flight.gap + 1
                if narrow and (void[x, y] or rise <= 0.5 * cell_width):
                    left, _, right, off = _both_sides(height, x, y, dy, dx, most, 2 * most)
                    across = off > 0 and bool(max(abs(left - low), abs(right - low)) <= cell_width)
                    if across and not void[x, y] and _climbs(height, x, y, dx, dy, on, back, flight):
                        filled[x, y] = low
                    narrow = across or not void[x, y]
                if run > NOTCH_SPAN or rise <= flight.least:
                    continue
                for way in (-1, 1):
                    tread, beside = _next_known(height, x, y, way * dy, way * dx, depth)
                    between = beside > 0 and tread > low + half and tread < high - half and not void[x, y]
                    if between and rise <= STEEPEST_FLIGHT * run and np.isnan(filled[x, y]):
                        filled[x, y] = tread
                gap = narrow and rise <= flight.most and np.isnan(filled[x, y])
                if gap and _goes_on(height, x, y, dx, dy, on, back, flight):
                    filled[x, y] = low
    return filled


@njit(cache=True, nogil=True)
def _goes_on(
    height: NDArray[np.float32], x: int, y: int, dx: int, dy: int, on: int, back: int, flight: _Flight
) -> bool:
    """Whether beyond one of the two treads on a line, `on` cells before (x, y) and `back` behind it, there is a third.

    That is one step further on.
    """
    up = 1.0 if height[x + on * dx, y + on * dy] > height[x - back * dx, y - back * dy] else -1.0
    ahead = _next_step(height, x, y, dx, dy, on, flight)
    behind = _next_step(height, x, y, -dx, -dy, back, flight)
    return 0.0 < up * ahead <= flight.most or 0.0 < -up * behind <= flight.most


@njit(cache=True, nogil=True)
def _climbs(height: NDArray[np.float32], x: int, y: int, dx: int, dy: int, on: int, back: int, flight: _Flight) -> bool:
    """Whether from a tread, known `on` cells before (x, y) and `back` behind it, a step is up on one side, one down."""
    ahead = _next_step(height, x, y, dx, dy, on, flight)
    behind = _next_step(height, x, y, -dx, -dy, back, flight)
    return ahead * behind < 0.0 and max(abs(ahead), abs(behind)) <= flight.most


@njit(cache=True, nogil=True)
def _next_step(height: NDArray[np.float32], x: int, y: int, dx: int, dy: int, first: int, flight: _Flight) -> float:
    """How far up the next step is from the cell `first` cells from (x, y) on a line [m]; 0 where there is none."""
    here, unknown = height[x + first * dx, y + first * dy], 0
    for step in range(first, flight.span):
        u, v = x + step * dx, y + step * dy
        if not (0 <= u < height.shape[0] and 0 <= v < height.shape[1]) or unknown > flight.gap:
            break
        if np.isnan(height[u, v]):
            unknown += 1
            continue
        rise, unknown = float(height[u, v] - here), 0
        if abs(rise) > flight.least:
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
            ahead, on, behind, back = _both_sides(height, x, y, dx, dy, most, 2 * most)
            run = (on + back) * cell_width * np.hypot(dx, dy)
            found[x, y] |= run > 0.0 and abs(ahead - behind) <= max(stair_step, STEEPEST_FLIGHT * run)


@njit(cache=True, nogil=True)
def _both_sides(
    height: NDArray[np.float32], x: int, y: int, dx: int, dy: int, most: int, span: int
) -> tuple[np.float32, int, np.float32, int]:
    """Heights of the next known cells before and behind (x, y) on a line, and how many cells away each is.

    They are 0 away where one of the two is more than `most` away, or both more than a `span` apart.
    """
    ahead, on = _next_known(height, x, y, dx, dy, most)
    behind, back = _next_known(height, x, y, -dx, -dy, min(most, span - on)) if on > 0 else (ahead, 0)
    return ahead, on if back > 0 else 0, behind, back


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

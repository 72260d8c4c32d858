"""What a scan missed of the treads of a flight: no wider than a foot bridges."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numba import njit
from scipy import ndimage

from gpdf_service.config import PerceptionConfig
from gpdf_service.ground.foot import SOLE, STRIDE
from gpdf_service.ground.footing import ROUGH
from gpdf_service.kernel_cache import lean
from gpdf_service.tiles.boxes import highest_around, window
from gpdf_service.tiles.layers import HALF
from gpdf_service.tiles.nearest import nearest_of
from gpdf_service.tiles.surface import INFERRED, UNKNOWN, HeightMap
from gpdf_service.types import BoolArray, Float32Array, FloatArray, IntArray

STEEPEST_FLIGHT = 1.3
"""[-] Rise over run of the steepest stair, 52°; what rises more between two pieces of ground is another storey."""
NOTCH_DEPTH = 0.35
"""[m] How far a shadow is filled beside seen treads: less than half of the narrowest stair."""
NOTCH_SPAN = 1.0
"""[m] Longest piece of a flight that a shadow bites out: five treads."""
FLIGHT = 2.0 * STRIDE
"""[m] From a flight's treads, within which a scan's notches are the flight's: two strides make a landing."""
BENEATH_SHARE = 0.5
"""[-] Of a flight's seen treads: where under more of them the room below was seen, it was seen from its side."""

Cell = tuple[int, int]
Way = tuple[float, float]
"""A direction along both axes of a grid [cells]."""
Told = tuple[BoolArray, BoolArray]
"""Cells in which something stands, and those under which something was seen, each of shape (nx, ny)."""


def fill_bites(surface: HeightMap, asked: BoolArray, beneath: BoolArray, stands: BoolArray) -> Float32Array:
    """Heights of the ground with what shadows bite out of a flight, in those of its cells that are `asked` [m].

    Args:
        surface: The ground.
        asked: Which cells of flights, shape (nx, ny).
        beneath: Cells under which something was seen, deeper than a step, shape (nx, ny).
        stands: Cells in which something lies over the nearest ground, shape (nx, ny).
    """
    made, box = surface.height.copy(), window(asked, bites_reach(surface))
    own, told = made[box].copy(), (np.ascontiguousarray(stands[box]), np.ascontiguousarray(beneath[box]))
    _fill_bitten(own, asked[box], told, surface.cell_width)
    made[box] = own
    return made


def bites_reach(surface: HeightMap) -> int:
    """Cells within which the ground decides on a bite."""
    return int((NOTCH_SPAN + NOTCH_DEPTH) / surface.cell_width) + 2


def fill_notches(
    surface: HeightMap, bitten: Float32Array, flight: BoolArray, beneath: BoolArray, config: PerceptionConfig
) -> HeightMap:
    """Fill what is unknown of a flight and no wider than a foot bridges, `widest_gap`: closing by a disc that wide.

    A nose hides the back of the tread below, and a scan from far shows strips. Such a place is of the tread around it,
    or, where one tread is on one side and the next on the other, of the lower one. On the level nothing is filled: a
    slot in a floor, or between a platform and a train, looks the same. So does a slot in a flight through which the
    room beneath was seen; unless that is seen beneath the treads beside it, too, or the slot is narrower than a sole
    and at a riser: an open one shows the room beneath. A tread that is closed up to the next one is seen as wide as a
    sole: of those that are seen from below the noses are, and nobody has seen more.

    Cells are told, shape (nx, ny) each, of a `flight` and its landings, and those `beneath` which something was seen
    deeper than a step; `bitten` are the heights with `fill_bites` [m].
    """
    width = surface.cell_width
    box = window(flight, notches_reach(surface, config))  # nothing else is filled, or tells what is
    height, state = surface.height.copy(), surface.state.copy()
    own, known, flight = bitten[box].copy(), surface.state[box] != UNKNOWN, flight[box]
    below, radius = beneath[box], 0.5 * config.widest_gap / width
    away = nearest_of(~np.isnan(own))[0]
    closed, narrow = (nearest_of(away > half)[0] > half for half in (radius, 0.5 * SOLE / width))
    asked, sole = closed & np.isnan(own) & flight, int(SOLE / width)
    at_risers = _between(own, asked, (sole, sole + 1, width), (ROUGH, np.inf))
    asked &= ~below | (narrow & at_risers) | _from_the_side(known & flight, below, width)
    cells, discs = np.ascontiguousarray(np.argwhere(asked)), (_disc(2.0 * radius), _disc(radius))
    rise = np.where(_as_wide_as_a_sole(~np.isnan(own), width), config.stair_step, 0.0)
    touching = highest_around(np.where(np.isnan(own), np.float32(-np.inf), own), 1)[asked].astype(np.float64)
    own[asked] = _treads(own, rise, cells, discs, touching - config.stair_step, 0.5 * width)
    height[box], state[box][known != ~np.isnan(own)] = own, INFERRED
    return replace(surface, height=height, state=state)


def notches_reach(surface: HeightMap, config: PerceptionConfig) -> int:
    """Cells within which ground and flights decide on a notch: soles, and discs on these; or treads seen beneath."""
    near = sum(int(length / surface.cell_width) + 2 for length in (3.0 * SOLE, 1.5 * config.widest_gap))
    return max(near, int(FLIGHT / surface.cell_width) + 1)


def _disc(radius: float) -> IntArray:
    """Cells within a `radius` [cells] of one, nearest first, shape (d, 2)."""
    offset = np.mgrid[-int(radius) : int(radius) + 1, -int(radius) : int(radius) + 1].reshape(2, -1).T
    away = np.hypot(*offset.T)
    cells: IntArray = offset[np.argsort(away, kind="stable")][: np.count_nonzero(away <= radius)]
    return cells


def _as_wide_as_a_sole(known: BoolArray, cell_width: float) -> BoolArray:
    """Cells of `known` ground, shape (nx, ny), that is as long and as wide as a `SOLE`, but for narrower gaps."""
    sole = np.ones(2 * [2 * round(0.5 * SOLE / cell_width) + 1], dtype=bool)
    wide: BoolArray = known & ndimage.binary_opening(ndimage.binary_closing(known, sole), sole)
    return wide


def _from_the_side(treads: BoolArray, below: BoolArray, cell_width: float) -> BoolArray:
    """Cells around which something was seen beneath most of the `treads`, shape (nx, ny): sums that do not round."""
    excess, ones = treads * (below - BENEATH_SHARE), np.ones(2 * int(FLIGHT / cell_width) + 1)
    for axis in (0, 1):
        excess = ndimage.convolve1d(excess, ones, axis, mode="constant")
    side: BoolArray = excess > 0.0
    return side


@njit(cache=True, nogil=True)
def _treads(
    height: Float32Array,
    rise: FloatArray,
    cells: IntArray,
    discs: tuple[IntArray, IntArray],
    lowest: FloatArray,
    same: float,
) -> Float32Array:
    """Height of the tread of each of the `cells`, (k, 2), NaN where none closes over it: the nearest, then the lowest.

    Every one of the lesser `discs` that holds the cell holds a known one as high, or up to its `rise` [m] higher, and
    it is no lower than the `lowest` [m], (k,). Heights of one tread differ by what is the `same` [m] at most.
    """
    (nx, ny), made, (near, disc) = height.shape, np.full(len(cells), np.float32(np.nan), np.float32), discs
    for k in range(len(cells)):
        (x, y), found = cells[k], 0
        for one in range(len(near)):
            dx, dy = near[one]
            if 0 < found < dx * dx + dy * dy:
                break
            u, v = x + dx, y + dy
            if not (0 <= u < nx and 0 <= v < ny) or not lowest[k] - same <= height[u, v] or height[u, v] >= made[k]:
                continue
            if _closes(height, x, y, disc, height[u, v] - same, height[u, v] + same + rise[u, v]):
                made[k], found = height[u, v], dx * dx + dy * dy
    return made


@njit(cache=True, nogil=True)
def _closes(height: Float32Array, x: int, y: int, disc: IntArray, low: float, high: float) -> bool:
    """Whether every disc that holds the cell (x, y) holds a cell between these heights."""
    nx, ny = height.shape
    for a in range(len(disc)):
        empty = True
        for b in range(len(disc)):
            u, v = x + disc[a, 0] + disc[b, 0], y + disc[a, 1] + disc[b, 1]
            if 0 <= u < nx and 0 <= v < ny and low <= height[u, v] <= high:
                empty = False
                break
        if empty:
            return False
    return True


@njit(cache=True, nogil=True)
def _fill_bitten(height: Float32Array, asked: BoolArray, told: Told, cell_width: float) -> None:
    """Fill what a shadow bites out of a flight, with the tread beside that was seen furthest; nothing where a thing is.

    Uphill may be any way; ways are half a cell apart where the longest bite ends.
    """
    most, half, seen = int(NOTCH_SPAN / cell_width) + 1, np.float32(0.5 * cell_width), height.copy()
    turn = np.pi * np.arange(0.0, 2.0, 0.5 / np.ceil(np.pi * most))
    ways, depth, sole = np.column_stack((np.cos(turn), np.sin(turn))), int(NOTCH_DEPTH / cell_width), SOLE / cell_width
    for x in range(height.shape[0]):
        for y in range(height.shape[1]):
            if not (asked[x, y] and np.isnan(height[x, y])) or told[0][x, y]:
                continue
            longest = 0
            for k in range(len(ways)):
                across = ways[k, 0], ways[k, 1]
                tread, beside = _next_on(seen, (x, y), across, depth)
                straight = max(1, round(sole), beside)
                long = _as_high(seen, (x, y), across, (beside, most), half) if beside > 0 else 0
                row = beside, straight
                if long > max(longest, straight) and _is_bitten(seen, told, (x, y), across, row, cell_width):
                    height[x, y], longest = tread, long


@lean()
def _as_high(height: Float32Array, at: Cell, by: Way, cells: tuple[int, int], half: np.float32) -> int:
    """Length of a row of cells as high as its first one, within `half` [m]: from so many `cells` on to so many."""
    (first, most), tread = cells, _on(height, at, by, cells[0])
    last = first
    while last < most and abs(_on(height, at, by, last) - tread) <= half:
        last += 1
    return last - first


@lean()
def _is_bitten(
    height: Float32Array, told: Told, at: Cell, across: Way, row: tuple[int, int], cell_width: float
) -> bool:
    """Whether a cell is between higher and lower ground, on the tread of a `row` of cells beside it.

    The row begins so many cells across, and is so many long: as wide as a sole, and as long as what is inferred. At its
    ends the flight is as high as at the cell. Nothing stands between the cell and the row. Beyond the cell something
    does, or ground is no lower: an open side has no treads. Nor has what shows the room beneath where the row does not.
    """
    (stands, below), (beside, straight) = told, row
    most, half = int(NOTCH_SPAN / cell_width) + 1, np.float32(0.5 * cell_width)
    away, along, back = (-across[0], -across[1]), (-across[1], across[0]), (across[1], -across[0])
    (one, on), (other, off) = _next_on(height, at, along, most), _next_on(height, at, back, most)
    run, low, high, tread = (on + off) * cell_width, min(one, other), max(one, other), _on(height, at, across, beside)
    if min(on, off) == 0 or run > NOTCH_SPAN or not 2.0 * cell_width < high - low <= STEEPEST_FLIGHT * run:
        return False
    if not low + half < tread < high - half or _count_on(stands, at, across, 1, beside) > 0:
        return False
    if below[at] and _count_on(below, at, across, beside, beside + straight) < straight:
        return False
    beyond, far = _next_on(height, at, away, most)
    closed = _count_on(stands, at, away, 1, far if far > 0 else most) > 0
    if not closed and not (far > 0 and beyond >= tread - half):
        return False
    goes_on = True
    for there in (_further(at, across, beside), _further(at, across, beside + straight)):
        goes_on = goes_on and _ends_alike(height, there, along, on, one, half)
        goes_on = goes_on and _ends_alike(height, there, back, off, other, half)
    return goes_on


@lean()
def _ends_alike(height: Float32Array, at: Cell, along: Way, cells: int, end: np.float32, most: np.float32) -> bool:
    """Whether ground so many cells on, or one more or less, is as high as an `end`, within `most` [m]."""
    alike = False
    for k in range(cells - 1, cells + 2):
        alike = alike or bool(abs(_on(height, at, along, k) - end) <= most)
    return alike


@lean()
def _further(at: Cell, by: Way, cells: int) -> Cell:
    """The cell that is so many cells on in a direction, wherever the grid begins."""
    return at[0] + int(np.round(cells * by[0])), at[1] + int(np.round(cells * by[1]))


@lean()
def _on(height: Float32Array, at: Cell, by: Way, cells: int) -> np.float32:
    """Height so many cells from a place on in a direction [m], NaN where none is known."""
    u, v = _further(at, by, cells)
    inside = 0 <= u < height.shape[0] and 0 <= v < height.shape[1]
    return height[u, v] if inside else np.float32(np.nan)


@lean()
def _next_on(height: Float32Array, at: Cell, by: Way, most: int) -> tuple[np.float32, int]:
    """Height of the next known cell on a line [m], and how many cells away; 0 if there is none within `most`."""
    for cells in range(1, most + 1):
        found = _on(height, at, by, cells)
        if not np.isnan(found):
            return found, cells
    return np.float32(np.nan), 0


@lean()
def _count_on(cells: BoolArray, at: Cell, by: Way, begin: int, end: int) -> int:
    """How many of the cells that are so many on, from `begin` to before `end`, are among the `cells`."""
    count = 0
    for k in range(begin, end):
        u, v = _further(at, by, k)
        count += 0 <= u < cells.shape[0] and 0 <= v < cells.shape[1] and cells[u, v]
    return count


def between_treads(surface: HeightMap, asked: BoolArray, stair_step: float) -> BoolArray:
    """Which of the `asked` cells, shape (nx, ny), have ground at hand on both sides that one flight joins.

    The open side of a flight has none, or that of the floor below. Two treads beside each other differ by `stair_step`
    at most [m].
    """
    most = int(NOTCH_DEPTH / surface.cell_width)
    return _between(surface.height, asked, (most, 2 * most, surface.cell_width), (-1.0, stair_step))


@njit(cache=True, nogil=True)
def _between(
    height: Float32Array, asked: BoolArray, lengths: tuple[int, int, float], rises: tuple[float, float]
) -> BoolArray:
    """Which of the `asked` cells, shape (nx, ny), have ground on both sides that differs by more than the first rise.

    And by no more than the second, or than a flight rises between. Each is within the first of the `lengths`, both
    within the second from each other [cells]; the third is a cell's width.
    """
    found, (most, span, cell_width), (least, step) = np.zeros_like(asked), lengths, rises
    for x in range(height.shape[0]):
        for y in range(height.shape[1]):
            for dx, dy in HALF:
                if not asked[x, y]:
                    break
                ahead, on = _next_on(height, (x, y), (float(dx), float(dy)), most)
                behind, back = _next_on(height, (x, y), (float(-dx), float(-dy)), min(most, span - on))
                run, off = (on + back) * cell_width * np.hypot(dx, dy), abs(ahead - behind)
                found[x, y] |= on > 0 and back > 0 and least < off <= max(step, STEEPEST_FLIGHT * run)
    return found

"""A single-valued piece of ground as a height map, with the holes filled that its surroundings explain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

from gpdf_service.perception.columns import by_cell
from gpdf_service.types import BoolArray, FloatArray, IntArray

UNKNOWN, OBSERVED, INFERRED = 0, 1, 2
GAP_CELLS = 4
"""Empty cells side by side that chance alone explains, at one in ten empty."""
RING_SHARE = 0.95
"""[-] Of the ground around a hole that must not lie under the plane that fills it: the rest is a scan's noise."""
PLANE_SHARE = 0.5
"""[-] Of the ground around a hole that must lie on that plane; the rest, higher, is a chair's feet or a step up."""
OPEN_SHARE = 0.5
"""[-] Of the rim of a hole under the open that must be ground: what furniture and walls close off can hold anything."""
SHUT_SHARE = 0.2
"""[-] The same of a hole under a thing, where only a low body fits: a desk stands along a wall or in a corner."""
NOTCH_SPAN = 1.0
"""[m] Longest piece of a flight that a shadow bites out: five treads."""
STEEPEST_FLIGHT = 1.3
"""[-] Rise over run of the steepest stair, 52°; what rises more between two pieces of ground is another storey."""
NOTCH_DEPTH = 0.35
"""[m] How far a shadow is filled beside seen treads: less than half of the narrowest stair."""
SLAB = 1.0
"""[m] Thickest floor: what is seen deeper than this under a hole was seen through it."""
STOREY = 1.5
"""[m] Least room under a floor: what is seen nearer below a hole with less than this under itself is a pit's bottom."""
WALL_CELLS = 3.0
"""[cells] The wall of a pit is seen within these under its rim; the underside of a floor is deeper."""
CEILING = 1.9
"""[m] What is higher over the ground beside is a ceiling or a lamp, no furniture whose shadow is the hole."""
_ROUNDING = float(np.finfo(np.float64).eps)
MAX_HOLE_RADIUS = 1.0
"""[m] A hole is filled if no place in it is further from seen ground: a scanner's blind spot, the shadow of a desk."""


@dataclass(frozen=True, slots=True)
class HeightMap:
    """Ground height on a grid.

    Attributes:
        origin: Lower corner of the grid [m], shape (2,).
        cell_width: [m].
        height: At the cells' centres [m], NaN where unknown, shape (nx, ny).
        state: UNKNOWN, OBSERVED or INFERRED, shape (nx, ny).
    """

    origin: FloatArray
    cell_width: float
    height: NDArray[np.float32]
    state: NDArray[np.uint8]

    def cells(self, xy: FloatArray) -> tuple[NDArray[np.int64], NDArray[np.int64], BoolArray]:
        """Cell of each place, shape (m, ≥ 2), clipped to the grid, and whether it was inside."""
        nx, ny = self.height.shape
        found: tuple[NDArray[np.int64], NDArray[np.int64], BoolArray] = _cells(
            np.asarray(xy, dtype=np.float64), np.asarray(self.origin, dtype=np.float64), self.cell_width, nx, ny
        )
        return found

    def contains(self, queries: FloatArray) -> BoolArray:
        """Whether the ground is known under each place, shape (m, 2 or 3)."""
        ix, iy, inside = self.cells(queries)
        known: BoolArray = inside & (self.state[ix, iy] != UNKNOWN)
        return known

    def height_at(self, xy: FloatArray) -> FloatArray:
        """Height of the ground [m], shape (m,), NaN where unknown.

        Bilinear between the four centres around a place where they lie on one slope; across a step, the cell's own.
        """
        heights: FloatArray = _height_at(
            self.height, np.asarray(self.origin, dtype=np.float64), self.cell_width, np.asarray(xy, dtype=np.float64)
        )
        return heights

    def centres(self, mask: BoolArray) -> FloatArray:
        """Centres of the cells in `mask`, shape (nx, ny), with their height: (k, 3) [m]."""
        index = np.argwhere(mask)
        return np.column_stack([self.origin + (index + 0.5) * self.cell_width, self.height[mask].astype(np.float64)])


@njit(cache=True, nogil=True)
def _cells(
    xy: FloatArray, origin: FloatArray, width: float, nx: int, ny: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], BoolArray]:
    ix, iy, inside = np.zeros(len(xy), np.int64), np.zeros(len(xy), np.int64), np.zeros(len(xy), np.bool_)
    for m in range(len(xy)):
        x, y = np.floor((xy[m, 0] - origin[0]) / width), np.floor((xy[m, 1] - origin[1]) / width)
        inside[m] = 0.0 <= x < nx and 0.0 <= y < ny
        if x > 0.0:  # what is no number stays in the first cell
            ix[m] = int(min(x, nx - 1.0))
        if y > 0.0:
            iy[m] = int(min(y, ny - 1.0))
    return ix, iy, inside


@njit(cache=True, nogil=True)
def _height_at(height: NDArray[np.float32], origin: FloatArray, width: float, xy: FloatArray) -> FloatArray:
    made = np.full(len(xy), np.nan)
    corners = np.empty(4)
    for m in range(len(xy)):
        x, y = (xy[m, 0] - origin[0]) / width, (xy[m, 1] - origin[1]) / width
        if not (0.0 <= x < height.shape[0] and 0.0 <= y < height.shape[1]):
            continue
        made[m] = height[int(x), int(y)]
        i, j = max(0, min(int(x - 0.5), height.shape[0] - 2)), max(0, min(int(y - 0.5), height.shape[1] - 2))
        corners[0], corners[1] = height[i, j], height[i, j + 1]
        corners[2], corners[3] = height[i + 1, j], height[i + 1, j + 1]
        if not np.isnan(made[m]) and corners.max() - corners.min() <= width * np.sqrt(2.0):  # a NaN compares false
            u, v = max(0.0, min(x - 0.5 - i, 1.0)), max(0.0, min(y - 0.5 - j, 1.0))
            made[m] = (1.0 - u) * ((1.0 - v) * corners[0] + v * corners[1])
            made[m] += u * ((1.0 - v) * corners[2] + v * corners[3])
    return made


def fill_holes(
    surface: HeightMap, lowest: FloatArray, seen_through: BoolArray, pit: BoolArray, walls: BoolArray
) -> HeightMap:
    """Infer ground where its surroundings explain it, and mark it.

    A hole is a connected set of unknown cells bounded by known ground and things (cells whose `lowest` other point is
    under a ceiling's height, inf where there is none), shut off from the map's rim, with no place further than
    `MAX_HOLE_RADIUS` from seen ground, and with the ground around it on one plane within a cell's slope or higher: an
    edge that drops is not bridged. Nor is what was `seen_through`, a `pit`, or a hole with `walls` going down from its
    rim, see `find_voids`. Under a thing it is filled only where ground was seen beneath its rim. A notch in a flight is
    filled with the treads beside it.
    """
    known = surface.state == OBSERVED
    height, state = surface.height.copy(), surface.state.copy()
    cells, nearest = ndimage.distance_transform_edt(~known, return_indices=True)
    distance = cells * surface.cell_width
    material = lowest < surface.height[nearest[0], nearest[1]] + CEILING
    _fill_gaps(height, state, ~known, distance, nearest, surface.cell_width)
    _fill_notches(height, state, seen_through, distance, surface.cell_width)
    known = state != UNKNOWN
    void = seen_through | pit | _walled_down(surface, walls)
    _fill(height, state, ~known & ~material, known, distance, surface.cell_width, void, OPEN_SHARE)
    solid = state != UNKNOWN  # then the ground that carries the furniture itself
    under = ~solid & (distance <= MAX_HOLE_RADIUS) & material & _seen_hollow(~solid & material, known & material)
    _fill(height, state, under, solid, distance, surface.cell_width, void, SHUT_SHARE)
    _fill_gaps(height, state, state == UNKNOWN, distance, nearest, surface.cell_width)  # what is left of larger ones
    return HeightMap(surface.origin, surface.cell_width, height, state)


def _seen_hollow(things: BoolArray, overhung: BoolArray) -> BoolArray:
    """Cells of things in whose neighbourhood ground was seen beneath material, further in than the edge of a cell.

    A table shows the floor under its rim, and single cells are no mass. What was seen from above alone, as a rock on a
    height map, may be solid.
    """
    label, count = ndimage.label(things, np.ones((3, 3)))
    inner = ndimage.binary_erosion(overhung | things, np.ones((3, 3))) & overhung
    near = ndimage.binary_dilation(inner, np.ones((3, 3)), iterations=2)
    hollow = np.ones(count + 1, dtype=bool)
    hollow[label[ndimage.binary_opening(things, np.ones((3, 3)))]] = False
    hollow[label[near & things]] = True
    hollow[0] = False
    result: BoolArray = hollow[label]
    return result


def find_voids(surface: HeightMap, points: FloatArray, max_step: float) -> tuple[BoolArray, BoolArray, BoolArray]:
    """Unknown cells whose highest point of `points` (n, 3) lies over `max_step` under the ground beside them.

    Returns:
        Where the scanner saw through, further down than a floor is thick; where the bottom of a pit is seen, which is
        no ceiling because no storey is under it; and where the upper end of a pit's walls is. All (nx, ny).
    """
    unknown = surface.state == UNKNOWN
    cells, nearest = ndimage.distance_transform_edt(unknown, return_indices=True)
    asked = unknown & (cells * surface.cell_width <= MAX_HOLE_RADIUS)
    ix, iy, inside = surface.cells(points)
    walls = _walls_down(surface, ix[inside], iy[inside], points[inside, 2])
    kept = inside & asked[ix, iy]
    ix, iy, z = ix[kept], iy[kept], points[kept, 2]
    beside = surface.height[nearest[0], nearest[1]]
    under = z < beside[ix, iy] + surface.cell_width
    top, bottom = np.full(unknown.shape, -np.inf), np.full(unknown.shape, np.inf)
    np.maximum.at(top, (ix[under], iy[under]), z[under])
    np.minimum.at(bottom, (ix[under], iy[under]), z[under])
    seen = np.isfinite(top)
    depth = np.where(seen, beside - top, 0.0)
    pit = (depth > max_step) & (depth <= SLAB) & (np.where(seen, top - bottom, 0.0) < STOREY)
    return depth > SLAB, pit, walls


def _walls_down(surface: HeightMap, ix: IntArray, iy: IntArray, z: FloatArray) -> BoolArray:
    """Cells of a hole or beside one with a point at (ix, iy, z), each (n,), right under the ground: no floor.

    A step up at the rim is none: the lowest ground within two cells counts. But a rim's cell that holds the wall's
    upper end, too, lies as deep as that: of each cell and those around it the highest ground counts.
    """
    unknown = surface.state == UNKNOWN
    rim = ndimage.maximum_filter(np.where(unknown, -np.inf, surface.height), size=3)
    floor = ndimage.minimum_filter(np.where(unknown, np.inf, rim), size=5)
    depth = floor[ix, iy] - z
    wall = (depth > surface.cell_width) & (depth <= WALL_CELLS * surface.cell_width)
    walls = np.zeros(unknown.shape, dtype=bool)
    walls[ix[wall], iy[wall]] = True
    walls &= ndimage.binary_dilation(unknown, np.ones((3, 3)))
    return walls


def _walled_down(surface: HeightMap, walls: BoolArray) -> BoolArray:
    """Holes with `walls` under more of their rim than a scan's noise explains."""
    unknown = surface.state == UNKNOWN
    label, count = ndimage.label(unknown)
    hole = ndimage.maximum_filter(label, size=3)
    rim = np.bincount(hole[~unknown], minlength=count + 1)
    pit = np.bincount(hole[walls], minlength=count + 1) > (1.0 - RING_SHARE) * rim
    result: BoolArray = pit[label] & unknown
    return result


def _fill_gaps(
    height: NDArray[np.float32],
    state: NDArray[np.uint8],
    holes: BoolArray,
    distance: FloatArray,
    nearest: NDArray[np.int32],
    cell_width: float,
) -> None:
    """Fill single cells that the scan's spacing left empty, with the ground beside them: also at a step's edge."""
    label, count = ndimage.label(holes)
    size, wide = (np.bincount(label[cells], minlength=count + 1) for cells in (holes, holes & (distance > cell_width)))
    small = holes & ((size <= GAP_CELLS) & (wide == 0))[label]
    height[small] = height[nearest[0][small], nearest[1][small]]
    state[small] = INFERRED


def _fill_notches(
    height: NDArray[np.float32], state: NDArray[np.uint8], void: BoolArray, distance: FloatArray, cell_width: float
) -> None:
    """Fill what a shadow bites out of a flight: uphill and downhill there is ground, and the tread itself beside.

    On the level this is left to `_fill`: there the edge of a platform looks the same. A flight that lies across the
    grid at an angle stays as it was seen.
    """
    open_ = (state == UNKNOWN) & ~void & (distance <= NOTCH_DEPTH)
    filled = np.full(height.shape, np.nan, np.float32)
    for axis in (0, 1):
        ahead, behind, gap = _known_beside(height, axis)
        low, high, run = np.fmin(ahead, behind), np.fmax(ahead, behind), gap * cell_width
        flight = open_ & (run <= NOTCH_SPAN) & (high - low > 2.0 * cell_width) & (high - low <= STEEPEST_FLIGHT * run)
        for tread in _known_beside(height, 1 - axis, NOTCH_DEPTH / cell_width)[:2]:
            between = (tread > low + 0.5 * cell_width) & (tread < high - 0.5 * cell_width)
            filled = np.where(flight & between & np.isnan(filled), tread, filled)
    explained = ~np.isnan(filled)
    height[explained] = filled[explained]
    state[explained] = INFERRED


def _known_beside(
    height: NDArray[np.float32], axis: int, reach: float = np.inf
) -> tuple[NDArray[np.float32], NDArray[np.float32], FloatArray]:
    """Heights of the nearest known cells before and after each cell along `axis`, and the cells between the two.

    NaN where there is none within `reach` cells.
    """
    before, back = _last_known(height, axis)
    after, on = (np.flip(part, axis) for part in _last_known(np.flip(height, axis), axis))
    nan = np.float32(np.nan)
    return np.where(back <= reach, before, nan), np.where(on <= reach, after, nan), back + on


def _last_known(height: NDArray[np.float32], axis: int) -> tuple[NDArray[np.float32], FloatArray]:
    """Height of the last known cell before each cell along `axis`, NaN if none, and how many cells back it is."""
    along = np.arange(height.shape[axis]).reshape((-1, 1) if axis == 0 else (1, -1))
    at = np.maximum.accumulate(np.where(np.isnan(height), -1, along), axis=axis)
    value = np.where(at >= 0, np.take_along_axis(height, np.maximum(at, 0), axis), np.float32(np.nan))
    return value, np.where(at >= 0, along - at, np.inf)


def _fill(
    height: NDArray[np.float32],
    state: NDArray[np.uint8],
    holes: BoolArray,
    known: BoolArray,
    distance: FloatArray,
    cell_width: float,
    void: BoolArray,
    share: float,
) -> None:
    """Fill each of the `holes` with the plane of the `known` ground around, if that is at least `share` of its rim."""
    label, count = ndimage.label(holes)
    start, order = by_cell(label.ravel().astype(np.int64), count + 1)
    _fill_labelled(height, state, label, start, order, known, distance, cell_width, void, share)


@njit(cache=True, nogil=True)
def _fill_labelled(
    height: NDArray[np.float32],
    state: NDArray[np.uint8],
    label: NDArray[np.int32],
    start: IntArray,
    order: IntArray,
    known: BoolArray,
    distance: FloatArray,
    cell_width: float,
    void: BoolArray,
    share: float,
) -> None:
    """`_fill` of the holes 1, 2 …, the flat cells of each in `order` from `start`."""
    nx, ny = label.shape
    met = np.zeros((nx, ny), np.int64)  # the last hole around which a cell was looked at
    for hole in range(1, len(start) - 1):
        cells = order[start[hole] : start[hole + 1]]
        shut = True
        for c in cells:
            x, y = c // ny, c % ny
            rim = x == 0 or y == 0 or x == nx - 1 or y == ny - 1
            shut &= not (rim or void[x, y] or distance[x, y] > MAX_HOLE_RADIUS)
        if not shut:
            continue
        left, top = cells[0] // ny, cells[0] % ny
        ring, heights = np.ones((25 * len(cells), 3)), np.empty(25 * len(cells))
        count, beside, ground = 0, 0, 0
        for c in cells:
            x, y = c // ny, c % ny
            for u in range(max(x - 2, 0), min(x + 3, nx)):
                for v in range(max(y - 2, 0), min(y + 3, ny)):
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
        if count < 3 or ground < share * beside:
            continue
        design, heights = ring[:count], heights[:count]
        on = heights <= np.median(heights) + cell_width
        plane: FloatArray = np.zeros(3)
        over: FloatArray = heights
        for _ in range(2):  # what stands on the ground beside the hole, a box or a step up, is no part of it
            plane = np.linalg.lstsq(design[on], heights[on], _ROUNDING * count)[0].astype(np.float64)
            over = heights - design @ plane
            on = np.abs(over) <= cell_width
            if not on.any():
                break
        if on.mean() < PLANE_SHARE or (over < -cell_width).mean() > 1.0 - RING_SHARE:
            continue
        for c in cells:
            x, y = c // ny, c % ny
            height[x, y] = (x - left) * plane[0] + (y - top) * plane[1] + plane[2]
            state[x, y] = INFERRED


def without_enclosed(surface: HeightMap, low: BoolArray) -> HeightMap:
    """Take back inferred ground that material at ground level shuts off from all seen ground: a cupboard's inside.

    Nobody has seen that it is hollow, so it is not called free.

    Args:
        surface: After `fill_holes`.
        low: Cells with material that the lowest body cannot pass under, shape (nx, ny).
    """
    label = ndimage.label((surface.state != UNKNOWN) & ~low)[0]
    seen = np.unique(label[(surface.state == OBSERVED) & ~low])
    enclosed = (surface.state == INFERRED) & ~low & ~np.isin(label, seen)
    height = np.where(enclosed, np.float32(np.nan), surface.height)
    state = np.where(enclosed, UNKNOWN, surface.state).astype(np.uint8)
    return HeightMap(surface.origin, surface.cell_width, height, state)

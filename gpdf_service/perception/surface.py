"""A single-valued piece of ground as a height map, with the holes filled that its surroundings explain."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple, TypeVar

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

from gpdf_service.config import PerceptionConfig
from gpdf_service.fields.threads import run_chunked
from gpdf_service.perception.bend import FINE, FLAT, bend_at, make_room, reach_of
from gpdf_service.perception.columns import between_range, cells_in_box, extent_in
from gpdf_service.perception.nearest import nearest_of
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
_SIDES = ((-1, 0), (1, 0), (0, -1), (0, 1))
"""The four neighbours of a cell."""
_ROUNDING = float(np.finfo(np.float64).eps)
"""[-] Of a least-squares fit, a row: a singular value below this times the rows over the largest counts as 0."""
MAX_HOLE_RADIUS = 1.0
"""[m] A hole is filled if no place in it is further from seen ground: a scanner's blind spot, the shadow of a desk."""


Scalar = TypeVar("Scalar", bound=np.generic)
Heights = float | FloatArray
"""Of one place or many [m]."""
Box = tuple[slice, slice]
"""Rows and columns of a grid."""
WHOLE: Box = (slice(None), slice(None))
NOWHERE: Box = (slice(0, 0), slice(0, 0))


def corner_of(box: Box) -> tuple[int, int]:
    """Its first cell."""
    return box[0].start or 0, box[1].start or 0


class Cells(NamedTuple):
    """A height map for compiled loops; the fields are those of `HeightMap`."""

    height: NDArray[np.float32]
    state: NDArray[np.uint8]
    origin: FloatArray
    width: float


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

    @property
    def arrays(self) -> Cells:
        """What a compiled loop needs for `cell_of`, `is_known` and `height_of`."""
        return Cells(self.height, self.state, np.asarray(self.origin, dtype=np.float64), self.cell_width)

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
        heights: FloatArray = _height_at(self.arrays, np.asarray(xy, dtype=np.float64))
        return heights

    def centres(self, mask: BoolArray) -> FloatArray:
        """Centres of the cells in `mask`, shape (nx, ny), with their height: (k, 3) [m]."""
        found: FloatArray = _centres(self.arrays, mask)
        return found


def changed(old: HeightMap, new: HeightMap) -> BoolArray:
    """Cells in which the ground is another, shape (nx, ny), of two maps on one grid."""
    cells: BoolArray = differ(old.height, new.height) | (old.state != new.state)
    return cells


def differ(a: NDArray[np.float32], b: NDArray[np.float32]) -> BoolArray:
    """Where heights are not the same, shape (nx, ny)."""
    cells: BoolArray = ~((a == b) | (np.isnan(a) & np.isnan(b)))
    return cells


def without(surface: HeightMap, cells: BoolArray) -> HeightMap:
    """The height map with nothing known of the `cells`, shape (nx, ny)."""
    height = np.where(cells, np.float32(np.nan), surface.height)
    return replace(surface, height=height, state=np.where(cells, UNKNOWN, surface.state).astype(np.uint8))


def cropped(surface: HeightMap, box: Box) -> HeightMap:
    """A box of cells of a height map."""
    origin = surface.origin + surface.cell_width * np.array(corner_of(box))
    return HeightMap(origin, surface.cell_width, surface.height[box], surface.state[box])


def cells_within(points: FloatArray, surface: HeightMap, box: Box = WHOLE) -> IntArray:
    """Flat cell in a box of the grid of each point, shape (n,); one more than there are for those outside."""
    first = corner_of(box)
    last = np.add(first, surface.state[box].shape)
    cell: IntArray = cells_in_box(points, surface.origin, surface.cell_width, np.array(first), last)
    return cell


def is_same_ground(height: Heights, other: Heights, cell_width: float) -> NDArray[np.bool_] | np.bool_:
    """Whether two levels are one ground where they have these heights [m], NaN where one has none."""
    return np.abs(height - other) <= cell_width


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
def _centres(ground: Cells, mask: BoolArray) -> FloatArray:
    made, used = np.empty((np.count_nonzero(mask), 3)), 0
    for x in range(mask.shape[0]):
        for y in range(mask.shape[1]):
            if mask[x, y]:
                made[used, 0] = ground.origin[0] + (x + 0.5) * ground.width
                made[used, 1] = ground.origin[1] + (y + 0.5) * ground.width
                made[used, 2] = ground.height[x, y]
                used += 1
    return made


@njit(cache=True, nogil=True)
def cell_of(ground: Cells, x: float, y: float) -> tuple[int, int]:
    """The cell of a place; (−1, −1) outside the grid, and for what is no place."""
    u, v = (x - ground.origin[0]) / ground.width, (y - ground.origin[1]) / ground.width
    if not (0.0 <= u < ground.state.shape[0] and 0.0 <= v < ground.state.shape[1]):
        return -1, -1
    return int(u), int(v)


@njit(cache=True, nogil=True)
def is_known(ground: Cells, x: float, y: float) -> bool:
    """Whether the ground is known under a place."""
    i, j = cell_of(ground, x, y)
    return i >= 0 and ground.state[i, j] != UNKNOWN


@njit(cache=True, nogil=True)
def _height_at(ground: Cells, xy: FloatArray) -> FloatArray:
    made = np.empty(len(xy))
    for m in range(len(xy)):
        made[m] = height_of(ground, xy[m, 0], xy[m, 1])
    return made


@njit(cache=True, nogil=True)
def height_of(ground: Cells, x: float, y: float) -> float:
    """`HeightMap.height_at` of one place."""
    height, origin, width = ground.height, ground.origin, ground.width
    x, y = (x - origin[0]) / width, (y - origin[1]) / width
    if not (0.0 <= x < height.shape[0] and 0.0 <= y < height.shape[1]):
        return np.nan
    own = float(height[int(x), int(y)])
    i, j = max(0, min(int(x - 0.5), height.shape[0] - 2)), max(0, min(int(y - 0.5), height.shape[1] - 2))
    a, b, c, d = float(height[i, j]), float(height[i, j + 1]), float(height[i + 1, j]), float(height[i + 1, j + 1])
    spread = max(max(a, b), max(c, d)) - min(min(a, b), min(c, d))
    if np.isnan(own + a + b + c + d) or spread > width * np.sqrt(2.0):
        return own
    u, v = max(0.0, min(x - 0.5 - i, 1.0)), max(0.0, min(y - 0.5 - j, 1.0))
    made: float = (1.0 - u) * ((1.0 - v) * a + v * b) + u * ((1.0 - v) * c + v * d)
    return made


class Nearest(NamedTuple):
    """For each cell of a box the seen ground nearest to it.

    Attributes:
        distance: To it [m], inf where nothing was seen, shape (nx, ny).
        height: Of it [m], NaN where nothing was seen, shape (nx, ny).
    """

    distance: FloatArray
    height: NDArray[np.float32]


def nearest_seen(surface: HeightMap, box: Box = WHOLE) -> Nearest:
    """The nearest seen ground of a height map, in a `box` of its cells; there is none outside."""
    distance, index = nearest_of(surface.state[box] == OBSERVED)
    height = surface.height[box].ravel()[index]  # of the last cell where there is none: then all are NaN
    return Nearest(distance * surface.cell_width, height)


def fill_holes(
    surface: HeightMap,
    lowest: FloatArray,
    seen_through: BoolArray,
    pit: BoolArray,
    walls: BoolArray,
    near: Nearest | None = None,
    noise: float = 0.0,
    config: PerceptionConfig | None = None,
) -> HeightMap:
    """Infer ground where its surroundings explain it, and mark it.

    A hole is a connected set of unknown cells bounded by known ground and things (cells whose `lowest` other point is
    under a ceiling's height, inf where there is none), shut off from the map's rim, with no place further than
    `MAX_HOLE_RADIUS` from seen ground, and with the ground around it on one plane within a cell's slope or higher: an
    edge that drops is not bridged. Nor is a void. Under a thing it is filled only where ground was seen beneath its
    rim. A notch in a flight is filled with the treads beside it, and the gap between two treads with the lower one.

    Args:
        surface: The ground as it was seen.
        lowest: Of the other points in each cell [m], inf where there is none, shape (nx, ny).
        seen_through: See `find_voids`.
        pit: See `find_voids`.
        walls: See `find_voids`.
        near: `nearest_seen` of the surface, where it is known.
        noise: Standard deviation of the points before they were cured [m].
        config: Limits of a flight's treads.
    """
    config = config or PerceptionConfig()
    known = surface.state == OBSERVED
    height, state = surface.height.copy(), surface.state.copy()
    near = near or nearest_seen(surface)
    distance, beside = near
    material = lowest < beside + CEILING
    _fill_gaps(height, state, ~known, surface, near, noise)
    _fill_notches(height, state, seen_through, distance, surface.cell_width, config)
    known = state != UNKNOWN
    void = seen_through | pit | _walled_down(surface, walls)
    _fill(height, state, ~known & ~material, known, distance, surface.cell_width, void, OPEN_SHARE)
    solid = state != UNKNOWN  # then the ground that carries the furniture itself
    under = ~solid & (distance <= MAX_HOLE_RADIUS) & material & _seen_hollow(~solid & material, known & material)
    _fill(height, state, under, solid, distance, surface.cell_width, void, SHUT_SHARE)
    _fill_gaps(height, state, state == UNKNOWN, surface, near, noise)  # what is left of larger ones
    return replace(surface, height=height, state=state)


def _seen_hollow(things: BoolArray, overhung: BoolArray) -> BoolArray:
    """Cells of things in whose neighbourhood ground was seen beneath material, further in than the edge of a cell.

    A table shows the floor under its rim, and single cells are no mass. What was seen from above alone, as a rock on a
    height map, may be solid.
    """
    label, count = ndimage.label(things, np.ones((3, 3)))
    hollow = np.ones(count + 1, dtype=bool)
    hollow[0] = False
    _tell_hollow(things, overhung, label, hollow)
    result: BoolArray = hollow[label]
    return result


@njit(cache=True, nogil=True)
def _tell_hollow(things: BoolArray, overhung: BoolArray, label: NDArray[np.int32], hollow: BoolArray) -> None:
    """Labels of masses become false, and true again if a cell within two of theirs is overhung and has no rim."""
    nx, ny = things.shape
    for mass in (True, False):
        for x in range(1, nx - 1):
            for y in range(1, ny - 1):
                if not (things[x, y] if mass else overhung[x, y]):
                    continue
                inner = True
                for u in range(x - 1, x + 2):
                    for v in range(y - 1, y + 2):
                        inner &= things[u, v] or (overhung[u, v] and not mass)
                if not inner:
                    continue
                if mass:
                    hollow[label[x, y]] = False
                    continue
                for u in range(max(x - 2, 0), min(x + 3, nx)):
                    for v in range(max(y - 2, 0), min(y + 3, ny)):
                        if things[u, v]:
                            hollow[label[u, v]] = True


def find_voids(
    surface: HeightMap,
    points: FloatArray,
    max_step: float,
    near: Nearest | None = None,
    box: Box = WHOLE,
    cell: IntArray | None = None,
) -> tuple[BoolArray, BoolArray, BoolArray]:
    """Unknown cells whose highest point of `points` (n, 3) lies over `max_step` under the ground beside them.

    Args:
        surface: The ground as it was seen.
        points: What else was seen [m], shape (n, 3).
        max_step: [m].
        near: `nearest_seen` of the surface in the box, where it is known.
        box: Cells that hold all points, and `MAX_HOLE_RADIUS` around them.
        cell: `cells_within` of the points, where it is known, shape (n,).

    Returns:
        Where the scanner saw through, further down than a floor is thick; where the bottom of a pit is seen, which is
        no ceiling because no storey is under it; and where the upper end of a pit's walls is. All (nx, ny) of the box.
    """
    distance, beside = near or nearest_seen(surface, box)
    part = cropped(surface, box)
    asked = (part.state == UNKNOWN) & (distance <= MAX_HOLE_RADIUS)
    cell, z = cells_within(points, surface, box) if cell is None else cell, points[:, 2]
    walls = _walls_down(part, cell, z)
    high = np.where(asked, beside + np.float32(surface.cell_width), -np.inf)
    bottom, top = extent_within(cell, z, np.full(asked.shape, -np.inf), under(high))
    seen = np.isfinite(top)
    depth = np.where(seen, beside - top, 0.0)
    pit = (depth > max_step) & (depth <= SLAB) & (np.where(seen, top - bottom, 0.0) < STOREY)
    return depth > SLAB, pit, walls


def extent_within(cell: IntArray, z: FloatArray, low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray]:
    """`extent_in` of cells on a grid, shape (nx, ny); points of the cell after the last one are in none."""
    least, most = extent_in(cell, z, low.ravel(), high.ravel())
    return least.reshape(low.shape), most.reshape(low.shape)


def between(cell: IntArray, z: FloatArray, low: NDArray[np.floating], high: NDArray[np.floating]) -> BoolArray:
    """Which points are over the `low` of their cell and not over its `high`, shape (n,): see `extent_within`."""
    found = np.empty(len(cell), dtype=bool)
    run_chunked(lambda a, b: between_range(cell, z, low.ravel(), high.ravel(), a, b, found), len(cell))
    return found


def _walls_down(surface: HeightMap, cell: IntArray, z: FloatArray) -> BoolArray:
    """Cells of a hole or beside one with a point right under the ground, no floor: `z` [m] in the flat `cell`, (n,).

    A step up at the rim is none: the lowest ground within two cells counts. But a rim's cell that holds the wall's
    upper end, too, lies as deep as that: of each cell and those around it the highest ground counts.
    """
    unknown = surface.state == UNKNOWN
    rim = ndimage.maximum_filter(np.where(unknown, -np.inf, surface.height), size=3)
    floor = ndimage.minimum_filter(np.where(unknown, np.inf, rim), size=5)
    low, high = (under(floor - cells * surface.cell_width) for cells in (WALL_CELLS, 1.0))
    walls: BoolArray = np.isfinite(extent_within(cell, z, low, high)[0])
    walls &= ndimage.maximum_filter(unknown, size=3, mode="constant")
    return walls


def under(heights: NDArray[np.floating]) -> FloatArray:
    """The next smaller numbers: what is not over them is under the heights."""
    made: FloatArray = np.nextafter(heights.astype(np.float64), -np.inf)
    return made


def _walled_down(surface: HeightMap, walls: BoolArray) -> BoolArray:
    """Holes with `walls` under more of their rim than a scan's noise explains."""
    unknown = surface.state == UNKNOWN
    label, count = ndimage.label(unknown)
    rim, pit = _rims(label, walls, count + 1)
    result: BoolArray = (pit > (1.0 - RING_SHARE) * rim)[label] & unknown
    return result


@njit(cache=True, nogil=True)
def _rims(label: NDArray[np.int32], walls: BoolArray, labels: int) -> tuple[IntArray, IntArray]:
    """Cells of the rim of each hole, and `walls` in or around it; what is at two holes is at the last one."""
    nx, ny = label.shape
    rim, pit = np.zeros(labels, np.int64), np.zeros(labels, np.int64)
    for x in range(nx):
        for y in range(ny):
            if label[x, y] > 0 and not walls[x, y]:
                continue
            hole = 0
            for u in range(max(x - 1, 0), min(x + 2, nx)):
                for v in range(max(y - 1, 0), min(y + 2, ny)):
                    hole = max(hole, label[u, v])
            rim[hole] += int(label[x, y] == 0)
            pit[hole] += int(walls[x, y])
    return rim, pit


def _fill_gaps(
    height: NDArray[np.float32],
    state: NDArray[np.uint8],
    holes: BoolArray,
    surface: HeightMap,
    near: Nearest,
    noise: float,
) -> None:
    """Fill single cells that the scan's spacing left empty, also at a step's edge.

    Each is of the smooth ground around it, or as high as the cell beside it. On a slope the latter makes a step that
    nobody saw. But where the cure has blurred a step to a slope, it shows it.
    """
    small = np.flatnonzero(_small(holes, near.distance, surface.cell_width))
    own = surface.height, reach_of(surface.cell_width, noise), max(FINE, FLAT * noise), small
    made = near.height.ravel()[small]
    run_chunked(lambda a, b: _onto_bends(*own, a, b, made), len(small))
    height.ravel()[small], state.ravel()[small] = made, INFERRED


@njit(cache=True, nogil=True)
def _onto_bends(
    height: NDArray[np.float32],
    reach: int,
    flat: float,
    cells: IntArray,
    begin: int,
    end: int,
    made: NDArray[np.float32],
) -> None:
    """Put `cells` that are not at the rim onto the quadric through the seen cells around where it is `flat` [m]."""
    (nx, ny), sums = height.shape, make_room()
    for k in range(begin, end):
        i, j = cells[k] // ny, cells[k] % ny
        if 0 < i < nx - 1 and 0 < j < ny - 1:
            shift, smooth = bend_at(height, i, j, reach, float(made[k]), flat, sums)
            if smooth:
                made[k] += shift


@njit(cache=True, nogil=True)
def _small(holes: BoolArray, distance: FloatArray, cell_width: float) -> BoolArray:
    """Connected cells of holes that are `GAP_CELLS` at most, none further than a cell from seen ground."""
    (nx, ny), small, cells = holes.shape, np.zeros(holes.shape, np.bool_), np.empty((GAP_CELLS + 4, 2), np.int64)
    for x in range(nx):
        for y in range(ny):
            if not holes[x, y] or small[x, y] or distance[x, y] > cell_width:
                continue
            cells[0], count, looked, gap = (x, y), 1, 0, True
            while gap and looked < count:
                i, j = cells[looked]
                looked += 1
                gap = distance[i, j] <= cell_width
                for dx, dy in _SIDES:
                    u, v = i + dx, j + dy
                    if not (0 <= u < nx and 0 <= v < ny and holes[u, v]):
                        continue
                    met = False
                    for k in range(count):
                        met |= cells[k, 0] == u and cells[k, 1] == v
                    if not met:
                        cells[count] = u, v
                        count += 1
                gap &= count <= GAP_CELLS
            for k in range(count if gap else 0):
                small[cells[k, 0], cells[k, 1]] = True
    return small


def _fill_notches(
    height: NDArray[np.float32],
    state: NDArray[np.uint8],
    void: BoolArray,
    distance: FloatArray,
    cell_width: float,
    config: PerceptionConfig,
) -> None:
    """Fill what a shadow bites out of a flight: uphill and downhill there is ground, and the tread itself beside.

    The whole back of a tread is hidden by the nose of the next one: such a gap is the lower tread's, where a third
    tread shows that they are a flight. On the level this is left to `_fill`: there the edge of a platform looks the
    same. A notch in a flight that lies across the grid at an angle stays as it was seen.
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
        here, first = _next_known(height, x, y, way * dx, way * dy, gap)
        there, _ = _next_known(height, x, y, -way * dx, -way * dy, gap)
        up, unknown = here > there, 0
        for step in range(first, span):
            u, v = x + way * step * dx, y + way * step * dy
            if not (0 <= u < height.shape[0] and 0 <= v < height.shape[1]) or unknown > gap:
                break
            if np.isnan(height[u, v]):
                unknown += 1
                continue
            rise, unknown = (height[u, v] - here) if up else (here - height[u, v]), 0
            if rise > least:
                if rise <= most:
                    return True
                break
    return False


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


@njit(cache=True, nogil=True)
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
    nx, ny = holes.shape
    met = np.zeros((nx, ny), np.int64)
    label, queue, last, hole = np.zeros((nx, ny), np.int32), np.empty(nx * ny, np.int64), 0, 0
    for corner in range(nx * ny):
        x, y = corner // ny, corner % ny
        if not holes[x, y] or label[x, y] > 0 or distance[x, y] > MAX_HOLE_RADIUS:
            continue
        first, hole = last, hole + 1
        label[x, y], queue[last] = hole, corner
        last, shut = _walk_hole(holes, distance, void, hole, label, queue, last)
        if not shut:
            continue
        cells = np.sort(queue[first:last])
        places, heights, ground = _ring(cells, hole, label, known, height, met)
        if len(heights) < 3 or ground < share:
            continue
        plane, held = _plane_under(places, heights, cell_width)
        if not held:
            continue
        left, top = cells[0] // ny, cells[0] % ny
        for c in cells:
            x, y = c // ny, c % ny
            height[x, y] = (x - left) * plane[0] + (y - top) * plane[1] + plane[2]
            state[x, y] = INFERRED


@njit(cache=True, nogil=True)
def _walk_hole(
    holes: BoolArray,
    distance: FloatArray,
    void: BoolArray,
    hole: int,
    label: NDArray[np.int32],
    queue: IntArray,
    looked: int,
) -> tuple[int, bool]:
    """Put the cells joined to the one that is `looked` at first behind it in the `queue`, and `label` them as a `hole`.

    Of what is further from seen ground than a hole may be it is enough to know that it is beside one.

    Returns:
        Where the queue ends, and whether no such cell, no void and no rim of the map is at the hole.
    """
    (nx, ny), last, shut = holes.shape, looked + 1, True
    while looked < last:
        x, y = queue[looked] // ny, queue[looked] % ny
        looked += 1
        shut &= not (x == 0 or y == 0 or x == nx - 1 or y == ny - 1 or void[x, y])
        for dx, dy in _SIDES:
            u, v = x + dx, y + dy
            if not (0 <= u < nx and 0 <= v < ny and holes[u, v]) or label[u, v] > 0:
                continue
            if distance[u, v] > MAX_HOLE_RADIUS:
                shut = False
                continue
            label[u, v], queue[last], last = hole, u * ny + v, last + 1
    return last, shut


@njit(cache=True, nogil=True)
def _ring(
    cells: IntArray,
    hole: int,
    label: NDArray[np.int32],
    known: BoolArray,
    height: NDArray[np.float32],
    met: IntArray,
) -> tuple[FloatArray, FloatArray, float]:
    """Places (x, y, 1) of the known cells within two of a hole's, from its first one on, and their heights [m].

    Also the share of the cells right beside the hole that are known. What was `met` around it is marked by twice its
    number, and right beside it by one more.
    """
    nx, ny = label.shape
    left, top = cells[0] // ny, cells[0] % ny
    ring, heights = np.ones((25 * len(cells), 3)), np.empty(25 * len(cells))  # of each cell the 5 × 5 around, at most
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
    return ring[:count], heights[:count], ground / max(beside, 1)


@njit(cache=True, nogil=True)
def _plane_under(places: FloatArray, heights: FloatArray, cell_width: float) -> tuple[FloatArray, bool]:
    """The plane that most of the ground around a hole lies on or over, and whether there is one.

    What stands on the ground beside the hole, a box or a step up, is no part of it.
    """
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


def without_enclosed(surface: HeightMap, low: BoolArray) -> HeightMap:
    """Take back inferred ground that material at ground level shuts off from all seen ground: a cupboard's inside.

    Nobody has seen that it is hollow, so it is not called free. What is no wider than a gap is left: things around it
    keep every body out, and the face of a step, which noise spreads over some cells of its top, does not have to.

    Args:
        surface: After `fill_holes`.
        low: Cells with material that the lowest body cannot pass under, shape (nx, ny).
    """
    label, count = ndimage.label((surface.state != UNKNOWN) & ~low)
    seen = np.zeros(count + 1, dtype=bool)
    seen[label[(surface.state == OBSERVED) & ~low]] = True
    wide = np.bincount(label.ravel()) > GAP_CELLS
    return without(surface, (surface.state == INFERRED) & ~low & (wide & ~seen)[label])

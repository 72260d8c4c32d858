"""A single-valued piece of ground as a height map."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gpdf_service.kernel_cache import lean
from gpdf_service.tiles.boxes import WHOLE, Box, corner_of, over_blocks
from gpdf_service.tiles.nearest import nearest_of
from gpdf_service.tiles.rows import cells_in_box
from gpdf_service.tiles.told import moved, unlike
from gpdf_service.types import BoolArray, FloatArray, IntArray

UNKNOWN, OBSERVED, INFERRED = 0, 1, 2
BLOCK = 8
"""Cells along a side of the blocks whose lowest and highest ground is told at once: of 5 cm cells 0.4 m."""
Heights = float | FloatArray
"""Of one place or many [m]."""


class Cells(NamedTuple):
    """A height map for compiled loops; the fields are those of `HeightMap`."""

    height: NDArray[np.float32]
    state: NDArray[np.uint8]
    origin: FloatArray
    width: float


@dataclass(frozen=True)
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

    @cached_property
    def arrays(self) -> Cells:
        """What a compiled loop needs for `cell_of`, `is_known` and `height_of`."""
        return Cells(self.height, self.state, np.asarray(self.origin, dtype=np.float64), self.cell_width)

    @cached_property
    def ends(self) -> NDArray[np.float32]:
        """Lowest and highest ground of each block of cells [m], inf and −inf where there is none; for `rise_around`."""
        ends = (over_blocks(self.height, BLOCK, *end) for end in ((np.fmin, np.inf), (np.fmax, -np.inf)))
        return np.stack(list(ends), axis=-1)

    @cached_property
    def inferred(self) -> NDArray[np.int32]:
        """How many cells are INFERRED, by boxes: see `count_cells`."""
        made: NDArray[np.int32] = count_cells(self.state == INFERRED)
        return made

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
        at = np.nonzero(mask)
        return np.column_stack([self.origin + (np.column_stack(at) + 0.5) * self.cell_width, self.height[at]])


def changed(old: HeightMap, new: HeightMap) -> BoolArray:
    """Cells in which the ground is another, shape (nx, ny), of two maps on one grid."""
    cells: BoolArray = unlike(old.height, new.height) | (old.state != new.state)
    return cells


def first_cell(surface: HeightMap, origin: FloatArray) -> tuple[int, int]:
    """The first cell of a box with that lower corner [m] among those of a map of the same grid; it may lie outside."""
    x, y = np.rint((origin - surface.origin) / surface.cell_width).astype(int).tolist()
    return x, y


def placed(surface: HeightMap, origin: FloatArray, shape: tuple[int, ...]) -> HeightMap:
    """A height map in another box of its grid, with that lower corner [m] and shape."""
    by = first_cell(surface, origin)
    if by == (0, 0) and shape == surface.state.shape:
        return surface
    height, state = moved(surface.height, by, shape, np.nan), moved(surface.state, by, shape, UNKNOWN)
    return HeightMap(origin, surface.cell_width, height, state)


def spread(one: HeightMap, other: HeightMap) -> tuple[HeightMap, HeightMap]:
    """Two height maps of one grid, each in the least box that holds both."""
    low = np.minimum(one.origin, other.origin)
    high = np.maximum(*(each.origin + each.cell_width * np.array(each.state.shape) for each in (one, other)))
    nx, ny = np.rint((high - low) / one.cell_width).astype(int).tolist()
    return placed(one, low, (nx, ny)), placed(other, low, (nx, ny))


def turned(was: HeightMap, now: HeightMap) -> Cells:
    """Over two maps of one grid: the `state` is 1 in cells that became known or unknown, else 0."""
    before, after = spread(was, now)
    return replace(after, state=((before.state != UNKNOWN) != (after.state != UNKNOWN)).view(np.uint8)).arrays


def without(surface: HeightMap, cells: BoolArray) -> HeightMap:
    """The height map with nothing known of the `cells`, shape (nx, ny)."""
    height = np.where(cells, np.float32(np.nan), surface.height)
    return replace(surface, height=height, state=np.where(cells, UNKNOWN, surface.state).astype(np.uint8))


def cropped(surface: HeightMap, box: Box) -> HeightMap:
    """A box of cells of a height map; in one piece, as whole maps are: no kernel is compiled once more for it."""
    origin = surface.origin + surface.cell_width * np.array(corner_of(box))
    height, state = np.ascontiguousarray(surface.height[box]), np.ascontiguousarray(surface.state[box])
    return HeightMap(origin, surface.cell_width, height, state)


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


def count_cells(mask: BoolArray) -> NDArray[np.int32]:
    """How many of the first i rows and j columns of cells, (nx, ny), are in a mask: shape (nx + 1, ny + 1).

    Four of these numbers tell of any box of cells, however large it is (Crow 1984).
    """
    made = np.zeros((mask.shape[0] + 1, mask.shape[1] + 1), np.int32)
    mask.cumsum(axis=0, dtype=np.int32).cumsum(axis=1, out=made[1:, 1:])
    return made


@lean()
def count_in(counts: NDArray[np.int32], u0: int, u1: int, v0: int, v1: int) -> int:
    """How many cells of rows u0 to u1 and columns v0 to v1, the last ones not among them, are in the mask."""
    count: int = counts[u1, v1] - counts[u0, v1] - counts[u1, v0] + counts[u0, v0]
    return count


@lean()
def rise_around(path: FloatArray, reach: float, ground: Cells, ends: NDArray[np.float32]) -> float:
    """How far apart ground can be in height that is within `reach` [m] of a path, (n, ≥ 2); −inf where there is none.

    It is told by all blocks that meet the box around the path: never less than it is, and soon.
    """
    low, high = np.float32(np.inf), np.float32(-np.inf)
    rows, columns = _blocks(path, 0, reach, ground), _blocks(path, 1, reach, ground)
    for i in range(rows[0], rows[1]):
        for j in range(columns[0], columns[1]):
            low, high = min(low, ends[i, j, 0]), max(high, ends[i, j, 1])
    return float(high) - float(low)


@lean()
def _blocks(path: FloatArray, axis: int, reach: float, ground: Cells) -> tuple[int, int]:
    """The first block along an axis that is within `reach` of a path, and the one after the last."""
    least, most, side = path[0, axis], path[0, axis], BLOCK * ground.width
    for i in range(1, len(path)):
        least, most = min(least, path[i, axis]), max(most, path[i, axis])
    count = -(-ground.height.shape[axis] // BLOCK)
    if not most - least < np.inf:  # a place that is none may be anywhere
        return 0, count
    low, high = (least - reach - ground.origin[axis]) / side, (most + reach - ground.origin[axis]) / side
    return int(min(max(low, 0.0), count)), int(min(max(high + 1.0, 0.0), count))


@lean()
def cell_of(ground: Cells, x: float, y: float) -> tuple[int, int]:
    """The cell of a place; (−1, −1) outside the grid, and for what is no place."""
    u, v = (x - ground.origin[0]) / ground.width, (y - ground.origin[1]) / ground.width
    if not (0.0 <= u < ground.state.shape[0] and 0.0 <= v < ground.state.shape[1]):
        return -1, -1
    return int(u), int(v)


@lean()
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


@lean()
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
    """For each cell the seen ground nearest to it.

    Attributes:
        distance: To it [m], inf where nothing was seen, shape (nx, ny).
        height: Of it [m], NaN where nothing was seen, shape (nx, ny).
    """

    distance: FloatArray
    height: NDArray[np.float32]


def nearest_seen(surface: HeightMap) -> Nearest:
    """The nearest seen ground of a height map."""
    distance, index = nearest_of(surface.state == OBSERVED)
    height = surface.height.ravel()[index]  # of the last cell where there is none: then all are NaN
    return Nearest(distance * surface.cell_width, height)

"""PRM (OMPL's) on a binary occupancy of the flat world, inflated by the body's radius."""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot, sqrt

import numpy as np
from numba import njit
from scipy import ndimage

from gpdf_service.baselines.flat import FlatWorld
from gpdf_service.baselines.sampling import sample_path
from gpdf_service.perception.surface import UNKNOWN
from gpdf_service.types import BoolArray, FloatArray, IntArray

CELL = 0.01
"""[m] A binary cell: what it rounds away closes a gap by less than 3 cm."""
MAX_CELLS = 4_000_000
"""Cells of the occupancy: on maps larger than 20 × 20 m the cells grow with the map."""
SECONDS = 2.0
"""[s] For the roadmap: most queries are answered in 20 ms, a narrow door may take all of it."""


@dataclass(frozen=True, slots=True)
class Occupancy:
    """Binary grid: lower corner [m], cell width [m], and where the body's centre may be, shape (nx, ny)."""

    origin: FloatArray
    cell: float
    free: BoolArray

    def cell_of(self, xy: FloatArray) -> IntArray:
        """Cell of each place, shape (m, 2), clipped to the grid."""
        index = np.floor((xy - self.origin) / self.cell).astype(np.int64)
        return np.clip(index, 0, np.array(self.free.shape) - 1)


def build_occupancy(world: FlatWorld) -> Occupancy:
    """Mark the cells that hold obstacle points, and inflate them: a place anywhere in a free cell is free."""
    size = world.surface.cell_width * np.array(world.surface.height.shape)
    cell = max(CELL, sqrt(float(size.prod()) / MAX_CELLS))
    shape = tuple(int(n) for n in np.maximum(1, np.ceil(size / cell)))
    grid = Occupancy(world.surface.origin, cell, np.ones(shape, dtype=bool))
    inside = ((world.points >= grid.origin) & (world.points <= grid.origin + size)).all(axis=1)
    empty = np.ones(shape, dtype=bool)
    empty[tuple(grid.cell_of(world.points[inside]).T)] = False
    room = ndimage.distance_transform_edt(empty) * cell if not empty.all() else np.full(shape, np.inf)
    ix, iy = (np.floor((np.arange(n) + 0.5) * cell / world.surface.cell_width).astype(np.int64) for n in shape)
    state = world.surface.state
    seen = state[np.ix_(np.minimum(ix, state.shape[0] - 1), np.minimum(iy, state.shape[1] - 1))] != UNKNOWN
    return Occupancy(grid.origin, cell, seen & (room >= world.radius + sqrt(2.0) * cell))


def find_prm_path(world: FlatWorld, seconds: float = SECONDS) -> FloatArray | None:
    """Places in plan from start to goal, shape (n, 2) [m]; none if the roadmap does not join them in time."""
    grid = build_occupancy(world)
    if not grid.free.any():
        return None
    ends = [_nearest_free(grid, place) for place in (world.start, world.goal)]
    label = ndimage.label(grid.free, np.ones((3, 3)))[0]
    if len({int(label[tuple(cell)]) for cell in ends}) > 1:  # no roadmap can join what the grid keeps apart
        return None
    start, goal = (grid.origin + (cell + 0.5) * grid.cell for cell in ends)
    high = grid.origin + grid.cell * np.array(grid.free.shape)
    origin, cell, free = grid.origin, grid.cell, grid.free

    def clear(a: FloatArray, b: FloatArray) -> bool:
        return bool(_line_is_free(free, origin, cell, a, b))

    path = sample_path("PRM", clear, grid.origin, high, start, goal, seconds)
    return None if path is None else np.vstack([world.start, path, world.goal])


def _nearest_free(grid: Occupancy, xy: FloatArray) -> IntArray:
    """The free cell nearest to a place: the body may stand closer to a wall than the inflation's rounding allows."""
    own: IntArray = grid.cell_of(xy[None])[0]
    if grid.free[tuple(own)]:
        return own
    cells = np.argwhere(grid.free)
    nearest: IntArray = cells[np.linalg.norm(cells - (xy - grid.origin) / grid.cell + 0.5, axis=1).argmin()]
    return nearest


@njit(cache=True, nogil=True)
def _line_is_free(free: BoolArray, origin: FloatArray, cell: float, a: FloatArray, b: FloatArray) -> bool:
    """Whether every cell that the segment ab passes is free, looked at each half cell."""
    count = int(2.0 * hypot(b[0] - a[0], b[1] - a[1]) / cell) + 1
    for i in range(count + 1):
        x = int((a[0] + (b[0] - a[0]) * i / count - origin[0]) / cell)
        y = int((a[1] + (b[1] - a[1]) * i / count - origin[1]) / cell)
        if x < 0 or y < 0 or x >= free.shape[0] or y >= free.shape[1] or not free[x, y]:
            return False
    return True

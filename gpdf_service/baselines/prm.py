"""PRM (OMPL's) on a binary occupancy of the flat world, inflated by the body's radius."""

from __future__ import annotations

from math import hypot

import numpy as np
from numba import njit

from gpdf_service.baselines.flat import FlatWorld
from gpdf_service.baselines.sampling import sample_path
from gpdf_service.types import BoolArray, FloatArray

SECONDS = 2.0
"""[s] For the roadmap: most queries are answered in 20 ms, a narrow door may take all of it."""


def find_prm_path(world: FlatWorld, start: FloatArray, goal: FloatArray, seconds: float = SECONDS) -> FloatArray | None:
    """Places in plan from start to goal, shape (n, 2) [m]; none if the roadmap does not join them in time."""
    grid = world.occupancy
    if not grid.free.any():
        return None
    ends = [grid.nearest_free(place) for place in (start, goal)]
    if len({int(grid.label[tuple(cell)]) for cell in ends}) > 1:  # no roadmap can join what the grid keeps apart
        return None
    a, b = (grid.origin + (cell + 0.5) * grid.cell for cell in ends)
    high = grid.origin + grid.cell * np.array(grid.free.shape)
    origin, cell, free = grid.origin, grid.cell, grid.free

    def clear(a: FloatArray, b: FloatArray) -> bool:
        return bool(_line_is_free(free, origin, cell, a, b))

    path = sample_path("PRM", clear, grid.origin, high, a, b, seconds)
    return None if path is None else np.vstack([start, path, goal])


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

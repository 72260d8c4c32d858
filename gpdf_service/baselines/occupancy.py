"""A binary occupancy of the flat world, inflated by the body's radius: what the PRM searches."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import sqrt

import numpy as np
from scipy import ndimage

from gpdf_service.tiles import HeightMap
from gpdf_service.tiles.surface import UNKNOWN
from gpdf_service.types import BoolArray, FloatArray, IntArray

CELL = 0.01
"""[m] A binary cell: what it rounds away closes a gap by less than 3 cm."""
MAX_CELLS = 4_000_000
"""Cells of the occupancy: on maps larger than 20 × 20 m the cells grow with the map."""


@dataclass(frozen=True)
class Occupancy:
    """Binary grid: lower corner [m], cell width [m], and where the body's centre may be, shape (nx, ny)."""

    origin: FloatArray
    cell: float
    free: BoolArray

    def cell_of(self, xy: FloatArray) -> IntArray:
        """Cell of each place, shape (m, 2), clipped to the grid."""
        index = np.floor((xy - self.origin) / self.cell).astype(np.int64)
        return np.clip(index, 0, np.array(self.free.shape) - 1)

    def nearest_free(self, xy: FloatArray) -> IntArray:
        """The free cell nearest to a place: a body may stand closer to a wall than the inflation's rounding allows."""
        own: IntArray = self.cell_of(xy[None])[0]
        if self.free[tuple(own)]:
            return own
        cells = np.argwhere(self.free)
        nearest: IntArray = cells[np.linalg.norm(cells - (xy - self.origin) / self.cell + 0.5, axis=1).argmin()]
        return nearest

    @cached_property
    def label(self) -> IntArray:
        """Which free cells hang together, shape (nx, ny)."""
        label: IntArray = ndimage.label(self.free, np.ones((3, 3)))[0]
        return label


def build_occupancy(surface: HeightMap, points: FloatArray, radius: float) -> Occupancy:
    """Mark the cells that hold obstacle points, and inflate them: a place anywhere in a free cell is free."""
    size = surface.cell_width * np.array(surface.height.shape)
    cell = max(CELL, sqrt(float(size.prod()) / MAX_CELLS))
    shape = tuple(int(n) for n in np.maximum(1, np.ceil(size / cell)))
    grid = Occupancy(surface.origin, cell, np.ones(shape, dtype=bool))
    inside = ((points >= grid.origin) & (points <= grid.origin + size)).all(axis=1)
    empty = np.ones(shape, dtype=bool)
    empty[tuple(grid.cell_of(points[inside]).T)] = False
    room = ndimage.distance_transform_edt(empty) * cell if not empty.all() else np.full(shape, np.inf)
    ix, iy = (np.floor((np.arange(n) + 0.5) * cell / surface.cell_width).astype(np.int64) for n in shape)
    state = surface.state
    seen = state[np.ix_(np.minimum(ix, state.shape[0] - 1), np.minimum(iy, state.shape[1] - 1))] != UNKNOWN
    return Occupancy(grid.origin, cell, seen & (room >= radius + sqrt(2.0) * cell))

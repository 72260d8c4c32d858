"""A cloud, and where it is another than in the version before."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpdf_service.config import PerceptionConfig
from gpdf_service.perception.boxes import Box, widened, window
from gpdf_service.perception.columns import by_cell
from gpdf_service.perception.layers import Layers, build_layers, grid_of, layer_gap, same_nodes, splice_layers
from gpdf_service.perception.points import Points
from gpdf_service.perception.rows import (
    cells_in_box,
    chosen_rows,
    rows_by_cell,
    rows_in_box,
    rows_in_cells,
)
from gpdf_service.perception.surface import HeightMap
from gpdf_service.types import BoolArray, FloatArray, IntArray

AT_HAND = 2.4
"""[m] Around a change, twice as far as sheets overlap: of a house's requests 99 in 100 lay within it."""
RIM = 3
"""Cells at a grid's rim that hold the outermost points: see `grid_of`."""
Rows = slice | NDArray[Any]
"""Some rows of an array: all, or by their numbers."""


class WholeError(Exception):
    """The change asks for a look at the whole cloud."""


class Cloud:
    """A cloud, with the points around a change at hand by their cells: they are asked for again and again.

    Attributes:
        points: All, by numbers up to n.
        places: Where any came, went, or counts for something else than before [m], (k, 3); of a build nothing is told.
    """

    def __init__(self, points: Points, places: FloatArray) -> None:
        self.points, self.places = points, places
        self._low = places[:, :2].min(axis=0, initial=np.inf) - AT_HAND
        self._high = places[:, :2].max(axis=0, initial=-np.inf) + AT_HAND
        self._rows: IntArray = points.rows_in_box(self._low, self._high) if len(places) else np.zeros(0, np.int64)
        self._near = points.taken(self._rows)
        self._sorted: dict[tuple[Any, ...], tuple[Box, IntArray, IntArray]] = {}

    def add(self, other: BoolArray) -> None:
        """The points that are `other`, shape (n,), count for something else, too."""
        self.places = np.concatenate([self.places, self.points.taken(np.flatnonzero(other))])

    def part(self, grid: Layers | HeightMap, wanted: BoolArray) -> tuple[Rows, FloatArray]:
        """Numbers of the points in the `wanted` cells of a grid, (nx, ny), and these points; if all are, of all."""
        if wanted.all():
            return (slice(None) if self.points.untouched else np.flatnonzero(self.points.there)), self.points.present
        rows = self._rows_in(grid, wanted)
        return rows, self.points.taken(rows)

    def rows_in_box(self, low: FloatArray, high: FloatArray) -> IntArray:
        """Numbers of the points between `low` and `high` in plan [m], shape (2,); they ascend."""
        if (low < self._low).any() or (high > self._high).any():
            return self.points.rows_in_box(low, high)
        return self._rows[rows_in_box(self._near, low, high)]

    def _rows_in(self, grid: Layers | HeightMap, wanted: BoolArray) -> IntArray:
        if not wanted.any():
            return np.zeros(0, np.int64)
        x, y = window(wanted, 1)
        low, high = (grid.origin + grid.cell_width * np.array(end) for end in ((x.start, y.start), (x.stop, y.stop)))
        if (low < self._low).any() or (high > self._high).any():
            rows = self.points.rows_in_box(low - grid.cell_width, high + grid.cell_width)  # rounding: a cell more
            return rows[rows_in_cells(self.points.taken(rows), grid.origin, grid.cell_width, wanted)]
        at_hand, start, order = self._by_cell(grid, wanted.shape)
        return self._rows[np.sort(order[rows_by_cell(wanted[at_hand], start)])]

    def _by_cell(self, grid: Layers | HeightMap, shape: tuple[int, ...]) -> tuple[Box, IntArray, IntArray]:
        """The box of cells at hand, where each begins, and the points at hand in their order."""
        key = (*grid.origin, *shape)
        if key not in self._sorted:
            ends = self._low, self._high
            first, last = (np.floor((end - grid.origin) / grid.cell_width).astype(int) for end in ends)
            first, last = np.clip(first, 0, shape), np.clip(last + 1, 0, shape)
            box = slice(first[0], last[0]), slice(first[1], last[1])
            flat = cells_in_box(self._near, grid.origin, grid.cell_width, first, last)
            self._sorted[key] = box, *by_cell(flat, int((last - first).prod()) + 1)
        return self._sorted[key]


def change_layers(
    layers: Layers, cloud: Cloud, chosen: BoolArray, config: PerceptionConfig
) -> tuple[Layers, BoolArray]:
    """Layers of the `chosen` points of a changed cloud, (n,), and the cells whose columns or those beside have others.

    They are the former ones where these hold the same nodes, as where something was put onto the ground.

    Raises:
        WholeError: their grid is another, so that all else would be moved.
    """
    width, shape = layers.cell_width, np.array(layers.shape)
    index = np.floor((cloud.places[:, :2] - layers.origin) / width)
    if ((index < RIM) | (index >= shape - RIM)).any():
        grid = grid_of(*cloud.points.bounds(chosen), width) if chosen.any() else None
        if grid is None or (grid[0] != layers.origin).any() or grid[1] != layers.shape:
            raise WholeError
    cells = np.zeros(layers.shape, dtype=bool)
    x, y = index[((index >= 0) & (index < shape)).all(axis=1)].astype(np.int64).T
    cells[x, y] = True
    cells = widened(cells, 1)  # a node's height asks those beside
    rows, points = cloud.part(layers, cells)
    own = chosen_rows(points, chosen[rows])
    fresh = build_layers(own, width, layer_gap(width, config), like=layers) if len(own) else None
    return layers if same_nodes(layers, cells, fresh) else splice_layers(layers, cells.ravel(), fresh), cells

"""A cloud, where it is another than in the version before, and which of its points are reflections."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpdf_service.config import PerceptionConfig
from gpdf_service.fields.order import corners_of
from gpdf_service.fields.threads import run_chunked
from gpdf_service.perception.rays import Rays
from gpdf_service.tiles.boxes import widened, window
from gpdf_service.tiles.layers import Layers, build_layers, grid_of, same_nodes, splice_layers
from gpdf_service.tiles.points import Points
from gpdf_service.tiles.rows import is_among
from gpdf_service.tiles.surface import HeightMap
from gpdf_service.tiles.width import layer_gap
from gpdf_service.types import BoolArray, FloatArray

Rows = slice | NDArray[Any]
"""Some rows of an array: all, or by their numbers."""


class WholeError(Exception):
    """The change asks for a look at the whole cloud."""


class Cloud:
    """A cloud, and where it changed.

    Attributes:
        points: All, by numbers up to n.
        places: Where any came, went, or counts for something else than before [m], (k, 3); of a build nothing is told.
        rays: Those of its scan, where they are known.
    """

    def __init__(self, points: Points, places: FloatArray, rays: Rays | None = None) -> None:
        self.points, self.places, self.rays = points, places, rays

    @property
    def seen_anew(self) -> bool:
        """Whether rays came or went."""
        return self.rays is not None and self.rays.news is not None

    def add(self, other: BoolArray) -> None:
        """The points that are `other`, shape (n,), count for something else, too."""
        self.places = np.concatenate([self.places, self.points.taken(np.flatnonzero(other))])

    def part(self, grid: Layers | HeightMap, wanted: BoolArray) -> tuple[Rows, FloatArray]:
        """Numbers of the points in the `wanted` cells of a grid, (nx, ny), and these points; if all are, of all."""
        if wanted.all():
            return (slice(None) if self.points.untouched else self.points.all_numbers), self.points.present
        rows = self.points.rows_in_cells(np.asarray(grid.origin, np.float64), grid.cell_width, wanted)
        return rows, self.points.taken(rows)

    def chosen(self, grid: Layers | HeightMap, wanted: BoolArray, kind: BoolArray) -> FloatArray:
        """The points of a `kind`, shape (n,), in the `wanted` cells of a grid, (nx, ny)."""
        own = np.asarray(grid.origin, np.float64), grid.cell_width, wanted, kind
        rows = self.points.in_order(np.flatnonzero(kind)) if wanted.all() else self.points.rows_in_cells(*own)
        return self.points.taken(rows)


def change_layers(
    layers: Layers, cloud: Cloud, chosen: BoolArray, config: PerceptionConfig
) -> tuple[Layers, BoolArray]:
    """Layers of the `chosen` points of a changed cloud, (n,), and the cells whose columns or those beside have others.

    They are the former ones where these hold the same nodes, as where something was put onto the ground.

    Raises:
        WholeError: their grid is another, so that all else would be moved.
    """
    width, shape = layers.cell_width, layers.shape
    index = np.floor((cloud.places[:, :2] - layers.origin) / width)
    held = window((np.diff(layers.start) > 0).reshape(layers.shape), 0)
    if any(((at <= side.start) | (at >= side.stop - 1)).any() for at, side in zip(index.T, held, strict=True)):
        grid = grid_of(*cloud.points.bounds(chosen), width) if chosen.any() else None
        if grid is None or (grid[0] != layers.origin).any() or grid[1] != layers.shape:
            raise WholeError
    cells = np.zeros(layers.shape, dtype=bool)
    x, y = index.astype(np.int64).T
    inside = (x >= 0) & (x < shape[0]) & (y >= 0) & (y < shape[1])
    cells[x[inside], y[inside]] = True
    cells = widened(cells, 1)  # a node's height asks those beside
    own = cloud.chosen(layers, cells, chosen)
    fresh = build_layers(own, width, layer_gap(width, config), like=layers) if len(own) else None
    return layers if same_nodes(layers, cells, fresh) else splice_layers(layers, cells, fresh), cells


def find_strays(points: FloatArray, width: float) -> BoolArray:
    """Which points (n, 3) have no other in their voxel of `width` [m] or in the 26 around it, shape (n,)."""
    stray, key = np.zeros(len(points), dtype=bool), np.empty(len(points), np.int64)
    if len(points) == 0:
        return stray
    low, high = (np.floor(corner / width) for corner in corners_of(points))
    ny, nz = (int(n) for n in (high - low)[1:] + 2.0)  # a voxel at each end is empty: none is beside a row's last one
    strides = np.array([ny * nz, nz, 1])

    def tell(a: int, b: int) -> None:  # counted from the frame's origin, so that a part of a cloud has the same voxels
        key[a:b] = (np.floor(points[a:b] / width) - low).astype(np.int64) @ strides

    run_chunked(tell, len(points))
    held, count = np.unique(key, return_counts=True)
    alone = held[count == 1]
    for beside in (np.indices((3, 3, 3)).reshape(3, -1).T - 1) @ strides:
        if beside != 0:
            alone = alone[~is_among(alone + beside, held)]

    def mark(a: int, b: int) -> None:
        stray[a:b] = is_among(key[a:b], alone)

    run_chunked(mark, len(points))
    return stray

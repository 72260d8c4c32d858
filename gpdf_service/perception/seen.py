"""A level's ground as it was seen: heights of a sheet's nodes at the centres of cells."""

from __future__ import annotations

from dataclasses import replace
from math import ceil

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gpdf_service.ground.foot import RESOLVED_STEP
from gpdf_service.ground.footing import bridged, footing_reach
from gpdf_service.ground.level import OVERLAP
from gpdf_service.ground.limits import neighbourhood, smoothed
from gpdf_service.perception.site import Part
from gpdf_service.perception.smooth import smooth_reach, to_centres, with_rims
from gpdf_service.tiles.boxes import Box
from gpdf_service.tiles.layers import BLOCK, Layers
from gpdf_service.tiles.surface import OBSERVED, UNKNOWN, HeightMap, cropped
from gpdf_service.tiles.told import Grid
from gpdf_service.types import BoolArray, ByteArray, Float32Array, FloatArray, IntArray


def part_of(layers: Layers, sheet: BoolArray) -> Part:
    """The box that holds the sheet of these nodes, shape (k,), and what decides on it.

    What stands beside a sheet counts within `OVERLAP`, and no hole in it is wider. The box is one of whole blocks of
    cells: so it stays where the ground changes a little.
    """
    nodes, by = np.flatnonzero(sheet), ceil(OVERLAP / layers.cell_width) + 1
    (x, end_x), (y, end_y) = (
        (max((int(at.min()) - by) // BLOCK * BLOCK, 0), min(((int(at.max()) + by) // BLOCK + 1) * BLOCK, size))
        for at, size in zip(np.divmod(layers.cell[nodes], layers.shape[1]), layers.shape, strict=True)
    )
    return Part(nodes, layers.origin + layers.cell_width * np.array([x, y]), (x, y), (end_x - x, end_y - y))


def sheet_surface(grid: Grid, layers: Layers, part: Part, max_step: float, noise: float = 0.0) -> HeightMap:
    """The ground of a sheet as it was seen, at the centres of its cells; the `noise` is that before the cure [m].

    What a flight is tells `max_step` [m], see `bridged`.
    """
    height, off = _nodes_at(layers, part)
    pairs = off.view(np.complex64)[..., 0]  # each two in one, to be compared at once
    whole = HeightMap(part.origin, layers.cell_width, height, np.zeros(part.shape, np.uint8))

    def answer(
        box: Box, height: Float32Array, pairs: NDArray[np.complex64]
    ) -> tuple[Float32Array, Float32Array, ByteArray]:
        off = np.ascontiguousarray(pairs)[..., None].view(np.float32)
        state = np.where(np.isnan(height), UNKNOWN, OBSERVED).astype(np.uint8)
        seen = replace(cropped(whole, box), height=height, state=state)
        surface = without_outliers(seen, RESOLVED_STEP * noise)
        if surface is not seen:  # a median's place is the middle of its cells
            off = np.where((surface.height != height)[..., None], np.float32(0.0), off)
        made = with_rims(to_centres(surface, off, noise), noise)
        height = bridged(made, max_step).height
        return height, made.height, np.where(np.isnan(height), UNKNOWN, OBSERVED).astype(np.uint8)

    reach = smooth_reach(whole, noise) + footing_reach(whole)
    height, _, state = grid.around("seen", reach, answer, height, pairs)
    return replace(whole, height=height, state=state)


def _nodes_at(layers: Layers, part: Part) -> tuple[Float32Array, Float32Array]:
    """Height of each cell's node [m], NaN of none, (nx, ny), and how far its place is from the middle [m], (nx, ny, 2).

    Of none it is 0.
    """
    height, off = np.full(part.shape, np.nan, np.float32), np.zeros((*part.shape, 2), np.float32)
    grid = layers.cell, layers.height, (layers.shape[1], layers.cell_width), part.first, part.origin
    for own, begin, end in layers.strips(part.first[0], part.first[0] + part.shape[0]):
        a, b = np.searchsorted(part.nodes, [begin, end]).tolist()
        _write_nodes(part.nodes[a:b], grid, own.place, begin, height, off)
    return height, off


_Grid = tuple[IntArray, FloatArray, tuple[int, float], tuple[int, int], FloatArray]
"""Cell and height of all nodes, columns and width of cells, first cell of a part, and its corner [m]."""


@njit(cache=True, nogil=True)
def _write_nodes(
    nodes: IntArray, grid: _Grid, place: FloatArray, first: int, height: Float32Array, off: Float32Array
) -> None:
    """See `_nodes_at`: of nodes of a strip, whose `first` one has the first `place`."""
    cell, heights, (ny, width), (x, y), origin = grid
    for node in nodes:
        i, j = cell[node] // ny - x, cell[node] % ny - y
        height[i, j] = heights[node]
        off[i, j, 0] = place[node - first, 0] - origin[0] - (i + 0.5) * width
        off[i, j, 1] = place[node - first, 1] - origin[1] - (j + 0.5) * width


def without_outliers(surface: HeightMap, most: float) -> HeightMap:
    """Cells that are off the median of their neighbourhood by `most` [m] at most take it if they are off it alone.

    A cell that fewer than three of its neighbours are with, nearer to it than to the median, is no corner of a step.
    Beside empty cells the median of a slope is off by a cell's rise; there the middles of two opposite ones count, too.
    """
    if most == 0.0:
        return surface
    around = neighbourhood(surface)
    median = smoothed(surface)
    own = surface.height.astype(np.float64)
    middles = np.where(np.isnan(around).any(axis=0), 0.5 * (around[:4] + around[:4:-1]), np.nan)
    told = np.concatenate([around, middles])
    with_it = (np.abs(told - own) < np.abs(told - median)).sum(axis=0) - (own != median)  # itself is one of the nine
    alone = (with_it < 3) & (np.abs(own - median) <= most)
    return HeightMap(surface.origin, surface.cell_width, np.where(alone, median, own).astype(np.float32), surface.state)

"""Points with nothing beside them: reflections."""

from __future__ import annotations

import numpy as np
from numba import njit

from gpdf_service.fields.threads import run_chunked
from gpdf_service.tiles.columns import by_cell, compacted
from gpdf_service.tiles.rows import bounds_of
from gpdf_service.types import BoolArray, FloatArray, IntArray


def find_strays(points: FloatArray, width: float) -> BoolArray:
    """Which points (n, 3) have no other in their voxel of `width` [m] or in the 26 around it, shape (n,)."""
    stray = np.zeros(len(points), dtype=bool)
    if len(points) == 0:
        return stray
    low, high = (np.floor(corner / width).astype(np.int64) for corner in bounds_of(points))
    nx, ny = (int(n) for n in high - low + 1)
    cell = np.empty(len(points), np.int64)
    run_chunked(lambda a, b: _write_columns(points[a:b], width, low, ny, cell[a:b]), len(points))
    cell, count, held = compacted(cell, nx * ny)
    start, order = by_cell(cell, count)
    level = np.empty(len(points))
    run_chunked(lambda a, b: _write_levels(points, order[a:b], width, level[a:b]), len(points))
    columns = start, order, level, held
    run_chunked(lambda a, b: _strays_range(columns, (nx, ny), a, b, stray), count)
    return stray


@njit(cache=True, nogil=True)
def _write_columns(points: FloatArray, width: float, low: IntArray, ny: int, cell: IntArray) -> None:
    for i in range(len(points)):  # voxels are counted from the frame's origin, so that a part of a cloud has the same
        x, y = int(np.floor(points[i, 0] / width)), int(np.floor(points[i, 1] / width))
        cell[i] = (x - low[0]) * ny + y - low[1]


@njit(cache=True, nogil=True)
def _write_levels(points: FloatArray, order: IntArray, width: float, level: FloatArray) -> None:
    for i in range(len(order)):
        level[i] = np.floor(points[order[i], 2] / width)


@njit(cache=True, nogil=True)
def _strays_range(
    columns: tuple[IntArray, IntArray, FloatArray, IntArray],
    shape: tuple[int, int],
    begin: int,
    end: int,
    stray: BoolArray,
) -> None:
    """Nearly every point finds another in its own column after a few looks. Columns are `held` as by `compacted`."""
    (start, order, level, held), (nx, ny) = columns, shape
    for own in range(begin, end):
        column = held[own] if len(held) else own
        for i in range(start[own], start[own + 1]):
            if _beside(level, i + 1, start[own + 1], level[i]) or _beside(level, start[own], i, level[i]):
                continue
            alone = True
            for x in range(max(column // ny - 1, 0), min(column // ny + 2, nx)):
                for y in range(max(column % ny - 1, 0), min(column % ny + 2, ny)):
                    c = x * ny + y
                    if len(held):
                        at = int(np.searchsorted(held, c))
                        if at == len(held) or held[at] != c:
                            continue
                        c = at
                    alone = alone and (c == own or not _beside(level, start[c], start[c + 1], level[i]))
            stray[order[i]] = alone


@njit(cache=True, nogil=True)
def _beside(level: FloatArray, begin: int, end: int, own: float) -> bool:
    while begin < end and abs(level[begin] - own) > 1.0:
        begin += 1
    return begin < end

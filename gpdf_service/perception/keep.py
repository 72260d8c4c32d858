"""Levels as named arrays, for a file that holds their cloud as well: of the points on them only which these are."""

from __future__ import annotations

from collections import ChainMap
from dataclasses import dataclass

import numpy as np
from numba import njit

from gpdf_service.errors import SceneFileError
from gpdf_service.fields.threads import run_parallel
from gpdf_service.ground import GroundLimits, Levels, ObstacleKind
from gpdf_service.perception.others import in_order
from gpdf_service.store import Arrays, flatten, restore
from gpdf_service.tiles.columns import by_cell
from gpdf_service.tiles.rows import chosen_rows
from gpdf_service.tiles.surface import HeightMap, cells_within
from gpdf_service.types import BoolArray, FloatArray, IntArray

_LEVEL, _EDGES = "levels/levels/{}", "/edges"
_POINTS, _ROWS, _DOWN, _LIMITS = (f"{_LEVEL}/{name}" for name in ("other_points", "other_rows", "down", "limits"))


@dataclass(frozen=True, slots=True)
class _Ground:
    """What of a level says the order of its points."""

    surface: HeightMap


def levels_to_arrays(levels: Levels, points: FloatArray, max_step: float) -> Arrays:
    """All that `levels_from_arrays` needs beside the cloud, `points` (n, 3). Of a cured one points are others.

    Points of ground over head that nobody saw from below may be down by `max_step` [m]: see `find_others`.
    """
    made = {name: each for name, each in flatten(levels, "levels").items() if _EDGES not in name}
    ordered: dict[tuple[object, ...], tuple[IntArray, IntArray]] = {}
    for i, level in enumerate(levels.levels):
        made |= flatten(level.limits, _LIMITS.format(i))  # which tell the edges, too
        grid = level.surface
        key = *grid.origin.tolist(), grid.cell_width, *grid.state.shape
        if key not in ordered:
            ordered[key] = by_cell(cells_within(points, grid), grid.state.size + 1)
        chosen, down = (np.zeros(len(each), dtype=bool) for each in (points, level.other_points))
        if _find(points, *ordered[key], level.other_points, max_step, chosen, down):
            del made[_POINTS.format(i)]
            made |= {_ROWS.format(i): chosen, _DOWN.format(i): down}
    return made


def levels_from_arrays(arrays: Arrays, points: FloatArray, max_step: float) -> Levels:
    """The levels that `levels_to_arrays` took apart, of the same cloud and `max_step` [m].

    Raises:
        SceneFileError: an array is missing.
    """
    grids = enumerate(restore(tuple[_Ground, ...], arrays, "levels/levels"))

    def one(numbered: tuple[int, _Ground]) -> Arrays:
        i, ground = numbered
        limits = restore(GroundLimits, arrays, _LIMITS.format(i))
        found = flatten(_edges(ground.surface, limits), _LEVEL.format(i) + _EDGES)
        if (chosen := arrays.get(_ROWS.format(i))) is None:
            return found
        down = arrays[_DOWN.format(i)]
        if chosen.shape != (len(points),) or down.shape != (np.count_nonzero(chosen),):
            raise SceneFileError("scene file", "it marks points that are not there", "Build the scene again.")
        others = in_order(chosen_rows(points, chosen), ground.surface)[0]
        others[down, 2] -= max_step
        return found | {_POINTS.format(i): others}

    levels: Levels = restore(Levels, ChainMap(*run_parallel(one, grids), arrays), "levels")
    return levels


def _edges(surface: HeightMap, limits: GroundLimits) -> tuple[BoolArray, BoolArray]:
    """The edges of a level that has these limits: what no limit is at is guarded."""
    made = np.ones(surface.state.shape, dtype=bool), np.zeros(surface.state.shape, dtype=bool)
    for each, kind in zip(made, (ObstacleKind.UNKNOWN, ObstacleKind.MATERIAL), strict=True):
        x, y, _ = surface.cells(limits.points[limits.kind == kind])
        each[x, y] = kind == ObstacleKind.MATERIAL
    return made


@njit(cache=True, nogil=True)
def _find(
    points: FloatArray,
    start: IntArray,
    order: IntArray,
    others: FloatArray,
    max_step: float,
    chosen: BoolArray,
    down: BoolArray,
) -> bool:
    """Mark the rows that the `others` are, which lie in the order of their cells; whether all are there.

    Args:
        points: Shape (n, 3) [m].
        start: Where each cell begins in the order.
        order: The rows of the points by cell.
        others: Shape (m, 3) [m].
        max_step: By which some of the others are down [m].
        chosen: Where rows are marked, shape (n,).
        down: Where the others are that are down, shape (m,).
    """
    found = 0
    for row in order[: start[-2]]:
        if found == len(others):
            break
        x, y, z = points[row]
        u, v, w = others[found]
        if x == u and y == v and (z == w or z - max_step == w):
            chosen[row], down[found], found = True, z != w, found + 1
    return found == len(others)

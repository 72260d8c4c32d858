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
_POINTS, _ROWS, _LIMITS = (f"{_LEVEL}/{name}" for name in ("other_points", "other_rows", "limits"))


@dataclass(frozen=True, slots=True)
class _Ground:
    """What of a level says the order of its points."""

    surface: HeightMap


def levels_to_arrays(levels: Levels, points: FloatArray) -> Arrays:
    """All that `levels_from_arrays` needs beside the cloud, `points` (n, 3). Of a cured one points are others."""
    made = {name: each for name, each in flatten(levels, "levels").items() if _EDGES not in name}
    ordered: dict[tuple[object, ...], tuple[IntArray, IntArray]] = {}
    for i, level in enumerate(levels.levels):
        made |= flatten(level.limits, _LIMITS.format(i))  # which tell the edges, too
        grid = level.surface
        key = *grid.origin.tolist(), grid.cell_width, *grid.state.shape
        if key not in ordered:
            ordered[key] = by_cell(cells_within(points, grid), grid.state.size + 1)
        chosen = np.zeros(len(points), dtype=bool)
        if _find(points, *ordered[key], level.other_points, chosen):
            del made[_POINTS.format(i)]
            made[_ROWS.format(i)] = chosen
    return made


def levels_from_arrays(arrays: Arrays, points: FloatArray) -> Levels:
    """The levels that `levels_to_arrays` took apart, of the same cloud.

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
        if chosen.shape != (len(points),):
            raise SceneFileError("scene file", "it marks points that are not there", "Build the scene again.")
        return found | {_POINTS.format(i): in_order(chosen_rows(points, chosen), ground.surface)[0]}

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
def _find(points: FloatArray, start: IntArray, order: IntArray, others: FloatArray, chosen: BoolArray) -> bool:
    """Mark the rows that the `others` are, in the `order` of cells, which `start` there; whether all are there."""
    found = 0
    for row in order[: start[-2]]:
        x, y, z = points[row]
        if found < len(others) and x == others[found, 0] and y == others[found, 1] and z == others[found, 2]:
            chosen[row], found = True, found + 1
    return found == len(others)

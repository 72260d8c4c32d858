"""Ways over poses (x, y, θ) of a body that must face the right way to pass: forward, aslant, and turns on the spot.

Poses lie on a grid, and waves go out over them from the goal; the way that they find is proven, motion by motion. A way
costs as far as the body's end goes on it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import atan2, ceil, nan, pi
from typing import NamedTuple

import numpy as np
from numba import njit

from gpdf_service.search.places import Places, is_motion_clear, turned
from gpdf_service.search.poses import TURNS, Field, Grid, field_of, follow, free_poses, is_reached, mend, row_of, spread
from gpdf_service.tiles import HeightMap
from gpdf_service.types import FloatArray, IntArray

CELL_SHARES = 0.5, 0.25
"""[-] Grid width over the discs' radius: a gap is found that leaves the discs so much of it on either side."""
COARSEST = 1.0
"""[-] The same where there is time, or memory, for nothing finer."""
DETOURS = (1.3, 2.0), (2.0, 30.0)
"""[-], [m] Ways are looked for that lie within so many times the way of one disc and so much more."""
NEARLY = 3.0
"""[-] Of two grids of which one is less than so many times as large, only that one is searched."""
MOST_POSES = 2**26
"""Poses in a grid, a byte each: of Spot a place of 29 × 29 m, in a second."""
POSES_PER_SECOND = 50_000_000
"""Most poses by seconds to a deadline: what an office takes that is searched to its end."""
MOST_TRIES = 8
"""Ways that are looked for where what was found does not prove clear: poses are told to a millimetre or two."""
_ASLANT = atan2(1.0, 2.0) + 1e-6
"""[rad] A body goes at most this much aslant: between two of the 16 directions of the grid, it can go along either."""
_STEP_COSTS = {1: 4, 2: 6, 5: 9}
"""Costs of steps by the square of their length in cells: four a cell, to 6 %; a turn moves an end by a cell."""


@dataclass(frozen=True, slots=True)
class PoseSearch:
    """Poses from start to goal, shape (n, 3), θ unwrapped; if `reached` is false, one: where it does not get on.

    Then `given_up` says that there may be a way, which was not found among as many poses as might be looked at.
    """

    poses: FloatArray
    reached: bool
    given_up: bool = False


class _Body(NamedTuple):
    """Discs ahead of the centre (k,) [m], and their least distance from any obstacle [m]."""

    offsets: FloatArray
    radius: float


def find_poses(
    obstacles: Places,
    surface: HeightMap,
    way: FloatArray,
    facing: tuple[float | None, float | None],
    offsets: FloatArray,
    radius: float,
    *,
    most: int = MOST_POSES,
) -> PoseSearch:
    """Find a way for a body of discs, beside the `way` of one disc from start to goal, shape (n, 2) [m].

    Its discs lie at `offsets` ahead of its centre [m], ascending, the same on either side, two at least, and their
    centres keep the `radius` from all obstacles [m]. At its ends it faces as asked [rad]; None leaves it free. So many
    poses are looked at, at `most`.
    """
    body = _Body(offsets, radius)
    found = PoseSearch(np.append(way[0], facing[0] or 0.0)[None], reached=False, given_up=True)
    grids, whole = _grids(surface, way, body, most)
    for grid in grids:
        found = _find(obstacles, surface, grid, way, facing, body)
        if found.reached:
            return found
    return replace(found, given_up=found.given_up or not whole)


def _grids(surface: HeightMap, way: FloatArray, body: _Body, most: int) -> tuple[list[Grid], bool]:
    """Grids around a way that hold `most` poses each, ever larger and finer ones; and whether the last is the finest.

    A grid that is nearly as large as the next one of the same cells is left out.
    """
    every = [[_grid(surface, way, body, detour, share * body.radius) for share in CELL_SHARES] for detour in DETOURS]
    near, far = ([grid for grid in grids if _poses_in(grid) <= most] for grids in every)
    near = [one for one, other in zip(near, every[-1], strict=False) if NEARLY * _poses_in(one) < _poses_in(other)]
    if not near + far:
        last = _grid(surface, way, body, DETOURS[0], COARSEST * body.radius)
        return [last] if _poses_in(last) <= most else [], False
    return near + far, len(far) == len(CELL_SHARES)


def _poses_in(grid: Grid) -> int:
    return grid.shape[0] * grid.shape[1] * grid.turns


def _grid(surface: HeightMap, way: FloatArray, body: _Body, detour: tuple[float, float], width: float) -> Grid:
    """The grid that holds all detours from a way, as far as the ground goes, with the start on one of its cells."""
    length = float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum())
    ends = np.stack([way[0], way[-1]])
    low, high = surface.origin, surface.origin + surface.cell_width * np.array(surface.height.shape)
    beyond = 0.5 * (detour[0] * length + detour[1] - np.abs(ends[1] - ends[0]))  # an ellipse lies within
    first = np.floor((np.maximum(ends.min(axis=0) - beyond, low) - way[0]) / width).astype(np.int64)
    last = np.ceil((np.minimum(ends.max(axis=0) + beyond, high) - way[0]) / width).astype(np.int64)
    turns = 8 * ceil(2.0 * pi * body.offsets[-1] / width / 8.0)  # an end then goes a cell in a turn to the next one
    nx, ny = (int(n) for n in last - first + 1)
    return Grid(way[0] + first * width, width, (nx, ny), turns)


def _find(
    obstacles: Places,
    surface: HeightMap,
    grid: Grid,
    way: FloatArray,
    facing: tuple[float | None, float | None],
    body: _Body,
) -> PoseSearch:
    """See `find_poses`."""
    free, moves = free_poses(obstacles, surface.arrays, grid, *body), _moves(grid)
    begin, end = (nan if angle is None else angle for angle in facing)
    starts, goals = _starts(obstacles, grid, way[0], begin, body), _goals(obstacles, grid, way[-1], end, body)
    field = field_of(free, grid.shape[1])
    mend(field, np.concatenate([starts, goals]), free=True)  # proven, and not by the grid
    for _ in range(MOST_TRIES):
        start = spread(field, moves, goals, starts)
        if start < 0:
            return PoseSearch(_stuck(field, grid, way)[None], reached=False)
        states = follow(field, moves, starts[start])
        poses = np.column_stack([grid.origin + states[:, 1:] * grid.width, states[:, 0] * 2.0 * pi / grid.turns])
        poses[:, 2] = np.unwrap(poses[:, 2])
        touching = _touching(obstacles, poses, body)
        if len(touching) == 0:
            return PoseSearch(_between(poses, way, facing), reached=True)
        mend(field, states[touching], free=False)
    return PoseSearch(poses[touching[:1]], reached=False, given_up=True)


def _between(poses: FloatArray, way: FloatArray, facing: tuple[float | None, float | None]) -> FloatArray:
    """From start to goal by way of the grid's poses, facing as asked."""
    begin = turned(poses[0], poses[0, 2] if facing[0] is None else facing[0])
    end = np.append(way[-1], poses[-1, 2])
    last = turned(end, end[2] if facing[1] is None else facing[1])
    return moving(np.concatenate([begin[None], poses, end[None], last[None]]))


def moving(poses: FloatArray) -> FloatArray:
    """The poses without those that repeat the one before; two at least."""
    keep = np.concatenate([[True], np.abs(np.diff(poses, axis=0)).max(axis=1) > 1e-9])
    keep[-1] |= not keep[1:].any()
    kept: FloatArray = poses[keep]
    return kept


def _moves(grid: Grid) -> IntArray:
    """Turns to the next headings, forward along one of 16 directions, aslant where none is straight ahead."""
    steps = [(i, j) for i in range(-2, 3) for j in range(-2, 3) if i * i + j * j in _STEP_COSTS]
    made = np.zeros((grid.turns, TURNS + len(steps), 4), np.int64)
    made[:, :TURNS] = (0, 0, -1, _STEP_COSTS[1]), (0, 0, 1, _STEP_COSTS[1])
    most = TURNS
    for h in range(grid.turns):
        used = TURNS
        for i, j in steps:
            aslant = (atan2(j, i) - 2.0 * pi * h / grid.turns + pi) % (2.0 * pi) - pi
            if abs(aslant) <= _ASLANT:
                made[h, used] = i, j, 0, _STEP_COSTS[i * i + j * j]
                used += 1
        most = max(most, used)
    return np.ascontiguousarray(made[:, :most])


@njit(cache=True, nogil=True)
def _starts(obstacles: Places, grid: Grid, place: FloatArray, facing: float, body: _Body) -> IntArray:
    """Poses (heading, i, j) at the start that the body gets to from how it faces there, NaN for any; shape (k, 3)."""
    made, used = np.empty((grid.turns, 3), np.int64), 0
    made[:, 1], made[:, 2] = (
        round((place[0] - grid.origin[0]) / grid.width),
        round((place[1] - grid.origin[1]) / grid.width),
    )
    to = np.array([place[0], place[1], 0.0])
    for h in range(grid.turns):
        to[2] = 2.0 * pi * h / grid.turns
        begin = to if np.isnan(facing) else turned(to, facing)
        near = abs(begin[2] - to[2]) <= 2.0 * pi / grid.turns
        if near and is_motion_clear(obstacles, begin, to, body.offsets, body.radius):
            made[used, 0] = h
            used += 1
    return made[:used]


@njit(cache=True, nogil=True)
def _goals(obstacles: Places, grid: Grid, goal: FloatArray, facing: float, body: _Body) -> IntArray:
    """Poses (heading, i, j) beside the goal from which the body gets there as it is, and then turns, shape (k, 3)."""
    u, v = int((goal[0] - grid.origin[0]) / grid.width), int((goal[1] - grid.origin[1]) / grid.width)
    made, used = np.empty((4 * grid.turns, 3), np.int64), 0
    for h in range(grid.turns):
        there = np.array([goal[0], goal[1], 2.0 * pi * h / grid.turns])
        last = there if np.isnan(facing) else turned(there, facing)
        if not is_motion_clear(obstacles, there, last, body.offsets, body.radius):
            continue
        for i in range(u, min(u + 2, grid.shape[0])):
            for j in range(v, min(v + 2, grid.shape[1])):
                pose = np.array([grid.origin[0] + i * grid.width, grid.origin[1] + j * grid.width, there[2]])
                if is_motion_clear(obstacles, pose, there, body.offsets, body.radius):
                    made[used] = h, i, j
                    used += 1
    return made[:used]


@njit(cache=True, nogil=True)
def _touching(obstacles: Places, poses: FloatArray, body: _Body) -> IntArray:
    """Rows of the poses that are not got to clear from the one before."""
    rows = [
        n
        for n in range(1, len(poses))
        if not is_motion_clear(obstacles, poses[n - 1], poses[n], body.offsets, body.radius)
    ]
    return np.array(rows)


@njit(cache=True, nogil=True)
def _stuck(field: Field, grid: Grid, way: FloatArray) -> FloatArray:
    """The place of one disc's way up to which the body does not get: the first from which it gets to the goal."""
    for n in range(len(way) - 1):
        count = ceil(np.sqrt(((way[n + 1] - way[n]) ** 2).sum()) / grid.width)
        for k in range(count):
            place = way[n] + k / count * (way[n + 1] - way[n])
            i, j = round((place[0] - grid.origin[0]) / grid.width), round((place[1] - grid.origin[1]) / grid.width)
            for h in range(grid.turns):
                if is_reached(field, row_of(field, np.array([h, i, j]))):
                    return np.array([place[0], place[1], 2.0 * pi * h / grid.turns])
    return np.array([way[-1, 0], way[-1, 1], 0.0])

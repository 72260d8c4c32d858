"""A* over poses (x, y, θ) of a body that must face the right way to pass: forward, aslant, and turns on the spot.

Poses lie on a grid. A motion is allowed if it is proven clear for every disc. A way costs as far as the body's end goes
on it, up to twice that where there is little room; a flood in plan from the goal is the guide.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from math import atan2, ceil, hypot, pi
from typing import NamedTuple

import numpy as np
from numba import njit

from gpdf_service.fields.tree import Scratch, make_scratch, place_of
from gpdf_service.perception import HeightMap
from gpdf_service.perception.surface import Cells, is_known
from gpdf_service.search.motion import disc_distance, is_motion_clear, turned
from gpdf_service.search.places import Places, distance_at
from gpdf_service.types import FloatArray, IntArray

CELL_SHARE = 0.25
"""[-] Grid width over the discs' radius: a gap is found that leaves the discs a quarter of it on either side."""
GREED = 2.0
"""[-] How much more the guide counts than it says: it knows nothing of turns, and what is found is bent anyway."""
DETOUR = (2.0, 30.0)
"""[-], [m] Ways are looked for that one disc goes in twice its shortest one and 30 m more: out of a house and back."""
MOST_POSES = 2_000_000
"""Poses that a search may look at: some five seconds; a room of 10 m has eight millions, and few are looked at."""
SHARES = (0.03, 0.2, 1.0)
"""[-] Of the poses that may be looked at, in each try from either end."""
POSES_PER_SECOND = 60_000
"""Most poses by seconds to a deadline: two hundred thousand are looked at in a second, in all tries together."""
_ASLANT = atan2(1.0, 2.0) + 1e-6
"""[rad] A body goes at most this much aslant: between two of the 16 directions of the grid, it can go along either."""
_FIRST_CELLS = 4096
"""Cells that the tables of a search begin with; they double."""


@dataclass(frozen=True, slots=True)
class PoseSearch:
    """Poses from start to goal, shape (n, 3), θ unwrapped; if `reached` is false, one: the nearest to the goal.

    Then `given_up` says that there may be a way, which was not found among as many poses as might be looked at.
    """

    poses: FloatArray
    reached: bool
    given_up: bool = False


class _Body(NamedTuple):
    """Discs ahead of the centre (k,) [m], and their least distance from any obstacle [m]."""

    offsets: FloatArray
    radius: float


class _Grid(NamedTuple):
    """Place of cell (0, 0) [m], width of the cells [m], angle between two headings [rad]."""

    origin: FloatArray
    width: float
    turn: float


class _Moves(NamedTuple):
    """From each heading: change of (i, j, heading), (h, m, 3); how far an end moves, and its cost (h, m) [m]."""

    change: IntArray
    moved: FloatArray
    cost: FloatArray


def find_poses(
    obstacles: Places,
    surface: HeightMap,
    start: FloatArray,
    goal: FloatArray,
    offsets: FloatArray,
    radius: float,
    *,
    most: int = MOST_POSES,
) -> PoseSearch:
    """Find a way for a body of discs.

    What drives forward from start to goal drives, seen backward, from goal to start with its other end ahead. So both
    are tried with ever more poses: a pocket that cannot be left, at whichever end, is soon known.

    Args:
        obstacles: All obstacle places of the body in plan [m].
        surface: The level's ground.
        start: (x, y), or (x, y, θ) where the body must begin facing θ.
        goal: The same of the end.
        offsets: Where the discs are, ahead of the body's centre [m], ascending, two at least.
        radius: Least distance of a disc's centre from any obstacle [m].
        most: Poses that may be looked at.
    """
    for share in SHARES:
        for begin, end, back in ((start, goal, False), (_about(goal), _about(start), True)):
            found = _find(obstacles, surface, begin, end, _Body(offsets, radius), int(share * most))
            if not found.given_up:
                return PoseSearch(_about(found.poses[::-1]), found.reached) if back else found
    return found


def _about(poses: FloatArray) -> FloatArray:
    """Turned by half a turn, where there is a heading."""
    made: FloatArray = poses + np.array([0.0, 0.0, pi])[: poses.shape[-1]]
    return made


def _find(
    obstacles: Places, surface: HeightMap, start: FloatArray, goal: FloatArray, body: _Body, most: int
) -> PoseSearch:
    """See `find_poses`."""
    offsets, radius = body
    width = CELL_SHARE * radius
    turns = 8 * ceil(2.0 * pi * offsets[-1] / width / 8.0)  # an end then goes one cell in a turn to the next heading
    first = np.ceil((start[:2] - surface.origin) / width).astype(np.int64)
    extent = surface.cell_width * np.array(surface.height.shape)
    shape = first + np.ceil((surface.origin + extent - start[:2]) / width).astype(np.int64) + 1
    grid = _Grid(start[:2] - first * width, width, 2.0 * pi / turns)
    guide = _flood(obstacles, surface.arrays, grid, (int(shape[0]), int(shape[1])), radius, first, goal[:2])
    away = _turns_to(obstacles, np.append(start[:2], start[2:]), grid.turn, body)
    states, reached, given_up = _search(obstacles, guide, grid, _moves(grid, body), first, away, goal, body, most)
    poses = np.column_stack([grid.origin + states[:, :2] * width, states[:, 2] * grid.turn])
    if not reached:
        return PoseSearch(poses[-1:] if len(poses) else np.append(start[:2], 0.0)[None], False, given_up)
    begin, end = np.append(start, poses[0, len(start) :])[None], np.append(goal[:2], poses[-1, 2])[None]
    last = np.append(goal[:2], goal[2] if len(goal) == 3 else poses[-1, 2])[None]
    made = np.concatenate([begin, poses, end, last])
    made[:, 2] = np.unwrap(made[:, 2])
    return PoseSearch(moving(made), True)


def moving(poses: FloatArray) -> FloatArray:
    """The poses without those that repeat the one before; two at least."""
    keep = np.concatenate([[True], np.abs(np.diff(poses, axis=0)).max(axis=1) > 1e-9])
    keep[-1] |= not keep[1:].any()
    kept: FloatArray = poses[keep]
    return kept


def _moves(grid: _Grid, body: _Body) -> _Moves:
    """Forward along one of 16 directions, aslant where none is straight ahead, and turns to the next headings."""
    steps = [(i, j) for i in range(-2, 3) for j in range(-2, 3) if i * i + j * j in (1, 2, 5)]
    change = np.array([(i, j, 0) for i, j in steps] + [(0, 0, -1), (0, 0, 1)])
    moved = np.hypot(*change[:, :2].T) * grid.width + np.abs(change[:, 2]) * grid.turn * body.offsets[-1]
    heading = grid.turn * np.arange(round(2.0 * pi / grid.turn))[:, None]
    aslant = np.abs((np.arctan2(change[:, 1], change[:, 0]) - heading + pi) % (2.0 * pi) - pi)
    aslant = np.where(change[:, 2] == 0, aslant, 0.0)
    cost = np.where(aslant <= _ASLANT, moved / np.cos(np.minimum(aslant, _ASLANT)), np.inf)
    count = int(np.isfinite(cost).sum(axis=1).max())
    order = np.argsort(cost, axis=1, kind="stable")[:, :count]
    return _Moves(
        change[order],
        np.broadcast_to(moved, cost.shape)[np.arange(len(cost))[:, None], order],
        np.take_along_axis(cost, order, axis=1),
    )


def _turns_to(obstacles: Places, start: FloatArray, turn: float, body: _Body) -> FloatArray:
    """How far an end goes from the start to each heading [m]; inf where the body does not fit, or is too far."""
    headings = turn * np.arange(round(2.0 * pi / turn))
    away = np.full(len(headings), np.inf)
    for h, heading in enumerate(headings):
        to = np.append(start[:2], heading)
        begin = to if len(start) == 2 else turned(to, start[2])
        angle = abs(begin[2] - heading)
        if angle <= turn and is_motion_clear(obstacles, begin, to, body.offsets, body.radius):
            away[h] = angle * body.offsets[-1]
    return away


@njit(cache=True, nogil=True)
def _weight(room: float, radius: float) -> float:
    """What a way costs for its length, as in the graph: twice where the body brushes past."""
    return 1.0 + min(1.0, max(0.0, 1.0 - room / radius))


@njit(cache=True, nogil=True)
def _flood(
    obstacles: Places,
    ground: Cells,
    grid: _Grid,
    shape: tuple[int, int],
    radius: float,
    start: IntArray,
    goal: FloatArray,
) -> FloatArray:
    """Cost of the way of a single disc from each cell to the goal [m]; inf where there is none, or too long a one."""
    guide, room = np.full(shape, np.inf), np.full(shape, np.nan)
    i, j = round((goal[0] - grid.origin[0]) / grid.width), round((goal[1] - grid.origin[1]) / grid.width)
    guide[i, j] = 0.0
    frontier = [(0.0, i, j)]
    while len(frontier) > 0:
        cost, i, j = heapq.heappop(frontier)
        if cost > DETOUR[0] * guide[start[0], start[1]] + DETOUR[1]:
            break
        if cost > guide[i, j]:
            continue
        for a in range(max(i - 1, 0), min(i + 2, shape[0])):
            for b in range(max(j - 1, 0), min(j + 2, shape[1])):
                if np.isnan(room[a, b]):
                    room[a, b] = _room_on(obstacles, ground, grid.origin + grid.width * np.array([a, b])) - radius
                further = cost + grid.width * hypot(float(a - i), float(b - j)) * _weight(room[a, b], radius)
                if room[a, b] >= 0.0 and further < guide[a, b]:
                    guide[a, b] = further
                    heapq.heappush(frontier, (further, a, b))
    return guide


@njit(cache=True, nogil=True)
def _room_on(obstacles: Places, ground: Cells, place: FloatArray) -> float:
    """Distance from a place in plan to the nearest obstacle [m]; 0 where no ground is known."""
    known = is_known(ground, place[0], place[1])
    return float(distance_at(obstacles, place_of(place), make_scratch())) if known else 0.0


@njit(cache=True, nogil=True)
def _search(
    obstacles: Places,
    guide: FloatArray,
    grid: _Grid,
    moves: _Moves,
    first: IntArray,
    away: FloatArray,
    goal: FloatArray,
    body: _Body,
    most: int,
) -> tuple[IntArray, bool, bool]:
    """A* from the cell `first`: states (i, j, heading), shape (n, 3), if the last reaches the goal, if given up."""
    turns = len(away)
    row = np.full(guide.shape, -1, np.int64)  # cells are given rows as they are touched
    row[first[0], first[1]] = 0
    cells, count = np.zeros((_FIRST_CELLS, 2), np.int64), 1
    cells[0] = first
    cost, room = np.full((_FIRST_CELLS, turns), np.inf), np.full((_FIRST_CELLS, turns), np.nan)
    came_from = np.full((_FIRST_CELLS, turns), -1)
    cost[0] = away
    frontier = [(away[h] + GREED * guide[first[0], first[1]], h) for h in range(turns) if away[h] < np.inf]
    heapq.heapify(frontier)
    best, nearest, reached, looked = -1, np.inf, False, 0
    a, b, scratch = np.empty(3), np.empty(3), make_scratch()
    while len(frontier) > 0 and looked < most and not reached:
        estimate, state = heapq.heappop(frontier)
        s, h = state // turns, state % turns
        i, j = cells[s]
        if estimate > cost[s, h] + GREED * guide[i, j]:
            continue
        looked += 1
        a[0], a[1], a[2] = grid.origin[0] + i * grid.width, grid.origin[1] + j * grid.width, h * grid.turn
        if guide[i, j] < nearest:
            best, nearest = state, guide[i, j]
        if _arrives(obstacles, a, goal, grid.width, body):
            best, reached = state, True
            continue
        here = _room(obstacles, a, body, room[s], h, scratch)
        for m in range(moves.cost.shape[1]):
            u, v = i + moves.change[h, m, 0], j + moves.change[h, m, 1]
            if moves.cost[h, m] == np.inf or not (0 <= u < guide.shape[0] and 0 <= v < guide.shape[1]):
                continue
            if guide[u, v] == np.inf:
                continue
            if row[u, v] < 0:
                if count == len(cells):
                    cells, came_from = _doubled(cells, 0), _doubled(came_from, -1)
                    cost, room = _doubled(cost, np.inf), _doubled(room, np.nan)
                row[u, v], cells[count, 0], cells[count, 1], count = count, u, v, count + 1
            t, to = row[u, v], (h + moves.change[h, m, 2]) % turns
            if cost[s, h] + moves.cost[h, m] >= cost[t, to]:
                continue
            b[0], b[1] = grid.origin[0] + u * grid.width, grid.origin[1] + v * grid.width
            b[2] = (h + moves.change[h, m, 2]) * grid.turn
            there = _room(obstacles, b, body, room[t], to, scratch)
            further = cost[s, h] + moves.cost[h, m] * _weight(min(here, there), body.radius)
            if there < 0.0 or further >= cost[t, to]:
                continue
            if here + there < moves.moved[h, m] and not is_motion_clear(obstacles, a, b, body.offsets, body.radius):
                continue
            cost[t, to], came_from[t, to] = further, state
            heapq.heappush(frontier, (further + GREED * guide[u, v], t * turns + to))
    return _trace(came_from, cells, best), reached, looked >= most and not reached


@njit(cache=True, nogil=True)
def _room(obstacles: Places, pose: FloatArray, body: _Body, known: FloatArray, h: int, scratch: Scratch) -> float:
    """Room beside the body at a pose [m], negative where it does not fit; looked for once, then known[h]."""
    if np.isnan(known[h]):
        known[h] = np.inf
        for offset in body.offsets:
            known[h] = min(known[h], disc_distance(obstacles, pose, offset, scratch) - body.radius)
            if known[h] < 0.0:
                break
    return float(known[h])


@njit(cache=True, nogil=True)
def _arrives(obstacles: Places, pose: FloatArray, goal: FloatArray, width: float, body: _Body) -> bool:
    """Whether the body gets to the goal from a pose beside it: there as it is, then turned to where it must face."""
    if hypot(pose[0] - goal[0], pose[1] - goal[1]) > width:
        return False
    there = pose.copy()
    there[:2] = goal[:2]
    return is_motion_clear(obstacles, pose, there, body.offsets, body.radius) and (
        len(goal) == 2 or is_motion_clear(obstacles, there, turned(there, goal[2]), body.offsets, body.radius)
    )


@njit(cache=True, nogil=True)
def _doubled(values, fill):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """With as many rows again, of `fill`."""
    made = np.full((2 * values.shape[0], values.shape[1]), fill, values.dtype)
    made[: values.shape[0]] = values
    return made


@njit(cache=True, nogil=True)
def _trace(came_from: IntArray, cells: IntArray, state: int) -> IntArray:
    """States (i, j, heading) from the start to `state`, shape (n, 3); none for −1."""
    turns = came_from.shape[1]
    states = [0 for _ in range(0)]
    while state >= 0:
        states.append(state)
        state = came_from[state // turns, state % turns]
    made = np.empty((len(states), 3), np.int64)
    for k, state in enumerate(states[::-1]):
        made[k, :2], made[k, 2] = cells[state // turns], state % turns
    return made

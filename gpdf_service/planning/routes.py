"""From ends to seeds: the ways through the graph, string-pulled, the shortest first; or a way known from before."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numba import njit

from gpdf_service.planning.endpoints import Endpoint, Ends
from gpdf_service.planning.shape import is_joined, is_path_clear, shortcut
from gpdf_service.search import FreeSpace, find_path
from gpdf_service.search.motion import CENTRE, RESOLUTION
from gpdf_service.types import FloatArray

Leg = tuple[int, FloatArray]
"""A piece of the path on one level: level, places in plan (n, 2)."""
SAME = 1e-9
"""[m] Places nearer together are one."""
NEAR = 0.5
"""[m] A way known from before is taken up if the start and the goal are this near to it: less than a stride."""


@dataclass(frozen=True, slots=True)
class Route:
    """A seed for the optimiser: its pieces, the number of its goal, and whether it was known before."""

    legs: list[Leg]
    goal: int
    warm: bool = False

    @property
    def length(self) -> float:
        """Length in plan [m]."""
        return sum(float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum()) for _, path in self.legs)


def find_routes(space: FreeSpace, ends: Ends) -> list[Route]:
    """Ways to each goal that can be reached, through the via points, the shortest first; empty if there is none."""
    routes = []
    for number, goal in enumerate(ends.goals):
        stops = [ends.start, *ends.via, *([goal] if goal else [])]
        if goal is None or find_cut(space, stops) is not None:
            continue
        routes.append(Route([leg for a, b in pairwise(stops) for leg in _route(space, a, b)], number))
    return sorted(routes, key=lambda route: route.length)


def find_cut(space: FreeSpace, stops: list[Endpoint]) -> tuple[Endpoint, Endpoint] | None:
    """The first two stops between which the graph has no way; none if all is joined."""
    component = space.graph.component
    return next(((a, b) for a, b in pairwise(stops) if component[a.node] != component[b.node]), None)


def take_up(space: FreeSpace, ends: Ends, known: FloatArray) -> Route | None:
    """A way known from before, contact points (n, 3), from the start on; none where it is not near or not clear.

    It leads to the goal that is nearest to its end. Where the ground has another height now it is not taken up, nor
    where it is longer than any that a planner gives: work on it would know no bound.
    """
    goals = [(float(np.linalg.norm(goal.xy - known[-1, :2])), n) for n, goal in enumerate(ends.goals) if goal]
    far, number = min(goals)
    goal = ends.goals[number]
    if goal is None or far > NEAR:
        return None
    here = np.array([*ends.start.xy, _floor(space, ends.start)])
    gap = np.linalg.norm(known - here, axis=1)
    first = int(gap.argmin())
    if gap[first] > NEAR:
        return None
    inner = known[first + 1 : -1]
    if np.linalg.norm(np.diff(inner[:, :2], axis=0), axis=1).sum() > space.longest:
        return None
    heights = np.stack([surface.height_at(inner[:, :2]) for surface in space.surfaces])
    off = np.abs(np.where(np.isnan(heights), np.inf, heights) - inner[:, 2])
    if len(inner) and off.min(axis=0).max() > space.surfaces[0].cell_width:
        return None
    level = [ends.start.level, *off.argmin(axis=0).tolist(), goal.level]
    legs = _cut_by_level(np.vstack([ends.start.xy, inner[:, :2], goal.xy]), level)
    clear = all(is_path_clear(path, space.trees[on], _radius(space, on, path)) for on, path in legs)
    return Route(legs, number, warm=True) if clear else None


def _cut_by_level(path: FloatArray, level: list[int]) -> list[Leg]:
    cuts = [0, *(np.flatnonzero(np.diff(level)) + 1).tolist(), len(path)]
    return [(level[a], _distinct(path[max(a - 1, 0) : b])) for a, b in pairwise(cuts) if b - max(a - 1, 0) > 1]


def _floor(space: FreeSpace, end: Endpoint) -> float:
    return float(space.surfaces[end.level].height_at(end.xy[None])[0])


def _route(space: FreeSpace, start: Endpoint, goal: Endpoint) -> list[Leg]:
    """Straight, where that is clear; else as A* goes through the graph, cut where the way changes level, and pulled."""
    if start.level == goal.level and _is_straight(space, start, goal):
        return [(start.level, np.stack([start.xy, goal.xy]))]
    graph = space.graph
    edges = find_path(graph, start.node, goal.node)
    nodes = np.concatenate([[start.node], graph.other[edges]])
    places = np.empty((2 * len(nodes) + 1, 2))  # from centre to centre through where the leaves meet
    places[1::2], places[2:-1:2], places[0], places[-1] = graph.position[nodes], graph.via[edges], start.xy, goal.xy
    crossing = np.flatnonzero(np.diff(graph.level[nodes]))
    cuts = [0, *(2 * crossing + 2).tolist(), len(places) - 1]
    levels = graph.level[nodes[[0, *(crossing + 1).tolist()]]]
    return [
        _pull(space, int(on), _distinct(places[a : b + 1])) for on, (a, b) in zip(levels, pairwise(cuts), strict=True)
    ]


def _is_straight(space: FreeSpace, start: Endpoint, goal: Endpoint) -> bool:
    """Whether the body can go straight from start to goal, on one level: then no graph is asked."""
    obstacles, ground = space.trees[start.level], space.surfaces[start.level].arrays
    radius = _radius(space, start.level, np.stack([start.xy, goal.xy]))
    return bool(is_joined(start.xy, goal.xy, obstacles, radius, CENTRE, ground))


def _pull(space: FreeSpace, level: int, path: FloatArray) -> Leg:
    """A leg pulled straight."""
    return level, path[shortcut(path, space.trees[level], _radius(space, level, path), space.surfaces[level])]


@njit(cache=True, nogil=True)
def _distinct(path: FloatArray) -> FloatArray:
    """Without places that repeat the one before; two rows at least, the ends kept."""
    keep = np.ones(len(path), np.bool_)
    for i in range(1, len(path)):
        keep[i] = np.sqrt(((path[i] - path[i - 1]) ** 2).sum()) > SAME
    keep[-1] |= keep.sum() == 1
    return path[keep]


def _radius(space: FreeSpace, level: int, path: FloatArray) -> float:
    """The search's radius; the body's own where an end lies closer than the margin."""
    ends = space.clearance(level, path[[0, -1]])[0]
    return min(space.radius, max(space.reach, float(ends.min()) - RESOLUTION))

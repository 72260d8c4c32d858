"""The flat world that the paper's planar baselines see: obstacle points within the body's height, projected.

Uttsha et al. 2024, "Benchmarks": no steps, no slopes, one plane "that crosses the start location at the maximum height
of the system". Two things are done better than that, so that the comparison is fair: the body's radius is kept, and
ground that nobody has seen is not free.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gpdf_service.fields import Tree, build_tree, find_nearest
from gpdf_service.perception import HeightMap, ObstacleKind
from gpdf_service.planning.endpoints import SAME_GROUND, Endpoint, Refusal, find_endpoint
from gpdf_service.search import FreeSpace
from gpdf_service.types import FloatArray, Status

FAR = 1e6
"""[m] Where the one obstacle of an empty world stands: a tree needs a point, and nobody gets there."""
NO_NODE = -1
"""An end that is in no leaf of the planner's own graph; the baselines have their own."""


@dataclass(frozen=True, slots=True)
class FlatWorld:
    """One level as the planar baselines see it.

    Attributes:
        surface: Where ground is known; its height is not looked at.
        points: Obstacle points, and the rim of the known ground, in plan [m], shape (n, 2).
        tree: The same, for exact distances.
        radius: Kept from every one of them by the body's centre [m].
        start: In plan [m], shape (2,).
        goal: The same.
    """

    surface: HeightMap
    points: FloatArray
    tree: Tree
    radius: float
    start: FloatArray
    goal: FloatArray


def find_end(space: FreeSpace, place: FloatArray, name: str) -> Endpoint | Refusal:
    """Check a place as the planner does, but for the steps and slopes that a flat world has not."""
    found = find_endpoint(space, place, name)
    if isinstance(found, Endpoint) or found.status not in (Status.START_OCCUPIED, Status.GOAL_OCCUPIED):
        return found
    xy = np.ascontiguousarray(place[None, :2])
    for level, surface in enumerate(space.surfaces):
        height = float(surface.height_at(xy)[0])
        here = not np.isnan(height) and (len(place) == 2 or abs(height - place[2]) <= SAME_GROUND)
        if here and find_nearest(build_tree(_seen(space, level)), xy)[0][0] >= space.agent.radius:
            return Endpoint(xy[0], level, NO_NODE)
    return found


def flatten_world(space: FreeSpace, start: Endpoint, goal: Endpoint) -> FlatWorld:
    """Project the level of the start."""
    points = _seen(space, start.level)
    return FlatWorld(space.surfaces[start.level], points, build_tree(points), space.radius, start.xy, goal.xy)


def _seen(space: FreeSpace, level: int) -> FloatArray:
    """Of what stops the body on a level, all but steps and slopes, in plan [m], shape (n, 2)."""
    obstacles = space.obstacles[level]
    seen = (obstacles.kind == ObstacleKind.MATERIAL) | (obstacles.kind == ObstacleKind.UNKNOWN)
    return np.ascontiguousarray(obstacles.points[seen, :2]) if seen.any() else np.full((1, 2), FAR)

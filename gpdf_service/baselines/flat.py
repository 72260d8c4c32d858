"""The flat world that the paper's planar baselines see: obstacle points within the body's height, projected.

Uttsha et al. 2024, "Benchmarks": no steps, no slopes, one plane "that crosses the start location at the maximum height
of the system". Two things are done better than that, so that the comparison is fair: the body's radius is kept, and
ground that nobody has seen is not free.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gpdf_service.fields import Tree, build_tree
from gpdf_service.perception import HeightMap, ObstacleKind
from gpdf_service.planning.endpoints import Endpoint
from gpdf_service.search import FreeSpace
from gpdf_service.types import FloatArray

FAR = 1e6
"""[m] Where the one obstacle of an empty world stands: a tree needs a point, and nobody gets there."""


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


def flatten_world(space: FreeSpace, start: Endpoint, goal: Endpoint) -> FlatWorld:
    """Project the level of the start; of what stops the body, steps and slopes are not seen."""
    obstacles = space.obstacles[start.level]
    seen = (obstacles.kind == ObstacleKind.MATERIAL) | (obstacles.kind == ObstacleKind.UNKNOWN)
    points = np.ascontiguousarray(obstacles.points[seen, :2])
    if len(points) == 0:
        points = np.full((1, 2), FAR)
    return FlatWorld(space.surfaces[start.level], points, build_tree(points), space.radius, start.xy, goal.xy)

"""A* on the quadtree graph of the flat world, its path pulled straight."""

from __future__ import annotations

import numpy as np

from gpdf_service.baselines.flat import FlatWorld
from gpdf_service.planning.shape import shortcut
from gpdf_service.search.graph import find_path
from gpdf_service.search.places import is_clear
from gpdf_service.types import FloatArray

NEAREST_LEAVES = 32
"""Free leaves that are tried, the nearest first, to enter the graph from a place that lies in none."""


def find_astar_path(world: FlatWorld, start: FloatArray, goal: FloatArray) -> FloatArray | None:
    """Places in plan from start to goal, shape (n, 2) [m]; none if the graph does not join them."""
    if is_clear(world.tree, start, goal, world.radius):
        return np.array([start, goal])
    graph = world.graph
    a, b = _enter(world, start), _enter(world, goal)
    if a is None or b is None or graph.component[a] != graph.component[b]:
        return None
    edges = find_path(graph, a, b)
    through = np.stack([graph.via[edges], graph.position[graph.other[edges]]], axis=1).reshape(-1, 2)
    path = np.vstack([start, graph.position[a], through, goal])
    kept: FloatArray = path[shortcut(path, world.tree, world.radius, np.zeros(1), world.surface.arrays)]
    return kept


def _enter(world: FlatWorld, xy: FloatArray) -> int | None:
    """The nearest free leaf whose centre is reached from `xy` on a clear line."""
    leaves = world.leaves
    free = np.flatnonzero(leaves.free)
    center = leaves.center
    gap = np.linalg.norm(center[free] - xy, axis=1) - leaves.half_size[free]
    for leaf in free[np.argsort(gap)[:NEAREST_LEAVES]]:
        if is_clear(world.tree, xy, center[leaf], world.radius):
            return int(leaf)
    return None

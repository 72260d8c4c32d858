"""The flat world that the paper's planar baselines see: obstacle points within the body's height, projected.

Uttsha et al. 2024, "Benchmarks": no steps, no slopes, one plane "that crosses the start location at the maximum height
of the system". Two things are done better than that, so that the comparison is fair: the body's radius is kept, and
ground that nobody has seen is not free.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from weakref import WeakKeyDictionary

import numpy as np

from gpdf_service.baselines.occupancy import Occupancy, build_occupancy
from gpdf_service.fields import build_tree
from gpdf_service.ground import ObstacleKind, Obstacles
from gpdf_service.planning.endpoints import SAME_GROUND, Endpoint, Refusal, find_endpoint
from gpdf_service.scene import Scene
from gpdf_service.search.free_space import FreeSpace
from gpdf_service.search.graph import Graph, assemble, find_edges, price_pairs
from gpdf_service.search.places import Places, nearest_places
from gpdf_service.search.quadtree import Quadtree, build_quadtree
from gpdf_service.tiles import HeightMap
from gpdf_service.types import Agent, FloatArray, Status

FAR = 1e6
"""[m] Where the one obstacle of an empty world stands: a tree needs a point, and nobody gets there."""
_MADE: WeakKeyDictionary[Scene, tuple[Agent, tuple[FlatWorld, ...]]] = WeakKeyDictionary()
"""Of each scene, as long as it lives, what its last body's queries made: the planner's free space is kept, too."""
NO_NODE = -1
"""An end that is in no leaf of the planner's own graph; the baselines have their own."""


@dataclass(frozen=True)
class FlatWorld:
    """One level as the planar baselines see it; what they make of it is kept for the next query.

    Attributes:
        surface: Where ground is known; its height is not looked at.
        points: Obstacle points, and the rim of the known ground, in plan [m], shape (n, 2).
        radius: Kept from every one of them by the body's centre [m].
    """

    surface: HeightMap
    points: FloatArray
    radius: float

    @cached_property
    def tree(self) -> Places:
        """The points, for exact distances."""
        return Places(build_tree(self.points))

    @cached_property
    def leaves(self) -> Quadtree:
        """Free leaves of the quadtree."""
        return build_quadtree(self.surface, self.tree.standing, self.radius)

    @cached_property
    def graph(self) -> Graph:
        """The free leaves, joined."""
        leaves, center = self.leaves, self.leaves.center
        edges = find_edges(leaves, self.tree, self.radius)
        levels = np.zeros(len(leaves.size), dtype=np.int64)
        return assemble(center, levels, edges, price_pairs(center, leaves.clearance, edges, self.radius))

    @cached_property
    def occupancy(self) -> Occupancy:
        """The binary grid, inflated by the radius."""
        return build_occupancy(self.surface, self.points, self.radius)


def flat_worlds(scene: Scene, agent: Agent) -> tuple[FlatWorld, ...]:
    """The levels of a scene, each flat, made once for a scene and a body."""
    kept, worlds = _MADE.get(scene, (None, ()))
    if kept != agent:
        space = scene.free_space(agent)
        worlds = tuple(FlatWorld(own.surface, _seen(own.obstacles), space.radius) for own in space.levels)
        _MADE[scene] = agent, worlds
    return worlds


def find_end(space: FreeSpace, worlds: Sequence[FlatWorld], place: FloatArray, name: str) -> Endpoint | Refusal:
    """Check a place as the planner does, but for the steps and slopes that a flat world has not."""
    found = find_endpoint(space, place, name)
    if isinstance(found, Endpoint) or found.status not in (Status.START_OCCUPIED, Status.GOAL_OCCUPIED):
        return found
    xy = np.ascontiguousarray(place[None, :2])
    for level, surface in enumerate(space.surfaces):
        height = float(surface.height_at(xy)[0])
        here = not np.isnan(height) and (len(place) == 2 or abs(height - place[2]) <= SAME_GROUND)
        if here and nearest_places(worlds[level].tree, xy)[0][0] >= space.agent.radius:
            return Endpoint(xy[0], level, NO_NODE, height)
    return found


def _seen(obstacles: Obstacles) -> FloatArray:
    """Of what stops the body on a level, all but steps and slopes, in plan [m], shape (n, 2)."""
    seen = (obstacles.kind == ObstacleKind.MATERIAL) | (obstacles.kind == ObstacleKind.UNKNOWN)
    return np.ascontiguousarray(obstacles.points[seen, :2]) if seen.any() else np.full((1, 2), FAR)

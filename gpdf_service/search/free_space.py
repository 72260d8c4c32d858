"""Where one kind of body can be in a scene, and how those places connect."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gpdf_service.config import FieldConfig, SearchConfig
from gpdf_service.fields import FieldArrays, Gpdf, Tree, build_tree, find_nearest, fit_gpdf
from gpdf_service.fields.traversal import nearest_only
from gpdf_service.perception import HeightMap, Levels, Obstacles, obstacles_of
from gpdf_service.perception.limits import step_and_slope
from gpdf_service.search.graph import Graph, assemble, find_edges
from gpdf_service.search.quadtree import Quadtree, build_quadtree
from gpdf_service.types import Agent, FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class FreeSpace:
    """One body's view of a scene; the tuples have one entry a level.

    Attributes:
        agent: The body.
        reach: Least distance of a disc's centre from any obstacle: its radius, and what the noise asks for [m]; of a
            cylinder there is one disc, itself.
        radius: The same with the margin of `SearchConfig` [m].
        surfaces: The ground.
        ground_fields: Ground GPDFs, 3D.
        steps: Height of the step at each cell of the ground [m].
        slopes: Slope of the ground at each cell [rad].
        obstacles: What stops the body.
        trees: All obstacle places in plan, for exact distances.
        exact_fields: The same places as fields, for compiled loops.
        obstacle_fields: Obstacle GPDFs, 2D.
        quadtrees: Free leaves.
        offsets: First graph node of each level's leaves.
        graph: All free leaves, connected.
    """

    agent: Agent
    reach: float
    radius: float
    surfaces: tuple[HeightMap, ...]
    ground_fields: tuple[Gpdf, ...]
    steps: tuple[FloatArray, ...]
    slopes: tuple[FloatArray, ...]
    obstacles: tuple[Obstacles, ...]
    trees: tuple[Tree, ...]
    exact_fields: tuple[FieldArrays, ...]
    obstacle_fields: tuple[Gpdf, ...]
    quadtrees: tuple[Quadtree, ...]
    offsets: tuple[int, ...]
    graph: Graph

    def clearance(self, level: int, xy: FloatArray) -> tuple[FloatArray, IntArray]:
        """Exact distance from places in plan, shape (m, 2), to the nearest obstacle [m], and its kind, shape (m,)."""
        distance, row = find_nearest(self.trees[level], np.ascontiguousarray(xy))
        return distance, self.obstacles[level].kind[self.trees[level].order[row]].astype(np.int64)


def build_free_space(
    levels: Levels,
    ground_fields: tuple[Gpdf, ...],
    agent: Agent,
    config: SearchConfig,
    field_config: FieldConfig,
    *,
    noise: float = 0.0,
) -> FreeSpace:
    """Find what stops the body, fit its Obstacle GPDFs, build quadtrees and graph; `noise` is the cloud's [m]."""
    reach = agent.disc_radius + config.noise_margin * noise
    radius = reach + config.margin
    surfaces = tuple(level.surface for level in levels.levels)
    obstacles = tuple(obstacles_of(level, agent, noise) for level in levels.levels)
    trees = tuple(build_tree(found.points[:, :2]) for found in obstacles)
    spacing = agent.disc_radius * config.field_spacing
    fields = tuple(
        fit_gpdf(found.points[:, :2], config=field_config, domain=surface, spacing=spacing)
        for found, surface in zip(obstacles, surfaces, strict=True)
    )
    quadtrees = tuple(build_quadtree(surface, tree, radius) for surface, tree in zip(surfaces, trees, strict=True))
    limits = [step_and_slope(surface) for surface in surfaces]
    offsets = tuple(int(n) for n in np.cumsum([0, *(len(tree.size) for tree in quadtrees[:-1])]))
    return FreeSpace(
        agent,
        reach,
        radius,
        surfaces,
        ground_fields,
        tuple(step for step, _ in limits),
        tuple(slope for _, slope in limits),
        obstacles,
        trees,
        tuple(nearest_only(tree) for tree in trees),
        fields,
        quadtrees,
        offsets,
        _connect(levels, quadtrees, trees, offsets, radius),
    )


def _connect(
    levels: Levels, quadtrees: tuple[Quadtree, ...], trees: tuple[Tree, ...], offsets: tuple[int, ...], radius: float
) -> Graph:
    """One graph over all levels: sides shared by leaves, and portals where two levels are the same ground."""
    pairs, vias = [], []
    for quadtree, tree, offset in zip(quadtrees, trees, offsets, strict=True):
        ends, via = find_edges(quadtree, tree, radius)
        pairs.append(ends + offset)
        vias.append(via)
    for portal in levels.portals:
        a, b = quadtrees[portal.a], quadtrees[portal.b]
        xy = portal.points[:, :2]
        one, two = a.find(xy), b.find(xy)
        both = (one >= 0) & (two >= 0) & a.whole[one] & b.whole[two]  # the place is in two wholly free leaves
        pairs.append(np.column_stack([one[both] + offsets[portal.a], two[both] + offsets[portal.b]]))
        vias.append(xy[both])
    position = np.concatenate([quadtree.center for quadtree in quadtrees])
    level = np.concatenate([np.full(len(q.size), i, np.int64) for i, q in enumerate(quadtrees)])
    clearance = np.concatenate([quadtree.clearance for quadtree in quadtrees])
    return assemble(position, level, clearance, np.concatenate(pairs), np.concatenate(vias), radius)

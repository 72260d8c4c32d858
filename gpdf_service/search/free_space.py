"""Where one kind of body can be in a scene, and how those places connect."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from operator import is_
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gpdf_service.config import FieldConfig, SearchConfig
from gpdf_service.fields import Gpdf, Nearer, Tree, build_tree, fit_gpdf
from gpdf_service.fields.nearer import EMPTY
from gpdf_service.fields.threads import run_beside, run_parallel
from gpdf_service.fields.traversal import NearerArrays, nearest_only
from gpdf_service.ground import CLEAN, GroundLevel, Levels, Obstacles, Scan, obstacles_of
from gpdf_service.ground.limits import Measured
from gpdf_service.search.core import Core, find_core, links_of
from gpdf_service.search.graph import Edges, Graph, assemble, find_edges, price_pairs
from gpdf_service.search.layered import Layered
from gpdf_service.search.places import Places, nearest_places, nearest_to
from gpdf_service.search.quadtree import Quadtree, build_quadtree
from gpdf_service.search.resplit import SplitQuadtree
from gpdf_service.search.steps import NOTICED_STEP
from gpdf_service.tiles import HeightMap
from gpdf_service.tiles.surface import UNKNOWN, count_cells
from gpdf_service.types import Agent, FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class LevelSpace:
    """One level of a free space; the attributes are those of `FreeSpace`.

    And the `source` of each leaf in the version before, −1 of a new one; None where they are the same, or all new.
    """

    surface: HeightMap
    ground_field: Gpdf
    measured: Measured
    obstacles: Obstacles
    tree: Tree
    obstacle_field: Gpdf
    quadtree: Quadtree
    edges: Edges
    source: IntArray | None = None


@dataclass(frozen=True, slots=True)
class FreeSpace:
    """One body's view of a scene; the tuples have one entry a level.

    What moves comes beside what stands, in the trees, the fields, the quadtrees and the graph: see `add_moving`.

    Attributes:
        agent: The body.
        reach: Least distance of a disc's centre from any obstacle: its radius, and what the noise asks for [m]; of a
            cylinder there is one disc, itself.
        radius: The same with the margin of `SearchConfig` [m].
        surfaces: The ground.
        ground_fields: Ground GPDFs, 3D.
        steps: Height of the step at each cell of the ground [m].
        noticed: How many of them one notices, by boxes of cells: see `count_cells`.
        slopes: Slope of the ground at each cell [rad].
        standing: What stops the body and stands.
        moving: What stops it and moves.
        trees: All obstacle places in plan, for exact distances.
        exact_fields: The same places as fields, for compiled loops.
        obstacle_fields: Obstacle GPDFs, 2D.
        quadtrees: Free leaves.
        edges: Neighbouring leaves of each level: their pairs and crossings, see `find_edges`.
        doors: Edges from level to level: pairs of graph nodes, and where.
        offsets: First graph node of each level's leaves.
        graph: All free leaves, connected.
        core: The leaves that ways lead over.
        longest: Length of a way that sweeps all ground once [m]: where one comes back beside itself, there is a
            shorter one.
        boxes: What kernels are handed of it, see `boxed.py`, by what that is; made on first use.
    """

    agent: Agent
    reach: float
    radius: float
    surfaces: tuple[HeightMap, ...]
    ground_fields: tuple[Gpdf, ...]
    steps: tuple[FloatArray, ...]
    noticed: tuple[NDArray[np.int32], ...]
    slopes: tuple[FloatArray, ...]
    standing: tuple[Obstacles, ...]
    moving: tuple[Obstacles, ...]
    trees: tuple[Places, ...]
    exact_fields: tuple[NearerArrays, ...]
    obstacle_fields: tuple[Nearer, ...]
    quadtrees: tuple[Quadtree | SplitQuadtree, ...]
    edges: tuple[Edges, ...]
    doors: Edges
    offsets: tuple[int, ...]
    graph: Graph
    core: Core
    longest: float
    boxes: dict[object, Any] = field(default_factory=dict, init=False, repr=False, compare=False)

    def clearance(self, level: int, xy: FloatArray) -> tuple[FloatArray, IntArray]:
        """Exact distance from places in plan, shape (m, 2), to the nearest obstacle [m], and its kind, shape (m,)."""
        distance, row = nearest_places(self.trees[level], xy)
        standing, moving = self.standing[level].kind, self.moving[level].kind
        return distance, Layered(standing, moving, len(standing))[row].astype(np.int64)

    def room(self, level: int, xy: FloatArray) -> tuple[float, int]:
        """`clearance` of a single place, shape (2,)."""
        distance, row = nearest_to(self.trees[level], xy)
        return distance, self.kind_of(level, row)

    def kind_of(self, level: int, row: int) -> int:
        """Of what kind an obstacle of a level is, by its number among those that stand and those that move."""
        standing = self.standing[level].kind
        return int(standing[row] if row < len(standing) else self.moving[level].kind[row - len(standing)])

    def standing_on(self, level: int, now: GroundLevel, ground_field: Gpdf) -> LevelSpace:
        """What stands on one level, over the ground as it is `now`."""
        trees, fields, quadtrees = self.trees[level], self.obstacle_fields[level], self.quadtrees[level]
        made = self.standing[level], trees.standing, fields.standing, quadtrees.standing, self.edges[level]
        return LevelSpace(self.surfaces[level], ground_field, now.measured, *made)

    @property
    def gone(self) -> IntArray:
        """Nodes of what stands that are none any more, as something moves there, ascending."""
        split = zip(self.quadtrees, self.offsets, strict=True)
        rows = [tree.gone + begin for tree, begin in split if isinstance(tree, SplitQuadtree)]
        return np.concatenate([np.zeros(0, np.int64), *rows])

    @property
    def obstacles(self) -> tuple[Obstacles, ...]:
        """What stops the body: all that stands, and then all that moves."""
        both = zip(self.standing, self.moving, strict=True)
        return tuple(joined(stands, moves) if len(moves.kind) else stands for stands, moves in both)


class Setup(NamedTuple):
    """How free spaces are built of a cloud.

    Attributes:
        config: Margins.
        field_config: Of the Obstacle GPDFs.
        scan: What obstacles need to know of the cloud.
    """

    config: SearchConfig
    field_config: FieldConfig
    scan: Scan = CLEAN


Before = tuple[FreeSpace, Sequence[int]]
"""The version before, and which of its levels each level was made from, −1 where there was none."""
Former = tuple[FreeSpace, Sequence[int], Sequence[IntArray | None]]
"""The same, and each level's `source`, see `LevelSpace`."""


def joined(one: Obstacles, other: Obstacles) -> Obstacles:
    """Both in one."""
    return Obstacles(np.concatenate([one.points, other.points]), np.concatenate([one.kind, other.kind]))


NONE = Obstacles(np.zeros((0, 3)), np.zeros(0, np.uint8))
"""Nothing."""


def build_free_space(levels: Levels, ground_fields: tuple[Gpdf, ...], agent: Agent, setup: Setup) -> FreeSpace:
    """Find what stops the body, fit its Obstacle GPDFs, build quadtrees and graph."""
    reach, radius = reach_of(agent, setup.config, setup.scan.noise)

    def one(i: int) -> LevelSpace:
        return build_level(levels.levels[i], ground_fields[i], agent, radius, setup)

    return join_levels(agent, reach, radius, run_parallel(one, range(len(ground_fields))), levels)


def build_level(level: GroundLevel, ground_field: Gpdf, agent: Agent, radius: float, setup: Setup) -> LevelSpace:
    """One level of the free space of a body whose centre keeps a `radius` [m] from obstacles."""
    obstacles = obstacles_of(level, agent, setup.scan)
    (tree, quadtree, edges), field = run_beside(
        partial(_leaves_and_edges, obstacles, level.surface, radius),
        partial(fit_obstacle_field, obstacles, level.surface, agent, setup),
    )
    return LevelSpace(level.surface, ground_field, level.measured, obstacles, tree, field, quadtree, edges)


def _leaves_and_edges(obstacles: Obstacles, surface: HeightMap, radius: float) -> tuple[Tree, Quadtree, Edges]:
    tree = build_tree(obstacles.points[:, :2])
    quadtree = build_quadtree(surface, tree, radius)
    return tree, quadtree, find_edges(quadtree, Places(tree), radius)


def reach_of(agent: Agent, config: SearchConfig, noise: float) -> tuple[float, float]:
    """How far the body's centre keeps from obstacles: at least, and while searching [m]."""
    reach = agent.disc_radius + config.noise_margin * noise
    return reach, reach + config.margin


def fit_obstacle_field(obstacles: Obstacles, surface: HeightMap, agent: Agent, setup: Setup) -> Gpdf:
    """The Obstacle GPDF of one level."""
    spacing = agent.disc_radius * setup.config.field_spacing
    return fit_gpdf(obstacles.points[:, :2], config=setup.field_config, domain=surface, spacing=spacing)


def join_levels(
    agent: Agent,
    reach: float,
    radius: float,
    parts: Sequence[LevelSpace],
    levels: Levels,
    old: Before | None = None,
) -> FreeSpace:
    """The free space of all levels, with one graph; an `old` version knows which leaves ways need."""
    quadtrees = tuple(part.quadtree for part in parts)
    edges = tuple(part.edges for part in parts)
    offsets, doors = _begins(quadtrees), find_doors(levels, quadtrees)
    if old and _is_joined(old, quadtrees, edges, doors):
        graph, core = old[0].graph, old[0].core
    else:
        graph = connect(quadtrees, edges, doors, radius)
        core = core_of(quadtrees, graph, old and (*old, [part.source for part in parts]))
    surfaces = tuple(part.surface for part in parts)
    former = zip(old[0].trees, old[0].exact_fields, strict=True) if old else ()
    exact = {id(tree.standing): field for tree, field in former}
    area = sum(np.count_nonzero(surface.state != UNKNOWN) * surface.cell_width**2 for surface in surfaces)
    return FreeSpace(
        agent,
        reach,
        radius,
        surfaces,
        tuple(part.ground_field for part in parts),
        tuple(part.measured[0] for part in parts),
        tuple(count_cells(part.measured[0] > NOTICED_STEP) for part in parts),
        tuple(part.measured[1] for part in parts),
        tuple(part.obstacles for part in parts),
        (NONE,) * len(parts),
        tuple(Places(part.tree) for part in parts),
        tuple(exact.get(id(part.tree)) or NearerArrays(nearest_only(part.tree), EMPTY) for part in parts),
        tuple(Nearer(part.obstacle_field) for part in parts),
        quadtrees,
        edges,
        doors,
        offsets,
        graph,
        core,
        float(area) / (2.0 * agent.disc_radius),
    )


def _is_joined(old: Before, quadtrees: tuple[Quadtree, ...], edges: tuple[Edges, ...], doors: Edges) -> bool:
    """Whether a version before has these very leaves and edges, and the same doors: then it has the graph."""
    pairs = ((quadtrees, old[0].quadtrees), (edges, old[0].edges))
    same = all(len(now) == len(was) and all(map(is_, now, was)) for now, was in pairs)
    return same and all(map(np.array_equal, doors, old[0].doors))


def find_doors(levels: Levels, quadtrees: tuple[Quadtree, ...]) -> Edges:
    """Edges from level to level, where two are the same ground: pairs of nodes of one graph over all of them."""
    offsets, pairs, vias = _begins(quadtrees), [np.zeros((0, 2), np.int64)], [np.zeros((0, 2))]
    for portal in levels.portals:
        a, b = quadtrees[portal.a], quadtrees[portal.b]
        xy = portal.points[:, :2]
        one, two = a.find(xy), b.find(xy)
        both = (one >= 0) & (two >= 0) & a.whole[one] & b.whole[two]  # the place is in two wholly free leaves
        pairs.append(np.column_stack([one[both] + offsets[portal.a], two[both] + offsets[portal.b]]))
        vias.append(xy[both])
    return np.concatenate(pairs), np.concatenate(vias)


def connect(quadtrees: tuple[Quadtree, ...], edges: tuple[Edges, ...], doors: Edges, radius: float) -> Graph:
    """One graph over all levels: sides shared by leaves, and doors."""
    pairs = [ends + offset if offset else ends for (ends, _), offset in zip(edges, _begins(quadtrees), strict=True)]
    pairs, vias = [*pairs, doors[0]], [*(via for _, via in edges), doors[1]]
    position = _joined([quadtree.center for quadtree in quadtrees])
    level = np.repeat(np.arange(len(quadtrees)), [len(quadtree.size) for quadtree in quadtrees])
    clearance = _joined([quadtree.clearance for quadtree in quadtrees])
    found = _joined(pairs), _joined(vias)
    return assemble(position, level, found, price_pairs(position, clearance, found, radius))


def _joined(parts: list[NDArray[Any]]) -> NDArray[Any]:
    """All parts in one array: a single one that is not empty as it is."""
    parts = [part for part in parts if len(part)] or parts[:1]
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def core_of(quadtrees: tuple[Quadtree, ...], graph: Graph, before: Former | None = None) -> Core:
    """The leaves that ways lead over; what was decided on the leaves of the version before stands where it can.

    Leaves are decided on one after another, equal ones by their numbers: so levels must be in their former order.
    """
    keys = "free", "half_size", "clearance"
    free, half, clearance = (_joined([getattr(tree, key) for tree in quadtrees]) for key in keys)
    links, former = links_of(graph, free, 2.0 * half, clearance), None
    old, levels, sources = before or (None, (), ())
    if old is not None and (np.diff([k for k in levels if k >= 0]) > 0).all():
        source = np.full(len(free), -1)
        for now, k, was, begin in zip(quadtrees, levels, sources, _begins(quadtrees), strict=True):
            if k >= 0:
                own = np.arange(len(now.size)) if was is None else was
                source[begin : begin + len(own)] = np.where(own < 0, -1, own + old.offsets[k])
        former = old.core, source
    return find_core(graph, free, links, former)


def _begins(quadtrees: tuple[Quadtree, ...]) -> tuple[int, ...]:
    """The first node of each level's leaves."""
    return tuple(int(n) for n in np.cumsum([0, *(len(tree.size) for tree in quadtrees[:-1])]))

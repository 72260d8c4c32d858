"""Where one kind of body can be in a scene, and how those places connect."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gpdf_service.config import FieldConfig, SearchConfig
from gpdf_service.fields import Gpdf, Nearer, Tree, build_tree, fit_gpdf
from gpdf_service.fields.threads import run_beside, run_parallel
from gpdf_service.ground import CLEAN, GroundLevel, Levels, Obstacles, Scan, obstacles_of
from gpdf_service.search.core import Core, find_core
from gpdf_service.search.graph import Edges, Graph, PatchedGraph, assemble, find_edges, price_pairs
from gpdf_service.search.layered import Layered
from gpdf_service.search.places import Places, nearest_places, nearest_to
from gpdf_service.search.quadtree import Quadtree, build_quadtree
from gpdf_service.search.resplit import SplitQuadtree
from gpdf_service.tiles import HeightMap
from gpdf_service.tiles.surface import UNKNOWN, count_cells
from gpdf_service.types import Agent, ByteArray, FloatArray, IntArray

NOTICED_STEP = 0.03
"""[m] Lower steps do not slow anybody down: a sill of 2 cm is rolled over. Higher ones are not level ground."""
NONE = Obstacles(np.zeros((0, 3)), np.zeros(0, np.uint8))
"""Nothing."""


@dataclass(frozen=True, slots=True)
class LevelSpace:
    """One level of a free space.

    Attributes:
        surface: The ground.
        steps: Height of the step at each cell of it [m].
        slopes: Slope at each cell [rad].
        noticed: How many of the steps one notices, by boxes of cells: see `count_cells`.
        ground_field: Ground GPDF, 3D.
        standing: What stops the body and stands.
        places: All obstacle places in plan, for exact distances.
        obstacle_field: Obstacle GPDF, 2D.
        quadtree: Free leaves.
        edges: Neighbouring leaves: their pairs and crossings, see `find_edges`.
        moving: What stops the body and moves.
        offset: First graph node of its leaves.
    """

    surface: HeightMap
    steps: FloatArray
    slopes: FloatArray
    noticed: NDArray[np.int32]
    ground_field: Gpdf
    standing: Obstacles
    places: Places
    obstacle_field: Nearer
    quadtree: Quadtree | SplitQuadtree
    edges: Edges
    moving: Obstacles = NONE
    offset: int = 0

    def clearance(self, xy: FloatArray) -> tuple[FloatArray, IntArray]:
        """Exact distance from places in plan, shape (m, 2), to the nearest obstacle [m], and its kind, shape (m,)."""
        distance, row = nearest_places(self.places, xy)
        return distance, Layered(self.standing.kind, self.moving.kind)[row].astype(np.int64)

    def room(self, xy: FloatArray) -> tuple[float, int]:
        """`clearance` of a single place, shape (2,)."""
        distance, row = nearest_to(self.places, xy)
        count = len(self.standing.kind)
        return distance, int(self.standing.kind[row] if row < count else self.moving.kind[row - count])

    def node_at(self, xy: FloatArray) -> int:
        """Graph node of the wholly free leaf that holds a place, shape (2,); −1 if none does."""
        leaf = self.quadtree.find_one(xy)
        return leaf + self.offset if leaf >= 0 and self.quadtree.whole[leaf] else -1

    @property
    def kind(self) -> ByteArray:
        """Of what kind each obstacle is: those that stand, and then those that move."""
        return np.concatenate([self.standing.kind, self.moving.kind]) if len(self.moving.kind) else self.standing.kind

    @property
    def obstacles(self) -> Obstacles:
        """What stops the body: all that stands, and then all that moves."""
        return joined(self.standing, self.moving) if len(self.moving.kind) else self.standing


@dataclass(frozen=True, slots=True)
class FreeSpace:
    """One body's view of a scene.

    What moves comes beside what stands, in the trees, the fields, the quadtrees and the graph: see `add_moving`.

    Attributes:
        agent: The body.
        reach: Least distance of a disc's centre from any obstacle: its radius, and what the noise asks for [m]; of a
            cylinder there is one disc, itself.
        radius: The same with the margin of `SearchConfig` [m].
        levels: The levels.
        doors: Edges from level to level: pairs of graph nodes, and where.
        graph: All free leaves, connected.
        core: The leaves that ways lead over.
        longest: Length of a way that sweeps all ground once [m]: where one comes back beside itself, there is a
            shorter one.
        boxes: What kernels are handed of it, see `boxed`, by what that is; made on first use.
    """

    agent: Agent
    reach: float
    radius: float
    levels: tuple[LevelSpace, ...]
    doors: Edges
    graph: Graph | PatchedGraph
    core: Core
    longest: float
    boxes: dict[object, Any] = field(default_factory=dict, init=False, repr=False, compare=False)

    @property
    def surfaces(self) -> tuple[HeightMap, ...]:
        """The ground of each level."""
        return tuple([own.surface for own in self.levels])

    @property
    def gone(self) -> IntArray:
        """Nodes of what stands that are none any more, as something moves there, ascending."""
        trees = [(own.quadtree, own.offset) for own in self.levels]
        gone = [tree.gone + offset for tree, offset in trees if isinstance(tree, SplitQuadtree)]
        return np.concatenate([np.zeros(0, np.int64), *gone])


class Setup(NamedTuple):
    """How free spaces are built: their margins, their Obstacle GPDFs, and what obstacles need to know of the cloud."""

    config: SearchConfig
    field_config: FieldConfig
    scan: Scan = CLEAN


Former = tuple[FreeSpace, Sequence[int], Sequence[IntArray | None]]
"""The version before, which of its levels each level was made from, −1 where there was none, and what each leaf was in
it, −1 of a new one; None where they are the same, or all new."""


def joined(one: Obstacles, other: Obstacles) -> Obstacles:
    """Both in one."""
    return Obstacles(np.concatenate([one.points, other.points]), np.concatenate([one.kind, other.kind]))


def build_free_space(levels: Levels, ground_fields: tuple[Gpdf, ...], agent: Agent, setup: Setup) -> FreeSpace:
    """Find what stops the body, fit its Obstacle GPDFs, build quadtrees and graph."""
    reach, radius = reach_of(agent, setup.config, setup.scan.noise)

    def one(i: int) -> LevelSpace:
        return build_level(levels.levels[i], ground_fields[i], agent, radius, setup)

    return join_levels(agent, reach, radius, run_parallel(one, range(len(ground_fields))), levels)


def build_level(level: GroundLevel, ground_field: Gpdf, agent: Agent, radius: float, setup: Setup) -> LevelSpace:
    """One level of the free space of a body whose centre keeps a `radius` [m] from obstacles."""
    obstacles = obstacles_of(level, agent, setup.scan)

    def leaves_and_edges() -> tuple[Tree, Quadtree, Edges]:
        tree = build_tree(obstacles.points[:, :2])
        quadtree = build_quadtree(level.surface, tree, radius)
        return tree, quadtree, find_edges(quadtree, Places(tree), radius)

    fit = partial(fit_obstacle_field, obstacles, level.surface, agent, setup)
    (tree, quadtree, edges), field = run_beside(leaves_and_edges, fit)
    return level_space(level, ground_field, obstacles, tree, field, quadtree, edges)


def level_space(
    level: GroundLevel,
    ground_field: Gpdf,
    obstacles: Obstacles,
    tree: Tree,
    field: Gpdf,
    quadtree: Quadtree,
    edges: Edges,
) -> LevelSpace:
    """A level in which nothing moves."""
    steps, slopes = level.measured
    ground = level.surface, steps, slopes, count_cells(steps > NOTICED_STEP), ground_field
    return LevelSpace(*ground, obstacles, Places(tree), Nearer(field), quadtree, edges)


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
    former: Former | None = None,
) -> FreeSpace:
    """The free space of all levels, with one graph; a `former` version knows which leaves ways need."""
    begins = np.cumsum([0, *(len(part.quadtree.size) for part in parts)]).tolist()
    own = tuple(replace(part, offset=begin) for part, begin in zip(parts, begins, strict=False))
    doors = find_doors(levels, own)
    if former and _is_joined(former[0], own, doors):
        graph, core = former[0].graph.standing, former[0].core
    else:
        graph = connect(own, doors, radius)
        core = core_of(own, graph, former)
    area = sum(np.count_nonzero(part.surface.state != UNKNOWN) * part.surface.cell_width**2 for part in own)
    return FreeSpace(agent, reach, radius, own, doors, graph, core, float(area) / (2.0 * agent.disc_radius))


def _is_joined(old: FreeSpace, parts: tuple[LevelSpace, ...], doors: Edges) -> bool:
    """Whether a version before has these very leaves and edges, and the same doors: then it has the graph."""
    pairs = zip(parts, old.levels, strict=False)
    same = all(now.quadtree is was.quadtree and now.edges is was.edges for now, was in pairs)
    return same and len(parts) == len(old.levels) and all(map(np.array_equal, doors, old.doors))


def find_doors(levels: Levels, parts: tuple[LevelSpace, ...]) -> Edges:
    """Edges from level to level, where two are the same ground: pairs of nodes of one graph over all of them."""
    found = [whole_doors(parts[each.a], parts[each.b], each.points[:, :2]) for each in levels.portals]
    pairs, vias = zip((np.zeros((0, 2), np.int64), np.zeros((0, 2))), *found, strict=True)
    return np.concatenate(pairs), np.concatenate(vias)


def whole_doors(one: LevelSpace, other: LevelSpace, xy: FloatArray) -> Edges:
    """Edges between two levels at those of the places (k, 2) that are in two wholly free leaves."""
    a, b = one.quadtree, other.quadtree
    i, j = a.find(xy), b.find(xy)
    both = (i >= 0) & (j >= 0) & a.whole[i] & b.whole[j]
    return np.column_stack([i[both] + one.offset, j[both] + other.offset]), xy[both]


def connect(parts: tuple[LevelSpace, ...], doors: Edges, radius: float) -> Graph:
    """One graph over all levels: sides shared by leaves, and doors."""
    pairs = [part.edges[0] + part.offset if part.offset else part.edges[0] for part in parts]
    found = _joined([*pairs, doors[0]]), _joined([*(part.edges[1] for part in parts), doors[1]])
    position, clearance = (_joined([getattr(part.quadtree, key) for part in parts]) for key in ("center", "clearance"))
    level = np.repeat(np.arange(len(parts)), [len(part.quadtree.size) for part in parts])
    return assemble(position, level, found, price_pairs(position, clearance, found, radius))


def _joined(parts: list[NDArray[Any]]) -> NDArray[Any]:
    """All parts in one array: a single one that is not empty as it is."""
    parts = [part for part in parts if len(part)] or parts[:1]
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def core_of(parts: tuple[LevelSpace, ...], graph: Graph, former: Former | None = None) -> Core:
    """The leaves that ways lead over; what was decided on the leaves of the version before stands where it can.

    Leaves are decided on one after another, equal ones by their numbers: so levels must be in their former order.
    """
    keys = "free", "half_size", "clearance"
    free, half, clearance = (_joined([getattr(part.quadtree, key) for part in parts]) for key in keys)
    known, (old, levels, sources) = None, former or (None, (), ())
    if old is not None and (np.diff([k for k in levels if k >= 0]) > 0).all():
        source = np.full(len(free), -1)
        for part, k, was in zip(parts, levels, sources, strict=True):
            if k >= 0:
                own = np.arange(len(part.quadtree.size)) if was is None else was
                source[part.offset : part.offset + len(own)] = np.where(own < 0, -1, own + old.levels[k].offset)
        known = old.core, source
    return find_core(graph, free, 2.0 * half, clearance, known)


@dataclass(frozen=True, slots=True)
class Reach:
    """Facts about a free space.

    Attributes:
        free_area: Where the body's centre may be [m²].
        largest_area: Of that, the largest connected piece [m²].
        pieces: Connected pieces.
        start: A place in the largest piece with the most room (x, y, z of the ground) [m]; None if nothing is free.
        goal: A place far from it that is half as roomy at least.
    """

    free_area: float
    largest_area: float
    pieces: int
    start: FloatArray | None
    goal: FloatArray | None


def find_reach(space: FreeSpace) -> Reach:
    """Measure a free space: its wholly free leaves, and the pieces that the graph makes of them."""
    nodes, rows = [], []
    for own in space.levels:
        tree = own.quadtree
        leaves = tree.numbers[tree.whole[tree.numbers]]
        nodes.append(leaves + own.offset)
        rows.append(np.column_stack([tree.width * tree.size[leaves], tree.clearance[leaves]]))
    node, (width, clearance) = np.concatenate(nodes), np.concatenate(rows).T
    if not len(node):
        return Reach(0.0, 0.0, 0, None, None)
    component = np.unique(space.graph.component[node], return_inverse=True)[1]
    areas = np.bincount(component, weights=width**2)
    inside = np.flatnonzero(component == areas.argmax())
    roomiest = inside[clearance[inside].argmax()]
    roomy = inside[clearance[inside] >= 0.5 * clearance[roomiest]]
    place = space.graph.position[node]
    far = roomy[np.linalg.norm(place[roomy] - place[roomiest], axis=1).argmax()]
    start, goal = (_on_ground(space, one) for one in node[[roomiest, far]])
    return Reach(float(areas.sum()), float(areas.max()), len(areas), start, goal)


def _on_ground(space: FreeSpace, node: int) -> FloatArray:
    xy = space.graph.position[node]
    return np.append(xy, space.levels[space.graph.level[node]].surface.height_at(xy[None]))

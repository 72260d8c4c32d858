"""A free space with something in it that moves: what stands is shared, only what that touches is made again."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np
from scipy import ndimage

from gpdf_service.fields import Nearer, build_tree
from gpdf_service.ground import GroundLevel, Levels, Obstacles, Scan, obstacles_of
from gpdf_service.ground.level import OVERLAP, within_reach
from gpdf_service.ground.limits import NO_LIMITS
from gpdf_service.search.core import patch_core
from gpdf_service.search.free_space import NONE, FreeSpace, Setup, fit_obstacle_field, joined, whole_doors
from gpdf_service.search.graph import Edges, find_edges
from gpdf_service.search.patch import Around, Nodes, around, patched
from gpdf_service.search.places import Places
from gpdf_service.search.resplit import SplitQuadtree, split_again
from gpdf_service.tiles.boxes import Box
from gpdf_service.tiles.surface import cropped
from gpdf_service.types import Agent, FloatArray, IntArray


def add_moving(space: FreeSpace, levels: Levels, points: FloatArray, setup: Setup) -> FreeSpace:
    """The free space with more points (k, 3) [m] in it, in time by what they touch.

    Args:
        space: Of what stands, without anything that moves.
        levels: The same that it was built of.
        points: What moves.
        setup: How the space of what stands was built.
    """
    scan, parts, start = setup.scan._replace(voxels=False), list(space.levels), len(space.graph.position)
    split: list[tuple[int, SplitQuadtree]] = []
    for i, (was, level) in enumerate(zip(space.levels, levels.levels, strict=True)):
        more = stopping(level, points, space.agent, scan)
        if len(more.points) == 0:
            continue
        places, leaves = Places(was.places.standing, build_tree(more.points[:, :2])), was.quadtree.standing
        field = Nearer(was.obstacle_field.standing, fit_obstacle_field(more, was.surface, space.agent, setup))
        gone, fresh = split_again(leaves, was.surface, places, space.radius)
        tree = SplitQuadtree(leaves, gone, fresh, start - was.offset)
        start += len(fresh.size)
        parts[i] = replace(was, moving=more, places=places, obstacle_field=field, quadtree=tree)
        split.append((i, tree))
    changed = replace(space, levels=tuple(parts))
    return _connected(changed, split) if split else changed


def stopping(level: GroundLevel, points: FloatArray, agent: Agent, scan: Scan) -> Obstacles:
    """Which of the moving points, shape (k, 3) [m], stop the body on a level: as if nothing stood there beside them.

    What stands can shut a higher piece of ground off, from which alone the body would touch a point: then such a point
    is an obstacle here all the same. Points that are far apart are looked at each by themselves, with the ground there.
    """
    surface = level.surface
    reach = int(np.ceil((agent.cylinder.radius + 2.0 * agent.disc_radius) / surface.cell_width)) + 6
    ix, iy, inside = surface.cells(points)
    cells, points, found = np.column_stack([ix, iy])[inside], points[inside], NONE
    for rows in _groups(cells, reach):
        near = within_reach(points[rows], surface, _box(cells[rows], int(np.ceil(OVERLAP / surface.cell_width))))
        if len(near):
            part = _part(level, near, _box(cells[rows], reach))
            found = joined(found, obstacles_of(part, agent, scan, NO_LIMITS))
    return found


def _groups(cells: IntArray, reach: int) -> list[IntArray]:
    """Rows of the cells, shape (m, 2), in groups that are more than `reach` cells apart."""
    if len(cells) == 0:
        return []
    coarse = cells // reach
    taken = np.zeros(coarse.max(axis=0) + 1, dtype=bool)
    taken[tuple(coarse.T)] = True
    group, count = ndimage.label(taken, structure=np.ones((3, 3)))
    own = group[tuple(coarse.T)]
    return [np.flatnonzero(own == i + 1) for i in range(count)]


def _box(cells: IntArray, by: int) -> Box:
    """The rows and columns that hold the cells, shape (m, 2), and `by` more on each side."""
    low, high = np.maximum(cells.min(axis=0) - by, 0), cells.max(axis=0) + by + 1
    return slice(int(low[0]), int(high[0])), slice(int(low[1]), int(high[1]))


def _part(level: GroundLevel, points: FloatArray, box: Box) -> GroundLevel:
    """A box of the level with these points, and nothing else on it."""
    ledge = np.full(len(points), np.inf, np.float32)  # no step's face
    return replace(level, surface=cropped(level.surface, box), other_points=points, ledge=ledge)


def _connected(space: FreeSpace, split: list[tuple[int, SplitQuadtree]]) -> FreeSpace:
    """The space without the leaves that are gone in graph and core, and with the fresh ones of these levels."""
    graph = space.graph
    gone = space.gone
    lost, found, room = around(graph, gone), [], []
    for i, tree in split:
        offset = space.levels[i].offset
        own = lost.ring[graph.level[lost.ring] == i] - offset
        leaves = np.concatenate([own, tree.start + np.arange(len(tree.fresh.size))])
        ends, via = find_edges(tree, space.levels[i].places, space.radius, leaves, partial(np.less_equal, tree.start))
        found.append((ends + offset, via))
        room.append(tree.clearance[ends])
    for edges, clearance in _portals(space, lost):
        found.append(edges)
        room.append(clearance)
    position, clearance, half_size = (
        np.concatenate([getattr(tree.fresh, key) for _, tree in split]) for key in ("center", "clearance", "half_size")
    )
    level = np.repeat([i for i, _ in split], [len(tree.fresh.size) for _, tree in split])
    edges = np.concatenate([ends for ends, _ in found]), np.concatenate([via for _, via in found])
    graph = patched(graph, lost, Nodes(position, level), edges, np.concatenate(room), space.radius)
    within = np.concatenate([tree.within_gone + space.levels[i].offset for i, tree in split])
    place = within + np.arange(1, len(within) + 1) / (len(within) + 1)  # in the order of a quadtree of all
    added = np.column_stack([clearance, place])
    return replace(space, graph=graph, core=patch_core(space.core, graph, gone, added, 2.0 * half_size))


def _portals(space: FreeSpace, lost: Around) -> Iterator[tuple[Edges, FloatArray]]:
    """What is left of the edges from level to level that are lost: where both leaves of the place are whole again.

    Also the clearance at both ends (e, 2) [m].
    """
    graph = space.graph
    levels = np.column_stack([graph.level[lost.source], graph.level[graph.other[lost.edge]]])
    across = levels[:, 0] != levels[:, 1]
    places = np.unique(np.column_stack([np.sort(levels[across], axis=1), graph.via[lost.edge[across]]]), axis=0)
    for a, b in np.unique(places[:, :2].astype(np.int64), axis=0):
        xy = places[(places[:, :2] == (a, b)).all(axis=1), 2:]
        yield whole_doors(space.levels[a], space.levels[b], xy)

"""A free space with something in it that moves: what stands is shared, only what that touches is made again."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numba import njit
from scipy import ndimage

from gpdf_service.fields import Nearer, build_tree
from gpdf_service.ground import GroundLevel, Levels, Obstacles, Scan, obstacles_of
from gpdf_service.ground.level import OVERLAP, within_reach
from gpdf_service.ground.limits import NO_LIMITS
from gpdf_service.search.core import patch_core
from gpdf_service.search.free_space import NONE, FreeSpace, Setup, fit_obstacle_field, joined, whole_doors
from gpdf_service.search.graph import Edges, Graph, Net, Patch, PatchedGraph, edges_of, far_end, find_edges, price_pairs
from gpdf_service.search.layered import Layered
from gpdf_service.search.places import Places
from gpdf_service.search.resplit import SplitQuadtree, split_again
from gpdf_service.tiles.boxes import Box
from gpdf_service.tiles.nodes import components
from gpdf_service.tiles.rows import is_among, rows_of_runs
from gpdf_service.tiles.surface import cropped
from gpdf_service.types import Agent, FloatArray, IntArray


def add_moving(space: FreeSpace, levels: Levels, points: FloatArray, setup: Setup) -> FreeSpace:
    """The free space of what stands, built of these levels by this `setup`, with `points` in it that move, (k, 3) [m].

    It takes time by what they touch.
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
    stands, gone = space.graph.standing, space.gone
    lost, found = around(stands, gone), []
    for i, tree in split:
        offset = space.levels[i].offset
        own = lost.ring[stands.level[lost.ring] == i] - offset
        leaves = np.concatenate([own, tree.start + np.arange(len(tree.fresh.size))])
        ends, via = find_edges(tree, space.levels[i].places, space.radius, leaves, partial(np.less_equal, tree.start))
        found.append((ends + offset, via))
    found += _portals(space, lost)
    position, clearance, half_size = (
        np.concatenate([getattr(tree.fresh, key) for _, tree in split]) for key in ("center", "clearance", "half_size")
    )
    level = np.repeat([i for i, _ in split], [len(tree.fresh.size) for _, tree in split])
    edges = np.concatenate([ends for ends, _ in found]), np.concatenate([via for _, via in found])
    room = Layered(space.core.links.clearance, clearance)
    graph = patched(stands, lost, (position, level), edges, room, space.radius)
    within = np.concatenate([tree.within_gone + space.levels[i].offset for i, tree in split])
    place = within + np.arange(1, len(within) + 1) / (len(within) + 1)  # in the order of a quadtree of all
    added = np.column_stack([clearance, place])
    return replace(space, graph=graph, core=patch_core(space.core, graph, gone, added, 2.0 * half_size))


def _portals(space: FreeSpace, lost: Around) -> Iterator[Edges]:
    """What is left of the edges from level to level that are lost: where both leaves of the place are whole again."""
    graph = space.graph.standing
    levels = np.column_stack([graph.level[lost.source], graph.level[graph.other[lost.edge]]])
    across = levels[:, 0] != levels[:, 1]
    places = np.unique(np.column_stack([np.sort(levels[across], axis=1), graph.via[lost.edge[across]]]), axis=0)
    for a, b in np.unique(places[:, :2].astype(np.int64), axis=0):
        xy = places[(places[:, :2] == (a, b)).all(axis=1), 2:]
        yield whole_doors(space.levels[a], space.levels[b], xy)


Nodes = tuple[FloatArray, IntArray]
"""Nodes that are new: places (x, y) [m], shape (k, 2), and level, shape (k,)."""


class Around(NamedTuple):
    """What a graph loses with its nodes that are `gone`, ascending: edges, from a node that is gone, and whose `ring`.

    Attributes:
        gone: The nodes, shape (g,).
        source: Of each edge the node that is gone, shape (e,).
        edge: Its number.
        ring: Nodes at the far ends that are not gone, ascending.
    """

    gone: IntArray
    source: IntArray
    edge: IntArray
    ring: IntArray


def around(graph: Graph, gone: IntArray) -> Around:
    """What the graph of what stands loses with these nodes, ascending."""
    source, edge = _edges_from(graph, gone)
    other = np.unique(graph.other[edge])
    return Around(gone, source, edge, other[~is_among(other, gone)])


def _edges_from(graph: Graph, nodes: IntArray) -> tuple[IntArray, IntArray]:
    """The edges of some nodes: from which of them, and their numbers."""
    first, behind = graph.first[nodes], graph.first[nodes + 1]
    return np.repeat(nodes, behind - first), rows_of_runs(first, behind)


def patched(graph: Graph, lost: Around, fresh: Nodes, edges: Edges, room: Layered, radius: float) -> PatchedGraph:
    """The graph of what stands without what it has `lost`, and with fresh nodes, numbered after all others.

    One node of each of the `edges` is new; the `room` is that from each node to the nearest obstacle [m].
    """
    (pairs, via), (places, level), count = edges, fresh, len(graph.position)
    beside = np.unique(np.concatenate([lost.ring, pairs[pairs < count]]))
    source, kept = _edges_from(graph, beside)
    stays = ~is_among(graph.other[kept], lost.gone)
    source, kept = source[stays], kept[stays]
    ends = pairs.ravel()
    own = np.arange(len(ends)).reshape(-1, 2), via  # the edges between the ends alone
    price = price_pairs(Layered(graph.position, places)[ends], room[ends], own, radius)
    start = np.concatenate([source, pairs[:, 0], pairs[:, 1]])
    order = np.argsort(start, kind="stable")
    start = start[order]
    other = np.concatenate([graph.other[kept], pairs[:, 1], pairs[:, 0]])[order]
    crossing = np.concatenate([graph.via[kept], via, via])[order]
    cost = np.concatenate([graph.cost[kept], price, price])[order]
    nodes = np.concatenate([beside, count + np.arange(len(level))])
    row = np.zeros(count + len(level), np.int32)  # pages that nobody reads cost nothing
    row[nodes] = 1 + np.arange(len(nodes))
    first = np.searchsorted(start, np.append(nodes, len(row)))
    component, more = _components(graph, Net(graph.first, graph.other, row, first, other), nodes, start)
    patch = Patch(nodes, row, first, other, crossing, cost, places, level, more)
    return PatchedGraph(graph._replace(component=component), patch)


def _components(graph: Graph, net: Net, nodes: IntArray, start: IntArray) -> tuple[IntArray, IntArray]:
    """Connected component of each node that stands, and of each that was added.

    What stood in one component is joined as before, where what is left of it beside the patch is joined in the patch,
    whose edges `start` at such `nodes`, see there. Only where that falls apart all of the component is looked through:
    there may be another way round.
    """
    count, known = len(graph.position), np.searchsorted(nodes, len(graph.position))
    here = is_among(net.more, nodes)
    own, to = (np.searchsorted(nodes, ends[here]) for ends in (start, net.more))
    piece = components(own, to, np.ones(len(nodes), dtype=bool))
    was = graph.component[nodes[:known]]
    label = count + np.arange(len(nodes))  # of a piece that nothing standing leads to: that of no other
    label[piece[:known]] = was
    fresh = label[piece[known:]]
    both = np.unique(np.column_stack([was, piece[:known]]), axis=0)[:, 0]
    torn = np.unique(both[1:][both[1:] == both[:-1]])
    if len(torn) == 0:
        return graph.component, fresh
    standing = graph.component.copy()
    _flood(net, nodes[:known][is_among(was, torn)], count + len(nodes), standing, fresh)
    return standing, fresh


@njit(cache=True, nogil=True)
def _flood(net: Net, seeds: IntArray, label: int, standing: IntArray, fresh: IntArray) -> None:
    """Give all nodes that one seed leads to a label of their own, from `label` on."""
    count = len(standing)
    for seed in seeds:
        if standing[seed] >= label:
            continue
        stack, mine = [seed], label + seed
        standing[seed] = mine
        while len(stack) > 0:
            node = stack.pop()
            for e in range(*edges_of(net, node)):
                near = far_end(net, e)
                if (standing[near] if near < count else fresh[near - count]) < label:
                    if near < count:
                        standing[near] = mine
                    else:
                        fresh[near - count] = mine
                    stack.append(near)

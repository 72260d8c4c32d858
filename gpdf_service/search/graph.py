"""The connectivity graph of the free leaves, over all levels, and A* on it."""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from math import sqrt

import numpy as np
from numba import njit
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from gpdf_service.fields import Tree
from gpdf_service.fields.threads import run_chunked
from gpdf_service.perception.columns import by_cell
from gpdf_service.search.motion import is_clear
from gpdf_service.search.quadtree import Quadtree
from gpdf_service.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class Graph:
    """Undirected graph in compressed rows.

    Attributes:
        position: Places of the nodes (x, y) [m], shape (k, 2).
        level: Level of each node, shape (k,).
        first: First edge of each node, shape (k + 1,).
        other: Far end of each edge, shape (e,).
        via: Where the edge crosses from leaf to leaf (x, y) [m], shape (e, 2).
        cost: Length of the edge, weighted by how close it passes [m], shape (e,).
        component: Connected component of each node, shape (k,).
    """

    position: FloatArray
    level: IntArray
    first: IntArray
    other: IntArray
    via: FloatArray
    cost: FloatArray
    component: IntArray


@njit(cache=True, nogil=True)
def _proven(
    obstacles: Tree,
    center: FloatArray,
    via: FloatArray,
    room: FloatArray,
    ends: IntArray,
    radius: float,
    begin: int,
    end: int,
    good: BoolArray,
) -> None:
    """Which edges are clear from centre to crossing to centre.

    Of each leaf the `room` is how far a place may be from its centre and still be clear [m], inf where all of it is: a
    wholly free leaf is convex.
    """
    for e in range(begin, end):
        good[e] = True
        for leaf in ends[e]:
            far = sqrt((via[e, 0] - center[leaf, 0]) ** 2 + (via[e, 1] - center[leaf, 1]) ** 2)
            good[e] &= room[leaf] >= far or is_clear(obstacles, center[leaf], via[e], radius)


Edges = tuple[IntArray, FloatArray]
"""Pairs of leaves, shape (e, 2), and where they cross from one to the other (x, y) [m], shape (e, 2)."""


def find_edges(tree: Quadtree, obstacles: Tree, radius: float, among: BoolArray | None = None) -> Edges:
    """Pairs of free leaves that share a side, with a proven passage: ends (e, 2) and crossings (e, 2) [m].

    Every leaf looks once across each of its four sides; the leaf found there is larger, or as large, and then the pair
    is kept once. So each pair of neighbours is found, in time n log n. Only leaves `among`, shape (k,), look, if given.
    """
    leaves = np.flatnonzero(tree.free if among is None else tree.free & among)
    corner, size, center, half = tree.corner[leaves], tree.size[leaves], tree.center, tree.half_size[leaves]
    ends, vias = [], []
    for axis in (0, 1):
        for side in (-1, 1):
            probe = corner + size[:, None] // 2
            probe[:, axis] = corner[:, axis] + (size if side > 0 else -1)
            found = tree.find_cell(probe)
            larger = (found >= 0) & tree.free[found] & (tree.size[found] >= size)
            once = larger & ((tree.size[found] > size) | (side > 0))
            via = center[leaves]
            via[:, axis] += side * half
            ends.append(np.column_stack([leaves[once], found[once]]))
            vias.append(via[once])
    pairs, via = np.concatenate(ends), np.concatenate(vias)
    room = np.where(tree.whole, np.inf, tree.clearance - radius)
    good, own = np.zeros(len(pairs), dtype=bool), (obstacles, center, via, room, pairs, radius)
    run_chunked(lambda a, b: _proven(*own, a, b, good), len(pairs))
    return pairs[good], via[good]


def change_edges(
    old: Quadtree, edges: Edges, tree: Quadtree, obstacles: Tree, radius: float, places: FloatArray
) -> Edges:
    """`find_edges` of a tree that was changed, from those of the `old` one: only leaves at the change look again.

    What proves an edge are obstacles within the radius and a leaf's width. So it stands where both leaves are as they
    were, and the `places`, shape (k, 2) [m], where obstacles came or went, are further away.
    """
    at = np.minimum(np.searchsorted(old.code, tree.code), len(old.code) - 1)
    same = np.logical_and.reduce(
        [getattr(old, key)[at] == getattr(tree, key) for key in ("code", "size", "free", "whole")]
    )
    if len(places):
        reach = (radius + 3.0 * np.sqrt(2.0) * tree.half_size)[:, None]
        low, high = places.min(axis=0) - reach, places.max(axis=0) + reach
        same &= tree.whole | ~np.logical_and.reduce((tree.center >= low) & (tree.center <= high), axis=1)
    if same.all():
        return edges
    far = tree.corner + tree.size[:, None]
    low, high = tree.corner[~same].min(axis=0), far[~same].max(axis=0)
    again = np.logical_and.reduce((far >= low) & (tree.corner <= high), axis=1)
    now = np.searchsorted(tree.code, old.code)  # of the leaves that stay, the others are not asked for
    kept = np.zeros(len(old.code), dtype=bool)
    kept[at[~again]] = True
    stay = kept[edges[0][:, 0]]
    ends, via = find_edges(tree, obstacles, radius, again)
    ends, via = np.concatenate([now[edges[0][stay]], ends]), np.concatenate([edges[1][stay], via])
    off = via - tree.center[ends[:, 0]]
    across = np.abs(off[:, 1]) > np.abs(off[:, 0])
    side = np.where(across, 2 + (off[:, 1] > 0.0), off[:, 0] > 0.0)
    order = np.argsort(side * len(tree.code) + ends[:, 0], kind="stable")  # as `find_edges` lists them
    return ends[order], via[order]


def assemble(
    position: FloatArray, level: IntArray, clearance: FloatArray, pairs: IntArray, via: FloatArray, radius: float
) -> Graph:
    """Make a graph of undirected `pairs`, shape (e, 2).

    An edge costs its length times 1 + max(0, 1 − (d − r)/r): up to twice where the body brushes past, once where there
    is as much room beside it as half its width. The factor is at least 1, so the Euclidean heuristic stays admissible.
    """
    length = np.linalg.norm(position[pairs[:, 0]] - via, axis=1) + np.linalg.norm(position[pairs[:, 1]] - via, axis=1)
    room = np.minimum(clearance[pairs[:, 0]], clearance[pairs[:, 1]]) - radius
    cost = length * (1.0 + np.clip(1.0 - room / radius, 0.0, 1.0))
    count = len(position)
    first, order = by_cell(np.concatenate([pairs[:, 0], pairs[:, 1]]), count)
    links = csr_matrix((np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    return Graph(
        np.ascontiguousarray(position),
        level,
        first,
        np.concatenate([pairs[:, 1], pairs[:, 0]])[order],
        np.concatenate([via, via])[order],
        np.concatenate([cost, cost])[order],
        connected_components(links, directed=False)[1].astype(np.int64),
    )


def find_path(graph: Graph, start: int, goal: int) -> IntArray:
    """A* with the Euclidean heuristic: the edges from `start` to `goal` in order, shape (k,); empty if start is goal.

    Start and goal must lie in one component.
    """
    count = len(graph.position)
    fresh = (
        np.zeros(count),
        np.zeros(count, np.int64),
        np.zeros(count, np.int64),
    )  # pages that nobody visits cost nothing
    edges: IntArray = _astar(graph.position, graph.first, graph.other, graph.cost, start, goal, *fresh)
    return edges


@njit(cache=True, nogil=True)
def _astar(
    position: FloatArray,
    first: IntArray,
    other: IntArray,
    cost: FloatArray,
    start: int,
    goal: int,
    cost_to_come: FloatArray,
    came_by: IntArray,
    came_from: IntArray,
) -> IntArray:
    """The last three are zero for every node; `came_by` holds 1 + the edge, 0 where nobody has been."""
    frontier = [(0.0, 0.0, start)]
    while len(frontier) > 0:
        _, come, node = heapq.heappop(frontier)
        if come > cost_to_come[node]:  # reached by a shorter way since
            continue
        if node == goal:
            break
        for e in range(first[node], first[node + 1]):
            near = other[e]
            reached = come + cost[e]
            if near != start and (came_by[near] == 0 or reached < cost_to_come[near]):
                cost_to_come[near], came_by[near], came_from[near] = reached, e + 1, node
                dx, dy = position[near, 0] - position[goal, 0], position[near, 1] - position[goal, 1]
                heapq.heappush(frontier, (reached + sqrt(dx * dx + dy * dy), reached, near))
    edges = [0 for _ in range(0)]
    node = goal
    while came_by[node] > 0:
        edges.append(came_by[node] - 1)
        node = came_from[node]
    return np.array(edges[::-1], dtype=np.int64)

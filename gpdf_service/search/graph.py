"""The connectivity graph of the free leaves, over all levels, and A* on it."""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from math import sqrt

import numpy as np
from numba import njit

from gpdf_service.fields import Tree
from gpdf_service.fields.threads import run_chunked
from gpdf_service.fields.traversal import nearest_at
from gpdf_service.fields.tree import make_scratch, place_of
from gpdf_service.perception.nodes import components
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


def find_edges(tree: Quadtree, obstacles: Tree, radius: float, of: BoolArray | None = None) -> Edges:
    """Pairs of free leaves that share a side, with a proven passage: ends (e, 2) and crossings (e, 2) [m].

    Every leaf looks once across each of its four sides; the leaf found there is larger, or as large, and then the pair
    is kept once. So each pair of neighbours is found, in time n log n. Only pairs with a leaf `of` these, shape (k,),
    if they are given: then only those and the leaves that touch them look.
    """
    leaves = np.flatnonzero(tree.free if of is None else tree.free & tree.touching(of))
    corner, size, center, half = tree.corner[leaves], tree.size[leaves], tree.center, tree.half_size[leaves]
    ends, vias = [], []
    for axis in (0, 1):
        for side in (-1, 1):
            probe = corner + size[:, None] // 2
            probe[:, axis] = corner[:, axis] + (size if side > 0 else -1)
            found = tree.find_cell(probe)
            larger = (found >= 0) & tree.free[found] & (tree.size[found] >= size)
            once = larger & ((tree.size[found] > size) | (side > 0))
            if of is not None:
                once &= of[leaves] | of[found]
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
    old: Quadtree, edges: Edges, tree: Quadtree, obstacles: Tree, radius: float, places: Tree | None
) -> Edges:
    """`find_edges` of a tree that was changed, from those of the `old` one: only leaves at the change look again.

    What proves an edge are obstacles within the radius of its way through its two leaves. So it stands where both are
    as they were, and none of the `places` where obstacles came or went is that near.
    """
    now, same = _same_leaves(*(np.ascontiguousarray(getattr(each, key)) for each in (old, tree) for key in _LEAF))
    if places is not None:
        _feel(places, tree.center, tree.half_size, tree.free & ~tree.whole, radius, same)
    if same.all():
        return edges
    ends, via = _merged_edges(now, same, edges, find_edges(tree, obstacles, radius, ~same), tree.center)
    return ends, via


_LEAF = "code", "size", "free", "whole"
"""What tells a leaf."""


@njit(cache=True, nogil=True)
def _same_leaves(
    code_was: IntArray,
    size_was: IntArray,
    free_was: BoolArray,
    whole_was: BoolArray,
    code: IntArray,
    size: IntArray,
    free: BoolArray,
    whole: BoolArray,
) -> tuple[IntArray, BoolArray]:
    """Number now of each leaf that was, −1 where it is another, and which of the leaves now are as they were."""
    now, same, i = np.full(len(code_was), -1), np.zeros(len(code), np.bool_), 0
    for j in range(len(code_was)):
        while i < len(code) and code[i] < code_was[j]:
            i += 1
        if i == len(code):
            break
        if code[i] == code_was[j] and size[i] == size_was[j] and free[i] == free_was[j] and whole[i] == whole_was[j]:
            now[j], same[i] = i, True
    return now, same


@njit(cache=True, nogil=True)
def _feel(
    places: Tree, center: FloatArray, half_size: FloatArray, asked: BoolArray, radius: float, same: BoolArray
) -> None:
    """Leaves of those `asked` are not the `same` if a place is within the radius of one of theirs, or little more."""
    scratch, low, high = make_scratch(), np.empty(2), np.empty(2)
    for k in range(2):
        low[k], high[k] = places.points[:, k].min(), places.points[:, k].max()
    for i in range(len(asked)):
        if not (asked[i] and same[i]):
            continue
        reach = radius + 3.0 * half_size[i]  # twice half the diagonal: more than the resolution of a proof
        near = low[0] - reach <= center[i, 0] <= high[0] + reach and low[1] - reach <= center[i, 1] <= high[1] + reach
        same[i] = not (near and nearest_at(places, place_of(center[i]), scratch)[0] <= reach)


@njit(cache=True, nogil=True)
def _merged_edges(now: IntArray, same: BoolArray, old: Edges, fresh: Edges, center: FloatArray) -> Edges:
    """The old edges between leaves that are the `same`, and the fresh ones, in the order of `find_edges`."""
    size, used, f = len(old[0]) + len(fresh[0]), 0, 0
    ends, via = np.empty((size, 2), np.int64), np.empty((size, 2))
    for e in range(len(old[0]) + 1):
        last = e == len(old[0])
        a, b = (0, 0) if last else (now[old[0][e, 0]], now[old[0][e, 1]])
        if a < 0 or b < 0 or not (last or (same[a] and same[b])):
            continue
        rank = (4, 0) if last else (_side(old[1][e], center[a]), a)
        while f < len(fresh[0]) and (_side(fresh[1][f], center[fresh[0][f, 0]]), fresh[0][f, 0]) < rank:
            ends[used], via[used] = fresh[0][f], fresh[1][f]
            used, f = used + 1, f + 1
        if not last:
            ends[used, 0], ends[used, 1], via[used] = a, b, old[1][e]
            used += 1
    return ends[:used].copy(), via[:used].copy()


@njit(cache=True, nogil=True)
def _side(via: FloatArray, center: FloatArray) -> int:
    """Across which side of a leaf an edge goes, as `find_edges` looks at them."""
    x, y = via[0] - center[0], via[1] - center[1]
    return 2 + int(y > 0.0) if abs(y) > abs(x) else int(x > 0.0)


def assemble(
    position: FloatArray, level: IntArray, clearance: FloatArray, pairs: IntArray, via: FloatArray, radius: float
) -> Graph:
    """Make a graph of undirected `pairs`, shape (e, 2).

    An edge costs its length times 1 + max(0, 1 − (d − r)/r): up to twice where the body brushes past, once where there
    is as much room beside it as half its width. The factor is at least 1, so the Euclidean heuristic stays admissible.
    """
    rows = _rows(position, clearance, pairs, via, radius)
    component = components(pairs[:, 0], pairs[:, 1], np.ones(len(position), dtype=bool))
    return Graph(np.ascontiguousarray(position), level, *rows, component)


@njit(cache=True, nogil=True)
def _rows(
    position: FloatArray, clearance: FloatArray, pairs: IntArray, via: FloatArray, radius: float
) -> tuple[IntArray, IntArray, FloatArray, FloatArray]:
    """First edge of each node, far end, crossing and cost of each edge."""
    count, size = len(position), 2 * len(pairs)
    first, other, crossing, cost = (
        np.zeros(count + 1, np.int64),
        np.empty(size, np.int64),
        np.empty((size, 2)),
        np.empty(size),
    )
    for a, b in pairs:
        first[a + 1] += 1
        first[b + 1] += 1
    for i in range(count):
        first[i + 1] += first[i]
    place = first[:-1].copy()
    for end in range(2):
        for e in range(len(pairs)):
            a, b = pairs[e, end], pairs[e, 1 - end]
            length = 0.0
            for leaf in pairs[e]:
                length += sqrt((position[leaf, 0] - via[e, 0]) ** 2 + (position[leaf, 1] - via[e, 1]) ** 2)
            room = min(clearance[a], clearance[b]) - radius
            at = place[a]
            place[a] += 1
            other[at], crossing[at, 0], crossing[at, 1] = b, via[e, 0], via[e, 1]
            cost[at] = length * (1.0 + min(max(1.0 - room / radius, 0.0), 1.0))
    return first, other, crossing, cost


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

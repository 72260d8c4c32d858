"""The connectivity graph of the free leaves, over all levels, and A* on it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from math import sqrt
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gpdf_service.fields import Tree
from gpdf_service.fields.threads import run_chunked
from gpdf_service.fields.traversal import nearest_at
from gpdf_service.fields.tree import make_scratch
from gpdf_service.kernel_cache import lean
from gpdf_service.search.landmarks import NO_LANDMARKS, Landmarks, at_least, bounds_to
from gpdf_service.search.layered import Layered
from gpdf_service.search.places import Places, is_straight_clear
from gpdf_service.search.quadtree import Quadtree, center_of, side_of, touching
from gpdf_service.search.resplit import Leaves, centers
from gpdf_service.tiles.nodes import components
from gpdf_service.types import BoolArray, FloatArray, IntArray


class Graph(NamedTuple):
    """Undirected graph in compressed rows. Kernels take it as it is.

    Attributes:
        position: Places of the nodes (x, y) [m], shape (k, 2).
        level: Level of each node, shape (k,).
        first: First edge of each node, shape (k + 1,).
        other: Far end of each edge, shape (e,).
        via: Where the edge crosses from leaf to leaf (x, y) [m], shape (e, 2).
        cost: Length of the edge, weighted by how close it passes [m], shape (e,).
        component: Connected component of each node, shape (k,).
        landmarks: For who searches it.
    """

    position: FloatArray
    level: IntArray
    first: IntArray
    other: IntArray
    via: FloatArray
    cost: FloatArray
    component: IntArray
    landmarks: Landmarks = NO_LANDMARKS

    @property
    def standing(self) -> Graph:
        """Without what moves."""
        return self

    @property
    def patch(self) -> Patch:
        """What is other than in it where something moves."""
        return NO_PATCH


class Patch(NamedTuple):
    """A few nodes of a graph whose edges are others than those that stand, the nodes that were added among them.

    Attributes:
        node: The few, ascending.
        row: 1 + which of the few each node is, 0 where its edges stand; shape (k,), or none if there is no patch.
        first: First edge of each of the few, and how many they have in all.
        other: Far end of each edge; those of a `Graph`, too, the next two.
        via: Where it crosses.
        cost: What it costs.
        position: Places of the nodes that were added (x, y) [m].
        level: Level of each of them.
        component: Connected component of each of them.
    """

    node: IntArray
    row: NDArray[np.int32]
    first: IntArray
    other: IntArray
    via: FloatArray
    cost: FloatArray
    position: FloatArray
    level: IntArray
    component: IntArray


_NONE, _NOWHERE = np.zeros(0, np.int64), np.zeros((0, 2))
NO_PATCH = Patch(
    _NONE, np.zeros(0, np.int32), np.zeros(1, np.int64), _NONE, _NOWHERE, np.zeros(0), _NOWHERE, _NONE, _NONE
)


def _both(name: str) -> cached_property[Layered]:
    """What a `Graph` says of each node or edge, by its number."""
    return cached_property(lambda graph: Layered(getattr(graph.standing, name), getattr(graph.patch, name)))


@dataclass(frozen=True)
class PatchedGraph:
    """A graph in which something moves: nodes and edges of the patch come after those that stand.

    Attributes:
        standing: The graph of what stands, with the components of now.
        patch: What is other than in its rows.
    """

    standing: Graph
    patch: Patch

    position = _both("position")
    level = _both("level")
    other = _both("other")
    via = _both("via")
    cost = _both("cost")
    component = _both("component")


class Net(NamedTuple):
    """Where the edges of a graph lead, for kernels.

    Attributes:
        first: Of a `Graph`, as the next one.
        other: See there.
        row: Of its `Patch`, as the next ones.
        first_more: First edge of each of its nodes.
        more: Far end of each of its edges.
    """

    first: IntArray
    other: IntArray
    row: NDArray[np.int32]
    first_more: IntArray
    more: IntArray


def net_of(graph: Graph | PatchedGraph) -> Net:
    """Where its edges lead."""
    return Net(graph.standing.first, graph.standing.other, graph.patch.row, graph.patch.first, graph.patch.other)


@lean()
def edges_of(net: Net, node: int) -> tuple[int, int]:
    """Number of the first edge of a node and behind its last; those of the patch come after those that stand."""
    row = net.row[node] if len(net.row) > 0 else 0
    if row == 0:
        return net.first[node], net.first[node + 1]
    return len(net.other) + net.first_more[row - 1], len(net.other) + net.first_more[row]


@lean()
def far_end(net: Net, edge: int) -> int:
    """The node that an edge leads to."""
    standing = len(net.other)
    return int(net.other[edge] if edge < standing else net.more[edge - standing])


@njit(cache=True, nogil=True)
def _proven(
    obstacles: Places, center: FloatArray, room: FloatArray, via: FloatArray, radius: float, good: BoolArray
) -> None:
    """Which edges are clear from centre to crossing to centre.

    Of the two leaves of an edge, `center` (e, 2, 2) and `room` (e, 2): how far a place may be from the leaf's centre
    and still be clear [m], inf where all of it is: a wholly free leaf is convex.
    """
    scratch = make_scratch()
    for e in range(len(via)):
        good[e] = True
        for k in range(2):
            far = sqrt((via[e, 0] - center[e, k, 0]) ** 2 + (via[e, 1] - center[e, k, 1]) ** 2)
            good[e] &= room[e, k] >= far or is_straight_clear(obstacles, center[e, k], via[e], radius, scratch)


Edges = tuple[IntArray, FloatArray]
"""Pairs of leaves, shape (e, 2), and where they cross from one to the other (x, y) [m], shape (e, 2)."""


def find_edges(
    tree: Leaves,
    obstacles: Places,
    radius: float,
    leaves: IntArray | None = None,
    wanted: Callable[[IntArray], BoolArray] | None = None,
) -> Edges:
    """Pairs of free leaves that share a side, with a proven passage: ends (e, 2) and crossings (e, 2) [m].

    Every leaf looks once across each of its four sides; the leaf found there is larger, or as large, and then the pair
    is kept once. So each pair of neighbours is found, in time n log n. Only these `leaves` look, if they are given, and
    only pairs with one that is `wanted` are kept.
    """
    leaves = tree.numbers[tree.free[tree.numbers]] if leaves is None else leaves
    corner, size = tree.corner[leaves], tree.size[leaves]
    center, half = centers(tree, leaves), 0.5 * tree.width * size
    ends, vias = [], []
    for axis in (0, 1):
        for side in (-1, 1):
            probe = corner + size[:, None] // 2
            probe[:, axis] = corner[:, axis] + (size if side > 0 else -1)
            found = tree.find_cell(probe)
            width = tree.size[found]
            once = (found >= 0) & tree.free[found] & ((width > size) | ((width == size) & (side > 0)))
            if wanted is not None:
                once &= wanted(leaves) | wanted(found)
            via = center[once]
            via[:, axis] += side * half[once]
            ends.append(np.column_stack([leaves[once], found[once]]))
            vias.append(via)
    pairs, via = np.concatenate(ends), np.concatenate(vias)
    good = np.ones(len(pairs), dtype=bool)
    asked = np.flatnonzero(~tree.whole[pairs].all(axis=1))  # a way through wholly free leaves is clear
    ends_of = pairs[asked]
    room = np.where(tree.whole[ends_of], np.inf, tree.clearance[ends_of] - radius)
    center, proven = centers(tree, ends_of.ravel()).reshape(-1, 2, 2), np.zeros(len(asked), dtype=bool)
    at = via[asked]

    def prove(a: int, b: int) -> None:
        _proven(obstacles, center[a:b], room[a:b], at[a:b], radius, proven[a:b])

    run_chunked(prove, len(asked))
    good[asked] = proven
    return pairs[good], via[good]


def change_edges(
    edges: Edges, leaves: SameLeaves, tree: Quadtree, obstacles: Places, radius: float, places: Tree | None
) -> Edges:
    """`find_edges` of a tree that was changed, from those before: only leaves at the change look again.

    What proves an edge are obstacles within the radius of its way through its two leaves. So it stands where both are
    as they were, `same_leaves`, and none of the `places` where obstacles came or went is that near.
    """
    now, was = leaves
    same = was >= 0
    if places is not None:
        _feel(places, tree, radius, same)
    if same.all():
        return edges
    fresh = ~same
    looking = np.flatnonzero(tree.free & touching(tree, fresh))
    found = find_edges(tree, obstacles, radius, looking, fresh.__getitem__)
    size = len(edges[0]) + len(found[0])
    made = np.empty((size, 2), np.int64), np.empty((size, 2))  # by NumPy, which asks for large pages
    used = _merge_edges(now, same, edges, found, tree, made)
    return made[0][:used], made[1][:used]


SameLeaves = tuple[IntArray, IntArray]
"""Number now of each leaf that was, −1 where it is another, and the number then of each leaf now."""


@njit(cache=True, nogil=True)
def same_leaves(old: Quadtree, tree: Quadtree) -> SameLeaves:
    """Which leaves of two trees are the same ones: both in turn, by their codes."""
    now, was, i = np.full(len(old.code), -1), np.full(len(tree.code), -1), 0
    if (old.origin != tree.origin).any() or side_of(old) != side_of(tree):
        return now, was
    for k in range(len(tree.code)):
        while i < len(old.code) and old.code[i] < tree.code[k]:
            i += 1
        if i == len(old.code):
            break
        alike = old.code[i] == tree.code[k] and old.size[i] == tree.size[k]
        if alike and old.free[i] == tree.free[k] and old.whole[i] == tree.whole[k]:
            now[i], was[k] = k, i
    return now, was


@njit(cache=True, nogil=True)
def _feel(places: Tree, tree: Quadtree, radius: float, same: BoolArray) -> None:
    """Leaves that are free in part are not the `same` if a place is within the radius of one of theirs, or more."""
    scratch, low, high = make_scratch(), np.empty(2), np.empty(2)
    for k in range(2):
        low[k], high[k] = places.points[:, k].min(), places.points[:, k].max()
    for i in range(len(same)):
        if tree.whole[i] or not (tree.free[i] and same[i]):
            continue
        reach = radius + 1.5 * tree.width * tree.size[i]  # twice half the diagonal: more than a proof's resolution
        x, y = center_of(tree, i)
        near = low[0] - reach <= x <= high[0] + reach and low[1] - reach <= y <= high[1] + reach
        same[i] = not (near and nearest_at(places, (x, y, 0.0), scratch)[0] <= reach)


@njit(cache=True, nogil=True)
def _merge_edges(now: IntArray, same: BoolArray, old: Edges, fresh: Edges, tree: Quadtree, made: Edges) -> int:
    """Write old edges between leaves that are the `same`, and fresh ones, as `find_edges` orders them; how many."""
    (ends, via), used, f = made, 0, 0
    for e in range(len(old[0]) + 1):
        last = e == len(old[0])
        a, b = (0, 0) if last else (now[old[0][e, 0]], now[old[0][e, 1]])
        if a < 0 or b < 0 or not (last or (same[a] and same[b])):
            continue
        rank = (4, 0) if last else (_side(old[1][e], tree, a), a)
        while f < len(fresh[0]) and (_side(fresh[1][f], tree, fresh[0][f, 0]), fresh[0][f, 0]) < rank:
            ends[used], via[used] = fresh[0][f], fresh[1][f]
            used, f = used + 1, f + 1
        if not last:
            ends[used, 0], ends[used, 1], via[used] = a, b, old[1][e]
            used += 1
    return used


@njit(cache=True, nogil=True)
def _side(via: FloatArray, tree: Quadtree, leaf: int) -> int:
    """Across which side of a leaf an edge goes, as `find_edges` looks at them."""
    center = center_of(tree, leaf)
    x, y = via[0] - center[0], via[1] - center[1]
    return 2 + int(y > 0.0) if abs(y) > abs(x) else int(x > 0.0)


def assemble(position: FloatArray, level: IntArray, edges: Edges, cost: FloatArray) -> Graph:
    """Make a graph of undirected `edges`, each of which costs the same both ways, shape (e,)."""
    (pairs, _), first, size = edges, np.zeros(len(position) + 1, np.int64), 2 * len(cost)
    made = np.empty(size, np.int64), np.empty((size, 2)), np.empty(size)  # by NumPy, which asks for large pages
    _put_rows(edges, cost, first, made)
    component = components(pairs[:, 0], pairs[:, 1], np.ones(len(position), dtype=bool))
    return Graph(np.ascontiguousarray(position), level, first, *made, component)


@njit(cache=True, nogil=True)
def _put_rows(edges: Edges, cost: FloatArray, first: IntArray, made: tuple[IntArray, FloatArray, FloatArray]) -> None:
    """Write the first edge of each node, and the far end, crossing and cost of each edge."""
    (pairs, via), (other, crossing, costs) = edges, made
    for e in range(len(pairs)):
        first[pairs[e, 0] + 1] += 1
        first[pairs[e, 1] + 1] += 1
    for i in range(len(first) - 1):
        first[i + 1] += first[i]
    place = first[:-1].copy()
    for end in range(2):
        for e in range(len(pairs)):
            at = place[pairs[e, end]]
            place[pairs[e, end]] += 1
            other[at], crossing[at, 0], crossing[at, 1], costs[at] = pairs[e, 1 - end], via[e, 0], via[e, 1], cost[e]


@njit(cache=True, nogil=True)
def price_pairs(position: FloatArray, clearance: FloatArray, edges: Edges, radius: float) -> FloatArray:
    """Cost of edges [m], shape (e,), between nodes, of all of which place [m] and clearance [m] are given.

    An edge costs its length times 1 + max(0, 1 − (d − r)/r): up to twice where the body brushes past, once where there
    is as much room beside it as half its width. The factor is at least 1, so the Euclidean heuristic stays admissible.
    """
    (pairs, via), cost = edges, np.empty(len(edges[1]))
    for e in range(len(pairs)):
        length, room = 0.0, np.inf
        for k in range(2):
            x, y = position[pairs[e, k], 0] - via[e, 0], position[pairs[e, k], 1] - via[e, 1]
            length, room = length + sqrt(x * x + y * y), min(room, clearance[pairs[e, k]])
        cost[e] = length * (1.0 + min(max(1.0 - (room - radius) / radius, 0.0), 1.0))
    return cost


class Doors(NamedTuple):
    """Nodes by which a search may begin or end, shape (k,), and what it costs to get there, shape (k,)."""

    node: IntArray
    cost: FloatArray


def find_path(graph: Graph, start: int, goal: int) -> IntArray:
    """A*: the edges from `start` to `goal` in order, shape (k,); empty if start is goal.

    Start and goal must lie in one component.
    """
    at = [Doors(np.array([node]), np.zeros(1)) for node in (start, goal)]
    return find_way(graph, at[0], at[1], graph.position[goal])[1]


def find_way(graph: Graph, begin: Doors, end: Doors, goal: FloatArray, rate: float = 1.0) -> tuple[int, IntArray]:
    """The node that the cheapest way begins with, and its edges in order, shape (k,); −1 where there is none.

    A metre of an edge, and of the way from an end's door to the `goal` (2,) [m], costs at least the `rate`.
    """
    first, edges = astar(Question(graph, begin, end, goal, rate))
    return int(first), edges


class Question(NamedTuple):
    """What A* is asked: see `find_way`."""

    graph: Graph
    begin: Doors
    end: Doors
    goal: FloatArray
    rate: float


KNOWN = np.dtype([("cost_to_come", np.float64), ("came_by", np.int32), ("came_from", np.int32), ("at", np.int64)])
"""What A* knows of a node. `came_by`: 1 + the edge by which the cheapest way came; 0 where nobody has been, −1 at a
source. `came_from`: the node before. `at`: 1 + where in the heap it is, 0 if it is not."""


class Front(NamedTuple):
    """What A* knows of each node, and the nodes that wait, as a heap that knows where each of them is.

    Attributes:
        known: What is known of each node, side by side, as few of them are in the processor's cache; shape (n,).
        heap: Nodes, each of them before the two behind twice its place; shape (n,).
        estimate: Cost of a way over each of these, shape (n,).
        size: How many there are, shape (1,).
    """

    known: NDArray[Any]
    heap: NDArray[np.int32]
    estimate: FloatArray
    size: IntArray


@lean()
def _is_before(front: Front, estimate: float, node: int, row: int) -> bool:
    """Whether a node with that estimate comes before the one in a row of the heap; of equal ones the nearer start."""
    if estimate != front.estimate[row]:
        return bool(estimate < front.estimate[row])
    come, other = front.known[node].cost_to_come, front.known[front.heap[row]].cost_to_come
    return bool(come < other or (come == other and node < front.heap[row]))


@lean()
def _put(front: Front, row: int, node: int, estimate: float) -> None:
    """Put a node into a row of the heap."""
    front.heap[row], front.estimate[row], front.known[node].at = node, estimate, row + 1


@lean()
def _wait(front: Front, estimate: float, node: int) -> None:
    """Put a node into the heap, or forward in it."""
    row = front.known[node].at - 1
    if row < 0:
        row = front.size[0]
        front.size[0] += 1
    while row > 0:
        up = (row - 1) >> 1
        if not _is_before(front, estimate, node, up):
            break
        _put(front, row, front.heap[up], front.estimate[up])
        row = up
    _put(front, row, node, estimate)


@lean()
def _next(front: Front) -> int:
    """Take the first node from the heap."""
    first, size = front.heap[0], front.size[0] - 1
    front.size[0], front.known[first].at = size, 0
    node, estimate, row = front.heap[size], front.estimate[size], 0
    while 2 * row + 1 < size:
        down = 2 * row + 1
        if down + 1 < size and _is_before(front, front.estimate[down + 1], front.heap[down + 1], down):
            down += 1
        if _is_before(front, estimate, node, down):
            break
        _put(front, row, front.heap[down], front.estimate[down])
        row = down
    if size > 0:
        _put(front, row, node, estimate)
    return int(first)


@njit(cache=True, nogil=True)
def astar(question: Question) -> tuple[int, IntArray]:
    """See `find_way`."""
    count = len(question.graph.position)
    n = count + 1  # the last is the goal itself; pages that nobody visits cost nothing
    front = Front(np.zeros(n, KNOWN), np.empty(n, np.int32), np.empty(n), np.zeros(1, np.int64))
    bounds = bounds_to(question.graph.landmarks, question.end.node, question.end.cost)
    _spread(question, bounds, front)
    edges = [0 for _ in range(0)]
    if front.known[count].came_by == 0:
        return -1, np.array(edges, dtype=np.int64)
    node = np.int64(front.known[count].came_from)
    while front.known[node].came_by > 0:
        edges.append(int(front.known[node].came_by - 1))
        node = np.int64(front.known[node].came_from)
    return int(node), np.array(edges[::-1], dtype=np.int64)


@lean(inline="always")
def _come(question: Question, bounds: FloatArray, front: Front, node: int, come: float, by: int, before: int) -> None:
    """Let a node wait that is reached at a cost, `by` an edge from the one `before`, if that is the cheapest so far."""
    known, position, goal = front.known[node], question.graph.position, question.goal
    if known.came_by == 0 or come < known.cost_to_come:
        known.cost_to_come, known.came_by, known.came_from = come, by, before
        far = 0.0
        if node < len(position):  # not the goal itself
            straight = question.rate * sqrt((position[node, 0] - goal[0]) ** 2 + (position[node, 1] - goal[1]) ** 2)
            far = max(straight, at_least(question.graph.landmarks, bounds, node))
        _wait(front, come + far, node)


@lean()
def _spread(question: Question, bounds: FloatArray, front: Front) -> None:
    """The search itself: until the goal is the next node, or none is left that leads there."""
    graph, begin, end = question.graph, question.begin, question.end
    goal_node = len(graph.position)
    for k in range(len(begin.node)):
        _come(question, bounds, front, begin.node[k], begin.cost[k], -1, 0)
    while front.size[0] > 0:
        estimate, node = front.estimate[0], _next(front)
        if node == goal_node or estimate == np.inf:
            break
        come = front.known[node].cost_to_come
        for k in range(len(end.node)):
            if end.node[k] == node:
                _come(question, bounds, front, goal_node, come + end.cost[k], 1, node)
        for e in range(graph.first[node], graph.first[node + 1]):
            _come(question, bounds, front, graph.other[e], come + graph.cost[e], e + 1, node)

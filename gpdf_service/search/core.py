"""The nodes that ways lead over: narrow leaves beside wider ones are left out, a narrow passage keeps a chain of them.

A quadtree has most of its leaves along obstacles, where they are the narrowest, and few ways need them. A narrow leaf
is left out if what is left of its neighbours is joined without it, those nearest to obstacles first. So what was joined
stays joined. From a leaf that was left out an edge leads up to another one, and so to the core.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit

from gpdf_service.search.graph import Graph, Patch, Question, astar, find_path
from gpdf_service.search.landmarks import Landmarks
from gpdf_service.search.layered import below
from gpdf_service.types import BoolArray, FloatArray, IntArray

NARROW = 0.1
"""[m] Leaves that are wider all stay: the optimiser's waypoints lie further apart."""
_MOST_NEIGHBOURS = 64
"""A leaf with more stays."""


@dataclass(frozen=True, slots=True)
class Core:
    """What is left of a graph.

    Attributes:
        node: Number in the whole graph of each node that is left, ascending, shape (k,).
        edge: The same of each edge, shape (e,).
        graph: What is left, numbered anew.
        up: The edge of the whole graph that leads up from each of its nodes; −1 for those that are left, shape (n,).
    """

    node: IntArray
    edge: IntArray
    graph: Graph
    up: IntArray

    def has(self, node: IntArray) -> BoolArray:
        """Which nodes of the whole graph are left."""
        made: BoolArray = self.node[np.minimum(self.number(node), len(self.node) - 1)] == node
        return made

    def number(self, node: IntArray) -> IntArray:
        """The number here of nodes that are left."""
        return np.searchsorted(self.node, node)


class Links(NamedTuple):
    """A graph of leaves, as far as it tells which ones ways need.

    Attributes:
        first: First edge of each node, shape (n + 1,).
        other: Far end of each edge, shape (e,).
        clearance: From a node's centre to the nearest obstacle [m], shape (n,).
        narrow: Whether it is free and narrow, shape (n,).
    """

    first: IntArray
    other: IntArray
    clearance: FloatArray
    narrow: BoolArray


class Decided(NamedTuple):
    """Whether each node stays, and the edge that leads up from it, −1 if it stays, shapes (n,)."""

    stays: BoolArray
    up: IntArray


@dataclass(frozen=True, slots=True)
class Former:
    """What was decided in the version before; the `source` is the node then of each node now, −1 of a new one."""

    links: Links
    decided: Decided
    source: IntArray


def links_of(graph: Graph, free: BoolArray, width: FloatArray, clearance: FloatArray) -> Links:
    """The links of a graph of leaves that are so wide [m]; all of shape (n,)."""
    return Links(graph.first, below(graph.other), clearance, free & (width < NARROW))


def find_core(graph: Graph, free: BoolArray, links: Links, former: Former | None = None) -> Core:
    """What ways need of a graph of leaves.

    Args:
        graph: Of what stands.
        free: Which leaves are free, shape (n,).
        links: Of the graph.
        former: The version before; only what differs from it, and what that decides on, is decided again.
    """
    made, asked = Decided(free.copy(), np.full(len(free), -1)), links.narrow
    if former is not None:
        asked = _carry(links, former.links, former.source, former.decided, made)
    order = np.flatnonzero(asked)
    _thin(links, order[np.argsort(links.clearance[order], kind="stable")], made)
    node = np.flatnonzero(made.stays)
    edge, begin, far = _left(links, made.stays, node)
    kept = far, graph.via[edge], graph.cost[edge], graph.component[node]
    return Core(node, edge, Graph(graph.position[node], graph.level[node], begin, *kept), made.up)


@njit(cache=True, nogil=True)
def _left(links: Links, stays: BoolArray, node: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    """Edges between nodes that stay, where those of each of these begin, and their far ends by their new numbers."""
    first, other = links.first, links.other
    number, count = np.empty(len(stays), np.int64), 0
    for k in range(len(node)):
        number[node[k]] = k
        count += first[node[k] + 1] - first[node[k]]
    edge, begin, far = np.empty(count, np.int64), np.zeros(len(node) + 1, np.int64), np.empty(count, np.int64)
    count = 0
    for k in range(len(node)):
        for e in range(first[node[k]], first[node[k] + 1]):
            if stays[other[e]]:
                edge[count], far[count] = e, number[other[e]]
                count += 1
        begin[k + 1] = count
    return edge[:count].copy(), begin, far[:count].copy()


@njit(cache=True, nogil=True)
def _carry(now: Links, was: Links, source: IntArray, known: Decided, made: Decided) -> BoolArray:
    """Take over what was `known`; which nodes are to be decided on again: narrow ones within two edges of another."""
    asked = np.zeros(len(source), np.bool_)
    for node in range(len(source)):
        old, begin, count = source[node], now.first[node], now.first[node + 1] - now.first[node]
        same = old >= 0 and now.narrow[node] == was.narrow[old] and now.clearance[node] == was.clearance[old]
        same = same and was.first[old + 1] - was.first[old] == count
        for k in range(count if same else 0):
            same &= source[now.other[begin + k]] == was.other[was.first[old] + k]
        if same and now.narrow[node]:
            made.stays[node] = known.stays[old]
            made.up[node] = known.up[old] + begin - was.first[old] if known.up[old] >= 0 else -1
        if same:
            continue
        asked[node] |= now.narrow[node]
        for e in range(begin, begin + count):
            near = now.other[e]
            asked[near] |= now.narrow[near]
            for f in range(now.first[near], now.first[near + 1]):
                asked[now.other[f]] |= now.narrow[now.other[f]]
    return asked


@njit(cache=True, nogil=True)
def _thin(links: Links, order: IntArray, made: Decided) -> None:
    """Leave out nodes one after the other, where that parts none of their neighbours that are left.

    Those nearest to obstacles come first. The nodes in `order` are decided on, and those that such a decision changes.
    """
    first, other, clearance, stays = links.first, links.other, links.clearance, made.stays
    near, later, at = np.empty(_MOST_NEIGHBOURS, np.int64), [(0.0, 0)], 0
    later.clear()
    asked = np.zeros(len(stays), np.bool_)
    asked[order] = True
    while at < len(order) or len(later) > 0:
        if len(later) == 0 or (at < len(order) and (clearance[order[at]], order[at]) < later[0]):
            node, at = order[at], at + 1
        else:
            node = heapq.heappop(later)[1]
        turn, count, best = (clearance[node], node), 0, -1
        for e in range(first[node], first[node + 1]):
            if not _is_left(links, stays, other[e], turn):
                continue
            if count < _MOST_NEIGHBOURS:
                near[count] = other[e]
            count += 1
            if best < 0 or clearance[other[e]] > clearance[other[best]]:
                best = e
        goes = 0 < count <= _MOST_NEIGHBOURS and _are_joined(links, stays, near[:count], turn)
        if stays[node] == goes:
            _ask_around(links, turn, asked, later)
        stays[node], made.up[node] = not goes, best if goes else -1


@njit(cache=True, nogil=True)
def _ask_around(links: Links, turn: tuple[float, int], asked: BoolArray, later: list[tuple[float, int]]) -> None:
    """Let the narrow nodes at most two edges away whose turn is later be decided on, too."""
    first, other = links.first, links.other
    for e in range(first[turn[1]], first[turn[1] + 1]):
        for f in range(first[other[e]], first[other[e] + 1]):
            for node in (other[e], other[f]):
                if links.narrow[node] and not asked[node] and (links.clearance[node], node) > turn:
                    asked[node] = True
                    heapq.heappush(later, (links.clearance[node], node))


@njit(cache=True, nogil=True)
def _is_left(links: Links, stays: BoolArray, node: int, turn: tuple[float, int]) -> bool:
    """Whether a node is left at the `turn` of one with that clearance and number: it stays, or its turn is later."""
    return bool(stays[node] or (links.narrow[node] and (links.clearance[node], node) > turn))


@njit(cache=True, nogil=True)
def _are_joined(links: Links, stays: BoolArray, near: IntArray, turn: tuple[float, int]) -> bool:
    """Whether nodes lead to each other without the one whose turn it is, directly or by one between two of them."""
    first, other = links.first, links.other
    seen, stack = np.zeros(len(near), np.bool_), np.empty(len(near), np.int64)
    stack[0], seen[0], top, count = near[0], True, 1, 1
    for k in range(1, len(near)):  # two edges may lead to one node
        if near[k] == near[0]:
            seen[k], count = True, count + 1
    while top > 0 and count < len(near):
        top -= 1
        node = stack[top]
        for e in range(first[node], first[node + 1]):
            between = other[e]
            if between == turn[1] or not _is_left(links, stays, between, turn):
                continue
            for k in range(len(near)):
                if seen[k] or not (near[k] == between or _has_edge(first, other, between, near[k])):
                    continue
                seen[k], count = True, count + 1
                stack[top] = near[k]
                top += 1
    return count == len(near)


@njit(cache=True, nogil=True)
def _has_edge(first: IntArray, other: IntArray, node: int, to: int) -> bool:
    for e in range(first[node], first[node + 1]):  # noqa: SIM110 - compiled
        if other[e] == to:
            return True
    return False


def climb(graph: Graph, core: Core, node: int) -> tuple[IntArray, IntArray]:
    """From a node up to the core: the nodes (k + 1,) and the edges between them (k,) of the whole graph."""
    nodes, edges = [node], []
    while core.up[nodes[-1]] >= 0:
        edges.append(int(core.up[nodes[-1]]))
        nodes.append(int(graph.other[edges[-1]]))
    return np.array(nodes), np.array(edges, dtype=np.int64)


def find_nodes(graph: Graph, core: Core | None, start: int, goal: int) -> tuple[IntArray, FloatArray]:
    """A way from node to node: its nodes (n,), and where it crosses from one to the next (n − 1, 2) [m].

    It is the cheapest one, but for narrow leaves that were left out, if there is a core.
    """
    if core is None:
        edges = find_path(graph, start, goal)
        return np.concatenate([[start], graph.other[edges]]), graph.via[edges]
    left = core.graph
    asked = below(left.position), left.first, below(left.other), below(left.cost), left.patch, left.landmarks
    found: tuple[IntArray, FloatArray] = _find_nodes(
        (core.up, core.node, core.edge), asked, below(graph.other), below(graph.via), start, goal
    )
    return found


@njit(cache=True, nogil=True)
def _find_nodes(
    core: tuple[IntArray, IntArray, IntArray],
    left: tuple[FloatArray, IntArray, IntArray, FloatArray, Patch, Landmarks],
    other: IntArray,
    via: FloatArray,
    start: int,
    goal: int,
) -> tuple[IntArray, FloatArray]:
    """See `find_nodes`: up to the core, over what is left, and down again."""
    up, node, edge = core
    position, first, near, cost, patch, landmarks = left
    ends, height, free = np.empty(2, np.int64), np.zeros(2, np.int64), np.zeros(1)
    for k, at in enumerate((start, goal)):
        while up[at] >= 0:
            at, height[k] = other[up[at]], height[k] + 1
        ends[k] = np.searchsorted(node, at)
    place = position[ends[1]]
    question = Question(position, first, near, cost, patch, landmarks, 1.0, ends[:1], free, ends[1:], free, place)
    over = astar(question, len(position))[1]
    count = height[0] + len(over) + height[1]
    nodes, crossings = np.empty(count + 1, np.int64), np.empty((count, 2))
    nodes[0], nodes[count] = start, goal
    for k in range(height[0] + len(over)):
        e = up[nodes[k]] if k < height[0] else edge[over[k - height[0]]]
        nodes[k + 1], crossings[k] = other[e], via[e]
    for k in range(height[1]):
        e = up[nodes[count - k]]
        nodes[count - k - 1], crossings[count - k - 1] = other[e], via[e]
    return nodes, crossings

"""The nodes that ways lead over: narrow leaves beside wider ones are left out, a narrow passage keeps a chain of them.

A quadtree has most of its leaves along obstacles, where they are the narrowest, and few ways need them. A narrow leaf
is left out if what is left of its neighbours is joined without it, those nearest to obstacles first. So what was joined
stays joined. From a leaf that was left out an edge leads up to another one, and so to the core.
"""

from __future__ import annotations

import heapq
from typing import NamedTuple

import numpy as np
from numba import njit

from gpdf_service.kernel_cache import lean
from gpdf_service.search.graph import Doors, Graph, Net, PatchedGraph, Question, astar, edges_of, far_end, net_of
from gpdf_service.search.layered import Layered
from gpdf_service.types import BoolArray, FloatArray, IntArray

NARROW = 0.1
"""[m] Leaves that are wider all stay: the optimiser's waypoints lie further apart."""
_MOST_NEIGHBOURS = 64
"""A leaf with more stays."""


class Links(NamedTuple):
    """A graph of leaves, as far as it tells which ones ways need.

    Attributes:
        net: Where its edges lead.
        clearance: From the centre of a node that stands to the nearest obstacle [m].
        added: The same of each of those that were added [m], and where it comes among those that stand, by their
            numbers: equal ones take turns by that; shape (m, 2).
        narrow: Whether a node is free and narrow, shape (n,).
    """

    net: Net
    clearance: FloatArray
    added: FloatArray
    narrow: BoolArray

    @property
    def room(self) -> Layered:
        """From the centre of each node to the nearest obstacle [m], shape (n,)."""
        return Layered(self.clearance, self.added[:, 0])


_Turn = tuple[float, float, int]
"""Of a node: its clearance, its place among the others, its number."""


@lean()
def _turn(links: Links, node: int) -> _Turn:
    """When a node is decided on: those nearest to obstacles come first."""
    count = len(links.clearance)
    if node < count:
        return links.clearance[node], float(node), node
    return links.added[node - count, 0], links.added[node - count, 1], node


class Decided(NamedTuple):
    """Whether each node stays, and the edge that leads up from it, −1 if it stays, shapes (n,)."""

    stays: BoolArray
    up: IntArray


class Core(NamedTuple):
    """What is left of a graph.

    Attributes:
        node: Number in the whole graph of each node that is left, ascending, shape (k,).
        edge: The same of each edge, shape (e,).
        graph: What is left, numbered anew.
        links: Of the whole graph.
        decided: What was decided on each of its nodes.
    """

    node: IntArray
    edge: IntArray
    graph: Graph
    links: Links
    decided: Decided

    @property
    def clearance(self) -> FloatArray:
        """From the centre of each node that is left to the nearest obstacle [m], shape (k,)."""
        made: FloatArray = self.links.room[self.node]
        return made


Former = tuple[Core, IntArray]
"""The core of the version before, and the node then of each node now, −1 of a new one."""


def find_core(
    graph: Graph, free: BoolArray, width: FloatArray, clearance: FloatArray, former: Former | None = None
) -> Core:
    """What ways need of a graph of leaves that are `free`, so wide [m], and so far from obstacles [m]; all (n,).

    Of a `former` version only what differs from it, and what that decides on, is decided again.
    """
    links = Links(net_of(graph), clearance, np.zeros((0, 2)), free & (width < NARROW))
    made, asked = Decided(free.copy(), np.full(len(free), -1, np.int32)), links.narrow
    if former is not None:
        asked = _carry(links, former[0].links, former[1], former[0].decided, made)
    return _decide(graph, links, made, np.flatnonzero(asked))


def patch_core(core: Core, graph: PatchedGraph, gone: IntArray, added: FloatArray, width: FloatArray) -> Core:
    """The core of a graph with a patch: only what is in that, and what it decides on, is decided again.

    The `core` is that of what stands, of which nodes are `gone`; leaves so wide [m], (m,), were `added`, (m, 2): see
    `Links`.
    """
    was, (stays, up) = core.links, core.decided
    made = Decided(np.append(stays, np.ones(len(added), dtype=bool)), np.append(up, np.full(len(added), -1, np.int32)))
    made.stays[gone] = False
    links = was._replace(net=net_of(graph), added=added, narrow=np.append(was.narrow, width < NARROW))
    asked = np.zeros(len(links.narrow), dtype=bool)
    _ask_near(links, graph.patch.node, asked)
    return _decide(graph, links, made, np.flatnonzero(asked))


def _decide(graph: Graph | PatchedGraph, links: Links, made: Decided, asked: IntArray) -> Core:
    """Decide on the nodes that are `asked`, ascending, and write what is `made` of them."""
    count = len(links.clearance)
    place = np.append(asked[asked < count], links.added[asked[asked >= count] - count, 1])
    _thin(links, asked[np.lexsort((place, links.room[asked]))], made)
    node: IntArray = np.flatnonzero(made.stays)
    first, edge, far = _left(links.net, made.stays, node)
    via, cost = graph.via[edge], graph.cost[edge]
    left = Graph(graph.position[node], graph.level[node], first, far, via, cost, graph.component[node])
    return Core(node, edge, left, links, made)


_Both = tuple[FloatArray, FloatArray]
"""Of edges that stand, and of those of a patch."""


@njit(cache=True, nogil=True)
def _left(net: Net, stays: BoolArray, node: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    """Where the edges of each node that stays begin, those between such nodes, and their far ends."""
    number, count = np.empty(len(stays), np.int32), 0
    for k in range(len(node)):
        number[node[k]] = k
        begin, end = edges_of(net, node[k])
        count += end - begin
    edge, first, far = np.empty(count, np.int64), np.zeros(len(node) + 1, np.int64), np.empty(count, np.int64)
    count = 0
    for k in range(len(node)):
        for e in range(*edges_of(net, node[k])):
            near = far_end(net, e)
            if stays[near]:
                edge[count], far[count], count = e, number[near], count + 1
        first[k + 1] = count
    return first, edge[:count].copy(), far[:count].copy()


@njit(cache=True, nogil=True)
def _carry(now: Links, was: Links, source: IntArray, known: Decided, made: Decided) -> BoolArray:
    """Take over what was `known`; which nodes are to be decided on again: narrow ones within two edges of another."""
    asked, other = np.zeros(len(source), np.bool_), np.zeros(len(source), np.bool_)
    first, far, first_was, far_was = now.net.first, now.net.other, was.net.first, was.net.other
    for node in range(len(source)):
        old, begin, count = source[node], first[node], first[node + 1] - first[node]
        same = old >= 0 and now.narrow[node] == was.narrow[old] and now.clearance[node] == was.clearance[old]
        same = same and first_was[old + 1] - first_was[old] == count
        for k in range(count if same else 0):
            same &= source[far[begin + k]] == far_was[first_was[old] + k]
        if same and now.narrow[node]:
            made.stays[node] = known.stays[old]
            made.up[node] = known.up[old] + begin - first_was[old] if known.up[old] >= 0 else -1
        other[node] = not same
    _ask_near(now, np.flatnonzero(other), asked)
    return asked


@njit(cache=True, nogil=True)
def _ask_near(links: Links, nodes: IntArray, asked: BoolArray) -> None:
    """Mark the narrow ones of these nodes, and of those within two edges of them."""
    for node in nodes:
        asked[node] |= links.narrow[node]
        for e in range(*edges_of(links.net, node)):
            near = far_end(links.net, e)
            asked[near] |= links.narrow[near]
            for f in range(*edges_of(links.net, near)):
                asked[far_end(links.net, f)] |= links.narrow[far_end(links.net, f)]


@njit(cache=True, nogil=True)
def _thin(links: Links, order: IntArray, made: Decided) -> None:
    """Leave out nodes one after the other, where that parts none of their neighbours that are left.

    Those nearest to obstacles come first. The nodes in `order` are decided on, and those that such a decision changes.
    A node leads up to the roomiest of these neighbours, of equal ones to the one that comes last.
    """
    stays, near, later, at = made.stays, np.empty(_MOST_NEIGHBOURS, np.int64), [(0.0, 0.0, 0)], 0
    later.clear()
    asked = np.zeros(len(stays), np.bool_)
    asked[order] = True
    while at < len(order) or len(later) > 0:
        if len(later) == 0 or (at < len(order) and _turn(links, order[at]) < later[0]):
            turn, at = _turn(links, order[at]), at + 1
        else:
            turn = heapq.heappop(later)
        node, count, best, most = turn[2], 0, -1, turn
        for e in range(*edges_of(links.net, node)):
            other = far_end(links.net, e)
            if not _is_left(links, stays, other, turn):
                continue
            if count < _MOST_NEIGHBOURS:
                near[count] = other
            count += 1
            if best < 0 or _turn(links, other) > most:
                best, most = e, _turn(links, other)
        goes = 0 < count <= _MOST_NEIGHBOURS and _are_joined(links, stays, near[:count], turn)
        if stays[node] == goes:
            _ask_around(links, turn, asked, later)
        stays[node], made.up[node] = not goes, best if goes else -1


@njit(cache=True, nogil=True)
def _ask_around(links: Links, turn: _Turn, asked: BoolArray, later: list[_Turn]) -> None:
    """Let the narrow nodes at most two edges away whose turn is later be decided on, too."""
    for e in range(*edges_of(links.net, turn[2])):
        near = far_end(links.net, e)
        for f in range(*edges_of(links.net, near)):
            for node in (near, far_end(links.net, f)):
                if links.narrow[node] and not asked[node] and _turn(links, node) > turn:
                    asked[node] = True
                    heapq.heappush(later, _turn(links, node))


@lean()
def _is_left(links: Links, stays: BoolArray, node: int, turn: _Turn) -> bool:
    """Whether a node is left at the `turn` of another one: it stays, or its turn is later."""
    return bool(stays[node] or (links.narrow[node] and _turn(links, node) > turn))


@njit(cache=True, nogil=True)
def _are_joined(links: Links, stays: BoolArray, near: IntArray, turn: _Turn) -> bool:
    """Whether nodes lead to each other without the one whose turn it is, directly or by one between two of them."""
    seen, stack = np.zeros(len(near), np.bool_), np.empty(len(near), np.int64)
    stack[0], seen[0], top, count = near[0], True, 1, 1
    for k in range(1, len(near)):  # two edges may lead to one node
        if near[k] == near[0]:
            seen[k], count = True, count + 1
    while top > 0 and count < len(near):
        top -= 1
        for e in range(*edges_of(links.net, stack[top])):
            between = far_end(links.net, e)
            if between == turn[2] or not _is_left(links, stays, between, turn):
                continue
            for k in range(len(near)):
                if seen[k] or not (near[k] == between or _has_edge(links, between, near[k])):
                    continue
                seen[k], count = True, count + 1
                stack[top] = near[k]
                top += 1
    return count == len(near)


@lean()
def _has_edge(links: Links, node: int, to: int) -> bool:
    for e in range(*edges_of(links.net, node)):  # noqa: SIM110 - compiled
        if far_end(links.net, e) == to:
            return True
    return False


def climb(graph: Graph | PatchedGraph, core: Core, node: int) -> tuple[IntArray, IntArray]:
    """From a node up to the core: the nodes (k + 1,) and the edges between them (k,) of the whole graph."""
    nodes, edges = [node], []
    while core.decided.up[nodes[-1]] >= 0:
        edges.append(int(core.decided.up[nodes[-1]]))
        nodes.append(int(graph.other[edges[-1]]))
    return np.array(nodes), np.array(edges, dtype=np.int64)


def tops_of(core: Core, nodes: IntArray) -> IntArray:
    """The numbers in the core of the nodes that those of the whole graph lead up to, shape (k,); see `climb`."""
    made: IntArray = np.searchsorted(core.node, _tops_of(core.links.net, core.decided.up, nodes))
    return made


@njit(cache=True, nogil=True)
def _tops_of(net: Net, up: IntArray, nodes: IntArray) -> IntArray:
    """Where the edges `up` lead from some nodes."""
    made = nodes.copy()
    for k in range(len(made)):
        while up[made[k]] >= 0:
            made[k] = far_end(net, up[made[k]])
    return made


class Search(NamedTuple):
    """What `find_nodes` asks of a graph: its core; crossings, places and levels that stand, and those of the patch."""

    core: Core
    via: _Both
    place: _Both
    level: tuple[IntArray, IntArray]


def search_in(graph: Graph | PatchedGraph, core: Core) -> Search:
    """A graph and its core as they are searched."""
    stands, more = graph.standing, graph.patch
    return Search(core, (stands.via, more.via), (stands.position, more.position), (stands.level, more.level))


@njit(cache=True, nogil=True)
def find_nodes(search: Search, start: int, goal: int) -> tuple[IntArray, FloatArray]:
    """A way from node to node: its nodes (n,), and where it crosses from one to the next (n − 1, 2) [m].

    It is the cheapest one, but for narrow leaves that were left out: up to the core, over what is left, and down again.
    """
    core, via = search.core, search.via
    links, left, up = core.links, core.graph, core.decided.up
    of, standing = (start, goal), len(links.net.other)
    ends, height, free = np.empty(2, np.int64), np.zeros(2, np.int64), np.zeros(1)
    for k, at in enumerate(of):
        while up[at] >= 0:
            at, height[k] = far_end(links.net, up[at]), height[k] + 1
        ends[k] = np.searchsorted(core.node, at)
    across = astar(Question(left, Doors(ends[:1], free), Doors(ends[1:], free), left.position[ends[1]], 1.0))[1]
    count = height[0] + len(across) + height[1]
    nodes, edges = np.empty(count + 1, np.int64), np.empty(count, np.int64)
    nodes[0], nodes[count] = of
    for k in range(height[0] + len(across)):
        edges[k] = up[nodes[k]] if k < height[0] else core.edge[across[k - height[0]]]
        nodes[k + 1] = far_end(links.net, edges[k])
    for k in range(count - 1, count - 1 - height[1], -1):
        edges[k] = up[nodes[k + 1]]
        nodes[k] = far_end(links.net, edges[k])
    crossings = np.empty((count, 2))
    for k in range(count):
        e = edges[k]
        crossings[k] = via[0][e] if e < standing else via[1][e - standing]
    return nodes, crossings

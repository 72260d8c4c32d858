"""The nodes that ways lead over: narrow leaves beside wider ones are left out, a narrow passage keeps a chain of them.

A quadtree has most of its leaves along obstacles, where they are the narrowest, and few ways need them. A narrow leaf
is left out if what is left of its neighbours is joined without it, those nearest to obstacles first. So what was joined
stays joined. From a leaf that was left out an edge leads up to another one, and so to the core.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from gpdf_service.search.graph import Graph, find_path
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


def find_core(graph: Graph, free: BoolArray, width: FloatArray, clearance: FloatArray) -> Core:
    """What ways need of a graph of leaves.

    Args:
        graph: Of what stands.
        free: Which leaves are free, shape (n,).
        width: Of each leaf [m].
        clearance: From its centre to the nearest obstacle [m].
    """
    first, other = graph.first, below(graph.other)
    narrow = np.flatnonzero(free & (width < NARROW))
    stays, up = free.copy(), np.full(len(free), -1)
    _thin(first, other, clearance, narrow[np.argsort(clearance[narrow], kind="stable")], stays, up)
    node = np.flatnonzero(stays)
    row = np.repeat(np.arange(len(free)), np.diff(first))
    edge = np.flatnonzero(stays[row] & stays[other])
    number = np.cumsum(stays) - 1
    begin = np.searchsorted(edge, first[np.append(node, len(free))])
    kept = number[other[edge]], graph.via[edge], graph.cost[edge], graph.component[node]
    return Core(node, edge, Graph(graph.position[node], graph.level[node], begin, *kept), up)


@njit(cache=True, nogil=True)
def _thin(
    first: IntArray, other: IntArray, clearance: FloatArray, order: IntArray, stays: BoolArray, up: IntArray
) -> None:
    """Leave out nodes one after the other, where that parts none of their neighbours that are left."""
    near = np.empty(_MOST_NEIGHBOURS, np.int64)
    for node in order:
        count, best = 0, -1
        for e in range(first[node], first[node + 1]):
            if not stays[other[e]]:
                continue
            if count < _MOST_NEIGHBOURS:
                near[count] = other[e]
            count += 1
            if best < 0 or clearance[other[e]] > clearance[other[best]]:
                best = e
        if 0 < count <= _MOST_NEIGHBOURS and _are_joined(first, other, stays, near[:count], node):
            stays[node], up[node] = False, best


@njit(cache=True, nogil=True)
def _are_joined(first: IntArray, other: IntArray, stays: BoolArray, near: IntArray, without: int) -> bool:
    """Whether some nodes lead to each other without one node, directly or by one between two of them."""
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
            if between == without or not stays[between]:
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
    (ahead, begin), (behind, end) = climb(graph, core, start), climb(graph, core, goal)
    ends = core.number(np.array([ahead[-1], behind[-1]])).tolist()
    edges = core.edge[find_path(core.graph, *ends)]
    nodes = np.concatenate([ahead, graph.other[edges], behind[-2::-1]])
    return nodes, graph.via[np.concatenate([begin, edges, end[::-1]])]

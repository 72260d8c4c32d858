"""A graph in which a few nodes are gone and a few are new: all others keep their numbers and their edges."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from gpdf_service.search.graph import Edges, Graph, Net, Patch, edges_of, far_end, price_edges
from gpdf_service.search.layered import Layered, below
from gpdf_service.tiles.nodes import components
from gpdf_service.tiles.rows import is_among, rows_of_runs
from gpdf_service.types import FloatArray, IntArray


class Nodes(NamedTuple):
    """Nodes that are new: places (x, y) [m], shape (k, 2), and level, shape (k,)."""

    position: FloatArray
    level: IntArray


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


def patched(graph: Graph, lost: Around, fresh: Nodes, edges: Edges, clearance: FloatArray, radius: float) -> Graph:
    """The graph of what stands without the nodes that are gone, and with fresh ones, numbered after all others.

    Args:
        graph: Of what stands.
        lost: What it loses.
        fresh: The new nodes.
        edges: Pairs of nodes, one of each new, shape (e, 2), and crossings.
        clearance: At both ends of these, shape (e, 2) [m].
        radius: As in `assemble`.
    """
    pairs, via = edges
    count, size = len(graph.position), len(graph.other)
    position = Layered(below(graph.position), fresh.position, count)
    beside = np.unique(np.concatenate([lost.ring, pairs[pairs < count]]))
    source, kept = _edges_from(graph, beside)
    stays = ~is_among(graph.other[kept], lost.gone)
    source, kept = source[stays], kept[stays]
    price = price_edges(position[pairs.ravel()].reshape(-1, 2, 2), via, clearance, radius)
    nodes = np.concatenate([beside, count + np.arange(len(fresh.level))])
    start = np.concatenate([source, pairs[:, 0], pairs[:, 1]])
    order = np.argsort(start, kind="stable")
    row = np.zeros(count + len(fresh.level), np.int32)  # pages that nobody reads cost nothing
    row[nodes] = 1 + np.arange(len(nodes))
    other = np.concatenate([graph.other[kept], pairs[:, 1], pairs[:, 0]])[order]
    patch = Patch(
        nodes,
        row,
        np.searchsorted(start[order], np.append(nodes, len(row))),
        other,
        np.concatenate([graph.cost[kept], price, price])[order],
        fresh.position,
    )
    return Graph(
        position,
        Layered(below(graph.level), fresh.level, count),
        graph.first,
        Layered(below(graph.other), other, size),
        Layered(below(graph.via), np.concatenate([graph.via[kept], via, via])[order], size),
        Layered(below(graph.cost), patch.cost, size),
        _components(graph, patch, start[order]),
        patch,
    )


def _components(graph: Graph, patch: Patch, start: IntArray) -> Layered:
    """Connected component of each node of a patched graph.

    What stood in one component is joined as before, where what is left of it beside the patch is joined in the patch.
    Only where that falls apart all of the component is looked through: there may be another way round.

    Args:
        graph: Of what stands.
        patch: What is other.
        start: Where each of its edges begins.
    """
    nodes, count, known = patch.node, len(graph.position), len(patch.node) - len(patch.position)
    here = is_among(patch.other, nodes)
    own, to = (np.searchsorted(nodes, ends[here]) for ends in (start, patch.other))
    piece = components(own, to, np.ones(len(nodes), dtype=bool))
    component = below(graph.component)
    was = component[nodes[:known]]
    label = count + np.arange(len(nodes))  # of a piece that nothing standing leads to: that of no other
    label[piece[:known]] = was
    fresh = label[piece[known:]]
    both = np.unique(np.column_stack([was, piece[:known]]), axis=0)[:, 0]
    torn = np.unique(both[1:][both[1:] == both[:-1]])
    if len(torn) == 0:
        return Layered(component, fresh, count)
    standing = component.copy()
    seeds = nodes[:known][is_among(was, torn)]
    _flood(graph.net._replace(patch=patch), seeds, count + len(nodes), standing, fresh)
    return Layered(standing, fresh, count)


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
            begin, end = edges_of(net, node)
            for e in range(begin, end):
                near = far_end(net, e)
                if (standing[near] if near < count else fresh[near - count]) < label:
                    if near < count:
                        standing[near] = mine
                    else:
                        fresh[near - count] = mine
                    stack.append(near)

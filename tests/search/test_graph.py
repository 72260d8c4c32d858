"""Edges, prices and ways of the graph against every pair of leaves, and against Dijkstra's."""

from itertools import combinations, product

import numpy as np
import pytest
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components, dijkstra

from gpdf_service.fields import build_tree
from gpdf_service.search.graph import (
    KNOWN,
    Doors,
    Front,
    _next,
    _proven,
    _wait,
    assemble,
    change_edges,
    edges_of,
    find_edges,
    find_path,
    find_way,
    net_of,
    price_pairs,
    same_leaves,
)
from gpdf_service.search.landmarks import find_landmarks
from gpdf_service.search.layered import Layered
from gpdf_service.search.moved import around, patched
from gpdf_service.search.places import Places
from gpdf_service.search.quadtree import build_quadtree
from gpdf_service.tiles.surface import HeightMap, turned


def segment_distance(a, b, places):
    along = np.clip((places - a) @ (b - a) / max((b - a) @ (b - a), 1e-300), 0.0, 1.0)
    return np.linalg.norm(a + along[:, None] * (b - a) - places, axis=1).min()


def small_scene(seed):
    rng = np.random.default_rng(seed)
    state = (rng.random((9, 7)) > 0.05).astype(np.uint8)
    surface = HeightMap(rng.uniform(-2.0, 2.0, 2), 0.1, np.where(state, 0.0, np.nan).astype(np.float32), state)
    places = surface.origin + rng.uniform(-0.1, 1.0, (rng.integers(2, 14), 2))
    radius = rng.choice([0.05, 0.09, 0.12])
    return rng, build_quadtree(surface, build_tree(places), radius), places, radius


def edges_by_pairs(tree, places, radius):
    """Every pair of free leaves that share a side, with a way over the middle of the smaller one's that keeps clear."""
    found, low, high = {}, tree.corner, tree.corner + tree.size[:, None]
    for a, b in combinations(np.flatnonzero(tree.free).tolist(), 2):
        overlap = np.minimum(high[a], high[b]) - np.maximum(low[a], low[b])
        if sorted(overlap > 0) != [False, True] or overlap.min() != 0:
            continue
        small, large = (a, b) if tree.size[a] <= tree.size[b] else (b, a)
        axis = int(overlap.argmin())
        via = tree.center[small].copy()
        via[axis] += np.sign(tree.center[large, axis] - via[axis]) * tree.half_size[small]
        ways = [segment_distance(tree.center[leaf], via, places) for leaf in (a, b) if not tree.whole[leaf]]
        assert all(abs(way - radius) > 1e-9 for way in ways)
        if all(way >= radius for way in ways):
            found[a, b] = tuple(via.round(9).tolist())
    return found


@pytest.mark.parametrize("seed", range(14))
def test_edges_are_all_pairs_of_neighbours_with_a_clear_way_and_each_once(seed):
    _, tree, places, radius = small_scene(seed)
    pairs, via = find_edges(tree, Places(build_tree(places)), radius)
    found = {(int(min(pair)), int(max(pair))): tuple(at.round(9).tolist()) for pair, at in zip(pairs, via, strict=True)}
    assert len(found) == len(pairs)
    assert found == edges_by_pairs(tree, places, radius)


def random_graph(rng, count=40, edges=70, radius=0.2):
    """A graph of which no edge is cheaper than it is long, in one part or several."""
    position, level = rng.uniform(-2.0, 2.0, (count, 2)), rng.integers(0, 3, count)
    pairs = np.array(
        sorted({tuple(sorted(pair)) for pair in rng.integers(0, count, (edges, 2)).tolist() if len(set(pair)) > 1})
    )
    via, clearance = rng.uniform(-2.0, 2.0, (len(pairs), 2)), rng.uniform(0.2, 0.7, count)
    return (
        assemble(position, level, (pairs, via), price_pairs(position, clearance, (pairs, via), radius)),
        pairs,
        via,
        clearance,
    )


def price(a, b, via, clearance, radius):
    length = np.linalg.norm(a - via) + np.linalg.norm(b - via)
    return length * (1.0 + np.clip(1.0 - (clearance - radius) / radius, 0.0, 1.0))


@pytest.mark.parametrize("seed", range(10))
def test_a_graph_has_every_edge_from_both_ends_with_its_price_and_its_component(seed):
    rng = np.random.default_rng(seed)
    graph, pairs, via, clearance = random_graph(rng, edges=rng.integers(10, 80))
    expected = [[] for _ in graph.position]
    for (a, b), at in zip(pairs.tolist(), via, strict=True):
        cost = price(graph.position[a], graph.position[b], at, min(clearance[a], clearance[b]), 0.2)
        expected[a].append((b, *at.tolist(), cost))
        expected[b].append((a, *at.tolist(), cost))
    for node, own in enumerate(expected):
        rows = slice(graph.first[node], graph.first[node + 1])
        mine = zip(graph.other[rows].tolist(), *graph.via[rows].T.tolist(), graph.cost[rows].tolist(), strict=True)
        np.testing.assert_allclose(sorted(mine), sorted(own), atol=1e-12)
    count, part = connected_components(csr_matrix((np.ones(len(pairs)), pairs.T), shape=2 * [len(graph.position)]))
    assert len(set(zip(part.tolist(), graph.component.tolist(), strict=True))) == count == len(set(graph.component))


def rows_of(graph, node):
    """Number, far end and cost of each edge of a node."""
    numbers = range(*edges_of(net_of(graph), node))
    return [(e, int(graph.other[e]), float(graph.cost[e])) for e in numbers]


def cheapest(graph, begin, end):
    """What the cheapest way costs, by Dijkstra's from a node before all begins to one behind all ends."""
    count, rows = len(graph.position), []
    for node in range(count):
        rows += [(node, other, cost) for _, other, cost in rows_of(graph, node)]
    rows += [(count, node, cost + 1.0) for node, cost in zip(begin.node.tolist(), begin.cost, strict=True)]
    rows += [(node, count + 1, cost + 1.0) for node, cost in zip(end.node.tolist(), end.cost, strict=True)]
    best = {}
    for a, b, cost in rows:
        best[a, b] = min(best.get((a, b), np.inf), cost)
    a, b = np.array(list(best)).T
    matrix = csr_matrix((list(best.values()), (a, b)), shape=(count + 2, count + 2))
    return dijkstra(matrix, indices=count)[count + 1] - 2.0


def spent(graph, begin, end, node, edges):
    """What a way costs, which must go on from where it came to, from a begin to an end."""
    cost, at = begin.cost[begin.node == node].min(), node
    for edge in edges.tolist():
        (row,) = (one for one in rows_of(graph, at) if one[0] == edge)
        at, cost = row[1], cost + row[2]
    return cost + end.cost[end.node == at].min()


def doors(rng, graph, goal, rate):
    nodes = rng.choice(len(graph.position), rng.integers(1, 4))
    far = np.linalg.norm(graph.position[nodes] - goal, axis=1)
    return Doors(nodes, rate * far * rng.uniform(1.0, 1.5, len(nodes)))


def compare(graph, rng, rate):
    """Some ways by A* and Dijkstra's: how many there are, and how many are none."""
    found = [0, 0]
    for _ in range(15):
        goal, start = rng.uniform(-2.0, 2.0, (2, 2))
        begin, end = doors(rng, graph, start, rate), doors(rng, graph, goal, rate)
        least = cheapest(graph, begin, end)
        node, edges = find_way(graph, begin, end, goal, rate)
        found[int(node < 0)] += 1
        if node < 0:
            assert np.isinf(least)
            assert len(edges) == 0
        else:
            assert spent(graph, begin, end, node, edges) == pytest.approx(least, abs=1e-6)
    return found


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("rate", [1.0, 0.3])
def test_a_way_is_the_cheapest_from_any_begin_to_any_end_and_none_where_there_is_none(seed, rate):
    rng = np.random.default_rng(seed)
    graph = random_graph(rng, edges=[30, 60][seed % 2])[0]
    graph = graph._replace(cost=graph.cost * rate)
    assert compare(graph, rng, rate)[0] > 0
    known = graph._replace(landmarks=find_landmarks(graph.first, graph.other, graph.cost, graph.component))
    compare(known, rng, rate)


def test_some_ways_are_none():
    rng = np.random.default_rng(5)
    assert compare(random_graph(rng, edges=30)[0], rng, 1.0)[1] > 0
    graph = random_graph(rng)[0]
    nobody = Doors(np.zeros(0, np.int64), np.zeros(0))
    for begin, end in ((nobody, doors(rng, graph, np.zeros(2), 1.0)), (doors(rng, graph, np.zeros(2), 1.0), nobody)):
        assert find_way(graph, begin, end, np.zeros(2))[0] == -1


@pytest.mark.parametrize("seed", range(12))
def test_with_a_patch_edges_lead_to_fresh_nodes_and_never_to_those_that_are_gone(seed):
    rng = np.random.default_rng(seed)
    graph = random_graph(rng, edges=80)[0]
    count, fresh = len(graph.position), 6
    gone = np.sort(rng.choice(count, 5, replace=False))
    stay = np.setdiff1d(np.arange(count), gone)
    nodes = rng.uniform(-2.0, 2.0, (fresh, 2)), rng.integers(0, 3, fresh)
    pairs = {(int(rng.choice(stay)), count + int(k)) for k in rng.integers(0, fresh, 12)}
    pairs |= {(count + k, count + k + 1) for k in range(0, fresh - 1, 2)}
    pairs = np.array(sorted(pairs))
    via, clearance = rng.uniform(-2.0, 2.0, (len(pairs), 2)), rng.uniform(0.2, 0.7, count + fresh)
    room = Layered(clearance[:count], clearance[count:])
    made = patched(graph, around(graph, gone), nodes, (pairs, via), room, 0.2)
    for pair, at in zip(pairs.tolist(), via, strict=True):
        (cost,) = {made.cost[e] for e, other, _ in rows_of(made, pair[0]) if other == pair[1]}
        assert cost == pytest.approx(price(*made.position[pair], at, clearance[pair].min(), 0.2))
    assert {other for node in stay for _, other, _ in rows_of(made, node)} & set(gone.tolist()) == set()
    fresh_edges = [(n, o) for n in range(count, count + fresh) for _, o, _ in rows_of(made, n)]
    assert sorted(fresh_edges) == sorted((a, b) for p in pairs.tolist() for a, b in (p, p[::-1]) if a >= count)
    ends = {
        (n, o): (*made.via[e].tolist(), c)
        for n in [*stay, *range(count, count + fresh)]
        for e, o, c in rows_of(made, n)
    }
    assert all(ends[o, n] == facts for (n, o), facts in ends.items())
    kept = {(n, o): (*graph.via[e].tolist(), c) for n in stay for e, o, c in rows_of(graph, n) if o not in gone}
    assert {pair: ends[pair] for pair in kept} == kept
    alive, rows = np.append(stay, np.arange(count, count + fresh)), np.array(list(ends)).T
    matrix = csr_matrix((np.ones(rows.shape[1]), rows), shape=2 * [count + fresh])
    part = connected_components(matrix)[1][alive]
    joined = set(zip(part.tolist(), made.component[alive].tolist(), strict=True))
    assert len(joined) == len(set(part.tolist())) == len({label for _, label in joined})


def test_from_a_node_to_itself_there_is_nothing_to_go():
    graph = random_graph(np.random.default_rng(1))[0]
    assert find_path(graph, 3, 3).tolist() == []
    door = Doors(np.array([3]), np.array([0.5]))
    assert find_way(graph, door, door, graph.position[3])[0] == 3


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_place_that_comes_beside_the_crossing_of_two_leaves_cuts_their_way_though_both_stay_as_they_were(side):
    """It is further than the radius from both centres, and nearer to the crossing between them."""
    cut = 0
    for seed in range(8):
        _, _, places, radius = small_scene(seed)
        surface = HeightMap(places.min(axis=0) - 0.1, 0.1, np.zeros((12, 12), np.float32), np.ones((12, 12), np.uint8))
        old, before = build_quadtree(surface, build_tree(places), radius), Places(build_tree(places))
        ends, via = edges = find_edges(old, before, radius)
        alike = ~old.whole[ends].any(axis=1) & (old.size[ends[:, 0]] == old.size[ends[:, 1]])
        for row in np.flatnonzero(alike)[:30]:
            half, ahead = old.half_size[ends[row, 0]], via[row] - old.center[ends[row, 0]]
            beside = side * np.array([-ahead[1], ahead[0]]) / half
            come = via[row] + beside * (radius - 0.25 * half**2 / radius)
            now = build_tree(np.vstack([places, come]))
            tree = build_quadtree(surface, now, radius, (old, build_tree(come[None]), turned(surface, surface)))
            found = change_edges(edges, same_leaves(old, tree), tree, Places(now), radius, build_tree(come[None]))
            expected = find_edges(tree, Places(now), radius)
            np.testing.assert_array_equal(found[0], expected[0])
            np.testing.assert_array_equal(found[1], expected[1])
            both = tree.find(old.center[ends[row]])
            cut += tree.free[both].all() and (tree.size[both] == old.size[ends[row]]).all()
    assert cut > 10


@pytest.mark.parametrize("seed", range(4))
def test_an_edge_is_proven_where_both_halves_keep_the_radius_or_stay_in_their_leaves_room(seed):
    rng, count = np.random.default_rng(seed), 200
    posts = rng.uniform(0.0, 3.0, (12, 2))
    center, via = rng.uniform(0.0, 3.0, (count, 2, 2)), rng.uniform(0.0, 3.0, (count, 2))
    room = np.where(rng.random((count, 2)) < 0.1, np.inf, rng.uniform(0.0, 2.0, (count, 2)))
    good = rng.random(count) < 0.5  # whatever was there before
    _proven(Places(build_tree(posts)), center, room, via, 0.2, good)
    want = np.ones(count, dtype=bool)
    for e, k in product(range(count), range(2)):
        along = center[e, k] + np.linspace(0.0, 1.0, 4001)[:, None] * (via[e] - center[e, k])
        clear = np.linalg.norm(along[:, None] - posts, axis=2).min() > 0.2
        want[e] &= room[e, k] >= np.linalg.norm(via[e] - center[e, k]) or clear
    assert 20 < want.sum() < 180
    np.testing.assert_array_equal(good, want)


@pytest.mark.parametrize("seed", range(4))
def test_nodes_come_out_of_the_heap_in_the_order_of_their_estimates_also_when_some_are_put_forward(seed):
    rng, n = np.random.default_rng(seed), 60
    known = np.zeros(n, KNOWN)
    came = known["cost_to_come"] = rng.integers(0, 3, n).astype(float)
    front = Front(known, np.empty(n, np.int32), np.empty(n), np.zeros(1, np.int64))
    waiting = {}
    for _ in range(2000):
        if waiting and rng.random() < 0.45:
            first = min(waiting, key=lambda node: (waiting[node], came[node], node))
            assert _next(front) == first
            del waiting[first]
        else:
            node, estimate = int(rng.integers(n)), float(rng.integers(20))
            if estimate < waiting.get(node, np.inf):
                waiting[node] = estimate
                _wait(front, estimate, node)
        assert front.size[0] == len(waiting)
    assert len(waiting) > 5

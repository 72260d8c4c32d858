"""Bounds from landmarks: never more than the way takes, and the same ways with them as without."""

import numpy as np
import pytest
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from gpdf_service.search.graph import Doors, Graph, find_way
from gpdf_service.search.landmarks import NO_LANDMARKS, at_least, bounds_to, find_landmarks
from gpdf_service.search.ways import Prefer


def matrix_of(graph):
    count = len(graph.position)
    source = np.repeat(np.arange(count), np.diff(graph.first))
    return csr_matrix((graph.cost, (source, graph.other)), shape=(count, count))


@pytest.fixture(scope="module")
def ways(office):
    return office[1].ways("human", Prefer.COMPANION)


def test_landmarks_never_say_more_than_the_way_takes_and_often_nearly_as_much(ways):
    graph, rng = ways.graph, np.random.default_rng(0)
    inside = np.flatnonzero(graph.component == np.bincount(graph.component).argmax())
    said, true = [], []
    for exits in rng.choice(inside, (20, 2)):
        cost = rng.uniform(0.0, 2.0, 2)
        far = (dijkstra(matrix_of(graph), indices=exits) + cost[:, None]).min(axis=0)
        bounds = bounds_to(graph.landmarks, exits, cost)
        said += [at_least(graph.landmarks, bounds, node) for node in inside]
        true += far[inside].tolist()
    assert (np.array(said) <= np.array(true) + 1e-4).all()
    assert np.sum(said) > 0.6 * np.sum(true)


def test_ways_cost_the_same_with_landmarks_and_without(ways):
    graph, rng = ways.graph, np.random.default_rng(1)
    plain = graph._replace(landmarks=NO_LANDMARKS)
    inside = np.flatnonzero(graph.component == np.bincount(graph.component).argmax())
    for _ in range(50):
        begin, end = (Doors(rng.choice(inside, 3), rng.uniform(0.0, 3.0, 3)) for _ in range(2))
        spent = []
        for each in (graph, plain):
            node, edges = find_way(each, begin, end, graph.position[end.node[0]], rate=0.0)
            last = graph.other[edges[-1]] if len(edges) else node
            at = begin.cost[begin.node == node].min() + end.cost[end.node == last].min()
            spent.append(graph.cost[edges].sum() + at)
        assert spent[0] == pytest.approx(spent[1], abs=1e-4)


def test_what_no_way_leads_to_is_known_at_once():
    position = np.array([[0.0, 0.0], [1.0, 0.0], [5.0, 0.0], [6.0, 0.0], [2.0, 0.0]])
    first, other = np.array([0, 1, 3, 4, 5, 6]), np.array([1, 0, 4, 3, 2, 1])
    cost, component = np.ones(6), np.array([0, 0, 1, 1, 0])
    landmarks = find_landmarks(first, other, cost, component)
    assert np.isinf(landmarks[[2, 3]]).all()
    assert np.isfinite(landmarks[[0, 1, 4]]).all()
    graph = Graph(position, np.zeros(5, np.int64), first, other, np.zeros((6, 2)), cost, component, landmarks=landmarks)
    assert find_way(graph, _door(0), _door(3), position[3])[0] == -1
    assert find_way(graph, _door(0), _door(4), position[4])[1].tolist() == [0, 2]


def _door(node):
    return Doors(np.array([node]), np.zeros(1))

"""How far it is at least from node to node, by how far both are from a few landmarks (Goldberg & Harrelson 2005).

|d(L, a) − d(L, b)| ≤ d(a, b) for each landmark L: a consistent heuristic, and nearly exact where ways are few, as on
ramps, which lead round and round over places that are near in plan.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from gpdf_service.kernel_cache import lean
from gpdf_service.types import Float32Array, FloatArray, IntArray

Landmarks = Float32Array
"""Cost of the way from each node to each landmark, shape (n, k), inf where there is none."""
COUNT = 6
"""Landmarks: each is one flood of the graph, and one number a node."""
NO_LANDMARKS = np.zeros((0, 0), np.float32)
"""Of a graph that is asked seldom."""


def find_landmarks(first: IntArray, other: IntArray, cost: FloatArray, component: IntArray) -> Landmarks:
    """Landmarks of a graph in compressed rows, in its largest component, each as far as can be from those before it."""
    count = len(component)
    if count == 0:
        return NO_LANDMARKS
    graph, inside = csr_matrix((cost, other, first), (count, count)), component == np.bincount(component).argmax()
    made, nearest = np.empty((count, COUNT), np.float32), np.where(inside, np.inf, -np.inf)
    node = np.where(inside, dijkstra(graph, indices=inside.argmax()), -np.inf).argmax()
    for k in range(COUNT):
        made[:, k] = far = dijkstra(graph, indices=node)
        nearest = np.minimum(nearest, far)
        node = nearest.argmax()
    return made


@njit(cache=True, nogil=True)
def bounds_to(landmarks: Landmarks, exits: IntArray, exit_cost: FloatArray) -> FloatArray:
    """What `at_least` needs of a goal behind some exits, shape (k, 2)."""
    made = np.empty((landmarks.shape[1], 2))
    for k in range(landmarks.shape[1]):
        made[k, 0], made[k, 1] = np.inf, -np.inf
        for e in range(len(exits)):
            far = np.float64(landmarks[exits[e], k])
            made[k, 0], made[k, 1] = min(made[k, 0], far + exit_cost[e]), max(made[k, 1], far - exit_cost[e])
    return made


@lean()
def at_least(landmarks: Landmarks, bounds: FloatArray, node: int) -> float:
    """Least cost of the way from a node to the goal that the `bounds` are of; inf where there is none."""
    best = 0.0
    for k in range(len(bounds)):
        far = np.float64(landmarks[node, k])
        if bounds[k, 0] - far > best:  # a NaN, of two in another component, compares false
            best = bounds[k, 0] - far
        if far - bounds[k, 1] > best:
            best = far - bounds[k, 1]
    return best

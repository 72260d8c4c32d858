"""How far it is at least from node to node, by how far both are from a few landmarks (Goldberg & Harrelson 2005).

|d(L, a) − d(L, b)| ≤ d(a, b) for each landmark L: a consistent heuristic, and nearly exact where ways are few, as on
ramps, which lead round and round over places that are near in plan.
"""

from __future__ import annotations

import heapq

import numpy as np
from numba import njit

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
    if len(component) == 0:
        return NO_LANDMARKS
    inside = np.flatnonzero(component == np.bincount(component).argmax())
    made: Landmarks = _spread(first, other, cost, inside, COUNT)
    return made


@njit(cache=True, nogil=True)
def _spread(first: IntArray, other: IntArray, cost: FloatArray, inside: IntArray, count: int) -> Landmarks:
    """See `find_landmarks`: all nodes of the component are `inside`."""
    made = np.full((len(first) - 1, count), np.inf, np.float32)
    nearest, node = flood(first, other, cost, inside[0]), inside[0]
    for k in range(count):
        for i in inside:
            if nearest[i] > nearest[node]:
                node = i
        far = flood(first, other, cost, node)
        for i in inside:
            made[i, k] = far[i]
            nearest[i] = min(nearest[i], far[i]) if k > 0 else far[i]
    return made


@njit(cache=True, nogil=True)
def flood(first: IntArray, other: IntArray, cost: FloatArray, source: int) -> FloatArray:
    """Cost of the way from a node to every one (Dijkstra), inf where there is none."""
    come = np.full(len(first) - 1, np.inf)
    come[source] = 0.0
    frontier = [(0.0, source)]
    while len(frontier) > 0:
        reached, node = heapq.heappop(frontier)
        if reached > come[node]:
            continue
        for e in range(first[node], first[node + 1]):
            further = reached + cost[e]
            if further < come[other[e]]:
                come[other[e]] = further
                heapq.heappush(frontier, (further, other[e]))
    return come


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

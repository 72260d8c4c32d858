"""How far apart the points on a surface are, and thinning to that."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from gpdf_service.types import FloatArray, IntArray

SAMPLE = 4000
"""Points whose neighbours are looked at: the median's error is then about 1 %."""


def estimate_spacing(points: FloatArray) -> float:
    """Median distance between neighbours on the same surface [m]; 0 when all points are equal.

    The distance to the k-th neighbour on a surface with one point every s² is s √(k/π): k = 8 evens out scan lines.
    """
    points = np.asarray(points, dtype=np.float64)
    k = min(8, len(points) - 1)
    if k < 1:
        return 0.0
    picked = points[:: max(1, len(points) // SAMPLE)]
    distance = cKDTree(points).query(picked, k=k + 1, workers=-1)[0][:, k]
    return float(np.median(distance) * np.sqrt(np.pi / k))


def thin(points: FloatArray, cell: float) -> IntArray:
    """Rows of the point nearest to the mean of each cubic cell: real points, no averages; (k,), sorted."""
    if cell <= 0:
        return np.unique(points, axis=0, return_index=True)[1].astype(np.int64)
    key = np.floor((points - points.min(axis=0)) / cell).astype(np.int64)
    sizes = key.max(axis=0) + 1
    flat = np.ravel_multi_index(tuple(key.T), tuple(sizes))
    _, inverse, count = np.unique(flat, return_inverse=True, return_counts=True)
    mean = np.stack([np.bincount(inverse, weights=column) / count for column in points.T], axis=1)
    off = ((points - mean[inverse]) ** 2).sum(axis=1)
    order = np.lexsort((off, inverse))
    first = np.concatenate([[0], np.cumsum(count)[:-1]])
    return np.sort(order[first]).astype(np.int64)

"""Who reaches whom in a cloud of voxels: a search over columns. Shares no code with perception or the planner.

Each column's points are cut where they are more than a body's step apart; a run's top is a place to stand if there is
headroom over it. A place is free where no run within the body's radius is in its way, and where there is ground within
a step in every direction. Neighbours are joined where the rise is one that the body takes and no steeper than that.
"""

from __future__ import annotations

from math import tan

import numpy as np
from numba import njit
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from gpdf_service.types import Agent, BoolArray, FloatArray, IntArray

LOOK = 0.01
"""[m] Between two looks at a body on its way."""
SLOPE_OVER = 2
"""Cells over which a slope is told, to either side: steps of a voxel are none."""


class ColumnSearch:
    """Where a body stands in a cloud of voxels.

    Args:
        points: [m], shape (n, 3).
        agent: The body.
        cell: Width of a column: the cloud's voxels [m].
    """

    def __init__(self, points: FloatArray, agent: Agent, cell: float) -> None:
        self.agent, self.cell = agent, cell
        self.origin = points.min(axis=0)
        index = np.floor((points[:, :2] - self.origin[:2]) / cell + 0.5).astype(np.int64)
        self.shape = index.max(axis=0) + 1
        column = index[:, 0] * self.shape[1] + index[:, 1]
        order = np.lexsort((points[:, 2], column))
        column, z = column[order], points[order, 2]
        last = np.append((column[1:] != column[:-1]) | (np.diff(z) > agent.max_step), True)
        first = np.roll(last, 1)
        self.column, self.top, self.bottom = column[last], z[last], z[first]
        self.begin = np.searchsorted(self.column, np.arange(self.shape.prod() + 1))
        self.stands = _stands(self.begin, self.top, self.bottom, self.shape, _discs(agent, cell), *_limits(agent, cell))
        self.component = self._components()

    @property
    def places(self) -> FloatArray:
        """Tops of all runs [m], shape (m, 3)."""
        ij = np.column_stack(np.divmod(self.column, self.shape[1]))
        return np.column_stack([self.origin[:2] + ij * self.cell, self.top])

    def nearest(self, place: FloatArray) -> int:
        """The place to stand that is nearest to (3,) [m]."""
        rows = np.flatnonzero(self.stands)
        return int(rows[np.linalg.norm(self.places[rows] - place, axis=1).argmin()])

    def random_pairs(self, count: int, rng: np.random.Generator, least: int) -> FloatArray:
        """Pairs of places that are joined, in components of at least so many places, (count, 2, 3) [m]."""
        size = np.bincount(self.component[self.stands], minlength=len(self.top))
        rows = np.flatnonzero(self.stands & (size[self.component] >= least))
        starts = rng.choice(rows, count)
        goals = [rng.choice(rows[self.component[rows] == self.component[row]]) for row in starts]
        return np.stack([self.places[starts], self.places[goals]], axis=1)

    def deepest(self, contact: FloatArray) -> float:
        """How deep the worst column is in the body anywhere on a way over contact points, (n, 3) [m]; 0 if none is."""
        poses = np.column_stack([contact[:, :2] - self.origin[:2], contact[:, 2]])
        reach, step, height = self.agent.radius, self.agent.max_step, self.agent.height
        return float(_deepest(self.begin, self.top, self.bottom, self.shape, poses, self.cell, reach, step, height))

    def _components(self) -> IntArray:
        step, slope = self.agent.max_step, tan(self.agent.max_slope)
        pairs = _pairs(self.begin, self.top, self.stands, self.shape, max(step, self.cell * slope))
        count = len(self.top)
        links = coo_matrix((np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
        found: IntArray = connected_components(links, directed=False)[1].astype(np.int64)
        return found


def _discs(agent: Agent, cell: float) -> IntArray:
    """Offsets of the columns that the body is over, shape (k, 2)."""
    n = int(np.ceil(agent.radius / cell))
    ij = np.stack(np.meshgrid(*2 * [np.arange(-n, n + 1)], indexing="ij"), axis=-1).reshape(-1, 2)
    under: IntArray = ij[np.hypot(*ij.T) * cell <= max(agent.radius, cell)]
    return under


def _limits(agent: Agent, cell: float) -> tuple[float, float, float]:
    """Step, headroom and rise over `SLOPE_OVER` cells to either side [m]; a voxel's rounding is no slope."""
    return agent.max_step, agent.height, 2 * SLOPE_OVER * cell * tan(agent.max_slope) + cell


@njit(cache=True)
def _next(begin: IntArray, top: FloatArray, column: int, z: float, rise: float) -> int:
    """The run in a column whose top is nearest to z, within a rise; -1 if none."""
    best, found = rise, -1
    for k in range(begin[column], begin[column + 1]):
        off = abs(top[k] - z)
        if off <= best:
            best, found = off, k
    return found


@njit(cache=True)
def _stands(
    begin: IntArray,
    top: FloatArray,
    bottom: FloatArray,
    shape: IntArray,
    discs: IntArray,
    step: float,
    height: float,
    slope: float,
) -> BoolArray:
    """Whether a body stands on each run: ground within a step all around it, nothing in it, not too steep."""
    free = np.ones(len(top), dtype=np.bool_)
    for i in range(shape[0]):
        for j in range(shape[1]):
            for k in range(begin[i * shape[1] + j], begin[i * shape[1] + j + 1]):
                z = top[k]
                for di, dj in discs:
                    a, b = i + di, j + dj
                    if not (0 <= a < shape[0] and 0 <= b < shape[1]):
                        free[k] = False
                        continue
                    column = a * shape[1] + b
                    if _next(begin, top, column, z, step) < 0:
                        free[k] = False
                    for other in range(begin[column], begin[column + 1]):
                        if top[other] > z + step and bottom[other] < z + height:
                            free[k] = False
                for axis in range(2):
                    di, dj = (SLOPE_OVER, 0) if axis == 0 else (0, SLOPE_OVER)
                    if i < di or i + di >= shape[0] or j < dj or j + dj >= shape[1]:
                        continue
                    one = _next(begin, top, (i + di) * shape[1] + j + dj, z, slope)
                    two = _next(begin, top, (i - di) * shape[1] + j - dj, z, slope)
                    if one >= 0 and two >= 0 and abs(top[one] - top[two]) > slope:
                        free[k] = False
    return free


@njit(cache=True)
def _pairs(begin: IntArray, top: FloatArray, stands: BoolArray, shape: IntArray, rise: float) -> IntArray:
    """Runs beside each other that a body goes between, (p, 2)."""
    made = np.empty((2 * len(top), 2), dtype=np.int64)
    count = 0
    for i in range(shape[0]):
        for j in range(shape[1]):
            for k in range(begin[i * shape[1] + j], begin[i * shape[1] + j + 1]):
                for di, dj in ((1, 0), (0, 1)):
                    if not stands[k] or i + di >= shape[0] or j + dj >= shape[1]:
                        continue
                    other = _next(begin, top, (i + di) * shape[1] + j + dj, top[k], rise)
                    if other >= 0 and stands[other]:
                        made[count] = k, other
                        count += 1
    return made[:count]


@njit(cache=True)
def _deepest(
    begin: IntArray,
    top: FloatArray,
    bottom: FloatArray,
    shape: IntArray,
    poses: FloatArray,
    cell: float,
    radius: float,
    step: float,
    height: float,
) -> float:
    """See `ColumnSearch.deepest`: a run is in the body where its top is over a step and its bottom under the head."""
    deepest, n = 0.0, int(np.ceil(radius / cell))
    for p in range(len(poses) - 1):
        count = int(np.ceil(np.sqrt(((poses[p + 1] - poses[p]) ** 2).sum()) / LOOK)) + 1
        for k in range(count + 1):
            x, y, z = poses[p] + k / count * (poses[p + 1] - poses[p])
            i, j = int(np.rint(x / cell)), int(np.rint(y / cell))
            for a in range(max(i - n, 0), min(i + n + 1, shape[0])):
                for b in range(max(j - n, 0), min(j + n + 1, shape[1])):
                    depth = radius - np.hypot(a * cell - x, b * cell - y)
                    if depth <= deepest:
                        continue
                    for run in range(begin[a * shape[1] + b], begin[a * shape[1] + b + 1]):
                        if top[run] > z + step and bottom[run] < z + height:
                            deepest = depth
    return deepest

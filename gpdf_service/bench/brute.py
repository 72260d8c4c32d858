"""Which queries can be solved at all: a search on a 2 cm grid with the true geometry. Shares no code with the planner.

Every ground point raises the cells around it to its height (storeys apart are layers of a cell); every point that would
be inside an upright cylinder standing there, every edge and every steep place takes its distance from each cell; cells
with room for the body, joined where the rise between neighbours is one that it takes, are searched exhaustively. A path
along centres of neighbouring cells keeps at least the body's radius, because the extra room is at least half a cell: a
query that this search solves has a solution.
"""

from __future__ import annotations

from math import ceil, hypot, inf, sqrt

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from gpdf_service.types import Agent, BoolArray, FloatArray, IntArray

CELL = 0.02
"""[m] Of the grid."""
MAX_CELLS = 4_000_000
"""On maps larger than 40 × 40 m the cells grow with the map, and the room asked for with them."""
LEAST_ROOM = 0.01
"""[m] Beyond the body's radius, and over its head; one standard deviation of the noise comes on top."""
LAYERS = 3
"""Storeys over one place."""
STOREY = 0.6
"""[m] Ground points further apart in height than this are two storeys: less than anybody's headroom but a Roomba's."""
VOXEL = 0.04
"""[m] Ground points are averaged over this: a scanner's scatter is no step."""
REACH = 2.0
"""[-] Ground is known this many point spacings around a ground point: an empty disc of that size is no accident."""
FACE = 0.1
"""[m] The face of a step has its upper ground within this, seen from above."""
SCATTER = 0.02
"""[m] Points this close to the ground are its scatter."""
NEIGHBOURS = 12
"""Ground points that a slope is fitted to: a patch of 8 cm radius, a foot."""
PLANAR = 0.015
"""[m] A patch that leaves its plane by more (root mean square) is a step, whose height counts, and not its slope."""


class BruteForce:
    """Where one body can stand in the clean cloud, and which places reach which.

    Args:
        points: The clean cloud [m], shape (n, 3).
        ground: Its true ground labels, shape (n,).
        agent: The body.
        noise: Standard deviation of the noise that a planner's input carries [m].
    """

    def __init__(self, points: FloatArray, ground: BoolArray, agent: Agent, noise: float = 0.0) -> None:
        floor = _average(points[ground])
        low, high = floor[:, :2].min(axis=0), floor[:, :2].max(axis=0)
        self.agent = agent
        self.cell = max(CELL, sqrt(float(np.prod(high - low)) / MAX_CELLS))
        self.room = max(LEAST_ROOM + noise, 0.5 * self.cell)
        self.origin = low - self.cell
        shape = tuple(int(n) for n in np.ceil((high - low) / self.cell) + 2)
        self.height = np.full((*shape, LAYERS), np.nan)
        _raise_ground(floor, self.origin, self.cell, _reach(floor), self.height, np.full((*shape, LAYERS), inf))
        far = agent.radius + self.room
        self.clearance = np.full((*shape, LAYERS), far, np.float32)
        tall = agent.height + LEAST_ROOM + noise
        stops = _material(points[~ground], self.height, self.origin, self.cell, tall, agent.max_step)
        for places in (stops, self._edges(), _steep(floor, agent.max_slope)):
            _keep_off(places, self.origin, self.cell, far, self.height, self.clearance)
        known = ~np.isnan(self.height)
        self.stands = known & (self.clearance >= agent.radius)
        self.fits = known & (self.clearance >= np.float32(far))
        self.component = self._components()

    def solves(self, start: FloatArray, goal: FloatArray) -> bool:
        """Whether the body gets from start to goal, (x, y) or (x, y, z of the ground), with the extra room."""
        a, b = self._component_at(start), self._component_at(goal)
        return a >= 0 and a == b

    def random_pairs(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Starts and goals where the body stands, without extra room beside it: (count, 2, 3) [m], z of its ground.

        None at all, shape (0, 2, 3), where it stands nowhere.
        """
        nodes = np.argwhere(self.stands)
        if len(nodes) == 0:
            return np.empty((0, 2, 3))
        i, j, k = nodes[rng.integers(len(nodes), size=2 * count)].T
        xy = self.origin + (np.column_stack([i, j]) + 0.5) * self.cell
        return np.column_stack([xy, self.height[i, j, k]]).reshape(-1, 2, 3)

    def _component_at(self, place: FloatArray) -> int:
        i, j = np.floor((place[:2] - self.origin) / self.cell).astype(int)
        if not (0 <= i < self.height.shape[0] and 0 <= j < self.height.shape[1]):
            return -1
        label = self.component[i, j]
        if len(place) == 2 or (label < 0).all():
            return int(label.max())
        off = np.where(label >= 0, np.abs(self.height[i, j] - place[2]), inf)
        return int(label[off.argmin()]) if off.min() < STOREY / 2 else -1

    def _edges(self) -> FloatArray:
        """Places beside which there is no ground within a step: x, y, and the heights that they stop, (k, 4)."""
        joined = np.ones(self.height.shape, dtype=bool)
        for axis in (0, 1):
            for side in (-1, 1):
                beside = np.roll(self.height, -side, axis=axis)
                rim = [slice(None)] * 3
                rim[axis] = slice(-1, None) if side > 0 else slice(0, 1)
                beside[tuple(rim)] = np.nan
                rise = np.abs(self.height[..., :, None] - beside[..., None, :])
                joined &= (rise <= self.agent.max_step).any(axis=-1)
        i, j, k = np.nonzero(~joined & ~np.isnan(self.height))
        xy, z = self.origin + (np.column_stack([i, j]) + 0.5) * self.cell, self.height[i, j, k]
        return np.column_stack([xy, z - STOREY, z + STOREY])

    def _components(self) -> IntArray:
        """Connected component of each cell and layer where the body fits, -1 elsewhere."""
        number = np.full(self.fits.shape, -1, dtype=np.int64)
        count = int(self.fits.sum())
        number[self.fits] = np.arange(count)
        ends = []
        for here, there in ((np.s_[:-1], np.s_[1:]), (np.s_[:, :-1], np.s_[:, 1:])):
            for a in range(LAYERS):
                for b in range(LAYERS):
                    one, two = number[here][..., a], number[there][..., b]
                    rise = np.abs(self.height[here][..., a] - self.height[there][..., b])
                    way = (one >= 0) & (two >= 0) & (rise <= self.agent.max_step)
                    ends.append(np.column_stack([one[way], two[way]]))
        pairs = np.concatenate(ends)
        links = coo_matrix((np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
        number[self.fits] = connected_components(links, directed=False)[1]
        return number


def _average(ground: FloatArray) -> FloatArray:
    """Means of the ground points in each voxel."""
    key = np.floor((ground - ground.min(axis=0)) / VOXEL).astype(np.int64)
    _, inverse, count = np.unique(key, axis=0, return_inverse=True, return_counts=True)
    return np.stack([np.bincount(inverse.ravel(), weights=column) / count for column in ground.T], axis=1)


def _reach(floor: FloatArray) -> float:
    """How far around a ground point its ground is known [m]."""
    k = min(8, len(floor) - 1)
    distance = cKDTree(floor).query(floor, k=k + 1)[0][:, k]
    return REACH * float(np.median(distance)) * sqrt(np.pi / k)


def _steep(floor: FloatArray, max_slope: float) -> FloatArray:
    """Ground points whose patch is a plane steeper than `max_slope`: x, y, and the heights that they stop, (k, 4)."""
    near = cKDTree(floor).query(floor, k=min(NEIGHBOURS, len(floor)))[1]
    patch = floor[near] - floor[near].mean(axis=1, keepdims=True)
    design, rise = patch[..., :2], patch[..., 2:]
    normal = design.transpose(0, 2, 1) @ design + 1e-9 * np.eye(2)
    gradient = np.linalg.solve(normal, design.transpose(0, 2, 1) @ rise)
    off = np.sqrt(((rise - design @ gradient) ** 2).mean(axis=(1, 2)))
    steep = (np.hypot(gradient[:, 0, 0], gradient[:, 1, 0]) > np.tan(max_slope)) & (off <= PLANAR)
    x, y, z = floor[steep].T
    return np.column_stack([x, y, z - STOREY, z + STOREY])


@njit(cache=True, nogil=True)
def _raise_ground(
    floor: FloatArray, origin: FloatArray, cell: float, reach: float, height: FloatArray, gap: FloatArray
) -> None:
    """Give each cell the height of the nearest ground point within reach, in one layer a storey."""
    n = ceil(reach / cell)
    for p in range(len(floor)):
        ci, cj = int((floor[p, 0] - origin[0]) / cell), int((floor[p, 1] - origin[1]) / cell)
        for i in range(max(ci - n, 0), min(ci + n + 1, height.shape[0])):
            for j in range(max(cj - n, 0), min(cj + n + 1, height.shape[1])):
                x, y = origin[0] + (i + 0.5) * cell, origin[1] + (j + 0.5) * cell
                distance = hypot(x - floor[p, 0], y - floor[p, 1])
                if distance > reach:
                    continue
                for k in range(height.shape[2]):
                    if np.isnan(height[i, j, k]) or abs(height[i, j, k] - floor[p, 2]) < STOREY:
                        if distance < gap[i, j, k]:
                            gap[i, j, k], height[i, j, k] = distance, floor[p, 2]
                        break


@njit(cache=True, nogil=True)
def _material(
    points: FloatArray, height: FloatArray, origin: FloatArray, cell: float, body: float, max_step: float
) -> FloatArray:
    """Points that stop a body: x, y, and between which heights of its contact they do, (k, 4).

    A point at z is in the cylinder over a contact c if c < z < c + h. It is not in the way where it is the ground's own
    scatter, or the face of a step that the body takes: with ground over it within `max_step` of c.
    """
    made = np.empty((len(points), 4))
    count = 0
    n = ceil(FACE / cell)
    for p in range(len(points)):
        z = points[p, 2]
        ci, cj = int((points[p, 0] - origin[0]) / cell), int((points[p, 1] - origin[1]) / cell)
        scatter, ledge = False, np.inf
        for i in range(max(ci - n, 0), min(ci + n + 1, height.shape[0])):
            for j in range(max(cj - n, 0), min(cj + n + 1, height.shape[1])):
                for k in range(height.shape[2]):
                    g = height[i, j, k]
                    if i == ci and j == cj and abs(g - z) <= SCATTER:
                        scatter = True
                    if g >= z - SCATTER and g < ledge:
                        ledge = g
        high = min(z - SCATTER, ledge - max_step)
        if not scatter and high > z - body:
            made[count, 0], made[count, 1] = points[p, 0], points[p, 1]
            made[count, 2], made[count, 3] = z - body, high
            count += 1
    return made[:count]


@njit(cache=True, nogil=True)
def _keep_off(
    places: FloatArray, origin: FloatArray, cell: float, far: float, height: FloatArray, clearance: NDArray[np.float32]
) -> None:
    """Lower the clearance of every cell within `far` of a place that stops a body on the cell's height."""
    n = ceil(far / cell)
    for p in range(len(places)):
        ci, cj = int((places[p, 0] - origin[0]) / cell), int((places[p, 1] - origin[1]) / cell)
        for i in range(max(ci - n, 0), min(ci + n + 1, height.shape[0])):
            for j in range(max(cj - n, 0), min(cj + n + 1, height.shape[1])):
                x, y = origin[0] + (i + 0.5) * cell, origin[1] + (j + 0.5) * cell
                distance = hypot(x - places[p, 0], y - places[p, 1])
                if distance >= far:
                    continue
                for k in range(height.shape[2]):
                    if places[p, 2] < height[i, j, k] < places[p, 3] and distance < clearance[i, j, k]:
                        clearance[i, j, k] = distance

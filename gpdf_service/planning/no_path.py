"""Why there is no path: which limit cuts the start from the goal, where, and how large a body would pass.

The ground of all levels is laid on one grid with, for each kind of obstacle, the distance to it. One kind after the
other is lifted, and the flood from the start looks whether that opens a way. The grid only explains; the refusal
itself comes from the exact graph.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from heapq import heappop, heappush

import numpy as np
from numba import njit
from scipy import ndimage
from scipy.spatial import cKDTree

from gpdf_service.perception import ObstacleKind
from gpdf_service.perception.levels import LEAST_OBSTACLE
from gpdf_service.perception.surface import UNKNOWN
from gpdf_service.planning.certificate import min_distance
from gpdf_service.planning.endpoints import Endpoint
from gpdf_service.planning.words import place_words
from gpdf_service.search import FreeSpace
from gpdf_service.types import BoolArray, FloatArray, IntArray

CELL = 0.025
"""[m] Half of the finest cell of the ground: the place of a cut is known to this."""
MAX_CELLS = 600_000
"""Cells of the grid over all levels, for an answer in a quarter of a second; a larger map gets wider ones."""
LOWEST_BODY = 0.1
"""[m] Material over this would let a lower body pass: the height of the lowest one, a Roomba."""
LEAST_RADIUS = 0.05
"""[m] Gaps narrower than twice this are gaps between measured points, not ways."""
LEAP = 2.0
"""[m] Ground that nobody has seen may join what is this near to it; of wider holes nothing is said."""
DETOUR = 10.0
"""[-] How much longer a way may be to cross a cut once less."""


_Found = tuple[str, FloatArray, str, float]
"""What cuts, where, in words, and the largest radius that passes [m]."""


class Cut(IntEnum):
    """What a way may have to cross, in the order of the grid's distances."""

    SOLID = 0
    HEIGHT = 1
    STEP = 2
    SLOPE = 3
    UNKNOWN = 4


@dataclass(frozen=True, slots=True)
class _Grid:
    """All levels on one grid: heights (L, nx, ny) [m], NaN where unknown; distance to each `Cut` (5, L, nx, ny) [m]."""

    origin: FloatArray
    width: float
    height: FloatArray
    distance: FloatArray

    def cell(self, end: Endpoint) -> IntArray:
        ij = np.floor((end.xy - self.origin) / self.width).astype(np.int64)
        return np.array([end.level, *np.clip(ij, 0, np.array(self.height.shape[1:]) - 1)])

    def centers(self, cells: IntArray) -> FloatArray:
        made: FloatArray = self.origin + (cells[:, 1:] + 0.5) * self.width
        return made


@dataclass(frozen=True, slots=True)
class NoPath:
    """Why there is no path.

    Attributes:
        message: In words, with what to try.
        cuts: What cuts start from goal: "width", "height", "step", "slope", "unknown" or "solid", the nearest first.
        at: Where the way first meets it (x, y, z of the ground) [m], shape (3,).
        largest_radius: Largest body that would pass, all else as it is [m]; 0 if none would.
    """

    message: str
    cuts: tuple[str, ...]
    at: FloatArray
    largest_radius: float


def explain_no_path(space: FreeSpace, start: Endpoint, goal: Endpoint) -> NoPath:
    """Find what cuts the start from the goal of a body that has no way between them."""
    grid = _lay_grid(space)
    ends = grid.cell(start), grid.cell(goal)
    radius = space.reach
    found: list[_Found] = []
    narrow = _widest(grid, ends, radius)
    if narrow > 0.0:
        path = _way(grid, ends, grid.distance.min(axis=0), narrow, ~np.isnan(grid.height))
        least, at = _exact_width(space, grid, path)
        width = min(least, radius)
        words = f"a passage at {place_words(at)} takes a body with a radius of {width:.2f} m, not one of {radius:.2f} m"
        if width >= LEAST_RADIUS:
            found.append(("width", at, words, width))
    for cut in (Cut.HEIGHT, Cut.STEP, Cut.SLOPE, Cut.UNKNOWN):
        path = _lift(grid, ends, (cut,), radius)
        if _meets(grid, path, cut):
            at, words = _met(space, grid, path, cut, start)
            found.append((cut.name.lower(), at, words, 0.0))
    largest = found[0][3] if found and found[0][0] == "width" else 0.0
    if found:
        return _tell(space, start, found, largest, together=False)
    return _tell(space, start, _together(space, grid, ends, start), largest, together=True)


def _together(space: FreeSpace, grid: _Grid, ends: tuple[IntArray, IntArray], start: Endpoint) -> list[_Found]:
    """What has to be lifted together: all that a more able body could take, or what is solid."""
    able = (Cut.HEIGHT, Cut.STEP, Cut.SLOPE, Cut.UNKNOWN)
    path = _lift(grid, ends, able, space.reach)
    met = [cut for cut in able if _meets(grid, path, cut, 2.0 * grid.width)]
    if len(path) == 0:
        path, met = _lift(grid, ends, tuple(Cut), space.reach), [Cut.SOLID]
    return [(cut.name.lower(), *_met(space, grid, path, cut, start), 0.0) for cut in met if _meets(grid, path, cut)]


def _tell(space: FreeSpace, start: Endpoint, found: list[_Found], largest: float, *, together: bool) -> NoPath:
    name = space.agent.name
    if not found:
        at = np.append(start.xy, space.surfaces[start.level].height_at(start.xy[None]))
        words = f"the {name} cannot get there: the ground of the start and that of the goal meet nowhere on the map."
        return NoPath(f"{words} Map what lies between them.", (), at, 0.0)
    hint = f"The largest body that passes has a radius of {largest:.2f} m." if largest else "No narrower body passes."
    joint = "; and " if together else "; another way: "
    return NoPath(
        f"the {name} cannot get there: {joint.join(words for _, _, words, _ in found)}. {hint}",
        tuple(kind for kind, _, _, _ in found),
        found[0][1],
        largest,
    )


def _lay_grid(space: FreeSpace) -> _Grid:
    first = space.surfaces[0]
    cells = len(space.surfaces) * first.height.size
    fine = max(1, min(round(first.cell_width / CELL), int(np.sqrt(MAX_CELLS / cells))))
    height = np.stack([np.kron(surface.height, np.ones((fine, fine))) for surface in space.surfaces])
    grid = _Grid(first.origin, first.cell_width / fine, height, np.full((len(Cut), *height.shape), np.inf))
    for level, found in enumerate(space.obstacles):
        cut = _cuts(space, level)
        ij = np.floor((found.points[:, :2] - grid.origin) / grid.width).astype(np.int64)
        ij = np.clip(ij, 0, np.array(height.shape[1:]) - 1)
        for kind in Cut:
            if (cut == kind).any():
                free = np.ones(height.shape[1:], dtype=bool)
                free[tuple(ij[cut == kind].T)] = False
                grid.distance[kind, level] = grid.width * ndimage.distance_transform_edt(free)
    return grid


def _cuts(space: FreeSpace, level: int) -> IntArray:
    """The `Cut` of each obstacle point of a level: its kind; material may be a step's face, or only too low."""
    surface, found = space.surfaces[level], space.obstacles[level]
    points, kind = found.points, found.kind.astype(np.int64)
    ground = ndimage.maximum_filter(np.where(surface.state != UNKNOWN, surface.height, -np.inf), size=3)
    ix, iy, _ = surface.cells(points)
    over = points[:, 2] - ground[ix, iy]
    seen = (kind == ObstacleKind.MATERIAL) & np.isfinite(over)
    table = np.array([Cut.SOLID, Cut.STEP, Cut.SLOPE, Cut.UNKNOWN])
    made = np.where(seen & (over > LOWEST_BODY), Cut.HEIGHT, table[kind])
    too_high = space.steps[level][ix, iy] > space.agent.max_step
    return np.where(seen & (over <= LEAST_OBSTACLE) & too_high, Cut.STEP, made)


def _opened(grid: _Grid, cuts: tuple[Cut, ...]) -> tuple[FloatArray, BoolArray]:
    """Distance to what is left when `cuts` are lifted, and where a centre may be."""
    left = [kind for kind in Cut if kind not in cuts]
    distance = grid.distance[left].min(axis=0) if left else np.full(grid.height.shape, np.inf)
    known = ~np.isnan(grid.height)
    if Cut.UNKNOWN in cuts:
        known = np.stack([ndimage.distance_transform_edt(~one) * grid.width <= LEAP for one in known])
    return distance, known


def _lift(grid: _Grid, ends: tuple[IntArray, IntArray], cuts: tuple[Cut, ...], radius: float) -> IntArray:
    """The way, cells (k, 3), when `cuts` stop nobody; empty where there is none."""
    distance, known = _opened(grid, cuts)
    if not _floods(_allow(distance >= radius, known, ends), grid.height, *ends):
        return np.zeros((0, 3), np.int64)
    return _way(grid, ends, distance, radius, known)


def _widest(grid: _Grid, ends: tuple[IntArray, IntArray], radius: float) -> float:
    """Largest radius up to the body's own that has a way [m], to half a cell; 0 if none of `LEAST_RADIUS` has."""
    distance, known = _opened(grid, ())
    low, high = LEAST_RADIUS, radius
    if not _floods(_allow(distance >= low, known, ends), grid.height, *ends):
        return 0.0
    while high - low > 0.5 * grid.width:
        middle = 0.5 * (low + high)
        passes = _floods(_allow(distance >= middle, known, ends), grid.height, *ends)
        low, high = (middle, high) if passes else (low, middle)
    return low


def _allow(wide: BoolArray, known: BoolArray, ends: tuple[IntArray, IntArray]) -> BoolArray:
    """Cells where a centre may be; those beside the ends, which are valid to the millimetre, always."""
    allowed = wide & known
    for level, i, j in ends:
        allowed[level, max(i - 2, 0) : i + 3, max(j - 2, 0) : j + 3] |= known[
            level, max(i - 2, 0) : i + 3, max(j - 2, 0) : j + 3
        ]
    return allowed


def _way(
    grid: _Grid, ends: tuple[IntArray, IntArray], distance: FloatArray, radius: float, known: BoolArray
) -> IntArray:
    """Shortest way that crosses as little as it can of what stops the body, in the middle where it is narrow."""
    shut = ~(grid.distance.min(axis=0) >= radius)
    weight = 1.0 + (radius / np.maximum(distance, grid.width)) ** 2 + DETOUR * shut
    path: IntArray = _dijkstra(_allow(distance >= radius, known, ends), grid.height, weight, *ends)
    return path


def _exact_width(space: FreeSpace, grid: _Grid, path: IntArray) -> tuple[float, FloatArray]:
    """Room that is proven along a way [m], and where it is least (3,)."""
    xy = grid.centers(path)
    cuts = np.flatnonzero(np.diff(path[:, 0])) + 1
    parts = [part for part in np.split(np.arange(len(path)), cuts) if len(part) > 1]
    proven = [(*min_distance(space, int(path[part[0], 0]), xy[part]), int(path[part[0], 0])) for part in parts]
    least, at, level = min(proven, key=lambda one: one[0])
    return least, np.append(at, space.surfaces[level].height_at(at[None]))


def _meets(grid: _Grid, path: IntArray, cut: Cut, within: float = np.inf) -> bool:
    """Whether a way comes nearer than `within` [m] to something of this kind."""
    return bool((grid.distance[cut][tuple(path.T)] < within).any())


def _reached(space: FreeSpace, grid: _Grid, path: IntArray, start: Endpoint) -> BoolArray:
    """Which cells of a way lie in leaves that the start can go to."""
    component, xy = space.graph.component, grid.centers(path)
    reached = np.zeros(len(path), dtype=bool)
    for level, (tree, offset) in enumerate(zip(space.quadtrees, space.offsets, strict=True)):
        leaf = tree.find(xy)
        mine = component[np.maximum(leaf, 0) + offset] == component[start.node]
        reached |= (path[:, 0] == level) & (leaf >= 0) & mine
    return reached


def _met(space: FreeSpace, grid: _Grid, path: IntArray, cut: Cut, start: Endpoint) -> tuple[FloatArray, str]:
    """Where a way first meets a cut (3,), after the last place that the start can go to, and what it is, in words."""
    agent, xy = space.agent, grid.centers(path)
    gap = grid.distance[cut][tuple(path.T)]
    beyond = np.arange(len(path)) > np.flatnonzero(_reached(space, grid, path, start)).max(initial=-1)
    shut = gap < max(space.reach, float(gap.min()) + 1e-9)
    shut = np.flatnonzero(shut & beyond if (shut & beyond).any() else shut)
    level = int(path[shut[0], 0])
    surface, found = space.surfaces[level], space.obstacles[level]
    points = found.points[_cuts(space, level) == cut]
    one = points[np.linalg.norm(points[:, :2] - xy[shut[0]], axis=1).argmin()]
    at = np.append(one[:2], surface.height_at(one[None, :2]))
    crossed = xy[shut[path[shut, 0] == level]]
    near = cKDTree(crossed).query(points[:, :2], distance_upper_bound=space.reach)[0] < np.inf
    worst = float(_values(space, level, np.vstack([points[near], one]), cut).max())
    where = place_words(at)
    return at, {
        Cut.SOLID: f"an obstacle closes the way at {where}",
        Cut.HEIGHT: f"there are {-worst:.2f} m of headroom at {where}, and it is {agent.height:.2f} m tall",
        Cut.STEP: f"a step or drop of {worst:.3f} m at {where} is higher than it takes ({agent.max_step:.3f} m)",
        Cut.SLOPE: f"a slope of {np.degrees(worst):.0f}° at {where} is steeper than it stands on "
        f"({np.degrees(agent.max_slope):.0f}°)",
        Cut.UNKNOWN: f"nobody has seen the ground at {where}",
    }[cut]


def _values(space: FreeSpace, level: int, points: FloatArray, cut: Cut) -> FloatArray:
    """How much each place asks of a body: step [m], slope [rad]; minus the headroom [m]."""
    surface = space.surfaces[level]
    ix, iy, _ = surface.cells(points)
    if cut == Cut.STEP:
        return space.steps[level][ix, iy]
    if cut == Cut.SLOPE:
        return space.slopes[level][ix, iy]
    ground = ndimage.maximum_filter(np.where(surface.state != UNKNOWN, surface.height, -np.inf), size=3)
    headroom: FloatArray = ground[ix, iy] - points[:, 2]
    return headroom


@njit(cache=True, nogil=True)
def _joined(height: FloatArray, here: int, there: int, i: int, j: int) -> bool:
    """Whether two levels are the same ground at a cell: where sheets overlap they share its height."""
    same: bool = abs(height[here, i, j] - height[there, i, j]) < 0.01
    return same


@njit(cache=True, nogil=True)
def _floods(allowed: BoolArray, height: FloatArray, start: IntArray, goal: IntArray) -> bool:
    """Whether allowed cells, side by side or where levels are joined, lead from start to goal."""
    levels, nx, ny = allowed.shape
    open_ = allowed.copy()
    stack = [(start[0], start[1], start[2])]
    while len(stack) > 0:
        level, i, j = stack.pop()
        if level == goal[0] and i == goal[1] and j == goal[2]:
            return True
        for di, dj in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            a, b = i + di, j + dj
            if 0 <= a < nx and 0 <= b < ny and open_[level, a, b]:
                open_[level, a, b] = False
                stack.append((level, a, b))
        for other in range(levels):
            if open_[other, i, j] and _joined(height, level, other, i, j):
                open_[other, i, j] = False
                stack.append((np.int64(other), i, j))
    return False


@njit(cache=True, nogil=True)
def _dijkstra(allowed: BoolArray, height: FloatArray, weight: FloatArray, start: IntArray, goal: IntArray) -> IntArray:
    """Cheapest way over allowed cells, shape (k, 3); empty where there is none."""
    levels, nx, ny = allowed.shape
    cost = np.full(allowed.size, np.inf)
    came_from = np.full(allowed.size, -1)
    first = (start[0] * nx + start[1]) * ny + start[2]
    last = (goal[0] * nx + goal[1]) * ny + goal[2]
    cost[first] = 0.0
    frontier = [(0.0, first)]
    while len(frontier) > 0:
        reached, node = heappop(frontier)
        if node == last:
            break
        if reached > cost[node]:
            continue
        level, i, j = node // (nx * ny), node // ny % nx, node % ny
        for k in range(8 + levels):
            if k < 8:
                t = k if k < 4 else k + 1  # the eight neighbours, without the cell itself
                to, a, b = level, i + t // 3 - 1, j + t % 3 - 1
                if a < 0 or b < 0 or a >= nx or b >= ny:
                    continue
                length = np.sqrt(float((a - i) ** 2 + (b - j) ** 2))
            else:
                to, a, b, length = k - 8, i, j, 0.0
                if to == level or not _joined(height, level, to, i, j):
                    continue
            if not allowed[to, a, b]:
                continue
            near = (to * nx + a) * ny + b
            further = reached + length * 0.5 * (weight[level, i, j] + weight[to, a, b])
            if further < cost[near]:
                cost[near], came_from[near] = further, node
                heappush(frontier, (further, near))
    path = [(0, 0, 0) for _ in range(0)]
    node = last if cost[last] < np.inf else -1
    while node >= 0:
        path.append((node // (nx * ny), node // ny % nx, node % ny))
        node = came_from[node]
    made = np.empty((len(path), 3), np.int64)
    for k in range(len(path)):
        made[k, 0], made[k, 1], made[k, 2] = path[len(path) - 1 - k]
    return made

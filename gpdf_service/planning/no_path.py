"""Why there is no path: which limit cuts the start from the goal, where, and how large a body would pass.

The ground around start and goal is laid on one grid with, for each kind of obstacle, the distance to it. One kind after
the other is lifted, and the flood from the start looks whether that opens a way. The grid only explains; the refusal
itself comes from the exact graph, and stands where no time is left to say why.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cached_property
from heapq import heappop, heappush
from math import sqrt
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from gpdf_service.ground import ObstacleKind
from gpdf_service.ground.foot import LEAST_OBSTACLE
from gpdf_service.ground.obstacles import least_headroom
from gpdf_service.kernel_cache import lean
from gpdf_service.planning.certificate import RESOLUTION
from gpdf_service.planning.endpoints import Endpoint
from gpdf_service.planning.words import measure, place_words
from gpdf_service.search.free_space import FreeSpace
from gpdf_service.search.places import least_distance, nearest_places
from gpdf_service.tiles import HeightMap
from gpdf_service.tiles.nearest import nearest_of
from gpdf_service.tiles.surface import UNKNOWN, Cells
from gpdf_service.types import Agent, BoolArray, FloatArray, IntArray

CELL = 0.025
"""[m] Half of the finest cell of the ground: the place of a cut is known to this."""
MAX_CELLS = 60_000
"""Cells of the grid over all levels, for an answer in 50 ms; a larger map gets wider ones."""
MARGINS = (6.0, 3.0, 1.5)
"""[m] Around start and goal, where the way is looked for that one would take; the first that `MAX_CELLS` hold."""
LOWEST_BODY = 0.1
"""[m] Material over this would let a lower body pass: the height of the lowest one, a Roomba."""
LEAST_RADIUS = 0.05
"""[m] Gaps narrower than twice this are gaps between measured points, not ways."""
ASIDE = 41
"""Places across a way of cells at which its room is looked for: 2.5 mm apart where the cells are the finest."""
MILLIMETRES = 0.05
"""[m] Less than this is told in millimetres."""
LEAP = 2.0
"""[m] Ground that nobody has seen may join what is this near to it; of wider holes nothing is said."""
STAGE = 0.01
"""[s] To lay the grid, or to lift a cut and find the way: it is not begun with less to the deadline."""
DETOUR = 10.0
"""[-] How much longer a way may be to cross a cut once less."""


_Found = tuple[str, FloatArray, str, float]
"""What cuts, where, in words, and by how much the body is beyond it: of a width what is missing in diameter [m]."""


class Cut(IntEnum):
    """What a way may have to cross, in the order of the grid's distances."""

    SOLID = 0
    HEIGHT = 1
    STEP = 2
    SLOPE = 3
    UNKNOWN = 4


class _Told(NamedTuple):
    """Obstacle points of a level that are near (k, 3) [m], the `Cut` of each, and how much it asks of a body (k,).

    That is a step [m], a slope [rad], minus the headroom [m], or 0.
    """

    points: FloatArray
    cut: NDArray[np.uint8]
    asks: FloatArray


@dataclass(frozen=True)
class _Grid:
    """Levels on one grid: heights (L, nx, ny) [m], NaN where unknown; distance to each `Cut` (5, L, nx, ny) [m].

    `level` says which one of the space's each of them is, and `told` what was laid on the grid of it.
    """

    origin: FloatArray
    width: float
    level: list[int]
    height: FloatArray
    distance: FloatArray
    told: list[_Told]

    @cached_property
    def known(self) -> BoolArray:
        """Where ground is known, shape (L, nx, ny)."""
        return ~np.isnan(self.height)

    @cached_property
    def guessed(self) -> BoolArray:
        """Where ground that nobody has seen may be, or is known."""
        return np.stack([nearest_of(one)[0] * self.width <= LEAP for one in self.known])

    @cached_property
    def nearest(self) -> FloatArray:
        """Distance to what stops the body (L, nx, ny) [m]."""
        made: FloatArray = self.distance.min(axis=0)
        return made

    def cell(self, end: Endpoint) -> IntArray:
        ij = np.floor((end.xy - self.origin) / self.width).astype(np.int64)
        return np.array([self.level.index(end.level), *np.clip(ij, 0, np.array(self.height.shape[1:]) - 1)])

    def centers(self, cells: IntArray) -> FloatArray:
        made: FloatArray = self.origin + (cells[:, 1:] + 0.5) * self.width
        return made


@dataclass(frozen=True, slots=True)
class NoPath:
    """Why there is no path, in words, and what to try; where the way first meets what cuts it, (3,) [m].

    The `cuts` are "width", "height", "step", "slope", "unknown" or "solid", the nearest first; its `short` says by
    how much the body is beyond it: width, height and step [m], slope [rad], 0 where that says nothing. The largest body
    that would pass, all else as it is, has a `largest_radius` [m], 0 if none would.
    """

    message: str
    cuts: tuple[str, ...]
    at: FloatArray
    largest_radius: float
    short: dict[str, float] = field(default_factory=dict)


def explain_no_path(
    space: FreeSpace, start: Endpoint, goal: Endpoint, left: Callable[[], float] = lambda: np.inf, hidden: float = 0.0
) -> NoPath:
    """Find what cuts the start from the goal of a body that has no way between them, in the seconds that are `left`.

    Things that are so low may be `hidden` in the scene [m].
    """
    if left() < STAGE:
        return _no_time(space, start)
    grid = _lay_grid(space, start, goal, hidden)
    ends = grid.cell(start), grid.cell(goal)
    radius, largest = space.reach, 0.0
    found: list[_Found] = []
    if left() >= STAGE and (narrow := _widest(grid, ends, radius)) > 0.0:
        path = _way(grid, ends, grid.nearest, narrow, grid.known)
        least, at = _exact_width(space, grid, path)
        width = min(least - _kept(space), radius)
        margin = radius - space.agent.disc_radius
        if width - margin >= LEAST_RADIUS:
            largest = width - margin
            found.append(("width", at, _narrow_words(at, width, radius, margin), 2.0 * (radius - width)))
    for cut in (Cut.HEIGHT, Cut.STEP, Cut.SLOPE, Cut.UNKNOWN):
        if left() < STAGE:
            break
        path = _lift(grid, ends, (cut,), radius)
        if _meets(grid, path, cut):
            found.append((cut.name.lower(), *_met(space, grid, path, cut, start)))
    if not found and left() < STAGE:
        return _no_time(space, start)
    if found:
        return _tell(space, start, found, largest, together=False)
    return _tell(space, start, _together(space, grid, ends, start), largest, together=True)


def _kept(space: FreeSpace) -> float:
    """Room that the search needs beyond a body's reach [m]: its margin, and what leaves lie beside the middle.

    In a passage that goes askew to them that is half of a leaf's diagonal.
    """
    return space.radius - space.reach + max(own.quadtree.width for own in space.levels) / sqrt(2.0)


def _no_time(space: FreeSpace, start: Endpoint) -> NoPath:
    words = f"the {space.agent.name} cannot get there; the deadline left no time to say why. Allow more."
    return NoPath(words, (), np.append(start.xy, start.floor), 0.0)


def _narrow_words(at: FloatArray, width: float, radius: float, margin: float) -> str:
    """A passage that is too narrow, in millimetres where centimetres do not tell; the `margin` is for the noise [m]."""
    short = 2.0 * (radius - width)
    words = f"{1e3 * short:.0f} mm" if short < MILLIMETRES else f"{short:.2f} m"
    noise = f", {2.0 * margin:.3f} m of it for the noise of the scan" if margin > 0.0 else ""
    room = f"it leaves a body {2.0 * width:.3f} m, and this one needs {2.0 * radius:.3f} m{noise}"
    return f"a passage at {place_words(at)} is {words} too narrow ({room})"


def _together(space: FreeSpace, grid: _Grid, ends: tuple[IntArray, IntArray], start: Endpoint) -> list[_Found]:
    """What has to be lifted together: all that a more able body could take, or what is solid."""
    able = (Cut.HEIGHT, Cut.STEP, Cut.SLOPE, Cut.UNKNOWN)
    path = _lift(grid, ends, able, space.reach)
    met = [cut for cut in able if _meets(grid, path, cut, 2.0 * grid.width)]
    if len(path) == 0:
        path, met = _lift(grid, ends, tuple(Cut), space.reach), [Cut.SOLID]
    return [(cut.name.lower(), *_met(space, grid, path, cut, start)) for cut in met if _meets(grid, path, cut)]


def _tell(space: FreeSpace, start: Endpoint, found: list[_Found], largest: float, *, together: bool) -> NoPath:
    name = space.agent.name
    if not found:
        words = f"the {name} cannot get there: the ground of the start and that of the goal meet nowhere on the map."
        return NoPath(f"{words} Map what lies between them.", (), np.append(start.xy, start.floor), 0.0)
    hint = f"The largest body that passes has a radius of {measure(largest)} m."
    hint = hint if largest else "No narrower body passes."
    joint = "; and " if together else "; another way: "
    words = f"the {name} cannot get there: {joint.join(words for _, _, words, _ in found)}. {hint}"
    short = {kind: much for kind, _, _, much in found}
    return NoPath(words, tuple(short), found[0][1], largest, short)


def _lay_grid(space: FreeSpace, start: Endpoint, goal: Endpoint, hidden: float = 0.0) -> _Grid:
    """The ground around start and goal, of the levels that have some there."""
    first, ends = space.levels[0].surface, np.stack([start.xy, goal.xy])
    least = np.min([one.origin for one in space.surfaces], axis=0)
    most = np.max([one.origin + one.cell_width * np.array(one.state.shape) for one in space.surfaces], axis=0)
    for margin in MARGINS:
        low, high = np.maximum(ends.min(axis=0) - margin, least), np.minimum(ends.max(axis=0) + margin, most)
        low = first.origin + np.floor((low - first.origin) / first.cell_width) * first.cell_width
        level = [n for n, one in enumerate(space.surfaces) if _is_known(one, low, high)]
        cells = len(level) * np.prod(np.ceil((high - low) / first.cell_width))
        if cells <= MAX_CELLS:
            break
    share = max(CELL / first.cell_width, np.sqrt(cells / MAX_CELLS))
    width = first.cell_width * np.ceil(share) if share > 1.0 else first.cell_width / np.floor(1.0 / share)
    height = np.stack([_heights(space.levels[n].surface, low, high, width) for n in level])
    told = [_told(space, n, low, high, hidden) for n in level]
    distance = np.full((len(Cut), *height.shape), np.inf)
    for own, (points, cut, _) in zip(distance.swapaxes(0, 1), told, strict=True):
        marks, last = np.zeros(own.shape, np.bool_), np.array(own.shape[1:]) - 1.0
        cells = np.clip((points[:, :2] - low) / width, 0.0, last)  # those beyond the grid count on its rim
        marks[cut, *cells.astype(np.int64).T] = True
        for kind in np.flatnonzero(marks.any(axis=(1, 2))):
            own[kind] = width * nearest_of(marks[kind])[0]
    return _Grid(low, width, level, height, distance, told)


def _is_known(surface: HeightMap, low: FloatArray, high: FloatArray) -> bool:
    """Whether any ground is known from `low` to `high` [m]."""
    first, last = (np.maximum(np.ceil((at - surface.origin) / surface.cell_width), 0).astype(int) for at in (low, high))
    return bool((surface.state[first[0] : last[0], first[1] : last[1]] != UNKNOWN).any())


def _heights(surface: HeightMap, low: FloatArray, high: FloatArray, width: float) -> FloatArray:
    """Height of the ground in the middle of cells of that `width` from `low` to `high` [m], NaN where unknown."""
    made = np.full(np.maximum(np.ceil((high - low) / width - 1e-9), 1.0).astype(np.int64), np.nan)
    at = [low[k] + (np.arange(made.shape[k]) + 0.5) * width for k in (0, 1)]
    cell = [np.floor((at[k] - surface.origin[k]) / surface.cell_width).astype(np.int64) for k in (0, 1)]
    inside = [(cell[k] >= 0) & (cell[k] < surface.state.shape[k]) for k in (0, 1)]
    here = np.ix_(cell[0][inside[0]], cell[1][inside[1]])
    made[np.ix_(*inside)] = np.where(surface.state[here] != UNKNOWN, surface.height[here], np.nan)
    return made


def _told(space: FreeSpace, level: int, low: FloatArray, high: FloatArray, hidden: float) -> _Told:
    """What is told of the obstacle points of a level that are within reach of a grid from `low` to `high` [m]."""
    own, agent, box = space.levels[level], space.agent, np.stack([low - space.reach, high + space.reach])
    room = max(LOWEST_BODY, least_headroom(own.surface, hidden)), agent.height, agent.cylinder.radius
    ground = own.surface.arrays, (own.steps, own.slopes), agent.max_step, room
    found = [_tell_points(one.points, one.kind, box, *ground) for one in (own.standing, own.moving)]
    return _Told(*(np.concatenate(parts) for parts in zip(*found, strict=True)))


@njit(cache=True, nogil=True)
def _tell_points(
    points: FloatArray,
    kind: NDArray[np.uint8],
    box: FloatArray,
    ground: Cells,
    measured: tuple[FloatArray, FloatArray],
    max_step: float,
    room: tuple[float, float, float],
) -> tuple[FloatArray, NDArray[np.uint8], FloatArray]:
    """The points in a box, the `Cut` of each, and what it asks; `measured` are steps [m] and slopes [rad].

    `room` is the headroom under which no body is led, the body's height, and its radius, within which it may stand on
    higher ground [m].
    """
    lowest, tall, radius = room
    row, cut, asks, count = np.empty(len(points), np.int64), np.empty(len(points), np.uint8), np.zeros(len(points)), 0
    (nx, ny), (steps, slopes) = ground.state.shape, measured
    for i in range(len(points)):
        x, y, z = points[i]
        if not (box[0, 0] <= x <= box[1, 0] and box[0, 1] <= y <= box[1, 1]):
            continue
        u = int(min(max((x - ground.origin[0]) / ground.width, 0.0), nx - 1.0))
        v = int(min(max((y - ground.origin[1]) / ground.width, 0.0), ny - 1.0))
        top, told = _highest(ground, u, v, 1), int(kind[i]) + 1
        if kind[i] == ObstacleKind.MATERIAL:  # a step's face, or what is only too low
            face = z - top <= LEAST_OBSTACLE and steps[u, v] > max_step
            if top > -np.inf and z - top >= tall:
                top = _highest(ground, u, v, int(radius / ground.width) + 1)
            low = lowest < z - top < tall
            told = Cut.SOLID if top == -np.inf else Cut.HEIGHT if low else Cut.STEP if face else Cut.SOLID
        if told == Cut.HEIGHT:
            asks[count] = top - z
        elif told == Cut.STEP or told == Cut.SLOPE:
            asks[count] = steps[u, v] if told == Cut.STEP else slopes[u, v]
        row[count], cut[count] = i, told
        count += 1
    return points[row[:count]], cut[:count], asks[:count]


@njit(cache=True, nogil=True)
def _highest(ground: Cells, u: int, v: int, reach: int) -> float:
    """The highest ground in a cell and those around it up to so many off [m], −inf where none is known."""
    top = -np.inf
    for a in range(max(u - reach, 0), min(u + reach + 1, ground.state.shape[0])):
        for b in range(max(v - reach, 0), min(v + reach + 1, ground.state.shape[1])):
            if ground.state[a, b] != UNKNOWN:
                top = max(top, ground.height[a, b])
    return top


def _lift(grid: _Grid, ends: tuple[IntArray, IntArray], cuts: tuple[Cut, ...], radius: float) -> IntArray:
    """The way, cells (k, 3), when `cuts` stop nobody; empty where there is none."""
    distance = grid.distance[[kind for kind in Cut if kind not in cuts]].min(axis=0, initial=np.inf)
    known = grid.guessed if Cut.UNKNOWN in cuts else grid.known
    if not _floods(_allow(distance >= radius, known, ends), grid.height, *ends):
        return np.zeros((0, 3), np.int64)
    return _way(grid, ends, distance, radius, known)


def _widest(grid: _Grid, ends: tuple[IntArray, IntArray], radius: float) -> float:
    """Largest radius up to the body's own that has a way [m], to half a cell; 0 if none of `LEAST_RADIUS` has."""

    def passes(wide: float) -> bool:
        return bool(_floods(_allow(grid.nearest >= wide, grid.known, ends), grid.height, *ends))

    low, high = LEAST_RADIUS, radius
    if not passes(low):
        return 0.0
    while high - low > 0.5 * grid.width:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if passes(middle) else (low, middle)
    return low


def _allow(wide: BoolArray, known: BoolArray, ends: tuple[IntArray, IntArray]) -> BoolArray:
    """Cells where a centre may be; those beside the ends, which are valid to the millimetre, always."""
    allowed = wide & known
    for level, i, j in ends:
        beside = level, slice(max(i - 2, 0), i + 3), slice(max(j - 2, 0), j + 3)
        allowed[beside] |= known[beside]
    return allowed


def _way(
    grid: _Grid, ends: tuple[IntArray, IntArray], distance: FloatArray, radius: float, known: BoolArray
) -> IntArray:
    """Shortest way that crosses as little as it can of what stops the body, in the middle where it is narrow."""
    weight = 1.0 + (radius / np.maximum(distance, grid.width)) ** 2 + DETOUR * ~(grid.nearest >= radius)
    path: IntArray = _cheapest(_allow(distance >= radius, known, ends), grid.height, weight, *ends)
    return path


def _exact_width(space: FreeSpace, grid: _Grid, path: IntArray) -> tuple[float, FloatArray]:
    """Room that is proven along a way [m], and where it is least (3,)."""
    xy = grid.centers(path)
    cuts = np.flatnonzero(np.diff(path[:, 0])) + 1
    parts = [(grid.level[path[part[0], 0]], xy[part]) for part in np.split(np.arange(len(path)), cuts) if len(part) > 1]
    middle = [(level, _to_middle(space, level, way, grid.width)) for level, way in parts]

    def prove(level: int, way: FloatArray) -> tuple[float, FloatArray, int]:
        poses = np.column_stack([way, np.zeros(len(way))])
        return *least_distance(space.levels[level].places, poses, np.zeros(1), RESOLUTION), level

    pairs = zip(parts, middle, strict=True)
    proven = [max(prove(*one), prove(*other), key=lambda found: found[0]) for one, other in pairs]
    least, at, level = min(proven, key=lambda one: one[0])
    return least, np.append(at, space.levels[level].surface.height_at(at[None]))


def _to_middle(space: FreeSpace, level: int, way: FloatArray, width: float) -> FloatArray:
    """A way over cells, (n, 2), moved aside by two of them at most to where there is most room; its ends stay."""
    ahead = np.gradient(ndimage.gaussian_filter1d(way, 2.0, axis=0, mode="nearest"), axis=0)
    aside = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1) / np.maximum(np.linalg.norm(ahead, axis=1), 1e-9)[:, None]
    tried = way[:, None] + 2.0 * width * np.linspace(-1.0, 1.0, ASIDE)[None, :, None] * aside[:, None]
    room = nearest_places(space.levels[level].places, tried.reshape(-1, 2))[0]
    moved: FloatArray = tried[np.arange(len(way)), room.reshape(len(way), ASIDE).argmax(axis=1)]
    moved[0], moved[-1] = way[0], way[-1]
    return moved


def _meets(grid: _Grid, path: IntArray, cut: Cut, within: float = np.inf) -> bool:
    """Whether a way comes nearer than `within` [m] to something of this kind."""
    return bool((grid.distance[cut][tuple(path.T)] < within).any())


def _reached(space: FreeSpace, grid: _Grid, path: IntArray, start: Endpoint) -> BoolArray:
    """Which cells of a way lie in leaves that the start can go to."""
    component, xy = space.graph.component, grid.centers(path)
    reached = np.zeros(len(path), dtype=bool)
    for n, level in enumerate(grid.level):
        own = space.levels[level]
        leaf = own.quadtree.find(xy)
        mine = component[np.maximum(leaf, 0) + own.offset] == component[start.node]
        reached |= (path[:, 0] == n) & (leaf >= 0) & mine
    return reached


def _met(space: FreeSpace, grid: _Grid, path: IntArray, cut: Cut, start: Endpoint) -> tuple[FloatArray, str, float]:
    """Where a way first meets a cut (3,), after the last place that the start can go to; what it is, and how much."""
    agent, xy = space.agent, grid.centers(path)
    gap = grid.distance[cut][tuple(path.T)]
    beyond = np.arange(len(path)) > np.flatnonzero(_reached(space, grid, path, start)).max(initial=-1)
    shut = gap < max(space.reach, float(gap.min()) + 1e-9)
    shut = np.flatnonzero(shut & beyond if (shut & beyond).any() else shut)
    told = grid.told[path[shut[0], 0]]
    points, asks = told.points[told.cut == cut], told.asks[told.cut == cut]
    first = np.linalg.norm(points[:, :2] - xy[shut[0]], axis=1).argmin()
    beside = cKDTree(xy[path[:, 0] == path[shut[0], 0]])  # of cells that are open, too: the grid is coarse
    near = np.isfinite(beside.query(points[:, :2], distance_upper_bound=space.reach + _kept(space))[0])
    worst = float(asks[near].max(initial=asks[first]))
    surface = space.levels[grid.level[path[shut[0], 0]]].surface
    at = np.append(points[first, :2], surface.height_at(points[first, None, :2]))
    limit = {Cut.HEIGHT: -agent.height, Cut.STEP: agent.max_step, Cut.SLOPE: agent.max_slope}
    return at, _cut_words(agent, cut, worst, place_words(at)), worst - limit[cut] if cut in limit else 0.0


def _cut_words(agent: Agent, cut: Cut, worst: float, where: str) -> str:
    """What stops a body somewhere, and what it would take."""
    highest, steepest = f"{measure(agent.max_step)} m", f"{np.degrees(agent.max_slope):.0f}°"
    return {
        Cut.SOLID: f"an obstacle closes the way at {where}",
        Cut.HEIGHT: f"there are {measure(-worst)} m of headroom at {where}, and it is {measure(agent.height)} m tall",
        Cut.STEP: f"a step or drop of {measure(worst)} m at {where} is higher than it takes ({highest})",
        Cut.SLOPE: f"a slope of {np.degrees(worst):.0f}° at {where} is steeper than it stands on ({steepest})",
        Cut.UNKNOWN: f"nobody has seen the ground at {where}",
    }[cut]


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


@lean()
def _ahead(a: int, b: int, goal: IntArray) -> float:
    """Cells at least from one to the goal, over sides and corners."""
    u, v = abs(a - goal[1]), abs(b - goal[2])
    return float(max(u, v) + (sqrt(2.0) - 1.0) * min(u, v))


@njit(cache=True, nogil=True)
def _cheapest(allowed: BoolArray, height: FloatArray, weight: FloatArray, start: IntArray, goal: IntArray) -> IntArray:
    """Cheapest way over allowed cells (A*), shape (k, 3), each of a weight of 1 or more; empty where there is none."""
    levels, nx, ny = allowed.shape
    cost = np.full(allowed.size, np.inf)
    came_from = np.full(allowed.size, -1)
    first = (start[0] * nx + start[1]) * ny + start[2]
    last = (goal[0] * nx + goal[1]) * ny + goal[2]
    cost[first] = 0.0
    frontier = [(_ahead(start[1], start[2], goal), first)]
    while len(frontier) > 0:
        estimate, node = heappop(frontier)
        if node == last:
            break
        level, i, j = node // (nx * ny), node // ny % nx, node % ny
        reached = cost[node]
        if estimate > reached + _ahead(i, j, goal):
            continue
        for k in range(8 + levels):
            if k < 8:
                t = k if k < 4 else k + 1  # the eight neighbours, without the cell itself
                to, a, b = level, i + t // 3 - 1, j + t % 3 - 1
                if a < 0 or b < 0 or a >= nx or b >= ny:
                    continue
                length = np.sqrt(float((a - i) ** 2 + (b - j) ** 2))
            else:
                to, a, b, length = k - 8, i, j, 0.0
            if not allowed[to, a, b] or (k >= 8 and (to == level or not _joined(height, level, to, i, j))):
                continue
            near = (to * nx + a) * ny + b
            further = reached + length * 0.5 * (weight[level, i, j] + weight[to, a, b])
            if further < cost[near]:
                cost[near], came_from[near] = further, node
                heappush(frontier, (further + _ahead(a, b, goal), near))
    path, node = [0 for _ in range(0)], last if cost[last] < np.inf else -1
    while node >= 0:
        path.append(node)
        node = came_from[node]
    cells = np.array(path[::-1], np.int64)
    return np.stack((cells // (nx * ny), cells // ny % nx, cells % ny), axis=1)

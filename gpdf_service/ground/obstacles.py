"""Everything that stops one kind of body on one level, as one 2D point set with a reason for each point."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gpdf_service.fields.threads import run_chunked, run_parallel
from gpdf_service.ground.foot import FACE, LEAST_OBSTACLE, SOLE, STRIDE, astray
from gpdf_service.ground.footing import ROUGH, by_treads, ends_around, footing_reach, is_tread, on_treads, rings_of
from gpdf_service.ground.level import GroundLevel
from gpdf_service.ground.limits import GroundLimits, ObstacleKind
from gpdf_service.kernel_cache import lean
from gpdf_service.tiles.boxes import widened
from gpdf_service.tiles.nearest import nearest_of
from gpdf_service.tiles.points import Points
from gpdf_service.tiles.rows import between, chosen_rows, under
from gpdf_service.tiles.surface import INFERRED, UNKNOWN, Cells, HeightMap, cells_within
from gpdf_service.types import Agent, BoolArray, ByteArray, Float32Array, FloatArray, IntArray

HEADROOM_SHARE = 0.01
"""[-] How well a scan knows the room over the ground, over the body's height: 2 cm for a person, 1 mm for a Roomba."""
_SURELY = 2.0
"""[-] Standard deviations by which what is no ground must be measured lower than an obstacle is, not to be one."""


@dataclass(frozen=True, slots=True)
class Obstacles:
    """Points [m], shape (j, 3), and the `ObstacleKind` of each, shape (j,)."""

    points: FloatArray
    kind: ByteArray


class Scan(NamedTuple):
    """What obstacles need to know of the cloud.

    Attributes:
        noise: Standard deviation of its points [m].
        hidden: What is lower may stand on the ground unseen [m].
        voxels: Whether its points are centres of voxels: `voxel_pitch`.
    """

    noise: float = 0.0
    hidden: float = 0.0
    voxels: bool = False


CLEAN = Scan()
"""A cloud of a perfect scanner."""


def obstacles_of(level: GroundLevel, agent: Agent, scan: Scan = CLEAN, limits: GroundLimits | None = None) -> Obstacles:
    """What stops `agent` on `level` of a cloud from such a `scan`.

    Material is an obstacle if a body that reaches it is as tall, on the highest ground within its radius that it has
    risen to: the paper's d_g(x) ≤ h_r, made safe beside a platform. The face between two pieces of ground that are
    joined by a step which the body takes is none. A face as wide as a cell shows a point in nearly every cell's width
    of its height (so wide are they chosen), and a leg half as wide in every two. So what begins no more than a cell
    over what may be hidden may go down to the ground, or two over what stops nobody; a body is at least as tall. Limits
    of the ground, all that the level has if they are not given, are obstacles where they exceed the body's.
    """
    touched = _material(level, agent, scan)
    limits = level.limits if limits is None else limits
    reach = np.array([0.0, agent.max_step, agent.max_slope, -np.inf])[limits.kind]
    stops = limits.value > reach
    points = chosen_rows(level.other_points, touched, chosen_rows(limits.points, stops))
    kind = np.full(len(points), int(ObstacleKind.MATERIAL), np.uint8)
    kind[np.count_nonzero(touched) :] = limits.kind[stops]
    return Obstacles(points, kind)


def least_headroom(surface: HeightMap, hidden: float) -> float:
    """What begins lower over this ground may go down to it: no body is led under it [m]; see `obstacles_of`."""
    return max(hidden, LEAST_OBSTACLE + surface.cell_width) + surface.cell_width


def obstacles_reach(surface: HeightMap, agent: Agent) -> tuple[int, int]:
    """Cells within which a level decides on an obstacle: its ground, and its other points.

    A body stands within its radius of it where no material within its discs' radius shuts that off; that is told by
    the ground within the radius again, or as far as treads are told from ridges.
    """
    body, shut, tread = _rings(surface, agent)
    return shut + max(body, tread), shut


def _rings(surface: HeightMap, agent: Agent) -> tuple[int, int, int]:
    """Cells to where the body stands, to what shuts that off, and to the ground that tells a tread; see above."""
    width = surface.cell_width
    body = int(np.ceil(agent.cylinder.radius / width)) + 1
    return body, body + int(np.ceil(agent.disc_radius / width)), footing_reach(surface) + rings_of(SOLE, width) + 1


def obstacles_felt(touched: BoolArray, was: HeightMap, surface: HeightMap, agent: Agent) -> BoolArray:
    """Cells in which a level may decide otherwise on obstacles than before, shape (nx, ny).

    As far as ground tells of treads it decides only where there is some, now or before: see `is_tread`.

    In the `touched` ones something of the level is other than it `was`.
    """
    body, shut, tread = _rings(surface, agent)
    return widened(touched, shut + body) | widened(by_treads(touched, tread, (was, surface), 1), shut)


def _material(level: GroundLevel, agent: Agent, scan: Scan) -> BoolArray:
    """Which of the other points of the level stop the `agent`, shape (m,); see `obstacles_of`."""
    surface, points, noise = level.surface, level.other_points, scan.noise
    least = max(LEAST_OBSTACLE, _SURELY * noise)
    known = surface.state != UNKNOWN
    top = np.where(known, surface.height, -np.inf)
    bottom = np.where(known, surface.height, np.inf)
    disc = _disc(agent.cylinder.radius + surface.cell_width, surface)
    tall = max((1.0 - HEADROOM_SHARE) * agent.height + noise, least_headroom(surface, scan.hidden))
    highest, lowest = run_parallel(lambda heights: highest_within(heights, disc), (top, -bottom))
    lowest, cell, z = -lowest, cells_within(points, surface), points[:, 2]
    stops = between(cell, z, under(lowest - least), under(highest + tall))
    rows = np.flatnonzero(stops)
    stops[rows] = ~_is_face(level, rows, cell, agent.max_step, scan)
    rows = np.flatnonzero(stops)
    cell, z = cell[rows], z[rows]
    # Beside a step the question is which ground the body stands on; not on what stops it wherever it stands.
    always = between(cell, z, np.full_like(lowest, -np.inf), under(lowest + tall))
    taken = np.zeros(known.shape, dtype=bool)
    taken.ravel()[cell[always]] = True
    shut = (nearest_of(taken)[0] + np.sqrt(2.0)) * surface.cell_width < agent.disc_radius
    stops[rows] = always
    asked = rows[~always]
    stops[asked] = _over_head(points[asked], surface, known & ~shut, agent, tall)
    return stops


def _over_head(points: FloatArray, surface: HeightMap, stands: BoolArray, agent: Agent, tall: float) -> BoolArray:
    """Which points, (m, 3), a body as `tall` [m] touches that `stands` anywhere in these cells, shape (nx, ny).

    On a flight it rises with its centre half a foot's length past a nose: nearer, its foot is on the lower tread.
    """
    hit = np.zeros(len(points), dtype=bool)
    limits = agent.cylinder.radius, tall, agent.max_step, rings_of(STRIDE, surface.cell_width)
    run_chunked(lambda a, b: _heads(points[a:b], surface.arrays, stands, limits, hit[a:b]), len(points))
    return hit


@njit(cache=True, nogil=True)
def _heads(
    points: FloatArray, ground: Cells, stands: BoolArray, limits: tuple[float, float, float, int], hit: BoolArray
) -> None:
    """See `_over_head`; the `limits` are the body's radius, its height and its step [m], and a stride in cells."""
    (nx, ny), width, height, (radius, tall, max_step, stride) = stands.shape, ground.width, ground.height, limits
    rings = int(radius / width) + 1
    for m in range(len(points)):
        x, y = (points[m, 0] - ground.origin[0]) / width, (points[m, 1] - ground.origin[1]) / width
        for i in range(max(int(x) - rings, 0), min(int(x) + rings + 1, nx)):
            for j in range(max(int(y) - rings, 0), min(int(y) + rings + 1, ny)):
                if hit[m] or not stands[i, j] or height[i, j] + tall <= points[m, 2]:
                    continue
                u, v = min(max(x, float(i)), i + 1.0), min(max(y, float(j)), j + 1.0)
                near = np.hypot(x - u, y - v) * width
                if near >= radius:
                    continue
                hit[m] = True
                if near > 0.0 and np.hypot(x - i - 0.5, y - j - 0.5) * width > radius - SOLE:
                    ahead = min(SOLE / near, 1.0)
                    foot = height[int(u + ahead * (x - u)), int(v + ahead * (y - v))]
                    low = height[i, j] - max_step <= foot <= points[m, 2] - tall
                    hit[m] = not (low and is_tread(height, i, j, stride))


def _is_face(level: GroundLevel, rows: IntArray, cell: IntArray, max_step: float, scan: Scan) -> BoolArray:
    """Which points in these `rows` belong to the ground: its scatter, or the face of a step that the body takes.

    A face lies between two pieces of ground, the upper one right beside it and no lower than it, the lower one not far.
    The upper one is a point of the ground, for cells can be wider than a tread, or inferred; and a step over some:
    what stands on a floor is not the floor's face. On a flight, where treads are rough, `on_treads` tells.
    """
    surface, noise = level.surface, scan.noise
    known = np.where(surface.state != UNKNOWN, surface.height, np.float32(np.nan))
    narrow, rings = surface.cell_width <= FACE, astray(surface, noise)
    told = _Beside(known, surface.state == INFERRED, narrow, scan.voxels, rings, max_step, noise)
    other, face = (level.other_points, cell, level.ledge), np.zeros(len(rows), dtype=bool)
    run_chunked(lambda a, b: _faces(rows[a:b], other, told, face[a:b]), len(rows))
    if max_step > ROUGH:
        rest = rows[~face]
        face[~face] = on_treads(level.other_points[rest, 2], cell[rest], surface, max_step)
    return face


class _Beside(NamedTuple):
    """What the ground beside a point tells of it: heights [m], NaN where unknown, and what is inferred, (nx, ny) each.

    If cells are `narrow`, inferred ones around a point's own are as near as a step's top to its face. A point of a face
    may lie `rings` cells from the ground over or under it.
    """

    known: Float32Array
    inferred: BoolArray
    narrow: bool
    voxels: bool
    rings: int
    max_step: float
    noise: float


@njit(cache=True, nogil=True)
def _faces(rows: IntArray, other: tuple[FloatArray, IntArray, Float32Array], told: _Beside, face: BoolArray) -> None:
    """See `_is_face`: the `other` points, their cells and their ledges are told."""
    (points, cell, ledges), known, noise = other, told.known, told.noise
    step, here = max(LEAST_OBSTACLE, noise), -1
    x, y, low, high, lowest = 0, 0, 0.0, 0.0, 0.0
    for m in range(len(rows)):
        row = rows[m]
        if cell[row] != here:  # points of one cell follow one another
            here = cell[row]
            x, y = here // known.shape[1], here % known.shape[1]
            (low, high), lowest = ends_around(known, x, y, told.rings), ends_around(known, x, y, 1)[0]
        z, face[m] = points[row, 2], False
        ledge = _ledge_beside(told, x, y, z, low + step, float(ledges[row]))
        if ledge < np.inf:
            face[m] = ledge <= _highest_up_to(ledge - step, known, x, y, told.rings) + told.max_step
        scatter = step if high - low > step else LEAST_OBSTACLE - _SURELY * noise
        face[m] |= np.isfinite(lowest) and z <= lowest + scatter


@lean()
def _ledge_beside(told: _Beside, x: int, y: int, z: float, least: float, ledge: float) -> float:
    """The `ledge` of a point at z, or ground at `least` so high beside, of a tread in a shadow, or of a voxel [m]."""
    for i in range(max(x - 1, 0), min(x + 2, told.known.shape[0])):
        for j in range(max(y - 1, 0), min(y + 2, told.known.shape[1])):
            beside, near = float(told.known[i, j]), told.narrow or (i == x and j == y)
            shadow = told.inferred[i, j] and near and z - told.noise <= beside
            level = told.voxels and abs(z - beside) <= LEAST_OBSTACLE
            if (shadow or level) and least <= beside < ledge:
                ledge = beside
    return ledge


@lean()
def _highest_up_to(most: float, height: Float32Array, x: int, y: int, rings: int) -> float:
    """Height of the highest ground within so many cells that is no higher than `most` [m], -inf where there is none."""
    found = -np.inf
    for i in range(max(x - rings, 0), min(x + rings + 1, height.shape[0])):
        for j in range(max(y - rings, 0), min(y + rings + 1, height.shape[1])):
            there = float(height[i, j])  # NaN, where it is unknown, compares false
            if found < there <= most:
                found = there
    return found


def voxel_pitch(points: Points) -> float:
    """Height of the voxels [m] whose centres points are, if that is more than what stops no body; else 0.

    Then all lie on rungs, and two surfaces that differ by less than a voxel are as high, or a whole voxel apart.
    """
    first = np.arange(0, len(points.there), max(1, points.count // _FIRST))
    pitch = _pitch(points.taken(first[points.there[first]])[:, 2])
    if pitch == 0.0:  # nearly always a first look tells
        return 0.0
    z = points.present[:, 2]
    return pitch if _on_rungs(z - z[0], pitch) else _pitch(z)


def _pitch(z: FloatArray) -> float:
    """The least difference of heights, if it would stop a body and all others are multiples of it, else 0 [m]."""
    between = np.diff(np.unique(np.round(z, 4)))
    pitch = float(between.min(initial=np.inf))
    return pitch if 2.0 * LEAST_OBSTACLE < pitch < np.inf and _on_rungs(between, pitch) else 0.0


def _on_rungs(heights: FloatArray, pitch: float) -> bool:
    off = heights / pitch
    return bool((np.abs(off - np.round(off)) <= _ROUNDED).all())


_FIRST = 1000
"""Heights that are looked at first."""
_ROUNDED = 0.01
"""[-] Of a voxel: what single precision and a turn make of its centre."""


def _disc(radius: float, surface: HeightMap) -> BoolArray:
    """Cells within `radius` [m] of the one in the middle, as wide as those of the surface."""
    cells = int(np.ceil(radius / surface.cell_width))
    x, y = np.mgrid[-cells : cells + 1, -cells : cells + 1] * surface.cell_width
    inside: BoolArray = np.hypot(x, y) <= radius
    return inside


def highest_within(heights: NDArray[np.floating], disc: BoolArray) -> NDArray[np.floating]:
    """The highest of `heights`, shape (nx, ny), in a `disc` round each cell: its rows, widened as they grow.

    The work is that of the disc's radius times the map, not of its area.
    """
    cells, widened, half = len(disc) // 2, heights.copy(), 0
    found = np.full_like(heights, -np.inf)
    for row in range(cells, -1, -1):
        width = np.count_nonzero(disc[cells + row])
        while half < width // 2:
            half += 1
            _lift(widened.T, heights.T, half)
        if width:
            _lift(found, widened, row)
    return found


def _lift(low: NDArray[np.floating], high: NDArray[np.floating], rows: int) -> None:
    """Lift `low` to what `high` is so many rows before and behind."""
    left = max(len(low) - rows, 0)
    np.maximum(low[rows:], high[:left], out=low[rows:])
    np.maximum(low[:left], high[rows:], out=low[:left])

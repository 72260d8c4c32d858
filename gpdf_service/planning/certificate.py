"""What is proven of a path over its whole continuous length, against the measured points themselves.

A cylinder goes straight from waypoint to waypoint: how far its way is from each point is told exactly. A disc that lies
o ahead of a body's centre moves by at most |ab| + |o| |Δθ| while the body goes from a to b and turns by Δθ, and the
distance to a fixed set of points is 1-Lipschitz: so it keeps at least (d(a) + d(b) − |ab| − |o| |Δθ|) / 2 of room.
Pieces that could hold the path's minimum are halved until it is known to `RESOLUTION`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gpdf_service.fields import NearerArrays, sample_at
from gpdf_service.fields.traversal import bracket_at
from gpdf_service.fields.tree import Scratch, make_scratch
from gpdf_service.ground.footing import ROUGH, crosses_flight
from gpdf_service.ground.limits import LEAST_STEP
from gpdf_service.kernel_cache import lean
from gpdf_service.planning.footprint import travel_headings
from gpdf_service.planning.shape import runs
from gpdf_service.planning.words import measure, place_words
from gpdf_service.search.free_space import FreeSpace
from gpdf_service.search.places import least_distance
from gpdf_service.search.ways import Fields, Here, fields_of, here
from gpdf_service.tiles.surface import INFERRED, OBSERVED, UNKNOWN, Cells, cell_of, count_in, is_known
from gpdf_service.types import BoolArray, Certificate, FloatArray, IntArray

RESOLUTION = 1e-3
"""[m] How closely the least clearance of a body of discs is known."""
FINEST = 1e-5
"""[m] The same of a path with so little room that a millimetre decides: of an end where the body just fits."""
SAMPLE = 0.01
"""[m] Ground and height are looked at this often, at least: a fifth of the finest cell."""
CELL_SHARE = 0.2
"""[-] The same of a cell that is wider than the finest one."""
HEIGHT_EVERY = 3
"""The height of the body's top is looked at in every third of these: that found the worst of 106 plans to 1 mm."""
UPRIGHT = 1e-9
"""[m] A top that is off its height by no more is not, but for rounding."""
HEIGHT_SHARE = 0.1
"""[-] The body's top may be off its height by this share, Uttsha et al. 2024, feasibility study."""


def certify(
    space: FreeSpace,
    positions: FloatArray,
    ground: FloatArray,
    level: IntArray,
    headings: FloatArray | None = None,
    hidden_height: float = 0.0,
) -> Certificate:
    """Certify a polyline of the body's top and its contact points, both (n, 3) [m], each on a level, (n,).

    It faces along the polyline where no headings are given, (n,) [rad]. Things of `hidden_height` may be in the scene
    that nobody can see [m]; on a flight what is no higher than a worn tread is rough counts as the tread.
    """
    headings = travel_headings(ground) if headings is None else headings
    agent, seen = space.agent, None
    for part, on in runs(level):
        body = agent.offsets, space.reach, agent.radius, agent.height
        more = prove(here(space, on), fields_of(space, on), ground[part], positions[part], headings[part], body)
        seen = more if seen is None else _both(seen, more)
    assert seen is not None
    return judge(space, ground, seen, hidden_height)


def judge(space: FreeSpace, ground: FloatArray, seen: Seen, hidden_height: float) -> Certificate:
    """Whether what was `seen` of a path is what its body may do; see `certify`."""
    agent, reason = space.agent, ""
    if seen.clearance < 0:
        short = f"{-1000 * seen.clearance:.0f} mm too little room at {place_words(seen.where)}"
        reason = f"the body would touch an obstacle: {short}"
    elif seen.unknown:
        reason = "the path leaves the known ground"
    elif seen.step > max(agent.max_step, LEAST_STEP):
        reason = f"a step of {measure(seen.step)} m is higher than the {agent.name} takes ({measure(agent.max_step)} m)"
    elif seen.slope > agent.max_slope:
        reason = f"a slope of {np.degrees(seen.slope):.0f}° is steeper than the {agent.name} stands on"
    if not reason and hidden_height < ROUGH < agent.max_step:
        crosses = any(crosses_flight(ground, one, agent.cylinder.radius) for one in space.surfaces)
        hidden_height = ROUGH if crosses else hidden_height
    where = seen.where, seen.deviation, seen.off_at
    return Certificate(
        seen.clearance, *where, seen.step, seen.slope, not reason, reason, hidden_height, ground_spacing=seen.spacing
    )


class Seen(NamedTuple):
    """Of a piece of the path on one level; what they are is said at `Certificate`."""

    clearance: float
    where: FloatArray
    unknown: bool
    deviation: float
    off_at: FloatArray
    step: float
    slope: float
    spacing: float


def _both(one: Seen, other: Seen) -> Seen:
    """What is proven of two pieces together."""
    near = other if other.clearance < one.clearance else one
    off = other if other.deviation > one.deviation else one
    step, slope, spacing = max(one.step, other.step), max(one.slope, other.slope), max(one.spacing, other.spacing)
    where = near.clearance, near.where, one.unknown or other.unknown, off.deviation, off.off_at
    return Seen(*where, step, slope, spacing)


@njit(cache=True, nogil=True)
def prove(
    here: Sequence[Here],
    fields: Sequence[Fields],
    path: FloatArray,
    tops: FloatArray,
    headings: FloatArray,
    body: tuple[FloatArray, float, float, float],
) -> Seen:
    """What is proven of a piece: its least distance, and its ground and its tops, looked at as `SAMPLE` says."""
    (offsets, reach, radius, height), (about, _, inferred), (_, field) = body, here[0], fields[0]
    obstacles, ground = about.places, about.ground
    poses, where, off_at, nearest = path.copy(), path[0].copy(), path[0].copy(), np.inf
    poses[:, 2] = headings
    least, at = least_distance(obstacles, poses, offsets, RESOLUTION)
    if least < reach <= least + RESOLUTION:
        least, at = least_distance(obstacles, poses, offsets, FINEST)
    for i in range(len(path)):
        far2 = (path[i, 0] - at[0]) ** 2 + (path[i, 1] - at[1]) ** 2
        if far2 < nearest:
            nearest, where[2] = far2, path[i, 2]
    where[:2] = at
    own = ground, about.steps, about.slopes, field, make_scratch(), np.empty(3), off_at
    unknown, deviation, step, slope = _look_along(path, tops, headings, offsets, height, *own)
    spacing = _coarsest_spacing(path, radius, ground, inferred)
    return Seen(least - reach, where, unknown, deviation, off_at, step, slope, spacing)


@lean()
def _look_along(
    path: FloatArray,
    tops: FloatArray,
    headings: FloatArray,
    offsets: FloatArray,
    height: float,
    ground: Cells,
    steps: FloatArray,
    slopes: FloatArray,
    field: NearerArrays,
    scratch: Scratch,
    along: FloatArray,
    off_at: FloatArray,
) -> tuple[bool, float, float, float]:
    """Whether ground is unknown, how far the top is off, steps and slopes; writes where the top is furthest off."""
    unknown, deviation, step, slope, upright, before = False, 0.0, 0.0, 0.0, True, (-2, -2)
    looks, last, spare = 0, len(path) - 2, 0.0
    for i in range(len(path)):  # a path that is anywhere off its height is so at a waypoint
        upright = upright and abs(tops[i, 2] - path[i, 2] - height) <= UPRIGHT
    sample = max(SAMPLE, CELL_SHARE * ground.width)
    every = max(int(HEIGHT_EVERY * SAMPLE / sample), 1)
    for i in range(len(path) - 1):
        dx, dy, dz = tops[i + 1, 0] - tops[i, 0], tops[i + 1, 1] - tops[i, 1], tops[i + 1, 2] - tops[i, 2]
        length = np.sqrt(dx * dx + dy * dy + dz * dz)
        count = max(1, int(np.ceil(length / sample))) if length < np.inf else 1  # NaN: over no known ground
        for k in range(count + (i == last)):
            share = k / count
            x = path[i, 0] + share * (path[i + 1, 0] - path[i, 0])
            y = path[i, 1] + share * (path[i + 1, 1] - path[i, 1])
            u, v = cell_of(ground, x, y)
            known = u >= 0 and ground.state[u, v] != UNKNOWN
            if (u, v) != before:
                before, unknown = (u, v), unknown or not known
                if known:
                    step, slope = max(step, steps[u, v]), max(slope, slopes[u, v])
            if upright:
                continue
            z = path[i, 2] + share * (path[i + 1, 2] - path[i, 2])
            top = tops[i, 0] + share * dx, tops[i, 1] + share * dy, tops[i, 2] + share * dz
            off = abs(top[2] - z - height)
            spare -= length / count  # a distance changes by no more than what the top has moved
            if (looks % every == 0 or (i == last and k == count)) and off > deviation and spare <= 0.0:
                if known:  # the ground's field is asked only where the path is as far off as it was found to be
                    low, high = bracket_at(field, top, scratch)
                    most = max(high - height, height - low)
                    if most > deviation:  # else it is nowhere between them as far off
                        most = abs(sample_at(field, top, scratch, along) - height)
                    off = min(off, most)
                    spare = deviation - off
                if off > deviation:
                    deviation, off_at[0], off_at[1], off_at[2] = off, x, y, z
            looks += 1
    for i in range(len(path)):
        for offset in offsets:
            x, y = path[i, 0] + offset * np.cos(headings[i]), path[i, 1] + offset * np.sin(headings[i])
            unknown = unknown or not is_known(ground, x, y)
    return unknown, deviation, step, slope


@njit(cache=True, nogil=True)
def _coarsest_spacing(path: FloatArray, radius: float, ground: Cells, inferred: NDArray[np.int32]) -> float:
    """Twice as far as ground within `radius` of a path is from where it was seen, to the width of a cell [m]."""
    (nx, ny), width = ground.state.shape, ground.width
    first, last, reach = np.zeros(2, np.int64), np.zeros(2, np.int64), int(radius / width)
    for k, cells in enumerate((nx, ny)):
        low, high = (path[:, k].min() - ground.origin[k]) / width, (path[:, k].max() - ground.origin[k]) / width
        if not high - low < np.inf:  # a place that is none is over no ground
            return np.inf
        first[k], last[k] = max(int(low) - reach, 0), min(int(high) + reach + 1, cells)
    if last[0] <= first[0] or last[1] <= first[1] or count_in(inferred, first[0], last[0], first[1], last[1]) == 0:
        return float(width)
    looked = np.zeros((last[0] - first[0], last[1] - first[1]), np.bool_)
    return (1.0 + 2.0 * _farthest_unseen(path, ground, inferred, reach, first, last, looked)) * width


@lean()
def _farthest_unseen(
    path: FloatArray,
    ground: Cells,
    inferred: NDArray[np.int32],
    reach: int,
    first: IntArray,
    last: IntArray,
    looked: BoolArray,
) -> float:
    """How far the furthest inferred cell within `reach` cells of a path is from a seen one [cells]; see above."""
    farthest, before, width = 0.0, (-1, -1), ground.width
    for i in range(len(path) - 1):
        dx, dy = path[i + 1, 0] - path[i, 0], path[i + 1, 1] - path[i, 1]
        count = max(1, int(np.ceil(2.0 * np.hypot(dx, dy) / width)))
        for k in range(count + 1):
            u, v = cell_of(ground, path[i, 0] + k / count * dx, path[i, 1] + k / count * dy)
            if (u, v) == before:
                continue
            before = u, v
            u0, u1 = max(u - reach, first[0]), min(u + reach + 1, last[0])
            v0, v1 = max(v - reach, first[1]), min(v + reach + 1, last[1])
            if u < 0 or count_in(inferred, u0, u1, v0, v1) == 0:
                continue
            for x in range(u0, u1):
                for y in range(v0, v1):
                    if looked[x - first[0], y - first[1]] or (x - u) ** 2 + (y - v) ** 2 > reach * reach:
                        continue
                    looked[x - first[0], y - first[1]] = True
                    if ground.state[x, y] == INFERRED:
                        farthest = max(farthest, _cells_to_seen(ground.state, x, y))
    return farthest


@lean()
def _cells_to_seen(state: NDArray[np.uint8], x: int, y: int) -> float:
    """Distance from a cell to the nearest in which ground was seen [cells]: ring by ring, until none can be nearer."""
    nearest, ring = np.inf, 1
    while ring * ring < nearest and ring < max(state.shape):
        for u in range(max(x - ring, 0), min(x + ring + 1, state.shape[0])):
            side = abs(u - x) == ring
            for v in range(max(y - ring, 0), min(y + ring + 1, state.shape[1])):
                if (side or abs(v - y) == ring) and state[u, v] == OBSERVED:
                    nearest = min(nearest, float((u - x) ** 2 + (v - y) ** 2))
        ring += 1
    return float(np.sqrt(nearest))

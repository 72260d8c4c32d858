"""What is proven of a path over its whole continuous length, against the measured points themselves.

The distance to a fixed set of points is 1-Lipschitz, so a segment ab keeps at least (d(a) + d(b) − |ab|) / 2 of room.
Pieces that could hold the path's minimum are halved until it is known to `RESOLUTION`. A disc that lies o ahead of the
body's centre moves by at most |ab| + |o| |Δθ| while the body goes from a to b and turns by Δθ: the same holds of it.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from gpdf_service.perception.limits import LEAST_STEP
from gpdf_service.planning.footprint import disc_places, travel_headings
from gpdf_service.search import FreeSpace
from gpdf_service.search.motion import least_distance
from gpdf_service.types import Certificate, FloatArray, IntArray

RESOLUTION = 1e-3
"""[m] How closely the least clearance is known."""
SAMPLE = 0.01
"""[m] Ground and height are looked at this often: a fifth of the finest cell."""
HEIGHT_EVERY = 3
"""The height of the body's top is looked at in every third of these: that found the worst of 106 plans to 1 mm."""
HEIGHT_SHARE = 0.1
"""[-] The body's top may be off its height by this share, Uttsha et al. 2024, feasibility study."""


def min_distance(
    space: FreeSpace, level: int, path: FloatArray, headings: FloatArray | None = None
) -> tuple[float, FloatArray]:
    """Lower bound of the distance from a path to the obstacles of a level [m], and where it is reached (2,) [m].

    Args:
        space: The body's free space.
        level: The level.
        path: A polyline in plan [m], shape (n, 2).
        headings: Where the body faces at its corners, turning evenly between them [rad], shape (n,): then the distance
            is that of the centres of all its discs; of the polyline alone where they are not given.
    """
    offsets = np.zeros(1) if headings is None else space.agent.offsets
    poses = np.column_stack([path, np.zeros(len(path)) if headings is None else headings])
    return least_distance(space.trees[level], poses, offsets, RESOLUTION)


def certify(
    space: FreeSpace,
    positions: FloatArray,
    ground: FloatArray,
    level: IntArray,
    headings: FloatArray | None = None,
) -> Certificate:
    """Certify a polyline of the body's top and its contact points.

    Args:
        space: The body's free space.
        positions: The body's top [m], shape (n, 3).
        ground: Contact points [m], shape (n, 3).
        level: Level of each contact point, shape (n,).
        headings: Where the body faces [rad], shape (n,); along the polyline where they are not given.
    """
    headings = travel_headings(ground) if headings is None else headings
    agent = space.agent
    clearance, where = np.inf, ground[0]
    deviation, off_at = 0.0, ground[0]
    step = slope = 0.0
    unknown = False
    for part, on in _runs(level):
        path = ground[part]
        least, at = min_distance(space, on, path[:, :2], headings[part])
        if least - space.reach < clearance:
            clearance = least - space.reach
            where = np.append(at, path[np.linalg.norm(path[:, :2] - at, axis=1).argmin(), 2])
        dense, tops = _resample(path, positions[part])
        surface = space.surfaces[on]
        poses = np.column_stack([path[:, :2], headings[part]])
        centres = [disc_places(poses, offset) for offset in agent.offsets]
        unknown |= not bool(surface.contains(np.vstack([dense[:, :2], *centres])).all())
        looked = np.unique(np.append(np.arange(0, len(tops), HEIGHT_EVERY), len(tops) - 1))
        sample = space.ground_fields[on].query(tops[looked])
        upright = np.abs(tops[looked, 2] - dense[looked, 2] - agent.height)
        off = np.minimum(upright, np.where(sample.valid, np.abs(sample.distance - agent.height), np.inf))
        if off.max() > deviation:
            deviation, off_at = float(off.max()), dense[looked[int(off.argmax())]]
        ix, iy, _ = surface.cells(dense)
        step, slope = max(step, float(space.steps[on][ix, iy].max())), max(slope, float(space.slopes[on][ix, iy].max()))
    reason = ""
    if clearance < 0:
        reason = f"the body would touch an obstacle: {-1000 * clearance:.0f} mm too little room at {_at(where)}"
    elif unknown:
        reason = "the path leaves the known ground"
    elif step > max(agent.max_step, LEAST_STEP):
        reason = f"a step of {step:.2f} m is higher than the {agent.name} takes ({agent.max_step:.2f} m)"
    elif slope > agent.max_slope:
        reason = f"a slope of {np.degrees(slope):.0f}° is steeper than the {agent.name} stands on"
    return Certificate(clearance, where, deviation, off_at, step, slope, holds=not reason, reason=reason)


def _runs(level: IntArray) -> list[tuple[slice, int]]:
    """Pieces of the path on one level; neighbouring pieces share the waypoint where they meet."""
    cuts = [0, *(np.flatnonzero(np.diff(level)) + 1).tolist(), len(level)]
    return [
        (slice(max(a - 1, 0), b), int(level[a]))
        if b - a + (a > 0) > 1
        else (slice(max(a - 1, 0), b + 1), int(level[a]))
        for a, b in pairwise(cuts)
    ]


def _resample(path: FloatArray, tops: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Contact points and tops at most `SAMPLE` apart."""
    length = np.nan_to_num(np.linalg.norm(np.diff(tops, axis=0), axis=1))  # NaN: over no known ground
    count = np.maximum(1, np.ceil(length / SAMPLE).astype(int))
    segment = np.repeat(np.arange(len(length)), count)
    t = (np.arange(len(segment)) - np.repeat(np.cumsum(count) - count, count)) / np.repeat(count, count)
    t = t[:, None]
    dense = [p[segment] * (1 - t) + p[segment + 1] * t for p in (path, tops)]
    return np.vstack([dense[0], path[-1:]]), np.vstack([dense[1], tops[-1:]])


def _at(place: FloatArray) -> str:
    return "(" + ", ".join(f"{value:.2f}" for value in place) + ")"

"""From a path in plan to the body's path: shortcuts, even waypoints, contact points, the body's top."""

from __future__ import annotations

import numpy as np
from numba import njit
from scipy.interpolate import make_interp_spline

from gpdf_service.fields import FieldArrays, Gpdf, Tree
from gpdf_service.fields.traversal import make_scratch, sample
from gpdf_service.perception import HeightMap
from gpdf_service.search import is_clear
from gpdf_service.types import FloatArray, IntArray

HEIGHT_SHARE = 0.1
"""[-] How far the top may be off the body height, Uttsha et al. 2024, feasibility study."""
_UPRIGHT_SHARE = 0.09
"""[-] The same over the contact point, less what the ground between its points is off: a hundredth of the height."""
_NEWTON_STEPS = 4
_STANDS = 1e-3
"""[m] A top this near to its height stands: a tenth of what the lowest body may be off."""


@njit(cache=True, nogil=True)
def shortcut(path: FloatArray, obstacles: Tree, radius: float) -> IntArray:
    """Rows of a path in plan, shape (n, 2), that a string pulled along it keeps: each leg is proven clear.

    Greedy with doubling: from each kept waypoint the furthest clear one that doubling and halving find.
    """
    kept = [0]
    here = 0
    last = path.shape[0] - 1
    while here < last:
        good, leap = here + 1, 2
        while here + leap <= last and is_clear(obstacles, path[here], path[here + leap], radius):
            good = here + leap
            leap *= 2
        bad = min(here + leap, last + 1)
        if good < last and is_clear(obstacles, path[here], path[last], radius):
            good, bad = last, last + 1
        while bad - good > 1:
            middle = (good + bad) // 2
            if is_clear(obstacles, path[here], path[middle], radius):
                good = middle
            else:
                bad = middle
        kept.append(good)
        here = good
    return np.array(kept)


@njit(cache=True, nogil=True)
def is_path_clear(path: FloatArray, obstacles: Tree, radius: float) -> bool:
    """Whether a whole polyline in plan, shape (n, 2), keeps `radius` from every obstacle."""
    for i in range(path.shape[0] - 1):  # noqa: SIM110 - compiled
        if not is_clear(obstacles, path[i], path[i + 1], radius):
            return False
    return True


def resample(path: FloatArray, spacing: float) -> FloatArray:
    """Waypoints evenly along a polyline, at most `spacing` apart, ends kept; at least 3 rows."""
    length = np.linalg.norm(np.diff(path, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(length)])
    count = max(3, int(np.ceil(along[-1] / spacing)) + 1)
    at = np.linspace(0.0, along[-1], count)
    return np.column_stack([np.interp(at, along, column) for column in path.T])


def subdivide(path: FloatArray, spacing: float) -> FloatArray:
    """The same polyline with its corners, and waypoints at most `spacing` apart."""
    step = np.diff(path, axis=0)
    count = np.maximum(1, np.ceil(np.linalg.norm(step, axis=1) / spacing).astype(np.int64))
    segment = np.repeat(np.arange(len(step)), count)
    share = (np.arange(len(segment)) - np.repeat(np.cumsum(count) - count, count)) / count[segment]
    return np.vstack([path[segment] + share[:, None] * step[segment], path[-1:]])


def spline(path: FloatArray, spacing: float) -> FloatArray:
    """Places about `spacing` apart on the C² curve (natural cubic spline) through the waypoints, ends kept."""
    if len(path) < 3:
        return path
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    at = np.linspace(0.0, along[-1], int(np.ceil(along[-1] / spacing)) + 1)
    curve: FloatArray = make_interp_spline(along, path, k=3, bc_type="natural")(at)
    curve[0], curve[-1] = path[0], path[-1]
    return curve


def stand_up(xy: FloatArray, surface: HeightMap, field: Gpdf, height: float) -> tuple[FloatArray, FloatArray]:
    """Contact points and the body's top over them, both (n, 3).

    The top is where d_g = h, as in the paper (Newton steps along z; on level ground one), but always within a tenth of
    the body height over the contact point: before a step that surface rises long before the ground does, and beside a
    flight or under a floor the nearest ground is another one. What lies beside counts less, what is overhead nothing.
    """
    floor = surface.height_at(xy)
    z = _top_over(xy, floor, field.arrays, height)
    return np.column_stack([xy, floor]), np.column_stack([xy, z])


@njit(cache=True, nogil=True)
def _top_over(xy: FloatArray, floor: FloatArray, field: FieldArrays, height: float) -> FloatArray:
    """Height of the body's top at each place; each starts from what the one before it was lifted by."""
    top = np.full(len(xy), np.nan)
    scratch, slope, least, most = make_scratch(), np.zeros(3), -_UPRIGHT_SHARE * height, _UPRIGHT_SHARE * height
    lift = 0.0
    for i in range(len(xy)):
        if np.isnan(floor[i]):
            continue
        for _ in range(_NEWTON_STEPS):
            distance = sample(field, (xy[i, 0], xy[i, 1], floor[i] + height + lift), scratch, slope)[0]
            off = (height - distance) * max(slope[2], 0.0)
            if abs(off) < _STANDS:
                break
            lift = min(max(lift + off, least), most)
        top[i] = floor[i] + height + lift
    return top

"""Time stamps: as fast as speed, acceleration, jerk and turning allow, from rest to rest, with care.

The largest v(s) under the limits with |dv²/ds| ≤ 2a, by one pass forward and one backward, is averaged over two windows
of time. An average of speeds keeps every bound of the speeds and accelerations in it; the first window bounds the jerk
by 2a/T₁, the second makes the speed C². The limits are taken as the least within reach of the windows, so they hold
where the body then is.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from scipy import ndimage

from gpdf_service.search import FreeSpace
from gpdf_service.types import Agent, FloatArray, IntArray

STANDING = 1e-3
"""[s] For a path whose start is its goal: nothing moves, but time stamps still increase."""
RAMP = 0.4
"""[s] First window: the jerk is at most 2 a / RAMP; a person takes a third of a second to start a step."""
BLEND = 0.2
"""[s] Second window: half of the first takes the corners off the acceleration."""
TICK = 0.005
"""[s] Grid of the windows: between its knots a body strays by 2 µm."""
GRID = 0.02
"""[m] Grid along the path: less than half of the distance between waypoints."""
LOOK = 0.1
"""[m] A heading is the mean direction over this on either side: half a foot's length, and the corner of a polyline."""
CARE = 0.5
"""[-] Share of the speed on stairs and steps, and where nothing is left of the preferred clearance."""
NOTICED_STEP = 0.03
"""[m] Lower steps do not slow anybody down: a sill of 2 cm is rolled over."""


def time_path(positions: FloatArray, agent: Agent, limit: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
    """Times [s] and headings [rad] of a polyline, shape (n, 3), n ≥ 2, without repeated points.

    Args:
        positions: The path [m].
        agent: Its speed v, acceleration a (along and across: v² κ ≤ a) and turn rate (v κ).
        limit: Highest speed at each waypoint [m/s], shape (n,); none but the agent's where it is not given.
    """
    step = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    if not step.any():
        return np.linspace(0.0, STANDING, len(positions)), np.zeros(len(positions))
    along = np.concatenate([[0.0], np.cumsum(step)])
    s = np.linspace(0.0, along[-1], max(64, int(np.ceil(along[-1] / GRID))) + 1)
    heading = _headings(positions, along, s)
    highest = np.full(len(s), agent.speed) if limit is None else _least_between(limit, along, s)
    curvature = np.abs(np.gradient(heading, s))
    with np.errstate(divide="ignore"):
        turning = np.minimum(np.sqrt(agent.acceleration / curvature), agent.turn_rate / curvature)
    highest = np.minimum(np.minimum(highest, turning), agent.speed)
    reach = int(np.ceil(agent.speed * (RAMP + BLEND) / s[1]))
    speed = _fastest(ndimage.minimum_filter1d(highest, 2 * reach + 1, mode="nearest"), s[1], agent.acceleration)
    return _smooth(s, speed, along), np.interp(along, s, heading)


def speed_limit(space: FreeSpace, ground: FloatArray, level: IntArray, preferred: float) -> FloatArray:
    """Highest speed at each contact point [m/s]: less on steps, and with less room than the `preferred` [m]."""
    agent = space.agent
    share = np.ones(len(ground))
    for on in np.unique(level):
        mine = level == on
        room = space.clearance(int(on), ground[mine, :2])[0] - space.reach
        near = np.clip(room / preferred, 0.0, 1.0)
        surface = space.surfaces[on]
        cells = 1 + 2 * int(np.ceil(agent.radius / surface.cell_width))
        ix, iy, _ = surface.cells(ground[mine])
        stepped = _around(space.steps[on], ix, iy, cells) > NOTICED_STEP
        share[mine] = np.where(stepped, CARE, CARE + (1.0 - CARE) * near)
    return agent.speed * share


def _around(values: FloatArray, ix: IntArray, iy: IntArray, cells: int) -> FloatArray:
    """Largest value in a square of `cells` around each cell, looked up in the part of the map that they lie in."""
    margin = cells // 2 + 1
    low = np.maximum([ix.min() - margin, iy.min() - margin], 0)
    part = values[low[0] : ix.max() + margin + 1, low[1] : iy.max() + margin + 1]
    largest: FloatArray = ndimage.maximum_filter(part, size=cells)[ix - low[0], iy - low[1]]
    return largest


def _headings(positions: FloatArray, along: FloatArray, s: FloatArray) -> FloatArray:
    """Direction of travel at s [rad], unwrapped: of each segment, averaged over `LOOK` on either side."""
    flat = np.diff(positions[:, :2], axis=0)
    direction = np.unwrap(np.arctan2(flat[:, 1], flat[:, 0]))
    segment = np.clip(np.searchsorted(along, s, side="right") - 1, 0, len(flat) - 1)
    window = 2 * int(np.ceil(LOOK / s[1])) + 1
    averaged: FloatArray = ndimage.uniform_filter1d(direction[segment], window, mode="nearest")
    return averaged


def _least_between(limit: FloatArray, along: FloatArray, s: FloatArray) -> FloatArray:
    """The smaller of the limits at the two waypoints around each s."""
    after = np.clip(np.searchsorted(along, s), 1, len(along) - 1)
    return np.minimum(limit[after - 1], limit[after])


@njit(cache=True, nogil=True)
def _fastest(highest: FloatArray, step: float, acceleration: float) -> FloatArray:
    """The largest v on an even grid with v ≤ highest, |dv²/ds| ≤ 2 acceleration, and v = 0 at both ends."""
    squared = highest**2
    squared[0] = squared[-1] = 0.0
    for i in range(1, len(squared)):
        squared[i] = min(squared[i], squared[i - 1] + 2.0 * acceleration * step)
    for i in range(len(squared) - 2, -1, -1):
        squared[i] = min(squared[i], squared[i + 1] + 2.0 * acceleration * step)
    return np.sqrt(squared)


def _smooth(s: FloatArray, speed: FloatArray, along: FloatArray) -> FloatArray:
    """Times at `along` of a body whose speed is v(t) averaged over the windows of `RAMP` and `BLEND`."""
    times = np.concatenate([[0.0], np.cumsum(2.0 * np.diff(s) / (speed[:-1] + speed[1:]))])
    widths = [round(RAMP / TICK), round(BLEND / TICK)]
    margin = sum(widths)  # at rest before and after
    t = TICK * (np.arange(int(np.ceil(times[-1] / TICK)) + 2 * margin + 1) - margin)
    i = np.clip(np.searchsorted(times, t, side="right") - 1, 0, len(s) - 2)
    spent = np.clip(t, 0.0, times[-1]) - times[i]
    gain = (speed[i + 1] - speed[i]) / (times[i + 1] - times[i])
    place = s[i] + spent * (speed[i] + 0.5 * gain * spent)
    for width in widths:  # the mean place over a window moves with the mean speed over it
        total = np.concatenate([[0.0], np.cumsum(place)])
        place = np.concatenate([(total[width:] - total[:-width]) / width, np.full(width - 1, place[-1])])
    moving = np.flatnonzero(np.diff(place) > 0.0)
    first, last = moving[0], moving[-1] + 2
    made: FloatArray = np.interp(along, place[first:last], t[first:last] - t[first])
    return made

"""Time stamps: as fast as speed, acceleration, jerk and turning allow, from rest to rest, with care.

The largest v(s) under the limits with |dv²/ds| ≤ 2a, by one pass forward and one backward, is averaged over two windows
of time. An average of speeds keeps every bound of the speeds and accelerations in it; the first window bounds the jerk
by 2a/T₁, the second makes the speed C². The limits are taken as the least within reach of the windows, so they hold
where the body then is.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit

from gpdf_service.fields.tree import Scratch, make_scratch
from gpdf_service.ground import ObstacleKind
from gpdf_service.kernel_cache import lean
from gpdf_service.planning.footprint import directions
from gpdf_service.planning.shape import SAME, lengths, runs
from gpdf_service.search.free_space import FreeSpace
from gpdf_service.search.places import nearest_of
from gpdf_service.search.ways import CARE, LENGTH, TIGHT, UNSEEN, Beside, Here, Prefer, here, is_stepped, least_takes
from gpdf_service.types import Agent, FloatArray, IntArray

STANDING = 1e-3
"""[s] For a path whose start is its goal: nothing moves, but time stamps still increase."""
RAMP = 0.4
"""[s] First window: the jerk is at most 2 a / RAMP; a person takes a third of a second to start a step."""
BLEND = 0.2
"""[s] Second window: half of the first takes the corners off the acceleration."""
STILL = 1e-6
"""[m] Who goes less stands: no sensor tells."""
TICK = 0.02
"""[s] Grid of the windows: between its knots a body strays by 30 µm."""
GRID = 0.02
"""[m] Grid along the path: less than half of the distance between waypoints."""
LOOK = 0.1
"""[m] A heading is the mean direction over this on either side: half a foot's length, and the corner of a polyline."""


def time_path(positions: FloatArray, agent: Agent, limit: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
    """Times [s] and headings [rad] of a polyline, shape (n, 3) [m], n ≥ 2, without repeated points.

    Limits are the body's acceleration a (along and across: v² κ ≤ a), turn rate (v κ) and speed v, or the highest at
    each waypoint, shape (n,) [m/s].
    """
    highest = np.full(len(positions), agent.speed) if limit is None else limit
    made: tuple[FloatArray, FloatArray] = time_along(
        positions, highest, agent.speed, agent.acceleration, agent.turn_rate
    )
    return made


@njit(cache=True, nogil=True)
def time_along(
    positions: FloatArray, limit: FloatArray, most: float, acceleration: float, turn_rate: float
) -> tuple[FloatArray, FloatArray]:
    """See `time_path`."""
    along, direction = lengths(positions), directions(positions)
    if along[-1] < STILL:
        return np.linspace(0.0, STANDING, len(positions)), np.zeros(len(positions))
    count = max(64, _steps(along[-1], GRID)) + 1
    s = np.linspace(0.0, along[-1], count)
    highest, ahead, after, segment = np.empty(count), np.empty(count), 1, 0
    for i in range(count):
        while after < len(along) - 1 and along[after] < s[i] - SAME:  # a place on a corner is before it
            after += 1
        while segment < len(direction) - 1 and along[segment + 1] < s[i] - SAME:
            segment += 1
        highest[i], ahead[i] = min(limit[after - 1], limit[after], most), direction[segment]
    heading = _mean_around(ahead, min(_steps(LOOK, s[1]), count))  # a short path has few places
    for i in range(count):
        before, next_ = max(i - 1, 0), min(i + 1, count - 1)
        curvature = abs(heading[next_] - heading[before]) / (s[next_] - s[before])
        if curvature > 0.0:
            highest[i] = min(highest[i], np.sqrt(acceleration / curvature), turn_rate / curvature)
    reach = _steps(most * (RAMP + BLEND), s[1])
    speed = _fastest(_least_around(highest, reach), s[1], acceleration)
    return _smooth(s, speed, along), np.interp(along, s, heading)


@lean()
def _steps(far: float, step: float) -> int:
    """How many steps reach so far: what does but for rounding does."""
    return int(np.ceil(far / step - SAME))


def speed_limit(
    space: FreeSpace,
    contact: FloatArray,
    headings: FloatArray,
    level: IntArray,
    preferred: float,
    prefer: Prefer = Prefer.COMPANION,
) -> tuple[FloatArray, FloatArray]:
    """Highest speed at each contact point, (n, 3) [m/s]: less on steps, and with less room than `preferred` [m].

    The disc in the tightest place tells. Also what the way takes, (6,): see `gpdf_service.search.ways`.
    """
    agent = space.agent
    share, takes = np.ones(len(contact)), np.zeros(6)
    for part, on in runs(level):
        body = agent.offsets, preferred, agent.radius
        walk(here(space, on, prefer), contact[part], headings[part], *body, share[part], takes)
    share *= agent.speed
    return share, takes


@njit(cache=True, nogil=True)
def walk(
    here: Sequence[Here],
    contact: FloatArray,
    headings: FloatArray,
    offsets: FloatArray,
    preferred: float,
    radius: float,
    share: FloatArray,
    takes: FloatArray,
) -> None:
    """Lower the `share` of the speed where one of the discs asks for care; add to what the way takes."""
    about, tight, unseen = here[0].about, np.zeros(len(contact)), np.zeros(len(contact))
    _take_care(about, contact, headings, offsets, preferred, radius, make_scratch(), (share, tight, unseen))
    ground = least_takes(contact, about)
    for i in range(len(ground)):
        for k in range(6):
            takes[k] += ground[i, k]
        takes[TIGHT] += ground[i, LENGTH] * 0.5 * (tight[i] + tight[i + 1])
        takes[UNSEEN] += ground[i, LENGTH] * 0.5 * (unseen[i] + unseen[i + 1])


@lean()
def _take_care(
    about: Beside,
    contact: FloatArray,
    headings: FloatArray,
    offsets: FloatArray,
    preferred: float,
    radius: float,
    scratch: Scratch,
    told: tuple[FloatArray, FloatArray, FloatArray],
) -> None:
    """See `walk`: writes the share of the speed, and how tight it is, and how tight beside what nobody has seen."""
    share, tight, unseen = told
    cells, enough = int(np.ceil(radius / about.ground.width)), max(preferred, about.minded)
    for offset in offsets:
        room, was_x, was_y, unknown = -np.inf, 0.0, 0.0, False  # there is at least so much, since that place
        for i in range(len(contact)):
            x, y = contact[i, 0] + offset * np.cos(headings[i]), contact[i, 1] + offset * np.sin(headings[i])
            room -= np.sqrt((x - was_x) ** 2 + (y - was_y) ** 2)
            was_x, was_y = x, y
            if is_stepped(about.ground, about.noticed, x, y, cells):
                share[i], tight[i] = CARE, 1.0
                continue
            if room < enough:
                distance, row = nearest_of(about.places, (x, y, 0.0), scratch)
                room = distance - about.reach
                unknown = row >= 0 and about.kind[row] == ObstacleKind.UNKNOWN
            share[i] = min(share[i], CARE + (1.0 - CARE) * min(max(room / preferred, 0.0), 1.0))
            less = min(max(1.0 - room / about.minded, 0.0), 1.0)
            tight[i], unseen[i] = max(tight[i], less), max(unseen[i], less if unknown else 0.0)


@njit(cache=True, nogil=True)
def _mean_around(values: FloatArray, reach: int) -> FloatArray:
    """Mean of the values up to `reach` places before and after each; the first and the last go on beyond the ends."""
    rows = np.arange(len(values) + 2 * reach + 1) - reach - 1
    total = np.cumsum(values[np.minimum(np.maximum(rows, 0), len(values) - 1)])
    mean: FloatArray = (total[2 * reach + 1 :] - total[: -2 * reach - 1]) / (2 * reach + 1)
    return mean


@njit(cache=True, nogil=True)
def _least_around(values: FloatArray, reach: int) -> FloatArray:
    """Least of the values up to `reach` places before and after each, in time by their number (Lemire 2006)."""
    made, row, first, last = np.empty(len(values)), np.empty(len(values), np.int64), 0, 0
    for i in range(len(values) + reach):
        if i < len(values):  # rows of values that rise, and may yet be the least
            while last > first and values[row[last - 1]] >= values[i]:
                last -= 1
            row[last], last = i, last + 1
        if i >= reach:
            while row[first] < i - 2 * reach:
                first += 1
            made[i - reach] = values[row[first]]
    return made


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


@njit(cache=True, nogil=True)
def _smooth(s: FloatArray, speed: FloatArray, along: FloatArray) -> FloatArray:
    """Times at `along` of a body whose speed is v(t) averaged over the windows of `RAMP` and `BLEND`."""
    times, i = np.zeros(len(s)), 0
    for k in range(1, len(s)):
        times[k] = times[k - 1] + 2.0 * (s[k] - s[k - 1]) / (speed[k - 1] + speed[k])
    ramp, blend = round(RAMP / TICK), round(BLEND / TICK)
    margin, end = ramp + blend, times[-1]  # at rest before and after
    place = np.zeros(int(np.ceil(end / TICK)) + 2 * margin + 1)
    t = np.empty(len(place))
    for k in range(len(t)):
        t[k] = TICK * (k - margin)
        while i < len(s) - 2 and times[i + 1] <= t[k]:
            i += 1
        spent = min(max(t[k], 0.0), end) - times[i]
        gain = (speed[i + 1] - speed[i]) / (times[i + 1] - times[i])
        place[k] = s[i] + spent * (speed[i] + 0.5 * gain * spent)
    for width in (ramp, blend):  # the mean place over a window moves with the mean speed over it
        total = np.zeros(len(place) + 1)
        for k in range(len(place)):
            total[k + 1] = total[k] + place[k]
        for k in range(len(place)):
            place[k] = (total[k + width] - total[k]) / width if k + width <= len(place) else place[k - 1]
    # It stirs when the windows' last knot is at 0, and rests once their first one is at the end: what the sums say of
    # that is rounding, and a knot beside the end would be no time apart.
    first, last = margin - (ramp - 1) - (blend - 1), margin + max(int(np.ceil(end / TICK - 0.5)), 0)
    while last > first + 1 and place[last - 1] >= s[-1]:
        last -= 1
    t[last], place[last] = end, s[-1]
    made, i = np.empty(len(along)), first
    for k in range(len(along)):
        while i < last - 1 and place[i + 1] < along[k]:
            i += 1
        share = min(max((along[k] - place[i]) / (place[i + 1] - place[i]), 0.0), 1.0)
        made[k] = t[i] - t[first] + share * (t[i + 1] - t[i])
    return made

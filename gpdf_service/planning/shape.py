"""From a path in plan to the body's path: shortcuts, even waypoints, contact points, the body's top."""

from __future__ import annotations

from itertools import pairwise
from math import sqrt

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gpdf_service.fields import NearerArrays
from gpdf_service.fields.tree import Scratch, make_scratch
from gpdf_service.kernel_cache import lean
from gpdf_service.planning.costs import Memo, make_memo, recall
from gpdf_service.search.core import NARROW
from gpdf_service.search.places import RESOLUTION, Places, distance_at, is_leap_clear, is_straight_clear
from gpdf_service.tiles.surface import UNKNOWN, Cells, cell_of, height_of, rise_around
from gpdf_service.types import FloatArray, IntArray

_UPRIGHT_SHARE = 0.09
"""[-] How far the top may be off the body height over the contact point: a tenth (Uttsha et al. 2024, feasibility
study), less what the ground between its points is off, a hundredth."""
_NEWTON_STEPS = 4
SAME = 1e-9
"""[m] Places nearer together are one."""
_STRAIGHT = 1e-9
"""[-] Places at a smaller angle are on one line, but for rounding."""
_STANDS = 1e-2
"""[-] A top this near to its height stands, as a share of it: a tenth of what a body may be off."""


@njit(cache=True, nogil=True)
def shortcut(path: FloatArray, obstacles: Places, radius: float, offsets: FloatArray, ground: Cells) -> IntArray:
    """Rows of a way over places (n, 2), or over poses (n, 3) of a body of discs, that a string pulled along it keeps.

    Each leg is proven clear of obstacles by `radius` [m], and lies on known ground: the path may lead around a hole.
    A leg between poses is a turn on the spot, a straight piece, and a turn.

    Greedy with doubling: from each kept row the furthest that doubling and halving find to be joined. They begin beyond
    the rows that lie straight ahead, which are joined as they are, and with half of the last leap.
    """
    kept = [0]
    here = first = 0
    last, straight, scratch = path.shape[0] - 1, _straight_to(path), make_scratch()
    seen = obstacles, radius, offsets, ground, scratch
    while here < last:
        ahead, leap = straight[here], max(1, first // 2)
        good = ahead
        while ahead + leap <= last and _is_joined(path[here], path[ahead + leap], *seen):
            good = ahead + leap
            leap *= 2
        bad = min(ahead + leap, last + 1)
        if good < last and _is_joined(path[here], path[last], *seen):
            good, bad = last, last + 1
        while bad - good > 1:
            middle = (good + bad) // 2
            if _is_joined(path[here], path[middle], *seen):
                good = middle
            else:
                bad = middle
        kept.append(good)
        here, first = good, good - ahead
    return np.array(kept)


@njit(cache=True, nogil=True)
def _straight_to(path: FloatArray) -> IntArray:
    """For each row the last one to which a way over places, (n, 2), goes straight on; the next one of poses, (n, 3)."""
    straight = np.minimum(np.arange(len(path)) + 1, len(path) - 1)
    for i in range(len(path) - 3, -1, -1):
        a, b = path[i + 1, 0] - path[i, 0], path[i + 1, 1] - path[i, 1]
        c, d = path[i + 2, 0] - path[i + 1, 0], path[i + 2, 1] - path[i + 1, 1]
        off, along = a * d - b * c, a * c + b * d
        if path.shape[1] == 2 and along > 0.0 and abs(off) <= _STRAIGHT * along:
            straight[i] = straight[i + 1]
    return straight


@njit(cache=True, nogil=True)
def tighten(path: FloatArray, obstacles: Places, radius: float, ground: Cells) -> IntArray:
    """Rows of a way over places (n, 2) that a string pulled tight along it keeps.

    Unlike `shortcut`, it stays between what it went between: from each kept row all rows up to the next one are seen.
    """
    kept, last, scratch = [0], len(path) - 1, make_scratch()
    while kept[-1] < last:
        here = kept[-1]
        seen = here + 1
        while seen < last and is_straight(path[here], path[seen + 1], obstacles, radius, ground, scratch):
            seen += 1
        kept.append(seen)
    return np.array(kept)


@njit(cache=True, nogil=True)
def pull(path: FloatArray, obstacles: Places, radius: float, ground: Cells) -> FloatArray:
    """A way over places (n, 2) pulled straight, and once more from its other end: from either first corners are wide.

    It keeps a `radius` [m] from the obstacles.
    """
    centre = np.zeros(1)  # of a cylinder
    rows = shortcut(path, obstacles, radius, centre, ground)
    if len(rows) == 2:  # straight, seen from either end
        return path[rows]
    back = np.ascontiguousarray(subdivide(path[rows], NARROW)[::-1])
    return np.ascontiguousarray(back[shortcut(back, obstacles, radius, centre, ground)][::-1])


@njit(cache=True, nogil=True)
def radius_of(path: FloatArray, obstacles: Places, reach: float, radius: float) -> float:
    """The search's `radius` [m]; where an end of a way (n, 2) lies closer than the margin, the body's own `reach`."""
    room, scratch = np.inf, make_scratch()
    for end in (0, len(path) - 1):
        room = min(room, distance_at(obstacles, (path[end, 0], path[end, 1], 0.0), scratch))
    return float(radius_within(room, reach, radius))


@lean()
def radius_within(room: float, reach: float, radius: float) -> float:
    """`radius_of` a way that has so much `room` at its ends [m]: with all of it, one could only go straight away."""
    return min(radius, max(reach, room - RESOLUTION))


@njit(cache=True, nogil=True)
def _is_joined(
    a: FloatArray,
    b: FloatArray,
    obstacles: Places,
    radius: float,
    offsets: FloatArray,
    ground: Cells,
    scratch: Scratch,
) -> bool:
    """Whether the leg from a to b is clear and on known ground."""
    if len(a) == 2:
        return is_straight(a, b, obstacles, radius, ground, scratch)
    return is_ground_known(ground, a, b) and is_leap_clear(obstacles, a, b, offsets, radius)


@lean()
def is_straight(
    a: FloatArray, b: FloatArray, obstacles: Places, radius: float, ground: Cells, scratch: Scratch
) -> bool:
    """Whether the straight way between places in plan is clear and on known ground."""
    return is_ground_known(ground, a, b) and is_straight_clear(obstacles, a, b, radius, scratch)


@lean()
def is_ground_known(ground: Cells, a: FloatArray, b: FloatArray) -> bool:
    """Whether the ground is known in each cell that the line from a to b crosses (Amanatides & Woo 1987)."""
    u, v = cell_of(ground, a[0], a[1])
    last_u, last_v = cell_of(ground, b[0], b[1])
    if u < 0 or last_u < 0 or ground.state[u, v] == UNKNOWN:
        return False
    dx, dy = (b[0] - a[0]) / ground.width, (b[1] - a[1]) / ground.width
    x, y = (a[0] - ground.origin[0]) / ground.width - u, (a[1] - ground.origin[1]) / ground.width - v
    right, up = 1 if dx > 0.0 else -1, 1 if dy > 0.0 else -1
    across_x = ((1.0 - x if dx > 0.0 else x) / abs(dx)) if dx != 0.0 else np.inf  # share of the leg to the next column
    across_y = ((1.0 - y if dy > 0.0 else y) / abs(dy)) if dy != 0.0 else np.inf
    for _ in range(abs(last_u - u) + abs(last_v - v)):
        if v == last_v or (u != last_u and across_x <= across_y):
            u, across_x = u + right, across_x + 1.0 / abs(dx)
        else:
            v, across_y = v + up, across_y + 1.0 / abs(dy)
        if ground.state[u, v] == UNKNOWN:
            return False
    return True


@njit(cache=True, nogil=True)
def is_path_clear(path: FloatArray, obstacles: Places, radius: float) -> bool:
    """Whether a whole polyline in plan, shape (n, 2), keeps `radius` from every obstacle."""
    scratch = make_scratch()
    for i in range(path.shape[0] - 1):  # noqa: SIM110 - compiled
        if not is_straight_clear(obstacles, path[i], path[i + 1], radius, scratch):
            return False
    return True


@njit(cache=True, nogil=True)
def resample(path: FloatArray, spacing: float) -> FloatArray:
    """Waypoints evenly along a polyline, shape (n, dim), at most `spacing` apart, ends kept; at least 3 rows."""
    along = lengths(path)
    at = np.linspace(0.0, along[-1], max(3, int(np.ceil(along[-1] / spacing)) + 1))
    places = np.empty((len(at), path.shape[1]))
    for k in range(path.shape[1]):
        places[:, k] = np.interp(at, along, path[:, k])
    return places


@njit(cache=True, nogil=True)
def waypoints(path: FloatArray, spacing: float, ground: Cells, height: float) -> FloatArray:
    """Waypoints of the body's top over a polyline in plan, (n, ≥ 2); none where nothing moves or ground is unknown."""
    seed, moves = resample(np.ascontiguousarray(path[:, :2]), spacing), False
    made = np.empty((len(seed), 3))
    for i in range(len(path)):
        moves |= abs(path[i, 0] - path[0, 0]) > SAME or abs(path[i, 1] - path[0, 1]) > SAME
    for i in range(len(seed)):
        made[i, 0], made[i, 1], made[i, 2] = seed[i, 0], seed[i, 1], height_of(ground, seed[i, 0], seed[i, 1]) + height
        moves &= np.isfinite(made[i, 2])
    return made if moves else made[:0]


@njit(cache=True, nogil=True)
def lengths(path: FloatArray) -> FloatArray:
    """Length of a polyline, shape (n, dim), up to each corner."""
    along = np.zeros(len(path))
    for i in range(1, len(path)):
        along[i] = along[i - 1] + _apart(path, i - 1)
    return along


@lean()
def _apart(path: FloatArray, i: int) -> float:
    """Distance from a place of a path, shape (n, dim), to the next one: without the arrays that NumPy's words make."""
    square = 0.0
    for k in range(path.shape[1]):
        square += (path[i + 1, k] - path[i, k]) ** 2
    return sqrt(square)


def runs(level: IntArray) -> list[tuple[slice, int]]:
    """Pieces of a path on one level, by the level of each place, (n,); neighbouring pieces share where they meet."""
    cuts = [0, *(np.flatnonzero(level[1:] != level[:-1]) + 1).tolist(), len(level)]
    return [(slice(max(a - 1, 0), max(b, 2)), int(level[a])) for a, b in pairwise(cuts)]


@njit(cache=True, nogil=True)
def subdivide(path: FloatArray, spacing: float) -> FloatArray:
    """The same polyline with its corners, and waypoints at most `spacing` apart."""
    count = np.empty(len(path) - 1, np.int64)
    for i in range(len(count)):
        count[i] = max(1, int(np.ceil(_apart(path, i) / spacing)))
    made, row = np.empty((count.sum() + 1, path.shape[1])), 0
    for i in range(len(count)):
        for k in range(count[i]):
            for m in range(path.shape[1]):
                made[row, m] = path[i, m] + k / count[i] * (path[i + 1, m] - path[i, m])
            row += 1
    made[row] = path[-1]
    return made


@njit(cache=True, nogil=True)
def distinct(path: FloatArray) -> FloatArray:
    """Without places that repeat the one before; two rows at least, the ends kept."""
    keep = np.ones(len(path), np.bool_)
    for i in range(1, len(path)):
        keep[i] = _apart(path, i - 1) > SAME
    keep[-1] |= keep.sum() == 1
    return path[keep]


@njit(cache=True, nogil=True)
def spline(path: FloatArray, spacing: float) -> FloatArray:
    """Places about `spacing` apart on the C² curve (natural cubic spline) through waypoints, shape (n, 2), ends kept.

    In Python SciPy's takes longer than all of CHOMP where it begins from the path before.
    """
    n = len(path)
    if n < 3:
        return path
    along = lengths(path)
    h = np.diff(along)
    bend, ratio = np.zeros((n, 2)), np.zeros(n)  # second derivatives, by Thomas' algorithm
    for i in range(1, n - 1):
        pivot = 2.0 * (h[i - 1] + h[i]) - h[i - 1] * ratio[i - 1]
        ratio[i] = h[i] / pivot
        for m in range(2):
            turn = 6.0 * ((path[i + 1, m] - path[i, m]) / h[i] - (path[i, m] - path[i - 1, m]) / h[i - 1])
            bend[i, m] = (turn - h[i - 1] * bend[i - 1, m]) / pivot
    for i in range(n - 2, 0, -1):
        for m in range(2):
            bend[i, m] -= ratio[i] * bend[i + 1, m]
    at = np.linspace(0.0, along[-1], int(np.ceil(along[-1] / spacing)) + 1)
    curve, i = np.empty((len(at), 2)), 0
    for k in range(len(at)):
        while i < n - 2 and along[i + 1] < at[k]:
            i += 1
        b = (at[k] - along[i]) / h[i]
        a = 1.0 - b
        p, q = (a * a * a - a) * h[i] * h[i] / 6.0, (b * b * b - b) * h[i] * h[i] / 6.0
        for m in range(2):
            curve[k, m] = a * path[i, m] + b * path[i + 1, m] + p * bend[i, m] + q * bend[i + 1, m]
    curve[0], curve[-1] = path[0], path[-1]
    return curve


@njit(cache=True, nogil=True)
def stand_on(
    xy: FloatArray, ground: Cells, ends: NDArray[np.float32], field: NearerArrays, height: float
) -> tuple[FloatArray, FloatArray]:
    """Contact points and the body's top over them, both (n, 3).

    The top is where d_g = h, as in the paper (Newton steps along z; on level ground one), but within a tenth of the
    body height over the contact point: before a step that surface rises long before the ground does, and beside a
    flight or under a floor the nearest ground is another one. What lies beside counts less, what is overhead nothing.
    Only where the path takes a step that is higher than both tenths does the top rise before it as that surface does:
    no other way over it keeps the body's height from the ground all along.
    """
    contact, top = np.empty((len(xy), 3)), np.empty((len(xy), 3))
    if is_level(xy, ground, ends, height):
        for i in range(len(xy)):
            x, y = xy[i, 0], xy[i, 1]
            floor = height_of(ground, x, y)
            contact[i, 0], contact[i, 1], contact[i, 2] = x, y, floor
            top[i, 0], top[i, 1], top[i, 2] = x, y, floor + height
        return contact, top
    _lift_all(xy, ground, field, height, make_memo(1), contact, top)
    return contact, top


@lean()
def is_level(path: FloatArray, ground: Cells, ends: NDArray[np.float32], height: float) -> bool:
    """Whether all ground that can be as near to a body's top as its own, along a path, stands for being level.

    Ground that is r away and z over the contact point is nearer to the top if r² < z (2h − z), so none is that is
    further away than h, or than what the highest of these says.
    """
    rise = rise_around(path, height, ground, ends)
    if _STANDS * height < rise < height:
        rise = rise_around(path, sqrt(rise * (2.0 * height - rise)), ground, ends)
    return rise <= _STANDS * height


@lean()
def _lift_all(
    xy: FloatArray, ground: Cells, field: NearerArrays, height: float, memo: Memo, contact: FloatArray, top: FloatArray
) -> None:
    """Write contact points and tops; each top starts from what the one before it was lifted by."""
    least, most, stands = -_UPRIGHT_SHARE * height, _UPRIGHT_SHARE * height, _STANDS * height
    lift = 0.0
    for i in range(len(xy)):
        x, y = xy[i, 0], xy[i, 1]
        floor = height_of(ground, x, y)
        contact[i, 0], contact[i, 1], contact[i, 2] = x, y, floor
        for _ in range(0 if np.isnan(floor) else _NEWTON_STEPS):
            top[i, 0], top[i, 1], top[i, 2] = x, y, floor + height + lift
            off = (height - recall(field, (top[i, 0], top[i, 1], top[i, 2]), memo, 0, np.inf, stands)) * max(
                memo.slope[0, 2], 0.0
            )
            if abs(off) < stands:
                break
            was, lift = lift, min(max(lift + off, least), most)
            if lift == was:
                break
        top[i, 0], top[i, 1], top[i, 2] = x, y, floor + height + lift
    for i in range(1, len(xy)):
        rise = contact[i, 2] - contact[i - 1, 2]
        if abs(rise) > most - least:
            _lift(contact, top, i - 1 if rise > 0.0 else i, -1 if rise > 0.0 else 1, abs(rise), field, height, memo)


@lean()
def _lift(
    contact: FloatArray,
    top: FloatArray,
    foot: int,
    away: int,
    rise: float,
    field: NearerArrays,
    height: float,
    memo: Memo,
) -> None:
    """Lift the tops from the foot of a step `away` from it to where d_g = h, as far as that is over them."""
    highest, i, stands = contact[foot, 2] + rise + height, foot, _STANDS * height
    memo.place[0, 0], z = np.nan, highest  # nothing is known here yet
    while 0 <= i < len(top):
        for _ in range(_NEWTON_STEPS):
            off = (height - recall(field, (top[i, 0], top[i, 1], z), memo, 0, np.inf, stands)) / max(
                memo.slope[0, 2], 0.5
            )
            z = min(z + off, highest)
            if abs(off) < stands:
                break
        if not z > top[i, 2] + stands:
            break
        top[i, 2] = z
        i += away

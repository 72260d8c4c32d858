"""Points whose own plane is hardly known, where the surfaces beside explain all that was measured there.

Points of a surface seen with the error σ lie about it as N(s, σ²) does. So at a place x its points s make Σ N(x; s, σ²)
expect so many measurements, and no more are due to it. Where no more were made there is nothing else, and a point goes
to where it is expected to come from, Σ N(x; s, σ²) s / Σ N(x; s, σ²). Where there were more, something else stands.
What is thinner than the noise shows no surface. It is told last: its own points are drawn to it.
"""

from __future__ import annotations

from functools import partial
from math import exp, pi, sqrt
from typing import NamedTuple

import numpy as np
from numba import njit

from gpdf_service.denoise.cells import Cells, begin_sweep, count_in, runs_within, sort_into_cells
from gpdf_service.denoise.cloud import HIDDEN, RESOLVED, Denoised
from gpdf_service.fields.shapes import FEWEST
from gpdf_service.fields.threads import run_chunked
from gpdf_service.fields.traversal import decay
from gpdf_service.fields.tree import VECTORS, lesser
from gpdf_service.kernel_cache import lean
from gpdf_service.types import BoolArray, FloatArray, IntArray

_AROUND = 4.0
"""[-] Standard deviations off a point that its surface is looked for at least."""
_STEEPEST = 0.5 * 5.0**2
"""[-] r² / 2 σ² of a point r off its surface: one in 1.7 million is further than five standard deviations."""
_CHANCE = 3.0
"""[-] Standard errors by which what was measured at a place may exceed what is expected there."""
_SEEN = FEWEST * 2.0 * pi / (3.0 * RESOLVED) ** 2
"""Sum of exp(−r² / 2 σ²) over a plane's points, on it, at least: of the fewest in a window that show one."""
_TOLD = sqrt(_SEEN / (2.0 * pi))
"""[-] Noise over spacing below which a plane shows that sum nowhere, as 2 π σ² of it hold the points."""
_CORNER = 0.25 * _SEEN
"""The same sum at a corner of such a surface."""
_SINGLE, _SQUARE, _CUBE = 2.0**-1.5, 3.0**-1.5, 4.0**-1.5
"""[-] What exp(−r² / 2 σ²), its square and its cube are in the mean where N(0, σ²) puts r."""


def return_explained(
    points: FloatArray, part: BoolArray, shown: BoolArray, cured: Denoised, spacing: float, apart: float = 0.0
) -> None:
    """Put the doubtful points of a `part` onto the surfaces that others show; not where more was measured than is due.

    Doubtful is what is vague, or on a plane that few points show, for such a plane follows them; and what was put onto
    a surface where that shows hardly any other point: beyond its end.

    Args:
        points: The cloud as it was measured [m], shape (n, 3).
        part: Whose points are looked at, shape (n,).
        shown: Whose points, and those of the part, show surfaces, shape (n,).
        cured: What was made of the cloud; its places are changed.
        spacing: Of the cloud [m]; where the noise is far less no surface explains anything.
        apart: Standard deviations off a surface of the `part`: nearer it stays, if it was measured and is there [-].
    """
    rows = np.flatnonzero((part | shown) & ~cured.stray)
    if len(rows) == 0 or cured.measured <= _TOLD * spacing:
        return
    sigma, measured, places = cured.local[rows], points.take(rows, 0), cured.points.take(rows, 0)
    vague = cured.vague[rows] | (cured.noise[rows] > HIDDEN * sigma)
    near, alone = sort_into_cells(places, RESOLVED * cured.measured), vague.copy()
    run_chunked(partial(_alone_range, near, vague, sigma, alone), len(near.key))
    rings = 1 if cured.measured < spacing else 2  # narrower cells would hold hardly a point each
    cells = sort_into_cells(measured, _AROUND * cured.measured / rings)
    rows, doubtful, sigma = rows[cells.order], alone[cells.order], sigma[cells.order]  # all in this order from here on
    places, around = places.take(cells.order, 0), np.empty((len(rows), 4))
    for thin in (False, True):
        moved, told = np.zeros(len(rows), dtype=bool), places - cells.corner
        if thin:
            told[doubtful] = around[doubtful, 1:]
        asked = _Asked(cells, rings, doubtful, part[rows], sigma, apart, told, around, thin)
        run_chunked(partial(_explain_range, asked, places, moved), len(cells.key))
        doubtful &= ~moved
    cured.points[rows] = places


@njit(cache=True, nogil=True)
def _alone_range(told: Cells, vague: BoolArray, sigma: FloatArray, alone: BoolArray, begin: int, end: int) -> None:
    """Add which points have less around than a corner of a surface shows, of the least that shows one."""
    runs, at = np.empty((10, 2), np.int64), begin_sweep(told, told.key[begin])
    for c in range(begin, end):
        runs[9, 0], runs[9, 1], count = told.begin[c], told.begin[c + 1], 0
        for i in range(told.begin[c], told.begin[c + 1]):
            if alone[told.order[i]]:
                continue
            seen = _shown_in(told, runs[9:], vague, i, sigma)
            if seen < _CORNER:
                if count == 0:
                    count = runs_within(told, told.key[c], 1, at, runs[:9])
                seen = _shown_in(told, runs[:count], vague, i, sigma)
            alone[told.order[i]] = seen < _CORNER


@lean()
def _shown_in(told: Cells, runs: IntArray, vague: BoolArray, i: int, sigma: FloatArray) -> float:
    """Sum of exp(−r² / 2 σ²) over the points of some runs that are not vague, until it is `_CORNER`."""
    (x, y, z), scale, seen = told.places[i], -0.5 / sigma[told.order[i]] ** 2, 0.0
    for run in runs:
        for k in range(run[0], run[1]):
            if k != i and not vague[told.order[k]]:
                p = told.places[k]
                seen += exp(scale * ((p[0] - x) ** 2 + (p[1] - y) ** 2 + (p[2] - z) ** 2))
                if seen >= _CORNER:
                    return seen
    return seen


class _Asked(NamedTuple):
    """Which points are asked about, `doubtful` and of their `own` part, in the order of `cells`, and `rings` around.

    Each has a noise `sigma` [m], is `told` to be somewhere from the cells' corner [m], (n, 3), and has `around` it what
    was measured, with its mean, (n, 4). In the `thin` round all points show where something is, else the sure ones.
    """

    cells: Cells
    rings: int
    doubtful: BoolArray
    own: BoolArray
    sigma: FloatArray
    apart: float
    told: FloatArray
    around: FloatArray
    thin: bool


class _Room(NamedTuple):
    """The points about a cell: where they are told to be, from the cells' corner [m], and which they are, (k,) each."""

    x: FloatArray
    y: FloatArray
    z: FloatArray
    rows: IntArray


@njit(cache=True, nogil=True)
def _make_room(count: int) -> _Room:
    return _Room(np.empty(count), np.empty(count), np.empty(count), np.empty(count, np.int64))


@njit(cache=True, nogil=True)
def _look(places: FloatArray, hidden: BoolArray, runs: IntArray, room: _Room) -> _Room:
    """Write those of the `places`, (n, 3), in the runs that are not hidden into the room; the part that they take."""
    found = 0
    for run in runs:
        for i in range(run[0], run[1]):
            room.x[found], room.y[found], room.z[found] = places[i, 0], places[i, 1], places[i, 2]
            room.rows[found] = i
            found += not hidden[i]
    return _Room(room.x[:found], room.y[:found], room.z[:found], room.rows[:found])


@lean(fastmath=VECTORS)
def _measure(shown: _Room, x: FloatArray, rate: float, around: FloatArray) -> None:
    """Write Σ exp(−r² / 2 σ²) over what is shown, without x itself, and their mean, shape (4,)."""
    x0, x1, x2 = x[0], x[1], x[2]
    total, m0, m1, m2 = 0.0, 0.0, 0.0, 0.0
    for k in range(len(shown.x)):
        a, b, c = shown.x[k] - x0, shown.y[k] - x1, shown.z[k] - x2
        t = (a * a + b * b + c * c) * rate
        third = decay(lesser(t, _STEEPEST) / 12.0) ** 4
        weight = third**3 if t <= _STEEPEST else 0.0
        total += weight
        m0 += weight * a
        m1 += weight * b
        m2 += weight * c
    around[0] = total - 1.0
    around[1], around[2], around[3] = x0 + m0 / total, x1 + m1 / total, x2 + m2 / total


@njit(cache=True, nogil=True)
def _explain_range(asked: _Asked, places: FloatArray, moved: BoolArray, begin: int, end: int) -> None:
    """Move what is explained; before, write how much was measured around each doubtful point, and its mean.

    For a density p of what was measured the source of a point is expected at x + σ² ∇ log p (Tweedie, 1956; Efron,
    2011). With p smoothed by σ itself, that is this mean: half-way to what is thinner than the noise.
    """
    (cells, _, doubtful), none, room, mean = asked[:3], np.zeros_like(asked.doubtful), _make_room(0), np.empty(3)
    at = begin_sweep(cells, cells.key[begin], asked.rings)
    runs = np.empty((at.shape[1], 2), np.int64)
    for c in range(begin, end):
        first, last = cells.begin[c], cells.begin[c + 1]
        if not doubtful[first:last].any():
            continue
        around = runs[: runs_within(cells, cells.key[c], asked.rings, at, runs)]
        count = count_in(around)
        room = room if count <= len(room.rows) else _make_room(2 * count)
        if not asked.thin:
            measured = _look(cells.places, none, around, room)
            for i in range(first, last):
                if doubtful[i]:
                    _measure(measured, cells.places[i], 0.5 / asked.sigma[i] ** 2, asked.around[i])
        shown = _look(asked.told, none if asked.thin else doubtful, around, room)
        for i in range(first, last):
            if doubtful[i] and asked.own[i] and _is_explained(asked, shown, i, mean):
                moved[i] = True
                for k in range(3):
                    places[i, k] = mean[k] + cells.corner[k]


@lean(fastmath=VECTORS)
def _is_explained(asked: _Asked, shown: _Room, i: int, mean: FloatArray) -> bool:
    """Whether the surfaces explain what is at place i; writes where on them it is expected to be from."""
    x0, x1, x2 = asked.cells.places[i]
    rate = 0.5 / asked.sigma[i] ** 2
    if asked.apart > 0.0 and _stays(asked, shown, i):
        return False
    expected, variance, skew, total, least = 0.0, 0.0, 0.0, 0.0, np.inf
    m0, m1, m2 = 0.0, 0.0, 0.0
    for k in range(len(shown.rows)):
        a, b, c = shown.x[k] - x0, shown.y[k] - x1, shown.z[k] - x2
        t = (a * a + b * b + c * c) * rate
        t = t if shown.rows[k] != i else 2.0 * _STEEPEST
        least = lesser(t, least)
        twelfth = decay(lesser(t, _STEEPEST) / 12.0)
        twelfth = twelfth if t <= _STEEPEST else 0.0
        third = twelfth**4
        expected += _SINGLE * third * twelfth**2
        variance += _SQUARE * third**2
        skew += _CUBE * third**2 * twelfth
        weight = third**3
        total += weight
        m0 += weight * a
        m1 += weight * b
        m2 += weight * c
    if least > _STEEPEST or total < _SEEN * exp(-least):
        return False
    if asked.around[i, 0] > expected + _by_chance(variance, skew):
        return False
    mean[0], mean[1], mean[2] = x0 + m0 / total, x1 + m1 / total, x2 + m2 / total
    return True


@lean()
def _stays(asked: _Asked, shown: _Room, i: int) -> bool:
    """Whether nothing is shown around place i, or it was measured and is near to what is nearest, of its own part."""
    x0, x1, x2 = asked.cells.places[i]
    least, nearest = np.inf, -1
    for k in range(len(shown.rows)):
        off = (shown.x[k] - x0) ** 2 + (shown.y[k] - x1) ** 2 + (shown.z[k] - x2) ** 2
        if off < least and shown.rows[k] != i:
            least, nearest = off, shown.rows[k]
    if nearest < 0:
        return True
    a, b = asked.told[i], asked.told[nearest]
    near = max(least, (a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2)
    return bool(asked.own[nearest] and near < (asked.apart * asked.sigma[i]) ** 2)


@lean()
def _by_chance(variance: float, skew: float) -> float:
    """How much more than is expected was measured by chance, by the third moment, too: Cornish and Fisher 1938."""
    return _CHANCE * sqrt(variance) + skew * (_CHANCE**2 - 1.0) / (6.0 * variance)

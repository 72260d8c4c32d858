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

from gpdf_service.denoise.cells import Cells, cells_within, holds_any, sort_into_cells
from gpdf_service.denoise.cloud import HIDDEN, RESOLVED, Denoised
from gpdf_service.fields.shapes import FEWEST
from gpdf_service.fields.threads import run_chunked
from gpdf_service.kernel_cache import lean
from gpdf_service.types import BoolArray, FloatArray, IntArray

_RINGS = 2
"""Cells off its own in which a point's surface is looked for: 4 σ and more."""
_FURTHEST = 5.0
"""[-] Standard deviations off its surface that a point is: one in 1.7 million is further."""
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
    own = part[rows]
    if len(rows) == 0 or cured.measured <= _TOLD * spacing:
        return
    places, sigma, width = cured.points[rows], cured.local[rows], RESOLVED * cured.measured
    near = sort_into_cells(places, width)
    doubtful = cured.vague[rows] | (cured.noise[rows] > HIDDEN * sigma)
    alone = np.zeros(len(rows), dtype=bool)
    run_chunked(lambda a, b: _alone_range(near, doubtful, sigma, a, b, alone), len(near.key))
    doubtful |= alone
    cells = sort_into_cells(points[rows], width)
    for thin in (False, True):
        moved, told, shows = np.zeros(len(rows), dtype=bool), places - cells.corner, ~doubtful
        if thin:
            run_chunked(partial(_draw_range, cells, doubtful, sigma, told), len(cells.key))
            shows = np.ones(len(rows), dtype=bool)
        asked = _Asked(cells, doubtful, shows, own, sigma, apart, told)
        run_chunked(partial(_explain_range, asked, places, moved), len(cells.key))
        doubtful &= ~moved
    cured.points[rows] = places


@njit(cache=True, nogil=True)
def _alone_range(told: Cells, vague: BoolArray, sigma: FloatArray, begin: int, end: int, alone: BoolArray) -> None:
    """Which points have less around than a corner of a surface shows, of the least that shows one."""
    beside = np.empty(27, np.int64)
    for c in range(begin, end):
        count = cells_within(told, c, 1, beside)
        for i in range(told.begin[c], told.begin[c + 1]):
            x, y, z = told.places[i]
            seen, scale = 0.0, -0.5 / sigma[told.order[i]] ** 2
            for j in beside[:count]:
                if seen >= _CORNER:
                    break
                for k in range(told.begin[j], told.begin[j + 1]):
                    if k != i and not vague[told.order[k]]:
                        p = told.places[k]
                        seen += exp(scale * ((p[0] - x) ** 2 + (p[1] - y) ** 2 + (p[2] - z) ** 2))
            alone[told.order[i]] = seen < _CORNER


@njit(cache=True, nogil=True)
def _draw_range(cells: Cells, doubtful: BoolArray, sigma: FloatArray, told: FloatArray, begin: int, end: int) -> None:
    """Write the mean of what was measured around each doubtful point: half-way to what is thinner than the noise.

    For a density p of what was measured the source of a point is expected at x + σ² ∇ log p (Tweedie, 1956; Efron,
    2011). With p smoothed by σ itself, which makes it wider and the step shorter, that is this mean.
    """
    beside = np.empty((2 * _RINGS + 1) ** 3, np.int64)
    for c in range(begin, end):
        if not holds_any(cells, c, doubtful):
            continue
        count = cells_within(cells, c, _RINGS, beside)
        for i in range(cells.begin[c], cells.begin[c + 1]):
            row = cells.order[i]
            if not doubtful[row]:
                continue
            (x, y, z), scale, total = cells.places[i], -0.5 / sigma[row] ** 2, 0.0
            told[row] = 0.0
            for j in beside[:count]:
                for k in range(cells.begin[j], cells.begin[j + 1]):
                    p = cells.places[k]
                    weight = exp(scale * ((p[0] - x) ** 2 + (p[1] - y) ** 2 + (p[2] - z) ** 2))
                    total += weight
                    for a in range(3):
                        told[row, a] += weight * p[a]
            told[row] /= total


class _Asked(NamedTuple):
    """What is asked about.

    Attributes:
        cells: Of the points as they were measured.
        doubtful: Those that are asked about, shape (n,).
        shows: Those that show where something is, shape (n,).
        own: Those of which the doubtful are asked about, shape (n,).
        sigma: Noise of each point [m], shape (n,).
        apart: Standard deviations off a surface of their own, within which they stay [-].
        told: Where the points are now, from the cells' corner [m], shape (n, 3).
    """

    cells: Cells
    doubtful: BoolArray
    shows: BoolArray
    own: BoolArray
    sigma: FloatArray
    apart: float
    told: FloatArray


@njit(cache=True, nogil=True)
def _explain_range(asked: _Asked, places: FloatArray, moved: BoolArray, begin: int, end: int) -> None:
    cells, doubtful = asked.cells, asked.doubtful
    beside, mean = np.empty((2 * _RINGS + 1) ** 3, np.int64), np.empty(3)
    for c in range(begin, end):
        if not holds_any(cells, c, doubtful):
            continue
        count = cells_within(cells, c, _RINGS, beside)
        for i in range(cells.begin[c], cells.begin[c + 1]):
            row = cells.order[i]
            if doubtful[row] and asked.own[row] and _is_explained(asked, beside[:count], i, mean):
                moved[row] = True
                for k in range(3):
                    places[row, k] = mean[k] + cells.corner[k]


@lean()
def _is_explained(asked: _Asked, beside: IntArray, i: int, mean: FloatArray) -> bool:
    """Whether the surfaces explain what is at place i; writes where on them it is expected to be from."""
    cells, _, shows, _, _, apart, told = asked
    sigma = asked.sigma[cells.order[i]]
    measured, expected, variance, skew, total = 0.0, 0.0, 0.0, 0.0, 0.0
    x, y, z = cells.places[i]
    scale, furthest, least, nearest = -0.5 / sigma**2, (_FURTHEST * sigma) ** 2, np.inf, -1
    mean[:] = 0.0
    for j in beside:
        for k in range(cells.begin[j], cells.begin[j + 1]):
            if k == i:
                continue
            p, row = cells.places[k], cells.order[k]
            off = (p[0] - x) ** 2 + (p[1] - y) ** 2 + (p[2] - z) ** 2
            if off <= furthest:
                measured += exp(scale * off)
            if not shows[row]:
                continue
            s = told[row]
            off = (s[0] - x) ** 2 + (s[1] - y) ** 2 + (s[2] - z) ** 2
            if off > furthest:
                continue
            twelfth = exp(scale * off / 12.0)
            third = twelfth**4
            expected += _SINGLE * third * twelfth**2
            variance += _SQUARE * third**2
            skew += _CUBE * third**2 * twelfth
            total += third**3
            for a in range(3):
                mean[a] += third**3 * s[a]
            if off < least:
                least, nearest = off, row
    if (
        nearest < 0
        or (
            asked.own[nearest]
            and max(least, _square_between(told[cells.order[i]], told[nearest])) < (apart * sigma) ** 2
        )
        or total < _SEEN * exp(scale * least)
        or measured > expected + _by_chance(variance, skew)
    ):
        return False
    mean /= total
    return True


@lean()
def _square_between(a: FloatArray, b: FloatArray) -> float:
    found: float = (a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2
    return found


@lean()
def _by_chance(variance: float, skew: float) -> float:
    """How much more than is expected was measured by chance, `_CHANCE` standard errors or, of few points, more.

    Cornish and Fisher (1938): the third moment tells how far the tail of a sum of few reaches.
    """
    return _CHANCE * sqrt(variance) + skew * (_CHANCE**2 - 1.0) / (6.0 * variance)

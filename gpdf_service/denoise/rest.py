"""What no plane of its cell explains: outliers go to the plane beside, things are let go again, the rest stays.

An outlier is alone; a rod, a handle or a leaf is many points on one side of a plane, more than the noise's tail has
there. What is left, foliage above all, stays as it was measured.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numba import njit

from gpdf_service.denoise.cells import (
    AROUND,
    Cells,
    Some,
    begin_among,
    begin_sweep,
    count_in,
    gather,
    holds_any,
    look_around,
    runs_within,
    some_of,
    some_within,
)
from gpdf_service.denoise.place import Placed
from gpdf_service.denoise.planes import Windows
from gpdf_service.fields.shapes import FEWEST
from gpdf_service.fields.threads import run_chunked
from gpdf_service.kernel_cache import lean
from gpdf_service.types import BoolArray, FloatArray, IntArray

EXTREME = 1.5
"""[-] Standard deviation of a point that was not moved over the noise: the nearest of many is an extreme one."""
_FURTHEST = 4.0
"""[-] Standard deviations off a plane that noise makes: one in 16 000 is further."""
_RINGS = 2
"""Cells off its own in which an outlier's plane is looked for: 4 σ."""
_SURROUNDINGS = 3
"""Cells off a point that is alone in which something else was seen, or the scan is thin there."""
_TAIL, _SHARE = 2.0, 0.0228
"""[-] Standard deviations that a point of the tail is off its plane at least, and the share of points that are, to one
side."""
_CHANCE, _FEWEST = 5.0, 2
"""[-] Standard errors, and points, by which a tail exceeds what noise makes: a floor has thousands of windows, and what
is let go of it wrongly stands over it."""
_WITNESSES = 256
"""Outliers beside that are looked at."""


def follow_planes(windows: Windows, placed: Placed) -> BoolArray:
    """Put pending points onto the main plane of a cell near them; which those are, shape (n,)."""
    before, shown = placed.pending.copy(), some_of(windows.cells, windows.main[:, 4] > 0.0)
    run_chunked(lambda a, b: _follow_range(windows, shown, placed, a, b), len(windows.main))
    return before & ~placed.pending


def release_things(windows: Windows, points: FloatArray, placed: Placed) -> None:
    """Make points pending again that are off their planes with more company than the noise's tail has."""
    off = points - placed.points
    far = ~placed.pending & (np.einsum("ij,ij->i", off, off) > (_TAIL * windows.sigma) ** 2)
    free = np.zeros(len(points), dtype=bool)
    run_chunked(lambda a, b: _company_range(windows, off, far, a, b, free), len(windows.main))
    placed.points[free], placed.pending[free] = points[free], True


def find_alone(cells: Cells, placed: Placed) -> BoolArray:
    """Pending points without two others beside, though a well-sampled surface is near, shape (n,).

    What has its place on a surface is no company: of a large wall some points are five deviations off it.
    """
    stray = np.zeros(len(placed.points), dtype=bool)
    run_chunked(lambda a, b: _alone_range(cells, placed.pending, a, b, stray), len(cells.key))
    return stray


@njit(cache=True, nogil=True)
def _follow_range(windows: Windows, shown: Some, placed: Placed, begin: int, end: int) -> None:
    """As `follow_planes`, of cells from `begin` to `end`; `shown` are those that have a main plane."""
    cells, sigma, _, main = windows
    beside, limit = np.empty((2 * _RINGS + 1) ** 3, np.int64), _FURTHEST * sigma
    planes, at = np.empty((len(beside), 7)), begin_among(shown.key, cells, begin, _RINGS)
    for c in range(begin, end):
        if not holds_any(cells, c, placed.pending):
            continue
        count = some_within(shown, cells.key[c], _RINGS, at, beside)
        for j in range(count):
            planes[j, :3], planes[j, 3:] = shown.middle[beside[j]], main[shown.cell[beside[j]], :4]
        for i in range(cells.begin[c], cells.begin[c + 1] if count > 0 else cells.begin[c]):
            row = cells.order[i]
            if not placed.pending[row]:
                continue
            best, height = _nearest(cells.places[i], planes[:count], limit, cells.width)
            if best >= 0:
                for k in range(3):
                    placed.points[row, k] = cells.places[i, k] + cells.corner[k] - height * planes[best, 3 + k]
                    placed.normal[row, k] = planes[best, 3 + k]
                placed.error[row], placed.pending[row] = main[shown.cell[beside[best]], 4], False


@lean()
def _nearest(p: FloatArray, planes: FloatArray, limit: float, width: float) -> tuple[int, float]:
    """Which of the planes is nearest to a place, −1 if none is within the `limit`, and its height over that [m].

    They are told by the middle of their cell, normal and height over that, shape (k, 7). A plane goes on as far as a
    cell's `width` from there.
    """
    least, best, height = limit, -1, 0.0
    for j in range(len(planes)):
        x, y, z, u, v, w, h = planes[j]
        a, b, d = p[0] - x, p[1] - y, p[2] - z
        off = a * u + b * v + d * w - h
        a, b, d = a - off * u, b - off * v, d - off * w
        if abs(off) < least and max(abs(a), abs(b), abs(d)) <= width:
            least, best, height = abs(off), j, off
    return best, height


@njit(cache=True, nogil=True)
def _company_range(windows: Windows, off: FloatArray, far: BoolArray, begin: int, end: int, free: BoolArray) -> None:
    cells, sigma = windows[:2]
    near, rows, at = np.empty(AROUND, np.int64), np.empty(_WITNESSES, np.int64), begin_sweep(cells, begin)
    for c in range(begin, end):
        if not holds_any(cells, c, far):
            continue
        look_around(cells, c, at, near)
        around, tail = 0, 0
        for j in near:
            if j >= 0:
                around += cells.begin[j + 1] - cells.begin[j]
                for i in range(cells.begin[j], cells.begin[j + 1]):
                    tail += far[cells.order[i]]
        by_chance = _SHARE * around + _CHANCE * sqrt(_SHARE * around) + _FEWEST
        if tail <= by_chance:
            continue
        count = gather(cells, near, rows, far)
        for i in range(cells.begin[c], cells.begin[c + 1]):
            row = cells.order[i]
            if not far[row]:
                continue
            x, company = off[row], 0
            length = sqrt(x[0] ** 2 + x[1] ** 2 + x[2] ** 2)
            for k in rows[:count]:
                y = off[cells.order[k]]
                company += x[0] * y[0] + x[1] * y[1] + x[2] * y[2] > _TAIL * sigma * length
            free[row] = company * tail > by_chance * count


@njit(cache=True, nogil=True)
def _alone_range(cells: Cells, pending: BoolArray, begin: int, end: int, stray: BoolArray) -> None:
    near, at = np.empty(AROUND, np.int64), begin_sweep(cells, begin)
    wide = begin_sweep(cells, begin, _SURROUNDINGS)
    runs = np.empty((wide.shape[1], 2), np.int64)
    for c in range(begin, end):
        if not holds_any(cells, c, pending):
            continue
        look_around(cells, c, at, near)
        around = -1
        for i in range(cells.begin[c], cells.begin[c + 1]):
            row = cells.order[i]
            if not pending[row] or _has_company(cells, cells.places[i], near, pending):
                continue
            if around < 0:
                around = count_in(runs[: runs_within(cells, c, _SURROUNDINGS, wide, runs)])
            stray[row] = around > FEWEST


@lean()
def _has_company(cells: Cells, x: FloatArray, near: IntArray, pending: BoolArray) -> bool:
    """Whether two other pending points are within a cell's width of x; x is one of them."""
    found = 0
    for j in near:
        if j >= 0:
            for i in range(cells.begin[j], cells.begin[j + 1]):
                y = cells.places[i]
                square = (x[0] - y[0]) ** 2 + (x[1] - y[1]) ** 2 + (x[2] - y[2]) ** 2
                found += pending[cells.order[i]] and square < cells.width**2
            if found > 2:
                return True
    return False

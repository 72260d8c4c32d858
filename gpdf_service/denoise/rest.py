"""What no plane of its cell explains: outliers go to the plane beside, the rest stays.

What is left, foliage above all, stays as it was measured.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from gpdf_service.denoise.cells import (
    AROUND,
    Cells,
    Some,
    begin_among,
    begin_sweep,
    count_in,
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


def follow_planes(windows: Windows, placed: Placed) -> BoolArray:
    """Put pending points onto the main plane of a cell near them; which those are, shape (n,)."""
    before, shown = placed.pending.copy(), some_of(windows.cells, windows.main[:, 4] > 0.0)
    run_chunked(lambda a, b: _follow_range(windows, shown, placed, a, b), len(windows.main))
    return before & ~placed.pending


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

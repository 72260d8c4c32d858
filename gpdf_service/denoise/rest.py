"""What no plane of its cell explains: outliers go to the plane beside; the rest, foliage above all, stays."""

from __future__ import annotations

import numpy as np
from numba import njit
from scipy.spatial import cKDTree

from gpdf_service.denoise.cells import Cells, begin_sweep, count_in, holds_any, runs_within, some_of
from gpdf_service.denoise.place import Placed
from gpdf_service.denoise.planes import Windows
from gpdf_service.fields.shapes import FEWEST
from gpdf_service.fields.threads import run_chunked
from gpdf_service.kernel_cache import lean
from gpdf_service.types import BoolArray, FloatArray, IntArray

EXTREME = 1.5
"""[-] Standard deviation of a point that was not moved over the noise: the nearest of many is an extreme one."""
FAR = 4.0
"""[-] Standard deviations off a plane that noise makes: one in 16 000 is further."""
_RINGS = 2
"""Cells off its own in which an outlier's plane is looked for: 4 σ."""
_SURROUNDINGS = 3
"""Cells off a point that is alone in which something else was seen, or the scan is thin there."""
_BESIDE = 2.0
"""[-] Standard deviations, or spacings, that witnesses are away at most."""
_WITNESSES = 24
"""Points beside one that say whether they are a thing: by then it shows from one standard deviation on."""


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
def _follow_range(windows: Windows, shown: Cells, placed: Placed, begin: int, end: int) -> None:
    """As `follow_planes`, of cells from `begin` to `end`; `shown` are those that have a main plane."""
    (cells, sigma, _, main), at = windows, begin_sweep(shown, windows.cells.key[begin], _RINGS)
    runs, planes = np.empty((at.shape[1], 2), np.int64), np.empty(((2 * _RINGS + 1) ** 3, 8))
    for c in range(begin, end):
        if not holds_any(cells, c, placed.pending):
            continue
        count = 0
        for run in runs[: runs_within(shown, cells.key[c], _RINGS, at, runs)]:
            for j in range(run[0], run[1]):
                planes[count, :3], planes[count, 3:] = shown.places[j], main[shown.order[j]]
                count += 1
        for i in range(cells.begin[c], cells.begin[c + 1] if count > 0 else cells.begin[c]):
            row = cells.order[i]
            if not placed.pending[row]:
                continue
            best, height = _nearest(cells.places[i], planes[:count], FAR * sigma, cells.width)
            if best >= 0:
                for k in range(3):
                    placed.points[row, k] = cells.places[i, k] + cells.corner[k] - height * planes[best, 3 + k]
                    placed.normal[row, k] = planes[best, 3 + k]
                placed.error[row], placed.pending[row] = planes[best, 7], False


@lean()
def _nearest(p: FloatArray, planes: FloatArray, limit: float, width: float) -> tuple[int, float]:
    """Which of the planes is nearest to a place, −1 if none is within the `limit`, and its height over that [m].

    Each goes a cell's `width` from its middle, which is told with its normal, height and error, shape (k, 8).
    """
    least, best, height = limit, -1, 0.0
    for j in range(len(planes)):
        x, y, z, u, v, w, h, _ = planes[j]
        a, b, d = p[0] - x, p[1] - y, p[2] - z
        off = a * u + b * v + d * w - h
        a, b, d = a - off * u, b - off * v, d - off * w
        if abs(off) < least and max(abs(a), abs(b), abs(d)) <= width:
            least, best, height = abs(off), j, off
    return best, height


@njit(cache=True, nogil=True)
def _alone_range(cells: Cells, pending: BoolArray, begin: int, end: int, stray: BoolArray) -> None:
    at, wide = begin_sweep(cells, cells.key[begin]), begin_sweep(cells, cells.key[begin], _SURROUNDINGS)
    near, far = np.empty((at.shape[1], 2), np.int64), np.empty((wide.shape[1], 2), np.int64)
    for c in range(begin, end):
        if not holds_any(cells, c, pending):
            continue
        beside, around = near[: runs_within(cells, cells.key[c], 1, at, near)], -1
        for i in range(cells.begin[c], cells.begin[c + 1]):
            row = cells.order[i]
            if not pending[row] or _has_company(cells, cells.places[i], beside, pending):
                continue
            if around < 0:
                around = count_in(far[: runs_within(cells, cells.key[c], _SURROUNDINGS, wide, far)])
            stray[row] = around > FEWEST


@lean()
def _has_company(cells: Cells, x: FloatArray, runs: IntArray, pending: BoolArray) -> bool:
    """Whether two other pending points in the runs are within a cell's width of x; x is one of them."""
    found = 0
    for run in runs:
        for i in range(run[0], run[1]):
            y = cells.places[i]
            square = (x[0] - y[0]) ** 2 + (x[1] - y[1]) ** 2 + (x[2] - y[2]) ** 2
            found += pending[cells.order[i]] and square < cells.width**2
        if found > 2:
            return True
    return False


def find_lifted(points: FloatArray, ground: BoolArray, noise: float, spacing: float) -> BoolArray:
    """Points that noise can have lifted off the `ground`, shape (n,), or sunk under it.

    In a million points of a floor a thousand are more than three deviations off it. But they are alone, or as often
    under it as over it: a thing is where the mean height of those beside is more than it can be by chance. Beside is
    two deviations of the noise, or two spacings. What has no ground right under it was not lifted off any: on the flank
    of a rock it is beside it.

    The points [m], shape (n, 3), z up, lie `spacing` [m] apart and are cured of their `noise` [m]; which of them are
    `ground`, (n,), is told.
    """
    lifted, rest = np.zeros(len(points), dtype=bool), np.flatnonzero(~ground)
    if len(rest) == 0 or len(rest) == len(points):
        return lifted
    floor, near = points[ground], FAR * noise + spacing
    z = points[rest, 2]
    rest = rest[(z >= floor[:, 2].min() - near) & (z <= floor[:, 2].max() + near)]
    off, nearest = _tree(floor).query(points[rest], distance_upper_bound=near, workers=-1)
    apart = points[rest] - floor[np.minimum(nearest, len(floor) - 1)]
    low = np.flatnonzero(np.isfinite(off) & (np.hypot(apart[:, 0], apart[:, 1]) <= spacing))
    height = np.full(len(rest) + 1, near)  # of what has no ground under it: it is no noise, but a witness
    height[low] = apart[low, 2]
    height[-1] = 0.0  # of nothing beside
    radius = _BESIDE * max(noise, spacing)
    beside = _tree(points[rest]).query(points[rest[low]], k=_WITNESSES, distance_upper_bound=radius, workers=-1)[1]
    number = (beside < len(rest)).sum(axis=1)
    lifted[rest[low]] = np.abs(height[beside].sum(axis=1)) <= FAR * noise * np.sqrt(number)
    return lifted


def _tree(points: FloatArray) -> cKDTree:
    """Made in a third of the time of a balanced one, and asked as fast."""
    return cKDTree(points, balanced_tree=False, compact_nodes=False)

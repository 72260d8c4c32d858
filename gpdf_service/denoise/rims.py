"""Where a surface ends and no other begins, as at a table's rim: what noise carried over its end goes back to it.

Noise across a surface is taken out by its plane, noise along it moves points past its end. It does not move their mean:
in a strip across the end, filled from −W to s, the points lie at (s − W) / 2, whatever the noise.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numba import njit

from gpdf_service.denoise.cells import Cells, begin_sweep, centre_of, count_in, runs_within
from gpdf_service.denoise.place import Placed
from gpdf_service.denoise.planes import Windows
from gpdf_service.fields.shapes import FEWEST
from gpdf_service.fields.threads import run_chunked
from gpdf_service.fields.tree import VECTORS
from gpdf_service.kernel_cache import lean
from gpdf_service.types import BoolArray, Float32Array, FloatArray, IntArray

_SAME = 0.5
"""[-] Standard deviations off a plane that what lies on it is at most, after it was placed."""
_ALIKE = 0.9
"""[-] Cosine of the angle (26°) between normals of one surface."""
_ASIDE = 0.2
"""[-] Of the window's half width that the middle of the points is off its own middle, at least, beside an end: 0.42 at
it."""
_HALF = 1.0
"""[-] Standard deviations that a strip reaches to either side."""
_STRIP = 2
"""Cells that a strip is long, either way: 4 σ, so that it begins where noise brings in as much as it takes out."""


def draw_in(windows: Windows, placed: Placed) -> BoolArray:
    """Move points that are beyond the end of their surface back to it; which have too few beside to tell, (n,)."""
    cells, few = windows.cells, np.zeros(len(placed.points), dtype=bool)
    sums = np.zeros((len(cells.order) + 1, 3))
    np.cumsum(cells.places, axis=0, out=sums[1:])
    told = np.column_stack([placed.points.take(cells.order, 0), placed.normal.take(cells.order, 0)]), sums
    run_chunked(lambda a, b: _rim_range(windows, told, placed, few, a, b), len(cells.key))
    return few


@njit(cache=True, nogil=True)
def _rim_range(
    windows: Windows, told: tuple[FloatArray, FloatArray], placed: Placed, few: BoolArray, begin: int, end: int
) -> None:
    """As `draw_in`; told are points and normals by cell, (n, 6), and sums of what was measured before, (n + 1, 3)."""
    (cells, sigma), (shown, sums) = windows[:2], told
    at, wide = begin_sweep(cells, cells.key[begin]), begin_sweep(cells, cells.key[begin], _STRIP)
    runs, out, total, room = np.empty((wide.shape[1], 2), np.int64), np.empty(3), np.empty(4), np.empty((6, 0))
    for c in range(begin, end):
        _sum_window(cells, c, runs[: runs_within(cells, cells.key[c], 1, at, runs)], sums, total)
        count = 0
        for i in range(cells.begin[c], cells.begin[c + 1]):
            row = cells.order[i]
            if placed.pending[row] or _is_inside(total, placed.normal[row], cells.width):
                continue
            if count == 0:
                around = runs[: runs_within(cells, cells.key[c], _STRIP, wide, runs)]
                count = count_in(around)
                room = room if count <= room.shape[1] else np.empty((6, 2 * count))
                _bring(shown, around, room)
            found, aside = _outwards(room, count, shown[i], (_SAME * sigma, cells.width), out)
            few[row] = found < FEWEST
            if aside and not few[row]:
                beyond = -_end(room, count, shown[i], (_SAME * sigma, _HALF * sigma, _STRIP * cells.width), out)
                if beyond > 0.0:
                    for k in range(3):
                        placed.points[row, k] -= beyond * out[k]


@lean()
def _sum_window(cells: Cells, c: int, runs: IntArray, sums: FloatArray, total: FloatArray) -> None:
    """Write how many points are in the runs, and the sum of their places from the middle of cell c, shape (4,)."""
    middle, total[:] = centre_of(cells, c), 0.0
    for run in runs:
        total[0] += run[1] - run[0]
        for k in range(3):
            total[1 + k] += sums[run[1], k] - sums[run[0], k]
    for k in range(3):
        total[1 + k] -= total[0] * middle[k]


@lean()
def _is_inside(total: FloatArray, normal: Float32Array, width: float) -> bool:
    """Whether the points of a window lie to all sides of its middle along the surface."""
    off, square = 0.0, 0.0
    for k in range(3):
        off += total[1 + k] * normal[k]
        square += total[1 + k] ** 2
    return bool(square - off * off < (_ASIDE * width * total[0]) ** 2)


@lean()
def _bring(shown: FloatArray, runs: IntArray, room: FloatArray) -> None:
    """Write those of `shown` in the runs, shape (n, 6), one after the other into the columns of the room."""
    found = 0
    for run in runs:
        for i in range(run[0], run[1]):
            for k in range(6):
                room[k, found] = shown[i, k]
            found += 1


@lean(fastmath=VECTORS)
def _outwards(
    room: FloatArray, number: int, own: FloatArray, limits: tuple[float, float], out: FloatArray
) -> tuple[int, bool]:
    """Write the direction `out` from the middle of the surface around a point to it; its points, and if it ends there.

    So many are in the `room`, by place and normal, as the point's `own`. The `limits` are how far off its plane, and
    how far away, they are of its surface [m].
    """
    x, y, z = room[0, :number], room[1, :number], room[2, :number]
    u, v, w = room[3, :number], room[4, :number], room[5, :number]
    (p0, p1, p2, n0, n1, n2), (thick, reach) = own, limits
    count, o0, o1, o2 = 0.0, 0.0, 0.0, 0.0
    for k in range(number):
        a, b, d = p0 - x[k], p1 - y[k], p2 - z[k]
        off, same = a * n0 + b * n1 + d * n2, u[k] * n0 + v[k] * n1 + w[k] * n2
        on = (abs(off) <= thick) & (abs(same) >= _ALIKE) & (a * a + b * b + d * d <= reach * reach)
        count += 1.0 if on else 0.0
        o0 += a if on else 0.0
        o1 += b if on else 0.0
        o2 += d if on else 0.0
    off = o0 * n0 + o1 * n1 + o2 * n2
    o0, o1, o2 = o0 - off * n0, o1 - off * n1, o2 - off * n2
    length = sqrt(o0 * o0 + o1 * o1 + o2 * o2)
    per = 1.0 / max(length, 1e-12)
    out[0], out[1], out[2] = o0 * per, o1 * per, o2 * per
    return int(count), bool(length > _ASIDE * reach * count)


@lean(fastmath=VECTORS)
def _end(room: FloatArray, number: int, own: FloatArray, limits: tuple[float, float, float], out: FloatArray) -> float:
    """Where the strip through a point ends at the latest, from it on along `out` [m]; inf where that is not known.

    The `limits` are how far off its plane, aside and along the strip its points are [m], the rest as in `_outwards`.
    """
    x, y, z = room[0, :number], room[1, :number], room[2, :number]
    u, v, w = room[3, :number], room[4, :number], room[5, :number]
    (p0, p1, p2, n0, n1, n2), (o0, o1, o2), (thick, half, reach) = own, out, limits
    count, total, squares = 0.0, 0.0, 0.0
    for k in range(number):
        a, b, d = x[k] - p0, y[k] - p1, z[k] - p2
        off, same = a * n0 + b * n1 + d * n2, u[k] * n0 + v[k] * n1 + w[k] * n2
        along = a * o0 + b * o1 + d * o2
        aside = a * a + b * b + d * d - along * along - off * off
        on = (abs(off) <= thick) & (abs(same) >= _ALIKE) & (aside <= half * half) & (abs(along) <= reach)
        along = along if on else 0.0
        count += 1.0 if on else 0.0
        total += along
        squares += along * along
    if count < FEWEST:
        return np.inf
    mean = total / count
    return float(2.0 * (mean + sqrt(max(squares / count - mean * mean, 0.0) / count)) + reach)

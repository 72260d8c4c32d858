"""Where a surface ends and no other begins, as at a table's rim: what noise carried over its end goes back to it.

Noise across a surface is taken out by its plane, noise along it moves points past its end. It does not move their mean:
in a strip across the end, filled from −W to s, the points lie at (s − W) / 2, whatever the noise.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gpdf_service.denoise.cells import AROUND, begin_sweep, cells_within, centre_of, look_around, sum_window
from gpdf_service.denoise.place import Placed
from gpdf_service.denoise.planes import Windows
from gpdf_service.fields.shapes import FEWEST
from gpdf_service.fields.threads import run_chunked
from gpdf_service.kernel_cache import lean
from gpdf_service.types import BoolArray, FloatArray, IntArray

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
_CORNER = 0.5 * sqrt(3.0)
"""[-] Of a cell's width, from its middle to its corners."""


def draw_in(windows: Windows, placed: Placed) -> BoolArray:
    """Move points that are beyond the end of their surface back to it; which have too few beside to tell, shape (n,).

    Args:
        windows: Of the points as they were measured.
        placed: Where the points are; changed in place.
    """
    before, few = placed._replace(points=placed.points.copy()), np.zeros(len(placed.points), dtype=bool)
    run_chunked(lambda a, b: _rim_range(windows, before, placed, a, b, few), len(windows.main))
    return few


@njit(cache=True, nogil=True)
def _rim_range(windows: Windows, before: Placed, placed: Placed, begin: int, end: int, few: BoolArray) -> None:
    cells = windows.cells
    near, at, wide = np.empty(AROUND, np.int64), begin_sweep(cells, begin), begin_sweep(cells, begin, _STRIP)
    out, total, beside = np.empty(3), np.empty(10), np.empty((2 * _STRIP + 1) ** 3, np.int64)
    for c in range(begin, end):
        look_around(cells, c, at, near)
        sum_window(cells, near, total)
        count = 0
        for i in range(cells.begin[c], cells.begin[c + 1]):
            row = cells.order[i]
            if placed.pending[row] or _is_inside(total, placed.normal[row], cells.width):
                continue
            found, aside = _outwards(windows, near, row, before, out)
            few[row] = found < FEWEST
            if aside and not few[row]:
                if count == 0:
                    count = cells_within(cells, c, _STRIP, wide, beside)
                beyond = -_end(windows, beside[:count], row, before, out)
                if beyond > 0.0:
                    for k in range(3):
                        placed.points[row, k] -= beyond * out[k]


@lean()
def _is_inside(total: FloatArray, normal: NDArray[np.float32], width: float) -> bool:
    """Whether the points of a window lie to all sides of its middle along the surface."""
    off, square = 0.0, 0.0
    for k in range(3):
        off += total[1 + k] * normal[k]
        square += total[1 + k] ** 2
    return bool(square - off * off < (_ASIDE * width * total[0]) ** 2)


@lean()
def _outwards(windows: Windows, near: IntArray, row: int, placed: Placed, out: FloatArray) -> tuple[int, bool]:
    """Write the direction from the middle of the surface around a point to it; its points, and if it ends there."""
    (cells, sigma, _, _), (points, _, _, normal) = windows, placed
    count, reach, p, n = 0, cells.width, points[row], normal[row]
    out[:] = 0.0
    for j in near:
        if j < 0:
            continue
        for i in range(cells.begin[j], cells.begin[j + 1]):
            q, m = points[cells.order[i]], normal[cells.order[i]]
            a, b, d = p[0] - q[0], p[1] - q[1], p[2] - q[2]
            off, same = a * n[0] + b * n[1] + d * n[2], m[0] * n[0] + m[1] * n[1] + m[2] * n[2]
            if abs(off) <= _SAME * sigma and abs(same) >= _ALIKE and a * a + b * b + d * d <= reach * reach:
                out[0], out[1], out[2], count = out[0] + a, out[1] + b, out[2] + d, count + 1
    off = out[0] * n[0] + out[1] * n[1] + out[2] * n[2]
    for k in range(3):
        out[k] -= off * n[k]
    length = sqrt(out[0] ** 2 + out[1] ** 2 + out[2] ** 2)
    for k in range(3):
        out[k] /= max(length, 1e-12)
    return count, bool(length > _ASIDE * reach * count)


@lean()
def _end(windows: Windows, beside: IntArray, row: int, placed: Placed, out: FloatArray) -> float:
    """Where the strip through a point ends at the latest, from it on along `out` [m]; inf where that is not known."""
    (cells, sigma, _, _), (points, _, _, normal) = windows, placed
    count, total, squares, reach, p, n = 0, 0.0, 0.0, _STRIP * cells.width, points[row], normal[row]
    far = (_HALF * sigma + _CORNER * cells.width) ** 2
    for j in beside:
        x, y, z = centre_of(cells, j)
        a, b, d = x + cells.corner[0] - p[0], y + cells.corner[1] - p[1], z + cells.corner[2] - p[2]
        u = a * out[0] + b * out[1] + d * out[2]
        if a * a + b * b + d * d - u * u > 2.0 * far:
            continue
        for i in range(cells.begin[j], cells.begin[j + 1]):
            q, m = points[cells.order[i]], normal[cells.order[i]]
            a, b, d = q[0] - p[0], q[1] - p[1], q[2] - p[2]
            off, same = a * n[0] + b * n[1] + d * n[2], m[0] * n[0] + m[1] * n[1] + m[2] * n[2]
            u = a * out[0] + b * out[1] + d * out[2]
            aside = a * a + b * b + d * d - u * u - off * off
            on = abs(off) <= _SAME * sigma and abs(same) >= _ALIKE and aside <= (_HALF * sigma) ** 2
            if on and abs(u) <= reach:
                count, total, squares = count + 1, total + u, squares + u * u
    if count < FEWEST:
        return np.inf
    mean = total / count
    return 2.0 * (mean + sqrt(max(squares / count - mean * mean, 0.0) / count)) + reach

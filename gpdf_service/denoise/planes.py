"""The plane of a window: a cell and those around it, where the noise alone explains how thick it is.

With the covariance's eigenvalues λ₁ ≤ λ₂ ≤ λ₃ of n points, n λ₁ / σ² is χ² with n − 3 degrees of freedom if they are of
one plane. What is thicker is two sheets, if each of them then leaves σ², or nothing that is known.
"""

from __future__ import annotations

from math import exp, sqrt
from typing import NamedTuple

import numpy as np
from numba import njit

from gpdf_service.denoise.cells import AROUND, Cells, begin_sweep, look_around, look_at, sum_cells, sum_window
from gpdf_service.fields.shapes import FEWEST, add, fit_axis, fit_plane
from gpdf_service.fields.threads import run_chunked
from gpdf_service.fields.tree import VECTORS
from gpdf_service.kernel_cache import lean
from gpdf_service.types import BoolArray, Float32Array, FloatArray

SHEETS = 2
"""Planes that a window can have."""
NUMBERS = 10
"""Of a plane: its normal, the middle of its points from the window's, how many they are, (λ₂ − λ₁)² / λ₂, the standard
error of its direction [rad], and how well it explains them and has its noise inside the window, 0 to 1."""
Planes = Float32Array
"""Shape (m, `SHEETS`, `NUMBERS`); 0 points where there is none."""
THICK = 2.5
"""[-] Standard errors by which λ₁ may exceed σ²: more, and it is another shape."""
_FLAT = 2.2
"""[-] λ₂ over λ₁ from which on a direction is known: in a window of 6 σ it is 3, in half of one 0.8."""
_CROSS = 0.65
"""[-] Cells from its window's middle that a plane may pass: further, the window cuts its noise off at one side."""
_THIN = 0.5
"""[-] λ₁ of a sheet over σ², at least: two halves of one sheet have 0.36."""
_ROUND = 0.25
"""[-] Two eigenvalues that differ by less, over one of them, are equal: those across a pole are, but for chance."""
_TURNS = 5
"""Assignments of points to two sheets: then few change sides."""
_MOST = 400
"""Points of a window that are looked at one by one."""


class Windows(NamedTuple):
    """Points in cells, as noisy all over, and what the windows around the cells show.

    Attributes:
        cells: The cells.
        sigma: Noise of the points [m].
        planes: Of the windows.
        main: The plane that most points of each cell are of: its normal, its height over the cell's middle and its
            error [m], shape (m, 5), 0 where there is none; written as points are placed.
    """

    cells: Cells
    sigma: float
    planes: Planes
    main: Float32Array


def find_planes(cells: Cells, sigma: float, wanted: BoolArray) -> Windows:
    """The windows around the cells, and the planes of the `wanted` ones, shape (m,), where the noise is `sigma` [m]."""
    count = len(cells.key)
    planes, main = np.zeros((count, SHEETS, NUMBERS), np.float32), np.zeros((count, 5), np.float32)
    found, moments = Windows(cells, sigma, planes, main), sum_cells(cells)
    run_chunked(lambda a, b: _planes_range(found, moments, wanted, a, b), count)
    return found


@njit(cache=True, nogil=True)
def _planes_range(windows: Windows, moments: FloatArray, wanted: BoolArray, begin: int, end: int) -> None:
    cells, sigma, planes, _ = windows
    near, total, normal, mean = np.empty(AROUND, np.int64), np.empty(10), np.empty(3), np.empty(3)
    halves, about = np.empty((2, 10)), np.empty((4, _MOST))
    at = begin_sweep(cells, cells.key[begin])
    for c in range(begin, end):
        if not wanted[c]:
            continue
        look_around(cells, c, at, near)
        sum_window(cells, moments, near, total)
        if total[0] < FEWEST:
            continue
        low, middle, high = fit_plane(total, mean, normal)
        excess = _excess(low, total[0], sigma)
        if excess <= THICK:
            if middle > _FLAT * low:
                _write(planes[c, 0], normal, mean, (total[0], (middle - low) ** 2 / middle, excess), cells.width, sigma)
        elif total[0] >= 2 * FEWEST:
            count = look_at(cells, c, near, _MOST, about)
            for axis in range(3):
                if _is_round((low, middle, high), axis):
                    continue
                if axis > 0:
                    fit_axis(total, middle if axis == 1 else high, normal)
                split = _split(about, count, normal, halves)
                if split and _both(halves, sigma, total[0] / count, cells.width, planes[c]):
                    break


@njit(cache=True, nogil=True)
def _is_round(values: tuple[float, float, float], axis: int) -> bool:
    """Whether the spread along an axis is that along another one, too: a pole has no two sheets, whichever way."""
    other, last = values[(axis + 1) % 3], values[(axis + 2) % 3]
    return bool(abs(other - values[axis]) < _ROUND * values[axis] or abs(last - values[axis]) < _ROUND * values[axis])


@njit(cache=True, nogil=True)
def _excess(low: float, count: float, sigma: float) -> float:
    """By how many standard errors a variance exceeds σ²."""
    return float((low * count / (sigma**2 * (count - 3.0)) - 1.0) * sqrt(0.5 * (count - 3.0)))


@njit(cache=True, nogil=True)
def _write(
    plane: Planes, normal: FloatArray, mean: FloatArray, told: tuple[float, float, float], width: float, sigma: float
) -> None:
    """A plane that crosses its window's own cell; `told` are its count, (λ₂ − λ₁)² / λ₂ and excess of λ₁ over σ²."""
    count, spread, excess = told
    height = mean[0] * normal[0] + mean[1] * normal[1] + mean[2] * normal[2]
    off = abs(height) / (_CROSS * width * (abs(normal[0]) + abs(normal[1]) + abs(normal[2])))
    if off >= 1.0:
        return
    for k in range(3):
        plane[k], plane[3 + k] = normal[k], mean[k]
    plane[6], plane[7], plane[8] = count, spread, sigma / sqrt(count * spread)
    plane[9] = (1.0 - off * off) * exp(-0.5 * max(excess, 0.0) ** 2)


@lean()
def _split(about: FloatArray, n: int, axis: FloatArray, halves: FloatArray) -> bool:
    """Write the sums of two sheets of the n points `about` across `axis` into their `halves`; whether there are two.

    The last row of `about` is room for heights.
    """
    x, y, z, heights = about[0, :n], about[1, :n], about[2, :n], about[3, :n]
    total, (u, v, w) = 0.0, axis
    for i in range(n):
        heights[i] = x[i] * u + y[i] * v + z[i] * w
    for h in heights:
        total += h
    cut = total / n
    for _ in range(_TURNS):
        upper, above = _sum_over(cut, heights)
        if above < FEWEST or n - above < FEWEST:
            return False
        cut, before = 0.5 * (upper / above + (total - upper) / (n - above)), cut
        if cut == before:
            break
    halves[:] = 0.0
    for i in range(n):
        add(halves[int(heights[i] > cut)], x[i], y[i], z[i])
    return bool(min(halves[0, 0], halves[1, 0]) >= FEWEST)


@lean(fastmath=VECTORS)
def _sum_over(cut: float, heights: FloatArray) -> tuple[float, float]:
    """Sum of those that are over the cut, and how many they are."""
    upper, above = 0.0, 0.0
    for h in heights:
        upper += h if h > cut else 0.0
        above += 1.0 if h > cut else 0.0
    return upper, above


@njit(cache=True, nogil=True)
def _both(halves: FloatArray, sigma: float, share: float, width: float, planes: Planes) -> bool:
    """Write two sheets if both are planes of their own; each of their points stands for `share`."""
    normal, mean = np.empty(3), np.empty(3)
    for k in range(SHEETS):
        low, middle, _ = fit_plane(halves[k], mean, normal)
        count = halves[k, 0]
        excess = _excess(low, count, sigma)
        if excess > THICK or low * count < _THIN * sigma**2 * (count - 3.0) or middle <= _FLAT * low:
            planes[0, 6] = 0.0
            return False
        _write(planes[k], normal, mean, (share * count, (middle - low) ** 2 / middle, excess), width, sigma)
    return True

"""Heights of cells from their surroundings: at their centres, and at rims of noisy ground.

A cell's height is that of one of its points. On a slope a point beside the centre is off by as much as the ground rises
between them, which reads as a step; and the cure of a point at a rim sees half of a plane.
"""

from __future__ import annotations

from dataclasses import replace
from math import ceil, sqrt

import numpy as np
from numba import njit

from gpdf_service.perception.bend import FINE, FLAT, REACH
from gpdf_service.tiles.surface import HeightMap
from gpdf_service.types import Float32Array

_SAME = 1.0
"""[-] Heights further apart, over the noise, are two surfaces: cured cells are off by a fifth of it."""
_BESIDE = 2
"""Cells from a rim that a step is read over: its own two sides and one more."""
_ALONE = 3.0
"""[-] Of what a rim's plane leaves: a cell that is further off is alone in that, however rough the others are."""
_FEWEST = 9
"""Cells that a rim's plane needs: three square."""
_AROUND = 5
"""Of a cell and its eight neighbours that a plane needs: two more than it has numbers, so that what is off shows."""
_ASKEW = 1e-3
"""[-] Places nearer to one line have no slope across it: their spread about it over that along it, squared."""

_Sums = tuple[float, float, float, float, float, float, float, float, float, float]
"""Of 1, x, y, z, x², y², z², xy, xz, yz."""
_OF_NONE: _Sums = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def to_centres(surface: HeightMap, off: Float32Array, noise: float = 0.0) -> HeightMap:
    """Each cell's height on the plane through its own and its neighbours' points, at the cell's centre.

    Least squares over those of the nine that differ from its own by less than a cell's width, or the noise. A step
    leaves more than `FINE` and `FLAT` σ: what is no plane stays as it is.

    Args:
        surface: The ground as it was seen.
        off: Where the point lies whose height a cell has, from the cell's centre [m], shape (nx, ny, 2).
        noise: Standard deviation σ of the points before they were cured [m].
    """
    same, flat = max(surface.cell_width, _SAME * noise), max(FINE, FLAT * noise)
    return replace(surface, height=_at_centres(surface.height, off, surface.cell_width, same, flat))


def with_rims(surface: HeightMap, noise: float) -> HeightMap:
    """Each cell at a rim on the plane through the heights of its surface around it, where they are one.

    Least squares over the cells within `REACH` σ whose height is within σ of its own. A step's height is the difference
    of two rims, and at a rim half of the plane is missing: the error of a small disc's plane is largest there. What is
    at no rim stays as it is: at the foot of a ramp a plane is off by a centimetre.

    Args:
        surface: The ground as it was seen, cured.
        noise: Standard deviation σ of the points before the cure [m]; 0 leaves everything as it is.
    """
    if noise == 0.0:
        return surface
    reach = ceil(REACH * noise / surface.cell_width)
    return replace(surface, height=_at_rims(surface.height, reach, _SAME * noise, FLAT * noise))


@njit(cache=True, nogil=True)
def _at_rims(height: Float32Array, reach: int, same: float, flat: float) -> Float32Array:
    made = height.copy()
    for i in range(height.shape[0]):
        for j in range(height.shape[1]):
            if not _is_rim(height, i, j, same):
                continue
            sums = _OF_NONE
            for k in range(max(i - reach, 0), min(i + reach + 1, height.shape[0])):
                for m in range(max(j - reach, 0), min(j + reach + 1, height.shape[1])):
                    a, b, rise = float(k - i), float(m - j), float(height[k, m]) - float(height[i, j])
                    if abs(rise) <= same and a * a + b * b <= reach * reach:  # a NaN compares false
                        sums = _with(sums, a, b, rise)
            shift, rest = _plane(sums)
            if sums[0] >= _FEWEST and (rest <= flat or abs(shift) > _ALONE * rest):
                made[i, j] += shift
    return made


@njit(cache=True, nogil=True)
def _is_rim(height: Float32Array, i: int, j: int, same: float) -> bool:
    """Whether another surface is within `_BESIDE` cells."""
    for k in range(max(i - _BESIDE, 0), min(i + _BESIDE + 1, height.shape[0])):
        for m in range(max(j - _BESIDE, 0), min(j + _BESIDE + 1, height.shape[1])):
            if abs(height[k, m] - height[i, j]) > same:  # a NaN compares false
                return True
    return False


@njit(cache=True, nogil=True)
def _at_centres(height: Float32Array, off: Float32Array, width: float, same: float, flat: float) -> Float32Array:
    made = height.copy()
    for i in range(height.shape[0]):
        for j in range(height.shape[1]):
            if np.isnan(height[i, j]):
                continue
            sums = _OF_NONE
            for k in range(max(i - 1, 0), min(i + 2, height.shape[0])):
                for m in range(max(j - 1, 0), min(j + 2, height.shape[1])):
                    rise = float(height[k, m]) - float(height[i, j])
                    if abs(rise) <= same:  # a NaN compares false
                        sums = _with(sums, (k - i) * width + off[k, m, 0], (m - j) * width + off[k, m, 1], rise)
            shift, rest = _plane(sums)
            if rest <= flat:
                made[i, j] += shift
    return made


@njit(cache=True, nogil=True)
def _with(sums: _Sums, x: float, y: float, z: float) -> _Sums:
    n, sx, sy, sz, xx, yy, zz, xy, xz, yz = sums
    n, sx, sy, sz = n + 1.0, sx + x, sy + y, sz + z
    return n, sx, sy, sz, xx + x * x, yy + y * y, zz + z * z, xy + x * y, xz + x * z, yz + y * z


@njit(cache=True, nogil=True)
def _plane(sums: _Sums) -> tuple[float, float]:
    """Height at (0, 0) of the least-squares plane, and the root mean square about it; inf if places carry none."""
    n, x, y, z, xx, yy, zz, xy, xz, yz = sums
    if n < _AROUND:
        return 0.0, np.inf
    xx, yy, zz = xx - x * x / n, yy - y * y / n, zz - z * z / n
    xy, xz, yz = xy - x * y / n, xz - x * z / n, yz - y * z / n
    whole = xx * yy - xy * xy
    if whole <= _ASKEW * xx * yy:
        return 0.0, np.inf
    slope_x, slope_y = (xz * yy - yz * xy) / whole, (yz * xx - xz * xy) / whole
    rest = max(zz - slope_x * xz - slope_y * yz, 0.0)
    return (z - slope_x * x - slope_y * y) / n, sqrt(rest / n)

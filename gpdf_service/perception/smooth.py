"""Heights of cells from the plane through their surroundings: at the cell's centre, and at the rims of noisy ground.

A cell's height is that of one of its points. On a slope a point beside the centre is off by as much as the ground rises
between them, which reads as a step; and the cure of a point at a rim sees half of a plane.
"""

from __future__ import annotations

from dataclasses import replace
from math import ceil

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gpdf_service.perception.planes import AROUND, FINE, FLAT, NOTHING, add_place, plane_of
from gpdf_service.perception.surface import HeightMap

_REACH = 11.4
"""[-] Radius of the plane over the noise: that of the largest neighbourhood that a point is cured by."""
_SAME = 1.0
"""[-] Heights further apart, over the noise, are two surfaces: cured cells are off by a fifth of it."""
RESOLVED_STEP = 3.0
"""[-] A lower step over the noise may be an unlucky cell of a cured floor, if it is of one cell."""
_BESIDE = 2
"""Cells from a rim that a step is read over: its own two sides and one more."""
_FEWEST = 9
"""Cells that a plane needs: three square."""


def to_centres(surface: HeightMap, off: NDArray[np.float32], noise: float = 0.0) -> HeightMap:
    """Each cell's height on the plane through its own and its neighbours' points, at the cell's centre.

    Least squares over those of the nine that differ from its own by less than a cell's width, or the noise. A step
    leaves more than `FINE` and `FLAT` σ: what is no plane stays as it is. But where the eight around are on one plane,
    and the cell alone is off it by no more than an unlucky cure leaves, it takes their plane.

    Args:
        surface: The ground as it was seen.
        off: Where the point lies whose height a cell has, from the cell's centre [m], shape (nx, ny, 2).
        noise: Standard deviation σ of the points before they were cured [m].
    """
    same, flat = max(surface.cell_width, _SAME * noise), max(FINE, FLAT * noise)
    made = _at_centres(surface.height, off, surface.cell_width, same, flat, RESOLVED_STEP * noise)
    return replace(surface, height=made)


def smooth(surface: HeightMap, noise: float) -> HeightMap:
    """Each cell at a rim on the plane through the heights of its surface around it, where they are one.

    h(x) = a + b·x by least squares over the cells within `_REACH` σ whose height is within σ of its own. A step's
    height is the difference of two rims, and at a rim half of the plane is missing: the error of a small disc's plane
    is largest there. What is no plane stays as it is, and so does what
    is at no rim: at the foot of a ramp a plane is off by a centimetre.

    Args:
        surface: The ground as it was seen, cured.
        noise: Standard deviation σ of the points before the cure [m]; 0 leaves everything as it is.
    """
    if noise == 0.0:
        return surface
    reach = ceil(_REACH * noise / surface.cell_width)
    return replace(surface, height=_planes(surface.height, reach, _SAME * noise, FLAT * noise))


@njit(cache=True, nogil=True)
def _planes(height: NDArray[np.float32], reach: int, same: float, flat: float) -> NDArray[np.float32]:
    made = height.copy()
    for i in range(height.shape[0]):
        for j in range(height.shape[1]):
            if _at_rim(height, i, j, same):
                shift, rest = _fit(height, i, j, reach, same)
                if rest <= flat:
                    made[i, j] += shift
    return made


@njit(cache=True, nogil=True)
def _at_rim(height: NDArray[np.float32], i: int, j: int, same: float) -> bool:
    """Whether another surface is within `_BESIDE` cells."""
    for k in range(max(i - _BESIDE, 0), min(i + _BESIDE + 1, height.shape[0])):
        for m in range(max(j - _BESIDE, 0), min(j + _BESIDE + 1, height.shape[1])):
            if abs(height[k, m] - height[i, j]) > same:  # a NaN compares false
                return True
    return False


@njit(cache=True, nogil=True)
def _at_centres(
    height: NDArray[np.float32], off: NDArray[np.float32], width: float, same: float, flat: float, unlucky: float
) -> NDArray[np.float32]:
    made = height.copy()
    for i in range(height.shape[0]):
        for j in range(height.shape[1]):
            if np.isnan(height[i, j]):
                continue
            around = NOTHING
            for k in range(max(i - 1, 0), min(i + 2, height.shape[0])):
                for m in range(max(j - 1, 0), min(j + 2, height.shape[1])):
                    rise = float(height[k, m]) - float(height[i, j])
                    if abs(rise) <= same and (k != i or m != j):  # a NaN compares false
                        around = add_place(around, (k - i) * width + off[k, m, 0], (m - j) * width + off[k, m, 1], rise)
            shift, rest = plane_of(add_place(around, float(off[i, j, 0]), float(off[i, j, 1]), 0.0), AROUND)
            if rest > flat and unlucky > 0.0:
                shift, rest = plane_of(around, AROUND)
                if abs(shift) > unlucky:
                    continue
            if rest <= flat:
                made[i, j] += shift
    return made


@njit(cache=True, nogil=True)
def _fit(height: NDArray[np.float32], i: int, j: int, reach: int, same: float) -> tuple[float, float]:
    """Height of the plane over the cell's own and the root mean square about it [m]; inf for the second if none."""
    sums = NOTHING
    for k in range(max(i - reach, 0), min(i + reach + 1, height.shape[0])):
        for m in range(max(j - reach, 0), min(j + reach + 1, height.shape[1])):
            a, b, c = float(k - i), float(m - j), float(height[k, m]) - float(height[i, j])
            if abs(c) <= same and a * a + b * b <= reach * reach:  # a NaN compares false
                sums = add_place(sums, a, b, c)
    return plane_of(sums, _FEWEST)

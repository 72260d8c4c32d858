"""Heights of cells from their surroundings: at their centres, at rims of noisy ground, and in gaps of smooth ground.

A cell's height is that of one of its points. On a slope a point beside the centre is off by as much as the ground rises
between them, which reads as a step; and the cure of a point at a rim sees half of a plane.
"""

from __future__ import annotations

from dataclasses import replace
from math import ceil, sqrt

import numpy as np
from numba import njit

from gpdf_service.fields.heights import add_height, clear, fit_heights, make_sums
from gpdf_service.fields.shapes import add
from gpdf_service.tiles.surface import HeightMap
from gpdf_service.types import Float32Array, FloatArray, IntArray

REACH = 11.4
"""[-] Radius of the surroundings over the noise: that of the largest neighbourhood that a point is cured by. What the
cure has blurred a step to is a slope to the next cells, but no quadric so far around."""
FLAT = 0.1
"""[-] Root mean square of what a plane or quadric leaves, over the noise, above which the ground is none: twice what
the cure leaves of a floor. With 0.2 a cave's floor had 2 mm more error at its 99 % than without, with 0.1 none."""
FINE = 0.002
"""[m] What the plane of a cell and its neighbours may leave (root mean square) where there is no noise: a sill of 1 cm
across them, or a kink of 10° between finest cells, leaves more."""
RINGS = 3
"""Cells to either side that a quadric is told by in a clean cloud: 28, so that a gap beside leaves enough."""
_OF_QUADRIC = 12
"""Cells that a quadric needs: twice its numbers, so that what is off shows."""
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


def to_centres(surface: HeightMap, off: Float32Array, noise: float = 0.0) -> HeightMap:
    """Each cell's height on the plane through its own and its neighbours' points, at the cell's centre.

    Least squares over those of the nine that differ from its own by less than a cell's width, or the noise. A step
    leaves more than `FINE` and `FLAT` σ: what is no plane stays as it is.

    The point whose height a cell has is `off` the cell's centre [m], shape (nx, ny, 2). The `noise` is the σ of the
    points before they were cured [m].
    """
    limits = max(surface.cell_width, _SAME * noise), max(FINE, FLAT * noise)
    return replace(surface, height=_onto_planes(surface.height, (off, surface.cell_width), 1, limits, rims=False))


def smooth_reach(surface: HeightMap, noise: float) -> int:
    """Cells within which heights decide on one at its cell's centre, without outliers and `with_rims`."""
    return 1 if noise == 0.0 else 2 + max(_BESIDE, ceil(REACH * noise / surface.cell_width))


def with_rims(surface: HeightMap, noise: float) -> HeightMap:
    """Each cell at a rim on the plane through the heights of its surface around it, where they are one.

    Least squares over the cells within `REACH` σ whose height is within σ of its own. A step's height is the difference
    of two rims, and at a rim half of the plane is missing: the error of a small disc's plane is largest there. What is
    at no rim stays as it is: at the foot of a ramp a plane is off by a centimetre. `noise` is the σ of the points
    before the cure [m]; 0 leaves everything as it is.
    """
    if noise == 0.0:
        return surface
    places, reach = (np.zeros((*surface.height.shape, 2), np.float32), 1.0), ceil(REACH * noise / surface.cell_width)
    return replace(
        surface, height=_onto_planes(surface.height, places, reach, (_SAME * noise, FLAT * noise), rims=True)
    )


@njit(cache=True, nogil=True)
def onto_bends(height: Float32Array, reach: int, flat: float, cells: IntArray, made: Float32Array) -> None:
    """Put flat `cells` that are not at the grid's rim onto the quadric through the others within `reach` cells.

    That is smooth ground if it leaves `flat` [m] at most (root mean square). Where they lie so much to one side that
    they tell the height no better than one of them would, it is not. `made` are the heights [m], shape (k,).
    """
    (nx, ny), sums = height.shape, make_sums()
    for n in range(len(cells)):
        i, j, base = cells[n] // ny, cells[n] % ny, float(made[n])
        if not (0 < i < nx - 1 and 0 < j < ny - 1):
            continue
        clear(sums)
        for k in range(max(i - reach, 0), min(i + reach + 1, nx)):
            for m in range(max(j - reach, 0), min(j + reach + 1, ny)):
                u, v, rise = float(k - i) / reach, float(m - j) / reach, float(height[k, m]) - base
                if u * u + v * v <= 1.0 and (k != i or m != j) and not np.isnan(rise):
                    add_height(sums, u, v, rise)
        if sums.moments[0] >= _OF_QUADRIC:
            shift, variance, rest = fit_heights(sums)
            if variance <= 1.0 and rest <= sums.moments[0] * flat * flat:
                made[n] += shift


@njit(cache=True, nogil=True)
def _onto_planes(
    height: Float32Array, places: tuple[Float32Array, float], reach: int, limits: tuple[float, float], rims: bool
) -> Float32Array:
    """See `to_centres` and `with_rims`; `places` are off their centres by so much, with cells of such a width."""
    made, sums, (off, width), (same, flat) = height.copy(), np.empty(10), places, limits
    for i in range(height.shape[0]):
        for j in range(height.shape[1]):
            if np.isnan(height[i, j]) or (rims and not _is_rim(height, i, j, same)):
                continue
            sums[:] = 0.0
            for k in range(max(i - reach, 0), min(i + reach + 1, height.shape[0])):
                for m in range(max(j - reach, 0), min(j + reach + 1, height.shape[1])):
                    x, y = (k - i) * width + off[k, m, 0], (m - j) * width + off[k, m, 1]
                    rise = float(height[k, m]) - float(height[i, j])
                    if abs(rise) <= same and (not rims or x * x + y * y <= reach * reach):  # a NaN compares false
                        add(sums, x, y, rise)
            shift, rest = _plane(sums)
            good = rest <= flat if not rims else sums[0] >= _FEWEST and (rest <= flat or abs(shift) > _ALONE * rest)
            if good:
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
def _plane(sums: FloatArray) -> tuple[float, float]:
    """Height at (0, 0) of the least-squares plane, and the root mean square about it; inf if places carry none.

    The sums are of `add`.
    """
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

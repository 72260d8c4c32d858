"""The quadric through the heights of the cells around one: what ground that goes on smoothly is there."""

from __future__ import annotations

from math import ceil

import numpy as np
from numba import njit

from gpdf_service.fields.heights import Sums, add_height, clear, fit_heights
from gpdf_service.types import Float32Array

REACH = 11.4
"""[-] Radius of the surroundings over the noise: that of the largest neighbourhood that a point is cured by. What the
cure has blurred a step to is a slope to the next cells, but no quadric so far around."""
FLAT = 0.1
"""[-] Root mean square of what a plane or quadric leaves, over the noise, above which the ground is none: twice what
the cure leaves of a floor. With 0.2 a cave's floor had 2 mm more error at its 99 % than without, with 0.1 none."""
FINE = 0.002
"""[m] What the plane of a cell and its neighbours may leave (root mean square) where there is no noise: a sill of 1 cm
across them, or a kink of 10° between finest cells, leaves more."""
_RINGS = 3
"""Cells to either side that are looked at in a clean cloud: 28, so that a gap beside leaves enough."""
_FEWEST = 12
"""Cells that a quadric needs: twice its numbers, so that what is off shows."""


def reach_of(width: float, noise: float) -> int:
    """Cells of that width [m] to either side that are looked at where the points have that noise [m]."""
    return max(_RINGS, ceil(REACH * noise / width))


@njit(cache=True, nogil=True)
def bend_at(
    height: Float32Array, i: int, j: int, reach: int, base: float, flat: float, sums: Sums
) -> tuple[float, bool]:
    """Height over `base` [m] at a cell of the quadric through the others around, and whether they are smooth ground.

    They are if it leaves `flat` [m] at most (root mean square). Where they lie so much to one side that they tell the
    height no better than one of them would, they are not.
    """
    clear(sums)
    for k in range(max(i - reach, 0), min(i + reach + 1, height.shape[0])):
        for m in range(max(j - reach, 0), min(j + reach + 1, height.shape[1])):
            rise = float(height[k, m]) - base
            u, v = float(k - i) / reach, float(m - j) / reach
            if u * u + v * v <= 1.0 and (k != i or m != j) and not np.isnan(rise):
                add_height(sums, u, v, rise)
    if sums.moments[0] < _FEWEST:
        return 0.0, False
    shift, variance, rest = fit_heights(sums)
    return shift, variance <= 1.0 and rest <= sums.moments[0] * flat * flat

"""The plane through heights of cells by least squares, from running sums: for compiled loops."""

from __future__ import annotations

from math import sqrt

import numpy as np
from numba import njit

FINE = 0.002
"""[m] What the plane of a cell and its neighbours may leave (root mean square) where there is no noise: a sill of 1 cm
across them, or a kink of 10° between finest cells, leaves more."""
FLAT = 0.1
"""[-] The same over the noise, above which the ground is no plane: twice what the cure leaves of a floor. With 0.2 a
cave's floor had 2 mm more error at its 99 % than without, with 0.1 none."""
AROUND = 5
"""Of a cell and its eight neighbours that a plane needs: two more than it has numbers, so that what is off shows."""
_ASKEW = 1e-3
"""[-] Places nearer to one line have no slope across it: their spread about it over that along it, squared."""

Sums = tuple[float, float, float, float, float, float, float, float, float, float]
"""Of 1, x, y, z, x², y², z², xy, xz, yz."""
NOTHING: Sums = (0.0,) * 10  # type: ignore[assignment]
"""Of no place."""


@njit(cache=True, nogil=True)
def add_place(sums: Sums, x: float, y: float, z: float) -> Sums:
    """The sums with one more place."""
    n, sx, sy, sz, xx, yy, zz, xy, xz, yz = sums
    n, sx, sy, sz = n + 1.0, sx + x, sy + y, sz + z
    return n, sx, sy, sz, xx + x * x, yy + y * y, zz + z * z, xy + x * y, xz + x * z, yz + y * z


@njit(cache=True, nogil=True)
def plane_of(sums: Sums, fewest: int) -> tuple[float, float]:
    """Height at (0, 0) of the least-squares plane, and the root mean square about it; inf if places carry none."""
    n, x, y, z, xx, yy, zz, xy, xz, yz = sums
    if n < fewest:
        return 0.0, np.inf
    xx, yy, zz = xx - x * x / n, yy - y * y / n, zz - z * z / n
    xy, xz, yz = xy - x * y / n, xz - x * z / n, yz - y * z / n
    whole = xx * yy - xy * xy
    if whole <= _ASKEW * xx * yy:
        return 0.0, np.inf
    slope_x, slope_y = (xz * yy - yz * xy) / whole, (yz * xx - xz * xy) / whole
    rest = max(zz - slope_x * xz - slope_y * yz, 0.0)
    return (z - slope_x * x - slope_y * y) / n, sqrt(rest / n)

"""Points whose own plane is hardly known, where the surfaces beside explain all that was measured there.

Points of a surface seen with the error σ lie about it as N(s, σ²) does. So at a place x its points s make Σ N(x; s, σ²)
expect so many measurements, and no more are due to it. Where no more were made there is nothing else, and a point goes
to where it is expected to come from, Σ N(x; s, σ²) s / Σ N(x; s, σ²). Where there were more, something else stands.
"""

from __future__ import annotations

from math import exp, pi, sqrt

import numpy as np
from numba import njit

from gpdf_service.denoise.cells import Cells, cells_within, holds_any, sort_into_cells
from gpdf_service.denoise.cloud import RESOLVED, Denoised
from gpdf_service.fields.shapes import FEWEST
from gpdf_service.fields.threads import run_chunked
from gpdf_service.types import BoolArray, FloatArray, IntArray

_RINGS = 2
"""Cells off its own in which a point's surface is looked for: 4 σ and more."""
_FURTHEST = 5.0
"""[-] Standard deviations off its surface that a point is: one in 1.7 million is further."""
_CHANCE = 3.0
"""[-] Standard errors by which what was measured at a place may exceed what is expected there."""
_SEEN = FEWEST * 2.0 * pi / (3.0 * RESOLVED) ** 2
"""Sum of exp(−r² / 2 σ²) over a plane's points, on it, at least: of the fewest in a window that show one."""
_SINGLE, _SQUARE = 2.0**-1.5, 3.0**-1.5
"""[-] What exp(−r² / 2 σ²) and its square are in the mean where N(0, σ²) puts r."""


def return_explained(points: FloatArray, part: BoolArray, cured: Denoised) -> None:
    """Put the vague points of a `part`, shape (n,), onto the surfaces that the others of it show; not where it is more.

    Args:
        points: The cloud as it was measured [m], shape (n, 3).
        part: Of it, that shows its own surfaces: what is no ground.
        cured: What was made of it; its places are changed.
    """
    rows = np.flatnonzero(part & ~cured.stray)
    vague = cured.vague[rows]
    if not vague.any():
        return
    cells = sort_into_cells(points[rows], RESOLVED * cured.measured)
    own = cells, vague, cured.measured, cured.points[rows] - cells.corner
    places = cured.points[rows]
    run_chunked(lambda a, b: _explain_range(*own, a, b, places), len(cells.key))
    cured.points[rows] = places


@njit(cache=True, nogil=True)
def _explain_range(
    cells: Cells, vague: BoolArray, sigma: float, told: FloatArray, begin: int, end: int, places: FloatArray
) -> None:
    beside, mean = np.empty((2 * _RINGS + 1) ** 3, np.int64), np.empty(3)
    for c in range(begin, end):
        if not holds_any(cells, c, vague):
            continue
        count = cells_within(cells, c, _RINGS, beside)
        for i in range(cells.begin[c], cells.begin[c + 1]):
            row = cells.order[i]
            if vague[row] and _is_explained(cells, beside[:count], i, vague, sigma, told, mean):
                for k in range(3):
                    places[row, k] = mean[k] + cells.corner[k]


@njit(cache=True, nogil=True)
def _is_explained(
    cells: Cells, beside: IntArray, i: int, vague: BoolArray, sigma: float, told: FloatArray, mean: FloatArray
) -> bool:
    """Whether the surfaces `told` explain what is at place i; writes where it is expected to come from."""
    measured, expected, variance, total = 0.0, 0.0, 0.0, 0.0
    mean[:] = 0.0
    x, y, z = cells.places[i]
    scale = -0.5 / sigma**2
    for j in beside:
        for k in range(cells.begin[j], cells.begin[j + 1]):
            p = cells.places[k]
            if k != i:
                measured += exp(scale * ((p[0] - x) ** 2 + (p[1] - y) ** 2 + (p[2] - z) ** 2))
            row = cells.order[k]
            if vague[row]:
                continue
            s = told[row]
            a, b, d = s[0] - x, s[1] - y, s[2] - z
            square = scale * (a * a + b * b + d * d)
            weight = exp(square)
            expected += _SINGLE * exp(0.5 * square)
            variance += _SQUARE * exp(square / 1.5)
            total += weight
            mean[0] += weight * s[0]
            mean[1] += weight * s[1]
            mean[2] += weight * s[2]
    if total < 1e-9 or measured > expected + _CHANCE * sqrt(variance):
        return False
    mean /= total
    off = (mean[0] - x) ** 2 + (mean[1] - y) ** 2 + (mean[2] - z) ** 2
    return bool(off <= (_FURTHEST * sigma) ** 2 and total >= _SEEN * exp(scale * off))

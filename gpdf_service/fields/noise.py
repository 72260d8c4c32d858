"""How noisy a cloud is, told from the shape of what it shows."""

from __future__ import annotations

from math import sqrt

import numpy as np
from numba import njit

from gpdf_service.fields.edge import fit_pair
from gpdf_service.fields.heights import quadric_rest
from gpdf_service.fields.shapes import MOST, fit_axis, fit_plane, fit_ring, gather, split_sheets, sum_rings
from gpdf_service.fields.threads import run_chunked
from gpdf_service.fields.tree import Tree, build_tree
from gpdf_service.types import FloatArray

GROWTH = 1.3
"""[-] Each radius over the one before."""
LONG = 6.0
"""[-] Ratio of two variances at which a neighbourhood is a line."""
_WIDE = 4.0
"""[-] Ratio of two variances at which it is a plane: twice as wide as it is thick."""
_TOLD = 16
"""Neighbours that tell a shape: of fewer, one in ten of a ball looks like a plane."""
EDGE = 0.6
"""[-] Variance about two half planes over that about a quadric, below which it is an edge; noise alone gives 0.75."""
_SHEETS = 0.2
"""[-] Variance within two sheets over that of one, below which they are two; noise alone gives 0.36."""
_AT_ONCE = 4
"""Radii that are looked at in one walk: most places are told by the first four."""
_SAMPLE = 1000
"""Points that the noise is estimated from: its error is then some per cent."""


def estimate_noise(points: FloatArray, spacing: float, *, sheets: bool = True, tree: Tree | None = None) -> float:
    """Standard deviation of the points along the surface's normal [m]; points of shape (n, 3).

    What is left of the smallest neighbourhood that shows its shape: a plane, an edge, two sheets or a pole. So the
    corners of a clean cloud are no noise, nor is the thickness of a board. A cloud so dense that most
    such neighbourhoods hold more points than are looked at is thinned first.

    Args:
        points: The cloud [m].
        spacing: Between its points [m].
        sheets: Whether two sheets on each other can both be there.
        tree: Over the points, where there is one.
    """
    if len(points) < _TOLD or spacing <= 0.0:
        return 0.0
    rng = np.random.default_rng(0)
    picked = points[rng.choice(len(points), min(_SAMPLE, len(points)), replace=False)]
    noise = np.full(len(picked), np.nan)
    radii: FloatArray = 2.0 * spacing * GROWTH ** np.arange(16.0)
    tree = build_tree(points) if tree is None else tree
    run_chunked(lambda a, b: _noise_range(tree, picked, a, b, radii, sheets, noise), len(picked))
    found = noise[np.isfinite(noise)]
    if np.isinf(noise).sum() > len(found):
        thinner = rng.choice(points, len(points) // 4, replace=False)
        return estimate_noise(thinner, 2.0 * spacing, sheets=sheets)
    return float(np.quantile(found, 0.25)) if len(found) else 0.0


@njit(cache=True, nogil=True)
def _lower(freedom: float) -> float:
    """Lower quartile of χ²/ν with ν degrees of freedom; Wilson and Hilferty 1931."""
    part = 2.0 / (9.0 * freedom)
    return (1.0 - part - 0.674 * sqrt(part)) ** 3


@njit(cache=True, nogil=True)
def _noise_range(
    tree: Tree, places: FloatArray, begin: int, end: int, radii: FloatArray, sheets: bool, noise: FloatArray
) -> None:
    """The larger radii are looked at only where the smaller ones do not tell: they hold most of the points.

    `noise`, NaN before, stays so where no radius tells, and is inf where the next one holds too many points.
    """
    moments, mean, normal, near = np.zeros((len(radii), 10)), np.zeros(3), np.zeros(3), np.zeros((MOST, 3))
    side, pair = np.zeros(MOST, np.int64), np.zeros((3, 9))
    for i in range(begin, end):
        first, wide = 0, 0
        while first < len(radii) and np.isnan(noise[i]):
            last = min(first + _AT_ONCE, len(radii))
            sum_rings(tree, places[i], radii[:last], normal * 0.0, 0.0, moments[:last])
            for j in range(first, last):
                count = moments[j, 0]
                if count < _TOLD:
                    continue
                if count > MOST:
                    noise[i] = np.inf
                    break
                low, middle, high = fit_plane(moments[j], mean, normal)
                wide = wide + 1 if middle > _WIDE * low else 0
                if wide == 2:
                    found = gather(tree, places[i], radii[j], near)
                    variance = quadric_rest(near, found, normal) / (count - 6.0)
                    edge = fit_pair(near, found, normal, side, pair) / (count - 6.0)
                    if edge < EDGE * variance:
                        variance = edge
                    within = split_sheets(near, found, normal, mean) if sheets else np.inf
                    if within < _SHEETS * low:
                        variance = min(variance, within)
                    noise[i] = sqrt(variance / _lower(count - 6.0))
                    break
                if high > LONG * middle:
                    found = gather(tree, places[i], radii[j], near)
                    fit_axis(moments[j], high, normal)
                    noise[i] = sqrt(fit_ring(near, found, mean, normal)[1] / _lower(count - 6.0))
                    break
            first = last

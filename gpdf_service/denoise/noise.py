"""How noisy a cloud is, told from the shape of what it shows."""

from __future__ import annotations

from math import sqrt

import numpy as np
from numba import njit

from gpdf_service.fields.heights import fit_heights, make_sums, quadric_rest, sum_heights
from gpdf_service.fields.shapes import (
    EDGE,
    MOST,
    fit_axis,
    fit_pair,
    fit_plane,
    fit_ring,
    gather,
    split_sheets,
    sum_rings,
)
from gpdf_service.fields.threads import run_chunked
from gpdf_service.fields.tree import Tree, build_tree, make_look
from gpdf_service.types import FloatArray

GROWTH = 1.3
"""[-] Each radius over the one before."""
LONG = 6.0
"""[-] Ratio of two variances at which a neighbourhood is a line."""
_WIDE = 4.0
"""[-] Ratio of two variances at which it is a plane: twice as wide as it is thick."""
_TOLD = 16
"""Neighbours that tell a shape: of fewer, one in ten of a ball looks like a plane."""
_SHEETS = 0.2
"""[-] Variance within two sheets over that of one, below which they are two; noise alone gives 0.36."""
_LARGER = 1.7
"""[-] Radius of the larger neighbourhood over that of the smallest that shows its shape: three times the area."""
_ALIKE = 1.5
"""[-] Variance about a quadric in the larger one over that in the smaller from which on it is relief: what bends leaves
1.7⁶ times as much, noise 1 ± 0.3, so that one place in twenty of it is lost."""
_CHANCE = 0.1
"""[-] Places that tell, over those whose neighbourhood holds too many points, below which the former may be chance: of
noise that is wide against the spacing one place in eighty looks like a plane, and too thin."""
_AT_ONCE = 4
"""Radii that are looked at in one walk: most places are told by the first four."""
PLACES = 1000
"""Points that the noise is estimated from: its error is then some per cent."""


def estimate_noise(
    points: FloatArray, spacing: float, *, sheets: bool = True, tree: Tree | None = None, places: int = PLACES
) -> float:
    """Standard deviation of the points along the surface's normal [m]; points of shape (n, 3).

    What is left of the smallest neighbourhood that shows its shape: a plane, an edge, two sheets or a pole. So the
    corners of a clean cloud are no noise, nor is the thickness of a board. A place shows noise where a quadric leaves
    no more of a larger neighbourhood: what bends, or is rough, leaves more. Noise need not be the same everywhere (a
    beam's is along the beam: all of it where a scanner looks straight onto a floor, little where it grazes one), so it
    is that of the upper quartile of these places. Where they are not most of all, relief may pass for noise, and it
    is that of the lower quartile of all. A cloud so dense that nearly all such neighbourhoods hold more points than are
    looked at is thinned first; no further, for what is crowded (leaves, shelves) shows its own size at last, and that
    is no noise.

    The points lie `spacing` [m] apart, in a `tree` where there is one. So many `places` of them are looked at. Whether
    two `sheets` on each other can both be there is told.
    """
    if len(points) < _TOLD or spacing <= 0.0:
        return 0.0
    rng = np.random.default_rng(0)
    picked = points[rng.choice(len(points), min(places, len(points)), replace=False)]
    rest, shown = np.full((2, len(picked)), np.nan)
    radii: FloatArray = 2.0 * spacing * GROWTH ** np.arange(16.0)
    tree = build_tree(points) if tree is None else tree
    run_chunked(lambda a, b: _noise_range(tree, picked[a:b], radii, sheets, rest[a:b], shown[a:b]), len(picked))
    told, sure = rest[np.isfinite(rest)], shown[np.isfinite(shown)]
    if len(told) < _CHANCE * np.isinf(rest).sum():
        thinner = rng.choice(points, len(points) // 4, replace=False)
        return estimate_noise(thinner, 2.0 * spacing, sheets=sheets, places=places)
    if 2 * len(sure) > len(told):
        return float(np.quantile(sure, 0.75))
    return float(np.quantile(told, 0.25)) if len(told) else 0.0


@njit(cache=True, nogil=True)
def _quartile(freedom: float, side: float) -> float:
    """Lower (`side` −1) or upper (1) quartile of χ²/ν with ν degrees of freedom; Wilson and Hilferty 1931."""
    part = 2.0 / (9.0 * freedom)
    return (1.0 - part + side * 0.674 * sqrt(part)) ** 3


@njit(cache=True, nogil=True)
def _unclipped(deviation: float, radius: float) -> float:
    """Deviation σ off a plane [m] by that in a ball of `radius` r, which leaves of σ² 1 − 2 / (r² / σ² − 1)."""
    q = min((deviation / radius) ** 2, 0.1)
    return radius * sqrt((1.0 + q - sqrt((1.0 + q) ** 2 - 12.0 * q)) / 6.0)


@njit(cache=True, nogil=True)
def _noise_range(
    tree: Tree, places: FloatArray, radii: FloatArray, sheets: bool, rest: FloatArray, shown: FloatArray
) -> None:
    """Write the `rest`, inf where the next radius holds too many points, and what is `shown` to be noise; NaN stays.

    Each is such that its quartile is the deviation [m]. Larger radii, which hold most points, are asked last.
    """
    moments, mean, normal, near = np.zeros((len(radii), 10)), np.zeros(3), np.zeros(3), np.zeros((MOST, 3))
    side, pair, sums, look = np.zeros(MOST, np.int64), np.zeros((3, 9)), make_sums(), make_look()
    for i in range(len(places)):
        first, wide = 0, 0
        while first < len(radii) and np.isnan(rest[i]):
            last = min(first + _AT_ONCE, len(radii))
            sum_rings(tree, places[i], radii[:last], moments[:last], look)
            for j in range(first, last):
                count = moments[j, 0]
                if count < _TOLD:
                    continue
                if count > MOST:
                    rest[i] = np.inf
                    break
                low, middle, high = fit_plane(moments[j], mean, normal)
                wide = wide + 1 if middle > _WIDE * low else 0
                if wide == 2:
                    found = gather(tree, places[i], radii[j], near, look)
                    variance = quadric_rest(near, found, normal, sums) / (count - 6.0)
                    edge = fit_pair(near, found, normal, side, pair) / (count - 6.0)
                    if edge < EDGE * variance:
                        variance = edge
                    within = split_sheets(near, found, normal, mean) if sheets else np.inf
                    if within < _SHEETS * low:
                        variance = min(variance, within)
                    deviation = _unclipped(sqrt(variance), radii[j])
                    rest[i] = deviation / sqrt(_quartile(count - 6.0, -1.0))
                    sum_heights(tree, places[i], normal, _LARGER * radii[j], sums, look)
                    if fit_heights(sums)[2] < _ALIKE * variance * (sums.moments[0] - 6.0):
                        shown[i] = deviation / sqrt(_quartile(count - 6.0, 1.0))
                    break
                if high > LONG * middle:
                    found = gather(tree, places[i], radii[j], near, look)
                    fit_axis(moments[j], high, normal)
                    rest[i] = sqrt(fit_ring(near, found, mean, normal)[1] / _quartile(count - 6.0, -1.0))
                    break
            first = last

"""Points moved onto the surface that they were measured on: local planes, each as large as the surface lets it be.

A Gaussian error of 5 cm biases a distance field by −14 cm at 2 m above a floor: the highest outliers are nearest.
No margin cures that, so the points are cured first. Every point is moved along its normal onto a plane through its
neighbours, and the radius of the neighbourhood is chosen for each point by the intersection of confidence intervals
(Goldenshluger and Nemirovski 1997; Katkovnik 1999): it grows while the planes agree with each other within their
errors, and stops where the surface bends or ends. Lines and scattered points have no plane and stay where they are.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
from numba import njit
from scipy.spatial import cKDTree

from gpdf_service.fields.noise import GROWTH, LONG, estimate_noise
from gpdf_service.fields.order import spatial_order
from gpdf_service.fields.shapes import FEWEST, fit_plane, sum_rings
from gpdf_service.fields.spacing import estimate_spacing
from gpdf_service.fields.threads import run_chunked
from gpdf_service.fields.tree import Tree, build_tree
from gpdf_service.types import BoolArray, FloatArray, IntArray

RESOLVED = 4.0
"""[-] Least radius of a neighbourhood over the noise: a disc of 4 σ is then twice as wide as it is thick (standard
deviations), and a point 3 σ off the surface still sees it."""
_SCALES = 5
"""Radii tried: 4 σ to 11 σ."""
_FIRST_SCALES = 3
"""Radii of all passes but the last: they only have to find the surface."""
_AGREE = 1.0
"""[-] Half width of a confidence interval in standard errors: twice it lets twice the bias pass on a ball."""
_BIAS = 2.5
"""[-] Standard deviation left over the standard error of the plane: where the surface bends, the bias grows by the
square of the radius, so planes that agree within one error each may both be off by five; two deviations cover that."""
_CLEARLY = 2.5
"""[-] Ratio of two variances at which a neighbourhood is wider than thick."""
_EXTREME = 1.5
"""[-] Standard deviation of a point that was not moved over the noise: the nearest of many is an extreme one."""
_FAR = 4.0
"""[-] Standard deviations: a point further off a plane is not of it, whatever it is."""
_SLAB = 3.5
"""[-] Standard deviations to either side of a point that its surface is looked for in, once its normal is known: what
is further off is another surface."""
_PASSES = 3
"""The first pass brings an outlier near the surface; only there is its neighbourhood round and its plane unbiased."""
_ENOUGH = 600
"""Neighbours within the largest radius after which more only cost time: the error is then a twentieth of the noise."""
_NEGLIGIBLE = 0.02
"""[-] Noise over spacing below which the gaps between the points hide it."""


class Cured(NamedTuple):
    """Points on the surface.

    Attributes:
        points: [m], shape (n, 3), in the order of the input.
        noise: Standard deviation left along the normal [m], shape (n,).
        stray: Points of no surface: alone where their surroundings are well sampled, shape (n,).
        measured: Standard deviation of the input along the normal [m].
    """

    points: FloatArray
    noise: FloatArray
    stray: BoolArray
    measured: float


def uncured(points: FloatArray, noise: float) -> Cured:
    """Points as they are, shape (n, 3), with the noise that they have [m]."""
    return Cured(points, np.full(len(points), noise), np.zeros(len(points), dtype=bool), noise)


def denoise(points: FloatArray, spacing: float | None = None, *, level: bool = False) -> Cured:
    """Move every point of `points`, shape (n, 3) [m], onto the surface around it; `spacing` is estimated if not given.

    Two parallel sheets nearer to each other than four times the noise become one.

    Args:
        points: [m], shape (n, 3).
        spacing: Between neighbours on a surface [m]; estimated when not given.
        level: Whether the surface is known to be more level than upright, as ground is: its steps then stay sharp.
    """
    spacing = estimate_spacing(points) if spacing is None else spacing
    noise = estimate_noise(points, spacing)
    if noise <= _NEGLIGIBLE * spacing:
        return uncured(points, noise)
    least = max(RESOLVED * noise, 3.0 * spacing)
    radii: FloatArray = least * GROWTH ** np.arange(float(_SCALES))
    expected = np.pi * (radii[-1] / spacing) ** 2
    support = points
    if expected > _ENOUGH:
        share = max(_ENOUGH / expected, FEWEST / (np.pi * (least / spacing) ** 2))
        support = points[np.random.default_rng(0).random(len(points)) < share]
    tree = build_tree(support)
    moved, left = points.copy(), np.full(len(points), _EXTREME * noise)

    normals = np.zeros_like(points)
    normals[:, 2] = float(level)

    order = spatial_order(points)

    def project(scales: FloatArray) -> None:
        centre = moved.copy()
        run_chunked(
            lambda a, b: _project_range(tree, centre, order[a:b], scales, noise, moved, left, normals), len(order)
        )

    for _ in range(_PASSES - 1):
        project(radii[:_FIRST_SCALES])
    project(radii)
    return Cured(moved, left, find_loose(moved, noise, spacing), noise)


def find_loose(points: FloatArray, noise: float, spacing: float) -> BoolArray:
    """Points of no surface, shape (n,): fewer than two others beside, though a well-sampled surface is near.

    Beside is two deviations of the noise, or two spacings; near is three times that. A pole or a cable is many such
    points together, and where the scan is thin nothing says that a point is wrong.

    Args:
        points: All points, cured [m], shape (n, 3); a part of them would make strays of what stands on the other part.
        noise: Standard deviation before the cure [m].
        spacing: Between neighbours on a surface [m].
    """
    radius = max(0.5 * RESOLVED * noise, 2.0 * spacing)
    stray = np.zeros(len(points), dtype=bool)
    if len(points) <= FEWEST:
        return stray
    tree = cKDTree(points)
    third = tree.query(points, k=3, distance_upper_bound=radius, workers=-1)[0][:, 2]
    alone = np.flatnonzero(~np.isfinite(third))
    if len(alone):
        stray[alone] = tree.query(points[alone], k=FEWEST + 1, workers=-1)[0][:, -1] <= 3.0 * radius
    return stray


@njit(cache=True, nogil=True)
def _project_range(
    tree: Tree,
    points: FloatArray,
    rows: IntArray,
    radii: FloatArray,
    sigma: float,
    moved: FloatArray,
    left: FloatArray,
    normals: FloatArray,
) -> None:
    moments, mean, normal, first = np.zeros((len(radii), 10)), np.zeros(3), np.zeros(3), np.zeros(3)
    for i in rows:
        sum_rings(tree, points[i], radii, normals[i], _SLAB * sigma, moments)
        low_end, high_end, chosen = -np.inf, np.inf, -1
        for j in range(len(radii)):
            count = moments[j, 0]
            if count < FEWEST:
                continue
            low, middle, high = fit_plane(moments[j], mean, normal)
            if middle <= _CLEARLY * low:
                if chosen >= 0 or high > LONG * middle:  # a pole or a cable stays as it is
                    break
                continue
            if chosen < 0:
                first[:] = normal
            slant = first[0] * normal[0] + first[1] * normal[1] + first[2] * normal[2]
            if abs(slant) < 0.5:  # the planes are 60° apart: another surface
                break
            across = mean[0] * normal[0] + mean[1] * normal[1] + mean[2] * normal[2]
            aside = max(mean[0] ** 2 + mean[1] ** 2 + mean[2] ** 2 - across * across, 0.0)
            error = sigma * sqrt((1.0 + aside / middle) / count)
            shift = across / slant
            if abs(shift) > _FAR * sigma:  # not a point of that plane
                break
            low_end, high_end = max(low_end, shift - _AGREE * error), min(high_end, shift + _AGREE * error)
            if low_end > high_end:
                break
            chosen = j
            for k in range(3):
                moved[i, k] = points[i, k] + shift * first[k]
            left[i] = _BIAS * error
        if chosen >= 0:
            normals[i] = first

"""Points moved onto the surface that they were measured on: local planes, each as large as the surface lets it be.

A Gaussian error of 5 cm biases a distance field by −14 cm at 2 m above a floor: the highest outliers are nearest.
No margin cures that, so the points are cured first. Every point is moved along its normal onto a plane through its
neighbours, and the radius of the neighbourhood is chosen for each point by the intersection of confidence intervals
(Goldenshluger and Nemirovski 1997; Katkovnik 1999): it grows while the planes agree with each other within their
errors, and stops where the surface bends or ends. Lines and scattered points have no plane and stay where they are.
"""

from __future__ import annotations

from math import acos, cos, pi, sqrt
from typing import NamedTuple

import numpy as np
from numba import njit
from scipy.spatial import cKDTree

from gpdf_service.fields.order import spatial_order
from gpdf_service.fields.spacing import estimate_spacing
from gpdf_service.fields.threads import run_chunked
from gpdf_service.fields.tree import Tree, build_tree, from_root, make_scratch, next_leaf, place_of
from gpdf_service.types import BoolArray, FloatArray, IntArray

RESOLVED = 4.0
"""[-] Least radius of a neighbourhood over the noise: a disc of 4 σ is then twice as wide as it is thick (standard
deviations), and a point 3 σ off the surface still sees it."""
_GROWTH = 1.3
"""[-] Each radius over the one before."""
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
_LONG = 6.0
"""[-] Ratio of two variances at which it is a line: eight points of a disc have that ratio in 1 % of cases."""
_FAR = 4.0
"""[-] Standard deviations: a point further off a plane is not of it, whatever it is."""
_SLAB = 3.5
"""[-] Standard deviations to either side of a point that its surface is looked for in, once its normal is known: what
is further off is another surface."""
_PASSES = 3
"""The first pass brings an outlier near the surface; only there is its neighbourhood round and its plane unbiased."""
_FEWEST = 8
"""Neighbours that a plane needs: three fix it, the others say how well."""
_ENOUGH = 600
"""Neighbours within the largest radius after which more only cost time: the error is then a twentieth of the noise."""
_NEGLIGIBLE = 0.02
"""[-] Noise over spacing below which the gaps between the points hide it."""
_SAMPLE = 1000
"""Points that the noise is estimated from: its error is then some per cent."""


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


def estimate_noise(points: FloatArray, spacing: float) -> float:
    """Standard deviation of the points along the surface's normal [m]; points of shape (n, 3).

    The thickness of the smallest neighbourhood that is clearly a plane: twice as wide as it is thick.
    """
    if len(points) < _FEWEST or spacing <= 0.0:
        return 0.0
    rng = np.random.default_rng(0)
    picked = points[rng.choice(len(points), min(_SAMPLE, len(points)), replace=False)]
    thickness = np.full(len(picked), np.nan)
    radii: FloatArray = 2.0 * spacing * _GROWTH ** np.arange(16.0)
    tree = build_tree(points)
    run_chunked(lambda a, b: _thickness_range(tree, picked, a, b, radii, thickness), len(picked))
    found = thickness[np.isfinite(thickness)]
    return float(np.median(found)) if len(found) else 0.0


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
    radii: FloatArray = least * _GROWTH ** np.arange(float(_SCALES))
    expected = np.pi * (radii[-1] / spacing) ** 2
    support = points
    if expected > _ENOUGH:
        share = max(_ENOUGH / expected, _FEWEST / (np.pi * (least / spacing) ** 2))
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
    if len(points) <= _FEWEST:
        return stray
    tree = cKDTree(points)
    third = tree.query(points, k=3, distance_upper_bound=radius, workers=-1)[0][:, 2]
    alone = np.flatnonzero(~np.isfinite(third))
    if len(alone):
        stray[alone] = tree.query(points[alone], k=_FEWEST + 1, workers=-1)[0][:, -1] <= 3.0 * radius
    return stray


@njit(cache=True, nogil=True)
def _gather(tree: Tree, x: FloatArray, radii: FloatArray, normal: FloatArray, half: float, moments: FloatArray) -> None:
    """Sums over the neighbours within each radius, shape (scales, 10): 1, the offset from x and its products.

    Of the neighbours only those in the slab around x across `normal`, `half` [m] to either side; all if it is zero.
    """
    blocks, boxes, limit = tree.blocks, tree.boxes, radii[-1] ** 2
    stack, bound, near = make_scratch()
    moments[:] = 0.0
    place = place_of(x)
    top = from_root(stack, bound)
    while True:
        leaf, _, top = next_leaf(boxes, place, place, limit, stack, bound, near, top)
        if leaf < 0:
            break
        for j in range(tree.begin[leaf + 1] - tree.begin[leaf]):
            a, b, c = blocks[leaf, 0, j] - x[0], blocks[leaf, 1, j] - x[1], blocks[leaf, 2, j] - x[2]
            square = a * a + b * b + c * c
            if square > limit or abs(a * normal[0] + b * normal[1] + c * normal[2]) > half:
                continue
            ring = 0
            while square > radii[ring] ** 2:
                ring += 1
            m = moments[ring]
            m[0] += 1.0
            m[1] += a
            m[2] += b
            m[3] += c
            m[4] += a * a
            m[5] += b * b
            m[6] += c * c
            m[7] += a * b
            m[8] += a * c
            m[9] += b * c
    for ring in range(1, len(radii)):
        moments[ring] += moments[ring - 1]


@njit(cache=True, nogil=True)
def _plane(m: FloatArray, mean: FloatArray, normal: FloatArray) -> tuple[float, float, float]:
    """Eigenvalues of the covariance, ascending; writes the mean offset and the direction of least spread.

    Closed form for a symmetric 3 × 3 matrix; Smith 1961.
    """
    n = m[0]
    for k in range(3):
        mean[k] = m[1 + k] / n
    xx, yy, zz = m[4] / n - mean[0] ** 2, m[5] / n - mean[1] ** 2, m[6] / n - mean[2] ** 2
    xy, xz, yz = m[7] / n - mean[0] * mean[1], m[8] / n - mean[0] * mean[2], m[9] / n - mean[1] * mean[2]
    q = (xx + yy + zz) / 3.0
    off = xy * xy + xz * xz + yz * yz
    p = sqrt(max(((xx - q) ** 2 + (yy - q) ** 2 + (zz - q) ** 2 + 2.0 * off) / 6.0, 1e-300))
    a, b, c, d, e, f = (xx - q) / p, (yy - q) / p, (zz - q) / p, xy / p, xz / p, yz / p
    half = (a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e)) / 2.0
    angle = acos(min(max(half, -1.0), 1.0)) / 3.0
    high = q + 2.0 * p * cos(angle)
    low = q + 2.0 * p * cos(angle + 2.0 * pi / 3.0)
    # The rows of A − λ I span what is normal to the eigenvector: their longest cross product is it.
    rows = ((xx - low, xy, xz), (xy, yy - low, yz), (xz, yz, zz - low))
    best = 0.0
    for i in range(3):
        u, v = rows[i], rows[(i + 1) % 3]
        cx, cy, cz = u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]
        length = cx * cx + cy * cy + cz * cz
        if length > best:
            best = length
            length = sqrt(length)
            normal[0], normal[1], normal[2] = cx / length, cy / length, cz / length
    if best == 0.0:
        normal[0], normal[1], normal[2] = 0.0, 0.0, 1.0
    return max(low, 0.0), 3.0 * q - high - low, high


@njit(cache=True, nogil=True)
def _thickness_range(
    tree: Tree, places: FloatArray, begin: int, end: int, radii: FloatArray, thickness: FloatArray
) -> None:
    moments, mean, normal = np.zeros((len(radii), 10)), np.zeros(3), np.zeros(3)
    for i in range(begin, end):
        _gather(tree, places[i], radii, normal * 0.0, 0.0, moments)
        for j in range(len(radii)):
            if moments[j, 0] < _FEWEST:
                continue
            low, middle, _ = _plane(moments[j], mean, normal)
            if middle > 4.0 * low:
                thickness[i] = sqrt(low * moments[j, 0] / (moments[j, 0] - 3.0))
                break


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
        _gather(tree, points[i], radii, normals[i], _SLAB * sigma, moments)
        low_end, high_end, chosen = -np.inf, np.inf, -1
        for j in range(len(radii)):
            count = moments[j, 0]
            if count < _FEWEST:
                continue
            low, middle, high = _plane(moments[j], mean, normal)
            if middle <= _CLEARLY * low:
                if chosen >= 0 or high > _LONG * middle:  # a pole or a cable stays as it is
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

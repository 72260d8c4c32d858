"""Points moved onto the surface that they were measured on: a plane, a quadric, an edge or a pole at each place.

A Gaussian error of 5 cm biases a distance field by −14 cm at 2 m above a floor: the highest outliers are nearest.
No margin cures that, so the points are cured first. A shape is taken only if what it leaves is no more than the noise,
and a richer one only if it explains clearly more. The radius of a plane or quadric is chosen for each point by the
intersection of confidence intervals (Goldenshluger and Nemirovski 1997; Katkovnik 1999): it grows while the surfaces
agree within their errors. What is none of these stays as it is: thicker by its noise, on the safe side.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
from numba import njit
from scipy.spatial import cKDTree

from gpdf_service.fields.edge import fit_pair, nearest_half, onto_half
from gpdf_service.fields.heights import Sums, fit_heights, make_sums, quadric_rest, sum_heights
from gpdf_service.fields.noise import GROWTH, LONG, estimate_noise
from gpdf_service.fields.order import spatial_order
from gpdf_service.fields.rests import EXTREME, FAR, beside_surface, follow_nearest, settle_rests
from gpdf_service.fields.shapes import FEWEST, MOST, fit_axis, fit_plane, fit_ring, gather, sum_rings
from gpdf_service.fields.spacing import estimate_spacing
from gpdf_service.fields.threads import run_chunked
from gpdf_service.fields.tree import Look, Tree, build_tree, make_look
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
_BIAS = 3.0
"""[-] Standard deviation left over the standard error of the plane: where the surface bends, the bias grows by the
square of the radius, so planes that agree within one error each may both be off by five; two deviations cover that."""
_CLEARLY = 2.5
"""[-] Ratio of two variances at which a neighbourhood is wider than thick."""
_SLAB = 3.5
"""[-] Standard deviations to either side of a point that its surface is looked for in, once its normal is known: what
is further off is another surface."""
_PASSES = 2
"""The first pass brings an outlier near the surface; only there is its neighbourhood round and its plane unbiased."""
_ENOUGH = 600
"""Neighbours within the largest radius after which more only cost time: the error is then a twentieth of the noise."""
_CLOSE = 300
"""Neighbours within the smallest radius that tell an edge from a bend."""
_CURVED = 12.0
"""[-] Squares that a richer shape takes off those of a plainer one, over the variance: 99 % of planes stay below."""
_SPLIT = 1.0 / 3.0
"""[-] Squares a point, over the variance, that two half planes take off one sheet of noise because each point goes to
the nearer one: 0.25 in 99 of 100 planes of 120 points, half of them in a right angle. A floor so split has a step."""
_THICK = 2.5
"""[-] Standard errors by which the variance about a shape may exceed the noise's: more, and it is another shape."""
HIDDEN = 0.6
"""[-] Least standard deviation left over the noise: relief within it passes for noise. The tips of a stair that looks
like a ramp with 4/3 of the true noise are 1.15 of it off that ramp, the faces of a board less."""
_LENGTH = 2.0
"""[-] Ratio of two variances at which the axis of a pole is known: a ring then has to explain the rest."""
_SURE = 2.0
"""[-] Standard errors to the safe side that a pole's radius is taken at: it is the only shape that can shrink."""
_WITNESSES = 24
"""Points beside one that say whether they are a thing: by then it shows from one standard deviation on."""
_SEED = 8_128
"""Of the points that are left out: another one than synthetic clouds are made with, or the choice follows the shape."""
_NEGLIGIBLE = 0.05
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


def denoise(points: FloatArray) -> Cured:
    """Move every point of `points`, shape (n, 3) [m], onto the surface around it, and find those of no surface.

    Two parallel sheets nearer to each other than four times the noise become one.
    """
    spacing = estimate_spacing(points)
    noise = estimate_noise(points, spacing)
    if noise <= _NEGLIGIBLE * spacing:
        return uncured(points, noise)
    moved, left = onto_surface(points, spacing, noise)
    return Cured(moved, left, find_loose(moved, noise, spacing), noise)


def onto_surface(
    points: FloatArray, spacing: float, noise: float, *, level: bool = False, things: bool = False
) -> tuple[FloatArray, FloatArray]:
    """Points on the surface [m], shape (n, 3), and the standard deviation left [m], shape (n,).

    Args:
        points: [m], shape (n, 3).
        spacing: Between neighbours on a surface [m].
        noise: Standard deviation of the points [m].
        level: Whether the surface is known to be more level than upright, as ground is: its steps then stay sharp.
        things: Whether these are things without ground: what no shape explains then goes to the mean of what is beside,
            and not onto its plane, if the noise is wide enough to hold several points. On a floor such means are steps.
    """
    least = max(RESOLVED * noise, 3.0 * spacing)
    radii: FloatArray = least * GROWTH ** np.arange(float(_SCALES))
    wide = build_tree(points[_pick(len(points), spacing, radii[-1], _ENOUGH)])
    picked = _pick(len(points), spacing, radii[0], _CLOSE)
    close = build_tree(points[picked])
    normals = np.zeros_like(points)
    normals[:, 2] = float(level)
    order = spatial_order(points)
    centre = points.copy()
    for _ in range(_PASSES):
        before = centre.copy()
        run_chunked(
            lambda a, b: _approach_range(wide, before, order[a:b], radii[:_FIRST_SCALES], noise, centre, normals),  # noqa: B023
            len(order),
        )
    moved, left = points.copy(), np.full(len(points), EXTREME * noise)

    def settle(rows: IntArray) -> None:
        run_chunked(
            lambda a, b: _settle_range(wide, close, points, centre, rows[a:b], radii, noise, normals, moved, left),
            len(rows),
        )

    settle(order)
    if not things or noise < spacing:
        follow_nearest(points, moved, left, normals, noise, spacing)
    else:  # once more from where its surface is: one in a hundred is too far off to see it
        _, rows, nearest, place = beside_surface(points, moved, left, normals, noise, spacing)
        centre[rows], normals[rows] = place, normals[nearest]
        moved[rows], left[rows] = points[rows], EXTREME * noise
        settle(rows)
        settle_rests(points, moved, left, normals, noise, spacing, picked)
    return moved, np.maximum(left, HIDDEN * noise)


def _pick(number: int, spacing: float, radius: float, count: int) -> BoolArray:
    """As many of `number` points of a surface as leave about `count` within `radius` [m], shape (number,)."""
    share = count / (np.pi * (radius / spacing) ** 2)
    picked: BoolArray = np.random.default_rng(_SEED).random(number) < share
    return picked


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


def find_lifted(points: FloatArray, ground: BoolArray, noise: float, spacing: float) -> BoolArray:
    """Points that noise can have lifted off the `ground`, shape (n,), or sunk under it.

    In a million points of a floor a thousand are more than three deviations off it. But they are alone, or as often
    under it as over it: a thing is where the mean height of those beside is more than it can be by chance. Beside is as
    in `find_loose`. What has no ground right under it was not lifted off any: on the flank of a rock it is beside it.

    Args:
        points: Cured [m], shape (n, 3), z up.
        ground: Which of them are ground, shape (n,).
        noise: Standard deviation before the cure [m].
        spacing: Between neighbours on a surface [m].
    """
    lifted, rest = np.zeros(len(points), dtype=bool), np.flatnonzero(~ground)
    if len(rest) == 0 or len(rest) == len(points):
        return lifted
    floor, near = points[ground], FAR * noise + spacing
    off, nearest = cKDTree(floor).query(points[rest], distance_upper_bound=near, workers=-1)
    apart = points[rest] - floor[np.minimum(nearest, len(floor) - 1)]
    low = np.flatnonzero(np.isfinite(off) & (np.hypot(apart[:, 0], apart[:, 1]) <= spacing))
    height = np.full(len(rest) + 1, near)  # of what has no ground under it: it is no noise, but a witness
    height[low] = apart[low, 2]
    height[-1] = 0.0  # of nothing beside
    radius = max(0.5 * RESOLVED * noise, 2.0 * spacing)
    beside = cKDTree(points[rest]).query(points[rest[low]], k=_WITNESSES, distance_upper_bound=radius, workers=-1)[1]
    number = (beside < len(rest)).sum(axis=1)
    lifted[rest[low]] = np.abs(height[beside].sum(axis=1)) <= FAR * noise * np.sqrt(number)
    return lifted


@njit(cache=True, nogil=True)
def _approach_range(
    tree: Tree,
    points: FloatArray,
    rows: IntArray,
    radii: FloatArray,
    sigma: float,
    moved: FloatArray,
    normals: FloatArray,
) -> None:
    """Bring each point near its surface, and find that one's normal: the largest plane that agrees with the smaller."""
    moments, mean, normal, first = np.zeros((len(radii), 10)), np.zeros(3), np.zeros(3), np.zeros(3)
    look = make_look()
    for i in rows:
        sum_rings(tree, points[i], radii, normals[i], _SLAB * sigma, moments, look)
        low_end, high_end, chosen = -np.inf, np.inf, -1
        for j in range(len(radii)):
            count = moments[j, 0]
            if count < FEWEST:
                continue
            low, middle, high = fit_plane(moments[j], mean, normal)
            if middle <= _CLEARLY * low:
                if chosen >= 0 or high > LONG * middle:
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
            if abs(shift) > FAR * sigma:  # not a point of that plane
                break
            low_end, high_end = max(low_end, shift - _AGREE * error), min(high_end, shift + _AGREE * error)
            if low_end > high_end:
                break
            chosen = j
            for k in range(3):
                moved[i, k] = points[i, k] + shift * first[k]
        if chosen >= 0:
            normals[i] = first


@njit(cache=True, nogil=True)
def _settle_range(
    wide: Tree,
    close: Tree,
    points: FloatArray,
    centres: FloatArray,
    rows: IntArray,
    radii: FloatArray,
    sigma: float,
    normals: FloatArray,
    moved: FloatArray,
    left: FloatArray,
) -> None:
    """Move each point of `rows` onto the shape that explains its neighbourhood; leave it where none does."""
    sums, one, near, look = make_sums(len(radii)), make_sums(1), np.zeros((MOST, 3)), make_look()
    side, pair, place = np.zeros(MOST, np.int64), np.zeros((3, 9)), np.zeros(3)
    for i in rows:
        centre, normal = centres[i], normals[i]
        error, bent = 0.0, True
        if normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2 > 0.5:
            sum_heights(close, centre, normal, radii[:1], _SLAB * sigma, one, look)
            shift, error, bent = _largest(one, sigma)
            if error > 0.0 and not bent:
                sum_heights(wide, centre, normal, radii, _SLAB * sigma, sums, look)
                further = _largest(sums, sigma)
                if 0.0 < further[1] < error:
                    shift, error = further[0], further[1]
            place[:] = shift * normal
        if bent:
            x = points[i] - centre
            count = gather(close, centre, radii[0], near, look)
            edge = _edge(near, count, x, normal, sigma, side, pair, one, place)
            if edge == 0.0:
                edge = _pole(wide, centre, x, radii, sigma, near, look, place)
            error = edge if edge > 0.0 else error
        place += centre
        if error > 0.0 and _apart(place, points[i]) <= FAR * sigma:
            moved[i], left[i] = place, _BIAS * error


@njit(cache=True, nogil=True)
def _apart(a: FloatArray, b: FloatArray) -> float:
    return sqrt((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2)


@njit(cache=True, nogil=True)
def _largest(sums: Sums, sigma: float) -> tuple[float, float, bool]:
    """Height of the surface over the centre by the largest plane, or else quadric, that agrees with the smaller ones.

    With its standard error, 0 if there is none, and whether it is bent at the smallest radius.
    """
    low_end, high_end, shift, error, bent = -np.inf, np.inf, 0.0, 0.0, True
    for j in range(len(sums.number)):
        count = sums.number[j]
        if count < 2 * FEWEST:
            continue
        plane, quadric = fit_heights(sums, j)
        flat = plane[2] - quadric[2] <= _CURVED * sigma**2
        height, spread, rest = plane if flat else quadric
        freedom = count - (3.0 if flat else 6.0)
        if not rest <= freedom * sigma**2 * (1.0 + _THICK * sqrt(2.0 / freedom)):
            if error > 0.0:
                break
            continue
        spread = sigma * sqrt(spread)
        low_end, high_end = max(low_end, height - _AGREE * spread), min(high_end, height + _AGREE * spread)
        if low_end > high_end:
            break
        if error == 0.0:
            bent = not flat
        shift, error = height, spread
    return shift, error, bent


@njit(cache=True, nogil=True)
def _edge(
    near: FloatArray,
    count: int,
    x: FloatArray,
    normal: FloatArray,
    sigma: float,
    side: IntArray,
    pair: FloatArray,
    sums: Sums,
    place: FloatArray,
) -> float:
    """Write where on an edge of two half planes x lies; the standard error, 0 if it is no edge.

    It must explain the first `count` rows of `near`, and clearly better than a quadric does.
    """
    if count < 3 * FEWEST:
        return 0.0
    freedom, more = count - 6.0, max(_CURVED, _SPLIT * count) * sigma**2
    bent = quadric_rest(near, count, normal, sums)
    if more > bent:
        return 0.0
    rest = fit_pair(near, count, normal, side, pair)
    if rest > freedom * sigma**2 * (1.0 + _THICK * sqrt(2.0 / freedom)) or rest + more > bent:
        return 0.0
    k = nearest_half(pair, x)
    onto_half(pair, k, x, place)
    aside = (place[0] - pair[k, 0]) ** 2 + (place[1] - pair[k, 1]) ** 2 + (place[2] - pair[k, 2]) ** 2
    return sigma * sqrt((1.0 + aside / pair[k, 7]) / pair[k, 6])


@njit(cache=True, nogil=True)
def _widest(square: float, sigma: float, count: int) -> float:
    """Upper bound of a pole's squared radius [m²] whose estimate from the known noise is `square`.

    A pole thinner than the noise looks like a line, and as a line it would be given too much room. The squared
    distances from its axis have the variance 4 σ² (σ² + ρ²).
    """
    estimate = max(square, 0.0)
    return float(estimate + _SURE * 2.0 * sigma * sqrt((sigma**2 + estimate) / count))


@njit(cache=True, nogil=True)
def _pole(
    tree: Tree,
    centre: FloatArray,
    x: FloatArray,
    radii: FloatArray,
    sigma: float,
    near: FloatArray,
    look: Look,
    place: FloatArray,
) -> float:
    """Write where on a pole x lies; the standard error, 0 if it is no pole."""
    mean, axis, moments = np.zeros(3), np.zeros(3), np.zeros((len(radii), 10))
    sum_rings(tree, centre, radii, axis, 0.0, moments, look)
    for j in range(len(radii) - 1, -1, -1):
        if moments[j, 0] < 2 * FEWEST:
            continue
        low, middle, high = fit_plane(moments[j], mean, axis)
        if high <= _LENGTH * middle or middle > _CLEARLY * low:
            continue
        count = gather(tree, centre, radii[j], near, look)
        fit_axis(moments[j], high, axis)
        square, variance = fit_ring(near, count, mean, axis)
        square = max(square, _widest(square + 2.0 * variance - 2.0 * sigma**2, sigma, count))
        if abs(variance / sigma**2 - 1.0) > 2.0 * _THICK * sqrt(2.0 / count):
            continue
        along = 0.0
        for k in range(3):
            along += (x[k] - mean[k]) * axis[k]
        place[:] = x - mean - along * axis
        rho = sqrt(place[0] ** 2 + place[1] ** 2 + place[2] ** 2)
        place[:] = mean + along * axis + place * (sqrt(square) / max(rho, 1e-12))
        return sigma * sqrt(4.0 / count)
    return 0.0

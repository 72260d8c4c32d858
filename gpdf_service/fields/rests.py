"""What the noise has left between points and the surface that they belong to, averaged over all that are beside.

An outlier is one point among many whose offsets from their surface cancel out; a rod, a cable or a handle is many
offsets to one side. So a place's mean offset tells them apart, with an error that falls with the number beside, where
a point's own offset does not. It also shows what a smooth shape has swallowed.
"""

from __future__ import annotations

from math import exp, sqrt

import numpy as np
from numba import njit
from scipy.spatial import cKDTree

from gpdf_service.fields.shapes import FEWEST
from gpdf_service.fields.threads import run_chunked
from gpdf_service.fields.tree import Tree, build_tree, from_root, make_scratch, next_leaf, place_of
from gpdf_service.types import BoolArray, FloatArray, IntArray

FAR = 4.0
"""[-] Standard deviations: a point further off a plane is not of it, whatever it is."""
EXTREME = 1.5
"""[-] Standard deviation of a point that was not moved over the noise: the nearest of many is an extreme one."""
_LONELY = 2.0
"""[-] Distance to the points beside over what it is for those: a quarter of the density is no surface."""
_REACH = 3.0
"""[-] Widths of the Gaussian window within which it counts."""
_SWALLOWED = 3.0
"""[-] Standard errors of a mean offset beyond which a shape has swallowed something: noise does so once in 400."""
_SURE = 3.0
"""[-] Standard errors beyond the mean, to the safe side, that a point which no shape explains is put at, and deviation
that is left of it over that error: a corner sticks out of its mean."""


def settle_rests(
    points: FloatArray,
    moved: FloatArray,
    left: FloatArray,
    normals: FloatArray,
    noise: float,
    spacing: float,
    picked: BoolArray,
) -> None:
    """Move what no shape explains to the mean of what is beside it, and what a shape has swallowed out of it.

    m = Σ w_j (x_j − s_j) / Σ w_j with w_j a Gaussian window, as wide as the noise, around the point's place on the
    nearest surface, and s_j the places of all points. Its standard error is σ √(Σ w_j²) / Σ w_j.

    Args:
        points: As measured [m], shape (n, 3).
        moved: On their surfaces [m], shape (n, 3); changed in place.
        left: Standard deviation left [m], shape (n,); changed in place.
        normals: Of the surfaces, shape (n, 3), 0 where there is none.
        noise: Standard deviation of the points [m].
        spacing: Between neighbours on a surface [m].
        picked: Points that are enough to take means over, shape (n,).
    """
    _, rows, _, place = beside_surface(points, moved, left, normals, noise, spacing)
    length = np.linalg.norm(points[rows] - place, axis=1)
    near = length <= FAR * noise
    rows, place, length = rows[near], place[near], np.maximum(length[near], 1e-12)
    home = moved.copy()
    home[rows] = place
    mean, error = _mean_rests(points, home, picked, noise, max(noise, spacing))
    along = np.einsum("ij,ij->i", mean, normals)
    cured = left < EXTREME * noise
    cured[rows] = False
    out = np.flatnonzero(cured & (np.abs(along) > _SWALLOWED * error))
    moved[out] += along[out, None] * normals[out]
    left[out] = np.maximum(left[out], np.minimum(_SURE * error[out], EXTREME * noise))
    aside = points[rows] - place
    out_by = np.einsum("ij,ij->i", mean[rows], aside) / length
    noisy = out_by <= FAR * error[rows]
    rows, share = rows[noisy], (out_by + _SURE * error[rows])[noisy] / length[noisy]
    moved[rows] = place[noisy] + np.clip(share, 0.0, 1.0)[:, None] * aside[noisy]
    left[rows] = np.minimum(_SURE * error[rows], EXTREME * noise)


def follow_nearest(
    points: FloatArray, moved: FloatArray, left: FloatArray, normals: FloatArray, noise: float, spacing: float
) -> None:
    """Move each point whose surroundings were cured and which itself was not, or elsewhere, onto the nearest's plane.

    For ground, which stays smooth so: a mean of few points is a step. The arguments are those of `settle_rests`.
    """
    lost, rows, nearest, _ = beside_surface(points, moved, left, normals, noise, spacing)
    around = cKDTree(points).query(points[rows], k=2 * FEWEST, workers=-1)[1]
    lone = lost[around].mean(axis=1) < 0.5
    rows, nearest = rows[lone], nearest[lone]
    normal = normals[nearest]
    across = np.einsum("ij,ij->i", points[rows] - moved[nearest], normal)
    place = np.where(normal.any(axis=1)[:, None], points[rows] - across[:, None] * normal, moved[nearest])
    close = np.linalg.norm(place - points[rows], axis=1) <= FAR * noise
    moved[rows[close]], left[rows[close]] = place[close], left[nearest[close]]


def beside_surface(
    points: FloatArray, moved: FloatArray, left: FloatArray, normals: FloatArray, noise: float, spacing: float
) -> tuple[BoolArray, IntArray, IntArray, FloatArray]:
    """The points that were not cured, or elsewhere than those beside, and of them those near one that was.

    Returns:
        Which were not, shape (n,); the rows of those near, shape (k,); the row of the nearest that was cured, shape
        (k,); and where they are on its plane, no further from it than the spacing [m], shape (k, 3).
    """
    cured = np.flatnonzero(left < EXTREME * noise)
    others = np.ones(len(points), dtype=bool)
    if len(cured) <= FEWEST:
        return others, cured[:0], cured[:0], points[:0]
    reach, near = cKDTree(moved[cured]).query(moved[cured], k=FEWEST, workers=-1)
    sound = cured[reach[:, -1] <= _LONELY * np.median(reach[near, -1], axis=1)]
    others[sound] = False
    rows = np.flatnonzero(others)
    off, nearest = cKDTree(moved[sound]).query(points[rows], workers=-1)
    close = off <= FAR * noise + spacing
    rows, nearest = rows[close], sound[nearest[close]]
    aside, normal = points[rows] - moved[nearest], normals[nearest]
    aside -= np.einsum("ij,ij->i", aside, normal)[:, None] * normal
    aside[~normal.any(axis=1)] = 0.0  # of a pole
    aside *= np.minimum(1.0, spacing / np.maximum(np.linalg.norm(aside, axis=1), 1e-12))[:, None]
    return others, rows, nearest, moved[nearest] + aside


def _mean_rests(
    points: FloatArray, home: FloatArray, picked: BoolArray, noise: float, width: float
) -> tuple[FloatArray, FloatArray]:
    """Mean offset of the points from their homes around each home [m], shape (n, 3), and its standard error, (n,)."""
    tree = build_tree(home[picked])
    rests = (points - home)[picked][tree.order]
    mean, error = np.zeros_like(points), np.full(len(points), noise)
    run_chunked(lambda a, b: _mean_range(tree, rests, home, a, b, width, noise, mean, error), len(points))
    return mean, error


@njit(cache=True, nogil=True)
def _mean_range(
    tree: Tree,
    rests: FloatArray,
    places: FloatArray,
    begin: int,
    end: int,
    width: float,
    sigma: float,
    mean: FloatArray,
    error: FloatArray,
) -> None:
    blocks, boxes, limit = tree.blocks, tree.boxes, (_REACH * width) ** 2
    stack, bound, near_box = make_scratch()
    for i in range(begin, end):
        x, total, squares, a, b, c = places[i], 0.0, 0.0, 0.0, 0.0, 0.0
        place, top = place_of(x), from_root(stack, bound)
        while True:
            leaf, _, top = next_leaf(boxes, place, place, limit, stack, bound, near_box, top)
            if leaf < 0:
                break
            first = tree.begin[leaf]
            for j in range(tree.begin[leaf + 1] - first):
                square = (blocks[leaf, 0, j] - x[0]) ** 2 + (blocks[leaf, 1, j] - x[1]) ** 2
                square += (blocks[leaf, 2, j] - x[2]) ** 2
                if square <= limit:
                    weight = exp(-0.5 * square / width**2)
                    total += weight
                    squares += weight * weight
                    a += weight * rests[first + j, 0]
                    b += weight * rests[first + j, 1]
                    c += weight * rests[first + j, 2]
        if total > 0.0:
            mean[i, 0], mean[i, 1], mean[i, 2] = a / total, b / total, c / total
            error[i] = sigma * sqrt(squares) / total

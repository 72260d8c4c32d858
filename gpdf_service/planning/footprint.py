"""A body as a row of discs along its heading: where they are when it stands at a pose (x, y, θ)."""

from __future__ import annotations

from collections.abc import Sequence
from math import atan2, pi, sqrt

import numpy as np
from numba import njit

from gpdf_service.planning.shape import stand_on, subdivide
from gpdf_service.search.ways import Fields, Here
from gpdf_service.types import BoolArray, FloatArray

STILL = 1e-9
"""[m] What moves less stands."""


def disc_places(poses: FloatArray, offset: FloatArray) -> FloatArray:
    """Centre in plan of the disc that lies `offset` [m], one or (n,), ahead of each pose (x, y, θ), (n, 3); (n, 2)."""
    places: FloatArray = poses[:, :2] + np.stack([offset * np.cos(poses[:, 2]), offset * np.sin(poses[:, 2])], axis=-1)
    return places


@njit(cache=True, nogil=True)
def directions(path: FloatArray) -> FloatArray:
    """Direction of each segment of a path, shape (n, 2 or more), unwrapped [rad], shape (n − 1,)."""
    made = np.empty(len(path) - 1)
    for i in range(len(made)):
        made[i] = atan2(path[i + 1, 1] - path[i, 1], path[i + 1, 0] - path[i, 0])
        if i > 0:
            made[i] += 2.0 * pi * np.round((made[i - 1] - made[i]) / (2.0 * pi))
    return made


@njit(cache=True, nogil=True)
def travel_headings(path: FloatArray) -> FloatArray:
    """Direction of travel at each place of a path, shape (n, 2 or more), unwrapped [rad]: half-way round a corner."""
    direction, headings = directions(path), np.empty(len(path))
    headings[0], headings[1:-1], headings[-1] = direction[0], 0.5 * (direction[1:] + direction[:-1]), direction[-1]
    return headings


@njit(cache=True, nogil=True)
def face(path: FloatArray, lever: float, spacing: float) -> FloatArray:
    """Poses (x, y, θ) at most `spacing` [m] apart along a path, shape (n, 2), where the body faces where it goes.

    Of a path that has a third column, θ, the body faces there: then neither its centre nor its ends, which are a
    `lever` [m] away from it, move further.
    """
    if path.shape[1] == 3:
        metres = path.copy()
        metres[:, 2] *= lever
        poses = subdivide(metres, spacing)
        poses[:, 2] /= lever
        return poses
    places = subdivide(path, spacing)
    made = np.empty((len(places), 3))
    made[:, :2], made[:, 2] = places, travel_headings(places)
    return made


@njit(cache=True, nogil=True)
def moving(places: FloatArray, heading: FloatArray, lever: float) -> BoolArray:
    """Which places, (n, ≥ 2), the body has moved or turned to from the one before; the last, too, if it never moves."""
    keep, any_moves = np.ones(len(places), np.bool_), False
    for i in range(1, len(places)):
        dx, dy = places[i, 0] - places[i - 1, 0], places[i, 1] - places[i - 1, 1]
        keep[i] = sqrt(dx * dx + dy * dy) + lever * abs(heading[i] - heading[i - 1]) > STILL
        any_moves |= keep[i]
    keep[-1] |= not any_moves
    return keep


@njit(cache=True, nogil=True)
def stand_along(
    path: FloatArray,
    lever: float,
    spacing: float,
    here: Sequence[Here],
    fields: Sequence[Fields],
    height: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Contact points and tops, (n, 3), of who goes along a path, see `stand_on`, and where he faces (n,).

    Places to which he does not move or turn from the one before are left out; two of them stay, the ends.
    """
    poses = face(path, lever, spacing)
    poses = poses[moving(poses, poses[:, 2], lever)]
    (about, ends, _), (_, field) = here[0], fields[0]
    contact, top = stand_on(poses, about.ground, ends, field, height)
    return contact, top, poses[:, 2].copy()

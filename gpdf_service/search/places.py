"""Obstacle places in plan: those that stand, in one tree, and those that move, in another, small one."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from gpdf_service.fields import Tree, find_nearest
from gpdf_service.fields.traversal import nearest_along, nearest_at
from gpdf_service.fields.tree import NO_POINTS, Place, Scratch, make_scratch
from gpdf_service.kernel_cache import lean
from gpdf_service.types import FloatArray, IntArray


class Places(NamedTuple):
    """Two trees that are asked as one; either may be without points. Rows of what moves come after the others."""

    standing: Tree
    moving: Tree = NO_POINTS


@lean()
def nearest_of(places: Places, x: Place, scratch: Scratch) -> tuple[float, int]:
    """Exact distance to the nearest of the places [m], and its row before it was in a tree; 0 and −1 for none."""
    distance, row = 0.0, -1
    if len(places.standing.begin) >= 2:
        distance, at = nearest_along(places.standing, x, scratch)
        row = places.standing.order[at]
    if len(places.moving.begin) >= 2:
        near, at = nearest_at(places.moving, x, scratch)
        if row < 0 or near < distance:
            distance, row = near, len(places.standing.points) + places.moving.order[at]
    return distance, row


@lean()
def distance_at(places: Places, x: Place, scratch: Scratch) -> float:
    """Exact distance to the nearest of the places [m], 0 from what is no place, or where there are none."""
    return float(nearest_of(places, x, scratch)[0])


@njit(cache=True, nogil=True)
def nearest_to(places: Places, xy: FloatArray) -> tuple[float, int]:
    """`nearest_of` for a single place in plan, shape (2,)."""
    return nearest_of(places, (xy[0], xy[1], 0.0), make_scratch())


def nearest_places(places: Places, xy: FloatArray) -> tuple[FloatArray, IntArray]:
    """Exact distance from each of `xy`, shape (m, 2), to the nearest place [m], and its row before it was in a tree."""
    standing, moving = places
    xy = np.ascontiguousarray(xy)
    distance, row = find_nearest(standing, xy)
    row = standing.order[row]
    if len(moving.points):
        near, other = find_nearest(moving, xy)
        nearer = near < distance
        distance, row = np.minimum(distance, near), np.where(nearer, len(standing.points) + moving.order[other], row)
    return distance, row

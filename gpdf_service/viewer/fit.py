"""Where a camera stands so that a box fills what the panel leaves free of the picture."""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np

from gpdf_service.types import FloatArray

PANEL = 400
"""[px] What viser's panel takes at the right, with its margins; on a phone it lies below."""
PHONE = 576
"""[px] Not wider: `front` puts the panel below there."""
BELOW = 0.46
"""[-] Of a phone's height that the panel takes."""
MARGIN = 0.08
"""[-] Of half the picture, for the numbers along the sides."""
NEAREST = 0.5
"""[m] From the camera to the box."""


class Free(NamedTuple):
    """A part of the picture, whose middle is zero and whose sides are at −1 and 1: from `low` to `high`, each (2,)."""

    low: FloatArray
    high: FloatArray


def free_of(width: int) -> Free:
    """What the panel leaves free of a picture so wide [px]."""
    low, high = np.full(2, MARGIN - 1.0), np.full(2, 1.0 - MARGIN)
    if width <= PHONE:
        low[1] += 2.0 * BELOW
    else:
        high[0] -= 2.0 * min(PANEL / width, 0.5)
    return Free(low, high)


def fitted(
    low: FloatArray, high: FloatArray, toward: FloatArray, fov: float, aspect: float, free: Free
) -> tuple[FloatArray, FloatArray]:
    """Position and target (3,) [m] of a camera as near as a box from `low` to `high` fits the free part of its picture.

    A corner at (x, z), seen from a shifted by a and back by b, is at (x − a) / (k (b + z)) of the picture: two corners
    fit between L and R where k (R − L) b is at least their distance less k (R z_i − L z_j). The largest such b serves.

    Args:
        low: Lower corner of the box, (3,) [m].
        high: Upper corner.
        toward: From the box to the camera, (3,), not straight up.
        fov: Angle of the picture's height [rad].
        aspect: Its width over its height.
        free: Where the box has to be.
    """
    forward = -toward / np.linalg.norm(toward)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(right, forward), forward])
    middle = 0.5 * (low + high)
    corners = (np.array(list(product(*zip(low, high, strict=True)))) - middle) @ axes.T
    beside, depth = corners[:, :2], corners[:, 2:]
    k = np.tan(0.5 * fov) * np.array([aspect, 1.0])
    right_most, left_most = beside - k * free.high * depth, beside - k * free.low * depth
    back = float(((right_most.max(axis=0) - left_most.min(axis=0)) / (k * (free.high - free.low))).max())
    back = max(back, NEAREST - float(depth.min()))
    shift = 0.5 * ((right_most - k * free.high * back).max(axis=0) + (left_most - k * free.low * back).min(axis=0))
    target = middle + shift @ axes[:2]
    return target - back * forward, target

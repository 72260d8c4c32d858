"""What moves as points: the same in the service, which plans round them, and in a client, which looks out for them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gpdf_schemas.messages import Cylinder, MovingObstacle

FloatArray = NDArray[np.float64]

SPACING = 0.05
"""[m] Between the points of a cylinder's side: half of the lowest body's height, so that one of them is in its way."""
FILL = 0.1
"""[m] Between the points inside: no body has its centre in there and its side clear of them."""
LARGEST = 10.0
"""[m] Radius and height of a cylinder at most: what is larger belongs into the map."""
MAX_POINTS = 200_000
"""Of all obstacles of one scene together: what a laser scanner sees in a second, or a cylinder of 3 m by 3 m."""


def points_of(obstacle: MovingObstacle, room: int = MAX_POINTS) -> FloatArray:
    """An obstacle as points, shape (k, 3) [m].

    Args:
        obstacle: Its points, its cylinder, or both.
        room: How many points it may have; a cylinder is a few bytes of a message and gigabytes of points.

    Raises:
        ValueError: no shape at all, an array of another shape, a cylinder that is none, too many points.
    """
    parts: list[FloatArray] = []
    if obstacle.points is not None:
        points = obstacle.points.unpack()
        if points.ndim != 2 or points.shape[1] != 3:
            raise ValueError(f"obstacle {obstacle.id!r}: points of shape {points.shape}. Send an array (k, 3).")
        parts.append(points)
    if obstacle.cylinder is not None:
        parts.append(_cylinder_points(obstacle.id, obstacle.cylinder, room))
    if not parts and obstacle.lifetime_s > 0:
        raise ValueError(f"obstacle {obstacle.id!r}: neither points nor a cylinder. Send one of them.")
    _check_room(obstacle.id, sum(map(len, parts)), room)
    return stacked(parts)


def _check_room(id_: str, count: int, room: int) -> None:
    if count > room:
        raise ValueError(f"obstacle {id_!r}: {count} points, there is room for {room} of {MAX_POINTS}. Thin them.")


def _cylinder_points(id_: str, cylinder: Cylinder, room: int) -> FloatArray:
    """Its side and its inside, layer by layer; the side a little outside, so that chords do not cut the circle."""
    radius, height = cylinder.radius, cylinder.height
    if not (0 < radius <= LARGEST and 0 < height <= LARGEST):
        raise ValueError(f"obstacle {id_!r}: radius {radius}, height {height}. Give more than 0, at most {LARGEST} m.")
    count = max(8, int(np.ceil(2 * np.pi * radius / SPACING)))
    angle = 2 * np.pi * np.arange(count) / count
    ring = np.column_stack([np.cos(angle), np.sin(angle)]) * radius / np.cos(np.pi / count)
    x, y = np.meshgrid(*[np.arange(-radius, radius + FILL, FILL)] * 2)
    inside = np.column_stack([x.ravel(), y.ravel()])
    disc = np.concatenate([ring, inside[np.hypot(*inside.T) < radius]])
    z = np.linspace(0.0, height, max(2, int(np.ceil(height / SPACING)) + 1))
    _check_room(id_, len(disc) * len(z), room)
    layers = np.column_stack([np.tile(disc, (len(z), 1)), np.repeat(z, len(disc))])
    placed: FloatArray = layers + np.array(cylinder.base)
    return placed


def stacked(parts: Sequence[FloatArray]) -> FloatArray:
    """Points of several, shape (k, 3); none give an empty array."""
    return np.concatenate([np.zeros((0, 3)), *parts])

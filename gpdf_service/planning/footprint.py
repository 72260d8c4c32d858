"""A body as a row of discs along its heading: where they are when it stands at a pose (x, y, θ)."""

from __future__ import annotations

import numpy as np

from gpdf_service.planning.shape import subdivide
from gpdf_service.types import Agent, FloatArray


def disc_places(poses: FloatArray, offset: FloatArray) -> FloatArray:
    """Centre in plan of the disc that lies `offset` [m], one or (n,), ahead of each pose (x, y, θ), (n, 3); (n, 2)."""
    places: FloatArray = poses[:, :2] + np.stack([offset * np.cos(poses[:, 2]), offset * np.sin(poses[:, 2])], axis=-1)
    return places


def travel_headings(path: FloatArray) -> FloatArray:
    """Direction of travel at each place of a path, shape (n, 2 or more), unwrapped [rad]: half-way round a corner."""
    step = np.diff(path[:, :2], axis=0)
    direction = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
    return np.concatenate([direction[:1], 0.5 * (direction[1:] + direction[:-1]), direction[-1:]])


def face(path: FloatArray, agent: Agent, spacing: float) -> FloatArray:
    """Poses (x, y, θ) at most `spacing` [m] apart along a path, shape (n, 2), where the body faces where it goes.

    Of a path that has a third column, θ, the body faces there: then neither its centre nor its ends move further.
    """
    if path.shape[1] == 2:
        places = subdivide(path, spacing)
        return np.column_stack([places, travel_headings(places)])
    metres = np.array([1.0, 1.0, agent.offsets[-1]])
    poses: FloatArray = subdivide(path * metres, spacing) / metres
    return poses

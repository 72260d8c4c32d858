"""Time stamps: as fast as speed, acceleration and turning allow, from rest to rest."""

from __future__ import annotations

import numpy as np

from gpdf_service.types import Agent, FloatArray

STANDING = 1e-3
"""[s] For a path whose start is its goal: nothing moves, but time stamps still increase."""


def time_path(positions: FloatArray, agent: Agent) -> tuple[FloatArray, FloatArray]:
    """Times [s] and headings [rad] of a polyline, shape (n, 3), n ≥ 2, without repeated points.

    The largest v(s) with v ≤ speed, v² κ ≤ acceleration, v κ ≤ turn rate, |dv²/ds| ≤ 2 acceleration and v = 0 at the
    ends: one pass forward and one backward, the numerical integration of time-optimal path parametrisation.
    """
    step = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    if not step.any():
        return np.linspace(0.0, STANDING, len(positions)), np.zeros(len(positions))
    heading = np.unwrap(np.arctan2(*np.diff(positions[:, :2], axis=0).T[::-1]))
    headings = np.concatenate([heading[:1], 0.5 * (heading[:-1] + heading[1:]), heading[-1:]])
    between = 0.5 * (step[:-1] + step[1:])
    curvature = np.concatenate([[0.0], np.abs(np.diff(heading)) / np.maximum(between, 1e-9), [0.0]])
    with np.errstate(divide="ignore"):
        limit = np.minimum(np.sqrt(agent.acceleration / curvature), agent.turn_rate / curvature)
    speed2 = np.minimum(agent.speed, limit) ** 2
    speed2[0] = speed2[-1] = 0.0
    for i in range(1, len(speed2)):
        speed2[i] = min(speed2[i], speed2[i - 1] + 2 * agent.acceleration * step[i - 1])
    for i in range(len(speed2) - 2, -1, -1):
        speed2[i] = min(speed2[i], speed2[i + 1] + 2 * agent.acceleration * step[i])
    speed = np.sqrt(speed2)
    mean = 0.5 * (speed[:-1] + speed[1:])
    # A single segment from rest to rest has no inner speed: the triangle profile.
    mean = np.where(mean > 0, mean, 0.5 * np.sqrt(agent.acceleration * step))
    times = np.concatenate([[0.0], np.cumsum(step / mean)])
    return times, headings

"""Everything that stops one kind of body on one level, as one 2D point set with a reason for each point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gpdf_service.perception.levels import GroundLevel
from gpdf_service.perception.limits import ObstacleKind
from gpdf_service.perception.surface import UNKNOWN, HeightMap
from gpdf_service.types import Agent, BoolArray, FloatArray

LEAST_OBSTACLE = 0.015
"""[m] What stands out of the ground by less stops no body here: the smallest `max_step`, and the scatter of a scan."""


@dataclass(frozen=True, slots=True)
class Obstacles:
    """Points [m], shape (j, 3), and the `ObstacleKind` of each, shape (j,)."""

    points: FloatArray
    kind: NDArray[np.uint8]


def obstacles_of(level: GroundLevel, agent: Agent, noise: float = 0.0) -> Obstacles:
    """What stops `agent` on `level`; `noise` is the standard deviation of the cloud [m].

    Material is an obstacle if a body that reaches it, standing on the highest ground within its radius, is as tall: the
    paper's d_g(x) ≤ h_r, made safe beside a platform. The face between two pieces of ground that are joined by a step
    which the body takes is none. Limits of the ground are obstacles where they exceed the body's.
    """
    touched = _material(level, agent, noise)
    limits = level.limits
    reach = np.array([0.0, agent.max_step, agent.max_slope, -np.inf])[limits.kind]
    stops = limits.value > reach
    return Obstacles(
        np.concatenate([level.other_points[touched], limits.points[stops]]),
        np.concatenate([np.full(int(touched.sum()), int(ObstacleKind.MATERIAL), np.uint8), limits.kind[stops]]),
    )


def _material(level: GroundLevel, agent: Agent, noise: float) -> BoolArray:
    surface, points = level.surface, level.other_points
    least = max(LEAST_OBSTACLE, noise)
    beside = 3 + 2 * int(np.ceil(2.0 * noise / surface.cell_width))  # cells that noise may have carried a point across
    known = surface.state != UNKNOWN
    top = np.where(known, surface.height, -np.inf)
    bottom = np.where(known, surface.height, np.inf)
    disc = _disc(agent.radius + surface.cell_width, surface)
    ix, iy, _ = surface.cells(points)
    z = points[:, 2]
    reached = z < ndimage.maximum_filter(top, footprint=disc)[ix, iy] + agent.height
    beneath = z < ndimage.minimum_filter(bottom, footprint=disc)[ix, iy] - least
    high = ndimage.maximum_filter(top, size=beside)[ix, iy]
    low = ndimage.minimum_filter(bottom, size=beside)[ix, iy]
    own = np.where(known, surface.height, -np.inf)[ix, iy]
    ledge = np.where(high - low > least, high, own)  # on level ground, the ground under the point itself
    face = np.isfinite(high) & (high - low <= agent.max_step + least) & (z <= ledge + least)
    stops: BoolArray = reached & ~beneath & ~face
    return stops


def _disc(radius: float, surface: HeightMap) -> BoolArray:
    cells = int(np.ceil(radius / surface.cell_width))
    x, y = np.mgrid[-cells : cells + 1, -cells : cells + 1] * surface.cell_width
    inside: BoolArray = np.hypot(x, y) <= radius
    return inside

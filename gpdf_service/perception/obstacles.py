"""Everything that stops one kind of body on one level, as one 2D point set with a reason for each point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

from gpdf_service.fields.threads import run_chunked
from gpdf_service.perception.levels import FACE, LEAST_OBSTACLE, GroundLevel
from gpdf_service.perception.limits import ObstacleKind
from gpdf_service.perception.surface import INFERRED, UNKNOWN, HeightMap
from gpdf_service.types import Agent, BoolArray, FloatArray, IntArray

HEADROOM_SHARE = 0.01
"""[-] How well a scan knows the room over the ground, over the body's height: 2 cm for a person, 1 mm for a Roomba."""


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
    known = surface.state != UNKNOWN
    top = np.where(known, surface.height, -np.inf)
    bottom = np.where(known, surface.height, np.inf)
    disc = _disc(agent.cylinder.radius + surface.cell_width, surface)
    ix, iy, _ = surface.cells(points)
    z, tall = points[:, 2], (1.0 - HEADROOM_SHARE) * agent.height + noise
    lowest = ndimage.minimum_filter(bottom, footprint=disc)[ix, iy]
    stops = (z < ndimage.maximum_filter(top, footprint=disc)[ix, iy] + tall) & (z >= lowest - least)
    stops[stops] = ~_is_face(level, np.flatnonzero(stops), agent.max_step, least)
    # Beside a step the question is which ground the body stands on; not on what stops it wherever it stands.
    always = stops & (z < lowest + tall)
    free = np.ones(known.shape, dtype=bool)
    free[ix[always], iy[always]] = False
    shut = (ndimage.distance_transform_edt(free) + np.sqrt(2.0)) * surface.cell_width < agent.disc_radius
    stands = ndimage.maximum_filter(np.where(shut, -np.inf, top), footprint=disc)[ix, iy]
    found: BoolArray = stops & (always | (z < stands + tall))
    return found


def _is_face(level: GroundLevel, rows: IntArray, max_step: float, least: float) -> BoolArray:
    """Which of the points belong to the ground: its scatter, or the face of a step that the body takes.

    A face lies between the ground next below it and the ground next above it. Cells can be wider than a tread, so the
    upper one must be a point of the ground right beside; or inferred, as a tread in a shadow is.
    """
    surface, points, near = level.surface, level.other_points[rows], level.surface.cell_width <= FACE
    ix, iy, _ = surface.cells(points)
    known = np.where(surface.state != UNKNOWN, surface.height, np.float32(np.nan))
    inferred, ledge, face = surface.state == INFERRED, level.ledge[rows], np.zeros(len(rows), dtype=bool)
    run_chunked(
        lambda a, b: _faces(points, ix, iy, known, inferred, ledge, near, max_step, least, a, b, face), len(rows)
    )
    return face


@njit(cache=True, nogil=True)
def _faces(
    points: FloatArray,
    ix: IntArray,
    iy: IntArray,
    known: NDArray[np.float32],
    inferred: BoolArray,
    ledges: NDArray[np.float32],
    near: bool,
    max_step: float,
    least: float,
    begin: int,
    end: int,
    face: BoolArray,
) -> None:
    """`_is_face`; a tread in a shadow counts in the cells around if they are `near`, else in the point's own."""
    for m in range(begin, end):
        z, foot, lowest, ledge = points[m, 2], -np.inf, np.inf, float(ledges[m])
        for i in range(max(ix[m] - 1, 0), min(ix[m] + 2, known.shape[0])):
            for j in range(max(iy[m] - 1, 0), min(iy[m] + 2, known.shape[1])):
                beside = float(known[i, j])
                if np.isnan(beside):
                    continue
                lowest = min(lowest, beside)
                if beside <= z:
                    foot = max(foot, beside)
                if inferred[i, j] and beside >= z - least and (near or (i == ix[m] and j == iy[m])):
                    ledge = min(ledge, beside)
        foot = max(foot, lowest)
        face[m] = np.isfinite(foot) and (z <= lowest + least or ledge <= foot + max_step)


def _disc(radius: float, surface: HeightMap) -> BoolArray:
    cells = int(np.ceil(radius / surface.cell_width))
    x, y = np.mgrid[-cells : cells + 1, -cells : cells + 1] * surface.cell_width
    inside: BoolArray = np.hypot(x, y) <= radius
    return inside

"""Paths over ground whose heights lie on rungs: each piece is bent that takes no more steps for it."""

from dataclasses import replace

import numpy as np

import gpdf_service as gpdf
from gpdf_service.planning.planner import MORE_STEPS

VOXEL = 0.2
BODY = replace(gpdf.AGENTS["human"], max_step=0.3, max_slope=0.4)


def helix(turns=0.9, inner=3.0, outer=5.6, rise=5.0):
    """A ramp round an axis, of voxels."""
    axis = np.arange(-30, 31) * VOXEL
    x, y = (coordinate.ravel() for coordinate in np.meshgrid(axis, axis, indexing="ij"))
    radius, angle = np.hypot(x, y), np.arctan2(y, x) % (2 * np.pi)
    on = (radius >= inner) & (radius <= outer) & (angle <= 2 * np.pi * turns)
    return np.column_stack([x, y, np.round(rise * angle / (2 * np.pi) / VOXEL) * VOXEL])[on]


def test_one_piece_that_would_take_more_steps_does_not_keep_the_others_from_being_bent():
    scene = gpdf.build_scene(helix())
    result = gpdf.plan(scene, (-3.0, 2.0, 2.0), (3.0, -4.6, 4.2), BODY, snap=0.6)
    assert result.status is gpdf.Status.OK
    assert result.details["iterations"] > 0
    rise = np.abs(np.diff(result.trajectory.ground[:, 2])).sum()
    assert rise <= 4.2 - 2.0 + 2 * VOXEL + 4 * MORE_STEPS  # up, and hardly ever down again

"""Scenes cut out of a scene, and put together from several."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gpdf_service.config import Config
from gpdf_service.errors import CloudError
from gpdf_service.pipeline import build_scene
from gpdf_service.scene import Progress, Scene
from gpdf_service.shades import shades_of
from gpdf_service.types import BoolArray, FloatArray


def crop_scene(scene: Scene, inside: BoolArray, progress: Progress = lambda stage, done: None) -> Scene:
    """A scene of the points `inside`, shape (n,); its ground is what was ground in the whole.

    Cut off from the floor around it a table top looks like one, so the part is not segmented anew.

    Raises:
        CloudError: no point is inside.
        NoGroundError: no ground is inside.
    """
    if not inside.any():
        low, high = (np.round(corner, 2).tolist() for corner in (scene.points.min(axis=0), scene.points.max(axis=0)))
        raise CloudError("crop", "no point lies inside", f"The points lie between {low} and {high} m.")
    made = build_scene(scene.points[inside], scene.ground[inside], scene.config, progress=progress)
    made.shades = scene.shades
    return made


def within_box(points: FloatArray, low: Sequence[float], high: Sequence[float]) -> BoolArray:
    """Points (n, 3) between two corners, each (x, y) or (x, y, z) [m].

    Raises:
        CloudError: the first corner is not below the second one.
    """
    if not all(a < b for a, b in zip(low, high, strict=True)):
        found = f"a box from {tuple(low)} to {tuple(high)}"
        raise CloudError("crop", found, "Give the corner with the least coordinates first.")
    part = points[:, : len(low)]
    inside: BoolArray = np.logical_and.reduce((part >= np.array(low)) & (part <= np.array(high)), axis=1)
    return inside


def within_polygon(points: FloatArray, corners: FloatArray) -> BoolArray:
    """Points (n, 3) over a simple polygon of the `corners`, shape (k ≥ 3, 2) [m]: crossings of a ray are counted.

    Raises:
        CloudError: fewer than three corners.
    """
    if len(corners) < 3:
        raise CloudError("crop", f"a polygon of {len(corners)} corners", "Give three or more.")
    x, y = points[:, 0], points[:, 1]
    inside = np.zeros(len(points), dtype=bool)
    for (ax, ay), (bx, by) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        if ay != by:
            crosses = ((ay > y) != (by > y)) & (x < ax + (y - ay) * (bx - ax) / (by - ay))
            inside ^= crosses
    return inside


def merge_scenes(
    scenes: Sequence[Scene], config: Config | None = None, progress: Progress = lambda stage, done: None
) -> Scene:
    """One scene of the points of all `scenes`; a point that two of them have is taken once.

    Their labels are kept where all of them were given labels; else the ground is found anew in the whole.

    Args:
        scenes: In one frame.
        config: Settings; those of the first scene when not given.
        progress: Called as the work goes on.
    """
    points = np.concatenate([scene.points for scene in scenes])
    ground = np.concatenate([scene.ground for scene in scenes])
    rows = np.sort(np.unique(points, axis=0, return_index=True)[1])
    labels = ground[rows] if all(scene.labelled for scene in scenes) else None
    made = build_scene(points[rows], labels, config or scenes[0].config, progress=progress)
    kept = [scene.shades for scene in scenes if scene.shades is not None]
    if kept:
        made.shades = shades_of(np.concatenate([s.places for s in kept]), np.concatenate([s.colours for s in kept]))
    return made

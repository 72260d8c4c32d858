"""Processor time of changes of 1 m² and of a body's next free space, and whether each equals a build from scratch."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import numpy as np

from gpdf_service.bench.report import Row, Subject, each
from gpdf_service.ground import GroundLevel
from gpdf_service.kernel_cache import load_kept
from gpdf_service.pipeline import build_scene
from gpdf_service.scene import Scene, assemble_scene
from gpdf_service.types import BoolArray, FloatArray

SIDE = 1.0
"""[m] Of the square in plan that a change takes away or fills."""
FRESH = 500
"""Points of what is put in: a box's worth at 5 cm."""
TALL = 1.0
"""[m] What is put in reaches so far over the point that it is put at."""


def measure_changes(cloud: Subject, noise: float, count: int, checked: int) -> Row:
    """Median and worst of `count` changes in turn, each of the version before: one taken away, one put in.

    Args:
        cloud: Of the scene, with its labels and origins, if there are some.
        noise: Standard deviation of what is added to each coordinate [m].
        count: How many.
        checked: How many of them, the first ones, are compared with builds from scratch.
    """
    name, points, ground, origins = cloud
    if noise:
        points = points + noise * np.random.default_rng(2).normal(size=points.shape)
    scene = build_scene(points, ground, origins=origins)
    scene.free_space("human")
    seconds, free, scratch, equal, whole = np.zeros(count), np.zeros(count), np.full(count, np.nan), 0, 0
    for i, change in enumerate(each(_warmed(scene, count), f"changes in {name}", count)):
        began = time.process_time()
        scene = scene.update(**change)
        updated = time.process_time()
        scene.free_space("human")
        seconds[i], free[i] = time.process_time() - began, time.process_time() - updated
        whole += not (scene.perceived and scene.perceived.touched)
        if i < checked:
            again = from_scratch(scene)
            again.free_space("human")
            scratch[i] = time.process_time() - began - seconds[i]
            equal += not differences(scene, again)
    return {
        **{"scene": name, "points": len(points), "noise_m": noise, "origins": origins is not None},
        **{"changes": count, "as_a_whole": whole},
        **{"median_cpu_s": float(np.median(seconds)), "worst_cpu_s": float(seconds.max())},
        **{"free_space_median_cpu_s": float(np.median(free))},
        **({"from_scratch_median_cpu_s": float(np.nanmedian(scratch))} if checked else {}),
        "equal": f"{equal} of {min(count, checked)}",
    }


def _warmed(scene: Scene, count: int) -> Iterator[dict[str, Any]]:
    """Changes of what the scene is at each of them; before the first one compiled code is loaded, and two are made."""
    load_kept("fields", "tiles", "perception", "search")
    for change in _changes(scene, 2, np.random.default_rng(1)):
        scene.update(**change).free_space("human")
    yield from _changes(scene, count, np.random.default_rng(0))


def _changes(scene: Scene, count: int, rng: np.random.Generator) -> Iterator[dict[str, Any]]:
    """Arguments of `Scene.update` for the last version: what is taken away is found by its place, as rows change."""
    points, began = scene.points, scene.rays.began if scene.rays else scene.points
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)  # beyond, all would be built as a whole
    for i in range(count):
        place = points[rng.integers(len(points))]
        if i % 2:
            plan = np.clip(place[:2] + rng.uniform(-0.5 * SIDE, 0.5 * SIDE, (FRESH, 2)), low, high)
            fresh = np.column_stack([plan, place[2] + rng.uniform(0.0, TALL, FRESH)])
            points = np.concatenate([points, fresh])
            labels = {"ground": np.zeros(FRESH, dtype=bool)} if scene.labelled else {}
            eyes = {"origins": began[rng.integers(len(began))]} if scene.rays else {}
            yield {"insert": fresh} | labels | eyes
        else:
            gone = around(points, place, 0.5 * SIDE)
            points = points[~gone]
            yield {"remove": np.flatnonzero(gone)}


def around(points: FloatArray, place: FloatArray, half: float) -> BoolArray:
    """Which points (n, 3) are in a square of half such a side around a place in plan [m], shape (n,)."""
    off = np.abs(points[:, :2] - place[:2])
    return (off[:, 0] < half) & (off[:, 1] < half)


def from_scratch(scene: Scene) -> Scene:
    """A build of the same points, labels and rays, with the same sampling."""
    began, labels = scene.rays.began if scene.rays else None, scene.ground if scene.labelled else None
    return assemble_scene(scene.points, labels, scene.config, known=scene.sampling, origins=began)


def differences(one: Scene, other: Scene) -> list[str]:
    """In what two scenes differ, and a person's free spaces in them."""
    if not np.array_equal(one.ground, other.ground) or len(one.surfaces) != len(other.surfaces):
        return ["ground"]
    found: list[str] = []
    for a, b in zip(one.levels.levels, other.levels.levels, strict=True):
        for name in ("state", "height"):
            if not np.array_equal(getattr(a.surface, name), getattr(b.surface, name), equal_nan=name == "height"):
                found.append(name)
        limits = (np.array_equal(getattr(a.limits, key), getattr(b.limits, key)) for key in ("points", "kind", "value"))
        found += [] if all(limits) else ["limits"]
        found += [] if np.array_equal(_stands(a), _stands(b)) else ["other points"]
    portals = ([portal.points for portal in scene.levels.portals] for scene in (one, other))
    found += [] if all(np.array_equal(a, b) for a, b in zip(*portals, strict=True)) else ["portals"]
    spaces = one.free_space("human"), other.free_space("human")
    for first, second in zip(*([own.quadtree for own in space.levels] for space in spaces), strict=True):
        leaves = (
            np.array_equal(getattr(first, key), getattr(second, key)) for key in ("corner", "size", "free", "whole")
        )
        found += [] if all(leaves) else ["leaves"]
    ends = [space.graph.standing.other for space in spaces]
    found += [] if np.array_equal(ends[0], ends[1]) else ["graph"]
    return found


def _stands(level: GroundLevel) -> FloatArray:
    """The other points of a level and their ledges, in an order of their own."""
    rows = np.column_stack([level.other_points, level.ledge])
    made: FloatArray = rows[np.lexsort(rows.T)]
    return made

"""CPU time of a build against the noise of its cloud: random rooms, labelled or not, beside Open3D's normals."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

import numpy as np

from gpdf_service.bench.build import find_normals
from gpdf_service.bench.report import Row
from gpdf_service.pipeline import build_scene
from gpdf_service.synthetic.scenes import SyntheticScene, random_room
from gpdf_service.types import BoolArray, FloatArray

T = TypeVar("T")
COARSE = 0.08
"""[m] Spacing at which a room is counted, before it is sampled as densely as asked for."""

SIZES = (300_000, 500_000)
"""Points of the smallest and the largest room."""


def dense_room(seed: int, count: int) -> SyntheticScene:
    """A random room of about `count` points."""
    coarse = random_room(np.random.default_rng(seed), spacing=COARSE)
    return random_room(np.random.default_rng(seed), spacing=COARSE * float(np.sqrt(len(coarse.points) / count)))


def measure_noise(noises: Sequence[float], rooms: int) -> Iterator[Row]:
    """Microseconds of CPU a point for each noise [m], with labels and without, in so many rooms."""
    _warm()
    for seed, count in enumerate(np.linspace(*SIZES, rooms).astype(int)):
        room = dense_room(seed, int(count))
        draw = np.random.default_rng((1, seed))
        for noise in noises:
            points = room.points + draw.normal(0.0, 1.0, room.points.shape) * noise
            peer = _cpu_us(lambda points=points: find_normals(points), points)[1]  # type: ignore[misc]
            for labels in (room.ground, None):
                yield {"room": seed, **_row(points, labels, noise, peer)}


def _warm() -> None:
    """Load the compiled code, so that it is not measured."""
    room = dense_room(0, 20_000)
    for noise in (0.0, 0.02):
        points = room.points + np.random.default_rng(0).normal(0.0, 1.0, room.points.shape) * noise
        find_normals(points)
        for labels in (room.ground, None):
            build_scene(points, labels)


def _row(points: FloatArray, labels: BoolArray | None, noise: float, peer: float) -> Row:
    scene, spent = _cpu_us(lambda: build_scene(points, labels), points)
    return {
        **{"noise_m": noise, "labelled": labels is not None, "points": len(points), "us_per_point": spent},
        **{"open3d_normals_us": peer, "ratio": spent / peer, "told_noise_m": scene.noise},
        "hidden_height_m": scene.hidden_height,
    }


def _cpu_us(work: Callable[[], T], points: FloatArray) -> tuple[T, float]:
    began = time.process_time()
    made = work()
    return made, 1e6 * (time.process_time() - began) / len(points)

"""Time and memory of a build against the number of points: a hall with furniture, as large as its points ask for."""

from __future__ import annotations

import multiprocessing
import resource
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from gpdf_service.bench.report import Row
from gpdf_service.clouds import read_cloud
from gpdf_service.pipeline import build_scene
from gpdf_service.types import FloatArray

SPACING = 0.04
"""[m] Between the points of the hall, as of a large scan that was thinned; in tiles they are four times as near."""
FURNITURE = 3000
"""Points of one piece at that spacing, about: as many points are furniture as floor."""
TILE = 1_000_000
"""Points of one file."""


def hall(count: int, spacing: float, rng: np.random.Generator) -> Iterator[FloatArray]:
    """Parts of a hall of about `count` points: floor, and boxes of 1 m that stand about, with 2 mm of noise."""
    side, dense = float(np.sqrt(0.5 * count)) * spacing, round(FURNITURE * (SPACING / spacing) ** 2)
    for begin in range(0, count, TILE):
        half = min(TILE, count - begin) // 2
        floor = np.column_stack([rng.uniform(0.0, side, (half, 2)), np.zeros(half)])
        pieces = max(1, half // dense)
        each = half // pieces
        box = rng.uniform(0.0, 1.0, (pieces, each, 3)) * np.array([1.0, 0.6, 1.2])
        face = rng.integers(0, 4, (pieces, each))
        for value, axis, place in ((0, 0, 0.0), (1, 1, 0.0), (2, 2, 1.2), (3, 0, 1.0)):
            box[..., axis][face == value] = place
        box[..., :2] += rng.uniform(0.0, side - 1.0, (pieces, 1, 2))
        yield np.concatenate([floor, box.reshape(-1, 3)]) + rng.normal(0.0, 0.002, (half + pieces * each, 3))


def hall_of(count: int) -> FloatArray:
    """All of a hall of about `count` points, shape (n, 3)."""
    return np.concatenate(list(hall(count, SPACING, np.random.default_rng(0))))


def measure(count: int, *, tiled: bool) -> Row:
    """Time and memory of a build and a person's free space, in a process of its own: memory is counted from its start.

    Args:
        count: Points.
        tiled: Whether they lie in files, and are thinned to `SPACING` while they are read.
    """
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(_measure_tiles if tiled else _measure_whole, (count,))


def _measure_whole(count: int) -> Row:
    _warm()
    points = hall_of(count)
    return _built(points, len(points), 0.0)


def _measure_tiles(count: int) -> Row:
    _warm()
    with tempfile.TemporaryDirectory() as folder:
        total = 0
        for i, part in enumerate(hall(count, SPACING / 4.0, np.random.default_rng(0))):
            np.savez(Path(folder) / f"{i}.npz", xyz=part.astype(np.float32))
            total += len(part)
        began = time.process_time()
        points = read_cloud(folder, thin=SPACING).points
        return _built(points, total, time.process_time() - began)


def _warm() -> None:
    """Load the compiled code, so that it is not measured."""
    points = np.concatenate(list(hall(50_000, SPACING, np.random.default_rng(1))))
    build_scene(points).free_space("human")


def _built(points: FloatArray, total: int, read_s: float) -> Row:
    began, clock = time.process_time(), time.perf_counter()
    scene = build_scene(points)
    built, peak = time.process_time(), _peak_gb()
    scene.free_space("human")
    free = time.process_time()
    seconds = read_s + free - began
    return {
        **{"points": total, "kept": len(points), "read_cpu_s": read_s, "build_cpu_s": built - began},
        **{"free_space_cpu_s": free - built, "ready_wall_s": time.perf_counter() - clock},
        "build_us_per_point": 1e6 * (read_s + built - began) / total,
        "us_per_point": 1e6 * seconds / total,
        "build_peak_gb": peak,
        "peak_gb": _peak_gb(),
    }


def _peak_gb() -> float:
    """Most memory that the process has held so far, the cloud and the program with it [GB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9

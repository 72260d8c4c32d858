"""VAMP in the plane: RRT-Connect that looks at eight places of a motion at once (Thomason et al. 2024, SIMD).

It looks at 32 places a metre and at none between: what it calls free may touch. Its points are a capacity-aware tree
(Ramsey et al. 2024), made once for a radius. `vamp-planner` is no dependency: it is compiled for one processor.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec

import numpy as np

from gpdf_service.types import FloatArray

SAMPLES = 10_000
"""Places that it may draw: the rooms of the benchmarks took 2,000 at most, and it sets as many aside beforehand."""

Found = tuple[FloatArray | None, float]
"""A path in plan, (n, 2) [m], or none; and the seconds of its search as it tells them itself."""


def is_here() -> bool:
    """Whether `vamp` can be imported."""
    return find_spec("vamp") is not None


def rrt_connect(
    points: FloatArray, radius: float, low: FloatArray, high: FloatArray
) -> Callable[[FloatArray, FloatArray], Found]:
    """A planner for a disc among points in plan, with VAMP's own settings for a sphere, and its simplification.

    VAMP has one sphere and one space for a process: the last planner that was made is the one to ask.

    Args:
        points: What it must not touch [m], shape (n, 2).
        radius: Of the disc [m].
        low: Lower corner of the space [m], shape (2,).
        high: Upper corner [m].

    Returns:
        From start and goal in plan, (2,) [m], to what it found.
    """
    import vamp

    sphere, environment = vamp.sphere, vamp.Environment()
    sphere.set_radius(radius)
    sphere.set_lows([*low.tolist(), 0.0])
    sphere.set_highs([*high.tolist(), 0.0])
    environment.add_pointcloud([[x, y, 0.0] for x, y in points.tolist()], radius, radius, 0.0)
    _, search, settings, simplify = vamp.configure_robot_and_planner_with_kwargs("sphere", "rrtc")
    settings.max_iterations = settings.max_samples = SAMPLES
    numbers = sphere.halton()

    def find(start: FloatArray, goal: FloatArray) -> Found:
        found = search(np.array([*start, 0.0]), np.array([*goal, 0.0]), environment, settings, numbers)
        if not found.solved:
            return None, 1e-9 * found.nanoseconds
        simple = sphere.simplify(found.path, environment, simplify, numbers)
        return np.array(simple.path.numpy(), np.float64)[:, :2], 1e-9 * (found.nanoseconds + simple.nanoseconds)

    return find

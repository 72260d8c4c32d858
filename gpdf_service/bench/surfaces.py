"""Surfaces whose distance is known in closed form: what the fields are judged by."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gpdf_service.types import FloatArray

Truth = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True)
class Surface:
    """A surface that can be sampled.

    Attributes:
        sample: `sample(n, rng)` gives about n points on it [m], shape (n, 3).
        distance: Distance of each query to it [m], shape (m, 3) → (m,).
        core: Corners of the box in which queries keep clear of its rim [m].
    """

    sample: Callable[[int, np.random.Generator], FloatArray]
    distance: Truth
    core: tuple[tuple[float, float, float], tuple[float, float, float]]


def patches(*corners: tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]) -> tuple[Callable, Truth]:  # type: ignore[type-arg]
    """Rectangles (origin, one side, the other side), sampled evenly; the distance is the least over them."""
    made = [tuple(np.asarray(part, dtype=float) for part in corner) for corner in corners]
    areas = np.array([np.linalg.norm(u) * np.linalg.norm(v) for _, u, v in made])

    def sample(n: int, rng: np.random.Generator) -> FloatArray:
        counts = np.ceil(n * areas / areas.sum()).astype(int)
        parts = [o + rng.random((k, 1)) * u + rng.random((k, 1)) * v for (o, u, v), k in zip(made, counts, strict=True)]
        return np.concatenate(parts)

    def distance(q: FloatArray) -> FloatArray:
        found = []
        for o, u, v in made:
            a = np.clip((q - o) @ u / (u @ u), 0, 1)[:, None]
            b = np.clip((q - o) @ v / (v @ v), 0, 1)[:, None]
            found.append(np.linalg.norm(q - o - a * u - b * v, axis=1))
        nearest: FloatArray = np.minimum.reduce(found)
        return nearest

    return sample, distance


def _sphere(n: int, rng: np.random.Generator) -> FloatArray:
    points = rng.normal(size=(n, 3))
    unit: FloatArray = points / np.linalg.norm(points, axis=1, keepdims=True)
    return unit


def _pole(n: int, rng: np.random.Generator) -> FloatArray:
    angle = rng.uniform(0, 2 * np.pi, n)
    return np.column_stack([POLE * np.cos(angle), POLE * np.sin(angle), rng.uniform(-5, 5, n)])


POLE = 0.1
"""[m] Radius of the pole."""
_WAVES = ((0.12, 1.1, 0.3), (0.08, -0.4, 1.7), (0.04, 2.9, 2.3))
"""Amplitude [m] and wave numbers [rad/m] of the rough terrain."""


def _height(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Height of the terrain and its slopes."""
    z, dx, dy = np.zeros_like(x), np.zeros_like(x), np.zeros_like(x)
    for a, kx, ky in _WAVES:
        z, c = z + a * np.sin(kx * x + ky * y), a * np.cos(kx * x + ky * y)
        dx, dy = dx + kx * c, dy + ky * c
    return z, dx, dy


def _terrain(n: int, rng: np.random.Generator) -> FloatArray:
    xy = rng.uniform(-5, 5, (n, 2))
    return np.column_stack([xy, _height(xy[:, 0], xy[:, 1])[0]])


def _terrain_distance(q: FloatArray) -> FloatArray:
    """The best of a fine grid around each query, then Gauss–Newton to the foot point."""
    from scipy.spatial import cKDTree

    side = np.arange(-10, 10, 0.02)
    grid = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)
    seed = np.column_stack([grid, _height(grid[:, 0], grid[:, 1])[0]])
    xy = grid[cKDTree(seed).query(q, workers=-1)[1]].copy()
    for _ in range(20):
        z, dx, dy = _height(xy[:, 0], xy[:, 1])
        ex, ey, ez = xy[:, 0] - q[:, 0], xy[:, 1] - q[:, 1], z - q[:, 2]
        gx, gy = ex + ez * dx, ey + ez * dy
        a, b, c = 1 + dx * dx, dx * dy, 1 + dy * dy
        det = a * c - b * b
        step = np.column_stack([c * gx - b * gy, a * gy - b * gx]) / det[:, None]
        xy -= 0.5 * step * np.minimum(1.0, 0.02 / np.maximum(np.linalg.norm(step, axis=1, keepdims=True), 1e-12))
    foot = np.column_stack([xy, _height(xy[:, 0], xy[:, 1])[0]])
    distance: FloatArray = np.linalg.norm(q - foot, axis=1)
    return distance


_FLOOR = ((-5.0, -5.0, 0.0), (10.0, 0.0, 0.0), (0.0, 10.0, 0.0))
_CORE = ((-3.5, -3.5, -5.0), (3.5, 3.5, 5.0))


def _stairs(steps: int = 10, rise: float = 0.17, tread: float = 0.28) -> list[tuple[tuple[float, ...], ...]]:
    made: list[tuple[tuple[float, ...], ...]] = []
    for i in range(steps):
        x, z = i * tread - steps * tread / 2, i * rise
        made.append(((x, -2.0, z), (0.0, 4.0, 0.0), (0.0, 0.0, rise)))
        made.append(((x, -2.0, z + rise), (tread, 0.0, 0.0), (0.0, 4.0, 0.0)))
    return made


SURFACES = {
    "plane": Surface(*patches(_FLOOR), _CORE),
    "corner": Surface(*patches(_FLOOR, ((0.0, -5.0, 0.0), (0.0, 10.0, 0.0), (0.0, 0.0, 3.0))), _CORE),
    "step": Surface(
        *patches(
            ((-5.0, -5.0, 0.0), (5.0, 0.0, 0.0), (0.0, 10.0, 0.0)),
            ((0.0, -5.0, 0.35), (5.0, 0.0, 0.0), (0.0, 10.0, 0.0)),
            ((0.0, -5.0, 0.0), (0.0, 10.0, 0.0), (0.0, 0.0, 0.35)),
        ),
        _CORE,
    ),
    "sphere": Surface(_sphere, lambda q: np.abs(np.linalg.norm(q, axis=1) - 1.0), ((-9, -9, -9), (9, 9, 9))),
    "pole": Surface(_pole, lambda q: np.abs(np.hypot(q[:, 0], q[:, 1]) - POLE), ((-9.0, -9.0, -3.5), (9.0, 9.0, 3.5))),
    "board": Surface(
        *patches(
            ((-2.0, -0.01, 0.0), (4.0, 0.0, 0.0), (0.0, 0.0, 2.0)),
            ((-2.0, 0.01, 0.0), (4.0, 0.0, 0.0), (0.0, 0.0, 2.0)),
        ),
        ((-1.5, -9.0, 0.3), (1.5, 9.0, 1.7)),
    ),
    "stairs": Surface(*patches(*_stairs()), ((-1.0, -1.5, -5.0), (1.0, 1.5, 9.0))),  # type: ignore[arg-type]
    "terrain": Surface(_terrain, _terrain_distance, _CORE),
}

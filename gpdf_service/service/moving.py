"""What moves in a scene: obstacles with a lifetime, merged with the scanned ones when somebody asks."""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from gpdf_schemas import Cylinder, MovingObstacle

from gpdf_service.scene import Scene
from gpdf_service.types import FloatArray

SPACING = 0.05
"""[m] Between the points of a cylinder's side: half of the lowest body's height, so that one of them is in its way."""
FILL = 0.1
"""[m] Between the points inside: no body has its centre in there and its side clear of them."""
LARGEST = 10.0
"""[m] Radius and height of a cylinder at most: a tram; beyond, it belongs into the map."""
MAX_POINTS = 200_000
"""Of all obstacles of one scene together: what a laser scanner sees in a second."""
MAX_LIFETIME_S = 3600.0
"""[s] What is there for longer belongs into the map."""
Clock = Callable[[], float]


@dataclass(frozen=True, slots=True)
class _Living:
    points: FloatArray
    until: float
    number: int


class Moving:
    """All moving obstacles of a service, by scene and id; safe for many threads.

    Args:
        clock: Monotonic seconds.
    """

    def __init__(self, clock: Clock = time.monotonic) -> None:
        self._clock = clock
        self._living: dict[str, dict[str, _Living]] = {}
        self._merged: dict[str, tuple[Scene, tuple[int, ...], Scene]] = {}
        self._numbers = itertools.count()
        self._lock = threading.Lock()

    def publish(self, scene: str, obstacles: Sequence[MovingObstacle]) -> None:
        """Take what somebody saw; each takes the place of the one before with its id.

        Raises:
            ValueError: one has no sense (the others are taken), or all together have too many points (none is).
        """
        now = self._clock()
        seen, wrong = {}, []
        for obstacle in obstacles:
            until = now + min(obstacle.lifetime_s, MAX_LIFETIME_S)
            try:
                seen[obstacle.id] = _Living(points_of(obstacle), until, next(self._numbers))
            except ValueError as error:
                wrong.append(str(error))
        with self._lock:
            living = {**self._alive(scene, now), **seen}
            living = {id_: one for id_, one in living.items() if one.until > now}
            if sum(len(one.points) for one in living.values()) > MAX_POINTS:
                raise ValueError(f"scene {scene!r} would have more than {MAX_POINTS} points that move. Thin them.")
            self._living[scene] = living
            self._living = {name: found for name, found in self._living.items() if found}
        if wrong:
            raise ValueError(" ".join(wrong))

    def merged(self, name: str, scene: Scene, more: Sequence[MovingObstacle] = ()) -> Scene:
        """The scene with everything that moves in it now, and with `more`.

        Raises:
            ValueError: `more` has too many points, or no sense.
        """
        with self._lock:
            living = self._alive(name, self._clock())
            numbers = tuple(one.number for one in living.values())
            known = self._merged.get(name)
            if known is None or known[0] is not scene or known[1] != numbers:
                whole = scene.with_obstacles(_stacked([one.points for one in living.values()])) if numbers else scene
                known = (scene, numbers, whole)
                if numbers:
                    self._merged[name] = known  # its free spaces serve until something changes
                else:
                    self._merged.pop(name, None)
        if not more:
            return known[2]
        points = _stacked([points_of(obstacle) for obstacle in more])
        if len(points) > MAX_POINTS:
            raise ValueError(f"the request has {len(points)} points that move, at most {MAX_POINTS}. Thin them.")
        return known[2].with_obstacles(points)

    def _alive(self, scene: str, now: float) -> dict[str, _Living]:
        return {id_: one for id_, one in self._living.get(scene, {}).items() if one.until > now}


def points_of(obstacle: MovingObstacle) -> FloatArray:
    """An obstacle as points, shape (k, 3) [m].

    Raises:
        ValueError: no shape at all, an array of another shape, a cylinder that is none.
    """
    parts: list[FloatArray] = []
    if obstacle.points is not None:
        points = obstacle.points.unpack()
        if points.ndim != 2 or points.shape[1] != 3:
            raise ValueError(f"obstacle {obstacle.id!r}: points of shape {points.shape}. Send an array (k, 3).")
        parts.append(points)
    if obstacle.cylinder is not None:
        parts.append(_cylinder_points(obstacle.id, obstacle.cylinder))
    if not parts and obstacle.lifetime_s > 0:
        raise ValueError(f"obstacle {obstacle.id!r}: neither points nor a cylinder. Send one of them.")
    return _stacked(parts)


def _cylinder_points(id_: str, cylinder: Cylinder) -> FloatArray:
    """Its side and its inside, layer by layer; the side a little outside, so that chords do not cut the circle."""
    radius, height = cylinder.radius, cylinder.height
    if not (0 < radius <= LARGEST and 0 < height <= LARGEST):
        raise ValueError(f"obstacle {id_!r}: radius {radius}, height {height}. Give more than 0, at most {LARGEST} m.")
    count = max(8, int(np.ceil(2 * np.pi * radius / SPACING)))
    angle = 2 * np.pi * np.arange(count) / count
    ring = np.column_stack([np.cos(angle), np.sin(angle)]) * radius / np.cos(np.pi / count)
    x, y = np.meshgrid(*[np.arange(-radius, radius + FILL, FILL)] * 2)
    inside = np.column_stack([x.ravel(), y.ravel()])
    disc = np.concatenate([ring, inside[np.hypot(*inside.T) < radius]])
    z = np.linspace(0.0, height, max(2, int(np.ceil(height / SPACING)) + 1))
    layers = np.column_stack([np.tile(disc, (len(z), 1)), np.repeat(z, len(disc))])
    placed: FloatArray = layers + np.array(cylinder.base)
    return placed


def _stacked(parts: Sequence[FloatArray]) -> FloatArray:
    return np.concatenate([np.zeros((0, 3)), *parts])

"""Scenes made of exact shapes: their true ground, the true room around a body, and samples of what a scanner sees."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from gpdf_service.types import BoolArray, FloatArray

TOUCH = 1e-6
"""[m] Shapes that touch do not overlap."""


@dataclass(frozen=True, slots=True)
class Box:
    """An upright box from `low` to `high` [m]; with `walkable`, its top is ground (a platform, a stair's tread)."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    walkable: bool = False

    def distance(self, contacts: FloatArray, height: float) -> FloatArray:
        """Distance in plan from upright axes at `contacts` (m, 3), `height` tall; inf where it is above or below."""
        low, high = np.array(self.low), np.array(self.high)
        gap = np.maximum(np.maximum(low[:2] - contacts[:, :2], contacts[:, :2] - high[:2]), 0.0)
        beside = (high[2] > contacts[:, 2] + TOUCH) & (low[2] < contacts[:, 2] + height - TOUCH)
        return np.where(beside, np.hypot(*gap.T), np.inf)

    def covers(self, points: FloatArray) -> BoolArray:
        """Whether points (m, 3) lie inside, the surface not counted."""
        axes = zip(points.T, self.low, self.high, strict=True)
        x, y, z = ((column > low + TOUCH) & (column < high - TOUCH) for column, low, high in axes)
        inside: BoolArray = x & y & z
        return inside

    def hides(self, points: FloatArray) -> BoolArray:
        """Whether points of other shapes lie inside or against a side or the underside."""
        axes = zip(points.T, self.low, self.high, (TOUCH, TOUCH, -TOUCH), strict=True)
        x, y, z = ((column >= low - TOUCH) & (column <= high + over) for column, low, high, over in axes)
        inside: BoolArray = x & y & z
        return inside

    def sample(self, spacing: float, rng: np.random.Generator) -> tuple[FloatArray, BoolArray]:
        """Points on its faces, and which are its top."""
        low, size = np.array(self.low), np.array(self.high) - np.array(self.low)
        faces, tops = [], []
        for axis in range(3):
            other = [k for k in range(3) if k != axis]
            for end in (0.0, 1.0):
                uv = _grid(size[other[0]], size[other[1]], spacing, rng)
                face = np.zeros((len(uv), 3))
                face[:, other], face[:, axis] = uv, end * size[axis]
                faces.append(face + low)
                tops.append(np.full(len(uv), axis == 2 and end == 1.0))
        return np.concatenate(faces), np.concatenate(tops)


@dataclass(frozen=True, slots=True)
class Sphere:
    """A ball [m]."""

    center: tuple[float, float, float]
    radius: float

    def distance(self, contacts: FloatArray, height: float) -> FloatArray:
        """See `Box.distance`."""
        z = np.clip(self.center[2], contacts[:, 2], contacts[:, 2] + height) - self.center[2]
        reach = np.sqrt(np.maximum(self.radius**2 - z**2, 0.0))
        gap = np.maximum(np.hypot(*(contacts[:, :2] - self.center[:2]).T) - reach, 0.0)
        return np.where(np.abs(z) < self.radius, gap, np.inf)

    def covers(self, points: FloatArray) -> BoolArray:
        """See `Box.covers`."""
        inside: BoolArray = np.linalg.norm(points - self.center, axis=1) < self.radius - TOUCH
        return inside

    def sample(self, spacing: float, rng: np.random.Generator) -> tuple[FloatArray, BoolArray]:
        """See `Box.sample`."""
        points = rng.normal(size=(int(4 * np.pi * self.radius**2 / spacing**2) + 8, 3))
        points *= self.radius / np.linalg.norm(points, axis=1, keepdims=True)
        return points + self.center, np.zeros(len(points), dtype=bool)


@dataclass(frozen=True, slots=True)
class Pillar:
    """An upright cylinder [m]: `foot` is the centre of its base."""

    foot: tuple[float, float, float]
    radius: float
    height: float

    def distance(self, contacts: FloatArray, height: float) -> FloatArray:
        """See `Box.distance`."""
        gap = np.maximum(np.hypot(*(contacts[:, :2] - self.foot[:2]).T) - self.radius, 0.0)
        top = self.foot[2] + self.height
        beside = (top > contacts[:, 2] + TOUCH) & (self.foot[2] < contacts[:, 2] + height - TOUCH)
        return np.where(beside, gap, np.inf)

    def covers(self, points: FloatArray) -> BoolArray:
        """See `Box.covers`."""
        near = np.hypot(*(points[:, :2] - self.foot[:2]).T) < self.radius - TOUCH
        inside: BoolArray = near & (points[:, 2] > self.foot[2]) & (points[:, 2] < self.foot[2] + self.height - TOUCH)
        return inside

    def sample(self, spacing: float, rng: np.random.Generator) -> tuple[FloatArray, BoolArray]:
        """See `Box.sample`."""
        uv = _grid(2 * np.pi * self.radius, self.height, spacing, rng)
        angle = uv[:, 0] / self.radius
        side = np.column_stack([self.radius * np.cos(angle), self.radius * np.sin(angle), uv[:, 1]])
        cap = _grid(2 * self.radius, 2 * self.radius, spacing, rng) - self.radius
        cap = cap[np.hypot(*cap.T) <= self.radius]
        points = np.concatenate([side, np.column_stack([cap, np.full(len(cap), self.height)])])
        return points + self.foot, np.zeros(len(points), dtype=bool)


Shape = Box | Sphere | Pillar


def _flat(xy: FloatArray) -> FloatArray:
    return np.zeros(len(xy))


@dataclass(frozen=True, slots=True)
class World:
    """A room of `size` (x, y, height) [m] with walls, a floor, and shapes in it; exact answers.

    Attributes:
        size: The room; its inner walls are x = 0, x = size[0], y = 0, y = size[1].
        shapes: What stands or hangs in it.
        floor: Height of the floor at (m, 2) → (m,).
        ceiling: Height of the ceiling over the floor is `size[2]` where True.
    """

    size: tuple[float, float, float]
    shapes: tuple[Shape, ...]
    floor: Callable[[FloatArray], FloatArray] = field(default=_flat)
    ceiling: bool = True

    def ground_height(self, xy: FloatArray) -> FloatArray:
        """True height of the ground [m], shape (m,), at (m, 2); NaN outside the room and inside what stands on it."""
        height = np.asarray(self.floor(xy), dtype=np.float64).copy()
        for shape in self.shapes:
            if isinstance(shape, Box) and shape.walkable:
                on = ((xy >= np.array(shape.low[:2])) & (xy <= np.array(shape.high[:2]))).all(axis=1)
                height = np.where(on, np.maximum(height, shape.high[2]), height)
        inside = ((xy >= 0) & (xy <= np.array(self.size[:2]))).all(axis=1)
        probe = np.column_stack([xy, height + 1e-3])
        for shape in self.shapes:
            inside &= ~shape.covers(probe)
        return np.where(inside, height, np.nan)

    def body_clearance(self, contacts: FloatArray, radius: float, height: float, max_step: float) -> FloatArray:
        """True room around an upright cylinder that stands at `contacts`, shape (m, 3): distance in plan less `radius`.

        Walls, shapes beside the body, platforms higher than `max_step`, and drops of more than that count.
        """
        x, y = contacts[:, 0], contacts[:, 1]
        room = np.minimum.reduce([x, self.size[0] - x, y, self.size[1] - y])
        for shape in self.shapes:
            distance = shape.distance(contacts, height)
            if isinstance(shape, Box) and shape.walkable:
                rise = shape.high[2] - contacts[:, 2]
                distance = np.where(np.abs(rise) <= max_step + TOUCH, np.inf, distance)
                on = (np.abs(rise) <= TOUCH) & (rise > -TOUCH)
                drop = contacts[:, 2] - self.floor(contacts[:, :2]) > max_step + TOUCH
                edge = np.minimum.reduce([x - shape.low[0], shape.high[0] - x, y - shape.low[1], shape.high[1] - y])
                distance = np.where(on & drop & (edge >= 0), np.minimum(distance, edge), distance)
            room = np.minimum(room, distance)
        clearance: FloatArray = room - radius
        return clearance

    def sample(self, spacing: float, rng: np.random.Generator, noise: float = 0.0) -> tuple[FloatArray, BoolArray]:
        """A scan: points (n, 3) on every surface that can be seen, and which are ground, (n,).

        Args:
            spacing: Between points [m].
            rng: Source of the jitter and the noise.
            noise: Standard deviation of each coordinate [m].
        """
        xy = _grid(self.size[0], self.size[1], spacing, rng)
        parts = [np.column_stack([xy, self.floor(xy)])]
        ground = [np.ones(len(xy), dtype=bool)]
        if self.ceiling:
            over = _grid(self.size[0], self.size[1], spacing, rng)
            parts.append(np.column_stack([over, self.floor(over) + self.size[2]]))
        for axis, length in ((0, self.size[1]), (1, self.size[0])):
            for side in (0.0, self.size[axis]):
                uv = _grid(length, self.size[2], spacing, rng)
                wall = np.zeros((len(uv), 3))
                wall[:, 1 - axis], wall[:, axis] = uv[:, 0], side
                wall[:, 2] = self.floor(wall[:, :2]) + uv[:, 1]
                parts.append(wall)
        ground += [np.zeros(len(part), dtype=bool) for part in parts[1:]]
        for shape in self.shapes:
            points, top = shape.sample(spacing, rng)
            hidden = [other.hides(points) for other in self.shapes if isinstance(other, Box) and other is not shape]
            shown = ~np.logical_or.reduce([np.zeros(len(points), dtype=bool), *hidden])
            points, top = points[shown], top[shown]
            parts.append(points)
            ground.append(top & (isinstance(shape, Box) and shape.walkable))
        points, mask = np.concatenate(parts), np.concatenate(ground)
        floor = self.floor(points[:, :2])
        seen = points[:, 2] >= floor - TOUCH
        seen &= ~((points[:, 2] <= floor + TOUCH) & ~mask)  # the underside of what stands
        lifted = points + np.array([0.0, 0.0, 1e-4]) * mask[:, None]  # floor under a box that stands on it
        for shape in self.shapes:
            seen &= ~shape.covers(lifted)
        points = points[seen]
        return points + rng.normal(0.0, 1.0, points.shape) * noise, mask[seen]


def _grid(width: float, depth: float, spacing: float, rng: np.random.Generator) -> FloatArray:
    """Jittered grid over [0, width] × [0, depth], shape (n, 2)."""
    counts = [max(1, round(length / spacing)) for length in (width, depth)]
    index = np.stack(np.meshgrid(*(np.arange(n) for n in counts), indexing="ij"), axis=-1).reshape(-1, 2)
    return (index + rng.uniform(0.0, 1.0, index.shape)) / counts * [width, depth]

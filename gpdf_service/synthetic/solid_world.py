"""Worlds of convex solids: what a ray meets, where the ground is, where a body is free; exact, for any place."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from typing import Any

import numpy as np

from gpdf_service.synthetic.solids import Solid
from gpdf_service.types import BoolArray, FloatArray, IntArray

OUTSIDE = 1e-4
"""[m] A place this far out of a face is in no other solid, or nobody sees the face there."""
HIGH = 100.0
"""[m] Over everything: where rays that look for ground begin."""


@dataclass(frozen=True)
class Hits:
    """What rays met: distance along each [m], inf where nothing; the triangle's number, -1 where nothing."""

    distance: FloatArray
    triangle: IntArray


@dataclass(frozen=True)
class SolidWorld:
    """A world of convex solids.

    Attributes:
        solids: What it is made of; they may touch and overlap.
    """

    solids: tuple[Solid, ...]

    @cached_property
    def triangles(self) -> FloatArray:
        """All faces [m], shape (n, 3, 3)."""
        return np.concatenate([solid.triangles for solid in self.solids])

    @cached_property
    def walkable(self) -> BoolArray:
        """Which triangles are ground, shape (n,)."""
        return np.concatenate([solid.walkable for solid in self.solids])

    @cached_property
    def kinds(self) -> tuple[str, ...]:
        """The kinds that occur, sorted."""
        return tuple(sorted({solid.kind for solid in self.solids}))

    @cached_property
    def kind(self) -> IntArray:
        """Of each triangle, which of `kinds` it is, shape (n,)."""
        return np.concatenate([np.full(len(s.triangles), self.kinds.index(s.kind)) for s in self.solids])

    @cached_property
    def _caster(self) -> Any:  # noqa: ANN401 - a class of Open3D, without types
        return _caster(self.triangles)

    @cached_property
    def _ground_caster(self) -> Any:  # noqa: ANN401
        return _caster(self.triangles[self.walkable])

    def cast(self, origins: FloatArray, directions: FloatArray) -> Hits:
        """The first triangle that each ray meets.

        Args:
            origins: Where rays begin [m], shape (n, 3).
            directions: Unit vectors, shape (n, 3).
        """
        return _cast(self._caster, origins, directions)

    def moved(self, T_world_solid: FloatArray) -> SolidWorld:
        """The same world after a rigid motion (4, 4)."""
        return SolidWorld(tuple(solid.moved(T_world_solid) for solid in self.solids))

    def ground_under(self, places: FloatArray, reach: float = HIGH) -> FloatArray:
        """Height of the highest ground at or under each place [m], shape (m,); NaN where there is none within `reach`.

        Args:
            places: Shape (m, 3); ground up to 1 mm over a place counts as at it.
            reach: How far down [m].
        """
        down = np.broadcast_to(np.array([0.0, 0.0, -1.0]), places.shape)
        began = places + np.array([0.0, 0.0, 1e-3])
        distance = _cast(self._ground_caster, began, down).distance
        return np.where(distance <= reach, began[:, 2] - distance, np.nan)

    def sample(
        self, spacing: float, headroom: float = 2.0, within: FloatArray | None = None
    ) -> tuple[FloatArray, BoolArray]:
        """Points on everything that a body could touch, about `spacing` apart: what the judges take for the truth.

        Args:
            spacing: At most this between two of them [m].
            headroom: Ground with other ground less than this over it is left out: the floor under a flight [m].
            within: Lowest and highest corner of the box that is asked for [m], (2, 3); all where it is None.

        Returns:
            Points [m], shape (n, 3), and which are ground, shape (n,).
        """
        low, high = np.array([[-np.inf] * 3, [np.inf] * 3]) if within is None else within
        near = (self.triangles.max(axis=1) >= low).all(axis=1) & (self.triangles.min(axis=1) <= high).all(axis=1)
        points, which = sample_triangles(self.triangles[near], spacing)
        inside = ((points >= low) & (points <= high)).all(axis=1)
        points, triangle = points[inside], np.flatnonzero(near)[which[inside]]
        normals = np.concatenate([solid.normals for solid in self.solids])
        seen = ~self._covered(points + OUTSIDE * normals[triangle])
        points, ground = points[seen], self.walkable[triangle[seen]]
        keep = ~ground
        keep[ground] = ~self._under_ground(points[ground], headroom)
        return points[keep], ground[keep]

    def _under_ground(self, points: FloatArray, headroom: float) -> BoolArray:
        over = self.ground_under(points + np.array([0.0, 0.0, headroom]), headroom)
        low: BoolArray = over > points[:, 2] + 1e-2
        return low

    def _covered(self, points: FloatArray) -> BoolArray:
        """Whether points lie in any solid, shape (m,)."""
        order = np.argsort(points[:, 0])
        x = points[order, 0]
        covered = np.zeros(len(points), dtype=bool)
        for solid in self.solids:
            low, high = solid.triangles.min(axis=(0, 1)), solid.triangles.max(axis=(0, 1))
            rows = order[np.searchsorted(x, low[0]) : np.searchsorted(x, high[0], side="right")]
            y, z = points[rows, 1], points[rows, 2]
            rows = rows[(y >= low[1]) & (y <= high[1]) & (z >= low[2]) & (z <= high[2]) & ~covered[rows]]
            covered[rows] = solid.covers(points[rows])
        return covered


def sample_triangles(triangles: FloatArray, spacing: float) -> tuple[FloatArray, IntArray]:
    """Points on triangles, edges included, at most `spacing` apart along both sides: points (m, 3), whose they are."""
    parts, whose = [], []
    for row, corners in enumerate(triangles):
        sides = corners[[1, 2, 0]] - corners
        longest = int(np.argmax(np.linalg.norm(sides, axis=1)))
        a, u, v = corners[longest], sides[longest], corners[(longest + 2) % 3] - corners[longest]
        length = float(np.linalg.norm(u))
        tall = float(np.linalg.norm(np.cross(u, v))) / length
        foot = float(v @ u) / length**2
        n = int(np.ceil(tall / spacing)) + 1
        for t in np.linspace(0.0, 1.0, n):
            count = int(np.ceil((1.0 - t) * length / spacing)) + 1
            s = np.linspace(t * foot, t * foot + 1.0 - t, count)
            parts.append(a + s[:, None] * u + t * (v - foot * u))
            whose.append(np.full(count, row))
    return np.concatenate(parts), np.concatenate(whose)


def _caster(triangles: FloatArray) -> Any:  # noqa: ANN401
    open3d: Any = import_module("open3d")  # its stubs refuse what it takes
    scene = open3d.t.geometry.RaycastingScene(nthreads=1)
    corners = np.ascontiguousarray(triangles.reshape(-1, 3), dtype=np.float32)
    numbers = np.arange(len(corners), dtype=np.uint32).reshape(-1, 3)
    scene.add_triangles(open3d.core.Tensor(corners), open3d.core.Tensor(numbers))
    return scene


def _cast(caster: Any, origins: FloatArray, directions: FloatArray) -> Hits:  # noqa: ANN401
    open3d: Any = import_module("open3d")  # its stubs refuse what it takes
    rays = np.ascontiguousarray(np.hstack([origins, directions]), dtype=np.float32)
    found = caster.cast_rays(open3d.core.Tensor(rays))
    triangle = found["primitive_ids"].numpy().astype(np.int64)
    distance = found["t_hit"].numpy().astype(np.float64)
    return Hits(distance, np.where(np.isfinite(distance), triangle, -1))

"""Convex solids made of triangles: prisms, boxes, boards along a line, balls. What exact worlds are built of."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from gpdf_service.types import BoolArray, FloatArray

ROUND = 16
"""Sides of what is round: off a circle by 2 % of its radius."""
UP = 0.99
"""[-] Upward part of the unit normal of a level face."""


@dataclass(frozen=True, slots=True)
class Solid:
    """A convex body of one kind.

    Attributes:
        kind: What it is, in words: "floor", "tread", "table" …
        triangles: Corners of its faces [m], shape (n, 3, 3); the winding does not matter.
        walkable: Which faces are ground, shape (n,).
    """

    kind: str
    triangles: FloatArray
    walkable: BoolArray

    @property
    def normals(self) -> FloatArray:
        """Outward unit normals of the faces, shape (n, 3)."""
        a, b, c = self.triangles.transpose(1, 0, 2)
        normal = np.cross(b - a, c - a)
        outward = ((a - self.triangles.reshape(-1, 3).mean(axis=0)) * normal).sum(axis=1)
        normal *= np.where(outward < 0.0, -1.0, 1.0)[:, None]
        made: FloatArray = normal / np.linalg.norm(normal, axis=1, keepdims=True)
        return made

    def covers(self, points: FloatArray) -> BoolArray:
        """Whether points (m, 3) lie in it, its surface not counted, shape (m,)."""
        normals = self.normals
        limit = (normals * self.triangles[:, 0]).sum(axis=1)
        inside: BoolArray = (points @ normals.T < limit - 1e-9).all(axis=1)
        return inside

    def moved(self, T_world_solid: FloatArray) -> Solid:
        """The same after a rigid motion (or a reflection), given as (4, 4)."""
        return replace(self, triangles=self.triangles @ T_world_solid[:3, :3].T + T_world_solid[:3, 3])


def prism(kind: str, outline: ArrayLike, low: ArrayLike, high: ArrayLike, *, walkable: bool = False) -> Solid:
    """An upright prism over a convex outline; its top and bottom may be inclined.

    Args:
        kind: What it is.
        outline: Corners in plan, in order [m], shape (k, 2).
        low: Height of the bottom, of all corners or of each [m].
        high: The same of the top.
        walkable: Whether the top is ground.
    """
    xy = np.asarray(outline, dtype=np.float64)
    k = len(xy)
    bottom = np.column_stack([xy, np.broadcast_to(np.asarray(low, dtype=np.float64), k)])
    top = np.column_stack([xy, np.broadcast_to(np.asarray(high, dtype=np.float64), k)])
    fan = [(0, i, i + 1) for i in range(1, k - 1)]
    faces = [top[list(corner)] for corner in fan] + [bottom[list(corner)] for corner in fan]
    for i in range(k):
        j = (i + 1) % k
        faces += [np.stack([bottom[i], bottom[j], top[j]]), np.stack([bottom[i], top[j], top[i]])]
    triangles = np.array(faces)
    ground = np.zeros(len(triangles), dtype=bool)
    ground[: len(fan)] = walkable
    area = np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1)
    return Solid(kind, triangles[area > 1e-12], ground[area > 1e-12])


def box(kind: str, low: ArrayLike, high: ArrayLike, *, walkable: bool = False) -> Solid:
    """An upright box from its lowest to its highest corner [m]."""
    (x0, y0, z0), (x1, y1, z1) = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
    return prism(kind, [(x0, y0), (x1, y0), (x1, y1), (x0, y1)], z0, z1, walkable=walkable)


def post(kind: str, foot: ArrayLike, radius: float, height: float, sides: int = ROUND) -> Solid:
    """An upright cylinder on `foot` (3,) [m]."""
    x, y, z = np.asarray(foot, dtype=np.float64)
    angle = 2 * np.pi * np.arange(sides) / sides
    return prism(kind, np.column_stack([x + radius * np.cos(angle), y + radius * np.sin(angle)]), z, z + height)


def board(kind: str, a: ArrayLike, b: ArrayLike, thickness: float, below: float, above: float) -> Solid:
    """An upright board along the line from `a` to `b`, (3,) each [m], which may rise.

    Args:
        kind: What it is.
        a: Where the line begins.
        b: Where it ends.
        thickness: Across the line, half to either side [m].
        below: From the board's lower edge up to the line [m].
        above: From the line up to its upper edge [m].
    """
    one, two = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    along = two[:2] - one[:2]
    aside = 0.5 * thickness * np.array([-along[1], along[0]]) / np.hypot(*along)
    outline = [one[:2] - aside, two[:2] - aside, two[:2] + aside, one[:2] + aside]
    z = np.array([one[2], two[2], two[2], one[2]])
    return prism(kind, outline, z - below, z + above)


def ball(kind: str, center: ArrayLike, radius: float) -> Solid:
    """A ball, as a convex body of 8 rings of `ROUND` corners."""
    rings = np.linspace(0.0, np.pi, 9)
    turn = 2 * np.pi * np.arange(ROUND) / ROUND
    corner = np.stack(
        [
            np.sin(rings)[:, None] * np.cos(turn),
            np.sin(rings)[:, None] * np.sin(turn),
            np.broadcast_to(np.cos(rings)[:, None], (9, ROUND)),
        ],
        axis=-1,
    )
    triangles = []
    for i in range(8):
        for j in range(ROUND):
            k = (j + 1) % ROUND
            triangles += [corner[[i, i + 1, i + 1], [j, j, k]]] if i < 8 - 1 else []
            triangles += [corner[[i, i + 1, i], [j, k, k]]] if i > 0 else []
    made = np.asarray(center, dtype=np.float64) + radius * np.array(triangles)
    return Solid(kind, made, np.zeros(len(made), dtype=bool))


def turn_and_shift(angle: float, shift: ArrayLike = (0.0, 0.0, 0.0)) -> FloatArray:
    """A rigid motion about the vertical [rad], then by `shift` (3,) [m], as (4, 4)."""
    T = np.eye(4)
    c, s = np.cos(angle), np.sin(angle)
    T[:2, :2] = [[c, -s], [s, c]]
    T[:3, 3] = shift
    return T

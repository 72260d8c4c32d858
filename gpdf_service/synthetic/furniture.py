"""What stands in rooms, as solids: tables, chairs, beds, cupboards, people; nobody walks on any of it."""

from __future__ import annotations

import numpy as np

from gpdf_service.synthetic.solids import Solid, ball, box, post
from gpdf_service.types import FloatArray

Corner = tuple[float, float, float]


def table(corner: Corner, size: tuple[float, float], height: float = 0.74) -> list[Solid]:
    """A top on four legs; its lower corner on the floor, its sides in plan [m]."""
    x, y, z = corner
    top = box("table", (x, y, z + height - 0.03), (x + size[0], y + size[1], z + height))
    legs = [
        post("table", (x + dx, y + dy, z), 0.025, height - 0.03, 8)
        for dx in (0.06, size[0] - 0.06)
        for dy in (0.06, size[1] - 0.06)
    ]
    return [top, *legs]


def chair(corner: Corner) -> list[Solid]:
    """A seat of 0.45 × 0.45 m at 0.45 m on four legs, with a back."""
    x, y, z = corner
    seat = table(corner, (0.45, 0.45), 0.45)
    return [*seat, box("chair", (x, y + 0.41, z + 0.45), (x + 0.45, y + 0.45, z + 0.9))]


def bed(corner: Corner) -> list[Solid]:
    """A mattress of 0.9 × 2.0 m, 0.5 m high, over 0.2 m of room."""
    x, y, z = corner
    feet = [post("bed", (x + dx, y + dy, z), 0.03, 0.2, 8) for dx in (0.05, 0.85) for dy in (0.05, 1.95)]
    return [box("bed", (x, y, z + 0.2), (x + 0.9, y + 2.0, z + 0.5)), *feet]


def cupboard(corner: Corner, size: Corner) -> list[Solid]:
    """A closed box on the floor."""
    return [box("cupboard", corner, np.asarray(corner) + size)]


def person(foot: Corner, height: float) -> list[Solid]:
    """Somebody who stands: two legs, a trunk, a head."""
    x, y, z = foot
    legs = [post("person", (x, y + dy, z), 0.08, 0.48 * height, 8) for dy in (-0.1, 0.1)]
    trunk = post("person", (x, y, z + 0.46 * height), 0.2, 0.38 * height, 8)
    return [*legs, trunk, ball("person", (x, y, z + 0.91 * height), 0.09 * height)]


def random_piece(corner: Corner, rng: np.random.Generator) -> list[Solid]:
    """A piece of furniture, at most 2 m long."""
    kind = rng.integers(4)
    if kind == 0:
        return table(corner, (float(rng.uniform(0.8, 1.6)), float(rng.uniform(0.6, 0.9))))
    if kind == 1:
        return chair(corner)
    if kind == 2:
        return bed(corner)
    return cupboard(corner, tuple(rng.uniform([0.3, 0.3, 0.4], [1.2, 0.7, 2.0]).tolist()))


def bounds_in_plan(solids: list[Solid]) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest corner in plan, (2,) each [m]."""
    corners = np.concatenate([solid.triangles.reshape(-1, 3) for solid in solids])
    return corners[:, :2].min(axis=0), corners[:, :2].max(axis=0)

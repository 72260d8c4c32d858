"""Random houses of two storeys with a stair between them, turned by any angle, for the walks over stairs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gpdf_service.synthetic.scenes import table
from gpdf_service.synthetic.world import Box, Shape, World
from gpdf_service.types import BoolArray, FloatArray

SIZE = (7.5, 5.0)
"""[m] Of both floors."""


@dataclass(frozen=True, slots=True, eq=False)
class House:
    """Cloud and labels, and where the stair is: its up-going direction [rad], its first and last edge, its half-width.

    `low` and `high` are places to stand on both floors; all are (x, y, z) [m] in the turned house.
    """

    points: FloatArray
    ground: BoolArray
    up: float
    foot: FloatArray
    head: FloatArray
    half_width: float
    low: FloatArray
    high: FloatArray

    def crossings(self, places: FloatArray) -> tuple[list[float], list[float]]:
        """Of a walk (n, 3): how far off the stair's line (n, 2) [m] and square (n, 2) [rad] its ends were crossed."""
        line = np.array([np.cos(self.up), np.sin(self.up)])
        side = np.array([-line[1], line[0]])
        changes = np.flatnonzero(np.abs(np.diff(places[:, 2])) > 0.05)
        aside: list[float] = []
        askew: list[float] = []
        for row in (changes[0], changes[-1]):
            move = places[min(row + 5, len(places) - 1), :2] - places[max(row - 4, 0), :2]
            aside.append(float(abs((places[row, :2] - self.foot[:2]) @ side)))
            askew.append(float(np.arccos(np.clip(abs(move @ line) / np.hypot(*move), 0.0, 1.0))))
        return aside, askew


def make_house(rng: np.random.Generator, spacing: float = 0.06) -> House:
    """One house: a stair along a wall, open or with a wall on its other side, and a landing at each end."""
    treads, depth, rise = int(rng.integers(13, 16)), rng.uniform(0.25, 0.3), rng.uniform(0.165, 0.185)
    width, begin, storey = rng.uniform(1.0, 1.3), rng.uniform(1.1, 1.4), 0.0
    storey, end = (treads + 1) * rise, begin + treads * depth
    shapes: list[Shape] = [
        Box((begin + i * depth, 0.0, 0.0), (begin + (i + 1) * depth, width, (i + 1) * rise), walkable=True)
        for i in range(treads)
    ]
    slabs = [((0.0, width), SIZE), ((0.0, 0.0), (begin - 0.6, width)), ((end, 0.0), (SIZE[0], width))]  # headroom
    shapes += [Box((*low, storey - 0.2), (*high, storey), walkable=True) for low, high in slabs]
    shapes += table(4.5, 3.8, 1.6, 0.8)
    if rng.random() < 0.5:
        shapes.append(Box((begin, width, 0.0), (end, width + 0.1, storey + 1.0)))
    points, ground = World((*SIZE, storey + 2.6), tuple(shapes), ceiling=False).sample(spacing, rng)
    up = rng.uniform(-np.pi, np.pi)
    turn = np.array([[np.cos(up), -np.sin(up), 0.0], [np.sin(up), np.cos(up), 0.0], [0.0, 0.0, 1.0]])
    stand = [(rng.uniform(1.0, 6.5), rng.uniform(2.0, 3.0), z) for z in (0.0, storey)]
    marks = np.array([(begin, width / 2, 0.0), (end, width / 2, storey), *stand]) @ turn.T
    return House(points @ turn.T, ground, up, marks[0], marks[1], width / 2, marks[2], marks[3])

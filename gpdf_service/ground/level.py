"""Levels: the sheets of ground, what is within reach over each, and where they meet."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gpdf_service.ground.limits import GroundLimits, Measured, find_limits
from gpdf_service.tiles.boxes import WHOLE, Box, highest_around, lowest_around
from gpdf_service.tiles.rows import between, chosen_rows, under
from gpdf_service.tiles.surface import OBSERVED, UNKNOWN, HeightMap, cells_within
from gpdf_service.types import BoolArray, Float32Array, FloatArray

OVERLAP = 1.2
"""[m] How far a sheet reaches into the next: twice the largest body's radius, so that a body fits where they meet."""
TALLEST = 3.0
"""[m] Material higher than this over the ground is out of every body's reach."""
Touched = tuple[tuple[int, BoolArray | None], ...]
"""For each level which one of those before it was made from, −1 where there was none, and the cells in which anything
is another than there, shape (nx, ny), None where nothing is."""


@dataclass(frozen=True)
class GroundLevel:
    """One sheet of ground.

    Attributes:
        surface: Its height map.
        other_points: What is not this ground and within reach over it [m], shape (m, 3).
        ledge: Height of the lowest point of this ground that is as high as each of them, within `FACE` in plan
            [m], shape (m,), inf where there is none: a step's face has the step's top beside it.
        measured: Steps and slopes of the ground, the same for all bodies.
        edges: Cells in which material guards the ground's edge, and those on a ridge, each of shape (nx, ny).
    """

    surface: HeightMap
    other_points: FloatArray
    ledge: Float32Array
    measured: Measured
    edges: tuple[BoolArray, BoolArray]

    @cached_property
    def limits(self) -> GroundLimits:
        """Where the ground itself stops a body."""
        return self.limits_in(np.ones(self.surface.state.shape, dtype=bool))

    def limits_in(self, cells: BoolArray) -> GroundLimits:
        """Where it does so in some cells, shape (nx, ny)."""
        return find_limits(self.surface, self.edges[0], self.measured, self.edges[1], cells)

    @property
    def ground_points(self) -> FloatArray:
        """Centres of the known cells, for the Ground GPDF [m], shape (n, 3)."""
        return self.surface.centres(self.surface.state != UNKNOWN)

    @property
    def inferred(self) -> BoolArray:
        """Which of the `ground_points` nobody has seen, shape (n,)."""
        state = self.surface.state
        guessed: BoolArray = state[state != UNKNOWN] != OBSERVED
        return guessed


@dataclass(frozen=True, slots=True)
class Portal:
    """Where the sheets `a` and `b` are the same ground: points [m], shape (k, 3)."""

    a: int
    b: int
    points: FloatArray


@dataclass(frozen=True, slots=True)
class Levels:
    """All sheets, and the portals between them."""

    levels: tuple[GroundLevel, ...]
    portals: tuple[Portal, ...]


def within_reach(points: FloatArray, surface: HeightMap, box: Box = WHOLE) -> FloatArray:
    """Points between a cell under the lowest known ground near them and `TALLEST` over the highest.

    The `box` of cells holds all points, and `OVERLAP` around them.
    """
    low, high = lowest_and_highest(surface, box)
    cell = cells_within(points, surface, box)
    return chosen_rows(points, between(cell, points[:, 2], under(low - surface.cell_width), high + TALLEST))


def lowest_and_highest(surface: HeightMap, box: Box = WHOLE) -> tuple[FloatArray, FloatArray]:
    """Height of the lowest and of the highest known ground within `OVERLAP` [m], shape (nx, ny), in a box of cells."""
    rings = int(np.ceil(OVERLAP / surface.cell_width))
    known, height = surface.state[box] != UNKNOWN, surface.height[box]
    low = lowest_around(np.where(known, height, np.inf), rings)
    high = highest_around(np.where(known, height, -np.inf), rings)
    return low, high

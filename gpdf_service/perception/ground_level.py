"""One level of the ground, and the data that its making hands on."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from gpdf_service.config import PerceptionConfig
from gpdf_service.perception.cloud import Cloud
from gpdf_service.perception.limits import GroundLimits, Measured, find_limits
from gpdf_service.perception.rays import Rays
from gpdf_service.perception.segment import LEAST_SCATTER
from gpdf_service.tiles.layers import Layers
from gpdf_service.tiles.surface import OBSERVED, UNKNOWN, HeightMap
from gpdf_service.tiles.told import Grid
from gpdf_service.types import BoolArray, Float32Array, FloatArray, IntArray


@dataclass(frozen=True)
class GroundLevel:
    """One sheet of ground.

    Attributes:
        surface: Its height map.
        other_points: What is not this ground and within reach over it [m], shape (m, 3).
        ledge: Height of the lowest point of this ground that is as high as each of them, within `face_reach` in plan
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


class Part(NamedTuple):
    """The nodes of a sheet, and the box of cells that holds it: its lower corner [m], first cell and shape."""

    nodes: IntArray
    origin: FloatArray
    first: tuple[int, int]
    shape: tuple[int, int]


@dataclass(frozen=True, slots=True)
class Site:
    """What all levels of a cloud are made of.

    Attributes:
        cloud: Its points, by numbers up to n.
        ground: Which of them are ground, shape (n,).
        stray: Which count for nothing, shape (n,).
        layers: Of the ground points.
        cells: The columns that hold other points than in the version before, and those beside; in a build all.
        config: Limits.
        noise: Standard deviation that the points had before they were cured [m].
        rays: Of the scan, where they are known.
    """

    cloud: Cloud
    ground: BoolArray
    stray: BoolArray
    layers: Layers
    cells: BoolArray
    config: PerceptionConfig
    noise: float = 0.0
    rays: Rays | None = None


@dataclass(frozen=True, slots=True)
class Made:
    """A level, and what it was made of.

    Attributes:
        level: The level.
        grid: What was asked of its cells.
        first: Where the other points of each cell begin, shape (cells + 1,): they are in this order.
        touched: Cells in which anything is another than in the version before, shape (nx, ny); None where nothing is.
    """

    level: GroundLevel
    grid: Grid
    first: IntArray
    touched: BoolArray | None


def count_undecided(level: GroundLevel, noise: float = 0.0) -> int:
    """Points at the ground that are not called ground though they lie within twice its scatter: ground, or a sill.

    Args:
        level: One sheet.
        noise: Standard deviation of the cloud's points [m].
    """
    ix, iy, _ = level.surface.cells(level.other_points)
    off = np.abs(level.other_points[:, 2] - level.surface.height[ix, iy])  # NaN, where it is unknown, compares false
    return int(np.count_nonzero(off <= 2.0 * max(LEAST_SCATTER, 3.0 * noise)))

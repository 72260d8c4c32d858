"""What the levels of a cloud are made of, and what is kept of their making."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from gpdf_service.config import PerceptionConfig
from gpdf_service.ground import GroundLevel
from gpdf_service.perception.cloud import Cloud
from gpdf_service.tiles.layers import Layers
from gpdf_service.tiles.told import Grid
from gpdf_service.types import BoolArray, FloatArray, IntArray


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
    """

    cloud: Cloud
    ground: BoolArray
    stray: BoolArray
    layers: Layers
    cells: BoolArray
    config: PerceptionConfig
    noise: float = 0.0


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

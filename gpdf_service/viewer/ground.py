"""The ground as the page knows it: where a click's ray meets it, and where slices are asked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from gpdf_client import Drawing

from gpdf_service.types import FloatArray

RAY_STEP = 0.5
"""[-] Of a cell's width: steps along a ray, so that no cell is jumped over."""
STOREY = 0.2
"""[-] Of the largest level's area: a level that is smaller is a part of the storeys that it joins."""
MAX_RAY = 200_000
"""Steps of a ray: 4 km over cells of 4 cm."""


@dataclass(frozen=True, slots=True)
class Ground:
    """Height of each level on its grid, NaN where unknown; places are the page's, relative to the drawing's origin.

    Attributes:
        low: Lower corner of the grid [m], shape (2,).
        cell_width: [m].
        heights: [m], shape (levels, nx, ny).
    """

    low: FloatArray
    cell_width: float
    heights: FloatArray

    @classmethod
    def of(cls, drawing: Drawing, cell_width: float) -> Ground:
        """From all cells' centres."""
        low = drawing.places[:, :2].min(axis=0) - 0.5 * cell_width
        index = np.floor((drawing.places[:, :2] - low) / cell_width).astype(np.int64)
        level = drawing.columns["level"].astype(np.int64)
        heights = np.full((int(level.max()) + 1, *(index.max(axis=0) + 1)), np.nan)
        heights[level, index[:, 0], index[:, 1]] = drawing.places[:, 2]
        return cls(low, cell_width, heights)

    @property
    def box(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper corner of what is known, each (3,) [m]."""
        size = self.cell_width * np.array(self.heights.shape[1:])
        low, high = np.nanmin(self.heights), np.nanmax(self.heights)
        return np.array([*self.low, low]), np.array([*(self.low + size), high])

    @property
    def storeys(self) -> dict[int, float]:
        """Height of each level that is no mere stair or ledge, in the middle [m], by its number."""
        size = np.isfinite(self.heights).sum(axis=(1, 2))
        large = np.flatnonzero(size >= STOREY * size.max())
        return {int(level): float(np.nanmedian(self.heights[level])) for level in large}

    def middle(self, levels: frozenset[int] | None) -> float:
        """Height of most of some levels [m]; of all, if None."""
        heights = self.heights if levels is None else self.heights[sorted(levels)]
        return float(np.nanmedian(heights))

    def hit(self, origin: FloatArray, direction: FloatArray, levels: frozenset[int] | None = None) -> FloatArray | None:
        """Where a ray meets the ground from above, shape (3,); None if it does not. `levels`: only those."""
        heights = self.heights if levels is None else self.heights[sorted(levels)]
        reach = origin[2] - np.nanmin(heights)
        if direction[2] >= 0 or reach <= 0:
            return None
        direction = direction / np.linalg.norm(direction)
        count = min(MAX_RAY, int(reach / -direction[2] / (RAY_STEP * self.cell_width)) + 2)
        along = origin + direction * (np.arange(count) * RAY_STEP * self.cell_width)[:, None]
        index = np.floor((along[:, :2] - self.low) / self.cell_width).astype(np.int64)
        inside = np.logical_and.reduce((index >= 0) & (index < heights.shape[1:]), axis=1)
        ix, iy = np.where(inside[:, None], index, 0).T
        over = along[:, 2] - np.where(inside, heights[:, ix, iy], np.nan)  # (levels, steps)
        crossed = (over[:, 1:] <= 0) & (over[:, 1:] > -2 * self.cell_width)
        steps = np.flatnonzero(crossed.any(axis=0))
        if len(steps) == 0:
            return None
        first = int(steps[0]) + 1
        depth = np.where(crossed[:, first - 1], -over[:, first], np.inf)
        found: FloatArray = along[first].copy()
        found[2] += float(depth.min())
        return found

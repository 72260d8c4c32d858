"""Ground over head: of a tread or a floor that was seen from above alone nobody knows how far down it reaches."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from gpdf_service.config import PerceptionConfig
from gpdf_service.ground.foot import LEAST_OBSTACLE
from gpdf_service.ground.footing import rings_of
from gpdf_service.tiles.boxes import Box, lowest_around, widened
from gpdf_service.tiles.rows import extent_within, under
from gpdf_service.tiles.told import Grid, grown, within
from gpdf_service.types import BoolArray, Float32Array, FloatArray, IntArray


class Columns(NamedTuple):
    """Points in some cells: the box that holds these, flat cell in it, points (n, 3) [m], and which are ground.

    Those of the cell after the last one are of none.
    """

    box: Box
    cell: IntArray
    points: FloatArray
    ground: BoolArray


def over_head(floor: Float32Array, config: PerceptionConfig) -> FloatArray:
    """What is over head over the `floor` [m], (nx, ny), is higher than this: it leaves the lowest body room anyhow."""
    over = floor.astype(np.float64) + config.max_step + config.min_headroom
    return np.where(np.isnan(floor), np.inf, over)


def unseen_asks(
    grid: Grid, sheet: Float32Array, floor: Float32Array, width: float, config: PerceptionConfig
) -> BoolArray:
    """Cells whose points `unseen_beneath` asks, shape (nx, ny)."""
    return widened(grid.felt("treads", 0, sheet, floor, points=True), rings_of(config.widest_gap, width))


def unseen_beneath(
    grid: Grid, held: Columns, sheet: Float32Array, floor: Float32Array, width: float, config: PerceptionConfig
) -> BoolArray:
    """Cells in which nobody saw an underside of ground over head, shape (nx, ny): it may be a step thick.

    A flight is as deep under a tread as its riser and its waist, a floor as its slab: no more than `max_step`. An
    underside, or the face of a rim, is a point within that under the lowest tread around; it is known, as ground is, as
    far as `widest_gap`. Over head is what leaves the lowest body room even so.

    `held` are the points in the cells that `unseen_asks` for. The `sheet`'s own ground, which holds none of these, and
    the `floor` to stand on have heights [m], shape (nx, ny), NaN where there is none. Cells have that `width` [m].
    """
    rings, (box, cell, points, ground) = rings_of(config.widest_gap, width), held
    over, z, outer = over_head(floor[box], config), points[:, 2], grown(box, rings, floor.shape)
    rows = np.flatnonzero(ground & (cell < over.size))  # of other sheets: few, or none
    own, none = (cell[rows], z[rows]), np.full(over.shape, np.inf)
    top = extent_within(*own, over, extent_within(*own, over, none)[0] + config.max_step)[1]  # a board is one tread
    felt, top = grid.felt("treads", 0, sheet, floor, points=True), np.where(np.isfinite(top), top, np.inf)
    (top,) = grid.put("treads", (sheet, floor), felt, [(box, (top,))] if felt.any() else [])
    low, shown = lowest_around(top[outer], rings)[within(box, outer)], np.zeros(over.shape, dtype=bool)
    if np.isfinite(low).any():
        shown = np.isfinite(extent_within(cell, z, low - config.max_step, under(low - LEAST_OBSTACLE))[0])
    felt = grid.felt("undersides", rings, sheet, top, points=True)
    (shown,) = grid.put("undersides", (sheet, top), felt, [(box, (shown,))] if felt.any() else [])

    def answer(_: Box, top: FloatArray, shown: BoolArray) -> tuple[BoolArray]:
        return (np.isfinite(lowest_around(top, rings)) & ~widened(shown, rings),)

    (hidden,) = grid.around("unseen beneath", rings, answer, top, shown)
    return hidden

"""Ground over head: of a tread or a floor that was seen from above alone nobody knows how far down it reaches."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gpdf_service.config import PerceptionConfig
from gpdf_service.perception.boxes import lowest_around, widened
from gpdf_service.perception.footing import rings_of
from gpdf_service.perception.ledges import LEAST_OBSTACLE
from gpdf_service.perception.rows import between, extent_within, under
from gpdf_service.types import BoolArray, FloatArray, IntArray


def overhead_reach(width: float, config: PerceptionConfig) -> int:
    """Cells of that `width` [m] within which points and ground decide on `unseen_beneath`."""
    return 2 * rings_of(config.widest_gap, width)


def unseen_beneath(
    cell: IntArray, z: FloatArray, ground: BoolArray, floor: NDArray[np.float32], width: float, config: PerceptionConfig
) -> BoolArray:
    """Which points are ground over head under which nobody saw an underside, shape (n,): it may be a step thick.

    A flight is as deep under a tread as its riser and its waist, a floor as its slab: no more than `max_step`. An
    underside, or the face of a rim, is a point within that under the lowest tread around; it is known, as ground is, as
    far as `widest_gap`. Over head is what leaves the lowest body room even so.

    Args:
        cell: Flat cell of each point; the one after the last one is of none.
        z: Its height [m].
        ground: Whether it is ground.
        floor: The ground to stand on in each cell [m], shape (nx, ny), NaN where there is none near.
        width: Of the cells [m].
        config: Limits.
    """
    rings, none = rings_of(config.widest_gap, width), np.full(floor.shape, np.inf)
    over = np.where(np.isnan(floor), np.inf, floor.astype(np.float64) + config.max_step + config.min_headroom)
    own = np.where(ground, cell, cell.dtype.type(over.size))
    low = extent_within(own, z, over, none)[0]
    if np.isinf(low).all():
        return np.zeros(len(z), dtype=bool)
    top = extent_within(own, z, over, low + config.max_step)[1]  # a board's two faces are one tread
    low = lowest_around(np.where(np.isfinite(top), top, np.inf), rings)
    shown = np.isfinite(extent_within(cell, z, low - config.max_step, under(low - LEAST_OBSTACLE))[0])
    hidden = np.isfinite(low) & ~widened(shown, rings)
    return between(own, z, np.where(hidden, over, np.inf), none)

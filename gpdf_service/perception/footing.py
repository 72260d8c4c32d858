"""Where a foot rests on rough treads: it does not sink into what is narrower than itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import ndimage

from gpdf_service.perception.strides import SOLE, STRIDE
from gpdf_service.perception.surface import UNKNOWN, HeightMap
from gpdf_service.types import BoolArray, FloatArray


def bridged(surface: HeightMap, max_step: float) -> HeightMap:
    """The ground of flights, with pits narrower than a foot closed: behind a nose a scan sags, the tread does not.

    Greyscale closing by a disc of `SOLE`. It leaves a staircase, which only rises one way, as it is. A flight is where
    the ground changes by more than a step, `max_step` [m], within a stride.
    """
    known = surface.state != UNKNOWN
    flight = known & flights(surface, max_step)
    if not flight.any():
        return surface
    high = np.where(known, surface.height, -np.inf)
    disc = _disc(_rings(SOLE, surface.cell_width))
    dilated = np.where(known, ndimage.maximum_filter(high, footprint=disc), np.inf)
    closed = ndimage.minimum_filter(dilated, footprint=disc)
    return replace(surface, height=np.where(flight, closed, surface.height).astype(np.float32))


def footholds(surface: HeightMap, max_step: float) -> FloatArray:
    """Height of the ground, in flights without what is narrower than a foot [m], shape (nx, ny), -inf where unknown.

    A step leads up to a tread, not to the stringer beside it: greyscale opening by a square as wide as `SOLE`. A sill
    on a floor is narrower, too, and one steps over it. A flight is as in `bridged`.
    """
    known, size = surface.state != UNKNOWN, 2 * round(0.5 * SOLE / surface.cell_width) + 1
    low = ndimage.minimum_filter(np.where(known, surface.height, np.inf), size)
    opened = ndimage.maximum_filter(np.where(np.isfinite(low), low, -np.inf), size)
    rests: FloatArray = np.where(flights(surface, max_step), opened, surface.height).astype(np.float64)
    rests[~known] = -np.inf
    return rests


def flights(surface: HeightMap, max_step: float, reach: float = STRIDE) -> BoolArray:
    """Cells around which known ground differs by more than a step, `max_step`, within a `reach` [m], shape (nx, ny)."""
    known, size = surface.state != UNKNOWN, 2 * _rings(reach, surface.cell_width) + 1
    low, high = (np.where(known, surface.height, none) for none in (np.inf, -np.inf))
    found: BoolArray = ndimage.maximum_filter(high, size) - ndimage.minimum_filter(low, size) > max_step
    return found


def footing_reach(surface: HeightMap) -> int:
    """Cells within which the ground decides on what is `bridged`, and on `footholds`."""
    return max(_rings(STRIDE, surface.cell_width), 2 * _rings(SOLE, surface.cell_width))


def _rings(length: float, width: float) -> int:
    return max(1, int(length / width))


def _disc(rings: int) -> BoolArray:
    offset = np.arange(-rings, rings + 1)
    disc: BoolArray = np.hypot(*np.meshgrid(offset, offset)) <= rings + 0.5
    return disc

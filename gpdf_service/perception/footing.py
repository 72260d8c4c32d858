"""Where a foot rests on rough treads: it does not sink into what is narrower than itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import ndimage

from gpdf_service.perception.strides import STRIDE
from gpdf_service.perception.surface import UNKNOWN, HeightMap
from gpdf_service.types import BoolArray

SOLE = 0.12
"""[m] Half the length of a foot, and the width of one: a pit narrower than two of these is bridged by it."""


def bridged(surface: HeightMap, max_step: float) -> HeightMap:
    """The ground of flights, with pits narrower than a foot closed: behind a nose a scan sags, the tread does not.

    Greyscale closing by a disc of `SOLE`. It leaves a staircase, which only rises one way, as it is. A flight is where
    the ground changes by more than a step, `max_step` [m], within a stride.
    """
    known = surface.state != UNKNOWN
    low, high = np.where(known, surface.height, np.inf), np.where(known, surface.height, -np.inf)
    size = 2 * _rings(STRIDE, surface.cell_width) + 1
    flight = known & (ndimage.maximum_filter(high, size) - ndimage.minimum_filter(low, size) > max_step)
    if not flight.any():
        return surface
    disc = _disc(_rings(SOLE, surface.cell_width))
    dilated = np.where(known, ndimage.maximum_filter(high, footprint=disc), np.inf)
    closed = ndimage.minimum_filter(dilated, footprint=disc)
    return replace(surface, height=np.where(flight, closed, surface.height).astype(np.float32))


def footing_reach(surface: HeightMap) -> int:
    """Cells within which the ground decides on what is `bridged`."""
    return max(_rings(STRIDE, surface.cell_width), 2 * _rings(SOLE, surface.cell_width))


def _rings(length: float, width: float) -> int:
    return max(1, int(length / width))


def _disc(rings: int) -> BoolArray:
    offset = np.arange(-rings, rings + 1)
    disc: BoolArray = np.hypot(*np.meshgrid(offset, offset)) <= rings + 0.5
    return disc

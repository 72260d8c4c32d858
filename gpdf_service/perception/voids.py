"""Voids: what a scan shows deeper than the ground of a level, through its holes and under it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import ndimage

from gpdf_service.tiles.boxes import highest_around, lowest_around, widened, window
from gpdf_service.tiles.nearest import nearest_of
from gpdf_service.tiles.rows import extent_within, under
from gpdf_service.tiles.surface import UNKNOWN, HeightMap, Nearest
from gpdf_service.types import BoolArray, Float32Array, FloatArray, IntArray

RING_SHARE = 0.95
"""[-] Of the ground around a hole that must not lie under the plane that fills it: the rest is a scan's noise."""
SLAB = 1.0
"""[m] Thickest floor: what is seen deeper than this under a hole was seen through it."""
STOREY = 1.5
"""[m] Least room under a floor: what is seen nearer below a hole with less than this under itself is a pit's bottom."""
WALL_CELLS = 3.0
"""[cells] The wall of a pit is seen within these under its rim; the underside of a floor is deeper."""
MAX_HOLE_RADIUS = 1.0
"""[m] A hole is filled if no place in it is further from seen ground: a scanner's blind spot, the shadow of a desk."""


class Voids(NamedTuple):
    """Cells of a level, each of shape (nx, ny); in the first two a known cell counts if it is a flight's.

    Attributes:
        through: Where the scanner saw through, further down than a floor is thick.
        pit: Where the bottom of a pit is seen, which is no ceiling because no storey is under it.
        walls: Where the upper end of a pit's walls is: a point right under the ground of a rim, no floor.
        hollow: Where the bottom of a pit is seen under ground that is no flight's.
    """

    through: BoolArray
    pit: BoolArray
    walls: BoolArray
    hollow: BoolArray


def find_voids(
    seen: HeightMap, near: Nearest, treads: BoolArray, rim: FloatArray, cell: IntArray, z: FloatArray, max_step: float
) -> Voids:
    """Cells under whose ground other points lie, by more than `max_step`: of an unknown one only the highest counts.

    Of the ground as it was `seen` `near` is the `nearest_seen`, `rim` what `find_rims` finds; `treads` are cells of a
    flight, shape (nx, ny). Each of the points, by its flat `cell`, shape (n,), has a height `z` [m].
    """
    distance, beside = near
    low, high = (under(rim - cells * seen.cell_width) for cells in (WALL_CELLS, 1.0))
    walls: BoolArray = np.isfinite(extent_within(cell, z, low, high)[0])
    unknown = seen.state == UNKNOWN
    high = np.where(unknown, beside + np.float32(seen.cell_width), beside - np.float32(max_step))
    high[distance > MAX_HOLE_RADIUS] = -np.inf
    bottom, top = extent_within(cell, z, np.full(unknown.shape, -np.inf), under(high))
    shown = np.isfinite(top)
    depth = np.where(shown, beside - top, 0.0)
    pit = (depth > max_step) & (depth <= SLAB) & (np.where(shown, top - bottom, 0.0) < STOREY)
    asked = unknown | treads
    return Voids(asked & (depth > SLAB), asked & pit, walls, pit & ~asked)


def find_rims(surface: HeightMap) -> Float32Array:
    """Height of the ground at the rim of a hole, in its cells and those beside [m], shape (nx, ny), else -inf.

    A step up at the rim is none: the lowest ground within two cells counts. But a rim's cell that holds the wall's
    upper end, too, lies as deep as that: of each cell and those around it the highest ground counts.
    """
    unknown = surface.state == UNKNOWN
    rim = highest_around(np.where(unknown, -np.inf, surface.height), 1)
    floor = lowest_around(np.where(unknown, np.inf, rim), 2)
    return np.where(widened(unknown, 1), floor, -np.inf)


def near_hollow(surface: HeightMap, hollow: BoolArray) -> BoolArray:
    """Unknown cells within `MAX_HOLE_RADIUS` of `hollow` ground; less of it than two cells by two is a stray's."""
    near, reach = np.zeros_like(hollow), MAX_HOLE_RADIUS / surface.cell_width
    firm = ndimage.binary_opening(hollow, np.ones((2, 2))) if hollow.any() else hollow
    if not firm.any():
        return near
    box = window(firm, int(reach))
    near[box] = (nearest_of(firm[box])[0] <= reach) & (surface.state[box] == UNKNOWN)
    return near


def walled_down(surface: HeightMap, walls: BoolArray) -> BoolArray:
    """Holes with `walls` under more of their rim than a scan's noise explains."""
    if not walls.any():
        return walls
    unknown = surface.state == UNKNOWN
    label, count = ndimage.label(unknown)
    at = highest_around(label, 1)  # what is at two holes is at the last one
    rim, pit = (np.bincount(at[cells], minlength=count + 1) for cells in (~unknown, walls))
    result: BoolArray = (pit > (1.0 - RING_SHARE) * rim)[label] & unknown
    return result

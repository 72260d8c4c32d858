"""How large a foot is, how far a stride, and what a step is: lengths that all of the ground is measured by."""

from __future__ import annotations

from math import ceil

import numpy as np
from numba import njit

from gpdf_service.tiles.surface import HeightMap

HALF_FOOT = 0.015
"""[m²] Half of the sole of a foot, 25 cm by 12."""
SOLE = 0.12
"""[m] Half the length of a foot, and the width of one: a pit narrower than two of these is bridged by it."""
STRIDE = 0.4
"""[m] Widest in plan between two stances that a stride joins: the going of a stair, and its hidden half."""
FACE = 0.1
"""[m] A step's face has the step's top within this in plan at most: half the depth of a stair's tread."""
LEAST_OBSTACLE = 0.015
"""[m] What stands out of the ground by less stops no body here: the smallest `max_step`, and the scatter of a scan."""
RESOLVED_STEP = 3.0
"""[-] A lower step over the noise may be an unlucky cell of a cured floor, if it is of one cell."""
SECTORS = 16
"""Directions in plan that are told apart around a place between two treads."""


@njit(cache=True, nogil=True)
def sector_of(dx: int, dy: int) -> int:
    """Which of the `SECTORS` a cell is in, so many cells away."""
    return int((np.arctan2(dy, dx) / (2.0 * np.pi) + 1.0) * SECTORS + 0.5) % SECTORS


def astray(surface: HeightMap, noise: float) -> int:
    """How many cells a point of a step's face may lie from the ground under or over it."""
    return max(1, ceil(RESOLVED_STEP * noise / surface.cell_width))

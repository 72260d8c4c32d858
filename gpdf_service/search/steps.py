"""Where steps are that one notices, asked for by boxes of cells: sums over all cells below and left tell of any box."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gpdf_service.kernel_cache import lean
from gpdf_service.tiles.surface import Cells, cell_of, count_in
from gpdf_service.types import FloatArray

NOTICED_STEP = 0.03
"""[m] Lower steps do not slow anybody down: a sill of 2 cm is rolled over. Higher ones are not level ground."""


@lean()
def is_stepped(ground: Cells, noticed: NDArray[np.int32], x: float, y: float, reach: int) -> bool:
    """Whether a step that is noticed is within `reach` cells of a place."""
    u, v = cell_of(ground, x, y)
    if u < 0:
        return False
    left, right = max(u - reach, 0), min(u + reach + 1, noticed.shape[0] - 1)
    near, far = max(v - reach, 0), min(v + reach + 1, noticed.shape[1] - 1)
    found: bool = count_in(noticed, left, right, near, far) > 0
    return found


@lean()
def is_near_step(path: FloatArray, ground: Cells, noticed: NDArray[np.int32], reach: float) -> bool:
    """Whether a way in plan, shape (n, 2), comes nearer than `reach` [m] to a step that is noticed."""
    cells = int(np.ceil(reach / ground.width))
    for i in range(len(path) - 1):
        dx, dy = path[i + 1, 0] - path[i, 0], path[i + 1, 1] - path[i, 1]
        length = np.sqrt(dx * dx + dy * dy)
        count = int(np.ceil(length / (ground.width * cells))) + 1
        for k in range(count + 1):
            if is_stepped(ground, noticed, path[i, 0] + k / count * dx, path[i, 1] + k / count * dy, cells):
                return True
    return False


@lean()
def count_steps(contact: FloatArray) -> int:
    """How many steps that are noticed a path over contact points, shape (n, 3), takes; a riser on end is one."""
    count, before = 0, 0
    for i in range(len(contact) - 1):
        rise = contact[i + 1, 2] - contact[i, 2]
        way = 0 if abs(rise) <= NOTICED_STEP else 1 if rise > 0.0 else -1
        count += way not in (0, before)
        before = way
    return count

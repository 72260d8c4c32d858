"""Memory of a scene's grids, reckoned before any of it is taken; and what was freed, given back."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import lru_cache

import numpy as np

from gpdf_service.config import PerceptionConfig
from gpdf_service.errors import TooLargeError
from gpdf_service.tiles.rows import bounds_of
from gpdf_service.types import FloatArray

LAYER_BYTES = 32
"""[bytes] Most that a cell of the layers of a whole cloud takes while its ground is found, empty ones as well."""
LEVEL_BYTES = 280
"""[bytes] The same of a cell of a level while it is made and measured."""
KEPT_BYTES = 140
"""[bytes] The same of what is kept of it while further levels are made."""
POINT_BYTES = 1000
"""[bytes] Of grids that each point may ask for: four cells of a level; floors that were scanned ask for 0.05 to 1."""
FREED_BYTES = 30
"""[bytes] Of what finding the ground takes a point, freed between what lasts: 300 MB of 10 M points."""
_MUCH = 1 << 26
"""[bytes] What a thread of glibc's takes from the system at once: less is not worth it."""
_BULK = (1.0, 99.0)
"""[%] Percentiles of x and of y between which the bulk of a cloud lies: what is outside may be an outlier."""


def check_grid(points: FloatArray, count: int, width: float, each: float, config: PerceptionConfig) -> None:
    """Refuse a grid over the points that takes more than the budget and what the cloud's points may ask for.

    The points [m], shape (k, 3), are of a cloud of `count`. Cells have that `width` [m] and take `each` so many bytes.

    Raises:
        TooLargeError: it would take more.
    """
    low, high = bounds_of(points)
    cells = np.prod(np.ceil((high - low) / width) + 2.0)
    needed, allowed = cells * each, config.memory_budget + POINT_BYTES * count
    if needed <= allowed:
        return
    wide, bulk = high - low, np.diff(np.percentile(points[:, :2], _BULK, axis=0), axis=0)[0]
    found = (
        f"{count} points over {wide[0]:.0f} × {wide[1]:.0f} m ask for {cells:.3g} cells of {width:.2g} m, "
        f"{needed / 1e9:.2g} GB, more than the {allowed / 1e9:.2g} GB that they may take"
    )
    crop = "Crop it"
    if (2.0 * bulk < wide).any():
        crop = f"Most points lie within {bulk[0]:.0f} × {bulk[1]:.0f} m: crop what lies outside"
    raise TooLargeError(
        "memory of the scene",
        found,
        f"Is it in millimetres? Divide by 1000. {crop}, build it in tiles, or raise config.perception.memory_budget.",
    )


def give_back(count: int) -> None:
    """Give memory that a stage freed, of so many points, back to the system.

    The C library keeps it wherever what lasts lies beside it. Of a small cloud it is left for the next stage.
    """
    trim = _trim()
    if trim is not None and count * FREED_BYTES >= _MUCH:
        trim(0)


@lru_cache(maxsize=1)
def _trim() -> Callable[[int], int] | None:
    """What gives it back, where the C library is glibc."""
    try:
        found: Callable[[int], int] = ctypes.CDLL(None).malloc_trim
    except (AttributeError, OSError, TypeError):
        return None
    return found

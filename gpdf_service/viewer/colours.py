"""Colours that the colour-blind can tell apart: viridis for heights and distances, Okabe and Ito's for kinds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gpdf_service.types import FloatArray

Colours = NDArray[np.uint8]

VIRIDIS = np.array(
    [
        (68, 1, 84),
        (70, 50, 126),
        (54, 92, 141),
        (39, 127, 142),
        (31, 161, 135),
        (74, 193, 109),
        (160, 218, 57),
        (253, 231, 37),
    ],
    dtype=np.float64,
)
"""matplotlib's viridis at even steps."""
PALENESS = 0.4
"""[-] Share of white."""
PALE = (1.0 - PALENESS) * VIRIDIS + PALENESS * 255.0
"""For the cloud, so that a path stands out before it."""
ROOM = np.array([(213, 94, 0), (230, 159, 0), (0, 158, 115), (0, 114, 178)], dtype=np.float64)
"""From no room (vermilion) to enough of it (blue), nowhere as pale as the floor."""
ENOUGH_ROOM = 0.5
"""[m] Clearance that is shown as blue: half a body's width more than is needed."""
METHODS = {"dual_gpdf": (0, 114, 178), "single_gpdf": (230, 159, 0), "astar": (204, 121, 167), "prm": (0, 158, 115)}
"""The paper's four methods."""
BODIES = {"roomba": (0, 158, 115), "spot": (230, 159, 0), "pepper": (204, 121, 167), "human": (0, 114, 178)}
"""The paper's four."""
OWN_BODY = (86, 180, 233)
"""One with measures of its own beside them."""
WARNING = (213, 94, 0)
"""A path that nobody has proven: vermilion, and dashed."""
DROPPED = (230, 159, 0)
"""What the operator put there."""
LIVE = (30, 30, 30)
"""People and robots that are on their way now: like nothing else on the page."""
KINDS = np.array([(90, 90, 90), (213, 94, 0), (230, 159, 0), (204, 121, 167)], np.uint8)
"""What stops a body: material, step, slope, unobserved ground."""
KIND_NAMES = ("material", "step", "slope", "unobserved ground")
LEVELS = np.array([(86, 180, 233), (230, 159, 0), (0, 158, 115), (204, 121, 167), (0, 114, 178)], np.uint8)
"""Storeys, over and over."""
NOWHERE = (150, 150, 150)
"""What lies over no known ground."""
SEEN, INFERRED = np.array([(190, 186, 178), (230, 158, 102)], np.uint8)
"""Ground that was measured, and ground that its surroundings explain: a pale vermilion, which no height has."""


def ramp(values: FloatArray, low: float, high: float, colours: FloatArray = VIRIDIS) -> Colours:
    """Colours of values (n,) between `low` and `high`, shape (n, 3)."""
    share = np.clip((values - low) / max(high - low, 1e-9), 0.0, 1.0) * (len(colours) - 1)
    steps = np.arange(len(colours))
    return np.column_stack([np.interp(share, steps, channel) for channel in colours.T]).astype(np.uint8)


def of_levels(level: FloatArray) -> Colours:
    """Colours of storeys, shape (n, 3)."""
    index = level.astype(np.int64)
    return np.where((index < 0)[:, None], np.array(NOWHERE, np.uint8), LEVELS[index % len(LEVELS)])


def unpacked(numbers: FloatArray) -> Colours:
    """Colours of numbers 0xRRGGBB (n,), shape (n, 3); of −1 that of `NOWHERE`."""
    index = numbers.astype(np.int64)
    channels = np.column_stack([index >> 16, index >> 8 & 255, index & 255])
    return np.where((index < 0)[:, None], NOWHERE, channels).astype(np.uint8)


def pale(shades: Colours) -> Colours:
    """Colours mixed with white, for what lies below others."""
    return ((1.0 - PALENESS) * shades + PALENESS * 255.0).astype(np.uint8)


def of_lines(shades: Colours) -> Colours:
    """Colours of the ends of lines, which viser takes for linear light: sRGB's, IEC 61966-2-1, made linear."""
    share = shades / 255.0
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    made: Colours = np.rint(255.0 * linear).astype(np.uint8)
    return made


def css(colour: tuple[int, int, int] | NDArray[np.generic]) -> str:
    """As CSS writes it."""
    r, g, b = (int(channel) for channel in colour)
    return f"#{r:02x}{g:02x}{b:02x}"

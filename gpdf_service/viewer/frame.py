"""Where the page's zero lies in the scene, and how far its storeys are pulled apart."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from gpdf_service.types import FloatArray

PART = 0.5, 0.9
"""[-] Of the way from one floor to the next: over the things of a storey, under the floor of the next. What lies
between, as the upper half of a stair, is stretched."""


@dataclass(slots=True)
class Frame:
    """The page draws every place relative to `origin` (3,) [m], so that float32 is exact in the browser.

    Attributes:
        origin: The page's zero in the scene [m].
        floors: Heights of the storeys over the origin, rising [m].
        apart: How much further each storey is drawn over the one below [m].
    """

    origin: FloatArray = field(default_factory=lambda: np.zeros(3))
    floors: FloatArray = field(default_factory=lambda: np.zeros(1))
    apart: float = 0.0

    def to_page(self, places: FloatArray) -> FloatArray:
        """From the scene's frame, shape (…, 3)."""
        return self.lifted(places - self.origin)

    def to_scene(self, places: FloatArray) -> FloatArray:
        """From the page's, shape (…, 3)."""
        heights, lifts = self._stack
        made = places + self.origin
        made[..., 2] -= np.interp(places[..., 2], heights + lifts, lifts)
        return made

    def lifted(self, places: FloatArray) -> FloatArray:
        """Places over the origin as they are drawn, shape (…, 3) [m]."""
        made = places.copy()
        made[..., 2] = self.lifted_heights(places[..., 2])
        return made

    def lifted_heights(self, z: FloatArray) -> FloatArray:
        """Heights over the origin as they are drawn, of any shape [m]."""
        made: FloatArray = z + np.interp(z, *self._stack)
        return made

    @property
    def _stack(self) -> tuple[FloatArray, FloatArray]:
        """Heights between which the lift grows, and the lift there [m]; it never falls, so that it can be undone."""
        low, gap = self.floors[:-1], np.diff(self.floors)
        heights = np.append(self.floors[0], (low[:, None] + gap[:, None] * PART).ravel())
        lifts = self.apart * np.append(0.0, (np.arange(len(gap))[:, None] + (0.0, 1.0)).ravel())
        return heights, lifts

"""Where the page's zero lies in the scene."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from gpdf_service.types import FloatArray


@dataclass(slots=True)
class Frame:
    """The page draws every place relative to `origin` (3,) [m], so that float32 is exact in the browser."""

    origin: FloatArray = field(default_factory=lambda: np.zeros(3))

    def to_page(self, places: FloatArray) -> FloatArray:
        """From the scene's frame, shape (…, 3)."""
        return places - self.origin

    def to_scene(self, places: FloatArray) -> FloatArray:
        """From the page's, shape (…, 3)."""
        return places + self.origin

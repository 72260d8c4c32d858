"""The colours that a scan came with, kept beside a scene for its pictures: thinned, and found again by place."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from gpdf_service.errors import CloudError
from gpdf_service.fields.spacing import thin
from gpdf_service.types import FloatArray, IntArray

MOST = 300_000
"""Places with a colour: as many points as a browser bears, and 1.5 MB."""
FINEST = 0.01
"""[m] Between two of them: finer than points are drawn."""
SLOWEST = 1.1
"""[-] By how much places lie further apart with each round at least, until they are few enough."""
REACH = 3.0
"""[-] Widths of a cell: from a point to the place of its cell, and from there to one that was kept, √3 and a half."""
CHANNELS = np.array([1 << 16, 1 << 8, 1])
"""[-] Of red, green and blue in one number: 0xRRGGBB."""


@dataclass(frozen=True)
class Shades:
    """Places where the scan had a colour. Nothing but pictures reads them.

    Attributes:
        low: The corner that cells are counted from [m], shape (3,).
        width: Of the cells [m].
        cells: Those with a colour, shape (k, 3).
        colours: Red, green and blue, shape (k, 3).
    """

    low: FloatArray
    width: float
    cells: NDArray[np.int32]
    colours: NDArray[np.uint8]

    @property
    def places(self) -> FloatArray:
        """Middles of the cells [m], shape (k, 3)."""
        return self.low + self.width * (self.cells + 0.5)

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.places)

    def at(self, points: FloatArray, moved: float) -> IntArray:
        """The colour of each point, 0xRRGGBB, shape (n,): of the nearest place; −1 where none is near.

        Args:
            points: Of the scene, shape (n, 3) [m].
            moved: How far they may lie from where they were scanned [m].
        """
        _, nearest = self._tree.query(points, distance_upper_bound=REACH * self.width + moved)
        told: IntArray = np.append(self.colours @ CHANNELS, -1)[nearest]
        return told


def shades_of(points: FloatArray, colours: ArrayLike) -> Shades:
    """Keep the colours (n, 3) of points (n, 3) [m], one a cell.

    Raises:
        CloudError: colours of another type or shape.
    """
    given = np.asarray(colours)
    if given.dtype != np.uint8 or given.shape != points.shape:
        found = f"an array of {given.dtype} of shape {given.shape}"
        raise CloudError("colours", found, f"Pass red, green and blue as uint8 of shape {points.shape}.")
    width, rows = FINEST, thin(points, FINEST)
    while len(rows) > MOST:
        width *= max(SLOWEST, float(np.sqrt(len(rows) / MOST)))
        rows = rows[thin(points[rows], width)]
    low = points.min(axis=0)
    cells = np.floor((points[rows] - low) / width).astype(np.int32)
    order = np.lexsort(cells.T)  # neighbours beside each other: a third less to store
    return Shades(low, width, cells[order], given[rows][order])

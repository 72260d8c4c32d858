"""Two fields in one: what stands, fitted once, and what moves, fitted again with each change. The nearer one answers.

Each brackets the distance to its own nearest point, so their least brackets that to the nearest of all points.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from gpdf_service.fields.gpdf import Gpdf
from gpdf_service.fields.traversal import NearerArrays, nearest_only
from gpdf_service.fields.tree import NO_POINTS
from gpdf_service.types import FieldSample

EMPTY = nearest_only(NO_POINTS)
"""A field of no points, in compiled form."""


@dataclass(frozen=True, slots=True)
class Nearer:
    """A `DistanceField`: the least of what stands and what moves, if anything does."""

    standing: Gpdf
    moving: Gpdf | None = None

    @property
    def arrays(self) -> NearerArrays:
        """What a compiled loop needs for `traversal.sample_at`."""
        return NearerArrays(self.standing.arrays, EMPTY if self.moving is None else self.moving.arrays)

    def query(self, queries: ArrayLike) -> FieldSample:
        """Distance, gradient, validity and standard deviation of the nearer one: see `Gpdf.query`."""
        stands = self.standing.query(queries)
        if self.moving is None:
            return stands
        moves = self.moving.query(queries)
        nearer = moves.valid & (~stands.valid | (moves.distance < stands.distance))
        return FieldSample(
            np.where(nearer, moves.distance, stands.distance),
            np.where(nearer[:, None], moves.gradient, stands.gradient),
            stands.valid | moves.valid,
            np.where(nearer, moves.deviation, stands.deviation),
        )

"""The rays of a scan: from where to what they hit, and which of them came and went since the version before."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from gpdf_service.errors import CloudError
from gpdf_service.tiles.points import Points
from gpdf_service.types import BoolArray, FloatArray, IntArray


class Bundle(NamedTuple):
    """Some rays.

    Attributes:
        origins: Where they began [m], shape (1, 3) for all of them, or (n, 3); NaN where that is not known.
        ends: What they hit [m], shape (n, 3).
        there: Which count, shape (n,).
    """

    origins: FloatArray
    ends: FloatArray
    there: BoolArray


@dataclass(frozen=True, slots=True)
class Rays:
    """Rays of a scan, by the numbers of the points that they hit.

    Attributes:
        points: What they hit.
        origins: Where those to the points of the first version began [m], shape (1, 3) for all of them, or (n, 3); NaN
            where that is not known.
        more: Where those to the points that came since began [m], shape (k, 3).
        news: Those that came, and those that went, since the version before; none of a build.
    """

    points: Points
    origins: FloatArray
    more: FloatArray
    news: tuple[Bundle, Bundle] | None = None

    @property
    def bundles(self) -> tuple[Bundle, Bundle]:
        """All rays."""
        points, count = self.points, len(self.points.base.points)
        first = Bundle(self.origins, points.base.points, points.there[:count])
        return first, Bundle(self.more, points.more, points.there[count:])

    @property
    def began(self) -> FloatArray:
        """Where those to the points that are there began, in their order [m], shape (1, 3) for all, or (count, 3)."""
        if len(self.origins) == 1 and len(self.more) == 0:
            return self.origins
        first = np.broadcast_to(self.origins, self.points.base.points.shape)
        return np.concatenate([first, self.more])[self.points.there]

    def began_at(self, keep: BoolArray, fresh: FloatArray) -> FloatArray:
        """Where those began to the points that are kept, shape (count,), and `fresh` ones, shape (m, 3) [m]."""
        began = self.began
        if len(began) == 1 and len(fresh) == 0:
            return began
        return np.concatenate([np.broadcast_to(began, (len(keep), 3))[keep], fresh])

    def changed(self, points: Points, gone: IntArray, began: FloatArray | None) -> Rays:
        """The next version: to its `points`, without those by number `gone`, and where fresh ones `began`, (m, 3).

        These are not known if that is None.
        """
        first, count = self.origins, len(self.points.base.points)
        own = first[np.where(gone < count, gone, 0) % len(first)]
        own[gone >= count] = self.more[gone[gone >= count] - count]
        fresh = points.more[len(self.more) :]
        began = np.full(fresh.shape, np.nan) if began is None else began
        came = Bundle(began, fresh, np.ones(len(fresh), dtype=bool))
        went = Bundle(own, points.taken(gone), np.ones(len(gone), dtype=bool))
        return Rays(points, first, np.concatenate([self.more, began]), (came, went))


def rays_of(points: Points, origins: FloatArray) -> Rays:
    """The rays of a first version to its `points`, from `origins` [m], shape (1, 3) for all of them, or (n, 3)."""
    return Rays(points, origins, np.zeros((0, 3)))


def check_origins(origins: ArrayLike, points: FloatArray) -> FloatArray:
    """Where rays to the `points`, shape (n, 3), began [m]: (1, 3) from an origin (3,), or (n, 3) from one for each.

    A whole row of NaN says that it is not known of that point.

    Raises:
        CloudError: another shape, or not finite.
    """
    try:
        made = np.ascontiguousarray(origins, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise CloudError("origins", f"no array of numbers ({error})", "Pass (3,) or (n, 3), in metres.") from error
    if made.shape not in ((3,), points.shape):
        raise CloudError("origins", f"an array of shape {made.shape}", f"Pass (3,), or {points.shape}: one a point.")
    if not (np.isfinite(made) | ((made.ndim > 1) & np.isnan(made).all(axis=-1, keepdims=True))).all():
        raise CloudError("origins", "not all of them are finite", "Give rows of NaN where they are not known.")
    return made.reshape(-1, 3)

"""Where on a way nobody has seen the ground: a cane has to find out what the map only infers.

The planner infers ground inside holes of a scan that their surroundings explain, as under a scanner or in a shadow.
What a foot bridges counts as seen; of what is wider a person is told before he comes to it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gpdf_guidance.features import FOOT, ONE_PASSAGE, Feature, FeatureKind

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

STOREY = 1.0
"""[m] Ground that is this much over or under the way's is another storey's."""
AT_ONCE = 4_000_000
"""Distances that are in memory at once."""


def with_unseen(
    features: tuple[Feature, ...], ground: FloatArray, s: FloatArray, radius: float, cells: FloatArray, seen: BoolArray
) -> tuple[Feature, ...]:
    """Features with the stretches under which a gap wider than a foot was not seen, in order; `amount` is its length.

    Args:
        features: Of a way.
        ground: Contact points of the way [m], shape (n, 3).
        s: Their arc lengths [m], shape (n,).
        radius: Of the body [m]: what is under it counts.
        cells: Centres of the map's cells of ground, all of those near the way [m], shape (k, 3).
        seen: Which of them were seen, and are not inferred, shape (k,).
    """
    guessed = cells[~seen]
    guessed = guessed[_is_within(guessed, ground, radius)]
    guessed = guessed[~_is_within(guessed, cells[seen], 0.5 * FOOT)]
    over = np.flatnonzero(_is_within(ground, guessed, radius))
    if not len(over):
        return features
    runs = np.split(over, np.flatnonzero(np.diff(s[over]) > ONE_PASSAGE) + 1)
    ends = [(float(s[run[0]]), float(s[run[-1]])) for run in runs]
    found = [Feature(FeatureKind.UNSEEN, begin, end, end - begin) for begin, end in ends]
    return tuple(sorted([*features, *found], key=lambda feature: feature.start))


def _is_within(places: FloatArray, others: FloatArray, reach: float) -> BoolArray:
    """Whether one of the others is within a reach of a place in plan, on the same storey, shape (n,)."""
    near = np.zeros(len(places), dtype=bool)
    if not len(others):
        return near
    step = max(1, AT_ONCE // len(others))
    for first in range(0, len(places), step):
        away = places[first : first + step, None, :] - others
        close = (away[..., 0] ** 2 + away[..., 1] ** 2 <= reach * reach) & (np.abs(away[..., 2]) < STOREY)
        near[first : first + step] = close.any(axis=1)
    return near

"""Named places on a way: where one turns, and what one passes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gpdf_guidance.features import Feature, FeatureKind

FloatArray = NDArray[np.float64]

BESIDE = 1.5
"""[m] A place that is this close to a way is passed: two paces to the side, which a cane or a call finds."""
AT = 1.0
"""[m] What is this close along the way to a place is at it."""
STOREY = 1.0
"""[m] A place that is this much over or under the way's ground is on another storey."""
DOING = (FeatureKind.TURN, FeatureKind.STAIRS, FeatureKind.STEP, FeatureKind.OPENING)
"""What a place gives its name to; other places are passed."""


def with_places(
    features: tuple[Feature, ...],
    ground: FloatArray,
    s: FloatArray,
    heading: FloatArray,
    places: Mapping[str, Sequence[float]],
) -> tuple[Feature, ...]:
    """Features with the names of the places that they are at, and the places that are passed, in order.

    Args:
        features: Of a way.
        ground: Its contact points [m], shape (n, 3).
        s: Their arc lengths [m], shape (n,).
        heading: Direction of the way there [rad], shape (n,).
        places: (x, y) or (x, y, z) of each name [m].
    """
    found = list(features)
    for name, place in places.items():
        near = _nearest(ground, place)
        if near is None or s[near] > s[-1] - BESIDE:  # the goal is told of on arrival
            continue
        at = [i for i, one in enumerate(found) if one.kind in DOING and abs(one.start - s[near]) <= AT]
        if at:
            found = [replace(one, name=one.name or name) if i == at[0] else one for i, one in enumerate(found)]
        elif s[near] > AT:
            away = np.asarray(place[:2]) - ground[near, :2]
            left = np.cos(heading[near]) * away[1] - np.sin(heading[near]) * away[0] > 0.0
            found.append(Feature(FeatureKind.PLACE, float(s[near]), float(s[near]), 1.0 if left else -1.0, name=name))
    return tuple(sorted(found, key=lambda feature: feature.start))


def _nearest(ground: FloatArray, place: Sequence[float]) -> int | None:
    """The sample of a way that a place is beside; None where it is not beside any."""
    away = np.hypot(ground[:, 0] - place[0], ground[:, 1] - place[1])
    if len(place) > 2:
        away = np.where(np.abs(ground[:, 2] - place[2]) < STOREY, away, np.inf)
    near = int(away.argmin())
    return near if away[near] <= BESIDE else None

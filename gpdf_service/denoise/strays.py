"""Which of the points beside a ground that noise was taken out of are of it all the same."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from gpdf_service.types import BoolArray, FloatArray

FAR = 4.0
"""[-] Standard deviations: a point further off a plane is not of it, whatever it is."""
_BESIDE = 2.0
"""[-] Standard deviations, or spacings, that witnesses are away at most."""
_WITNESSES = 24
"""Points beside one that say whether they are a thing: by then it shows from one standard deviation on."""


def find_lifted(points: FloatArray, ground: BoolArray, noise: float, spacing: float) -> BoolArray:
    """Points that noise can have lifted off the `ground`, shape (n,), or sunk under it.

    In a million points of a floor a thousand are more than three deviations off it. But they are alone, or as often
    under it as over it: a thing is where the mean height of those beside is more than it can be by chance. Beside is
    two deviations of the noise, or two spacings. What has no ground right under it was not lifted off any: on the flank
    of a rock it is beside it.

    Args:
        points: Cured [m], shape (n, 3), z up.
        ground: Which of them are ground, shape (n,).
        noise: Standard deviation before the cure [m].
        spacing: Between neighbours on a surface [m].
    """
    lifted, rest = np.zeros(len(points), dtype=bool), np.flatnonzero(~ground)
    if len(rest) == 0 or len(rest) == len(points):
        return lifted
    floor, near = points[ground], FAR * noise + spacing
    z = points[rest, 2]
    rest = rest[(z >= floor[:, 2].min() - near) & (z <= floor[:, 2].max() + near)]
    off, nearest = _tree(floor).query(points[rest], distance_upper_bound=near, workers=-1)
    apart = points[rest] - floor[np.minimum(nearest, len(floor) - 1)]
    low = np.flatnonzero(np.isfinite(off) & (np.hypot(apart[:, 0], apart[:, 1]) <= spacing))
    height = np.full(len(rest) + 1, near)  # of what has no ground under it: it is no noise, but a witness
    height[low] = apart[low, 2]
    height[-1] = 0.0  # of nothing beside
    radius = _BESIDE * max(noise, spacing)
    beside = _tree(points[rest]).query(points[rest[low]], k=_WITNESSES, distance_upper_bound=radius, workers=-1)[1]
    number = (beside < len(rest)).sum(axis=1)
    lifted[rest[low]] = np.abs(height[beside].sum(axis=1)) <= FAR * noise * np.sqrt(number)
    return lifted


def _tree(points: FloatArray) -> cKDTree:
    """Made in a third of the time of a balanced one, and asked as fast."""
    return cKDTree(points, balanced_tree=False, compact_nodes=False)

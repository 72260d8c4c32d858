"""Changes of a scene that wait for the build of its next version, and that version."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from gpdf_service.clouds.stream import rows_in_new_voxels
from gpdf_service.pipeline import Progress
from gpdf_service.scene import Scene
from gpdf_service.tiles.rows import chosen_rows
from gpdf_service.types import BoolArray, FloatArray


@dataclass(frozen=True, slots=True)
class Change:
    """What one scan says.

    Attributes:
        insert: Points that are new [m], (k, 3).
        gone: Places that are empty now [m], (j, 3).
        radius: What was within this of such a place is gone [m].
        origins: Where the rays to the new points began [m], (k, 3), if that is known.
        thin: Only those are taken, one each, in whose voxel of this width [m] no point is; all if it is 0.
    """

    insert: FloatArray
    gone: FloatArray
    radius: float
    origins: FloatArray | None = None
    thin: float = 0.0

    @property
    def size(self) -> int:
        """Points to hold."""
        return len(self.insert) + len(self.gone)


def changed(scene: Scene, changes: Sequence[Change], progress: Progress) -> Scene:
    """The version after all changes, in their order: what one inserts a later one may take away, not an earlier one."""
    gone = np.zeros(len(scene.points), dtype=bool)
    fresh, began = np.zeros((2, 0, 3))
    for change in changes:
        gone |= _near(scene.points, change)
        stays = ~_near(fresh, change)
        fresh, rows = fresh[stays], np.arange(len(change.insert))
        if change.thin:
            rows = rows_in_new_voxels(change.insert, change.thin, chosen_rows(scene.points, ~gone), fresh)
        origins = np.full(change.insert.shape, np.nan) if change.origins is None else change.origins
        fresh = np.concatenate([fresh, change.insert[rows]])
        began = np.concatenate([began[stays], origins[rows]])
    return scene.update(insert=fresh if len(fresh) else None, remove=gone, origins=began, progress=progress)


def _near(points: FloatArray, change: Change) -> BoolArray:
    """Which points lie where nothing is any more."""
    if not len(change.gone) or not len(points):
        return np.zeros(len(points), dtype=bool)
    distance, _ = cKDTree(change.gone).query(points, distance_upper_bound=change.radius)
    return np.asarray(np.isfinite(distance))

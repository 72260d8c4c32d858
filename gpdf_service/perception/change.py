"""What a change of a clean cloud does to its ground and its levels: only what it touches is looked at again.

What a cell holds depends on the points of its column and on cells within a known reach: what is told by them is asked
again where any of that is another (`Beside.around`, `Grid.around`). What depends on connections (which surfaces are
ground, which are one sheet, what a hole is shut off by) is decided anew from the cells of the whole scene, not from a
window of it. So the result is that of the whole cloud by construction.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gpdf_service.config import PerceptionConfig
from gpdf_service.perception.cloud import Cloud, WholeError
from gpdf_service.perception.levels import Levels, Survey, alone, change_levels
from gpdf_service.perception.rows import taken
from gpdf_service.perception.segment import Segmentation, change_segmentation
from gpdf_service.perception.strays import find_strays
from gpdf_service.types import BoolArray, FloatArray

Touched = tuple[tuple[int, BoolArray | None], ...]
"""For each level which one of those before it was made from, −1 where there was none, and the cells in which anything
is another than there, shape (nx, ny), None where nothing is."""


@dataclass(frozen=True, slots=True)
class Perceived:
    """All that is known of a clean cloud; what a change starts from.

    Attributes:
        points: The cloud [m], shape (n, 3).
        ground: Which points are ground, shape (n,).
        segmentation: What the ground was found from; None where it was given.
        levels: The sheets of ground.
        survey: What they were made of.
        touched: Where the last change made anything another; empty after a build.
    """

    points: FloatArray
    ground: BoolArray
    segmentation: Segmentation | None
    levels: Levels
    survey: Survey
    touched: Touched = ()

    def lasting(self) -> Perceived:
        """The same without what only the build needed."""
        found, survey = self.segmentation, replace(self.survey, near=self.survey.near.lasting())
        return replace(self, segmentation=None if found is None else found.lasting(), survey=survey)


def change(
    old: Perceived, points: FloatArray, keep: BoolArray, labels: BoolArray | None, config: PerceptionConfig
) -> Perceived:
    """What is known after a change.

    Args:
        old: What was known.
        points: Those that stay and, after them, those that are new [m], shape (n, 3).
        keep: Which of the old points stay, shape (m,).
        labels: Which points are ground; None where the segmentation says so.
        config: Limits.

    Raises:
        WholeError: the cloud has other bounds; build it as a whole.
        NoGroundError: nothing in it is walkable.
    """
    stay = int(np.count_nonzero(keep))
    places = np.concatenate([taken(old.points, np.flatnonzero(~keep)), points[stay:]])
    if len(places) == 0:
        same = tuple(range(len(old.levels.levels)))
        return replace(old, survey=replace(old.survey, former=same), touched=tuple((k, None) for k in same))
    cloud = Cloud(points, places)
    none = np.zeros(len(points) - stay, dtype=bool)
    before, stray = (np.concatenate([each[keep], none]) for each in (old.ground, old.survey.stray))
    segmentation, ground = old.segmentation, labels
    if ground is None:
        if segmentation is None:
            raise WholeError
        segmentation, ground = change_segmentation(segmentation, cloud, before, config)
    cloud.add(before != ground)
    again = _change_strays(stray, cloud, alone(old.survey.layers.cell_width)) & ~ground
    cloud.add(again != stray)
    levels, survey = change_levels(old.survey, cloud, ground, again, config)
    touched = tuple(zip(survey.former, (made.touched for made in survey.made), strict=True))
    return Perceived(points, ground, segmentation, levels, survey, touched).lasting()


def _change_strays(stray: BoolArray, cloud: Cloud, width: float) -> BoolArray:
    """Stray points, where those in voxels near the change may be others than before; see `find_strays`."""
    voxel = np.floor(cloud.places[:, :2] / width)
    low, high = voxel.min(axis=0), voxel.max(axis=0) + 1.0
    near = cloud.rows_in_box((low - 3.0) * width, (high + 3.0) * width)
    points = taken(cloud.points, near)
    column = np.floor(points[:, :2] / width)  # one on, another may be alone now, and asks one further
    sure = ((column >= low - 1.0) & (column < high + 1.0)).all(axis=1)
    made = stray.copy()
    made[near[sure]] = find_strays(points, width)[sure]
    return made

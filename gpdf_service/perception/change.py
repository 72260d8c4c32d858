"""What a change of a cloud does to its ground and its levels: only what it touches is looked at again.

What a cell holds depends on the points of its column and on cells within a known reach: what is told by them is asked
again where any of that is another (`Beside.around`, `Grid.around`). What depends on connections is decided anew: which
surfaces are ground from the pieces of all strips of the grid and the pairs that join them, which are one sheet and what
a hole is shut off by from the cells of the whole scene. So the result is that of the whole cloud by construction.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gpdf_service.config import PerceptionConfig
from gpdf_service.ground import Levels, Touched
from gpdf_service.perception.cloud import Cloud, WholeError, find_strays
from gpdf_service.perception.levels import Survey, alone, change_levels
from gpdf_service.perception.noisy import Noisy, change_noisy, longer
from gpdf_service.perception.rays import Rays
from gpdf_service.perception.segment import Segmentation, change_segmentation
from gpdf_service.tiles.points import Points
from gpdf_service.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class Perceived:
    """All that is known of a cloud; what a change starts from.

    Attributes:
        points: What its levels are built of, by numbers up to n: the cloud itself, if it is clean.
        ground: Which of these points are ground, shape (n,); none that is not there.
        segmentation: What the ground of a clean cloud was found from; None where it was given.
        levels: The sheets of ground.
        survey: What they were made of.
        touched: Where the last change made anything another; empty after a build.
        noisy: The cloud, and what was made of it, if it is noisy.
    """

    points: Points
    ground: BoolArray
    segmentation: Segmentation | None
    levels: Levels
    survey: Survey
    touched: Touched = ()
    noisy: Noisy | None = None
    rays: Rays | None = None

    @property
    def cloud(self) -> tuple[Points, BoolArray]:
        """The cloud as it was measured, by numbers up to m, and which of it are ground, shape (m,)."""
        return (self.points, self.ground) if self.noisy is None else (self.noisy.points, self.noisy.ground)

    def lasting(self) -> Perceived:
        """The same without what only the build needed."""
        found, noisy = self.segmentation, self.noisy
        return replace(
            self,
            segmentation=None if found is None else found.lasting(),
            survey=replace(self.survey, near=self.survey.near.lasting()),
            noisy=None if noisy is None else noisy.lasting(),
            rays=None if self.rays is None else replace(self.rays, news=None),
        )


def change(
    old: Perceived,
    gone: IntArray,
    fresh: FloatArray,
    labels: BoolArray | None,
    config: PerceptionConfig,
    began: FloatArray | None = None,
) -> Perceived:
    """What is known after a change.

    Args:
        old: What was known.
        gone: Numbers of the points that are there no more.
        fresh: Those that are new [m], shape (k, 3).
        labels: Which of these are ground, shape (k,), and the others as before; None where the segmentation says so.
        config: Limits.
        began: Of a cloud with rays where those to the new ones began [m], shape (k, 3), NaN where that is not known.

    Raises:
        WholeError: the cloud has other bounds; build it as a whole.
        NoGroundError: nothing in it is walkable.
    """
    if old.noisy is not None:
        noisy, cloud = change_noisy(old.noisy, gone, fresh, labels, config)
        before = noisy.held.told(longer(old.noisy.ground, len(noisy.ground)))
        cloud.rays = None if old.rays is None or began is None else old.rays.changed(noisy.points, gone, began)
        return _changed(replace(old, noisy=noisy), cloud, before, noisy.own_ground, config)
    if len(gone) + len(fresh) == 0:
        return _same(old)
    cloud = Cloud(old.points.changed(gone, fresh), np.concatenate([old.points.taken(gone), fresh]))
    cloud.rays = None if old.rays is None or began is None else old.rays.changed(cloud.points, gone, began)
    before = longer(old.ground, len(cloud.points.there)) & cloud.points.there
    segmentation = old.segmentation
    if labels is None:
        if segmentation is None:
            raise WholeError
        segmentation, ground = change_segmentation(segmentation, cloud, before, config)
    else:
        ground = before.copy()
        ground[len(old.ground) :] = labels
    return _changed(replace(old, segmentation=segmentation), cloud, before, ground, config)


def _changed(old: Perceived, cloud: Cloud, before: BoolArray, ground: BoolArray, config: PerceptionConfig) -> Perceived:
    """What is known of a changed cloud, of whose points some are ground, shape (n,), and others were `before`.

    Of the `old` version are the levels and their survey; what the ground was found from is of this one.
    """
    cloud.add(before != ground)
    if len(cloud.places) == 0 and not cloud.seen_anew:
        return _same(old)
    stray = longer(old.survey.stray, len(ground)) & cloud.points.there
    again = _change_strays(stray, cloud, alone(old.survey.layers.cell_width)) & ~ground
    cloud.add(again != stray)
    noise = 0.0 if old.noisy is None else old.noisy.noise
    levels, survey = change_levels(old.survey, cloud, ground, again, config, noise)
    touched = tuple(zip(survey.former, (made.touched for made in survey.made), strict=True))
    own = replace(old, points=cloud.points, ground=ground, levels=levels, survey=survey, touched=touched)
    return replace(own, rays=cloud.rays).lasting()


def _same(old: Perceived) -> Perceived:
    """What was known, of a cloud in which nothing is other: what came and went were strays, at most."""
    same = tuple(range(len(old.levels.levels)))
    survey, touched = replace(old.survey, former=same), tuple((k, None) for k in same)
    return replace(old, survey=survey, touched=touched)


def _change_strays(stray: BoolArray, cloud: Cloud, width: float) -> BoolArray:
    """Stray points, where those in voxels near the change may be others than before; see `find_strays`."""
    if len(cloud.places) == 0:
        return stray
    voxel = np.floor(cloud.places[:, :2] / width)
    low, high = voxel.min(axis=0), voxel.max(axis=0) + 1.0
    near = cloud.points.rows_in_cells((low - 2.0) * width, width, np.ones((high - low + 4.0).astype(int), dtype=bool))
    points = cloud.points.taken(near)
    x, y = np.floor(points[:, :2] / width).T  # one on, another may be alone now, and asks one further
    sure = (x >= low[0] - 1.0) & (x < high[0] + 1.0) & (y >= low[1] - 1.0) & (y < high[1] + 1.0)
    made = stray.copy()
    made[near[sure]] = find_strays(points, width)[sure]
    return made

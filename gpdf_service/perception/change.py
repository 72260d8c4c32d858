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
from gpdf_service.errors import NoGroundError
from gpdf_service.ground import Levels, Touched
from gpdf_service.perception.cloud import Cloud, WholeError, find_strays
from gpdf_service.perception.cure import Found
from gpdf_service.perception.levels import Survey, alone, change_levels
from gpdf_service.perception.noisy import longer
from gpdf_service.perception.rays import Rays
from gpdf_service.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class Perceived:
    """All that is known of a cloud; what a change starts from.

    Attributes:
        found: Its ground.
        levels: The sheets of ground.
        survey: What they were made of.
        touched: Where the last change made anything another; empty after a build.
        rays: Those to its points, where they are known.
        twin: The ground of the same cloud without its labels, once points came without: there theirs are told.
    """

    found: Found
    levels: Levels
    survey: Survey
    touched: Touched = ()
    rays: Rays | None = None
    twin: Found | None = None

    def lasting(self) -> Perceived:
        """The same without what only the build needed."""
        return replace(
            self,
            found=self.found.lasting(),
            survey=replace(self.survey, near=self.survey.near.lasting()),
            rays=None if self.rays is None else replace(self.rays, news=None),
            twin=None if self.twin is None else self.twin.lasting(),
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
        labels: Which of these are ground, shape (k,), and the others as before; None where that is to be found.
        config: Limits.
        began: Of a cloud with rays where those to the new ones began [m], shape (k, 3), NaN where that is not known, as
            it is of none without.

    Raises:
        WholeError: the cloud has other bounds; build it as a whole.
        NoGroundError: nothing in it is walkable.
    """
    if len(gone) + len(fresh) == 0:
        return _same(old)
    twin = None
    if old.found.labelled:
        twin, labels = _told_by_twin(old, gone, fresh, labels, config)
    found, cloud = old.found.changed(gone, fresh, labels, config)
    if old.rays is not None:
        cloud.rays = old.rays.changed(found.cloud[0], gone, began)
    return _changed(replace(old, found=found, twin=twin), cloud, config)


def _told_by_twin(
    old: Perceived, gone: IntArray, fresh: FloatArray, labels: BoolArray | None, config: PerceptionConfig
) -> tuple[Found | None, BoolArray]:
    """The twin of a cloud with labels, and those of the `fresh` points: as given, or what it says.

    A twin that is not asked, and cannot follow, is let go: it is made again when it is asked.
    """
    asked = labels is None and len(fresh) > 0
    twin = old.found.unlabelled(config) if asked and old.twin is None else old.twin
    try:
        twin = None if twin is None else twin.changed(gone, fresh, None, config)[0]
    except (WholeError, NoGroundError):
        if asked:
            raise
        twin = None
    if labels is None:
        labels = twin.cloud[1][-len(fresh) :] if asked and twin is not None else np.zeros(0, dtype=bool)
    return twin, labels


def _changed(old: Perceived, cloud: Cloud, config: PerceptionConfig) -> Perceived:
    """What is known of a changed cloud: of the `old` version are levels and their survey, the ground is of this one."""
    if len(cloud.places) == 0 and not cloud.seen_anew:
        return _same(old)
    ground = old.found.ground
    stray = longer(old.survey.stray, len(ground)) & cloud.points.there
    again = _change_strays(stray, cloud, alone(old.survey.layers.cell_width)) & ~ground
    cloud.add(again != stray)
    levels, survey = change_levels(old.survey, cloud, ground, again, config, old.found.spread)
    touched = tuple(zip(survey.former, (made.touched for made in survey.made), strict=True))
    return replace(old, levels=levels, survey=survey, touched=touched, rays=cloud.rays).lasting()


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

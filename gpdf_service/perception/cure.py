"""A scanner's noise taken out of a cloud before anything is built on it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from gpdf_service.config import PerceptionConfig
from gpdf_service.denoise import estimate_noise
from gpdf_service.fields import build_tree, estimate_spacing
from gpdf_service.ground import voxel_pitch
from gpdf_service.perception.cloud import Cloud
from gpdf_service.perception.noisy import Noisy, Tiles, change_noisy, longer, tiles_over, without_noise
from gpdf_service.perception.segment import ANY, Grain, Segmentation, change_segmentation, segment
from gpdf_service.tiles.columns import compacted
from gpdf_service.tiles.points import Points, points_of
from gpdf_service.tiles.rows import bounds_of, cells_of, chosen_rows
from gpdf_service.tiles.width import columns_over
from gpdf_service.types import BoolArray, FloatArray, IntArray

_SAMPLE = 60_000
"""Points that say how noisy a cloud is: enough for a thousand neighbourhoods."""
_SEEN, _SEEN_APART = 0.25, 0.1
"""[-] Noise over spacing below which it cannot be told from the shape of things: a plane of few points cuts corners.
Labels tell treads from risers and floors from feet; what is left of scans that are clean is less than a tenth."""
_DOUBLE = 1.5
"""[-] Noise of the ground over that of all, each place told from its shape, from which on the ground lies there more
than once: a stair's treads make 1.1 of it, a forest's litter 1.3, two scans that are 2 cm off each other 2.9."""
_PLACES = 300
"""Places of the ground that tell whether it lies there more than once: to a tenth, for half as much again."""
_COLUMN = 1.0
"""[m] Width of the columns that the sample is made of: several times the largest neighbourhood of 5 cm noise."""


@dataclass(frozen=True, slots=True)
class Found:
    """Which points of a cloud are ground, and what that was told by.

    Attributes:
        points: What levels are built of, by numbers up to n: the cloud itself, if it is clean.
        ground: Which of these points are ground, shape (n,); none that is not there.
        measured: Standard deviation of the cloud's points [m].
        segmentation: What the ground of a clean cloud was found from; None where it was given.
        noisy: The cloud, and what was made of it, if it is noisy.
    """

    points: Points
    ground: BoolArray
    measured: float
    segmentation: Segmentation | None = None
    noisy: Noisy | None = None

    @property
    def cloud(self) -> tuple[Points, BoolArray]:
        """The cloud as it was measured, by numbers up to m, and which of it are ground, shape (m,): no stray is."""
        return (self.points, self.ground) if self.noisy is None else (self.noisy.points, self.noisy.ground)

    @property
    def labelled(self) -> bool:
        """Whether the ground was given."""
        return self.grain is None

    @property
    def grain(self) -> Grain | None:
        """In which the ground was found; None where it was given."""
        found = self.segmentation if self.noisy is None else self.noisy.segmentation
        return None if found is None else found.grain

    @property
    def spread(self) -> float:
        """Standard deviation that was taken out of the points [m]."""
        return 0.0 if self.noisy is None else self.noisy.noise

    def lasting(self) -> Found:
        """The same without what only the build needed."""
        if self.noisy is not None:
            return replace(self, noisy=self.noisy.lasting())
        return self if self.segmentation is None else replace(self, segmentation=self.segmentation.lasting())

    def unlabelled(self, config: PerceptionConfig) -> Found:
        """The same cloud, of as much noise, whose ground is found."""
        points, _ = self.cloud
        if self.noisy is not None:
            return _cured(points, None, self.noisy.tiles, ANY, config)
        return _clean(points, None, self.measured, Grain(pitch=voxel_pitch(points)), config)

    def changed(
        self, gone: IntArray, fresh: FloatArray, labels: BoolArray | None, config: PerceptionConfig
    ) -> tuple[Found, Cloud]:
        """The next version, and where what levels are built of is another.

        Points are `gone`, by their numbers, and `fresh` ones came, shape (k, 3) [m], with their `labels` where the
        ground is given.

        Raises:
            WholeError: the cloud has other bounds; find its ground anew.
        """
        if self.noisy is not None:
            noisy, cloud = change_noisy(self.noisy, gone, fresh, labels, config)
            before, ground = noisy.held.told(longer(self.noisy.ground, len(noisy.ground))), noisy.own_ground
            cloud.add(before != ground)
            return Found(cloud.points, ground, self.measured, None, noisy), cloud
        cloud = Cloud(self.points.changed(gone, fresh), np.concatenate([self.points.taken(gone), fresh]))
        before = longer(self.ground, len(cloud.points.there)) & cloud.points.there
        segmentation, ground = self.segmentation, before.copy()
        if segmentation is None:
            ground[len(self.ground) :] = labels
        else:
            segmentation, ground = change_segmentation(segmentation, cloud, before, config)
        cloud.add(before != ground)
        return Found(cloud.points, ground, self.measured, segmentation), cloud


class Sampling(NamedTuple):
    """How a cloud was measured, told once from all of it: the changes of it that follow keep it.

    Attributes:
        grain: In which its ground was found; where that was given, the width of the levels' cells alone.
        noise: Standard deviation of its points [m]; 0 when negligible.
        tiles: By which its noise is taken out; None of a clean cloud.
    """

    grain: Grain
    noise: float
    tiles: Tiles | None = None


_Sample = tuple[BoolArray, float, float]
"""Which points are a sample of the cloud, shape (n,), and the cloud's spacing and noise [m]."""


def cure_and_segment(
    points: FloatArray, ground: BoolArray | None, config: PerceptionConfig, known: Sampling | None = None
) -> Found:
    """Move the points of a noisy cloud onto their surfaces, and tell ground from the rest.

    A clean cloud stays as it is. Two sheets close to each other are a board, and no noise; but ground has one height,
    so there they are scans that do not fit on each other, and their distance is what the cloud is off by. Of a noisy
    cloud without labels that is not asked: so lie a stair's treads.

    Args:
        points: The cloud [m], shape (n, 3).
        ground: Labels, shape (n,); our own segmentation where not given.
        config: Limits.
        known: Of a cloud that changed a little; measured when not given.
    """
    cloud = points_of(points)
    if known is not None:
        if known.tiles is not None:
            return _cured(cloud, ground, known.tiles, known.grain, config)
        return _clean(cloud, ground, known.noise, known.grain, config)
    _, spacing, noise = sample = _measure(points)
    least = max(config.negligible_noise, (_SEEN if ground is None else _SEEN_APART) * spacing)
    if ground is not None or noise <= least:
        grain = ANY if ground is not None else Grain(pitch=voxel_pitch(cloud))
        found = _clean(cloud, ground, noise, grain, config)
        noise = _with_double(points, found.ground, sample, least)
        if noise <= least:
            return replace(found, measured=noise)
    return _cured(cloud, ground, tiles_over(points, noise, spacing), ANY, config)


def _cured(points: Points, labels: BoolArray | None, tiles: Tiles, grain: Grain, config: PerceptionConfig) -> Found:
    """A cloud whose noise is taken out."""
    noisy = without_noise(points, labels, tiles, config, grain)
    return Found(noisy.held.points, noisy.own_ground, noisy.noise, None, noisy)


def _clean(points: Points, labels: BoolArray | None, noise: float, grain: Grain, config: PerceptionConfig) -> Found:
    """A cloud as it is, of so little noise."""
    if labels is not None:
        return Found(points, labels, noise)
    ground = np.zeros(len(points.there), dtype=bool)
    ground[points.there], segmentation = segment(points.present, config, grain)
    return Found(points, ground, noise, segmentation)


def _with_double(points: FloatArray, ground: BoolArray, sample: _Sample, least: float) -> float:
    """Noise of the cloud [m], or how far the sheets of its ground are off each other, where they are."""
    picked, spacing, noise = sample
    double = estimate_noise(chosen_rows(points, picked & ground), spacing, sheets=False, places=_PLACES)
    return double if double > max(_DOUBLE * noise, least) else noise


def _measure(points: FloatArray) -> _Sample:
    picked = _columns(points)
    sample = chosen_rows(points, picked)
    tree = build_tree(sample)
    spacing = estimate_spacing(sample, tree)
    return picked, spacing, estimate_noise(sample, spacing, tree=tree)


def _columns(points: FloatArray) -> BoolArray:
    """Which points are in some columns that are picked at random, where they are as dense as the cloud itself."""
    if len(points) <= _SAMPLE:
        return np.ones(len(points), dtype=bool)
    corner, far = bounds_of(points)
    shape = columns_over(corner, far, _COLUMN)
    key = compacted(cells_of(points, corner, _COLUMN, shape), shape[0] * shape[1])[0]
    count = np.bincount(key)
    order = np.random.default_rng(0).permutation(len(count))
    picked = np.zeros(len(count), dtype=bool)
    picked[order[: 1 + int(np.searchsorted(np.cumsum(count[order]), _SAMPLE))]] = True
    sampled: BoolArray = picked[key]
    return sampled

"""A scanner's noise taken out of a cloud before anything is built on it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from gpdf_service.config import PerceptionConfig
from gpdf_service.denoise import Denoised, estimate_noise
from gpdf_service.fields import build_tree, estimate_spacing
from gpdf_service.ground import voxel_pitch
from gpdf_service.perception.noisy import Noisy, Tiles, tiles_over, without_noise
from gpdf_service.perception.segment import Segmentation, segment
from gpdf_service.tiles.columns import compacted
from gpdf_service.tiles.points import points_of
from gpdf_service.tiles.rows import bounds_of, cells_of, chosen_rows
from gpdf_service.tiles.width import columns_over
from gpdf_service.types import BoolArray, FloatArray

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


class CuredGround(NamedTuple):
    """The ground of a cloud whose noise was taken out.

    Attributes:
        cured: The cloud without its noise.
        ground: Which of its points are ground, shape (n,): the labels, where they were given; else no stray point is.
        segmentation: What the ground of a cloud without labels was found from.
        noisy: What was made of a noisy cloud; None where it was clean enough to stay as it was.
    """

    cured: Denoised
    ground: BoolArray
    segmentation: Segmentation | None = None
    noisy: Noisy | None = None


class Sampling(NamedTuple):
    """How a cloud was measured, told once from all of it: the changes of it that follow keep it.

    Attributes:
        width: Of the cells that it is looked at in [m].
        noise: Standard deviation of its points [m]; 0 when negligible.
        pitch: Of the voxels whose centres they are [m], where their ground was found; else 0.
        tiles: By which its noise is taken out; None of a clean cloud.
    """

    width: float
    noise: float
    pitch: float = 0.0
    tiles: Tiles | None = None


_Sample = tuple[BoolArray, float, float]
"""Which points are a sample of the cloud, shape (n,), and the cloud's spacing and noise [m]."""


def cure_and_segment(
    points: FloatArray, ground: BoolArray | None, config: PerceptionConfig, known: Sampling | None = None
) -> CuredGround:
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

    def floor_of() -> tuple[BoolArray, Segmentation | None]:
        if ground is not None:
            return ground, None
        width, pitch = (None, voxel_pitch(points_of(points))) if known is None else (known.width, known.pitch)
        return segment(points, config, width=width, pitch=pitch)

    if known is not None and known.tiles is not None:
        return _cured(points, ground, known.tiles, known.width, config)
    if known is not None:
        floor, found = floor_of()
        return CuredGround(_clean(points, known.noise), floor, found)
    _, spacing, noise = sample = _measure(points)
    least = max(config.negligible_noise, (_SEEN if ground is None else _SEEN_APART) * spacing)
    if ground is not None or noise <= least:
        floor, found = floor_of()
        noise = _with_double(points, floor, sample, least)
        if noise <= least:
            return CuredGround(_clean(points, noise), floor, found)
    return _cured(points, ground, tiles_over(points, noise, spacing), None, config)


def _cured(
    points: FloatArray, ground: BoolArray | None, tiles: Tiles, width: float | None, config: PerceptionConfig
) -> CuredGround:
    """A cloud whose noise is taken out."""
    noisy = without_noise(points, ground, tiles, config, width)
    cured = noisy.explained._replace(points=noisy.last, measured=noisy.noise)
    return CuredGround(cured, noisy.ground, noisy.segmentation, noisy)


def _clean(points: FloatArray, noise: float) -> Denoised:
    """Points as they are, shape (n, 3): one number says the noise of all [m], and none is vague or stray."""
    none, all_ = np.broadcast_to(np.False_, len(points)), np.broadcast_to(noise, len(points))
    return Denoised(points, all_, none, none, noise, all_)


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

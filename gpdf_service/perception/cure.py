"""A scanner's noise taken out of a cloud before anything is built on it."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np

from gpdf_service.config import PerceptionConfig
from gpdf_service.errors import NoGroundError
from gpdf_service.fields import (
    Cured,
    Flight,
    build_tree,
    estimate_noise,
    estimate_spacing,
    find_lifted,
    find_loose,
    onto_risers,
    onto_surface,
    onto_treads,
    uncured,
)
from gpdf_service.fields.threads import run_beside
from gpdf_service.perception.layers import Layers, columns_over
from gpdf_service.perception.rows import bounds_of, cells_of, chosen_rows
from gpdf_service.perception.segment import Segmentation, first_layers, segment
from gpdf_service.types import BoolArray, FloatArray

_SAMPLE = 60_000
"""Points that say how noisy a cloud is: enough for a thousand neighbourhoods."""
_SEEN, _SEEN_APART = 0.25, 0.1
"""[-] Noise over spacing below which it cannot be told from the shape of things: a plane of few points cuts corners.
Labels tell treads from risers and floors from feet; what is left of scans that are clean is less than a tenth."""
_DOUBLE = 1.5
"""[-] Noise of the ground over that of all, each place told from its shape, from which on the ground lies there more
than once: a stair's treads make 1.1 of it, a forest's litter 1.3, two scans that are 2 cm off each other 2.9."""
_COLUMN = 1.0
"""[m] Width of the columns that the sample is made of: several times the largest neighbourhood of 5 cm noise."""


class CuredGround(NamedTuple):
    """The ground of a cloud whose noise was taken out.

    Attributes:
        cured: The cloud without its noise.
        ground: Which of its points are ground, shape (n,); a stray point is not.
        as_it_was: Whether the cloud was clean enough to stay as it was.
        segmentation: What the ground of a clean cloud without labels was found from.
    """

    cured: Cured
    ground: BoolArray
    as_it_was: bool
    segmentation: Segmentation | None = None


def cure_and_segment(
    points: FloatArray, ground: BoolArray | None, config: PerceptionConfig, width: float | None = None
) -> CuredGround:
    """Move the points of a noisy cloud onto their surfaces, and tell ground from the rest.

    At the foot of a wall a neighbourhood holds both floor and wall, and its plane is neither. So ground and the rest
    are cured apart: by the labels, or by a segmentation of the cloud cured as a whole. A clean cloud stays as it is.
    Two sheets close to each other are a board, and no noise; but ground has one height, so there they are scans that do
    not fit on each other, and their distance is what the cloud is off by.

    Args:
        points: The cloud [m], shape (n, 3).
        ground: Labels, shape (n,); our own segmentation where not given.
        config: Limits.
        width: Of the cells that a clean cloud is segmented in [m]; measured when not given.
    """
    given = first_layers(points, config, width) if ground is None else ground
    (first, segmentation, refused), (picked, spacing, noise) = run_beside(
        partial(_first_look, points, given, config), partial(_measure, points)
    )
    least = max(config.negligible_noise, (_SEEN if ground is None else _SEEN_APART) * spacing)
    if refused is not None and noise <= least:
        raise refused
    double = estimate_noise(chosen_rows(points, picked & first), spacing, sheets=False)
    if double > max(_DOUBLE * noise, least):
        noise = double
    if noise <= least:
        return CuredGround(uncured(points, noise), first, as_it_was=True, segmentation=segmentation)
    stray = None
    if ground is None:
        moved, _ = onto_surface(points, spacing, noise)
        stray = find_loose(moved, noise, spacing)
        ground = np.zeros(len(points), dtype=bool)
        kept = chosen_rows(moved, ~stray)
        ground[~stray] = segment(kept, first_layers(kept, config), config)[0]
    cured = _cure_apart(points, ground, noise)
    if stray is None:  # the labels have told ground from the rest
        stray = find_loose(cured.points, noise, spacing)
    else:
        stray |= find_lifted(cured.points, ground, noise, spacing)
    cured = cured._replace(stray=stray)
    return CuredGround(cured, ground & ~cured.stray, as_it_was=False)


def _cure_apart(points: FloatArray, ground: BoolArray, noise: float) -> Cured:
    """The ground, with stairs on their treads; then the rest, with what is between two treads on their risers."""
    cured = uncured(points.copy(), noise)
    flights: list[Flight] = []
    for part, is_ground in ((ground, True), (~ground, False)):
        if not part.any():
            continue
        own = points[part]
        moved, left = onto_surface(own, estimate_spacing(own), noise, level=is_ground, things=not is_ground)
        if is_ground:
            flights = onto_treads(own, noise, moved, left)
        else:
            for flight in flights:
                onto_risers(flight, own, noise, moved, left)
        cured.points[part], cured.noise[part] = moved, left
    return cured


def _measure(points: FloatArray) -> tuple[BoolArray, float, float]:
    """Which points are a sample of the cloud, shape (n,), and its spacing and its noise [m]."""
    picked = _columns(points)
    sample = chosen_rows(points, picked)
    tree = build_tree(sample)
    spacing = estimate_spacing(sample, tree)
    return picked, spacing, estimate_noise(sample, spacing, tree=tree)


def _first_look(
    points: FloatArray, given: BoolArray | Layers, config: PerceptionConfig
) -> tuple[BoolArray, Segmentation | None, NoGroundError | None]:
    """The ground of a cloud as it is, by labels or found in its layers; none, and why, where noise may hide it."""
    if not isinstance(given, Layers):
        return given, None, None
    try:
        return (*segment(points, given, config), None)
    except NoGroundError as error:
        return np.zeros(len(points), dtype=bool), None, error


def _columns(points: FloatArray) -> BoolArray:
    """Which points are in some columns that are picked at random, where they are as dense as the cloud itself."""
    if len(points) <= _SAMPLE:
        return np.ones(len(points), dtype=bool)
    corner, far = bounds_of(points)
    key = cells_of(points, corner, _COLUMN, columns_over(corner, far, _COLUMN))
    count = np.bincount(key)
    order = np.random.default_rng(0).permutation(len(count))
    picked = np.zeros(len(count), dtype=bool)
    picked[order[: 1 + int(np.searchsorted(np.cumsum(count[order]), _SAMPLE))]] = True
    sampled: BoolArray = picked[key]
    return sampled

"""A cloud whose noise is taken out, stage by stage and tile by tile: a build is a change of all tiles.

What a point becomes depends on its tile alone, the points in it and in a halo around. So a change tells the tiles anew
that it touches, and what comes out as it was is not looked at by the next stage. The noise itself is told once of all.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from math import ceil
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gpdf_service.config import PerceptionConfig
from gpdf_service.denoise import (
    BLOCK,
    Denoised,
    as_measured,
    denoise,
    find_lifted,
    halo_of,
    onto_risers,
    onto_treads,
    return_explained,
)
from gpdf_service.fields.threads import run_parallel
from gpdf_service.perception.cloud import Cloud
from gpdf_service.perception.segment import Segmentation, change_segmentation, segment
from gpdf_service.tiles.points import Points, points_of
from gpdf_service.tiles.rows import taken
from gpdf_service.tiles.width import in_steps
from gpdf_service.types import BoolArray, FloatArray, IntArray

NOISE_STEP = 0.001
"""[m] Noise counts in steps, so that a cloud which changes a little is as noisy as before; all stages know the same."""
_APART = 2.0
"""[-] Standard deviations off a surface of their own that outliers are at least, of labelled ground and where nobody
labelled it: the rim of a lid that was taken for ground is nearer to the lid's side than that, and stays where it was
measured, and so do a table's legs 7 cm before a wall."""
_HALOS = 8
"""Halos along a side of a tile: its points and those around are looked at one and a half times as often as once."""

_NONE: IntArray = np.zeros(0, np.int64)


class Tiles(NamedTuple):
    """Squares in plan that a cloud's noise is taken out by.

    Attributes:
        noise: Standard deviation of the points along the normal [m].
        spacing: Between neighbours on a surface [m].
        corner: Of one of the tiles [m].
    """

    noise: float
    spacing: float
    corner: tuple[float, float]

    @property
    def width(self) -> float:
        """Of a tile [m]: of whole cubes that are as noisy all over."""
        return ceil(_HALOS * halo_of(self.noise, self.spacing) / BLOCK) * BLOCK

    def near(self, points: FloatArray) -> list[tuple[int, int]]:
        """The tiles that hold any of the points, (n, 3) [m], in them or in their halo."""
        further = self.width / (_HALOS - 1)  # than a halo: rounding
        sides = [(x, y) for x in (-further, further) for y in (-further, further)]
        return sorted({tile for side in sides for tile in self.of(points + np.array([*side, 0.0]))})

    def of(self, points: FloatArray) -> list[tuple[int, int]]:
        """The tiles that hold any of the points, (n, 3) [m]."""
        x, y = self._index(points).T
        low, count = y.min(initial=0), max(int(y.max(initial=0)) - int(y.min(initial=0)), 0) + 1
        return [(int(n // count), int(low + n % count)) for n in np.unique(x * count + (y - low))]

    def rows(self, points: Points, tile: tuple[int, int]) -> tuple[IntArray, BoolArray]:
        """Numbers of the points in a tile and its halo, shape (k,), and which of them are in the tile itself."""
        halo, origin = self.width / _HALOS, np.array(self.corner) + self.width * np.array(tile)
        rows = points.rows_in_cells(origin - halo, halo, np.ones((_HALOS + 2, _HALOS + 2), dtype=bool))
        own: BoolArray = (self._index(points.taken(rows)) == tile).all(axis=1)
        return rows, own

    def _index(self, points: FloatArray) -> IntArray:
        """The tile in which each point is, shape (n, 2)."""
        index: IntArray = np.floor((points[:, :2] - self.corner) / self.width).astype(np.int64)
        return index


@dataclass(frozen=True, slots=True)
class Moved:
    """Some points of a cloud at other places, where each has a number of its own.

    Attributes:
        points: They; their rank is the number of each in the cloud.
        number: Of each point of the cloud the own one, −1 where it has none, shape (n,).
    """

    points: Points
    number: IntArray

    def now(self, other: IntArray, there: BoolArray, places: FloatArray) -> tuple[Moved, Cloud]:
        """The next version, and where it is another.

        Of the points that are `other`, by ascending numbers in the cloud, those that are `there`, shape (n,), are at
        their `places`, shape (n, 3) [m].
        """
        number = np.concatenate([self.number, np.full(len(there) - len(self.number), -1)])
        gone, rows = number[other], other[there[other]]
        gone = gone[gone >= 0]
        points = self.points.changed(gone, places[rows], rows)
        number[other] = -1
        number[rows] = len(self.points.there) + np.arange(len(rows))
        return Moved(points, number), Cloud(points, np.concatenate([self.points.taken(gone), places[rows]]))

    def told(self, values: NDArray[Any]) -> NDArray[Any]:
        """What is told of the cloud's points, shape (n, …), by their own numbers: nothing of what has gone."""
        points = self.points
        assert points.rank is not None
        made = values[points.rank]
        made[~points.there] = 0
        return made


@dataclass(frozen=True, slots=True)
class Noisy:
    """A noisy cloud, and what was made of it; arrays by the numbers of its points, shape (n,) or (n, 3).

    Attributes:
        points: As they were measured.
        tiles: By which its noise is taken out.
        labels: Which are ground, where that was given.
        first: Off the noise.
        kept: Without strays: what the ground is found in; None with labels.
        segmentation: Of these.
        ground: Which are ground.
        explained: Where what is doubtful was put back to where it is from, and strays are told.
        last: Where all are at last: a stair's treads and risers are told with labels.
        held: What the levels are built of.
    """

    points: Points
    tiles: Tiles
    labels: BoolArray | None
    first: Denoised
    kept: Moved | None
    segmentation: Segmentation | None
    ground: BoolArray
    explained: Denoised
    last: FloatArray
    held: Moved

    def lasting(self) -> Noisy:
        """The same without what only the build needed."""
        return self if self.segmentation is None else replace(self, segmentation=self.segmentation.lasting())

    @property
    def noise(self) -> float:
        """As every later stage knows it: a step that one of two takes for noise is the top of no face [m]."""
        return in_steps(self.tiles.noise, NOISE_STEP)

    @property
    def own_ground(self) -> BoolArray:
        """Which of the points that levels are built of are ground, by their numbers."""
        return self.held.told(self.ground)


def without_noise(
    points: Points,
    labels: BoolArray | None,
    tiles: Tiles,
    config: PerceptionConfig,
    *,
    width: float | None = None,
    was: Noisy | None = None,
    news: IntArray = _NONE,
) -> tuple[Noisy, Cloud]:
    """A cloud without its noise, and where what the levels are built of is other than in the version before.

    Labels keep the surfaces of ground and of the rest apart: at the foot of a wall a window holds both. A cloud without
    labels is denoised as a whole, and then segmented.

    Args:
        points: As they were measured.
        labels: Which are ground, shape (n,), where that is given.
        tiles: By which the noise is taken out.
        config: Limits.
        width: Of the cells that the ground is found in [m]; measured when not given.
        was: The version before, if there was one.
        news: Numbers, which ascend, of the points that came since, and of those that went.
    """
    count = len(points.there)
    first = (
        as_measured(points.present.copy(), tiles.noise) if was is None else was.first.each(partial(longer, count=count))
    )
    asked = tiles.of(points.present) if was is None else tiles.near(points.taken(news))
    other = _tell(points, tiles, asked, first, partial(_denoised, points, tiles, labels)) | _among(news, count)
    if labels is None:
        kept, segmentation, ground = _find_ground(first, points.there & ~first.stray, other, was, width, config)
    else:
        kept, segmentation, ground = None, None, labels
    if was is None:
        explained = first.each(np.copy)
    else:
        other |= ground != longer(was.ground, count)
        asked, explained = (
            tiles.near(points.taken(np.flatnonzero(other))),
            was.explained.each(partial(longer, count=count)),
        )
    explain = partial(_explained, points, tiles, first, ground, labels is not None)
    other = _tell(points, tiles, asked, explained, explain) | _among(news, count)
    last = explained.points
    if labels is not None:
        last = _settled(points, ground, explained)
        other |= True if was is None else (last != longer(was.last, count)).any(axis=1)
    there = points.there & ~explained.stray
    if was is None:
        held = moved(last, there)
        cloud = Cloud(held.points, last[:0])
    else:
        held, cloud = was.held.now(np.flatnonzero(other), there, last)
    return Noisy(points, tiles, labels, first, kept, segmentation, ground, explained, last, held), cloud


def change_noisy(
    was: Noisy, gone: IntArray, fresh: FloatArray, labels: BoolArray | None, config: PerceptionConfig
) -> tuple[Noisy, Cloud]:
    """The next version of a cloud: see `without_noise`.

    Points are `gone`, by their numbers, and `fresh` ones came, shape (k, 3) [m]: of a cloud with labels with theirs.
    """
    points = was.points.changed(gone, fresh)
    news = np.concatenate([np.sort(gone), np.arange(len(was.points.there), len(points.there))])
    told = None
    if was.labels is not None and labels is not None:
        told = np.concatenate([was.labels, labels]) & points.there
    return without_noise(points, told, was.tiles, config, was=was, news=news)


def moved(places: FloatArray, there: BoolArray) -> Moved:
    """A first version of the points of a cloud that are `there`, shape (n,), at their `places`, shape (n, 3) [m]."""
    rows, number = np.flatnonzero(there), np.full(len(there), -1)
    number[rows] = np.arange(len(rows))
    return Moved(points_of(taken(places, rows), rows), number)


def longer(values: NDArray[Any], count: int) -> NDArray[Any]:
    """A copy with zeros after it, so that it has so many rows."""
    return np.concatenate([values, np.zeros((count - len(values), *values.shape[1:]), values.dtype)])


def _among(numbers: IntArray, count: int) -> BoolArray:
    found = np.zeros(count, dtype=bool)
    found[numbers] = True
    return found


def _tell(
    points: Points, tiles: Tiles, asked: list[tuple[int, int]], made: Denoised, tell: Callable[[IntArray], Denoised]
) -> BoolArray:
    """Write what is told of the points in the `asked` tiles; of which it is other than before, shape (n,).

    The question is called with the numbers of points in a tile and around it.
    """
    other = np.zeros(len(points.there), dtype=bool)

    def one(tile: tuple[int, int]) -> None:
        rows, own = tiles.rows(points, tile)
        if not own.any():
            return
        inner, told = rows[own], tell(rows)
        for whole, fresh in zip(made.arrays, told.arrays, strict=True):
            differs = whole[inner] != fresh[own]
            other[inner] |= differs if differs.ndim == 1 else differs.any(axis=1)
            whole[inner] = fresh[own]

    run_parallel(one, asked)
    return other


def _denoised(points: Points, tiles: Tiles, labels: BoolArray | None, rows: IntArray) -> Denoised:
    return denoise(points.taken(rows), tiles.noise, tiles.spacing, None if labels is None else labels[rows])


def _find_ground(
    first: Denoised,
    there: BoolArray,
    other: BoolArray,
    was: Noisy | None,
    width: float | None,
    config: PerceptionConfig,
) -> tuple[Moved, Segmentation, BoolArray]:
    """The points that are `there`, shape (n,), in what their ground is found, and which of the cloud are ground."""
    ground = np.zeros(len(there), dtype=bool)
    if was is None or was.kept is None or was.segmentation is None:
        kept = moved(first.points, there)
        own, found = segment(kept.points.present, config, width=width, noise=kept.told(first.local))
    else:
        kept, cloud = was.kept.now(np.flatnonzero(other), there, first.points)
        before = kept.told(longer(was.ground, len(there)))
        own_noise = kept.told(first.local)
        found, own = change_segmentation(was.segmentation, cloud, before, config, own_noise)
    ground[there] = own[kept.number[there]]
    return kept, found, ground


def _explained(
    points: Points, tiles: Tiles, first: Denoised, ground: BoolArray, labelled: bool, rows: IntArray
) -> Denoised:
    """Points of which some are put back to the surface that explains them, and which are strays.

    With labels the floor explains nothing that was labelled as no ground, and no thing what is ground. Without, ground
    is put back nowhere: such points clump, and leave cells empty.
    """
    own, floor = points.taken(rows), ground[rows]
    cured = first.each(lambda told: told[rows])
    if labelled:
        cured.stray[~floor] = False  # what is alone goes back to a surface that explains it, or stays where it is
        return_explained(own, ~floor, ~floor, cured, tiles.spacing)
        return_explained(own, floor, floor, cured, tiles.spacing, _APART)
        return cured
    return_explained(own, ~floor, floor, cured, tiles.spacing, _APART)
    return cured._replace(stray=cured.stray | find_lifted(cured.points, floor, tiles.noise, tiles.spacing))


def _settled(points: Points, ground: BoolArray, cured: Denoised) -> FloatArray:
    """Where the points are, (n, 3) [m], with those of a stair on its treads and risers."""
    floor, rest = (np.flatnonzero(points.there & kind) for kind in (ground, ~ground))
    own, made, left = points.taken(floor), cured.points[floor], cured.noise[floor]
    flights = onto_treads(own, cured.measured, made, left)
    if not flights:
        return cured.points
    last = cured.points.copy()
    last[floor] = made
    own, made, left = points.taken(rest), cured.points[rest], cured.noise[rest]
    onto_risers(flights, own, cured.measured, made, left)
    last[rest] = made
    return last

"""A cloud whose noise is taken out, stage by stage and tile by tile: a build is a change of all tiles.

What a point becomes depends on its tile alone, the points in it and in a halo around. So a change tells the tiles anew
that it touches, and what comes out as it was is not looked at by the next stage. The noise itself is told once of all.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
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
from gpdf_service.perception.segment import ANY, Grain, Segmentation, change_segmentation, segment
from gpdf_service.tiles.columns import compacted
from gpdf_service.tiles.points import Base, Points, points_of
from gpdf_service.tiles.rows import INDEX, bounds_of, cells_of
from gpdf_service.tiles.width import columns_over, in_steps
from gpdf_service.types import BoolArray, FloatArray, IntArray

NOISE_STEP = 0.001
"""[m] Noise counts in steps, so that a cloud which changes a little is as noisy as before; all stages know the same."""
_APART = 2.0
"""[-] Standard deviations off a surface of their own that outliers are at least, of labelled ground and where nobody
labelled it: the rim of a lid that was taken for ground is nearer to the lid's side than that, and stays where it was
measured, and so do a table's legs 7 cm before a wall."""
_HALOS = 16
"""Halos along a side of a tile, about: then its points and those around are a quarter more than its own."""
_STEP = 0.25
"""[-] Of a halo: places that are nearer to each other count as one when tiles are looked for that they are near to."""


class Tiles(NamedTuple):
    """Rectangles in plan that a cloud's noise is taken out by.

    Attributes:
        noise: Standard deviation of the points along the normal [m].
        spacing: Between neighbours on a surface [m].
        corner: Of one of the tiles [m].
        width: Of each in x and y [m], of whole cubes that are as noisy all over.
    """

    noise: float
    spacing: float
    corner: tuple[float, float]
    width: tuple[float, float]

    @property
    def halo(self) -> float:
        """How far around a tile points decide on its own [m]."""
        return halo_of(self.noise, self.spacing)

    def near(self, points: FloatArray) -> list[tuple[int, int]]:
        """The tiles that hold any of the points, (n, 3) [m], in them or in their halo."""
        if len(points) == 0:
            return []
        size, (low, high) = _STEP * self.halo, bounds_of(points)
        shape = columns_over(low, high, size)
        cell, count, held = compacted(cells_of(points, low, size, shape), shape[0] * shape[1])
        some = np.flatnonzero(np.bincount(cell, minlength=count))
        begin = low - self.corner + size * np.column_stack(np.divmod(held[some] if len(held) else some, shape[1]))
        off = -self.halo - size, self.halo + 2.0 * size
        # x and y in one number, to be told apart at once
        ends = [np.floor((begin + np.array([i, j])) / self.width) @ [1.0, 1.0j] for i in off for j in off]
        return [(int(tile.real), int(tile.imag)) for tile in np.unique(np.concatenate(ends))]

    def rows(self, points: Points, tile: tuple[int, int]) -> tuple[IntArray, BoolArray]:
        """Numbers of the points in a tile and its halo, shape (k,), and which of them are in the tile itself."""
        halo, (low, high) = self.halo, self._ends(np.array([tile, (tile[0] + 1, tile[1] + 1)]))
        cells = np.ceil((high - low) / halo).astype(int) + 3
        rows = points.rows_in_cells(low - halo, halo, np.ones(cells, dtype=bool))
        x, y = points.taken(rows).T[:2]
        around = (x < high[0] + halo) & (y < high[1] + halo)
        own: BoolArray = (x >= low[0]) & (x < high[0]) & (y >= low[1]) & (y < high[1])
        return rows[around], own[around]

    def _ends(self, tiles: IntArray) -> FloatArray:
        """Where tiles, (k, 2), begin [m]: in whole metres, to the bit."""
        begin: FloatArray = np.array(self.corner) + np.array(self.width) * tiles
        return begin


def tiles_over(points: FloatArray, noise: float, spacing: float) -> Tiles:
    """Tiles that the points, (n, 3) [m], fill evenly: a room is one, or some, and none is a strip at its end."""
    (low, high), most = bounds_of(points), _HALOS * halo_of(noise, spacing)
    corner = np.floor(low / BLOCK) * BLOCK
    count = np.maximum(np.round((high - corner) / most), 1.0)
    width = np.ceil(np.maximum((high - corner) / count, 0.5 * most) / BLOCK) * BLOCK
    return Tiles(noise, spacing, (float(corner[0]), float(corner[1])), (float(width[0]), float(width[1])))


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
        if len(self.number) == 0:
            made = moved(places, there)
            return made, Cloud(made.points, places[:0])
        number = np.concatenate([self.number, np.full(len(there) - len(self.number), -1, INDEX)])
        gone, rows = number[other], other[there[other]]
        gone = gone[gone >= 0]
        points = self.points.changed(gone, places[rows], rows.astype(INDEX))
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
        kept: Without strays: what the ground is found in, where there are no labels.
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
    kept: Moved
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
    grain: Grain = ANY,
) -> Noisy:
    """A cloud without its noise, and its ground: a change of one without points.

    Labels keep the surfaces of ground and of the rest apart: at the foot of a wall a window holds both. A cloud without
    labels is denoised as a whole, and then segmented.

    Args:
        points: As they were measured, by numbers up to n.
        labels: Which are ground, shape (n,), where that is given.
        tiles: By which the noise is taken out.
        config: Limits.
        grain: In which the ground is found.
    """
    none, every = np.zeros(0, dtype=bool), points.base.points[:0]
    nothing = moved(every, none)
    # those that have gone stay where they were measured: at the origin they would widen what is looked through
    first = as_measured(every if points.untouched else np.concatenate([points.base.points, points.more]), tiles.noise)
    was = Noisy(points_of(every), tiles, labels, first, nothing, None, none, first, every, nothing)
    return _changed(was, points, labels, np.flatnonzero(points.there), config, grain)[0]


def change_noisy(
    was: Noisy, gone: IntArray, fresh: FloatArray, labels: BoolArray | None, config: PerceptionConfig
) -> tuple[Noisy, Cloud]:
    """The next version of a cloud, and where what the levels are built of is other than before.

    Points are `gone`, by their numbers, and `fresh` ones came, shape (k, 3) [m]: of a cloud with labels with theirs.
    """
    points = was.points.changed(gone, fresh)
    news = np.concatenate([np.sort(gone), np.arange(len(was.points.there), len(points.there))])
    told = None
    if was.labels is not None and labels is not None:
        told = np.concatenate([was.labels, labels]) & points.there
    return _changed(was, points, told, news, config)


def _changed(
    was: Noisy,
    points: Points,
    labels: BoolArray | None,
    news: IntArray,
    config: PerceptionConfig,
    grain: Grain = ANY,
) -> tuple[Noisy, Cloud]:
    """See `change_noisy`; `news` are the numbers, which ascend, of points that went, or came."""
    tiles, count, new = was.tiles, len(points.there), np.zeros(len(points.there), dtype=bool)
    new[news] = True
    first = was.first.each(partial(longer, count=count))
    other = new | _tell(points, tiles, news, first.arrays, partial(_denoised, points, tiles, labels))
    if labels is None:
        kept, segmentation, ground = _find_ground(was, first, points.there & ~first.stray, other, config, grain)
    else:
        kept, segmentation, ground = was.kept, None, labels
    other |= ground != longer(was.ground, count)
    places, noise, stray = made = tuple(longer(each, count) for each in _explained_of(was.explained))
    explain = partial(_explained, points, tiles, first, ground, labels is not None)
    other = new | _tell(points, tiles, np.flatnonzero(other), made, explain)
    explained, last = first._replace(points=places, noise=noise, stray=stray), places
    if labels is not None:
        last = _settled(points, ground, explained)
        other |= (last != longer(was.last, count)).any(axis=1)
    held, cloud = was.held.now(np.flatnonzero(other), points.there & ~stray, last)
    return Noisy(points, tiles, labels, first, kept, segmentation, ground, explained, last, held), cloud


def moved(places: FloatArray, there: BoolArray) -> Moved:
    """A first version of a cloud's points that are `there`, (n,), at their `places`, (n, 3) [m], which it keeps."""
    rank = np.arange(len(there), dtype=INDEX)
    return Moved(Points(Base(places), places[:0], there, rank), np.where(there, rank, INDEX(-1)))


def longer(values: NDArray[Any], count: int) -> NDArray[Any]:
    """A copy with zeros after it, so that it has so many rows."""
    return np.concatenate([values, np.zeros((count - len(values), *values.shape[1:]), values.dtype)])


def _tell(
    points: Points,
    tiles: Tiles,
    news: IntArray,
    told: tuple[NDArray[Any], ...],
    tell: Callable[[IntArray], tuple[NDArray[Any], ...]],
) -> BoolArray:
    """Write what is told of the points in tiles with any of the `news`; of which it is other than before, shape (n,).

    The question is called with the numbers of points in a tile and around it.
    """
    other = np.zeros(len(points.there), dtype=bool)

    def one(tile: tuple[int, int]) -> None:
        rows, own = tiles.rows(points, tile)
        if not own.any():
            return
        inner, fresh = rows[own], tell(rows)
        for whole, now in zip(told, fresh, strict=True):
            made = now[own]
            other[inner] |= (made != whole[inner]).reshape(len(made), -1).any(axis=1)
            whole[inner] = made

    run_parallel(one, tiles.near(points.taken(news)))
    return other


def _denoised(points: Points, tiles: Tiles, labels: BoolArray | None, rows: IntArray) -> tuple[NDArray[Any], ...]:
    parts = None if labels is None else labels[rows]
    return denoise(points.taken(rows), tiles.noise, tiles.spacing, parts).arrays


def _find_ground(
    was: Noisy, first: Denoised, there: BoolArray, other: BoolArray, config: PerceptionConfig, grain: Grain
) -> tuple[Moved, Segmentation, BoolArray]:
    """The points that are `there`, shape (n,), in what their ground is found, and which of the cloud are ground."""
    kept, cloud = was.kept.now(np.flatnonzero(other), there, first.points)
    ground = np.zeros(len(there), dtype=bool)
    if was.segmentation is None:
        ground[there], found = segment(kept.points.present, config, grain, first.local[there])
        return kept, found, ground
    if len(cloud.places) == 0:
        return kept, was.segmentation, longer(was.ground, len(there))
    before = kept.told(longer(was.ground, len(there)))
    found, own = change_segmentation(was.segmentation, cloud, before, config, kept.told(first.local))
    ground[there] = own[kept.number[there]]
    return kept, found, ground


def _explained_of(told: Denoised) -> tuple[FloatArray, FloatArray, BoolArray]:
    """What `_explained` tells."""
    return told.points, told.noise, told.stray


def _explained(
    points: Points, tiles: Tiles, first: Denoised, ground: BoolArray, labelled: bool, rows: IntArray
) -> tuple[NDArray[Any], ...]:
    """Points of which some are put back to the surface that explains them, and which are strays.

    With labels the floor explains nothing that was labelled as no ground, and no thing what is ground. Without, ground
    is put back nowhere: such points clump, and leave cells empty.
    """
    own, floor, cured = points.taken(rows), ground[rows], first.each(lambda told: told[rows])
    if labelled:
        cured.stray[~floor] = False  # what is alone goes back to a surface that explains it, or stays where it is
        return_explained(own, ~floor, ~floor, cured, tiles.spacing)
        return_explained(own, floor, floor, cured, tiles.spacing, _APART)
        return _explained_of(cured)
    return_explained(own, ~floor, floor, cured, tiles.spacing, _APART)
    lifted = find_lifted(cured.points, floor, tiles.noise, tiles.spacing)
    return _explained_of(cured._replace(stray=cured.stray | lifted))


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

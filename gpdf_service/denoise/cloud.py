"""A cloud without its noise, in one pass: planes that vote.

A Gaussian error of 5 cm biases a distance field by −14 cm at 2 m above a floor: the highest outliers are nearest. No
margin cures that, so points go onto the surface that they were measured on before anything is built. Windows of cells
are planes where the noise explains how thick they are; each cell takes the planes of the windows around it together,
and each of its points goes to the nearest. What is no plane stays as it is or moves little, and says so: it is thicker
by its noise, on the safe side. The work is that of the points, whatever they are of. First with wide cells, where all
around is flat, and then with those that are as narrow as the noise lets them be.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import sqrt
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gpdf_service.denoise.cells import Cells, cells_around, rows_around, sort_into_cells
from gpdf_service.denoise.edges import place_at_edges
from gpdf_service.denoise.place import Placed, place_in_cells
from gpdf_service.denoise.planes import Windows, find_planes
from gpdf_service.denoise.rest import EXTREME, find_alone, follow_planes
from gpdf_service.denoise.rims import draw_in
from gpdf_service.fields.shapes import FEWEST
from gpdf_service.fields.threads import run_chunked
from gpdf_service.types import BoolArray, FloatArray, IntArray

RESOLVED = 2.0
"""[-] Width of a cell over the noise: a window is then twice as wide as it is thick (standard deviations)."""
_FILLED = 1.3
"""[-] Width of a cell over the spacing: a window of a plane then holds fifteen points."""
_WIDE = 2.0
"""[-] Width of the wide cells over that of the others: a window of 12 σ, as precise again, where all of it is flat."""
_FLAT = 7
"""Votes, of the nine in a layer, that a wide cell's plane has more than where all around it is flat."""
_HALO = 3
"""Wide cells around some points without which these are told otherwise: at an edge planes are taken from as far. What
is further off moves one point in five hundred by a tenth of the noise, and none of them nearer to where it is from."""
_FEW = 0.01
"""[-] Of the points that are left, below which wider cells are not tried: they are outliers, not a surface."""
_BIAS = 3.0
"""[-] Standard deviation left over the standard error of a plane: where its surface bends it is off by more."""
HIDDEN = 0.6
"""[-] Least standard deviation left over the noise: relief within it passes for noise."""
_NEGLIGIBLE = 0.05
"""[-] Noise over spacing below which the gaps between the points hide it."""
BLOCK = 1.0
"""[m] Width of the cubes that are as noisy all over: several times the largest window of 5 cm noise."""
_TOLD = 100
"""Points of a cube that tell its noise: to a tenth. Fewer, or less than half of them, tell nothing."""
_QUIETER = np.sqrt(2.0)
"""[-] Noise that is denoised as one, over the least in it: as much again as single windows differ by chance."""
_QUIETEST = 6
"""Times that the noise is less by that: an eighth. Cells then have the width of the spacing, whatever the noise."""
_ROUNDS = 2
"""Of this: where a lid and the floor were smeared into one, the next one tells them apart, and less noise."""
_NORMAL = 1.4826
"""[-] Standard deviation of normal residuals over the median of their size."""


class Denoised(NamedTuple):
    """Points on their surfaces.

    Attributes:
        points: [m], shape (n, 3), in the order of the input.
        noise: Standard deviation left along the normal [m], shape (n,).
        vague: Points whose surface is hardly known, or only the plane of a cell beside, shape (n,).
        stray: Points of no surface: alone where their surroundings are well sampled, shape (n,).
        measured: Standard deviation of the input along the normal where it is most [m].
        local: The same around each point [m], shape (n,).
    """

    points: FloatArray
    noise: FloatArray
    vague: BoolArray
    stray: BoolArray
    measured: float
    local: FloatArray

    @property
    def arrays(self) -> tuple[NDArray[Any], ...]:
        """What is told of each point."""
        return self.points, self.noise, self.vague, self.stray, self.local

    def each(self, made: Callable[[NDArray[Any]], NDArray[Any]]) -> Denoised:
        """With what is `made` of each of these arrays in its place."""
        points, noise, vague, stray, local = map(made, self.arrays)
        return Denoised(points, noise, vague, stray, self.measured, local)


def as_measured(points: FloatArray, noise: float) -> Denoised:
    """Points as they are, shape (n, 3), with the noise that they have [m]."""
    none, all_ = np.zeros(len(points), dtype=bool), np.full(len(points), noise)
    return Denoised(points, all_, none, none.copy(), noise, all_.copy())


def halo_of(noise: float, spacing: float) -> float:
    """How far around some points others are needed to denoise them [m]; see `denoise`."""
    return _HALO * _WIDE * _width_of(noise, spacing)


def _width_of(noise: float, spacing: float) -> float:
    """Width of the cells [m]."""
    return max(RESOLVED * noise, _FILLED * spacing)


def denoise(points: FloatArray, noise: float, spacing: float, parts: BoolArray | None = None) -> Denoised:
    """Move every point onto the surface around it, where there is one, and find those of no surface.

    Args:
        points: The cloud [m], shape (n, 3).
        noise: Standard deviation of the points along the normal [m].
        spacing: Between neighbours on a surface [m].
        parts: Which are ground, shape (n,), where that is known: the surfaces of ground and of the rest are told
            without each other, for at the foot of a wall a window holds both.
    """
    if noise <= _NEGLIGIBLE * spacing:
        return as_measured(points, noise)
    parts = np.zeros(len(points), dtype=bool) if parts is None else parts
    made = as_measured(points.copy(), noise)
    for part in (parts, ~parts):
        rows = np.flatnonzero(part)
        if len(rows) > FEWEST:
            own = _denoise_part(points.take(rows, 0), noise, spacing)
            for whole, told in zip(made.arrays, own.arrays, strict=True):
                whole[rows] = told
    return made


def _denoise_part(points: FloatArray, noise: float, spacing: float) -> Denoised:
    """All as noisy as the noisiest, then what is quieter with its own noise, beside what is around it."""
    made = _denoise_alike(points, noise, spacing)
    blocks = sort_into_cells(made.points, BLOCK)  # as measured, one that cuts a wall's points has those off little
    for _ in range(_ROUNDS):
        found = list(_quieter(points, blocks, made))
        if not found:
            break
        for own, rows, quieter in found:
            part, mine = _denoise_alike(points[rows], quieter, spacing), own[rows]
            for whole, fresh in zip(made.arrays, part.arrays, strict=True):
                whole[rows[mine]] = fresh[mine]
    return made


def _quieter(points: FloatArray, blocks: Cells, made: Denoised) -> Iterator[tuple[BoolArray, IntArray, float]]:
    """Points of quieter places than was thought, shape (n,), the rows of windows around them, and the noise there."""
    median = np.empty(len(blocks.key))
    run_chunked(lambda a, b: _medians(blocks, points, made, a, b, median), len(median))
    less = np.log(made.measured / np.maximum(_NORMAL * median, 1e-9)) / np.log(_QUIETER)
    level = np.empty(len(points), np.int8)
    level[blocks.order] = np.repeat(np.clip(less, 0, _QUIETEST).astype(np.int8), np.diff(blocks.begin))
    for times in range(1, int(level.max(initial=0)) + 1):
        noise = made.measured / _QUIETER**times
        own = (level == times) & (made.local > noise)
        if own.any():
            width = 3.0 * _WIDE * RESOLVED * noise  # windows around those of a wide cell
            yield own, rows_around(points, own, width), noise


@njit(cache=True, nogil=True)
def _medians(blocks: Cells, points: FloatArray, made: Denoised, begin: int, end: int, median: FloatArray) -> None:
    """Median of how far the well-known points of each block were moved [m]; the most that is told if these are few."""
    x, y, off = points, made.points, np.empty(np.diff(blocks.begin[begin : end + 1]).max())
    for c in range(begin, end):
        rows, count = blocks.order[blocks.begin[c] : blocks.begin[c + 1]], 0
        for i in rows:
            off[count] = sqrt((y[i, 0] - x[i, 0]) ** 2 + (y[i, 1] - x[i, 1]) ** 2 + (y[i, 2] - x[i, 2]) ** 2)
            count += made.noise[i] <= HIDDEN * made.measured
        median[c] = np.median(off[:count]) if count >= _TOLD and 2 * count >= len(rows) else made.measured


def _denoise_alike(points: FloatArray, noise: float, spacing: float) -> Denoised:
    """Points that are as noisy all over, in one pass."""
    width = _width_of(noise, spacing)
    cells = sort_into_cells(points, _WIDE * width)
    error, pending = np.full(len(points), np.inf), np.ones(len(points), dtype=bool)
    placed = Placed(points.copy(), error, pending, np.zeros(points.shape, np.float32))
    wide = find_planes(cells, noise, np.ones(len(cells.key), dtype=bool))
    _place_flat(wide, placed)
    cells = sort_into_cells(points, width)
    near = find_planes(cells, noise, cells_around(cells, placed.pending))
    _place_flat(near, placed)
    astray = follow_planes(near, placed) | follow_planes(wide, placed)
    place_in_cells(near, placed)
    astray |= follow_planes(near, placed)
    if placed.pending.mean() > _FEW:
        place_in_cells(wide, placed)
    astray |= draw_in(near, placed)
    left = np.where(placed.pending, np.inf, _BIAS * placed.error)
    vague, stray = astray | (left >= EXTREME * noise), find_alone(cells, placed)
    left = np.clip(left, HIDDEN * noise, EXTREME * noise)
    return Denoised(placed.points, left, vague, stray, noise, np.full(len(points), noise))


def _place_flat(windows: Windows, placed: Placed) -> None:
    """Put points onto planes where all around is flat, then where such planes meet."""
    place_in_cells(windows, placed, _FLAT)
    place_at_edges(windows, placed)

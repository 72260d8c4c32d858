"""Rays followed over the cells of a grid: how many passed low over each one, and how many fell into it.

A ray is free from its origin to the point that it hit. It is followed in plan from cell to cell, and only where it is
as low as the ground: of a ray to a wall that is nowhere, of one to the floor it is its last part. What it says of a
cell depends on the ray and on that cell alone, to the bit: so counts of some rays, and of some cells, add up.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gpdf_service.fields.threads import run_parallel
from gpdf_service.kernel_cache import lean
from gpdf_service.perception.rays import Bundle
from gpdf_service.tiles.boxes import over_blocks, window
from gpdf_service.tiles.surface import HeightMap, cropped
from gpdf_service.types import BoolArray, Float32Array, FloatArray, IntArray

SHARES = 4
"""Parts of the rays, each counted by itself."""
TILE = 16
"""Cells along the side of a tile, which a ray that is over its ground crosses in one step."""
FARTHEST = 512
"""[cells] Before its point a ray is followed as far: 20 m in cells of 4 cm. So its work is bounded."""
SHORTEST = 1e-9
"""[-] Of a ray: a shorter part of it was in no cell, so that no rounding decides in which one it was."""
ROUNDING = 1e-6
"""[m] By which boxes that rays are first held against are larger than what is in them."""

Counts = NDArray[np.int32]
_Place = tuple[float, float, float]
_Ray = tuple[_Place, _Place, tuple[float, float], float]
"""Where a ray begins and how far it goes along each axis [m], the shares of it between which it counts, and the height
under which ground lies that it falls to or comes from [m]."""


class Follow(NamedTuple):
    """How rays are followed.

    Attributes:
        corner: Of the cells that are counted from 0 [m], shape (2,).
        width: Of the cells [m].
        before: A ray counts as far as so much before its point [m].
        deep: Under the ground, from or to which a ray falls [m].
    """

    corner: FloatArray
    width: float
    before: float
    deep: float

    def over(self, bundles: Sequence[Bundle], filled: HeightMap, room: Float32Array, asked: BoolArray) -> Counts:
        """How many rays passed low over each of the `asked` cells, and how many fell into it, shape (nx, ny, 2)."""
        made = np.zeros((*asked.shape, 2), np.int32)
        if not asked.any():
            return made
        box = window(asked, 0)
        field = self._field(cropped(filled, box), room[box], asked[box])
        shares = [np.zeros((len(field.height), 2), np.int32) for _ in range(SHARES)]

        def count(share: int) -> None:
            for each in bundles:
                _cast(each, field, share, shares[share])

        run_parallel(count, range(SHARES))
        made[asked] = np.sum(shares, axis=0)
        return made

    def _field(self, part: HeightMap, room: Float32Array, asked: BoolArray) -> _Field:
        top = np.where(asked, part.height + room, np.float32(np.nan))
        height = np.where(asked, part.height, np.float32(np.nan))
        lowest = over_blocks(height, TILE, np.fmin, np.inf).astype(np.float64) - ROUNDING
        highest = over_blocks(top, TILE, np.fmax, -np.inf).astype(np.float64) + ROUNDING
        first = np.rint((part.origin - self.corner) / self.width).astype(np.int64)
        low = np.append(part.origin - ROUNDING, lowest.min())
        high = np.append(part.origin + self.width * np.array(asked.shape) + ROUNDING, highest.max())
        number = np.where(asked, np.cumsum(asked).reshape(asked.shape) - 1, -1).astype(np.int32)
        return _Field(self, number, height[asked], top[asked], lowest, highest, first, low, high)


class _Field(NamedTuple):
    """Cells that are asked about, in a box of a grid.

    Attributes:
        how: Rays are followed.
        number: Of each cell among those asked, −1 of the others, shape (nx, ny).
        height: Of those asked [m], shape (m,).
        top: How high a ray may pass over each [m], shape (m,).
        lowest: The lowest height in each tile [m].
        highest: The highest top in each tile [m].
        first: The first cell of the box in the grid.
        low: Lower corner of a box that holds all [m], shape (3,).
        high: Its upper corner [m], shape (3,).
    """

    how: Follow
    number: NDArray[np.int32]
    height: Float32Array
    top: Float32Array
    lowest: FloatArray
    highest: FloatArray
    first: IntArray
    low: FloatArray
    high: FloatArray


@lean()
def _part(along: _Place, how: Follow) -> tuple[float, float]:
    """Where a ray is surely free, and not too far off its point, as shares of it; none of it if it is short."""
    plan = along[0] ** 2 + along[1] ** 2
    length = np.sqrt(plan + along[2] ** 2)
    if not how.before < length < np.inf:
        return 1.0, 0.0
    last = 1.0 - how.before / length
    return max(0.0, last - FARTHEST * how.width / max(np.sqrt(plan), how.width)), last


@lean()
def _cell_at(ray: _Ray, t: float, k: int, field: _Field) -> int:
    """In which cell of the box, or beyond it, a share of a ray ends along an axis."""
    return int(np.floor((ray[0][k] + t * ray[1][k] - field.how.corner[k]) / field.how.width)) - int(field.first[k])


@lean()
def _part_at_ground(ray: _Ray, field: _Field) -> tuple[float, float]:
    """Where that part of a ray enters and leaves the box that holds all that is asked about."""
    a, along, (first, last), _ = ray
    for k in range(3):
        if along[k] == 0.0:
            inside = field.low[k] <= a[k] <= field.high[k]
            if not (inside if k == 2 else 0 <= _cell_at(ray, 0.0, k, field) < field.number.shape[k]):
                return 1.0, 0.0
            continue
        one, other = (field.low[k] - a[k]) / along[k], (field.high[k] - a[k]) / along[k]
        first, last = max(first, min(one, other)), min(last, max(one, other))
    return first, last


@lean()
def _square_at(ray: _Ray, t: float, field: _Field, ends: tuple[int, int, int, int]) -> tuple[int, int]:
    """The cell in which a share of a ray ends, or the nearest one of a square from its first to its last ones."""
    x, y = _cell_at(ray, t, 0, field), _cell_at(ray, t, 1, field)
    return min(max(x, ends[0]), ends[1]), min(max(y, ends[2]), ends[3])


@lean()
def _reaches(ray: _Ray, k: int, field: _Field, cell: int, none: float) -> float:
    """The share of a ray where it reaches the lower side of a cell along an axis; `none` if it goes across.

    Cells are counted in the grid, so that it is the same to the bit in each box of it.
    """
    if ray[1][k] == 0.0:
        return none
    return float(field.how.corner[k] + field.how.width * (field.first[k] + cell) - ray[0][k]) / ray[1][k]


@lean()
def _leaves(ray: _Ray, field: _Field, at: tuple[int, int], side: int) -> tuple[float, float]:
    """The shares of a ray where it leaves a square of cells, so many a `side`, along each axis."""
    x, y = at[0] + side * (ray[1][0] > 0.0), at[1] + side * (ray[1][1] > 0.0)
    return _reaches(ray, 0, field, x, np.inf), _reaches(ray, 1, field, y, np.inf)


@lean()
def _next(ray: _Ray, at: tuple[int, int], leaves: tuple[float, float]) -> tuple[int, int]:
    """The square that a ray comes to."""
    if leaves[0] <= leaves[1]:
        return at[0] + (1 if ray[1][0] > 0.0 else -1), at[1]
    return at[0], at[1] + (1 if ray[1][1] > 0.0 else -1)


@lean()
def _cast(rays: Bundle, field: _Field, share: int, made: Counts) -> None:
    """Count how many rays of a share were in each cell between its ground and its top, and how many fell, (m, 2).

    One falls that comes from or goes to what is deep under the ground. Through tiles that are as low it goes from
    cell to cell.
    """
    origins, ends, there = rays
    mx, my = field.lowest.shape
    for i in range(share, len(ends), SHARES):
        if not there[i]:
            continue
        k = i if len(origins) > 1 else 0
        a = origins[k, 0], origins[k, 1], origins[k, 2]
        x, y, z = ends[i, 0] - a[0], ends[i, 1] - a[1], ends[i, 2] - a[2]
        along = x if abs(x) > ROUNDING else 0.0, y if abs(y) > ROUNDING else 0.0, z if abs(z) > ROUNDING else 0.0
        ray = a, along, _part(along, field.how), min(a[2], ends[i, 2]) + field.how.deep
        t, last = _part_at_ground(ray, field)
        if not t < last:
            continue
        cell = _square_at(ray, t, field, (0, TILE * mx - 1, 0, TILE * my - 1))
        at = cell[0] // TILE, cell[1] // TILE
        while t < last and 0 <= at[0] < mx and 0 <= at[1] < my:
            leaves = _leaves(ray, field, (TILE * at[0], TILE * at[1]), TILE)
            leave = max(min(leaves[0], leaves[1], last), t)
            z, behind = a[2] + t * along[2], a[2] + leave * along[2]
            if min(z, behind) <= field.highest[at] and max(z, behind) >= field.lowest[at]:
                _look_along(ray, (t, leave), at, field, made)
            t, at = leave, _next(ray, at, leaves)


@lean()
def _look_along(ray: _Ray, walk: tuple[float, float], tile: tuple[int, int], field: _Field, made: Counts) -> None:
    """`_cast` in a tile, from where a ray enters it to where it leaves it (Amanatides and Woo, 1987)."""
    (a, along, part, deep), (nx, ny) = ray, field.number.shape
    left, near = TILE * tile[0], TILE * tile[1]
    right, far = min(left + TILE, nx) - 1, min(near + TILE, ny) - 1
    at = _square_at(ray, walk[0], field, (left, right, near, far))
    while left <= at[0] <= right and near <= at[1] <= far:
        leaves, n = _leaves(ray, field, at, 1), field.number[at]
        if n >= 0:
            x, y = at[0] + (along[0] < 0.0), at[1] + (along[1] < 0.0)
            first = max(part[0], _reaches(ray, 0, field, x, -np.inf), _reaches(ray, 1, field, y, -np.inf))
            last = min(part[1], leaves[0], leaves[1])
            if last - first > SHORTEST:
                z, behind, ground = a[2] + first * along[2], a[2] + last * along[2], field.height[n]
                lowest, highest = min(z, behind), max(z, behind)
                made[n, 0] += lowest <= field.top[n] and highest >= ground
                made[n, 1] += lowest < ground <= highest and deep < ground
        if min(leaves[0], leaves[1]) >= walk[1]:
            return
        at = _next(ray, at, leaves)

"""The points of a cloud that changes: each keeps its number, those that went are marked, and others come after."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numba import njit

from gpdf_service.fields.tree import longer
from gpdf_service.tiles.boxes import span
from gpdf_service.tiles.columns import by_cell
from gpdf_service.tiles.rows import (
    INDEX,
    bounds_of,
    cells_in_box,
    chosen_rows,
    rows_in_cells,
    taken,
)
from gpdf_service.tiles.width import columns_over
from gpdf_service.types import BoolArray, FloatArray, IntArray

SQUARE = 0.25
"""[m] Width of the squares in plan in which points are looked for: few of theirs lie beside what is asked."""
_EACH = 8
"""Points that squares hold at least, empty ones too: those of a thinner cloud are wider."""
_BLOCK = 4096
"""Points that are counted at once."""


class _Squares(NamedTuple):
    """Which points are in each square: corner and width of the squares [m], their shape, and `by_cell`."""

    corner: FloatArray
    width: float
    shape: tuple[int, int]
    start: IntArray
    order: IntArray


@dataclass(frozen=True)
class Base:
    """Points that were there from the first version on [m], shape (n, 3); those that follow share them."""

    points: FloatArray

    @cached_property
    def squares(self) -> _Squares:
        """The points by squares; told on first use, and kept for all versions."""
        low, high = bounds_of(self.points)
        width = SQUARE
        while _EACH * np.prod(np.floor((high - low) / width) + 1.0) > len(self.points) + _BLOCK:
            width *= 2.0
        shape = columns_over(low, high, width)
        cell = cells_in_box(self.points, low, width, np.zeros(2, np.int64), np.array(shape))
        return _Squares(low, width, shape, *by_cell(cell, shape[0] * shape[1]))


@dataclass(frozen=True, slots=True)
class Points:
    """All points of one version; a number below is that of a point among those of `base`, and after them of `more`.

    Attributes:
        base: Those of the first version.
        more: Those that came since [m], shape (k, 3).
        there: Which of all are there, shape (n + k,).
        rank: By what they are in order, shape (n + k,); None where that is their numbers.
    """

    base: Base
    more: FloatArray
    there: BoolArray
    rank: IntArray | None = None

    @property
    def count(self) -> int:
        """How many are there."""
        return int(np.count_nonzero(self.there))

    @property
    def untouched(self) -> bool:
        """Whether all are there, and no others."""
        return len(self.more) == 0 and bool(self.there.all())

    @property
    def all_numbers(self) -> IntArray:
        """The numbers of those that are there, in order, shape (count,)."""
        return self.in_order(np.flatnonzero(self.there))

    def in_order(self, numbers: IntArray) -> IntArray:
        """Some numbers, which ascend, in the order of their points."""
        return numbers if self.rank is None else numbers[np.argsort(self.rank[numbers], kind="stable")]

    @property
    def present(self) -> FloatArray:
        """Those that are there, in order [m], shape (count, 3)."""
        if self.untouched:
            return self.base.points
        if self.rank is not None:
            return self.taken(self.all_numbers)
        count = len(self.base.points)
        return chosen_rows(self.base.points, self.there[:count], self.more[self.there[count:]])

    def numbers(self, rows: IntArray) -> IntArray:
        """The numbers of some of those that are `present`, by their rows, which ascend."""
        return rows if self.untouched else _select(self.there, rows)

    def taken(self, numbers: IntArray) -> FloatArray:
        """Some of the points [m], by their numbers, shape (m, 3)."""
        return _taken(self.base.points, self.more, numbers) if len(self.more) else taken(self.base.points, numbers)

    def changed(self, gone: IntArray, fresh: FloatArray, rank: IntArray | None = None) -> Points:
        """The next version: without some, by their numbers, and with `fresh` ones, (m, 3), of that `rank`, (m,)."""
        there = np.concatenate([self.there, np.ones(len(fresh), dtype=bool)])
        there[gone] = False
        ranks = None if self.rank is None or rank is None else np.concatenate([self.rank, rank])
        return Points(self.base, np.concatenate([self.more, fresh]), there, ranks)

    def rows_in_cells(
        self, origin: FloatArray, width: float, wanted: BoolArray, kind: BoolArray | None = None
    ) -> IntArray:
        """Numbers of the points that are there in the `wanted` cells, (nx, ny), of a grid; in order.

        If a `kind` is given, shape (n + k,), only those of it; none of it may have gone.
        """
        grid, count, asked = (origin, width, wanted), len(self.base.points), self.there if kind is None else kind
        rows, more = _inside(self.base.points, asked, self.base.squares, grid), rows_in_cells(self.more, *grid)
        return self.in_order(np.concatenate([np.sort(rows), more[asked[count + more]] + count]))

    def bounds(self, chosen: BoolArray) -> tuple[FloatArray, FloatArray]:
        """Least and greatest (x, y) [m] of the `chosen` points, shape (n + k,)."""
        count = len(self.base.points)
        ends = bounds_of(self.base.points, chosen[:count]), bounds_of(self.more, chosen[count:])
        return np.minimum(ends[0][0], ends[1][0]), np.maximum(ends[0][1], ends[1][1])


def points_of(points: FloatArray) -> Points:
    """The points of a first version [m], shape (n, 3)."""
    return Points(Base(points), np.zeros((0, 3)), np.ones(len(points), dtype=bool))


@njit(cache=True, nogil=True)
def _select(there: BoolArray, rows: IntArray) -> IntArray:
    """Numbers of those that are `there`, by their rows among them, which ascend."""
    made, k, before = np.empty(len(rows), np.int64), 0, 0
    for begin in range(0, len(there), _BLOCK):
        if k == len(rows):
            break
        block, count = there[begin : begin + _BLOCK], 0
        for i in range(len(block)):
            count += block[i]
        if rows[k] < before + count:
            row = before
            for i in range(len(block)):
                while block[i] and k < len(rows) and rows[k] == row:
                    made[k] = begin + i
                    k += 1
                row += block[i]
        before += count
    return made


@njit(cache=True, nogil=True)
def _taken(base: FloatArray, more: FloatArray, numbers: IntArray) -> FloatArray:
    made = np.empty((len(numbers), 3))
    for i in range(len(numbers)):
        n = numbers[i]
        for k in range(3):
            made[i, k] = base[n, k] if n < len(base) else more[n - len(base), k]
    return made


_Cells = tuple[FloatArray, float, BoolArray]
"""Corner of a grid [m], width of its cells [m], and which are wanted, shape (nx, ny)."""


@njit(cache=True, nogil=True)
def _inside(points: FloatArray, asked: BoolArray, squares: _Squares, grid: _Cells) -> IntArray:
    """Numbers of the `asked` points in the wanted cells of a grid: only squares are read that meet one."""
    (corner, wide, shape, start, order), (origin, width, wanted) = squares, grid
    found, used, (left, right, near, far) = np.empty(_BLOCK, INDEX), 0, span(wanted)
    side, x, y = width / wide, (origin[0] - corner[0]) / wide, (origin[1] - corner[1]) / wide  # in squares
    for u in range(max(int(x + (left - 1) * side), 0), min(int(x + (right + 1) * side) + 1, shape[0])):
        i, k = int((u - x) / side) - 1, int((u + 1 - x) / side) + 2  # rounding: a cell more
        for v in range(max(int(y + (near - 1) * side), 0), min(int(y + (far + 1) * side) + 1, shape[1])):
            j, m = int((v - y) / side) - 1, int((v + 1 - y) / side) + 2
            cells = wanted[max(i, left) : min(k, right), max(j, near) : min(m, far)]
            if not cells.any():
                continue
            whole = cells.size == (k - i) * (m - j) and cells.all()  # then none of its points is read
            square = order[start[u * shape[1] + v] : start[u * shape[1] + v + 1]]
            if used + len(square) > len(found):
                found = longer(found, 2 * (used + len(square)))
            if whole:
                for n in square:
                    found[used] = n
                    used += asked[n]
                continue
            for n in square:
                if not asked[n]:
                    continue
                a = int(np.floor((points[n, 0] - origin[0]) / width))
                b = int(np.floor((points[n, 1] - origin[1]) / width))
                found[used] = n
                used += int(0 <= a < wanted.shape[0] and 0 <= b < wanted.shape[1] and wanted[a, b])
    return found[:used]

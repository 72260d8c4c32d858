"""What the cells of a grid are told by those around them, remembered: a change asks again only where something differs.

A build asks bands of rows, one after another. A change asks the boxes of those cells within whose reach what is given
is another than in the version before. Either asks with as much around them: so both go through the same functions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from operator import is_
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpdf_service.tiles.boxes import Box, widened, window
from gpdf_service.types import BoolArray

TILE = 64
"""Cells a side of the boxes in which a change asks again."""
NEVER = 0xA5
"""Of this byte is what was never told: no truth value, and no height."""
BAND = 1 << 18
"""Cells of a band, without its reach, that a build asks at once: each of its arrays then takes 2 MB."""


@dataclass(frozen=True, slots=True)
class Told:
    """What was given for each node or cell, and the answers; arrays of one shape, (k,) or (nx, ny, …)."""

    given: tuple[NDArray[Any], ...]
    made: tuple[NDArray[Any], ...]


def boxes_of(cells: BoolArray, by: int) -> list[Box]:
    """Boxes that hold all of the cells, shape (nx, ny): the least one in each tile of the grid, or one of all.

    What is less to look at, with `by` cells more on each side, is taken. A whole grid is looked at in bands.
    """
    if cells.all():
        return bands_of(cells.shape, by)
    found, (rows, columns) = [], window(cells, 0)
    for x in range(rows.start, rows.stop, TILE):
        for y in range(columns.start, columns.stop, TILE):
            part = window(cells[x : min(x + TILE, rows.stop), y : min(y + TILE, columns.stop)], 0)
            if part[0].stop > part[0].start:
                found.append((slice(x + part[0].start, x + part[0].stop), slice(y + part[1].start, y + part[1].stop)))

    def area(boxes: list[Box]) -> int:
        return sum((x.stop - x.start) * (y.stop - y.start) for x, y in (grown(box, by, cells.shape) for box in boxes))

    return min(found, [(rows, columns)], key=area) if found else found


def grown(box: Box, by: int, shape: tuple[int, ...]) -> Box:
    """A box and `by` cells more on each side, within a grid."""
    rows, columns = (
        slice(max(each.start - by, 0), min(each.stop + by, size)) for each, size in zip(box, shape, strict=False)
    )
    return rows, columns


def within(box: Box, outer: Box) -> Box:
    """Where a box lies in one around it."""
    rows, columns = (slice(own.start - o.start, own.stop - o.start) for own, o in zip(box, outer, strict=True))
    return rows, columns


def shared(by: tuple[int, int], size: tuple[int, ...], shape: tuple[int, ...], less: int = 0) -> tuple[Box, Box]:
    """What a box of so many cells shares with one of another shape that begins `by` cells further on: in each of them.

    On a side on which it goes on further it is so many cells `less`.
    """
    ends = [
        (max(first, 0) + less * (first > 0), min(first + count, was) - less * (first + count < was))
        for first, was, count in zip(by, size, shape, strict=False)
    ]
    own, other = (
        tuple(slice(a - off, max(b, a) - off) for (a, b), off in zip(ends, o, strict=True)) for o in ((0, 0), by)
    )
    return (own[0], own[1]), (other[0], other[1])


def moved(values: NDArray[Any], by: tuple[int, int], shape: tuple[int, ...], fill: Any, less: int = 0) -> NDArray[Any]:  # noqa: ANN401
    """The values of cells, (nx, ny, …), in another box, as `shared` has them; the `fill` where there were none."""
    own, other = shared(by, values.shape, shape, less)
    made = np.full((shape[0], shape[1], *values.shape[2:]), fill, values.dtype)
    made[other] = values[own]
    return made


def unlike(now: NDArray[Any], was: NDArray[Any]) -> BoolArray:
    """Where values are others than before, by their bits: NaN is NaN."""
    kind = f"u{now.dtype.itemsize}"
    found: BoolArray = now.view(kind) != was.view(kind)
    return found


Differ = tuple[NDArray[Any], NDArray[Any], list[tuple[Box, BoolArray]]]
"""What is told now, what was in the version before, and boxes with their cells, by whose bits they differ."""


@dataclass(frozen=True, slots=True)
class Grid:
    """What was asked of the cells of a grid.

    Attributes:
        known: What each question was told, by its name.
        former: What it was told in the version before; none in a build.
        others: Cells that hold other points than in that version, shape (nx, ny).
        differ: Of answers, by their identity, what was told in that version, and the boxes and cells that differ.
    """

    known: dict[str, Told]
    former: dict[str, Told]
    others: BoolArray
    differ: dict[int, Differ]

    def now(self, others: BoolArray) -> Grid:
        """The grid of the next version, which holds other points in some cells."""
        return Grid({}, self.known, others, {})

    def moved(self, by: tuple[int, int], shape: tuple[int, int]) -> Grid:
        """The same of a box of that shape that begins `by` cells further on.

        What was never told of a cell is told by nothing that can be given; so it is asked, and all in reach of it. The
        last cells before a side that moved inward count as such, too: they may have been told by what is cut off. All
        these are the `others`.
        """
        made: dict[int, NDArray[Any]] = {}

        def one(values: NDArray[Any]) -> NDArray[Any]:
            if id(values) not in made:  # what was one object stays one
                raw = np.ascontiguousarray(values).view(np.uint8).reshape(*values.shape, values.dtype.itemsize)
                made[id(values)] = moved(raw, by, shape, NEVER, 1).view(values.dtype)[..., 0]
            return made[id(values)]

        known = {
            name: Told(tuple(map(one, told.given)), tuple(map(one, told.made))) for name, told in self.known.items()
        }
        return Grid(known, {}, moved(np.zeros_like(self.others), by, shape, fill=True, less=1), {})

    def lasting(self) -> Grid:
        """The same without the version before."""
        return replace(self, former={}, differ={})

    def around(
        self,
        name: str,
        reach: int,
        answer: Callable[..., tuple[NDArray[Any], ...]],
        *given: NDArray[Any],
        points: bool = False,
        asked: bool = False,
    ) -> tuple[NDArray[Any], ...]:
        """What a question is told of each cell, arrays of shape (nx, ny, …).

        Args:
            name: Of the question.
            reach: Cells within which what is given, and the points, decide on the answer.
            answer: Called with a box of cells and what is given for them.
            given: Arrays of shape (nx, ny).
            points: Whether the answer asks the points that the cells hold, too.
            asked: Whether it is told, before what is given, of which cells it is asked.
        """
        felt = self.felt(name, reach, *given, points=points)

        def parts() -> Iterable[tuple[Box, tuple[NDArray[Any], ...]]]:
            for box in boxes_of(felt, reach):
                outer = grown(box, reach, felt.shape)
                own, there = within(box, outer), [np.ascontiguousarray(each[outer]) for each in given]
                if asked:
                    there.insert(0, np.zeros(there[0].shape, dtype=bool))
                    there[0][own] = felt[box]
                yield box, tuple(each[own] for each in answer(outer, *there))

        return self.put(name, given, felt, parts())

    def whole(
        self, name: str, answer: Callable[..., tuple[NDArray[Any], ...]], *given: NDArray[Any]
    ) -> tuple[NDArray[Any], ...]:
        """What a question that asks all cells at once is told: as before where all that is given is the same object."""
        told = self.former.get(name)
        if told is None or not all(map(is_, given, told.given)):
            told = Told(given, answer(*given))
        self.known[name] = told
        return told.made

    def put(
        self,
        name: str,
        given: tuple[NDArray[Any], ...],
        felt: BoolArray,
        parts: Iterable[tuple[Box, tuple[NDArray[Any], ...]]],
    ) -> tuple[NDArray[Any], ...]:
        """Answers for boxes of cells, which count in the `felt` ones; else the former ones, which stay if none differs.

        Args:
            name: Of the question.
            given: What it was told by.
            felt: Shape (nx, ny).
            parts: Boxes that hold all of these, and the answers there.
        """
        was = self.former[name].made if name in self.former else ()
        made, differ = list(was), [list[tuple[Box, BoolArray]]() for _ in was]
        for box, found in parts:
            if felt[box].size == felt.size and felt.all():
                made, was = list(found), ()
                break
            made = made or [np.empty(felt.shape, each.dtype) for each in found]
            for k, part in enumerate(found):
                other = felt[box] & unlike(part, was[k][box]) if was else felt[box]
                if was and other.any():
                    made[k] = made[k].copy() if made[k] is was[k] else made[k]
                    differ[k].append((box, other))
                made[k][box][other] = part[other]
        for now, before, boxes in zip(made, was, differ, strict=True) if was else ():
            self.differ[id(now)] = now, before, boxes
        self.known[name] = Told(given, tuple(made))
        return self.known[name].made

    def felt(self, name: str, reach: int, *given: NDArray[Any], points: bool = False) -> BoolArray:
        """Cells within reach of what is given otherwise than before, or of other `points`, (nx, ny); all of a build."""
        if name not in self.former:
            return np.ones_like(self.others)
        felt = self.others.copy() if points else np.zeros_like(self.others)
        for one, another in zip(given, self.former[name].given, strict=True):
            self._mark(one, another, felt)
        return widened(felt, reach)

    def other_answers(self, *names: str) -> BoolArray:
        """Cells in which a question was told otherwise than in the version before, shape (nx, ny)."""
        found = np.zeros_like(self.others)
        for name in names:
            if name not in self.former:
                return np.ones_like(found)
            for now, was in zip(self.known[name].made, self.former[name].made, strict=True):
                self._mark(now, was, found)
        return found

    def _mark(self, now: NDArray[Any], was: NDArray[Any], cells: BoolArray) -> None:
        """Mark the cells with other values than before."""
        _, before, boxes = self.differ.get(id(now), (None, None, ()))
        if before is was:
            for box, other in boxes:
                cells[box] |= other
        elif now is not was:
            cells |= unlike(now, was)


def new_grid(shape: tuple[int, ...]) -> Grid:
    """Of so many cells, of which nothing was asked."""
    return Grid({}, {}, np.zeros(shape, dtype=bool), {})


def bands_of(shape: tuple[int, ...], reach: int) -> list[Box]:
    """Bands of whole rows that tile a grid: of `BAND` cells, and twice as many rows as their reach adds at least."""
    nx, ny = shape
    count = max(1, min(nx * ny // BAND, nx // (4 * max(reach, 1))))
    return [(slice(nx * i // count, nx * (i + 1) // count), slice(0, ny)) for i in range(count)]

"""What nodes of layered columns are told by those around them, and which of them are joined: strip by strip.

A strip is some rows of the grid. What its nodes are told is a function of them, of what is given for them, and of the
same of the strips within reach. So an answer is kept with what it was made of, and made again where any of that is
another array: a build makes all of them, in one piece, a change those that it touches. An answer that comes out as it
was is the array that it was, and what follows from it is not asked again. What is joined is told by pieces within each
strip, by the pairs that go on into the next one, and by a graph of these pieces, which is small.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import compress, count, pairwise
from math import ceil
from operator import is_, is_not
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gpdf_service.fields.threads import run_parallel
from gpdf_service.tiles.boxes import Box, span
from gpdf_service.tiles.columns import box_spliced, box_unlike, unlike_cells
from gpdf_service.tiles.layers import Layers, crop_layers, flat
from gpdf_service.tiles.rows import rows_over
from gpdf_service.tiles.told import grown, within
from gpdf_service.types import BoolArray, FloatArray, IntArray

ROWS = 16
"""Of cells a strip: about a metre. What changes in a room touches two or three."""
Strips = tuple[NDArray[Any], ...]
"""What is told of nodes, an array for the nodes of each strip; versions share those that are the same."""
Answer = tuple[NDArray[Any], ...]
"""What one question tells of one strip."""
Spans = Sequence[slice]
"""For each strip those that decide on it."""


class Told(NamedTuple):
    """What a question was told: what is `given` for the strips, and what was `made` of it for each of them.

    At last the same by `kinds`, each for all strips: the very objects of the version before where nothing is other.
    """

    given: tuple[Sequence[object], ...]
    made: list[Answer]
    kinds: tuple[Strips, ...]


_Ends = tuple[int, int, int, int]
"""First and behind the last row of cells, and column."""
Other = tuple[object, object, _Ends]
"""What is told now, what was in the version before, and where it is other."""


@dataclass(frozen=True)
class Beside:
    """Nodes in strips, and what was asked of them.

    Attributes:
        layers: The nodes.
        nodes: An object for each strip, the same one as long as the strip has the same nodes.
        known: What each question was told, by its name.
        former: The same of the version before; empty in a build.
        was: Where the nodes of each cell began in the version before, shape (cells + 1,).
        others: Of what is told otherwise than before, by its identity.
    """

    layers: Layers
    nodes: tuple[object, ...]
    known: dict[str, Told]
    former: dict[str, Told]
    was: IntArray
    others: dict[int, Other]

    @cached_property
    def first(self) -> IntArray:
        """First node of each strip, and how many there are, shape (strips + 1,)."""
        begin: IntArray = self.layers.start[self._cells]
        return begin

    def rows(self, strip: int) -> slice:
        """Of cells of a strip."""
        return slice(ROWS * strip, min(ROWS * (strip + 1), self.layers.shape[0]))

    def around(self, name: str, reach: int, answer: Callable[..., Answer], *given: Strips) -> tuple[Strips, ...]:
        """What a question is told of each node.

        Args:
            name: Of the question.
            reach: Cells within which the nodes, and what is given for them, decide on the answer.
            answer: Called with layers of a box of cells, which of their nodes are asked about, and what is given for
                all of them: arrays of shape (k,). Returns such arrays.
            given: For each node.
        """
        was, spans = self.former.get(name), spans_of(len(self.nodes), ceil(reach / ROWS))

        def make(begin: int, end: int) -> list[Answer]:
            box = self._window(given, was, slice(begin, end), reach)
            if was is not None and box[0].start == box[0].stop:
                return was.made[begin:end]  # what is other is further away
            part, asked, _, told = self._part(box, reach, given)
            made = answer(part, asked, *told)
            if was is None:
                return [tuple(values[a:b] for values in made) for a, b in pairwise(self.first.tolist())]
            before = zip(*was.made[begin:end], strict=True)
            own = [self._spliced(begin, box, new[asked], old) for new, old in zip(made, before, strict=True)]
            return list(zip(*own, strict=True))

        return self.told_nodes(name, given, make, spans)

    def each(self, name: str, answer: Callable[..., NDArray[Any]], *given: Strips) -> Strips:
        """What a question is told of each node by what is given for it alone; see `around`."""
        return self.around(name, 0, lambda _, __, *own: (answer(*own),), *given)[0]

    def among(self, name: str, nodes: IntArray) -> Strips:
        """Which nodes are among some, by their numbers."""
        held = np.zeros(len(self.layers.cell), dtype=bool)
        held[nodes] = True
        return self.given(f"{name}, among", held)

    def joins(
        self, name: str, reach: int, answer: Callable[..., tuple[IntArray, IntArray]], *given: Strips
    ) -> tuple[IntArray, IntArray]:
        """Pairs of nodes that a question is told, of each of which the first node decides; see `around`."""
        was, ny, spans = self.former.get(name), self.layers.shape[1], spans_of(len(self.nodes), ceil(reach / ROWS))
        start, cells = self.layers.start, self._cells

        def make(begin: int, end: int) -> list[Answer]:
            box = self._window(given, was, slice(begin, end), reach)
            part, asked, nodes, told = self._part(box, reach, given)
            ends = answer(part, *told)
            a, b = (each[asked[ends[0]]] for each in ends)
            a, b = (a, b) if nodes is None else (nodes[a], nodes[b])
            by_first = np.argsort(a, kind="stable")  # strips are cut from pairs in this order
            a, b = a[by_first], b[by_first]
            cell = self.layers.cell[a], self.layers.cell[b]
            fresh = np.column_stack([*cell, a - start[cell[0]], b - start[cell[1]]])
            made = [fresh[x:y] for x, y in pairwise(np.searchsorted(cell[0], cells[begin : end + 1]))]
            if was is None:
                return [(each,) for each in made]
            stay = [each[~_within(each[:, 0], ny, box)] for (each,) in was.made[begin:end]]
            return [(np.concatenate(both),) for both in zip(stay, made, strict=True)]

        pairs = flat(self.told(name, given, make, spans)[0])
        return start[pairs[:, 0]] + pairs[:, 2], start[pairs[:, 1]] + pairs[:, 3]

    def same(self, name: str, own: Sequence[NDArray[Any]]) -> Strips:
        """An array of each strip, and the one that was told before where it is the same."""
        if (was := self.former.get(name)) is None:
            return self._keep(name, (), [(each,) for each in own])[0]
        pairs = zip(own, was.made, strict=True)
        return self._keep(name, (), [old if _alike(each, old[0]) else (each,) for each, old in pairs])[0]

    def given(self, name: str, values: NDArray[Any]) -> Strips:
        """The values of all nodes, shape (k,), by strips; nobody writes over them."""
        strips = self.same(name, [values[a:b] for a, b in pairwise(self.first.tolist())])
        self._note(name)
        return strips

    def told(
        self,
        name: str,
        given: tuple[Strips, ...],
        make: Callable[[int, int], list[Answer]],
        spans: Spans | None = None,
    ) -> tuple[Strips, ...]:
        """The answers to a question, each for all strips.

        Args:
            name: Of the question.
            given: For each node, which decides on the answers with them: the former ones stay while these are the same
                objects.
            make: Called with the first and behind the last of strips that are asked. Returns their answers.
            spans: The strips in which they decide on each one's answer; by itself if that is all.
        """
        was, of = self.former.get(name), (self.nodes, *given)
        if was is None:
            return self._keep(name, of, make(0, len(self.nodes)))
        found = was.made.copy()
        for begin, end in _runs(_asked(of, was.given, spans)):
            found[begin:end] = map(self._as_it_was, make(begin, end), found[begin:end])
        return self._keep(name, of, found)

    def _keep(self, name: str, given: tuple[Sequence[object], ...], made: list[Answer]) -> tuple[Strips, ...]:
        """Remember what a question was told."""
        was = self.former.get(name)
        if was is not None and all(map(is_, made, was.made)):
            self.known[name] = was._replace(given=given)
        else:
            self.known[name] = Told(given, made, tuple(zip(*made, strict=True)))
        return self.known[name].kinds

    def strips_of(self, points: FloatArray) -> tuple[int, int]:
        """The first strip and behind the last that hold points (n, 3) [m]; one strip for none."""
        first, last = rows_over(points, self.layers.origin, ROWS * self.layers.cell_width)
        return max(first - 1, 0), min(last + 2, len(self.nodes))  # rounding: one more

    def unlike(self, told: Sequence[Strips], then: Beside, was: Sequence[Strips]) -> BoolArray:
        """Cells whose nodes are told otherwise than in another version, or are others, shape (nx, ny)."""
        ny, found, first = self.layers.shape[1], np.zeros(self.layers.shape, dtype=bool), (self.first, then.first)
        for i in range(len(self.nodes)):
            rows = slice(ROWS * i, ROWS * (i + 1))
            starts = [each.layers.start[rows.start * ny : rows.stop * ny + 1] for each in (self, then)]
            own = starts[0] - first[0][i], starts[1] - first[1][i]
            for now, old in zip(told, was, strict=True):
                if now[i] is not old[i]:
                    ours, theirs = (now[i][:, None], own[0]), (old[i][:, None], own[1])
                    found[rows] |= unlike_cells(np.ones_like(found[rows]), *theirs[::-1], *ours[::-1])
        return found

    def lasting(self) -> Beside:
        """The same without the version before."""
        return Beside(self.layers, self.nodes, self.known, {}, self.layers.start, {})

    @cached_property
    def _cells(self) -> IntArray:
        """First cell of each strip, and how many there are."""
        (nx, ny), rows = self.layers.shape, ROWS * np.arange(len(self.nodes) + 1)
        return np.minimum(rows, nx) * ny

    def told_nodes(
        self,
        name: str,
        given: tuple[Strips, ...],
        make: Callable[[int, int], list[Answer]],
        spans: Spans | None = None,
    ) -> tuple[Strips, ...]:
        """`told` of what is told of each node, and into `others` where that is other than before."""
        found = self.told(name, given, make, spans)
        self._note(name)
        return found

    def _note(self, name: str) -> None:
        """Write into `others` where a question was told otherwise of nodes than before."""
        (nx, ny), made, was = self.layers.shape, self.known[name].made, self.former.get(name)
        for i, (found, before) in enumerate(zip(made, was.made, strict=True) if was and was.made is not made else ()):
            for now, old in zip(found, before, strict=True) if found is not before else ():
                if now is not old and not self._is_other(now, old):
                    self.others[id(now)] = now, old, self._unlike(i, now, old, (0, nx, 0, ny))[0]

    def _is_other(self, now: object, old: object) -> bool:
        """Whether it is known in which cells what is told now is other than what was told."""
        return id(now) in self.others and self.others[id(now)][1] is old

    def _unlike(self, strip: int, fresh: NDArray[Any], old: NDArray[Any], box: _Ends) -> tuple[_Ends, int]:
        """Where in a box nodes of a strip are told otherwise than before, and how many are in it: see `box_unlike`."""
        cells, ny = self._cells[strip : strip + 2], self.layers.shape[1]
        told = old.view(f"u{old.itemsize}"), fresh.view(f"u{fresh.itemsize}")
        where, count = box_unlike(*told, self.was, self.layers.start, (cells[0], cells[1]), ny, box)
        return where, count

    def _window(self, given: tuple[Strips, ...], was: Told | None, strips: slice, reach: int) -> Box:
        """The box of cells of some strips in which what they are told may be other than before."""
        (nx, ny), halo = self.layers.shape, ceil(reach / ROWS)
        rows = ROWS * strips.start, min(ROWS * strips.stop, nx)
        if was is None:
            return slice(*rows), slice(0, ny)
        near = slice(max(strips.start - halo, 0), strips.stop + halo)
        boxes = {
            box if one is now and other is old else (0, nx, 0, ny)
            for ours, theirs in zip((self.nodes, *given), was.given, strict=True)
            for now, old in zip(ours[near], theirs[near], strict=True)
            if now is not old
            for one, other, box in (self.others.get(id(now), (None, None, (0, nx, 0, ny))),)
        }
        left, right, near_by, far = zip(*boxes, strict=True)
        first, last = max(min(left) - reach, rows[0]), min(max(right) + reach, rows[1])
        return slice(first, max(first, last)), slice(max(min(near_by) - reach, 0), min(max(far) + reach, ny))

    def _part(self, box: Box, reach: int, given: Sequence[Strips]) -> tuple[Layers, BoolArray, IntArray | None, Answer]:
        """Layers of a box of cells and as many around, which of their nodes are in it, and their numbers among all.

        These are none where they are all. At last what is given for them.
        """
        layers, (rows, columns) = self.layers, grown(box, reach, self.layers.shape)
        if (rows.stop - rows.start, columns.stop - columns.start) == layers.shape:
            part, nodes, told = layers, None, tuple(map(flat, given))
        else:
            strips = slice(rows.start // ROWS, ceil(rows.stop / ROWS))
            part, nodes = crop_layers(layers, (rows, columns))
            own = nodes - self.first[strips.start]
            told = tuple(flat(each[strips])[own] for each in given)
        inside = np.zeros(part.shape, dtype=bool)
        inside[within(box, (rows, columns))] = True
        return part, inside.ravel()[part.cell], nodes, told

    def strips(self, begin: int, end: int) -> Layers:
        """Layers of some strips; views, as they are asked for once for each strip."""
        return self.layers.rows(ROWS * begin, min(ROWS * end, self.layers.shape[0]))

    def _spliced(self, begin: int, box: Box, fresh: NDArray[Any], before: Strips) -> Strips:
        """What is told of the nodes of some strips, one after another: in a box of cells the `fresh` values.

        Where that is other than before is written into `others`.
        """
        cells, start, ny, used, made = self._cells, self.layers.start, self.layers.shape[1], 0, []
        ends = box[0].start, box[0].stop, box[1].start, box[1].stop
        for i, old in enumerate(before, begin):
            values, (where, count) = old, self._unlike(i, fresh[used:], old, ends)
            if where[0] < where[1]:
                values = np.empty(start[cells[i + 1]] - start[cells[i]], fresh.dtype)
                box_spliced(old, fresh[used:], self.was, start, (cells[i], cells[i + 1]), ny, ends, values)
                self.others[id(values)] = values, old, where
            used += count
            made.append(values)
        return tuple(made)

    def _as_it_was(self, now: Answer, was: Answer) -> Answer:
        """An answer, with the former arrays where they are the same by their bits: NaN is NaN."""
        pairs = zip(now, was, strict=True)
        made = tuple(old if not self._is_other(new, old) and _alike(new, old) else new for new, old in pairs)
        return was if all(map(is_, made, was)) else made


FEW = 8
"""Strips that one core has done before another one wakes."""


def each_strip(one: Callable[[int], Answer], begin: int, end: int) -> list[Answer]:
    """The answers of strips from `begin` to `end`, made on all cores where they are more than a few."""
    asked = range(begin, end)
    return run_parallel(one, asked) if len(asked) > FEW else [one(i) for i in asked]


@lru_cache
def spans_of(size: int, before: int, behind: int | None = None) -> Spans:
    """For each of so many strips those `before` it, itself, and those `behind` it: as many, if that is not told."""
    last = before if behind is None else behind
    return [slice(max(i - before, 0), min(i + last + 1, size)) for i in range(size)]


def _asked(now: tuple[Sequence[object], ...], was: tuple[Sequence[object], ...], spans: Spans | None) -> list[int]:
    """Strips for which something else is given than before."""
    pairs = ((ours, theirs) for ours, theirs in zip(now, was, strict=True) if ours is not theirs)
    other = sorted({i for ours, theirs in pairs for i in compress(count(), map(is_not, ours, theirs))})
    if spans is None or not other:
        return other
    ends = [*other, len(spans)]
    return [i for i, span in enumerate(spans) if ends[bisect_left(other, span.start)] < span.stop]


def _runs(asked: list[int]) -> list[tuple[int, int]]:
    """First and behind the last of each run of numbers that ascend."""
    ends = [k for k in range(1, len(asked)) if asked[k] > asked[k - 1] + 1]
    return [(asked[a], asked[b - 1] + 1) for a, b in pairwise([0, *ends, len(asked)]) if a < b]


def _alike(one: NDArray[Any], other: NDArray[Any]) -> bool:
    return one is other or (one.shape == other.shape and one.tobytes() == other.tobytes())


def _within(cell: IntArray, ny: int, box: Box) -> BoolArray:
    """Which cells, by their numbers, are in a box."""
    x, y = np.divmod(cell, ny)
    inside: BoolArray = (x >= box[0].start) & (x < box[0].stop) & (y >= box[1].start) & (y < box[1].stop)
    return inside


def beside(layers: Layers) -> Beside:
    """Nodes of which nothing was asked."""
    return Beside(layers, tuple(object() for _ in range(0, layers.shape[0], ROWS)), {}, {}, layers.start, {})


def beside_now(near: Beside, layers: Layers, cells: BoolArray) -> Beside:
    """`beside` of `layers` that are those of `near` but for the columns `cells`, shape (nx, ny)."""
    nodes, others = list(near.nodes), {}
    for i in range(len(nodes)):
        left, right, near_by, far = span(cells[ROWS * i : ROWS * (i + 1)])
        if left < right:
            old, nodes[i] = nodes[i], object()
            others[id(nodes[i])] = nodes[i], old, (ROWS * i + left, ROWS * i + right, near_by, far)
    return Beside(layers, tuple(nodes), {}, near.known, near.layers.start, others)

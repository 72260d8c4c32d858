"""What nodes of layered columns are told by those around them, remembered: a change asks only where it is another.

Pairs of nodes beside each other lie in strips of the grid. A strip numbers its nodes from its first one, so it is the
same wherever it comes in the whole. What it was asked in the version before it remembers, with what was given for its
nodes: where both are as they were, so is the answer. What a node is told by all that is within a known reach is asked
of boxes of cells with as much around them: a build asks one box, a change those in which what is given is another.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpdf_service.fields.threads import run_parallel
from gpdf_service.perception.boxes import widened
from gpdf_service.perception.layers import (
    APART,
    HALF,
    Layers,
    Pairs,
    crop_layers,
)
from gpdf_service.perception.nodes import (
    across_in,
    carry,
    degrees,
    mark_unlike,
    numbered,
    pieces_in,
    put_in,
    unite_all,
)
from gpdf_service.perception.pairs import pairs_beside
from gpdf_service.perception.rows import INDEX
from gpdf_service.perception.told import Told, boxes_of
from gpdf_service.types import BoolArray, FloatArray, IntArray

ROWS = 16
"""Of cells a strip: about a metre. What changes in a room touches two or three."""
Answers = dict[tuple[Any, ...], Any]
"""By the question's name, its limits, and the bytes that were given for the nodes."""
NO_PAIRS: Pairs = np.zeros(0, INDEX), np.zeros(0, INDEX)


@dataclass(frozen=True, slots=True)
class Strip:
    """Nodes in some rows of cells, and after them those in the row behind.

    Attributes:
        count: How many of them are its own.
        size: How many there are in all.
        known: What it was asked in this version.
        before: What it was asked in the version before.
        pairs: Of nodes, `pairs_beside`, while they are asked for again and again; else none.
    """

    count: int
    size: int
    known: Answers
    before: Answers
    pairs: list[tuple[IntArray, IntArray, IntArray]]

    def recall(self, key: tuple[Any, ...]) -> object:
        """The answer to what it was asked in this version or the one before; None where it was not."""
        return self.known.get(key, self.before.get(key))


@dataclass(frozen=True, slots=True)
class Former:
    """The version before.

    Attributes:
        known: What was asked of it.
        kept: Runs of its nodes that are nodes now, (r, 3): the number now of the first one, the one then, how many.
        cells: The columns that hold others, shape (nx, ny).
    """

    known: dict[str, Told]
    kept: IntArray
    cells: BoolArray


NOTHING = Former({}, np.zeros((0, 3), np.int64), np.zeros((0, 0), dtype=bool))
"""Before a build."""


@dataclass(frozen=True, slots=True)
class Beside:
    """Nodes, pairs of those in neighbouring cells, and what was asked of them.

    Attributes:
        layers: The nodes.
        rise: Between the nodes of a pair at most [m].
        strips: Of their pairs.
        known: What each question was told, by its name.
        former: The version before.
    """

    layers: Layers
    rise: float
    strips: tuple[Strip, ...]
    known: dict[str, Told]
    former: Former = NOTHING

    def around(
        self, name: str, reach: int, answer: Callable[..., tuple[NDArray[Any], ...]], *given: NDArray[Any]
    ) -> tuple[NDArray[Any], ...]:
        """What a question is told of each node, arrays of shape (k,).

        Args:
            name: Of the question.
            reach: Cells within which the nodes, and what is given for them, decide on the answer.
            answer: Called with layers of a box of cells, which of their nodes are asked about, and what is given for
                all of them.
            given: Arrays of shape (k,).
        """
        was = self.former.known.get(name)
        if was is None:
            made = answer(self.layers, np.ones(len(self.layers.cell), dtype=bool), *given)
        else:
            made = self.last(name)
            for nodes, fresh, found in self._again(name, reach, answer, given):
                for values, now in zip(made, found, strict=True):
                    values[nodes[fresh]] = now[fresh]
        self.known[name] = Told(given, made)
        return made

    def pairs_around(self, name: str, reach: int, answer: Callable[..., Pairs], *given: NDArray[Any]) -> Pairs:
        """Pairs of nodes that a question is told, of each of which the first node decides; see `around`."""
        was = self.former.known.get(name)
        if was is None:
            made = answer(self.layers, np.ones(len(self.layers.cell), dtype=bool), *given)
        else:
            number = np.empty(len(was.given[0]), np.int64)
            carry(np.arange(len(self.layers.cell)), self.former.kept[:, [1, 0, 2]], -1, number)
            a, b = (number[ends] for ends in was.made)
            felt = self.felt(name, given, reach).ravel()[self.layers.cell]
            stay = (a >= 0) & (b >= 0)
            stay[stay] = ~felt[a[stay]]
            found = [(a[stay], b[stay])]
            for nodes, fresh, (one, other) in self._again(name, reach, answer, given):
                own = fresh[one]
                found.append((nodes[one[own]], nodes[other[own]]))
            made = np.concatenate([pair[0] for pair in found]), np.concatenate([pair[1] for pair in found])
        self.known[name] = Told(given, made)
        return made

    def _again(
        self, name: str, reach: int, answer: Callable[..., tuple[NDArray[Any], ...]], given: tuple[NDArray[Any], ...]
    ) -> Iterator[tuple[IntArray, BoolArray, tuple[NDArray[Any], ...]]]:
        """The nodes of each box in which something is another, which of them that can change, and the answer."""
        felt = self.felt(name, given, reach)
        for box in boxes_of(felt, reach):
            part, nodes = crop_layers(self.layers, box, reach)
            inside = np.zeros(self.layers.shape, dtype=bool)
            inside[box] = felt[box]
            asked = inside.ravel()[self.layers.cell[nodes]]
            yield nodes, asked, answer(part, asked, *(each[nodes] for each in given))

    def felt(self, name: str, given: tuple[NDArray[Any], ...], reach: int = 0) -> BoolArray:
        """Cells within reach of what is given otherwise than to the version before, shape (nx, ny); all of a build."""
        was = self.former.known.get(name)
        if was is None:
            return np.ones(self.layers.shape, dtype=bool)
        return self._unlike(given, was.given, reach)

    def last(self, name: str) -> tuple[NDArray[Any], ...]:
        """What the nodes were told in the version before, arrays of shape (k,): NaN, or false, of new ones."""
        was, made = self.former.known.get(name), []
        for values in was.made if was is not None else ():
            made.append(np.empty(len(self.layers.cell), values.dtype))
            carry(values, self.former.kept, values.dtype.type(np.nan if values.dtype.kind == "f" else 0), made[-1])
        return tuple(made)

    def other_answers(self, name: str) -> BoolArray:
        """Cells in which a question was told otherwise than in the version before, shape (nx, ny)."""
        was = self.former.known.get(name)
        if was is None:
            return np.ones(self.layers.shape, dtype=bool)
        return self._unlike(self.known[name].made, was.made, 0)

    def _unlike(self, now: tuple[NDArray[Any], ...], was: tuple[NDArray[Any], ...], reach: int) -> BoolArray:
        cells = self.former.cells.copy()  # those of new nodes are among them
        for one, another in zip(now, was, strict=True):
            bits = f"u{one.itemsize}"  # NaN is NaN
            mark_unlike(one.view(bits), another.view(bits), self.former.kept, self.layers.cell, cells.ravel())
        return widened(cells, reach)

    def degrees(self, name: str, keep: BoolArray, rise: float) -> NDArray[np.uint8]:
        """How many nodes to keep are beside each of them with at most `rise` [m] a cell between them, shape (k,)."""

        def answer(layers: Layers, _: BoolArray, keep: BoolArray) -> tuple[NDArray[np.uint8]]:
            return (degrees(layers.columns, keep, rise),)

        return self.around(name, 1, answer, keep)[0]

    def across(self, one: BoolArray, other: BoolArray, step: float) -> Pairs:
        """Pairs of a node of `one` kind and one of the `other` within a `step` [m]; no node is of both."""
        found = self._ask(across_in, one + np.uint8(2) * other, step)
        a, b = (np.concatenate([part[side] + INDEX(begin) for begin, part in found]) for side in (0, 1))
        return a, b

    def pieces(
        self,
        inner: BoolArray,
        rise: float,
        sloped: BoolArray | None = None,
        stepped: BoolArray | None = None,
        step: float = 0.0,
    ) -> tuple[IntArray, Pairs, Pairs]:
        """What is joined by slopes, and the pairs that tell what else is.

        Args:
            inner: Nodes that are joined, shape (k,); any other one is a piece by itself.
            rise: With at most this between them [m] a cell.
            sloped: Nodes of which pairs are asked for with at most that between them.
            stepped: Nodes of which pairs are asked for with at most a step between them.
            step: [m].

        Returns:
            Piece of each node, numbered by their first nodes, shape (k,); the pairs of `sloped` nodes that are not both
            inner, and those of `stepped` nodes but for most that are of one piece.
        """
        kind = inner.astype(np.uint8)
        for bit, asked in ((2, sloped), (4, stepped)):
            if asked is not None:
                kind += np.uint8(bit) * asked
        parent, found = np.empty(len(kind), INDEX), self._ask(pieces_in, kind, rise, step)
        for begin, part in found:
            put_in(parent, part[0], begin)
        for begin, part in found:
            unite_all(parent, part[1], part[2], begin)
        slopes, steps = (
            NO_PAIRS if asked is None else _in_order(found, at) for asked, at in ((sloped, 3), (stepped, 6))
        )
        return numbered(parent), slopes, steps

    def lasting(self) -> Beside:
        """The same without pairs, and without the version before."""
        return replace(self.asked(), former=NOTHING)

    def asked(self) -> Beside:
        """The same without pairs and the answers before: no more is asked of it."""
        return replace(self, strips=tuple(replace(strip, before={}, pairs=[]) for strip in self.strips))

    def _ask(self, question: Callable[..., Any], given: NDArray[np.uint8], *limits: float) -> list[tuple[int, Any]]:
        """The first node of each strip, and its answer."""
        begin = np.cumsum([0, *(strip.count for strip in self.strips)]).tolist()
        own = [given[first : first + strip.size] for first, strip in zip(begin, self.strips, strict=False)]
        keys = [(question.__name__, *limits, part.tobytes()) for part in own]
        found = [strip.recall(key) for strip, key in zip(self.strips, keys, strict=True)]
        asked = [i for i, answer in enumerate(found) if answer is None]
        fresh = run_parallel(lambda i: question(*self._strip(i, begin[i]), APART, own[i], *limits), asked)
        for i, answer in zip(asked, fresh, strict=True):
            found[i] = answer
        for strip, key, answer in zip(self.strips, keys, found, strict=True):
            strip.known[key] = answer
        return list(zip(begin, found, strict=False))

    def _strip(self, i: int, begin: int) -> tuple[IntArray, IntArray, IntArray, FloatArray, int]:
        """Pairs of a strip, heights of its nodes, the first of which is number `begin`, and how many are its own."""
        strip, (nx, _), row = self.strips[i], self.layers.shape, ROWS * i
        if not strip.pairs:
            strip.pairs.append(pairs_beside(self.layers.columns, self.rise, HALF, row, min(row + ROWS, nx)))
        return *strip.pairs[0], self.layers.height[begin : begin + strip.size], strip.count


def _in_order(found: list[tuple[int, Any]], at: int) -> Pairs:
    """The pairs of all strips, those of each of the `HALF` after another."""

    def ends(side: int) -> IntArray:
        parts = [(part[at + side] + INDEX(begin), part[at + 2]) for begin, part in found]
        made: IntArray = np.concatenate(
            [own[first[k] : first[k + 1]] for k in range(len(HALF)) for own, first in parts]
        )
        return made

    return ends(0), ends(1)


def beside(layers: Layers, rise: float) -> Beside:
    """All pairs with at most `rise` [m] between them."""
    return Beside(layers, rise, tuple(_new_strip(layers, row) for row in range(0, layers.shape[0], ROWS)), {})


def beside_now(near: Beside, layers: Layers, cells: BoolArray) -> Beside:
    """`beside` of `layers` that are those of `near` but for the columns `cells`, shape (nx, ny)."""
    rows: BoolArray = np.logical_or.reduce(cells, axis=1)
    strips = tuple(
        _new_strip(layers, ROWS * i)
        if rows[ROWS * i : ROWS * (i + 1) + 1].any()
        else replace(strip, known={}, before=strip.known, pairs=[])
        for i, strip in enumerate(near.strips)
    )
    begin, end = np.flatnonzero(np.diff(cells.ravel(), prepend=True, append=True)).reshape(-1, 2).T
    kept = np.column_stack([layers.start[begin], near.layers.start[begin], layers.start[end] - layers.start[begin]])
    return Beside(layers, near.rise, strips, {}, Former(near.known, kept, cells))


def _new_strip(layers: Layers, row: int) -> Strip:
    """The strip that begins with a row of cells."""
    start, (nx, ny) = layers.start, layers.shape
    begin, own, end = (int(start[x * ny]) for x in (row, min(row + ROWS, nx), min(row + ROWS + 1, nx)))
    return Strip(own - begin, end - begin, {}, {}, [])

"""Which nodes of layered columns lie beside each other, in strips of the grid: a change asks only those it touches.

A strip numbers its nodes from its first one, so it is the same wherever it comes in the whole. What it was asked in the
version before it remembers, with what was given for its nodes: where both are as they were, so is the answer.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpdf_service.fields.threads import run_parallel
from gpdf_service.perception.layers import APART, HALF, Layers, Pairs
from gpdf_service.perception.nodes import across_in, degrees_in, ends_in, numbered, pieces_in, put_in, unite_all
from gpdf_service.perception.pairs import INDEX, pairs_beside
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
        height: Of all [m], shape (k,).
        a: Its own node of each pair, those of each of the `HALF` after another, shape (e,).
        b: The other one, shape (e,).
        first: Where each of the `HALF` begins, shape (5,).
        known: What it was asked in this version.
        before: What it was asked in the version before.
    """

    count: int
    height: FloatArray
    a: IntArray
    b: IntArray
    first: IntArray
    known: Answers
    before: Answers

    def recall(self, key: tuple[Any, ...]) -> object:
        """The answer to what it was asked in this version or the one before; None where it was not."""
        return self.known.get(key, self.before.get(key))

    def ask(self, question: Callable[..., Any], given: NDArray[np.uint8], limits: tuple[float, ...]) -> object:
        """The answer to a question, which is `given` a number for each node, shape (k,)."""
        answer: object = question(self.a, self.b, self.first, self.height, self.count, APART, given, *limits)
        return answer


@dataclass(frozen=True, slots=True)
class Beside:
    """Pairs of nodes in neighbouring cells, from which those among some nodes and within some rise are taken.

    Attributes:
        layers: The nodes.
        strips: Of their pairs.
    """

    layers: Layers
    strips: tuple[Strip, ...]

    def degrees(self, keep: BoolArray, rise: float) -> IntArray:
        """How many nodes to keep are beside each of them with at most `rise` [m] a cell between them, shape (k,)."""
        made = np.zeros(len(keep), np.int64)
        for begin, part in self._ask(degrees_in, keep.astype(np.uint8), rise):
            made[begin : begin + len(part)] += part
        return made

    def across(self, one: BoolArray, other: BoolArray, step: float) -> Pairs:
        """Pairs of a node of `one` kind and one of the `other` within a `step` [m]; no node is of both."""
        found = self._ask(across_in, one + np.uint8(2) * other, step)
        a, b = (np.concatenate([part[side] + INDEX(begin) for begin, part in found]) for side in (0, 1))
        return a, b

    def ends(self, keep: BoolArray, step: float) -> list[IntArray]:
        """For each of the `HALF`, the nodes to keep that no node in that direction is within a `step` of [m]."""
        found = self._ask(ends_in, keep.astype(np.uint8), step)
        return [np.concatenate([part[k] + begin for begin, part in found]) for k in range(len(HALF))]

    def pieces(
        self,
        inner: BoolArray,
        rise: float,
        sloped: BoolArray | None = None,
        stepped: BoolArray | None = None,
        step: float = 0.0,
        more: Pairs = NO_PAIRS,
    ) -> tuple[IntArray, Pairs, Pairs]:
        """What is joined by slopes, and the pairs that tell what else is.

        Args:
            inner: Nodes that are joined, shape (k,); any other one is a piece by itself.
            rise: With at most this between them [m] a cell.
            sloped: Nodes of which pairs are asked for with at most that between them.
            stepped: Nodes of which pairs are asked for with at most a step between them.
            step: [m].
            more: Pairs of inner nodes that are joined, too.

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
        unite_all(parent, more[0], more[1], 0)
        return numbered(parent), _in_order(found, 3), _in_order(found, 6)

    def lasting(self) -> Beside:
        """The same without the points."""
        return replace(self, layers=replace(self.layers, node_of_point=np.zeros(0, np.int64)))

    def _ask(self, question: Callable[..., Any], given: NDArray[np.uint8], *limits: float) -> list[tuple[int, Any]]:
        """The first node of each strip, and its answer."""
        begin = np.cumsum([0, *(strip.count for strip in self.strips)]).tolist()
        own = [given[first : first + len(strip.height)] for first, strip in zip(begin, self.strips, strict=False)]
        keys = [(question.__name__, *limits, part.tobytes()) for part in own]
        found = [strip.recall(key) for strip, key in zip(self.strips, keys, strict=True)]
        asked = [i for i, answer in enumerate(found) if answer is None]
        fresh = run_parallel(lambda i: self.strips[i].ask(question, own[i], limits), asked)
        for i, answer in zip(asked, fresh, strict=True):
            found[i] = answer
        for strip, key, answer in zip(self.strips, keys, found, strict=True):
            strip.known[key] = answer
        return list(zip(begin, found, strict=False))


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
    return Beside(layers, tuple(run_parallel(lambda row: _strip(layers, rise, row), range(0, layers.shape[0], ROWS))))


def beside_now(near: Beside, layers: Layers, rise: float, cells: BoolArray) -> Beside:
    """`beside` of `layers` that are those of `near` but for the columns `cells`, shape (nx, ny)."""
    rows: BoolArray = np.logical_or.reduce(cells, axis=1)
    strips = (
        _strip(layers, rise, ROWS * i)
        if rows[ROWS * i : ROWS * (i + 1) + 1].any()
        else replace(strip, known={}, before=strip.known)
        for i, strip in enumerate(near.strips)
    )
    return Beside(layers, tuple(strips))


def _strip(layers: Layers, rise: float, row: int) -> Strip:
    """The strip that begins with a row of cells."""
    start, (nx, ny) = layers.start, layers.shape
    last, behind = min(row + ROWS, nx), min(row + ROWS + 1, nx)
    begin, own, end = (int(start[x * ny]) for x in (row, last, behind))
    pairs = pairs_beside(start, layers.shape, layers.height, rise, HALF, row, last)
    return Strip(own - begin, layers.height[begin:end].copy(), *pairs, {}, {})

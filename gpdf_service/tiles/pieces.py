"""Which nodes are joined: pieces within each strip, the pairs that go on into the next one, and a graph of these.

The graph is small, and so is what is summed up of each piece in each strip. Only strips with other nodes, or ones that
are joined otherwise, are looked at again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpdf_service.tiles.beside import Answer, Beside, Strips, each_strip, spans_of
from gpdf_service.tiles.layers import flat
from gpdf_service.tiles.nodes import components, count_labels, extents_of, pairs_on, pieces_of, plan_sums
from gpdf_service.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class Pieces:
    """Sets of nodes that are joined; nodes of none have the number after the last.

    Attributes:
        near: The nodes.
        label: Number of each node's piece among those of its strip; of a node of none how many these are.
        first: Where the labels of each strip begin among those of all, shape (strips + 1,).
        number: The piece that each label is of, and the number after the last for who is of none, shape (labels,).
        start: The first node of each piece, shape (pieces,), which ascend.
    """

    near: Beside
    label: Strips
    first: IntArray
    number: IntArray
    start: IntArray

    @property
    def count(self) -> int:
        """How many pieces there are."""
        return len(self.start)

    @property
    def whole(self) -> IntArray:
        """Piece of each node, shape (k,)."""
        first = np.repeat(self.first[:-1], np.diff(self.near.first))
        piece: IntArray = self.number[first + np.concatenate(self.label)]
        return piece

    def totals(self, name: str, add: Callable[..., NDArray[Any]], *given: Strips) -> NDArray[Any]:
        """Sums over the nodes of each piece, shape (pieces, d).

        Args:
            name: Of the question.
            add: Called with rows of the nodes of a strip among all, their labels, how many labels there are with that
                of none, and what is given for them. Returns sums for each label, shape (labels, d).
            given: For each node.
        """
        first = self.near.first

        def make(begin: int, end: int) -> list[Answer]:
            def one(i: int) -> Answer:
                own, count = slice(int(first[i]), int(first[i + 1])), int(self.first[i + 1] - self.first[i])
                return (add(own, self.label[i], count, *(each[i] for each in given)),)

            return each_strip(one, begin, end)

        sums = np.concatenate(self.near.told(f"{name}, totals", (self.label, *given), make)[0])
        totals = [np.bincount(self.number, column, self.count + 1)[:-1] for column in sums.T]
        return np.column_stack(totals).astype(sums.dtype)  # of whole numbers they are exact

    def counts(self, name: str, *kinds: Strips) -> IntArray:
        """How many nodes of each of the `kinds` there are in each piece, shape (kinds, pieces)."""
        return self.totals(name, _count, *kinds).T

    def extents(self, name: str, among: Strips) -> tuple[FloatArray, FloatArray]:
        """Length and depth of what the nodes `among` all of each piece cover [m], (pieces,), see `extents_of`."""
        layers = self.near.layers

        def add(own: slice, label: IntArray, labels: int, among: BoolArray) -> FloatArray:
            return plan_sums(layers.cell[own], layers.shape[1], among, label, labels)

        return extents_of(self.totals(name, add, among), layers.cell_width)

    def chosen(self, name: str, which: NDArray[Any]) -> Strips:
        """What is told of its piece for each node, by `which`, shape (pieces,): 0, or false, for a node of none."""
        told = np.append(which[: self.count], which.dtype.type(0))[self.number]
        own = self.near.same(f"{name}, which", [told[a:b] for a, b in pairwise(self.first.tolist())])

        def make(begin: int, end: int) -> list[Answer]:
            return [(own[i][self.label[i]],) for i in range(begin, end)]

        return self.near.told_nodes(f"{name}, chosen", (self.label, own), make)[0]

    def at(self, nodes: IntArray) -> IntArray:
        """The piece of some nodes, shape (m,)."""
        strip = np.searchsorted(self.near.first, nodes, side="right") - 1
        piece: IntArray = self.number[self.first[strip] + np.concatenate(self.label)[nodes]]
        return piece


def find_pieces(near: Beside, name: str, inner: Strips, rise: float, step: float = 0.0) -> Pieces:
    """Of the nodes `inner` what is joined where there is at most `rise` [m] a cell and a `step` [m] between."""
    first = near.first.tolist()

    def make(begin: int, end: int) -> list[Answer]:
        def one(i: int) -> Answer:
            rows = near.rows(i)
            return pieces_of(near.layers.columns_in(rows.start, rows.stop), inner[i], rise, step)

        return each_strip(one, begin, end)

    def join(begin: int, end: int) -> list[Answer]:
        def one(i: int) -> Answer:
            if i + 1 == len(near.nodes):
                return (np.zeros((0, 2), np.int64),)
            ends = (label[i], label[i + 1]), (first[i], first[i + 1]), (len(starts[i]), len(starts[i + 1]))
            return (pairs_on(near.layers.columns, near.rows(i).stop - 1, *ends, rise, step),)

        return each_strip(one, begin, end)

    label, starts = near.told(f"{name}, pieces", (inner,), make)
    (pairs,) = near.told(f"{name}, seams", (label,), join, spans_of(len(label), 0, 1))
    counts, joins = [np.array([len(each) for each in strips]) for strips in (starts, pairs)]
    begin = np.concatenate([[0], np.cumsum(counts + 1)])  # one of a strip for none
    a, b = (flat(pairs) + np.repeat(np.column_stack([begin[:-1], begin[1:]]), joins, axis=0)).T
    own = np.ones(begin[-1], dtype=bool)
    own[begin[1:] - 1] = False
    found = components(a, b, own)[own]
    number = (np.cumsum(np.bincount(found) > 0) - 1)[found]
    count = int(number.max(initial=-1)) + 1
    nodes, labels = np.empty(count, np.int64), np.full(begin[-1], count)
    nodes[number[::-1]] = (flat(starts) + np.repeat(first[:-1], counts))[::-1]  # the last stays
    labels[own] = number
    return Pieces(near, label, begin, labels, nodes)


def _count(_: slice, label: NDArray[Any], labels: int, *kinds: BoolArray) -> IntArray:
    """How many nodes of each kind have each label, shape (labels, kinds)."""
    return np.column_stack([count_labels(label, kind, labels) for kind in kinds])

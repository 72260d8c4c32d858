"""Surface layers per cell: a column of the grid cut at vertical gaps, so that floor, table and ceiling are three."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gpdf_service.fields.threads import run_chunked, run_parallel
from gpdf_service.tiles.boxes import Box, widened, window
from gpdf_service.tiles.columns import (
    Grid,
    column_order,
    count_nodes,
    cut_columns,
    runs_of,
    starts_spliced,
    tops_of_boards,
    values_spliced,
    write_nodes,
)
from gpdf_service.tiles.pairs import Columns, pairs_at
from gpdf_service.tiles.rows import INDEX, bounds_of, cells_of, rows_by_cell, rows_of_runs, rows_over
from gpdf_service.types import BoolArray, FloatArray, IntArray

BOARD = 0.02
"""[m] Thinnest board that a tread is made of, less what a good scanner scatters."""
THIN = 0.15
"""[m] A surface in a wide cell is no thicker: less than a stair's riser. What is thicker is two, or a face."""
BLOCK = 32
"""Cells a side of the blocks that grids and levels' boxes are made of: two metres of a room's."""
STRIP = 64
"""Rows of cells a strip: what changes in a room touches one or two."""


def flat(strips: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """All in one: what they were cut from in a build, where they are that."""
    whole = strips[0].base
    if len(strips) == 1:
        return strips[0]
    return whole if isinstance(whole, np.ndarray) and _are_all(strips, whole) else np.concatenate(strips)


def _are_all(strips: Sequence[NDArray[Any]], whole: NDArray[Any]) -> bool:
    """Whether strips are all of an array, and not of columns of it: the base of a view of a view is under both."""
    kinds = {(each.dtype, each.shape[1:], each.strides) for each in (strips[0], whole)}
    return len(kinds) == 1 and all(each.base is whole for each in strips) and sum(map(len, strips)) == len(whole)


class Rest(NamedTuple):
    """What of the nodes of a strip is asked for in windows alone; see `Layers`."""

    place: FloatArray
    top: FloatArray
    headroom: FloatArray
    middle: FloatArray
    face: FloatArray


@dataclass(frozen=True, slots=True)
class Layers:
    """Nodes of the layered grid, sorted by cell and, within a cell, upward.

    Attributes:
        origin: Lower corner of the grid [m], shape (2,).
        cell_width: [m].
        shape: Cells along x and y.
        cell: Flat cell index of each node, shape (k,).
        height: Height of its surface [m], shape (k,).
        thickness: Between its lowest and highest point [m], shape (k,).
        start: First node of each cell, shape (cells + 1,).
        rest: Strips of `STRIP` rows of cells, which versions share, or one of all: where in plan the point lies whose
            height it is [m], shape (k, 2); height of its highest point [m]; free height above it [m], inf under the
            open sky; height of its middle point, or of a step's face its highest [m]; and of the middle of what may be
            the upper face of a board, seen on both [m], NaN of no such node.
        window: Of a window, which has no `rest`, all layers, and which of their nodes it holds, shape (k,).
    """

    origin: FloatArray
    cell_width: float
    shape: tuple[int, int]
    cell: IntArray
    height: FloatArray
    thickness: FloatArray
    start: IntArray
    rest: tuple[Rest, ...]
    window: tuple[Layers, IntArray] | None = None

    @property
    def place(self) -> FloatArray:
        """Of all nodes, see `rest`, shape (k, 2)."""
        return flat([each.place for each in self._rest()])

    @property
    def top(self) -> FloatArray:
        """Of all nodes, see `rest`, shape (k,)."""
        return flat([each.top for each in self._rest()])

    @property
    def headroom(self) -> FloatArray:
        """Of all nodes, see `rest`, shape (k,)."""
        return flat([each.headroom for each in self._rest()])

    def _rest(self) -> tuple[Rest, ...]:
        return self.rest if self.window is None else (self.window[0].taken(self.window[1]),)

    def strips(self, low: int, high: int) -> Iterator[tuple[Rest, int, int]]:
        """Of the strips with some rows of cells the rest, the first node, and the one behind the last."""
        (nx, ny), step = self.shape, STRIP if len(self.rest) > 1 else self.shape[0]
        for i in range(low // step, -(-high // step)):
            yield self.rest[i], int(self.start[i * step * ny]), int(self.start[min((i + 1) * step, nx) * ny])

    def rows(self, low: int, high: int) -> Layers:
        """The layers of some rows of cells, in views: no strips of them are asked, as they begin anywhere in one."""
        own, (a, b) = self.columns_in(low, high), self.start[[low * self.shape[1], high * self.shape[1]]].tolist()
        strips = ((each, max(a - first, 0), b - first) for each, first, _ in self.strips(low, high))
        rest = tuple(Rest(*(each[begin:end] for each in told)) for told, begin, end in strips)
        origin = self.origin + self.cell_width * np.array([low, 0])
        return Layers(origin, self.cell_width, own.shape, own.cell, own.height, own.thickness, own.start, rest)

    def columns_in(self, low: int, high: int) -> Columns:
        """The layers of some rows of cells for compiled loops."""
        ny, start = self.shape[1], self.start[low * self.shape[1] : high * self.shape[1] + 1]
        a, b = int(start[0]), int(start[-1])
        return Columns(self.cell[a:b] - low * ny, start - a, (high - low, ny), self.height[a:b], self.thickness[a:b])

    def taken(self, nodes: IntArray) -> Rest:
        """The rest of some nodes, whose numbers ascend."""
        low, high = (self.cell[nodes[[0, -1]]] // self.shape[1]).tolist() if len(nodes) else (0, 0)
        parts = []
        for own, first, last in self.strips(low, high + 1):
            a, b = np.searchsorted(nodes, [first, last]).tolist()
            parts.append([each.take(nodes[a:b] - first, axis=0) for each in own])
        return Rest(*map(flat, zip(*parts, strict=True)))

    @property
    def columns(self) -> Columns:
        """The same for compiled loops."""
        return Columns(self.cell, self.start, self.shape, self.height, self.thickness)

    def grid_of(self, points: FloatArray) -> Grid:
        """What tells the nodes of points (n, 3) [m], for `node_at`."""
        (nx, ny), (first, last) = self.shape, rows_over(points, self.origin, self.cell_width)
        low = min(max(first - 1, 0), nx - 1)  # rounding: a row more
        part = self.rows(low, max(min(last + 2, nx), low + 1))
        return self.origin, self.cell_width, ny, self.start, part.top, int(self.start[low * ny])


def nodes_of(layers: Layers, points: FloatArray) -> IntArray:
    """Node of each of the points (n, 3) that the layers were built from, or some of them, shape (n,)."""
    node, grid = np.empty(len(points), INDEX), layers.grid_of(points)
    run_chunked(lambda a, b: write_nodes(points[a:b], grid, node[a:b]), len(points))
    return node


def grid_of(low: FloatArray, high: FloatArray, cell_width: float) -> tuple[FloatArray, tuple[int, int]]:
    """Lower corner [m] and shape of the grid over points between `low` and `high` [m].

    Centres lie at multiples of the width, and the grid is one of whole blocks: both stay when the cloud grows a little.
    A ring of cells at least is empty: unknown.
    """
    first = np.floor((np.floor(low[:2] / cell_width) - 1.0) / BLOCK) * BLOCK
    nx, ny = np.ceil((np.floor(high[:2] / cell_width) + 3.0 - first) / BLOCK).astype(np.int64) * BLOCK
    origin: FloatArray = (first - 0.5) * cell_width
    return origin, (int(nx), int(ny))


def same_nodes(layers: Layers, cells: BoolArray, fresh: Layers | None) -> bool:
    """Whether the nodes in these cells, shape (nx, ny), are all those of `fresh` on the same grid."""
    nodes = rows_by_cell(cells, layers.start)
    if fresh is None or len(fresh.cell) != len(nodes):
        return fresh is None and len(nodes) == 0
    own, theirs = (
        (one.cell[rows], one.thickness[rows], *one.taken(rows))  # what tells the height, too
        for one, rows in ((layers, nodes), (fresh, np.arange(len(nodes))))
    )
    return all(np.array_equal(a, b, equal_nan=True) for a, b in zip(own, theirs, strict=True))


def splice_layers(layers: Layers, changed: BoolArray, fresh: Layers | None) -> Layers:
    """Layers with all nodes of the `changed` cells, shape (nx, ny), replaced by those of `fresh` on the same grid."""
    new, begin = (layers, np.zeros_like(layers.start)) if fresh is None else (fresh, fresh.start)
    (nx, ny), other = layers.shape, changed.ravel()
    start, runs = starts_spliced(other, layers.start, begin), runs_of(other, layers.start, begin)
    cell = values_spliced(runs, layers.cell, new.cell)
    height, thickness = (
        values_spliced(runs, *both) for both in ((layers.height, new.height), (layers.thickness, new.thickness))
    )
    held = layers.rest[:1] if fresh is None else fresh.rest  # of nothing nothing is taken
    rest, fresh_rest = list(layers.rest), Rest(*map(flat, zip(*held, strict=True)))
    for i, (_, first, _) in enumerate(layers.strips(0, nx)):
        a, b = STRIP * i * ny, min(STRIP * (i + 1), nx) * ny
        if other[a:b].any():
            part = runs_of(other[a:b], layers.start[a : b + 1] - first, begin[a : b + 1])
            rest[i] = Rest(*(values_spliced(part, *both) for both in zip(rest[i], fresh_rest, strict=True)))
    own = cell, height, thickness, start, tuple(rest)
    made = Layers(layers.origin, layers.cell_width, layers.shape, *own)
    around, (rows, _) = widened(changed, 1), window(changed, 2)  # what lies beside a board says if it is one
    near = made.rows(rows.start, rows.stop)
    nodes, told = rows_by_cell(around[rows], near.start), Rest(*map(flat, zip(*near.rest, strict=True)))
    grid = near.cell, near.start, near.shape
    tops = tops_of_boards(nodes, grid, told.middle, told.face, BOARD)
    height[nodes + start[rows.start * ny]] = tops
    return made


def steady(layers: Layers, nodes: IntArray) -> IntArray:
    """Names of some nodes, by cell and place in it, which stay where others come and go, shape (m,)."""
    cell = layers.cell[nodes]
    name: IntArray = (cell << 16) + nodes - layers.start[cell]
    return name


def crop_layers(layers: Layers, box: Box) -> tuple[Layers, IntArray]:
    """The layers of a box of cells, and which nodes of all they are, shape (k,)."""
    rows, columns = box
    first, shape = (rows.start, columns.start), (rows.stop - rows.start, columns.stop - columns.start)
    begin, end = (each.reshape(layers.shape)[box].ravel() for each in (layers.start[:-1], layers.start[1:]))
    start, nodes = np.append(0, np.cumsum(end - begin)), rows_of_runs(begin, end)
    cell = np.repeat(np.arange(len(begin)), end - begin)
    origin = layers.origin + layers.cell_width * np.array(first)
    own = cell, layers.height.take(nodes), layers.thickness.take(nodes), start, ()
    return Layers(origin, layers.cell_width, shape, *own, (layers, nodes)), nodes


def build_layers(points: FloatArray, cell_width: float, gap: float, *, like: Layers | None = None) -> Layers:
    """Cut the columns of `points`, shape (n, 3), wherever neighbours in height are more than `gap` apart [m].

    A surface is as thick as its slope makes it. The grid is that of `like`, which must hold all points, or as large as
    the points ask for.
    """
    origin, shape = grid_of(*bounds_of(points), cell_width) if like is None else (like.origin, like.shape)
    cell = cells_of(points, origin, cell_width, shape)
    low, high = (int(cell.min()), int(cell.max()) + 1) if len(cell) else (0, 0)  # a few columns cost what they are
    cell -= low
    ordered = column_order(cell, points, high - low)
    first = count_nodes(ordered[0], ordered[2], gap)
    count = int(first[-1])
    cell_of, row = np.empty(count, np.int64), np.empty(count, np.int64)
    middle, face, top, thickness, headroom = (np.empty(count) for _ in range(5))
    made = cell_of, row, middle, face, top, thickness, headroom
    limits = gap, min(2.0 * cell_width, THIN), BOARD
    run_chunked(lambda a, b: cut_columns(ordered, limits, first, a, b, made), high - low)
    cell_of += low
    first = np.concatenate([np.zeros(low, np.int64), first, np.full(shape[0] * shape[1] - high, count)])
    height = tops_of_boards(np.arange(count), (cell_of, first, shape), middle, face, BOARD)
    ends = first[np.minimum(np.arange(0, shape[0] + STRIP, STRIP), shape[0]) * shape[1]].tolist()
    told = np.ascontiguousarray(points.take(row, axis=0)[:, :2]), top, headroom, middle, face
    rest = tuple(Rest(*(each[a:b] for each in told)) for a, b in pairwise(ends))
    return Layers(origin, cell_width, shape, cell_of, height, thickness, first, rest)


HALF = ((1, 0), (0, 1), (1, 1), (1, -1))
"""Half of a cell's eight neighbours: each pair of cells once."""
APART = np.hypot(*np.array(HALF, dtype=np.float64).T)
"""How many cells they are away."""
Pairs = tuple[IntArray, IntArray]


def connect(layers: Layers, keep: BoolArray, rise: float) -> Pairs:
    """Pairs of kept nodes in neighbouring cells with at most `rise` [m] a cell between them."""
    own = layers.columns, keep
    found = run_parallel(lambda k: pairs_at(*own, rise * APART[k], HALF[k]), range(len(HALF)))
    a, b = (np.concatenate(ends) for ends in zip(*found, strict=True))
    return a, b

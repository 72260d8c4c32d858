"""Surface layers per cell: a column of the grid cut at vertical gaps, so that floor, table and ceiling are three."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from gpdf_service.config import PerceptionConfig
from gpdf_service.fields.threads import run_chunked
from gpdf_service.perception.boxes import Box, widened
from gpdf_service.perception.columns import (
    Grid,
    by_cell,
    column_floors,
    column_order,
    compacted,
    count_nodes,
    cut_columns,
    kth_beside,
    nodes_in_box,
    runs_of,
    starts_spliced,
    told_of,
    tops_of_boards,
    values_spliced,
    write_nodes,
)
from gpdf_service.perception.pairs import Columns, pairs_near
from gpdf_service.perception.rows import INDEX, bounds_of, cells_of, chosen_rows, rows_by_cell
from gpdf_service.types import BoolArray, FloatArray, IntArray

MIN_CELL = 0.05
"""[m] Finer than a wheel or a foot feels, and a quarter of the smallest body's radius."""
STEP = 0.1 * MIN_CELL
"""[m] What is measured of a whole cloud counts in steps: its cells then stay when a part of it changes."""
BOARD = 0.02
"""[m] Thinnest board that a tread is made of, less what a good scanner scatters."""
THIN = 0.15
"""[m] A surface in a wide cell is no thicker: less than a stair's riser. What is thicker is two, or a face."""
SPREAD = 4.0
"""[-] Thickness that noise adds to a surface over its standard deviation: nearly all of its points are within two."""
_SAMPLE = 4000
"""Points of a floor whose neighbours are looked at: the median's error is then about 1 %."""
_NEIGHBOUR = 8
"""Which neighbour's distance tells the spacing: how near the first few are is mostly chance."""
_REFLECTED = 0.05
"""[-] Of the points of a column, those that may lie under its floor: reflections."""
_COLUMN = 0.5
"""[m] Wide enough to hold several floor points of any cloud that a body can be planned in."""


def widest_cell(config: PerceptionConfig) -> float:
    """Widest cells in whose middle the ground is no further than the widest gap from a sample anywhere in them [m].

    Cells that must be as wide as this do not close the gaps of a floor: its samples are too far apart.
    """
    return float(np.floor(np.sqrt(2.0) * config.widest_gap / STEP)) * STEP


def cell_width_of(points: FloatArray, config: PerceptionConfig) -> float:
    """Cell width at which nearly every cell of a sampled floor is hit, `widest_cell` at most [m].

    Density is not uniform: a dense chair must not speak for a sparse floor. So only the lowest points of each column
    `_COLUMN` wide are looked at, which are floor nearly everywhere. At 1.5 × their spacing s (the mean distance to the
    k-th neighbour is s √(k/π)) one cell in ten of a Poisson sample stays empty, which the height map closes.
    """
    corner, far = bounds_of(points)
    shape = columns_over(corner, far, _COLUMN)
    key, count, _ = compacted(cells_of(points, corner, _COLUMN, shape), shape[0] * shape[1])
    z = np.ascontiguousarray(points[:, 2])
    floor = column_floors(*by_cell(key, count), z, _REFLECTED)
    floor_points = chosen_rows(points, np.abs(z - floor[key]) <= MIN_CELL)
    k = min(_NEIGHBOUR, len(floor_points) - 1)
    if k < 1:
        return MIN_CELL
    picked = np.arange(0, len(floor_points), max(1, len(floor_points) // _SAMPLE))
    distance = _median_to(k, floor_points, picked, corner, far, 2.0 * MIN_CELL)
    if distance > 2.0 * MIN_CELL:
        distance = _median_to(k, floor_points, picked, corner, far, _COLUMN)
    if distance > _COLUMN:
        distance = float(np.median(cKDTree(floor_points).query(floor_points[picked], k=k + 1, workers=-1)[0][:, k]))
    return min(max(MIN_CELL, in_steps(1.5 * distance * float(np.sqrt(np.pi / k)))), widest_cell(config))


def columns_over(corner: FloatArray, far: FloatArray, width: float) -> tuple[int, int]:
    """How many columns of `width` there are from one corner to the other [m]."""
    x, y = np.floor((far - corner) / width).astype(np.int64) + 1
    return int(x), int(y)


def _median_to(
    k: int, points: FloatArray, picked: IntArray, corner: FloatArray, far: FloatArray, width: float
) -> float:
    """Median distance of the `picked` points to their `k`-th neighbour [m]; exact if it is at most `width`.

    Infinite where the columns are too many for the points, most of them empty.
    """
    shape, each = columns_over(corner, far, width), np.empty(len(picked))
    cell, count, held = compacted(cells_of(points, corner, width, shape), shape[0] * shape[1])
    if len(held):
        return np.inf
    columns = by_cell(cell, count)
    own = points, columns, (corner, width, shape)
    run_chunked(lambda a, b: kth_beside(*own, picked[a:b], k, each[a:b]), len(picked))
    return float(np.median(each))


def in_steps(length: float, step: float = STEP) -> float:
    """A measured length rounded up to whole steps [m]: a cloud that changes a little is measured as before."""
    return float(np.ceil(round(length / step, 6))) * step


def layer_gap(width: float, config: PerceptionConfig) -> float:
    """Room between two layers of columns that are `width` wide [m]."""
    return max(config.min_headroom, 1.5 * width)


@dataclass(frozen=True, slots=True)
class Layers:
    """Nodes of the layered grid, sorted by cell and, within a cell, upward.

    Attributes:
        origin: Lower corner of the grid [m], shape (2,).
        cell_width: [m].
        shape: Cells along x and y.
        board: Least room between the two faces of a board [m].
        cell: Flat cell index of each node, shape (k,).
        place: Where in plan the point lies whose height it is [m], shape (k, 2).
        height: Height of its surface [m], shape (k,).
        top: Height of its highest point [m], shape (k,).
        thickness: Between its lowest and highest point [m], shape (k,).
        headroom: Free height above it [m], inf under the open sky, shape (k,).
        middle: Height of its middle point, or of a step's face its highest [m], shape (k,).
        face: Of the middle of what may be the upper face of a board, seen on both [m], shape (k,), NaN of no such node.
        start: First node of each cell, shape (cells + 1,).
    """

    origin: FloatArray
    cell_width: float
    shape: tuple[int, int]
    board: float
    cell: IntArray
    place: FloatArray
    height: FloatArray
    top: FloatArray
    thickness: FloatArray
    headroom: FloatArray
    middle: FloatArray
    face: FloatArray
    start: IntArray

    @property
    def columns(self) -> Columns:
        """The same for compiled loops."""
        return Columns(self.cell, self.start, self.shape, self.height, self.thickness)

    @property
    def grid(self) -> Grid:
        """The same for `node_at`."""
        return self.origin, self.cell_width, self.shape[1], self.start, self.top


def nodes_of(layers: Layers, points: FloatArray) -> IntArray:
    """Node of each of the points (n, 3) that the layers were built from, or some of them, shape (n,)."""
    node = np.empty(len(points), INDEX)
    run_chunked(lambda a, b: write_nodes(points[a:b], layers.grid, node[a:b]), len(points))
    return node


def grid_of(low: FloatArray, high: FloatArray, cell_width: float) -> tuple[FloatArray, tuple[int, int]]:
    """Lower corner [m] and shape of the grid over points between `low` and `high` [m].

    Centres lie at multiples of the width, so that they stay when the cloud grows; a ring of them is empty: unknown.
    """
    origin: FloatArray = (np.floor(low[:2] / cell_width) - 1.5) * cell_width
    shape = np.floor((high[:2] - origin) / cell_width).astype(np.int64) + 2
    return origin, (int(shape[0]), int(shape[1]))


_TOLD = "height", "top", "thickness", "headroom", "middle", "face"
PER_NODE = "cell", "place", *_TOLD
"""What is told of each node."""


def same_nodes(layers: Layers, cells: BoolArray, fresh: Layers | None) -> bool:
    """Whether the nodes in these cells, shape (nx, ny), are all those of `fresh` on the same grid."""
    rows, own = rows_by_cell(cells, layers.start), [name for name in PER_NODE if name != "height"]  # which these tell
    if fresh is None or len(fresh.cell) != len(rows):
        return fresh is None and len(rows) == 0
    return all(np.array_equal(getattr(layers, name)[rows], getattr(fresh, name), equal_nan=True) for name in own)


def splice_layers(layers: Layers, changed: BoolArray, fresh: Layers | None) -> Layers:
    """Layers with all nodes of the `changed` cells, shape (cells,), replaced by those of `fresh` on the same grid."""
    new, begin = (layers, np.zeros_like(layers.start)) if fresh is None else (fresh, fresh.start)
    start, runs = starts_spliced(changed, layers.start, begin), runs_of(changed, layers.start, begin)
    own: dict[str, Any] = {name: values_spliced(runs, getattr(layers, name), getattr(new, name)) for name in PER_NODE}
    nodes = rows_by_cell(widened(changed.reshape(layers.shape), 1), start)  # what lies beside a board says if it is one
    grid = own["cell"], start, layers.shape
    own["height"][nodes] = tops_of_boards(nodes, grid, own["middle"], own["face"], layers.board)
    return replace(layers, **own, start=start)


def steady(layers: Layers, nodes: IntArray) -> IntArray:
    """Names of some nodes, by cell and place in it, which stay where others come and go, shape (m,)."""
    cell = layers.cell[nodes]
    name: IntArray = (cell << 16) + nodes - layers.start[cell]
    return name


def crop_layers(layers: Layers, box: Box) -> tuple[Layers, IntArray]:
    """The layers of a box of cells, and which nodes of all they are, shape (k,)."""
    rows, columns = box
    first, shape = (rows.start, columns.start), (rows.stop - rows.start, columns.stop - columns.start)
    start, cell, nodes = nodes_in_box(layers.start, layers.shape[1], first, shape)
    place, told = told_of(nodes, layers.place, tuple(getattr(layers, name) for name in _TOLD))
    own: dict[str, Any] = dict(zip(_TOLD, told, strict=True))
    origin = layers.origin + layers.cell_width * np.array(first)
    return Layers(origin, layers.cell_width, shape, layers.board, cell, place, start=start, **own), nodes


def build_layers(
    points: FloatArray, cell_width: float, gap: float, noise: float = 0.0, *, like: Layers | None = None
) -> Layers:
    """Cut the columns of `points`, shape (n, 3), wherever neighbours in height are more than `gap` apart [m].

    A surface is as thick as its slope and `SPREAD` standard deviations of the `noise` [m] make it. The grid is that of
    `like`, which must hold all points, or as large as the points ask for.
    """
    origin, shape = grid_of(*bounds_of(points), cell_width) if like is None else (like.origin, like.shape)
    cell = cells_of(points, origin, cell_width, shape)
    low, high = (int(cell.min()), int(cell.max()) + 1) if len(cell) else (0, 0)  # a few columns cost what they are
    cell -= low
    ordered = column_order(cell, points, high - low)
    flat, board = min(2.0 * cell_width, THIN) + SPREAD * noise, BOARD + SPREAD * noise
    first = count_nodes(ordered[0], ordered[2], gap)
    count = int(first[-1])
    cell_of, row = np.empty(count, np.int64), np.empty(count, np.int64)
    middle, face, top, thickness, headroom = (np.empty(count) for _ in range(5))
    made = cell_of, row, middle, face, top, thickness, headroom
    run_chunked(lambda a, b: cut_columns(ordered, (gap, flat, board), first, a, b, made), high - low)
    cell_of += low
    first = np.concatenate([np.zeros(low, np.int64), first, np.full(shape[0] * shape[1] - high, count)])
    height = tops_of_boards(np.arange(count), (cell_of, first, shape), middle, face, board)
    own = cell_of, points[row, :2], height, top, thickness, headroom, middle, face
    return Layers(origin, cell_width, shape, board, *own, first)


HALF = ((1, 0), (0, 1), (1, 1), (1, -1))
"""Half of a cell's eight neighbours: each pair of cells once."""
APART = np.hypot(*np.array(HALF, dtype=np.float64).T)
"""How many cells they are away."""
Pairs = tuple[IntArray, IntArray]


def connect(layers: Layers, keep: BoolArray, rise: float) -> Pairs:
    """Pairs of kept nodes in neighbouring cells with at most `rise` [m] a cell between them."""
    pairs: Pairs = pairs_near(layers.start, layers.shape, layers.height, keep, rise * APART, HALF)
    return pairs

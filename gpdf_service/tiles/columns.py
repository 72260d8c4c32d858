"""Compiled loops over the columns of a grid: points in the order of their columns, and the nodes cut from them."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gpdf_service.fields.threads import run_chunked
from gpdf_service.tiles.rows import INDEX
from gpdf_service.types import BoolArray, FloatArray, IntArray

Grid = tuple[FloatArray, float, int, IntArray, FloatArray, int]
"""What tells the node of a point: corner and width of cells [m], how many a row has, first nodes; tops of nodes [m]
from one on, and that one's number."""
BAND = 0.04
"""[m] Thickness of a surface as a scanner of a centimetre's noise sees it."""
_FEW = 32
"""Points that are sorted faster by insertion than by a call."""

_SCATTERED, _MANY = 8, 1_000_000
"""Cells a point, and in any case, that are counted out one by one: sorting takes longer, and less memory."""


def column_order(cell: IntArray, points: FloatArray, cells: int) -> tuple[IntArray, IntArray, FloatArray]:
    """Order of points by their cell and, within a cell, upward; equal heights stay in their order.

    Args:
        cell: Cell of each point, shape (n,).
        points: Shape (n, 3) [m].
        cells: How many cells there are.

    Returns:
        Where each cell begins in the order, shape (cells + 1,), the order, and the heights in it [m], shape (n,).
    """
    start, order = by_cell(cell, cells)
    z = np.empty(len(order))
    run_chunked(lambda a, b: _sort_columns(start, points, order, z, a, b), cells)
    return start, order, z


def compacted(cell: IntArray, cells: int) -> tuple[IntArray, int, IntArray]:
    """Cells numbered anew where most hold no point: then memory goes with what is there, and not with how wide it is.

    Returns:
        Cell of each point, shape (n,), how many there are, and which of the former each is; empty where none changed.
    """
    if cells <= _SCATTERED * len(cell) + _MANY:
        return cell, cells, np.zeros(0, np.int64)
    held, number = np.unique(cell, return_inverse=True)
    return number, len(held), held


def by_cell(cell: IntArray, cells: int) -> tuple[IntArray, IntArray]:
    """Where each of the cells begins, shape (cells + 1,), in the order of the points by cell, shape (n,)."""
    start, order = np.empty(cells + 1, np.int64), np.empty(len(cell), INDEX)
    _count_out(cell, start, order)
    return start, order


@njit(cache=True, nogil=True)
def _count_out(cell: IntArray, start: IntArray, order: IntArray) -> None:
    place, before = np.zeros(len(start), order.dtype), 0  # looked up at random: half as wide, more is in the caches
    for c in cell:
        place[c] += 1
    for c in range(len(start)):
        start[c], before, place[c] = before, before + place[c], before
    for i in range(len(cell)):
        order[place[cell[i]]] = i
        place[cell[i]] += 1


@njit(cache=True, nogil=True)
def _sort_columns(start: IntArray, points: FloatArray, order: IntArray, z: FloatArray, begin: int, end: int) -> None:
    for i in range(start[begin], start[end]):  # by itself: no guess of a branch of the sorting waits for memory
        z[i] = points[order[i], 2]
    for c in range(begin, end):
        a, b = start[c], start[c + 1]
        if b - a > _FEW:
            upward = np.argsort(z[a:b], kind="mergesort")
            z[a:b], order[a:b] = z[a:b][upward], order[a:b][upward]
            continue
        for i in range(a + 1, b):
            row, height, j = order[i], z[i], i
            while j > a and z[j - 1] > height:
                order[j], z[j] = order[j - 1], z[j - 1]
                j -= 1
            order[j], z[j] = row, height


@njit(cache=True, nogil=True)
def count_nodes(start: IntArray, z: FloatArray, gap: float) -> IntArray:
    """First node of each column, shape (cells + 1,): columns of sorted heights are cut where they leave a `gap` [m]."""
    first = np.zeros(len(start), np.int64)
    for c in range(len(start) - 1):
        first[c + 1] = first[c]
        for i in range(start[c], start[c + 1]):
            first[c + 1] += i == start[c] or z[i] - z[i - 1] > gap
    return first


@njit(cache=True, nogil=True)
def cut_columns(
    ordered: tuple[IntArray, IntArray, FloatArray],
    limits: tuple[float, float, float],
    first: IntArray,
    begin: int,
    end: int,
    made: tuple[IntArray, IntArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray],
) -> None:
    """Fill what nodes of the columns from `begin` to `end` are, in the order of `made`.

    Args:
        ordered: Where each column begins, rows of the points, by column and upward, and their heights [m].
        limits: What parts two nodes [m]; the thickness up to which a node's middle is its median [m], of a thicker one
            it is `_highest_full_band`; and the room between the faces of a board, at least: what lies over another node
            may have been seen on both [m]. Then the face is the median of what is over that room.
        first: `count_nodes`.
        begin: First column.
        end: Behind the last.
        made: Of each node its cell, the row of the point in its middle, that one's height, its face, top, thickness
            and headroom.
    """
    (start, order, z), (gap, flat, board) = ordered, limits
    cell, row, middle, face, top, thickness, headroom = made
    for c in range(begin, end):
        node, i = first[c], start[c]
        while i < start[c + 1]:
            last = i
            while last + 1 < start[c + 1] and z[last + 1] - z[last] <= gap:
                last += 1
            cell[node], top[node], thickness[node] = c, z[last], z[last] - z[i]
            chosen = (i + last) // 2 if thickness[node] <= flat else _highest_full_band(z, i, last)
            row[node], middle[node], face[node] = order[chosen], z[chosen], np.nan
            if i > start[c] and thickness[node] <= flat:
                upper = _top_of_board(z, i, last, board)
                face[node] = z[(upper + last) // 2] if upper > i else np.nan
            headroom[node] = z[last + 1] - z[last] if last + 1 < start[c + 1] else np.inf
            node, i = node + 1, last + 1


@njit(cache=True, nogil=True)
def node_at(place: tuple[float, float, float], grid: Grid) -> Any:  # noqa: ANN401
    """The node of a point that layers were built from, the lowest of its column that is as high; see `Layers`."""
    (x, y, z), (origin, width, ny, start, top, begin) = place, grid
    column = int(np.floor((x - origin[0]) / width)) * ny + int(np.floor((y - origin[1]) / width))
    n, last = start[column], start[column + 1] - 1
    while n < last and top[n - begin] < z:
        n += 1
    return n


@njit(cache=True, nogil=True)
def write_nodes(points: FloatArray, grid: Grid, node: IntArray) -> None:
    """Write the node of each point."""
    for i in range(len(points)):
        node[i] = node_at((points[i, 0], points[i, 1], points[i, 2]), grid)


@njit(cache=True, nogil=True)
def take_out(
    points: FloatArray, stray: BoolArray, ground: BoolArray, grid: Grid, sheet: BoolArray, out: int, cell: IntArray
) -> None:
    """Write `out` as the cell of points that are stray, or ground in the nodes of a `sheet`."""
    for i in range(len(points)):
        inside = ground[i] and cell[i] != out and sheet[node_at((points[i, 0], points[i, 1], points[i, 2]), grid)]
        if stray[i] or inside:
            cell[i] = out


@njit(cache=True, nogil=True)
def _highest_full_band(z: FloatArray, first: int, last: int) -> int:
    """The top of a thick run from `first` to `last`: the middle of its highest band that is a quarter as full as any.

    What lies over it are strays, or points of a railing.
    """
    most, low = 1, first
    for e in range(first, last + 1):
        while z[e] - z[low] > BAND:
            low += 1
        most = max(most, e - low + 1)
    high, low = last, last
    while low >= first:
        while low > first and z[high] - z[low - 1] <= BAND:
            low -= 1
        if 4 * (high - low + 1) >= most:
            return (low + high + 1) // 2
        high -= 1
    return last


@njit(cache=True, nogil=True)
def _top_of_board(z: FloatArray, first: int, last: int, board: float) -> int:
    """The first of the heights over the widest room between those from `first` to `last`, if that is a `board` [m].

    One alone is no face.
    """
    top = first
    for e in range(first, last - 1):
        if z[e + 1] - z[e] > board:
            top, board = e + 1, z[e + 1] - z[e]
    return top


@njit(cache=True, nogil=True)
def tops_of_boards(
    nodes: IntArray, grid: tuple[IntArray, IntArray, tuple[int, int]], middle: FloatArray, face: FloatArray, near: float
) -> FloatArray:
    """Heights of `nodes` [m], shape (m,): the `face` of those that three others beside lie `near` [m], or the `middle`.

    A board goes on in two directions; points of a riser over its tread, with room between by chance, along a line.
    The `grid` is cell, first nodes and shape of `Layers`.
    """
    (cell, start, shape), height = grid, middle[nodes]
    for n in range(len(nodes)):
        i = nodes[n]
        if np.isnan(face[i]):
            continue
        x, y, beside = cell[i] // shape[1], cell[i] % shape[1], 0
        for u in range(max(x - 1, 0), min(x + 2, shape[0])):
            for v in range(max(y - 1, 0), min(y + 2, shape[1])):
                for j in range(start[u * shape[1] + v], start[u * shape[1] + v + 1]):
                    top = middle[j] if np.isnan(face[j]) else face[j]
                    if j != i and abs(top - face[i]) <= near:
                        beside += 1
                        break
        if beside >= 3:
            height[n] = face[i]
    return height


Runs = list[tuple[bool, slice]]
"""Cells beside each other that all changed, or none of them, one run after another, and where their values lie."""


def runs_of(changed: BoolArray, start: IntArray, fresh: IntArray) -> Runs:
    """Runs of cells, shape (cells,): what is in the `changed` ones begins at `fresh`, (cells + 1,), else at `start`."""
    ends = [0, *(np.flatnonzero(changed[1:] != changed[:-1]) + 1), len(changed)]
    found = [(bool(changed[a]), fresh if changed[a] else start, a, b) for a, b in pairwise(ends)]
    return [(other, slice(int(place[a]), int(place[b]))) for other, place, a, b in found]


@njit(cache=True, nogil=True)
def starts_spliced(changed: BoolArray, start: IntArray, fresh: IntArray) -> IntArray:
    """Where each cell begins, shape (cells + 1,), when what is in the `changed` ones is taken from others."""
    made = np.zeros(len(changed) + 1, np.int64)
    for i in range(len(changed)):
        count = fresh[i + 1] - fresh[i] if changed[i] else start[i + 1] - start[i]
        made[i + 1] = made[i] + count
    return made


def values_spliced(runs: Runs, old: NDArray[Any], new: NDArray[Any]) -> NDArray[Any]:
    """The `old` values by cell, but of the cells that changed the `new` ones; where all are of one kind, a view."""
    if len(runs) == 1:
        return (new if runs[0][0] else old)[runs[0][1]]
    return np.concatenate([(new if changed else old)[part] for changed, part in runs])


@njit(cache=True, nogil=True)
def unlike_cells(cells: BoolArray, start: IntArray, old: NDArray[Any], fresh: IntArray, new: NDArray[Any]) -> BoolArray:
    """Those of the `cells`, shape (nx, ny), that hold other rows than before, or the same in another order.

    The `old` ones (m, d) of each cell begin at its `start`, the `new` ones at `fresh`.
    """
    found = np.zeros_like(cells)
    for x in range(cells.shape[0]):
        for y in range(cells.shape[1]):
            c = x * cells.shape[1] + y
            a, b, count = start[c], fresh[c], fresh[c + 1] - fresh[c]
            other = cells[x, y] and start[c + 1] - a != count
            for i in range(count if cells[x, y] and not other else 0):
                for k in range(old.shape[1]):
                    other |= old[a + i, k] != new[b + i, k]
            found[x, y] = other
    return found


@njit(cache=True, nogil=True)
def box_unlike(
    old: NDArray[Any],
    fresh: NDArray[Any],
    was: IntArray,
    start: IntArray,
    cells: tuple[int, int],
    ny: int,
    box: tuple[int, int, int, int],
) -> tuple[tuple[int, int, int, int], int]:
    """First and behind the last row and column in which nodes of some rows are told otherwise than before.

    In a box of cells, first and behind the last row and column, they are told the `fresh` values, elsewhere the `old`
    ones. The nodes of each cell began at `was`, and begin at `start`, shape (all cells + 1,); where there are as many
    they are the same. The rows, from the first of the `cells` to the last, have `ny` each. At last how many values are
    these rows'.
    """
    (first, last, begin, end), used = box, 0
    left, right, near, far = last, first, end, begin
    for row in range(max(cells[0], first * ny), min(cells[1], last * ny), ny):
        for c in range(row + begin, row + end):
            a, count = was[c] - was[cells[0]], start[c + 1] - start[c]
            other = was[c + 1] - was[c] != count
            for k in range(0 if other else count):
                other |= old[a + k] != fresh[used + k]
            used += count
            if other:
                left, right, near, far = min(left, row // ny), row // ny + 1, min(near, c - row), max(far, c - row + 1)
    return (left, right, near, far), used


@njit(cache=True, nogil=True)
def box_spliced(
    old: NDArray[Any],
    fresh: NDArray[Any],
    was: IntArray,
    start: IntArray,
    cells: tuple[int, int],
    ny: int,
    box: tuple[int, int, int, int],
    made: NDArray[Any],
) -> None:
    """Write what is told of nodes of some rows: in a box of cells the `fresh` values, else the `old` ones.

    See `box_unlike`.
    """
    used = 0
    for row in range(cells[0], cells[1], ny):
        inside = box[0] * ny <= row < box[1] * ny
        left, right, end = row + (box[2] if inside else ny), row + (box[3] if inside else ny), row + ny
        for a, b in ((row, left), (right, end)):
            begin, count, at = was[a] - was[cells[0]], was[b] - was[a], start[a] - start[cells[0]]
            made[at : at + count] = old[begin : begin + count]
        at, count = start[left] - start[cells[0]], start[right] - start[left]
        made[at : at + count] = fresh[used : used + count]
        used += count


@njit(cache=True, nogil=True)
def ends_of_runs(key: IntArray, order: IntArray, z: FloatArray) -> IntArray:
    """Rows of the lowest and the highest z of each run of equal keys in `order`: of equal ones the first, the last."""
    ends, used = np.empty(2 * len(order), np.int64), 0
    for i in range(len(order)):
        row = order[i]
        if i == 0 or key[row] != key[ends[used - 1]]:
            ends[used] = ends[used + 1] = row
            used += 2
            continue
        low, high = ends[used - 2], ends[used - 1]
        if z[row] < z[low] or (z[row] == z[low] and row < low):
            ends[used - 2] = row
        if z[row] > z[high] or (z[row] == z[high] and row > high):
            ends[used - 1] = row
    return ends[:used].copy()


@njit(cache=True, nogil=True)
def lowest_above(
    held: tuple[IntArray, FloatArray], points: FloatArray, asked: IntArray, stride: int, reach: float, least: FloatArray
) -> FloatArray:
    """Least height of the `ends` that are within `reach` of each point in plan and no lower than its `least` [m].

    Args:
        held: Cell of each of the ends, ascending, shape (e,), and the ends, points (e, 3) [m].
        points: Shape (m, 3) [m].
        asked: Cell of each point, shape (m,); two cells to all sides of it are looked at.
        stride: Cells of a row of the grid.
        reach: [m].
        least: [m], shape (m,).
    """
    (keys, ends), best = held, np.full(len(points), np.inf)
    for i in range(len(points)):
        for step in range(-2, 3):
            first = asked[i] + step * stride - 2
            for e in range(np.searchsorted(keys, first), len(keys)):
                if keys[e] > first + 4:
                    break
                if not least[i] <= ends[e, 2] < best[i]:
                    continue
                if np.hypot(ends[e, 0] - points[i, 0], ends[e, 1] - points[i, 1]) <= reach:
                    best[i] = ends[e, 2]
    return best

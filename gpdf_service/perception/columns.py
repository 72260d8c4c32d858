"""Compiled loops over the columns of a grid: points in the order of their columns, and pairs of neighbouring layers."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gpdf_service.fields.threads import run_chunked, run_parallel
from gpdf_service.types import BoolArray, FloatArray, IntArray

INDEX: Any = np.int32
"""Kind of the numbers of nodes in pairs, which are many: half of the memory."""
_FEW = 32
"""Points that are sorted faster by insertion than by a call."""


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


def by_cell(cell: IntArray, cells: int) -> tuple[IntArray, IntArray]:
    """Where each of the cells begins, shape (cells + 1,), in the order of the points by cell, shape (n,)."""
    start, order = np.zeros(cells + 1, np.int64), np.empty(len(cell), np.int64)
    _count_out(cell, start, order)
    return start, order


@njit(cache=True, nogil=True)
def _count_out(cell: IntArray, start: IntArray, order: IntArray) -> None:
    for c in cell:
        start[c + 1] += 1
    for c in range(len(start) - 1):
        start[c + 1] += start[c]
    place = start[:-1].copy()
    for i in range(len(cell)):
        order[place[cell[i]]] = i
        place[cell[i]] += 1


@njit(cache=True, nogil=True)
def _sort_columns(start: IntArray, points: FloatArray, order: IntArray, z: FloatArray, begin: int, end: int) -> None:
    for c in range(begin, end):
        a, b = start[c], start[c + 1]
        for i in range(a, b):
            z[i] = points[order[i], 2]
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
    start: IntArray,
    order: IntArray,
    z: FloatArray,
    gap: float,
    flat: float,
    board: float,
    first: IntArray,
    begin: int,
    end: int,
    made: tuple[IntArray, IntArray, FloatArray, FloatArray, FloatArray, FloatArray, IntArray],
) -> None:
    """Fill what nodes of the columns from `begin` to `end` are, in the order of `made`.

    Args:
        start: Where each column begins in `order` and in `z`.
        order: Rows of the points, by column and upward.
        z: Their heights in that order [m].
        gap: That parts two nodes [m].
        flat: Thickness up to which a node's middle is its median; of a thicker one, a step's face, its top [m].
        board: Room between the faces of a board, at least: what lies over another node may have been seen on both [m].
            Then the face is the median of what is over that room.
        first: `count_nodes`.
        begin: First column.
        end: Behind the last.
        made: Of each node its cell, the row of the point in its middle, that one's height, its face, thickness and
            headroom; and each point's node.
    """
    cell, row, middle, face, thickness, headroom, node_of_point = made
    for c in range(begin, end):
        node, i = first[c], start[c]
        while i < start[c + 1]:
            last = i
            while last + 1 < start[c + 1] and z[last + 1] - z[last] <= gap:
                last += 1
            for e in range(i, last + 1):
                node_of_point[order[e]] = node
            cell[node], thickness[node] = c, z[last] - z[i]
            chosen = (i + last) // 2 if thickness[node] <= flat else last
            row[node], middle[node], face[node] = order[chosen], z[chosen], np.nan
            if i > start[c] and thickness[node] <= flat:
                top = _top_of_board(z, i, last, board)
                face[node] = z[(top + last) // 2] if top > i else np.nan
            headroom[node] = z[last + 1] - z[last] if last + 1 < start[c + 1] else np.inf
            node, i = node + 1, last + 1


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
    nodes: IntArray,
    cell: IntArray,
    start: IntArray,
    shape: tuple[int, int],
    middle: FloatArray,
    face: FloatArray,
    near: float,
) -> FloatArray:
    """Heights of `nodes` [m], shape (m,): the `face` of those that three others beside lie `near` [m], or the `middle`.

    A board goes on in two directions; points of a riser over its tread, with room between by chance, along a line.
    """
    height = middle[nodes]
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


def pairs_near(
    start: IntArray,
    shape: tuple[int, int],
    height: FloatArray,
    keep: BoolArray,
    most: FloatArray,
    offsets: tuple[tuple[int, int], ...],
) -> tuple[IntArray, IntArray]:
    """Pairs of kept nodes (a, b), b's cell at one of the `offsets` from a's, whose heights differ by little.

    That is by at most `most` [m], one number an offset.
    """
    own = start, shape, height, keep
    found = run_parallel(lambda k: _pairs_at(*own, float(most[k]), offsets[k]), range(len(offsets)))
    a, b = (np.concatenate(ends) for ends in zip(*found, strict=True))
    return a, b


@njit(cache=True, nogil=True)
def _pairs_at(
    start: IntArray, shape: tuple[int, int], height: FloatArray, keep: BoolArray, most: float, offset: tuple[int, int]
) -> tuple[IntArray, IntArray]:
    """`pairs_near` with one offset."""
    capacity, used = len(height) + 16, 0
    one, other = np.empty(capacity, INDEX), np.empty(capacity, INDEX)
    dx, dy = offset
    for x in range(max(0, -dx), min(shape[0], shape[0] - dx)):
        for y in range(max(0, -dy), min(shape[1], shape[1] - dy)):
            here, there = x * shape[1] + y, (x + dx) * shape[1] + y + dy
            more = (start[here + 1] - start[here]) * (start[there + 1] - start[there])
            if used + more > capacity:
                capacity = 2 * capacity + more
                one, other = _longer(one, capacity), _longer(other, capacity)
            for a in range(start[here], start[here + 1] if more > 0 else 0):
                if not keep[a]:
                    continue
                for b in range(start[there], start[there + 1]):  # written, and kept or not: a guess would be wrong
                    one[used], other[used] = a, b
                    used += int(keep[b] & (abs(height[a] - height[b]) <= most))
    return one[:used], other[:used]


@njit(cache=True, nogil=True)
def pairs_beside(
    start: IntArray,
    shape: tuple[int, int],
    height: FloatArray,
    most: float,
    offsets: tuple[tuple[int, int], ...],
    begin: int,
    end: int,
) -> tuple[IntArray, IntArray, IntArray]:
    """What `pairs_near` finds if all are kept, and where the pairs of each offset begin, shape (offsets + 1,).

    Of the nodes a in the rows of cells from `begin` to `end`; nodes count from the first of these. The heights of a
    column must ascend: so what is too low or too high for one node is passed over.
    """
    first, base = np.zeros(len(offsets) + 1, np.int64), start[begin * shape[1]]
    capacity, used = 4 * (start[end * shape[1]] - base) + 16, 0
    one, other = np.empty(capacity, INDEX), np.empty(capacity, INDEX)
    for k in range(len(offsets)):
        dx, dy = offsets[k]
        for x in range(max(begin, -dx), min(end, shape[0] - dx)):
            for y in range(max(0, -dy), min(shape[1], shape[1] - dy)):
                here, there = x * shape[1] + y, (x + dx) * shape[1] + y + dy
                low, last = start[there], start[there + 1]
                more = (start[here + 1] - start[here]) * (last - low)
                if used + more > capacity:
                    capacity = 2 * capacity + more
                    one, other = _longer(one, capacity), _longer(other, capacity)
                for a in range(start[here], start[here + 1]):
                    while low < last and height[a] - height[low] > most:
                        low += 1
                    b = low
                    while b < last and height[b] - height[a] <= most:
                        one[used], other[used] = a - base, b - base
                        used, b = used + 1, b + 1
        first[k + 1] = used
    return one[:used].copy(), other[:used].copy(), first


@njit(cache=True, nogil=True)
def _longer(values: IntArray, capacity: int) -> IntArray:
    made = np.empty(capacity, values.dtype)
    made[: len(values)] = values
    return made


@njit(cache=True, nogil=True)
def medians_around(height: FloatArray, keep: BoolArray, a: IntArray, b: IntArray) -> FloatArray:
    """Lower median of the heights of each kept node and those that the pairs (a, b) join it to; others as they are."""
    start = np.zeros(len(height) + 1, np.int64)
    for i in range(len(height)):
        start[i + 1] = keep[i]
    for e in range(len(a)):
        start[a[e] + 1] += 1
        start[b[e] + 1] += 1
    for i in range(len(height)):
        start[i + 1] += start[i]
    values, place = np.empty(start[-1]), start[:-1].copy()
    for i in range(len(height)):
        if keep[i]:
            values[place[i]] = height[i]
            place[i] += 1
    for e in range(len(a)):
        values[place[a[e]]], values[place[b[e]]] = height[b[e]], height[a[e]]
        place[a[e]] += 1
        place[b[e]] += 1
    made = height.copy()
    for i in range(len(height)):
        if keep[i]:
            _sort(values, start[i], start[i + 1])
            made[i] = values[(start[i] + start[i + 1] - 1) // 2]
    return made


@njit(cache=True, nogil=True)
def _sort(values: FloatArray, begin: int, end: int) -> None:
    """Put the few values from `begin` to `end` in order, by insertion."""
    for i in range(begin + 1, end):
        value, j = values[i], i
        while j > begin and values[j - 1] > value:
            values[j] = values[j - 1]
            j -= 1
        values[j] = value


@njit(cache=True, nogil=True)
def heights_in_plan(
    cell: IntArray,
    nodes: IntArray,
    height: FloatArray,
    place: FloatArray,
    origin: FloatArray,
    width: float,
    ny: int,
    first: tuple[int, int],
    shape: tuple[int, int],
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Height [m] of the one of the `nodes` in each cell, NaN where there is none, and its place from the cell's centre.

    Of the cells of a box from `first` on, shapes (nx, ny) and (nx, ny, 2), of a grid `ny` cells wide.
    """
    made, off = np.full(shape, np.nan, np.float32), np.zeros((*shape, 2), np.float32)
    for i in nodes:
        x, y = cell[i] // ny, cell[i] % ny
        u, v = x - first[0], y - first[1]
        if 0 <= u < shape[0] and 0 <= v < shape[1]:
            made[u, v] = height[i]
            off[u, v, 0] = place[i, 0] - origin[0] - (x + 0.5) * width
            off[u, v, 1] = place[i, 1] - origin[1] - (y + 0.5) * width
    return made, off


Runs = list[tuple[bool, slice]]
"""Cells beside each other that all changed, or none of them, one run after another, and where their values lie."""


def runs_of(changed: BoolArray, start: IntArray, fresh: IntArray) -> Runs:
    """Runs of cells, shape (cells,): what is in the `changed` ones begins at `fresh`, (cells + 1,), else at `start`."""
    ends = [0, *(np.flatnonzero(changed[1:] != changed[:-1]) + 1), len(changed)]
    found = [(bool(changed[a]), fresh if changed[a] else start, a, b) for a, b in pairwise(ends)]
    return [(other, slice(int(place[a]), int(place[b]))) for other, place, a, b in found]


def starts_spliced(changed: BoolArray, start: IntArray, fresh: IntArray) -> IntArray:
    """Where each cell begins, shape (cells + 1,), when what is in the `changed` ones is taken from others."""
    return np.concatenate([[0], np.cumsum(np.where(changed, np.diff(fresh), np.diff(start)))])


def values_spliced(runs: Runs, old: NDArray[Any], new: NDArray[Any]) -> NDArray[Any]:
    """The `old` values by cell, but of the cells that changed the `new` ones."""
    return np.concatenate([(new if changed else old)[part] for changed, part in runs])


@njit(cache=True, nogil=True)
def more_now(key: NDArray[np.uint64], was: int) -> IntArray:
    """How many more of the keys from number `was` on than of those before are that of each key, shape (n,)."""
    slots = 1
    while slots < 2 * len(key):
        slots *= 2
    first, more, slot = np.full(slots, -1), np.zeros(slots, np.int64), np.empty(len(key), np.int64)
    for i in range(len(key)):
        at = np.int64(key[i] & np.uint64(slots - 1))
        while first[at] >= 0 and key[first[at]] != key[i]:
            at = (at + 1) & (slots - 1)
        first[at] = i if first[at] < 0 else first[at]
        more[at] += 1 if i >= was else -1
        slot[i] = at
    return more[slot]


@njit(cache=True, nogil=True)
def rows_in_cells(points: FloatArray, origin: FloatArray, cell_width: float, wanted: BoolArray) -> IntArray:
    """Rows of the points (n, 3) in the `wanted` cells, shape (nx, ny), of a grid; sorted."""
    found, used = np.empty(1024, np.int64), 0
    low, high = np.full(2, np.inf), np.full(2, -np.inf)  # [m] around the cells: most points are seen to lie outside
    for i in range(wanted.shape[0]):
        for j in range(wanted.shape[1]):
            if wanted[i, j]:
                low[0], high[0] = min(low[0], i - 1), max(high[0], i + 2)
                low[1], high[1] = min(low[1], j - 1), max(high[1], j + 2)
    low, high = origin + low * cell_width, origin + high * cell_width
    for row in _rows_between(points, low, high, 0, len(points)):
        i = int(np.floor((points[row, 0] - origin[0]) / cell_width))
        j = int(np.floor((points[row, 1] - origin[1]) / cell_width))
        if 0 <= i < wanted.shape[0] and 0 <= j < wanted.shape[1] and wanted[i, j]:
            if used == len(found):
                found = _longer(found, 2 * used)
            found[used] = row
            used += 1
    return found[:used]


@njit(cache=True, nogil=True)
def rows_of_cells(wanted: BoolArray, start: IntArray, order: IntArray) -> IntArray:
    """Rows of the points in the `wanted` cells, sorted, of points that are in `order` by cell."""
    found = np.zeros(len(order), np.bool_)
    for c in range(len(wanted)):
        for i in range(start[c], start[c + 1] if wanted[c] else 0):
            found[order[i]] = True
    return np.flatnonzero(found)


def rows_by_cell(wanted: BoolArray, start: IntArray) -> IntArray:
    """Rows of the points in the `wanted` cells, shape (nx, ny), of points by cell, where each begins at its `start`."""
    cells = np.flatnonzero(wanted)
    count = start[cells + 1] - start[cells]
    before = np.concatenate([[0], np.cumsum(count)])
    return np.repeat(start[cells] - before[:-1], count) + np.arange(before[-1])


def rows_in_box(points: FloatArray, low: FloatArray, high: FloatArray) -> IntArray:
    """Rows of the points (n, 3) between `low` and `high` in plan, shape (2,); sorted."""
    begin = range(0, max(len(points), 1), _SHARE)
    return np.concatenate(run_parallel(lambda row: _rows_between(points, low, high, row, row + _SHARE), begin))


_SHARE = 1 << 17
"""Rows that a core looks through at once: 3 MB, which takes as long as five wake-ups."""


@njit(cache=True, nogil=True)
def _rows_between(points: FloatArray, low: FloatArray, high: FloatArray, first: int, last: int) -> IntArray:
    found, used, last = np.empty(2 * _BLOCK, np.int64), 0, min(last, len(points))
    left, right, near, far = low[0], high[0], low[1], high[1]
    for begin in range(first, last, _BLOCK):
        if used + _BLOCK > len(found):
            found = _longer(found, 2 * len(found))
        for row in range(begin, min(begin + _BLOCK, last)):  # no branch: half of all would be guessed wrong
            x, y = points[row, 0], points[row, 1]
            found[used] = row
            used += int((x >= left) & (x <= right) & (y >= near) & (y <= far))
    return found[:used].copy()


_NO_POINTS: FloatArray = np.zeros((0, 3))
_BLOCK = 4096
"""Rows for which room is made at once: what is found is few, and memory that nobody touches costs nothing."""


@njit(cache=True, nogil=True)
def taken(points: FloatArray, rows: IntArray) -> FloatArray:
    """The points (n, d) in these rows, three times as fast as by NumPy."""
    made = np.empty((len(rows), points.shape[1]))
    for i in range(len(rows)):
        for k in range(points.shape[1]):
            made[i, k] = points[rows[i], k]
    return made


def chosen_rows(points: FloatArray, chosen: BoolArray, fresh: FloatArray = _NO_POINTS) -> FloatArray:
    """The points (n, 3) that are `chosen`, and the `fresh` ones (k, 3) after them, four times as fast as by NumPy."""
    count = np.count_nonzero(chosen)
    made = np.empty((count + len(fresh) + 1, 3))  # by NumPy, which asks for large pages: a quarter of the time
    _keep_rows(points, chosen, made)
    made[count:-1] = fresh
    return made[:-1]


@njit(cache=True, nogil=True)
def _keep_rows(points: FloatArray, keep: BoolArray, made: FloatArray) -> None:
    used = 0
    for i in range(len(points)):
        for k in range(3):  # written, and kept or not: a guess would be wrong
            made[used, k] = points[i, k]
        used += keep[i]


@njit(cache=True, nogil=True)
def extent_in(cell: IntArray, z: FloatArray, low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest z of the points in each cell that are over its `low` and not over its `high`; inf, −inf.

    Points of the cell after the last one are in none.
    """
    least, most = np.full(len(low), np.inf), np.full(len(low), -np.inf)
    for i in range(len(cell)):
        c = cell[i]
        if c < len(low) and low[c] < z[i] <= high[c]:
            least[c], most[c] = min(least[c], z[i]), max(most[c], z[i])
    return least, most


@njit(cache=True, nogil=True)
def between_range(
    cell: IntArray,
    z: FloatArray,
    low: NDArray[np.floating],
    high: NDArray[np.floating],
    begin: int,
    end: int,
    found: BoolArray,
) -> None:
    """Write which points from `begin` to `end` are over the `low` of their cell and not over its `high`.

    Points of the cell after the last one are in none.
    """
    for i in range(begin, end):
        c = cell[i]
        found[i] = c < len(low) and low[c] < z[i] <= high[c]


@njit(cache=True, nogil=True)
def bounds_of(points: FloatArray, chosen: BoolArray | None = None) -> tuple[FloatArray, FloatArray]:
    """Least and greatest (x, y) [m] of points (n, 3), of the `chosen` ones where they are given."""
    left, right, near, far = np.inf, -np.inf, np.inf, -np.inf
    for row in range(len(points)):
        if chosen is not None and not chosen[row]:
            continue
        x, y = points[row, 0], points[row, 1]
        left, right, near, far = min(left, x), max(right, x), min(near, y), max(far, y)
    return np.array([left, near]), np.array([right, far])


@njit(cache=True, nogil=True)
def extent_of(points: FloatArray) -> tuple[float, float]:
    """How wide points (n, 3) are in x or y, and the largest of all coordinates, inf if any is not finite."""
    low, high, most = np.full(3, np.inf), np.full(3, -np.inf), 0.0
    for row in range(len(points)):
        for k in range(3):
            value = points[row, k]
            low[k], high[k] = min(low[k], value), max(high[k], value)
            most = max(most, abs(value)) if np.isfinite(value) else np.inf
    return max(high[0] - low[0], high[1] - low[1]), most


def cells_of(points: FloatArray, origin: FloatArray, width: float, shape: tuple[int, int]) -> IntArray:
    """Flat cell of each point (n, 3), which must lie on the grid, shape (n,)."""
    cell = np.empty(len(points), np.int64)
    run_chunked(lambda a, b: _cells_range(points, origin, width, shape[1], a, b, cell), len(points))
    return cell


@njit(cache=True, nogil=True)
def _cells_range(
    points: FloatArray, origin: FloatArray, width: float, ny: int, begin: int, end: int, cell: IntArray
) -> None:
    for i in range(begin, end):
        x, y = np.floor((points[i, 0] - origin[0]) / width), np.floor((points[i, 1] - origin[1]) / width)
        cell[i] = int(x) * ny + int(y)


def cells_in_box(points: FloatArray, origin: FloatArray, width: float, first: IntArray, last: IntArray) -> IntArray:
    """Flat cell of each point (n, 3) in a box of cells, from `first` to `last`; those outside are in one more."""
    cell = np.empty(len(points), np.int64)
    run_chunked(lambda a, b: _box_range(points, origin, width, first, last, a, b, cell), len(points))
    return cell


@njit(cache=True, nogil=True)
def _box_range(
    points: FloatArray,
    origin: FloatArray,
    width: float,
    first: IntArray,
    last: IntArray,
    begin: int,
    end: int,
    cell: IntArray,
) -> None:
    wide = last[1] - first[1]
    for i in range(begin, end):
        x, y = int(np.floor((points[i, 0] - origin[0]) / width)), int(np.floor((points[i, 1] - origin[1]) / width))
        inside = first[0] <= x < last[0] and first[1] <= y < last[1]
        cell[i] = (x - first[0]) * wide + y - first[1] if inside else (last[0] - first[0]) * wide


def column_floors(start: IntArray, order: IntArray, z: FloatArray, share: float) -> FloatArray:
    """Height under which a `share` of the points of each column lies [m], shape (cells,); NaN in an empty one."""
    floor = np.full(len(start) - 1, np.nan)
    run_chunked(lambda a, b: _floors_range(start, order, z, share, a, b, floor), len(floor))
    return floor


@njit(cache=True, nogil=True)
def _floors_range(
    start: IntArray, order: IntArray, z: FloatArray, share: float, begin: int, end: int, floor: FloatArray
) -> None:
    for c in range(begin, end):
        count = start[c + 1] - start[c]
        if count > 0:
            at = int(share * count)
            floor[c] = np.partition(z[order[start[c] : start[c + 1]]], at)[at]


@njit(cache=True, nogil=True)
def kth_beside(
    points: FloatArray,
    columns: tuple[IntArray, IntArray],
    grid: tuple[FloatArray, float, tuple[int, int]],
    picked: IntArray,
    k: int,
    begin: int,
    end: int,
    distance: FloatArray,
) -> None:
    """Distance of each `picked` row to its `k`-th neighbour in its column and those around [m].

    What is no further than a column is wide is exact, for all columns are looked at that may hold a nearer one.

    Args:
        points: Shape (n, 3) [m].
        columns: Where each column begins, and the rows in that order.
        grid: Lower corner [m], width [m] and shape of the columns.
        picked: Rows, shape (m,).
        k: Which neighbour.
        begin: First of the picked ones to look at.
        end: Behind the last.
        distance: Where it is written, shape (m,).
    """
    (start, order), (corner, width, shape), near = columns, grid, np.empty(k + 1)
    for i in range(begin, end):
        row = picked[i]
        at_x, at_y = (points[row, 0] - corner[0]) / width, (points[row, 1] - corner[1]) / width
        x, y = int(np.floor(at_x)), int(np.floor(at_y))
        near[:] = np.inf
        for dx, dy in _OWN_FIRST:
            u, v = x + dx, y + dy
            if not (0 <= u < shape[0] and 0 <= v < shape[1]):
                continue
            off = max(u - at_x, at_x - u - 1.0, 0.0) ** 2 + max(v - at_y, at_y - v - 1.0, 0.0) ** 2
            if off * width**2 >= near[k]:
                continue
            for e in range(start[u * shape[1] + v], start[u * shape[1] + v + 1]):
                other, square = order[e], 0.0
                for axis in range(3):
                    square += (points[other, axis] - points[row, axis]) ** 2
                at = k
                if square >= near[at]:
                    continue
                while at > 0 and near[at - 1] > square:
                    near[at] = near[at - 1]
                    at -= 1
                near[at] = square
        distance[i] = np.sqrt(near[k])


_OWN_FIRST = ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1), (-1, -1), (-1, 1), (1, -1), (1, 1))
"""A column and those around it, the one that likely holds the nearest neighbours first: most others are passed over."""


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
    keys: IntArray, ends: FloatArray, points: FloatArray, asked: IntArray, stride: int, reach: float, least: FloatArray
) -> FloatArray:
    """Least height of the `ends` that are within `reach` of each point in plan and no lower than its `least` [m].

    Args:
        keys: Cell of each of the ends, ascending, shape (e,).
        ends: Points (e, 3) [m].
        points: Shape (m, 3) [m].
        asked: Cell of each point, shape (m,); two cells to all sides of it are looked at.
        stride: Cells of a row of the grid.
        reach: [m].
        least: [m], shape (m,).
    """
    best = np.full(len(points), np.inf)
    for i in range(len(points)):
        for step in range(-2, 3):
            first = asked[i] + step * stride - 2
            for e in range(np.searchsorted(keys, first), len(keys)):
                if keys[e] > first + 4:
                    break
                near = np.hypot(ends[e, 0] - points[i, 0], ends[e, 1] - points[i, 1]) <= reach
                if near and least[i] <= ends[e, 2] < best[i]:
                    best[i] = ends[e, 2]
    return best

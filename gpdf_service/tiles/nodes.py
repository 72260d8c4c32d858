"""Compiled loops over the nodes of layered columns, their neighbours, and the pairs that join them."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gpdf_service.tiles.pairs import AROUND, FAR, Columns
from gpdf_service.tiles.rows import INDEX
from gpdf_service.types import BoolArray, ByteArray, FloatArray, IntArray


@njit(cache=True, nogil=True)
def unite(parent: IntArray, i: int, j: int) -> None:
    """Make one tree of those of i and j (Rem): who climbs, from the higher parent, gets the other's lower one."""
    p, q = parent[i], parent[j]
    while p != q:
        if p < q:
            i, j, p, q = j, i, q, p
        parent[i] = q
        if i == p:
            return
        i, p = p, parent[p]


@njit(cache=True, nogil=True)
def components(a: IntArray, b: IntArray, among: BoolArray) -> IntArray:
    """Connected component of each node, shape (k,), numbered by their first nodes.

    The pairs (a, b) of which both are `among` join them; any other node is one by itself.
    """
    count = len(among)
    parent = np.arange(count).astype(INDEX)
    for e in range(len(a)):
        i, j = a[e], b[e]
        if not (among[i] and among[j]):
            continue
        unite(parent, i, j)
    return numbered(parent)


@njit(cache=True, nogil=True)
def numbered(parent: IntArray) -> IntArray:
    """Number of each node's tree, by their first nodes: a parent comes before its children."""
    label, used = np.empty(len(parent), np.int64), 0
    for i in range(len(parent)):
        if parent[i] == i:
            label[i] = used
            used += 1
        else:
            label[i] = label[parent[i]]
    return label


@njit(cache=True, nogil=True)
def degrees(columns: Columns, keep: BoolArray, rise: float) -> ByteArray:
    """How many nodes to keep are beside each of them with at most `rise` [m] a cell between them, shape (k,)."""
    cell, start, (nx, ny), height, _ = columns
    degree = np.zeros(len(cell), np.uint8)
    for i in np.flatnonzero(keep):
        x, y = divmod(cell[i], ny)
        for dx, dy in AROUND[4:]:  # half of them: each pair once
            if x + dx < nx and 0 <= y + dy < ny:
                there, most = (x + dx) * ny + y + dy, rise * np.hypot(dx, dy)
                for j in range(start[there], start[there + 1]):
                    near = np.uint8(keep[j] & (abs(height[i] - height[j]) <= most))
                    degree[i] += near
                    degree[j] += near
    return degree


@njit(cache=True, nogil=True)
def mark_nearest(a: IntArray, b: IntArray, mark: NDArray[np.int8]) -> None:
    """Give each node marked 0 the mark of the one over 0 that the fewest pairs (a, b) join it to; -1 joins nothing."""
    start = np.zeros(len(mark) + 1, np.int64)
    for e in range(len(a)):
        if mark[a[e]] >= 0 and mark[b[e]] >= 0:
            start[a[e] + 1] += 1
            start[b[e] + 1] += 1
    start = np.cumsum(start)
    place, other = start[:-1].copy(), np.empty(start[-1], INDEX)
    for e in range(len(a)):
        i, j = a[e], b[e]
        if mark[i] >= 0 and mark[j] >= 0:
            other[place[i]], other[place[j]] = j, i
            place[i] += 1
            place[j] += 1
    ring = np.flatnonzero(mark > 0)
    while len(ring):
        found = [0 for _ in range(0)]
        for i in ring:
            for e in range(start[i], start[i + 1]):
                if mark[other[e]] == 0:
                    mark[other[e]] = mark[i]
                    found.append(other[e])
        ring = np.array(found, np.int64)


@njit(cache=True, nogil=True)
def plan_sums(cell: IntArray, ny: int, among: BoolArray, label: IntArray, labels: int) -> FloatArray:
    """Sums of 1, x, y, x², y², xy of the cells of the nodes `among` all with each label, shape (labels, 6).

    They are whole numbers, so it is the same in which order they are added.
    """
    sums = np.zeros((labels, 6))
    for i in range(len(cell)):
        if among[i]:
            x, y, own = float(cell[i] // ny), float(cell[i] % ny), sums[label[i]]
            own[0] += 1.0
            own[1] += x
            own[2] += y
            own[3] += x * x
            own[4] += y * y
            own[5] += x * y
    return sums


def extents_of(sums: FloatArray, width: float) -> tuple[FloatArray, FloatArray]:
    """Length and depth of what the nodes with each label cover, along their principal axes [m], by their `plan_sums`.

    A uniform strip of length L has variance L²/12; a cell more, because cells have a `width` [m]. What no node has
    covers nothing.
    """
    count = sums[:, 0]
    x, y, xx, yy, xy = sums[:, 1:].T / np.maximum(count, 1.0)
    xx, yy, xy = xx - x**2, yy - y**2, xy - x * y
    middle, radius = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    length = np.where(count > 0.0, (np.sqrt(12.0 * (middle + radius)) + 1.0) * width, 0.0)
    return length, np.where(count > 0.0, (np.sqrt(12.0 * np.maximum(middle - radius, 0.0)) + 1.0) * width, 0.0)


@njit(cache=True, nogil=True)
def mean_gradients(height: FloatArray, cell: IntArray, ny: int, a: IntArray, b: IntArray) -> FloatArray:
    """Length of the mean rise [m a cell] of each node and of those that the pairs (a, b) join it to, shape (k,)."""
    count = len(height)
    own, sides = np.zeros((count, 2)), np.zeros((count, 2))
    for e in range(len(a)):
        i, j = a[e], b[e]
        if cell[j] - cell[i] != ny and cell[j] - cell[i] != 1:  # beside each other across a corner
            continue
        axis, up = int(cell[j] - cell[i] == 1), height[j] - height[i]
        for node in (i, j):
            own[node, axis] += up
            sides[node, axis] += 1.0
    own /= np.maximum(sides, 1.0)
    total, around = own.copy(), np.ones(count)
    for e in range(len(a)):
        for i, j in ((a[e], b[e]), (b[e], a[e])):
            total[i, 0] += own[j, 0]
            total[i, 1] += own[j, 1]
            around[i] += 1.0
    return np.sqrt(total[:, 0] ** 2 + total[:, 1] ** 2) / around


@njit(cache=True, nogil=True)
def half_way(height: FloatArray, a: IntArray, b: IntArray) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest of each node's height [m] and the means with the nodes that the pairs (a, b) join to it."""
    low, high = height.copy(), height.copy()
    for e in range(len(a)):
        i, j = a[e], b[e]
        middle = 0.5 * (height[i] + height[j])
        low[i], low[j] = min(low[i], middle), min(low[j], middle)
        high[i], high[j] = max(high[i], middle), max(high[j], middle)
    return low, high


@njit(cache=True, nogil=True)
def lowest_beside(columns: Columns, ground: BoolArray, smooth: FloatArray, slack: FloatArray) -> FloatArray:
    """Least `smooth` height of `ground` in the cells around each node within `slack` of its height; inf if none."""
    cell, start, (nx, ny), height, _ = columns
    beside = np.full(len(height), np.inf)
    for j in np.flatnonzero(ground):
        x, y = divmod(cell[j], ny)
        for u in range(max(x - 1, 0), min(x + 2, nx)):
            for i in range(start[u * ny + max(y - 1, 0)], start[u * ny + min(y + 2, ny)]):
                if abs(smooth[j] - height[i]) <= slack[i] and cell[i] != cell[j]:
                    beside[i] = min(beside[i], smooth[j])
    return beside


@njit(cache=True, nogil=True)
def drops_beside(nodes: IntArray, columns: Columns, rise: float, max_step: float) -> BoolArray:
    """Which `nodes` have a direction in which nothing goes on within `rise` and something is over `max_step` lower."""
    cell, start, shape, height, thickness = columns
    drops = np.zeros(len(cell), np.bool_)
    for i in nodes:
        x, y = divmod(cell[i], shape[1])
        for dx, dy in AROUND:
            if not (0 <= x + dx < shape[0] and 0 <= y + dy < shape[1]):
                continue
            there, level, down = (x + dx) * shape[1] + y + dy, False, False
            for j in range(start[there], start[there + 1]):
                over = height[i] - height[j]
                level |= abs(over) <= rise * np.hypot(dx, dy)
                down |= over + thickness[j] > max_step and over > -max_step
            drops[i] |= down and not level
    return drops


@njit(cache=True, nogil=True)
def nodes_over(nodes: IntArray, cell: IntArray, height: FloatArray, keep: BoolArray, headroom: float) -> BoolArray:
    """Which of the `nodes` have a kept node next below them in their cell at `headroom` or less, shape (m,).

    Nodes are sorted by cell and upward.
    """
    over = np.zeros(len(nodes), np.bool_)
    for k in range(len(nodes)):
        i = nodes[k]
        below = i - 1
        while below >= 0 and cell[below] == cell[i] and not keep[below]:
            below -= 1
        over[k] = below >= 0 and cell[below] == cell[i] and height[i] - height[below] <= headroom
    return over


@njit(cache=True, nogil=True)
def rises_beside(nodes: IntArray, columns: Columns, top: FloatArray, step: float) -> BoolArray:
    """Over which of the `nodes` something rises by more than a `step`, in their cells or the eight around, (m,)."""
    cell, start, (nx, ny), height, _ = columns
    rises = np.zeros(len(nodes), np.bool_)
    for k in range(len(nodes)):
        x, y = divmod(cell[nodes[k]], ny)
        least = height[nodes[k]] + step
        for u in range(max(x - 1, 0), min(x + 2, nx)):
            for other in range(start[u * ny + max(y - 1, 0)], start[u * ny + min(y + 2, ny)]):
                rises[k] |= top[other] > least
    return rises


@njit(cache=True, nogil=True)
def grown_sheet(
    columns: Columns, keep: BoolArray, sheet: BoolArray, beside: IntArray, max_step: float, rings: int
) -> BoolArray:
    """A `sheet`, and around it `rings` of kept nodes in cells that hold none yet, each within a step of the last ring.

    In each cell the lowest node that can be reached is taken; of the first ring these are among the nodes `beside`.
    """
    cell, start, (nx, ny), height, _ = columns
    inside, used = sheet.copy(), np.zeros(nx * ny, np.bool_)
    for i in range(len(cell)):
        used[cell[i]] |= sheet[i]
    found = beside.astype(np.int64)
    for k in range(rings):
        ring, count = np.sort(found), 0
        for node in ring:
            if not used[cell[node]]:
                used[cell[node]], inside[node] = True, True
                ring[count] = node
                count += 1
        found, more = np.empty(8 * count, np.int64), 0
        for i in ring[: count if k + 1 < rings else 0]:
            x, y = divmod(cell[i], ny)
            for u in range(max(x - 1, 0), min(x + 2, nx)):
                for j in range(start[u * ny + max(y - 1, 0)], start[u * ny + min(y + 2, ny)]):
                    lowest = more == 0 or cell[found[more - 1]] != cell[j]
                    if keep[j] and lowest and not used[cell[j]] and abs(height[i] - height[j]) <= max_step:
                        found[more] = j
                        more += 1
        found = found[:more]
    return inside


@njit(cache=True, nogil=True)
def ends_at(columns: Columns, inside: BoolArray, beyond: BoolArray, max_step: float) -> BoolArray:
    """At which nodes `inside` a sheet it ends: one is `beyond` it a step beside, (k,).

    There is no end where the sheet has another node in that cell that is a step away, too.
    """
    cell, start, (nx, ny), height, _ = columns
    end = np.zeros(len(cell), np.bool_)
    for i in np.flatnonzero(inside):
        x, y = divmod(cell[i], ny)
        for u in range(max(x - 1, 0), min(x + 2, nx)):
            for there in range(u * ny + max(y - 1, 0), u * ny + min(y + 2, ny)):
                some, had = False, False
                for j in range(start[there], start[there + 1] if there != cell[i] else start[there]):
                    near = abs(height[i] - height[j]) <= max_step
                    some |= near & beyond[j]
                    had |= near & inside[j]
                end[i] |= some and not had
    return end


@njit(cache=True, nogil=True)
def whole_around(columns: Columns, inside: BoolArray, end: BoolArray, max_step: float, rings: int) -> BoolArray:
    """Which nodes `inside` a sheet have no `end` of it within `rings` of them."""
    cell, start, (nx, ny), height, _ = columns
    end = end.copy()
    ring = np.flatnonzero(end)
    for _ in range(rings):
        found, count = np.empty(len(ring) * 8, np.int64), 0
        for i in ring:
            x, y = divmod(cell[i], ny)
            for u in range(max(x - 1, 0), min(x + 2, nx)):
                for j in range(start[u * ny + max(y - 1, 0)], start[u * ny + min(y + 2, ny)]):
                    if inside[j] and not end[j] and abs(height[i] - height[j]) <= max_step:
                        end[j] = True
                        found[count] = j
                        count += 1
        ring = found[:count].copy()
    return inside & ~end


@njit(cache=True, nogil=True)
def held_by(
    points: FloatArray,
    node: IntArray,
    first: int,
    ground: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    held: BoolArray,
) -> None:
    """Whether points in the nodes `node` are within `scatter` of the ground there, or `beside` [m], in height.

    The ground is told from node number `first` on.
    """
    low, high, beside, scatter = ground
    for i in range(len(node)):
        n, z = node[i] - first, points[i, 2]
        near = scatter[n]
        held[i] = low[n] - near <= z <= high[n] + near or abs(z - beside[n]) <= near


@njit(cache=True, nogil=True)
def off_ground(points: FloatArray, node: IntArray, ground: BoolArray, smooth: FloatArray) -> FloatArray:
    """How far the points in those of the nodes `node` that are `ground` are off its height [m]."""
    found, used = np.empty(len(node)), 0
    for i in range(len(node)):
        found[used] = abs(points[i, 2] - smooth[node[i]])
        used += int(ground[node[i]])
    return found[:used]


@njit(cache=True, nogil=True)
def count_labels(label: IntArray, among: BoolArray, labels: int) -> IntArray:
    """How many nodes `among` all have each label, shape (labels,)."""
    made = np.zeros(labels, np.int64)
    for i in range(len(label)):
        made[label[i]] += among[i]
    return made


@njit(cache=True, nogil=True)
def pieces_of(columns: Columns, inner: BoolArray, rise: float, step: float) -> tuple[IntArray, IntArray]:
    """Which `inner` nodes are joined where there is at most `rise` [m] a cell and a `step` [m] between them.

    Labels, numbered by first nodes, shape (k,), and these nodes, shape (labels,); any other node's label is the next.
    """
    cell, start, (nx, ny), height, _ = columns
    root, label, used = np.arange(len(cell)).astype(INDEX), np.empty(len(cell), INDEX), 0
    for i in range(len(cell)):
        if not inner[i]:
            continue
        x, y = divmod(cell[i], ny)
        for k in range(4, 8):  # half of those around: each pair once
            u, v = x + AROUND[k][0], y + AROUND[k][1]
            if u < nx and 0 <= v < ny:
                most = rise * FAR[k] + step
                for j in range(start[u * ny + v], start[u * ny + v + 1]):
                    if inner[j] and abs(height[i] - height[j]) <= most:
                        unite(root, i, j)
    for i in range(len(cell)):
        if inner[i]:
            label[i] = used if root[i] == i else label[root[i]]
            used += int(root[i] == i)
    begin = np.empty(used, INDEX)
    for i in range(len(cell)):
        if not inner[i]:
            label[i] = used
        elif root[i] == i:
            begin[label[i]] = i
    return label, begin


@njit(cache=True, nogil=True)
def pairs_on(
    columns: Columns,
    row: int,
    ends: tuple[NDArray[np.int32], NDArray[np.int32]],
    begin: tuple[int, int],
    none: tuple[int, int],
    rise: float,
    step: float,
) -> IntArray:
    """Pairs of labels that are joined, see `pieces_of`, from a row of cells to the next one, shape (p, 2).

    Args:
        columns: All nodes.
        row: Of cells.
        ends: Labels of the nodes of a strip that ends with the row, and of the strip behind it.
        begin: First node of each.
        none: Labels of nodes that nothing is joined to.
        rise: At most [m a cell].
        step: And as much more at most [m].
    """
    _, start, (_, ny), height, _ = columns
    found, last = [(0, 0) for _ in range(0)], np.full(none[0], -1)
    for y in range(ny):
        for i in range(start[row * ny + y], start[row * ny + y + 1]):
            a = ends[0][i - begin[0]]
            if a == none[0]:
                continue
            for v in range(max(y - 1, 0), min(y + 2, ny)):
                there, most = (row + 1) * ny + v, rise * np.hypot(1, v - y) + step
                for j in range(start[there], start[there + 1]):
                    b = ends[1][j - begin[1]]
                    if b != none[1] and b != last[a] and abs(height[i] - height[j]) <= most:
                        found.append((int(a), int(b)))
                        last[a] = b
    made = np.empty((len(found), 2), np.int64)
    for k in range(len(found)):
        made[k, 0], made[k, 1] = found[k]
    return made


@njit(cache=True, nogil=True)
def joined_to(columns: Columns, among: BoolArray, others: BoolArray, rise: float, step: float = 0.0) -> BoolArray:
    """Which nodes `among` all are joined to one of the `others` beside them, see `pieces_of`, shape (k,)."""
    cell, start, (nx, ny), height, _ = columns
    found = np.zeros(len(cell), np.bool_)
    for j in range(len(cell)):
        if not others[j]:
            continue
        x, y = cell[j] // ny, cell[j] % ny
        for k in range(8):
            u, v = x + AROUND[k][0], y + AROUND[k][1]
            if 0 <= u < nx and 0 <= v < ny:
                there, most = u * ny + v, rise * FAR[k] + step
                for i in range(start[there], start[there + 1]):
                    found[i] |= among[i] and abs(height[i] - height[j]) <= most
    return found


@njit(cache=True, nogil=True)
def attach(
    cell: IntArray,
    shape: tuple[int, int],
    pairs: tuple[IntArray, IntArray],
    pieces: tuple[IntArray, IntArray, IntArray],
    sheet: int,
    sheet_of: IntArray,
) -> None:
    """Write into `sheet_of` each node's, (k,), what a `sheet` gets: pieces beside it that do not lie over it.

    One after another, as long as any is found.

    Args:
        cell: Of each node.
        shape: Of the grid.
        pairs: Nodes that are beside each other.
        pieces: Piece of each node, where each one's begin among the nodes in order, and these.
        sheet: Number of the sheet.
        sheet_of: That of each node, -1 where it has none yet.
    """
    piece, start, members = pieces
    taken, beside = np.zeros(shape[0] * shape[1], np.bool_), np.ones(1, np.int64)
    taken[cell[sheet_of == sheet]] = True
    while len(beside):
        near, grown = np.zeros(len(start), np.bool_), False
        for k in range(len(pairs[0])):
            for i, j in ((pairs[0][k], pairs[1][k]), (pairs[1][k], pairs[0][k])):
                near[piece[i]] |= sheet_of[i] < 0 and sheet_of[j] == sheet
        beside = np.flatnonzero(near)
        for p in beside:
            own = members[start[p] : start[p + 1]]
            own = own[sheet_of[own] < 0]
            cells = cell[own]  # ascending, as nodes are
            if not taken[cells].any() and (np.diff(cells) > 0).all():
                sheet_of[own], taken[cells], grown = sheet, True, True
        if not grown:
            return

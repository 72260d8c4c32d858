"""Compiled loops over the nodes of layered columns, their neighbours, and the pairs that join them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gpdf_service.perception.pairs import AROUND, Columns
from gpdf_service.perception.rows import INDEX
from gpdf_service.types import BoolArray, FloatArray, IntArray


@njit(cache=True, nogil=True)
def _unite(parent: IntArray, i: int, j: int) -> None:
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
        _unite(parent, i, j)
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
def numbered_among(label: IntArray, among: BoolArray) -> tuple[IntArray, int]:
    """The labels that nodes `among` all have, numbered in their order, and how many; any other node has this number."""
    number, used = np.zeros(len(label) + 1, np.int64), 0
    for i in range(len(label)):
        if among[i]:
            number[label[i]] = 1
    for k in range(len(number)):
        if number[k] > 0:
            number[k], used = used, used + 1
    made = np.full(len(label), used)
    for i in range(len(label)):
        if among[i]:
            made[i] = number[label[i]]
    return made, used


@njit(cache=True, nogil=True)
def counts_of(label: IntArray, true: BoolArray, among: BoolArray, labels: int) -> tuple[IntArray, IntArray]:
    """Of how many nodes `among` all with each label it is `true`, and how many there are, each of shape (labels,)."""
    held, all_ = np.zeros(labels, np.int64), np.zeros(labels, np.int64)
    for i in range(len(label)):
        if among[i]:
            all_[label[i]] += 1
            held[label[i]] += true[i]
    return held, all_


@njit(cache=True, nogil=True)
def sizes_and_means(label: IntArray, among: BoolArray, height: FloatArray, labels: int) -> tuple[IntArray, FloatArray]:
    """How many nodes `among` all have each label, and the mean height of all that have it [m], 0 of none, (labels,)."""
    size, count, total = np.zeros(labels, np.int64), np.zeros(labels, np.int64), np.zeros(labels)
    for i in range(len(label)):
        size[label[i]] += among[i]
        count[label[i]] += 1
        total[label[i]] += height[i]
    return size, total / np.maximum(count, 1)


@njit(cache=True, nogil=True)
def touched_by(a: IntArray, b: IntArray, among: BoolArray, others: BoolArray) -> BoolArray:
    """Which nodes, of those `among` all, a pair (a, b) joins to one of the `others`, shape (k,)."""
    found = np.zeros(len(among), np.bool_)
    for e in range(len(a)):
        i, j = a[e], b[e]
        found[i] |= among[i] and others[j]
        found[j] |= among[j] and others[i]
    return found


@njit(cache=True, nogil=True)
def carry(values: NDArray[Any], kept: IntArray, nothing: Any, made: NDArray[Any]) -> None:  # noqa: ANN401
    """Write the `values` of the nodes that are `kept`, see `Former`, and `nothing` for the others."""
    last = 0
    for begin, before, count in kept:
        made[last:begin], last = nothing, begin + count
        made[begin:last] = values[before : before + count]
    made[last:] = nothing


@njit(cache=True, nogil=True)
def mark_unlike(now: NDArray[Any], was: NDArray[Any], kept: IntArray, cell: IntArray, cells: BoolArray) -> None:
    """Mark the cells of nodes that are `kept`, see `Former`, with another value now."""
    for begin, before, count in kept:
        one, other = now[begin : begin + count], was[before : before + count]
        for i in range(count):
            if one[i] != other[i]:
                cells[cell[begin + i]] = True


@njit(cache=True, nogil=True)
def put_in(parent: IntArray, part: IntArray, begin: int) -> None:
    """Write the trees of some nodes, which are numbered from the first of them, `begin`, into those of all."""
    for i in range(len(part)):
        parent[begin + i] = begin + part[i]


@njit(cache=True, nogil=True)
def unite_all(parent: IntArray, a: IntArray, b: IntArray, begin: int) -> None:
    """Make one tree each of those that the pairs (a, b) join; nodes are numbered from `begin`."""
    for e in range(len(a)):
        _unite(parent, begin + a[e], begin + b[e])


@njit(cache=True, nogil=True)
def pieces_in(
    a: IntArray,
    b: IntArray,
    first: IntArray,
    height: FloatArray,
    count: int,
    apart: FloatArray,
    kind: NDArray[np.uint8],
    rise: float,
    step: float,
) -> tuple[IntArray, IntArray, IntArray, IntArray, IntArray, IntArray, IntArray, IntArray, IntArray]:
    """What is joined in a strip, and the pairs that tell what else is; see `Beside.pieces`.

    Args:
        a: Its own node of each pair.
        b: The other one; from `count` on in the row behind the strip.
        first: Where the pairs of each offset begin.
        height: Of the nodes [m].
        count: How many of them are the strip's own.
        apart: Cells between the nodes of a pair with each offset.
        kind: Bits that tell whether a node is inner (1), and whether its slopes (2) and steps (4) are asked for.
        rise: Of slopes [m a cell].
        step: [m].

    Returns:
        First node of each own node's piece; inner pairs with the row behind; and twice, for slopes and steps, the pairs
        and where those of each offset begin.
    """
    root, size = np.arange(count).astype(INDEX), len(a) + 1
    across, behind, crossing = np.empty(size, INDEX), np.empty(size, INDEX), 0
    one, other, used, slopes = np.empty(size, INDEX), np.empty(size, INDEX), 0, np.zeros_like(first)
    for k in range(len(apart)):
        for e in range(first[k], first[k + 1]):
            i, j = a[e], b[e]
            both = int(kind[i] & kind[j]) * int(abs(height[i] - height[j]) <= rise * apart[k])
            one[used], other[used] = i, j
            used += int(both & 3 == 2)
            if both & 1 and j < count:
                _unite(root, i, j)
            elif both & 1:
                across[crossing], behind[crossing] = i, j
                crossing += 1
        slopes[k + 1] = used
    for i in range(count):  # a parent comes before its children
        root[i] = root[root[i]]
    left, right, found, steps = np.empty(size, INDEX), np.empty(size, INDEX), 0, np.zeros_like(first)
    for k in range(len(apart) if step > 0.0 else 0):
        for e in range(first[k], first[k + 1]):
            i, j = a[e], b[e]
            over, both = abs(height[i] - height[j]), kind[i] & kind[j]
            joined = root[i] == root[j] if j < count else both & 1 and over <= rise * apart[k]
            left[found], right[found] = i, j
            found += int(both & 4 > 0) * int(over <= step) * int(not joined)
        steps[k + 1] = found
    inner, sloped = (across[:crossing].copy(), behind[:crossing].copy()), (one[:used].copy(), other[:used].copy())
    return root, *inner, *sloped, slopes, left[:found].copy(), right[:found].copy(), steps


@njit(cache=True, nogil=True)
def degrees(columns: Columns, keep: BoolArray, rise: float) -> NDArray[np.uint8]:
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
def across_in(
    a: IntArray,
    b: IntArray,
    first: IntArray,
    height: FloatArray,
    count: int,
    apart: FloatArray,
    kind: NDArray[np.uint8],
    step: float,
) -> tuple[IntArray, IntArray]:
    """A strip's pairs of a node of one kind (1) and one of another (2) within a `step` [m]; see `pieces_in`."""
    one, other, used = np.empty(len(a) + 1, INDEX), np.empty(len(a) + 1, INDEX), 0
    for e in range(len(a)):
        i, j = a[e], b[e]
        turned = kind[i] == 2
        one[used], other[used] = (j, i) if turned else (i, j)
        used += int(kind[i] + kind[j] == 3) * int(abs(height[i] - height[j]) <= step)
    return one[:used].copy(), other[:used].copy()


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
def plan_sums(cell: IntArray, ny: int, among: BoolArray, label: IntArray) -> tuple[IntArray, FloatArray]:
    """Sums of 1, x, y, x², y², xy of the cells of the nodes `among` all with each label.

    Returns:
        The labels of these nodes, sorted, shape (labels,), and the sums, shape (labels, 6).
    """
    number, used = np.full(label.max() + 1, -1), 0
    for i in range(len(cell)):
        if among[i]:
            number[label[i]] = 0
    for k in range(len(number)):
        if number[k] == 0:
            number[k], used = used, used + 1
    sums = np.zeros((used, 6))
    for i in range(len(cell)):
        if among[i]:
            x, y, own = float(cell[i] // ny), float(cell[i] % ny), sums[number[label[i]]]
            own[0] += 1.0
            own[1] += x
            own[2] += y
            own[3] += x * x
            own[4] += y * y
            own[5] += x * y
    return np.flatnonzero(number >= 0), sums


def extents_in_plan(
    cell: IntArray, ny: int, among: BoolArray, label: IntArray, width: float
) -> tuple[FloatArray, FloatArray]:
    """Length and depth of what the nodes `among` all with each label cover, along their principal axes [m].

    A uniform strip of length L has variance L²/12; a cell more, because cells have a `width` [m]. What no node has
    covers nothing.
    """
    labels, sums = plan_sums(cell, ny, among, label)
    x, y, xx, yy, xy = sums[:, 1:].T / sums[:, 0]
    xx, yy, xy = xx - x**2, yy - y**2, xy - x * y
    middle, radius = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    length, depth = np.zeros((2, int(label.max()) + 1))
    length[labels] = (np.sqrt(12.0 * (middle + radius)) + 1.0) * width
    depth[labels] = (np.sqrt(12.0 * np.maximum(middle - radius, 0.0)) + 1.0) * width
    return length, depth


@njit(cache=True, nogil=True)
def with_rims(
    core: BoolArray, keep: BoolArray, piece: IntArray, a: IntArray, b: IntArray
) -> tuple[BoolArray, IntArray]:
    """The pieces of core nodes among those to `keep`, each patch with its rim: which nodes are in one, and in which.

    The rim are nodes to keep that a pair (a, b) joins to a core node. Patches are numbered by their first nodes; those
    that are in none have the number after the last.
    """
    wide, patch, used = core & keep, piece.copy(), 0
    for one, other in ((a, b), (b, a)):
        before = wide.copy()
        for e in range(len(one)):
            i, j = one[e], other[e]
            if not before[j] and keep[j] and core[i] and keep[i]:
                wide[j], patch[j] = True, patch[i]
    number = np.full(len(patch), -1)
    for i in range(len(patch)):
        if wide[i] and number[patch[i]] < 0:
            number[patch[i]], used = used, used + 1
    for i in range(len(patch)):
        patch[i] = number[patch[i]] if wide[i] else used
    return wide, patch


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
def over_kept(cell: IntArray, height: FloatArray, keep: BoolArray, headroom: float) -> BoolArray:
    """Which nodes have a kept node next below them in their cell at `headroom` or less [m], shape (k,).

    Nodes are sorted by cell and upward.
    """
    over, last = np.zeros(len(cell), np.bool_), -1
    for i in range(len(cell)):
        over[i] = last >= 0 and cell[last] == cell[i] and height[i] - height[last] <= headroom
        if keep[i]:
            last = i
    return over


@njit(cache=True, nogil=True)
def nodes_over(nodes: IntArray, cell: IntArray, height: FloatArray, keep: BoolArray, headroom: float) -> BoolArray:
    """Which of the `nodes` have a kept node next below them in their cell at `headroom` or less, shape (m,)."""
    over = np.zeros(len(nodes), np.bool_)
    for k in range(len(nodes)):
        i = nodes[k]
        below = i - 1
        while below >= 0 and cell[below] == cell[i] and not keep[below]:
            below -= 1
        over[k] = below >= 0 and cell[below] == cell[i] and height[i] - height[below] <= headroom
    return over


@njit(cache=True, nogil=True)
def rises_beside(
    nodes: IntArray,
    cell: IntArray,
    start: IntArray,
    shape: tuple[int, int],
    height: FloatArray,
    top: FloatArray,
    step: float,
) -> BoolArray:
    """Over which of the `nodes` something rises by more than a `step`, in their cells or the eight around, (m,)."""
    rises = np.zeros(len(nodes), np.bool_)
    for k in range(len(nodes)):
        x, y = divmod(cell[nodes[k]], shape[1])
        least = height[nodes[k]] + step
        for i in range(max(x - 1, 0), min(x + 2, shape[0])):
            first, last = max(y - 1, 0), min(y + 2, shape[1])
            for other in range(start[i * shape[1] + first], start[i * shape[1] + last]):
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
def whole_around(
    columns: Columns, inside: BoolArray, beyond: tuple[IntArray, IntArray], max_step: float, rings: int
) -> BoolArray:
    """Which nodes `inside` a sheet have no end of it within `rings` of them: a node `beyond` it a step beside.

    The pairs are nodes inside and beyond. There is no end where the sheet has another node in that cell that is a step
    away, too.
    """
    cell, start, (nx, ny), height, _ = columns
    end = np.zeros(len(cell), np.bool_)
    for e in range(len(beyond[0])):
        i, there, had = beyond[0][e], cell[beyond[1][e]], False
        for j in range(start[there], start[there + 1]):
            had |= inside[j] and abs(height[i] - height[j]) <= max_step
        end[i] |= not had
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
    points: FloatArray, node: IntArray, ground: tuple[FloatArray, FloatArray, FloatArray, FloatArray], held: BoolArray
) -> None:
    """Whether points in the nodes `node` are within `scatter` of the ground there, or `beside` [m], in height."""
    low, high, beside, scatter = ground
    for i in range(len(node)):
        n, z = node[i], points[i, 2]
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

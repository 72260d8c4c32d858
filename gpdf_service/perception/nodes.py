"""Compiled loops over the nodes of layered columns, their neighbours, and the pairs that join them."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gpdf_service.perception.columns import INDEX
from gpdf_service.types import BoolArray, FloatArray, IntArray

AROUND = ((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1))
"""The eight cells around one."""


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
    label, used = np.empty(count, np.int64), 0
    for i in range(count):  # a parent comes before its children
        if parent[i] == i:
            label[i] = used
            used += 1
        else:
            label[i] = label[parent[i]]
    return label


@njit(cache=True, nogil=True)
def joined_to(seeds: BoolArray, among: BoolArray, a: IntArray, b: IntArray) -> BoolArray:
    """The `seeds`, shape (k,), and the nodes `among` all that pairs (a, b) of both join to them, one after another.

    All seeds are one node, the first: so only pairs with an end that is no seed are looked at.
    """
    kind = seeds.astype(np.uint8)
    parent = np.arange(len(seeds) + 1).astype(INDEX)
    for i in range(len(seeds)):
        kind[i] += among[i] or seeds[i]
    for e in range(len(a)):
        one, other = kind[a[e]], kind[b[e]]
        if one == 0 or other == 0 or one + other == 4:
            continue
        i, j = a[e] + 1 if one == 1 else 0, b[e] + 1 if other == 1 else 0
        _unite(parent, i, j)
    made = seeds.copy()
    for i in range(len(seeds)):  # a parent comes before its children
        parent[i + 1] = parent[parent[i + 1]]
        made[i] |= parent[i + 1] == 0
    return made


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
def pairs_within(a: IntArray, b: IntArray, among: BoolArray, both: bool) -> tuple[IntArray, IntArray]:
    """The pairs of which `both`, or at least one, are `among` the nodes."""
    one, other, used = np.empty(len(a) + 1, INDEX), np.empty(len(a) + 1, INDEX), 0
    for e in range(len(a)):
        one[used], other[used] = a[e], b[e]
        used += int(among[a[e]] and among[b[e]] if both else among[a[e]] or among[b[e]])
    return one[:used].copy(), other[:used].copy()


@njit(cache=True, nogil=True)
def pairs_around(
    nodes: IntArray,
    cell: IntArray,
    start: IntArray,
    shape: tuple[int, int],
    height: FloatArray,
    keep: BoolArray,
    slope: float,
    step: float,
) -> tuple[IntArray, IntArray]:
    """Pairs of a row of `nodes` and a kept node in a cell around its own, within `slope` a cell and a `step` [m]."""
    one, other = [0 for _ in range(0)], [0 for _ in range(0)]
    for n in range(len(nodes)):
        i = nodes[n]
        x, y = cell[i] // shape[1], cell[i] % shape[1]
        for dx, dy in AROUND:
            if not (0 <= x + dx < shape[0] and 0 <= y + dy < shape[1]):
                continue
            there = (x + dx) * shape[1] + y + dy
            for j in range(start[there], start[there + 1]):
                if keep[j] and abs(height[i] - height[j]) <= slope * np.hypot(dx, dy) + step:
                    one.append(n)
                    other.append(j)
    return np.array(one, np.int64), np.array(other, np.int64)


@njit(cache=True, nogil=True)
def plan_sums(cell: IntArray, ny: int, among: BoolArray, label: IntArray, labels: int) -> FloatArray:
    """Sums of 1, x, y, x², y², xy of the cells of the nodes `among` all with each label, shape (labels, 6)."""
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


def extents_in_plan(
    cell: IntArray, ny: int, among: BoolArray, label: IntArray, width: float
) -> tuple[FloatArray, FloatArray]:
    """Length and depth of what the nodes `among` all with each label cover, along their principal axes [m].

    A uniform strip of length L has variance L²/12; a cell more, because cells have a `width` [m].
    """
    sums = plan_sums(cell, ny, among, label, int(label.max()) + 1)
    x, y, xx, yy, xy = sums[:, 1:].T / np.maximum(sums[:, 0], 1.0)
    xx, yy, xy = xx - x**2, yy - y**2, xy - x * y
    middle, radius = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    length = (np.sqrt(12.0 * (middle + radius)) + 1.0) * width
    depth = (np.sqrt(12.0 * np.maximum(middle - radius, 0.0)) + 1.0) * width
    return length, depth


@njit(cache=True, nogil=True)
def medians_of(height: FloatArray, start: IntArray, members: IntArray, asked: BoolArray) -> FloatArray:
    """Upper median of the heights of the members of each set that is `asked` for, NaN of the others."""
    made = np.full(len(asked), np.nan)
    for i in range(len(asked)):
        if asked[i]:
            count = start[i + 1] - start[i]
            made[i] = np.partition(height[members[start[i] : start[i + 1]]], count // 2)[count // 2]
    return made


@njit(cache=True, nogil=True)
def degrees(a: IntArray, b: IntArray, count: int) -> IntArray:
    """How many of the pairs (a, b) each of `count` nodes is in."""
    degree = np.zeros(count, np.int64)
    for e in range(len(a)):
        degree[a[e]] += 1
        degree[b[e]] += 1
    return degree


@njit(cache=True, nogil=True)
def add_rims(a: IntArray, b: IntArray, core: BoolArray, keep: BoolArray, wide: BoolArray, patch: IntArray) -> None:
    """Add to the `wide` nodes, and to their patches, those to `keep` that a pair (a, b) joins to a core node."""
    for one, other in ((a, b), (b, a)):
        before = wide.copy()
        for e in range(len(one)):
            i, j = one[e], other[e]
            if not before[j] and keep[j] and core[i] and keep[i]:
                wide[j], patch[j] = True, patch[i]


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
def stepped(reach: BoolArray, a: IntArray, b: IntArray) -> BoolArray:
    """`reach`, shape (k,), and the nodes that a pair (a, b) joins to it."""
    grown = reach.copy()
    for e in range(len(a)):
        grown[a[e]] |= reach[b[e]]
        grown[b[e]] |= reach[a[e]]
    return grown


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
def lowest_beside(
    start: IntArray,
    shape: tuple[int, int],
    ground: BoolArray,
    smooth: FloatArray,
    height: FloatArray,
    slack: FloatArray,
) -> FloatArray:
    """Least `smooth` height of `ground` in the cells around each node within `slack` of its `height`; inf if none."""
    beside = np.full(len(height), np.inf)
    for x in range(shape[0]):
        for y in range(shape[1]):
            for dx, dy in AROUND:
                if not (0 <= x + dx < shape[0] and 0 <= y + dy < shape[1]):
                    continue
                here, there = x * shape[1] + y, (x + dx) * shape[1] + y + dy
                for j in range(start[there], start[there + 1]):
                    for i in range(start[here], start[here + 1] if ground[j] else 0):
                        if abs(smooth[j] - height[i]) <= slack[i]:
                            beside[i] = min(beside[i], smooth[j])
    return beside


@njit(cache=True, nogil=True)
def drops_beside(
    nodes: IntArray,
    cell: IntArray,
    start: IntArray,
    shape: tuple[int, int],
    height: FloatArray,
    thickness: FloatArray,
    rise: float,
    max_step: float,
) -> BoolArray:
    """Which `nodes` have a direction in which nothing goes on within `rise` and something is over `max_step` lower."""
    drops = np.zeros(len(cell), np.bool_)
    for i in nodes:
        x, y = cell[i] // shape[1], cell[i] % shape[1]
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
def grown_sheet(
    cell: IntArray,
    start: IntArray,
    shape: tuple[int, int],
    height: FloatArray,
    keep: BoolArray,
    nodes: IntArray,
    max_step: float,
    rings: int,
) -> BoolArray:
    """`nodes`, and around them `rings` of kept nodes in cells that hold none yet, each within a step of the last ring.

    In each cell the lowest node that can be reached is taken.
    """
    inside, used = np.zeros(len(cell), np.bool_), np.zeros(shape[0] * shape[1], np.bool_)
    for i in nodes:
        inside[i] = True
        used[cell[i]] = True
    ring = nodes
    for _ in range(rings):
        found = np.full(len(ring) * 8, -1)
        count = 0
        for i in ring:
            for dx, dy in AROUND:
                x, y = cell[i] // shape[1] + dx, cell[i] % shape[1] + dy
                if not (0 <= x < shape[0] and 0 <= y < shape[1]) or used[x * shape[1] + y]:
                    continue
                for j in range(start[x * shape[1] + y], start[x * shape[1] + y + 1]):
                    if keep[j] and abs(height[i] - height[j]) <= max_step:
                        found[count] = j
                        count += 1
                        break
        taken = np.sort(found[:count])
        count = 0
        for node in taken:
            if not used[cell[node]]:
                used[cell[node]] = True
                inside[node] = True
                found[count] = node
                count += 1
        ring = found[:count].copy()
    return inside


@njit(cache=True, nogil=True)
def held_by(
    z: FloatArray,
    node: IntArray,
    low: FloatArray,
    high: FloatArray,
    beside: FloatArray,
    scatter: float,
    begin: int,
    end: int,
    held: BoolArray,
) -> None:
    """Whether points at heights `z` in the nodes `node` are within `scatter` of the ground there, or `beside` [m]."""
    for i in range(begin, end):
        n = node[i]
        held[i] = low[n] - scatter <= z[i] <= high[n] + scatter or abs(z[i] - beside[n]) <= scatter


@njit(cache=True, nogil=True)
def off_ground(z: FloatArray, node: IntArray, ground: BoolArray, smooth: FloatArray) -> FloatArray:
    """How far the points at heights `z` in those of the nodes `node` that are `ground` are off its height [m]."""
    found, used = np.empty(len(z)), 0
    for i in range(len(z)):
        found[used] = abs(z[i] - smooth[node[i]])
        used += int(ground[node[i]])
    return found[:used]

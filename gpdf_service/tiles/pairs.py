"""Compiled loops over pairs of nodes in cells beside each other."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gpdf_service.fields.tree import longer
from gpdf_service.kernel_cache import lean
from gpdf_service.tiles.rows import INDEX
from gpdf_service.types import BoolArray, FloatArray, IntArray

AROUND = ((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1))
"""The eight cells around one."""
FAR = tuple(float(np.hypot(*offset)) for offset in AROUND)
"""How many cells they are away."""


class Columns(NamedTuple):
    """Nodes of layered columns for compiled loops; the fields are those of `Layers`."""

    cell: IntArray
    start: IntArray
    shape: tuple[int, int]
    height: FloatArray
    thickness: FloatArray


@njit(cache=True, nogil=True)
def pairs_at(columns: Columns, keep: BoolArray, most: float, offset: tuple[int, int]) -> tuple[IntArray, IntArray]:
    """Pairs of kept nodes (a, b), b's cell at the `offset` from a's, whose heights differ by `most` [m] at most."""
    a = used = 0
    one, other = np.empty(len(columns.cell) + 16, INDEX), np.empty(len(columns.cell) + 16, INDEX)
    while True:
        a, used = _write_pairs(columns, keep, most, offset, (a, used), (one, other))
        if a == len(columns.cell):
            return one[:used], other[:used]
        one, other = longer(one, 2 * len(one)), longer(other, 2 * len(other))


@lean()
def _write_pairs(
    columns: Columns,
    keep: BoolArray,
    most: float,
    offset: tuple[int, int],
    begun: tuple[int, int],
    made: tuple[NDArray[np.int32], NDArray[np.int32]],
) -> tuple[int, int]:
    """Go on with `pairs_at` from a node, with so many pairs made, as long as there is room: both numbers after that."""
    (cell, start, (nx, ny), height, _), (dx, dy), (first, used), (one, other) = columns, offset, begun, made
    x = 0
    for a in range(first, len(cell)):
        if not keep[a]:
            continue
        while cell[a] >= (x + 1) * ny:
            x += 1
        y = cell[a] - x * ny
        if not (0 <= x + dx < nx and 0 <= y + dy < ny):
            continue
        begin, end = start[cell[a] + dx * ny + dy], start[cell[a] + dx * ny + dy + 1]
        if used + end - begin > len(one):
            return a, used
        for b in range(begin, end):  # written, and kept or not: a guess would be wrong
            one[used], other[used] = a, b
            used += int(keep[b] & (abs(height[a] - height[b]) <= most))
    return len(cell), used


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
def steps_over_gaps(
    columns: Columns, keep: BoolArray, limits: tuple[float, float], offset: tuple[int, int], most: int
) -> tuple[IntArray, IntArray]:
    """Pairs of kept nodes between which a step is, or that a gap parts.

    A step is more than the first of the `limits`, and neither is more than the second [m]. A gap has up to `most` cells
    of which nothing was seen as low. The nose of a tread hides the back of the next one; a hole that one looks through
    into something is no gap. The `offset` is that of neighbouring cells on the line.
    """
    one, other = [INDEX(0) for _ in range(0)], [INDEX(0) for _ in range(0)]
    (cell, start, (nx, ny), height, _), (slope, step) = columns, limits
    dx, dy = offset
    for a in np.flatnonzero(keep):
        x, y = cell[a] // ny, cell[a] % ny
        for far in range(1, most + 2):
            u, v = x + far * dx, y + far * dy
            if not (0 <= u < nx and 0 <= v < ny):
                break
            begin, end = start[u * ny + v], start[u * ny + v + 1]
            if begin == end or height[begin] > height[a] + step:
                continue
            least = slope if far == 1 else -1.0
            for b in range(begin, end):
                if keep[b] and least < abs(height[a] - height[b]) <= step:
                    one.append(INDEX(a))
                    other.append(INDEX(b))
            break
    return np.array(one, INDEX), np.array(other, INDEX)


@njit(cache=True, nogil=True)
def pairs_around(
    nodes: IntArray, columns: Columns, keep: BoolArray, slope: float, step: float
) -> tuple[IntArray, IntArray]:
    """Pairs of a row of `nodes` and a kept node in a cell around its own, within `slope` a cell and a `step` [m]."""
    cell, start, (nx, ny), height, _ = columns
    one, other = [0 for _ in range(0)], [0 for _ in range(0)]
    for n in range(len(nodes)):
        i = nodes[n]
        x, y = divmod(cell[i], ny)
        for k in range(8):
            u, v, most = x + AROUND[k][0], y + AROUND[k][1], slope * FAR[k] + step
            if 0 <= u < nx and 0 <= v < ny:
                for j in range(start[u * ny + v], start[u * ny + v + 1]):
                    if keep[j] and abs(height[i] - height[j]) <= most:
                        one.append(n)
                        other.append(j)
    return np.array(one, np.int64), np.array(other, np.int64)

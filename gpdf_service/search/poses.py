"""Poses (x, y, θ) on a grid at which all discs of a body keep their distance: 64 of a row in a word, a bit each.

Where a disc's centre is, is told by the nearest node of the grid: so much room, or so little, that it is settled for
all places around the node, and then whole rows are shifted and joined at once. The few poses between are told by the
nearest obstacles of the four nodes around each disc.

From which poses a body gets to the goal, and how, waves tell that go out from there (Dial 1969). A wave holds the poses
whose way to the goal costs the same. Whoever looks at all poses of a room, which is what it takes to know that there is
no way, looks at millions: so a pose is one byte, and a move a step in their table.
"""

from __future__ import annotations

from math import ceil, cos, sin, sqrt
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gpdf_service.fields.tree import make_scratch
from gpdf_service.search.places import Places, nearest_of
from gpdf_service.tiles.surface import Cells, is_known
from gpdf_service.types import ByteArray, Float32Array, FloatArray, IntArray

Bits = NDArray[np.uint64]
"""Rows of words; bit b of word w tells of column 64 w + b."""
_ONE = np.uint64(1)
_DIAGONAL = sqrt(0.5)
"""[-] A place is at most so far from the nearest node, in widths of the grid."""
_DE_BRUIJN = np.uint64(0x03F79D71B4CB0A89)
"""Each run of six of its bits is another one, so that shifts of it can be told apart."""
_NUMBER = np.zeros(64, np.uint64)
_NUMBER[[(0x03F79D71B4CB0A89 << b & 0xFFFFFFFFFFFFFFFF) >> 58 for b in range(64)]] = range(64)
_FAR = np.float32(1e6)
"""[m] No obstacle near enough to matter."""


class Grid(NamedTuple):
    """Place of cell (0, 0) [m], width of the cells [m], their number in x and y, headings in a turn."""

    origin: FloatArray
    width: float
    shape: tuple[int, int]
    turns: int


class _Nodes(NamedTuple):
    """What is known of the grid's nodes, and of as many around it as the body's ends reach.

    Attributes:
        clear: Where a disc fits that is at any place around the node.
        open: Where it may fit; shape (nx, words).
        x: The nearest obstacle as seen from the node [m], shape (nx, ny); far where none is near.
        y: The same.
        around: Nodes around the grid.
    """

    clear: Bits
    open: Bits
    x: Float32Array
    y: Float32Array
    around: int


@njit(cache=True, nogil=True)
def free_poses(obstacles: Places, ground: Cells, grid: Grid, offsets: FloatArray, radius: float) -> Bits:
    """Where all discs keep `radius` [m], and what a step of the grid cuts from a turn, and the ground is known.

    The discs lie at `offsets` ahead of the body's centre [m], the same on either side of it; the grid has an even
    number of headings. A bit a pose, shape (headings, cells in x, words).
    """
    radius += grid.width**2 / (4.0 * radius)
    nodes = _look_around(obstacles, grid, ceil(offsets[-1] / grid.width) + 2, radius)
    known = _known(ground, grid)
    free = np.zeros((grid.turns, *known.shape), np.uint64)
    half = grid.turns // 2
    for h in range(half):
        _stand(nodes, grid, h, (offsets, radius), known, free[h])
        free[h + half] = free[h]  # with its other end ahead
    return free


@njit(cache=True, nogil=True)
def _known(ground: Cells, grid: Grid) -> Bits:
    """Cells whose middle has ground."""
    known = np.zeros((grid.shape[0], (grid.shape[1] + 63) // 64), np.uint64)
    for i in range(grid.shape[0]):
        for j in range(grid.shape[1]):
            if is_known(ground, grid.origin[0] + i * grid.width, grid.origin[1] + j * grid.width):
                known[i, j >> 6] |= _ONE << np.uint64(j & 63)
    return known


@njit(cache=True, nogil=True)
def _look_around(obstacles: Places, grid: Grid, around: int, radius: float) -> _Nodes:
    """What each node is told by its nearest obstacle; where those before it say that it is far or deep, none is asked.

    Distances are 1-Lipschitz: from node to node they change by no more than what lies between.
    """
    (nx, ny), width = grid.shape, grid.width
    nx, ny = nx + 2 * around, ny + 2 * around
    clear, open_ = np.zeros((nx, (ny + 63) // 64 + 1), np.uint64), np.zeros((nx, (ny + 63) // 64 + 1), np.uint64)
    x, y = np.full((nx, ny), _FAR), np.full((nx, ny), _FAR)
    points, moving = obstacles.standing.points, obstacles.moving.points
    stands, moves = _rows_of(obstacles.standing.order), _rows_of(obstacles.moving.order)
    least, most = np.full(ny + 1, -np.inf), np.full(ny + 1, np.inf)  # of the node, or the one below it in the last row
    near, scratch = _DIAGONAL * width, make_scratch()
    for i in range(nx):
        for j in range(ny):
            word, bit = j >> 6, _ONE << np.uint64(j & 63)
            least[j] = max(least[j], least[j - 1] if j > 0 else -np.inf) - width
            most[j] = min(most[j], most[j - 1] if j > 0 else np.inf) + width
            if least[j] < radius + 2.0 * width and most[j] > radius - 3.0 * width:
                at = grid.origin[0] + (i - around) * width, grid.origin[1] + (j - around) * width, 0.0
                distance, row = nearest_of(obstacles, at, scratch)
                place = points[stands[row]] if row < len(points) else moving[moves[row - len(points)]]
                x[i, j], y[i, j], least[j], most[j] = place[0] - at[0], place[1] - at[1], distance, distance
            if least[j] >= radius + near:
                clear[i, word] |= bit
            if most[j] >= radius - near:
                open_[i, word] |= bit
    return _Nodes(clear, open_, x, y, around)


@njit(cache=True, nogil=True)
def _rows_of(order: IntArray) -> IntArray:
    """Row in a tree of each row before it was in one."""
    rows = np.empty(len(order), np.int64)
    rows[order] = np.arange(len(order))
    return rows


@njit(cache=True, nogil=True)
def word_at(row: Bits, start: int) -> np.uint64:
    """The 64 bits of a row that begin with the bit `start`; a word must follow theirs."""
    w, b = start >> 6, np.uint64(start & 63)
    word: np.uint64 = row[w]
    if b > 0:
        word = (word >> b) | (row[w + 1] << (np.uint64(64) - b))
    return word


@njit(cache=True, nogil=True)
def lowest(word: np.uint64) -> np.uint64:
    """Number of the lowest bit that is set, of a word that is not 0 (Leiserson, Prokop & Randall 1998)."""
    number: np.uint64 = _NUMBER[((word & (~word + _ONE)) * _DE_BRUIJN) >> np.uint64(58)]
    return number


@njit(cache=True, nogil=True)
def _stand(nodes: _Nodes, grid: Grid, h: int, discs: tuple[FloatArray, float], known: Bits, free: Bits) -> None:
    """Set the bits of the cells where the body fits at a heading, by its `discs`' offsets and radius [m]."""
    (offsets, radius), angle = discs, 2.0 * np.pi * h / grid.turns
    k = len(offsets)
    place, shift = np.empty((k, 2)), np.empty((k, 2), np.int64)
    for d in range(k):
        place[d, 0], place[d, 1] = offsets[d] * cos(angle) / grid.width, offsets[d] * sin(angle) / grid.width
        shift[d, 0], shift[d, 1] = round(place[d, 0]) + nodes.around, round(place[d, 1]) + nodes.around
    for i in range(known.shape[0]):
        for w in range(known.shape[1]):
            sure = may = known[i, w]
            for d in range(k):
                if may == 0:
                    break
                sure &= word_at(nodes.clear[i + shift[d, 0]], 64 * w + shift[d, 1])
                may &= word_at(nodes.open[i + shift[d, 0]], 64 * w + shift[d, 1])
            doubt = may & ~sure
            while doubt != 0:
                b = lowest(doubt)
                doubt &= doubt - _ONE
                if _fits(nodes, grid.width, i, 64 * w + int(b), place, radius):
                    sure |= _ONE << b
            free[i, w] = sure


@njit(cache=True, nogil=True)
def _fits(nodes: _Nodes, width: float, i: int, j: int, place: FloatArray, radius: float) -> bool:
    """Whether all discs, at `place` from cell (i, j) in widths, keep off what the nodes around each are nearest to."""
    for d in range(len(place)):
        u, v = int(np.floor(place[d, 0])), int(np.floor(place[d, 1]))
        for a in range(u, u + 2):
            for b in range(v, v + 2):
                n, m = i + a + nodes.around, j + b + nodes.around
                off_x = nodes.x[n, m] - (place[d, 0] - a) * width
                off_y = nodes.y[n, m] - (place[d, 1] - b) * width
                if off_x * off_x + off_y * off_y < radius * radius:
                    return False
    return True


AROUND = 2
"""Cells around the grid that are never free: no move goes further."""
TURNS = 2
"""The first two moves of each heading are turns by one, back and on."""
_ARRIVED, _BLOCKED, _OPEN = 253, 254, 255


class Field(NamedTuple):
    """What brings each pose nearer to the goal, after a search.

    Attributes:
        onward: The move, one of its heading's; or that it has arrived, is blocked, or was not reached. A byte a pose,
            headings one after the other, in each all rows of cells, with those around.
        size: Headings, rows, and cells in a row, with those around.
    """

    onward: ByteArray
    size: tuple[int, int, int]


class _Kind(NamedTuple):
    """Moves of one cost, from each heading that they arrive at.

    Attributes:
        cost: The same for all.
        number: How many there are, shape (headings,).
        step: How far on in the field they lead, shape (headings, m).
        passed: The same of the poses between which they lead, shape (headings, m, 2).
        move: Which of their heading's moves they are.
        before: The heading that they come from.
    """

    cost: int
    number: IntArray
    step: IntArray
    passed: IntArray
    move: ByteArray
    before: NDArray[np.int16]


@njit(cache=True, nogil=True)
def field_of(free: Bits, cells: int) -> Field:
    """The field of the poses that are `free`, a bit each in rows of so many `cells`, before any search."""
    turns, nx, words = free.shape
    size = turns, nx + 2 * AROUND, cells + 2 * AROUND
    onward = np.full(size, _BLOCKED, np.uint8)
    for h in range(turns):
        for i in range(nx):
            row = onward[h, i + AROUND]
            for w in range(words):
                rest = free[h, i, w]
                while rest != 0:
                    row[64 * w + int(lowest(rest)) + AROUND] = _OPEN
                    rest &= rest - _ONE
    return Field(onward.ravel(), size)


@njit(cache=True, nogil=True)
def row_of(field: Field, pose: IntArray) -> int:
    """Where a pose (heading, i, j) is in a field."""
    _, nx, ny = field.size
    return int((pose[0] * nx + pose[1] + AROUND) * ny + pose[2] + AROUND)


@njit(cache=True, nogil=True)
def is_reached(field: Field, row: int) -> bool:
    """Whether one gets from a pose to the goal."""
    return bool(field.onward[row] <= _ARRIVED)


@njit(cache=True, nogil=True)
def mend(field: Field, poses: IntArray, *, free: bool) -> None:
    """Say of poses (heading, i, j), shape (k, 3), that they are `free`, or not."""
    for pose in poses:
        field.onward[row_of(field, pose)] = _OPEN if free else _BLOCKED


@njit(cache=True, nogil=True)
def spread(field: Field, moves: IntArray, goals: IntArray, starts: IntArray) -> int:
    """Send waves out from the `goals`, poses (heading, i, j), shape (k, 3), until one comes to a start or none goes on.

    The moves from each heading are a change of (i, j, heading) and its cost, 0 for no move, shape (headings, m, 4).
    Writes the field; which start was reached first, −1 for none.
    """
    onward, (_, nx, ny) = field.onward, field.size
    onward[onward < _BLOCKED] = _OPEN  # what a search before found
    kinds = [_moves_of(moves, cost, nx * ny, ny) for cost in np.unique(moves[:, :, 3]) if cost > 0]
    longest = moves[:, :, 3].max()
    poses = wave, facing = np.empty(len(onward), np.int32), np.empty(len(onward), np.int16)
    ends = np.array([row_of(field, start) for start in starts])
    begin, used = [0 for _ in range(longest + 1)], 0  # of each wave, the newest last; the first ones are empty
    for goal in goals:
        row = row_of(field, goal)
        if onward[row] == _OPEN:
            onward[row], wave[used], facing[used] = _ARRIVED, row, goal[0]
            used += 1
    while used > begin[-longest]:
        for s in range(len(ends)):
            if is_reached(field, ends[s]):
                return s
        begin.append(used)
        for kind in kinds:
            used = _wave(onward, kind, poses, (begin[-1 - kind.cost], begin[-kind.cost]), used)
    return -1


@njit(cache=True, nogil=True)
def _wave(
    onward: ByteArray,
    kind: _Kind,
    poses: tuple[NDArray[np.int32], NDArray[np.int16]],
    ends: tuple[int, int],
    used: int,
) -> int:
    """Add to the newest wave the poses from which moves of a kind lead to those between `ends`; how many there are."""
    wave, facing = poses
    for e in range(ends[0], ends[1]):
        row, h = wave[e], facing[e]
        for m in range(kind.number[h]):
            before = row - kind.step[h, m]
            if (
                onward[before] == _OPEN
                and onward[row - kind.passed[h, m, 0]] != _BLOCKED
                and onward[row - kind.passed[h, m, 1]] != _BLOCKED
            ):
                onward[before], wave[used], facing[used] = kind.move[h, m], before, kind.before[h, m]
                used += 1
    return used


@njit(cache=True, nogil=True)
def _moves_of(moves: IntArray, cost: int, plane: int, row: int) -> _Kind:
    """The moves of a cost."""
    turns, most, _ = moves.shape
    count, step, move = np.zeros(turns, np.int64), np.zeros((turns, most), np.int64), np.zeros((turns, most), np.uint8)
    before, passed = np.zeros((turns, most), np.int16), np.zeros((turns, most, 2), np.int64)
    for h in range(turns):
        for m in range(most):
            if moves[h, m, 3] == cost:
                k, faced = count[h], (h - moves[h, m, 2]) % turns
                i, j = moves[h, m, 0], moves[h, m, 1]
                step[h, k] = (h - faced) * plane + i * row + j
                if abs(i) + abs(j) == 3:  # to the middle of its way, on either side
                    passed[h, k, 0], passed[h, k, 1] = int(i / 2) * row + int(j / 2), np.sign(i) * row + np.sign(j)
                move[h, k], before[h, k], count[h] = m, faced, k + 1
    return _Kind(cost, count, step, passed, move, before)


@njit(cache=True, nogil=True)
def follow(field: Field, moves: IntArray, start: IntArray) -> IntArray:
    """Poses (heading, i, j) from a start that was reached to one that has arrived, shape (n, 3)."""
    pose, made = start.copy(), [(start[0], start[1], start[2])]
    while field.onward[row_of(field, pose)] != _ARRIVED:
        i, j, turn, _ = moves[pose[0], field.onward[row_of(field, pose)]]
        pose[0], pose[1], pose[2] = (pose[0] + turn) % len(moves), pose[1] + i, pose[2] + j
        made.append((pose[0], pose[1], pose[2]))
    return np.array(made)

"""From which poses a body gets to the goal, and how: waves that go out from there (Dial 1969).

A wave holds the poses whose way to the goal costs the same. Whoever looks at all poses of a room, which is what it
takes to know that there is no way, looks at millions: so a pose is one byte, and a move a step in their table.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gpdf_service.search.poses import Bits, lowest
from gpdf_service.types import ByteArray, IntArray

AROUND = 2
"""Cells around the grid that are never free: no move goes further."""
TURNS = 2
"""The first two moves of each heading are turns by one, back and on."""
_ARRIVED, _BLOCKED, _OPEN = 253, 254, 255
_ONE = np.uint64(1)


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
    """Send waves out from the `goals` until one comes to a start, or none goes on.

    Args:
        field: Written.
        moves: What it does from each heading: change of (i, j, heading) and the cost, 0 for no move; (headings, m, 4).
        goals: Poses (heading, i, j) that have arrived, shape (k, 3).
        starts: The same where the waves may end.

    Returns:
        Which start was reached first, −1 for none.
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

"""What planes there are in a cell: those of the windows around it, put together, each ended where another one is.

Each window's plane is a vote, as heavy as it is precise at the cell: n / (1 + D² / λ), D from its points' middle. At
an edge the windows across it are no planes, and those clear of it tell where both sides are. Planes of windows on all
sides of a place that bends are off to both sides of it, so that their mean is not.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
from numba import njit

from gpdf_service.denoise.cells import AROUND, offset_of
from gpdf_service.denoise.planes import SHEETS, Windows
from gpdf_service.fields.tree import larger, lesser
from gpdf_service.kernel_cache import lean
from gpdf_service.types import Float32Array, FloatArray, IntArray

KINDS = 4
"""Planes of one cell at most: three that meet in a corner, and a sheet beside them."""
MOST = 400
"""Points of a window that planes are fitted to, at most."""
VOTES = AROUND * SHEETS
VOTE = 10
"""Numbers of a vote: normal, height over the cell's middle, weight, the middle of its points from the cell's, standard
error of its direction [rad], and how far off the plane that it is for it can be there [m]."""
FOUND = 9
"""Numbers of a plane: normal, height over the cell's middle, weight of all votes and of the heaviest one, and the
weighted sum of their middles."""
_ALIKE = 0.47
"""[-] Sine of the angle (28°), and two errors, between votes for one plane: a ball of 5 widths turns by 23° a cell."""
_BESIDE = 1.0
"""[-] Standard deviations, and two errors of a vote, between votes for the same plane: a step of 1.5 is two."""
_REACH = 3.0
"""[-] Standard deviations from a cell that its points can be from their plane."""
_BENT = 2.0
"""[-] Standard errors of the heaviest vote that a bend exceeds."""
LIGHT = 0.05
"""[-] Of the heaviest plane's weight: what has less is no plane that ends others."""
_END = 0.3
"""[-] Cells beyond another plane that the middle of a vote may be, and the plane still ends there."""


class Room(NamedTuple):
    """What telling the planes of a cell needs; made once a batch.

    Attributes:
        cast: The votes as they came, shape (n, `VOTE`).
        votes: The heaviest first, shape (`VOTE`, n).
        rank: Which of those that were cast they are, shape (n,).
        of: Which plane each is for, −1 for none, shape (n,).
        found: The planes, the heaviest first, shape (`KINDS`, `FOUND`).
        ends: On which side of plane j plane i is, ±1, shape (`KINDS`, `KINDS`); 0 where it does not end there.
        known: Sums of what is known of each plane before points are looked at, shape (`KINDS`, 10).
        sums: The same with the points.
        vectors: Three places, shape (3, 3).
        about: Points about the cell, from its middle [m], shape (3, `MOST`).
        shares: What share each plane has of them, and what all have, shape (`KINDS` + 1, `MOST`).
        slants: How each plane lies to each other one, shape (`KINDS`, `KINDS`, 2).
        number: How many points are of each plane, shape (`KINDS`,).
    """

    cast: FloatArray
    votes: FloatArray
    rank: IntArray
    of: IntArray
    found: FloatArray
    ends: FloatArray
    known: FloatArray
    sums: FloatArray
    vectors: FloatArray
    about: FloatArray
    shares: FloatArray
    slants: FloatArray
    number: IntArray


@njit(cache=True, nogil=True)
def make_room(votes: int) -> Room:
    """Room for so many votes."""
    planes = np.empty((KINDS, FOUND)), np.empty((KINDS, KINDS)), np.zeros((KINDS, 10)), np.empty((KINDS, 10))
    points = np.empty((3, 3)), np.empty((3, MOST)), np.empty((KINDS + 1, MOST))
    slants, number = np.empty((KINDS, KINDS, 2)), np.empty(KINDS, np.int64)
    told = np.empty((votes, VOTE)), np.empty((VOTE, votes)), np.empty(votes, np.int64), np.empty(votes, np.int64)
    return Room(*told, *planes, *points, slants, number)


@lean()
def collect(windows: Windows, near: IntArray, votes: FloatArray) -> int:
    """Write the votes for a cell's planes of the windows `near`; how many."""
    count, (cells, sigma, planes, _) = 0, windows
    for j in range(AROUND):
        if near[j] >= 0:
            for s in range(SHEETS):
                count = add_vote(planes[near[j], s], offset_of(cells, j), cells.width, sigma, votes, count)
    return count


@lean()
def add_vote(
    plane: Float32Array, offset: tuple[float, float, float], width: float, sigma: float, votes: FloatArray, count: int
) -> int:
    """Add the vote of one of `Planes` for a cell of that `width` to the first `count`; how many they are then.

    The `offset` is from the cell's middle to that of the plane's window [m].
    """
    if plane[6] == 0.0:
        return count
    x, y, z = offset[0] + plane[3], offset[1] + plane[4], offset[2] + plane[5]
    height = x * plane[0] + y * plane[1] + z * plane[2]
    flat = abs(plane[0]) + abs(plane[1]) + abs(plane[2])
    if abs(height) > 0.5 * width * flat + _REACH * sigma:
        return count
    aside = x * x + y * y + z * z - height * height
    weight = plane[6] / (1.0 + aside / plane[7]) * plane[9]
    if weight == 0.0:  # its points bend so much that they are of no plane
        return count
    vote = votes[count]
    vote[0], vote[1], vote[2], vote[3], vote[4] = plane[0], plane[1], plane[2], height, weight
    vote[5], vote[6], vote[7], vote[8], vote[9] = x, y, z, plane[8], sigma * (_BESIDE + 2.0 / sqrt(weight))
    return count + 1


@lean()
def _sort_votes(room: Room, count: int) -> None:
    """Write the first `count` votes that were cast, the heaviest first."""
    rank, weight = room.rank, room.cast[:, 4]
    for i in range(count):
        at = i
        while at > 0 and weight[rank[at - 1]] < weight[i]:
            rank[at] = rank[at - 1]
            at -= 1
        rank[at] = i
    for i in range(count):
        for k in range(VOTE):
            room.votes[k, i] = room.cast[rank[i], k]


@lean()
def cluster(room: Room, count: int, width: float, sigma: float) -> int:
    """Write which plane each of the first `count` votes is for, the planes, and where they end; how many they are.

    The heaviest vote that is left begins a plane, and those that agree with it are of it. Then once more with the
    planes themselves, the heaviest first: what one vote was off by does not split a plane.
    """
    _sort_votes(room, count)
    votes, of, found = room.votes, room.of, room.found
    of[:count] = -1
    kinds = 0
    for i in range(count):
        if of[i] < 0 and kinds < KINDS:
            _give(room, count, (votes[0, i], votes[1, i], votes[2, i], votes[3, i]), votes[8, i], kinds)
            kinds += 1
    _sum_votes(room, count, kinds, sigma)
    _heaviest_first(found, kinds)
    of[:count] = -1
    for i in range(kinds):
        _give(room, count, (found[i, 0], found[i, 1], found[i, 2], found[i, 3]), 0.0, i)
    _sum_votes(room, count, kinds, sigma)
    kinds = _without_empty(of[:count], found, kinds)
    _find_ends(room, count, kinds, width)
    return kinds


@lean()
def _without_empty(of: IntArray, found: FloatArray, kinds: int) -> int:
    """Drop planes whose votes all agree with a heavier one, or none, and number the rest anew; how many they are."""
    kept = 0
    for kind in range(kinds):
        if found[kind, 4] == 0.0:
            continue
        if kept < kind:
            for k in range(FOUND):
                found[kept, k] = found[kind, k]
            for j in range(len(of)):
                if of[j] == kind:
                    of[j] = kept
        kept += 1
    return kept


@lean()
def _give(room: Room, count: int, plane: tuple[float, float, float, float], turn: float, kind: int) -> None:
    """Give a plane whose direction is known to within `turn` [rad] those of the votes for it that are for none yet."""
    (a, b, c, h), votes, of = plane, room.votes, room.of[:count]
    x, y, z, height, error, most = votes[0], votes[1], votes[2], votes[3], votes[8], votes[9]
    for j in range(len(of)):
        dot = a * x[j] + b * y[j] + c * z[j]
        off = height[j] - h if dot > 0.0 else height[j] + h
        alike = 1.0 - dot * dot <= (_ALIKE + 2.0 * sqrt(turn * turn + error[j] * error[j])) ** 2
        of[j] = kind if (of[j] < 0) & alike & (abs(off) <= most[j]) else of[j]


@lean()
def _sum_votes(room: Room, count: int, kinds: int, sigma: float) -> None:
    """Write the mean of the votes for each plane, which way round they are told by the heaviest.

    It goes through the mean of their middles, unless what the votes say of the cell itself is clearly another: their
    slopes are noisier than their middles, but see the surface bend. What noise explains of that is left out of it.
    """
    found, of = room.found, room.of
    found[:kinds] = 0.0
    for j in range(count):
        if of[j] < 0:
            continue
        plane, v = found[of[j]], room.cast[room.rank[j]]
        sign = 1.0 if plane[0] * v[0] + plane[1] * v[1] + plane[2] * v[2] >= 0.0 else -1.0
        for k in range(4):
            plane[k] += sign * v[4] * v[k]
        for k in range(3):
            plane[6 + k] += v[4] * v[5 + k]
        plane[4] += v[4]
        plane[5] = max(plane[5], v[4])
    for plane in found[:kinds]:
        if plane[4] == 0.0:
            continue
        length = sqrt(plane[0] ** 2 + plane[1] ** 2 + plane[2] ** 2)
        through = 0.0
        for k in range(3):
            plane[k] /= length
            through += plane[k] * plane[6 + k] / plane[4]
        bend, chance = plane[3] / plane[4] - through, (_BENT * sigma) ** 2 / plane[5]
        plane[3] = through + bend * max(0.0, 1.0 - chance / max(bend * bend, 1e-300))


@lean()
def _heaviest_first(found: FloatArray, kinds: int) -> None:
    for i in range(1, kinds):
        for j in range(i, 0, -1):
            if found[j, 4] <= found[j - 1, 4]:
                break
            for k in range(FOUND):
                found[j, k], found[j - 1, k] = found[j - 1, k], found[j, k]


@lean()
def _find_ends(room: Room, count: int, kinds: int, width: float) -> None:
    """Write on which side of each other plane each one is."""
    votes, of, found, ends = room.votes, room.of, room.found, room.ends
    ends[:] = 0.0
    for j in range(kinds):
        if found[j, 4] < LIGHT * found[0, 4]:
            continue
        for i in range(kinds):
            slant = found[i, 0] * found[j, 0] + found[i, 1] * found[j, 1] + found[i, 2] * found[j, 2]
            if i == j or 1.0 - slant * slant < _ALIKE**2:
                continue
            least, most = _spread(votes, of[:count], i, found[j])
            if -least <= _END * width and most > _END * width:
                ends[i, j] = 1.0
            elif most <= _END * width and -least > _END * width:
                ends[i, j] = -1.0


@lean()
def _spread(votes: FloatArray, of: IntArray, kind: int, plane: FloatArray) -> tuple[float, float]:
    """How far under and over a `plane` the middles of the votes for another one lie at most [m]."""
    (a, b, c, h), x, y, z, low, high = (plane[0], plane[1], plane[2], plane[3]), votes[5], votes[6], votes[7], 0.0, 0.0
    for v in range(len(of)):
        beside = x[v] * a + y[v] * b + z[v] * c - h if of[v] == kind else 0.0
        low, high = lesser(low, beside), larger(high, beside)
    return low, high


@lean()
def onto_plane(found: FloatArray, ends: FloatArray, i: int, x: FloatArray, place: FloatArray) -> float:
    """Write the point of plane i, as far as it goes, that is nearest to x [m]; the squared distance [m²]."""
    off = x[0] * found[i, 0] + x[1] * found[i, 1] + x[2] * found[i, 2] - found[i, 3]
    for k in range(3):
        place[k] = x[k] - off * found[i, k]
    for j in range(len(found)):
        if ends[i, j] == 0.0:
            continue
        beyond = place[0] * found[j, 0] + place[1] * found[j, 1] + place[2] * found[j, 2] - found[j, 3]
        if beyond * ends[i, j] >= 0.0:
            continue
        slant = found[i, 0] * found[j, 0] + found[i, 1] * found[j, 1] + found[i, 2] * found[j, 2]
        for k in range(3):
            place[k] -= beyond * (found[j, k] - slant * found[i, k]) / max(1.0 - slant * slant, 1e-6)
    return float((x[0] - place[0]) ** 2 + (x[1] - place[1]) ** 2 + (x[2] - place[2]) ** 2)

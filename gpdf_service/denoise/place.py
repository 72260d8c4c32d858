"""Each point onto the nearest plane of its cell."""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gpdf_service.denoise.cells import AROUND, Cells, begin_sweep, centre_of, gather_all, holds_any, look_around
from gpdf_service.denoise.planes import Planes
from gpdf_service.denoise.turns import fit_by_turns
from gpdf_service.denoise.votes import FOUND, KINDS, LIGHT, VOTE, VOTES, cluster, collect, find_ends, onto_plane
from gpdf_service.fields.threads import run_chunked
from gpdf_service.types import BoolArray, FloatArray

_MOST = 200
"""Points of a window that planes which meet are fitted to."""
FAR = 3.0
"""[-] Standard deviations that a point can be off its plane: one in 400 is further."""


class Placed(NamedTuple):
    """Where the points are, in the order of the input.

    Attributes:
        points: [m], shape (n, 3).
        error: Standard error of the place across its surface [m], shape (n,).
        pending: Points that have no place yet, shape (n,).
        normal: Of the surface that each lies on, shape (n, 3).
    """

    points: FloatArray
    error: FloatArray
    pending: BoolArray
    normal: NDArray[np.float32]


def place_in_cells(
    cells: Cells, planes: Planes, sigma: float, placed: Placed, main: NDArray[np.float32], least: int = 0
) -> None:
    """Put the points that are pending onto the nearest plane of their cell, if one is within `FAR` σ.

    Args:
        cells: Of the points.
        planes: Of their windows.
        sigma: Noise of the points [m].
        placed: Where the points are; changed in place.
        main: The plane that most points of each cell are of: its normal, its height over the cell's middle and its
            error [m], shape (m, 5), 0 where there is none; written.
        least: Votes of the one plane that a cell must have; 0 where it may have several, and few votes.
    """
    run_chunked(lambda a, b: _place_range(cells, planes, sigma, placed, least, a, b, main), len(cells.key))


@njit(cache=True, nogil=True)
def _place_range(
    cells: Cells,
    planes: Planes,
    sigma: float,
    placed: Placed,
    least: int,
    begin: int,
    end: int,
    main: NDArray[np.float32],
) -> None:
    near, votes, of = np.empty(AROUND, np.int64), np.empty((VOTES, VOTE)), np.empty(VOTES, np.int64)
    found, ends, number = np.empty((KINDS, FOUND)), np.empty((KINDS, KINDS)), np.empty(KINDS, np.int64)
    rows, room = np.empty(_MOST, np.int64), (np.empty((KINDS, 10)), np.empty(3), np.empty(3), np.empty(3))
    known, at = np.zeros((KINDS, 10)), begin_sweep(cells, begin)
    for c in range(begin, end):
        if not holds_any(cells, c, placed.pending):
            continue
        look_around(cells, c, at, near)
        count = collect(cells, near, planes, sigma, votes)
        if count <= least:
            continue
        kinds = cluster(votes, count, sigma, of, found)
        if kinds == 0 or (least > 0 and not _is_alone(of[:count], found[:kinds], least)):
            continue
        find_ends(votes, count, of, found, kinds, cells.width, ends)
        if least == 0 and kinds > 1:
            fit_by_turns(
                cells, c, rows[: gather_all(cells, near, rows)], sigma, found[:kinds], ends, known[:kinds], room
            )
        place_points(cells, c, found[:kinds], ends, sigma, placed, number, main[c])


@njit(cache=True, nogil=True)
def _is_alone(of: NDArray[np.int64], found: FloatArray, least: int) -> bool:
    """Whether the first plane has more votes than `least`, and no other one any weight."""
    votes, alone = 0, True
    for kind in of:
        votes += kind == 0
    for plane in found[1:]:
        alone &= plane[4] < LIGHT * found[0, 4]
    return bool(alone and votes > least)


@njit(cache=True, nogil=True)
def place_points(
    cells: Cells,
    c: int,
    found: FloatArray,
    ends: FloatArray,
    sigma: float,
    placed: Placed,
    number: NDArray[np.int64],
    main: NDArray[np.float32],
) -> None:
    """Put the pending points of cell c onto the nearest of its planes, and write the one that most of them are of."""
    x, place, best = np.empty(3), np.empty(3), np.empty(3)
    middle, most = centre_of(cells, c), 0
    number[:] = 0
    for i in range(cells.begin[c], cells.begin[c + 1]):
        row = cells.order[i]
        if not placed.pending[row]:
            continue
        for k in range(3):
            x[k] = cells.places[i, k] - middle[k]
        nearest, chosen = (FAR * sigma) ** 2, -1
        for kind in range(len(found)):
            if found[kind, 4] < LIGHT * found[0, 4]:
                continue
            off = onto_plane(found, len(found), ends, kind, x, place)
            if off < nearest:
                nearest, chosen = off, kind
                best[:] = place
        if chosen >= 0:
            for k in range(3):
                placed.points[row, k] = best[k] + middle[k] + cells.corner[k]
                placed.normal[row, k] = found[chosen, k]
            placed.error[row] = sigma / sqrt(found[chosen, 5])
            placed.pending[row] = False
            number[chosen] += 1
            if number[chosen] > most:
                most = number[chosen]
                for k in range(4):
                    main[k] = found[chosen, k]
                main[4] = placed.error[row]

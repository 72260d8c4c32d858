"""Each point onto the nearest plane of its cell."""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gpdf_service.denoise.cells import AROUND, begin_sweep, centre_of, holds_any, look_around, look_at
from gpdf_service.denoise.planes import Windows
from gpdf_service.denoise.turns import fit_by_turns
from gpdf_service.denoise.votes import LIGHT, VOTES, Room, cluster, collect, make_room, onto_plane
from gpdf_service.fields.threads import run_chunked
from gpdf_service.kernel_cache import lean
from gpdf_service.types import BoolArray, Float32Array, FloatArray

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
    normal: Float32Array


def place_in_cells(windows: Windows, placed: Placed, least: int = 0) -> None:
    """Put the points that are pending onto the nearest plane of their cell, if one is within `FAR` σ.

    The main planes of the `windows` are written. A cell must have one plane, of more votes than the `least`; where that
    is 0 it may have several, and few votes.
    """
    run_chunked(lambda a, b: _place_range(windows, placed, least, a, b), len(windows.main))


@njit(cache=True, nogil=True)
def _place_range(windows: Windows, placed: Placed, least: int, begin: int, end: int) -> None:
    cells, room, near = windows.cells, make_room(VOTES), np.empty(AROUND, np.int64)
    at = begin_sweep(cells, cells.key[begin])
    for c in range(begin, end):
        if not holds_any(cells, c, placed.pending):
            continue
        look_around(cells, c, at, near)
        count = collect(windows, near, room.cast)
        if count <= least:
            continue
        kinds = cluster(room, count, cells.width, windows.sigma)
        if kinds == 0 or (least > 0 and not _is_alone(room.of[:count], room.found[:kinds], least)):
            continue
        if least == 0 and kinds > 1:
            number = look_at(cells, c, near, _MOST, room.about)
            fit_by_turns(windows.sigma, cells.width, room, number, kinds)
        place_points(windows, c, room, kinds, placed)


@lean()
def _is_alone(of: NDArray[np.int64], found: FloatArray, least: int) -> bool:
    """Whether the first plane has more votes than `least`, and no other one any weight."""
    votes, alone = 0, True
    for kind in of:
        votes += kind == 0
    for plane in found[1:]:
        alone &= plane[4] < LIGHT * found[0, 4]
    return bool(alone and votes > least)


@lean()
def place_points(windows: Windows, c: int, room: Room, kinds: int, placed: Placed) -> None:
    """Put the pending points of cell c onto the nearest of its planes, and write the one that most of them are of."""
    cells, sigma, found, main = windows.cells, windows.sigma, room.found[:kinds], windows.main[c]
    (x, place, best), number = room.vectors, room.number
    number[:] = 0
    middle, most = centre_of(cells, c), 0
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
            off = onto_plane(found, room.ends, kind, x, place)
            if off < nearest:
                nearest, chosen = off, kind
                best[0], best[1], best[2] = place
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

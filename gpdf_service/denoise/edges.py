"""Planes that go on to where they meet: what a cell at an edge holds, told by the planes clear of it.

No window at an edge is one plane. But walls, floors and the sides of boxes are known well a little further off, and
where they, each ended at the others, leave of the cell's points what the noise explains, they are what is there.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numba import njit

from gpdf_service.denoise.cells import (
    AROUND,
    Cells,
    begin_sweep,
    centre_of,
    holds_any,
    look_around,
    look_at,
    runs_within,
    some_of,
)
from gpdf_service.denoise.place import Placed, place_points
from gpdf_service.denoise.planes import THICK, Planes, Windows
from gpdf_service.denoise.turns import fit_by_turns, sum_known
from gpdf_service.denoise.votes import LIGHT, MOST, VOTES, Room, add_vote, cluster, collect, make_room, onto_plane
from gpdf_service.fields.shapes import FEWEST, add, fit_plane
from gpdf_service.fields.threads import run_chunked
from gpdf_service.kernel_cache import lean
from gpdf_service.types import IntArray

_RINGS = 3
"""Cells off its own that planes are taken from: a window clear of an edge is two off, all those around it three."""
_SIDE = 2 * _RINGS + 1
"""Cells along a side of all that planes are taken from."""
_HALF = 1.0
"""[-] Cells to either side of a cell's middle whose points the planes must explain: half of them are its own."""


def place_at_edges(windows: Windows, placed: Placed) -> None:
    """Put the pending points of cells that the planes around explain onto these, in place.

    Until now only those `windows` where all around is flat have a main plane.
    """
    flat = some_of(windows.cells, windows.main[:, 4] > 0.0)
    planes = np.ascontiguousarray(windows.planes[flat.order, 0])
    run_chunked(lambda a, b: _edge_range(windows, (flat, planes), placed, a, b), len(windows.main))


@njit(cache=True, nogil=True)
def _edge_range(windows: Windows, told: tuple[Cells, Planes], placed: Placed, begin: int, end: int) -> None:
    """As `place_at_edges`, of cells from `begin` to `end`; the flat cells are told, and their planes."""
    (cells, sigma, _, _), (flat, planes) = windows, told
    near, runs = np.empty(AROUND, np.int64), np.empty((_SIDE**2, 2), np.int64)
    room, own, half, first = make_room(_SIDE**3), make_room(VOTES), _HALF * cells.width, cells.key[begin]
    at, wide = begin_sweep(cells, first), begin_sweep(flat, first, _RINGS)
    for c in range(begin, end):
        if not holds_any(cells, c, placed.pending):
            continue
        count, (x, y, z) = 0, centre_of(cells, c)
        for run in runs[: runs_within(flat, cells.key[c], _RINGS, wide, runs)]:
            for j in range(run[0], run[1]):
                a, b, d = flat.places[j]
                count = add_vote(planes[j], (a - x, b - y, d - z), cells.width, sigma, room.cast, count)
        if count == 0:
            continue
        look_around(cells, c, at, near)
        number = look_at(cells, c, near, MOST, room.about)
        close, thickness = _close_to(room, number, half)
        kinds = cluster(room, count, cells.width, sigma) if close >= FEWEST else 0
        most = sigma**2 * (close + THICK * sqrt(2.0 * close))  # sum of squares that the noise explains
        if kinds == 0 or (kinds == 1 and thickness > most):
            continue
        sum_known(room.found[:kinds], cells.width, sigma, room.known)
        fit_by_turns(sigma, cells.width, room, number, kinds)
        rest = _rest(room, room, number, kinds, half)
        if rest <= most and not _bends(windows, near, (room, number), own, kinds, rest):
            place_points(windows, c, room, kinds, placed)


@lean()
def _bends(windows: Windows, near: IntArray, about: tuple[Room, int], room: Room, kinds: int, rest: float) -> bool:
    """Whether no more planes, of the windows right around, leave less of the points `about`: then the surface bends."""
    width = windows.cells.width
    own = cluster(room, collect(windows, near, room.cast), width, windows.sigma)
    if own == 0 or own > kinds:
        return own == 0
    return bool(_rest(room, *about, own, _HALF * width) < rest)


@lean()
def _is_close(x: float, y: float, z: float, half: float) -> bool:
    """Whether the planes of a cell must explain a point so far from its middle [m]."""
    return bool((abs(x) <= half) & (abs(y) <= half) & (abs(z) <= half))


@lean()
def _close_to(room: Room, number: int, half: float) -> tuple[int, float]:
    """How many of the points about a cell its planes must explain, and what one plane leaves of them at least [m²]."""
    x, y, z = room.about[0, :number], room.about[1, :number], room.about[2, :number]
    moments, (place, normal, _) = room.sums[0], room.vectors
    moments[:] = 0.0
    for k in range(number):
        if _is_close(x[k], y[k], z[k], half):
            add(moments, x[k], y[k], z[k])
    few = moments[0] < FEWEST
    return int(moments[0]), 0.0 if few else float(moments[0] * fit_plane(moments, place, normal)[0])


@lean()
def _rest(planes: Room, room: Room, number: int, kinds: int, half: float) -> float:
    """Sum of squares [m²] by which the points in a room close to a cell are off the first `kinds` planes in another."""
    x, y, z = room.about[0, :number], room.about[1, :number], room.about[2, :number]
    found, (own, place, _), total = planes.found[:kinds], planes.vectors, 0.0
    for k in range(number):
        if not _is_close(x[k], y[k], z[k], half):
            continue
        least, (own[0], own[1], own[2]) = np.inf, (x[k], y[k], z[k])
        for kind in range(kinds):
            if found[kind, 4] >= LIGHT * found[0, 4]:
                least = min(least, onto_plane(found, planes.ends, kind, own, place))
        total += least
    return total

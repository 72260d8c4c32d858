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
    cells_within,
    centre_of,
    gather,
    holds_any,
    look_around,
)
from gpdf_service.denoise.place import Placed, place_points
from gpdf_service.denoise.planes import THICK, Windows
from gpdf_service.denoise.turns import fit_by_turns, sum_known
from gpdf_service.denoise.votes import LIGHT, VOTES, Room, add_vote, cluster, collect, make_room, onto_plane
from gpdf_service.fields.shapes import FEWEST, add, fit_plane
from gpdf_service.fields.threads import run_chunked
from gpdf_service.kernel_cache import lean
from gpdf_service.types import BoolArray, FloatArray, IntArray

_RINGS = 3
"""Cells off its own that planes are taken from: a window clear of an edge is two off, all those around it three."""
_MOST = 400
"""Points of a window that planes are fitted to."""
_HALF = 1.0
"""[-] Cells to either side of a cell's middle whose points the planes must explain: half of them are its own."""


def place_at_edges(windows: Windows, placed: Placed) -> None:
    """Put the pending points of cells that the planes around explain onto these.

    Args:
        windows: Of the points; until now only cells where all around is flat have a main plane.
        placed: Where the points are; changed in place.
    """
    flat = windows.main[:, 4] > 0.0
    run_chunked(lambda a, b: _edge_range(windows, flat, placed, a, b), len(flat))


@njit(cache=True, nogil=True)
def _edge_range(windows: Windows, flat: BoolArray, placed: Placed, begin: int, end: int) -> None:
    cells, sigma, planes, _ = windows
    near, beside = np.empty(AROUND, np.int64), np.empty((2 * _RINGS + 1) ** 3, np.int64)
    room, rows = make_room(len(beside)), np.empty(_MOST, np.int64)
    at, wide = begin_sweep(cells, begin), begin_sweep(cells, begin, _RINGS)
    for c in range(begin, end):
        if not holds_any(cells, c, placed.pending):
            continue
        look_around(cells, c, at, near)
        own = rows[: gather(cells, near, rows)]
        number, least = _thickness(windows, c, own, room)
        if number < FEWEST:
            continue
        count, (x, y, z) = 0, centre_of(cells, c)
        for j in beside[: cells_within(cells, c, _RINGS, wide, beside)]:
            if flat[j]:
                a, b, d = centre_of(cells, j)
                count = add_vote(planes[j, 0], (a - x, b - y, d - z), cells.width, sigma, room.votes, count)
        kinds = cluster(room, count, cells.width, sigma) if count > 0 else 0
        if kinds == 0 or (kinds == 1 and least > _explained(sigma, number)):
            continue
        sum_known(room.found[:kinds], cells.width, sigma, room.known)
        fit_by_turns(windows, c, own, room, kinds)
        rest = _rest(windows, c, own, room, kinds)
        if rest <= _explained(sigma, number) and not _bends(windows, c, near, own, kinds, rest):
            place_points(windows, c, room, kinds, placed)


@njit(cache=True, nogil=True)
def _bends(windows: Windows, c: int, near: IntArray, rows: IntArray, kinds: int, rest: float) -> bool:
    """Whether no more planes, of the windows right around, leave less: then the surface bends, and goes not on."""
    room = make_room(VOTES)
    own = cluster(room, collect(windows, near, room.votes), windows.cells.width, windows.sigma)
    if own == 0 or own > kinds:
        return own == 0
    return bool(_rest(windows, c, rows, room, own) < rest)


@lean()
def _explained(sigma: float, number: int) -> float:
    """Sum of the squares by which the noise has so many points off their planes, at most [m²]."""
    return sigma**2 * (number + THICK * sqrt(2.0 * number))


@lean()
def _thickness(windows: Windows, c: int, rows: IntArray, room: Room) -> tuple[int, float]:
    """How many of the points `rows` are in and about cell c, and what no one plane can leave less of than [m²]."""
    cells, moments, (x, normal, _) = windows.cells, room.sums[0], room.vectors
    moments[:] = 0.0
    for i in rows:
        if _is_about(cells, c, i, x):
            add(moments, x[0], x[1], x[2])
    return int(moments[0]), moments[0] * fit_plane(moments, x, normal)[0] if moments[0] >= FEWEST else 0.0


@lean()
def _is_about(cells: Cells, c: int, i: int, x: FloatArray) -> bool:
    """Write a place from the middle of cell c, (3,) [m]; whether its planes must explain it."""
    a, b, d = centre_of(cells, c)
    x[0], x[1], x[2] = cells.places[i, 0] - a, cells.places[i, 1] - b, cells.places[i, 2] - d
    return bool(max(abs(x[0]), abs(x[1]), abs(x[2])) <= _HALF * cells.width)


@lean()
def _rest(windows: Windows, c: int, rows: IntArray, room: Room, kinds: int) -> float:
    """Sum of the squares by which the points in and about cell c are off its planes [m²]."""
    found, (x, place, _), total = room.found[:kinds], room.vectors, 0.0
    for i in rows:
        if not _is_about(windows.cells, c, i, x):
            continue
        least = np.inf
        for kind in range(kinds):
            if found[kind, 4] >= LIGHT * found[0, 4]:
                least = min(least, onto_plane(found, room.ends, kind, x, place))
        total += least
    return total

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
    Some,
    begin_among,
    begin_sweep,
    centre_of,
    gather,
    holds_any,
    look_around,
    some_of,
    some_within,
)
from gpdf_service.denoise.place import Placed, place_points
from gpdf_service.denoise.planes import THICK, Windows
from gpdf_service.denoise.turns import fit_by_turns, look_at, sum_known
from gpdf_service.denoise.votes import LIGHT, MOST, VOTES, Room, add_vote, cluster, collect, make_room, onto_plane
from gpdf_service.fields.shapes import FEWEST, add, fit_plane
from gpdf_service.fields.threads import run_chunked
from gpdf_service.kernel_cache import lean
from gpdf_service.types import FloatArray, IntArray

_RINGS = 3
"""Cells off its own that planes are taken from: a window clear of an edge is two off, all those around it three."""
_HALF = 1.0
"""[-] Cells to either side of a cell's middle whose points the planes must explain: half of them are its own."""


def place_at_edges(windows: Windows, placed: Placed) -> None:
    """Put the pending points of cells that the planes around explain onto these.

    Args:
        windows: Of the points; until now only cells where all around is flat have a main plane.
        placed: Where the points are; changed in place.
    """
    flat = some_of(windows.cells, windows.main[:, 4] > 0.0)
    run_chunked(lambda a, b: _edge_range(windows, flat, placed, a, b), len(windows.main))


@njit(cache=True, nogil=True)
def _edge_range(windows: Windows, flat: Some, placed: Placed, begin: int, end: int) -> None:
    cells, sigma, planes, _ = windows
    near, beside = np.empty(AROUND, np.int64), np.empty((2 * _RINGS + 1) ** 3, np.int64)
    room, own, rows = make_room(len(beside)), make_room(VOTES), np.empty(MOST, np.int64)
    at, wide = begin_sweep(cells, begin), begin_among(flat.key, cells, begin, _RINGS)
    for c in range(begin, end):
        if not holds_any(cells, c, placed.pending):
            continue
        count, (x, y, z) = 0, centre_of(cells, c)
        for j in beside[: some_within(flat, cells.key[c], _RINGS, wide, beside)]:
            plane, (a, b, d) = planes[flat.cell[j], 0], flat.middle[j]
            count = add_vote(plane, (a - x, b - y, d - z), cells.width, sigma, room.cast, count)
        if count == 0:
            continue
        look_around(cells, c, at, near)
        about = room.about[:, : look_at(cells, c, rows[: gather(cells, near, rows)], room)]
        number = _count_near(about, _HALF * cells.width)
        kinds = cluster(room, count, cells.width, sigma) if number >= FEWEST else 0
        most = _explained(sigma, number)
        if kinds == 0 or (kinds == 1 and _thickness(about, _HALF * cells.width, room) > most):
            continue
        sum_known(room.found[:kinds], cells.width, sigma, room.known)
        fit_by_turns(sigma, cells.width, room, about.shape[1], kinds)
        rest = _rest(about, _HALF * cells.width, room, kinds)
        if rest <= most and not _bends(windows, near, about, own, kinds, rest):
            place_points(windows, c, room, kinds, placed)


@lean()
def _bends(windows: Windows, near: IntArray, about: FloatArray, room: Room, kinds: int, rest: float) -> bool:
    """Whether no more planes, of the windows right around, leave less: then the surface bends, and goes not on."""
    own = cluster(room, collect(windows, near, room.cast), windows.cells.width, windows.sigma)
    if own == 0 or own > kinds:
        return own == 0
    return bool(_rest(about, _HALF * windows.cells.width, room, own) < rest)


@lean()
def _explained(sigma: float, number: int) -> float:
    """Sum of the squares by which the noise has so many points off their planes, at most [m²]."""
    return sigma**2 * (number + THICK * sqrt(2.0 * number))


@lean()
def _count_near(about: FloatArray, half: float) -> int:
    """How many of the points about a cell its planes must explain."""
    number = 0
    for k in range(about.shape[1]):
        number += _is_near(about, k, half)
    return number


@lean()
def _thickness(about: FloatArray, half: float, room: Room) -> float:
    """What no one plane can leave less of than of the points near a cell [m²]."""
    moments, (place, normal, _) = room.sums[0], room.vectors
    moments[:] = 0.0
    for k in range(about.shape[1]):
        if _is_near(about, k, half):
            add(moments, about[0, k], about[1, k], about[2, k])
    return float(moments[0] * fit_plane(moments, place, normal)[0])


@lean()
def _is_near(about: FloatArray, k: int, half: float) -> bool:
    """Whether the planes of a cell must explain a point about it."""
    return bool(max(abs(about[0, k]), abs(about[1, k]), abs(about[2, k])) <= half)


@lean()
def _rest(about: FloatArray, half: float, room: Room, kinds: int) -> float:
    """Sum of the squares by which the points near a cell are off its planes [m²]."""
    found, (_, place, _), total = room.found[:kinds], room.vectors, 0.0
    for k in range(about.shape[1]):
        if not _is_near(about, k, half):
            continue
        least = np.inf
        for kind in range(kinds):
            if found[kind, 4] >= LIGHT * found[0, 4]:
                least = min(least, onto_plane(found, room.ends, kind, about[:, k], place))
        total += least
    return total

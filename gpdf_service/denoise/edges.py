"""Planes that go on to where they meet: what a cell at an edge holds, told by the planes clear of it.

No window at an edge is one plane. But walls, floors and the sides of boxes are known well a little further off, and
where they, each ended at the others, leave of the cell's points what the noise explains, they are what is there.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gpdf_service.denoise.cells import (
    AROUND,
    Cells,
    begin_sweep,
    cells_within,
    centre_of,
    gather_all,
    holds_any,
    look_around,
)
from gpdf_service.denoise.place import Placed, place_points
from gpdf_service.denoise.planes import THICK, Planes
from gpdf_service.denoise.turns import fit_by_turns, sum_known
from gpdf_service.denoise.votes import (
    FOUND,
    KINDS,
    LIGHT,
    VOTE,
    VOTES,
    add_vote,
    cluster,
    collect,
    find_ends,
    onto_plane,
)
from gpdf_service.fields.shapes import FEWEST
from gpdf_service.fields.threads import run_chunked
from gpdf_service.types import BoolArray, FloatArray, IntArray

_RINGS = 3
"""Cells off its own that planes are taken from: a window clear of an edge is two off, all those around it three."""
_MOST = 400
"""Points of a window that planes are fitted to."""
_HALF = 1.0
"""[-] Cells to either side of a cell's middle whose points the planes must explain: half of them are its own."""


def place_at_edges(cells: Cells, planes: Planes, sigma: float, placed: Placed, main: NDArray[np.float32]) -> None:
    """Put the pending points of cells that the planes around explain onto these.

    Args:
        cells: Of the points.
        planes: Of their windows.
        sigma: Noise of the points [m].
        placed: Where the points are; changed in place.
        main: See `place_in_cells`: until now only of cells where all around is flat; written.
    """
    flat = main[:, 4] > 0.0
    run_chunked(lambda a, b: _edge_range(cells, planes, flat, sigma, placed, a, b, main), len(cells.key))


@njit(cache=True, nogil=True)
def _edge_range(
    cells: Cells,
    planes: Planes,
    flat: BoolArray,
    sigma: float,
    placed: Placed,
    begin: int,
    end: int,
    main: NDArray[np.float32],
) -> None:
    near, beside = np.empty(AROUND, np.int64), np.empty((2 * _RINGS + 1) ** 3, np.int64)
    votes, of = np.empty((len(beside), VOTE)), np.empty(len(beside), np.int64)
    found, ends, number = np.empty((KINDS, FOUND)), np.empty((KINDS, KINDS)), np.empty(KINDS, np.int64)
    rows, room = np.empty(_MOST, np.int64), (np.empty((KINDS, 10)), np.empty(3), np.empty(3), np.empty(3))
    known, at = np.empty((KINDS, 10)), begin_sweep(cells, begin)
    for c in range(begin, end):
        if not holds_any(cells, c, placed.pending):
            continue
        count, (x, y, z) = 0, centre_of(cells, c)
        for j in beside[: cells_within(cells, c, _RINGS, beside)]:
            if flat[j]:
                a, b, d = centre_of(cells, j)
                count = add_vote(planes[j, 0], (a - x, b - y, d - z), cells.width, sigma, votes, count)
        if count == 0:
            continue
        kinds = cluster(votes, count, sigma, of, found)
        if kinds == 0:
            continue
        find_ends(votes, count, of, found, kinds, cells.width, ends)
        look_around(cells, c, at, near)
        own = rows[: gather_all(cells, near, rows)]
        sum_known(found[:kinds], cells.width, sigma, known)
        fit_by_turns(cells, c, own, sigma, found[:kinds], ends, known[:kinds], room)
        rest, most = _rest(cells, c, own, found[:kinds], ends, sigma, room[1], room[2])
        if rest > most or _bends(cells, c, near, own, planes, sigma, kinds, rest, room):
            continue
        place_points(cells, c, found[:kinds], ends, sigma, placed, number, main[c])


@njit(cache=True, nogil=True)
def _bends(
    cells: Cells,
    c: int,
    near: IntArray,
    rows: IntArray,
    planes: Planes,
    sigma: float,
    kinds: int,
    rest: float,
    room: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
) -> bool:
    """Whether no more planes, of the windows right around, leave less: then the surface bends, and goes not on."""
    votes, of = np.empty((VOTES, VOTE)), np.empty(VOTES, np.int64)
    found, ends = np.empty((KINDS, FOUND)), np.empty((KINDS, KINDS))
    count = collect(cells, near, planes, sigma, votes)
    own = cluster(votes, count, sigma, of, found)
    if own == 0 or own > kinds:
        return own == 0
    find_ends(votes, count, of, found, own, cells.width, ends)
    return bool(_rest(cells, c, rows, found[:own], ends, sigma, room[1], room[2])[0] < rest)


@njit(cache=True, nogil=True)
def _rest(
    cells: Cells,
    c: int,
    rows: IntArray,
    found: FloatArray,
    ends: FloatArray,
    sigma: float,
    x: FloatArray,
    place: FloatArray,
) -> tuple[float, float]:
    """Sum of the squares by which the points in and about cell c are off its planes, and what the noise explains."""
    (a, b, d), total, count = centre_of(cells, c), 0.0, 0
    for i in rows:
        x[0], x[1], x[2] = cells.places[i, 0] - a, cells.places[i, 1] - b, cells.places[i, 2] - d
        if max(abs(x[0]), abs(x[1]), abs(x[2])) > _HALF * cells.width:
            continue
        least = np.inf
        for kind in range(len(found)):
            if found[kind, 4] >= LIGHT * found[0, 4]:
                least = min(least, onto_plane(found, len(found), ends, kind, x, place))
        total, count = total + least, count + 1
    return total, sigma**2 * (count + THICK * sqrt(2.0 * count)) if count >= FEWEST else -1.0

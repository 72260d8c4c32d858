"""Points that noise carried off a surface or past its end, alone: each goes back to the nearest place that is not.

Of a surface seen with a Gaussian error hardly any points are far off it, so around one of them there are few others,
though the surface beside is full of them. A thing has company: what has more of it than the noise's tail stays.
"""

from __future__ import annotations

from math import pi

import numpy as np
from numba import njit

from gpdf_service.denoise.cells import AROUND, Cells, begin_sweep, cells_within, look_around, sort_into_cells
from gpdf_service.denoise.place import Placed
from gpdf_service.fields.shapes import FEWEST
from gpdf_service.fields.threads import run_chunked
from gpdf_service.types import FloatArray, IntArray

_FURTHEST = 4.0
"""[-] Standard deviations that noise carries a point: one in 16 000 goes further."""
_RINGS = 2
"""Cells off its own that a point's surface is looked for in: 4 σ."""
_FEW = 0.25
"""[-] Of the points of a cell of the surface, that a cell beside it holds at most where no surface crosses it."""
_TAIL = 0.04
"""[-] Points around one that noise carried off a surface or past its end, over those of a disc of the surface as wide:
two deviations past an end they are 0.02 to 0.04. Where more are, there is a thing. A disc of fewer than 25 points tells
nothing: a point alone beside it may be one of a thing that is seen as sparsely."""


def draw_back(placed: Placed, width: float, sigma: float) -> None:
    """Move points that are alone beside a surface onto it.

    Args:
        placed: Where the points are; changed in place.
        width: Of the cells, and how far company can be [m].
        sigma: Noise of the points [m].
    """
    cells = sort_into_cells(placed.points, width)
    chosen = np.full(len(placed.points), -1, np.int64)
    run_chunked(lambda a, b: _tail_range(cells, sigma, a, b, chosen), len(cells.key))
    alone = np.flatnonzero(chosen >= 0)
    beside = chosen[alone]
    placed.points[alone], placed.normal[alone] = placed.points[beside], placed.normal[beside]
    placed.error[alone], placed.pending[alone] = placed.error[beside], placed.pending[beside]


@njit(cache=True, nogil=True)
def _tail_range(cells: Cells, sigma: float, begin: int, end: int, chosen: IntArray) -> None:
    beside, near, at = np.empty((2 * _RINGS + 1) ** 3, np.int64), np.empty(AROUND, np.int64), begin_sweep(cells, begin)
    for c in range(begin, end):
        look_around(cells, c, at, near)
        most, own = 0, cells.begin[c + 1] - cells.begin[c]
        for j in near:
            if j >= 0:
                most = max(most, int(cells.begin[j + 1] - cells.begin[j]))
        if own > max(_FEW * most, 1):
            continue
        count = cells_within(cells, c, _RINGS, beside)
        for i in range(cells.begin[c], cells.begin[c + 1]):
            full, k = _nearest(cells, beside[:count], cells.places[i], max(own / _FEW, FEWEST / pi), sigma)
            if k >= 0:
                tail = _TAIL * pi * (cells.begin[full + 1] - cells.begin[full])
                if _company(cells, near, cells.places[i], cells.places[k]) <= tail:
                    chosen[cells.order[i]] = cells.order[k]


@njit(cache=True, nogil=True)
def _company(cells: Cells, near: IntArray, x: FloatArray, surface: FloatArray) -> int:
    """Points within a cell's width of x, itself one of them, that are nearer to x than to a place of the surface."""
    count, (a, b, c) = 0, (surface[0] - x[0], surface[1] - x[1], surface[2] - x[2])
    half = 0.5 * (a * a + b * b + c * c)
    for j in near:
        if j >= 0:
            for i in range(cells.begin[j], cells.begin[j + 1]):
                y = cells.places[i]
                u, v, w = y[0] - x[0], y[1] - x[1], y[2] - x[2]
                count += u * u + v * v + w * w <= cells.width**2 and a * u + b * v + c * w < half
    return count


@njit(cache=True, nogil=True)
def _nearest(cells: Cells, beside: IntArray, x: FloatArray, least: float, sigma: float) -> tuple[int, int]:
    """The nearest point of the cells that hold `least` points, and its cell; -1 where none is near."""
    square, cell, best = (_FURTHEST * sigma) ** 2, -1, -1
    for j in beside:
        if cells.begin[j + 1] - cells.begin[j] < least:
            continue
        for i in range(cells.begin[j], cells.begin[j + 1]):
            y = cells.places[i]
            off = (x[0] - y[0]) ** 2 + (x[1] - y[1]) ** 2 + (x[2] - y[2]) ** 2
            if off < square:
                square, cell, best = off, j, i
    return cell, best

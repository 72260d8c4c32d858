"""Planes of a cell where several meet, by turns: what share each has of each point, and each through its shares.

A window across an edge leans to both sides of it. Expectation maximisation tells the sides: a half-plane seen with the
error σ is as dense at a place as N(off its plane; σ²) Φ(how far it is inside its end / σ). Points that are given to the
nearest plane alone would draw each one to the side that it already leans to.
"""

from __future__ import annotations

from math import erf, exp, sqrt

from gpdf_service.denoise.cells import centre_of
from gpdf_service.denoise.planes import Windows
from gpdf_service.denoise.votes import Room
from gpdf_service.fields.shapes import FEWEST, fit_plane
from gpdf_service.kernel_cache import lean
from gpdf_service.types import FloatArray, IntArray

_TURNS = 5
"""Of shares and planes: then few change."""
_SETTLED = 0.02
"""[-] Of the noise: planes that move by less in a turn are where they will be, to a tenth of their own error."""
_NONE = 0.01
"""[-] Density of what is of none of the planes, over that on one: a point three deviations off is as likely either."""
_NOWHERE = 4.0
"""[-] Standard deviations beyond which a plane has no density worth a share: one point in 16 000 is further."""
_WIDE = 1.2
"""[-] λ₂ over λ₁ that points show a direction from: those of half a window have 1.3."""
_TURNED = 0.9
"""[-] Cosine of the angle (26°) that a plane can turn by: further, its points were another's."""


@lean()
def fit_by_turns(windows: Windows, c: int, rows: IntArray, room: Room, kinds: int) -> None:
    """Move the first `kinds` planes in the room, those of cell c, onto their shares of the points at places `rows`."""
    cells, sigma, found, sums = windows.cells, windows.sigma, room.found[:kinds], room.sums
    x, place, normal = room.vectors
    a, b, d = centre_of(cells, c)
    shares, slants = room.shares, room.slants
    for _ in range(_TURNS):
        for kind in range(kinds):
            for k in range(10):
                sums[kind, k] = room.known[kind, k]
        _find_slants(found, room.ends, sigma, slants)
        for i in rows:
            x[0], x[1], x[2] = cells.places[i, 0] - a, cells.places[i, 1] - b, cells.places[i, 2] - d
            whole = _NONE
            for kind in range(kinds):
                shares[kind] = _density(found, slants, kind, x, sigma)
                whole += shares[kind]
            for kind in range(kinds):
                if shares[kind] > 0.0:
                    _add_share(sums[kind], shares[kind] / whole, x)
        moved = 0.0
        for kind in range(kinds):
            if sums[kind, 0] < FEWEST:
                continue
            low, middle, _ = fit_plane(sums[kind], place, normal)
            turn = normal[0] * found[kind, 0] + normal[1] * found[kind, 1] + normal[2] * found[kind, 2]
            if middle < _WIDE * low or abs(turn) < _TURNED:
                continue
            sign, height = (1.0 if turn > 0.0 else -1.0), found[kind, 3]
            found[kind, 3] = 0.0
            for k in range(3):
                found[kind, k] = sign * normal[k]
                found[kind, 3] += sign * normal[k] * place[k]
            moved = max(moved, abs(found[kind, 3] - height) + cells.width * sqrt(max(0.0, 2.0 - 2.0 * abs(turn))))
        if moved < _SETTLED * sigma:
            break


@lean()
def _find_slants(found: FloatArray, ends: FloatArray, sigma: float, slants: FloatArray) -> None:
    """Write for each two planes the cosine of their angle and ±1 over the error at their edge [1/m], 0 if none is."""
    for i in range(len(found)):
        for j in range(len(found)):
            slant = found[i, 0] * found[j, 0] + found[i, 1] * found[j, 1] + found[i, 2] * found[j, 2]
            slants[i, j, 0] = slant
            slants[i, j, 1] = ends[i, j] / (sigma * sqrt(max(1.0 - slant * slant, 1e-6)))


@lean()
def sum_known(found: FloatArray, width: float, sigma: float, known: FloatArray) -> None:
    """Write the sums of as many points on each plane as its heaviest vote is worth at a cell so wide."""
    for kind in range(len(found)):
        plane, n, m = found[kind], found[kind, 5], known[kind]
        along, across = width**2, sigma**2 - width**2 + plane[3] ** 2
        m[0], m[1], m[2], m[3] = n, n * plane[3] * plane[0], n * plane[3] * plane[1], n * plane[3] * plane[2]
        for k in range(3):
            m[4 + k] = n * (along + across * plane[k] ** 2)
        m[7], m[8] = n * across * plane[0] * plane[1], n * across * plane[0] * plane[2]
        m[9] = n * across * plane[1] * plane[2]


@lean()
def _density(found: FloatArray, slants: FloatArray, i: int, x: FloatArray, sigma: float) -> float:
    """Of plane i, as far as it goes, at x, over that on it; the `slants` are from `_find_slants`."""
    off = x[0] * found[i, 0] + x[1] * found[i, 1] + x[2] * found[i, 2] - found[i, 3]
    if abs(off) > _NOWHERE * sigma:
        return 0.0
    density = exp(-0.5 * (off / sigma) ** 2)
    for j in range(len(found)):
        if slants[i, j, 1] == 0.0:
            continue
        beside = x[0] * found[j, 0] + x[1] * found[j, 1] + x[2] * found[j, 2] - found[j, 3]
        inside = (beside - slants[i, j, 0] * off) * slants[i, j, 1]
        if inside < -_NOWHERE:
            return 0.0
        if inside < _NOWHERE:
            density *= 0.5 * (1.0 + erf(inside * sqrt(0.5)))
    return density


@lean()
def _add_share(m: FloatArray, share: float, x: FloatArray) -> None:
    """`add` a share of a point."""
    a, b, c = x[0], x[1], x[2]
    m[0] += share
    m[1] += share * a
    m[2] += share * b
    m[3] += share * c
    m[4] += share * a * a
    m[5] += share * b * b
    m[6] += share * c * c
    m[7] += share * a * b
    m[8] += share * a * c
    m[9] += share * b * c

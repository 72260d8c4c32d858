"""Planes of a cell where several meet, by turns: what share each has of each point, and each through its shares.

A window across an edge leans to both sides of it. Expectation maximisation tells the sides: a half-plane seen with the
error σ is as dense at a place as N(off its plane; σ²) Φ(how far it is inside its end / σ). Points that are given to the
nearest plane alone would draw each one to the side that it already leans to.
"""

from __future__ import annotations

from math import sqrt

from gpdf_service.denoise.votes import KINDS, Room
from gpdf_service.fields.shapes import FEWEST, fit_plane
from gpdf_service.fields.traversal import decay
from gpdf_service.fields.tree import VECTORS, lesser
from gpdf_service.kernel_cache import lean
from gpdf_service.types import FloatArray

Three = tuple[FloatArray, FloatArray, FloatArray]
"""x, y and z from a cell's middle [m], shape (n,) each."""
_TURNS = 5
"""Of shares and planes: then few change."""
_SETTLED = 0.02
"""[-] Of the noise: planes that move by less in a turn are where they will be, to a tenth of their own error."""
_NONE = 0.01
"""[-] Density of what is of none of the planes, over that on one: a point three deviations off is as likely either."""
_NOWHERE = 4.0
"""[-] Standard deviations beyond which a plane has no density worth a share: one point in 16 000 is further."""
_LEAST = 0.5 * _NOWHERE**2
"""[-] Exponent of the density there."""
_WIDE = 1.2
"""[-] λ₂ over λ₁ that points show a direction from: those of half a window have 1.3."""
_TURNED = 0.9
"""[-] Cosine of the angle (26°) that a plane can turn by: further, its points were another's."""


@lean()
def fit_by_turns(sigma: float, width: float, room: Room, number: int, kinds: int) -> None:
    """Move the first `kinds` planes in the room onto their shares of the `number` points that are."""
    found, (place, normal, _) = room.found[:kinds], room.vectors
    for _ in range(_TURNS):
        _share_out(found, sigma, room, number)
        moved = 0.0
        for kind in range(kinds):
            sums, plane = room.sums[kind], found[kind]
            if sums[0] < FEWEST:
                continue
            low, middle, _ = fit_plane(sums, place, normal)
            turn = normal[0] * plane[0] + normal[1] * plane[1] + normal[2] * plane[2]
            if middle < _WIDE * low or abs(turn) < _TURNED:
                continue
            sign, height = (1.0 if turn > 0.0 else -1.0), plane[3]
            plane[3] = 0.0
            for k in range(3):
                plane[k] = sign * normal[k]
                plane[3] += sign * normal[k] * place[k]
            moved = max(moved, abs(plane[3] - height) + width * sqrt(max(0.0, 2.0 - 2.0 * abs(turn))))
        if moved < _SETTLED * sigma:
            break


@lean()
def _share_out(found: FloatArray, sigma: float, room: Room, number: int) -> None:
    """Write the sums of each plane's shares, and of what is known of it."""
    about = room.about[0, :number], room.about[1, :number], room.about[2, :number]
    whole = room.shares[KINDS, :number]
    whole[:] = _NONE
    _find_slants(found, room.ends, sigma, room.slants)
    for i in range(len(found)):
        density = room.shares[i, :number]
        _find_density(found[i], sigma, about, density)
        for j in range(len(found)):
            if room.slants[i, j, 1] != 0.0:
                _end_density(found[i], found[j], room.slants[i, j], about, density)
        for k in range(number):
            whole[k] += density[k]
    for i in range(len(found)):
        _sum_shares(room.shares[i, :number], whole, about, room.known[i], room.sums[i])


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


@lean(fastmath=VECTORS)
def _find_density(plane: FloatArray, sigma: float, about: Three, density: FloatArray) -> None:
    """Write that of a plane without an end at each point, over that on it, shape (n,)."""
    x, y, z = about
    a, b, c, height = plane[0] / sigma, plane[1] / sigma, plane[2] / sigma, plane[3] / sigma
    for k in range(len(density)):
        t = 0.5 * (x[k] * a + y[k] * b + z[k] * c - height) ** 2
        near = decay(lesser(t, _LEAST))
        density[k] = near if t <= _LEAST else 0.0


@lean(fastmath=VECTORS, error_model="numpy")
def _end_density(plane: FloatArray, other: FloatArray, slant: FloatArray, about: Three, density: FloatArray) -> None:
    """Multiply that of a plane by Φ of how far each point is inside its end at the other one; Hastings 1955, to 1e-7.

    The `slant` is from `_find_slants`.
    """
    (x, y, z), (cosine, per) = about, slant
    a, b, c = (
        (other[0] - cosine * plane[0]) * per,
        (other[1] - cosine * plane[1]) * per,
        (other[2] - cosine * plane[2]) * per,
    )
    height = (other[3] - cosine * plane[3]) * per
    for k in range(len(density)):
        inside = x[k] * a + y[k] * b + z[k] * c - height
        off = lesser(abs(inside), _NOWHERE)
        t = 1.0 / (1.0 + 0.2316419 * off)
        series = 0.7107068705 + t * (-0.7265760135 + t * 0.5307027145)
        tail = decay(0.5 * off * off) * t * (0.127414796 + t * (-0.142248368 + t * series))
        tail = tail if off < _NOWHERE else 0.0
        density[k] *= tail if inside < 0.0 else 1.0 - tail


@lean(fastmath=VECTORS, error_model="numpy")
def _sum_shares(density: FloatArray, whole: FloatArray, about: Three, known: FloatArray, m: FloatArray) -> None:
    """Write what is `known`, shape (10,), and the shares of the points: `add`."""
    x, y, z = about
    m0, m1, m2, m3, m4, m5, m6, m7, m8, m9 = known
    for k in range(len(density)):
        share, a, b, c = density[k] / whole[k], x[k], y[k], z[k]
        m0 += share
        m1 += share * a
        m2 += share * b
        m3 += share * c
        m4 += share * a * a
        m5 += share * b * b
        m6 += share * c * c
        m7 += share * a * b
        m8 += share * a * c
        m9 += share * b * c
    m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8], m[9] = m0, m1, m2, m3, m4, m5, m6, m7, m8, m9

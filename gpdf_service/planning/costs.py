"""The three costs of the modified CHOMP, each with its gradient; waypoints are the body's top. Uttsha et al. 2024."""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
from numba import njit

from gpdf_service.fields import AnyField
from gpdf_service.fields.traversal import sample_at
from gpdf_service.fields.tree import Scratch, make_scratch
from gpdf_service.types import FloatArray

OFF = 2e-4
"""[m] An answer of a field is taken on along its gradient g as long as it stays this good: a step s away the distance
d to a place is d + g·s + s² / 2d at most, so within s² ≤ 2d × `OFF` (1 cm at 25 cm). The field itself is as good."""
GROUND_OFF = 1e-2
"""[-] The same of the ground, as a share of the body's height: a tenth of what its top may be off."""


class Discs(NamedTuple):
    """A body in plan: where its discs are, ahead of its centre [m], shape (k,), and their radius [m]."""

    offsets: FloatArray
    radius: float


class Memo(NamedTuple):
    """What a field said last for each waypoint, or for each disc at each waypoint.

    Attributes:
        place: Where it was asked [m], shape (n, dim); NaN before it was.
        distance: Shape (n,) [m]; a lower bound of it where there is no slope.
        slope: Gradient of the distance, shape (n, dim); NaN where only a bound is known.
        scratch: Of the walk through the field.
    """

    place: FloatArray
    distance: FloatArray
    slope: FloatArray
    scratch: Scratch


@njit(cache=True, nogil=True)
def make_memo(count: int, dim: int) -> Memo:
    """Nothing asked yet, for `count` places."""
    return Memo(np.full((count, dim), np.nan), np.zeros(count), np.zeros((count, dim)), make_scratch())


@njit(cache=True, nogil=True)
def recall(field: AnyField, x: FloatArray, memo: Memo, i: int, enough: float, off: float = OFF) -> float:
    """Distance at x, the i-th place that is remembered, to `off`, and its gradient in `memo.slope[i]`.

    Distances are 1-Lipschitz: where the one from before says that there is `enough`, it is inf, and has no gradient.
    """
    dim = memo.place.shape[1]
    for j in range(i, max(i - 2, -1), -1):  # what the place before was told may do as well
        moved2, along = 0.0, 0.0
        for k in range(dim):
            step = x[k] - memo.place[j, k]
            moved2 += step * step
            along += memo.slope[j, k] * step
        good = moved2 <= 2.0 * off * memo.distance[j] and along == along  # a bound has no slope
        bound = memo.distance[j] - sqrt(moved2)
        if not (good or bound >= enough):  # a NaN compares false
            continue
        if j < i:
            memo.distance[i] = memo.distance[j] if good else bound
            for k in range(dim):
                memo.place[i, k] = memo.place[j, k] if good else x[k]
                memo.slope[i, k] = memo.slope[j, k] if good else np.nan
        return float(memo.distance[j] + along) if good else np.inf
    for k in range(dim):
        memo.place[i, k] = x[k]
    place = (x[0], x[1], x[2] if dim == 3 else 0.0)
    memo.distance[i] = sample_at(field, place, memo.scratch, memo.slope[i])
    return float(memo.distance[i])


@njit(cache=True, nogil=True)
def smoothness_cost(xi: FloatArray, spacing: float, weight: float, gradient: FloatArray, band: FloatArray) -> float:
    """Σ λ_s ½ ‖ẋ‖² ds with ẋ = Δx/ds [m]; adds to `gradient`, shape (n, 3), and to its derivative in `band`."""
    total, stiff = 0.0, weight / spacing
    for i in range(xi.shape[0] - 1):
        for k in range(3):
            step = xi[i + 1, k] - xi[i, k]
            total += 0.5 * stiff * step * step
            gradient[i + 1, k] += stiff * step
            gradient[i, k] -= stiff * step
            band[i, k, 0] += stiff
            band[i + 1, k, 0] += stiff
            band[i + 1, k, 3] -= stiff
    return total


@njit(cache=True, nogil=True)
def obstacle_cost(
    xi: FloatArray,
    spacing: float,
    field: AnyField,
    discs: Discs,
    epsilon: float,
    wall: float,
    memo: Memo,
    gradient: FloatArray,
    band: FloatArray,
) -> float:
    """Σ c_o(x) ‖ẋ‖ ds, c_o = (d − ε)² / 2ε below ε, with d = d_o(x, y) − radius, and −d + ε/2 where d < 0 [m].

    There a `wall` [1/m] adds wall · d² / 2: the paper's slope of 1 alone lets a taut path cut into what it goes round.

    A body of discs pays for each of them: the one that lies o ahead is at x + o ẋ/‖ẋ‖, for the body faces where it
    goes; so the neighbours that say where that is take part in its gradient. Of a cylinder there is one, at o = 0.

    ‖ẋ‖ as in CHOMP (Ratliff et al. 2009): the paper prints ‖ẍ‖, which is zero on straight pieces and would let a
    straight path run through an obstacle at no cost. The gradient is CHOMP's: the part of ∇c across the way.
    """
    total, count = 0.0, len(discs.offsets)
    place = np.zeros(2)
    for i in range(1, xi.shape[0] - 1):
        tx, ty = xi[i + 1, 0] - xi[i - 1, 0], xi[i + 1, 1] - xi[i - 1, 1]
        length = sqrt(tx * tx + ty * ty)
        if length == 0.0:
            continue
        normal = -ty / length, tx / length
        for j in range(count):
            offset = discs.offsets[j]
            place[0], place[1] = xi[i, 0] + offset * normal[1], xi[i, 1] - offset * normal[0]
            d = recall(field, place, memo, i * count + j, discs.radius + epsilon) - discs.radius
            if d >= epsilon:
                continue
            cost, rate, stiff = (d - epsilon) ** 2 / (2.0 * epsilon), (d - epsilon) / epsilon, 1.0 / epsilon
            if d < 0.0:
                cost, rate, stiff = epsilon / 2.0 - d + 0.5 * wall * d * d, wall * d - 1.0, stiff + wall
            total += cost * 0.5 * length
            slope = memo.slope[i * count + j]
            across = slope[0] * normal[0] + slope[1] * normal[1]
            pull, bend = rate * across * spacing, stiff * across * across * spacing
            lever = offset / length
            for m, one in ((i - 1, -lever), (i, 1.0), (i + 1, lever)):
                for k in range(2):
                    gradient[m, k] += pull * one * normal[k]
                    for n, two in ((i - 1, -lever), (i, 1.0), (i + 1, lever)):
                        for q in range(2):
                            p = 3 * (m - n) + k - q
                            if p >= 0 and one * two != 0.0:
                                band[m, k, p] += bend * one * two * normal[k] * normal[q]
    return total


@njit(cache=True, nogil=True)
def ground_cost(
    xi: FloatArray,
    spacing: float,
    field: AnyField,
    height: float,
    memo: Memo,
    gradient: FloatArray,
    band: FloatArray,
) -> float:
    """Σ (d_g(x) − h)² / 2h ds [m²]: keeps the body's top at body height over the ground."""
    total = 0.0
    for i in range(1, xi.shape[0] - 1):
        off = recall(field, xi[i], memo, i, np.inf, GROUND_OFF * height) - height
        total += off * off / (2.0 * height) * spacing
        for k in range(3):
            gradient[i, k] += off / height * memo.slope[i, k] * spacing
            for p in range(k + 1):
                band[i, k, p] += memo.slope[i, k] * memo.slope[i, k - p] * spacing / height
    return total

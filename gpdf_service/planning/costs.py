"""The three costs of the modified CHOMP, each with its gradient; waypoints are the body's top. Uttsha et al. 2024."""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
from numba import njit

from gpdf_service.fields import NearerArrays
from gpdf_service.fields.traversal import sample_at
from gpdf_service.fields.tree import Place, Scratch, make_scratch
from gpdf_service.kernel_cache import lean
from gpdf_service.types import FloatArray

OFF = 2e-4
"""[m] An answer of a field is taken on along its gradient g as long as it stays this good: a step s away the distance
d to a place is d + g·s + s² / 2d at most, so within s² ≤ 2d × `OFF` (1 cm at 25 cm). The field itself is as good."""
GROUND_OFF = 3e-2
"""[-] The same of the ground, as a share of the body's height: a third of what its top may be off."""


class Discs(NamedTuple):
    """A body in plan: where its discs are, ahead of its centre [m], shape (k,), and their radius [m]."""

    offsets: FloatArray
    radius: float


class Task(NamedTuple):
    """What the costs are of; see `chomp.optimize`; and the waypoints' `spacing` [m]."""

    obstacles: NearerArrays
    ground: NearerArrays
    discs: Discs
    height: float
    epsilon: float
    wall: float
    smoothness_weight: float
    spacing: float
    level: bool = False


class Memo(NamedTuple):
    """What a field said last for each waypoint, or for each disc at each waypoint.

    Attributes:
        place: Where it was asked [m], shape (n, 3); NaN before it was.
        distance: Shape (n,) [m]; a lower bound of it where there is no slope.
        slope: Gradient of the distance, shape (n, 3); NaN where only a bound is known.
        scratch: Of the walk through the field.
    """

    place: FloatArray
    distance: FloatArray
    slope: FloatArray
    scratch: Scratch


@njit(cache=True, nogil=True)
def make_memo(count: int) -> Memo:
    """Nothing asked yet, for `count` places."""
    return Memo(np.full((count, 3), np.nan), np.zeros(count), np.zeros((count, 3)), make_scratch())


@lean()
def recall(field: NearerArrays, x: Place, memo: Memo, i: int, enough: float, off: float = OFF) -> float:
    """Distance at x, the i-th place that is remembered, to `off`, and its gradient in `memo.slope[i]`.

    Distances are 1-Lipschitz: where the one from before says that there is `enough`, it is inf, and has no gradient.
    """
    told = _told(memo.place, memo.distance, memo.slope, i, x, enough, off)
    return told if told == told else _ask(field, x, memo, i, enough)


@lean()
def _told(
    place: FloatArray, distance: FloatArray, slope: FloatArray, i: int, x: Place, enough: float, off: float
) -> float:
    """`recall` of what was told before; NaN where that does not do. It takes arrays, for a tuple of them is counted."""
    for j in range(i, max(i - 2, -1), -1):  # what the place before was told may do as well
        s0, s1, s2 = x[0] - place[j, 0], x[1] - place[j, 1], x[2] - place[j, 2]
        moved2, along = s0 * s0 + s1 * s1 + s2 * s2, s0 * slope[j, 0] + s1 * slope[j, 1] + s2 * slope[j, 2]
        good = moved2 <= 2.0 * off * distance[j] and along == along  # a bound has no slope
        bound = distance[j] - sqrt(moved2)
        if not (good or bound >= enough):  # a NaN compares false
            continue
        if j < i:
            distance[i] = distance[j] if good else bound
            for k in range(3):
                place[i, k] = place[j, k] if good else x[k]
                slope[i, k] = slope[j, k] if good else np.nan
        return float(distance[j] + along) if good else np.inf
    return np.nan


@lean()
def _ask(field: NearerArrays, x: Place, memo: Memo, i: int, enough: float) -> float:
    """Distance at x, which is remembered, and its gradient; inf where a bound, which has none, tells of `enough`."""
    for k in range(3):
        memo.place[i, k] = x[k]
    memo.distance[i] = sample_at(field, x, memo.scratch, memo.slope[i], enough)
    return float(memo.distance[i]) if memo.slope[i, 0] == memo.slope[i, 0] else np.inf


@lean()
def smoothness_cost(xi: FloatArray, task: Task, gradient: FloatArray, band: FloatArray) -> float:
    """Σ λ_s ½ ‖ẋ‖² ds with ẋ = Δx/ds [m]; adds to `gradient`, shape (n, 3), and to its derivative in `band`."""
    total, stiff = 0.0, task.smoothness_weight / task.spacing
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


@lean()
def obstacle_cost(xi: FloatArray, task: Task, memo: Memo, gradient: FloatArray, band: FloatArray) -> float:
    """Σ c_o(x) ‖ẋ‖ ds, c_o = (d − ε)² / 2ε below ε, with d = d_o(x, y) − radius, and −d + ε/2 where d < 0 [m].

    There a `wall` [1/m] adds wall · d² / 2: the paper's slope of 1 alone lets a taut path cut into what it goes round.

    A body of discs pays for each of them: the one that lies o ahead is at x + o ẋ/‖ẋ‖, for the body faces where it
    goes; so the neighbours that say where that is take part in its gradient. Of a cylinder there is one, at o = 0.

    ‖ẋ‖ as in CHOMP (Ratliff et al. 2009): the paper prints ‖ẍ‖, which is zero on straight pieces and would let a
    straight path run through an obstacle at no cost. The gradient is CHOMP's: the part of ∇c across the way.
    """
    (offsets, radius), epsilon, wall, spacing, total = task.discs, task.epsilon, task.wall, task.spacing, 0.0
    known, distance, slope = memo.place, memo.distance, memo.slope
    for i in range(1, xi.shape[0] - 1):
        tx, ty = xi[i + 1, 0] - xi[i - 1, 0], xi[i + 1, 1] - xi[i - 1, 1]
        length = sqrt(tx * tx + ty * ty)
        if length == 0.0:
            continue
        normal = -ty / length, tx / length
        for j in range(len(offsets)):
            place = xi[i, 0] + offsets[j] * normal[1], xi[i, 1] - offsets[j] * normal[0], 0.0
            row = i * len(offsets) + j
            d = _told(known, distance, slope, row, place, radius + epsilon, OFF)
            d = (d if d == d else _ask(task.obstacles, place, memo, row, radius + epsilon)) - radius
            if d >= epsilon:
                continue
            paid, rate, stiff = (d - epsilon) ** 2 / (2.0 * epsilon), (d - epsilon) / epsilon, 1.0 / epsilon
            if d < 0.0:
                paid, rate, stiff = epsilon / 2.0 - d + 0.5 * wall * d * d, wall * d - 1.0, stiff + wall
            total += paid * 0.5 * length
            across = slope[row, 0] * normal[0] + slope[row, 1] * normal[1]
            pull, bend = rate * across * spacing, stiff * across * across * spacing
            _spread(i, offsets[j] / length, normal, pull, bend, gradient, band)
    return total


@lean()
def _spread(
    i: int,
    lever: float,
    normal: tuple[float, float],
    pull: float,
    bend: float,
    gradient: FloatArray,
    band: FloatArray,
) -> None:
    """Add a `pull` across the way at a waypoint, and its derivative, to whom it moves: the neighbours by a lever."""
    reach = 1 if lever != 0.0 else 0
    for m in range(-reach, reach + 1):
        one = 1.0 if m == 0 else m * lever
        for k in range(2):
            gradient[i + m, k] += pull * one * normal[k]
            for n in range(-reach, m + 1):
                two = 1.0 if n == 0 else n * lever
                for q in range(2):
                    p = 3 * (m - n) + k - q
                    if p >= 0:
                        band[i + m, k, p] += bend * one * two * normal[k] * normal[q]


@lean()
def ground_cost(xi: FloatArray, task: Task, memo: Memo, gradient: FloatArray, band: FloatArray) -> float:
    """Σ (d_g(x) − h)² / 2h ds [m²]: keeps the body's top at body height over the ground."""
    height, spacing, total = task.height, task.spacing, 0.0
    known, distance, slope = memo.place, memo.distance, memo.slope
    for i in range(1, xi.shape[0] - 1):
        top = xi[i, 0], xi[i, 1], xi[i, 2]
        d = _told(known, distance, slope, i, top, np.inf, GROUND_OFF * height)
        off = (d if d == d else _ask(task.ground, top, memo, i, np.inf)) - height
        total += off * off / (2.0 * height) * spacing
        for k in range(3):
            gradient[i, k] += off / height * slope[i, k] * spacing
            for p in range(k + 1):
                band[i, k, p] += slope[i, k] * slope[i, k - p] * spacing / height
    return total

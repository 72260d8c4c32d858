"""The three costs of the modified CHOMP, each with its gradient; waypoints are the body's top. Uttsha et al. 2024."""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
from numba import njit

from gpdf_service.fields import FieldArrays, sample_one
from gpdf_service.types import FloatArray

CENTRE = np.zeros(1)
"""[m] A cylinder is one disc, at the body's centre."""


class Discs(NamedTuple):
    """A body in plan: where its discs are, ahead of its centre [m], shape (k,), and their radius [m]."""

    offsets: FloatArray
    radius: float


@njit(cache=True, nogil=True)
def smoothness_cost(xi: FloatArray, spacing: float, gradient: FloatArray) -> float:
    """Σ ½ ‖ẋ‖² ds with ẋ = Δx/ds [m]; adds to `gradient`, shape (n, 3)."""
    total = 0.0
    for i in range(xi.shape[0] - 1):
        for k in range(3):
            step = xi[i + 1, k] - xi[i, k]
            total += 0.5 * step * step / spacing
            gradient[i + 1, k] += step / spacing
            gradient[i, k] -= step / spacing
    return total


@njit(cache=True, nogil=True)
def obstacle_cost(
    xi: FloatArray,
    spacing: float,
    field: FieldArrays,
    discs: Discs,
    epsilon: float,
    weight: float,
    gradient: FloatArray,
) -> float:
    """Σ λ_o c_o(x) ‖ẋ‖ ds, c_o = (d − ε)² / 2ε below ε, with d = d_o(x, y) − radius, and −d + ε/2 where d < 0 [m].

    A body of discs pays for each of them: the one that lies o ahead is at x + o ẋ/‖ẋ‖, for the body faces where it
    goes; so the neighbours that say where that is take part in its gradient. Of a cylinder there is one, at o = 0.

    ‖ẋ‖ as in CHOMP (Ratliff et al. 2009): the paper prints ‖ẍ‖, which is zero on straight pieces and would let a
    straight path run through an obstacle at no cost. The gradient is CHOMP's: the part of ∇c across the way.
    """
    total = 0.0
    slope, place = np.zeros(2), np.zeros(2)
    for i in range(1, xi.shape[0] - 1):
        tx, ty = xi[i + 1, 0] - xi[i - 1, 0], xi[i + 1, 1] - xi[i - 1, 1]
        length = sqrt(tx * tx + ty * ty)
        if length == 0.0:
            continue
        tx, ty = tx / length, ty / length
        for offset in discs.offsets:
            place[0], place[1] = xi[i, 0] + offset * tx, xi[i, 1] + offset * ty
            d = sample_one(field, place, slope) - discs.radius
            if d >= epsilon:
                continue
            cost = epsilon / 2.0 - d if d < 0.0 else (d - epsilon) ** 2 / (2.0 * epsilon)
            rate = -1.0 if d < 0.0 else (d - epsilon) / epsilon
            total += weight * cost * 0.5 * length
            across = weight * rate * (slope[1] * tx - slope[0] * ty) * spacing
            lever = offset / length
            for k, share in ((i, 1.0), (i + 1, lever), (i - 1, -lever)):
                gradient[k, 0] -= share * across * ty
                gradient[k, 1] += share * across * tx
    return total


@njit(cache=True, nogil=True)
def ground_cost(
    xi: FloatArray, spacing: float, field: FieldArrays, height: float, weight: float, gradient: FloatArray
) -> float:
    """Σ λ_g (d_g(x) − h)² / 2h ds [m²]: keeps the body's top at body height over the ground."""
    total = 0.0
    slope = np.zeros(3)
    for i in range(1, xi.shape[0] - 1):
        off = sample_one(field, xi[i], slope) - height
        total += weight * off * off / (2.0 * height) * spacing
        for k in range(3):
            gradient[i, k] += weight * off / height * slope[k] * spacing
    return total

"""The three costs of the modified CHOMP, each with its gradient; waypoints are the body's top. Uttsha et al. 2024."""

from __future__ import annotations

from math import sqrt

import numpy as np
from numba import njit

from gpdf_service.fields import FieldArrays, sample_one
from gpdf_service.types import FloatArray


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
    radius: float,
    epsilon: float,
    weight: float,
    gradient: FloatArray,
) -> float:
    """Σ λ_o c_o(x) ‖ẋ‖ ds, c_o = (d − ε)² / 2ε below ε, with d = d_o(x, y) − radius, and −d + ε/2 where d < 0 [m].

    ‖ẋ‖ as in CHOMP (Ratliff et al. 2009): the paper prints ‖ẍ‖, which is zero on straight pieces and would let a
    straight path run through an obstacle at no cost. The gradient is CHOMP's: the part of ∇c across the way.
    """
    n = xi.shape[0]
    total = 0.0
    slope = np.zeros(2)
    for i in range(1, n - 1):
        d = sample_one(field, xi[i, :2], slope) - radius
        if d >= epsilon:
            continue
        cost = epsilon / 2.0 - d if d < 0.0 else (d - epsilon) ** 2 / (2.0 * epsilon)
        rate = -1.0 if d < 0.0 else (d - epsilon) / epsilon
        tx, ty = xi[i + 1, 0] - xi[i - 1, 0], xi[i + 1, 1] - xi[i - 1, 1]
        length = sqrt(tx * tx + ty * ty)
        total += weight * cost * 0.5 * length
        if length > 0.0:
            along = (slope[0] * tx + slope[1] * ty) / (length * length)
            gradient[i, 0] += weight * rate * (slope[0] - along * tx) * spacing
            gradient[i, 1] += weight * rate * (slope[1] - along * ty) * spacing
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

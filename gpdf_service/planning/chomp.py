"""Modified CHOMP: covariant descent on smoothness, obstacle and ground cost. Uttsha et al. 2024, equation 10.

ξ ← ξ − η H ∇U(ξ). The paper's H is A⁻¹, A the smoothness metric (second differences, fixed ends): a step bends the
whole path. Here H is the L-BFGS estimate of the inverse Hessian that starts from A⁻¹ (Nocedal and Wright, algorithm
7.4). η is 1 and halved until the cost falls, so it never rises on an accepted step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from gpdf_service.fields import FieldArrays
from gpdf_service.planning.costs import CENTRE, Discs, ground_cost, obstacle_cost, smoothness_cost
from gpdf_service.types import FloatArray

_PAIRS = 6
"""Steps that the estimate of the Hessian remembers; 3 to 20 are usual."""
_DESCENT = 1e-4
"""[-] Share of the fall that the slope promises which a step must bring (Armijo)."""
_STILL = 1e-5
"""[m] Smaller steps move nothing."""
_CURVED = 1e-12
"""[m] Least curvature along a step that is worth remembering."""


@dataclass(frozen=True, slots=True)
class ChompResult:
    """Waypoints (n, 3) [m], cost before and after each accepted step, and whether it came to rest."""

    xi: FloatArray
    costs: FloatArray
    converged: bool

    @property
    def iterations(self) -> int:
        """Accepted steps."""
        return len(self.costs) - 1


def optimize(
    xi: FloatArray,
    obstacle_field: FieldArrays,
    ground_field: FieldArrays,
    *,
    radius: float,
    height: float,
    epsilon: float,
    smoothness_weight: float,
    max_iterations: int,
    tolerance: float,
    offsets: FloatArray = CENTRE,
) -> ChompResult:
    """Optimise waypoints of the body's top.

    Args:
        xi: Start, shape (n, 3) [m]; rows 0 and -1 stay.
        obstacle_field: d_o, 2D, in compiled form.
        ground_field: d_g, 3D, in compiled form.
        radius: Of the body, or of each of its discs [m].
        height: Of the body [m].
        epsilon: Room beyond the radius that the path wants [m].
        smoothness_weight: λ_s; λ_o = λ_g = 1.
        max_iterations: Accepted and refused steps together.
        tolerance: Stop when the cost falls by less than this share.
        offsets: Where the body's discs are, ahead of its centre [m], shape (k,); it faces where it goes.
    """
    xi = np.ascontiguousarray(xi, dtype=np.float64).copy()
    costs = np.zeros(max_iterations + 1)
    discs = Discs(offsets, radius)
    count = _descend(
        xi, obstacle_field, ground_field, discs, height, epsilon, smoothness_weight, max_iterations, tolerance, costs
    )
    return ChompResult(xi, costs[: abs(count)], count > 0)


@njit(cache=True, nogil=True)
def _cost(
    xi: FloatArray,
    spacing: float,
    obstacle_field: FieldArrays,
    ground_field: FieldArrays,
    discs: Discs,
    height: float,
    epsilon: float,
    smoothness_weight: float,
    gradient: FloatArray,
) -> float:
    gradient[:] = 0.0
    total = smoothness_weight * smoothness_cost(xi, spacing, gradient)
    gradient *= smoothness_weight
    total += obstacle_cost(xi, spacing, obstacle_field, discs, epsilon, 1.0, gradient)
    total += ground_cost(xi, spacing, ground_field, height, 1.0, gradient)
    gradient[0], gradient[-1] = 0.0, 0.0
    return total


@njit(cache=True, nogil=True)
def solve_metric(gradient: FloatArray) -> FloatArray:
    """A⁻¹ ∇U for A = tridiag(−1, 2, −1) with fixed ends: Thomas' algorithm, O(n); shape (n, 3)."""
    n = gradient.shape[0] - 2
    step = np.zeros_like(gradient)
    ratio = np.zeros(n + 2)
    for i in range(1, n + 1):
        pivot = 2.0 + ratio[i - 1] if i > 1 else 2.0
        ratio[i] = -1.0 / pivot
        for k in range(gradient.shape[1]):
            step[i, k] = (gradient[i, k] + (step[i - 1, k] if i > 1 else 0.0)) / pivot
    for i in range(n - 1, 0, -1):
        for k in range(gradient.shape[1]):
            step[i, k] -= ratio[i] * step[i + 1, k]
    return step


@njit(cache=True, nogil=True)
def _direction(gradient: FloatArray, s: FloatArray, y: FloatArray, count: int, scale: float) -> FloatArray:
    """H ∇U by the two-loop recursion over the newest of `count` pairs of a step s and its gradient change y."""
    kept = min(count, _PAIRS)
    q = gradient.copy()
    share = np.zeros(_PAIRS)
    for back in range(kept):
        i = (count - 1 - back) % _PAIRS
        share[i] = (s[i] * q).sum() / (s[i] * y[i]).sum()
        q -= share[i] * y[i]
    if kept > 0:
        i = (count - 1) % _PAIRS
        scale = (s[i] * y[i]).sum() / (y[i] * solve_metric(y[i])).sum()
    q = scale * solve_metric(q)
    for back in range(kept - 1, -1, -1):
        i = (count - 1 - back) % _PAIRS
        q += (share[i] - (y[i] * q).sum() / (s[i] * y[i]).sum()) * s[i]
    return q


@njit(cache=True, nogil=True)
def _descend(
    xi: FloatArray,
    obstacle_field: FieldArrays,
    ground_field: FieldArrays,
    discs: Discs,
    height: float,
    epsilon: float,
    smoothness_weight: float,
    max_iterations: int,
    tolerance: float,
    costs: FloatArray,
) -> int:
    """Descend in place; returns the number of costs written, negative when it did not come to rest."""
    n = xi.shape[0]
    spacing = 0.0
    for i in range(n - 1):
        spacing += np.sqrt(((xi[i + 1] - xi[i]) ** 2).sum()) / (n - 1)
    gradient, trial_gradient = np.zeros_like(xi), np.zeros_like(xi)
    steps, changes, pairs = np.zeros((_PAIRS, n, 3)), np.zeros((_PAIRS, n, 3)), 0
    cost = _cost(xi, spacing, obstacle_field, ground_field, discs, height, epsilon, smoothness_weight, gradient)
    costs[0], count = cost, 1
    # In this metric the smoothness term alone is solved by the scale ds/λ_s; start well below it.
    scale = 0.1 * spacing / smoothness_weight
    direction = _direction(gradient, steps, changes, pairs, scale)
    rate = 1.0
    for _ in range(max_iterations):
        slope = (direction * gradient).sum()
        if slope <= 0.0 and pairs > 0:  # the pairs do not describe this place: begin again
            pairs, rate = 0, 1.0
            direction = _direction(gradient, steps, changes, pairs, scale)
            slope = (direction * gradient).sum()
        largest = np.abs(direction).max()
        if largest == 0.0:
            return count
        rate = min(rate, 0.5 * epsilon / largest)  # no waypoint jumps across half of what it wants to keep
        trial = xi - rate * direction
        trial_cost = _cost(
            trial, spacing, obstacle_field, ground_field, discs, height, epsilon, smoothness_weight, trial_gradient
        )
        if trial_cost > cost - _DESCENT * rate * slope:
            rate *= 0.5
            if rate * largest < _STILL:
                if pairs == 0:
                    return count
                pairs, rate = 0, 1.0
                direction = _direction(gradient, steps, changes, pairs, scale)
            continue
        step, change = trial - xi, trial_gradient - gradient
        if (step * change).sum() > _CURVED:
            steps[pairs % _PAIRS], changes[pairs % _PAIRS] = step, change
            pairs += 1
        fall = cost - trial_cost
        xi[:], gradient[:], cost = trial, trial_gradient, trial_cost
        costs[count] = cost
        count += 1
        if fall < tolerance * max(cost, 1e-9):
            return count
        rate = 1.0
        direction = _direction(gradient, steps, changes, pairs, scale)
    return -count

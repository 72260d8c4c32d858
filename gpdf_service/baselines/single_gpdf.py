"""Vanilla CHOMP with one 3D field over all points: the body is spheres below its top, nothing holds it to the ground.

Σ λ_s ½ ‖ẋ‖² + Σ_b c(x − b) ‖ẋ‖, Uttsha et al. 2024, equations 4 to 6, and the sum over the body's points b of Ratliff
et al. 2009, with the same weights, the same clearance and the same covariant step as the planner, started from the A*
path: the best start that a baseline has. The paper says that this method goes over obstacles; so does this one.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_banded

from gpdf_service.config import PlanningConfig
from gpdf_service.types import DistanceField, FloatArray

CostAndGradient = tuple[float, FloatArray]


def body_points(height: float, radius: float, epsilon: float) -> FloatArray:
    """How far below the body's top the spheres' centres are [m]: as far down as the ground does not push them up.

    A body that is too low for one that the ground leaves alone is a point at its top, and is lifted.
    """
    lowest = height - radius - epsilon
    if lowest <= radius:
        return np.zeros(1)
    return np.linspace(radius, lowest, max(2, int(np.ceil((lowest - radius) / radius)) + 1))


def optimize_in_one_field(
    xi: FloatArray, field: DistanceField, height: float, radius: float, config: PlanningConfig
) -> FloatArray:
    """Optimise waypoints of the body's top.

    Args:
        xi: Start, shape (n, 3) [m]; rows 0 and -1 stay.
        field: Distance to the nearest point of the cloud, 3D.
        height: Of the body [m].
        radius: Of the body [m].
        config: Weights and limits.
    """
    spacing = float(np.linalg.norm(np.diff(xi, axis=0), axis=1).mean())
    epsilon, weight = config.preferred_clearance * radius, config.smoothness_weight(radius)
    below = body_points(height, radius, epsilon)

    def evaluate(xi: FloatArray) -> CostAndGradient:
        return cost_in_one_field(xi, spacing, field, below, radius, epsilon, weight)

    cost, gradient = evaluate(xi)
    rate = 0.1 * spacing / weight  # well below the step that solves the smoothness term alone
    for _ in range(config.max_iterations):
        step = solve_metric(gradient)
        largest = float(np.abs(step).max())
        if largest == 0.0:
            break
        rate = min(rate, 0.5 * epsilon / largest)
        trial = xi - rate * step
        trial_cost, trial_gradient = evaluate(trial)
        if trial_cost > cost:
            rate *= 0.5
            continue
        fall = cost - trial_cost
        xi, cost, gradient, rate = trial, trial_cost, trial_gradient, 1.5 * rate
        if fall < config.tolerance * cost:
            break
    return xi


def solve_metric(gradient: FloatArray) -> FloatArray:
    """A⁻¹ ∇U for A = tridiag(−1, 2, −1) with fixed ends, shape (n, 3)."""
    step = np.zeros_like(gradient)
    count = len(gradient) - 2
    side = np.full(count, -1.0)
    step[1:-1] = solve_banded((1, 1), np.vstack([side, np.full(count, 2.0), side]), gradient[1:-1])
    return step


def cost_in_one_field(
    xi: FloatArray,
    spacing: float,
    field: DistanceField,
    below: FloatArray,
    radius: float,
    epsilon: float,
    smoothness_weight: float,
) -> CostAndGradient:
    """Cost of waypoints, and its gradient with zero rows at the ends; ‖ẋ‖ ds is half the way between the neighbours."""
    steps = np.diff(xi, axis=0)
    gradient = np.zeros_like(xi)
    gradient[1:-1] = smoothness_weight * (steps[:-1] - steps[1:]) / spacing
    smooth = 0.5 * smoothness_weight * float((steps**2).sum()) / spacing
    spheres = xi[1:-1, None] - below[:, None] * np.array([0.0, 0.0, 1.0])
    sample = field.query(spheres.reshape(-1, 3))
    room = np.where(sample.valid, sample.distance - radius, epsilon)  # nothing is near where the field says nothing
    near = np.clip(epsilon - room, 0.0, None)
    rate = np.where(room < 0.0, -1.0, -near / epsilon)
    each = np.where(room < 0.0, epsilon / 2.0 - room, near**2 / (2.0 * epsilon))
    obstacle = each.reshape(-1, len(below)).sum(axis=1)
    push = (rate[:, None] * sample.gradient).reshape(-1, len(below), 3).sum(axis=1)
    along = 0.5 * (xi[2:] - xi[:-2])
    speed = np.linalg.norm(along, axis=1)
    pull = (0.5 * obstacle / np.maximum(speed, 1e-9))[:, None] * along
    gradient[1:-1] += push * speed[:, None]
    gradient[2:-1] += pull[:-1]
    gradient[1:-2] -= pull[1:]
    return smooth + float((obstacle * speed).sum()), gradient

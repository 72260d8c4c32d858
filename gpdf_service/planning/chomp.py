"""Modified CHOMP: covariant descent on smoothness, obstacle and ground cost. Uttsha et al. 2024, equation 10.

ξ ← ξ − η H ∇U(ξ). The paper's H is A⁻¹, A the smoothness metric (second differences, fixed ends): a step bends the
whole path. Here H⁻¹ is λ_s A and the curvature of the two other costs along their gradients (Gauss and Newton): a step
bends the path as far as what is beside it lets it. A waypoint that would jump too far is held alone. η is 1 at most,
twice what it was before, and made smaller until the cost falls: so it never rises on an accepted step. Where no step
promises to win the tolerance, none is looked for.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit

from gpdf_service.kernel_cache import lean
from gpdf_service.planning.costs import (
    Discs,
    Memo,
    Task,
    ground_cost,
    make_memo,
    obstacle_cost,
    smoothness_cost,
)
from gpdf_service.planning.shape import distinct, is_level, lengths, spline, waypoints
from gpdf_service.search.ways import Fields, Here
from gpdf_service.types import FloatArray

_DESCENT = 1e-4
"""[-] Share of the fall that the slope promises which a step must bring (Armijo)."""
_SHORTEST = 0.1
"""[-] A refused step is made shorter as the parabola through what is known says, but not by more than this."""
_STILL = 1e-5
"""[m] Smaller steps move nothing."""
NARROW = 4
"""Width of a cylinder's band: a waypoint's three coordinates, and the neighbour's same one."""


class Wants(NamedTuple):
    """What is asked of a path.

    Attributes:
        height: Of the body [m].
        epsilon: Room beyond the radius that the path wants [m].
        wall: How much steeper the obstacle cost gets with each metre that the body is too near [1/m].
        smoothness_weight: λ_s; λ_o = λ_g = 1.
    """

    height: float
    epsilon: float
    wall: float
    smoothness_weight: float


class Stop(NamedTuple):
    """After how many steps, accepted and refused together; and the share of the cost that a step must win."""

    max_iterations: int
    tolerance: float


class Bending(NamedTuple):
    """How a piece of the path is bent.

    Attributes:
        discs: Of the body.
        wants: What is asked of the path.
        spacing: Of the waypoints, and of the places of the path that is made [m].
        looks: At how many waypoints there is time to look.
        stop: When it is good enough.
    """

    discs: Discs
    wants: Wants
    spacing: tuple[float, float]
    looks: float
    stop: Stop


class ChompResult(NamedTuple):
    """Waypoints (n, 3) [m], cost before and after each accepted step, evaluations of it, whether it came to rest."""

    xi: FloatArray
    costs: FloatArray
    evaluations: int
    converged: bool

    @property
    def iterations(self) -> int:
        """Accepted steps."""
        return len(self.costs) - 1


@njit(cache=True, nogil=True)
def optimize(
    xi: FloatArray, fields: Fields, discs: Discs, wants: Wants, stop: Stop, level: bool = False
) -> ChompResult:
    """Optimise waypoints of the body's top, shape (n, 3) [m], in place; rows 0 and -1 stay.

    Over `level` ground, where d_g = h wherever they are moved to, the ground costs nothing.
    """
    (obstacles, ground), (height, epsilon, wall, stiff) = fields, wants
    costs, spacing = np.zeros(stop.max_iterations + 1), lengths(xi)[-1] / (len(xi) - 1)
    task = Task(obstacles, ground, discs, height, epsilon, wall, stiff, spacing, level)
    count, evaluations, converged = _descend(xi, task, stop.max_iterations, stop.tolerance, costs)
    return ChompResult(xi, costs[:count].copy(), evaluations, converged)


@njit(cache=True, nogil=True)
def bend(
    path: FloatArray, here: Sequence[Here], bent_by: Sequence[Fields], bending: Bending
) -> tuple[FloatArray, ChompResult]:
    """`optimize` waypoints over a path in plan, (n, 2) [m], whose ends stay, by the fields of its level.

    Over level ground the ground's field is not asked. The path that is made, (k, 2), is the `spline` through what is
    distinct of them, without places if there is no time for a step. No waypoints where nothing moves, or ground is
    unknown.
    """
    (about, ends, _), (discs, wants, spacing, looks, stop) = here[0], bending
    xi = waypoints(path, spacing[0], about.ground, wants.height)
    steps = int(min(float(stop.max_iterations), looks / max(len(xi), 1)))
    if len(xi) == 0 or steps < 1:
        return path[:0].copy(), ChompResult(xi, np.zeros(1), 0, False)
    level = is_level(xi, about.ground, ends, wants.height)
    found = optimize(xi, bent_by[0], discs, wants, Stop(steps, stop.tolerance), level)
    return spline(distinct(np.ascontiguousarray(xi[:, :2])), spacing[1]), found


@lean()
def _cost(xi: FloatArray, task: Task, memos: tuple[Memo, Memo], gradient: FloatArray, band: FloatArray) -> float:
    """All that a path costs; writes its gradient and the derivative of that."""
    gradient[:], band[:] = 0.0, 0.0
    total: float = smoothness_cost(xi, task, gradient, band)
    total += obstacle_cost(xi, task, memos[0], gradient, band)
    if not task.level:
        total += ground_cost(xi, task, memos[1], gradient, band)
    return total


@njit(cache=True, nogil=True)
def solve_banded(band: FloatArray, right: FloatArray) -> FloatArray:
    """Solve A x = b, shape (n, 3), for a positive definite A, by A = L D Lᵀ in place, O(n).

    Row r = 3i + k of A is in the last axis of the `band`, shape (n, 3, w): element [p] is that p columns left of the
    diagonal. It is L after, with 1 / D for the diagonal.
    """
    low, x, width = band.reshape(-1, band.shape[2]), right.copy().reshape(-1), band.shape[2]
    if width == NARROW:
        _solve_narrow(low, x)
        return x.reshape(right.shape)
    for r in range(len(x)):
        most = min(width - 1, r)
        for p in range(most, 0, -1):  # row r of L D, and then of L
            for q in range(p + 1, most + 1):
                low[r, p] -= low[r, q] * low[r - p, q - p]
        for p in range(1, most + 1):
            share = low[r, p] * low[r - p, 0]
            low[r, 0] -= share * low[r, p]
            low[r, p] = share
            x[r] -= share * x[r - p]
        low[r, 0] = 1.0 / low[r, 0]
    for r in range(len(x)):
        x[r] *= low[r, 0]
    for r in range(len(x) - 1, -1, -1):
        for p in range(1, min(width - 1, r) + 1):
            x[r - p] -= low[r, p] * x[r]
    return x.reshape(right.shape)


@lean()
def _solve_narrow(low: FloatArray, x: FloatArray) -> None:
    """`solve_banded` in place with three columns beside the diagonal, without loops over them: six times as fast."""
    d1 = d2 = d3 = x1 = x2 = x3 = 0.0  # 1 / D and x of the last three rows
    one = two = next_one = 0.0  # L of the row before, and of the one before that
    for r in range(len(x)):
        c3, c2, c1 = low[r, 3] if r > 2 else 0.0, low[r, 2] if r > 1 else 0.0, low[r, 1] if r > 0 else 0.0
        c2 -= c3 * next_one
        c1 -= c3 * two + c2 * one
        low[r, 3], low[r, 2], low[r, 1] = c3 * d3, c2 * d2, c1 * d1
        low[r, 0] = 1.0 / (low[r, 0] - low[r, 3] * c3 - low[r, 2] * c2 - low[r, 1] * c1)
        x[r] -= low[r, 3] * x3 + low[r, 2] * x2 + low[r, 1] * x1
        d3, d2, d1, x3, x2, x1 = d2, d1, low[r, 0], x2, x1, x[r]
        next_one, one, two = one, low[r, 1], low[r, 2]
    for r in range(len(x)):
        x[r] *= low[r, 0]
    for r in range(len(x) - 1, 0, -1):
        for p in range(1, min(NARROW - 1, r) + 1):
            x[r - p] -= low[r, p] * x[r]


@njit(cache=True, nogil=True)
def _descend(
    xi: FloatArray, task: Task, max_iterations: int, tolerance: float, costs: FloatArray
) -> tuple[int, int, bool]:
    """Descend in place; returns the number of costs written, of evaluations, and whether it came to rest."""
    n, discs = len(xi), len(task.discs.offsets)
    gradient, band, direction = np.zeros((n, 3)), np.zeros((n, 3, NARROW if discs == 1 else 9)), np.zeros((n, 3))
    memos = make_memo(n * discs), make_memo(n)
    cost = _cost(xi, task, memos, gradient, band)
    costs[0], count, rate, fresh = cost, 1, 1.0, True
    slope = largest = 0.0
    for tried in range(1, max_iterations + 1):
        if fresh:
            direction[1:-1] = solve_banded(band[1:-1], gradient[1:-1])
            _shorten(direction, gradient, task.epsilon)
            slope, largest = (direction * gradient).sum(), np.abs(direction).max()
            rate = min(1.0, 2.0 * rate)
            if largest == 0.0 or rate * slope < tolerance * cost:  # twice what the step promises to win
                return count, tried, True
        trial = xi - rate * direction
        trial_cost = _cost(trial, task, memos, gradient, band)
        fresh = trial_cost <= cost - _DESCENT * rate * slope
        if not fresh:
            parabola = 0.5 * slope * rate / (trial_cost - cost + slope * rate)  # its least, of the step that was tried
            rate *= min(max(parabola, _SHORTEST), 0.5)
            if rate * largest < _STILL or rate * slope < tolerance * cost:
                return count, tried + 1, True
            continue
        fall = cost - trial_cost
        xi[:], cost = trial, trial_cost
        costs[count] = cost
        count += 1
        if fall < tolerance * max(cost, 1e-9):
            return count, tried + 1, True
    return count, max_iterations + 1, False


@njit(cache=True, nogil=True)
def _shorten(direction: FloatArray, gradient: FloatArray, epsilon: float) -> None:
    """Let no waypoint jump further than the room that it wants to keep: each alone, so no other one waits.

    Where the cost would not fall along what is left all are shortened alike: it falls along the direction as a whole.
    """
    share, fall, longest = np.ones(len(direction)), 0.0, 0.0
    for i in range(len(direction)):
        far = max(abs(direction[i, 0]), abs(direction[i, 1]), abs(direction[i, 2]))
        share[i], longest = epsilon / max(far, epsilon), max(longest, far)
        for k in range(3):
            fall += share[i] * direction[i, k] * gradient[i, k]
    if fall <= 0.0:
        share[:] = epsilon / max(longest, epsilon)
    for i in range(len(direction)):
        for k in range(3):
            direction[i, k] *= share[i]

"""From a request to a certified trajectory: endpoints, A*, shortcut, CHOMP, certificate, time stamps.

Nothing is returned as OK without a certificate that holds: CHOMP leaves a valid seed and may end in collision, so its
result competes with the seed, and the first candidate that certifies is the answer.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from gpdf_service.config import PlanningConfig
from gpdf_service.planning.certificate import certify
from gpdf_service.planning.chomp import ChompResult, optimize
from gpdf_service.planning.endpoints import Ends, Refusal, find_ends
from gpdf_service.planning.footprint import face
from gpdf_service.planning.no_path import explain_no_path
from gpdf_service.planning.routes import Leg, Route, find_cut, find_routes, take_up
from gpdf_service.planning.shape import resample, spline, stand_up
from gpdf_service.planning.timing import speed_limit
from gpdf_service.planning.turning import Facing, Stuck, time_poses, turn_route
from gpdf_service.search import FreeSpace
from gpdf_service.types import Certificate, FloatArray, IntArray, PlanOptions, PlanResult, Status, Trajectory

Clock = Callable[[], float]
NO_OPTIONS = PlanOptions()
BEND = 0.125
"""[m] Between the optimiser's waypoints, at most; half of the radius of a smaller body. The result is their spline."""
WALL = 1000.0
"""[1/m] A millimetre too near, which is what the certificate resolves, doubles the push away."""


@dataclass(frozen=True, slots=True)
class _Candidate:
    """A path that may be certified, the optimiser's costs on the way to it, and numbers about it."""

    legs: list[Leg]
    costs: FloatArray
    details: dict[str, float]


def plan_path(
    space: FreeSpace,
    start: FloatArray,
    goal: FloatArray,
    config: PlanningConfig,
    *,
    options: PlanOptions = NO_OPTIONS,
    deadline: float | None = None,
    clock: Clock = time.monotonic,
) -> PlanResult:
    """Plan for the body of `space`.

    Args:
        space: Where the body can be.
        start: (x, y) or (x, y, z of the ground) [m].
        goal: The same.
        config: Weights and limits.
        options: What else the request asks for.
        deadline: On `clock`; a certified path that is not yet optimised is returned when it passes.
        clock: Monotonic seconds.
    """
    began = clock()
    ends = find_ends(space, start, [goal, *options.other_goals], options)
    if isinstance(ends, Refusal):
        details = {} if ends.nearest is None else _place("nearest", ends.nearest)
        return PlanResult(ends.status, ends.message, timings={"total": clock() - began}, details=details)
    if deadline is not None and clock() > deadline:
        return PlanResult(Status.TIMEOUT, "the deadline passed before the search began. Allow more time.")
    first: Certificate | None = None
    stuck: Stuck | None = None
    for route in _routes(space, ends, options, lambda: np.inf if deadline is None else deadline - clock()):
        if isinstance(route, Stuck):
            stuck = stuck or route
            continue
        searched = clock()
        for candidate in _candidates(space, route.legs, config, deadline, clock):
            contact, top, level, headings = _stand(space, candidate.legs, config.waypoint_spacing, _facing(options))
            certificate = certify(space, top, contact, level, headings)
            first = first or certificate
            if certificate.holds:
                poses = np.column_stack([contact[:, :2], headings])
                limit = speed_limit(space, poses, level, config.preferred_clearance * space.agent.disc_radius)
                trajectory = Trajectory(top, contact, *time_poses(top, headings, space.agent, limit))
                timings = {"search": searched - began, "optimise": clock() - searched, "total": clock() - began}
                details = candidate.details | {"nodes": float(len(space.graph.position))}
                details |= {"goal": float(route.goal), "warm": float(route.warm)}
                return PlanResult(Status.OK, ends.moved, trajectory, certificate, timings, details, candidate.costs)
    timings = {"total": clock() - began}
    if first is None:
        goal_end = next(end for end in ends.goals if end)
        cut = find_cut(space, [ends.start, *ends.via, goal_end])
        assert cut is not None
        why = explain_no_path(space, *cut)
        details = {"largest_radius": why.largest_radius} | _place("cut", why.at)
        return PlanResult(Status.NO_VALID_PATH, why.message, timings=timings, details=details)
    if stuck is not None:
        return PlanResult(stuck.status, stuck.message, timings=timings, details=_place("cut", stuck.at))
    return PlanResult(
        Status.UNCERTIFIED,
        f"a path was found, but it cannot be certified: {first.reason}. Choose other places, or a smaller body.",
        certificate=first,
        timings=timings,
    )


def _place(name: str, place: FloatArray) -> dict[str, float]:
    """A place as numbers by name, without what is not known."""
    return {f"{name}_{axis}": float(v) for axis, v in zip("xyz", place, strict=True) if np.isfinite(v)}


def _routes(space: FreeSpace, ends: Ends, options: PlanOptions, left: Clock) -> Iterator[Route | Stuck]:
    """The way from before, if it can be taken up; then, if that does not certify, those of the graph.

    For a body of discs these are ways of one disc; if bending does not make them its own, it searches over its poses,
    for as many seconds as are `left`.
    """
    if options.warm_start is not None and (known := take_up(space, ends, options.warm_start)) is not None:
        yield known
    routes = find_routes(space, ends)
    yield from routes
    if space.agent.discs > 1:
        yield from (turn_route(space, route, left(), _facing(options)) for route in routes)


def _candidates(
    space: FreeSpace, legs: list[Leg], config: PlanningConfig, deadline: float | None, clock: Clock
) -> Iterator[_Candidate]:
    """Paths from the best to the safest: CHOMP, CHOMP that bends round every point behind a wall, then the seed."""
    for strict in (False, True):
        if deadline is not None and clock() > deadline:
            break
        bent = [_bend(space, level, path, config, strict) for level, path in legs]
        runs = [run for _, run in bent if run is not None]
        most = max((len(run.costs) for run in runs), default=0)
        steps = np.arange(most)  # a piece that came to rest keeps its cost
        costs = sum((run.costs[np.minimum(steps, len(run.costs) - 1)] for run in runs), np.zeros(most))
        details = {
            "iterations": float(sum(run.iterations for run in runs)),
            "evaluations": float(sum(run.evaluations for run in runs)),
            "converged": float(all(run.converged for run in runs)),
        }
        yield _Candidate([(level, path) for (level, _), (path, _) in zip(legs, bent, strict=True)], costs, details)
    yield _Candidate(legs, np.zeros(0), {"iterations": 0.0, "evaluations": 0.0, "converged": 0.0})


def _bend(
    space: FreeSpace, level: int, path: FloatArray, config: PlanningConfig, strict: bool
) -> tuple[FloatArray, ChompResult | None]:
    """A piece of the path after CHOMP; as it was where nothing moves or the ground is not known all along.

    The Obstacle GPDF is fitted to thinned points and its cost is soft. `strict`ly, the path bends round the points
    themselves behind a wall, with the margin of the search and what a chord between waypoints cuts from a turn.
    """
    agent = space.agent
    spacing = max(config.waypoint_spacing, min(agent.disc_radius / 2, BEND))
    seed = resample(path[:, :2], spacing)
    _, top = stand_up(seed, space.surfaces[level], space.ground_fields[level], agent.height)
    if not np.isfinite(top).all() or np.ptp(path[:, :2], axis=0).max() == 0.0:
        return path, None
    found = optimize(
        top,
        space.exact_fields[level] if strict else space.obstacle_fields[level].arrays,
        space.ground_fields[level].arrays,
        offsets=agent.offsets,
        radius=space.radius + spacing**2 / (8.0 * agent.disc_radius) if strict else space.reach,
        height=agent.height,
        epsilon=config.preferred_clearance * agent.disc_radius,
        wall=WALL if strict else 0.0,
        smoothness_weight=config.smoothness_weight(agent.disc_radius),
        max_iterations=config.max_iterations,
        tolerance=config.tolerance,
    )
    return spline(found.xi[:, :2], config.waypoint_spacing), found


def _facing(options: PlanOptions) -> Facing:
    return options.start_heading, options.goal_heading


def _stand(
    space: FreeSpace, legs: list[Leg], spacing: float, facing: Facing
) -> tuple[FloatArray, FloatArray, IntArray, FloatArray]:
    """Contact points, tops, levels and headings of a whole path; a place where two legs meet stands in it once.

    A body of discs turns on the spot at the ends if it must face elsewhere there.
    """
    agent = space.agent
    contacts, tops, levels, headings = [], [], [], []
    for i, (level, path) in enumerate(legs):
        poses = face(path, agent, spacing)[1 if i else 0 :]
        contact, top = stand_up(poses[:, :2], space.surfaces[level], space.ground_fields[level], agent.height)
        contacts.append(contact)
        tops.append(top)
        levels.append(np.full(len(poses), level))
        headings.append(poses[:, 2])
    contact, top, on, heading = np.vstack(contacts), np.vstack(tops), np.concatenate(levels), np.concatenate(headings)
    if agent.discs > 1:
        turned = [(0, facing[0]), *enumerate(heading), (-1, facing[1])]
        row = np.array([i % len(contact) for i, angle in turned if angle is not None])
        heading = np.unwrap([angle for _, angle in turned if angle is not None])
        contact, top, on = contact[row], top[row], on[row]
    moved = np.linalg.norm(np.diff(contact[:, :2], axis=0), axis=1) + agent.offsets[-1] * np.abs(np.diff(heading))
    keep = np.concatenate([[True], moved > 1e-9])
    if keep.sum() < 2:  # start is goal: stand there
        keep[-1] = True
    return contact[keep], top[keep], on[keep], heading[keep]

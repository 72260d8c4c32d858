"""From a request to a certified trajectory: endpoints, A*, shortcut, CHOMP, certificate, time stamps.

Nothing is returned as OK without a certificate that holds: CHOMP leaves a valid seed and may end in collision, so its
result competes with the seed, and the first candidate that certifies is the answer.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import numpy as np

from gpdf_service.config import PlanningConfig
from gpdf_service.planning.certificate import certify
from gpdf_service.planning.chomp import optimize
from gpdf_service.planning.endpoints import Endpoint, Refusal, find_endpoint
from gpdf_service.planning.no_path import NoPath, explain_no_path
from gpdf_service.planning.shape import resample, shortcut, stand_up, subdivide
from gpdf_service.planning.timing import time_path
from gpdf_service.search import FreeSpace, find_path
from gpdf_service.types import Certificate, FloatArray, IntArray, PlanResult, Status, Trajectory

Clock = Callable[[], float]
Leg = tuple[int, FloatArray]
"""A piece of the path on one level: level, places in plan (n, 2)."""


def plan_path(
    space: FreeSpace,
    start: FloatArray,
    goal: FloatArray,
    config: PlanningConfig,
    *,
    deadline: float | None = None,
    clock: Clock = time.monotonic,
) -> PlanResult:
    """Plan for the body of `space`.

    Args:
        space: Where the body can be.
        start: (x, y) or (x, y, z of the ground) [m].
        goal: The same.
        config: Weights and limits.
        deadline: On `clock`; a certified path that is not yet optimised is returned when it passes.
        clock: Monotonic seconds.
    """
    began = clock()
    ends = find_endpoint(space, start, "start"), find_endpoint(space, goal, "goal")
    for end in ends:
        if isinstance(end, Refusal):
            return PlanResult(end.status, end.message, timings={"total": clock() - began})
    a, b = (end for end in ends if isinstance(end, Endpoint))
    if space.graph.component[a.node] != space.graph.component[b.node]:
        return _refuse(explain_no_path(space, a, b), {"total": clock() - began})
    if deadline is not None and clock() > deadline:
        return PlanResult(Status.TIMEOUT, "the deadline passed before the search began. Allow more time.")
    legs = [
        (level, path[shortcut(path, space.trees[level], _radius(space, level, path))])
        for level, path in route(space, a, b)
    ]
    searched = clock()
    first: Certificate | None = None
    for candidate, iterations in _candidates(space, legs, config, deadline, clock):
        contact, top, level = _stand(space, candidate, config.waypoint_spacing)
        certificate = certify(space, top, contact, level)
        first = first or certificate
        if certificate.holds:
            times, headings = time_path(top, space.agent)
            timings = {"search": searched - began, "optimise": clock() - searched, "total": clock() - began}
            details = {"iterations": float(iterations), "nodes": float(len(space.graph.position))}
            trajectory = Trajectory(top, contact, times, headings)
            return PlanResult(Status.OK, "", trajectory, certificate, timings, details)
    assert first is not None
    return PlanResult(
        Status.UNCERTIFIED,
        f"a path was found, but it cannot be certified: {first.reason}. Choose other places, or a smaller body.",
        certificate=first,
        timings={"total": clock() - began},
    )


def _refuse(why: NoPath, timings: dict[str, float]) -> PlanResult:
    details = {
        "largest_radius": why.largest_radius,
        **dict(zip(("cut_x", "cut_y", "cut_z"), map(float, why.at), strict=True)),
    }
    finite = {key: value for key, value in details.items() if np.isfinite(value)}
    return PlanResult(Status.NO_VALID_PATH, why.message, timings=timings, details=finite)


def route(space: FreeSpace, start: Endpoint, goal: Endpoint) -> list[Leg]:
    """A* through the graph, as places in plan, cut where the path changes level."""
    graph = space.graph
    edges = find_path(graph, start.node, goal.node)
    legs: list[tuple[int, list[FloatArray]]] = [(start.level, [start.xy, graph.position[start.node]])]
    for edge in edges:
        node = int(graph.other[edge])
        legs[-1][1].append(graph.via[edge])
        if graph.level[node] != legs[-1][0]:
            legs.append((int(graph.level[node]), [graph.via[edge]]))
        legs[-1][1].append(graph.position[node])
    legs[-1][1].append(goal.xy)
    return [(level, _distinct(np.array(path))) for level, path in legs]


def _distinct(path: FloatArray) -> FloatArray:
    """Without places that repeat the one before; two rows at least, the ends kept."""
    moved = np.linalg.norm(np.diff(path, axis=0), axis=1) > 1e-9
    if not moved.any():
        moved[-1] = True
    distinct: FloatArray = path[np.concatenate([[True], moved])]
    return distinct


def _radius(space: FreeSpace, level: int, path: FloatArray) -> float:
    """The search's radius; the body's own where an end lies closer than the margin."""
    ends = space.clearance(level, path[[0, -1]])[0]
    return min(space.radius, max(space.agent.radius, float(ends.min()) - 1e-9))


def _candidates(
    space: FreeSpace, legs: list[Leg], config: PlanningConfig, deadline: float | None, clock: Clock
) -> Iterator[tuple[list[Leg], int]]:
    """Paths from the best to the safest: CHOMP with all its room, with half, a quarter of it, then the seed."""
    agent = space.agent
    for share in (1.0, 0.5, 0.25):
        if deadline is not None and clock() > deadline:
            break
        better, iterations = [], 0
        for level, path in legs:
            seed = resample(path, max(config.waypoint_spacing, agent.radius / 4))
            _, top = stand_up(seed, space.surfaces[level], space.ground_fields[level], agent.height)
            if not np.isfinite(top).all() or np.ptp(path, axis=0).max() == 0.0:
                better.append((level, path))
                continue
            found = optimize(
                top,
                space.obstacle_fields[level].arrays,
                space.ground_fields[level].arrays,
                radius=agent.radius,
                height=agent.height,
                epsilon=share * config.preferred_clearance * agent.radius,
                smoothness_weight=config.smoothness_weight,
                max_iterations=config.max_iterations,
                tolerance=config.tolerance,
            )
            iterations += len(found.costs)
            better.append((level, found.xi[:, :2]))
        yield better, iterations
    yield legs, 0


def _stand(space: FreeSpace, legs: list[Leg], spacing: float) -> tuple[FloatArray, FloatArray, IntArray]:
    """Contact points, tops and levels of a whole path; a place where two legs meet stands in it once."""
    contacts, tops, levels = [], [], []
    for i, (level, path) in enumerate(legs):
        xy = subdivide(path, spacing)[1 if i else 0 :]
        contact, top = stand_up(xy, space.surfaces[level], space.ground_fields[level], space.agent.height)
        contacts.append(contact)
        tops.append(top)
        levels.append(np.full(len(xy), level))
    contact, top = np.vstack(contacts), np.vstack(tops)
    keep = np.concatenate([[True], np.linalg.norm(np.diff(contact[:, :2], axis=0), axis=1) > 1e-9])
    if keep.sum() < 2:  # start is goal: stand there
        return contact[[0, -1]], top[[0, -1]], np.concatenate(levels)[[0, -1]]
    return contact[keep], top[keep], np.concatenate(levels)[keep]

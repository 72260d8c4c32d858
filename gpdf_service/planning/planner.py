"""From a request to a certified trajectory: endpoints, A*, shortcut, CHOMP, certificate, time stamps.

Nothing is returned as OK without a certificate that holds: CHOMP leaves a valid seed and may end in collision, so its
result competes with the seed, and the first candidate that certifies is the answer.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import islice
from typing import NamedTuple

import numpy as np

from gpdf_service.config import PlanningConfig
from gpdf_service.planning.at_once import MORE_STEPS, Pace, go_at_once
from gpdf_service.planning.certificate import certify, judge
from gpdf_service.planning.chomp import Bending, ChompResult, Stop, Wants, bend
from gpdf_service.planning.costs import Discs
from gpdf_service.planning.endpoints import Ends, Refusal, find_ends
from gpdf_service.planning.footprint import moving, stand_along
from gpdf_service.planning.no_path import explain_no_path
from gpdf_service.planning.others import find_others, find_rival
from gpdf_service.planning.portals import Bent, Meet, bend_over, pull_over
from gpdf_service.planning.routes import Leg, Route, Wish, find_cut, find_routes, is_as_level, take_up
from gpdf_service.planning.shape import lengths
from gpdf_service.planning.timing import speed_limit
from gpdf_service.planning.turning import Facing, Stuck, time_poses, turn_route
from gpdf_service.search.free_space import FreeSpace
from gpdf_service.search.ways import STEPPED, WIDE, Prefer, Ways, count_steps, fields_of, here, prices
from gpdf_service.types import Agent, Certificate, FloatArray, IntArray, PlanOptions, PlanResult, Status, Trajectory

Clock = Callable[[], float]
NO_OPTIONS = PlanOptions()
PATIENCE = 0.005
"""[s] A path that was found this long after its deadline is not certified any more: that takes as long again."""
WAYPOINTS_PER_SECOND = 300_000
"""Waypoints that the optimiser looks at in a second: with a deadline, it takes no more steps than there is time for."""
LATE = "the deadline passed before a path was certified. Allow more time."
WALL = 1000.0
"""[1/m] A millimetre too near, which is what the certificate resolves, doubles the push away."""


class _Candidate(NamedTuple):
    """A path that may be certified, the costs on the way to it, and numbers about it."""

    legs: list[Leg]
    costs: FloatArray
    details: dict[str, float]


class _Made(NamedTuple):
    """What was made of a candidate: its trajectory, what is proven of that, and what it takes."""

    trajectory: Trajectory
    certificate: Certificate
    takes: FloatArray
    details: dict[str, float]
    costs: FloatArray


def plan_path(
    space: FreeSpace,
    start: FloatArray,
    goal: FloatArray,
    config: PlanningConfig,
    *,
    options: PlanOptions = NO_OPTIONS,
    ways: Callable[..., Ways] | None = None,
    hidden_height: float = 0.0,
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
        ways: All ways of the body, as one prefers them; only the shortest one is looked for if it is not given.
        hidden_height: How high things may be in the scene that nobody can see [m].
        deadline: On `clock`; a certified path that is not yet optimised is returned when it passes.
        clock: Monotonic seconds.
    """
    began = clock()
    ends = find_ends(space, start, [goal, *options.other_goals], options)
    if isinstance(ends, Refusal):
        details = ends.room | ({} if ends.nearest is None else _place("nearest", ends.nearest))
        return PlanResult(ends.status, ends.message, timings={"total": clock() - began}, details=details)
    if deadline is not None and clock() > deadline:
        return PlanResult(Status.TIMEOUT, "the deadline passed before the search began. Allow more time.")

    def left() -> float:
        return np.inf if deadline is None else deadline - clock()

    wish = Wish(Prefer.COMPANION if options.prefer is None else Prefer(options.prefer), ways, left)
    task = _Task(space, ends, config, options, wish, hidden_height, clock, began)
    found, route = _best(task)
    if found is None:
        found = _refuse_cut(task)
    elif route is not None and options.alternatives:
        others = islice(_others(task, route), options.alternatives)
        best, *rest = sorted([found, *others], key=lambda way: way.details["cost"])
        found = replace(best, alternatives=tuple(rest))
    found.timings["total"] = clock() - began
    return found


class _Task(NamedTuple):
    """A request that is at work; the attributes are those of `plan_path`."""

    space: FreeSpace
    ends: Ends
    config: PlanningConfig
    options: PlanOptions
    wish: Wish
    hidden_height: float
    clock: Clock
    began: float

    def left(self) -> float:
        """Seconds to the deadline; inf if there is none."""
        return self.wish.left()


def _best(task: _Task) -> tuple[PlanResult | None, Route | None]:
    """The result for the best route that certifies, and the route; or why none does, or nothing if there was none."""
    refused: PlanResult | None = None
    stuck: Stuck | None = None
    for route in _routes(task):
        if isinstance(route, Stuck):
            stuck = stuck or route
            continue
        made = _follow(task, route)
        if made.status is Status.OK:
            if (rival := find_rival(task.space, task.ends, task.wish, route)) is not None:
                other = _follow(task, rival)
                if other.status is Status.OK and other.details["cost"] < made.details["cost"]:
                    return other, rival
            return made, route
        if made.status is Status.TIMEOUT and task.left() <= 0.0:
            return made, None
        refused = refused or made
    if refused is not None and stuck is not None:
        refused = PlanResult(stuck.status, stuck.message, details=_place("cut", stuck.at))
    return refused, None


def _follow(task: _Task, route: Route) -> PlanResult:
    """A trajectory along a route: of the first candidate that certifies; else UNCERTIFIED, with what is wrong."""
    space, searched = task.space, task.clock()
    legs = pull_over(route.legs, _meet([end.xy for end in task.ends.via]), task.config.waypoint_spacing)
    made = _at_once(task, legs)
    if made is None or not made.certificate.holds:
        found = _certified(task, legs)
        if isinstance(found, PlanResult):
            return found
        made = found
    details = made.details | {"nodes": float(len(space.graph.position))}
    details |= {"goal": float(route.goal), "warm": float(route.warm)}
    details |= _effort(space.agent, made.takes, made.trajectory.ground, made.trajectory.headings, task.wish.prefer)
    timings = {"search": searched - task.began, "optimise": task.clock() - searched}
    parts = made.trajectory, made.certificate, timings, details, made.costs
    return PlanResult(Status.OK, task.ends.moved, *parts)


def _certified(task: _Task, legs: list[Leg]) -> _Made | PlanResult:
    """What is made of the first candidate that certifies, or why none does."""
    space, spacing, first, hurried = task.space, task.config.waypoint_spacing, None, False
    for candidate in _candidates(task, legs):
        left = task.left()
        if left < -PATIENCE:
            return PlanResult(Status.TIMEOUT, LATE)
        bent = candidate.legs is not legs
        hurried = hurried or left < 0.0 or (left < np.inf and bent and not candidate.details["converged"])
        contact, top, level, headings = _stand(space, candidate.legs, spacing, _facing(task.options))
        certificate = certify(space, top, contact, level, headings, task.hidden_height)
        first = first or certificate
        if certificate.holds:
            limit, takes = speed_limit(space, contact, headings, level, _preferred(task), task.wish.prefer)
            body_top = contact + np.array([0.0, 0.0, space.agent.height])
            trajectory = Trajectory(body_top, contact, *time_poses(body_top, headings, space.agent, limit))
            return _Made(trajectory, certificate, takes, candidate.details, candidate.costs)
    assert first is not None
    if hurried:
        return PlanResult(Status.TIMEOUT, LATE)
    words = f"a path was found, but it cannot be certified: {first.reason}. Choose other places, or a smaller body."
    return PlanResult(Status.UNCERTIFIED, words, certificate=first)


def _preferred(task: _Task) -> float:
    """Room beside the body with which it goes freely [m]."""
    return task.config.preferred_clearance * task.space.agent.disc_radius


def _at_once(task: _Task, legs: list[Leg]) -> _Made | None:
    """What is made of the first candidate, if it is one piece of a cylinder's path and there is time for all of it."""
    space, agent, left = task.space, task.space.agent, task.left()
    level, path, _ = legs[0]
    if len(legs) > 1 or agent.discs > 1 or left < 0.0:
        return None
    if left < np.inf and lengths(path)[-1] > left * WAYPOINTS_PER_SECOND * task.config.waypoint_spacing:
        return None
    bending = _bending(legs[0], _liking(task.config, task.wish.prefer), False, left)
    pace = Pace(agent.radius, agent.speed, agent.acceleration, agent.turn_rate, _preferred(task))
    boxes = here(space, level, task.wish.prefer), fields_of(legs[0].space, level)
    made = go_at_once(np.ascontiguousarray(path), *boxes, bending, pace)
    certificate = judge(space, made.contact, made.seen, task.hidden_height)
    candidate = _candidate(legs, [made.run] if made.is_bent else [])
    trajectory = Trajectory(made.top, made.contact, made.times, made.headings)
    return _Made(trajectory, certificate, made.takes, candidate.details, candidate.costs)


def _others(task: _Task, best: Route) -> Iterator[PlanResult]:
    """More ways that differ from the best one, until the deadline."""
    for route in find_others(task.space, task.ends, task.wish, best):
        if task.left() <= 0.0:
            return
        made = _follow(task, route)
        if made.status is Status.OK:
            yield made


def _refuse_cut(task: _Task) -> PlanResult:
    """There is no path: why."""
    goal_end = next(end for end in task.ends.goals if end)
    cut = find_cut(task.space, [task.ends.start, *task.ends.via, goal_end])
    assert cut is not None
    why = explain_no_path(task.space, *cut, task.left, task.hidden_height)
    details = {"largest_radius": why.largest_radius} | _place("cut", why.at)
    details |= {f"short_{kind}": amount for kind, amount in why.short.items()}
    return PlanResult(Status.NO_VALID_PATH, why.message, details=details)


def _place(name: str, place: FloatArray) -> dict[str, float]:
    """A place as numbers by name, without what is not known."""
    return {f"{name}_{axis}": float(v) for axis, v in zip("xyz", place, strict=True) if np.isfinite(v)}


def _liking(config: PlanningConfig, prefer: Prefer) -> PlanningConfig:
    """The optimiser wants as much room beside the body as who asks for a wide way."""
    return replace(config, preferred_clearance=WIDE * config.preferred_clearance) if prefer == Prefer.WIDE else config


def _effort(
    agent: Agent, takes: FloatArray, contact: FloatArray, headings: FloatArray, prefer: Prefer
) -> dict[str, float]:
    """What a way that `takes` so much costs the body [s], how many steps there are, and their rise and fall [m].

    Turns on the spot of a body of discs cost their time.
    """
    cost = takes @ prices(agent, prefer)
    if agent.discs > 1:
        stands = (np.diff(contact[:, :2], axis=0) == 0.0).all(axis=1)
        cost += np.abs(np.diff(headings))[stands].sum() / agent.turn_rate
    return {"cost": float(cost), "steps": float(count_steps(contact)), "stepped": float(takes[STEPPED])}


def _routes(task: _Task) -> Iterator[Route | Stuck]:
    """The way from before, if it can be taken up; then, if that does not certify, those of the graph.

    For a body of discs these are ways of one disc; if bending does not make them its own, it searches over its poses,
    for as many seconds as are left.
    """
    space, options = task.space, task.options
    if options.warm_start is not None and (known := take_up(space, task.ends, options.warm_start)) is not None:
        yield known
    routes = find_routes(space, task.ends, task.wish)
    yield from routes
    if space.agent.discs > 1:
        yield from (turn_route(space, route, task.left(), _facing(options)) for route in routes)


def _candidates(task: _Task, legs: list[Leg]) -> Iterator[_Candidate]:
    """Paths from the best to the safest: CHOMP, CHOMP that bends round every point behind a wall, then the seed."""
    for bent in _tries(task, legs):
        yield _candidate([leg for leg, _ in bent], [run for _, run in bent if run is not None])
    yield _Candidate(legs, np.zeros(0), {"iterations": 0.0, "evaluations": 0.0, "converged": 0.0})


def _candidate(legs: list[Leg], runs: list[ChompResult]) -> _Candidate:
    """A path that these runs of the optimiser made."""
    details = {
        "iterations": float(sum(run.iterations for run in runs)),
        "evaluations": float(sum(run.evaluations for run in runs)),
        "converged": float(all(run.converged for run in runs)),
    }
    return _Candidate(legs, _sum_of([run.costs for run in runs]), details)


def _sum_of(costs: list[FloatArray]) -> FloatArray:
    """What all pieces cost after each step: one that came to rest keeps its cost."""
    if len(costs) == 1:
        return costs[0]
    most = max(map(len, costs), default=0)
    steps = np.arange(most)
    return sum((one[np.minimum(steps, len(one) - 1)] for one in costs), np.zeros(most))


def _tries(task: _Task, legs: list[Leg]) -> Iterator[list[Bent]]:
    """All pieces bent, in each way that is tried, while there is time; one that would take more steps stays."""
    config = _liking(task.config, task.wish.prefer)

    def alone(pieces: list[Leg], *, strict: bool) -> list[Bent]:
        made = [(leg, _bend(leg, config, strict, task.left())) for leg in pieces]
        return [bent if is_as_level([bent[0]], [leg], MORE_STEPS) else (leg, None) for leg, bent in made]

    def together(pieces: list[Leg]) -> list[Bent]:
        if len(pieces) > 1:
            joined = Leg(pieces[0].level, np.concatenate([leg.path for leg in pieces]), task.space)
            one = _bend(joined, config, False, task.left())
            if is_as_level([one[0]], pieces, MORE_STEPS):
                return [one]
        return alone(pieces, strict=False)

    via = [end.xy for end in task.ends.via]
    if task.left() < 0.0:
        return
    meet = _meet(via)
    bent = bend_over(_beside_each_other(legs, via), meet, task.config.waypoint_spacing, together)
    yield bent
    if (len(bent) < len(legs) or any(map(meet, legs, legs[1:]))) and task.left() >= 0.0:
        yield alone(legs, strict=False)
    if task.left() >= 0.0:
        yield alone(legs, strict=True)


def _meet(via: list[FloatArray]) -> Meet:
    """Pieces of poses stay as they are, and so does a via point."""

    def meet(one: Leg, other: Leg) -> bool:
        return one.level != other.level and one.path.shape[1] == other.path.shape[1] == 2 and _is_free(other, via)

    return meet


def _is_free(leg: Leg, via: list[FloatArray]) -> bool:
    """Whether a piece begins at no via point."""
    return not any(np.array_equal(leg.path[0, :2], place) for place in via)


def _beside_each_other(legs: list[Leg], via: list[FloatArray]) -> list[list[Leg]]:
    """Pieces that go on from each other on one level, on level ground and on steps, without a via point between them.

    They may be bent as one. Of poses each is for itself.
    """
    made = [[legs[0]]]
    for leg in legs[1:]:
        if made[-1][-1].level != leg.level or leg.path.shape[1] > 2 or not _is_free(leg, via):
            made.append([leg])
        else:
            made[-1].append(leg)
    return made


def _bend(leg: Leg, config: PlanningConfig, strict: bool, seconds: float) -> Bent:
    """A piece of the path after CHOMP; as it was where nothing moves, no time is left, or ground is not known."""
    level, path, space = leg
    bending = _bending(leg, config, strict, seconds)
    bent, found = bend(path, here(space, level), fields_of(space, level, exact=strict), bending)
    if len(found.xi) == 0:
        return leg, None
    return (leg if len(bent) == 0 else leg._replace(path=bent)), found


def _bending(leg: Leg, config: PlanningConfig, strict: bool, seconds: float) -> Bending:
    """How a piece is bent. `strict`ly, the path bends round the points themselves behind a wall.

    That has the margin of the search and what a chord between waypoints cuts from a turn.

    Obstacles push with 1 at most against the tension λ_s, so λ_s is the radius of the tightest bend: a spline through
    waypoints as far apart follows it.
    """
    space, agent, wide = leg.space, leg.space.agent, leg.space.agent.disc_radius
    stiff = config.smoothness_weight(wide)
    spacing = max(config.waypoint_spacing, stiff)
    wall, radius = (WALL, space.radius + spacing**2 / (8.0 * wide)) if strict else (0.0, space.reach)
    return Bending(
        Discs(agent.offsets, radius),
        Wants(agent.height, config.preferred_clearance * wide, wall, stiff),
        (spacing, config.waypoint_spacing),
        WAYPOINTS_PER_SECOND * seconds,
        Stop(config.max_iterations, config.tolerance),
    )


def _facing(options: PlanOptions) -> Facing:
    return options.start_heading, options.goal_heading


_Stands = tuple[FloatArray, FloatArray, IntArray, FloatArray]
"""Contact points, where d_g = h over them, levels and headings of a path."""


def _stand(space: FreeSpace, legs: list[Leg], spacing: float, facing: Facing) -> _Stands:
    """How a body stands along a whole path, where legs meet once; one of discs turns at the ends to face as asked."""
    agent, lever, parts = space.agent, float(space.agent.offsets[-1]), list[_Stands]()
    for level, path, _ in legs:
        on_level = here(space, level), fields_of(space, level)
        contact, top, heading = stand_along(path, lever, spacing, *on_level, agent.height)
        first, on = int(bool(parts)), np.full(len(heading), level)
        parts.append((contact[first:], top[first:], on[first:], heading[first:]))
    if len(legs) == agent.discs == 1:
        return parts[0]
    contact, top, on, heading = map(np.concatenate, zip(*parts, strict=True))
    if agent.discs > 1:
        turned = [(0, facing[0]), *enumerate(heading), (-1, facing[1])]
        row = np.array([i % len(contact) for i, angle in turned if angle is not None])
        heading = np.unwrap([angle for _, angle in turned if angle is not None])
        contact, top, on = contact[row], top[row], on[row]
    keep = moving(contact, heading, lever)
    return contact[keep], top[keep], on[keep], heading[keep]

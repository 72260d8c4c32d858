"""From a request to a baseline's answer, with the same certificate as the planner's own."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from typing import Literal

import numpy as np

from gpdf_service.baselines.astar import find_astar_path
from gpdf_service.baselines.flat import find_end, flat_worlds
from gpdf_service.baselines.prm import SECONDS, find_prm_path
from gpdf_service.baselines.single_gpdf import optimize_in_one_field
from gpdf_service.planning.certificate import HEIGHT_SHARE, certify
from gpdf_service.planning.endpoints import Endpoint, Refusal
from gpdf_service.planning.shape import resample, subdivide
from gpdf_service.planning.timing import time_path
from gpdf_service.scene import Scene
from gpdf_service.search.free_space import FreeSpace
from gpdf_service.types import Agent, Certificate, FloatArray, PlanResult, Status, Trajectory

Baseline = Literal["single_gpdf", "astar", "prm"]
LEAST_MOVE = 1e-6
"""[m] Waypoints closer together than this are one."""


def plan_baseline(
    scene: Scene,
    start: FloatArray,
    goal: FloatArray,
    agent: Agent,
    method: Baseline,
    *,
    deadline: float | None = None,
    clock: Callable[[], float] = time.monotonic,
) -> PlanResult:
    """Plan with one of the paper's baselines.

    The answer is OK only if its certificate holds and its top keeps the body's height; otherwise it is UNCERTIFIED and
    still carries the trajectory, to be measured and drawn, never to be followed.

    Args:
        scene: Where.
        start: (x, y) or (x, y, z of the ground) [m].
        goal: The same.
        agent: The body.
        method: Which baseline.
        deadline: On `clock`.
        clock: Monotonic seconds.
    """
    began = clock()
    space = scene.free_space(agent)
    worlds = flat_worlds(scene, agent)
    ends = find_end(space, worlds, start, "start"), find_end(space, worlds, goal, "goal")
    for end in ends:
        if isinstance(end, Refusal):
            return PlanResult(end.status, end.message, timings={"total": clock() - began})
    a, b = (end for end in ends if isinstance(end, Endpoint))
    if a.level != b.level:
        return PlanResult(Status.NO_VALID_PATH, f"{method} plans in one plane, and the goal is on another storey.")
    world = worlds[a.level]
    seconds = SECONDS if deadline is None else min(SECONDS, deadline - clock())
    stands = np.array_equal(a.xy, b.xy)
    if stands:
        path: FloatArray | None = np.array([a.xy, b.xy])
    else:
        sampled = method == "prm"
        path = find_prm_path(world, a.xy, b.xy, max(seconds, 0.0)) if sampled else find_astar_path(world, a.xy, b.xy)
    if deadline is not None and clock() > deadline:
        return PlanResult(Status.TIMEOUT, f"the deadline passed while {method} searched. Allow more time.")
    if path is None:
        words = f"{method} found no way for the {agent.name} between these places. Try method dual_gpdf."
        return PlanResult(Status.NO_VALID_PATH, words, timings={"total": clock() - began})
    top = _lift(scene, space, a, path)
    if method == "single_gpdf" and not stands:
        spacing = max(scene.config.planning.waypoint_spacing, agent.radius / 4)
        shape = agent.height, agent.radius
        top = optimize_in_one_field(resample(top, spacing), scene.whole_field, *shape, scene.config.planning)
    result = _certified(space, a.level, subdivide(_distinct(top), scene.config.planning.waypoint_spacing), method)
    return dataclasses.replace(result, timings={"total": clock() - began})


def _lift(scene: Scene, space: FreeSpace, start: Endpoint, path: FloatArray) -> FloatArray:
    """Put a path in plan on the plane that crosses the start at the body's height."""
    floor = float(scene.surfaces[start.level].height_at(start.xy[None])[0])
    return np.column_stack([path, np.full(len(path), floor + space.agent.height)])


def _distinct(top: FloatArray) -> FloatArray:
    """Without waypoints that repeat the one before; two rows at least."""
    moved = np.linalg.norm(np.diff(top, axis=0), axis=1) > LEAST_MOVE
    if not moved.any():
        return top[[0, -1]]
    distinct: FloatArray = top[np.concatenate([[True], moved])]
    return distinct


def _certified(space: FreeSpace, level: int, top: FloatArray, method: Baseline) -> PlanResult:
    """Stand under the path, certify, stamp; UNCERTIFIED where the certificate does not hold."""
    agent = space.agent
    floor = space.levels[level].surface.height_at(top[:, :2])
    contact = np.column_stack([top[:, :2], np.where(np.isnan(floor), top[:, 2] - agent.height, floor)])
    times, headings = time_path(top, agent)
    proven = certify(space, top, contact, np.full(len(top), level), headings)
    certificate = _with_height(proven, top, contact, agent)
    trajectory = Trajectory(top, contact, times, headings)
    if certificate.holds:
        return PlanResult(Status.OK, "", trajectory, certificate)
    words = f"{method} found a path that no body may follow: {certificate.reason}. Try method dual_gpdf."
    return PlanResult(Status.UNCERTIFIED, words, trajectory, certificate)


def _with_height(certificate: Certificate, top: FloatArray, contact: FloatArray, agent: Agent) -> Certificate:
    """Make the certificate also ask for the body's height, which a plane or a flight over a table does not keep.

    Upright over the contact, so that a path on the floor beside a platform is not blamed for the platform's nearness.
    """
    off = float(np.abs(top[:, 2] - contact[:, 2] - agent.height).max())
    if not np.isfinite(certificate.max_height_deviation):  # the ground is not known everywhere below
        certificate = dataclasses.replace(certificate, max_height_deviation=off)
    if certificate.holds and off > HEIGHT_SHARE * agent.height:
        reason = f"the body's top is {off:.2f} m off its height"
        return dataclasses.replace(certificate, holds=False, reason=reason)
    return certificate

"""The paper's block diagram as two functions: build a scene, plan in it. Uttsha et al. 2024, Fig. 1."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from gpdf_service.baselines import plan_baseline
from gpdf_service.config import Config
from gpdf_service.errors import CloudError, RequestError
from gpdf_service.perception import check_points
from gpdf_service.planning import plan_path
from gpdf_service.scene import Progress as Progress
from gpdf_service.scene import Scene, assemble_scene
from gpdf_service.types import Agent, BoolArray, FloatArray, PlanResult, resolve_agent

Method = Literal["dual_gpdf", "single_gpdf", "astar", "prm"]


def build_scene(
    points: ArrayLike,
    ground: ArrayLike | None = None,
    config: Config | None = None,
    *,
    progress: Progress = lambda stage, done: None,
) -> Scene:
    """Build a scene from a point cloud: ground, levels, Ground GPDFs.

    Args:
        points: The cloud in the scene frame, z up [m], shape (n, 3).
        ground: Which points are ground, shape (n,); our own segmentation where it is not given.
        config: Settings; the defaults work.
        progress: Called as the work goes on.

    Raises:
        CloudError: the cloud cannot be used (empty, not finite, wrong shape, wrong unit).
        NoGroundError: no walkable ground was found.
    """
    config = config or Config()
    cloud = check_points(points)
    labels = None if ground is None else _check_mask(ground, len(cloud))
    return assemble_scene(cloud, labels, config, progress=progress)


def plan(
    scene: Scene,
    start: Sequence[float] | FloatArray,
    goal: Sequence[float] | FloatArray,
    agent: str | Agent = "human",
    *,
    method: Method = "dual_gpdf",
    deadline_s: float | None = None,
    clock: Callable[[], float] = time.monotonic,
) -> PlanResult:
    """Plan a trajectory for a body from start to goal.

    Args:
        scene: From `build_scene` or `load_scene`.
        start: (x, y), or (x, y, z of the ground there) [m].
        goal: The same.
        agent: A name in `AGENTS`, or an `Agent`.
        method: "dual_gpdf", the paper's method with a certificate, or one of its baselines, "single_gpdf", "astar" and
            "prm"; a baseline's path that cannot be certified comes back as UNCERTIFIED, for comparison only.
        deadline_s: Seconds that the answer may take; none when not given.
        clock: Monotonic seconds, for tests.

    Returns:
        A result whose `status` is OK, or says why there is no trajectory: never an exception for "no path".

    Raises:
        RequestError: the request cannot be understood (shape, not finite, unknown method).
        UnknownAgentError: no agent has that name.
    """
    body = resolve_agent(agent)
    if method not in get_args(Method):
        raise RequestError("method", f"{method!r}", f"Use one of {', '.join(get_args(Method))}.")
    ends = _check_place(start, "start"), _check_place(goal, "goal")
    if deadline_s is not None and not deadline_s > 0:
        raise RequestError("deadline_s", f"{deadline_s!r}", "It must be a positive number of seconds.")
    deadline = None if deadline_s is None else clock() + deadline_s
    if method != "dual_gpdf":
        return plan_baseline(scene, *ends, body, method, deadline=deadline, clock=clock)
    space = scene.free_space(body)
    return plan_path(space, *ends, scene.config.planning, deadline=deadline, clock=clock)


def _check_mask(ground: ArrayLike, count: int) -> BoolArray:
    mask = np.asarray(ground)
    if mask.dtype != np.bool_ or mask.shape != (count,):
        found = f"an array of {mask.dtype} of shape {mask.shape}"
        raise CloudError("ground labels", found, f"Pass booleans of shape ({count},), one for each point.")
    return mask


def _check_place(place: Sequence[float] | FloatArray, name: str) -> FloatArray:
    try:
        made = np.asarray(place, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise RequestError(name, f"{place!r}", "Pass (x, y) or (x, y, z) in metres.") from error
    if made.shape not in ((2,), (3,)) or not np.isfinite(made).all():
        raise RequestError(name, f"{place!r}", "Pass (x, y) or (x, y, z): finite numbers in metres.")
    return made

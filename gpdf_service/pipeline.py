"""The paper's block diagram as two functions: build a scene, plan in it. Uttsha et al. 2024, Fig. 1."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from math import isfinite
from numbers import Integral, Real
from typing import cast, get_args

import numpy as np
from numpy.typing import ArrayLike

from gpdf_service.baselines import plan_baseline
from gpdf_service.clouds import check_labels, check_points
from gpdf_service.config import Config
from gpdf_service.errors import ConfigError, RequestError
from gpdf_service.perception import check_origins
from gpdf_service.planning import plan_path
from gpdf_service.scene import Progress as Progress
from gpdf_service.scene import Scene, assemble_scene
from gpdf_service.shades import shades_of
from gpdf_service.types import Agent, FloatArray, PlanOptions, PlanResult, Trajectory, is_number, resolve_agent
from gpdf_service.types import Method as Method
from gpdf_service.types import Preference as Preference

Place = Sequence[float] | FloatArray
"""(x, y), or (x, y, z of the ground there) [m]."""
MOST_PLACES = 100
"""Via points, and other goals, of one request: each costs a search."""
MOST_ALTERNATIVES = 9
"""Ways of one request beside the best: more than anybody chooses among, and each costs a plan."""


def build_scene(
    points: ArrayLike,
    ground: ArrayLike | None = None,
    config: Config | None = None,
    *,
    origins: ArrayLike | None = None,
    colours: ArrayLike | None = None,
    progress: Progress = lambda stage, done: None,
) -> Scene:
    """Build a scene from a point cloud: ground, levels, Ground GPDFs.

    Args:
        points: The cloud in the scene frame, z up [m], shape (n, 3).
        ground: Which points are ground, shape (n,); our own segmentation where it is not given.
        config: Settings; the defaults work.
        origins: Where the rays to the points began [m], shape (3,) or (n, 3): the scanner's stations. Then what they
            saw decides which holes of the ground are free, and not rules.
        colours: Red, green and blue of the points, uint8 of shape (n, 3), for pictures alone.
        progress: Called as the work goes on.

    Raises:
        ConfigError: `config` is no `Config`.
        CloudError: the cloud cannot be used (empty, not finite, wrong shape, wrong unit).
        NoGroundError: no walkable ground was found.
    """
    config = Config() if config is None else config
    if not isinstance(config, Config):
        raise ConfigError("config", f"a {type(config).__name__}", "Pass a gpdf.Config; Config.from_mapping makes one.")
    cloud = check_points(points)
    labels = None if ground is None else check_labels(ground, len(cloud))
    began = None if origins is None else check_origins(origins, cloud)
    shades = None if colours is None else shades_of(cloud, colours)
    scene = assemble_scene(cloud, labels, config, origins=began, progress=progress)
    scene.shades = shades
    return scene


def plan(
    scene: Scene,
    start: Place,
    goal: Place,
    agent: str | Agent = "human",
    *,
    method: Method = "dual_gpdf",
    via: Sequence[Place] = (),
    other_goals: Sequence[Place] = (),
    snap: float = 0.0,
    warm_start: Trajectory | FloatArray | None = None,
    start_heading: float | None = None,
    goal_heading: float | None = None,
    prefer: Preference | None = None,
    alternatives: int = 0,
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
        via: Places that the path goes through, in this order.
        other_goals: More goals; the one with the shortest way is taken, `details["goal"]` is its number, 0 the first.
        snap: How far a place where the body cannot be may be moved to the nearest one where it can [m]; 0 refuses it.
        warm_start: A trajectory from before, or its contact points (n, 3) [m]: taken up from where the start is near it
            if it is still clear and ends near the goal; not with `via`.
        start_heading: Where a body of discs faces at the start [rad], to turn there if it must; free when not given.
        goal_heading: The same at the goal.
        prefer: "quickest", "level" (no steps where there is another way) or "wide" (room beside the body); not given,
            the way that a sighted companion would take: time, and effort as the body's `Agent` says what it costs it.
        alternatives: How many more ways are wanted that differ, each a result in `alternatives`, the best first.
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
    facing = _check_heading(start_heading, "start_heading"), _check_heading(goal_heading, "goal_heading")
    wanted = _check_preference(prefer), _check_alternatives(alternatives)
    options = PlanOptions(*_check_places_of(via, other_goals, snap, warm_start), *facing, *wanted)
    if deadline_s is not None and not (isinstance(deadline_s, Real) and deadline_s > 0):
        raise RequestError("deadline_s", f"{deadline_s!r}", "It must be a positive number of seconds.")
    deadline = None if deadline_s is None else clock() + deadline_s
    if method != "dual_gpdf":
        if _asks_for_more(options):
            words = "Baselines take one goal and no via, snap, warm_start, heading, prefer or alternatives."
            raise RequestError("method", f"{method!r} with options of the planner", words)
        return plan_baseline(scene, *ends, body, method, deadline=deadline, clock=clock)
    space = scene.free_space(body)
    settings, ways = scene.config.planning, partial(scene.ways, body)
    hidden = scene.hidden_height
    return plan_path(
        space, *ends, settings, options=options, ways=ways, hidden_height=hidden, deadline=deadline, clock=clock
    )


def _asks_for_more(options: PlanOptions) -> bool:
    """Whether a request has options that baselines do not take."""
    given = options.warm_start, options.start_heading, options.goal_heading, options.prefer
    asked = options.via or options.other_goals or options.snap or options.alternatives
    return bool(asked) or given != (None, None, None, None)


def _check_preference(prefer: object) -> str | None:
    if prefer is not None and prefer not in get_args(Preference):
        raise RequestError("prefer", f"{prefer!r}", f"Use one of {', '.join(get_args(Preference))}, or nothing.")
    return cast("str | None", prefer)


def _check_alternatives(count: object) -> int:
    if not isinstance(count, Integral) or isinstance(count, bool) or not 0 <= int(count) <= MOST_ALTERNATIVES:
        raise RequestError("alternatives", f"{count!r}", f"Ask for 0 to {MOST_ALTERNATIVES} more ways.")
    return int(count)


def _check_places_of(
    via: Sequence[Place], other_goals: Sequence[Place], snap: float, warm_start: Trajectory | FloatArray | None
) -> tuple[tuple[FloatArray, ...], tuple[FloatArray, ...], float, FloatArray | None]:
    if not is_number(snap) or snap < 0:
        raise RequestError("snap", f"{snap!r}", "It must be a finite number of metres, 0 or more.")
    return (
        _check_places(via, "via", "via point"),
        _check_places(other_goals, "other_goals", "other goal"),
        float(snap),
        None if warm_start is None else _check_warm_start(warm_start, via),
    )


def _check_places(places: Sequence[Place], name: str, each: str) -> tuple[FloatArray, ...]:
    if isinstance(places, tuple) and not places:
        return ()
    if not isinstance(places, Sequence | np.ndarray) or isinstance(places, str):
        raise RequestError(name, f"{places!r}", "Pass a list of places.")
    if len(places) > MOST_PLACES:
        raise RequestError(name, f"{len(places)} places", f"Give at most {MOST_PLACES}.")
    return tuple(_check_place(place, f"{each} {n}") for n, place in enumerate(places, start=1))


def _check_warm_start(warm_start: Trajectory | FloatArray, via: Sequence[Place]) -> FloatArray:
    known = _floats(warm_start.ground if isinstance(warm_start, Trajectory) else warm_start)
    finite = known is not None and bool(np.isfinite(known).all())
    if known is None or not finite or known.ndim != 2 or known.shape[1] != 3 or len(known) < 2:
        found = "no array of finite numbers" if known is None or not finite else f"an array of shape {known.shape}"
        raise RequestError("warm_start", found, "Pass contact points, (n ≥ 2, 3).")
    if len(via):
        raise RequestError("warm_start", "together with via points", "Give one or the other.")
    return known


def _check_heading(heading: float | None, name: str) -> float | None:
    if heading is not None and not is_number(heading):
        raise RequestError(name, f"{heading!r}", "It must be a finite number of radians.")
    return heading


def _check_place(place: Place, name: str) -> FloatArray:
    made = _floats(place)
    if made is None or made.shape not in ((2,), (3,)) or not all(map(isfinite, made.tolist())):
        raise RequestError(name, f"{place!r}", "Pass (x, y) or (x, y, z): finite numbers in metres.")
    return made


def _floats(values: object) -> FloatArray | None:
    """A new array of numbers, if they are that."""
    try:
        return np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        return None

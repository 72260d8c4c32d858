"""OMPL's RRT-Connect with simplification, RRT* and VAMP beside the planner: same queries, same points, same run.

OMPL's test is the planner's own, `is_clear`: exact over a whole segment, compiled. OMPL calls it through Python, which
adds a few microseconds to each of `checks` calls. It draws its own random numbers, so runs differ. VAMP has its own
test; how many of the paths are `clear` the exact one says of all.

The work is not the same. A peer ends with a polyline in plan between two places of free ground. Ours has found level,
steps and slopes there and weighed other ways; `p50_search_ms` is what that took. Then it has bent the path, proven it
with its ground and over its whole length, and given it headings and time stamps. VAMP's binding copies the points at
each call, which is no planning: `p50_search_ms` is what it says itself that planning took.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from itertools import pairwise

import numpy as np

from gpdf_service.baselines import simd
from gpdf_service.baselines.sampling import sample_path
from gpdf_service.bench.report import Row
from gpdf_service.pipeline import plan
from gpdf_service.planning.shape import is_path_clear
from gpdf_service.scene import Scene
from gpdf_service.search.places import is_clear
from gpdf_service.types import Agent, FloatArray, Status

SECONDS = 0.99
"""[s] That a peer may search; RRT* takes all of it. From 1 s on OMPL watches the time in a thread and
waits for that to wake up: by the clock RRT-Connect took two to four times as long as it worked."""
STEP = 0.01
"""[m] Clearance is looked at this often along a path."""
STRIDE = 0.1
"""[m] Bends are measured between straight pieces of this length, a foot's: corners closer together add up."""
PEERS = {"rrt_connect": "RRTConnect", "rrt_star": "RRTstar"}

_Found = tuple[FloatArray | None, float | None]
"""A path in plan, (n, 2) [m], or none; and how long the search alone took, where it tells [s]."""


def compare(scene: Scene, agent: Agent, pairs: FloatArray) -> list[Row]:
    """Measure the planners on pairs of places on the first level, shape (n, 2, 2) [m].

    Room, length and bends are means over the pairs that all of them solve. `clear` are the paths that keep the radius
    over their whole length, by the same exact test.
    """
    space = scene.free_space(agent)
    surface, obstacles = space.levels[0].surface, space.levels[0].places
    low, high = surface.origin, surface.origin + surface.cell_width * np.array(surface.height.shape)
    checks = dict.fromkeys(PEERS, 0)

    def ours(start: FloatArray, goal: FloatArray) -> _Found:
        result = plan(scene, start, goal, agent)
        if result.status is not Status.OK or result.trajectory is None:
            return None, None
        return result.trajectory.ground[:, :2], result.timings["search"]

    def peer(name: str) -> Callable[[FloatArray, FloatArray], _Found]:
        def clear(a: FloatArray, b: FloatArray) -> bool:
            checks[name] += 1
            return bool(is_clear(obstacles, a, b, agent.radius))

        return lambda start, goal: (sample_path(PEERS[name], clear, low, high, start, goal, SECONDS), None)

    planners = {"dual_gpdf": ours, **{name: peer(name) for name in PEERS}}
    if simd.is_here():
        planners["vamp"] = simd.rrt_connect(obstacles.standing.points, agent.radius, low, high)
    found = {name: [_timed(planner, *pair) for pair in pairs] for name, planner in planners.items()}
    both = [i for i in range(len(pairs)) if all(paths[i][0] is not None for paths in found.values())]
    rows = []
    for name, paths in found.items():
        made = [path for path, _ in paths if path is not None]
        measured = [
            _measure(space.levels[0].clearance, path, agent.radius) for i in both if (path := paths[i][0]) is not None
        ]
        mean = {key: float(np.mean([row[key] for row in measured])) for key in (measured[0] if measured else {})}
        seconds, worked, searched = (1e3 * float(np.median([spent[i] for _, spent in paths])) for i in range(3))
        clear = sum(is_path_clear(np.ascontiguousarray(path), obstacles, agent.radius) for path in made)
        rows.append(
            {"planner": name, "pairs": len(pairs), "solved": len(made), "clear": clear, "compared": len(both), **mean}
            | {"p50_ms": seconds, "p50_cpu_ms": worked, "p50_search_ms": searched}
            | {"checks": checks.get(name, 0) // max(len(pairs), 1)}
        )
    return rows


def _timed(
    planner: Callable[[FloatArray, FloatArray], _Found], start: FloatArray, goal: FloatArray
) -> tuple[FloatArray | None, tuple[float, float, float]]:
    """A path, the time that it took, the processor's [s], beside other work they differ, and the search's own."""
    began = time.perf_counter(), time.process_time()
    path, searched = planner(start, goal)
    spent = time.perf_counter() - began[0], time.process_time() - began[1]
    return path, (*spent, spent[0] if searched is None else searched)


def _measure(
    clearance: Callable[[FloatArray], tuple[FloatArray, object]], path: FloatArray, radius: float
) -> dict[str, float]:
    """Room [m], length [m] and bends [°] of a path in plan."""
    room = clearance(_along(path, STEP))[0] - radius
    legs = np.diff(_along(path, STRIDE), axis=0)
    bend = np.abs([_turn(a, b) for a, b in pairwise(legs)]) if len(legs) > 1 else np.zeros(1)
    length = float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
    return {
        "length_m": length,
        "least_room_m": float(room.min()),
        "mean_room_m": float(room.mean()),
        "sharpest_bend_deg": float(np.degrees(bend.max())),
        "turning_deg_per_m": float(np.degrees(bend.sum())) / length,
    }


def _turn(a: FloatArray, b: FloatArray) -> float:
    """Angle from direction a to direction b [rad]."""
    return float(np.arctan2(a[0] * b[1] - a[1] * b[0], a @ b))


def _along(path: FloatArray, spacing: float) -> FloatArray:
    """Places along a polyline, at most `spacing` apart."""
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    at = np.linspace(0.0, length[-1], max(2, int(np.ceil(length[-1] / spacing)) + 1))
    return np.column_stack([np.interp(at, length, column) for column in path.T])

"""Which ways people are led: steps that they take though a level way is there, over random pairs of places.

A level way is looked for in the free space of the same body that takes no step, by another search than the planner's.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gpdf_service.bench.judge import Judge
from gpdf_service.bench.report import Row, each
from gpdf_service.pipeline import plan
from gpdf_service.scene import Scene
from gpdf_service.tiles.surface import UNKNOWN
from gpdf_service.types import Agent, FloatArray, PlanResult, Status

HIGH_STEP = 0.2
"""[m] Steps that building codes do not let a stair have."""
LONGER = 1.3
"""[-] A level way that is no longer than this over the one that was taken would have been taken by a companion."""


def standing_pairs(scene: Scene, agent: Agent, count: int, rng: np.random.Generator) -> FloatArray:
    """Pairs of places where the body stands, on all levels: x, y and the ground's z, shape (count, 2, 3) [m]."""
    space, found = scene.free_space(agent), []
    for level, surface in enumerate(scene.surfaces):
        places = surface.centres(surface.state != UNKNOWN)
        found.append(places[space.levels[level].clearance(places[:, :2])[0] >= space.reach])
    places = np.concatenate(found)
    return places[rng.choice(len(places), (count, 2))]


def measure_ways(scene: Scene, judge: Judge, agent: Agent, pairs: FloatArray) -> Row:
    """Plan pairs of places (n, 2, 3) [m] and say how many take a high step that a level way of LONGER would spare."""
    level = replace(agent, max_step=HIGH_STEP)
    ok = high = needless = collisions = 0
    longer = []
    for start, goal in each(pairs, f"ways of a {agent.name}"):
        result = plan(scene, start, goal, agent)
        if result.status is not Status.OK or result.trajectory is None:
            continue
        ok += 1
        collisions += not judge.judge(result.trajectory, agent).collision_free
        quick = _length(plan(scene, start, goal, agent, prefer="quickest"))
        longer.append(result.trajectory.length / quick)
        if _highest_step(result.trajectory.ground) > HIGH_STEP:
            high += 1
            needless += _length(plan(scene, start, goal, level)) <= LONGER * result.trajectory.length
    return {
        "pairs": len(pairs),
        "ok": ok,
        "high_step": high,
        "needless": needless,
        "over_quickest": float(np.mean(longer)) if longer else float("nan"),
        "collisions": collisions,
    }


def _highest_step(contact: FloatArray) -> float:
    """The most that a way over contact points (n, 3) rises or falls from a waypoint to the next but one [m].

    Not what the certificate tells: who walks along a ledge has its height beside him, and takes no step.
    """
    return float(np.abs(contact[2:, 2] - contact[:-2, 2]).max(initial=0.0))


def _length(result: PlanResult) -> float:
    """Of its trajectory [m]; inf where there is none."""
    return np.inf if result.trajectory is None else result.trajectory.length

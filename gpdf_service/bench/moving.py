"""`gpdf bench plan --moving`: how much later the next plan comes when somebody steps in the way.

Each pair of places is planned in the scene as it stands; then a person stands on or beside that way, and it is planned
again, from the points of the person on: what is made again for them counts. Both run one after the other, warm.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

import numpy as np
from scipy.spatial import cKDTree

from gpdf_service.bench.report import Row
from gpdf_service.ground.foot import LEAST_OBSTACLE
from gpdf_service.pipeline import plan
from gpdf_service.planning.footprint import disc_places
from gpdf_service.scene import Scene
from gpdf_service.types import Agent, FloatArray, PlanResult, Status

T = TypeVar("T")
PERSON = (0.25, 1.75, 300)
"""Radius and height [m] of who steps in the way, and the points that a depth camera gives of them."""
ASIDE = 0.4
"""[m] Standard deviation of how far beside the way they stand."""
WARM = 3
"""Pairs before the clock runs."""
TRIES = 20
"""Places that are tried for them to stand."""
SAMPLE = 0.005
"""[m] The finished way is looked at this often."""


@dataclass
class _Times:
    """By the clock and of the processor [s], one entry a pair."""

    wall: list[float]
    cpu: list[float]

    def told(self, name: str) -> Row:
        """Medians and 99 of 100."""
        made: Row = {}
        for unit, seconds in (("", self.wall), ("cpu_", self.cpu)):
            for word, share in (("p50", 0.5), ("p99", 0.99)):
                made[f"{name}_{word}_{unit}ms"] = 1e3 * float(np.quantile(seconds, share)) if seconds else float("nan")
        return made


def measure_moving(scene: Scene, agent: Agent, count: int, rng: np.random.Generator) -> Row:
    """Plan `count` random pairs that can be planned, without and with somebody by the way.

    How much `later` the plan comes is told of those that are OK again; `change` is the share of the free space in it.
    """
    names = "standing", "moving", "later", "change"
    times = {name: _Times([], []) for name in names}
    statuses: Counter[str] = Counter()
    touched = done = 0
    while done < count + WARM:
        start, goal = _pair(scene, agent, rng)
        stood, *first = _timed(partial(plan, scene, start, goal, agent))
        if stood.trajectory is None:
            continue
        done += 1
        person = _person(stood.trajectory.ground, agent, rng)
        now = scene.with_obstacles(person)
        _, *change = _timed(partial(now.free_space, agent))
        moved, *then = _timed(partial(plan, now, start, goal, agent))
        if done <= WARM:
            continue
        statuses[moved.status.value] += 1
        touched += touches(moved, person, agent)
        whole = np.add(then, change)
        measured = first, whole, whole - first, change
        for name, (wall, cpu) in zip(names, measured, strict=True):
            if moved.status is Status.OK or name == "change":
                times[name].wall.append(wall)
                times[name].cpu.append(cpu)
    row: Row = {"pairs": count, **statuses, "collisions": touched}
    for name in names:
        row |= times[name].told(name)
    return row


def _timed(work: Callable[[], T]) -> tuple[T, float, float]:
    """What it returns, and its seconds by the clock and of the processor."""
    wall, cpu = time.perf_counter(), time.process_time()
    made = work()
    return made, time.perf_counter() - wall, time.process_time() - cpu


def _pair(scene: Scene, agent: Agent, rng: np.random.Generator) -> FloatArray:
    """Two places (x, y, z of the ground) where the body stands free, on whichever levels: shape (2, 3) [m]."""
    space, found = scene.free_space(agent), list[FloatArray]()
    area = np.array([np.count_nonzero(surface.state) for surface in space.surfaces], dtype=float)
    while len(found) < 2:
        level = int(rng.choice(len(area), p=area / area.sum()))
        surface = space.levels[level].surface
        xy = surface.origin + rng.random((64, 2)) * surface.height.shape * surface.cell_width
        good = surface.contains(xy) & (space.levels[level].clearance(xy)[0] >= space.reach)
        found += list(np.column_stack([xy, surface.height_at(xy)])[good][:1])
    return np.array(found)


def _person(way: FloatArray, agent: Agent, rng: np.random.Generator) -> FloatArray:
    """Points of somebody who stands by the way (n, 3), where they leave its ends free if they can: (k, 3) [m]."""
    radius, height, points = PERSON
    for _ in range(TRIES):
        foot = way[rng.integers(len(way))] + np.append(rng.normal(0.0, ASIDE, 2), 0.0)
        if np.linalg.norm(way[[0, -1], :2] - foot[:2], axis=1).min() > radius + agent.cylinder.radius + ASIDE:
            break
    angle, z = rng.uniform(0.0, 2.0 * np.pi, points), rng.uniform(0.0, height, points)
    made: FloatArray = foot + np.column_stack([radius * np.cos(angle), radius * np.sin(angle), z])
    return made


def touches(result: PlanResult, person: FloatArray, agent: Agent) -> bool:
    """Whether the body touches one of the points on a way that was called OK, by a look at every few millimetres."""
    if result.status is not Status.OK or result.trajectory is None:
        return False
    poses = np.column_stack([result.trajectory.ground, np.unwrap(result.trajectory.headings)])
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1)))
    at = np.linspace(0.0, along[-1], int(along[-1] / SAMPLE) + 2)
    dense = np.column_stack([np.interp(at, along, column) for column in poses.T])
    for offset in agent.offsets:
        near = cKDTree(disc_places(dense[:, [0, 1, 3]], offset)).query_ball_point(person[:, :2], agent.disc_radius)
        for point, rows in zip(person, near, strict=True):
            over = point[2] - dense[rows, 2]
            if ((over > LEAST_OBSTACLE) & (over < 0.99 * agent.height)).any():
                return True
    return False

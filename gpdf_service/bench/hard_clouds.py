"""Real clouds that defeated perception: stairs of a museum and a house at every angle, spiral ramps and bridges."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from gpdf_service.bench.columns import ColumnSearch
from gpdf_service.bench.report import Row
from gpdf_service.clouds import read_cloud
from gpdf_service.errors import GpdfError
from gpdf_service.pipeline import build_scene, plan
from gpdf_service.scene import Scene
from gpdf_service.synthetic.solids import turn_and_shift
from gpdf_service.types import AGENTS, Agent, FloatArray, Status

HALL, HOUSE, SPIRAL = "hall_stair_2cm.npz", "house_2storey_stairs_4cm.npz", "spiral_ramps_20cm.npz"
FOOT, HEAD = np.array([59.6, 34.4, 0.55]), np.array([59.6, 28.6, 5.15])
"""[m] In front of the museum's stair, and on its gallery."""
FLIGHT = np.array([[58.8, 30.9, 0.9], [60.4, 31.45, 4.6]])
"""[m] A piece of 0.55 m of its flight, with all that is over and under it."""
LOWER, UPPER = np.array([9.0, 14.0, 1.65]), np.array([14.0, 13.0, 5.35])
"""[m] On the two floors of the house."""
WIDTHS = (0.02, 0.03, 0.04, 0.05, 0.06)
"""[m] Voxels to which the museum is thinned."""
TURNS = 7
"""Angles that it is turned by, over a whole turn."""
SHIFTS = 16
"""Places of the cells under the spiral."""
HOUSE_TURNS = 35
"""Angles that a house is turned by."""
NEAR = 0.3
"""[m] Ends are moved by this at most: the points of the stair's surroundings are another in every voxel width."""
SPIRAL_CELL = 0.2
"""[m] Voxels of the spiral."""
SPIRAL_BODY = replace(AGENTS["human"], name="human_spiral", max_step=0.30, max_slope=0.40)
"""The limits that the scene was published with."""
SPIRAL_BODIES = (SPIRAL_BODY, AGENTS["spot"])
SPIRAL_QUERY = np.array([[-16.0, -6.0], [-26.0, -5.0]])
"""[m] The published query, at the ground."""
TURN = 0.3
"""[m] Of a path, in which it turns at a corner: half a stride."""
DECK = 500
"""Places: a component of fewer is no deck."""


def hall_rows(folder: Path, turns: int, seed: int, widths: Sequence[float] = WIDTHS) -> Iterator[Row]:
    """For each width: of so many angles, in how many a human gets up and down; with the flight cut, in how many yet.

    Args:
        folder: Where the clouds are.
        turns: Angles, at most.
        seed: Of the thinning.
        widths: Voxels to which it is thinned [m].
    """
    points = read_cloud(folder / HALL).points
    cut = ~((points >= FLIGHT[0]) & (points <= FLIGHT[1])).all(axis=1)
    for width in widths:
        row: Row = {"row": "hall", "width_m": width, "turns": turns, "up": 0, "down": 0, "cut_joined": 0}
        spent = []
        for turn in range(turns):
            T = turn_and_shift(2 * np.pi * turn / TURNS)
            for cloud, names in ((points, ("up", "down")), (points[cut], ("cut_joined", "cut_joined"))):
                thin = _thinned(cloud, width, np.random.default_rng(seed + turn)) @ T[:3, :3].T
                found, seconds = _both_ways(thin, FOOT @ T[:3, :3].T, HEAD @ T[:3, :3].T)
                spent.append(1e6 * seconds / len(thin))
                for name, ok in zip(names, found, strict=True):
                    row[name] += ok
        yield row | {"us_a_point": float(np.median(spent))}


def turned_house(folder: Path, turns: int, seed: int) -> Row:
    """Of so many angles that a scanned house is turned by, and shifted, in how many a human gets up its stair and down.

    Its flight is 20 cm wider than a human, and part of that was not seen: where the cells lie decides, too.
    """
    points, spent = read_cloud(folder / HOUSE).points, []
    row: Row = {"row": "house", "turns": turns, "up": 0, "down": 0}
    for turn in range(turns):
        shift = np.append(np.random.default_rng(seed + turn).random(2), 0.0)
        T = turn_and_shift(2 * np.pi * turn / turns)[:3, :3].T
        (up, down), seconds = _both_ways(points @ T + shift, LOWER @ T + shift, UPPER @ T + shift)
        row["up"], row["down"] = row["up"] + up, row["down"] + down
        spent.append(1e6 * seconds / len(points))
    return row | {"us_a_point": float(np.median(spent))}


def _thinned(points: FloatArray, width: float, rng: np.random.Generator) -> FloatArray:
    """One random point of each voxel."""
    order = rng.permutation(len(points))
    cell = np.floor(points[order] / width).astype(np.int64)
    _, first = np.unique(cell, axis=0, return_index=True)
    return points[np.sort(order[first])]


def _both_ways(points: FloatArray, low: FloatArray, high: FloatArray) -> tuple[tuple[bool, bool], float]:
    """Whether a human gets up and down, and the processor's seconds of the build."""
    began = time.process_time()
    try:
        scene = build_scene(points)
    except GpdfError:
        return (False, False), time.process_time() - began
    seconds = time.process_time() - began
    return (_gets(scene, low, high), _gets(scene, high, low)), seconds


def _gets(scene: Scene, start: FloatArray, goal: FloatArray) -> bool:
    return plan(scene, start, goal, "human", snap=NEAR).status is Status.OK


def shifted_spiral(folder: Path, seed: int) -> Row:
    """Of so many shifts within a metre, under how many Spot's published query over the spiral is answered yet.

    A deck's row of voxels lies one voxel lower. Where cells lie so that it has some of its own, it is a groove.
    """
    points, rng = read_cloud(folder / SPIRAL).points, np.random.default_rng(seed)
    row: Row = {"row": "spiral_shifted", "shifts": SHIFTS, "ok": 0}
    for shift in rng.random((SHIFTS, 2)):
        scene = build_scene(points + np.append(shift, 0.0))
        start, goal = SPIRAL_QUERY + shift
        row["ok"] += plan(scene, start, goal, "spot").status is Status.OK
    return row


def spiral_rows(folder: Path, count: int, seed: int, bodies: Sequence[Agent] = SPIRAL_BODIES) -> Iterator[Row]:
    """For each body the published query, then random pairs on decks and ramps that a search over columns joins."""
    points = read_cloud(folder / SPIRAL).points
    began = time.process_time()
    scene = build_scene(points)
    built = time.process_time() - began
    for body in bodies:
        search = ColumnSearch(points, body, SPIRAL_CELL)
        row: Row = {"row": "spiral", "agent": body.name, "points": len(points), "build_s": built}
        began = time.process_time()
        scene.free_space(body)
        row["space_s"] = time.process_time() - began
        ground = float(points[:, 2].min())
        query = np.array([search.places[search.nearest(np.append(end, ground))] for end in SPIRAL_QUERY])
        published = plan(scene, query[0], query[1], body, snap=SPIRAL_CELL)
        pairs = search.random_pairs(count, np.random.default_rng(seed), DECK)
        yield row | {"published": str(published.status)} | _solved(scene, search, pairs)


def _solved(scene: Scene, search: ColumnSearch, pairs: FloatArray) -> Row:
    agent, said, spent, deep, corner = search.agent, [], [], [], []
    for start, goal in pairs:
        began = time.process_time()
        result = plan(scene, start, goal, agent, snap=SPIRAL_CELL)
        spent.append(time.process_time() - began)
        said.append(result.status)
        if result.trajectory is not None:
            deep.append(search.deepest(result.trajectory.ground))
            corner.append(sharpest_turn(result.trajectory.ground[:, :2]))
    high = np.ptp(pairs[:, :, 2], axis=1) > agent.height
    ok = np.array([status is Status.OK for status in said])
    return {
        "pairs": len(pairs),
        "ok": int(ok.sum()),
        "pairs_high": int(high.sum()),
        "ok_high": int(ok[high].sum()),
        "collisions": int(np.count_nonzero(deep)),
        "deepest_m": max(deep, default=0.0),
        "p50_ms": 1e3 * float(np.median(spent)) if spent else float("nan"),
        "turn_p50_deg": float(np.degrees(np.median(corner))) if corner else float("nan"),
    }


def sharpest_turn(path: FloatArray) -> float:
    """The most that a path in plan, (n, 2), turns within `TURN` of its length [rad]."""
    step = np.diff(path, axis=0)
    step = step[np.hypot(*step.T) > 0.0]
    heading, along = np.unwrap(np.arctan2(step[:, 1], step[:, 0])), np.cumsum(np.hypot(*step.T))
    until = np.searchsorted(along, along + TURN)
    return max((float(np.ptp(heading[i:j])) for i, j in enumerate(until) if j > i), default=0.0)

"""Scenes with known truth as a scanner sees them, and what a build of them is worth."""

from __future__ import annotations

import numpy as np

from gpdf_service.bench.report import Row
from gpdf_service.scene import Scene
from gpdf_service.synthetic import SyntheticScene
from gpdf_service.types import AGENTS, BoolArray, FloatArray

BLIND = np.radians(30.0)
"""Half angle of the cone under a scanner that it does not see: its own mount is there, in today's instruments."""
EYE = 1.6
"""[m] Of the scanner over the floor."""
STATIONS = 2
RAY = 0.004
"""[rad] Between two rays that are told apart when it is asked what hides what: 2 cm in 5 m."""
DEEP = 0.05
"""[m] A point this far behind another on the same ray is hidden; less is the same surface, seen at an angle."""
STEP = 0.05
"""[m] Between the places at which ground and free space are compared with the truth."""
OFF = 0.05
"""[m] Ground that is further off in height is wrong ground."""


def scanned(points: FloatArray, clean: FloatArray, rng: np.random.Generator) -> BoolArray:
    """Which points (n, 3) are seen from `STATIONS` random places in the room, by where they truly are, shape (n,)."""
    low, high = clean[:, :2].min(axis=0), clean[:, :2].max(axis=0)
    seen = np.zeros(len(points), dtype=bool)
    for _ in range(STATIONS):
        station = np.append(rng.uniform(low + 0.2 * (high - low), high - 0.2 * (high - low)), EYE)
        away = clean - station
        distance = np.linalg.norm(away, axis=1)
        down, turn = np.arccos(np.clip(-away[:, 2] / distance, -1.0, 1.0)), np.arctan2(away[:, 1], away[:, 0])
        ray = np.round(down / RAY).astype(np.int64) * 10_000 + np.round(turn / RAY).astype(np.int64)
        _, own = np.unique(ray, return_inverse=True)
        nearest = np.full(own.max() + 1, np.inf)
        np.minimum.at(nearest, own, distance)
        seen |= (down > BLIND) & (distance <= nearest[own] + DEEP)
    return seen


def overlap(found: BoolArray, true: BoolArray) -> float:
    """Of two sets what is in both, over what is in either."""
    return float((found & true).sum() / (found | true).sum())


def judge(made: Scene, scene: SyntheticScene) -> Row:
    """How much of the true ground is known, how much of what is known is wrong, and where a body is wrongly free."""
    side = np.array(scene.truth.size[:2])
    x, y = (np.arange(0.5 * STEP, length, STEP) for length in side)
    xy = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    truth = scene.truth.ground_height(xy)
    heights = np.stack([surface.height_at(xy) for surface in made.surfaces])
    off = np.abs(heights - truth)
    known: BoolArray = np.logical_or.reduce(np.isfinite(heights))
    right: BoolArray = np.fmin.reduce(off) <= OFF  # NaN compares false
    row: Row = {
        "known_of_true": float(right[np.isfinite(truth)].mean()),
        "wrong_of_known": float((~right)[known].mean()),
        "height_mm_p95": 1e3 * float(np.quantile(np.fmin.reduce(off)[right], 0.95)),
    }
    if scene.name == "stair":  # exact room counts the riser after next as a wall, which a climber's is not
        return row
    for agent in (AGENTS["human"], AGENTS["roomba"]):
        space = made.free_space(agent)
        contacts = np.column_stack([xy, truth])
        room = scene.truth.body_clearance(contacts, agent.radius, agent.height, agent.max_step)
        room = np.where(np.isfinite(truth), room, np.nan)
        free = np.zeros(len(xy), dtype=bool)
        for own in space.levels:
            leaf = own.quadtree.find(xy)
            free |= (leaf >= 0) & own.quadtree.whole[leaf]
        fits = room >= 0.0  # NaN compares false
        wrong = free & ~fits
        row |= {
            f"{agent.name}_free_of_true": float(free[fits].mean()) if fits.any() else float("nan"),
            f"{agent.name}_wrong_free": int(wrong.sum()),
            f"{agent.name}_deepest_mm": 1e3 * float(np.max(-room[wrong & np.isfinite(room)], initial=0.0)),
        }
    return row

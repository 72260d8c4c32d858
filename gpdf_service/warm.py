"""Every compiled kernel, once: what is in the cache afterwards is loaded in a moment, what is not is compiled here."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import numpy as np

from gpdf_service.pipeline import build_scene, plan
from gpdf_service.scene import Scene, load_scene
from gpdf_service.synthetic import SCENES, Box, SyntheticScene, World
from gpdf_service.synthetic.house import make_house
from gpdf_service.types import AGENTS

SPACING = 0.1
"""[m] Coarse, so that the time goes into compiling."""
NOISE = 0.02
"""[m] Enough to be cured."""
EYE = 1.5
"""[m] Of a scanner over the floor."""
DOOR = 0.55
"""[m] Wide, and beside another one: Spot's legs pass each, and its cylinder neither."""
TURNED = 0.6
"""[m] Between two such doors, where Spot finds its way by turns on the spot alone."""
TOO_TIGHT = 0.5
"""[m] Wide, a corridor around whose corner Spot does not get."""


class Warming:
    """Small scenes and plans that between them run what a service, a verb or a script runs."""

    @cached_property
    def _office(self) -> SyntheticScene:
        return SCENES["office"](np.random.default_rng(0), spacing=SPACING)

    @cached_property
    def _scene(self) -> Scene:
        return build_scene(self._office.points, self._office.ground)

    def plans(self) -> None:
        """A labelled scene, plans in it, one round something that moves, its file: what a planner needs at once."""
        made, scene = self._office, self._scene
        scene.prepare("human")
        plan(scene, made.start, made.goal)
        leaves = scene.free_space("human").levels[0].quadtree.standing
        plan(scene, *leaves.center[leaves.free & ~leaves.whole][[0, -1]])  # from beside one obstacle to another one
        plan(scene.with_obstacles(np.array([[*made.start[:2], 1.0]])), made.start, made.goal)
        with tempfile.TemporaryDirectory() as folder:
            scene.save(file := Path(folder) / "scene")
            load_scene(file)

    def grounds(self) -> None:
        """Our segmentation of a clean cloud, and of a stair."""
        build_scene(self._office.points)
        stair = SCENES["stair"](np.random.default_rng(0), spacing=SPACING / 2)
        plan(build_scene(stair.points), stair.start, stair.goal)

    def storeys(self) -> None:
        """A house, a way up its stair and others that differ, one from its foot, something new there; with rays."""
        house = make_house(np.random.default_rng(0), SPACING / 2)
        post = house.head + np.array([[0.0, 0.0, z] for z in np.arange(SPACING, 1.0, SPACING)])
        for labels in None, house.ground:
            scene = build_scene(house.points, labels)
            plan(scene, house.low, house.high, alternatives=1)
            plan(scene, house.head, house.high)
            plan(scene.update(insert=post), house.low, house.high)
        eye = house.low + np.array([0.0, 0.0, EYE])
        build_scene(house.points, origins=np.broadcast_to(eye, house.points.shape))

    def noise(self) -> None:
        """The cure of a noisy cloud, without and with labels, and its next versions."""
        stair = SCENES["stair"](np.random.default_rng(0), noise=NOISE, spacing=SPACING)
        post = np.array([[*stair.start[:2], z] for z in np.arange(SPACING, 1.0, SPACING)])
        for labels in None, stair.ground:
            scene = build_scene(stair.points, labels).update(insert=post)
            scene.update(remove=np.arange(len(stair.points), len(scene.points)))

    def changes(self) -> None:
        """The next version of a scene, and of a body's free space in it."""
        box = np.stack(np.meshgrid([3.0, 3.1], [3.0, 3.1], np.arange(0.1, 1.0, SPACING)), axis=-1).reshape(-1, 3)
        made = self._office
        for labels in made.ground, None:
            scene = build_scene(made.points, labels)
            plan(scene, made.start, made.goal)
            scene = scene.update(insert=box)  # and the free space that the plan took
            plan(scene, made.start, made.goal)
            plan(scene.update(remove=np.arange(len(made.points), len(scene.points))), made.start, made.goal)

    def bodies(self) -> None:
        """A row of discs that turns between two doors and cannot turn around a corner; a body that is too wide."""
        row, wide = replace(AGENTS["spot"], name="row", discs=6), replace(AGENTS["human"], name="wide", width=0.9)
        doors = (
            Box((2.4, 0.0, 0.0), (2.5, 1.0, 2.6)),
            Box((2.4, 1.0 + DOOR, 0.0), (2.5, 4.0, 2.6)),
            Box((2.5 + TURNED, 0.0, 0.0), (2.6 + TURNED, 3.0 - DOOR, 2.6)),
            Box((2.5 + TURNED, 3.0, 0.0), (2.6 + TURNED, 4.0, 2.6)),
        )
        corner = Box((0.0, TOO_TIGHT, 0.0), (4.0 - TOO_TIGHT, 4.0, 2.6))
        rng, inside = np.random.default_rng(0), 0.5 * TOO_TIGHT
        turns = build_scene(*World((6.0, 4.0, 2.6), doors).sample(SPACING / 2, rng))
        cannot = build_scene(*World((4.0, 4.0, 2.6), (corner,)).sample(SPACING / 2, rng))
        for body in row, wide:
            plan(turns, (1.0, 1.0), (5.0, 3.0), body, start_heading=0.3 if body is row else None)
        plan(cannot, (0.8, inside), (4.0 - inside, 3.4), row)

    def heaps(self) -> None:
        """Places that were measured again and again, and sheets over sheets: what few clouds run."""
        rng = np.random.default_rng(0)
        again, sheets = np.repeat(rng.uniform(0.0, 20.0, (30, 3)), 20, axis=0), rng.uniform(0.0, 6.0, (6000, 3))
        sheets[:, 2] = np.floor(sheets[:, 2] / 0.75) * 2.5  # eight
        for points in again, sheets:
            scene = build_scene(points, points[:, 2] <= np.median(points[:, 2]))
            plan(scene, points[:, :2].min(axis=0), points[:, :2].max(axis=0))

    def methods(self) -> None:
        """The baselines that need no further package."""
        for method in ("single_gpdf", "astar"):
            plan(self._scene, self._office.start, self._office.goal, method=method)  # type: ignore[arg-type]

    def steps(self) -> dict[str, Callable[[], None]]:
        """All of it by name, to be called."""
        return {
            "plans": self.plans,
            "noise": self.noise,
            "grounds": self.grounds,
            "storeys": self.storeys,
            "bodies": self.bodies,
            "methods": self.methods,
            "changes": self.changes,
            "heaps": self.heaps,
        }

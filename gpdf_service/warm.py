"""Every compiled kernel, once: what is in the cache afterwards is loaded in a moment, what is not is compiled here."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numba.core.dispatcher import Dispatcher

from gpdf_service.pipeline import build_scene, plan
from gpdf_service.scene import Scene, load_scene
from gpdf_service.synthetic import SCENES, Box, SyntheticScene, World
from gpdf_service.types import AGENTS

SPACING = 0.1
"""[m] Coarse, so that the time goes into compiling."""
NOISE = 0.02
"""[m] Enough to be cured."""


class Warming:
    """Small scenes and plans that between them run what a service, a verb or a script runs."""

    @cached_property
    def _office(self) -> SyntheticScene:
        return SCENES["office"](np.random.default_rng(0), spacing=SPACING)

    @cached_property
    def _scene(self) -> Scene:
        return build_scene(self._office.points, self._office.ground)

    def plans(self) -> None:
        """A labelled scene, a plan in it, one round something that moves, its file: what a planner needs at once."""
        made, scene = self._office, self._scene
        plan(scene, made.start, made.goal)
        plan(scene.with_obstacles(np.array([[*made.start[:2], 1.0]])), made.start, made.goal)
        with tempfile.TemporaryDirectory() as folder:
            scene.save(file := Path(folder) / "scene")
            load_scene(file)

    def grounds(self) -> None:
        """Our segmentation of a clean cloud, and of a stair."""
        build_scene(self._office.points)
        stair = SCENES["stair"](np.random.default_rng(0), spacing=SPACING / 2)
        plan(build_scene(stair.points), stair.start, stair.goal)

    def noise(self) -> None:
        """The cure of a noisy cloud."""
        build_scene(SCENES["stair"](np.random.default_rng(0), noise=NOISE, spacing=SPACING).points)

    def changes(self) -> None:
        """The next version of a scene."""
        box = np.stack(np.meshgrid([3.0, 3.1], [3.0, 3.1], np.arange(0.1, 1.0, SPACING)), axis=-1).reshape(-1, 3)
        scene = build_scene(self._office.points).update(insert=box)
        plan(scene, self._office.start, self._office.goal)

    def bodies(self) -> None:
        """A row of discs through a door, and a body that is too wide for it."""
        walls = Box((3.0, 0.0, 0.0), (3.2, 1.6, 2.6)), Box((3.0, 2.4, 0.0), (3.2, 4.0, 2.6))
        scene = build_scene(*World((6.0, 4.0, 2.6), walls).sample(SPACING / 2, np.random.default_rng(0)))
        row, wide = replace(AGENTS["spot"], name="row", discs=6), replace(AGENTS["human"], name="wide", width=0.9)
        for body in row, wide:
            plan(scene, (1.0, 1.0), (5.0, 3.0), body, start_heading=0.3 if body is row else None)

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
            "grounds": self.grounds,
            "noise": self.noise,
            "changes": self.changes,
            "bodies": self.bodies,
            "heaps": self.heaps,
            "methods": self.methods,
        }


def kernels() -> Iterator[Dispatcher]:
    """Every compiled function of the modules that are loaded."""
    for name in [name for name in sys.modules if name.partition(".")[0] == "gpdf_service"]:
        module = sys.modules[name]
        for value in list(vars(module).values()):
            if isinstance(value, Dispatcher) and value.py_func.__module__ == name:
                yield value

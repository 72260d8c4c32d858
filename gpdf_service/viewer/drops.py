"""Obstacles that the operator puts on the ground, to see what the planner makes of them."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

import numpy as np
import viser
from gpdf_client import Trajectory
from gpdf_schemas import Cylinder, MovingObstacle

from gpdf_service.types import Agent, FloatArray
from gpdf_service.viewer import colours
from gpdf_service.viewer.desk import Desk
from gpdf_service.viewer.path_layers import disc_centres
from gpdf_service.viewer.widgets import by_hand, put

HEIGHT = 1.8
"""[m] Of what is dropped: as tall as a person who stands in the way."""
POINT_SIZE = 0.04
"""[m] Obstacles of a recorded request that came as points."""


class Drops:
    """They go with every plan that the page asks for, and into no map: other clients do not meet them.

    Args:
        desk: The page's.
        on_change: Told when there are others than before.
    """

    def __init__(self, desk: Desk, on_change: Callable[[], None]) -> None:
        self._desk, self._tab, self._on_change = desk, desk.panel.plan.drops, on_change
        self.obstacles: dict[str, MovingObstacle] = {}
        self._handles: dict[str, viser.SceneNodeHandle] = {}
        self._nodes = itertools.count()
        self._tab.remove.on_click(by_hand(self._remove_chosen))
        self._tab.remove_all.on_click(by_hand(self._remove_all))

    def drop(self, place: FloatArray) -> None:
        """Put a cylinder on the ground at (x, y, z) [m], as wide as the slider says."""
        cylinder = Cylinder((float(place[0]), float(place[1]), float(place[2])), self._tab.radius.value, HEIGHT)
        name = next(name for name in map(str, itertools.count(1)) if name not in self.obstacles)
        self._add(MovingObstacle(id=name, cylinder=cylinder))
        self._offer()
        self._on_change()

    def replace(self, obstacles: Sequence[MovingObstacle]) -> None:
        """Show those of a recorded request in place of all others."""
        for name in list(self.obstacles):
            self._remove(name)
        for obstacle in obstacles:
            self._add(obstacle)
        self._offer()

    def _add(self, obstacle: MovingObstacle) -> None:
        self._remove(obstacle.id)
        self.obstacles[obstacle.id] = obstacle
        scene, frame, node = self._desk.browser.scene, self._desk.frame, f"/drops/{next(self._nodes)}"
        self._handles[obstacle.id] = scene.add_frame(node, show_axes=False)  # an id may be any text, a node's name not
        if (cylinder := obstacle.cylinder) is not None:
            base, up = frame.to_page(np.array(cylinder.base)), np.array([0.0, 0.0, cylinder.height])
            size = cylinder.radius, cylinder.height
            scene.add_cylinder(f"{node}/body", *size, colours.DROPPED, position=base + 0.5 * up, cast_shadow=False)
            scene.add_label(f"{node}/label", obstacle.id, position=base + up)
        if obstacle.points is not None:
            places = frame.to_page(obstacle.points.unpack()).astype(np.float32)
            scene.add_point_cloud(f"{node}/points", places, colours.DROPPED, point_size=POINT_SIZE)

    def _remove(self, name: str) -> None:
        self.obstacles.pop(name, None)
        if name in self._handles:
            self._handles.pop(name).remove()

    def _remove_chosen(self) -> None:
        self._remove(self._tab.chosen.value)
        self._offer()
        self._on_change()

    def _remove_all(self) -> None:
        self.replace(())
        self._on_change()

    def _offer(self) -> None:
        """Those that can be removed; the newest is chosen."""
        tab, there = self._tab, bool(self.obstacles)
        if there:
            tab.chosen.options = tuple(self.obstacles)
            put(tab.chosen, next(reversed(self.obstacles)))
        tab.folder.visible = there


def room_beside(obstacles: Sequence[MovingObstacle], path: Trajectory, agent: Agent) -> FloatArray:
    """Distance in plan from the body's side to the nearest obstacle at each waypoint [m], shape (n,); inf for none."""
    discs = disc_centres(path, agent)
    foot = path.ground[:, 2]
    nearest = np.full(len(foot), np.inf)
    for obstacle in obstacles:
        pillars = [] if obstacle.points is None else [(place, 0.0, 0.0) for place in obstacle.points.unpack()]
        if (cylinder := obstacle.cylinder) is not None:
            pillars.append((np.array(cylinder.base), cylinder.radius, cylinder.height))
        for base, radius, height in pillars:
            gap = np.linalg.norm(discs[:, :, :2] - base[:2], axis=2).min(axis=0) - radius
            beside = (base[2] < foot + agent.height) & (base[2] + height > foot)
            nearest = np.minimum(nearest, np.where(beside, gap, np.inf))
    return np.maximum(nearest - agent.disc_radius, 0.0)

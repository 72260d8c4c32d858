"""A path from the side: height, ground, clearance and speed along the way."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
import viser
from gpdf_client import Client, Trajectory, UnavailableError, UnknownSceneError
from viser import uplot

from gpdf_service.types import Agent, FloatArray
from gpdf_service.viewer.colours import METHODS, css
from gpdf_service.viewer.link import Link
from gpdf_service.viewer.path_layers import disc_centres

CHART_HEIGHT = 165
"""[px]"""
TOP, GROUND, ROOM, SPEED = "#0072b2", "#7a6a4f", "#d55e00", css(METHODS["prm"])


@dataclass(frozen=True, slots=True)
class Profile:
    """Along the way on the ground [m], each (n,): the body's top and the ground [m], clearance [m], speed [m/s]."""

    along: FloatArray
    top: FloatArray
    ground: FloatArray
    clearance: FloatArray
    speed: FloatArray


def clearance_along(client: Client, scene: str, path: Trajectory, agent: Agent) -> FloatArray:
    """Room beside the body at each waypoint, as the Obstacle GPDF has it [m]; 0 where the field says nothing."""
    discs = disc_centres(path, agent)
    found = client.distance(scene, "obstacle", discs.reshape(-1, 3), dataclasses.asdict(agent))
    room = np.where(found.valid, np.maximum(0.0, found.distance - agent.disc_radius), 0.0)
    least: FloatArray = room.reshape(discs.shape[:2]).min(axis=0)
    return least


def profile_of(path: Trajectory, clearance: FloatArray) -> Profile:
    """Seen from the side; the speed is that of the contact point."""
    steps = np.linalg.norm(np.diff(path.ground, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    speed = np.gradient(along, path.times)
    return Profile(along, path.positions[:, 2], path.ground[:, 2], clearance, speed)


class ProfileCharts:
    """Two charts in the panel, made anew for each path: uPlot does not find its width while it is hidden."""

    def __init__(self, gui: viser.GuiApi) -> None:
        self._gui = gui
        self._folder = gui.add_folder("From the side", visible=False)
        self._charts: list[viser.GuiUplotHandle] = []

    def hide(self) -> None:
        """Show none."""
        self._folder.visible = False
        for chart in self._charts:
            chart.remove()
        self._charts = []

    def show(self, profile: Profile) -> None:
        """Show one."""
        self.hide()
        self._folder.visible = True
        with self._folder:
            self._charts = [
                _chart(
                    self._gui,
                    profile.along,
                    "m",
                    {"top [m]": (profile.top, TOP), "ground [m]": (profile.ground, GROUND)},
                ),
                _chart(
                    self._gui,
                    profile.along,
                    "m, m/s",
                    {"clearance [m]": (profile.clearance, ROOM), "speed [m/s]": (profile.speed, SPEED)},
                ),
            ]


def _chart(
    gui: viser.GuiApi, along: FloatArray, label: str, lines: dict[str, tuple[FloatArray, str]]
) -> viser.GuiUplotHandle:
    series = [uplot.Series(label="along [m]")]
    series += [uplot.Series(label=name, stroke=colour, width=2) for name, (_, colour) in lines.items()]
    return gui.add_uplot(
        data=(along, *(values for values, _ in lines.values())),
        series=tuple(series),
        scales={"x": uplot.Scale(time=False), "y": uplot.Scale(auto=True)},
        axes=(uplot.Axis(label="along the way [m]", size=40), uplot.Axis(label=label, size=50)),
        height=CHART_HEIGHT,
    )


def known_clearance(link: Link, scene: str, path: Trajectory, agent: Agent) -> FloatArray | None:
    """`clearance_along`, or None where no service knows the scene."""
    try:
        return clearance_along(link.client, scene, path, agent)
    except (UnavailableError, UnknownSceneError):
        return None

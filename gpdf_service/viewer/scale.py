"""How large the scene is and where its coordinates run: lines under the ground, and numbers along two sides."""

from __future__ import annotations

from typing import Literal

import numpy as np
import viser

from gpdf_service.types import FloatArray
from gpdf_service.viewer.frame import Frame

STEPS = (1.0, 5.0, 10.0, 50.0, 100.0, 500.0)
"""[m] Between two lines."""
MOST_LINES = 30
"""Along one side."""
NUMBERS = 6
"""Along one side, at most."""
UNDER = 0.05
"""[m] Under the lowest ground, so that the lines cross nothing."""
GREY = (205, 205, 205)
SIDES: tuple[tuple[str, Literal["bottom-center", "center-left"]], ...] = ("x", "bottom-center"), ("y", "center-left")
"""Axes, and which point of a number lies on the ground's rim: so it reaches inwards, not over a phone's edge."""


def line_step(metres: float) -> float:
    """Between two lines of a scene that is so wide [m]."""
    return next((step for step in STEPS if metres / step <= MOST_LINES), STEPS[-1])


def numbers(low: float, high: float, step: float) -> FloatArray:
    """Some multiples of the step from low to high [m], `NUMBERS` at most; none where that is narrower."""
    within = step * np.arange(np.ceil(low / step), np.floor(high / step) + 0.5) + 0.0  # no -0
    return within[:: max(1, -(-len(within) // NUMBERS))]


def add_scale(scene: viser.SceneApi, frame: Frame, low: FloatArray, high: FloatArray) -> float:
    """Draw it for ground between two corners of the page, each (3,) [m]; how far two lines are apart [m].

    The lines go on beyond the ground; the numbers do not, as the camera shows the ground and on a phone no more.
    """
    step = line_step(float((high - low)[:2].max()))
    rim, end = frame.to_scene(low) - [0.0, 0.0, UNDER], frame.to_scene(high)
    first, last, z = np.floor(rim[:2] / step) * step, np.ceil(end[:2] / step) * step, rim[2]
    along = [np.arange(first[k], last[k] + 0.5 * step, step) for k in (0, 1)]
    lines = [[(x, first[1], z), (x, last[1], z)] for x in along[0]]
    lines += [[(first[0], y, z), (last[0], y, z)] for y in along[1]]
    segments = frame.to_page(np.array(lines)).astype(np.float32)
    scene.add_line_segments("/scale/lines", segments, GREY, thickness=1.0, thickness_units="screen")
    for k, (axis, anchor) in enumerate(SIDES):
        for value in numbers(rim[k] + 0.5 * step, end[k] - 0.5 * step, step):  # a phone cuts off what is at a corner
            place = rim.copy()
            place[k] = value
            scene.add_label(
                f"/scale/{axis}/{round(value)}",
                f"{axis} {value:g} m",
                position=frame.to_page(place),
                font_screen_scale=0.8,
                anchor=anchor,
            )
    return step

"""How large the scene is and where its coordinates run: lines under the ground, and numbers along two sides."""

from __future__ import annotations

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


def line_step(metres: float) -> float:
    """Between two lines of a scene that is so wide [m]."""
    return next((step for step in STEPS if metres / step <= MOST_LINES), STEPS[-1])


def add_scale(scene: viser.SceneApi, frame: Frame, low: FloatArray, high: FloatArray) -> float:
    """Draw it for ground between two corners of the page, each (3,) [m]; how far two lines are apart [m]."""
    step = line_step(float((high - low)[:2].max()))
    first = np.floor(frame.to_scene(low)[:2] / step) * step
    last = np.ceil(frame.to_scene(high)[:2] / step) * step
    z = frame.to_scene(low)[2] - UNDER
    along = [np.arange(first[k], last[k] + 0.5 * step, step) for k in (0, 1)]
    lines = [[(x, first[1], z), (x, last[1], z)] for x in along[0]]
    lines += [[(first[0], y, z), (last[0], y, z)] for y in along[1]]
    segments = frame.to_page(np.array(lines)).astype(np.float32)
    scene.add_line_segments("/scale/lines", segments, GREY, thickness=1.0, thickness_units="screen")
    for k, axis in enumerate("xy"):
        every = -(-len(along[k]) // NUMBERS)
        for value in along[k][k::every]:  # both begin in one corner
            place = np.array([*first, z])
            place[k] = value
            scene.add_label(
                f"/scale/{axis}/{round(value)}",
                f"{axis} {value:g} m",
                position=frame.to_page(place),
                font_screen_scale=0.8,
                anchor="center-center",
            )
    return step

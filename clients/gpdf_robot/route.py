"""A trajectory as a controller sees it: a line in plan, by arc length."""

from __future__ import annotations

from math import atan2

import numpy as np
from gpdf_client.trajectory import FloatArray, Trajectory

BEYOND = 2.0
"""[m] The line goes straight on after the goal by this, so that there is always something to look ahead to."""
TANGENT = 0.1
"""[m] The direction of the line is taken over this: two waypoints, which smooths their bend."""
WINDOW = (0.3, 0.6)
"""[m] Back and ahead of the last nearest place: a line that passes close to itself is not jumped over to."""


class Route:
    """The ground below a trajectory.

    Attributes:
        ground: (n, 3) [m], with the piece beyond the goal.
        along: Arc length in plan (n,) [m].
        length: Of the line up to the goal [m].
    """

    def __init__(self, trajectory: Trajectory) -> None:
        steps = np.hypot(*np.diff(trajectory.ground[:, :2], axis=0).T)
        ground = trajectory.ground[np.concatenate([[True], steps > 0.0])]
        along = np.concatenate([[0.0], np.cumsum(steps[steps > 0.0])])
        last = trajectory.headings[-1]
        if len(ground) > 1:
            last = atan2(*(ground[-1] - ground[-2])[1::-1])
        beyond = ground[-1] + BEYOND * np.array([np.cos(last), np.sin(last), 0.0])
        self.length = float(along[-1])
        self.ground: FloatArray = np.vstack([ground, beyond])
        self.along: FloatArray = np.append(along, self.length + BEYOND)

    def at(self, along: FloatArray) -> FloatArray:
        """Ground at arc lengths (m,) → (m, 3) [m]."""
        return np.column_stack([np.interp(along, self.along, column) for column in self.ground.T])

    def heading(self, along: float) -> float:
        """Direction of the line there [rad]."""
        a, b = self.at(np.array([max(along - TANGENT / 2, 0.0), max(along, TANGENT / 2) + TANGENT / 2]))
        return atan2(b[1] - a[1], b[0] - a[0])

    def nearest(self, xy: FloatArray, near: float | None = None) -> tuple[float, float]:
        """Arc length of the nearest place on the line, and the distance to it [m].

        Args:
            xy: A place in plan, shape (2,).
            near: Look only around this arc length.
        """
        a, step = self.ground[:-1, :2], np.diff(self.ground[:, :2], axis=0)
        length2 = np.maximum((step**2).sum(axis=1), 1e-12)
        low, high = np.zeros(len(a)), np.ones(len(a))
        if near is not None:
            width = np.diff(self.along)
            low = np.clip((near - WINDOW[0] - self.along[:-1]) / width, 0.0, 1.0)
            high = np.clip((near + WINDOW[1] - self.along[:-1]) / width, 0.0, 1.0)
        share = np.clip(((xy - a) * step).sum(axis=1) / length2, low, high)
        distance = np.hypot(*(a + share[:, None] * step - xy).T)
        if near is not None:
            distance = np.where(high > low, distance, np.inf)
        best = int(distance.argmin())
        along = self.along[best] + share[best] * (self.along[best + 1] - self.along[best])
        return float(along), float(distance[best])

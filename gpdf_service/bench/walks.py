"""The world as it is for a simulated walker: the clean cloud, never the planner's picture of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gpdf_service.bench.judge import Judge
from gpdf_service.types import AGENTS, Agent, BoolArray, FloatArray

NEIGHBOURS = 8
"""Ground points that are looked at for the one that the walker can step onto."""
OFF_GROUND = 0.6
"""[m] Further from any ground point, nobody knows what is under the walker; scans have smaller gaps between points."""


@dataclass(slots=True)
class WalkedWorld:
    """Ground under a walker, and what touches it; `fell` once it stepped off the ground or a drop.

    Attributes:
        judge: Holds the points.
        agent: Measures of the walker.
        fell: Whether it took more than its highest step, or left the ground.
    """

    judge: Judge
    agent: Agent
    fell: bool = False

    @classmethod
    def of(cls, points: FloatArray, ground: BoolArray, agent: Agent = AGENTS["human"]) -> WalkedWorld:
        """From a clean cloud and its labels, for a walker with these measures."""
        return cls(Judge(points, ground), agent)

    def ground_height(self, position: FloatArray) -> float:
        """Height of the ground under (x, y), on the storey of z [m]; what is higher than a step is over the walker."""
        rows = np.array(self.judge.ground_plan.query_ball_point(position[:2], OFF_GROUND), dtype=np.int64)
        rows = rows[self.judge.ground[rows, 2] <= position[2] + self.agent.max_step]
        away = np.hypot(*(self.judge.ground[rows, :2] - position[:2]).T)
        z = self.judge.ground[rows[np.argsort(away)[:NEIGHBOURS]], 2]
        near = z[z >= position[2] - self.agent.max_step]
        if len(near) == 0:
            self.fell = True
            return float(z[0] if len(z) else position[2])
        return float(near[0])

    def penetration(self, position: FloatArray) -> float:
        """How deep the worst point is in the walker's cylinder [m]; inf after a fall."""
        return float("inf") if self.fell else self.judge.penetration(position, self.agent)

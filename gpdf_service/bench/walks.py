"""The world as it is for a simulated walker: the clean cloud, never the planner's picture of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gpdf_service.bench.judge import Judge
from gpdf_service.types import AGENTS, Agent, BoolArray, FloatArray

NEIGHBOURS = 8
"""Ground points that are looked at for the one on the walker's own storey."""
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
        """Height of the ground under (x, y), on the storey of z [m]."""
        away, rows = self.judge.ground_plan.query(position[:2], k=NEIGHBOURS)
        z = self.judge.ground[rows, 2]
        near = np.flatnonzero(np.abs(z - position[2]) <= self.agent.max_step)
        if len(near) == 0 or away[near[0]] > OFF_GROUND:
            self.fell = True
            return float(z[0])
        return float(z[near[0]])

    def penetration(self, position: FloatArray) -> float:
        """How deep the worst point is in the walker's cylinder [m]; inf after a fall."""
        return float("inf") if self.fell else self.judge.penetration(position, self.agent)

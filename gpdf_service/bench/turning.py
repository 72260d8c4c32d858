"""Which queries a body of discs can solve, turned as it must be: a search over poses with the true geometry.

Every cell of 2 cm and every heading of 5° where all discs keep their room, joined by steps ahead and turns on the spot,
is searched exhaustively. A disc is at most 0.71 cells beside the cell that stands for it, and so much more room is
asked for: what this search solves has a solution. It shares no code with the planner, and is for one floor.
"""

from __future__ import annotations

from math import atan2, cos, pi, sin, sqrt

import numpy as np
from numba import njit

from gpdf_service.bench.brute import BruteForce
from gpdf_service.types import Agent, BoolArray, FloatArray, IntArray

HEADINGS = 72
"""In a turn: 4 cm at the end of a body that is 1 m long."""
ASLANT = pi / 8 + 1e-6
"""[rad] The body goes at most this much aslant: along one of the eight directions of the grid it can always go."""
SAG = 0.002
"""[m] What a step of the grid cuts from a turn."""


class BrutePoses:
    """Where a body of discs can stand in the clean cloud and how it must face, and from where a place is reached.

    Args:
        points: The clean cloud [m], shape (n, 3).
        ground: Its true ground labels, shape (n,).
        agent: The body.
    """

    def __init__(self, points: FloatArray, ground: BoolArray, agent: Agent) -> None:
        plan = BruteForce(points, ground, agent)
        self.origin, self.cell = plan.origin, plan.cell
        room = agent.disc_radius + sqrt(0.5) * plan.cell + SAG
        disc: BoolArray = (plan.clearance[..., 0] >= room) & ~np.isnan(plan.height[..., 0])
        self.fits = np.stack([self._stand(disc, agent, 2.0 * pi * h / HEADINGS) for h in range(HEADINGS)])

    def _stand(self, disc: BoolArray, agent: Agent, heading: float) -> BoolArray:
        """Cells where all discs fit at a heading."""
        around = int(agent.offsets[-1] / self.cell) + 2
        padded, (nx, ny) = np.pad(disc, around), disc.shape
        made = np.ones(disc.shape, dtype=bool)
        for offset in agent.offsets:
            i, j = round(offset * cos(heading) / self.cell) + around, round(offset * sin(heading) / self.cell) + around
            made &= padded[i : i + nx, j : j + ny]
        return made

    def solves(self, start: FloatArray, goal: FloatArray) -> bool:
        """Whether the body gets from start to goal, (x, y), as it likes to face there."""
        a, b = (np.floor((place[:2] - self.origin) / self.cell).astype(np.int64) for place in (start, goal))
        inside = all((cell >= 0).all() and (cell < self.fits.shape[1:]).all() for cell in (a, b))
        return inside and bool(_reaches(self.fits, a, b))


@njit(cache=True, nogil=True)
def _reaches(fits: BoolArray, start: IntArray, goal: IntArray) -> bool:
    """Whether a flood of poses, (headings, nx, ny), from a cell comes to another one."""
    turns, nx, ny = fits.shape
    seen = np.zeros_like(fits)
    waiting = [(h, start[0], start[1]) for h in range(turns) if fits[h, start[0], start[1]]]
    for h, i, j in waiting:
        seen[h, i, j] = True
    while len(waiting) > 0:
        h, i, j = waiting.pop()
        if i == goal[0] and j == goal[1]:
            return True
        for di in range(-1, 2):
            for dj in range(-1, 2):
                aslant = (atan2(dj, di) - 2.0 * pi * h / turns + pi) % (2.0 * pi) - pi
                u, v = i + di, j + dj
                if (di == 0 and dj == 0) or abs(aslant) > ASLANT or not (0 <= u < nx and 0 <= v < ny):
                    continue
                if fits[h, u, v] and not seen[h, u, v]:
                    seen[h, u, v] = True
                    waiting.append((h, u, v))
        for k in ((h + 1) % turns, (h - 1) % turns):
            if fits[k, i, j] and not seen[k, i, j]:
                seen[k, i, j] = True
                waiting.append((k, i, j))
    return False

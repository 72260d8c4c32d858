"""An independent judge of trajectories: a cylinder against the clean cloud. Shares no code with the planner.

Written from the paper's evaluation ("each waypoint is free from collision given the cylindrical model", "within the
desired height from the ground allowing ±10 %"), and stricter: along the whole path, not only at its waypoints.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from gpdf_service.types import Agent, BoolArray, FloatArray, Trajectory

STEP = 0.01
"""[m] The path is looked at this often; a body of 17 cm radius cannot jump over anything on the way."""
FACE = 0.1
"""[m] A step's face has the step's upper ground within this, seen from above."""
SCATTER = 0.02
"""[m] Points this close to the ground are its scatter or a joint in the floor."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """Judgement of one trajectory.

    Attributes:
        penetration: How deep the worst point of the cloud is in the body's cylinder [m]; 0 when it is collision-free.
        collision_free: No point of the cloud is in the cylinder, anywhere on the path.
        feasible: The top of the body is within ±10 % of its height from the nearest ground point, or from the one
            under it, everywhere on the path.
        mean_ground_distance: Mean distance of the body's top to the nearest ground point [m].
    """

    penetration: float
    collision_free: bool
    feasible: bool
    mean_ground_distance: float


class Judge:
    """Judges paths in one place.

    Args:
        points: The clean cloud [m], shape (n, 3).
        ground: Its true ground labels, shape (n,).
    """

    def __init__(self, points: FloatArray, ground: BoolArray) -> None:
        self.other = points[~ground]
        self.ground = points[ground]
        self.other_tree, self.ground_plan = cKDTree(self.other[:, :2]), cKDTree(self.ground[:, :2])
        self.ground_tree = cKDTree(self.ground)

    def judge(self, trajectory: Trajectory, agent: Agent) -> Verdict:
        """Judge one trajectory of a body."""
        contact, top = _dense(trajectory.ground), _dense(trajectory.positions)
        deepest = max(self.penetration(centre, agent) for centre in contact)
        distance = self.ground_tree.query(top)[0]
        # The nearest of sparse points is further than the surface; straight above one, it is not.
        upright = top[:, 2] - self.ground[self.ground_plan.query(top[:, :2])[1], 2]
        off = np.minimum(np.abs(distance - agent.height), np.abs(upright - agent.height))
        feasible = bool((off <= 0.1 * agent.height).all())
        return Verdict(deepest, deepest == 0.0, feasible, float(distance.mean()))

    def penetration(self, contact: FloatArray, agent: Agent) -> float:
        """How deep the worst point is in a body that stands at `contact` (3,) [m]; 0 where none touches it."""
        near = self.other[self.other_tree.query_ball_point(contact[:2], agent.radius)]
        hit = self._hits(near, contact, agent)
        return float((agent.radius - np.linalg.norm(hit[:, :2] - contact[:2], axis=1)).max()) if len(hit) else 0.0

    def _hits(self, points: FloatArray, centre: FloatArray, agent: Agent) -> FloatArray:
        """Points in the cylinder that are not the face of a step that the body takes."""
        over = points[:, 2] - centre[2]
        inside = points[(over > SCATTER) & (over < agent.height)]
        beneath = self.ground[self.ground_plan.query(inside[:, :2])[1], 2]
        inside = inside[np.abs(inside[:, 2] - beneath) > SCATTER]
        low = inside[:, 2] - centre[2] <= agent.max_step
        keep = ~low
        for i in np.flatnonzero(low):
            beside = self.ground[self.ground_plan.query_ball_point(inside[i, :2], FACE)]
            rise = beside[:, 2] - centre[2]
            keep[i] = not ((rise >= inside[i, 2] - centre[2] - SCATTER) & (rise <= agent.max_step)).any()
        hits: FloatArray = inside[keep]
        return hits


def _dense(path: FloatArray) -> FloatArray:
    pieces = [
        np.linspace(a, b, max(1, int(np.ceil(np.linalg.norm(b - a) / STEP))), endpoint=False)
        for a, b in zip(path[:-1], path[1:], strict=True)  # noqa: RUF007 - reads as the pieces of a path
    ]
    return np.vstack([*pieces, path[-1:]])

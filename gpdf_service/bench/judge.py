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
SCATTER = 0.0201
"""[m] Points this close to the ground are its scatter or a joint in the floor; two steps of a scan in centimetres."""
NEAR = 8
"""Ground points around a contact; the one straightest under the body is the ground that it stands on."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """Judgement of one trajectory.

    Attributes:
        penetration: How deep the worst point of the cloud is in the body's cylinder [m]; 0 when it is collision-free.
        collision_free: No point of the cloud is in the cylinder, anywhere on the path.
        feasible: The top of the body is within ±10 % of its height from the nearest ground point, or from the one
            under it, everywhere on the path.
        mean_ground_distance: Mean distance of the body's top to the nearest ground point [m].
        mean_obstacle_distance: Mean distance in plan of the body's axis to the nearest point over the ground and within
            the body's height of it [m]; infinite where there is none.
    """

    penetration: float
    collision_free: bool
    feasible: bool
    mean_ground_distance: float
    mean_obstacle_distance: float


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
        self.over_ground = self.other[:, 2] - self.ground[self.ground_plan.query(self.other[:, :2])[1], 2]
        self.obstacles: dict[float, cKDTree] = {}

    def judge(self, trajectory: Trajectory, agent: Agent) -> Verdict:
        """Judge one trajectory strictly: along all of it, the body standing on the contact points."""
        return self._judge(_dense(trajectory.ground), _dense(trajectory.positions), agent)

    def judge_waypoints(self, trajectory: Trajectory, agent: Agent) -> Verdict:
        """Judge one trajectory as the paper does: at the waypoints alone, the cylinder hanging from the body's top."""
        top = trajectory.positions
        return self._judge(top - np.array([0.0, 0.0, agent.height]), top, agent)

    def _judge(self, contact: FloatArray, top: FloatArray, agent: Agent) -> Verdict:
        deepest = max(self.penetration(centre, agent) for centre in contact)
        distance = self.ground_tree.query(top)[0]
        # The nearest of sparse points is further than the surface; straight above one, it is not.
        upright = top[:, 2] - self._ground_under(top, agent.height)
        off = np.minimum(np.abs(distance - agent.height), np.abs(upright - agent.height))
        feasible = bool((off <= 0.1 * agent.height).all())
        room = float(self._room(top[:, :2], agent).mean())
        return Verdict(deepest, deepest == 0.0, feasible, float(distance.mean()), room)

    def _ground_under(self, top: FloatArray, height: float) -> FloatArray:
        """Height of the ground point under a body's top, of the storey that it stands on."""
        near = self.ground[self.ground_tree.query(top - np.array([0.0, 0.0, height]), k=NEAR)[1]]
        under = np.linalg.norm(near[..., :2] - top[:, None, :2], axis=-1).argmin(axis=1)
        z: FloatArray = near[np.arange(len(top)), under, 2]
        return z

    def _room(self, places: FloatArray, agent: Agent) -> FloatArray:
        """Distance in plan to the paper's obstacle points: not ground, and within the body's height of it."""
        within = (self.over_ground > SCATTER) & (self.over_ground < agent.height)
        if not within.any():
            return np.full(len(places), np.inf)
        if agent.height not in self.obstacles:
            self.obstacles[agent.height] = cKDTree(self.other[within, :2])
        room: FloatArray = self.obstacles[agent.height].query(places)[0]
        return room

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

"""An independent judge of trajectories: a body against the clean cloud. Shares no code with the planner.

The body is the paper's cylinder; of one that is planned for as a row of discs, the upright box of its length and width,
turned as the trajectory says: the judge knows nothing of discs.

Written from the paper's evaluation ("each waypoint is free from collision given the cylindrical model", "within the
desired height from the ground allowing ±10 %"), and stricter: along the whole path, not only at its waypoints.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from gpdf_service.types import Agent, BoolArray, FloatArray, IntArray, Trajectory

STEP = 0.01
"""[m] No part of the body moves further between two looks; a body of 17 cm radius cannot jump over anything."""
FACE = 0.1
"""[m] A step's face has the step's upper ground within this, seen from above."""
SCATTER = 0.0201
"""[m] Points this close to the ground are its scatter or a joint in the floor; two steps of a scan in centimetres."""
HEAD = 0.01
"""[-] How well a scan knows the room over the ground, over the body's height."""
NEAR = 8
"""Ground points around a contact; the one straightest under the body is the ground that it stands on."""
ROUNDED = 0.01
"""[-] Of a voxel: what single precision and a turn make of its centre."""
PLANAR = 0.002
"""[m] Where they are off one plane by no more (root mean square), it is known between them, too: on a slope of 20°,
3 cm beside a point, the ground is 1 cm higher, which is all that a Roomba's top may be off."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """Judgement of one trajectory.

    Attributes:
        penetration: How deep the worst point of the cloud is in the body's cylinder [m]; 0 when it is collision-free.
        collision_free: No point of the cloud is in the cylinder, anywhere on the path.
        feasible: The top of the body is within ±10 % of its height from the nearest ground point, or from the ground
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
        self.beside = np.full((len(self.other), 2), np.nan)
        self.voxel = (1.0 + ROUNDED) * _pitch(points[:, 2])

    def judge(self, trajectory: Trajectory, agent: Agent) -> Verdict:
        """Judge one trajectory strictly: along all of it, the body standing on the contact points.

        Its height is looked at at the waypoints: between two of them a body takes a step at once.
        """
        poses = _dense(np.column_stack([trajectory.ground, np.unwrap(trajectory.headings)]), _reach(agent))
        return self._judge(poses, trajectory.positions, agent)

    def judge_waypoints(self, trajectory: Trajectory, agent: Agent) -> Verdict:
        """Judge one trajectory as the paper does: at the waypoints alone, the cylinder hanging from the body's top."""
        top = trajectory.positions
        poses = np.column_stack([top - np.array([0.0, 0.0, agent.height]), trajectory.headings])
        return self._judge(poses, top, agent)

    def _judge(self, poses: FloatArray, top: FloatArray, agent: Agent) -> Verdict:
        deepest = max(self.penetration(pose[:3], agent, pose[3]) for pose in poses)
        distance = self.ground_tree.query(top)[0]
        # The nearest of sparse points is further than the surface; straight above one, it is not.
        upright = top[:, 2] - self._ground_under(top, agent.height)
        off = np.minimum(np.abs(distance - agent.height), np.abs(upright - agent.height))
        feasible = bool((off <= 0.1 * agent.height).all())
        room = float(self._room(top[:, :2], agent).mean())
        return Verdict(deepest, deepest == 0.0, feasible, float(distance.mean()), room)

    def _ground_under(self, top: FloatArray, height: float) -> FloatArray:
        """Height of the ground under a body's top, of the storey it stands on: on the plane there, or of a point."""
        near = self.ground[self.ground_tree.query(top - np.array([0.0, 0.0, height]), k=NEAR)[1]]
        under = np.linalg.norm(near[..., :2] - top[:, None, :2], axis=-1).argmin(axis=1)
        middle = near.mean(axis=1, keepdims=True)
        aside, rise = (near - middle)[..., :2], (near - middle)[..., 2:]
        across = aside.transpose(0, 2, 1)
        gradient = np.linalg.solve(across @ aside + 1e-9 * np.eye(2), across @ rise)
        off = np.sqrt(((rise - aside @ gradient) ** 2).mean(axis=(1, 2)))
        plane = middle[:, 0, 2] + ((top[:, None, :2] - middle[..., :2]) @ gradient)[:, 0, 0]
        z: FloatArray = np.where(off <= PLANAR, plane, near[np.arange(len(top)), under, 2])
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

    def penetration(self, contact: FloatArray, agent: Agent, heading: float = 0.0) -> float:
        """How deep the worst point is in a body at `contact` (3,) [m] facing `heading` [rad]; 0 if none is in it."""
        rows = self._beside(contact, agent)
        depth = _depth(self.other[rows, :2] - contact[:2], agent, heading)
        inside = depth > 0.0  # few are, and only these need to be looked at for steps
        kept = ~self._are_faces(rows[inside], contact[2], agent.max_step)
        return float(depth[inside][kept].max(initial=0.0))

    def height_of_touched(self, trajectory: Trajectory, agent: Agent) -> float:
        """How high over the ground beside it the highest point is that the standing cylinder touches [m]; 0 if none."""
        rows = np.concatenate([self._hits(pose, agent) for pose in _dense(trajectory.ground)])
        return float(self.over_ground[rows].max(initial=0.0))

    def _hits(self, contact: FloatArray, agent: Agent) -> IntArray:
        """Which points beside a contact are at the height of the body, and no face of a step that it takes."""
        rows = self._beside(contact, agent)
        hits: IntArray = rows[~self._are_faces(rows, contact[2], agent.max_step)]
        return hits

    def _beside(self, contact: FloatArray, agent: Agent) -> IntArray:
        """Which points are at the height of the body, as far from a contact as it reaches, whatever they are."""
        near = self.other_tree.query_ball_point(contact[:2], max(agent.radius, _reach(agent)))
        rows = np.array(near, dtype=np.int64)
        over = self.other[rows, 2] - contact[2]
        beside: IntArray = rows[(over > SCATTER) & (over < (1.0 - HEAD) * agent.height)]
        return beside

    def _are_faces(self, rows: IntArray, contact: float, max_step: float) -> BoolArray:
        """Whether points are the ground's scatter, or under ground that is one step over the ground next below it.

        The front of a cylinder on a stair reaches the riser after next: what counts is each riser by itself, right
        beside the point, not how high it is over the contact. A tread that was not scanned leaves the contact.
        """
        for row in rows[np.isnan(self.beside[rows, 0])]:
            self.beside[row] = self._ground_beside(self.other[row])
        above, below = self.beside[rows].T
        faces: BoolArray = above - np.maximum(below, contact) <= max_step
        return faces

    def _ground_beside(self, point: FloatArray) -> tuple[float, float]:
        """Height of the ground next above a point and next below it, right beside it [m]; inf, -inf where none is.

        Between centres of voxels wider than `FACE` nothing is that near: the same rung, a voxel further, goes on there.
        """
        rows = [*self.ground_plan.query_ball_point(point[:2], FACE), self.ground_plan.query(point[:2])[1]]
        if self.voxel > FACE:
            next_to = np.array(self.ground_plan.query_ball_point(point[:2], self.voxel), dtype=np.int64)
            rows += next_to[np.abs(self.ground[next_to, 2] - point[2]) <= SCATTER].tolist()
        z = self.ground[rows, 2]
        above, below = z[z >= point[2] - SCATTER], z[z <= point[2] + SCATTER]
        return float(above.min(initial=np.inf)), float(below.max(initial=-np.inf))


def _pitch(z: FloatArray) -> float:
    """Width of the voxels that heights, shape (n,) [m], are those of; 0 where they do not all lie on rungs."""
    apart = np.diff(np.unique(np.round(z, 3)))
    pitch = float(apart.min(initial=np.inf))
    on_rungs = np.isfinite(pitch) and np.abs(apart / pitch - np.round(apart / pitch)).max() <= ROUNDED
    return pitch if on_rungs and len(apart) < len(z) - 1 else 0.0


def _depth(aside: FloatArray, agent: Agent, heading: float) -> FloatArray:
    """How deep places beside the body's axis, (m, 2) [m], are in its cylinder, or in its footprint if it has discs."""
    if agent.discs == 1:
        radial: FloatArray = agent.radius - np.linalg.norm(aside, axis=1)
        return radial
    turn = np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])
    ahead, across = np.abs(turn @ aside.T)
    depth: FloatArray = np.minimum(0.5 * agent.length - ahead, 0.5 * agent.width - across)
    return depth


def _reach(agent: Agent) -> float:
    """How far the farthest corner is from the body's axis [m]; turning moves it. A cylinder's turning moves nothing."""
    return 0.0 if agent.discs == 1 else 0.5 * float(np.hypot(agent.length, agent.width))


def _dense(path: FloatArray, reach: float = 0.0) -> FloatArray:
    """A path every `STEP`; a fourth column is the heading [rad], whose turning moves a corner at `reach` [m]."""
    moved = np.linalg.norm(np.diff(path[:, :3], axis=0), axis=1)
    moved = moved + reach * np.abs(np.diff(path[:, 3:], axis=0)).sum(axis=1)
    pieces = [
        np.linspace(a, b, max(1, int(np.ceil(length / STEP))), endpoint=False)
        for a, b, length in zip(path[:-1], path[1:], moved, strict=True)
    ]
    return np.vstack([*pieces, path[-1:]])

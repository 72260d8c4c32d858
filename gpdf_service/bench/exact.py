"""Paths judged against an exact world: what the body touches, and whether its feet are on the ground."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from gpdf_service.bench.judge import Judge
from gpdf_service.synthetic.place import SEEN
from gpdf_service.synthetic.solid_world import SolidWorld
from gpdf_service.types import Agent, FloatArray, Trajectory

SPACING = 0.03
"""[m] Between the points of the world that a body is held against; no baluster is narrower than two thirds of it."""
STEP = 0.03
"""[m] Between two looks along a path."""
FOOT = 0.1
"""[m] A foot stands on ground this far in plan from its middle: less than half a foot's length."""
ON = 0.05
"""[m] A foot this far over or under the ground is on it: a person's step is no more exact."""
AROUND = 8
"""Directions in which ground is looked for around the middle of a foot."""


@dataclass(frozen=True, slots=True)
class Truth:
    """What is true of one path.

    Attributes:
        penetration: How deep the worst point of the world is in the body [m]; 0 if nothing is touched.
        foot: The farthest that a foot is over (positive) or under the true ground [m]; inf where there is none.
    """

    penetration: float
    foot: float

    def collides(self, noise: float) -> bool:
        """Whether something is touched deeper than three standard deviations of the scan's noise [m] explain."""
        return self.penetration > 3.0 * noise

    @property
    def in_the_air(self) -> bool:
        """Whether a foot is anywhere off the ground."""
        return abs(self.foot) > ON


def judge_path(world: SolidWorld, path: Trajectory, agent: Agent) -> Truth:
    """Hold a path against the world, every `STEP` of it."""
    contacts = every(path.ground, STEP)
    aside, up = agent.radius + 0.3, agent.height
    grown = np.array([[-aside, -aside, -1.0], [aside, aside, up]])
    corner = np.array([contacts.min(axis=0), contacts.max(axis=0)]) + grown
    judge = Judge(*world.sample(SPACING, agent.height, corner))
    deepest = max(judge.penetration(contact, agent) for contact in contacts)
    return Truth(deepest, worst_foot(world, contacts, agent.max_step))


def count_touching(
    world: SolidWorld, places: FloatArray, agent: Agent, noise: float, things: FloatArray
) -> dict[str, int]:
    """At how many places (m, 3) a body that stands there is deeper in something than noise [m] explains.

    And at how many of these in something that a scan shows there: the `things` are its points that are truly no ground
    (n, 3) [m], for a wall that nobody saw stands on a floor that was seen.
    """
    points, ground = world.sample(SPACING, agent.height)

    def touching(judge: Judge, places: FloatArray) -> FloatArray:
        return places[[Truth(judge.penetration(place, agent), 0.0).collides(noise) for place in places]]

    wrong = touching(Judge(points, ground), places)
    seen = ground.copy()
    if len(wrong):
        seen |= cKDTree(things).query(points, distance_upper_bound=SEEN)[0] <= SEEN
    return {"wrongly_free": len(wrong), "wrongly_free_seen": len(touching(Judge(points[seen], ground[seen]), wrong))}


def worst_foot(world: SolidWorld, contacts: FloatArray, max_step: float) -> float:
    """The one of `feet_off` that is farthest [m]."""
    off = feet_off(world, contacts, max_step)
    return float(off[np.abs(off).argmax()])


def feet_off(world: SolidWorld, contacts: FloatArray, max_step: float) -> FloatArray:
    """How far contacts (m, 3) are over (positive) or under the ground next to them [m], (m,); inf without any.

    Between two treads within a foot's length of it that are a step apart, a contact goes from one to the other.
    """
    turn = 2 * np.pi * np.arange(AROUND) / AROUND
    around = np.vstack([np.zeros(3), FOOT * np.column_stack([np.cos(turn), np.sin(turn), np.zeros(AROUND)])])
    places = (contacts[:, None] + around).reshape(-1, 3)
    under = [world.ground_under(places + np.array([0.0, 0.0, lift]), 2 * max_step) for lift in (0.0, ON, max_step)]
    off = np.concatenate([contacts[:, None, 2] - each.reshape(len(contacts), -1) for each in under], axis=1)
    over = np.where(off >= 0.0, off, np.inf).min(axis=1)
    sunk = np.where(off < 0.0, -off, np.inf).min(axis=1)
    nearest = np.where(over <= sunk, over, -sunk)
    made: FloatArray = np.where(over + sunk <= max_step, 0.0, nearest)
    return made


def every(path: FloatArray, step: float) -> FloatArray:
    """Places along a path (n, 3), at most `step` apart [m]."""
    length = np.linalg.norm(np.diff(path, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(length)])
    s = np.union1d(np.arange(0.0, along[-1], step), along)
    return np.column_stack([np.interp(s, along, column) for column in path.T])

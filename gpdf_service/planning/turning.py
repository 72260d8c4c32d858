"""Ways of a body that must face the right way to pass: from the search over poses to legs, and their time stamps."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from gpdf_service.planning.routes import Leg, Route
from gpdf_service.planning.shape import shortcut
from gpdf_service.planning.timing import STILL, time_path
from gpdf_service.planning.words import measure, place_words
from gpdf_service.search.free_space import FreeSpace
from gpdf_service.search.lattice import MOST_POSES, POSES_PER_SECOND, PoseSearch, find_poses, moving
from gpdf_service.search.places import leap
from gpdf_service.types import Agent, FloatArray, Status

Facing = tuple[float | None, float | None]
"""Where a body faces at the start and at the goal [rad]; None leaves it free."""


@dataclass(frozen=True, slots=True)
class Stuck:
    """Why a body gets no further, and where: (x, y, z of the ground) [m]."""

    status: Status
    message: str
    at: FloatArray


def turn_route(space: FreeSpace, route: Route, seconds: float, facing: Facing = (None, None)) -> Route | Stuck:
    """The same route with poses (x, y, θ) for legs, whose ends are kept, or where it cannot be passed.

    The body begins each leg as it ends the one before. The search may take so many `seconds`.
    """
    legs: list[Leg] = []
    heading = facing[0]
    most = min(MOST_POSES, int(POSES_PER_SECOND * max(0.0, min(seconds, MOST_POSES))))
    if most == 0:
        level, path, own = route.legs[0]
        return _stuck(own, level, PoseSearch(np.append(path[0, :2], 0.0)[None], reached=False, given_up=True))
    for n, (level, path, own) in enumerate(route.legs, start=1):
        ends, body = (heading, facing[1] if n == len(route.legs) else None), (own.agent.offsets, own.radius)
        found = find_poses(own.levels[level].places, own.surfaces[level], path, ends, *body, most=most)
        if not found.reached:
            return _stuck(own, level, found)
        legs.append(Leg(level, _pull(own, level, found.poses), own))
        heading = float(legs[-1].path[-1, 2])
    return route._replace(legs=legs)


def _stuck(space: FreeSpace, level: int, found: PoseSearch) -> Stuck:
    agent, xy = space.agent, found.poses[-1, :2]
    at = np.append(xy, space.levels[level].surface.height_at(xy[None]))
    place = place_words(xy)
    if found.given_up:
        words = f"the {agent.name} had come as near as {place} when the search for a way was given up. Allow more time."
        return Stuck(Status.TIMEOUT, words, at)
    words = (
        f"the {agent.name} cannot get there: it is {measure(agent.length)} m long and does not get round at {place}."
    )
    return Stuck(Status.NO_VALID_PATH, f"{words} A shorter body, or one that is narrow all around, may pass.", at)


def _pull(space: FreeSpace, level: int, poses: FloatArray) -> FloatArray:
    """A way over poses, (n, 3), pulled straight: turn on the spot, go straight ahead, turn again; θ unwrapped."""
    own = space.levels[level]
    kept = shortcut(poses, own.places, space.radius, space.agent.offsets, own.surface.arrays)
    parts = [poses[:1]]
    for a, b in pairwise(kept):
        parts.append(leap(poses[a], poses[b]) if b - a > 1 else poses[[b]])
    made = np.concatenate(parts)
    made[:, 2] = np.unwrap(made[:, 2])
    return moving(made)


def time_poses(
    positions: FloatArray, headings: FloatArray, agent: Agent, limit: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Times [s] and headings [rad] of a path of a body that faces `headings`; a cylinder faces where it goes.

    Where it moves, it is as slow as its turn rate asks for; where two places are the same but for rounding it stands
    and turns, its ends no faster than they may be on the way. The path has shape (n, 3) [m], the `limit` of the speed
    (n,) [m/s].
    """
    if agent.discs == 1:
        return time_path(positions, agent, limit)
    step = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    turn = np.abs(np.diff(headings))
    goes = step > STILL
    cuts = np.flatnonzero(np.diff(goes)) + 1
    times = np.zeros(len(positions))
    for part in np.split(np.arange(len(step)), cuts):
        rows = np.append(part, part[-1] + 1)
        if goes[part[0]]:
            with np.errstate(divide="ignore"):
                slow = agent.turn_rate * step[part] / turn[part]
            most = np.minimum(np.append(slow, np.inf), np.insert(slow, 0, np.inf))
            spent = time_path(positions[rows], agent, np.minimum(limit[rows], most))[0]
        else:
            reach = float(agent.offsets[-1])
            along = np.append(0.0, np.cumsum(reach * turn[part]))
            ends = replace(agent, speed=reach * agent.turn_rate)
            spent = time_path(along[:, None] * np.array([1.0, 0.0, 0.0]), ends)[0]
        times[rows[1:]] = times[rows[0]] + spent[1:] - spent[0]
    return times, headings

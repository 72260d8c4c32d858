"""Start and goal: which level they are on, and whether the body can be there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from gpdf_service.perception import ObstacleKind
from gpdf_service.perception.surface import UNKNOWN
from gpdf_service.search import FreeSpace, is_clear
from gpdf_service.types import FloatArray, Status

SAME_GROUND = 0.5
"""[m] A given height means the level within this of it: half of the least headroom between two storeys is far more."""
REASONS = {
    ObstacleKind.MATERIAL: "an obstacle",
    ObstacleKind.STEP: "a step or drop that it does not take",
    ObstacleKind.SLOPE: "ground too steep for it",
    ObstacleKind.UNKNOWN: "ground that nobody has seen",
}


@dataclass(frozen=True, slots=True)
class Endpoint:
    """A valid start or goal: place in plan (2,) [m], level, graph node to go on from."""

    xy: FloatArray
    level: int
    node: int


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why a start or goal is none."""

    status: Status
    message: str


def find_endpoint(space: FreeSpace, place: FloatArray, name: str) -> Endpoint | Refusal:
    """Check a place, (x, y) or (x, y, z of the ground), and connect it to the graph."""
    outside = Status.START_OUTSIDE_MAP if name == "start" else Status.GOAL_OUTSIDE_MAP
    occupied = Status.START_OCCUPIED if name == "start" else Status.GOAL_OCCUPIED
    xy = place[None, :2]
    heights = np.array([float(surface.height_at(xy)[0]) for surface in space.surfaces])
    there = np.flatnonzero(~np.isnan(heights))
    if len(there) == 0 and any(_shut_in(space, level, xy) for level in range(len(space.surfaces))):
        words = f"the {name} {_at(place)} is inside something, or on ground that nobody has seen."
        near = _nearest_free(space, 0, xy[0])
        return Refusal(occupied, words if near is None else f"{words} The nearest free place is {_at(near)}.")
    if len(there) == 0:
        return Refusal(outside, f"no ground is known at the {name} {_at(place)}. Choose a place on the mapped ground.")
    if len(place) == 3:
        level = int(there[np.abs(heights[there] - place[2]).argmin()])
        if abs(heights[level] - place[2]) > SAME_GROUND:
            found = ", ".join(f"{heights[i]:.2f}" for i in there)
            return Refusal(outside, f"the ground at the {name} {_at(place)} is at z = {found} m, not {place[2]:.2f} m.")
    elif np.ptp(heights[there]) > SAME_GROUND:
        found = ", ".join(f"{heights[i]:.2f}" for i in there)
        return Refusal(
            Status.AMBIGUOUS_LEVEL, f"there is ground at z = {found} m under the {name} {_at(place)}. Give its z."
        )
    else:
        level = int(there[0])
    distance, kind = space.clearance(level, xy)
    if distance[0] < space.reach:
        what = REASONS[ObstacleKind(int(kind[0]))]
        near = _nearest_free(space, level, xy[0])
        hint = "" if near is None else f" The nearest free place is {_at(near)}."
        return Refusal(
            occupied,
            f"the {space.agent.name} (radius {space.agent.radius:.2f} m) does not fit at the {name} {_at(place)}: "
            f"{what} is {distance[0]:.2f} m from its centre.{hint}",
        )
    node = _connect(space, level, xy[0])
    if node < 0:
        return Refusal(occupied, f"the {space.agent.name} cannot leave the {name} {_at(place)} in any direction.")
    return Endpoint(xy[0], level, node)


def _shut_in(space: FreeSpace, level: int, xy: FloatArray) -> bool:
    """Whether a place without known ground is within reach of material, or in a hole that known ground surrounds."""
    surface = space.surfaces[level]
    ix, iy, inside = surface.cells(xy)
    if not inside[0]:
        return False
    distance, kind = space.clearance(level, xy)
    if kind[0] == ObstacleKind.MATERIAL and distance[0] < space.reach:
        return True
    label = ndimage.label(surface.state == UNKNOWN)[0]
    rim = np.concatenate([label[0], label[-1], label[:, 0], label[:, -1]])
    return bool(label[ix[0], iy[0]] not in rim)


def _connect(space: FreeSpace, level: int, xy: FloatArray) -> int:
    """The graph node of a free leaf whose centre is reached from `xy` on a clear line; -1 if there is none."""
    tree = space.quadtrees[level]
    leaf = int(tree.find(xy[None])[0])
    if leaf >= 0 and tree.whole[leaf]:
        return leaf + space.offsets[level]
    free = np.flatnonzero(tree.free)
    gap = np.linalg.norm(tree.center[free] - xy, axis=1) - tree.half_size[free]
    radius = min(space.radius, float(space.clearance(level, xy[None])[0][0]) - 1e-9)  # it may start closer
    for leaf in free[np.argsort(gap)[:32]]:
        if is_clear(space.trees[level], xy, tree.center[leaf], radius):
            return int(leaf) + space.offsets[level]
    return -1


def _nearest_free(space: FreeSpace, level: int, xy: FloatArray) -> FloatArray | None:
    tree = space.quadtrees[level]
    free = np.flatnonzero(tree.free)
    if len(free) == 0:
        return None
    inside = np.where(tree.whole[free], tree.half_size[free], 0.0)[:, None]
    nearest = np.clip(xy, tree.center[free] - inside, tree.center[free] + inside)
    place: FloatArray = nearest[np.linalg.norm(nearest - xy, axis=1).argmin()]
    return place


def _at(place: FloatArray) -> str:
    return "(" + ", ".join(f"{value:.2f}" for value in place) + ")"

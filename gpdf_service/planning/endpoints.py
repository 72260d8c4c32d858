"""Start and goal: which level they are on, and whether the body can be there."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import isnan, sqrt
from typing import NamedTuple

import numpy as np
from numba import njit
from scipy import ndimage

from gpdf_service.fields.tree import make_scratch
from gpdf_service.ground import ObstacleKind
from gpdf_service.planning.certificate import FINEST
from gpdf_service.planning.footprint import disc_places
from gpdf_service.planning.shape import radius_within
from gpdf_service.planning.words import measure, metres, place_words
from gpdf_service.search.free_space import FreeSpace
from gpdf_service.search.nearest import nearest_free
from gpdf_service.search.places import Places, is_straight_clear
from gpdf_service.tiles.surface import UNKNOWN, height_of, is_same_ground
from gpdf_service.types import FloatArray, PlanOptions, Status

SAME_GROUND = 0.5
"""[m] A given height means the level within this of it: half of the least headroom between two storeys is far more."""
NEXT = 1.0
"""[m] The centre of the leaf to go on from is nearer than this: leaves are small beside obstacles."""
MOST_TRIED = 32
"""Leaves to which a way is looked for: some are behind what stands beside."""
FACINGS = 180
"""Directions that are tried for a body of discs, over half a turn: 1 cm at the end of one that is 1.2 m long."""
REASONS = {
    ObstacleKind.MATERIAL: "an obstacle",
    ObstacleKind.STEP: "a step or drop that it does not take",
    ObstacleKind.SLOPE: "ground too steep for it",
    ObstacleKind.UNKNOWN: "ground that nobody has seen",
}


class Endpoint(NamedTuple):
    """A valid start or goal.

    Attributes:
        xy: Place in plan [m], shape (2,).
        level: Of the ground that it is on.
        node: Of the graph, to go on from.
        floor: Height of the ground [m].
        room: Distance to the nearest obstacle [m]; inf in a leaf that is wholly free, where the search asks for none.
    """

    xy: FloatArray
    level: int
    node: int
    floor: float
    room: float = np.inf


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why a start or goal is none, and the nearest place that is one (x, y, z of the ground), where it is known.

    Where the body does not fit, `room` tells as numbers what its message says [m]: `room`, from its centre to the
    nearest obstacle; `needed`, which that must be at least; `noise_margin`, how much of it the scan's noise asks for.
    """

    status: Status
    message: str
    nearest: FloatArray | None = None
    room: dict[str, float] = field(default_factory=dict)


class Ends(NamedTuple):
    """All places of a request; a goal that is not valid is None. `moved` says in words what was snapped."""

    start: Endpoint
    via: tuple[Endpoint, ...]
    goals: tuple[Endpoint | None, ...]
    moved: str = ""


def find_ends(space: FreeSpace, start: FloatArray, goals: list[FloatArray], options: PlanOptions) -> Ends | Refusal:
    """Check all places of a request; one goal of several must be valid. Snaps where the request allows it."""
    began = _snap(space, start, "start", options.snap)
    if isinstance(began, Refusal):
        return began
    component = int(space.graph.component[began[0].node])
    via = []
    for number, place in enumerate(options.via, start=1):
        found = _snap(space, place, f"via point {number}", options.snap, component)
        if isinstance(found, Refusal):
            return found
        via.append(found)
    reached = [_snap(space, goal, "goal", options.snap, component) for goal in goals]
    free = [goal for goal in reached if not isinstance(goal, Refusal)]
    if not free and isinstance(reached[0], Refusal):
        return reached[0]
    goals_ = tuple([None if isinstance(goal, Refusal) else goal[0] for goal in reached])
    words = " ".join([words for _, words in (began, *via, *free) if words])
    return Ends(began[0], tuple([end for end, _ in via]), goals_, words)


def _snap(
    space: FreeSpace, place: FloatArray, name: str, snap: float, component: int | None = None
) -> tuple[Endpoint, str] | Refusal:
    """A valid place, and in words how it was moved to be one, `snap` metres at most, within the graph's component."""
    found = find_endpoint(space, place, name)
    if isinstance(found, Endpoint):
        return found, ""
    if found.nearest is None or snap <= 0.0:
        return found
    near = found.nearest if component is None else nearest_free(space, place, SAME_GROUND, component)
    if near is None or np.linalg.norm(near[:2] - place[:2]) > snap:
        return found if component is None else _unreached(found, near, place, snap)
    moved = find_endpoint(space, near, name)
    if isinstance(moved, Refusal):
        return found
    return moved, f"The {name} was moved {np.linalg.norm(near[:2] - place[:2]):.2f} m to {place_words(near)}."


def _unreached(found: Refusal, near: FloatArray | None, place: FloatArray, snap: float) -> Refusal:
    """The refusal of a place that could be moved, but to no place within reach that the start can go to."""
    assert found.nearest is not None
    if np.linalg.norm(found.nearest[:2] - place[:2]) > snap:  # nothing free is that near
        return found
    words = f"{found.message.removesuffix('.')}: it is free, but not reachable from the start."
    if near is None:
        return replace(found, message=f"{words} Nothing is.")
    far = np.linalg.norm(near[:2] - place[:2])
    return replace(found, message=f"{words} The nearest that is, {place_words(near)}, is {far:.2f} m away.")


def find_endpoint(space: FreeSpace, place: FloatArray, name: str) -> Endpoint | Refusal:
    """Check a place, (x, y) or (x, y, z of the ground), and connect it to the graph; via points count as goals."""
    xy = place[:2]
    heights = _heights_at(space, xy)
    found = _level_at(space, place, name, heights)
    if isinstance(found, Refusal):
        return found
    width = space.surfaces[found].cell_width
    same = [one for one, z in heights.items() if one == found or is_same_ground(z, heights[found], width)]
    if len(same) == 1 and space.agent.discs == 1:  # else the room decides, on the level or which way it faces
        node = space.levels[found].node_at(xy)
        if node >= 0:
            return Endpoint(xy, found, node, heights[found])
    rooms = {one: space.levels[one].room(xy) for one in same}
    level = max(same, key=lambda one: rooms[one][0])  # sheets end where others go on
    room, kind = rooms[level]
    occupied, body = _occupied(name), f"the {space.agent.name}"
    if room < space.reach + FINEST:  # less cannot be proven of a way that ends there
        words = f"does not fit at {_words(name, place)}: {REASONS[ObstacleKind(kind)]} is"
        return _too_tight(space, np.array([*xy, heights[level]]), occupied, words, room)
    if not _faces_somewhere(space, level, xy, room):
        body = f"{body} ({measure(space.agent.length)} m long)"
        return Refusal(occupied, f"{body} fits at {_words(name, place)} in no direction.")
    node = connect(space, level, xy, room)
    if node < 0:
        return Refusal(occupied, f"{body} cannot leave {_words(name, place)} in any direction.")
    return Endpoint(xy, level, node, heights[level], room)


def _words(name: str, place: FloatArray) -> str:
    return f"the {name} {place_words(place)}"


def _occupied(name: str) -> Status:
    return Status.START_OCCUPIED if name == "start" else Status.GOAL_OCCUPIED


def _outside(name: str) -> Status:
    return Status.START_OUTSIDE_MAP if name == "start" else Status.GOAL_OUTSIDE_MAP


def _heights_at(space: FreeSpace, xy: FloatArray) -> dict[int, float]:
    """Levels with ground at a place, and its height there [m]."""
    (x, y), made = xy.tolist(), {}
    for level, surface in enumerate(space.surfaces):
        (u, v), (nx, ny), width = surface.origin.tolist(), surface.state.shape, surface.cell_width
        if -width <= x - u <= (nx + 1) * width and -width <= y - v <= (ny + 1) * width:  # else no kernel is asked
            z = float(height_of(surface.arrays, x, y))
            if not isnan(z):
                made[level] = z
    return made


def _level_at(space: FreeSpace, place: FloatArray, name: str, heights: dict[int, float]) -> int | Refusal:
    """The level that a place means, of those with ground of such heights there."""
    if not heights:
        at, (near, hint) = _words(name, place), _nearest(space, place)
        if any(_shut_in(space, level, place[None, :2]) for level in range(len(space.levels))):
            return Refusal(_occupied(name), f"{at} is inside something, or on ground that nobody has seen.{hint}", near)
        words = f"no ground is known at {at}. Choose a place on the mapped ground.{hint}"
        return Refusal(_outside(name), words, near)
    if len(place) == 2:
        if max(heights.values()) - min(heights.values()) <= SAME_GROUND:
            return next(iter(heights))
        words = f"there is ground at z = {_told(heights)} m under {_words(name, place)}. Give its z."
        return Refusal(Status.AMBIGUOUS_LEVEL, words)
    level = min(heights, key=lambda one: abs(heights[one] - place[2]))
    if abs(heights[level] - place[2]) <= SAME_GROUND:
        return level
    ground = f"the ground at {_words(name, place)} is at z = {_told(heights)} m"
    return Refusal(_outside(name), f"{ground}, not {metres(place[2])} m.")


def _told(heights: dict[int, float]) -> str:
    return ", ".join(dict.fromkeys(f"{z:.2f}" for z in sorted(heights.values())))


def _nearest(space: FreeSpace, place: FloatArray) -> tuple[FloatArray | None, str]:
    """The nearest free place, and that in words."""
    near = nearest_free(space, place, SAME_GROUND)
    return near, "" if near is None else f" The nearest free place is {place_words(near)}."


def _too_tight(space: FreeSpace, place: FloatArray, status: Status, words: str, room: float) -> Refusal:
    """The refusal of a place, (x, y, z), with too little `room` [m]."""
    near, hint = _nearest(space, place)
    radius, margin = space.agent.disc_radius, space.reach - space.agent.disc_radius
    digits = 2 if round(room, 2) < round(space.reach, 2) else 4  # a millimetre or less may be what is short
    noise = f", and {margin:.{digits}f} m for the noise of the scan" if margin > 0.0 else ""
    body = f"the {space.agent.name} (radius {measure(radius)} m{noise})"
    told = {"room": room, "needed": space.reach, "noise_margin": margin}
    return Refusal(status, f"{body} {words} {room:.{digits}f} m from its centre.{hint}", near, told)


def _faces_somewhere(space: FreeSpace, level: int, xy: FloatArray, room: float) -> bool:
    """Whether all discs of the body keep their distance at a place in plan when it faces in some direction.

    With `room` [m] around the place that the discs need however it is turned, any will do.
    """
    agent = space.agent
    if room >= space.reach + agent.offsets[-1]:
        return True
    heading = np.linspace(0.0, np.pi, FACINGS, endpoint=False)
    poses = np.column_stack([np.tile(xy, (FACINGS, 1)), heading])
    fits = [space.levels[level].clearance(disc_places(poses, offset))[0] >= space.reach for offset in agent.offsets]
    return bool(np.logical_and.reduce(fits).any())


def _shut_in(space: FreeSpace, level: int, xy: FloatArray) -> bool:
    """Whether a place without known ground is within reach of material, or in a hole that known ground surrounds."""
    surface = space.levels[level].surface
    ix, iy, inside = surface.cells(xy)
    if not inside[0]:
        return False
    distance, kind = space.levels[level].clearance(xy)
    if kind[0] == ObstacleKind.MATERIAL and distance[0] < space.reach:
        return True
    label = ndimage.label(surface.state == UNKNOWN)[0]
    rim = np.concatenate([label[0], label[-1], label[:, 0], label[:, -1]])
    return bool(label[ix[0], iy[0]] not in rim)


def radius_at(space: FreeSpace, room: float) -> float:
    """What a way keeps from obstacles [m] that begins with so much `room`."""
    return float(radius_within(room, space.reach, space.radius))


def connect(space: FreeSpace, level: int, xy: FloatArray, room: float | None = None) -> int:
    """The graph node of a free leaf whose centre is reached on a clear line from `xy`; -1 if none, or no body fits.

    How much `room` there is [m] is only asked, where it is not given, in a leaf that is not wholly free.
    """
    own = space.levels[level]
    tree, node = own.quadtree, own.node_at(xy)
    if node >= 0:
        return node
    room = own.room(xy)[0] if room is None else room
    if room < space.reach:
        return -1
    for reach in (0.1 * NEXT, NEXT):  # most go on from a leaf beside them, and there are many further away
        free = tree.within(xy, reach)
        free = free[tree.free[free]]
        half = np.asarray(0.5 * tree.width * tree.size[free], dtype=np.float64)
        center = tree.origin + tree.corner[free] * tree.width + half[:, None]
        row = _nearest_clear(own.places, xy, center, half, radius_at(space, room))
        if row >= 0:
            return int(free[row]) + own.offset
    return -1


@njit(cache=True, nogil=True)
def _nearest_clear(obstacles: Places, xy: FloatArray, center: FloatArray, half: FloatArray, radius: float) -> int:
    """Of squares with such centres (k, 2) and half widths (k,), one of the nearest to which it is clear; −1 if none."""
    gap, scratch = np.empty(len(half)), make_scratch()
    for i in range(len(half)):
        gap[i] = sqrt((center[i, 0] - xy[0]) ** 2 + (center[i, 1] - xy[1]) ** 2) - half[i]
    for row in np.argsort(gap)[:MOST_TRIED]:
        if is_straight_clear(obstacles, xy, center[row], radius, scratch):
            return int(row)
    return -1

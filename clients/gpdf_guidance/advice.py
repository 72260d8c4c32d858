"""What a person should do and know at a place on a route: a pure function of route, pose and time.

One rule carries the safety: a person may go only as fast as lets him come to rest inside the corridor should no pose
ever come again. So a lost pose, a late reaction and a bent course have all been paid for before they happen.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import atan2, inf, radians

import numpy as np
from gpdf_schemas import CueAction
from numpy.typing import NDArray

from gpdf_guidance.ahead import ARRIVED, EDGE, ON_THE_SPOT, find_ahead, find_turning, is_edge
from gpdf_guidance.corridor import WIDEST
from gpdf_guidance.features import FeatureKind, wrap
from gpdf_guidance.instruction import Instruction, Kind, Side, Urgency
from gpdf_guidance.route import Pose, Progress, Route
from gpdf_guidance.stairs import FEET, GATE, SQUARE

FloatArray = NDArray[np.float64]

PACES = (0.7, 0.3, 0.2, 0.1)
"""[m/s] A walk with a cane; a careful one, which is a stair's tread a second; feeling the way, and inch by inch."""
POSE_AGE = 0.4
"""[s] An older pose is none: two poses of a 5 Hz stream are missing."""
REACTION = 0.5
"""[s] From a cue to the foot."""
BRAKING = 0.3
"""[s] The step that is under way, at the pace that it had."""
BLIND = POSE_AGE + REACTION + BRAKING
"""[s] What a person walks on after the last good pose."""
SWAY = radians(8)
"""[rad] Without sight a course bends by this within `BLIND`."""
UNRELIABLE = 0.15
"""[m] One standard deviation of a pose from which it is no pose: half of a narrow passage's room."""
STOREY = 1.0
"""[m] A pose that is this much over or under the way's ground is on another storey: half of the least headroom."""
LOOK_AHEAD = (1.5, 1.2, 0.9, 0.7, 0.5, 0.35, 0.2)
"""[m] Along the path to the place that one walks towards; the furthest that is reached straight."""
RAY_STEPS = 14
"""Steps of 6 cm along which the corridor is looked at; the slowest pace takes two of them."""
FACING = radians(3)
"""[rad] In a tight place one turns until one faces the way by this."""
POSE_SLACK = 0.03
"""[m] A pose may be this far out of the corridor by its own error alone."""
AT_EDGE = 0.35
"""[m] Half a pace: so near to an edge of stairs a person stays square to it."""
SQUARE_ON = radians(12)
"""[rad] Towards the middle of the stairs one may be led by this; `SQUARE` is this and a course's sway."""
NEAR_STEP = 1.2
"""[m] Before a step or a stair one goes slowly: a pace and a half."""
CAREFUL = (FeatureKind.STEP, FeatureKind.STAIRS, FeatureKind.UNSEEN)
"""What is walked at a careful pace, so that a cane finds it."""
STOP_BEFORE = 2.8
"""[s] An obstacle that is new on the path stops who would be there within this: twice `BLIND`, and a step. Beside what
moves one goes on slowly until one would be there within this at a careful pace, which is `BLIND` at full pace."""
BODY_HEIGHT = 2.0
"""[m] Of a person with a hat."""
LEAST_OBSTACLE = 0.05
"""[m] What is lower is no obstacle to a foot."""
SWING = 0.1
"""[m] Beside the body, of an arm: what is new and within it is no room to walk past."""
MOVES_NEAR = 3.0
"""[m] What moves is told of from here: two seconds of a person who comes."""
AT_GOAL = 0.1
"""[m] From the goal one has arrived: a pose knows no better."""
NEAR_GOAL = ((1.0, PACES[1]), (0.5, PACES[2]))
"""[m], [m/s] So close to the goal one goes so slowly: who is told to stop still walks for `REACTION`."""
OVER_TURN = radians(15)
"""[rad] Who turns on the spot turns on by this after the cue to stop (Ahmetovic et al. 2018: 17° and 13°)."""


@dataclass(frozen=True, slots=True)
class Advice:
    """What to do now (`action`, `direction` [rad] to the left, `pace` [m/s], `urgency` 0 to 1) and what to say."""

    progress: Progress
    action: CueAction
    direction: float = 0.0
    pace: float = 0.0
    urgency: float = 0.0
    off_way: bool = False
    instructions: tuple[Instruction, ...] = ()


def advise(
    route: Route,
    pose: Pose,
    now: float,
    *,
    near: float,
    obstacles: FloatArray | None = None,
    moving: FloatArray | None = None,
    turning: float | None = None,
    told: float = PACES[0],
) -> Advice:
    """Advise a person.

    Args:
        route: Where to go.
        pose: The newest pose.
        now: On the clock of the pose's stamp [s].
        near: Arc length of the last progress [m].
        obstacles: New things that the service does not know yet, shape (k, 3) [m].
        moving: Those of them that move, shape (m, 3) [m].
        turning: Of one who turns on the spot now, how far he turns on after the cue to stop [rad]; else None.
        told: The pace that he was told of late [m/s]; 0 where he stands, and may turn from a thing that he faces.
    """
    if (reason := distrust(pose, now)) is not None:
        return stop(Progress(near, 0.0), reason)
    progress = route.locate(pose, near)
    if abs(pose.position[2] - route.at(progress.s)[2]) > STOREY:
        return stop(progress, Instruction(Kind.STOP_UNRELIABLE, Urgency.DANGER))
    on_path = _nearest(partial(_obstacle_ahead, route, progress), obstacles, moving)
    before = _nearest(partial(_obstacle_before, route.radius, pose), obstacles, moving)
    faces = before.distance < route.radius + max(told, PACES[1]) * BLIND
    careful = _careful_pace(route, progress)
    least = PACES[1] if on_path.kind is Kind.STOP_MOVING else max(told, careful)
    if on_path.distance < STOP_BEFORE * least or (faces and told > 0.0):
        return stop(progress, min(on_path, before, key=lambda one: one.distance))
    place = np.array(pose.position[:2])
    if not route.inside(place[None], progress.s, POSE_SLACK)[0]:
        if _is_there(route, pose, progress, 0.0):
            return _arrive(route, pose, progress)
        off = Instruction(Kind.STOP_OFF_WAY, Urgency.DANGER)
        return stop(progress, off, off_way=True)
    direction, askew = _square(route, pose, progress, aim(route, pose, progress))
    pace = min(safe_pace(route, pose, progress, direction), careful)
    pace = min(pace, _pace_for(on_path.distance * BLIND / STOP_BEFORE))
    pace = 0.0 if askew or faces else min(pace, _pace_for(before.distance - route.radius))
    on_the_spot = SQUARE if _by_stairs(route, progress) else ON_THE_SPOT
    action = _action(direction, pace, on_the_spot, turning)
    if _is_there(route, pose, progress, pace if action in (CueAction.GO, CueAction.SLOW) else 0.0):
        return _arrive(route, pose, progress)
    if faces and action is CueAction.STOP and turning is None:
        return stop(progress, before)
    ahead, turns = find_ahead(route, progress), action is CueAction.TURN
    ahead = [one for one in ahead if one.leaves_stairs or not turns]  # who turns does not know yet where "ahead" is
    faces_edge = abs(direction) <= SQUARE and _faces_stairs(route, pose, progress)
    ahead = [one for one in ahead if faces_edge or not is_edge(one)]
    said = find_turning(route, progress, direction, action) + ahead
    urgency = min(1.0, abs(direction) / ON_THE_SPOT)
    pace = 0.0 if action is CueAction.TURN else pace
    return Advice(progress, action, direction, pace, urgency, instructions=tuple(sorted(said, key=_first)))


def _is_there(route: Route, pose: Pose, progress: Progress, pace: float) -> bool:
    """Whether a person who is told to stop now stands as near to the goal as he is led.

    Args:
        route: Where he goes.
        pose: Where he is.
        progress: On the way.
        pace: Of him; 0 where he cannot go on from here.
    """
    away = route.ground[-1, :2] - np.array(pose.position[:2])
    gap = float(np.hypot(*away))
    if gap >= ARRIVED or route.length - progress.s >= ARRIVED:
        return False
    ahead = float(away @ [np.cos(pose.heading), np.sin(pose.heading)])
    return gap < AT_GOAL or pace == 0.0 or ahead <= pace * REACTION


def _arrive(route: Route, pose: Pose, progress: Progress) -> Advice:
    """The end of the way, and where the goal is if it is not here; it ends whatever is being said."""
    away = route.ground[-1, :2] - np.array(pose.position[:2])
    gap = float(np.hypot(*away))
    side = side_of(float(np.arctan2(away[1], away[0])) - pose.heading)
    kind = Kind.ARRIVED_BESIDE if gap > 2 * UNRELIABLE else Kind.ARRIVED
    done = Instruction(kind, Urgency.DANGER, distance=gap, side=side)
    return Advice(progress, CueAction.ARRIVED, instructions=(done,))


def side_of(bearing: float) -> Side:
    """Where something is to a person, from its direction to the left [rad]."""
    quarter = round(wrap(bearing) / (0.5 * np.pi)) % 4
    return (Side.AHEAD, Side.LEFT, Side.BEHIND, Side.RIGHT)[quarter]


def _first(instruction: Instruction) -> tuple[int, bool, float]:
    return -instruction.urgency, not instruction.leaves_stairs, instruction.distance


def distrust(pose: Pose, now: float) -> Instruction | None:
    """Why a pose is none, whatever the way: old, of the future, without numbers, vague; None if it is one."""
    if now - pose.stamp > POSE_AGE:
        return Instruction(Kind.STOP_LOST, Urgency.DANGER)
    good = pose.is_finite and now - pose.stamp >= -POSE_AGE and pose.accuracy <= UNRELIABLE
    return None if good else Instruction(Kind.STOP_UNRELIABLE, Urgency.DANGER)


def stop(progress: Progress, reason: Instruction, *, off_way: bool = False) -> Advice:
    """Stop at once, and why."""
    return Advice(progress, CueAction.STOP, urgency=1.0, off_way=off_way, instructions=(reason,))


def _action(direction: float, pace: float, on_the_spot: float, turning: float | None) -> CueAction:
    """What to do; who turns goes on turning until he comes to rest where he should face."""
    if turning is not None:
        if abs(direction) > turning:
            return CueAction.TURN
        if pace == 0.0:
            return CueAction.STOP  # he turns on; then it is seen what is left
    if abs(direction) >= on_the_spot or pace == 0.0:
        return CueAction.TURN if abs(direction) > FACING else CueAction.STOP
    return CueAction.GO if pace == PACES[0] else CueAction.SLOW


def _nearest(
    gap: Callable[[FloatArray], float], obstacles: FloatArray | None, moving: FloatArray | None
) -> Instruction:
    """What to say of the nearest new thing, and how far it is as `gap` measures it [m]; inf where there is none."""
    nearest = inf if obstacles is None else gap(obstacles)
    moves = moving is not None and gap(moving) <= nearest
    return Instruction(Kind.STOP_MOVING if moves else Kind.STOP_OBSTACLE, Urgency.DANGER, distance=nearest)


def _obstacle_before(radius: float, pose: Pose, obstacles: FloatArray) -> float:
    """To what a person meets who walks on blindly, sways and swings an arm [m]; inf where there is nothing."""
    away = obstacles - np.array(pose.position)
    c, s = np.cos(pose.heading), np.sin(pose.heading)
    ahead, aside = away[:, 0] * c + away[:, 1] * s, away[:, 1] * c - away[:, 0] * s
    width = radius + SWING + np.clip(ahead, 0.0, None) * np.sin(SWAY)
    tall = (away[:, 2] > LEAST_OBSTACLE) & (away[:, 2] < BODY_HEIGHT)
    met = tall & (ahead > 0.0) & (ahead < radius + PACES[0] * BLIND) & (np.abs(aside) < width)
    return float(ahead[met].min(initial=np.inf))


def _obstacle_ahead(route: Route, progress: Progress, obstacles: FloatArray) -> float:
    """Along the path to the first new obstacle in the body's way [m]; inf where there is none."""
    rows = (route.s >= progress.s) & (route.s <= progress.s + (STOP_BEFORE + 1.0) * PACES[0])
    path = route.ground[rows]
    gap = obstacles[:, None, :] - path[None]
    over = gap[:, :, 2]
    hit = (np.hypot(gap[:, :, 0], gap[:, :, 1]) < route.radius) & (over > LEAST_OBSTACLE) & (over < BODY_HEIGHT)
    struck = hit.any(axis=0)
    return float(route.s[rows][struck][0] - progress.s) if struck.any() else float("inf")


def moves_near(pose: Pose, moving: FloatArray) -> list[Instruction]:
    """What moves near a person who walks and is not in his way: the nearest, and on which side."""
    away = moving[:, :2] - np.array(pose.position[:2])
    over = moving[:, 2] - pose.position[2]
    gap = np.where((over > 0.0) & (over < BODY_HEIGHT), np.hypot(*away.T), np.inf)
    if not len(gap) or gap.min() > MOVES_NEAR:
        return []
    x, y = away[int(gap.argmin())]
    side = side_of(float(np.arctan2(y, x)) - pose.heading)
    if side is Side.BEHIND:
        return []  # who walks leaves it
    return [Instruction(Kind.MOVING, Urgency.INFORM, distance=float(gap.min()), side=side)]


def aim(route: Route, pose: Pose, progress: Progress) -> float:
    """Direction to walk, to the left [rad]: to the place mid-corridor that is reached straight and at the best pace.

    Of equal ones the furthest, so that the course is calm.
    """
    place = np.array(pose.position[:2])
    targets = np.array([route.middle_at(min(progress.s + ahead, route.length)) for ahead in LOOK_AHEAD]) - place
    bearings = np.arctan2(targets[:, 1], targets[:, 0])
    share = np.linspace(0.0, 1.0, 9)[1:, None, None]
    straight = route.inside((place + share * targets).reshape(-1, 2), progress.s).reshape(len(share), -1).all(axis=0)
    fans = bearings[:, None] + np.array([-SWAY, 0.0, SWAY])
    reach = _clear(route, pose, progress, fans.ravel()).reshape(fans.shape).min(axis=1)
    paces = np.array([_pace_for(length) for length in reach])
    best = int(np.where(straight, paces, -1.0).argmax()) if straight.any() else len(bearings) - 1
    return wrap(float(bearings[best]) - pose.heading)


def _square(route: Route, pose: Pose, progress: Progress, direction: float) -> tuple[float, bool]:
    """At the first and the last edge of stairs, a direction that is square over it but for `SQUARE_ON`, or `SQUARE`.

    The flag says to turn there on the spot. Who is beside the line is led back to it first.
    """
    for flight in route.flights:
        ahead, aside = flight.before(*pose.position[:2])
        comes = 0.0 <= flight.start - progress.s <= LOOK_AHEAD[0] and abs(aside) <= WIDEST
        if comes and 0.0 <= ahead <= AT_EDGE:
            bent = _bent(pose, flight.enter, direction)
            if abs(aside) <= (GATE + POSE_SLACK if _is_walkable(route, pose, progress, bent) else 0.5 * GATE):
                return bent, abs(wrap(flight.enter - pose.heading)) > SQUARE
            back = (wrap(flight.enter + atan2(-aside, min(ahead - foot, 0.0)) - pose.heading) for foot in FEET[::-1])
            return next((one for one in back if _is_walkable(route, pose, progress, one)), direction), False
        for edge, facing in ((flight.start, flight.enter), (flight.end, flight.leave)):
            if abs(progress.s - edge) <= AT_EDGE and not comes:
                bent, most = (_bent(pose, facing, direction, most) for most in (SQUARE_ON, SQUARE))
                return (bent if _is_walkable(route, pose, progress, bent) else most), False
    return direction, False


def _faces_stairs(route: Route, pose: Pose, progress: Progress) -> bool:
    """Whether the stairs that begin here are ahead: who is led along their edge, back to their line, has them aside."""
    begin = (flight for flight in route.flights if 0.0 <= flight.start - progress.s <= EDGE)
    return all(side_of(flight.enter - pose.heading) is Side.AHEAD for flight in begin)


def _bent(pose: Pose, facing: float, direction: float, most: float = SQUARE_ON) -> float:
    """A direction as close to the wanted one as is `most` from square [rad]."""
    square = wrap(facing - pose.heading)
    return square + float(np.clip(wrap(direction - square), -most, most))


def _is_walkable(route: Route, pose: Pose, progress: Progress, direction: float) -> bool:
    fan = pose.heading + direction + np.array([-SWAY, 0.0, SWAY])
    return _pace_for(float(_clear(route, pose, progress, fan).min())) > 0.0


def _by_stairs(route: Route, progress: Progress) -> bool:
    """Whether an edge of stairs is so near that nobody walks in a curve."""
    edges = [edge for flight in route.flights for edge in (flight.start, flight.end)]
    return any(abs(edge - progress.s) <= NEAR_STEP for edge in edges)


def safe_pace(route: Route, pose: Pose, progress: Progress, direction: float) -> float:
    """The fastest of `PACES` at which a person who hears nothing more stops inside the corridor; 0 where none is.

    He bends from where he looks towards `direction`, and sways to either side of that.
    """
    bend = float(np.clip(direction, -ON_THE_SPOT, ON_THE_SPOT))
    fan = pose.heading + np.array([min(bend, 0.0) - SWAY, 0.5 * bend, max(bend, 0.0) + SWAY])
    return _pace_for(float(_clear(route, pose, progress, fan).min()))


def _pace_for(reach: float) -> float:
    return next((pace for pace in PACES if pace * BLIND <= reach + 1e-9), 0.0)


def _clear(route: Route, pose: Pose, progress: Progress, headings: FloatArray) -> FloatArray:
    """How far one can go straight inside the corridor [m], up to `BLIND` at full pace, shape (m,)."""
    steps = np.linspace(0.0, PACES[0] * BLIND, RAY_STEPS + 1)
    forward = np.column_stack([np.cos(headings), np.sin(headings)])
    places = np.array(pose.position[:2]) + steps[1:, None, None] * forward
    inside = route.inside(places.reshape(-1, 2), progress.s).reshape(RAY_STEPS, len(headings))
    clear: FloatArray = steps[np.logical_and.accumulate(inside).sum(axis=0)]
    return clear


def _careful_pace(route: Route, progress: Progress) -> float:
    """The fastest of `PACES` before steps, over ground that nobody saw, and before the goal."""
    left = route.length - progress.s
    goal = min((pace for near, pace in NEAR_GOAL if left <= near), default=PACES[0])
    near = any(f.kind in CAREFUL and f.start - NEAR_STEP <= progress.s <= f.end for f in route.features)
    return min(goal, PACES[1] if near else PACES[0])

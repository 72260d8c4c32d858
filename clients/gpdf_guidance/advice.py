"""What a person should do and know at a place on a route: a pure function of route, pose and time.

One rule carries the safety: a person may go only as fast as lets him come to rest inside the corridor should no pose
ever come again. So a lost pose, a late reaction and a bent course have all been paid for before they happen.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, radians

import numpy as np
from gpdf_schemas import CueAction
from numpy.typing import NDArray

from gpdf_guidance.ahead import ARRIVED, ON_THE_SPOT, find_ahead, find_turning
from gpdf_guidance.corridor import WIDEST
from gpdf_guidance.features import FeatureKind, wrap
from gpdf_guidance.instruction import Instruction, Kind, Urgency
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
STOP_BEFORE = 2.0
"""[m] An obstacle that is new on the path stops from here: BLIND at full pace, and as much again."""
BODY_HEIGHT = 2.0
"""[m] Of a person with a hat."""
LEAST_OBSTACLE = 0.05
"""[m] What is lower is no obstacle to a foot."""


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


def advise(route: Route, pose: Pose, now: float, *, near: float, obstacles: FloatArray | None = None) -> Advice:
    """Advise a person.

    Args:
        route: Where to go.
        pose: The newest pose.
        now: On the clock of the pose's stamp [s].
        near: Arc length of the last progress [m].
        obstacles: New things that the service does not know yet, shape (k, 3) [m].
    """
    if (reason := distrust(pose, now)) is not None:
        return stop(Progress(near, 0.0), reason)
    progress = route.locate(pose, near)
    if abs(pose.position[2] - route.at(progress.s)[2]) > STOREY:
        return stop(progress, Instruction(Kind.STOP_UNRELIABLE, Urgency.DANGER))
    left = route.length - progress.s
    place = np.array(pose.position[:2])
    if left < ARRIVED and np.hypot(*(route.ground[-1, :2] - place)) < ARRIVED:
        done = Instruction(Kind.ARRIVED, Urgency.DANGER)  # it ends whatever is being said
        return Advice(progress, CueAction.ARRIVED, instructions=(done,))
    if obstacles is not None and (gap := _obstacle_ahead(route, progress, obstacles)) < STOP_BEFORE:
        return stop(progress, Instruction(Kind.STOP_OBSTACLE, Urgency.DANGER, distance=gap))
    if not route.inside(place[None], progress.s, POSE_SLACK)[0]:
        off = Instruction(Kind.STOP_OFF_WAY, Urgency.DANGER)
        return stop(progress, off, off_way=True)
    direction, askew = _square(route, pose, progress, aim(route, pose, progress))
    pace = min(safe_pace(route, pose, progress, direction), _pace_before_steps(route, progress))
    action = _action(direction, 0.0 if askew else pace, SQUARE if _by_stairs(route, progress) else ON_THE_SPOT)
    ahead, turns = find_ahead(route, progress), action is CueAction.TURN
    ahead = [one for one in ahead if one.leaves_stairs or not turns]  # who turns does not know yet where "ahead" is
    said = find_turning(route, progress, direction, action) + ahead
    urgency = min(1.0, abs(direction) / ON_THE_SPOT)
    pace = 0.0 if action is CueAction.TURN else pace
    return Advice(progress, action, direction, pace, urgency, instructions=tuple(sorted(said, key=_first)))


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


def _action(direction: float, pace: float, on_the_spot: float) -> CueAction:
    if abs(direction) >= on_the_spot or pace == 0.0:
        return CueAction.TURN if abs(direction) > FACING else CueAction.STOP
    return CueAction.GO if pace == PACES[0] else CueAction.SLOW


def _obstacle_ahead(route: Route, progress: Progress, obstacles: FloatArray) -> float:
    """Along the path to the first new obstacle in the body's way [m]; inf where there is none."""
    rows = (route.s >= progress.s) & (route.s <= progress.s + STOP_BEFORE + PACES[0])
    path = route.ground[rows]
    gap = obstacles[:, None, :] - path[None]
    over = gap[:, :, 2]
    hit = (np.hypot(gap[:, :, 0], gap[:, :, 1]) < route.radius) & (over > LEAST_OBSTACLE) & (over < BODY_HEIGHT)
    struck = hit.any(axis=0)
    return float(route.s[rows][struck][0] - progress.s) if struck.any() else float("inf")


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
            if abs(aside) <= (GATE if _is_walkable(route, pose, progress, bent) else 0.5 * GATE):
                return bent, abs(wrap(flight.enter - pose.heading)) > SQUARE
            back = (wrap(flight.enter + atan2(-aside, min(ahead - foot, 0.0)) - pose.heading) for foot in FEET[::-1])
            return next((one for one in back if _is_walkable(route, pose, progress, one)), direction), False
        for edge, facing in ((flight.start, flight.enter), (flight.end, flight.leave)):
            if abs(progress.s - edge) <= AT_EDGE and not comes:
                bent, most = (_bent(pose, facing, direction, most) for most in (SQUARE_ON, SQUARE))
                return (bent if _is_walkable(route, pose, progress, bent) else most), False
    return direction, False


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


def _pace_before_steps(route: Route, progress: Progress) -> float:
    near = any(
        f.kind in (FeatureKind.STEP, FeatureKind.STAIRS) and f.start - NEAR_STEP <= progress.s <= f.end
        for f in route.features
    )
    return PACES[1] if near else PACES[0]

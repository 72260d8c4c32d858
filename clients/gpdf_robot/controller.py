"""Regulated pure pursuit, Macenski et al. 2023: chase a place ahead on the line, slower in bends and near obstacles.

A pure function of line, pose and speed. The differential drive turns along the arc through the place ahead; the
omnidirectional one moves along the line's direction, and back to the line within the same length, and turns into the
line's direction meanwhile.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, cos, hypot, sin

import numpy as np

from gpdf_robot.bodies import Body
from gpdf_robot.motion import Pose, Velocity, wrap
from gpdf_robot.route import Route

LOOK_AHEAD_S = 0.4
"""[s] The place ahead is where the line is after this at the present speed: three times the delay of a small robot."""
LOOK_AHEAD_M = (0.15, 0.6)
"""[m] But never nearer or further: nearer swings with the noise of 1 cm, further cuts corners."""
BEND_S = 1.5
"""[s] A bend whose radius is shorter than the way of this at cruising speed is taken slower, in proportion."""
PROXIMITY = 0.2
"""[m] With less room than this beside the body it goes slower, in proportion."""
SLOWEST = 0.25
"""[-] Share of the cruising speed below which bends and proximity do not slow: a robot that stands gets nowhere."""
APPROACH_S = 1.0
"""[s] The last part of the way is driven at what is left of it over this."""
CREEP = 0.04
"""[m/s] The slowest approach: wheels do not turn below."""
TURN_FIRST = 0.8
"""[rad] It turns on the spot when the place ahead (the line, if omnidirectional) is further aside (Nav2: 0.785)…"""
TURN_UNTIL = 0.1
"""[rad] …and, once it stands, until it is nearer than this: it leaves along the line, not in a swing beside it."""
STANDS = 0.03
"""[m/s] It stands below this."""
TURN_GAIN = 2.0
"""[1/s] Yaw rate for each radian of turning on the spot: settles in half a second, slower than twice the delay."""


@dataclass(frozen=True, slots=True)
class Pursuit:
    """What to do now, and where on the line that is.

    Attributes:
        velocity: To command.
        along: Arc length of the nearest place on the line [m].
        offset: Distance from the line [m].
    """

    velocity: Velocity
    along: float
    offset: float


def pursue(route: Route, pose: Pose, near: float | None, speed: float, body: Body, room: float) -> Pursuit:
    """One step of the controller.

    Args:
        route: The line to follow.
        pose: Where the robot is.
        near: Arc length where it was last [m]; none at the start of a line.
        speed: At which it moves [m/s].
        body: Its limits.
        room: Least room beside the body a little ahead [m].
    """
    along, offset = route.nearest(pose.xy, near)
    look_ahead = float(np.clip(LOOK_AHEAD_S * speed, *LOOK_AHEAD_M))
    line = route.heading(along)
    carrot = route.at(np.array([along + look_ahead]))[0, :2]
    if (
        body.omnidirectional
    ):  # moving straight at a place on a bend would cut it by half its curvature times look_ahead²
        carrot = route.at(np.array([along]))[0, :2] + look_ahead * np.array([cos(line), sin(line)])
    dx, dy = (carrot - pose.xy).tolist()
    bearing = wrap(atan2(dy, dx) - pose.heading)
    aside = wrap(line - pose.heading) if body.omnidirectional else bearing
    turn = float(np.clip(TURN_GAIN * aside, -body.turn_rate, body.turn_rate))
    if abs(aside) > (TURN_UNTIL if speed < STANDS else TURN_FIRST):
        return Pursuit(Velocity(turn=turn), along, offset)
    if body.omnidirectional:
        bend = wrap(route.heading(along + look_ahead) - line) / look_ahead
        wanted = regulated(body.speed, bend, room, route.length - along, body)
        return Pursuit(Velocity(wanted * cos(bearing), wanted * sin(bearing), turn), along, offset)
    curvature = 2.0 * sin(bearing) / max(hypot(dx, dy), 1e-3)
    wanted = regulated(body.speed, curvature, room, route.length - along, body)
    wanted = min(wanted, body.turn_rate / max(abs(curvature), 1e-9))
    return Pursuit(Velocity(forward=wanted, turn=wanted * curvature), along, offset)


def regulated(speed: float, curvature: float, room: float, remaining: float, body: Body) -> float:
    """The speed [m/s] that bends, obstacles beside the way and the end of the way leave of the cruising speed."""
    bend = 1.0 / max(abs(curvature), 1e-9) / (BEND_S * body.speed)
    share = max(SLOWEST, min(1.0, bend, room / PROXIMITY))
    return max(CREEP, min(speed * share, remaining / APPROACH_S))

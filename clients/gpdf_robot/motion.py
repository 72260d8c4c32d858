"""Poses and velocities in the plane."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, hypot, pi, sin

import numpy as np
from gpdf_client.trajectory import FloatArray


@dataclass(frozen=True, slots=True)
class Pose:
    """Where a robot is.

    Attributes:
        x: In the scene's frame [m].
        y: The same.
        heading: Counter-clockwise from +x [rad].
        stamp: When that was measured [s].
        accuracy: One standard deviation of the place [m].
    """

    x: float
    y: float
    heading: float
    stamp: float = 0.0
    accuracy: float = 0.0

    @property
    def xy(self) -> FloatArray:
        """Place in plan [m], shape (2,)."""
        return np.array([self.x, self.y])


@dataclass(frozen=True, slots=True)
class Velocity:
    """A velocity in the robot's own frame: forward, left [m/s], turning counter-clockwise [rad/s]."""

    forward: float = 0.0
    left: float = 0.0
    turn: float = 0.0

    @property
    def speed(self) -> float:
        """Along the ground [m/s]."""
        return hypot(self.forward, self.left)


STOP = Velocity()


def wrap(angle: float) -> float:
    """The same angle between -π and π."""
    return (angle + pi) % (2 * pi) - pi


def advance(pose: Pose, velocity: Velocity, seconds: float) -> Pose:
    """Where a robot is after moving at a constant velocity: an arc, exp of the twist."""
    angle = velocity.turn * seconds
    # sin(a)/a and (1 - cos(a))/a, by their series where the quotient loses its digits
    along, across = (1.0, 0.5 * angle) if abs(angle) < 1e-6 else (sin(angle) / angle, (1 - cos(angle)) / angle)
    dx = (along * velocity.forward - across * velocity.left) * seconds
    dy = (across * velocity.forward + along * velocity.left) * seconds
    c, s = cos(pose.heading), sin(pose.heading)
    x, y = pose.x + c * dx - s * dy, pose.y + s * dx + c * dy
    return Pose(x, y, wrap(pose.heading + angle), pose.stamp + seconds, pose.accuracy)


def toward(now: Velocity, wanted: Velocity, acceleration: float, turn_acceleration: float, seconds: float) -> Velocity:
    """The velocity after `seconds` of getting from one velocity to another as fast as accelerations allow."""
    step = np.array([wanted.forward - now.forward, wanted.left - now.left])
    share = min(1.0, acceleration * seconds / max(float(np.hypot(*step)), 1e-12))
    turn = float(np.clip(wanted.turn - now.turn, -turn_acceleration * seconds, turn_acceleration * seconds))
    return Velocity(now.forward + share * float(step[0]), now.left + share * float(step[1]), now.turn + turn)

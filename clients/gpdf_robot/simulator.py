"""A simulated robot: limited acceleration, slipping wheels, late commands, late and noisy poses."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import hypot

import numpy as np

from gpdf_robot.bodies import Body
from gpdf_robot.motion import STOP, Pose, Velocity, advance, toward

TURN_ACCELERATION_S = 0.2
"""[s] From standing to the highest yaw rate."""


@dataclass(frozen=True, slots=True)
class Errors:
    """What a simulated robot does wrong.

    Attributes:
        position: Standard deviation of a measured coordinate [m].
        bias: Standard deviation of a coordinate's error that stays for life: the map's, the sensor's mounting [m].
        heading: The same of the heading [rad].
        slip: Standard deviation of the share that a robot's wheels run fast or slow, each axis for itself, for life.
        command_s: From a command to its effect [s].
        pose_s: Age of a pose when it arrives [s].
    """

    position: float = 0.01
    bias: float = 0.01
    heading: float = 0.01
    slip: float = 0.03
    command_s: float = 0.1
    pose_s: float = 0.05


class SimulatedRobot:
    """One robot in the plane.

    Args:
        body: Its limits.
        pose: Where it is at first; its stamp is the time.
        errors: What it does wrong.
        rng: Source of the errors.

    Attributes:
        pose: Where it truly is.
        velocity: How it truly moves.
        track: All its true places in plan.
    """

    def __init__(self, body: Body, pose: Pose, errors: Errors, rng: np.random.Generator) -> None:
        self.body, self.pose, self.errors, self.velocity = body, pose, errors, STOP
        self.track = [(pose.x, pose.y)]
        self._rng, self._slip = rng, 1.0 + errors.slip * rng.normal(size=3)
        self._bias = np.append(errors.bias * rng.normal(size=2), 0.0)
        self._commands: deque[tuple[float, Velocity]] = deque()
        self._command = STOP
        self._poses: deque[Pose] = deque([pose])

    def command(self, velocity: Velocity) -> None:
        """Take a command; it has its effect later."""
        self._commands.append((self.pose.stamp + self.errors.command_s, velocity))

    def move(self, seconds: float) -> None:
        """Let time pass."""
        while self._commands and self._commands[0][0] <= self.pose.stamp + 1e-9:
            self._command = self._commands.popleft()[1]
        limits = self.body.acceleration, self.body.turn_rate / TURN_ACCELERATION_S
        self.velocity = toward(self.velocity, self._command, *limits, seconds)
        fast = (self.velocity.forward, self.velocity.left, self.velocity.turn) * self._slip
        self.pose = advance(self.pose, Velocity(*map(float, fast)), seconds)
        self.track.append((self.pose.x, self.pose.y))
        self._poses.append(self.pose)
        while len(self._poses) > 1 and self._poses[1].stamp <= self.pose.stamp - self.errors.pose_s + 1e-9:
            self._poses.popleft()

    def measure(self) -> Pose:
        """The newest pose that has arrived, with noise."""
        true = self._poses[0]
        noise = self._rng.normal(size=3) * (self.errors.position, self.errors.position, self.errors.heading)
        x, y, heading = np.array([true.x, true.y, true.heading]) + self._bias + noise
        accuracy = hypot(self.errors.position, self.errors.bias)
        return Pose(float(x), float(y), float(heading), true.stamp, accuracy)

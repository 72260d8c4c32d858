"""The driver: asks the service for a route, follows it, looks ahead with the service's distances, stops, asks again.

It takes poses and gives velocities; where they come from and go to is not its business, nor is the clock.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from gpdf_client import Client, ClientError, Status, Trajectory
from gpdf_client.trajectory import FloatArray

from gpdf_robot.bodies import Body
from gpdf_robot.controller import pursue
from gpdf_robot.motion import STOP, Pose, Velocity, advance, toward
from gpdf_robot.route import Route

MARGINS = (0.06, 0.03)
"""[m] Routes are planned for a body wider by this on every side: the error of following and two standard deviations of
the pose. The second where the first has no route; never less, so that a route through a narrower gap is refused."""
KEEP = 0.01
"""[m] Room that the robot stops before it loses: the error of the Obstacle GPDF against the points. Where its place is
known less well than that, one standard deviation of it."""
DELAY_S = 0.1
"""[s] From a command to its effect: what small robots' bases and buses have. The driver thinks ahead by it."""
REACTION_S = 0.15
"""[s] More than that until it brakes, at worst: the rest of this period, all of the next, and the service's answer."""
AHEAD_M = 1.5
"""[m] Of the line that is checked ahead: the stopping distance of the fastest body, 0.75 m, twice."""
CHECK_M = 0.05
"""[m] Between places that are checked; a body's radius is three times that."""
DISTANCE_DEADLINE_S = 0.2
"""[s] For the service to answer about distances; later than that the robot stops."""
TURN_ACCELERATION_S = 0.3
"""[s] From standing to the highest yaw rate."""
POSE_OLD_S = 0.5
"""[s] A pose older than this is none: stop."""
LOST_M = 0.3
"""[m] Further from the line than this a new one is asked for."""
ARRIVED_M = 0.04
"""[m] Left of the line at arrival: the noise of a pose and the way of stopping."""
RETRY_S = 2.0
"""[s] Between requests for a route while there is none."""
REPLAN_S = 0.5
"""[s] Between a route and a request for the next."""
BLOCKED_S = 1.0
"""[s] Without progress, for want of room, after which a route from where it is now is asked for."""
GIVE_UP_S = 20.0
"""[s] Without a centimetre of progress after which the robot stays where it is and says why."""
PROGRESS_M = 0.01
"""[m] Of the line that count as progress; a turn on the spot counts too."""


class State(StrEnum):
    """What the driver does."""

    PLANNING = "planning"
    DRIVING = "driving"
    BLOCKED = "blocked"
    BLIND = "blind"
    ARRIVED = "arrived"
    GAVE_UP = "gave up"


ENDS = (State.ARRIVED, State.GAVE_UP)


@dataclass(frozen=True, slots=True)
class Look:
    """What the service says of the places ahead.

    Attributes:
        here: Room beside the body where it is [m].
        arc: Least room until it stands if it now did what it wants to do [m].
        line: Room along the line ahead, from its nearest place on [m], shape (k,).
        keep: Room that it may not lose [m].
        version: Of the scene that answered.
    """

    here: float
    arc: float
    line: FloatArray
    keep: float
    version: int


class Driver:
    """Drives one robot to one goal. Call `step` for each new pose, and do what it says.

    Args:
        client: Connection to the service.
        scene: Name of the scene.
        goal: (x, y), or (x, y, z of the ground there) [m].
        body: The robot's.
        margins: Room for the error of following, the first that has a route [m].
        delay_s: From a command to its effect [s].

    Attributes:
        state: What it does.
        reason: Why, in words.
        trajectory: What it follows.
        plans: How many routes it has had.
        offset: Distance from the line at the last step [m].
    """

    def __init__(
        self,
        client: Client,
        scene: str,
        goal: Sequence[float],
        body: Body,
        *,
        margins: Sequence[float] = MARGINS,
        delay_s: float = DELAY_S,
    ) -> None:
        self.delay_s = delay_s
        self.client, self.scene, self.goal, self.body, self.margins = client, scene, tuple(goal), body, tuple(margins)
        self.state, self.reason, self.offset, self.plans = State.PLANNING, "", 0.0, 0
        self.trajectory: Trajectory | None = None
        self._route: Route | None = None
        self._agent = body.agent(self.margins[0])
        self._along, self._best, self._version, self._room = 0.0, -np.inf, 0, np.inf
        self._command = STOP
        self._stepped: float | None = None
        self._moved_at = self._asked_at = -np.inf
        self._wait_s = 0.0

    def step(self, pose: Pose | None, now: float, start_z: float | None = None) -> Velocity:
        """What to do now.

        Args:
            pose: The last one that was measured, if any was.
            now: Present time on the clock of its stamp [s].
            start_z: Height of the ground under the robot, which tells its storey before there is a route [m].
        """
        seconds = 0.0 if self._stepped is None else now - self._stepped
        if self._stepped is None:
            self._moved_at = now
        self._stepped = now
        self._command = self._decide(pose, now, seconds, start_z)
        return self._command

    def _decide(self, pose: Pose | None, now: float, seconds: float, start_z: float | None) -> Velocity:
        if self.state in ENDS:
            return STOP
        if now - self._moved_at > GIVE_UP_S:
            return self._stop(State.GAVE_UP, self.reason or f"no progress in {GIVE_UP_S:.0f} s")
        if pose is None:
            return self._stop(State.BLIND, "no pose has come")
        if not abs(now - pose.stamp) <= POSE_OLD_S:
            return self._stop(State.BLIND, f"the pose is {now - pose.stamp:.2f} s old")
        if 2.0 * pose.accuracy > self.margins[0]:
            return self._stop(State.BLIND, f"the place is known to {pose.accuracy:.2f} m only")
        if self._route is None:
            if now - self._asked_at >= self._wait_s:
                self._plan(pose, now, start_z)
            return STOP
        return self._follow(
            self._route, advance(pose, self._command, max(0.0, now - pose.stamp) + self.delay_s), now, seconds
        )

    def _follow(self, route: Route, pose: Pose, now: float, seconds: float) -> Velocity:
        pursuit = pursue(route, pose, self._along, self._command.speed, self.body, self._room)
        self._along, self.offset = pursuit.along, pursuit.offset
        if route.length - self._along <= ARRIVED_M:
            return self._stop(State.ARRIVED, "")
        if self._along > self._best + PROGRESS_M or abs(self._command.turn) > 0.1 * self.body.turn_rate:
            self._best, self._moved_at = max(self._best, self._along), now
        if self.offset > LOST_M:
            return self._forget(f"the robot is {self.offset:.2f} m beside its route")
        wanted = toward(
            self._command,
            pursuit.velocity,
            self.body.acceleration,
            self.body.turn_rate / TURN_ACCELERATION_S,
            seconds,
        )
        try:
            look = self._look(route, pose, wanted)
        except ClientError as error:
            return self._stop(State.BLIND, f"no distances: {error}")
        return self._allowed(look, wanted, now)

    def _allowed(self, look: Look, wanted: Velocity, now: float) -> Velocity:
        """What of the wanted velocity the places ahead allow."""
        near = max(1, round(self._reach(wanted) / CHECK_M))
        self._room = max(0.0, float(look.line[: 2 * near + 1].min()))
        if look.version != self._version:
            return self._forget("the scene has changed")
        if (look.line < -KEEP).any():  # what the plan had as free is not
            return self._forget("something stands on the route")
        if look.arc < min(look.keep, look.here - 1e-3) and wanted.speed > 0.0:
            if now - max(self._moved_at, self._asked_at) > BLOCKED_S:
                return self._forget("it cannot go on along its route")
            return self._stop(State.BLOCKED, f"only {look.arc:.3f} m of room ahead")
        self.state, self.reason = State.DRIVING, ""
        return wanted

    def _look(self, route: Route, pose: Pose, wanted: Velocity) -> Look:
        """Room on the way until it stands, and along the line ahead; one request."""
        ahead = np.arange(self._along, min(self._along + AHEAD_M, route.length) + CHECK_M, CHECK_M)
        line = route.at(ahead)
        arc = self._until_standing(pose, wanted)
        height = float(line[0, 2])
        places = np.vstack([np.column_stack([arc, np.full(len(arc), height)]), line])
        found = self.client.distance(self.scene, "obstacle", places, self._agent, deadline_s=DISTANCE_DEADLINE_S)
        room = np.where(found.valid, found.distance, 0.0) - self.body.radius
        keep = max(KEEP, pose.accuracy)
        return Look(float(room[0]), float(room[: len(arc)].min()), room[len(arc) :], keep, found.scene_version)

    def _reach(self, velocity: Velocity) -> float:
        """Way until it stands [m]."""
        return velocity.speed * (self.delay_s + REACTION_S) + velocity.speed**2 / (2 * self.body.acceleration)

    def _until_standing(self, pose: Pose, velocity: Velocity) -> FloatArray:
        """Places from the present one to where it stands if it brakes after its reaction, (k, 2) [m]."""
        seconds = self.delay_s + REACTION_S + velocity.speed / (2 * self.body.acceleration)
        count = max(2, 1 + round(self._reach(velocity) / CHECK_M))
        return np.array([advance(pose, velocity, t).xy for t in np.linspace(0.0, seconds, count)])

    def _plan(self, pose: Pose, now: float, start_z: float | None) -> None:
        """Ask for a route for the widest body that has one."""
        start = [pose.x, pose.y]
        if self.trajectory is not None:
            nearest = np.hypot(*(self.trajectory.ground[:, :2] - pose.xy).T).argmin()
            start_z = float(self.trajectory.ground[nearest, 2])
        if start_z is not None:
            start.append(start_z)
        self._asked_at, self._wait_s, self.state = now, RETRY_S, State.PLANNING
        for margin in self.margins:
            agent = self.body.agent(margin)
            try:
                result = self.client.plan(self.scene, start, self.goal, agent)
            except ClientError as error:
                self.reason = str(error)
                return
            self.reason = f"{result.status}: {result.message}"
            if result.status is Status.OK and result.trajectory is not None:
                self._agent, self._version, self.plans = agent, result.scene_version, self.plans + 1
                self.trajectory, self._route = result.trajectory, Route(result.trajectory)
                self._along, self._best, self._room = 0.0, -np.inf, np.inf
                self.state, self.reason = State.DRIVING, ""
                return

    def _stop(self, state: State, reason: str) -> Velocity:
        self.state, self.reason = state, reason
        return STOP

    def _forget(self, reason: str) -> Velocity:
        """Stop, and ask for another route at the next step."""
        self._route, self._wait_s = None, REPLAN_S
        return self._stop(State.PLANNING, reason)

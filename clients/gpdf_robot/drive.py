"""A drive in simulated time: driver and simulated robot in step, as fast as the service answers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from gpdf_client import Trajectory
from gpdf_client.trajectory import FloatArray

from gpdf_robot.driver import ENDS, Driver, State
from gpdf_robot.motion import Velocity
from gpdf_robot.route import Route
from gpdf_robot.simulator import SimulatedRobot

PERIOD_S = 0.05
"""[s] Between commands: 20 Hz, as Nav2's controller server."""
SUBSTEPS = 5
"""Steps of the robot's motion in one period: 10 ms, 1 cm at 1 m/s."""
SETTLE_S = 1.5
"""[s] That the robot has to come to a stand after the end: from 1 m/s at 1 m/s², with its delay."""


@dataclass(frozen=True, slots=True)
class Drive:
    """How a drive went.

    Attributes:
        state: `ARRIVED`, or `GAVE_UP` where it stopped for good.
        reason: Why it gave up.
        seconds: Of simulated time.
        plans: Routes that it has had.
        track: True places in plan every 10 ms (n, 2) [m].
        offsets: True distance from the line that was followed, where one was, at each period (k,) [m].
        stops: Times that it had to stop before the goal.
        planned: The trajectories that it followed, in order.
    """

    state: State
    reason: str
    seconds: float
    plans: int
    track: FloatArray
    offsets: FloatArray
    stops: int
    planned: tuple[Trajectory, ...]

    @property
    def error_p95(self) -> float:
        """95 % of the way it was nearer to the line than this [m]; NaN without a line."""
        return float(np.quantile(self.offsets, 0.95)) if len(self.offsets) else float("nan")


def simulate(
    driver: Driver,
    robot: SimulatedRobot,
    *,
    start_z: float | None = None,
    limit_s: float = 600.0,
    on_step: Callable[[SimulatedRobot, Velocity], None] = lambda robot, command: None,
) -> Drive:
    """Drive until the driver arrives or gives up, or `limit_s` of simulated time have passed."""
    began, offsets, stops, planned, before = robot.pose.stamp, [], 0, list[Trajectory](), State.PLANNING
    route: Route | None = None
    while driver.state not in ENDS and robot.pose.stamp - began < limit_s:
        command = driver.step(robot.measure(), robot.pose.stamp, start_z)
        robot.command(command)
        on_step(robot, command)
        if driver.trajectory is not None and (not planned or planned[-1] is not driver.trajectory):
            planned.append(driver.trajectory)
            route = Route(driver.trajectory)
        if route is not None:
            offsets.append(route.nearest(robot.pose.xy)[1])
        stops += before is State.DRIVING and driver.state not in (State.DRIVING, State.ARRIVED)
        before = driver.state
        for _ in range(SUBSTEPS):
            robot.move(PERIOD_S / SUBSTEPS)
    seconds = robot.pose.stamp - began
    for _ in range(round(SETTLE_S / PERIOD_S) * SUBSTEPS):
        robot.move(PERIOD_S / SUBSTEPS)
    reason = driver.reason if driver.state in ENDS else f"not there after {limit_s:.0f} s"
    state = driver.state if driver.state in ENDS else State.GAVE_UP
    return Drive(
        state,
        reason,
        seconds,
        driver.plans,
        np.array(robot.track),
        np.array(offsets),
        stops,
        tuple(planned),
    )

"""A drive in real time: poses come and velocities go over Zenoh."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import zenoh
from gpdf_schemas import DecodeError, PoseMessage, VelocityMessage, decode, encode, keys

from gpdf_robot.drive import PERIOD_S
from gpdf_robot.driver import ENDS, Driver
from gpdf_robot.motion import STOP, Pose, Velocity

LAST_STOPS = 3
"""Stop commands at the end: one could be the one that is lost."""


class Poses:
    """The newest pose of a body, as it comes over Zenoh. A context manager.

    Args:
        session: To listen on.
        name: Of the body.
    """

    def __init__(self, session: zenoh.Session, name: str) -> None:
        self._newest: tuple[Pose, float] | None = None
        self._subscriber = session.declare_subscriber(f"{keys.POSE}/{name}", self._take)

    def __enter__(self) -> Poses:
        return self

    def __exit__(self, *_: object) -> None:
        self._subscriber.undeclare()  # type: ignore[no-untyped-call]

    @property
    def newest(self) -> tuple[Pose, float] | None:
        """The pose and the height of the ground under it [m]; none before the first."""
        return self._newest

    def _take(self, sample: zenoh.Sample) -> None:
        try:
            message = decode(sample.payload.to_bytes(), PoseMessage)
            x, y, z = message.position
        except (DecodeError, ValueError):
            return  # what cannot be read is no pose: the last one grows old, and the driver stops
        if self._newest is None or message.stamp >= self._newest[0].stamp:
            self._newest = Pose(x, y, message.heading, message.stamp, message.accuracy), z


def velocity_message(velocity: Velocity, stamp: float, state: str) -> VelocityMessage:
    """A velocity as it goes over Zenoh."""
    return VelocityMessage(forward=velocity.forward, left=velocity.left, turn=velocity.turn, stamp=stamp, state=state)


def drive_live(
    driver: Driver,
    session: zenoh.Session,
    name: str,
    *,
    stop: threading.Event | None = None,
    on_step: Callable[[Driver], None] = lambda driver: None,
) -> None:
    """Drive until the driver arrives or gives up, or `stop` is set; the last command is to stand.

    Args:
        driver: Where to go, and how.
        session: To listen and to speak on.
        name: Of the body, in the keys of poses and velocities.
        stop: Set by another thread to end the drive.
        on_step: Told after each command.
    """
    stop = stop or threading.Event()
    publisher = session.declare_publisher(f"{keys.VELOCITY}/{name}")

    def send(velocity: Velocity) -> None:
        publisher.put(encode(velocity_message(velocity, time.time(), driver.state.value)))

    try:
        with Poses(session, name) as poses:
            while driver.state not in ENDS:
                due = time.monotonic() + PERIOD_S
                pose, z = poses.newest or (None, None)
                send(driver.step(pose, time.time(), z))
                on_step(driver)
                if stop.wait(max(0.0, due - time.monotonic())):
                    return
    finally:
        for _ in range(LAST_STOPS):
            send(STOP)
        publisher.undeclare()  # type: ignore[no-untyped-call]

"""Guidance over Zenoh: poses and obstacles come in, cues go out, sentences are spoken."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from math import nan
from typing import Any

import msgspec
import numpy as np
import zenoh
from gpdf_schemas import CueMessage, DecodeError, MovingObstacles, PoseMessage, decode, encode, keys
from gpdf_schemas.moving import MAX_POINTS, points_of, stacked
from numpy.typing import NDArray

from gpdf_guidance.guide import Guide, Outcome
from gpdf_guidance.instruction import Instruction
from gpdf_guidance.route import Pose, Route

CUE_PERIOD = 0.1
"""[s] A cue goes out at least this often: twice the 5 Hz that a device needs."""
PULSE_EVERY = 0.25
"""[s] Between an answer of the planner and the next question whether it is there."""
WAITING = 64
"""Messages that may wait; the guide looks at the newest pose of them only."""
NO_POSE = Pose((nan, nan, nan), nan, nan)
Told = Callable[[float, Instruction, str], None]
"""Told each sentence: seconds since the start, the instruction, its words."""
Seen = dict[str, tuple[NDArray[np.float64], float]]
"""Points [m] and when they are not believed any more, on `time.monotonic` [s], by the obstacle's id."""
Planned = tuple[Route | None, str]


class LiveGuide:
    """Feeds one `Guide` from the streams of one person.

    Args:
        session: Where the streams are.
        guide: Whom to ask.
        name: Of the person, the last part of the streams' keys.
        told: Told each sentence.
    """

    def __init__(self, session: zenoh.Session, guide: Guide, name: str, told: Told) -> None:
        self._session, self._guide, self._name, self._told = session, guide, name, told
        self._inbox: queue.Queue[Pose | Seen] = queue.Queue(WAITING)
        self._pose: Pose | None = None
        self._stamp = 0.0
        self._seen: Seen = {}
        self._planning: tuple[Future[Planned], Pose] | None = None
        self._pulse: Future[int | None] | None = None
        self._pulse_at = -float("inf")

    def run(self, stop: Callable[[], bool] = lambda: False) -> Outcome:
        """Guide until arrival, a safe stop, or `stop`; the last cue is sent in any case."""
        began = time.monotonic()
        pose_key, obstacle_key = f"{keys.POSE}/{self._name}", keys.obstacles(self._guide.planner.scene)
        subscribers = [
            self._session.declare_subscriber(pose_key, self._take_pose),
            self._session.declare_subscriber(obstacle_key, self._take_obstacles),
        ]
        publisher = self._session.declare_publisher(f"{keys.CUE}/{self._name}")
        with ThreadPoolExecutor(2, thread_name_prefix="gpdf-guide") as pool:
            while not stop() and self._guide.outcome is Outcome.WALKING:
                self._listen()
                now = time.monotonic()
                self._seen = {id_: seen for id_, seen in self._seen.items() if seen[1] > now}
                near = stacked([points for points, _ in self._seen.values()])
                self._guide.see(near if len(near) else None)
                self._guide.felt = publisher.matching_status.matching  # type: ignore[attr-defined] # its stub says bool
                self._feel_pulse(pool, now)
                cue, said = self._guide.step(self._pose, now)
                publisher.put(encode(self._stamped(cue)))
                if said is not None:
                    self._told(now - began, *said)
                self._plan(pool, now)
        cue, said = self._guide.step(self._pose, time.monotonic())
        publisher.put(encode(self._stamped(cue)))
        if said is not None:
            self._told(time.monotonic() - began, *said)
        for subscriber in subscribers:
            subscriber.undeclare()  # type: ignore[no-untyped-call]
        publisher.undeclare()  # type: ignore[no-untyped-call]
        return self._guide.outcome

    def _listen(self) -> None:
        """Wait for a message, at most until the next cue is due; take all that wait."""
        until = time.monotonic() + CUE_PERIOD
        while True:
            try:
                message = self._inbox.get(timeout=max(0.0, until - time.monotonic()))
            except queue.Empty:
                return
            if isinstance(message, Pose):
                self._pose = message
            else:
                self._seen |= message
            until = 0.0

    def _plan(self, pool: ThreadPoolExecutor, now: float) -> None:
        """Ask for a route beside the stream of cues, and take it when it is there."""
        if self._planning is not None and self._planning[0].done():
            future, pose = self._planning
            self._planning = None
            self._guide.take(*future.result(), pose)
        elif self._planning is None and self._guide.wants_route(self._pose, now) and self._pose is not None:
            self._planning = pool.submit(self._guide.planner.route, self._pose, self._guide.goal), self._pose

    def _feel_pulse(self, pool: ThreadPoolExecutor, now: float) -> None:
        """Whether there still is a planner, and in which version of the scene it plans."""
        if self._pulse is not None and self._pulse.done():
            self._guide.hear(self._pulse.result())
            self._pulse, self._pulse_at = None, now
        if self._pulse is None and now - self._pulse_at >= PULSE_EVERY:
            self._pulse = pool.submit(self._guide.planner.pulse)

    def _stamped(self, cue: CueMessage) -> CueMessage:
        return msgspec.structs.replace(cue, stamp=time.time(), pose_stamp=self._stamp)

    def _take_pose(self, sample: zenoh.Sample) -> None:
        """Zenoh's callback. A pose of a clock that is ahead is as old as its way; of one that is behind, older.

        What is no pose, and one of a clock that went back, goes on as one without numbers, for which the guide stops.
        """
        try:
            message = decode(sample.payload.to_bytes(), PoseMessage)
            x, y, z = message.position
            if message.stamp < self._stamp:
                raise ValueError("time goes back")
        except (DecodeError, ValueError):
            self._put(NO_POSE)
            return
        self._stamp = message.stamp
        stamp = time.monotonic() - max(0.0, time.time() - message.stamp)
        self._put(Pose((x, y, z), message.heading, stamp, message.accuracy))

    def _take_obstacles(self, sample: zenoh.Sample) -> None:
        """Zenoh's callback: what moves in the scene. One that has no sense does not hide the others."""
        seen: Seen = {}
        room = MAX_POINTS
        with suppress(DecodeError):
            for obstacle in decode(sample.payload.to_bytes(), MovingObstacles).obstacles:
                with suppress(ValueError):
                    points = points_of(obstacle, room)
                    seen[obstacle.id] = points, time.monotonic() + obstacle.lifetime_s
                    room -= len(points)
        self._put(seen)

    def _put(self, message: Pose | Seen) -> None:
        while True:
            try:
                return self._inbox.put_nowait(message)
            except queue.Full:  # the oldest makes room
                with suppress(queue.Empty):
                    self._inbox.get_nowait()


def to_json(time_s: float, instruction: Instruction, text: str) -> dict[str, Any]:
    """A sentence as plain values."""
    return {"time": time_s, "kind": instruction.kind.value, "urgency": int(instruction.urgency), "text": text}

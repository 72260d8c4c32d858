"""Guidance over Zenoh: poses, obstacles and asks come in, cues and sentences go out."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from math import nan
from typing import Any, NamedTuple

import msgspec
import numpy as np
import zenoh
from gpdf_schemas import (
    Ask,
    AskMessage,
    CueMessage,
    DecodeError,
    MovingObstacles,
    PoseMessage,
    SayMessage,
    decode,
    encode,
    keys,
)
from gpdf_schemas.moving import MAX_POINTS, points_of, stacked
from numpy.typing import NDArray

from gpdf_guidance.guide import Asked, Guide, Outcome, look_up
from gpdf_guidance.instruction import Instruction, Kind, Urgency
from gpdf_guidance.planner import Planned
from gpdf_guidance.route import Pose

CUE_PERIOD = 0.1
"""[s] A cue goes out at least this often: twice the 5 Hz that a device needs."""
PULSE_EVERY = 0.25
"""[s] Between an answer of the planner and the next question whether it is there."""
WAITING = 64
"""Messages that may wait; the guide looks at the newest pose of them only."""
NO_POSE = Pose((nan, nan, nan), nan, nan)
Told = Callable[[float, Instruction, str], None]
"""Told each sentence: seconds since the start, the instruction, its words."""
FloatArray = NDArray[np.float64]
VALID = {Urgency.INFORM: 4.0, Urgency.PREPARE: 3.0, Urgency.ACT: 2.0, Urgency.DANGER: 5.0}
"""[s] A sentence that has not been begun by then is not begun: at full pace 1.4 m further it is wrong."""
HEARD_STANDING = (
    Kind.OVERVIEW,
    Kind.ASK_STEP,
    Kind.ASK_STEP_OR_DETOUR,
    Kind.STEP_EDGE,
    Kind.STAIRS_EDGE,
    Kind.ON_STAIRS,
)
VALID_STANDING = 10.0
"""[s] The same of what is said to who stands until it has been said."""
QUESTIONS = (Kind.ASK_STEP, Kind.ASK_STEP_OR_DETOUR)
MOVES = 0.1
"""[m] What is this far from where it was `WATCHED` ago moves; less is a sensor's noise."""
WATCHED = 0.5
"""[s] A person who walks goes half a metre in it."""


@dataclass(frozen=True, slots=True)
class Thing:
    """What is in the way.

    Attributes:
        points: Of it, shape (k, 3) [m].
        until: They are believed until then, on `time.monotonic` [s].
        since: When its place was compared last, on the same clock [s].
        place: Where it was then, (2,) [m].
        moves: Whether it had moved by then.
    """

    points: FloatArray
    until: float
    since: float
    place: FloatArray
    moves: bool = False


class Sensed(NamedTuple):
    """A pose, and its stamp as it was sent: a cue names that of the pose it is made of [s]."""

    pose: Pose
    stamp: float


Seen = dict[str, Thing]
"""By the obstacle's id."""


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
        self._inbox: queue.Queue[Sensed | Seen] = queue.Queue(WAITING)
        self._asks: queue.Queue[AskMessage] = queue.Queue(WAITING)
        self._looking: Future[Asked] | None = None
        self._said = 0
        self._pose: Pose | None = None
        self._newest_stamp, self._pose_stamp = 0.0, 0.0
        self._seen: Seen = {}
        self._planning: tuple[Future[Planned], Pose] | None = None
        self._pulse: Future[int | None] | None = None
        self._pulse_at = -float("inf")
        self._planned_for: tuple[float, ...] = ()

    def run(self, stop: Callable[[], bool] = lambda: False, *, stays: bool = False) -> Outcome:
        """Guide until arrival, a safe stop, or `stop`; the last cue is sent in any case.

        Args:
            stop: Asked ten times a second.
            stays: Whether to go on after arrival and after a safe stop: the person may ask for another goal.
        """
        began, self._guide.patient = time.monotonic(), stays
        pose_key, obstacle_key = f"{keys.POSE}/{self._name}", keys.obstacles(self._guide.planner.scene)
        subscribers = [
            self._session.declare_subscriber(pose_key, self._take_pose),
            self._session.declare_subscriber(obstacle_key, self._take_obstacles),
            self._session.declare_subscriber(f"{keys.ASK}/{self._name}", self._take_ask),
        ]
        publisher = self._session.declare_publisher(f"{keys.CUE}/{self._name}")
        with ThreadPoolExecutor(2, thread_name_prefix="gpdf-guide") as pool:
            while not stop() and (stays or self._guide.outcome is Outcome.WALKING):
                self._listen()
                now = time.monotonic()
                self._look_out(now)
                self._answer(pool)
                self._guide.felt = publisher.matching_status.matching  # type: ignore[attr-defined] # its stub says bool
                self._feel_pulse(pool, now)
                cue, said = self._guide.step(self._pose, now)
                publisher.put(encode(self._stamped(cue)))
                if said is not None:
                    self._say(now - began, *said)
                self._plan(pool, now)
        cue, said = self._guide.step(self._pose, time.monotonic())
        publisher.put(encode(self._stamped(cue)))
        if said is not None:
            self._say(time.monotonic() - began, *said)
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
            if isinstance(message, Sensed):
                self._pose, self._pose_stamp = message
            else:
                self._seen |= {id_: _moved(self._seen.get(id_), thing) for id_, thing in message.items()}
            until = 0.0

    def _plan(self, pool: ThreadPoolExecutor, now: float) -> None:
        """Ask for a route beside the stream of cues, and take it when it is there."""
        if self._planning is not None and self._planning[0].done():
            future, pose = self._planning
            self._planning = None
            if self._guide.goal == self._planned_for:
                self._guide.take(future.result(), pose)
        elif self._planning is None and self._guide.wants_route(self._pose, now) and self._pose is not None:
            guide, self._planned_for = self._guide, self._guide.goal
            planning = pool.submit(guide.planner.route, self._pose, guide.goal, guide.climb, guide.obstacles)
            self._planning = planning, self._pose

    def _look_out(self, now: float) -> None:
        """Tell the guide of what is in the way and still believed."""
        self._seen = {id_: seen for id_, seen in self._seen.items() if seen.until > now}
        near = stacked([seen.points for seen in self._seen.values()])
        moving = stacked([seen.points for seen in self._seen.values() if seen.moves])
        self._guide.see(near if len(near) else None, moving if len(moving) else None)

    def _answer(self, pool: ThreadPoolExecutor) -> None:
        """Hand what the person asks to the guide, one after the other; what must be looked up is, beside the cues."""
        if self._looking is not None and self._looking.done():
            self._guide.ask(self._looking.result())
            self._looking = None
        while self._looking is None and not self._asks.empty():
            ask = self._asks.get_nowait()
            if ask.ask in (Ask.GOAL, Ask.AROUND):
                self._looking = pool.submit(look_up, self._guide.planner, ask, self._pose)
            else:
                self._guide.ask(Asked(ask.ask, ask.id))

    def _say(self, since: float, one: Instruction, text: str) -> None:
        """Publish a sentence, and tell who runs the guide."""
        self._said += 1
        now = time.time()
        message = SayMessage(
            id=f"{self._name}-{self._said}",
            text=text,
            language=self._guide.manner.language,
            kind=one.kind.value,
            urgency=int(one.urgency),
            about=None if one.place == (0.0, 0.0) else list(one.place),
            stamp=now,
            valid_until=now + (VALID_STANDING if one.kind in HEARD_STANDING else VALID[one.urgency]),
            answers=[Ask.YES, Ask.NO] if one.kind in QUESTIONS else [],
            reply_to=one.reply_to or "",
        )
        self._session.put(f"{keys.SAY}/{self._name}", encode(message))
        self._told(since, one, text)

    def _feel_pulse(self, pool: ThreadPoolExecutor, now: float) -> None:
        """Whether there still is a planner, and in which version of the scene it plans."""
        if self._pulse is not None and self._pulse.done():
            self._guide.hear(self._pulse.result())
            self._pulse, self._pulse_at = None, now
        if self._pulse is None and now - self._pulse_at >= PULSE_EVERY:
            self._pulse = pool.submit(self._guide.planner.pulse)

    def _stamped(self, cue: CueMessage) -> CueMessage:
        return msgspec.structs.replace(cue, stamp=time.time(), pose_stamp=self._pose_stamp)

    def _take_pose(self, sample: zenoh.Sample) -> None:
        """Zenoh's callback. A pose of a clock that is ahead is as old as its way; of one that is behind, older.

        What is no pose, and one of a clock that went back, goes on as one without numbers, for which the guide stops.
        """
        try:
            message = decode(sample.payload.to_bytes(), PoseMessage)
            x, y, z = message.position
            if message.stamp < self._newest_stamp:
                raise ValueError("time goes back")
        except (DecodeError, ValueError):
            self._put(Sensed(NO_POSE, self._newest_stamp))
            return
        self._newest_stamp = message.stamp
        stamp = time.monotonic() - max(0.0, time.time() - message.stamp)
        pose = Pose((x, y, z), message.heading, stamp, message.accuracy, message.steps)
        self._put(Sensed(pose, message.stamp))

    def _take_ask(self, sample: zenoh.Sample) -> None:
        """Zenoh's callback. What is no ask is not answered; of too many the newest are dropped."""
        with suppress(DecodeError, queue.Full):
            self._asks.put_nowait(decode(sample.payload.to_bytes(), AskMessage))

    def _take_obstacles(self, sample: zenoh.Sample) -> None:
        """Zenoh's callback: what moves in the scene. One that has no sense does not hide the others."""
        seen: Seen = {}
        room = MAX_POINTS
        with suppress(DecodeError):
            for obstacle in decode(sample.payload.to_bytes(), MovingObstacles).obstacles:
                with suppress(ValueError):
                    points = points_of(obstacle, room)
                    now = time.monotonic()
                    place = points[:, :2].mean(axis=0) if len(points) else np.full(2, nan)
                    seen[obstacle.id] = Thing(points, now + obstacle.lifetime_s, now, place)
                    room -= len(points)
        self._put(seen)

    def _put(self, message: Sensed | Seen) -> None:
        while True:
            try:
                return self._inbox.put_nowait(message)
            except queue.Full:  # the oldest makes room
                with suppress(queue.Empty):
                    self._inbox.get_nowait()


def _moved(before: Thing | None, thing: Thing) -> Thing:
    """A thing that was told of again, and whether it moves."""
    if before is None:
        return thing
    if thing.since - before.since < WATCHED:
        return replace(thing, since=before.since, place=before.place, moves=before.moves)
    return replace(thing, moves=bool(np.hypot(*(thing.place - before.place)) > MOVES))


def to_json(time_s: float, instruction: Instruction, text: str) -> dict[str, Any]:
    """A sentence as plain values."""
    return {"time": time_s, "kind": instruction.kind.value, "urgency": int(instruction.urgency), "text": text}

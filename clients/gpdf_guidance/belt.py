"""A vibrating belt, feelSpace's naviBelt, that lets a person feel the cues: where to walk, how far to turn, and stop.

Everything that it is told ends by itself within `LASTS`, so a belt that hears no more leads nobody on; and without cues
for `SILENCE` it is told to say stop. It runs beside the guide, in a process of its own: pybelt's listener takes a core.
"""

from __future__ import annotations

import queue
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from math import degrees
from typing import Any, Protocol

import zenoh
from gpdf_schemas import CueAction, CueMessage, DecodeError, decode, keys

from gpdf_guidance.alignment import Clock

SILENCE = 0.4
"""[s] Without a cue for so long it says stop, which is felt within half a second; one that comes this late is none."""
LASTS = 0.6
"""[s] A vibration; it is told again before that while it is still true."""
AGAIN = 0.3
"""[s] So often: half of `LASTS`, so that one may be lost."""
MOTORS = 16
ALL_MOTORS = 0xFFFF
"""Around the waist."""
CONTINUOUS, SINGLE_SHORT, DOUBLE_SHORT, DOUBLE_LONG = 1, 2, 4, 5
"""Patterns, as pybelt counts them."""
MASK, ANGLE = 0, 2
"""What an orientation is: motors, or degrees clockwise from the front."""
CHANNEL = 1


class BeltError(Exception):
    """There is no belt, or no more.

    Args:
        port: Where it was looked for.
    """

    def __init__(self, port: str) -> None:
        super().__init__(f"no naviBelt answers at {port}. Switch it on, and see that nothing else uses the port.")


class Vibrates(Protocol):
    """What is used of pybelt's `BeltController`."""

    def send_vibration_command(self, **command: Any) -> bool:  # noqa: ANN401 - of pybelt, which has no types
        """Vibrate; False if that could not be sent."""
        ...


@dataclass(frozen=True, slots=True)
class Buzz:
    """A vibration: its pattern, its motors, and whether it goes on while the cue does.

    `motor` is counted clockwise from the front; None is all around.
    """

    pattern: int
    motor: int | None
    goes_on: bool = False


STOP = Buzz(DOUBLE_LONG, None)
PATTERNS = {CueAction.GO: CONTINUOUS, CueAction.SLOW: SINGLE_SHORT, CueAction.TURN: DOUBLE_SHORT}


def buzz(cue: CueMessage) -> Buzz:
    """What a cue feels like: a direction is where it vibrates, stop and arrival are all around."""
    if cue.action is CueAction.ARRIVED:
        return Buzz(DOUBLE_SHORT, None)
    if cue.action is CueAction.STOP:
        return STOP
    motor = round(-degrees(cue.direction) / 360.0 * MOTORS) % MOTORS
    return Buzz(PATTERNS[cue.action], motor, goes_on=True)


class Belt:
    """Tells a belt what changes, and what is still true; holds no thread and no clock.

    Args:
        belt: Of pybelt, connected.
        port: Its name, for errors.
    """

    def __init__(self, belt: Vibrates, port: str = "") -> None:
        self._belt, self._port = belt, port
        self._felt: Buzz | None = None
        self._told_at = self._cue_at = float("-inf")
        self._clock = Clock()

    def step(self, cue: CueMessage | None, now: float) -> None:
        """Take the newest cue that has come since the last step, if one has.

        Raises:
            BeltError: the belt does not take it.
        """
        if cue is not None and now - self._clock.to_ours(cue.stamp, now) <= SILENCE:
            self._cue_at = now
            self._tell(buzz(cue), now)
        elif self._felt is not None and now - self._cue_at > SILENCE:
            self._tell(STOP, now)

    def stop(self, now: float) -> None:
        """Say stop, whatever was said."""
        self._tell(STOP, now)

    def _tell(self, one: Buzz, now: float) -> None:
        if one == self._felt and not (one.goes_on and now - self._told_at >= AGAIN):
            return
        sent = self._belt.send_vibration_command(
            channel_index=CHANNEL,
            pattern=one.pattern,
            intensity=None,
            orientation_type=MASK if one.motor is None else ANGLE,
            orientation=ALL_MOTORS if one.motor is None else round(one.motor * 360 / MOTORS),
            pattern_iterations=1,
            pattern_period=round(1000 * LASTS),
            pattern_start_time=0,
            exclusive_channel=False,
            clear_other_channels=True,
        )
        if not sent:
            raise BeltError(self._port)
        self._felt, self._told_at = one, now


def connect(port: str) -> Any:  # noqa: ANN401 - of pybelt, which has no types
    """Connect the belt at a serial port, and take it over from its own compass.

    A line that takes nothing for `SILENCE` fails from then on: pybelt would wait for it for ever, and who guides would
    go on believing that the cues are felt.

    Raises:
        BeltError: there is none. Nothing of it runs on.
    """
    from pybelt.belt_controller import BeltConnectionState, BeltController, BeltMode

    belt = BeltController()
    belt.connect(port)
    if belt.get_connection_state() != BeltConnectionState.CONNECTED:
        raise BeltError(port)
    with ExitStack() as undo:
        undo.callback(belt.disconnect_belt)  # its listener would keep the process from ending
        try:
            belt._communication_interface._serial_port.write_timeout = SILENCE
            belt.set_belt_mode(BeltMode.APP_MODE, wait_ack=True)
        except (OSError, AttributeError) as error:  # no answer in time; the line has just gone
            raise BeltError(port) from error
        undo.pop_all()
    return belt


def run(session: zenoh.Session, name: str, belt: Belt, stop: Callable[[], bool]) -> None:
    """Feel the cues of a person until `stop`, which is asked some twenty times a second.

    Raises:
        BeltError: the belt has gone. Who guides sees then that nobody feels the cues, and speaks of every stop at once.
    """
    cues: queue.SimpleQueue[CueMessage] = queue.SimpleQueue()

    def take(sample: zenoh.Sample) -> None:
        with suppress(DecodeError):
            cues.put(decode(sample.payload.to_bytes(), CueMessage))

    subscriber = session.declare_subscriber(f"{keys.CUE}/{name}", take)
    try:
        while not stop():
            newest = None
            with suppress(queue.Empty):
                newest = cues.get(timeout=0.05)
                while True:
                    newest = cues.get_nowait()
            belt.step(newest, time.time())
        belt.stop(time.time())
    finally:
        subscriber.undeclare()  # type: ignore[no-untyped-call]

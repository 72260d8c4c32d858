"""A simulated person who cannot see: follows cues late, turns too far, drifts, and carries a sensor that drops out."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from gpdf_schemas import CueAction, CueMessage
from numpy.typing import NDArray

from gpdf_guidance.features import TURN, wrap
from gpdf_guidance.route import Pose

FloatArray = NDArray[np.float64]
GroundHeight = Callable[[FloatArray], float]
"""Height of the ground at (x, y, z close to it) [m]."""

TURN_RATE = 1.0
"""[rad/s] On the spot."""
STEERING = 1.0
"""[1/s] Share of a felt direction that a walker turns in a second."""
ACCELERATION = 1.5
"""[m/s²] From a walk to a stand in a step."""
SILENCE = 0.5
"""[s] Without a cue a person stops, as told."""


@dataclass(frozen=True, slots=True)
class Errors:
    """Of a person and of his sensor.

    Attributes:
        over_turn: Turned too far on an instruction to turn [rad]; blind people over-rotate by 17°.
        over_turn_spread: One standard deviation of it [rad].
        delay: From a cue to the foot [s].
        drift: One standard deviation of the course's bend [rad/m].
        drift_time: That a bend lasts [s].
        sideways: One standard deviation of the share of a pace that goes sideways, once for a walk.
        drop_out_rate: Of the sensor [1/s].
        drop_out: Longest time without a pose [s].
        position: One standard deviation of a pose [m].
        heading: The same [rad].
    """

    over_turn: float = float(np.radians(17))
    over_turn_spread: float = float(np.radians(5))
    delay: float = 0.5
    drift: float = float(np.radians(5))
    drift_time: float = 4.0
    sideways: float = 0.04
    drop_out_rate: float = 1 / 15
    drop_out: float = 2.5
    position: float = 0.02
    heading: float = float(np.radians(2))


class Walker:
    """Walks by cues. `position` (3,) [m] and `heading` [rad] are the truth; `pose` is what the sensor says.

    Args:
        position: Where it stands, (x, y, z of the ground) [m].
        heading: Where it looks [rad].
        ground: Height of the ground.
        rng: Source of the errors.
        errors: Their size.
    """

    def __init__(
        self,
        position: FloatArray,
        heading: float,
        ground: GroundHeight,
        rng: np.random.Generator,
        errors: Errors | None = None,
    ) -> None:
        self.position, self.heading, self.speed = np.array(position, dtype=np.float64), heading, 0.0
        self._ground, self._rng, self._errors = ground, rng, errors or Errors()
        self._cues: deque[CueMessage] = deque()
        self._cue: CueMessage | None = None
        self._drift = 0.0
        self._sideways = float(rng.normal(0.0, self._errors.sideways))
        self._turn_to: float | None = None
        self._rest_until, self._blind_until = 0.0, 0.0

    def feel(self, cue: CueMessage) -> None:
        """A cue arrives; it is acted on after the delay."""
        self._cues.append(cue)

    def pose(self, now: float, period: float) -> Pose | None:
        """What the sensor says; None while it has dropped out.

        Args:
            now: Clock [s].
            period: Since the last call [s].
        """
        if now >= self._blind_until and self._rng.random() < period * self._errors.drop_out_rate:
            self._blind_until = now + float(self._rng.uniform(0.3, self._errors.drop_out))
        if now < self._blind_until:
            return None
        x, y = self.position[:2] + self._rng.normal(0.0, self._errors.position, 2)
        heading = self.heading + float(self._rng.normal(0.0, self._errors.heading))
        return Pose((float(x), float(y), float(self.position[2])), heading, now, self._errors.position)

    def move(self, now: float, period: float) -> None:
        """Walk on for `period` [s]."""
        while self._cues and self._cues[0].stamp <= now - self._errors.delay:
            self._take(self._cues.popleft(), now)
        self._wander(period)
        wanted = self._wanted_speed(now)
        change = ACCELERATION * period
        self.speed += float(np.clip(wanted - self.speed, -change, change))
        self._turn(now, period)
        self.heading = wrap(self.heading + self._drift * period * self.speed)  # a course bends as one walks
        forward = np.array([np.cos(self.heading), np.sin(self.heading)])
        side = np.array([-forward[1], forward[0]])
        self.position[:2] += period * self.speed * (forward + self._sideways * side)
        self.position[2] = self._ground(self.position)

    def _take(self, cue: CueMessage, now: float) -> None:
        self._cue = cue
        large = cue.action is CueAction.TURN and abs(cue.direction) > self._errors.over_turn
        if large and self._turn_to is None and now >= self._rest_until:
            too_far = self._rng.normal(self._errors.over_turn, self._errors.over_turn_spread)
            too_far *= min(1.0, abs(cue.direction) / TURN)  # a correction is over-turned in proportion
            self._turn_to = self.heading + cue.direction + float(np.copysign(too_far, cue.direction))

    def _wander(self, period: float) -> None:
        """The course's error, an Ornstein-Uhlenbeck process."""
        share = period / self._errors.drift_time
        kick = self._rng.normal(0.0, self._errors.drift * np.sqrt(2 * share))
        self._drift += float(kick) - share * self._drift

    def _wanted_speed(self, now: float) -> float:
        cue = self._felt(now)
        walks = cue is not None and self._turn_to is None and cue.action in (CueAction.GO, CueAction.SLOW)
        return cue.pace if walks and cue is not None else 0.0

    def _felt(self, now: float) -> CueMessage | None:
        """The cue that is acted on; none after a silence."""
        recent = self._cue is not None and now - self._cue.stamp <= SILENCE + self._errors.delay
        return self._cue if recent else None

    def _turn(self, now: float, period: float) -> None:
        if self._turn_to is not None:
            left = wrap(self._turn_to - self.heading)
            self.heading += float(np.clip(left, -TURN_RATE * period, TURN_RATE * period))
            if abs(left) <= TURN_RATE * period:
                self._turn_to, self._rest_until = None, now + 2 * self._errors.delay  # waits for what it feels now
            return
        cue = self._felt(now)
        if cue is None or now < self._rest_until or cue.action in (CueAction.STOP, CueAction.ARRIVED):
            return
        rate = STEERING * cue.direction
        self.heading += period * float(np.clip(rate, -TURN_RATE, TURN_RATE))

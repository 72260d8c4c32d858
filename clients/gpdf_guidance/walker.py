"""A simulated person who cannot see, with errors as studies of blind people found them, and a sensor that drops out.

Turns: Ahmetovic, Oh, Mascetti, Asakawa, "Turn Right", ASSETS 2018: over-rotation 17.4° (SD 4.0) after slight turns
(22.5° to 60°), 13.4° (SD 3.7) after ample ones. Courses: Kallie, Schrater, Legge, "Variability in stepping direction
explains the veering behavior of blind walkers", J. Exp. Psychol. HPP 33, 2007: a wrong first direction, a bias that
stays, and an error of each step. Steps: Mason, Legge, Kallie, J. Vis. Impair. Blind. 99, 2005: their length is steady
within a walk. Stops: Tirosh, Sparrow, Gait & Posture 19, 2004: 0.46 s (young) to 0.57 s (old) from a signal to a stand.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from gpdf_schemas import CueAction, CueMessage
from numpy.typing import NDArray

from gpdf_guidance.features import wrap
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
SLIGHT = float(np.radians(22.5)), float(np.radians(60))
"""[rad] A slight turn; a smaller one was not studied, and is over-turned in proportion."""


@dataclass(frozen=True, slots=True)
class Errors:
    """Of a person and of his sensor.

    Attributes:
        slight: Turned on after the cue to end a slight turn [rad].
        slight_spread: One standard deviation of it [rad].
        ample: The same of a turn of more than 60° [rad].
        ample_spread: One standard deviation of it [rad].
        delay: From a cue to the foot [s].
        delay_spread: One standard deviation of it between people [s].
        first_step: One standard deviation of the error of direction with which one sets off [rad].
        bias: The same of the turn that each step of a walk adds [rad].
        each_step: The same of each step's own [rad].
        step: Length of a step [m].
        step_spread: One standard deviation of it between people, as a share.
        step_change: The same from step to step.
        sideways: The same of the share of a pace that goes sideways, once for a walk.
        drop_out_rate: Of the sensor [1/s].
        drop_out: Longest time without a pose [s].
        position: One standard deviation of a pose [m].
        heading: The same [rad].
    """

    slight: float = float(np.radians(17.4))
    slight_spread: float = float(np.radians(4.0))
    ample: float = float(np.radians(13.4))
    ample_spread: float = float(np.radians(3.7))
    delay: float = 0.5
    delay_spread: float = 0.05
    first_step: float = float(np.radians(4.0))
    bias: float = float(np.radians(0.5))
    each_step: float = float(np.radians(1.5))
    step: float = 0.62
    step_spread: float = 0.1
    step_change: float = 0.04
    sideways: float = 0.04
    drop_out_rate: float = 1 / 15
    drop_out: float = 2.5
    position: float = 0.02
    heading: float = float(np.radians(2))


_NONE = {name: 0.0 for name in Errors.__dataclass_fields__ if name not in ("delay", "step", "drop_out")}
EXACT = Errors(**_NONE)
"""A person and a sensor without errors, who is as slow as others."""


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
        self._turn: tuple[float, float] | None = None  # under way: its sign, and the angle that was asked for [rad]
        self._rest_at: float | None = None  # heading at which it ends [rad]
        self._blind_until = 0.0
        spread = self._errors
        self._sideways = float(rng.normal(0.0, spread.sideways))
        self._bias = float(rng.normal(0.0, spread.bias))
        self._delay = max(0.3 * spread.delay, float(rng.normal(spread.delay, spread.delay_spread)))
        self._length = spread.step * max(0.6, 1.0 + float(rng.normal(0.0, spread.step_spread)))
        self._left, self.steps = self._length, 0  # of the step that is being made [m]

    def feel(self, cue: CueMessage) -> None:
        """A cue arrives; it is acted on after the delay, but what ends a turn ends it as in the studies."""
        if self._turn is not None and self._rest_at is None and not self._goes_on(cue):
            sign, angle = self._turn
            self._rest_at = self.heading + sign * self._over(angle)
            self._cues.clear()  # what said to turn is past
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
        place = (float(x), float(y), float(self.position[2]))
        return Pose(place, heading, now, self._errors.position, self.steps)

    def move(self, now: float, period: float) -> None:
        """Walk on for `period` [s]."""
        while self._cues and self._cues[0].stamp <= now - self._delay:
            self._take(self._cues.popleft())
        wanted = self._wanted_speed(now)
        if self.speed == 0.0 and wanted > 0.0:
            self.heading += float(self._rng.normal(0.0, self._errors.first_step))
        change = ACCELERATION * period
        self.speed += float(np.clip(wanted - self.speed, -change, change))
        self._face(now, period)
        self._step(period * self.speed)
        forward = np.array([np.cos(self.heading), np.sin(self.heading)])
        side = np.array([-forward[1], forward[0]])
        self.position[:2] += period * self.speed * (forward + self._sideways * side)
        self.position[2] = self._ground(self.position)

    def _goes_on(self, cue: CueMessage) -> bool:
        assert self._turn is not None
        return cue.action is CueAction.TURN and cue.direction * self._turn[0] > 0.0

    def _over(self, angle: float) -> float:
        """How far one turns on after the cue to end a turn of `angle` [rad]."""
        errors = self._errors
        mean, spread = (errors.ample, errors.ample_spread)
        if angle < SLIGHT[1]:
            mean, spread = (errors.slight, errors.slight_spread)
        return min(1.0, angle / SLIGHT[0]) * max(0.0, float(self._rng.normal(mean, spread)))

    def _take(self, cue: CueMessage) -> None:
        self._cue = cue
        if cue.action is CueAction.TURN and self._turn is None and self._rest_at is None:
            self._turn = float(np.sign(cue.direction)), abs(cue.direction)
            newer = next((later for later in self._cues if not self._goes_on(later)), None)
            if newer is not None:  # the cue to end it is on its way already: a small turn
                self._rest_at = self.heading + self._turn[0] * self._over(self._turn[1])

    def _step(self, way: float) -> None:
        """Each step has a length and a direction of its own, so a course bends as one walks."""
        self._left -= way
        if self._left <= 0.0:
            self.steps += 1
            change = 1.0 + float(self._rng.normal(0.0, self._errors.step_change))
            self._left += self._length * max(0.5, change)
            self.heading += self._bias + float(self._rng.normal(0.0, self._errors.each_step))

    def _wanted_speed(self, now: float) -> float:
        cue = self._felt(now)
        walks = cue is not None and self._turn is None and cue.action in (CueAction.GO, CueAction.SLOW)
        return cue.pace if walks and cue is not None else 0.0

    def _felt(self, now: float) -> CueMessage | None:
        """The cue that is acted on; none after a silence."""
        recent = self._cue is not None and now - self._cue.stamp <= SILENCE + self._delay
        return self._cue if recent else None

    def _face(self, now: float, period: float) -> None:
        if self._turn is not None:
            self._go_round(now, period)
            return
        cue = self._felt(now)
        if cue is None or cue.action in (CueAction.STOP, CueAction.ARRIVED, CueAction.TURN):
            return
        rate = STEERING * cue.direction
        self.heading = wrap(self.heading + period * float(np.clip(rate, -TURN_RATE, TURN_RATE)))

    def _go_round(self, now: float, period: float) -> None:
        """Turn on the spot until the cue ends it, and on by what one over-turns; a silence ends it, too."""
        assert self._turn is not None
        if self._rest_at is None and self._felt(now) is None:
            self._rest_at = self.heading + self._turn[0] * self._over(self._turn[1])
        left = np.inf if self._rest_at is None else self._turn[0] * wrap(self._rest_at - self.heading)
        self.heading = wrap(self.heading + self._turn[0] * min(max(left, 0.0), TURN_RATE * period))
        if left <= TURN_RATE * period:
            self._turn, self._rest_at = None, None

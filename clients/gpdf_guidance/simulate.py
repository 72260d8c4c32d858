"""A guided walk in simulated time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from gpdf_schemas import CueAction
from numpy.typing import NDArray

from gpdf_guidance.guide import Guide, Outcome
from gpdf_guidance.instruction import Instruction
from gpdf_guidance.route import Pose
from gpdf_guidance.walker import Walker

FloatArray = NDArray[np.float64]

TICK = 0.05
"""[s] Of the walk: 3.5 cm at full pace."""
CUE_EVERY = 2
"""Ticks between cues and poses: 10 Hz."""
LONGEST = 600.0
"""[s] A walk that takes longer has failed."""


class Truth(Protocol):
    """The world as it is, which neither the guide nor the planner sees."""

    def penetration(self, position: FloatArray) -> float:
        """How deep the worst obstacle is in a person who stands at (x, y, z) [m]; 0 where none touches."""
        ...


@dataclass(frozen=True, slots=True)
class Said:
    """A spoken sentence: when [s], where (3,) [m], what."""

    time: float
    place: FloatArray
    instruction: Instruction
    text: str


@dataclass(frozen=True, slots=True)
class Walk:
    """What happened: times (n,) [s], true places (n, 3) [m], sentences, how it ended, worst contact [m]."""

    times: FloatArray
    places: FloatArray
    said: tuple[Said, ...]
    outcome: Outcome
    reason: str
    penetration: float
    routes: int
    stopped: float

    @property
    def metres(self) -> float:
        """Length of the walk in plan [m]."""
        return float(np.hypot(*np.diff(self.places[:, :2], axis=0).T).sum())

    @property
    def per_minute(self) -> float:
        """Spoken instructions a minute."""
        return 60.0 * len(self.said) / max(float(self.times[-1]), 1.0)


def simulate(guide: Guide, walker: Walker, truth: Truth | None, *, longest: float = LONGEST) -> Walk:
    """Guide a walker until it arrives or stops for good.

    Args:
        guide: Fresh, or at work.
        walker: Who walks.
        truth: Looks for contacts at every tick.
        longest: Time after which the walk is ended [s].
    """
    times, places, said, worst, stopped = [0.0], [walker.position.copy()], [], 0.0, 0.0
    pose: Pose | None = None
    now, tick = 0.0, 0
    while now < longest:
        if tick % CUE_EVERY == 0:
            pose = walker.pose(now, CUE_EVERY * TICK) or pose
            if guide.wants_route(pose, now) and pose is not None:
                guide.replan(pose)
            cue, spoken = guide.step(pose, now)
            walker.feel(cue)
            stopped += CUE_EVERY * TICK * (cue.action is CueAction.STOP)
            if spoken is not None:
                said.append(Said(now, walker.position.copy(), *spoken))
            if guide.outcome is not Outcome.WALKING and walker.speed < 0.01:
                break
        now, tick = now + TICK, tick + 1
        walker.move(now, TICK)
        times.append(now)
        places.append(walker.position.copy())
        worst = max(worst, truth.penetration(walker.position)) if truth is not None else worst
    if guide.outcome is Outcome.WALKING:
        guide.give_up(f"not there after {longest:.0f} s")
    routes = len(guide.routes)
    return Walk(np.array(times), np.array(places), tuple(said), guide.outcome, guide.reason, worst, routes, stopped)

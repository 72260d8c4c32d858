"""A guided walk in simulated time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from gpdf_schemas import Ask, CueAction
from numpy.typing import NDArray

from gpdf_guidance.guide import Asked, Guide, Outcome
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
THINKS = 4.0
"""[s] From a question's first word to the answer."""


class Truth(Protocol):
    """The world as it is, which neither the guide nor the planner sees."""

    def penetration(self, position: FloatArray) -> float:
        """How deep the worst obstacle is in a person who stands at (x, y, z) [m]; 0 where none touches."""
        ...


class Others(Protocol):
    """Who else moves in the world."""

    def move(self, now: float, period: float, person: FloatArray) -> None:
        """Move on for `period` [s] beside a person who is at (x, y, z) [m]."""
        ...

    def points(self) -> FloatArray:
        """What the person's sensor sees of them, shape (k, 3) [m]."""
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
    """What happened: times (n,) [s], true places (n, 3) [m], sentences, how it ended, worst contact [m].

    `end` is how far from the goal it ended, in plan [m].
    """

    times: FloatArray
    places: FloatArray
    said: tuple[Said, ...]
    outcome: Outcome
    reason: str
    penetration: float
    routes: int
    stopped: float
    end: float = float("inf")

    @property
    def metres(self) -> float:
        """Length of the walk in plan [m]."""
        return float(np.hypot(*np.diff(self.places[:, :2], axis=0).T).sum())

    @property
    def per_minute(self) -> float:
        """Spoken instructions a minute."""
        return 60.0 * len(self.said) / max(float(self.times[-1]), 1.0)


def simulate(
    guide: Guide,
    walker: Walker,
    truth: Truth | None,
    *,
    longest: float = LONGEST,
    agrees: bool = True,
    others: Others | None = None,
) -> Walk:
    """Guide a walker until it arrives or stops for good.

    Args:
        guide: Fresh, or at work.
        walker: Who walks.
        truth: Looks for contacts at every tick.
        longest: Time after which the walk is ended [s].
        agrees: Whether the person says yes to what the guide asks.
        others: Who else moves.
    """
    times, places, said, worst, stopped = [0.0], [walker.position.copy()], [], 0.0, 0.0
    pose: Pose | None = None
    now, tick, asked_at = 0.0, 0, float("inf")
    while now < longest:
        if tick % CUE_EVERY == 0:
            pose = walker.pose(now, CUE_EVERY * TICK) or pose
            if others is not None:
                guide.see(seen := others.points(), seen)
            if guide.wants_route(pose, now) and pose is not None:
                guide.replan(pose)
            ended = guide.outcome is not Outcome.WALKING  # and this step says so
            cue, spoken = guide.step(pose, now)
            walker.feel(cue)
            stopped += CUE_EVERY * TICK * (cue.action is CueAction.STOP)
            if spoken is not None:
                said.append(Said(now, walker.position.copy(), *spoken))
            asked_at = float("inf") if guide.question is None else min(asked_at, now)
            if now - asked_at >= THINKS:
                guide.ask(Asked(Ask.YES if agrees else Ask.NO))
            if ended and walker.speed < 0.01:
                break
        now, tick = now + TICK, tick + 1
        walker.move(now, TICK)
        if others is not None:
            others.move(now, TICK, walker.position)
        times.append(now)
        places.append(walker.position.copy())
        worst = max(worst, truth.penetration(walker.position)) if truth is not None else worst
    if guide.outcome is Outcome.WALKING:
        guide.give_up(f"not there after {longest:.0f} s")
    end = float(np.hypot(*(walker.position[:2] - guide.goal[:2])))
    walked = np.array(times), np.array(places), tuple(said)
    return Walk(*walked, guide.outcome, guide.reason, worst, len(guide.routes), stopped, end)

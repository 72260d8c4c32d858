"""What is said of all that could be said: most urgent first, nothing twice, within a budget of words."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import hypot, inf

from gpdf_guidance.ahead import FOOT_OF
from gpdf_guidance.features import TREAD
from gpdf_guidance.instruction import Instruction, Kind, Urgency
from gpdf_guidance.speech import spoken_in

PER_MINUTE = 5.0
"""[1/min] Instructions that the budget earns: under the 8 that people bear for long, since urgent ones may borrow."""
SAVED = 1.5
"""Instructions that can be saved up."""
DEBT = -3.0
"""Instructions that urgent ones can borrow."""
NEEDED = {Urgency.INFORM: 1.0, Urgency.PREPARE: 0.0, Urgency.ACT: -inf, Urgency.DANGER: -inf}
"""Instructions that must be saved up to say one: what prepares may come right after one that was urgent."""
AGAIN = {Urgency.DANGER: 8.0, Urgency.ACT: 12.0}
"""[s] What is dangerous or to be done now is said again so long after its end if it still is; the rest is said once."""
KIND_AGAIN = {
    Kind.STEP: 30.0,
    Kind.STAIRS: 30.0,
    Kind.STEP_EDGE: 20.0,
    Kind.STAIRS_EDGE: 30.0,
    Kind.ON_STAIRS: inf,
    Kind.MOVING: 15.0,
    Kind.ASK_STEP: 15.0,
    Kind.ASK_STEP_OR_DETOUR: 15.0,
    Kind.PAUSED: inf,
    Kind.STOP_MOVING: 20.0,
}
"""[s] The same by kind: a step that one still stands before is told of again, by then it may be forgotten."""
SAME = 0.8
"""[m] What is of one kind and this close is the same thing, also after another way has been planned."""
SAME_STEP = 0.5 * TREAD
"""[m] The same for a single step: another one may be a tread away."""
STEPS = (Kind.STEP, Kind.STEP_EDGE, Kind.STAIRS, Kind.STAIRS_EDGE, Kind.ON_STAIRS)
LAST = tuple(kind for kind in Kind if kind.value.startswith(("gave_up", "no_way", "no_answer", "arrived")))
"""What ends a walk cuts off whatever is being said."""
AT_EDGE = {Kind.STEP: Kind.STEP_EDGE, Kind.STAIRS: Kind.STAIRS_EDGE}
ANYWHERE = (Kind.MOVING, Kind.LOW_UNSEEN)
"""What is the same thing wherever it is; but that a map misses more than was said is news."""


@dataclass(frozen=True, slots=True)
class _Said:
    """An instruction, and when its sentence ends [s]."""

    instruction: Instruction
    end: float


class Announcer:
    """Chooses what to say now.

    Args:
        say: Puts an instruction into words.
    """

    def __init__(self, say: Callable[[Instruction], str]) -> None:
        self._say = say
        self._said: list[_Said] = []
        self._tokens = 1.0
        self._then: float | None = None
        self._quiet_at, self._speaking = -inf, Urgency.INFORM
        self._last: tuple[Instruction, str] | None = None

    @property
    def last(self) -> tuple[Instruction, str] | None:
        """What was said last."""
        return self._last

    def choose(self, instructions: Sequence[Instruction], now: float) -> tuple[Instruction, str] | None:
        """The most urgent that is due, in words; None to be silent.

        Args:
            instructions: Most urgent first.
            now: Clock [s].
        """
        self._earn(now)
        due = (one for one in instructions if self._is_affordable(one) and self._due(one, now))
        chosen = next((one for one in due if self._may_begin(one, now)), None)
        if chosen is not None and chosen.kind is Kind.RESUME and chosen.reply_to is None:
            after = next((one for one in due if one.reply_to is None), None)  # in the same breath
            chosen = chosen if after is None else replace(after, resumes=True)
        return None if chosen is None else self._speak(chosen, now)

    def _is_affordable(self, one: Instruction) -> bool:
        return self._tokens >= NEEDED[one.urgency] or one.reply_to is not None

    def _may_begin(self, one: Instruction, now: float) -> bool:
        return now >= self._quiet_at or one.urgency > self._speaking or one.kind in LAST

    def _earn(self, now: float) -> None:
        if self._then is not None:
            self._tokens = min(SAVED, self._tokens + (now - self._then) * PER_MINUTE / 60.0)
        self._then = now

    def has_told(self, instruction: Instruction, now: float) -> bool:
        """Whether this has been said to the end."""
        return any(now >= said.end for said in self._said if _same(said.instruction, instruction))

    def has_begun(self, instruction: Instruction, now: float) -> bool:
        """Whether this is being said, or was within the time after which it would be said again."""
        again = AGAIN[Urgency.ACT]
        return any(now - said.end < again for said in self._said if _same(said.instruction, instruction))

    def _due(self, instruction: Instruction, now: float) -> bool:
        if instruction.reply_to is not None:
            return True
        again = KIND_AGAIN.get(instruction.kind, AGAIN.get(instruction.urgency, inf))
        return all(now - said.end >= again for said in self._said if _same(said.instruction, instruction))

    def _speak(self, instruction: Instruction, now: float) -> tuple[Instruction, str]:
        text = self._say(instruction)
        self._last = instruction, text
        self._said = [said for said in self._said if said.end <= now and not _takes_back(instruction, said.instruction)]
        self._tokens = max(DEBT, self._tokens - 1.0)
        self._quiet_at, self._speaking = now + spoken_in(text), instruction.urgency
        self._said += [_Said(one, self._quiet_at) for one in _told_with(instruction)]
        return instruction, text


def _told_with(one: Instruction) -> list[Instruction]:
    """All that is told with an instruction, and need not be told by itself."""
    told = [one] if one.first is None else [one.first, one]
    told += [replace(one, kind=Kind.STAIRS_END)] if one.ends else []
    told += [Instruction(Kind.RESUME, Urgency.DANGER)] if one.resumes else []
    told += [part for part in one.then if part.kind is Kind.LOW_UNSEEN]
    if one.kind in AT_EDGE and one.distance <= FOOT_OF:  # that is the word at the edge
        told.append(replace(one, kind=AT_EDGE[one.kind]))
    if one.kind in (Kind.STAIRS, Kind.STAIRS_EDGE) and not one.early:
        told.append(replace(one, kind=Kind.ON_STAIRS))
    return told if one.soon is None else told + _told_with(one.soon)


def _takes_back(new: Instruction, old: Instruction) -> bool:
    """A stop after "go on" is another stop, and the other way round."""
    both_danger = new.urgency is old.urgency is Urgency.DANGER
    return both_danger and (new.kind is Kind.RESUME) is not (old.kind is Kind.RESUME)


def _same(a: Instruction, b: Instruction) -> bool:
    if a.kind is not b.kind or a.early is not b.early:
        return False
    if a.kind in STEPS and a.amount * b.amount < 0.0:
        return False  # up and down a sill
    if a.kind is Kind.LOW_UNSEEN and b.amount > a.amount:
        return False
    if a.last is not None and b.last is not None:
        same_end = SAME if a.kind is Kind.ON_STAIRS else SAME_STEP
        if _apart(a.last, b.last) < same_end:
            return True  # who has climbed a part of a flight is still on it
    return a.kind in ANYWHERE or _apart(a.place, b.place) < (SAME_STEP if a.kind in STEPS[:2] else SAME)


def _apart(a: tuple[float, float], b: tuple[float, float]) -> float:
    return hypot(a[0] - b[0], a[1] - b[1])

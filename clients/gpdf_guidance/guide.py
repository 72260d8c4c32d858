"""The guide of one person to one goal: plans, advises, chooses what to say, plans again, knows when to give up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from math import inf

import numpy as np
from gpdf_schemas import Ask, AskMessage, CueAction, CueMessage
from numpy.typing import NDArray

from gpdf_guidance.advice import BLIND, OVER_TURN, PACES, Advice, advise, aim, moves_near, stop
from gpdf_guidance.ahead import find_reassurance, is_edge, is_hidden_step
from gpdf_guidance.announcer import Announcer
from gpdf_guidance.answers import here, how_far, overview, unseen
from gpdf_guidance.belief import Belief, believe
from gpdf_guidance.catalogue import phrase
from gpdf_guidance.features import FeatureKind
from gpdf_guidance.instruction import Instruction, Kind, Urgency
from gpdf_guidance.manner import Detail, Manner, changed
from gpdf_guidance.planner import LEAST_ROOM, LEVEL_STEP, Planned, Planner
from gpdf_guidance.route import Pose, Progress, Route
from gpdf_guidance.steps import StepLength, learn
from gpdf_guidance.trust import doubt

FloatArray = NDArray[np.float64]

STALLED = 30.0
"""[s] Without half a metre of progress another way is asked for."""
PATIENCE = 3.0
"""[s] Off the way, held up, or facing nothing that is safe: after this another way is asked for."""
MOVES_ON = 8.0
"""[s] The same behind what moves: who walks has gone before another way is, and at each way the person would turn."""
OFF_WAY = 0.5
"""[s] The same when the person has left the corridor: he stands by then."""
TRIES = 6
"""Ways that are asked for without half a metre of progress between them."""
MANY_TRIES = 20
"""The same where something new is in the way: it may yet go."""
LOST = 30.0
"""[s] Without a good pose the guide gives up."""
UNANSWERED = 60.0
"""[s] Without an answer to a question it gives up, too."""
SETTLES = 1.0
"""[s] After a turn a person comes to rest, and is not told of a small one before."""
WAITING = {
    Kind.STOP_LOST: PATIENCE,
    Kind.STOP_NO_POSE: PATIENCE,
    Kind.STOP_OFF_WAY: PATIENCE,
    Kind.STOP_MOVING: PATIENCE,
    Kind.STOP_UNRELIABLE: 0.4,
}
"""[s] The cue says stop at once; one that is over within this is felt and not spoken, if somebody feels the cues. Poses
that are missing mostly come again, and who crosses the way, a walk of 1.4 s, has been gone for `CLEAR_FOR`: to speak of
that takes longer than it lasts, and "go on" must wait for it. Poses that cannot be true are spoken of within half a
second."""
STOPS = (*WAITING, Kind.STOP_ALONE, Kind.STOP_OBSTACLE, Kind.STOP_UNSURE)
"""After these a person waits to be told to go on."""
WALKS = (CueAction.GO, CueAction.SLOW)
GOING = (*WALKS, CueAction.TURN)
BLOCKS = {Kind.STOP_OBSTACLE, Kind.STOP_MOVING}
CLEAR_FOR = (1.0, 4.0)
"""[s] What was in the way has been gone for so long before one goes on; twice as long each time that it comes back
before one has got on, up to the second."""
PASSED = 2.5
"""[m] From where he was told of a thing in his way one is led past it: its length, and the way to it."""
GETS_ON = 0.5
"""[m] Who has moved by this has got on."""
STANDS = 8.0
"""[s] The same for one who stands. Who was told to stop: that his pose is missing, too, is no news for so long. Who has
heard the overview and has not set off: "stop" is no news, and where it is over by then, "go on" is none. Who is led
past a thing that he was told of: that it stops him once more is none."""
UNSURE = 2.0
"""[s] A person who is held without a word for so long is told that the guide is at work."""
BRAKES = PACES[0] / BLIND
"""[m/s²] A pace that was told is thought to last this long after a slower one."""
MANNERS = {
    Ask.SLOWER: Kind.SLOWER,
    Ask.FASTER: Kind.FASTER,
    Ask.MORE_WORDS: Kind.MORE_WORDS,
    Ask.FEWER_WORDS: Kind.FEWER_WORDS,
}
"""How what changes the manner is answered."""


class Outcome(StrEnum):
    """How a guided walk stands."""

    WALKING = "walking"
    ARRIVED = "arrived"
    SAFE_STOP = "safe stop"


@dataclass(frozen=True, slots=True)
class Asked:
    """What a person asks, with what had to be looked up for the answer.

    Attributes:
        what: Of the fixed list.
        id: Given back with the answer.
        goal: Of `Ask.GOAL`: where it is [m]; None where there is no such place.
        name: Of the goal, as the person calls it.
        free: Of `Ask.AROUND`: how far it is free ahead, to the right, behind and to the left [m]; empty if unknown.
    """

    what: Ask
    id: str = ""
    goal: tuple[float, ...] | None = None
    name: str = ""
    free: tuple[float, ...] = ()


def look_up(planner: Planner, ask: AskMessage, pose: Pose | None) -> Asked:
    """Look up at the service what the answer to an ask needs; may take its time."""
    if ask.ask is Ask.GOAL and ask.goal is not None:
        where = planner.where(ask.goal)
        name = ask.goal if isinstance(ask.goal, str) else ""
        return Asked(ask.ask, ask.id, None if where is None else tuple(map(float, where)), name)
    if ask.ask is Ask.AROUND and pose is not None:
        return Asked(ask.ask, ask.id, free=planner.around(pose))
    return Asked(ask.ask, ask.id)


@dataclass(slots=True)
class _Waiting:
    """What keeps the person from walking.

    Attributes:
        since: Since when, or since another way was last asked for [s]; None while he walks.
        stands: Since when, however often another way was asked for [s].
        known: When there was a reason for it last [s].
        tries: Ways that were asked for.
        at: Where the last one was [m].
    """

    since: float | None = None
    stands: float = inf
    known: float = -inf
    tries: int = 0
    at: FloatArray = field(default_factory=lambda: np.full(3, np.inf))


@dataclass(slots=True)
class _Block:
    """What new thing stopped the person, until when he waits for it, for how long, where, where told [s], [m]."""

    by: Instruction | None = None
    until: float = -np.inf
    clear_for: float = CLEAR_FOR[0]
    at: FloatArray = field(default_factory=lambda: np.full(3, np.inf))
    told_at: FloatArray = field(default_factory=lambda: np.full(3, np.inf))

    def is_passed(self, place: FloatArray) -> bool:
        """Whether one is led past a thing that he was told of."""
        return bool(np.hypot(*(self.told_at - place)[:2]) < PASSED)

    def again(self, by: Instruction, now: float, place: FloatArray) -> None:
        """It stops him now."""
        if now >= self.until:
            near = bool(np.hypot(*(self.at - place)[:2]) < GETS_ON)
            self.clear_for = min(2.0 * self.clear_for, CLEAR_FOR[1]) if near else CLEAR_FOR[0]
        self.by, self.until, self.at = by, now + self.clear_for, place


@dataclass(slots=True)
class _Talk:
    """What the person and the guide have agreed on, and what is still to be answered.

    Attributes:
        climb: The highest step that the person agrees to [m].
        question: What the guide has asked, and the ways that it is about; None without one.
        since: When it asked [s].
        declined: Whether a high step was declined, so that ways without it are all that is taken.
        paused: Whether the person wants to stand.
        replies: Answers that are still to be said.
        overview: What is said of the way before its first step; None when that is done.
        sets_off: Whether that was heard and no step has been made since.
    """

    climb: float = LEVEL_STEP
    question: tuple[Instruction, Planned] | None = None
    since: float = 0.0
    declined: bool = False
    paused: bool = False
    replies: list[Instruction] = field(default_factory=list)
    overview: Instruction | None = None
    sets_off: bool = False


class Guide:
    """Leads one person; fed with poses and asked for cues. Holds no thread and no clock.

    Args:
        planner: Where routes come from.
        goal: (x, y) or (x, y, z of the ground) [m].
        language: Of the sentences.
        unit: "metres" or "steps".
        name: Of the goal, as the person calls it.
        manner: How the person wants to be led, instead of language and unit.

    Attributes:
        felt: Whether somebody feels the cues; if not, every stop is spoken at once.
        manner: How the person wants to be led; asks change it.
        patient: Whether to wait for the first pose for ever: who opens the page has to find his place first.
    """

    def __init__(
        self,
        planner: Planner,
        goal: Sequence[float],
        language: str = "en",
        unit: str = "metres",
        *,
        name: str = "",
        manner: Manner | None = None,
    ) -> None:
        self.planner, self.goal, self.name = planner, tuple(map(float, goal)), name
        self.manner = manner or Manner(language, unit)
        self.route: Route | None = None
        self.outcome, self.reason = Outcome.WALKING, ""
        self.routes: list[Route] = []
        self.obstacles: FloatArray | None = None
        self._moving: FloatArray | None = None
        self._announcer = Announcer(lambda instruction: phrase(instruction, self.manner))
        self._talk = _Talk()
        self._s, self._waiting, self._told_to_stop = 0.0, _Waiting(), False
        self._moved, self._moved_at = 0.0, np.full(2, np.inf)
        self._trusted: Pose | None = None
        self._planned_at: Pose | None = None
        self._belief: Belief | None = None
        self._steps = StepLength()
        self._pace, self._told_at = 0.0, 0.0
        self._turning, self._turn_seen, self._settled = False, 0.0, -np.inf
        self._block = _Block()
        self._off_way, self._alone, self._version = False, False, 0
        self._gave_up = Instruction(Kind.GAVE_UP, Urgency.DANGER)
        self.felt, self.patient = True, False
        self._then, self._clock = float("inf"), 0.0  # time that goes back is none

    def see(self, obstacles: FloatArray | None, moving: FloatArray | None = None) -> None:
        """Tell of things that stand in the scene and that the service does not know.

        Args:
            obstacles: All of them, shape (k, 3) [m].
            moving: Those of them that move, shape (m, 3) [m].
        """
        self.obstacles, self._moving = obstacles, moving

    def hear(self, version: int | None) -> None:
        """Tell which version the scene has, as `Planner.pulse` says it; None stops the person: nobody plans for him."""
        self._alone, self._version = version is None, version or self._version

    @property
    def climb(self) -> float:
        """The highest step that the person agrees to [m]."""
        return self._talk.climb

    @property
    def question(self) -> Kind | None:
        """What the person is asked and has not answered."""
        return None if self._talk.question is None else self._talk.question[0].kind

    def ask(self, asked: Asked) -> None:
        """Hear what the person asks; `step` answers it."""
        reply = self._reply(asked)
        if reply is not None:
            self._talk.replies.append(replace(reply, reply_to=asked.id))

    def step(self, pose: Pose | None, now: float) -> tuple[CueMessage, tuple[Instruction, str] | None]:
        """What to do and what to say now. Quick: it asks the service nothing.

        Args:
            pose: The newest pose; None before the first.
            now: On the clock of its stamp [s].
        """
        went_on = max(0.0, now - self._then)
        self._clock, self._then = self._clock + went_on, now
        advice = self._held(self._settle(self._blocked(self._advise(pose, now))))
        self._notice(advice)
        said = self._announcer.choose((*self._talk.replies, *self._worth_saying(advice)), self._clock)
        if said is not None:
            self._said(said[0])
        waits = self._told_to_stop and advice.action in WALKS  # "stop" is still in his ear: "go on" comes next
        if waits or any(self._is_unheard(one) for one in advice.instructions):
            advice = replace(advice, action=CueAction.STOP, pace=0.0)  # nor does he go towards a step unheard
        if advice.action in WALKS:
            self._talk.sets_off = False
        self._pace = max(advice.pace, self._pace - BRAKES * went_on)
        cue = CueMessage(
            action=advice.action,
            direction=advice.direction,
            urgency=advice.urgency,
            pace=advice.pace * self.manner.pace,
            distance=0.0 if self.route is None else self.route.length - advice.progress.s,
            stamp=now,
            pose_stamp=0.0 if self._trusted is None else self._trusted.stamp,
        )
        return cue, said

    def _said(self, one: Instruction) -> None:
        if one.reply_to is not None:
            self._talk.replies = [reply for reply in self._talk.replies if reply is not one]
        else:
            self._told_to_stop = one.kind in STOPS
            if one.kind is Kind.STOP_OBSTACLE and self._trusted is not None:
                self._block.told_at = np.array(self._trusted.position)
        self._told_at = self._s

    def _is_unheard(self, one: Instruction) -> bool:
        step = is_hidden_step(one) or is_edge(one)
        return step and not self._announcer.has_told(one, self._clock)

    def _advise(self, pose: Pose | None, now: float) -> Advice:
        here_is = Progress(self._s, 0.0)
        if self.outcome is Outcome.SAFE_STOP:
            return stop(here_is, self._gave_up)
        if self.outcome is Outcome.ARRIVED:
            return Advice(here_is, CueAction.ARRIVED)
        if self._alone:
            return stop(here_is, Instruction(Kind.STOP_ALONE, Urgency.DANGER))
        if pose is None:
            waits = Instruction(Kind.STOP_NO_POSE, Urgency.DANGER)
            return Advice(here_is, CueAction.STOP) if self._not_begun else stop(here_is, waits)
        if (reason := doubt(pose, self._trusted, now)) is not None:
            return stop(here_is, reason)
        if self._belief is None or pose is not self._trusted:
            self._belief = believe(self._belief, pose, self._pace)
        self._trusted = pose
        if self.route is None:
            return Advice(here_is, CueAction.STOP)
        if self._version > self.route.version:
            return stop(here_is, Instruction(Kind.STOP_OFF_WAY, Urgency.DANGER), off_way=True)
        advice = advise(
            self.route,
            self._belief.pose,
            now,
            near=self._s,
            obstacles=self.obstacles,
            moving=self._moving,
            turning=OVER_TURN if self._turning else None,
            told=self._pace,
        )
        self._s = advice.progress.s
        self._learn(pose, advice)
        return advice

    @property
    def _not_begun(self) -> bool:
        return self.patient and self._trusted is None

    def _learn(self, pose: Pose, advice: Advice) -> None:
        """The length of the person's steps, where he walks straight on over level ground."""
        assert self.route is not None
        stairs = (FeatureKind.STAIRS, FeatureKind.STEP)
        on = any(one.kind in stairs and one.start - 1.0 <= self._s <= one.end + 1.0 for one in self.route.features)
        level = advice.action is CueAction.GO and not on
        self._steps = learn(self._steps, self._s, pose.steps, level=level)
        self.manner = replace(self.manner, step_length=self._steps.length)

    def _blocked(self, advice: Advice) -> Advice:
        """Who was stopped by something new waits until it has been gone for a moment: it may come back."""
        new = next((one for one in advice.instructions if one.kind in BLOCKS), None)
        if new is not None and self._trusted is not None:
            self._block.again(new, self._clock, np.array(self._trusted.position))
        elif self._block.by is not None and self._clock < self._block.until and advice.action in GOING:
            return stop(advice.progress, self._block.by)
        return advice

    def _settle(self, advice: Advice) -> Advice:
        """Who has been told to end a turn comes to rest before he is told of another one; one pose turns nobody."""
        turns = advice.action is CueAction.TURN
        before, self._turn_seen = self._turn_seen, float(np.sign(advice.direction)) if turns else 0.0
        sure = self._turning or self._turn_seen == before
        if self._turning and not turns:
            self._settled = self._clock + SETTLES
        self._turning = turns and sure and self._clock >= self._settled
        if turns and not self._turning:
            return replace(advice, action=CueAction.STOP, pace=0.0, instructions=())
        return advice

    def _held(self, advice: Advice) -> Advice:
        """What the person is held for: an answer, a pause, the overview of his way. Whatever stops him comes first.

        But not that something is in the way of one who has not set off, nor that a pose of his is missing.
        """
        if advice.action not in (*GOING, CueAction.STOP):
            return advice
        sets_off = self._talk.overview is not None
        dangers = {one.kind for one in advice.instructions if one.urgency is Urgency.DANGER}
        if dangers - (BLOCKS | {Kind.STOP_LOST} if sets_off else set()):
            return advice
        if self._talk.question is not None:
            return Advice(advice.progress, CueAction.STOP, instructions=(self._talk.question[0],))
        if self._talk.paused:
            return Advice(advice.progress, CueAction.STOP)
        if (first := self._talk.overview) is not None:
            if self._announcer.has_told(first, self._clock):
                self._talk.overview, self._talk.sets_off = None, True
            else:
                return Advice(advice.progress, CueAction.STOP, instructions=(first,))
        return advice

    def _worth_saying(self, advice: Advice) -> tuple[Instruction, ...]:
        """What stops the feet for a moment only is no news; who was told to stop is told to go on."""
        waited = 0.0 if self._waiting.since is None else self._clock - self._waiting.stands
        stood = set(WAITING) - (BLOCKS if self._told_to_stop else {Kind.STOP_UNRELIABLE})
        stands = dict.fromkeys(stood, STANDS) if self._told_to_stop or self._talk.sets_off else {}
        known = self._trusted is not None and self._block.is_passed(np.array(self._trusted.position))
        passes = {Kind.STOP_OBSTACLE: STANDS} if known and not self._told_to_stop else {}
        patient = (WAITING | passes | stands) if self.felt else {}
        worth = tuple(
            one
            for one in advice.instructions
            if waited >= patient.get(one.kind, 0.0)
            and not (self.felt and self._is_felt(one))
            and self.manner.wants(one.kind)
            and not (one.early and self.manner.detail is Detail.FEW)
        )
        walks = self._told_to_stop and advice.action in WALKS
        resume = (Instruction(Kind.RESUME, Urgency.DANGER),) if walks else ()
        return resume + worth + self._besides(advice, waited)

    def _besides(self, advice: Advice, waited: float) -> tuple[Instruction, ...]:
        """What is said beside the way's own: that all is well, what moves, what the map misses, why it takes long."""
        if self.route is None:
            return ()
        if advice.action is CueAction.STOP:
            waited = min(waited, self._clock - self._waiting.known)
            silent = waited >= (STANDS if self._told_to_stop else UNSURE)
            return (Instruction(Kind.STOP_UNSURE, Urgency.DANGER),) if silent else ()
        if advice.action not in WALKS:
            return ()
        found = find_reassurance(self.route, advice.progress, self._told_at)
        if self._moving is not None and self._belief is not None:
            left = self.route.length - advice.progress.s
            found += [one for one in moves_near(self._belief.pose, self._moving) if one.distance < left]
        found += unseen(self.route)  # of a new way that misses more than was said of the last one
        return tuple(one for one in found if self.manner.wants(one.kind))

    def _is_felt(self, one: Instruction) -> bool:
        """Whether the cue alone says enough: it leads back before that is said, and it says when to turn, once told."""
        told = replace(one, kind=Kind.TURN_SOON)
        return one.kind is Kind.TURN_BACK or (
            one.kind is Kind.TURN_NOW and self._announcer.has_begun(told, self._clock)
        )

    def _notice(self, advice: Advice) -> None:
        """Arrival, and how long the person has been kept from walking."""
        self._off_way = advice.off_way
        self._waiting.known = self._clock if advice.instructions else self._waiting.known
        if advice.action is CueAction.ARRIVED:
            self.outcome = Outcome.ARRIVED
        waits = self._talk.question is not None or self._talk.paused or self._talk.overview is not None
        danger = any(one.urgency is Urgency.DANGER for one in advice.instructions)
        if advice.action is not CueAction.STOP or (waits and not danger) or self._not_begun:
            self._waiting.since = None
        elif self._waiting.since is None:
            self._waiting.since = self._waiting.stands = self._clock
        elif self._clock - self._waiting.since > LOST:
            blocked = BLOCKS & {one.kind for one in advice.instructions}
            kind = Kind.GAVE_UP_HELD_UP if blocked else Kind.GAVE_UP_LOST if danger else Kind.GAVE_UP
            self.give_up("no good pose, no planner, or held up, for too long", kind)
        if self._talk.question is not None and self._clock - self._talk.since > UNANSWERED:
            self.give_up("no answer to a question", Kind.NO_ANSWER)
        if self._trusted is None:
            return
        place = np.array(self._trusted.position)
        if np.hypot(*(self._waiting.at - place)[:2]) > GETS_ON:
            self._waiting.tries = 0
        if waits or np.hypot(*(self._moved_at - place[:2])) > GETS_ON:
            self._moved, self._moved_at = self._clock, place[:2]

    def wants_route(self, pose: Pose | None, now: float) -> bool:
        """Whether `replan` should be called with this pose."""
        if pose is None or self._alone or self.outcome is not Outcome.WALKING or self._talk.question is not None:
            return False
        if doubt(pose, self._trusted, now) is not None:
            return False
        if self.route is None:
            return True
        since = self._waiting.since
        if since is None:
            return self._clock - self._moved > STALLED
        block = self._block.by if self._clock < self._block.until else None
        patience = MOVES_ON if block is not None and block.kind is Kind.STOP_MOVING else PATIENCE
        return self._clock - since >= (OFF_WAY if self._off_way else patience)

    def replan(self, pose: Pose) -> None:
        """Ask the service for a way from here, and wait for it."""
        self.take(self.planner.route(pose, self.goal, self._talk.climb, self.obstacles), pose)

    def take(self, planned: Planned, pose: Pose) -> None:
        """Walk on by a way from `Planner.route`, ask the person for it, or do without.

        Args:
            planned: The way, or why there is none.
            pose: Where it was asked for.
        """
        self._planned_at = pose
        self._waiting.tries += 1
        self._waiting.stands = self._clock if self._waiting.since is None else self._waiting.stands
        self._waiting.since, self._waiting.at = self._clock, np.array(pose.position)
        self._moved = self._clock
        if planned.route is not None and abs(planned.highest) > self._talk.climb + 1e-6:
            self._ask_for(planned)
            return
        if planned.route is not None:
            self._walk(planned.route)
        held_up = self._clock - self._block.until < PATIENCE
        if self._waiting.tries >= (MANY_TRIES if held_up else TRIES) or (planned.route is None and self.route is None):
            self._refuse(replace(planned, refusal=Kind.GAVE_UP_HELD_UP) if held_up else planned)

    def _walk(self, route: Route) -> None:
        if self.route is None and not self.manner.wants(Kind.OVERVIEW):
            self._talk.overview = next(iter(unseen(route)), None)
        elif self.route is None:
            stands = self._trusted or self._planned_at
            turn = 0.0 if stands is None else aim(route, stands, Progress(0.0, 0.0))
            self._talk.overview = overview(route, self.name, self.manner.pace, turn)
        self.route, self._s, self._told_at = route, 0.0, 0.0
        self.routes.append(route)

    def _ask_for(self, planned: Planned) -> None:
        """A step that is too high to be led over unasked: ask, or remember that it was declined."""
        assert planned.route is not None
        if self._talk.declined:
            self._decline(planned)
            return
        one = Instruction(Kind.ASK_STEP, Urgency.ACT, distance=planned.route.length, amount=planned.highest)
        if planned.instead is not None:
            longer = Instruction(Kind.HOW_FAR, Urgency.INFORM, distance=planned.instead.length)
            one = replace(one, kind=Kind.ASK_STEP_OR_DETOUR, then=(longer,))
        self._talk.question, self._talk.since = (one, planned), self._clock

    def _decline(self, planned: Planned) -> None:
        self._talk.declined = True
        if planned.instead is not None:
            self._walk(planned.instead)
        else:
            self.give_up("no way without a high step", Kind.NO_WAY_STEP, amount=self._talk.climb)

    def _answer(self, *, agrees: bool) -> Instruction | None:
        """What the person says to the question."""
        if self._talk.question is None:
            return Instruction(Kind.NOT_ASKED, Urgency.ACT)
        (_, planned), self._talk.question = self._talk.question, None
        self._waiting.since = None
        if not agrees:
            self._decline(planned)
            return Instruction(Kind.DECLINED, Urgency.ACT) if planned.instead is not None else None
        assert planned.route is not None
        self._talk.climb = max(self._talk.climb, abs(planned.highest))
        self._walk(planned.route)
        return Instruction(Kind.CONSENTED, Urgency.ACT)

    def _reply(self, asked: Asked) -> Instruction | None:
        what = asked.what
        if what in MANNERS:
            self.manner = changed(self.manner, what)
            return Instruction(MANNERS[what], Urgency.ACT)
        if what in (Ask.YES, Ask.NO):
            return self._answer(agrees=what is Ask.YES)
        if what in (Ask.PAUSE, Ask.GO_ON):
            self._talk.paused = what is Ask.PAUSE
            return Instruction(Kind.PAUSED if self._talk.paused else Kind.RESUME, Urgency.ACT)
        if what is Ask.GOAL:
            return self._new_goal(asked)
        if what is Ask.REPEAT:
            return self._again()
        return self._facts(asked)

    def _again(self) -> Instruction:
        """The last sentence, as it is true here."""
        if self._announcer.last is None:
            return Instruction(Kind.NOTHING_SAID, Urgency.ACT)
        one, walked = self._announcer.last[0], self._s - self._told_at
        first, soon = (None if part is None else _nearer(part, walked) for part in (one.first, one.soon))
        return replace(_nearer(one, walked), first=first, soon=soon, resumes=False, reply_to=None)

    def _facts(self, asked: Asked) -> Instruction:
        """Where the person is, what is around him, how far it is."""
        if self._belief is None:
            return Instruction(Kind.STOP_NO_POSE, Urgency.ACT)
        if self.route is None:
            return Instruction(Kind.NEW_GOAL, Urgency.ACT, name=self.name)
        pose, pace = self._belief.pose, self.manner.pace
        if asked.what is Ask.WHERE:
            return here(self.route, self._s, pose, pace)
        if asked.what is Ask.AROUND and asked.free:
            return Instruction(Kind.AROUND, Urgency.ACT, free=asked.free)
        return how_far(self.route, self._s, pace)

    def _new_goal(self, asked: Asked) -> Instruction:
        """Another goal; a person who had arrived or was stopped for good walks again."""
        if asked.goal is None:
            return Instruction(Kind.UNKNOWN_GOAL, Urgency.ACT, name=asked.name)
        self.goal, self.name = asked.goal, asked.name
        self.route, self._s, self.outcome, self.reason = None, 0.0, Outcome.WALKING, ""
        self._talk = replace(self._talk, question=None, declined=False, overview=None)
        self._waiting = _Waiting()
        return Instruction(Kind.NEW_GOAL, Urgency.ACT, name=asked.name)

    def _refuse(self, planned: Planned) -> None:
        why = planned.why or "no way that can be walked safely"
        tight = planned.refusal is Kind.NO_WAY_TIGHT
        self.give_up(why, planned.refusal, amount=planned.room, distance=LEAST_ROOM if tight else 0.0)

    def give_up(self, reason: str, kind: Kind = Kind.GAVE_UP, *, amount: float = 0.0, distance: float = 0.0) -> None:
        """Stop for good: the person stays and asks for help.

        Args:
            reason: In words for a log.
            kind: What the person is told.
            amount: Put into the sentence [m].
            distance: The same [m].
        """
        self.outcome, self.reason = Outcome.SAFE_STOP, reason
        self._gave_up = Instruction(kind, Urgency.DANGER, amount=amount, distance=distance)


def _nearer(one: Instruction, walked: float) -> Instruction:
    """The same told later on the way."""
    return replace(one, distance=max(0.0, one.distance - walked))

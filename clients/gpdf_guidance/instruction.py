"""One thing to say to a person: what, how soon, and where it is."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum, StrEnum


class Urgency(IntEnum):
    """How soon something must be said."""

    INFORM = 0
    PREPARE = 1
    ACT = 2
    DANGER = 3


class Kind(StrEnum):
    """What is said; every language's catalogue has a sentence for each."""

    STOP_LOST = "stop_lost"
    STOP_NO_POSE = "stop_no_pose"
    STOP_UNRELIABLE = "stop_unreliable"
    STOP_ALONE = "stop_alone"
    STOP_OBSTACLE = "stop_obstacle"
    STOP_MOVING = "stop_moving"
    STOP_OFF_WAY = "stop_off_way"
    STOP_UNSURE = "stop_unsure"
    GAVE_UP = "gave_up"
    GAVE_UP_LOST = "gave_up_lost"
    GAVE_UP_HELD_UP = "gave_up_held_up"
    NO_WAY = "no_way"
    NO_WAY_TIGHT = "no_way_tight"
    NO_WAY_START = "no_way_start"
    NO_WAY_GOAL = "no_way_goal"
    NO_WAY_STEP = "no_way_step"
    NO_ANSWER = "no_answer"
    ASK_STEP = "ask_step"
    ASK_STEP_OR_DETOUR = "ask_step_or_detour"
    CONSENTED = "consented"
    DECLINED = "declined"
    OVERVIEW = "overview"
    ARRIVED = "arrived"
    ARRIVED_BESIDE = "arrived_beside"
    STEP = "step"
    STEP_EDGE = "step_edge"
    STAIRS = "stairs"
    STAIRS_EDGE = "stairs_edge"
    ON_STAIRS = "on_stairs"
    STAIRS_END = "stairs_end"
    TURN_NOW = "turn_now"
    TURN_BACK = "turn_back"
    TURN_SOON = "turn_soon"
    GO_ON = "go_on"
    RESUME = "resume"
    STRAIGHT = "straight"
    OPENING = "opening"
    NARROW = "narrow"
    HEAD = "head"
    UNSEEN = "unseen"
    RAMP = "ramp"
    BEAR = "bear"
    PASS = "pass"
    MOVING = "moving"
    LOW_UNSEEN = "low_unseen"
    PAUSED = "paused"
    HERE = "here"
    AROUND = "around"
    HOW_FAR = "how_far"
    NEW_GOAL = "new_goal"
    UNKNOWN_GOAL = "unknown_goal"
    SLOWER = "slower"
    FASTER = "faster"
    MORE_WORDS = "more_words"
    FEWER_WORDS = "fewer_words"
    NOT_ASKED = "not_asked"
    NOTHING_SAID = "nothing_said"


class Side(StrEnum):
    """Where something is, as a person counts it."""

    AHEAD = "ahead"
    RIGHT = "right"
    BEHIND = "behind"
    LEFT = "left"
    BOTH = "both"


@dataclass(frozen=True, slots=True)
class Instruction:
    """One thing to say.

    Attributes:
        kind: What.
        urgency: How soon.
        place: Where what it speaks of is (x, y) [m], so that the same thing is not said twice.
        last: Of stairs, where their last edge is (x, y) [m]: the same all the way over them.
        distance: Along the way to there [m].
        amount: As in `Feature`; for turns the angle to the left [rad]; of a refusal, the room or the height [m].
        count: Number of steps; in an overview, of turns.
        after: So far behind the end of stairs that the person has not left yet [m]; None if it is not behind any.
        ends: The stairs before it end here: that is told with it.
        early: Told well before, at the distance that guides' users asked for; it is told again when it is near.
        first: A turn right before it, which is told in the same breath.
        then: What comes after it, told in the same breath.
        soon: Of an overview, what is to be done so soon that it is told with it.
        name: Of the place that it is at; of the goal.
        side: Where it is, or where the handrail is.
        free: How far it is free ahead, to the right, behind and to the left [m].
        seconds: That the way takes about [s].
        reply_to: Id of the ask that it answers; None where nobody asked.
        resumes: Told to who was told to stop and goes on now: that is told with it.
    """

    kind: Kind
    urgency: Urgency
    place: tuple[float, float] = (0.0, 0.0)
    distance: float = 0.0
    amount: float = 0.0
    count: int = 1
    after: float | None = None
    ends: bool = False
    early: bool = False
    first: Instruction | None = None
    then: tuple[Instruction, ...] = ()
    soon: Instruction | None = None
    name: str = ""
    side: Side | None = None
    free: tuple[float, ...] = ()
    seconds: float = 0.0
    reply_to: str | None = None
    last: tuple[float, float] | None = None
    resumes: bool = False

    @property
    def leaves_stairs(self) -> bool:
        """Whether it says that stairs end."""
        return self.ends or self.kind is Kind.STAIRS_END

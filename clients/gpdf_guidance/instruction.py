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
    """What is said; the message catalogue has a sentence for each."""

    STOP_LOST = "stop_lost"
    STOP_UNRELIABLE = "stop_unreliable"
    STOP_ALONE = "stop_alone"
    STOP_OBSTACLE = "stop_obstacle"
    STOP_OFF_WAY = "stop_off_way"
    GAVE_UP = "gave_up"
    ARRIVED = "arrived"
    STEP = "step"
    STAIRS = "stairs"
    STAIRS_END = "stairs_end"
    TURN_NOW = "turn_now"
    TURN_BACK = "turn_back"
    TURN_SOON = "turn_soon"
    GO_ON = "go_on"
    RESUME = "resume"
    NARROW = "narrow"
    HEAD = "head"
    RAMP = "ramp"
    BEAR = "bear"
    LOW_UNSEEN = "low_unseen"


@dataclass(frozen=True, slots=True)
class Instruction:
    """One thing to say.

    Attributes:
        kind: What.
        urgency: How soon.
        place: Where what it speaks of is (x, y) [m], so that the same thing is not said twice.
        distance: Along the way to there [m].
        amount: As in `Feature`; for turns the angle to the left [rad].
        count: Number of steps.
        after: So far behind the end of stairs that the person has not left yet [m]; None if it is not behind any.
        ends: The stairs before it end here: that is told with it.
        first: A turn right before it, which is told in the same breath.
    """

    kind: Kind
    urgency: Urgency
    place: tuple[float, float] = (0.0, 0.0)
    distance: float = 0.0
    amount: float = 0.0
    count: int = 1
    after: float | None = None
    ends: bool = False
    first: Instruction | None = None

    @property
    def leaves_stairs(self) -> bool:
        """Whether it says that stairs end."""
        return self.ends or self.kind is Kind.STAIRS_END

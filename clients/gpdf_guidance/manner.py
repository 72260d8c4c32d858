"""How a person wants to be spoken to and led: language, how much is said, in what units, how fast."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum

from gpdf_schemas import Ask

from gpdf_guidance.instruction import Kind

STEP_LENGTH = 0.62
"""[m] Of a person who walks with a cane, until his own has been learned (see `gpdf_guidance.steps`)."""
SLOWER = 0.7
"""Share of the pace that "slower" leaves."""
SLOWEST = SLOWER**3
"""Below this nobody walks any more."""


class Detail(IntEnum):
    """How much is said."""

    FEW = 0
    NORMAL = 1
    MANY = 2


LEAST_DETAIL: dict[Kind, Detail] = {
    Kind.OVERVIEW: Detail.NORMAL,
    Kind.STRAIGHT: Detail.NORMAL,
    Kind.GO_ON: Detail.NORMAL,
    Kind.OPENING: Detail.NORMAL,
    Kind.RAMP: Detail.NORMAL,
    Kind.MOVING: Detail.NORMAL,
    Kind.PASS: Detail.NORMAL,
    Kind.BEAR: Detail.MANY,
}
"""From which on a kind is said; what is not named here is said always: safety is no detail."""


@dataclass(frozen=True, slots=True)
class Manner:
    """How one person wants it.

    Attributes:
        language: One of `LANGUAGES`.
        unit: Of distances, "metres" or "steps".
        detail: How much is said.
        clock: Directions by the face of a clock, 12 is straight ahead.
        step_length: The person's own [m].
        pace: Share of the pace that would be safe.
    """

    language: str = "en"
    unit: str = "metres"
    detail: Detail = Detail.NORMAL
    clock: bool = False
    step_length: float = STEP_LENGTH
    pace: float = 1.0

    def wants(self, kind: Kind) -> bool:
        """Whether a kind is said."""
        return self.detail >= LEAST_DETAIL.get(kind, Detail.FEW)


def changed(manner: Manner, ask: Ask) -> Manner:
    """The manner after slower, faster, more words or fewer words."""
    if ask is Ask.MORE_WORDS:
        return replace(manner, detail=Detail(min(Detail.MANY, manner.detail + 1)))
    if ask is Ask.FEWER_WORDS:
        return replace(manner, detail=Detail(max(Detail.FEW, manner.detail - 1)))
    factor = {Ask.SLOWER: SLOWER, Ask.FASTER: 1 / SLOWER}.get(ask, 1.0)
    return replace(manner, pace=min(1.0, max(SLOWEST, manner.pace * factor)))

"""What a guide says to a person, and what the person asks it: streams, as sentences and as words of a fixed list."""

from __future__ import annotations

from enum import StrEnum

import msgspec


class Ask(StrEnum):
    """What a person asks of a guide; each is answered by a sentence."""

    REPEAT = "repeat"
    WHERE = "where"
    AROUND = "around"
    HOW_FAR = "how_far"
    PAUSE = "pause"
    GO_ON = "go_on"
    GOAL = "goal"
    SLOWER = "slower"
    FASTER = "faster"
    MORE_WORDS = "more_words"
    FEWER_WORDS = "fewer_words"
    YES = "yes"
    NO = "no"


class SayMessage(msgspec.Struct, frozen=True, kw_only=True):
    """One sentence for a person, on `keys.SAY`/NAME; to be spoken one at a time, the most urgent first.

    Attributes:
        id: Unique for this person; the same sentence said again has another one.
        text: To be spoken as it is.
        language: Of the text, a BCP 47 tag.
        kind: What is said, a word that stays the same in all languages; a kind that one does not know is spoken, too.
        urgency: 0 to know, 1 to be ready, 2 to do now, 3 danger: what is more urgent cuts off what is being spoken.
        about: (x, y) or (x, y, z) of what it speaks of [m]; None where it is about no place.
        stamp: When it was said, since 1970 [s].
        valid_until: Not to be begun after this, since 1970 [s]: the person is somewhere else then.
        answers: What the person may answer; empty where nothing is asked.
        reply_to: Id of the `AskMessage` that it answers; empty where nobody asked.
    """

    id: str
    text: str
    language: str
    kind: str
    urgency: int
    about: list[float] | None = None
    stamp: float = 0.0
    valid_until: float = 0.0
    answers: list[Ask] = []
    reply_to: str = ""


class AskMessage(msgspec.Struct, frozen=True, kw_only=True):
    """What a person asks of the guide, on `keys.ASK`/NAME.

    Attributes:
        ask: What.
        id: Chosen by who sends it; given back in the answer's `reply_to`.
        goal: Of `Ask.GOAL`: (x, y) or (x, y, z of the ground) [m], or the name of one of the scene's places.
        stamp: When it was asked, since 1970 [s].
    """

    ask: Ask
    id: str = ""
    goal: list[float] | str | None = None
    stamp: float = 0.0

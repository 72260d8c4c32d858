"""How long a sentence takes to be spoken, never less than it does: who counts on a prompt must have heard all of it."""

from __future__ import annotations

import re

LETTER = 0.058
"""[s] A letter or a blank takes, at 180 words a minute."""
DIGIT = 0.22
"""[s] A digit takes, and the point of "0.5": a number is longer to hear than to read."""
PAUSE = 0.2
"""[s] At each comma, colon, or end of a sentence that another one follows."""
BEGINS = 0.3
"""[s] Until a voice is heard; a browser's takes as long."""
NUMERAL = re.compile(r"\d|(?<=\d)[.,](?=\d)")
INNER_PAUSE = re.compile(r"[.,:?](?= )")


def spoken_in(text: str) -> float:
    """Time from the order to speak to a sentence's end [s].

    The constants are an upper bound of what `gpdf bench spoken` measures in each language.
    """
    numerals, pauses = len(NUMERAL.findall(text)), len(INNER_PAUSE.findall(text))
    return BEGINS + LETTER * (len(text) - numerals) + DIGIT * numerals + PAUSE * pauses

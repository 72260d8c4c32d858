"""`gpdf bench spoken`: every sentence in every language, read aloud by espeak-ng, and how long that takes.

A sentence that is heard while walking must be over before what it speaks of is reached; and the guide may not count on
one before it is over, so that what it reckons with (`spoken_in`) is never less than what a voice needs.
"""

from __future__ import annotations

import argparse
import io
import subprocess
import wave
from dataclasses import replace
from math import pi

import numpy as np
from gpdf_guidance import LANGUAGES, Instruction, Kind, Manner, Side, Urgency, phrase
from gpdf_guidance.advice import NEAR_STEP, PACES
from gpdf_guidance.ahead import OTHER_WINDOW, STEP_WINDOW, TURN_WINDOW
from gpdf_guidance.speech import spoken_in
from gpdf_guidance.voice import WORDS_PER_MINUTE

from gpdf_service.bench.report import Row, show

QUIET = 200
"""Of 32767: what is no louder is silence."""
TO_STEPS = (STEP_WINDOW[1] - NEAR_STEP) / PACES[0] + NEAR_STEP / PACES[1]
"""[s] From the place where stairs are told of to the first edge: slowly at last."""
WITHIN = {
    Kind.TURN_SOON: TURN_WINDOW[1] / PACES[0],
    **dict.fromkeys((Kind.OPENING, Kind.NARROW, Kind.HEAD, Kind.RAMP, Kind.BEAR), OTHER_WINDOW[1] / PACES[0]),
    **dict.fromkeys((Kind.STEP, Kind.STAIRS), TO_STEPS),
    Kind.UNSEEN: (OTHER_WINDOW[1] - NEAR_STEP) / PACES[0] + NEAR_STEP / PACES[1],
}
"""[s] What is told of something ahead, and how soon that may be reached."""
AMOUNTS = {
    **dict.fromkeys((Kind.TURN_NOW, Kind.TURN_SOON), -0.5 * pi),
    **dict.fromkeys((Kind.NO_WAY_TIGHT, Kind.LOW_UNSEEN), 0.07),
    **dict.fromkeys((Kind.ASK_STEP, Kind.ASK_STEP_OR_DETOUR), -0.35),
    Kind.NO_WAY_STEP: 0.2,
}
"""What is put into the examples, as in `Instruction`; of what is not named here, the rise of a stair."""
RISER = 0.17
NAMED = (Kind.PASS, Kind.HERE, Kind.NEW_GOAL, Kind.UNKNOWN_GOAL)


def example(kind: Kind) -> Instruction:
    """A sentence of a kind as it may be said, with all that it may have, stairs with their handrail."""
    rest = Instruction(Kind.HOW_FAR, Urgency.INFORM, distance=20.0, seconds=40.0)
    one = Instruction(kind, Urgency.ACT, distance=2.6, amount=AMOUNTS.get(kind, RISER), count=12, seconds=75.0)
    if kind in (Kind.STAIRS, Kind.STAIRS_EDGE):
        return replace(one, side=Side.RIGHT)
    if kind is Kind.OVERVIEW:
        climbs = tuple(replace(one, kind=Kind.STAIRS, amount=RISER) for _ in range(2))
        soon = replace(one, kind=Kind.TURN_SOON, amount=0.5 * pi)
        return replace(one, distance=14.0, count=3, then=climbs, soon=soon)
    if kind is Kind.STAIRS_END:
        return replace(one, then=(Instruction(Kind.GO_ON, Urgency.INFORM, distance=4.2),))
    if kind is Kind.NO_WAY_TIGHT:
        return replace(one, distance=0.08)
    one = replace(one, name="Gate 4") if kind in NAMED else one
    return replace(one, then=(rest,), side=Side.LEFT, free=(0.2, 1.0, 2.0, 3.0))


def read_aloud(text: str, language: str) -> float:
    """How long espeak-ng speaks [s].

    Raises:
        FileNotFoundError: it is not installed.
    """
    command = ["espeak-ng", "-v", language, "-s", str(WORDS_PER_MINUTE), "--stdout", "--", text]
    spoken = subprocess.run(command, stdout=subprocess.PIPE, check=True).stdout
    with wave.open(io.BytesIO(spoken)) as sound:
        rate, header = sound.getframerate(), len(spoken) - 2 * (len(spoken) // 2 - 22)
    loud = np.flatnonzero(np.abs(np.frombuffer(spoken[header:], dtype="<i2").astype(float)) > QUIET)
    return float(loud[-1] + 1) / rate if len(loud) else 0.0


def judged(kind: Kind, language: str) -> Row:
    """One sentence: its seconds, those that are counted on, those that there may be, and whether that is enough."""
    text = phrase(example(kind), Manner(language))
    seconds, counted, within = read_aloud(text, language), spoken_in(text), WITHIN.get(kind)
    holds = seconds <= counted and (within is None or counted <= within)
    row: Row = {"language": language, "kind": kind.value, "s": round(seconds, 2), "counted_s": round(counted, 2)}
    return {**row, "within_s": "-" if within is None else round(within, 2), "holds": holds, "sentence": text}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    parser.add_argument("--language", action="append", choices=LANGUAGES, help="all when not given")
    parser.add_argument("--json", action="store_true", help="print the rows as JSON")


def run(args: argparse.Namespace) -> int:
    """Exit code 0 if every sentence is over in time."""
    rows = [judged(kind, language) for language in args.language or LANGUAGES for kind in Kind]
    show(rows, as_json=args.json)
    return 0 if all(row["holds"] for row in rows) else 1

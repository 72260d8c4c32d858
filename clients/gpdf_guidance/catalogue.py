"""Sentences, short enough to be heard while walking, in English and German."""

from __future__ import annotations

from dataclasses import dataclass
from math import degrees

from gpdf_guidance.instruction import Instruction, Kind

STEP_LENGTH = 0.65
"""[m] Of a person who walks with a cane."""
HALF = 0.5
"""[m] Distances are told in these."""
SLIGHT, ROUND = 50.0, 150.0
"""[°] Below, a turn is slight; above, it is a turn around."""


@dataclass(frozen=True, slots=True)
class Words:
    """One language: its sentences, and the words that are put into them."""

    sentences: dict[Kind, str]
    left: str
    right: str
    slightly: str
    around: str
    up: str
    down: str
    metre: str
    metres: str
    step: str
    steps: str
    point: str
    within: str
    right_ahead: str
    after: str
    then: str


ENGLISH = Words(
    {
        Kind.STOP_LOST: "Stop. I have lost your position.",
        Kind.STOP_UNRELIABLE: "Stop. Your position is uncertain.",
        Kind.STOP_ALONE: "Stop. I have no connection.",
        Kind.STOP_OBSTACLE: "Stop. Something is in the way.",
        Kind.STOP_OFF_WAY: "Stop. I look for a new way.",
        Kind.GAVE_UP: "Stay here. I find no safe way. Please ask for help.",
        Kind.ARRIVED: "You have arrived.",
        Kind.STEP: "{where}, step {vertical}, {height} centimetres.",
        Kind.STAIRS: "{where}, stairs {vertical}, {count} steps.",
        Kind.STAIRS_END: "The stairs end.",
        Kind.TURN_NOW: "Turn {side}.",
        Kind.TURN_BACK: "Too far. A little back to the {side}.",
        Kind.TURN_SOON: "{where}, turn {side}.",
        Kind.GO_ON: "Good. Straight on, {distance}.",
        Kind.RESUME: "Go on.",
        Kind.NARROW: "Narrow passage ahead, {width} centimetres. Go slowly.",
        Kind.HEAD: "Mind your head, obstacle on the {side}.",
        Kind.RAMP: "{where}, ramp {vertical}.",
        Kind.BEAR: "Keep {side}.",
        Kind.LOW_UNSEEN: "The map misses what is lower than {height} centimetres.",
    },
    "left", "right", "slightly {side}", "around", "up", "down", "metre", "metres", "step", "steps", ".",
    "In {distance}", "Right ahead", "After these stairs: {sentence}", "Then",
)  # fmt: skip
GERMAN = Words(
    {
        Kind.STOP_LOST: "Halt. Ich habe Ihre Position verloren.",
        Kind.STOP_UNRELIABLE: "Halt. Ihre Position ist unsicher.",
        Kind.STOP_ALONE: "Halt. Ich habe keine Verbindung.",
        Kind.STOP_OBSTACLE: "Halt. Etwas steht im Weg.",
        Kind.STOP_OFF_WAY: "Halt. Ich suche einen neuen Weg.",
        Kind.GAVE_UP: "Bleiben Sie hier. Ich finde keinen sicheren Weg. Bitten Sie um Hilfe.",
        Kind.ARRIVED: "Sie sind da.",
        Kind.STEP: "{where} Stufe {vertical}, {height} Zentimeter.",
        Kind.STAIRS: "{where} Treppe {vertical}, {count} Stufen.",
        Kind.STAIRS_END: "Ende der Treppe.",
        Kind.TURN_NOW: "Drehung {side}.",
        Kind.TURN_BACK: "Zu weit. Etwas zurück nach {side}.",
        Kind.TURN_SOON: "{where} Drehung {side}.",
        Kind.GO_ON: "Gut. Geradeaus, {distance}.",
        Kind.RESUME: "Weiter.",
        Kind.NARROW: "Engstelle voraus, {width} Zentimeter. Gehen Sie langsam.",
        Kind.HEAD: "Vorsicht, Hindernis in Kopfhöhe {side}.",
        Kind.RAMP: "{where} Rampe {vertical}.",
        Kind.BEAR: "Halten Sie sich {side}.",
        Kind.LOW_UNSEEN: "Was niedriger als {height} Zentimeter ist, fehlt in der Karte.",
    },
    "links", "rechts", "leicht {side}", "ganz herum", "aufwärts", "abwärts", "Meter", "Metern",
    "Schritt", "Schritten", ",",
    "In {distance}", "Direkt vor Ihnen", "Nach dieser Treppe: {sentence}", "Dann",
)  # fmt: skip
LANGUAGES = {"en": ENGLISH, "de": GERMAN}


def phrase(instruction: Instruction, language: str = "en", unit: str = "metres") -> str:
    """Say an instruction.

    Args:
        instruction: What to say.
        language: One of `LANGUAGES`.
        unit: "metres" or "steps".
    """
    words, after = LANGUAGES[language], instruction.after
    metres = instruction.distance if after is None else after
    at_once = instruction.kind is Kind.TURN_SOON and instruction.ends and metres < HALF
    sentence = words.sentences[Kind.TURN_NOW if at_once else instruction.kind].format(
        distance=_distance(metres, words, unit),
        where=words.then if instruction.first is not None else _where(metres, words, unit),
        side=_side(instruction, words),
        vertical=words.up if instruction.amount > 0 else words.down,
        height=round(100 * abs(instruction.amount)),
        width=5 * int(20 * instruction.amount + 1e-6),
        count=instruction.count,
    )
    if instruction.first is not None:
        sentence = f"{phrase(instruction.first, language, unit)} {sentence}"
    if instruction.ends:
        return f"{words.sentences[Kind.STAIRS_END]} {sentence}"
    return sentence if after is None else words.after.format(sentence=sentence)


def _where(metres: float, words: Words, unit: str) -> str:
    if metres < (STEP_LENGTH if unit == "steps" else HALF):
        return words.right_ahead
    return words.within.format(distance=_distance(metres, words, unit))


def _distance(metres: float, words: Words, unit: str) -> str:
    """How far it is to something, never more than it is: who expects a step too late falls."""
    metres += 1e-6
    if unit == "steps":
        count = max(1, int(metres / STEP_LENGTH))
        return f"{count} {words.step if count == 1 else words.steps}"
    halves = max(1, int(metres / HALF)) if metres < 3 else 2 * int(metres)
    number = f"{halves // 2}" if halves % 2 == 0 else f"{halves / 2:.1f}".replace(".", words.point)
    return f"{number} {words.metre if halves == 2 else words.metres}"


def _side(instruction: Instruction, words: Words) -> str:
    side = words.left if instruction.amount > 0 else words.right
    if instruction.kind not in (Kind.TURN_NOW, Kind.TURN_SOON):
        return side
    angle = degrees(abs(instruction.amount))
    if angle > ROUND:
        return words.around
    return words.slightly.format(side=side) if angle < SLIGHT else side

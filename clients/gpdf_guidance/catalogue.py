"""Sentences, short enough to be heard while walking; each language is a file that a translator fills."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from importlib import resources
from math import ceil, degrees

from gpdf_guidance.instruction import Instruction, Kind, Side
from gpdf_guidance.manner import Manner

HALF = 0.5
"""[m] Distances are told in these."""
SLIGHT, ROUND = 50.0, 150.0
"""[°] Below, a turn is slight; above, it is a turn around."""
HOUR = 30.0
"""[°] Of the face of a clock."""
NEAR, FAR = 0.5, 3.0
"""[m] What is nearer is within reach of an arm; what is further off is no news to a person who stands."""
SHORT_TIME, LONG_TIME = 50.0, 90.0
"""[s] Below the first a time is told in tens of seconds; from the second on in minutes, between them as one."""
WITH_RAIL = (Kind.STAIRS, Kind.STAIRS_EDGE)
GOES_ON = (Kind.STAIRS_END,)
"""Kinds whose sentence is followed by those of `Instruction.then`; others weave them in."""


@dataclass(frozen=True, slots=True)
class Language:
    """One language: its sentences, the words that are put into them, and what stands on the phone's page."""

    words: Mapping[str, str]
    sentences: Mapping[Kind, str]
    page: Mapping[str, str]


LANGUAGES = tuple(
    sorted(
        file.name.removesuffix(".toml")
        for file in resources.files("gpdf_guidance").joinpath("languages").iterdir()
        if file.name.endswith(".toml")
    )
)
"""Those that there is a file for."""


@cache
def language(name: str) -> Language:
    """A language by its tag.

    Raises:
        KeyError: a sentence is missing, or there is one that nothing says.
    """
    file = resources.files("gpdf_guidance").joinpath("languages", f"{name}.toml")
    read = tomllib.loads(file.read_text(encoding="utf-8"))
    missing = {kind.value for kind in Kind} ^ set(read["sentences"])
    if missing:
        raise KeyError(f"{file.name}: sentences missing or unknown: {', '.join(sorted(missing))}")
    return Language(read["words"], {Kind(kind): sentence for kind, sentence in read["sentences"].items()}, read["page"])


def phrase(instruction: Instruction, manner: Manner | None = None) -> str:
    """Say an instruction.

    Args:
        instruction: What to say.
        manner: In which language and units; English and metres if None.
    """
    manner = manner or Manner()
    if instruction.resumes:
        resume = language(manner.language).sentences[Kind.RESUME]
        return f"{resume} {phrase(replace(instruction, resumes=False), manner)}"
    chosen, after = language(manner.language), instruction.after
    words = chosen.words
    metres = instruction.distance if after is None else after
    at_once = instruction.kind is Kind.TURN_SOON and instruction.ends and metres < HALF
    sentence = chosen.sentences[Kind.TURN_NOW if at_once else instruction.kind].format_map(
        _Fields(instruction, metres, words, manner)
    )
    if instruction.kind is Kind.OVERVIEW:
        unseen = (one for one in instruction.then if one.kind is Kind.LOW_UNSEEN)
        also = (*unseen, instruction.first, instruction.soon)
        return " ".join([sentence, *(phrase(one, manner) for one in also if one is not None)])
    if instruction.first is not None:
        sentence = f"{phrase(instruction.first, manner)} {sentence}"
    if instruction.kind in WITH_RAIL and instruction.side is not None:
        sentence = f"{sentence} {words[f'rail_{instruction.side}']}"
    if instruction.kind in GOES_ON:
        sentence = " ".join([sentence, *(phrase(one, manner) for one in instruction.then)])
    if instruction.ends:
        return f"{chosen.sentences[Kind.STAIRS_END]} {sentence}"
    return sentence if after is None else words["after"].format(sentence=sentence)


class _Fields(dict[str, str]):
    """What stands in braces in a sentence, made when it is asked for."""

    def __init__(self, instruction: Instruction, metres: float, words: Mapping[str, str], manner: Manner) -> None:
        one, other = instruction, instruction.then[0].distance if instruction.then else 0.0
        self._made: dict[str, Callable[[], str]] = {
            "distance": lambda: distance(metres, words, manner),
            "rest": lambda: distance(other, words, manner),
            "detour": lambda: distance(other, words, manner),
            "where": lambda: _where(one, metres, words, manner),
            "side": lambda: _side(one, words, manner),
            "beside": lambda: words[f"on_{one.side}"],
            "vertical": lambda: words["up" if one.amount > 0 else "down"],
            "height": lambda: f"{round(100 * abs(one.amount))}",
            "limit": lambda: f"{round(100 * abs(one.amount))}",
            "room": lambda: f"{int(100 * max(one.amount, 0.0))}",
            "needed": lambda: f"{round(100 * one.distance)}",
            "count": lambda: f"{one.count}",
            "turns": lambda: words[f"way_turns_{one.count}" if one.count < 2 else "way_turns"].format(count=one.count),
            "stairs": lambda: "".join(_on_the_way(parts, words) for parts in _flights(one.then)),
            "time": lambda: _time(one.seconds, words),
            "name": lambda: one.name or words["the_goal"],
            "goal": lambda: one.name[:1].upper() + one.name[1:] or words["goal"],
            "free": lambda: _free(one.free, words, manner),
        }

    def __missing__(self, key: str) -> str:
        return self._made[key]()


def distance(metres: float, words: Mapping[str, str], manner: Manner, suffix: str = "") -> str:
    """How far it is to something, never more than it is: who expects a step too late falls.

    Args:
        metres: So far [m].
        words: Of a language.
        manner: Says the unit.
        suffix: "_within" for the form that the language has behind "in".
    """
    metres += 1e-6
    if manner.unit == "steps":
        count = max(1, int(metres / manner.step_length))
        return f"{count} {words['step' + suffix] if count == 1 else words['steps' + suffix]}"
    halves = max(1, int(metres / HALF)) if metres < 3 else 2 * int(metres)
    number = f"{halves // 2}" if halves % 2 == 0 else f"{halves / 2:.1f}".replace(".", words["point"])
    return f"{number} {words['metre' + suffix] if halves == 2 else words['metres' + suffix]}"


def _where(one: Instruction, metres: float, words: Mapping[str, str], manner: Manner) -> str:
    if one.first is not None:
        return words["then"]
    near = metres < (manner.step_length if manner.unit == "steps" else HALF)
    within = words["within"].format(distance=distance(metres, words, manner, "_within"))
    where = words["right_ahead"] if near else within
    return words["at"].format(where=where, name=one.name) if one.name else where


def _side(one: Instruction, words: Mapping[str, str], manner: Manner) -> str:
    left = one.amount > 0
    if one.kind not in (Kind.TURN_NOW, Kind.TURN_SOON):
        return words["left" if left else "right"]
    angle = degrees(abs(one.amount))
    if manner.clock:
        return words["clock"].format(hour=round((-1 if left else 1) * angle / HOUR) % 12 or 12)
    if angle > ROUND:
        return words["around"]
    side = words["turn_left" if left else "turn_right"]
    return words["slightly"].format(side=side) if angle < SLIGHT else side


def _flights(parts: tuple[Instruction, ...]) -> list[list[Instruction]]:
    """What an overview names, in order: flights of stairs up, or down, one after the other, in one."""
    named: list[list[Instruction]] = []
    for part in parts:
        if part.kind is Kind.LOW_UNSEEN:
            continue  # a sentence of its own
        goes_on = named and named[-1][0].kind is part.kind is Kind.STAIRS and named[-1][0].amount * part.amount > 0.0
        named[-1].append(part) if goes_on else named.append([part])
    return named


def _on_the_way(parts: list[Instruction], words: Mapping[str, str]) -> str:
    part, count = parts[0], f" {words['and']} ".join(str(one.count) for one in parts)
    vertical = words["up" if part.amount > 0 else "down"]
    return words[f"way_{part.kind}"].format(vertical=vertical, count=count, height=round(100 * abs(part.amount)))


def _time(seconds: float, words: Mapping[str, str]) -> str:
    if seconds <= SHORT_TIME:
        return words["seconds"].format(count=10 * max(1, ceil(seconds / 10)))
    minutes = 1 if seconds < LONG_TIME else round(seconds / 60)
    return words["minute"] if minutes == 1 else words["minutes"].format(count=minutes)


def _free(free: tuple[float, ...], words: Mapping[str, str], manner: Manner) -> str:
    said = []
    for side, metres in zip((Side.AHEAD, Side.RIGHT, Side.BEHIND, Side.LEFT), free, strict=True):
        far = words["free_at"].format(distance=distance(metres, words, manner, "_within"))
        far = words["free_near"] if metres < NEAR else words["free_far"] if metres >= FAR else far
        said.append(words[f"free_{side}"].format(far=far))
    return ", ".join(said)

"""`gpdf bench f921`: what ITU-T F.921 recommends for guidance by words, beside what our guide says on a real walk.

F.921 (08/2018) is the Wayfindr Open Standard, Recommendation 2.0. Its recommendations are told here in our own words,
under the number of their clause, as far as its public parts give one. A simulated person without errors walks through
a made hall (a long leg, a turn, stairs with a handrail, a landing) with the real service; each check reads
what was said.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from gpdf_client import Client
from gpdf_guidance import (
    LANGUAGES,
    Asked,
    Guide,
    Instruction,
    Kind,
    Manner,
    Planner,
    Pose,
    Urgency,
    Walk,
    Walker,
    simulate,
)
from gpdf_guidance.ahead import EARLY, REASSURE
from gpdf_guidance.catalogue import language, phrase
from gpdf_guidance.features import FeatureKind
from gpdf_guidance.speech import spoken_in
from gpdf_guidance.walker import EXACT
from gpdf_schemas import Ask

from gpdf_service.bench.guide import serving
from gpdf_service.bench.report import Row, show
from gpdf_service.bench.walks import WalkedWorld
from gpdf_service.synthetic.world import Box, Shape, World
from gpdf_service.types import BoolArray, FloatArray

START, GOAL = (1.0, 1.0, 0.0), (17.0, 13.2, 1.7)
PLACES = {"the lift": [9.0, 1.9, 0.0], "the corner": [17.0, 1.0, 0.0], "the exit": list(GOAL)}
SLACK = 0.5
"""[m] A sentence is chosen ten times a second, and waits for the one before it."""
LONGEST = 14
"""Words of a sentence that is heard while walking; the overview and questions are heard standing."""
VERBS = {"walk", "turn", "take", "go", "keep", "stop", "step", "wait", "stay", "mind", "use"}
STANDING = (Kind.OVERVIEW, Kind.ASK_STEP, Kind.ASK_STEP_OR_DETOUR)
TELLS = (Kind.PASS, Kind.MOVING, Kind.STAIRS_END, Kind.CONSENTED, Kind.DECLINED)
"""What tells and asks for nothing."""
ANSWERS = tuple(Kind)[tuple(Kind).index(Kind.PAUSED) :]


@dataclass(frozen=True, slots=True)
class Heard:
    """A walk through the hall: what happened, who guided, what the person was told who asked to hear it again."""

    walk: Walk
    guide: Guide
    repeated: str

    def of(self, *kinds: Kind, early: bool | None = None) -> list[Instruction]:
        """What was said of some kinds, in order."""
        said = [one.instruction for one in self.walk.said if one.instruction.kind in kinds]
        return [one for one in said if early is None or one.early is early]


Check = Callable[[Heard], tuple[bool, str]]


@dataclass(frozen=True, slots=True)
class Recommendation:
    """One "should": clause, in our words, and how it is checked, or why it does not apply."""

    clause: str
    words: str
    check: Check | None = None
    why_not: str = ""


def hall(rng: np.random.Generator, spacing: float = 0.05) -> tuple[FloatArray, BoolArray]:
    """Points and labels: 18 m, a turn to the left, 6 m, ten steps up with a rail on the right, a landing."""
    shapes: list[Shape] = [Box((0.0, 2.0, 0.0), (16.0, 14.0, 3.0))]
    for i in range(10):
        y, z = 8.0 + 0.29 * i, 0.17 * (i + 1)
        shapes.append(Box((16.0, y, 0.0), (18.0, y + 0.29, z), walkable=True))
        shapes.append(Box((17.87, y, z + 0.84), (17.91, y + 0.29, z + 0.94)))
    shapes.append(Box((16.0, 10.9, 0.0), (18.0, 14.0, 1.7), walkable=True))
    return World((18.0, 14.0, 4.5), tuple(shapes), ceiling=False).sample(spacing, rng, 0.0)


def listen(client: Client, points: FloatArray, ground: BoolArray) -> Heard:
    """Walk through the hall, and ask for the last sentence again."""
    for name, place in PLACES.items():
        client.set_place("hall", name, place)
    world = WalkedWorld.of(points, ground)
    walker = Walker(np.array(START), 0.0, world.ground_height, np.random.default_rng(0), EXACT)
    guide = Guide(Planner(client, "hall"), GOAL, name="the exit")
    walk = simulate(guide, walker, world)
    guide.ask(Asked(Ask.REPEAT))
    _, said = guide.step(None, float(walk.times[-1]) + 10.0)
    return Heard(walk, guide, "" if said is None else said[1])


def _early(heard: Heard, kind: Kind) -> tuple[bool, str]:
    told = [one.distance for one in heard.of(kind, early=True)]
    fine = bool(told) and all(EARLY[0] - SLACK <= metres <= EARLY[1] for metres in told)
    return fine, ", ".join(f"{metres:.1f} m before" for metres in told) or "not told early"


def _reassured(heard: Heard) -> tuple[bool, str]:
    """On level legs, the longest way without a word."""
    route = heard.guide.routes[0]
    on = [(one.start, one.end) for one in route.features if one.kind is FeatureKind.STAIRS]
    walked = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(heard.walk.places[:, :2], axis=0).T))])
    near = [float(np.interp(one.time, heard.walk.times, walked)) for one in heard.walk.said]
    at = [route.locate(_pose(one.place), s).s for one, s in zip(heard.walk.said, near, strict=True)]
    gaps = [b - a for a, b in pairwise(at) if not any(a <= end and start <= b for start, end in on)]
    longest = max(gaps, default=float("inf"))
    return longest <= REASSURE + SLACK, f"{longest:.1f} m at most without a word"


def _pose(place: FloatArray) -> Pose:
    return Pose((float(place[0]), float(place[1]), float(place[2])), 0.0, 0.0)


def _short(heard: Heard) -> tuple[bool, str]:
    words = [len(one.text.split()) for one in heard.walk.said if one.instruction.kind not in STANDING]
    return max(words) <= LONGEST, f"{np.median(words):.0f} words, at most {max(words)}"


def _active(_: Heard) -> tuple[bool, str]:
    """Every English sentence that asks for something has a verb that says what to do."""
    idle = [
        kind.value
        for kind, text in language("en").sentences.items()
        if kind not in (*TELLS, *ANSWERS, *STANDING[1:]) and not VERBS & set(re.findall(r"[a-z]+", text.lower()))
    ]
    return not idle, f"without a verb: {', '.join(idle) or 'none'}"


def _egocentric(_: Heard) -> tuple[bool, str]:
    """No compass and no degrees in any sentence of any language."""
    foreign = re.compile(r"\b(north|south|east|west|degree|nord|süd|ost|grad)\w*", re.IGNORECASE)
    texts = [text for name in LANGUAGES for text in language(name).sentences.values()]
    found = [text for text in texts if foreign.search(text)]
    return not found, f"{len(texts)} sentences, {len(found)} with compass or degrees"


def _choice(_: Heard) -> tuple[bool, str]:
    turn = Instruction(Kind.TURN_NOW, Urgency.ACT, amount=-np.pi / 2)
    said = [phrase(turn, Manner(clock=clock)) for clock in (False, True)]
    return said == ["Turn right.", "Turn to 3 o'clock."], " ".join(said)


def _units(_: Heard) -> tuple[bool, str]:
    step = Instruction(Kind.GO_ON, Urgency.INFORM, distance=6.2)
    said = [phrase(step), phrase(step, Manner(unit="steps"))]
    return "metres" in said[0] and "paces" in said[1], " ".join(said)


def _overview(heard: Heard) -> tuple[bool, str]:
    first = heard.walk.said[0]
    moved = float(np.hypot(*(first.place - heard.walk.places[0])[:2]))
    return first.instruction.kind is Kind.OVERVIEW and moved < 0.1, first.text


def _ending(heard: Heard) -> tuple[bool, str]:
    last = heard.walk.said[-1]
    return last.instruction.kind in (Kind.ARRIVED, Kind.ARRIVED_BESIDE), f"{last.text} ({heard.walk.end:.2f} m off)"


def _landmark(heard: Heard) -> tuple[bool, str]:
    said = [one.text for one in heard.walk.said if "the lift" in one.text or "the corner" in one.text]
    return any("lift" in text for text in said) and any("corner" in text for text in said), " ".join(said)


def _turn(heard: Heard) -> tuple[bool, str]:
    told = [f"{one.distance:.1f} m" for one in heard.of(Kind.TURN_SOON) if one.amount > 0]
    return len(told) >= 2, f"told {', '.join(told)} before"


def _stairs(heard: Heard) -> tuple[bool, str]:
    told = heard.of(Kind.STAIRS)
    return bool(told) and all(one.amount > 0 and one.count == 10 for one in told), phrase(told[0]) if told else "none"


def _rail(heard: Heard) -> tuple[bool, str]:
    told = [one.side for one in heard.of(Kind.STAIRS)]
    return bool(told) and all(side == "right" for side in told), f"on the {told[0] if told else None}"


def _edge(heard: Heard) -> tuple[bool, str]:
    told = [one.distance for one in heard.of(Kind.STAIRS_EDGE)]
    return bool(told) and told[0] <= 0.5, f"{told[0]:.2f} m before the first edge" if told else "not told"


def _top(heard: Heard) -> tuple[bool, str]:
    said = [one.text for one in heard.walk.said if one.instruction.leaves_stairs]
    return bool(said) and len(said[0].split(". ")) > 1, " ".join(said)


def _again(heard: Heard) -> tuple[bool, str]:
    return heard.repeated == heard.walk.said[-1].text, heard.repeated


def _calm(heard: Heard) -> tuple[bool, str]:
    walked = [one for one in heard.walk.said if one.instruction.kind not in STANDING]
    share = sum(spoken_in(one.text) for one in walked) / float(heard.walk.times[-1])
    return share <= 0.5, f"speech fills {100 * share:.0f} % of the walk, {heard.walk.per_minute:.1f} sentences a minute"


NO_SCAN = "a scan does not show it; a named place can tell of it"
RECOMMENDATIONS = (
    Recommendation("6", "say little: short sentences", _short),
    Recommendation("6", "leave the ears to the surroundings: few sentences", _calm),
    Recommendation("7", "let people with impaired sight try it", why_not="open: simulated people only, until now"),
    Recommendation("8", "give directions as the person's own left, right, ahead", _egocentric),
    Recommendation("8", "let the person choose how directions are told", _choice),
    Recommendation("9", "begin with what the way is like", _overview),
    Recommendation("9", "say what to do with a verb", _active),
    Recommendation("9", "let the person choose the unit of distances", _units),
    Recommendation("9", "tell of a turn 6 ± 1 m before it", lambda heard: _early(heard, Kind.TURN_SOON)),
    Recommendation("9", "tell of it again where it is to be made", _turn),
    Recommendation("9.2.4", "on long legs say every 10 m that all is well", _reassured),
    Recommendation("9", "name landmarks that are passed, and where one turns", _landmark),
    Recommendation("9", "say that the way ends", _ending),
    Recommendation("9", "tell at each junction to go straight on", why_not="a map of free space knows no junctions"),
    Recommendation("10", "tell of stairs 6 ± 1 m before them", lambda heard: _early(heard, Kind.STAIRS)),
    Recommendation("10", "say whether stairs go up or down, and how many steps", _stairs),
    Recommendation("10", "say on which side the handrail is", _rail),
    Recommendation("10", "say where stairs begin", _edge),
    Recommendation("10", "say where they end, and what comes next", _top),
    Recommendation("10", "say of what kind a door is and how it opens", why_not=NO_SCAN),
    Recommendation("10", "tell of lifts, escalators, moving walkways", why_not=NO_SCAN),
    Recommendation("11", "tell of platforms, gates, trains", why_not=NO_SCAN),
    Recommendation("12", "say the last sentence again when asked", _again),
    Recommendation("12", "search by dictation", why_not="the phone's own keyboard dictates"),
)


def judged(heard: Heard) -> list[Row]:
    """Every recommendation, whether it applies, whether it is followed, and the evidence."""
    rows: list[Row] = []
    for one in RECOMMENDATIONS:
        if one.check is None:
            rows.append({"F.921": one.clause, "should": one.words, "holds": "-", "evidence": one.why_not})
            continue
        passed, evidence = one.check(heard)
        rows.append({"F.921": one.clause, "should": one.words, "holds": passed, "evidence": evidence})
    return rows


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    parser.add_argument("--json", action="store_true", help="print the rows as JSON")
    parser.add_argument("--said", action="store_true", help="print what was said, too")


def run(args: argparse.Namespace) -> int:
    """Exit code 0 if all that applies is followed."""
    points, ground = hall(np.random.default_rng(0))
    with serving("hall", points, ground) as (_, client):
        heard = listen(client, points, ground)
    if args.said:
        show([{"time": round(one.time, 1), "said": one.text} for one in heard.walk.said], as_json=args.json)
    rows = judged(heard)
    show(rows, as_json=args.json)
    return 0 if all(row["holds"] in (True, "-") for row in rows) else 1

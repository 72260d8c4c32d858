"""What is to be said at a place on a route: the turns there, and what lies ahead."""

from __future__ import annotations

from math import radians

from gpdf_schemas import CueAction

from gpdf_guidance.features import TREAD, TURN, Feature, FeatureKind
from gpdf_guidance.instruction import Instruction, Kind, Urgency
from gpdf_guidance.route import Progress, Route

ON_THE_SPOT = radians(40)
"""[rad] From this on one turns before one walks."""
ARRIVED = 0.4
"""[m] From the goal: an arm reaches it."""
STRAIGHT = radians(10)
"""[rad] Nobody feels a smaller error of direction."""
STEP_WINDOW = (1.0, 2.8)
"""[m] Steps and stairs are told of this far before: not too late to find with the cane, not too early to count on."""
ON_STAIRS = 1.6
"""[m] What comes after a stair, or a turn before one, is told of from here: two of them are not mixed up."""
LANDING = STEP_WINDOW[0] + 0.1
"""[m] What is this far behind a stair is told of where the stair ends, in the same breath, and still soon enough."""
OFF_STAIRS = 0.6
"""[m] A stair's end is told of until here: two short paces."""
TURN_WINDOW = (0.3, 2.5)
"""[m] The same for turns."""
OTHER_WINDOW = (0.0, 2.5)
"""[m] The same for the rest."""
STEPS = (FeatureKind.STEP, FeatureKind.STAIRS)
TO_STEPS = 1.0
"""[m] A turn that ends this near before a step or stairs, or begins so near behind stairs, is told with them."""


def find_turning(route: Route, progress: Progress, direction: float, action: CueAction) -> list[Instruction]:
    """Turns at this place: to be made, over-turned, or made."""
    turn = next((f for f in route.features if f.kind is FeatureKind.TURN and _at(f, progress.s)), None)
    if turn is not None and direction * turn.amount < 0 and STRAIGHT < abs(direction) < ON_THE_SPOT:
        return [Instruction(Kind.TURN_BACK, Urgency.PREPARE, _place(route, turn.start), amount=direction)]
    if action is CueAction.TURN and abs(direction) >= TURN:
        place = _place(route, progress.s if turn is None else turn.start)
        return [Instruction(Kind.TURN_NOW, Urgency.ACT, place, amount=direction)]
    straight = _straight_length(route, progress.s)
    if turn is not None and progress.s >= turn.end and abs(direction) <= STRAIGHT and straight >= TO_STEPS:
        return [Instruction(Kind.GO_ON, Urgency.INFORM, _place(route, turn.start), straight)]
    return []


def _place(route: Route, s: float) -> tuple[float, float]:
    x, y, _ = route.at(s).tolist()
    return x, y


def _at(turn: Feature, s: float) -> bool:
    return turn.start - TURN_WINDOW[0] <= s <= turn.end + 2 * TURN_WINDOW[0]


def _straight_length(route: Route, s: float) -> float:
    """Until the next turn, step or end [m]; 0 on stairs."""
    turns = [f.start for f in route.features if f.kind is FeatureKind.TURN and f.start > s + TURN_WINDOW[0]]
    steps = [max(f.start, s) for f in route.features if f.kind in STEPS and f.end >= s]
    return min(turns + steps + [route.length]) - s


_SOON: dict[FeatureKind, tuple[Kind, Urgency, tuple[float, float]]] = {
    FeatureKind.STEP: (Kind.STEP, Urgency.ACT, STEP_WINDOW),
    FeatureKind.STAIRS: (Kind.STAIRS, Urgency.ACT, STEP_WINDOW),
    FeatureKind.TURN: (Kind.TURN_SOON, Urgency.PREPARE, TURN_WINDOW),
    FeatureKind.NARROW: (Kind.NARROW, Urgency.PREPARE, OTHER_WINDOW),
    FeatureKind.HEAD: (Kind.HEAD, Urgency.PREPARE, OTHER_WINDOW),
    FeatureKind.RAMP: (Kind.RAMP, Urgency.INFORM, OTHER_WINDOW),
    FeatureKind.BEAR: (Kind.BEAR, Urgency.INFORM, OTHER_WINDOW),
}


def is_hidden_step(one: Instruction) -> bool:
    """Whether it tells of a step or stairs that come too soon to go on while it is spoken."""
    return one.kind in (Kind.STEP, Kind.STAIRS) and one.distance < STEP_WINDOW[0]


def find_ahead(route: Route, progress: Progress) -> list[Instruction]:
    """What comes soon, and the end of a stair."""
    said: list[Instruction] = []
    stairs = [f for f in route.features if f.kind is FeatureKind.STAIRS]
    climbed = next((f for f in stairs if f.end > progress.s), None)
    left = next((f for f in stairs if f.end <= progress.s <= f.end + OFF_STAIRS), None)
    for feature in route.features:
        kind, urgency, window = _SOON[feature.kind]
        distance, after = feature.start - progress.s, _behind(climbed, feature)
        is_step = feature.kind in STEPS
        ends = left is not None and _is_told_with_the_end(left, feature)
        if after is not None and (feature.kind is FeatureKind.TURN or _is_told_with_the_end(climbed, feature)):
            continue  # it is time for them when the stairs end
        if feature.kind is FeatureKind.TURN and _needs_no_word(route, feature, ends):
            continue
        if is_step and distance > ON_STAIRS and _turns_before(route, progress, feature) > 1:
            continue  # one turn after the other
        soon = window[0] <= distance <= (window[1] if after is None else ON_STAIRS)
        if soon or (is_step and 0.0 <= distance < window[0]) or (ends and distance > 0.0):  # late is better than never
            first = _turn_before(route, progress, feature) if is_step else None
            place = _place(route, feature.start)
            urgency = Urgency.ACT if ends else urgency
            said.append(Instruction(kind, urgency, place, distance, feature.amount, feature.count, after, ends, first))
    if left is not None and not any(one.ends for one in said):
        turn = next((f.start for f in route.features if _is_told_with_the_end(left, f)), left.end)
        said.append(Instruction(Kind.STAIRS_END, Urgency.ACT, _place(route, turn)))
    return said


def _is_told_with_the_end(stairs: Feature | None, feature: Feature) -> bool:
    """Whether a feature behind stairs is told of where they end, not while a person is on them."""
    if stairs is None:
        return False
    behind = feature.start - stairs.end
    if feature.kind in STEPS:
        return LANDING <= behind <= STEP_WINDOW[1]
    return feature.kind is FeatureKind.TURN and -TREAD <= behind <= TO_STEPS


def _needs_no_word(route: Route, turn: Feature, ends: bool) -> bool:
    """Whether a turn is told with the steps that it leads to, or one has arrived before it."""
    if turn.start > route.length - ARRIVED:
        return True
    return not ends and any(f.kind in STEPS and turn.start <= f.start <= turn.end + TO_STEPS for f in route.features)


def _turns_before(route: Route, progress: Progress, steps: Feature) -> int:
    """How many turns are to be made before a step or stairs."""
    places = [f.start for f in route.features if f.kind is FeatureKind.TURN]
    return sum(progress.s < place <= steps.start for place in places)


def _turn_before(route: Route, progress: Progress, steps: Feature) -> Instruction | None:
    """The turn that is still to be made right before a step or stairs."""
    for turn in route.features:
        distance = turn.start - progress.s
        leads = turn.kind is FeatureKind.TURN and turn.start <= steps.start <= turn.end + TO_STEPS
        if leads and distance >= TURN_WINDOW[0]:
            return Instruction(Kind.TURN_SOON, Urgency.PREPARE, _place(route, turn.start), distance, turn.amount)
    return None


def _behind(climbed: Feature | None, feature: Feature) -> float | None:
    """How far a feature is behind stairs [m]; a turn at their last step is made after it. None if it is not."""
    if climbed is None or climbed is feature or feature.start < climbed.end - TREAD:
        return None
    return max(0.0, feature.start - climbed.end)

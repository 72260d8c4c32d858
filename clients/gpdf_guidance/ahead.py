"""What is to be said at a place on a route: the turns there, and what lies ahead."""

from __future__ import annotations

from dataclasses import replace
from math import radians

from gpdf_schemas import CueAction

from gpdf_guidance.features import TREAD, TURN, Feature, FeatureKind
from gpdf_guidance.instruction import Instruction, Kind, Side, Urgency
from gpdf_guidance.route import Progress, Route
from gpdf_guidance.stairs import LEAST_EDGE

ON_THE_SPOT = radians(40)
"""[rad] From this on one turns before one walks."""
ARRIVED = 0.4
"""[m] From the goal: an arm reaches it."""
STRAIGHT = radians(10)
"""[rad] Nobody feels a smaller error of direction."""
EARLY = (5.0, 7.0)
"""[m] What one will have to do is told of this far before for the first time: 6 ± 1 m, ITU-T F.921."""
STEP_WINDOW = (1.0, 2.8)
"""[m] Steps and stairs are told of this far before: not too late to find with the cane, not too early to count on."""
FOOT_OF = 0.6
"""[m] Stairs that are told of from here begin where one stands."""
EDGE = 0.45
"""[m] Before an edge that is not told of yet one stands: a careful pace of 0.3 m/s ends a foot before it."""
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
PASSING = (0.0, 1.0)
"""[m] A named place is told of when it is this far ahead."""
REASSURE = 10.0
"""[m] Who has heard nothing for so long is told that all is well, ITU-T F.921."""
STEPS = (FeatureKind.STEP, FeatureKind.STAIRS)
TO_STEPS = 1.0
"""[m] A turn that ends this near before a step or stairs is told with them."""
SETTING_OFF = 1.4
"""[m] Two seconds of a walk: what would be told of within them is told with the overview, to who still stands."""


def find_turning(route: Route, progress: Progress, direction: float, action: CueAction) -> list[Instruction]:
    """Turns at this place: to be made, over-turned, or made."""
    turn = next((f for f in route.features if f.kind is FeatureKind.TURN and _at(f, progress.s)), None)
    if turn is not None and direction * turn.amount < 0 and STRAIGHT < abs(direction) < ON_THE_SPOT:
        return [Instruction(Kind.TURN_BACK, Urgency.PREPARE, _place(route, turn.start), amount=direction)]
    if action is CueAction.TURN and abs(direction) >= TURN:
        place = _place(route, progress.s if turn is None else turn.start)
        return [Instruction(Kind.TURN_NOW, Urgency.ACT, place, amount=direction)]
    straight = _straight_length(route, progress.s)
    soon = straight <= EARLY[1] and progress.s + straight < route.length  # what comes then is told of by itself
    if turn is not None and progress.s >= turn.end and abs(direction) <= STRAIGHT and straight >= TO_STEPS and not soon:
        return [Instruction(Kind.GO_ON, Urgency.INFORM, _place(route, turn.start), straight)]
    return []


def find_reassurance(route: Route, progress: Progress, told_at: float) -> list[Instruction]:
    """What is said to who has walked long without a word.

    Args:
        route: The way.
        progress: Where the person is.
        told_at: Where the last sentence was said [m].
    """
    straight = _straight_length(route, progress.s)
    if progress.s - told_at < REASSURE or straight < TO_STEPS:
        return []
    return [Instruction(Kind.STRAIGHT, Urgency.INFORM, _place(route, progress.s), straight)]


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
    FeatureKind.TURN: (Kind.TURN_SOON, Urgency.ACT, TURN_WINDOW),
    FeatureKind.OPENING: (Kind.OPENING, Urgency.PREPARE, OTHER_WINDOW),
    FeatureKind.NARROW: (Kind.NARROW, Urgency.PREPARE, OTHER_WINDOW),
    FeatureKind.HEAD: (Kind.HEAD, Urgency.PREPARE, OTHER_WINDOW),
    FeatureKind.UNSEEN: (Kind.UNSEEN, Urgency.ACT, OTHER_WINDOW),
    FeatureKind.RAMP: (Kind.RAMP, Urgency.INFORM, OTHER_WINDOW),
    FeatureKind.BEAR: (Kind.BEAR, Urgency.INFORM, OTHER_WINDOW),
    FeatureKind.PLACE: (Kind.PASS, Urgency.INFORM, PASSING),
}
TOLD_EARLY = (FeatureKind.STEP, FeatureKind.STAIRS, FeatureKind.TURN, FeatureKind.RAMP)
"""What changes how one walks is told of early, too; a passage is not: one is led through it."""


def is_hidden_step(one: Instruction) -> bool:
    """Whether it tells of a step or stairs that come too soon to go on while it is spoken."""
    return one.kind is Kind.ON_STAIRS or (one.kind in (Kind.STEP, Kind.STAIRS) and one.distance < STEP_WINDOW[0])


def is_edge(one: Instruction) -> bool:
    """Whether it is the word at an edge that one does not step over unheard."""
    return one.kind in (Kind.STEP_EDGE, Kind.STAIRS_EDGE)


def find_ahead(route: Route, progress: Progress) -> list[Instruction]:
    """What comes soon, and the end of a stair."""
    said: list[Instruction] = []
    stairs = [f for f in route.features if f.kind is FeatureKind.STAIRS]
    climbed = next((f for f in stairs if f.end > progress.s), None)
    left = next((f for f in stairs if f.end <= progress.s <= f.end + OFF_STAIRS), None)
    if any(f.kind in STEPS and 0.0 <= f.start - progress.s <= EDGE for f in route.features):
        left = None  # at the next edge the end of the last stairs is no news, and sounds like that of the next ones
    turns = (f for f in route.features if f.kind is FeatureKind.TURN and _is_told_with_the_end(left, f))
    first = next(turns, None)
    for feature in route.features:
        after = _behind(climbed, feature)
        ends = feature is first or (feature.kind in STEPS and _is_told_with_the_end(left, feature))
        if after is not None and (feature.kind is FeatureKind.TURN or _is_told_with_the_end(climbed, feature)):
            continue  # it is time for them when the stairs end
        if feature.kind is FeatureKind.TURN and _needs_no_word(route, feature, ends):
            continue
        said += _told_of(route, progress, feature, after, ends)
    if left is not None and not any(one.ends for one in said):
        turn = next((f.start for f in route.features if _is_told_with_the_end(left, f)), left.end)
        straight = _straight_length(route, left.end + 1e-6)
        on = (Instruction(Kind.GO_ON, Urgency.INFORM, distance=straight),) if straight >= TO_STEPS else ()
        said.append(Instruction(Kind.STAIRS_END, Urgency.ACT, _place(route, turn), then=on))
    return said


def find_first(route: Route) -> tuple[Feature, Instruction] | None:
    """What is to be done first, if it is so near that it is told with the overview.

    At what is nearer than `FOOT_OF` to a step one stands already: its own sentence is the word at the edge.
    """
    start = Progress(0.0, 0.0)
    for feature in route.features:
        if feature.kind not in TOLD_EARLY or feature.end <= 0.0:
            continue
        if feature.kind is FeatureKind.TURN and _needs_no_word(route, feature, ends=False):
            continue
        near = (FOOT_OF, STEP_WINDOW[1]) if feature.kind in STEPS else _SOON[feature.kind][2]
        early = EARLY[0] <= feature.start <= EARLY[1]
        soon = near[0] < feature.start <= near[1] + SETTING_OFF and _turns_before(route, start, feature) <= 1
        return (feature, _tell(route, start, feature, early=early)) if early or soon else None
    return None


def _told_of(route: Route, progress: Progress, feature: Feature, after: float | None, ends: bool) -> list[Instruction]:
    """What is said of one feature here: early, soon, at its edge, on it (to who begins there), or nothing."""
    kind, urgency, window = _SOON[feature.kind]
    if feature.kind is FeatureKind.STAIRS and feature.start < progress.s < feature.end:
        here, end = _place(route, progress.s), _place(route, feature.end)
        return [Instruction(Kind.ON_STAIRS, urgency, here, amount=feature.amount, last=end)]
    distance, is_step = feature.start - progress.s, feature.kind in STEPS
    if is_step and distance > ON_STAIRS and _turns_before(route, progress, feature) > 1:
        return []  # one turn after the other
    early = EARLY[0] <= distance <= EARLY[1] and _is_told_early(route, progress, feature)
    soon = window[0] <= distance <= (window[1] if after is None else ON_STAIRS)
    late = is_step and 0.0 <= distance < window[0]  # better than never
    if not (early or soon or late or (ends and distance >= -TREAD)):  # a turn at their last step is made now
        return []
    one = replace(_tell(route, progress, feature, early=early), after=after, ends=ends)
    one = replace(one, urgency=Urgency.ACT) if ends else one
    if is_step and distance <= EDGE and after is None and abs(feature.amount) >= LEAST_EDGE:
        edge = Kind.STAIRS_EDGE if kind is Kind.STAIRS else Kind.STEP_EDGE
        return [one, replace(one, kind=edge, side=None, first=None)]
    return [one]


def _tell(route: Route, progress: Progress, feature: Feature, *, early: bool) -> Instruction:
    """What is said of a feature ahead."""
    kind, urgency, _ = _SOON[feature.kind]
    is_step, side = feature.kind in STEPS, Side(feature.rail) if feature.rail else None
    if feature.kind is FeatureKind.PLACE:
        side = Side.LEFT if feature.amount > 0 else Side.RIGHT
    return Instruction(
        kind,
        Urgency.PREPARE if early and not is_step else urgency,
        _place(route, feature.start),
        max(feature.start - progress.s, 0.0),
        feature.amount,
        feature.count,
        early=early,
        first=_turn_before(route, progress, feature) if is_step else None,
        name=feature.name,
        side=side,
        last=_place(route, feature.end) if kind is Kind.STAIRS else None,
    )


def _is_told_early(route: Route, progress: Progress, feature: Feature) -> bool:
    """Whether nothing that is to be done lies before a feature: two things to do are not told of at once."""
    doing = (*STEPS, FeatureKind.TURN)
    between = (
        f.kind in doing and f is not feature and progress.s < f.end and f.start < feature.start - TO_STEPS
        for f in route.features
    )
    return feature.kind in TOLD_EARLY and not any(between)


def _is_told_with_the_end(stairs: Feature | None, feature: Feature) -> bool:
    """Whether a feature behind stairs is told of where they end, not while a person is on them."""
    if stairs is None:
        return False
    behind = feature.start - stairs.end
    if feature.kind in STEPS:
        return LANDING <= behind <= STEP_WINDOW[1]
    return feature.kind is FeatureKind.TURN and -TREAD <= behind <= TURN_WINDOW[1]


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
            place = _place(route, turn.start)
            return Instruction(Kind.TURN_SOON, Urgency.PREPARE, place, distance, turn.amount, name=turn.name)
    return None


def _behind(climbed: Feature | None, feature: Feature) -> float | None:
    """How far a feature is behind stairs [m]; a turn at their last step is made after it. None if it is not."""
    if climbed is None or climbed is feature or feature.start < climbed.end - TREAD:
        return None
    return max(0.0, feature.start - climbed.end)

"""What a person is told who asks, and what is told of a whole way: pure functions of the route and the pose."""

from __future__ import annotations

from math import atan2, hypot

from gpdf_guidance.advice import LEAST_OBSTACLE, PACES, side_of
from gpdf_guidance.ahead import ON_THE_SPOT, find_first
from gpdf_guidance.features import Feature, FeatureKind
from gpdf_guidance.instruction import Instruction, Kind, Urgency
from gpdf_guidance.route import Pose, Route

TREAD_TIME = 1.2
"""[s] That a person who cannot see takes for a step of stairs."""
TURN_TIME = 3.0
"""[s] For a turn on the spot, and to set off again."""
CLIMBS = {FeatureKind.STEP: 0.0, FeatureKind.STAIRS: 0.0, FeatureKind.RAMP: 0.5}
"""[m] What an overview tells of, from this rise on; a lower ramp is felt, as three steps would be."""
MARGIN = 1.2
"""Times as long as at full pace: people slow down at narrow places and at the end."""


def overview(route: Route, name: str, pace: float, turn: float = 0.0) -> Instruction:
    """What a way is like, before its first step.

    Args:
        route: The way.
        name: Of the goal; empty where it has none.
        pace: Share of the full pace that the person wants.
        turn: To the left [rad], on the spot, to where he walks first.
    """
    at, soon = find_first(route) or (None, None)
    climbs = [one for one in route.features if one.kind in CLIMBS and abs(one.amount) >= CLIMBS[one.kind]]
    steps = () if climbs == [at] else tuple(_as_told(one) for one in climbs)  # the only one is told by itself
    turns = sum(one.kind is FeatureKind.TURN and one.end > 0.0 for one in route.features)
    if turns == 1 and soon is not None and (soon.kind is Kind.TURN_SOON or soon.first is not None):
        turns = 0  # it is told by itself
    first = Instruction(Kind.TURN_NOW, Urgency.ACT, _start(route), amount=turn) if abs(turn) >= ON_THE_SPOT else None
    return Instruction(
        Kind.OVERVIEW,
        Urgency.ACT,
        _start(route),
        route.length,
        count=turns,
        first=first,
        then=steps + unseen(route),
        soon=soon,
        name=name,
        seconds=duration(route, 0.0, pace),
    )


def unseen(route: Route) -> tuple[Instruction, ...]:
    """That the map misses low things on this way, where it misses what a foot would notice."""
    height = route.hidden_height
    return (Instruction(Kind.LOW_UNSEEN, Urgency.PREPARE, amount=height),) if height > LEAST_OBSTACLE else ()


def _start(route: Route) -> tuple[float, float]:
    x, y, _ = route.at(0.0).tolist()
    return x, y


def _as_told(one: Feature) -> Instruction:
    return Instruction(Kind(one.kind.value), Urgency.INFORM, amount=one.amount, count=one.count)


def duration(route: Route, s: float, pace: float) -> float:
    """How long a person walks from arc length `s` on, about [s]."""
    ahead = [one for one in route.features if one.end > s]
    treads = sum(one.count for one in ahead if one.kind in (FeatureKind.STAIRS, FeatureKind.STEP))
    on_stairs = sum(one.end - max(one.start, s) for one in ahead if one.kind is FeatureKind.STAIRS)
    turns = sum(one.kind is FeatureKind.TURN and one.start >= s for one in ahead)
    walked = max(0.0, route.length - s - on_stairs)
    return MARGIN * walked / (PACES[0] * pace) + TREAD_TIME * treads + TURN_TIME * turns


def how_far(route: Route, s: float, pace: float) -> Instruction:
    """How far it is to the goal, and how long."""
    left = max(0.0, route.length - s)
    return Instruction(Kind.HOW_FAR, Urgency.ACT, distance=left, seconds=duration(route, s, pace))


def here(route: Route, s: float, pose: Pose, pace: float) -> Instruction:
    """Where a person is: beside the nearest named place of his storey; the way left if there is none."""
    known = [
        (hypot(place[0] - pose.position[0], place[1] - pose.position[1]), name, place)
        for name, place in route.places.items()
        if len(place) < 3 or abs(place[2] - pose.position[2]) < 1.0
    ]
    left = how_far(route, s, pace)
    if not known:
        return left
    away, name, (x, y, *_) = min(known)
    side = side_of(atan2(y - pose.position[1], x - pose.position[0]) - pose.heading)
    return Instruction(Kind.HERE, Urgency.ACT, distance=away, name=name, side=side, then=(left,))

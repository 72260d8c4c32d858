"""What is told and when: early, at edges, on long legs; landmarks, openings, handrails; what is learned of a person."""

import numpy as np
import pytest
from gpdf_guidance import Instruction, Kind, Pose, Side, Urgency, advise, build_route
from gpdf_guidance.advice import moves_near
from gpdf_guidance.ahead import EARLY, REASSURE, find_ahead, find_reassurance, is_hidden_step
from gpdf_guidance.announcer import Announcer
from gpdf_guidance.answers import duration, here, overview
from gpdf_guidance.catalogue import phrase
from gpdf_guidance.features import FeatureKind
from gpdf_guidance.manner import Detail, Manner, changed
from gpdf_guidance.rails import with_rails
from gpdf_guidance.route import Progress
from gpdf_guidance.stairs import Flight
from gpdf_guidance.steps import StepLength, learn
from gpdf_schemas import Ask, CueAction

from tests.clients.test_guidance import RADIUS, line, trajectory, wide


def on(route, s):
    return find_ahead(route, Progress(s, 0.0))


def corner(leg=12.0):
    return build_route(trajectory(line((0, 0), (leg, 0), (leg, 4))), wide, radius=RADIUS)


def stairs(start=12.0, up=1):
    path = line((0, 0), (18, 0), spacing=0.01, z=lambda s: up * 0.17 * np.searchsorted(start + 0.3 * np.arange(5), s))
    return build_route(trajectory(path), wide, radius=RADIUS)


def low_ramp(start):
    path = line((0, 0), (18, 0), spacing=0.01, z=lambda s: np.clip(0.1 * (s - start - 0.1), 0.0, 0.2))
    return build_route(trajectory(path), wide, radius=RADIUS)


@pytest.mark.parametrize("made", [corner, stairs], ids=["a turn", "stairs"])
def test_what_is_to_be_done_is_told_six_metres_before_and_again_when_it_is_near(made):
    route = made()
    told = {round(12.0 - s, 1): [one.early for one in on(route, s)] for s in np.arange(0.0, 11.6, 0.1)}
    early = [away for away, flags in told.items() if True in flags]
    assert EARLY[0] - 0.2 <= min(early) <= EARLY[0] + 0.2
    assert EARLY[1] - 0.2 <= max(early) <= EARLY[1] + 0.2
    assert any(False in flags for away, flags in told.items() if away < 2.6)
    assert not any(flags for away, flags in told.items() if 3.0 < away < 4.7)


def test_what_lies_behind_a_turn_is_not_told_early_before_it():
    path = line((0, 0), (4, 0), (4, 8), spacing=0.01, z=lambda s: 0.17 * np.searchsorted(7.0 + 0.3 * np.arange(5), s))
    route = build_route(trajectory(path), wide, radius=RADIUS)
    assert Kind.STAIRS not in {one.kind for one in on(route, 1.0)}


def test_the_edge_is_told_to_who_stands_before_it_and_faces_it():
    route = stairs(3.0)
    assert Kind.STAIRS_EDGE not in {one.kind for one in on(route, 2.2)}
    assert Kind.STAIRS_EDGE in {one.kind for one in on(route, 2.7)}
    facing = advise(route, Pose((2.7, 0.0, 0.0), 0.0, 0.0), 0.0, near=2.7)
    assert Kind.STAIRS_EDGE in {one.kind for one in facing.instructions}
    away = advise(route, Pose((2.7, 0.0, 0.0), 1.2, 0.0), 0.0, near=2.7)
    assert Kind.STAIRS_EDGE not in {one.kind for one in away.instructions}


@pytest.mark.parametrize("up", [1, -1])
def test_who_begins_on_stairs_is_told_so_before_he_goes_on_and_who_came_to_them_is_not(up):
    route, announcer = stairs(3.0, up), Announcer(phrase)
    told = [one for one in on(route, 3.1) if is_hidden_step(one)]
    assert [phrase(one) for one in told] == [f"You stand on stairs. Go {'up' if up > 0 else 'down'}."]
    assert not announcer.has_told(told[0], 0.0)
    assert announcer.choose(told, 0.0)[0].kind is Kind.ON_STAIRS
    assert not announcer.has_told(told[0], 1.0)  # it is being said
    assert announcer.has_told(told[0], 4.0)
    came = Announcer(phrase)
    came.choose([one for one in on(route, 1.5) if one.kind is Kind.STAIRS], 0.0)
    assert came.has_told(told[0], 10.0)
    assert came.choose([one for one in on(route, 3.4) if is_hidden_step(one)], 10.0) is None


@pytest.mark.parametrize(
    ("made", "start", "told"),
    [
        (corner, 2.0, Kind.TURN_SOON),
        (corner, 4.5, None),  # neither near, nor six metres off: by itself, when it is near
        (corner, 6.0, Kind.TURN_SOON),
        (stairs, 0.5, None),  # its own word is that at the edge
        (stairs, 2.0, Kind.STAIRS),
        (low_ramp, 2.0, Kind.RAMP),
    ],
)
def test_what_is_to_be_done_soon_after_the_first_step_is_told_with_the_overview_and_not_again(made, start, told):
    route, voice = made(start), Announcer(phrase)
    way = overview(route, "", 1.0)
    assert (None if way.soon is None else way.soon.kind) is told
    _, text = voice.choose([way], 0.0)
    assert (f"In {int(start)} metres" in text) is (told is not None)
    assert "1 turn" not in text or told is None
    assert ("with 5 steps" in text) is (made is stairs and told is None)  # once, and where
    soon = [one for one in on(route, max(0.0, start - 2.0)) if one.kind is told and not one.early]
    if way.soon is not None and not way.soon.early:
        assert len(soon) == 1
        assert voice.choose(soon, 10.0) is None
        assert voice.has_told(soon[0], 10.0)


def test_what_is_still_to_be_heard_is_not_counted_on():
    step = Instruction(Kind.STEP, Urgency.ACT, (1.0, 0.0), 2.4, -0.17)
    voice = Announcer(lambda one: phrase(one, Manner("de")))
    _, text = voice.choose([step], 0.0)
    assert text == "In 2 Metern Stufe abwärts, 17 Zentimeter."
    assert not voice.has_told(step, 2.8)  # a voice has just ended, which took no time to begin: see `bench spoken`
    assert voice.has_told(step, 4.5)


def test_at_the_end_of_stairs_one_hears_what_comes_next():
    route = stairs(3.0)
    (end,) = (one for one in on(route, 4.4) if one.kind is Kind.STAIRS_END)
    assert [one.kind for one in end.then] == [Kind.GO_ON]
    assert end.then[0].distance == pytest.approx(18.0 - 4.2, abs=0.2)


def test_who_has_heard_nothing_for_ten_metres_is_told_that_all_is_well():
    route = build_route(trajectory(line((0, 0), (40, 0))), wide, radius=RADIUS)
    assert find_reassurance(route, Progress(REASSURE - 0.5, 0.0), 0.0) == []
    (one,) = find_reassurance(route, Progress(REASSURE + 0.1, 0.0), 0.0)
    assert (one.kind, one.distance) == (Kind.STRAIGHT, pytest.approx(29.9, abs=0.1))


def test_named_places_are_passed_on_their_side_or_name_a_turn():
    places = {"lift": [5.0, 1.0], "desk": [7.0, -1.0], "corner": [12.2, -0.3], "far": [3.0, 9.0], "above": [5, 0, 3.0]}
    path = trajectory(line((0, 0), (12, 0), (12, 8)))
    route = build_route(path, wide, radius=RADIUS, places=places)
    passed = {one.name: one.amount for one in route.features if one.kind is FeatureKind.PLACE}
    assert passed == {"lift": 1.0, "desk": -1.0}
    assert [one.name for one in route.features if one.kind is FeatureKind.TURN] == ["corner"]
    (said,) = (one for one in on(route, 4.5) if one.kind is Kind.PASS)
    assert (said.name, said.side) == ("lift", Side.LEFT)


def walls(rail_height, side, spacing=0.03):
    """Walls beside five treads, and a bar that stands off one of them."""
    x, z = (grid.ravel() for grid in np.meshgrid(np.arange(2.9, 4.6, spacing), np.arange(0.0, 3.0, spacing)))
    treads = 0.17 * np.searchsorted(3.0 + 0.3 * np.arange(5), np.arange(2.9, 4.6, spacing))
    sides = [np.column_stack([x, np.full(len(x), y), z]) for y in (-0.7, 0.7)]
    bar = np.column_stack([np.arange(2.9, 4.6, spacing), np.full(len(treads), 0.62 * side), treads + rail_height])
    return np.concatenate([*sides, bar])


@pytest.mark.parametrize(
    ("height", "side", "told"), [(0.9, 1, "left"), (0.9, -1, "right"), (0.45, 1, ""), (1.4, 1, "")]
)
def test_a_handrail_is_what_stands_out_at_hands_height(height, side, told):
    route = stairs(3.0)
    flight = Flight(3.0, 4.2, 0.0, 0.0, 0.17, (3.0, 0.0), (4.2, 0.0))
    named = with_rails(route.features, route.ground, route.s, (flight,), walls(height, side))
    assert [one.rail for one in named if one.kind is FeatureKind.STAIRS] == [told]
    bare = with_rails(route.features, route.ground, route.s, (flight,), np.zeros((0, 3)))
    assert [one.rail for one in bare if one.kind is FeatureKind.STAIRS] == [""]


def test_an_opening_is_short_and_a_passage_is_long():
    def narrow(length):
        def room(places):
            inside = np.abs(places[:, 0] - 4.0) < length / 2
            return np.where(inside, 0.37, 1.5) - np.abs(places[:, 1]) - RADIUS

        return build_route(trajectory(line((0, 0), (8, 0))), room, radius=RADIUS).features

    assert [one.kind for one in narrow(0.4)] == [FeatureKind.OPENING]
    assert [one.kind for one in narrow(2.5)] == [FeatureKind.NARROW]


def test_the_length_of_a_persons_steps_is_learned_on_the_level_alone():
    known = StepLength()
    for step in range(200):
        known = learn(known, 0.5 * step, step, level=True)
    assert known.length == pytest.approx(0.5, abs=0.01)
    assert learn(known, 101.0, None, level=True).length == known.length
    on_stairs = known
    for step in range(50):
        on_stairs = learn(on_stairs, 100 + 0.29 * step, 200 + step, level=False)
    assert on_stairs.length == known.length
    shaken = known
    for step in range(50):
        shaken = learn(shaken, 100.0 + 0.01 * step, 200 + 5 * step, level=True)
    assert shaken.length == pytest.approx(known.length, abs=0.002)  # steps of two millimetres are none


def test_an_overview_counts_the_turn_on_the_spot_as_the_first_thing_to_do():
    path = line((0, 0), (6, 0), (6, 6), spacing=0.01, z=lambda s: 0.17 * np.searchsorted(8.0 + 0.3 * np.arange(5), s))
    route = build_route(trajectory(path), wide, radius=RADIUS, facing=np.radians(120))
    way = overview(route, "exit", 1.0, np.radians(-120))
    assert overview(route, "exit", 1.0, np.radians(30)).first is None
    assert (way.count, way.first.kind, [one.count for one in way.then]) == (0, Kind.TURN_NOW, [5])
    assert (way.soon.kind, way.soon.distance) == (Kind.TURN_SOON, pytest.approx(6.0, abs=0.1))
    assert way.first.amount < 0
    assert duration(route, 0.0, 1.0) < duration(route, 0.0, 0.7)
    assert duration(route, 6.0, 1.0) < duration(route, 0.0, 1.0)


def test_an_overview_names_all_flights_though_the_first_is_told_with_it():
    edges = [*(1.5 + 0.3 * np.arange(10)), *(6.0 + 0.3 * np.arange(3))]
    path = line((0, 0), (9, 0), spacing=0.01, z=lambda s: 0.17 * np.searchsorted(edges, s))
    way = overview(build_route(trajectory(path), wide, radius=RADIUS), "", 1.0)
    assert (way.soon.kind, way.soon.count) == (Kind.STAIRS, 10)
    assert "stairs up with 10 and 3 steps, about" in phrase(way)


@pytest.mark.parametrize(
    ("rise", "told"), [(2.0, ", a ramp up, "), (-2.0, ", a ramp down, "), (0.3, " 12 metres, about")]
)
def test_an_overview_tells_of_a_long_ramp(rise, told):
    path = line((0, 0), (12, 0), z=lambda s: rise * np.clip((s - 7.5) / 4.5, 0.0, 1.0))
    assert told in phrase(overview(build_route(trajectory(path), wide, radius=RADIUS), "", 1.0))


def test_where_one_is_is_told_by_the_nearest_place_of_the_storey():
    places = {"lift": [5.0, 1.0, 0.0], "attic": [2.0, 0.0, 3.0]}
    route = build_route(trajectory(line((0, 0), (12, 0))), wide, radius=RADIUS, places=places)
    said = here(route, 5.0, Pose((5.0, 0.0, 0.0), 0.0, 0.0), 1.0)
    assert (said.kind, said.name, said.side) == (Kind.HERE, "lift", Side.LEFT)
    assert said.then[0].distance == pytest.approx(7.0)


def test_less_is_said_who_wants_less_and_never_less_of_danger():
    few = changed(Manner(), Ask.FEWER_WORDS)
    assert few.detail is Detail.FEW
    assert not few.wants(Kind.STRAIGHT)
    assert all(
        few.wants(kind) for kind in (Kind.STAIRS, Kind.STAIRS_EDGE, Kind.STOP_LOST, Kind.TURN_SOON, Kind.ARRIVED)
    )
    assert changed(changed(few, Ask.MORE_WORDS), Ask.MORE_WORDS).wants(Kind.BEAR)


@pytest.mark.parametrize(
    ("place", "stops"),
    [((1.8, 0.0), True), ((2.0, 0.5), True), ((1.5, 0.95), False), ((0.5, 0.0), False)],
    ids=["on the path", "before the person, beside the path", "beside", "behind"],
)
def test_what_is_straight_before_a_person_stops_him_also_beside_the_path(place, stops):
    route = build_route(trajectory(line((0, 0), (8, 0))), wide, radius=RADIUS)
    thing = np.array([[*place, 1.0]])
    beside = advise(route, Pose((1.2, 0.45, 0.0), 0.0, 0.0), 0.0, near=1.2, obstacles=thing, moving=thing)
    if place == (2.0, 0.5):
        assert np.hypot(*(route.ground[:, :2] - place).T).min() > RADIUS  # the path itself is clear of it
    assert (beside.action is CueAction.STOP) == stops
    if stops:
        assert beside.instructions[0].kind is Kind.STOP_MOVING


def test_of_two_turns_behind_stairs_the_first_is_told_where_they_end():
    path = line((0, 0), (5.8, 0), (5.8, 1.3), (9, 1.3), z=lambda s: 0.17 * np.clip(np.ceil((s - 3.0) / 0.28), 0.0, 9.0))
    route = build_route(trajectory(path), wide, radius=RADIUS)
    end = next(one.end for one in route.features if one.kind is FeatureKind.STAIRS)
    assert sum(one.kind is FeatureKind.TURN for one in route.features) == 2
    told = [one.amount > 0 for s in (0.05, 0.1, 0.2) for one in find_ahead(route, Progress(end + s, 0.0)) if one.ends]
    assert told == [True, True, True]


def test_a_turn_that_begins_on_stairs_is_told_where_they_end():
    angle = np.linspace(0.0, np.pi / 2, 60)
    curve = np.array([4.6, 0.0]) + 1.4 * np.column_stack([np.sin(angle), 1 - np.cos(angle)])
    xy = np.concatenate([line((0, 0), (4.55, 0))[:, :2], curve, line((6.0, 1.45), (6.0, 6.0))[:, :2]])
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(xy, axis=0).T))])
    path = np.column_stack([xy, 0.17 * np.clip(np.ceil((s - 3.0) / 0.28), 0.0, 9.0)])
    route = build_route(trajectory(path), wide, radius=RADIUS)
    stairs = next(one for one in route.features if one.kind is FeatureKind.STAIRS)
    (turn,) = (one for one in route.features if one.kind is FeatureKind.TURN)
    assert turn.start == stairs.end
    for s_on in np.arange(stairs.start + 0.1, stairs.end - 0.05, 0.1):
        assert Kind.TURN_SOON not in {one.kind for one in find_ahead(route, Progress(float(s_on), 0.0))}
    for s_off in (0.02, 0.1, 0.3):
        (told,) = (one for one in find_ahead(route, Progress(stairs.end + s_off, 0.0)) if one.leaves_stairs)
        assert phrase(told) == "The stairs end. Turn left."


@pytest.mark.parametrize(("behind", "told"), [(0.5, True), (2.0, True), (3.5, False)])
def test_the_turn_that_comes_next_is_told_where_stairs_end(behind, told):
    corner = 5.5 + behind
    path = line((0, 0), (corner, 0), (corner, 6), z=lambda s: 0.17 * np.clip(np.ceil((s - 3.0) / 0.28), 0.0, 9.0))
    route = build_route(trajectory(path), wide, radius=RADIUS)
    end = next(one.end for one in route.features if one.kind is FeatureKind.STAIRS)
    (one,) = (one for one in find_ahead(route, Progress(end + 0.1, 0.0)) if one.leaves_stairs)
    assert (one.kind is Kind.TURN_SOON) == told


def test_what_moves_beside_a_person_is_told_with_its_side():
    here_is = Pose((0.0, 0.0, 0.0), 0.0, 0.0)
    (one,) = moves_near(here_is, np.array([[0.2, -2.0, 1.0]]))
    assert (one.kind, one.side) == (Kind.MOVING, Side.RIGHT)
    assert moves_near(here_is, np.array([[6.0, 0.0, 1.0]])) == []
    assert moves_near(here_is, np.array([[-2.0, 0.2, 1.0]])) == []  # behind him
    assert moves_near(here_is, np.array([[1.0, 0.0, 3.5]])) == []


def test_an_answer_is_said_though_it_was_said_before_and_the_end_cuts_off_everything():
    voice = Announcer(lambda one: "one two three four")
    reply = Instruction(Kind.HOW_FAR, Urgency.ACT, reply_to="1")
    assert voice.choose([reply], 0.0)
    assert voice.choose([reply], 0.5) is None  # the first one is being said
    assert voice.choose([reply], 5.0)
    stop = Instruction(Kind.STOP_LOST, Urgency.DANGER)
    assert voice.choose([stop], 20.0)
    assert voice.choose([Instruction(Kind.GAVE_UP_LOST, Urgency.DANGER)], 20.1)

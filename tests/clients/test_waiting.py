"""What a guide does with who waits: no service, a straight way, poses by hand."""

import dataclasses

import numpy as np
import pytest
from gpdf_client import Trajectory
from gpdf_guidance import Detail, Guide, Instruction, Kind, Manner, Outcome, Planned, Pose, Urgency, build_route
from gpdf_guidance.announcer import Announcer
from gpdf_guidance.catalogue import phrase
from gpdf_schemas import CueAction

IN_THE_WAY = np.array([[2.0, 0.0, 1.0]])


def led(detail=Detail.FEW, facing=0.0, hidden=0.0):
    """A guide at the start of 8 m straight on, and what it does for some seconds with a pose: cues, sentences."""
    x = np.arange(0.0, 8.01, 0.05)
    ground = np.column_stack([x, 0.0 * x, 0.0 * x])
    path = Trajectory(ground + np.array([0.0, 0.0, 2.0]), ground, x / 0.7, 0.0 * x)
    route = build_route(path, lambda places: 1.0 - np.abs(places[:, 1]) - 0.25, radius=0.25)
    route = dataclasses.replace(route, hidden_height=hidden)
    guide = Guide(None, (8.0, 0.0), manner=Manner(detail=detail))
    guide.take(Planned(route), Pose((0.0, 0.0, 0.0), facing, 0.0))
    clock = [0.0]

    def live(seconds, x=1.0, heading=0.0):
        cues, said = [], []
        for _ in range(round(10 * seconds)):
            cue, one = guide.step(Pose((x, 0.0, 0.0), heading, clock[0]), clock[0])
            cues.append(cue.action)
            said += [] if one is None else [one[0].kind]
            clock[0] += 0.1
        return cues, said

    return guide, live


def test_the_overview_is_heard_to_its_end_though_something_is_in_the_way():
    guide, live = led(Detail.NORMAL)
    guide.see(IN_THE_WAY)
    cues, said = live(8.0, x=0.0)
    assert set(cues) == {CueAction.STOP}
    assert said == [Kind.OVERVIEW, Kind.STOP_OBSTACLE]


def test_the_overview_is_heard_to_its_end_though_poses_are_missing():
    guide, live = led(Detail.NORMAL)
    live(0.5, x=0.0)
    last = Pose((0.0, 0.0, 0.0), 0.0, 0.4)
    steps = [guide.step(last, t) for t in np.arange(0.5, 12.0, 0.1)]
    assert {cue.action for cue, _ in steps} == {CueAction.STOP}
    assert [one[0].kind for _, one in steps if one is not None] == [Kind.STOP_LOST]  # after it


@pytest.mark.parametrize("detail", list(Detail))
def test_what_the_map_misses_is_told_once_and_before_the_first_step(detail):
    guide, live = led(detail, hidden=0.075)
    cue, (_, text) = guide.step(Pose((0.0, 0.0, 0.0), 0.0, 0.0), 0.0)
    assert cue.action is CueAction.STOP
    assert "I do not see things lower than 8 centimetres" in text
    cues, said = live(20.0, x=0.5)
    assert CueAction.GO in cues
    assert Kind.LOW_UNSEEN not in said
    guide.take(Planned(dataclasses.replace(guide.route, hidden_height=0.15)), Pose((0.5, 0.0, 0.0), 0.0, 20.0))
    assert live(20.0, x=0.5)[1] == [Kind.LOW_UNSEEN]  # a new way misses more
    guide.take(Planned(guide.route), Pose((0.5, 0.0, 0.0), 0.0, 40.0))
    assert live(20.0, x=0.5)[1] == []


def test_where_the_map_shows_what_a_foot_notices_nothing_is_said_of_it():
    guide, live = led(Detail.NORMAL, hidden=0.05)
    _, (_, text) = guide.step(Pose((0.0, 0.0, 0.0), 0.0, 0.0), 0.0)
    assert "misses" not in text
    assert Kind.LOW_UNSEEN not in live(20.0)[1]


@pytest.mark.parametrize(
    ("facing", "first"), [(30, "."), (-45, ". Turn slightly left."), (-100, ". Turn left."), (100, ". Turn right.")]
)
def test_the_overview_ends_with_the_turn_that_the_cue_asks_for_first(facing, first):
    guide, live = led(Detail.NORMAL, np.radians(facing))
    one, text = guide.step(Pose((0.0, 0.0, 0.0), np.radians(facing), 0.0), 0.0)[1]
    assert one.kind is Kind.OVERVIEW
    assert text.endswith(f"seconds{first}")
    assert Kind.TURN_NOW not in live(10.0, x=0.0, heading=np.radians(facing))[1]  # the cue turns him


def test_what_comes_back_is_waited_for_longer_until_one_has_got_on():
    guide, live = led()
    waited = []
    for x in (1.0, 1.0, 1.0, 1.0, 1.9):
        guide.see(IN_THE_WAY + np.array([x - 1.0, 0.0, 0.0]))
        live(12.0, x)  # "Stop." has been said to the end
        guide.see(None)
        cues, said = live(6.0, x)
        waited.append(cues.count(CueAction.STOP) / 10)
        assert said[-1] is Kind.RESUME
    assert np.allclose(waited, [1.0, 2.0, 4.0, 4.0, 1.0], atol=0.11)


def test_who_crosses_the_way_is_felt_and_is_spoken_of_only_if_he_stays():
    for seconds, felt, told in ((2.9, True, 0), (5.0, True, 1), (28.0, True, 2), (0.3, False, 1)):
        guide, live = led()
        guide.felt = felt
        guide.see(IN_THE_WAY, IN_THE_WAY)
        cues, said = live(seconds)
        assert set(cues) == {CueAction.STOP}
        assert said == told * [Kind.STOP_MOVING]


def test_who_has_not_set_off_is_not_told_to_stop_for_what_is_soon_over():
    guide, live = led(Detail.NORMAL)
    guide.see(IN_THE_WAY, IN_THE_WAY)
    cues, said = live(9.0)
    assert (set(cues), said) == ({CueAction.STOP}, [Kind.OVERVIEW])
    guide.see(None)
    cues, said = live(4.0)
    assert (CueAction.GO in cues, said) == (True, [])
    guide.see(IN_THE_WAY, IN_THE_WAY)
    assert live(3.5)[1] == [Kind.STOP_MOVING]  # he walks now


def test_who_has_not_set_off_hears_why_he_waits_for_long():
    guide, live = led(Detail.NORMAL)
    guide.see(IN_THE_WAY, IN_THE_WAY)
    assert live(20.0)[1] == [Kind.OVERVIEW, Kind.STOP_MOVING]


@pytest.mark.parametrize(("detail", "after"), [(Detail.FEW, 3.0), (Detail.NORMAL, 8.0)])
def test_why_one_waits_is_told_though_other_ways_are_asked_for_meanwhile(detail, after):
    guide, live = led(detail)
    guide.see(IN_THE_WAY, IN_THE_WAY)
    said, now = [], 0.0
    begins = 4.0 if detail is Detail.NORMAL else 0.0  # the overview
    while Kind.STOP_MOVING not in said:
        now += 0.1
        here = Pose((1.0, 0.0, 0.0), 0.0, now)
        if guide.wants_route(here, now):
            guide.take(Planned(guide.route), here)
        said += live(0.1)[1]
        assert now < begins + after + 0.5


def test_a_thing_that_one_is_led_past_is_felt_when_it_stops_him_again():
    guide, live = led()
    guide.see(IN_THE_WAY)
    assert live(3.0)[1] == [Kind.STOP_OBSTACLE]
    guide.see(None)
    assert live(4.0)[1] == [Kind.RESUME]
    guide.see(IN_THE_WAY)
    cues, said = live(7.0, x=1.3)
    assert (set(cues), said) == ({CueAction.STOP}, [])
    assert live(3.0, x=1.3)[1] == [Kind.STOP_OBSTACLE]  # but he is told if it stays
    guide.see(None)
    assert live(6.0, x=1.3)[1] == [Kind.RESUME]
    live(1.0, x=1.8)
    live(1.0, x=2.6)
    live(1.0, x=3.4)
    live(1.0, x=4.0)
    guide.see(IN_THE_WAY + np.array([3.0, 0.0, 0.0]))
    assert live(0.3, x=4.0)[1] == [Kind.STOP_OBSTACLE]  # that is another one


def test_who_was_held_for_a_missing_pose_is_not_told_that_the_way_is_unsure():
    guide, live = led()
    live(1.0)
    last = Pose((1.0, 0.0, 0.0), 0.0, 1.0)
    said = [guide.step(last, t)[1] for t in np.arange(1.0, 3.6, 0.1)]
    turned = [guide.step(Pose((1.0, 0.0, 0.0), 0.9, t), t)[1] for t in np.arange(3.6, 4.2, 0.1)]
    assert [one[0].kind for one in said + turned if one is not None] == []


def test_the_first_turn_is_not_told_again_at_the_end_of_a_long_overview():
    _, live = led(Detail.NORMAL, np.radians(-120), hidden=0.075)
    assert live(14.0, x=0.0, heading=np.radians(-120))[1] == [Kind.OVERVIEW]


def test_who_was_told_to_stop_feels_go_when_he_hears_it():
    guide, live = led()
    guide.see(IN_THE_WAY, IN_THE_WAY)
    assert live(3.1)[1] == [Kind.STOP_MOVING]
    guide.see(None)
    felt, heard = zip(*(live(0.1) for _ in range(30)), strict=True)
    walks = [CueAction.GO in cues for cues in felt]
    assert walks.index(True) == heard.index([Kind.RESUME]) > 10


@pytest.mark.parametrize(("moving", "patience"), [(None, 3.0), (IN_THE_WAY, 8.0)], ids=["a thing", "somebody"])
def test_another_way_is_asked_for_sooner_round_a_thing_than_round_somebody(moving, patience):
    guide, live = led()
    live(1.0)
    guide.see(IN_THE_WAY, moving)
    live(patience - 0.3)
    assert not guide.wants_route(Pose((1.0, 0.0, 0.0), 0.0, patience + 0.7), patience + 0.7)
    live(0.5)
    assert guide.wants_route(Pose((1.0, 0.0, 0.0), 0.0, patience + 1.2), patience + 1.2)


def test_who_goes_on_hears_what_comes_in_the_same_breath():
    go_on = Instruction(Kind.RESUME, Urgency.DANGER)
    stairs = Instruction(Kind.STAIRS, Urgency.ACT, (2.0, 0.0), 1.2, 0.17, 7)
    voice = Announcer(phrase)
    one, text = voice.choose([go_on, stairs], 0.0)
    assert text == "Go on. In 1 metre, take the stairs up, 7 steps."
    assert (one.kind, one.place) == (Kind.STAIRS, stairs.place)
    assert voice.choose([go_on, stairs], 6.0) is None  # both were told
    alone = Announcer(phrase)
    assert alone.choose([go_on], 0.0)[1] == "Go on."
    assert alone.choose([go_on, stairs], 3.0)[1] == phrase(stairs)


def test_one_wrong_pose_turns_nobody():
    _, live = led()
    assert CueAction.GO in live(0.5)[0]
    assert live(0.1, heading=1.5)[0] == [CueAction.STOP]
    assert live(0.1)[0] == [CueAction.GO]
    assert live(0.2, heading=1.5)[0] == [CueAction.STOP, CueAction.TURN]


def test_arrival_is_told_once():
    guide, live = led()
    for x in np.arange(0.0, 8.0, 0.05):
        live(0.1, x)
    cues, said = live(20.0, 7.99)
    assert guide.outcome is Outcome.ARRIVED
    assert set(cues) == {CueAction.ARRIVED}
    assert said in ([], [Kind.ARRIVED])

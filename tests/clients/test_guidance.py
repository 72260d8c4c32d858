"""Advice, features, words and budget as pure functions; the walker's errors."""

import dataclasses
import shutil

import numpy as np
import pytest
from gpdf_client import Trajectory
from gpdf_guidance import Announcer, Errors, Instruction, Kind, Pose, Side, Urgency, Walker, advise, build_route
from gpdf_guidance.advice import BLIND, OVER_TURN, PACES, POSE_AGE, SWAY, UNRELIABLE
from gpdf_guidance.belief import believe
from gpdf_guidance.features import Feature, FeatureKind, find_ramps, find_steps, find_turns
from gpdf_guidance.planner import PERSON
from gpdf_guidance.route import join
from gpdf_guidance.stairs import find_stairs, obliqueness, places_to_stand
from gpdf_guidance.voice import Voice
from gpdf_guidance.walker import EXACT
from gpdf_schemas import CueAction, CueMessage

import gpdf_service as gpdf

RADIUS = 0.25


def trajectory(ground):
    ground = np.asarray(ground, dtype=float)
    step = np.diff(ground[:, :2], axis=0)
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*step.T))])
    heading = np.arctan2(step[:, 1], step[:, 0])
    return Trajectory(ground + np.array([0, 0, 2.0]), ground, s / 0.7, np.append(heading, heading[-1]))


def line(*corners, spacing=0.05, z=lambda s: 0.0 * s):
    corners = np.asarray(corners, dtype=float)
    legs = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))])
    s = np.linspace(0.0, legs[-1], round(legs[-1] / spacing) + 1)
    xy = np.column_stack([np.interp(s, legs, corners[:, k]) for k in (0, 1)])
    return np.column_stack([xy, z(s)])


def corridor(half_width):
    """A straight corridor along x."""
    return lambda places: half_width - np.abs(places[:, 1]) - RADIUS


def wide(places):
    return np.full(len(places), 3.0)


def straight(half_width=1.0, **options):
    return build_route(trajectory(line((0, 0), (8, 0))), corridor(half_width), radius=RADIUS, **options)


def pose(x, y, heading=0.0, stamp=0.0, **options):
    return Pose((x, y, 0.0), np.radians(heading), stamp, **options)


def kinds(advice):
    return [one.kind for one in advice.instructions]


def test_a_turn_is_found_with_its_side_and_angle():
    for sign in (1, -1):
        path = line((0, 0), (3, 0), (3, 3 * sign))
        (turn,) = find_turns(path[:, :2], np.linspace(0, 6, len(path)))
        assert turn.kind is FeatureKind.TURN
        assert turn.amount == pytest.approx(sign * np.pi / 2, abs=0.1)
        assert turn.start == pytest.approx(3.0, abs=0.2)


def test_a_gentle_bend_is_no_turn_and_a_sway_is_nothing():
    s = np.linspace(0, 6, 121)
    bend = np.column_stack([s, np.where(s > 3, (s - 3) * np.tan(np.radians(40)), 0.0)])
    assert [feature.kind for feature in find_turns(bend, s)] == [FeatureKind.BEAR]
    assert find_turns(np.column_stack([s, 0.1 * np.sin(2 * s)]), s) == []


@pytest.mark.parametrize("radius", [0.5, 1.0, 1.4, 1.7, 2.0])
@pytest.mark.parametrize("degrees", [70, 80, 90])
def test_a_turn_in_a_curve_is_one_turn(radius, degrees):
    angle = np.linspace(0, np.radians(degrees), 60)
    curve = radius * np.column_stack([np.sin(angle), 1 - np.cos(angle)])
    on = np.array([np.cos(angle[-1]), np.sin(angle[-1])])
    path = np.concatenate(
        [line((-3, 0), (-0.05, 0))[:, :2], curve, line(curve[-1] + 0.05 * on, curve[-1] + 3 * on)[:, :2]]
    )
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])
    (turn,) = find_turns(path, s)
    assert turn.kind is FeatureKind.TURN
    assert turn.amount == pytest.approx(np.radians(degrees), abs=0.15)


def test_single_steps_keep_their_height_and_direction():
    s = np.linspace(0, 6, 121)
    z = np.where(s > 2, 0.17, 0.0) - np.where(s > 4, 0.3, 0.0)
    up, down = find_steps(z, s)
    assert (up.kind, down.kind) == (FeatureKind.STEP, FeatureKind.STEP)
    assert (up.amount, down.amount) == (pytest.approx(0.17), pytest.approx(-0.3))
    assert (up.start, down.start) == (pytest.approx(2.0, abs=0.06), pytest.approx(4.0, abs=0.06))


@pytest.mark.parametrize("once_more", [(1.64, 1.68), (1.7, 1.79)], ids=["a cell", "the corner of a tread"])
def test_an_edge_that_is_crossed_twice_within_a_foot_is_one_step(once_more):
    s = np.linspace(0, 4, 161)
    z = -0.17 * np.searchsorted([1.0, 1.3, 1.6, 1.9, 2.2], s)
    z[(s > once_more[0]) & (s < once_more[1])] += 0.17  # the upper tread, behind its edge
    (stairs,) = find_steps(z, s)
    assert (stairs.kind, stairs.count) == (FeatureKind.STAIRS, 5)
    assert stairs.amount == pytest.approx(-0.17)


def test_stairs_are_counted_and_a_landing_parts_them():
    s = np.linspace(0, 10, 401)
    edges = np.concatenate([1 + 0.29 * np.arange(10), 5.5 + 0.29 * np.arange(7)])
    z = 0.17 * (s[:, None] > edges).sum(axis=1)
    stairs = find_steps(z, s)
    assert [(one.kind, one.count) for one in stairs] == [(FeatureKind.STAIRS, 10), (FeatureKind.STAIRS, 7)]
    assert stairs[0].amount == pytest.approx(0.17)
    down = find_steps(-z, s)
    assert [one.count for one in down] == [10, 7]
    assert down[0].amount == pytest.approx(-0.17)
    assert find_ramps(z, s) == []


def test_two_steps_are_told_of_together():
    s = np.linspace(0, 4, 161)
    (stairs,) = find_steps(-0.17 * np.searchsorted([1.0, 1.3], s), s)
    assert (stairs.kind, stairs.count) == (FeatureKind.STAIRS, 2)


@pytest.mark.parametrize(("second", "height"), [(5.7, 0.3), (5.3, 0.0)], ids=["a deep tread", "a sill"])
def test_every_step_is_told_of_though_another_one_is_near(second, height):
    path = line((0, 0), (8, 0), z=lambda s: np.where(s > second, height, np.where(s > 5.0, 0.15, 0.0)))
    route, voice = build_route(trajectory(path), wide, radius=RADIUS), announcer()
    said = [
        voice.choose(advise(route, Pose((s, 0.0, 0.0), 0.0, 0.0), 0.0, near=s).instructions, 10 * s)
        for s in np.arange(2.0, 5.0, 0.1)
    ]
    told = [one[0].amount for one in said if one is not None and one[0].kind is Kind.STEP]
    assert told == pytest.approx([0.15, height - 0.15], abs=0.01)


def test_a_ramp_is_no_step_and_a_floor_is_no_ramp():
    s = np.linspace(0, 8, 161)
    z = np.clip(s - 2, 0, 3) * 0.1
    (ramp,) = find_ramps(z, s)
    assert (ramp.kind, find_steps(z, s)) == (FeatureKind.RAMP, [])
    assert ramp.amount == pytest.approx(0.3, abs=0.03)
    assert find_ramps(0.01 * np.sin(3 * s), s) == []
    assert find_ramps(-z, s)[0].amount < 0


def test_narrow_places_and_head_height_obstacles_are_features():
    def door(places):
        near = np.abs(places[:, 0] - 4) < 0.3
        return np.where(near, 0.36, 1.5) - np.abs(places[:, 1]) - RADIUS

    (narrow,) = build_route(trajectory(line((0, 0), (8, 0))), door, radius=RADIUS).features
    assert narrow.kind is FeatureKind.OPENING
    assert narrow.amount == pytest.approx(0.72, abs=0.05)
    assert 3.5 < narrow.start < narrow.end < 4.5

    def ball(places):
        return np.hypot(places[:, 0] - 4, places[:, 1] - 0.75) - 0.3 - RADIUS

    route = build_route(trajectory(line((0, 0), (8, 0))), ball, room_low=wide, radius=RADIUS)
    (head,) = (feature for feature in route.features if feature.kind is FeatureKind.HEAD)
    assert head.amount > 0  # on the left
    low = build_route(trajectory(line((0, 0), (8, 0))), ball, room_low=ball, radius=RADIUS)
    assert all(feature.kind is not FeatureKind.HEAD for feature in low.features)  # a cane finds what stands


def test_progress_follows_the_path_and_knows_left_from_right():
    route = straight()
    assert route.locate(pose(3.0, 0.2), 2.5).s == pytest.approx(3.0)
    assert route.locate(pose(3.0, 0.2), 2.5).offset == pytest.approx(0.2)
    assert route.locate(pose(3.0, -0.2), 2.5).offset == pytest.approx(-0.2)


def test_a_path_that_passes_itself_is_not_confused():
    there_and_back = line((0, 0), (4, 0), (4, 0.3), (0, 0.3))
    route = build_route(trajectory(there_and_back), wide, radius=RADIUS)
    assert route.locate(pose(2.0, 0.15), 1.5).s == pytest.approx(2.0, abs=0.1)
    assert route.locate(pose(2.0, 0.15), 6.0).s == pytest.approx(6.3, abs=0.1)


def test_the_corridor_ends_where_the_room_does():
    route = straight(half_width=0.6)
    y = np.array([0.0, 0.2, -0.2, 0.3, -0.3])
    inside = route.inside(np.column_stack([np.full(5, 3.0), y]), 3.0)
    assert inside.tolist() == [True, True, True, False, False]


def test_an_old_or_unreliable_pose_stops_and_a_fresh_one_does_not():
    route = straight()
    fresh = advise(route, pose(1, 0, stamp=10.0), 9.99 + POSE_AGE, near=1.0)
    assert fresh.action is CueAction.GO
    old = advise(route, pose(1, 0, stamp=10.0), 10.01 + POSE_AGE, near=1.0)
    assert (old.action, old.urgency, kinds(old)) == (CueAction.STOP, 1.0, [Kind.STOP_LOST])
    blurred = advise(route, pose(1, 0, accuracy=UNRELIABLE + 0.01), 0.0, near=1.0)
    assert (blurred.action, kinds(blurred)) == (CueAction.STOP, [Kind.STOP_UNRELIABLE])


@pytest.mark.parametrize(
    ("obstacle", "stops"),
    [
        ((3.0, 0.0, 1.0), True),
        ((3.0, 0.2, 0.3), True),
        ((3.0, 0.9, 1.0), False),
        ((3.0, 0.0, 2.2), False),
        ((3.0, 0.0, 0.01), False),
        ((0.2, 0.0, 1.0), False),
        ((6.5, 0.0, 1.0), False),
    ],
    ids=["ahead", "in the body's way", "beside", "overhead", "dust", "behind", "far"],
)
def test_a_new_obstacle_stops_only_where_it_is_in_the_way(obstacle, stops):
    advice = advise(straight(), pose(1.5, 0), 0.0, near=1.5, obstacles=np.array([obstacle]))
    assert (advice.action is CueAction.STOP) == stops
    assert (Kind.STOP_OBSTACLE in kinds(advice)) == stops


@pytest.mark.parametrize(
    ("pace", "gap", "stops"), [(0.7, 1.5, True), (0.7, 2.4, False), (0.3, 1.2, False), (0.3, 0.6, True)]
)
def test_who_goes_slowly_on_stairs_is_stopped_for_a_new_thing_later_than_on_the_level(pace, gap, stops):
    treads = lambda s: 0.17 * np.searchsorted(1.0 + 0.3 * np.arange(15), s)  # noqa: E731
    flat = build_route(trajectory(line((0, 0), (8, 0))), wide, radius=RADIUS)
    flight = build_route(trajectory(line((0, 0), (8, 0), spacing=0.01, z=treads)), wide, radius=RADIUS)
    route = flat if pace == PACES[0] else flight
    height = route.at(2.0)[2]
    who = Pose((2.0, 0.0, height), 0.0, 0.0)
    thing = np.array([[2.0 + RADIUS + gap, 0.0, height + 1.0]])
    advice = advise(route, who, 0.0, near=2.0, obstacles=thing, told=pace)
    assert (Kind.STOP_OBSTACLE in kinds(advice)) is stops
    assert advice.pace <= pace


@pytest.mark.parametrize(("gap", "pace"), [(2.4, PACES[0]), (1.5, PACES[1]), (0.9, PACES[1]), (0.8, 0.0)])
def test_who_comes_the_same_way_is_met_slowly_and_stopped_for_only_when_he_is_near(gap, pace):
    who = np.array([[2.0 + RADIUS + gap, 0.0, 1.0]])
    advice = advise(straight(), pose(2.0, 0.0), 0.0, near=2.0, obstacles=who, moving=who)
    assert advice.pace == pace
    assert (Kind.STOP_MOVING in kinds(advice)) == (pace == 0.0)


@pytest.mark.parametrize(("told", "action"), [(PACES[0], CueAction.STOP), (0.0, CueAction.TURN)])
def test_who_stands_turns_away_from_a_new_thing_that_he_faces(told, action):
    facing = np.array([[2.0, 0.55, 1.0]])  # half a metre straight ahead, and not on the way
    advice = advise(straight(), pose(1.5, 0.0, 45), 0.0, near=1.5, obstacles=facing, told=told)
    assert advice.action is action
    assert (Kind.STOP_OBSTACLE in kinds(advice)) == (action is CueAction.STOP)


def test_a_thing_straight_ahead_beside_the_way_is_come_near_slowly_and_not_touched():
    beside = np.array([[2.3, 0.4, 1.0]])
    paces = [advise(straight(), pose(x, 0.0), 0.0, near=x, obstacles=beside, told=0.0).pace for x in (0.5, 1.3, 1.9)]
    assert paces == [PACES[0], PACES[1], 0.0]


def test_a_step_beside_the_way_is_kept_off():
    def level(places):  # the edge of a step 0.5 m to the left
        return 0.5 - places[:, 1] - RADIUS

    left = straight(half_width=2.0, room_level=level).left
    assert straight(half_width=2.0).left.min() >= 0.5 > left.max() > 0.0
    assert 0.5 - left.max() >= 0.24  # half of the way's own distance, at most half a pace


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("gap", [0.0, 0.02, 0.04, 0.06, 0.1])
def test_beside_a_ledge_nobody_is_led_onto_it_and_one_may_step_away_from_it(side, gap):
    edge = np.column_stack([np.arange(-1.0, 4.0, 0.05), np.full(100, side * gap)])  # a platform of 0.35 m, 5 m long

    def level(places):
        return np.hypot(*(places[:, None, :2] - edge).transpose(2, 0, 1)).min(axis=1) - RADIUS

    def field(places):  # a floor, and the platform's top
        inside = (side * places[:, 1] > gap) & (places[:, 0] < 4.0)
        aside = np.minimum(np.abs(places[:, 1] - side * gap), 4.0 - places[:, 0])
        return np.where(inside, np.minimum(aside, 0.35), 0.0), np.zeros((len(places), 3))

    route = straight(half_width=2.0, room_level=level, field=field)
    towards, other = (route.left, route.right) if side > 0 else (route.right, route.left)
    beside = route.s < 3.9
    assert towards[beside].max() <= gap + 1e-9
    assert other[beside].min() > 0.5
    assert towards[route.s > 5.0].min() > 0.5


def test_who_leaves_the_corridor_is_stopped():
    advice = advise(straight(half_width=0.7), pose(3, 0.45), 0.0, near=3.0)
    assert (advice.action, advice.off_way, kinds(advice)) == (CueAction.STOP, True, [Kind.STOP_OFF_WAY])


@pytest.mark.parametrize(
    ("x", "heading", "there"),
    [
        (7.95, 0, True),
        (7.9, 0, True),
        (7.75, 0, False),
        (7.4, 0, False),
        (8.1, 0, True),
        (8.6, 0, False),
    ],
)
def test_arrival_is_where_one_who_is_told_to_stop_stands_at_the_goal(x, heading, there):
    advice = advise(straight(), pose(x, 0.0, heading), 0.0, near=min(x, 8.0))
    assert (advice.action is CueAction.ARRIVED) == there
    assert (Kind.ARRIVED in kinds(advice)) == there


def test_one_goes_slowly_before_the_goal():
    paces = [advise(straight(), pose(x, 0.0), 0.0, near=x).pace for x in (6.5, 7.2, 7.6)]
    assert paces == [PACES[0], PACES[1], PACES[2]]


def test_who_cannot_get_nearer_hears_where_the_goal_is():
    walled = build_route(trajectory(line((0, 0), (8, 0))), lambda places: 7.7 - places[:, 0], radius=RADIUS)
    for heading, side in ((0, Side.AHEAD), (90, Side.RIGHT), (-90, Side.LEFT), (180, Side.BEHIND)):
        advice = advise(walled, pose(7.68, 0.0, heading), 0.0, near=7.68)
        assert advice.action is CueAction.ARRIVED
        assert (advice.instructions[0].kind, advice.instructions[0].side) == (Kind.ARRIVED_BESIDE, side)


def test_the_cue_points_along_the_path_whichever_way_one_looks():
    for heading in (-170, -90, -20, 0, 30, 120):
        advice = advise(straight(), pose(2, 0, heading), 0.0, near=2.0)
        assert np.degrees(advice.direction) == pytest.approx(-heading, abs=5)
        assert (advice.action is CueAction.TURN) == (abs(heading) >= 40)


def test_who_sways_is_led_back_to_the_other_side():
    for side in (1, -1):
        advice = advise(straight(), pose(2, 0.4 * side), 0.0, near=2.0)
        assert advice.direction * side < 0


def test_a_turn_is_announced_before_and_confirmed_after_and_corrected():
    route = build_route(trajectory(line((0, 0), (4, 0), (4, 4))), wide, radius=RADIUS)
    before = advise(route, pose(2.0, 0), 0.0, near=2.0).instructions
    (soon,) = (one for one in before if one.kind is Kind.TURN_SOON)
    assert soon.distance == pytest.approx(2.0, abs=0.2)
    assert soon.amount > 0
    (done,) = (one for one in advise(route, pose(4, 0.2, 90), 0.0, near=4.2).instructions if one.kind is Kind.GO_ON)
    assert done.distance == pytest.approx(3.8, abs=0.3)
    (back,) = (
        one for one in advise(route, pose(4, 0.1, 115), 0.0, near=4.1).instructions if one.kind is Kind.TURN_BACK
    )
    assert back.amount < 0  # to the right


@pytest.mark.parametrize(("steps", "told"), [(0.4, None), (2.3, None), (9.3, 9.1)])
def test_after_a_turn_one_hears_how_far_it_is_to_what_is_not_told_of_by_itself_soon(steps, told):
    path = line((0, 0), (4, 0), (4, 12), z=lambda s: np.where(s > 4.0 + steps, 0.17, 0.0))
    route = build_route(trajectory(path), wide, radius=RADIUS)
    on = [one for one in advise(route, pose(4, 0.2, 90), 0.0, near=4.2).instructions if one.kind is Kind.GO_ON]
    assert [one.distance for one in on] == ([] if told is None else [pytest.approx(told, abs=0.1)])


def test_the_turn_before_the_first_step_is_told():
    route = straight(facing=np.radians(120))
    advice = advise(route, pose(0, 0, 120), 0.0, near=0.0)
    assert advice.instructions[0].kind is Kind.TURN_NOW
    assert advice.instructions[0].amount < 0
    over = advise(route, pose(0, 0, -17), 0.0, near=0.0)
    assert Kind.TURN_BACK in kinds(over)


@pytest.mark.parametrize(("distance", "told"), [(3.2, False), (2.5, True), (1.2, True), (0.5, True), (-0.3, False)])
def test_a_step_is_told_of_one_to_three_metres_before(distance, told):
    path = line((0, 0), (8, 0), z=lambda s: np.where(s > 5, -0.15, 0.0))
    route = build_route(trajectory(path), wide, radius=RADIUS)
    advice = advise(route, pose(5 - distance, 0), 0.0, near=5 - distance)
    steps = [one for one in advice.instructions if one.kind is Kind.STEP]
    assert bool(steps) == told
    if told:
        assert steps[0].amount == pytest.approx(-0.15)
        assert steps[0].distance == pytest.approx(distance, abs=0.1)
    slow = advise(route, pose(4.2, 0), 0.0, near=4.2)
    assert (slow.action, slow.pace) == (CueAction.SLOW, PACES[1])


def test_the_next_stairs_are_told_of_at_the_end_of_the_first():
    edges = np.concatenate([2 + 0.29 * np.arange(10), 6.0 + 0.29 * np.arange(5)])
    path = line((0, 0), (9, 0), z=lambda s: 0.17 * (s[:, None] > edges).sum(axis=1))
    route = build_route(trajectory(path), wide, radius=RADIUS)

    def told(s):
        here = Pose(tuple(route.at(s)), 0.0, 0.0)
        return [one.count for one in advise(route, here, 0.0, near=s).instructions if one.kind is Kind.STAIRS]

    assert told(0.5) == [10]
    assert told(3.5) == []
    assert told(4.5) == []  # it would be too much on the stairs
    assert told(4.7) == [5]


def test_who_hears_nothing_more_stops_inside_the_corridor():
    rng = np.random.default_rng(0)
    walked = 0
    for half_width in (0.35, 0.45, 0.6, 1.0):
        route = straight(half_width)
        for _ in range(100):
            x, y = rng.uniform(1, 6), rng.uniform(-1, 1) * (half_width - RADIUS)
            now = pose(x, y, rng.uniform(-60, 60))
            advice = advise(route, now, 0.0, near=x)
            if advice.pace == 0.0:
                continue
            walked += 1
            for sway in (-SWAY, 0.0, SWAY):
                heading = now.heading + sway
                blind = advice.pace * BLIND * np.array([np.cos(heading), np.sin(heading)])
                assert corridor(half_width)(np.array([[x + blind[0], y + blind[1], 0.0]]))[0] >= 0
    assert walked > 100


def test_a_narrower_corridor_is_walked_more_slowly():
    paces = [advise(straight(width), pose(3, 0), 0.0, near=3.0).pace for width in (1.0, 0.42, 0.36)]
    assert paces == sorted(paces, reverse=True)
    assert paces[0] == PACES[0] > paces[-1] > 0


def announcer():
    return Announcer(lambda instruction: "one two three")


def informing(i, urgency=Urgency.INFORM):
    return Instruction(Kind.BEAR, urgency, (10.0 * i, 0.0))


def test_a_flood_is_cut_to_the_budget():
    voice, said = announcer(), 0
    for tick in range(6000):  # ten minutes
        said += voice.choose([informing(tick)], 0.1 * tick) is not None
    assert 30 <= said <= 80


def test_the_most_urgent_is_said_first_and_at_once():
    voice = announcer()
    urgent = Instruction(Kind.STEP, Urgency.ACT, (5.0, 0.0))
    assert voice.choose([urgent, informing(0)], 0.0)[0] is urgent
    danger = Instruction(Kind.STOP_OBSTACLE, Urgency.DANGER)
    assert voice.choose([danger], 0.1)[0] is danger  # cuts the sentence off
    assert voice.choose([informing(1)], 0.2) is None


def test_the_same_thing_is_said_once_also_after_another_plan():
    voice = announcer()
    assert voice.choose([Instruction(Kind.STEP, Urgency.ACT, (5.0, 0.0))], 0.0)
    assert voice.choose([Instruction(Kind.STEP, Urgency.ACT, (5.2, 0.1))], 5.0) is None
    assert voice.choose([Instruction(Kind.STEP, Urgency.ACT, (7.0, 0.0))], 5.0)


def test_who_has_climbed_a_part_of_stairs_is_not_told_of_them_again():
    voice = announcer()
    first = Instruction(Kind.STAIRS, Urgency.ACT, (2.0, 0.0), amount=0.17, count=10, last=(5.0, 0.0))
    assert voice.choose([first], 0.0)
    further = dataclasses.replace(first, place=(3.5, 0.0), count=5)  # another way, planned on the stairs
    assert voice.choose([further], 10.0) is None
    assert voice.choose([dataclasses.replace(further, last=(9.0, 0.0))], 10.0)  # other stairs
    assert voice.choose([further], 50.0)  # by then it may be forgotten


def test_danger_is_said_again_while_it_lasts():
    voice = announcer()
    danger = Instruction(Kind.STOP_OBSTACLE, Urgency.DANGER)
    times = [tick / 10 for tick in range(300) if voice.choose([danger], tick / 10)]
    assert 3 <= len(times) <= 5


def two_flights(landing):
    """Two flights of four steps with a landing between them; where the first one ends."""
    risers = 2.0 + 0.3 * np.arange(4)
    risers = np.concatenate([risers, risers[-1] + landing + 0.3 * np.arange(4)])
    path = line((0, 0), (9, 0), spacing=0.01, z=lambda s: 0.17 * np.searchsorted(risers, s))
    return build_route(trajectory(path), wide, radius=RADIUS), risers[3]


def test_a_second_flight_is_told_of_where_the_first_one_ends():
    route, end = two_flights(landing=1.6)
    on_it = advise(route, Pose((end - 0.3, 0.0, 0.5), 0.0, 0.0), 0.0, near=end - 0.3)
    assert kinds(on_it) == [Kind.ON_STAIRS]  # which who came to them from before has heard
    off_it = advise(route, Pose((end + 0.1, 0.0, 0.68), 0.0, 0.0), 0.0, near=end)
    assert kinds(off_it) == [Kind.STAIRS]
    assert off_it.instructions[0].ends
    assert off_it.instructions[0].distance == pytest.approx(1.5, abs=0.1)


def test_who_stands_before_the_next_stairs_does_not_hear_any_more_that_the_last_ones_end():
    route, end = two_flights(landing=1.0)
    told = [kinds(advise(route, Pose((end + on, 0.0, 0.68), 0.0, 0.0), 0.0, near=end + on)) for on in (0.3, 0.58)]
    assert [Kind.STAIRS_END in one for one in told] == [True, False]
    assert Kind.STAIRS_EDGE in told[1]


def test_a_flight_right_behind_a_short_landing_is_told_of_before():
    route, end = two_flights(landing=0.9)
    on_it = advise(route, Pose((end - 0.3, 0.0, 0.5), 0.0, 0.0), 0.0, near=end - 0.3).instructions
    (told,) = (one for one in on_it if one.kind is not Kind.ON_STAIRS)
    assert told.kind is Kind.STAIRS
    assert told.after == pytest.approx(0.9, abs=0.05)
    assert not told.ends
    assert Kind.STAIRS_END in kinds(advise(route, Pose((end + 0.1, 0.0, 0.68), 0.0, 0.0), 0.0, near=end))


def test_what_lies_on_stairs_is_not_told_as_if_it_came_behind_them():
    route, end = two_flights(landing=1.6)
    head = [Feature(FeatureKind.HEAD, at, at + 0.2, 1.0) for at in (end - 0.65, end + 0.4)]
    route = dataclasses.replace(route, features=(*route.features, *head))
    here = end - 0.85
    found = advise(route, Pose(tuple(route.at(here)), 0.0, 0.0), 0.0, near=here).instructions
    afters = [one.after for one in found if one.kind is Kind.HEAD]
    assert afters == [None, pytest.approx(0.4, abs=0.01)]


def test_a_neck_as_wide_as_a_person_needs_has_no_gap():
    neck = straight(half_width=RADIUS + 0.08)
    along = np.column_stack([np.arange(1.0, 7.0, 0.01), np.full(600, 0.035)])
    assert all(neck.inside(place[None], place[0])[0] for place in along)
    assert not neck.inside(np.array([[4.0, 0.045]]), 4.0)[0]


def test_what_juts_out_between_two_samples_makes_the_corridor_narrower():
    post = np.array([4.05, 0.30])

    def room(places):
        return np.hypot(*(places[:, :2] - post).T) - RADIUS

    route = build_route(trajectory(line((0, 0), (8, 0), spacing=0.1)), room, radius=RADIUS)
    assert route.room.min() == pytest.approx(0.05, abs=0.002)


def test_a_scattering_pose_is_smoothed_and_a_wrong_belief_is_dropped():
    rng, belief, off = np.random.default_rng(0), None, []
    for tick in range(200):
        seen = Pose((0.01 * tick + rng.normal(0, 0.02), rng.normal(0, 0.02), 0.0), 0.0, 0.1 * tick, 0.02)
        belief = believe(belief, seen, 0.1)
        off.append(belief.pose.position[1])
    assert np.std(off[20:]) < 0.01
    assert belief.pose.position[0] == pytest.approx(1.99, abs=0.05)
    assert believe(belief, Pose((2.5, 0.3, 0.0), 0.0, 20.0, 0.02), 0.1).pose.position[:2] == (2.5, 0.3)
    exact = Pose((2.0, 0.05, 0.0), 0.0, 20.0)
    assert believe(belief, exact, 0.1).pose == exact


def test_the_person_has_the_measures_of_the_services_human():
    human = gpdf.AGENTS["human"]
    for key in ("height", "width", "length", "max_step", "acceleration", "turn_rate"):
        assert PERSON[key] == getattr(human, key)
    assert PERSON["max_slope"] == pytest.approx(human.max_slope)


def test_speech_says_what_is_missing(monkeypatch):
    monkeypatch.setenv("PATH", "")
    with pytest.raises(FileNotFoundError, match="espeak-ng is not installed"):
        Voice("en")


@pytest.mark.skipif(shutil.which("espeak-ng") is None, reason="needs espeak-ng")
def test_a_newer_sentence_cuts_the_older_one_off():
    voice = Voice("en")
    voice.say("one two three four five six seven eight nine ten")
    older = voice._speaking
    voice.say("stop")
    assert older.poll() is not None
    voice.close()


def walker(errors, seed=0):
    return Walker(np.zeros(3), 0.0, lambda position: 0.0, np.random.default_rng(seed), errors)


def walked(person, seconds, cue=None, since=0.0):
    for tick in range(round(seconds * 20)):
        now = since + tick / 20
        if cue is not None:
            person.feel(CueMessage(stamp=now, **cue))
        person.move(now, 0.05)
    return person


GO = {"action": CueAction.GO, "direction": 0.0, "urgency": 0.0, "pace": 0.7}


def test_the_walker_acts_half_a_second_late_and_stops_without_cues():
    person = walked(walker(EXACT), 0.5, GO)
    assert person.position[0] == 0.0
    walked(person, 3.0, GO, since=0.5)
    assert person.speed == pytest.approx(0.7)
    walked(person, 3.0, since=3.5)
    assert person.speed == 0.0


@pytest.mark.parametrize(("told", "mean", "spread"), [(40, 17.4, 4.0), (90, 13.4, 3.7)])
def test_the_walker_turns_on_after_the_cue_to_stop_as_blind_people_do(told, mean, spread):
    far = []
    for seed in range(80):
        person, now = walker(dataclasses.replace(EXACT, **SPREAD), seed), 0.0
        while np.degrees(person.heading) < told and now < 9:
            left = np.radians(told) - person.heading
            walked(person, 0.1, {"action": CueAction.TURN, "direction": left, "urgency": 1.0}, now)
            now += 0.1
        stop_at = person.heading
        walked(person, 3.0, {"action": CueAction.STOP, "direction": 0.0, "urgency": 1.0}, now)
        far.append(np.degrees(person.heading - stop_at))
    assert np.mean(far) == pytest.approx(mean, abs=1.5)
    assert np.std(far) == pytest.approx(spread, rel=0.35)


SPREAD = {name: getattr(Errors(), name) for name in ("slight", "slight_spread", "ample", "ample_spread")}


def test_a_cue_to_stop_that_comes_early_ends_a_turn_where_it_should():
    off = []
    for seed in range(40):
        person, now, turning = walker(dataclasses.replace(EXACT, **SPREAD), seed), 0.0, None
        route = build_route(trajectory(line((0, 0), (0, 8))), wide, radius=RADIUS)
        while now < 6:
            advice = advise(route, Pose((0.0, 0.0, 0.0), person.heading, now), now, near=0.0, turning=turning)
            turning = OVER_TURN if advice.action is CueAction.TURN else None
            if advice.action is not CueAction.TURN:
                break
            walked(person, 0.1, {"action": advice.action, "direction": advice.direction, "urgency": 1.0}, now)
            now += 0.1
        walked(person, 3.0, {"action": CueAction.STOP, "direction": 0.0, "urgency": 1.0}, now)
        off.append(np.degrees(person.heading) - 90)
    assert abs(np.mean(off)) < 6
    assert np.max(np.abs(off)) < 17


def test_the_walker_veers_without_guidance_and_counts_its_steps():
    aside = []
    for seed in range(60):
        person = walked(walker(Errors(), seed), 15.0, GO)
        aside.append(person.position[1] / person.position[0])
        assert person.steps == pytest.approx(person.position[0] / 0.62, rel=0.4)
    assert 0.05 < np.std(aside) < 0.3  # half a metre and more to a side in ten


def test_the_walkers_sensor_drops_out_and_comes_back():
    person = walker(Errors())
    missing = [person.pose(tick / 10, 0.1) is None for tick in range(3000)]
    assert 0.02 < np.mean(missing) < 0.3
    assert not missing[-1] or not all(missing[-40:])
    assert not any(walker(EXACT).pose(tick / 10, 0.1) is None for tick in range(100))


def round_a_corner_to_stairs(**options):
    """A stair of five steps, its line turned by 90° from the way to it and from the way behind it; z and the route."""
    risers = 2.5 + 0.3 * np.arange(5)
    path = line((0, 0), (2, 0), (2, 2.2), (0, 2.2), spacing=0.01, z=lambda s: 0.17 * np.searchsorted(risers, s))
    return build_route(trajectory(path), wide, radius=RADIUS, **options), risers


def test_a_turn_to_stairs_is_told_with_them_and_a_turn_behind_them_with_their_end():
    route, risers = round_a_corner_to_stairs()
    (before,) = advise(route, pose(0.0, 0), 0.0, near=0.0).instructions
    assert (before.kind, before.first.kind, before.count) == (Kind.STAIRS, Kind.TURN_SOON, 5)
    assert before.distance == pytest.approx(2.5, abs=0.05)
    assert before.first.distance == pytest.approx(2.0, abs=0.1)
    on = Pose((2.0, 1.5, 0.17 * 4), np.pi / 2, 0.0)
    assert advise(route, on, 0.0, near=3.5).instructions == ()
    off = Pose((2.0, risers[-1] - 1.9, 0.17 * 5), np.pi / 2, 0.0)
    behind = advise(route, off, 0.0, near=3.8).instructions[0]
    assert (behind.kind, behind.ends, behind.urgency) == (Kind.TURN_SOON, True, Urgency.ACT)


def test_what_was_told_in_one_breath_is_not_told_again():
    route, risers = round_a_corner_to_stairs()
    off = Pose((2.0, risers[-1] - 1.9, 0.17 * 5), np.pi / 2, 0.0)
    past = Pose((1.9, 2.2, 0.17 * 5), np.pi, 0.0)
    voice = announcer()
    said = [
        voice.choose(advise(route, where, 0.0, near=s).instructions, t)
        for where, s, t in ((off, 3.8, 0), (past, 4.25, 3))
    ]
    assert said[0][0].ends
    assert said[1] is None


def test_of_two_turns_before_stairs_the_second_one_is_not_told_before_the_first_is_made():
    risers = 3.6 + 0.3 * np.arange(5)
    path = line((0, 0), (1.7, 0), (1.7, 1.5), (6, 1.5), spacing=0.01, z=lambda s: 0.17 * np.searchsorted(risers, s))
    route = build_route(trajectory(path), wide, radius=RADIUS)
    assert kinds(advise(route, pose(0.8, -0.3, 30), 0.0, near=0.8)) == [Kind.TURN_SOON]
    between = Pose((1.7, 0.4, 0.0), np.pi / 2, 0.0)
    (told,) = (one for one in advise(route, between, 0.0, near=2.1).instructions if one.kind is Kind.STAIRS)
    assert told.first.distance == pytest.approx(1.1, abs=0.1)


def stairs_along_x(places):
    """The ground of five steps of 0.17 m at x = 3, 3.3 … between y = -0.5 and 0.5, and the floor around them."""
    far, low, high = 99.0, 3.0 + 0.3 * np.arange(5), 0.17 * np.arange(1, 6)
    boxes = [((-far, -far, 0), (3, far, 0)), ((-far, 0.5, 0), (far, far, 0)), ((-far, -far, 0), (far, -0.5, 0))]
    for x, end, z in zip(low, [*low[1:], far], high, strict=True):
        boxes += [((x, -0.5, z), (end, 0.5, z)), ((x, -0.5, z - 0.17), (x, 0.5, z))]  # a tread and its riser
    away = np.array([places - np.clip(places, *box) for box in boxes])
    distances = np.linalg.norm(away, axis=2)
    nearest = away[distances.argmin(axis=0), np.arange(len(places))]
    distance = distances.min(axis=0)
    return distance, nearest / np.maximum(distance, 1e-9)[:, None]


@pytest.mark.parametrize("slope", [0.0, 0.3, -0.3])
def test_the_direction_of_stairs_is_square_to_their_steps_whatever_the_path_does(slope):
    path = line((0, -4 * slope), (8, 4 * slope), spacing=0.02)
    for up in (1, -1):
        walked = path[::up].copy()
        walked[:, 2] = 0.17 * np.searchsorted(3.0 + 0.3 * np.arange(5), walked[:, 0])
        s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(walked[:, :2], axis=0).T))])
        (flight,) = find_stairs(walked, s, stairs_along_x, wide)
        square = 0.0 if up == 1 else np.pi
        assert np.cos(flight.enter - square) > 0.999
        assert np.cos(flight.leave - square) > 0.999
        assert flight.rise == pytest.approx(0.17 * up)
        assert obliqueness(walked, s, (flight,)) == pytest.approx(abs(np.arctan(slope)), abs=0.03)


def test_the_places_before_and_behind_stairs_are_in_their_line_and_have_room():
    path = line((0, -1.2), (8, 1.2), spacing=0.02)
    path[:, 2] = 0.17 * np.searchsorted(3.0 + 0.3 * np.arange(5), path[:, 0])
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path[:, :2], axis=0).T))])
    flights = find_stairs(path, s, stairs_along_x, wide)
    (foot, climbs), (head, on) = places_to_stand(path, s, flights, lambda places: np.full(len(places), 1.0))
    assert foot == pytest.approx([2.4, -0.12, 0.0], abs=0.03)
    assert (climbs, on) == (True, False)
    assert head == pytest.approx([4.8, -0.12, 0.85], abs=0.03)
    nearer, _ = places_to_stand(path, s, flights, lambda places: places[:, 0] - 2.48)
    assert nearer[0][0] == pytest.approx(2.55, abs=0.03)
    assert len(places_to_stand(path, s, flights, lambda places: np.full(len(places), -1.0))) == 0


def turned(field, angle):
    """A ground field whose gradient is wrong, as that of a coarse stair is."""
    c, s = np.cos(angle), np.sin(angle)

    def wrong(places):
        distance, gradient = field(places)
        return distance, gradient @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])

    return wrong


@pytest.mark.parametrize("aside", [-0.2, -0.07, 0.0, 0.07, 0.2])
@pytest.mark.parametrize("wrong", [-5, 0, 5])
def test_the_line_of_stairs_is_their_middle_though_the_path_is_beside_it_and_the_faces_are_rough(aside, wrong):
    path = line((0, aside), (9, aside), spacing=0.02)
    path[:, 2] = 0.17 * np.searchsorted(3.0 + 0.3 * np.arange(12), path[:, 0])
    s = path[:, 0]

    def stairs(places):  # twelve steps of the same line
        distance, gradient = stairs_along_x(places - [1.2, 0.0, 4 * 0.17])
        return distance, gradient

    def room(places):  # an open side, a wall, and a post beside one tread
        sides = 0.5 - np.abs(places[:, 1])
        return np.minimum(sides, np.hypot(places[:, 0] - 4.0, places[:, 1] - 0.4)) - RADIUS

    (flight,) = find_stairs(path, s, turned(stairs, np.radians(wrong)), room)
    assert flight.foot == pytest.approx([3.0, 0.0], abs=0.035)
    assert flight.head == pytest.approx([6.3, 0.0], abs=0.035)
    assert abs(np.degrees(flight.enter)) < 1.0
    places = places_to_stand(path, s, (flight,), lambda places: 0.12 - np.abs(places[:, 1]))
    assert len(places) == 2  # in a passage that leaves 7 cm to either side


def test_a_path_that_goes_aside_on_a_tread_is_on_one_flight_and_one_over_a_landing_on_two():
    def walked(*corners):
        path = line(*corners, spacing=0.02)
        tread = np.searchsorted(3.0 + 0.3 * np.arange(5), path[:, 0])
        path[:, 2] = 0.17 * np.where(np.abs(path[:, 1]) < 0.5, tread, 0)
        return path, np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path[:, :2], axis=0).T))])

    for order in (1, -1):
        path, s = walked(*[(0, 0.4), (3.15, 0.4), (3.15, -0.4), (6, -0.4)][::order])
        (flight,) = find_stairs(path, s, stairs_along_x, wide)
        assert np.ptp([flight.foot[0], flight.head[0]]) == pytest.approx(1.2, abs=0.05)

    def landing(places):  # five steps, a metre of landing, five steps
        return stairs_along_x(places - np.where(places[:, :1] > 4.6, [2.2, 0.0, 5 * 0.17], 0.0))

    path = line((0, 0), (9, 0), spacing=0.02)
    path[:, 2] = 0.17 * np.searchsorted(
        np.concatenate([3.0 + 0.3 * np.arange(5), 5.2 + 0.3 * np.arange(5)]), path[:, 0]
    )
    assert len(find_stairs(path, path[:, 0], landing, wide)) == 2


def test_the_corridor_leads_onto_stairs_in_their_line_and_nowhere_from_their_side():
    path = line((0, 0), (8, 0), spacing=0.02)
    path[:, 2] = 0.17 * np.searchsorted(3.0 + 0.3 * np.arange(5), path[:, 0])
    route = build_route(trajectory(path), wide, radius=RADIUS, field=stairs_along_x)
    before, on, side = np.array([[2.9, 0.15]]), np.array([[3.15, 0.15]]), np.array([[3.15, 0.4]])
    assert route.inside(before, 2.8)[0]
    assert route.inside(on, 3.0)[0]
    assert not route.inside(side, 3.0)[0]
    assert not route.inside(np.array([[2.9, 0.6]]), 2.8)[0]
    assert route.inside(np.array([[1.5, 0.6]]), 1.5)[0]  # away from them it is as wide as ever
    past = build_route(trajectory(line((0, 0.9), (8, 0.9))), wide, radius=RADIUS, field=stairs_along_x)
    assert past.inside(np.array([[3.15, 0.4]]), 3.1)[0]  # no stairs on the way: nothing is looked for


@pytest.mark.parametrize("askew", [30, -30, 90])
def test_who_stands_askew_before_stairs_turns_to_them_first(askew):
    path = line((0, 0), (8, 0), spacing=0.02)
    path[:, 2] = 0.17 * np.searchsorted(3.0 + 0.3 * np.arange(5), path[:, 0])
    route = build_route(trajectory(path), wide, radius=RADIUS, field=stairs_along_x)
    advice = advise(route, pose(2.8, 0.05, askew), 0.0, near=2.8)
    assert advice.action is CueAction.TURN
    assert np.degrees(advice.direction) == pytest.approx(-askew, abs=13)
    assert advise(route, pose(2.8, 0.05, 5), 0.0, near=2.8).action is CueAction.SLOW


@pytest.mark.parametrize("heading", [-30, 0, 12, 30])
def test_nobody_is_sent_off_the_last_tread_to_its_side(heading):
    path = line((0, 0), (4.3, 0), (4.3, 4), spacing=0.02)
    path[:, 2] = 0.17 * np.searchsorted(3.0 + 0.3 * np.arange(5), path[:, 0])

    def room(places):  # walls beside the stairs, a hall behind them
        return np.where(places[:, 0] < 4.2, 0.5 - np.abs(places[:, 1]) - RADIUS, 2.0)

    route = build_route(trajectory(path), room, radius=RADIUS, field=stairs_along_x)
    led = 0
    for x, y in [(x, y) for x in (4.0, 4.1, 4.15, 4.18) for y in (-0.15, -0.1, 0.0, 0.1, 0.15)]:
        advice = advise(route, Pose((x, y, 0.17 * 4), np.radians(heading), 0.0), 0.0, near=x)
        if advice.action is not CueAction.STOP:
            led += 1
            assert abs(heading + np.degrees(advice.direction)) <= 20 + 1e-6
    assert led >= 10  # of 20: no stop at every place


def test_who_stands_beside_the_line_before_stairs_is_led_back_to_it_first():
    path = line((0, 0), (8, 0), spacing=0.02)
    path[:, 2] = 0.17 * np.searchsorted(3.0 + 0.3 * np.arange(5), path[:, 0])
    route = build_route(trajectory(path), wide, radius=RADIUS, field=stairs_along_x)
    advice = advise(route, pose(2.8, 0.22, 0), 0.0, near=2.8)
    assert advice.direction < -np.pi / 4  # to the right, not over the edge


@pytest.mark.parametrize(("heading", "told"), [(-90, False), (90, False), (0, True), (12, True)])
def test_the_word_at_the_edge_of_stairs_is_for_who_faces_them_and_not_for_who_walks_along_it(heading, told):
    path = line((0, 0), (8, 0), spacing=0.02)
    path[:, 2] = 0.17 * np.searchsorted(3.0 + 0.3 * np.arange(5), path[:, 0])
    route = build_route(trajectory(path), wide, radius=RADIUS, field=stairs_along_x)
    beside = 0.0 if told else np.copysign(0.22, -heading)  # of the line, which he faces and is led back to
    said = advise(route, pose(2.7, beside, heading), 0.0, near=2.7).instructions
    assert any(one.kind is Kind.STAIRS_EDGE for one in said) is told


def test_legs_are_joined_into_one_trajectory_whose_times_go_on():
    first, second = trajectory(line((0, 0), (1, 0))), trajectory(line((1, 0), (1, 2)))
    whole = join([first, second])
    assert whole.length == pytest.approx(3.0)
    assert whole.duration == pytest.approx(first.duration + second.duration)
    assert (np.diff(whole.times) > 0).all()
    np.testing.assert_array_equal(whole.ground[[0, -1], :2], [[0, 0], [1, 2]])
    assert np.hypot(*np.diff(whole.ground[:, :2], axis=0).T).min() > 0.01  # the place where they meet stands in it once

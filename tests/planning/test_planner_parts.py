"""The planner's own small parts, each beside what it says."""

import itertools
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import gpdf_service as gpdf
from gpdf_service.config import PlanningConfig
from gpdf_service.planning import footprint, planner, routes
from gpdf_service.planning.chomp import ChompResult
from gpdf_service.planning.routes import Leg
from gpdf_service.search.ways import STEPPED, WIDE, Prefer, prices
from gpdf_service.synthetic import Box, World
from gpdf_service.types import AGENTS

CONFIG = PlanningConfig()
HUMAN = AGENTS["human"]


@pytest.fixture(scope="module")
def room():
    points, ground = World((4.0, 3.0, 2.6), (Box((1.8, 0.0, 0.0), (2.2, 1.2, 1.5)),)).sample(
        0.06, np.random.default_rng(0)
    )
    return gpdf.build_scene(points, ground)


def leg(*places, level=0, space=None):
    return Leg(level, np.array(places, dtype=float), space)


def run_of(costs, evaluations=0, *, converged=True):
    return ChompResult(np.zeros((3, 3)), np.array(costs, dtype=float), evaluations, converged)


def task_of(space, *, left=lambda: np.inf, via=()):
    ends = SimpleNamespace(via=[SimpleNamespace(xy=np.array(place)) for place in via])
    return SimpleNamespace(space=space, config=CONFIG, ends=ends, wish=SimpleNamespace(prefer="companion"), left=left)


@pytest.mark.parametrize(("start", "more"), [((0.6, 0.6), 0), ((0.6, 0.6), 1), ((2.0, 0.6), 0)])
def test_times_are_told_by_the_clock_that_is_given(room, start, more):
    ticks = []
    tell = itertools.count(100)
    clock = lambda: ticks.append(float(next(tell))) or ticks[-1]  # noqa: E731
    result = gpdf.plan(room, start, (3.4, 0.6), alternatives=more, clock=clock)
    assert result.timings["total"] == ticks[-1] - ticks[0] > 0.0
    if result.status is gpdf.Status.OK:
        assert min(result.timings["search"], result.timings["optimise"]) > 0.0
        assert result.timings["search"] + result.timings["optimise"] <= result.timings["total"]


def test_a_deadline_that_has_just_come_is_none_that_has_passed(room):
    times = iter([0.0, 0.0, 1.0])  # the deadline is at 1.0: as the search begins, it is that late
    result = gpdf.plan(room, (0.6, 0.6), (3.4, 0.6), deadline_s=1.0, clock=lambda: next(times, 1.0))
    assert "before the search began" not in result.message


@pytest.mark.parametrize("ticks", range(3, 16))
def test_other_ways_are_looked_for_only_beside_one_that_was_found_in_time(room, ticks):
    times = itertools.chain([0.0] * ticks, itertools.count(2.0))  # then the deadline is over, however patient one is
    result = gpdf.plan(room, (0.6, 0.6), (3.4, 0.6), alternatives=2, deadline_s=1.0, clock=lambda: next(times))
    assert result.status in {gpdf.Status.OK, gpdf.Status.TIMEOUT}
    assert all(way.status is gpdf.Status.OK for way in result.alternatives)


def test_what_neither_moves_nor_turns_is_told():
    rng = np.random.default_rng(0)
    for lever in (0.0, 0.4):
        step = rng.choice([0.0, 1e-10, 0.05], (60, 3)) * np.array([1.0, 1.0, 0.0])
        contact, heading = np.cumsum(step, axis=0), np.cumsum(rng.choice([0.0, 0.1], 60))
        moved = np.linalg.norm(np.diff(contact[:, :2], axis=0), axis=1) + lever * np.abs(np.diff(heading))
        told = planner.moving(contact, heading, lever)
        np.testing.assert_array_equal(told, [True, *(moved > footprint.STILL)])
    still = np.zeros((4, 3))
    np.testing.assert_array_equal(planner.moving(still, np.zeros(4), 0.4), [True, False, False, True])


def test_a_whole_path_stands_once_where_its_legs_meet(room):
    space = room.free_space("human")
    legs = [leg((0.6, 0.6), (0.6, 2.0), space=space), leg((0.6, 2.0), (3.4, 2.0), space=space)]
    contact, top, level, heading = planner._stand(space, legs, 0.05, (None, None))
    np.testing.assert_allclose(contact[[0, 28, -1], :2], [(0.6, 0.6), (0.6, 2.0), (3.4, 2.0)], atol=1e-9)
    gaps = np.linalg.norm(np.diff(contact[:, :2], axis=0), axis=1)
    assert 0.04 < gaps.min() <= gaps.max() <= 0.05 + 1e-9
    assert len(contact) == len(top) == len(level) == len(heading)
    np.testing.assert_allclose(top[:, 2] - contact[:, 2], HUMAN.height, atol=0.1 * HUMAN.height)
    twice = [legs[0], leg((0.6, 2.0), (0.6, 2.0), space=space), legs[1]]
    np.testing.assert_array_equal(planner._stand(space, twice, 0.05, (None, None))[0], contact)


@pytest.mark.parametrize(("start", "goal"), [(None, None), (2.0, None), (None, -3.0), (2.0, -3.0)])
def test_a_body_of_discs_turns_on_the_spot_at_its_ends(room, start, goal):
    spot = replace(AGENTS["spot"], discs=3)
    space = room.free_space(spot)
    contact, _, _, heading = planner._stand(space, [leg((0.6, 2.2), (3.2, 2.2), space=space)], 0.05, (start, goal))
    along = np.flatnonzero(np.isclose(np.sin(heading), 0.0, atol=1e-9) & np.isclose(np.cos(heading), 1.0))
    assert len(contact) == len(along) + (start is not None) + (goal is not None)
    for row, angle in ((0, start), (-1, goal)):
        assert np.cos(heading[row] - (0.0 if angle is None else angle)) == pytest.approx(1.0)
    assert np.abs(np.diff(heading)).max() <= np.pi
    np.testing.assert_allclose(contact[[0, -1], :2], [(0.6, 2.2), (3.2, 2.2)], atol=1e-9)


def test_pieces_are_bent_as_one_where_they_go_on_on_one_level():
    a, b, c = leg((0, 0), (1, 0)), leg((1, 0), (2, 0)), leg((2, 0), (3, 0))
    up, pose = leg((3, 0), (4, 0), level=1), leg((4, 0, 0.0), (5, 0, 0.0), level=1)

    def count(legs, via=()):
        return [len(part) for part in planner._beside_each_other(legs, [np.array(place, float) for place in via])]

    assert count([a]) == [1]
    assert count([a, b, c]) == [3]
    assert count([a, b, c], [(1, 0)]) == [1, 2]
    assert count([a, b, c], [(1, 0), (2, 0)]) == [1, 1, 1]
    assert count([a, b, c, up, pose]) == [3, 1, 1]


def test_a_candidate_tells_the_sum_of_what_its_pieces_cost(room, monkeypatch):
    space = room.free_space("human")
    legs = [leg((0.6, 0.6), (0.6, 2.0), space=space)] * 3
    runs = [run_of([5, 3, 1], 4), None, run_of([7, 6], 9, converged=False)]
    monkeypatch.setattr(planner, "_tries", lambda *_: iter([list(zip(legs, runs, strict=True))]))
    bent, seed = planner._candidates(task_of(space), legs)
    np.testing.assert_array_equal(bent.costs, [12, 9, 7])
    assert bent.details == {"iterations": 3.0, "evaluations": 13.0, "converged": 0.0}
    assert seed.legs is legs
    assert len(seed.costs) == 0
    assert seed.details == {"iterations": 0.0, "evaluations": 0.0, "converged": 0.0}


@pytest.fixture
def bends(monkeypatch):
    """What `_bend` is asked for: how many places, strictly or not, and the seconds that are left."""
    asked = []

    def bend(one, _config, strict, seconds):
        asked.append((len(one.path), strict, seconds))
        return one, run_of([1.0])

    monkeypatch.setattr(planner, "_bend", bend)
    return asked


def two_legs(space):
    return [leg((0.6, 0.6), (0.6, 2.0), space=space), leg((0.6, 2.0), (2.0, 2.2), (3.4, 2.0), space=space)]


def test_pieces_are_bent_as_one_then_each_alone_then_strictly(room, bends):
    space = room.free_space("human")
    tried = list(planner._tries(task_of(space), two_legs(space)))
    assert [len(parts) for parts in tried] == [1, 2, 2]
    assert bends == [(size, strict, np.inf) for size, strict in [(5, 0), (2, 0), (3, 0), (2, 1), (3, 1)]]


def test_one_piece_is_bent_and_then_strictly(room, bends):
    space = room.free_space("human")
    tried = list(planner._tries(task_of(space), two_legs(space)[:1]))
    assert [len(parts) for parts in tried] == [1, 1]
    assert [strict for _, strict, _ in bends] == [False, True]


def test_what_would_take_more_steps_as_one_is_bent_apart_and_stays_if_it_still_would(room, bends, monkeypatch):
    space = room.free_space("human")
    legs = two_legs(space)
    monkeypatch.setattr(planner, "is_as_level", lambda *_: False)
    tried = list(planner._tries(task_of(space), legs))
    assert [len(parts) for parts in tried] == [2, 2]
    assert [strict for _, strict, _ in bends] == [False, False, False, True, True]
    assert all(run is None for parts in tried for _, run in parts)
    assert [one for one, _ in tried[0]] == legs


@pytest.mark.parametrize(("spare", "count"), [(-1, 0), (0, 1), (1, 1), (2, 2), (4, 2), (5, 3)])
def test_nothing_is_tried_when_no_time_is_left(room, bends, spare, count):
    space = room.free_space("human")
    seconds = itertools.count(spare, -1)
    assert len(list(planner._tries(task_of(space, left=lambda: next(seconds)), two_legs(space)))) == count


def test_there_is_a_moment_left_at_zero(room, bends):
    space = room.free_space("human")
    assert len(list(planner._tries(task_of(space, left=lambda: 0.0), two_legs(space)))) == 3


def test_via_points_part_what_is_bent_as_one(room, bends):
    space = room.free_space("human")
    first = next(planner._tries(task_of(space, via=[(0.6, 2.0)]), two_legs(space)))
    assert len(first) == 2


def test_effort_is_what_a_way_takes_at_its_price_and_turns_on_the_spot_their_time():
    takes = np.arange(1.0, 7.0)
    contact = np.array([[0, 0, 0], [0, 0, 0], [1, 0, 0.2], [2, 0, 0.4], [2, 0, 0.4]], dtype=float)
    heading = np.array([0.0, 1.0, 1.5, 1.5, 0.5])
    cylinder = planner._effort(HUMAN, takes, contact, heading, Prefer.LEVEL)
    assert cylinder == pytest.approx(
        {"cost": float(takes @ prices(HUMAN, Prefer.LEVEL)), "steps": 1.0, "stepped": takes[STEPPED]}
    )
    spot = replace(AGENTS["spot"], discs=2)
    turning = planner._effort(spot, takes, contact, heading, Prefer.COMPANION)
    assert turning["cost"] == pytest.approx(float(takes @ prices(spot, Prefer.COMPANION)) + 2.0 / spot.turn_rate)


def test_who_wants_it_wide_wants_more_room():
    assert planner._liking(CONFIG, Prefer.WIDE).preferred_clearance == WIDE * CONFIG.preferred_clearance
    assert planner._liking(CONFIG, Prefer.LEVEL) is CONFIG


def test_a_place_is_told_as_far_as_it_is_known():
    assert planner._place("cut", np.array([1.0, 2.0, np.nan])) == {"cut_x": 1.0, "cut_y": 2.0}


def test_a_piece_stays_where_there_is_no_time_or_nothing_to_bend(room):
    space = room.free_space("human")
    straight, still = two_legs(space)[0], leg((0.6, 0.6), (0.6, 0.6 + 1e-10), space=space)
    same, run = planner._bend(straight, CONFIG, False, 0.0)
    assert same is straight
    assert (run.converged, run.iterations) == (False, 0)
    assert planner._bend(still, CONFIG, False, np.inf) == (still, None)
    unknown = leg((0.6, 0.6), (9.0, 0.6), space=space)
    assert planner._bend(unknown, CONFIG, False, np.inf) == (unknown, None)
    waypoints = len(run.xi)
    _, one = planner._bend(straight, CONFIG, False, 1.01 * waypoints / planner.WAYPOINTS_PER_SECOND)
    assert 1 <= one.evaluations <= 2  # time for one step


def test_strictly_bent_a_piece_keeps_the_margin_of_the_search(room):
    space = room.free_space("human")
    round_box = leg((1.0, 0.6), (1.5, 1.5), (2.5, 1.5), (3.0, 0.6), space=space)
    for strict, least in ((False, 0.0), (True, space.radius - 1e-3)):
        bent, run = planner._bend(round_box, CONFIG, strict, np.inf)
        assert run.converged
        assert space.levels[0].clearance(bent.path)[0].min() >= least
        gaps = np.linalg.norm(np.diff(bent.path, axis=0), axis=1)
        assert gaps.max() <= 1.05 * CONFIG.waypoint_spacing


def test_strictly_there_is_a_wall_as_far_off_as_what_a_chord_cuts_from_a_turn(room, monkeypatch):
    space, asked = room.free_space("human"), []
    bend = planner.bend
    monkeypatch.setattr(planner, "bend", lambda *args: asked.append(args) or bend(*args))
    for strict in (False, True):
        planner._bend(two_legs(space)[0], CONFIG, strict, np.inf)
    assert [bent_by[0][0][0].weights.any() for _, _, bent_by, _ in asked] == [True, False]  # the GPDF, the points
    apart = max(CONFIG.waypoint_spacing, CONFIG.smoothness_weight(HUMAN.disc_radius))
    soft, hard = (bending.discs.radius for *_, bending in asked)
    assert soft == space.reach
    assert hard == pytest.approx(space.radius + apart**2 / (8.0 * HUMAN.disc_radius))
    wants = [bending.wants for *_, bending in asked]
    assert [one.wall for one in wants] == [0.0, planner.WALL]
    assert wants[0].epsilon == CONFIG.preferred_clearance * HUMAN.disc_radius
    assert wants[0].height == HUMAN.height


def test_the_top_is_as_high_over_the_contact_as_the_body(room):
    path = gpdf.plan(room, (0.6, 0.6), (3.4, 0.6)).trajectory
    np.testing.assert_allclose(path.positions - path.ground, [[0.0, 0.0, HUMAN.height]] * len(path.ground))


def test_bending_keeps_the_steps_of_the_seed_but_for_a_diagonal(monkeypatch):
    for seed, bent, level in (((0.2, 0), (0.24, 0), True), ((0.3, 0.2), (0, 0.26), False), ((0.2, 0), (0.3, 0), False)):
        taken = iter([bent, seed])
        monkeypatch.setattr(routes, "steps_of", lambda _, taken=taken: next(taken))
        assert routes.is_as_level([], [], planner.MORE_STEPS) == level


def test_a_refusal_says_where_and_by_how_much_as_numbers(room):
    door = World((4.0, 3.0, 2.6), (Box((1.8, 0.0, 0.0), (2.2, 1.3, 2.6)), Box((1.8, 1.7, 0.0), (2.2, 3.0, 2.6))))
    points, ground = door.sample(0.06, np.random.default_rng(0))
    result = gpdf.plan(gpdf.build_scene(points, ground), (0.8, 1.5), (3.2, 1.5))
    assert result.status is gpdf.Status.NO_VALID_PATH
    assert result.details["short_width"] > 0.0
    assert 1.5 < result.details["cut_x"] < 2.5


def test_a_body_of_discs_also_searches_over_its_poses(room, monkeypatch):
    monkeypatch.setattr(planner, "find_routes", lambda *_: ["way"])
    monkeypatch.setattr(planner, "turn_route", lambda _space, route, seconds, facing: (route, seconds, facing))
    options = SimpleNamespace(warm_start=None, start_heading=1.0, goal_heading=None)
    for discs, more in ((1, []), (2, [("way", np.inf, (1.0, None))])):
        space = SimpleNamespace(agent=SimpleNamespace(discs=discs))
        task = SimpleNamespace(space=space, options=options, ends=None, wish=None, left=lambda: np.inf)
        assert list(planner._routes(task)) == ["way", *more]


@pytest.mark.parametrize(("left", "expected"), [(1.0, "OK"), (0.0, "TIMEOUT"), (-1.0, "TIMEOUT")])
def test_a_way_that_came_too_late_leaves_the_next_one_if_there_is_time(monkeypatch, left, expected):
    made = {"long": gpdf.Status.TIMEOUT, "short": gpdf.Status.OK}
    monkeypatch.setattr(planner, "_routes", lambda _: iter(made))
    monkeypatch.setattr(planner, "_follow", lambda _, route: SimpleNamespace(status=made[route]))
    monkeypatch.setattr(planner, "find_rival", lambda *_: None)
    found, _ = planner._best(SimpleNamespace(left=lambda: left, space=None, ends=None, wish=None))
    assert found.status.value == expected


@pytest.mark.parametrize(("cost", "status", "taken"), [(9.0, "OK", 1), (11.0, "OK", 0), (9.0, "UNCERTIFIED", 0)])
def test_a_rival_is_taken_where_it_certifies_and_is_cheaper(monkeypatch, cost, status, taken):
    made = {"way": ("OK", 10.0), "rival": (status, cost)}
    monkeypatch.setattr(planner, "_routes", lambda _: iter(["way"]))
    monkeypatch.setattr(planner, "find_rival", lambda *_: "rival")
    follow = lambda _, route: SimpleNamespace(status=gpdf.Status(made[route][0]), details={"cost": made[route][1]})  # noqa: E731
    monkeypatch.setattr(planner, "_follow", follow)
    found, route = planner._best(SimpleNamespace(left=lambda: 1.0, space=None, ends=None, wish=None))
    assert (route, found.status) == (["way", "rival"][taken], gpdf.Status.OK)
    assert found.details["cost"] == [10.0, cost][taken]


def test_of_ways_that_do_not_certify_the_first_says_why_even_if_the_last_was_late(monkeypatch):
    made = {"a": gpdf.Status.UNCERTIFIED, "b": gpdf.Status.TIMEOUT}
    monkeypatch.setattr(planner, "_routes", lambda _: iter(made))
    monkeypatch.setattr(planner, "_follow", lambda _, route: SimpleNamespace(status=made[route]))
    found, route = planner._best(SimpleNamespace(left=lambda: 1.0))
    assert (found.status, route) == (gpdf.Status.UNCERTIFIED, None)


def test_where_a_body_gets_stuck_is_why_there_is_no_way_rather_than_what_did_not_certify(monkeypatch):
    stuck = [planner.Stuck(gpdf.Status.NO_VALID_PATH, words, np.array([1.0, 2.0, at])) for at, words in enumerate("ab")]
    uncertified = SimpleNamespace(status=gpdf.Status.UNCERTIFIED)
    monkeypatch.setattr(planner, "_follow", lambda *_: uncertified)
    monkeypatch.setattr(planner, "_routes", lambda _: iter(["way", *stuck]))
    found, route = planner._best(SimpleNamespace(left=lambda: 1.0))
    assert (found.status, found.message, route) == (gpdf.Status.NO_VALID_PATH, "a", None)
    assert found.details == {"cut_x": 1.0, "cut_y": 2.0, "cut_z": 0.0}
    monkeypatch.setattr(planner, "_routes", lambda _: iter(["way"]))
    assert planner._best(SimpleNamespace(left=lambda: 1.0)) == (uncertified, None)


def test_a_body_goes_slower_with_less_room_than_it_prefers(room, monkeypatch):
    asked, (go, limit) = [], (planner.go_at_once, planner.speed_limit)
    monkeypatch.setattr(planner, "go_at_once", lambda *args: asked.append(args[-1].preferred) or go(*args))
    monkeypatch.setattr(planner, "speed_limit", lambda *args: asked.append(args[4]) or limit(*args))
    gpdf.plan(room, (0.6, 0.6), (3.4, 0.6))
    monkeypatch.setattr(planner, "_at_once", lambda *_: None)
    gpdf.plan(room, (0.6, 0.6), (3.4, 0.6))
    assert asked == 2 * [room.config.planning.preferred_clearance * HUMAN.disc_radius]

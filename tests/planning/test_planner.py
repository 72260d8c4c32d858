import dataclasses
import itertools

import numpy as np
import pytest

import gpdf_service as gpdf
from gpdf_service.bench.judge import Judge
from gpdf_service.bench.plan import random_places
from gpdf_service.config import Config
from gpdf_service.errors import RequestError, UnknownAgentError
from gpdf_service.planning import planner
from gpdf_service.planning.certificate import RESOLUTION, certify
from gpdf_service.planning.chomp import Stop, Wants, optimize, solve_banded
from gpdf_service.planning.costs import Discs
from gpdf_service.planning.routes import Leg
from gpdf_service.planning.shape import resample
from gpdf_service.search.places import least_distance
from gpdf_service.synthetic import SCENES, Box, World, random_room
from gpdf_service.types import AGENTS
from tests.clients.two_storeys import make_house


def scene_of(world, seed=0, spacing=0.05):
    points, ground = world.sample(spacing, np.random.default_rng(seed))
    return gpdf.build_scene(points, ground)


@pytest.fixture(scope="module")
def empty_room():
    return scene_of(World((8.0, 6.0, 2.6), ()))


def test_in_an_empty_room_the_path_is_the_straight_line(empty_room):
    result = gpdf.plan(empty_room, (2, 3), (6, 3), "pepper")
    assert result.status is gpdf.Status.OK
    assert np.abs(result.trajectory.ground[:, 1] - 3).max() < 0.01
    assert result.trajectory.length == pytest.approx(4.0, abs=0.01)


def test_an_ok_result_is_complete_and_consistent(office):
    made, scene = office
    for name, agent in AGENTS.items():
        result = gpdf.plan(scene, made.start, made.goal, name)
        assert result.status is gpdf.Status.OK, result.message
        path = result.trajectory
        np.testing.assert_allclose(path.ground[[0, -1], :2], [made.start, made.goal], atol=1e-9)
        np.testing.assert_allclose(path.positions[:, :2], path.ground[:, :2])
        assert (np.diff(path.times) > 0).all()
        assert len(path.headings) == len(path.times) == len(path.positions)
        assert result.certificate.holds
        assert result.certificate.min_clearance >= 0
        assert result.certificate.max_height_deviation <= 0.1 * agent.height


def test_who_minds_no_step_walks_over_the_platform_and_the_roomba_around_it():
    scene = scene_of(World((5.0, 3.0, 2.6), (Box((2.0, 0.0, 0.0), (3.0, 2.5, 0.3), walkable=True),)))
    walker = dataclasses.replace(AGENTS["human"], comfortable_step=0.37, climb_time=0.0)
    human = gpdf.plan(scene, (0.8, 0.5), (4.2, 0.5), walker)
    roomba = gpdf.plan(scene, (0.8, 0.5), (4.2, 0.5), "roomba")
    assert human.trajectory.ground[:, 2].max() == pytest.approx(0.3, abs=0.01)
    assert human.certificate.max_step == pytest.approx(0.3, abs=0.02)
    assert roomba.trajectory.ground[:, 2].max() < 0.02
    assert roomba.trajectory.length > human.trajectory.length + 0.5


def test_the_roomba_takes_the_way_under_the_couch():
    made = SCENES["cluttered_office"](np.random.default_rng(0))
    scene = gpdf.build_scene(made.points, made.ground)
    lengths = {name: gpdf.plan(scene, made.start, made.goal, name).trajectory.length for name in ("roomba", "human")}
    assert lengths["roomba"] < 0.6 * lengths["human"]


def test_the_human_climbs_the_stair_and_pepper_is_told_why_not():
    made = SCENES["stair"](np.random.default_rng(0))
    scene = gpdf.build_scene(made.points, made.ground)
    result = gpdf.plan(scene, made.start, made.goal, "human")
    assert result.status is gpdf.Status.OK
    assert result.trajectory.ground[-1, 2] == pytest.approx(3.4, abs=0.02)
    refused = gpdf.plan(scene, made.start, made.goal, "pepper")
    assert refused.status is gpdf.Status.NO_VALID_PATH
    assert "step" in refused.message
    assert refused.trajectory is None


@pytest.mark.parametrize(
    ("start", "goal", "status"),
    [
        ((50, 1), (2, 2), "START_OUTSIDE_MAP"),
        ((1, 1), (-9, 2), "GOAL_OUTSIDE_MAP"),
        ((3.5, 3.0), (1, 1), "START_OCCUPIED"),
        ((1, 1), (3.5, 3.0), "GOAL_OCCUPIED"),
        ((1, 1, 1.5), (2, 2), "START_OUTSIDE_MAP"),
    ],
)
def test_a_place_where_the_body_cannot_be_is_told_apart(start, goal, status):
    scene = scene_of(World((8.0, 6.0, 2.6), (Box((3.0, 2.5, 0.0), (4.0, 3.5, 1.5)),)))
    result = gpdf.plan(scene, start, goal, "human")
    assert result.status == status
    assert result.message
    assert result.trajectory is None
    if status.endswith("OCCUPIED"):
        assert "nearest free place" in result.message


def test_a_wall_across_the_room_leaves_no_path():
    scene = scene_of(World((8.0, 6.0, 2.6), (Box((3.0, 0.0, 0.0), (3.2, 6.0, 2.6)),)))
    result = gpdf.plan(scene, (1, 1), (7, 5), "roomba")
    assert result.status is gpdf.Status.NO_VALID_PATH
    assert "an obstacle" in result.message


@pytest.mark.parametrize(("gap", "fits"), [(0.54, True), (0.49, False)])
def test_a_gap_is_found_exactly_when_the_body_fits(gap, fits):
    walls = (Box((3.0, 0.0, 0.0), (3.2, 3.0 - gap / 2, 2.6)), Box((3.0, 3.0 + gap / 2, 0.0), (3.2, 6.0, 2.6)))
    scene = scene_of(World((6.0, 6.0, 2.6), walls), spacing=0.01)
    result = gpdf.plan(scene, (1, 3), (5, 3), "human")
    assert (result.status is gpdf.Status.OK) == fits


def test_start_equal_to_goal_is_a_standing_trajectory(empty_room):
    result = gpdf.plan(empty_room, (2, 2), (2, 2), "human")
    assert result.status is gpdf.Status.OK
    assert result.trajectory.length == 0
    assert (np.diff(result.trajectory.times) > 0).all()


def test_a_goal_that_is_the_start_but_for_rounding_is_a_standing_trajectory(office):
    _, scene = office
    start = np.array([5.0, 0.9])
    for step in (np.nextafter(5.0, 6.0) - 5.0, 1e-14, 1e-10):
        result = gpdf.plan(scene, start, start + np.array([step, 0.0]), "human")
        assert result.status is gpdf.Status.OK, result.message
        assert result.trajectory.length < 1e-6
        assert (np.diff(result.trajectory.times) > 0).all()


def test_with_no_time_to_bend_it_a_path_is_as_the_search_found_it(office):
    made, scene = office
    result = gpdf.plan(scene, made.start, made.goal, "roomba", deadline_s=1e-6, clock=lambda: 0.0)
    assert result.status is gpdf.Status.OK
    assert result.details["evaluations"] == 0
    assert result.certificate.holds


def test_a_path_that_is_found_long_after_its_deadline_is_a_timeout(office):
    made, scene = office
    ticks = itertools.count(step=0.01)
    result = gpdf.plan(scene, made.start, made.goal, "roomba", deadline_s=0.025, clock=lambda: next(ticks))
    assert result.status is gpdf.Status.TIMEOUT
    assert "before a path was certified" in result.message


def test_a_path_that_there_was_no_time_to_bend_until_it_certifies_is_a_timeout(office, monkeypatch):
    made, scene = office
    touching = dataclasses.replace(gpdf.plan(scene, made.start, made.goal, "roomba").certificate, holds=False)
    monkeypatch.setattr(planner, "certify", lambda *_: touching)
    monkeypatch.setattr(planner, "judge", lambda *_: touching)
    ends = made.start, made.goal, "roomba"
    hurried = gpdf.plan(scene, *ends, deadline_s=1e-6, clock=lambda: 0.0)
    assert hurried.status is gpdf.Status.TIMEOUT
    assert gpdf.plan(scene, *ends).status is gpdf.Status.UNCERTIFIED
    for enough in (0.09, 1e6):
        found = gpdf.plan(scene, *ends, deadline_s=enough, clock=lambda: 0.0)
        assert found.status is gpdf.Status.UNCERTIFIED


@pytest.mark.parametrize(
    ("deadline_s", "left", "converged", "status"),
    [
        (None, np.inf, False, "UNCERTIFIED"),  # there is none that could have passed
        (1.0, 0.5, True, "UNCERTIFIED"),
        (1.0, 0.5, False, "TIMEOUT"),  # with more time it might have
        (1.0, -0.5 * planner.PATIENCE, True, "TIMEOUT"),
    ],
)
def test_what_does_not_certify_is_blamed_on_the_deadline_where_that_is_why(
    office, monkeypatch, deadline_s, left, converged, status
):
    made, scene = office
    touching = dataclasses.replace(gpdf.plan(scene, made.start, made.goal, "roomba").certificate, holds=False)
    monkeypatch.setattr(planner, "certify", lambda *_: touching)
    monkeypatch.setattr(planner, "judge", lambda *_: touching)
    candidates, now = planner._candidates, [0.0]

    def tried(task, legs):
        for candidate in candidates(task, legs):
            now[0] = 1.0 - left if deadline_s else 0.0
            yield candidate._replace(details=candidate.details | {"converged": float(converged)})

    monkeypatch.setattr(planner, "_candidates", tried)
    found = gpdf.plan(scene, made.start, made.goal, "roomba", deadline_s=deadline_s, clock=lambda: now[0])
    assert found.status.value == status


def test_a_deadline_that_has_passed_is_a_timeout(empty_room):
    ticks = itertools.count()
    result = gpdf.plan(empty_room, (2, 2), (6, 4), "human", deadline_s=0.5, clock=lambda: float(next(ticks)))
    assert result.status is gpdf.Status.TIMEOUT


@pytest.mark.parametrize(
    "bad",
    [
        {"start": (1,)},
        {"goal": (1, float("nan"))},
        {"start": "here"},
        {"deadline_s": -1.0},
        {"method": "teleport"},
    ],
)
def test_requests_that_make_no_sense_are_refused(empty_room, bad):
    with pytest.raises(RequestError):
        gpdf.plan(empty_room, **{"start": (2, 2), "goal": (3, 3), **bad})


def test_an_unknown_agent_is_named_with_those_that_exist(empty_room):
    with pytest.raises(UnknownAgentError, match="roomba"):
        gpdf.plan(empty_room, (2, 2), (3, 3), "dragon")


def test_the_certificate_is_a_lower_bound_of_what_a_fine_sampling_finds(office):
    _, scene = office
    space = scene.free_space("roomba")
    rng = np.random.default_rng(2)
    for _ in range(20):
        path = rng.uniform([0.5, 0.5], [5.5, 4.5], (5, 2))
        poses = np.column_stack([path, np.zeros(len(path))])
        bound, where = least_distance(space.levels[0].places, poses, np.zeros(1), RESOLUTION)
        fine = space.levels[0].clearance(resample(path, 0.001))[0].min()
        assert bound <= fine + 1e-9
        assert fine - bound < 0.003
        assert np.linalg.norm(resample(path, 0.001) - where, axis=1).min() < 0.01


def test_a_path_through_an_obstacle_is_not_certified(office):
    _, scene = office
    xy = np.column_stack([np.linspace(0.5, 5.5, 50), np.full(50, 2.9)])
    ground = np.column_stack([xy, np.zeros(50)])
    certificate = certify(scene.free_space("human"), ground + np.array([0, 0, 2]), ground, np.zeros(50, dtype=int))
    assert not certificate.holds
    assert "obstacle" in certificate.reason


def test_chomp_never_raises_the_cost_and_lowers_it(office):
    _, scene = office
    space = scene.free_space("human")
    xi = np.column_stack([np.linspace(0.8, 4.5, 40), np.linspace(0.8, 2.2, 40), np.full(40, 1.9)])
    fields = space.levels[0].obstacle_field.arrays, space.levels[0].ground_field.arrays
    found = optimize(xi.copy(), fields, Discs(np.zeros(1), 0.25), Wants(2.0, 0.25, 0.0, 0.1), Stop(100, 1e-4))
    assert (np.diff(found.costs) <= 0).all()
    assert found.costs[-1] < 0.97 * found.costs[0]
    np.testing.assert_array_equal(found.xi[[0, -1]], xi[[0, -1]])


def test_chomp_comes_to_rest_for_any_radius(office):
    """Far from obstacles only a bound of the distance is known: it has no gradient, whatever the sums round to."""
    _, scene = office
    space, rng = scene.free_space("human"), np.random.default_rng(5)
    xi = np.column_stack([np.linspace(0.8, 4.5, 40), np.linspace(0.8, 2.2, 40), np.full(40, 1.9)])
    fields = space.levels[0].obstacle_field.arrays, space.levels[0].ground_field.arrays
    for radius in rng.uniform(0.15, 0.35, 60):
        found = optimize(xi.copy(), fields, Discs(np.zeros(1), radius), Wants(2.0, 0.25, 0.0, 0.1), Stop(100, 1e-4))
        assert found.converged, radius
        assert np.isfinite(found.xi).all()
        assert found.costs[-1] < found.costs[0]


def test_waypoints_do_not_wait_for_one_that_has_far_to_go():
    points, ground = World((20.0, 6.0, 2.5), (), ceiling=False).sample(0.1, np.random.default_rng(0))
    space = gpdf.build_scene(points, ground).free_space("human")
    fields = space.levels[0].obstacle_field.arrays, space.levels[0].ground_field.arrays
    x = np.linspace(1.0, 19.0, 97)
    y = np.where(x < 12.0, 0.3, 0.3 + 4.0 * np.sin(np.pi * (x - 12.0) / 7.0))  # along a wall, then far aside
    given = Discs(np.zeros(1), 0.25), Wants(2.0, 0.25, 0.0, 0.19)
    seed = np.column_stack([x, y, np.full(97, 2.0)])
    rest, soon = (optimize(seed.copy(), fields, *given, Stop(most, 1e-4)).xi for most in (100, 3))
    assert np.ptp(rest[x > 12.0, 1]) < 0.3 < np.ptp(soon[x > 12.0, 1])
    beside_the_wall = (x > 2.0) & (x < 11.0)
    assert np.abs(soon - rest)[beside_the_wall, 1].max() < 0.02 < np.abs(seed - rest)[beside_the_wall, 1].min()


@pytest.mark.parametrize("width", [4, 9])  # a cylinder's, a body's of discs
@pytest.mark.parametrize("count", [1, 2, 10])
def test_banded_equations_are_solved_exactly(width, count):
    rng = np.random.default_rng(0)
    band = rng.normal(size=(count, 3, width))
    band[..., 0] = 20.0
    rows = band.reshape(-1, width)
    lower = sum(np.diag(rows[p:, p], -p) for p in range(min(width, 3 * count)))
    A, right = lower + np.tril(lower, -1).T, rng.normal(size=(count, 3))
    np.testing.assert_allclose(solve_banded(band.copy(), right).ravel(), np.linalg.solve(A, right.ravel()), atol=1e-12)


def test_a_body_of_ones_own_measures_is_planned_for(empty_room):
    cart = dataclasses.replace(AGENTS["pepper"], name="cart", width=1.2, length=1.6)
    assert gpdf.plan(empty_room, (2, 2), (6, 4), cart).status is gpdf.Status.OK


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("name", ["human", "roomba"])
def test_no_certified_path_in_a_random_room_touches_anything(seed, name):
    rng = np.random.default_rng(seed)
    room = random_room(rng)
    scene = gpdf.build_scene(room.points, room.ground)
    judge, agent, certified = Judge(room.points, room.ground), AGENTS[name], 0
    for start, goal in random_places(scene, agent, 10, rng):
        result = gpdf.plan(scene, start, goal, agent)
        if result.status is gpdf.Status.OK:
            certified += 1
            verdict = judge.judge(result.trajectory, agent)
            assert verdict.collision_free, (start, goal, verdict)
            assert verdict.feasible, (start, goal, verdict)
    assert certified > 0


def half_walled(width=8.0):
    """A floor with a thin wall from one side to its middle, 5 cm between points."""
    x, y = np.meshgrid(np.arange(0, width, 0.05), np.arange(0, width, 0.05))
    floor = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    along, z = np.meshgrid(np.arange(0, width / 2, 0.05), np.arange(0.05, 2.0, 0.05))
    wall = np.column_stack([np.full(along.size, width / 2), along.ravel(), z.ravel()])
    return np.concatenate([floor, wall]), np.arange(len(floor) + len(wall)) < len(floor)


def test_a_piece_that_goes_out_and_back_is_bent_onto_its_place():
    space = gpdf.build_scene(*half_walled()).free_space("human")
    place, aside = np.array([2.5, 2.0]), np.array([0.03, 0.0])
    leg = Leg(0, np.array([place, place + aside, place]), space)
    bent, found = planner._bend(leg, Config().planning, strict=False, seconds=np.inf)
    assert found.converged
    np.testing.assert_allclose(bent.path, [place, place], atol=1e-9)


@pytest.mark.parametrize("name", ["roomba", "human", "spot"])
def test_round_a_corner_a_path_keeps_its_share_of_the_room_it_wants(name):
    points, ground = half_walled()
    agent, kept = AGENTS[name], []
    for share in (0.5, 0.8):
        config = Config.from_mapping({"planning": {"corner_room": share}})
        result = gpdf.plan(gpdf.build_scene(points, ground, config), (2.5, 2.0), (5.5, 2.0), agent)
        assert result.status is gpdf.Status.OK
        kept.append(result.certificate.min_clearance / agent.disc_radius)
    assert 0.45 < kept[0] < 0.8  # of the preferred clearance, which is one radius; it rests before it is taut
    assert max(0.75, kept[0] + 0.1) < kept[1] < 1.0


@pytest.mark.parametrize("spare", [0.0012, 0.0003])
def test_a_body_leaves_a_place_where_it_just_fits(office, spare):
    """A millimetre beside what stops it: only the ways straight out are proven with all of the room that is there."""
    scene, rng = office[1], np.random.default_rng(1)
    space = scene.free_space("human")
    places = rng.uniform([0.3, 0.3], [5.7, 4.7], (400, 2))
    room = space.levels[0].clearance(places)[0] - space.reach
    inside, outside = places[(room < 0.0) & (room > -0.1)], places[room > 0.1]
    assert len(inside) > 11
    for a in inside[:12]:
        b = outside[np.linalg.norm(outside - a, axis=1).argmin()]
        line = a + np.linspace(0.0, 1.0, 20_001)[:, None] * (b - a)
        just = line[np.abs(space.levels[0].clearance(line)[0] - space.reach - spare).argmin()]
        result = gpdf.plan(scene, just, b, "human")
        assert result.status is gpdf.Status.OK, result.message
        assert result.certificate.min_clearance >= 0.0


def test_a_place_where_nothing_can_be_proven_of_a_way_is_refused_and_no_way_is_looked_for(office):
    """With less than 10 µm beside the body a way was found, bent three times, and never certified."""
    scene, rng = office[1], np.random.default_rng(1)
    space = scene.free_space("human")
    places = rng.uniform([0.3, 0.3], [5.7, 4.7], (400, 2))
    room = space.levels[0].clearance(places)[0] - space.reach
    inside, outside = places[(room < 0.0) & (room > -0.1)][:6], places[room > 0.1]
    for a in inside:
        b = outside[np.linalg.norm(outside - a, axis=1).argmin()]
        low, high = 0.0, 1.0
        while high - low > 1e-9:
            middle = 0.5 * (low + high)
            spare = space.levels[0].clearance((a + middle * (b - a))[None])[0][0] - space.reach
            low, high = (middle, high) if spare < 5e-6 else (low, middle)
        assert gpdf.plan(scene, a + high * (b - a), b, "human").status is gpdf.Status.START_OCCUPIED


def test_where_two_levels_are_the_same_ground_a_place_has_the_room_of_the_roomier_one():
    house = make_house(np.random.default_rng(0))
    scene = gpdf.build_scene(house.points, house.ground)
    assert len(scene.surfaces) > 1
    ahead = np.array([np.cos(house.up), np.sin(house.up), 0.0])
    for behind in np.arange(0.3, 1.0, 0.1):  # on the upper floor, where the sheet of the stair ends
        result = gpdf.plan(scene, house.head + behind * ahead, house.high, "human")
        assert (result.status, result.message) == (gpdf.Status.OK, "")


def test_who_stands_where_two_levels_are_the_same_ground_stands_on_both():
    house = make_house(np.random.default_rng(0))
    scene = gpdf.build_scene(house.points, house.ground)
    way = gpdf.plan(scene, house.low, house.high, "human").trajectory.ground
    heights = np.stack([surface.height_at(way[:, :2]) for surface in scene.surfaces])
    common = way[(np.abs(heights - way[:, 2]) < 0.01).sum(axis=0) > 1]
    assert len(common) > 20
    for place in common[::20]:
        post = place + np.column_stack([np.zeros((30, 2)), np.arange(0.05, 1.55, 0.05)])
        result = gpdf.plan(scene.with_obstacles(post), house.low, house.high, "human")
        if result.status is gpdf.Status.OK:
            ground = result.trajectory.ground
            beside = np.abs(ground[:, 2] - place[2]) < 1.0
            assert np.linalg.norm(ground[beside, :2] - place[:2], axis=1).min() >= AGENTS["human"].radius - 1e-3

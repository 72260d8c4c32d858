import numpy as np
import pytest

from gpdf_service.bench.brute import BruteForce
from gpdf_service.bench.plan import refused_share
from gpdf_service.pipeline import build_scene
from gpdf_service.synthetic import SCENES, Box, World, random_room
from gpdf_service.types import AGENTS

pytestmark = pytest.mark.slow


def brute_of(world, agent="human", noise=0.0, spacing=0.02):
    points, ground = world.sample(spacing, np.random.default_rng(0))
    return BruteForce(points, ground, AGENTS[agent], noise)


def solves(brute, start, goal):
    return brute.solves(np.array(start, dtype=float), np.array(goal, dtype=float))


@pytest.mark.parametrize(
    ("gap", "noise", "fits"),
    [(0.57, 0.0, True), (0.50, 0.0, False), (0.57, 0.05, False), (0.67, 0.05, True)],
)
def test_a_gap_is_passed_exactly_when_body_and_extra_room_fit(gap, noise, fits):
    walls = (Box((1.5, 0.0, 0.0), (1.7, 0.8 - gap / 2, 2.2)), Box((1.5, 0.8 + gap / 2, 0.0), (1.7, 1.6, 2.2)))
    assert solves(brute_of(World((3.2, 1.6, 2.2), walls), noise=noise), (0.7, 0.8), (2.5, 0.8)) == fits


def room_with_a_platform(height):
    return World((4.0, 2.0, height + 2.2), (Box((2.0, 0.0, 0.0), (4.0, 2.0, height), walkable=True),))


@pytest.mark.parametrize(("agent", "climbs"), [("human", True), ("spot", True), ("roomba", False), ("pepper", False)])
def test_a_step_is_taken_by_those_who_can(agent, climbs):
    brute = brute_of(room_with_a_platform(0.35), agent)
    assert solves(brute, (0.8, 1), (3.2, 1)) == climbs
    assert solves(brute, (0.8, 0.8), (0.8, 1.2))
    assert solves(brute, (3.2, 0.8), (3.2, 1.2))


def test_nobody_climbs_a_bench_of_half_a_metre():
    assert not solves(brute_of(room_with_a_platform(0.5)), (0.8, 1), (3.2, 1))


@pytest.mark.parametrize(
    ("degrees", "agent", "climbs"), [(25, "human", True), (35, "human", False), (15, "roomba", False)]
)
def test_a_slope_is_climbed_by_those_who_stand_on_it(degrees, agent, climbs):
    def ramp(xy):
        return np.clip(xy[:, 0] - 2.0, 0.0, 2.0) * np.tan(np.radians(degrees))

    assert solves(brute_of(World((6.0, 3.0, 3.0), (), ramp), agent, spacing=0.04), (1, 1.5), (5, 1.5)) == climbs


def test_the_roomba_passes_under_the_couch_and_the_human_does_not_stand_there():
    made = SCENES["cluttered_office"](np.random.default_rng(0), spacing=0.05)
    under = (3.6, 2.6)
    assert solves(BruteForce(made.points, made.ground, AGENTS["roomba"]), under, made.goal)
    assert not solves(BruteForce(made.points, made.ground, AGENTS["human"]), under, made.goal)


def test_the_stair_joins_its_foot_and_its_head_for_legs_alone():
    made = SCENES["stair"](np.random.default_rng(0), spacing=0.05)
    assert solves(BruteForce(made.points, made.ground, AGENTS["human"]), made.start, made.goal)
    assert not solves(BruteForce(made.points, made.ground, AGENTS["roomba"]), made.start, made.goal)


def test_storeys_one_over_the_other_are_told_apart_by_height():
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(0, 4, 0.04), np.arange(0, 4, 0.04)))
    points = np.concatenate([np.column_stack([x, y, np.full(x.size, z)]) for z in (0.0, 2.8)])
    brute = BruteForce(points, np.ones(len(points), dtype=bool), AGENTS["human"])
    assert solves(brute, (1, 1, 0), (3, 3, 0))
    assert solves(brute, (1, 1, 2.8), (3, 3, 2.8))
    assert not solves(brute, (1, 1, 0), (3, 3, 2.8))


def test_a_place_off_the_map_is_no_solution():
    brute = brute_of(World((4.0, 4.0, 2.6), ()), spacing=0.04)
    assert not solves(brute, (1, 1), (40, 1))
    assert not solves(brute, (1, 1), (3.9, 1))


@pytest.mark.parametrize("agent", ["human", "roomba"])
@pytest.mark.parametrize("seed", range(3))
def test_where_it_lets_a_body_stand_there_truly_is_room(agent, seed):
    room, body = random_room(np.random.default_rng(seed)), AGENTS[agent]
    brute = BruteForce(room.points, room.ground, body)
    places = brute.random_pairs(200, np.random.default_rng(seed)).reshape(-1, 3)
    truth = room.truth.body_clearance(places, body.radius, body.height, body.max_step)
    assert truth.min() > -0.02  # a grid cell; the scan's points stand 3 cm apart


@pytest.mark.parametrize(("room", "noise", "fits"), [(0.03, 0.0, True), (0.03, 0.05, False), (0.08, 0.05, True)])
def test_a_lintel_is_passed_exactly_when_the_extra_room_is_over_the_head_too(room, noise, fits):
    lintel = Box((1.4, 0.0, AGENTS["pepper"].height + room), (1.6, 1.2, 1.4))
    assert solves(brute_of(World((3.0, 1.2, 1.6), (lintel,)), "pepper", noise), (0.6, 0.6), (2.4, 0.6)) == fits


def test_a_pole_that_is_not_there_is_a_share_of_refused_places():
    points, ground = World((3.0, 3.0, 2.4), ()).sample(0.03, np.random.default_rng(0))
    brute, human = BruteForce(points, ground, AGENTS["human"]), AGENTS["human"]
    pole = np.column_stack([np.full((50, 2), 1.5), np.linspace(0.3, 1.6, 50)])
    scenes = [
        build_scene(np.concatenate([points, p]), np.append(ground, np.zeros(len(p), bool))) for p in (pole[:0], pole)
    ]
    right, wrong = (refused_share(scene, brute, human) for scene in scenes)
    side = 3.0 - 2.0 * (human.radius + brute.room)
    assert right < 0.01
    assert wrong == pytest.approx(np.pi * human.radius**2 / side**2, rel=0.1)

"""How the bench of guided walks judges: edges that were told of in time; people who step aside."""

import numpy as np
from gpdf_guidance import Instruction, Kind, Outcome, Urgency, Walk
from gpdf_guidance.simulate import Said

from gpdf_service.bench.guide import edges_told, where_people_stand
from gpdf_service.bench.walks import PASSES, STANDS, YIELDS, Crowd, WalkedWorld
from gpdf_service.pipeline import build_scene
from gpdf_service.synthetic import SCENES
from gpdf_service.types import AGENTS


def walk_over(risers, said, pause_at=None):
    """A walk along x at 0.35 m/s over edges of 17 cm; it may stand for six seconds at a place."""
    x = np.arange(0.0, 6.0, 0.0175)
    if pause_at is not None:
        row = int(np.searchsorted(x, pause_at))
        x = np.concatenate([x[:row], np.full(120, x[row]), x[row:]])
    places = np.column_stack([x, 0 * x, 0.17 * np.searchsorted(risers, x)])
    times = 0.05 * np.arange(len(x))
    return Walk(times, places, tuple(said), Outcome.ARRIVED, "", 0.0, 1, 0.0, 0.0)


def told(time, place):
    one = Instruction(Kind.STAIRS, Urgency.ACT, (place, 0.0), amount=0.17)
    return Said(time, np.zeros(3), one, "take the stairs")


def test_an_edge_counts_as_told_if_the_sentence_was_over_before_the_foot():
    stairs = 3.0 + 0.3 * np.arange(4)
    assert edges_told(walk_over(stairs, [told(2.0, 3.0)])) == [True]
    assert edges_told(walk_over(stairs, [told(8.4, 3.0)])) == [False]  # in the same moment
    assert edges_told(walk_over(stairs, [told(2.0, 5.0)])) == [False]  # of another place
    assert edges_told(walk_over(stairs, [])) == [False]


def test_who_stands_for_long_on_stairs_is_still_on_the_same_ones():
    stairs = 3.0 + 0.3 * np.arange(4)
    assert edges_told(walk_over(stairs, [told(2.0, 3.0)], pause_at=3.4)) == [True]
    assert edges_told(walk_over(np.append(stairs, 5.5), [told(2.0, 3.0)])) == [True, False]


def test_an_edge_that_wavers_under_the_foot_is_one_and_a_sill_is_two():
    wavers, sill = (walk_over([3.0], [told(2.0, 3.0)]) for _ in range(2))
    wavers.places[(wavers.places[:, 0] > 3.02) & (wavers.places[:, 0] < 3.06), 2] = 0.0
    sill.places[sill.places[:, 0] > 3.06, 2] = 0.0
    assert edges_told(wavers) == [True]
    assert edges_told(sill) == [True, False]


def test_people_who_see_do_not_walk_into_who_does_not():
    rng = np.random.default_rng(0)
    candidates = np.column_stack([rng.uniform(0, 6, (100, 2)), np.zeros(100)])
    crowd = Crowd.of(3, candidates, lambda xy: np.zeros(len(xy)), rng)
    crowd.places = np.array([[0.5, 0.5, 0.0], [5.0, 5.0, 0.0], [5.0, 0.5, 0.0]])
    person, moved = np.array([3.0, 3.0, 0.0]), 0.0
    for tick in range(2000):
        before = crowd.places.copy()
        crowd.move(0.05 * tick, 0.05, person)
        moved += float(np.abs(crowd.places - before).sum())
        assert np.hypot(*(crowd.places - person)[:, :2].T).min() > PASSES - 1e-6
    assert moved > 10.0
    assert crowd.penetration(np.array([*crowd.places[0, :2], 0.0])) == 0.5
    assert crowd.penetration(np.array([*crowd.places[0, :2], 3.0])) < 0.5  # on another storey


def test_who_stands_aside_does_not_brush_past_one_who_walks_up_to_him():
    crowd = Crowd.of(1, np.zeros((1, 3)), lambda xy: np.zeros(len(xy)), np.random.default_rng(0))
    crowd.places, crowd.targets = np.array([[0.9, 0.45, 0.0]]), np.array([[-8.0, 0.8, 0.0]])  # a little outwards
    for tick in range(160):
        person, before = np.array([0.015 * tick, 0.0, 0.0]), crowd.places[0].copy()
        crowd.move(0.05 * tick, 0.05, person)
        was, now = (float(np.hypot(*(place - person)[:2])) for place in (before, crowd.places[0]))
        assert now > YIELDS or now >= was


def test_who_sees_goes_round_who_stands_where_there_is_room():
    def corridor(xy):
        return np.where(np.abs(xy[:, 1]) < 0.64, 0.0, np.nan)

    crowd = Crowd.of(1, np.array([[-3.0, 0.0, 0.0]]), corridor, np.random.default_rng(0))
    crowd.places, crowd.targets = np.array([[3.0, 0.0, 0.0]]), np.array([[-3.0, 0.0, 0.0]])
    person, crossed = np.array([0.0, 0.0, 0.0]), np.inf
    for tick in range(300):
        crowd.move(0.05 * tick, 0.05, person)
        assert np.hypot(*(crowd.places[0] - person)[:2]) > PASSES - 1e-6
        crossed = min(crossed, float(crowd.places[0, 0]))
    assert crossed < -1.0


def test_who_is_in_the_way_of_one_who_stands_goes_away_from_him():
    def corridor(xy):
        return np.where(np.abs(xy[:, 1]) < 0.3, 0.0, np.nan)  # too narrow to pass

    candidates = np.column_stack([np.linspace(-9, 9, 200), np.zeros((200, 2))])
    for seed in range(12):
        crowd = Crowd.of(1, candidates, corridor, np.random.default_rng(seed))
        crowd.places, crowd.targets = np.array([[0.7, 0.0, 0.0]]), np.array([[-8.0, 0.0, 0.0]])
        crowd.person, crowd.stood = np.zeros(3), STANDS
        for tick in range(50):
            crowd.move(0.05 * tick, 0.05, np.zeros(3))
        assert crowd.places[0, 0] > 1.0


def test_people_begin_beside_each_other_and_leave_a_nook_to_who_waits_before_it():
    rng = np.random.default_rng(0)
    near = np.column_stack([rng.uniform(0, 0.3, (20, 2)), np.zeros(20)])
    crowd = Crowd.of(2, near, lambda xy: np.zeros(len(xy)), rng)
    assert len(crowd.places) == 1  # no two have room

    def nook(xy):  # a room of 4 m, and a nook of 1 m behind an opening to the left of it
        inside = (np.abs(xy[:, 1]) < np.where(xy[:, 0] > 0.0, 2.0, 0.4)) & (xy[:, 0] > -1.0) & (xy[:, 0] < 4.0)
        return np.where(inside, 0.0, np.nan)

    candidates = np.column_stack([rng.uniform(0, 4, 200), rng.uniform(-2, 2, 200), np.zeros(200)])
    crowd = Crowd.of(1, candidates, nook, rng)
    crowd.places = np.array([[-0.8, 0.0, 0.0]])
    for tick in range(1200):
        crowd.move(0.05 * tick, 0.05, np.array([2.0, 1.0, 0.0]))
    assert crowd.places[0, 0] > 0.0


def test_who_cannot_get_to_where_he_goes_gives_it_up():
    candidates = np.column_stack([np.linspace(-9, 9, 200), np.zeros((200, 2))])
    crowd = Crowd.of(1, candidates, lambda xy: np.where(np.abs(xy[:, 1]) < 0.5, 0.0, np.nan), np.random.default_rng(0))
    crowd.places, crowd.targets = np.array([[2.0, 0.1, 0.0]]), np.array([[0.2, 0.0, 0.0]])  # beside who stands
    for tick in range(200):
        crowd.move(0.05 * tick, 0.05, np.zeros(3))
    assert np.hypot(*(crowd.targets[0] - [0.2, 0.0, 0.0])[:2]) > 0.1


def test_people_walk_over_stairs_from_one_level_to_the_next():
    made = SCENES["stair"](np.random.default_rng(0))
    scene = build_scene(made.points, made.ground)
    x = np.arange(1.0, 9.6, 0.05)
    place, heights = np.array([1.0, 0.8, 0.0]), []
    for place[0] in x:
        place[2] = where_people_stand(scene, AGENTS["human"])(place[None])[0]
        heights.append(place[2])
    assert heights[0] < 0.1
    assert heights[-1] > 3.3
    assert np.abs(np.diff(heights)).max() < AGENTS["human"].max_step


def test_who_climbs_a_flight_does_not_sink_to_its_underside():
    x, y = (v.ravel() for v in np.mgrid[0:4:0.04, -0.6:0.6:0.04])
    tread = 0.17 * np.floor(np.clip(x, 0.0, 3.0) / 0.28)
    under = (x > 1.0) & (x < 3.0)
    top = np.column_stack([x, y, tread])
    bottom = np.column_stack([x, y, 0.17 * x / 0.28 - 0.4])[under] + [0.01, 0.01, 0.0]  # often nearer than the tread
    world = WalkedWorld.of(np.vstack([top, bottom]), np.ones(len(top) + len(bottom), dtype=bool))
    for ahead in (np.arange(0.1, 3.5, 0.02), np.arange(3.5, 0.1, -0.02)):
        place = np.array([ahead[0], 0.013, world.ground_height(np.array([ahead[0], 0.013, 1.8 * (ahead[0] > 1)]))])
        for forward in ahead:
            place[0] = forward
            place[2] = world.ground_height(place)
            assert abs(place[2] - 0.17 * np.floor(min(forward, 3.0) / 0.28)) < 0.18
    assert not world.fell


def test_who_walks_close_beside_a_ledge_stays_below_and_who_leaves_it_steps_down():
    x, y = (v.ravel() for v in np.mgrid[0:3:0.03, -1:1:0.03])
    points = np.column_stack([x, y, 0.35 * (y > 0.0)])
    world = WalkedWorld.of(points, np.ones(len(points), dtype=bool))
    assert {world.ground_height(np.array([forward, -0.03, 0.0])) for forward in np.arange(0.1, 2.9, 0.02)} == {0.0}
    z, heights = 0.35, []
    for aside in np.arange(0.3, -0.3, -0.02):
        heights.append(z := world.ground_height(np.array([1.5, aside, z])))
    assert (heights[0], heights[-1], np.count_nonzero(np.diff(heights))) == (0.35, 0.0, 1)
    assert not world.fell

import numpy as np
import pytest

from gpdf_service.bench.judge import Judge
from gpdf_service.synthetic import Box, Pillar, World
from gpdf_service.types import AGENTS, Trajectory


def judge_of(*shapes):
    return Judge(*World((6.0, 4.0, 2.6), shapes).sample(0.03, np.random.default_rng(0)))


def path_of(contact, top):
    count = len(contact)
    return Trajectory(np.array(top, dtype=float), np.array(contact, dtype=float), np.arange(count), np.zeros(count))


def test_a_hit_between_two_waypoints_is_seen_only_strictly():
    judge, agent = judge_of(Pillar((3.0, 2.0, 0.0), 0.1, 2.0)), AGENTS["human"]
    path = path_of([(2.5, 2, 0), (3.5, 2, 0)], [(2.5, 2, 2), (3.5, 2, 2)])
    assert judge.judge_waypoints(path, agent).collision_free
    strict = judge.judge(path, agent)
    assert not strict.collision_free
    assert strict.penetration == pytest.approx(agent.radius, abs=0.15)


def test_a_flight_over_a_table_is_free_where_it_hangs_infeasible_and_no_place_to_stand():
    judge, agent = judge_of(Box((2.0, 1.0, 0.7), (4.0, 3.0, 0.74))), AGENTS["roomba"]
    path = path_of([(2.5, 2, 0.74), (3.5, 2, 0.74)], [(2.5, 2, 1.0), (3.5, 2, 1.0)])
    verdict = judge.judge_waypoints(path, agent)
    assert verdict.collision_free
    assert not verdict.feasible
    assert verdict.mean_ground_distance == pytest.approx(1.0, abs=0.01)


def test_the_distance_to_obstacles_counts_what_is_within_the_bodys_height():
    judge = judge_of(Box((2.9, 0.0, 1.0), (3.1, 4.0, 1.1)))
    human = judge.judge(path_of([(2, 2, 0), (2, 2.5, 0)], [(2, 2, 2), (2, 2.5, 2)]), AGENTS["human"])
    roomba = judge.judge(path_of([(2, 2, 0), (2, 2.5, 0)], [(2, 2, 0.1), (2, 2.5, 0.1)]), AGENTS["roomba"])
    assert human.mean_obstacle_distance == pytest.approx(0.9, abs=0.02)
    assert roomba.mean_obstacle_distance == pytest.approx(1.75, abs=0.1)  # the walls


def test_where_there_is_no_obstacle_the_distance_is_infinite():
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(0, 4, 0.05), np.arange(0, 4, 0.05)))
    points = np.column_stack([x, y, np.zeros(x.size)])
    points = np.vstack([points, [(2, 2, 5.0)]])
    judge = Judge(points, points[:, 2] < 1)
    verdict = judge.judge(path_of([(1, 1, 0), (2, 1, 0)], [(1, 1, 2), (2, 1, 2)]), AGENTS["human"])
    assert verdict.mean_obstacle_distance == np.inf
    assert verdict.collision_free
    assert verdict.feasible


def test_the_riser_after_next_is_a_step_and_one_that_is_too_high_is_not():
    def stair(riser):
        treads = [Box((2.0 + 0.2 * i, 0.0, 0.0), (6.0, 4.0, riser * (i + 1)), walkable=True) for i in range(6)]
        return Judge(*World((6.0, 4.0, 6.0), tuple(treads), ceiling=False).sample(0.03, np.random.default_rng(0)))

    human = AGENTS["human"]
    before_the_second = np.array([2.19, 2.0, 0.2])
    assert stair(0.2).penetration(before_the_second, human) == 0.0  # the third tread is 0.4 m over the contact
    assert stair(0.4).penetration(np.array([1.99, 2.0, 0.0]), human) > 0.2


@pytest.mark.parametrize(("beside", "touched"), [(0.2, False), (0.4, True), (None, True)])
def test_a_voxel_on_the_rung_of_the_ground_beside_it_is_that_ground_s(beside, touched):
    """Where a ramp begins a column has two voxels; the upper one is as high as the ramp's next column."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(0.0, 3.0, 0.2), np.arange(0.0, 3.0, 0.2)))
    floor = np.column_stack([x, y, np.zeros(x.size)])
    upper = np.array([[1.4, 1.4, 0.2]])
    ground = floor
    if beside is not None:
        ground = floor[~((np.abs(x - 1.6) < 0.1) & (np.abs(y - 1.4) < 0.1))]
        ground = np.vstack([ground, [(1.6, 1.4, beside)]])
    points = np.vstack([ground, upper]).astype(np.float32).astype(float)
    judge = Judge(points, np.arange(len(points)) < len(ground))
    assert (judge.penetration(np.array([1.3, 1.4, 0.0]), AGENTS["human"]) > 0.0) == touched


def test_a_head_that_brushes_a_lintel_within_the_scan_s_own_error_does_not_hit_it():
    path = path_of([(1, 2, 0), (5, 2, 0)], [(1, 2, 2), (5, 2, 2)])
    low, high = (judge_of(Box((2.9, 0.0, z), (3.1, 4.0, 2.4))) for z in (1.96, 1.99))
    assert not low.judge(path, AGENTS["human"]).collision_free
    assert high.judge(path, AGENTS["human"]).collision_free


def test_what_is_touched_is_told_by_its_height_over_the_ground():
    judge = judge_of(Box((2.5, 1.5, 0.0), (3.5, 2.5, 0.12)))
    path = path_of([(1, 2, 0), (5, 2, 0)], [(1, 2, 2), (5, 2, 2)])
    assert judge.height_of_touched(path, AGENTS["human"]) == pytest.approx(0.12, abs=0.01)
    aside = path_of([(1, 0.5, 0), (5, 0.5, 0)], [(1, 0.5, 2), (5, 0.5, 2)])
    assert judge.height_of_touched(aside, AGENTS["human"]) == 0.0


@pytest.mark.parametrize(("over", "feasible"), [(0.0, True), (0.006, True), (0.02, False), (-0.013, False)])
def test_between_the_points_of_a_slope_the_ground_is_known(over, feasible):
    """At 6 cm from point to point on 20° the nearest of them is a centimetre lower or higher than the ground."""
    slope, agent = np.tan(np.radians(20.0)), AGENTS["roomba"]
    world = World((4.0, 4.0, 2.6), (), floor=lambda xy: slope * xy[:, 0], ceiling=False)
    judge = Judge(*world.sample(0.06, np.random.default_rng(0)))
    xy = np.random.default_rng(1).uniform(1.0, 3.0, (100, 2))
    contact = np.column_stack([xy, world.ground_height(xy)])
    top = contact + np.array([0.0, 0.0, 0.1 + over])
    verdicts = [judge.judge_waypoints(path_of([c, c], [t, t]), agent) for c, t in zip(contact, top, strict=True)]
    share = np.mean([verdict.feasible for verdict in verdicts])
    assert share == 1.0 if feasible else share < 0.3  # or near enough to some point: the paper's measure

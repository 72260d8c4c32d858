import numpy as np
import pytest

import gpdf_service as gpdf
from gpdf_service.errors import RequestError
from gpdf_service.synthetic import SCENES, Box, World


@pytest.fixture(scope="module")
def room():
    """8 × 6 m with a block of 1 × 1 m in the middle."""
    points, ground = World((8.0, 6.0, 2.6), (Box((3.5, 2.5, 0.0), (4.5, 3.5, 1.5)),)).sample(
        0.05, np.random.default_rng(0)
    )
    return gpdf.build_scene(points, ground)


def passes(path, place):
    return np.linalg.norm(path.ground[:, :2] - place, axis=1).min() < 1e-6


def test_the_path_goes_through_the_via_points_in_their_order(room):
    via = [(6.0, 5.0), (2.0, 5.0)]
    result = gpdf.plan(room, (1, 1), (7, 1), via=via)
    assert result.status is gpdf.Status.OK, result.message
    at = [np.linalg.norm(result.trajectory.ground[:, :2] - place, axis=1).argmin() for place in via]
    assert at[0] < at[1]
    assert all(passes(result.trajectory, place) for place in via)
    assert result.certificate.holds


def test_a_via_point_where_the_body_cannot_be_is_named(room):
    result = gpdf.plan(room, (1, 1), (7, 1), via=[(6, 5), (4, 3)])
    assert result.status is gpdf.Status.GOAL_OCCUPIED
    assert "via point 2" in result.message


def test_the_goal_with_the_shortest_way_is_taken_not_the_nearest_as_the_crow_flies():
    wall = Box((3.9, 0.0, 0.0), (4.1, 5.0, 2.6))
    points, ground = World((8.0, 6.0, 2.6), (wall,)).sample(0.05, np.random.default_rng(0))
    scene = gpdf.build_scene(points, ground)
    behind, near = (4.8, 1.0), (1.0, 4.5)
    for goal, others, number in ((behind, [near], 1), (near, [behind], 0)):
        result = gpdf.plan(scene, (3.2, 1.0), goal, other_goals=others)
        assert result.details["goal"] == number
        assert passes(result.trajectory, near)


def test_goals_where_the_body_cannot_be_are_passed_over(room):
    result = gpdf.plan(room, (1, 1), (4, 3), other_goals=[(50, 50), (7, 5)])
    assert result.status is gpdf.Status.OK
    assert result.details["goal"] == 2
    refused = gpdf.plan(room, (1, 1), (4, 3), other_goals=[(50, 50)])
    assert refused.status is gpdf.Status.GOAL_OCCUPIED


def test_a_place_in_an_obstacle_is_moved_only_as_far_as_the_request_allows(room):
    inside = (4.0, 2.6)
    refused = gpdf.plan(room, (1, 1), inside)
    assert refused.status is gpdf.Status.GOAL_OCCUPIED
    nearest = np.array([refused.details[f"nearest_{axis}"] for axis in "xy"])
    far = np.linalg.norm(nearest - inside)
    assert 0.3 < far < 0.4
    assert gpdf.plan(room, (1, 1), inside, snap=far - 0.01).status is gpdf.Status.GOAL_OCCUPIED
    moved = gpdf.plan(room, (1, 1), inside, snap=far + 0.01)
    assert moved.status is gpdf.Status.OK
    assert passes(moved.trajectory, nearest)
    assert "The goal was moved 0.3" in moved.message
    assert gpdf.plan(room, (1, 1), nearest).message == ""


def test_a_start_off_the_map_is_moved_onto_it(room):
    refused = gpdf.plan(room, (-0.5, 3), (7, 5))
    assert refused.status is gpdf.Status.START_OUTSIDE_MAP
    assert "nearest free place" in refused.message
    moved = gpdf.plan(room, (-0.5, 3), (7, 5), snap=1.0)
    assert moved.status is gpdf.Status.OK
    assert moved.trajectory.ground[0, 0] == pytest.approx(0.25, abs=0.05)


def test_a_goal_is_moved_to_where_the_start_can_go():
    """The nearest free place to the goal is walled off; the one beyond the wall can be reached."""
    walls = Box((5.0, 0.0, 0.0), (5.1, 4.0, 2.6)), Box((6.0, 1.5, 0.0), (6.4, 1.9, 2.6))
    points, ground = World((8.0, 4.0, 2.6), walls).sample(0.05, np.random.default_rng(0))
    result = gpdf.plan(gpdf.build_scene(points, ground), (1, 2), (6.2, 1.7), snap=3.0)
    assert result.status is gpdf.Status.OK
    assert result.trajectory.ground[-1, 0] < 5.0


def test_a_trajectory_from_before_is_taken_up_on_the_way(room):
    first = gpdf.plan(room, (1, 1), (7, 5))
    halfway = first.trajectory.ground[len(first.trajectory.ground) // 2, :2] + np.array([0.05, -0.05])
    again = gpdf.plan(room, halfway, (7, 5), warm_start=first.trajectory)
    cold = gpdf.plan(room, halfway, (7, 5))
    assert again.status is gpdf.Status.OK
    assert (again.details["warm"], cold.details["warm"]) == (1.0, 0.0)
    assert again.trajectory.length == pytest.approx(cold.trajectory.length, rel=0.02)
    assert again.certificate.min_clearance >= 0.9 * cold.certificate.min_clearance
    np.testing.assert_allclose(again.trajectory.ground[[0, -1], :2], [halfway, (7, 5)], atol=1e-9)


def test_a_trajectory_that_is_blocked_or_leads_elsewhere_is_not_taken_up(room):
    blocked = np.column_stack([np.linspace(1, 7, 100), np.full(100, 3.0), np.zeros(100)])
    for known in (blocked, blocked[:50], blocked + np.array([0.0, 0.0, 1.0])):
        result = gpdf.plan(room, (1, 3), (7, 3), warm_start=known)
        assert result.status is gpdf.Status.OK
        assert result.details["warm"] == 0.0


def test_a_way_that_sweeps_more_ground_than_there_is_is_not_taken_up(room):
    """It costs as much as it is long, whatever the deadline: 4 MiB of it are 170 km."""
    first = gpdf.plan(room, (1, 1), (7, 5)).trajectory.ground
    to_and_fro = np.concatenate([first, first[::-1]])
    again = {
        laps: gpdf.plan(room, (1, 1), (7, 5), warm_start=np.concatenate([*[to_and_fro] * laps, first]))
        for laps in (0, 50)
    }
    assert {laps: result.details["warm"] for laps, result in again.items()} == {0: 1.0, 50: 0.0}
    assert again[50].status is gpdf.Status.OK


def test_a_trajectory_over_two_storeys_is_taken_up():
    made = SCENES["stair"](np.random.default_rng(0))
    scene = gpdf.build_scene(made.points, made.ground)
    first = gpdf.plan(scene, made.start, made.goal)
    again = gpdf.plan(scene, made.start, made.goal, warm_start=first.trajectory)
    assert again.details["warm"] == 1.0
    assert again.trajectory.ground[-1, 2] == pytest.approx(3.4, abs=0.02)


def test_the_optimiser_tells_how_its_cost_fell(room):
    result = gpdf.plan(room, (1, 3), (7, 3))
    assert len(result.costs) == result.details["iterations"] + 1
    assert (np.diff(result.costs) <= 0).all()
    assert result.costs[-1] < result.costs[0]
    assert result.details["converged"] == 1.0


@pytest.mark.parametrize(
    "bad",
    [
        {"via": [(1,)]},
        {"other_goals": ["there"]},
        {"snap": -1.0},
        {"snap": float("nan")},
        {"snap": "far"},
        {"via": 5},
        {"via": "ab"},
        {"other_goals": None},
        {"deadline_s": "soon"},
        {"start_heading": "north"},
        {"warm_start": "before"},
        {"warm_start": [[1, 2, 3], [1]]},
        {"agent": {"height": 1.0}},
        {"warm_start": np.zeros((3, 2))},
        {"warm_start": np.zeros((3, 3)), "via": [(1, 1)]},
        {"via": [(1, 1)] * 101},
        {"method": "astar", "snap": 1.0},
    ],
)
def test_options_that_make_no_sense_are_refused(room, bad):
    with pytest.raises(RequestError):
        gpdf.plan(room, (1, 1), (2, 1), **bad)

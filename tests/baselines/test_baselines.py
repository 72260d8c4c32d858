import itertools
import typing

import numpy as np
import pytest

import gpdf_service as gpdf
from gpdf_service.baselines.single_gpdf import body_points, cost_in_one_field, solve_metric
from gpdf_service.pipeline import Method
from gpdf_service.synthetic import SCENES, Box, World
from gpdf_service.types import AGENTS, FieldSample

BASELINES = [method for method in typing.get_args(Method) if method != "dual_gpdf"]
PLANAR = ["astar", "prm"]


def scene_of(world, seed=0, spacing=0.05):
    points, ground = world.sample(spacing, np.random.default_rng(seed))
    return gpdf.build_scene(points, ground)


@pytest.fixture(scope="module")
def empty_room():
    return scene_of(World((8.0, 6.0, 2.6), ()))


@pytest.fixture(scope="module")
def with_step():
    return scene_of(World((6.0, 4.0, 2.9), (Box((3.0, 0.0, 0.0), (6.0, 4.0, 0.35), walkable=True),)))


@pytest.fixture(scope="module")
def with_drop():
    """Ground alone, half a metre lower on one side: no face is seen, only the drop."""
    points = np.concatenate([floor(0, 0, 3, 4, 0.0), floor(3, 0, 6, 4, 0.5)])
    return gpdf.build_scene(points, np.ones(len(points), dtype=bool))


@pytest.fixture(scope="module")
def cluttered():
    made = SCENES["cluttered_office"](np.random.default_rng(0), spacing=0.05)
    return made, gpdf.build_scene(made.points, made.ground)


@pytest.mark.parametrize("method", BASELINES)
def test_in_an_empty_room_a_baseline_goes_straight_and_is_certified(empty_room, method):
    result = gpdf.plan(empty_room, (2, 3), (6, 3), "pepper", method=method)
    assert result.status is gpdf.Status.OK
    path = result.trajectory
    assert np.abs(path.ground[:, 1] - 3).max() < 0.1
    np.testing.assert_allclose(path.ground[[0, -1], :2], [(2, 3), (6, 3)], atol=1e-9)
    assert (np.diff(path.times) > 0).all()
    assert result.certificate.holds


@pytest.mark.parametrize("method", BASELINES)
def test_a_baseline_that_loses_the_height_over_a_step_is_never_ok_and_can_still_be_measured(with_step, method):
    ours = gpdf.plan(with_step, (1, 2), (5, 2), "human")
    result = gpdf.plan(with_step, (1, 2), (5, 2), "human", method=method)
    assert ours.status is gpdf.Status.OK
    assert result.status is gpdf.Status.UNCERTIFIED
    assert "off its height" in result.message
    assert result.trajectory.ground[-1, 2] == pytest.approx(0.35, abs=0.02)
    assert not result.certificate.holds
    assert result.certificate.max_height_deviation > 0.2


@pytest.mark.parametrize("method", PLANAR)
def test_a_planar_baseline_stays_in_the_plane_of_the_start_and_keeps_the_radius(cluttered, method):
    made, scene = cluttered
    result = gpdf.plan(scene, made.start, made.goal, "human", method=method)
    assert result.status is gpdf.Status.OK
    assert np.ptp(result.trajectory.positions[:, 2]) == 0.0
    assert result.trajectory.positions[0, 2] == pytest.approx(2.0, abs=0.01)
    assert result.certificate.min_clearance >= 0.0
    assert result.trajectory.length > 4.0  # around the couch


def test_one_field_goes_around_the_couch(cluttered):
    made, scene = cluttered
    result = gpdf.plan(scene, made.start, made.goal, "human", method="single_gpdf")
    assert result.trajectory.length > 4.0


def test_the_bodys_spheres_are_within_it_and_stand_clear_of_the_ground():
    below = body_points(2.0, 0.25, 0.25)
    assert len(below) > 1
    assert np.diff(below).max() <= 0.25 + 1e-9
    assert (below[0], 2.0 - below[-1]) == pytest.approx((0.25, 0.5))
    np.testing.assert_array_equal(body_points(0.1, 0.17, 0.17), [0.0])


@pytest.mark.parametrize("count", [2, 3, 4, 9])
def test_the_metric_is_solved_for_paths_of_any_length(count):
    gradient = np.zeros((count, 3))
    gradient[1:-1] = np.random.default_rng(0).uniform(-1, 1, (count - 2, 3))
    step = solve_metric(gradient)
    np.testing.assert_allclose(2 * step[1:-1] - step[:-2] - step[2:], gradient[1:-1], atol=1e-12)


@pytest.mark.parametrize("method", BASELINES)
def test_a_step_aside_is_a_path(empty_room, method):
    result = gpdf.plan(empty_room, (2, 2), (2.2, 2.1), "spot", method=method)
    assert result.trajectory is not None


@pytest.mark.parametrize("method", BASELINES)
def test_a_bodys_worlds_are_not_taken_for_anothers(cluttered, method):
    made, scene = cluttered
    again = [gpdf.plan(scene, made.start, made.goal, body, method=method) for body in ("human", "roomba", "human")]
    assert again[0].certificate.min_clearance == pytest.approx(again[2].certificate.min_clearance, abs=0.3)
    nearer = AGENTS["human"].radius - AGENTS["roomba"].radius  # in a person's world its axis could not come as near
    assert again[1].certificate.min_clearance < nearer or method == "single_gpdf"


def test_one_field_lifts_the_roomba_off_the_floor(empty_room):
    result = gpdf.plan(empty_room, (2, 3), (6, 3), "roomba", method="single_gpdf")
    assert result.status is gpdf.Status.UNCERTIFIED
    assert result.trajectory.positions[:, 2].max() > 0.2


@pytest.mark.parametrize("method", BASELINES)
def test_ends_and_walls_are_told_as_the_planner_tells_them(method):
    scene = scene_of(World((8.0, 6.0, 2.6), (Box((3.0, 0.0, 0.0), (3.2, 6.0, 2.6)),)))
    assert gpdf.plan(scene, (1, 1), (7, 5), "roomba", method=method).status is gpdf.Status.NO_VALID_PATH
    assert gpdf.plan(scene, (1, 1), (2.9, 3), "roomba", method=method).status is gpdf.Status.GOAL_OCCUPIED
    assert gpdf.plan(scene, (-9, 1), (2, 3), "roomba", method=method).status is gpdf.Status.START_OUTSIDE_MAP


@pytest.mark.parametrize("method", PLANAR)
def test_a_flat_world_has_no_steps_so_a_start_beside_one_is_not_refused(with_drop, method):
    assert gpdf.plan(with_drop, (3.1, 2), (5, 2), "human").status is gpdf.Status.START_OCCUPIED
    assert gpdf.plan(with_drop, (3.1, 2), (5, 2), "human", method=method).status is gpdf.Status.UNCERTIFIED


@pytest.mark.parametrize("method", BASELINES)
def test_standing_still_is_a_path(empty_room, method):
    result = gpdf.plan(empty_room, (2, 2), (2, 2), "human", method=method)
    assert result.status is gpdf.Status.OK
    assert result.trajectory.length == 0


@pytest.mark.parametrize("method", BASELINES)
def test_a_deadline_that_passes_is_a_timeout(empty_room, method):
    ticks = itertools.count()
    result = gpdf.plan(empty_room, (2, 2), (6, 4), method=method, deadline_s=0.5, clock=lambda: float(next(ticks)))
    assert result.status is gpdf.Status.TIMEOUT
    assert result.trajectory is None


def floor(x0, y0, x1, y1, z):
    x, y = np.meshgrid(np.arange(x0, x1, 0.05), np.arange(y0, y1, 0.05), indexing="ij")
    return np.column_stack([x.ravel(), y.ravel(), np.full(x.size, z)])


@pytest.mark.parametrize("method", BASELINES)
def test_another_storey_is_out_of_a_planes_reach(method):
    points = np.concatenate([floor(0, 0, 5, 5, 0.0), floor(0, 0, 5, 5, 3.0)])
    scene = gpdf.build_scene(points, np.ones(len(points), dtype=bool))
    result = gpdf.plan(scene, (1, 1, 0), (4, 4, 3), method=method)
    assert result.status is gpdf.Status.NO_VALID_PATH
    assert "storey" in result.message


@pytest.fixture(scope="module")
def around_a_pit():
    points = floor(0, 0, 9, 9, 0.0)
    points = points[~((points[:, :2] > 2.5) & (points[:, :2] < 6.5)).all(axis=1)]
    return gpdf.build_scene(points, np.ones(len(points), dtype=bool))


@pytest.mark.parametrize("method", PLANAR)
def test_ground_that_nobody_has_seen_is_walked_around(around_a_pit, method):
    result = gpdf.plan(around_a_pit, (1, 4.5), (8, 4.5), method=method)
    assert result.status is gpdf.Status.OK
    assert result.trajectory.length > 8.0


def test_a_flight_over_ground_that_nobody_has_seen_is_not_certified_and_all_its_numbers_are_finite(around_a_pit):
    result = gpdf.plan(around_a_pit, (1, 4.5), (8, 4.5), method="single_gpdf")
    assert result.status is gpdf.Status.UNCERTIFIED
    path, proof = result.trajectory, result.certificate
    assert np.isfinite(path.ground).all()
    assert np.isfinite([proof.min_clearance, proof.max_height_deviation]).all()


class Wall:
    """Distance to the plane y = 0."""

    def query(self, queries):
        gradient = np.zeros_like(queries)
        gradient[:, 1] = np.sign(queries[:, 1])
        return FieldSample(np.abs(queries[:, 1]), gradient, np.ones(len(queries), dtype=bool), np.zeros(len(queries)))


@pytest.mark.parametrize("distance", [0.1, 0.4, 2.0])  # inside the radius, within the wanted room, out of reach
def test_the_gradient_in_one_field_is_that_of_its_cost(distance):
    xi = np.column_stack([np.linspace(0, 1, 11), np.full(11, distance), np.ones(11)])
    xi[1:-1] += np.random.default_rng(0).uniform(-0.03, 0.03, (9, 3))
    weigh = {
        "spacing": 0.1,
        "field": Wall(),
        "below": np.array([0.2, 0.5]),
        "radius": 0.25,
        "epsilon": 0.25,
        "smoothness_weight": 0.4,
    }
    _, gradient = cost_in_one_field(xi, **weigh)
    for i, k in itertools.product(range(1, 10), range(3)):
        step = np.zeros_like(xi)
        step[i, k] = 1e-6
        slope = (cost_in_one_field(xi + step, **weigh)[0] - cost_in_one_field(xi - step, **weigh)[0]) / 2e-6
        assert gradient[i, k] == pytest.approx(slope, abs=1e-6)
    np.testing.assert_array_equal(gradient[[0, -1]], 0.0)

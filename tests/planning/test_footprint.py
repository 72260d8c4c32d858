import dataclasses

import numpy as np
import pytest

import gpdf_service as gpdf
from gpdf_service.bench.judge import Judge
from gpdf_service.bench.plan import random_places
from gpdf_service.errors import RequestError
from gpdf_service.fields import fit_gpdf
from gpdf_service.fields.traversal import sample_at
from gpdf_service.fields.tree import make_scratch
from gpdf_service.planning.certificate import RESOLUTION, certify
from gpdf_service.planning.costs import Discs, Task, make_memo, obstacle_cost
from gpdf_service.planning.footprint import disc_places, face, travel_headings
from gpdf_service.planning.turning import time_poses
from gpdf_service.search.lattice import find_poses
from gpdf_service.search.places import is_motion_clear, least_distance
from gpdf_service.synthetic import Box, Pillar, World, random_room
from gpdf_service.types import AGENTS

SPOT = dataclasses.replace(AGENTS["spot"], discs=6)


def place(world, seed=0, spacing=0.03):
    points, ground = world.sample(spacing, np.random.default_rng(seed))
    return gpdf.build_scene(points, ground), Judge(points, ground)


def cost_of(xi, spacing, field, discs, epsilon, gradient):
    memo, band = make_memo(len(xi) * len(discs.offsets)), np.zeros((len(xi), 3, 9))
    task = Task(field, None, discs, 1.0, epsilon, 0.0, 1.0, spacing)
    return obstacle_cost(xi, task, memo, gradient, band)


def door(width):
    walls = Box((3.0, 0.0, 0.0), (3.2, 2.2, 1.2)), Box((3.0, 2.2 + width, 0.0), (3.2, 5.0, 1.2))
    return World((6.0, 5.0, 1.2), walls)


def bend(width):
    """A corridor around a corner."""
    return World((5.0, 5.0, 1.2), (Box((0.0, width, 0.0), (5.0 - width, 5.0, 1.2)),))


def random_flat(rng):
    """Rooms side by side, with a door in each wall between them that Spot's cylinder does not pass, and pillars."""
    depth, walls, x = rng.uniform(3.0, 5.0), [], 0.0
    for _ in range(2):
        x += rng.uniform(1.6, 2.6)
        gap, width = rng.uniform(0.1, depth - 1.0), rng.uniform(0.45, 0.9)
        walls += [Box((x, 0.0, 0.0), (x + 0.12, gap, 2.6)), Box((x, gap + width, 0.0), (x + 0.12, depth, 2.6))]
    size = (x + 2.0, depth, 2.6)
    pillars = [Pillar((*rng.uniform([0.2, 0.2], [size[0] - 0.2, depth - 0.2]), 0.0), 0.1, 1.0) for _ in range(3)]
    return World(size, (*walls, *pillars))


def assert_sound(result, judge, agent=SPOT):
    """An independent judge finds nothing in the body, headings keep to the turn rate, and times increase."""
    path = result.trajectory
    verdict = judge.judge(path, agent)
    assert verdict.collision_free, verdict
    assert (np.diff(path.times) > 0).all()
    assert np.abs(np.diff(path.headings) / np.diff(path.times)).max() <= 1.02 * agent.turn_rate
    assert result.certificate.holds
    assert result.certificate.min_clearance >= 0.0


def test_the_discs_cover_the_footprint_and_lie_in_the_bodys_cylinder():
    for discs in (2, 6, 11):
        body = dataclasses.replace(AGENTS["spot"], discs=discs)
        x, y = np.meshgrid(np.linspace(-0.5, 0.5, 101) * body.length, np.linspace(-0.5, 0.5, 21) * body.width)
        away = np.hypot(x[..., None] - body.offsets, y[..., None])
        assert away.min(axis=-1).max() <= body.disc_radius + 1e-9
        assert body.offsets[-1] + body.disc_radius == pytest.approx(body.cylinder.radius)


@pytest.mark.parametrize("name", AGENTS)
def test_the_known_bodies_are_cylinders_with_one_disc_at_their_centre(name):
    agent = AGENTS[name]
    assert agent.discs == 1
    assert agent.offsets.tolist() == [0.0]
    assert agent.disc_radius == agent.radius == 0.5 * max(agent.width, agent.length)
    assert agent.cylinder == agent


@pytest.mark.parametrize("discs", [0, -1, 33])
def test_a_body_has_some_discs_and_not_too_many(discs):
    with pytest.raises(RequestError, match="discs"):
        dataclasses.replace(SPOT, discs=discs)


@pytest.mark.parametrize("width", [0.45, 0.7, 0.95])
def test_a_door_that_the_cylinder_does_not_pass_is_passed(width):
    scene, judge = place(door(width))
    assert gpdf.plan(scene, (1, 1), (5, 4), "spot").status is gpdf.Status.NO_VALID_PATH
    result = gpdf.plan(scene, (1, 1), (5, 4), SPOT)
    assert result.status is gpdf.Status.OK, result.message
    assert_sound(result, judge)
    assert result.trajectory.length < 1.1 * np.hypot(4, 3)


def test_a_door_that_is_too_narrow_for_the_discs_is_not_passed():
    scene, _ = place(door(0.25))
    result = gpdf.plan(scene, (1, 1), (5, 4), SPOT)
    assert result.status is gpdf.Status.NO_VALID_PATH
    assert result.trajectory is None


def test_a_corner_of_a_narrow_corridor_is_turned():
    scene, judge = place(bend(0.8))
    start, goal = (0.8, 0.4), (4.6, 4.2)
    assert gpdf.plan(scene, start, goal, "spot").status is not gpdf.Status.OK
    result = gpdf.plan(scene, start, goal, SPOT)
    assert result.status is gpdf.Status.OK, result.message
    assert_sound(result, judge)
    assert abs(result.trajectory.headings[-1] - result.trajectory.headings[0]) == pytest.approx(np.pi / 2, abs=0.6)


def test_a_corner_that_is_too_tight_for_the_length_is_refused_with_its_place():
    scene, _ = place(bend(0.5))
    result = gpdf.plan(scene, (0.8, 0.25), (4.75, 4.2), SPOT)
    assert result.status is gpdf.Status.NO_VALID_PATH
    assert "1.10 m long" in result.message
    assert np.hypot(result.details["cut_x"] - 4.75, result.details["cut_y"] - 0.25) < 1.0


def test_a_place_where_it_fits_in_no_direction_is_occupied():
    walls = [Box((x, 0.0, 0.0), (x + 0.1, 2.0, 2.6)) for x in (2.0, 2.9)]
    pit = World((6.0, 5.0, 2.6), (*walls, Box((2.0, 0.8, 0.0), (3.0, 2.0, 2.6))))
    result = gpdf.plan(place(pit)[0], (2.5, 0.4), (5, 4), SPOT)
    assert result.status is gpdf.Status.START_OCCUPIED
    assert "no direction" in result.message


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(15))
def test_no_certified_path_through_random_doors_touches_anything(seed):
    rng = np.random.default_rng(seed)
    scene, judge = place(random_flat(rng), seed, 0.05)
    certified = 0
    for start, goal in random_places(scene, SPOT, 3, rng):
        result = gpdf.plan(scene, start, goal, SPOT)
        assert result.message or result.status is gpdf.Status.OK
        if result.status is gpdf.Status.OK:
            certified += 1
            assert_sound(result, judge)
    assert certified > 0


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(15))
def test_in_random_rooms_nothing_is_touched_and_no_way_of_the_cylinder_is_lost(seed):
    rng = np.random.default_rng(seed)
    room = random_room(rng, spacing=0.05)
    scene, judge = gpdf.build_scene(room.points, room.ground), Judge(room.points, room.ground)
    certified = 0
    for start, goal in random_places(scene, SPOT.cylinder, 2, rng):
        result = gpdf.plan(scene, start, goal, SPOT)
        if result.status is gpdf.Status.OK:
            certified += 1
            assert_sound(result, judge)
        else:
            assert gpdf.plan(scene, start, goal, SPOT.cylinder).status is not gpdf.Status.OK
    assert certified > 0


def test_the_certificate_bounds_what_a_fine_sampling_of_the_turning_body_finds(office):
    _, scene = office
    space, rng = scene.free_space(SPOT), np.random.default_rng(1)
    for _ in range(10):
        poses = rng.uniform([0.5, 0.5, -3.0], [5.5, 4.5, 3.0], (4, 3))
        bound, where = least_distance(space.levels[0].places, poses, SPOT.offsets, RESOLUTION)
        t = np.linspace(0.0, 3.0, 4000)
        fine = np.column_stack([np.interp(t, range(4), column) for column in poses.T])
        discs = np.vstack([disc_places(fine, offset) for offset in SPOT.offsets])
        least = space.levels[0].clearance(discs)[0].min()
        assert bound <= least + 1e-9
        assert least - bound < 0.004
        assert np.linalg.norm(discs - where, axis=1).min() < 0.01


def test_turning_on_the_spot_beside_a_wall_is_not_certified():
    space = place(door(0.7))[0].free_space(SPOT)
    ground = np.array([[0.3, 2.5, 0.0], [0.3, 2.5, 0.0]])
    top, level = ground + np.array([0.0, 0.0, SPOT.height]), np.zeros(2, dtype=int)
    along = certify(space, top, ground, level, np.full(2, np.pi / 2))
    turning = certify(space, top, ground, level, np.array([np.pi / 2, -np.pi / 2]))
    assert along.holds
    assert not turning.holds
    assert "obstacle" in turning.reason


def test_a_motion_is_clear_exactly_when_a_fine_sampling_of_it_is(office):
    _, scene = office
    space, rng = scene.free_space(SPOT), np.random.default_rng(3)
    seen = set()
    for _ in range(300):
        a = rng.uniform([0.5, 0.5, -3.0], [5.5, 4.5, 3.0])
        b = a + rng.normal(size=3) * [0.1, 0.1, 0.5]
        clear = is_motion_clear(space.levels[0].places, a, b, SPOT.offsets, SPOT.disc_radius)
        fine = a + np.linspace(0.0, 1.0, 300)[:, None] * (b - a)
        least = min(space.levels[0].clearance(disc_places(fine, o))[0].min() for o in SPOT.offsets) - SPOT.disc_radius
        if abs(least) > 0.003:
            assert clear == (least > 0)
            seen.add(clear)
    assert seen == {True, False}


@pytest.mark.parametrize("ends", [(2, 2), (3, 3)])
def test_poses_are_found_from_end_to_end_facing_as_asked(ends):
    scene, _ = place(door(0.5))
    space = scene.free_space(SPOT)
    start, goal = np.array([1.0, 1.0, 2.0])[: ends[0]], np.array([5.0, 4.0, -1.0])[: ends[1]]
    way, facing = (
        np.stack([start[:2], goal[:2]]),
        (start[2] if ends[0] == 3 else None, goal[2] if ends[1] == 3 else None),
    )
    found = find_poses(space.levels[0].places, space.levels[0].surface, way, facing, SPOT.offsets, space.radius)
    assert found.reached
    np.testing.assert_allclose(found.poses[0, : ends[0]], start, atol=1e-9)
    off = found.poses[-1, : ends[1]] - goal
    np.testing.assert_allclose([*off[:2], *np.sin(off[2:] / 2)], 0.0, atol=1e-9)
    for a, b in zip(found.poses[:-1], found.poses[1:], strict=True):
        assert is_motion_clear(space.levels[0].places, a, b, SPOT.offsets, space.radius)


def test_room_that_is_wanted_to_the_last_bit_costs_nothing():
    """There the field tells a bound without a gradient, and the radius taken from that is a bit less than is wanted."""
    radius, room = 0.6, 0.3
    assert (radius + room) - radius < room
    field, scratch, slope = fit_gpdf([[0.0, 0.0], [0.0, 10.0]], spacing=0.05).arrays, make_scratch(), np.zeros(3)
    low, high = radius + room, 2.0
    while np.nextafter(low, high) < high:
        middle = 0.5 * (low + high)
        sample_at(field, (middle, 0.0, 0.0), scratch, slope, radius + room)
        low, high = (low, middle) if np.isnan(slope[0]) else (middle, high)
    xi, gradient = np.array([[high, y, 0.0] for y in (-0.1, 0.0, 0.1)]), np.zeros((3, 3))
    assert cost_of(xi, 0.1, field, Discs(np.zeros(1), radius), room, gradient) == 0.0
    np.testing.assert_array_equal(gradient, 0.0)


def test_the_obstacle_cost_falls_along_its_gradient_as_finite_differences_say(office):
    _, scene = office
    field, discs = scene.free_space(SPOT).levels[0].obstacle_field.arrays, Discs(SPOT.offsets, SPOT.disc_radius)
    xi = np.column_stack([np.linspace(1.2, 3.4, 12), np.full(12, 1.0), np.full(12, 0.7)])
    spacing, gradient = 0.2, np.zeros_like(xi)
    assert cost_of(xi, spacing, field, discs, 0.6, gradient) > 0
    assert np.abs(gradient[:, 1]).max() > 0.01
    for i in range(1, 11):  # across the way, where CHOMP's gradient is that of the sum
        cost = []
        for step in (-1e-5, 1e-5):
            moved = xi.copy()
            moved[i, 1] += step
            cost.append(cost_of(moved, spacing, field, discs, 0.6, np.zeros_like(xi)))
        assert (cost[1] - cost[0]) / 2e-5 == pytest.approx(gradient[i, 1], abs=0.01 * np.abs(gradient).max())


def test_one_disc_at_the_centre_costs_what_a_cylinder_costs_whatever_its_heading(office):
    _, scene = office
    field = scene.free_space("human").levels[0].obstacle_field.arrays
    xi = np.column_stack([np.linspace(1.2, 3.4, 12), np.linspace(1.0, 1.6, 12), np.full(12, 2.0)])
    gradient = np.zeros_like(xi)
    cost = cost_of(xi, 0.2, field, Discs(np.zeros(1), 0.25), 0.5, gradient)
    d = scene.obstacle_field("human").query(xi[1:-1, :2]).distance - 0.25
    c = np.where(d < 0, 0.25 - d, np.where(d < 0.5, (d - 0.5) ** 2 / 1.0, 0.0))
    assert cost == pytest.approx((c * 0.5 * np.linalg.norm(xi[2:, :2] - xi[:-2, :2], axis=1)).sum())
    np.testing.assert_array_equal(gradient[[0, -1]], 0.0)


def test_a_path_is_faced_along_and_a_path_of_poses_as_it_says():
    corner = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])
    np.testing.assert_allclose(travel_headings(corner), [0.0, np.pi / 4, np.pi / 2])
    poses = face(corner, SPOT.offsets[-1], 0.05)
    assert np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1).max() <= 0.05 + 1e-9
    on_the_spot = face(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 3.0]]), SPOT.offsets[-1], 0.05)
    assert SPOT.offsets[-1] * np.diff(on_the_spot[:, 2]).max() <= 0.05 + 1e-9


def test_a_turn_on_the_spot_takes_its_time_from_rest_to_rest():
    poses = np.array([[0.0, 0, 0], [1.0, 0, 0], [1.0, 0, np.pi / 2], [1.0, 1, np.pi / 2]])
    poses = face(poses, SPOT.offsets[-1], 0.01)
    positions = np.column_stack([poses[:, :2], np.full(len(poses), SPOT.height)])
    times, headings = time_poses(positions, poses[:, 2], SPOT, np.full(len(poses), SPOT.speed))
    assert (np.diff(times) > 0).all()
    np.testing.assert_array_equal(headings, poses[:, 2])
    turning = np.flatnonzero(np.diff(headings))
    assert times[turning[-1] + 1] - times[turning[0]] > np.pi / 2 / SPOT.turn_rate
    assert np.abs(np.diff(headings) / np.diff(times)).max() <= 1.02 * SPOT.turn_rate
    speed = np.linalg.norm(np.diff(positions, axis=0), axis=1) / np.diff(times)
    assert speed[turning[0] - 1] < 0.3
    assert speed.max() > 0.5


@pytest.mark.parametrize(("start_heading", "goal_heading"), [(2.5, None), (None, -2.0), (-2.0, 1.5)])
def test_the_body_begins_and_ends_facing_as_asked(start_heading, goal_heading):
    scene, judge = place(door(0.6))
    asked = {"start_heading": start_heading, "goal_heading": goal_heading}
    result = gpdf.plan(scene, (1.2, 1.2), (4.8, 3.8), SPOT, **asked)
    assert result.status is gpdf.Status.OK, result.message
    assert_sound(result, judge)
    for row, heading in ((0, start_heading), (-1, goal_heading)):
        if heading is not None:
            assert np.sin((result.trajectory.headings[row] - heading) / 2) == pytest.approx(0.0, abs=1e-9)


def test_a_turn_on_the_spot_costs_its_time():
    scene, _ = place(World((6.0, 5.0, 1.2), ()))
    ahead, turned = (gpdf.plan(scene, (1.2, 1.2), (4.8, 1.2), SPOT, start_heading=at) for at in (0.0, np.pi / 2))
    assert turned.status is gpdf.Status.OK
    spent = np.pi / 2 / SPOT.turn_rate
    assert turned.details["cost"] - ahead.details["cost"] == pytest.approx(spent, abs=0.1)


def test_a_heading_at_which_it_does_not_fit_at_the_start_has_no_way():
    scene, _ = place(door(0.6))
    assert gpdf.plan(scene, (0.3, 2.5), (5, 4), SPOT, start_heading=np.pi / 2).status is gpdf.Status.OK
    refused = gpdf.plan(scene, (0.3, 2.5), (5, 4), SPOT, start_heading=0.0)
    assert refused.status is gpdf.Status.NO_VALID_PATH
    with pytest.raises(RequestError, match="heading"):
        gpdf.plan(scene, (1, 1), (5, 4), SPOT, start_heading=np.nan)


def test_a_search_that_is_given_up_at_the_deadline_is_a_timeout():
    scene, _ = place(bend(0.5))
    ticks = iter(np.arange(0.0, 100.0, 0.02))
    result = gpdf.plan(scene, (0.8, 0.25), (4.75, 4.2), SPOT, deadline_s=0.26, clock=lambda: float(next(ticks)))
    assert result.status is gpdf.Status.TIMEOUT
    assert "given up" in result.message
    assert result.trajectory is None


@pytest.mark.parametrize("apart", [0.0, 2e-16, 1e-9])
def test_a_turn_between_places_that_differ_in_a_last_digit_is_one_on_the_spot(apart):
    """At a via point legs end within rounding of each other: to creep there so slowly took all memory."""
    x, headings = np.array([0.0, 0.5, 1.0, 1.0 + apart, 1.5]), np.array([0.0, 0.0, 0.0, 1.3, 1.3])
    positions = np.column_stack([x, np.zeros((5, 2))])
    times, _ = time_poses(positions, headings, SPOT, np.full(5, SPOT.speed))
    assert (np.diff(times) > 0.0).all()
    assert times[-1] < 10.0

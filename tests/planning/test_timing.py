import dataclasses

import numpy as np
import pytest

import gpdf_service as gpdf
from gpdf_service.planning.timing import BLEND, CARE, LOOK, RAMP, STILL, TICK, _least_around, speed_limit, time_path
from gpdf_service.search.ways import is_stepped
from gpdf_service.synthetic import SCENES, Box, World
from gpdf_service.types import AGENTS


def along(positions):
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(positions, axis=0), axis=1))])


def rates(times, place, tick=0.04):
    """Speed, acceleration and jerk by differences on an even grid of time."""
    t = np.arange(0.0, times[-1], tick)
    s = np.interp(t, times, place)
    return tuple(np.diff(s, n) / tick**n for n in (1, 2, 3))


def straight(length, spacing=0.002):
    x = np.linspace(0.0, length, int(length / spacing) + 1)
    return np.column_stack([x, np.zeros((len(x), 2))])


@pytest.mark.parametrize("name", AGENTS)
@pytest.mark.parametrize("length", [0.05, 0.5, 8.0])
def test_speed_acceleration_and_jerk_keep_to_their_limits_from_rest_to_rest(name, length):
    u = np.linspace(0.0, 1.0, 20000)
    x = length * u**3 * (10 - 15 * u + 6 * u**2)  # closer together where it is slow
    agent, path = AGENTS[name], np.column_stack([x, np.zeros((len(x), 2))])
    speed, acceleration, jerk = rates(time_path(path, agent)[0], along(path))
    assert speed.max() <= agent.speed + 1e-3
    assert np.abs(acceleration).max() <= 1.02 * agent.acceleration
    assert np.abs(jerk).max() <= 1.1 * 2 * agent.acceleration / RAMP
    assert max(speed[0], speed[-1]) < 0.05 * speed.max()


def test_a_long_straight_takes_the_time_of_the_trapezoid_and_the_two_windows():
    agent = AGENTS["human"]
    times, headings = time_path(straight(20.0), agent)
    trapezoid = 20.0 / agent.speed + agent.speed / agent.acceleration
    assert times[-1] == pytest.approx(trapezoid + 0.6, abs=0.15)
    np.testing.assert_allclose(headings, 0.0)


def test_turning_keeps_to_the_turn_rate_and_to_the_acceleration_across():
    agent = AGENTS["spot"]
    t = np.linspace(0, 2 * np.pi, 400)
    positions = np.column_stack([2 * np.cos(t), 1 * np.sin(2 * t), np.zeros(400)])
    times, headings = time_path(positions, agent)
    speed = np.diff(along(positions)) / np.diff(times)
    turn = np.abs(np.diff(headings) / np.diff(times))
    assert turn.max() <= 1.02 * agent.turn_rate
    assert (turn * speed).max() <= 1.05 * agent.acceleration
    tangent = np.unwrap(np.arctan2(*np.gradient(positions[:, :2], axis=0).T[::-1]))
    assert np.abs(headings - tangent).max() < 0.1


def test_a_corner_is_turned_slowly_and_times_increase():
    agent = AGENTS["pepper"]
    leg = straight(2.0, 0.05)
    corner = np.vstack([leg, leg[-1] + leg[1:, [1, 0, 2]]])
    times, headings = time_path(corner, agent)
    assert (np.diff(times) > 0).all()
    speed = np.diff(along(corner)) / np.diff(times)
    assert speed[len(leg) - 2 : len(leg) + 1].max() < 0.5 * agent.speed
    assert np.abs(np.diff(headings) / np.diff(times)).max() <= 1.1 * agent.turn_rate
    assert headings[-1] - headings[0] == pytest.approx(np.pi / 2, abs=1e-9)


def test_a_corner_is_turned_about_from_a_tenth_of_a_metre_before_it_to_as_far_behind():
    leg = straight(2.0, 0.01)
    corner = np.vstack([leg, leg[-1] + leg[1:, [1, 0, 2]]])
    headings, s = time_path(corner, AGENTS["pepper"])[1], along(corner)
    assert np.abs(headings[s < 2.0 - LOOK - 0.03]).max() == 0.0
    assert (np.diff(headings[np.abs(s - 2.0) < LOOK]) > 0.0).all()
    assert headings[s > 2.0 + LOOK + 0.03].min() == pytest.approx(np.pi / 2, abs=1e-9)


@pytest.mark.parametrize(("length", "reach"), [(6.0, 0.5), (60.0, 0.1)])
def test_a_limit_holds_where_the_body_then_is_however_long_the_way(length, reach):
    agent, path = AGENTS["human"], straight(length, 0.01)
    limit = np.where(np.abs(path[:, 0] - 0.44 * length) < reach, 0.3, agent.speed)
    times, _ = time_path(path, agent, limit)
    speed, middle = np.diff(path[:, 0]) / np.diff(times), 0.5 * (path[1:, 0] + path[:-1, 0])
    slow = np.abs(middle - 0.44 * length) < reach
    assert speed[slow].max() <= 0.3 + 1e-3
    assert speed[~slow].max() > 0.7


def test_a_stair_is_climbed_at_half_the_speed():
    made = SCENES["stair"](np.random.default_rng(0))
    path = gpdf.plan(gpdf.build_scene(made.points, made.ground), made.start, made.goal, "human").trajectory
    speed = np.diff(along(path.positions)) / np.diff(path.times)
    rising = np.flatnonzero((path.ground[1:, 2] > 0.2) & (path.ground[1:, 2] < 3.2))
    assert speed[rising].max() <= CARE * AGENTS["human"].speed + 0.01


def test_a_narrow_door_is_passed_slowly():
    walls = Box((3.0, 0.0, 0.0), (3.2, 2.7, 2.6)), Box((3.0, 3.3, 0.0), (3.2, 6.0, 2.6))
    points, ground = World((6.0, 6.0, 2.6), walls).sample(0.03, np.random.default_rng(0))
    path = gpdf.plan(gpdf.build_scene(points, ground), (1, 3), (5, 3), "human").trajectory
    speed = np.diff(along(path.positions)) / np.diff(path.times)
    middle = 0.5 * (path.ground[1:, 0] + path.ground[:-1, 0])
    assert speed[np.abs(middle - 3.1) < 0.1].max() < 0.65 * AGENTS["human"].speed
    assert speed.max() > 0.9 * AGENTS["human"].speed


@pytest.mark.parametrize("discs", [1, 6])
def test_the_speed_is_that_of_the_disc_in_the_tightest_place_and_on_steps(discs):
    rng, preferred = np.random.default_rng(0), 0.3
    step = Box((3.0, 0.0, 0.0), (6.0, 3.0, 0.15), walkable=True)
    scene = gpdf.build_scene(*World((6.0, 3.0, 2.6), (step,)).sample(0.05, rng))
    agent = dataclasses.replace(AGENTS["spot"], discs=discs)
    space = scene.free_space(agent)
    poses = rng.uniform((0.3, 0.3, -np.pi), (5.7, 2.7, np.pi), (300, 3))
    cells = int(np.ceil(agent.radius / space.levels[0].surface.cell_width))
    expected = np.ones(len(poses))
    for offset in agent.offsets:
        xy = poses[:, :2] + offset * np.column_stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])])
        room = np.clip((space.levels[0].clearance(xy)[0] - space.reach) / preferred, 0.0, 1.0)
        stepped = [is_stepped(space.levels[0].surface.arrays, space.levels[0].noticed, x, y, cells) for x, y in xy]
        expected = np.minimum(expected, np.where(stepped, CARE, CARE + (1.0 - CARE) * room))
    contact, level = poses * [1.0, 1.0, 0.0], np.zeros(len(poses), dtype=np.int64)
    found = speed_limit(space, contact, poses[:, 2], level, preferred)[0]
    np.testing.assert_allclose(found, agent.speed * expected, atol=1e-9)
    assert CARE < np.quantile(expected, 0.6) < expected.max()


@pytest.mark.parametrize("length", [1e-300, 1e-12, 1e-8, 2e-6, 1e-3])
def test_a_goal_that_differs_from_the_start_in_a_last_digit_is_timed_in_little_memory(length):
    times, headings = time_path(np.array([[0.0, 0.0, 0.0], [length, 0.0, 0.0]]), gpdf.AGENTS["roomba"])
    assert np.isfinite(times).all()
    assert times[1] > times[0]
    if length < STILL:
        assert times[1] <= TICK  # who is there already has no way to wait for
    np.testing.assert_allclose(headings, 0.0, atol=1e-9)


@pytest.mark.parametrize("radius", [0.3, 1.0])
def test_a_body_that_turns_at_once_is_still_slow_enough_not_to_slip_aside(radius):
    """v² / r of a circle at most the acceleration across, where the turn rate alone would allow a race."""
    agent = dataclasses.replace(AGENTS["human"], turn_rate=50.0, speed=3.0, acceleration=0.4)
    t = np.linspace(0.0, 4.0 * np.pi, 2000)
    circle = np.column_stack([radius * np.cos(t), radius * np.sin(t), np.zeros(len(t))])
    times, _ = time_path(circle, agent)
    speed = np.diff(along(circle)) / np.diff(times)
    fastest = np.sqrt(agent.acceleration * radius)
    assert speed.max() <= 1.02 * fastest
    assert speed.max() >= 0.9 * fastest


@pytest.mark.parametrize(("count", "reach"), [(1, 3), (7, 0), (50, 4), (50, 80)])
def test_the_least_around_each_place_is_that_of_its_window(count, reach):
    values = np.random.default_rng(count).random(count)
    plain = [values[max(i - reach, 0) : i + reach + 1].min() for i in range(count)]
    assert _least_around(values, reach).tolist() == plain


def test_time_stamps_do_not_hang_on_rounding():
    rng, agent = np.random.default_rng(0), AGENTS["human"]
    for count, even in ((7, True), (60, True), (60, False)):
        turn, step = np.cumsum(rng.normal(0.0, 0.3, count)), np.ones(count) if even else rng.uniform(0.5, 1.5, count)
        legs = 0.1 * np.column_stack([step * np.cos(turn), step * np.sin(turn), 0.0 * turn])
        path, limit = np.cumsum(np.vstack([np.zeros(3), legs]), axis=0), rng.uniform(0.3, 1.0, count + 1) * agent.speed
        times = time_path(path, agent, limit)[0]
        for _ in range(5):
            elsewhere = path + rng.uniform(-50.0, 50.0, 3)
            np.testing.assert_allclose(time_path(elsewhere, agent, limit)[0], times, rtol=0.0, atol=1e-6)


@pytest.mark.parametrize("length", [0.001, 0.3, 7.0])
def test_the_last_time_stamp_is_when_the_body_rests(length):
    agent = AGENTS["human"]
    times = time_path(straight(length, length / 500), agent)[0]
    ramps = length / agent.speed + agent.speed / agent.acceleration
    fastest = ramps if length > agent.speed**2 / agent.acceleration else 2.0 * np.sqrt(length / agent.acceleration)
    assert times[-1] == pytest.approx(fastest + RAMP + BLEND - 2.0 * TICK, abs=0.02 * fastest + 1e-3)

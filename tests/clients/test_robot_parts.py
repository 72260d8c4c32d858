"""The robot's parts by themselves: motion, line, controller, simulated robot."""

from dataclasses import asdict
from math import pi

import numpy as np
import pytest
from gpdf_client import Trajectory
from gpdf_robot import BODIES, Errors, Pose, SimulatedRobot, Velocity
from gpdf_robot.controller import pursue, regulated
from gpdf_robot.motion import STOP, advance, toward, wrap
from gpdf_robot.route import BEYOND, Route
from hypothesis import given
from hypothesis import strategies as st

import gpdf_service as gpdf

ROOMBA, PEPPER = BODIES["roomba"], BODIES["pepper"]
PERFECT = Errors(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
small = st.floats(-2.0, 2.0)


def line_of(*places):
    ground = np.array([[*place, 0.0] for place in places], dtype=float)
    return Trajectory(ground + np.array([0, 0, 0.1]), ground, np.arange(len(places)) * 1.0, np.zeros(len(places)))


def test_the_bodies_are_the_services_own():
    for name, body in BODIES.items():
        measures = asdict(body)
        del measures["omnidirectional"]
        assert measures == {key: getattr(gpdf.AGENTS[name], key) for key in measures}
        wider = gpdf.Agent(**body.agent(0.05))
        assert wider.radius == pytest.approx(body.radius + 0.05)


def test_a_quarter_circle_ends_where_it_should():
    radius = 0.5
    end = advance(Pose(1.0, 2.0, 0.0), Velocity(forward=radius * pi / 2, turn=pi / 2), 1.0)
    assert (end.x, end.y, end.heading, end.stamp) == pytest.approx((1.5, 2.5, pi / 2, 1.0))
    sideways = advance(Pose(0.0, 0.0, pi / 2), Velocity(left=1.0), 2.0)
    assert (sideways.x, sideways.y) == pytest.approx((-2.0, 0.0))


@given(small, small, small, small)
def test_two_halves_of_a_motion_are_the_whole(heading, forward, left, turn):
    velocity, start = Velocity(forward, left, turn), Pose(0.3, -0.2, heading)
    whole, half = advance(start, velocity, 1.0), advance(advance(start, velocity, 0.4), velocity, 0.6)
    assert (half.x, half.y) == pytest.approx((whole.x, whole.y), abs=1e-6)
    assert wrap(half.heading - whole.heading) == pytest.approx(0.0, abs=1e-9)


@given(small, small, small, small)
def test_no_acceleration_is_beyond_its_limit(forward, left, turn, rate):
    now, wanted = Velocity(0.1, -0.2, 0.3), Velocity(forward, left, turn)
    then = toward(now, wanted, 0.5, abs(rate), 0.1)
    assert np.hypot(then.forward - now.forward, then.left - now.left) <= 0.05 + 1e-12
    assert abs(then.turn - now.turn) <= 0.1 * abs(rate) + 1e-12
    there = toward(now, wanted, 1e6, 1e6, 1.0)
    assert (there.forward, there.left, there.turn) == pytest.approx((forward, left, turn))


def test_the_nearest_place_on_a_line():
    route = Route(line_of((0, 0), (3, 0), (3, 4)))
    assert route.length == 7.0
    assert route.nearest(np.array([1.0, 0.5])) == pytest.approx((1.0, 0.5))
    assert route.nearest(np.array([3.5, 2.0])) == pytest.approx((5.0, 0.5))
    np.testing.assert_allclose(route.at(np.array([1.0, 5.0, 7.0 + BEYOND])), [[1, 0, 0], [3, 2, 0], [3, 4 + BEYOND, 0]])
    assert route.heading(1.0) == pytest.approx(0.0)
    assert route.heading(5.0) == pytest.approx(pi / 2)


def test_a_line_that_comes_back_is_not_taken_for_its_later_part():
    route = Route(line_of((0, 0), (3, 0), (3, 0.1), (0, 0.1)))
    xy = np.array([1.0, 0.09])
    assert route.nearest(xy)[0] == pytest.approx(3.1 + 2.0)
    assert route.nearest(xy, 0.9)[0] == pytest.approx(1.0)


def test_repeated_waypoints_and_a_line_without_length_are_no_trouble():
    assert Route(line_of((0, 0), (0, 0), (1, 0), (1, 0))).length == 1.0
    still = Route(line_of((2, 1), (2, 1)))
    assert still.length == 0.0
    assert still.nearest(np.array([2.0, 1.0])) == pytest.approx((0.0, 0.0))


STRAIGHT = Route(line_of((0, 0), (6, 0)))


def test_on_the_line_it_goes_straight_on_at_cruising_speed():
    for body in (ROOMBA, PEPPER):
        command = pursue(STRAIGHT, Pose(2, 0, 0), 2.0, body.speed, body, np.inf).velocity
        assert (command.forward, command.left, command.turn) == pytest.approx((body.speed, 0.0, 0.0))


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_beside_the_line_it_turns_or_moves_toward_it(side):
    pose = Pose(2, 0.05 * side, 0)
    differential = pursue(STRAIGHT, pose, 2.0, ROOMBA.speed, ROOMBA, np.inf)
    assert differential.velocity.left == 0.0
    assert differential.velocity.turn * side < 0.0
    assert differential.offset == pytest.approx(0.05)
    omnidirectional = pursue(STRAIGHT, pose, 2.0, PEPPER.speed, PEPPER, np.inf).velocity
    assert omnidirectional.left * side < 0.0
    assert omnidirectional.turn == pytest.approx(0.0)


def test_looking_away_it_turns_on_the_spot_and_starts_aligned():
    for body in (ROOMBA, PEPPER):
        for heading in (pi, -2.0, 1.5):
            command = pursue(STRAIGHT, Pose(2, 0, heading), 2.0, body.speed, body, np.inf).velocity
            assert command.speed == 0.0
            assert command.turn * -heading > 0.0 or heading == pi
        assert pursue(STRAIGHT, Pose(2, 0, 0.3), 2.0, 0.0, body, np.inf).velocity.speed == 0.0
        assert pursue(STRAIGHT, Pose(2, 0, 0.3), 2.0, body.speed, body, np.inf).velocity.speed > 0.0


def test_bends_obstacles_and_the_end_slow_it():
    cruise = regulated(0.3, 0.0, np.inf, np.inf, ROOMBA)
    assert cruise == 0.3
    assert regulated(0.3, 4.0, np.inf, np.inf, ROOMBA) < cruise
    assert regulated(0.3, 0.0, 0.1, np.inf, ROOMBA) == pytest.approx(0.15)
    assert regulated(0.3, 0.0, np.inf, 0.1, ROOMBA) == pytest.approx(0.1)
    assert regulated(0.3, 50.0, 0.0, np.inf, ROOMBA) == pytest.approx(0.075)
    assert regulated(0.3, 0.0, np.inf, 0.0, ROOMBA) > 0.0


def test_a_perfect_robot_does_what_it_is_told_within_its_limits():
    robot = SimulatedRobot(ROOMBA, Pose(0, 0, 0), PERFECT, np.random.default_rng(0))
    robot.command(Velocity(forward=0.3))
    for _ in range(200):
        robot.move(0.01)
    assert robot.velocity.forward == pytest.approx(0.3)
    # 0.6 s at 0.5 m/s², then 1.4 s at 0.3 m/s
    assert robot.pose.x == pytest.approx(0.5 * 0.3 * 0.6 + 0.3 * 1.4, abs=0.002)
    assert robot.measure() == robot.pose
    assert len(robot.track) == 201


def test_commands_and_poses_come_late():
    robot = SimulatedRobot(ROOMBA, Pose(0, 0, 0), Errors(0, 0, 0, 0, 0.1, 0.05), np.random.default_rng(0))
    robot.command(Velocity(forward=0.3))
    for _ in range(10):
        assert robot.velocity == STOP
        robot.move(0.01)
    robot.move(0.01)
    assert robot.velocity.forward > 0.0
    assert robot.pose.stamp - robot.measure().stamp == pytest.approx(0.05)


def test_noise_is_as_large_as_it_is_said_to_be_and_comes_again_with_its_seed():
    def poses(seed):
        robot = SimulatedRobot(ROOMBA, Pose(0, 0, 0), Errors(position=0.02, bias=0.0), np.random.default_rng(seed))
        return np.array([robot.measure().xy for _ in range(400)])

    biased = SimulatedRobot(ROOMBA, Pose(0, 0, 0), Errors(0.0, 0.05), np.random.default_rng(0))
    assert biased.measure().xy.tolist() == biased.measure().xy.tolist() != [0.0, 0.0]
    assert poses(1).std() == pytest.approx(0.02, rel=0.1)
    np.testing.assert_array_equal(poses(1), poses(1))
    assert not np.array_equal(poses(1), poses(2))


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_an_omnidirectional_body_does_not_cut_a_long_bend(side):
    spot, angles = BODIES["spot"], np.linspace(0.0, 1.5 * pi, 200)
    route = Route(line_of(*np.column_stack([np.sin(angles), side * (1.0 - np.cos(angles))])))
    robot = SimulatedRobot(spot, Pose(0.0, 0.0, 0.0), PERFECT, np.random.default_rng(0))
    along, offsets = 0.0, []
    while along < route.length - 0.5:
        pursuit = pursue(route, robot.measure(), along, robot.velocity.speed, spot, np.inf)
        robot.command(pursuit.velocity)
        for _ in range(5):
            robot.move(0.01)
        along = pursuit.along
        offsets.append(pursuit.offset)
    assert max(offsets) < 0.02  # moving at a place 0.4 m ahead on the bend would be 0.08 m inside of it


@given(st.floats(-0.1, 0.1), st.floats(-0.5, 0.5), st.floats(0.05, 0.3))
def test_the_arc_that_is_driven_goes_through_the_line_ahead(y, heading, speed):
    """The circle that touches the heading and has the commanded curvature meets the line within the look-ahead."""
    velocity = pursue(STRAIGHT, Pose(2.0, y, heading), 2.0, speed, ROOMBA, np.inf).velocity
    if velocity.speed == 0.0:  # it turns on the spot first
        return
    carrot = np.array([2.0 + max(0.15, 0.4 * speed), 0.0])
    end = Pose(2.0, y, heading)
    steps = [end := advance(end, velocity, 0.002 / velocity.forward) for _ in range(300)]
    assert min(np.hypot(*(pose.xy - carrot)) for pose in steps) < 0.01


def test_behind_a_sharp_corner_the_place_ahead_may_be_nearer_than_it_looks():
    """Along a line that folds back, the place 0.15 m ahead is 0.04 m off: the arc through it is as tight as that."""
    fold = Route(line_of((0, 0), (3, 0), (0, 0.2)))
    carrot = fold.at(np.array([3.0 - 0.075 + 0.15]))[0, :2] - np.array([2.925, 0.0])
    off, bearing = np.hypot(*carrot), np.arctan2(carrot[1], carrot[0])
    assert off < 0.05
    velocity = pursue(fold, Pose(2.925, 0.0, bearing - 0.05), 2.925, 0.2, ROOMBA, np.inf).velocity
    assert velocity.turn == pytest.approx(velocity.forward * 2.0 * np.sin(0.05) / off)


def test_a_bend_is_taken_in_proportion_to_its_radius():
    easy = 1.5 * ROOMBA.speed  # [m] the way of a second and a half
    assert regulated(ROOMBA.speed, 1.0 / easy, np.inf, np.inf, ROOMBA) == pytest.approx(ROOMBA.speed)
    assert regulated(ROOMBA.speed, 2.0 / easy, np.inf, np.inf, ROOMBA) == pytest.approx(0.5 * ROOMBA.speed)
    assert regulated(ROOMBA.speed, -2.0 / easy, np.inf, np.inf, ROOMBA) == pytest.approx(0.5 * ROOMBA.speed)


def test_an_omnidirectional_body_slows_before_a_corner_and_not_behind_it():
    corner, spot = Route(line_of((0, 0), (3, 0), (3, 4))), BODIES["spot"]
    before = pursue(corner, Pose(2.9, 0.0, 0.0), 2.9, spot.speed, spot, np.inf).velocity
    assert before.speed < 0.5 * spot.speed
    behind = pursue(corner, Pose(3.0, 0.2, pi / 2), 3.2, spot.speed, spot, np.inf).velocity
    assert behind.speed == pytest.approx(spot.speed)


def test_turning_on_the_spot_settles_without_a_swing_beyond():
    robot = SimulatedRobot(ROOMBA, Pose(0.0, 0.0, 0.7), Errors(0, 0, 0, 0, 0.1, 0.05), np.random.default_rng(0))
    headings = []
    for _ in range(60):
        robot.command(Velocity(turn=pursue(STRAIGHT, robot.measure(), 0.0, 0.0, ROOMBA, np.inf).velocity.turn))
        for _ in range(5):
            robot.move(0.01)
        headings.append(robot.pose.heading)
    assert min(headings) > -0.05
    assert abs(headings[-1]) < 0.1


@pytest.mark.parametrize("body", [ROOMBA, PEPPER], ids=["differential", "omnidirectional"])
def test_the_end_of_the_line_slows_it(body):
    near_the_end = pursue(STRAIGHT, Pose(5.9, 0.0, 0.0), 5.9, body.speed, body, np.inf).velocity
    assert near_the_end.speed == pytest.approx(0.1)  # what is left, over a second


def test_who_moves_slowly_does_not_stop_to_turn():
    for speed, stops in ((0.02, True), (0.1, False)):
        assert (pursue(STRAIGHT, Pose(2, 0, 0.3), 2.0, speed, ROOMBA, np.inf).velocity.speed == 0.0) is stops


def test_the_place_ahead_is_never_further_than_a_corner_allows():
    corner = Route(line_of((0, 0), (3, 0), (3, 4)))
    fast = pursue(corner, Pose(2.3, 0.0, 0.0), 2.3, 3.0, ROOMBA, np.inf).velocity
    assert fast.turn == pytest.approx(0.0)  # the corner is 0.7 m ahead: further than anybody looks

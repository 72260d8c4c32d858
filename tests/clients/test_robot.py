"""The robot against the real service: it arrives, keeps off what is there and what comes, stops when it cannot see."""

import dataclasses
import json
import threading
import time

import numpy as np
import pytest
from gpdf_client import Client
from gpdf_robot import BODIES, Driver, Errors, Pose, SimulatedRobot, State, drive_live, simulate
from gpdf_robot.driver import DISTANCE_DEADLINE_S, GIVE_UP_S, POSE_OLD_S
from gpdf_robot.motion import STOP, Velocity
from gpdf_schemas import PoseMessage, VelocityMessage, decode, encode, keys

from gpdf_service.cli import main
from gpdf_service.ports import free_endpoint
from gpdf_service.service.server import Options, Server
from gpdf_service.synthetic.world import Box, World

ROOMBA = BODIES["roomba"]
HALL = (6.0, 4.0, 2.5)
WALL = Box((3.0, 0.0, 0.0), (3.2, 3.0, 0.6))
"""Leaves a gap of 1 m at the far side of the hall."""
SHUT = Box((3.0, 0.0, 0.0), (3.2, 4.0, 0.6))


def hall(*shapes):
    return World(HALL, shapes).sample(0.05, np.random.default_rng(0))


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    endpoint = free_endpoint()
    folder = tmp_path_factory.mktemp("robot")
    with Server(Options(endpoint, folder, folder, 1)), Client.connect(endpoint) as client:
        yield client, endpoint


def load(client, name, *shapes):
    points, ground = hall(*shapes)
    client.load_scene(name, upload=points, ground=ground)


def robot_at(x, y, heading=0.5, seed=0, body=ROOMBA):
    return SimulatedRobot(body, Pose(x, y, heading), Errors(), np.random.default_rng(seed))


def room_of(drive, *shapes, body=ROOMBA):
    track = np.column_stack([drive.track, np.zeros(len(drive.track))])
    return World(HALL, shapes).body_clearance(track, body.radius, body.height, body.max_step).min()


@pytest.mark.parametrize("name", BODIES)
def test_it_arrives_without_touching_anything(service, name):
    client, _ = service
    load(client, "gap", Box((3.0, 0.0, 0.0), (3.2, 2.2, 0.6)))
    body, goal = BODIES[name], (5.0, 1.0)
    drive = simulate(Driver(client, "gap", goal, body), robot_at(1.0, 1.0, 2.5, body=body))
    assert drive.state is State.ARRIVED
    assert np.hypot(*(drive.track[-1] - goal)) < 0.1
    assert drive.error_p95 < 0.05
    assert room_of(drive, Box((3.0, 0.0, 0.0), (3.2, 2.2, 0.6)), body=body) > 0.0


def test_something_new_on_the_route_stops_it_at_once_and_it_goes_round(service):
    client, _ = service
    load(client, "new")
    commands = []

    def come(robot, command):
        if commands or robot.pose.x > 1.6:
            if not commands:
                load(client, "new", WALL)
            commands.append(command)

    driver = Driver(client, "new", (5.0, 1.0), ROOMBA)
    drive = simulate(driver, robot_at(1.0, 1.0), on_step=come)
    assert commands[0].speed > 0.0  # what was decided before it came
    assert commands[1] == STOP
    assert drive.state is State.ARRIVED
    assert drive.plans == 2
    assert drive.stops >= 1
    assert len(drive.planned) == 2
    assert room_of(drive, WALL) > 0.0


def test_a_way_that_is_shut_ends_in_a_stop_with_the_planners_reason(service):
    client, _ = service
    load(client, "shut")

    def come(robot, command):
        if robot.pose.x > 1.6 and not closed:
            load(client, "shut", SHUT)
            closed.append(robot.pose.stamp)

    closed = []
    drive = simulate(Driver(client, "shut", (5.0, 1.0), ROOMBA), robot_at(1.0, 1.0), on_step=come)
    assert drive.state is State.GAVE_UP
    assert "NO_VALID_PATH" in drive.reason
    assert room_of(drive, SHUT) > 0.0
    assert drive.seconds <= closed[0] + GIVE_UP_S + 2.0
    np.testing.assert_allclose(np.diff(drive.track[-50:], axis=0), 0.0, atol=1e-9)


def test_it_does_not_leave_for_a_goal_that_it_cannot_reach(service):
    client, _ = service
    load(client, "shut", SHUT)
    drive = simulate(Driver(client, "shut", (5.0, 1.0), ROOMBA), robot_at(1.0, 1.0))
    assert (drive.state, drive.plans) == (State.GAVE_UP, 0)
    assert np.isnan(drive.error_p95)
    np.testing.assert_array_equal(drive.track, np.broadcast_to([1.0, 1.0], drive.track.shape))


def test_an_obstacle_that_it_is_about_to_hit_stops_it_though_the_plan_does_not_know(service):
    """The route leads past; a robot that looks elsewhere than along it is stopped by the distances alone."""
    client, _ = service
    load(client, "wall", WALL)
    driver = Driver(client, "wall", (1.0, 2.0), ROOMBA)
    driver.step(Pose(2.2, 1.0, 0.0, 0.0), 0.0)
    route = driver._route
    heading_for_the_wall = Pose(3.0 - ROOMBA.radius - 0.05, 1.0, 0.0, 0.0)
    look = driver._look(route, heading_for_the_wall, Velocity(forward=0.3))
    assert look.here == pytest.approx(0.05, abs=0.02)
    assert look.arc < 0.0
    assert driver._allowed(look, Velocity(forward=0.3), 0.1) == STOP
    assert driver.state is State.BLOCKED
    away = driver._look(route, heading_for_the_wall, Velocity(forward=-0.3))
    assert driver._allowed(away, Velocity(forward=-0.3), 0.2).forward == -0.3
    driver._allowed(look, Velocity(forward=0.3), 5.0)
    assert driver.state is State.PLANNING  # stuck for long: another route
    unsure = Pose(*heading_for_the_wall.xy, 0.0, 0.0, accuracy=0.03)
    assert driver._look(route, unsure, STOP).keep == 0.03 > look.keep


def test_a_slow_robot_is_thought_ahead_of(service):
    client, _ = service
    load(client, "wall", WALL)
    errors, offsets = Errors(position=0.0, bias=0.0, command_s=0.3), []
    for known in (0.3, 0.0):
        robot = SimulatedRobot(ROOMBA, Pose(1.0, 1.0, 0.5), errors, np.random.default_rng(0))
        drive = simulate(Driver(client, "wall", (5.0, 1.0), ROOMBA, delay_s=known), robot)
        assert drive.state is State.ARRIVED
        assert room_of(drive, WALL) > 0.0
        offsets.append(drive.error_p95)
    assert offsets[0] < 0.7 * offsets[1]


def test_an_old_or_absent_pose_stops_it(service):
    client, _ = service
    load(client, "free")
    driver = Driver(client, "free", (5.0, 2.0), ROOMBA)
    assert driver.step(None, 0.0) == STOP
    assert driver.state is State.BLIND
    for i in range(20):
        command = driver.step(Pose(1.0, 2.0, 0.0, 0.05 * i), 0.05 * i)
    assert command.forward > 0.0
    assert driver.step(Pose(1.0, 2.0, 0.0, 1.0), 1.0 + 1.1 * POSE_OLD_S) == STOP
    assert driver.reason == f"the pose is {1.1 * POSE_OLD_S:.2f} s old"
    assert driver.state is State.BLIND
    assert driver.step(Pose(1.0, 2.0, 0.0, 2.0), 2.0).forward >= 0.0
    assert driver.state is State.DRIVING
    assert driver.step(Pose(1.0, 2.0, 0.0, 2.0, accuracy=0.2), 2.0) == STOP
    assert driver.state is State.BLIND
    driver.step(None, 2.0 + 2 * GIVE_UP_S)
    assert driver.state is State.GAVE_UP


def test_a_service_that_dies_stops_it(tmp_path, free_endpoint):
    with Server(Options(free_endpoint, tmp_path, tmp_path, 1)) as server, Client.connect(free_endpoint) as client:
        load(client, "free")
        driver = Driver(client, "free", (5.0, 2.0), ROOMBA)
        for i in range(20):
            command = driver.step(Pose(1.0, 2.0, 0.0, 0.05 * i), 0.05 * i)
        assert command.forward > 0.0
        server.__exit__(None, None, None)
        assert driver.step(Pose(1.0, 2.0, 0.0, 1.0), 1.0) == STOP
        assert driver.state is State.BLIND
        assert "no distances" in driver.reason
        assert DISTANCE_DEADLINE_S < POSE_OLD_S


def test_in_real_time_poses_and_velocities_go_over_zenoh(service):
    client, endpoint = service
    load(client, "free")
    done, heard = threading.Event(), []
    start = Pose(1.0, 2.0, 0.0, time.time())
    robot = SimulatedRobot(ROOMBA, start, Errors(slip=0.0), np.random.default_rng(0))

    def listen(sample):
        message = decode(sample.payload.to_bytes(), VelocityMessage)
        heard.append(message)
        robot.command(Velocity(message.forward, message.left, message.turn))

    def live(session):
        publisher = session.declare_publisher(f"{keys.POSE}/walle")
        publisher.put(b"\xff no pose")
        while not done.wait(0.02):
            while robot.pose.stamp < time.time():
                robot.move(0.02)
            pose = robot.measure()
            message = PoseMessage(position=[pose.x, pose.y, 0.0], heading=pose.heading, stamp=pose.stamp)
            publisher.put(encode(message))

    with Client.connect(endpoint) as other:
        other.session.declare_subscriber(f"{keys.VELOCITY}/walle", listen)
        thread = threading.Thread(target=live, args=(other.session,))
        thread.start()
        try:
            driver = Driver(client, "free", (1.6, 2.0), ROOMBA)
            drive_live(driver, client.session, "walle")
            until = time.monotonic() + 60
            while heard[-1].state != "arrived":  # the last command is on its way
                assert time.monotonic() < until
                time.sleep(0.01)
        finally:
            done.set()
            thread.join()
    assert driver.state is State.ARRIVED
    assert np.hypot(robot.pose.x - 1.6, robot.pose.y - 2.0) < 0.1
    assert (heard[-1].forward, heard[-1].turn, heard[-1].state) == (0.0, 0.0, "arrived")
    assert max(message.forward for message in heard) > 0.1


@pytest.mark.slow
def test_the_verb_drives_in_a_cloud_and_draws(tmp_path, capsys):
    points, ground = hall(WALL)
    cloud = tmp_path / "hall.npz"
    np.savez(cloud, xyz=points, label=ground.astype(int), classes=np.array(["other", "ground"]))
    words = ["drive", str(cloud), "--start", "1,1", "--goal", "5,1", "--simulate", "--seed", "3"]
    assert main([*words, "--json", "--png", str(tmp_path / "drive.png")]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["state"] == "arrived"
    assert result["error_p95_m"] < 0.05
    assert result["driven_m"] > 5.0
    assert result["track"][0] == [1.0, 1.0]
    assert (tmp_path / "drive.png").read_bytes().startswith(b"\x89PNG")


def test_the_verb_fails_where_the_robot_does(service, capsys):
    client, endpoint = service
    load(client, "shut", SHUT)
    words = ["drive", "shut", "--start", "1,1", "--goal", "5,1", "--simulate", "--endpoint", endpoint]
    assert main(words) == 1
    assert "NO_VALID_PATH" in capsys.readouterr().out
    assert main(["drive", "nowhere", *words[2:]]) == 1
    assert "nowhere" in capsys.readouterr().err
    assert main(["drive", "shut", "--goal", "5,1", "--simulate", "--endpoint", endpoint]) == 2


@pytest.mark.slow
def test_the_benchmark_judges_errands(capsys):
    assert main(["bench", "drive", "--runs", "2", "--scene", "office", "--agent", "roomba", "--json"]) == 0
    row, total = json.loads(capsys.readouterr().out)
    assert row["runs"] == row["arrived"] == 2
    assert total["contacts"] == 0
    assert 0.0 < total["error_p95_m"] <= 0.05
    assert row["least_room_m"] > 0.0


class Altered:
    """The real client, but for one thing that it says of distances."""

    def __init__(self, client, change):
        self.client, self.change = client, change

    def plan(self, *words, **options):
        return self.client.plan(*words, **options)

    def distance(self, *words, **options):
        self.places = words[2]
        return self.change(self.client.distance(*words, **options))


def set_off(service):
    """A robot on its way for a second, whose client can be altered, and its last command."""
    client, _ = service
    load(client, "free")
    altered = Altered(client, lambda found: found)
    driver = Driver(altered, "free", (5.0, 2.0), ROOMBA)
    for i in range(20):
        command = driver.step(Pose(1.0, 2.0, 0.0, 0.05 * i), 0.05 * i)
    return altered, driver, command


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda found: dataclasses.replace(found, distance=found.distance + 9.0, valid=found.valid & False), "stands"),
        (lambda found: dataclasses.replace(found, scene_version=found.scene_version + 1), "the scene has changed"),
        (lambda found: dataclasses.replace(found, distance=found.distance - 1.0), "something stands on the route"),
    ],
    ids=["not valid", "another version", "less room"],
)
def test_what_speaks_against_the_route_stops_it_each_by_itself(service, change, reason):
    altered, driver, command = set_off(service)
    assert command.forward > 0.0
    altered.change = change
    assert driver.step(Pose(1.0, 2.0, 0.0, 1.0), 1.0) == STOP
    assert reason in driver.reason


def test_what_stands_between_here_and_where_it_would_stand_blocks_it(service):
    altered, driver, command = set_off(service)
    ahead = altered.places[:, 0]
    begin, end = ahead[0], ahead[np.flatnonzero(np.diff(ahead) < 0.0)[0]]  # then the line follows, from its beginning
    assert end - begin > 0.1

    def touching(found):
        middle = np.abs(altered.places[:, 0] - 0.5 * (begin + end)) < 0.03
        return dataclasses.replace(found, distance=np.where(middle, ROOMBA.radius, found.distance))

    altered.change = touching
    assert command.forward > 0.0
    assert driver.step(Pose(1.0, 2.0, 0.0, 1.0), 1.0) == STOP
    assert driver.state is State.BLOCKED

"""The driver by itself, in a world whose distances are exact: what each of its rules does, and when."""

import dataclasses

import numpy as np
import pytest
from gpdf_client import ClientError, PlanResult, Status, Trajectory
from gpdf_client.results import Distances
from gpdf_robot import BODIES, Driver, Pose, State
from gpdf_robot.motion import STOP, advance

ROOMBA = BODIES["roomba"]
PERIOD_S = 0.05
POSE_OLD_S, GIVE_UP_S, RETRY_S, REPLAN_S, BLOCKED_S = 0.5, 20.0, 2.0, 0.5, 1.0
DELAY_S, REACTION_S = 0.1, 0.15
MARGINS, KEEP, LOST_M, ARRIVED_M, AHEAD_M, CHECK_M = (0.06, 0.03), 0.01, 0.3, 0.04, 1.5, 0.05
"""What the driver promises, written down once more: a promise that changes is to be noticed."""
LENGTH = 6.0


class World:
    """A plane with pillars (x, y, radius); the route is the straight line to the goal; what is asked is kept."""

    def __init__(self, *pillars, height=0.0):
        self.pillars, self.height, self.version = list(pillars), height, 1
        self.refused = lambda width: False
        self.broken, self.status, self.slope, self.deadline_s = False, Status.OK, 0.0, None
        self.plans, self.asked = [], None

    def plan(self, scene, start, goal, agent):
        self.plans.append((tuple(start), agent["width"]))
        if self.refused(agent["width"]):
            return PlanResult(Status.NO_VALID_PATH, "too narrow", None, None, self.version, "p")
        xy = np.linspace(start[:2], goal[:2], 61)
        ground = np.column_stack([xy, self.height + self.slope * xy[:, 0]])
        top = ground + np.array([0.0, 0.0, ROOMBA.height])
        return PlanResult(
            self.status, "", Trajectory(top, ground, np.linspace(0.0, 20.0, 61), np.zeros(61)), None, self.version, "p"
        )

    def distance(self, scene, field, places, agent, deadline_s):
        if self.broken:
            raise ClientError("nobody answers")
        self.asked, self.deadline_s = np.array(places), deadline_s
        return Distances(
            self.room(places[:, :2]), np.zeros((len(places), 2)), np.ones(len(places), bool), None, self.version
        )

    def room(self, xy):
        gaps = [np.linalg.norm(xy - np.array(at), axis=1) - radius for *at, radius in self.pillars]
        return np.maximum(np.minimum.reduce([np.full(len(xy), 5.0), *gaps]), 0.0)


class Walk:
    """A driver whose robot does exactly what it was told `DELAY_S` ago."""

    def __init__(self, world, goal=(LENGTH, 0.0), at=(0.0, 0.0, 0.0), body=ROOMBA, **options):
        self.driver = Driver(world, "hall", goal, body, **options)
        self.world, self.now, self.pose = world, 0.0, Pose(*at)
        self.told = [STOP] * round(DELAY_S / PERIOD_S)

    def step(self, pose=None):
        command = self.driver.step(self.pose if pose is None else pose, self.now)
        self.told.append(command)
        self.now += PERIOD_S
        self.pose = dataclasses.replace(advance(self.pose, self.told.pop(0), PERIOD_S), stamp=self.now)
        return command

    def until(self, claim, seconds=60.0):
        end = self.now + seconds
        while self.now < end:
            command = self.step()
            if claim(command):
                return command
        return pytest.fail(f"it is {self.driver.state} after {seconds} s: {self.driver.reason}")

    @property
    def room(self):
        return float(self.world.room(self.pose.xy[None])[0]) - ROOMBA.radius


def cruising(*pillars, **options):
    walk = Walk(World(*pillars), **options)
    walk.until(lambda command: command.forward > 0.95 * ROOMBA.speed)
    return walk


def test_it_arrives_at_the_end_of_the_line_and_stays():
    walk = Walk(World())
    walk.until(lambda _: walk.driver.state is State.ARRIVED)
    assert LENGTH - ARRIVED_M - 0.02 <= walk.pose.x <= LENGTH + 0.01
    assert walk.driver.reason == ""
    assert [walk.step() for _ in range(5)] == [STOP] * 5
    assert len(walk.world.plans) == 1


@pytest.mark.parametrize("off", [-1.0, 1.0])
def test_a_pose_that_is_too_old_or_of_the_future_stops_it(off):
    walk = cruising()
    for age, stops in ((POSE_OLD_S - 0.01, False), (POSE_OLD_S + 0.01, True)):
        command = walk.step(dataclasses.replace(walk.pose, stamp=walk.now + off * age))
        assert (command == STOP) == stops
        assert (walk.driver.state is State.BLIND) == stops
    assert f"{-off * (POSE_OLD_S + 0.01):.2f} s old" in walk.driver.reason
    assert walk.step().forward > 0.0  # and goes on when it sees again


def test_where_no_distance_is_known_a_robot_of_any_size_has_no_room():
    small = dataclasses.replace(ROOMBA, width=0.1, length=0.1)
    walk = Walk(World(), body=small)
    walk.until(lambda command: command.forward > 0.0)
    told = walk.world.distance
    walk.world.distance = lambda *asked, **how: dataclasses.replace(
        told(*asked, **how), valid=np.zeros(len(walk.world.asked), bool)
    )
    assert walk.step() == STOP
    assert walk.driver.state is not State.DRIVING


def test_a_place_that_is_known_too_roughly_stops_it():
    walk = cruising()
    for accuracy, stops in ((0.5 * MARGINS[0] - 0.001, False), (0.5 * MARGINS[0] + 0.001, True)):
        assert (walk.step(dataclasses.replace(walk.pose, accuracy=accuracy)) == STOP) == stops
    assert "known to 0.03 m only" in walk.driver.reason


def test_without_a_first_pose_it_is_blind_and_asks_nothing():
    world = World()
    driver = Driver(world, "hall", (LENGTH, 0.0), ROOMBA)
    assert driver.step(None, 0.0) == STOP
    assert (driver.state, driver.reason, world.plans) == (State.BLIND, "no pose has come", [])


def test_no_answer_about_distances_stops_it():
    walk = cruising()
    walk.world.broken = True
    assert walk.world.deadline_s == 0.2  # in which it goes on
    assert walk.step() == STOP
    assert (walk.driver.state, walk.driver.reason) == (State.BLIND, "no distances: nobody answers")


def test_the_widest_body_that_has_a_route_is_planned_for():
    wide, narrow = (ROOMBA.width + 2 * margin for margin in MARGINS)
    for refused, asked in ((lambda width: False, [wide]), (lambda width: width > narrow + 1e-6, [wide, narrow])):
        walk = Walk(World())
        walk.world.refused = refused
        walk.step()
        assert [width for _, width in walk.world.plans] == pytest.approx(asked)
        assert (walk.driver.state, walk.driver.plans) == (State.DRIVING, 1)


def test_without_a_route_it_asks_again_after_a_while_and_gives_up_in_the_planners_words():
    walk = Walk(World())
    walk.world.refused = lambda width: True
    walk.step()
    times = []
    while walk.driver.state is not State.GAVE_UP:
        before = len(walk.world.plans)
        walk.step()
        if len(walk.world.plans) > before:
            times.append(walk.now - PERIOD_S)
        assert walk.now < 2 * GIVE_UP_S
    np.testing.assert_allclose(np.diff([0.0, *times]), RETRY_S, atol=PERIOD_S)
    assert walk.now == pytest.approx(GIVE_UP_S + 2 * PERIOD_S, abs=PERIOD_S)
    assert walk.driver.reason == "NO_VALID_PATH: too narrow"
    walk.world.refused = lambda width: False
    assert walk.step() == STOP


def test_after_something_new_it_asks_again_half_a_second_later_from_where_it_is():
    walk = cruising(at=(0.0, 0.0, 0.0))
    walk.world.version = 2
    assert walk.step() == STOP
    assert (walk.driver.state, walk.driver.reason) == (State.PLANNING, "the scene has changed")
    walk.driver._asked_at = walk.now - PERIOD_S  # as if the route were of now
    began = walk.now - PERIOD_S
    walk.until(lambda _: len(walk.world.plans) == 2)
    assert walk.now - PERIOD_S - began == pytest.approx(REPLAN_S, abs=PERIOD_S)
    (x, y, z), _ = walk.world.plans[1]
    assert (x, y, z) == pytest.approx((walk.pose.x, walk.pose.y, 0.0), abs=0.05)


def test_the_first_route_begins_on_the_storey_that_was_said_and_later_ones_on_the_routes_own():
    world = World(height=3.1)
    world.slope = 0.2
    driver = Driver(world, "hall", (LENGTH, 0.0), ROOMBA)
    driver.step(Pose(0.0, 0.0, 0.0), 0.0, start_z=3.0)
    assert world.plans[0][0] == (0.0, 0.0, 3.0)
    world.version = 2
    for i in range(1, 40):
        driver.step(Pose(2.0, 0.0, 0.0, 0.05 * i), 0.05 * i, start_z=0.0)
    assert world.plans[1][0] == pytest.approx((2.0, 0.0, 3.5))


def test_a_route_that_nobody_has_proven_is_not_driven():
    walk = Walk(World())
    walk.world.status = Status.UNCERTIFIED
    assert [walk.step() for _ in range(30)] == [STOP] * 30
    assert walk.driver.reason.startswith("UNCERTIFIED")


def test_far_beside_its_line_it_asks_for_another():
    walk = cruising()
    for off, lost in ((LOST_M - 0.03, False), (LOST_M + 0.01, True)):
        walk.step(dataclasses.replace(walk.pose, y=off))
        assert (walk.driver.state is State.PLANNING) == lost
    assert "beside its route" in walk.driver.reason


def test_what_is_asked_reaches_from_here_to_where_it_would_stand_then_along_the_line():
    walk = Walk(World(), body=dataclasses.replace(BODIES["pepper"], acceleration=0.25), delay_s=0.4)
    walk.until(lambda command: command.forward > 0.95 * walk.driver.body.speed)
    acceleration = walk.driver.body.acceleration
    speed = walk.step().forward
    asked = walk.world.asked[:, :2]
    cut = int(np.flatnonzero(np.diff(asked[:, 0]) < 0)[0]) + 1
    arc, line = asked[:cut], asked[cut:]
    reach = speed * (0.4 + REACTION_S) + speed**2 / (2 * acceleration)
    here = walk.driver._along
    assert arc[0, 0] == pytest.approx(here, abs=0.02)
    assert arc[-1, 0] - arc[0, 0] == pytest.approx(reach, rel=0.03)
    assert np.diff(arc[:, 0]).max() <= 1.3 * CHECK_M
    assert line[0, 0] == pytest.approx(here, abs=1e-6)
    np.testing.assert_allclose(np.diff(line[:, 0]), CHECK_M)
    assert AHEAD_M - 1e-6 <= line[-1, 0] - line[0, 0] <= AHEAD_M + CHECK_M + 1e-6


@pytest.mark.parametrize("age", [0.0, 0.3, -0.2])
def test_it_thinks_from_where_it_is_when_its_command_takes_effect(age):
    walk = cruising()
    speed = walk.driver._command.forward
    walk.step(dataclasses.replace(walk.pose, stamp=walk.now - age))
    ahead = walk.world.asked[0, 0] - (walk.pose.x - PERIOD_S * speed)  # of where the pose was
    assert ahead == pytest.approx(speed * (max(age, 0.0) + DELAY_S), abs=0.01)


def test_it_turns_no_faster_and_gets_no_faster_than_its_body_can():
    walk = Walk(World(), at=(0.0, 0.0, 2.0))
    commands = [walk.step() for _ in range(200)]
    turns, speeds = np.array([one.turn for one in commands]), np.array([one.forward for one in commands])
    rate = ROOMBA.turn_rate
    assert np.abs(turns).max() == pytest.approx(rate, rel=0.01)
    assert np.abs(np.diff(turns)).max() == pytest.approx(rate / 0.3 * PERIOD_S, rel=0.01)
    assert np.diff(speeds).max() == pytest.approx(ROOMBA.acceleration * PERIOD_S, rel=0.01)


@pytest.mark.parametrize("seed", range(12))
def test_what_appears_further_off_than_it_needs_to_stand_is_never_touched(seed):
    rng = np.random.default_rng(seed)
    walk = cruising()
    reach = ROOMBA.speed * (DELAY_S + REACTION_S) + ROOMBA.speed**2 / (2 * ROOMBA.acceleration)
    ahead, radius = reach + rng.uniform(0.02, 0.3), rng.uniform(0.02, 0.4)
    walk.world.pillars.append((walk.pose.x + ROOMBA.radius + ahead + radius, rng.uniform(-0.05, 0.05), radius))
    for _ in range(60):
        walk.step()
        assert walk.room > 0.0
    assert walk.told[-1] == STOP  # the route that it asked for leads through it again


def test_blocked_it_stands_and_asks_for_another_way_after_a_second():
    walk = cruising()
    place = walk.pose.x + 0.55
    walk.world.pillars.append((place, ROOMBA.radius + 0.005 + 0.05, 0.05))  # less than it keeps, and not on the line
    walk.until(lambda _: walk.driver.state is State.BLOCKED)
    assert "only 0.00" in walk.driver.reason
    assert float(walk.driver.reason.split()[1]) < KEEP
    began = walk.now
    walk.until(lambda _: walk.driver.state is State.PLANNING)
    assert walk.driver.reason == "it cannot go on along its route"
    assert BLOCKED_S - 0.3 <= walk.now - began <= BLOCKED_S + 0.5  # it creeps on for a bit
    asked = []
    while len(asked) < 3:  # the way that it is given is the same one: no sooner than the first time is it given up
        before = len(walk.world.plans)
        walk.step()
        if len(walk.world.plans) > before:
            asked.append(walk.now)
    np.testing.assert_allclose(np.diff(asked), BLOCKED_S, atol=0.2)
    assert walk.room > 0.0


def test_what_is_too_near_behind_does_not_keep_it_from_leaving():
    walk = Walk(World((-ROOMBA.radius - 0.055, 0.0, 0.05)))  # 5 mm behind its back
    walk.until(lambda _: walk.pose.x > 1.0, 20.0)
    assert walk.driver.plans == 1


def test_a_route_that_something_stands_on_is_given_up_before_it_is_near():
    walk = cruising()
    walk.world.pillars.append((walk.pose.x + 1.2, 0.0, 0.1))
    assert walk.step() == STOP
    assert walk.driver.reason == "something stands on the route"


def test_beside_something_it_goes_slowly_and_fast_again_behind_it():
    walk = cruising()
    at = walk.pose.x + 1.0
    walk.world.pillars.append((at, ROOMBA.radius + 0.05 + 0.1, 0.1))
    speeds = {}
    while walk.pose.x < at + 1.5:
        command = walk.step()
        speeds[walk.pose.x - at] = command.forward
    beside = [speed for x, speed in speeds.items() if abs(x) < 0.05]
    behind = [speed for x, speed in speeds.items() if x > 1.0]
    assert max(beside) < 0.6 * ROOMBA.speed
    assert min(behind) > 0.95 * ROOMBA.speed


def test_standing_still_for_long_it_gives_up_but_not_while_it_turns_or_creeps():
    walk = cruising()
    stuck = walk.pose
    while walk.now < 10.0:
        walk.step(dataclasses.replace(stuck, stamp=walk.now))
    assert walk.driver.state is State.DRIVING
    walk.step(dataclasses.replace(stuck, x=stuck.x + 0.02, stamp=walk.now))  # two centimetres: progress
    moved = walk.now
    while walk.driver.state is not State.GAVE_UP:
        walk.step(dataclasses.replace(stuck, x=stuck.x + 0.02, stamp=walk.now))
        assert walk.now < 60.0
    assert walk.now - moved == pytest.approx(GIVE_UP_S, abs=3 * PERIOD_S)
    assert walk.driver.reason == f"no progress in {GIVE_UP_S:.0f} s"
    turning = Walk(World(), at=(0.0, 0.0, np.pi))
    while turning.now < GIVE_UP_S + 5.0:  # something holds it, while its wheels turn
        turning.step(Pose(0.0, 0.0, np.pi, turning.now))
    assert turning.driver.state is State.DRIVING


@pytest.mark.parametrize(("aside", "turns"), [(0.03, False), (0.15, True)])
def test_only_a_turn_of_a_tenth_of_its_rate_counts_as_getting_on(aside, turns):
    """Held where it is, it turns on the spot at 0.3 rad/s, or drives on at less than 0.2 rad/s."""
    walk = Walk(World(), at=(0.0, 0.0, aside))
    while walk.now < GIVE_UP_S + 5.0:
        command = walk.step(Pose(0.0, 0.0, aside, walk.now))
        if 1.0 < walk.now < GIVE_UP_S - 1.0:
            assert (command.forward == 0.0) is turns
            assert (abs(command.turn) > 0.1 * ROOMBA.turn_rate) is turns
            assert 0.05 < abs(command.turn) < 0.2 * ROOMBA.turn_rate
    assert (walk.driver.state is State.GAVE_UP) is not turns

"""People are guided by the real service: simulated walks, poses over Zenoh, the command line."""

import dataclasses
import json
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import msgpack
import numpy as np
import pytest
import zenoh
from gpdf_client import Client
from gpdf_client.client import client_config
from gpdf_guidance import (
    PERSON,
    Asked,
    Detail,
    Errors,
    Guide,
    Kind,
    Manner,
    Outcome,
    Planned,
    Planner,
    Pose,
    Urgency,
    Walker,
    simulate,
)
from gpdf_guidance.advice import BLIND, PACES
from gpdf_guidance.features import FeatureKind
from gpdf_guidance.guide import LOST, look_up
from gpdf_guidance.live import LiveGuide
from gpdf_guidance.planner import LEVEL_STEP, too_tight
from gpdf_guidance.walker import EXACT
from gpdf_schemas import (
    Array,
    Ask,
    AskMessage,
    CueAction,
    CueMessage,
    MovingObstacle,
    MovingObstacles,
    PoseMessage,
    SayMessage,
    decode,
    encode,
    keys,
)

from gpdf_service.bench.guide import summary
from gpdf_service.bench.walks import WalkedWorld
from gpdf_service.cli import main
from gpdf_service.ports import free_endpoint
from gpdf_service.service.server import Options, Server
from gpdf_service.synthetic import SCENES
from gpdf_service.synthetic.world import Box, World

NAMES = ("office", "stair", "cow_and_lady")


def open_session(endpoint):
    return zenoh.open(client_config(endpoint))


@pytest.fixture(scope="module")
def made():
    return {name: SCENES[name](np.random.default_rng(0), spacing=0.05) for name in NAMES}


@pytest.fixture(scope="module")
def endpoint(tmp_path_factory, made):
    address = free_endpoint()
    folder: Path = tmp_path_factory.mktemp("guide")
    with Server(Options(address, folder, folder, 1)) as server, Client.connect(address) as client:
        for name, scene in made.items():
            client.load_scene(name, upload=scene.points, ground=scene.ground)
        assert server.shelf.get("stair").scene is not None
        yield address


@pytest.fixture
def client(endpoint):
    with Client.connect(endpoint) as connected:
        yield connected


def setting(client, made, name, start, goal, seed=0, heading=0.0, errors=None):
    world = WalkedWorld.of(made[name].points, made[name].ground)
    walker = Walker(np.array(start, dtype=float), heading, world.ground_height, np.random.default_rng(seed), errors)
    return Guide(Planner(client, name), goal), walker, world


@pytest.mark.parametrize("seed", range(4))
def test_people_with_errors_cross_the_office_without_a_contact(client, made, seed):
    scene = made["office"]
    guide, walker, world = setting(client, made, "office", (*scene.start, 0.0), scene.goal, seed, heading=2.0)
    walk = simulate(guide, walker, world)
    assert walk.outcome is Outcome.ARRIVED
    assert walk.penetration == 0
    assert np.hypot(*(walk.places[-1, :2] - scene.goal)) < 1.0
    assert walk.said[-1].instruction.kind is Kind.ARRIVED


@pytest.mark.slow
def test_in_a_noisy_map_without_labels_one_hears_once_how_low_things_may_be_missing(client, made):
    points = made["cow_and_lady"].points
    noisy = points + np.random.default_rng(0).normal(0.0, 0.03, points.shape)
    client.load_scene("noisy", upload=noisy)
    world = WalkedWorld.of(points, made["cow_and_lady"].ground)
    for name, heard in (("noisy", 1), ("cow_and_lady", 0)):
        walker = Walker(np.array([1.0, 1.0, 0.0]), 0.5, world.ground_height, np.random.default_rng(0))
        walk = simulate(Guide(Planner(client, name), (7.0, 5.0)), walker, world)
        assert walk.outcome is Outcome.ARRIVED
        told = [said for said in walk.said if "I do not see things lower than" in said.text]
        assert len(told) == heard
        assert all(said.instruction.kind is Kind.OVERVIEW for said in told)
        (low,) = [one for said in told for one in said.instruction.then] or [None]
        assert low is None or 0.15 < low.amount < 0.21


def told(walk):
    """All that was told, what is told with the overview included, in order."""
    return [one for said in walk.said for one in (said.instruction, said.instruction.soon) if one is not None]


@pytest.mark.parametrize("down", [False, True], ids=["up", "down"])
def test_the_stairs_are_told_with_their_steps_before_they_come(client, made, down):
    foot, head = (0.6, 0.8, 0.0), (9.6, 0.8, 3.4)
    start, goal = (head, foot) if down else (foot, head)
    guide, walker, world = setting(client, made, "stair", start, goal, heading=np.pi if down else 0.0)
    walk = simulate(guide, walker, world)
    assert walk.outcome is Outcome.ARRIVED
    assert walk.penetration == 0
    assert abs(walk.places[-1, 2] - goal[2]) < 0.01
    stairs = [one for one in told(walk) if one.kind is Kind.STAIRS]
    assert [one.count for one in stairs] == [10, 10]
    assert all((one.amount < 0) == down for one in stairs)
    assert all(one.distance <= 3.0 for one in stairs)
    assert stairs[1].distance >= 1.0
    facts = summary([(walk, guide)])
    assert facts["edges"] == facts["edges_told"] >= 1


def test_the_judge_of_the_walks_sees_contacts_and_falls(made):
    world = WalkedWorld.of(made["office"].points, made["office"].ground)
    assert world.penetration(np.array([0.9, 0.9, 0.0])) == 0
    assert world.penetration(np.array([2.7, 0.6, 0.0])) == pytest.approx(0.05, abs=0.03)  # the cupboard
    assert world.ground_height(np.array([5.5, 2.2, 0.1])) == pytest.approx(0.35)
    assert world.penetration(np.array([3.0, 2.9, 0.0])) > 0.1  # the ball at head height
    assert world.ground_height(np.array([9.0, 9.0, 0.0])) == 0.0
    assert world.penetration(np.array([0.9, 0.9, 0.0])) == np.inf


def test_under_the_rim_of_an_upper_floor_nobody_stands_on_it_and_over_it_one_falls():
    x, y = np.mgrid[-1:1:0.1, -1:1:0.1].reshape(2, -1)
    low = np.column_stack([x + 0.05, y + 0.05, 0 * x])
    x, y = np.mgrid[0:1:0.02, -1:1:0.02].reshape(2, -1)
    points = np.concatenate([low, np.column_stack([x, y, 0 * x + 2.5]), [[0.0, 0.0, 5.0]]])
    world = WalkedWorld.of(points, np.arange(len(points)) < len(points) - 1)
    assert (world.ground_height(np.array([0.1, 0.1, 0.0])), world.fell) == (0.0, False)  # the nearest eight are above
    assert (world.ground_height(np.array([0.1, 0.1, 2.5])), world.fell) == (2.5, False)
    assert (world.ground_height(np.array([-0.3, 0.1, 2.5])), world.fell) == (0.0, True)


def test_no_way_is_a_safe_stop_with_the_reason(client, made):
    guide, walker, world = setting(client, made, "office", (0.9, 0.9, 0.0), (40.0, 2.0))
    walk = simulate(guide, walker, world)
    assert walk.outcome is Outcome.SAFE_STOP
    assert "goal" in walk.reason
    assert [said.instruction.kind for said in walk.said] == [Kind.NO_WAY_GOAL]
    assert "goal" in walk.said[0].text
    assert np.ptp(walk.places, axis=0).max() == 0


def test_a_sensor_that_never_comes_back_is_a_safe_stop(client, made):
    guide, walker, world = setting(client, made, "office", (0.9, 0.9, 0.0), (5.4, 3.4))
    see = walker.pose
    walker.pose = lambda now, period: see(now, period) if now < 5.0 else None
    walk = simulate(guide, walker, world)
    assert walk.outcome is Outcome.SAFE_STOP
    assert walk.penetration == 0
    assert Kind.STOP_LOST in [said.instruction.kind for said in walk.said]
    assert walk.times[-1] < 10.0 + LOST


FAULTS = {
    "jumps": lambda pose: dataclasses.replace(pose, position=(pose.position[0] + 3.0, *pose.position[1:])),
    "is on another storey": lambda pose: dataclasses.replace(pose, position=(*pose.position[:2], 2.8)),
    "has no numbers": lambda pose: dataclasses.replace(pose, position=(np.nan, np.nan, np.nan), heading=np.nan),
    "has no height": lambda pose: dataclasses.replace(pose, position=(*pose.position[:2], np.nan)),
    "has no direction": lambda pose: dataclasses.replace(pose, heading=np.nan),
    "is of yesterday": lambda pose: dataclasses.replace(pose, stamp=pose.stamp - 86400.0),
    "is of tomorrow": lambda pose: dataclasses.replace(pose, stamp=pose.stamp + 86400.0),
    "is vague": lambda pose: dataclasses.replace(pose, accuracy=0.5),
    "is vague beyond numbers": lambda pose: dataclasses.replace(pose, accuracy=np.nan),
    "is silent": lambda pose: None,
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_sensor_that_goes_wrong_is_a_spoken_stop_within_a_second_and_never_a_go(client, made, fault):
    guide, walker, world = setting(
        client, made, "office", (0.9, 0.9, 0.0), (5.4, 3.4), 0, 0.6, Errors(drop_out_rate=0.0)
    )
    guide.felt = fault != "is silent"  # a person who does not feel the cues hears at once
    see, since = walker.pose, 3.0

    def sense(now, period):
        pose = see(now, period)
        return pose if now < since or pose is None else FAULTS[fault](pose)

    walker.pose = sense
    walk = simulate(guide, walker, world)
    after = [said for said in walk.said if said.time >= since]
    assert after[0].instruction.urgency is Urgency.DANGER
    assert after[0].text.startswith("Stop.")
    assert after[0].time <= since + 1.0
    assert {said.instruction.kind for said in after} <= {Kind.STOP_LOST, Kind.STOP_UNRELIABLE, Kind.GAVE_UP_LOST}
    assert walk.outcome is Outcome.SAFE_STOP
    assert walk.penetration == 0
    moved = np.hypot(*(walk.places[-1] - walk.places[round(since / 0.05)])[:2])
    assert moved <= PACES[0] * BLIND + 0.05  # and what a walker's sideways drift adds


def test_a_pose_that_was_wrong_for_a_moment_does_not_end_the_walk(client, made):
    guide, walker, world = setting(
        client, made, "office", (0.9, 0.9, 0.0), (5.4, 3.4), 0, 0.6, Errors(drop_out_rate=0.0)
    )
    see = walker.pose

    def sense(now, period):
        pose = see(now, period)
        return FAULTS["jumps"](pose) if pose is not None and 8.0 <= now < 10.0 else pose

    walker.pose = sense
    walk = simulate(guide, walker, world)
    kinds = [Kind.RESUME if said.instruction.resumes else said.instruction.kind for said in walk.said]
    assert kinds.index(Kind.STOP_UNRELIABLE) < kinds.index(Kind.RESUME)
    assert (walk.outcome, walk.routes, walk.penetration) == (Outcome.ARRIVED, 1, 0)


def test_a_clock_that_goes_back_is_a_stop_and_does_not_silence_the_guide(client, made):
    guide, _, _ = setting(client, made, "office", (0.9, 0.9, 0.0), (5.4, 3.4))
    guide.manner = Manner(detail=Detail.FEW)  # nothing is said before the first step
    here = Pose((0.9, 0.9, 0.0), 0.6, 100.0)
    guide.replan(here)
    assert guide.step(here, 100.0)[0].action is not CueAction.STOP
    said = []
    for tick in range(300):
        cue, words = guide.step(here, 40.0 + 0.1 * tick)  # the newest pose is of the time before
        assert cue.action is CueAction.STOP
        said += [(0.1 * tick, words[0].kind)] if words is not None else []
    assert said[0][0] <= 1.0
    assert {kind for _, kind in said} <= {Kind.STOP_UNRELIABLE, Kind.GAVE_UP_LOST}
    assert len(said) >= 3  # said again while it lasts


def test_a_planner_that_does_not_answer_is_a_stop_and_a_new_scene_another_way(client, made):
    guide, _, _ = setting(client, made, "office", (0.9, 0.9, 0.0), (5.4, 3.4))
    guide.manner = Manner(detail=Detail.FEW)
    guide.replan(Pose((0.9, 0.9, 0.0), 0.6, 0.0))
    version = guide.planner.pulse()
    assert version == guide.route.version > 0

    def after(told, seconds, since):
        guide.hear(told)
        steps = [guide.step(Pose((0.9, 0.9, 0.0), 0.6, t), t) for t in since + np.arange(0, seconds, 0.1)]
        return steps[-1][0].action, [words[0].kind for _, words in steps if words is not None]

    assert after(version, 0.2, 0.0)[0] is CueAction.GO
    assert after(None, 1.0, 0.2) == (CueAction.STOP, [Kind.STOP_ALONE])
    assert not guide.wants_route(Pose((0.9, 0.9, 0.0), 0.6, 1.2), 1.2)
    assert after(version, 2.0, 1.2) == (CueAction.GO, [Kind.RESUME])  # when "Stop. …" has been said to the end
    assert after(version + 1, 1.0, 3.2)[0] is CueAction.STOP
    assert guide.wants_route(Pose((0.9, 0.9, 0.0), 0.6, 4.2), 4.2)


def test_a_way_is_planned_for_the_person_that_is_led(client):
    here, goal = Pose((0.9, 0.9, 0.0), 0.6, 0.0), (5.4, 3.4)
    slim = Planner(client, "office", {**PERSON, "width": 0.4}).route(here, goal)
    assert slim.route.radius == 0.2
    wide = Planner(client, "office", {**PERSON, "width": 3.0}).route(here, goal)
    assert wide.route is None
    assert "1.50 m" in wide.why
    assert wide.refusal is Kind.NO_WAY_START


@pytest.mark.parametrize("name", NAMES)
def test_widths_that_are_not_asked_for_would_be_refused(name, client, made, monkeypatch):
    """Asked or not, the way is the same: so wide a body would not fit where it starts, or where it goes to."""
    rng, low, high = np.random.default_rng(3), made[name].points.min(axis=0), made[name].points.max(axis=0)
    places = [[float(value) for value in rng.uniform(low[:2], high[:2])] for _ in range(24)]
    asked, plan = [], Client.plan
    monkeypatch.setattr(Client, "plan", lambda *args, **more: asked.append(0) or plan(*args, **more))

    def routes():
        asked.clear()
        planner = Planner(client, name)
        found = [planner.route(Pose((*a, 0.0), 0.0, 0.0), b) for a, b in zip(places[::2], places[1::2], strict=True)]
        return [(one.why, None if one.route is None else one.route.ground.tolist()) for one in found], len(asked)

    ours, few = routes()
    monkeypatch.setattr("gpdf_guidance.planner.spare_at_ends", lambda *_: np.inf)
    all_of_them, many = routes()
    assert ours == all_of_them
    assert few < many


def test_nobody_plans_for_a_scene_that_is_not_there(client):
    assert Planner(client, "nowhere").pulse() is None
    planned = Planner(client, "nowhere").route(Pose((0.0, 0.0, 0.0), 0.0, 0.0), (1.0, 1.0))
    assert planned.route is None
    assert "nowhere" in planned.why


def test_a_new_obstacle_is_stopped_for_and_passed_when_it_is_gone(client, made):
    guide, walker, world = setting(client, made, "stair", (0.6, 0.8, 0.0), (9.6, 0.8, 3.4))
    column = np.column_stack([np.full(20, 1.7), np.full(20, 0.8), np.linspace(0.0, 1.9, 20)])
    guide.replan(Pose((0.6, 0.8, 0.0), 0.0, 0.0))  # it comes when the way is known already
    guide.see(column)
    blocked = simulate(guide, walker, world, longest=20.0)
    assert blocked.outcome is Outcome.SAFE_STOP
    assert Kind.STOP_OBSTACLE in [said.instruction.kind for said in blocked.said]
    assert np.hypot(*(blocked.places[:, :2] - column[0, :2]).T).min() > 0.25
    again, walker, world = setting(client, made, "stair", blocked.places[-1], (9.6, 0.8, 3.4))
    assert simulate(again, walker, world).outcome is Outcome.ARRIVED


def test_what_hangs_beside_the_way_is_a_feature(client):
    here = Pose((4.75, 1.2, 0.0), np.pi / 2, 0.0)
    route = Planner(client, "cow_and_lady").route(here, (4.7, 4.2)).route
    (head,) = (feature for feature in route.features if feature.kind is FeatureKind.HEAD)  # the cow's
    assert head.amount > 0
    assert abs(route.at(head.start)[1] - 2.45) < 0.8


def test_a_way_that_is_too_tight_is_refused_with_its_room(client):
    planner = Planner(client, "office")
    route = planner.route(Pose((0.9, 0.9, 0.0), 0.0, 0.0), (5.4, 3.4)).route
    assert too_tight(route) == ""
    tight = dataclasses.replace(route, room=np.where(np.abs(route.s - 3) < 0.2, 0.05, route.room))
    assert "5 cm beside the person" in too_tight(tight)
    at_the_goal = dataclasses.replace(route, room=np.where(route.s > route.length - 0.5, 0.01, route.room))
    assert too_tight(at_the_goal) == ""


class Feet(threading.Thread):
    """A walker in real time: feels cues from Zenoh, sends poses."""

    def __init__(self, session, walker, name):
        super().__init__(daemon=True)
        self.walker, self.cues, self.halt, self.mute = walker, [], threading.Event(), threading.Event()
        self._poses = session.declare_publisher(f"{keys.POSE}/{name}")
        self._cues = session.declare_subscriber(f"{keys.CUE}/{name}", self._feel)

    def __enter__(self):
        self.start()
        return self

    def __exit__(self, *_):
        self.halt.set()
        self.join()

    def _feel(self, sample):
        self.cues.append(decode(sample.payload.to_bytes(), CueMessage))
        self.walker.feel(self.cues[-1])

    def wait_for(self, action):
        self.cues.clear()
        until = time.monotonic() + 30
        while all(cue.action is not action for cue in list(self.cues)):
            assert time.monotonic() < until, f"no cue says {action}"
            time.sleep(0.01)

    def run(self):
        while not self.halt.wait(0.05):
            now = time.time()
            self.walker.move(now, 0.05)
            pose = self.walker.pose(now, 0.05)
            if pose is not None and not self.mute.is_set():
                message = PoseMessage(position=list(pose.position), heading=pose.heading, stamp=now, accuracy=0.02)
                self._poses.put(encode(message))


def test_poses_over_zenoh_become_cues_and_a_person_arrives(endpoint, made):
    with open_session(endpoint) as session, open_session(endpoint) as body:
        guide, walker, world = setting(Client(session), made, "office", (0.9, 0.9, 0.0), (2.4, 1.2))
        feet, said = Feet(body, walker, "ada"), []
        body.put(f"{keys.POSE}/ada", b"\xffno pose")
        live = LiveGuide(session, guide, "ada", lambda *sentence: said.append(sentence))
        with feet:
            assert live.run() is Outcome.ARRIVED
            until = time.monotonic() + 30
            while feet.cues[-1].action is not CueAction.ARRIVED:  # the last cue is on its way
                assert time.monotonic() < until
                time.sleep(0.01)
    assert world.penetration(walker.position) == 0
    assert said[-1][1].kind is Kind.ARRIVED


def test_cues_say_stop_when_poses_stop_and_when_something_is_in_the_way(endpoint, made):
    stop, key = threading.Event(), keys.obstacles("office")
    with open_session(endpoint) as session, open_session(endpoint) as body, ThreadPoolExecutor(1) as pool:
        guide, walker, _ = setting(Client(session), made, "office", (0.9, 0.9, 0.0), (5.4, 3.4), heading=0.6)
        walker.move = lambda now, period: None  # stands, and looks the right way
        running = pool.submit(LiveGuide(session, guide, "bob", lambda *_: None).run, stop.is_set)
        try:
            with Feet(body, walker, "bob") as feet:
                feet.wait_for(CueAction.GO)
                column = np.tile(guide.route.at(1.0), (9, 1)) + np.linspace(0.1, 1.9, 9)[:, None] * [0, 0, 1]
                seen = MovingObstacle(id="bob", points=Array.pack(column), lifetime_s=60.0)
                body.put(key, encode(MovingObstacles(obstacles=[MovingObstacle(id="nothing"), seen])))
                feet.wait_for(CueAction.STOP)
                body.put(key, encode(MovingObstacles(obstacles=[MovingObstacle(id="bob", lifetime_s=0.0)])))
                feet.wait_for(CueAction.GO)
                feet.mute.set()
                feet.wait_for(CueAction.STOP)
        finally:
            stop.set()
        assert running.result(30) is Outcome.WALKING


STOPS = (Kind.STOP_ALONE, Kind.STOP_LOST, Kind.STOP_UNRELIABLE)


@pytest.mark.slow
def test_a_service_that_dies_in_mid_walk_is_a_spoken_stop(tmp_path, made, free_endpoint):
    said, steps, stop = [], [], threading.Event()

    def told(time_s, instruction, text):
        if instruction.kind in (*STOPS, Kind.RESUME):
            said.append(instruction.kind)

    def ends():
        steps.append(stop.is_set())
        return steps[-1]

    with Server(Options(free_endpoint, tmp_path, tmp_path, 1)) as server, open_session(free_endpoint) as session:
        client, scene = Client(session), made["office"]
        client.load_scene("office", upload=scene.points, ground=scene.ground)
        guide, walker, _ = setting(client, made, "office", (0.9, 0.9, 0.0), (5.4, 3.4), heading=0.6)
        with open_session(free_endpoint) as body, ThreadPoolExecutor(1) as pool, Feet(body, walker, "eve") as feet:
            running = pool.submit(LiveGuide(session, guide, "eve", told).run, ends)
            try:
                feet.wait_for(CueAction.GO)
                server.__exit__(None, None, None)
                until = time.monotonic() + 60
                while not said or said[-1] is Kind.RESUME:  # a busy machine may have stopped and gone on before
                    assert time.monotonic() < until
                    time.sleep(0.01)
                stops, later = len(said), len(steps) + 20
                while len(steps) < later:
                    assert time.monotonic() < until
                    time.sleep(0.01)
                assert Kind.RESUME not in said[stops:]
            finally:
                stop.set()
            assert running.result(30) is Outcome.WALKING


@pytest.mark.parametrize("wrong", ["garbage", "without numbers", "a clock that goes back"])
def test_messages_that_are_no_poses_stop_a_person(endpoint, made, wrong):
    said, heard, stop = [], threading.Event(), threading.Event()

    def told(time_s, instruction, text):
        said.append(instruction.kind)
        if instruction.kind is Kind.STOP_UNRELIABLE:
            heard.set()

    with open_session(endpoint) as session, open_session(endpoint) as body, ThreadPoolExecutor(1) as pool:
        guide, walker, _ = setting(Client(session), made, "office", (0.9, 0.9, 0.0), (5.4, 3.4), heading=0.6)
        running = pool.submit(LiveGuide(session, guide, "kim", told).run, stop.is_set)
        try:
            with Feet(body, walker, "kim") as feet:
                feet.wait_for(CueAction.GO)
                feet.mute.set()
                while not heard.wait(0.05):
                    old = PoseMessage(position=[0.9, 0.9, 0.0], heading=0.6, stamp=time.time() - 60.0)
                    nan = {"position": [0.9, 0.9, float("nan")], "heading": 0.6, "stamp": time.time()}
                    messages = {
                        "garbage": b"\xff",
                        "without numbers": msgpack.packb(nan),
                        "a clock that goes back": encode(old),
                    }
                    body.put(f"{keys.POSE}/kim", messages[wrong])
                feet.wait_for(CueAction.STOP)
        finally:
            stop.set()
        assert running.result(30) is Outcome.WALKING
        assert Kind.RESUME not in said


@pytest.mark.slow
def test_the_command_line_guides_a_simulated_person(endpoint, made, tmp_path, capsys):
    scene, cloud = made["stair"], tmp_path / "stair.npz"
    np.savez(cloud, xyz=scene.points, label=scene.ground.astype(int), classes=np.array(["other", "ground"]))
    words = ["guide", "stair", "--goal", "9.6,0.8", "--start", "0.6,0.8", "--simulate", "--json"]
    words += ["--endpoint", endpoint]
    assert main([*words, "--truth", str(cloud), "--png", str(tmp_path / "walk.png")]) == 0
    *said, result = map(json.loads, capsys.readouterr().out.splitlines())
    assert {"stairs", "arrived"} <= {line["kind"] for line in said}
    assert (result["outcome"], result["contact"]) == ("arrived", False)
    assert (tmp_path / "walk.png").read_bytes().startswith(b"\x89PNG")
    assert main([*words, "--width", "0.6", "--height", "1.9"]) == 0  # the same without the truth, for another person
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["contact"] is None


def test_the_command_line_fails_with_words(endpoint, free_endpoint, capsys):
    assert main(["guide", "nowhere", "--goal", "1,1", "--endpoint", endpoint]) == 1
    assert "nowhere" in capsys.readouterr().err
    assert main(["guide", "office", "--goal", "1,1", "--simulate", "--endpoint", endpoint]) == 2
    assert "--start" in capsys.readouterr().err
    assert main(["guide", "office", "--goal", "1,1", "--endpoint", free_endpoint]) == 1
    assert "gpdf serve" in capsys.readouterr().err


@pytest.mark.slow
def test_the_guide_needs_nothing_but_the_light_install(endpoint):
    code = "import sys\n"
    code += "for name in ('scipy', 'numba', 'open3d', 'laspy', 'mcap', 'matplotlib'): sys.modules[name] = None\n"
    code += "from gpdf_service.cli import main\nsys.exit(main(sys.argv[1:]))"
    words = ["guide", "office", "--goal", "2.4,1.2", "--start", "0.9,0.9", "--simulate", "--endpoint", endpoint]
    done = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert "You have arrived." in done.stdout


def test_a_ledge_is_gone_round_where_a_level_way_exists_and_asked_for_where_none_does(client, made):
    guide, walker, world = setting(client, made, "office", (5.4, 1.0, 0.0), (5.4, 3.5), heading=1.0)
    walk = simulate(guide, walker, world, agrees=False)
    assert (walk.outcome, walk.penetration) == (Outcome.ARRIVED, 0.0)
    assert np.ptp(walk.places[:, 2]) == 0.0  # the ledge of 35 cm lies between
    assert not {said.instruction.kind for said in walk.said} & {Kind.STEP, Kind.ASK_STEP}

    guide, walker, world = setting(client, made, "office", (5.4, 1.0, 0.0), (5.5, 2.2), heading=1.0)
    declined = simulate(guide, walker, world, agrees=False)
    assert [said.instruction.kind for said in declined.said] == [Kind.ASK_STEP, Kind.NO_WAY_STEP]
    assert "35 centimetres up" in declined.said[0].text
    assert (declined.outcome, declined.metres) == (Outcome.SAFE_STOP, 0.0)

    guide, walker, world = setting(client, made, "office", (5.4, 1.0, 0.0), (5.5, 2.2), heading=1.0)
    agreed = simulate(guide, walker, world, agrees=True)
    kinds = [said.instruction.kind for said in agreed.said]
    assert (agreed.outcome, agreed.penetration) == (Outcome.ARRIVED, 0.0)
    assert kinds[:3] == [Kind.ASK_STEP, Kind.CONSENTED, Kind.OVERVIEW]
    assert {Kind.STEP, Kind.ARRIVED} <= set(kinds)  # told of where one stands, that is the word at the edge, too
    assert guide.climb == pytest.approx(0.35, abs=0.03)  # it is remembered


def deck(barred):
    """A car park's ramp along a wall, without a parapet: 0.33 m high where the walk begins; `barred` at its foot."""

    def floor(xy):
        return np.where(xy[:, 0] < 1.6, 0.15 * np.clip(xy[:, 1] - 2.0, 0.0, 6.0), 0.0)

    bar = (Box((0.0, 2.2, 0.0), (1.6, 3.6, 1.5)),) if barred else ()
    return World((5.0, 8.5, 3.0), bar, floor, ceiling=False).sample(0.06, np.random.default_rng(0), 0.0)


@pytest.mark.parametrize(("barred", "agrees"), [(False, False), (True, False), (True, True)])
def test_from_a_ramp_one_walks_to_its_foot_and_off_its_side_only_after_consent(client, barred, agrees):
    points, ground = deck(barred)
    name = f"deck_{barred}"
    if name not in client.scenes():
        client.load_scene(name, upload=points, ground=ground)
    world = WalkedWorld.of(points, ground)
    walker = Walker(np.array([0.8, 4.2, 0.33]), 0.0, world.ground_height, np.random.default_rng(0), EXACT)
    walk = simulate(Guide(Planner(client, name), (3.5, 4.2, 0.0)), walker, world, agrees=agrees)
    kinds = [one.kind for one in told(walk)]
    assert walk.penetration == 0.0
    assert (Kind.ASK_STEP in kinds) == barred
    if barred and not agrees:
        assert (walk.outcome, walk.metres, kinds[-1]) == (Outcome.SAFE_STOP, 0.0, Kind.NO_WAY_STEP)
        return
    assert walk.outcome is Outcome.ARRIVED
    assert (Kind.STEP in kinds) == barred
    dropped = np.abs(np.diff(walk.places[:, 2])).max() > LEVEL_STEP
    assert dropped == barred  # without a bar he walks to the foot of the ramp


def test_who_stands_beside_a_ledge_is_led_away_from_it(client):
    planned = Planner(client, "office").route(Pose((4.8, 2.2, 0.0), 0.0, 0.0), (0.9, 0.9))
    assert planned.route is not None, planned.why
    assert planned.highest == 0.0


def test_nobody_is_led_over_a_ledge_before_the_answer(client, made):
    guide, _, _ = setting(client, made, "office", (5.4, 1.0, 0.0), (5.5, 2.2), heading=1.0)
    guide.replan(Pose((5.4, 1.0, 0.0), 1.0, 0.0))
    cues = [guide.step(Pose((5.4, 1.0, 0.0), 1.0, t), t)[0].action for t in np.arange(0.0, 30.0, 0.1)]
    assert set(cues) == {CueAction.STOP}
    assert guide.outcome is Outcome.WALKING
    for t in np.arange(30.0, 62.0, 0.1):
        guide.step(Pose((5.4, 1.0, 0.0), 1.0, t), t)
    assert guide.outcome is Outcome.SAFE_STOP


def test_too_tight_a_way_is_told_with_its_room(client, made):
    guide, _, _ = setting(client, made, "office", (0.9, 0.9, 0.0), (5.4, 3.4))
    tight = Planned(None, "too tight", Kind.NO_WAY_TIGHT, 0.071)
    guide.take(tight, Pose((0.9, 0.9, 0.0), 0.0, 0.0))
    _, said = guide.step(Pose((0.9, 0.9, 0.0), 0.0, 0.1), 0.1)
    assert said[1] == (
        "Stay here. The best way leaves only 7 centimetres beside you, and you need 8. Please ask for help."
    )


def led(client, made, detail=Detail.NORMAL, start=(0.9, 0.9, 0.0), heading=0.6):
    """A guide whose person stands at the start of a way, and a way to step it."""
    guide, _, _ = setting(client, made, "office", start, (5.4, 3.4))
    guide.manner = Manner(detail=detail)
    clock = [0.0]

    def hear(seconds):
        said = []
        for _ in range(round(seconds * 10)):
            clock[0] += 0.1
            cue, words = guide.step(Pose(start, heading, clock[0]), clock[0])
            said += [words] if words is not None else []
        return cue, said

    guide.replan(Pose(start, heading, 0.0))
    return guide, hear


def test_every_ask_is_answered_with_its_id(client, made):
    guide, hear = led(client, made, Detail.FEW)
    hear(1.0)
    answers = {
        Ask.REPEAT: Kind.NOTHING_SAID,
        Ask.WHERE: Kind.HOW_FAR,  # this scene has no named place
        Ask.HOW_FAR: Kind.HOW_FAR,
        Ask.PAUSE: Kind.PAUSED,
        Ask.GO_ON: Kind.RESUME,
        Ask.SLOWER: Kind.SLOWER,
        Ask.FASTER: Kind.FASTER,
        Ask.MORE_WORDS: Kind.MORE_WORDS,
        Ask.FEWER_WORDS: Kind.FEWER_WORDS,
        Ask.YES: Kind.NOT_ASKED,
        Ask.NO: Kind.NOT_ASKED,
        Ask.AROUND: Kind.AROUND,
    }
    assert set(answers) | {Ask.GOAL} == set(Ask)
    for i, (ask, kind) in enumerate(answers.items()):
        guide.ask(look_up(guide.planner, AskMessage(ask=ask, id=str(i)), Pose((0.9, 0.9, 0.0), 0.6, 0.0)))
        _, said = hear(6.0)
        assert (kind, str(i)) in [(one.kind, one.reply_to) for one, _ in said], ask


@pytest.mark.parametrize("ask", [Ask.WHERE, Ask.HOW_FAR, Ask.AROUND])
def test_who_asks_before_his_first_pose_hears_that_it_is_waited_for_and_then_that_a_way_is(client, made, ask):
    guide, _, _ = setting(client, made, "office", (0.9, 0.9, 0.0), (5.4, 3.4))
    guide.ask(Asked(ask, "1"))
    _, said = guide.step(None, 0.1)
    assert said is not None
    assert (said[0].kind, said[0].reply_to) == (Kind.STOP_NO_POSE, "1")
    guide.step(Pose((0.9, 0.9, 0.0), 0.6, 0.2), 0.2)
    guide.ask(Asked(ask, "2"))
    _, said = guide.step(Pose((0.9, 0.9, 0.0), 0.6, 9.9), 10.0)
    assert said is not None
    assert (said[0].kind, said[1]) == (Kind.NEW_GOAL, "I am looking for the way to the goal.")


def test_a_position_that_never_was_there_is_not_lost(client, made):
    guide, _, _ = setting(client, made, "office", (0.9, 0.9, 0.0), (5.4, 3.4))
    said = [guide.step(None, 0.1 * tick)[1] for tick in range(60)]
    assert [one[0].kind for one in said if one is not None] == [Kind.STOP_NO_POSE]


def test_who_pauses_stands_until_going_on_and_is_not_given_up(client, made):
    guide, hear = led(client, made, Detail.FEW)
    assert hear(1.0)[0].action is CueAction.GO
    guide.ask(Asked(Ask.PAUSE))
    assert hear(100.0)[0].action is CueAction.STOP
    guide.ask(Asked(Ask.GO_ON))
    assert hear(1.0)[0].action is CueAction.GO


def test_slower_is_slower_and_faster_is_never_faster_than_is_safe(client, made):
    guide, hear = led(client, made, Detail.FEW)
    full = hear(1.0)[0].pace
    guide.ask(Asked(Ask.SLOWER))
    assert hear(1.0)[0].pace < full
    for _ in range(5):
        guide.ask(Asked(Ask.FASTER))
    assert hear(1.0)[0].pace == full


def test_a_new_goal_is_looked_up_and_walked_to_and_an_unknown_one_changes_nothing(client, made):
    client.set_place("office", "cupboard", (3.0, 1.2))
    guide, hear = led(client, made, Detail.FEW)
    guide.ask(look_up(guide.planner, AskMessage(ask=Ask.GOAL, goal="nowhere"), None))
    assert guide.goal == (5.4, 3.4)
    assert [one.kind for one, _ in hear(3.0)[1]] == [Kind.UNKNOWN_GOAL]
    guide.ask(look_up(guide.planner, AskMessage(ask=Ask.GOAL, goal="cupboard"), None))
    assert guide.goal[:2] == (3.0, 1.2)
    assert guide.wants_route(Pose((0.9, 0.9, 0.0), 0.6, 4.0), 4.0)
    client.remove_place("office", "cupboard")


@pytest.mark.parametrize("patient", [True, False])
def test_who_opens_the_page_has_time_to_find_his_place(client, made, patient):
    guide, _, _ = setting(client, made, "office", (0.9, 0.9, 0.0), (5.4, 3.4))
    guide.patient = patient
    steps = [guide.step(None, 0.1 * tick) for tick in range(600)]
    assert {cue.action for cue, _ in steps} == {CueAction.STOP}
    assert (guide.outcome is Outcome.WALKING) == patient
    assert all(said is None for _, said in steps) == patient


def test_the_way_is_told_before_the_first_step(client, made):
    _, hear = led(client, made)
    cue, said = hear(1.0)
    assert cue.action is CueAction.STOP
    assert [one.kind for one, _ in said] == [Kind.OVERVIEW]
    assert "walk 5 metres" in said[0][1]
    assert hear(6.0)[0].action is CueAction.GO


def test_sentences_and_asks_go_over_zenoh(endpoint, made):
    heard, stop = [], threading.Event()

    def wait_for(wanted):
        until = time.monotonic() + 30
        while not any(wanted(one) for one in list(heard)):
            assert time.monotonic() < until, heard
            time.sleep(0.01)

    with open_session(endpoint) as session, open_session(endpoint) as body, ThreadPoolExecutor(1) as pool:
        guide, walker, _ = setting(Client(session), made, "office", (0.9, 0.9, 0.0), (5.4, 3.4), heading=0.6)
        walker.move = lambda now, period: None
        body.declare_subscriber(f"{keys.SAY}/lea", lambda s: heard.append(decode(s.payload.to_bytes(), SayMessage)))
        running = pool.submit(LiveGuide(session, guide, "lea", lambda *_: None).run, stop.is_set)
        try:
            with Feet(body, walker, "lea"):
                wait_for(lambda one: one.kind == "overview")
                body.put(f"{keys.ASK}/lea", b"\xffno ask")
                body.put(f"{keys.ASK}/lea", encode(AskMessage(ask=Ask.HOW_FAR, id="q1")))
                wait_for(lambda one: one.reply_to == "q1")
                body.put(f"{keys.ASK}/lea", encode(AskMessage(ask=Ask.GOAL, id="q2", goal=[5.5, 2.2])))
                wait_for(lambda one: one.kind == "ask_step" and one.answers == [Ask.YES, Ask.NO])
                body.put(f"{keys.ASK}/lea", encode(AskMessage(ask=Ask.NO, id="q3")))
                wait_for(lambda one: one.kind == "no_way_step")
        finally:
            stop.set()
        assert running.result(30) is Outcome.SAFE_STOP
    assert all(one.language == "en" and one.valid_until > one.stamp for one in heard)
    assert len({one.id for one in heard}) == len(heard)

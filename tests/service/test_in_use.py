"""Trajectories that somebody follows, cut by something that moves."""

import dataclasses
import queue
import shutil
import threading
import tracemalloc

import numpy as np
import pytest
from gpdf_client import Client, InvalidRequestError
from gpdf_schemas import Array, Cylinder, MovingObstacle
from gpdf_schemas.moving import MAX_POINTS, points_of
from hypothesis import assume, given
from hypothesis import strategies as st

import gpdf_service as gpdf
from gpdf_service.service.in_use import MOST_PLACES, InUse
from gpdf_service.service.server import Options, Server
from gpdf_service.types import Trajectory

START, GOAL = (1.0, 1.5), (5.0, 1.5)
PATIENCE, GRACE_S, MOST, TOUCH = 3.0, 60.0, 1000, 0.002
"""What is promised, written down once more."""


def straight(length=4.0, agent="human", duration=8.0):
    """Along x from (1, 1.5), in two waypoints."""
    ground = np.array([[1.0, 1.5, 0.0], [1.0 + length, 1.5, 0.0]])
    top = ground + np.array([0.0, 0.0, gpdf.AGENTS[agent].height])
    return Trajectory(top, ground, np.array([0.0, duration]), np.zeros(2))


def in_use(points, agent="human", clock=lambda: 0.0, **more):
    made = InUse(lambda scene: {"x": np.atleast_2d(points).astype(float)}, lambda cut: None, "me", clock)
    made.remember("hall", "1", gpdf.AGENTS[agent], straight(agent=agent, **more))
    return made


@given(
    st.floats(0.0, 6.0),
    st.floats(0.5, 2.5),
    st.floats(-0.5, 2.5),
    st.sampled_from(["roomba", "spot", "pepper", "human"]),
)
def test_a_point_cuts_exactly_where_the_swept_cylinder_is(x, y, z, agent):
    body = gpdf.AGENTS[agent]
    apart = np.hypot(x - np.clip(x, 1.0, 5.0), y - 1.5)  # from the line
    inside = min(body.radius - apart, z - 0.015, body.height - z)
    cuts = in_use((x, y, z), agent).cuts("hall")
    if abs(inside) > 2 * TOUCH:
        assert bool(cuts) == (inside > 0)
    for cut in cuts:
        along = x - 1.0 - np.sqrt(max(0.0, body.radius**2 - (y - 1.5) ** 2))  # where its rim first reaches the point
        assert cut.time == pytest.approx(2.0 * max(0.0, along), abs=0.15)
        np.testing.assert_allclose(cut.at, [1.0 + cut.time / 2, 1.5, 0.0], atol=1e-9)
        assert (cut.scene, cut.request_id, cut.planner, cut.obstacles) == ("hall", "1", "me", ["x"])


def away_from_whole(number):
    """Whether rounding cannot turn it into one piece more."""
    return abs(number - round(number)) > 1e-9


@given(st.floats(1.5, 5.5), st.floats(-0.1, 0.1), st.floats(0.5, 4.0))
def test_a_way_is_looked_at_every_four_centimetres_from_its_start(x, aside, length):
    assume(away_from_whole(length / 0.04))
    radius, pieces = gpdf.AGENTS["human"].radius, np.ceil(length / 0.04)
    looks = 1.0 + length / pieces * np.arange(pieces + 1)
    gap = np.hypot(looks - x, aside) - (radius - TOUCH)
    assume(np.abs(gap).min() >= 1e-6)
    cuts = in_use((x, 1.5 + aside, 0.5), length=length, duration=10.0).cuts("hall")
    assert bool(cuts) == (gap < 0.0).any()
    for cut in cuts:
        first = np.flatnonzero(gap < 0.0)[0]
        np.testing.assert_allclose(cut.at, [looks[first], 1.5, 0.0], atol=1e-9)
        assert cut.time == pytest.approx(10.0 * first / pieces, abs=1e-9)


@pytest.mark.parametrize("agent", ["roomba", "human"])
def test_neither_what_lies_on_the_ground_nor_what_hangs_over_the_body_cuts_it(agent):
    height = gpdf.AGENTS[agent].height
    for z, cut in ((0.015, False), (0.016, True), (height - 0.001, True), (height, False)):
        assert bool(in_use((3.0, 1.5, z), agent).cuts("hall")) == cut


def test_on_a_slope_the_body_stands_upright_on_its_contact_point():
    human = gpdf.AGENTS["human"]
    ground = np.array([[1.0, 1.5, 0.0], [5.0, 1.5, 2.0]])
    path = Trajectory(ground + np.array([0.0, 0.0, human.height]), ground, np.array([0.0, 8.0]), np.zeros(2))
    for z, cut in ((0.5, False), (1.0, True), (1.0 + human.height, True), (1.3 + human.height, False)):
        used = InUse(lambda scene, at=z: {"x": np.array([[3.0, 1.5, at]])}, lambda cut: None)
        used.remember("hall", "1", human, path)
        assert bool(used.cuts("hall")) == cut, z  # its rim is half its radius above and below the middle


def test_what_comes_first_is_told_and_all_that_are_in_the_way():
    points = {"far": np.array([[4.0, 1.5, 0.5]]), "near": np.array([[9.0, 1.5, 0.5], [2.0, 1.5, 0.5]])}
    points |= {"beside": np.array([[3.0, 2.4, 0.5]]), "over": np.array([[3.0, 1.5, 2.0]])}
    used = InUse(lambda scene: points, lambda cut: None)
    used.remember("hall", "1", gpdf.AGENTS["human"], straight())
    (cut,) = used.cuts("hall")
    assert cut.obstacles == ["far", "near"]
    assert cut.at[0] == pytest.approx(2.0 - gpdf.AGENTS["human"].radius, abs=0.05)


@given(st.floats(0.3, 3.0), st.floats(-3.0, 3.0), st.floats(0.0, 0.7))
def test_who_turns_on_the_spot_is_looked_at_every_four_centimetres_of_its_ends(turn, angle, away):
    cart = dataclasses.replace(gpdf.AGENTS["spot"], discs=6)
    ground = np.tile([3.0, 1.5, 0.0], (2, 1))
    path = Trajectory(ground + np.array([0.0, 0.0, 0.7]), ground, np.array([0.0, 4.0]), np.array([0.0, turn]))
    point = np.array([3.0 + away * np.cos(angle), 1.5 + away * np.sin(angle), 0.3])
    used = InUse(lambda scene: {"x": point[None]}, lambda cut: None)
    used.remember("hall", "1", cart, path)
    assume(away_from_whole(max(cart.offsets) * turn / 0.04))
    pieces = int(np.ceil(max(cart.offsets) * turn / 0.04))
    heading = np.linspace(0.0, turn, pieces + 1)
    discs = np.array([3.0, 1.5]) + cart.offsets[:, None, None] * np.column_stack([np.cos(heading), np.sin(heading)])
    gap = np.linalg.norm(discs - point[:2], axis=2).min(axis=0) - (cart.disc_radius - TOUCH)
    assume(np.abs(gap).min() >= 1e-6)
    expected = 4.0 * np.flatnonzero(gap < 0.0)[:1] / pieces
    np.testing.assert_allclose([cut.time for cut in used.cuts("hall")], expected, atol=1e-9)


def test_of_many_places_the_oldest_go_but_never_the_newest(monkeypatch):
    monkeypatch.setattr("gpdf_service.service.in_use.MOST_PLACES", 250)  # a straight way has 101
    used = in_use((3.0, 1.5, 0.5))
    for number in ("2", "3"):
        used.remember("hall", number, gpdf.AGENTS["human"], straight())
    assert [cut.request_id for cut in used.cuts("hall")] == ["2", "3"]
    used.remember("hall", "long", gpdf.AGENTS["human"], straight(length=40.0))
    assert [cut.request_id for cut in used.cuts("hall")] == ["long"]
    used.remember("hall", "4", gpdf.AGENTS["human"], straight())
    assert [cut.request_id for cut in used.cuts("hall")] == ["4"]


def test_an_error_while_looking_does_not_end_the_looking():
    asked, told = threading.Event(), queue.Queue()

    def points_of_scene(scene):
        if not asked.is_set():
            asked.set()
            raise ValueError("once")
        return {"x": np.array([[3.0, 1.5, 0.5]])}

    sources = [lambda scene: {}]
    used = InUse(lambda scene: sources[-1](scene), told.put)
    used.remember("hall", "1", gpdf.AGENTS["human"], straight())
    sources.append(points_of_scene)
    used.start()
    try:
        used.look("hall")
        assert asked.wait(30)
        used.look("hall")
        assert told.get(timeout=30).request_id == "1"
    finally:
        used.close()


@pytest.mark.parametrize("agent", ["roomba", "human"])
def test_what_touches_the_body_by_less_than_two_millimetres_does_not_cut_it(agent):
    radius = gpdf.AGENTS[agent].radius
    for inside, cut in ((0.0015, False), (0.0025, True)):
        assert bool(in_use((1.0, 1.5 + radius - inside, 0.05), agent).cuts("hall")) == cut


def test_a_body_of_discs_is_cut_by_what_its_footprint_meets_turning_too():
    spot = dataclasses.replace(gpdf.AGENTS["spot"], discs=6)
    ground = np.array([[1.0, 1.5, 0.0], [5.0, 1.5, 0.0], [5.0, 1.5, 0.0]])
    path = Trajectory(
        ground + np.array([0.0, 0.0, 0.7]), ground, np.array([0.0, 8.0, 10.0]), np.array([0.0, 0.0, np.pi / 2])
    )
    for point, when in (((3.0, 1.8, 0.5), None), ((3.0, 1.55, 0.5), 3.0), ((5.0, 1.95, 0.5), 9.7)):
        used = InUse(lambda scene, at=point: {"x": np.array([at])}, lambda cut: None)
        used.remember("hall", "1", spot, path)
        times = [cut.time for cut in used.cuts("hall")]
        assert times == ([] if when is None else [pytest.approx(when, abs=0.3)]), point


def test_a_trajectory_is_in_use_for_a_while_and_in_its_scene():
    now = [0.0]
    used = in_use((3.0, 1.5, 0.5), clock=lambda: now[0])
    assert used.cuts("hall")
    assert not used.cuts("elsewhere")
    now[0] = PATIENCE * 8.0 + GRACE_S - 1.0
    assert used.cuts("hall")
    now[0] += 2.0
    assert not used.cuts("hall")


def test_only_so_many_are_remembered():
    used = in_use((3.0, 1.5, 0.5))
    for i in range(MOST):
        used.remember("hall", f"later {i}", gpdf.AGENTS["human"], straight())
    assert len(used.cuts("hall")) == MOST
    assert "1" not in {cut.request_id for cut in used.cuts("hall")}


def test_long_trajectories_of_bodies_of_many_discs_take_no_more_memory_than_many_short_ones():
    long = dataclasses.replace(gpdf.AGENTS["human"], discs=32), straight(length=200.0)
    used = InUse(lambda scene: {"x": np.array([[3.0, 1.5, 0.5]])}, lambda cut: None)
    tracemalloc.start()
    for i in range(200):
        used.remember("hall", str(i), *long)
    cuts = used.cuts("hall")
    held = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert 1 < len(cuts) < 100
    assert cuts[-1].request_id == "199"
    assert held < 100 * MOST_PLACES


@pytest.mark.parametrize("agent", ["roomba", "human"])
def test_a_plan_round_something_is_not_cut_by_it(agent):
    x, y = np.meshgrid(np.arange(0, 6, 0.05), np.arange(0, 3, 0.05))
    hall = gpdf.build_scene(np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]))
    for place in (1.9, 1.8, 2.1):
        points = points_of(MovingObstacle(cylinder=Cylinder((3.0, place, 0.0), 0.25, 1.8)))
        path = gpdf.plan(hall.with_obstacles(points), START, GOAL, agent)
        assert path.status == "OK"
        used = InUse(lambda scene, points=points: {"x": points}, lambda cut: None)
        used.remember("hall", "1", gpdf.AGENTS[agent], path.trajectory)
        assert used.cuts("hall") == []


def test_who_subscribed_hears_of_a_cut_over_zenoh(free_endpoint, tmp_path, office, office_file):
    made = office[0]
    shutil.copy(office_file, tmp_path / "office.gpdf")
    options = Options(free_endpoint, tmp_path, tmp_path / "log", 1)
    heard = queue.Queue()
    with (
        Server(options, [("office", tmp_path / "office.gpdf")]) as server,
        Client.connect(free_endpoint) as walker,
        Client.connect(free_endpoint) as camera,
    ):
        server.shelf.settle()
        walker.watch_cuts("office", heard.put)
        plan = walker.plan("office", made.start, made.goal)
        x, y, z = plan.trajectory.ground[len(plan.trajectory.ground) // 2]
        with pytest.raises(InvalidRequestError, match="neither points"):
            camera.publish_obstacles("office", [MovingObstacle(id="nothing")])
        many = Array.pack(np.zeros((MAX_POINTS + 1, 3)), "f4")
        with pytest.raises(InvalidRequestError, match="Thin"):
            camera.publish_obstacles("office", [MovingObstacle(id="all", points=many)])
        with pytest.raises(InvalidRequestError, match="parts"):
            camera.publish_obstacles("office", [MovingObstacle(id="all", points=Array.pack(np.zeros((MAX_POINTS, 3))))])
        camera.publish_obstacles(
            "office", [MovingObstacle(id="dog", cylinder=Cylinder((x, y, z), 0.2, 0.5), lifetime_s=600)]
        )
        cut = heard.get(timeout=30)
    assert (cut.scene, cut.request_id, cut.obstacles) == ("office", plan.request_id, ["dog"])
    assert cut.planner == server.planner_id
    assert 0 < cut.time < plan.trajectory.duration
    assert server.status().metrics["bad_publications"] == 0


def test_a_new_trajectory_is_looked_at_alone_and_all_are_when_something_moves():
    points, told = {}, queue.Queue()
    used = InUse(lambda scene: points, told.put)
    used.start()
    try:
        used.remember("hall", "first", gpdf.AGENTS["human"], straight())
        points["x"] = np.array([[3.0, 1.5, 0.5]])
        used.look("hall")
        assert told.get(timeout=30).request_id == "first"
        used.remember("hall", "second", gpdf.AGENTS["human"], straight())
        assert told.get(timeout=30).request_id == "second"
        used.look("hall")
        assert {told.get(timeout=30).request_id for _ in range(2)} == {"first", "second"}
        assert told.empty()
    finally:
        used.close()
    assert "gpdf-cuts" not in {thread.name for thread in threading.enumerate()}
    InUse(lambda scene: points, told.put).close()  # one that never looked

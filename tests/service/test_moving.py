import copy
import time
import tracemalloc
from itertools import pairwise

import msgspec
import numpy as np
import pytest
from gpdf_client import Client, InvalidRequestError
from gpdf_schemas import Array, Cylinder, MovingObstacle, MovingObstacles, encode, keys
from gpdf_schemas.moving import MAX_POINTS, points_of
from mcap.records import Channel

import gpdf_service as gpdf
from gpdf_service.service.moving import LEAST_OBSTACLE, Living, Moving
from gpdf_service.service.record import records_of
from gpdf_service.service.replay import Moved, recorded_events
from gpdf_service.service.server import Options, Server

START, GOAL = (1.0, 1.5), (5.0, 1.5)


@pytest.fixture(scope="module")
def hall():
    """A floor of 6 x 3 m; its rim is the end of the known world."""
    x, y = np.meshgrid(np.arange(0, 6, 0.05), np.arange(0, 3, 0.05))
    return gpdf.build_scene(np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]))


def person(x, y, **more):
    return MovingObstacle(id=f"{x},{y}", cylinder=Cylinder((x, y, 0.0), 0.25, 1.8), **more)


def gap(result, x, y):
    """Room between the side of the person and the path [m]."""
    path = result.trajectory.ground[:, :2]
    fine = np.concatenate([a + (b - a) * np.linspace(0, 1, 20)[:, None] for a, b in pairwise(path)])
    return np.linalg.norm(fine - (x, y), axis=1).min() - 0.25


@pytest.mark.parametrize("agent", ["roomba", "spot", "pepper", "human"])
def test_a_plan_goes_round_a_person_and_its_certificate_knows(hall, agent):
    free = gpdf.plan(hall, START, GOAL, agent)
    assert gap(free, 3.0, 1.5) < 0  # straight through
    body = gpdf.AGENTS[agent]
    place = (3.0, 1.9)
    result = gpdf.plan(Moving().merged("hall", hall, [person(*place)]), START, GOAL, agent)
    assert result.status == "OK"
    assert gap(result, *place) >= body.radius
    assert result.certificate.min_clearance <= gap(result, *place) - body.radius + 0.005


def test_a_crowd_closes_the_way_and_a_lifted_barrier_stops_only_the_tall(hall):
    crowd = [person(3.0, y) for y in np.arange(0.0, 3.01, 0.4)]
    assert gpdf.plan(Moving().merged("hall", hall, crowd), START, GOAL, "roomba").status == "NO_VALID_PATH"
    barrier = [MovingObstacle(id=str(y), cylinder=Cylinder((3.0, y, 1.0), 0.1, 0.1)) for y in np.arange(0.0, 3.01, 0.1)]
    barred = Moving().merged("hall", hall, barrier)
    assert gpdf.plan(barred, START, GOAL, "roomba").status == "OK"
    assert gpdf.plan(barred, START, GOAL, "human").status == "NO_VALID_PATH"


def test_nobody_starts_inside_a_moving_obstacle(hall):
    large = MovingObstacle(cylinder=Cylinder((1.0, 1.5, 0.0), 1.0, 1.8))
    assert gpdf.plan(Moving().merged("hall", hall, [large]), START, GOAL, "roomba").status == "START_OCCUPIED"


def test_an_obstacle_ends_with_its_lifetime_and_is_replaced_and_removed_by_its_id(hall):
    now = [0.0]
    moving = Moving(lambda: now[0])

    def count():
        return len(moving.merged("hall", hall).moving)

    one, two = person(3.0, 1.5, lifetime_s=1.0), person(4.0, 1.5, lifetime_s=5.0)
    size = len(points_of(one))
    moving.publish("hall", [one, two])
    assert count() == 2 * size
    now[0] = 1.0
    assert count() == size
    moving.publish("hall", [two])
    assert count() == size
    now[0] = 5.5
    assert count() == size
    moving.publish("hall", [MovingObstacle(id=two.id, lifetime_s=0.0)])
    assert moving.merged("hall", hall) is hall
    assert not moving._living


def test_the_next_version_of_a_scene_gets_what_moves_though_nothing_of_that_has_changed(hall):
    moving = Moving()
    moving.publish("hall", [person(3.0, 1.5, lifetime_s=60)])
    before = moving.merged("hall", hall)
    pillar = np.random.default_rng(0).uniform((2.0, 0.5, 0.0), (2.2, 0.7, 1.8), (400, 3))
    changed = hall.update(pillar)
    now = moving.merged("hall", changed)
    np.testing.assert_array_equal(now.points, changed.points)
    np.testing.assert_array_equal(now.moving, before.moving)
    assert moving.merged("hall", changed) is now


def test_what_was_built_serves_until_something_changes(hall):
    moving = Moving()
    moving.publish("hall", [person(3.0, 1.5, lifetime_s=60)])
    first = moving.merged("hall", hall)
    assert moving.merged("hall", hall) is first
    moving.publish("hall", [person(3.1, 1.5, lifetime_s=60)])
    assert moving.merged("hall", hall) is not first
    assert moving.merged("elsewhere", hall) is hall


@pytest.mark.parametrize(
    "obstacle",
    [
        MovingObstacle(id="x"),
        MovingObstacle(id="x", points=Array.pack(np.zeros((3, 2)))),
        MovingObstacle(id="x", cylinder=Cylinder((0.0, 0.0, 0.0), -1.0, 1.0)),
        MovingObstacle(id="x", cylinder=Cylinder((0.0, 0.0, 0.0), 1e9, 1.0)),
        MovingObstacle(id="x", points=Array((1, 3), "f8", np.full(3, np.nan).tobytes())),
        MovingObstacle(id="x", points=Array.pack(np.zeros((MAX_POINTS + 1, 3)))),
    ],
)
def test_an_obstacle_of_no_sense_is_refused_and_leaves_the_others(hall, obstacle):
    moving = Moving()
    moving.publish("hall", [person(3.0, 1.5, lifetime_s=60)])
    before = moving.merged("hall", hall)
    with pytest.raises(ValueError, match=r"x|points|finite"):
        moving.publish("hall", [obstacle])
    with pytest.raises(ValueError, match=r"x|points|finite"):
        moving.merged("hall", hall, [obstacle])
    assert moving.merged("hall", hall) is before


def test_one_obstacle_of_no_sense_does_not_hide_the_others_of_its_message(hall):
    moving = Moving()
    with pytest.raises(ValueError, match="neither"):
        moving.publish("hall", [MovingObstacle(id="x"), person(3.0, 1.5, lifetime_s=60)])
    assert len(moving.merged("hall", hall).moving) > 0


def test_what_is_published_is_known_from_the_moment_that_is_told(hall):
    now, told = iter(range(100)), []
    moving = Moving(lambda: next(now))
    with pytest.raises(ValueError, match="neither"):
        moving.publish("hall", [MovingObstacle(id="x"), person(3.0, 1.5, lifetime_s=60)], told.append)
    looked, living = moving.look("hall")
    assert told[0] < looked < living["3.0,1.5"].until == told[0] + 60


def test_a_message_with_one_obstacle_of_no_sense_is_recorded_as_its_others_count(hall, tmp_path, free_endpoint):
    hall.save(tmp_path / "hall.gpdf")
    with Server(Options(free_endpoint, tmp_path, tmp_path, 1)) as server, Client.connect(free_endpoint) as client:
        client.load_scene("hall", "hall.gpdf")
        both = MovingObstacles(obstacles=[MovingObstacle(id="x"), person(3.0, 1.9, lifetime_s=600)])
        client.session.put(keys.obstacles("hall"), encode(both))
        until = time.monotonic() + 300
        while server.status().metrics["bad_publications"] < 1:
            assert time.monotonic() < until
        assert len(server.handlers.moving.living("hall")) == 1
    (moved,) = [event for event in recorded_events(server.recorder.path) if isinstance(event, Moved)]
    assert [one.id for one in moved.obstacles] == ["x", "3.0,1.9"]


def test_a_short_message_does_not_become_gigabytes(hall):
    largest = Cylinder((3.0, 1.5, 0.0), 10.0, 10.0)
    crowd = [MovingObstacle(id=str(i), cylinder=largest, lifetime_s=60) for i in range(100)]  # 16 GB of points
    tracemalloc.start()
    for take in (Moving().publish, lambda name, more: Moving().merged(name, hall, more)):
        with pytest.raises(ValueError, match="room for 200000"):
            take("hall", crowd)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 50e6


def test_what_does_not_fit_any_more_is_refused_and_what_fits_is_taken():
    moving, half = Moving(), Array.pack(np.zeros((MAX_POINTS // 2 + 1, 3)))
    first, second, small = (MovingObstacle(id=id_, points=half, lifetime_s=60) for id_ in ("first", "second", "small"))
    small = msgspec.structs.replace(small, points=Array.pack(np.zeros((1, 3))))
    with pytest.raises(ValueError, match="'second'"):
        moving.publish("hall", [first, second, small])
    assert set(moving.living("hall")) == {"first", "small"}
    with pytest.raises(ValueError, match="Thin"):
        moving.publish("hall", [second])
    assert set(moving.living("hall")) == {"first", "small"}


def test_scenes_that_nobody_loaded_do_not_fill_the_memory(monkeypatch):
    monkeypatch.setattr("gpdf_service.service.moving.MAX_IN_ALL", 3 * LEAST_OBSTACLE)
    now = [0.0]
    moving = Moving(lambda: now[0])
    nothing = MovingObstacle(id="x", points=Array.pack(np.zeros((0, 3))), lifetime_s=10)
    for name in "abc":
        moving.publish(name, [nothing])
    moving.publish("c", [nothing])
    with pytest.raises(ValueError, match="all others"):
        moving.publish("d", [nothing])
    now[0] = 11.0
    moving.publish("d", [nothing])
    assert set(moving._living) == {"d"}  # what ended is forgotten, also where nobody looks


ROOM, COUNTS, SCENES_FULL = 200_000, 20, 50
"""What is promised, written down once more: points of a scene, of an obstacle at least; scenes that may be full."""


def held(count, until=np.inf):
    """Obstacles of so many points, which take no memory."""
    return {"x": Living(np.broadcast_to(0.0, (count, 3)), until, 0)}


def dot(name="dot", **more):
    return MovingObstacle(id=name, points=Array.pack(np.zeros((1, 3))), **{"lifetime_s": 60.0, **more})


def test_an_obstacle_counts_twenty_points_and_a_scene_holds_so_many_to_the_last_one():
    for free, fits in ((COUNTS, True), (COUNTS - 1, False)):
        moving = Moving(lambda: 0.0)
        moving.replace("hall", held(ROOM - free))
        if fits:
            moving.publish("hall", [dot()])
        else:
            with pytest.raises(ValueError, match="counts 20 or more"):
                moving.publish("hall", [dot()])
        assert set(moving.living("hall")) == ({"x", "dot"} if fits else {"x"})


def test_all_scenes_together_hold_fifty_full_ones_to_the_last_obstacle():
    moving = Moving(lambda: 0.0)
    for i in range(SCENES_FULL):
        moving.replace(f"s{i}", held(ROOM))
    with pytest.raises(ValueError, match="all others"):
        moving.publish("hall", [dot()])
    moving.replace("s0", held(ROOM - COUNTS))
    moving.publish("hall", [dot()])
    moving.publish("hall", [dot()])  # the same again takes no more
    with pytest.raises(ValueError, match="all others"):
        moving.publish("hall", [dot("another")])
    moving.publish("hall", [dot(lifetime_s=0.0)])
    moving.publish("hall", [dot("another")])
    moving.forget("s1")
    moving.publish("hall", [dot()])


def test_an_obstacle_is_taken_away_even_where_others_fill_the_memory():
    moving = Moving(lambda: 0.0)
    moving.publish("hall", [dot()])
    for i in range(SCENES_FULL + 1):
        moving.replace(f"s{i}", held(ROOM))
    moving.publish("hall", [dot(lifetime_s=0.0)])
    assert moving.living("hall") == {}


def test_what_ended_elsewhere_is_looked_for_once_a_second():
    now = [0.0]
    moving = Moving(lambda: now[0])
    for i in range(SCENES_FULL):
        moving.replace(f"s{i}", held(ROOM, until=0.5))
    for at, fits in ((0.0, False), (0.9, False), (1.1, True)):  # at 0 s they lived, so it was looked
        now[0] = at
        if fits:
            moving.publish("hall", [dot()])
        else:
            with pytest.raises(ValueError, match="all others"):
                moving.publish("hall", [dot()])


def test_the_same_again_asks_for_no_room_so_nothing_that_ended_is_looked_for():
    now = [0.0]
    moving = Moving(lambda: now[0])
    for i in range(SCENES_FULL):
        moving.replace(f"s{i}", held(ROOM - COUNTS * (i == 0), until=0.5))
    for at, name in ((0.0, "dot"), (0.1, "dot"), (0.6, "another")):  # had it been looked at 0.1 s, it would not at 0.6
        now[0] = at
        moving.publish("hall", [dot(name)])
    assert set(moving.living("hall")) == {"dot", "another"}


def test_what_ended_elsewhere_makes_room_for_the_one_point_that_is_lacking():
    moving = Moving(lambda: 1.0)
    moving.replace("s0", held(ROOM - COUNTS + 1, until=0.5))
    for i in range(1, SCENES_FULL):
        moving.replace(f"s{i}", held(ROOM))
    moving.publish("hall", [dot()])
    assert set(moving.living("hall")) == {"dot"}


def test_nothing_moves_for_longer_than_an_hour_unless_it_is_published_again():
    now = [0.0]
    moving = Moving(lambda: now[0])
    moving.publish("hall", [dot("long", lifetime_s=1e9), dot("short", lifetime_s=3599.0)])
    for at, left in ((3598.0, {"long", "short"}), (3599.5, {"long"}), (3600.5, set())):
        now[0] = at
        assert set(moving.living("hall")) == left


def test_a_name_has_256_characters_at_most():
    moving = Moving(lambda: 0.0)
    moving.publish("hall", [dot("x" * 256)])
    with pytest.raises(ValueError, match="257 characters"):
        moving.publish("hall", [dot("y" * 257)])
    assert set(moving.living("hall")) == {"x" * 256}


def test_what_was_built_serves_its_scene_alone_and_what_was_looked_at(hall):
    moving, other = Moving(lambda: 0.0), copy.copy(hall)
    moving.publish("hall", [person(3.0, 1.5, lifetime_s=60)])
    first = moving.merged("hall", hall)
    assert moving.merged("hall", hall, living={}) is hall
    assert len(moving.merged("hall", hall).moving) == len(first.moving)
    later = moving.merged("hall", other)
    assert later is not first
    assert moving.merged("hall", other) is later


def test_obstacles_of_a_request_have_room_together(hall):
    half = Array.pack(np.zeros((ROOM // 2 + 1, 3)))
    with pytest.raises(ValueError, match=f"room for {ROOM - ROOM // 2 - 1} of"):
        Moving().merged("hall", hall, [MovingObstacle(id=id_, points=half) for id_ in "ab"])
    several = [dot(str(i)) for i in range(3)]
    assert len(Moving().merged("hall", hall, several).moving) == 3


@pytest.mark.slow
def test_many_tiny_obstacles_take_no_more_memory_and_time_than_few_large_ones():
    moving, most = Moving(lambda: 0.0), MAX_POINTS // LEAST_OBSTACLE
    dot = Array.pack(np.zeros((1, 3)))
    dots = [MovingObstacle(id=str(i), points=dot, lifetime_s=3600) for i in range(most + 1)]
    with pytest.raises(ValueError, match=f"counts {LEAST_OBSTACLE} or more"):
        moving.publish("hall", dots)
    for i in range(50):
        moving.publish(f"s{i}", dots[:most])
    with pytest.raises(ValueError, match="all others"):
        moving.publish("hall", dots[:1])
    before = time.process_time()
    for _ in range(100):
        with pytest.raises(ValueError, match="all others"):
            moving.publish("hall", dots[:1])
    assert time.process_time() - before < 0.5  # 500,000 were looked at each time
    moving.publish("s0", [msgspec.structs.replace(dots[0], lifetime_s=0)])
    moving.publish("hall", dots[:1])  # there is room again


def test_an_obstacle_with_a_name_of_megabytes_is_refused_and_the_others_are_taken():
    moving = Moving()
    with pytest.raises(ValueError, match="1000 characters"):
        moving.publish("hall", [msgspec.structs.replace(person(1.0, 1.0), id=id_) for id_ in ("x" * 1000, "y")])
    assert set(moving.living("hall")) == {"y"}


def test_what_is_published_for_scenes_that_nobody_loaded_is_kept_and_not_recorded(tmp_path, free_endpoint):
    with Server(Options(free_endpoint, tmp_path, tmp_path, 1)) as server, Client.connect(free_endpoint) as client:
        client.publish_obstacles("not yet", [person(3.0, 1.9, lifetime_s=60)])
        client.publish_obstacles("later", [person(3.0, 1.9, lifetime_s=60)])
        until = time.monotonic() + 30
        while not server.handlers.moving.living("later"):
            assert time.monotonic() < until
        assert server.status().metrics["bad_publications"] == 1  # no scene can have a name with a blank
    topics = {record.topic for record in records_of(server.recorder.path) if isinstance(record, Channel)}
    assert not {topic for topic in topics if "later" in topic or "not yet" in topic}


def test_a_cylinders_points_are_not_inside_it_and_leave_no_gap():
    points = points_of(person(0.0, 0.0))
    ring = points[np.hypot(*points[:, :2].T) > 0.24]
    assert np.hypot(*ring[:, :2].T).min() >= 0.25
    angle = np.sort(np.unique(np.arctan2(ring[:, 1], ring[:, 0]).round(9)))
    assert np.diff(angle).max() * 0.25 < 0.06
    assert (points[:, 2].min(), points[:, 2].max()) == (0.0, 1.8)


def test_obstacles_of_a_request_and_published_ones_over_zenoh(hall, tmp_path, free_endpoint):
    hall.save(tmp_path / "hall.gpdf")
    with Server(Options(free_endpoint, tmp_path, tmp_path, 1)) as server, Client.connect(free_endpoint) as client:
        client.load_scene("hall", "hall.gpdf")
        assert gap(client.plan("hall", START, GOAL), 3.0, 1.5) < 0
        result = client.plan("hall", START, GOAL, obstacles=[person(3.0, 1.9)])
        assert gap(result, 3.0, 1.9) >= gpdf.AGENTS["human"].radius
        assert gap(client.plan("hall", START, GOAL), 3.0, 1.5) < 0  # for that plan alone
        with pytest.raises(InvalidRequestError, match="neither points"):
            client.plan("hall", START, GOAL, obstacles=[MovingObstacle(id="x")])

        client._session.put(keys.obstacles("hall"), b"garbage")
        client.publish_obstacles("hall", [person(3.0, 1.9, lifetime_s=60)])
        until = time.monotonic() + 30
        while gap(result := client.plan("hall", START, GOAL), 3.0, 1.5) < 0:
            assert time.monotonic() < until
        assert gap(result, 3.0, 1.9) >= gpdf.AGENTS["human"].radius
        assert client.distance("hall", "obstacle", [[3.0, 1.6]]).distance[0] < 0.1
        assert server.status().metrics["bad_publications"] == 1
        client.publish_obstacles("hall", [msgspec.structs.replace(person(3.0, 1.9), lifetime_s=0.0)])
        while gap(client.plan("hall", START, GOAL), 3.0, 1.5) > 0:
            assert time.monotonic() < until

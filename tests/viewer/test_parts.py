"""The page's parts without a browser."""

import dataclasses
import re
import threading

import numpy as np
import pytest
from driving import until
from gpdf_client import PlanResult, Trajectory, UnavailableError
from gpdf_schemas import Array, CertificateMessage, Cylinder, MovingObstacle, Status

from gpdf_service.clouds.formats import READERS
from gpdf_service.service.server import Options, Server
from gpdf_service.types import AGENTS
from gpdf_service.viewer import colours, words
from gpdf_service.viewer.drops import room_beside
from gpdf_service.viewer.frame import Frame
from gpdf_service.viewer.link import Link
from gpdf_service.viewer.map_layers import View
from gpdf_service.viewer.panel import AS_SCANNED, CLOUDS, key_of
from gpdf_service.viewer.path_layers import DASH, dashes, disc_centres
from gpdf_service.viewer.profile import profile_of
from gpdf_service.viewer.scale import numbers
from gpdf_service.viewer.worker import Worker

GOOD = PlanResult(
    Status.OK,
    "",
    Trajectory(*(np.array([[0.0, 0.0, z], [3.0, 4.0, z]]) for z in (2.0, 0.0)), np.array([0.0, 10.0]), np.zeros(2)),
    CertificateMessage(0.25, [0, 0, 0], 0.01, [0, 0, 0], 0.1, np.radians(5.0), True, "", 0.075, 0.3),
    1,
    "p",
    {"looked": 0.001, "search": 0.002},
)
UNPROVEN = dataclasses.replace(GOOD, status=Status.UNCERTIFIED, message="It touches a desk.")
BAD = PlanResult(Status.GOAL_OCCUPIED, "The goal is in a desk.", None, None, 1, "p")


def test_of_jobs_with_one_name_only_the_newest_is_done():
    gate, done, ended = threading.Event(), [], threading.Event()
    worker = Worker("test", done.append)
    worker.do("first", lambda: (gate.wait(30), done.append("first")))
    for i in range(5):
        worker.do("slider", lambda i=i: done.append(i))
    worker.do("last", ended.set)
    gate.set()
    assert ended.wait(30)
    worker.close()
    assert done == ["first", 4]


def test_a_newer_job_of_a_name_comes_after_all_that_were_asked_for_before_it():
    gate, done, ended = threading.Event(), [], threading.Event()
    worker = Worker("test", done.append)
    worker.do("first", lambda: gate.wait(30))
    for name, job in (("plan", "old plan"), ("clear", "clear"), ("plan", "new plan")):
        worker.do(name, lambda job=job: done.append(job))
    worker.do("last", ended.set)
    gate.set()
    assert ended.wait(30)
    worker.close()
    assert done == ["clear", "new plan"]  # what is cleared stays cleared, and the plan that comes after stays


def test_a_job_that_fails_is_told_and_the_next_is_done():
    told, ended = [], threading.Event()
    worker = Worker("test", told.append)

    def fail(error):
        raise error

    worker.do("a", lambda: fail(UnavailableError("nobody there")))
    worker.do("b", lambda: fail(ZeroDivisionError("oh")))
    worker.do("c", ended.set)
    assert ended.wait(30)
    worker.close()
    assert told[0] == "nobody there"
    assert "ZeroDivisionError" in told[1]


def test_the_link_finds_loses_and_finds_again(tmp_path, free_endpoint):
    heard = []
    link = Link(free_endpoint, heard.append)
    link.start()
    try:
        for _ in range(2):
            with Server(Options(free_endpoint, tmp_path, tmp_path, 1)):
                until(lambda: heard[-1:] == [True])
                assert link.client.scenes() == {}
            until(lambda: heard[-1:] == [False])
            with pytest.raises(UnavailableError, match="gpdf serve"):
                link.client  # noqa: B018
    finally:
        link.close()
    assert heard == [True, False, True, False]


@pytest.mark.parametrize(
    ("change", "layers"),
    [
        ({}, set()),
        ({"colour": "level"}, {"cloud", "ground"}),
        ({"colour": "ground"}, {"cloud"}),
        ({"colour": AS_SCANNED}, {"cloud", "ground"}),
        ({"below": 1.0}, {"cloud"}),
        ({"point_size": 0.05}, {"cloud", "obstacles"}),
        ({"shown": frozenset({"cloud", "ground", "leaves"})}, {"leaves"}),
        ({"shown": frozenset({"cloud"})}, {"cloud", "ground"}),  # the cloud then shows the ground's own points
        ({"levels": frozenset({1})}, {"cloud", "ground"}),
        ({"apart": 2.0}, {"cloud", "ground"}),
    ],
)
def test_only_what_looks_different_is_sent_again(change, layers):
    assert View(**change).touched(View()) == layers


def test_colours_are_told_as_one_number_each():
    made = colours.unpacked(np.array([0xC8141E, 0xFFFFFF, 0, -1], dtype=np.float32))
    np.testing.assert_array_equal(made, [[200, 20, 30], [255, 255, 255], [0, 0, 0], colours.NOWHERE])


def test_a_ramp_runs_from_its_first_colour_to_its_last_and_stays_there():
    made = colours.ramp(np.array([-1.0, 0.0, 0.5, 1.0, 9.0]), 0.0, 1.0, colours.ROOM)
    assert made[0].tolist() == made[1].tolist() == colours.ROOM[0].tolist()
    assert made[3].tolist() == made[4].tolist() == colours.ROOM[-1].tolist()
    assert made[2].tolist() != made[1].tolist()


def test_inferred_ground_looks_like_no_height_of_the_cloud_and_like_no_seen_ground():
    heights = colours.ramp(np.linspace(0.0, 1.0, 500), 0.0, 1.0, colours.PALE)
    inferred = colours.INFERRED.astype(np.float64)
    assert np.linalg.norm(heights - inferred, axis=1).min() > 75.0
    assert np.linalg.norm(colours.SEEN - inferred) > 75.0


@pytest.mark.parametrize(
    ("colour", "said"),
    [
        ("height", ["ground", "inferred: nobody saw it", "things at 0 m", "2.5 m over the ground"]),
        ("ground", ["ground", "inferred: nobody saw it", "other points"]),
        ("level", ["ground", "inferred: nobody saw it"]),
        (AS_SCANNED, ["inferred: nobody saw it", "came without a colour"]),
    ],
)
def test_the_key_names_what_is_drawn_with_units(colour, said):
    assert [text for text in re.split(r"<[^>]*>", key_of(colour, 2.5)) if text] == said


def test_every_file_that_is_read_can_be_sent():
    assert CLOUDS.split(",") == list(READERS)


def test_levels_have_their_own_colours_and_nowhere_is_grey():
    made = colours.of_levels(np.array([-1.0, 0.0, 1.0, 0.0]))
    assert made[0].tolist() == list(colours.NOWHERE)
    assert made[1].tolist() == made[3].tolist() != made[2].tolist()


def test_an_answer_is_in_words():
    assert "5.00 m in 10.0 s" in words.answer(GOOD)
    assert "0.25 m" in words.answer(GOOD)
    assert words.answer(BAD) == "**GOAL_OCCUPIED** · The goal is in a desk."
    said = words.details(GOOD, 0.0213)
    assert "21 ms" in said
    assert "Search 2 ms" in said
    assert "looked" not in said
    assert "5.0°" in said
    assert "| things may be missed up to | 0.075 m |" in said
    assert "| ground was seen every | 0.30 m |" in said


def test_a_path_that_is_not_proven_is_not_to_be_followed():
    assert "Not proven: do not follow it" in words.answer(UNPROVEN)
    assert "Not proven" not in words.answer(GOOD)


def test_a_comparison_has_a_row_for_each_method_also_for_a_refused_one():
    results = {"a": GOOD, "b": BAD, "c": UNPROVEN, "d": "unknown <method>"}
    text = words.comparison("method", results, {"a": 0.01, "b": 0.02, "c": 0.03}, dict.fromkeys(results, (0, 0, 0)))
    head, a, b, c, d = re.findall("<tr>.*?</tr>", text)
    assert "least clearance" in head
    assert "5.00" in a
    assert "GOAL_OCCUPIED" in b
    assert "5.00" in c
    assert "UNCERTIFIED" in c
    assert "refused" in d
    assert text.count("do not follow it") == 1
    assert "d: unknown &lt;method&gt;" in text
    for colour in re.findall(r"color:#(\w{6})'>[A-Z]", text):  # words, on white: WCAG's relative luminance
        shares = [int(colour[i : i + 2], 16) / 255.0 for i in (0, 2, 4)]
        linear = [share / 12.92 if share <= 0.04045 else ((share + 0.055) / 1.055) ** 2.4 for share in shares]
        assert 1.05 / (np.dot((0.2126, 0.7152, 0.0722), linear) + 0.05) > 4.5


def test_room_beside_dropped_obstacles_is_that_of_the_nearest_at_the_bodys_height():
    path, agent = GOOD.trajectory, AGENTS["spot"]
    post = MovingObstacle(id="1", cylinder=Cylinder((0.0, 1.0, 0.0), 0.25, 1.8))
    lamp = MovingObstacle(id="2", cylinder=Cylinder((0.0, 0.0, 1.0), 0.25, 0.5))  # over a Spot's back
    dust = MovingObstacle(id="3", points=Array.pack(np.array([[3.0, 4.9, 0.2], [3.0, 4.1, 0.9]])))
    room = room_beside([post, lamp, dust], path, agent)
    np.testing.assert_allclose(room, [0.75 - agent.radius, 0.9 - agent.radius])
    assert np.isinf(room_beside([], path, agent)).all()


def test_a_body_of_discs_has_the_room_of_its_nearest_disc():
    way = Trajectory(*(np.array([[0.0, 0.0, z], [2.0, 0.0, z]]) for z in (0.7, 0.0)), np.array([0.0, 2.0]), np.zeros(2))
    spot = dataclasses.replace(AGENTS["spot"], discs=6)
    ahead, beside = (
        MovingObstacle(id=name, cylinder=Cylinder(base, 0.1, 1.0))
        for name, base in (("1", (3.0, 0.0, 0.0)), ("2", (0.0, 0.5, 0.0)))
    )
    discs = disc_centres(way, spot)
    assert discs.shape == (6, 2, 3)
    np.testing.assert_allclose(discs[:, 1, 0] - 2.0, spot.offsets)
    tip = spot.offsets[-1] + spot.disc_radius
    np.testing.assert_allclose(room_beside([ahead], way, spot), [3.0 - 0.1 - tip, 1.0 - 0.1 - tip])
    near = np.hypot(spot.offsets[3], 0.5) - 0.1 - spot.disc_radius
    np.testing.assert_allclose(room_beside([beside], way, spot)[0], near)
    turned = dataclasses.replace(way, headings=np.full(2, np.pi / 2))
    np.testing.assert_allclose(disc_centres(turned, spot)[-1, 0], [0.0, spot.offsets[-1], 0.0], atol=1e-12)


def test_dashes_lie_on_the_line_and_leave_half_of_it_out():
    line = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [3.0, 4.0, 0.0]])
    pieces = dashes(line)
    lengths = np.linalg.norm(pieces[:, 1] - pieces[:, 0], axis=1)
    np.testing.assert_allclose(lengths, DASH, rtol=0.35)  # around the corner a dash is shorter
    np.testing.assert_allclose(lengths.sum(), 3.5, atol=2 * DASH)
    np.testing.assert_allclose([pieces[0, 0], pieces[-1, 1]], [line[0], line[-1]])


@pytest.mark.parametrize(
    ("low", "high", "step", "shown"),
    [(-0.2, 6.1, 1.0, [0, 2, 4, 6]), (0.3, 0.8, 1.0, []), (-23.0, 31.0, 5.0, [-20, -10, 0, 10, 20, 30])],
)
def test_numbers_along_a_side_lie_on_the_ground_that_the_camera_shows(low, high, step, shown):
    made = numbers(low, high, step)
    np.testing.assert_allclose(made, shown)
    assert not np.signbit(made[made == 0.0]).any()  # "-0 m"


def test_a_profile_has_the_way_and_the_speed_of_the_feet():
    profile = profile_of(GOOD.trajectory, np.array([0.3, 0.4]))
    np.testing.assert_allclose(profile.along, [0.0, 5.0])
    np.testing.assert_allclose(profile.speed, [0.5, 0.5])
    np.testing.assert_allclose(profile.top - profile.ground, 2.0)


@pytest.mark.parametrize("floors", [[0.0], [0.4, 3.2], [-1.0, 2.0, 2.3, 9.0]])
@pytest.mark.parametrize("apart", [0.0, 0.5, 10.0])
def test_storeys_are_pulled_apart_and_what_is_drawn_is_found_again(floors, apart):
    frame = Frame(np.array([5.0, -3.0, 100.0]), np.array(floors), apart)
    places = np.random.default_rng(0).uniform((0.0, 0.0, 95.0), (9.0, 9.0, 115.0), (500, 3))
    drawn = frame.to_page(places)
    np.testing.assert_allclose(frame.to_scene(drawn), places, atol=1e-9)
    np.testing.assert_array_equal(drawn[:, :2], places[:, :2] - frame.origin[:2])
    rising = np.argsort(places[:, 2])
    assert (np.diff(drawn[rising, 2]) >= np.diff(places[rising, 2]) - 1e-9).all()  # nothing changes its order
    for storey, floor in enumerate(floors):  # and each floor stands as many gaps over where it is
        at = np.array([0.0, 0.0, 100.0 + floor])
        assert frame.to_page(at)[2] == pytest.approx(floor + storey * apart)


def test_the_things_on_a_floor_go_with_it():
    frame = Frame(floors=np.array([0.0, 2.8]), apart=3.0)
    for floor, lift in ((0.0, 0.0), (2.8, 3.0)):
        heights = np.linspace(floor - 0.2, floor + 1.3, 20)
        np.testing.assert_allclose(frame.lifted_heights(heights) - heights, lift)

"""What strangers can make a service hold, write and wait for."""

import os
import signal
import threading
import time
import tracemalloc
from collections import namedtuple

import msgpack
import numpy as np
import pytest
import zenoh
from gpdf_client import Client, ServiceError
from gpdf_schemas import (
    Array,
    Cylinder,
    MovingObstacle,
    Reply,
    SceneReply,
    ScenesReply,
    Status,
    UpdateRequest,
    UploadRequest,
    decode,
    encode,
    keys,
)

import gpdf_service as gpdf
from gpdf_service.service.evidence import (
    BURST_S,
    MUTED_NAMES,
    MUTED_S,
    OTHERS,
    PICTURE_RATE,
    SHORT_RATE,
    Evidence,
)
from gpdf_service.service.follower import Follower
from gpdf_service.service.handlers import Handlers
from gpdf_service.service.network import session_config
from gpdf_service.service.scenes import NotKeptError, Shelf
from gpdf_service.service.server import Options, Server
from gpdf_service.service.uploads import LEAST_PART

BODY = {"height": 1.0, "width": 0.5, "length": 0.5, "max_step": 0.1, "max_slope": 0.1}
BODY |= {"speed": 1.0, "acceleration": 1.0, "turn_rate": 1.0}
PLAN = {"scene": "floor", "start": [0.5, 1.5], "goal": [2.5, 1.5], "agent": "roomba"}
Disk = namedtuple("Disk", "free")


def floor(width=3.0):
    x, y = np.meshgrid(np.arange(0, width, 0.05), np.arange(0, 3, 0.05))
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])


@pytest.fixture
def shelf(tmp_path):
    made = Shelf(tmp_path, state_dir=tmp_path / "state")
    made.add_part("floor", "u", 0, 1, floor(), None)
    made.settle()
    yield made
    made.close()


@pytest.fixture
def handlers(shelf):
    return Handlers(shelf, "me")


def ask(handlers, key, fields, kind=Reply):
    raw = handlers.answer(key, msgpack.packb(fields), time.monotonic())
    assert len(raw) < 10_000 or fields == PLAN
    return decode(raw, kind)


def test_what_a_request_calls_itself_is_not_kept_by_the_megabyte(handlers):
    assert ask(handlers, keys.PLAN, PLAN | {"request_id": "x" * 256}).status == "OK"
    assert len(handlers.in_use._known) == 1
    for change in ({"request_id": "x" * 4_000_000}, {"agent": BODY | {"name": "x" * 1_000_000}}):
        reply = ask(handlers, keys.PLAN, PLAN | change)
        assert (reply.status, reply.request_id) == ("INVALID_REQUEST", "")
        assert "000 characters" in reply.message
    assert len(handlers.in_use._known) == 1


def test_a_refusal_does_not_say_a_long_request_again(handlers):
    reply = ask(handlers, keys.PLAN, PLAN | {"scene": "\0" * 4_000_000})
    assert reply.status == "UNKNOWN_SCENE"
    assert reply.message.endswith("…")


def test_a_part_whose_reply_was_lost_is_taken_once(handlers, shelf):
    point, gone = Array.pack(np.array([[1.0, 1.0, 0.5]])), Array.pack(np.zeros(1), "f4")
    change = UpdateRequest(scene="floor", upload_id="u", part=0, parts=1, points=point, gone=gone, request_id="r")
    for _ in range(3):
        assert decode(handlers.answer(keys.SCENE_UPDATE, encode(change), time.monotonic()), Reply).status == "BUILDING"
    shelf.settle()
    assert shelf.facts()["floor"]["points"] == len(floor()) + 1
    for part in (0, 1, 1, 0):
        request = UploadRequest(
            scene="x", upload_id="u", part=part, parts=2, points=Array.pack(floor()), request_id=str(part)
        )
        reply = decode(handlers.answer(keys.SCENE_UPLOAD, encode(request), time.monotonic()), SceneReply)
        assert reply.status == ("BUILDING" if part else "OK"), reply.message
    shelf.settle()
    assert shelf.facts()["x"]["version"] == shelf.facts()["floor"]["version"] + 1


def test_a_million_tiny_parts_take_no_more_memory_than_a_large_cloud(tmp_path, monkeypatch):
    monkeypatch.setattr("gpdf_service.service.uploads.MAX_UPLOAD_POINTS", 100_000)
    shelf, taken = Shelf(tmp_path), 100_000 // LEAST_PART
    tracemalloc.start()
    for part in range(taken):
        shelf.add_part("x", "u", part, 100_000, np.zeros((1, 3)), None)
    with pytest.raises(ValueError, match="too small parts"):
        shelf.add_part("x", "u", taken, 100_000, np.zeros((1, 3)), None)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2 * 24 * 100_000
    with pytest.raises(ValueError, match="part 0 comes first"):  # what was too much is let go
        shelf.add_part("x", "u", 1, 2, np.zeros((1, 3)), None)
    before = time.process_time()
    for i in range(2000):  # whoever has sent much does not make each further part slow
        shelf.add_part("x", "v", i, 3000, np.zeros((1, 3)), None)
    assert time.process_time() - before < 0.5
    shelf.close()


def test_changes_that_wait_are_bounded_in_number_too(shelf, monkeypatch):
    monkeypatch.setattr("gpdf_service.service.scenes.MAX_WAITING_POINTS", 5000)
    go_on = threading.Event()
    shelf._builder.submit(go_on.wait, 60)
    one, stays = np.array([[1.0, 1.0, 0.5]]), np.zeros(1, dtype=bool)
    for i in range(5):
        shelf.add_change("floor", str(i), 0, 1, one + 0.01 * i, stays, 0.05)
    with pytest.raises(gpdf.errors.GpdfError, match="faster than they are built"):
        shelf.add_change("floor", "5", 0, 1, one, stays, 0.05)
    go_on.set()
    shelf.settle()
    assert shelf.facts()["floor"]["points"] == len(floor()) + 5


def test_scenes_leave_room_on_the_disk_for_the_log(shelf, tmp_path, monkeypatch):
    version = shelf.facts()["floor"]["version"]
    shelf._spare_bytes = 1e9
    monkeypatch.setattr("gpdf_service.service.scene_files.shutil.disk_usage", lambda _: Disk(1e9 + 1000))
    with pytest.raises(NotKeptError, match=r"1000 MB left, 1000 stay free.*Make room"):
        shelf.add_part("large", "u", 0, 1, floor(), None)
    assert "large" not in shelf.facts()
    free = iter([2e9, 0.5e9])  # what is built of it is larger than what was sent
    monkeypatch.setattr("gpdf_service.service.scene_files.shutil.disk_usage", lambda _: Disk(next(free)))
    shelf.add_part("floor", "v", 0, 1, floor(4.0), None)
    shelf.settle()
    assert "500 MB left" in shelf.trouble
    assert shelf.facts()["floor"]["version"] == version
    assert not list((tmp_path / "state").glob(".*built"))
    monkeypatch.undo()
    monkeypatch.setattr("gpdf_service.service.scenes.time.monotonic", lambda: 1e12)
    shelf.try_again()
    shelf.settle()
    assert (shelf.facts()["floor"]["points"], shelf.trouble) == (len(floor(4.0)), "")


HOUR_S = 3600.0


def hour_of(evidence, clock, one):
    """Bytes that an hour of it adds to a log, `one` after another, twenty times a second."""
    written = 0
    for i in range(3600):
        clock[0] += 1.0
        for _ in range(20):
            found = one(i)
            written += 0 if found is None else sum(map(len, found[1:]))
    return written


@pytest.mark.parametrize("thrifty", [False, True])
def test_small_requests_that_are_answered_do_not_fill_the_disk(thrifty):
    clock, noise = [0.0], np.random.default_rng(0).bytes(1000)
    evidence = Evidence(lambda: clock[0])
    evidence.thrifty = thrifty
    read = hour_of(evidence, clock, lambda i: evidence.of(str(i), keys.SCENE_INFO, Status.OK, noise, noise))
    assert read <= (HOUR_S + BURST_S) * SHORT_RATE
    other = evidence.of("me", keys.SCENE_UNLOAD, Status.OK, b"x", b"y")
    assert other == (keys.SCENE_UNLOAD, b"x", b"y")  # who asks a lot under one key hides nothing of the others
    key = keys.obstacles("floor")
    seen = hour_of(evidence, clock, lambda i: evidence.publication(f"{key}{i}", 5 * noise))
    assert thrifty == (seen <= (HOUR_S + BURST_S) * SHORT_RATE)


def test_names_that_nobody_asked_for_do_not_fill_the_log():
    clock = [0.0]
    evidence = Evidence(lambda: clock[0])
    for i in range(200_000):
        evidence.of(str(i), keys.PLAN, Status.BUSY, b"x", b"no")
    found = evidence.muted()
    assert len(found) == MUTED_NAMES + 1
    assert found[OTHERS] > 100_000
    evidence.publication("x", b"")
    for i in range(10):
        evidence.of(str(i), keys.PLAN, Status.BUSY, b"x", b"no")
    assert evidence.muted() == {}  # not again so soon
    clock[0] = MUTED_S
    assert sum(evidence.muted().values()) == 10


def test_pictures_have_a_rate_of_their_own():
    clock = [0.0]
    evidence = Evidence(lambda: clock[0])
    drawn = 0
    for i in range(36_000):
        clock[0] = 0.1 * i
        if evidence.may_draw:
            evidence.drawn(1_200_000)
            drawn += 1_200_000
    assert drawn < 1.2 * 3600 * PICTURE_RATE
    assert evidence.may_draw or drawn > 0.9 * 3600 * PICTURE_RATE
    evidence.thrifty = True
    assert not evidence.may_draw


def test_a_small_publication_beside_a_large_one_does_not_write_megabytes(tmp_path, free_endpoint):
    gpdf.build_scene(floor()).save(tmp_path / "floor.gpdf")
    crowd = MovingObstacle(id="crowd", points=Array.pack(np.random.default_rng(0).uniform(size=(100_000, 3)), "f4"))
    dot = MovingObstacle(id="dot", cylinder=Cylinder((1.0, 1.0, 0.0), 0.1, 0.1), lifetime_s=60)
    with Server(Options(free_endpoint, tmp_path, tmp_path, 1)) as server, Client.connect(free_endpoint) as client:
        client.load_scene("floor", "floor.gpdf")
        server.recorder.evidence._pictures.charge(PICTURE_RATE * 300)  # the reserve is used up
        client.publish_obstacles("floor", [crowd, dot])
        for _ in range(200):
            client.publish_obstacles("floor", [dot])
        path = server.recorder.path
    assert path.stat().st_size < 10e6  # 240 MB otherwise


def test_a_map_that_talks_nonsense_does_not_end_who_follows_it(tmp_path, free_endpoint):
    good = {"state": "building"}
    said = [{"x": {}}, {"x": {"state": "ready"}}, {"../x": good, "y": good}]

    def answer(query):
        scenes = said[0] if len(said) == 1 else said.pop(0)
        with query:
            query.reply(keys.SCENES, encode(ScenesReply(scenes=scenes)))

    shelf, synced = Shelf(tmp_path, state_dir=tmp_path / "mine"), threading.Event()
    with zenoh.open(session_config(Options(free_endpoint))) as session:
        queryable = session.declare_queryable(keys.SCENES, answer, complete=True)
        follower = Follower(session, shelf, synced.set)
        follower.start()
        until = time.monotonic() + 60
        while not synced.is_set():
            follower._news.set()
            assert time.monotonic() < until
            time.sleep(0.05)
        follower.close()
        queryable.undeclare()
    shelf.close()
    assert follower.absent["y"][0] == "BUILDING"
    assert follower.absent["../x"] == ("UNAVAILABLE", "'../x' is no name of a scene. Ask another planner.")


@pytest.mark.slow
def test_a_build_that_hangs_is_ended_and_the_next_one_is_made(tmp_path, free_endpoint, monkeypatch, office):
    monkeypatch.setattr("gpdf_service.service.builder.STALL_S", 0.5)
    with (
        Server(Options(free_endpoint, tmp_path, tmp_path / "log", 1)) as server,
        Client.connect(free_endpoint) as client,
    ):
        make, told = server._builder.build, threading.Event()

        def build(job, progress):
            def tell(stage, done):
                if not told.is_set():
                    told.set()
                    os.kill(server._builder.pids[0], signal.SIGSTOP)
                progress(stage, done)

            return make(job, tell)

        server.shelf._build = build
        with pytest.raises(ServiceError, match=r"BUILD_FAILED.*hung"):
            client.load_scene("office", upload=office[0].points, timeout_s=120)
        assert client.load_scene("floor", upload=floor(), timeout_s=120)["points"] == len(floor())

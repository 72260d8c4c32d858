"""Plans are made by processes of the service: they die, the service dies, and scenes change under them."""

import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from types import SimpleNamespace

import msgpack
import msgspec
import numpy as np
import psutil
import pytest
import zenoh
from gpdf_client import Client
from gpdf_client.client import client_config
from gpdf_schemas import (
    Array,
    Cylinder,
    DistanceReply,
    DistanceRequest,
    DrawRequest,
    MovingObstacle,
    PlanReply,
    PlanRequest,
    decode,
    encode,
    keys,
)

import gpdf_service as gpdf
import gpdf_service.service.pool as pool_module
from gpdf_service.service.answers import RefusedError
from gpdf_service.service.moving import Living
from gpdf_service.service.plan_process import Desk
from gpdf_service.service.pool import WARM, Ask, Pool, Seen, Settings
from gpdf_service.service.record import check
from gpdf_service.service.replay import recorded_plans
from gpdf_service.service.server import Options, Server

pytestmark = pytest.mark.slow

PATIENCE_S = 300
"""[s] For what must happen at all."""
SETTINGS = Settings(planner="me", memory_bytes=1e9, log_format="text")
PLACES = np.random.default_rng(0).uniform([0.5, 0.5], [5.5, 4.5], (50, 2))


def wait_for(true):
    until = time.monotonic() + PATIENCE_S
    while not (found := true()):
        assert time.monotonic() < until
        time.sleep(0.02)
    return found


@pytest.fixture(scope="module")
def files(tmp_path_factory, office_file):
    folder = tmp_path_factory.mktemp("scenes")
    shutil.copy(office_file, folder / "office.gpdf")
    return folder


@pytest.fixture(scope="module")
def pool():
    made = Pool(2, SETTINGS)
    made.start()
    yield made
    made.close()


def test_a_process_is_told_of_scenes_that_are_gone_only_where_it_knows_what_moved_there(monkeypatch):
    sent = []
    monkeypatch.setattr(pool_module, "Child", lambda *_: SimpleNamespace(pipe=SimpleNamespace(send_bytes=sent.append)))
    pool, living = Pool(1, SETTINGS), {"a": Living(np.zeros((1, 3)), 9.0, 7)}
    process = pool._alive["x"] = pool_module._Process(SETTINGS)

    def told(living):
        process.tell(Ask(keys.PLAN, b"", 0.0, 0.0, "here", "file"), 0.0, living)
        asked = decode(sent[-1], Ask)
        return asked.gone, None if asked.moving is None else len(asked.moving)

    assert told(living) == ([], 1)
    for i in range(100):  # scenes come and go, and nobody plans
        pool.forget(f"there {i}")
        pool.forget("here")
    assert told(living) == (["here"], 1)
    assert told(living) == ([], None)
    assert told({}) == ([], 0)


def distances(pool, file, living=None, deadline_s=PATIENCE_S):
    """What a process says of the obstacle field; None if it cannot read the file."""
    request = DistanceRequest(
        scene="x", field="obstacle", points=Array.pack(PLACES), agent="roomba", deadline_s=deadline_s
    )
    ask = Ask(keys.DISTANCE, encode(request), time.monotonic(), 0.5, "x", str(file))
    found = pool.ask(ask, lambda scene: (time.monotonic(), living or {}), time.monotonic() + deadline_s)
    return decode(found, DistanceReply) if found else None


def test_a_process_answers_as_we_would(pool, files, office):
    reply = distances(pool, files / "office.gpdf")
    here = office[1].obstacle_field("roomba").query(PLACES)
    assert (reply.status, reply.planner, reply.load) == ("OK", "me", 0.5)
    np.testing.assert_array_equal(reply.distance.unpack(), here.distance)


def test_what_moves_is_known_to_every_process_and_ends_there_too(pool, files):
    before = distances(pool, files / "office.gpdf").distance.unpack()
    pillar = PLACES[0] + np.random.default_rng(1).uniform(-0.05, 0.05, (50, 2))
    points = np.column_stack([pillar, np.linspace(0, 1, 50)])
    living = {"a": Living(points, time.monotonic() + 3600, 7)}
    for _ in range(4):  # whichever of the two is asked, told of it now or before
        assert distances(pool, files / "office.gpdf", living).distance.unpack()[0] < 0.05 < before[0]
    for _ in range(4):
        np.testing.assert_array_equal(distances(pool, files / "office.gpdf").distance.unpack(), before)


def test_a_scene_of_the_same_name_in_another_file_is_another_scene(pool, files, tmp_path):
    x, y = np.meshgrid(np.arange(0, 6, 0.05), np.arange(0, 5, 0.05))
    bare = gpdf.build_scene(np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]))
    bare.version = 9
    bare.save(tmp_path / "x@9.gpdf")
    assert distances(pool, files / "office.gpdf").scene_version != 9
    for _ in range(2):
        assert distances(pool, tmp_path / "x@9.gpdf").scene_version == 9


def test_a_file_that_is_not_there_or_damaged_is_told(pool, files, tmp_path):
    (tmp_path / "bad.gpdf").write_bytes(b"damaged")
    assert distances(pool, tmp_path / "bad.gpdf") is None
    assert distances(pool, tmp_path / "none.gpdf") is None
    assert distances(pool, files / "office.gpdf").status == "OK"


def test_a_process_that_is_killed_is_begun_anew(pool, files):
    distances(pool, files / "office.gpdf")
    wait_for(lambda: len(pool.pids) == 2)
    before, restarts = pool.pids, pool.restarts
    for pid in before:
        os.kill(pid, signal.SIGKILL)
    assert distances(pool, files / "office.gpdf").status == "OK"
    wait_for(lambda: len(pool.pids) == 2 and not set(pool.pids) & set(before))
    assert pool.restarts == restarts + 2


def test_processes_that_died_while_they_waited_are_not_blamed_on_the_next_request(pool, files, monkeypatch):
    monkeypatch.setattr("gpdf_service.service.pool.TRIES", 1)
    wait_for(lambda: len(pool.pids) == 2 and pool.idle == 2)
    before = pool.pids
    for pid in before:
        os.kill(pid, signal.SIGKILL)
    wait_for(lambda: not set(pool.pids) & set(before))
    assert distances(pool, files / "office.gpdf").status == "OK"


def test_what_moves_is_known_to_the_processes_that_come_after_those_that_died(pool, files):
    pillar = np.column_stack([np.tile(PLACES[0], (20, 1)), np.linspace(0, 1, 20)])
    living = {"a": Living(pillar, time.monotonic() + 3600, 8)}
    wait_for(lambda: len(pool.pids) == 2)
    for pid in pool.pids:
        os.kill(pid, signal.SIGKILL)
    for _ in range(4):
        assert distances(pool, files / "office.gpdf", living).distance.unpack()[0] < 0.05


def test_a_process_that_hangs_is_ended_and_its_request_goes_to_another(pool, files):
    wait_for(lambda: len(pool.pids) == 2 and pool.idle == 2)
    before = pool.pids
    for pid in before:
        os.kill(pid, signal.SIGSTOP)
    assert distances(pool, files / "office.gpdf").status == "OK"
    wait_for(lambda: len(pool.pids) == 2 and not set(pool.pids) & set(before))


def test_a_request_that_no_process_takes_in_time_is_refused(files):
    nobody = Pool(1, SETTINGS)
    with pytest.raises(RefusedError, match="no process was free") as refused:
        distances(nobody, files / "office.gpdf", deadline_s=0.1)
    assert refused.value.status == "TIMEOUT"
    nobody.close()


def test_a_deadline_beyond_what_the_system_can_wait_is_a_deadline(pool, files):
    assert distances(pool, files / "office.gpdf", deadline_s=1e308).status == "OK"


def test_a_closed_pool_leaves_no_process(files):
    made = Pool(1, SETTINGS)
    made.start()
    distances(made, files / "office.gpdf")
    (pid,) = made.pids
    made.close()
    assert not psutil.pid_exists(pid)


def test_a_process_lets_go_of_a_scene_whose_file_is_gone(files, tmp_path, monkeypatch):
    monkeypatch.setattr("gpdf_service.service.plan_process.TIDY_S", 0.0)
    desk, file = Desk(SETTINGS), tmp_path / "x@1.gpdf"
    file.write_bytes((files / "office.gpdf").read_bytes())
    request = encode(DistanceRequest(scene="x", field="obstacle", points=Array.pack(PLACES), agent="roomba"))
    ask = Ask(keys.DISTANCE, request, time.monotonic(), 0.0, "x", str(file))
    assert decode(desk.answer(ask), DistanceReply).status == "OK"
    desk.tidy()
    assert desk.scenes == ["x"]
    file.unlink()
    assert decode(desk.answer(ask), DistanceReply).status == "OK"  # it is in memory
    desk.tidy()
    assert desk.scenes == []
    assert desk.answer(ask) == b""


DRAWN = encode(DrawRequest(scene="x", what="leaves", agent="human", limit=1))


@pytest.mark.parametrize(("bodies", "drawn"), [(("human",), b""), ((), DRAWN)])
def test_the_first_plan_of_a_configured_or_drawn_body_finds_all_that_it_needs(
    files, office, monkeypatch, bodies, drawn
):
    desk, file = Desk(msgspec.structs.replace(SETTINGS, bodies=bodies)), str(files / "office.gpdf")
    desk.answer(Ask(WARM, drawn, time.monotonic(), 0.0, "x", file))
    built = []
    for name in ("build_free_space", "find_ways"):
        monkeypatch.setattr(f"gpdf_service.scene.{name}", lambda *_, name=name, **__: built.append(name))
    made = office[0]
    request = encode(PlanRequest(scene="x", start=list(made.start), goal=list(made.goal), agent="human"))
    reply = decode(desk.answer(Ask(keys.PLAN, request, time.monotonic(), 0.0, "x", file)), PlanReply)
    assert (reply.status, built) == ("OK", [])


def test_each_process_makes_ready_for_the_body_that_somebody_draws(files, free_endpoint, tmp_path):
    """What is ready when the drawing is there: both processes have worked as long as a free space takes."""
    shutil.copy(files / "office.gpdf", tmp_path / "office.gpdf")
    options = Options(free_endpoint, tmp_path, tmp_path / "log", 2, bodies=())
    with Server(options, [("office", tmp_path / "office.gpdf")]) as server, Client.connect(free_endpoint) as client:
        server.shelf.settle()
        wait_for(lambda: server.status().ready)
        planners = [psutil.Process(pid) for pid in server.processes]
        assert len(planners) == 2

        def worked():
            return np.array([sum(one.cpu_times()[:2]) for one in planners])

        idle = worked()
        client.draw("office", "leaves", "human", limit=1)
        made = worked()
        client.draw("office", "leaves", "human", limit=1)
        again = worked()
        assert ((made - idle) > 5.0 * (again - made)).all()


def test_a_new_version_of_a_scene_does_not_make_a_process_forget_what_moves_in_it(files, tmp_path, monkeypatch):
    monkeypatch.setattr("gpdf_service.service.plan_process.TIDY_S", 0.0)
    desk, first, second = Desk(SETTINGS), tmp_path / "x@1.gpdf", tmp_path / "x@2.gpdf"
    for file in (first, second):
        file.write_bytes((files / "office.gpdf").read_bytes())
    request = encode(DistanceRequest(scene="x", field="obstacle", points=Array.pack(PLACES), agent="roomba"))
    box = Seen(
        "box", Array.pack(np.array([[*PLACES[0], z] for z in np.linspace(0, 1, 30)])), time.monotonic() + 3600, 1
    )

    def distance(file, moving):
        ask = Ask(keys.DISTANCE, request, time.monotonic(), 0.0, "x", str(file), moving)
        return decode(desk.answer(ask), DistanceReply).distance.unpack()[0]

    before = distance(first, None)
    assert distance(first, [box]) < 0.05 < before
    first.unlink()
    desk.tidy()
    assert distance(second, None) < 0.05  # "as before", says the service, and so it is


def test_a_process_knows_what_was_there_when_the_service_looked_whatever_has_ended_since(files):
    desk, file = Desk(SETTINGS), str(files / "office.gpdf")
    request = encode(DistanceRequest(scene="x", field="obstacle", points=Array.pack(PLACES), agent="roomba"))
    pillar = Array.pack(np.array([[*PLACES[0], z] for z in np.linspace(0, 1, 30)]))
    looked = time.monotonic() - 10.0

    def distance(ends):
        ask = Ask(keys.DISTANCE, request, looked, 0.0, "x", file, [Seen("box", pillar, ends, 1)], looked)
        return decode(desk.answer(ask), DistanceReply).distance.unpack()[0]

    assert distance(looked + 5.0) < 0.05 < distance(looked - 5.0)


def plain_plans(endpoint, made, done, seen):
    """Plans by Zenoh alone, on the key of all planners, asked once each: nobody tries again for this client."""
    ask = {
        "scene": "office",
        "start": list(map(float, made.start)),
        "goal": list(map(float, made.goal)),
        "agent": "roomba",
    }
    with zenoh.open(client_config(endpoint)) as session:
        while not done.is_set():
            answers = list(session.get(keys.PLAN, payload=msgpack.packb(ask), timeout=PATIENCE_S))
            seen.extend(msgpack.unpackb(answer.ok.payload.to_bytes())["status"] for answer in answers if answer.ok)
            if not answers:
                seen.append("nobody")


def test_a_process_dies_under_load_and_not_even_a_client_that_asks_once_sees_it(files, tmp_path, free_endpoint, office):
    done, seen = threading.Event(), []
    with Server(Options(free_endpoint, files, tmp_path, 2)) as server:
        with Client.connect(free_endpoint) as client:
            client.load_scene("office", "office.gpdf")
        args = free_endpoint, office[0], done, seen
        clients = [threading.Thread(target=plain_plans, args=args) for _ in range(3)]
        for thread in clients:
            thread.start()
        for _ in range(2):
            enough = len(seen) + 20
            wait_for(lambda enough=enough: len(seen) > enough)
            victim = server.processes[0]
            os.kill(victim, signal.SIGKILL)
            wait_for(lambda victim=victim: len(server.processes) == 2 and victim not in server.processes)
        enough = len(seen) + 20
        wait_for(lambda: len(seen) > enough)
        done.set()
        for thread in clients:
            thread.join(PATIENCE_S)
        assert server.status().metrics["process_restarts"] == 2
    assert set(seen) == {"OK"}
    assert len(list(recorded_plans(server.recorder.path))) == len(seen)  # each once


def test_a_trajectory_of_a_process_is_told_when_it_is_cut(files, tmp_path, free_endpoint, office):
    made, cuts = office[0], []
    with Server(Options(free_endpoint, files, tmp_path, 2)), Client.connect(free_endpoint) as client:
        client.load_scene("office", "office.gpdf")
        client.watch_cuts("office", cuts.append)
        path = client.plan("office", made.start, made.goal, "roomba", request_id="mine").trajectory
        x, y, z = path.ground[len(path.ground) // 2]
        client.publish_obstacles(
            "office", [MovingObstacle(id="box", cylinder=Cylinder((x, y, z), 0.2, 1.0), lifetime_s=600)]
        )
        cut = wait_for(lambda: cuts and cuts[0])
        assert (cut.request_id, cut.obstacles) == ("mine", ["box"])
        round_it = client.plan("office", made.start, made.goal, "roomba")
        assert round_it.status == "OK"
        assert np.linalg.norm(round_it.trajectory.ground[:, :2] - (x, y), axis=1).min() > 0.2


@pytest.fixture
def process(files, tmp_path, free_endpoint):
    words = ["-m", "gpdf_service.cli", "serve", f"office={files / 'office.gpdf'}", "--workers", "2"]
    words += ["--endpoint", free_endpoint, "--log-dir", str(tmp_path / "log"), "--scenes-dir", str(files)]
    with subprocess.Popen([sys.executable, *words]) as running:
        with Client.connect(free_endpoint, timeout_s=PATIENCE_S) as client:
            client.wait_for_scene("office")
            everybody = psutil.Process(running.pid)
            wait_for(lambda: client.status()[0].ready and len(everybody.children(recursive=True)) == 4)
        yield running
        running.kill()


def test_a_service_that_is_killed_leaves_no_process_behind(process):
    children = psutil.Process(process.pid).children(recursive=True)
    assert [one.name() for one in psutil.Process(process.pid).children()] == ["nursery"]
    assert "serve" in children[0].cmdline()  # a fork of the service
    process.kill()
    assert psutil.wait_procs(children, PATIENCE_S)[1] == []


def test_a_manager_that_ends_every_process_at_once_gets_a_graceful_end(process, free_endpoint, tmp_path, office):
    """systemd sends SIGTERM to all of them."""
    made, statuses = office[0], []
    children = psutil.Process(process.pid).children(recursive=True)
    with Client.connect(free_endpoint) as client:
        asks = [
            threading.Thread(target=lambda: statuses.append(client.plan("office", made.start, made.goal).status))
            for _ in range(4)
        ]
        for thread in asks:
            thread.start()
        wait_for(lambda: statuses)
        for one in (*children, process):
            one.send_signal(signal.SIGTERM)
        assert process.wait(PATIENCE_S) == 0
    assert psutil.wait_procs(children, PATIENCE_S)[1] == []
    (log,) = (tmp_path / "log").glob("*.mcap")
    assert check(log).complete
    assert statuses[0] == "OK"

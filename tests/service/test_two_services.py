"""Map service and planners as processes of their own; planners die under load."""

import os
import resource
import shutil
import signal
import subprocess
import sys
import threading
import time
from contextlib import ExitStack, contextmanager

import numpy as np
import pytest
from gpdf_client import Client, ServiceError, UnknownSceneError
from gpdf_client.results import UnavailableError
from gpdf_schemas import LoadRequest, SceneReply, Status, keys

from gpdf_service import ports
from gpdf_service.service.server import Options, Server

pytestmark = pytest.mark.slow
PATIENCE_S = 300.0
"""[s] For what must happen at all."""


@contextmanager
def serving(*flags, before=None):
    words = [sys.executable, "-m", "gpdf_service.cli", "serve", *map(str, flags)]
    with subprocess.Popen(words, preexec_fn=before) as process:
        try:
            yield process
        finally:
            process.send_signal(signal.SIGCONT)
            process.kill()


def freeze(process):
    """Stop all its threads; a signal alone lets them run until one of them has taken it."""
    process.send_signal(signal.SIGSTOP)
    os.waitid(os.P_PID, process.pid, os.WSTOPPED)


def map_flags(folder, endpoint):
    return "--map", "--endpoint", endpoint, "--scenes-dir", folder, "--log-dir", folder / "map"


def planner_flags(folder, endpoint, name):
    return "--planner", "--endpoint", "", "--connect", endpoint, "--log-dir", folder / name, "--workers", "1"


@pytest.fixture
def folder(tmp_path, office_file):
    shutil.copy(office_file, tmp_path / "office.gpdf")
    return tmp_path


def wait_for_planners(client, count):
    until = time.monotonic() + PATIENCE_S
    while len(client._planners.alive()) != count:
        assert time.monotonic() < until
        time.sleep(0.02)


def until_ready(server):
    until = time.monotonic() + PATIENCE_S
    while not server.status().ready:
        assert time.monotonic() < until
        time.sleep(0.02)


def test_one_of_two_planners_is_killed_under_load_and_no_client_sees_a_failed_plan(folder, free_endpoint, office):
    made = office[0]
    with ExitStack() as stack:
        stack.enter_context(serving(*map_flags(folder, free_endpoint)))
        planners = [stack.enter_context(serving(*planner_flags(folder, free_endpoint, name))) for name in ("a", "b")]
        client = stack.enter_context(Client.connect(free_endpoint, timeout_s=60))
        client.load_scene("office", "office.gpdf")
        wait_for_planners(client, 2)
        results, done, lock = [], threading.Event(), threading.Lock()

        def plan_on():
            with Client.connect(free_endpoint) as mine:
                wait_for_planners(mine, 2)
                while not done.is_set():
                    result = mine.plan("office", made.start, made.goal, "roomba")
                    with lock:
                        results.append((result.status, result.planner))

        threads = [threading.Thread(target=plan_on) for _ in range(4)]
        for thread in threads:
            thread.start()

        def wait_for(count, who):
            until = time.monotonic() + PATIENCE_S
            while len({planner for _, planner in results[-50:]}) != who or len(results) < count:
                assert time.monotonic() < until
                time.sleep(0.02)

        wait_for(50, 2)  # both plan
        os.kill(planners[0].pid, signal.SIGKILL)
        wait_for(len(results) + 100, 1)
        done.set()
        for thread in threads:
            thread.join(60)
        assert not any(thread.is_alive() for thread in threads)
        assert {status for status, _ in results} == {"OK"}
        wait_for_planners(client, 1)


def test_a_frozen_planner_is_passed_over_and_a_deadline_with_all_frozen_is_told_as_that(
    folder, free_endpoint, office, monkeypatch
):
    monkeypatch.setattr("gpdf_client.client.TRY_S", 0.5)
    made = office[0]
    with ExitStack() as stack:
        stack.enter_context(serving(*map_flags(folder, free_endpoint)))
        planners = [stack.enter_context(serving(*planner_flags(folder, free_endpoint, name))) for name in ("a", "b")]
        client = stack.enter_context(Client.connect(free_endpoint, timeout_s=60))
        client.load_scene("office", "office.gpdf")
        wait_for_planners(client, 2)
        for _ in range(4):
            client.plan("office", made.start, made.goal, "roomba")
        freeze(planners[0])
        for _ in range(10):
            assert client.plan("office", made.start, made.goal, "roomba").status == "OK"
        wait_for_planners(client, 1)  # the lease is over
        freeze(planners[1])
        with pytest.raises(UnavailableError, match=r"did not answer.*0\.5 s\. Give it more time"):
            client.plan("office", made.start, made.goal, "roomba", deadline_s=0.5)


def test_a_planner_follows_the_map(folder, free_endpoint, office, tmp_path):
    made, scene = office
    floor = made.points[made.ground]
    map_options = Options(free_endpoint, folder, tmp_path / "map", 1, role="map")
    planner_options = Options("", folder, tmp_path / "planner", 1, role="planner", connect=(free_endpoint,))
    with Server(map_options, [("office", folder / "office.gpdf")]), Client.connect(free_endpoint) as client:
        client.wait_for_scene("office")
        with Server(planner_options) as planner:
            result = client.plan("office", made.start, made.goal, "roomba")
            assert result.status == "OK"
            assert result.planner == planner.planner_id
            assert result.scene_version == client.info("office")["version"]
            points = np.random.default_rng(0).uniform([0, 0, 0], [6, 5, 2], (50, 3))
            far, here = client.distance("office", "ground", points), scene.ground_field.query(points)
            np.testing.assert_array_equal(far.distance, here.distance)

            version = client.load_scene("office", upload=floor, ground=np.ones(len(floor), bool))["version"]
            until = time.monotonic() + PATIENCE_S
            while client.plan("office", made.start, made.goal, "roomba").scene_version != version:
                assert time.monotonic() < until
            client.load_scene("other", upload=floor, ground=np.ones(len(floor), bool))
            assert client.plan("other", made.start, made.goal, "roomba").status == "OK"  # asked for at once, fetched

            client.unload_scene("other")
            while "other" in planner.shelf.facts():
                assert time.monotonic() < until
                time.sleep(0.01)
            with pytest.raises(UnknownSceneError):
                client.plan("other", made.start, made.goal)
            while not all(reply.ready for reply in client.status()):
                assert time.monotonic() < until
                time.sleep(0.05)
            services = {reply.role: reply for reply in client.status()}
            assert set(services) == {"map", "planner"}
            assert all(reply.healthy and reply.ready and not reply.problems for reply in services.values())
            files = [path.name for path in (tmp_path / "planner" / "planner").glob("*@*")]
            assert files == [f"office@{version}.gpdf"]
        with Server(planner_options) as planner:  # it comes back with what it had; nothing is fetched again
            stamp = (tmp_path / "planner" / "planner" / files[0]).stat().st_mtime_ns
            assert client.plan("office", made.start, made.goal, "roomba").planner == planner.planner_id
            assert (tmp_path / "planner" / "planner" / files[0]).stat().st_mtime_ns == stamp


def test_a_planner_whose_map_is_gone_plans_on_and_says_so(folder, free_endpoint, office, tmp_path, monkeypatch):
    monkeypatch.setattr("gpdf_service.service.follower.RESYNC_S", 0.1)
    monkeypatch.setattr("gpdf_service.service.follower.ASK_S", 0.3)
    made = office[0]
    other = ports.free_endpoint()
    map_options = Options(free_endpoint, folder, tmp_path / "map", 1, role="map")
    planner_options = Options(other, folder, tmp_path / "planner", 1, role="planner", connect=(free_endpoint,))
    with Server(planner_options) as planner, Client.connect(other) as client:
        with Server(map_options, [("office", folder / "office.gpdf")]):
            until = time.monotonic() + PATIENCE_S
            while "office" not in planner.shelf.facts():
                assert time.monotonic() < until
                time.sleep(0.02)
        assert client.plan("office", made.start, made.goal, "roomba").status == "OK"
        while not planner.status().problems:
            assert time.monotonic() < until
            time.sleep(0.02)
        assert "stale" in planner.status().problems[0]
        assert client.plan("office", made.start, made.goal, "roomba").status == "OK"


def test_a_map_service_that_was_killed_is_found_again_by_planners_and_clients(folder, free_endpoint, office):
    made = office[0]
    with ExitStack() as stack:
        first = stack.enter_context(serving(*map_flags(folder, free_endpoint)))
        stack.enter_context(serving(*planner_flags(folder, free_endpoint, "a")))
        client = stack.enter_context(Client.connect(free_endpoint, timeout_s=60))
        version = client.load_scene("office", "office.gpdf")["version"]
        wait_for_planners(client, 1)
        assert client.plan("office", made.start, made.goal, "roomba").status == "OK"
        first.kill()
        first.wait(30)
        stack.enter_context(serving(*map_flags(folder, free_endpoint)))
        result = client.plan("office", made.start, made.goal, "roomba", deadline_s=60)
        assert (result.status, result.scene_version) == ("OK", version)
        floor = made.points[made.ground]
        client.load_scene("office", upload=floor, ground=np.ones(len(floor), bool), timeout_s=60)
        until = time.monotonic() + PATIENCE_S
        while client.plan("office", made.start, made.goal, "roomba").scene_version == version:
            assert time.monotonic() < until
            time.sleep(0.05)


def test_a_planner_that_cannot_keep_a_scene_of_the_map_says_so_and_is_not_ready(folder, free_endpoint, office):
    made = office[0]

    def full():
        resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, 50_000))  # a write beyond it fails as on a full disk

    with ExitStack() as stack:
        stack.enter_context(serving(*map_flags(folder, free_endpoint)))
        stack.enter_context(serving(*planner_flags(folder, free_endpoint, "a"), before=full))
        client = stack.enter_context(Client.connect(free_endpoint, timeout_s=60))
        client.load_scene("office", "office.gpdf")
        wait_for_planners(client, 1)
        until = time.monotonic() + PATIENCE_S
        while (planner := next(one for one in client.status() if one.role == "planner")).healthy:
            assert time.monotonic() < until
            time.sleep(0.05)
        assert (planner.state, planner.ready) == ("warming", False)
        assert any("'office': it cannot be kept (File too large)" in problem for problem in planner.problems)
        with pytest.raises(UnavailableError, match=r"'office': it cannot be kept.*Ask another planner"):
            client.plan("office", made.start, made.goal, "roomba", deadline_s=5.0)
        client.unload_scene("office")
        while not (planner := next(one for one in client.status() if one.role == "planner")).healthy:
            assert time.monotonic() < until
            time.sleep(0.05)
        with pytest.raises(UnknownSceneError):
            client.plan("office", made.start, made.goal, "roomba")


def test_a_planner_tells_of_what_the_map_builds_and_of_what_it_cannot_build(folder, free_endpoint, office, tmp_path):
    made, gate = office[0], threading.Event()
    map_options = Options(free_endpoint, folder, tmp_path / "map", 1, role="map")
    planner_options = Options("", folder, tmp_path / "planner", 1, role="planner", connect=(free_endpoint,))
    with Server(map_options) as server, Server(planner_options) as planner, Client.connect(free_endpoint) as client:
        build = server.shelf._build

        def held(job, progress):
            gate.wait(PATIENCE_S)
            return build(job, progress)

        server.shelf._build = held
        wait_for_planners(client, 1)
        until_ready(planner)
        (folder / "bad.npz").write_bytes(b"no cloud")
        for file in ("office.gpdf", "bad.npz"):
            client.ask(
                keys.SCENE_LOAD, LoadRequest(scene=file[:3], file=file), SceneReply, PATIENCE_S, {Status.BUILDING}
            )
        with pytest.raises(ServiceError, match="BUILDING"):
            client.plan("off", made.start, made.goal, "roomba")
        assert server.status().ready
        assert planner.status().ready
        gate.set()
        client.wait_for_scene("off", timeout_s=PATIENCE_S)
        assert client.plan("off", made.start, made.goal, "roomba").status == "OK"
        server.shelf.settle()
        with pytest.raises(ServiceError, match=r"BUILD_FAILED.*bad\.npz"):
            client.plan("bad", made.start, made.goal, "roomba")
        assert planner.status().ready  # what cannot be built stands in nobody's way


def test_a_planner_that_begins_while_the_map_builds_its_first_scene_is_not_ready_before_it(
    folder, free_endpoint, tmp_path
):
    gate = threading.Event()
    map_options = Options(free_endpoint, folder, tmp_path / "map", 1, role="map")
    planner_options = Options("", folder, tmp_path / "planner", 1, role="planner", connect=(free_endpoint,))
    server = Server(map_options, [("office", folder / "office.gpdf")])
    build = server.shelf._build

    def held(job, progress):
        gate.wait(PATIENCE_S)
        return build(job, progress)

    server.shelf._build = held
    with server, Server(planner_options) as planner, Client.connect(free_endpoint) as client:
        wait_for_planners(client, 1)
        planner._warmer.join()
        assert (planner.status().state, planner.status().ready) == ("warming", False)
        gate.set()
        until_ready(planner)
        assert list(planner.shelf.facts()) == ["office"]

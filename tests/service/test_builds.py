"""Builds are made by a process of their own, in bounded memory; what was acknowledged outlives a kill."""

import os
import resource
import signal
import subprocess
import sys
import threading
import time
from multiprocessing import Pipe

import msgpack
import msgspec
import numpy as np
import pytest
import zenoh
from gpdf_client import Client, ServiceError
from gpdf_client.results import ClientError
from gpdf_schemas import Array, SceneReply, Status, UploadRequest, keys

import gpdf_service as gpdf
from gpdf_service.config import Config, PerceptionConfig
from gpdf_service.service import build_process
from gpdf_service.service.journal import Journal
from gpdf_service.service.network import session_config
from gpdf_service.service.scenes import NotKeptError, Shelf
from gpdf_service.service.server import Options, Server
from gpdf_service.service.workshop import BuildError, Job, Workshop

PATIENCE_S = 300.0
FAR_APART = np.array([[0, 0, 0], [4900, 0, 0], [0, 4900, 0], [4900, 4900, 0.0]])
"""96 bytes whose grid is gigabytes, if somebody makes one."""


def floor(width):
    x, y = np.meshgrid(np.arange(0, width, 0.05), np.arange(0, 3, 0.05))
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])


@pytest.mark.slow
def test_a_cloud_that_would_take_all_memory_is_refused_in_words_and_others_are_served(tmp_path, free_endpoint):
    gpdf.build_scene(floor(3.0)).save(tmp_path / "room.gpdf")
    options = Options(free_endpoint, tmp_path, tmp_path / "log", 1, build_memory_mb=700.0)
    with Server(options) as server, Client.connect(free_endpoint) as client:
        client.load_scene("room", "room.gpdf", timeout_s=PATIENCE_S)
        before = server.metrics.numbers()["memory_bytes"]
        with pytest.raises(ServiceError, match=r"BUILD_FAILED.*(metres|unit|thin)"):
            client.load_scene("far", upload=FAR_APART, timeout_s=PATIENCE_S)
        assert server.metrics.numbers()["memory_bytes"] - before < 200e6
        assert client.plan("room", (0.5, 1.5), (2.0, 1.5), "roomba").status == "OK"
        assert client.load_scene("more", upload=floor(4.0), timeout_s=PATIENCE_S)["points"] == len(floor(4.0))


@pytest.mark.slow
def test_what_nobody_reckoned_is_ended_by_the_limit_of_the_process_that_builds(tmp_path, free_endpoint):
    options = Options(free_endpoint, tmp_path, tmp_path / "log", 1, build_memory_mb=700.0)
    config = Config(PerceptionConfig(memory_budget=1e12))  # whatever is asked for may be taken
    with Server(options, config=config), Client.connect(free_endpoint) as client:
        with pytest.raises(ServiceError, match=r"BUILD_FAILED.*700 MB.*--build-memory-mb.*metres"):
            client.load_scene("far", upload=FAR_APART, timeout_s=PATIENCE_S)
        assert client.load_scene("floor", upload=floor(3.0), timeout_s=PATIENCE_S)["points"] == len(floor(3.0))


@pytest.mark.slow
def test_a_build_that_is_killed_is_told_in_words_and_the_next_one_is_made(tmp_path, free_endpoint, office):
    with (
        Server(Options(free_endpoint, tmp_path, tmp_path / "log", 1)) as server,
        Client.connect(free_endpoint) as client,
    ):
        told = threading.Event()
        make = server._builder.build

        def build(job, progress):
            def tell(stage, done):
                if not told.is_set():  # it builds
                    told.set()
                    os.kill(server._builder.pids[0], signal.SIGKILL)
                progress(stage, done)

            return make(job, tell)

        server.shelf._build = build
        with pytest.raises(ServiceError, match=r"BUILD_FAILED.*SIGKILL.*--build-memory-mb"):
            client.load_scene("office", upload=office[0].points, timeout_s=PATIENCE_S)
        assert client.load_scene("floor", upload=floor(3.0), timeout_s=PATIENCE_S)["version"] > 1


def test_a_build_whose_service_has_gone_ends_without_a_complaint(tmp_path, caplog):
    np.savez(tmp_path / "floor.npz", xyz=floor(3.0))
    ours, theirs = Pipe()
    job = Job("floor", 1, str(tmp_path), file=str(tmp_path / "floor.npz"))
    ours.send_bytes(msgspec.json.encode(job))
    ours.close()
    build_process.serve(theirs, Workshop(), 10**9)
    assert caplog.records == []


def test_who_builds_forgets_scenes_that_are_unloaded_or_replaced(tmp_path):
    workshop = Workshop()
    shelf = Shelf(tmp_path, state_dir=tmp_path / "state", build=workshop.build)

    def held_with(*names):
        for name in names:
            shelf.add_part(name, "u", 0, 1, floor(3.0), None)
            shelf.settle()
        workshop.forget_gone()
        return workshop.held

    one = held_with("a")
    assert 0 < one < 1.1 * held_with("a", "a") < 1.3 * one
    assert held_with("b", "c") > 2.5 * one
    for name in "abc":
        shelf.unload(name)
    assert held_with() == 0
    shelf.close()


def test_who_builds_forgets_them_while_there_is_nothing_to_build(monkeypatch):
    monkeypatch.setattr("gpdf_service.service.build_process.TIDY_S", 0.01)
    (ours, theirs), forgot = Pipe(), threading.Event()
    monkeypatch.setattr(Workshop, "forget_gone", lambda _: forgot.set())
    builder = threading.Thread(target=build_process.serve, args=(theirs, Workshop(), 10**9))
    builder.start()
    did = forgot.wait(30)
    ours.close()
    builder.join(30)
    assert did
    assert not builder.is_alive()


def send(client, scene, points):
    """An upload that is acknowledged, and no more."""
    request = UploadRequest(scene=scene, upload_id="u", part=0, parts=1, points=Array.pack(points))
    return client.ask(keys.SCENE_UPLOAD, request, SceneReply, 60.0, {Status.BUILDING}).status


@pytest.mark.slow
def test_what_was_acknowledged_is_built_after_a_kill(tmp_path, free_endpoint):
    def serve():
        words = [sys.executable, "-m", "gpdf_service.cli", "serve", "--endpoint", free_endpoint, "--workers", "1"]
        return subprocess.Popen([*words, "--log-dir", str(tmp_path), "--scenes-dir", str(tmp_path)])

    gpdf.build_scene(floor(3.0)).save(tmp_path / "file.gpdf")
    with serve() as process:
        try:
            with Client.connect(free_endpoint, timeout_s=PATIENCE_S) as client:
                base = client.load_scene("base", upload=floor(3.0), timeout_s=PATIENCE_S)
                for i in range(3):
                    assert send(client, f"up{i}", floor(3.0 + i)) == "BUILDING"
                for i in range(3):
                    client.update_scene("base", np.array([[1.0, 1.0, 0.5 + 0.1 * i]]), wait=False)
                process.kill()
        finally:
            process.kill()
    with serve() as process:
        try:
            with Client.connect(free_endpoint, timeout_s=PATIENCE_S) as client:
                for i in range(3):
                    found = client.wait_for_scene(f"up{i}", timeout_s=PATIENCE_S)
                    assert found["points"] == len(floor(3.0 + i))
                found = client.wait_for_scene("base", timeout_s=PATIENCE_S)
                assert found["points"] == base["points"] + 3  # each once
                assert found["version"] > base["version"]
        finally:
            process.kill()
    assert not list((tmp_path / "state" / "journal").iterdir())


def test_a_change_that_is_in_a_version_on_the_disk_is_not_made_again(tmp_path):
    shelf = Shelf(tmp_path, state_dir=tmp_path / "state")
    shelf.add_part("x", "u", 0, 1, floor(3.0), None)
    shelf.settle()
    shelf.journal.done = lambda task: None  # killed between the two
    shelf.add_change("x", "c", 0, 1, np.array([[1.0, 1.0, 0.5]]), np.zeros(1, dtype=bool), 0.05)
    shelf.settle()
    facts = shelf.facts()["x"]
    shelf.close()
    assert len(list((tmp_path / "state" / "journal").iterdir())) == 1
    again = Shelf(tmp_path, state_dir=tmp_path / "state")
    again.restore()
    again.settle()
    assert (again.facts()["x"]["points"], again.facts()["x"]["version"]) == (facts["points"], facts["version"])
    assert not list((tmp_path / "state" / "journal").iterdir())
    again.close()


class FullDisk:
    """A workshop that cannot keep what it builds while `full`."""

    def __init__(self):
        self._workshop, self.full = Workshop(), False

    def build(self, job, progress):
        if self.full:
            raise NotKeptError("it cannot be kept (no space)")
        return self._workshop.build(job, progress)


def change(shelf, height):
    shelf.add_change("x", "c", 0, 1, np.array([[1.0, 1.0, height]]), np.zeros(1, dtype=bool), 0.05)


@pytest.mark.parametrize("then", ["change", "cloud", "nothing"])
def test_a_change_that_the_disk_did_not_take_is_in_the_version_after_it(tmp_path, monkeypatch, then):
    disk = FullDisk()
    shelf = Shelf(tmp_path, state_dir=tmp_path / "state", build=disk.build)
    shelf.add_part("x", "u", 0, 1, floor(3.0), None)
    shelf.settle()
    disk.full = True
    change(shelf, 0.5)
    shelf.settle()
    assert "cannot be kept" in shelf.trouble
    shelf.try_again()  # not so soon
    shelf.settle()
    assert len(shelf.get("x").waiting) == 1
    disk.full = False
    if then == "change":
        change(shelf, 0.7)
    elif then == "cloud":
        shelf.add_part("x", "v", 0, 1, floor(4.0), None)
    else:
        monkeypatch.setattr("gpdf_service.service.scenes.time.monotonic", lambda: 1e12)
        shelf.try_again()
    for _ in range(3):
        shelf.settle()
    points = {"change": len(floor(3.0)) + 2, "cloud": len(floor(4.0)), "nothing": len(floor(3.0)) + 1}[then]
    assert (shelf.facts()["x"]["points"], shelf.trouble) == (points, "")
    assert not list((tmp_path / "state" / "journal").iterdir())
    shelf.close()


def test_a_change_that_the_disk_did_not_take_is_made_after_a_restart_whatever_came_between(tmp_path):
    disk = FullDisk()
    shelf = Shelf(tmp_path, state_dir=tmp_path / "state", build=disk.build)
    shelf.add_part("x", "u", 0, 1, floor(3.0), None)
    shelf.settle()
    disk.full = True
    change(shelf, 0.5)
    shelf.settle()
    disk.full = False
    change(shelf, 0.7)
    shelf.settle()
    shelf.close()
    again = Shelf(tmp_path, state_dir=tmp_path / "state")
    again.restore()
    again.settle()
    assert again.facts()["x"]["points"] == len(floor(3.0)) + 2
    again.close()


def test_a_change_of_a_scene_that_is_unloaded_meanwhile_makes_no_ghost_of_it(tmp_path):
    shelf = Shelf(tmp_path, state_dir=tmp_path / "state")
    shelf.add_part("x", "u", 0, 1, floor(3.0), None)
    shelf.settle()
    write = shelf.journal.put

    def put(*told, **arrays):
        shelf.unload("x")
        return write(*told, **arrays)

    shelf.journal.put = put
    with pytest.raises(ValueError, match="no scene 'x' any more"):
        change(shelf, 0.5)
    shelf.settle()
    assert shelf.facts() == {}
    assert not list((tmp_path / "state" / "journal").iterdir())
    shelf.close()


def test_an_unloaded_scene_does_not_come_back_with_the_next_start(tmp_path):
    gate = threading.Event()
    workshop = Workshop()

    def build(job, progress):
        made = workshop.build(job, progress)
        gate.wait(30)
        return made

    shelf = Shelf(tmp_path, state_dir=tmp_path / "state", build=build)
    shelf.add_part("x", "u", 0, 1, floor(3.0), None)
    shelf.add_part("x", "v", 0, 1, floor(4.0), None)
    assert shelf.unload("x")
    assert not list((tmp_path / "state" / "journal").iterdir())
    assert not list((tmp_path / "state").glob("x@*"))
    gate.set()
    shelf.settle()
    assert not list((tmp_path / "state").glob("*x@*"))
    assert shelf.facts() == {}
    shelf.close()


@pytest.mark.slow
def test_what_cannot_be_kept_is_not_acknowledged_and_the_service_says_that_it_is_ill(tmp_path, free_endpoint):
    words = [sys.executable, "-m", "gpdf_service.cli", "serve", "--endpoint", free_endpoint, "--workers", "1"]
    words += ["--log-dir", str(tmp_path / "log"), "--scenes-dir", str(tmp_path)]
    gpdf.build_scene(floor(3.0)).save(tmp_path / "room.gpdf")

    def full():
        resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, 50_000))

    with subprocess.Popen(words, preexec_fn=full) as process:  # each write beyond it fails as on a full disk
        try:
            with Client.connect(free_endpoint, timeout_s=PATIENCE_S) as client:
                with pytest.raises(ServiceError, match=r"BUILD_FAILED.*cannot be kept.*Make room") as told:
                    client.load_scene("large", upload=floor(6.0))
                assert str(tmp_path) not in str(told.value)
                assert "large" not in client.scenes()
                with pytest.raises(
                    ServiceError, match=r"BUILD_FAILED.*cannot be kept"
                ):  # the order fits, not the scene
                    client.load_scene("room", "room.gpdf", timeout_s=PATIENCE_S)
                (status,) = client.status()
                assert not status.healthy
                assert any("cannot be kept" in problem for problem in status.problems)
        finally:
            process.kill()
    with subprocess.Popen(words) as process:  # there is room again
        try:
            with Client.connect(free_endpoint, timeout_s=PATIENCE_S) as client:
                assert client.wait_for_scene("room", timeout_s=PATIENCE_S)["kept"]
                until = time.monotonic() + PATIENCE_S
                while not client.status()[0].healthy:
                    assert time.monotonic() < until
        finally:
            process.kill()


def test_a_failed_build_tells_no_places_of_this_machine(tmp_path, free_endpoint):
    (tmp_path / "bad.gpdf").write_bytes(b"no scene")
    (tmp_path / "bad.npz").write_bytes(b"no cloud")
    with Server(Options(free_endpoint, tmp_path, tmp_path / "log", 1)), Client.connect(free_endpoint) as client:
        for name in ("bad.gpdf", "bad.npz"):
            with pytest.raises(ServiceError, match=f"BUILD_FAILED.*{name}") as told:
                client.load_scene("bad", name, timeout_s=PATIENCE_S)
            assert str(tmp_path) not in str(told.value)
        assert str(tmp_path) not in str(client.status()[0].problems)


def test_whatever_a_build_raises_ends_it(tmp_path):
    for error in (BuildError("no"), NotKeptError("no"), RuntimeError("no"), MemoryError()):

        def build(job, progress, error=error):
            raise error

        shelf = Shelf(tmp_path, build=build)
        shelf.add_part("x", "u", 0, 1, floor(3.0), None)
        shelf.settle()
        assert (shelf.facts()["x"]["state"], shelf.get("x").pending) == ("failed", 0)
        shelf.close()


def test_an_entry_of_the_journal_that_cannot_be_read_is_a_loss_that_is_told(tmp_path, free_endpoint):
    options = Options(free_endpoint, tmp_path, tmp_path / "log", 1)
    journal = Journal(options.state / "journal")
    journal.put("cloud", "x", {}, points=floor(3.0)).path.write_bytes(b"spoiled")
    (options.state / "GPDF_STATE").touch()
    with Server(options), Client.connect(free_endpoint) as client:
        (status,) = client.status()
    assert not status.healthy
    assert any("lost" in problem for problem in status.problems)


def test_a_wildcard_changes_nothing(tmp_path, free_endpoint):
    gpdf.build_scene(floor(3.0)).save(tmp_path / "room.gpdf")
    with Server(Options(free_endpoint, tmp_path, tmp_path / "log", 1)), Client.connect(free_endpoint) as client:
        client.load_scene("room", "room.gpdf", timeout_s=PATIENCE_S)
        for key in ("gpdf/v1/**", "gpdf/v1/scene/*", "gpdf/v1/scene/un$*"):
            found = client.session.get(key, payload=msgpack.packb({"scene": "room"}), timeout=30.0)
            replies = [msgpack.unpackb(answer.ok.payload.to_bytes()) for answer in found if answer.ok]
            refused = [reply for reply in replies if reply["status"] == "INVALID_REQUEST"]
            assert len(refused) >= len(replies) - 1  # a status is told to whoever asks
        assert client.info("room")["points"] == len(floor(3.0))


def test_certificates_that_nobody_is_asked_for_are_a_mistake(tmp_path):
    file = tmp_path / "mtls.json5"
    file.write_text("{transport: {link: {tls: {enable_mtls: true}}}}")
    with pytest.raises(gpdf.errors.ConfigError, match="tls/HOST:PORT"):
        session_config(Options("tcp/127.0.0.1:7447", zenoh=file))
    session_config(Options("tls/127.0.0.1:7447", zenoh=file))
    session_config(Options("", zenoh=file, connect=("tls/127.0.0.1:7447",)))


def test_a_request_that_is_too_long_is_told_as_that(tmp_path, free_endpoint):
    with Server(Options(free_endpoint, tmp_path, tmp_path / "log", 1)), Client.connect(free_endpoint) as client:
        client.wait_for_service(timeout_s=PATIENCE_S)
        with pytest.raises(ClientError, match=r"INVALID_REQUEST.*Send it in parts"):
            client.distance("x", "ground", np.zeros((2_000_000, 3)))


def test_a_taken_port_is_found_before_any_work(tmp_path, free_endpoint):
    (tmp_path / "room.npz").write_bytes(b"")
    with (
        Server(Options(free_endpoint, tmp_path, tmp_path / "log", 1)),
        pytest.raises(zenoh.ZError),
        Server(Options(free_endpoint, tmp_path, tmp_path / "more", 1), [("room", tmp_path / "room.npz")]),
    ):
        pass
    assert not (tmp_path / "more" / "state" / "last_version").exists()

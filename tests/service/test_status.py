import gc
import json
import shutil
import threading
import time
import urllib.error
import urllib.request

import msgpack
import psutil
import pytest
import zenoh
from gpdf_client import Client, UnavailableError
from gpdf_client.client import client_config
from gpdf_schemas import LoadRequest, SceneReply, Status, keys
from msgspec.structs import replace

from gpdf_service import __version__
from gpdf_service.cli import main
from gpdf_service.errors import ConfigError
from gpdf_service.ports import free_port
from gpdf_service.service.pool import _Process
from gpdf_service.service.server import Options, Server
from gpdf_service.warm import Warming


@pytest.fixture
def scenes(tmp_path, office_file):
    shutil.copy(office_file, tmp_path / "office.gpdf")
    return tmp_path


def until_ready(client):
    until = time.monotonic() + 120
    while not (status := client.status()[0]).ready:
        assert time.monotonic() < until
        time.sleep(0.05)
    return status


@pytest.mark.slow
def test_a_service_that_plans_itself_never_looks_through_what_it_has_loaded(scenes, free_endpoint):
    gc.unfreeze()
    with Server(Options(free_endpoint, scenes, scenes / "log", 1)), Client.connect(free_endpoint) as client:
        until_ready(client)
        assert gc.get_freeze_count() > 50_000  # modules and kernels, which took 74 ms
    gc.unfreeze()


@pytest.mark.slow
def test_a_service_says_how_it_is_and_what_it_did(scenes, free_endpoint, office):
    made = office[0]
    with Server(Options(free_endpoint, scenes, scenes / "log", 2)) as server, Client.connect(free_endpoint) as client:
        client.load_scene("office", "office.gpdf")
        before = client.status()[0].metrics.get("answers_OK", 0)
        for _ in range(3):
            client.plan("office", made.start, made.goal, "roomba")
        client.plan("office", made.start, (90.0, 0.0), "roomba")
        status = until_ready(client)
        assert (status.planner, status.role, status.software) == (server.planner_id, "both", __version__)
        assert status.healthy
        assert status.ready
        assert status.problems == []
        assert status.metrics["answers_OK"] - before == 3
        assert status.metrics["answers_GOAL_OUTSIDE_MAP"] == 1
        assert 0 < status.metrics["answer_p50_s"] <= status.metrics["answer_p99_s"]
        planning = server.metrics.numbers(server.processes)["memory_bytes"]
        assert status.metrics["memory_bytes"] > planning + 50e6  # that of who builds counts, too
        assert (status.metrics["scenes"], status.metrics["scenes_in_memory"], status.metrics["workers"]) == (1, 1, 2)


def test_a_full_service_still_says_how_it_is(scenes, free_endpoint, monkeypatch):
    gate, inside = threading.Event(), threading.Event()
    with Server(Options(free_endpoint, scenes, scenes / "log", 1, queue=1)) as server:
        answer = server.handlers.answer

        def slow(*asked):
            inside.set()
            gate.wait(30)
            return answer(*asked)

        monkeypatch.setattr(server.handlers, "answer", slow)
        with zenoh.open(client_config(free_endpoint)) as session, Client.connect(free_endpoint) as client:
            ask = [threading.Thread(target=lambda: list(session.get(keys.SCENES, payload=b"\x80"))) for _ in range(2)]
            ask[0].start()
            assert inside.wait(30)  # the worker is held
            ask[1].start()
            while server.load < 2:
                pass
            (status,) = client.status()
            assert status.load == 2
            assert status.healthy
            gate.set()
            for thread in ask:
                thread.join(30)


def test_a_log_that_loses_what_was_done_is_a_problem_and_an_illness(scenes, free_endpoint):
    options = Options(free_endpoint, scenes, scenes / "log", 1, log_min_free_mb=1e12)
    with Server(options), Client.connect(free_endpoint) as client:
        client.scenes()
        until = time.monotonic() + 30
        while (status := client.status()[0]).metrics["messages_lost"] < 1:  # counted when it would be written
            assert time.monotonic() < until
        assert not status.healthy
        assert "log-min-free-mb" in status.problems[0]


def test_the_command_for_health_checks(scenes, free_endpoint, capsys):
    with Server(Options(free_endpoint, scenes, scenes / "log", 1)) as server:
        with Client.connect(free_endpoint) as client:
            until_ready(client)
        assert main(["client", "--endpoint", free_endpoint, "status", "--json"]) == 0
        (service,) = json.loads(capsys.readouterr().out)["services"]
        assert service["planner"] == server.planner_id
        assert main(["client", "--endpoint", free_endpoint, "status"]) == 0
        assert capsys.readouterr().out.startswith(f"both {server.planner_id}: ready, load 0.0, 0 scenes, ")
    assert main(["client", "--endpoint", free_endpoint, "status"]) == 1


def test_a_service_that_is_still_building_its_scenes_is_not_ready(scenes, free_endpoint, monkeypatch):
    gate = threading.Event()
    load = __import__("gpdf_service.scene", fromlist=["load_scene"]).load_scene

    def slow(path):
        gate.wait(30)
        return load(path)

    monkeypatch.setattr("gpdf_service.service.scenes.load_scene", slow)
    options = Options(free_endpoint, scenes, scenes / "log", 1)
    with Server(options, [("office", scenes / "office.gpdf")]) as server, Client.connect(free_endpoint) as client:
        status = client.status()[0]
        assert (status.state, status.ready) == ("warming", False)
        gate.set()
        assert until_ready(client).state == "active"
        assert client.info("office")["agents_ready"] == ["human"]  # built ahead: it is a configured body
    assert server.state == "draining"


def test_a_service_that_builds_a_new_scene_is_ready_and_the_scene_says_that_it_is_built(
    scenes, free_endpoint, office, monkeypatch
):
    gate, made = threading.Event(), office[0]
    options = Options(free_endpoint, scenes, scenes / "log", 1)
    with Server(options, [("office", scenes / "office.gpdf")]) as server, Client.connect(free_endpoint) as client:
        until_ready(client)
        build = server.shelf._build

        def held(job, progress):
            gate.wait(120)
            return build(job, progress)

        monkeypatch.setattr(server.shelf, "_build", held)
        request = LoadRequest(scene="second", file="office.gpdf")
        client.ask(keys.SCENE_LOAD, request, SceneReply, 60, {Status.BUILDING})
        status = client.status()[0]
        assert (status.state, status.ready) == ("active", True)
        assert [client.scenes()[name]["state"] for name in ("office", "second")] == ["ready", "building"]
        assert client.plan("office", made.start, made.goal, "roomba").status == "OK"
        gate.set()
        client.wait_for_scene("second")
        assert client.status()[0].ready


@pytest.mark.slow
@pytest.mark.parametrize(
    ("workers", "kind", "step"), [(1, Warming, "plans"), (2, _Process, "wait_until_ready")], ids=["inside", "pool"]
)
def test_a_service_whose_kernels_or_processes_are_not_there_is_not_ready(
    scenes, free_endpoint, monkeypatch, workers, kind, step
):
    gate, do = threading.Event(), getattr(kind, step)

    def held(self):
        gate.wait(120)
        do(self)

    monkeypatch.setattr(kind, step, held)
    options = Options(free_endpoint, scenes, scenes / "log", workers)
    with Server(options) as server, Client.connect(free_endpoint) as client:
        server.shelf.settle()
        assert (server.status().state, server.status().ready) == ("warming", False)
        gate.set()
        assert until_ready(client).state == "active"


def test_a_scene_from_before_has_the_free_spaces_of_bodies_that_are_configured_since(scenes, free_endpoint):
    options = Options(free_endpoint, scenes, scenes / "log", 1, bodies=("human",))
    with Server(options), Client.connect(free_endpoint) as client:
        client.load_scene("office", "office.gpdf")
    with Server(replace(options, bodies=("human", "spot"))) as server, Client.connect(free_endpoint) as client:
        assert until_ready(client).state == "active"
        assert sorted(client.info("office")["agents_ready"]) == ["human", "spot"]
        assert server.shelf.get("office").facts["version"] == 1  # it was read, not built


def test_what_comes_while_a_service_ends_is_answered(scenes, free_endpoint):
    answers, begun, asked = [], threading.Event(), threading.Event()

    def ask_on(session):
        while not asked.is_set():
            for answer in session.get(keys.SCENES, payload=b"\x80", timeout=20):
                answers.append(msgpack.unpackb(answer.ok.payload.to_bytes())["status"] if answer.ok else "timed out")
            if "OK" in answers:  # until the hub knows the service nobody answers
                begun.set()

    hub_config = zenoh.Config()
    for key, value in (
        ("mode", '"router"'),
        ("listen/endpoints", f'["{free_endpoint}"]'),
        ("scouting/multicast/enabled", "false"),
    ):
        hub_config.insert_json5(key, value)
    with zenoh.open(hub_config), zenoh.open(client_config(free_endpoint)) as session:
        with Server(Options("", scenes, scenes / "log", 1, connect=(free_endpoint,))):
            threads = [threading.Thread(target=ask_on, args=(session,)) for _ in range(8)]
            for thread in threads:
                thread.start()
            assert begun.wait(30)
        asked.set()
        for thread in threads:
            thread.join(30)
            assert not thread.is_alive()
    assert "OK" in answers
    assert set(answers) <= {"OK", "UNAVAILABLE"}


def test_a_client_of_a_service_that_ended_hears_that_it_is_not_there(scenes, free_endpoint):
    with Server(Options(free_endpoint, scenes, scenes / "log", 1)):
        client = Client.connect(free_endpoint)
    with client, pytest.raises(UnavailableError):
        client.plan("office", (1, 1), (2, 2), deadline_s=0.5)


def test_prometheus_reads_the_same_numbers_on_this_machine_alone(scenes, free_endpoint):
    from prometheus_client.parser import text_string_to_metric_families

    port = free_port()
    options = Options(free_endpoint, scenes, scenes / "log", 1, metrics_port=port)

    def read():
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=10) as answer:
            families = text_string_to_metric_families(answer.read().decode())
            return {(one.name, one.labels.get("status")): one.value for family in families for one in family.samples}

    with Server(options) as server, Client.connect(free_endpoint) as client:
        client.load_scene("office", "office.gpdf")
        client.plan("office", (1, 1), (90.0, 0.0), "roomba")
        until_ready(client)
        numbers = read()
        assert numbers["gpdf_answers_total", "GOAL_OUTSIDE_MAP"] == 1
        assert (numbers["gpdf_healthy", None], numbers["gpdf_ready", None], numbers["gpdf_workers", None]) == (1, 1, 1)
        assert numbers["gpdf_memory_bytes", None] > 50e6
        assert {f"gpdf_{name}" for name in server.status().metrics if not name.startswith("answers_")} <= {
            name.removesuffix("_total") for name, _ in numbers
        }
        addresses = {at.laddr.ip for at in psutil.Process().net_connections() if at.laddr.port == port}
        assert addresses == {"127.0.0.1"}
        with pytest.raises(ConfigError, match="free port"):
            Server(Options("", scenes, scenes / "log2", 1, metrics_port=port)).__enter__()
    with pytest.raises(urllib.error.URLError):
        read()

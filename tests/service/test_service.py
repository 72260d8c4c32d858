import asyncio
import json
import os
import queue
import shutil
import signal
import subprocess
import sys
import threading
import time

import msgpack
import numpy as np
import pytest
import zenoh
from gpdf_client import AsyncClient, Client, InvalidRequestError, ServiceError, UnavailableError, UnknownSceneError
from gpdf_schemas import PlanReply, PlanRequest, decode, encode, keys
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

import gpdf_service as gpdf
from gpdf_service.ports import free_endpoint
from gpdf_service.service.handlers import Handlers
from gpdf_service.service.record import check, repair, repair_folder
from gpdf_service.service.replay import compare, recorded_plans
from gpdf_service.service.server import Options, Server
from tests.asynchronous import run


@pytest.fixture(scope="module")
def clouds(tmp_path_factory, office, office_file):
    folder = tmp_path_factory.mktemp("scenes")
    made = office[0]
    label = made.ground.astype(int)
    np.savez(folder / "office.npz", xyz=made.points, label=label, classes=np.array(["other", "ground"]))
    shutil.copy(office_file, folder / "office.gpdf")
    return folder


@pytest.fixture(scope="module")
def running(clouds, tmp_path_factory):
    endpoint = free_endpoint()
    options = Options(endpoint, clouds, tmp_path_factory.mktemp("log"), 2)
    with Server(options) as server, Client.connect(endpoint) as client:
        client.load_scene("office", "office.npz")
        while not client.status()[0].ready:  # its processes are there, too
            time.sleep(0.05)
        yield server, client, endpoint


def test_a_plan_over_zenoh_is_the_plan_in_process(running, office):
    _, client, _ = running
    made, scene = office
    over, inside = client.plan("office", made.start, made.goal), gpdf.plan(scene, made.start, made.goal)
    assert over.status == gpdf.Status.OK
    np.testing.assert_allclose(over.trajectory.positions, inside.trajectory.positions, atol=1e-6)
    np.testing.assert_allclose(over.trajectory.times, inside.trajectory.times, atol=1e-6)
    assert over.certificate.min_clearance == pytest.approx(inside.certificate.min_clearance, abs=1e-6)
    assert over.certificate.holds
    assert over.certificate.hidden_height == inside.certificate.hidden_height > 0


def test_the_options_of_a_plan_go_over_zenoh(running, office):
    _, client, _ = running
    made, scene = office
    via, other = [(4.5, 1.0)], [(1.2, 1.0)]
    over = client.plan("office", made.start, made.goal, via=via)
    inside = gpdf.plan(scene, made.start, made.goal, via=via)
    np.testing.assert_allclose(over.trajectory.positions, inside.trajectory.positions, atol=1e-6)
    np.testing.assert_allclose(over.costs, inside.costs, rtol=1e-6)
    assert over.details == pytest.approx(inside.details)
    assert client.plan("office", made.start, made.goal, other_goals=other).details["goal"] == 1
    assert client.plan("office", (-0.05, 1.0), made.goal, snap=1.0).message.startswith("The start was moved")
    again = client.plan(
        "office", made.start, made.goal, warm_start=client.plan("office", made.start, made.goal).trajectory
    )
    assert again.details["warm"] == 1
    with pytest.raises(InvalidRequestError, match="snap"):
        client.plan("office", made.start, made.goal, snap=-1.0)


def test_distances_over_zenoh_are_those_in_process(running, office):
    _, client, _ = running
    points = np.random.default_rng(0).uniform([0, 0, 0], [6, 5, 2], (50, 3))
    over, inside = client.distance("office", "ground", points), office[1].ground_field.query(points)
    np.testing.assert_allclose(over.distance, inside.distance, rtol=1e-12)  # another process compiles for itself
    np.testing.assert_array_equal(over.valid, inside.valid)
    np.testing.assert_allclose(over.deviation, inside.deviation, rtol=1e-6)
    flat = client.distance("office", "obstacle", points[:, :2], "roomba")
    ours = office[1].obstacle_field("roomba").query(points[:, :2]).distance
    np.testing.assert_allclose(flat.distance, ours, rtol=1e-12)


def test_uploaded_points_become_a_scene(running, office):
    _, client, _ = running
    shares = []
    made = office[0]
    facts = client.load_scene("sent", upload=made.points, ground=made.ground, progress=shares.append)
    assert facts["points"] == len(made.points)
    assert facts["digest"] == office[1].digest
    assert shares[-1] == 1.0
    assert len(shares) > 1
    assert client.plan("sent", made.start, made.goal, "roomba").status == "OK"
    client.unload_scene("sent")
    assert "sent" not in client.scenes()


def test_failures_have_their_own_errors_and_words(running):
    _, client, _ = running
    with pytest.raises(UnknownSceneError, match="office"):
        client.plan("nowhere", (1, 1), (2, 2))
    with pytest.raises(InvalidRequestError, match="dragon"):
        client.plan("office", (1, 1), (2, 2), "dragon")
    with pytest.raises(InvalidRequestError, match="outside the scenes folder"):
        client.load_scene("x", "../../etc/passwd")
    with pytest.raises(InvalidRequestError, match="not in the scenes folder"):
        client.load_scene("x", "none.npz")
    with pytest.raises(InvalidRequestError, match="no name"):
        client.load_scene("../x", "office.npz")
    with pytest.raises(ServiceError, match=r"walkable|ground"):
        client.load_scene("bad", upload=np.zeros((10, 3)) + np.arange(10)[:, None])
    outside = client.plan("office", (1, 1), (90, 2))
    assert outside.status == "GOAL_OUTSIDE_MAP"
    assert outside.trajectory is None


@pytest.mark.parametrize("method", ["astar", "prm", "single_gpdf"])
def test_a_baseline_is_asked_by_name_and_its_uncertified_path_is_not_ok(running, method):
    _, client, _ = running
    flat = client.plan("office", (1, 1), (2, 1.5), "human", method=method)
    assert flat.status == "OK"
    onto_the_step = client.plan("office", (1, 1), (5.5, 2.2), "human", method=method)
    assert onto_the_step.status == "UNCERTIFIED"
    assert not onto_the_step.certificate.holds
    assert len(onto_the_step.trajectory.positions) > 2


def ask_raw(endpoint, key, payload):
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    with zenoh.open(config) as session:
        return [answer.ok.payload.to_bytes() for answer in session.get(key, payload=payload, timeout=30)]


@pytest.mark.parametrize(
    "payload",
    [
        b"",
        b"\xff\x00garbage",
        msgpack.packb([1, 2, 3]),
        msgpack.packb({"scene": "office"}),
        msgpack.packb({"scene": "office", "start": [float("nan"), 1.0], "goal": [1.0, 1.0]}),
        msgpack.packb({"scene": "office", "start": [1.0, 1.0, 1.0, 1.0], "goal": [1.0, 1.0]}),
        msgpack.packb({"scene": 5, "start": [1.0, 1.0], "goal": [1.0, 1.0]}),
        b"\x91" * 100_000,
        b"\xdf\xff\xff\xff\xff",
        msgpack.packb({"scene": "x" * (5 << 20), "start": [1.0, 1.0], "goal": [1.0, 1.0]}),
        msgpack.packb({"scene": "office", "start": [1.0, 1.0], "goal": [1.0, 1.0], "agent": {"name": "x"}}),
        msgpack.packb({"scene": "office", "start": [1.0, 1.0], "goal": [1.0, 1.0], "method": "teleport"}),
    ],
)
def test_garbage_gets_an_answer_and_the_service_goes_on(running, payload):
    _, client, endpoint = running
    (answer,) = ask_raw(endpoint, keys.PLAN, payload)
    reply = msgpack.unpackb(answer)
    assert reply["status"] == "INVALID_REQUEST"
    assert reply["message"]
    assert "office" in client.scenes()


def test_the_example_of_the_conventions_plans_with_zenoh_and_msgpack_alone(running, capsys):
    from pathlib import Path

    text = (Path(__file__).parent.parent.parent / "schemas" / "CONVENTIONS.md").read_text()
    code = text.split("```python\n")[1].split("```")[0]
    assert "gpdf_" not in code
    exec(compile(code.replace("tcp/127.0.0.1:7447", running[2]), "CONVENTIONS.md", "exec"), {})
    out = capsys.readouterr().out
    assert out.startswith("OK")
    assert "waypoints, the first at (1.0, 1.0," in out


def test_the_asyncio_client_plans_side_by_side(running, office):
    made = office[0]

    async def both():
        async with await AsyncClient.connect(running[2]) as client:
            return await asyncio.gather(
                client.plan("office", made.start, made.goal, "human"),
                client.plan("office", made.start, made.goal, "roomba"),
                client.scenes(),
            )

    human, roomba, scenes = run(both())
    assert human.status == roomba.status == "OK"
    assert "office" in scenes


def test_nobody_there_is_unavailable(free_endpoint):
    with pytest.raises(UnavailableError, match="gpdf serve"):
        Client.connect(free_endpoint, timeout_s=0.2)


def test_a_full_queue_is_busy_and_everybody_gets_an_answer(clouds, tmp_path, free_endpoint, monkeypatch):
    gate, inside = threading.Event(), threading.Event()
    with Server(Options(free_endpoint, clouds, tmp_path, 1, queue=2)) as server:
        answer = server.handlers.answer

        def slow(*asked):
            inside.set()
            gate.wait(30)
            return answer(*asked)

        monkeypatch.setattr(server.handlers, "answer", slow)
        replies, lock = [], threading.Lock()

        def one():
            (raw,) = ask_raw(free_endpoint, keys.SCENES, msgpack.packb({}))
            with lock:
                replies.append(msgpack.unpackb(raw)["status"])

        threads = [threading.Thread(target=one) for _ in range(8)]
        threads[0].start()
        assert inside.wait(30)  # the one worker is held; two more wait, five are turned away
        for thread in threads[1:]:
            thread.start()
        until = time.monotonic() + 30
        while len(replies) < 5 and time.monotonic() < until:
            time.sleep(0.01)
        gate.set()
        for thread in threads:
            thread.join(30)
    assert len(replies) == 8
    assert replies.count("BUSY") == 5
    assert replies.count("OK") == 3


def test_the_log_holds_the_bytes_of_the_wire_and_draws_in_viewers(clouds, tmp_path, free_endpoint, office):
    made = office[0]
    request = encode(PlanRequest(scene="office", start=list(made.start), goal=list(made.goal), request_id="one"))
    with Server(Options(free_endpoint, clouds, tmp_path, 1)) as server:
        with Client.connect(free_endpoint) as client:
            client.load_scene("office", "office.gpdf")
        (answer,) = ask_raw(free_endpoint, keys.PLAN, request)
        path = server.recorder.path
    with path.open("rb") as file:
        found = {}
        for schema, channel, message in make_reader(file).iter_messages():
            found.setdefault(channel.topic, []).append((schema, channel.message_encoding, message))
    assert [m.data for _, _, m in found[f"{keys.PLAN}/request"]] == [request]
    assert [m.data for _, _, m in found[f"{keys.PLAN}/reply"]] == [answer]
    assert found[f"{keys.PLAN}/reply"][0][1] == "msgpack"
    with path.open("rb") as file:
        decoded = {
            channel.topic: message
            for _, channel, _, message in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages(
                topics=["/plan/office", "/cloud/office", "/path/office", "/words"]
            )
        }
    reply = decode(answer, PlanReply)
    poses = decoded["/plan/office"].poses
    xyz = np.array([[p.position.x, p.position.y, p.position.z] for p in poses])
    np.testing.assert_array_equal(xyz, reply.trajectory.positions.unpack())
    assert len(decoded["/cloud/office"].data) % 12 == 0
    dots = np.frombuffer(decoded["/path/office"].data, "<f4").reshape(-1, 3)
    np.testing.assert_allclose(dots[[0, -1]], xyz[[0, -1]], atol=1e-6)
    assert np.linalg.norm(np.diff(dots, axis=0), axis=1).max() < 0.03
    assert decoded["/words"].message.startswith("office: OK, ")
    assert decoded["/words"].message.endswith(" m of room, request one")
    (pair,) = recorded_plans(path)
    result = compare(*pair, reply)
    assert result.same
    assert result.deviation == 0


def serve(clouds, log_dir, endpoint):
    words = ["-m", "gpdf_service.cli", "serve", f"office={clouds / 'office.gpdf'}", "--endpoint", endpoint]
    words += ["--log-dir", str(log_dir), "--scenes-dir", str(clouds), "--workers", "1"]
    return subprocess.Popen([sys.executable, *words], stderr=subprocess.PIPE, env=os.environ, text=True)


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_process_with_a_complete_log(clouds, tmp_path, free_endpoint, office, number):
    made = office[0]
    with serve(clouds, tmp_path, free_endpoint) as process:
        try:
            with Client.connect(free_endpoint, timeout_s=60) as client:
                client.wait_for_scene("office")
                assert client.plan("office", made.start, made.goal, "roomba").status == "OK"
            process.send_signal(number)
            assert process.wait(60) == 0
        finally:
            process.kill()
    (log,) = tmp_path.glob("*.mcap")
    assert check(log).complete
    assert len(list(recorded_plans(log))) == 1


def test_a_killed_process_leaves_a_log_that_is_mended(clouds, tmp_path, free_endpoint, office):
    made = office[0]
    with serve(clouds, tmp_path, free_endpoint) as process:
        try:
            with Client.connect(free_endpoint, timeout_s=60) as client:
                client.wait_for_scene("office")
                client.plan("office", made.start, made.goal, "roomba")
                log = next(tmp_path.glob("*.mcap"))
                until = time.monotonic() + 30
                while not list(recorded_plans(log)) and time.monotonic() < until:
                    client.scenes()  # later messages, so that the flush interval passes with the plan inside
                    time.sleep(0.1)
        finally:
            process.kill()
            process.wait(60)
    assert not check(log).complete
    messages = check(log).messages
    assert messages > 0
    assert repair_folder(tmp_path) == [log]
    assert check(log).complete
    assert check(log).messages == messages
    assert len(list(recorded_plans(log))) == 1
    assert repair_folder(tmp_path) == []
    assert repair(log).messages == messages


def test_two_services_on_one_port_do_not_both_start(running, clouds, tmp_path):
    with serve(clouds, tmp_path, running[2]) as process:
        try:
            assert process.wait(60) == 1
        finally:
            process.kill()
        assert "Is another service running" in process.stderr.read()


def test_uploads_that_nobody_finishes_make_room(tmp_path, monkeypatch):
    from gpdf_service.service.scenes import Shelf

    monkeypatch.setattr("gpdf_service.service.uploads.MAX_UPLOAD_POINTS", 100)
    shelf, points = Shelf(tmp_path), np.zeros((40, 3))
    for name in ("a", "b", "c", "d"):
        assert not shelf.add_part("x", name, 0, 2, points, None)
    with pytest.raises(ValueError, match="Thin the cloud"):
        shelf.add_part("x", "large", 0, 2, np.zeros((200, 3)), None)
    with pytest.raises(ValueError, match="count from 0"):
        shelf.add_part("x", "e", 2, 2, points, None)
    shelf.close()


@pytest.mark.slow
def test_a_second_service_leaves_the_log_of_the_running_one_alone(clouds, tmp_path, free_endpoint, office):
    made = office[0]
    with Server(Options(free_endpoint, clouds, tmp_path, 1)) as server, Client.connect(free_endpoint) as client:
        client.load_scene("office", "office.gpdf")
        with serve(clouds, tmp_path, free_endpoint) as second:
            try:
                assert second.wait(60) == 1
            finally:
                second.kill()
        client.plan("office", made.start, made.goal, "roomba", request_id="after")
    assert check(server.recorder.path).complete
    assert [request.request_id for request, _ in recorded_plans(server.recorder.path)] == ["after"]


def test_a_log_that_is_cut_anywhere_is_mended(tmp_path):
    (tmp_path / "log").mkdir()
    from gpdf_service.service.recorder import Recorder

    recorder = Recorder(Options(log_dir=tmp_path / "log"), "x", {})
    for i in range(5):
        recorder.exchange(keys.PLAN, bytes([i]) * 20, bytes([i]) * 50, i, i)
    recorder.close()
    whole, path = recorder.path.read_bytes(), tmp_path / "gpdf_cut.mcap"
    cuts = range(0, len(whole), 7)
    for cut in cuts:
        path.write_bytes(whole[:cut])
        assert repair_folder(tmp_path) == [path]
        assert check(path).complete
    for place in cuts:
        path.write_bytes(whole[:place] + b"\xa5" + whole[place + 1 :])
        assert check(path).messages <= 10


def test_a_running_service_is_seen_by_its_liveliness_token(running):
    server, client, _ = running
    seen = queue.Queue()
    client.watch(lambda planner, alive: seen.put((planner, alive)))
    assert seen.get(timeout=30) == (server.planner_id, True)


def test_a_scene_is_ready_only_when_its_last_load_is(tmp_path):
    from gpdf_service.service.scenes import Shelf, describe
    from gpdf_service.service.workshop import Workshop

    gates, first_done, workshop = [threading.Event(), threading.Event()], threading.Event(), Workshop()
    waiting = iter(gates)

    def build(job, progress):
        progress("wait", 0.5)
        next(waiting).wait(30)
        return workshop.build(job, lambda stage, done: None)

    shelf = Shelf(tmp_path, lambda name, scene: first_done.set(), build=build)
    for width in (3.0, 4.0):
        shelf.add_part("x", str(width), 0, 1, floor(width), None)
    until = time.monotonic() + 30
    while describe(shelf.get("x")).get("done", 0.0) < 0.5 and time.monotonic() < until:
        time.sleep(0.01)
    assert describe(shelf.get("x"))["stage"] == "wait"
    gates[0].set()
    assert first_done.wait(30)
    first = shelf.facts()["x"]["version"]
    assert shelf.get("x").building
    gates[1].set()
    shelf.settle()
    assert not shelf.get("x").building
    assert len(shelf.get("x").scene.points) == len(floor(4.0))
    assert shelf.facts()["x"]["version"] > first
    shelf.close()


def test_versions_of_a_name_never_come_again(running, tmp_path, clouds):
    _, client, _ = running
    scene = gpdf.build_scene(floor(3.0))
    scene.version = 50
    scene.save(clouds / "fifty.gpdf")
    versions = [client.load_scene("v", "fifty.gpdf")["version"], client.load_scene("v", upload=floor(3.0))["version"]]
    client.unload_scene("v")
    versions.append(client.load_scene("v", upload=floor(4.0))["version"])
    client.unload_scene("v")
    assert versions[0] >= 50
    assert versions == sorted(set(versions))


def test_parts_that_do_not_fit_together_are_refused_in_words(tmp_path):
    from gpdf_service.service.scenes import Shelf

    shelf, points = Shelf(tmp_path), np.zeros((4, 3))
    for part in (0, 5):
        assert not shelf.add_part("x", "a", part, 10, points, None)
    with pytest.raises(ValueError, match="to be 3 parts"):
        shelf.add_part("x", "a", 1, 3, points, None)
    with pytest.raises(gpdf.errors.RequestError, match="no name"):  # before millions of points were sent
        shelf.add_part("../x", "a", 0, 10, points, None)
    shelf.close()


def test_uploads_that_wait_for_their_builds_and_names_of_scenes_are_bounded(tmp_path, monkeypatch):
    from gpdf_service.service import scenes

    monkeypatch.setattr(scenes, "MAX_CLOUD_POINTS", 10)
    monkeypatch.setattr(scenes, "MAX_SCENES", 2)
    go_on = threading.Event()
    shelf, points = scenes.Shelf(tmp_path, build=lambda *_: go_on.wait(30)), np.zeros((4, 3))
    shelf._builder.submit(go_on.wait, 30)
    for name in "ab":
        assert shelf.add_part(name, "u", 0, 1, points, None)
    with pytest.raises(scenes.FullError, match="faster"):
        shelf.add_part("a", "u", 0, 1, points, None)
    with pytest.raises(gpdf.errors.RequestError, match="Unload one"):
        shelf.add_part("c", "u", 0, 1, points, None)
    (tmp_path / "a.npz").touch()
    monkeypatch.setattr(scenes, "MAX_BUILDS", 3)
    shelf.load_file("a", "a.npz")
    with pytest.raises(scenes.FullError, match="3 builds are waiting"):
        shelf.load_file("a", "a.npz")
    go_on.set()
    shelf.settle()
    assert shelf.add_part("a", "u", 0, 1, points, None)
    with pytest.raises(ValueError, match="too long"):
        shelf.add_part("a", "u" * 1000, 0, 2, points, None)
    shelf.close()


def test_an_upload_that_made_room_is_refused_not_forgotten(tmp_path, monkeypatch):
    from gpdf_service.service.scenes import Shelf

    monkeypatch.setattr("gpdf_service.service.uploads.MAX_UPLOADS", 2)
    shelf, points = Shelf(tmp_path), np.zeros((4, 3))
    for upload in ("a", "b", "c"):
        assert not shelf.add_part("x", upload, 0, 2, points, None)
    with pytest.raises(ValueError, match="Send it again"):
        shelf.add_part("x", "a", 1, 2, points, None)
    with pytest.raises(ValueError, match="no points"):
        shelf.add_part("x", "d", 0, 2, points[:0], None)
    shelf.close()


def floor(width):
    x, y = np.meshgrid(np.arange(0, width, 0.05), np.arange(0, 3, 0.05))
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])


def test_waiting_counts_against_the_deadline(running, monkeypatch):
    given = []
    monkeypatch.setattr("gpdf_service.service.planning.plan", lambda *_, deadline_s, **__: given.append(deadline_s))
    request = encode(PlanRequest(scene="office", start=[1.0, 1.0], goal=[2.0, 2.0], deadline_s=1000.0))
    Handlers(running[0].shelf, "").answer(keys.PLAN, request, time.monotonic() - 400.0)
    assert len(given) == 1
    assert 0 < given[0] <= 600.0


def test_a_deadline_that_is_over_at_once_is_told_with_numbers_that_say_so(running, office):
    made = office[0]
    request = PlanRequest(scene="office", start=list(made.start), goal=list(made.goal), agent="roomba", deadline_s=1e-6)
    late = running[1].ask_planner(keys.PLAN, request, PlanReply, 30.0)  # the client has time to hear it
    assert late.status == "TIMEOUT"
    assert "its deadline was 1e-06 s. Give more time." in late.message


def test_a_file_name_that_no_file_can_have_is_an_invalid_request(running):
    with pytest.raises(InvalidRequestError, match="not in the scenes folder"):
        running[1].load_scene("x", "y" * 300)

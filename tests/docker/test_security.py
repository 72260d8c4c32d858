"""The examples of docker/security, as they are but for their paths and ports, with the real service and client."""

import queue
import re
import shutil
import subprocess
import time
from pathlib import Path

import msgspec
import numpy as np
import pytest
import zenoh
from gpdf_client import Client, UnavailableError
from gpdf_schemas import Cylinder, FileReply, FileRequest, MovingObstacle, keys

from gpdf_service.service.options import ENVIRONMENT, descriptions
from gpdf_service.service.server import Options, Server
from gpdf_service.viewer.link import Link

DOCKER = Path(__file__).parent.parent.parent / "docker"
REFUSED_S = 1.0
"""[s] A client without rights is not answered, however long it asks."""


def example(name, folder, **changes):
    """One of our examples, its /etc/gpdf in `folder`, as a file there."""
    text = (DOCKER / "security" / name).read_text().replace("/etc/gpdf", str(folder))
    for old, new in changes.values():
        assert old in text
        text = text.replace(old, new)
    path = folder / name
    path.write_text(text)
    return path


def as_user(user, folder, endpoint):
    passwords = dict(line.split(":") for line in (folder / "users.txt").read_text().split())
    text = (DOCKER / "security" / "client.json5").read_text().replace("tcp/127.0.0.1:7447", endpoint)
    path = folder / f"{user}.json5"
    path.write_text(text.replace("guide", user).replace("change-me-3", passwords.get(user, "guessed")))
    return Client.connect(endpoint, config=zenoh.Config.from_file(str(path)), timeout_s=REFUSED_S)


@pytest.fixture
def guarded(tmp_path, free_endpoint, office_file):
    shutil.copy(office_file, tmp_path / "office.gpdf")
    shutil.copy(DOCKER / "security" / "users.txt", tmp_path)
    options = Options(
        free_endpoint, tmp_path, tmp_path / "log", 1, zenoh=example("access.json5", tmp_path), role="both"
    )
    with Server(options, [("office", tmp_path / "office.gpdf")]) as server:
        server.shelf.settle()
        yield server, free_endpoint, tmp_path


def test_the_operators_page_has_credentials(guarded):
    _, endpoint, folder = guarded
    as_user("operator", folder, endpoint).close()  # writes its configuration
    heard = queue.Queue()
    link = Link("", heard.put, zenoh.Config.from_file(str(folder / "operator.json5")))
    link.start()
    try:
        assert heard.get(timeout=30)
        assert set(link.client.scenes()) == {"office"}
    finally:
        link.close()


def test_nobody_enters_without_a_password_or_with_a_wrong_one(guarded):
    _, endpoint, folder = guarded
    with pytest.raises(UnavailableError):
        Client.connect(endpoint, timeout_s=REFUSED_S)
    with pytest.raises(UnavailableError):
        as_user("stranger", folder, endpoint)


def test_a_guide_leads_its_own_person_and_nobody_else(guarded):
    _, endpoint, folder = guarded
    heard = queue.Queue()
    with as_user("guide", folder, endpoint) as guide, as_user("operator", folder, endpoint) as body:
        listening = [
            guide.session.declare_subscriber(f"{keys.POSE}/*", lambda sample: heard.put(str(sample.key_expr))),
            guide.session.declare_subscriber(f"{keys.POSE}/guide", lambda sample: heard.put(str(sample.key_expr))),
            body.session.declare_subscriber(f"{keys.CUE}/*", lambda sample: heard.put(str(sample.key_expr))),
        ]
        until = time.monotonic() + 30
        while heard.empty():  # until the subscriptions have reached the router
            assert time.monotonic() < until
            for name in ("other", "guide"):
                body.session.put(f"{keys.POSE}/{name}", b"")
            time.sleep(0.05)
        for name in ("other", "guide"):
            guide.session.put(f"{keys.CUE}/{name}", b"")
        told = set()
        while told != {f"{keys.POSE}/guide", f"{keys.CUE}/guide"}:
            told.add(heard.get(timeout=30))
        assert len(listening) == 3


def test_a_guide_may_plan_and_look_and_nothing_else(guarded, office):
    _, endpoint, folder = guarded
    made = office[0]
    with as_user("guide", folder, endpoint) as guide:
        assert guide.plan("office", made.start, made.goal, "roomba").status == "OK"
        assert "office" in guide.scenes()
        assert guide.status()[0].healthy
        guide.publish_obstacles("office", [blocker(made)])
        for key, request in (
            (keys.SCENE_UNLOAD, {"scene": "office"}),
            (keys.SCENE_LOAD, {"scene": "other", "file": "office.gpdf"}),
            (keys.SCENE_FILE, {"scene": "office", "version": 1}),
        ):
            assert list(guide._session.get(key, payload=msgspec.msgpack.encode(request), timeout=REFUSED_S)) == []
        assert list(guide.scenes()) == ["office"]
        assert guide.plan("office", made.start, made.goal, "roomba").status == "OK"  # its obstacle was not taken


def blocker(made):
    x, y = made.start[:2]
    return MovingObstacle(id="x", cylinder=Cylinder((float(x), float(y), 0.0), 0.5, 1.8), lifetime_s=600)


def test_a_camera_may_tell_of_obstacles_and_cannot_plan_or_read_maps(guarded, office):
    server, endpoint, folder = guarded
    made = office[0]
    with as_user("camera", folder, endpoint) as camera, as_user("guide", folder, endpoint) as guide:
        for key in server.handlers.by_key:
            assert list(camera._session.get(key, payload=b"\x80", timeout=REFUSED_S)) == []
        until = time.monotonic() + 30
        while guide.plan("office", made.start, made.goal, "roomba").status == "OK":
            camera.publish_obstacles("office", [blocker(made)])
            assert time.monotonic() < until


def test_an_operator_may_do_everything_and_a_planner_can_follow(guarded, office):
    _, endpoint, folder = guarded
    made = office[0]
    planner = Options(
        "",
        folder,
        folder / "planner",
        1,
        role="planner",
        connect=(endpoint,),
        zenoh=example("planner.json5", folder),
    )
    with Server(planner) as follower, as_user("operator", folder, endpoint) as operator:
        floor = made.points[made.ground]
        version = operator.load_scene("floor", upload=floor, ground=np.ones(len(floor), bool))["version"]
        part = operator.ask(keys.SCENE_FILE, FileRequest(scene="floor", version=version), FileReply, 10)
        assert 0 < len(part.data) <= 1_000_000
        until = time.monotonic() + 30
        while set(follower.shelf.facts()) != {"office", "floor"}:
            assert time.monotonic() < until
            time.sleep(0.05)
        operator.unload_scene("floor")
        assert list(operator.scenes()) == ["office"]


def test_only_certificates_of_our_authority_enter(tmp_path, free_endpoint, office, office_file):
    made = office[0]
    shutil.copy(office_file, tmp_path / "office.gpdf")
    subprocess.run([DOCKER / "security" / "make_certificates.sh", tmp_path, "localhost"], check=True)
    endpoint = free_endpoint.replace("tcp/127.0.0.1", "tls/localhost")
    options = Options(endpoint, tmp_path, tmp_path / "log", 1, zenoh=example("mtls.json5", tmp_path))
    client_file = example("mtls_client.json5", tmp_path, port=("tls/localhost:7447", endpoint))
    with Server(options, [("office", tmp_path / "office.gpdf")]) as server:
        server.shelf.settle()
        config = zenoh.Config.from_file(str(client_file))
        with Client.connect(config=config, timeout_s=10) as client:
            assert client.plan("office", made.start, made.goal, "roomba").status == "OK"
        other = tmp_path / "stranger"
        subprocess.run([DOCKER / "security" / "make_certificates.sh", other, "localhost"], check=True)
        shutil.copy(tmp_path / "ca.pem", other)  # it trusts us, and shows a certificate that we did not sign
        stranger = example("mtls_client.json5", other, port=("tls/localhost:7447", endpoint))
        assert_locked_out(zenoh.Config.from_file(str(stranger)))
        nobody = zenoh.Config()
        nobody.insert_json5("mode", '"client"')
        nobody.insert_json5("connect/endpoints", f'["{endpoint}"]')
        nobody.insert_json5("scouting/multicast/enabled", "false")
        nobody.insert_json5("transport/link/tls/root_ca_certificate", f'"{tmp_path / "ca.pem"}"')
        assert_locked_out(nobody)


def assert_locked_out(config):
    with pytest.raises(UnavailableError):  # noqa: SIM117
        with Client.connect(config=config, timeout_s=REFUSED_S) as client:
            client.wait_for_service(timeout_s=REFUSED_S)


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="needs systemd")
def test_systemd_reads_the_unit(tmp_path):
    text = (DOCKER / "gpdf.service").read_text().replace("/opt/gpdf/bin/gpdf", "/bin/true")
    (tmp_path / "gpdf.service").write_text(text)
    done = subprocess.run(["systemd-analyze", "verify", tmp_path / "gpdf.service"], capture_output=True, text=True)
    ours = [line for line in done.stderr.splitlines() if "gpdf.service" in line]
    assert ours == []


def test_the_unit_and_the_compose_file_name_only_options_that_exist():
    words = (DOCKER / "gpdf.service").read_text() + (DOCKER / "compose.yaml").read_text()
    named = set(re.findall(rf"{ENVIRONMENT}([A-Z_]+)", words))
    assert named
    assert {name.lower() for name in named} <= set(descriptions())
    flags = set(re.findall(r'"--([a-z-]+)"', words))
    assert {flag.replace("-", "_") for flag in flags} <= set(descriptions()) | {"map", "planner"}

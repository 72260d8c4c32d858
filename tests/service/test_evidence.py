"""What of an exchange is in the log, and what nobody can wash out of it."""

import hashlib

import msgpack
import numpy as np
import pytest
import zenoh
from gpdf_client.client import client_config
from gpdf_schemas import MAX_REQUEST_BYTES, Status, keys
from mcap.reader import make_reader

from gpdf_service.service.evidence import BURST_S, RATE, REFUSALS, WHOLE_BYTES, Evidence, digest_of
from gpdf_service.service.server import Options, Server

BLOB = np.random.default_rng(0).bytes(60_000)


@pytest.fixture
def clock():
    return [0.0]


@pytest.fixture
def evidence(clock):
    return Evidence(lambda: clock[0])


def test_a_long_body_is_its_size_its_hash_and_its_first_bytes():
    found = msgpack.unpackb(digest_of(BLOB))
    assert (found["bytes"], found["sha256"]) == (len(BLOB), hashlib.sha256(BLOB).hexdigest())
    assert BLOB.startswith(found["head"])
    assert digest_of(BLOB[:WHOLE_BYTES]) == BLOB[:WHOLE_BYTES]


def test_plans_are_whole_clouds_and_refused_requests_are_hashes(evidence):
    assert evidence.of("me", keys.PLAN, Status.OK, BLOB, BLOB) == (keys.PLAN, BLOB, BLOB)
    for key, status in ((keys.SCENE_UPLOAD, Status.BUILDING), (keys.PLAN, Status.INVALID_REQUEST)):
        assert evidence.of("me", key, status, BLOB, b"no") == (f"{key}/digest", digest_of(BLOB), b"no")
    assert evidence.of("me", keys.PLAN, Status.BUSY, b"small", b"no") == (keys.PLAN, b"small", b"no")


def test_a_client_that_sends_more_than_its_share_is_recorded_as_hashes_and_the_others_whole(evidence, clock):
    while evidence.of("greedy", keys.PLAN, Status.OK, BLOB, BLOB)[0] == keys.PLAN:
        pass
    assert evidence.of("modest", keys.PLAN, Status.OK, BLOB, BLOB)[0] == keys.PLAN
    clock[0] += BURST_S
    assert evidence.of("greedy", keys.PLAN, Status.OK, BLOB, BLOB)[0] == keys.PLAN
    assert 10 * len(BLOB) < RATE  # ten plans a second fit, for ever


def test_refused_requests_are_counted_once_they_are_too_many_also_under_ever_new_names(evidence):
    def kept(names):
        return sum(evidence.of(name, keys.PLAN, Status.INVALID_REQUEST, b"x", b"no") is not None for name in names)

    assert kept(["one"] * 100_000) == REFUSALS * BURST_S
    assert evidence.muted() == {"one": 100_000 - REFUSALS * BURST_S}
    assert evidence.muted() == {}
    assert kept(map(str, range(200_000))) <= 10 * REFUSALS * BURST_S


def test_what_is_published_without_end_is_hashed(evidence):
    key = keys.obstacles("office")
    assert evidence.publication(key, BLOB) == (key, BLOB)
    while evidence.publication(key, BLOB)[0] == key:
        pass
    assert evidence.publication(keys.obstacles("other"), BLOB)[1] == BLOB


def test_a_service_under_garbage_writes_little(tmp_path, free_endpoint):
    options = Options(free_endpoint, tmp_path, tmp_path / "log", 1)
    with Server(options) as server, zenoh.open(client_config(free_endpoint)) as session:
        for i in range(20):
            body = bytes([i]) + bytes(MAX_REQUEST_BYTES - 1)
            (answer,) = session.get(keys.PLAN, payload=body, timeout=60.0)
            assert msgpack.unpackb(answer.ok.payload.to_bytes())["status"] == "INVALID_REQUEST"
    path = server.recorder.path
    assert path.stat().st_size < 100_000
    with path.open("rb") as file:
        found = [m.data for _, c, m in make_reader(file).iter_messages() if c.topic == f"{keys.PLAN}/digest/request"]
    assert [msgpack.unpackb(data)["bytes"] for data in found] == [MAX_REQUEST_BYTES] * 20
    assert len({msgpack.unpackb(data)["sha256"] for data in found}) == 20

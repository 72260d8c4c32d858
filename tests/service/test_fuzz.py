import threading
import time

import msgpack
import numpy as np
import pytest
import zenoh
from gpdf_client.client import client_config
from gpdf_schemas import MAX_REQUEST_BYTES, DecodeError, decode, keys

from gpdf_service.bench.fuzz import KINDS, VALID, attack, malformed
from gpdf_service.bench.running import serving
from gpdf_service.service.handlers import Handlers
from gpdf_service.service.scenes import Shelf
from gpdf_service.service.server import Options, Server


def ask_raw(endpoint, key, payload):
    with zenoh.open(client_config(endpoint)) as session:
        return [answer.ok.payload.to_bytes() for answer in session.get(key, payload=payload, timeout=30)]


@pytest.mark.slow
def test_malformed_requests_get_typed_answers_and_valid_clients_are_served(tmp_path):
    with serving(tmp_path) as service:
        row = attack(service, 1000, np.random.default_rng(1))
    assert row["requests"] == 1000
    assert row["untyped"] == row["INTERNAL"] == row["valid_failed"] == 0
    assert row["alive"]
    assert row["valid_plans"] > 0
    assert row["INVALID_REQUEST"] > 500


@pytest.mark.parametrize("kind", KINDS[:-1], ids=lambda kind: kind.__name__)
def test_each_kind_of_damage_is_told_apart_from_a_request(kind, tmp_path):
    handlers = Handlers(Shelf(tmp_path), "")
    rng, refused = np.random.default_rng(0), 0
    for _ in range(200):
        key = str(rng.choice(list(VALID)))
        payload = kind(rng, dict(VALID[key][1]))
        try:
            decode(payload, handlers.by_key[key][0])
        except DecodeError:
            refused += 1
    assert refused > 20  # the rest is read, and refused by its handler


def test_the_fuzzer_repeats_itself_by_its_seed():
    one, two = ([malformed(rng) for _ in range(50)] for rng in (np.random.default_rng(3), np.random.default_rng(3)))
    assert one == two


def test_too_long_a_request_is_refused_before_it_waits_in_the_queue(tmp_path, free_endpoint, monkeypatch):
    gate, inside = threading.Event(), threading.Event()
    with Server(Options(free_endpoint, tmp_path, tmp_path, 1, queue=1)) as server:
        answer = server.handlers.answer

        def slow(*asked):
            inside.set()
            gate.wait(30)
            return answer(*asked)

        monkeypatch.setattr(server.handlers, "answer", slow)
        askers = [threading.Thread(target=ask_raw, args=(free_endpoint, keys.SCENES, msgpack.packb({}))) for _ in "ab"]
        askers[0].start()
        assert inside.wait(30)  # the one worker is held
        (raw,) = ask_raw(free_endpoint, keys.PLAN, bytes(MAX_REQUEST_BYTES + 1))
        gate.set()
        askers[0].join(30)
    reply = msgpack.unpackb(raw)
    assert reply["status"] == "INVALID_REQUEST"
    assert str(MAX_REQUEST_BYTES) in reply["message"]


def test_a_described_body_of_no_earthly_size_is_refused(tmp_path, office_file):
    shelf = Shelf(tmp_path)
    shelf.load_file("office", office_file, inside=False)
    shelf._builder.submit(lambda: None).result(30)
    body = {"name": "x", "height": 1.0, "width": 0.5, "length": 0.5, "max_step": 0.1, "max_slope": 0.1}
    body |= {"speed": 1.0, "acceleration": 1.0, "turn_rate": 1.0}
    slow = [{key: value} for key in ("speed", "acceleration", "turn_rate") for value in (1e-6, 5e-324, 1e308)]
    for change in ({"width": 1e-9}, {"length": 1e9}, {"height": 0.0}, {"width": True}, {"speed": -1.0}, *slow):
        request = {"scene": "office", "start": [1.0, 1.0], "goal": [2.0, 1.0], "agent": body | change}
        reply = msgpack.unpackb(Handlers(shelf, "").answer(keys.PLAN, msgpack.packb(request), time.monotonic()))
        assert reply["status"] == "INVALID_REQUEST"
    shelf.close()

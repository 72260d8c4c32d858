"""Answers to who does not read them hold up nobody else."""

import threading

import numpy as np
import pytest
import zenoh
from gpdf_client import Client
from gpdf_client.client import client_config
from gpdf_schemas import SceneRequest, encode, keys

import gpdf_service as gpdf
from gpdf_service.service.outbox import Outbox
from gpdf_service.service.server import Options, Server


@pytest.fixture
def outbox():
    made = Outbox()
    made.start()
    yield made
    made.close()


def test_who_gives_an_answer_does_not_wait_and_another_clients_answer_passes(outbox):
    gate, sent = threading.Event(), threading.Event()
    for _ in range(100):
        outbox.put(lambda: gate.wait(60), "sleeper", 1)
    outbox.put(sent.set, "reader", 1)
    assert sent.wait(30)
    gate.set()


def test_what_waits_is_sent_before_the_end_and_what_comes_later_at_once(outbox):
    told = []
    for i in range(100):
        outbox.put(lambda i=i: told.append(i), str(i % 7), 1)
    outbox.put(lambda: 1 / 0, "x", 1)  # an answer that cannot be sent ends no thread
    outbox.close()
    assert sorted(told) == list(range(100))
    outbox.put(lambda: told.append("late"), "x", 1)
    assert told[-1] == "late"


def test_what_waits_is_bounded_in_bytes(outbox, monkeypatch):
    monkeypatch.setattr("gpdf_service.service.outbox.MOST_BYTES", 100)
    gate, told = threading.Event(), []
    outbox.put(lambda: gate.wait(60), "sleeper", 60)
    outbox.put(lambda: told.append(threading.current_thread()), "sleeper", 60)
    assert told == [threading.current_thread()]  # here, by who gives it
    gate.set()
    outbox.close()
    assert outbox._bytes == 0


def test_answers_and_refusals_that_nobody_reads_hold_up_nobody_else(tmp_path, free_endpoint, monkeypatch):
    x, y = np.meshgrid(np.arange(0, 3, 0.05), np.arange(0, 3, 0.05))
    gpdf.build_scene(np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])).save(tmp_path / "floor.gpdf")
    gate, reply, stuck = threading.Event(), Server._reply, threading.Semaphore(0)

    def held(server, job, data, **more):
        if job.client == b"sleeper".hex():  # as Zenoh does where the link takes nothing
            stuck.release()
            gate.wait(120)
        reply(server, job, data, **more)

    monkeypatch.setattr(Server, "_reply", held)
    options = Options(free_endpoint, tmp_path, tmp_path / "log", 1, queue=8)
    with Server(options), Client.connect(free_endpoint) as client, zenoh.open(client_config(free_endpoint)) as sleeper:
        client.load_scene("floor", "floor.gpdf", timeout_s=120)
        for _ in range(50):
            sleeper.get(keys.SCENES, lambda _: None, payload=encode(SceneRequest()), attachment="sleeper", timeout=120)
        for _ in range(2):  # an answer, and a refusal of those for which there was no room
            assert stuck.acquire(timeout=60)
        assert client.plan("floor", (0.5, 1.5), (2.5, 1.5), "roomba").status == "OK"
        assert list(client.scenes()) == ["floor"]
        assert client.status()[0].healthy
        gate.set()

"""Nobody who asks seldom waits, or is turned away, for somebody who asks a lot."""

import shutil
import threading
from contextlib import ExitStack
from functools import partial

import zenoh
from gpdf_client import Client
from gpdf_client.client import client_config
from gpdf_schemas import PlanReply, PlanRequest, Status, decode, encode, keys
from hypothesis import given
from hypothesis import strategies as st

from gpdf_service.service.fair_queue import MOST_SENDING, FairQueue
from gpdf_service.service.server import Options, Server


def test_the_lines_take_turns_and_each_stays_in_order():
    queue = FairQueue(10)
    for item in ("a1", "a2", "a3", "b1", "c1", "b2"):
        assert queue.put(item, item[0]) is None
    assert [queue.get() for _ in range(6)] == ["a1", "b1", "c1", "a2", "b2", "a3"]
    assert queue.unfinished == 6
    for _ in range(6):
        queue.done()
    assert queue.unfinished == 0


def test_a_full_queue_turns_the_longest_line_away():
    queue = FairQueue(3)
    for item in ("a1", "a2", "a3"):
        assert queue.put(item, "a") is None
    assert queue.put("a4", "a") == "a4"
    assert queue.put("b1", "b") == "a3"
    assert queue.put("b2", "b") == "b2"
    assert queue.put("c1", "c") == "a2"
    assert queue.put("d1", "d") == "d1"  # everybody has one
    assert [queue.get() for _ in range(3)] == ["a1", "b1", "c1"]


@given(st.lists(st.one_of(st.sampled_from("abcde"), st.none()), max_size=60), st.integers(1, 8))
def test_nothing_is_lost_or_doubled_and_the_bound_holds(steps, size):
    queue = FairQueue(size)
    put, out = [], []
    for number, client in enumerate(steps):
        if client is None:
            out += (
                [queue.get()]
                if queue.unfinished - sum(item[0] == "got" for item in out) and len(put) > len(out)
                else []
            )
        else:
            item = (client, number)
            put.append(item)
            refused = queue.put(item, client)
            out += [refused] if refused is not None else []
        assert len(put) - len(out) <= size
    queue.close()
    assert queue.put(("z", -1), "z") == ("z", -1)
    while (item := queue.get()) is not None:
        out.append(item)
    assert sorted(out) == sorted(put)


def test_a_client_that_does_not_take_its_answers_has_no_turn_until_it_does():
    queue = FairQueue(10)
    for item in ("a1", "a2", "b1"):
        queue.put(item, item[0])
    with ExitStack() as stack:
        for _ in range(MOST_SENDING):
            stack.enter_context(queue.sending("a"))
        assert queue.get() == "b1"
        got = []
        waiting = threading.Thread(target=lambda: got.append(queue.get()))
        waiting.start()
        waiting.join(0.2)
        assert got == []
    waiting.join(10)
    assert got == ["a1"]
    queue.close()
    assert [queue.get(), queue.get()] == ["a2", None]


def test_who_waits_is_woken_by_an_item_and_by_the_end():
    queue, got = FairQueue(4), []
    waiting = [threading.Thread(target=lambda: got.append(queue.get())) for _ in range(3)]
    for thread in waiting:
        thread.start()
    queue.put("one", "a")
    queue.close()
    for thread in waiting:
        thread.join(10)
    assert sorted(map(str, got)) == ["None", "None", "one"]


def test_a_greedy_client_is_told_busy_and_a_polite_one_is_answered(
    free_endpoint, tmp_path, office, office_file, monkeypatch
):
    """One worker that is held; 200 requests of one client fill the queue of 8, then 10 of another come, in turn."""
    made = office[0]
    shutil.copy(office_file, tmp_path / "office.gpdf")
    options = Options(free_endpoint, tmp_path, tmp_path / "log", 1, queue=8)
    request = PlanRequest(scene="office", start=list(made.start), goal=list(made.goal), deadline_s=60.0)
    greedy, every, full, displaced = [], threading.Event(), threading.Event(), threading.Event()
    gate, inside = threading.Event(), threading.Event()
    with (
        Server(options, [("office", tmp_path / "office.gpdf")]) as server,
        Client.connect(free_endpoint) as polite,
        zenoh.open(client_config(free_endpoint)) as session,
    ):
        server.shelf.settle()
        polite.plan("office", made.start, made.goal)

        def hear(reply):
            greedy.append(decode(reply.ok.payload.to_bytes(), PlanReply).status)
            for count, event in ((191, full), (192, displaced), (200, every)):
                if len(greedy) == count:
                    event.set()

        def open_the_gate():
            displaced.wait(60)
            gate.set()

        answer = server.handlers.answer

        def held(*asked):
            inside.set()
            gate.wait(60)
            return answer(*asked)

        monkeypatch.setattr(server.handlers, "answer", held)
        opener = threading.Thread(target=open_the_gate)
        opener.start()
        ask = partial(session.get, keys.PLAN, hear, payload=encode(request), attachment="greedy", timeout=120)
        ask()
        assert inside.wait(60)
        for _ in range(199):
            ask()
        assert full.wait(60)  # one at work, 8 wait, the others were turned away
        statuses = []
        for _ in range(10):
            answers = polite.session.get(keys.PLAN, payload=encode(request), attachment="polite", timeout=120)
            statuses += [decode(answer.ok.payload.to_bytes(), PlanReply).status for answer in answers]
        assert every.wait(60)
        opener.join()
    assert statuses == [Status.OK] * 10
    assert (greedy.count(Status.OK), greedy.count(Status.BUSY)) == (8, 192)

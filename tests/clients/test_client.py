"""The client against what a real service would not say: garbage, half a reply, "busy", nothing."""

import inspect
import json
import threading
from contextlib import contextmanager

import gpdf_schemas
import msgpack
import pytest
import zenoh
from gpdf_client import AsyncClient, Client, ClientError, DecodeError, InvalidRequestError, UnavailableError
from gpdf_client.client import client_config
from gpdf_schemas import Array, DistanceReply, PlanReply, ScenesReply, Status, TrajectoryMessage, encode, keys

from gpdf_service.service.server import MAX_CLIENT_BYTES


@contextmanager
def answering(endpoint, key, answers):
    """A router that gives one answer after another (None: none at all); yields the requests that came."""
    config = zenoh.Config()
    config.insert_json5("mode", '"router"')
    config.insert_json5("listen/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    asked, waiting = [], list(answers)

    def answer(query):
        with query:
            asked.append(msgpack.unpackb(query.payload.to_bytes()))
            if (data := waiting.pop(0) if len(waiting) > 1 else waiting[0]) is not None:
                query.reply(key, data)

    with zenoh.open(config) as session:
        session.declare_queryable(key, answer, complete=True)
        yield asked


def test_each_client_has_a_line_of_its_own(free_endpoint):
    """A service's queue has a line for each attachment; without one a client would wait behind all the nameless."""
    config, names = zenoh.Config(), []
    config.insert_json5("mode", '"router"')
    config.insert_json5("listen/endpoints", json.dumps([free_endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")

    def answer(query):
        with query:
            names.append(query.attachment and query.attachment.to_bytes())
            query.reply(keys.SCENES, encode(ScenesReply()))

    with zenoh.open(config) as session:
        session.declare_queryable(keys.SCENES, answer, complete=True)
        for _ in range(2):
            with Client.connect(free_endpoint) as client:
                client.scenes()
                client.scenes()
    assert names[0] == names[1] != names[2] == names[3]
    assert all(0 < len(name) <= MAX_CLIENT_BYTES for name in names)


WRONG = [
    b"",
    b"\xff garbage",
    msgpack.packb({"status": "PERHAPS"}),
    msgpack.packb({"status": "OK", "trajectory": {"positions": 1}}),
    encode(PlanReply(trajectory=TrajectoryMessage(*[Array((2, 3), "f8", b"short")] * 4))),
]


@pytest.mark.parametrize("reply", WRONG)
def test_a_reply_that_cannot_be_read_is_an_error_of_the_client(free_endpoint, reply):
    with answering(free_endpoint, keys.PLAN, [reply]), Client.connect(free_endpoint) as client:
        with pytest.raises(DecodeError, match="CONVENTIONS") as caught:
            client.plan("a", (0, 0), (1, 1))
        assert isinstance(caught.value, ClientError)
        assert isinstance(caught.value, gpdf_schemas.DecodeError)


def test_an_array_that_cannot_be_read_is_an_error_of_the_client(free_endpoint):
    wrong = encode(DistanceReply(**dict.fromkeys(("distance", "gradient", "valid"), Array((3,), "f8", b"short"))))
    with (
        answering(free_endpoint, keys.DISTANCE, [wrong]),
        Client.connect(free_endpoint) as client,
        pytest.raises(ClientError, match="do not fill"),
    ):
        client.distance("a", "ground", [[0, 0, 0]])


def test_every_try_carries_the_same_request_id(free_endpoint):
    busy, done = encode(PlanReply(status=Status.BUSY)), encode(PlanReply(status=Status.NO_VALID_PATH))
    answers = [busy, None, busy, done]
    with answering(free_endpoint, keys.PLAN, answers) as asked, Client.connect(free_endpoint) as client:
        assert client.plan("a", (0, 0), (1, 1)).status is Status.NO_VALID_PATH
        assert len(asked) == 4
        assert len({request["request_id"] for request in asked}) == 1
        assert asked[0]["request_id"]
        client.plan("a", (0, 0), (1, 1))
        client.plan("a", (0, 0), (1, 1), request_id="mine")
        assert asked[4]["request_id"] != asked[0]["request_id"]
        assert asked[5]["request_id"] == "mine"


@pytest.mark.parametrize("key", [keys.DISTANCE, keys.SCENES, keys.SCENE_INFO, keys.SCENE_UNLOAD, keys.SCENE_LOAD])
def test_every_kind_of_request_carries_an_id(free_endpoint, key):
    calls = {
        keys.DISTANCE: lambda c: c.distance("a", "ground", [[0, 0, 0]]),
        keys.SCENES: lambda c: c.scenes(),
        keys.SCENE_INFO: lambda c: c.info("a"),
        keys.SCENE_UNLOAD: lambda c: c.unload_scene("a"),
        keys.SCENE_LOAD: lambda c: c.load_scene("a", "file"),
    }
    refusal = msgpack.packb({"status": "INVALID_REQUEST", "message": "no"})
    with answering(free_endpoint, key, [refusal]) as asked, Client.connect(free_endpoint) as client:
        with pytest.raises(InvalidRequestError, match="no"):
            calls[key](client)
        assert asked[0]["request_id"]


def test_a_deadline_beyond_every_clock_is_waited_for_in_pieces(free_endpoint):
    done = encode(PlanReply(status=Status.NO_VALID_PATH))
    with answering(free_endpoint, keys.PLAN, [done]) as asked, Client.connect(free_endpoint) as client:
        assert client.plan("a", (0, 0), (1, 1), deadline_s=1e300).status is Status.NO_VALID_PATH
        assert asked[0]["deadline_s"] == 1e300


@pytest.mark.parametrize("deadline_s", [float("inf"), float("nan"), 0.0, -1.0])
def test_a_deadline_that_is_none_is_an_invalid_request(free_endpoint, deadline_s):
    with answering(free_endpoint, keys.PLAN, [b""]) as asked, Client.connect(free_endpoint) as client:
        with pytest.raises(InvalidRequestError, match="positive, finite"):
            client.plan("a", (0, 0), (1, 1), deadline_s=deadline_s)
        assert asked == []


def test_a_closed_client_leaves_no_thread_behind(free_endpoint):
    """One that is inside Zenoh when Python ends aborts the program."""
    with answering(free_endpoint, keys.PLAN, [b""]):
        before = set(threading.enumerate())
        with Client.connect(free_endpoint):
            assert set(threading.enumerate()) - before
        assert not set(threading.enumerate()) - before  # others may have ended


def test_nobody_there_is_unavailable(free_endpoint):
    with pytest.raises(UnavailableError, match="gpdf serve"):
        Client.connect(free_endpoint, timeout_s=0.1)
    with pytest.raises(UnavailableError, match=free_endpoint):  # the endpoint that was asked for, not the default one
        Client.connect(config=client_config(free_endpoint), timeout_s=0.1)
    with (
        answering(free_endpoint, keys.PLAN, [None]),
        Client.connect(free_endpoint) as client,
        pytest.raises(UnavailableError, match="Is the service running"),
    ):
        client.plan("a", (0, 0), (1, 1), deadline_s=0.3)


def test_a_slip_is_an_error_of_the_client_that_says_what_to_pass(free_endpoint):
    with pytest.raises(ClientError, match="is no endpoint"):
        Client.connect("127.0.0.1:7447")
    with answering(free_endpoint, keys.PLAN, []):
        client = Client.connect(free_endpoint)
        with pytest.raises(InvalidRequestError, match="is no place"):
            client.plan("a", (0, 0), (1, 1), via=(3, 1))  # one place where a list of them belongs
        client.close()
        with pytest.raises(UnavailableError, match="closed"):
            client.plan("a", (0, 0), (1, 1))


def test_the_asyncio_client_has_every_call_with_the_same_arguments():
    calls = {name for name, _ in inspect.getmembers(Client, callable) if not name.startswith("_")}
    calls -= {"ask", "ask_planner"}
    assert calls >= {"plan", "info", "wait_for_scene"}
    for name in calls:
        ours, theirs = (inspect.signature(getattr(kind, name)).parameters.values() for kind in (Client, AsyncClient))
        assert [(p.name, p.kind, p.annotation) for p in ours] == [(p.name, p.kind, p.annotation) for p in theirs], name

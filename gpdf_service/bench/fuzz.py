"""`gpdf bench fuzz`: malformed requests by the hundred thousand against the real service, valid clients beside them."""

from __future__ import annotations

import argparse
import sys
import tempfile
import threading
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import zenoh
from gpdf_client import Client
from gpdf_client.client import client_config
from gpdf_schemas import MAX_REQUEST_BYTES, Array, DecodeError, Reply, decode, encode, keys, messages
from tqdm import tqdm

from gpdf_service.bench.report import Row, show
from gpdf_service.bench.running import Running, serving

Rng = np.random.Generator
Fields = dict[str, Any]
ASKERS = 4
"""Threads that ask at once: the wait for one answer hides behind the others."""
ANSWER_S = 60.0
"""[s] A request without an answer after this had none."""
CLAIM = 1 << 30
"""Bytes that a few bytes claim to bring."""
SHARE_OF_LONG = 0.001
"""Requests above the limit of 4 MiB: each takes as long as hundreds of the others."""
PLACE = [1.0, 1.0]
ARRAY = {"shape": [2, 3], "dtype": "f8", "data": bytes(48)}
ONES = {"shape": [2], "dtype": "f4", "data": np.ones(2, "<f4").tobytes()}
BODY = {"height": 1.0, "width": 0.5, "length": 0.5, "max_step": 0.1, "max_slope": 0.1}
VALID: dict[str, tuple[type[Reply], Fields]] = {
    keys.PLAN: (
        messages.PlanReply,
        {"scene": "office", "start": PLACE, "goal": PLACE, "agent": "human", "obstacles": []},
    ),
    keys.DISTANCE: (messages.DistanceReply, {"scene": "office", "field": "ground", "points": ARRAY}),
    keys.SCENES: (messages.ScenesReply, {"request_id": "1"}),
    keys.SCENE_INFO: (messages.SceneReply, {"scene": "office"}),
    keys.SCENE_LOAD: (messages.SceneReply, {"scene": "fuzz", "file": "none.npz"}),
    keys.SCENE_UPLOAD: (
        messages.SceneReply,
        {"scene": "fuzz", "upload_id": "1", "part": 0, "parts": 2, "points": ARRAY},
    ),
    keys.SCENE_UPDATE: (
        messages.SceneReply,
        {"scene": "office", "upload_id": "1", "part": 0, "parts": 3, "points": ARRAY, "gone": ONES, "radius": 0.05},
    ),
    keys.SCENE_PLACES: (messages.PlacesReply, {"scene": "office"}),
    keys.SCENE_PLACE: (messages.PlacesReply, {"scene": "office", "name": "door", "position": PLACE}),
    keys.SCENE_UNLOAD: (messages.SceneReply, {"scene": "fuzz"}),
    keys.SCENE_FILE: (messages.FileReply, {"scene": "office", "version": 1, "offset": 0}),
}
ODD: tuple[Any, ...] = (
    *(None, True, -1, 0, 2**63, -(2**63), 1e308, 5e-324, float("nan"), float("inf"), "", "x" * 70, "\0", b"\xff"),
    *("../../etc/passwd", "/dev/zero", "y" * 300, [], [[]], {}, {"a": {}}, [1.0], [1e308, -1e308], {1: 2}),
    *(msgpack.ExtType(5, b"x"), msgpack.Timestamp(1), ["a"] * 50, BODY, BODY | {"name": "x", "width": 1e-9}),
    *({**ARRAY, "shape": [CLAIM, 3]}, {**ARRAY, "shape": [-1, -6]}, {**ARRAY, "dtype": "O"}, {**ARRAY, "data": b""}),
    {"shape": [1, 3], "dtype": "f8", "data": np.full(3, np.nan).tobytes()},
    *([{"points": ARRAY}], [{"cylinder": [PLACE, 1e9, 1]}], [{"cylinder": [[1.0, 1.0, 0.0], 0.3, 1e-300]}], [{}] * 999),
)
"""Values where another was expected."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    parser.add_argument("--count", type=int, default=100_000, help="malformed requests")
    parser.add_argument("--seed", type=int, default=0, help="of the requests")
    parser.add_argument("--json", action="store_true", help="print the row as JSON")


def run(args: argparse.Namespace) -> int:
    """Exit code 0 if each request had a typed answer, none failed inside, and every valid plan was OK."""
    with tempfile.TemporaryDirectory() as folder, serving(Path(folder)) as service:
        row = attack(service, args.count, np.random.default_rng(args.seed))
    show([row], as_json=args.json)
    return 0 if row["untyped"] == row["INTERNAL"] == row["valid_failed"] == 0 and row["alive"] else 1


def attack(service: Running, count: int, rng: Rng) -> Row:
    """Send them and count the answers by status; a client plans all the while."""
    before, found, done = service.usage(), Counter[str](), threading.Event()
    lock = threading.Lock()
    bar = tqdm(total=count, desc="fuzz", disable=not sys.stderr.isatty())
    with zenoh.open(client_config(service.endpoint)) as session, ThreadPoolExecutor(ASKERS + 1) as pool:

        def ask_many(mine: Rng) -> None:
            for _ in range(count // ASKERS):
                status = ask(session, *malformed(mine))
                with lock:
                    found[status] += 1
                bar.update()

        valid = pool.submit(_plan_on, service, done)
        askers = [pool.submit(ask_many, mine) for mine in rng.spawn(ASKERS)]
        try:
            for asker in askers:
                asker.result()
        finally:
            done.set()
        planned, failed = valid.result()
    bar.close()
    return {
        "requests": sum(found.values()),
        "untyped": found.pop("untyped", 0),
        "INTERNAL": found.pop("INTERNAL", 0),
        **dict(sorted(found.items())),
        "valid_plans": planned,
        "valid_failed": failed,
        "alive": service.process.poll() is None,
        "rss_mb_before": before["rss_mb"],
        "rss_mb_after": service.usage()["rss_mb"],
    }


def ask(session: zenoh.Session, key: str, payload: bytes) -> str:
    """The status of the one answer, or "untyped"."""
    replies = list(session.get(key, payload=payload, timeout=ANSWER_S))
    if len(replies) != 1 or replies[0].ok is None:
        return "untyped"
    try:
        return decode(replies[0].ok.payload.to_bytes(), VALID[key][0]).status.value
    except DecodeError:
        return "untyped"


def malformed(rng: Rng) -> tuple[str, bytes]:
    """A key, and bytes that nobody should send there."""
    key = str(rng.choice(list(VALID)))
    if rng.random() < SHARE_OF_LONG:
        return key, msgpack.packb({**VALID[key][1], "scene": "x" * (MAX_REQUEST_BYTES + 1)})
    spoil: Callable[[Rng, Fields], bytes] = KINDS[rng.integers(len(KINDS))]
    return key, spoil(rng, dict(VALID[key][1]))


def random_bytes(rng: Rng, _: Fields) -> bytes:
    """Noise."""
    return rng.bytes(int(rng.integers(0, 200)))


def truncated(rng: Rng, fields: Fields) -> bytes:
    """Cut anywhere but at the end."""
    raw: bytes = msgpack.packb(fields)
    return raw[: rng.integers(len(raw))]


def flipped(rng: Rng, fields: Fields) -> bytes:
    """One to four bytes changed."""
    raw = bytearray(msgpack.packb(fields))
    for _ in range(rng.integers(1, 5)):
        raw[rng.integers(len(raw))] = rng.integers(256)
    return bytes(raw)


def nested(rng: Rng, fields: Fields) -> bytes:
    """Lists or maps in one another, up to 50,000 deep, alone or as a field."""
    layer: bytes = (b"\x91", b"\x81\xa1a")[rng.integers(2)]
    deep: bytes = layer * int(10 ** rng.uniform(2, 4.7)) + b"\xc0"
    if rng.random() < 0.5:
        return deep
    return b"\x81" + bytes(msgpack.packb(str(rng.choice(list(fields))))) + deep


def huge_header(rng: Rng, fields: Fields) -> bytes:
    """A few bytes that claim up to 4 GB to follow: text, binary, list, map, extension."""
    size = (CLAIM, 0xFFFFFFFF, int(rng.integers(1 << 32)))[rng.integers(3)].to_bytes(4, "big")
    claim: bytes = (b"\xdb", b"\xc6", b"\xdd", b"\xdf", b"\xc9")[rng.integers(5)] + size + b"xyz"
    if rng.random() < 0.5:
        return claim
    return b"\x81" + bytes(msgpack.packb(str(rng.choice(list(fields))))) + claim


def wrong_type(rng: Rng, fields: Fields) -> bytes:
    """An odd value in place of one or two of the right ones, also where an array's parts belong."""
    for _ in range(rng.integers(1, 3)):
        name = str(rng.choice([*fields, "agent", "deadline_s", "request_id", "ground", "method", "obstacles"]))
        fields[name] = ODD[rng.integers(len(ODD))]
    return bytes(msgpack.packb(fields))


def not_finite(rng: Rng, fields: Fields) -> bytes:
    """NaN or infinity as a coordinate or a deadline."""
    value = (float("nan"), float("inf"), float("-inf"))[rng.integers(3)]
    name = str(rng.choice(["start", "goal", "deadline_s", "later"]))
    return bytes(msgpack.packb({**fields, name: value if name == "deadline_s" else [value, 1.0]}))


def missing(rng: Rng, fields: Fields) -> bytes:
    """Without one of its fields, and with some that nobody knows."""
    fields.pop(str(rng.choice(list(fields))))
    return bytes(msgpack.packb(fields | {f"unknown_{i}": i for i in range(rng.integers(50))}))


def array_lies(rng: Rng, fields: Fields) -> bytes:
    """A shape that its bytes do not fill, up to more than any memory."""
    shape = [int(n) for n in rng.integers(-3, 1 << int(rng.integers(3, 62)), rng.integers(0, 4))]
    lie = Array(tuple(shape), ("f8", "f4", "i8", "")[rng.integers(4)], rng.bytes(int(rng.integers(0, 64))))
    return bytes(msgpack.packb(fields | {"points": msgpack.unpackb(encode(lie))}))


KINDS = (random_bytes, truncated, flipped, nested, huge_header, wrong_type, not_finite, missing, array_lies)


def _plan_on(service: Running, done: threading.Event) -> tuple[int, int]:
    planned = failed = 0
    with Client.connect(service.endpoint) as client:
        while not done.is_set():
            planned += 1
            failed += client.plan("office", service.start, service.goal, "roomba").status != "OK"
    return planned, failed

"""Random requests, sensible and odd, of several clients at once: what they get, and whether it is true."""

from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from itertools import chain

import msgpack
import numpy as np
import pytest
import zenoh
from gpdf_client import Client
from gpdf_client.client import client_config
from gpdf_schemas import Array, MovingObstacle, Status, decode, encode, keys, messages
from gpdf_schemas.moving import points_of, stacked
from msgspec import convert

import gpdf_service as gpdf
from gpdf_service.bench.fuzz import BODY, VALID
from gpdf_service.bench.houses import free_places
from gpdf_service.bench.judge import Judge
from gpdf_service.bench.running import serving
from gpdf_service.errors import GpdfError
from gpdf_service.service.planning import agent_of, to_trajectory
from gpdf_service.synthetic import SCENES
from gpdf_service.types import AGENTS, resolve_agent

CLIENTS, REQUESTS, SEED = 3, 50, 0
PLANS, ODD_ONES = 0.6, 0.2
"""[-] Shares of the requests: for a plan; with something else in one field."""
DEEPEST = 0.003
"""[m] Into a true point, of a path over a floor that is known by cells."""
KINDS = {key: kind for key, (kind, _) in VALID.items()} | {keys.SCENE_DRAW: messages.DrawReply}
ODD = [np.nan, np.inf, -np.inf, 1e308, 5e-324, 2**64 - 1, -(2**63), True, None, "x\0y", "", [], {}, b"\xff", -1.0]
OPTIONS = "method", "via", "other_goals", "snap", "start_heading", "goal_heading", "prefer", "alternatives"


def array(values):
    return msgpack.unpackb(encode(Array.pack(np.asarray(values, float))))


def random_plan(rng, places):
    def place():
        return rng.choice(places)[:2].tolist() if rng.random() < 0.9 else rng.uniform(-0.3, 8, 2).tolist()

    body = dict.fromkeys(("speed", "acceleration", "turn_rate"), 1.0) | {"name": "b"} | BODY
    body |= {name: rng.uniform(0.1, 0.8) for name in ("width", "length", "height")}
    bodies = [*map(str, rng.permutation(list(AGENTS))[:2]), body, body | {"discs": 3}]
    cylinder = {"base": [*place(), 0.0], "radius": rng.uniform(0.1, 1), "height": rng.uniform(0.2, 2)}
    more = {"via": [place(), place()], "other_goals": [place()], "obstacles": [{"id": "o", "cylinder": cylinder}]}
    more |= {"snap": rng.uniform(0, 2), "start_heading": rng.uniform(-9, 9), "goal_heading": rng.uniform(-9, 9)}
    more |= {"prefer": str(rng.choice(["quickest", "level", "wide"])), "alternatives": int(rng.integers(1, 3))}
    more |= {"method": str(rng.choice(["astar", "prm", "none"])), "deadline_s": float(rng.choice([0.001, 0.1, 60.0]))}
    asked = {"scene": "office", "start": place(), "goal": place(), "agent": bodies[rng.integers(len(bodies))]}
    return keys.PLAN, asked | {key: value for key, value in more.items() if rng.random() < 0.15}


def random_other(rng, me):
    scene, own = {"scene": str(rng.choice(["office", "other", "none", "../x"]))}, {"scene": f"{me}-{rng.integers(2)}"}
    points = rng.uniform(0, 6, (4, int(rng.choice([2, 3, 3, 3]))))
    part = {"points": array(points), "upload_id": "u", "part": int(rng.integers(2)), "parts": int(rng.integers(3))}
    floor = np.stack(np.meshgrid(np.arange(0, 3, 0.05), np.arange(0, 3, 0.05), [0.0]), axis=-1).reshape(-1, 3)
    drawing = {"what": str(rng.choice(["cloud", "ground", "leaves", "x"])), "limit": int(rng.choice([-1, 100, 2000]))}
    asked = [
        (keys.DISTANCE, scene | {"field": str(rng.choice(["ground", "obstacle"])), "points": array(points)}),
        (keys.SCENE_UPLOAD, own | {"points": array(floor), "upload_id": "w", "part": 0, "parts": 1}),
        (keys.SCENE_UPLOAD, own | part),
        (keys.SCENE_UPDATE, {"scene": "other", "gone": array(rng.random(4) > 0.5), "radius": 0.05} | part),
        (keys.SCENE_LOAD, {"scene": "other", "file": str(rng.choice(["office.npz", "none.npz", "../a", "."]))}),
        (keys.SCENE_UNLOAD, {"scene": "other"} if rng.random() < 0.5 else own),
        (keys.SCENE_PLACE, scene | {"name": str(rng.choice(["a", "a,b"])), "position": [1.0, 1.0]}),
        (keys.SCENE_DRAW, scene | drawing | {"part": int(rng.integers(2))}),
        (keys.SCENE_FILE, scene | {"version": int(rng.integers(4)), "offset": int(rng.choice([-1, 0, 9]))}),
    ]
    return asked[rng.integers(len(asked))]


def ask_away(me, endpoint, places):
    rng, found = np.random.default_rng([SEED, me]), []
    with zenoh.open(client_config(endpoint)) as session:
        for i in range(REQUESTS):
            key, asked = random_plan(rng, places) if rng.random() < PLANS else random_other(rng, me)
            asked["request_id"], is_odd = f"{me}-{i}", rng.random() < ODD_ONES
            if is_odd:
                asked[str(rng.choice(list(asked)))] = ODD[rng.integers(len(ODD))]
            answers = list(session.get(key, payload=msgpack.packb(asked), timeout=600))  # however slow the machine is
            read = [None if one.ok is None else decode(one.ok.payload.to_bytes(), KINDS[key]) for one in answers]
            found.append((key, asked, is_odd, read))
    return found


def is_typed(read):
    """Whether a request got one answer, which says why where it is not OK, and which is certified where it is."""
    if len(read) != 1 or read[0] is None or read[0].status is Status.INTERNAL:
        return False
    if read[0].status is not Status.OK:
        return len(read[0].message) > 8
    ways = [read[0], *read[0].alternatives] if isinstance(read[0], messages.PlanReply) else []
    return all(way.trajectory is not None and way.certificate.holds for way in ways)


def around(asked):
    return stacked([points_of(convert(one, MovingObstacle)) for one in asked.get("obstacles", ())])


def in_process(scene, asked):
    """The status of the same plan without a service."""
    options = {name: asked[name] for name in OPTIONS if name in asked}
    try:
        there = scene.with_obstacles(around(asked))
        return gpdf.plan(there, asked["start"], asked["goal"], agent_of(asked["agent"]), **options).status.value
    except (GpdfError, ValueError):
        return "INVALID_REQUEST"


def depth(office, asked, reply):
    """How deep a body on its path would be in something [m]."""
    points = np.concatenate([office.points, around(asked)])
    judge = Judge(points, np.pad(office.ground, (0, len(points) - len(office.ground))))
    return judge.judge(to_trajectory(reply.trajectory), resolve_agent(agent_of(asked["agent"]))).penetration


def told(client):
    (status,) = client.status()
    return status.problems, [status.metrics[name] for name in ("scenes", "scenes_in_memory", "process_restarts")]


@pytest.mark.slow
def test_whatever_several_ask_at_once_gets_one_answer_and_it_is_true(tmp_path):
    office = SCENES["office"](np.random.default_rng(0))
    with serving(tmp_path, "--workers", "2") as service, Client.connect(service.endpoint) as client:
        (file,) = (tmp_path / "log" / "state").glob("office@*.gpdf")
        scene, before = gpdf.load_scene(file), told(client)
        places = free_places(scene, AGENTS["human"], 300, np.random.default_rng(SEED))
        with ThreadPoolExecutor(CLIENTS) as pool:
            found = [*chain(*pool.map(lambda me: ask_away(me, service.endpoint, places), range(CLIENTS)))]
        assert client.plan("office", service.start, service.goal).status == "OK"
        for name in set(client.scenes()) - {"office"}:
            client.unload_scene(name)
        assert told(client) == before
        assert list(file.parent.glob("*.gpdf")) == [file]
    assert "Traceback" not in (tmp_path / "serve.log").read_text()
    assert [exchange for exchange in found if not is_typed(exchange[-1])] == []

    plans = [(asked, reply) for key, asked, is_odd, (reply,) in found if key == keys.PLAN and not is_odd]
    same = [(in_process(scene, asked), reply.status.value, asked) for asked, reply in plans[::2]]
    assert [one for one in same if one[1] not in (one[0], "TIMEOUT")] == []
    ours = [(asked, reply) for asked, reply in plans if reply.status is Status.OK and "method" not in asked]
    assert max(depth(office, *pair) for pair in ours[::2]) <= DEEPEST
    seen = Counter(reply.status.value for _, _, _, (reply,) in found)
    assert min(len(same), len(ours), seen["INVALID_REQUEST"], seen["UNKNOWN_SCENE"], len(seen)) > 5

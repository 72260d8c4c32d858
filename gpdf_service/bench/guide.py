"""`gpdf bench guide`: people with human errors are guided through scenes by the real service.

Contacts are looked for in the clean cloud at every 50 ms of every walk.
"""

from __future__ import annotations

import argparse
import dataclasses
import socket
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path

import numpy as np
from gpdf_client import Client, ClientError
from gpdf_guidance import Guide, Kind, Outcome, Planner, Walk, Walker, simulate
from gpdf_guidance.features import FeatureKind
from gpdf_guidance.guide import LEAST_ROOM, PERSON
from tqdm import tqdm

from gpdf_service.bench.cues import measure_cues
from gpdf_service.bench.plan import random_places
from gpdf_service.bench.plotting import add_plot_argument, draw_rows
from gpdf_service.bench.report import Row, add_scene_arguments, clouds, show
from gpdf_service.bench.walks import WalkedWorld
from gpdf_service.scene import Scene
from gpdf_service.service.server import Options, Server
from gpdf_service.types import AGENTS, BoolArray, FloatArray

STANDING_ROOM = 0.8
"""[m] Width of the place where a walk begins and ends: a person can turn there without touching anything."""
WAY = 2 * (PERSON["width"] / 2 + LEAST_ROOM)
"""[m] Width of a way that people are guided on."""
LEAST_WALK = 4.0
"""[m] As the crow flies; nobody needs to be led for less."""
SCANS = ("../shared/data/house_2storey_stairs_4cm.npz", "../shared/data/subt_urban_alpha_lower.npz")
"""Walked too where they are: long ways. In the scanned offices no way of 4 m is wide enough for a person to be led."""
TRIES = 5
"""Pairs of places without an answer of the service before a scene is given up: one that compiles is late once."""
PANELS = {
    "walks": ("walks", "arrived", "safe_stops", "contacts"),
    "words a minute": ("said_per_min",),
    "steps and stairs": ("steps_and_stairs", "announced_1_to_3_m"),
}
"""Of the picture."""

Guided = tuple[Walk, Guide]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    scans = [str(path) for path in map(Path, SCANS) if path.is_file()]
    add_scene_arguments(parser, ["office", "cluttered_office", "stair", "cow_and_lady", *scans])
    parser.add_argument("--count", type=int, default=50, help="walks in each scene")
    parser.add_argument("--live", type=float, metavar="S", help="also measure cues in real time, for S seconds a scene")
    add_plot_argument(parser)
    parser.add_argument("--seed", type=int, default=1)


def run(args: argparse.Namespace) -> int:
    """Exit code 0 if nobody touched anything and everybody arrived or was stopped safely."""
    rows: list[Row] = []
    everything: list[Guided] = []
    for name, points, ground in clouds(args):
        walks: list[Guided] = []
        unanswered: list[str] = []
        found: Row = {}
        try:
            with serving(name, points, ground) as (server, client):
                for one in walk_all(server, client, name, args.count, args.seed, unanswered):
                    walks.append(one)  # what was walked is kept when the next one fails
                found = live(client, server.options.endpoint, name, walks, args.live) if args.live and walks else {}
        except ClientError as error:  # the walks until then count, and those in the other scenes
            found = {"failed": str(error)}
        everything += walks
        found |= {"unanswered": len(unanswered)} if unanswered else {}
        rows.append({"scene": name, **summary(walks), **found})
    total = summary(everything)
    rows.append({"scene": "all", **total})
    show(rows, as_json=args.json)
    if args.plot:
        draw_rows(args.plot, rows, PANELS, by=("scene",), title=f"{args.count} guided walks in each scene")
    ended = total["arrived"] + total["safe_stops"] == total["walks"]
    return 0 if total["contacts"] == 0 and ended and not any("failed" in row for row in rows) else 1


@contextmanager
def serving(name: str, points: FloatArray, ground: BoolArray | None) -> Iterator[tuple[Server, Client]]:
    """The real service with one scene, and a client of it."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    with tempfile.TemporaryDirectory() as folder:
        options = Options(endpoint, Path(folder), Path(folder))
        with Server(options) as server, Client.connect(endpoint) as client:
            client.load_scene(name, upload=points, ground=ground)
            yield server, client


def walk_all(
    server: Server, client: Client, name: str, count: int, seed: int, unanswered: list[str]
) -> Iterator[Guided]:
    """Walk between `count` random pairs of places, one after the other; pairs without an answer are noted."""
    entry = server.shelf.get(name)
    assert entry is not None
    assert entry.scene is not None
    scene, rng = entry.scene, np.random.default_rng(seed)
    world = WalkedWorld.of(scene.points, scene.ground)
    pairs = islice(connected_pairs(client, scene, name, count, rng, unanswered), count)
    for start, goal in tqdm(pairs, desc=name, total=count, disable=None):
        world.fell = False
        z = float(world.judge.ground[world.judge.ground_plan.query(start)[1], 2])
        heading = float(rng.uniform(-np.pi, np.pi))
        walker = Walker(np.array([*start, z]), heading, world.ground_height, rng)
        guide = Guide(Planner(client, name), goal.tolist())
        yield simulate(guide, walker, world), guide


def connected_pairs(
    client: Client, scene: Scene, name: str, count: int, rng: np.random.Generator, unanswered: list[str]
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Pairs of places (2,) [m] where a person has room to stand, joined by a way that is wide enough.

    Raises:
        ClientError: `TRIES` pairs had no answer.
    """
    wide = dataclasses.replace(AGENTS["human"], width=STANDING_ROOM)
    pairs = random_places(scene, wide, 40 * count, rng)
    body = {**PERSON, "width": WAY}
    for start, goal in pairs[np.hypot(*(pairs[:, 1] - pairs[:, 0]).T) >= LEAST_WALK]:
        try:
            joined = client.plan(name, start, goal, body).trajectory is not None
        except ClientError as error:
            unanswered.append(str(error))
            if len(unanswered) >= TRIES:
                raise
            continue
        if joined:
            yield start, goal


def live(client: Client, endpoint: str, name: str, walks: list[Guided], seconds: float) -> Row:
    """Delays of the cues on the way of the first walk."""
    walk, guide = walks[0]
    return measure_cues(client, endpoint, name, walk.places[0], np.array(guide.goal), seconds)


def summary(walks: list[Guided]) -> Row:
    """Numbers of many walks."""
    minutes = sum(float(walk.times[-1]) for walk, _ in walks) / 60.0
    announced = [place for walk, guide in walks for place in step_announcements(walk, guide)]
    return {
        "walks": len(walks),
        "arrived": sum(walk.outcome is Outcome.ARRIVED for walk, _ in walks),
        "safe_stops": sum(walk.outcome is Outcome.SAFE_STOP for walk, _ in walks),
        "contacts": sum(walk.penetration > 0 for walk, _ in walks),
        "deepest_m": max((walk.penetration for walk, _ in walks), default=0.0),
        "metres_per_walk": sum(walk.metres for walk, _ in walks) / max(len(walks), 1),
        "said_per_min": sum(len(walk.said) for walk, _ in walks) / max(minutes, 1e-9),
        "minutes": minutes,
        "stopped_share": sum(walk.stopped for walk, _ in walks) / max(60.0 * minutes, 1e-9),
        "routes": sum(walk.routes for walk, _ in walks) / max(len(walks), 1),
        "steps_and_stairs": len(announced),
        "announced_1_to_3_m": sum(1.0 <= place <= 3.0 for place in announced),
    }


def step_announcements(walk: Walk, guide: Guide) -> list[float]:
    """How far before each step or stair of the first route it was told of [m]; inf where it was not.

    One that lies within a metre of where the walk begins cannot be told of earlier, so it is left out.
    """
    if not guide.routes or walk.outcome is not Outcome.ARRIVED:
        return []
    route = guide.routes[0]
    told = [said.instruction for said in walk.said if said.instruction.kind in (Kind.STEP, Kind.STAIRS)]
    found = []
    for feature in route.features:
        if feature.kind in (FeatureKind.STEP, FeatureKind.STAIRS) and feature.start > 1.0:
            mine = [one.distance for one in told if np.hypot(*(route.at(feature.start)[:2] - one.place)) < 0.8]
            found.append(mine[0] if mine else float("inf"))
    return found

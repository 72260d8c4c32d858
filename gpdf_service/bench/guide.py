"""`gpdf bench guide`: people with human errors are guided through scenes by the real service.

Contacts are looked for in the clean cloud at every 50 ms of every walk.
"""

from __future__ import annotations

import argparse
import dataclasses
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from pathlib import Path

import numpy as np
from gpdf_client import Client, ClientError
from gpdf_guidance import Guide, Kind, Outcome, Planner, Walk, Walker, simulate
from gpdf_guidance.announcer import STEPS
from gpdf_guidance.features import TREAD
from gpdf_guidance.planner import LEAST_ROOM, PERSON
from gpdf_guidance.simulate import TICK
from gpdf_guidance.speech import spoken_in
from gpdf_guidance.stairs import LEAST_EDGE
from tqdm import tqdm

from gpdf_service.bench.cues import measure_cues
from gpdf_service.bench.plotting import add_plot_argument, draw_rows
from gpdf_service.bench.report import Row, add_scene_arguments, read_scene, show
from gpdf_service.bench.walks import COVERS, RADIUS, STOREY, Beset, Crowd, WalkedWorld
from gpdf_service.ports import free_endpoint
from gpdf_service.scene import Scene
from gpdf_service.service.server import Options, Server
from gpdf_service.synthetic import ramp, random_room
from gpdf_service.synthetic.house import make_house
from gpdf_service.types import AGENTS, Agent, BoolArray, FloatArray

STANDING_ROOM = 0.8
"""[m] Width of the place where a walk begins and ends: a person can turn there without touching anything."""
WAY = 2 * (PERSON["width"] / 2 + LEAST_ROOM)
"""[m] Width of a way that people are guided on."""
LEAST_WALK = 4.0
"""[m] As the crow flies; nobody needs to be led for less."""
SCANS = ("../shared/data/house_2storey_stairs_4cm.npz", "../shared/data/subt_urban_alpha_lower.npz")
"""Walked too where they are: long ways. In the scanned offices no way of 4 m is wide enough for a person to be led."""
CANDIDATES = 2000
"""Places on each storey from which starts and goals are drawn, however many walks there are."""
TRIES = 5
"""Pairs of places without an answer of the service before a scene is given up: one that compiles is late once."""
PEOPLE = 2
"""Who walk about in every second walk."""
STANDING = (
    Kind.OVERVIEW,
    Kind.ASK_STEP,
    Kind.ASK_STEP_OR_DETOUR,
    Kind.CONSENTED,
    Kind.DECLINED,
    Kind.ARRIVED,
    Kind.ARRIVED_BESIDE,
)
EDGE_NEAR = 0.8
"""[m] A sentence is about the edge that is this near to the place of which it speaks."""
REASONS = tuple(kind for kind in Kind if kind.value.startswith(("gave_up", "no_way", "no_answer")))
PANELS = {
    "walks": ("walks", "arrived", "safe_stops", "contacts"),
    "words a minute": ("said_per_min",),
    "edges": ("edges", "edges_told"),
}
"""Of the picture."""


def _made(name: str) -> tuple[FloatArray, BoolArray]:
    """A made scene that is random: a name and a seed, as in "house:3"."""
    kind, _, seed = name.partition(":")
    rng = np.random.default_rng(int(seed or 0))
    if kind == "house":
        house = make_house(rng, 0.05)
        return house.points, house.ground
    made = {"ramp": ramp, "room": random_room}[kind](rng)
    return made.points, made.ground


def scenes(args: argparse.Namespace) -> Iterator[tuple[str, FloatArray, BoolArray | None]]:
    """The scenes that were asked for, one after the other: name, points, ground labels."""
    for name in args.scene or args.default_scenes:
        if name.partition(":")[0] in ("house", "ramp", "room"):
            yield (name.replace(":", "_"), *_made(name))
        else:
            yield read_scene(name)[:3]


Guided = tuple[Walk, Guide]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    scans = [str(path) for path in map(Path, SCANS) if path.is_file()]
    made = ["office", "cluttered_office", "stair", "cow_and_lady", "ramp:1", "room:1", "room:2", "house:1", "house:2"]
    add_scene_arguments(parser, [*made, "house:3", *scans])
    parser.add_argument("--count", type=int, default=50, help="walks in each scene")
    parser.add_argument("--walk", type=int, nargs="+", metavar="N", help="only the walks of these numbers, from 0 on")
    parser.add_argument("--said", action="store_true", help="print what was said on each walk")
    parser.add_argument("--live", type=float, metavar="S", help="also measure cues in real time, for S seconds a scene")
    add_plot_argument(parser)
    parser.add_argument("--seed", type=int, default=1)


def run(args: argparse.Namespace) -> int:
    """Exit code 0 if nobody touched anything and everybody arrived or was stopped safely."""
    rows: list[Row] = []
    everything: list[Guided] = []
    for name, points, ground in scenes(args):
        walks: list[Guided] = []
        unanswered: list[str] = []
        found: Row = {}
        try:
            with serving(name, points, ground) as (server, client):
                wanted = range(args.count) if args.walk is None else args.walk
                for one in walk_all(server, client, name, wanted, args.seed, unanswered):
                    walks.append(one)  # what was walked is kept when the next one fails
                    if args.said:
                        show([{"s": round(said.time, 1), "said": said.text} for said in one[0].said], as_json=args.json)
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
    with tempfile.TemporaryDirectory() as folder:
        options = Options(free_endpoint(), Path(folder), Path(folder))
        with Server(options) as server, Client.connect(options.endpoint) as client:
            client.load_scene(name, upload=points, ground=ground)
            yield server, client


def walk_all(
    server: Server, client: Client, name: str, wanted: Sequence[int], seed: int, unanswered: list[str]
) -> Iterator[Guided]:
    """Walk between random pairs of places, those of the wanted numbers; pairs without an answer are noted.

    A walk depends on seed and number alone, so that one can be looked at again by itself. In every second one people
    who see walk about, where there is room for them.
    """
    entry = server.shelf.get(name)
    assert entry is not None
    assert entry.scene is not None
    scene, count = entry.scene, max(wanted) + 1
    world = WalkedWorld.of(scene.points, scene.ground)
    pairs = islice(connected_pairs(client, scene, name, count, np.random.default_rng(seed), unanswered), count)
    for number, (start, goal) in enumerate(tqdm(pairs, desc=name, total=count, disable=None)):
        if number not in wanted:
            continue
        world.fell, rng = False, np.random.default_rng((seed, number))
        crowd = _crowd(scene, start, rng) if number % 2 else None
        start[2] = world.ground_height(start)  # the map's is smooth; a step from one to the other is none
        walker = Walker(start, float(rng.uniform(-np.pi, np.pi)), world.ground_height, rng)
        guide = Guide(Planner(client, name), goal.tolist())
        truth = world if crowd is None else Beset(world, crowd)
        yield simulate(guide, walker, truth, others=crowd), guide


def _crowd(scene: Scene, start: FloatArray, rng: np.random.Generator) -> Crowd:
    """People who begin on the storey on which a walk begins, none of them at its start; stairs lead them to others."""
    agent = AGENTS["human"]
    everywhere = np.concatenate([places_on(scene, level, agent, 200, rng) for level in range(len(scene.surfaces))])
    away = np.hypot(*(everywhere[:, :2] - start[:2]).T)
    begins = everywhere[(away > 2.0) & (np.abs(everywhere[:, 2] - start[2]) < STOREY)]
    if not len(begins):
        begins = np.array([[1e3, 1e3, 0.0]])
    crowd = Crowd.of(PEOPLE, begins, where_people_stand(scene, agent), rng)
    crowd.candidates = everywhere if len(everywhere) else begins
    return crowd


def where_people_stand(scene: Scene, agent: Agent) -> Callable[[FloatArray], FloatArray]:
    """Height of the ground at places (n, 3), on the level nearest to z; NaN where a body has no room."""
    space = scene.free_space(agent)

    def ground(places: FloatArray) -> FloatArray:
        xy, found = places[:, :2], np.full(len(places), np.nan)
        for level, surface in enumerate(scene.surfaces):
            stands = surface.contains(xy) & (space.levels[level].clearance(xy)[0] >= RADIUS)
            height = np.where(stands, surface.height_at(xy), np.nan)
            near, before = np.abs(height - places[:, 2]), np.abs(found - places[:, 2])
            found = np.where((near < STOREY) & ~(near >= before), height, found)
        return found

    return ground


def places_on(scene: Scene, level: int, agent: Agent, count: int, rng: np.random.Generator) -> FloatArray:
    """Places on one storey where a body stands free of everything, shape (n, 3) [m]."""
    surface, space = scene.surfaces[level], scene.free_space(agent)
    low, size = surface.origin, np.array(surface.height.shape) * surface.cell_width
    xy = rng.uniform(low, low + size, (40 * count, 2))
    xy = xy[surface.contains(xy)]
    xy = xy[space.levels[level].clearance(xy)[0] >= agent.disc_radius][:count]
    return np.column_stack([xy, surface.height_at(xy)])


def connected_pairs(
    client: Client, scene: Scene, name: str, count: int, rng: np.random.Generator, unanswered: list[str]
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Pairs of places (3,) [m] where a person has room to stand, joined by a way that is wide enough.

    Where there are several storeys, half of the ways lead from one to another.

    Raises:
        ClientError: `TRIES` pairs had no answer.
    """
    wide = dataclasses.replace(AGENTS["human"], width=STANDING_ROOM)
    found = [places_on(scene, level, wide, CANDIDATES, rng) for level in range(len(scene.surfaces))]
    storeys = [places for places in found if len(places)]
    body = {**PERSON, "width": WAY}
    for _ in range(40 * count):
        start, goal = (one[rng.integers(len(one))] for one in (storeys[i] for i in rng.integers(len(storeys), size=2)))
        if np.hypot(*(goal - start)[:2]) < LEAST_WALK and abs(goal[2] - start[2]) < 1.0:
            continue
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
    edges = [told for walk, _ in walks for told in edges_told(walk)]
    ends = [walk.end for walk, _ in walks if walk.outcome is Outcome.ARRIVED]
    stops = [walk for walk, _ in walks if walk.outcome is Outcome.SAFE_STOP]
    return {
        "walks": len(walks),
        "arrived": sum(walk.outcome is Outcome.ARRIVED for walk, _ in walks),
        "safe_stops": len(stops),
        "reason_spoken": sum(bool(walk.said) and walk.said[-1].instruction.kind in REASONS for walk in stops),
        "contacts": sum(walk.penetration > 0 for walk, _ in walks),
        "deepest_m": max((walk.penetration for walk, _ in walks), default=0.0),
        "end_m_p50": float(np.median(ends)) if ends else float("nan"),
        "end_m_max": max(ends, default=float("nan")),
        "metres_per_walk": sum(walk.metres for walk, _ in walks) / max(len(walks), 1),
        "said_per_min": sum(len(walk.said) for walk, _ in walks) / max(minutes, 1e-9),
        "walking_per_min": sum(_heard_walking(walk) for walk, _ in walks) / max(minutes, 1e-9),
        "minutes": minutes,
        "stopped_share": sum(walk.stopped for walk, _ in walks) / max(60.0 * minutes, 1e-9),
        "routes": sum(walk.routes for walk, _ in walks) / max(len(walks), 1),
        "edges": len(edges),
        "edges_told": sum(edges),
    }


def _without_wavering(walk: Walk, rise: FloatArray) -> list[int]:
    """Rows at which edges were crossed; forth, back and forth again within half a foot is one, of scattered points."""
    crossed: list[int] = []
    for row in np.flatnonzero(np.abs(rise) >= LEAST_EDGE).tolist():
        crossed.append(row)
        if len(crossed) > 2:
            first, back, again = crossed[-3:]
            near = np.hypot(*(walk.places[again] - walk.places[first])[:2]) < COVERS
            if near and rise[first] * rise[back] < 0.0 < rise[first] * rise[again]:
                del crossed[-2:]
    return crossed


def _same_flight(walk: Walk, before: int, row: int) -> bool:
    """Whether two edges that were crossed are a tread apart, both up or both down, however long he stood between."""
    rise = np.diff(walk.places[[before, before + 1, row, row + 1], 2])[[0, 2]]
    away = float(np.hypot(*(walk.places[row] - walk.places[before])[:2]))
    return away <= TREAD and bool(rise[0] * rise[1] > 0.0)


def _heard_walking(walk: Walk) -> int:
    """Sentences but for those that are heard standing, before the first step and after the last one."""
    return sum(one.instruction.kind not in STANDING for one in walk.said)


def edges_told(walk: Walk) -> list[bool]:
    """Of each step, and of each flight's first edge, that was walked over: whether it had been told of to the end."""
    rise = np.diff(walk.places[:, 2])
    crossed = _without_wavering(walk, rise)
    found: list[bool] = []
    for i, row in enumerate(crossed):
        if i and _same_flight(walk, crossed[i - 1], row):
            continue
        told = (
            one
            for one in walk.said
            if one.instruction.kind in STEPS
            and one.instruction.amount * rise[row] > 0.0
            and np.hypot(*(np.array(one.instruction.place) - walk.places[row, :2])) < EDGE_NEAR
        )
        found.append(any(one.time + spoken_in(one.text) <= walk.times[row] + TICK for one in told))
    return found

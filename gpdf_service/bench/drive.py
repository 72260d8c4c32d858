"""`gpdf bench drive`: simulated robots on random errands, over Zenoh; every true place judged against the cloud."""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from gpdf_client import Client
from gpdf_robot import BODIES, Body, Drive, Driver, Errors, Pose, SimulatedRobot, State, simulate
from gpdf_robot.driver import MARGINS
from tqdm import tqdm

from gpdf_service.bench.judge import Judge
from gpdf_service.bench.plan import random_places
from gpdf_service.bench.plotting import add_plot_argument, draw_rows
from gpdf_service.bench.report import Row, show
from gpdf_service.pipeline import build_scene
from gpdf_service.ports import free_endpoint
from gpdf_service.scene import Scene
from gpdf_service.service.server import Options, Server
from gpdf_service.synthetic import SCENES
from gpdf_service.synthetic.scenes import SyntheticScene
from gpdf_service.types import AGENTS, Agent, FloatArray, Trajectory

DEFAULT_SCENES = ("office", "cluttered_office", "cow_and_lady")
EVERY = 5
"""Of the true places, one in 10 ms, those that are judged: 5 cm at 1 m/s, and the judge fills in between."""

PANELS = {
    "errands": ("runs", "arrived", "refused", "gave_up", "contacts"),
    "distance [m]": ("least_room_m", "error_p95_m", "error_max_m", "deepest_m"),
}
"""Of the picture."""


@dataclass
class Tally:
    """What came of the errands in one scene with one body.

    Refused are those that the planner had no route for; `refused_by_margin` of them it would have had one for the body
    without the room for errors of following.
    """

    ends: Counter[str] = field(default_factory=Counter)
    reasons: Counter[str] = field(default_factory=Counter)
    refused: int = 0
    refused_by_margin: int = 0
    contacts: int = 0
    deepest: float = 0.0
    least_room: float = float("inf")
    stops: int = 0
    offsets: list[FloatArray] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    parser.add_argument(
        "--scene", action="append", choices=list(SCENES), help=f"{', '.join(DEFAULT_SCENES)} when not given"
    )
    parser.add_argument("--agent", action="append", choices=list(BODIES), help="all of them when not given")
    parser.add_argument("--runs", type=int, default=200, help="errands in all")
    add_plot_argument(parser)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true", help="print the rows as JSON")


def run(args: argparse.Namespace) -> int:
    """Exit code 0 if nothing was touched and 95 % of the way was within 5 cm of the line."""
    names, agents = args.scene or DEFAULT_SCENES, args.agent or list(BODIES)
    pairs = [(name, agent) for name in names for agent in agents]
    rows, offsets, contacts = [], [], 0
    with tqdm(total=args.runs, disable=not sys.stderr.isatty(), desc="errands") as bar:
        for i, (name, agent) in enumerate(pairs):
            count = args.runs * (i + 1) // len(pairs) - args.runs * i // len(pairs)
            began = time.perf_counter()
            tally = _errands(name, BODIES[agent], count, np.random.default_rng([args.seed, i]), bar)
            rows.append({"scene": name, "agent": agent, **_row(tally), "wall_s": time.perf_counter() - began})
            offsets += tally.offsets
            contacts += tally.contacts
    error = _quantile(offsets, 0.95)
    arrived = sum(int(row["arrived"]) for row in rows)
    rows.append({"scene": "all", "runs": args.runs, "arrived": arrived, "contacts": contacts, "error_p95_m": error})
    show(rows, as_json=args.json)
    if args.plot:
        title = f"{args.runs} errands of simulated robots"
        draw_rows(args.plot, rows, PANELS, by=("scene", "agent"), title=title)
    return 0 if contacts == 0 and error <= 0.05 else 1


def _errands(name: str, body: Body, count: int, rng: np.random.Generator, bar: tqdm[None]) -> Tally:
    made = SCENES[name](np.random.default_rng(0), spacing=0.05)
    scene = build_scene(made.points, made.ground)
    judge, agent, tally = Judge(made.points, made.ground), AGENTS[body.name], Tally()
    places = random_places(scene, Agent(**body.agent(MARGINS[0])), count, rng)
    with serving(scene) as client:
        for start, goal in places:
            pose = Pose(float(start[0]), float(start[1]), float(rng.uniform(-np.pi, np.pi)))
            robot = SimulatedRobot(body, pose, Errors(), rng)
            drive = simulate(Driver(client, "scene", [float(v) for v in goal], body), robot)
            _count(tally, drive, made, judge, agent)
            if drive.plans == 0:
                bare = client.plan("scene", start.tolist(), goal.tolist(), body.agent(0.0))
                tally.refused_by_margin += bare.trajectory is not None
            bar.update()
    return tally


@contextmanager
def serving(scene: Scene) -> Iterator[Client]:
    """A service with this scene, in this process, and a connection to it over TCP."""
    endpoint = free_endpoint()
    with TemporaryDirectory() as folder:
        scene.save(Path(folder) / "scene.gpdf")
        options = Options(endpoint, Path(folder), Path(folder), 2)
        with Server(options, [("scene", Path(folder) / "scene.gpdf")]), Client.connect(endpoint) as client:
            client.wait_for_scene("scene")
            yield client


def _count(tally: Tally, drive: Drive, made: SyntheticScene, judge: Judge, agent: Agent) -> None:
    """Judge the true track, against the points and against the exact shapes."""
    track = drive.track[::EVERY]
    height = made.truth.ground_height(track)
    tally.ends[drive.state.value] += 1
    if drive.state is not State.ARRIVED:
        tally.reasons[drive.reason.partition(":")[0]] += 1
        tally.refused += drive.plans == 0
    tally.stops += drive.stops
    tally.offsets.append(drive.offsets)
    tally.seconds.append(drive.seconds)
    if np.isnan(height).any():  # inside something
        tally.contacts += 1
        return
    contact = np.column_stack([track, height])
    top = contact + np.array([0.0, 0.0, agent.height])
    body = Trajectory(top, contact, np.arange(len(track), dtype=np.float64), np.zeros(len(track)))
    verdict = judge.judge(body, agent)
    room = made.truth.body_clearance(contact, agent.radius, agent.height, agent.max_step)
    tally.contacts += not verdict.collision_free
    tally.deepest = max(tally.deepest, verdict.penetration)
    tally.least_room = min(tally.least_room, float(room.min()))


def _row(tally: Tally) -> Row:
    return {
        "runs": sum(tally.ends.values()),
        "arrived": tally.ends[State.ARRIVED.value],
        "refused": tally.refused,
        "refused_by_margin": tally.refused_by_margin,
        "gave_up": tally.ends[State.GAVE_UP.value] - tally.refused,
        "why": ", ".join(f"{reason} {count}" for reason, count in tally.reasons.items()),
        "contacts": tally.contacts,
        "deepest_m": tally.deepest,
        "least_room_m": tally.least_room,
        "error_p95_m": _quantile(tally.offsets, 0.95),
        "error_max_m": _quantile(tally.offsets, 1.0),
        "stops": tally.stops,
        "drive_s": float(np.mean(tally.seconds)) if tally.seconds else float("nan"),
    }


def _quantile(parts: list[FloatArray], share: float) -> float:
    values = np.concatenate([np.empty(0), *parts])
    return float(np.quantile(values, share)) if len(values) else float("nan")

"""`gpdf bench plan`: random queries; what share is certified, what an independent judge says, how long it takes.

A brute-force search with the true geometry says which queries could be solved; OMPL and VAMP run beside, on some.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from dataclasses import replace

import numpy as np

from gpdf_service.baselines import simd
from gpdf_service.bench.brute import STOREY, BruteForce
from gpdf_service.bench.curve import STEPS, draw_curve, measure_curve
from gpdf_service.bench.judge import Judge
from gpdf_service.bench.moving import measure_moving
from gpdf_service.bench.peers import compare
from gpdf_service.bench.plotting import add_plot_argument, draw_rows
from gpdf_service.bench.report import Row, add_scene_arguments, clouds, each, show
from gpdf_service.bench.turning import BrutePoses
from gpdf_service.bench.ways import measure_ways, standing_pairs
from gpdf_service.pipeline import build_scene, plan
from gpdf_service.scene import Scene
from gpdf_service.synthetic import random_room
from gpdf_service.types import AGENTS, Agent, FloatArray, Status

NOISES = [0.0, 0.01, 0.02, 0.05]
"""[m] Of the random rooms."""
ROOM_SPACING = 0.02
"""[m] Between their points: 0.3 to 0.5 million of them."""
REPEATS = 5
"""Paths in each row of the curve."""
WARM = 5
"""Plans before the clock runs: the first ones of a process load what is compiled."""
PANELS = {
    "queries": ("queries", "solvable", "ok_of_solvable", "certified", "collisions"),
    "time [ms]": ("p50_ms", "p99_ms"),
    "distance [m]": ("mean_clearance_m", "deepest_m"),
}
"""Of the picture."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    add_scene_arguments(parser, ["office", "cluttered_office"])
    parser.add_argument("--agent", action="append", help="human and roomba when not given")
    parser.add_argument("--discs", type=int, default=1, help="bodies are so many discs in a row, and no cylinders")
    parser.add_argument("--count", type=int, default=100, help="queries for each scene and body")
    add_plot_argument(parser)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--peers", type=int, default=5, help="queries on which OMPL and VAMP run beside; 0 for none")
    parser.add_argument(
        "--curve",
        type=float,
        nargs="?",
        const=max(STEPS),
        help="how time grows with path, map and clutter, up to so many metres, and nothing else",
    )
    parser.add_argument(
        "--ways", action="store_true", help="high steps that people are led over though a level way is there, alone"
    )
    parser.add_argument(
        "--rooms", type=int, help="so many random rooms instead, at each noise, with labels and without, and no peers"
    )
    parser.add_argument("--noise", type=float, nargs="+", default=NOISES, help="of the rooms' coordinates [m]")
    parser.add_argument(
        "--moving",
        action="store_true",
        help="how much later a plan comes when somebody is in the way, and nothing else",
    )
    parser.add_argument(
        "--ignore-labels", action="store_true", help="plan on our own segmentation, judge by the labels"
    )


def run(args: argparse.Namespace) -> int:
    """Exit code 0 if no certified path was judged a collision; of the curve, if every path was found."""
    if args.curve:
        return _curve(args)
    if args.ways:
        return _ways(args)
    if args.rooms:
        return _rooms(args)
    if args.moving:
        return _moving(args)
    rows: list[Row] = []
    peers: list[Row] = []
    for name, points, ground, _ in clouds(args):
        scene = build_scene(points, None if args.ignore_labels else ground)
        truth = scene.ground if ground is None else ground
        judge = Judge(points, truth)
        for agent in args.agent or ["human", "roomba"]:
            body, which = replace(AGENTS[agent], discs=args.discs), {"scene": name, "agent": agent}
            pairs = random_places(scene, body, args.count, np.random.default_rng(args.seed))
            brute = BruteForce(points, truth, body) if body.discs == 1 else BrutePoses(points, truth, body)
            rows.append(which | measure(scene, judge, brute, body, pairs))
            if args.peers and body.discs == 1:
                peers += [which | row for row in compare(scene, body, pairs[: args.peers])]
    if args.json:
        show(rows + peers, as_json=True)
    else:
        show(rows, as_json=False)
        show(peers, as_json=False)
        if peers and not simd.is_here():
            print("VAMP has no row: there is no `vamp` to import.")  # noqa: T201
    if args.plot:
        draw_rows(args.plot, rows, PANELS, by=("scene", "agent"), title="Random queries, judged by the true obstacles")
    return 0 if all(row["collisions"] == 0 for row in rows) else 1


def _ways(args: argparse.Namespace) -> int:
    """Exit code 0 if nobody is led over a high step though a level way is there, and into nothing."""
    rows: list[Row] = []
    for name, points, ground, _ in clouds(args):
        scene = build_scene(points, None if args.ignore_labels else ground)
        judge = Judge(points, scene.ground if ground is None else ground)
        for agent in args.agent or ["human"]:
            pairs = standing_pairs(scene, AGENTS[agent], args.count, np.random.default_rng(args.seed))
            rows.append({"scene": name, "agent": agent} | measure_ways(scene, judge, AGENTS[agent], pairs))
    show(rows, as_json=args.json)
    return 0 if all(row["needless"] == row["collisions"] == 0 for row in rows) else 1


def _rooms(args: argparse.Namespace) -> int:
    rows = [row for noise in args.noise for row in room_rows(args, noise)]
    show(rows, as_json=args.json)
    return 0 if all(row["collisions"] == 0 for row in rows) else 1


def _moving(args: argparse.Namespace) -> int:
    rows: list[Row] = []
    for name, points, ground, _ in clouds(args):
        scene = build_scene(points, None if args.ignore_labels else ground)
        for agent in args.agent or ["human", "roomba"]:
            made = measure_moving(scene, AGENTS[agent], args.count, np.random.default_rng(args.seed))
            rows.append({"scene": name, "agent": agent} | made)
    show(rows, as_json=args.json)
    return 0 if all(row["collisions"] == 0 for row in rows) else 1


def room_rows(args: argparse.Namespace, noise: float) -> list[Row]:
    """Random rooms with this noise [m]: for labels and none, and each body, the sum over all rooms.

    Ends are where the body stands in the exact room, on floor that was sampled; the clean room judges.
    """
    parts: dict[tuple[bool, str], list[Row]] = {}
    for seed in each(range(args.seed, args.seed + args.rooms), f"rooms at {1e3 * noise:g} mm of noise"):
        clean, noisy = (random_room(np.random.default_rng(seed), each, ROOM_SPACING) for each in (0.0, noise))
        judge = Judge(clean.points, clean.ground)
        scenes = {labelled: build_scene(noisy.points, noisy.ground if labelled else None) for labelled in (True, False)}
        for agent in args.agent or ["human", "roomba"]:
            brute = BruteForce(clean.points, clean.ground, AGENTS[agent], noise)
            pairs = brute.random_pairs(args.count, np.random.default_rng(seed))
            for labelled, scene in scenes.items():
                row = measure(scene, judge, brute, AGENTS[agent], pairs)
                row["refused"] = refused_share(scene, brute, AGENTS[agent])
                parts.setdefault((labelled, agent), []).append(row)
    return [
        {"scene": "random_rooms", "rooms": args.rooms, "noise_m": noise, "labels": labelled, "agent": agent}
        | _total(many)
        for (labelled, agent), many in parts.items()
    ]


def refused_share(scene: Scene, brute: BruteForce, agent: Agent) -> float:
    """Share of the places in the largest piece of the exact search's grid where the scene has no room for the body."""
    largest = np.bincount(brute.component[brute.fits]).argmax()
    i, j, k = np.nonzero(brute.component == largest)
    xy, z = brute.origin + (np.column_stack([i, j]) + 0.5) * brute.cell, brute.height[i, j, k]
    space, free = scene.free_space(agent), np.zeros(len(xy), dtype=bool)
    for level, surface in enumerate(scene.surfaces):
        stands = np.abs(surface.height_at(xy) - z) < 0.5 * STOREY  # NaN compares false
        free |= stands & (space.levels[level].clearance(xy)[0] >= space.reach)
    return float((~free).mean())


def _total(many: list[Row]) -> Row:
    """Counts of several rooms, the worst penetration, and the median time."""
    made: Row = {key: sum(row[key] for row in many) for key in ("queries", "certified", "solvable", "ok_of_solvable")}
    made["share"] = made["ok_of_solvable"] / max(made["solvable"], 1)
    made["collisions"] = sum(row["collisions"] for row in many)
    made["deepest_m"] = max(row["deepest_m"] for row in many)
    made["refused"] = float(np.mean([row["refused"] for row in many]))
    made["p50_ms"] = float(np.median([row["p50_ms"] for row in many]))
    return made


def _curve(args: argparse.Namespace) -> int:
    rng = np.random.default_rng(args.seed)
    rows: list[Row] = []
    for agent in args.agent or ["human"]:
        rows += [{"agent": agent} | row for row in measure_curve(AGENTS[agent], args.curve, REPEATS, rng)]
    show(rows, as_json=args.json)
    if args.plot:
        draw_curve(args.plot, rows)
    return 0 if all(row["ok"] == row["queries"] for row in rows) else 1


def random_places(scene: Scene, agent: Agent, count: int, rng: np.random.Generator) -> FloatArray:
    """Pairs of places on the ground where the body stands free of everything, shape (count, 2, 2) [m].

    Rejection sampling over the height map with exact clearances: it does not know what the graph connects.
    """
    surface, space = scene.surfaces[0], scene.free_space(agent)
    found: list[FloatArray] = []
    for _ in range(1000):
        low, size = surface.origin, np.array(surface.height.shape) * surface.cell_width
        xy = rng.uniform(low, low + size, (4096, 2))
        xy = xy[surface.contains(xy)]
        xy = xy[space.levels[0].clearance(xy)[0] >= agent.disc_radius]
        found.append(xy)
        if sum(map(len, found)) >= 2 * count:
            break
    places = np.concatenate(found)[: 2 * count]
    return places[: len(places) // 2 * 2].reshape(-1, 2, 2)


def measure(scene: Scene, judge: Judge, brute: BruteForce | BrutePoses, agent: Agent, pairs: FloatArray) -> Row:
    """Plan every pair of places, judge every answer, and say which refused ones could be solved."""
    statuses: Counter[str] = Counter()
    seconds, worked, clearance, ground, collisions, deepest, feasible = [], [], [], [], 0, 0.0, 0
    solvable = solved = 0
    for start, goal in pairs[:WARM]:
        plan(scene, start, goal, agent)
    for start, goal in each(pairs, f"plans of a {agent.name}"):
        began, cpu = time.perf_counter(), time.process_time()
        result = plan(scene, start, goal, agent)
        worked.append(time.process_time() - cpu)
        seconds.append(time.perf_counter() - began)
        statuses[result.status.value] += 1
        can = brute.solves(start, goal)
        solvable, solved = solvable + can, solved + (can and result.status is Status.OK)
        if result.status is Status.OK and result.trajectory is not None and result.certificate is not None:
            verdict = judge.judge(result.trajectory, agent)
            collisions += not verdict.collision_free
            deepest = max(deepest, verdict.penetration)
            feasible += verdict.feasible
            ground.append(verdict.mean_ground_distance)
            clearance.append(result.certificate.min_clearance)
    certified = statuses[Status.OK.value]
    return {
        "queries": len(pairs),
        "certified": certified,
        "solvable": solvable,
        "ok_of_solvable": solved,
        **{status: n for status, n in statuses.items() if status != Status.OK.value},
        "collisions": collisions,
        "deepest_m": deepest,
        "feasible": feasible,
        "mean_ground_m": float(np.mean(ground)) if ground else float("nan"),
        "mean_clearance_m": float(np.mean(clearance)) if clearance else float("nan"),
        "p50_ms": 1e3 * float(np.median(seconds)),
        "p99_ms": 1e3 * float(np.quantile(seconds, 0.99)),
        "p50_cpu_ms": 1e3 * float(np.median(worked)),
        "p99_cpu_ms": 1e3 * float(np.quantile(worked, 0.99)),
    }

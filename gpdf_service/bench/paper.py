"""`gpdf bench paper`: the paper's evaluation, its four methods on noisy clouds, judged against the clean ones."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cached_property, partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from tqdm import tqdm

from gpdf_service.bench.brute import BruteForce
from gpdf_service.bench.judge import Judge, Verdict
from gpdf_service.bench.paper_tables import METHODS, to_markdown
from gpdf_service.bench.report import Row
from gpdf_service.clouds import read_cloud
from gpdf_service.cores import end_with_parent
from gpdf_service.errors import GpdfError, RequestError
from gpdf_service.perception import segment_ground
from gpdf_service.pipeline import Method, build_scene, plan
from gpdf_service.scene import Scene
from gpdf_service.synthetic import SCENES
from gpdf_service.types import AGENTS, Agent, BoolArray, FloatArray, PlanResult, Status

CLOUDS = {".ply", ".pcd", ".xyz", ".npz", ".las", ".laz"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    parser.add_argument(
        "--scene",
        action="append",
        help=f"{', '.join(SCENES)}; a cloud, a folder of clouds, or NAME=CLOUD to stand beside the paper's numbers of "
        "that scene (cow_and_lady, cluttered_office for Office 10, office for Office 1, cave); all synthetic ones when "
        "not given",
    )
    parser.add_argument("--agent", action="append", choices=list(AGENTS), help="human and roomba when not given")
    parser.add_argument("--method", action="append", choices=METHODS, help="all four when not given")
    parser.add_argument("--queries", type=int, default=100, help="random start and goal pairs for each scene and body")
    parser.add_argument("--noise", type=float, default=0.05, help="standard deviation of the input's noise [m]")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--ignore-labels",
        action="store_true",
        help="plan on our own segmentation of the noisy cloud, not on that of the clean one, which the paper is given",
    )
    parser.add_argument("--json", nargs="?", const="-", help="write the rows as JSON; without a file, print them")
    parser.add_argument("--markdown", type=Path, help="write the tables; printed when neither this nor --json is given")
    parser.add_argument(
        "--keep", type=Path, help="folder for each scene's and body's rows; what is there is not redone"
    )
    parser.add_argument("--jobs", type=int, default=1, help="scenes that are evaluated at once, each in its process")
    parser.add_argument("--png", type=Path, help="folder for pictures of the four methods and of the four bodies")


def run(args: argparse.Namespace) -> int:
    """Exit code 0 if every scene could be evaluated and no OK answer was judged a collision."""
    rows: list[Row] = []
    failed = False
    scenes = _scenes(args.scene or list(SCENES))
    if args.jobs > 1:
        with ProcessPoolExecutor(args.jobs, get_context("spawn"), end_with_parent) as pool:
            done = list(pool.map(partial(_evaluate, args), scenes))
    else:
        done = [_evaluate(args, scene) for scene in scenes]
    for (name, _), (found, error) in zip(scenes, done, strict=True):
        rows += found
        if error:  # the other scenes' hours are not lost
            print(f"gpdf bench paper: {name}: {error}", file=sys.stderr)  # noqa: T201
            failed = True
    _write(args, rows)
    return 1 if failed or any(row["collisions_in_ok"] for row in rows) else 0


def _evaluate(args: argparse.Namespace, scene: tuple[str, Path | None]) -> tuple[list[Row], str]:
    """One scene's rows, and why there are no more of them."""
    rows: list[Row] = []
    try:
        place = _Place.read(args, *scene)
        for agent in args.agent or ["human", "roomba"]:
            rows += _keep(args, place, agent)
        if args.png:
            _draw(args.png, place, rows, args.seed)
    except GpdfError as error:
        return rows, str(error)
    return rows, ""


class _Place:
    """A clean cloud, and what is made of it when it is asked for: the noisy scene, and its judge."""

    def __init__(self, name: str, points: FloatArray, labels: BoolArray | None, args: argparse.Namespace) -> None:
        self.name, self.points, self.labels = name, points, labels
        self.noise, self.seed, self.given = args.noise, args.seed, not args.ignore_labels

    @classmethod
    def read(cls, args: argparse.Namespace, name: str, file: Path | None) -> _Place:
        """A synthetic scene by its name, or a cloud from a file."""
        if file is None:
            scene = SCENES[name](np.random.default_rng(0))
            return cls(name, scene.points, scene.ground, args)
        cloud = read_cloud(file)
        return cls(name, cloud.points, cloud.ground, args)

    @cached_property
    def truth(self) -> BoolArray:
        """Which points are ground: the labels, or our segmentation of the clean cloud."""
        return segment_ground(self.points) if self.labels is None else self.labels

    @cached_property
    def scene(self) -> Scene:
        """Of the noisy cloud: all that a planner sees."""
        noise = np.random.default_rng(self.seed).normal(0.0, 1.0, self.points.shape)
        return build_scene(self.points + noise * self.noise, self.truth if self.given else None)

    @cached_property
    def judge(self) -> Judge:
        """Knows the clean cloud alone."""
        return Judge(self.points, self.truth)


def _keep(args: argparse.Namespace, place: _Place, agent: str) -> list[Row]:
    """A body's rows from the folder of those that are kept, if they were asked for in the same words; else made."""
    methods = list(METHODS) if args.method is None else args.method
    asked = {"queries": args.queries, "noise": args.noise, "seed": args.seed, "methods": methods}
    asked |= {"ignore_labels": args.ignore_labels}
    file = None if args.keep is None else args.keep / f"{place.name}_{agent}.json"
    if file is not None and file.exists():
        kept = json.loads(file.read_text())
        if kept["asked"] == asked:
            rows: list[Row] = kept["rows"]
            return rows
    rows = _compare(place, agent, methods, args.queries)
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(json.dumps({"asked": asked, "rows": rows}, indent=1))
    return rows


def _compare(place: _Place, agent: str, methods: list[Method], queries: int) -> list[Row]:
    """One body, every method, the same queries for all of them."""
    body = AGENTS[agent]
    brute = BruteForce(place.points, place.truth, body, place.noise)
    pairs = brute.random_pairs(queries, np.random.default_rng((place.seed, list(AGENTS).index(agent))))
    if len(pairs) == 0:
        raise RequestError(
            "bench paper", f"no place in {place.name} where the {agent} can stand", "Choose other bodies."
        )
    solvable = np.array([brute.solves(*pair) for pair in pairs])
    rows: list[Row] = []
    for method in methods:
        row = _measure(place, body, method, pairs, solvable)
        rows.append({"scene": place.name, "agent": agent, "method": method, "noise_m": place.noise, **row})
    return rows


def _draw(folder: Path, place: _Place, rows: list[Row], seed: int) -> None:
    from gpdf_service.bench.paper_pictures import draw_refused, draw_scene_pictures

    draw_scene_pictures(place.name, place.scene, place.points, place.truth, folder, seed)
    for row in rows:
        if row["method"] == "dual_gpdf" and row["refused"]:
            draw_refused(
                folder / f"{place.name}_{row['agent']}_refused.png", place.scene, place.points, place.truth, row
            )


def _scenes(words: list[str]) -> list[tuple[str, Path | None]]:
    """Name and file of each scene that was asked for; a synthetic one has no file."""
    found: list[tuple[str, Path | None]] = []
    for text in words:
        if text in SCENES:
            found.append((text, None))
            continue
        name, _, file = text.rpartition("=")
        path = Path(file)
        files = sorted(p for p in path.iterdir() if p.suffix in CLOUDS) if path.is_dir() else [path]
        found += [(name or each.stem, each) for each in files]
    return found


@dataclass(frozen=True, slots=True)
class _Answer:
    """One query's result, its verdicts (none without a trajectory), and the processor's time [s]."""

    result: PlanResult
    waypoints: Verdict | None
    strict: Verdict | None
    seconds: float


def _measure(place: _Place, agent: Agent, method: Method, pairs: FloatArray, solvable: BoolArray) -> Row:
    scene, judge, label = place.scene, place.judge, f"{place.name} {agent.name} {method}"
    plan(scene, pairs[0, 0], pairs[0, 1], agent, method=method)  # fields and graphs are built on first use
    answers = []
    for start, goal in tqdm(pairs, desc=label, disable=not sys.stderr.isatty()):
        began = time.process_time()
        result = plan(scene, start, goal, agent, method=method)
        seconds, path = time.process_time() - began, result.trajectory
        if path is None:
            answers.append(_Answer(result, None, None, seconds))
        else:
            answers.append(_Answer(result, judge.judge_waypoints(path, agent), judge.judge(path, agent), seconds))
    ok = np.array([answer.result.status is Status.OK for answer in answers])
    strict = [answer.strict for answer, good in zip(answers, ok, strict=True) if good and answer.strict is not None]
    touched = [
        {"start": start.tolist(), "goal": goal.tolist(), "deep_m": answer.strict.penetration}
        | {"height_m": judge.height_of_touched(path, agent), "hidden_m": scene.hidden_height}
        for answer, good, (start, goal) in zip(answers, ok, pairs, strict=True)
        if good and answer.strict and not answer.strict.collision_free and (path := answer.result.trajectory)
    ]
    seconds_all = [answer.seconds for answer in answers]
    return {
        "queries": len(pairs),
        "solvable": int(solvable.sum()),
        "answered": sum(answer.strict is not None for answer in answers),
        "ok": int(ok.sum()),
        "ok_of_solvable": int((ok & solvable).sum()),
        "refused": [
            {"start": start.tolist(), "goal": goal.tolist(), "status": answer.result.status.value}
            | {"message": answer.result.message, "at": _refused_at(answer.result, start, goal).tolist()}
            for answer, (start, goal), can in zip(answers, pairs, solvable, strict=True)
            if can and answer.result.status is not Status.OK
        ],
        "touched": touched,
        "low_in_ok": sum(case["height_m"] <= case["hidden_m"] for case in touched),
        "statuses": dict(Counter(answer.result.status.value for answer in answers)),
        "collisions_in_ok": sum(not verdict.collision_free for verdict in strict),
        "infeasible_in_ok": sum(not verdict.feasible for verdict in strict),
        "deepest_in_ok_m": max((verdict.penetration for verdict in strict), default=0.0),
        **_rates("waypoints", [a.waypoints for a, good in zip(answers, solvable, strict=True) if good]),
        **_rates("strict", [a.strict for a, good in zip(answers, solvable, strict=True) if good]),
        "p50_cpu_ms": 1e3 * float(np.median(seconds_all)),
        "p99_cpu_ms": 1e3 * float(np.quantile(seconds_all, 0.99)),
    }


def _refused_at(result: PlanResult, start: FloatArray, goal: FloatArray) -> FloatArray:
    """Where a query was refused [m]: at one of its ends, or where the limits cut them apart."""
    end = goal if result.status.value.startswith("GOAL") else start
    return np.array([result.details.get(f"cut_{axis}", z) for axis, z in zip("xyz", end, strict=True)])


def _rates(how: str, verdicts: list[Verdict | None]) -> Row:
    """The paper's measures over the solvable queries, a refusal being a failure; and over those that got a path."""
    paths = [verdict for verdict in verdicts if verdict is not None]
    free, feasible = (sum(getattr(v, name) for v in paths) for name in ("collision_free", "feasible"))
    return {
        f"{how}_collision_free": _share(free, len(verdicts)),
        f"{how}_collision_free_of_paths": _share(free, len(paths)),
        f"{how}_feasible": _share(feasible, len(verdicts)),
        f"{how}_feasible_of_paths": _share(feasible, len(paths)),
        f"{how}_ground_m": _mean([verdict.mean_ground_distance for verdict in paths]),
        f"{how}_obstacles_m": _mean([verdict.mean_obstacle_distance for verdict in paths]),
    }


def _share(some: int, of: int) -> float | None:
    """In percent."""
    return 100.0 * some / of if of else None


def _mean(values: list[float]) -> float | None:
    """None where there is nothing to average: no path, or no obstacle anywhere."""
    finite = [value for value in values if np.isfinite(value)]
    return float(np.mean(finite)) if finite else None


def _write(args: argparse.Namespace, rows: list[Row]) -> None:
    text = to_markdown(rows, args.noise)
    if args.markdown:
        args.markdown.parent.mkdir(parents=True, exist_ok=True)
        args.markdown.write_text(text)
    if args.json == "-":
        print(json.dumps(rows))  # noqa: T201
    elif args.json:
        Path(args.json).write_text(json.dumps(rows, indent=1))
    elif not args.markdown:
        print(text, end="")  # noqa: T201

"""`gpdf bench ground`: our segmentation beside true labels, and how much of platforms, treads and ramps it keeps."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from gpdf_service.bench.hard_clouds import (
    HOUSE,
    HOUSE_TURNS,
    TURNS,
    hall_rows,
    shifted_spiral,
    spiral_rows,
    turned_house,
)
from gpdf_service.bench.houses import THIN, How, house_rows
from gpdf_service.bench.placed import placed_rows
from gpdf_service.bench.places import island_rows, label_rows, land_rows, path_rows, shaft_rows
from gpdf_service.bench.report import Row, each, show
from gpdf_service.bench.rules import RULES, rule_rows
from gpdf_service.clouds import read_cloud
from gpdf_service.errors import RequestError
from gpdf_service.perception import segment_ground
from gpdf_service.synthetic import SCANNERS, SCENES, SyntheticScene, ramp, random_room
from gpdf_service.synthetic.faults import FAULTS
from gpdf_service.types import BoolArray, FloatArray

RAISED = 0.04
"""[m] Ground this far over the floor is a platform, a tread or a ramp; less is lost in a scan's noise."""
CELL = 0.05
"""[m] Of the overlap by area."""
HIGH = 0.3
"""[m] What is no ground and lies this far over the lowest ground, level, is a seat or a table top."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    parser.add_argument("--scene", action="append", type=Path, help="a cloud with ground labels, besides random scenes")
    parser.add_argument(
        "--count",
        type=int,
        help="random rooms (20), and as many ramps; houses (21 tripod, 28 handheld); angles (7); pairs",
    )
    parser.add_argument(
        "--noise", action="append", type=float, help="of each coordinate [m]; 0.01 and 0.05 if not given"
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--ablation",
        nargs="*",
        metavar="RULE",
        help="each rule switched off by itself, or those that are named: which numbers it moves",
    )
    parser.add_argument(
        "--rows",
        nargs="+",
        choices=[*ROWS, "all"],
        help="other rows instead: ray-cast houses, stairs of a museum and a house, spiral ramps, clouds that are "
        "turned and shifted, where a start (x, y) lands, islands, shafts, labels of random places and paths in them",
    )
    parser.add_argument("--scanner", action="append", choices=list(SCANNERS), help="of the houses; repeatable")
    parser.add_argument("--origins", action="store_true", help="houses are built with where the rays began")
    parser.add_argument("--fault", choices=list(FAULTS), help="of the scans of houses, as raw ones have them")
    parser.add_argument("--thin", type=float, default=THIN, help="one point is kept of such a voxel of a house [m]")
    parser.add_argument("--centres", action="store_true", help="that point is moved into the middle of its voxel")
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="folder of the real clouds")
    parser.add_argument("--json", action="store_true", help="print the rows as JSON")


def run(args: argparse.Namespace) -> int:
    """Measure labelled clouds, then synthetic scenes at every noise; or what parts of the build change."""
    if args.ablation is not None:
        rules = args.ablation or list(RULES)
        if unknown := [rule for rule in rules if rule not in RULES]:
            raise RequestError("--ablation", f"{unknown[0]!r}", f"Rules: {', '.join(RULES)}.")
        show(list(rule_rows(args.data, args.seed, args.count or 1, rules)), as_json=args.json)
        return 0
    if args.rows:
        names = ROWS if "all" in args.rows else args.rows
        show([row for name in names for row in ROWS[name](args)], as_json=args.json)
        return 0
    rows: list[Row] = []
    for path in args.scene or []:
        cloud = read_cloud(path)
        if cloud.ground is not None:
            floor = float(np.median(cloud.points[cloud.ground, 2]))
            rows.append({"scene": path.stem, "scenes": 1} | measure([(cloud.points, cloud.ground, floor)]))
    for noise in args.noise or [0.01, 0.05]:
        for name, scenes in _made(20 if args.count is None else args.count, args.seed, noise).items():
            parts = [(scene.points, scene.ground, 0.0) for scene in scenes]
            rows.append({"scene": name, "scenes": len(scenes), "noise_m": noise} | measure(parts))
    show(rows, as_json=args.json)
    return 0


def _houses(args: argparse.Namespace) -> Iterator[Row]:
    noise = args.noise[0] if args.noise else None
    how: How = {"origins": args.origins, "fault": args.fault, "thin": args.thin, "centres": args.centres}
    for scanner in args.scanner or ["tripod", "handheld"]:
        yield from house_rows(scanner, args.count, args.seed, noise, **how)


def _hall(args: argparse.Namespace) -> Iterator[Row]:
    turns = TURNS if args.count is None else min(args.count, TURNS)
    yield from hall_rows(args.data, turns, args.seed)
    if (args.data / HOUSE).exists():
        yield turned_house(args.data, HOUSE_TURNS if args.count is None else args.count, args.seed)


def _spiral(args: argparse.Namespace) -> Iterator[Row]:
    yield from spiral_rows(args.data, 100 if args.count is None else args.count, args.seed)
    yield shifted_spiral(args.data, args.seed)


def _placed(args: argparse.Namespace) -> Iterator[Row]:
    clouds = args.scene or sorted(args.data.glob("*.npz"))
    yield from placed_rows(clouds, 40 if args.count is None else args.count, args.seed)


def _lands(args: argparse.Namespace) -> Iterator[Row]:
    for scanner in args.scanner or ["tripod"]:
        yield from land_rows(scanner, args.count, args.seed, args.noise[0] if args.noise else None)


def _islands(args: argparse.Namespace) -> Iterator[Row]:
    for scanner in args.scanner or ["tripod"]:
        yield from island_rows(scanner, args.count, args.seed, args.noise[0] if args.noise else None)


def _shafts(args: argparse.Namespace) -> Iterator[Row]:
    for scanner in args.scanner or ["tripod", "handheld"]:
        yield from shaft_rows(scanner, args.count, args.seed, args.noise[0] if args.noise else None)


def _paths(args: argparse.Namespace) -> Iterator[Row]:
    for scanner in args.scanner or ["tripod", "handheld"]:
        yield from path_rows(scanner, args.count, args.seed, args.noise[0] if args.noise else None)


def _labels(args: argparse.Namespace) -> Iterator[Row]:
    for scanner in args.scanner or ["tripod", "handheld"]:
        yield from label_rows(scanner, args.count, args.seed, args.noise[0] if args.noise else None)


ROWS: dict[str, Callable[[argparse.Namespace], Iterator[Row]]] = {
    "houses": _houses,
    "hall": _hall,
    "spiral": _spiral,
    "placed": _placed,
    "lands": _lands,
    "islands": _islands,
    "shafts": _shafts,
    "labels": _labels,
    "paths": _paths,
}
"""Rows that are asked for by name."""


def _made(count: int, seed: int, noise: float) -> dict[str, list[SyntheticScene]]:
    rooms = [random_room(np.random.default_rng(seed + i), noise) for i in range(count)]
    ramps = [ramp(np.random.default_rng(seed + i), noise) for i in range(count)]
    named = {name: [make(np.random.default_rng(seed), noise)] for name, make in SCENES.items()}
    return {"random_room": rooms, "ramp": ramps, **named}


def measure(clouds: list[tuple[FloatArray, BoolArray, float]]) -> Row:
    """Shares over all points of several clouds (points, true labels, height of the floor)."""
    true, found, raised, high, seconds, cells = [], [], [], [], 0.0, np.zeros(2)
    for points, ground, floor in each(clouds, "clouds"):
        began = time.perf_counter()
        found.append(segment_ground(points))
        seconds += time.perf_counter() - began
        over = points[:, 2] - floor
        true.append(ground)
        cells += _shared_cells(points, ground, found[-1])
        raised.append(ground & (over > RAISED))
        high.append(~ground & (over > HIGH))
    mask, is_ground = np.concatenate(found), np.concatenate(true)
    up, furniture = np.concatenate(raised), np.concatenate(high)
    return {
        "points": len(mask),
        "iou": float((mask & is_ground).sum() / (mask | is_ground).sum()),
        "iou_area": float(cells[0] / cells[1]),
        "recall": float(mask[is_ground].mean()),
        "precision": float(is_ground[mask].mean()),
        "raised_recall": float(mask[up].mean()) if up.any() else float("nan"),
        "furniture_as_ground": float(mask[furniture].mean()) if furniture.any() else 0.0,
        "seconds": seconds,
    }


def _shared_cells(points: FloatArray, true: BoolArray, found: BoolArray) -> FloatArray:
    """How many cells of `CELL` hold ground by both masks, and by either: each place counts once, however dense."""
    cell = np.floor(points[:, :2] / CELL).astype(np.int64)
    one, other = ({*map(tuple, np.unique(cell[mask], axis=0).tolist())} for mask in (true, found))
    return np.array([len(one & other), len(one | other)], dtype=np.float64)

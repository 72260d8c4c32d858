"""`gpdf demo`: the real service as its own process, four bodies asked for over Zenoh, a table, a picture and a log."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
from gpdf_client import Client

from gpdf_service.ports import free_endpoint
from gpdf_service.service.begun import begun
from gpdf_service.synthetic import SCENES, SyntheticScene
from gpdf_service.types import AGENTS, PlanResult

LASER_OFFICE = "cluttered_office_tls_1cm.npz"


FIRST_S = 120.0
"""[s] For what is done the first time: kernels are compiled for a minute on a fresh machine, longer on a busy one."""


@dataclass(frozen=True)
class Tour:
    """One scene of the demo: where from, where to, and which bodies must get there."""

    name: str
    cloud: Path
    start: tuple[float, ...]
    goal: tuple[float, ...]
    expected: tuple[str, ...]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder for the picture, the log and the scenes")
    parser.add_argument(
        "--scans", type=Path, default=Path("../shared/data"), help="folder with the laser-scanned office"
    )
    parser.add_argument("--json", action="store_true", help="print the table as JSON")


def run(args: argparse.Namespace) -> int:
    """Run the tours; exit code 0 only if every body that should arrive has a certified trajectory."""
    args.out.mkdir(parents=True, exist_ok=True)
    tours = _tours(args.out, args.scans)
    rows: list[dict[str, Any]] = []
    with _service(args.out, tours) as endpoint, Client.connect(endpoint, timeout_s=FIRST_S) as client:
        client.wait_for_service(timeout_s=FIRST_S)
        if not args.json:
            print(HEAD)
        for tour in tours:
            for row in _travel(client, tour, args.out):
                rows.append(row)
                if not args.json:
                    print(_line(row), flush=True)
    if args.json:
        print(json.dumps(rows))
    else:
        _print_next(args.out)
    return 0 if all(row["status"] == "OK" or not row["expected"] for row in rows) else 1


def _tours(out: Path, scans: Path) -> list[Tour]:
    office, cloud = SCENES["office"](np.random.default_rng(0)), out / "office.npz"
    _write(office, cloud)
    _write(SCENES["stair"](np.random.default_rng(0)), out / "stair.npz")  # for whoever is guided next
    everyone = tuple(AGENTS)
    tours = [Tour("office", cloud, tuple(office.start), tuple(office.goal), everyone)]
    if (scans / LASER_OFFICE).is_file():
        tours.append(Tour("laser_office", scans / LASER_OFFICE, (6.6, 9.2), (9.9, 14.1), ("roomba", "pepper", "human")))
    return tours


def _write(scene: SyntheticScene, path: Path) -> None:
    label, classes = scene.ground.astype(np.int32), np.array(["other", "ground"])
    np.savez(path, xyz=scene.points.astype(np.float32), label=label, classes=classes)


@contextmanager
def _service(out: Path, tours: list[Tour]) -> Iterator[str]:
    """`gpdf serve` in its own process."""
    endpoint = free_endpoint()
    scenes = [f"{tour.name}={tour.cloud}" for tour in tours]
    flags = [*scenes, "--endpoint", endpoint, "--log-dir", str(out), "--workers", "1"]  # one asks, one plan at a time
    print(f"gpdf serve {' '.join(flags)}", file=sys.stderr)
    print("(where nobody has run `gpdf warm` yet, it compiles the kernels first, for minutes)", file=sys.stderr)
    (out / "serve.log").unlink(missing_ok=True)
    with begun(out / "serve.log", *flags):
        yield endpoint


def _travel(client: Client, tour: Tour, out: Path) -> Iterator[dict[str, Any]]:
    """Ask for every body's plan in one scene, then draw them."""
    client.wait_for_scene(tour.name, timeout_s=FIRST_S)
    results = {}
    for name in AGENTS:
        # the first one builds this body's free space, and compiles the kernels if nobody has yet
        client.plan(tour.name, tour.start, tour.goal, agent=name, deadline_s=FIRST_S)
        began = time.perf_counter()
        result = client.plan(tour.name, tour.start, tour.goal, agent=name)
        results[name] = result
        row = {"scene": tour.name, "agent": name, "status": str(result.status), "expected": name in tour.expected}
        row["milliseconds"] = 1000 * (time.perf_counter() - began)
        if result.trajectory is not None and result.certificate is not None:
            row["length"] = result.trajectory.length
            row["clearance"] = result.certificate.min_clearance
            row["deviation"] = result.certificate.max_height_deviation
            row["certified"] = result.certificate.holds
        yield row
    from gpdf_service.clouds import read_cloud  # the service runs already
    from gpdf_service.pipeline import build_scene
    from gpdf_service.viewer.picture import draw_plans

    cloud = read_cloud(tour.cloud)
    scene = build_scene(cloud.points, cloud.ground, colours=cloud.colours)
    picture = out / f"{tour.name}.png"
    drawn = cast("dict[str, PlanResult]", results)  # the client's results have the same attributes
    draw_plans(scene, drawn, picture, start=tour.start, goal=tour.goal, title=f"{tour.name}: four bodies")


HEAD = f"{'scene':14}{'agent':8}{'status':10}{'length':>9}{'clearance':>11}{'off height':>12}{'time':>9}  certified"


def _line(row: dict[str, Any]) -> str:
    """One of the table's."""
    line = f"{row['scene']:14}{row['agent']:8}{row['status']:10}"
    if "length" in row:
        line += f"{row['length']:7.2f} m{row['clearance']:9.3f} m{row['deviation']:10.3f} m"
        line += f"{row['milliseconds']:6.0f} ms  {'yes' if row['certified'] else 'NO'}"
    return line


def _print_next(out: Path) -> None:
    log = max(out.glob("*.mcap"), key=lambda path: path.stat().st_mtime)
    pictures = " ".join(str(path) for path in sorted(out.glob("*.png")))
    print(f"\npictures: {pictures}\nlog:      {log} (opens in Foxglove and Rerun)\n\nTry next:")
    print(f"  .venv/bin/gpdf replay {log} --scenes-dir {out}/state")
    print("  .venv/bin/gpdf scene info YOUR_CLOUD.ply --agent human --png cloud.png")
    print(f"  .venv/bin/gpdf serve office={out}/office.npz stair={out}/stair.npz")

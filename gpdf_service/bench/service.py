"""`gpdf bench service`: what Zenoh, msgpack and the log add to a plan, against the same plans in process."""

from __future__ import annotations

import argparse
import socket
import tempfile
import time
from pathlib import Path

import numpy as np
from gpdf_client import Client

from gpdf_service.bench.plan import random_places
from gpdf_service.bench.plotting import add_plot_argument, draw_rows
from gpdf_service.bench.report import Row, show
from gpdf_service.pipeline import plan
from gpdf_service.service.server import Options, Server
from gpdf_service.synthetic import SCENES
from gpdf_service.types import resolve_agent


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    parser.add_argument("--count", type=int, default=100, help="plans")
    add_plot_argument(parser)
    parser.add_argument("--json", action="store_true", help="print the rows as JSON")


def run(args: argparse.Namespace) -> int:
    """Measure and print."""
    row = measure(args.count)
    show([row], as_json=args.json)
    if args.plot:
        panels = {"time of a plan [ms]": [name for name in row if name.endswith("_ms")]}
        draw_rows(args.plot, [row], panels, title=f"What the wire adds, {args.count} plans")
    return 0


def measure(count: int) -> Row:
    """Each plan once over Zenoh and once in process, in turn, so that a noisy machine is noisy for both."""
    office = SCENES["office"](np.random.default_rng(0))
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    over, inside = [], []
    with tempfile.TemporaryDirectory() as folder:
        options = Options(endpoint, Path(folder), Path(folder))
        with Server(options) as server, Client.connect(endpoint) as client:
            client.load_scene("office", upload=office.points, ground=office.ground)
            entry = server.shelf.get("office")
            assert entry is not None
            assert entry.scene is not None
            scene, agent = entry.scene, resolve_agent("human")
            for start, goal in random_places(scene, agent, count, np.random.default_rng(0)):
                plan(scene, start, goal, agent)
                began = time.perf_counter()
                client.plan("office", start.tolist(), goal.tolist())
                middle = time.perf_counter()
                plan(scene, start, goal, agent)
                over.append(middle - began)
                inside.append(time.perf_counter() - middle)
    added = np.array(over) - np.array(inside)
    return {
        "plans": count,
        "in_process_p50_ms": 1e3 * float(np.median(inside)),
        "over_zenoh_p50_ms": 1e3 * float(np.median(over)),
        "added_p50_ms": 1e3 * float(np.median(added)),
        "added_p90_ms": 1e3 * float(np.quantile(added, 0.9)),
    }

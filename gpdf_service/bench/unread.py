"""`gpdf bench unread`: clients that ask for megabytes and read nothing of them, and what others wait meanwhile."""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from gpdf_client import Client

from gpdf_service.bench.report import Row, show
from gpdf_service.bench.running import Running, serving

QUIET_S = 4.0
"""[s] Of plans before, to compare with."""
ASKER = """
import os, signal, sys, zenoh
from gpdf_client.client import client_config
from gpdf_schemas import FileRequest, PlanRequest, encode, keys

file = encode(FileRequest(scene="office", version=int(sys.argv[2])))
plan = encode(PlanRequest(scene="office", start=[1.0, 1.0], goal=[2.0, 1.0]))
with zenoh.open(client_config(sys.argv[1])) as session:
    for key, body, count in ((keys.SCENE_FILE, file, 150), (keys.PLAN, plan, 300)):
        for _ in range(count):
            session.get(key, lambda reply: None, payload=body, attachment=str(os.getpid()), timeout=60)
    os.kill(os.getpid(), signal.SIGSTOP)
"""
"""More than its share of the queue, and 15 MB more than its link holds; then it is frozen."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    parser.add_argument("--clients", type=int, default=3, help="that read nothing")
    parser.add_argument("--seconds", type=float, default=12.0, help="of plans beside them")
    parser.add_argument("--json", action="store_true", help="print the rows as JSON")


def run(args: argparse.Namespace) -> int:
    """Measure and print; exit code 0 if each plan of the others was OK."""
    with tempfile.TemporaryDirectory() as folder, serving(Path(folder), "--workers", "2") as service:
        rows = _beside(service, args.clients, args.seconds)
    show(rows, as_json=args.json)
    return 0 if all(row["failed"] == 0 for row in rows) else 1


def _beside(service: Running, clients: int, seconds: float) -> list[Row]:
    with Client.connect(service.endpoint) as client:
        version = str(client.info("office")["version"])
        _plans(client, service, 0, QUIET_S / 2)  # warm
        rows, frozen = [_plans(client, service, 0, QUIET_S)], list[subprocess.Popen[bytes]]()
        try:
            for _ in range(clients):
                frozen.append(subprocess.Popen([sys.executable, "-c", ASKER, service.endpoint, version]))
            rows.append(_plans(client, service, clients, seconds))
        finally:
            for process in frozen:
                process.kill()
                process.wait()
    return rows


def _plans(client: Client, service: Running, clients: int, seconds: float) -> Row:
    """One plan after another of who reads."""
    took, failed, until = list[float](), 0, time.monotonic() + seconds
    while time.monotonic() < until:
        began = time.perf_counter()
        failed += client.plan("office", service.start, service.goal, "roomba").status != "OK"
        took.append(time.perf_counter() - began)
    p50, p99 = 1e3 * np.quantile(took, [0.5, 0.99])
    return {
        "unread": clients,
        "plans": len(took),
        "failed": failed,
        "p50_ms": float(p50),
        "p99_ms": float(p99),
        "max_ms": 1e3 * max(took),
    }

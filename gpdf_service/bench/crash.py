"""`gpdf bench crash`: kill -9 at random moments of uploads, updates and log writes; then look what is left."""

from __future__ import annotations

import argparse
import contextlib
import sys
import tempfile
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from gpdf_client import Client
from gpdf_client.results import ClientError
from gpdf_schemas import Array, SceneReply, Status, UpdateRequest, UploadRequest, keys
from mcap.exceptions import McapError
from mcap.reader import make_reader
from tqdm import tqdm

from gpdf_service.bench.report import Row, show
from gpdf_service.ports import free_endpoint
from gpdf_service.service.begun import begun
from gpdf_service.service.record import check, repair_folder
from gpdf_service.service.replay import recorded_plans
from gpdf_service.types import FloatArray

SPACING = 0.1
"""[m] Of the rooms that are sent: small, so that the kills meet many different moments."""
WAIT_S = 300.0
"""[s] For what must happen at all."""
ANSWER_S = 2.0
"""[s] For an acknowledgement; a service that was killed gives none, and each kill waits for that."""
FEWEST = 3
"""Widths of a room [cells]; each upload has its own, so that its points tell which one it was."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    parser.add_argument("--kills", type=int, default=100, help="how often the service is killed")
    parser.add_argument("--within", type=float, default=4.0, help="seconds of work that a kill falls into")
    parser.add_argument("--seed", type=int, default=0, help="of the moments")
    parser.add_argument("--json", action="store_true", help="print the row as JSON")


@dataclass
class _Told:
    """What was acknowledged: points of each scene, plans that were answered."""

    points: dict[str, set[int]] = field(
        default_factory=dict
    )  # any of these: what was acknowledged, or is under way; 0: none
    plans: list[str] = field(default_factory=list)
    uploads: int = 0
    updates: int = 0


def run(args: argparse.Namespace) -> int:
    """Exit code 0 if nothing that was acknowledged is lost and every log reads."""
    rng = np.random.default_rng(args.seed)
    with tempfile.TemporaryDirectory() as folder:
        row = _kill_many(Path(folder), args.kills, args.within, rng)
    show([row], as_json=args.json)
    return 0 if row["lost"] == row["bad_logs"] == row["plans_lost"] == 0 else 1


def _kill_many(folder: Path, kills: int, within: float, rng: np.random.Generator) -> Row:
    told, lost, endpoint = _Told(), 0, free_endpoint()
    words = ["--endpoint", endpoint, "--workers", "1", "--log-sync", "each"]
    words += ["--log-dir", str(folder / "log"), "--scenes-dir", str(folder)]
    for i in tqdm(range(kills + 1), desc="kill", disable=not sys.stderr.isatty()):
        with begun(folder / "serve.log", *words) as process, Client.connect(endpoint, timeout_s=WAIT_S) as client:
            lost += _missing(client, told)
            if i == kills:
                break
            worker = threading.Thread(target=_work, args=(client, told, i), daemon=True)
            worker.start()
            time.sleep(rng.uniform(0.0, within))
            process.kill()
            process.wait()
            worker.join()
    repair_folder(folder / "log")
    logs = list((folder / "log").glob("*.mcap"))
    planned = {request.request_id for log in logs for request, _ in recorded_plans(log)}
    return {
        "kills": kills,
        "uploads": told.uploads,
        "updates": told.updates,
        "plans": len(told.plans),
        "lost": lost,
        "plans_lost": len(set(told.plans) - planned),
        "logs": len(logs),
        "bad_logs": sum(not _reads(log) for log in logs),
    }


def _room(width: int) -> FloatArray:
    x, y = np.meshgrid(SPACING * np.arange(20 + width), SPACING * np.arange(20))
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])


def _work(client: Client, told: _Told, number: int) -> None:
    """Upload, change and plan until the service is gone; write down what is under way, and what was acknowledged."""
    with contextlib.suppress(ClientError):
        for step in range(1000):
            name, width = f"room{step % 3}", FEWEST + (97 * number + step) % 50
            before, now = told.points.get(name, {0}), 20 * (20 + width)
            told.points[name] = before | {now}
            request = UploadRequest(
                scene=name, upload_id=f"{number}-{step}", part=0, parts=1, points=Array.pack(_room(width))
            )
            client.ask(keys.SCENE_UPLOAD, request, SceneReply, ANSWER_S, {Status.BUILDING})
            told.points[name], told.uploads = {now}, told.uploads + 1
            told.points[name] = {now, now + 1}
            point, gone = Array.pack(np.array([[1.0, 1.0, 0.5 + 1e-3 * step]])), Array.pack(np.zeros(1), "f4")
            change = UpdateRequest(scene=name, upload_id=f"c{number}-{step}", part=0, parts=1, points=point, gone=gone)
            client.ask(keys.SCENE_UPDATE, change, SceneReply, ANSWER_S, {Status.BUILDING})
            told.points[name], told.updates = {now + 1}, told.updates + 1
            plan = f"{number}-{step}"
            with contextlib.suppress(ClientError):  # it is being built
                client.plan(name, (0.5, 0.5), (1.5, 1.5), "roomba", request_id=plan, deadline_s=1.0)
                told.plans.append(plan)


def _missing(client: Client, told: _Told) -> int:
    """Scenes that are not as they were acknowledged."""
    missing = 0
    for name, points in told.points.items():
        try:
            found = client.wait_for_scene(name, timeout_s=WAIT_S)["points"]
        except ClientError:
            found = 0
        missing += found not in points
        told.points[name] = {found}
    return missing


def _reads(log: Path) -> bool:
    try:
        with log.open("rb") as file:
            for _ in make_reader(file, validate_crcs=True).iter_messages():
                pass
    except (McapError, ValueError, OSError):
        return False
    return check(log).whole

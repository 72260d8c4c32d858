"""`gpdf bench soak`: loads, uploads, plans, moving obstacles and unloads for a while; what the process keeps of it."""

from __future__ import annotations

import argparse
import random
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
from gpdf_client import Client
from gpdf_client.results import ClientError, ServiceError, UnknownSceneError
from gpdf_schemas import Cylinder, MovingObstacle, Reply
from tqdm import tqdm

from gpdf_service.bench.report import Row, show
from gpdf_service.bench.running import Running, serving
from gpdf_service.types import AGENTS, FloatArray

SAMPLE_S = 1.0
"""[s] Between looks at the process."""
WARM = 0.3
"""[-] Share of the time that fills caches and pools before anything is judged."""
MAX_SLOPE_MB_PER_MIN = 2.0
"""Growth of memory that counts as a leak: 2.9 GB in a day."""
LEAST_MINUTES = 4.0
"""For a slope that means something: loads and unloads move memory up and down by 60 MB within a minute."""
MAX_GROWTH = 3
"""Threads or files more at the end than after the warm-up: what happens to be open at one moment."""
PLANNERS = 3
"""Clients that plan."""
PATIENCE_S = 120.0
"""[s] For a plan: this looks for leaks, also on a machine that is busy with other things."""
Count = Callable[[str], None]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    parser.add_argument("--minutes", type=float, default=15.0, help="how long")
    parser.add_argument("--seed", type=int, default=0, help="of what is asked")
    parser.add_argument("--json", action="store_true", help="print the row as JSON")


def run(args: argparse.Namespace) -> int:
    """Exit code 0 if nothing failed and nothing grew."""
    flags = ("--log-segment-mb", "8", "--log-keep-mb", "64", "--scene-memory-mb", "200")
    with tempfile.TemporaryDirectory() as folder, serving(Path(folder), *flags) as service:
        row = soak(service, 60.0 * args.minutes, args.seed)
    show([row], as_json=args.json)
    leaks = args.minutes >= LEAST_MINUTES and row["rss_mb_per_min"] > MAX_SLOPE_MB_PER_MIN
    grew = leaks or max(row["threads_grew"], row["files_grew"]) > MAX_GROWTH
    return 1 if grew or row["failed"] or not row["plans"] else 0


def soak(service: Running, seconds: float, seed: int) -> Row:
    """Keep everybody busy for some seconds and watch the process."""
    done, counts, lock = threading.Event(), Counter[str](), threading.Lock()

    def count(what: str) -> None:
        with lock:
            counts[what] += 1

    with ThreadPoolExecutor(PLANNERS + 2) as pool:
        rng = random.Random(seed)
        jobs = [pool.submit(_plan_on, service, done, count, random.Random(rng.random())) for _ in range(PLANNERS)]
        jobs.append(pool.submit(_change_scenes, service, done, count))
        jobs.append(pool.submit(_move, service, done, count, random.Random(rng.random())))
        try:
            samples = _watch(service, seconds)
        finally:
            done.set()
        for job in jobs:
            job.result()
    warm = samples[int(WARM * len(samples)) :]
    minutes = np.arange(len(warm)) * SAMPLE_S / 60
    slope = float(np.polyfit(minutes, [sample["rss_mb"] for sample in warm], 1)[0])
    third = max(1, len(warm) // 3)
    return {
        "seconds": seconds,
        **{what: counts[what] for what in ("plans", "failed", "loads", "uploads", "unloads", "moves")},
        "rss_mb": warm[-1]["rss_mb"],
        "rss_mb_per_min": slope,
        **{f"{what}_grew": _median(warm[-third:], what) - _median(warm[:third], what) for what in ("threads", "files")},
        "answers": _answers(service),
    }


def _watch(service: Running, seconds: float) -> list[dict[str, float]]:
    samples, until = [], time.monotonic() + seconds
    with tqdm(total=round(seconds), desc="soak", unit="s", disable=not sys.stderr.isatty()) as bar:
        while time.monotonic() < until:
            samples.append(service.usage())
            time.sleep(SAMPLE_S)
            bar.update(SAMPLE_S)
    return samples


def _plan_on(service: Running, done: threading.Event, count: Count, rng: random.Random) -> None:
    """Plan in the office for everybody, and in a scene that comes and goes."""
    with Client.connect(service.endpoint) as client:
        while not done.is_set():
            agent = rng.choice(list(AGENTS))
            count("plans")
            with _counted(count):
                result = client.plan("office", service.start, service.goal, agent, deadline_s=PATIENCE_S)
                if result.status != "OK":
                    raise ServiceError(Reply(status=result.status, message=result.message))
            with _counted(count), suppress(UnknownSceneError):  # it has just gone, or is being built
                client.plan("floor", (0.5, 0.5), (2.5, 2.0), agent, deadline_s=PATIENCE_S)


def _change_scenes(service: Running, done: threading.Event, count: Count) -> None:
    with Client.connect(service.endpoint) as client:
        for i in range(1_000_000):
            if done.is_set():
                return
            with _counted(count):
                client.load_scene("floor", upload=_floor(3.0 + i % 3))
                count("uploads")
                client.load_scene("again", "office.npz")
                count("loads")
                for name in ("floor", "again"):
                    client.unload_scene(name)
                    count("unloads")


@contextmanager
def _counted(count: Count) -> Iterator[None]:
    """A failure is told and counted; the others go on."""
    try:
        yield
    except ClientError as error:
        count("failed")
        print(error, file=sys.stderr)  # noqa: T201


def _move(service: Running, done: threading.Event, count: Count, rng: random.Random) -> None:
    """Somebody walks through the scene that nobody's success depends on."""
    with Client.connect(service.endpoint) as client:
        while not done.wait(0.2):
            base = (rng.uniform(0, 3), rng.uniform(0, 3), 0.0)
            client.publish_obstacles(
                "floor", [MovingObstacle(id=str(rng.randrange(5)), cylinder=Cylinder(base, 0.25, 1.8))]
            )
            count("moves")


def _floor(width: float) -> FloatArray:
    x, y = np.meshgrid(np.arange(0, width, 0.05), np.arange(0, 3, 0.05))
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])


def _median(samples: list[dict[str, float]], what: str) -> float:
    return float(np.median([sample[what] for sample in samples]))


def _answers(service: Running) -> int:
    """What the service itself says that it answered."""
    with Client.connect(service.endpoint) as client:
        (status,) = client.status()
    return int(sum(number for name, number in status.metrics.items() if name.startswith("answers_")))

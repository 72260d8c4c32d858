"""`gpdf bench hostile`: clouds that nobody should send, each answered in words, and what memory the answer took.

With `--served` they are sent to a service where others plan meanwhile, and what the others wait is measured.
"""

from __future__ import annotations

import argparse
import resource
import sys
import tempfile
import threading
import time
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from gpdf_client import Client, ClientError
from tqdm import tqdm

import gpdf_service as gpdf
from gpdf_service.bench.report import Row, show
from gpdf_service.bench.running import Running, serving
from gpdf_service.cores import end_with_parent
from gpdf_service.synthetic.hostile import Hostile, hostile_clouds

ALLOWED = 4.0, 5e8
"""Times the cloud's own memory, and bytes beside it, that an answer may take."""
QUIET = 10
"""Plans before each cloud is sent: a machine's other work is then in both."""
OTHERS = 2.0
"""Times the quiet p99 that others' plans may take."""
PATIENCE_S = 300.0
"""[s] For what must happen at all."""
LIMIT = 8 << 30
"""[bytes] Of data that the process which answers may hold: what asks for more is refused by the system."""


def answer(count: int, seed: int, index: int) -> Row:
    """Build one of the `hostile_clouds` and plan in it; runs in a process of its own."""
    return measure(hostile_clouds(count, seed)[index])


def measure(cloud: Hostile) -> Row:
    """Build a scene of a cloud, plan for a person in it, and say what came of it and how much memory it took at most.

    Linux alone tells a process's peak, and forgets it when told so.
    """
    before, began = _peak_from_here(), time.process_time()
    try:
        scene = gpdf.build_scene(cloud.points, cloud.ground)
        low, high = cloud.points.min(axis=0), cloud.points.max(axis=0)
        said = gpdf.plan(scene, low[:2] + 0.1 * (high - low)[:2], low[:2] + 0.9 * (high - low)[:2], deadline_s=20.0)
        words = f"{said.status}: {said.message}"
    except gpdf.GpdfError as error:
        words = f"{type(error).__name__}: {error}"
    taken = _memory("VmHWM") - before
    allowed = ALLOWED[0] * cloud.points.nbytes + ALLOWED[1]
    return {
        "cloud": cloud.name,
        "points": len(cloud.points),
        "labelled": cloud.ground is not None,
        "mb": taken / 1e6,
        "within": bool(taken <= allowed),
        "cpu_s": time.process_time() - began,
        "answer": words,
    }


def _peak_from_here() -> float:
    """Memory now [bytes]; the peak is counted from here on."""
    Path("/proc/self/clear_refs").write_text("5")  # proc(5): resets VmHWM
    return _memory("VmRSS")


def _memory(name: str) -> float:
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024.0 * float(next(line for line in lines if line.startswith(name)).split()[1])


def _ready() -> None:
    """Load and compile what a scene needs, within the limit."""
    end_with_parent()
    resource.setrlimit(resource.RLIMIT_DATA, (LIMIT, LIMIT))
    x, y = (axis.ravel() for axis in np.meshgrid(*2 * [np.arange(0.0, 3.0, 0.03)], indexing="ij"))
    floor = np.column_stack([x, y, np.zeros(len(x))])
    for ground in (np.ones(len(x), dtype=bool), None):
        gpdf.plan(gpdf.build_scene(floor, ground), (1.0, 1.0), (2.0, 2.0))


def measure_all(count: int, seed: int, wanted: list[int] | None = None) -> list[Row]:
    """`answer` of each cloud, or of the `wanted` ones, one after another in a process that is begun anew if it dies."""
    rows: list[Row] = []
    one = partial(answer, count, seed)
    left = list(range(count)) if wanted is None else list(wanted)
    bar = tqdm(total=len(left), desc="hostile clouds", disable=not sys.stderr.isatty())
    while left:
        with ProcessPoolExecutor(1, get_context("spawn"), _ready) as pool:
            try:
                while left:
                    rows.append(pool.submit(one, left[0]).result())
                    left.pop(0)
                    bar.update()
            except (BrokenProcessPool, MemoryError) as error:
                name = hostile_clouds(count, seed)[left.pop(0)].name
                rows.append({"cloud": name, "within": False, "answer": f"{type(error).__name__}: {error}"})
    bar.close()
    return rows


def serve_others(service: Running, clouds: list[Hostile]) -> Row:
    """Send the clouds one after another, and plan: a few times before each, and until it is answered."""
    quiet, beside, words = list[float](), list[float](), list[str]()
    with Client.connect(service.endpoint) as planner, Client.connect(service.endpoint) as sender:

        def timed() -> float:
            began = time.perf_counter()
            planner.plan("office", service.start, service.goal, deadline_s=PATIENCE_S)
            return time.perf_counter() - began

        for cloud in tqdm(clouds, desc="served", disable=not sys.stderr.isatty()):
            quiet += [timed() for _ in range(QUIET)]
            sending = threading.Thread(target=lambda cloud=cloud: words.append(_send(sender, cloud)))
            sending.start()
            beside.append(timed())  # at least one, however soon the cloud is answered
            while sending.is_alive():
                beside.append(timed())
            sending.join()
    p99 = [1e3 * float(np.quantile(took, 0.99)) for took in (quiet, beside)]
    return {
        "clouds": len(clouds),
        "built": words.count(""),
        "refused_in_words": sum(len(said.split()) > 5 for said in words),
        "plans_quiet": len(quiet),
        "quiet_p50_ms": 1e3 * float(np.median(quiet)),
        "quiet_p99_ms": p99[0],
        "plans_beside": len(beside),
        "beside_p50_ms": 1e3 * float(np.median(beside)),
        "beside_p99_ms": p99[1],
        "ratio": p99[1] / p99[0],
    }


def _send(client: Client, cloud: Hostile) -> str:
    """What a service says of a cloud; nothing if it makes a scene of it, which then is unloaded."""
    try:
        client.load_scene("hostile", upload=cloud.points, ground=cloud.ground, timeout_s=PATIENCE_S)
        client.unload_scene("hostile")
    except ClientError as error:
        return str(error)
    return ""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of this benchmark."""
    parser.add_argument("--count", type=int, default=100, help="clouds, of each of ten kinds in turn")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--served", action="store_true", help="send them to a service where others plan, instead")
    parser.add_argument("--json", action="store_true", help="print the rows as JSON")


def run(args: argparse.Namespace) -> int:
    """Run it; fails if an answer took more memory than it may, or others waited for it."""
    if args.served:
        with tempfile.TemporaryDirectory() as folder, serving(Path(folder)) as service:
            row = serve_others(service, hostile_clouds(args.count, args.seed))
        show([row], as_json=args.json)
        return 0 if row["ratio"] <= OTHERS and row["built"] + row["refused_in_words"] == row["clouds"] else 1
    rows = measure_all(args.count, args.seed)
    show(rows, as_json=args.json)
    return 0 if all(row["within"] for row in rows) else 1

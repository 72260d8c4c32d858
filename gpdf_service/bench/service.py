"""`gpdf bench service`: what wire and log add to a plan, plans a second, too many clients, the first plan of all.

The service has its own processes. The clients run on its cores, one or two, and their work counts: a machine of one
core against a machine of two.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import cycle
from pathlib import Path

import numpy as np
import zenoh
from gpdf_client import Client
from gpdf_client.client import client_config
from gpdf_schemas import PlanRequest, Reply, Status, decode, encode, keys
from tqdm import trange

from gpdf_service.bench.plan import random_places
from gpdf_service.bench.plotting import add_plot_argument, draw_rows
from gpdf_service.bench.report import Row, show
from gpdf_service.bench.running import Running, serving
from gpdf_service.pipeline import build_scene, plan
from gpdf_service.synthetic import SCENES
from gpdf_service.types import resolve_agent

AGENT = "human"
OVER = 2.0
"""Times the capacity that all clients together ask for."""
PATIENCE_S = 60.0
"""[s] Until a request counts as unanswered."""
WARM_S = 2.0
"""[s] Before anything is measured: each process has its free space, queues and pools have grown."""
Took = tuple[float, float]
"""Of a plan: by the clock, and what the service's processes worked [s]; the system counts that in steps of 10 ms."""
TENTH = 10
"""Plans of a service that was just begun; the last of them takes what plans take."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    parser.add_argument("--count", type=int, default=100, help="plans for what the wire adds")
    parser.add_argument("--seconds", type=float, default=10.0, help="for each of the other measurements")
    parser.add_argument("--clients", type=int, default=64, help="clients that ask for twice what the service can do")
    parser.add_argument("--restarts", type=int, default=20, help="services begun for the first plan after `ready`")
    add_plot_argument(parser)
    parser.add_argument("--json", action="store_true", help="print the rows as JSON")


def run(args: argparse.Namespace) -> int:
    """Measure and print; exit code 0 if every request was answered."""
    with tempfile.TemporaryDirectory() as one, serving_on(Path(one), 1) as service:
        single = per_second(service, 1, args.seconds)
    cores = min(2, len(os.sched_getaffinity(0)))
    with tempfile.TemporaryDirectory() as two, serving_on(Path(two), cores) as service:
        took = [first_plans(service)]
        wire = added(service, args.count)
        double = per_second(service, cores, args.seconds)
        crowd = overload(service, args.clients, OVER * double["plans_per_s"], args.seconds)
    speed = {"ratio": double["plans_per_s"] / single["plans_per_s"]}
    speed |= {f"{name}_{n}": row[name] for n, row in ((1, single), (cores, double)) for name in row}
    first = first_and_tenth([*took, *begin_again(cores, args.restarts - 1)])
    rows = [row | {"load_average": os.getloadavg()[0]} for row in (wire, speed, crowd, first)]
    for part in [rows] if args.json else [[row] for row in rows]:
        show(part, as_json=args.json)
    if args.plot:
        panels = {"time of a plan [ms]": [name for name in wire if name.endswith("_ms")]}
        draw_rows(args.plot, [wire], panels, title=f"What the wire adds, {args.count} plans")
    return 1 if crowd["unanswered"] else 0


@contextmanager
def serving_on(folder: Path, cores: int) -> Iterator[Running]:
    """The service, and us, on so many cores, a worker each."""
    ours = os.sched_getaffinity(0)
    os.sched_setaffinity(0, set(sorted(ours)[:cores]))  # a child has its parent's
    try:
        with serving(folder, "--workers", str(cores)) as running:
            yield running
    finally:
        os.sched_setaffinity(0, ours)


def added(service: Running, count: int) -> Row:
    """Each plan once over Zenoh and once in process, in turn, so that a noisy machine is noisy for both."""
    office, agent = SCENES["office"](np.random.default_rng(0)), resolve_agent(AGENT)
    scene = build_scene(office.points, office.ground)
    over, inside = [], []
    with Client.connect(service.endpoint) as client:
        for start, goal in random_places(scene, agent, count, np.random.default_rng(0)):
            plan(scene, start, goal, agent)
            client.plan("office", start, goal, AGENT)
            began = time.perf_counter()
            client.plan("office", start, goal, AGENT)
            middle = time.perf_counter()
            plan(scene, start, goal, agent)
            over.append(middle - began)
            inside.append(time.perf_counter() - middle)
    extra = np.array(over) - np.array(inside)
    return {
        "plans": count,
        "in_process_p50_ms": 1e3 * float(np.median(inside)),
        "over_zenoh_p50_ms": 1e3 * float(np.median(over)),
        "added_p50_ms": 1e3 * float(np.median(extra)),
        "added_p90_ms": 1e3 * float(np.quantile(extra, 0.9)),
    }


def begin_again(cores: int, times: int) -> list[list[Took]]:
    """`first_plans` of so many services."""
    took = []
    for _ in trange(times, desc="restart", disable=not sys.stderr.isatty()):
        with tempfile.TemporaryDirectory() as folder, serving_on(Path(folder), cores) as service:
            took.append(first_plans(service))
    return took


def first_plans(service: Running) -> list[Took]:
    """What each of the first plans takes of a service that has just said that it is ready."""
    took = list[Took]()
    with Client.connect(service.endpoint) as client:
        for _ in range(TENTH):
            before, began = service.usage()["cpu_s"], time.perf_counter()
            client.plan("office", service.start, service.goal, AGENT)
            lasted = time.perf_counter() - began
            took.append((lasted, service.usage()["cpu_s"] - before))
    return took


def first_and_tenth(took: list[list[Took]]) -> Row:
    """The first plan beside the tenth, of services that were just begun: by the clock, and by what they work."""
    first, tenth = 1e3 * np.array(took)[:, [0, -1], 0].T
    worked = 1e3 * np.array(took)[:, [0, -1], 1]
    return {
        "restarts": len(took),
        "first_p50_ms": float(np.median(first)),
        "first_max_ms": float(first.max()),
        "tenth_p50_ms": float(np.median(tenth)),
        "first_over_tenth_max_ms": float((first - tenth).max()),
        "first_over_tenth_over_50": int((first - tenth > 50.0).sum()),
        "first_over_tenth_cpu_max_ms": float((worked[:, 0] - worked[:, 1]).max()),
    }


class Crowd:
    """Clients that ask without waiting for one another; they share a session, and each has a name of its own.

    Args:
        session: A session that leads to the service.
        service: Where the places are.
    """

    def __init__(self, session: zenoh.Session, service: Running) -> None:
        self._session = session
        places = [(service.start, service.goal), (service.goal, service.start)]
        self._requests = cycle([encode(self._request(*place)) for place in places])
        self.asked, self.answers = 0, Counter[str]()
        self.seconds: list[float] = []  # of accepted ones
        self._change = threading.Condition()

    @staticmethod
    def _request(start: tuple[float, ...], goal: tuple[float, ...]) -> PlanRequest:
        return PlanRequest(scene="office", start=list(start), goal=list(goal), agent=AGENT, deadline_s=PATIENCE_S)

    def ask(self, client: int) -> None:
        """Send a request; returns at once."""
        began = time.perf_counter()

        def hear(answer: zenoh.Reply) -> None:
            took = time.perf_counter() - began
            status = decode(answer.ok.payload.to_bytes(), Reply).status if answer.ok else Status.TIMEOUT
            with self._change:
                self.answers[status] += 1
                if status is Status.OK:
                    self.seconds.append(took)
                self._change.notify_all()

        with self._change:
            self.asked += 1
        self._session.get(
            keys.PLAN, hear, payload=next(self._requests), attachment=f"client {client}", timeout=PATIENCE_S
        )

    def wait(self, at_most: int) -> bool:
        """Wait until no more than so many requests are open; whether that came."""
        with self._change:
            return self._change.wait_for(lambda: self.asked - self.answers.total() <= at_most, PATIENCE_S)


def per_second(service: Running, workers: int, seconds: float) -> Row:
    """Plans a second with two requests a worker open all the time, and what CPU time a plan costs all of us."""
    at_once = 2 * workers
    with zenoh.open(client_config(service.endpoint)) as session:
        crowd = Crowd(session, service)
        _keep_open(crowd, at_once, WARM_S)
        warm, before, own = crowd.answers[Status.OK], service.usage()["cpu_s"], time.process_time()
        began = time.perf_counter()
        _keep_open(crowd, at_once, seconds)
        plans, lasted = crowd.answers[Status.OK] - warm, time.perf_counter() - began
        used = service.usage()["cpu_s"] - before, time.process_time() - own
    return {
        "plans_per_s": plans / lasted,
        "service_cpu_ms": 1e3 * used[0] / plans,
        "clients_cpu_ms": 1e3 * used[1] / plans,
    }


def _keep_open(crowd: Crowd, at_once: int, seconds: float) -> None:
    until = time.perf_counter() + seconds
    while time.perf_counter() < until:
        crowd.ask(crowd.asked % at_once)
        crowd.wait(at_once - 1)
    crowd.wait(0)


def overload(service: Running, clients: int, rate: float, seconds: float) -> Row:
    """What becomes of `rate` requests a second, in turn by so many clients."""
    with zenoh.open(client_config(service.endpoint)) as session:
        crowd = Crowd(session, service)
        _ask_at(crowd, clients, rate, WARM_S)
        before, warm = service.usage(), crowd.asked
        began = time.perf_counter()
        _ask_at(crowd, clients, rate, seconds)
        lasted = time.perf_counter() - began
        crowd.wait(0)
        after = service.usage()
    return {
        "clients": clients,
        "asked_per_s": (crowd.asked - warm) / lasted,
        "asked": crowd.asked,
        **{status.lower(): count for status, count in sorted(crowd.answers.items())},
        "unanswered": crowd.asked - crowd.answers.total(),
        "ok_p50_ms": 1e3 * float(np.median(crowd.seconds)),
        "ok_p99_ms": 1e3 * float(np.quantile(crowd.seconds, 0.99)),
        "rss_mb_before": before["rss_mb"],
        "rss_mb_after": after["rss_mb"],
    }


def _ask_at(crowd: Crowd, clients: int, rate: float, seconds: float) -> None:
    began, first = time.perf_counter(), crowd.asked
    while (now := time.perf_counter() - began) < seconds:
        for _ in range(int(now * rate) - (crowd.asked - first)):
            crowd.ask(crowd.asked % clients)
        time.sleep(1.0 / rate)

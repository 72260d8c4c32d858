"""`gpdf bench refusals`: how soon a plan is refused, whether what the refusal names helps, and who is late.

Places are random ones of every level, half of them where the body does not stand. A refusal makes a promise: a body as
narrow, low or able as it says gets there, and at the nearest free place the body can be. A sample of them is tried.
"""

from __future__ import annotations

import argparse
import gc
import time
from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from gpdf_service.bench.report import Row, add_scene_arguments, clouds, each, show
from gpdf_service.pipeline import build_scene, plan
from gpdf_service.scene import Scene
from gpdf_service.synthetic import SCENES
from gpdf_service.types import AGENTS, Agent, FloatArray, PlanResult, Status

WARM = 5
"""Plans before the clock runs: the first ones of a process load what is compiled."""
ASIDE = 0.2
"""[m] Places lie up to so far beside the centre of a cell of ground: some are off it."""
STANDS = 0.5
"""[-] Of the places are where the body stands, so that ways are refused, too, and not only places."""
KEPT = 0.95
"""[-] Of the promises that were tried, at least."""
ROUNDING = 1e-6
"""[m, rad] What was lifted is over its limit by this, not on it."""
SHORT = ("short_width", "short_height", "short_step", "short_slope")
"""What `details` may say that a body exceeds; ground that is unseen or solid names no body."""
TOGETHER = "; and "
"""Between limits, in a message, that have to be lifted all at once; any one of others is enough."""


@dataclass(frozen=True, slots=True)
class _Refused:
    """A query that was refused: how long that took by the clock and the processor [s], and which promises helped."""

    seconds: float
    cpu: float
    helped: list[bool]


_Found = dict[Status, list[_Refused]]
"""What was refused with each status."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    add_scene_arguments(parser, list(SCENES))
    parser.add_argument("--agent", action="append", help="human and roomba when not given")
    parser.add_argument("--count", type=int, default=300, help="queries for each scene and body")
    parser.add_argument("--tried", type=int, default=10, help="promises of each status that are tried")
    parser.add_argument("--deadlines", type=float, nargs="+", help="[s] who is late with so much time, alone")
    parser.add_argument("--seed", type=int, default=1)


def run(args: argparse.Namespace) -> int:
    """Exit code 0 if what refusals name helps, or of deadlines, if nobody is refused after one for want of a path."""
    rows: list[Row] = []
    every: _Found = {}
    for name, points, ground, _ in clouds(args):
        scene = build_scene(points, ground)
        for agent in args.agent or ["human", "roomba"]:
            body, rng, which = AGENTS[agent], np.random.default_rng(args.seed), {"scene": name, "agent": agent}
            pairs = random_queries(scene, body, args.count, rng)
            scene.prepare(body)  # what a body's first plan builds knows no deadline
            for start, goal in pairs[:WARM]:
                plan(scene, start, goal, body)
            gc.freeze()  # as a service does: a look through what is loaded takes 74 ms
            if args.deadlines:
                rows += [which | measure_deadline(scene, body, pairs, deadline_s) for deadline_s in args.deadlines]
                continue
            found = measure_refusals(scene, body, pairs, args.tried)
            rows += [which | row for row in rows_of(found)]
            for status, some in found.items():
                every.setdefault(status, []).extend(some)
    rows += [{"scene": "all", "agent": "all"} | row for row in rows_of(every)]
    show(rows, as_json=args.json)
    if args.deadlines:
        return 0 if all(row["uncertified"] == 0 for row in rows) else 1
    promises = [good for some in every.values() for one in some for good in one.helped]
    return 0 if sum(promises) >= KEPT * len(promises) else 1


def random_queries(scene: Scene, agent: Agent, count: int, rng: np.random.Generator) -> FloatArray:
    """Pairs of places (count, 2, 3) [m], on all levels alike, x, y and the ground's z; `STANDS` where the body does."""
    space = scene.free_space(agent)
    anywhere, standing = [], []
    for level, surface in enumerate(scene.surfaces):
        cells = np.argwhere(np.isfinite(surface.height))
        if len(cells) == 0:
            continue
        cells = cells[rng.integers(len(cells), size=2 * count)]
        center = surface.origin + (cells + 0.5) * surface.cell_width
        z = surface.height[tuple(cells.T)][:, None]
        fits = space.levels[level].clearance(center)[0] >= agent.disc_radius
        standing.append(np.hstack([center, z])[fits])
        anywhere.append(np.hstack([center + rng.uniform(-ASIDE, ASIDE, center.shape), z]))
    free = _one_of(standing, 2 * count, rng)
    chosen = np.where(rng.random(2 * count)[:, None] < STANDS, free, _one_of(anywhere, 2 * count, rng))
    return chosen.reshape(count, 2, 3)


def _one_of(places: list[FloatArray], count: int, rng: np.random.Generator) -> FloatArray:
    """So many places, each of a level that is drawn first, so that small levels are asked for, too."""
    levels = [some for some in places if len(some)]
    return np.array(
        [some[rng.integers(len(some))] for some in (levels[n] for n in rng.integers(len(levels), size=count))]
    )


def measure_refusals(scene: Scene, agent: Agent, pairs: FloatArray, tried: int) -> _Found:
    """What queries (n, 2, 3) [m] were refused; of each status the first `tried` that promise something are tried."""
    found: _Found = {}
    for start, goal in each(pairs, f"plans of a {agent.name}"):
        began, cpu = time.perf_counter(), time.process_time()
        result = plan(scene, start, goal, agent)
        seconds, cpu = time.perf_counter() - began, time.process_time() - cpu
        if result.status is Status.OK:
            continue
        some = found.setdefault(result.status, [])
        more = sum(len(one.helped) for one in some) < tried
        some.append(_Refused(seconds, cpu, tries(scene, agent, start, goal, result) if more else []))
    return found


def rows_of(found: _Found) -> list[Row]:
    """A row for each status: how soon it was answered, and how many promises helped."""
    return [_row(status, some) for status, some in sorted(found.items())]


def _row(status: Status, refused: list[_Refused]) -> Row:
    took = 1e3 * np.array([one.seconds for one in refused])
    helped = [good for one in refused for good in one.helped]
    return {
        "status": status.value,
        "refused": len(refused),
        "p50_ms": float(np.median(took)),
        "p95_ms": float(np.quantile(took, 0.95)),
        "p99_ms": float(np.quantile(took, 0.99)),
        "worst_ms": float(took.max()),
        "cpu_p99_ms": 1e3 * float(np.quantile([one.cpu for one in refused], 0.99)),
        "tried": len(helped),
        "helped": sum(helped),
    }


def tries(scene: Scene, agent: Agent, start: FloatArray, goal: FloatArray, refused: PlanResult) -> list[bool]:
    """Whether each thing that a refusal names helps; nothing if it names none.

    A nearest free place helps if the same end is not refused there again; another body, if it gets a path.
    """
    named = refused.details
    if "nearest_x" in named:
        place = np.array([named[f"nearest_{axis}"] for axis in "xyz"])
        at_start = refused.status in (Status.START_OCCUPIED, Status.START_OUTSIDE_MAP)
        again = plan(scene, place if at_start else start, goal if at_start else place, agent)
        return [again.status is not refused.status]
    return [plan(scene, start, goal, body).status is Status.OK for body in named_bodies(agent, refused)]


def named_bodies(agent: Agent, refused: PlanResult) -> list[Agent]:
    """The bodies that would get there, as a refusal says."""
    shorts = {key: refused.details[key] for key in SHORT if key in refused.details}
    if TOGETHER in refused.message:
        if "short_unknown" in refused.details or "short_solid" in refused.details:
            return []
        body = agent
        for key, short in shorts.items():
            body = _lifted(body, key, short)
        return [body] if shorts else []
    return [_lifted(agent, key, short) for key, short in shorts.items()]


def _lifted(agent: Agent, key: str, short: float) -> Agent:
    more = short + ROUNDING
    if key == "short_width":
        longer = max(agent.width, agent.length) - more  # of a cylinder the longer side is the diameter
        return replace(agent, width=min(agent.width, longer), length=min(agent.length, longer))
    if key == "short_height":
        return replace(agent, height=agent.height - more)
    if key == "short_step":
        return replace(agent, max_step=agent.max_step + more)
    return replace(agent, max_slope=agent.max_slope + more)


def measure_deadline(scene: Scene, agent: Agent, pairs: FloatArray, deadline_s: float) -> Row:
    """What queries (n, 2, 3) [m] are answered within a deadline [s], and how much later than it at worst.

    Both are on the processor's clock: who else is at work on the machine does not count.
    """
    statuses: Counter[Status] = Counter()
    late = []
    for start, goal in each(pairs, f"plans of a {agent.name}"):
        began = time.process_time()
        statuses[plan(scene, start, goal, agent, deadline_s=deadline_s, clock=time.process_time).status] += 1
        late.append(time.process_time() - began - deadline_s)
    return {
        "deadline_ms": 1e3 * deadline_s,
        "queries": len(pairs),
        "ok": statuses[Status.OK],
        "timeout": statuses[Status.TIMEOUT],
        "uncertified": statuses[Status.UNCERTIFIED],
        "refused": len(pairs) - sum(statuses[one] for one in (Status.OK, Status.TIMEOUT, Status.UNCERTIFIED)),
        "late": int(np.count_nonzero(np.array(late) > 0.0)),
        "late_p99_ms": 1e3 * max(0.0, float(np.quantile(late, 0.99))),
        "worst_late_ms": 1e3 * max(0.0, max(late)),
    }

"""How the time of a plan grows: with the length of the path, with clutter, and not with the map.

A hall of any length and 6 m wide, with walls that reach into it by turns from either side, at random places: no path is
straight, and the same path can be asked for in a short hall and in a long one.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gpdf_service.bench.report import Row, each
from gpdf_service.pipeline import build_scene, plan
from gpdf_service.scene import Scene
from gpdf_service.synthetic import Box, World
from gpdf_service.types import Agent, Status

WIDTH = 6.0
"""[m] Of the hall."""
REACH = 4.2
"""[m] How far a wall reaches into it: a human goes round each one, from one side of the hall to the other."""
THICK = 0.2
"""[m] Of a wall."""
EVERY = 10.0
"""[m] Between two walls, on average, where their number is not what is asked about."""
SHORT = 30.0
"""[m] The path that is asked for in maps of all lengths."""
MEDIUM = 100.0
"""[m] The path, and the hall, in which walls stand close or far."""
STEPS = (10.0, 30.0, 100.0, 300.0, 1000.0)
"""[m] Lengths of paths and of maps, each about three times the one before."""
CLUTTER = (50.0, 20.0, 10.0, 5.0, 2.5)
"""[m] Between two walls."""
SPACING = 0.1
"""[m] Between points: a kilometre has a million and a half."""
END = 1.0
"""[m] From a hall's end to the nearest start or goal; these move as far at most where they are in a wall."""
PANELS = {
    "path": ("walked_m", "length of the path [m], in the longest hall"),
    "map": ("map_m", f"length of the hall [m], paths of {SHORT:g} m"),
    "clutter": ("walls_per_100m", f"walls in {MEDIUM:g} m, paths of as much"),
}
"""Of the picture: what each sweep is drawn over."""


def measure_curve(agent: Agent, longest: float, repeats: int, rng: np.random.Generator) -> list[Row]:
    """Rows of three sweeps: over the path, over the map, and over the clutter.

    Args:
        agent: The body.
        longest: Path and map, no shorter than the path that is asked for in all maps [m].
        repeats: Paths in each row, at different places.
        rng: Places of the walls and of the paths.
    """
    lengths = [length for length in STEPS if length < longest] + [longest]
    halls = {length: build_hall(length + 2 * END, EVERY, rng) for length in lengths if length >= SHORT}
    long = halls[longest]
    rows: list[Row] = []
    for length in each(lengths, "lengths of path"):
        rows.append({"sweep": "path"} | _measure(long, longest, length, agent, repeats, rng))
    for size in each(halls, "sizes of map"):
        rows.append({"sweep": "map"} | _measure(halls[size], size, SHORT, agent, repeats, rng))
    for every in each(CLUTTER, "clutter"):
        hall, length = build_hall(MEDIUM + 2 * END, every, rng), min(MEDIUM, longest)
        rows.append(
            {"sweep": "clutter", "walls_per_100m": 100.0 / every} | _measure(hall, MEDIUM, length, agent, 1, rng)
        )
    return rows


def build_hall(length: float, every: float, rng: np.random.Generator) -> Scene:
    """A hall with a wall about every so many metres, from either side by turns."""
    count = round((length - 4 * END) / every)
    cells = 2 * END + (np.arange(count) + rng.uniform(0.3, 0.7, count)) * (length - 4 * END) / max(count, 1)
    sides = [(0.0, REACH) if i % 2 else (WIDTH - REACH, WIDTH) for i in range(count)]
    walls = [Box((x, low, 0.0), (x + THICK, high, 2.2)) for x, (low, high) in zip(cells, sides, strict=True)]
    return build_scene(*World((length, WIDTH, 2.5), tuple(walls), ceiling=False).sample(SPACING, rng))


def _measure(scene: Scene, size: float, length: float, agent: Agent, repeats: int, rng: np.random.Generator) -> Row:
    """Plan paths of a length in a hall of a size; each twice, the second one counts."""
    results, seconds = [], []
    for begin in rng.uniform(0.0, size - length, repeats) + END:
        ends = (begin, 0.5 * WIDTH), (begin + length, 0.5 * WIDTH)
        for counts in (False, True):
            began = time.process_time()
            result = plan(scene, *ends, agent, snap=END)
            if counts:
                seconds.append(time.process_time() - began)
                results.append(result)
    ok = [result for result in results if result.status is Status.OK and result.trajectory is not None]
    return {
        "map_m": size,
        "asked_m": length,
        "walked_m": float(np.mean([r.trajectory.length for r in ok if r.trajectory])) if ok else None,
        "queries": repeats,
        "ok": len(ok),
        "search_ms": 1e3 * float(np.median([r.timings["search"] for r in ok])) if ok else None,
        "cpu_ms": 1e3 * float(np.median(seconds)),
        "least_room_m": min((r.certificate.min_clearance for r in ok if r.certificate), default=None),
    }


def draw_curve(path: Path, rows: Sequence[Row]) -> None:
    """Draw the processor time of a plan over each sweep."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 4.2), layout="constrained")
    for axes, (sweep, (column, label)) in zip(
        figure.subplots(1, len(PANELS), sharey=True), PANELS.items(), strict=True
    ):
        shown = [row for row in rows if row["sweep"] == sweep and row["ok"]]
        axes.loglog([row[column] for row in shown], [row["cpu_ms"] for row in shown], "o-", color="#0072B2")
        for row in shown:
            at = row[column], row["cpu_ms"]
            axes.annotate(f"{row['cpu_ms']:.3g}", at, (0, 7), textcoords="offset points", ha="center", fontsize=9)
        axes.set_xticks([row[column] for row in shown], [f"{row[column]:.4g}" for row in shown])
        axes.set_xticks([], minor=True)
        axes.set(xlabel=label)
        axes.margins(0.12, 0.15)
        axes.grid(which="both", alpha=0.25)
    figure.axes[0].set_ylabel("processor time of a plan [ms]")
    path.parent.mkdir(parents=True, exist_ok=True)
    FigureCanvasAgg(figure).print_png(str(path))  # type: ignore[no-untyped-call]

"""A picture of one guided walk: walked against planned, with what was said where."""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np
from gpdf_guidance import Route, Walk
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from gpdf_service.types import BoolArray, FloatArray
from gpdf_service.viewer.picture import COLOURS

SLICE = (0.05, 2.0)
"""[m] Over the walked ground: points that can touch a person."""
AROUND = 2.0
"""[m] The picture shows this much around the walk."""


def draw_walk(
    path: str | os.PathLike[str], walk: Walk, routes: Sequence[Route], points: FloatArray, title: str
) -> None:
    """Draw a walk in plan, and its height over time.

    Args:
        path: The PNG to write.
        walk: What happened.
        routes: What was planned, in order.
        points: What stands in the world [m], shape (n, 3).
        title: Over the picture.
    """
    figure = Figure(figsize=(13, 10), layout="constrained")
    grid = figure.add_gridspec(2, 1, height_ratios=(3, 1))
    plan, side = figure.add_subplot(grid[0]), figure.add_subplot(grid[1])
    shown = points[_beside(walk.places, points)]
    plan.plot(shown[:, 0], shown[:, 1], ".", ms=0.6, color="#333333")
    for i, route in enumerate(routes):
        plan.plot(*route.ground[:, :2].T, color=COLOURS[0], lw=2, ls="--", label="planned" if i == 0 else None)
    plan.plot(*walk.places[:, :2].T, color=COLOURS[1], lw=2, label=f"walked: {walk.outcome}")
    side.plot(walk.times, walk.places[:, 2], color=COLOURS[1])
    for i, said in enumerate(walk.said, start=1):
        plan.annotate(str(i), (said.place[0], said.place[1]), fontsize=11, fontweight="bold", color=COLOURS[3])
        plan.plot([], [], " ", label=f"{i}: {said.time:.1f} s  {said.text}")
        side.axvline(said.time, color=COLOURS[3], lw=0.8)
    plan.plot(*walk.places[0, :2], "o", ms=10, mfc="white", mec="black", label="start")
    for route in routes[-1:]:
        plan.plot(*route.ground[-1, :2], "*", ms=15, mfc="white", mec="black", label="goal")
    plan.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", title=title)
    plan.legend(loc="upper left", bbox_to_anchor=(1.02, 1.0), fontsize=9)
    side.set(xlabel="time [s]", ylabel="z of the ground [m]", title="height, and when something was said")
    FigureCanvasAgg(figure).print_png(os.fspath(path))  # type: ignore[no-untyped-call]


def _beside(places: FloatArray, points: FloatArray) -> BoolArray:
    """Which points near the walk could touch a person there."""
    keep = np.zeros(len(points), dtype=bool)
    for place in places[:: max(1, len(places) // 200)]:
        over = points[:, 2] - place[2]
        near = (np.abs(points[:, :2] - place[:2]) < AROUND).all(axis=1)
        keep |= near & (over > SLICE[0]) & (over < SLICE[1])
    return keep

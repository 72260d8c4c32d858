"""The paper's Figures 4 to 8 on our scenes: the paths of the four methods, and of the four bodies."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import ceil
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle
from scipy.spatial import cKDTree

from gpdf_service.bench.brute import LEAST_ROOM, BruteForce
from gpdf_service.bench.paper_tables import TITLES
from gpdf_service.bench.report import Row
from gpdf_service.pipeline import Method, plan
from gpdf_service.scene import Scene
from gpdf_service.synthetic import SCENES
from gpdf_service.types import AGENTS, BoolArray, FloatArray, PlanResult, Status, Trajectory
from gpdf_service.viewer.picture import KIND_COLOURS, KIND_NAMES

METHOD_COLOURS: dict[Method, str] = {
    "prm": "#0072B2",
    "astar": "#56B4E9",
    "single_gpdf": "#D55E00",
    "dual_gpdf": "#009E73",
}
"""The paper's blue, cyan, red and green, as the colour-blind can tell them apart."""
AGENT_COLOURS = {"roomba": "#D55E00", "spot": "#E69F00", "pepper": "#0072B2", "human": "#009E73"}
"""The paper's red, yellow, blue and green."""
BODIES = {**AGENTS, "spot": replace(AGENTS["spot"], discs=6)}
"""Spot as long and narrow as it is: as the cylinder around it, it would hardly get anywhere in these scenes."""
WIDEST, NARROWER = 4.4, 0.8
"""[pt] Width of the first line, and how much less each next one is: paths over each other are all seen."""
FIGURES = {
    "office": "Fig. 4, Office 1 with step and hanging ball",
    "stair": "Fig. 5 (a), urban circuit",
    "cave": "Fig. 5 (b), cave circuit",
    "cluttered_office": "Fig. 6, Office 10",
    "cow_and_lady": "Fig. 7, Cow and lady",
}
AGENT_FIGURES = {"cluttered_office": "Fig. 8, Office 10"}
PLACES = {"office": ((1.6, 2.65), (5.55, 2.2))}
"""Starts and goals of the paper's figures where they differ from the scene's: in Fig. 4 the goal is on the step."""
WALL = 0.1
"""[m] What is this close to the near sides is left out of the 3D view, as in the paper's Fig. 4."""
CEILING = 2.2
"""[m] What is higher over the ground is not drawn: one looks in from above."""
CLOUD_POINTS = 25_000
"""Points of the cloud in a picture: more hide the paths."""
PANELS = 4
"""Refused queries beside each other in a picture."""
LEGEND = 8.0
"""[inch] Width of the legend below them."""
PANEL = 0.6
"""[m] Half of the width of a panel: a doorway, and what is beside it."""
TRUE_COLOUR, BODY_COLOUR = "#0072B2", "#009E73"
"""Of what truly is there, and of who would stand there."""
PAIRS = 30
"""Random pairs of which the furthest apart is drawn, where a scene has no start and goal of its own."""


def draw_scene_pictures(
    name: str, scene: Scene, points: FloatArray, ground: BoolArray, folder: Path, seed: int
) -> list[Path]:
    """Draw the human's path by each method, and each body's path by ours.

    Args:
        name: Of the scene.
        scene: Built from the noisy cloud.
        points: The clean cloud [m], shape (n, 3), which is drawn.
        ground: Its ground labels, shape (n,).
        folder: Where the pictures go.
        seed: For the places, where the scene has none of its own.
    """
    folder.mkdir(parents=True, exist_ok=True)
    start, goal = _places(name, points, ground, seed)
    methods = {method: plan(scene, start, goal, "human", method=method) for method in METHOD_COLOURS}
    agents = {agent: plan(scene, start, goal, BODIES[agent]) for agent in AGENT_COLOURS}
    made = [folder / f"{name}_methods.png", folder / f"{name}_bodies.png"]
    shown, heights = _shown(points, ground)
    draw(made[0], shown, heights, methods, METHOD_COLOURS, f"{name}: four methods, human. {_like(FIGURES, name)}")
    draw(made[1], shown, heights, agents, AGENT_COLOURS, f"{name}: four bodies, ours. {_like(AGENT_FIGURES, name)}")
    return made


def draw(
    path: Path,
    points: FloatArray,
    heights: FloatArray,
    results: Mapping[Any, PlanResult],
    colours: Mapping[Any, str],
    title: str,
) -> None:
    """Draw paths over a cloud: in 3D, from above, and along each path; dashed where they are not certified."""
    figure = Figure(figsize=(17, 9), layout="constrained")
    figure.suptitle(title, x=0.02, ha="left")  # the view from above has a title of its own
    grid = figure.add_gridspec(2, 2, height_ratios=(3, 1), width_ratios=(4, 3))
    solid: Any = figure.add_subplot(grid[:, 0], projection="3d")
    above: Any = figure.add_subplot(grid[0, 1])
    beside: Any = figure.add_subplot(grid[1, 1])
    style = {"c": heights, "cmap": "Greys", "vmin": -2.5, "vmax": 2.5, "linewidths": 0}
    far = (points[:, 1] > points[:, 1].min() + WALL) & (points[:, 0] < points[:, 0].max() - WALL)
    solid.scatter(*points[far].T, s=4, alpha=0.4, **{**style, "c": heights[far]})
    above.scatter(*points[:, :2].T, s=2, alpha=0.5, **style)
    for i, (name, result) in enumerate(results.items()):
        line = {"color": colours[name], "label": _label(name, result), "lw": WIDEST - NARROWER * i, "zorder": 10}
        line["ls"] = "-" if result.status is Status.OK else "--"
        tops = np.full((1, 3), np.nan) if result.trajectory is None else result.trajectory.positions
        solid.plot(*tops.T, **line)
        above.plot(*tops[:, :2].T, **line)
        if result.trajectory is not None:
            _stand(solid, result.trajectory, colours[name])
            _profile(beside, result.trajectory, line)
    low, high = points.min(axis=0), points.max(axis=0)
    solid.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]", xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    solid.set_box_aspect(np.maximum(high - low, 2.5), zoom=1.1)
    solid.view_init(elev=38, azim=-65)
    above.set(aspect="equal", title="from above: x to the right, y upwards [m]")
    beside.set(xlabel="along the path [m]: the body's top, and dotted the ground under it", ylabel="z [m]")
    figure.legend(*above.get_legend_handles_labels(), loc="outside lower center", ncols=2, fontsize=9)
    FigureCanvasAgg(figure).print_png(str(path))  # type: ignore[no-untyped-call]


def draw_refused(path: Path, scene: Scene, points: FloatArray, ground: BoolArray, row: Row) -> None:
    """Draw each solvable query that was not answered with OK where it was refused, with what the planner said.

    Blue: what truly is there as high as the body, over what the planner, which had the noisy cloud, took to be there.
    The body, and dashed the extra room that it truly has.
    """
    body, refused = AGENTS[row["agent"]], row["refused"]
    room = body.cylinder.radius + LEAST_ROOM + row["noise_m"]
    half = max(PANEL, 3.0 * room)
    rows = ceil(len(refused) / PANELS)
    columns = ceil(len(refused) / rows)
    figure = Figure(figsize=(max(3.4 * columns, LEGEND), 5.0 * rows), layout="constrained")
    space = scene.free_space(body)
    things = points[~ground]
    for i, query in enumerate(refused):
        axes: Any = figure.add_subplot(rows, columns, i + 1)
        at = np.array(query["at"])
        over = things[:, 2] - at[2]
        shown = things[(over > body.max_step) & (over < body.height) & (np.abs(things[:, :2] - at[:2]) < half).all(1)]
        for obstacles in [own.obstacles for own in space.levels]:
            near = (np.abs(obstacles.points[:, :2] - at[:2]) < half).all(1)
            colours = np.array(list(KIND_COLOURS.values()))[obstacles.kind[near]]
            axes.scatter(*obstacles.points[near, :2].T, s=6, c=colours, linewidths=0)
        axes.scatter(*shown[:, :2].T, s=2, c=TRUE_COLOUR, linewidths=0)
        axes.add_patch(Circle((at[0], at[1]), body.cylinder.radius, color=BODY_COLOUR, alpha=0.3))
        axes.add_patch(Circle((at[0], at[1]), room, fill=False, ls="--"))
        axes.set(aspect="equal", xlim=at[0] + [-half, half], ylim=at[1] + [-half, half])
        axes.set_title(fill(f"{query['status']}: {query['message']}", 48), fontsize=7, parse_math=False)
        axes.tick_params(labelsize=6)
    named = {f"taken for {KIND_NAMES[kind]}": colour for kind, colour in KIND_COLOURS.items()}
    named |= {"truly there": TRUE_COLOUR, "the body": BODY_COLOUR}
    dots = [Line2D([], [], ls="", marker="o", color=colour, label=label) for label, colour in named.items()]
    dots.append(Line2D([], [], ls="--", color="black", label="clearance that it truly has"))
    figure.legend(handles=dots, ncols=4, loc="outside lower center")
    figure.suptitle(f"{row['scene']}, {body.name}: {len(refused)} of {row['solvable']} solvable queries were refused")
    FigureCanvasAgg(figure).print_png(str(path))  # type: ignore[no-untyped-call]


def _profile(axes: Any, trajectory: Trajectory, line: dict[str, Any]) -> None:  # noqa: ANN401
    steps = np.linalg.norm(np.diff(trajectory.positions[:, :2], axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    axes.plot(along, trajectory.positions[:, 2], **line)
    axes.plot(along, trajectory.ground[:, 2], color=line["color"], ls=":", lw=1.2)


def _stand(axes: Any, trajectory: Trajectory, colour: str) -> None:  # noqa: ANN401
    """Upright lines from the ground to the body's top, so that the eye sees the height."""
    for i in np.linspace(0, len(trajectory.positions) - 1, 9).astype(int):
        axes.plot(*np.stack([trajectory.ground[i], trajectory.positions[i]]).T, color=colour, lw=0.7, alpha=0.6)


def _label(name: str, result: PlanResult) -> str:
    said = f"{TITLES.get(name, name)}: {result.status}"
    if result.trajectory is None or result.certificate is None:
        return said
    proof = result.certificate
    return f"{said}, clearance {proof.min_clearance:.2f} m, off height {proof.max_height_deviation:.2f} m"


def _places(name: str, points: FloatArray, ground: BoolArray, seed: int) -> tuple[FloatArray, FloatArray]:
    """The scene's own start and goal; else, of random pairs that the human can walk, the furthest apart."""
    if name in PLACES:
        return np.array(PLACES[name][0]), np.array(PLACES[name][1])
    if name in SCENES:
        made = SCENES[name](np.random.default_rng(0))
        return np.array(made.start), np.array(made.goal)
    brute = BruteForce(points, ground, AGENTS["human"])
    pairs = brute.random_pairs(PAIRS, np.random.default_rng(seed))
    length = [brute.solves(*pair) * np.linalg.norm(pair[1] - pair[0]) for pair in pairs]
    start, goal = pairs[int(np.argmax(length))]
    return start, goal


def _shown(points: FloatArray, ground: BoolArray) -> tuple[FloatArray, FloatArray]:
    """The points to draw and their height over the ground: no ceiling, no flat floor, but steps and slopes."""
    floor = points[ground]
    height = points[:, 2] - floor[cKDTree(floor[:, :2]).query(points[:, :2])[1], 2]
    level = np.median(floor[:, 2])
    keep = np.flatnonzero((height < CEILING) & (~ground | (np.abs(points[:, 2] - level) > 0.05)))
    keep = keep[:: max(1, len(keep) // CLOUD_POINTS)]
    return points[keep], points[keep, 2] - level


def _like(figures: Mapping[str, str], name: str) -> str:
    return f"As the paper's {figures[name]}" if name in figures else ""

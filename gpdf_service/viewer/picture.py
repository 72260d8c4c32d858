"""PNG pictures: the plan view of a scene with field, quadtree and paths, and each path's profile.

Colours are Okabe and Ito's, which the colour-blind can tell apart; every axis is in metres.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PatchCollection
from matplotlib.colors import LinearSegmentedColormap, ListedColormap, to_rgba
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle

from gpdf_service.ground import ObstacleKind
from gpdf_service.scene import Scene
from gpdf_service.tiles.surface import INFERRED
from gpdf_service.types import Agent, BoolArray, FloatArray, IntArray, PlanResult, Status, Trajectory, resolve_agent

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
KIND_COLOURS = {
    ObstacleKind.MATERIAL: "#333333",
    ObstacleKind.STEP: "#D55E00",
    ObstacleKind.SLOPE: "#E69F00",
    ObstacleKind.UNKNOWN: "#CC79A7",
}
KIND_NAMES = {
    ObstacleKind.MATERIAL: "material",
    ObstacleKind.STEP: "step",
    ObstacleKind.SLOPE: "slope",
    ObstacleKind.UNKNOWN: "unobserved",
}
GROUND = LinearSegmentedColormap.from_list("ground", ["#f4efe4", "#cdbb93", "#7d6a45"])
"""Pale, so that what lies on it is seen; darker is higher."""
INFERRED_COLOUR, FITS, FITS_EDGE = "#8fd9d3", "#56B4E9", "#0072B2"
LINE_WIDTH = 2.0
"""[pt]"""
FIELD_PIXELS = 240
"""Samples of the distance field along the longer side of a picture: finer than it is printed."""
LEAF_PIXELS = 1600
"""Pixels of the quadtree along that side: two for one that is printed, so that every leaf's edge is seen."""
PANELS = 6
"""Levels that a sheet shows: those with the most ground. The others are named below it."""
SHEET = 18.0, 10.5
"""[inch] Width and height of a sheet at 100 points an inch: a screen."""
NAMED = 8
"""Of the levels that are not drawn, that are named."""
BESIDE = 2.2, 4.1
"""[inch] Beside a plan view for its axis and colours; below and over it for the profile, titles and legend."""
PROFILE = 2.2
"""[inch] Height of a profile."""
LEAST_WIDTH = 9.0
"""[inch] For the legend."""
PLANS = 2
"""Levels on which a way is drawn in plan: those with most of it."""
OTHER_LEVEL = 0.4
"""[-] How strong a way is drawn where it is on another level than what is drawn below it."""
AROUND = 2.0
"""[m] Of the rooms around a way, at least; three tenths of its extent where that is more."""
CLOUD_POINTS = 60_000
"""Points of the cloud that a picture draws: more cannot be told apart on it."""


def draw_plans(
    scene: Scene,
    results: Mapping[str, PlanResult],
    path: str | os.PathLike[str],
    *,
    agent: str | Agent | None = None,
    start: Sequence[float] = (),
    goal: Sequence[float] = (),
    title: str = "",
) -> None:
    """Draw paths of one or more bodies in plan and from the side.

    Args:
        scene: Where they were planned.
        results: By the name in the legend; those without a trajectory stand in the legend with their status.
        path: The PNG to write.
        agent: Whose obstacles, free space and, of discs, footprint are shown; the one that the first result is named by
            if None.
        start: Marked when given, (x, y, …) [m].
        goal: The same.
        title: Over the picture.
    """
    shown = {name: r.trajectory for name, r in results.items() if r.trajectory is not None}
    body = resolve_agent(next(iter(results)) if agent is None else agent)
    on = {name: _levels_under(scene, path) for name, path in shown.items()}
    levels = _most_of(on.values())
    low, high = _view(scene, levels, [start, goal, *(path.ground for path in shown.values())])
    aspect = float((high - low)[0] / (high - low)[1])
    wide = min((SHEET[1] - BESIDE[1]) * aspect, SHEET[0] / len(levels) - BESIDE[0])
    size = max(len(levels) * (wide + BESIDE[0]), LEAST_WIDTH), wide / aspect + BESIDE[1]
    figure = Figure(figsize=size, layout="compressed")
    grid = figure.add_gridspec(2, len(levels), height_ratios=(wide / aspect, PROFILE))
    side_axes = figure.add_subplot(grid[1, :])
    handles: dict[Any, Any] = {}  # of all plan views
    style: dict[str, Any]
    for column, level in enumerate(levels):
        axes = figure.add_subplot(grid[0, column])
        _draw_field(figure, axes, scene, body, level)
        _draw_obstacles(axes, scene, body, level)
        _draw_ways(axes, results, {name: under == level for name, under in on.items()}, body)
        for place, marker, label in ((start, "o", "start"), (goal, "*", "goal")):
            if len(place):
                style = {"marker": marker, "ms": 13, "mfc": "white", "mec": "black", "ls": "", "zorder": 6}
                axes.plot(place[0], place[1], label=label, **style)
        view = {"xlim": (low[0], high[0]), "ylim": (low[1], high[1])}
        named = title or "plan view"
        if len(scene.surfaces) > 1:
            named += f", {_storey(scene, level)}" if len(levels) == 1 else f"\n{_storey(scene, level)}"
        axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", title=named, **view)
        handles |= {label: handle for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    figure.legend(handles=list(handles.values()), loc="outside upper center", fontsize=9, ncols=4)
    for i, result in enumerate(results.values()):
        if result.trajectory is not None:
            _draw_profile(side_axes, result.trajectory, COLOURS[i % len(COLOURS)])
    aside = "side view along each path: top of the body, and the ground dotted"
    side_axes.set(xlabel="distance along the path in plan [m]", ylabel="z [m]", title=aside)
    _save(figure, path)


def draw_scene(scene: Scene, agent: str | Agent, path: str | os.PathLike[str]) -> None:
    """Draw the levels with the most ground on one sheet, as high as a screen; the others are named.

    Of each the ground by height, what of it is inferred, what stops the agent and why, and where it fits.
    """
    body = resolve_agent(agent)
    by_area = np.argsort([-np.count_nonzero(surface.state) for surface in scene.surfaces], kind="stable").tolist()
    drawn = sorted(by_area[:PANELS])
    columns = min(len(drawn), 2 if len(drawn) < 5 else 3)
    rows = -(-len(drawn) // columns)
    tall = (9.0 if columns == rows == 1 else SHEET[1]) / rows - 1.0
    aspect = max(shape[0] / shape[1] for shape in (scene.surfaces[i].height.shape for i in drawn))
    wide = min(max(columns * (tall * aspect + BESIDE[0]), LEAST_WIDTH), SHEET[0])
    # "constrained" leaves more of a sheet to several, "compressed" keeps one in its middle.
    figure = Figure((wide, rows * (tall + 1.0)), layout="compressed" if len(drawn) == 1 else "constrained")
    kinds: dict[Any, Any] = {}  # of all panels
    for panel, i in enumerate(drawn, 1):
        surface, axes = scene.surfaces[i], figure.add_subplot(rows, columns, panel)
        nx, ny = surface.height.shape
        extent = _extent(surface.origin, surface.cell_width * np.array([nx, ny]))
        image = axes.imshow(surface.height.T, origin="lower", extent=extent, cmap=GROUND, interpolation="nearest")
        figure.colorbar(image, ax=axes, label="height of the ground [m]", shrink=0.7)
        inferred = np.where(surface.state == INFERRED, 1.0, np.nan)
        shade = ListedColormap([INFERRED_COLOUR])
        axes.imshow(inferred.T, origin="lower", extent=extent, cmap=shade, alpha=0.7, interpolation="nearest")
        _draw_quadtree(axes, scene, body, i, (FITS, FITS_EDGE), 0.4)
        _draw_obstacles(axes, scene, body, i)
        axes.set(
            xlabel="x [m]", ylabel="y [m]", aspect="equal", title=f"{_storey(scene, i)} as the {body.name} finds it"
        )
        named = [
            Patch(color=INFERRED_COLOUR, alpha=0.7, label="inferred ground"),
            Patch(color=FITS, alpha=0.4, label=f"the {body.name}'s centre may be here"),
        ]
        kinds |= {patch.get_label(): patch for patch in named}
        kinds |= {label: handle for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    figure.legend(handles=list(kinds.values()), loc="outside lower center", ncols=6, fontsize=9)
    if len(by_area) > PANELS:
        rest = by_area[PANELS : PANELS + NAMED]
        more = f" and {len(by_area) - PANELS - NAMED} more" if len(by_area) > PANELS + NAMED else ""
        figure.suptitle(f"not drawn: {'; '.join(_storey(scene, i) for i in rest)}{more}", fontsize=9)
    _save(figure, path)


def _storey(scene: Scene, level: int) -> str:
    """A level by its number, the height of its ground and how much there is."""
    surface = scene.surfaces[level]
    area = np.count_nonzero(surface.state) * surface.cell_width**2
    return f"level {level}, z {float(np.nanmedian(surface.height)):.1f} m, {area:.0f} m²"


def _view(
    scene: Scene, levels: Sequence[int], places: Sequence[Sequence[float] | FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Least and greatest corner of what is shown of levels: the way with the rooms around it, within the maps [m]."""
    lows = np.array([surface.origin for surface in scene.surfaces])
    highs = lows + [surface.cell_width * np.array(surface.height.shape) for surface in scene.surfaces]
    low, high = lows[levels].min(axis=0), highs[levels].max(axis=0)
    corners = [np.atleast_2d(np.asarray(place, dtype=np.float64))[:, :2] for place in places if len(place)]
    if not corners:
        return low, high
    way = np.clip(np.concatenate(corners), lows.min(axis=0), highs.max(axis=0))  # one may be far off the map
    least, most = way.min(axis=0), way.max(axis=0)
    around = max(AROUND, 0.3 * float((most - least).max()))
    return np.clip(low, least - around, least), np.clip(high, most, most + around)


def _save(figure: Figure, path: str | os.PathLike[str]) -> None:
    FigureCanvasAgg(figure).print_png(os.fspath(path))  # type: ignore[no-untyped-call]


def _extent(origin: FloatArray, size: FloatArray) -> tuple[float, float, float, float]:
    return float(origin[0]), float(origin[0] + size[0]), float(origin[1]), float(origin[1] + size[1])


def _summary(result: PlanResult) -> str:
    if result.trajectory is None or result.certificate is None:
        return result.status.value
    room = result.certificate.min_clearance
    said = "" if result.status is Status.OK else f"{result.status}, "
    return f"{said}{result.trajectory.length:.1f} m, clearance {room:.2f} m"


def _levels_under(scene: Scene, trajectory: Trajectory) -> IntArray:
    """The level that each waypoint of a path is on, shape (n,)."""
    heights = np.stack([surface.height_at(trajectory.ground[:, :2]) for surface in scene.surfaces])
    gap = np.where(np.isnan(heights), np.inf, np.abs(heights - trajectory.ground[:, 2]))
    nearest: IntArray = gap.argmin(axis=0)
    return nearest


def _most_of(on: Iterable[IntArray]) -> list[int]:
    """The levels with most of the waypoints, in the order of their numbers; the lowest where there is none."""
    count = Counter(level for levels in on for level in levels.tolist())
    return sorted(level for level, _ in count.most_common(PLANS)) or [0]


def _draw_field(figure: Figure, axes: Any, scene: Scene, agent: Agent, level: int) -> None:  # noqa: ANN401
    places, extent = _pixels(scene, level, FIELD_PIXELS)
    sample = scene.free_space(agent).levels[level].obstacle_field.query(places.reshape(-1, 2))
    distance = np.where(sample.valid, sample.distance, np.nan).reshape(places.shape[:2])
    image = axes.imshow(distance, origin="lower", extent=extent, cmap="cividis", alpha=0.8)
    figure.colorbar(image, ax=axes, label=f"distance to what stops the {agent.name} [m]", shrink=0.7)
    _draw_quadtree(axes, scene, agent, level, (None, "white"), 0.3)


def _pixels(scene: Scene, level: int, count: int) -> tuple[FloatArray, tuple[float, float, float, float]]:
    """Centres of square pixels over a level (rows, columns, 2) [m], `count` along the longer side, and their extent."""
    surface = scene.surfaces[level]
    size = surface.cell_width * np.array(surface.height.shape)
    step = size.max() / count
    columns, rows = np.ceil(size / step - 1e-9).astype(int)
    x, y = (surface.origin[k] + (np.arange(n) + 0.5) * step for k, n in ((0, columns), (1, rows)))
    return np.stack(np.meshgrid(x, y), axis=-1), _extent(surface.origin, step * np.array([columns, rows]))


def _draw_quadtree(
    axes: Any,  # noqa: ANN401
    scene: Scene,
    agent: Agent,
    level: int,
    colours: tuple[str | None, str],
    alpha: float,
) -> None:
    """The leaves in which the body may be, filled and edged with `colours`; as an image, for a million are as quick."""
    tree = scene.free_space(agent).levels[level].quadtree
    places, extent = _pixels(scene, level, LEAF_PIXELS)
    leaf = tree.find(places.reshape(-1, 2)).reshape(places.shape[:2])
    free = (leaf >= 0) & tree.free[leaf]
    edge = np.zeros_like(free)
    edge[1:] |= leaf[1:] != leaf[:-1]
    edge[:, 1:] |= leaf[:, 1:] != leaf[:, :-1]
    shown = np.zeros((*leaf.shape, 4))
    for mask, colour in ((free, colours[0]), (free & edge, colours[1])):
        if colour is not None:
            shown[mask] = to_rgba(colour, alpha)
    axes.imshow(shown, origin="lower", extent=extent)


def _draw_obstacles(axes: Any, scene: Scene, agent: Agent, level: int) -> None:  # noqa: ANN401
    obstacles = scene.free_space(agent).levels[level].obstacles
    stride = max(1, len(obstacles.points) // CLOUD_POINTS)
    for kind, colour in KIND_COLOURS.items():
        points = obstacles.points[obstacles.kind == kind][::stride]
        if len(points):
            axes.plot(points[:, 0], points[:, 1], ".", ms=0.7, color=colour, zorder=3)
            axes.plot([], [], "o", ms=5, color=colour, label=KIND_NAMES[kind])  # for the legend, large enough to see


def _draw_ways(
    axes: Any,  # noqa: ANN401
    results: Mapping[str, PlanResult],
    here: Mapping[str, BoolArray],
    agent: Agent,
) -> None:
    """Each path, pale where its waypoints are on another level than `here`; those that are none, in the legend."""
    for i, (name, result) in enumerate(results.items()):
        label, colour = f"{name}: {_summary(result)}", COLOURS[i % len(COLOURS)]
        if result.trajectory is None:
            axes.plot([], [], color=colour, label=label)
            continue
        width = LINE_WIDTH + (len(results) - 1 - i)  # where paths lie on each other, the first looks out below
        style = {"color": colour, "lw": width, "zorder": 5}
        x, y = result.trajectory.positions[:, :2].T
        axes.plot(np.where(here[name], x, np.nan), y, label=label, **style)
        axes.plot(np.where(here[name], np.nan, x), y, alpha=OTHER_LEVEL, **style)
        _draw_footprints(axes, result.trajectory, agent, colour)


def _draw_footprints(axes: Any, trajectory: Trajectory, agent: Agent, colour: str) -> None:  # noqa: ANN401
    """The body of discs along its path, turned as it is there: its box, every third of a length that an end goes."""
    if agent.discs == 1:
        return
    moved = np.linalg.norm(np.diff(trajectory.positions, axis=0), axis=1)
    moved = moved + agent.offsets[-1] * np.abs(np.diff(trajectory.headings))
    along = np.concatenate([[0.0], np.cumsum(moved)])
    rows = np.unique(np.searchsorted(along, np.linspace(0.0, along[-1], int(3.0 * along[-1] / agent.length) + 2)))
    boxes = [
        Rectangle(
            (x - 0.5 * agent.length, y - 0.5 * agent.width),
            agent.length,
            agent.width,
            angle=float(np.degrees(heading)),
            rotation_point="center",
        )
        for (x, y), heading in zip(trajectory.positions[rows, :2], trajectory.headings[rows], strict=True)
    ]
    axes.add_collection(PatchCollection(boxes, facecolor=colour, edgecolor=colour, linewidth=0.6, alpha=0.25, zorder=4))


def _draw_profile(axes: Any, trajectory: Trajectory, colour: str) -> None:  # noqa: ANN401
    steps = np.linalg.norm(np.diff(trajectory.ground[:, :2], axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    axes.plot(along, trajectory.positions[:, 2], color=colour)
    axes.plot(along, trajectory.ground[:, 2], color=colour, ls=":")

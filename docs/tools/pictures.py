"""The pictures of this documentation, from our synthetic scenes: `make pictures` writes docs/pictures."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from shutil import copyfile
from tempfile import TemporaryDirectory

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from page import draw_page
from PIL import Image

import gpdf_service as gpdf
from gpdf_service.bench.paper_pictures import draw_scene_pictures
from gpdf_service.cli import main as command_line
from gpdf_service.synthetic import SCENES, SyntheticScene
from gpdf_service.synthetic.world import Box, World
from gpdf_service.viewer.picture import COLOURS, draw_plans, draw_scene

FOLDER = Path(__file__).parent.parent / "pictures"
LARGEST_BYTES = 100_000
"""A picture that is kept in the repository for ever is smaller than this."""
SHOWN = (
    "office_methods.png",
    "stair_methods.png",
    "cave_methods.png",
    "cluttered_office_methods.png",
    "cow_and_lady_methods.png",
    "cluttered_office_bodies.png",
)
"""The paper's figures 4 to 8."""
WIDTH = 1000
"""[px] As wide as the text."""
PALETTE = 256
"""Colours of a picture: these drawings need no more, and are half the size. Chosen so that thin lines keep theirs."""
SLICE = 0.02
"""[m] Between samples of a field that is drawn."""


def main() -> None:
    """Draw them all; fails if one is larger than it may be."""
    FOLDER.mkdir(exist_ok=True)
    made = SCENES["office"](np.random.default_rng(0))
    scene = gpdf.build_scene(made.points, made.ground)
    for name, draw in PICTURES.items():
        path = FOLDER / f"{name}.png"
        draw(made, scene, path)
        _shrink(path)
    draw_page(scene, FOLDER / "page.png")
    _shrink(FOLDER / "page.png")
    for name in SCENES:
        made = SCENES[name](np.random.default_rng(0))
        scene = gpdf.build_scene(made.points, made.ground)
        for path in draw_scene_pictures(name, scene, made.points, made.ground, FOLDER, seed=0):
            _shrink(path) if path.name in SHOWN else path.unlink()
    _refused(FOLDER / "refused.png")


def _free_space(agent: str) -> Callable[[SyntheticScene, gpdf.Scene, Path], None]:
    return lambda made, scene, path: draw_scene(scene, agent, path)


def _ground_field(made: SyntheticScene, scene: gpdf.Scene, path: Path) -> None:
    """A vertical slice through the step: the Ground GPDF, and the height that each body's top keeps."""
    x, z = np.arange(0.05, 5.96, SLICE), np.arange(-0.2, 2.4, SLICE)
    queries = np.stack(np.meshgrid(x, [2.2], z, indexing="ij"), axis=-1).reshape(-1, 3)
    sample = scene.ground_field.query(queries)
    distance = np.where(sample.valid, sample.distance, np.nan).reshape(len(x), len(z))
    figure, axes = _figure(8, 4.0)
    image = axes.imshow(distance.T, origin="lower", extent=(x[0], x[-1], z[0], z[-1]), cmap="gray")
    heights = [agent.height for agent in gpdf.AGENTS.values()]
    axes.contour(x, z, distance.T, levels=heights, colors=COLOURS[: len(heights)])
    for colour, agent in zip(COLOURS, gpdf.AGENTS.values(), strict=False):
        axes.plot([], [], color=colour, label=f"{agent.name}: {agent.height:g} m")
    near = made.points[made.ground & (np.abs(made.points[:, 1] - 2.2) < 0.04)]
    axes.plot(near[:, 0], near[:, 2], ".", color="white", mec="black", mew=0.3, ms=4, label="ground points")
    axes.set(xlabel="x [m]", ylabel="z [m]", title="Ground GPDF at y = 2.2 m, over the floor and the 35 cm step")
    figure.legend(fontsize=8, ncols=5, loc="outside lower center")
    figure.colorbar(image, ax=axes, label="distance [m]", shrink=0.8)
    _save(figure, path)


def _obstacle_fields(made: SyntheticScene, scene: gpdf.Scene, path: Path) -> None:
    """The Obstacle GPDF of a low and of a tall body: tables and the ball stop only one of them."""
    x, y = np.arange(0.05, 5.96, SLICE), np.arange(0.05, 4.96, SLICE)
    queries = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    figure = Figure(figsize=(10, 4.4), layout="constrained")
    for i, name in enumerate(("roomba", "human")):
        axes = figure.add_subplot(1, 2, i + 1)
        sample = scene.obstacle_field(name).query(queries)
        distance = np.where(sample.valid, sample.distance, np.nan).reshape(len(x), len(y))
        extent = (x[0], x[-1], y[0], y[-1])
        image = axes.imshow(distance.T, origin="lower", extent=extent, cmap="cividis", vmin=0, vmax=1.8)
        axes.contour(x, y, distance.T, levels=[gpdf.AGENTS[name].radius], colors="white")
        axes.set(xlabel="x [m]", ylabel="y [m]", title=f"{name}: white is its radius from what stops it")
    figure.colorbar(image, ax=figure.axes, label="distance [m]", shrink=0.8)
    _save(figure, path)


def _certificate(made: SyntheticScene, scene: gpdf.Scene, path: Path) -> None:
    """Exact room beside the body along the path, at the waypoints and between them, over the proven bound."""
    figure, axes = _figure(8, 3.2)
    result = gpdf.plan(scene, made.start, made.goal, "human")
    assert result.trajectory is not None
    assert result.certificate is not None
    xy = result.trajectory.ground[:, :2]
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(xy, axis=0), axis=1))])
    room = scene.free_space("human").levels[0].clearance(xy)[0] - gpdf.AGENTS["human"].radius
    axes.plot(along, room, ".-", color=COLOURS[0], label="clearance at each waypoint, exact")
    bound = result.certificate.min_clearance
    axes.axhline(bound, color=COLOURS[1], label=f"certified for everything between them, too: {bound:.3f} m")
    axes.set(xlabel="along the path [m]", ylabel="clearance [m]", ylim=(0, None), title="What the certificate says")
    axes.legend(fontsize=8)
    _save(figure, path)


def _levels(made: SyntheticScene, scene: gpdf.Scene, path: Path) -> None:
    """Two storeys that lie over each other, seen from the side."""
    world = World((6.0, 4.0, 5.2), (Box((2.5, 0.0, 2.5), (6.0, 4.0, 2.7), walkable=True),))
    points, ground = world.sample(0.06, np.random.default_rng(0), 0.0)
    house = gpdf.build_scene(points, ground)
    figure, axes = _figure(7, 4.4)
    axes.plot(points[:, 0], points[:, 2], ".", ms=1, color="0.8")
    axes.plot([], [], "o", color="0.8", label="cloud")
    for i, surface in enumerate(house.surfaces):
        place = np.stack(np.meshgrid(np.arange(0.1, 6, 0.1), [2.0]), axis=-1).reshape(-1, 2)
        axes.plot(place[:, 0], surface.height_at(place), color=COLOURS[i], lw=3, label=f"ground of level {i}")
    axes.set(xlabel="x [m]", ylabel="z [m]", aspect="equal", title="two storeys: each has its own ground and fields")
    axes.legend(fontsize=8, loc="upper left")
    _save(figure, path)


def _stair(made: SyntheticScene, scene: gpdf.Scene, path: Path) -> None:
    stair = SCENES["stair"](np.random.default_rng(0))
    built = gpdf.build_scene(stair.points, stair.ground)
    results = {name: gpdf.plan(built, stair.start, stair.goal, name) for name in ("human", "roomba")}
    draw_plans(built, results, path, start=stair.start, goal=stair.goal, title="the human goes, the Roomba does not")


def _alternatives(made: SyntheticScene, scene: gpdf.Scene, path: Path) -> None:
    """All ways that differ, of one request."""
    cow = SCENES["cow_and_lady"](np.random.default_rng(0))
    built = gpdf.build_scene(cow.points, cow.ground)
    best = gpdf.plan(built, cow.start, cow.goal, alternatives=3)
    ways = {f"{n}, {way.details['cost']:.1f} s": way for n, way in enumerate([best, *best.alternatives], start=1)}
    draw_plans(built, ways, path, agent="human", start=cow.start, goal=cow.goal, title="alternatives=3, and their cost")


def _noise(made: SyntheticScene, scene: gpdf.Scene, path: Path) -> None:
    """A floor with 3 cm of noise: the GPDF on the cured points beside the nearest points."""
    rng = np.random.default_rng(0)
    x, y = np.meshgrid(np.arange(0, 6, 0.04), np.arange(0, 4, 0.04))
    floor = np.column_stack([x.ravel(), y.ravel(), rng.normal(0.0, 0.03, x.size)])
    field = gpdf.build_scene(floor, np.ones(len(floor), dtype=bool)).ground_field
    height = np.linspace(0.1, 2.0, 20)
    queries = np.stack(np.meshgrid(np.linspace(1.5, 4.5, 20), [2.0], height, indexing="ij"), axis=-1).reshape(-1, 3)
    raw = np.array([np.linalg.norm(floor - query, axis=1).min() for query in queries])
    figure, axes = _figure(7, 3.4)
    for label, found in (("nearest point of the cloud", raw), ("Ground GPDF", field.query(queries).distance)):
        error = (found - queries[:, 2]).reshape(20, 20)
        axes.plot(height, 100 * error.mean(axis=0), ".-", label=label, color=COLOURS[label == "Ground GPDF"])
    axes.axhline(0, color="black", lw=0.5)
    axes.set(xlabel="true height over the floor [m]", ylabel="mean error [cm]", title="a floor with 3 cm of noise")
    axes.legend(fontsize=8)
    _save(figure, path)


def _refused(path: Path) -> None:
    """What a human was refused beside the cow and the lady under noise, as `gpdf bench paper --png` draws it."""
    with TemporaryDirectory() as folder:
        words = ["--scene", "cow_and_lady", "--agent", "human", "--method", "dual_gpdf", "--png", folder]
        if command_line(["bench", "paper", *words, "--json", f"{folder}/rows.json"]) != 0:
            raise SystemExit("a path was judged a collision")
        copyfile(Path(folder) / "cow_and_lady_human_refused.png", path)
    _shrink(path)


def _figure(width: float, height: float) -> tuple[Figure, object]:
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.add_subplot()


def _save(figure: Figure, path: Path) -> None:
    FigureCanvasAgg(figure).print_png(str(path))


def _shrink(path: Path) -> None:
    """As wide as the page, with a palette; refuses what is still too large."""
    image = Image.open(path).convert("RGB")
    if image.width > WIDTH:
        image = image.resize((WIDTH, round(image.height * WIDTH / image.width)), Image.Resampling.LANCZOS)
    image.quantize(PALETTE, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(path, optimize=True)
    if path.stat().st_size > LARGEST_BYTES:
        raise SystemExit(f"{path} has {path.stat().st_size} bytes, more than {LARGEST_BYTES}: draw less in it")
    print(f"{path.name}: {path.stat().st_size / 1000:.0f} kB")


PICTURES: dict[str, Callable[[SyntheticScene, gpdf.Scene, Path], None]] = {
    "ground_field": _ground_field,
    "obstacle_fields": _obstacle_fields,
    "free_space_human": _free_space("human"),
    "certificate": _certificate,
    "levels": _levels,
    "stair": _stair,
    "alternatives": _alternatives,
    "noise": _noise,
}

if __name__ == "__main__":
    main()

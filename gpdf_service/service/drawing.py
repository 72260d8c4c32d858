"""What a picture of a scene shows, as tables in parts: cloud, ground, and the obstacles and leaves of a body."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from gpdf_service.errors import RequestError
from gpdf_service.scene import Scene, level_under
from gpdf_service.search.resplit import Leaves, centers
from gpdf_service.types import Agent, BoolArray, FloatArray, IntArray

PART_BYTES = 1_000_000
"""One part: small requests stay quick beside it."""
MAX_ROWS = 2_000_000
"""More than a browser bears, and 40 parts."""
OF_BODIES = "obstacles", "leaves"
"""What is another for each body."""
MOVED = 3.0
"""[-] Deviations of the noise: how far denoising moves a point."""
LARGEST_FIRST = ("leaves",)
"""What is not thinned evenly."""


@dataclass(frozen=True, slots=True)
class Part:
    """One part of a drawing: `parts` in all, the columns' names, and the rows with places relative to `origin` [m]."""

    parts: int
    origin: FloatArray
    columns: tuple[str, ...]
    rows: FloatArray


def draw_part(
    scene: Scene,
    what: str,
    agent: str | Agent,
    limit: int,
    part: int,
    near: FloatArray | None = None,
    reach: float = 0.0,
) -> Part:
    """Make one part; the same arguments give the same rows, so that the parts of one version fit together.

    Args:
        scene: What is drawn.
        what: Which of its tables.
        agent: The body that obstacles and leaves are of.
        limit: Most rows of all parts together.
        part: Which part.
        near: Places [m], shape (k, 2) or (k, 3): only what is near one of them in plan is drawn; None: everything.
        reach: How near [m].

    Raises:
        RequestError: there is no such thing to draw, or no such part.
    """
    if what not in _TABLES:
        raise RequestError("what", f"{what!r}", f"Use one of {', '.join(_TABLES)}.")
    if not 0 < limit <= MAX_ROWS:
        raise RequestError("limit", f"{limit}", f"Ask for 1 to {MAX_ROWS} rows.")
    columns, places, rows_of = _TABLES[what](scene, agent)
    chosen = np.arange(len(places)) if near is None else np.flatnonzero(_is_near(places, near, reach))
    if what not in LARGEST_FIRST:
        chosen = chosen[_shuffled(len(chosen))]
    chosen = chosen[:limit]
    size = PART_BYTES // (4 * len(columns))
    parts = max(1, -(-len(chosen) // size))
    if not 0 <= part < parts:
        raise RequestError("part", f"{part}", f"There are {parts}; they count from 0.")
    origin = scene.points.min(axis=0)
    rows = rows_of(chosen[part * size : (part + 1) * size])
    rows[:, :3] -= origin
    return Part(parts, origin, columns, rows)


_Table = tuple[tuple[str, ...], FloatArray, Callable[[IntArray], FloatArray]]
"""Columns; places [m], shape (n, 3); and the rows of some of them."""


def _is_near(places: FloatArray, near: FloatArray, reach: float) -> BoolArray:
    """Which places are within a reach of one of others, in plan, shape (n,)."""
    if near.ndim != 2 or near.shape[1] not in (2, 3) or not len(near):
        raise RequestError("near", f"an array of shape {near.shape}", "Send (k, 2) or (k, 3), one place at least.")
    if reach <= 0.0:
        raise RequestError("reach", f"{reach:g} m", "Say how near, in metres.")
    is_near = np.zeros(len(places), dtype=np.bool_)
    low, high = near[:, :2].min(axis=0) - reach, near[:, :2].max(axis=0) + reach
    boxed = np.flatnonzero(np.all((places[:, :2] >= low) & (places[:, :2] <= high), axis=1))
    away, _ = cKDTree(near[:, :2]).query(places[boxed, :2], distance_upper_bound=reach)
    is_near[boxed] = np.isfinite(away)
    return is_near


def _shuffled(count: int) -> IntArray:
    """The same order each time; its first part shows all that is drawn, thinner."""
    return np.random.default_rng(0).permutation(count)


def _cloud(scene: Scene, agent: str | Agent) -> _Table:
    def rows(chosen: IntArray) -> FloatArray:
        points = scene.points[chosen]
        level = level_under(scene.surfaces, points)
        beneath = np.full(len(points), min(float(np.nanmin(surface.height)) for surface in scene.surfaces))
        for i, surface in enumerate(scene.surfaces):
            beneath[level == i] = surface.height_at(points[level == i, :2])
        return np.column_stack([points, level, scene.ground[chosen], points[:, 2] - beneath, *_colour(scene, points)])

    return _columns(scene, "x", "y", "z", "level", "ground", "above"), scene.points, rows


def _columns(scene: Scene, *names: str) -> tuple[str, ...]:
    return names if scene.shades is None else (*names, "colour")


def _colour(scene: Scene, points: FloatArray, reach: float = 0.0) -> list[IntArray]:
    """The column of the scan's colours, where it had some: of points that stand for what is up to `reach` [m] away."""
    return [] if scene.shades is None else [scene.shades.at(points, reach + MOVED * scene.noise)]


def _ground(scene: Scene, agent: str | Agent) -> _Table:
    levels = scene.levels.levels
    table = np.concatenate(
        [_with_level(level.ground_points, i, level.inferred.astype(np.float64)) for i, level in enumerate(levels)]
    )

    def rows(chosen: IntArray) -> FloatArray:
        return np.column_stack([table[chosen], *_colour(scene, table[chosen, :3], levels[0].surface.cell_width)])

    return _columns(scene, "x", "y", "z", "level", "inferred"), table[:, :3], rows


def _obstacles(scene: Scene, agent: str | Agent) -> _Table:
    found = [own.obstacles for own in scene.free_space(agent).levels]
    table = np.concatenate(
        [_with_level(level.points, i, level.kind.astype(np.float64)) for i, level in enumerate(found)]
    )
    return ("x", "y", "z", "level", "kind"), table[:, :3], lambda chosen: table[chosen]


def _leaves(scene: Scene, agent: str | Agent) -> _Table:
    parts = []
    for i, own in enumerate(scene.free_space(agent).levels):
        tree, surface = own.quadtree, own.surface
        free = tree.numbers[tree.free[tree.numbers]]
        xy = centers(tree, free)
        height = surface.height_at(xy)
        leaf = _with_level(np.column_stack([xy, height]), i, *_size_and_room(tree, free))
        parts.append(leaf[np.isfinite(height)])
    table = np.concatenate(parts)
    table = table[np.argsort(-table[:, 4], kind="stable")]
    return ("x", "y", "z", "level", "half_size", "clearance"), table[:, :3], lambda chosen: table[chosen]


def _size_and_room(tree: Leaves, leaves: IntArray) -> tuple[FloatArray, FloatArray]:
    """Half the width of some leaves, and their clearance [m]."""
    half = np.asarray(0.5 * tree.width * tree.size[leaves], dtype=np.float64)
    return half, tree.clearance[leaves]


def _with_level(points: FloatArray, level: int, *more: FloatArray) -> FloatArray:
    return np.column_stack([points, np.full(len(points), float(level)), *more])


_TABLES: dict[str, Callable[[Scene, str | Agent], _Table]] = {
    "cloud": _cloud,
    "ground": _ground,
    "obstacles": _obstacles,
    "leaves": _leaves,
}

"""The free space of a scene that changed, from the one before: only what the change touches is built again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numba import njit

from gpdf_service.fields import Gpdf, Tree, build_tree, change_tree, thin
from gpdf_service.fields.threads import run_beside, run_parallel
from gpdf_service.ground import GroundLevel, Levels, Obstacles, Scan, Touched, obstacles_of
from gpdf_service.ground.obstacles import obstacles_felt, obstacles_reach
from gpdf_service.search.free_space import (
    FreeSpace,
    LevelSpace,
    Setup,
    build_level,
    fit_obstacle_field,
    join_levels,
    level_space,
    reach_of,
)
from gpdf_service.search.graph import Edges, SameLeaves, change_edges, same_leaves
from gpdf_service.search.places import Places
from gpdf_service.search.quadtree import Quadtree, build_quadtree
from gpdf_service.tiles.boxes import span, widened, window
from gpdf_service.tiles.rows import hashed, more_now, rows_by_cell, rows_in_cells, rows_spliced, taken
from gpdf_service.tiles.surface import cropped, first_cell, spread, turned
from gpdf_service.tiles.told import moved
from gpdf_service.types import Agent, BoolArray, FloatArray, IntArray


def change_free_space(
    old: FreeSpace,
    levels: Levels,
    ground_fields: tuple[Gpdf, ...],
    touched: Touched,
    first: Sequence[IntArray],
    setup: Setup,
) -> FreeSpace:
    """The free space that `build_free_space` makes, from the `old` one, which was built by the same `setup`.

    It is `touched` where anything in a level is another than in the one before that it was made from. Where the other
    points of each cell of a level begin says `first`, shape (cells + 1,).
    """

    def one(i: int) -> tuple[LevelSpace, IntArray | None]:
        level, ground_field, (k, cells) = levels.levels[i], ground_fields[i], touched[i]
        if k < 0:
            return build_level(level, ground_field, old.agent, old.radius, setup), None
        was = replace(old.levels[k], ground_field=ground_field)
        return (was, None) if cells is None else _change_level(was, level, cells, first[i], old, setup)

    made, sources = zip(*run_parallel(one, range(len(touched))), strict=True)
    reach = reach_of(old.agent, setup.config, setup.scan.noise)
    return join_levels(old.agent, *reach, made, levels, (old, [k for k, _ in touched], sources))


def _change_level(
    was: LevelSpace, level: GroundLevel, touched: BoolArray, first: IntArray, old: FreeSpace, setup: Setup
) -> tuple[LevelSpace, IntArray | None]:
    """The level now, and the leaf then of each leaf now, see `Former`."""
    surface, agent, radius, leaves = level.surface, old.agent, old.radius, was.quadtree.standing
    obstacles, tree, places = _change_obstacles(was, level, touched, first, agent, setup.scan)
    turning = turned(was.surface, surface)
    if len(places) == 0 and not turning.state.any():
        former = was.obstacle_field.standing.over(surface)
        return level_space(level, was.ground_field, obstacles, tree, former, leaves, was.edges), None

    def leaves_and_edges() -> tuple[Quadtree, SameLeaves, Edges]:
        around = build_tree(places) if len(places) else None
        quadtree = build_quadtree(surface, tree, radius, (leaves, around, turning))
        same = same_leaves(leaves, quadtree)
        return quadtree, same, change_edges(was.edges, same, quadtree, Places(tree), radius, around)

    def field() -> Gpdf:
        made = _change_field(was, obstacles, tree, places, setup.config.field_spacing * agent.disc_radius)
        return fit_obstacle_field(obstacles, surface, agent, setup) if made is None else made

    (quadtree, (_, source), edges), made = run_beside(leaves_and_edges, field)
    return level_space(level, was.ground_field, obstacles, tree, made.over(surface), quadtree, edges), source


def _change_obstacles(
    was: LevelSpace, level: GroundLevel, touched: BoolArray, first: IntArray, agent: Agent, scan: Scan
) -> tuple[Obstacles, Tree, FloatArray]:
    """What stops the body on a level, told anew where that may be another, and the tree of its places.

    Also the places where an obstacle came or went, shape (k, 2) [m].
    """
    reach, shut = obstacles_reach(level.surface, agent)
    before, after = spread(was.surface, level.surface)
    by, shape = first_cell(level.surface, after.origin), after.state.shape
    wide = obstacles_felt(moved(touched, by, shape, fill=True), before, after, agent)
    region = moved(wide, first_cell(after, level.surface.origin), touched.shape, fill=True)
    stood, trunk = was.standing, was.places.standing
    found = obstacles_of(_part(level, first, region, reach, shut), agent, scan, level.limits_in(region))
    cells = after.origin, after.cell_width, wide
    inside, gone = rows_in_cells(found.points, *cells), rows_in_tree(trunk, *cells)
    rows = (stood, trunk.order[gone]), (found, inside)
    key = [hashed(each.points.view(np.uint64), each.kind, own) for each, own in rows]
    other = more_now(np.concatenate(key), len(gone)) != 0
    gone, inside = gone[other[: len(gone)]], inside[other[len(gone) :]]
    if len(gone) == len(inside) == 0:
        return stood, trunk, np.zeros((0, 2))
    lost, fresh = np.sort(trunk.order[gone]), found.points[inside]
    points = rows_spliced(stood.points, lost, fresh)
    kind = rows_spliced(stood.kind, lost, found.kind[inside])
    tree = _change_tree(trunk, gone, lost, fresh[:, :2])
    return Obstacles(points, kind), tree, np.concatenate([trunk.points[gone], fresh[:, :2]])


@njit(cache=True, nogil=True)
def rows_in_tree(tree: Tree, origin: FloatArray, cell_width: float, wanted: BoolArray) -> IntArray:
    """`rows_in_cells` of the points of a tree, in no order: boxes without a wanted cell are passed over."""
    nodes, stack, found = tree.boxes.shape[0], [0], [0 for _ in range(0)]
    left, right, near, far = span(wanted)
    low_x, high_x = origin[0] + (left - 1) * cell_width, origin[0] + (right + 1) * cell_width  # rounding: a cell more
    low_y, high_y = origin[1] + (near - 1) * cell_width, origin[1] + (far + 1) * cell_width
    while len(stack) > 0:
        node = stack.pop()
        if node < nodes:
            box = tree.boxes[node]
            for k in range(box.shape[1]):
                if box[0, k] <= high_x and box[3, k] >= low_x and box[1, k] <= high_y and box[4, k] >= low_y:
                    stack.append(box.shape[1] * node + 1 + k)
            continue
        for row in range(tree.begin[node - nodes], tree.begin[node - nodes + 1]):
            i = int(np.floor((tree.points[row, 0] - origin[0]) / cell_width))
            j = int(np.floor((tree.points[row, 1] - origin[1]) / cell_width))
            if 0 <= i < wanted.shape[0] and 0 <= j < wanted.shape[1] and wanted[i, j]:
                found.append(row)
    return np.array(found, np.int64)


def _change_tree(tree: Tree, gone: IntArray, lost: IntArray, fresh: FloatArray) -> Tree:
    """The tree without rows that are `gone`, `lost` ones of what it was built of, and with `fresh` points behind."""
    if len(gone) == len(tree.points):
        return build_tree(fresh)
    stay = np.ones(len(tree.points), dtype=bool)
    stay[gone] = False
    made, source = change_tree(tree, stay, np.ascontiguousarray(fresh))
    return made._replace(order=_order_now(tree.order, source, lost))


@njit(cache=True, nogil=True)
def _order_now(order: IntArray, source: IntArray, lost: IntArray) -> IntArray:
    """Which row of what it is built of each row of a tree is, from those before, by its `source`: see `change_tree`."""
    before, made = np.zeros(len(order), np.int32), np.empty(len(source), np.int64)
    before[lost] = 1
    for row in range(1, len(order)):
        before[row] += before[row - 1]
    for k in range(len(source)):
        row = source[k]
        made[k] = order[row] - before[order[row]] if row >= 0 else len(order) - len(lost) - 1 - row
    return made


def _part(level: GroundLevel, first: IntArray, region: BoolArray, reach: int, shut: int) -> GroundLevel:
    """What decides on the material that stops in `region`: ground within `reach` cells, points within `shut`."""
    surface, box, other = level.surface, window(region, reach), rows_by_cell(widened(region, shut), first)
    return replace(
        level,
        surface=cropped(surface, box),
        other_points=taken(level.other_points, other),
        ledge=level.ledge[other],
    )


def _change_field(was: LevelSpace, obstacles: Obstacles, tree: Tree, places: FloatArray, spacing: float) -> Gpdf | None:
    """The Obstacle GPDF with the points thinned again where places came or went; None where it must be fitted anew.

    The fit thins its points by cells of 0.95 spacings: only the cells with a change in them can have another point.
    """
    former = was.obstacle_field.standing
    if len(places) == 0:
        return former
    width, points = 0.95 * spacing, former.points
    cells = np.floor(places / width).astype(np.int64)
    first = cells.min(axis=0) - 2
    wanted = np.zeros(cells.max(axis=0) - first + 3, dtype=bool)
    wanted[tuple((cells - first).T)] = True
    grid = first * width, width, widened(wanted, 1)  # a cell more on each side: corners are rounded

    def held(at: FloatArray) -> BoolArray:
        inside: BoolArray = wanted[tuple((np.floor(at / width).astype(np.int64) - first).T)]
        return inside

    near, lost = obstacles.points[np.sort(tree.order[rows_in_tree(tree, *grid)]), :2], rows_in_cells(points, *grid)
    near, lost = near[held(near)], lost[held(points[lost])]
    fresh = near[thin(near, width)] if len(near) else near
    if max(len(lost), len(fresh)) > 0.5 * len(points):
        return None
    gone = np.zeros(len(points), dtype=bool)
    gone[lost[~_among(points[lost], fresh)]] = True
    return former.replace(gone, fresh[~_among(fresh, points[lost])])


def _among(rows: FloatArray, others: FloatArray) -> BoolArray:
    """Which of the rows (n, 2) are among the others (m, 2)."""
    a, b = (np.ascontiguousarray(each).view([("", np.float64)] * 2).ravel() for each in (rows, others))
    return np.isin(a, b)

"""Ledges: ground beside a thing and no lower than it, by which a step's face is told from what stands there."""

from __future__ import annotations

import numpy as np
from numba import njit

from gpdf_service.denoise.cells import Cells, begin_sweep, runs_within, sort_into_cells
from gpdf_service.fields.shapes import FEWEST
from gpdf_service.fields.threads import run_chunked
from gpdf_service.ground.foot import FACE, LEAST_OBSTACLE, RESOLVED_STEP, astray
from gpdf_service.ground.footing import by_treads, footholds, footing_reach
from gpdf_service.tiles.boxes import WHOLE, Box, highest_around, lowest_around, widened
from gpdf_service.tiles.columns import ends_of_runs, lowest_above
from gpdf_service.tiles.rows import between, chosen_rows
from gpdf_service.tiles.surface import UNKNOWN, HeightMap, cells_within, cropped
from gpdf_service.types import BoolArray, Float32Array, FloatArray, IntArray

NOSING = 0.03
"""[m] By which a tread stands over the face below it: building codes say 0.016 to 0.032."""
HIGH = 2
"""Cells around one whose ground says how high a step there can be."""
RIM_SHARE, RIM_NOISE = 0.25, 0.05
"""[-] Of the points of a face under its edge that may be over it: noise makes 0.05, a lip of 1.5 deviations more."""


def find_ledges(
    surface: HeightMap, ground: FloatArray, other: FloatArray, max_step: float, noise: float = 0.0, box: Box = WHOLE
) -> Float32Array:
    """`next_above` by the `ground` points of this sheet, for those `other` points that can be a step's face.

    No cure takes the `noise` [m] along a face out of it: its upper rim stands over the ground behind it by as much.
    Where a flight is, as `max_step` [m] tells, what is narrower than a foot is no ledge: the end of a stringer.
    The `box` of cells holds all `other` points, and what is within `ground_reach` and `ledge_reach` cells of them.
    """
    part, off = cropped(surface, box), max(surface.cell_width, RESOLVED_STEP * noise)
    aside, known = min(FACE, NOSING + off), part.state != UNKNOWN
    high = highest_around(np.where(known, part.height, -np.inf), HIGH) + off
    rests = footholds(part, max_step) + max(LEAST_OBSTACLE, noise)
    cell = cells_within(other, surface, box)
    asked = between(cell, other[:, 2], np.full_like(high, -np.inf), high)
    cell, low = cell[asked], chosen_rows(other, asked)
    beside = np.zeros(part.state.shape, dtype=bool)
    beside.ravel()[cell] = True
    near = widened(beside, int(np.ceil(1.5 * FACE / surface.cell_width)))
    at, most = cells_within(ground, surface, box), np.where(near, np.minimum(high, rests), -np.inf)
    ground = chosen_rows(ground, between(at, ground[:, 2], np.full_like(high, -np.inf), most))
    ledge = np.full(len(other), np.inf, np.float32)
    if len(ground) and len(low):
        least = np.maximum(low[:, 2] - LEAST_OBSTACLE, step_over(part, noise).ravel()[cell])
        ledge[asked] = next_above(ground, low, least, aside)
    if noise > 0.0 and len(ground):
        _add_rims(ledge, asked, ground, other, noise, aside)
    return ledge


def _add_rims(
    ledge: Float32Array, asked: BoolArray, ground: FloatArray, other: FloatArray, noise: float, reach: float
) -> None:
    """Give points over a step's edge its `ledge`: within a deviation, or so few by its face that noise made them."""
    rows = np.flatnonzero(asked & np.isinf(ledge))
    upside_down = np.array([1.0, 1.0, -1.0])
    edges = -next_above(ground * upside_down, other[rows] * upside_down, -other[rows, 2], reach)
    over = other[rows, 2] - edges
    ledge[rows[over <= noise]] = edges[over <= noise]
    rim = (over > noise) & (over <= RESOLVED_STEP * noise)
    rows, edges = rows[rim], edges[rim]
    if len(rows) == 0:
        return
    edge = np.full(len(other), np.nan)
    edge[rows] = edges
    face, over = _count_beside(other[asked], edge[asked], noise, reach + noise)
    is_rim = (face > 0) & (over - 1 <= _rim_points(face))  # a point is no witness for itself
    ledge[np.flatnonzero(asked)[is_rim]] = edge[asked][is_rim]


def _count_beside(points: FloatArray, edge: FloatArray, noise: float, radius: float) -> tuple[IntArray, IntArray]:
    """How many of the points, (n, 3), beside each are up to two deviations under its edge, or more than one over it."""
    counts = np.zeros((2, len(points)), np.int64)
    cells = sort_into_cells(points * [1.0, 1.0, 0.0], radius)
    above = np.stack((points[:, 2], edge)) / noise
    run_chunked(lambda a, b: _count_range(cells, above, radius, counts, a, b), len(cells.key))
    return counts[0], counts[1]


@njit(cache=True, nogil=True)
def _count_range(cells: Cells, above: FloatArray, radius: float, counts: IntArray, begin: int, end: int) -> None:
    """As `_count_beside`; how high `above` zero points and edges, NaN of those not asked, are in deviations, (2, n)."""
    (z, edge), runs, at = above, np.empty((9, 2), np.int64), begin_sweep(cells, cells.key[begin])
    for c in range(begin, end):
        around = runs[: runs_within(cells, cells.key[c], 1, at, runs)]
        for i in range(cells.begin[c], cells.begin[c + 1]):
            row = cells.order[i]
            if np.isnan(edge[row]):
                continue
            for run in around:
                for k in range(run[0], run[1]):
                    x, y = cells.places[k, 0] - cells.places[i, 0], cells.places[k, 1] - cells.places[i, 1]
                    near, over = x**2 + y**2 <= radius**2, z[cells.order[k]] - edge[row]
                    counts[0, row] += near and -2.0 < over <= 0.0
                    counts[1, row] += near and over > 1.0


def _rim_points(face: IntArray) -> FloatArray:
    """How many points over an edge may be the rim of a `face` of so many: a quarter, or what chance makes, if told.

    A platform's rim has hundreds of such places. A thinly seen face does not tell a lip from noise.
    """
    by_chance = np.where(face < FEWEST, -np.inf, RIM_NOISE * face)
    most: FloatArray = np.maximum(RIM_SHARE * face, by_chance + 3.0 * np.sqrt(RIM_NOISE * face) + 1.0)
    return most


def others_reach(surface: HeightMap, noise: float) -> int:
    """Cells within which other points decide on a ledge: they tell what the noise made."""
    return int(np.ceil((FACE + noise) / surface.cell_width)) + 1 if noise > 0.0 else 0


def ground_reach(surface: HeightMap, noise: float) -> int:
    """Cells within which the ground's points decide on a ledge."""
    return int(np.ceil((2.0 * FACE + noise) / surface.cell_width)) + 1


def ledge_reach(surface: HeightMap, noise: float) -> int:
    """Cells within which the ground decides what is a ledge."""
    return max(_high(surface, noise), footing_reach(surface))


def _high(surface: HeightMap, noise: float) -> int:
    """Cells within which the ground says how high a step is, and from where on it is one."""
    return max(HIGH, astray(surface, noise))


def ledges_felt(touched: BoolArray, was: HeightMap, surface: HeightMap, noise: float) -> BoolArray:
    """Cells in which the ground may decide otherwise on ledges than before, where it is other in the `touched` ones."""
    felt = by_treads(touched, ledge_reach(surface, noise), (was, surface), 2)
    return widened(touched, _high(surface, noise)) | felt


def step_over(surface: HeightMap, noise: float) -> FloatArray:
    """How high ground is that is a step over the lowest around each cell [m], shape (nx, ny); a lower one is none."""
    low = np.where(surface.state != UNKNOWN, surface.height, np.inf).astype(np.float64)  # or the sum is rounded
    rings = astray(surface, noise)
    found: FloatArray = lowest_around(low, rings) + max(LEAST_OBSTACLE, noise)
    return found


def next_above(ground: FloatArray, points: FloatArray, least: FloatArray, reach: float = FACE) -> Float32Array:
    """Height of the lowest `ground` point (n, 3) over `least` (m,) and within `reach` [m] in plan of `points` (m, 3).

    Of each cell half as wide only the highest and the lowest ground point are looked at, and single precision rounds
    up: so a step can be taken for a higher one, never for a lower one, and inf stands where nothing was found. Shape
    (m,) [m].
    """
    width = 0.5 * reach
    at, asked = (np.floor(part[:, :2] / width).astype(np.int64) for part in (ground, points))
    corner = at.min(axis=0) - 3
    at, asked = at - corner, asked - corner
    stride = int(at[:, 1].max()) + 4
    key = at[:, 0] * stride + at[:, 1]
    order = np.argsort(key)
    rows = ends_of_runs(key, order, ground[:, 2])
    here = asked[:, 0] * stride + np.clip(asked[:, 1], 0, stride - 1)

    best = np.full(len(points), np.inf)
    held = key[rows], np.ascontiguousarray(ground[rows])

    def look(a: int, b: int) -> None:
        best[a:b] = lowest_above(held, points[a:b], here[a:b], stride, reach, least[a:b])

    run_chunked(look, len(points))
    kept = best.astype(np.float32)
    return np.where(kept < best, np.nextafter(kept, np.float32(np.inf)), kept)

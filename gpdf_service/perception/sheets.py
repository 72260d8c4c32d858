"""Ground that overlaps in plan, split into sheets that are single-valued in (x, y)."""

from __future__ import annotations

from functools import partial

import numpy as np

from gpdf_service.config import PerceptionConfig
from gpdf_service.ground.level import OVERLAP
from gpdf_service.perception.segment import over_ground
from gpdf_service.tiles.beside import Answer, Beside, Strips
from gpdf_service.tiles.columns import by_cell
from gpdf_service.tiles.layers import APART, HALF, Layers, Pairs, connect, flat
from gpdf_service.tiles.nodes import (
    attach,
    components,
    degrees,
    ends_at,
    grown_sheet,
    joined_to,
    mark_nearest,
    whole_around,
)
from gpdf_service.tiles.pairs import steps_over_gaps
from gpdf_service.tiles.pieces import Pieces, find_pieces
from gpdf_service.types import BoolArray, IntArray


def split_sheets(near: Beside, config: PerceptionConfig) -> tuple[BoolArray, ...]:
    """Which nodes are of each sheet: no sheet has two nodes in one cell; sheets overlap by `OVERLAP` where they meet.

    The lowest comes first, by the median of its heights.
    """
    layers = near.layers
    count = len(layers.cell)
    (kept,) = near.around("sheets", 1, partial(_kept, headroom=config.step_headroom))
    keep = np.concatenate(kept)
    if (np.diff(layers.cell[keep]) > 0).all():
        return (keep,)
    smooth = find_pieces(near, "smooth", kept, layers.cell_width)
    piece, size = smooth.whole, smooth.counts("smooth", kept)[0]
    start, members = by_cell(piece, len(size) + 1)
    steps = _steps(near, kept, piece, config)
    sheet_of = np.full(count, -1)
    least = max(9, int(0.001 * count))  # a patch smaller than three cells square holds no foot
    sheets = 0
    for seed in np.argsort(-size, kind="stable"):
        own = members[start[seed] : start[seed + 1]]
        left = own[sheet_of[own] < 0]
        while len(left) >= (least if len(left) < len(own) else 1):
            sheet_of[_lowest_of(layers, left, least)] = sheets
            attach(layers.cell, layers.shape, steps, (piece, start, members), sheets, sheet_of)
            sheets += 1
            left = own[sheet_of[own] < 0]
    rings = int(np.ceil(OVERLAP / layers.cell_width))

    def grow(name: str, sheet: BoolArray) -> BoolArray:
        beside = near.around(f"beside {name}", 1, rims, kept, near.given(name, sheet))[0]
        return grown_sheet(layers.columns, keep, sheet, np.flatnonzero(flat(beside)), config.max_step, rings)

    def rims(layers: Layers, _: BoolArray, keep: BoolArray, sheet: BoolArray) -> Answer:
        return (joined_to(layers.columns, keep & ~sheet, sheet, 0.0, config.max_step),)

    large = [i for i in range(sheets) if np.count_nonzero(sheet_of == i) >= least]
    grown = [grow(f"sheet {i}", sheet_of == k) for i, k in enumerate(large)]
    seams = [grow(f"seam {i}", nodes) for i, nodes in enumerate(_seams(near, kept, grown, config, rings))]
    grown = [*grown, *(inside for inside in seams if np.count_nonzero(inside) >= least)]
    return tuple(sorted(grown, key=lambda inside: float(np.median(layers.height[inside]))))


def _steps(near: Beside, kept: Strips, piece: IntArray, config: PerceptionConfig) -> Pairs:
    """Steps between kept nodes of another `piece` each, over gaps, too, in which less than a foot fits."""
    width = near.layers.cell_width
    far = (config.tread_depth / (APART * width)).astype(int)

    def steps(layers: Layers, keep: BoolArray) -> Pairs:
        limits = [(width * apart, config.max_step) for apart in APART]
        found = [steps_over_gaps(layers.columns, keep, limits[k], HALF[k], far[k]) for k in range(len(HALF))]
        one, other = (np.concatenate(ends) for ends in zip(*found, strict=True))
        return one, other

    a, b = near.joins("steps of sheets", int(far.max()) + 1, steps, kept)
    other = piece[a] != piece[b]
    return a[other], b[other]


def _seams(
    near: Beside, kept: Strips, sheets: list[BoolArray], config: PerceptionConfig, rings: int
) -> list[BoolArray]:
    """Nodes of further sheets, so that a body finds all ground around each place in one of them.

    A sheet that lies over its own end has no room to reach into the next: the upper floor's, which goes down a stair
    of open treads and ends at its foot under that floor.
    """
    layers = near.layers

    def pieces(name: str, nodes: Strips) -> tuple[Pieces, BoolArray]:
        """Pieces of nodes that steps join, and which of them a foot fits on: a rim of single cells is no ground."""
        found = find_pieces(near, name, nodes, 0.0, config.max_step)
        return found, found.extents(name, nodes)[1] >= config.tread_depth

    def ends(layers: Layers, _: BoolArray, sheet: BoolArray, beyond: BoolArray) -> Answer:
        return (ends_at(layers.columns, sheet, beyond, config.max_step),)

    left = np.concatenate(kept)
    for i, sheet in enumerate(sheets):
        own = near.given(f"whole sheet {i}", sheet)
        beyond = near.each(f"beyond sheet {i}", lambda keep, own: keep & ~own, kept, own)
        found, deep = pieces(f"beyond sheet {i}", beyond)
        end = near.around(f"ends of sheet {i}", 1, ends, own, found.chosen(f"deep beyond sheet {i}", deep))[0]
        left &= ~whole_around(layers.columns, sheet, np.concatenate(end), config.max_step, rings // 2)
    found, deep = pieces("left of sheets", near.given("left of sheets", left))
    return [_first_of_each_cell(layers, found.whole == label) for label in np.flatnonzero(deep)]


def _kept(layers: Layers, _: BoolArray, headroom: float) -> Answer:
    """Nodes that are of sheets: not at the foot of a step in its cell, and not over others with little headroom [m]."""
    keep = ~_under_step(layers, headroom)
    return (keep & ~over_ground(layers, keep, headroom),)  # what goes on nowhere


def _under_step(layers: Layers, headroom: float) -> BoolArray:
    """Nodes at the foot of a step whose top is in the same cell, and goes on beside it: such a cell is the step's top.

    So is that of an open tread with less than the `headroom` [m] under it. A single point over the floor goes on
    nowhere.
    """
    joined = degrees(layers.columns, np.ones(len(layers.cell), dtype=bool), layers.cell_width)
    foot = np.zeros(len(layers.cell), dtype=bool)
    foot[:-1] = (np.diff(layers.cell) == 0) & (np.diff(layers.height) <= headroom) & (joined[1:] > 1)
    return foot


def _first_of_each_cell(layers: Layers, nodes: BoolArray) -> BoolArray:
    rows = np.flatnonzero(nodes)
    made = np.zeros_like(nodes)
    made[rows[np.unique(layers.cell[rows], return_index=True)[1]]] = True
    return made


def _lowest_of(layers: Layers, piece: IntArray, least: int) -> IntArray:
    """The nodes of a smooth piece on its lowest floor: all of them, or the floor below where it lies over itself.

    So do two floors that a ramp or a gentle stair joins. A node that is alone in its cell is of the floor to which the
    way over the piece is shorter: the upper floor over a hole in the scan of the lower one stays the upper floor, and
    half of the ramp is of either. What is joined to the floor only over others is left for them. Fewer nodes than the
    `least` that lie over others are no floor.
    """
    cell = layers.cell[piece]
    over = np.r_[False, np.diff(cell) == 0]
    if not over.any():
        return piece
    mark = np.full(len(layers.cell), -1, dtype=np.int8)
    mark[piece] = np.where(over, 2, 0)
    slopes = connect(layers, mark >= 0, layers.cell_width)
    part = components(*slopes, mark == 2)[piece]
    floor = over & (np.bincount(part[over], minlength=part.max() + 1) >= least)[part]
    if not floor.any():
        lowest: IntArray = piece[~over]
        return lowest
    mark[piece] = np.where(floor, 2, np.where(over, -1, np.isin(cell, cell[floor])))
    mark_nearest(*slopes, mark)
    low = mark == 1
    part = components(*slopes, low)[piece]
    floors: IntArray = piece[low[piece] & (part == np.bincount(part[low[piece]]).argmax())]
    return floors

"""Ground that overlaps in plan, split into sheets that are single-valued in (x, y)."""

from __future__ import annotations

import numpy as np

from gpdf_service.config import PerceptionConfig
from gpdf_service.fields.threads import run_parallel
from gpdf_service.perception.beside import Beside
from gpdf_service.perception.columns import by_cell
from gpdf_service.perception.layers import Layers, Pairs, connect
from gpdf_service.perception.nodes import (
    components,
    extents_in_plan,
    grown_sheet,
    mark_nearest,
    touched_by,
    whole_around,
)
from gpdf_service.perception.pairs import pairs_within
from gpdf_service.perception.segment import over_ground, steps_over_gaps
from gpdf_service.types import BoolArray, IntArray

OVERLAP = 1.2
"""[m] How far a sheet reaches into the next: twice the largest body's radius, so that a body fits where they meet."""


def split_sheets(near: Beside, config: PerceptionConfig) -> tuple[BoolArray, ...]:
    """Which nodes are of each sheet: no sheet has two nodes in one cell; sheets overlap by `OVERLAP` where they meet.

    The lowest comes first, by the median of its heights.
    """
    layers = near.layers
    count = len(layers.cell)
    keep = ~_under_step(near, config.step_headroom)
    keep &= ~over_ground(layers, keep, config.step_headroom)  # what goes on nowhere
    if (np.diff(layers.cell[keep]) > 0).all():
        return (keep,)
    smooth, _, steps = near.pieces(keep, layers.cell_width, None, keep, config.max_step)
    over = steps_over_gaps(near, keep, smooth, config)[0]
    one, other = (np.concatenate(ends) for ends in zip(pairs_within(*steps, keep, True, smooth), over, strict=True))
    sheet_of = np.full(count, -1)
    size = np.bincount(smooth, weights=keep)
    order = np.argsort(-size)
    start, members = by_cell(smooth, len(size))
    least = max(9, int(0.001 * count))  # a patch smaller than three cells square holds no foot
    sheets = 0
    for seed in order[size[order] > 0]:
        own = members[start[seed] : start[seed + 1]]
        left = own[sheet_of[own] < 0]
        while len(left) >= (least if len(left) < len(own) else 1):
            sheet_of[_lowest_of(layers, left, least)] = sheets
            _attach(layers, (one, other), (smooth, start, members), sheet_of, sheets)
            sheets += 1
            left = own[sheet_of[own] < 0]
    made = [np.flatnonzero(sheet_of == i) for i in range(sheets)]
    rings = int(np.ceil(OVERLAP / layers.cell_width))

    def grow(nodes: IntArray) -> BoolArray:
        sheet = np.zeros(count, dtype=bool)
        sheet[nodes] = True
        beside = near.across(sheet, keep & ~sheet, config.max_step)[1]
        return grown_sheet(layers.columns, keep, sheet, beside, config.max_step, rings)

    grown = run_parallel(grow, [nodes for nodes in made if len(nodes) >= least])
    seams = run_parallel(grow, _seams(near, keep, grown, config, rings))
    grown = [*grown, *(inside for inside in seams if np.count_nonzero(inside) >= least)]
    return tuple(sorted(grown, key=lambda inside: float(np.median(layers.height[inside]))))


def _seams(
    near: Beside, keep: BoolArray, sheets: list[BoolArray], config: PerceptionConfig, rings: int
) -> list[IntArray]:
    """Nodes of further sheets, so that a body finds all ground around each place in one of them.

    A sheet that lies over its own end has no room to reach into the next: the upper floor's, which goes down a stair
    of open treads and ends at its foot under that floor.
    """
    layers = near.layers

    def pieces(nodes: BoolArray) -> tuple[IntArray, BoolArray]:
        """Pieces of nodes that steps join, and which of them a foot fits on: a rim of single cells is no ground."""
        piece = near.pieces(nodes, config.max_step)[0]
        depth = extents_in_plan(layers.cell, layers.shape[1], nodes, piece, layers.cell_width)[1]
        return piece, depth >= config.tread_depth

    left = keep.copy()
    for sheet in sheets:
        piece, deep = pieces(keep & ~sheet)
        beyond = near.across(sheet, keep & ~sheet & deep[piece], config.max_step)
        left &= ~whole_around(layers.columns, sheet, beyond, config.max_step, rings // 2)
    piece, deep = pieces(left)
    return [_first_of_each_cell(layers, np.flatnonzero(left & (piece == label))) for label in np.flatnonzero(deep)]


def rise_of_sheets(layers: Layers, config: PerceptionConfig) -> float:
    """Between the nodes of pairs that `split_sheets` asks for, at most: a step, or a cell's diagonal [m]."""
    return max(config.max_step, float(np.sqrt(2.0)) * layers.cell_width)


def _under_step(near: Beside, headroom: float) -> BoolArray:
    """Nodes at the foot of a step whose top is in the same cell, and goes on beside it: such a cell is the step's top.

    So is that of an open tread with less than the `headroom` [m] under it. A single point over the floor goes on
    nowhere.
    """
    layers = near.layers
    joined = near.degrees("smooth", np.ones(len(layers.cell), dtype=bool), layers.cell_width)
    foot = np.zeros(len(layers.cell), dtype=bool)
    foot[:-1] = (np.diff(layers.cell) == 0) & (np.diff(layers.height) <= headroom) & (joined[1:] > 1)
    return foot


def _first_of_each_cell(layers: Layers, nodes: IntArray) -> IntArray:
    return nodes[np.unique(layers.cell[nodes], return_index=True)[1]]


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


def _attach(
    layers: Layers, pairs: Pairs, pieces: tuple[IntArray, IntArray, IntArray], sheet_of: IntArray, sheet: int
) -> None:
    """Add to a sheet, one after another, the smooth pieces beside it that do not lie over it."""
    smooth, start, members = pieces
    taken = np.zeros(layers.shape[0] * layers.shape[1], dtype=bool)
    taken[layers.cell[sheet_of == sheet]] = True
    while True:
        grown = False
        for piece in np.unique(smooth[touched_by(*pairs, sheet_of < 0, sheet_of == sheet)]):
            nodes = members[start[piece] : start[piece + 1]]
            nodes = nodes[sheet_of[nodes] < 0]
            cells = layers.cell[nodes]  # ascending, as nodes are
            if not taken[cells].any() and (np.diff(cells) > 0).all():
                sheet_of[nodes] = sheet
                taken[cells] = True
                grown = True
        if not grown:
            return

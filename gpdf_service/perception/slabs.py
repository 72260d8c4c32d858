"""Slabs that are seen from below: undersides of floors and treads are no ground, nor is what hangs with them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from gpdf_service.config import PerceptionConfig
from gpdf_service.ground.foot import HALF_FOOT, STRIDE
from gpdf_service.perception.parts import OVER_SHARE, TABLE_AREA, Parts, build_parts, share
from gpdf_service.tiles.beside import Answer, Beside, Strips
from gpdf_service.tiles.layers import Layers, Pairs
from gpdf_service.tiles.nodes import joined_to
from gpdf_service.tiles.pieces import find_pieces
from gpdf_service.types import BoolArray


def _slabs(near: Beside, parts: Parts, config: PerceptionConfig) -> tuple[Strips, BoolArray]:
    """Nodes of slabs that are seen from below, and which parts hang: slabs, with or without a top, (parts + 1,).

    An underside is at most a step below nodes of parts, as wide as a body, and over more than strays. A part hangs if
    it is mostly that, or is seen more under a floor, larger than furniture, than over an underside of its own.
    """
    floors = parts.size * near.layers.cell_width**2 > TABLE_AREA

    def beneath(layers: Layers, _: BoolArray, room: BoolArray, floor: BoolArray) -> Answer:
        over, found = np.r_[False, layers.cell[1:] == layers.cell[:-1]], np.zeros(len(room), dtype=bool)
        low, top, ceiling = found.copy(), found.copy(), found.copy()
        low[:-1] = over[1:] & (np.diff(layers.height) <= config.max_step)
        found[:-1] = low[:-1] & ~room[:-1] & room[1:]
        ceiling[:-1], top[1:] = found[:-1] & floor[1:], low[:-1] & room[1:]
        return found, found & over, ceiling, top

    over = parts.pieces.chosen("floors over slabs", floors)
    slab, aloft, ceiling, top = near.around("slabs", 0, beneath, parts.keep, over)
    pieces = find_pieces(near, "slabs", slab, parts.rise)
    size, lies = pieces.counts("slabs aloft", slab, aloft)
    wide = pieces.extents("slabs", slab)[1] >= config.standing_width
    under = pieces.chosen("slabs", wide & (lies > OVER_SHARE * size))
    hidden = near.each("under floors", np.logical_and, under, ceiling)
    of_parts, all_, hung, tops = parts.counts("undersides", under, parts.flat, hidden, top)
    hangs = (share(of_parts, all_) >= 0.5) | (hung > tops)
    hangs[-1] = False
    return under, hangs


def undersides(near: Beside, parts: Parts, config: PerceptionConfig) -> tuple[Strips, Parts, BoolArray]:
    """Nodes of slabs that are seen from below, the parts without them, and which of these are what was left.

    What is left of a part that hangs, and what that is around, are pieces by themselves: where the slab's top has holes
    in its scan, and a stair's last tread, where that is as high as the underside beside it. See `without_ceilings`.
    """
    under, hangs = _slabs(near, parts, config)

    def without(_: Layers, __: BoolArray, *given: BoolArray) -> Answer:
        under, hung, room, flat = given
        under = under | (hung & ~room)
        return under, flat & ~under, hung & room

    given = under, parts.pieces.chosen("hung", hangs), parts.keep, parts.flat
    under, flat, rest = near.around("undersides", 0, without, *given)
    if not any(each.any() for each in under):
        return under, parts, np.zeros_like(hangs)
    left = build_parts(near, "parts left", flat, parts.keep, parts.inner, parts.rise, config)

    def scraps(layers: Layers, _: BoolArray, room: BoolArray, under: BoolArray, inner: BoolArray) -> Answer:
        touches = joined_to(layers.columns, room, under, parts.rise)
        return touches, room & (touches | ~inner)

    kinds = near.around("scraps", 1, scraps, left.keep, under, parts.inner)
    touches, all_, held = left.counts("scraps", *kinds, rest)
    found: BoolArray = (share(touches, all_) >= 0.5) | (held > 0)
    found[-1] = False
    return under, left, found


def without_ceilings(
    near: Beside, parts: Parts, joins: Pairs, under: Strips, scraps: BoolArray, config: PerceptionConfig
) -> tuple[Strips, Parts, Pairs]:
    """What is left of undersides, `scraps` of shape (parts + 1,), is one as well but for treads: one steps down there.

    Through a hole in the scan of a slab's top nothing is within a stride below. Where that hole is beside a tread, the
    tread is what is as near to the one below it as that is deep, at most a stride: a ramp is no tread.
    """
    if not scraps.any():
        return under, parts, joins
    layers, of = near.layers, parts.pieces.whole
    lost = scraps[of]
    high, low = (np.concatenate(ends) for ends in zip(joins, joins[::-1], strict=True))
    down = scraps[high] & ~scraps[low] & (parts.level[high] - parts.level[low] > parts.rise)
    down &= parts.size[low] * layers.cell_width**2 >= HALF_FOOT
    for scrap, below in zip(high[down], low[down], strict=True):
        rise = parts.level[scrap] - layers.height  # a ramp and both its storeys are one part
        tread = (of == below) & (rise > 0.0) & (rise <= config.max_step)
        own, beneath = np.flatnonzero(of == scrap), np.flatnonzero(tread)
        off = cKDTree(layers.place[beneath]).query(layers.place[own])[0]
        lost[own[off <= min(parts.depth[below], STRIDE) + layers.cell_width]] = False

    def without(_: Layers, __: BoolArray, *given: BoolArray) -> Answer:
        under, lost, flat, room = given
        return under | lost, flat & ~lost, room & ~lost

    gone = near.among("ceilings", np.flatnonzero(lost))
    under, flat, keep = near.around("ceilings", 0, without, under, gone, parts.flat, parts.keep)
    none = np.diff(parts.pieces.first) - 1
    label = [np.where(one, number, each) for each, one, number in zip(parts.pieces.label, gone, none, strict=True)]
    pieces = replace(parts.pieces, label=near.same("labels without ceilings", label))
    left = replace(parts, name="parts under ceilings", pieces=pieces, flat=flat, keep=keep)
    left = replace(left, size=left.counts("room", keep)[0])
    good = (left.size[joins[0]] > 0) & (left.size[joins[1]] > 0)
    return under, left, (joins[0][good], joins[1][good])

"""Random houses of two storeys that a stair joins, with what one needs to scan and to judge them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gpdf_service.synthetic.furniture import bounds_in_plan, random_piece
from gpdf_service.synthetic.place import Place
from gpdf_service.synthetic.solid_world import SolidWorld
from gpdf_service.synthetic.solids import Solid, board, box, post, turn_and_shift
from gpdf_service.synthetic.stairs import STAIRS, Stair, random_stair
from gpdf_service.types import BoolArray, FloatArray

WALL = 0.2
"""[m] Thickness of the outer walls."""
ROOM = 2.5
"""[m] Height of the upper storey."""
HEADROOM = 2.1
"""[m] At least over each tread; a floor that would be lower over it has its opening there."""
APPROACH = 1.5
"""[m] Before the first step and beyond the last one there is so much floor."""
NARROWEST = 3.5
"""[m] No house is narrower."""
DOOR = (0.9, 2.05)
"""[m] Width and height."""


@dataclass(frozen=True, slots=True)
class Plan:
    """A house from above: the rectangle of its floors and of its stair, each (2, 2) [m], lowest and highest corner."""

    floor: FloatArray
    stair: FloatArray


def house(rng: np.random.Generator, kind: str = "") -> Place:
    """A house of two storeys.

    Args:
        rng: Source of all that is random.
        kind: One of `STAIRS`; a random one where it is empty.
    """
    stair = random_stair(kind or str(rng.choice(list(STAIRS))), rng)
    plan, slab = _plan(stair, rng), float(rng.uniform(0.18, 0.28))
    solids = [*stair.solids(), *_shell(plan, stair.storey), *_upper_floor(stair, plan, slab, rng)]
    doors: list[FloatArray] = []
    for z, height in ((0.0, stair.storey - slab), (stair.storey, ROOM)):
        solids += _partition(plan, z, height, doors, rng)
        solids += _furniture(plan, z, doors, rng)
    T = turn_and_shift(float(rng.uniform(-np.pi, np.pi)), rng.uniform(-5.0, 5.0, 3))
    if rng.random() < 0.5:
        T = T @ np.diag([1.0, -1.0, 1.0, 1.0])  # turns to the right
    way = stair.way() @ T[:3, :3].T + T[:3, 3]
    rooms = [_room(plan.floor, z, T) for z in (0.0, stair.storey)]
    landings = way[1:-1][[tread.is_landing for tread in stair.treads]]
    return Place(f"house_{stair.name}", SolidWorld(tuple(solids)).moved(T), tuple(rooms), way, landings)


def _room(floor: FloatArray, z: float, T: FloatArray) -> FloatArray:
    """The four corners of a storey's floor, in order, (4, 3)."""
    (x0, y0), (x1, y1) = floor
    corners = np.array([(x0, y0, z), (x1, y0, z), (x1, y1, z), (x0, y1, z)])
    made: FloatArray = corners @ T[:3, :3].T + T[:3, 3]
    return made


def _plan(stair: Stair, rng: np.random.Generator) -> Plan:
    """Walls around the stair: against it, or so far that there is a room; with floor at its foot and its head."""
    outline = np.concatenate([tread.outline for tread in stair.treads])
    low, high = outline.min(axis=0), outline.max(axis=0)
    margin = np.where(rng.random((2, 2)) < 0.4, 0.06, rng.uniform(1.0, 2.5, (2, 2)))
    margin[rng.integers(2), rng.integers(2)] = rng.uniform(2.8, 4.0)
    way = stair.way()[:, :2]
    ends = [
        way[0] + (APPROACH - 1.0) * (way[0] - _edge(stair, 0)),
        way[-1] + (APPROACH - 1.0) * (way[-1] - _edge(stair, -1)),
    ]
    near = np.concatenate([[low - margin[0], high + margin[1]], ends])
    floor = np.array([near.min(axis=0), near.max(axis=0)])
    floor[1] = np.maximum(floor[1], floor[0] + NARROWEST)
    return Plan(floor, np.array([low, high]))


def _edge(stair: Stair, which: int) -> FloatArray:
    tread = stair.treads[which]
    middle: FloatArray = 0.5 * (tread.left[which] + tread.right[which])
    return middle


def _shell(plan: Plan, storey: float) -> list[Solid]:
    """Lowest floor, outer walls, ceiling."""
    (x0, y0), (x1, y1) = plan.floor
    top = storey + ROOM
    out = ((x0 - WALL, y0 - WALL), (x1 + WALL, y1 + WALL))
    walls = [
        (out[0], (x0, out[1][1])),
        ((x1, out[0][1]), out[1]),
        ((x0, out[0][1]), (x1, y0)),
        ((x0, y1), (x1, out[1][1])),
    ]
    made = [box("floor", (x0, y0, -WALL), (x1, y1, 0.0), walkable=True)]
    made += [box("wall", (*low, -WALL), (*high, top)) for low, high in walls]
    return [*made, box("ceiling", (*out[0], top), (*out[1], top + WALL))]


def _upper_floor(stair: Stair, plan: Plan, slab: float, rng: np.random.Generator) -> list[Solid]:
    """The slab around its opening, and a guard along that, but for where the stair arrives."""
    need = stair.height > stair.storey - slab - HEADROOM - stair.style.rise * (1.0 + 0.3 / stair.style.going)
    outlines = [tread.outline for tread, over in zip(stair.treads, need, strict=True) if over]
    rect = np.array([[outline.min(axis=0), outline.max(axis=0)] for outline in outlines])
    cuts = [np.unique(np.round([*rect[:, :, k].ravel(), *plan.floor[:, k]], 6)) for k in (0, 1)]
    cuts = [np.clip(cut, *plan.floor[:, k]) for k, cut in enumerate(cuts)]
    middle = [0.5 * (cut[1:] + cut[:-1]) for cut in cuts]
    open_ = np.zeros((len(middle[0]), len(middle[1])), dtype=bool)
    for low, high in rect:
        inside = [(m > low[k]) & (m < high[k]) for k, m in enumerate(middle)]
        open_ |= np.outer(*inside)
    open_ = _closed(open_)
    made = []
    for i, j, k in _runs(~open_):
        low, high = (cuts[0][i], cuts[1][j]), (cuts[0][i + 1], cuts[1][k])
        made.append(box("floor", (*low, stair.storey - slab), (*high, stair.storey), walkable=True))
    return made + (_guard(stair, cuts, open_) if rng.random() < 0.7 else [])


def _closed(open_: BoolArray) -> BoolArray:
    """What lies between two open cells is open: the well of a stair."""
    made = open_.copy()
    for axis in (0, 1):
        before = np.logical_or.accumulate(open_, axis=axis)
        after = np.flip(np.logical_or.accumulate(np.flip(open_, axis), axis=axis), axis)
        made |= before & after
    return made


def _runs(shut: BoolArray) -> list[tuple[int, int, int]]:
    """Runs of cells in each row: row, first, one after the last."""
    made = []
    for i, row in enumerate(shut):
        edge = np.flatnonzero(np.diff(np.concatenate([[0], row.astype(np.int8), [0]])))
        made += [(i, int(a), int(b)) for a, b in edge.reshape(-1, 2)]
    return made


def _guard(stair: Stair, cuts: list[FloatArray], open_: BoolArray) -> list[Solid]:
    """A rail on posts along each edge of the opening that the stair's last edge does not lie on."""
    last, z = stair.treads[-1], stair.storey
    made: list[Solid] = []
    for axis in (0, 1):
        grid = open_ if axis == 0 else open_.T
        along, across = cuts[axis], cuts[1 - axis]
        for i, j in np.argwhere(grid[1:] != grid[:-1]):
            ends = np.array([[along[i + 1], across[j]], [along[i + 1], across[j + 1]]])
            ends = ends if axis == 0 else ends[:, ::-1]
            if _on_edge(ends.mean(axis=0), last.left[-1], last.right[-1]):
                continue
            a, b = (np.append(end, z + 1.0) for end in ends)
            if np.hypot(*(b - a)[:2]) < 0.01:
                continue
            made.append(board("guard", a, b, 0.05, 0.05, 0.0))
            count = max(1, round(float(np.hypot(*(b - a)[:2])) / 0.15))
            made += [post("guard", (*(a + t * (b - a))[:2], z), 0.012, 1.0, 6) for t in np.arange(count) / count]
    return made


def _on_edge(place: FloatArray, a: FloatArray, b: FloatArray) -> bool:
    t = (place - a) @ (b - a) / ((b - a) @ (b - a))
    return bool(-1e-6 <= t <= 1.0 + 1e-6 and np.hypot(*(a + t * (b - a) - place)) < 0.02)


def _partition(plan: Plan, z: float, height: float, doors: list[FloatArray], rng: np.random.Generator) -> list[Solid]:
    """A wall with a door beside the stair, where there is room for one."""
    beside = [(k, s) for k in (0, 1) for s in (0, 1) if abs(plan.floor[s, k] - plan.stair[s, k]) > 2.6]
    if not beside or rng.random() < 0.4:
        return []
    k, s = beside[rng.integers(len(beside))]
    where = plan.stair[s, k] + (1.4 if s else -1.4)
    low, high = plan.floor[:, 1 - k]
    begin = float(rng.uniform(low + 0.3, high - DOOR[0] - 0.3))
    doors.append(np.array([where, begin + 0.5 * DOOR[0]])[:: 1 if k == 0 else -1])

    def piece(a: float, b: float, bottom: float) -> Solid:
        ends = np.array([[where - 0.05, a, z + bottom], [where + 0.05, b, z + height]])
        return box("wall", *(ends if k == 0 else ends[:, [1, 0, 2]]))

    return [piece(low, begin, 0.0), piece(begin, begin + DOOR[0], DOOR[1]), piece(begin + DOOR[0], high, 0.0)]


def _furniture(plan: Plan, z: float, doors: list[FloatArray], rng: np.random.Generator) -> list[Solid]:
    """Pieces that leave the stair, what is before it, and the doors free."""
    made: list[Solid] = []
    for _ in range(int(rng.integers(4, 9))):
        x, y = rng.uniform(plan.floor[0] + 0.05, np.maximum(plan.floor[1] - 1.0, plan.floor[0] + 0.1))
        piece = random_piece((float(x), float(y), z), rng)
        low, high = bounds_in_plan(piece)
        inside = (high < plan.floor[1]).all()
        near_stair = ((high > plan.stair[0] - APPROACH) & (low < plan.stair[1] + APPROACH)).all()
        near_door = any(((high > door - 1.2) & (low < door + 1.2)).all() for door in doors)
        if inside and not near_stair and not near_door:
            made += piece
    return made

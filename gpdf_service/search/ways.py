"""What a way costs a body, in seconds: time, and effort as the time that one would rather walk than take it.

A body that takes steps has two free spaces: its own, and that of the same body as it goes on level ground, where every
step is an obstacle. The graph here holds both, joined where steps are near: so a way leaves the level ground only where
that is worth its price, and it is smoothed and kept clear of ledges by the space that it is in.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numba.typed import List
from numpy.typing import NDArray

from gpdf_service.fields import NearerArrays
from gpdf_service.fields.traversal import nearest_only
from gpdf_service.fields.tree import Scratch, make_scratch
from gpdf_service.ground import ObstacleKind
from gpdf_service.kernel_cache import lean
from gpdf_service.search.core import Core
from gpdf_service.search.free_space import NOTICED_STEP, FreeSpace, LevelSpace
from gpdf_service.search.graph import Edges, Graph, assemble
from gpdf_service.search.landmarks import find_landmarks
from gpdf_service.search.places import Places, nearest_of
from gpdf_service.search.resplit import FELT
from gpdf_service.tiles.rows import is_among, rows_among
from gpdf_service.tiles.surface import UNKNOWN, Cells, cell_of, count_in
from gpdf_service.types import Agent, BoolArray, ByteArray, Float32Array, FloatArray, IntArray

CARE = 0.5
"""[-] Share of the speed near steps, and where no room is left beside the body: on stairs people go 0.5 m/s in plan
(Fruin 1971), half of what they walk."""
BORDER = 0.25
"""[m] Leaves of the level ground with less room than this to spare lead on to steps: what is wholly free has at most
2.12 times its width, and leaves of a tenth are the narrowest ones that a core is sure to hold."""
CHANGE = 0.5
"""[s] To go over from level ground to where steps are, or back: a stride. Where both cost the same, a way would change
from leaf to leaf, and its many pieces would each be pulled and bent alone."""
LOOK = 0.1
"""[m] Room beside a way is looked at this often: two waypoints."""
WIDE = FELT - 1.0
"""[-] Who wants it wide minds less room than this beside the body, over its radius: an arm's length for a person."""
MINDED = 10.0
"""[-] How much more than its time narrowness costs who wants it wide: a metre without room is a detour of ten."""
STEPLESS = 20.0
"""[-] How much more steps cost who wants it level: a storey is six minutes, a ramp of 1 in 12 up to it one."""

LENGTH, TIGHT, UNSEEN, SLOPED, STEPPED, LEDGE = range(6)
"""What a way takes: metres; metres times how tight they are, wholly near steps; the same beside ground that nobody has
seen; metres of rise or fall on slopes, on steps, and on steps higher than the body takes gladly."""


class Prefer(StrEnum):
    """What one wants of a way."""

    COMPANION = "companion"
    QUICKEST = "quickest"
    LEVEL = "level"
    WIDE = "wide"


def prices(agent: Agent, prefer: Prefer = Prefer.COMPANION) -> FloatArray:
    """Seconds for each of what a way takes, shape (6,); the first is the least that a metre costs."""
    second = 1.0 / agent.speed
    slow = second * (1.0 / CARE - 1.0)
    made = np.array([second, slow, slow, agent.climb_time, agent.climb_time, agent.ledge_time])
    if prefer == Prefer.QUICKEST:
        made[[UNSEEN, LEDGE]] = 0.0
    elif prefer == Prefer.LEVEL:
        made[[STEPPED, LEDGE]] *= STEPLESS
    elif prefer == Prefer.WIDE:
        made[[TIGHT, UNSEEN]] *= MINDED
    return made


@lru_cache(maxsize=64)
def level_body(agent: Agent) -> Agent | None:
    """The same body as it goes on level ground; None where it takes no step that is noticed. Asked for in each plan."""
    return replace(agent, max_step=NOTICED_STEP) if agent.max_step > NOTICED_STEP else None


class Beside(NamedTuple):
    """What a way in one level of a free space meets: see `FreeSpace`; the `kind` of each obstacle, (n,)."""

    places: Places
    kind: ByteArray
    ground: Cells
    noticed: NDArray[np.int32]
    steps: FloatArray
    slopes: FloatArray
    reach: float
    minded: float
    glad_step: float


def beside(space: FreeSpace, level: int, prefer: Prefer = Prefer.COMPANION) -> Beside:
    """What is beside the ways on a level."""
    own, limits = space.levels[level], (space.reach, minded_room(space.agent, prefer), space.agent.comfortable_step)
    return Beside(own.places, own.kind, own.surface.arrays, own.noticed, own.steps, own.slopes, *limits)


Fields = tuple[NearerArrays, NearerArrays]
"""d_o, 2D, and d_g, 3D, in compiled form."""


@njit(cache=True, nogil=True)
def boxed(content: tuple[Any, ...]) -> Any:  # noqa: ANN401 - a sequence of what it is given
    """A list of Numba's own that holds one tuple of arrays, which live as long as it does.

    Numba takes a tuple over from Python array by array, at each call: some 0.25 µs each; such a list as it is, whatever
    is in it. So what a space keeps for its plans is in lists of one tuple.
    """
    box = List()
    box.append(content)
    return box


class Here(NamedTuple):
    """What a level of a free space is to the kernels of a plan; `ends` and `inferred` are those of its `HeightMap`."""

    about: Beside
    ends: Float32Array
    inferred: NDArray[np.int32]


def here(space: FreeSpace, level: int, prefer: Prefer = Prefer.COMPANION) -> Sequence[Here]:
    """What a level is to the kernels of a plan, in a box that the space keeps."""
    if (level, prefer) not in space.boxes:
        surface = space.levels[level].surface
        space.boxes[level, prefer] = boxed(Here(beside(space, level, prefer), surface.ends, surface.inferred))
    box: Sequence[Here] = space.boxes[level, prefer]
    return box


def fields_of(space: FreeSpace, level: int, *, exact: bool = False) -> Sequence[Fields]:
    """What a path on a level is bent by, or by the `exact` places of obstacles, in a box that the space keeps."""
    key = Fields, level, exact
    if key not in space.boxes:
        own = space.levels[level]
        obstacles = tuple(map(nearest_only, own.places)) if exact else own.obstacle_field.arrays
        space.boxes[key] = boxed((obstacles, own.ground_field.arrays))
    box: Sequence[Fields] = space.boxes[key]
    return box


def minded_room(agent: Agent, prefer: Prefer) -> float:
    """Less room than this beside the body is tight [m]."""
    return agent.disc_radius * (WIDE if prefer == Prefer.WIDE else 1.0)


@njit(cache=True, nogil=True)
def way_takes(path: FloatArray, about: Beside) -> FloatArray:
    """What each segment of a way in plan, shape (n, 2), takes: shape (n − 1, 6).

    What is seen beside the way counts until the next look. Distances are 1-Lipschitz: as long as there must be enough
    room yet, no obstacle is looked for.
    """
    made = least_takes(path, about)
    _look_beside(path, about, make_scratch(), made)
    return made


@njit(cache=True, nogil=True)
def straight_takes(xy: FloatArray, ends: FloatArray, about: Beside) -> FloatArray:
    """What the straight way from a place (2,) to each of others, shape (k, 2), takes: shape (k, 6)."""
    made, path = np.empty((len(ends), 6)), np.empty((2, 2))
    path[0] = xy
    for i in range(len(ends)):
        path[1] = ends[i]
        made[i] = way_takes(path, about)[0]
    return made


@lean()
def _look_beside(path: FloatArray, about: Beside, scratch: Scratch, made: FloatArray) -> None:
    """Add to what a way takes at least what is beside it; see `way_takes`."""
    cells, enough = int(np.ceil(about.reach / about.ground.width)), about.reach + about.minded
    distance, due, tight, unseen = -np.inf, 0.0, 0.0, False
    for i in range(len(path) - 1):
        length, at = made[i, LENGTH], 0.0
        while at < length:
            if due <= 0.0:
                share = at / length
                x = path[i, 0] + share * (path[i + 1, 0] - path[i, 0])
                y = path[i, 1] + share * (path[i + 1, 1] - path[i, 1])
                if distance < enough:
                    distance, row = nearest_of(about.places, (x, y, 0.0), scratch)
                    unseen = distance < enough and row >= 0 and about.kind[row] == ObstacleKind.UNKNOWN
                tight = min(max(1.0 - (distance - about.reach) / about.minded, 0.0), 1.0)
                tight = 1.0 if is_stepped(about.ground, about.noticed, x, y, cells) else tight
                due, distance = LOOK, distance - LOOK
            piece = min(length - at, due)
            at, due = at + piece, due - piece
            made[i, TIGHT] += tight * piece
            made[i, UNSEEN] += tight * piece if unseen else 0.0


@njit(cache=True, nogil=True)
def least_takes(path: FloatArray, about: Beside) -> FloatArray:
    """What `way_takes` says, but for what is beside the way: never more, and soon told."""
    made = np.zeros((len(path) - 1, 6))
    _look_at_ground(path, about, made)
    return made


@lean()
def _look_at_ground(path: FloatArray, about: Beside, made: FloatArray) -> None:
    """Write what `least_takes` says."""
    on = about.ground, about.steps, about.slopes, about.glad_step
    for i in range(len(path) - 1):
        a, b = (path[i, 0], path[i, 1]), (path[i + 1, 0], path[i + 1, 1])
        taken = _ground_takes(a, b, on)
        made[i, LENGTH], made[i, SLOPED], made[i, STEPPED], made[i, LEDGE] = taken


_Ground = tuple[Cells, FloatArray, FloatArray, float]
"""Heights, steps and slopes of the ground, and the highest step that is gladly taken [m]."""


@lean()
def _ground_takes(a: tuple[float, float], b: tuple[float, float], on: _Ground) -> tuple[float, float, float, float]:
    """The length of a segment, and what its ground takes, which is looked at twice a cell: slopes, steps, high ones."""
    ground, steps, slopes, glad_step = on
    length = np.sqrt((b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2)
    count = max(1, int(np.ceil(2.0 * length / ground.width)))
    before, step_before, sloped, stepped, ledge = np.nan, 0.0, 0.0, 0.0, 0.0
    for k in range(count + 1):
        t = k / count
        u, v = cell_of(ground, a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1]))
        if u < 0 or ground.state[u, v] == UNKNOWN:
            continue
        z, step = float(ground.height[u, v]), max(steps[u, v], step_before)
        if step <= NOTICED_STEP:
            sloped += length / count * np.tan(slopes[u, v]) if k > 0 and slopes[u, v] > 0.0 else 0.0
        elif not np.isnan(before):
            stepped += abs(z - before)
            ledge += abs(z - before) if step > glad_step else 0.0
        before, step_before = z, steps[u, v]
    return length, sloped, stepped, ledge


@njit(cache=True, nogil=True)
def way_steps(path: FloatArray, here: Sequence[Here]) -> tuple[float, float]:
    """Rise and fall in steps, and in high ones, of a way in plan on a level, shape (n, ≥ 2) [m]."""
    takes = least_takes(path, here[0].about)
    return takes[:, STEPPED].sum(), takes[:, LEDGE].sum()


class Priced(NamedTuple):
    """What all ways were priced by, and at what: nodes and edges are told by keys that ascend, see `_keys`.

    Attributes:
        node: Key of each node of the graph, shape (k,).
        leaf: The node of the other space whose leaf holds it, −1 for none, shape (k,).
        room: From it to the nearest obstacle of either space [m], shape (k,).
        unseen: Whether that of its own space is ground which nobody has seen, shape (k,).
        edge: Key of each edge, shape (e,): of both spaces, and then of the doors between them.
        seconds: What each of them costs.
    """

    node: IntArray
    leaf: IntArray
    room: FloatArray
    unseen: BoolArray
    edge: IntArray
    seconds: FloatArray


_NONE = np.zeros(0, np.int64)
_NOTHING = Priced(_NONE, _NONE, np.zeros(0), np.zeros(0, dtype=bool), _NONE, np.zeros(0))
_APART = 1 << 40
"""[-] Keys of the next space's nodes and edges are so much higher: no graph has as many."""


@dataclass(frozen=True, slots=True)
class Ways:
    """All ways of a body, with what they cost it.

    Attributes:
        spaces: Its own free space; and that of the level ground, if it takes steps.
        prefer: What one wants of a way.
        graph: The cores of both, that of the level ground last; `cost` is in seconds.
        rate: Least seconds that a metre costs.
        priced: What it was priced by.
    """

    spaces: tuple[FreeSpace, ...]
    prefer: Prefer
    graph: Graph
    rate: float
    priced: Priced

    @property
    def first_level_node(self) -> int:
        """Nodes from this on are of the level ground."""
        return len(self.spaces[0].core.node)

    @property
    def half_size(self) -> FloatArray:
        """Half the width of each node's leaf [m]."""
        return np.concatenate([_of_leaves(each, "half_size", np.arange(len(each.core.node))) for each in self.spaces])


def find_ways(able: FreeSpace, level: FreeSpace | None, prefer: Prefer, stand: Ways | None = None) -> Ways:
    """Join the free space of a body with that of the level ground, and price the core of both.

    Where something moves, the ways of what stands know the price of all that it does not touch.
    """
    spaces = (able,) if level is None else (able, level)
    if stand is not None and all(now.core is was.core for now, was in zip(spaces, stand.spaces, strict=True)):
        return replace(stand, spaces=spaces)
    position, on = (
        np.concatenate([getattr(space.core.graph, key) for space in spaces]) for key in ("position", "level")
    )
    was, node = _NOTHING if stand is None else stand.priced, _keys([space.core.node for space in spaces])
    row = rows_among(node, was.node)
    leaf, unseen, room = _price_nodes(spaces, (position, on), was, row)
    found = [_edges_of(space.core, k * len(able.core.node)) for k, space in enumerate(spaces)]
    if level is not None:
        found.append(_doors(able, level, leaf, room, position))
    numbers, pairs, via = zip(*found, strict=True)
    edge, edges = _keys(numbers), (np.concatenate(pairs), np.concatenate(via))
    known, felt = rows_among(edge, was.edge), row < 0
    felt[~felt] = room[~felt] != was.room[row[~felt]]
    seconds, dear = np.empty(len(edge)), (known < 0) | felt[edges[0][:, 0]] | felt[edges[0][:, 1]]
    seconds[~dear] = was.seconds[known[~dear]]
    asked = edges[0][dear], edges[1][dear]
    through = CHANGE * (edge[dear] >= len(spaces) * _APART)
    seconds[dear] = _seconds(able, (position, on, room, unseen), asked, prefer) + through
    graph = assemble(position, on, edges, seconds)
    if stand is None:
        graph = graph._replace(landmarks=find_landmarks(graph.first, graph.other, graph.cost, graph.component))
    priced = Priced(node, leaf, room, unseen, edge, seconds)
    return Ways(spaces, prefer, graph, float(prices(able.agent, prefer)[LENGTH]), priced)


def _price_nodes(
    spaces: tuple[FreeSpace, ...], places: tuple[FloatArray, IntArray], was: Priced, row: IntArray
) -> tuple[IntArray, BoolArray, FloatArray]:
    """The leaf of the other space, what is unseen, and the room of each node: see `Priced`.

    The nodes are at these places in plan, (k, 2) [m], and levels (k,); `row` says which of those that were it is, −1
    for none, and what is told of that stands.
    """
    (position, on), first = places, [0, len(spaces[0].core.node), len(row)]
    room = np.concatenate([space.core.clearance for space in spaces])
    fresh, leaf, unseen = row < 0, np.full(len(row), -1), np.zeros(len(row), dtype=bool)
    leaf[~fresh], unseen[~fresh] = was.leaf[row[~fresh]], was.unseen[row[~fresh]]
    for space, other, begin, end in zip(spaces, spaces[::-1], first, first[1:], strict=False):
        new = begin + np.flatnonzero(fresh[begin:end])
        unseen[new] = _unseen(space, position[new], on[new], room[new])
        if other is not space:
            gone = begin + np.flatnonzero(fresh[begin:end] | is_among(leaf[begin:end], other.gone))
            leaf[gone] = _leaf_at(other, position[gone], on[gone])
    if len(spaces) > 1:
        up = leaf[: first[1]]
        room[: first[1]] = np.minimum(room[: first[1]], np.where(up >= 0, spaces[1].core.links.room[up], 0.0))
    return leaf, unseen, room


def _keys(numbers: Sequence[IntArray]) -> IntArray:
    """Numbers of nodes, or of edges, of one space after the other: all ascend, and are the same whatever moves."""
    return np.concatenate([number + k * _APART for k, number in enumerate(numbers)])


def _edges_of(core: Core, first: int) -> tuple[IntArray, IntArray, FloatArray]:
    """Each edge of a core once: its number, its ends as nodes from the `first` on, and where it crosses."""
    row, other = np.repeat(np.arange(len(core.node)), np.diff(core.graph.first)), core.graph.other
    once = np.flatnonzero(row < other)
    pairs = first + np.column_stack([row[once], other[once]])
    return core.edge[once], pairs, core.graph.via.take(once, axis=0)


def _on_levels(space: FreeSpace, level: IntArray) -> Iterator[tuple[LevelSpace, IntArray]]:
    """Each level of a space, and the rows of what is on it, by the `level` of each row."""
    return ((own, np.flatnonzero(level == on)) for on, own in enumerate(space.levels))


def _of_leaves(space: FreeSpace, name: str, rows: IntArray) -> FloatArray:
    """A measure of the leaves of some nodes of a space's core, shape (k,)."""
    node, made = space.core.node[rows], np.empty(len(rows))
    for own, here in _on_levels(space, space.core.graph.level[rows]):
        made[here] = getattr(own.quadtree, name)[node[here] - own.offset]
    return made


def _leaf_at(space: FreeSpace, position: FloatArray, level: IntArray) -> IntArray:
    """The node of a space whose leaf holds each place on a level, shape (k,); −1 for none."""
    made = np.empty(len(position), np.int64)
    for own, here in _on_levels(space, level):
        leaf = own.quadtree.find(position[here])
        made[here] = np.where(leaf >= 0, leaf + own.offset, -1)
    return made


def _doors(
    able: FreeSpace, level: FreeSpace, leaf: IntArray, room: FloatArray, position: FloatArray
) -> tuple[IntArray, IntArray, FloatArray]:
    """Where one gets from level ground to where steps are: level leaves, pairs of nodes (k, 2), and where [m].

    Only leaves at the border of the level ground are such, whose own `leaf` in the able space is wholly free.
    """
    count = len(able.core.node)
    node = count + np.flatnonzero(room[count:] < level.radius + BORDER)
    to = rows_among(leaf[node], able.core.node)
    good = to >= 0
    good[good] = _of_leaves(able, "whole", to[good]) > 0.0
    node, to = node[good], to[good]
    return level.core.node[node - count], np.column_stack([to, node]), position[node]


def _unseen(space: FreeSpace, position: FloatArray, on: IntArray, room: FloatArray) -> BoolArray:
    """Whether the nearest obstacle of nodes with so much room [m] is ground which nobody has seen, if that is near."""
    one, tight = np.zeros(len(room), dtype=bool), room < space.reach + space.agent.disc_radius
    for own, here in _on_levels(space, np.where(tight, on, -1)):
        if len(here):
            one[here] = own.clearance(position[here])[1] == ObstacleKind.UNKNOWN
    return one


_Nodes = tuple[FloatArray, IntArray, FloatArray, BoolArray]
"""Place in plan [m], level, room [m] of each node, and whether what is nearest is ground that nobody has seen."""


def _seconds(space: FreeSpace, nodes: _Nodes, edges: Edges, prefer: Prefer) -> FloatArray:
    """What each edge costs a body [s], shape (e,)."""
    (position, level, room, unseen), (ends, _), made = nodes, edges, np.zeros((len(edges[0]), 6))
    for on, own in enumerate(space.levels):
        ground = own.surface.arrays, own.steps, own.slopes, space.agent.comfortable_step
        _ground_of_edges((position, level), edges, on, ground, made)
    beside_it = room[ends].min(axis=1) - space.reach
    made[:, TIGHT] = made[:, LENGTH] * np.clip(1.0 - beside_it / minded_room(space.agent, prefer), 0.0, 1.0)
    made[:, UNSEEN] = made[:, TIGHT] * unseen[ends].any(axis=1)
    seconds: FloatArray = (made * prices(space.agent, prefer)).sum(axis=1)  # of each edge by itself, whatever is asked
    return seconds


@lean()
def _ground_of_edges(
    nodes: tuple[FloatArray, IntArray], edges: Edges, level: int, ground: _Ground, made: FloatArray
) -> None:
    """Add what the halves of the edges on a level take, from node to crossing."""
    (position, on), (ends, via) = nodes, edges
    for e in range(len(ends)):
        for node in ends[e]:
            if on[node] == level:
                a, b = (position[node, 0], position[node, 1]), (via[e, 0], via[e, 1])
                length, sloped, stepped, ledge = _ground_takes(a, b, ground)
                made[e, LENGTH] += length
                made[e, SLOPED] += sloped
                made[e, STEPPED] += stepped
                made[e, LEDGE] += ledge


@lean()
def is_stepped(ground: Cells, noticed: NDArray[np.int32], x: float, y: float, reach: int) -> bool:
    """Whether a step that is noticed is within `reach` cells of a place."""
    u, v = cell_of(ground, x, y)
    if u < 0:
        return False
    left, right = max(u - reach, 0), min(u + reach + 1, noticed.shape[0] - 1)
    near, far = max(v - reach, 0), min(v + reach + 1, noticed.shape[1] - 1)
    return bool(count_in(noticed, left, right, near, far) > 0)


@lean()
def is_near_step(path: FloatArray, ground: Cells, noticed: NDArray[np.int32], reach: float) -> bool:
    """Whether a way in plan, shape (n, 2), comes nearer than `reach` [m] to a step that is noticed."""
    cells = int(np.ceil(reach / ground.width))
    for i in range(len(path) - 1):
        dx, dy = path[i + 1, 0] - path[i, 0], path[i + 1, 1] - path[i, 1]
        length = np.sqrt(dx * dx + dy * dy)
        count = int(np.ceil(length / (ground.width * cells))) + 1
        for k in range(count + 1):
            if is_stepped(ground, noticed, path[i, 0] + k / count * dx, path[i, 1] + k / count * dy, cells):
                return True
    return False


@lean()
def count_steps(contact: FloatArray) -> int:
    """How many steps that are noticed a path over contact points, shape (n, 3), takes; a riser on end is one."""
    count, before = 0, 0
    for i in range(len(contact) - 1):
        rise = contact[i + 1, 2] - contact[i, 2]
        way = 0 if abs(rise) <= NOTICED_STEP else 1 if rise > 0.0 else -1
        count += way not in (0, before)
        before = way
    return count

"""From ends to seeds: the ways through the graph, string-pulled, the cheapest first; or a way known from before."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from math import hypot, sqrt
from typing import NamedTuple

import numpy as np
from numba import njit

from gpdf_service.fields.tree import make_scratch
from gpdf_service.planning.endpoints import Endpoint, Ends, connect, radius_at
from gpdf_service.planning.shape import (
    distinct,
    is_path_clear,
    is_straight,
    lengths,
    pull,
    radius_of,
    radius_within,
    tighten,
)
from gpdf_service.search.core import Core, Search, climb, find_nodes, search_in, tops_of
from gpdf_service.search.free_space import FreeSpace
from gpdf_service.search.graph import Doors, find_way
from gpdf_service.search.places import Places, distance_at
from gpdf_service.search.ways import (
    LEDGE,
    LENGTH,
    SLOPED,
    STEPPED,
    TIGHT,
    UNSEEN,
    Beside,
    Here,
    Prefer,
    Ways,
    beside,
    boxed,
    here,
    is_near_step,
    least_takes,
    prices,
    straight_takes,
    way_steps,
    way_takes,
)
from gpdf_service.tiles.surface import Cells
from gpdf_service.types import FloatArray, IntArray

NEAR = 0.5
"""[m] A way known from before is taken up if the start and the goal are this near to it: less than a stride."""
SPARED = 0.05
"""[-] Effort of less than this share of a way's time is not worth looking for another way."""
PULLED = 1.01
"""[-] A string pulled along a way may cost this much of it: it is looked at in steps."""
MOST_DOORS = 16
"""Leaves of the level ground that are tried from an end among steps, near and further."""


class Leg(NamedTuple):
    """A piece of the path on one level: places in plan (n, 2) [m], and the free space in which it is clear."""

    level: int
    path: FloatArray
    space: FreeSpace


class Route(NamedTuple):
    """A seed for the optimiser: its pieces, the number of its goal, whether it was known before, what it costs [s].

    A `direct` one is the shortest, and was looked for in the body's own free space alone.
    """

    legs: list[Leg]
    goal: int
    warm: bool = False
    cost: float = 0.0
    direct: bool = False

    @property
    def length(self) -> float:
        """Length in plan [m]."""
        return sum(float(lengths(leg.path)[-1]) for leg in self.legs)


class Wish(NamedTuple):
    """What one wants of a way, and all ways of the body at their price, which are only made where they are needed.

    And where there is time: `left` says how many seconds are.
    """

    prefer: Prefer
    ways: Callable[..., Ways] | None = None
    left: Callable[[], float] = lambda: np.inf


def find_routes(space: FreeSpace, ends: Ends, wish: Wish) -> list[Route]:
    """Ways to each goal that can be reached, through the via points, the cheapest first; empty if there is none."""
    routes = []
    for number, goal in enumerate(ends.goals):
        stops = [ends.start, *ends.via, *([goal] if goal else [])]
        if goal is None or find_cut(space, stops) is not None:
            continue
        parts = [_route(space, a, b, wish) for a, b in pairwise(stops)]
        legs = [leg for part, _, _ in parts for leg in part]
        direct = all(direct for _, _, direct in parts)
        routes.append(Route(legs, number, cost=sum(cost for _, cost, _ in parts), direct=direct))
    return sorted(routes, key=lambda route: route.cost)


def _route(space: FreeSpace, start: Endpoint, goal: Endpoint, wish: Wish) -> tuple[list[Leg], float, bool]:
    """The shortest way with room; where that takes effort, the cheapest of all ways; what it costs [s]; which it is.

    Effort only adds to a way's price: where the shortest one takes none, no other is cheaper. Where the goal is so much
    higher or lower than the start that it takes effort, the cheapest one is looked for at once: it is among all ways.
    """
    price, ways = prices(space.agent, wish.prefer), wish.ways
    climb = abs(goal.floor - start.floor) * price[SLOPED] / (SPARED * price[LENGTH])
    if ways is not None and climb > hypot(*(goal.xy - start.xy).tolist()) and wish.left() > 0.0:
        legs, takes = _cheapest(ways, wish.prefer, start, goal)
        if legs:
            return legs, float(takes @ price), False
        ways = None
    direct, takes, by_step = _shortest(space, start, goal, wish.prefer)
    seconds = (takes * price).tolist()
    cost = sum(seconds)
    if ways is None or wish.left() <= 0.0 or not (by_step or _is_effort(seconds, wish.prefer)):
        return direct, cost, True
    legs, takes = _cheapest(ways, wish.prefer, start, goal)
    other = float(takes @ price) if legs else np.inf
    return (legs, other, False) if other < cost else (direct, cost, False)


def _cheapest(
    ways: Callable[..., Ways], prefer: Prefer, start: Endpoint, goal: Endpoint
) -> tuple[list[Leg], FloatArray]:
    """The cheapest of all ways, pulled, and what it takes (6,); no legs where there is none."""
    return pull_all(find_cheapest(ways(prefer), start, goal), prefer)


def _is_effort(seconds: list[float], prefer: Prefer) -> bool:
    """Whether a way takes more than its length and what room beside it asks for, by the seconds that each costs."""
    if prefer == Prefer.WIDE and seconds[TIGHT] > 0.0:
        return True
    return seconds[UNSEEN] + seconds[SLOPED] + seconds[STEPPED] + seconds[LEDGE] > SPARED * seconds[LENGTH]


def steps_of(legs: list[Leg]) -> tuple[float, float]:
    """Rise and fall of a way in steps, and in high ones [m]."""
    stepped, high = 0.0, 0.0
    for level, path, space in legs:
        more, higher = way_steps(path, here(space, level))
        stepped, high = stepped + more, high + higher
    return stepped, high


def is_as_level(legs: list[Leg], others: list[Leg], more: float) -> bool:
    """Whether a way takes no steps, or those of another one and at most so much more rise and fall [m]."""
    stepped, high = steps_of(legs)
    if stepped == high == 0.0:
        return True
    most, highest = steps_of(others)
    return stepped <= most + more and high <= highest + more


def find_cut(space: FreeSpace, stops: list[Endpoint]) -> tuple[Endpoint, Endpoint] | None:
    """The first two stops between which the graph has no way; none if all is joined."""
    component = space.graph.component
    return next(((a, b) for a, b in pairwise(stops) if component[a.node] != component[b.node]), None)


def take_up(space: FreeSpace, ends: Ends, known: FloatArray) -> Route | None:
    """A way known from before, contact points (n, 3), from the start on; none where it is not near or not clear.

    It leads to the goal that is nearest to its end. Where the ground has another height now it is not taken up, nor
    where it is longer than any that a planner gives: work on it would know no bound.
    """
    goals = [(float(np.linalg.norm(goal.xy - known[-1, :2])), n) for n, goal in enumerate(ends.goals) if goal]
    far, number = min(goals)
    goal = ends.goals[number]
    if goal is None or far > NEAR:
        return None
    here = np.array([*ends.start.xy, ends.start.floor])
    gap = np.linalg.norm(known - here, axis=1)
    first = int(gap.argmin())
    if gap[first] > NEAR:
        return None
    inner = known[first + 1 : -1]
    if np.linalg.norm(np.diff(inner[:, :2], axis=0), axis=1).sum() > space.longest:
        return None
    heights = np.stack([surface.height_at(inner[:, :2]) for surface in space.surfaces])
    off = np.abs(np.where(np.isnan(heights), np.inf, heights) - inner[:, 2])
    if len(inner) and off.min(axis=0).max() > space.levels[0].surface.cell_width:
        return None
    level = [ends.start.level, *off.argmin(axis=0).tolist(), goal.level]
    legs = _cut_by_level(space, np.vstack([ends.start.xy, inner[:, :2], goal.xy]), level)
    return Route(legs, number, warm=True) if all(map(_is_clear, legs)) else None


def _is_clear(leg: Leg) -> bool:
    obstacles, reach, radius, _ = _around(leg.space, leg.level)
    return bool(is_path_clear(leg.path, obstacles, radius_of(leg.path, obstacles, reach, radius)))


def _cut_by_level(space: FreeSpace, path: FloatArray, level: list[int]) -> list[Leg]:
    cuts = [0, *(np.flatnonzero(np.diff(level)) + 1).tolist(), len(path)]
    parts = [(level[a], path[max(a - 1, 0) : b]) for a, b in pairwise(cuts)]
    return [Leg(on, distinct(part), space) for on, part in parts if len(part) > 1]


def _shortest(space: FreeSpace, start: Endpoint, goal: Endpoint, prefer: Prefer) -> tuple[list[Leg], FloatArray, bool]:
    """Straight, where that is clear; else as A* goes through the graph, cut where the way changes level, and pulled.

    Also what the way takes, (6,), and whether it passes a step as near as the body is wide.
    """
    if start.level == goal.level:
        near, radius = space.agent.disc_radius, radius_at(space, min(start.room, goal.room))
        around = here(space, start.level, prefer)
        straight, takes, by_step = _go_straight(start.xy, goal.xy, around, radius, near)
        if len(straight):
            return [Leg(start.level, straight, space)], takes, by_step
    return over_core(space, space.core, start, goal, prefer)


def over_core(
    space: FreeSpace, core: Core, start: Endpoint, goal: Endpoint, prefer: Prefer
) -> tuple[list[Leg], FloatArray, bool]:
    """`_shortest` of the ways over a core."""
    near, ends = space.agent.disc_radius, (start.xy, goal.xy)
    around, radius = here(space, start.level, prefer), radius_at(space, min(start.room, goal.room))
    chain, path, takes, by_step = _pull_over(_net(space, core), (start.node, goal.node), ends, around, radius, near)
    if len(path):
        return [Leg(start.level, path, space)], takes, by_step
    legs = _legs(chain, *ends, (space,))
    pulled, by_step = list[Leg](), False
    for n, leg in enumerate(legs, start=1):
        radius = radius_at(space, min(start.room if n == 1 else np.inf, goal.room if n == len(legs) else np.inf))
        path, more, by = _pull(leg.path, beside(space, leg.level, prefer), radius, near)
        pulled.append(leg._replace(path=path))
        takes, by_step = takes + more, by_step or by
    return pulled, takes, by_step


def _net(space: FreeSpace, core: Core) -> Sequence[Search]:
    """A space's graph and a core of it as they are searched; the box of its own core is kept."""
    box: Sequence[Search] | None = space.boxes.get(Search) if core is space.core else None
    if box is None:
        box = boxed(search_in(space.graph, core))
        if core is space.core:
            space.boxes[Search] = box
    return box


@njit(cache=True, nogil=True)
def _go_straight(
    a: FloatArray, b: FloatArray, here: Sequence[Here], radius: float, near: float
) -> tuple[FloatArray, FloatArray, bool]:
    """The straight way from place to place, (2,), without places where it is not clear: `_looked_at`."""
    about, path = here[0].about, np.empty((2, 2))
    path[0], path[1] = a, b
    if not is_straight(a, b, about.places, radius, about.ground, make_scratch()):
        return path[:0], np.zeros(6), False
    return _looked_at(path, about, near)


class _Chain(NamedTuple):
    """Nodes one after the other: their places (n, 2) [m], levels and numbers of spaces (n,), and crossings to the next.

    There are n − 1 of these, or n where the chain leads on.
    """

    position: FloatArray
    level: IntArray
    on: IntArray
    via: FloatArray


@njit(cache=True, nogil=True)
def _pull_over(
    net: Sequence[Search],
    of: tuple[int, int],
    ends: tuple[FloatArray, FloatArray],
    here: Sequence[Here],
    radius: float,
    near: float,
) -> tuple[_Chain, FloatArray, FloatArray, bool]:
    """The way over a core from node to node; and `_pull` of it from end to end, (2,), if it is on one level."""
    search = net[0]
    (place, more_place), (on, more_on), (nodes, via) = search.place, search.level, find_nodes(search, *of)
    position, level = np.empty((len(nodes), 2)), np.empty(len(nodes), np.int64)
    for i in range(len(nodes)):
        row = nodes[i] - len(place)
        position[i] = place[nodes[i]] if row < 0 else more_place[row]
        level[i] = on[nodes[i]] if row < 0 else more_on[row]
    chain = _Chain(position, level, np.zeros(len(nodes), np.int64), via)
    places, cut = _strung(position, level, chain.on, via, ends[0], ends[1])
    if len(cut) > 0:
        return chain, places[:0], np.zeros(6), False
    path, takes, by_step = _pull(distinct(places), here[0].about, radius, near)
    return chain, path, takes, by_step


@njit(cache=True, nogil=True)
def _pull(path: FloatArray, about: Beside, radius: float, near: float) -> tuple[FloatArray, FloatArray, bool]:
    """A leg pulled straight: `_looked_at`."""
    return _looked_at(pull(path, about.places, radius, about.ground), about, near)


@njit(cache=True, nogil=True)
def _looked_at(path: FloatArray, about: Beside, near: float) -> tuple[FloatArray, FloatArray, bool]:
    """A way, (n, 2), what it takes, (6,), and whether it comes `near` a step that is noticed [m]."""
    takes = way_takes(path, about).sum(axis=0)
    return path, takes, is_near_step(path, about.ground, about.noticed, near)


def find_cheapest(ways: Ways, start: Endpoint, goal: Endpoint) -> list[Leg]:
    """The cheapest of all ways, from leaf to leaf; none where there is none."""
    (begin, ahead), (end, behind) = (_doors(ways, one) for one in (start, goal))
    graph = ways.graph
    node, edges = find_way(graph, begin, end, goal.xy, rate=ways.rate)
    if node < 0:
        return []
    nodes = np.concatenate([[node], graph.other[edges]])
    on = (nodes >= ways.first_level_node).astype(np.int64)
    first, last = _way_to(ways, start, nodes[0], begin, ahead), _way_to(ways, goal, nodes[-1], end, behind)
    middle = graph.position[nodes], graph.level[nodes], on, graph.via[edges]
    back = [part[::-1] for part in last]
    chain = _Chain(*(np.concatenate(parts) for parts in zip(first, middle, back, strict=True)))
    return _legs(chain, start.xy, goal.xy, ways.spaces)


def _doors(ways: Ways, end: Endpoint) -> tuple[Doors, IntArray]:
    """By which nodes the ways go on from an end, if it has a leaf, and by which leaf one gets to each, shape (k,).

    On level ground one goes by its own leaf; among steps by its own first, or by those of the level ground near it.
    """
    able, level = ways.spaces[0], ways.spaces[-1]
    price = prices(able.agent, ways.prefer)
    if level is not able and (own := connect(level, end.level, end.xy)) >= 0:
        leaf = np.array([own])
        node = _tops(ways, 1, leaf)
        return Doors(node, price[LENGTH] * np.linalg.norm(ways.graph.position[node] - end.xy, axis=1)), leaf
    if (own := connect(able, end.level, end.xy)) < 0:
        return Doors(np.zeros(0, np.int64), np.zeros(0)), np.zeros(0, np.int64)
    leaf = np.array([own])
    node = _tops(ways, 0, leaf)
    if level is not able:
        near = _joined_leaves(ways, end)
        node, leaf = np.append(node, _tops(ways, 1, near)), np.append(leaf, near)
    about, places = beside(able, end.level, ways.prefer), np.asarray(ways.graph.position[node], np.float64)
    return Doors(node, straight_takes(end.xy, places, about) @ price), leaf


def _tops(ways: Ways, space: int, leaves: IntArray) -> IntArray:
    """The nodes of the ways that leaves of one of their spaces lead up to."""
    return tops_of(ways.spaces[space].core, leaves) + space * ways.first_level_node


def _way_to(ways: Ways, end: Endpoint, node: int, doors: Doors, leaf: IntArray) -> _Chain:
    """What leads from an end up to a node of the ways, by the first of the doors that does."""
    door, on = int((doors.node == node).argmax()), int(node >= ways.first_level_node)
    graph = ways.spaces[on].graph
    nodes, edges = climb(graph, ways.spaces[on].core, int(leaf[door]))
    under = nodes[:-1]
    chain = _Chain(graph.position[under], graph.level[under], np.full(len(under), on), graph.via[edges])
    if door == 0:
        return chain
    # one goes to the first leaf as on steps, wherever that is
    here = end.xy[None], np.array([end.level]), np.zeros(1, np.int64), graph.position[leaf[door]][None]
    return _Chain(*(np.concatenate(parts) for parts in zip(here, chain, strict=True)))


def _joined_leaves(ways: Ways, end: Endpoint) -> IntArray:
    """Leaves of the level ground near an end that the body gets to straight: nodes of its graph, the nearest first."""
    able, level = ways.spaces
    tree = level.levels[end.level].quadtree
    leaf = tree.within(end.xy, NEAR)
    node = leaf[tree.free[leaf]] + level.levels[end.level].offset
    made: IntArray = node[_joined_among(end.xy, level.graph.position[node], *_around(able, end.level))]
    return made


@njit(cache=True, nogil=True)
def _joined_among(
    xy: FloatArray, center: FloatArray, obstacles: Places, reach: float, radius: float, ground: Cells
) -> IntArray:
    """Of places (k, 2), `MOST_DOORS` from the nearest to the furthest: rows of those that one gets to straight."""
    far, scratch, made = np.empty(len(center)), make_scratch(), np.empty(len(center), np.int64)
    for i in range(len(center)):
        far[i] = sqrt((center[i, 0] - xy[0]) ** 2 + (center[i, 1] - xy[1]) ** 2)
    radius = radius_within(distance_at(obstacles, (xy[0], xy[1], 0.0), scratch), reach, radius)
    count = 0
    for row in np.argsort(far, kind="mergesort")[:: max(1, len(center) // MOST_DOORS)]:
        if is_straight(xy, center[row], obstacles, radius, ground, scratch):
            made[count], count = row, count + 1
    return made[:count].copy()


def _legs(chain: _Chain, start: FloatArray, goal: FloatArray, spaces: tuple[FreeSpace, ...]) -> list[Leg]:
    """From the start through the places of a chain, and its crossings, to the goal.

    It is cut where the level changes, or the space that it is `on`.
    """
    level, on = chain.level, chain.on
    places, crossing = _strung(*chain, start, goal)
    if not len(crossing):
        return [Leg(int(level[0]), distinct(places), spaces[on[0]])]
    cuts = [0, *(2 * crossing + 2).tolist(), len(places) - 1]
    rows = [0, *(crossing + 1).tolist()]
    parts = [(row, distinct(places[a : b + 1])) for row, (a, b) in zip(rows, pairwise(cuts), strict=True)]
    return [Leg(int(level[row]), path, spaces[on[row]]) for row, path in parts]


@njit(cache=True, nogil=True)
def _strung(
    position: FloatArray, level: IntArray, on: IntArray, via: FloatArray, start: FloatArray, goal: FloatArray
) -> tuple[FloatArray, IntArray]:
    """From the start over a chain's places and crossings to the goal (2n + 1, 2), and after which of them it is cut."""
    places, cut, count = np.empty((2 * len(position) + 1, 2)), np.empty(len(position), np.int64), 0
    places[0], places[-1] = start, goal
    for i in range(len(position)):
        places[2 * i + 1] = position[i]
        if i < len(position) - 1:
            places[2 * i + 2] = via[i]
            if level[i] != level[i + 1] or on[i] != on[i + 1]:
                cut[count], count = i, count + 1
    return places, cut[:count].copy()


def _around(space: FreeSpace, level: int) -> tuple[Places, float, float, Cells]:
    """What ways on a level are pulled between."""
    own = space.levels[level]
    return own.places, space.reach, space.radius, own.surface.arrays


def pull_all(legs: list[Leg], prefer: Prefer, *, between: bool = False) -> tuple[list[Leg], FloatArray]:
    """`pull_cheaply` of each leg, and what the way takes, shape (6,)."""
    pulled = [pull_cheaply(leg, prefer, between=between) for leg in legs]
    return [leg for leg, _ in pulled], sum((takes for _, takes in pulled), np.zeros(6))


def pull_cheaply(leg: Leg, prefer: Prefer, *, between: bool = False) -> tuple[Leg, FloatArray]:
    """A leg pulled straight, in ever smaller pieces until that takes no more effort than the leg did.

    It stays `between` what it goes between, if that is asked for. Also what it takes, shape (6,).
    """
    price = prices(leg.space.agent, prefer)
    if prefer != Prefer.WIDE:
        price[TIGHT] = 0.0  # the optimiser makes room where there is some
    path, takes = _pull_cheaply(leg.path, here(leg.space, leg.level, prefer), leg.space.radius, price, between)
    return leg._replace(path=path), takes


@njit(cache=True, nogil=True)
def _pull_cheaply(
    path: FloatArray, here: Sequence[Here], radius: float, price: FloatArray, between: bool
) -> tuple[FloatArray, FloatArray]:
    """See `pull_cheaply`; what the leg takes is told where it is asked for, first what is soon told."""
    about = here[0].about
    places, ground = about.places, about.ground
    rest, made, rows, takes = [(0, len(path) - 1)], [path], 0, np.zeros(6)
    least = spent = np.zeros(0)
    while len(rest) > 0:
        first, last = rest.pop()
        piece = path[first : last + 1]
        room = radius_of(piece, places, about.reach, radius)
        tight = piece[tighten(piece, places, room, ground)] if between else pull(piece, places, room, ground)
        taken = way_takes(tight, about)
        most, done = _costs(taken, price)[-1] / PULLED, last - first < 2
        if not done:
            least = _costs(least_takes(path, about), price) if len(least) == 0 else least
            done = most <= least[last] - least[first]
        if not done:
            spent = _costs(way_takes(path, about), price) if len(spent) == 0 else spent
            done = most <= spent[last] - spent[first]
        if done:
            made.append(tight)
            rows += len(tight)
            takes += taken.sum(axis=0)
        else:
            middle = (first + last + 1) // 2
            rest.append((middle, last))
            rest.append((first, middle))
    if len(made) == 2:
        return made[1], takes
    whole, row = np.empty((rows, 2)), 0
    for k in range(1, len(made)):
        whole[row : row + len(made[k])] = made[k]
        row += len(made[k])
    return distinct(whole), takes


@njit(cache=True, nogil=True)
def _costs(takes: FloatArray, price: FloatArray) -> FloatArray:
    """What a way costs up to each of its places, (n,) [s], from what its segments take, (n − 1, 6)."""
    made = np.zeros(len(takes) + 1)
    for i in range(len(takes)):
        made[i + 1] = made[i]
        for k in range(len(price)):
            made[i + 1] += takes[i, k] * price[k]
    return made

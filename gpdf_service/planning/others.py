"""More ways than the best one: a rival, which may be the cheaper one when it is bent; others, for who would choose."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
from math import hypot, sqrt

import numpy as np
from numba import njit
from scipy.spatial import cKDTree

from gpdf_service.fields.tree import make_scratch
from gpdf_service.kernel_cache import lean
from gpdf_service.planning.endpoints import Ends
from gpdf_service.planning.routes import Leg, Route, Wish, find_cheapest, over_core, pull_all, steps_of
from gpdf_service.planning.shape import is_straight, resample, subdivide
from gpdf_service.search.free_space import NOTICED_STEP, FreeSpace
from gpdf_service.search.graph import Graph
from gpdf_service.search.ways import Prefer, Ways, prices
from gpdf_service.types import FloatArray, IntArray

TRIES = 8
"""Searches with what is known avoided: some find a way that is known already, a little aside."""
WORTH = 3.0
"""[-] A way that costs as much more than the best is none to choose."""
BETWEEN = 0.05
"""[m] What is as near to the line between two ways stands between them."""
STOREY = 0.5
"""[m] Ways that are higher or lower than each other by this much are two."""
STRIDE = 0.25
"""[m] Along a way, for what lies between it and another one."""
AVOIDED = 2.0
"""[-] Where a way is known already, the next search finds it as much dearer, each time again."""
DETOUR = 1.06
"""[-] A way that is no longer than so many straight lines to its goal is taken: another one costs its time to plan. Of
2,160 pairs 98 with a shorter one had a rival, and 8 of these were cheaper, by 4 % at most; of the next 32 also 8. Six
of 597 pairs get a way that an alternative undercuts: three are shorter than this (1.5 to 4.5 %), three are the same
way bent from another seed (0.1 to 0.7 %)."""
RIVAL = 1.15
"""[-] A seed that costs as much more than another one may yet be the cheaper one when both are bent: of 99 rivals up to
here 47 were, of 73 beyond, up to half as much again, none."""


def find_rival(space: FreeSpace, ends: Ends, wish: Wish, best: Route) -> Route | None:
    """The next best way of the graph that is another one, if it may be the cheaper one when it is bent; or none.

    A graph leads from leaf to leaf, so to some percent it does not tell which of two ways is the cheaper one when they
    are pulled straight. A way that is hardly longer than the straight line has no rival, and neither has one that
    takes effort: it is the cheapest of all ways, which are priced.
    """
    goal = ends.goals[best.goal]
    if goal is None or ends.via or space.agent.discs > 1 or not best.direct:
        return None
    if best.length <= DETOUR * hypot(*(goal.xy - ends.start.xy).tolist()) or wish.left() <= 0.0:
        return None
    price, width = prices(space.agent, wish.prefer), 2.0 * space.agent.disc_radius
    core = space.core._replace(graph=avoiding(space.core.graph, best.legs, width))
    legs, takes, _ = over_core(space, core, ends.start, goal, wish.prefer)
    cost = float(takes @ price)
    if cost > RIVAL * best.cost or not _are_apart(legs, best.legs, 0.5 * width):
        return None
    return Route(legs, best.goal, cost=cost)


def avoiding(graph: Graph, legs: list[Leg], width: float, half_size: FloatArray | None = None) -> Graph:
    """A graph of what stands whose ways are dearer within a `width` [m] of the way of these legs.

    That is from a node's leaf, if half of the width of each is given, (n,) [m]; else from its place.
    """
    far = np.full(len(graph.position), width) + (0.0 if half_size is None else half_size)
    dearer = np.ones(len(far))
    for leg in legs:
        _mark(graph.position, graph.level, far, leg.level, _plan(leg.path), dearer)
    return graph._replace(cost=_dearer(graph.first, graph.other, graph.cost, dearer))


@njit(cache=True, nogil=True)
def _mark(
    position: FloatArray, level: IntArray, far: FloatArray, on: int, path: FloatArray, dearer: FloatArray
) -> None:
    """Make nodes that are less than so `far` [m] from a path on a level dearer: `AVOIDED`."""
    for n in range(len(position)):
        if level[n] == on and _far_from(path, position[n, 0], position[n, 1], far[n]) < far[n]:
            dearer[n] *= AVOIDED


@lean()
def _far_from(path: FloatArray, x: float, y: float, limit: float) -> float:
    """Distance from a place to a path in plan, (n, 2) [m]; where it is more than the `limit`, that may be told."""
    least2 = limit * limit
    for i in range(len(path) - 1):
        ax, ay, bx, by = path[i, 0], path[i, 1], path[i + 1, 0], path[i + 1, 1]
        apart_x, apart_y = max(min(ax, bx) - x, x - max(ax, bx)), max(min(ay, by) - y, y - max(ay, by))
        if apart_x > limit or apart_y > limit:
            continue
        dx, dy = bx - ax, by - ay
        length2 = dx * dx + dy * dy
        share = min(max(((x - ax) * dx + (y - ay) * dy) / length2, 0.0), 1.0) if length2 > 0.0 else 0.0
        least2 = min(least2, (x - ax - share * dx) ** 2 + (y - ay - share * dy) ** 2)
    return sqrt(least2)


@njit(cache=True, nogil=True)
def _dearer(first: IntArray, other: IntArray, cost: FloatArray, dearer: FloatArray) -> FloatArray:
    """What edges cost between nodes that are so much dearer, (k,)."""
    made = cost.copy()
    for n in range(len(dearer)):
        for e in range(first[n], first[n + 1]):
            if dearer[n] > 1.0 or dearer[other[e]] > 1.0:
                made[e] *= sqrt(dearer[n] * dearer[other[e]])
    return made


def _are_apart(legs: list[Leg], others: list[Leg], width: float) -> bool:
    """Whether a way comes anywhere as far as a `width` [m] from another one on the same level, or is on another one."""
    for leg in legs:
        beside_it = [other.path for other in others if other.level == leg.level]
        if not beside_it or _is_apart(leg.path, np.concatenate(beside_it), width):
            return True
    return False


@njit(cache=True, nogil=True)
def _is_apart(path: FloatArray, other: FloatArray, width: float) -> bool:
    places = subdivide(path, width)
    for i in range(len(places)):  # noqa: SIM110 - compiled
        if _far_from(other, places[i, 0], places[i, 1], width) >= width:
            return True
    return False


def find_others(space: FreeSpace, ends: Ends, wish: Wish, best: Route) -> Iterator[Route]:
    """Ways that differ from the best one and from each other, the cheapest first, then those that others prefer.

    Two ways are the same if one can be moved over into the other: nothing stands between them, and they take as many
    steps.
    """
    known = [best]
    for found in _aside(wish.ways, ends, wish, best) if wish.ways is not None else ():
        if not any(_is_same(space, found, other) for other in known):
            known.append(found)
            yield found


def _aside(ways: Callable[..., Ways], ends: Ends, wish: Wish, best: Route) -> Iterator[Route]:
    """The cheapest way that avoids those before it, as long as that is worth it; then those that others prefer."""
    own, seen = ways(wish.prefer), list(best.legs)
    width, half_size = 2.0 * own.spaces[0].agent.disc_radius, own.half_size
    for _ in range(TRIES):
        dearer = replace(own, graph=avoiding(own.graph, seen, width, half_size))
        raw = _find(dearer, ends, best.goal)
        found = _pulled(raw, wish, best.goal)
        if found.cost > WORTH * best.cost:
            break
        seen += [*raw, *found.legs]
        yield found
    for prefer in Prefer:
        yield _pulled(_find(ways(prefer), ends, best.goal), wish, best.goal)


def _find(ways: Ways, ends: Ends, number: int) -> list[Leg]:
    """The cheapest of these ways to a goal, through the via points, from leaf to leaf."""
    goal = ends.goals[number]
    assert goal is not None
    return [leg for a, b in pairwise([ends.start, *ends.via, goal]) for leg in find_cheapest(ways, a, b)]


def _pulled(legs: list[Leg], wish: Wish, number: int) -> Route:
    legs, takes = pull_all(legs, wish.prefer, between=True)
    return Route(legs, number, cost=float(takes @ prices(legs[0].space.agent, wish.prefer)))


def _plan(path: FloatArray) -> FloatArray:
    return np.ascontiguousarray(path[:, :2])


def _is_same(space: FreeSpace, one: Route, other: Route) -> bool:
    """Whether one way can be moved over into the other, see `find_others`."""
    if abs(steps_of(one.legs)[0] - steps_of(other.legs)[0]) > NOTICED_STEP:
        return False
    ours, theirs = _places(space, one), _places(space, other)
    nearest, scratch = cKDTree(theirs[:, :2]).query(ours[:, :2])[1], make_scratch()
    for here, there in zip(ours, theirs[nearest], strict=True):
        own = space.levels[int(here[3])]
        parts = own.places, BETWEEN, own.surface.arrays, scratch
        if abs(here[2] - there[2]) > STOREY or not is_straight(here[:2], there[:2], *parts):
            return False
    return True


def _places(space: FreeSpace, route: Route) -> FloatArray:
    """Places of a way: x, y, z of the ground [m], level; shape (n, 4)."""
    made = []
    for leg in route.legs:
        xy = resample(_plan(leg.path), STRIDE)
        made.append(np.column_stack([xy, space.levels[leg.level].surface.height_at(xy), np.full(len(xy), leg.level)]))
    return np.concatenate(made)

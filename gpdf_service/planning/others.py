"""More ways than the best one: those that differ from it, for somebody who would rather choose."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree

from gpdf_service.fields.tree import make_scratch
from gpdf_service.planning.endpoints import Ends
from gpdf_service.planning.routes import Leg, Route, Wish, avoiding, find_cheapest, pull_all, way_takes_of
from gpdf_service.planning.shape import is_straight, resample
from gpdf_service.search.free_space import NOTICED_STEP, FreeSpace
from gpdf_service.search.ways import STEPPED, Prefer, Ways, prices
from gpdf_service.types import FloatArray

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


def find_others(space: FreeSpace, ends: Ends, wish: Wish, best: Route) -> Iterator[Route]:
    """Ways that differ from the best one and from each other, the cheapest first, then those that others prefer.

    Two ways are the same if one can be moved over into the other: nothing stands between them, and they take as many
    steps.
    """
    if wish.ways is None:
        return
    known, seen = [best], list(best.legs)
    own = wish.ways(wish.prefer)
    for _ in range(TRIES):
        raw = _find(_avoiding(own, seen), ends, best.goal)
        found = _pulled(raw, wish, best.goal)
        if found.cost > WORTH * best.cost:
            break
        seen += [*raw, *found.legs]
        if not any(_is_same(space, found, other) for other in known):
            known.append(found)
            yield found
    for prefer in Prefer:
        found = _pulled(_find(wish.ways(prefer), ends, best.goal), wish, best.goal)
        if not any(_is_same(space, found, other) for other in known):
            known.append(found)
            yield found


def _find(ways: Ways, ends: Ends, number: int) -> list[Leg]:
    """The cheapest of these ways to a goal, through the via points, from leaf to leaf."""
    goal = ends.goals[number]
    assert goal is not None
    return [leg for a, b in pairwise([ends.start, *ends.via, goal]) for leg in find_cheapest(ways, a, b)]


def _pulled(legs: list[Leg], wish: Wish, number: int) -> Route:
    legs, takes = pull_all(legs, wish.prefer, between=True)
    return Route(legs, number, cost=float(takes @ prices(legs[0].space.agent, wish.prefer)))


def _avoiding(ways: Ways, seen: list[Leg]) -> Ways:
    """The same ways, dearer where they are within the body's width of those that were seen."""
    width = 2.0 * ways.spaces[0].agent.disc_radius
    return replace(ways, graph=avoiding(ways.graph, seen, width, ways.half_size))


def _plan(path: FloatArray) -> FloatArray:
    return np.ascontiguousarray(path[:, :2])


def _is_same(space: FreeSpace, one: Route, other: Route) -> bool:
    """Whether one way can be moved over into the other, see `find_others`."""
    stepped = [way_takes_of([leg._replace(path=_plan(leg.path)) for leg in way.legs])[STEPPED] for way in (one, other)]
    if abs(stepped[0] - stepped[1]) > NOTICED_STEP:
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

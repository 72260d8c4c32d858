"""Pieces of a path on one level after another, pulled and bent so that it has no corner where they meet.

Levels hold the same ground around their portals. So a piece is bent as far into the next one as its own level holds the
ground there, and cut in the middle of what both hold; the next one is bent from there on. So each place is bent with
what comes after it, as if there were one level (Schwarz 1870: domains that overlap, one after another).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numba import njit

from gpdf_service.fields.tree import make_scratch
from gpdf_service.planning.chomp import ChompResult
from gpdf_service.planning.routes import Leg, is_as_level
from gpdf_service.planning.shape import distinct, is_straight, subdivide
from gpdf_service.search.ways import Here, here
from gpdf_service.tiles.surface import height_of
from gpdf_service.types import FloatArray

Bent = tuple[Leg, ChompResult | None]
"""A piece of the path after the optimiser, and what that says of it."""
Meet = Callable[[Leg, Leg], bool]
"""Whether two pieces, one after the other, meet at a portal, and may as well meet elsewhere."""

PULLS = 2
"""Rounds over all portals: a piece between two of them moves at one end and then at the other."""
SAME_GROUND = 0.01
"""[m] Ground of two levels that differs by no more is the same: it is no step for any body."""


def pull_over(legs: list[Leg], meet: Meet, spacing: float) -> list[Leg]:
    """A way whose corners at portals are gone where the straight way past them is clear and takes no more steps.

    The ground is looked at in places with such a `spacing` [m].
    """
    pulled = list(legs)
    for i in [*range(len(legs) - 1)] * PULLS:
        one, other = pulled[i], pulled[i + 1]
        straight = _straight_over(one, other, spacing) if meet(one, other) else []
        pulled[i : i + 2] = straight or [one, other]
    return pulled


def bend_over(
    groups: list[list[Leg]], meet: Meet, spacing: float, bend: Callable[[list[Leg]], list[Bent]]
) -> list[Bent]:
    """A way bent over its portals; then what lies around each of them once more, as both ends of that lie well now.

    A group are pieces that may be bent as one: that makes `bend`, from the same place to the same place, of places with
    such a `spacing` [m].
    """
    made, (pieces, *others) = list[Bent](), groups
    for after in others:
        rest = after[0]
        if meet(pieces[-1], rest):
            longer, rest = _go_on(pieces[-1], rest, spacing)
            made += bend([*pieces[:-1], longer])
            made[-1], rest = _part(made[-1], rest)
        else:
            made += bend(pieces)
        pieces = [rest, *after[1:]]
    made += bend(pieces)
    for i in range(len(made) - 1):
        if meet(made[i][0], made[i + 1][0]):
            _round_off(made, i, spacing, bend)
    return made


def _round_off(made: list[Bent], i: int, spacing: float, bend: Callable[[list[Leg]], list[Bent]]) -> None:
    """Bend the end of a piece, and as much of the next one as its level holds, once more."""
    (one, run), (other, next_run) = made[i : i + 2]
    longer, rest = _go_on(one, other, spacing)
    first = 2 * len(one.path) - len(longer.path) - 1  # as far back as it goes on
    if first < 0 or len(longer.path) == len(one.path):
        return
    around, rest = _part(bend([longer._replace(path=longer.path[first:])])[0], rest)
    path = np.concatenate([one.path[:first], around[0].path])
    made[i : i + 2] = (one._replace(path=path), run), (rest, next_run)


def _straight_over(one: Leg, other: Leg, spacing: float) -> list[Leg]:
    """Two pieces that meet on the straight line from the corner before to the one after.

    Nothing if that is not clear, or takes more steps.
    """
    space, line = one.space, subdivide(np.stack([one.path[-2], other.path[1]]), spacing)
    at = _crossing(line, here(space, one.level), here(space, other.level), space.radius)
    if at < 0:
        return []
    straight, rest = one.path.copy(), other.path.copy()
    straight[-1] = rest[0] = line[at]
    legs = [one._replace(path=straight), other._replace(path=rest)]
    return legs if is_as_level(legs, [one, other], SAME_GROUND) else []


@njit(cache=True, nogil=True)
def _crossing(line: FloatArray, own: Sequence[Here], other: Sequence[Here], radius: float) -> int:
    """The row in the middle of those to which a straight way is clear on one level, and from which it is on the other.

    It is none of the ends; -1 where there is none, or the grounds differ there.
    """
    one, beyond, last, first, scratch = own[0].about, other[0].about, 0, len(line) - 1, make_scratch()
    places, ground, places_beyond, ground_beyond = one.places, one.ground, beyond.places, beyond.ground
    while last < len(line) - 1 and is_straight(line[last], line[last + 1], places, radius, ground, scratch):
        last += 1
    while first > 0 and is_straight(line[first - 1], line[first], places_beyond, radius, ground_beyond, scratch):
        first -= 1
    row = (max(first, 1) + min(last, len(line) - 2)) // 2
    if not (first <= row <= last and 0 < row < len(line) - 1):
        return -1
    x, y = line[row, 0], line[row, 1]
    return row if abs(height_of(ground, x, y) - height_of(ground_beyond, x, y)) <= SAME_GROUND else -1


def _go_on(leg: Leg, after: Leg, spacing: float) -> tuple[Leg, Leg]:
    """A piece that goes on into the next one as far as its level holds the ground there, and that from there on."""
    ahead = subdivide(after.path, spacing)
    last = max(min(_count_held(ahead, after, leg.level), len(ahead) - 1) - 1, 0)
    long = distinct(np.concatenate([leg.path, ahead[1 : last + 1]]))
    return leg._replace(path=long), after._replace(path=ahead[last:])


def _part(bent: Bent, after: Leg) -> tuple[Bent, Leg]:
    """A bent piece up to the middle of its end that both levels hold, and the next one with its rest before it."""
    (leg, run), path = bent, bent[0].path
    held = _count_held(np.ascontiguousarray(path[::-1]), leg, after.level)
    cut = len(path) - 1 - max(held - 1, 0) // 2
    rest = distinct(np.concatenate([path[cut:], after.path[1:]]))
    return (leg._replace(path=path[: cut + 1]), run), after._replace(path=rest)


def _count_held(path: FloatArray, leg: Leg, level: int) -> int:
    """How many rows of a path (n, 2) on the level of a piece, from the first one on, another `level` holds, too.

    The ground is known there and as high, and the way from row to row is clear by the body's radius.
    """
    held: int = _count_on_both(path, here(leg.space, leg.level), here(leg.space, level), leg.space.radius)
    return held


@njit(cache=True, nogil=True)
def _count_on_both(path: FloatArray, here: Sequence[Here], beyond: Sequence[Here], radius: float) -> int:
    own, other, obstacles = here[0].about.ground, beyond[0].about.ground, beyond[0].about.places
    scratch = make_scratch()
    for i in range(len(path)):
        x, y = path[i, 0], path[i, 1]
        if not abs(height_of(own, x, y) - height_of(other, x, y)) <= SAME_GROUND:  # a NaN compares false
            return i
        if i > 0 and not is_straight(path[i - 1], path[i], obstacles, radius, other, scratch):
            return i
    return len(path)

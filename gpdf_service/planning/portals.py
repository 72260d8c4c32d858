"""Pieces of a path on one level after another, pulled and bent so that it has no corner where they meet.

Levels hold the same ground around their portals. So a piece is bent as far into the next one as its own level holds the
ground there, and cut in the middle of what both hold; the next one is bent from there on. So each place is bent with
what comes after it, as if there were one level (Schwarz 1870: domains that overlap, one after another).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numba import njit

from gpdf_service.fields.tree import Scratch, make_scratch
from gpdf_service.kernel_cache import lean
from gpdf_service.planning.chomp import ChompResult
from gpdf_service.planning.routes import Leg
from gpdf_service.planning.shape import distinct, is_straight, subdivide
from gpdf_service.search.places import Places
from gpdf_service.search.ways import Here, here, way_steps
from gpdf_service.tiles.surface import Cells, height_of
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

    Args:
        legs: Of the way.
        meet: Which of them meet at a portal.
        spacing: Between places where the ground is looked at [m].
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

    Args:
        groups: Pieces of the way, those together that may be bent as one.
        meet: Which of them meet at a portal.
        spacing: Between places of a bent path [m].
        bend: Makes bent paths of pieces that may be bent as one, from the same place to the same place.
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
    space = one.space
    grounds = here(space, one.level), here(space, other.level), here(other.space, other.level)
    paths = _pass_over(one.path, other.path, *grounds, (spacing, space.radius))
    return [leg._replace(path=path) for leg, path in zip((one, other), paths, strict=True) if len(path)]


@njit(cache=True, nogil=True)
def _pass_over(
    path: FloatArray,
    after: FloatArray,
    here: Sequence[Here],
    there: Sequence[Here],
    beyond: Sequence[Here],
    measures: tuple[float, float],
) -> tuple[FloatArray, FloatArray]:
    """See `_straight_over`; no places if there is no such line.

    Both levels are given as the first piece's space has them, and the second one as its own space sees steps there: box
    by box, for Numba takes long to tell what a tuple of boxes is. The measures are spacing and radius [m].
    """
    one, other, steps, (spacing, radius) = here[0].about, there[0].about, beyond[0].about, measures
    line = np.empty((2, 2))
    line[0], line[1] = path[-2], after[1]
    line = subdivide(line, spacing)
    at = _crossing(line, one.ground, other.ground, one.places, other.places, radius)
    if at < 0:
        return path[:0], after[:0]
    straight, rest = path.copy(), after.copy()
    straight[-1], rest[0] = line[at], line[at]
    for k in range(2):
        taken = way_steps(straight, one)[k] + way_steps(rest, steps)[k]
        if taken > way_steps(path, one)[k] + way_steps(after, steps)[k] + SAME_GROUND:
            return path[:0], after[:0]
    return straight, rest


@njit(cache=True, nogil=True)
def _crossing(line: FloatArray, ground: Cells, other: Cells, obstacles: Places, beyond: Places, radius: float) -> int:
    """The row in the middle of those to which a straight way is clear on one ground, and from which it is on the other.

    It is none of the ends; -1 where there is none, or the grounds differ there.
    """
    last, first, scratch = 0, len(line) - 1, make_scratch()
    while last < len(line) - 1 and is_straight(line[last], line[last + 1], obstacles, radius, ground, scratch):
        last += 1
    while first > 0 and is_straight(line[first - 1], line[first], beyond, radius, other, scratch):
        first -= 1
    row = (max(first, 1) + min(last, len(line) - 2)) // 2
    if not (first <= row <= last and 0 < row < len(line) - 1):
        return -1
    x, y = line[row, 0], line[row, 1]
    return row if abs(height_of(ground, x, y) - height_of(other, x, y)) <= SAME_GROUND else -1


def _go_on(leg: Leg, after: Leg, spacing: float) -> tuple[Leg, Leg]:
    """A piece that goes on into the next one as far as its level holds the ground there, and that from there on."""
    space = after.space
    own, other = here(space, after.level), here(space, leg.level)
    long, rest = _longer(leg.path, after.path, own, other, spacing, space.radius)
    return leg._replace(path=long), after._replace(path=rest)


@njit(cache=True, nogil=True)
def _longer(
    path: FloatArray, after: FloatArray, own: Sequence[Here], other: Sequence[Here], spacing: float, radius: float
) -> tuple[FloatArray, FloatArray]:
    """See `_go_on`: the next piece is on its `own` level, the one that goes on is on the `other` one."""
    ahead = subdivide(after, spacing)
    last = max(min(_count_held(ahead, own, other, radius), len(ahead) - 1) - 1, 0)
    return distinct(np.concatenate((path, ahead[1 : last + 1]))), ahead[last:]


def _part(bent: Bent, after: Leg) -> tuple[Bent, Leg]:
    """A bent piece up to the middle of its end that both levels hold, and the next one with its rest before it."""
    leg, run = bent
    space = leg.space
    path, rest = _cut(leg.path, after.path, here(space, leg.level), here(space, after.level), space.radius)
    return (leg._replace(path=path), run), after._replace(path=rest)


@njit(cache=True, nogil=True)
def _cut(
    path: FloatArray, after: FloatArray, own: Sequence[Here], other: Sequence[Here], radius: float
) -> tuple[FloatArray, FloatArray]:
    """See `_part`: the bent piece is on its `own` level, the next one is on the `other` one."""
    back = np.ascontiguousarray(path[::-1])
    cut = len(path) - 1 - max(_count_held(back, own, other, radius) - 1, 0) // 2
    return path[: cut + 1], distinct(np.concatenate((path[cut:], after[1:])))


@njit(cache=True, nogil=True)
def _count_held(path: FloatArray, own: Sequence[Here], other: Sequence[Here], radius: float) -> int:
    """How many rows of a path (n, 2) on its `own` level, from the first one on, the `other` one holds, too.

    The ground is known there and as high, and the way from row to row is clear by the body's radius.
    """
    beyond = other[0].about
    return _count_on_both(path, own[0].about.ground, beyond.ground, beyond.places, radius, make_scratch())


@lean()
def _count_on_both(
    path: FloatArray, own: Cells, other: Cells, obstacles: Places, radius: float, scratch: Scratch
) -> int:
    for i in range(len(path)):
        x, y = path[i, 0], path[i, 1]
        if not abs(height_of(own, x, y) - height_of(other, x, y)) <= SAME_GROUND:  # a NaN compares false
            return i
        if i > 0 and not is_straight(path[i - 1], path[i], obstacles, radius, other, scratch):
            return i
    return len(path)

"""A path over two levels has no corner where they meet: here one floor, of which each level holds a part."""

from dataclasses import replace

import numpy as np
import pytest

import gpdf_service as gpdf
from gpdf_service.planning.portals import bend_over, pull_over
from gpdf_service.planning.routes import Leg
from gpdf_service.planning.shape import lengths, resample
from gpdf_service.synthetic import Box, World
from gpdf_service.tiles.surface import UNKNOWN

SPACING = 0.05
HELD = 2.0, 3.0
"""[m] Between these x both levels hold the floor."""


@pytest.fixture(scope="module")
def space():
    """A room of 5 × 4 m with a column, and its floor as two levels."""
    points, ground = World((5.0, 4.0, 2.6), (Box((2.3, 0.0, 0.0), (2.7, 1.0, 1.5)),)).sample(
        0.06, np.random.default_rng(0)
    )
    whole = gpdf.build_scene(points, ground).free_space("human")
    surface = whole.levels[0].surface
    x = surface.origin[0] + (np.arange(surface.height.shape[0]) + 0.5) * surface.cell_width

    def only(kept):
        height, state = surface.height.copy(), surface.state.copy()
        height[~kept], state[~kept] = np.nan, UNKNOWN
        return replace(surface, height=height, state=state)

    surfaces = only(x < HELD[1]), only(x > HELD[0])
    return replace(whole, levels=tuple(replace(whole.levels[0], surface=one) for one in surfaces))


def legs_of(space, *paths):
    return [Leg(i, np.array(path, dtype=float), space) for i, path in enumerate(paths)]


def meet(one, other):
    return one.level != other.level


def straight(pieces):
    """Bent paths that are as straight as can be."""
    return [(leg._replace(path=resample(leg.path[[0, -1]], SPACING)), None) for leg in pieces]


def corner_at(one, other):
    """How far the way turns where two pieces meet [deg]."""
    ahead = [np.arctan2(*(path[1] - path[0])[::-1]) for path in (one.path[-2:], other.path[:2])]
    return np.degrees(abs((ahead[1] - ahead[0] + np.pi) % (2.0 * np.pi) - np.pi))


def test_a_corner_at_a_portal_is_pulled_straight_where_that_is_clear(space):
    bowed = legs_of(space, [(0.6, 2.0), (2.5, 2.9)], [(2.5, 2.9), (4.4, 2.0)])
    one, other = pull_over(bowed, meet, SPACING)
    np.testing.assert_array_equal(one.path[-1], other.path[0])
    assert HELD[0] < one.path[-1, 0] < HELD[1]
    np.testing.assert_allclose(np.concatenate([one.path, other.path])[:, 1], 2.0, atol=1e-9)


@pytest.mark.parametrize("y", [0.6, 1.1])
def test_a_corner_round_a_column_stays(space, y):
    bowed = legs_of(space, [(0.6, y), (2.5, 1.6)], [(2.5, 1.6), (4.4, y)])
    assert pull_over(bowed, meet, SPACING) == bowed


def test_a_corner_that_the_way_must_lead_over_stays(space):
    bowed = legs_of(space, [(0.6, 2.0), (2.5, 2.9)], [(2.5, 2.9), (4.4, 2.0)])
    assert pull_over(bowed, lambda *_: False, SPACING) == bowed


def test_pieces_are_bent_over_a_portal_and_their_corner_is_gone(space):
    bowed = legs_of(space, [(0.6, 2.0), (2.5, 2.9)], [(2.5, 2.9), (4.4, 2.0)])
    assert corner_at(*bowed) > 50.0
    (one, _), (other, _) = bend_over([[leg] for leg in bowed], meet, SPACING, straight)
    np.testing.assert_array_equal(one.path[-1], other.path[0])
    assert HELD[0] < one.path[-1, 0] < HELD[1]
    assert corner_at(one, other) < 15.0
    np.testing.assert_allclose([one.path[0], other.path[-1]], [(0.6, 2.0), (4.4, 2.0)])
    assert lengths(one.path)[-1] + lengths(other.path)[-1] < sum(lengths(leg.path)[-1] for leg in bowed)


def test_pieces_that_do_not_meet_at_a_portal_are_bent_each_by_itself(space):
    bowed = legs_of(space, [(0.6, 2.0), (2.5, 2.9)], [(2.5, 2.9), (4.4, 2.0)])
    made = bend_over([[leg] for leg in bowed], lambda *_: False, SPACING, straight)
    for (bent, _), leg in zip(made, bowed, strict=True):
        np.testing.assert_allclose(bent.path[[0, -1]], leg.path)


def test_where_the_levels_hold_no_same_ground_the_pieces_meet_where_they_met(space):
    lower, upper = space.levels
    deeper = replace(lower.surface, height=lower.surface.height - 0.5)
    apart = replace(space, levels=(replace(lower, surface=deeper), upper))
    bowed = legs_of(apart, [(0.6, 2.0), (2.5, 2.9)], [(2.5, 2.9), (4.4, 2.0)])
    assert pull_over(bowed, meet, SPACING) == bowed
    (one, _), (other, _) = bend_over([[leg] for leg in bowed], meet, SPACING, straight)
    np.testing.assert_allclose([one.path[-1], other.path[0]], [(2.5, 2.9), (2.5, 2.9)])

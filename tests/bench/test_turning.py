from dataclasses import replace

import numpy as np
import pytest

from gpdf_service.bench.turning import BrutePoses
from gpdf_service.synthetic import Box, World
from gpdf_service.types import AGENTS

pytestmark = pytest.mark.slow
SPOT = replace(AGENTS["spot"], discs=6)


def brute_of(world):
    return BrutePoses(*world.sample(0.03, np.random.default_rng(0)), SPOT)


def corner(width):
    """A corridor around a corner."""
    return World((5.0, 5.0, 1.2), (Box((0.0, width, 0.0), (5.0 - width, 5.0, 1.2)),))


@pytest.mark.parametrize(("width", "turns"), [(1.0, True), (0.5, False)])
def test_a_corner_is_turned_exactly_when_the_length_gets_round(width, turns):
    brute = brute_of(corner(width))
    start, goal = np.array([1.0, width / 2]), np.array([5.0 - width / 2, 4.0])
    assert brute.solves(start, goal) == turns
    assert brute.solves(start, np.array([2.0, width / 2]))


def test_a_place_where_it_stands_in_no_direction_or_that_is_no_place_is_not_solved():
    brute = brute_of(corner(1.0))
    assert not brute.solves(np.array([0.05, 0.5]), np.array([2.0, 0.5]))
    assert not brute.solves(np.array([-3.0, 0.5]), np.array([2.0, 0.5]))

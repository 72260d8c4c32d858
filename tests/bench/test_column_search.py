"""The search over columns that says which places of a cloud of voxels are joined."""

from dataclasses import replace

import numpy as np
import pytest

from gpdf_service.bench.columns import ColumnSearch
from gpdf_service.types import AGENTS

BODY = replace(AGENTS["human"], max_step=0.3, max_slope=0.4)
CELL = 0.2


def plate(x, y, z):
    """Voxels over x and y (ranges of cells) at height z of (i, j)."""
    i, j = (axis.ravel() for axis in np.meshgrid(np.arange(*x), np.arange(*y), indexing="ij"))
    return np.column_stack([i * CELL, j * CELL, np.round(z(i, j) / CELL) * CELL])


def decks(gap=0, headroom=4.0, slope=0.3):
    """A floor, a ramp of that slope, and a deck at its head; `gap` cells of the ramp are missing."""
    n = int(headroom / (slope * CELL))
    floor = plate((0, 20), (0, 20), lambda i, j: 0.0 * i)
    ramp = plate((20, 20 + n), (5, 15), lambda i, j: (i - 19) * slope * CELL)
    ramp = ramp[np.abs(ramp[:, 0] / CELL - 20 - n // 2) >= gap / 2 + 0.1] if gap else ramp
    deck = plate((20 + n, 40 + n), (0, 20), lambda i, j: headroom + 0.0 * i)
    return np.concatenate([floor, ramp, deck])


def joined(points):
    search = ColumnSearch(points, BODY, CELL)
    low, high = search.nearest(np.array([1.0, 2.0, 0.0])), search.nearest(points.max(axis=0) - [2.0, 2.0, 0.0])
    assert abs(search.places[high, 2] - search.places[low, 2]) > 3.0
    return search.component[low] == search.component[high]


def test_a_ramp_joins_two_decks_and_a_gap_in_it_does_not():
    assert joined(decks())
    assert not joined(decks(gap=3))


def test_a_ramp_steeper_than_the_body_stands_on_joins_nothing():
    assert not joined(decks(slope=0.9))


@pytest.mark.parametrize(("height", "stands"), [(1.0, False), (3.0, True)])
def test_nobody_stands_under_a_ceiling_that_is_too_low(height, stands):
    floor, lid = (plate((0, 20), (0, 20), lambda i, j, z=z: z + 0.0 * i) for z in (0.0, height))
    search = ColumnSearch(np.concatenate([floor, lid]), BODY, CELL)
    low = search.places[:, 2] < 0.1
    assert search.stands[low].any() == stands


def test_random_pairs_are_joined_and_stood_on():
    search = ColumnSearch(decks(), BODY, CELL)
    pairs = search.random_pairs(20, np.random.default_rng(0), 50)
    assert pairs.shape == (20, 2, 3)
    for one, two in pairs:
        a, b = search.nearest(one), search.nearest(two)
        assert np.allclose(search.places[a], one)
        assert search.component[a] == search.component[b]


@pytest.mark.parametrize(("post", "deep"), [(0.2, 0.0), (1.0, BODY.radius - 0.1)])
def test_a_way_is_in_a_column_that_is_higher_than_a_step(post, deep):
    """The way passes 0.1 m beside a post that stands on a ramp; one of a voxel's height is a step up."""
    points = decks()
    x = 26 * CELL  # in the middle of the ramp
    z = points[(np.abs(points[:, :2] - [x, 2.0]) < 0.01).all(axis=1), 2].min()
    up = np.column_stack([np.full(5, x), np.full(5, 2.0), z + CELL * np.arange(1, 6)])
    search = ColumnSearch(np.concatenate([points, up[up[:, 2] <= z + post + 0.01]]), BODY, CELL)
    way = np.array([[x - 1.0, 2.1, z - 0.3], [x + 1.0, 2.1, z + 0.3]])
    assert search.deepest(way) == pytest.approx(deep, abs=0.005)
    assert search.deepest(np.add(way, [0.0, 2.0 * BODY.radius, 0.0])) == 0.0

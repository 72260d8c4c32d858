"""What the bench of houses calls seen: a stair over which no gap is wider than a foot bridges."""

import numpy as np
import pytest

from gpdf_service.bench.houses import beside, has_within, was_seen
from gpdf_service.synthetic.houses import house


@pytest.fixture(scope="module")
def home():
    place = house(np.random.default_rng(5), "straight")
    points, ground = place.world.sample(0.05, headroom=0.0)
    return place, points[ground]


def test_a_stair_whose_treads_are_all_sampled_was_seen(home):
    place, ground = home
    assert was_seen(place, ground)


def test_a_stair_of_which_one_tread_was_not_sampled_was_not_seen(home):
    place, ground = home
    tread = place.way[6, 2]
    assert not was_seen(place, ground[np.abs(ground[:, 2] - tread) > 0.05])


def test_the_hidden_back_of_treads_is_no_gap(home):
    place, ground = home
    ahead = place.way[6] - place.way[5]
    ahead[2] = 0.0
    ahead /= np.linalg.norm(ahead)
    back = np.zeros(len(ground), dtype=bool)
    for middle in place.way[1:-1]:
        along = (ground - middle) @ ahead
        back |= (np.abs(ground[:, 2] - middle[2]) < 0.05) & (along > 0.03)
    assert back.any()
    assert was_seen(place, ground[~back])


def test_a_way_beside_another_is_as_far_from_it_as_was_asked():
    way = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.2], [2.0, 0.0, 0.4]])
    np.testing.assert_allclose(beside(way, 0.3), way + np.array([0.0, 0.3, 0.0]))


def test_a_point_counts_within_an_ellipsoid():
    places = np.array([[0.0, 0.0, 0.0], [0.2, 0.0, 0.0], [0.0, 0.0, 0.2]])
    assert has_within(places, np.array([[0.3, 0.0, 0.0], [0.0, 0.0, 0.5]]), 0.15, 0.35).tolist() == [False, True, True]

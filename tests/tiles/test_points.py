"""Points of a cloud that changes keep their numbers, and are found as if it was another cloud."""

import numpy as np
import pytest

from gpdf_service.perception.cloud import Cloud
from gpdf_service.tiles.points import points_of
from gpdf_service.tiles.rows import rows_in_cells
from gpdf_service.tiles.surface import OBSERVED, HeightMap


def changed(rng, count, wide=12.0, versions=4):
    """A cloud after some changes, and what is there, told row by row."""
    cloud = rng.uniform(0.0, wide, (count, 3))
    points, present, numbers = points_of(cloud), cloud, np.arange(count)
    for _ in range(versions):
        gone, fresh = rng.random(len(present)) < 0.1, rng.uniform(-1.0, wide + 1.0, (rng.integers(0, 40), 3))
        first = len(points.there)
        points = points.changed(points.numbers(np.flatnonzero(gone)), fresh)
        present = np.concatenate([present[~gone], fresh])
        numbers = np.concatenate([numbers[~gone], first + np.arange(len(fresh))])
    return points, present, numbers


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("count", [1, 300, 20_000])
def test_what_is_there_is_in_the_order_of_its_numbers(seed, count):
    rng = np.random.default_rng(seed)
    points, present, numbers = changed(rng, count)
    np.testing.assert_array_equal(points.present, present)
    np.testing.assert_array_equal(np.flatnonzero(points.there), numbers)
    assert points.count == len(present)
    rows = np.flatnonzero(rng.random(len(present)) < 0.3)
    np.testing.assert_array_equal(points.numbers(rows), numbers[rows])
    np.testing.assert_array_equal(points.taken(numbers[rows]), present[rows])


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("wide", [0.5, 12.0, 5e4])
def test_points_in_some_cells_are_found_wherever_these_lie(seed, wide):
    rng = np.random.default_rng(seed)
    points, present, numbers = changed(rng, 3000, wide)
    for _ in range(20):
        width, wanted = wide / 20.0, rng.random((24, 22)) < rng.choice([0.02, 0.5, 0.95])
        origin = rng.uniform(-1.1 * wide, 0.9 * wide, 2)
        x, y = np.floor((present[:, :2] - origin) / width).astype(int).T
        held = (x >= 0) & (x < 24) & (y >= 0) & (y < 22)
        held[held] = wanted[x[held], y[held]]
        np.testing.assert_array_equal(points.rows_in_cells(origin, width, wanted), numbers[held])
    everywhere = points.rows_in_cells(np.full(2, -1.5), wide + 3.0, np.ones((1, 1), dtype=bool))
    np.testing.assert_array_equal(everywhere, numbers)


def test_bounds_are_those_of_the_chosen_points_old_and_new():
    points, present, numbers = changed(np.random.default_rng(0), 500)
    chosen = np.zeros(len(points.there), dtype=bool)
    chosen[numbers[::7]] = True
    low, high = points.bounds(chosen)
    np.testing.assert_array_equal(low, present[::7, :2].min(axis=0))
    np.testing.assert_array_equal(high, present[::7, :2].max(axis=0))


def test_a_first_version_shares_its_points_and_a_later_one_leaves_them_as_they_were():
    cloud = np.random.default_rng(0).uniform(0.0, 3.0, (50, 3))
    first = points_of(cloud)
    second = first.changed(np.array([3, 7]), np.zeros((1, 3)))
    assert first.untouched
    assert first.present is cloud
    assert not second.untouched
    assert second.base is first.base
    assert first.there.all()


@pytest.mark.parametrize("seed", range(3))
def test_a_point_on_the_rim_of_a_grid_is_in_its_last_cell_wherever_the_change_is(seed):
    """Rounding puts it beyond where the last cell ends, and into that cell."""
    rng, width, beyond, corner, shape = np.random.default_rng(seed), 0.055, np.inf, 0.0, (0, 3)
    while np.floor((beyond - corner) / width) >= shape[0]:
        corner, shape = -width * rng.integers(1, 60), (int(rng.integers(200, 300)), 3)
        beyond = np.nextafter(corner + width * shape[0], np.inf)
    cloud = np.array([[corner + 0.5 * width, 0.5 * width, 0.0], [beyond, 0.5 * width, 0.0]])
    grid = HeightMap(np.array([corner, 0.0]), width, np.zeros(shape, np.float32), np.full(shape, OBSERVED, np.uint8))
    wanted = np.zeros(shape, dtype=bool)
    wanted[[0, -1]] = True
    rows = rows_in_cells(cloud, grid.origin, width, wanted)
    assert rows.tolist() == [0, 1]
    np.testing.assert_array_equal(Cloud(points_of(cloud), cloud[:1]).part(grid, wanted)[0], rows)

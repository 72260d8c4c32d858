"""Cells and their windows against the plain sums over the points, however far these lie apart."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from gpdf_service.denoise.cells import (
    AROUND,
    begin_sweep,
    centre_of,
    look_around,
    rows_around,
    runs_within,
    some_of,
    sort_into_cells,
    sum_cells,
    sum_window,
)


def cloud(rng):
    return np.concatenate(
        [rng.uniform(0, 1, (400, 3)), [[1e4, -3e3, 50.0]], rng.normal([5.0, 5.0, 5.0], 0.2, (300, 3))]
    )


@pytest.mark.parametrize("seed", range(3))
def test_a_windows_sums_are_those_of_the_points_in_its_27_cells(seed):
    rng = np.random.default_rng(seed)
    points = cloud(rng)
    cells = sort_into_cells(points, 0.11)
    np.testing.assert_allclose(cells.places + cells.corner, points[cells.order], atol=1e-9)
    near, total, moments = np.empty(AROUND, np.int64), np.empty(10), sum_cells(cells)
    at = begin_sweep(cells, cells.key[0])
    for c in range(len(cells.key)):
        look_around(cells, c, at, near)
        sum_window(cells, moments, near, total)
        offset = cells.places - np.array(centre_of(cells, c))
        x, y, z = offset[np.abs(offset).max(axis=1) < 1.5 * cells.width].T
        own = [len(x), *(v.sum() for v in (x, y, z, x * x, y * y, z * z, x * y, x * z, y * z))]
        np.testing.assert_allclose(total, own, atol=1e-9)


def test_a_sweep_that_begins_in_the_middle_finds_the_same_cells():
    cells = sort_into_cells(cloud(np.random.default_rng(1)), 0.11)
    one, other, at = np.empty(AROUND, np.int64), np.empty(AROUND, np.int64), begin_sweep(cells, cells.key[0])
    for c in range(len(cells.key)):
        look_around(cells, c, at, one)
        look_around(cells, c, begin_sweep(cells, cells.key[c]), other)
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("share", [0.0, 0.2, 1.0])
def test_some_cells_two_rings_off_are_those_whose_centres_are(share):
    rng = np.random.default_rng(2)
    cells = sort_into_cells(cloud(rng), 0.11)
    some = some_of(cells, rng.uniform(size=len(cells.key)) < share)
    centres = np.array([centre_of(cells, c) for c in range(len(cells.key))])
    np.testing.assert_array_equal(some.places, centres[some.order])
    runs, at = np.empty((25, 2), np.int64), begin_sweep(some, cells.key[0], 2)
    off = np.abs(centres[:, None] - some.places).max(axis=2)
    for c, own in enumerate(cells.key):
        found = [j for run in runs[: runs_within(some, own, 2, at, runs)] for j in range(*run)]
        assert sorted(found) == np.flatnonzero(off[c] <= 2.5 * cells.width).tolist()


def test_runs_hold_the_places_of_the_cells_within():
    cells = sort_into_cells(cloud(np.random.default_rng(2)), 0.11)
    centres = np.array([centre_of(cells, c) for c in range(len(cells.key))])
    runs, at = np.empty((25, 2), np.int64), begin_sweep(cells, cells.key[0], 2)
    for c, around in enumerate(cKDTree(centres).query_ball_point(centres, 2.5 * cells.width, p=np.inf)):
        held = [range(*cells.begin[j : j + 2]) for j in sorted(around)]
        found = [range(*run) for run in runs[: runs_within(cells, cells.key[c], 2, at, runs)]]
        assert np.concatenate(found).tolist() == np.concatenate(held).tolist()


@pytest.mark.parametrize("width", [0.02, 0.11, 0.6])
@pytest.mark.parametrize("share", [0.0, 0.01, 1.0])
def test_rows_around_some_points_are_those_of_the_cells_around_them(width, share):
    rng = np.random.default_rng(3)
    points = cloud(rng)
    asked = rng.uniform(size=len(points)) < share
    cells = sort_into_cells(points, width)
    cell = np.round((cells.places - 0.5 * cells.width) / cells.width)[np.argsort(cells.order)]
    off = np.abs(cell[:, None] - cell[asked]).max(axis=2)
    np.testing.assert_array_equal(rows_around(points, asked, width), np.flatnonzero((off <= 1).any(axis=1)))

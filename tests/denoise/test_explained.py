"""Points that the surfaces beside explain go back to them, and what is more than they explain stays."""

import numpy as np
import pytest

from gpdf_service.denoise import as_measured, return_explained
from gpdf_service.denoise.cloud import HIDDEN

SIGMA, SPACING = 0.05, 0.03


def well_known(points):
    """Points on surfaces that many others show, shape (n, 3)."""
    return as_measured(points, SIGMA)._replace(noise=np.full(len(points), HIDDEN * SIGMA))


def looked_at_again(extra, spacing=SPACING, placed=None, apart=0.0, wall_is_own=False):
    """The `extra` points before a wall at x = 0 that is told exactly, after they were looked at again, (k, 3) [m].

    They are vague, or were `placed` elsewhere. The wall is shown, or of the same part.
    """
    rng = np.random.default_rng(0)
    wall = np.column_stack([np.zeros(n := round(4.0 / spacing**2)), rng.uniform(-1.0, 1.0, (n, 2))])
    measured = np.concatenate([wall + rng.normal(0.0, SIGMA, wall.shape), extra])
    added = np.arange(len(measured)) >= len(wall)
    told = well_known(np.concatenate([wall, extra if placed is None else placed]))
    part = added | wall_is_own
    return_explained(measured, part, ~added, told._replace(vague=added & (placed is None)), spacing, apart)
    assert wall_is_own or np.array_equal(told.points[~added], wall)
    return told.points[added]


@pytest.mark.parametrize("off", [2.0, 3.0, 3.7])
def test_an_outlier_goes_back_to_the_wall_that_it_is_of(off):
    made = looked_at_again(np.array([[off * SIGMA, 0.1, 0.2]]))
    assert abs(made[0, 0]) < 1e-9
    assert np.linalg.norm(made[0, 1:] - [0.1, 0.2]) < SIGMA


def test_what_is_further_off_than_noise_reaches_stays():
    extra = np.array([[6.0 * SIGMA, 0.1, 0.2]])
    made = looked_at_again(extra)
    assert np.array_equal(made, extra)


@pytest.mark.parametrize("count", [24, 60])
def test_a_rod_is_more_than_the_wall_behind_it_explains(count):
    rng = np.random.default_rng(1)
    rod = np.column_stack([np.full(count, 3.0 * SIGMA), np.full(count, 0.2), rng.uniform(-0.2, 0.2, count)])
    rod += rng.normal(0.0, SIGMA, rod.shape) * [0.3, 1.0, 1.0]
    made = looked_at_again(rod)
    assert (made[:, 0] > 2.0 * SIGMA).mean() > 0.6


@pytest.mark.parametrize(("count", "back"), [(60, True), (6, False)])
def test_an_outlier_of_a_rod_that_shows_no_surface_goes_back_to_it_and_a_few_points_draw_nothing(count, back):
    rng = np.random.default_rng(2)
    rod = np.column_stack([np.full(count, 1.0), np.full(count, 0.2), rng.uniform(-0.3, 0.3, count)])
    rod += rng.normal(0.0, SIGMA, rod.shape)
    rod[0] = 1.0 + 3.7 * SIGMA, 0.2, 0.0
    made = looked_at_again(rod)
    assert (np.hypot(*(made[0, :2] - [1.0, 0.2])) < 2.0 * SIGMA) == back
    axis = np.hypot(*(made[:, :2] - [1.0, 0.2]).T)
    assert axis.max() <= np.hypot(*(rod[:, :2] - [1.0, 0.2]).T).max()


def test_a_wall_of_which_hardly_a_point_was_seen_explains_nothing():
    extra = np.array([[2.5 * SIGMA, 0.1, 0.2]])
    made = looked_at_again(extra, spacing=0.3)
    assert np.array_equal(made, extra)


@pytest.mark.parametrize(("count", "back"), [(2, True), (4, False)])
def test_two_outliers_beside_each_other_are_no_thing_and_four_are(count, back):
    extra = np.array([[4.0 * SIGMA, 0.1, 0.2 + 0.5 * SIGMA * i] for i in range(count)])
    made = looked_at_again(extra)
    assert np.array_equal(np.abs(made[:, 0]) < 1e-9, [back] * count)


def test_what_was_put_where_no_surface_is_goes_back_to_the_one_beside():
    measured = np.array([[2.0 * SIGMA, 0.1, 0.2]])
    made = looked_at_again(measured, placed=np.array([[6.0 * SIGMA, 0.1, 0.2]]))
    assert abs(made[0, 0]) < 1e-9


def test_outliers_that_show_a_plane_to_each_other_go_back():
    """Such a plane is hardly known: of eight refused places in three rooms with 5 cm of noise four were beside one."""
    rng = np.random.default_rng(3)
    wall = np.column_stack([np.zeros(n := round(4.0 / SPACING**2)), rng.uniform(-1.0, 1.0, (n, 2))])
    measured = wall + rng.normal(0.0, SIGMA, wall.shape)
    few = np.argsort(np.abs(measured[:, 0] - 2.2 * SIGMA) + np.hypot(*(measured[:, 1:] - [0.1, 0.2]).T))[:6]
    told = well_known(wall)
    told.points[few], told.noise[few] = measured[few] * [0.0, 1.0, 1.0] + [2.2 * SIGMA, 0.0, 0.0], 1.1 * SIGMA
    return_explained(measured, np.ones(n, dtype=bool), np.zeros(n, dtype=bool), told, SPACING)
    assert np.abs(told.points[few, 0]).max() < 1e-9


def test_what_is_nearer_to_its_own_surface_than_an_outlier_stays_where_it_was_measured():
    extra = np.array([[1.5 * SIGMA, 0.1, 0.2], [3.0 * SIGMA, -0.4, 0.2]])
    made = looked_at_again(extra, apart=2.0, wall_is_own=True)
    assert np.array_equal(made[0], extra[0])
    assert abs(made[1, 0]) < 1e-9
    assert (abs(looked_at_again(extra, apart=2.0)[:, 0]) < 1e-9).all()


def test_of_what_only_shows_surfaces_nothing_is_moved():
    rng = np.random.default_rng(0)
    wall = np.column_stack([np.zeros(2000), rng.uniform(-1.0, 1.0, (2000, 2))])
    wall[0] = 3.0 * SIGMA, 0.0, 0.0
    told, first = well_known(wall)._replace(vague=np.arange(2000) == 0), np.arange(2000) == 0
    return_explained(wall, ~first, first, told, SPACING)
    assert np.array_equal(told.points, wall)
    return_explained(wall, first, ~first, told, SPACING)
    assert abs(told.points[0, 0]) < 1e-9

"""A noisy cloud: sheets, edges and things stay apart, foliage stays, and the deviation that is left is honest."""

import numpy as np
import pytest

from gpdf_service.denoise import denoise

SPACING = 0.03


def sheet(rng, x, y, z):
    """Points on a level sheet over the ranges x and y [m] at the height z, one every `SPACING`²."""
    count = round((x[1] - x[0]) * (y[1] - y[0]) / SPACING**2)
    return np.column_stack([rng.uniform(*x, count), rng.uniform(*y, count), np.full(count, z)])


def wall(rng, x, y, z):
    """Points on an upright wall at x over the ranges y and z [m]."""
    return sheet(rng, y, z, x)[:, [2, 0, 1]]


def noisy(rng, clean, sigma):
    return clean + rng.normal(0.0, sigma, clean.shape)


@pytest.mark.parametrize("sigma", [0.005, 0.01, 0.02, 0.05])
def test_a_slope_is_flat_again_wherever_the_grid_lies(sigma):
    rng = np.random.default_rng(0)
    clean = sheet(rng, (0.0, 5.0), (0.0, 5.0), 0.0) + rng.uniform(0.0, 1.0, 3)
    clean[:, 2] += 0.2 * clean[:, 0]
    made = denoise(noisy(rng, clean, sigma), sigma, SPACING)
    inner = (np.abs(clean[:, :2] - clean[:, :2].mean(axis=0)) < 2.0).all(axis=1)
    off = (made.points[:, 2] - 0.2 * made.points[:, 0] - (clean[0, 2] - 0.2 * clean[0, 0]))[inner] / np.sqrt(1.04)
    assert np.sqrt((off**2).mean()) < 0.25 * sigma
    assert abs(off.mean()) < 0.05 * sigma
    assert (np.abs(off) <= 2.0 * made.noise[inner]).mean() > 0.99


@pytest.mark.parametrize("sigma", [0.01, 0.02])
def test_the_foot_of_a_wall_stays_a_corner(sigma):
    rng = np.random.default_rng(1)
    floor, side = sheet(rng, (0.0, 2.0), (0.0, 2.0), 0.0), wall(rng, 0.0, (0.0, 2.0), (0.0, 2.0))
    points = noisy(rng, np.concatenate([floor, side]), sigma)
    made = denoise(points, sigma, SPACING).points
    near = np.concatenate([floor[:, 0] < 5 * sigma, side[:, 2] < 5 * sigma])
    off = np.minimum(np.abs(made[:, 2]), np.abs(made[:, 0]))[near]
    raw = np.minimum(np.abs(points[:, 2]), np.abs(points[:, 0]))[near]
    assert np.sqrt((off**2).mean()) < 0.9 * np.sqrt((raw**2).mean())
    assert np.quantile(off, 0.99) < 3.0 * sigma


def test_a_lid_over_a_floor_is_not_drawn_onto_it():
    rng, sigma = np.random.default_rng(2), 0.05
    floor, lid = sheet(rng, (0.0, 3.0), (0.0, 3.0), 0.0), sheet(rng, (1.0, 2.0), (1.0, 2.0), 0.2)
    points = noisy(rng, np.concatenate([floor, lid]), sigma)
    for parts in (None, np.arange(len(points)) < len(floor)):
        z = denoise(points, sigma, SPACING, parts).points[len(floor) :, 2]
        assert (z > 0.1).mean() > (0.9 if parts is None else 0.99)


def test_foliage_stays_where_it_is():
    rng, sigma = np.random.default_rng(4), 0.01
    leaves = rng.normal([0.0, 0.0, 3.0], 0.5, (20_000, 3))
    points = np.concatenate([noisy(rng, sheet(rng, (-2.0, 2.0), (-2.0, 2.0), 0.0), sigma), leaves])
    made = denoise(points, sigma, SPACING, np.arange(len(points)) < len(points) - len(leaves))
    moved = np.linalg.norm(made.points - points, axis=1)[-len(leaves) :]
    assert np.quantile(moved, 0.9) < 3.0 * sigma
    assert np.linalg.norm(np.cov(made.points[-len(leaves) :].T) - np.cov(leaves.T)) < 0.01


def test_the_order_of_the_points_and_where_they_are_change_nothing():
    rng, sigma = np.random.default_rng(5), 0.02
    points = noisy(rng, np.concatenate([sheet(rng, (0, 2), (0, 2), 0.0), wall(rng, 0.0, (0, 2), (0, 2))]), sigma)
    order = rng.permutation(len(points))
    one, other = denoise(points, sigma, SPACING), denoise(points[order] + 64.0, sigma, SPACING)
    assert (
        np.quantile(np.abs(one.points[order] - (other.points - 64.0)), 0.99) < 0.3 * sigma
    )  # the spacing's sample differs


def test_a_table_is_no_larger_for_its_noise_along_it():
    rng, sigma = np.random.default_rng(6), 0.05
    points = noisy(rng, np.concatenate([sheet(rng, (-0.6, 0.6), (-0.6, 0.6), 0.7) for _ in range(4)]), sigma)
    made = denoise(points, sigma, SPACING)
    past, before = (np.abs(p[~made.stray][:, :2]).max(axis=1) - 0.6 for p in (made.points, points))
    assert np.quantile(past, 0.99) < 0.8 * np.quantile(before, 0.99)
    assert np.quantile(past, 0.9) > -sigma  # nor smaller


def test_an_outlier_of_a_wall_has_no_company_in_what_lies_on_the_wall():
    rng, sigma = np.random.default_rng(7), 0.02
    points = np.concatenate([noisy(rng, wall(rng, 0.0, (-1.0, 1.0), (-1.0, 1.0)), sigma), [[5.0 * sigma, 0.0, 0.0]]])
    made = denoise(points, sigma, SPACING)
    assert made.stray[-1]

import numpy as np
import pytest

from gpdf_service.fields import onto_surface
from gpdf_service.fields.rests import EXTREME, settle_rests

SPACING = 0.03


def wall(rng, noise):
    """An upright wall of 2 × 2 m at x = 0, noisy; its points are cured, their normals known."""
    count = int(4.0 / SPACING**2)
    clean = np.column_stack([np.zeros(count), rng.uniform(-1, 1, (count, 2))])
    return clean, clean + rng.normal(size=clean.shape) * noise


def settled(points, moved, lost, noise):
    left = np.where(lost, EXTREME * noise, 0.5 * noise)
    normals = np.where(lost[:, None], 0.0, [1.0, 0.0, 0.0])
    settle_rests(points, moved, left, normals, noise, SPACING, np.ones(len(points), dtype=bool))
    return moved


@pytest.mark.parametrize("noise", [0.02, 0.05])
def test_an_outlier_comes_to_its_wall_and_a_rod_before_the_wall_stays(noise):
    rng = np.random.default_rng(3)
    clean, points = wall(rng, noise)
    outlier = np.array([[3.0 * noise, 0.6, 0.6]])
    rod = np.column_stack([np.full(140, 3.0 * noise), np.zeros(140), rng.uniform(-1, 1, 140)])
    rod += rng.normal(size=rod.shape) * 0.3 * noise
    points = np.concatenate([points, outlier, rod])
    lost = np.arange(len(points)) >= len(clean)
    moved = settled(points, np.concatenate([clean, outlier, rod]), lost, noise)
    assert moved[len(clean), 0] < 1.5 * noise
    kept = (moved[len(clean) + 1 :] == rod).all(axis=1)
    assert kept.mean() > 0.85
    assert np.diff(np.sort(rod[kept, 2])).max() < 0.25  # a person is twice as wide


def test_what_a_plane_has_swallowed_comes_out_of_it_and_the_rest_stays():
    rng, noise = np.random.default_rng(4), 0.05
    clean, points = wall(rng, noise)
    handle = (np.abs(clean[:, 1]) < 0.06) & (np.abs(clean[:, 2]) < 0.06)
    points[handle, 0] += 0.08
    moved = settled(points, clean.copy(), np.zeros(len(clean), dtype=bool), noise)
    assert moved[handle, 0].max() > 0.04
    far = np.linalg.norm(clean[:, 1:], axis=1) > 0.3
    assert (moved[far, 0] != 0.0).mean() < 0.02
    assert np.abs(moved[far, 0]).max() < noise


@pytest.mark.parametrize("noise", [0.01, 0.02, 0.05])
def test_a_pole_before_a_wall_is_kept(noise):
    rng = np.random.default_rng(5)
    clean, points = wall(rng, noise)
    pole = np.column_stack([np.full(280, 4.0 * noise), np.zeros(280), rng.uniform(-1, 1, 280)])
    points = np.concatenate([points, pole + rng.normal(size=pole.shape) * noise])
    moved, _ = onto_surface(points, SPACING, noise, things=True)
    assert (moved[len(clean) :, 0] > 2.5 * noise).mean() > 0.85

import numpy as np
import pytest

from gpdf_service.bench.surfaces import SURFACES
from gpdf_service.fields import denoise, estimate_noise, estimate_spacing, fit_gpdf


def noisy(name, sigma, count=20_000):
    rng = np.random.default_rng(1)
    clean = SURFACES[name].sample(count, rng)
    return clean, clean + rng.normal(size=clean.shape) * sigma, rng


@pytest.mark.parametrize("sigma", [0.01, 0.02, 0.05])
@pytest.mark.parametrize("name", ["plane", "corner", "sphere"])
def test_the_noise_is_found_without_being_told(name, sigma):
    _, points, _ = noisy(name, sigma)
    assert estimate_noise(points, estimate_spacing(points)) == pytest.approx(sigma, rel=0.25)


@pytest.mark.parametrize(("name", "share"), [("plane", 0.3), ("corner", 0.35), ("sphere", 0.45), ("terrain", 0.4)])
@pytest.mark.parametrize("sigma", [0.02, 0.05])
def test_points_come_back_to_their_surface(name, share, sigma):
    _, points, _ = noisy(name, sigma)
    cured = denoise(points)
    error = SURFACES[name].distance(cured.points[~cured.stray])
    assert np.sqrt((error**2).mean()) < share * sigma
    assert cured.stray.mean() < 0.01


def test_two_metres_over_a_floor_with_5_cm_of_noise_the_bias_is_gone():
    _, points, rng = noisy("plane", 0.05)
    queries = np.column_stack([rng.uniform(-3, 3, (500, 2)), np.full(500, 2.0)])
    raw = fit_gpdf(points).query(queries).distance - 2.0
    cured = denoise(points)
    ours = fit_gpdf(cured.points[~cured.stray]).query(queries).distance - 2.0
    assert raw.mean() < -0.08  # what the cure is for
    assert abs(ours.mean()) < 0.02


def test_clean_points_stay_where_they_are():
    clean, _, _ = noisy("corner", 0.0)
    cured = denoise(clean)
    np.testing.assert_array_equal(cured.points, clean)
    assert not cured.stray.any()


def test_a_pole_beside_a_noisy_wall_is_not_moved_into_it_nor_taken_for_a_stray():
    rng = np.random.default_rng(2)
    wall = np.column_stack([np.zeros(30_000), rng.uniform(-3, 3, 30_000), rng.uniform(0, 2.5, 30_000)])
    pole = np.column_stack([np.full(400, 0.6), np.zeros(400), rng.uniform(0, 2, 400)])
    points = np.concatenate([wall, pole]) + rng.normal(size=(30_400, 3)) * 0.03
    cured = denoise(points)
    kept = cured.points[30_000:][~cured.stray[30_000:]]
    assert len(kept) > 390
    assert np.abs(kept[:, 0] - 0.6).max() < 0.15


def test_a_reflection_above_a_floor_is_a_stray_and_a_thin_region_is_not():
    rng = np.random.default_rng(3)
    floor = np.column_stack([rng.uniform(0, 4, (20_000, 2)), np.zeros(20_000)])
    far = np.column_stack([rng.uniform(10, 20, 40), rng.uniform(0, 4, 40), np.zeros(40)])
    points = np.concatenate([floor, far]) + rng.normal(size=(20_040, 3)) * 0.02
    cured = denoise(np.concatenate([points, [[2.0, 2.0, 0.15]]]))
    assert cured.stray[-1]
    assert not cured.stray[20_000:-1].any()


@pytest.mark.parametrize("sigma", [0.0, 0.01, 0.02])
@pytest.mark.parametrize("name", ["plane", "corner", "sphere", "terrain"])
def test_the_truth_lies_within_two_standard_deviations(name, sigma):
    _, points, rng = noisy(name, sigma)
    cured = denoise(points)
    field = fit_gpdf(cured.points[~cured.stray], noise=cured.noise[~cured.stray])
    low, high = np.asarray(SURFACES[name].core)
    queries = rng.uniform(np.maximum(low, -3), np.minimum(high, 3), (3000, 3))
    sample = field.query(queries)
    error = np.abs(sample.distance - SURFACES[name].distance(queries))
    assert (error <= 2 * sample.deviation)[sample.valid].mean() > 0.95

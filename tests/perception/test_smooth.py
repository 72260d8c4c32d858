"""Heights of noisy ground: the error at a rim, and what must stay as it is."""

import numpy as np
import pytest
from scipy import ndimage

import gpdf_service as gpdf
from gpdf_service.config import PerceptionConfig
from gpdf_service.ground.limits import step_and_slope
from gpdf_service.perception.holes import fill_holes
from gpdf_service.perception.levels import survey_levels
from gpdf_service.perception.smooth import to_centres, with_rims
from gpdf_service.perception.voids import Voids
from gpdf_service.tiles.points import points_of
from gpdf_service.tiles.surface import OBSERVED, UNKNOWN, HeightMap, nearest_seen
from gpdf_service.tiles.told import new_grid

WIDTH = 0.05
NOISE = 0.05


def ground(height):
    state = np.where(np.isnan(height), UNKNOWN, OBSERVED).astype(np.uint8)
    return HeightMap(np.zeros(2), WIDTH, height.astype(np.float32), state)


def cells(count=60):
    return np.mgrid[0:count, 0:count] * WIDTH


def test_clean_ground_is_not_touched():
    surface = ground(np.random.default_rng(0).normal(0.0, 0.01, (20, 20)))
    assert with_rims(surface, 0.0) is surface


@pytest.mark.parametrize("noise", [0.0, NOISE])
def test_a_slope_sampled_beside_the_cells_centres_has_its_height_at_the_centres(noise):
    x, y = cells()
    off = np.random.default_rng(1).uniform(-0.5 * WIDTH, 0.5 * WIDTH, (*x.shape, 2)).astype(np.float32)
    sampled = 0.25 * (x + off[..., 0]) - 0.1 * (y + off[..., 1])
    sampled[20:30, 20:30] = np.nan
    made = to_centres(ground(sampled), off, noise).height
    known = ~np.isnan(sampled)
    held = known & (ndimage.uniform_filter(known.astype(float), size=3, mode="constant") > 4.5 / 9.0)
    assert held.sum() > known.sum() - 10  # the corners of the map have four cells
    assert np.abs(sampled - 0.25 * x + 0.1 * y)[held].max() > 0.008
    assert np.abs(made - 0.25 * x + 0.1 * y)[held].max() < 1e-4
    assert np.isnan(made[~known]).all()


@pytest.mark.parametrize("step", [0.02, 0.05, 0.3])
def test_a_step_stays_as_high_and_as_sharp_as_it_was(step):
    x, _ = cells()
    height = np.where(x >= 1.5, step, 0.0).astype(np.float32)
    off = np.random.default_rng(2).uniform(-0.5 * WIDTH, 0.5 * WIDTH, (*x.shape, 2)).astype(np.float32)
    np.testing.assert_allclose(to_centres(ground(height), off).height, height, atol=1e-6)


def test_a_coarse_scan_of_a_slope_has_no_steps():
    rng = np.random.default_rng(3)
    xy = np.mgrid[0:6:0.06, 0:6:0.06].reshape(2, -1).T
    xy += rng.uniform(-0.03, 0.03, xy.shape)

    def floor(xy):
        return 0.25 * xy[:, 0] + 0.05 * np.sin(2.0 * xy[:, 1])

    points = np.column_stack([xy, floor(xy)])
    surface = (
        survey_levels(points_of(points), np.ones(len(points), dtype=bool), PerceptionConfig())[0].levels[0].surface
    )
    inner = ndimage.binary_erosion(surface.state != UNKNOWN, np.ones((3, 3)), iterations=3)
    assert step_and_slope(surface)[0][inner].max() < 0.02
    centres = surface.centres(inner)
    assert np.quantile(np.abs(centres[:, 2] - floor(centres)), 0.95) < 0.002  # a third of what the points alone say


def test_a_tilted_rim_of_a_platform_takes_the_height_of_what_is_behind_it():
    x, y = cells()
    rise = np.where(x >= 1.5, 0.35, 0.0)
    tilt = np.where(
        (x >= 1.5) & (x < 1.7) & (np.abs(y - 1.5) < 0.15), 0.025 * (1.7 - x) / 0.2, 0.0
    )  # as a plane of few points leaves it
    made = with_rims(ground(rise + tilt), NOISE).height
    assert np.abs(made - rise)[30:32].max() < 0.5 * tilt.max()  # a step is read over these cells
    assert np.abs(np.diff(made, axis=0)).max() > 0.34  # the edge is sharp


def test_a_plane_with_a_rim_stays_and_unknown_cells_stay_unknown():
    x, y = cells()
    plane = 0.2 * x - 0.1 * y
    plane[20:30, 20:30] = np.nan
    plane[40:, :] += 0.3
    np.testing.assert_allclose(with_rims(ground(plane), NOISE).height, plane, atol=1e-5)


def test_what_bends_more_at_a_rim_than_the_noise_hides_stays_as_it_is():
    x, y = cells()
    hill = ((x - 1.5) ** 2 + (y - 1.5) ** 2) / (2.0 * 1.5)  # 1.5 m of radius: 11 cm lower at the plane's end
    inner = np.s_[15:45, 15:45]
    hill[30:, :] += 0.3  # a rim across its top
    assert np.abs(with_rims(ground(hill), NOISE).height - hill)[inner].max() < 0.2 * NOISE


def test_ground_at_no_rim_keeps_its_heights():
    x, _ = cells()
    ramp = 0.1 * np.maximum(x - 1.5, 0.0)
    np.testing.assert_array_equal(with_rims(ground(ramp), NOISE).height, ramp.astype(np.float32))


def test_a_cell_that_stands_out_at_a_rim_is_put_on_its_plane_though_the_others_are_rough_too():
    rng = np.random.default_rng(9)
    x, y = cells(40)
    height = np.where((x >= 0.6) & (x < 1.4) & (y >= 0.6) & (y < 1.4), 0.35, 0.0)
    height += rng.normal(0.0, 0.14 * NOISE, height.shape)  # more than a plane may leave
    height[12, 20] = 0.35 + 0.8 * NOISE
    made = with_rims(ground(height), NOISE).height
    assert abs(made[12, 20] - 0.35) < 0.14 * NOISE
    quiet = np.abs(height - np.where(height > 0.2, 0.35, 0.0)) < 0.28 * NOISE
    np.testing.assert_array_equal(made[quiet], height.astype(np.float32)[quiet])


@pytest.mark.parametrize("seed", range(4, 10))
def test_a_platform_that_a_human_takes_is_one_at_5_cm_of_noise(seed):
    rng = np.random.default_rng(seed)
    xy = rng.uniform(0.0, 3.0, (10_000, 2))
    on = (np.abs(xy - 1.5) < 0.6).all(axis=1)
    points = np.column_stack([xy, np.where(on, 0.35, 0.0)])
    scene = gpdf.build_scene(points + rng.normal(0.0, NOISE, points.shape), np.ones(len(points), dtype=bool))
    steps = scene.free_space("human").levels[0].steps
    assert 0.33 < np.quantile(steps[steps > 0.2], 0.5) < 0.37
    assert gpdf.plan(scene, (0.4, 1.5, 0.0), (1.5, 1.5, 0.35), "human").status is gpdf.Status.OK


def fill_gaps(height, noise=0.0):
    nothing = np.zeros(height.shape, dtype=bool)
    seen, nowhere = ground(height), Voids(*(nothing,) * 4)
    grid, near = new_grid(height.shape), nearest_seen(seen)
    return fill_holes(seen, grid, near, 3 * (nothing,), nowhere, PerceptionConfig(), noise).height


@pytest.mark.parametrize("noise", [0.0, NOISE])
def test_an_empty_cell_of_a_slope_lies_on_it(noise):
    x, y = cells()
    slope = 0.3 * x - 0.2 * y
    gaps = np.zeros(x.shape, dtype=bool)
    gaps[2:-2, 2:-2] = np.random.default_rng(4).random((56, 56)) < 0.1
    made = fill_gaps(np.where(gaps, np.nan, slope), noise)
    assert not np.isnan(made).any()
    assert (np.abs(made - slope)[gaps] < 1e-4).mean() > 0.99  # of those at the rim too few are known
    assert (step_and_slope(ground(made))[0] > 0.01).sum() < 10


@pytest.mark.parametrize(("step", "noise"), [(0.02, 0.0), (0.025, NOISE), (0.05, NOISE), (0.3, NOISE)])
def test_an_empty_cell_beside_a_step_lies_on_one_of_its_sides(step, noise):
    x, _ = cells()
    height = np.where(x >= 1.5, step, 0.0)
    gaps = np.zeros(x.shape, dtype=bool)
    gaps[28:32, 3:-3:4] = True
    made = fill_gaps(np.where(gaps, np.nan, height), noise)
    assert np.minimum(np.abs(made), np.abs(made - step))[gaps].max() < 1e-6
    assert (np.abs(np.diff(made, axis=0)) > 0.9 * step).any(axis=0).all()


def test_a_gap_where_a_step_was_blurred_to_a_slope_is_not_smoothed_over():
    x, _ = cells()
    blurred = np.clip((x - 1.4) / 0.2, 0.0, 1.0) * 0.04
    gaps = np.zeros(x.shape, dtype=bool)
    for begin in range(4, 56, 8):
        gaps[30, begin : begin + 3] = True
    made = fill_gaps(np.where(gaps, np.nan, blurred), 0.02)
    assert (
        np.abs(np.diff(made, axis=0))[:, 5:56:8].max(axis=0).min() > 0.019
    )  # a Roomba's step, seen by chance; it stays one


@pytest.mark.parametrize("noise", [0.0, NOISE])
def test_a_notch_a_cell_wide_in_a_noisy_rim_is_a_gap_and_a_wider_or_longer_one_is_none(noise):
    floor = np.zeros((60, 60))
    floor[:, 50:] = np.nan  # nothing was seen beyond
    notches = np.full(floor.shape, False)
    notches[10, 47:50] = True
    wide, long = notches.copy(), notches.copy()
    wide[30:33, 47:50], long[30, 44:50] = True, True
    for there in (wide, long):
        made = fill_gaps(np.where(there, np.nan, floor), noise)
        assert np.isnan(made[10, 47:50]).all() == (noise == 0.0)
        assert np.isnan(made[30:33][there[30:33]]).all()
        assert np.isnan(made[:, 50:]).all()

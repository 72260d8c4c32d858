"""Noisy flights: real ones are told and set onto their treads and risers, what only looks like one is not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from gpdf_service.denoise import Flight, onto_risers, onto_treads
from gpdf_service.types import FloatArray

NOISE = 0.05
"""[m]"""
EDGES: FloatArray = 1.0 + 0.29 * np.arange(7)
RISE = 0.17
"""[m]"""
SPACING = 0.03
"""[m]"""


def sampled(low: tuple[float, float], high: tuple[float, float], rng: np.random.Generator) -> FloatArray:
    """Random places in a rectangle, shape (n, 2)."""
    size = np.subtract(high, low)
    return np.asarray(low) + rng.random((int(np.prod(size) / SPACING**2), 2)) * size


def stair(rng: np.random.Generator, width: float = 1.2) -> FloatArray:
    """Clean treads of 0.17 × 0.29 m with a floor and a landing."""
    xy = sampled((0.0, 0.0), (EDGES[-1] + 1.0, width), rng)
    return np.column_stack([xy, RISE * np.searchsorted(EDGES, xy[:, 0])])


def turned(points: FloatArray, angle: float) -> FloatArray:
    c, s = np.cos(angle), np.sin(angle)
    return np.column_stack([c * points[:, 0] - s * points[:, 1], s * points[:, 0] + c * points[:, 1], points[:, 2]])


def cured(points: FloatArray, noise: float = NOISE) -> tuple[list[Flight], FloatArray, FloatArray]:
    moved, left = points.copy(), np.zeros(len(points))
    return onto_treads(points, noise, moved, left), moved, left


@pytest.mark.parametrize("angle", [0.0, 0.7, -2.5])
@pytest.mark.parametrize("noise", [0.02, 0.05])
def test_treads_of_a_noisy_stair_are_told_wherever_it_points(angle: float, noise: float) -> None:
    rng = np.random.default_rng(1)
    clean = stair(rng)
    points = turned(clean + rng.normal(0.0, noise, clean.shape), angle)
    flights, moved, left = cured(points, 0.95 * noise)
    assert len(flights) == 1
    u, _ = flights[0].treads.along(np.append(flights[0].origin, 0.0)[None])
    np.testing.assert_allclose(flights[0].treads.edges + u - 0.0, EDGES, atol=0.02)
    np.testing.assert_allclose(flights[0].treads.heights, RISE * np.arange(8), atol=0.01)
    true = RISE * np.searchsorted(EDGES, turned(points, -angle)[:, 0])
    sure = (left > 0.0) & (np.abs(turned(points, -angle)[:, :1] - EDGES).min(axis=1) > 0.02)
    assert sure.mean() > 0.6
    np.testing.assert_allclose(moved[sure, 2], true[sure], atol=0.01)


def test_a_flight_open_at_its_side_ends_there() -> None:
    rng = np.random.default_rng(2)
    beside = sampled((0.0, 1.2), (EDGES[-1] + 1.0, 2.2), rng)
    clean = np.concatenate([stair(rng), np.column_stack([beside, np.zeros(len(beside))])])
    flights, moved, _ = cured(clean + rng.normal(0.0, NOISE, clean.shape))
    assert len(flights) == 1
    assert np.ptp([flights[0].low[1], flights[0].high[1]]) < 1.2 + 3.0 * NOISE + 0.1
    floor = (clean[:, 1] > 1.4) & (clean[:, 0] > EDGES[0] + 0.1)
    assert moved[floor, 2].max() < 6.0 * NOISE


@pytest.mark.parametrize("relief", [0.0, 0.02, 0.04, 0.06])
@pytest.mark.parametrize("length", [0.05, 0.1, 0.2])
def test_no_treads_are_told_of_a_slope(relief: float, length: float) -> None:
    for seed in range(6):
        rng = np.random.default_rng(seed)
        xy = sampled((0.0, 0.0), (3.5, 1.2), rng)
        grid = gaussian_filter(rng.normal(size=(360, 130)), length / 0.01 / np.sqrt(2.0))
        bumps = relief * (grid / grid.std())[(xy[:, 0] / 0.01).astype(int), (xy[:, 1] / 0.01).astype(int)]
        slope = np.tan(np.radians(rng.uniform(25.0, 36.0)))
        clean = np.column_stack([xy, slope * np.clip(xy[:, 0] - 0.5, 0.0, 2.5) + bumps])
        flights, _, left = cured(clean + rng.normal(0.0, NOISE, clean.shape))
        assert flights == []
        assert not left.any()


@pytest.mark.parametrize("heights", [(0.35,), (0.14,), (0.17, 0.34)])
def test_a_platform_a_kerb_and_two_steps_stay_as_they_are(heights: tuple[float, ...]) -> None:
    rng = np.random.default_rng(3)
    xy = sampled((0.0, 0.0), (3.0, 1.5), rng)
    levels = np.array([0.0, *heights])
    clean = np.column_stack([xy, levels[np.searchsorted(1.5 + 0.29 * np.arange(len(heights)), xy[:, 0])]])
    flights, _, left = cured(clean + rng.normal(0.0, NOISE, clean.shape))
    assert flights == []
    assert not left.any()


def test_risers_are_set_and_things_on_treads_are_not() -> None:
    rng = np.random.default_rng(4)
    clean = stair(rng)
    flights, _, _ = cured(clean + rng.normal(0.0, NOISE, clean.shape))
    faces = [sampled((0.0, k * RISE), (1.2, (k + 1) * RISE), rng) for k in range(len(EDGES))]
    risers = np.concatenate([np.column_stack([np.full(len(f), x), f]) for x, f in zip(EDGES, faces, strict=True)])
    top = sampled((EDGES[3] - 0.2, 0.4), (EDGES[3] - 0.05, 0.7), rng)
    front = sampled((0.4, 3 * RISE), (0.7, 3 * RISE + 0.12), rng)
    box = np.concatenate(
        [
            np.column_stack([top, np.full(len(top), 3 * RISE + 0.12)]),
            np.column_stack([np.full(len(front), EDGES[3] - 0.2), front]),
        ]
    )
    behind = (np.abs(risers[:, 0] - EDGES[3]) < 0.01) & (risers[:, 1] > 0.4) & (risers[:, 1] < 0.7)
    clean = np.concatenate([risers[~behind], box])
    points = clean + rng.normal(0.0, NOISE, clean.shape)
    moved, left = points.copy(), np.zeros(len(points))
    onto_risers(flights, points, NOISE, moved, left)
    thing = np.arange(len(points)) >= (~behind).sum()
    far = ~thing & (np.abs(clean[:, 1] - 0.55) > 0.35)
    assert (left[far] > 0.0).mean() > 0.9
    off = np.abs(moved[far & (left > 0.0), :1] - EDGES).min(axis=1)
    assert off.max() < 0.02
    assert (left[thing] > 0.0).mean() < 0.1


@pytest.mark.parametrize("count", [0, 1, 40, 300])
def test_few_points_are_no_flight(count: int) -> None:
    rng = np.random.default_rng(5)
    clean = stair(rng)[:count]
    flights, moved, left = cured(clean + rng.normal(0.0, NOISE, clean.shape))
    assert flights == []
    assert not left.any()
    assert len(moved) == count

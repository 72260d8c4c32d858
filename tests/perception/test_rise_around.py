"""How far ground rises around a path, told by blocks of cells, against a look at every cell."""

import numpy as np
import pytest

from gpdf_service.tiles.surface import BLOCK, OBSERVED, UNKNOWN, HeightMap, rise_around

WIDTH = 0.05


def surface_of(height):
    state = np.where(np.isnan(height), UNKNOWN, OBSERVED).astype(np.uint8)
    return HeightMap(np.array([-1.0, 2.0]), WIDTH, height.astype(np.float32), state)


@pytest.mark.parametrize("seed", range(20))
def test_a_rise_is_never_less_than_that_of_the_cells_around_and_no_more_than_that_of_their_blocks(seed):
    rng = np.random.default_rng(seed)
    height = np.cumsum(rng.normal(0.0, 0.01, (rng.integers(3, 90), rng.integers(3, 90))), axis=0)
    height[rng.random(height.shape) < 0.3] = np.nan
    ground = surface_of(height)
    size = WIDTH * np.array(height.shape)
    for _ in range(50):
        path = ground.origin + rng.uniform(-0.3, 1.3, (rng.integers(1, 5), 2)) * size
        reach = rng.uniform(0.0, 1.0)
        told = rise_around(path, reach, ground.arrays, ground.ends)
        low, high = (path.min(axis=0) - reach - ground.origin), (path.max(axis=0) + reach - ground.origin)
        first = np.clip(np.floor(low / WIDTH), 0, height.shape).astype(int)
        last = np.clip(np.floor(high / WIDTH) + 1, 0, height.shape).astype(int)
        inside = height.astype(np.float32)[first[0] : last[0], first[1] : last[1]]
        if np.isfinite(inside).any():
            assert told >= np.nanmax(inside) - np.nanmin(inside)
        around = [
            slice(max(a // BLOCK - 1, 0) * BLOCK, (b // BLOCK + 2) * BLOCK) for a, b in zip(first, last, strict=True)
        ]
        blocks = height.astype(np.float32)[tuple(around)]
        if not np.isfinite(blocks).any():
            assert told == -np.inf
        else:
            assert told <= np.nanmax(blocks) - np.nanmin(blocks)


def test_a_place_that_is_none_may_be_anywhere():
    height = np.zeros((60, 60))
    height[50, 50] = 1.0
    ground = surface_of(height)
    assert rise_around(np.zeros((1, 2)) + ground.origin + 0.1, 0.1, ground.arrays, ground.ends) == 0.0
    assert rise_around(np.full((1, 2), np.nan), 0.1, ground.arrays, ground.ends) == 1.0

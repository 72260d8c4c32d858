"""Whether a path crosses a flight: one look at a box of ground for many places finds what a look at each finds."""

import numpy as np
import pytest

from gpdf_service.ground.foot import STRIDE
from gpdf_service.ground.footing import FLIGHT_RISE, ROUGH, crosses_flight, rings_of
from gpdf_service.tiles.surface import OBSERVED, UNKNOWN, HeightMap

WIDTH, RADIUS = 0.05, 0.25


def crosses(path, surface):
    """`crosses_flight`, place by place and cell by cell."""
    height, every = surface.height, 0.5 * RADIUS
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(path[:, :2], axis=0), axis=1)))
    at = np.append(np.arange(0.0, along[-1], every), along[-1])
    stride, reach = rings_of(STRIDE, WIDTH), int(2.5 * every / WIDTH) + 1
    for x, y, z in np.column_stack([np.interp(at, along, column) for column in path.T]):
        i, j = int(x // WIDTH), int(y // WIDTH)
        if not abs(height[i, j] - z) <= FLIGHT_RISE:
            continue
        for u in range(max(i - reach, 0), min(i + reach + 1, height.shape[0])):
            for v in range(max(j - reach, 0), min(j + reach + 1, height.shape[1])):
                own = height[u, v]
                box = height[max(u - stride, 0) : u + stride + 1, max(v - stride, 0) : v + stride + 1]
                low, high = np.nanmin(box), np.nanmax(box)
                near = (u - i) ** 2 + (v - j) ** 2 <= reach * reach
                if near and high - own > ROUGH and own - low > ROUGH and high - low > FLIGHT_RISE:
                    return True
    return False


@pytest.mark.parametrize("seed", range(12))
def test_a_path_crosses_a_flight_where_a_look_at_each_place_says_so(seed):
    rng = np.random.default_rng(seed)
    height = np.zeros((120, 40), np.float32)
    stairs = rng.integers(30, 90)
    height[stairs:] = 0.18 * np.minimum((np.arange(120 - stairs) // 5 + 1), 6)[:, None]
    height[rng.random(height.shape) < 0.1] = np.nan
    surface = HeightMap(np.zeros(2), WIDTH, height, np.where(np.isnan(height), UNKNOWN, OBSERVED).astype(np.uint8))
    far = rng.uniform(0.6, 5.5)
    path = np.column_stack([np.linspace(0.3, far, 40), np.linspace(*rng.uniform(0.3, 1.7, 2), 40), np.zeros(40)])
    assert crosses_flight(path, surface, RADIUS) == crosses(path, surface)


def test_both_answers_are_asked_for():
    flat = HeightMap(np.zeros(2), WIDTH, np.zeros((60, 60), np.float32), np.full((60, 60), OBSERVED, np.uint8))
    path = np.column_stack([np.linspace(0.3, 2.7, 20), np.ones(20), np.zeros(20)])
    assert not crosses_flight(path, flat, RADIUS)
    stair = HeightMap(
        flat.origin, WIDTH, np.tile(0.18 * (np.arange(60, dtype=np.float32) // 5)[:, None], 60), flat.state
    )
    path[:, 2] = 0.18 * (path[:, 0] // 0.25)
    assert crosses_flight(path, stair, RADIUS)

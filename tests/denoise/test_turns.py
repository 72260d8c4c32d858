"""Shares of points between planes that end at each other, against sums made one by one."""

import numpy as np
from scipy.stats import norm

from gpdf_service.denoise.cells import look_at, sort_into_cells
from gpdf_service.denoise.turns import _share_out
from gpdf_service.denoise.votes import make_room

SIGMA = 0.05


def test_shares_are_those_of_planes_seen_with_an_error():
    rng = np.random.default_rng(0)
    points = rng.normal(0.0, SIGMA, (200, 3)) + rng.uniform(-0.15, 0.15, (200, 3))
    cells, room = sort_into_cells(points, 2.0), make_room(1)
    x = room.about[:, : look_at(cells, 0, np.zeros(1, np.int64), len(points), room.about)].T
    normals, heights = np.array([[0.0, 0.6, 0.8], [1.0, 0.0, 0.0]]), np.median(x, axis=0)[[2, 0]]
    room.found[:2, :3], room.found[:2, 3] = normals, heights
    room.ends[:2, :2] = [[0.0, 1.0], [-1.0, 0.0]]
    _share_out(room.found[:2], SIGMA, room, len(x))
    off = (x @ normals.T - heights) / SIGMA
    inside = off[:, ::-1] * [1.0, -1.0]
    density = (
        np.exp(-0.5 * off**2) * (np.abs(off) <= 4.0) * norm.cdf(np.where(np.abs(inside) < 4.0, inside, 99.0 * inside))
    )
    for k, share in enumerate((density / (0.01 + density.sum(axis=1, keepdims=True))).T):
        own = [share.sum(), *(share @ x), *(share @ x**2), *(share @ (x[:, [0, 0, 1]] * x[:, [1, 2, 2]]))]
        np.testing.assert_allclose(room.sums[k], own, rtol=1e-5, atol=1e-5)

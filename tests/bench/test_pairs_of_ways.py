import numpy as np

import gpdf_service as gpdf
from gpdf_service.bench.ways import _highest_step, standing_pairs
from gpdf_service.types import AGENTS
from tests.clients.two_storeys import make_house


def test_pairs_stand_on_all_levels_and_their_height_is_known():
    house = make_house(np.random.default_rng(0))
    scene = gpdf.build_scene(house.points, house.ground)
    pairs = standing_pairs(scene, AGENTS["human"], 60, np.random.default_rng(0))
    assert pairs.shape == (60, 2, 3)
    assert np.ptp(pairs[..., 2]) > 2.0
    for start, _ in pairs[:20]:
        assert gpdf.plan(scene, start, start, "human").status is gpdf.Status.OK


def test_who_walks_along_a_ledge_takes_no_step():
    flat, step = np.zeros((9, 3)), np.zeros((9, 3))
    step[5:, 2] = 0.35
    assert _highest_step(flat) == 0.0
    assert _highest_step(step) == _highest_step(step[::-1]) == 0.35
    step[5, 2] = 0.17  # between two waypoints
    assert _highest_step(step) == 0.35

"""Steps that one notices, asked for by boxes of cells."""

from __future__ import annotations

import numpy as np
import pytest

from gpdf_service.search.free_space import NOTICED_STEP
from gpdf_service.search.ways import count_steps, is_near_step, is_stepped
from gpdf_service.tiles.surface import OBSERVED, Cells, count_cells


def ground_of(steps):
    height = np.zeros(steps.shape, np.float32)
    return Cells(height, np.full(steps.shape, OBSERVED, np.uint8), np.array([-1.0, 2.0]), 0.1)


def test_a_step_is_found_in_a_box_just_as_by_looking_at_each_cell():
    rng = np.random.default_rng(3)
    steps = np.where(rng.random((17, 23)) < 0.02, 0.1, rng.uniform(0.0, NOTICED_STEP, (17, 23)))
    ground, noticed = ground_of(steps), count_cells(steps > NOTICED_STEP)
    found = set()
    for u, v, reach in zip(
        rng.integers(17, size=500), rng.integers(23, size=500), rng.integers(5, size=500), strict=True
    ):
        x, y = ground.origin + 0.1 * (np.array([u, v]) + 0.5)
        box = steps[max(u - reach, 0) : u + reach + 1, max(v - reach, 0) : v + reach + 1]
        told = is_stepped(ground, noticed, x, y, int(reach))
        assert told == (box > NOTICED_STEP).any()
        found.add(bool(told))
    assert found == {True, False}
    assert not is_stepped(ground, noticed, -1.5, 2.5, 3)  # off the grid


def test_a_way_is_near_a_step_that_it_passes():
    steps = np.zeros((40, 40))
    steps[20, 20] = 0.2
    ground, noticed = ground_of(steps), count_cells(steps > NOTICED_STEP)
    way = np.array([[-0.9, 4.0], [2.9, 4.0]])
    assert is_near_step(way, ground, noticed, 0.25)
    assert not is_near_step(way + np.array([0.0, 0.9]), ground, noticed, 0.25)


@pytest.mark.parametrize(
    ("heights", "steps"),
    [
        ([0.0, 0.0, 0.02, 0.04], 0),
        ([0.0, 0.2, 0.2, 0.4], 2),
        ([0.0, 0.2, 0.4, 0.4], 1),  # a riser that is told in two pieces
        ([0.0, 0.2, 0.0, 0.0], 2),
        ([0.4, 0.0], 1),
    ],
)
def test_steps_of_a_path_are_counted_up_and_down(heights, steps):
    contact = np.column_stack([np.arange(len(heights)), np.zeros(len(heights)), heights]).astype(float)
    assert count_steps(contact) == steps

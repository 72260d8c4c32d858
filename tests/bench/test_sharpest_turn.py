"""How much a path turns at a corner."""

import numpy as np
import pytest

from gpdf_service.bench.hard_clouds import TURN, sharpest_turn


@pytest.mark.parametrize("angle", [0.0, 40.0, 120.0])
def test_a_corner_is_found_and_a_turn_on_both_sides_of_south_is_none(angle):
    steps = np.concatenate([np.full(40, 170.0), np.full(40, 170.0 + angle)])
    path = np.cumsum(0.05 * np.column_stack([np.cos(np.radians(steps)), np.sin(np.radians(steps))]), axis=0)
    assert np.degrees(sharpest_turn(path)) == pytest.approx(angle)
    assert np.degrees(sharpest_turn(np.repeat(path, 2, axis=0))) == pytest.approx(angle)  # standing is no turn


def test_an_arc_turns_by_what_lies_within_a_corners_length():
    along = np.arange(0.0, 6.0, 0.02)
    arc = 2.0 * np.column_stack([np.cos(0.5 * along), np.sin(0.5 * along)])
    assert sharpest_turn(arc) == pytest.approx(TURN / 2.0, abs=0.02)

"""What a camera sees of a box, against projections of its corners."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpdf_service.viewer.fit import BELOW, MARGIN, PANEL, PHONE, fitted, free_of

FOV = np.radians(75.0)
SIZES = [(1440, 900), (390, 844), (844, 390), (1100, 600), (820, 1180)]


def seen(low, high, position, target, aspect):
    """Where the corners of a box are in the picture, (8, 2), as viser's camera shows them, with z up."""
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    away = np.array(list(product(*zip(low, high, strict=True)))) - position
    assert (away @ forward > 0.0).all()
    scale = np.tan(0.5 * FOV) * (away @ forward)
    return np.column_stack([away @ right / (scale * aspect), away @ up / scale])


@given(
    st.sampled_from(SIZES),
    st.tuples(*3 * [st.floats(-50.0, 50.0)]),
    st.tuples(st.floats(5.0, 200.0), st.floats(5.0, 200.0), st.floats(0.0, 60.0)),
    st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, -0.2), st.floats(0.1, 1.0)),
)
def test_every_corner_is_beside_the_panel_and_the_box_could_not_be_larger(size, low, extent, toward):
    (width, height), low = size, np.array(low)
    high, free = low + extent, free_of(width)
    position, target = fitted(low, high, np.array(toward), FOV, width / height, free)
    spots = seen(low, high, position, target, width / height)
    assert (spots >= free.low - 1e-6).all()
    assert (spots <= free.high + 1e-6).all()
    touched = [np.isclose(spots.min(axis=0), free.low), np.isclose(spots.max(axis=0), free.high)]
    assert np.all(touched, axis=0).any()  # from side to side, or from top to bottom
    np.testing.assert_allclose(np.cross(position - target, toward), 0.0, atol=1e-6 * np.linalg.norm(position - target))


def test_one_step_sees_a_point_from_a_distance():
    position, target = fitted(np.zeros(3), np.zeros(3), np.array([0.0, -1.0, 1.0]), FOV, 1.5, free_of(1440))
    assert np.linalg.norm(position - target) == pytest.approx(0.5)


def test_the_panel_is_at_the_right_or_on_a_phone_below():
    desk, phone = free_of(1440), free_of(PHONE)
    assert desk.high[0] == pytest.approx(1.0 - MARGIN - 2 * PANEL / 1440)
    assert desk.low[1] == phone.low[0] == MARGIN - 1.0
    assert phone.high[0] == 1.0 - MARGIN
    assert phone.low[1] == pytest.approx(-1.0 + MARGIN + 2 * BELOW)

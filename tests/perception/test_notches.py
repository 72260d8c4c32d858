"""What is inferred of a flight's treads: a strip that was seen on all sides, and nothing beyond an open side."""

import numpy as np
import pytest

from gpdf_service.config import PerceptionConfig
from gpdf_service.perception.notches import fill_notches
from gpdf_service.perception.surface import INFERRED, OBSERVED, UNKNOWN

WIDTH = 0.05
RISE = 0.17
DEPTH = 6
"""Cells of a tread: 30 cm."""


def filled(height, void=None):
    state = np.where(np.isnan(height), UNKNOWN, OBSERVED).astype(np.uint8)
    height, near = height.astype(np.float32), np.full(height.shape, WIDTH)
    void = np.zeros(height.shape, dtype=bool) if void is None else void
    fill_notches(height, state, void, near, WIDTH, PerceptionConfig())
    return height, state


def flight(rows=30, treads=5):
    """Treads up along x; the outermost row of them is 20, what lies beyond was not seen."""
    height = np.repeat(RISE * np.arange(treads), DEPTH)[:, None] * np.ones(rows)
    height[:, 21:] = np.nan
    return height


STRIP = slice(2 * DEPTH + 2, 2 * DEPTH + 4)
"""Two cells in the middle of the third tread."""


def test_a_strip_of_a_tread_that_was_seen_all_round_is_that_tread():
    height = flight()
    height[STRIP, 8:13] = np.nan
    made, state = filled(height)
    np.testing.assert_allclose(made[STRIP, 8:13], 2 * RISE, atol=1e-6)
    assert (state[STRIP, 8:13] == INFERRED).all()
    assert (state[:, 21:] == UNKNOWN).all()


def test_at_the_open_side_of_a_flight_a_strip_stays_unknown():
    height = flight()
    height[STRIP, 20] = np.nan
    assert (filled(height)[1][STRIP, 20] == UNKNOWN).all()


@pytest.mark.parametrize("change", ["floor", "landing", "seen through"])
def test_a_strip_that_is_in_no_flight_or_was_seen_through_stays_unknown(change):
    height = flight()
    height[STRIP, 8:13] = np.nan
    void = np.isnan(height) & (change == "seen through")
    if change == "floor":
        height[np.isfinite(height)] = 0.0
    if change == "landing":  # up behind it, level before it
        height[: 2 * DEPTH, :21] = 2 * RISE
    assert (filled(height, void)[1][STRIP, 8:13] == UNKNOWN).all()


@pytest.mark.parametrize(("cells", "end", "fills"), [(1, 13, True), (2, 13, False), (1, 21, False)])
def test_the_back_of_an_open_tread_is_inferred_where_it_is_as_narrow_as_openings_and_seen_at_both_ends(
    cells, end, fills
):
    height = flight()
    back = slice(3 * DEPTH - cells, 3 * DEPTH)
    height[back, 8:end] = np.nan
    made, state = filled(height, np.isnan(height))
    assert (state[back, 8:end] == (INFERRED if fills else UNKNOWN)).all()
    if fills:
        np.testing.assert_allclose(made[back, 8:end], 2 * RISE, atol=1e-6)

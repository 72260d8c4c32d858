"""What is inferred of a flight's treads: what a foot bridges, in any direction, and nothing beyond an open side."""

import numpy as np
import pytest

from gpdf_service.config import PerceptionConfig
from gpdf_service.ground.footing import flights
from gpdf_service.perception.notches import FLIGHT, bites_reach, fill_bites, fill_notches, notches_reach
from gpdf_service.tiles.surface import INFERRED, OBSERVED, UNKNOWN, HeightMap

WIDTH, LIMITS = 0.05, PerceptionConfig()
RISE = 0.17
DEPTH = 6
"""Cells of a tread: 30 cm."""


def filled(height, below=None, stands=None, flight=None):
    state = np.where(np.isnan(height), UNKNOWN, OBSERVED).astype(np.uint8)
    below, stands = (np.zeros(height.shape, dtype=bool) if each is None else each for each in (below, stands))
    surface = HeightMap(np.zeros(2), WIDTH, height.astype(np.float32), state)
    flight = flights(surface, LIMITS.max_step, FLIGHT) if flight is None else flight
    bitten = fill_bites(surface, flight, below, stands)
    made = fill_notches(surface, bitten, flight, below, LIMITS)
    return made.height, made.state


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


@pytest.mark.parametrize(("seen", "filled_up"), [(1, False), (3, True)])
def test_treads_of_which_only_the_noses_were_seen_are_not_filled_up_to_the_next(seen, filled_up):
    depth = DEPTH - 1
    height = np.repeat(RISE * np.arange(8), depth)[:, None] * np.ones(30)
    x = np.arange(len(height))
    height[(x > 2 * depth) & (x < 6 * depth) & (x % depth >= seen)] = np.nan
    middle = filled(height)[0][3 * depth : 5 * depth, 5:25]
    known = np.isfinite(middle).any(axis=1)
    assert known.all() if filled_up else known.sum() == 2 * seen


def test_beyond_the_open_side_of_a_flight_nothing_is_inferred():
    height = flight()
    height[STRIP, 18:21] = np.nan
    state = filled(height)[1]
    assert (state[:, 21:] == UNKNOWN).all()
    height[:, 24:] = -2 * RISE  # nor up to a floor further down
    assert (filled(height)[1][:, 21:24] == UNKNOWN).all()


@pytest.mark.parametrize(("wide", "filled_up"), [(1, False), (5, True)])
def test_a_shadow_is_filled_as_high_as_the_tread_beside_it_but_not_as_a_stringer(wide, filled_up):
    """A floor, a flight up along y, and between them, beside a shadow before a wall, a tread of so many cells."""
    height = np.zeros((24, 26))
    height[:, 14:], height[:, 18:] = 0.4, 0.6
    height[8:, 8:14] = np.nan
    height[9 - wide : 9, 8:14] = 0.25
    wall = np.zeros(height.shape, dtype=bool)
    wall[16:] = True
    made, state = filled(height, stands=wall)
    assert (state[10:13, 10:12] == (INFERRED if filled_up else UNKNOWN)).all()
    assert not filled_up or np.allclose(made[10:13, 10:12], 0.25)


@pytest.mark.parametrize("wall", [True, False])
@pytest.mark.parametrize("turn", np.pi * np.arange(14) / 7)
def test_a_shadow_at_the_wall_beside_a_flight_is_filled_at_any_angle_and_none_at_its_open_side(turn, wall):
    """Nine treads of 1.2 m, of which a shadow bites out 30 cm by 80; beside them a wall, or nothing, and a floor."""
    x, y = np.meshgrid(np.arange(90) - 45.0, np.arange(90) - 45.0, indexing="ij")
    along, across = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
    tread = RISE * np.clip(np.floor(along / DEPTH) + 5, 0, 9)
    shadow, beside = (np.abs(along) < 8) & (across > 6) & (across <= 12), (across > 12) & (across <= 15)
    height = np.where(across > 12, 0.0, tread)
    height[shadow | beside] = np.nan
    made, state = filled(height, stands=beside & wall)
    inferred = state[shadow] == INFERRED
    assert (inferred.mean() > 0.85) if wall else (inferred.mean() < 0.1)  # in its corners discs close
    off = np.abs(made - tread)[shadow][inferred]
    assert off.max() < 1.01 * RISE
    assert not wall or (off < 1e-6).mean() > 0.8


def test_a_riser_s_cell_is_no_two_steps_under_the_ground_beside_it():
    height = flight()
    height[2 * DEPTH, 10], height[2 * DEPTH + 1, 10] = np.nan, 3 * RISE  # between three treads, as near to each
    made, _ = filled(height)
    np.testing.assert_allclose(made[2 * DEPTH, 10], 2 * RISE, atol=1e-6)


@pytest.mark.parametrize("change", ["floor", "landing"])
def test_a_strip_that_is_in_no_flight_stays_unknown(change):
    height = flight()
    height[STRIP, 8:13] = np.nan
    if change == "floor":
        height[np.isfinite(height)] = 0.0
    if change == "landing":  # up behind it, level before it
        height[: 2 * DEPTH, :21] = 2 * RISE
    assert (filled(height)[1][STRIP, 8:13] == UNKNOWN).all()


@pytest.mark.parametrize("cells", [2, 4, 5])
def test_the_hidden_back_of_a_tread_is_the_lower_tread_up_to_what_a_foot_bridges(cells):
    height = flight()
    back = slice(3 * DEPTH - cells, 3 * DEPTH)
    height[back, 5:18] = np.nan
    made, state = filled(height)
    fills = cells * WIDTH < PerceptionConfig().widest_gap
    assert (state[back, 9:14] == (INFERRED if fills else UNKNOWN)).all()
    if fills:
        np.testing.assert_allclose(made[back, 9:14], 2 * RISE, atol=1e-6)


@pytest.mark.parametrize("turn", [0.3, 0.8])
def test_a_flight_across_the_grid_is_filled_as_one_along_it(turn):
    x, y = np.meshgrid(np.arange(60), np.arange(60), indexing="ij")
    along = (x - 30) * np.cos(turn) + (y - 30) * np.sin(turn) + 30
    tread = np.clip(np.floor(along / DEPTH), 0, 9)
    height = np.where((tread % 2 == 0) & (along % DEPTH >= DEPTH - 3), np.nan, RISE * tread)  # the back of each second
    inner = (np.abs(x - 30) < 10) & (np.abs(y - 30) < 10)
    made, state = filled(height)
    assert (state[inner] != UNKNOWN).all()
    np.testing.assert_allclose(made[inner], (RISE * tread)[inner], atol=1e-6)


def test_a_slot_that_shows_the_room_beneath_is_open_unless_that_shows_beneath_the_treads_too():
    height = flight()
    height[STRIP, 8:13] = np.nan
    slot = np.isnan(height)
    assert (filled(height, slot)[1][STRIP, 8:13] == UNKNOWN).all()
    everywhere = np.ones(height.shape, dtype=bool)
    assert (filled(height, everywhere)[1][STRIP, 8:13] == INFERRED).all()


@pytest.mark.parametrize(("cells", "state"), [(2, INFERRED), (4, UNKNOWN)])
def test_an_open_riser_shows_the_room_beneath_but_a_slot_wider_than_a_sole_is_open(cells, state):
    height = flight()
    riser = slice(3 * DEPTH - cells // 2, 3 * DEPTH + cells // 2), slice(8, 13)
    height[riser] = np.nan
    assert (filled(height, np.isnan(height))[1][riser][:, 1:-1] == state).all()  # its ends are closed over


def test_treads_of_which_half_were_seen_from_beneath_are_filled_alike_in_any_box_around_them():
    height = np.repeat(RISE * np.arange(34), DEPTH)[:, None] * np.ones(200)
    height[np.random.default_rng(0).random(height.shape) < 0.7] = np.nan
    below = np.zeros(height.shape, dtype=bool)
    below[:, ::2] = True
    state, columns = filled(height, below)[1], slice(70, 130)
    surface = HeightMap(np.zeros(2), WIDTH, height, np.where(np.isnan(height), UNKNOWN, OBSERVED))
    treads = flights(surface, LIMITS.max_step, FLIGHT)
    reach = bites_reach(surface) + notches_reach(surface, LIMITS)
    for first in range(70, 130, 4):
        box = slice(first - reach, first + 4 + reach), slice(columns.start - reach, columns.stop + reach)
        part = filled(height[box], below[box], flight=treads[box])[1][reach:-reach, reach:-reach]
        np.testing.assert_array_equal(part, state[first : first + 4, columns])
    assert 0 < (state == UNKNOWN).sum() < np.isnan(height).sum()

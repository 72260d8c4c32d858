"""A scan shows fronts: what stands behind them, nobody knows."""

import numpy as np
import pytest

from gpdf_service.config import PerceptionConfig
from gpdf_service.perception.levels import survey_levels
from gpdf_service.tiles.points import points_of
from gpdf_service.tiles.surface import INFERRED, UNKNOWN


def floor_without(shadow):
    """A floor of 6 × 6 m in which `shadow` of x and y was not seen."""
    x, y = (axis.ravel() for axis in np.meshgrid(*2 * [np.arange(0.01, 6.0, 0.02)], indexing="ij"))
    seen = ~shadow(x, y)
    return np.column_stack([x[seen], y[seen], np.zeros(seen.sum())])


def surface_of(floor, things):
    cloud = np.concatenate([floor, things])
    return survey_levels(points_of(cloud), np.arange(len(cloud)) < len(floor), PerceptionConfig())[0].levels[0].surface


def state_at(surface, x, y):
    ix, iy, _ = surface.cells(np.array([[x, y]]))
    return surface.state[ix[0], iy[0]]


def upright(x, y, height=1.8):
    """Points over places in plan, from the floor up."""
    z = np.arange(0.03, height, 0.02)
    return np.column_stack([np.repeat(x, len(z)), np.repeat(y, len(z)), np.tile(z, len(x))])


def test_in_the_shadow_of_a_wall_nothing_is_ground_and_the_same_hole_in_the_open_is():
    def hole(x, y):
        return (np.abs(x - 2.0) < 1.0) & (np.abs(y - 3.25) < 0.25)

    along = np.arange(1.0, 3.0, 0.02)
    behind, alone = (
        surface_of(floor_without(hole), wall)
        for wall in (upright(along, np.full(len(along), 2.99)), upright(along, np.full(len(along), 1.01)))
    )
    for y in (3.1, 3.25, 3.4):
        assert not behind.contains(np.array([[2.0, y]]))[0]
        assert state_at(alone, 2.0, y) == INFERRED


def test_beneath_a_shelf_the_floor_is_known_where_it_was_seen():
    """What stands beneath it, its legs or a box against its back, a scan from its front does not show."""

    def unseen(x, y):
        return (np.abs(x - 3.0) < 0.7) & (np.abs(y - 3.0) < 0.3)

    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(2.0, 4.0, 0.02), np.arange(2.5, 3.5, 0.02)))
    surface = surface_of(floor_without(unseen), np.column_stack([x, y, np.full(x.size, 0.15)]))
    assert not surface.contains(np.array([[3.0, 3.0], [2.6, 3.0], [3.0, 2.9], [3.0, 2.76], [2.36, 3.0]])).any()
    assert surface.contains(np.array([[3.0, 2.66], [2.26, 3.0]])).all()
    bare = surface_of(floor_without(unseen), np.empty((0, 3)))
    assert state_at(bare, 3.0, 3.0) == INFERRED


def test_a_single_cell_that_the_scan_missed_before_a_wall_hides_nothing():
    along = np.arange(0.02, 6.0, 0.02)
    wall = upright(along, np.full(len(along), 5.99))
    seen = surface_of(floor_without(lambda x, y: np.zeros(len(x), dtype=bool)), wall)
    i, j, _ = seen.cells(np.array([[3.0, 5.99]]))
    low = seen.origin + np.array([i[0], j[0] - 1]) * seen.cell_width

    def missed(x, y):
        cell = np.floor((np.column_stack([x, y]) - low) / seen.cell_width)
        return (cell == 0).all(axis=1)

    surface = surface_of(floor_without(missed), wall)
    assert surface.state[i[0], j[0] - 1] == INFERRED


def test_behind_a_trunk_the_ground_is_inferred_again_beyond_what_it_can_be_deep():
    radius, angle = 0.15, np.arange(-np.pi, 0.0, 0.1)
    trunk = upright(3.0 + radius * np.cos(angle), 3.0 + radius * np.sin(angle))
    surface = surface_of(
        floor_without(
            lambda x, y: (np.hypot(x - 3.0, y - 3.0) < radius) | ((np.abs(x - 3.0) < radius) & (y > 3.0) & (y < 4.0))
        ),
        trunk,
    )
    back = np.array([[3.0, y] for y in (3.0, 3.05, 3.1)])
    assert not surface.contains(back).any()
    assert state_at(surface, 3.0, 3.6) == INFERRED


@pytest.mark.parametrize("depth", [0.4, 0.6])
def test_behind_a_box_whose_top_was_seen_the_shadow_is_inferred(depth):
    def hidden(x, y):
        return (np.abs(x - 3.0) < 0.5) & (y > 2.0) & (y < 2.0 + depth + 0.5)

    along, up = np.arange(2.5, 3.5, 0.02), np.arange(2.0, 2.0 + depth, 0.02)
    x, y = (axis.ravel() for axis in np.meshgrid(along, up))
    top = np.column_stack([x, y, np.full(x.size, 0.5)])
    box = np.concatenate([upright(along, np.full(len(along), 2.0), 0.5), top])
    assert state_at(surface_of(floor_without(hidden), box), 3.0, 2.0 + depth + 0.25) == INFERRED


def test_a_blind_disc_with_single_points_at_one_height_over_it_is_inferred():
    """Points at much the same height go nowhere: they are no front of which the back was not seen.

    What lies right under them stays unobserved: they may be the top of something.
    """

    def disc(x, y):
        return np.hypot(x - 3.0, y - 3.0) < 0.6

    few = np.array([[2.8, 3.2, 0.095], [2.81, 3.2, 0.105], [2.82, 3.2, 0.11]])
    surface = surface_of(floor_without(disc), few)
    for x, y in ((3.0, 3.0), (2.8, 3.3), (3.3, 2.8), (2.6, 3.0)):
        assert state_at(surface, x, y) == INFERRED
    assert state_at(surface, 2.8, 3.2) == UNKNOWN
    front = surface_of(floor_without(disc), upright(np.array([2.8, 2.8, 2.8]), np.array([3.18, 3.2, 3.22]), 0.3))
    assert not front.contains(np.array([[3.0, 3.0]]))[0]


@pytest.mark.parametrize(("z", "state"), [(0.0, INFERRED), (0.03, INFERRED), (0.12, UNKNOWN)])
def test_single_points_of_the_floor_in_a_blind_disc_are_no_thing_and_those_over_it_are(z, state):
    """They are too few to be ground by themselves; but a ray met the floor there, and nothing over it."""

    def disc(x, y):
        return np.hypot(x - 3.0, y - 3.0) < 0.6

    surface = surface_of(floor_without(disc), np.array([[2.8, 3.2, z]]))
    assert state_at(surface, 3.0, 3.0) == INFERRED
    assert state_at(surface, 2.8, 3.2) == state


def test_points_of_the_floor_in_two_cells_side_by_side_may_be_the_foot_of_something():
    """In a crowd's shade they are feet: a path ran into one."""

    def disc(x, y):
        return np.hypot(x - 3.0, y - 3.0) < 0.6

    surface = surface_of(floor_without(disc), np.array([[2.8, 3.2, 0.0], [2.85, 3.2, 0.0]]))
    assert state_at(surface, 3.0, 3.0) == INFERRED
    assert state_at(surface, 2.8, 3.2) == state_at(surface, 2.85, 3.2) == UNKNOWN


@pytest.mark.parametrize(("size", "state"), [(0.2, UNKNOWN), (0.04, INFERRED)])
def test_behind_a_low_box_of_which_a_part_of_the_top_was_seen_nothing_is_inferred(size, state):
    """It may go on in its own shadow; what is smaller than half a foot is a cable or noise."""

    def unseen(x, y):
        return np.hypot(x - 3.0, y - 3.0) < 0.7

    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(0.0, size, 0.02), np.arange(-0.5 * size, 0.5 * size, 0.02)))
    top = np.column_stack([2.35 + x, 3.0 + y, np.full(x.size, 0.15)])
    assert state_at(surface_of(floor_without(unseen), np.empty((0, 3))), 2.75, 3.0) == INFERRED
    assert state_at(surface_of(floor_without(unseen), top), 2.75, 3.0) == state


@pytest.mark.parametrize(("y", "state"), [(2.7, INFERRED), (3.05, UNKNOWN)])
def test_a_front_in_the_air_goes_down_where_nobody_has_seen_the_floor_beneath(y, state):
    """Of one who stands behind another the scanner sees shoulders; a cupboard on a wall has the floor beneath it."""

    def strip(x, y):
        return (np.abs(x - 3.0) < 1.0) & (np.abs(y - 3.25) < 0.25)

    front = upright(np.arange(2.5, 3.5, 0.02), np.full(50, y), 0.4) + np.array([0.0, 0.0, 1.1])
    assert state_at(surface_of(floor_without(strip), front), 3.0, 3.25) == state

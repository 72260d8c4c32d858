"""The corridor of stairs between two floors, against the place itself: a flight along x, 1.2 m wide, over a floor."""

import dataclasses

import numpy as np
import pytest
from gpdf_guidance.corridor import (
    BESIDE_STAIRS,
    FOOTING,
    SPACING,
    Corridor,
    beside_steps,
    least_room,
    middle_of,
    on_own_ground,
    other_ground,
    scan,
    through_gates,
    where_there_is_room,
)
from gpdf_guidance.stairs import ELBOW_ROOM, GATE, Flight

WIDEST, HALF_PACE, ARM = 0.8, 0.35, 0.1
"""[m] What is looked at, and what is kept free beside one, written down once more."""
RISE, TREAD, EDGES, HALF = 0.17, 0.3, 3.0 + 0.3 * np.arange(8), 0.6
FLIGHT = Flight(EDGES[0], EDGES[-1], 0.0, 0.0, RISE, (EDGES[0], 0.0), (EDGES[-1], 0.0))
along = np.arange(0.0, 8.0 + SPACING / 2, SPACING)
"""Arc lengths of a path along the flight's middle, at y = 0."""


def heights(x):
    return RISE * np.searchsorted(EDGES, x)


def field(places):
    """Distance to the ground: over the flight its treads, beside it the floor; nothing is known behind its head."""
    x, y, z = places.T
    on = np.where(np.abs(y) <= HALF, heights(x), 0.0)
    samples = np.stack([np.where(np.abs(y) <= HALF, heights(x + shift), 0.0) for shift in (-0.02, 0.02)])
    low, high = samples.min(axis=0), samples.max(axis=0)
    distance = np.maximum(np.maximum(low - z, z - high), 0.0)  # at a face, its foot, its tread and all between
    beside = np.where(np.abs(y) <= HALF, np.inf, np.abs(y) - HALF)  # of the flight's side
    return np.minimum(distance, np.where(z <= on, np.inf, np.hypot(beside, np.maximum(z - heights(x), 0.0)))), None


def corridor_of_stairs(flight=FLIGHT):
    ground = np.column_stack([along, 0.0 * along, heights(along)])
    wide = Corridor(*(np.full(len(along), WIDEST) for _ in range(3)))
    return on_own_ground(wide, ground, along, np.zeros(len(along)), (flight,), field)


def test_nobody_walks_within_half_a_stance_of_the_side_of_a_flight():
    found = corridor_of_stairs()
    high = (along > EDGES[2]) & (along < EDGES[-1])  # the floor is two steps down and more
    for width in found:
        assert (width[high] <= HALF - FOOTING + 1e-9).all()
    for width in (found.left, found.right):  # and the side is no wall
        assert (width[high] >= HALF - FOOTING - 0.7 * RISE - SPACING).all()


def test_a_flight_begins_and_ends_at_its_edges():
    found = corridor_of_stairs()
    for edge in (FLIGHT.start, FLIGHT.end):
        for width in (found.left, found.right):
            assert (width[np.abs(along - edge) < SPACING + 1e-9] >= HALF - FOOTING - 0.7 * RISE - SPACING).all()


def test_a_flight_elsewhere_changes_nothing_beside_this_one():
    alone, steeper = corridor_of_stairs(), dataclasses.replace(FLIGHT, start=40.0, end=42.0, rise=2.0 * RISE)
    ground = np.column_stack([along, 0.0 * along, heights(along)])
    wide = Corridor(*(np.full(len(along), WIDEST) for _ in range(3)))
    for flights in ((FLIGHT, steeper), (steeper, FLIGHT)):
        found = on_own_ground(wide, ground, along, np.zeros(len(along)), flights, field)
        for width, other in zip(found, alone, strict=True):
            np.testing.assert_array_equal(width, other)


@pytest.mark.parametrize(("x", "y"), [(0.0, 16.0), (-32.0, -8.0)])
def test_a_flight_is_the_same_wherever_it_is(x, y):
    there = np.array([x, y, 0.0])
    ground = np.column_stack([along, 0.0 * along, heights(along)]) + there
    wide = Corridor(*(np.full(len(along), WIDEST) for _ in range(3)))
    found = on_own_ground(wide, ground, along, np.zeros(len(along)), (FLIGHT,), lambda places: field(places - there))
    for width, other in zip(found, corridor_of_stairs(), strict=True):
        np.testing.assert_allclose(width, other, atol=SPACING / 2 + 1e-9)  # an edge may fall beside a sample


def test_the_way_down_a_flight_is_as_wide_as_the_way_up():
    ground = np.column_stack([along, 0.0 * along, heights(along)])[::-1]
    flight = dataclasses.replace(FLIGHT, start=8.0 - FLIGHT.end, end=8.0 - FLIGHT.start, rise=-RISE)
    wide = Corridor(*(np.full(len(along), WIDEST) for _ in range(3)))
    down, up = on_own_ground(wide, ground, along, np.full(len(along), np.pi), (flight,), field), corridor_of_stairs()
    off = np.minimum(np.abs(along - FLIGHT.start), np.abs(along - FLIGHT.end))
    told = np.abs(off - SPACING) > 1e-6  # who is just a sample away is on the flight, or not, by the last bit
    for one, other in ((down.disc, up.disc), (down.left, up.right), (down.right, up.left)):
        np.testing.assert_allclose(one[::-1][told], other[told], atol=SPACING / 2 + 1e-9)


def pit(x, y, radius):
    """Level ground with a round pit in it, near a flight that begins at 3 m."""

    def field(places):
        inside = np.hypot(places[:, 0] - x, places[:, 1] - y) < radius
        return np.where(inside, 1.0, np.abs(places[:, 2])), None

    wide = Corridor(*(np.full(len(along), WIDEST) for _ in range(3)))
    level = np.column_stack([along, 0.0 * along, 0.0 * along])
    return on_own_ground(wide, level, along, np.zeros(len(along)), (FLIGHT,), field)


def test_a_pit_as_wide_as_a_foot_near_stairs_is_seen_wherever_it_is():
    rng = np.random.default_rng(0)
    for x, y in zip(rng.uniform(1.5, 2.5, 60), rng.uniform(-0.7, 0.7, 60), strict=True):
        found = pit(x, y, 0.06)
        away = np.hypot(along - x, y)
        near = (away < WIDEST - 0.1) & (along > 1.0)
        assert (found.disc[near] <= away[near]).all(), (x, y)
        assert (found.disc[near] < WIDEST).all(), (x, y)


def test_what_is_right_beside_a_sample_narrows_its_side():
    for sign in (1.0, -1.0):
        found = pit(2.0, 0.65 * sign, 0.03)
        own, other = (found.left, found.right) if sign > 0 else (found.right, found.left)
        beside = np.abs(along - 2.0) < 1e-9
        assert (own[beside] < WIDEST).all()
        assert (other[beside] == WIDEST).all()
        assert (own[np.abs(along - 2.0) > 1.5 * SPACING] == WIDEST).all()


def test_a_path_over_a_ledge_is_narrowed_before_and_behind_it_and_not_on_it():
    """A ledge of 0.3 m across the path at x = 4 m: `away` is how far it is."""
    wide = Corridor(*(np.full(len(along), WIDEST) for _ in range(3)))
    ground = np.column_stack([along, 0.0 * along, np.where(along < 4.0 - 1e-9, 0.0, 0.3)])
    away = np.tile(np.abs(along - 4.0)[:, None], (1, 33))
    found = beside_steps(wide, away, along, ground, (), np.ones((len(along), 2), dtype=bool))
    gap = np.abs(along - 4.0)
    on = gap < 1e-9
    for width in found:
        assert (width[on] == WIDEST).all()
    np.testing.assert_allclose(found.disc[~on], np.minimum(WIDEST, np.maximum(0.5 * gap, gap - HALF_PACE))[~on])


def test_a_path_that_begins_on_a_ledges_rim_keeps_off_it_on_every_storey():
    """The ledge is right beneath the first half metre, with other ground on its right: the path goes over none."""
    wide = Corridor(*(np.full(len(along), WIDEST) for _ in range(3)))
    places = SPACING * np.arange(-16, 17)  # from right to left
    away = np.abs(places) + np.where(along < 0.5, 0.0, 1.0)[:, None]
    falls = np.column_stack([np.zeros(len(along), bool), along < 0.5])
    for height in (0.0, 7.5, -30.0):
        ground = np.column_stack([along, 0.0 * along, np.full(len(along), height)])
        found = beside_steps(wide, away, along, ground, (), falls)
        np.testing.assert_array_equal(found.right[along < 0.5], 0.0)
        assert (found.right[along >= 0.5] > 0.0).all()
        assert (found.left > 0.0).all()


def test_on_a_narrow_landing_with_open_sides_half_of_its_width_is_left_beside_one():
    found = corridor_of_stairs()
    landing = (along > FLIGHT.end + 1.5 * SPACING) & (along < FLIGHT.end + 2.4)
    for width in found:
        assert (width[landing] <= 0.5 * HALF + 0.5 * SPACING + 1e-9).all()  # an edge is told by samples
        assert np.median(width[landing]) >= 0.5 * HALF - 0.5 * SPACING


def test_a_wide_floor_before_a_flight_is_as_wide_as_it_was():
    found = corridor_of_stairs()
    floor = (along > 0.6) & (along < FLIGHT.start - WIDEST - SPACING)
    for width in found:
        assert (width[floor] == WIDEST).all()


def test_far_before_and_behind_a_flight_the_corridor_is_as_it_was():
    found = corridor_of_stairs()
    for width in found:
        assert (width[along < FLIGHT.start - 2.6] == WIDEST).all()
        assert (width[along > FLIGHT.end + 2.6] == WIDEST).all()


@pytest.mark.parametrize("askew", [0.0, 10.0, -10.0, 40.0, -40.0])
def test_a_gate_stands_where_the_path_is_in_the_line_of_the_stairs(askew):
    wide = Corridor(*(np.full(len(along), WIDEST) for _ in range(3)))
    bend = 2.0  # before it the path comes askew
    heading = np.where(along < bend, np.radians(askew), 0.0)
    for width in through_gates(wide, along, heading, (FLIGHT,)):
        straight = (along > (bend if abs(askew) > 20 else FLIGHT.start - 2.5) + 1e-9) & (along < FLIGHT.start)
        assert (width[straight] == GATE).all()
        assert (width[along < (bend if abs(askew) > 20 else FLIGHT.start - 2.5) - 1e-9] == WIDEST).all()
        assert (width[(along > FLIGHT.start) & (along < FLIGHT.start + 0.59)] == GATE).all()
        assert (width[(along > FLIGHT.start + 0.61) & (along < FLIGHT.end - 0.61)] == WIDEST).all()
        assert (width[(along > FLIGHT.end) & (along < FLIGHT.end + 2.49)] == GATE).all()
        assert (width[along > FLIGHT.end + 2.51] == WIDEST).all()


@pytest.mark.parametrize("turn", [0.7, -2.0, 3.0])
def test_a_gate_stands_in_the_line_of_stairs_that_face_any_way(turn):
    wide = Corridor(*(np.full(len(along), WIDEST) for _ in range(3)))
    heading = np.where(along < 2.0, np.radians(40.0), 0.0)
    turned = dataclasses.replace(FLIGHT, enter=turn, leave=turn) if dataclasses.is_dataclass(FLIGHT) else FLIGHT
    for width, other in zip(
        through_gates(wide, along, heading, (FLIGHT,)),
        through_gates(wide, along, (heading + turn + np.pi) % (2 * np.pi) - np.pi, (turned,)),
        strict=True,
    ):
        np.testing.assert_array_equal(width, other)


def test_a_ledge_beside_a_path_is_told_on_its_side_half_a_pace_before_and_behind_it():
    """A platform of 0.3 m on the left, from x = 3 to 5 m, its side `gap` beside the path; a ditch on the right."""
    ground, heading = np.column_stack([along, 0.0 * along, 0.0 * along]), np.zeros(len(along))
    for side, gap, told in (
        (1.0, 0.3, True),
        (1.0, 0.45, False),
        (-1.0, 0.3, True),
        (1.0, 0.05, True),
        (-1.0, 0.05, True),
    ):

        def field(places, side=side, gap=gap):
            x, y, z = places.T
            on = (x >= 3.0 - 1e-9) & (x <= 5.0 + 1e-9) & (side * y >= gap - 1e-9)
            return np.where(on, np.abs(z - 0.3 * side), np.abs(z)), None

        found = other_ground(ground, heading, field)
        assert found.shape == (len(along), 2)
        beside = (along >= 3.0 - HALF_PACE + SPACING / 2) & (along <= 5.0 + HALF_PACE - SPACING / 2)
        far = (along < 3.0 - HALF_PACE - SPACING) | (along > 5.0 + HALF_PACE + SPACING)
        own, other = (0, 1) if side > 0 else (1, 0)
        assert found[beside, own].all() == found[beside, own].any() == told
        assert not found[far].any()
        assert not found[:, other].any()
    unknown = other_ground(ground, heading, None)
    assert unknown.all()
    assert unknown.shape == (len(along), 2)


def test_the_room_around_is_the_paths_own_less_an_arm_or_half_of_it():
    clear = np.array([0.0, 0.06, 0.2, 0.5, 2.0])
    places = scan(np.zeros((5, 3)), np.zeros(5), lambda places: np.full(len(places), 9.0))
    found = where_there_is_room(np.full(places.shape, 9.0), clear)
    np.testing.assert_allclose(found.disc, [0.0, 0.03, 0.1, 0.5 - ARM, 2.0 - ARM])
    np.testing.assert_allclose(found.left, np.maximum(found.disc, WIDEST))
    np.testing.assert_allclose(found.right, np.maximum(found.disc, WIDEST))


def test_on_a_ramp_the_edges_beside_it_are_kept_off_too():
    wide = Corridor(*(np.full(len(along), WIDEST) for _ in range(3)))
    ramp, falls = np.column_stack([along, 0.0 * along, 0.5 * along]), np.ones((len(along), 2), dtype=bool)
    places = scan(ramp, np.zeros(len(along)), wall_on_the_right)
    found = beside_steps(wide, places, along, ramp, (), falls)
    assert (found.right <= 0.5 * 0.5 + SPACING / 2).all()
    assert (found.left == WIDEST).all()


@pytest.mark.parametrize("heading", [0.0, 0.7, 2.0, -2.5])
def test_room_is_looked_at_from_right_to_left_whatever_the_heading(heading):
    left, place = np.array([-np.sin(heading), np.cos(heading), 0.0]), np.array([3.0, -2.0, 1.0])
    free = scan(place[None], np.array([heading]), lambda places: 1.0 + (places - place) @ left)[0]
    np.testing.assert_allclose(free, 1.0 + np.linspace(-WIDEST, WIDEST, 33))


def test_a_wall_on_one_side_narrows_that_side_alone():
    ground, room = np.column_stack([along, 0.0 * along, 0.0 * along]), wall_on_the_right
    free = scan(ground, np.zeros(len(along)), room)
    found = where_there_is_room(free, least_room(along, ground, along, room))
    np.testing.assert_allclose(found.right, 0.5 - 0.1, atol=SPACING / 2 + 1e-9)  # an arm's room is left beside it
    assert (found.left == WIDEST).all()
    back = scan(ground[::-1], np.full(len(along), np.pi), room)  # the way back has it on the other side
    np.testing.assert_allclose(where_there_is_room(back, back[:, back.shape[1] // 2]).left, found.right)


def wall_on_the_right(places):
    return np.maximum(places[:, 1] + 0.5, 0.0)


@pytest.mark.parametrize("at", [2.0, 2.03, 3.0, 4.55, 5.0])
def test_a_post_on_the_path_is_felt_at_the_sample_beside_it(at):
    s = np.arange(2.0, 5.0 + SPACING / 2, SPACING)
    path = np.column_stack([along, 0.0 * along, 0.0 * along])
    found = least_room(s, path, along, lambda places: np.hypot(places[:, 0] - at, places[:, 1]))
    exact = np.maximum(np.abs(s - at) - SPACING / 2, 0.0)
    np.testing.assert_allclose(found, exact, atol=SPACING / 10 + 1e-9)  # it is asked every 2 cm


def test_the_middle_is_the_least_move_that_gives_elbow_room_or_as_much_on_both_sides():
    rng = np.random.default_rng(0)
    left, right = rng.uniform(0.0, 0.8, (2, 200))
    found = middle_of(Corridor(np.zeros(200), left, right))
    moves = np.linspace(-0.8, 0.8, 3201)
    for a, b, shift in zip(left, right, found, strict=True):
        least = np.minimum(np.minimum(a - moves, b + moves), ELBOW_ROOM)
        best = moves[least >= least.max() - 1e-9]
        assert shift == pytest.approx(best[np.abs(best).argmin()], abs=1e-3)


def test_steps_that_are_passed_are_kept_off_but_by_the_flight_that_is_climbed():
    wide = Corridor(*(np.full(len(along), WIDEST) for _ in range(3)))
    ground, falls = np.column_stack([along, 0.0 * along, 0.0 * along]), np.ones((len(along), 2), dtype=bool)
    places = scan(ground, np.zeros(len(along)), wall_on_the_right)
    flight = dataclasses.replace(FLIGHT, start=5.0, end=5.5)
    found = beside_steps(wide, places, along, ground, (flight,), falls)
    near = (along >= 5.0 - BESIDE_STAIRS) & (along <= 5.5 + BESIDE_STAIRS)
    assert (found.right[near] == WIDEST).all()
    assert (found.right[~near] <= 0.5 * 0.5 + SPACING / 2).all()
    assert (found.left == WIDEST).all()

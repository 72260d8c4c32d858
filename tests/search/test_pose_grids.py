"""The grids of poses and the motions over them, beside the plain definitions."""

from itertools import product
from math import atan2, ceil, cos, hypot, pi, sin

import numpy as np
import pytest

from gpdf_service.fields import build_tree
from gpdf_service.search.lattice import (
    CELL_SHARES,
    COARSEST,
    DETOURS,
    NEARLY,
    _between,
    _Body,
    _goals,
    _grid,
    _grids,
    _moves,
    _poses_in,
    _starts,
    _stuck,
    _touching,
    find_poses,
    moving,
)
from gpdf_service.search.places import Places, is_motion_clear
from gpdf_service.search.poses import TURNS, Grid, field_of, spread
from gpdf_service.tiles.surface import OBSERVED, HeightMap

BODY = _Body(np.array([-0.3, 0.0, 0.3]), 0.15)
WAY = np.array([[3.0, 4.0], [4.0, 4.0], [4.0, 5.0]])
ANYWHERE = Places(build_tree(np.array([[-50.0, -50.0]])))


def floor(size, origin=(0.0, 0.0), width=0.1):
    shape = tuple(int(n / width) for n in size)
    return HeightMap(np.array(origin), width, np.zeros(shape, np.float32), np.full(shape, OBSERVED, np.uint8))


def far_end(grid):
    return grid.origin + grid.width * (np.array(grid.shape) - 1)


@pytest.mark.parametrize("detour", DETOURS)
def test_a_grid_holds_every_detour_and_has_the_start_on_a_cell(detour):
    grid = _grid(floor((80.0, 80.0), (-40.0, -40.0)), WAY, BODY, detour, 0.05)
    cells = (WAY[0] - grid.origin) / grid.width
    np.testing.assert_allclose(cells, np.round(cells), atol=1e-6)
    longest = detour[0] * 2.0 + detour[1]  # the way is 2 m long
    for angle in np.linspace(0.0, 2.0 * pi, 48):
        low, high = 0.0, longest
        for _ in range(60):  # how far one gets this way and back to the goal
            out = 0.5 * (low + high)
            there = WAY[0] + out * np.array([cos(angle), sin(angle)])
            low, high = (out, high) if out + hypot(*(there - WAY[-1])) <= longest else (low, out)
        there = np.clip(WAY[0] + low * np.array([cos(angle), sin(angle)]), -40.0, 40.0)
        assert (there >= grid.origin - 1e-6).all()
        assert (there <= far_end(grid) + 1e-6).all()
    assert ((WAY[0] + WAY[-1]) / 2 - 0.5 * longest - 3 * grid.width <= grid.origin).all()  # and hardly more
    assert (far_end(grid) <= (WAY[0] + WAY[-1]) / 2 + 0.5 * longest + 3 * grid.width).all()


def test_a_grid_ends_where_the_ground_does():
    grid = _grid(floor((6.0, 7.0)), WAY, BODY, (2.0, 30.0), 0.05)
    assert (np.abs(grid.origin) <= grid.width).all()
    assert (np.abs(far_end(grid) - (6.0, 7.0)) <= grid.width).all()


@pytest.mark.parametrize("width", [0.03, 0.075, 0.2])
def test_an_end_goes_a_cell_at_most_from_heading_to_heading(width):
    turns = _grid(floor((8.0, 8.0)), WAY, BODY, DETOURS[0], width).turns
    assert turns % 8 == 0  # so that north, east and the ways between them are headings
    assert 2.0 * pi / turns * 0.3 <= width < 2.0 * pi / max(turns - 8, 1e-9) * 0.3


def test_grids_grow_and_one_that_is_nearly_the_next_one_is_left_out():
    large = floor((80.0, 50.0), (-40.0, -20.0))
    grids, whole = _grids(large, WAY, BODY, 2**40)
    assert whole
    widths = [share * BODY.radius for share in CELL_SHARES]
    assert [grid.width for grid in grids] == [*widths, *widths]
    for near, far in zip(grids[:2], grids[2:], strict=True):
        assert NEARLY * _poses_in(near) < _poses_in(far)
    small, whole = _grids(floor((6.0, 7.0)), WAY, BODY, 2**40)
    assert whole
    assert [grid.width for grid in small] == widths  # the detours end where the ground does


def test_with_little_room_there_are_fewer_grids_then_a_coarse_one_then_none():
    large = floor((80.0, 50.0), (-40.0, -20.0))
    every, _ = _grids(large, WAY, BODY, 2**40)
    sizes = sorted(map(_poses_in, every))
    assert _poses_in(Grid(np.zeros(2), 0.1, (3, 5), 8)) == 3 * 5 * 8
    for most in (sizes[-1] - 1, sizes[1], sizes[0]):
        grids, whole = _grids(large, WAY, BODY, most)
        assert not whole
        assert grids
        assert max(map(_poses_in, grids)) <= most
    assert _poses_in(_grids(large, WAY, BODY, sizes[0])[0][-1]) == sizes[0]  # the most that may be
    (coarse,), whole = _grids(large, WAY, BODY, sizes[0] - 1)
    assert not whole
    assert coarse.width == COARSEST * BODY.radius
    assert _grids(large, WAY, BODY, _poses_in(coarse))[0][0].shape == coarse.shape
    assert _grids(large, WAY, BODY, _poses_in(coarse) - 1) == ([], False)


@pytest.mark.parametrize("turns", [8, 24, 40])
def test_moves_are_turns_and_steps_ahead_that_cost_their_length(turns):
    made = _moves(Grid(np.zeros(2), 0.1, (5, 5), turns))
    steps = {(i, j): c for i, j in product(range(-2, 3), repeat=2) if (c := {1: 4, 2: 6, 5: 9}.get(i * i + j * j))}
    for h in range(turns):
        assert made[h, :TURNS].tolist() == [[0, 0, -1, 4], [0, 0, 1, 4]]
        moves = {tuple(move[:2]): move[2:] for move in made[h, TURNS:].tolist() if move[3]}
        heading = 2.0 * pi * h / turns
        ahead = {
            step
            for step in steps
            if abs(atan2(sin(atan2(*step[::-1]) - heading), cos(atan2(*step[::-1]) - heading))) <= atan2(1, 2) + 1e-6
        }
        assert moves == {step: [0, steps[step]] for step in ahead}
        assert len(ahead) >= 2  # between two directions it can go along either
    for (i, j), cost in steps.items():
        assert cost == pytest.approx(4.0 * hypot(i, j), rel=0.07)
    assert made.shape[1] == TURNS + max(int((made[h, TURNS:, 3] > 0).sum()) for h in range(turns))


def test_poses_that_repeat_are_left_out_but_two_stay():
    poses = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.0, 0.5]])
    np.testing.assert_array_equal(moving(poses), poses[[0, 2, 4]])
    np.testing.assert_array_equal(moving(poses[:2]), poses[:2])
    small = np.array([[0.0, 0.0, 0.0], [0.0, 1e-8, 0.0], [1.0, 0.0, 0.0]])
    np.testing.assert_array_equal(moving(small), small)


def test_a_way_begins_and_ends_facing_as_asked_the_short_way_round():
    poses = np.array([[0.0, 0.0, 0.2], [1.0, 0.0, 0.4]])
    free = _between(poses, WAY, (None, None))
    np.testing.assert_allclose(free, [*poses, [*WAY[-1], 0.4]])
    asked = _between(poses, WAY, (2.0 * pi - 0.3, 2.0 * pi + 1.0))
    np.testing.assert_allclose(asked, [[0.0, 0.0, -0.3], *poses, [*WAY[-1], 0.4], [*WAY[-1], 1.0]])


def obstacle_at(*places):
    return Places(build_tree(np.array(places)))


GRID = Grid(np.array([0.1, 0.2]), 0.1, (20, 15), 24)
POSTS = obstacle_at((0.9, 0.9), (1.4, 0.6))


@pytest.mark.parametrize("facing", [np.nan, 2.2, 6.2])
def test_starts_are_the_headings_that_it_faces_or_turns_to_next(facing):
    place = np.array([1.1, 1.2])
    want = []
    for h in range(24):
        angle = 2.0 * pi * h / 24
        turn = 0.0 if np.isnan(facing) else atan2(sin(facing - angle), cos(facing - angle))
        to, begin = np.array([*place, angle]), np.array([*place, angle + turn])
        if abs(turn) <= 2.0 * pi / 24 and is_motion_clear(POSTS, begin, to, *BODY):
            want.append([h, 10, 10])
    assert want
    assert _starts(POSTS, GRID, place, facing, BODY).tolist() == want
    assert np.isnan(facing) == (len(want) > 2)


@pytest.mark.parametrize("facing", [np.nan, 2.2])
@pytest.mark.parametrize("goal", [(1.13, 1.27), (0.13, 0.22), (1.97, 1.58)])
def test_goals_are_the_poses_beside_it_from_which_it_goes_there_as_it_is(facing, goal):
    want = set()
    for h, i, j in product(range(24), range(20), range(15)):
        pose = np.array([0.1 + 0.1 * i, 0.2 + 0.1 * j, 2.0 * pi * h / 24])
        if not (np.abs(pose[:2] - goal) < 0.1).all():
            continue
        there = np.array([*goal, pose[2]])
        turn = 0.0 if np.isnan(facing) else atan2(sin(facing - pose[2]), cos(facing - pose[2]))
        last = np.array([*goal, pose[2] + turn])
        if all(is_motion_clear(POSTS, *pair, *BODY) for pair in ((there, last), (pose, there))):
            want.add((h, i, j))
    assert want
    found = _goals(POSTS, GRID, np.array(goal), facing, BODY)
    assert {tuple(one) for one in found.tolist()} == want
    assert len(found) == len(want)


def test_what_is_not_got_to_clear_is_told():
    poses = np.array([[0.4, 0.2, 0.0], [0.5, 0.2, 0.0], [1.3, 0.7, 0.0], [0.5, 0.2, 0.0], [0.4, 0.2, 0.0]])
    assert _touching(POSTS, poses, BODY).tolist() == [2, 3]
    assert _touching(POSTS, poses[1:], BODY).tolist() == [1, 2]
    assert _touching(ANYWHERE, poses, BODY).tolist() == []


@pytest.mark.parametrize(("origin", "heading"), [((0.0, 0.0), 0), ((-3.0, 7.0), 3)])
def test_it_is_stuck_where_the_way_comes_to_what_the_waves_reached(origin, heading):
    shape, grid = (40, 5), Grid(np.array(origin), 0.1, (40, 5), 8)
    free = np.full((8, *shape), 1, dtype=bool)
    free[:, 20] = free[:heading] = False  # a wall; there is no room to face some ways
    field = field_of(
        np.packbits(np.pad(free, ((0, 0), (0, 0), (0, 59))), axis=-1, bitorder="little").view(np.uint64), 5
    )
    assert spread(field, _moves(grid), np.array([[heading, 35, 2]]), np.zeros((0, 3), np.int64)) == -1
    way = np.array([[0.5, 0.2], [1.5, 0.2], [3.5, 0.2]]) + origin
    at = _stuck(field, grid, way)
    np.testing.assert_allclose(at[:2] - origin, [2.1, 0.2], atol=0.051)
    assert at[2] == pytest.approx(2.0 * pi * heading / 8)  # the first heading that gets on
    np.testing.assert_allclose(_stuck(field, grid, way[:2]), [*way[1], 0.0])


def test_without_room_for_any_grid_the_search_gives_up_at_the_start():
    found = find_poses(ANYWHERE, floor((8.0, 8.0)), WAY, (0.5, None), *BODY, most=1)
    assert (found.reached, found.given_up) == (False, True)
    np.testing.assert_allclose(found.poses, [[*WAY[0], 0.5]])


def test_a_wall_is_no_reason_to_give_up_and_a_small_grid_is_one():
    wall = Places(build_tree(np.column_stack([np.full(400, 3.5), np.linspace(0.0, 8.0, 400)])))
    large = floor((8.0, 8.0))
    way = np.array([[2.0, 4.0], [5.0, 4.0]])
    found = find_poses(wall, large, way, (None, None), *BODY)
    assert (found.reached, found.given_up) == (False, False)
    assert found.poses.shape == (1, 3)
    assert 3.5 <= found.poses[0, 0] <= 4.2  # the first place behind the wall from which it gets on
    less = _poses_in(_grid(large, way, BODY, DETOURS[0], ceil(1.0) * BODY.radius))
    assert find_poses(wall, large, way, (None, None), *BODY, most=less).given_up

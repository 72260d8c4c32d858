import heapq
from itertools import pairwise

import numpy as np
import pytest

from gpdf_service.fields import build_tree
from gpdf_service.search.lattice import _Body, _grid, _moves, find_poses
from gpdf_service.search.places import Places, is_motion_clear
from gpdf_service.search.poses import Grid, field_of, follow, free_poses, is_reached, lowest, row_of, spread
from gpdf_service.tiles.surface import OBSERVED, UNKNOWN, Cells

OFFSETS, RADIUS = np.array([-0.3, 0.0, 0.3]), 0.15


def ground(size=(3.0, 3.0), width=0.1):
    shape = tuple(int(n / width) for n in size)
    return Cells(np.zeros(shape), np.full(shape, OBSERVED, np.uint8), np.zeros(2), width)


def pillars(rng, count=25, size=3.0):
    return Places(build_tree(rng.uniform(0.0, size, (count, 2))))


def bits(free, cells):
    """As booleans, (headings, nx, ny)."""
    return np.unpackbits(free.view(np.uint8), axis=-1, bitorder="little")[..., :cells].astype(bool)


def least_room(obstacles, grid):
    """Distance of the nearest disc to an obstacle at each pose, less the radius."""
    h, i, j = np.indices((grid.turns, *grid.shape))
    x, y, angle = grid.origin[0] + i * grid.width, grid.origin[1] + j * grid.width, 2 * np.pi * h / grid.turns
    points, room = obstacles.standing.points, np.full(h.shape, np.inf)
    for offset in OFFSETS:
        at = np.stack([x + offset * np.cos(angle), y + offset * np.sin(angle)], axis=-1)
        for point in points:
            room = np.minimum(room, np.linalg.norm(at - point, axis=-1))
    return room - RADIUS


def test_the_lowest_bit_of_a_word_is_told():
    for b in range(64):
        assert lowest(np.uint64(1 << b | 1 << 63)) == b


@pytest.mark.parametrize("seed", range(4))
def test_a_pose_is_free_where_its_discs_keep_their_distance_and_nowhere_else(seed):
    obstacles = pillars(np.random.default_rng(seed))
    grid = Grid(np.array([0.1, 0.1]), 0.04, (70, 70), 48)
    free, room = bits(free_poses(obstacles, ground(), grid, OFFSETS, RADIUS), 70), least_room(obstacles, grid)
    asked = grid.width**2 / (4 * RADIUS)  # for a step of the grid
    assert room[free].min() > asked - 0.003
    assert free[room > asked + 1e-6].all()
    assert 0.02 < free.mean() < 0.9


def test_no_pose_is_free_where_the_ground_is_not_known():
    floor = ground()
    floor.state[15:] = UNKNOWN
    grid = Grid(np.array([0.1, 0.1]), 0.04, (70, 70), 48)
    free = bits(free_poses(pillars(np.random.default_rng(0), 1), floor, grid, OFFSETS, RADIUS), 70)
    beyond = grid.origin[0] + 0.04 * np.arange(70) > 1.5
    assert not free[:, beyond].any()
    assert free[:, ~beyond].any()


def test_what_moves_is_in_the_way_of_poses_too():
    moving = Places(build_tree(np.array([[-9.0, -9.0]])), build_tree(np.array([[1.0, 1.0]])))
    grid = Grid(np.array([0.1, 0.1]), 0.04, (70, 70), 48)
    free = bits(free_poses(moving, ground(), grid, OFFSETS, RADIUS), 70)
    near = np.hypot(*(grid.origin[:, None, None] + 0.04 * np.indices((70, 70)) - 1.0)) < RADIUS
    assert not free[:, near].any()
    assert free[:, ~near].any()


def dijkstra(free, moves, goal):
    """Cost of the way from each pose to the goal."""
    come = {goal: 0}
    frontier = [(0, goal)]
    while frontier:
        cost, (h, i, j) = heapq.heappop(frontier)
        if cost > come[h, i, j]:
            continue
        for di, dj, turn, price in moves[h].tolist():
            before = ((h - turn) % len(moves), i - di, j - dj)
            if price == 0 or not all(0 <= n < size for n, size in zip(before, free.shape, strict=True)):
                continue
            between = [(h, i - int(di / 2), j - int(dj / 2)), (h, i - np.sign(di), j - np.sign(dj))]
            passed = all(free[pose] for pose in between) if abs(di) + abs(dj) == 3 else True
            if free[before] and passed and cost + price < come.get(before, np.inf):
                come[before] = cost + price
                heapq.heappush(frontier, (cost + price, before))
    return come


@pytest.mark.parametrize("seed", range(3))
def test_waves_reach_what_dijkstra_reaches_at_the_same_cost(seed):
    obstacles = pillars(np.random.default_rng(seed))
    grid = Grid(np.array([0.1, 0.1]), 0.075, (37, 37), 24)
    free, moves = free_poses(obstacles, ground(), grid, OFFSETS, RADIUS), _moves(grid)
    flags = bits(free, 37)
    goal = tuple(int(n) for n in np.argwhere(flags)[len(np.argwhere(flags)) // 2])
    come = dijkstra(flags, moves, goal)
    field, nowhere = field_of(free, 37), np.zeros((0, 3), np.int64)
    assert spread(field, moves, np.array([goal]), nowhere) == -1
    reached = {tuple(pose) for pose in np.argwhere(flags).tolist() if is_reached(field, row_of(field, np.array(pose)))}
    assert reached == set(come)
    for pose in list(come)[:: max(1, len(come) // 50)]:
        states = follow(field, moves, np.array(pose))
        assert tuple(states[-1]) == goal
        cost = 0
        for a, b in pairwise(states):
            change = b - a
            change[0] = (change[0] + 12) % 24 - 12
            cost += min(m[3] for m in moves[a[0]].tolist() if m[3] and [m[2], m[0], m[1]] == change.tolist())
        assert cost == come[pose]


def test_a_start_ends_the_waves_and_says_which():
    free = np.full((8, 5, 1), 31, np.uint64)
    grid = Grid(np.zeros(2), 0.1, (5, 5), 8)
    field = field_of(free, 5)
    assert spread(field, _moves(grid), np.array([[0, 4, 2]]), np.array([[4, 0, 2], [0, 2, 2]])) == 1
    assert not is_reached(field, row_of(field, np.array([0, 0, 2])))


@pytest.mark.parametrize("seed", range(4))
def test_every_way_that_is_found_is_clear_and_leads_from_start_to_goal(seed):
    rng = np.random.default_rng(seed)
    obstacles, floor = pillars(rng), ground()

    class Surface:
        arrays, origin, cell_width, height = floor, floor.origin, floor.width, floor.height

    found = [
        find_poses(obstacles, Surface, way, (None, None), OFFSETS, RADIUS) for way in rng.uniform(0.3, 2.7, (12, 2, 2))
    ]
    assert any(one.reached for one in found)
    for one in found:
        if one.reached:
            for a, b in pairwise(one.poses):
                assert is_motion_clear(obstacles, a, b, OFFSETS, RADIUS)
        else:
            assert not one.given_up


def test_a_search_with_little_time_looks_at_a_coarse_grid_and_does_not_say_that_there_is_no_way():
    obstacles, floor = pillars(np.random.default_rng(1), 6), ground()

    class Surface:
        arrays, origin, cell_width, height = floor, floor.origin, floor.width, floor.height

    way = np.array([[0.4, 1.5], [2.6, 1.5]])
    fine = _grid(Surface, way, _Body(OFFSETS, RADIUS), (2.0, 30.0), 0.25 * RADIUS)
    for most in (fine.shape[0] * fine.shape[1] * fine.turns // 2, 10):
        found = find_poses(obstacles, Surface, way, (None, None), OFFSETS, RADIUS, most=most)
        assert found.reached or found.given_up
    assert not found.reached

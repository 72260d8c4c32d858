"""A map that was changed in one place is filled as one that is looked at as a whole, and most of it is not asked."""

import numpy as np
import pytest

from gpdf_service.config import PerceptionConfig
from gpdf_service.perception.holes import fill_holes
from gpdf_service.perception.voids import Voids
from gpdf_service.tiles.boxes import highest_around
from gpdf_service.tiles.surface import INFERRED, OBSERVED, UNKNOWN, HeightMap, nearest_seen
from gpdf_service.tiles.told import boxes_of, grown, new_grid

CELLS, WIDTH = (260, 240), 0.06


def place(rng, rough=0.003):
    """Floors that flights join, with gaps, holes and things: heights, NaN where unseen, and what is over and under."""
    x, y = np.indices(CELLS)
    height = 0.17 * np.clip((x - 100) // 5, 0, 8) + 0.15 * np.clip((y - 150) // 6, 0, 4)
    height = height + rng.normal(0.0, rough, CELLS)
    height[rng.random(CELLS) < 0.02] = np.nan
    for _ in range(150):
        (i, j), (u, v) = rng.integers(0, CELLS), rng.integers(1, 16, 2)
        height[i : i + u, j : j + v] = np.nan
    material, hollow = np.zeros((2, *CELLS), dtype=bool)
    through, pit, walls = (rng.random(CELLS) < share for share in (0.001, 0.001, 0.002))
    for _ in range(60):
        (i, j), (u, v) = rng.integers(0, CELLS), rng.integers(2, 12, 2)
        material[i : i + u, j : j + v] = True
    for _ in range(3):
        (i, j), (u, v) = rng.integers(0, CELLS), rng.integers(1, 6, 2)
        hollow[i : i + u, j : j + v] = True
    at_floor = material & (rng.random(CELLS) < 0.1)
    return height.astype(np.float32), material, at_floor, through, pit, walls, hollow


def fill(grid, height, *others):
    state = np.where(np.isnan(height), UNKNOWN, OBSERVED).astype(np.uint8)
    seen, (material, at_floor, *voids) = HeightMap(np.zeros(2), WIDTH, height, state), others
    things, limits = (material, at_floor, material), PerceptionConfig()
    return fill_holes(seen, grid, nearest_seen(seen), things, Voids(*voids), limits, 0.0)


@pytest.mark.parametrize("seed", range(12))
def test_a_change_fills_holes_notches_and_gaps_as_a_build_does(seed):
    """On smooth treads what is filled is as high as what was seen there before."""
    rng, rough = np.random.default_rng(seed), 0.003 * (seed < 6)
    before = place(rng, rough)
    grid = new_grid(CELLS)
    was = fill(grid, *before)
    for _ in range(3):
        i, j = (rng.integers(0, size - 17) for size in CELLS)
        here, others = (slice(i, i + 17), slice(j, j + 17)), np.zeros(CELLS, dtype=bool)
        others[here] = True
        now = tuple(np.where(others, new, old) for new, old in zip(place(rng, rough), before, strict=True))
        grid = grid.lasting().now(others)
        ours, theirs = fill(grid, *now), fill(new_grid(CELLS), *now)
        np.testing.assert_array_equal(ours.height, theirs.height)
        np.testing.assert_array_equal(ours.state, theirs.state)
        assert (ours.state != was.state).any()
        for name, reach in (("notches", 55), ("holes under planes", 2), ("gaps", 8)):
            assert 0 < grid.felt(name, reach, *grid.known[name].given).mean() < 0.5
        before, was = now, ours


def test_a_hole_is_filled_as_before_where_changes_on_all_sides_do_not_touch_it():
    """Then a box that holds what changed holds the whole map, and most of that is not asked."""
    height, none = np.full(CELLS, np.nan, np.float32), np.zeros((6, *CELLS), dtype=bool)
    height[4:-4, 4:-4] = 0.0
    height[100:110, 100:110] = np.nan
    grid, others = new_grid(CELLS), np.zeros(CELLS, dtype=bool)
    fill(grid, height, *none)
    others[4:8, 4:8] = others[-8:-4, -8:-4] = True
    height = np.where(others, np.float32(np.nan), height)
    ours, theirs = fill(grid.lasting().now(others), height, *none), fill(new_grid(CELLS), height, *none)
    np.testing.assert_array_equal(ours.state, theirs.state)
    assert (ours.state[100:110, 100:110] == INFERRED).all()


def test_what_asks_all_cells_is_asked_again_where_it_is_given_another_object():
    asked, one = [], np.zeros((3, 3))

    def answer(given):
        asked.append(given)
        return (given + 1.0,)

    grid = new_grid((3, 3))
    made = grid.whole("all", answer, one)
    now = grid.lasting().now(grid.others)
    assert now.whole("all", answer, one) is made
    assert now.known == grid.known
    assert now.lasting().now(grid.others).whole("all", answer, one + 1.0)[0].tolist() == [[2.0] * 3] * 3
    assert len(asked) == 2


def test_boxes_hold_all_cells_and_one_is_taken_where_several_would_overlap_more():
    cells = np.zeros((300, 300), dtype=bool)
    cells[120:136, 120:136] = True  # over the corners of tiles, from the first cell on
    cells[0, 0] = True
    far = boxes_of(cells, 2)
    held = np.zeros_like(cells)
    for box in far:
        held[box] = True
    assert held[cells].all()
    assert held.sum() < 2 * cells.sum()
    cells[0, 0] = False
    cells[100:240, 100:240] = True
    assert len(boxes_of(cells, 0)) > 1
    assert boxes_of(cells, 40) == [(slice(100, 240), slice(100, 240))]
    assert boxes_of(np.zeros((9, 9), dtype=bool), 3) == []
    assert grown((slice(2, 4), slice(7, 9)), 3, (9, 9)) == (slice(0, 7), slice(4, 9))


@pytest.mark.parametrize("seed", range(8))
def test_a_box_that_moves_is_told_as_a_fresh_one_and_asks_only_at_its_new_sides(seed):
    """What lies outside of a box decides on nothing, so an answer at its side is another where that has moved."""
    rng = np.random.default_rng(seed)
    values, kinds, reach = rng.normal(size=(150, 140)).astype(np.float32), rng.random((150, 140)) < 0.1, 3
    asked = []

    def answer(box, height, kind):
        asked.append(height.size)
        lowest = np.where(kind, -9.0, height).astype(np.float32)
        return -highest_around(-lowest, reach), highest_around(kind.view(np.uint8), reach).view(bool)

    def told(grid, box, others):
        grid = grid.now(others)
        return grid, grid.around("lowest", reach, answer, values[box], kinds[box], points=True)

    first, size = rng.integers(20, 40, 2), rng.integers(80, 90, 2)
    grid = told(new_grid(tuple(size)), box_of(first, size), np.zeros(size, dtype=bool))[0]
    for _ in range(4):
        by, shape = rng.integers(-8, 8, 2) * rng.integers(0, 2, 2), rng.integers(75, 95, 2)
        first, size, grid = first + by, shape, grid.lasting().moved(tuple(by.tolist()), tuple(shape.tolist()))
        assert grid.others.any()
        asked.clear()
        grid, ours = told(grid, box_of(first, size), grid.others)
        assert sum(asked) < 0.9 * size.prod() + 4000
        theirs = told(new_grid(tuple(size)), box_of(first, size), np.zeros(size, dtype=bool))[1]
        for one, other in zip(ours, theirs, strict=True):
            np.testing.assert_array_equal(one, other)


def box_of(first, size):
    rows, columns = (slice(int(a), int(a + n)) for a, n in zip(first, size, strict=True))
    return rows, columns

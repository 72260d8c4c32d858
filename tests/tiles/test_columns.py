"""The compiled loops over points and cells against the obvious ones."""

import numpy as np
import pytest
from scipy import ndimage
from scipy.spatial import cKDTree

from gpdf_service.ground.level import within_reach
from gpdf_service.ground.limits import median_around
from gpdf_service.perception.cloud import find_strays
from gpdf_service.perception.voids import find_rims, find_voids
from gpdf_service.tiles.boxes import highest_around, lowest_around, widened
from gpdf_service.tiles.columns import by_cell, ends_of_runs, unlike_cells
from gpdf_service.tiles.layers import build_layers, nodes_of, splice_layers
from gpdf_service.tiles.rows import (
    between,
    bounds_of,
    cells_of,
    chosen_rows,
    extent_within,
    more_now,
    rows_by_cell,
    rows_in_cells,
    rows_spliced,
    taken,
)
from gpdf_service.tiles.surface import HeightMap, cells_within, nearest_seen
from gpdf_service.tiles.width import kth_beside

CORNER, WIDTH, SHAPE = np.array([-1.0, -2.0]), 0.3, (21, 14)


@pytest.fixture(scope="module")
def points():
    return np.random.default_rng(0).uniform([-0.9, -1.9, 0.0], [5.0, 2.0, 2.0], (4000, 3))


def test_cells_boxes_and_bounds_are_those_of_numpy(points):
    x, y = np.floor((points[:, :2] - CORNER) / WIDTH).astype(int).T
    cell = cells_of(points, CORNER, WIDTH, SHAPE)
    np.testing.assert_array_equal(cell, x * SHAPE[1] + y)
    chosen = points[:, 2] > 1.0
    for gone in (~chosen, np.zeros_like(chosen), np.ones_like(chosen)):
        stay = np.concatenate([points[~gone], points[:5]])
        np.testing.assert_array_equal(rows_spliced(points, np.flatnonzero(gone), points[:5]), stay)
    np.testing.assert_array_equal(bounds_of(points), (points[:, :2].min(axis=0), points[:, :2].max(axis=0)))
    np.testing.assert_array_equal(bounds_of(points, chosen), bounds_of(points[chosen]))
    np.testing.assert_array_equal(chosen_rows(points, chosen), points[chosen])
    np.testing.assert_array_equal(chosen_rows(points, chosen, points[:5]), np.concatenate([points[chosen], points[:5]]))
    wanted = np.random.default_rng(1).random(SHAPE[0] * SHAPE[1]) < 0.2
    start, order = by_cell(cell, wanted.size)
    rows = np.sort(order[rows_by_cell(wanted.reshape(SHAPE), start)])
    np.testing.assert_array_equal(rows, np.flatnonzero(wanted[cell]))
    np.testing.assert_array_equal(rows_in_cells(points, CORNER, WIDTH, wanted.reshape(SHAPE)), rows)
    assert len(rows_in_cells(points, CORNER, WIDTH, np.zeros(SHAPE, dtype=bool))) == 0
    np.testing.assert_array_equal(taken(points, rows), points[rows])


def test_points_are_between_the_bounds_of_their_cells_and_outside_of_the_grid_in_none(points):
    rng, z = np.random.default_rng(3), points[:, 2]
    cell = rng.integers(0, 13, len(points))  # twelve cells, and outside
    low, high = rng.uniform(0.0, 1.0, (3, 4)), rng.uniform(1.0, 2.0, (3, 4))
    own = np.minimum(cell, 11)
    expected = (cell < 12) & (z > low.ravel()[own]) & (z <= high.ravel()[own])
    np.testing.assert_array_equal(between(cell, z, low, high), expected)
    least, most = extent_within(cell, z, low, high)
    for c in range(12):
        held = z[expected & (cell == c)]
        assert (least.ravel()[c], most.ravel()[c]) == (held.min(), held.max())


def test_points_that_are_in_no_cell_are_to_a_level_as_if_they_were_not_there(points):
    rng = np.random.default_rng(4)
    height = rng.uniform(0.9, 1.1, SHAPE).astype(np.float32)
    height[5:12, 4:9] = np.nan
    surface = HeightMap(CORNER, WIDTH, height, np.isfinite(height).astype(np.uint8))
    gone = rng.random(len(points)) < 0.5
    cell, rest = cells_within(points, surface), points[~gone]
    cell[gone] = surface.state.size
    assert 0 < len(within_reach(rest, surface)) < len(rest)
    near, treads, rim = nearest_seen(surface), np.isfinite(height) & (height > 1.05), find_rims(surface)
    held = (cell, points[:, 2]), (cells_within(rest, surface), rest[:, 2])
    voids = [find_voids(surface, near, treads, rim, *own, 0.2) for own in held]
    assert all(found.any() for found in voids[0][1:])
    for one, other in zip(*voids, strict=True):
        np.testing.assert_array_equal(one, other)


def test_what_is_there_more_often_now_is_counted():
    key = np.random.default_rng(0).integers(0, 60, 300).astype(np.uint64) << np.uint64(40)  # none differ in a low bit
    before, after = key[:120].tolist(), key[120:].tolist()
    assert more_now(key, 120).tolist() == [after.count(k) - before.count(k) for k in key.tolist()]
    assert more_now(key[:0], 0).tolist() == []


def test_a_place_outside_a_height_map_has_the_cell_next_to_it_and_no_number_has_the_first():
    surface = HeightMap(np.zeros(2), 0.5, np.zeros((4, 3), np.float32), np.ones((4, 3), np.uint8))
    ix, iy, inside = surface.cells(np.array([[0.7, 0.2], [-3.0, 9.0], [1e30, 1.4], [np.nan, 0.6]]))
    assert ix.tolist() == [1, 0, 3, 0]
    assert iy.tolist() == [0, 2, 2, 1]
    assert inside.tolist() == [True, False, False, False]


def test_the_extent_of_a_cell_is_over_its_low_and_not_over_its_high(points):
    cell, z = np.arange(4) % 2, np.array([0.0, 0.5, 1.0, 1.5])
    low, high = extent_within(cell, z, np.array([0.0, 0.5]), np.array([1.0, np.inf]))
    assert (low.tolist(), high.tolist()) == ([1.0, 1.5], [1.0, 1.5])
    low, high = extent_within(cell, z, np.full(2, 5.0), np.full(2, 6.0))
    assert np.isposinf(low).all()
    assert np.isneginf(high).all()


def test_the_kth_neighbour_is_that_of_a_tree(points):
    cell = cells_of(points, CORNER, WIDTH, SHAPE)
    picked, found = np.arange(0, len(points), 7), np.empty(len(range(0, len(points), 7)))
    kth_beside(points, by_cell(cell, SHAPE[0] * SHAPE[1]), (CORNER, WIDTH, SHAPE), picked, 4, found)
    true = cKDTree(points).query(points[picked], k=5)[0][:, 4]
    near = true <= WIDTH
    assert near.mean() > 0.5
    np.testing.assert_allclose(found[near], true[near])
    assert (found[~near] > WIDTH).all()


def test_the_ends_of_runs_are_the_lowest_first_and_the_highest_last():
    key, z = np.array([2, 1, 2, 1, 2]), np.array([0.3, 0.1, 0.3, 0.1, 0.2])
    ends = ends_of_runs(key, np.array([3, 1, 4, 2, 0]), z)
    assert ends.tolist() == [1, 3, 4, 2]


def highest_band(z):
    """The middle of the highest 4 cm that hold a quarter as many heights as any 4 cm do; z is sorted."""
    most = max(int(((z <= top) & (z >= top - 0.04)).sum()) for top in z)
    for top in z[::-1]:
        band = z[(z <= top) & (z >= top - 0.04)]
        if 4 * len(band) >= most:
            return band[len(band) // 2]
    raise AssertionError("the fullest band is one")


def test_columns_are_cut_as_by_hand():
    rng = np.random.default_rng(3)
    points = rng.uniform([0, 0, 0], [2, 2, 3], (500, 3))
    layers = build_layers(points, 0.25, 0.2)
    middle, node_of = layers.taken(np.arange(len(layers.cell))).middle, nodes_of(layers, points)
    x, y = np.floor((points[:, :2] - layers.origin) / 0.25).astype(int).T
    cell, node = x * layers.shape[1] + y, 0
    for column in np.unique(cell):
        rows = np.flatnonzero(cell == column)
        rows = rows[np.argsort(points[rows, 2])]
        parts = np.split(rows, np.flatnonzero(np.diff(points[rows, 2]) > 0.2) + 1)
        for part, above in zip(parts, [*parts[1:], None], strict=True):
            z = points[part, 2]
            assert layers.cell[node] == column
            assert (node_of[part] == node).all()
            assert layers.thickness[node] == z[-1] - z[0]
            assert middle[node] == (z[(len(z) - 1) // 2] if z[-1] - z[0] <= 0.15 else highest_band(z))
            assert layers.headroom[node] == (np.inf if above is None else points[above[0], 2] - z[-1])
            node += 1
    assert node == len(layers.cell)
    np.testing.assert_array_equal(np.diff(layers.start), np.bincount(layers.cell, minlength=len(layers.start) - 1))


def test_spliced_layers_are_those_of_all_points():
    rng = np.random.default_rng(4)
    old, new = rng.uniform([0, 0, 0], [2, 2, 3], (2, 800, 3))
    first = build_layers(old, 0.25, 0.2)
    changed = rng.random(first.shape[0] * first.shape[1]) < 0.3

    def cells(points):
        return cells_of(points, first.origin, 0.25, first.shape)

    mixed = np.concatenate([old[~changed[cells(old)]], new[changed[cells(new)]]])
    fresh = build_layers(new[changed[cells(new)]], 0.25, 0.2, like=first)
    made, true = splice_layers(first, changed.reshape(first.shape), fresh), build_layers(mixed, 0.25, 0.2, like=first)
    for name in ("cell", "height", "thickness", "headroom", "start"):
        np.testing.assert_array_equal(getattr(made, name), getattr(true, name))


def test_where_a_board_ends_is_told_beside_the_column_that_changed():
    place = 0.25 * np.argwhere(np.ones((3, 3)))
    old = np.concatenate([np.column_stack([place, np.full(9, z)]) for z in (0.0, 0.5, 0.5, 0.5, 0.55, 0.55, 0.55)])
    gone = (old[:, :2] == 0.25).all(axis=1) & (old[:, 2] > 0.0)
    first = build_layers(old, 0.25, 0.2)
    changed = np.isin(np.arange(len(first.start) - 1), cells_of(old[gone], first.origin, 0.25, first.shape))
    floor = old[(old[:, :2] == 0.25).all(axis=1) & ~gone]
    made = splice_layers(first, changed.reshape(first.shape), build_layers(floor, 0.25, 0.2, like=first))
    np.testing.assert_array_equal(made.height, build_layers(old[~gone], 0.25, 0.2, like=first).height)
    assert (first.height == 0.55).sum() == 9
    assert (made.height == 0.5).sum() == 4  # the corners: beside two others


def test_strays_are_those_with_empty_voxels_around():
    rng = np.random.default_rng(5)
    points = np.concatenate([rng.uniform(-2, 2, (300, 3)), rng.uniform(-9, 9, (200, 3))])
    voxel = np.floor(points / 0.25)
    apart = np.abs(voxel[:, None] - voxel[None]).max(axis=2)
    expected = (apart <= 1).sum(axis=1) == 1
    assert 0 < expected.sum() < len(points)
    np.testing.assert_array_equal(find_strays(points, 0.25), expected)
    assert len(find_strays(np.zeros((0, 3)), 0.25)) == 0


def test_medians_are_those_of_scipy_and_what_is_unknown_counts_for_nothing():
    rng = np.random.default_rng(6)
    values = rng.normal(size=(30, 20))
    wanted = rng.random(values.shape) < 0.7
    for reach in (1, 2):
        found = median_around(values, reach, wanted)
        np.testing.assert_array_equal(found[wanted], ndimage.median_filter(values, size=2 * reach + 1)[wanted])
        assert np.isnan(found[~wanted]).all()
    values[rng.random(values.shape) < 0.4] = np.nan
    found = median_around(values, 1, np.ones(values.shape, dtype=bool))
    for i, j in ((5, 5), (12, 7), (20, 15)):
        assert found[i, j] == np.nanmedian(values[i - 1 : i + 2, j - 1 : j + 2])


@pytest.mark.parametrize("kind", [np.float32, np.float64, np.bool_])
@pytest.mark.parametrize("shape", [(1, 1), (3, 200), (200, 3), (70, 300)])
def test_the_highest_and_the_lowest_around_each_cell_are_those_of_a_filter(kind, shape):
    rng = np.random.default_rng(0)
    values = (9.0 * rng.normal(size=shape)).astype(kind) if kind is not np.bool_ else rng.random(shape) < 0.02
    if kind is not np.bool_:
        values[rng.random(shape) < 0.2] = -np.inf
    for rings in (0, 1, 2, 3, 7, 8, 40, 400):  # those that the grid ends before, too
        size = 2 * rings + 1
        if kind is np.bool_:
            np.testing.assert_array_equal(widened(values, rings), ndimage.maximum_filter(values, size))
            continue
        found = highest_around(values, rings)
        np.testing.assert_array_equal(found, ndimage.maximum_filter(values, size))
        np.testing.assert_array_equal(lowest_around(values, rings), ndimage.minimum_filter(values, size))
        assert found.dtype == kind


def test_cells_that_hold_other_rows_than_before_are_told():
    rng = np.random.default_rng(6)
    start, old = np.array([0, 2, 2, 5, 6]), rng.random((6, 3))
    fresh, new = np.array([0, 2, 3, 6, 7]), np.insert(old, 2, 0.5, axis=0)
    new[5, 1] += 1e-9  # of the third cell
    cells = np.ones((2, 2), dtype=bool)
    assert unlike_cells(cells, start, old, fresh, new).tolist() == [[False, True], [True, False]]
    assert unlike_cells(cells, start, old, start, old).sum() == 0
    assert unlike_cells(~cells, start, old, fresh, new).sum() == 0

"""The compiled loops over nodes against the obvious ones."""

from unittest.mock import Mock

import numpy as np
import pytest
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from gpdf_service.config import PerceptionConfig
from gpdf_service.perception.beside import beside, beside_now
from gpdf_service.perception.boxes import widened
from gpdf_service.perception.bumps import raised_over_sides
from gpdf_service.perception.columns import ends_in_plan, heights_in_plan
from gpdf_service.perception.layers import HALF, build_layers, connect, crop_layers, splice_layers, steady
from gpdf_service.perception.nodes import (
    components,
    drops_beside,
    grown_sheet,
    half_way,
    lowest_beside,
    mean_gradients,
    nodes_over,
    numbered_among,
    plan_sums,
)
from gpdf_service.perception.pairs import AROUND, pairs_within
from gpdf_service.perception.strides import find_stances, find_strides


@pytest.fixture(scope="module")
def layers():
    points = np.random.default_rng(0).uniform([0, 0, 0], [3, 3, 2], (900, 3))
    return build_layers(points, 0.25, 0.3)


def pairs(layers):
    """All pairs (i, j) of nodes in neighbouring cells, with the direction from i to j."""
    cells = np.column_stack(np.divmod(layers.cell, layers.shape[1]))
    for offset in AROUND:
        for i, cell in enumerate(cells):
            for j in np.flatnonzero((cells == cell + offset).all(axis=1)):
                yield i, j, offset


def test_components_are_those_of_scipy_numbered_by_their_first_nodes():
    rng = np.random.default_rng(1)
    for count, edges in ((1, 0), (50, 0), (300, 120), (300, 600)):
        a, b = rng.integers(0, count, (2, edges))
        graph = csr_matrix((np.ones(edges), (a, b)), shape=(count, count))
        found = components(a, b, np.ones(count, dtype=bool))
        np.testing.assert_array_equal(found, connected_components(graph, directed=False)[1])
        assert (np.diff(np.unique(found, return_index=True)[1]) > 0).all()


def test_components_among_some_nodes_leave_the_others_alone():
    rng = np.random.default_rng(1)
    (a, b), among = rng.integers(0, 200, (2, 400)), rng.random(200) < 0.5
    inside = among[a] & among[b]
    np.testing.assert_array_equal(components(a, b, among), components(a[inside], b[inside], np.ones(200, dtype=bool)))


def test_pairs_are_chosen_as_by_masks():
    rng = np.random.default_rng(2)
    (a, b), among, own = rng.integers(0, 50, (2, 300)), rng.random(50) < 0.4, np.arange(50)
    for found, mask in (
        (pairs_within(a, b, among, True), among[a] & among[b]),
        (pairs_within(a, b, among, False), among[a] | among[b]),
        (pairs_within(a, b, among, True, own % 3), among[a] & among[b] & (a % 3 != b % 3)),
    ):
        np.testing.assert_array_equal(found, (a[mask], b[mask]))


@pytest.fixture(scope="module")
def strips():
    """Layers of three strips."""
    points = np.random.default_rng(0).uniform([0, 0, 0], [9, 1, 2], (900, 3))
    return build_layers(points, 0.25, 0.3)


def answers(near, layers, seed=3):
    rng = np.random.default_rng(seed)
    keep = rng.random(len(layers.cell)) < 0.8
    inner = keep & (rng.random(len(layers.cell)) < 0.7)
    return keep, inner, near.degrees("degrees", keep, 0.2), near.pieces(inner, 0.2, keep, keep, 0.3)


def test_pieces_and_the_pairs_beside_them_are_those_of_all_pairs(strips):
    near = beside(strips, 0.3)
    assert len(near.strips) == 3
    keep, inner, degree, (piece, sloped, stepped_over) = answers(near, strips)
    a, b = np.array([(i, j) for i, j, offset in pairs(strips) if offset in set(HALF)]).T
    far = np.hypot(*(np.divmod(strips.cell[b], strips.shape[1]) - np.array(np.divmod(strips.cell[a], strips.shape[1]))))
    rise, both, joined = np.abs(strips.height[a] - strips.height[b]), keep[a] & keep[b], inner[a] & inner[b]
    slope = both & (rise <= 0.2 * far)
    np.testing.assert_array_equal(degree, np.bincount(np.concatenate([a[slope], b[slope]]), minlength=len(keep)))
    np.testing.assert_array_equal(piece, components(a[slope], b[slope], inner))
    assert set(zip(*sloped, strict=True)) == set(zip(a[slope & ~joined], b[slope & ~joined], strict=True))
    step = both & (rise <= 0.3) & (piece[a] != piece[b])
    assert set(zip(*stepped_over, strict=True)) >= set(zip(a[step], b[step], strict=True))
    assert len(stepped_over[0]) < 1.1 * step.sum()
    found, order = set(zip(*sloped, strict=True)), zip(*connect(strips, keep, 0.2), strict=True)
    assert [pair for pair in order if pair in found] == list(zip(*sloped, strict=True))


def test_pairs_across_are_those_of_one_kind_and_the_other_within_a_step(strips):
    rng = np.random.default_rng(11)
    one = rng.random(len(strips.cell)) < 0.4
    other = ~one & (rng.random(len(one)) < 0.5)
    near = {(i, j) for i, j, _ in pairs(strips) if abs(strips.height[i] - strips.height[j]) <= 0.25}
    expected = {(i, j) for i, j in near if one[i] and other[j]}
    found = list(zip(*beside(strips, 0.3).across(one, other, 0.25), strict=True))
    assert set(found) == expected
    assert len(found) == len(expected) > 50


def test_a_change_of_columns_asks_only_the_strips_that_it_touches(strips):
    rng = np.random.default_rng(6)
    points = np.column_stack([rng.uniform(0.0, 9.0, 300), rng.uniform(0.0, 1.0, 300), rng.uniform(0.0, 2.0, 300)])
    other = build_layers(points, strips.cell_width, 0.3, like=strips)
    near, cells = beside(strips, 0.3), rng.random(strips.shape) < 0.3
    answers(near, strips)
    cells[:17] = False
    now = splice_layers(strips, cells.ravel(), other)
    made, expected = beside_now(near, now, cells), beside(now, 0.3)
    assert [bool(strip.before) for strip in made.strips] == [True, False, False]
    for seed in (3, 4):
        ours, theirs = answers(made, now, seed), answers(expected, now, seed)
        np.testing.assert_array_equal(ours[2], theirs[2])
        np.testing.assert_array_equal(ours[3][0], theirs[3][0])
        for k in (1, 2):
            np.testing.assert_array_equal(ours[3][k], theirs[3][k])


def test_each_answer_of_the_version_before_is_remembered_and_none_older(strips, monkeypatch):
    near, none = beside(strips, 0.3), np.zeros(strips.shape, dtype=bool)
    before = [answers(near, strips, seed) for seed in (3, 4, 5)]
    now = beside_now(near, strips, none)
    monkeypatch.setattr("gpdf_service.perception.beside.pieces_in", named := Mock(__name__="pieces_in"))
    for seed in (3, 5):  # one sheet's question comes after another's
        np.testing.assert_array_equal(answers(now, strips, seed)[3][0], before[seed - 3][3][0])
    assert not named.called
    later = beside_now(now, strips, none)
    assert all(len(strip.before) == 2 and not strip.known for strip in later.strips)


def test_labels_among_some_nodes_are_numbered_in_their_order():
    rng = np.random.default_rng(8)
    label, among = rng.integers(0, 40, 60), rng.random(60) < 0.5
    found, count = numbered_among(label, among)
    held, number = np.unique(label[among], return_inverse=True)
    np.testing.assert_array_equal(found[among], number)
    assert count == len(held)
    assert (found[~among] == count).all()


@pytest.mark.parametrize("tile", [3, 7, 64])
def test_a_change_is_told_what_a_build_is_in_tiles_of_any_size(tile, monkeypatch):
    """Questions to all within a reach, of nodes with others in some columns and with something else given elsewhere."""
    monkeypatch.setattr("gpdf_service.perception.told.TILE", tile)
    rng, config = np.random.default_rng(11), PerceptionConfig()
    cloud = rng.uniform(0.0, [4.0, 3.0, 2.0], (4000, 3))
    layers = build_layers(cloud, 0.1, 0.3)
    gone = (np.abs(cloud[:, :2] - [1.0, 2.0]) < 0.3).all(axis=1)
    now = build_layers(cloud[~gone], 0.1, 0.3, like=layers)
    cells = np.zeros(layers.shape, dtype=bool)
    place = np.floor((cloud[gone, :2] - layers.origin) / 0.1).astype(int)
    cells[tuple(place.T)] = True
    cells = widened(cells, 1)

    def ask(near, far):
        """Answers, with other ground in a far corner."""
        own = near.layers
        x, y = np.divmod(own.cell, own.shape[1])
        ground, label = (x + y) % 5 > 0, x // 4
        ground &= ~((x > 30) & (y < 8) & (y % 2 == far))
        raised = raised_over_sides(near, ground, config)
        (stance,) = near.around("stance", 2, lambda part, asked, among: (find_stances(part, among & asked),), ground)
        named = steady(own, label)

        def strides(part, _, stance, named):
            return find_strides(part.columns, stance, named, 4.0, 0.2)

        pairs = near.pairs_around("strides", 5, strides, ground, named)
        return raised, stance, in_order(pairs), near

    former = ask(beside(layers, 0.3), 0)[-1]
    changed = ask(beside_now(former, now, cells), 1)
    again = ask(beside(now, 0.3), 1)
    for ours, theirs in zip(changed[:3], again[:3], strict=True):
        np.testing.assert_array_equal(ours, theirs)
    assert min(np.count_nonzero(changed[0]), np.count_nonzero(changed[1]), len(changed[2])) > 100
    assert 0 < changed[-1].felt("stance", again[-1].known["stance"].given, 2).sum() < cells.size // 2


def in_order(pairs):
    rows = np.column_stack(pairs)
    return rows[np.lexsort(rows.T)]


def test_sums_in_plan_and_heights_in_plan_are_those_of_numpy(layers):
    rng = np.random.default_rng(4)
    keep, label = rng.random(len(layers.cell)) < 0.5, rng.integers(0, 5, len(layers.cell))
    x, y = np.divmod(layers.cell, layers.shape[1])
    labels, sums = plan_sums(layers.cell, layers.shape[1], keep, 7 * label)
    np.testing.assert_array_equal(labels, 7 * np.arange(5))
    for k, values in enumerate((np.ones(len(x)), x, y, x * x, y * y, x * y)):
        np.testing.assert_array_equal(sums[:, k], np.bincount(label, values * keep, minlength=5))
    nodes = np.unique(layers.cell, return_index=True)[1]
    grid = layers.origin, layers.cell_width
    height, off = heights_in_plan(layers.columns, nodes, layers.place, *grid, (0, 0), layers.shape)
    (left, right), (near, far) = ends_in_plan(layers.cell, layers.shape[1], nodes)
    assert (left, right, near, far) == (x.min(), x.max(), y.min(), y.max())
    np.testing.assert_array_equal(height[x[nodes], y[nodes]], layers.height[nodes].astype(np.float32))
    assert np.isfinite(height).sum() == len(nodes)
    assert np.abs(off).max() <= 0.5 * layers.cell_width + 1e-6
    centre = layers.origin + (np.column_stack([x, y])[nodes] + 0.5) * layers.cell_width
    np.testing.assert_allclose(centre + off[x[nodes], y[nodes]], layers.place[nodes], atol=1e-6)


def test_the_layers_of_a_box_are_those_of_its_columns(layers):
    box = slice(2, 7), slice(3, 9)
    part, nodes = crop_layers(layers, box)
    x, y = np.divmod(layers.cell, layers.shape[1])
    inside = (x >= 2) & (x < 7) & (y >= 3) & (y < 9)
    np.testing.assert_array_equal(nodes, np.flatnonzero(inside))
    np.testing.assert_array_equal(part.cell, (x[inside] - 2) * 6 + y[inside] - 3)
    np.testing.assert_array_equal(part.height, layers.height[inside])
    np.testing.assert_array_equal(np.diff(part.start), np.bincount(part.cell, minlength=30))
    np.testing.assert_allclose(part.origin, layers.origin + np.array([2, 3]) * layers.cell_width)


def test_the_mean_gradient_of_a_plane_is_its_slope():
    x, y = np.meshgrid(np.arange(0.05, 2.0, 0.1), np.arange(0.05, 2.0, 0.1))
    plane = np.column_stack([x.ravel(), y.ravel(), 0.3 * x.ravel() - 0.1 * y.ravel()])
    layers = build_layers(plane, 0.1, 0.5)
    a, b = connect(layers, np.ones(len(layers.cell), dtype=bool), 1.0)
    found = mean_gradients(layers.height, layers.cell, layers.shape[1], a, b)
    np.testing.assert_allclose(found, 0.1 * np.hypot(0.3, 0.1))


def test_half_way_is_between_the_extreme_neighbours():
    low, high = half_way(np.array([0.0, 2.0, 5.0]), np.array([0, 1]), np.array([1, 2]))
    np.testing.assert_array_equal(low, [0.0, 1.0, 3.5])
    np.testing.assert_array_equal(high, [1.0, 3.5, 5.0])


def test_the_lowest_ground_beside_is_that_of_all_pairs(layers):
    rng = np.random.default_rng(2)
    ground, slack = rng.random(len(layers.cell)) < 0.3, rng.uniform(0.1, 0.5, len(layers.cell))
    expected = np.full(len(layers.cell), np.inf)
    for i, j, _ in pairs(layers):
        if ground[j] and abs(layers.height[j] - layers.height[i]) <= slack[i]:
            expected[i] = min(expected[i], layers.height[j])
    found = lowest_beside(layers.columns, ground, layers.height, slack)
    np.testing.assert_array_equal(found, expected)
    assert 0 < np.isfinite(found).sum() < len(found)


def test_a_drop_is_a_direction_in_which_all_is_lower(layers):
    rise, max_step, nodes = 0.2, 0.35, np.arange(0, len(layers.cell), 2)
    level, down = set(), set()
    for i, j, offset in pairs(layers):
        over = layers.height[i] - layers.height[j]
        if abs(over) <= rise * np.hypot(*offset):
            level.add((i, offset))
        if over + layers.thickness[j] > max_step and over > -max_step:
            down.add((i, offset))
    expected = np.isin(np.arange(len(layers.cell)), [i for i, _ in down - level]) & (
        np.arange(len(layers.cell)) % 2 == 0
    )
    np.testing.assert_array_equal(drops_beside(nodes, layers.columns, rise, max_step), expected)
    assert expected.any()


def test_what_is_over_a_node_has_a_kept_one_below_it_in_its_cell(layers):
    keep = np.random.default_rng(3).random(len(layers.cell)) < 0.4
    nodes = np.arange(len(layers.cell))
    expected = []
    for i in nodes:
        below = [j for j in range(i) if keep[j] and layers.cell[j] == layers.cell[i]]
        expected.append(bool(below) and layers.height[i] - layers.height[below[-1]] <= 0.8)
    np.testing.assert_array_equal(nodes_over(nodes, layers.cell, layers.height, keep, 0.8), expected)
    assert any(expected)


def test_a_sheet_grows_by_its_rings_and_never_over_itself(layers):
    keep = np.ones(len(layers.cell), dtype=bool)
    first = np.zeros(len(layers.cell), dtype=bool)
    first[np.flatnonzero(layers.cell == layers.cell[len(layers.cell) // 2])[0]] = True
    around = beside(layers, 0.3).across(first, ~first, 0.3)[1]
    sizes = []
    for rings in (0, 1, 3):
        inside = np.flatnonzero(grown_sheet(layers.columns, keep, first, around, 0.3, rings))
        x, y = np.divmod(layers.cell[inside], layers.shape[1])
        assert len(np.unique(layers.cell[inside])) == len(inside)
        assert max(np.ptp(x), np.ptp(y)) <= 2 * rings
        sizes.append(len(inside))
    assert sizes[0] == 1
    assert sizes[0] < sizes[1] < sizes[2]

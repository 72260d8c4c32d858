"""The compiled loops over nodes against the obvious ones."""

import operator

import numpy as np
import pytest
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from gpdf_service.config import PerceptionConfig
from gpdf_service.perception.bumps import raised_over_sides
from gpdf_service.perception.strides import find_stances, find_strides
from gpdf_service.tiles.beside import beside, beside_now
from gpdf_service.tiles.boxes import widened
from gpdf_service.tiles.layers import build_layers, connect, crop_layers, steady
from gpdf_service.tiles.nodes import (
    attach,
    components,
    drops_beside,
    ends_at,
    grown_sheet,
    half_way,
    joined_to,
    lowest_beside,
    mean_gradients,
    nodes_over,
    plan_sums,
)
from gpdf_service.tiles.pairs import AROUND, steps_over_gaps
from gpdf_service.tiles.pieces import find_pieces


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


@pytest.fixture(scope="module")
def strips():
    """Layers of which three strips hold some."""
    points = np.random.default_rng(0).uniform([0, 0, 0], [9, 1, 2], (900, 3))
    return build_layers(points, 0.25, 0.3)


def test_pieces_are_components_of_all_pairs_and_sums_those_of_their_nodes(strips):
    rng, near, count = np.random.default_rng(3), beside(strips), len(strips.cell)
    assert np.count_nonzero(np.diff(near.first)) == 3
    inner, kind = rng.random(count) < 0.6, rng.random(count) < 0.5
    a, b = np.array([(i, j) for i, j, _ in pairs(strips)]).T
    far = np.hypot(*(np.divmod(strips.cell[b], strips.shape[1]) - np.array(np.divmod(strips.cell[a], strips.shape[1]))))
    for rise, step in ((0.2, 0.0), (0.0, 0.3)):
        own = inner[a] & inner[b] & (np.abs(strips.height[a] - strips.height[b]) <= rise * far + step)
        among = near.given(f"inner {step}", inner)
        found = find_pieces(near, f"pieces {step}", among, rise, step)
        expected = np.unique(components(a[own], b[own], inner)[inner], return_inverse=True)[1]
        np.testing.assert_array_equal(found.whole[inner], expected)
        assert (found.whole[~inner] == found.count).all()
        np.testing.assert_array_equal(found.start, np.flatnonzero(inner)[np.unique(expected, return_index=True)[1]])
        (held,) = found.counts(f"kinds {step}", near.given(f"kind {step}", kind))
        np.testing.assert_array_equal(held, np.bincount(expected, kind[inner], found.count))
        chosen = rng.random(found.count) < 0.5
        told = np.concatenate(found.chosen(f"chosen {step}", chosen))
        np.testing.assert_array_equal(told, np.append(chosen, False)[found.whole])
        nodes = rng.permutation(count)[:50]
        np.testing.assert_array_equal(found.at(nodes), found.whole[nodes])
    assert 5 < found.count < count // 2


def test_ends_of_a_sheet_are_those_of_all_pairs(layers):
    rng, count = np.random.default_rng(11), len(layers.cell)
    inside = rng.random(count) < 0.4
    beyond = ~inside & (rng.random(count) < 0.5)
    joined, ends = np.zeros(count, dtype=bool), np.zeros(count, dtype=bool)
    for i, j, _ in pairs(layers):
        if abs(layers.height[i] - layers.height[j]) > 0.25:
            continue
        had = inside & (layers.cell == layers.cell[j]) & (np.abs(layers.height - layers.height[i]) <= 0.25)
        joined[i] |= inside[i] & beyond[j]
        ends[i] |= inside[i] & beyond[j] & ~had.any()
    np.testing.assert_array_equal(joined_to(layers.columns, inside, beyond, 0.0, 0.25), joined)
    np.testing.assert_array_equal(ends_at(layers.columns, inside, beyond, 0.25), ends)
    assert 10 < ends.sum() < joined.sum()


@pytest.mark.parametrize("offset", [(1, 0), (0, 1), (1, -1)])
def test_steps_and_gaps_are_those_of_each_line_of_cells(layers, offset):
    keep, found = np.random.default_rng(2).random(len(layers.cell)) < 0.5, set()
    x, y = np.divmod(layers.cell, layers.shape[1])
    for i in np.flatnonzero(keep):
        for far in (1, 2, 3):
            there = np.flatnonzero((x == x[i] + far * offset[0]) & (y == y[i] + far * offset[1]))
            rise = np.abs(layers.height[there] - layers.height[i])
            if not (layers.height[there] <= layers.height[i] + 0.4).any():  # all that was seen there is higher
                continue
            near = keep[there] & (rise <= 0.4) & ((rise > 0.1) | (far > 1))
            found |= {(int(i), int(j)) for j in there[near]}
            break
    ends = steps_over_gaps(layers.columns, keep, (0.1, 0.4), offset, 2)
    assert set(zip(*(each.tolist() for each in ends), strict=True)) == found
    assert len(found) > 20


def test_a_sheet_gets_the_pieces_beside_it_that_lie_over_nothing_of_it():
    """Pieces a, b, c, d in a row of cells; c lies over a, e over itself; f is joined to d alone."""
    pieces = {"a": [0, 1], "b": [2], "c": [3, 0], "d": [4], "e": [5, 5], "f": [6], "g": [7]}
    nodes = sorted((cell, name) for name, cells in pieces.items() for cell in cells)
    names, cell = sorted(pieces), np.array([cell for cell, _ in nodes])
    piece = np.array([names.index(name) for _, name in nodes])
    first = {name: next(i for i, node in enumerate(nodes) if node[1] == name) for name in names}
    pairs = np.array([(first[a], first[b]) for a, b in ("ab", "bc", "bd", "de", "df", "ga")]).T
    start = np.searchsorted(np.sort(piece), np.arange(len(names) + 1))
    sheet_of = np.where(piece == 0, 3, -1)
    sheet_of[first["g"]] = 1
    attach(cell, (1, 8), (pairs[0], pairs[1]), (piece, start, np.argsort(piece, kind="stable")), 3, sheet_of)
    assert {names[p] for p in piece[sheet_of == 3]} == {"a", "b", "d", "f"}
    assert (sheet_of[piece == names.index("c")] == -1).all()
    assert sheet_of[first["g"]] == 1


def ask(near, far, config, looked=None):
    """Answers to questions of all kinds, with other ground in a far corner; and how many nodes one looked at."""
    own = near.layers
    x, y = np.divmod(own.cell, own.shape[1])
    ground = (x + y) % 5 > 0
    ground &= ~((x > 30) & (y < 8) & (y % 2 == far))
    ground = near.given("ground", ground)
    raised = raised_over_sides(near, ground, config)

    def stances(part, asked, among):
        if looked is not None:
            looked.append(len(part.cell))
        return (find_stances(part, among & asked),)

    (stance,) = near.around("stance", 2, stances, ground)
    pieces = find_pieces(near, "pieces", stance, 0.1)
    named = pieces.chosen("names", steady(own, pieces.start))

    def strides(part, stance, named):
        return find_strides(part.columns, stance, named, 4.0, 0.2)

    one, other = near.joins("strides", 5, strides, stance, named)
    ends = np.column_stack([pieces.at(one), pieces.at(other)])
    few = near.among("few", np.flatnonzero(np.concatenate(raised) > 0.1))
    told = (raised, stance, few, pieces.label)
    return *map(np.concatenate, told), pieces.number, pieces.start, in_order((*ends.T, one, other))


@pytest.mark.parametrize("rows", [3, 7, 64])
def test_a_change_is_told_what_a_build_is_in_strips_of_any_size(rows, monkeypatch):
    """Questions of all kinds, of nodes with others in some columns and with something else given elsewhere."""
    monkeypatch.setattr("gpdf_service.tiles.beside.ROWS", rows)
    rng, config = np.random.default_rng(11), PerceptionConfig()
    cloud = rng.uniform(0.0, [4.0, 3.0, 2.0], (4000, 3))
    near, was = beside(build_layers(cloud, 0.1, 0.3)), 0
    ask(near, 0, config)
    for place, far in (((1.0, 2.0), 1), ((3.0, 1.0), 1), ((3.0, 0.4), 0)):
        layers, gone = near.layers, (np.abs(cloud[:, :2] - place) < 0.3).all(axis=1)
        cells = np.zeros(layers.shape, dtype=bool)
        cells[tuple(np.floor((cloud[gone, :2] - layers.origin) / 0.1).astype(int).T)] = True
        cloud, before = cloud[~gone], near.lasting()
        near = beside_now(before, build_layers(cloud, 0.1, 0.3, like=layers), widened(cells, 1))
        looked = []
        ours, theirs = ask(near, far, config, looked), ask(beside(near.layers), far, config)
        for one, other in zip(ours, theirs, strict=True):
            np.testing.assert_array_equal(one, other)
            assert len(one) > 20
        if far == was:  # else what lies between is looked at, too
            assert 0 < max(looked) < 0.6 * len(near.layers.cell)
        was = far
        raised = np.concatenate([each for (each,) in before.known["raised"].made])
        expected = unlike_nodes((before.layers, raised), (near.layers, ours[0]), widened(cells, 1))
        found = near.unlike(
            [tuple(each for (each,) in near.known["raised"].made)],
            before,
            [tuple(each for (each,) in before.known["raised"].made)],
        )
        np.testing.assert_array_equal(found | widened(cells, 1), expected)


def unlike_nodes(old, now, cells):
    """Cells that hold other nodes or ones with other values, and `cells`."""
    made = cells.copy()
    for x, y in np.ndindex(cells.shape):
        held = [values[layers.cell == x * cells.shape[1] + y] for layers, values in (old, now)]
        made[x, y] |= not np.array_equal(*held)
    return made


def test_what_comes_out_as_it_was_is_what_it_was_and_none_older_is_kept(strips):
    near, calls = beside(strips), []

    def lower(part, asked, kind):
        calls.append(int(asked.sum()))
        return (part.height < 1.0 + 0.0 * kind,)

    def low(near, kind):
        return near.around("low", 1, lower, near.given("kind", kind))[0]

    kind = np.zeros(len(strips.cell))
    was = low(near, kind)
    now = beside_now(near, strips, np.zeros(strips.shape, dtype=bool))
    assert low(now, kind) == was  # the same objects
    assert calls == [len(kind)]
    kind = np.where(np.arange(len(kind)) < 3, 1.0, 0.0)
    later = beside_now(now, strips, np.zeros(strips.shape, dtype=bool))
    assert all(map(operator.is_, low(later, kind), was))  # was asked, and told the same
    assert len(calls) == 2
    assert 3 <= calls[1] < 50
    assert not now.lasting().former
    assert later.lasting().known is later.known


def in_order(pairs):
    rows = np.column_stack(pairs)
    return rows[np.lexsort(rows.T)]


def test_sums_in_plan_are_those_of_numpy(layers):
    rng = np.random.default_rng(4)
    keep, label = rng.random(len(layers.cell)) < 0.5, rng.integers(0, 5, len(layers.cell))
    x, y = np.divmod(layers.cell, layers.shape[1])
    sums = plan_sums(layers.cell, layers.shape[1], keep, label, 5)
    for k, values in enumerate((np.ones(len(x)), x, y, x * x, y * y, x * y)):
        np.testing.assert_array_equal(sums[:, k], np.bincount(label, values * keep, minlength=5))


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
    x, y = np.meshgrid(np.arange(0.02, 2.0, 0.1), np.arange(0.02, 2.0, 0.1))
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
    around = np.flatnonzero(joined_to(layers.columns, ~first, first, 0.0, 0.3))
    sizes = []
    for rings in (0, 1, 3):
        inside = np.flatnonzero(grown_sheet(layers.columns, keep, first, around, 0.3, rings))
        x, y = np.divmod(layers.cell[inside], layers.shape[1])
        assert len(np.unique(layers.cell[inside])) == len(inside)
        assert max(np.ptp(x), np.ptp(y)) <= 2 * rings
        sizes.append(len(inside))
    assert sizes[0] == 1
    assert sizes[0] < sizes[1] < sizes[2]

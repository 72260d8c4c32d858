import numpy as np
import pytest

import gpdf_service as gpdf
from gpdf_service.search.core import NARROW, climb, find_core, find_nodes, search_in
from gpdf_service.search.free_space import core_of
from gpdf_service.search.graph import assemble, find_path, price_pairs
from gpdf_service.search.quadtree import MIN_WIDTH
from gpdf_service.synthetic import Box, World
from gpdf_service.tiles.nodes import components


@pytest.fixture(scope="module")
def space(office):
    return office[1].free_space("roomba")


def half_size(space):
    return np.concatenate([own.quadtree.half_size for own in space.levels])


def test_what_was_joined_stays_joined_and_nothing_else_is(space):
    core, free = space.core, np.concatenate([own.quadtree.free for own in space.levels])
    assert len(core.node) < 0.5 * free.sum()
    assert (free & (2.0 * half_size(space) >= NARROW) <= np.isin(np.arange(len(free)), core.node)).all()
    row = np.repeat(np.arange(len(core.node)), np.diff(core.graph.first))
    parts = components(row, core.graph.other, np.ones(len(core.node), dtype=bool))
    for ours, theirs in ((parts, core.graph.component), (core.graph.component, parts)):
        assert len({*zip(ours.tolist(), theirs.tolist(), strict=True)}) == len({*ours.tolist()})
    assert {*space.graph.component[free].tolist()} == {*core.graph.component.tolist()}


def test_from_every_free_leaf_edges_lead_up_to_the_core_of_its_own_component(space):
    free = np.flatnonzero(np.concatenate([own.quadtree.free for own in space.levels]))
    for leaf in np.random.default_rng(0).choice(free, 100):
        nodes, edges = climb(space.graph, space.core, int(leaf))
        assert np.isin(nodes, space.core.node).tolist() == [False] * len(edges) + [True]
        assert (space.graph.other[edges] == nodes[1:]).all()
        assert space.graph.component[nodes[-1]] == space.graph.component[leaf]


def test_a_way_over_the_core_is_one_of_the_graph_and_little_longer_than_the_cheapest(space):
    graph, rng = space.graph, np.random.default_rng(1)
    free = np.flatnonzero(np.concatenate([own.quadtree.free for own in space.levels]))
    largest = np.bincount(graph.component[free]).argmax()
    spent, least = 0.0, 0.0
    for start, goal in rng.choice(free[graph.component[free] == largest], (30, 2)):
        nodes, via = find_nodes(search_in(graph, space.core), int(start), int(goal))
        assert (nodes[0], nodes[-1]) == (start, goal)
        for a, b, at in zip(nodes[:-1], nodes[1:], via, strict=True):
            edges = np.arange(graph.first[a], graph.first[a + 1])
            edge = edges[(graph.other[edges] == b) & (graph.via[edges] == at).all(axis=1)]
            assert len(edge) == 1
            spent += graph.cost[edge[0]]
        least += graph.cost[find_path(graph, int(start), int(goal))].sum()
    assert least <= spent < 1.15 * least


def test_a_narrow_passage_keeps_a_chain_of_leaves():
    walls = Box((3.0, 0.0, 0.0), (3.2, 1.73, 2.6)), Box((3.0, 2.27, 0.0), (3.2, 4.0, 2.6))
    points, ground = World((6.0, 4.0, 2.6), walls).sample(0.02, np.random.default_rng(0))
    scene = gpdf.build_scene(points, ground)
    space = scene.free_space("human")  # 4 cm to spare
    inside = space.core.node[np.abs(space.graph.position[space.core.node, 0] - 3.1) < 0.1]
    assert len(inside) > 0
    assert (2.0 * half_size(space)[inside] < NARROW).all()
    assert gpdf.plan(scene, (1, 2), (5, 2)).status is gpdf.Status.OK


@pytest.mark.parametrize("spacing", [0.03, 0.2])
def test_no_leaf_is_finer_than_a_fifth_of_a_cell_of_the_ground(spacing):
    x, y = np.meshgrid(np.arange(0.0, 8.0, spacing), np.arange(0.0, 8.0, spacing))
    scene = gpdf.build_scene(np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]), np.ones(x.size, dtype=bool))
    width = scene.free_space("human").levels[0].quadtree.width
    assert width == pytest.approx(max(MIN_WIDTH, 0.2 * scene.surfaces[0].cell_width))
    assert (width > 1.001 * MIN_WIDTH) == (spacing > 0.1)


def test_what_is_decided_again_after_a_change_is_what_is_decided_on_the_whole(office):
    scene, rng = office[1], np.random.default_rng(2)
    scene.free_space("roomba")
    for _ in range(8):
        place = scene.levels.levels[0].ground_points[rng.integers(len(scene.levels.levels[0].ground_points))]
        gone = np.flatnonzero(np.abs(scene.points[:, :2] - place[:2]).max(axis=1) < 0.3)
        box = place + rng.uniform((-0.2, -0.2, 0.0), (0.2, 0.2, 0.5), (300, 3))
        scene = scene.update(box, gone[scene.points[gone, 2] > place[2] + 0.05])
        changed = scene.free_space("roomba")
        whole = core_of(changed.levels, changed.graph)
        assert (changed.core.node == whole.node).all()
        assert (changed.core.edge == whole.edge).all()
        assert (changed.core.decided.up == whole.decided.up).all()


def grid_of(clearance):
    """Narrow leaves in rows and columns, each joined to those beside it."""
    number = np.arange(clearance.size).reshape(clearance.shape)
    pairs = np.concatenate(
        [
            np.column_stack([a.ravel(), b.ravel()])
            for a, b in ((number[1:], number[:-1]), (number[:, 1:], number[:, :-1]))
        ]
    )
    place = np.column_stack([each.ravel() for each in np.indices(clearance.shape)]).astype(float)
    via = 0.5 * (place[pairs[:, 0]] + place[pairs[:, 1]])
    free = np.ones(clearance.size, dtype=bool)
    cost = price_pairs(place, clearance.ravel(), (pairs, via), 0.3)
    graph = assemble(place, np.zeros(clearance.size, np.int64), (pairs, via), cost)
    return graph, free, np.full(clearance.size, 0.05), clearance.ravel()


def test_a_decision_that_changes_is_asked_for_again_wherever_it_matters():
    rng, further = np.random.default_rng(3), 0
    for _ in range(60):
        clearance = rng.uniform(0.3, 1.0, (15, 15))
        before = find_core(*grid_of(clearance))
        source = np.arange(clearance.size)
        clearance = clearance.copy()
        clearance[7, 7] = rng.uniform(0.3, 1.0)
        changed = grid_of(clearance)
        now = find_core(*changed, (before, source))
        whole = find_core(*changed)
        assert now.node.tolist() == whole.node.tolist()
        assert (now.decided.up == whole.decided.up).all()
        x, y = np.divmod(np.setxor1d(now.node, before.node), 15)
        further += int((np.abs(x - 7) + np.abs(y - 7) > 2).any())
    assert further > 0  # it goes on beyond the two edges around the change

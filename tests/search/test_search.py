import numpy as np
import pytest
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from gpdf_service.fields import build_tree, morton
from gpdf_service.fields.tree import NO_POINTS
from gpdf_service.search.graph import find_edges, find_path
from gpdf_service.search.places import Places, is_clear, least_distance
from gpdf_service.search.quadtree import touching


@pytest.fixture(scope="module")
def space(office):
    return office[1].free_space("roomba")


def test_leaves_tile_the_root(space):
    tree = space.levels[0].quadtree
    side = round(float(np.sqrt((tree.size.astype(float) ** 2).sum())))
    assert side & (side - 1) == 0
    codes = tree.code
    np.testing.assert_array_equal(codes[1:] - codes[:-1], (tree.size**2)[:-1])
    assert codes[0] == 0


def test_a_free_leaf_is_free_and_a_whole_one_everywhere(space):
    tree, rng = space.levels[0].quadtree, np.random.default_rng(0)
    assert (space.levels[0].clearance(tree.center[tree.free])[0] >= space.radius).all()
    whole = np.flatnonzero(tree.whole)
    inside = tree.center[whole] + rng.uniform(-1, 1, (len(whole), 2)) * tree.half_size[whole, None]
    assert (space.levels[0].clearance(inside)[0] >= space.radius - 1e-9).all()
    assert space.levels[0].surface.contains(inside).all()


def test_every_place_finds_its_leaf(space):
    tree, rng = space.levels[0].quadtree, np.random.default_rng(1)
    xy = tree.origin + rng.uniform(0, 5, (500, 2))
    leaf = tree.find(xy)
    assert (np.abs(xy - tree.center[leaf]) <= tree.half_size[leaf, None] + 1e-12).all()
    assert tree.find(np.array([[-100.0, 0.0], [1e4, 0.0]])).tolist() == [-1, -1]


def test_morton_codes_of_a_node_are_one_range():
    cells = np.stack(np.meshgrid(np.arange(8, 12), np.arange(4, 8), indexing="ij"), axis=-1).reshape(-1, 2)
    codes = np.sort(morton(cells))
    np.testing.assert_array_equal(codes, codes[0] + np.arange(16))


def test_edges_are_symmetric_and_clear(space):
    graph = space.graph
    source = np.repeat(np.arange(len(graph.position)), np.diff(graph.first))
    forward = set(zip(source.tolist(), graph.other.tolist(), strict=True))
    assert forward == {(b, a) for a, b in forward}
    rng = np.random.default_rng(0)
    for edge in rng.integers(len(source), size=300):
        a, via, b = graph.position[source[edge]], graph.via[edge], graph.position[graph.other[edge]]
        t = np.linspace(0, 1, 20)[:, None]
        line = np.vstack([a + t * (via - a), via + t * (b - via)])
        assert (space.levels[0].clearance(line)[0] >= space.radius - 1e-9).all()


def test_the_edges_of_some_leaves_are_those_of_all_that_have_one_of_them(space):
    tree, obstacles = space.levels[0].quadtree, space.levels[0].places
    some = np.random.default_rng(4).random(len(tree.size)) < 0.01
    looking = np.flatnonzero(tree.free & touching(tree, some))
    pairs, via = find_edges(tree, obstacles, space.radius, looking, some.__getitem__)
    every, across = find_edges(tree, obstacles, space.radius)
    wanted = some[every].any(axis=1)
    assert 0 < wanted.sum() < len(every)
    np.testing.assert_array_equal(pairs, every[wanted])
    np.testing.assert_array_equal(via, across[wanted])


def test_a_star_costs_what_dijkstra_costs(space):
    graph, rng = space.graph, np.random.default_rng(0)
    count = len(graph.position)
    source = np.repeat(np.arange(count), np.diff(graph.first))
    matrix = csr_matrix((graph.cost, (source, graph.other)), shape=(count, count))
    nodes = np.flatnonzero(graph.component == np.bincount(graph.component[space.levels[0].quadtree.whole]).argmax())
    for start in rng.choice(nodes, 3):
        best = dijkstra(matrix, indices=int(start))
        for goal in rng.choice(nodes, 10):
            edges = find_path(graph, int(start), int(goal))
            assert graph.cost[edges].sum() == pytest.approx(best[goal], abs=1e-9)
            assert (source[edges[1:]] == graph.other[edges[:-1]]).all()


def test_a_segment_is_clear_exactly_when_a_fine_sampling_is(space):
    rng, tree = np.random.default_rng(4), space.levels[0].places
    seen = set()
    for _ in range(300):
        a, b = rng.uniform([0.3, 0.3], [5.7, 4.7], (2, 2))
        b = a + 0.3 * (b - a)
        least = space.levels[0].clearance(np.linspace(a, b, 400))[0].min()
        if abs(least - space.radius) > 0.002:
            clear = is_clear(tree, a, b, space.radius)
            assert clear == (least > space.radius)
            seen.add(clear)
    assert seen == {True, False}


def test_leaves_around_a_place_are_those_that_meet_the_square(space):
    tree, rng = space.levels[0].quadtree, np.random.default_rng(5)
    for xy in tree.center[rng.integers(len(tree.size), size=20)] + rng.normal(0.0, 0.5, (20, 2)):
        gap = np.abs(tree.center - xy).max(axis=1) - tree.half_size
        found = np.sort(tree.within(xy, 0.3))
        assert set(np.flatnonzero(gap < 0.3 - tree.width)) <= set(found.tolist())
        assert (gap[found] <= 0.3 + tree.width).all()


def test_the_room_at_one_place_is_what_the_clearance_of_many_says(space):
    xy = np.random.default_rng(6).uniform(0.0, 5.0, (100, 2))
    distance, kind = space.levels[0].clearance(xy)
    found = [space.levels[0].room(place) for place in xy]
    assert found == list(zip(distance.tolist(), kind.tolist(), strict=True))


@pytest.mark.parametrize("count", [1, 31, 700])
def test_a_segment_and_a_polyline_know_their_distance_to_points_exactly(count):
    rng = np.random.default_rng(count)
    points, moving = rng.uniform(-3.0, 3.0, (count, 2)), rng.uniform(-3.0, 3.0, (3, 2))
    places = Places(build_tree(points), build_tree(moving))
    for scale in (0.0, 0.05, 2.0):
        path = rng.uniform(-2.0, 2.0, 2) + np.cumsum(scale * rng.normal(size=(80, 2)), axis=0)
        a, b, every = path[:-1, None], path[1:, None], np.concatenate([points, moving])
        far2 = np.maximum(((b - a) ** 2).sum(axis=-1), 1e-300)
        along = np.clip(((every - a) * (b - a)).sum(axis=-1) / far2, 0.0, 1.0)
        distance = np.linalg.norm(a + along[..., None] * (b - a) - every, axis=-1).min(axis=1)
        for one, two, least in zip(path[:-1], path[1:], distance, strict=True):
            assert is_clear(places, one, two, least - 1e-9)
            assert not is_clear(places, one, two, least + 1e-9)
        least, where = least_distance(places, np.column_stack([path, np.zeros(80)]), np.zeros(1), 1e-3)
        assert least == pytest.approx(distance.min(), abs=1e-9)
        assert np.linalg.norm(every - where, axis=1).min() == pytest.approx(least, abs=1e-9)


def test_nothing_is_clear_where_a_place_is_none_or_nothing_is_known():
    a, b = np.zeros(2), np.ones(2)
    assert not is_clear(Places(NO_POINTS), a, b, 0.1)
    places = Places(build_tree(np.array([[9.0, 9.0]])))
    assert is_clear(places, a, b, 0.1)
    assert not is_clear(places, a, np.array([np.nan, 1.0]), 0.1)
    assert not is_clear(places, a, np.array([np.inf, 1.0]), 0.1)

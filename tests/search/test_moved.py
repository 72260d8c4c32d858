"""A free space with something in it that moves equals one that is built from scratch with the same points."""

import numpy as np
import pytest

import gpdf_service as gpdf
from gpdf_service.fields import build_tree
from gpdf_service.planning import plan_path
from gpdf_service.search.free_space import Setup, fit_obstacle_field, join_levels, level_space
from gpdf_service.search.graph import find_edges
from gpdf_service.search.places import Places
from gpdf_service.search.quadtree import build_quadtree
from gpdf_service.search.ways import Prefer, find_ways
from gpdf_service.synthetic import SCENES
from gpdf_service.types import AGENTS
from tests.clients.two_storeys import make_house

CHANGES = 26
"""Of each scene and body."""


def cylinder(foot, radius, height, rng, count=150):
    angle = rng.uniform(0.0, 2.0 * np.pi, count)
    around_it = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    return np.column_stack([foot[:2] + around_it, foot[2] + rng.uniform(0.0, height, count)])


def door(foot, rng):
    """A leaf of 0.9 m, hinged at a place, turned anyhow."""
    along, angle = np.linspace(0.0, 0.9, 31), rng.uniform(0.0, 2.0 * np.pi)
    x, z = np.meshgrid(along, np.arange(0.05, 2.0, 0.1))
    return foot + np.column_stack([x.ravel() * np.cos(angle), x.ravel() * np.sin(angle), z.ravel()])


def pen(scene, agent, rng):
    """A fence around the place with the most room, which parts it from the rest."""
    tree, surface = scene.free_space(agent).levels[0].quadtree, scene.surfaces[0]
    row = np.where(tree.whole, tree.clearance, 0.0).argmax()
    foot = np.append(tree.center[row], surface.height_at(tree.center[row][None]))
    return cylinder(foot, 0.7 * tree.clearance[row], 1.8, rng, 1500)


def a_place(scene, rng):
    surface = scene.surfaces[rng.integers(len(scene.surfaces))]
    cells = np.argwhere(surface.state > 0)
    cell = cells[rng.integers(len(cells))]
    return np.append(surface.origin + (cell + rng.random(2)) * surface.cell_width, surface.height[tuple(cell)])


def changed(there, scene, rng):
    """Something appears, moves, or vanishes: points by name."""
    there = dict(there)
    if there and rng.random() < 0.5:
        name = sorted(there)[rng.integers(len(there))]
        points = there.pop(name)
        if rng.random() < 0.6:
            there[name] = points + np.append(rng.normal(0.0, 0.3, 2), 0.0)
        return there
    foot = a_place(scene, rng)
    kinds = (
        lambda: cylinder(foot, 0.25, 1.8, rng),
        lambda: cylinder(foot, 0.05, 0.3, rng, 30),
        lambda: cylinder(foot + np.array([0.0, 0.0, 1.5]), 0.3, 0.4, rng),
        lambda: door(foot, rng),
    )
    return {**there, str(rng.integers(10**9)): kinds[rng.integers(4)]()}


def from_scratch(space, scene):
    """All of the free space made of what stands and moves together."""
    parts = []
    for i, level in enumerate(scene.levels.levels):
        surface, both = level.surface, space.levels[i].obstacles
        tree = build_tree(both.points[:, :2])
        quadtree = build_quadtree(surface, tree, space.radius)
        edges = find_edges(quadtree, Places(tree), space.radius)
        field = fit_obstacle_field(both, surface, space.agent, Setup(scene.config.search, scene.config.fields))
        parts.append(level_space(level, space.levels[i].ground_field, both, tree, field, quadtree, edges))
    return join_levels(space.agent, space.reach, space.radius, parts, scene.levels)


def leaves_of(space):
    """Number in the graph of every free leaf by its level, corner and size, and what is known of it."""
    names, facts = {}, {}
    for level, own in enumerate(space.levels):
        tree, offset = own.quadtree, own.offset
        free = tree.numbers[tree.free[tree.numbers]]
        rows = zip(tree.corner[free].tolist(), tree.size[free].tolist(), strict=True)
        for leaf, (corner, size) in zip(free.tolist(), rows, strict=True):
            name = (level, *corner, size)
            names[leaf + offset] = name
            facts[name] = (bool(tree.whole[leaf]), min(float(tree.clearance[leaf]), 2.0 * space.radius))
    return names, facts


def edges_from(graph, node):
    """Far end, crossing and cost of every edge of a node, as A* walks them."""
    row = graph.patch.row[node] if len(graph.patch.row) else 0
    if row == 0:
        edges = np.arange(graph.standing.first[node], graph.standing.first[node + 1])
    else:
        edges = len(graph.other) - len(graph.patch.other) + np.arange(*graph.patch.first[row - 1 : row + 1])
    return graph.other[edges], graph.via[edges], graph.cost[edges]


def assert_equal_spaces(ours, theirs, rng):
    (names, facts), (other_names, other_facts) = leaves_of(ours), leaves_of(theirs)
    assert facts.keys() == other_facts.keys()
    assert {name: whole for name, (whole, _) in facts.items()} == {n: w for n, (w, _) in other_facts.items()}
    for name, (_, room) in facts.items():
        assert room == pytest.approx(other_facts[name][1], abs=1e-9)
    numbers = {name: node for node, name in other_names.items()}
    joined = {}
    for node, name in names.items():
        assert (
            joined.setdefault(ours.graph.component[node], theirs.graph.component[numbers[name]])
            == (theirs.graph.component[numbers[name]])
        )
    assert len(set(joined.values())) == len(joined)
    near = set()
    if len(ours.graph.patch.row):
        near = {node for node in names if ours.graph.patch.row[node]}
    for node in [*near, *rng.choice(list(names), 200)]:
        far, via, cost = edges_from(ours.graph, node)
        to, at, price = edges_from(theirs.graph, numbers[names[node]])
        mine = sorted((names[n], *xy, c) for n, xy, c in zip(far.tolist(), via.tolist(), cost.tolist(), strict=True))
        other = sorted(
            (other_names[n], *xy, c) for n, xy, c in zip(to.tolist(), at.tolist(), price.tolist(), strict=True)
        )
        assert [row[0] for row in mine] == [row[0] for row in other]
        np.testing.assert_allclose([row[1:] for row in mine], [row[1:] for row in other], atol=1e-9)


def assert_equal_fields(scene, ours, theirs, rng):
    """Distances to the nearest place are the same; the fields' differ by less than what a gap hides."""
    for level, surface in enumerate(scene.surfaces):
        high = np.array(surface.height.shape) * surface.cell_width
        xy = surface.origin + rng.uniform(0.0, 1.0, (500, 2)) * high
        (mine, kind), (other, their_kind) = ours.levels[level].clearance(xy), theirs.levels[level].clearance(xy)
        np.testing.assert_allclose(mine, other, atol=1e-12)
        assert (kind == their_kind).mean() > 0.99  # two kinds may be as near
        a, b = ours.levels[level].obstacle_field.query(xy), theirs.levels[level].obstacle_field.query(xy)
        np.testing.assert_array_equal(a.valid, b.valid)
        spacing = ours.levels[level].obstacle_field.standing.spacing
        assert (a.distance[a.valid] <= mine[a.valid] + 2.0 * spacing).all()
        assert np.abs(a.distance - b.distance).max() <= 2.0 * spacing
        assert np.median(np.abs(a.distance - b.distance)) <= 1e-3


@pytest.fixture(scope="module")
def house():
    made = make_house(np.random.default_rng(0))
    return gpdf.build_scene(made.points, made.ground)


@pytest.fixture(scope="module")
def room():
    made = SCENES["office"](np.random.default_rng(0), spacing=0.05)
    return gpdf.build_scene(made.points, made.ground)


@pytest.mark.parametrize("agent", ["human", "roomba"])
@pytest.mark.parametrize("where", ["room", "house"])
def test_random_changes_equal_a_free_space_from_scratch(where, agent, request):
    scene, rng = request.getfixturevalue(where), np.random.default_rng(11)
    there, statuses, torn = {"pen": pen(scene, agent, rng)}, [], 0
    for number in range(CHANGES):
        there = changed(there, scene, rng)
        points = np.concatenate([np.zeros((0, 3)), *there.values()])
        now = scene.with_obstacles(points)
        ours = now.free_space(agent)
        theirs = from_scratch(ours, scene)
        if number % 4 == 0:
            assert_equal_spaces(ours, theirs, rng)
        assert_equal_fields(scene, ours, theirs, rng)
        torn += ours.graph.standing.component is not (scene.free_space(agent).graph.component)
        start, goal = a_place(scene, rng), a_place(scene, rng)
        result = gpdf.plan(now, start, goal, agent)
        mine, again = (plan_path(one, start, goal, scene.config.planning) for one in (ours, theirs))
        assert result.status == mine.status == again.status, (result.message, mine.message, again.message)
        statuses.append(result.status)
        if result.status is gpdf.Status.OK:
            assert result.certificate.holds
            assert mine.certificate.min_clearance == pytest.approx(again.certificate.min_clearance, abs=0.05)
            body = np.repeat(result.trajectory.ground, 5, axis=0)[:, :2]
            room_there = np.max([own.clearance(body)[0] for own in theirs.levels], axis=0)
            assert room_there.min() >= AGENTS[agent].radius - 1e-6
    assert len(set(statuses)) > 1
    assert torn > 0


def led_up(space):
    """Of every free leaf the leaf that one goes on to on the way up to the core, and where; none of the core's own."""
    names, _ = leaves_of(space)
    made = {}
    for node, name in names.items():
        edge = space.core.decided.up[node]
        made[name] = None if edge < 0 else (names[int(space.graph.other[edge])], *space.graph.via[edge].tolist())
    return made


def prices_of(ways):
    """What every edge of the ways costs, by the leaves that it joins and where it crosses."""
    graph, leaves = ways.graph, [leaves_of(space)[0] for space in ways.spaces]
    names = [(k, leaves[k][node]) for k, space in enumerate(ways.spaces) for node in space.core.node.tolist()]
    row = np.repeat(np.arange(len(names)), np.diff(graph.first)).tolist()
    edges = zip(row, graph.other.tolist(), map(tuple, graph.via.tolist()), graph.cost.tolist(), strict=True)
    return {(names[a], names[b], via): cost for a, b, via, cost in edges}


def has_two_nearest(ways, leaf):
    """Whether obstacles of two kinds are as near to a leaf's centre, so that either can be told."""
    k, (level, x, y, size) = leaf
    tree, both = ways.spaces[k].levels[level].quadtree, ways.spaces[k].levels[level].obstacles
    far = np.linalg.norm(both.points[:, :2] - tree.origin - (np.array([x, y]) + 0.5 * size) * tree.width, axis=1)
    return len(np.unique(both.kind[far <= far.min() + 1e-9])) > 1


@pytest.mark.parametrize("prefer", [Prefer.COMPANION, Prefer.WIDE])
def test_ways_around_random_discs_are_those_of_a_build_from_scratch(house, prefer):
    """The same leaves and edges; prices but for the last bits of distances, which two trees tell in another order."""
    rng, known, other, tied = np.random.default_rng(2), prices_of(house.ways("human", prefer)), 0, 0
    for count in (1, 2, 4, 8):
        radii = rng.uniform(0.05, 0.4, count)
        points = np.concatenate([cylinder(a_place(house, rng), radius, 1.8, rng) for radius in radii])
        ours = house.with_obstacles(points).ways("human", prefer)
        theirs = find_ways(*(from_scratch(space, house) for space in ours.spaces), prefer)
        for one, whole in zip(ours.spaces, theirs.spaces, strict=True):
            assert len(one.graph.patch.row)
            assert led_up(one) == led_up(whole)
        made, whole = prices_of(ours), prices_of(theirs)
        assert made.keys() == whole.keys()
        for edge, cost in made.items():
            if cost != pytest.approx(whole[edge], rel=1e-12):
                assert any(has_two_nearest(ours, leaf) for leaf in edge[:2])
                tied += 1
        other += len(made.keys() ^ known.keys())
    assert tied < 100 < other  # much was another than without them


def test_what_touches_no_leaf_leaves_the_ways_as_they_were(house):
    stand = house.ways("human", Prefer.COMPANION)
    above = np.append(a_place(house, np.random.default_rng(0))[:2], 100.0)
    now = house.with_obstacles(above[None]).ways("human", Prefer.COMPANION)
    assert now.graph is stand.graph
    assert now.spaces[0] is not stand.spaces[0]


def test_where_nothing_was_free_nothing_changes_and_where_all_is_full_nothing_is_free(room):
    standing = room.free_space("roomba")
    inside = standing.levels[0].obstacles.points[:1]
    nothing = room.with_obstacles(inside + np.array([0.0, 0.0, 0.001])).free_space("roomba")
    assert nothing.graph.component[0] == standing.graph.component[0]
    surface = room.surfaces[0]
    everywhere = surface.centres(surface.state > 0) + np.array([0.0, 0.0, 0.05])
    full = room.with_obstacles(everywhere)
    space = full.free_space("roomba")
    leaf = space.levels[0].quadtree.find(everywhere[:, :2])
    assert not (space.levels[0].quadtree.free[leaf] & (leaf >= 0)).any()
    assert len(space.levels[0].quadtree.fresh.size) == 0
    assert gpdf.plan(full, (1.0, 1.0), (5.0, 3.0), "roomba").status is gpdf.Status.START_OCCUPIED
    assert len(full.ways("human", Prefer.COMPANION).graph.position) == 0

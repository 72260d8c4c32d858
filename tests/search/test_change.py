"""Quadtree and edges of a change are those of a build, whatever changed: obstacles, ground, or both."""

import dataclasses
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial import cKDTree

from gpdf_service.fields.tree import build_tree, change_tree
from gpdf_service.search.change import rows_in_tree
from gpdf_service.search.graph import change_edges, find_edges, same_leaves
from gpdf_service.search.places import Places
from gpdf_service.search.quadtree import build_quadtree, root_of
from gpdf_service.tiles.rows import rows_in_cells
from gpdf_service.tiles.surface import HeightMap, cropped, turned

RADIUS = 0.2


def flat(rng):
    """Known ground of 6 x 5 m with some unknown cells."""
    state = (rng.random((60, 50)) > 0.02).astype(np.uint8)
    height = np.where(state > 0, 0.0, np.nan).astype(np.float32)
    return HeightMap(np.zeros(2), 0.1, height, state)


def sticks(rng, count):
    return rng.uniform((0.0, 0.0), (6.0, 5.0), (count, 2))


def assert_same(surface_was, places_was, surface, places):
    """The changed tree and edges against built ones; how many leaves are others."""
    gone = places_was[~np.isin(places_was.view("f8,f8").ravel(), places.view("f8,f8").ravel())]
    come = places[~np.isin(places.view("f8,f8").ravel(), places_was.view("f8,f8").ravel())]
    moved = np.concatenate([gone, come])
    around = build_tree(moved) if len(moved) else None
    trees = build_tree(places_was), build_tree(places)
    old = build_quadtree(surface_was, trees[0], RADIUS)
    tree = build_quadtree(surface, trees[1], RADIUS, (old, around, turned(surface_was, surface)))
    built = build_quadtree(surface, trees[1], RADIUS)
    for key in ("corner", "size", "free", "whole"):
        np.testing.assert_array_equal(getattr(tree, key), getattr(built, key), err_msg=key)
    np.testing.assert_allclose(tree.clearance, built.clearance, atol=1e-9)
    edges = find_edges(old, Places(trees[0]), RADIUS)
    found = change_edges(edges, same_leaves(old, tree), tree, Places(trees[1]), RADIUS, around)
    expected = find_edges(built, Places(trees[1]), RADIUS)
    np.testing.assert_array_equal(found[0], expected[0])
    np.testing.assert_array_equal(found[1], expected[1])


@pytest.mark.parametrize("start", [5.0, 57.0])
def test_a_tree_over_a_box_that_moves_is_the_one_that_is_built(start):
    """Ground ends, or goes on, beyond the box that held it; from 57.3 m on the root has another corner."""
    rng, width, shape = np.random.default_rng(5), 0.0625, (96, 64)
    state = (rng.random(shape) > 0.02).astype(np.uint8)
    whole = HeightMap(np.array([np.floor(start / width) * width, 2.0]), width, np.zeros(shape, np.float32), state)
    places = whole.origin + rng.uniform(0.0, 1.0, (40, 2)) * width * np.array(shape)
    boxes = [cropped(whole, box) for box in (np.s_[:64, :], np.s_[32:, :], np.s_[32:, 32:], np.s_[:, :])]
    for was, now in pairwise(boxes):
        assert_same(was, places, now, places)
    assert (root_of(boxes[0])[0] != root_of(boxes[1])[0]).any() == (start > 50.0)


@pytest.mark.parametrize("seed", range(6))
def test_ground_that_is_seen_or_lost_without_an_obstacle_near_it_changes_its_leaves(seed):
    rng = np.random.default_rng(seed)
    was, places = flat(rng), sticks(rng, 25)
    state = was.state.copy()
    for _ in range(3):
        i, j = rng.integers(0, (54, 44))
        state[i : i + rng.integers(1, 6), j : j + rng.integers(1, 6)] ^= 1
    assert_same(was, places, dataclasses.replace(was, state=state), places)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("spread", [0.05, 1.0])
def test_obstacles_that_come_and_go_change_the_leaves_and_edges_around_them(seed, spread):
    rng = np.random.default_rng(seed)
    surface, places = flat(rng), sticks(rng, 60)
    middle = rng.uniform((1.0, 1.0), (5.0, 4.0))
    stay = np.hypot(*(places - middle).T) > 0.5 * spread
    come = middle + spread * rng.uniform(-0.5, 0.5, (3, 2))
    assert_same(surface, places, surface, np.concatenate([places[stay], come]))


@pytest.mark.parametrize("seed", [0, 1, 2814])
def test_an_obstacle_that_goes_opens_ways(seed):
    """In the last, one of 3,400 places, between two leaves that are wholly free then and stay as large."""
    rng = np.random.default_rng(seed)
    surface, places = flat(rng), sticks(rng, rng.integers(4, 60))
    assert_same(surface, places, surface, places[1:])


@pytest.mark.parametrize("seed", range(4))
def test_every_edge_is_clear_and_none_that_is_clear_is_missing(seed):
    """Each pair of free neighbours against a fine sampling of its way through the crossing."""
    rng = np.random.default_rng(seed)
    surface, places = flat(rng), sticks(rng, 600)
    tree = build_quadtree(surface, build_tree(places), RADIUS)
    ends, via = find_edges(tree, Places(build_tree(places)), RADIUS)
    proven = {tuple(sorted(pair)) for pair in ends.tolist()}
    everything, crossing = find_edges(tree, Places(build_tree(np.array([[90.0, 90.0]]))), RADIUS)
    away, t = cKDTree(places), np.linspace(0.0, 1.0, 60)[:, None]
    refused = 0
    for pair, at in zip(everything.tolist(), crossing, strict=True):
        a, b = tree.center[pair]
        least = away.query(np.vstack([a + t * (at - a), at + t * (b - at)]))[0].min()
        if tuple(sorted(pair)) in proven:
            assert least >= RADIUS - 1e-9
        else:
            refused += 1
            assert least < RADIUS + 1e-3  # what the sampling resolves
    assert refused > 0
    assert len(via) == len(ends) > 100


@pytest.mark.parametrize("seed", range(4))
def test_rows_in_some_cells_by_boxes_of_a_tree_are_those_of_all_rows(seed):
    rng = np.random.default_rng(seed)
    points, fresh = rng.uniform((-1.0, -1.0), (7.0, 6.0), (3000, 2)), sticks(rng, 40)
    tree, keep = build_tree(points), rng.random(3000) < 0.7
    changed = change_tree(tree, keep, fresh)[0]
    wanted = np.zeros((60, 50), dtype=bool)
    wanted[20:31, 5:9] = wanted[3, 40:] = rng.random() < 0.8
    wanted |= rng.random((60, 50)) < 0.01
    for one, rows in ((tree, points), (changed, changed.points)):
        found = np.sort(one.order[rows_in_tree(one, np.zeros(2), 0.1, wanted)])
        np.testing.assert_array_equal(found, rows_in_cells(rows, np.zeros(2), 0.1, wanted))
        assert 0 < len(found) < len(rows) // 4
    assert len(rows_in_tree(tree, np.zeros(2), 0.1, np.zeros((60, 50), dtype=bool))) == 0

"""The quadtree against one that is built node by node in Python, and its look-ups against looking at every leaf."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial import cKDTree

from gpdf_service.fields import build_tree
from gpdf_service.search.quadtree import build_quadtree, least_width, side_of, touching
from gpdf_service.tiles.surface import INFERRED, OBSERVED, UNKNOWN, HeightMap, turned

MIN_WIDTH, CELL_SHARE, ANCHORED = 0.014, 0.2, 4096
"""[m] and [-]: what is promised, written down once more."""


def ground(rng, shape, width, unknown=0.1):
    state = rng.choice(np.array([UNKNOWN, OBSERVED, INFERRED], np.uint8), shape, p=[unknown, 0.9 - unknown, 0.1])
    height = np.where(state == UNKNOWN, np.nan, 0.0).astype(np.float32)
    return HeightMap(rng.uniform(-3.0, 3.0, 2), width, height, state)


def leaves_of(surface, places, radius):
    """Corner, size, clearance and state of every leaf: by the docstring, down from the root."""
    asked, away = max(MIN_WIDTH, CELL_SHARE * surface.cell_width), cKDTree(places)
    near = np.float32(asked)
    width = max(width for width in map(float, (near, np.nextafter(near, np.float32(0.0)))) if width <= asked)
    corner, side = np.floor(surface.origin / (ANCHORED * width)) * ANCHORED * width, 1
    while (corner + side * width < surface.origin + surface.cell_width * np.array(surface.state.shape)).any():
        side *= 2
    found = []

    def split(i, j, n):
        place = corner + (np.array([i, j]) + 0.5 * n) * width
        distance, half = away.query(place)[0], 0.5 * np.sqrt(2.0) * n * width
        some, every = distance + half >= radius, distance - half >= radius
        if some and not every and n > 1:
            for k in range(4):
                split(i + (k >> 1) * (n // 2), j + (k & 1) * (n // 2), n // 2)
            return
        cell = np.floor((place - surface.origin) / surface.cell_width).astype(int)
        inside = (cell >= 0).all() and (cell < surface.state.shape).all() and surface.state[tuple(cell)] != UNKNOWN
        state = 0 if not inside or distance < radius else 2 if every else 1
        found.append((i, j, n, distance, state))

    split(0, 0, side)
    return found


def code_of(i, j):
    """Bits of both, i's before j's."""
    return sum(((i >> b) & 1) << (2 * b + 1) | ((j >> b) & 1) << (2 * b) for b in range(20))


def scene_of(seed):
    rng = np.random.default_rng(seed)
    width = rng.choice([0.05, 0.08, 0.2])
    surface = ground(rng, tuple(rng.integers(4, 16, 2)), width)
    high = np.array(surface.state.shape) * width
    places = surface.origin + rng.uniform(-0.2, 1.2, (rng.integers(1, 30), 2)) * high
    return rng, surface, places, rng.choice([0.03, 0.1, 0.25])


@pytest.mark.parametrize("seed", range(30))
def test_a_tree_is_the_one_that_is_split_node_by_node(seed):
    _, surface, places, radius = scene_of(seed)
    tree, expected = build_quadtree(surface, build_tree(places), radius), leaves_of(surface, places, radius)
    i, j, size, clearance, state = (np.array(column) for column in zip(*expected, strict=True))
    np.testing.assert_array_equal(tree.corner, np.column_stack([i, j]))
    np.testing.assert_array_equal(tree.size, size)
    np.testing.assert_allclose(tree.clearance, clearance, atol=1e-12)
    np.testing.assert_array_equal(tree.free, state > 0)
    np.testing.assert_array_equal(tree.whole, state == 2)
    np.testing.assert_array_equal(tree.code, [code_of(*corner) for corner in tree.corner.tolist()])
    assert tree.width == least_width(surface) == pytest.approx(max(MIN_WIDTH, CELL_SHARE * surface.cell_width))
    np.testing.assert_allclose(tree.center, tree.origin + tree.width * np.column_stack([i, j] + 0.5 * size[:, None].T))
    np.testing.assert_allclose(tree.half_size, 0.5 * tree.width * size)
    assert tree.numbers.tolist() == list(range(len(size)))
    assert side_of(tree) == (1 if len(size) == 1 else (i + size).max())
    assert tree.standing is tree


def test_a_tree_of_very_many_leaves_is_whole():
    rng = np.random.default_rng(0)
    surface = ground(rng, (70, 64), 0.1, unknown=0.0)
    places = surface.origin + rng.uniform(0.0, 7.0, (1500, 2))
    tree = build_quadtree(surface, build_tree(places), 0.06)
    assert len(tree.size) > 40_000
    np.testing.assert_array_equal(np.diff(tree.code), (tree.size**2)[:-1])
    assert tree.code[-1] + tree.size[-1] ** 2 == side_of(tree) ** 2
    np.testing.assert_allclose(tree.clearance, cKDTree(places).query(tree.center)[0], atol=1e-12)
    inside = (tree.center < surface.origin + np.array([7.0, 6.4])).all(axis=1)
    inside &= (tree.center >= surface.origin).all(axis=1)
    np.testing.assert_array_equal(tree.free, inside & (tree.clearance >= 0.06))
    np.testing.assert_array_equal(tree.whole, inside & (tree.clearance - np.sqrt(2.0) * tree.half_size >= 0.06))


@pytest.mark.parametrize("width", [0.01, 0.02])
def test_a_map_of_one_small_cell_is_a_leaf_or_four(width):
    surface = HeightMap(np.zeros(2), width, np.zeros((1, 1), np.float32), np.ones((1, 1), np.uint8))
    tree = build_quadtree(surface, build_tree(np.array([[0.1, 0.0]])), 0.095)
    assert len(tree.size) == (1 if width == 0.01 else 4)
    assert tree.size.tolist() == [1] * len(tree.size)


@pytest.mark.parametrize("seed", range(12))
def test_every_place_finds_its_leaf_and_what_lies_outside_finds_none(seed):
    rng, surface, places, radius = scene_of(seed)
    tree = build_quadtree(surface, build_tree(places), radius)
    wide = side_of(tree) * tree.width
    xy = tree.origin + rng.uniform(-0.3, 1.3, (300, 2)) * wide
    corners = np.array([1e-9, wide - 1e-9, wide + 1e-9, -1e-9])[:, None]
    xy = np.concatenate([xy, tree.origin + corners])
    low, high = tree.center - tree.half_size[:, None], tree.center + tree.half_size[:, None]
    for place, leaf in zip(xy, tree.find(xy), strict=True):
        holds = np.flatnonzero(((low <= place + 1e-12) & (place < high - 1e-12)).all(axis=1))
        assert [leaf] == (holds.tolist() or [-1])


@pytest.mark.parametrize("seed", range(12))
def test_leaves_that_meet_a_square_and_those_that_touch_others(seed):
    rng, surface, places, radius = scene_of(seed)
    tree = build_quadtree(surface, build_tree(places), radius)
    wide = side_of(tree) * tree.width
    for _ in range(20):
        xy, reach = tree.origin + rng.uniform(-0.2, 1.2, 2) * wide, rng.choice([0.0, 0.03, 0.2, 5.0])
        gap, found = np.abs(tree.center - xy).max(axis=1) - tree.half_size, tree.within(xy, reach)
        assert len(set(found.tolist())) == len(found)
        assert set(np.flatnonzero(gap < reach - 1e-9)) <= set(found.tolist())
        assert (gap[found] < reach + tree.width).all()
    some = rng.random(len(tree.size)) < 0.1
    low, high = tree.corner, tree.corner + tree.size[:, None]
    meets = (low[:, None] <= high[None]).all(axis=-1) & (low[None] <= high[:, None]).all(axis=-1)
    np.testing.assert_array_equal(touching(tree, some), (meets & some).any(axis=1))


@pytest.mark.parametrize("seed", range(24))
def test_a_tree_that_is_changed_is_the_one_that_is_built(seed):
    """Obstacles come and go, ground is seen and lost, here and there or at one place."""
    rng, surface, places, radius = scene_of(seed)
    old = build_quadtree(surface, build_tree(places), radius)
    high = np.array(surface.state.shape) * surface.cell_width
    come = surface.origin + rng.uniform(0.0, 1.0, (rng.integers(0, 4), 2)) * high
    gone = rng.random(len(places)) < rng.choice([0.0, 0.2])
    gone[0] = False
    state = surface.state.copy()
    if seed % 3 != 1:
        i, j = rng.integers(0, surface.state.shape)
        state[i : i + rng.integers(1, 4), j : j + rng.integers(1, 4)] ^= 1
    now, moved = np.concatenate([places[~gone], come]), np.concatenate([places[gone], come])
    after, tree = dataclasses.replace(surface, state=state), build_tree(now)
    around = build_tree(moved) if len(moved) else None
    made = build_quadtree(after, tree, radius, (old, around, turned(surface, after)))
    assert_equal(made, build_quadtree(after, tree, radius))


def assert_equal(made, built):
    for key in ("corner", "size", "free", "whole", "code"):
        np.testing.assert_array_equal(getattr(made, key), getattr(built, key), err_msg=key)
    np.testing.assert_allclose(made.clearance, built.clearance, atol=1e-9)


@pytest.mark.parametrize("seed", range(8))
def test_in_a_wide_hall_an_obstacle_that_comes_is_known_in_leaves_far_from_it(seed):
    rng = np.random.default_rng(seed)
    surface = HeightMap(np.zeros(2), 0.25, np.zeros((160, 160), np.float32), np.full((160, 160), OBSERVED, np.uint8))
    places = rng.uniform(0.0, 40.0, (5, 2))
    old, tree = build_quadtree(surface, build_tree(places[1:]), 0.2), build_tree(places)
    made = build_quadtree(surface, tree, 0.2, (old, build_tree(places[:1]), turned(surface, surface)))
    assert_equal(made, build_quadtree(surface, tree, 0.2))


@pytest.mark.parametrize("where", [0.05, 0.5])
def test_what_a_change_is_far_from_is_copied_and_what_it_is_near_is_made_anew(where):
    """The tree that is changed has a mark in each leaf: it stays where nothing came near."""
    rng = np.random.default_rng(1)
    surface = ground(rng, (40, 40), 0.1, unknown=0.0)
    places = surface.origin + rng.uniform(0.0, 4.0, (40, 2))
    old = build_quadtree(surface, build_tree(places), 0.12)
    marked = old._replace(clearance=old.clearance - 1e-6)
    come = surface.origin + 4.0 * where * np.ones((1, 2))
    tree = build_tree(np.concatenate([places, come]))
    made = build_quadtree(surface, tree, 0.12, (marked, build_tree(come), turned(surface, surface)))
    exact, half = tree_distance(tree, made.center), np.sqrt(2.0) * made.half_size
    stays = np.abs(made.clearance - exact + 1e-6) < 1e-9
    far = np.linalg.norm(made.center - come, axis=1)
    assert stays[far > np.maximum(exact, 0.12 + half) + 2.0 * half + 0.1].all()
    assert not stays[far < exact + 1e-9].any()
    assert stays.mean() > 0.5


def tree_distance(tree, xy):
    return cKDTree(tree.points).query(xy)[0]

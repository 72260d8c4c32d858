"""Answers along a way, each from the last one's nearest point on, are those from nothing on."""

import numpy as np
import pytest

from gpdf_service.fields import build_tree, fit_gpdf, sample_at
from gpdf_service.fields.traversal import nearest_along, nearest_at
from gpdf_service.fields.tree import make_scratch
from gpdf_service.kernel_cache import lean
from gpdf_service.types import FloatArray


@pytest.fixture(scope="module")
def wall() -> FloatArray:
    rng = np.random.default_rng(3)
    along = rng.uniform(0.0, 20.0, 3000)
    return np.column_stack([along, np.sin(along) + rng.normal(0.0, 0.002, 3000)])


@pytest.fixture(scope="module")
def way() -> FloatArray:
    """Small steps along the wall, and leaps."""
    rng = np.random.default_rng(4)
    steps = np.column_stack([np.linspace(0.0, 20.0, 200), np.linspace(2.0, -2.0, 200)])
    return np.concatenate([steps, rng.uniform(-5.0, 25.0, (200, 2))])


def test_the_nearest_point_is_as_near_from_the_last_one_on(wall: FloatArray, way: FloatArray) -> None:
    tree, along = build_tree(wall), make_scratch()
    for x, y in way:
        told, row = nearest_along(tree, (x, y, 0.0), along)
        assert told == pytest.approx(nearest_at(tree, (x, y, 0.0), make_scratch())[0], abs=1e-12)
        assert np.hypot(*(tree.points[row] - (x, y))) == pytest.approx(told, abs=1e-12)


def test_one_scratch_serves_two_trees_and_what_is_no_place(wall: FloatArray, way: FloatArray) -> None:
    trees, scratch = (build_tree(wall), build_tree(wall[:3] + 1.0)), make_scratch()
    for x, y in way[::10]:
        for tree in trees:
            fresh = nearest_at(tree, (x, y, 0.0), make_scratch())[0]
            assert nearest_along(tree, (x, y, 0.0), scratch)[0] == pytest.approx(fresh, abs=1e-12)
            assert nearest_along(tree, (np.nan, y, 0.0), scratch)[0] == 0.0


def test_enough_room_is_told_by_a_lower_bound_and_less_as_ever(wall: FloatArray, way: FloatArray) -> None:
    field, scratch, enough = fit_gpdf(wall).arrays, make_scratch(), 0.5
    exact, slope, bounds = np.empty(2), np.empty(2), 0
    for x, y in way:
        whole = sample_at(field, (x, y, 0.0), make_scratch(), exact)
        told = sample_at(field, (x, y, 0.0), scratch, slope, enough)
        if np.isnan(slope).all():
            bounds += 1
            assert enough <= told <= whole + 1e-12
        else:
            assert told == pytest.approx(whole, abs=1e-9)
            assert slope == pytest.approx(exact, abs=1e-6)
    assert 0 < bounds < len(way)


def test_a_lean_loop_writes_what_it_is_given_and_makes_nothing() -> None:
    @lean()
    def double(values: FloatArray) -> float:
        total = 0.0
        for i in range(len(values)):
            values[i] *= 2.0
            total += values[i]
        return total

    @lean()
    def copies(values: FloatArray) -> float:
        return float(values.copy().sum())

    values = np.arange(3.0)
    assert double(values) == 6.0
    assert values.tolist() == [0.0, 2.0, 4.0]
    with pytest.raises(Exception, match="NRT"):
        copies(values)

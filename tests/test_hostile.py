"""Clouds that nobody should send are answered in words, and take no more memory than a scene of their size may."""

from pathlib import Path

import numpy as np
import pytest

import gpdf_service as gpdf
from gpdf_service.bench.hostile import measure_all
from gpdf_service.config import Config, PerceptionConfig
from gpdf_service.errors import NoGroundError, TooLargeError
from gpdf_service.perception.cloud import find_strays
from gpdf_service.synthetic.hostile import KINDS, hostile_clouds
from gpdf_service.tiles.columns import compacted

CORNERS = np.array([[x, y, 0.0] for x in (0.0, 4900.0) for y in (0.0, 4900.0)])


def floor(side=4.0, step=0.04):
    x, y = (axis.ravel() for axis in np.meshgrid(*2 * [np.arange(0.0, side, step)], indexing="ij"))
    return np.column_stack([x, y, np.zeros(len(x))])


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="only Linux tells a process's peak")
def test_hostile_clouds_take_little_memory_and_each_is_answered_in_words():
    """Two of each kind, one with labels; `gpdf bench hostile` has a hundred."""
    rows = measure_all(2 * len(KINDS), seed=5)
    assert len(rows) == 2 * len(KINDS)
    assert [(row["cloud"], row["answer"]) for row in rows if not row["within"]] == []
    assert all(len(row["answer"].split()) > 5 for row in rows if not row["answer"].startswith("OK"))


def test_hostile_clouds_are_of_all_kinds_and_the_same_each_time():
    names = {cloud.name.rsplit(" ", 1)[0] for cloud in hostile_clouds(len(KINDS))}
    assert names == set(KINDS)
    one, other = (hostile_clouds(12, seed=3)[11].points for _ in range(2))
    assert np.array_equal(one, other)


@pytest.mark.parametrize("labelled", [True, False])
def test_four_points_over_kilometres_are_refused_before_memory_is_taken(labelled):
    with pytest.raises(TooLargeError, match=r"4 points over 4900 × 4900 m ask for .* GB") as caught:
        gpdf.build_scene(CORNERS, np.ones(4, dtype=bool) if labelled else None)
    assert "millimetres" in caught.value.try_
    assert "memory_budget" in caught.value.try_


def test_a_room_in_millimetres_is_refused_and_asked_for_its_unit():
    with pytest.raises(TooLargeError, match="millimetres"):
        gpdf.build_scene(1000.0 * floor(), np.ones(len(floor()), dtype=bool))


def test_an_outlier_is_named_with_where_most_points_are():
    points = np.concatenate([floor(), [[3000.0, 2500.0, 0.0]]])
    with pytest.raises(TooLargeError, match=r"Most points lie within 4 × 4 m: crop"):
        gpdf.build_scene(points, np.ones(len(points), dtype=bool))


def test_an_outlier_that_is_no_ground_costs_nothing():
    points = np.concatenate([floor(), [[3000.0, 2500.0, 0.0]]])
    ground = np.arange(len(points)) < len(points) - 1
    scene, without = gpdf.build_scene(points, ground), gpdf.build_scene(points[:-1], ground[:-1])
    assert scene.surfaces[0].state.size == without.surfaces[0].state.size


def test_who_has_the_memory_may_raise_the_budget():
    apart = np.concatenate([floor(), floor() + np.array([45.0, 45.0, 0.0])])
    ground = np.ones(len(apart), dtype=bool)
    small = Config(PerceptionConfig(memory_budget=1e8))
    with pytest.raises(TooLargeError):
        gpdf.build_scene(apart, ground, small)
    assert gpdf.build_scene(apart, ground, Config(PerceptionConfig(memory_budget=1.5e9))).surfaces


def test_strays_of_a_wide_cloud_are_those_of_its_parts():
    rng = np.random.default_rng(0)
    near = rng.uniform(0.0, 6.0, (3000, 3))
    apart = np.concatenate([near, near + np.array([4000.0, 3000.0, 0.0])])
    cells = int(4006 / 0.25) * int(3006 / 0.25)
    assert len(compacted(np.arange(len(apart)), cells)[2])
    plain = find_strays(near, 0.25)
    assert 0 < plain.sum() < len(plain)
    assert np.array_equal(find_strays(apart, 0.25), np.tile(plain, 2))


def test_ground_of_single_points_over_each_other_is_no_ground():
    """No sheet is large enough to stand on: it is said so."""
    points = np.random.default_rng(0).uniform(0.0, 30.0, (60, 3))
    points = np.concatenate([points, points + np.array([0.01, 0.0, 3.0])])
    with pytest.raises(NoGroundError, match="three by three cells"):
        gpdf.build_scene(points, np.ones(len(points), dtype=bool))

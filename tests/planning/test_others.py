"""Alternatives: they differ, they are certified, and they are what was asked for."""

import numpy as np
import pytest

import gpdf_service as gpdf
from gpdf_service.bench.judge import Judge
from gpdf_service.synthetic import Box, World
from gpdf_service.types import AGENTS


@pytest.fixture(scope="module")
def pillar():
    """A block in the middle of a room: two ways lead past it."""
    points, ground = World((6.0, 4.0, 2.6), (Box((2.6, 1.4, 0.0), (3.4, 2.4, 2.6)),)).sample(
        0.05, np.random.default_rng(0)
    )
    return gpdf.build_scene(points, ground), Judge(points, ground)


def test_the_other_way_round_a_pillar_is_an_alternative(pillar):
    scene, judge = pillar
    result = gpdf.plan(scene, (1, 1.8), (5, 1.8), alternatives=3)
    assert len(result.alternatives) == 1  # there is no third one
    (other,) = result.alternatives
    at_block = [way.trajectory.ground[np.abs(way.trajectory.ground[:, 0] - 3.0).argmin(), 1] for way in (result, other)]
    assert min(at_block) < 1.4 < 2.4 < max(at_block)
    assert result.details["cost"] <= other.details["cost"]
    for way in (result, other):
        assert way.status is gpdf.Status.OK
        assert way.certificate.holds
        assert judge.judge(way.trajectory, AGENTS["human"]).collision_free


def test_nobody_who_asks_for_none_gets_one(pillar):
    assert gpdf.plan(pillar[0], (1, 1.8), (5, 1.8)).alternatives == ()


def test_an_empty_room_has_one_way():
    points, ground = World((4.0, 3.0, 2.6), ()).sample(0.06, np.random.default_rng(0))
    assert gpdf.plan(gpdf.build_scene(points, ground), (1, 1), (3, 2), alternatives=2).alternatives == ()

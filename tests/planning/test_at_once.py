"""The stages in one kernel beside the same stages one after the other."""

from dataclasses import replace

import numpy as np
import pytest

import gpdf_service as gpdf
from gpdf_service.bench.plan import random_places
from gpdf_service.planning import planner
from gpdf_service.tiles.surface import UNKNOWN
from gpdf_service.types import AGENTS


@pytest.fixture
def asked(monkeypatch):
    """What the kernel made, of each way that it was asked for."""
    made, go = [], planner.go_at_once
    monkeypatch.setattr(planner, "go_at_once", lambda *args: made.append(go(*args)) or made[-1])
    return made


@pytest.mark.parametrize(("agent", "prefer"), [("human", None), ("human", "level"), ("roomba", "wide"), ("spot", None)])
def test_it_makes_what_the_stages_make(office, asked, monkeypatch, agent, prefer):
    scene = office[1]
    pairs = random_places(scene, AGENTS[agent], 20, np.random.default_rng(3))
    soon = [gpdf.plan(scene, *pair, agent, prefer=prefer) for pair in pairs]
    assert sum(one.is_bent for one in asked) > 10
    monkeypatch.setattr(planner, "_at_once", lambda *_: None)
    for one, pair in zip(soon, pairs, strict=True):
        other = gpdf.plan(scene, *pair, agent, prefer=prefer)
        assert (one.status, one.message, one.details) == (other.status, other.message, other.details)
        np.testing.assert_array_equal(one.costs, other.costs)
        if other.status is gpdf.Status.OK:
            for name in "positions", "ground", "times", "headings":
                np.testing.assert_array_equal(getattr(one.trajectory, name), getattr(other.trajectory, name))
            for name in type(other.certificate).__dataclass_fields__:
                np.testing.assert_array_equal(getattr(one.certificate, name), getattr(other.certificate, name))


def test_what_is_in_pieces_turns_or_has_no_time_is_made_by_stages(office, asked):
    made, scene = office
    ends = made.start, made.goal
    assert gpdf.plan(scene, *ends, replace(AGENTS["spot"], discs=2)).status is gpdf.Status.OK
    assert gpdf.plan(scene, *ends, "roomba", via=[(2.0, 1.0)]).status is gpdf.Status.OK
    assert gpdf.plan(scene, *ends, "roomba", deadline_s=1e-6, clock=lambda: 0.0).status is gpdf.Status.OK
    assert asked == []
    assert gpdf.plan(scene, *ends, "roomba", deadline_s=1.0, clock=lambda: 0.0).status is gpdf.Status.OK
    assert len(asked) == 1


@pytest.mark.parametrize("agent", ["human", "roomba", "spot"])
def test_a_way_over_ground_that_nobody_saw_is_not_proven_and_another_is_found(asked, agent):
    x, y = np.mgrid[0.0:4.0:0.04, 0.0:4.0:0.04].reshape(2, -1)
    scene = gpdf.build_scene(np.column_stack([x, y, np.zeros_like(x)]))
    ground = scene.free_space(agent).surfaces[0]
    cell = tuple(int(k[0]) for k in ground.cells(np.array([[2.0, 2.0]]))[:2])
    ground.state[cell], ground.height[cell] = UNKNOWN, np.nan  # no edge of the known ground stops the search there
    result = gpdf.plan(scene, [1.0, 2.0], [3.0, 2.0], agent)
    assert [made.seen.unknown for made in asked] == [True]
    assert result.status is gpdf.Status.OK
    assert ground.contains(result.trajectory.ground[:, :2]).all()

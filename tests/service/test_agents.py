"""The body that a request means."""

from dataclasses import asdict, replace

import numpy as np
import pytest

import gpdf_service as gpdf
from gpdf_service.errors import RequestError
from gpdf_service.service.handlers import agent_of

MEASURES = asdict(gpdf.AGENTS["spot"])


def test_measures_are_a_cylinder_unless_they_say_how_many_discs():
    cylinder = {key: value for key, value in MEASURES.items() if key != "discs"}
    assert agent_of(cylinder) == gpdf.AGENTS["spot"]
    assert agent_of(MEASURES | {"discs": 6}) == replace(gpdf.AGENTS["spot"], discs=6)


@pytest.mark.parametrize("discs", [0, 1000, 2.5, True, "6", None])
def test_discs_that_are_no_number_of_discs_are_refused(discs):
    with pytest.raises(RequestError, match="discs"):
        agent_of(MEASURES | {"discs": discs})


@pytest.mark.parametrize("change", [{"wings": 2.0}, {"height": "tall"}, {"width": 50.0}])
def test_other_measures_are_refused(change):
    with pytest.raises(RequestError):
        agent_of(MEASURES | change)
    with pytest.raises(RequestError, match="height"):
        agent_of({key: value for key, value in MEASURES.items() if key != "height"})


@pytest.mark.parametrize(
    "change", [{"height": "1"}, {"width": -0.1}, {"length": float("nan")}, {"discs": 1.5}, {"max_slope": 2}]
)
def test_a_body_that_cannot_be_is_refused_where_it_is_made(change):
    with pytest.raises(RequestError, match=next(iter(change))):
        replace(gpdf.AGENTS["spot"], **change)


def test_measures_given_as_integers_are_the_same_body():
    assert isinstance(replace(gpdf.AGENTS["spot"], height=1).height, float)


@pytest.mark.parametrize("change", [{"width": 1e6}, {"height": 1e-9}, {"speed": 1e-12}, {"acceleration": 1e300}])
def test_a_body_that_would_take_all_memory_is_refused_in_python_too(change):
    scene = gpdf.build_scene(np.random.default_rng(0).uniform((0, 0, 0), (3, 3, 0), (2000, 3)), np.ones(2000, bool))
    with pytest.raises(RequestError, match=next(iter(change))):
        gpdf.plan(scene, (1, 1), (2, 2), replace(gpdf.AGENTS["human"], **change))

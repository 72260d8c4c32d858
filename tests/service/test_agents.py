"""The body that a request means."""

from dataclasses import asdict, replace

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

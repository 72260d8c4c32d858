"""The guide beside ITU-T F.921, on a walk with the real service; and that each check can fail."""

import dataclasses

import numpy as np
import pytest

from gpdf_service.bench.f921 import RECOMMENDATIONS, hall, judged, listen
from gpdf_service.bench.guide import serving

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def heard():
    points, ground = hall(np.random.default_rng(0))
    with serving("hall", points, ground) as (_, client):
        yield listen(client, points, ground)


@pytest.mark.parametrize(
    "one", [one for one in RECOMMENDATIONS if one.check], ids=lambda one: f"{one.clause} {one.words}"
)
def test_what_applies_is_followed(heard, one):
    passed, evidence = one.check(heard)
    assert passed, evidence


def test_the_walk_touches_nothing_and_ends_at_the_goal(heard):
    assert heard.walk.penetration == 0.0
    assert heard.walk.end <= 0.2


def test_what_does_not_apply_says_why():
    assert all(one.check is not None or one.why_not for one in RECOMMENDATIONS)


def test_a_guide_that_keeps_silent_fails(heard):
    early = heard.walk.said[1]
    silent = dataclasses.replace(heard, walk=dataclasses.replace(heard.walk, said=(early,)), repeated="")
    failed = {row["should"] for row in judged(silent) if row["holds"] is False}
    assert len(failed) >= 10
    assert any("stairs" in words for words in failed)

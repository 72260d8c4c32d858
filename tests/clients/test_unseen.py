"""Ground that nobody has seen is told of before a person comes to it, and walked with care."""

from unittest.mock import Mock

import numpy as np
import pytest
from gpdf_client import Client
from gpdf_guidance import Guide, Kind, Outcome, Planner, Pose, Walker, planner, simulate
from gpdf_guidance.advice import NEAR_STEP, PACES, advise
from gpdf_guidance.features import FOOT, FeatureKind
from gpdf_guidance.unseen import with_unseen
from gpdf_guidance.walker import EXACT

from gpdf_service.ports import free_endpoint
from gpdf_service.service.server import Options, Server

CELL, RADIUS = 0.05, 0.25
HOLE = np.array([4.0, 4.0])
"""[m] Its middle, on a floor of 8 × 8 m."""
WIDE = 0.9
"""[m] Radius of a scanner's blind spot."""


def floor():
    """Centres of the cells of a floor [m]."""
    x, y = np.meshgrid(np.arange(0.0, 8.0, CELL) + CELL / 2, np.arange(0.0, 8.0, CELL) + CELL / 2)
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])


def found(seen, y=4.0, z=0.0):
    """What is told of a straight way at this y over a floor of which so much was seen."""
    x = np.arange(0.5, 7.51, 0.05)
    ground = np.column_stack([x, np.full_like(x, y), np.full_like(x, z)])
    return with_unseen((), ground, x - x[0], RADIUS, floor(), seen)


def test_a_hole_on_the_way_is_a_stretch_of_it_and_one_beside_is_none():
    seen = np.hypot(*(floor()[:, :2] - HOLE).T) > WIDE
    (one,) = found(seen)
    assert one.kind is FeatureKind.UNSEEN
    reach = WIDE - FOOT / 2 + RADIUS
    assert (one.start, one.end) == pytest.approx((3.5 - reach, 3.5 + reach), abs=2 * CELL)
    assert one.amount == pytest.approx(one.end - one.start)
    assert found(seen, y=4.0 + WIDE + RADIUS) == ()
    assert found(seen, z=3.0) == ()  # the storey above


def test_what_a_foot_bridges_is_not_told():
    cells = floor()
    strip = np.abs(cells[:, 0] - 4.0)
    assert found(strip > FOOT / 2 - CELL / 2) == ()
    (one,) = found(strip > 0.3)
    assert one.start < 3.5 < one.end
    single = np.random.default_rng(0).random(len(cells)) > 0.02
    assert found(single) == ()


def test_two_holes_near_each_other_are_told_of_together():
    x = floor()[:, 0]
    (one,) = found((np.abs(x - 3.5) > 0.3) & (np.abs(x - 4.7) > 0.3))
    assert one.start < 3.0 < 4.2 < one.end
    assert len(found((np.abs(x - 2.0) > 0.3) & (np.abs(x - 6.0) > 0.3))) == 2


@pytest.fixture(scope="module")
def client(tmp_path_factory):
    """Of a service with a floor that has a scanner's blind spot; it counts what is asked."""
    points = np.random.default_rng(0).uniform((0.0, 0.0, 0.0), (8.0, 8.0, 0.0), (60_000, 3))
    points = points[np.hypot(*(points[:, :2] - HOLE).T) > WIDE]
    address, folder = free_endpoint(), tmp_path_factory.mktemp("unseen")
    with Server(Options(address, folder, folder, 1)), Client.connect(address) as connected:
        connected.load_scene("floor", upload=points, ground=np.ones(len(points), dtype=bool))
        yield Mock(wraps=connected)


def test_who_is_led_over_a_blind_spot_hears_of_it_before_and_goes_slowly_there(client):
    guide = Guide(Planner(client, "floor"), (7.0, 4.0))
    walker = Walker(np.array([1.0, 4.0, 0.0]), 0.0, lambda place: 0.0, np.random.default_rng(0), EXACT)
    walk = simulate(guide, walker, None)
    assert walk.outcome is Outcome.ARRIVED
    (route,) = guide.routes
    (hole,) = [one for one in route.features if one.kind is FeatureKind.UNSEEN]
    assert hole.start < 3.0 < hole.end
    (said,) = [one for one in walk.said if one.instruction.kind is Kind.UNSEEN]
    assert said.text.endswith("use your cane: I never saw the ground there.")
    assert 0.0 < said.instruction.distance <= 2.5
    for s in np.arange(0.5, route.length - 1.5, 0.1):
        near = hole.start - NEAR_STEP <= s <= hole.end
        advice = advise(route, Pose(tuple(route.at(s)), route.heading_at(s), 0.0), 0.0, near=s)
        assert advice.pace == PACES[int(near)]


def test_in_a_place_of_more_cells_than_are_fetched_as_much_is_said(client, monkeypatch):
    def said():
        route = Planner(client, "floor").route(Pose((1.0, 3.4, 0.0), 0.0, 0.0), (7.0, 3.4)).route
        return [(one.start, one.end) for one in route.features if one.kind is FeatureKind.UNSEEN]

    whole, along = len(client.draw("floor", "ground").places), said()
    assert len(along) == 1
    monkeypatch.setattr(planner, "CELLS", whole // 4)
    assert said() == along


def test_beside_it_nothing_is_said_and_no_cell_is_fetched(client):
    fetched = client.draw.call_count
    route = Planner(client, "floor").route(Pose((1.0, 1.0, 0.0), 0.0, 0.0), (7.0, 1.0)).route
    assert all(one.kind is not FeatureKind.UNSEEN for one in route.features)
    assert client.draw.call_count == fetched

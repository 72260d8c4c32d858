"""Stairs are met squarely: in houses that nobody has seen before, up and down."""

import numpy as np
import pytest
from gpdf_client import Client
from gpdf_guidance import Guide, Kind, Outcome, Planner, Pose, Walker, simulate
from gpdf_guidance.ahead import SETTING_OFF, STEP_WINDOW
from gpdf_guidance.features import FeatureKind

from gpdf_service.bench.walks import WalkedWorld
from gpdf_service.ports import free_endpoint
from gpdf_service.service.server import Options, Server
from tests.clients.two_storeys import make_house

pytestmark = pytest.mark.slow

LARGEST_ASKEW = np.radians(25)  # the foot still points over the edge


@pytest.fixture(scope="module")
def client(tmp_path_factory):
    address, folder = free_endpoint(), tmp_path_factory.mktemp("house")
    with Server(Options(address, folder, folder, 1)), Client.connect(address) as connected:
        yield connected


@pytest.fixture(scope="module", params=[0, 1, 2, 23])  # 23: by its faces alone the line ends 15 cm beside its middle
def house(request, client):
    made = make_house(np.random.default_rng(request.param))
    client.load_scene("house", upload=made.points, ground=made.ground)
    return made, client


EARLIEST = 7.0
"""[m] Before stairs they are told: ITU-T F.921 says 6 ± 1 m."""
NEAR = STEP_WINDOW[1] + SETTING_OFF
"""[m] And again from here, or with the overview to who stands there."""


@pytest.mark.parametrize("down", [False, True], ids=["up", "down"])
def test_stairs_are_begun_and_left_in_their_line(house, down):
    made, client = house
    start, goal = (made.high, made.low) if down else (made.low, made.high)
    world, rng = WalkedWorld.of(made.points, made.ground), np.random.default_rng(0)
    walker = Walker(start.copy(), rng.uniform(-np.pi, np.pi), world.ground_height, rng)
    walk = simulate(Guide(Planner(client, "house"), goal.tolist()), walker, world)
    assert (walk.outcome, walk.reason, walk.penetration) == (Outcome.ARRIVED, "", 0.0)
    assert abs(walk.places[-1, 2] - goal[2]) < 0.01
    aside, askew = made.crossings(walk.places)
    assert max(aside) < made.half_width - 0.15  # half a stance
    assert max(askew) < LARGEST_ASKEW
    said = [one for said in walk.said for one in (said.instruction, said.instruction.soon) if one is not None]
    told = [one.distance for one in said if one.kind is Kind.STAIRS]
    assert 1.0 <= told[0] <= EARLIEST  # where the way there is long
    assert any(1.0 <= distance <= NEAR for distance in told)  # it may be said again at the foot
    assert Kind.STAIRS_EDGE in {one.kind for one in said}


def test_a_handrail_is_read_from_the_points_beside_the_stairs(client):
    made = make_house(np.random.default_rng(0))
    line = made.head - made.foot
    left = np.array([-np.sin(made.up), np.cos(made.up), 0.0]) * (made.half_width - 0.1)
    rail = made.foot + left + np.linspace(0.0, 1.0, 200)[:, None] * line + np.array([0.0, 0.0, 0.95])
    ground = np.append(made.ground, np.zeros(len(rail), dtype=bool))
    client.load_scene("railed", upload=np.concatenate([made.points, rail]), ground=ground)
    for start, goal, side in ((made.low, made.high, "left"), (made.high, made.low, "right")):
        found = Planner(client, "railed").route(Pose(tuple(start), 0.0, 0.0), goal.tolist())
        assert [one.rail for one in found.route.features if one.kind is FeatureKind.STAIRS] == [side]

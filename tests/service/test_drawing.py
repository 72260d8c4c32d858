import shutil

import numpy as np
import pytest
from gpdf_client import Client, InvalidRequestError, UnknownSceneError
from gpdf_schemas import Array, SceneReply, UpdateRequest, keys
from mcap.records import Channel

from gpdf_service.ground.limits import ObstacleKind
from gpdf_service.ports import free_endpoint
from gpdf_service.service import drawing
from gpdf_service.service.record import records_of
from gpdf_service.service.server import Options, Server

EXACT = 1e-4
"""[m] Places are drawn as f4."""


@pytest.fixture(scope="module")
def asked(office_file, tmp_path_factory):
    folder, endpoint = tmp_path_factory.mktemp("drawing"), free_endpoint()
    shutil.copy(office_file, folder / "office.gpdf")
    with Server(Options(endpoint, folder, folder / "log", 1)) as server, Client.connect(endpoint) as client:
        client.load_scene("office", "office.gpdf")
        yield server, client


def test_a_whole_cloud_comes_back_with_its_labels(asked, office, monkeypatch):
    monkeypatch.setattr(drawing, "PART_BYTES", 100_000)  # many parts
    shares = []
    scene = office[1]
    drawn = asked[1].draw("office", "cloud", progress=shares.append)
    assert len(shares) > 3
    assert shares[-1] == 1.0
    order = drawing._shuffled(len(scene.points))
    np.testing.assert_allclose(drawn.places + drawn.origin, scene.points[order], atol=1e-5)
    np.testing.assert_array_equal(drawn.columns["ground"] > 0, scene.ground[order])
    assert (drawn.columns["level"][drawn.columns["ground"] > 0] == 0).all()
    np.testing.assert_allclose(drawn.columns["above"][drawn.columns["ground"] > 0], 0, atol=0.36)  # a step's edge
    assert drawn.columns["above"].max() == pytest.approx(2.7, abs=0.01)
    assert set(drawn.columns["level"]) == {-1.0, 0.0}  # the outer face of a wall stands over no known ground


def test_a_thinned_cloud_shows_all_of_the_scene(asked, office):
    points = office[1].points
    drawn = asked[1].draw("office", "cloud", limit=2000)
    assert len(drawn.places) == 2000
    np.testing.assert_allclose((drawn.places + drawn.origin).mean(axis=0), points.mean(axis=0), atol=0.15)


def test_the_leaves_are_free_places_of_the_body_the_largest_first(asked, office):
    space = office[1].free_space("roomba")
    drawn = asked[1].draw("office", "leaves", "roomba", limit=500)
    half = drawn.columns["half_size"]
    assert len(half) == 500
    assert (np.diff(half) <= 0).all()
    exact, _ = space.levels[0].clearance(drawn.places[:, :2] + drawn.origin[:2])
    np.testing.assert_allclose(drawn.columns["clearance"], exact, atol=1e-5)
    assert exact.min() >= space.radius - 1e-9


def test_obstacles_have_their_reason_and_belong_to_the_body(asked, office):
    human, roomba = (asked[1].draw("office", "obstacles", agent) for agent in ("human", "roomba"))
    assert len(human.places) > len(roomba.places)
    kinds = office[1].free_space("roomba").levels[0].obstacles.kind
    for kind in ObstacleKind:
        assert (roomba.columns["kind"] == kind).sum() == (kinds == kind).sum()
    assert (roomba.columns["kind"] == ObstacleKind.STEP).any()
    assert not (human.columns["kind"] == ObstacleKind.STEP).any()


def test_the_ground_says_which_part_of_it_nobody_saw(asked, office):
    level = office[1].levels.levels[0]
    drawn = asked[1].draw("office", "ground")
    assert len(drawn.places) == len(level.ground_points)
    assert drawn.columns["inferred"].sum() == level.inferred.sum() > 0


@pytest.mark.parametrize("what", ["cloud", "ground", "obstacles", "leaves"])
def test_near_a_path_is_drawn_what_is_near_it_and_all_of_that(asked, what):
    path = np.column_stack([np.linspace(1.0, 5.0, 30), np.linspace(1.0, 4.0, 30), np.zeros(30)])
    whole, near = asked[1].draw("office", what), asked[1].draw("office", what, near=path, reach=0.4)
    expected = np.sort(whole.places[_away(whole, path) < 0.4 - EXACT], axis=0)
    assert 0 < len(expected) < len(whole.places) / 2
    assert _away(near, path).max() < 0.4 + EXACT
    found = near.places[_away(near, path) < 0.4 - EXACT]
    np.testing.assert_array_equal(np.sort(found, axis=0), expected)
    assert asked[1].draw("office", what, near=path[:, :2], reach=0.4, limit=10).places.tolist() == (
        near.places[:10].tolist()
    )


def _away(drawn, path):
    """How far from a path each place is, in plan [m]."""
    return np.linalg.norm((drawn.places + drawn.origin)[:, None, :2] - path[:, :2], axis=2).min(axis=1)


def test_where_nothing_is_near_nothing_is_drawn(asked):
    drawn = asked[1].draw("office", "ground", near=[[1e3, 1e3]], reach=1.0)
    assert drawn.places.shape == (0, 3)
    assert drawn.columns["inferred"].shape == (0,)


def test_colours_that_are_sent_with_a_cloud_are_drawn_and_those_of_what_is_taken_away_are_not(asked):
    x, y = np.meshgrid(np.arange(0.0, 4.0, 0.05), np.arange(0.0, 2.0, 0.05))
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    colours = np.column_stack([np.full(len(points), 255), 60.0 * points[:, 0], np.zeros(len(points))]).round()
    facts = asked[1].load_scene("painted", upload=points, colours=colours)
    assert facts["coloured"]
    assert not asked[1].info("office")["coloured"]
    cloud, ground = (asked[1].draw("painted", what) for what in ("cloud", "ground"))
    np.testing.assert_allclose(cloud.columns["colour"], 0xFF0000 + 256 * np.round(60.0 * cloud.places[:, 0]), atol=0)
    green = ground.columns["colour"].astype(int) >> 8 & 255
    np.testing.assert_allclose(green, 60.0 * ground.places[:, 0], atol=6.0)  # a cell is that of a point beside it
    asked[1].update_scene("painted", remove=points[points[:, 0] > 3.0])
    left = asked[1].draw("painted", "cloud")
    assert len(left.places) < 0.8 * len(points)
    np.testing.assert_allclose(left.columns["colour"], 0xFF0000 + 256 * np.round(60.0 * left.places[:, 0]), atol=0)


def test_colours_that_do_not_fit_are_refused(asked):
    with pytest.raises(InvalidRequestError, match=r"shape \(2, 5\)"):
        asked[1].load_scene("two", upload=np.zeros((2, 3)), colours=np.zeros((2, 2)))
    with pytest.raises(ValueError, match=r"shape \(2, 6\)"):  # and no four points of the six numbers
        asked[1].update_scene("office", np.zeros((2, 6)))
    change = UpdateRequest(
        scene="office", upload_id="u", part=0, parts=1, points=Array.pack(np.zeros((2, 6))), gone=Array.pack([0, 0])
    )
    with pytest.raises(InvalidRequestError, match=r"shape \(2, 6\)"):
        asked[1].ask(keys.SCENE_UPDATE, change, SceneReply, 30.0)


def test_what_cannot_be_drawn_is_refused_in_words(asked):
    client = asked[1]
    for near, reach in (([[0.0]], 1.0), (np.zeros((0, 2)), 1.0), ([1.0, 2.0], 1.0)):
        with pytest.raises(InvalidRequestError, match="near"):
            client.draw("office", "cloud", near=near, reach=reach)
    for reach in (0.0, -1.0):
        with pytest.raises(InvalidRequestError, match="reach"):
            client.draw("office", "cloud", near=[[0.0, 0.0]], reach=reach)
    with pytest.raises(InvalidRequestError, match="leaves"):
        client.draw("office", "dreams")
    with pytest.raises(InvalidRequestError, match="limit"):
        client.draw("office", "cloud", limit=0)
    with pytest.raises(InvalidRequestError, match="limit"):
        client.draw("office", "cloud", limit=drawing.MAX_ROWS + 1)
    with pytest.raises(UnknownSceneError, match="office"):
        client.draw("nowhere", "cloud")


def test_a_scene_replaced_in_mid_drawing_is_drawn_again_from_the_start(asked, office, monkeypatch):
    server, client = asked
    monkeypatch.setattr(drawing, "PART_BYTES", 200_000)
    scene = server.shelf.get("office").scene
    before = scene.version
    shares = []

    def replace(share):
        shares.append(share)
        if len(shares) == 2:
            scene.version = before + 1

    drawn = client.draw("office", "cloud", progress=replace)
    assert drawn.scene_version == before + 1
    assert len(drawn.places) == len(scene.points)
    assert len(shares) > 2 + 1


def test_drawings_are_not_in_the_log(office_file, tmp_path):
    shutil.copy(office_file, tmp_path / "office.gpdf")
    endpoint = free_endpoint()
    with Server(Options(endpoint, tmp_path, tmp_path, 1)) as server, Client.connect(endpoint) as client:
        client.load_scene("office", "office.gpdf")
        client.draw("office", "cloud")
        client.scenes()
    topics = {record.topic for record in records_of(server.recorder.path) if isinstance(record, Channel)}
    assert f"{keys.SCENES}/request" in topics
    assert not any(topic.startswith(keys.SCENE_DRAW) for topic in topics)

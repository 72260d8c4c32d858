"""Incremental mapping on the wire: scans change a scene while plans are answered from its last version."""

import queue
import threading

import numpy as np
import pytest
from gpdf_client import AsyncClient, Client, InvalidRequestError, ServiceError, Status, UnknownSceneError
from gpdf_schemas import Array, SceneReply, UpdateRequest, keys

import gpdf_service as gpdf
from gpdf_service.ports import free_endpoint
from gpdf_service.service import scenes
from gpdf_service.service.changes import Change, changed
from gpdf_service.service.scenes import FullError, Shelf
from gpdf_service.service.server import Options, Server
from tests.asynchronous import run

NOBODY = np.zeros((0, 3))
START, GOAL = (1.0, 1.5), (5.0, 1.5)
CLOSED = (Status.NO_VALID_PATH, Status.GOAL_OUTSIDE_MAP)
"""What a plan says of the far side of a wall: there is no way, or it is no ground that anything here leads to."""


def wall(x=3.0):
    y, z = np.meshgrid(np.arange(-0.5, 3.5, 0.05), np.arange(0.05, 2.0, 0.05))
    return np.column_stack([np.full(y.size, x), y.ravel(), z.ravel()])


@pytest.fixture(scope="module")
def hall():
    x, y = np.meshgrid(np.arange(0, 6, 0.05), np.arange(0, 3, 0.05))
    return gpdf.build_scene(np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]))


@pytest.fixture(scope="module")
def running(hall, tmp_path_factory):
    folder = tmp_path_factory.mktemp("updates")
    hall.save(folder / "hall.gpdf")
    with Server(Options(free_endpoint(), folder, folder / "log", 1)) as server:
        yield server


@pytest.fixture
def serving(running):
    """A service with the hall as it was."""
    with Client.connect(running.options.endpoint) as client:
        client.load_scene("hall", "hall.gpdf")
        yield running, client


def test_a_change_that_takes_everything_away_is_refused_in_words_and_the_scene_stays(serving, hall):
    _, client = serving
    with pytest.raises(ServiceError, match="no point would be left"):
        client.update_scene("hall", remove=np.array([[3.0, 1.5, 0.0]]), radius=5.0)
    assert client.scenes()["hall"]["points"] == len(hall.points)


def test_a_scan_closes_the_way_and_its_end_opens_it_again(serving, hall, monkeypatch):
    monkeypatch.setattr("gpdf_client.client.PART_POINTS", 1000)
    _, client = serving
    news = queue.Queue()
    client.watch_scenes(news.put)
    before = client.info("hall")
    turned = np.array([[0.0, -1.0, 0.0, 2.0], [1.0, 0.0, 0.0, -1.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    seen = (wall() - turned[:3, 3]) @ turned[:3, :3]  # in the sensor's frame
    after = client.update_scene("hall", seen, pose=turned)
    assert after["points"] == before["points"] + len(wall())
    assert after["version"] > before["version"]
    assert client.plan("hall", START, GOAL).status in CLOSED
    heard = news.get(timeout=30)
    assert (heard.scene, heard.version, heard.digest) == ("hall", after["version"], after["digest"])
    again = client.update_scene("hall", remove=wall(), radius=0.02)
    assert again["points"] == before["points"]
    result = client.plan("hall", START, GOAL)
    assert result.status is Status.OK
    assert result.scene_version == again["version"] > after["version"]
    assert result.trajectory.length == pytest.approx(gpdf.plan(hall, START, GOAL).trajectory.length, abs=0.01)


def test_a_scan_of_what_is_known_adds_little(serving):
    _, client = serving
    first = client.update_scene("hall", wall())["points"]
    assert client.update_scene("hall", wall() + 1e-4, thin=0.07)["points"] < first + 0.2 * len(wall())
    assert client.update_scene("hall", wall() + 1e-4)["points"] >= first + len(wall())
    with pytest.raises(InvalidRequestError, match="thin"):
        client.update_scene("hall", wall(), thin=-0.1)


def floor_in_a_shadow():
    """A floor of which a thing's shadow of 0.8 × 0.5 m was not seen, and which a station far above saw."""
    x, y = np.meshgrid(np.arange(0.01, 6, 0.03), np.arange(0.01, 6, 0.03))
    floor = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    return floor[(np.abs(floor[:, 0] - 4.6) > 0.4) | (np.abs(floor[:, 1] - 3.0) > 0.25)]


def test_a_scan_with_its_origin_shows_what_is_free(running, monkeypatch):
    """A sensor near the floor looks over the hole from either side: rays that pass low make it ground."""
    monkeypatch.setattr("gpdf_client.client.PART_POINTS", 7000)
    place = (4.6, 3.0)
    along = np.column_stack([np.full(40, 0.6), np.linspace(-0.3, 0.3, 40), np.full(40, -0.12)])  # in the sensor's frame
    poses = [np.eye(4), np.diag([-1.0, -1.0, 1.0, 1.0])]
    for pose, x in zip(poses, (4.55, 4.65), strict=True):
        pose[:3, 3] = x, 3.0, 0.12
    eyes = along * (0, 1, 0)
    with Client.connect(running.options.endpoint) as client:
        client.load_scene("floor", upload=floor_in_a_shadow(), origins=(3.0, 3.0, 40.0))
        assert client.plan("floor", (1.0, 1.0), place).status in (Status.GOAL_OUTSIDE_MAP, Status.GOAL_OCCUPIED)
        for pose in poses:
            client.update_scene("floor", along, pose=pose)
        assert client.plan("floor", (1.0, 1.0), place).status in (Status.GOAL_OUTSIDE_MAP, Status.GOAL_OCCUPIED)
        for pose in poses:
            client.update_scene("floor", along + np.array([0.01, 0.0, 0.0]), pose=pose, origins=eyes)
        assert client.plan("floor", (1.0, 1.0), place).status is Status.OK
        with pytest.raises(ValueError, match="origins of shape"):
            client.update_scene("floor", along, origins=eyes[:5])
        request = UpdateRequest(
            **{"scene": "floor", "upload_id": "a", "part": 0, "parts": 1, "points": Array.pack(along)},
            gone=Array.pack(np.zeros(40)),
            origins=Array.pack(eyes[:5]),
        )
        with pytest.raises(InvalidRequestError, match="origins"):
            client.ask(keys.SCENE_UPDATE, request, SceneReply, 10.0)


def test_the_next_version_outlives_the_service(hall, tmp_path):
    hall.save(tmp_path / "hall.gpdf")
    options = Options(free_endpoint(), tmp_path, tmp_path / "log", 1)
    with Server(options), Client.connect(options.endpoint) as client:
        client.load_scene("hall", "hall.gpdf")
        facts = client.update_scene("hall", wall())
    with Server(options) as server, Client.connect(options.endpoint) as client:
        server.shelf.settle()
        found = client.info("hall")
    assert (found["version"], found["digest"]) == (facts["version"], facts["digest"])


def test_changes_apply_in_order_and_equal_one_after_the_other(hall):
    box = np.random.default_rng(0).uniform((2.8, 1.0, 0.1), (3.2, 1.4, 1.0), (2000, 3))
    first, second = Change(box, NOBODY, 0.05), Change(wall(), box[:500], 0.05, wall(4.0))
    third = Change(box[:500], NOBODY, 0.05)
    quiet = lambda stage, done: None  # noqa: E731
    aside = box + np.array([0.0, 0.5, 0.0])
    fourth = Change(np.concatenate([box, aside]), NOBODY, 0.05, thin=0.04)
    together = changed(hall, [first, second, third, fourth], quiet)
    apart = hall
    for change in (first, second, third, fourth):
        apart = changed(apart, [change], quiet)
    assert together.digest == apart.digest
    assert together.version == hall.version + 1
    held = {tuple(point) for point in together.points.tolist()}
    assert {tuple(point) for point in box[:500].tolist()} <= held  # gone, and there again
    beside = len(np.unique(np.floor(aside / 0.04), axis=0))
    assert len(together.points) <= len(hall.points) + len(box) + len(wall()) + beside


def test_changes_that_wait_become_one_version_and_too_many_are_busy(hall, tmp_path, monkeypatch):
    hall.save(tmp_path / "hall.gpdf")
    versions, held = [], threading.Event()
    shelf = Shelf(tmp_path, lambda name, scene: versions.append(scene.version))
    shelf.load_file("hall", "hall.gpdf")
    shelf.settle()
    shelf._builder.submit(held.wait)  # a long build
    empty = np.zeros(100, dtype=bool)
    for i in range(5):
        assert shelf.add_change("hall", str(i), 0, 1, np.full((100, 3), 1.0 + 0.3 * i), empty, 0.05)
    assert not shelf.add_change("hall", "parts", 0, 2, np.full((100, 3), 1.0), empty, 0.05)
    monkeypatch.setattr(scenes, "MAX_WAITING_POINTS", 550)
    with pytest.raises(FullError, match="faster"):
        shelf.add_change("hall", "parts", 1, 2, np.full((100, 3), 1.0), empty, 0.05)
    held.set()
    shelf.settle()
    assert len(versions) == 2
    assert len(shelf.get("hall").scene.points) == len(hall.points) + 500
    assert shelf.add_change("hall", "parts", 1, 2, np.full((100, 3), 1.0), empty, 0.05)
    shelf.settle()
    assert len(versions) == 3
    shelf.close()


def test_a_change_of_no_sense_is_refused_and_one_that_leaves_nothing_keeps_the_old_version(serving, hall):
    _, client = serving
    with pytest.raises(UnknownSceneError, match="hall"):
        client.update_scene("nowhere", wall())
    with pytest.raises(ValueError, match="at least one"):
        client.update_scene("hall")
    with pytest.raises(ValueError, match="pose"):
        client.update_scene("hall", wall(), pose=np.eye(3))
    with pytest.raises(InvalidRequestError, match="radius"):
        client.update_scene("hall", wall(), radius=0.0)
    odd = UpdateRequest(
        scene="hall", upload_id="a", part=0, parts=1, points=Array.pack(wall()), gone=Array.pack(np.ones(3))
    )
    with pytest.raises(InvalidRequestError, match="gone"):
        client.ask(keys.SCENE_UPDATE, odd, SceneReply, 10.0)
    version = client.info("hall")["version"]
    with pytest.raises(ServiceError, match="BUILD_FAILED"):
        client.update_scene("hall", remove=hall.points)
    result = client.plan("hall", START, GOAL)
    assert (result.status, result.scene_version) == (Status.OK, version)


def test_an_asynchronous_client_streams_without_waiting(serving):
    server, client = serving

    async def stream():
        async with AsyncClient(Client.connect(server.options.endpoint)) as walker:
            assert await walker.update_scene("hall", wall(), wait=False) == {}
            return await walker.wait_for_scene("hall")

    assert run(stream())["points"] > client.info("hall")["points"] - 1
    assert client.plan("hall", START, GOAL).status in CLOSED

import shutil
import time

import numpy as np
import pytest
from gpdf_client import Client
from gpdf_schemas import Cylinder, MovingObstacle

from gpdf_service.cli import main
from gpdf_service.ports import free_endpoint
from gpdf_service.service.replay import recorded_scenes
from gpdf_service.service.server import Options, Server


@pytest.fixture(scope="module")
def logged(office, office_file, tmp_path_factory):
    """A log with one plan, and the scene it was planned in."""
    made, folder, endpoint = office[0], tmp_path_factory.mktemp("logged"), free_endpoint()
    shutil.copy(office_file, folder / "office.gpdf")
    with Server(Options(endpoint, folder, folder, 1)) as server, Client.connect(endpoint) as client:
        client.load_scene("office", "office.gpdf")
        client.plan("office", made.start, made.goal, "roomba", request_id="one")
    return server.recorder.path, folder / "office.gpdf"


def test_a_replayed_plan_is_drawn_beside_the_recorded_one(logged, tmp_path, capsys):
    log, scene = logged
    picture = tmp_path / "replay.png"
    assert main(["replay", str(log), "--scene", f"office={scene}", "--png", str(picture)]) == 0
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert "1 of 1 plans are identical" in capsys.readouterr().out


def test_a_picture_without_its_scene_is_refused_in_words(logged, tmp_path, capsys):
    log, scene = logged
    picture = tmp_path / "replay.png"
    assert main(["replay", str(log), "--png", str(picture)]) == 1
    assert "--scene" in capsys.readouterr().err
    assert main(["replay", str(log), "--scene", f"other={scene}", "--png", str(picture)]) == 1
    assert "'office'" in capsys.readouterr().err
    assert not picture.exists()


def test_a_log_is_replayed_with_the_scene_of_its_hash_wherever_that_is(logged, tmp_path, capsys, office):
    log, scene = logged
    moved = tmp_path / "elsewhere"
    moved.mkdir()
    (moved / "bad.gpdf").write_bytes(b"damaged")
    assert main(["replay", str(log), "--scenes-dir", str(moved)]) == 1
    assert office[1].digest in capsys.readouterr().err
    shutil.copy(scene, moved / "of_another_name.gpdf")
    assert main(["replay", str(log), "--scenes-dir", str(moved)]) == 0


def test_what_was_planned_in_a_version_that_is_not_given_is_left_out_and_told(logged, tmp_path, capsys):
    folder, endpoint, made = (
        logged[1].parent,
        free_endpoint(),
        np.array([[3.0, 4.5, z] for z in np.linspace(0.0, 0.5, 30)]),
    )
    with Server(Options(endpoint, folder, tmp_path / "log", 1)) as server, Client.connect(endpoint) as client:
        client.load_scene("office", "office.gpdf")
        client.plan("office", (1.0, 1.0), (2.0, 1.0), "roomba")
        client.update_scene("office", made)
        client.plan("office", (1.0, 1.0), (2.0, 1.0), "roomba")
    assert main(["replay", str(server.recorder.path), "--scenes-dir", str(folder)]) == 1
    said = capsys.readouterr()
    assert "1 of 1 plans are identical" in said.out
    assert "1 plans were not asked again" in said.err


def test_what_moved_moves_again_in_process_and_in_a_service_at_any_speed(office, office_file, tmp_path):
    made, endpoint = office[0], free_endpoint()
    shutil.copy(office_file, tmp_path / "office.gpdf")
    with Server(Options(endpoint, tmp_path, tmp_path, 1)) as server, Client.connect(endpoint) as client:
        client.load_scene("office", "office.gpdf")
        free = client.plan("office", made.start, made.goal, "roomba").trajectory
        x, y, z = free.ground[len(free.ground) // 2]
        box = MovingObstacle(id="box", cylinder=Cylinder((x, y, z), 0.2, 1.0), lifetime_s=600)
        client.publish_obstacles("office", [box])
        until = time.monotonic() + 300
        while not server.handlers.moving.points("office"):  # what is asked before it is heard is replayed without it
            assert time.monotonic() < until
            time.sleep(0.01)
        while np.array_equal(client.plan("office", made.start, made.goal, "roomba").trajectory.ground, free.ground):
            assert time.monotonic() < until
        client.publish_obstacles("office", [MovingObstacle(id="box", lifetime_s=0.0)])  # it has gone
        while server.handlers.moving.points("office"):
            assert time.monotonic() < until
            time.sleep(0.01)
        client.plan("office", made.start, made.goal, "roomba")
    log = str(server.recorder.path)
    assert main(["replay", log, "--scene", f"office={tmp_path}/office.gpdf"]) == 0
    with Server(Options(endpoint, tmp_path, tmp_path, 1)) as again:  # nothing moves there now
        again.shelf.settle()
        assert main(["replay", log, "--endpoint", endpoint]) == 0


@pytest.mark.slow
def test_a_service_is_asked_no_faster_than_it_was_and_one_that_is_gone_is_told(logged, capsys, tmp_path):
    (log, scene), endpoint = logged, free_endpoint()
    with Server(Options(endpoint, scene.parent, tmp_path / "more", 1)) as server:
        with Client.connect(endpoint) as client:
            client.load_scene("office", "office.gpdf")
            for start in ((1, 1), (1.2, 1)):
                client.plan("office", start, (2, 1), "roomba")
                time.sleep(0.4)
        assert main(["replay", str(log), "--endpoint", endpoint]) == 0
    with Server(Options(endpoint, scene.parent, tmp_path / "more", 1)) as again:  # it has the scene from before
        again.shelf.settle()
        began = time.monotonic()
        assert main(["replay", str(server.recorder.path), "--endpoint", endpoint, "--recorded-speed"]) == 0
        assert time.monotonic() - began > 0.4
    assert "3 of 3 plans are identical" in capsys.readouterr().out
    assert main(["replay", str(log), "--endpoint", endpoint]) == 1
    assert "no service at" in capsys.readouterr().err


def test_a_log_says_which_scenes_its_plans_were_made_in(logged, office):
    assert recorded_scenes(logged[0]) == {("office", 1): office[1].digest}

import pytest
from gpdf_client import Client

from gpdf_service.cli import main
from gpdf_service.service.replay import recorded_scenes
from gpdf_service.service.server import Options, Server


@pytest.fixture
def logged(office, free_endpoint, tmp_path):
    """A log with one plan, and the scene it was planned in."""
    made, scene = office
    scene.save(tmp_path / "office.gpdf")
    with Server(Options(free_endpoint, tmp_path, tmp_path, 1)) as server, Client.connect(free_endpoint) as client:
        client.load_scene("office", "office.gpdf")
        client.plan("office", made.start, made.goal, "roomba", request_id="one")
    return server.log_path, tmp_path / "office.gpdf"


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


def test_a_log_says_which_scenes_its_plans_were_made_in(logged, office):
    assert recorded_scenes(logged[0]) == {("office", 1): office[1].digest}

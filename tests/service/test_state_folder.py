"""The folder of ready scenes belongs to the service, and nothing else does."""

import pytest

from gpdf_service.errors import ConfigError
from gpdf_service.service.scene_files import COUNTER, SceneFiles
from gpdf_service.service.scenes import Shelf
from gpdf_service.service.server import Options, Server
from gpdf_service.service.state_folder import MARKER, StateFolder


def everything(folder):
    return {path.relative_to(folder): path.is_file() and path.read_bytes() for path in folder.rglob("*")}


@pytest.fixture
def home(tmp_path):
    """Somebody's home."""
    (tmp_path / ".config").mkdir()
    (tmp_path / ".config" / "keys").write_text("mine")
    (tmp_path / ".bashrc").write_text("mine")
    (tmp_path / ".0@9.gpdf.tmpabc").write_text("mine, too, whatever it is called")
    return tmp_path


def test_a_folder_that_is_not_ours_is_refused_and_nothing_in_it_is_touched(home, free_endpoint, tmp_path):
    before = everything(home)
    with pytest.raises(ConfigError, match=r"not ours \(\.bashrc, \.config\)"):
        Shelf(home, state_dir=home)
    with pytest.raises(ConfigError, match="empty folder"):
        Server(Options(free_endpoint, home, home / "log", 1, state_dir=home))
    after = {path: data for path, data in everything(home).items() if path.parts[0] != "log"}
    assert after == before


def test_in_our_own_folder_what_is_not_ours_stays_and_what_a_crash_left_goes(tmp_path):
    StateFolder(tmp_path).close()
    (tmp_path / ".env").write_text("mine")
    (tmp_path / ".config").mkdir()
    (tmp_path / "notes@home.gpdf").write_text("mine")
    for left in (".0@9.gpdf.tmpabc", ".0@9.gpdf.built", ".last_version", ".fetch-0", ".0.places.json"):
        (tmp_path / left).write_text("half")
    shelf = Shelf(tmp_path, state_dir=tmp_path)
    shelf.restore()
    shelf.settle()
    assert shelf.facts() == {}
    shelf.close()
    assert sorted(path.name for path in tmp_path.iterdir()) == [".config", ".env", MARKER, "journal", "notes@home.gpdf"]


def test_a_folder_from_before_there_were_markers_is_taken_over(tmp_path):
    for name in ("0@3.gpdf", "0.places.json", COUNTER):
        (tmp_path / name).write_text("3")
    StateFolder(tmp_path).close()
    assert (tmp_path / MARKER).is_file()


def test_a_folder_has_one_service_at_a_time(tmp_path):
    folder = StateFolder(tmp_path)
    with pytest.raises(ConfigError, match="another service"):
        StateFolder(tmp_path)
    folder.close()
    StateFolder(tmp_path).close()


@pytest.mark.parametrize("left", ["", "x", "\0\0\0\0"])
def test_a_counter_that_a_loss_of_power_emptied_stops_no_build_and_no_version_comes_again(tmp_path, left):
    files = SceneFiles(tmp_path)
    given = [files.next_version(41), files.next_version()]
    (tmp_path / COUNTER).write_text(left)
    given += [files.next_version(), files.next_version()]
    assert given[:2] == [41, 42]
    assert given == sorted(set(given))

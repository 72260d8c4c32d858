"""Named places: kept with the scene, used by every client."""

import json
import shutil

import numpy as np
import pytest
from gpdf_client import AsyncClient, Client, InvalidRequestError, UnknownPlaceError, UnknownSceneError

from gpdf_service.cli import main
from gpdf_service.errors import RequestError, SceneFileError
from gpdf_service.service.places import MAX_NAME, MAX_PLACES, Places
from gpdf_service.service.server import Options, Server
from tests.asynchronous import run


@pytest.fixture
def serve(free_endpoint, tmp_path, office_file):
    shutil.copy(office_file, tmp_path / "office.gpdf")

    def start():
        return Server(Options(free_endpoint, tmp_path, tmp_path / "log", 1))

    return start, free_endpoint


@pytest.mark.slow
def test_places_outlive_a_restart_and_a_new_version_but_not_their_scene(serve):
    start, endpoint = serve
    with start(), Client.connect(endpoint) as client:
        first = client.load_scene("office", "office.gpdf")["version"]
        assert client.places("office") == {}
        assert client.set_place("office", "entrance", (1, 1)) == {"entrance": [1.0, 1.0]}
        client.set_place("office", "Küche", (5, 3.3, 0.0))
        client.set_place("office", "entrance", (1.5, 1))
    both = {"entrance": [1.5, 1.0], "Küche": [5.0, 3.3, 0.0]}
    with start() as server, Client.connect(endpoint) as client:
        server.shelf.settle()
        assert client.places("office") == both
        assert client.load_scene("office", "office.gpdf")["version"] > first
        assert client.places("office") == both
        assert client.remove_place("office", "Küche") == {"entrance": [1.5, 1.0]}
        client.unload_scene("office")
        with pytest.raises(UnknownSceneError):
            client.places("office")
        client.load_scene("office", "office.gpdf")
        assert client.places("office") == {}


def test_a_plan_between_places_is_the_plan_between_their_positions(serve, office):
    start, endpoint = serve
    made, _ = office

    async def ask():
        async with await AsyncClient.connect(endpoint) as client:
            await client.set_place("office", "exit", made.goal)
            assert await client.where("office", "exit") == list(made.goal)
            assert (await client.plan("office", "entrance", "exit")).status == "OK"
            assert sorted(await client.remove_place("office", "exit")) == ["entrance", "kitchen"]
            assert sorted(await client.places("office")) == ["entrance", "kitchen"]

    with start(), Client.connect(endpoint) as client:
        client.load_scene("office", "office.gpdf")
        client.set_place("office", "entrance", made.start)
        client.set_place("office", "kitchen", made.goal)
        named = client.plan("office", "entrance", "kitchen")
        assert (
            named.trajectory.positions.tolist()
            == client.plan("office", made.start, made.goal).trajectory.positions.tolist()
        )
        with pytest.raises(UnknownPlaceError, match=r"'cellar'.*entrance, kitchen"):
            client.plan("office", "entrance", "cellar")
        with pytest.raises(UnknownPlaceError, match="entrance"):
            client.remove_place("office", "cellar")
        for name, position in (("a,b", (1, 1)), ("", (1, 1)), (" a", (1, 1)), ("a", (1,)), ("a", (1, 2, 3, 4))):
            with pytest.raises(InvalidRequestError):
                client.set_place("office", name, position)
        with pytest.raises(UnknownSceneError):
            client.set_place("nowhere", "a", (1, 1))
        run(ask())


def test_the_command_line_names_places_and_goes_there(serve, capsys):
    start, endpoint = serve
    with start(), Client.connect(endpoint) as client:
        client.load_scene("office", "office.gpdf")
        ask = ["client", "--endpoint", endpoint]
        assert main([*ask, "place", "office", "entrance", "--at", "1,1"]) == 0
        assert main([*ask, "place", "office", "status", "--at", "5,3.3,0"]) == 0
        assert capsys.readouterr().out.splitlines()[1:] == ["entrance: 1.0,1.0", "status: 5.0,3.3,0.0"]
        assert main([*ask, "place", "office", "--json"]) == 0
        assert json.loads(capsys.readouterr().out) == {"places": {"entrance": [1.0, 1.0], "status": [5.0, 3.3, 0.0]}}
        assert main([*ask, "plan", "office", "--start", "entrance", "--goal", "status"]) == 0
        via = client.plan("office", "entrance", "status", via=[(4.5, 1.0)])
        client.set_place("office", "corner", (4.5, 1.0))
        named = client.plan("office", "entrance", "status", via=["corner"])
        np.testing.assert_array_equal(named.trajectory.positions, via.trajectory.positions)
        assert client.plan("office", "entrance", "status", other_goals=["entrance"]).details["goal"] == 1
        words = [
            "plan",
            "office",
            "--start",
            "entrance",
            "--goal",
            "status",
            "--via",
            "corner",
            "--or-goal",
            "entrance",
        ]
        assert main([*ask, *words]) == 0
        assert main([*ask, *words, "--via", "nowhere"]) == 1
        client.remove_place("office", "corner")
        assert "corner, entrance, status" in capsys.readouterr().err
        assert main([*ask, "plan", "office", "--start", "entrance", "--goal", "nowhere"]) == 1
        assert "entrance, status" in capsys.readouterr().err
        walk = ["--endpoint", endpoint, "--start", "entrance", "--goal", "status", "--simulate"]
        assert main(["drive", "office", *walk, "--agent", "roomba"]) == 0
        assert main(["guide", "office", *walk]) == 0
        assert main(["guide", "office", *walk, "--goal", "nowhere"]) == 1
        assert "entrance, status" in capsys.readouterr().err
        assert main([*ask, "place", "office", "status", "--remove"]) == 0
        assert capsys.readouterr().out == "entrance: 1.0,1.0\n"
        for wrong in (["entrance"], ["entrance", "--at", "1,1", "--remove"], ["--remove"]):
            assert main([*ask, "place", "office", *wrong]) == 1


def test_a_scene_has_no_more_places_than_fit_into_a_reply():
    places = Places()
    for i in range(MAX_PLACES):
        places.put("hall", f"door {i}", (i, 0.0))
    places.put("hall", "door 0", (0.0, 1.0))
    with pytest.raises(RequestError, match="Remove one"):
        places.put("hall", "one more", (0.0, 0.0))
    with pytest.raises(RequestError, match="letters"):
        places.put("hall", "x" * (MAX_NAME + 1), (0.0, 0.0))
    assert len(places.of("hall")) == MAX_PLACES


def test_a_damaged_file_of_places_is_told_and_never_overwritten(tmp_path):
    Places(tmp_path).put("hall", "door", (1.0, 2.0))
    (file,) = tmp_path.iterdir()
    file.write_text('{"door": "open"}')
    places = Places(tmp_path)
    with pytest.raises(SceneFileError, match="hall"):
        places.of("hall")
    with pytest.raises(SceneFileError, match="hall"):
        places.put("hall", "window", (1.0, 2.0))
    assert file.read_text() == '{"door": "open"}'

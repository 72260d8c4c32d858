import argparse
import dataclasses
import json
import os
import re
import socket
import subprocess
import sys

import numpy as np
import pytest

from gpdf_service import cli
from gpdf_service.cli import VERBS, find_verb, main, overview
from gpdf_service.cli.bodies import add_body_arguments, body_of, read_agent
from gpdf_service.cli.inputs import read_config
from gpdf_service.errors import GpdfError
from gpdf_service.service.serve_verb import trouble_at
from gpdf_service.types import AGENTS


def write_room(path, with_labels=True):
    """A floor of 5 x 4 m with walls, 5 cm between points."""
    x, y = np.meshgrid(np.arange(0, 5.001, 0.05), np.arange(0, 4.001, 0.05), indexing="ij")
    floor = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    walls = []
    for z in np.arange(0.05, 2.5, 0.05):
        edge_x, edge_y = np.arange(0, 5.001, 0.05), np.arange(0, 4.001, 0.05)
        for side in (0.0, 4.0):
            walls.append(np.stack([edge_x, np.full_like(edge_x, side), np.full_like(edge_x, z)], axis=1))
        for side in (0.0, 5.0):
            walls.append(np.stack([np.full_like(edge_y, side), edge_y, np.full_like(edge_y, z)], axis=1))
    points = np.concatenate([floor, *walls])
    extra = {}
    if with_labels:
        extra = {"label": (np.arange(len(points)) < len(floor)).astype(int), "classes": np.array(["other", "floor"])}
    np.savez(path, xyz=points.astype(np.float32), **extra)
    return path


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_has_help(verb, capsys):
    with pytest.raises(SystemExit) as stop:
        main([*verb.split(), "--help"])
    assert stop.value.code == 0
    assert f"gpdf {verb}" in capsys.readouterr().out


def test_two_word_verbs_are_found_before_one_word_verbs():
    assert find_verb(["scene", "build", "x.npz"]) == "scene build"
    assert find_verb(["plan", "scene"]) == "plan"
    assert find_verb(["dance"]) is None


def test_no_verb_lists_the_verbs_and_fails(capsys):
    assert main([]) == 2
    assert "gpdf serve" in capsys.readouterr().err


def test_help_goes_to_standard_output(capsys):
    assert main(["--help"]) == 0
    assert "gpdf demo" in capsys.readouterr().out


def test_build_info_and_plan_agree(tmp_path, capsys):
    cloud = write_room(tmp_path / "room.npz")
    assert main(["scene", "build", str(cloud), "--json"]) == 0
    built = json.loads(capsys.readouterr().out)
    assert main(["scene", "info", built["file"], "--json", "--png", str(tmp_path / "info.png")]) == 0
    info = json.loads(capsys.readouterr().out)
    assert info["digest"] == built["digest"]
    assert len(info["levels"]) == 1
    assert (tmp_path / "info.png").read_bytes().startswith(b"\x89PNG")
    picture = tmp_path / "plan.png"
    words = [
        "plan",
        built["file"],
        "--start",
        "1,1",
        "--goal",
        "4,3",
        "--agent",
        "pepper",
        "--json",
        "--png",
        str(picture),
    ]
    assert main(words) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["status"] == "OK"
    assert result["certificate"]["holds"]
    assert result["certificate"]["min_clearance"] > 0
    np.testing.assert_allclose(result["trajectory"]["ground"][0][:2], [1, 1], atol=1e-6)
    np.testing.assert_allclose(result["trajectory"]["ground"][-1][:2], [4, 3], atol=1e-6)
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("agent", ["human", "roomba"])
def test_the_places_that_info_names_can_be_planned_between(agent, tmp_path, capsys):
    room = write_room(tmp_path / "room.npz")
    assert main(["scene", "info", str(room), "--agent", agent]) == 0
    *_, free, command = capsys.readouterr().out.splitlines()
    area = float(re.search(r"free ([\d.]+) m² in 1 piece", free)[1])
    radius = AGENTS[agent].disc_radius
    assert area == pytest.approx((5 - 2 * radius) * (4 - 2 * radius), rel=0.1)  # less what the margin takes
    words = command.split()
    assert words[:2] == ["try", "gpdf"]
    assert main([*words[2:-2], "--json"]) == 0
    reply = json.loads(capsys.readouterr().out)
    assert reply["status"] == "OK"
    assert reply["length"] > 1.5


def test_info_of_a_body_that_fits_nowhere_names_no_places(tmp_path, capsys):
    x, y = np.meshgrid(np.arange(0, 6, 0.05), np.arange(0, 0.35, 0.05))  # a plank narrower than a person
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    np.savez(tmp_path / "plank.npz", xyz=points, label=np.zeros(x.size, int), classes=np.array(["floor"]))
    assert main(["scene", "info", str(tmp_path / "plank.npz"), "--agent", "human", "--json"]) == 0
    reach = json.loads(capsys.readouterr().out)["reach"]
    assert reach["free_area"] == 0.0
    assert reach["start"] is None
    assert main(["scene", "info", str(tmp_path / "plank.npz"), "--agent", "human"]) == 0
    assert "try" not in capsys.readouterr().out


def test_a_cloud_too_narrow_to_stand_on_is_not_called_badly_labelled(tmp_path, capsys):
    x, y = np.meshgrid(np.arange(0, 6, 0.05), np.arange(0, 0.35, 0.05))
    np.savez(tmp_path / "plank.npz", xyz=np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]))
    assert main(["scene", "info", str(tmp_path / "plank.npz")]) == 1
    assert "wide and level enough to stand on" in capsys.readouterr().err


def test_a_plan_that_fails_exits_with_one_and_says_why(tmp_path, capsys):
    cloud = write_room(tmp_path / "room.npz")
    assert main(["plan", str(cloud), "--start", "1,1", "--goal", "40,3", "--json"]) == 1
    result = json.loads(capsys.readouterr().out)
    assert (result["status"], result["code"]) == ("GOAL_OUTSIDE_MAP", 204)
    assert "trajectory" not in result


def test_a_baseline_is_planned_by_name(tmp_path, capsys):
    cloud = write_room(tmp_path / "room.npz")
    assert main(["plan", str(cloud), "--start", "1,1", "--goal", "4,3", "--method", "astar", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["status"] == "OK"
    assert (
        main(["plan", str(cloud), "--start", "1,1", "--goal", "4,3", "--agent", "roomba", "--method", "single_gpdf"])
        == 1
    )
    assert capsys.readouterr().out.startswith("UNCERTIFIED")


def test_bad_input_exits_with_one_and_a_typed_error(tmp_path, capsys):
    assert main(["scene", "info", str(tmp_path / "none.npz"), "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["error"] == "CloudError"
    assert main(["scene", "info", str(tmp_path / "none.gpdf"), "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["error"] == "SceneFileError"


def test_files_that_cannot_be_read_or_written_are_said_without_a_traceback(tmp_path, capsys):
    cloud, nowhere = str(write_room(tmp_path / "room.npz")), str(tmp_path / "none" / "x")
    (tmp_path / "bad.toml").write_text("[perception")
    for words in (
        ["scene", "build", cloud, "--out", f"{nowhere}.gpdf"],
        ["scene", "info", cloud, "--png", f"{nowhere}.png"],
        ["scene", "info", cloud, "--config", f"{nowhere}.toml"],
        ["scene", "info", cloud, "--config", str(tmp_path / "bad.toml")],
        ["record", "check", "--repair", cloud],
        ["replay", cloud],
    ):
        assert main(words) == 1
        said = capsys.readouterr().err
        assert words[-1] in said
        assert said.startswith("gpdf: ")


def test_the_file_that_says_how_to_serve_says_how_to_build_as_well(tmp_path, capsys):
    assert main(["serve", "--print-config"]) == 0
    file = tmp_path / "all.toml"
    file.write_text(capsys.readouterr().out.replace("max_step = 0.37", "max_step = 0.2"))
    assert read_config(file).perception.max_step == 0.2


@pytest.mark.parametrize("verb", ["build", "crop --box 0,0,1,1", "merge x.npz"])
def test_a_folder_that_is_not_there_is_told_before_the_work(tmp_path, capsys, monkeypatch, verb):
    monkeypatch.setattr("gpdf_service.clouds.read_cloud", None)
    assert main(["scene", *verb.split(), "x.npz", "--out", str(tmp_path / "none" / "x.gpdf")]) == 1
    assert "its folder is not there" in capsys.readouterr().err


def test_options_of_a_build_are_refused_for_a_scene_that_is_built(tmp_path, capsys):
    assert main(["scene", "info", str(tmp_path / "x.gpdf"), "--ground-label", "0"]) == 1
    assert "--ground-label: the scene" in capsys.readouterr().err


def test_a_place_that_is_no_place_is_a_usage_error(tmp_path):
    with pytest.raises(SystemExit) as stop:
        main(["plan", "x.npz", "--start", "here", "--goal", "1,1"])
    assert stop.value.code == 2


def test_the_program_runs_as_a_module():
    words = [sys.executable, "-m", "gpdf_service.cli", "--version"]
    out = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    assert out.strip() == "0.1.0"


def test_a_place_may_begin_with_a_minus(tmp_path, capsys):
    words = ["plan", str(tmp_path / "none.npz"), "--start", "-1,2", "--goal", "-.5,-3"]
    assert main(words) == 1
    assert "expected one argument" not in capsys.readouterr().err


def test_a_verb_that_is_nearly_one_is_guessed(capsys):
    for words, meant in (
        (["sevre"], "serve"),
        (["scene", "inof", "x.npz"], "scene info"),
        (["bench", "plam"], "bench plan"),
    ):
        assert main(words) == 2
        assert f"Did you mean `gpdf {meant}`?" in capsys.readouterr().err
    assert main(["bogus"]) == 2
    said = capsys.readouterr().err
    assert "there is no verb 'bogus'" in said
    assert "gpdf drive" not in said


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (["plan", "x.npz", "--start", "1,1", "--gaol", "2,2"], "--goal"),
        (["scene", "build", "x.npz", "--output=x.gpdf"], "--out"),
        (["client", "plan", "office", "--strat", "1,1", "--goal", "2,2"], "--start"),
    ],
)
def test_an_option_that_is_nearly_one_is_guessed(words, meant, capsys):
    with pytest.raises(SystemExit, match="2"):
        main(words)
    assert f"Did you mean {meant}?" in capsys.readouterr().err


def test_the_begin_of_an_option_is_it_and_what_is_near_none_is_said_plainly(capsys):
    with pytest.raises(SystemExit):
        main(["plan", "x.npz", "--start", "1,1", "--goal", "2,2", "--zzzzzz"])
    assert "unrecognized arguments: --zzzzzz" in capsys.readouterr().err
    assert main(["plan", "x.npz", "--sta", "1,1", "--goal", "2,2"]) == 1
    assert "there is no such file" in capsys.readouterr().err


def test_the_help_of_a_group_is_the_groups(capsys):
    for word, others in (("scene", "gpdf bench"), ("bench", "gpdf scene"), ("record", "gpdf serve")):
        assert main([word, "--help"]) == 0
        said = capsys.readouterr().out
        assert f"gpdf {word} " in said
        assert others not in said


def test_a_bench_says_what_it_measures_before_it_is_loaded(monkeypatch, capsys):
    def stops(name):
        raise KeyboardInterrupt

    monkeypatch.setattr(cli, "import_module", stops)
    for verb in (verb for verb in VERBS if verb.startswith("bench ")):
        assert main([*verb.split(), "--json"]) == 130
        out, said = capsys.readouterr()
        assert said.startswith(f"gpdf {verb}: {VERBS[verb][1]}\n")
        assert out == ""
    assert main(["bench", "plan", "--help"]) == 130
    assert capsys.readouterr().err == ""


def test_the_help_lists_every_verb_once_and_the_exit_codes():
    said = overview()
    assert [said.count(f"  gpdf {verb} ") for verb in VERBS] == [1] * len(VERBS)
    assert all(f"\n  {code}" in said for code in (0, 1, 2, 130, 141))


def test_whoever_stops_reading_ends_it_quietly(tmp_path):
    room = write_room(tmp_path / "room.npz")
    words = f"{sys.executable} -m gpdf_service.cli scene info {room} --json | head -c 1; echo ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", words], capture_output=True, text=True, check=True)
    assert done.stderr == ""
    assert done.stdout.splitlines()[-1].lstrip("{") in ("0", "141")
    theirs, ours = os.pipe()
    os.close(theirs)  # nobody reads
    for verb in (["scene", "info", str(room)], ["--help"], ["scene", "--help"], ["--version"]):
        words = [sys.executable, "-m", "gpdf_service.cli", *verb]
        done = subprocess.run(words, stdout=ours, stderr=subprocess.PIPE, text=True)
        assert (done.stderr, done.returncode) == ("", 141)
    os.close(ours)


@pytest.mark.parametrize("verb", ["plan --start 1,1 --goal 2,2", "scene info", "scene build"])
def test_an_unknown_body_is_told_before_the_work(verb, capsys, monkeypatch):
    monkeypatch.setattr("gpdf_service.clouds.read_cloud", None)
    words = verb.split()
    count = 2 if words[0] == "scene" else 1
    assert main([*words[:count], "x.npz", *words[count:], "--agent", "rhino"]) == 1
    assert "there is no agent of that name" in capsys.readouterr().err


def test_a_picture_that_cannot_be_written_is_told_before_the_work(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("gpdf_service.clouds.read_cloud", None)
    for target, said in ((tmp_path / "none" / "x.png", "its folder is not there"), (tmp_path, "it may not be written")):
        assert main(["plan", "x.npz", "--start", "1,1", "--goal", "2,2", "--png", str(target)]) == 1
        assert said in capsys.readouterr().err


CART = """
height = 1.1
width = 0.6
length = 0.8
max_step = 0.01
max_slope = 0.1
speed = 0.7
acceleration = 0.5
turn_rate = 1.0
"""


def test_a_body_of_ones_own_is_planned_for(tmp_path, capsys):
    room = write_room(tmp_path / "room.npz")
    (tmp_path / "cart.toml").write_text(CART)
    words = ["plan", str(room), "--start", "1,1", "--goal", "4,3", "--json"]
    kept = {}
    for name, body in {
        "file": ["--agent-file", str(tmp_path / "cart.toml")],
        "wider": ["--agent-file", str(tmp_path / "cart.toml"), "--width", "1.2"],
        "slim": ["--width", "0.4", "--length", "0.3"],
    }.items():
        assert main([*words, *body]) == 0
        kept[name] = json.loads(capsys.readouterr().out)["certificate"]["min_clearance"]
    assert main([*words, "--width", "3.0"]) == 1
    assert "own human" in json.loads(capsys.readouterr().out)["message"]
    assert kept["wider"] > 0


def test_measures_on_the_command_line_take_the_place_of_the_bodys():
    parser = argparse.ArgumentParser()
    add_body_arguments(parser)
    body = body_of(parser.parse_args(["--agent", "pepper", "--width", "0.6", "--step", "0.03", "--slope", "12"]))
    known = AGENTS["pepper"]
    assert (body.width, body.max_step, body.length, body.height) == (0.6, 0.03, known.length, known.height)
    assert body.max_slope == pytest.approx(np.radians(12))
    assert body_of(parser.parse_args([])) is AGENTS["human"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (CART.replace("max_step = 0.01", ""), "it lacks max_step"),
        (CART + "colour = 1", "there is no key 'colour'"),
        (CART.replace("1.1", "11.0"), "height = 11.0"),
        ("like = 'rhino'", "no agent of that name"),
        ("height = ", "Invalid"),
    ],
)
def test_a_file_that_is_no_body_is_refused_in_words(text, said, tmp_path):
    (tmp_path / "cart.toml").write_text(text)
    with pytest.raises(GpdfError, match=said):
        read_agent(tmp_path / "cart.toml")


def test_a_file_may_say_how_a_body_differs_from_a_known_one(tmp_path):
    (tmp_path / "anna.toml").write_text("like = 'human'\nheight = 1.6")
    assert read_agent(tmp_path / "anna.toml") == dataclasses.replace(AGENTS["human"], name="anna", height=1.6)
    (tmp_path / "cart.toml").write_text(CART)
    assert read_agent(tmp_path / "cart.toml").max_step == 0.01


@pytest.mark.parametrize("host", ["127.0.0.1", "::1", "localhost"])
def test_a_port_that_is_taken_is_told_before_anything_is_built(tmp_path, capsys, host):
    with socket.create_server((host, 0), family=socket.getaddrinfo(host, 0)[0][0]) as other:
        endpoint = f"tcp/{f'[{host}]' if ':' in host else host}:{other.getsockname()[1]}"
        assert main(["serve", "room=none.npz", "--endpoint", endpoint, "--log-dir", str(tmp_path / "log")]) == 1
    assert f"cannot listen on {endpoint}: Address already in use" in capsys.readouterr().err
    assert not (tmp_path / "log").exists()
    assert trouble_at(endpoint) == ""


def test_an_address_of_another_machine_is_told_before_anything_is_built(tmp_path, capsys):
    words = ["serve", "room=none.npz", "--endpoint", "tcp/192.0.2.1:7447", "--log-dir", str(tmp_path / "log")]
    assert main(words) == 1  # RFC 5737: nobody's
    assert "Cannot assign requested address" in capsys.readouterr().err
    assert trouble_at("quic/192.0.2.1:7447") == ""  # Zenoh alone knows


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("plan x.npz --start nan,1 --goal 2,2", "'nan,1' is no place"),
        ("plan x.npz --start 1,1 --goal 2,inf", "'2,inf' is no place"),
        ("plan x.npz --start 1,1 --goal 2,2 --deadline -1", "'-1' is no number over 0"),
        ("plan x.npz --start 1,1 --goal 2,2 --thin nan", "'nan' is no number over 0"),
        ("scene info x.npz --scale 0", "'0' is no number over 0"),
        ("scene info x.npz --scale much", "'much' is no number over 0"),
    ],
)
def test_a_number_that_makes_no_sense_is_a_usage_error(words, said, capsys):
    with pytest.raises(SystemExit) as stop:
        main(words.split())
    assert stop.value.code == 2
    assert said in capsys.readouterr().err


def test_a_file_in_place_of_a_known_body_is_told_with_its_option(capsys):
    assert main(["plan", "x.npz", "--start", "1,1", "--goal", "2,2", "--agent", "cart.toml"]) == 1
    assert "Write --agent-file cart.toml." in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "said"),
    [("ros2 office --agent rhino", "there is no agent of that name"), ("belt /dev/none", "/dev/none")],
)
def test_what_is_wrong_here_is_told_before_a_service_is_looked_for(words, said, capsys, monkeypatch):
    monkeypatch.setattr("gpdf_client.client.Client.connect", None)
    assert main(words.split()) == 1
    assert said in capsys.readouterr().err


def test_what_is_no_endpoint_is_told_before_anything_is_loaded(capsys, monkeypatch):
    monkeypatch.setattr("zenoh.open", None)
    for flag in ("--endpoint", "--connect"):
        assert main(["serve", flag, "nonsense"]) == 1
        assert "'nonsense' is no endpoint. Write tcp/HOST:PORT" in capsys.readouterr().err


def test_the_endpoint_may_stand_behind_the_sub_verb_and_zenohs_sources_are_nobodys_business(capsys, free_endpoint):
    assert main(["client", "scenes", "--endpoint", free_endpoint]) == 1
    said = capsys.readouterr().err
    assert f"no service at {free_endpoint}" in said
    assert ".rs" not in said


WITHOUT_WHAT_COMPUTES = """
import sys
sys.modules["numba"] = sys.modules["scipy"] = None
from gpdf_service.cli import main
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.parametrize(
    "verb",
    [
        "scene info none.npz",
        "scene build none.gpdf",
        "scene crop none.ply --box 0,0,1,1 --out part.gpdf",
        "scene merge none.npz other.npz --out both.gpdf",
        "plan none.npz --start 1,1 --goal 2,2",
        "serve room=none.npz --endpoint ENDPOINT",
        "replay none.mcap",
        "record check none.mcap",
        "view --log none.mcap",
        "drive none.ply --start 1,1 --goal 2,2 --simulate",
        "bench plan --scene office --scene none.ply",
        "bench paper --scene=cave=none.ply",
        "bench ground --scene some/none.npz",
    ],
)
def test_a_file_that_is_not_there_is_told_before_anything_that_computes_is_loaded(verb, tmp_path, free_endpoint):
    words = [sys.executable, "-c", WITHOUT_WHAT_COMPUTES, *verb.replace("ENDPOINT", free_endpoint).split()]
    done = subprocess.run(words, capture_output=True, text=True, cwd=tmp_path, timeout=60)
    assert done.returncode == 1
    assert re.search(r"none\.\w+'?(: there is no such file| is not there|$)", done.stderr.strip())
    assert "needs" not in done.stderr
    assert list(tmp_path.iterdir()) == []

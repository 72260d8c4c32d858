import json

import numpy as np
import pytest
from matplotlib.image import imread

from gpdf_service.baselines import simd
from gpdf_service.bench import peers
from gpdf_service.bench.paper_pictures import draw_refused
from gpdf_service.bench.paper_tables import METHODS, to_markdown
from gpdf_service.bench.peers import compare
from gpdf_service.bench.plan import random_places
from gpdf_service.cli import main
from gpdf_service.search.places import is_clear
from gpdf_service.types import AGENTS

pytestmark = pytest.mark.slow


def write_floor(path, width, roof=()):
    """A square floor, and roofs at those heights, labelled."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(0, width, 0.05), np.arange(0, width, 0.05)))
    points = np.concatenate([np.column_stack([x, y, np.full(x.size, z)]) for z in (0.0, *roof)])
    label = (points[:, 2] == 0.0).astype(int)
    np.savez(path, xyz=points, label=label, classes=np.array(["other", "floor"]))


@pytest.fixture(scope="module")
def evaluated(tmp_path_factory, office):
    """The verb on a cloud of the office, which stands beside the paper's Office 1."""
    folder, made = tmp_path_factory.mktemp("paper"), office[0]
    labels = {"label": made.ground.astype(int), "classes": np.array(["other", "ground"])}
    np.savez(folder / "cloud.npz", xyz=made.points, **labels)
    words = ["bench", "paper", "--scene", f"office={folder / 'cloud.npz'}", "--agent", "human", "--queries", "3"]
    words += ["--keep", str(folder / "kept")]
    outputs = ["--json", str(folder / "rows.json"), "--markdown", str(folder / "tables.md"), "--png", str(folder)]
    assert main([*words, "--noise", "0", *outputs]) == 0
    return folder, json.loads((folder / "rows.json").read_text())


def test_every_method_is_measured_on_the_same_queries(evaluated):
    _, rows = evaluated
    assert [row["method"] for row in rows] == list(METHODS)
    assert len({(row["queries"], row["solvable"]) for row in rows}) == 1
    assert all(row["ok"] <= row["answered"] <= row["queries"] for row in rows)


def test_without_noise_ours_solves_what_can_be_solved_and_nothing_is_touched(evaluated):
    ours = evaluated[1][-1]
    assert ours["solvable"] > 0
    assert ours["ok_of_solvable"] == ours["solvable"]
    assert ours["collisions_in_ok"] == 0
    assert ours["strict_collision_free"] == ours["waypoints_collision_free"] == ours["strict_feasible"] == 100
    assert ours["strict_ground_m"] == pytest.approx(2.0, abs=0.1)


def test_the_tables_stand_beside_the_papers_numbers(evaluated):
    text = (evaluated[0] / "tables.md").read_text()
    lines = [line for line in text.splitlines() if line.startswith("| human | office (Office 1)")]
    assert len(lines) == 4
    assert [cell in lines[0] for cell in ("(60)", "(71)", "(98)", "100 · 100 (100)")] == [True] * 4
    assert "(0.286)" in lines[3]


def test_what_is_kept_is_not_made_again_unless_other_things_are_asked(evaluated, capsys):
    folder, rows = evaluated
    file = folder / "kept" / "office_human.json"
    kept = json.loads(file.read_text())
    assert kept["rows"] == rows
    words = ["bench", "paper", "--scene", f"office={folder / 'cloud.npz'}", "--agent", "human", "--noise", "0"]
    words += ["--keep", str(folder / "kept"), "--json", "--queries"]
    file.write_text(json.dumps(kept | {"rows": [{**rows[-1], "p50_cpu_ms": -1.0}]}))
    assert main([*words, "3"]) == 0
    assert [row["p50_cpu_ms"] for row in json.loads(capsys.readouterr().out)] == [-1.0]
    assert main([*words, "1"]) == 0
    assert [row["queries"] for row in json.loads(capsys.readouterr().out)] == [1] * 4


def test_scenes_in_processes_are_told_in_their_order(tmp_path, capsys):
    for name, width in (("large", 8.0), ("small", 3.0)):  # the second is done first
        write_floor(tmp_path / f"{name}.npz", width)
    words = ["bench", "paper", "--agent", "human", "--method", "astar", "--queries", "2", "--noise", "0", "--jobs", "2"]
    words += ["--scene", str(tmp_path / "large.npz"), "--scene", str(tmp_path / "small.npz")]
    assert main([*words, "--json"]) == 0
    assert [row["scene"] for row in json.loads(capsys.readouterr().out)] == ["large", "small"]


def test_the_pictures_are_drawn(evaluated):
    for name in ("office_methods.png", "office_bodies.png"):
        assert (evaluated[0] / name).read_bytes().startswith(b"\x89PNG")


def test_a_scene_where_nothing_could_be_solved_has_dashes_and_no_zeroes(evaluated):
    rates = {key: None for key in evaluated[1][0] if key.startswith(("waypoints_", "strict_"))}
    text = to_markdown([{**row, "scene": "nowhere", **rates} for row in evaluated[1]], 0.05)
    assert "| human | nowhere | – | – | – | – |" in text


def test_peers_are_held_to_the_same_validity(office):
    _, scene = office
    pairs = random_places(scene, AGENTS["human"], 1, np.random.default_rng(3))
    rows = compare(scene, AGENTS["human"], pairs)
    assert [row["planner"] for row in rows][:3] == ["dual_gpdf", "rrt_connect", "rrt_star"]
    for row in rows[:3]:
        assert row["solved"] == row["clear"] == row["compared"] == 1
        assert row["least_room_m"] >= -1e-9
        assert row["length_m"] >= np.linalg.norm(pairs[0, 1] - pairs[0, 0]) - 1e-9
    assert rows[1]["checks"] > 0
    assert 0.0 < rows[0]["p50_search_ms"] < rows[0]["p50_ms"]
    assert rows[1]["p50_search_ms"] == rows[1]["p50_ms"]


def test_what_a_peer_calls_free_is_judged_by_the_exact_test(office, monkeypatch):
    _, scene = office
    pairs = random_places(scene, AGENTS["roomba"], 12, np.random.default_rng(3))

    def straight(start, goal):
        return np.stack([start, goal]), 1e-6

    monkeypatch.setattr(simd, "is_here", lambda: True)
    monkeypatch.setattr(simd, "rrt_connect", lambda points, radius, low, high: straight)
    monkeypatch.setattr(peers, "PEERS", {})
    ours, theirs = peers.compare(scene, AGENTS["roomba"], pairs)
    obstacles = scene.free_space("roomba").levels[0].places
    clear = sum(bool(is_clear(obstacles, *pair, AGENTS["roomba"].radius)) for pair in pairs)
    assert theirs["planner"] == "vamp"
    assert theirs["p50_search_ms"] == pytest.approx(1e-3)
    assert theirs["clear"] == clear < theirs["solved"] == len(pairs)
    assert ours["clear"] == ours["solved"] > 0


@pytest.mark.skipif(not simd.is_here(), reason="VAMP is compiled by hand for one processor")
def test_vamp_goes_round_a_wall():
    wall = np.column_stack([np.full(80, 5.0), np.arange(80) * 0.05])
    find = simd.rrt_connect(wall, 0.3, np.zeros(2), np.full(2, 10.0))
    path, seconds = find(np.array([1.0, 1.0]), np.array([9.0, 1.0]))
    assert path is not None
    assert 0.0 < seconds < 1.0
    assert np.linalg.norm(np.diff(path, axis=0), axis=1).sum() > 2.0 * np.hypot(4.0, 3.0) - 0.1
    assert path[:, 1].max() > 4.0


def test_bench_plan_says_how_many_of_the_solvable_are_ok(capsys):
    words = ["bench", "plan", "--scene", "office", "--agent", "roomba", "--count", "4", "--peers", "0", "--json"]
    assert main(words) == 0
    (row,) = json.loads(capsys.readouterr().out)
    assert row["ok_of_solvable"] <= row["solvable"] <= row["queries"] == 4
    assert row["collisions"] == 0


def test_a_scene_without_room_fails_and_the_others_are_still_told(tmp_path, capsys):
    write_floor(tmp_path / "crawl.npz", 3.0, roof=[1.0])
    write_floor(tmp_path / "open.npz", 3.0)
    words = ["bench", "paper", "--scene", str(tmp_path), "--agent", "human", "--method", "astar", "--queries", "3"]
    assert main([*words, "--noise", "0", "--json"]) == 1
    said = capsys.readouterr()
    assert "no place in crawl where the human can stand" in said.err
    assert [row["scene"] for row in json.loads(said.out)] == ["open"]


def test_what_was_refused_is_drawn_where_it_was_refused(office, tmp_path):
    made, scene = office
    query = {"status": "START_OCCUPIED", "message": "an obstacle is 0.02 m from its centre", "at": [0.1, 2.0, 0.0]}
    row = {"scene": "office", "agent": "roomba", "noise_m": 0.0, "solvable": 7}
    free = {**query, "at": [3.0, 2.5, 0.0]}
    for name, refused in {"one": [query], "free": [free], "seven": [query] * 7}.items():
        draw_refused(tmp_path / f"{name}.png", scene, made.points, made.ground, {**row, "refused": refused})
    one, empty, seven = (imread(tmp_path / f"{name}.png")[..., :3] for name in ("one", "free", "seven"))
    assert seven.shape[0] == 2 * one.shape[0]
    there = np.array([0x00, 0x72, 0xB2]) / 255
    assert pixels(one, there) > pixels(empty, there) > 0  # those of the legend


def pixels(picture, colour):
    return (np.abs(picture - colour) < 0.01).all(axis=-1).sum()

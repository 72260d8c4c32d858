"""`gpdf bench plan --moving`: what it tells, and that its judge sees who is touched."""

import json

import numpy as np
import pytest

import gpdf_service as gpdf
from gpdf_service.bench.moving import measure_moving, touches
from gpdf_service.cli import main


def post(x, y, low, high):
    z = np.arange(low, high, 0.02)
    return np.column_stack([np.full(len(z), x), np.full(len(z), y), z])


@pytest.mark.parametrize("agent", ["human", "roomba"])
def test_who_stands_on_the_way_is_touched_and_who_stands_beside_it_is_not(office, agent):
    made, scene = office
    result, body = gpdf.plan(scene, made.start, made.goal, agent), gpdf.AGENTS[agent]
    way = result.trajectory.ground
    middle = way[len(way) // 2]
    assert touches(result, post(*middle[:2], 0.0, 0.09), body)
    assert not touches(result, post(*middle[:2], body.height + 0.05, 2.5), body)
    apart = np.linalg.norm(way[:, :2] - middle[:2], axis=1).max() + 2.0
    assert not touches(result, post(middle[0] + apart, middle[1], 0.0, 1.0), body)


def test_somebody_in_the_way_makes_only_the_change_again(office, monkeypatch):
    scene = office[1]
    scene.free_space("roomba")
    for searched in ("build_quadtree", "build_tree", "obstacles_of"):
        monkeypatch.setattr(f"gpdf_service.search.free_space.{searched}", None)  # nothing that stands is built again
    row = measure_moving(scene, gpdf.AGENTS["roomba"], 3, np.random.default_rng(0))
    assert row["pairs"] == 3
    assert row["collisions"] == 0
    assert row["change_p50_ms"] > 0.0


def test_the_verb_prints_a_row_for_each_scene_and_body(capsys):
    assert main(["bench", "plan", "--moving", "--scene", "office", "--agent", "roomba", "--count", "2", "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)
    assert (row["scene"], row["agent"], row["pairs"]) == ("office", "roomba", 2)
    assert {"standing_p50_ms", "moving_p99_ms", "later_p50_cpu_ms", "change_p99_cpu_ms"} <= row.keys()

"""What is taken out of a build is missed."""

import importlib

import numpy as np
import pytest

from gpdf_service import build_scene
from gpdf_service.bench.rules import RULES, rule_rows, without
from gpdf_service.bench.scanned import judge, scanned
from gpdf_service.synthetic import SCENES
from gpdf_service.synthetic.scenes import random_room

NOISY = SCENES["stair"](np.random.default_rng(0), spacing=0.15, noise=0.02)


def test_a_scanner_sees_no_floor_under_itself_and_nothing_behind_a_wall():
    x, y = (axis.ravel() for axis in np.meshgrid(*2 * [np.arange(0.0, 6.0, 0.05)]))
    floor = np.column_stack([x, y, np.zeros(x.size)])
    wall = np.column_stack([np.full(4000, 3.0), *np.random.default_rng(0).uniform([0, 0], [6, 2.5], (4000, 2)).T])
    open_, shut = (
        scanned(cloud, cloud, np.random.default_rng(1))[: len(floor)].mean()
        for cloud in (floor, np.concatenate([floor, wall]))
    )
    assert 0.9 < open_ < 0.99
    assert shut < open_


@pytest.mark.parametrize("rule", RULES)
def test_each_rule_is_where_it_is_said_to_be_and_is_on_again(rule):
    module, name, off = RULES[rule]
    on = getattr(importlib.import_module(module), name)
    with without(rule):
        assert getattr(importlib.import_module(module), name) is off is not on
    assert getattr(importlib.import_module(module), name) is on


@pytest.mark.parametrize("rule", RULES)
def test_a_noisy_stair_is_built_without_any_rule(rule):
    with without(rule):
        assert build_scene(NOISY.points).ground.any()


def test_a_build_without_a_rule_is_another():
    clean = random_room(np.random.default_rng(1))
    points = clean.points[scanned(clean.points, clean.points, np.random.default_rng(1))]
    whole = judge(build_scene(points), clean)
    with without("filling of holes"):
        bare = judge(build_scene(points), clean)
    assert whole["known_of_true"] > bare["known_of_true"]
    assert whole["human_free_of_true"] > bare["human_free_of_true"]
    assert whole["wrong_of_known"] < 0.02


def test_a_rule_is_told_by_the_first_scenes_that_it_moves(tmp_path, monkeypatch):
    asked = []

    def rooms(seed, count, labelled=False):
        if not labelled:
            asked.append((seed, count))
        return {"known": build_scene(floor).surfaces[0].cell_width}

    floor = np.column_stack([*(axis.ravel() for axis in np.meshgrid(*2 * [np.arange(0.0, 2.0, 0.05)])), np.zeros(1600)])
    for name in ("_houses", "_crowded", "_islands", "_depth", "_reflections"):
        monkeypatch.setattr(f"gpdf_service.bench.rules.{name}", lambda *_, **__: {"ways": len(asked)})
    monkeypatch.setattr("gpdf_service.bench.rules._rooms", rooms)
    rows = list(rule_rows(tmp_path, 1, 2, ["ceilings", "roofs"]))
    assert [row["without"] for row in rows] == ["ceilings", "roofs"]
    assert rows[0] == {"without": "ceilings", "in": "all", "moves": "nothing"}
    assert rows[1]["in"] == "islands"
    assert rows[1]["moves"] == "ways 2 → 3"
    assert asked == [(1, 2)] * 3

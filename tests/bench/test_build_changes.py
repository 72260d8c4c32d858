import numpy as np
import pytest

import gpdf_service as gpdf
from gpdf_service.bench import build_wild
from gpdf_service.bench.build_changes import differences, measure_changes
from gpdf_service.bench.report import Subject
from gpdf_service.synthetic.places import PLACES
from gpdf_service.synthetic.scanners import SCANNERS
from gpdf_service.synthetic.scenes import random_room


@pytest.mark.parametrize(("noise", "origin"), [(0.0, None), (0.0, (2.0, 2.0, 1.5)), (0.01, None)])
def test_changes_of_a_room_are_measured_and_equal_builds(noise, origin):
    points = random_room(np.random.default_rng(7)).points
    origins = None if origin is None else np.broadcast_to(origin, points.shape)
    row = measure_changes(Subject("room", points, origins=origins), noise, 2, 1)
    assert (row["noise_m"], row["changes"], row["as_a_whole"], row["equal"]) == (noise, 2, 0, "1 of 1")
    assert row["origins"] == (origin is not None)
    assert 0.0 < row["free_space_median_cpu_s"] < row["median_cpu_s"] <= row["worst_cpu_s"]
    assert row["from_scratch_median_cpu_s"] > row["median_cpu_s"]


@pytest.mark.parametrize(("labels", "origins"), [(False, True), (True, False)])
def test_changes_of_any_kind_are_held_against_builds(labels, origins, monkeypatch):
    monkeypatch.setattr(build_wild, "KINDS", {kind: build_wild.KINDS[kind] for kind in ("board", "strays")})
    rng = np.random.default_rng(2)
    scan = SCANNERS["handheld"](PLACES["platform"](rng), rng, 0.006).thinned(0.06, rng)
    row = build_wild.measure_wild(scan, labels, origins, 3, rng)
    assert (row["made"] + row["refused"], row["other"]) == (3, "")
    assert 0 < row["made"] > row["as_a_whole"]


def test_a_version_that_is_no_build_is_named_by_its_kind_of_change(monkeypatch):
    monkeypatch.setattr(build_wild, "from_scratch", lambda scene: gpdf.build_scene(scene.points[::2]))
    monkeypatch.setattr(build_wild, "KINDS", {"board": build_wild.KINDS["board"]})
    rng = np.random.default_rng(2)
    scan = SCANNERS["handheld"](PLACES["platform"](rng), rng, 0.006).thinned(0.06, rng)
    assert build_wild.measure_wild(scan, False, False, 1, rng)["other"].startswith("board: ")


def test_scenes_that_differ_are_told_apart():
    points = random_room(np.random.default_rng(7)).points
    scene = gpdf.build_scene(points)
    middle = np.array([*points[:, :2].mean(axis=0), points[scene.ground, 2].min()])
    box = middle + np.random.default_rng(0).uniform(0.0, 0.3, (400, 3))
    other = gpdf.build_scene(np.concatenate([points, box]), np.r_[scene.ground, np.zeros(len(box), dtype=bool)])
    assert differences(scene, scene) == []
    assert differences(scene, other) == ["ground"]
    labelled = gpdf.build_scene(points, scene.ground)
    moved = gpdf.build_scene(points + np.where(scene.ground[:, None], 0.0, [0.1, 0.0, 0.0]), scene.ground)
    assert "other points" in differences(labelled, moved)
    assert "leaves" in differences(labelled, moved)

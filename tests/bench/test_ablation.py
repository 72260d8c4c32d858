"""What is taken out of a build is missed."""

import numpy as np

from gpdf_service.bench.ablation import compare, scanned
from gpdf_service.synthetic.scenes import random_room


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


def test_filling_adds_ground_and_free_places_and_no_wrong_ones():
    clean = random_room(np.random.default_rng(1))
    rows = {row["built"]: row for row in compare("room", clean, clean.points, np.random.default_rng(1))}
    assert list(rows) == ["all", "no cure", "no filling"]
    whole, bare = rows["all"], rows["no filling"]
    assert whole["known_of_true"] > bare["known_of_true"]
    assert whole["human_free_of_true"] > bare["human_free_of_true"]
    assert whole["wrong_of_known"] < 0.02
    assert whole["iou"] == rows["no cure"]["iou"] > 0.95  # the cloud is clean

"""Clouds of voxels' centres: a floor between two rungs has points on both, and is one floor."""

from __future__ import annotations

import numpy as np
import pytest

from gpdf_service.bench.houses import scanned_house
from gpdf_service.config import PerceptionConfig
from gpdf_service.perception.segment import Grain, segment
from gpdf_service.pipeline import build_scene, plan
from gpdf_service.types import Status

PITCH = 0.05


def middles(points):
    return (np.unique(np.floor(np.asarray(points) / PITCH).astype(int), axis=0) + 0.5) * PITCH


def floor(share, rng, size=80):
    """Voxels of a level floor, of which a `share` is on the rung above, too."""
    x, y = (each.ravel() for each in np.meshgrid(np.arange(size), np.arange(size), indexing="ij"))
    low = (np.column_stack([x, y, np.zeros_like(x)]) + 0.5) * PITCH
    return np.concatenate([low, low[rng.random(len(low)) < share] + [0.0, 0.0, PITCH]])


def found(points):
    return segment(points, PerceptionConfig(), Grain(pitch=PITCH))[0]


@pytest.mark.parametrize("share", [0.05, 0.3, 0.9])
def test_a_floor_between_two_rungs_is_ground_on_both(share):
    points = floor(share, np.random.default_rng(1))
    inner = (np.abs(points[:, :2] - 2.0) < 1.7).all(axis=1)  # around the outermost cells nothing says what they are
    assert found(points)[inner].all()
    upper = inner & (points[:, 2] > PITCH)
    assert not segment(points, PerceptionConfig())[0][upper].any()  # as long as nobody knows that they are voxels


def test_a_kerb_of_one_rung_and_a_thing_of_one_rung_stay_what_they_are():
    """The voxels of a thing hide the floor beneath; of a kerb each side shows one rung, and its edge both."""
    points = floor(0.0, np.random.default_rng(1))
    thing = (np.abs(points[:, :2] - [1.0, 1.0]) < 0.13).all(axis=1)
    points[thing, 2] += PITCH
    rim = points[(np.abs(points[:, :2] - [1.0, 1.0]) < 0.13).all(axis=1)] - [0.0, 0.0, PITCH]
    rim = rim[(np.abs(rim[:, :2] - [1.0, 1.0]) > 0.1).any(axis=1)]  # its side reaches the floor
    points = np.concatenate([points, rim])
    thing = points[:, 2] > PITCH
    assert thing.sum() == 36
    assert not found(points)[thing].any()


def test_a_house_of_voxels_centres_is_climbed():
    """Its floors lie between two rungs: the upper one was a thing on the lower."""
    place, scan = scanned_house(5, "handheld", thin=PITCH, centres=True)
    rng, ground = np.random.default_rng(5), scan.points[scan.ground]
    ends = place.seen_end(0, ground, rng), place.seen_end(len(place.rooms) - 1, ground, rng)
    scene = build_scene(scan.points)
    assert [plan(scene, *way, "human").status for way in (ends, ends[::-1])] == [Status.OK, Status.OK]

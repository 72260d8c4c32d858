"""Stairs in coarse maps: one point of each voxel is kept, and a cell is half as wide as a tread."""

from __future__ import annotations

import numpy as np
import pytest

from gpdf_service import build_scene, plan
from gpdf_service.bench.houses import scanned_house
from gpdf_service.types import Status


@pytest.mark.parametrize(
    ("seed", "voxel"),
    [
        (3, 0.08),  # its treads were slopes, as the flight is over three cells
        (2, 0.08),  # its treads and a landing were one part, joined by cells of risers' faces alone
    ],
)
def test_a_house_of_wide_voxels_is_climbed(seed, voxel):
    place, scan = scanned_house(seed, "handheld", thin=voxel)
    rng, floor = np.random.default_rng(seed), scan.points[scan.ground]
    ends = place.seen_end(0, floor, rng), place.seen_end(len(place.rooms) - 1, floor, rng)
    scene = build_scene(scan.points)
    assert [plan(scene, *way, "human").status for way in (ends, ends[::-1])] == [Status.OK, Status.OK]

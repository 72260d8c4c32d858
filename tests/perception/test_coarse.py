"""Stairs in coarse maps: one point of each voxel is kept, and a cell is half as wide as a tread."""

from __future__ import annotations

import numpy as np
import pytest

from gpdf_service import build_scene, plan
from gpdf_service.bench.houses import scanned_house
from gpdf_service.ground.foot import FACE
from gpdf_service.perception.ledges import find_ledges
from gpdf_service.tiles.surface import OBSERVED, HeightMap
from gpdf_service.types import Status


@pytest.mark.parametrize(
    ("seed", "voxel"),
    [
        (3, 0.08),  # its treads were slopes: the next one up counted among what is around
        (2, 0.08),  # seven treads and a landing are one part, as high as the floor's slab at its upper end
        (14, 0.1),  # of its first tread no point is in the floor's cells, where its face is
    ],
)
def test_a_house_of_wide_voxels_is_climbed(seed, voxel):
    place, scan = scanned_house(seed, "handheld", thin=voxel)
    rng, floor = np.random.default_rng(seed), scan.points[scan.ground]
    ends = place.seen_end(0, floor, rng), place.seen_end(len(place.rooms) - 1, floor, rng)
    scene = build_scene(scan.points)
    assert [plan(scene, *way, "human").status for way in (ends, ends[::-1])] == [Status.OK, Status.OK]


def test_a_tread_goes_on_into_the_cell_of_the_floor_before_it():
    width = 1.5 * FACE
    height = np.zeros((6, 3), np.float32)
    height[3:] = 0.17
    surface = HeightMap(np.zeros(2), width, height, np.full(height.shape, OBSERVED, np.uint8))
    seen = np.array([[3.5 * width, 1.5 * width, 0.17]])  # the face is in the floor's last cell, far from what is held
    face = np.array([[2.1 * width, 1.5 * width, z] for z in (0.05, 0.1, 0.15)])
    nose = np.array([[2.2 * width, 1.5 * width, 0.17]])
    assert np.isinf(find_ledges(surface, seen, face, 0.37)).all()
    assert find_ledges(surface, seen, np.concatenate([face, nose]), 0.37)[:3] == pytest.approx(0.17, abs=1e-6)
    box = np.array([[2.2 * width, 1.5 * width, 0.12]])
    assert np.isinf(find_ledges(surface, seen, np.concatenate([face[:1], box]), 0.37)).all()

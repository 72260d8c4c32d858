"""A level holds what it is and what stands beside it, not the whole map."""

from __future__ import annotations

import resource
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import gpdf_service as gpdf
from gpdf_service.ground.level import OVERLAP
from gpdf_service.perception.budget import _trim, give_back
from gpdf_service.synthetic.scenes import cave, random_room, stair
from gpdf_service.tiles.layers import BLOCK
from gpdf_service.tiles.surface import UNKNOWN
from gpdf_service.tiles.told import bands_of
from gpdf_service.types import FloatArray


def tower(side: float = 24.0, step: float = 0.06) -> FloatArray:
    """A wide floor, and over one corner of it a gallery that no stair joins, under a ceiling."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(0, side, step), np.arange(0, side, step)))
    floor = np.column_stack([x, y, np.zeros(x.size)])
    corner = (x < 14.0) & (y < 14.0)
    gallery, ceiling = (np.column_stack([x, y, np.full(x.size, z)])[corner] for z in (3.2, 6.0))
    box = np.random.default_rng(0).uniform(size=(4000, 3)) * [0.5, 0.5, 1.0] + [14.4, 5.0, 3.2]  # beside the gallery
    return np.concatenate([floor, gallery, ceiling, box])


def test_a_level_is_as_large_as_its_ground() -> None:
    scene = gpdf.build_scene(tower())
    floor, gallery = scene.surfaces
    cells = BLOCK + OVERLAP / gallery.cell_width + 2
    assert (np.array(gallery.state.shape) < 14.0 / gallery.cell_width + 2 * cells).all()
    assert (np.array(floor.state.shape) > 24.0 / floor.cell_width).all()
    assert np.count_nonzero(gallery.state != UNKNOWN) * gallery.cell_width**2 > 0.95 * 14.0**2
    lattice = (gallery.origin - floor.origin) / floor.cell_width
    np.testing.assert_allclose(lattice, np.round(lattice), atol=1e-6)


def test_what_stands_beside_the_ground_of_a_level_is_known_to_it() -> None:
    scene = gpdf.build_scene(tower())
    beside = scene.levels.levels[1].other_points
    assert (beside[:, 0] > 14.4).any()
    distance = scene.obstacle_field("human").query(np.array([[13.5, 5.2, 3.2]])).distance[0]
    assert distance < 0.6  # the ground's rim, at most


def test_no_way_between_levels_of_other_boxes_is_explained() -> None:
    scene = gpdf.build_scene(tower())
    result = gpdf.plan(scene, (20.0, 20.0, 0.0), (5.0, 5.0, 3.2))
    assert result.status is gpdf.Status.NO_VALID_PATH
    assert "meet nowhere" in result.message


@pytest.mark.parametrize("noise", [0.0, 0.02])
@pytest.mark.parametrize("place", [stair, cave, random_room])
def test_a_scene_is_the_same_in_whatever_bands_its_cells_are_asked(place, noise: float, monkeypatch) -> None:
    cloud = place(np.random.default_rng(0), noise, spacing=0.08).points
    rng, asked = np.random.default_rng(3), []
    whole = gpdf.build_scene(cloud)

    def bands(shape, reach):
        """Up to six bands of any width, those of a single row as well; one where the reach is that of the grid."""
        ends = np.unique([0, *rng.integers(0, shape[0], 5 if reach < max(shape) else 0), shape[0]]).tolist()
        asked.append(len(ends) - 1)
        return [(slice(a, b), slice(0, shape[1])) for a, b in pairwise(ends)]

    monkeypatch.setattr("gpdf_service.tiles.told.bands_of", bands)
    other = gpdf.build_scene(cloud)
    assert max(asked) > 1
    for a, b in zip(whole.levels.levels, other.levels.levels, strict=True):
        np.testing.assert_array_equal(a.surface.height, b.surface.height)
        np.testing.assert_array_equal(a.surface.state, b.surface.state)
        np.testing.assert_array_equal(a.other_points, b.other_points)
        np.testing.assert_array_equal(a.ledge, b.ledge)
        np.testing.assert_array_equal(a.limits.points, b.limits.points)
        np.testing.assert_array_equal(a.limits.value, b.limits.value)


@pytest.mark.parametrize("reach", [0, 1, 40, 4000])
def test_bands_tile_a_grid_and_are_twice_as_wide_as_what_they_reach_over(reach: int) -> None:
    for shape in ((1, 1), (700, 3), (700, 1500), (5000, 1400)):
        bands = bands_of(shape, reach)
        cells = np.zeros(shape, np.int64)
        for box in bands:
            cells[box] += 1
        assert (cells == 1).all()
        assert len(bands) == 1 or min(rows.stop - rows.start for rows, _ in bands) >= 4 * reach
    assert reach == 4000 or len(bands) > 1


@pytest.mark.skipif(_trim() is None, reason="glibc keeps what was freed, other C libraries do not")
def test_what_was_freed_between_what_lasts_is_given_back_for_a_large_cloud_alone() -> None:
    page = resource.getpagesize()

    def held() -> int:
        return int(Path("/proc/self/statm").read_text().split()[1]) * page

    blocks = [np.ones(100_000, np.uint8) for _ in range(2000)]  # too small to be mapped one by one
    lasting = blocks[::40]
    del blocks
    before = held()
    give_back(1000)
    assert held() > before - 20e6
    give_back(10_000_000)
    assert held() < before - 100e6
    assert len(lasting) == 50

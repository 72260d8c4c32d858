"""The scan's colours beside a scene: found by place, and never of what is not there any more."""

import numpy as np
import pytest

import gpdf_service as gpdf
from gpdf_service import shades
from gpdf_service.combine import crop_scene, merge_scenes
from gpdf_service.errors import CloudError
from gpdf_service.service.drawing import draw_part
from gpdf_service.shades import shades_of

SPACING = 0.05
RED, BLUE = (200, 20, 30), (10, 60, 220)
NUMBER = {RED: 0xC8141E, BLUE: 0x0A3CDC}


def floor(low=0.0, high=3.0):
    """Level points and their colours: red where x < 1.5, else blue."""
    x, y = np.meshgrid(np.arange(low, high, SPACING), np.arange(0.0, 2.0, SPACING))
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    return points, np.where(points[:, :1] < 1.5, RED, BLUE).astype(np.uint8)


@pytest.fixture(scope="module")
def scene():
    points, colours = floor()
    return gpdf.build_scene(points, colours=colours)


def drawn(scene):
    """Places and colours of the whole cloud as the page gets them."""
    part = draw_part(scene, "cloud", "human", 100_000, 0)
    assert part.parts == 1
    table = dict(zip(part.columns, part.rows.T, strict=True))
    return part.rows[:, :3] + part.origin, table.get("colour")


def test_every_point_has_the_colour_that_it_was_scanned_with(scene):
    places, colour = drawn(scene)
    np.testing.assert_array_equal(colour, np.where(places[:, 0] < 1.5 - 1e-6, NUMBER[RED], NUMBER[BLUE]))
    assert scene.info()["coloured"]


def test_a_scene_without_colours_is_the_same_scene_and_draws_none(scene):
    bare = gpdf.build_scene(floor()[0])
    assert bare.digest == scene.digest
    assert not bare.info()["coloured"]
    assert drawn(bare)[1] is None


def test_the_file_keeps_them_and_takes_no_more_than_the_cloud(scene, tmp_path):
    scene.save(tmp_path / "coloured.gpdf")
    np.testing.assert_array_equal(drawn(gpdf.load_scene(tmp_path / "coloured.gpdf"))[1], drawn(scene)[1])
    rng = np.random.default_rng(0)
    points = rng.uniform((0, 0, 0), (6, 5, 0.004), (60_000, 3)).astype(np.float32)
    colours = rng.integers(90, 140, (60_000, 3), dtype=np.uint8)
    gpdf.build_scene(points, colours=colours).save(tmp_path / "noisy.gpdf")
    np.savez_compressed(tmp_path / "cloud.npz", xyz=points, rgb=colours)
    assert (tmp_path / "noisy.gpdf").stat().st_size < 3 * (tmp_path / "cloud.npz").stat().st_size


def test_what_changes_has_no_colour_and_what_stays_keeps_its_own(scene):
    new, many = floor(3.0, 4.0)[0], floor(3.0, 6.0)[0]
    for changed in (
        scene.update(new, np.flatnonzero(scene.points[:, 0] < 0.5)),
        scene.update(many),  # so much that all is built anew
    ):
        places, colour = drawn(changed)
        is_new = places[:, 0] > 3.0 + shades.REACH * shades.FINEST
        assert (colour[is_new] == -1).all()
        assert is_new.any()
        old = places[:, 0] < 3.0 - 1e-6
        expected = np.where(places[old, 0] < 1.5 - 1e-6, NUMBER[RED], NUMBER[BLUE])
        np.testing.assert_array_equal(colour[old], expected)
        assert old.sum() == (changed.points[:, 0] < 3.0 - 1e-6).sum()


def test_beside_what_moves_the_cloud_looks_the_same(scene):
    moved = scene.with_obstacles([[1.0, 1.0, 0.5]])
    np.testing.assert_array_equal(drawn(moved)[1], drawn(scene)[1])


def test_parts_and_what_is_put_together_of_them_keep_their_colours(scene):
    west, east = (crop_scene(scene, inside) for inside in (scene.points[:, 0] < 1.2, scene.points[:, 0] > 1.1))
    for made in (west, merge_scenes([west, east])):
        places, colour = drawn(made)
        np.testing.assert_array_equal(colour, np.where(places[:, 0] < 1.5 - 1e-6, NUMBER[RED], NUMBER[BLUE]))


def test_denoised_points_find_the_colours_that_lay_within_the_noise():
    rng = np.random.default_rng(1)
    points, colours = floor()
    kept = shades_of(points + rng.normal(0, 0.02, points.shape), colours)
    assert (kept.at(points, 0.06) >= 0).all()
    assert (kept.at(points + np.array([0.0, 0.0, 0.2]), 0.06) == -1).all()


def test_of_many_places_few_enough_are_kept_and_every_point_still_finds_one(monkeypatch):
    monkeypatch.setattr(shades, "MOST", 200)
    points, colours = floor()
    kept = shades_of(points, colours)
    assert 50 < len(kept.cells) <= 200
    assert (kept.at(points, 0.0) >= 0).all()
    wrong = kept.at(points, 0.0) != np.where(points[:, 0] < 1.5 - 1e-6, NUMBER[RED], NUMBER[BLUE])
    assert np.abs(points[wrong, 0] - 1.5).max() < 2 * kept.width  # at the edge between both alone


@pytest.mark.parametrize("colours", [np.zeros((2400, 3)), np.zeros((2399, 3), np.uint8), np.zeros(2400, np.uint8)])
def test_colours_of_another_kind_or_number_are_refused(colours):
    points, _ = floor()
    assert len(points) == 2400
    with pytest.raises(CloudError, match="colours"):
        gpdf.build_scene(points, colours=colours)

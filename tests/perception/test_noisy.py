"""Noise taken out tile by tile: no seam shows, and a change reaches no further than its tiles."""

import numpy as np
import pytest

import gpdf_service as gpdf
import gpdf_service.perception.noisy as noisy_module
from gpdf_service.config import PerceptionConfig
from gpdf_service.denoise import denoise
from gpdf_service.perception.noisy import Tiles, change_noisy, moved, without_noise
from gpdf_service.synthetic.scenes import random_room
from gpdf_service.tiles.points import points_of

NOISE, SPACING = 0.01, 0.02


@pytest.fixture(scope="module")
def room():
    made = random_room(np.random.default_rng(2), noise=NOISE, spacing=SPACING)
    return made.points, made.ground


@pytest.fixture(scope="module")
def noisy(room):
    return without_noise(points_of(room[0]), room[1], tiles_at(room[0]), PerceptionConfig())


def tiles_at(points, off=0.0):
    """Small ones: a room is one tile else."""
    x, y = (np.floor(points[:, :2].min(axis=0)) - off).tolist()
    return Tiles(NOISE, SPACING, (x, y), (3.0, 2.0))


def test_each_point_is_in_one_tile_and_in_the_halo_of_those_near(room):
    points = room[0]
    tiles, held = tiles_at(points), points_of(points)
    told = np.zeros(len(points), dtype=int)
    assert len(tiles.near(points)) > 4
    for tile in tiles.near(points):
        rows, own = tiles.rows(held, tile)
        told[rows[own]] += 1
    assert (told == 1).all()
    near = tiles.near(points[:1])
    for tile in tiles.near(points):
        assert (tile in near) or 0 not in tiles.rows(held, tile)[0]


def test_no_seam_shows(room, noisy):
    points, ground = room
    whole = denoise(points, NOISE, SPACING, ground)
    off = np.linalg.norm(noisy.first.points - whole.points, axis=1)
    assert (off > 0.1 * NOISE).mean() < 1e-3


def test_other_tiles_tell_the_same_but_for_few_points(room, noisy):
    points, ground = room
    other = without_noise(points_of(points), ground, tiles_at(points, 1.0), PerceptionConfig())
    off = np.linalg.norm(noisy.last - other.last, axis=1)
    assert (off > 0.1 * NOISE).mean() < 1e-3


def test_a_change_is_told_of_its_tiles_alone(room, noisy):
    """And what comes out as it was is in no cloud that others look at again."""
    points, ground = room
    fresh = points[:40] + np.array([0.0, 0.0, 0.3])
    now, cloud = change_noisy(noisy, np.arange(40), fresh, ground[:40], PerceptionConfig())
    gone_and_new = np.concatenate([points[:40], fresh])
    other = (now.first.points[: len(points)] != noisy.first.points).any(axis=1)
    assert 0 < other.sum() < 0.1 * len(points)
    told = [now.tiles.rows(points_of(points), tile)[0] for tile in now.tiles.near(gone_and_new)]
    assert np.isin(np.flatnonzero(other), np.concatenate(told)).all()
    assert len(cloud.places) < 0.1 * len(points)


def test_points_at_other_places_keep_their_order(room):
    points = room[0][:1000]
    there = np.arange(1000) % 3 > 0
    first = moved(points, there)
    places, others = points + 0.01, np.array([0, 5, 900])
    now, cloud = first.now(others, np.ones(1000, dtype=bool), places)
    expected = np.flatnonzero(there | np.isin(np.arange(1000), others))
    shown = np.where(np.isin(expected, others)[:, None], places[expected], points[expected])
    np.testing.assert_array_equal(now.points.present, shown)
    np.testing.assert_array_equal(now.points.rank[now.points.all_numbers], expected)
    assert len(cloud.places) == 4  # where 5 was, and where all three are
    told = now.told(np.arange(1000))
    np.testing.assert_array_equal(told[now.number[expected]], expected)


def test_a_stray_that_goes_and_moves_nothing_leaves_all_as_it_was(monkeypatch):
    made = random_room(np.random.default_rng(0), noise=0.05)
    scene = gpdf.build_scene(made.points)
    stray = np.flatnonzero(scene.perceived.found.noisy.first.stray)[:1]
    assert len(stray) == 1
    monkeypatch.setattr(noisy_module, "_tell", lambda points, *_: np.zeros(len(points.there), dtype=bool))
    gone = scene.update(remove=stray)
    assert len(gone.points) == len(scene.points) - 1
    assert gone.levels is scene.levels
    np.testing.assert_array_equal(gone.ground, np.delete(scene.ground, stray))
    assert gone.perceived.touched == tuple((k, None) for k in range(len(scene.surfaces)))

"""What one could step onto, but is narrower than a place to go to, is no ground; a platform and a mound are."""

from __future__ import annotations

import numpy as np
import pytest

import gpdf_service as gpdf
from gpdf_service.bench.houses import scanned_house
from gpdf_service.synthetic.solids import turn_and_shift
from gpdf_service.types import BoolArray, FloatArray

SPACING = 0.025


def plate(low: tuple[float, float], high: tuple[float, float], z: float) -> FloatArray:
    """Points of a level rectangle [m]."""
    x, y = (np.arange(a + 0.5 * SPACING, b, SPACING) for a, b in zip(low, high, strict=True))
    return np.stack(np.meshgrid(x, y, [z]), axis=-1).reshape(-1, 3)


def sides(low: tuple[float, float], high: tuple[float, float], z: float) -> FloatArray:
    """Points of the walls below such a rectangle [m]."""
    x, y = (np.arange(a, b, SPACING) for a, b in zip(low, high, strict=True))
    z_of = np.arange(0.5 * SPACING, z, SPACING)
    along = [np.stack(np.meshgrid(x, [end], z_of), axis=-1).reshape(-1, 3) for end in (low[1], high[1])]
    across = [np.stack(np.meshgrid([end], y, z_of), axis=-1).reshape(-1, 3) for end in (low[0], high[0])]
    return np.concatenate([*along, *across])


def room_with(
    low: tuple[float, float], high: tuple[float, float], z: float, noise: float
) -> tuple[FloatArray, BoolArray]:
    """A floor of 6 × 5 m with something raised on it, and which points are its top."""
    floor = plate((0.0, 0.0), (6.0, 5.0), 0.0)
    under = ((floor[:, :2] > low) & (floor[:, :2] < high)).all(axis=1)
    parts = [floor[~under], sides(low, high, z), plate(low, high, z)]
    cloud = np.concatenate(parts)
    cloud += np.random.default_rng(0).normal(0.0, noise, cloud.shape)
    return cloud, np.arange(len(cloud)) >= len(cloud) - len(parts[2])


@pytest.mark.parametrize("noise", [0.002, 0.02])
@pytest.mark.parametrize(
    ("size", "z"),
    [
        ((1.0, 0.7), 0.12),
        ((0.6, 0.6), 0.2),
        ((4.0, 0.9), 0.25),
        ((0.9, 0.8), 0.35),
        ((0.86, 0.35), 0.18),
        ((0.43, 0.25), 0.15),
    ],
)
def test_a_lid_a_box_and_a_rack_are_no_ground(size: tuple[float, float], z: float, noise: float) -> None:
    low = (1.0, 2.0)
    cloud, top = room_with(low, (low[0] + size[0], low[1] + size[1]), z, noise)
    scene = gpdf.build_scene(cloud)
    assert scene.ground[top].mean() < 0.02
    assert scene.ground[~top & (np.abs(cloud[:, 2]) < 0.01)].mean() > 0.95
    beside = gpdf.plan(scene, (0.5, 1.0), (low[0] + 0.5 * size[0], low[1] + 0.5 * size[1]), "human")
    assert beside.status is gpdf.Status.GOAL_OCCUPIED


def test_a_box_of_which_a_scan_shows_two_sides_and_the_top_is_no_ground() -> None:
    """Behind it the floor lies in its shade, so that nobody knows whether it falls off there."""
    cloud, top = room_with((2.0, 2.0), (2.64, 2.76), 0.36, 0.0)
    shade = (cloud[:, 2] < 0.01) & (cloud[:, 0] > 2.0) & (cloud[:, 1] > 2.3) & (cloud[:, 1] < cloud[:, 0] + 1.2)
    hidden = (cloud[:, 2] < 0.35) & ((cloud[:, 0] > 2.63) | (cloud[:, 1] > 2.75)) & (cloud[:, 2] > 0.01)
    seen = ~(shade | hidden)
    assert gpdf.segment_ground(cloud[seen])[top[seen]].mean() < 0.02


def test_random_boxes_under_noise_are_no_ground() -> None:
    """Turned, of all sizes that are no sill, and as high as noise of 2 cm lets one see; a platform stays."""
    rng, taken = np.random.default_rng(0), []
    for _ in range(6):
        floor, parts, of = plate((0.0, 0.0), (6.0, 5.0), 0.0), [], []
        places = [(4.0, 0.7), (5.2, 0.7), (4.0, 2.3), (5.2, 2.3), (1.0, 4.1)]
        sizes = rng.uniform(0.13, 0.35, (len(places), 2)) * rng.permuted([[1.0, 2.0]] * len(places), axis=1)
        boxes = [*zip(np.array(places), sizes, rng.uniform(0.12, 0.3, len(places)), strict=True)]
        for at, size, z in [*boxes, (np.array([1.8, 1.6]), np.array([2.0, 2.0]), 0.2)]:
            low, high = tuple(at - 0.5 * size), tuple(at + 0.5 * size)
            floor = floor[~((floor[:, :2] > low) & (floor[:, :2] < high)).all(axis=1)]
            parts += [sides(low, high, z), plate(low, high, z)]
            of += [np.full(len(parts[-2]), -1), np.full(len(parts[-1]), len(of) // 2)]
        cloud, of = np.concatenate([*parts, floor]), np.concatenate([*of, np.full(len(floor), -1)])
        cloud = cloud @ turn_and_shift(rng.uniform(0.0, np.pi))[:3, :3].T + rng.normal(0.0, 0.02, cloud.shape)
        ground = gpdf.segment_ground(cloud)
        share = [ground[of == k].mean() for k in range(len(boxes) + 1)]
        assert share[-1] > 0.95
        taken += share[:-1]
    assert (np.array(taken) > 0.1).sum() <= 2


@pytest.mark.parametrize("noise", [0.002, 0.02])
def test_a_platform_is_ground(noise: float) -> None:
    cloud, top = room_with((1.0, 1.0), (3.5, 3.0), 0.15, noise)
    assert gpdf.segment_ground(cloud)[top].mean() > 0.95


@pytest.mark.parametrize("noise", [0.002, 0.02])
def test_a_platform_is_ground_to_its_corners(noise: float) -> None:
    """At a corner a platform falls off to either side within the width of a person, as a chair's foot does."""
    low, high = np.array([1.0, 1.0]), np.array([3.5, 3.0])
    cloud, top = room_with((1.0, 1.0), (3.5, 3.0), 0.15, noise)
    inward = np.minimum(cloud[:, :2] - low, high - cloud[:, :2])
    corner = top & (inward > 0.5 * SPACING).all(axis=1) & (inward < 0.25).all(axis=1)
    assert gpdf.segment_ground(cloud)[corner].mean() > 0.9
    scene = gpdf.build_scene(cloud)
    for at in (low, high, (low[0], high[1]), (high[0], low[1])):  # a body there stands half on it
        assert gpdf.plan(scene, (0.5, 0.5, 0.0), (*at, 0.0), "human").status is gpdf.Status.OK


def test_a_rise_without_a_step_is_ground() -> None:
    """A mound as high and as wide as a box."""
    floor = plate((0.0, 0.0), (6.0, 5.0), 0.0)
    away = np.linalg.norm(floor[:, :2] - [3.0, 2.5], axis=1)
    floor[:, 2] = 0.12 * np.maximum(1.0 - (away / 0.8) ** 2, 0.0)
    assert gpdf.segment_ground(floor).mean() > 0.99


@pytest.mark.parametrize("noise", [0.002, 0.02])
def test_a_step_before_a_door_is_ground(noise: float) -> None:
    """A metre square, and the sill over a fifth of its rim: it leads further up."""
    low, high, rise = (2.5, 2.0), (3.5, 3.0), 0.17
    floor, step = plate((0.0, 0.0), (6.0, 3.0), 0.0), plate(low, high, rise)
    inside = plate((0.0, 3.1), (6.0, 5.0), 2.0 * rise), plate((2.6, 3.0), (3.4, 3.1), 2.0 * rise)
    wall = np.stack(np.meshgrid(np.arange(0.0, 6.0, SPACING), [3.0], np.arange(0.0, 2.6, SPACING)), axis=-1)
    wall = wall.reshape(-1, 3)
    wall = wall[(np.abs(wall[:, 0] - 3.0) > 0.4) | (wall[:, 2] < 2.0 * rise)]
    under = ((floor[:, :2] > low) & (floor[:, :2] < high)).all(axis=1)
    cloud = np.concatenate([floor[~under], sides(low, high, rise), *inside, wall, step])
    cloud += np.random.default_rng(0).normal(0.0, noise, cloud.shape)
    scene = gpdf.build_scene(cloud)
    assert scene.ground[-len(step) :].mean() > 0.95
    assert gpdf.plan(scene, (1.0, 1.0, 0.0), (3.0, 4.5, 2.0 * rise), "human").status is gpdf.Status.OK


def test_a_floor_that_a_scanner_saw_in_rings_is_ground() -> None:
    """Between a flight's head and walls; half of its cells hold no point, and it is larger than those that do."""
    place, scan = scanned_house(21, "tripod")
    head = place.way[-1]
    aside = np.linalg.norm(scan.points - (place.way[-2] + [0.0, 0.0, head[2] - place.way[-2][2]]), axis=1)
    behind = scan.ground & (aside < 1.0) & (scan.points[:, 2] > head[2] - 0.05)
    assert behind.sum() > 300
    assert gpdf.segment_ground(scan.points)[behind].mean() > 0.95

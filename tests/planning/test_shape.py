"""The body's top over a path: at its height over the ground, all along."""

import dataclasses
import itertools

import numpy as np
import pytest

import gpdf_service as gpdf
from gpdf_service.bench.judge import Judge
from gpdf_service.planning.shape import _straight_to, is_ground_known, is_level, stand_on, subdivide
from gpdf_service.synthetic.world import Box, World
from gpdf_service.tiles.surface import OBSERVED, UNKNOWN, Cells
from gpdf_service.types import AGENTS


@pytest.mark.slow
@pytest.mark.parametrize("rise", [0.17, 0.35])  # of the 0.7 m of a Spot
@pytest.mark.parametrize("down", [False, True])
def test_a_low_body_keeps_its_height_over_a_step_that_is_half_of_it(rise, down):
    world = World((6.0, 3.0, 2.6), (Box((3.0, 0.0, 0.0), (6.0, 3.0, rise), walkable=True),), ceiling=False)
    points, ground = world.sample(0.03, np.random.default_rng(0))
    ends = np.array([[1.0, 1.5], [5.0, 1.6]])
    result = gpdf.plan(gpdf.build_scene(points, ground), *(ends[::-1] if down else ends), agent="spot")
    assert result.status is gpdf.Status.OK
    verdict = Judge(points, ground).judge(result.trajectory, AGENTS["spot"])
    assert verdict.feasible
    assert verdict.collision_free
    assert result.certificate.max_height_deviation < 0.07  # of the line that keeps d_g = h
    over = result.trajectory.positions - result.trajectory.ground
    np.testing.assert_allclose(over, [[0.0, 0.0, AGENTS["spot"].height]] * len(over), atol=1e-9)


@pytest.mark.parametrize("height", [0.04, 0.1, 0.2, 0.35, 0.6, 1.0])
def test_a_rigid_carts_top_is_level_over_flat_floor_beside_platforms(height):
    """It goes round a platform as near as it fits, and past one between two walls."""
    low, high = (1.5, 1.2, 0.0), (3.5, 2.2, height)
    wall = Box((1.5, 3.0, 0.0), (3.5, 3.1, 2.0))
    points, ground = World((5.0, 4.5, 2.6), (Box(low, high, walkable=True), wall)).sample(
        0.05, np.random.default_rng(0)
    )
    scene = gpdf.build_scene(points, ground)
    cart = dataclasses.replace(AGENTS["pepper"], name="cart", height=1.2, max_step=0.02)
    corners = [(1.1, 0.8), (3.9, 0.8), (3.9, 2.6), (1.1, 2.6)]
    near = 0
    for start, goal in itertools.permutations(corners, 2):
        result = gpdf.plan(scene, start, goal, cart)
        assert result.status is gpdf.Status.OK, result.message
        path = result.trajectory
        assert np.ptp(path.positions[:, 2]) <= 1e-3
        assert path.positions[:, 2].mean() == pytest.approx(1.2, abs=1e-3)
        gap = np.maximum(np.abs(path.ground[:, :2] - (2.5, 1.7)) - (1.0, 0.5), 0.0)
        near += np.linalg.norm(gap, axis=1).min() < 0.5 * cart.height
    assert "\n" not in repr(result)
    assert near == 12  # so near that the nearest ground of a top is not the ground under it


def test_a_line_is_on_known_ground_if_each_cell_that_it_crosses_is():
    rng, width = np.random.default_rng(5), 0.1
    state = np.where(rng.random((30, 40)) < 0.02, UNKNOWN, OBSERVED).astype(np.uint8)
    ground = Cells(np.zeros(state.shape, np.float32), state, np.array([1.0, -2.0]), width)
    found = set()
    for _ in range(300):
        a, b = ground.origin + rng.uniform(-0.1, 1.1, (2, 2)) * np.array([3.0, 4.0])
        if rng.random() < 0.2:
            b[rng.integers(2)] = a[rng.integers(2)]
        line = a + np.linspace(0.0, 1.0, 20_001)[:, None] * (b - a)
        cells = np.floor((line - ground.origin) / width).astype(np.int64)
        inside = np.all((cells >= 0) & (cells < state.shape), axis=1)
        looked = bool(inside.all() and (state[tuple(cells.T)] != UNKNOWN).all())
        told = is_ground_known(ground, a, b)
        assert looked or not told  # a corner that is cut by less than the looks are apart may be missed by these
        found.add((bool(told), looked))
    assert {(True, True), (False, False)} <= found


def test_rows_that_lie_straight_ahead_are_told():
    corners = np.array([[0.0, 0.0], [1.0, 0.3], [1.0, 1.0], [0.5, 0.5]])
    path = subdivide(corners, 0.1)
    straight = _straight_to(path)
    rows = [int(np.abs(path - corner).sum(axis=1).argmin()) for corner in corners]
    for i, to in enumerate(straight[:-1]):
        assert to == next(row for row in rows if row > i)
    back = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, 0.0], [2.0, 0.0]])
    assert _straight_to(back).tolist() == [1, 2, 3, 3]


@pytest.mark.parametrize("height", [0.1, 2.0])
def test_over_level_ground_a_top_stands_where_the_field_says_to_a_hundredth(height):
    rng = np.random.default_rng(0)
    points, ground = World((12.0, 10.0, 2.6), (), ceiling=False).sample(0.05, rng)
    points[:, 2] += np.where(ground, rng.uniform(0.0, 0.004 * height, len(points)), 0.0)
    scene = gpdf.build_scene(points, ground)
    surface, field = scene.surfaces[0], scene.ground_fields[0].arrays
    xy = np.column_stack([np.linspace(4.0, 8.0, 60), np.linspace(4.0, 6.0, 60)])
    apart = np.stack([np.zeros(surface.ends.shape[:2]), np.ones(surface.ends.shape[:2])], axis=-1).astype(np.float32)
    assert is_level(xy, surface.arrays, surface.ends, height)
    assert not is_level(xy, surface.arrays, apart, height)
    (soon, soon_top), (contact, top) = (stand_on(xy, surface.arrays, e, field, height) for e in (surface.ends, apart))
    np.testing.assert_array_equal(soon, contact)
    np.testing.assert_allclose(soon_top, top, atol=0.01 * height)
    assert np.abs(scene.ground_fields[0].query(soon_top).distance - height).max() < 0.011 * height

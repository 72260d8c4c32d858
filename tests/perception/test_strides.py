"""Stances and strides: what joins parts of the ground, and where a foot rests on rough treads."""

import numpy as np
import pytest

from gpdf_service import Status, build_scene, plan, read_cloud, segment_ground
from gpdf_service.config import PerceptionConfig
from gpdf_service.ground.footing import bridged
from gpdf_service.perception.segment import first_layers
from gpdf_service.perception.strides import find_footing, find_stances
from gpdf_service.tiles.surface import OBSERVED, HeightMap

CONFIG = PerceptionConfig()
SPACING = 0.025
STEP = CONFIG.max_step


def face(x, y, z):
    """Points of a level rectangle, jittered by less than half their spacing."""
    u, v = (axis.ravel() for axis in np.meshgrid(np.arange(*x, SPACING), np.arange(*y, SPACING)))
    jitter = np.random.default_rng(0).uniform(-0.01, 0.01, (u.size, 3)) * [1.0, 1.0, 0.2]
    return np.column_stack([u, v, np.full(u.size, z)]) + jitter


def flight(steps=12, riser=0.18, going=0.27, cut=0.0, gap=0.0):
    """Two floors 5 m wide and a flight between them; a `cut` of it is missing, and a `gap` behind each nose.

    Returns:
        The points, and the height of the upper floor [m].
    """
    top, end = steps * riser, 3.0 + going * (steps - 1)
    parts = [face((0.0, 3.0), (0.0, 5.0), 0.0), face((end, end + 3.0), (0.0, 5.0), top)]
    for i in range(steps - 1):
        low, high = 3.0 + going * i, 3.0 + going * (i + 1) - gap
        if cut and i * riser < 0.5 * top <= i * riser + cut:
            continue
        parts.append(face((low, high), (2.0, 3.2), riser * (i + 1)))
    return np.concatenate(parts), top


def test_beside_what_reaches_to_the_hip_there_is_no_stance():
    desk = face((2.0, 3.0), (1.0, 2.0), 0.5)
    layers = first_layers(np.concatenate([face((0.0, 5.0), (0.0, 3.0), 0.0), desk]), CONFIG)
    stance = find_stances(layers, np.ones(len(layers.cell), dtype=bool))
    flat = np.column_stack(np.divmod(layers.cell, layers.shape[1]))
    xy = layers.origin + (flat + 0.5) * layers.cell_width
    off = np.hypot(*(np.maximum(np.maximum([2.0, 1.0] - xy, xy - [3.0, 2.0]), 0.0)).T)
    floor = layers.height < 0.1
    assert not stance[floor & (off < 0.1)].any()
    assert stance[floor & (off > 0.3)].all()
    assert stance[~floor].all()  # nothing is over the desk; that it is no ground is told from where it leads


@pytest.mark.parametrize("gap", [0.0, 0.12])
def test_a_flight_is_ground_up_to_the_upper_floor_also_where_each_tread_is_half_hidden(gap):
    points, top = flight(gap=gap)
    found = segment_ground(points)
    assert found[points[:, 2] > top - 0.05].mean() > 0.98
    assert found.mean() > 0.95


def test_a_flight_of_which_half_a_metre_is_cut_out_joins_nothing():
    points, top = flight(cut=0.55)
    scene = build_scene(points)
    up = plan(scene, (1.0, 2.6, 0.0), (8.0, 2.6, top))
    assert up.status is not Status.OK


def test_a_box_beside_the_way_leads_nowhere_and_a_platform_is_ground():
    floor = face((0.0, 6.0), (0.0, 4.0), 0.0)
    narrow = (floor[:, 0] > 2.0) & (floor[:, 0] < 2.3) & (floor[:, 1] > 1.0) & (floor[:, 1] < 1.3)
    wide = (floor[:, 0] > 4.0) & (floor[:, 0] < 5.5) & (floor[:, 1] > 1.0) & (floor[:, 1] < 2.5)
    points = np.concatenate(
        [floor[~narrow & ~wide], face((2.0, 2.3), (1.0, 1.3), 0.3), face((4.0, 5.5), (1.0, 2.5), 0.3)]
    )
    found, raised = segment_ground(points), points[:, 2] > 0.2
    on_box = raised & (points[:, 0] < 3.0)
    assert not found[on_box].any()
    assert found[raised & ~on_box].mean() > 0.95


def surface_of(height):
    state = np.where(np.isnan(height), 0, OBSERVED).astype(np.uint8)
    return HeightMap(np.zeros(2), 0.05, height.astype(np.float32), state)


def test_a_foot_bridges_the_dip_behind_a_nose_and_leaves_a_staircase_as_it_is():
    steps = np.repeat(0.2 * np.arange(8), 5)
    stair = np.tile(steps[:, None], (1, 20))
    assert np.array_equal(bridged(surface_of(stair), STEP).height, stair.astype(np.float32))
    dipped = stair.copy()
    dipped[12:14] -= 0.15  # two cells of a tread
    np.testing.assert_allclose(bridged(surface_of(dipped), STEP).height, stair, atol=1e-6)


def test_a_hole_in_a_level_floor_is_no_flight_and_stays():
    floor = np.zeros((40, 40))
    floor[20:22, 20:22] = -0.1
    assert np.array_equal(bridged(surface_of(floor), STEP).height, floor.astype(np.float32))


@pytest.mark.slow
def test_the_public_spiral_of_ramps_and_bridges_is_a_way_for_legs(scan):
    scene = build_scene(read_cloud(scan("spiral_ramps_20cm.npz")).points)
    for body in ("human", "spot"):
        assert plan(scene, (-16.0, -6.0, 0.2), (-26.0, -5.0, 0.2), body).status is Status.OK


def test_a_floor_of_which_a_scan_from_far_shows_some_cells_is_ground_and_so_is_its_stair():
    points, top = flight()
    layers = first_layers(points, CONFIG)
    cell = np.floor((points[:, :2] - layers.origin) / layers.cell_width).astype(int)
    upper = points[:, 2] > top - 0.05
    points = points[~upper | (cell.sum(axis=1) % 2 == 0)]  # a chessboard: each cell has four neighbours, at its corners
    found, stair = segment_ground(points), np.abs(points[:, 1] - 2.6) < 0.4
    assert found[points[:, 2] > top - 0.05].mean() > 0.95
    assert found[stair & (points[:, 2] > 0.1)].mean() > 0.95


def test_the_rim_of_a_surface_holds_no_foot_and_a_place_between_single_samples_does():
    floor = face((0.0, 2.0), (0.0, 2.0), 0.0)
    layers = first_layers(floor, CONFIG)
    every, rise = np.ones(len(layers.cell), dtype=bool), layers.cell_width * float(np.tan(CONFIG.steepest))
    x, y = np.divmod(layers.cell, layers.shape[1])
    rim = (x == x.min()) | (x == x.max()) | (y == y.min()) | (y == y.max())
    assert not find_footing(layers, every, every, rise, 5)[rim].any()
    assert find_footing(layers, every, every, rise, 5)[
        (x > x.min() + 2) & (x < x.max() - 2) & (y > y.min() + 2) & (y < y.max() - 2)
    ].all()
    chess = (x + y) % 2 == 0
    inner = (x > x.min() + 2) & (x < x.max() - 3) & (y > y.min() + 2) & (y < y.max() - 3)
    assert find_footing(layers, chess, chess, rise, 5)[chess & inner].all()

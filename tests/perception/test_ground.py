from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from gpdf_service import build_scene, plan
from gpdf_service.bench.houses import scanned_house
from gpdf_service.clouds import read_cloud
from gpdf_service.config import PerceptionConfig
from gpdf_service.errors import NoGroundError
from gpdf_service.ground.foot import LEAST_OBSTACLE
from gpdf_service.ground.level import GroundLevel
from gpdf_service.ground.limits import ObstacleKind, step_and_slope
from gpdf_service.ground.obstacles import Scan, obstacles_of
from gpdf_service.perception.cloud import find_strays
from gpdf_service.perception.complete import guard_edges
from gpdf_service.perception.ledges import find_ledges, next_above
from gpdf_service.perception.levels import survey_levels
from gpdf_service.perception.seen import without_outliers
from gpdf_service.perception.segment import segment_ground
from gpdf_service.synthetic import SCENES, Box, World, ramp, random_room
from gpdf_service.tiles.points import points_of
from gpdf_service.tiles.surface import INFERRED, OBSERVED, UNKNOWN, HeightMap
from gpdf_service.types import AGENTS, Status
from tests.clients.two_storeys import make_house

CONFIG = PerceptionConfig()


def scan_of(world, spacing=0.04, noise=0.0, seed=0):
    return world.sample(spacing, np.random.default_rng(seed), noise)


def level_of(world, **options):
    points, ground = scan_of(world, **options)
    levels = survey_levels(points_of(points), ground, CONFIG)[0].levels
    assert len(levels) == 1
    return levels[0]


@pytest.mark.parametrize("name", ["office", "cluttered_office", "cow_and_lady", "cave", "stair"])
def test_segmentation_agrees_with_the_true_labels(name):
    scene = SCENES[name](np.random.default_rng(1))
    found = segment_ground(scene.points)
    union = (found | scene.ground).sum()
    assert (found & scene.ground).sum() / union > (0.85 if name == "stair" else 0.93)


def test_the_platform_is_ground_and_the_tables_are_not():
    scene = SCENES["office"](np.random.default_rng(0))
    found = segment_ground(scene.points)
    x, y, z = scene.points.T
    platform = (x > 5.1) & (x < 5.9) & (y > 1.7) & (y < 2.7) & (abs(z - 0.35) < 0.01)
    assert found[platform].mean() > 0.98
    assert found[(z > 0.4) & (z < 2.0)].sum() == 0


def test_noise_of_two_centimetres_leaves_the_floor():
    scene = SCENES["office"](np.random.default_rng(0), noise=0.02)
    found = segment_ground(scene.points)
    assert (found & scene.ground).sum() / scene.ground.sum() > 0.9


def test_a_wall_alone_has_no_ground():
    z, y = np.meshgrid(np.arange(0, 3, 0.03), np.arange(0, 4, 0.03))
    with pytest.raises(NoGroundError):
        segment_ground(np.column_stack([np.zeros(z.size), y.ravel(), z.ravel()]))


def test_labels_without_ground_are_refused():
    with pytest.raises(NoGroundError):
        survey_levels(points_of(np.zeros((5, 3))), np.zeros(5, dtype=bool), CONFIG)[0]


def test_the_real_office_keeps_its_floor_and_drops_its_tables(scan):
    cloud = read_cloud(scan("s3dis_office.npz"))
    found = segment_ground(cloud.points)
    assert found[cloud.ground].mean() > 0.9
    over = cloud.points[:, 2] > 0.3
    assert found[over].mean() < 0.001


def test_height_map_is_the_true_ground():
    rng = np.random.default_rng(5)
    scene = SCENES["cave"](rng)
    level = survey_levels(points_of(scene.points), scene.ground, CONFIG)[0].levels[0]
    xy = rng.uniform([1, 1], [19, 11], (2000, 2))
    truth, found = scene.truth.ground_height(xy), level.surface.height_at(xy)
    both = ~np.isnan(truth) & ~np.isnan(found)
    assert both.mean() > 0.8
    assert np.quantile(np.abs(truth - found)[both], 0.95) < 0.03


def test_a_hole_in_the_floor_is_inferred_and_one_at_the_rim_is_not():
    points, ground = scan_of(World((5.0, 5.0, 2.5), (), ceiling=False))
    hole = np.hypot(points[:, 0] - 2.5, points[:, 1] - 2.5) < 0.5
    level = survey_levels(points_of(points[~hole]), ground[~hole], CONFIG)[0].levels[0]
    ix, iy, _ = level.surface.cells(np.array([[2.5, 2.5], [1.0, 1.0], [5.3, 2.5]]))
    assert level.surface.state[ix[:2], iy[:2]].tolist() == [INFERRED, OBSERVED]
    assert level.surface.height_at(np.array([[2.5, 2.5]]))[0] == pytest.approx(0.0, abs=0.01)
    assert not level.surface.contains(np.array([[5.3, 2.5]])).any()


@pytest.mark.parametrize("turn", [0.0, 0.5])
@pytest.mark.parametrize("seen", ["one wall", "all walls", "a reflection"])
def test_a_pit_is_not_bridged_when_only_its_walls_were_seen(turn, seen):
    points, _ = scan_of(World((6.0, 6.0, 2.5), (), ceiling=False), spacing=0.03, noise=0.003)
    rotation = np.array([[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]])
    across, down = np.mgrid[-0.5:0.5:0.03, -0.6:0.0:0.03].reshape(2, -1)
    wall = np.column_stack([across, np.full(across.size, 0.4), down])
    walls = [wall, wall * (1, -1, 1), (wall * (0.8, 1.25, 1))[:, [1, 0, 2]], (wall * (0.8, -1.25, 1))[:, [1, 0, 2]]]
    below = {"one wall": wall, "all walls": np.vstack(walls), "a reflection": wall[len(wall) // 2 :][8:10]}[seen]
    inside = (np.abs((points - (3.0, 3.0, 0.0)) @ rotation) < (0.5, 0.4, 0.1)).all(axis=1)
    cloud = np.vstack([points[~inside], below @ rotation.T + (3.0, 3.0, 0.0)])
    surface = survey_levels(points_of(cloud), segment_ground(cloud), CONFIG)[0].levels[0].surface
    assert surface.contains(np.array([[3.0, 3.0]]))[0] == (seen == "a reflection")
    assert surface.contains(np.array([[2.0, 2.0]]))[0]


def test_a_pit_of_whose_walls_only_the_upper_end_was_seen_is_not_bridged():
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(0.01, 6.0, 0.02), np.arange(0.01, 6.0, 0.02)))
    hole = (x > 2.5) & (x < 2.92) & (y > 2.5) & (y < 2.92)
    floor = np.column_stack([x[~hole], y[~hole], np.zeros(np.count_nonzero(~hole))])
    across, down = np.mgrid[2.5:2.92:0.02, -0.085:-0.02:0.01].reshape(2, -1)
    far = np.column_stack([across, np.full(across.size, 2.915), down])
    cloud = np.vstack([floor, far, far[:, [1, 0, 2]]])
    surface = survey_levels(points_of(cloud), segment_ground(cloud), CONFIG)[0].levels[0].surface
    assert not surface.contains(np.array([[2.7, 2.7]])).any()


def test_the_inside_of_a_cupboard_is_not_called_free():
    level = level_of(World((5.0, 5.0, 2.5), (Box((2.0, 2.0, 0.0), (3.0, 2.8, 1.8)),)))
    assert not level.surface.contains(np.array([[2.5, 2.4]])).any()
    assert level.surface.contains(np.array([[1.8, 2.4], [3.2, 2.4]])).all()


def test_a_large_unseen_place_stays_unknown_and_stops_everybody():
    points, ground = scan_of(World((8.0, 8.0, 2.5), (), ceiling=False))
    hole = np.hypot(points[:, 0] - 4, points[:, 1] - 4) < 2.0
    level = survey_levels(points_of(points[~hole]), ground[~hole], CONFIG)[0].levels[0]
    assert not level.surface.contains(np.array([[4.0, 4.0]])).any()
    found = obstacles_of(level, AGENTS["roomba"])
    rim = found.points[found.kind == ObstacleKind.UNKNOWN]
    rim = rim[(np.abs(rim[:, :2] - 4) < 3.5).all(axis=1)]  # not the outer walls'
    assert len(rim) > 100
    assert (np.hypot(rim[:, 0] - 4, rim[:, 1] - 4) < 2.1).all()


def test_a_platform_stops_the_roomba_and_not_the_human():
    level = level_of(World((5.0, 5.0, 2.5), (Box((2.0, 2.0, 0.0), (3.2, 3.4, 0.3), walkable=True),)))
    near = {}
    for name in ("roomba", "human"):
        points = obstacles_of(level, AGENTS[name]).points
        near[name] = ((points[:, 0] > 1) & (points[:, 0] < 4) & (points[:, 1] > 1) & (points[:, 1] < 4)).sum()
    assert near["human"] == 0
    assert near["roomba"] > 200


def test_a_low_table_over_seen_floor_is_no_platform():
    world = World((5.0, 5.0, 2.5), (Box((2.0, 2.0, 0.22), (3.2, 2.9, 0.25)),))
    points, _ = scan_of(world)
    found = segment_ground(points)
    top = (np.abs(points - (2.6, 2.45, 0.25)) < (0.5, 0.35, 0.01)).all(axis=1)
    beneath = (np.abs(points - (2.6, 2.45, 0.0)) < (0.5, 0.35, 0.01)).all(axis=1)
    assert top.sum() > 100
    assert not found[top].any()
    assert found[beneath].all()


def test_a_low_table_is_no_platform_when_the_floor_was_seen_below_one_side_alone():
    points, _ = scan_of(World((5.0, 5.0, 2.5), (Box((2.0, 2.0, 0.22), (3.2, 2.9, 0.25)),)))
    beneath = (points[:, 0] > 2.2) & (np.abs(points - (2.6, 2.45, 0.1)) < (0.6, 0.45, 0.14)).all(axis=1)
    points = points[~beneath]
    top = (np.abs(points - (2.6, 2.45, 0.25)) < (0.5, 0.35, 0.01)).all(axis=1)
    assert top.sum() > 100
    assert not segment_ground(points)[top].any()


def test_a_crate_beside_a_low_board_is_no_way_on_from_it():
    board = Box((1.0, 2.0, 0.15), (7.0, 2.9, 0.25))
    crate = Box((3.0, 3.1, 0.0), (3.8, 3.42, 0.33))
    points, _ = scan_of(World((8.0, 6.0, 2.5), (board, crate)))
    tops = [
        (np.abs(points - (*middle, height)) < (0.15, 0.1, 0.01)).all(axis=1)
        for middle, height in (((2.6, 2.45), 0.25), ((3.4, 3.26), 0.33))
    ]
    assert min(top.sum() for top in tops) > 20
    assert not segment_ground(points)[np.logical_or.reduce(tops)].any()


@pytest.mark.parametrize("seed", range(4))
def test_a_board_that_joins_scraps_of_a_thin_scan_is_no_tread_and_a_sill_between_two_floors_is(seed):
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0.0, 6.0, (2, 90000))
    thin = (np.abs(y - 3.0) < 0.8) & (rng.random(len(x)) > 0.15)
    narrow = np.abs(y - 3.0) < 0.1
    x, y, narrow = x[~thin | narrow], y[~thin | narrow], narrow[~thin | narrow]
    for thing, kept in ((narrow & (np.abs(x - 3.0) < 1.0), False), (narrow, True)):
        found = segment_ground(np.column_stack([x, y, np.where(thing, 0.15, 0.0)]))
        assert found[thing].mean() == pytest.approx(float(kept), abs=0.1)


def test_the_face_of_a_drop_does_not_guard_its_edge():
    step = 0.04
    x, y = np.mgrid[0.0:2.0:step, 0.0:4.0:step].reshape(2, -1)
    upper = np.column_stack([x, y, np.zeros(x.size)])
    y, z = np.mgrid[0.0:4.0:step, -1.02:-0.01:step].reshape(2, -1)
    face = np.column_stack([np.full(y.size, 2.03), y, z])
    cloud = np.vstack([upper, face])
    level = survey_levels(points_of(cloud), np.arange(len(cloud)) < len(upper), CONFIG)[0].levels[0]
    edge = obstacles_of(level, AGENTS["roomba"]).points
    edge = edge[(np.abs(edge[:, 0] - 2.0) < 0.2) & (edge[:, 1] > 0.5) & (edge[:, 1] < 3.5)]
    assert np.diff(np.sort(edge[:, 1])).max() < AGENTS["roomba"].radius
    assert len(edge) > 30


def test_a_board_stops_only_bodies_that_reach_it():
    level = level_of(World((5.0, 5.0, 2.5), (Box((2.0, 2.0, 1.0), (3.0, 3.0, 1.1)),)))
    counts = {name: (obstacles_of(level, AGENTS[name]).points[:, 2] > 0.95).sum() for name in AGENTS}
    middle = [(np.abs(obstacles_of(level, AGENTS[n]).points[:, :2] - 2.5) < 0.4).all(axis=1).sum() for n in AGENTS]
    assert counts["roomba"] < counts["pepper"]
    assert dict(zip(AGENTS, (m > 0 for m in middle), strict=True)) == {
        "roomba": False,
        "spot": False,
        "pepper": True,
        "human": True,
    }


@pytest.mark.parametrize(("lowest", "stops"), [(0.11, True), (0.25, True), (0.45, False)])
def test_what_may_go_down_to_the_floor_between_the_points_of_a_thin_scan_stops_a_low_body(lowest, stops):
    rng = np.random.default_rng(0)
    floor = np.column_stack([rng.uniform(0, 4, (2500, 2)), np.zeros(2500)])  # 8 cm between the points
    post = np.column_stack([rng.normal(2, 0.02, (12, 2)), lowest + 0.08 * np.arange(12)])
    space = build_scene(np.concatenate([floor, post])).free_space("roomba")
    assert 0.1 < space.levels[0].surface.cell_width < 0.2
    distance, kind = space.levels[0].clearance(np.array([[2.0, 2.0]]))
    assert (distance[0] < 0.05 and kind[0] == ObstacleKind.MATERIAL) == stops


def test_slope_of_a_ramp_is_its_angle_and_a_stair_is_flat():
    x = np.arange(60) * 0.05
    ramp = HeightMap(
        np.zeros(2), 0.05, np.repeat((x * np.tan(0.3))[:, None], 40, 1).astype("f4"), np.ones((60, 40), "u1")
    )
    step, slope = step_and_slope(ramp)
    assert slope[5:-5, 5:-5] == pytest.approx(0.3, abs=0.01)
    assert step[5:-5, 5:-5].max() < 0.01
    stairs = HeightMap(
        np.zeros(2), 0.05, np.repeat((np.floor(x / 0.3) * 0.17)[:, None], 40, 1).astype("f4"), np.ones((60, 40), "u1")
    )
    step, slope = step_and_slope(stairs)
    assert step.max() == pytest.approx(0.17, abs=0.01)
    assert np.median(slope[5:-5, 5:-5]) < 0.01


@pytest.mark.parametrize(("heights", "highest"), [((0.0, 0.22, 0.44, 0.66, 0.88), 0.22), ((0.0, 0.22, 0.44), 0.44)])
def test_two_risers_beside_a_tread_of_one_wide_cell_are_two_steps_and_the_slanted_edge_of_a_seat_is_one(
    heights, highest
):
    """Of the treads every second one shows in one cell, the others in three; the seat has one half-way up."""
    wide = [3 if k % 2 == 0 else 1 for k in range(len(heights))]
    height = np.repeat(heights, wide)
    height = np.concatenate([np.full(9, height[0]), height, np.full(9, height[-1])])
    surface = HeightMap(
        np.zeros(2), 0.095, np.repeat(height[:, None], 12, 1).astype("f4"), np.ones((len(height), 12), "u1")
    )
    step, slope = step_and_slope(surface)
    assert step.max() == pytest.approx(highest, abs=0.02)
    assert slope.max() < 0.524


def banks(rise, run, flat=0.5, cell=0.05):
    """Level ground and steep banks by turns, of that rise and run [m], along x."""
    x = np.arange(80) * cell
    whole, part = np.divmod(x, flat + run)
    height = rise * (whole + np.clip((part - flat) / run, 0.0, 1.0))
    return HeightMap(np.zeros(2), cell, np.repeat(height[:, None], 40, 1).astype("f4"), np.ones((80, 40), "u1"))


def test_a_steep_face_between_two_places_to_stand_is_a_step_as_high_as_it_is():
    step, slope = (values[5:-5, 5:-5] for values in step_and_slope(banks(rise=0.3, run=0.25)))  # 50 degrees
    assert slope.max() < 0.524
    assert step.max() == pytest.approx(0.3, abs=0.02)


def test_a_steep_face_that_no_stride_crosses_is_a_slope():
    slope = step_and_slope(banks(rise=1.2, run=1.0))[1]
    assert slope.max() > 0.8


def test_height_is_not_mixed_across_a_step():
    height = np.where(np.arange(20)[:, None] < 10, 0.0, 0.3).repeat(20, 1).astype("f4")
    surface = HeightMap(np.zeros(2), 0.1, height, np.full((20, 20), OBSERVED, "u1"))
    found = surface.height_at(np.column_stack([np.linspace(0.5, 1.5, 101), np.full(101, 1.0)]))
    assert set(np.round(found, 6)) == {0.0, 0.3}


def test_outside_the_map_the_ground_is_unknown():
    surface = HeightMap(np.zeros(2), 0.1, np.zeros((5, 5), "f4"), np.full((5, 5), UNKNOWN, "u1"))
    assert not surface.contains(np.array([[0.2, 0.2], [9.0, 9.0]])).any()
    assert np.isnan(surface.height_at(np.array([[9.0, 9.0]]))).all()


def two_storeys(closed):
    """A floor, a slab 2.8 m over it with a ceiling, and, unless it is `closed`, a stair along one wall between them."""
    rng = np.random.default_rng(3)

    def sheet(low, high, z):
        count = ((np.array(high) - low) / 0.04).astype(int)
        grid = np.stack(np.meshgrid(*map(np.arange, count), indexing="ij"), -1).reshape(-1, 2)
        return np.column_stack([low + (grid + rng.uniform(0, 1, grid.shape)) * 0.04, np.full(len(grid), z)])

    parts = [sheet((0, 0), (8, 6), 0.0), sheet((0, 1.4), (8, 6), 2.5), sheet((0, 0), (8, 6), 5.6)]
    parts += [sheet((0, 1.4), (8, 6), 2.8), sheet((6.48, 0), (8, 1.4), 2.8), sheet((6.48, 0), (8, 1.4), 2.5)]
    if not closed:
        for i in range(16):
            parts.append(sheet((2 + 0.28 * i, 0.1), (2.28 + 0.28 * i, 1.2), 0.175 * (i + 1)))
            face = sheet((0.1, 0), (1.2, 0.175), 2 + 0.28 * i)
            parts.append(np.column_stack([face[:, 2], face[:, 0], face[:, 1] + 0.175 * i]))
        under = (np.abs(parts[0][:, 0] - 4.24) < 2.25) & (parts[0][:, 1] < 1.2)
        parts[0] = parts[0][~under]  # the stair is solid
    return np.concatenate(parts)


def test_a_storey_without_a_stair_is_ground_and_a_ceiling_is_not():
    points = two_storeys(closed=True)
    found = segment_ground(points)
    share = {z: found[points[:, 2] == z].mean() for z in (0.0, 2.5, 2.8, 5.6)}
    assert share[0.0] > 0.98
    assert share[2.8] > 0.95
    assert share[2.5] == share[5.6] == 0.0


def test_a_ceiling_that_is_larger_than_any_piece_of_the_floor_that_was_seen_is_no_ground():
    rng = np.random.default_rng(3)
    aisles = [np.column_stack([rng.uniform((0, y), (10, y + 1.2), (8000, 2)), np.zeros(8000)]) for y in (0, 2, 4, 6)]
    shelves = [rng.uniform((0, y - 0.8, 0), (10, y, 2), (40_000, 3)) for y in (2, 4, 6)]
    ceiling = np.column_stack([rng.uniform(0, (10, 7.2), (50_000, 2)), np.full(50_000, 3.2)])
    points = np.concatenate([*aisles, *shelves, ceiling])
    found = segment_ground(points)
    assert found[points[:, 2] == 0.0].mean() > 0.95
    assert not found[points[:, 2] > 1.0].any()


def test_a_human_walks_up_to_the_next_storey_and_a_roomba_does_not():
    scene = build_scene(two_storeys(closed=False))
    assert scene.levels.portals
    start, goal = (1.0, 3.0, 0.0), (4.0, 4.0, 2.8)
    result = plan(scene, start, goal, "human")
    assert result.status is Status.OK, result.message
    assert result.certificate.max_step == pytest.approx(0.175, abs=0.02)
    assert plan(scene, start, goal, "roomba").status is not Status.OK
    # who asks the field along the path, between its waypoints too, hears of the room that the certificate found
    path = result.trajectory.ground
    between = np.concatenate([path[:-1] + share * np.diff(path, axis=0) for share in (0.0, 0.3, 0.6, 0.9)])
    room = scene.obstacle_field("human").query(between).distance - AGENTS["human"].radius
    assert room.min() > result.certificate.min_clearance - 0.02


@pytest.mark.slow
def test_the_scanned_house_is_climbed_by_the_human_alone(scan):
    scene = build_scene(read_cloud(scan("house_2storey_stairs_4cm.npz")).points)
    result = plan(scene, (9.0, 14.0, 1.65), (14.0, 13.0, 5.35), "human")
    assert result.status is Status.OK, result.message
    assert np.ptp(result.trajectory.ground[:, 2]) > 3.5
    assert plan(scene, (9.0, 14.0, 1.65), (8.0, 10.0, 5.3), "roomba").status is Status.NO_VALID_PATH


def test_nothing_is_inferred_over_a_hatch_that_was_seen_through():
    points, ground = scan_of(World((5.0, 5.0, 2.5), (), ceiling=False))
    hatch = (np.abs(points[:, :2] - 2.5) < 0.4).all(axis=1)
    below = np.where(hatch[:, None], points - [0, 0, 3.0], points)
    level = survey_levels(points_of(below), ground & ~hatch, CONFIG)[0].levels[0]
    assert not level.surface.contains(np.array([[2.5, 2.5]])).any()


def test_on_coarse_cells_a_bump_beside_a_low_step_is_no_step_face():
    x, y = np.meshgrid(np.arange(0, 6, 0.1), np.arange(0, 6, 0.1))
    x, y = x.ravel() + 0.05, y.ravel() + 0.05
    floor = np.column_stack([x, y, np.where(x > 3.0, 0.12, 0.0)])
    bump = np.array([[2.85, 3.05, 0.06], [2.87, 3.1, 0.06]])  # 15 cm before the step, at half its height
    cloud = np.concatenate([floor, bump])
    level = survey_levels(points_of(cloud), np.arange(len(cloud)) < len(floor), CONFIG)[0].levels[0]
    assert level.surface.cell_width > 0.12
    found = obstacles_of(level, AGENTS["human"])
    assert (found.kind == ObstacleKind.MATERIAL).sum() == 2


def test_the_ground_next_above_is_the_lowest_that_is_near_and_high_enough():
    ground = np.array([[0.0, 0.0, 0.0], [0.05, 0.0, 0.2], [0.0, 0.06, 0.4], [0.2, 0.0, 0.15]])
    places = np.array([[0.0, 0.0, 0.1], [0.0, 0.0, 0.3], [0.0, 0.0, 0.5], [5.0, 5.0, 0.0]])
    found = next_above(ground, places, places[:, 2])
    assert found == pytest.approx([0.2, 0.4, np.inf, np.inf])


def test_the_ground_next_above_is_never_told_lower_than_it_is():
    heights = np.random.default_rng(0).uniform(0.0, 300.0, 500)
    ground = np.column_stack([np.arange(500.0), np.zeros(500), heights])
    found = next_above(ground, ground - [0.0, 0.0, 0.1], heights - 0.05).astype(np.float64)
    assert (found >= heights).all()
    assert (found - heights).max() < 1e-4


def test_the_rim_of_a_noisy_face_is_the_faces_and_what_is_higher_is_not():
    ground = np.array([[0.0, 0.0, 0.0], [0.05, 0.0, 0.35]])
    rim = np.array([[0.0, 0.0, 0.39], [0.0, 0.0, 0.41]])
    assert next_above(ground, rim, rim[:, 2]) == pytest.approx([np.inf, np.inf])
    assert next_above(ground, rim, rim[:, 2] - 0.05) == pytest.approx([0.35, np.inf])


def test_a_tread_whose_scatter_ends_where_a_step_begins_hides_no_step():
    """Sum and difference must be rounded alike: of 28 turns of a museum's stair at 4 cm two were shut by it."""
    found = []
    for millimetre in range(4000, 5000, 7):
        low = np.float32(0.001 * millimetre + 0.000459)
        height = np.full((9, 9), low, np.float32)
        height[:4] += 0.25
        surface = HeightMap(np.zeros(2), 0.065, height, np.full(height.shape, OBSERVED, np.uint8))
        x, y = ((np.arange(9) + 0.5) * 0.065 for _ in range(2))
        ground = np.column_stack([np.repeat(x, 9), np.tile(y, 9), height.ravel()])
        ground[4 * 9 + 4, 2] = np.float32(low + LEAST_OBSTACLE)
        face = ground[[4 * 9 + 4]] + [-0.03, 0.0, 0.005]
        ledge = find_ledges(surface, ground, face, CONFIG.max_step)
        limits = np.zeros(height.shape), np.zeros(height.shape)
        level = GroundLevel(surface, face, ledge, limits, (height < 0.0, height < 0.0))
        found.append(len(obstacles_of(level, AGENTS["human"]).points))
    assert max(found) == 0


def test_what_stands_where_no_ground_is_known_is_no_face():
    x, y = (a.ravel() for a in np.meshgrid(np.arange(0, 4, 0.05), np.arange(0, 4, 0.05)))
    floor = np.column_stack([x, y, np.zeros(len(x))])[(x < 2.0) | (y > 3.5)]
    wall = np.column_stack([np.full(40, 2.2), np.linspace(0.5, 2.5, 40), np.linspace(0.1, 1.9, 40)])
    cloud = np.concatenate([floor, wall])
    level = survey_levels(points_of(cloud), np.arange(len(cloud)) < len(floor), CONFIG)[0].levels[0]
    ix, iy, inside = level.surface.cells(wall)
    assert inside.all()
    assert (level.surface.state[ix, iy] == UNKNOWN).all()
    found = obstacles_of(level, AGENTS["human"])
    assert (found.kind == ObstacleKind.MATERIAL).sum() == len(wall)


@pytest.mark.parametrize("noise", [0.02, 0.05])
def test_what_is_labelled_as_no_ground_is_no_noise_of_the_floor_however_low_it_is(noise):
    rng = np.random.default_rng(0)
    x, y = (a.ravel() for a in np.meshgrid(np.arange(0, 4, 0.05), np.arange(0, 4, 0.05)))
    floor = np.column_stack([x, y, rng.normal(0.0, 0.2 * noise, len(x))])  # what the cure leaves
    things = np.array([[1.0, 1.0, 0.8 * noise], [2.0, 3.0, -0.5 * noise], [3.0, 1.0, 0.02]])
    far_below = np.array([[2.0, 2.0, -3.0 * noise]])
    cloud = np.concatenate([floor, things, far_below])
    level = survey_levels(points_of(cloud), np.arange(len(cloud)) < len(floor), CONFIG, noise=noise)[0].levels[0]
    found = obstacles_of(level, AGENTS["human"], Scan(noise))
    material = found.points[found.kind == ObstacleKind.MATERIAL]
    assert sorted(material[:, 0]) == pytest.approx([1.0, 2.0, 3.0])
    assert not (np.abs(material[:, 1] - 2.0) < 0.1).any()


def test_single_cells_of_a_noisy_floor_are_no_steps_and_corners_stay():
    height = np.zeros((12, 12), np.float32)
    height[6:, 6:] = 0.1
    height[2, 2], height[9, 2] = 0.03, 0.3
    surface = HeightMap(np.zeros(2), 0.05, height.copy(), np.full((12, 12), OBSERVED, np.uint8))
    assert without_outliers(surface, 0.0) is surface
    height[2, 2] = 0.0  # 0.3 m are no noise of 5 cm
    assert (without_outliers(surface, 0.15).height == height).all()


def test_a_sparse_slope_keeps_its_heights_beside_empty_cells():
    x, y = np.mgrid[0:60, 0:60] * 0.1
    slope = (0.14 * x - 0.05 * y).astype(np.float32)
    slope[np.random.default_rng(0).random(x.shape) < 0.1] = np.nan
    state = np.where(np.isnan(slope), UNKNOWN, OBSERVED).astype(np.uint8)
    made = without_outliers(HeightMap(np.zeros(2), 0.1, slope, state), 0.06).height
    assert (np.abs(made - slope)[1:-1, 1:-1] > 1e-6).sum() < 40  # of 3,018 cells 298 were, by up to 9 mm


def test_a_noisy_rim_over_a_platform_is_its_face_and_a_lip_is_not():
    rng = np.random.default_rng(0)
    noise, top = 0.05, 0.35
    grid = np.stack(np.meshgrid(np.arange(40), np.arange(40), indexing="ij"), -1).reshape(-1, 2) * 0.05 + 0.025
    ground = np.column_stack([grid, np.where(grid[:, 0] < 1.0, 0.0, top)])
    height = ground[:, 2].reshape(40, 40).astype(np.float32)
    surface = HeightMap(np.zeros(2), 0.05, height, np.full(height.shape, OBSERVED, np.uint8))

    def wall(high: float) -> np.ndarray:
        side = np.column_stack([np.ones(20 * 66), rng.uniform(0, 2, 20 * 66), rng.uniform(0, high, 20 * 66)])
        return side + [0, 0, 1] * rng.normal(0, noise, (len(side), 1))

    rim, lip = wall(top), wall(top + 3 * noise)
    over = rim[:, 2] > top + noise
    assert over.sum() > 10
    assert np.isinf(find_ledges(surface, ground, rim, CONFIG.max_step)[over]).all()
    assert np.isfinite(find_ledges(surface, ground, rim, CONFIG.max_step, noise)[over]).mean() > 0.9
    over = lip[:, 2] > top + noise
    assert np.isinf(find_ledges(surface, ground, lip, CONFIG.max_step, noise)[over]).all()


def test_noise_carries_a_face_further_off_its_platform():
    noise, top = 0.05, 0.35
    grid = np.stack(np.meshgrid(np.arange(40), np.arange(40), indexing="ij"), -1).reshape(-1, 2) * 0.05 + 0.025
    ground = np.column_stack([grid, np.where(grid[:, 0] < 1.0, 0.0, top)])
    surface = HeightMap(np.zeros(2), 0.05, ground[:, 2].reshape(40, 40).astype(np.float32), np.ones((40, 40), np.uint8))
    far = np.array([[0.93, 1.025, 0.2]])  # 9.5 cm from the middle of the platform's first cell
    assert np.isinf(find_ledges(surface, ground, far, CONFIG.max_step)).all()
    assert find_ledges(surface, ground, far, CONFIG.max_step, noise) == pytest.approx([top])


def test_one_point_over_a_thinly_seen_face_is_its_rim_and_two_things_on_it_are_none():
    noise, top = 0.02, 0.17
    grid = np.stack(np.meshgrid(np.arange(40), np.arange(40), indexing="ij"), -1).reshape(-1, 2) * 0.05 + 0.025
    ground = np.column_stack([grid, np.where(grid[:, 0] < 1.0, 0.0, top)])
    height = ground[:, 2].reshape(40, 40).astype(np.float32)
    surface = HeightMap(np.zeros(2), 0.05, height, np.full(height.shape, OBSERVED, np.uint8))
    face = np.array([[1.0, 0.92 + 0.04 * k, top - 0.01 * (1 + k % 3)] for k in range(5)])
    over = np.array([[1.0, 1.0, top + 0.045]])
    more = over + np.array([[0.0, 0.03, 0.0], [0.0, -0.03, 0.0]])
    assert find_ledges(surface, ground, np.concatenate([over, face]), CONFIG.max_step, noise)[0] == pytest.approx(top)
    assert np.isinf(find_ledges(surface, ground, np.concatenate([over, more, face]), CONFIG.max_step, noise)[:3]).all()
    assert np.isinf(
        find_ledges(surface, ground, over, CONFIG.max_step, noise)
    ).all()  # no face: it stands on the platform


def test_a_few_points_by_chance_over_a_well_seen_rim_are_the_rim_and_half_as_many_again_are_not():
    noise, top = 0.02, 0.19
    grid = np.stack(np.meshgrid(np.arange(40), np.arange(40), indexing="ij"), -1).reshape(-1, 2) * 0.05 + 0.025
    ground = np.column_stack([grid, np.where(grid[:, 0] < 1.0, 0.0, top)])
    height = ground[:, 2].reshape(40, 40).astype(np.float32)
    surface = HeightMap(np.zeros(2), 0.05, height, np.full(height.shape, OBSERVED, np.uint8))
    face = np.array([[1.0, 0.93 + 0.015 * k, top - 0.01 * (1 + k % 3)] for k in range(9)])
    over = np.array([[1.0, 0.95 + 0.02 * k, top + 0.022 + 0.002 * k] for k in range(6)])

    def ledges(count: int) -> np.ndarray:
        cloud = np.concatenate([over[:count], face])
        return find_ledges(surface, ground, cloud, CONFIG.max_step, noise)[:count]

    assert ledges(4) == pytest.approx(top)
    assert np.isinf(ledges(6)).all()


def test_a_floating_point_stops_nobody_and_a_cable_does():
    points, ground = scan_of(World((5.0, 5.0, 2.5), (), ceiling=False))
    cable = np.column_stack([np.full(25, 1.5), np.full(25, 2.5), np.arange(25) * 0.04 + 1.2])
    cloud = np.concatenate([points, [[3.5, 2.5, 1.2]], cable])
    assert np.flatnonzero(find_strays(cloud, 0.25)).tolist() == [len(points)]
    level = survey_levels(points_of(cloud), np.append(ground, np.zeros(26, dtype=bool)), CONFIG)[0].levels[0]
    at = obstacles_of(level, AGENTS["human"]).points
    assert np.hypot(*(at[:, :2] - [1.5, 2.5]).T).min() == 0.0
    assert np.hypot(*(at[:, :2] - [3.5, 2.5]).T).min() > 1.0


@pytest.mark.parametrize("make", [random_room, ramp])
def test_random_platforms_and_ramps_are_kept_at_a_centimetre_of_noise(make):
    for seed in range(3):
        scene = make(np.random.default_rng(seed), 0.01)
        found = segment_ground(scene.points)
        raised = scene.ground & (scene.points[:, 2] > 0.04)
        assert found[scene.ground].mean() > 0.98
        if raised.sum() > 100:  # there is a platform or a ramp
            assert found[raised].mean() > 0.98


def test_two_floors_that_a_gentle_stair_joins_are_two_levels():
    """Cells nearly as wide as a riser is high make floor, stair and upper floor one smooth piece, over itself."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(0.0, 6.0, 0.05), np.arange(0.0, 4.0, 0.05)))
    upper = (y > 1.2) | (x > 5.0)
    ramp = (y < 1.0) & (x > 1.0) & (x < 5.0)
    stair = np.floor((x[ramp] - 1.0) / 0.2) * 0.14
    points = np.concatenate(
        [
            np.column_stack([x[~ramp], y[~ramp], np.zeros((~ramp).sum())]),
            np.column_stack([x[ramp], y[ramp], stair]),
            np.column_stack([x[upper], y[upper], np.full(upper.sum(), 2.8)]),
        ]
    )
    scene = build_scene(points, np.ones(len(points), dtype=bool))
    assert {round(float(np.nanmax(surface.height)), 1) for surface in scene.surfaces} >= {2.8}
    assert plan(scene, (3.0, 3.0, 0.0), (4.0, 3.0, 0.0)).status is Status.OK
    assert plan(scene, (3.0, 3.0, 2.8), (4.0, 3.0, 2.8)).status is Status.OK


def car_park(slab=0.25, unseen=0.0):
    """Two decks 2.9 m apart, a `slab` thick, that a ramp joins, as scanners on each saw them, which are blind below.

    Of the upper one's top so many metres are `unseen`.
    """
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(0.0, 16.0, 0.05), np.arange(0.0, 6.0, 0.05)))
    deck, ramp = x < 8.0, (x >= 8.0) & (y < 3.0)
    blind = np.hypot(x - 4.0, y - 4.0) < 0.6
    surfaces = [
        (~(ramp & (x < 14.0)) & ~blind, 0.0 * x),
        (ramp & (x < 14.0), 2.9 * (14.0 - x) / 6.0),
        (deck & (x >= unseen) & (np.hypot(x - 4.0, y - 1.5) > 0.6), 0.0 * x + 2.9),
        (deck, 0.0 * x + 2.9 - slab),
    ]
    return np.concatenate([np.column_stack([x[seen], y[seen], z[seen]]) for seen, z in surfaces])


@pytest.mark.parametrize("slab", [0.25, 0.6])
def test_a_slab_seen_from_below_through_the_hole_in_the_scan_of_its_top_is_no_ground(slab):
    scene = build_scene(car_park(slab))
    heights = np.concatenate([surface.height_at(np.array([[4.0, 1.5]])) for surface in scene.surfaces])
    assert np.nanmin(np.abs(heights - 2.9 + slab)) > 0.2
    assert np.nanmin(np.abs(heights - 2.9)) < 0.01  # the slab is there: its top is inferred
    assert plan(scene, (4.0, 0.6, 2.9), (4.0, 2.4, 2.9)).status is Status.OK


def test_a_slab_of_which_the_top_was_mostly_not_seen_is_no_ground_where_it_was_not():
    points = car_park(unseen=5.6)
    scene, under = build_scene(points), np.abs(points[:, 2] - 2.65) < 0.01
    assert segment_ground(points)[under].mean() < 0.02
    places = points[under & (points[:, 0] < 5.0)][:, :2]
    heights = np.array([surface.height_at(places) for surface in scene.surfaces])
    assert not (np.abs(heights - 2.65) < 0.2).any()
    assert plan(scene, (3.0, 4.0, 0.0), (7.0, 4.0, 2.9)).status is Status.OK  # over the ramp


@pytest.mark.parametrize("deep", [0.0, 0.45, 0.9])
@pytest.mark.parametrize("beyond", [0.0, 0.9])
def test_where_a_tile_of_a_raised_floor_is_out_nobody_walks(deep, beyond):
    """What is below was seen in a fifth of the opening or beyond it, and no wall of it: thin tiles stand on posts."""
    x, y = (axis.ravel() for axis in np.meshgrid(*2 * [np.arange(0.0, 6.0, 0.03)]))
    out = (np.abs(x - 3.0) < 0.45) & (np.abs(y - 3.0) < 0.45)
    below = (np.abs(x - 3.0 - beyond) < 0.2) & (np.abs(y - 3.0) < 0.2)
    floor, bottom = (np.column_stack([x, y, 0.0 * x - z])[seen] for seen, z in ((~out, 0.0), (below, deep)))
    wall = np.column_stack([0.0 * x, x, y / 3.0])  # by it the floor is no ceiling
    heights = build_scene(np.concatenate([floor, bottom, wall])).surfaces[0].height_at(np.column_stack([x, y])[out])
    assert (np.isnan(heights).mean() > 0.9) == (deep > 0.0)


def test_a_hole_in_the_scan_of_a_floor_below_another_that_a_ramp_joins_is_filled():
    scene = build_scene(car_park())
    heights = np.concatenate([surface.height_at(np.array([[4.0, 4.0]])) for surface in scene.surfaces])
    assert np.nanmin(np.abs(heights)) < 0.01
    assert plan(scene, (3.0, 4.0, 0.0), (5.0, 4.0, 0.0)).status is Status.OK
    assert plan(scene, (3.0, 4.0, 0.0), (5.0, 4.0, 2.9)).status is Status.OK  # over the ramp


def open_flight(board=0.0, rise=0.18, slab=0.25):
    """A floor under a slab 16 steps higher, and an open flight of 15 treads, 5 cm thick, from one to the other.

    The floor below it, and the treads' undersides, were seen; the slab begins over the second tread.
    An inclined `board` so wide stands over one end of the treads, and hides it. A `slab` no thicker than a step is seen
    from below beside the last tread, too, which is as high as its underside.
    """
    rng, top = np.random.default_rng(0), 16 * rise

    def face(low, high, z):
        x, y = (axis.ravel() for axis in np.meshgrid(*(np.arange(a, b, 0.025) for a, b in zip(low, high, strict=True))))
        return np.column_stack([x, y, np.full(x.size, z)]) + rng.uniform(-0.01, 0.01, (x.size, 3)) * [1, 1, 0.4]

    parts = [face((0, 0), (9, 5), 0.0), face((5.9, 0), (9, 5), top)]
    for low, high in (((0, 0), (2.4, 5)), ((2.4, 0), (5.9, 1)), ((2.4, 3), (5.9, 5))):
        parts += [face(low, high, top), face(low, high, top - slab)]
    if slab <= rise:
        parts.append(face((5.9, 0), (9, 5), top - slab))
    for i in range(15):
        low, high = (2.0 + 0.26 * i, 1.5 + board), (2.0 + 0.26 * (i + 1) + 0.02, 2.5)
        parts += [face(low, high, rise * (i + 1)), face(low, high, rise * (i + 1) - 0.05)]
    side = face((2.1, 1.5), (5.9, 1.5 + board), 0.0)
    parts.append(side + np.outer(rise / 0.26 * (side[:, 0] - 1.92), [0, 0, 1]))
    return np.concatenate(parts)


@pytest.mark.parametrize("board", [0.0, 0.09])
def test_a_flight_of_open_treads_under_its_own_upper_floor_is_climbed_but_not_beside_its_open_side(board):
    scene = build_scene(open_flight(board))
    up = plan(scene, (1.0, 2.0, 0.0), (7.0, 2.0, 2.88), "human")
    assert up.status is Status.OK, up.message
    assert plan(scene, (7.0, 2.0, 2.88), (1.0, 2.0, 0.0), "human").status is Status.OK
    for i in range(2, 14):
        x, z = 2.13 + 0.26 * i, 0.18 * (i + 1)
        assert plan(scene, (x, 2.0, z), (1.0, 2.0, 0.0), "human").status is Status.OK, i
        for y in (1.56, 2.44):
            assert plan(scene, (x, y, z), (1.0, 2.0, 0.0), "human").status is Status.START_OCCUPIED, (i, y)


def test_the_last_tread_of_a_flight_is_ground_where_it_is_as_high_as_the_underside_of_the_floor_beside_it():
    points = open_flight(rise=0.21, slab=0.21)
    found, (x, y, z) = segment_ground(points), points.T
    number = np.round((x - 2.13) / 0.26)
    treads = (y > 1.5) & (y < 2.5) & (number < 15) & (np.abs(z - 0.21 * (number + 1)) < 0.01) & (number > -1)
    assert found[treads].mean() > 0.95
    assert found[(np.abs(z - 15 * 0.21) < 0.01) & (x > 6.2)].mean() < 0.01


def hillside_with_a_house(pitch):
    """A lawn, a terrace 1.8 m over it behind a bank of 24°, and a house whose roof of `pitch` begins at the terrace."""
    rng = np.random.default_rng(0)
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(0.0, 24.0, 0.1), np.arange(0.0, 20.0, 0.1)))
    x, y = x + rng.uniform(0.0, 0.1, x.size), y + rng.uniform(0.0, 0.1, y.size)
    on_terrace, on_roof = (x > 14.0) & (y > 6.0) & (y < 9.0), (x > 8.0) & (x < 14.0) & (y > 6.0) & (y < 14.0)
    bank = np.clip(0.45 * (20.0 - x), 0.0, 1.8)
    z = np.where(on_terrace, np.minimum(bank, 1.8), 0.0)
    z = np.where(on_roof, 1.9 + np.tan(pitch) * np.minimum(14.0 - x, x - 8.0), z)
    wall = np.arange(0.0, 1.9, 0.1)
    front = [np.column_stack([np.full(19, 8.0), np.full(19, v), wall]) for v in np.arange(6.0, 14.0, 0.1)]
    points = np.concatenate([np.column_stack([x, y, z]), *front])
    return points, *(np.append(mask, np.zeros(len(points) - len(x), dtype=bool)) for mask in (on_terrace, on_roof))


def test_a_pitched_roof_that_begins_at_a_terrace_is_no_ground():
    points, on_terrace, on_roof = hillside_with_a_house(0.6)
    found = segment_ground(points)
    assert found[on_terrace].mean() > 0.95
    assert found[on_roof].mean() < 0.02
    assert found[~on_roof & (points[:, 2] == 0.0)].mean() > 0.98


def test_a_tread_is_ground_to_its_end_and_its_risers_are_joined_to_it():
    scene = SCENES["stair"](np.random.default_rng(1), 0.01)
    found = segment_ground(scene.points)
    assert found[scene.ground].mean() > 0.98
    surface = survey_levels(points_of(scene.points), scene.ground, CONFIG)[0].levels[0].surface
    foot, head = (surface.height_at(np.array([[x, 0.8]]))[0] for x in (2.1, 4.4))
    assert (foot, head) == pytest.approx((0.17, 1.53), abs=0.02)


def lawn(rng, width=6.0, spacing=0.04):
    count = int((width / spacing) ** 2)
    return np.column_stack([rng.uniform(0.0, width, (count, 2)), np.zeros(count)])


def test_nothing_is_inferred_under_a_rock_that_was_seen_from_above_alone():
    points = lawn(np.random.default_rng(0))
    rock = (np.abs(points[:, :2] - 3.0) < 0.5).all(axis=1)
    points[rock, 2] = 0.8
    surface = survey_levels(points_of(points), ~rock, CONFIG)[0].levels[0].surface
    assert not surface.contains(np.array([[3.0, 3.0]])).any()


def test_the_floor_goes_on_through_a_hole_beside_a_low_box_and_not_through_one_that_walls_close_off():
    points = lawn(np.random.default_rng(0))
    x, y = points[:, 0], points[:, 1]
    points[(x > 3.4) & (x < 4.0) & (y > 2.7) & (y < 3.3), 2] = 0.27
    hole = (np.hypot(x - 3.0, y - 3.0) < 0.4) | (np.hypot(x - 1.0, y - 5.0) < 0.4)
    z, angle = (axis.ravel() for axis in np.meshgrid(np.arange(0.0, 1.5, 0.03), np.arange(0.5, 6.0, 0.05)))
    wall = np.column_stack([1.0 + 0.37 * np.cos(angle), 5.0 + 0.37 * np.sin(angle), z])
    cloud = np.concatenate([points[~hole], wall])
    surface = (
        survey_levels(points_of(cloud), np.arange(len(cloud)) < len(cloud) - len(wall), CONFIG)[0].levels[0].surface
    )
    assert surface.height_at(np.array([[3.0, 3.0]])) == pytest.approx(0.0, abs=0.02)
    assert not surface.contains(np.array([[1.0, 5.0]])).any()


def test_a_scene_says_how_sure_its_ground_is():
    rng = np.random.default_rng(0)
    floor = lawn(rng)
    crumbs = np.column_stack([rng.uniform(1.0, 5.0, (500, 2)), np.full(500, 0.03)])
    cloud = np.concatenate([floor, crumbs])
    sure, unsure = (build_scene(part, np.arange(len(part)) < len(floor)).info() for part in (floor, cloud))
    assert (sure["ground_confidence"], sure["undecided_points"]) == (1.0, 0)
    assert unsure["undecided_points"] == pytest.approx(500, abs=25)
    assert unsure["ground_confidence"] == pytest.approx(len(floor) / len(cloud), abs=0.01)


def test_every_blocked_leaf_says_why():
    scene = build_scene(*scan_of(World((6.0, 5.0, 2.7), (Box((2.0, 1.0, 0.0), (3.0, 2.0, 0.35), walkable=True),))))
    space = scene.free_space("roomba")
    tree, surface = space.levels[0].quadtree, space.levels[0].surface
    blocked = tree.center[~tree.free]
    distance, kind = space.levels[0].clearance(blocked)
    named = distance < space.radius
    assert (named | ~surface.contains(blocked)).all()
    assert {ObstacleKind(int(one)) for one in np.unique(kind[named])} >= {ObstacleKind.MATERIAL, ObstacleKind.STEP}


def test_a_cell_that_the_scan_missed_in_a_floor_over_another_is_ground_whatever_is_under_it():
    house = make_house(np.random.default_rng(1))
    scene = build_scene(house.points, house.ground)
    for surface in scene.surfaces:
        beside = ndimage.binary_erosion(surface.state == OBSERVED, np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]]))
        assert beside.sum() > (beside & (surface.state == OBSERVED)).sum()  # there are such cells
        assert not (beside & (surface.state == UNKNOWN)).any()


def swivel_chair(x, y, turn):
    """The foot of one: five arms of 30 cm, 5 cm wide and 3 to 7 cm over the floor."""
    arms = []
    for angle in turn + 2.0 * np.pi * np.arange(5) / 5.0:
        along = np.linspace(0.05, 0.3, 60)[:, None] * [np.cos(angle), np.sin(angle)]
        across = np.linspace(-0.025, 0.025, 6)[:, None] * [-np.sin(angle), np.cos(angle)]
        top = (along[:, None] + across[None] + [x, y]).reshape(-1, 2)
        away = np.hypot(*(top - [x, y]).T)
        arms += [np.column_stack([top, z + 0.07 - 0.13 * away]) for z in (0.0, -0.03)]
    return np.concatenate(arms)


@pytest.mark.parametrize("seed", range(4))
def test_the_foot_of_a_chair_is_no_ground_and_a_sill_or_a_bump_across_the_way_is(seed):
    rng = np.random.default_rng(seed)
    sill = Box((3.0, 0.0, 0.0), (3.12, 3.0, 0.06), walkable=True)
    hump = [Box((x, 0.0, 0.0), (x + 0.1, 3.0, h), walkable=True) for x, h in ((4.5, 0.03), (4.6, 0.05), (4.7, 0.03))]
    floor, labels = scan_of(World((6.0, 3.0, 2.5), (sill, *hump)), 0.03, 0.002, seed)
    feet = np.concatenate([swivel_chair(1.0, y, rng.uniform(0, 1.2)) for y in (0.8, 2.2)])
    points = np.concatenate([floor, feet])
    found, high = segment_ground(points), feet[:, 2] > 0.02
    assert found[len(floor) :][high].mean() < 0.05  # 0.29 by slope alone
    assert found[: len(floor)][labels].mean() > 0.98
    assert plan(build_scene(points), (0.4, 1.5, 0), (5.6, 1.5, 0), "human").status == Status.OK


def test_rubble_is_ground_though_all_of_it_are_bumps():
    rng = np.random.default_rng(0)
    xy = rng.uniform(0, 8, (80_000, 2))
    relief = ndimage.gaussian_filter(rng.normal(size=(160, 160)), 2.0)
    z = 0.03 / relief.std() * ndimage.map_coordinates(relief, 20.0 * xy.T, order=1)
    assert segment_ground(np.column_stack([xy, z])).mean() > 0.99


def flight_seen_from_above(hidden, back=0.0):
    """A closed flight of 14 treads between walls, x from 2 m; of some the nose above has `hidden` all but a `back`."""
    rng = np.random.default_rng(0)

    def sheet(low, high, z):
        count = int(np.prod(np.subtract(high, low)) / 0.02**2)
        return np.column_stack([rng.uniform(low, high, (count, 2)), np.full(count, z)])

    treads = []
    for i in range(14):
        x = 2.0 + 0.28 * i
        end = x + 0.28 - (hidden + back if i in (4, 5, 9) else 0.0)
        treads.append(sheet((x, 1.4), (end, 2.6), 0.18 * (i + 1)))
        if back > 0.0 and i in (4, 5, 9):  # and one end of it was seen
            treads += [sheet((x + 0.28 - back, 1.4), (x + 0.28, 2.6), 0.18 * (i + 1))]
            treads += [sheet((end, 1.4), (x + 0.28 - back, 1.6), 0.18 * (i + 1))]
    head = 2.0 + 0.28 * 14
    floors = [sheet((0.0, 0.0), (2.0, 4.0), 0.0), sheet((head, 0.0), (head + 2.0, 4.0), 0.18 * 14)]
    count = int(0.28 * 14 * 3.0 / 0.02**2)
    walls = [
        np.column_stack([rng.uniform(2.0, head, count), np.full(count, y), rng.uniform(0.0, 3.0, count) + 0.5])
        for y in (1.4, 2.6)
    ]
    return np.concatenate([*treads, *floors, *walls]) + rng.normal(0.0, 0.002, (1, 3))


@pytest.mark.parametrize(("hidden", "back"), [(0.16, 0.0), (0.1, 0.08)])
def test_a_strip_that_nobody_saw_of_a_tread_is_inferred_as_the_tread(hidden, back):
    scene = build_scene(flight_seen_from_above(hidden, back))
    for i in (4, 5, 9):
        place = np.array([[2.0 + 0.28 * (i + 1) - back - 0.5 * hidden, 2.0]])
        known = [s for s in scene.surfaces if not np.isnan(s.height_at(place)[0])]
        assert known, i
        for surface in known:
            ix, iy, _ = surface.cells(place)
            assert surface.state[ix[0], iy[0]] == INFERRED
            assert surface.height_at(place)[0] == pytest.approx(0.18 * (i + 1), abs=0.01)  # the lower tread
    assert plan(scene, (1.0, 2.0, 0.0), (7.0, 2.0, 2.52), "human").status is Status.OK
    assert plan(scene, (7.0, 2.0, 2.52), (1.0, 2.0, 0.0), "human").status is Status.OK


def test_a_gap_wider_than_a_foot_or_under_a_single_step_stays_unknown():
    wide = build_scene(flight_seen_from_above(0.26))
    refused = Status.NO_VALID_PATH, Status.GOAL_OUTSIDE_MAP
    assert plan(wide, (1.0, 2.0, 0.0), (7.0, 2.0, 2.52), "human").status in refused
    rng = np.random.default_rng(0)
    x, y = rng.uniform(0.0, 8.0, 60000), rng.uniform(0.0, 3.0, 60000)
    seen = (x < 4.0) | (x > 4.16)  # beyond it a platform, 18 cm high
    step = build_scene(np.column_stack([x, y, 0.18 * (x > 4.1)])[seen])
    assert all(np.isnan(s.height_at(np.array([[4.1, 1.5]]))[0]) for s in step.surfaces)


def test_a_strip_through_a_level_floor_or_a_wide_one_that_is_seen_through_stays_unknown():
    flight, rng = flight_seen_from_above(0.18, 0.0), np.random.default_rng(1)
    strip = 2.0 + 0.28 * 10 - 0.09  # no sole is as wide; a narrower one at a riser is an open riser
    below = np.column_stack([rng.uniform((strip - 0.09, 1.4), (strip + 0.09, 2.6), (500, 2)), np.zeros(500)])
    x, y = rng.uniform(0.0, 8.0, 60000), rng.uniform(0.0, 3.0, 60000)
    seen = (x < 3.8) | (x > 3.92)
    step = np.column_stack([x, y, 0.18 * (x > 4.1)])[seen]  # up on one side of it, and not down on the other
    for cloud, place in ((np.concatenate([flight, below]), (strip, 2.0)), (step, (3.86, 1.5))):
        assert all(np.isnan(s.height_at(np.array([place]))[0]) for s in build_scene(cloud).surfaces)


def test_the_end_of_a_stringer_is_no_step_and_the_tread_beside_it_is_one():
    grid = np.stack(np.meshgrid(np.arange(40), np.arange(46), indexing="ij"), -1).reshape(-1, 2) * 0.05 + 0.025
    tread, next_, over = 0.17, 0.51, 0.1
    treads = np.select([(grid[:, 0] < 1.0) | (grid[:, 1] > 2.0), grid[:, 0] < 1.3], [0.0, tread], next_)

    def ledges(broad: float, points: np.ndarray) -> np.ndarray:
        """Beside a stringer so `broad`."""
        height = treads + np.where((grid[:, 1] > 2.0 - broad) & (treads > 0.0), over, 0.0)
        surface = np.column_stack([grid, height]), height.reshape(40, 46).astype(np.float32)
        seen = HeightMap(np.zeros(2), 0.05, surface[1], np.full((40, 46), OBSERVED, np.uint8))
        return find_ledges(seen, surface[0], points, CONFIG.max_step)

    end, middle, riser = np.array([[1.0, 1.975, 0.2]]), np.array([[1.0, 1.85, 0.2]]), np.array([[1.0, 1.0, 0.1]])
    assert np.isinf(ledges(0.05, end)).all()
    assert ledges(0.05, riser) == pytest.approx([tread])
    assert ledges(0.3, middle) == pytest.approx([tread + over])  # a foot rests on it: a tread of its own


def height_map(width, z, shift=0.0):
    """Samples of a surface that is `z` of x high, on a grid of that width around the middle, shifted along x."""
    x, y = np.mgrid[-2.0 : 2.0 + width / 2 : width, -2.0 : 2.0 + width / 2 : width].reshape(2, -1)
    return np.column_stack([x + shift, y, z(x)])


@pytest.mark.parametrize("shift", np.arange(0.0, 0.27, 0.03))
def test_a_groove_of_one_voxel_cuts_no_floor_wherever_its_cells_lie(shift):
    floor = height_map(0.2, lambda x: np.where(np.abs(x) < 0.1, -0.2, 0.0), shift)
    scene = build_scene(floor)
    assert plan(scene, [shift - 1.0, 0.0], [shift + 1.0, 0.0], "human").status is Status.OK
    assert plan(scene, [shift - 1.0, 0.0], [shift - 0.6, 0.0], "roomba").status is Status.OK


def test_a_single_voxel_under_a_floor_is_no_groove():
    floor = height_map(0.2, np.zeros_like)
    floor[np.hypot(*floor[:, :2].T) < 0.1, 2] = -0.2
    assert not segment_ground(floor)[floor[:, 2] < -0.1].any()


@pytest.mark.parametrize("shift", np.arange(0.0, 0.056, 0.008))
def test_cells_that_only_a_step_s_face_fills_are_ground_wherever_they_lie(shift):
    face = height_map(0.04, lambda x: 0.1 * np.clip(np.round(x / 0.04) + 1.0, 0.0, 3.0), shift)
    result = plan(build_scene(face), [shift - 1.0, 0.0], [shift + 1.0, 0.0], "human")
    assert result.status is Status.OK
    assert result.certificate.max_step == pytest.approx(0.3, abs=0.01)
    high = face * [1.0, 1.0, 2.0]
    result = plan(build_scene(high), [shift - 1.0, 0.0], [shift + 1.0, 0.0], "human")
    assert result.status is Status.NO_VALID_PATH


def test_what_is_under_the_ground_beside_guards_no_edge():
    """It may be a step's face, which stops nobody who takes the step; a wall stops all who come there."""
    height = np.zeros((9, 9), np.float32)
    height[5:], height[4] = 0.3, np.nan
    surface = HeightMap(np.zeros(2), 0.05, height, np.where(np.isnan(height), UNKNOWN, OBSERVED).astype(np.uint8))
    cell, z = np.array([4 * 9 + 2, 4 * 9 + 2, 4 * 9 + 6, 4 * 9 + 6]), np.array([0.1, 0.25, 0.1, 0.38])
    lowest = np.full(81, np.inf)
    lowest[cell] = 0.1
    _, guarded = guard_edges(surface, lowest.reshape(9, 9), cell, z, replace(CONFIG, stair_step=0.0))
    assert np.argwhere(guarded).tolist() == [[4, 6]]


def test_walls_of_a_coarse_scan_tell_no_scatter_of_the_floor():
    """In wide cells most points of a floor's nodes may be of walls: then all was within three deviations of it."""
    _, scan = scanned_house(13, "handheld", thin=0.08)
    found = segment_ground(scan.points)
    assert found[scan.ground].mean() > 0.9
    assert found[~scan.ground].mean() < 0.05  # the undersides of its upper floor, and a foot of its walls

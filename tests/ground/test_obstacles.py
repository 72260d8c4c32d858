import numpy as np
import pytest
from scipy import ndimage

from gpdf_service import build_scene
from gpdf_service.bench.build_changes import differences, from_scratch
from gpdf_service.config import PerceptionConfig
from gpdf_service.ground.footing import on_treads
from gpdf_service.ground.limits import ObstacleKind
from gpdf_service.ground.obstacles import highest_within, obstacles_of, voxel_pitch
from gpdf_service.perception.levels import survey_levels
from gpdf_service.synthetic.solids import turn_and_shift
from gpdf_service.tiles.points import points_of
from gpdf_service.tiles.surface import OBSERVED, UNKNOWN, HeightMap
from gpdf_service.types import AGENTS

RISE, GOING, SPACING = 0.2, 0.25, 0.025
HUMAN = AGENTS["human"]


def plane(x, y, z):
    """Points on a level rectangle, every 2.5 cm."""
    grid = np.meshgrid(np.arange(*x, SPACING) + 0.5 * SPACING, np.arange(*y, SPACING) + 0.5 * SPACING)
    return np.column_stack([grid[0].ravel(), grid[1].ravel(), np.full(grid[0].size, z)])


def flight(treads=10):
    """A stair up along x, 1.5 m wide."""
    return np.vstack([plane((GOING * k, GOING * (k + 1)), (0.0, 1.5), RISE * k) for k in range(treads)])


def overhead(ground, slab):
    """Points of a slab that stop a human on the `ground`."""
    cloud = np.vstack([ground, slab])
    level = survey_levels(points_of(cloud), np.arange(len(cloud)) < len(ground), PerceptionConfig())[0].levels[0]
    found = obstacles_of(level, HUMAN)
    return found.points[(found.points[:, 2] > slab[:, 2].min() - 0.01) & (found.kind == 0)]


@pytest.mark.parametrize("along", [(0, 1, 2), (1, 0, 2)])
@pytest.mark.parametrize(("room", "stops"), [(2.08, False), (1.95, True)])
def test_under_the_edge_of_an_upper_floor_counts_the_tread_that_the_foot_is_on(room, stops, along):
    """It ends 20 cm before the next nose: over there a human of 2 m would touch it, but his foot is not there yet."""
    slab = plane((0.3, 5 * GOING + 0.05), (0.0, 1.5), 5 * RISE + room)
    slab = slab[slab[:, 0] > 4.5 * GOING]
    assert (len(overhead(flight()[:, along], slab[:, along])) > 0) == stops


def test_what_hangs_before_a_ledge_that_is_no_step_stops_who_stands_on_it():
    ground = np.vstack([plane((0.0, 2.0), (0.0, 1.5), 0.0), plane((2.0, 4.0), (0.0, 1.5), 0.6)])
    assert len(overhead(ground, plane((1.7, 1.8), (0.0, 1.5), 2.5))) > 0


def treads_of(height):
    state = np.where(np.isnan(height), UNKNOWN, OBSERVED).astype(np.uint8)
    return HeightMap(np.zeros(2), 0.05, height.astype(np.float32), state)


@pytest.mark.parametrize(
    ("place", "over", "of_tread"),
    [
        ((22, 15), 0.06, True),  # on a tread
        ((22, 15), 0.12, False),  # a thing on it
        ((24, 15), 0.15, True),  # before the next riser
        ((22, 29), 0.06, False),  # at the flight's side: its stringer
        ((2, 15), 0.06, False),  # on the floor before it
    ],
)
def test_what_is_rough_on_the_treads_of_a_flight_is_of_them(place, over, of_tread):
    x = np.arange(50)
    height = np.where(x < 10, 0.0, RISE * ((x - 10) // 5 + 1.0))[:, None] * np.ones(40)
    height[:, 30:] = np.nan
    z = np.array([height[place] + over])
    cell = np.array([place[0] * 40 + place[1]])
    assert on_treads(z, cell, treads_of(height), HUMAN.max_step)[0] == of_tread


@pytest.mark.parametrize("radius", [0.0, 1.0, 4.4, 7.0, 40.0])
@pytest.mark.parametrize("shape", [(1, 1), (3, 90), (60, 25)])
def test_the_highest_in_a_disc_is_that_of_a_filter_over_its_area(radius, shape):
    rng = np.random.default_rng(0)
    known = rng.random(shape) < 0.8
    heights = np.where(known, rng.normal(size=shape).astype(np.float32), -np.inf)
    reach = int(np.ceil(radius))
    x, y = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    disc = np.hypot(x, y) <= radius
    found = highest_within(heights, disc)
    assert found.dtype == heights.dtype
    # scipy's default mode reflects wrongly at a map that is much narrower than the disc
    expected = ndimage.maximum_filter(heights, footprint=disc, mode="constant", cval=-np.inf)
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("turn", np.arange(0.2, 1.3, 0.1))
def test_a_ramp_of_wide_voxels_is_no_row_of_things(turn):
    x, y = (each.ravel() for each in np.meshgrid(np.arange(0, 12, 0.03), np.arange(0, 4, 0.03), indexing="ij"))
    ramp = np.column_stack([x, y, np.clip(0.2 * (x - 4.0), 0.0, 0.8)]) @ turn_and_shift(turn)[:3, :3].T
    scene = build_scene(0.2 * np.unique(np.round(ramp / 0.2).astype(int), axis=0))
    stopping = [own.obstacles for own in scene.free_space("spot").levels]
    assert all(not (stops.kind == ObstacleKind.MATERIAL).any() for stops in stopping)


@pytest.mark.parametrize(
    ("heights", "voxels"),
    [
        ([0.2, 0.4, 0.4, 1.0], True),
        (np.float32([7.0, 7.2, 7.6]).astype(float), True),
        ([0.01, 0.02, 0.05], False),  # nothing that stops a body is lost in so small ones
        ([0.2, 0.4, 0.73], False),
        ([0.2, 0.2], False),
        ([], False),
    ],
)
def test_voxels_are_told_by_their_rungs(heights, voxels):
    points = np.column_stack([np.zeros((len(heights), 2)), np.array(heights, dtype=float)])
    assert (voxel_pitch(points_of(points)) > 0.0) == voxels


def test_a_change_of_voxels_into_points_changes_what_stops_a_body_as_a_build_does():
    x, y = (each.ravel() for each in np.meshgrid(np.arange(0, 12, 0.03), np.arange(0, 4, 0.03), indexing="ij"))
    ramp = np.column_stack([x, y, np.clip(0.2 * (x - 4.0), 0.0, 0.8)]) @ turn_and_shift(0.9)[:3, :3].T
    before = build_scene(0.2 * np.unique(np.round(ramp / 0.2).astype(int), axis=0))
    before.free_space("spot")
    middle = np.median(before.points, axis=0)
    after = before.update(insert=middle + np.array([[0.0, 0.0, 0.93], [0.0, 0.01, 0.97], [0.01, 0.0, 0.95]]))
    anew = from_scratch(after)
    assert not differences(after, anew)
    stops = [scene.free_space("spot").levels[0].obstacles.points for scene in (before, after, anew)]
    assert len(stops[1]) == len(stops[2]) > len(stops[0]) + 3

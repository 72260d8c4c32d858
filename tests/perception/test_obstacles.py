from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from gpdf_service import build_scene, plan
from gpdf_service.bench.build_changes import differences, from_scratch
from gpdf_service.config import PerceptionConfig
from gpdf_service.perception.footing import on_treads
from gpdf_service.perception.levels import survey_levels
from gpdf_service.perception.limits import ObstacleKind
from gpdf_service.perception.obstacles import HEADROOM_SHARE, are_voxels, highest_within, obstacles_of
from gpdf_service.perception.points import points_of
from gpdf_service.perception.surface import OBSERVED, UNKNOWN, HeightMap
from gpdf_service.synthetic.solids import turn_and_shift
from gpdf_service.types import AGENTS, Status

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
    level = survey_levels(cloud, np.arange(len(cloud)) < len(ground), PerceptionConfig())[0].levels[0]
    found = obstacles_of(level, HUMAN)
    return found.points[(found.points[:, 2] > slab[:, 2].min() - 0.01) & (found.kind == 0)]


NEXT = 5 * GOING
"""[m] A nose, and the tread before it is 4 risers up."""


@pytest.mark.parametrize("along", [(0, 1, 2), (1, 0, 2)])
@pytest.mark.parametrize(("short", "room", "stops"), [(0.2, 2.08, True), (0.2, 2.25, False), (0.3, 2.08, False)])
def test_over_a_flight_a_body_is_as_high_as_its_contact_over_its_whole_footprint(short, room, stops, along):
    """The edge of a floor ends `short` of a nose, and has so much `room` over the tread there: 2 m are room enough.

    As the human's axis passes the nose he is a riser higher, and less than his radius from an edge that is 0.2 m short.
    """
    slab = plane((0.3, NEXT), (0.0, 1.5), 4 * RISE + room)
    slab = slab[(slab[:, 0] > 3.5 * GOING) & (slab[:, 0] < NEXT - short)]
    assert (len(overhead(flight()[:, along], slab[:, along])) > 0) == stops


@pytest.mark.parametrize(("height", "certified"), [(2.0, False), (1.9, True)])
def test_up_a_stair_under_an_edge_whose_room_is_told_from_the_highest_tread_in_reach(height, certified):
    """1.93 m are over the tread whose nose is 0.2 m past the edge. What is certified touches nothing."""
    low, high = plane((-2.0, 0.0), (0.0, 1.5), -RISE), plane((10 * GOING, 10 * GOING + 2.0), (0.0, 1.5), 9 * RISE)
    ground = np.vstack([low, flight(), high])
    slab = plane((-2.0, NEXT - 0.2), (0.0, 1.5), 5 * RISE + 1.93)
    walls = np.vstack([plane((-RISE, 9 * RISE + 2.0), (-2.0, 4.5), y)[:, [1, 2, 0]] for y in (0.0, 1.5)])
    cloud = np.vstack([ground, slab, walls])
    body = replace(HUMAN, height=height)
    result = plan(build_scene(cloud, np.arange(len(cloud)) < len(ground)), [-1.5, 0.75, -0.2], [4.0, 0.75, 1.8], body)
    assert (result.status is Status.OK) == certified
    if not certified:
        assert result.status is Status.NO_VALID_PATH
        assert "1.93 m of headroom" in result.message
    for foot in () if result.trajectory is None else dense(result.trajectory.ground):
        over = slab[np.hypot(*(slab[:, :2] - foot[:2]).T) < body.radius, 2] - foot[2]
        assert over.min(initial=np.inf) >= body.height * (1.0 - HEADROOM_SHARE)


def dense(path):
    """Contact points every 5 mm; between two of them a body takes a step at once."""
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(path[:, :2], axis=0), axis=1)))
    at = np.arange(0.0, along[-1], 0.005)
    upper = np.maximum(path[:-1, 2], path[1:, 2])[np.searchsorted(along, at, side="right") - 1]
    return np.column_stack([np.interp(at, along, path[:, 0]), np.interp(at, along, path[:, 1]), upper])


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
    assert all(not (stops.kind == ObstacleKind.MATERIAL).any() for stops in scene.free_space("spot").obstacles)


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
    assert are_voxels(points_of(points)) == voxels


def test_a_change_of_voxels_into_points_changes_what_stops_a_body_as_a_build_does():
    x, y = (each.ravel() for each in np.meshgrid(np.arange(0, 12, 0.03), np.arange(0, 4, 0.03), indexing="ij"))
    ramp = np.column_stack([x, y, np.clip(0.2 * (x - 4.0), 0.0, 0.8)]) @ turn_and_shift(0.9)[:3, :3].T
    before = build_scene(0.2 * np.unique(np.round(ramp / 0.2).astype(int), axis=0))
    before.free_space("spot")
    middle = np.median(before.points, axis=0)
    after = before.update(insert=middle + np.array([[0.0, 0.0, 0.93], [0.0, 0.01, 0.97], [0.01, 0.0, 0.95]]))
    anew = from_scratch(after)
    assert not differences(after, anew)
    stops = [scene.free_space("spot").obstacles[0].points for scene in (before, after, anew)]
    assert len(stops[1]) == len(stops[2]) > len(stops[0]) + 3

"""Ground over head under which nobody saw an underside may be as thick as a step."""

import numpy as np
import pytest

import gpdf_service as gpdf
from gpdf_service.bench.build_changes import differences, from_scratch
from gpdf_service.config import PerceptionConfig
from gpdf_service.ground.obstacles import obstacles_of
from gpdf_service.perception.levels import survey_levels
from gpdf_service.tiles.points import points_of
from gpdf_service.types import AGENTS

HUMAN, SPACING, NOTHING = AGENTS["human"], 0.025, np.zeros((0, 3))


def plane(x, y, z):
    """Points on a level rectangle, every 2.5 cm."""
    grid = np.meshgrid(np.arange(*x, SPACING), np.arange(*y, SPACING))
    return np.column_stack([grid[0].ravel(), grid[1].ravel(), np.full(grid[0].size, float(z))])


def stops(over, is_ground, below=NOTHING):
    """Whether something over a floor stops a human who stands under its middle."""
    floor = plane((0.0, 4.0), (0.0, 4.0), 0.0)
    cloud, ground = np.vstack([floor, over, below]), np.zeros(len(floor) + len(over) + len(below), dtype=bool)
    ground[: len(floor)], ground[len(floor) :][: len(over)] = True, is_ground
    level = survey_levels(points_of(cloud), ground, PerceptionConfig())[0].levels[0]
    found = obstacles_of(level, HUMAN)
    off = np.hypot(*(found.points[found.kind == 0][:, :2] - 2.0).T)
    return bool((off < HUMAN.radius).any())


def deck(z):
    return plane((1.0, 3.0), (1.0, 3.0), z)


@pytest.mark.parametrize(("room", "stopped"), [(2.2, True), (2.4, False)])
def test_a_floor_that_was_seen_from_above_alone_may_be_as_thick_as_a_step(room, stopped):
    assert stops(deck(room), is_ground=True) == stopped


def test_an_underside_that_was_seen_tells_how_thick_the_floor_is():
    assert not stops(deck(2.2), is_ground=True, below=deck(2.05))
    assert stops(deck(2.2), is_ground=True, below=deck(1.95))


def test_a_board_both_of_whose_faces_are_ground_is_as_thick_as_it_was_seen():
    assert not stops(np.vstack([deck(2.2), deck(2.16)]), is_ground=True)


def test_a_ceiling_or_a_lintel_reaches_down_to_its_points():
    assert not stops(deck(2.2), is_ground=False)


def test_risers_are_no_underside_of_the_flight():
    """The lowest tread over a human is 2.2 m up, and its riser, which was seen from before it, ends at 2.0 m."""
    treads = [plane((0.25 * k, 0.25 * (k + 1)), (1.0, 3.0), 0.8 + 0.2 * k) for k in range(14)]
    faces = [plane((0.6 + 0.2 * k, 0.8 + 0.2 * k), (1.0, 3.0), 0.25 * k)[:, [2, 1, 0]] for k in range(14)]
    assert stops(np.vstack(treads), is_ground=True, below=np.vstack(faces))


def test_an_underside_that_is_seen_later_changes_the_scene_as_a_build_does():
    floor, over = plane((0.0, 5.0), (0.0, 5.0), 0.0), plane((1.5, 3.5), (1.5, 3.5), 2.2)
    cloud = np.vstack([floor, over])
    scene = gpdf.build_scene(cloud, np.ones(len(cloud), dtype=bool))
    below = plane((2.0, 2.6), (2.0, 2.6), 2.1)
    seen = scene.update(insert=below, ground=np.zeros(len(below), dtype=bool))
    assert not differences(seen, from_scratch(seen))
    room = [each.free_space("human").levels[0].clearance(np.array([[2.3, 2.3]]))[0][0] for each in (scene, seen)]
    assert room[0] < HUMAN.radius < room[1]
    again = seen.update(remove=np.arange(len(cloud), len(seen.points)))
    assert not differences(again, from_scratch(again))

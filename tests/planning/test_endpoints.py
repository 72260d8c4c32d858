"""Where a start or a goal may be, against distances to the true walls of rooms; what is said, and where it is moved."""

import dataclasses

import numpy as np
import pytest

import gpdf_service as gpdf
from gpdf_service.planning.endpoints import Endpoint, Refusal, connect, find_endpoint, find_ends
from gpdf_service.synthetic import Box, World
from gpdf_service.types import AGENTS, PlanOptions, Status

SPACING = 0.05
SIZE = 8.0, 6.0
BLOCK = (3.5, 2.5), (4.5, 3.5)
CLOSET = (6.0, 4.0)
"""Its lower corner; walls of 0.1 m shut it off, from there to the room's corner."""
HUMAN = AGENTS["human"]


def room_at(xy):
    """Distance to the nearest true wall or side of the block, (n,) [m]."""
    xy = np.atleast_2d(xy)
    walls = np.minimum(xy, np.array(SIZE) - xy).min(axis=1)
    gaps = [np.linalg.norm(np.maximum(np.maximum(low - xy, xy - high), 0.0), axis=1) for low, high in SHUT]
    return np.minimum.reduce([walls, *gaps])


CLOSET_WALLS = ((6.0, 4.0), (6.1, 6.0)), ((6.0, 4.0), (8.0, 4.1))
SHUT = [tuple(map(np.array, one)) for one in (BLOCK, *CLOSET_WALLS)]


@pytest.fixture(scope="module")
def points():
    boxes = tuple(Box((*low, 0.0), (*high, 2.6)) for low, high in (BLOCK, *CLOSET_WALLS))
    return World((*SIZE, 2.6), boxes).sample(SPACING, np.random.default_rng(0))


@pytest.fixture(scope="module")
def space(points):
    return gpdf.build_scene(*points).free_space(HUMAN)


@pytest.fixture(scope="module")
def storeys():
    """Two floors of 5 × 4 m, 3 m apart, that nothing joins; on the upper one stands a block."""
    x, y = (one.ravel() for one in np.meshgrid(np.arange(0, 5.01, SPACING), np.arange(0, 4.01, SPACING)))
    floors = [np.column_stack([x, y, np.full(x.size, z)]) for z in (0.0, 3.0)]
    block = Box((2.0, 1.5, 3.0), (3.0, 2.5, 4.2))
    sides, _ = World((5.0, 4.0, 4.3), (block,), ceiling=False).sample(SPACING, np.random.default_rng(0))
    on_block = ((sides > np.array(block.low) - 0.01) & (sides < np.array(block.high) + 0.01)).all(axis=1)
    ground = np.arange(2 * x.size + on_block.sum()) < 2 * x.size
    return gpdf.build_scene(np.concatenate([*floors, sides[on_block]]), ground).free_space(HUMAN)


def test_a_place_is_valid_exactly_where_the_body_fits_between_the_true_walls(space):
    places = np.random.default_rng(1).uniform((0.05, 0.05), (7.95, 5.95), (300, 2))
    truth, seen = room_at(places), []
    for place, room in zip(places, truth, strict=True):
        found = find_endpoint(space, place, "goal")
        seen.append(isinstance(found, Endpoint))
        if abs(room - HUMAN.radius) > SPACING:
            assert seen[-1] == (room > HUMAN.radius), (place, room)
        if isinstance(found, Endpoint):
            np.testing.assert_array_equal(found.xy, place)
        else:
            assert found.status is Status.GOAL_OCCUPIED
            assert room_at(found.nearest[:2])[0] > HUMAN.radius - 2 * SPACING  # samples round a corner are so far apart
            free = truth[np.linalg.norm(places - place, axis=1) < np.linalg.norm(found.nearest[:2] - place) - SPACING]
            assert not (free > HUMAN.radius + SPACING).any()  # nothing nearer is free
    assert 0.3 < np.mean(seen) < 0.95


def test_how_far_the_nearest_obstacle_is_from_a_place_is_said(space):
    refused = find_endpoint(space, np.array([3.4, 3.0]), "goal")
    assert refused.message.startswith(
        "the human (radius 0.25 m) does not fit at the goal (3.40, 3.00): an obstacle is "
    )
    said = float(refused.message.partition("obstacle is ")[2].partition(" m")[0])
    assert said == pytest.approx(0.1, abs=0.02)
    np.testing.assert_allclose(refused.nearest, (3.25, 3.0, 0.0), atol=SPACING)
    assert "nearest free place is (3." in refused.message


def test_a_radius_is_told_to_the_millimetre_that_it_has(points):
    scene = gpdf.build_scene(*points)
    for agent, radius in (("human", "0.25"), ("roomba", "0.175"), (dataclasses.replace(HUMAN, width=1.0), "0.50")):
        assert f"(radius {radius} m)" in gpdf.plan(scene, (1.0, 1.0), (3.4, 3.0), agent).message


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_the_room_that_noise_asks_for_is_named_where_it_is_what_a_body_does_not_have(points, noise):
    rng = np.random.default_rng(0)
    cloud, ground = points
    scene = gpdf.build_scene(cloud + rng.normal(0.0, noise, cloud.shape), ground)
    space, margin = scene.free_space(HUMAN), 0.5 * scene.noise
    refused = next(
        result
        for x in np.arange(2.9, 3.4, 0.001)
        if (result := gpdf.plan(scene, (1.0, 1.0), (x, 3.0))).status is Status.GOAL_OCCUPIED
    )
    details = refused.details
    assert details["needed"] == pytest.approx(HUMAN.radius + details["noise_margin"]) == space.reach
    assert details["noise_margin"] == pytest.approx(margin)
    said = f"(radius 0.25 m, and {margin:.4f} m for the noise of the scan)" if noise else "(radius 0.25 m)"
    assert said in refused.message
    assert details["room"] < details["needed"] + 1e-4
    assert details["room"] > details["needed"] - 2e-3  # so little is short that it is told to a tenth of a millimetre
    assert f" is {details['room']:.4f} m from its centre" in refused.message


def assert_nearest_clear(space, place, leaf):
    """It is clear from the place to the leaf's centre, and to that of no free leaf that is nearer."""
    tree = space.levels[0].quadtree
    reached = tree.origin + (tree.corner + 0.5 * tree.size[:, None]) * tree.width
    line = place + np.linspace(0.0, 1.0, 200)[:, None] * (reached[leaf] - place)
    assert space.levels[0].clearance(line)[0].min() > space.reach - 0.0021
    gap = np.linalg.norm(reached - place, axis=1) - 0.5 * tree.size * tree.width
    radius = min(space.radius, max(space.reach, space.levels[0].clearance(place[None])[0][0] - 0.002))
    for nearer in reached[tree.free & (gap < gap[leaf] - 1e-9)]:
        line = place + np.linspace(0.0, 1.0, 200)[:, None] * (nearer - place)
        assert space.levels[0].clearance(line)[0].min() < radius + 0.005


def test_the_leaf_to_go_on_from_is_free_and_reached_on_a_clear_line(space):
    tree = space.levels[0].quadtree
    met = 0
    for place in np.random.default_rng(2).uniform((0.3, 0.3), (7.7, 5.7), (2000, 2)):
        if not HUMAN.radius < room_at(place)[0] < 1.5 * HUMAN.radius:
            continue
        found = find_endpoint(space, place, "start")
        if isinstance(found, Refusal):
            continue
        leaf = found.node - space.levels[found.level].offset
        assert tree.free[leaf]
        low = tree.origin + tree.corner[leaf] * tree.width
        if (low <= place).all() and (place <= low + tree.width * tree.size[leaf]).all() and tree.whole[leaf]:
            continue
        met += 1
        assert_nearest_clear(space, place, leaf)
    assert met >= 5  # places beside obstacles, in leaves that are not wholly free


def test_a_way_goes_on_from_a_place_exactly_where_the_body_fits(space):
    tree, met = space.levels[0].quadtree, {True: 0, False: 0}
    rng, places = np.random.default_rng(5), []
    for side in range(4):  # of the block, and as far off as the body needs it
        along, off = rng.uniform(-0.45, 0.45, 200), 0.5 + space.reach + rng.uniform(-0.02, 0.02, 200)
        turned = np.column_stack([along, off] if side % 2 else [off, along])
        places.append(np.mean(BLOCK, axis=0) + (turned if side < 2 else -turned))
    for place in np.concatenate(places):
        leaf, node = tree.find_one(place), connect(space, 0, place)
        if leaf >= 0 and tree.whole[leaf]:
            assert node == leaf + space.levels[0].offset
            continue
        fits = space.levels[0].clearance(place[None])[0][0] - space.reach
        if abs(fits) > 0.0021:  # what the room is told with
            met[bool(fits > 0.0)] += 1
            if fits < 0.0:
                assert node == -1
            else:
                assert_nearest_clear(space, place, node - space.levels[0].offset)
    assert min(met.values()) >= 10


@pytest.mark.parametrize(("name", "outside"), [("start", Status.START_OUTSIDE_MAP), ("goal", Status.GOAL_OUTSIDE_MAP)])
def test_off_the_map_no_ground_is_known(space, name, outside):
    for place in ((-0.6, 3.0), (8.6, 3.0), (4.0, -0.6), (4.0, 6.6), (40.0, 3.0)):
        refused = find_endpoint(space, np.array(place), name)
        assert refused.status is outside
        assert f"no ground is known at the {name}" in refused.message
        np.testing.assert_allclose(refused.nearest[:2], np.clip(place, 0.25, np.array(SIZE) - 0.25), atol=0.1)


def test_within_reach_of_a_wall_from_behind_something_stands_and_further_off_nothing_is_known(points):
    """Floor and walls were seen from inside; a floor goes on 3 m behind the western wall, so the map is there, too."""
    cloud, ground = points
    x, y = (one.ravel() for one in np.meshgrid(np.arange(-4.0, -3.0, SPACING), np.arange(0.0, 6.0, SPACING)))
    beyond = np.column_stack([x, y, np.zeros(x.size)])
    scene = gpdf.build_scene(np.concatenate([cloud, beyond]), np.concatenate([ground, np.ones(x.size, bool)]))
    space = scene.free_space(HUMAN)
    for off, status in ((0.02, Status.GOAL_OCCUPIED), (0.15, Status.GOAL_OUTSIDE_MAP), (0.6, Status.GOAL_OUTSIDE_MAP)):
        assert find_endpoint(space, np.array([-off, 3.0]), "goal").status is status


@pytest.mark.parametrize(("name", "occupied"), [("start", Status.START_OCCUPIED), ("goal", Status.GOAL_OCCUPIED)])
def test_in_a_hole_that_known_ground_surrounds_something_stands_or_nobody_has_seen_it(points, name, occupied):
    cloud, ground = points
    hole = (np.abs(cloud[:, :2] - (1.8, 3.0)) < 1.5).all(axis=1) & ground
    space = gpdf.build_scene(cloud[~hole], ground[~hole]).free_space(HUMAN)
    for place in ((1.8, 3.0), (4.0, 3.0)):  # in the hole; under the block
        refused = find_endpoint(space, np.array(place), name)
        assert refused.status is occupied
    assert (
        "inside something, or on ground that nobody has seen" in find_endpoint(space, np.array((1.8, 3)), name).message
    )


def test_at_the_rim_of_the_known_ground_something_is_in_the_way_and_the_place_is_on_the_map():
    x, y = (one.ravel() for one in np.meshgrid(np.arange(0, 5.01, SPACING), np.arange(0, 4.01, SPACING)))
    space = gpdf.build_scene(np.column_stack([x, y, np.zeros(x.size)])).free_space(HUMAN)
    for place in ((0.01, 2.0), (4.99, 2.0), (2.5, 0.01), (2.5, 3.99)):
        refused = find_endpoint(space, np.array(place), "goal")
        assert refused.status is Status.GOAL_OCCUPIED
        assert "ground that nobody has seen is 0.0" in refused.message


def test_a_place_that_one_storey_surrounds_is_shut_in_though_another_ends_there():
    x, y = (one.ravel() for one in np.meshgrid(np.arange(0, 8.01, SPACING), np.arange(0, 8.01, SPACING)))
    hole = (np.abs(x - 4.0) < 1.5) & (np.abs(y - 4.0) < 1.5)
    bay = (np.abs(x - 4.0) < 1.5) & (y < 5.5)  # open to the map's rim
    upper = np.column_stack([x, y, np.full(x.size, 3.0)])[~hole]
    lower = np.column_stack([x, y, np.zeros(x.size)])[~bay]
    space = gpdf.build_scene(np.concatenate([upper, lower]), np.ones(len(upper) + len(lower), bool)).free_space(HUMAN)
    assert len(space.surfaces) == 2
    refused = find_endpoint(space, np.array([4.0, 4.0]), "goal")
    assert refused.status is Status.GOAL_OCCUPIED
    alone = gpdf.build_scene(lower, np.ones(len(lower), bool)).free_space(HUMAN)
    assert find_endpoint(alone, np.array([4.0, 4.0]), "goal").status is Status.GOAL_OUTSIDE_MAP


def test_a_height_says_which_storey_is_meant_and_half_a_metre_is_the_same_ground(storeys):
    for z in (0.0, 3.0):
        for off in (-0.45, 0.0, 0.45):
            found = find_endpoint(storeys, np.array([1.0, 1.0, z + off]), "goal")
            assert isinstance(found, Endpoint)
            assert storeys.surfaces[found.level].height_at(np.array([[1.0, 1.0]]))[0] == pytest.approx(z, abs=0.01)
        for off in (-0.55, 0.55):
            refused = find_endpoint(storeys, np.array([1.0, 1.0, z + off]), "goal")
            assert refused.status is Status.GOAL_OUTSIDE_MAP
            assert "is at z = 0.00, 3.00 m, not" in refused.message
    asked = find_endpoint(storeys, np.array([1.0, 1.0]), "goal")
    between = find_ends(storeys, np.array([1.0, 1.0, 0.0]), [np.array([1.0, 1.0, 1.5])], PlanOptions(snap=1.0))
    assert between.status is Status.GOAL_OUTSIDE_MAP  # there is no ground to be moved to at that height
    assert (asked.status, asked.nearest) == (Status.AMBIGUOUS_LEVEL, None)
    assert "z = 0.00, 3.00 m under the goal" in asked.message


def test_two_storeys_are_two_wherever_zero_is(points):
    floor = points[0][points[1]]
    both = np.concatenate([floor + np.array([0.0, 0.0, z]) for z in (-1.5, 1.5)])
    space = gpdf.build_scene(both, np.ones(len(both), dtype=bool)).free_space(HUMAN)
    found = find_endpoint(space, np.array([1.5, 1.5]), "start")
    assert found.status is Status.AMBIGUOUS_LEVEL
    assert "-1.50, 1.50" in found.message


def test_a_place_is_moved_as_far_as_allowed_and_the_distance_is_said(space):
    inside = np.array([4.0, 2.7])  # 0.2 m in the block, so 0.45 m from where the human fits
    start, far = np.array([1.0, 1.0]), 0.45
    for snap, moves in ((0.0, False), (far - SPACING, False), (far + SPACING, True)):
        ends = find_ends(space, start, [inside], PlanOptions(snap=snap))
        assert isinstance(ends, Refusal) != moves
        if moves:
            moved = np.linalg.norm(ends.goals[0].xy - inside)
            assert moved == pytest.approx(far, abs=SPACING)
            assert ends.moved.startswith(f"The goal was moved {moved:.2f} m to (")
    both = find_ends(space, inside, [inside, start], PlanOptions(snap=1.0, via=(np.array([4.0, 3.3]), start)))
    assert [word for word in ("start", "via point 1", "goal") if f"The {word} was moved" in both.moved] == [
        "start",
        "via point 1",
        "goal",
    ]
    assert "via point 2" not in both.moved
    np.testing.assert_array_equal(both.goals[1].xy, start)


def test_a_place_that_can_be_moved_to_no_place_that_the_start_can_go_to_is_refused_in_words(space):
    start, wall = np.array([1.0, 1.0]), np.array([6.2, 5.0])  # in the closet, too near its wall: free 0.15 m further
    far = 6.2 - (6.0 - 0.25)  # and before the closet
    refused = find_ends(space, start, [wall], PlanOptions(snap=far - SPACING))
    assert "it is free, but not reachable from the start. The nearest that is, (5." in refused.message
    said = float(refused.message.rpartition("is ")[2].partition(" m away")[0])
    assert said == pytest.approx(far, abs=SPACING)
    assert "reachable" not in find_ends(space, start, [wall], PlanOptions(snap=0.05)).message  # nothing is that near
    moved = find_ends(space, start, [wall], PlanOptions(snap=far + SPACING))
    assert room_at(moved.goals[0].xy)[0] > 0.2
    assert moved.goals[0].xy[0] < 6.0


def test_on_a_storey_that_the_start_cannot_go_to_nothing_is_reachable(storeys):
    start, in_block = np.array([1.0, 1.0, 0.0]), np.array([2.1, 2.0, 3.0])
    refused = find_ends(storeys, start, [in_block], PlanOptions(snap=1.0))
    assert refused.status is Status.GOAL_OCCUPIED
    assert refused.message.endswith("it is free, but not reachable from the start. Nothing is.")


def test_a_place_with_a_height_is_moved_on_its_own_storey(storeys):
    start, in_block = np.array([1.0, 1.0, 3.0]), np.array([2.1, 2.0, 3.0])
    ends = find_ends(storeys, start, [in_block], PlanOptions(snap=1.0))
    far = 0.1 + HUMAN.radius  # out of the block, and clear of it
    assert np.linalg.norm(ends.goals[0].xy - in_block[:2]) == pytest.approx(far, abs=SPACING)
    assert ends.goals[0].level == ends.start.level
    assert ends.moved.endswith("3.00).")
    refused = find_ends(storeys, start, [in_block], PlanOptions(snap=far - SPACING))
    assert refused.status is Status.GOAL_OCCUPIED
    assert refused.nearest[2] == pytest.approx(3.0, abs=0.01)


def test_one_goal_of_several_must_be_valid_and_the_first_refusal_is_told(space):
    start, good, bad = np.array([1.0, 1.0]), np.array([2.0, 5.0]), np.array([4.0, 3.0])
    ends = find_ends(space, start, [bad, good], PlanOptions())
    assert ends.goals[0] is None
    np.testing.assert_array_equal(ends.goals[1].xy, good)
    refused = find_ends(space, start, [bad, np.array([50.0, 50.0])], PlanOptions())
    assert (refused.status, "goal (4.00, 3.00)" in refused.message) == (Status.GOAL_OCCUPIED, True)
    assert find_ends(space, bad, [good], PlanOptions()).status is Status.START_OCCUPIED


def test_a_long_body_fits_where_its_discs_do_in_some_direction(points):
    long = dataclasses.replace(AGENTS["human"], name="cart", width=0.4, length=1.4, discs=5)
    space = gpdf.build_scene(*points).free_space(long)
    headings = np.linspace(0.0, np.pi, 360, endpoint=False)
    way = np.column_stack([np.cos(headings), np.sin(headings)])
    seen = []
    for place in np.random.default_rng(3).uniform((0.25, 0.25), (7.75, 5.75), (400, 2)):
        discs = place + long.offsets[:, None, None] * way
        best = room_at(discs.reshape(-1, 2)).reshape(len(long.offsets), -1).min(axis=0).max()
        if abs(best - long.disc_radius) < SPACING:
            continue
        found = find_endpoint(space, place, "goal")
        seen.append(isinstance(found, Endpoint))
        assert seen[-1] == (best > long.disc_radius), (place, best)
        if not seen[-1] and room_at(place)[0] > long.disc_radius + SPACING:
            assert "in no direction" in found.message
    assert 0.3 < np.mean(seen) < 0.98

"""Each thing that a certificate refuses, alone: nothing else in the way would refuse it, too."""

import dataclasses
from itertools import pairwise

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

import gpdf_service as gpdf
from gpdf_service.fields.tree import build_tree
from gpdf_service.planning.certificate import _coarsest_spacing, certify
from gpdf_service.planning.shape import stand_on
from gpdf_service.search.places import Places
from gpdf_service.synthetic import Box, World
from gpdf_service.tiles.surface import INFERRED, OBSERVED, UNKNOWN, Cells, count_cells
from gpdf_service.types import AGENTS

FAR = np.array([[100.0, 100.0]])
"""[m] The only obstacle there is, so that room is nowhere the reason."""


def ramp(xy):
    return np.clip(xy[:, 0] - 2.0, 0.0, 2.0) * np.tan(np.radians(20.0))


def scene_of(points, ground):
    return gpdf.build_scene(points, ground)


@pytest.fixture(scope="module")
def scenes():
    rng = np.random.default_rng(0)
    step = World((6.0, 3.0, 2.6), (Box((3.0, 0.0, 0.0), (6.0, 3.0, 0.3), walkable=True),))
    pit = World((6.0, 3.0, 2.6), ())
    made = {name: world.sample(0.05, rng) for name, world in (("step", step), ("pit", pit))}
    made["slope"] = World((6.0, 3.0, 2.6), (), ramp).sample(0.05, rng)
    points, ground = made["pit"]
    gone = (points[:, 0] > 2.5) & (points[:, 0] < 5.0) & (points[:, 1] > 1.5) & (points[:, 2] < 0.1)
    made["corner"] = points[~gone], ground[~gone]
    seen = ~((points[:, 0] > 2.5) & (points[:, 0] < 5.0) & (points[:, 2] < 0.1))
    made["pit"] = points[seen], ground[seen]
    return {name: scene_of(*cloud) for name, cloud in made.items()}


def with_places(space, places):
    """The space with other obstacle places, one tree a level."""
    levels = (dataclasses.replace(own, places=one) for own, one in zip(space.levels, places, strict=True))
    return dataclasses.replace(space, levels=tuple(levels))


def stand_up(space, xy):
    """Contact points and tops on the only level."""
    own = space.levels[0]
    return stand_on(xy, own.surface.arrays, own.surface.ends, own.ground_field.arrays, space.agent.height)


def certificate_of(scene, agent, begin=1.0, end=4.5):
    """Of the straight way along x, whatever stands there."""
    space = scene.free_space(agent)
    space = with_places(space, [Places(build_tree(FAR)) for _ in space.levels])
    xy = np.column_stack([np.arange(begin, end, 0.05), np.full(len(np.arange(begin, end, 0.05)), 1.5)])
    ground, top = stand_up(space, xy)
    contact = np.column_stack([xy, np.nan_to_num(ground[:, 2])])
    return certify(space, np.where(np.isfinite(top), top, contact), contact, np.zeros(len(xy), dtype=np.int64))


@pytest.mark.parametrize(
    ("name", "agent", "reason"),
    [
        ("pit", "human", "leaves the known ground"),
        ("step", "roomba", "a step of 0.30 m is higher than the roomba takes"),
        ("slope", dataclasses.replace(AGENTS["human"], max_slope=0.2), "is steeper than the human stands on"),
    ],
)
def test_ground_is_refused_by_itself(scenes, name, agent, reason):
    found = certificate_of(scenes[name], agent)
    assert found.min_clearance > 10.0
    assert not found.holds
    assert reason in found.reason


@pytest.mark.parametrize(("name", "agent"), [("step", "human"), ("slope", "human"), ("slope", "spot")])
def test_ground_that_the_body_takes_is_not_refused(scenes, name, agent):
    found = certificate_of(scenes[name], agent)
    assert (found.holds, found.reason) == (True, "")


def test_the_tightest_place_has_the_height_of_the_way_there(scenes):
    """A point beside the way, at its foot, half up a ramp and at its head."""
    space = scenes["slope"].free_space("human")
    xy = np.column_stack([np.arange(1.0, 5.0, 0.05), np.full(80, 1.5)])
    ground, top = stand_up(space, xy)
    for x in (1.5, 3.0, 4.5):
        trees = (Places(build_tree(np.array([[x, 2.0]]))),)
        found = certify(with_places(space, trees), top, ground, np.zeros(len(xy), dtype=np.int64))
        assert found.min_clearance_at[0] == pytest.approx(x, abs=0.06)
        assert found.min_clearance_at[2] == pytest.approx(float(ramp(np.array([[x, 1.5]]))[0]), abs=0.05)


def test_the_limits_are_the_bodys_own(scenes):
    """The same step and slope, a little over and a little under what the body takes."""
    for scene, measure in ((scenes["step"], "max_step"), (scenes["slope"], "max_slope")):
        value = getattr(certificate_of(scene, "human"), measure)
        for change, holds in ((1.01, True), (0.99, False)):
            body = dataclasses.replace(AGENTS["human"], name="own", **{measure: change * value})
            assert certificate_of(scene, body).holds == holds


def test_every_disc_stands_on_known_ground(scenes):
    """The centre stops before the hole; the front of a long body hangs over it."""
    long = dataclasses.replace(AGENTS["spot"], discs=6)
    ends = 2.5 - 0.25
    assert certificate_of(scenes["pit"], dataclasses.replace(long, discs=1), end=ends).holds
    found = certificate_of(scenes["pit"], long, end=ends)
    assert (found.holds, found.reason) == (False, "the path leaves the known ground")
    assert certificate_of(scenes["pit"], long, end=2.5 - 0.7).holds


@pytest.mark.parametrize(("turn", "holds"), [(np.pi / 4, False), (-np.pi / 4, True)])
def test_a_disc_is_where_the_body_faces(scenes, turn, holds):
    """Before the corner of a hole: facing it a disc is over the hole, facing along its side none is."""
    space = scenes["corner"].free_space(dataclasses.replace(AGENTS["spot"], discs=6))
    space = with_places(space, [Places(build_tree(FAR)) for _ in space.levels])
    ground = np.column_stack([np.array([(2.39, 1.39), (2.4, 1.4)]), np.zeros(2)])
    top = ground + np.array([0.0, 0.0, space.agent.height])
    found = certify(space, top, ground, np.zeros(2, dtype=np.int64), np.full(2, turn))
    assert (found.holds, found.reason) == (holds, "" if holds else "the path leaves the known ground")


def _spacing(path, radius, ground):
    return _coarsest_spacing(path, radius, ground, count_cells(ground.state == INFERRED))


@pytest.mark.parametrize("seed", range(6))
def test_the_coarsest_spacing_is_that_of_the_inferred_cell_near_the_path_that_is_farthest_from_a_seen_one(seed):
    rng, width, radius, origin = np.random.default_rng(seed), 0.1, 0.1 * seed, np.array([1.0, -2.0])
    kinds = np.array([INFERRED, OBSERVED, UNKNOWN], np.uint8)
    state = rng.choice(kinds, (24, 31), p=[0.85, 0.05, 0.1])
    path = np.column_stack([origin + width * rng.uniform(1.0, 23.0, (3, 2)), np.zeros(3)])
    if seed == 0:  # along the map's edge, and nothing near the path was seen
        state[:], state[0, 0], path[:, 0] = INFERRED, OBSERVED, origin[0] + 0.5 * width
    x, y = np.indices(state.shape)
    near = np.zeros(state.shape, dtype=bool)
    for a, b in pairwise(path):
        count = max(1, int(np.ceil(2.0 * np.hypot(*(b - a)[:2]) / width)))
        for share in np.linspace(0.0, 1.0, count + 1):
            u, v = np.floor((a + share * (b - a) - [*origin, 0.0])[:2] / width)
            near |= (x - u) ** 2 + (y - v) ** 2 <= int(radius / width) ** 2
    farthest = distance_transform_edt(state != OBSERVED)[near & (state == INFERRED)].max(initial=0.0)
    ground = Cells(np.zeros(state.shape, np.float32), state, origin, width)
    assert _spacing(path, radius, ground) == pytest.approx((1.0 + 2.0 * farthest) * width)


@pytest.mark.parametrize("shape", [(3, 40), (40, 3)])
def test_the_nearest_seen_cell_may_be_further_off_than_the_map_is_wide(shape):
    state, width, origin = np.full(shape, INFERRED, np.uint8), 0.1, np.array([1.0, -2.0])
    path = np.broadcast_to([*(origin + width * (np.array(shape) - 0.5)), 0.0], (2, 3)).copy()
    ground = Cells(np.zeros(shape, np.float32), state, origin, width)
    assert _spacing(path, 0.0, ground) == np.inf
    state[0, 0] = OBSERVED
    away = np.hypot(shape[0] - 1, shape[1] - 1)
    assert _spacing(path, 0.0, ground) == pytest.approx((1.0 + 2.0 * away) * width)


@pytest.mark.parametrize("corner", [0, 29])
def test_ground_beside_each_piece_of_the_way_is_looked_at(corner):
    """A way round a corner at which two cells are inferred, by itself and with pieces before or after it."""
    state, width, origin = np.full((30, 30), OBSERVED, np.uint8), 0.1, np.zeros(2)
    state[corner, 0] = INFERRED
    ground = Cells(np.zeros(state.shape, np.float32), state, origin, width)
    places = np.array([(29 - corner, 0), (corner, 0), (corner, 29), (29 - corner, 29)])
    path = np.column_stack([(places + 0.5) * width, np.zeros(4)])
    for part, near in ((path[:3], True), (path[1:], True), (path[:2], True), (path[2:], False)):
        assert _spacing(part, 0.1, ground) == pytest.approx(3.0 * width if near else width)


@pytest.mark.parametrize("away", [(-2.0, 0.0), (5.0, 0.0), (0.0, -2.0), (0.0, 5.0)])
def test_a_way_that_lies_beside_the_map_on_any_side_looks_at_none_of_its_cells(away):
    ground = Cells(np.zeros((40, 30), np.float32), np.full((40, 30), INFERRED, np.uint8), np.zeros(2), 0.1)
    path = np.array([(1.0, 1.0, 0.0), (1.5, 1.2, 0.0)]) + np.array([*away, 0.0])
    assert _spacing(path, 0.3, ground) == ground.width


def test_what_of_a_way_lies_beside_the_map_looks_at_none_of_its_cells():
    state, width = np.full((9, 9), OBSERVED, np.uint8), 0.1
    state[0, 0] = INFERRED  # further from the way than the radius
    path = np.array([(0.25, 0.85, 0.0), (0.85, 0.85, 0.0), (0.85, 0.25, 0.0), (1.2, 0.25, 0.0)])
    assert _spacing(path, 0.2, Cells(np.zeros((9, 9), np.float32), state, np.zeros(2), width)) == width


def test_beside_a_step_the_height_of_the_top_is_told_by_the_nearest_ground_or_by_the_contact(scenes):
    """Over its edge the top keeps its distance from the nearest ground, and is off its height over the contact."""
    space = scenes["step"].free_space("human")
    xy = np.column_stack([np.arange(1.0, 4.5, 0.05), np.full(70, 1.5)])
    ground, top = stand_up(space, xy)
    level = np.zeros(len(xy), dtype=np.int64)
    path = dataclasses.make_dataclass("Path", ["ground", "positions"])(ground, top)
    off = looked_at_closely(space, path, level)[1]
    assert certify(space, top, ground, level).max_height_deviation == pytest.approx(off.max(), abs=0.003)
    assert np.abs(top[:, 2] - ground[:, 2] - space.agent.height).max() > off.max() + 0.02


@pytest.fixture(scope="module")
def storeys():
    """A scene of two storeys, and a way up its stair with its levels, as a plan goes it."""
    rise, tread, treads = 0.175, 0.28, 16
    steps = [
        Box((1.0 + i * tread, 0.0, 0.0), (1.0 + (i + 1) * tread, 1.2, (i + 1) * rise), walkable=True)
        for i in range(treads - 1)
    ]
    head, high = 1.0 + (treads - 1) * tread, treads * rise
    slabs = [((0.0, 1.2), (7.0, 4.0)), ((head, 0.0), (7.0, 1.2))]
    floors = [Box((*low, high - 0.2), (*up, high), walkable=True) for low, up in slabs]
    world = World((7.0, 4.0, 2 * high), (*steps, *floors), ceiling=False)
    scene = gpdf.build_scene(*world.sample(0.06, np.random.default_rng(0)))
    path = gpdf.plan(scene, (3.0, 3.0, 0.0), (3.0, 3.0, high)).trajectory
    space = scene.free_space("human")
    level = level_at(space, path.ground)
    assert len(set(level.tolist())) > 1
    return scene, space, path, level


def level_at(space, ground):
    """The level of each place (n, 3) of a way: of those whose ground is under it the one with the most room."""
    off = np.array([np.abs(surface.height_at(ground[:, :2]) - ground[:, 2]) for surface in space.surfaces])
    off = np.where(np.isnan(off), np.inf, off)
    room = np.array([space.levels[k].clearance(ground[:, :2])[0] for k in range(len(space.levels))])
    return np.where(off < 0.01, room, -off).argmax(axis=0)


def looked_at_closely(space, path, level, count=40):
    """Room, height, steps and slopes of a way, at `count` places between two waypoints, each part by its own level."""
    room, off, step, slope = [], [], [], []
    for i, (a, b) in enumerate(pairwise(range(len(level)))):
        on = level[b]
        share = np.linspace(0.0, 1.0, count)[:, None]
        at = path.ground[a] + share * (path.ground[b] - path.ground[a])
        top = path.positions[a] + share * (path.positions[b] - path.positions[a])
        room.append((space.levels[on].clearance(at[:, :2])[0].min() - space.reach, i))
        field = np.abs(space.levels[on].ground_field.query(top).distance - space.agent.height)
        off.append(np.minimum(np.abs(top[:, 2] - at[:, 2] - space.agent.height), field).max())
        ix, iy, inside = space.levels[on].surface.cells(at[:, :2])
        assert inside.all()
        step.append(space.levels[on].steps[ix, iy].max())
        slope.append(space.levels[on].slopes[ix, iy].max())
    return room, np.array(off), max(step), max(slope)


def test_a_certificate_says_of_a_way_over_storeys_what_a_close_look_at_each_part_finds(storeys):
    _, space, path, level = storeys
    found = certify(space, path.positions, path.ground, level)
    room, off, step, slope = looked_at_closely(space, path, level)
    least, where = min(room)
    assert least - 0.0021 <= found.min_clearance <= least + 1e-4
    near = space.levels[level[where + 1]].clearance(found.min_clearance_at[None, :2])[0][0] - space.reach
    assert near == pytest.approx(least, abs=0.003)
    assert found.min_clearance_at[2] == pytest.approx(
        path.ground[:, 2][np.linalg.norm(path.ground[:, :2] - found.min_clearance_at[:2], axis=1).argmin()]
    )
    assert found.max_height_deviation == pytest.approx(off.max(), abs=0.003)
    worst = off[np.linalg.norm(path.ground[:-1] - found.max_height_deviation_at, axis=1).argsort()[:4]].max()
    assert worst == pytest.approx(off.max(), abs=0.003)
    assert (found.max_step, found.max_slope) == pytest.approx((step, slope), abs=1e-6)
    assert found.ground_spacing >= max(surface.cell_width for surface in space.surfaces) - 1e-9
    assert (found.holds, found.reason) == (True, "")


def test_each_part_of_a_way_is_held_to_its_own_storeys_obstacles_and_the_worst_is_told(storeys):
    """One point beside the way, on one storey alone: it counts where the way is on that storey, and only there."""
    _, space, path, level = storeys
    clear = certify(space, path.positions, path.ground, level).min_clearance
    for on in sorted(set(level.tolist())):
        own = np.flatnonzero(level == on)
        middle = path.ground[own[len(own) // 2], :2]
        for gap in (0.02, -0.02):
            point = middle + (space.reach + gap) * np.array([0.0, 1.0])
            trees = [own.places for own in space.levels]
            trees[on] = trees[on]._replace(moving=build_tree(point[None]))
            found = certify(with_places(space, trees), path.positions, path.ground, level)
            line = np.concatenate([np.linspace(path.ground[k - 1, :2], path.ground[k, :2], 50) for k in own if k])
            exact = min(clear, np.linalg.norm(line - point, axis=1).min() - space.reach)
            assert found.min_clearance == pytest.approx(exact, abs=0.0021)
            assert ("too little room" in found.reason, not found.holds) == (exact < 0.0, exact < 0.0)

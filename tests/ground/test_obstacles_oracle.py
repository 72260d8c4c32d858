"""What stops a body, point by point as the docstrings say it, on random ground with random things over it."""

import dataclasses
from itertools import product

import numpy as np
import pytest

from gpdf_service.ground import footing
from gpdf_service.ground.footing import by_treads, footholds, footing_reach, is_tread, on_treads, rings_of
from gpdf_service.ground.level import GroundLevel
from gpdf_service.ground.limits import ObstacleKind
from gpdf_service.ground.obstacles import Scan, obstacles_felt, obstacles_of, obstacles_reach, voxel_pitch
from gpdf_service.tiles.boxes import widened
from gpdf_service.tiles.points import points_of
from gpdf_service.tiles.surface import INFERRED, OBSERVED, UNKNOWN, HeightMap, cropped
from gpdf_service.types import AGENTS

LEAST_OBSTACLE, HEADROOM_SHARE, SURELY, RESOLVED = 0.015, 0.01, 2.0, 3.0
SOLE, STRIDE, FACE, ROUGH = 0.12, 0.4, 0.1, 0.075
"""What is promised, written down once more."""
BODIES = (
    AGENTS["roomba"],
    AGENTS["human"],
    dataclasses.replace(AGENTS["spot"], discs=6),
    dataclasses.replace(AGENTS["human"], name="child", height=1.1, width=0.36, length=0.36, max_step=0.05),
    dataclasses.replace(AGENTS["human"], name="slim", height=1.5, width=0.3, length=0.3),
)


def ground(kind, shape, width, rng):
    """Heights with unknown cells, some of the others inferred."""
    x, y = (np.indices(shape) + 0.5) * width
    height = {
        "floor": np.zeros(shape),
        "step": np.where(x > x.mean(), rng.choice([0.05, 0.2, 0.5]), 0.0),
        "stair": 0.18 * np.floor(x / max(0.26, width)),
        "ramp": 0.2 * y,
    }[kind]
    height = height + rng.normal(0.0, rng.choice([0.0, 0.008]), shape)
    state = rng.choice(np.array([UNKNOWN, OBSERVED, INFERRED], np.uint8), shape, p=[0.08, 0.77, 0.15])
    i, j = rng.integers(0, np.array(shape) - 4)
    state[i : i + 4, j : j + 4] = UNKNOWN  # over its middle nothing is known of the ground beside
    return HeightMap(rng.uniform(-1.0, 1.0, 2), width, np.where(state, height, np.nan).astype(np.float32), state)


def level_of(surface, rng, count):
    """The ground with points over it, some beside it, and limits that some bodies take."""
    shape, width = surface.state.shape, surface.cell_width
    xy = surface.origin + rng.uniform(-0.05, 1.05, (count, 2)) * np.array(shape) * width
    ix, iy, _ = surface.cells(xy)
    high = np.nan_to_num(surface.height[ix, iy].astype(float))
    low, any_, over_head = rng.uniform(-0.05, 0.3, count), rng.uniform(0.0, 2.6, count), rng.uniform(1.0, 2.3, count)
    over = np.choose(rng.choice(3, count, p=[0.5, 0.25, 0.25]), [low, any_, over_head])
    ledge = np.where(rng.random(count) < 0.5, np.inf, high + rng.uniform(0.0, 0.5, count)).astype(np.float32)
    measured = tuple(rng.choice([0.0, 0.011, 0.04, 0.1, 0.3, 0.6, 1.0], shape) for _ in range(2))
    edges = rng.random(shape) < 0.5, np.zeros(shape, dtype=bool)
    return GroundLevel(surface, np.column_stack([xy, high + over]), ledge, measured, edges)


def near_cells(surface, i, j, rings):
    for u, v in product(range(i - rings, i + rings + 1), range(j - rings, j + rings + 1)):
        if 0 <= u < surface.state.shape[0] and 0 <= v < surface.state.shape[1] and surface.state[u, v] != UNKNOWN:
            yield u, v, float(surface.height[u, v])


def is_face(level, row, cell, body, scan):
    """Whether a point is the ground's scatter, or the face of a step that the body takes."""
    surface, z, noise = level.surface, level.other_points[row, 2], scan.noise
    ledge, step = float(level.ledge[row]), max(LEAST_OBSTACLE, noise)
    rings = max(1, int(np.ceil(RESOLVED * noise / surface.cell_width)))
    around = [h for _, _, h in near_cells(surface, *cell, rings)]
    beside = list(near_cells(surface, *cell, 1))
    for u, v, height in beside:
        own = surface.cell_width <= FACE or (u, v) == cell
        shadow = surface.state[u, v] == INFERRED and own and z - noise <= height
        voxel = scan.voxels and abs(z - height) <= LEAST_OBSTACLE
        if (shadow or voxel) and min(around) + step <= height < ledge:
            ledge = height
    foot = max((h for h in around if h <= ledge - step), default=-np.inf)
    wide = around and max(around) - min(around) > step
    scatter = step if wide else LEAST_OBSTACLE - SURELY * noise
    if ledge <= foot + body.max_step or (beside and z <= min(h for _, _, h in beside) + scatter):
        return True
    flat = np.array([cell[0] * surface.state.shape[1] + cell[1]])
    return body.max_step > ROUGH and bool(on_treads(np.array([z]), flat, surface, body.max_step)[0])


def is_met_over_head(level, row, stands, body, tall):
    """Whether a body that stands anywhere meets the point: its rim is past it, and its foot on the same tread."""
    surface, width, radius = level.surface, level.surface.cell_width, body.cylinder.radius
    place, z = (level.other_points[row, :2] - surface.origin) / width, level.other_points[row, 2]
    height, stride = surface.height, max(1, int(STRIDE / width))
    for i, j in np.argwhere(stands):
        edge = np.clip(place, [i, j], [i + 1.0, j + 1.0])
        near, far = np.linalg.norm(place - edge) * width, np.linalg.norm(place - [i + 0.5, j + 0.5]) * width
        if height[i, j] + tall <= z or near >= radius:
            continue
        if near > 0.0 and far > radius - SOLE:
            u, v = (edge + min(SOLE / near, 1.0) * (place - edge)).astype(int)
            foot = height[u, v]
            if height[i, j] - body.max_step <= foot <= z - tall and is_tread(height, int(i), int(j), stride):
                continue
        return True
    return False


def met(level, body, scan):
    """Which of the points stop the body."""
    surface, width = level.surface, level.surface.cell_width
    radius = body.cylinder.radius + width
    least = max(LEAST_OBSTACLE, SURELY * scan.noise)
    tall = max((1.0 - HEADROOM_SHARE) * body.height + scan.noise, max(scan.hidden, LEAST_OBSTACLE + width) + width)
    always, asked = set(), []
    for row, point in enumerate(level.other_points):
        cell = tuple(np.floor((point[:2] - surface.origin) / width).astype(int).tolist())
        if not all(0 <= c < n for c, n in zip(cell, surface.state.shape, strict=True)):
            continue
        reach = int(np.ceil(radius / width))
        disc = [
            h for u, v, h in near_cells(surface, *cell, reach) if np.hypot(u - cell[0], v - cell[1]) * width <= radius
        ]
        if not disc or not min(disc) - least <= point[2] < max(disc) + tall or is_face(level, row, cell, body, scan):
            continue
        if point[2] < min(disc) + tall:
            always.add((row, cell))
        else:
            asked.append(row)
    stands = surface.state != UNKNOWN
    for i, j in np.argwhere(stands):
        away = min((np.hypot(i - u, j - v) for _, (u, v) in always), default=np.inf)
        stands[i, j] = (away + np.sqrt(2.0)) * width >= body.disc_radius
    over = {row for row in asked if is_met_over_head(level, row, stands, body, tall)}
    return sorted({row for row, _ in always} | over)


@pytest.mark.parametrize("body", BODIES, ids=lambda body: body.name)
@pytest.mark.parametrize("kind", ["floor", "step", "stair", "ramp"])
@pytest.mark.parametrize("seed", range(6))
def test_what_stops_a_body_is_what_each_point_says_by_itself(kind, body, seed):
    rng = np.random.default_rng([seed, len(kind), int(100 * body.height)])
    width = rng.choice([0.05, 0.1, 0.15])
    surface = ground(kind, (int(1.6 / width), int(1.3 / width)), width, rng)
    level = level_of(surface, rng, 160)
    scan = Scan(rng.choice([0.0, 0.006, 0.03]), rng.choice([0.0, 0.02, 0.3]), bool(rng.random() < 0.3))
    found, expected = obstacles_of(level, body, scan), met(level, body, scan)
    most = {ObstacleKind.STEP: body.max_step, ObstacleKind.SLOPE: body.max_slope, ObstacleKind.UNKNOWN: -np.inf}
    stops = [value > most[kind] for kind, value in zip(level.limits.kind, level.limits.value, strict=True)]
    assert sum(stops) > 0
    np.testing.assert_array_equal(
        found.points, np.concatenate([level.other_points[expected], level.limits.points[stops]])
    )
    assert found.kind.tolist() == [0] * len(expected) + level.limits.kind[stops].tolist()
    assert found.kind.dtype == np.uint8


@pytest.mark.parametrize("body", BODIES, ids=lambda body: body.name)
@pytest.mark.parametrize("kind", ["step", "stair", "ramp"])
def test_obstacles_in_a_region_are_told_by_what_is_in_their_reach(kind, body):
    rng, shape, scan = np.random.default_rng(5), (150, 140), Scan(0.0, 0.02, False)
    surface = ground(kind, shape, 0.06, rng)
    whole = level_of(surface, rng, 60_000)
    region = np.zeros(shape, dtype=bool)
    region[60:90, 60:80] = True
    reach, shut = obstacles_reach(surface, body)
    near = widened(region, shut)
    ix, iy, inside = surface.cells(whole.other_points)
    rows = np.flatnonzero(near[ix, iy] & inside)
    box = tuple(slice(max(a - reach, 0), b + reach) for a, b in ((60, 90), (60, 80)))
    points, ledge = whole.other_points[rows], whole.ledge[rows]
    part = dataclasses.replace(whole, surface=cropped(surface, box), other_points=points, ledge=ledge)

    def here(level):
        found = obstacles_of(level, body, scan)
        places = found.points[found.kind == ObstacleKind.MATERIAL]
        ix, iy, inside = surface.cells(places)
        return places[region[ix, iy] & inside]

    np.testing.assert_array_equal(here(part), here(whole))
    assert len(here(whole)) > 10
    assert part.surface.state.size < surface.state.size


@pytest.mark.parametrize("body", BODIES, ids=lambda body: body.name)
@pytest.mark.parametrize("kind", ["floor", "step", "stair", "ramp"])
def test_other_ground_makes_obstacles_others_only_where_they_are_felt(kind, body):
    rng, shape, scan = np.random.default_rng(6), (150, 140), Scan(0.0, 0.02, False)
    was, touched = ground(kind, shape, 0.06, rng), np.zeros(shape, dtype=bool)
    level, count = level_of(was, rng, 60_000), 0
    touched[70:74, 70:73] = True
    for rise in (-0.3, 0.08, 0.3):
        now = dataclasses.replace(was, height=np.where(touched, was.height + np.float32(rise), was.height))
        both = [obstacles_of(dataclasses.replace(level, surface=each), body, scan) for each in (was, now)]
        told = [set(map(tuple, found.points[found.kind == ObstacleKind.MATERIAL])) for found in both]
        felt = obstacles_felt(touched, was, now, body)
        others = np.array(sorted(told[0] ^ told[1])).reshape(-1, 3)
        ix, iy, _ = was.cells(others)
        assert felt[ix, iy].all()
        count += len(others)
    assert count > 0
    assert not felt.all()


@pytest.mark.parametrize("kind", ["step", "stair", "ramp"])
def test_other_ground_tells_of_treads_and_footholds_only_around_what_is_uneven(kind):
    rng, shape, step, beyond = np.random.default_rng(7), (150, 140), AGENTS["human"].max_step, 0
    was, cell = ground(kind, shape, 0.06, rng), np.arange(shape[0] * shape[1])
    for place in range(20, 120, 9):
        touched = np.zeros(shape, dtype=bool)
        touched[place : place + 12, 60:64] = True
        now = dataclasses.replace(was, height=np.where(touched, was.height - np.float32(0.35), was.height))
        z, reach = was.height.ravel() + rng.uniform(0.0, 0.2, len(cell)), footing_reach(was)
        treads = np.not_equal(*(footing.on_treads(z, cell, each, step) for each in (was, now))).reshape(shape)
        rests = np.not_equal(*(footholds(each, step) for each in (was, now)))
        assert by_treads(touched, reach + rings_of(SOLE, 0.06) + 1, (was, now), 1)[treads & ~touched].all()
        assert by_treads(touched, reach, (was, now), 2)[rests & ~touched].all()
        beyond += np.count_nonzero((treads | rests) & ~widened(touched, 2))
    assert beyond > 0


TRUCK = dataclasses.replace(AGENTS["human"], name="truck", width=2.5, length=2.5)


@pytest.mark.parametrize("width", [0.0625, 0.125])
@pytest.mark.parametrize("body", [*BODIES[1:], TRUCK], ids=lambda body: body.name)
def test_what_shuts_the_ground_off_is_in_reach_of_what_is_over_it(body, width):
    """Over a floor hangs what only who stands on a platform meets; a thing behind it shuts that off.

    It does not where it is over the head of who stands in a pit further on.
    """
    scan, rings = Scan(0.0, 0.0, False), int(np.ceil(body.cylinder.radius / width))
    pit_at = int((body.cylinder.radius + width) / width)
    shape, (x, y) = (240, 61), (100, 30)
    tall = max((1.0 - HEADROOM_SHARE) * body.height, LEAST_OBSTACLE + 2.0 * width)
    flat, nowhere = np.zeros(shape), np.zeros(shape, dtype=bool)  # only material is asked about
    over, told = width * np.array([x + 0.999, y + 0.5]), set()
    reach, shut = obstacles_reach(HeightMap(np.zeros(2), width, np.zeros(shape, np.float32), np.zeros(shape)), body)
    box = tuple(slice(max(at - reach, 0), at + reach + 1) for at in (x, y))
    for away, pit in product(range(int(body.disc_radius / width) + 2), [False, True]):
        behind = x + rings + away
        points = np.column_stack([[over, width * np.array([behind + 0.5, y + 0.5])], [1.2 * tall, 0.7 * tall]])
        height = np.zeros(shape, np.float32)
        height[x + rings, y], height[behind + pit_at, y] = 0.5 * tall, -0.5 * tall if pit else 0.0
        surface = HeightMap(np.zeros(2), width, height, np.full(shape, OBSERVED, np.uint8))
        whole = GroundLevel(surface, points, np.full(2, np.inf, np.float32), (flat, flat), (nowhere, nowhere))
        rows = [0, 1] if rings + away <= shut else [0]
        part = dataclasses.replace(
            whole,
            surface=cropped(surface, box),
            other_points=points[rows],
            ledge=whole.ledge[rows],
            measured=(flat[box], flat[box]),
            edges=(nowhere[box], nowhere[box]),
        )
        met_in = [bool((obstacles_of(one, body, scan).points == points[0]).all(axis=1).any()) for one in (whole, part)]
        assert met_in == [pit or (away + np.sqrt(2.0)) * width >= body.disc_radius] * 2
        told.add(met_in[0])
    assert told == ({True, False} if body.disc_radius > np.sqrt(2.0) * width else {True})


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("down", [False, True])
def test_a_lintel_before_a_ledge_on_a_flight_stops_who_has_no_room_behind_its_nose(turned, down):
    """Of the upper tread 10 × 25 cm were seen: all of it is nearer to the lintel than the body's radius less a sole."""
    human, width = AGENTS["human"], 0.05
    height = np.tile(np.repeat([0.0, 0.2, np.nan, 0.4], [10, 2, 5, 10])[:, None], (1, 30)).astype(np.float32)
    height[10:12, [*range(10), *range(15, 30)]] = np.nan
    z = (1.0 - HEADROOM_SHARE) * human.height + 0.09  # over who stands below, and not over who stands above
    x, y = np.meshgrid([0.5 - 0.08, 0.5 - 0.01], [0.61, 0.625, 0.64])
    points = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, z)])
    if down:
        height, points[:, 0] = height[::-1], width * len(height) - points[:, 0]
    if turned:
        height, points = height.T, points[:, [1, 0, 2]]
    surface = HeightMap(np.zeros(2), width, height, np.where(np.isnan(height), UNKNOWN, OBSERVED).astype(np.uint8))
    measured, guarded = (np.zeros(height.shape), np.zeros(height.shape)), np.ones(height.shape, dtype=bool)
    level = GroundLevel(surface, points, np.full(len(points), np.inf, np.float32), measured, (guarded, ~guarded))
    scan = Scan(0.0, 0.0, False)
    assert met(level, human, scan) == list(range(len(points)))
    np.testing.assert_array_equal(obstacles_of(level, human, scan).points, points)


def at_voxels(z):
    return voxel_pitch(points_of(np.column_stack([np.zeros((len(z), 2)), z]))) > 0.0


@pytest.mark.parametrize("pitch", [0.05, 0.2])
@pytest.mark.parametrize("odd", [None, 0, 700, 2500])
def test_heights_are_those_of_voxels_where_all_of_them_are(pitch, odd):
    """One that is no rung is noticed among the first that are looked at, and among those that are not."""
    z = pitch * np.random.default_rng(0).integers(0, 20, 3000) + 0.123
    if odd is not None:
        z[odd] += 0.4 * pitch
    assert at_voxels(z) == (odd is None)


def test_voxels_of_which_those_that_are_looked_at_first_lie_on_every_second_rung_voxel_pitch():
    z = 0.05 * np.arange(3000)
    z[::3] = 0.1 * np.arange(1000)
    assert at_voxels(z)
    z[1] += 0.02
    assert not at_voxels(z)


@pytest.mark.parametrize(("share", "voxels"), [(0.008, True), (0.02, False)])
def test_a_voxels_centre_may_be_off_its_rung_by_what_rounding_makes(share, voxels):
    rungs = np.array([0.0, 1.0, 2.0, 4.0 + share, 5.0 + share])
    assert at_voxels(0.2 * rungs) == voxels


@pytest.mark.parametrize(("pitch", "voxels"), [(0.029, False), (0.031, True)])
def test_voxels_that_hide_nothing_which_stops_a_body_are_points(pitch, voxels):
    assert at_voxels(pitch * np.arange(50.0)) == voxels

"""Where the rays began is known: what they passed over is free, what none of them saw is not."""

import numpy as np
import pytest

import gpdf_service as gpdf
from gpdf_service.clouds import read_cloud
from gpdf_service.config import PerceptionConfig
from gpdf_service.errors import CloudError
from gpdf_service.perception.levels import survey_levels
from gpdf_service.perception.rays import check_origins, rays_of
from gpdf_service.tiles.points import points_of
from gpdf_service.tiles.surface import INFERRED

CONFIG = PerceptionConfig()
STATION = np.array([3.0, 3.0, 1.5])
BLIND = np.radians(25.0)
"""Half angle of the cone under the station that it does not see: 0.7 m on the floor."""


def box(low, high):
    return np.array([low, high], dtype=float)


def room(*boxes, side=6.0, height=2.5):
    """Slabs of a room and of boxes in it, each (2, 3): floor first."""
    floor = box((0, 0, -0.1), (side, side, 0.0))
    walls = [
        box((-0.1, 0, 0), (0, side, height)),
        box((side, 0, 0), (side + 0.1, side, height)),
        box((0, -0.1, 0), (side, 0, height)),
        box((0, side, 0), (side, side + 0.1, height)),
    ]
    return [floor, *walls, *boxes]


def ray_cast(slabs, origin):
    """First hits of the rays of a station: points (n, 3), and which slab each is of."""
    step = np.radians(0.4)
    up, around = np.meshgrid(np.arange(-np.pi / 2 + BLIND, 0.4, step), np.arange(0.0, 2 * np.pi, step), indexing="ij")
    ray = np.stack([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)], axis=-1).reshape(-1, 3)
    near, which = np.full(len(ray), np.inf), np.full(len(ray), -1)
    for i, (low, high) in enumerate(slabs):
        with np.errstate(divide="ignore"):
            one, other = (low - origin) / ray, (high - origin) / ray
        enter, leave = np.minimum(one, other).max(axis=1), np.maximum(one, other).min(axis=1)
        hit = (enter > 0) & (enter <= leave) & (enter < near)
        near[hit], which[hit] = enter[hit], i
    seen = which >= 0
    return origin + near[seen, None] * ray[seen], which[seen]


def surface_of(points, ground, origins=None):
    cloud = points_of(points)
    rays = None if origins is None else rays_of(cloud, check_origins(origins, points))
    return survey_levels(cloud, ground, CONFIG, rays=rays)[0].levels[0].surface


def state_at(surface, x, y):
    i, j, _ = surface.cells(np.array([[x, y]]))
    return surface.state[i[0], j[0]]


@pytest.fixture(scope="module")
def cupboard():
    """A cupboard, seen from one station: no ray sees what is behind it."""
    return ray_cast(room(box((4.5, 2.5, 0.0), (4.9, 3.5, 1.9))), STATION)


def test_the_blind_spot_under_the_station_is_explained(cupboard):
    points, which = cupboard
    surface = surface_of(points, which == 0, STATION)
    assert np.hypot(*(points[which == 0, :2] - STATION[:2]).T).min() > 0.6
    assert state_at(surface, 3.0, 3.0) == INFERRED
    assert state_at(surface, 3.3, 3.2) == INFERRED


def test_behind_a_thing_and_in_it_nothing_is_known(cupboard):
    points, which = cupboard
    surface = surface_of(points, which == 0, STATION)
    asked = np.array([[4.7, 3.0], [5.2, 3.0], [5.5, 2.9], [5.8, 3.1]])
    assert not surface.contains(asked).any()
    assert surface.contains(np.array([[4.0, 3.0], [5.5, 1.0], [2.0, 5.5]])).all()


def shadow_in_a_floor():
    """A dense floor in which a thing's shadow of 0.8 × 0.5 m was not seen; the thing itself left no point."""
    x, y = (axis.ravel() for axis in np.meshgrid(*2 * [np.arange(0.01, 6.0, 0.02)], indexing="ij"))
    hole = (np.abs(x - 4.6) < 0.4) & (np.abs(y - 3.0) < 0.25)
    return np.column_stack([x, y, np.zeros(len(x))])[~hole]


def test_a_hole_that_rules_explain_is_not_free_where_no_ray_passed_low_over_it():
    """A dark box of 0.5 m, of which the scanner got nothing back: the rule takes its place for ground."""
    floor, dark = shadow_in_a_floor(), box((4.2, 2.75, 0.0), (5.0, 3.25, 0.5))
    with np.errstate(divide="ignore"):
        one, other = (dark[0] - STATION) / (floor - STATION), (dark[1] - STATION) / (floor - STATION)
    through = np.minimum(one, other).max(axis=1) <= np.maximum(one, other).min(axis=1)
    seen = floor[~through]
    ground = np.ones(len(seen), dtype=bool)
    inside = np.array([[4.6, 3.0], [4.5, 2.9], [4.8, 3.1]])
    assert not surface_of(seen, ground, STATION).contains(inside).any()


def test_a_hole_that_rays_passed_low_over_is_free():
    floor = shadow_in_a_floor()
    ground = np.ones(len(floor), dtype=bool)
    rays_from_both_sides = np.where(floor[:, :1] > 4.6, np.array([[4.0, 3.0, 0.25]]), np.array([[5.2, 3.0, 0.25]]))
    surface = surface_of(floor, ground, rays_from_both_sides)
    assert state_at(surface, 4.6, 3.0) == INFERRED


def test_a_hole_that_a_ray_fell_through_is_open():
    """A trapdoor of 0.6 m: the rule sees coplanar floor around; one ray went through it, to 0.5 m below."""
    floor = shadow_in_a_floor()
    below = STATION + 1.35 * (np.array([4.5, 3.0, 0.0]) - STATION)
    points = np.concatenate([floor, below[None]])
    ground = np.arange(len(points)) < len(floor)
    low_over = np.where(points[:, :1] > 4.6, np.array([[4.0, 3.0, 0.25]]), np.array([[5.2, 3.0, 0.25]]))
    shut = surface_of(floor, ground[:-1], low_over[:-1])
    low_over[-1] = STATION
    open_ = surface_of(points, ground, low_over)
    assert shut.contains(np.array([[4.7, 3.0]]))[0]
    assert not open_.contains(np.array([[4.7, 3.0]]))[0]


def test_the_back_of_a_tread_in_the_shadow_of_the_next_one_is_known():
    """Of a tread of 0.28 m the scanner at the top of the flight sees no more than 0.09 m behind the nose above it."""
    treads = [box((3.0 + 0.28 * k, 2.0, 0.0), (6.0, 4.0, 0.17 * (k + 1))) for k in range(5)]
    station = np.array([5.53, 3.0, 5 * 0.17 + 1.5])
    points, which = ray_cast(room(*treads), station)
    ground = (which == 0) | ((which > 4) & (np.abs(points[:, 2] / 0.17 - np.round(points[:, 2] / 0.17)) < 1e-6))
    surface = surface_of(points, ground, station)
    backs = np.array([[3.2 + 0.28 * k, y] for k in range(3) for y in (2.5, 3.0, 3.5)])
    assert not (np.abs(points[:, None, :2] - backs) < 0.02).all(axis=2).any()
    assert surface.contains(backs).all()


def test_rays_know_more_than_the_rule_behind_a_thing_that_another_station_looked_behind():
    slabs = room(box((4.5, 2.5, 0.0), (4.9, 3.5, 1.9)))
    stations = np.array([STATION, [5.5, 4.6, 1.5]])
    scans = [ray_cast(slabs, station) for station in stations]
    points = np.concatenate([scan[0] for scan in scans])
    ground = np.concatenate([scan[1] for scan in scans]) == 0
    origins = np.repeat(stations, [len(scan[0]) for scan in scans], axis=0)
    surface, one = (
        surface_of(points, ground, origins),
        surface_of(*(part[: len(scans[0][0])] for part in (points, ground, origins))),
    )
    behind = np.array([[5.3, 3.2], [5.4, 3.0]])
    assert surface.contains(behind).all()
    assert not one.contains(behind).any()


def test_who_gives_origins_gets_the_same_by_one_or_by_many_and_in_a_saved_scene(cupboard, tmp_path):
    points, which = cupboard
    one = gpdf.build_scene(points, which == 0, origins=STATION)
    many = gpdf.build_scene(points, which == 0, origins=np.broadcast_to(STATION, points.shape))
    assert np.array_equal(one.surfaces[0].state, many.surfaces[0].state)
    one.save(tmp_path / "room.gpdf")
    loaded = gpdf.load_scene(tmp_path / "room.gpdf")
    gone = np.arange(50)
    assert np.array_equal(loaded.update(remove=gone).surfaces[0].state, one.update(remove=gone).surfaces[0].state)


def test_of_some_points_it_may_not_be_known_where_their_rays_began(cupboard):
    points, which = cupboard
    some = np.where(points[:, :1] > 4.0, np.nan, STATION)
    surface = surface_of(points, which == 0, some)
    assert state_at(surface, 3.0, 3.0) == INFERRED
    assert not surface.contains(np.array([[4.7, 3.0], [5.2, 3.0]])).any()


def test_new_points_bring_their_origins_and_without_them_show_nothing():
    floor = shadow_in_a_floor()
    ground = np.ones(len(floor), dtype=bool)
    scene = gpdf.build_scene(floor, ground, origins=(3.0, 3.0, 40.0))
    place = np.array([[4.6, 3.0]])
    assert not scene.surfaces[0].contains(place)[0]
    line = np.column_stack([np.full(40, 5.1), np.linspace(2.8, 3.2, 40), np.zeros(40)])
    lines = np.concatenate([line, line - np.array([1.0, 0.0, 0.0])])
    began = np.where(lines[:, :1] > 4.6, np.array([[4.0, 3.0, 0.25]]), np.array([[5.2, 3.0, 0.25]]))
    known = scene.update(lines, ground=np.ones(80, dtype=bool), origins=began)
    unknown = scene.update(lines, ground=np.ones(80, dtype=bool))
    assert known.surfaces[0].contains(place)[0]
    assert not unknown.surfaces[0].contains(place)[0]


@pytest.mark.parametrize(
    ("origins", "words"),
    [
        ((1.0, 2.0), "shape"),
        (np.zeros((5, 3)), "shape"),
        ((0.0, np.nan, 1.0), "finite"),
        ((np.nan,) * 3, "finite"),
        ("here", "numbers"),
    ],
)
def test_origins_that_are_none_are_refused(origins, words):
    with pytest.raises(CloudError, match=words):
        gpdf.build_scene(shadow_in_a_floor(), origins=origins)


def test_an_npz_file_tells_its_origins(tmp_path):
    points = shadow_in_a_floor()
    np.savez(tmp_path / "with.npz", xyz=points, origins=STATION)
    np.savez(tmp_path / "without.npz", xyz=points)
    assert np.array_equal(read_cloud(tmp_path / "with.npz").origins, np.broadcast_to(STATION, points.shape))
    assert read_cloud(tmp_path / "without.npz").origins is None

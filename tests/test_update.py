"""A scene that changes: the next version equals a scene built from scratch."""

import numpy as np
import pytest

import gpdf_service as gpdf
from gpdf_service.bench.build_changes import differences, from_scratch
from gpdf_service.bench.houses import scanned_house
from gpdf_service.config import PerceptionConfig
from gpdf_service.errors import CloudError, NoGroundError
from gpdf_service.scene import assemble_scene
from gpdf_service.synthetic import SCENES
from gpdf_service.synthetic.scenes import cave, ramp, random_room, stair
from gpdf_service.synthetic.world import Box
from gpdf_service.tiles.width import cell_width_of


@pytest.fixture(scope="module")
def office():
    made = SCENES["office"](np.random.default_rng(0))
    return gpdf.build_scene(made.points, made.ground)


def box(low, high, count=6000):
    rng = np.random.default_rng(4)
    return rng.uniform(low, high, (count, 3))


@pytest.fixture(scope="module")
def blocked(office):
    """The office with a box in the middle of the floor."""
    points = box((2.0, 2.0, 0.02), (2.8, 2.8, 1.0))
    return office.update(insert=points, ground=np.zeros(len(points), dtype=bool))


def test_a_further_scan_equals_a_scene_from_scratch(office, blocked):
    scratch = gpdf.build_scene(blocked.points, blocked.ground)
    assert (blocked.version, office.version) == (2, 1)
    assert blocked.digest == scratch.digest
    rng = np.random.default_rng(1)
    queries = np.column_stack([rng.uniform(0.5, 5.5, (3000, 2)), rng.uniform(0, 2, 3000)])
    ours, theirs = blocked.ground_field.query(queries), scratch.ground_field.query(queries)
    np.testing.assert_array_equal(ours.valid, theirs.valid)
    np.testing.assert_allclose(ours.distance, theirs.distance, atol=1e-3)
    one, other = blocked.free_space("human").levels[0].quadtree, scratch.free_space("human").levels[0].quadtree
    np.testing.assert_array_equal(one.center[one.free], other.center[other.free])


def test_a_storey_that_comes_or_goes_leaves_the_others_as_they_were(office):
    x, y = np.mgrid[1.5:3.5:0.04, 1.5:3.5:0.04].reshape(2, -1)
    deck = np.column_stack([x, y, np.full(x.size, 3.6)])
    more = office.update(insert=deck, ground=np.ones(len(deck), dtype=bool))
    less = more.update(remove=np.arange(len(office.points), len(more.points)))
    for scene, former in ((more, (0, -1)), (less, (0,))):
        assert scene.perceived.survey.former == former
        assert not differences(scene, from_scratch(scene))
    assert len(more.surfaces) == 2
    assert more.levels.levels[0] is office.levels.levels[0]


def test_what_is_put_onto_the_floor_leaves_nodes_and_fields_of_the_ground_as_they_were(office):
    points = box((2.0, 2.0, 0.5), (2.4, 2.4, 1.0))
    above = office.update(insert=points, ground=np.zeros(len(points), dtype=bool))
    assert above.perceived.survey.layers is office.perceived.survey.layers
    assert above.ground_fields[0] is office.ground_fields[0]
    assert above.levels.levels[0] is not office.levels.levels[0]
    assert not differences(above, from_scratch(above))


def test_what_hangs_over_a_body_leaves_its_obstacles_and_its_graph_as_they_were(office):
    points, before = box((2.0, 2.0, 2.2), (2.8, 2.8, 2.3)), office.free_space("human")
    hung = office.update(insert=points, ground=np.zeros(len(points), dtype=bool))
    after = hung.free_space("human")
    assert len(hung.levels.levels[0].other_points) == len(office.levels.levels[0].other_points) + len(points)
    for name in ("graph", "core"):
        assert getattr(after, name) is getattr(before, name)
    assert after.levels[0].standing is before.levels[0].standing
    assert not differences(hung, from_scratch(hung))


def test_what_is_new_stands_in_the_way_and_the_old_version_does_not_know(office, blocked):
    assert gpdf.plan(office, (2.4, 2.4), (0.9, 0.9)).status == gpdf.Status.OK
    assert gpdf.plan(blocked, (2.4, 2.4), (0.9, 0.9)).status == gpdf.Status.START_OCCUPIED


def test_taking_it_away_again_gives_the_scene_back(office, blocked):
    back = blocked.update(remove=np.arange(len(office.points), len(blocked.points)))
    assert back.version == 3
    assert back.digest == office.digest
    mask = np.zeros(len(blocked.points), dtype=bool)
    mask[len(office.points) :] = True
    assert blocked.update(remove=mask).digest == office.digest
    queries = np.column_stack([np.linspace(1, 5, 50), np.full(50, 2.4), np.full(50, 1.0)])
    ours, theirs = back.ground_field.query(queries), office.ground_field.query(queries)
    np.testing.assert_allclose(ours.distance, theirs.distance, atol=1e-3)


def test_new_points_without_labels_are_segmented_and_the_old_labels_stay(office):
    changed = office.update(insert=box((2.0, 2.0, 0.4), (2.8, 2.8, 1.0)))
    assert changed.labelled
    np.testing.assert_array_equal(changed.ground[: len(office.points)], office.ground)
    assert not changed.ground[len(office.points) :].any()


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_labels_of_new_points_are_told_by_a_scene_without_labels_that_changes_as_well(noise):
    """As whoever streams scans has none: the second one costs what it touches."""
    rng = np.random.default_rng(11)
    made = random_room(rng, noise=noise, spacing=0.03)
    scene = gpdf.build_scene(made.points, made.ground)
    twin = gpdf.build_scene(made.points)
    assert twin.sampling.tiles == scene.sampling.tiles
    for _ in range(4):
        change = random_change(twin, rng)
        scene, twin = scene.update(**change), twin.update(**change)
        assert scene.perceived.touched
        fresh = len(change.get("insert", ()))
        held, own = scene.perceived.twin, twin.perceived.found
        assert held is None or not held.labelled
        if held is not None:
            np.testing.assert_array_equal(held.cloud[1], own.cloud[1])
            np.testing.assert_array_equal(
                scene.ground[len(scene.ground) - fresh :], twin.ground[len(twin.ground) - fresh :]
            )
        assert_equal_scenes(scene, from_scratch(scene))


def test_a_twin_that_cannot_follow_what_it_is_not_asked_about_keeps_no_change_from_being_made(office):
    """What is labelled as no ground, and lies beyond all points, moves the twin's grid, and not that of the ground."""
    scene = office.update(insert=box((2.0, 2.0, 0.4), (2.8, 2.8, 1.0), 500))
    assert scene.perceived.twin is not None
    beyond = box((30.0, 2.0, 0.4), (30.5, 2.5, 1.0), 200)
    more = scene.update(insert=beyond, ground=np.zeros(len(beyond), dtype=bool))
    assert more.perceived.touched
    assert more.perceived.twin is None
    assert not differences(more, from_scratch(more))
    again = more.update(insert=box((1.0, 1.0, 0.4), (1.3, 1.3, 1.0), 500))
    assert not again.ground[-500:].any()


def test_a_place_that_is_scanned_again_takes_what_is_new_alone(office):
    again = office.points + np.random.default_rng(0).normal(0.0, 1e-3, office.points.shape)
    crate = box((2.0, 2.0, 0.1), (2.8, 2.8, 1.0), 20_000)
    scan = np.concatenate([again, crate])
    ground, origins = (
        np.append(office.ground, np.zeros(len(crate), dtype=bool)),
        np.arange(3.0 * len(scan)).reshape(-1, 3),
    )
    more = gpdf.build_scene(office.points, office.ground, origins=(3.0, 2.0, 1.5)).update(
        insert=scan, ground=ground, origins=origins, thin=0.1
    )
    fresh = more.points[len(office.points) :]
    voxels = [set(map(tuple, np.floor(points / 0.1).astype(int).tolist())) for points in (office.points, fresh, scan)]
    assert len(voxels[1]) == len(fresh)
    assert voxels[1] == voxels[2] - voxels[0]
    rows = {tuple(point): row for row, point in enumerate(scan.tolist())}
    row = [rows[tuple(point)] for point in fresh.tolist()]
    assert sorted(row) == row
    np.testing.assert_array_equal(more.ground[len(office.points) :], ground[row])
    np.testing.assert_array_equal(more.rays.began[len(office.points) :], origins[row])
    same = more.update(insert=scan, ground=ground, origins=origins, thin=0.1)
    assert (same.version, len(same.points), same.digest) == (more.version + 1, len(more.points), more.digest)
    without = more.update(remove=np.arange(len(office.points), len(more.points)))
    assert len(without.update(insert=crate, thin=0.1).points) > len(without.points)  # what is gone takes no room


@pytest.mark.parametrize("width", [0.0, -1.0, np.nan, np.inf])
def test_voxels_without_a_width_are_refused(office, width):
    with pytest.raises(CloudError, match="thin"):
        office.update(insert=office.points[:10], thin=width)


def test_a_scene_without_labels_finds_its_ground_anew(office):
    scene = gpdf.build_scene(office.points)
    assert not scene.labelled
    changed = scene.update(remove=office.points[:, 0] > 4.0)
    assert gpdf.plan(changed, (1.0, 1.0), (5.0, 3.0)).status == gpdf.Status.GOAL_OUTSIDE_MAP


def test_the_new_version_is_kept_in_the_file(blocked, tmp_path):
    blocked.save(tmp_path / "scene.gpdf")
    back = gpdf.load_scene(tmp_path / "scene.gpdf")
    assert (back.version, back.digest, back.labelled) == (2, blocked.digest, True)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"remove": [10**9]}, "rows that are not there"),
        ({"insert": np.zeros((3, 2))}, r"\(n, 3\)"),
        ({"insert": np.full((3, 3), np.nan)}, "finite"),
        ({"insert": np.ones((3, 3)), "ground": np.ones(2, dtype=bool)}, r"shape \(3,\)"),
    ],
)
def test_a_change_that_cannot_be_made_is_refused_and_loses_nothing(office, change, message):
    with pytest.raises(CloudError, match=message):
        office.update(**change)
    assert office.version == 1


def test_a_removal_that_leaves_nothing_to_stand_on_is_refused_and_loses_nothing(office):
    with pytest.raises(CloudError, match="no point would be left"):
        office.update(remove=np.ones(len(office.points), dtype=bool))
    with pytest.raises(NoGroundError, match="labelled ground"):
        office.update(remove=office.ground)
    assert office.version == 1


def test_a_removal_alone_segments_nothing_in_a_labelled_scene(office, monkeypatch):
    expected = gpdf.build_scene(office.points[5000:], office.ground[5000:])
    monkeypatch.setattr("gpdf_service.perception.cure.segment", None)
    np.testing.assert_array_equal(office.update(remove=np.arange(5000)).ground, expected.ground)


def in_order(rows):
    return rows[np.lexsort(rows.T)]


def assert_equal_scenes(one, other, *agents):
    """Labels, levels, fields and free spaces of a changed scene and of one from scratch."""
    np.testing.assert_array_equal(one.ground, other.ground)
    assert len(one.surfaces) == len(other.surfaces)
    for a, b in zip(one.levels.levels, other.levels.levels, strict=True):
        np.testing.assert_array_equal(a.surface.state, b.surface.state)
        np.testing.assert_array_equal(a.surface.height, b.surface.height)
        np.testing.assert_array_equal(a.limits.points, b.limits.points)
        np.testing.assert_array_equal(a.limits.value, b.limits.value)
        stands = [in_order(np.column_stack([level.other_points, level.ledge])) for level in (a, b)]
        np.testing.assert_array_equal(*stands)
    for a, b in zip(one.levels.portals, other.levels.portals, strict=True):
        np.testing.assert_array_equal(a.points, b.points)
    low, high = other.points.min(axis=0), other.points.max(axis=0)
    queries = np.random.default_rng(0).uniform(low, high, (2000, 3))
    assert_equal_fields(one.ground_field, other.ground_field, queries)
    for agent in agents:
        ours, theirs = one.free_space(agent), other.free_space(agent)
        assert_equal_fields(one.obstacle_field(agent), other.obstacle_field(agent), queries[:, :2])
        for now, then in zip(ours.levels, theirs.levels, strict=True):
            stopping = (np.column_stack([each.obstacles.points, each.kind]) for each in (now, then))
            np.testing.assert_array_equal(*map(in_order, stopping))
            a, b = now.quadtree, then.quadtree
            for name in ("code", "size", "free", "whole"):
                np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
            np.testing.assert_allclose(a.clearance, b.clearance, rtol=1e-12)  # sums in another order
        np.testing.assert_array_equal(ours.graph.component, theirs.graph.component)
        np.testing.assert_array_equal(ours.graph.other, theirs.graph.other)


def assert_equal_findings(one, other):
    """What the ground was found from, from which the next version starts."""
    ours, theirs = (scene.perceived.found.segmentation.near.known for scene in (one, other))
    assert ours.keys() == theirs.keys()
    for name in ours:
        for one, other in zip(ours[name].made, theirs[name].made, strict=True):
            for a, b in zip(one, other, strict=True):  # pairs come in another order
                np.testing.assert_array_equal(*(map(in_order, (a, b)) if a.ndim > 1 else (a, b)), name)


def test_slopes_beside_columns_that_are_empty_now_are_those_of_a_scene_from_scratch():
    scene = gpdf.build_scene(cave(np.random.default_rng(0)).points)
    rng = np.random.default_rng(1)
    for _ in range(4):
        place, half = scene.points[rng.integers(len(scene.points)), :2], rng.uniform(0.2, 0.5)
        scene = scene.update(remove=(np.abs(scene.points[:, :2] - place) < half).all(axis=1))
        assert scene.perceived.touched
        assert_equal_findings(scene, from_scratch(scene))


def assert_equal_fields(ours, theirs, queries):
    a, b = ours.query(queries), theirs.query(queries)
    np.testing.assert_array_equal(a.valid, b.valid)
    np.testing.assert_allclose(a.distance, b.distance, atol=1e-3)


def random_change(scene, rng):
    """A box put in anywhere, on the ground, on the wall or in the air, and a ball or a column taken out."""
    low, high = scene.points.min(axis=0), scene.points.max(axis=0)
    change = {}
    if rng.random() < 0.7:
        size = rng.uniform([0.2, 0.2, 0.05], [0.8, 0.8, 1.0])
        corner = rng.uniform(low + 0.1, high - 0.1 - size)
        near = np.hypot(*(scene.points[:, :2] - corner[:2] - 0.5 * size[:2]).T).argmin()
        corner[2] = min(scene.points[near, 2] + rng.choice([0.0, 0.02, 0.5]), high[2] - size[2] - 0.1)
        change["insert"] = Box(tuple(corner), tuple(corner + size)).sample(0.06, rng)[0]
    if not change or rng.random() < 0.6:
        centre, radius = rng.uniform(low, high), rng.uniform(0.2, 0.7)
        away = scene.points - centre
        change["remove"] = np.linalg.norm(away[:, : rng.integers(2, 4)], axis=1) < radius
    if scene.labelled:
        change["ground"] = np.zeros(len(change.get("insert", ())), dtype=bool)
    return change


@pytest.mark.parametrize(
    ("made", "labelled", "agents", "tile"),
    [
        (random_room, False, ("human", "roomba"), 64),
        (random_room, True, ("spot",), 11),
        (ramp, False, ("human",), 7),
        (stair, False, ("human",), 16),
        (cave, False, ("roomba",), 23),
    ],
)
def test_random_changes_equal_a_scene_from_scratch(made, labelled, agents, tile, monkeypatch):
    """Whatever the tiles in which a change asks again what differs."""
    monkeypatch.setattr("gpdf_service.tiles.told.TILE", tile)
    rng = np.random.default_rng(7)
    sample = made(rng)
    scene = gpdf.build_scene(sample.points, sample.ground if labelled else None)
    for agent in agents:
        scene.free_space(agent)
    for _ in range(3):
        changed = scene.update(**random_change(scene, rng))
        assert changed.perceived.touched  # only what the change touches was looked at
        again = from_scratch(changed)
        assert_equal_scenes(changed, again, *agents)
        if not labelled:
            assert_equal_findings(changed, again)
        scene = changed


def test_more_obstacles_than_there_were_can_come_at_once():
    plan = np.random.default_rng(3).uniform(0.0, 6.0, (40_000, 2))
    floor = np.column_stack([plan, np.zeros(len(plan))])
    points = np.concatenate([floor, box((1.0, 1.0, 0.1), (1.2, 1.2, 1.0), 30)])
    scene = gpdf.build_scene(points, np.arange(len(points)) < len(floor))
    before = len(scene.free_space("human").levels[0].obstacles.points)
    fresh = box((3.0, 3.0, 0.1), (4.0, 4.0, 1.0), 900)
    changed = scene.update(insert=fresh, ground=np.zeros(len(fresh), dtype=bool))
    assert changed.perceived.touched
    assert before < len(fresh)
    assert_equal_scenes(changed, from_scratch(changed), "human")


def test_a_scene_keeps_its_resolution_until_much_of_it_has_changed():
    """The width of its cells is measured in steps of 5 mm, and a few points can take it over one."""
    plan = np.random.default_rng(3).uniform(0.0, 6.0, (4000, 2))

    def floor(scale):
        return np.column_stack([scale * plan, np.zeros(len(plan))])

    low, high = 1.0, 1.2
    width = cell_width_of(floor(low), PerceptionConfig())
    assert cell_width_of(floor(high), PerceptionConfig()) > width
    while high - low > 1e-5:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if cell_width_of(floor(middle), PerceptionConfig()) > width else (middle, high)
    scene = gpdf.build_scene(floor(low))
    gone = (np.abs(scene.points[:, :2] - 3.0) < 0.5).all(axis=1)
    assert cell_width_of(scene.points[~gone], PerceptionConfig()) > width
    thinner = scene.update(remove=gone)
    beyond = thinner.update(insert=[[-9.0, 0.1, 0.0]])
    assert thinner.perceived.touched
    assert not beyond.perceived.touched  # the map has other bounds: all was looked at
    for changed in (thinner, beyond):
        assert changed.sampling.grain.width == width
        assert_equal_scenes(changed, from_scratch(changed))
    assert beyond.update(remove=np.arange(200)).sampling.grain.width > width


def test_changes_of_voxels_centres_equal_a_scene_from_scratch():
    """A floor near the upper end of its rung has some points on the next one."""
    rng, pitch = np.random.default_rng(4), 0.05
    voxels = np.column_stack([np.indices((80, 80)).reshape(2, -1).T, np.zeros(6400)])
    above = voxels[rng.random(len(voxels)) < 0.03] + [0, 0, 1]
    wall = np.array([60, 10, 0]) + np.indices((1, 30, 30)).reshape(3, -1).T
    scene = gpdf.build_scene(pitch * (np.concatenate([voxels, above, wall]) + 0.5))
    assert scene.sampling.grain.pitch == pytest.approx(pitch)
    scene.free_space("human")
    for corner in ([20, 20, 1], [40, 60, 0], [10, 40, 1]):
        fresh = pitch * (np.unique(corner + rng.integers(0, [8, 8, 2], (60, 3)), axis=0) + 0.5)
        near = (np.abs(scene.points[:, :2] / pitch - corner[:2] - [12, 0]) < 6).all(axis=1)
        changed = scene.update(insert=fresh, remove=near & (scene.points[:, 2] > pitch))
        assert changed.perceived.touched
        assert changed.sampling == scene.sampling
        assert_equal_scenes(changed, from_scratch(changed), "human")
        assert_equal_findings(changed, from_scratch(changed))
        scene = changed


def test_how_noisy_a_cloud_is_is_kept_as_its_cells_width_is():
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(0.0, 6.0, 0.08), np.arange(0.0, 5.0, 0.08)))
    off = np.random.default_rng(3).normal(size=len(x))

    def floor(noise):
        return gpdf.build_scene(np.column_stack([x, y, noise * off]), np.ones(len(x), bool))

    low, high = 0.002, 0.008
    while high - low > 1e-7:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if floor(middle).noise else (middle, high)
    differs = []
    for scene in (floor(low), floor(high)):  # one is as good as negligible, the other one is not quite
        changed = scene.update(remove=(np.abs(scene.points[:, :2] - 3.0) < 0.5).all(axis=1))
        assert changed.perceived.touched
        assert changed.noise == scene.noise
        assert_equal_scenes(changed, from_scratch(changed))
        differs.append(assemble_scene(changed.points, changed.ground, changed.config).noise != scene.noise)
    assert any(differs)


def test_how_rough_the_ground_is_is_kept_as_its_cells_width_is():
    """What comes onto a rough floor is told by the scatter of the floor before it came, in a build with it as well."""
    rng = np.random.default_rng(5)
    floor = np.column_stack([rng.uniform(0.0, 4.0, (4000, 2)), rng.normal(0.0, 0.012, 4000)])
    scene = gpdf.build_scene(floor)
    rough = scene.perceived.found.grain
    assert rough.deviation > 0.008
    changed = scene.update(insert=rng.uniform((1.0, 1.0, -0.03), (2.0, 2.0, 0.06), (150, 3)))
    assert changed.perceived.touched
    assert changed.perceived.found.grain == from_scratch(changed).perceived.found.grain == rough
    assert gpdf.build_scene(changed.points).perceived.found.grain.deviation > rough.deviation
    assert_equal_scenes(changed, from_scratch(changed))


def test_a_ground_field_resolves_the_same_however_much_of_the_ground_is_steep():
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(0, 7.9, 0.04), np.arange(0, 5, 0.04)))
    scene = gpdf.build_scene(np.column_stack([x, y, 0.4 * np.maximum(4.0 - x, 0.0)]))
    changed = scene.update(remove=(np.abs(scene.points[:, 0] - 2.0) < 0.9) & (scene.points[:, 1] < 1.0))
    assert changed.perceived.touched
    again = from_scratch(changed)
    assert changed.ground_fields[0].spacing == again.ground_fields[0].spacing
    assert_equal_scenes(changed, again)


def two_storeys():
    """A hall with an upper floor over half of it, which only a stair joins."""
    step = 0.05
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(-2, 8, step), np.arange(0, 4, step)))
    under = (x > 0.2) & (x < 4.4) & (y < 1.6)
    floor = np.column_stack([x, y, np.zeros(x.size)])[~under]
    upper = np.column_stack([x, y, np.full(x.size, 3.0)])[(x > 4.4) | (y > 2.0)]
    roof = np.column_stack([x, y, np.full(x.size, 5.6)])
    stairs = []
    for i in range(15):
        u, v = (axis.ravel() for axis in np.meshgrid(np.arange(0, 0.28, step / 2), np.arange(0.0, 1.6, step)))
        stairs.append(np.column_stack([0.2 + 0.28 * i + u, v, np.full(u.size, 0.2 * (i + 1))]))
        stairs.append(np.column_stack([np.full(u.size, 0.2 + 0.28 * i), v, 0.2 * i + u * 0.2 / 0.28]))
    return np.concatenate([floor, upper, roof, *stairs])


def test_a_change_that_cuts_the_stair_cuts_the_storeys_apart():
    cloud = two_storeys()
    scene = gpdf.build_scene(cloud)
    assert len(scene.surfaces) > 1
    assert (np.diff([np.nanmedian(surface.height) for surface in scene.surfaces]) >= 0.0).all()  # level 0 is the lowest
    assert gpdf.plan(scene, (6.0, 1.0, 0.0), (6.0, 3.0, 3.0)).status is gpdf.Status.OK
    gone = (scene.points[:, 0] > 1.6) & (scene.points[:, 0] < 2.6) & (scene.points[:, 1] < 1.7)
    gone &= (scene.points[:, 2] > 0.5) & (scene.points[:, 2] < 2.8)
    cut = scene.update(remove=gone)
    assert_equal_scenes(cut, from_scratch(cut), "human")
    assert gpdf.plan(cut, (6.0, 1.0, 0.0), (6.0, 3.0, 3.0)).status is not gpdf.Status.OK
    back = cut.update(insert=scene.points[gone])
    assert_equal_scenes(back, gpdf.build_scene(back.points), "human")
    assert gpdf.plan(back, (6.0, 1.0, 0.0), (6.0, 3.0, 3.0)).status is gpdf.Status.OK


def test_a_level_that_comes_and_goes_leaves_the_free_space_of_the_others():
    """It comes between two, and takes the number of the upper one."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(0, 8, 0.05), np.arange(0, 6, 0.05)))
    floor, upper = (np.column_stack([x, y, np.full(x.size, z)])[chosen] for z, chosen in ((0.0, x < 9), (4.0, x > 5)))
    points = np.concatenate([floor, upper, box((6.0, 3.0, 4.1), (6.4, 3.6, 5.0), 500)])
    scene = gpdf.build_scene(points, points[:, 2] % 4.0 == 0.0)
    before = scene.free_space("human").levels
    slab = np.column_stack([x, y, np.full(x.size, 2.0)])[(x > 1) & (x < 2.2) & (y > 2) & (y < 3.2)]
    more = scene.update(insert=slab, ground=np.ones(len(slab), dtype=bool))
    assert [k for k, _ in more.perceived.touched] == [0, -1, 1]
    assert more.free_space("human").levels[2].quadtree is before[1].quadtree
    assert_equal_scenes(more, from_scratch(more), "human")
    assert_equal_cores(more, from_scratch(more))
    fewer = more.update(remove=np.arange(len(points), len(more.points)))  # its space is not asked for
    fewer = fewer.update(remove=[0])
    assert fewer.free_space("human").levels[1].quadtree is before[1].quadtree
    assert_equal_scenes(fewer, from_scratch(fewer), "human")
    assert_equal_cores(fewer, from_scratch(fewer))


def assert_equal_cores(one, other):
    """The leaves that ways lead over."""
    ours, theirs = (scene.free_space("human").core for scene in (one, other))
    np.testing.assert_array_equal(ours.node, theirs.node)
    np.testing.assert_array_equal(ours.decided.up, theirs.decided.up)


@pytest.mark.parametrize("asked", [True, False])
def test_a_level_whose_box_moves_keeps_what_is_known_of_it(asked):
    """The upper floor ends earlier, and then goes on again; its free space is asked for now and then."""
    cloud = np.concatenate([two_storeys(), box((4.8, 3.0, 3.1), (5.0, 3.6, 4.0), 500)])
    upper = (cloud[:, 2] > 2.9) & (cloud[:, 2] < 3.1)
    cloud, upper = (each[~upper | (cloud[:, 0] < 5.6)] for each in (cloud, upper))
    scene = gpdf.build_scene(cloud)
    scene.free_space("human")
    end = upper & (cloud[:, 0] > 5.2)
    less = scene.update(remove=end)
    if asked:
        less.free_space("human")
    more = less.update(insert=cloud[end])
    for before, now in ((scene, less), (less, more)):
        boxes = [{surface.state.shape for surface in each.surfaces} for each in (before, now)]
        assert boxes[0] != boxes[1]
        assert now.perceived.survey.former == tuple(range(len(now.surfaces)))
        assert_equal_scenes(now, from_scratch(now), "human")
        assert_equal_cores(now, from_scratch(now))
        for k, field in enumerate(now.ground_fields):
            np.testing.assert_array_equal(field.alpha, from_scratch(now).ground_fields[k].alpha)


def test_a_change_that_takes_away_ground_far_from_it_finds_all_of_that():
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(-2, 16, 0.05), np.arange(0, 9, 0.05)))
    terrace = (x > 0.0) & (x < 15.0) & (y > 4.0) & (y < 6.0)
    ramp = (x > 0.0) & (x < 1.5) & (y >= 3.0) & (y <= 4.0)
    shown = terrace | ramp | (x <= 0.0) | (y < 3.0) | (y > 7.0)
    z = np.where(terrace, 0.6, np.where(ramp, 0.6 * (y - 3.0), 0.0))
    scene = gpdf.build_scene(np.column_stack([x, y - 100.0, z])[shown])
    far = scene.points[:, 2] == 0.6
    assert scene.ground[far].all()
    gone = (scene.points[:, 2] > 0.15) & (scene.points[:, 2] < 0.45)
    cut = scene.update(remove=gone)
    assert cut.drift > 0.0
    assert not cut.ground[far[~gone]].any()
    assert_equal_scenes(cut, gpdf.build_scene(cut.points))


def test_a_scan_beyond_the_map_or_of_much_of_it_is_built_as_a_whole(office):
    scene = gpdf.build_scene(office.points)
    x, y = np.meshgrid(np.arange(6.0, 7.0, 0.05), np.arange(0.0, 1.0, 0.05))
    grown = scene.update(insert=np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]))
    assert not grown.perceived.touched
    assert_equal_scenes(grown, from_scratch(grown))
    halved = scene.update(remove=np.arange(0, len(scene.points), 2))
    assert halved.drift == 0.0
    assert_equal_scenes(halved, gpdf.build_scene(halved.points))


def test_a_single_point_where_nothing_is_equals_a_scene_from_scratch():
    """What is new is then one node alone, whose place is no cut of an array of places."""
    x, y = np.meshgrid(np.arange(0.0, 6.0, 0.05), np.arange(0.0, 6.0, 0.05))
    floor = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    there = ~((floor[:, :2] > 2.0) & (floor[:, :2] < 3.0)).all(axis=1)
    scene = gpdf.build_scene(floor[there])
    for place in ((2.5, 2.5, 0.0), (2.5, 2.5, 3.0), (6.3, 3.0, 0.0)):
        scene = scene.update(insert=[place])
        assert_equal_scenes(scene, from_scratch(scene))


@pytest.mark.parametrize(
    ("made", "labelled", "noise"),
    [(random_room, False, 0.02), (random_room, True, 0.02), (random_room, False, 0.01), (stair, True, 0.02)],
)
def test_random_changes_of_a_noisy_scene_equal_one_from_scratch(made, labelled, noise):
    """Tile by tile the noise is taken out of what the change touches, and of nothing else."""
    rng = np.random.default_rng(3)
    sample = made(rng, noise=noise, spacing=0.03)
    scene = gpdf.build_scene(sample.points, sample.ground if labelled else None)
    scene.free_space("human")
    touched = 0
    for _ in range(4):
        changed = scene.update(**random_change(scene, rng))
        again = from_scratch(changed)
        assert changed.sampling.tiles is not None
        assert changed.sampling == scene.sampling or changed.drift == 0.0  # much of it had changed
        np.testing.assert_array_equal(changed.perceived.found.points.present, again.perceived.found.points.present)
        assert_equal_scenes(changed, again, "human")
        touched += bool(changed.perceived.touched)
        scene = changed
    assert touched >= 1  # a change of much, or of the map's bounds, is built as a whole


@pytest.mark.parametrize(
    ("scanner", "noise", "one_origin"),
    [("tripod", 0.0, False), ("tripod", 0.02, False), ("tripod", 0.0, True), ("handheld", 0.0, False)],
)
def test_random_changes_of_a_scene_with_origins_equal_one_from_scratch(scanner, noise, one_origin):
    """New rays are counted, and those that went, and all of them where the ground is another."""
    rng = np.random.default_rng(5)
    _, scan = scanned_house(1, scanner, noise, thin=0.04)
    stations = scan.origins[:1] if one_origin else scan.origins
    scene = gpdf.build_scene(scan.points, origins=stations[0] if one_origin else stations)
    scene.free_space("human")
    touched = 0
    for i in range(5):
        change = random_change(scene, rng)
        if "insert" in change and i % 3:  # as somebody scans it who walks there, or nobody knows from where
            change["origins"] = stations[rng.integers(len(stations))] + rng.uniform(-0.5, 0.5, 3)
        changed = scene.update(**change)
        again = from_scratch(changed)
        np.testing.assert_array_equal(
            *(np.broadcast_to(each.rays.began, each.points.shape) for each in (changed, again))
        )
        assert_equal_scenes(changed, again, "human")
        for own, other in zip(changed.perceived.survey.made, again.perceived.survey.made, strict=True):
            for name in ("rays", "blind", "holes fallen through"):
                for a, b in zip(own.grid.known[name].made, other.grid.known[name].made, strict=True):
                    np.testing.assert_array_equal(a, b, name)
        touched += bool(changed.perceived.touched)
        scene = changed
    assert touched >= 2  # a change of the map's bounds is built as a whole


def test_a_ray_alone_that_comes_shows_what_is_free(office):
    """Points that lie where others do change no ground; from where they were seen tells that a hole beside is floor."""
    away = np.hypot(*(office.points[:, :2] - (3.0, 2.4)).T) > 0.3
    floor = away | ~office.ground
    scene = gpdf.build_scene(office.points[floor], office.ground[floor], origins=(3.0, 2.4, 12.0))
    assert not scene.surfaces[0].contains(np.array([[3.0, 2.4]]))[0]
    ground = np.flatnonzero(scene.ground & (np.abs(scene.points[:, 0] - 3.5) < 0.15))
    ground = ground[np.abs(scene.points[ground, 1] - 2.4) < 0.3]
    seen = scene.update(insert=scene.points[ground], ground=np.ones(len(ground), dtype=bool), origins=(2.2, 2.4, 0.1))
    assert seen.perceived.touched
    assert seen.surfaces[0].contains(np.array([[3.0, 2.4]]))[0]
    assert_equal_scenes(seen, from_scratch(seen))


def test_a_noisy_scene_keeps_the_labels_of_its_strays():
    """What denoising leaves out as a stray is no thing to the next version."""
    noisy = random_room(np.random.default_rng(0), noise=0.05)
    scene = gpdf.build_scene(noisy.points, noisy.ground)
    assert scene.perceived.found.noisy.explained.stray.any()
    assert (scene.ground == noisy.ground).all()
    again = scene.update(remove=np.array([0]))
    assert (again.ground == noisy.ground[1:]).all()


def test_what_moves_is_still_there_after_a_change(office, blocked):
    person = np.array([3.5, 1.0, 0.0]) + box((0.0, 0.0, 0.1), (0.3, 0.3, 1.7), 300)
    changed = office.with_obstacles(person).update(
        insert=box((2.0, 2.0, 0.02), (2.8, 2.8, 1.0)), ground=np.zeros(6000, bool)
    )
    np.testing.assert_array_equal(changed.moving, person)
    assert changed.version == office.version + 1
    queries = np.random.default_rng(0).uniform(0.0, 4.0, (500, 2))
    assert_equal_fields(
        changed.obstacle_field("human"), blocked.with_obstacles(person).obstacle_field("human"), queries
    )


def test_a_free_space_of_two_versions_ago_is_taken_over(office):
    scene = gpdf.build_scene(office.points, office.ground)
    scene.free_space("human")
    for low in ((2.0, 2.0, 0.02), (3.0, 1.0, 0.02)):
        points = box(low, np.add(low, (0.4, 0.4, 1.0)), 1000)
        scene = scene.update(insert=points, ground=np.zeros(len(points), dtype=bool))
    assert scene.drift > 0.0
    assert_equal_scenes(scene, gpdf.build_scene(scene.points, scene.ground), "human")


def test_a_change_of_nothing_is_a_version_like_the_last(office):
    scene = gpdf.build_scene(office.points, office.ground)
    same = scene.update()
    assert (same.version, same.digest) == (2, scene.digest)
    assert same.ground_fields == scene.ground_fields

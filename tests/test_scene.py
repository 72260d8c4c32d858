import gc
import json
import threading

import laspy
import numpy as np
import pytest

import gpdf_service as gpdf
from gpdf_service.errors import CloudError, FieldError, SceneFileError
from gpdf_service.planning.routes import Leg, pull_cheaply
from gpdf_service.scene import level_under
from gpdf_service.search.ways import Prefer
from gpdf_service.store import flatten, read_arrays, write_arrays
from gpdf_service.synthetic import SCANNERS, SCENES
from gpdf_service.synthetic.places import PLACES
from gpdf_service.tiles import HeightMap


def test_a_saved_scene_answers_the_same_and_fits_nothing(office, tmp_path, monkeypatch):
    made, scene = office
    before = gpdf.plan(scene, made.start, made.goal, "human")
    scene.save(tmp_path / "office.gpdf")
    monkeypatch.setattr("gpdf_service.scene.fit_gpdf", None)
    back = gpdf.load_scene(tmp_path / "office.gpdf")
    after = gpdf.plan(back, made.start, made.goal, "human")
    np.testing.assert_array_equal(before.trajectory.positions, after.trajectory.positions)
    assert back.digest == scene.digest
    assert back.config == scene.config
    points = np.random.default_rng(0).uniform([0, 0, 0], [6, 5, 2], (100, 3))
    np.testing.assert_array_equal(back.ground_field.query(points).distance, scene.ground_field.query(points).distance)


def parts_of(scene):
    """Every array that a scene is made of."""
    made = flatten(scene.levels, "levels") | {"points": scene.points, "ground": scene.ground}
    made = {name: value for name, value in made.items() if "/edges/" not in name}  # which tell limits alone
    for i, level in enumerate(scene.levels.levels):
        made |= flatten(level.limits, f"levels/levels/{i}/limits")
    for i, field in enumerate(scene.ground_fields):
        made |= {f"field/{i}/{name}": value for name, value in field.to_arrays().items()}
    return made


def same(a, b):
    first, second = parts_of(a), parts_of(b)
    assert first.keys() == second.keys()
    for name, values in first.items():
        assert values.dtype == second[name].dtype, name
        np.testing.assert_array_equal(values, second[name], err_msg=name)


def noisy_office():
    made = SCENES["office"](np.random.default_rng(0), spacing=0.08, noise=0.02)
    return gpdf.build_scene(made.points, made.ground)


def changed_office():
    made = SCENES["office"](np.random.default_rng(0), spacing=0.08)
    box = np.stack(np.meshgrid([3.0, 3.1], [3.0, 3.1], np.arange(0.1, 1.0, 0.1)), axis=-1).reshape(-1, 3)
    scene = gpdf.build_scene(made.points, made.ground)
    return scene.update(remove=np.flatnonzero(made.points[:, 0] < 1.0), insert=box)


@pytest.mark.parametrize("make", [noisy_office, changed_office])
def test_a_scene_comes_back_to_the_bit(make, tmp_path):
    scene = make()
    scene.save(tmp_path / "a.gpdf")
    back = gpdf.load_scene(tmp_path / "a.gpdf")
    same(scene, back)
    back.save(tmp_path / "b.gpdf")
    assert (tmp_path / "a.gpdf").read_bytes() == (tmp_path / "b.gpdf").read_bytes()


def test_two_storeys_take_no_more_than_thrice_their_cloud_and_come_back_to_the_bit(tmp_path):
    grid = np.stack(np.meshgrid(np.arange(0.0, 6.0, 0.05), np.arange(0.0, 5.0, 0.05), [0.0, 2.7]), axis=-1)
    wall = np.stack(np.meshgrid(np.arange(0.0, 6.0, 0.05), [2.5], np.arange(0.05, 5.0, 0.05)), axis=-1)
    floors, walls = grid.reshape(-1, 3), wall.reshape(-1, 3)
    scan = np.concatenate([floors, walls]) + np.random.default_rng(0).normal(0.0, 0.001, (len(floors) + len(walls), 3))
    scan = scan.astype(np.float32)
    scene = gpdf.build_scene(scan, np.arange(len(scan)) < len(floors))
    assert len(scene.levels.levels) == 2
    scene.save(tmp_path / "a.gpdf")
    same(scene, gpdf.load_scene(tmp_path / "a.gpdf"))
    np.savez_compressed(tmp_path / "cloud.npz", points=scan)
    assert (tmp_path / "a.gpdf").stat().st_size < 3.0 * (tmp_path / "cloud.npz").stat().st_size


def test_a_scene_file_of_an_earlier_version_is_refused_with_what_to_do(office, tmp_path):
    header = np.frombuffer(json.dumps({"schema_version": 7, "version": 1}).encode(), np.uint8)
    with (tmp_path / "old.gpdf").open("wb") as file:
        np.savez(file, meta=header, points=office[1].points)
    with pytest.raises(SceneFileError, match=r"another gpdf built it.*version 7.*again from its cloud"):
        gpdf.load_scene(tmp_path / "old.gpdf")


def test_a_scene_of_a_laz_cloud_takes_less_than_three_times_its_file(tmp_path):
    """With ground over head that nobody saw from below: some of its points are a step further down."""
    rng = np.random.default_rng(3)
    scan = SCANNERS["handheld"](PLACES["house_return"](rng), rng, 0.006).thinned(0.08, rng).points
    header = laspy.LasHeader()
    header.scales, header.offsets = np.full(3, 1e-3), np.floor(scan.min(axis=0))
    made = laspy.LasData(header)
    made.x, made.y, made.z = scan.T
    made.write(tmp_path / "house.laz")
    scene = gpdf.build_scene(gpdf.read_cloud(tmp_path / "house.laz").points)
    scene.save(tmp_path / "house.gpdf")
    arrays = read_arrays(tmp_path / "house.gpdf")[0]
    assert any(values.any() for name, values in arrays.items() if name.endswith("/down"))
    assert not any(name.endswith("/other_points") for name in arrays)
    same(gpdf.load_scene(tmp_path / "house.gpdf"), scene)
    assert (tmp_path / "house.gpdf").stat().st_size < 3.0 * (tmp_path / "house.laz").stat().st_size


def test_a_scene_file_that_marks_points_which_are_not_there_is_refused(office, tmp_path):
    office[1].save(tmp_path / "a.gpdf")
    arrays, meta, _ = read_arrays(tmp_path / "a.gpdf")
    arrays["points"] = arrays["points"][1:]
    write_arrays(tmp_path / "b.gpdf", arrays, meta)
    with pytest.raises(SceneFileError, match="points that are not there"):
        gpdf.load_scene(tmp_path / "b.gpdf")


def test_a_scene_file_with_a_ground_field_of_other_cells_is_refused(office, tmp_path):
    office[1].save(tmp_path / "a.gpdf")
    arrays, meta, _ = read_arrays(tmp_path / "a.gpdf")
    arrays["ground_fields/0/alpha"] = arrays["ground_fields/0/alpha"][1:]
    write_arrays(tmp_path / "b.gpdf", arrays, meta)
    with pytest.raises(SceneFileError, match="a ground field of"):
        gpdf.load_scene(tmp_path / "b.gpdf")


def test_a_scene_file_without_a_part_is_refused(office, tmp_path):
    office[1].save(tmp_path / "a.gpdf")
    arrays, meta, _ = read_arrays(tmp_path / "a.gpdf")
    del arrays["levels/levels/0/surface/height"]
    write_arrays(tmp_path / "b.gpdf", arrays, meta)
    with pytest.raises(SceneFileError, match="height"):
        gpdf.load_scene(tmp_path / "b.gpdf")


def graph_of(scene, agent):
    graph = scene.free_space(agent).graph
    return graph.position, graph.level, graph.first, graph.other, graph.via, graph.cost, graph.component


def test_a_scene_file_keeps_the_free_spaces_that_are_ready(office, tmp_path, monkeypatch):
    made, scene = office
    scene.forget_agents()
    before = {name: gpdf.plan(scene, made.start, made.goal, name) for name in ("human", "roomba")}
    scene.save(tmp_path / "a.gpdf")
    gpdf.load_scene(tmp_path / "a.gpdf").save(tmp_path / "b.gpdf")  # also what nobody asked for in between
    for searched in ("build_quadtree", "find_edges", "build_tree", "fit_gpdf", "obstacles_of"):
        monkeypatch.setattr(f"gpdf_service.search.free_space.{searched}", None)
    back = gpdf.load_scene(tmp_path / "b.gpdf")
    assert back.info()["agents_ready"] == ["human", "roomba"]
    for name, result in before.items():
        for ours, theirs in zip(graph_of(back, name), graph_of(scene, name), strict=True):
            np.testing.assert_array_equal(ours, theirs)
        after = gpdf.plan(back, made.start, made.goal, name)
        np.testing.assert_array_equal(after.trajectory.positions, result.trajectory.positions)
    back.forget_agents()
    assert back.info()["agents_ready"] == []


def test_a_scene_file_keeps_no_more_free_spaces_than_a_scene(office, tmp_path, monkeypatch):
    scene = office[1]
    scene.forget_agents()
    scene.free_space("human")
    scene.save(tmp_path / "a.gpdf")
    back = gpdf.load_scene(tmp_path / "a.gpdf")
    monkeypatch.setattr("gpdf_service.scene.MAX_CACHED_AGENTS", 1)
    back.free_space("roomba")
    back.save(tmp_path / "b.gpdf")
    assert gpdf.load_scene(tmp_path / "b.gpdf").info()["agents_ready"] == ["roomba"]


@pytest.mark.parametrize("part", ["order", "quadtree/size"])
def test_a_free_space_with_a_part_missing_is_an_error(office, tmp_path, part):
    scene = office[1]
    scene.forget_agents()
    scene.free_space("human")
    scene.save(tmp_path / "a.gpdf")
    arrays, meta, _ = read_arrays(tmp_path / "a.gpdf")
    del arrays[f"agents/0/0/{part}"]
    write_arrays(tmp_path / "b.gpdf", arrays, meta)
    with pytest.raises(SceneFileError, match=part):
        gpdf.load_scene(tmp_path / "b.gpdf").free_space("human")


def test_the_obstacle_field_is_close_to_the_truth_and_on_the_safe_side(office):
    made, scene = office
    rng = np.random.default_rng(0)
    xy = rng.uniform([0.3, 0.3], [5.7, 4.7], (3000, 2))
    for name in ("roomba", "human"):
        agent = gpdf.AGENTS[name]
        contacts = np.column_stack([xy, np.zeros(len(xy))])
        truth = made.truth.body_clearance(contacts, 0.0, agent.height, agent.max_step)
        floor = made.truth.ground_height(xy) == 0
        sample = scene.obstacle_field(name).query(xy)
        away = floor & sample.valid & (truth > 0.1)
        assert away.sum() > 500
        error = (sample.distance - truth)[away]
        assert np.median(np.abs(error)) < 0.01
        assert np.quantile(error, 0.99) < 0.03


def test_fields_say_nothing_outside_the_map(office):
    _, scene = office
    for sample in (
        scene.ground_field.query([[100.0, 0.0, 1.0], [np.nan, 0.0, 0.0]]),
        scene.obstacle_field("human").query([[100.0, 0.0], [np.inf, 0.0]]),
    ):
        assert not sample.valid.any()
        assert (sample.distance == 0).all()


def test_fields_refuse_queries_of_another_shape(office):
    with pytest.raises(FieldError, match="no array of numbers"):
        office[1].obstacle_field("human").query([["left", "right"]])
    with pytest.raises(FieldError):
        office[1].ground_field.query([[0.0, 0.0]])
    with pytest.raises(FieldError):
        office[1].obstacle_field("human").query([0.0, 0.0])


@pytest.mark.parametrize("points", [np.full((3, 3), np.nan), [[1.0, 1.0, np.inf]], np.zeros((3, 2)), "here"])
def test_obstacles_that_would_be_dropped_are_refused(office, points):
    with pytest.raises(CloudError):
        office[1].with_obstacles(points)


def test_no_obstacles_are_none(office):
    none = office[1].with_obstacles(np.zeros((0, 3))).free_space("roomba")
    assert none.graph is office[1].free_space("roomba").graph


def test_what_is_put_in_after_something_else_is_put_in_beside_it(office):
    one, other = np.array([[2.0, 2.0, 0.05]]), np.array([[3.0, 2.0, 0.05]])
    both = office[1].with_obstacles(one).with_obstacles(other)
    np.testing.assert_array_equal(both.moving, np.concatenate([one, other]))
    assert (both.free_space("roomba").levels[0].clearance(both.moving[:, :2])[0] == 0.0).all()
    assert (office[1].free_space("roomba").levels[0].clearance(both.moving[:, :2])[0] > 0.0).all()


def test_what_moves_is_not_written(office, tmp_path):
    scene = office[1].with_obstacles([[2.0, 2.0, 0.05]])
    scene.free_space("roomba")
    scene.save(tmp_path / "scene.gpdf")
    back = gpdf.load_scene(tmp_path / "scene.gpdf").free_space("roomba")
    assert len(back.graph.position) == len(office[1].free_space("roomba").graph.position)
    assert back.levels[0].clearance(np.array([[2.0, 2.0]]))[0] > 0.0


def test_the_level_is_the_highest_ground_under_a_point():
    def flat(z):
        return HeightMap(np.zeros(2), 0.1, np.full((10, 10), z, "f4"), np.ones((10, 10), "u1"))

    surfaces = (flat(0.0), flat(2.8))
    points = np.array([[0.5, 0.5, z] for z in (-1.0, 0.0, 2.0, 2.75, 3.0)] + [[9.0, 9.0, 0.0]])
    assert level_under(surfaces, points).tolist() == [0, 0, 0, 1, 1, -1]


def test_threads_that_ask_at_once_share_one_free_space(office):
    _, scene = office
    scene.forget_agents()
    found = []
    threads = [threading.Thread(target=lambda: found.append(scene.free_space("spot"))) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len({id(space) for space in found}) == 1


def test_a_prepared_body_leaves_nothing_for_its_first_plan_to_build(office):
    made = office[0]
    scene = gpdf.build_scene(made.points, made.ground)
    scene.prepare("human")
    assert all(field.shaped for field in scene.ground_fields)
    spaces = scene.free_space("human")
    assert gpdf.plan(scene, made.start, made.goal).status is gpdf.Status.OK
    assert scene.free_space("human") is spaces


@pytest.mark.parametrize("between", [False, True])
def test_a_way_that_is_pulled_leaves_nothing_that_keeps_its_scene_until_somebody_looks_for_garbage(office, between):
    """In a service nobody looks for thousands of plans, and scenes come and go."""
    made, scene = office
    leg = Leg(0, np.array([made.start[:2], made.goal[:2]]), scene.free_space("human"))
    pull_cheaply(leg, Prefer.COMPANION, between=between)
    gc.collect()
    gc.disable()
    try:
        pull_cheaply(leg, Prefer.COMPANION, between=between)
        assert gc.collect() == 0
    finally:
        gc.enable()


def test_labels_must_fit_the_points():
    with pytest.raises(CloudError, match="one for each point"):
        gpdf.build_scene(np.zeros((10, 3)), np.ones(9, dtype=bool))


def test_the_public_names_are_those_of_the_design():
    for name in ("build_scene", "load_scene", "plan", "segment_ground", "AGENTS", "Agent", "Status"):
        assert hasattr(gpdf, name)
    with pytest.raises(AttributeError):
        _ = gpdf.nonsense
    assert {name: (a.height, a.width, a.length) for name, a in gpdf.AGENTS.items()} == {
        "roomba": (0.1, 0.34, 0.35),
        "spot": (0.7, 0.19, 1.1),
        "pepper": (1.2, 0.48, 0.42),
        "human": (2.0, 0.5, 0.32),
    }


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "start", "goal"),
    [("s3dis_office.npz", (2.4, 5.0), (5.0, 1.3)), ("cluttered_office_tls_1cm.npz", (6.6, 9.2), (9.9, 14.1))],
)
def test_a_human_crosses_the_real_offices(scan, name, start, goal):
    cloud = gpdf.read_cloud(scan(name))
    scene = gpdf.build_scene(cloud.points, cloud.ground)
    result = gpdf.plan(scene, start, goal, "human")
    assert result.status is gpdf.Status.OK, result.message
    assert result.certificate.holds

"""A scene that changes: the next version equals a scene built from scratch."""

import numpy as np
import pytest

import gpdf_service as gpdf
from gpdf_service.errors import CloudError
from gpdf_service.synthetic import SCENES


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
    one, other = blocked.free_space("human").quadtrees[0], scratch.free_space("human").quadtrees[0]
    np.testing.assert_array_equal(one.center[one.free], other.center[other.free])


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

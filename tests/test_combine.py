import json

import numpy as np
import pytest

import gpdf_service as gpdf
from gpdf_service.cli import main
from gpdf_service.combine import crop_scene, merge_scenes, within_box, within_polygon
from gpdf_service.errors import CloudError, NoGroundError


@pytest.fixture(scope="module")
def hall():
    x, y = np.meshgrid(np.arange(0, 6, 0.05), np.arange(0, 3, 0.05))
    floor = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    table = floor[(x.ravel() > 4) & (x.ravel() < 5) & (y.ravel() > 1) & (y.ravel() < 2)] + [0, 0, 0.7]
    return gpdf.build_scene(np.concatenate([floor, table]))


def test_a_part_keeps_the_ground_of_the_whole(hall):
    inside = within_box(hall.points, (4.0, 1.0), (5.0, 2.0))
    part = crop_scene(hall, inside)
    np.testing.assert_array_equal(part.points, hall.points[inside])
    assert (part.points[part.ground, 2] == 0).all()
    table = within_box(hall.points, (0.0, 0.0, 0.5), (6.0, 3.0, 1.0))
    with pytest.raises(NoGroundError):  # by itself it would be a floor
        crop_scene(hall, table)


def test_parts_put_together_are_the_whole(hall):
    west = crop_scene(hall, within_box(hall.points, (0.0, 0.0), (3.5, 3.0)))
    east = crop_scene(hall, within_polygon(hall.points, np.array([[2.9, -1], [7, -1], [7, 4], [2.9, 4]])))
    both = merge_scenes([west, east])
    assert both.labelled
    assert {tuple(point) for point in both.points.tolist()} == {tuple(point) for point in hall.points.tolist()}
    assert len(both.points) == len(hall.points)
    assert both.ground.sum() == hall.ground.sum()
    assert gpdf.plan(west, (1.0, 1.5), (3.0, 1.5)).status is gpdf.Status.OK
    assert gpdf.plan(west, (1.0, 1.5), (5.5, 2.5)).status is gpdf.Status.GOAL_OUTSIDE_MAP
    assert gpdf.plan(both, (1.0, 1.5), (5.5, 2.5)).status is gpdf.plan(hall, (1.0, 1.5), (5.5, 2.5)).status


def test_a_merge_without_labels_finds_the_ground_in_the_whole(hall):
    table = hall.points[hall.points[:, 2] > 0.5]
    alone = gpdf.build_scene(table)  # taken for a floor
    assert alone.ground.any()
    both = merge_scenes([gpdf.build_scene(hall.points[hall.points[:, 2] < 0.5]), alone])
    assert not both.labelled
    assert (both.points[both.ground, 2] == 0).all()


def test_a_polygon_holds_what_its_outline_encloses():
    corners = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [2.0, 1.0], [0.0, 4.0]])
    points = np.array([[0.5, 1.0, 9.0], [2.0, 3.0, 0.0], [3.8, 3.5, 0.0], [2.0, 0.5, 0.0], [5.0, 1.0, 0.0]])
    assert within_polygon(points, corners).tolist() == [True, False, True, True, False]
    np.testing.assert_array_equal(within_polygon(points, corners[::-1]), within_polygon(points, corners))


def test_what_cannot_be_cut_out_is_refused(hall):
    with pytest.raises(CloudError, match="no point lies inside"):
        crop_scene(hall, within_box(hall.points, (10.0, 10.0), (11.0, 11.0)))
    with pytest.raises(CloudError, match="least coordinates first"):
        within_box(hall.points, (2.0, 0.0), (1.0, 3.0))
    with pytest.raises(CloudError, match="2 corners"):
        within_polygon(hall.points, np.zeros((2, 2)))


def test_the_verbs_crop_and_merge(hall, tmp_path, capsys):
    whole, west, east, both = (str(tmp_path / f"{name}.gpdf") for name in ("hall", "west", "east", "both"))
    hall.save(whole)
    assert main(["scene", "crop", whole, "--box", "-1,-1,3,4", "--out", west, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["extent"][1][0] <= 3.0
    assert main(["scene", "crop", whole, "--polygon", "2.9,-1 7,-1 7,4 2.9,4", "--out", east]) == 0
    assert main(["scene", "merge", west, east, "--out", both, "--json"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["points"] == len(hall.points)
    assert len(gpdf.load_scene(both).points) == len(hall.points)
    assert main(["scene", "crop", whole, "--box", "50,50,51,51", "--out", west, "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["error"] == "CloudError"
    assert main(["scene", "merge", whole, "--out", both]) == 1
    assert "two" in capsys.readouterr().err
    with pytest.raises(SystemExit) as stop:
        main(["scene", "crop", whole, "--box", "1,2,3", "--out", west])
    assert stop.value.code == 2

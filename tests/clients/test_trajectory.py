import csv
import json

import numpy as np
import pytest
from gpdf_client import Trajectory
from gpdf_client.cli import table, told

import gpdf_service


@pytest.fixture
def corner():
    """3 m along x in 3 s, then 4 m along y in 8 s, 2 m over the ground."""
    ground = np.array([[0.0, 0, 0], [3, 0, 0], [3, 4, 0]])
    return Trajectory(
        ground + np.array([0, 0, 2]), ground, np.array([0.0, 3, 11]), np.array([0.0, np.pi / 4, np.pi / 2])
    )


def test_length_and_duration_are_those_of_the_polyline(corner):
    assert corner.length == 7.0
    assert corner.duration == 11.0
    np.testing.assert_array_equal(corner.arc_lengths, [0, 3, 7])


def test_samples_lie_between_the_waypoints(corner):
    by_time, by_length = corner.at_times([1.5, 7.0]), corner.at_lengths([1.5, 5.0])
    np.testing.assert_allclose(by_time.ground, [[1.5, 0, 0], [3, 2, 0]])
    np.testing.assert_allclose(by_time.positions, by_length.positions)
    np.testing.assert_allclose(by_length.times, [1.5, 7.0])
    np.testing.assert_allclose(by_length.headings, [np.pi / 8, 3 * np.pi / 8])


def test_samples_outside_are_the_ends(corner):
    np.testing.assert_array_equal(corner.at_times([-1.0, 99.0]).ground, corner.ground[[0, -1]])
    np.testing.assert_array_equal(corner.at_lengths([-1.0, 99.0]).ground, corner.ground[[0, -1]])


def test_a_heading_is_interpolated_the_short_way_round():
    ground = np.array([[0.0, 0, 0], [-1, 0, 0]])
    path = Trajectory(ground, ground, np.array([0.0, 1]), np.array([np.pi - 0.1, -np.pi + 0.1]))
    assert np.cos(path.at_times([0.5]).headings[0]) == pytest.approx(-1.0)


def test_a_cut_keeps_its_waypoints_and_starts_at_time_zero(corner):
    piece = corner.cut(1.0, 5.0)
    np.testing.assert_allclose(piece.ground, [[1, 0, 0], [3, 0, 0], [3, 2, 0]])
    np.testing.assert_allclose(piece.times, [0, 2, 6])
    assert piece.length == pytest.approx(4.0)
    assert corner.cut(-5, 99).length == corner.length
    assert corner.cut(0, 3).length + corner.cut(3, 7).length == pytest.approx(corner.length)


@pytest.mark.parametrize("ends", [(2.0, 2.0), (5.0, 1.0), (8.0, 9.0), (float("nan"), 1.0)])
def test_an_empty_cut_is_refused(corner, ends):
    with pytest.raises(ValueError, match="nothing lies between"):
        corner.cut(*ends)


def test_json_comes_back_equal(corner, tmp_path):
    corner.save(tmp_path / "path.json")
    back = Trajectory.load(tmp_path / "path.json")
    for name in ("positions", "ground", "times", "headings"):
        np.testing.assert_array_equal(getattr(back, name), getattr(corner, name))


def test_csv_and_geojson_hold_every_waypoint(corner, tmp_path):
    corner.save(tmp_path / "path.csv")
    with (tmp_path / "path.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["time"]) for row in rows] == corner.times.tolist()
    assert [[float(row[key]) for key in ("ground_x", "ground_y", "ground_z")] for row in rows] == corner.ground.tolist()
    corner.save(tmp_path / "path.geojson")
    feature = json.loads((tmp_path / "path.geojson").read_text())
    assert feature["geometry"] == {"type": "LineString", "coordinates": corner.ground.tolist()}
    assert feature["properties"]["times"] == corner.times.tolist()


def test_another_kind_of_file_is_refused(corner, tmp_path):
    with pytest.raises(ValueError, match=r"saved as \.json"):
        corner.save(tmp_path / "path.xml")


def test_a_trajectory_is_told_in_a_line():
    t = np.linspace(0.0, 8.0, 300)
    line = np.column_stack([t, t * 0.0, t * 0.0])
    assert repr(Trajectory(line, line, t, t)) == "Trajectory(300 waypoints, 8.00 m, 8.0 s)"
    ends = "(0.00, 0.00, 0.00) to (8.00, 0.00, 0.00)"
    served = gpdf_service.types.Trajectory(line, line, t, t)
    assert repr(served) == f"Trajectory(8.00 m in 8.0 s, 300 waypoints, {ends})"


def test_facts_are_a_table_for_people():
    facts = {"office": {"points": 7, "noise": 30.07500000000001, "levels": [1, 2]}, "b": {"points": 123456}}
    rows = ["scene   points  noise  levels", "office  7       30.08  2", "b       123456"]
    assert table(facts, ("points", "noise", "levels")) == rows
    assert table({}) == []
    assert told({"x": [1.23456789, 2.0]}) == "x 1.235 2"

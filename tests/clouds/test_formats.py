"""Clouds as they come: twelve kinds of files, and what is read from each when it is not as it should be."""

import json
import struct

import laspy
import numpy as np
import open3d
import pye57
import pytest
import trimesh

from gpdf_service.cli import main
from gpdf_service.clouds import formats, read_cloud
from gpdf_service.clouds.frame import UP, look, odd_unit, odd_up, turn
from gpdf_service.errors import CloudError
from gpdf_service.synthetic import SCENES, Box, World

OFFICE = SCENES["office"](np.random.default_rng(0), spacing=0.12).points
WITH_NAN = np.insert(OFFICE, [0, 7, 7, len(OFFICE)], np.nan, axis=0)
CENTIMETRES = OFFICE * 100.0
Y_UP = OFFICE[:, [0, 2, 1]] * [1.0, 1.0, -1.0]


def write_open3d(path, points):
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    open3d.io.write_point_cloud(str(path), cloud)


def write_las(path, points):
    made = laspy.create()
    made.header.scales = np.full(3, 1e-4)
    made.x, made.y, made.z = points.T
    made.write(path)


def write_e57(path, points, station=(0.0, 0.0, 0.0)):
    with pye57.E57(str(path), mode="w") as file:
        data = {f"cartesian{axis}": points[:, i] - station[i] for i, axis in enumerate("XYZ")}
        file.write_scan_raw(data, translation=np.array(station))


def write_text(path, points, comma=","):
    path.write_text("\n".join(comma.join(f"{value:.4f}" for value in point) for point in points))


WRITERS = {
    ".ply": write_open3d,
    ".pcd": write_open3d,
    ".xyz": lambda path, points: np.savetxt(path, points),
    ".txt": lambda path, points: np.savetxt(path, np.column_stack([points, np.ones(len(points))]), header="x y z i"),
    ".csv": lambda path, points: np.savetxt(path, points, delimiter=",", header="x,y,z", comments=""),
    ".npy": np.save,
    ".npz": lambda path, points: np.savez(path, xyz=points),
    ".las": write_las,
    ".laz": write_las,
    ".e57": write_e57,
}
HOLDS_NAN = [kind for kind in WRITERS if kind not in (".las", ".laz", ".e57")]  # whole numbers, or a flag


def boxes(points=None, scale=1.0):
    """A room of 4 x 3 x 2.5 m with a table in it, as a mesh."""
    room = trimesh.creation.box((4.0, 3.0, 2.5))
    table = trimesh.creation.box((1.2, 0.8, 0.1))
    table.apply_translation((0.0, 0.0, -0.6))
    both = trimesh.util.concatenate([room, table])
    both.apply_scale(scale)
    return both


@pytest.mark.parametrize("kind", WRITERS)
def test_every_kind_holds_the_same_points(kind, tmp_path):
    WRITERS[kind](tmp_path / f"cloud{kind}", OFFICE)
    cloud = read_cloud(tmp_path / f"cloud{kind}")
    np.testing.assert_allclose(cloud.points, OFFICE, atol=1e-4)
    assert (cloud.dropped, cloud.scale, cloud.up) == (0, 1.0, "z")
    assert [words for words in cloud.remarks if "scan(s)" not in words] == []


@pytest.mark.parametrize("kind", HOLDS_NAN)
def test_what_is_not_finite_is_left_out_and_counted(kind, tmp_path):
    WRITERS[kind](tmp_path / f"cloud{kind}", WITH_NAN)
    cloud = read_cloud(tmp_path / f"cloud{kind}")
    np.testing.assert_allclose(cloud.points, OFFICE, atol=1e-4)
    assert cloud.dropped == 4
    assert "4 points were not finite and left out" in cloud.remarks


@pytest.mark.parametrize("kind", WRITERS)
def test_centimetres_are_refused_whatever_the_standard_says_and_read_when_they_are_said(kind, tmp_path):
    WRITERS[kind](tmp_path / f"cloud{kind}", CENTIMETRES)
    with pytest.raises(CloudError, match=r"is it in centimetres\? --scale 0.01"):
        read_cloud(tmp_path / f"cloud{kind}")
    assert read_cloud(tmp_path / f"cloud{kind}", scale=1.0).scale == 1.0
    np.testing.assert_allclose(read_cloud(tmp_path / f"cloud{kind}", scale=0.01).points, OFFICE, atol=1e-4)


@pytest.mark.parametrize("kind", WRITERS)
def test_another_up_axis_is_said_and_read_when_it_is_known(kind, tmp_path):
    WRITERS[kind](tmp_path / f"cloud{kind}", Y_UP)
    assert any("is y up? --up y" in words for words in read_cloud(tmp_path / f"cloud{kind}").remarks)
    cloud = read_cloud(tmp_path / f"cloud{kind}", up="y")
    np.testing.assert_allclose(cloud.points, OFFICE * [1.0, 1.0, 1.0], atol=1e-4)
    assert [words for words in cloud.remarks if "scan(s)" not in words] == []


@pytest.mark.parametrize("as_text", [False, True])
@pytest.mark.parametrize("share", [0.03, 0.5, 0.97])
def test_a_ply_that_ends_before_its_last_point_is_refused(as_text, share, tmp_path):
    """Open3D reads it, and gives what lay in memory for the points that are missing."""
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(OFFICE))
    cloud.colors = open3d.utility.Vector3dVector(np.zeros_like(OFFICE))
    whole = tmp_path / "whole.ply"
    open3d.io.write_point_cloud(str(whole), cloud, write_ascii=as_text)
    assert len(read_cloud(whole).points) == len(OFFICE)
    written = whole.read_bytes()
    whole.write_bytes(written[: int(share * len(written))])
    with pytest.raises(CloudError, match=rf"it ends after \d+ of {len(OFFICE)} rows of its element 'vertex'"):
        read_cloud(whole)


def test_a_ply_whose_faces_or_cameras_come_with_its_points_is_read(tmp_path):
    """Elements before the vertices are passed over, what comes behind does not matter, and a last line needs no end."""
    first = "ply\nformat ascii 1.0\nelement camera 1\nproperty float f\nelement vertex {}\n"
    rows = "\n".join(" ".join(f"{value:.3f}" for value in point) for point in OFFICE)
    head = first.format(len(OFFICE)) + "".join(f"property float {axis}\n" for axis in "xyz") + "end_header\n1.5\n"
    (tmp_path / "cameras.ply").write_text(head + rows)
    assert len(read_cloud(tmp_path / "cameras.ply").points) == len(OFFICE)
    (tmp_path / "cameras.ply").write_text(head + rows.rpartition("\n")[0])
    with pytest.raises(CloudError, match="it ends after"):
        read_cloud(tmp_path / "cameras.ply")
    boxes().export(tmp_path / "faces.ply")
    assert len(read_cloud(tmp_path / "faces.ply").points) == len(boxes().vertices)


@pytest.mark.parametrize("kind", [".npy", ".npz", ".las"])
def test_a_file_without_a_point_is_refused_in_words(kind, tmp_path):
    WRITERS[kind](tmp_path / f"cloud{kind}", OFFICE[:0])
    with pytest.raises(CloudError, match="it holds no point"):
        read_cloud(tmp_path / f"cloud{kind}")


@pytest.mark.parametrize("comma", [",", ";", " , ", "\t"])
def test_text_is_read_with_commas_semicolons_and_tabs(comma, tmp_path):
    write_text(tmp_path / "cloud.xyz", OFFICE, comma)
    np.testing.assert_allclose(read_cloud(tmp_path / "cloud.xyz").points, OFFICE, atol=1e-4)


def test_text_with_names_decimal_commas_and_holes_is_read(tmp_path):
    (tmp_path / "a.csv").write_text("id;Z;X;Y\n1;0,5;1,25;2,0\n2;0,5;;2,0\n3;1,0;3,5;4,0\n")
    cloud = read_cloud(tmp_path / "a.csv")
    np.testing.assert_allclose(cloud.points, [[1.25, 2.0, 0.5], [3.5, 4.0, 1.0]])
    assert cloud.dropped == 1
    (tmp_path / "b.pts").write_text("2\n// made by hand\n1 2 3 90 255 255 255\n4 5 6 90 255 255 255\n")
    np.testing.assert_allclose(read_cloud(tmp_path / "b.pts").points, [[1, 2, 3], [4, 5, 6]])


@pytest.mark.parametrize("kind", [*WRITERS, ".obj", ".stl", ".glb", ".dae"])
def test_an_empty_file_is_refused_in_words(kind, tmp_path):
    (tmp_path / f"cloud{kind}").write_bytes(b"")
    with pytest.raises(CloudError):
        read_cloud(tmp_path / f"cloud{kind}")


@pytest.mark.parametrize("kind", [".obj", ".stl", ".off"])
def test_a_mesh_is_sampled_as_densely_as_a_scan(kind, tmp_path, monkeypatch):
    monkeypatch.setattr(formats, "MOST_SAMPLES", 300_000)  # which the room in centimetres has more of in metres
    boxes().export(tmp_path / f"room{kind}")
    cloud = read_cloud(tmp_path / f"room{kind}")
    np.testing.assert_allclose(np.ptp(cloud.points, axis=0), [4.0, 3.0, 2.5], atol=0.01)
    assert len(cloud.points) == pytest.approx(boxes().area / 0.015**2, rel=0.01)
    assert "faces" in cloud.remarks[0]
    boxes(scale=100.0).export(tmp_path / f"large{kind}")
    with pytest.raises(CloudError, match="centimetres"):
        read_cloud(tmp_path / f"large{kind}")
    assert len(read_cloud(tmp_path / f"large{kind}", scale=0.01).points) == pytest.approx(len(cloud.points), rel=0.01)


@pytest.mark.parametrize("kind", [".glb", ".dae"])
def test_a_mesh_that_says_its_axis_is_turned(kind, tmp_path):
    made = boxes()
    made.apply_transform(np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1.0]]))  # y up, as glTF has it
    made.export(tmp_path / f"room{kind}")
    if kind == ".dae":
        text = (tmp_path / "room.dae").read_text()
        (tmp_path / "room.dae").write_text(text.replace("Z_UP", "Y_UP"))
    cloud = read_cloud(tmp_path / f"room{kind}")
    np.testing.assert_allclose(np.ptp(cloud.points, axis=0), [4.0, 3.0, 2.5], atol=0.01)
    assert cloud.up == "y"
    table = np.abs(cloud.points[:, :2]).max(axis=1) < 0.3
    assert (cloud.points[table, 2] < 0.0).mean() > 0.5  # below the middle


def test_scans_of_an_e57_file_know_where_their_rays_began(tmp_path):
    write_e57(tmp_path / "cloud.e57", OFFICE, station=(2.0, 1.0, 1.5))
    cloud = read_cloud(tmp_path / "cloud.e57")
    np.testing.assert_allclose(cloud.points, OFFICE, atol=1e-6)
    np.testing.assert_allclose(cloud.origins, np.broadcast_to([2.0, 1.0, 1.5], OFFICE.shape))
    turned = read_cloud(tmp_path / "cloud.e57", up="y", scale=2.0)
    np.testing.assert_allclose(turned.origins[0], [4.0, -3.0, 2.0])


def test_labels_go_with_their_points(tmp_path):
    ground = WITH_NAN[:, 2] < 0.01
    np.savez(tmp_path / "cloud.npz", xyz=WITH_NAN, label=ground.astype(int), classes=np.array(["other", "floor"]))
    cloud = read_cloud(tmp_path / "cloud.npz")
    np.testing.assert_array_equal(cloud.ground, cloud.points[:, 2] < 0.01)


@pytest.mark.parametrize("up", UP)
def test_every_up_axis_is_a_rotation(up):
    turned = turn(np.eye(3), 1.0, up)
    assert np.linalg.det(turned) == pytest.approx(1.0)
    axis, sign = "xyz".index(up[-1]), -1.0 if up.startswith("-") else 1.0
    np.testing.assert_array_equal(turned[axis], [0.0, 0.0, sign])


@pytest.mark.parametrize(("up", "scale"), [("w", 1.0), ("z", 0.0), ("z", -1.0), ("z", np.nan)])
def test_an_axis_or_a_unit_that_is_none_is_refused_before_the_file_is_read(up, scale, tmp_path):
    with pytest.raises(CloudError, match="frame"):
        read_cloud(tmp_path / "none.npz", up=up, scale=scale)


@pytest.mark.parametrize("name", ["office", "cluttered_office", "cow_and_lady", "cave", "stair"])
def test_what_is_as_it_should_be_is_not_called_odd(name):
    made = look(SCENES[name](np.random.default_rng(0)).points)
    assert (odd_unit(made), odd_up(made)) == (("", False), "")


@pytest.mark.parametrize("name", ["office", "cluttered_office", "cow_and_lady"])
def test_a_room_says_its_unit_and_its_axis(name):
    points = SCENES[name](np.random.default_rng(0), spacing=0.05).points
    for unit, scale in (("millimetres", 0.001), ("centimetres", 0.01), ("inches", 0.0254), ("kilometres", 1000.0)):
        words, impossible = odd_unit(look(points / scale))
        assert impossible
        assert f"{unit}? --scale {scale:g}" in words
    words, impossible = odd_unit(look(points / 0.3048))
    assert ("in feet? --scale 0.3048" in words, impossible) == (True, False)
    assert "is x up" in odd_up(look(points[:, [2, 0, 1]]))
    assert "is z down" in odd_up(look(points * [1.0, -1.0, -1.0]))


@pytest.mark.parametrize("name", ["office", "cluttered_office"])
def test_furniture_says_feet_where_there_is_no_ceiling(name):
    points = SCENES[name](np.random.default_rng(0), spacing=0.05).points
    points = points[points[:, 2] < 1.9]
    assert odd_unit(look(points)) == ("", False)
    words, impossible = odd_unit(look(points / 0.3048))
    assert ("seats and tables if it is in feet" in words, impossible) == (True, False)
    assert "--scale 0.3048" in words


def test_roofs_over_stalls_and_steps_are_no_furniture_in_feet():
    rng = np.random.default_rng(0)
    market = Box((1.0, 1.0, 0.7), (3.0, 2.0, 0.75)), Box((1.0, 1.0, 2.3), (3.0, 2.0, 2.35))
    points, _ = World((6.0, 4.0, 2.7), market).sample(0.05, rng)
    assert odd_unit(look(points[points[:, 2] < 2.6])) == ("", False)
    treads = tuple(Box((0.3 * i, 0.0, 0.0), (0.3 * i + 0.3, 4.0, 0.17 * (i + 1))) for i in range(14))
    points, _ = World((6.0, 4.0, 4.0), treads).sample(0.05, rng)
    assert odd_unit(look(points[points[:, 2] < 3.9])) == ("", False)


@pytest.mark.parametrize(("unit", "scale"), [("centimetres", 0.01), ("inches", 0.0254)])
def test_a_room_whose_points_are_dense_and_that_has_no_ceiling_says_that_it_is_too_high(unit, scale):
    """As a mesh that states no unit is sampled."""
    points = np.asarray(trimesh.sample.sample_surface(boxes(), 1_000_000, seed=0)[0])
    points = points[points[:, 2] < 1.1]
    assert odd_unit(look(points)) == ("", False)
    words, impossible = odd_unit(look(points / scale))
    assert (f"m high, and wider: is it in {unit}? --scale {scale}" in words, impossible) == (True, False)
    strays = np.array([[0.0, 0.0, 300.0], [300.0, 0.0, 0.0], [0.0, 300.0, 0.0]])
    assert "m high" not in odd_unit(look(np.concatenate([points[::50], strays])))[0]


@pytest.mark.parametrize("things", [(), (Box((2.0, 1.0, 0.0), (3.0, 2.0, 0.75)),)], ids=["bare", "with a table"])
def test_a_place_without_a_ceiling_says_that_z_is_down(things):
    points, _ = World((6.0, 4.0, 2.7), things).sample(0.05, np.random.default_rng(0))
    points = points[points[:, 2] < 2.65]
    assert odd_up(look(points)) == ""
    assert "is z down? --up -z" in odd_up(look(points * [1.0, -1.0, -1.0]))


def test_info_says_how_it_took_the_cloud(tmp_path, capsys):
    np.save(tmp_path / "cloud.npy", np.insert(CENTIMETRES, 3, np.inf, axis=0)[:, [0, 2, 1]] * [1.0, 1.0, -1.0])
    words = ["scene", "info", str(tmp_path / "cloud.npy")]
    assert main(words) == 1
    assert "centimetres" in capsys.readouterr().err
    assert main([*words, "--scale", "0.01", "--up", "y"]) == 0
    first = capsys.readouterr().out.splitlines()[0]
    assert first == "cloud    taken in units of 0.01 m, y up; 1 points were not finite and left out"
    assert main([*words, "--scale", "0.01", "--up", "y", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)["cloud"]
    assert (told["scale"], told["up"], told["dropped"]) == (0.01, "y", 1)


def test_damaged_files_are_refused_in_words(tmp_path):
    (tmp_path / "a.glb").write_bytes(struct.pack("<4sII", b"glTF", 2, 1000))
    (tmp_path / "b.stl").write_bytes(b"\0" * 90)
    (tmp_path / "c.e57").write_bytes(b"ASTM-E57" + bytes(100))
    (tmp_path / "d.csv").write_text("name,age\nanna,7\n")
    np.save(tmp_path / "e.npy", np.zeros((5, 2)))
    (tmp_path / "f.obj").write_text("v 0 0 0\nv 1 0 0\n")
    for file in sorted(tmp_path.iterdir()):
        with pytest.raises(CloudError):
            read_cloud(file)

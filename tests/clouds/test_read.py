import pickle
from decimal import Decimal

import laspy
import numpy as np
import open3d
import pytest

from gpdf_service.clouds import check_points, read_cloud
from gpdf_service.errors import CloudError

POINTS = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.5], [2.0, 1.0, 1.5]])


@pytest.mark.parametrize("suffix", [".ply", ".pcd", ".xyz"])
def test_open3d_formats_are_read(tmp_path, suffix):
    path = tmp_path / f"cloud{suffix}"
    open3d.io.write_point_cloud(path, open3d.geometry.PointCloud(open3d.utility.Vector3dVector(POINTS)))
    cloud = read_cloud(path)
    np.testing.assert_allclose(cloud.points, POINTS, atol=1e-6)
    assert cloud.ground is None


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_las_class_two_is_ground(tmp_path, suffix):
    path = tmp_path / f"cloud{suffix}"
    made = laspy.create()
    made.header.scales = np.full(3, 1e-4)
    made.x, made.y, made.z = POINTS.T
    made.classification = np.array([2, 2, 6, 6])
    made.write(path)
    cloud = read_cloud(path)
    np.testing.assert_allclose(cloud.points, POINTS, atol=1e-4)
    assert cloud.ground.tolist() == [True, True, False, False]
    assert read_cloud(path, ground_label=6).ground.tolist() == [False, False, True, True]


@pytest.mark.parametrize(("offset", "scale"), [(0.0, 1e-3), (500_000.0, 1e-2), (-12.5, 1e-4), (7.25, 0.3)])
def test_the_decimals_of_a_las_file_are_read_as_they_are_meant(tmp_path, offset, scale):
    whole, header = np.random.default_rng(0).integers(-5000, 5000, (100, 3)), laspy.LasHeader()
    header.scales, header.offsets = np.full(3, scale), np.full(3, offset)
    made = laspy.LasData(header)
    made.X, made.Y, made.Z = whole.T
    made.write(tmp_path / "a.laz")
    points = read_cloud(tmp_path / "a.laz").points
    meant = [float(Decimal(repr(scale)) * int(number) + Decimal(repr(offset))) for number in whole.ravel()]
    np.testing.assert_allclose(points.ravel(), meant, rtol=1e-15)
    if scale != 0.3:  # the others are whole parts of a metre
        np.testing.assert_array_equal(points.ravel(), meant)


def test_npz_labels_are_found_by_class_name(tmp_path):
    path = tmp_path / "cloud.npz"
    np.savez(path, xyz=POINTS, label=[1, 1, 0, 2], classes=np.array(["ceiling", "floor", "wall"]))
    assert read_cloud(path).ground.tolist() == [True, True, False, False]
    assert read_cloud(path, ground_label=2).ground.tolist() == [False, False, False, True]


def test_npz_without_labels_has_no_ground(tmp_path):
    np.savez(tmp_path / "cloud.npz", xyz=POINTS)
    assert read_cloud(tmp_path / "cloud.npz").ground is None


def test_files_that_cannot_be_used_are_refused_in_words(tmp_path):
    np.savez(tmp_path / "column.npz", abc=POINTS)
    np.savez(tmp_path / "label.npz", xyz=POINTS, label=[0, 0, 0, 0], classes=np.array(["floor"]))
    np.savez(tmp_path / "plain.npz", xyz=POINTS)
    (tmp_path / "text.npz").write_text("hello")
    (tmp_path / "empty.ply").write_text("")
    (tmp_path / "broken.las").write_bytes(b"LASF")
    (tmp_path / "cloud.xls").write_text("1 2 3")
    for name, options, message in (
        ("none.ply", {}, "no such file"),
        ("cloud.xls", {}, "not known"),
        ("column.npz", {}, "no column xyz"),
        ("label.npz", {"ground_label": 7}, "no point is labelled 7"),
        ("plain.npz", {"ground_label": 1}, "no column label"),
        ("text.npz", {}, "cannot be read"),
        ("empty.ply", {}, "it is empty"),
        ("broken.las", {}, "cannot be read"),
    ):
        with pytest.raises(CloudError, match=message):
            read_cloud(tmp_path / name, **options)


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.zeros((0, 3)), "empty"),
        (np.zeros((4, 2)), "shape"),
        ("hello", "no array of numbers"),
        ([[0.0, 0.0, np.nan], [0.0, 0.0, 0.0]], "1 of 2 points are not finite"),
        (POINTS * [6000.0, 1.0, 1.0], "millimetres"),
        (np.add(POINTS, [0.0, 5_600_000.0, 0.0]).astype(np.float32), "rounded to 0.5 m"),
    ],
)
def test_points_that_cannot_be_used_are_refused_in_words(points, message):
    with pytest.raises(CloudError, match=message):
        check_points(points)


def test_points_far_from_the_origin_are_taken_in_double_precision():
    far = np.add(POINTS, [500_000.123, 5_600_000.123, 100.0])
    np.testing.assert_array_equal(check_points(far), far)


@pytest.mark.parametrize("suffix", [".npz", ".npy", ".las", ".e57", ".ply", ".obj"])
@pytest.mark.parametrize("thin", [None, 0.1])
def test_a_file_of_something_else_is_refused_and_nobody_is_advised_to_run_it(tmp_path, suffix, thin):
    path = tmp_path / f"cloud{suffix}"
    for content in (b"hello", b"PK\x03\x04 half an archive", bytes(range(256)) * 4, pickle.dumps(["an object"])):
        path.write_bytes(content)
        with pytest.raises(CloudError) as refusal:
            read_cloud(path, thin=thin)
        assert "pickle" not in str(refusal.value)


def test_a_compressed_cloud_with_a_spoiled_byte_is_refused(tmp_path):
    path = tmp_path / "cloud.npz"
    np.savez_compressed(path, xyz=np.random.default_rng(0).normal(size=(1000, 3)))
    whole = bytearray(path.read_bytes())
    for at in range(100, len(whole) - 100, 997):
        spoiled = whole.copy()
        spoiled[at] ^= 0xFF
        path.write_bytes(spoiled)
        with pytest.raises(CloudError, match="cannot be read"):
            read_cloud(path)

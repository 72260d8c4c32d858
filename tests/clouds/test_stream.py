"""Clouds read in chunks, thinned by voxel."""

import subprocess
import sys

import laspy
import numpy as np
import open3d
import pytest

from gpdf_service.clouds import read_cloud, stream
from gpdf_service.clouds.stream import VoxelSieve, chunks_of
from gpdf_service.errors import CloudError


@pytest.fixture(autouse=True)
def small_chunks(monkeypatch):
    monkeypatch.setattr(stream, "CHUNK", 700)


@pytest.fixture
def points():
    return np.random.default_rng(0).uniform((-3, 0, 0), (3, 4, 1), (5000, 3)).astype(np.float32).astype(np.float64)


def write(path, points):
    labels = (points[:, 2] < 0.5).astype(np.uint8) * 2
    if path.suffix in (".las", ".laz"):
        made = laspy.create()
        made.header.scales = np.full(3, 1e-4)
        made.x, made.y, made.z = points.T
        made.classification = labels
        made.write(path)
    elif path.suffix == ".npz":
        np.savez(path, xyz=points.astype("f4"), label=labels // 2, classes=np.array(["other", "ground"]))
    else:
        cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
        open3d.io.write_point_cloud(path, cloud, write_ascii="text" in path.name)
    return path


@pytest.mark.parametrize("name", ["a.las", "a.laz", "a.npz", "a.ply", "a.pcd", "text.ply", "text.pcd", "a.xyz"])
def test_one_real_point_of_each_voxel_is_kept(tmp_path, points, name):
    path = write(tmp_path / name, points)
    assert (chunks_of(path) is None) == (name in ("text.ply", "text.pcd", "a.xyz"))
    whole, thinned = read_cloud(path), read_cloud(path, thin=0.5)
    voxels = {tuple(voxel) for voxel in np.floor(whole.points / 0.5).astype(int).tolist()}
    kept = np.floor(thinned.points / 0.5).astype(int)
    assert len(kept) == len(voxels) < len(points)
    assert {tuple(voxel) for voxel in kept.tolist()} == voxels
    held = {tuple(point): i for i, point in enumerate(whole.points.tolist())}
    rows = [held[tuple(point)] for point in thinned.points.tolist()]
    if whole.ground is None:
        assert thinned.ground is None
    else:
        np.testing.assert_array_equal(thinned.ground, whole.ground[rows])


def test_tiles_in_a_folder_are_one_cloud(tmp_path, points):
    whole = read_cloud(write(tmp_path / "whole.npz", points), thin=0.3)
    tiles = tmp_path / "tiles"
    tiles.mkdir()
    write(tiles / "a.npz", points[:2000])
    write(tiles / "b.npz", points[2000:])
    parts = read_cloud(tiles, thin=0.3)
    np.testing.assert_array_equal(parts.points, whole.points)
    np.testing.assert_array_equal(parts.ground, whole.ground)
    write(tiles / "c.ply", points[:10] + 100.0)
    assert read_cloud(tiles, thin=0.3).ground is None  # one tile has no labels
    with pytest.raises(CloudError, match="--thin"):
        read_cloud(tiles)


def test_far_coordinates_and_points_that_are_not_finite_do_no_harm():
    sieve = VoxelSieve(0.1)
    sieve.add(np.array([[5e5, 4e6, 100.0], [np.nan, 0, 0], [5e5 + 0.01, 4e6 + 0.01, 100.01], [5e5 + 1, 4e6, 100.0]]))
    assert len(sieve.result()[0]) == 2
    with pytest.raises(CloudError, match="apart"):
        sieve.add(np.zeros((1, 3)))


@pytest.mark.parametrize("name", ["a.npz", "a.ply", "a.pcd", "a.las"])
def test_a_file_that_ends_early_is_refused(tmp_path, points, name):
    path = write(tmp_path / name, points)
    raw = path.read_bytes()
    path.write_bytes(raw[: len(raw) // 2])
    with pytest.raises(CloudError, match="complete"):
        read_cloud(path, thin=0.5)


@pytest.mark.parametrize("width", [0.0, -1.0, np.nan, np.inf])
def test_a_width_of_no_sense_is_refused(tmp_path, points, width):
    with pytest.raises(CloudError, match="positive"):
        read_cloud(write(tmp_path / "a.npz", points), thin=width)


def test_memory_is_that_of_what_is_kept(tmp_path):
    """Three million points, 72 MB as read, of which 20 000 are kept; measured over what the imports take."""
    code = """
import resource, sys
import numpy as np
from gpdf_service.clouds import read_cloud
def peak():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
from gpdf_service.clouds import stream
stream.CHUNK = 50_000
read_cloud(sys.argv[2], thin=0.1)
before = peak()
print(len(read_cloud(sys.argv[1], thin=0.1).points), peak() - before)
"""
    rng = np.random.default_rng(0)
    big, small = (tmp_path / f"{count}.npz" for count in (3_000_000, 60_000))
    for path in (big, small):
        np.savez(path, xyz=rng.uniform((0, 0, 0), (20, 10, 0.1), (int(path.stem), 3)).astype(np.float32))
    words = [sys.executable, "-c", code, str(big), str(small)]
    count, grown = subprocess.run(words, capture_output=True, text=True, check=True).stdout.split()
    assert int(count) == 20_000
    assert float(grown) < 30.0

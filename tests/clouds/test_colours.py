"""The scan's own colours: read from every kind of file that has them, row by row, and from no other."""

import laspy
import numpy as np
import open3d
import pye57
import pytest
import trimesh

from gpdf_service.clouds import read_cloud, stream

COUNT = 300
"""Too few for a cloud to be called odd."""
RNG = np.random.default_rng(0)
POINTS = RNG.uniform((0, 0, 0), (4, 3, 2), (COUNT, 3)).round(3)
COLOURS = RNG.integers(0, 256, (COUNT, 3), dtype=np.uint8)
CHANNELS = "red", "green", "blue"


def write_open3d(path, points, colours):
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    cloud.colors = open3d.utility.Vector3dVector(colours / 255.0)
    open3d.io.write_point_cloud(str(path), cloud, write_ascii="text" in path.name)


def write_las(path, points, colours, depth=257):
    made = laspy.create(point_format=2)
    made.header.scales = np.full(3, 1e-3)
    made.x, made.y, made.z = points.T
    made.red, made.green, made.blue = depth * colours.astype(np.uint16).T
    made.write(path)


def write_e57(path, points, colours):
    data = {f"cartesian{axis}": points[:, i] for i, axis in enumerate("XYZ")}
    data |= {f"color{name.title()}": colours[:, i] for i, name in enumerate(CHANNELS)}
    with pye57.E57(str(path), mode="w") as file:
        file.write_scan_raw(data)


def write_table(path, points, colours, between=(), **how):
    columns = [points, *[np.full(len(points), value) for value in between], colours]
    np.savetxt(path, np.column_stack(columns), fmt="%.7g", **how)


def write_records(path, points, colours):
    kinds = [(axis, "f4") for axis in "xyz"] + [(name, "u1") for name in "rgb"]
    np.save(path, np.array([(*p, *c) for p, c in zip(points.tolist(), colours.tolist(), strict=True)], dtype=kinds))


WRITERS = {
    "a.ply": write_open3d,
    "text.ply": write_open3d,
    "a.pcd": write_open3d,
    "text.pcd": write_open3d,
    "a.las": write_las,
    "a.laz": write_las,
    "of8bits.las": lambda *args: write_las(*args, depth=1),
    "a.e57": write_e57,
    "a.npz": lambda path, points, colours: np.savez(path, xyz=points, rgb=colours),
    "shares.npz": lambda path, points, colours: np.savez(path, points=points, colors=colours / 255.0),
    "a.npy": write_records,
    "plain.npy": lambda path, points, colours: np.save(path, np.hstack([points, colours])),
    "a.xyz": write_table,
    "a.pts": lambda *args: write_table(*args, between=[-1200]),
    "a.csv": lambda *args: write_table(*args, delimiter=",", header="x,y,z,Red,Green,Blue", comments=""),
    "a.txt": lambda path, p, c: write_table(path, p, c / 255.0, between=[7, 8], header="x y z i n r g b"),
}


@pytest.mark.parametrize("name", WRITERS)
def test_each_kind_of_file_gives_its_points_the_colours_that_it_holds(name, tmp_path):
    WRITERS[name](tmp_path / name, POINTS, COLOURS)
    cloud = read_cloud(tmp_path / name)
    np.testing.assert_allclose(cloud.points, POINTS, atol=1e-3)
    np.testing.assert_array_equal(cloud.colours, COLOURS)
    assert cloud.colours.dtype == np.uint8


@pytest.mark.parametrize("name", ["a.xyz", "a.ply", "a.npz", "plain.npy"])
def test_points_that_are_left_out_take_their_colours_with_them(name, tmp_path):
    rows = [0, 7, COUNT]
    WRITERS[name](tmp_path / name, np.insert(POINTS, rows, np.nan, axis=0), np.insert(COLOURS, rows, 9, axis=0))
    cloud = read_cloud(tmp_path / name)
    assert cloud.dropped == 3
    np.testing.assert_array_equal(cloud.colours, COLOURS)


@pytest.mark.parametrize("name", WRITERS)
def test_read_in_chunks_each_point_that_is_kept_has_its_own_colour(name, tmp_path, monkeypatch):
    monkeypatch.setattr(stream, "CHUNK", 70)
    WRITERS[name](tmp_path / name, POINTS, COLOURS)
    whole, thinned = read_cloud(tmp_path / name), read_cloud(tmp_path / name, thin=0.8)
    assert 10 < len(thinned.points) < COUNT / 2
    held = {tuple(point): i for i, point in enumerate(whole.points.tolist())}
    rows = [held[tuple(point)] for point in thinned.points.tolist()]
    np.testing.assert_array_equal(thinned.colours, whole.colours[rows])


@pytest.mark.parametrize("darkest", [0, 200])
@pytest.mark.parametrize("name", ["a.las", "a.laz", "a.npz", "shares.npz"])
def test_a_chunk_that_is_dark_is_as_dark_as_in_the_whole(name, darkest, tmp_path, monkeypatch):
    monkeypatch.setattr(stream, "CHUNK", 70)
    deep = RNG.integers(0, 1 << 16, (COUNT, 3), dtype=np.uint16)
    deep[:100] = darkest
    if ".la" in name:
        write_las(tmp_path / name, POINTS, deep, depth=1)
    else:
        np.savez(tmp_path / name, xyz=POINTS, rgb=deep / np.float32(65535.0) if "shares" in name else deep)
    whole, kept = read_cloud(tmp_path / name), read_cloud(tmp_path / name, thin=1e-4)
    np.testing.assert_array_equal(whole.colours, np.rint(deep / 257.0))
    np.testing.assert_array_equal(kept.points, whole.points)
    np.testing.assert_array_equal(kept.colours, whole.colours)


def test_a_dark_tile_is_as_dark_as_it_is_beside_the_others(tmp_path):
    bright = RNG.integers(0, 1 << 16, (COUNT, 3), dtype=np.uint16)
    write_las(tmp_path / "a.las", POINTS, bright // 256, depth=1)
    write_las(tmp_path / "b.las", POINTS + 10.0, bright, depth=1)
    np.savez(tmp_path / "c.npz", xyz=POINTS + 20.0, rgb=COLOURS)  # of 8 bits, which say so
    cloud = read_cloud(tmp_path, thin=1e-4)
    np.testing.assert_array_equal(cloud.colours, [*np.rint(bright // 256 / 257.0), *np.rint(bright / 257.0), *COLOURS])


def test_colours_that_are_no_numbers_are_none(tmp_path):
    np.savez(tmp_path / "a.npz", xyz=POINTS, rgb=np.full(POINTS.shape, "red"))
    assert read_cloud(tmp_path / "a.npz").colours is None
    assert read_cloud(tmp_path / "a.npz", thin=0.1).colours is None


def test_tiles_without_colours_leave_none_to_the_others(tmp_path):
    np.savez(tmp_path / "a.npz", xyz=POINTS, rgb=COLOURS)
    np.savez(tmp_path / "b.npz", xyz=POINTS + 10.0, rgb=COLOURS)
    assert read_cloud(tmp_path, thin=0.1).colours is not None
    np.savez(tmp_path / "c.npz", xyz=POINTS + 20.0)
    assert read_cloud(tmp_path, thin=0.1).colours is None


@pytest.mark.parametrize("thin", [None, 0.01])
@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("normals.xyz", lambda path: write_table(path, POINTS, POINTS / np.linalg.norm(POINTS, axis=1)[:, None])),
        ("normals.npy", lambda path: np.save(path, np.hstack([POINTS, POINTS]))),
        ("axes.xyz", lambda path: write_table(path, POINTS, np.tile([0, 0, 1], (COUNT, 1)))),
        ("black.las", lambda path: write_las(path, POINTS, 0 * COLOURS)),
        ("grey.npz", lambda path: np.savez(path, xyz=POINTS, rgb=COLOURS[:, 0])),
        ("few.npz", lambda path: np.savez(path, xyz=POINTS, rgb=COLOURS[:-1])),
    ],
)
def test_what_is_no_colour_is_taken_for_none(name, write, thin, tmp_path):
    write(tmp_path / name)
    cloud = read_cloud(tmp_path / name, thin=thin)
    assert cloud.colours is None
    assert len(cloud.points) == COUNT


def test_a_line_without_its_colour_costs_the_colours_and_no_point(tmp_path):
    lines = [" ".join(f"{value:g}" for value in row) for row in np.hstack([POINTS, COLOURS])]
    lines[40] = " ".join(lines[40].split()[:4])
    (tmp_path / "a.xyz").write_text("\n".join(lines))
    cloud = read_cloud(tmp_path / "a.xyz")
    np.testing.assert_allclose(cloud.points, POINTS)
    assert cloud.colours is None


def test_a_painted_mesh_gives_the_points_of_each_face_its_colour(tmp_path):
    box = trimesh.creation.box((1.0, 1.0, 1.0))
    box.unmerge_vertices()  # a file keeps colours of vertices
    top = box.face_normals[:, 2] > 0.5
    box.visual.face_colors = np.where(top[:, None], [200, 10, 20, 255], [30, 40, 50, 255]).astype(np.uint8)
    box.export(tmp_path / "box.glb")
    cloud = read_cloud(tmp_path / "box.glb", up="z")
    within = np.abs(cloud.points[:, :2]).max(axis=1) < 0.49
    assert within.sum() > 1000
    expected = np.where(cloud.points[within, 2:] > 0.0, [200, 10, 20], [30, 40, 50])
    np.testing.assert_array_equal(cloud.colours[within], expected)
    box.visual = trimesh.visual.ColorVisuals()
    box.export(tmp_path / "plain.glb")
    plain = read_cloud(tmp_path / "plain.glb", up="z")
    assert plain.colours is None
    assert len(plain.points) == len(cloud.points)

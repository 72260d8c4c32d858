import numpy as np
import pytest
from gpdf_ros2 import messages
from rosbags.rosbag2 import StoragePlugin, Writer

from gpdf_service.cli import main
from gpdf_service.clouds import read_cloud
from gpdf_service.errors import CloudError

POINTS = np.random.default_rng(0).uniform(-3, 3, (200, 3))
STORAGES = [StoragePlugin.MCAP, StoragePlugin.SQLITE3]


def record(folder, clouds, storage=StoragePlugin.MCAP):
    """A bag with clouds by topic, each a list of (frame, points), and poses beside them."""
    with Writer(folder, version=9, storage_plugin=storage) as writer:
        pose = writer.add_connection("/pose", messages.POSE, typestore=messages._store)
        writer.write(pose, 1, messages.encode_pose("map", np.zeros(3), 0.0, 0))
        for topic, frames in clouds.items():
            connection = writer.add_connection(topic, messages.CLOUD, typestore=messages._store)
            for i, (frame, points) in enumerate(frames):
                writer.write(connection, 10 + i, messages.encode_cloud(frame, points, 10 + i))
    return folder


def file_in(folder):
    return next(path for path in folder.iterdir() if path.suffix in (".mcap", ".db3"))


@pytest.mark.parametrize("storage", STORAGES)
def test_the_last_cloud_of_a_bag_is_read_from_the_folder_and_from_its_file(tmp_path, storage):
    bag = record(tmp_path / "bag", {"/map": [("map", POINTS[:50]), ("map", POINTS)]}, storage)
    for path in (bag, file_in(bag)):
        cloud = read_cloud(path)
        np.testing.assert_allclose(cloud.points, POINTS, atol=1e-6)
        assert cloud.ground is None


def test_points_that_are_not_finite_are_left_out(tmp_path):
    points = POINTS.copy()
    points[3, 2] = np.inf
    bag = record(tmp_path / "bag", {"/map": [("map", points)]})
    assert len(read_cloud(bag).points) == len(POINTS) - 1


def test_of_several_topics_one_is_to_be_named(tmp_path):
    bag = record(tmp_path / "bag", {"/a": [("map", POINTS)], "/b": [("map", POINTS[:20])]})
    with pytest.raises(CloudError, match=r"/a, /b.*--topic"):
        read_cloud(bag)
    assert len(read_cloud(bag, topic="/b").points) == 20
    with pytest.raises(CloudError, match=r"/a, /b"):
        read_cloud(bag, topic="/c")


def test_what_is_no_scene_is_refused(tmp_path):
    with pytest.raises(CloudError, match="none"):
        read_cloud(record(tmp_path / "none", {}))
    with pytest.raises(CloudError, match="has no message"):
        read_cloud(record(tmp_path / "silent", {"/map": []}))
    with pytest.raises(CloudError, match="z is ahead"):
        read_cloud(record(tmp_path / "camera", {"/depth": [("camera_optical_frame", POINTS)]}))
    with pytest.raises(CloudError, match="no such file"):
        read_cloud(tmp_path / "absent.mcap")
    with pytest.raises(CloudError, match="no labels"):
        read_cloud(record(tmp_path / "bag", {"/map": [("map", POINTS)]}), ground_label=2)


@pytest.mark.parametrize("storage", STORAGES)
def test_a_damaged_bag_is_refused(tmp_path, storage):
    file = file_in(record(tmp_path / "bag", {"/map": [("map", POINTS)]}, storage))
    whole = file.read_bytes()
    for cut in (0, 10, len(whole) // 2):
        file.write_bytes(whole[:cut])
        with pytest.raises(CloudError, match=r"cannot be read|topics with"):
            read_cloud(file)


def test_a_bag_becomes_a_scene_on_the_command_line(tmp_path, capsys):
    x, y = np.meshgrid(np.arange(0, 4, 0.05), np.arange(0, 3, 0.05))
    floor = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    bag = record(tmp_path / "bag", {"/map": [("map", floor)], "/other": [("map", POINTS)]})
    assert main(["plan", str(bag), "--topic", "/map", "--start", "1,1", "--goal", "3,2", "--agent", "roomba"]) == 0
    assert "OK" in capsys.readouterr().out

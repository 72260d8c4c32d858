"""ROS 2 without ROS: keys, tokens, attachments and CDR byte for byte, and the exchange over real Zenoh sessions."""

import queue
import shutil
import signal
import struct
import subprocess
import sys
import time

import numpy as np
import pytest
import zenoh
from gpdf_client import Client, DecodeError, Trajectory
from gpdf_ros2 import Bridge, Dialect, Names, Topic, messages
from gpdf_ros2.topics import attachment, node_token, publisher_id
from zenoh.ext import Int64, z_serialize

from gpdf_service.ports import free_endpoint
from gpdf_service.service.server import Options, Server

STRING = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
NS = 1_000_000_000
CDR = b"\x00\x01\x00\x00"
"""The encapsulation header of little-endian plain CDR."""
PATIENCE = 300.0
"""[s] Until what never comes is given up: the first scene of a fresh installation is compiled for a minute."""


def header(stamp_ns):
    """A Header in frame "map": 16 bytes."""
    return struct.pack("<iII4s", stamp_ns // NS, stamp_ns % NS, 4, b"map\0")


def pose(x, y, z, heading, stamp_ns):
    """A PoseStamped: 72 bytes where the next free one is at a multiple of 8."""
    return header(stamp_ns) + struct.pack("<7d", x, y, z, 0, 0, np.sin(heading / 2), np.cos(heading / 2))


def test_keys_and_tokens_are_those_of_rmw_zenohs_design():
    """The examples of docs/design.md of ros2/rmw_zenoh."""
    chatter = Topic("/chatter", "std_msgs/msg/String", STRING)
    assert messages.topic("chatter", "std_msgs/msg/String").hash == STRING
    assert chatter.key(Dialect.RMW_ZENOH) == f"0/chatter/std_msgs::msg::dds_::String_/{STRING}"
    named = Topic("/robot1/chatter", "std_msgs/msg/String", STRING)
    assert named.key(Dialect.RMW_ZENOH) == f"0/robot1/chatter/std_msgs::msg::dds_::String_/{STRING}"
    session = "aac3178e146ba6f1fc6e6a4085e77f21"
    assert node_token(session, 2) == f"@ros2_lv/2/{session}/0/0/NN/%/%/gpdf"
    assert chatter.token("MS", session, 10, 2) == (
        f"@ros2_lv/2/{session}/0/10/MS/%/%/gpdf/%chatter/std_msgs::msg::dds_::String_/{STRING}/::,10:,:,:,,"
    )
    assert named.token("MP", session, 1).split("/")[9] == "%robot1%chatter"


def test_keys_of_the_dds_bridge_are_the_names():
    assert Topic("/robot1/plan", "nav_msgs/msg/Path", "x").key(Dialect.ROS2DDS) == "robot1/plan"


def test_hashes_are_those_that_ros_2_gives_these_types():
    expected = {
        messages.POSE: "RIHS01_10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8",
        messages.PATH: "RIHS01_1957a5bb3cee5da65c4e52e52b65a93df227efce4c20f8458b36e73066ca334b",
    }
    for kind, value in expected.items():
        assert messages.topic("x", kind).hash == value


@pytest.mark.parametrize("name", ["", "/", "a b", "//a", "a//b", "1a", "a/*"])
def test_a_name_that_is_none_is_refused(name):
    with pytest.raises(ValueError, match="no name of a topic"):
        messages.topic(name, messages.POSE)


def test_an_attachment_is_33_bytes_as_rmw_zenoh_reads_them():
    raw = attachment(258, 1, bytes(range(16)))
    assert raw.hex() == "0201000000000000" + "0100000000000000" + "10" + bytes(range(16)).hex()
    # rmw_zenoh's attachment_helpers.cpp serialises an int64, an int64 and a std::array of 16 bytes with zenoh-ext, in
    # whose format an array is a sequence: here by zenoh's own serialiser
    theirs = [z_serialize(Int64(258)), z_serialize(Int64(1)), z_serialize(bytes(range(16)))]
    assert raw == b"".join(part.to_bytes() for part in theirs)
    assert len(publisher_id("a")) == 16
    assert publisher_id("a") != publisher_id("b")


def test_a_pose_is_cdr_byte_for_byte():
    raw = CDR + pose(1.0, -2.0, 0.5, 1.25, 7 * NS + 5)
    assert messages.encode_pose("map", np.array([1.0, -2.0, 0.5]), 1.25, 7 * NS + 5) == raw
    frame, position, heading = messages.decode_pose(raw)
    assert (frame, position.tolist(), heading) == ("map", [1.0, -2.0, 0.5], pytest.approx(1.25))


def test_a_path_is_cdr_byte_for_byte():
    ground = np.array([[0.0, 0, 0], [1, 0, 0.1], [1, 2, 0.2]])
    path = Trajectory(ground + np.array([0, 0, 2]), ground, np.array([0.0, 1.5, 4.0]), np.array([0.0, 0.5, 1.0]))
    raw = CDR + header(3 * NS) + struct.pack("<I", 3)
    for i, (place, heading, seconds) in enumerate(zip(ground, path.headings, path.times, strict=True)):
        made = pose(*place, heading, 3 * NS + round(seconds * NS))
        raw += made[:16] + (b"\0" * 4 if i == 0 else b"") + made[16:]  # doubles start at multiples of 8
    assert messages.encode_path("map", path, 3 * NS) == raw
    np.testing.assert_array_equal(messages.decode_path(raw), ground)


def test_no_path_is_an_empty_one():
    assert messages.encode_path("map", None, 3 * NS) == CDR + header(3 * NS) + struct.pack("<I", 0)
    assert messages.decode_path(messages.encode_path("map", None, 0)).shape == (0, 3)


def test_bytes_that_are_no_message_are_refused():
    good = CDR + pose(1.0, 2.0, 0.0, 0.0, 0)
    for raw in (b"", b"\x00", good[:40], b"\xff" * 76, CDR + pose(float("nan"), 0.0, 0.0, 0.0, 0)):
        with pytest.raises(DecodeError):
            messages.decode_pose(raw)


def test_a_cloud_comes_back_without_what_is_not_finite():
    points = np.random.default_rng(0).normal(size=(50, 3))
    points[7, 1] = np.nan
    frame, found = messages.decode_cloud(messages.encode_cloud("map", points, 0))
    assert frame == "map"
    np.testing.assert_allclose(found, np.delete(points, 7, axis=0), atol=1e-6)


def test_a_cloud_of_a_scanner_with_more_fields_rows_and_padding_is_read():
    store, types = messages._store, messages._types
    field = types["sensor_msgs/msg/PointField"]
    rows = np.zeros((2, 3), {"names": ["i", "x", "y", "z"], "formats": [">u2", ">f8", ">f8", ">f4"], "itemsize": 32})
    rows["x"], rows["y"], rows["z"] = [[1, 2, 3], [4, 5, 6]], 0.5, -1.0
    offsets = {name: rows.dtype.fields[name][1] for name in "xyz"}
    raw = b"".join(row.tobytes() + b"\xee" * 8 for row in rows)
    message = types[messages.CLOUD](
        header=messages._header("map", 0),
        height=2,
        width=3,
        fields=[field(name=n, offset=offsets[n], datatype=7 if n == "z" else 8, count=1) for n in "zxy"],
        is_bigendian=True,
        point_step=32,
        row_step=104,
        data=np.frombuffer(raw, np.uint8),
        is_dense=True,
    )
    points = messages.decode_cloud(bytes(store.serialize_cdr(message, messages.CLOUD)))[1]
    np.testing.assert_array_equal(points, [[i, 0.5, -1.0] for i in range(1, 7)])
    message.fields = message.fields[:2]
    with pytest.raises(DecodeError, match="layout"):
        messages.decode_cloud(bytes(store.serialize_cdr(message, messages.CLOUD)))


@pytest.fixture(scope="module")
def service(tmp_path_factory, office_file):
    endpoint = free_endpoint()
    folder = tmp_path_factory.mktemp("ros2")
    shutil.copy(office_file, folder / "office.gpdf")
    with Server(Options(endpoint, folder, folder, 1)), Client.connect(endpoint) as client:
        client.load_scene("office", "office.gpdf")
        yield client, endpoint


class Robot:
    """A ROS 2 robot as Zenoh sees it: bytes on the documented keys, nothing of our code."""

    KEYS = {  # noqa: RUF012
        Dialect.RMW_ZENOH: {
            "pose": "5/robot_pose/geometry_msgs::msg::dds_::PoseStamped_/"
            "RIHS01_10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8",
            "goal": "5/goal_pose/geometry_msgs::msg::dds_::PoseStamped_/"
            "RIHS01_10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8",
            "path": "5/plan/nav_msgs::msg::dds_::Path_/"
            "RIHS01_1957a5bb3cee5da65c4e52e52b65a93df227efce4c20f8458b36e73066ca334b",
        },
        Dialect.ROS2DDS: {"pose": "robot_pose", "goal": "goal_pose", "path": "plan"},
    }

    def __init__(self, session, dialect):
        self.session, self.keys, self.paths = session, self.KEYS[dialect], queue.Queue()
        self.subscriber = session.declare_subscriber(self.keys["path"], self.paths.put)

    def send(self, what, raw):
        publisher = self.session.declare_publisher(self.keys[what])
        wait_for(lambda: publisher.matching_status.matching)
        publisher.put(raw)
        publisher.undeclare()

    def answer(self):
        return self.paths.get(timeout=PATIENCE)


def wait_for(condition):
    until = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < until
        time.sleep(0.01)


@pytest.mark.parametrize("dialect", list(Dialect))
def test_a_goal_is_answered_with_the_path_of_the_service(service, office, dialect, monkeypatch):
    monkeypatch.setattr("gpdf_ros2.bridge.POSE_OLD_S", PATIENCE)
    client, endpoint = service
    made = office[0]
    goal = CDR + pose(*made.goal, 0.0, 0.0, time.time_ns())
    with Client.connect(endpoint) as ros, Client.connect(endpoint) as ours:
        robot = Robot(ros.session, dialect)
        with Bridge(client, ours.session, "office", "roomba", dialect=dialect, domain=5) as bridge:
            robot.send("goal", goal)
            assert messages.decode_path(robot.answer().payload.to_bytes()).shape == (0, 3)  # no pose yet
            robot.send("pose", CDR + pose(*made.start, 0.0, 0.0, time.time_ns()))
            wait_for(lambda: bridge._start is not None)
            robot.send("goal", goal)
            sample = robot.answer()
            expected = client.plan("office", made.start, made.goal, "roomba").trajectory
            np.testing.assert_array_equal(messages.decode_path(sample.payload.to_bytes()), expected.ground)
            if dialect is Dialect.RMW_ZENOH:
                beside = sample.attachment.to_bytes()
                sequence, stamp, length = struct.unpack("<qqB", beside[:17])
                assert (sequence, length, len(beside)) == (2, 16, 33)
                assert abs(stamp - time.time_ns()) < 60 * NS
            else:
                assert sample.attachment is None
            monkeypatch.setattr("gpdf_ros2.bridge.POSE_OLD_S", 0.0)
            robot.send("goal", goal)
            assert messages.decode_path(robot.answer().payload.to_bytes()).shape == (0, 3)  # the robot may be elsewhere
            monkeypatch.setattr("gpdf_ros2.bridge.POSE_OLD_S", PATIENCE)
            for wrong in (b"garbage", CDR + pose(90.0, 90.0, 0.0, 0.0, 0), goal.replace(b"map\0", b"odo\0")):
                robot.send("goal", wrong)
                assert messages.decode_path(robot.answer().payload.to_bytes()).shape == (0, 3)


def test_rmw_zenoh_sees_the_node_and_its_topics(service):
    client, endpoint = service
    with Client.connect(endpoint) as ros, Client.connect(endpoint) as ours:
        zid = str(ours.session.zid())
        with Bridge(client, ours.session, "office", names=Names(cloud="/map_cloud")):
            until, seen = time.monotonic() + PATIENCE, []
            while len(seen) < 5 and time.monotonic() < until:
                seen = [str(reply.ok.key_expr) for reply in ros.session.liveliness().get(f"@ros2_lv/0/{zid}/**")]
        assert sorted(token.split("/")[5] for token in seen) == ["MP", "MS", "MS", "MS", "NN"]
        assert {token.split("/")[9] for token in seen if "/NN/" not in token} == {
            "%plan",
            "%goal_pose",
            "%robot_pose",
            "%map_cloud",
        }


def test_a_cloud_from_a_topic_becomes_the_scene(service):
    client, endpoint = service
    x, y = np.meshgrid(np.arange(0, 4, 0.05), np.arange(0, 3, 0.05))
    floor = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    topic = messages.topic("/map_cloud", messages.CLOUD)
    with (
        Client.connect(endpoint) as ros,
        Client.connect(endpoint) as ours,
        Bridge(client, ours.session, "cloud", names=Names(cloud="/map_cloud")),
    ):
        block = zenoh.CongestionControl.BLOCK  # a loaded machine would drop the second of two in a row
        publisher = ros.session.declare_publisher(topic.key(Dialect.RMW_ZENOH), congestion_control=block)
        wait_for(lambda: publisher.matching_status.matching)
        publisher.put(b"garbage")
        publisher.put(messages.encode_cloud("map", floor, 0))
        wait_for(lambda: "cloud" in client.scenes())
        assert client.wait_for_scene("cloud")["points"] == len(floor)


@pytest.mark.slow
def test_the_verb_answers_until_it_is_stopped(service, office):
    _, endpoint = service
    words = [sys.executable, "-m", "gpdf_service.cli", "ros2", "office", "--agent", "roomba", "--domain", "5"]
    with subprocess.Popen([*words, "--endpoint", endpoint], stderr=subprocess.PIPE, text=True) as process:
        try:
            with Client.connect(endpoint) as ros:
                robot = Robot(ros.session, Dialect.RMW_ZENOH)

                def path():  # a pose counts for 2 s, and a process on a busy machine may take longer to hear the goal
                    robot.send("pose", CDR + pose(*office[0].start, 0.0, 0.0, time.time_ns()))
                    robot.send("goal", CDR + pose(*office[0].goal, 0.0, 0.0, time.time_ns()))
                    return messages.decode_path(robot.answer().payload.to_bytes())

                wait_for(lambda: len(path()) > 2)
            process.send_signal(signal.SIGINT)
            assert process.wait(30) == 0
        finally:
            process.kill()
        assert "OK" in process.stderr.read()

"""ROS 2's messages to and from ours, as CDR; the types and the serialisation are those of the rosbags library."""

from __future__ import annotations

from math import atan2, cos, sin
from typing import Any

import numpy as np
from gpdf_client import DecodeError, Trajectory
from gpdf_client.trajectory import FloatArray
from rosbags.typesys import Stores, get_typestore

from gpdf_ros2.topics import Topic

POSE = "geometry_msgs/msg/PoseStamped"
PATH = "nav_msgs/msg/Path"
CLOUD = "sensor_msgs/msg/PointCloud2"
NUMBERS = {7: "f4", 8: "f8"}
"""Datatypes FLOAT32 and FLOAT64 of sensor_msgs/msg/PointField."""
NS = 1_000_000_000
"""Nanoseconds in a second."""

_store = get_typestore(Stores.ROS2_JAZZY)  # from Iron to Kilted these types have the same hashes
_types: Any = _store.types


def topic(name: str, kind: str) -> Topic:
    """A topic of one of the types above."""
    return Topic(name, kind, _store.hash_rihs01(kind))


def encode_pose(frame: str, position: FloatArray, heading: float, stamp_ns: int) -> bytes:
    """A PoseStamped as CDR; position (x, y, z) [m], heading [rad]."""
    return bytes(_store.serialize_cdr(_pose(frame, position, heading, stamp_ns), POSE))


def encode_path(frame: str, trajectory: Trajectory | None, stamp_ns: int) -> bytes:
    """A Path as CDR: the contact points, each with the time at which the body is there; none is an empty path."""
    poses = []
    if trajectory is not None:
        rows = zip(trajectory.ground, trajectory.headings, trajectory.times, strict=True)
        poses = [_pose(frame, place, float(heading), stamp_ns + round(NS * t)) for place, heading, t in rows]
    return bytes(_store.serialize_cdr(_types[PATH](header=_header(frame, stamp_ns), poses=poses), PATH))


def decode_pose(data: bytes) -> tuple[str, FloatArray, float]:
    """Frame, position (3,) [m] and heading [rad] of a PoseStamped.

    Raises:
        DecodeError: it is no PoseStamped, or its numbers are not finite.
    """
    message = _decode(data, POSE)
    p, q = message.pose.position, message.pose.orientation
    numbers = np.array([p.x, p.y, p.z, q.x, q.y, q.z, q.w])
    if not np.isfinite(numbers).all():
        raise DecodeError(f"{POSE}: a number is not finite.")
    heading = atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y * q.y + q.z * q.z))
    return str(message.header.frame_id), numbers[:3], heading


def decode_path(data: bytes) -> FloatArray:
    """Positions (n, 3) [m] of a Path.

    Raises:
        DecodeError: it is no Path.
    """
    places = [(p.pose.position.x, p.pose.position.y, p.pose.position.z) for p in _decode(data, PATH).poses]
    return np.array(places, dtype=np.float64).reshape(-1, 3)


def decode_cloud(data: bytes) -> tuple[str, FloatArray]:
    """Frame and finite points (n, 3) [m] of a PointCloud2.

    Raises:
        DecodeError: it is no PointCloud2, or it has no x, y and z as floating-point numbers.
    """
    message = _decode(data, CLOUD)
    order = ">" if message.is_bigendian else "<"
    fields = {field.name: field for field in message.fields}
    try:
        kinds = [order + NUMBERS[fields[name].datatype] for name in "xyz"]
        offsets = [fields[name].offset for name in "xyz"]
        layout: Any = {"names": list("xyz"), "formats": kinds, "offsets": offsets, "itemsize": message.point_step}
        rows = message.data.reshape(message.height, message.row_step)[:, : message.width * message.point_step]
        cloud = np.frombuffer(np.ascontiguousarray(rows).tobytes(), np.dtype(layout))
    except (KeyError, ValueError) as error:
        raise DecodeError(f"{CLOUD}: its layout cannot be read ({error!r}).") from error
    points = np.column_stack([cloud[name].astype(np.float64) for name in "xyz"])
    return str(message.header.frame_id), points[np.isfinite(points).all(axis=1)]


def encode_cloud(frame: str, points: FloatArray, stamp_ns: int) -> bytes:
    """A PointCloud2 of x, y, z as float32."""
    values = np.ascontiguousarray(points, dtype="<f4")
    field = _types["sensor_msgs/msg/PointField"]
    message = _types[CLOUD](
        header=_header(frame, stamp_ns),
        height=1,
        width=len(values),
        fields=[field(name=name, offset=4 * i, datatype=7, count=1) for i, name in enumerate("xyz")],
        is_bigendian=False,
        point_step=12,
        row_step=12 * len(values),
        data=values.view(np.uint8).reshape(-1),
        is_dense=True,
    )
    return bytes(_store.serialize_cdr(message, CLOUD))


def _decode(data: bytes, kind: str) -> Any:  # noqa: ANN401 - rosbags makes its classes when it is imported
    try:
        return _store.deserialize_cdr(data, kind)
    except Exception as error:  # the generated code raises whatever its reading of wrong bytes comes to
        raise DecodeError(f"{len(data)} bytes are no {kind} ({error!r}).") from error


def _header(frame: str, stamp_ns: int) -> Any:  # noqa: ANN401
    stamp = _types["builtin_interfaces/msg/Time"](sec=stamp_ns // NS, nanosec=stamp_ns % NS)
    return _types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)


def _pose(frame: str, position: FloatArray, heading: float, stamp_ns: int) -> Any:  # noqa: ANN401
    x, y, z = map(float, position)
    place = _types["geometry_msgs/msg/Point"](x=x, y=y, z=z)
    turned = _types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=sin(heading / 2), w=cos(heading / 2))
    pose = _types["geometry_msgs/msg/Pose"](position=place, orientation=turned)
    return _types[POSE](header=_header(frame, stamp_ns), pose=pose)

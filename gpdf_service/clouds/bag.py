"""The last PointCloud2 of a topic in a ROS bag: .mcap, .db3, .bag, or a rosbag2 folder (rosbags, the extra `ros2`)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from gpdf_service.errors import CloudError
from gpdf_service.types import FloatArray

KIND = "sensor_msgs/msg/PointCloud2"
NUMBERS = {7: "f4", 8: "f8"}
"""Datatypes FLOAT32 and FLOAT64 of sensor_msgs/msg/PointField."""
OPTICAL = "_optical_frame"
"""REP 103: frames of this ending have z ahead, not up."""


def read_bag(path: Path, topic: str | None = None) -> FloatArray:
    """Finite points (n, 3) [m] in the frame of the message: the last one, because a map on a topic grows.

    Raises:
        CloudError: no rosbags, a damaged bag, no cloud, several topics and none chosen, or a frame without z up.
    """
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise CloudError(f"bag {path}", "rosbags is not installed", "pip install 'gpdf-service[ros2]'") from error
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as bag:
            found = sorted({c.topic for c in bag.connections if c.msgtype == KIND})
            chosen = _choose(path, found, topic)
            connections = [c for c in bag.connections if c.topic == chosen]
            last = None
            for connection, _, raw in bag.messages(connections):
                last = connection, raw
            if last is None:
                raise CloudError(f"bag {path}", f"{chosen} has no message", "Record it again.")
            message: Any = bag.deserialize(last[1], last[0].msgtype)
    except CloudError:
        raise
    except Exception as error:  # rosbags, its compression and its database raise whatever damaged bytes come to
        raise CloudError(f"bag {path}", f"it cannot be read ({error})", "Is the file complete?") from error
    if message.header.frame_id.endswith(OPTICAL):
        found_words = f"{chosen} is in frame {message.header.frame_id!r}, whose z is ahead"
        raise CloudError(f"bag {path}", found_words, "Record a cloud in a frame with z up, as a map's.")
    return points_of(message, path)


def _choose(path: Path, found: list[str], topic: str | None) -> str:
    if topic is None and len(found) == 1:
        return found[0]
    if topic in found:
        return str(topic)
    names = ", ".join(found) or "none"
    what = f"topics with a {KIND}: {names}"
    raise CloudError(f"bag {path}", what, "Name one of them: --topic NAME." if found else "Record a PointCloud2.")


def points_of(message: Any, path: Path) -> FloatArray:  # noqa: ANN401 - rosbags makes its classes when it is imported
    """Finite points (n, 3) of a PointCloud2."""
    order = ">" if message.is_bigendian else "<"
    fields = {field.name: field for field in message.fields}
    try:
        layout: Any = {
            "names": list("xyz"),
            "formats": [order + NUMBERS[fields[name].datatype] for name in "xyz"],
            "offsets": [fields[name].offset for name in "xyz"],
            "itemsize": message.point_step,
        }
        rows = message.data.reshape(message.height, message.row_step)[:, : message.width * message.point_step]
        cloud = np.frombuffer(np.ascontiguousarray(rows).tobytes(), np.dtype(layout))
    except (KeyError, ValueError) as error:
        found = f"its layout cannot be read ({error!r})"
        raise CloudError(f"bag {path}", found, "Give it x, y and z as floating-point numbers.") from error
    points = np.column_stack([cloud[name].astype(np.float64) for name in "xyz"])
    finite: FloatArray = points[np.isfinite(points).all(axis=1)]
    return finite

"""Twins of plans and scenes that Foxglove and Rerun draw."""

from __future__ import annotations

from typing import Any

import numpy as np
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from numpy.typing import NDArray

from gpdf_service.types import FloatArray

FRAME = "scene"


def poses(path: FloatArray, headings: FloatArray, stamp_ns: int) -> PosesInFrame:
    """A trajectory: positions (n, 3) [m], headings (n,) [rad]."""
    message = PosesInFrame(frame_id=FRAME)
    message.timestamp.FromNanoseconds(stamp_ns)
    for (x, y, z), heading in zip(path.tolist(), headings.tolist(), strict=True):
        pose = message.poses.add()
        pose.position.x, pose.position.y, pose.position.z = x, y, z
        pose.orientation.z, pose.orientation.w = float(np.sin(heading / 2)), float(np.cos(heading / 2))
    return message


def cloud(points: NDArray[Any], stamp_ns: int) -> PointCloud:
    """Points (n, 3) [m]."""
    message = PointCloud(frame_id=FRAME, point_stride=12, data=points.astype("<f4").tobytes())
    message.timestamp.FromNanoseconds(stamp_ns)
    message.pose.orientation.w = 1.0
    for i, name in enumerate("xyz"):
        message.fields.add(name=name, offset=4 * i, type=PackedElementField.FLOAT32)
    return message

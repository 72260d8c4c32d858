"""Twins of plans, scenes and what moves that viewers draw: Foxglove all of them, Rerun clouds and words."""

from __future__ import annotations

from typing import Any

import numpy as np
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from gpdf_schemas import PlanReply, Status
from numpy.typing import NDArray

from gpdf_service.types import FloatArray

FRAME = "scene"
DOTS = 8
"""Points on each piece of a path: a piece is 12 cm long at most, so that they look like a line."""


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


def line(path: FloatArray, stamp_ns: int) -> PointCloud:
    """A path (n, 3) [m] as a dotted line: Rerun draws neither poses nor Foxglove's lines."""
    pieces = path[:-1, None] + np.diff(path, axis=0)[:, None] * np.linspace(0, 1, DOTS)[:, None]
    return cloud(pieces.reshape(-1, 3), stamp_ns)


def words(reply: PlanReply, stamp_ns: int) -> Log:
    """What became of a request, in a line."""
    level = {Status.OK: Log.INFO, Status.INTERNAL: Log.ERROR}.get(reply.status, Log.WARNING)
    said = [f"{reply.scene}: {reply.status.value}", reply.message]
    if reply.trajectory is not None and reply.certificate is not None:
        steps = np.diff(reply.trajectory.positions.unpack(), axis=0)
        length, room = np.linalg.norm(steps, axis=1).sum(), reply.certificate.min_clearance
        said.append(f"{length:.2f} m in {reply.trajectory.times.unpack()[-1]:.1f} s, {room:.3f} m of room")
    said.append(f"request {reply.request_id}")
    message = Log(level=level, message=", ".join(part for part in said if part), name=f"plan in {reply.scene}")
    message.timestamp.FromNanoseconds(stamp_ns)
    return message

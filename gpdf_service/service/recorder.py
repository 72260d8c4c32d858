"""The log: every request and reply as the bytes on the wire, in MCAP, with twins that Foxglove and Rerun draw."""

from __future__ import annotations

import fcntl
import json
import logging
import queue
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from gpdf_schemas import PlanReply
from mcap.writer import Writer
from mcap_protobuf.schema import build_file_descriptor_set

from gpdf_service import __version__
from gpdf_service.types import FloatArray

log = logging.getLogger(__name__)

FLUSH_S = 0.5
"""[s] At most this much of the log is lost when the process is killed."""
QUEUE_SIZE = 4096
"""Messages waiting for the disk; beyond, the service waits for the log rather than answer unrecorded."""
CLOUD_POINTS = 100_000
"""Points of a scene that the log keeps for pictures."""
FRAME = "scene"
Task = Callable[[], None]


class Recorder:
    """One thread that writes one file; `close` it, or lose up to `FLUSH_S` seconds."""

    def __init__(self, path: Path, metadata: dict[str, str]) -> None:
        self.path = path
        self._file = path.open("wb")
        fcntl.flock(self._file, fcntl.LOCK_EX)  # ends with the process, so that repair can tell a crash from a live log
        self._writer = Writer(self._file)
        self._writer.start(profile="gpdf", library=f"gpdf_service {__version__}")
        self._writer.add_metadata("gpdf", {"version": __version__, **metadata})
        self._channels: dict[str, int] = {}
        self._sequence = 0
        self._queue: queue.Queue[Task | None] = queue.Queue(QUEUE_SIZE)
        self._failed = False
        self._thread = threading.Thread(target=self._run, name="gpdf-record", daemon=True)
        self._thread.start()

    def exchange(self, key: str, request: bytes, reply: bytes, received_ns: int, replied_ns: int) -> None:
        """Record a request and its reply."""

        def write() -> None:
            self._write(f"{key}/request", "", b"", "msgpack", request, received_ns)
            self._write(f"{key}/reply", "", b"", "msgpack", reply, replied_ns)

        self._queue.put(write)

    def plan(self, reply: PlanReply, stamp_ns: int) -> None:
        """Record a trajectory as poses for viewers; they show no status, so an uncertified path is left out."""
        if reply.trajectory is not None and reply.status == "OK":
            path, headings = reply.trajectory.positions.unpack(), reply.trajectory.headings.unpack()
            self._queue.put(lambda: self._proto(f"/plan/{reply.scene}", _poses(path, headings, stamp_ns), stamp_ns))

    def scene(self, name: str, points: FloatArray, facts: dict[str, Any]) -> None:
        """Record a scene's facts and, thinned, its cloud for viewers."""
        stamp_ns = time.time_ns()
        picked = points[:: max(1, len(points) // CLOUD_POINTS)].astype("<f4")

        def write() -> None:
            self._writer.add_metadata(f"scene/{name}", {"facts": json.dumps(facts)})
            self._proto(f"/cloud/{name}", _cloud(picked, stamp_ns), stamp_ns)

        self._queue.put(write)

    def close(self) -> None:
        """Write what waits, then the index."""
        self._queue.put(None)
        self._thread.join()

    def _run(self) -> None:
        flushed = time.monotonic()
        while True:
            try:
                task = self._queue.get(timeout=FLUSH_S)
            except queue.Empty:
                task = _nothing
            try:
                if task is None:
                    self._writer.finish()  # type: ignore[no-untyped-call]
                    self._file.close()
                    return
                task()
                if time.monotonic() - flushed > FLUSH_S:
                    self._writer.flush()  # type: ignore[no-untyped-call]
                    self._file.flush()
                    flushed = time.monotonic()
            except OSError as error:  # a full disk must not stop planning, and must not be silent
                if not self._failed:
                    log.error("the log %s cannot be written any more: %s", self.path, error)
                self._failed = True
                if task is None:
                    return
            except Exception:
                log.exception("a message could not be recorded in %s", self.path)

    def _write(self, topic: str, schema: str, schema_data: bytes, encoding: str, data: bytes, stamp_ns: int) -> None:
        if topic not in self._channels:
            schema_id = self._writer.register_schema(schema, encoding, schema_data) if schema else 0
            self._channels[topic] = self._writer.register_channel(topic, encoding, schema_id)
        self._sequence += 1
        self._writer.add_message(self._channels[topic], stamp_ns, data, stamp_ns, self._sequence)

    def _proto(self, topic: str, message: Any, stamp_ns: int) -> None:  # noqa: ANN401 - any protobuf message
        kind = type(message)
        descriptor = build_file_descriptor_set(kind).SerializeToString()
        data = message.SerializeToString()
        self._write(topic, kind.DESCRIPTOR.full_name, descriptor, "protobuf", data, stamp_ns)


def _nothing() -> None:
    """Wake up to flush."""


def _poses(path: FloatArray, headings: FloatArray, stamp_ns: int) -> PosesInFrame:
    message = PosesInFrame(frame_id=FRAME)
    message.timestamp.FromNanoseconds(stamp_ns)
    for (x, y, z), heading in zip(path.tolist(), headings.tolist(), strict=True):
        pose = message.poses.add()
        pose.position.x, pose.position.y, pose.position.z = x, y, z
        pose.orientation.z, pose.orientation.w = float(np.sin(heading / 2)), float(np.cos(heading / 2))
    return message


def _cloud(points: Any, stamp_ns: int) -> PointCloud:  # noqa: ANN401 - float32 array (n, 3)
    message = PointCloud(frame_id=FRAME, point_stride=12, data=points.tobytes())
    message.timestamp.FromNanoseconds(stamp_ns)
    message.pose.orientation.w = 1.0
    for i, name in enumerate("xyz"):
        message.fields.add(name=name, offset=4 * i, type=PackedElementField.FLOAT32)
    return message

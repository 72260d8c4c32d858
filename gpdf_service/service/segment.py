"""One file of the log: MCAP, locked while it is written, complete when it is closed."""

from __future__ import annotations

import contextlib
import fcntl
import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mcap.writer import Writer
from mcap_protobuf.schema import build_file_descriptor_set

from gpdf_service import __version__


class Segment:
    """A new file; not for several threads at once. Any call may raise OSError: then `abandon` it."""

    def __init__(self, path: Path) -> None:
        self.path, self._began = path, time.monotonic()
        self._file = path.open("xb")
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX)  # ends with the process: repair tells a crash from a live log
            self._writer = Writer(self._file, enable_data_crcs=True)
            self._writer.start(profile="gpdf", library=f"gpdf_service {__version__}")
        except BaseException:
            self.abandon()
            raise
        self._channels: dict[str, int] = {}
        self._sequence = 0

    @property
    def size(self) -> int:
        """Bytes that are in the file."""
        return self._file.tell()

    @property
    def age_s(self) -> float:
        """Seconds since it was begun."""
        return time.monotonic() - self._began

    def describe(self, name: str, facts: Mapping[str, str]) -> None:
        """Write a metadata record."""
        self._writer.add_metadata(name, dict(facts))

    def write(
        self, topic: str, data: bytes, stamp_ns: int, *, encoding: str = "msgpack", schema: str = "", text: bytes = b""
    ) -> None:
        """Write a message; its topic's channel, and the schema that `text` describes, on first use."""
        if topic not in self._channels:
            schema_id = self._writer.register_schema(schema, encoding, text) if schema else 0
            self._channels[topic] = self._writer.register_channel(topic, encoding, schema_id)
        self._sequence += 1
        self._writer.add_message(self._channels[topic], stamp_ns, data, stamp_ns, self._sequence)

    def draw(self, topic: str, message: Any, stamp_ns: int) -> None:  # noqa: ANN401 - any protobuf message
        """Write a protobuf message with the schema that viewers ask for."""
        kind = type(message)
        text = b"" if topic in self._channels else build_file_descriptor_set(kind).SerializeToString()
        data = message.SerializeToString()
        self.write(topic, data, stamp_ns, encoding="protobuf", schema=kind.DESCRIPTOR.full_name, text=text)

    def flush(self) -> None:
        """Bring everything to the disk: neither a kill nor a loss of power takes it back."""
        self._writer.flush()  # type: ignore[no-untyped-call]
        self._file.flush()
        os.fsync(self._file.fileno())

    def close(self) -> None:
        """Write what is left and the index."""
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._file.flush()
        os.fsync(self._file.fileno())
        self._file.close()

    def abandon(self) -> None:
        """Let go of a file that cannot be written any more; `repair` completes what is in it."""
        with contextlib.suppress(OSError):  # the descriptor is closed all the same
            self._file.close()

"""Logs on disk: read them, also those that a crash cut short, and mend those."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from mcap.records import Channel, Footer, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC, Writer


@dataclass(frozen=True, slots=True)
class Condition:
    """What is in a log: messages, whether it is complete, whether anything can be read."""

    path: Path
    messages: int
    complete: bool


def records_of(path: Path) -> Iterator[McapRecord]:
    """Every record to the end, or to the break."""
    with path.open("rb") as file:
        try:
            yield from StreamReader(file, emit_chunks=False).records
        except Exception:  # damaged bytes raise whatever they meet: struct.error, ZstdError, MemoryError, …
            return


def _ends_well(path: Path) -> bool:
    """Whether the file ends with the format's magic, as readers that seek the index from the end demand."""
    with path.open("rb") as file:
        file.seek(-len(MCAP0_MAGIC), os.SEEK_END)
        return file.read() == MCAP0_MAGIC


def check(path: Path) -> Condition:
    """Read a log through."""
    messages, complete = 0, False
    for record in records_of(path):
        messages += isinstance(record, Message)
        complete |= isinstance(record, Footer)
    return Condition(path, messages, complete and _ends_well(path))


def repair(path: Path) -> Condition:
    """Write a log that was cut short again, complete, in its place; the condition after."""
    target = path.with_suffix(".repairing")
    with target.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="gpdf", library="gpdf_service repair")
        schemas: dict[int, int] = {0: 0}
        channels: dict[int, int] = {}
        for record in records_of(path):
            if isinstance(record, Schema) and record.id not in schemas:
                schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
            elif isinstance(record, Channel) and record.id not in channels:
                channels[record.id] = writer.register_channel(
                    record.topic, record.message_encoding, schemas[record.schema_id], record.metadata
                )
            elif isinstance(record, Message):
                channel = channels[record.channel_id]
                writer.add_message(channel, record.log_time, record.data, record.publish_time, record.sequence)
            elif isinstance(record, Metadata):
                writer.add_metadata(record.name, record.metadata)
        writer.finish()  # type: ignore[no-untyped-call]
    target.replace(path)
    return check(path)


def repair_folder(folder: Path) -> list[Path]:
    """Mend every log of a folder that was cut short, but none that a service still writes; which they were."""
    broken = []
    for path in sorted(folder.glob("*.mcap")):
        with path.open("rb") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                continue
            if not check(path).complete:
                repair(path)
                broken.append(path)
    return broken

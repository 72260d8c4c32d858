"""Logs on disk: read them, also those that a crash cut short, and mend those."""

from __future__ import annotations

import fcntl
import logging
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import BinaryIO

from mcap.records import Channel, Footer, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC, Writer

log = logging.getLogger(__name__)

BROKEN = ".broken"
"""What is put behind the name of a log that was cut short, when a mended one takes its place."""


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


def is_log(path: Path) -> bool:
    """Whether a file is a log as far as it goes; one that a crash left empty is."""
    with path.open("rb") as file:
        return MCAP0_MAGIC.startswith(file.read(len(MCAP0_MAGIC)))


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
    """Write a log that was cut short again, complete, in its place; the broken file stays beside it.

    Returns:
        The condition after.
    """
    target = path.with_suffix(".repairing")
    try:
        with target.open("wb") as file:
            _copy(path, file)
            file.flush()
            os.fsync(file.fileno())
        os.link(path, _spare_name(path))  # at no moment is there no log of that name
        target.replace(path)
    finally:
        target.unlink(missing_ok=True)
    return check(path)


def _copy(path: Path, file: BinaryIO) -> None:
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


def _spare_name(path: Path) -> Path:
    names = (path.with_name(f"{path.name}{BROKEN}{n or ''}") for n in count())
    return next(name for name in names if not name.exists())


def repair_folder(folder: Path) -> list[Path]:
    """Mend every log of a folder that was cut short, but none that a service still writes; which they were."""
    broken = []
    for path in sorted(folder.glob("*.mcap")):
        with path.open("rb") as file:
            if not _lock(file) or check(path).complete:
                continue
            try:
                repair(path)
            except OSError as error:  # a full disk: the log stays as it is
                log.error("the log %s was cut short and cannot be mended: %s", path, error)
                continue
            broken.append(path)
    return broken


def prune(folder: Path, *, keep_bytes: float, keep_s: float) -> list[Path]:
    """Delete logs, the oldest first, until none is older than `keep_s` and all together are no more than `keep_bytes`.

    Logs that a service writes stay; broken ones that were mended count and go like the others.
    """
    stats = {path: path.stat() for path in folder.glob("gpdf_*.mcap*")}
    total, now, gone = sum(stat.st_size for stat in stats.values()), time.time(), []
    for path, stat in sorted(stats.items(), key=lambda item: item[1].st_mtime):
        if total <= keep_bytes and now - stat.st_mtime <= keep_s:
            break
        with path.open("rb") as file:
            if not _lock(file):
                continue
            path.unlink()
        total -= stat.st_size
        gone.append(path)
        log.info("deleted the log %s", path.name, extra={"age_s": round(now - stat.st_mtime), "bytes": stat.st_size})
    return gone


def is_live(path: Path) -> bool:
    """Whether a service writes a log now."""
    with path.open("rb") as file:
        return not _lock(file)


def _lock(file: BinaryIO) -> bool:
    """Whether nobody writes it; it is ours until it is closed."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True

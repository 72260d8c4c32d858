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

from mcap.reader import make_reader
from mcap.records import Channel, Chunk, Footer, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import CRCValidationError, StreamReader, breakup_chunk
from mcap.writer import MCAP0_MAGIC, Writer

log = logging.getLogger(__name__)

LOGS = "gpdf_*.mcap"
"""What a service writes; other files are not its own."""
_WHOLE = "the file as a whole"
AT_ONCE = 2
"""Logs that go for their age when a new one begins: a clock that is set wrong for a moment must not empty the log."""
BROKEN = ".broken"
"""What is put behind the name of a log that was cut short, when a mended one takes its place."""


@dataclass(frozen=True, slots=True)
class Condition:
    """What is in a log.

    Attributes:
        path: The log.
        messages: That can be trusted.
        complete: Whether it reaches its end, with its index.
        damage: What is not as it was written, in words.
    """

    path: Path
    messages: int
    complete: bool
    damage: tuple[str, ...] = ()

    @property
    def whole(self) -> bool:
        """Whether everything is there as it was written."""
        return self.complete and not self.damage


def records_of(path: Path, damage: list[str] | None = None) -> Iterator[McapRecord]:
    """Every record that is as it was written, to the end, or to the break.

    Args:
        path: The log.
        damage: Told in words what is left out: chunks whose checksum is another one.
    """
    told: list[str] = [] if damage is None else damage
    with path.open("rb") as file:
        try:
            for record in StreamReader(file, emit_chunks=True, validate_crcs=True).records:
                if isinstance(record, Chunk):
                    yield from _in_chunk(record, path, told)
                else:
                    yield record
        except CRCValidationError as error:
            told.append(f"{_WHOLE} is not as it was written ({error})")
        except Exception:  # damaged bytes raise whatever they meet: struct.error, ZstdError, MemoryError, …
            return


def _in_chunk(chunk: Chunk, path: Path, told: list[str]) -> Iterator[McapRecord]:
    try:
        found = breakup_chunk(chunk, validate_crc=True)
    except Exception as error:  # as above
        seconds = chunk.message_start_time / 1e9, chunk.message_end_time / 1e9
        told.append(f"the messages from {seconds[0]:.3f} to {seconds[1]:.3f} s are not as they were written ({error})")
        yield from _index(path)  # what the next chunks' messages are may have been said in this one
    else:
        yield from found


def _index(path: Path) -> list[McapRecord]:
    """The schemas and channels that the end of the file tells of."""
    try:
        with path.open("rb") as file:
            summary = make_reader(file).get_summary()
    except Exception:  # there is no end, or it is damaged, too
        return []
    return [] if summary is None else [*summary.schemas.values(), *summary.channels.values()]


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
    messages, complete, damage = 0, False, list[str]()
    for record in records_of(path, damage):
        messages += isinstance(record, Message)
        complete |= isinstance(record, Footer)
    return Condition(
        path, messages, (complete or any(_WHOLE in words for words in damage)) and _ends_well(path), tuple(damage)
    )


def repair(path: Path) -> Condition:
    """Write a log that was cut short or damaged again, in its place, with what can be trusted; the other stays beside.

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
    writer = Writer(file, enable_data_crcs=True)
    writer.start(profile="gpdf", library="gpdf_service repair")
    schemas: dict[int, int] = {0: 0}
    channels: dict[int, int] = {}
    for record in records_of(path):
        if isinstance(record, Schema) and record.id not in schemas:
            schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
        elif isinstance(record, Channel) and record.id not in channels and record.schema_id in schemas:
            channels[record.id] = writer.register_channel(
                record.topic, record.message_encoding, schemas[record.schema_id], record.metadata
            )
        elif isinstance(record, Message) and (channel := channels.get(record.channel_id)) is not None:
            writer.add_message(channel, record.log_time, record.data, record.publish_time, record.sequence)
        elif isinstance(record, Metadata):
            writer.add_metadata(record.name, record.metadata)
    writer.finish()  # type: ignore[no-untyped-call]


def _spare_name(path: Path) -> Path:
    names = (path.with_name(f"{path.name}{BROKEN}{n or ''}") for n in count())
    return next(name for name in names if not name.exists())


def repair_folder(folder: Path) -> list[Path]:
    """Mend every log of a service in a folder that was cut short, but none that is still written; which they were."""
    broken = []
    for path in sorted(folder.glob(LOGS)):
        with path.open("rb") as file:
            if not _lock(file):
                continue
            found = check(path)
            for words in found.damage:  # evidence: whoever wants it mended says so
                log.error("the log %s is DAMAGED: %s", path, words)
            if found.complete:
                continue
            try:
                repair(path)
            except OSError as error:  # a full disk: the log stays as it is
                log.error("the log %s was cut short and cannot be mended: %s", path, error)
                continue
            broken.append(path)
    return broken


def size_of(folder: Path) -> int:
    """Bytes of all logs."""
    return sum(path.stat().st_size for path in folder.glob(f"{LOGS}*"))


def prune(folder: Path, *, keep_bytes: float, keep_s: float, spare_s: float = 0.0) -> list[Path]:
    """Delete logs, the oldest first: all that are beyond `keep_bytes` together, and `AT_ONCE` that are beyond `keep_s`.

    Logs that a service writes stay, and those younger than `spare_s` whatever their size: else who fills the log can
    delete what it says. Broken ones that were mended count and go like the others.
    """
    aged = 0
    stats = {path: path.stat() for path in folder.glob(f"{LOGS}*")}
    total, now, gone = sum(stat.st_size for stat in stats.values()), time.time(), []
    for path, stat in sorted(stats.items(), key=lambda item: item[1].st_mtime):
        is_old = now - stat.st_mtime > keep_s and aged < AT_ONCE
        if now - stat.st_mtime < spare_s or (total <= keep_bytes and not is_old):
            break
        with path.open("rb") as file:
            if not _lock(file):
                continue
            path.unlink()
        aged += total <= keep_bytes
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

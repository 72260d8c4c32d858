"""The log: every request and reply as the bytes on the wire, in MCAP, with twins that viewers draw.

One thread writes. When the disk fails or fills, requests are answered all the same; the loss is counted, told in the
service's status and on stderr, and recording begins again by itself when it can.
"""

from __future__ import annotations

import contextlib
import json
import logging
import queue
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from gpdf_schemas import PlanReply, decode
from numpy.typing import NDArray

from gpdf_service import __version__
from gpdf_service.service.evidence import Evidence
from gpdf_service.service.options import Options
from gpdf_service.service.pictures import cloud, line, poses, words
from gpdf_service.service.record import prune, size_of
from gpdf_service.service.scene_files import short_of_room
from gpdf_service.service.segment import Segment
from gpdf_service.types import FloatArray

log = logging.getLogger(__name__)

QUEUE_BYTES = 64 << 20
"""Of messages that wait for the disk, 16 of the largest; beyond, the service waits for the log rather than answer
unrecorded."""
TASK_BYTES = 1 << 14
"""That a message counts for beside its data, so that 4096 small ones are as many as may wait."""
BATCH = 256
"""Messages that share one flush when each is flushed."""
GATHER_S = 0.01
"""[s] Before a message that nobody waits for is written: its reply is on its way then. The work on a log took the
interpreter from the threads that send the reply and receive it: 0.4 ms of a plan's 1.6 over Zenoh."""
WAKE_S = 0.5
"""[s] How often an idle log looks at its age and at the disk."""
RETRY_S = 2.0
"""[s] Between tries to record again after a failure."""
REMIND_S = 60.0
"""[s] Between complaints while nothing can be recorded."""
CLOUD_POINTS = 100_000
"""Points of a scene, or of what moves in it, that the log keeps for pictures."""
HEAD_POINTS = 10 * CLOUD_POINTS
"""Of all scenes at the head of each file, 12 MB; more scenes share it."""
MB = 1e6
HOUR_S = 3600.0
DAY_S = 24.0 * HOUR_S
MUTED = "gpdf/muted"
"""Topic: what was only counted, by client, or by the key under which it was published."""


@dataclass(frozen=True, slots=True)
class _Task:
    write: Callable[[Segment], None]
    size: int = 0  # bytes of its data
    done: threading.Event = field(default_factory=threading.Event)


@dataclass(frozen=True, slots=True)
class _Seen:
    """A scene as the log shows it: its facts, some of its points, and when it was ready [ns]."""

    facts: Mapping[str, Any]
    points: NDArray[np.float32]
    stamp_ns: int


class _Backlog(queue.Queue[_Task | None]):
    """Tasks in order; its size is in bytes."""

    def _init(self, maxsize: int) -> None:
        super()._init(maxsize)
        self._bytes = 0

    def _qsize(self) -> int:
        return self._bytes

    def _put(self, item: _Task | None) -> None:
        super()._put(item)
        self._bytes += _weight(item)

    def _get(self) -> _Task | None:
        item: _Task | None = super()._get()
        self._bytes -= _weight(item)
        return item


def _weight(task: _Task | None) -> int:
    return TASK_BYTES + (0 if task is None else task.size)


class Recorder:
    """Writes `options.log_dir`; `close` it, or lose up to `options.flush_s` seconds.

    Attributes:
        lost: Messages that could not be recorded.
        trouble: Why nothing is recorded now; empty when all is well.
    """

    def __init__(self, options: Options, name: str, metadata: Mapping[str, str]) -> None:
        self.options, self.lost, self.trouble = options, 0, ""
        self._name, self._metadata = name, {"version": __version__, **metadata}
        self._segments = self._unsafe = 0  # files begun; messages since the last flush
        self._flushed = self._retry = self._complained = -float("inf")
        self._counting = threading.Lock()
        self.evidence = Evidence()
        self._scenes: dict[str, _Seen] = {}
        self._head = 0  # bytes of the file that tell of the scenes
        self._queue = _Backlog(QUEUE_BYTES)
        self._segment: Segment | None = None
        try:
            self._segment = self._begin()  # a folder that cannot be written is told at the start
        except OSError as error:
            self._degrade(str(error))
        self._thread = threading.Thread(target=self._run, name="gpdf-record", daemon=True)
        self._thread.start()

    @property
    def path(self) -> Path:
        """The file that is being written, or was last."""
        return self.options.log_dir / f"gpdf_{self._name}_{self._segments:04d}.mcap"

    def exchange(
        self, key: str, request: bytes, reply: bytes, received_ns: int, replied_ns: int, *, patient: bool = True
    ) -> None:
        """Record a request and its reply.

        Args:
            key: What was asked.
            request: Its bytes.
            reply: Its bytes.
            received_ns: When it came [ns].
            replied_ns: When it was answered [ns].
            patient: Wait where the log is behind, and with `--log-sync each` until it is on the disk; False where that
                would hold up everybody: what does not fit is lost, and counted.
        """

        def write(segment: Segment) -> None:
            segment.write(f"{key}/request", request, received_ns)
            segment.write(f"{key}/reply", reply, replied_ns)

        task = _Task(write, len(request) + len(reply))
        if not patient:
            self._put_if_room(task)
            return
        self._queue.put(task)
        if self.options.flush_s == 0:
            task.done.wait()

    def publication(self, key: str, data: bytes, stamp_ns: int) -> None:
        """Record what somebody published; lost, and counted, where the log is behind."""
        self._put_if_room(_Task(lambda segment: segment.write(key, data, stamp_ns), len(data)))

    def _put_if_room(self, task: _Task) -> None:
        try:
            self._queue.put_nowait(task)
        except queue.Full:
            self._count_lost(1)

    def plan(self, data: bytes, stamp_ns: int) -> None:
        """Record for viewers what became of a request, and its trajectory, but no uncertified one.

        Args:
            data: The `PlanReply`'s bytes.
            stamp_ns: When it was answered [ns].
        """

        def write(segment: Segment) -> None:
            reply = decode(data, PlanReply)
            segment.draw("/words", words(reply, stamp_ns), stamp_ns)
            if reply.trajectory is not None and reply.status == "OK":
                path, headings = reply.trajectory.positions.unpack(), reply.trajectory.headings.unpack()
                segment.draw(f"/plan/{reply.scene}", poses(path, headings, stamp_ns), stamp_ns)
                segment.draw(f"/path/{reply.scene}", line(path, stamp_ns), stamp_ns)

        self._queue.put(_Task(write, len(data)))

    def moving(self, scene: str, points: FloatArray, stamp_ns: int) -> None:
        """Record for viewers what moves in a scene now, thinned."""
        picked = _thinned(points, CLOUD_POINTS)
        self.evidence.drawn(picked.nbytes)

        def write(segment: Segment) -> None:
            segment.draw(f"/moving/{scene}", cloud(picked, stamp_ns), stamp_ns)

        self._put_if_room(_Task(write, picked.nbytes))

    def scene(self, name: str, points: FloatArray, facts: Mapping[str, Any]) -> None:
        """Record a scene's facts and, thinned, its cloud for viewers: now, and at the head of each file to come."""
        seen = _Seen(facts, _thinned(points, CLOUD_POINTS), time.time_ns())

        def write(segment: Segment) -> None:
            self._scenes[name] = seen
            share = HEAD_POINTS // len(self._scenes)
            for other, known in self._scenes.items():
                if len(known.points) > share:
                    self._scenes[other] = replace(known, points=_thinned(known.points, share))
            drawn = self.evidence.may_draw
            self._describe(segment, name, draw=drawn)
            if drawn:
                self.evidence.drawn(self._scenes[name].points.nbytes)

        self._queue.put(_Task(write, seen.points.nbytes))

    def _describe(self, segment: Segment, name: str, *, draw: bool = True) -> None:
        seen = self._scenes[name]
        segment.describe(f"scene/{name}", {"facts": json.dumps(seen.facts)})
        if draw:
            segment.draw(f"/cloud/{name}", cloud(seen.points, seen.stamp_ns), seen.stamp_ns)

    def forget(self, name: str) -> None:
        """Keep a scene out of the files to come."""

        def let_go(_: Segment) -> None:
            self._scenes.pop(name, None)

        self._queue.put(_Task(let_go))

    def close(self) -> None:
        """Write what waits, then the index."""
        self._queue.put(None)
        self._thread.join()

    def _run(self) -> None:
        open_ = True
        while open_:
            batch = self._batch()
            open_ = None not in batch
            tasks = [task for task in batch if task is not None]
            try:
                self._record(tasks)
            except OSError as error:
                self._degrade(str(error))
            except (
                Exception
            ) as error:  # whatever it is, the thread must live: those who wait for it would wait for ever
                log.exception("in %s", self.path)
                self._degrade(repr(error))
            finally:
                for task in tasks:
                    task.done.set()
        try:
            self._end()
        except OSError as error:
            self._degrade(str(error))

    def _batch(self) -> list[_Task | None]:
        """What waits, after at least one has come or it is time to look after the file."""
        batch: list[_Task | None] = []
        with contextlib.suppress(queue.Empty):
            batch.append(self._queue.get(timeout=min(WAKE_S, self.options.flush_s or WAKE_S)))
            if self.options.flush_s:
                time.sleep(GATHER_S)
            held = _weight(batch[0])
            while len(batch) < BATCH and held < QUEUE_BYTES:
                batch.append(self._queue.get_nowait())
                held += _weight(batch[-1])
        return batch

    def _record(self, tasks: list[_Task]) -> None:
        self._unsafe += len(tasks)
        now = time.monotonic()
        if self._segment is None:
            if now < self._retry:
                self._lose_unsafe()
                return
            self._segment = self._begin()
        for task in tasks:
            try:
                task.write(self._segment)
            except OSError:
                raise
            except Exception:
                log.exception("a message could not be recorded in %s", self.path)
        self._tell_muted(self._segment)
        if self._unsafe and now - self._flushed >= self.options.flush_s:
            self._segment.flush()
            self._flushed, self._unsafe = now, 0
        if (
            self._segment.size - self._head > self.options.log_segment_mb * MB
            or self._segment.age_s > self.options.log_segment_s
        ):
            self._end()
            self._segment = self._begin()
        elif self._short_of_room():
            self._end()
            raise OSError(self._short_of_room())

    def _begin(self) -> Segment:
        """The next file, with what a reader must know at its head; the oldest make room."""
        options = self.options
        most, spare_s = options.log_keep_mb * MB, options.log_spare_hours * HOUR_S
        prune(options.log_dir, keep_bytes=most, keep_s=options.log_keep_days * DAY_S, spare_s=spare_s)
        self.evidence.thrifty = size_of(options.log_dir) > most
        if short := self._short_of_room():
            raise OSError(short)
        self._segments += 1
        segment = Segment(self.path)
        try:
            segment.describe("gpdf", {**self._metadata, "segment": str(self._segments)})
            for name in self._scenes:
                self._describe(segment, name)
            segment.flush()
            self._head = segment.size
        except OSError:
            segment.abandon()
            self.path.unlink()  # a head without a message, and the next try needs the room
            self._segments -= 1
            raise
        if self.trouble:
            log.warning("recording again, in %s; %d messages were lost", segment.path, self.lost)
            self.trouble = ""
        return segment

    def _end(self) -> None:
        """Complete the file."""
        if self._segment is not None:
            self._tell_muted(self._segment, at_once=True)
            self._segment.close()
            self._segment, self._unsafe = None, 0

    def _tell_muted(self, segment: Segment, *, at_once: bool = False) -> None:
        if muted := self.evidence.muted(at_once=at_once):
            segment.write(MUTED, msgspec.msgpack.encode(muted), time.time_ns())

    def _short_of_room(self) -> str:
        """Why nothing may be written, so that others still can; empty when there is room."""
        short = short_of_room(self.options.log_dir, self.options.log_min_free_mb * MB)
        return short and f"{short} (--log-min-free-mb)"

    def _degrade(self, why: str) -> None:
        """Give up the file, say so, and go on without."""
        if self._segment is not None:
            self._segment.abandon()
            self._segment = None
        self._lose_unsafe()
        now = time.monotonic()
        self._retry = now + RETRY_S
        if not self.trouble or now - self._complained > REMIND_S:
            self._complained = now
            log.error("NOT RECORDING: %s; plans go on; %d messages lost so far", why, self.lost)
        self.trouble = why

    def _lose_unsafe(self) -> None:
        self._count_lost(self._unsafe)
        self._unsafe = 0

    def _count_lost(self, count: int) -> None:
        with self._counting:
            self.lost += count


def _thinned(points: NDArray[Any], most: int) -> NDArray[np.float32]:
    return points[:: max(1, -(-len(points) // max(1, most)))].astype("<f4")

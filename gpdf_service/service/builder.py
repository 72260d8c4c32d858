"""The process that builds, seen from the service: what a build takes of memory or does to itself is its own affair."""

from __future__ import annotations

import contextlib
import logging
import signal
import threading
from pathlib import Path

import msgspec

from gpdf_service.config import Config
from gpdf_service.pipeline import Progress
from gpdf_service.service.child import Child
from gpdf_service.service.options import Options, plain
from gpdf_service.service.workshop import BuildError, EndedError, Job, NotKeptError

log = logging.getLogger(__name__)

PROGRAM = "gpdf_service.service.build_process"
MB = 1e6
STALL_S = 30.0
"""[s] In which a build uses some of the processor, also while it reads or writes gigabytes."""
SMALLER = "Is it in metres? Thin it (gpdf scene build --thin), or build it in parts and merge them (gpdf scene merge)"


class BuildSettings(msgspec.Struct, frozen=True):
    """What the process is begun with: what it shares with the service."""

    config: dict[str, dict[str, object]]
    limit_bytes: int
    memory_bytes: float
    bodies: tuple[str, ...]
    log_format: str


class Note(msgspec.Struct, frozen=True, tag=True):
    """How far a build is."""

    stage: str
    done: float


class Built(msgspec.Struct, frozen=True, tag=True):
    """Where the new version is."""

    file: str


class Failed(msgspec.Struct, frozen=True, tag=True):
    """Why there is none; whether the disk takes it, and whether the process goes on."""

    words: str
    kept: bool = True
    goes_on: bool = True


class Builder:
    """One process that builds, begun anew when it dies; asked by one thread at a time.

    Args:
        settings: What it is begun with.
    """

    def __init__(self, settings: BuildSettings) -> None:
        self._settings = settings
        self._child: Child | None = None
        self._ended, self._lock = False, threading.Lock()

    @classmethod
    def of(cls, options: Options, config: Config) -> Builder:
        """As the options say."""
        tables = {name: table for name, table in plain(options, config).items() if name != "serve"}
        limit = int(MB * options.build_memory_mb)
        return cls(BuildSettings(tables, limit, options.memory_bytes, tuple(options.bodies), options.log_format))

    @property
    def pids(self) -> list[int]:
        """The system's number of the process, if there is one."""
        with self._lock:
            pid = None if self._child is None else self._child.pid
            return [] if pid is None else [pid]

    def start(self) -> None:
        """Begin the process, ahead of the first build."""
        with contextlib.suppress(EndedError):
            self._running()

    def build(self, job: Job, progress: Progress) -> Path:
        """Have a job done; the file of the new version.

        Raises:
            BuildError: it failed, in words; a NotKeptError where the disk is why.
            EndedError: `close` was called.
        """
        heard = self._ask(job, progress) or self._ask(
            job, progress
        )  # one that had died before, or at once: another one
        if isinstance(heard, Built):
            return Path(heard.file)
        if heard is None:
            raise BuildError("the process that builds cannot be begun; the service's log says more.")
        raise (BuildError if heard.kept else NotKeptError)(heard.words)

    def _ask(self, job: Job, progress: Progress) -> Built | Failed | None:
        """What becomes of a job; none if the process ends without having begun it."""
        child, begun = self._running(), False
        try:
            child.pipe.send_bytes(msgspec.json.encode(job))
            while True:
                heard = msgspec.json.decode(child.hear(STALL_S), type=Note | Built | Failed)
                if not isinstance(heard, Note):
                    break
                begun = True
                progress(heard.stage, heard.done)
        except TimeoutError:
            self._epitaph(child)
            return Failed("the build's process hung, and was ended. Send it again; the service's log says more.")
        except (EOFError, OSError):
            words = self._epitaph(child)
            return Failed(words) if begun else None
        if isinstance(heard, Failed) and not heard.goes_on:
            self._epitaph(child)
        return heard

    def close(self) -> None:
        """End the process, also in the middle of a build."""
        with self._lock:
            self._ended = True
            if self._child is not None:
                self._child.kill()
                self._child.wait()

    def _running(self) -> Child:
        with self._lock:
            if self._ended:
                raise EndedError
            if self._child is None:
                self._child = Child(PROGRAM, self._settings)
            return self._child

    def _epitaph(self, child: Child) -> str:
        """Why a build's process has ended, for who waits for the scene."""
        child.kill()
        code = child.wait()
        with self._lock:
            self._child = None
            if self._ended:
                raise EndedError
        log.error("the process that builds has ended with code %d", code)
        how = f"with {signal.Signals(-code).name}" if code < 0 else f"with code {code}"
        allowed = f"{self._settings.limit_bytes / MB:.0f} MB (--build-memory-mb)"
        return f"the build's process ended {how}, most likely for want of memory: it may take {allowed}. {SMALLER}."

"""A Python process of ours behind a pipe, forked of a nursery; it ends when we end, however we do."""

from __future__ import annotations

import contextlib
import logging
import os
import select
import signal
import socket
import struct
import subprocess
import sys
import threading
from collections.abc import Callable
from multiprocessing.connection import Connection, wait
from pathlib import Path

import msgspec
import psutil

from gpdf_service.service.nursery import Birth, run

log = logging.getLogger(__name__)

MOVE_S = 3
"""[s] In which the other end takes what is sent, and sends the rest of what it began; one that does not hangs."""
START_S = 30.0
"""[s] In which one that begins uses some of the processor: it reads a lot from the disk."""
FATE_BYTES = 64
"""A number in digits is shorter."""
FIRST_TO_GO = 1000
"""Where the kernel looks first when memory runs out: a child is begun anew, and has nothing that is not on the disk."""


class _Nursery:
    """Ours: begun with the first child, or ahead of it, and anew when it has died."""

    def __init__(self) -> None:
        self._births: socket.socket
        self._end: Callable[[], int] | None = None
        self._lock = threading.Lock()
        self.pid = 0

    def bear(self, birth: Birth, sent: list[int]) -> None:
        """Have a child forked, with these file descriptors."""
        words = msgspec.json.encode(birth)
        with self._lock:
            try:
                if self._end is None:
                    raise ConnectionError
                socket.send_fds(self._births, [words], sent)
            except ConnectionError:
                self._begin()
                socket.send_fds(self._births, [words], sent)

    def fork(self) -> None:
        """Begin it as a fork of this process, which has loaded it all: a second less. Not where other threads run."""
        if self._end is not None or threading.active_count() > 1:
            return
        theirs = self._connect()
        if (pid := os.fork()) == 0:
            self._births.close()
            os.setpgid(0, 0)  # Ctrl-C at a terminal is for the service, which answers first what waits
            with Path(os.devnull).open() as nothing:
                os.dup2(nothing.fileno(), 0)
            run(theirs)
        theirs.close()
        self.pid, self._end = pid, lambda: os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])

    def end(self) -> None:
        """End it at once: where it loads something for a child, that can be for minutes."""
        with self._lock:
            if self._end is not None:
                os.kill(self.pid, signal.SIGKILL)  # it may have ended, but nobody else has its number yet
                self._end()
                self._births.close()
                self._end = None

    def _begin(self) -> None:
        if self._end is not None:
            log.error("the process that children are forked of has ended with code %d", self._end())
            self._births.close()
        with self._connect() as theirs:
            process = subprocess.Popen(
                [sys.executable, "-P", "-m", "gpdf_service.service.nursery", str(theirs.fileno())],
                env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},  # the modules that we have, no others
                stdin=subprocess.DEVNULL,
                pass_fds=[theirs.fileno()],
                process_group=0,  # as above
            )
        self.pid, self._end = process.pid, process.wait

    def _connect(self) -> socket.socket:
        """Where it hears of births; our end is closed with us, however we end: then it ends, too."""
        self._births, theirs = socket.socketpair(type=socket.SOCK_SEQPACKET)
        return theirs


NURSERY = _Nursery()
"""One for all services of a process: what it has loaded is the same for all."""


class Child:
    """A process that runs `program.main(pipe, settings)`; safe for many threads.

    Args:
        program: A module.
        settings: What it is begun with.

    Attributes:
        pipe: Our end.
    """

    def __init__(self, program: str, settings: msgspec.Struct) -> None:
        ours, theirs = socket.socketpair()
        self._fate, told = socket.socketpair(type=socket.SOCK_SEQPACKET)  # closed with us: then it is ended
        self._born: int | None = None
        self._code: int | None = None
        self._lock = threading.Lock()
        with ours, theirs, told:
            for way in (socket.SO_SNDTIMEO, socket.SO_RCVTIMEO):
                ours.setsockopt(socket.SOL_SOCKET, way, struct.pack("ll", MOVE_S, 0))
            self.pipe = Connection(os.dup(ours.fileno()))
            birth = Birth(program, msgspec.Raw(msgspec.json.encode(settings)), str(Path.cwd()))
            NURSERY.bear(birth, [theirs.fileno(), told.fileno(), 1, 2])
        self._says = select.poll()
        self._says.register(self.pipe, select.POLLIN)
        self._says.register(self._fate, 0)  # its end is told, whatever is asked for

    @property
    def pid(self) -> int | None:
        """The system's number of it; None before it is born."""
        self._look(0.0)
        return self._born

    def _look(self, timeout: float | None) -> None:
        """Take in what its nursery has told: its number, and later its exit code."""
        wait([self._fate], timeout)
        with self._lock:
            while self._code is None and wait([self._fate], 0.0):
                said = self._fate.recv(FATE_BYTES)
                if not said:  # the nursery has died, or need not bear it; who is alone ends, too
                    self._code = -signal.SIGKILL
                    if self._born is not None:
                        with contextlib.suppress(ProcessLookupError):
                            os.kill(self._born, signal.SIGKILL)
                elif self._born is None:
                    self._born = int(said)
                else:
                    self._code = int(said)

    def hear(self, stall_s: float) -> bytes:
        """What it says next.

        Args:
            stall_s: In which it uses some of the processor, if it works.

        Raises:
            TimeoutError: it hangs.
            EOFError: it has ended.
            OSError: the same.
        """
        spent = -1.0
        while not self._says.poll(1e3 * stall_s):
            pid = self.pid or NURSERY.pid
            before, spent = spent, _cpu_s(pid)
            if spent == before:
                words = f"process {pid} was asked for something and hangs"
                log.error(words)
                raise TimeoutError(words)
        self._look(0.0)
        while self._born is None and self._code is None:  # it may be faster than who tells of its birth
            self._look(None)
        if self._born is None:
            raise EOFError
        return self.pipe.recv_bytes()

    def wait(self) -> int:
        """Until it has ended; its exit code, or the negative number of the signal that ended it."""
        while self._code is None:
            self._look(None)
        return self._code

    def kill(self) -> None:
        """End it at once; one that is not born yet, which can take its nursery minutes, is not waited for."""
        with contextlib.suppress(OSError):
            self._fate.shutdown(socket.SHUT_RDWR if self.pid is None else socket.SHUT_WR)


def _cpu_s(pid: int) -> float:
    try:
        times = psutil.Process(pid).cpu_times()
    except psutil.NoSuchProcess:  # the pipe says so, too
        return -1.0
    return float(times.user + times.system)


def go_first() -> None:
    """Let the kernel end this process ahead of the service when memory runs out."""
    with contextlib.suppress(OSError):  # not a Linux, or not allowed: the limits are there all the same
        Path("/proc/self/oom_score_adj").write_text(str(FIRST_TO_GO))

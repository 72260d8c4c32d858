"""A Python process of ours behind a pipe; it ends when we end, however we do."""

from __future__ import annotations

import contextlib
import logging
import os
import select
import socket
import struct
import subprocess
import sys
from multiprocessing.connection import Connection
from pathlib import Path

import msgspec
import psutil

log = logging.getLogger(__name__)

MOVE_S = 3
"""[s] In which the other end takes what is sent, and sends the rest of what it began; one that does not hangs."""
START_S = 30.0
"""[s] In which one that begins uses some of the processor: it reads a lot from the disk."""
FIRST_TO_GO = 1000
"""Where the kernel looks first when memory runs out: a child is begun anew, and has nothing that is not on the disk."""


class Child:
    """`python -m program SETTINGS`.

    Args:
        program: A module.
        settings: What it is begun with; its field `pipe` becomes the file descriptor of its end of the pipe.

    Attributes:
        pipe: Our end.
    """

    def __init__(self, program: str, settings: msgspec.Struct) -> None:
        ours, theirs = socket.socketpair()  # closed with us, however we end: then it ends too
        with ours, theirs:
            words = msgspec.json.encode(msgspec.structs.replace(settings, pipe=theirs.fileno())).decode()
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", program, words],
                env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},  # the modules that we have, no others
                stdin=subprocess.DEVNULL,
                pass_fds=[theirs.fileno()],
                process_group=0,  # Ctrl-C at a terminal is for the service, which answers first what waits
            )
            for way in (socket.SO_SNDTIMEO, socket.SO_RCVTIMEO):
                ours.setsockopt(socket.SOL_SOCKET, way, struct.pack("ll", MOVE_S, 0))
            self.pipe = Connection(os.dup(ours.fileno()))
        self._says = select.poll()
        self._says.register(self.pipe, select.POLLIN)

    @property
    def pid(self) -> int:
        """The system's number of it."""
        return self._process.pid

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
            before, spent = spent, self._cpu_s()
            if spent == before:
                words = f"process {self.pid} was asked for something and hangs"
                log.error(words)
                raise TimeoutError(words)
        return self.pipe.recv_bytes()

    def _cpu_s(self) -> float:
        try:
            times = psutil.Process(self.pid).cpu_times()
        except psutil.NoSuchProcess:  # the pipe says so, too
            return -1.0
        return float(times.user + times.system)

    def wait(self) -> int:
        """Until it has ended; its exit code, or the negative number of the signal that ended it."""
        return self._process.wait()

    def kill(self) -> None:
        """End it at once."""
        self._process.kill()


def go_first() -> None:
    """Let the kernel end this process ahead of the service when memory runs out."""
    with contextlib.suppress(OSError):  # not a Linux, or not allowed: the limits are there all the same
        Path("/proc/self/oom_score_adj").write_text(str(FIRST_TO_GO))

"""A process that has loaded what the service's children run, and forks them; it is given the descriptor of a socket.

It has no thread that runs when it forks, so nothing is lost in a fork: a child begins in some milliseconds, not in a
second of imports, and shares what was loaded. A child is ended when the service's end of its fate is shut.
"""

from __future__ import annotations

import contextlib
import gc
import os
import select
import signal
import socket
import sys
import traceback
from functools import cache
from importlib import import_module
from multiprocessing.connection import Connection
from pathlib import Path
from types import ModuleType
from typing import NoReturn

import msgspec

MOST_BYTES = 1 << 16
"""Of what the service says of a child."""
SENT = 4
"""File descriptors that come with it: the child's pipe, its fate, its stdout, its stderr."""


class Birth(msgspec.Struct, frozen=True):
    """A child to be forked.

    Attributes:
        program: A module with `main(pipe, settings)`, and maybe `prepare()`, which is called once, before any fork.
        settings: For `main`, as JSON.
        folder: That it works in.
    """

    program: str
    settings: msgspec.Raw
    folder: str


class Nursery:
    """Forks children, and tells each one's fate: its number when it is born, its exit code when it has ended.

    Args:
        service: Where births come from.
    """

    def __init__(self, service: socket.socket) -> None:
        self._service = service
        self._fates: dict[int, tuple[int, socket.socket]] = {}  # by what a child holds open as long as it lives
        self._shut: dict[int, int] = {}  # children by the file descriptor of their fates
        self._events = select.poll()
        self._events.register(service, select.POLLIN)

    def run(self) -> None:
        """Until the service has ended; then the children are ended, too."""
        while True:
            for number, _ in self._events.poll():
                if number in self._fates:
                    self._bury(number)
                elif number in self._shut:  # not if it was buried a moment ago
                    self._events.unregister(number)
                    self._end(self._shut.pop(number))
                elif number == self._service.fileno() and not self._bear():
                    for child, _ in self._fates.values():
                        self._end(child)
                        os.waitpid(child, 0)
                    return

    def _bear(self) -> bool:
        """Fork a child; whether the service is still there."""
        try:
            said, sent, _, _ = socket.recv_fds(self._service, MOST_BYTES, SENT)
        except ConnectionError:
            return False
        if not said:
            return False
        birth = msgspec.json.decode(said, type=Birth)
        pipe, fate = sent[0], socket.socket(fileno=sent[1])
        program = _loaded(birth.program)
        dies, lives = os.pipe()
        gc.freeze()  # what is here already is nobody's garbage: looking through it would make it a child's own
        if (child := os.fork()) == 0:
            for kept in (dies, fate.fileno(), self._service.fileno(), *self._fates, *self._shut):
                os.close(kept)
            _live(program, Connection(pipe), sent[2:], birth)
        for number in (pipe, lives, *sent[2:]):
            os.close(number)
        self._fates[dies], self._shut[fate.fileno()] = (child, fate), child
        self._events.register(dies, 0)  # its end is told, whatever is asked for
        self._events.register(fate, select.POLLIN)
        _tell(fate, child)
        return True

    def _bury(self, dies: int) -> None:
        self._events.unregister(dies)
        os.close(dies)
        child, fate = self._fates.pop(dies)
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        if self._shut.pop(fate.fileno(), None) is not None:
            self._events.unregister(fate)
        with fate:
            _tell(fate, code)

    @staticmethod
    def _end(child: int) -> None:
        os.kill(child, signal.SIGKILL)  # it may have ended, but nobody else has its number before it is buried


@cache
def _loaded(name: str) -> ModuleType:
    program = import_module(name)
    if hasattr(program, "prepare"):
        program.prepare()
    return program


def _tell(fate: socket.socket, number: int) -> None:
    with contextlib.suppress(OSError):  # the service does not ask any more
        fate.send(b"%d" % number)


def _be_called(name: str) -> None:
    """By `top` and `ps`."""
    with contextlib.suppress(OSError):  # not a Linux
        Path("/proc/self/comm").write_text(name)


def _live(program: ModuleType, pipe: Connection, says: list[int], birth: Birth) -> NoReturn:
    """A child's life."""
    code = 1
    try:
        os.setpgid(0, 0)
        for number, stream in zip(says, (sys.stdout, sys.stderr), strict=True):
            os.dup2(number, stream.fileno())
            os.close(number)
        os.chdir(birth.folder)
        _be_called(birth.program.rpartition(".")[2])
        program.main(pipe, bytes(birth.settings))
        code = 0
    except BaseException:
        traceback.print_exc()
    finally:
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        os._exit(code)


def run(service: socket.socket) -> NoReturn:
    """Be the nursery of a service until that has ended; signals are for the service."""
    code = 1
    try:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)
        _be_called("nursery")
        Nursery(service).run()
        code = 0
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(code)


if __name__ == "__main__":
    run(socket.socket(fileno=int(sys.argv[1])))

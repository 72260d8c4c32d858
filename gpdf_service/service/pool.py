"""Processes that plan, each with an interpreter of its own; the service hands them requests and keeps everything else.

A plan's Python holds the interpreter lock, so that threads share one core. A process has no state that matters: the
scene is a file, what moves comes with the request. One that dies is begun anew, and its request goes to another one.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections.abc import Callable, Mapping

import msgspec
from gpdf_schemas import Array, Status, encode

from gpdf_service.service.answers import RefusedError
from gpdf_service.service.child import START_S, Child
from gpdf_service.service.moving import Living

log = logging.getLogger(__name__)

PROGRAM = "gpdf_service.service.plan_process"
READY = b"ready"
"""The first message of a process."""
TRIES = 3
"""Processes that may die over one request before it is refused: it may be what kills them."""
STALL_S = 3.0
"""[s] In which one that was asked uses some of the processor; one that does not hangs, and is ended like a dead one."""
RESTART_S = 1.0
"""[s] Between beginnings of a process that dies."""


WARM = "warm"
"""The key by which a process is told to take a scene into memory, ahead of the first plan in it, and to make ready for
a body: that of the `DrawRequest` that comes with it, else those that the service is configured for."""
WARM_S = 10.0
"""[s] That a busy process is waited for, to be told so; else it loads the scene when it is asked to plan there."""


class Settings(msgspec.Struct, frozen=True):
    """What a process is begun with: what it shares with the service."""

    planner: str
    memory_bytes: float
    log_format: str
    bodies: tuple[str, ...] = ()


class Seen(msgspec.Struct, frozen=True):
    """A `Living` obstacle on its way to a process."""

    id: str
    points: Array
    until: float
    number: int


class Ask(msgspec.Struct, frozen=True):
    """One request to a process; it answers with a reply's bytes, or with none if the file cannot be read.

    Attributes:
        key: What is asked, one of `gpdf_schemas.keys`.
        request: Its bytes.
        received: From when on its deadline counts, on `time.monotonic` [s].
        load: Of the service.
        scene: Name of its scene.
        file: Where the scene is.
        moving: What moves in it; None: as before.
        looked: When the service looked at what moves, on `time.monotonic` [s].
        gone: Scenes that were unloaded: what moved in them goes, too, ahead of `moving`.
    """

    key: str
    request: bytes
    received: float
    load: float
    scene: str
    file: str
    moving: list[Seen] | None = None
    looked: float = 0.0
    gone: list[str] = []


class _Process:
    """One of them; asked by one thread at a time."""

    def __init__(self, settings: Settings) -> None:
        self._child = Child(PROGRAM, settings)
        self._told: dict[str, tuple[int, ...]] = {}
        self._gone = queue.SimpleQueue[str]()
        self.ready = False

    @property
    def pid(self) -> int | None:
        """The system's number of it; None before it is born."""
        return self._child.pid

    def wait_until_ready(self) -> None:
        """Until it can be asked."""
        self._child.hear(START_S)

    def tell(self, ask: Ask, looked: float, living: Mapping[str, Living]) -> None:
        """Ask it; `hear` next."""
        gone = [self._gone.get() for _ in range(self._gone.qsize())]
        for scene in gone:
            self._told.pop(scene, None)
        numbers = tuple(one.number for one in living.values())
        moving = None if self._told.get(ask.scene, ()) == numbers else [_as_seen(*item) for item in living.items()]
        if numbers:  # ahead of the telling, during which it may be gone
            self._told[ask.scene] = numbers
        else:
            self._told.pop(ask.scene, None)
        self._child.pipe.send_bytes(encode(msgspec.structs.replace(ask, moving=moving, looked=looked, gone=gone)))

    def forget(self, scene: str) -> None:
        """Tell it with the next request that a scene is gone, if it was told what moves there; for any thread."""
        if self._told.pop(scene, None) is not None:
            self._gone.put(scene)

    def hear(self) -> bytes:
        """The bytes that it answers with.

        Raises:
            TimeoutError: it hangs.
        """
        return self._child.hear(STALL_S)

    def wait(self) -> int:
        """Until it has ended."""
        return self._child.wait()

    def kill(self) -> None:
        """End it at once."""
        self._child.kill()


class _Idle:
    """Processes that wait to be asked; safe for many threads."""

    def __init__(self) -> None:
        self._waiting: list[_Process] = []
        self._change = threading.Condition()

    def put(self, process: _Process) -> None:
        """It can be asked."""
        with self._change:
            self._waiting.append(process)
            self._change.notify_all()

    def take(self, timeout: float, wanted: _Process | None = None) -> _Process | None:
        """The one that waits longest, or the one that is wanted; none if there is none in time."""

        def there() -> bool:
            return bool(self._waiting) if wanted is None else wanted in self._waiting

        with self._change:
            if not self._change.wait_for(there, timeout):
                return None
            return self._waiting.pop(0 if wanted is None else self._waiting.index(wanted))

    def __len__(self) -> int:
        with self._change:
            return len(self._waiting)


class Pool:
    """So many processes, kept running until `close`; safe for many threads.

    Args:
        count: Processes.
        settings: What they share with the service.

    Attributes:
        restarts: Processes that died.
    """

    def __init__(self, count: int, settings: Settings) -> None:
        self._settings, self.restarts = settings, 0
        self._idle = _Idle()
        self._alive: dict[str, _Process] = {}
        self._warm: dict[str, Ask] = {}  # by scene, for those that begin later
        self._seen: set[str] = set()  # keepers whose process was ever ready
        self._ended, self._lock = threading.Event(), threading.Lock()
        names = [f"gpdf-process-{i}" for i in range(count)]
        self._keepers = [threading.Thread(target=self._keep, name=name, daemon=True) for name in names]

    def start(self) -> None:
        """Begin the processes; requests wait for the first that is ready."""
        for thread in self._keepers:
            thread.start()

    @property
    def ready(self) -> bool:
        """Whether each process was there to be asked, with the scenes that there were."""
        with self._lock:
            return len(self._seen) == len(self._keepers)

    @property
    def idle(self) -> int:
        """How many wait to be asked; one that has just died among them."""
        return len(self._idle)

    @property
    def pids(self) -> list[int]:
        """The system's numbers of those that run."""
        with self._lock:
            return [pid for process in self._alive.values() if (pid := process.pid) is not None]

    def ask(self, ask: Ask, look: Callable[[str], tuple[float, Mapping[str, Living]]], until: float) -> bytes:
        """The reply's bytes of whichever process is free first; none if it cannot read the scene's file.

        Args:
            ask: What is asked.
            look: Says what moves in a scene, and when; asked when there is a process to tell it.
            until: When the answer is too late, on `time.monotonic` [s].

        Raises:
            RefusedError: no process was free in time.
        """
        died = 0
        while died < TRIES:
            process = self._idle.take(min(max(0.0, until - time.monotonic()), threading.TIMEOUT_MAX))
            if process is None:
                words = "no process was free to plan before the deadline. Ask again, or give more time."
                raise RefusedError(Status.TIMEOUT, words)
            told = False
            try:
                process.tell(ask, *look(ask.scene))
                told = True
                answer = process.hear()
            except (EOFError, OSError):  # it is not put back
                process.kill()
                died += told  # else it had died before, which is not this request's doing
                continue
            except BaseException:  # whatever it was, the next request must not read this one's answer
                process.kill()
                raise
            self._idle.put(process)
            return answer
        raise RuntimeError(f"{TRIES} processes died one after another")

    def warm(self, scene: str, file: str) -> None:
        """Let each process take a scene into memory, now and whenever one begins."""
        ask = Ask(WARM, b"", time.monotonic(), 0.0, scene, file)
        with self._lock:
            self._warm[scene] = ask
        self._tell_each(ask, WARM_S)

    def prepare(self, scene: str, file: str, request: bytes) -> None:
        """Let all that are idle make ready for the body of a `DrawRequest`, ahead of the first plan for it."""
        self._tell_each(Ask(WARM, request, time.monotonic(), 0.0, scene, file), 0.0)

    def _tell_each(self, ask: Ask, patience: float) -> None:
        """Tell it one process after another, so that the others plan on; a busy one is waited for so long [s]."""
        with self._lock:
            alive = list(self._alive.values())
        for process in alive:
            if self._idle.take(patience if process.ready else 0.0, process) is not None and self._tell(process, ask):
                self._idle.put(process)

    def forget(self, scene: str) -> None:
        """Nobody is to take it into memory any more, or to know what moves in it."""
        with self._lock:
            self._warm.pop(scene, None)
            for process in self._alive.values():
                process.forget(scene)

    @staticmethod
    def _tell(process: _Process, ask: Ask) -> bool:
        """Whether it still lives afterwards."""
        try:
            process.tell(ask, 0.0, {})
            process.hear()
        except (EOFError, OSError):
            process.kill()
            return False
        except BaseException:  # what it answers later must not be read as another's answer
            process.kill()
            raise
        return True

    def close(self) -> None:
        """End all; nobody asks any more."""
        with self._lock:
            self._ended.set()
            for process in self._alive.values():
                process.kill()
        for thread in self._keepers:
            if thread.ident is not None:
                thread.join()

    def _keep(self) -> None:
        """Keep one process running."""
        name = threading.current_thread().name
        while not self._ended.is_set():
            try:
                self._live(name)
            except OSError as error:
                log.error("a process that plans could not be begun: %s", error)
            self._ended.wait(RESTART_S)

    def _begin(self, name: str, process: _Process) -> None:
        """Let a new one take the scenes into memory, then let it be asked."""
        told = list[Ask]()
        while True:
            with self._lock:
                new = [ask for ask in self._warm.values() if ask not in told]
                if not new:
                    process.ready = True
                    self._idle.put(process)
                    self._seen.add(name)
                    return
            for ask in new:
                told.append(ask)
                process.tell(ask, 0.0, {})
                process.hear()

    def _live(self, name: str) -> None:
        """From a process's beginning to its end."""
        with self._lock:
            if self._ended.is_set():
                return
            process = self._alive[name] = _Process(self._settings)
        try:
            process.wait_until_ready()
            self._begin(name, process)
        except (EOFError, OSError):  # it has ended, or hangs
            process.kill()
        code = process.wait()
        with self._lock:
            del self._alive[name]
            self.restarts += not self._ended.is_set()
        if not self._ended.is_set():
            log.error("a process that plans has ended with code %d; another one begins", code)


def _as_seen(id_: str, one: Living) -> Seen:
    return Seen(id_, Array.pack(one.points), one.until, one.number)

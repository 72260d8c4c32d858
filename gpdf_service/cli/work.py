"""A bar on a terminal while a verb works: the stage, the time so far and about how much is left.

It stands before the packages that do the work are loaded, so that something is seen at once.
"""

from __future__ import annotations

import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from types import TracebackType
from typing import Any

SHARES = {"read": 1.0, "build": 7.0, "fit": 4.0, "draw": 5.0, "again": 7.0, "cast": 1.0, "write": 1.0, "walk": 1.0}
"""[-] Processor time of the steps beside each other: of four clouds, and of two places that are made."""
NAMES = {
    "read": "read",
    "build": "build",
    "fit": "find where the body fits",
    "draw": "draw",
    "again": "build",
    "cast": "cast rays",
    "write": "write",
    "walk": "walk",
}
START = "start"
TICK_S = 0.5


@contextmanager
def mortal() -> Iterator[None]:
    """Ctrl-C ends the process at once: as an exception it could be lost in a callback of a library that is loading."""
    before = signal.getsignal(signal.SIGINT)
    ours = before is signal.default_int_handler and threading.current_thread() is threading.main_thread()
    if ours:  # else the shell wants it ignored
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        yield
    finally:
        if ours:
            signal.signal(signal.SIGINT, before)


def size_of_terminal() -> dict[str, int]:
    """Columns and rows for tqdm: some terminals say 0 of both, and it draws as much."""
    size = shutil.get_terminal_size()
    return {"ncols": size.columns, "nrows": size.lines}


class Work:
    """What a verb has to do, in steps.

    Args:
        *steps: Names of `SHARES`, in their order.
        load: The module that does the work, if it is to be loaded under the bar.
    """

    def __init__(self, *steps: str, load: str | None = "gpdf_service.pipeline") -> None:
        self._load = load
        self._steps, self._whole = steps, sum(SHARES[step] for step in steps)
        self._began, self._told_at, self._done = 0.0, 0.0, 0.0  # of the first step, not of what is loaded before
        self._lock, self._ended = threading.Lock(), threading.Event()
        terminal = sys.stderr.isatty() and find_spec("tqdm") is not None  # the light install has none
        form = "{desc:26}{bar} {elapsed}{postfix}"
        self._bar: Any = None
        if terminal:
            from tqdm import tqdm

            self._bar = tqdm(total=1.0, desc=START, bar_format=form, leave=False, **size_of_terminal())
        self._ticker = threading.Thread(target=self._tick, name="gpdf-bar", daemon=True) if terminal else None

    def __enter__(self) -> Work:
        """Show the bar, and load what builds and plans."""
        if self._ticker is not None:
            self._ticker.start()
        if self._load is None:
            return self
        with mortal():
            import_module(self._load)
        if self._ticker is not None:
            import_module("gpdf_service.cli.compiling").tell_of_compiling()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        """Take the bar away."""
        self._ended.set()
        if self._ticker is not None:
            self._ticker.join()
            self._bar.close()

    @contextmanager
    def step(self, step: str) -> Iterator[Callable[[str, float], None]]:
        """Do one of the steps; what it yields may be told its stages, and which share of it is done, 0 to 1."""
        before = sum(SHARES[one] for one in self._steps[: self._steps.index(step)])

        def progress(stage: str, done: float) -> None:
            self._tell(stage, (before + done * SHARES[step]) / self._whole)

        progress(NAMES[step], 0.0)
        yield progress

    def left(self, now: float) -> float | None:
        """Seconds until the end, as long as all goes on as it did until the last that was told; None before that."""
        if self._done == 0.0:
            return None
        return max(0.0, self._told_at * (1.0 - self._done) / self._done - (now - self._began - self._told_at))

    def say(self, text: str) -> None:
        """Print a line for people above the bar."""
        with self._lock:
            if self._bar is not None:
                self._bar.clear()
            print(text, file=sys.stderr)
            if self._bar is not None:
                self._bar.refresh()

    def _tell(self, stage: str, done: float) -> None:
        with self._lock:
            self._began = self._began or time.monotonic()
            self._told_at, self._done = time.monotonic() - self._began, done
            if self._bar is not None:
                self._bar.set_description_str(stage, refresh=False)
                self._bar.n = done
                self._show()

    def _tick(self) -> None:
        while not self._ended.wait(TICK_S):
            with self._lock:
                self._show()

    def _show(self) -> None:
        left = self.left(time.monotonic())
        if left is not None:
            self._bar.set_postfix_str(f"about {left:.0f} s left", refresh=False)
        self._bar.refresh()

"""`gpdf warm`: compile every kernel for this machine, so that the first run of a verb is like the second."""

from __future__ import annotations

import argparse
import gc
import json
import sys
import time
from concurrent.futures import ProcessPoolExecutor, wait
from multiprocessing import get_context
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path
from tempfile import TemporaryDirectory

from numba.core.event import Event, Listener, register
from tqdm import tqdm

from gpdf_service.cli.work import size_of_terminal
from gpdf_service.cores import end_with_parent, worker_count

BLINK = 0.1
"""[s] Between two looks at how many kernels there are."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


class _Counter(Listener):  # type: ignore[misc]  # Numba has no types
    """Counts each kernel that is compiled."""

    def __init__(self, count: Synchronized[int]) -> None:
        self._count = count

    def on_start(self, event: Event) -> None:
        """One that is not in the cache."""

    def on_end(self, event: Event) -> None:
        """One more is in the cache now."""
        with self._count.get_lock():
            self._count.value += 1


def _begin(folder: Path, compiled: Synchronized[int]) -> None:
    """What each process does first."""
    from gpdf_service.cli import GARBAGE
    from gpdf_service.kernel_cache import compile_in_turn

    gc.set_threshold(GARBAGE)
    end_with_parent()
    compile_in_turn(folder)
    register("numba:compile", _Counter(compiled))  # type: ignore[no-untyped-call]


def _run_step(name: str) -> None:
    from gpdf_service.warm import Warming

    Warming().steps()[name]()


def run(args: argparse.Namespace) -> int:
    """Run what needs the kernels; most of the time, if there is any to speak of, goes into compiling them.

    Each process takes one step after the other: they begin with kernels that others do not need. There is one more than
    there are cores: of two a quarter of the time goes into waiting for what the other one compiles.
    """
    from gpdf_service.kernel_cache import forget_others, kernels
    from gpdf_service.warm import Warming

    began, context = time.monotonic(), get_context("spawn")
    compiled = context.Value("i", 0)
    with (
        TemporaryDirectory() as folder,
        ProcessPoolExecutor(worker_count() + 1, context, _begin, (Path(folder), compiled)) as pool,
        tqdm(
            total=len(list(kernels())),
            desc="kernels",
            unit="kernel",
            disable=not sys.stderr.isatty(),
            **size_of_terminal(),
        ) as bar,
    ):
        left = {pool.submit(_run_step, name) for name in Warming().steps()}
        while left:
            done, left = wait(left, BLINK)
            for step in done:
                step.result()
            bar.update(compiled.value - bar.n)
    forget_others(kernels())
    seconds = time.monotonic() - began
    if args.json:
        print(json.dumps({"compiled": compiled.value, "seconds": seconds}))
    else:
        print(f"{compiled.value} kernels compiled in {seconds:.0f} s; the others were there")
    return 0

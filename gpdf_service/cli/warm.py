"""`gpdf warm`: compile every kernel for this machine, so that the first run of a verb is like the second."""

from __future__ import annotations

import argparse
import json
import sys
import time

from numba.core.event import Event, Listener, install_listener
from tqdm import tqdm

from gpdf_service.cli.work import size_of_terminal


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


class _Bar(Listener):  # type: ignore[misc]  # Numba has no types
    """Moves a bar with each kernel that is compiled."""

    def __init__(self, bar: tqdm[None]) -> None:
        self.compiled, self._bar = 0, bar

    def on_start(self, event: Event) -> None:
        """One that is not in the cache."""

    def on_end(self, event: Event) -> None:
        """One more is in the cache now."""
        self.compiled += 1
        self._bar.update()


def run(args: argparse.Namespace) -> int:
    """Run what needs the kernels; most of the time, if there is any to speak of, goes into compiling them."""
    from gpdf_service.kernel_cache import forget_others, kernels
    from gpdf_service.warm import Warming

    began = time.monotonic()
    with tqdm(
        total=len(list(kernels())), desc="kernels", unit="kernel", disable=not sys.stderr.isatty(), **size_of_terminal()
    ) as bar:
        told = _Bar(bar)
        with install_listener("numba:compile", told):
            for name, step in Warming().steps().items():
                bar.set_postfix_str(name)
                step()
    forget_others(kernels())
    seconds = time.monotonic() - began
    if args.json:
        print(json.dumps({"compiled": told.compiled, "seconds": seconds}))
    else:
        print(f"{told.compiled} kernels compiled in {seconds:.0f} s; the others were there")
    return 0

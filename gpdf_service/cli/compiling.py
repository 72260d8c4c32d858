"""Tells a terminal why the first run takes longer."""

from __future__ import annotations

import sys
from functools import cache

from numba.core.event import Event, Listener, register

TOLD = "compiling for this machine, once: up to a minute; what comes next starts in seconds"


class _Teller(Listener):  # type: ignore[misc]  # Numba has no types
    def __init__(self) -> None:
        self._told = False

    def on_start(self, event: Event) -> None:
        """A kernel that is not in the cache is being compiled."""
        if not self._told:
            self._told = True
            print(TOLD, file=sys.stderr)

    def on_end(self, event: Event) -> None:
        """Nothing to say."""


@cache
def tell_of_compiling() -> None:
    """Say so on stderr when the first kernel is compiled; once, however often it is asked for."""
    register("numba:compile", _Teller())  # type: ignore[no-untyped-call]

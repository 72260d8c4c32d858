"""The real service as a process of its own, for who asks it and must not share one with it."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

ENDS_S = 30.0
"""[s] A service that drains and closes its log needs less."""


@contextmanager
def begun(log: Path, *words: str) -> Iterator[subprocess.Popen[bytes]]:
    """`gpdf serve WORDS`, what it says added to a file; ended by SIGTERM, and also when we end, however we do.

    Raises:
        subprocess.TimeoutExpired: it did not end when it was told to, and was killed.
    """
    command = [sys.executable, "-m", "gpdf_service.cli", "serve", "--until-eof", *words]
    with (
        log.open("ab") as said,
        subprocess.Popen(command, stdin=subprocess.PIPE, stdout=said, stderr=said) as process,
    ):
        try:
            yield process
        finally:
            process.send_signal(signal.SIGTERM)
            try:
                process.wait(ENDS_S)
            except subprocess.TimeoutExpired:
                process.kill()
                raise

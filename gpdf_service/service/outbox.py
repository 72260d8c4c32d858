"""Answers that are sent by threads of their own, so that who gives them never waits for who should read them.

Zenoh's callbacks give some: refusals, and how the service is. A callback that waits holds up the callbacks behind it,
then the link that they came over, then all links.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass

from gpdf_service.service.fair_queue import FairQueue

log = logging.getLogger(__name__)

THREADS = 16
MOST_WAITING = 10_000
"""Answers that wait."""
MOST_BYTES = 256 << 20
"""That the questions to them hold."""


@dataclass(frozen=True, slots=True)
class _Letter:
    send: Callable[[], None]
    client: str
    size: int


class Outbox:
    """Safe for many threads."""

    def __init__(self) -> None:
        self._letters = FairQueue[_Letter](MOST_WAITING)
        self._bytes, self._lock = 0, threading.Lock()
        self._threads = [
            threading.Thread(target=self._run, name=f"gpdf-outbox-{i}", daemon=True) for i in range(THREADS)
        ]

    def start(self) -> None:
        """Send from now on."""
        for thread in self._threads:
            thread.start()

    def put(self, send: Callable[[], None], client: str, size: int) -> None:
        """Send it soon; returns at once, unless more waits than may.

        Args:
            send: Does it.
            client: To whom; of those that do not read, each has a few threads at most.
            size: Bytes that are held until then.
        """
        letter: _Letter | None = _Letter(send, client, size)
        with self._lock:
            fits = self._bytes + size <= MOST_BYTES
            self._bytes += size
        if fits:
            letter = self._letters.put(_Letter(send, client, size), client)
        if letter is not None:  # there is no room, or this is the end
            self._send(letter)

    def close(self) -> None:
        """Send what waits."""
        self._letters.close()
        for thread in self._threads:
            if thread.ident is not None:
                thread.join()

    def _run(self) -> None:
        while (letter := self._letters.get()) is not None:
            self._letters.done()
            with self._letters.sending(letter.client):
                self._send(letter)

    def _send(self, letter: _Letter) -> None:
        try:
            letter.send()
        except Exception:
            log.exception("an answer could not be sent")
        finally:
            with self._lock:
                self._bytes -= letter.size

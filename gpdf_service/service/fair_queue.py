"""A bounded queue with one line a client: the lines take turns, and when it is full the longest gives way.

The line of a client that does not take its answers waits until it does.
"""

from __future__ import annotations

import threading
from collections import Counter, deque
from collections.abc import Hashable, Iterator
from contextlib import contextmanager
from typing import Generic, TypeVar

T = TypeVar("T")
MOST_SENDING = 1
"""Answers on their way to one client, ahead of its next turn: each may wait until its link is closed."""


class FairQueue(Generic[T]):
    """Safe for many threads.

    Args:
        size: Items that may wait, of all clients together.
    """

    def __init__(self, size: int) -> None:
        self.size = size
        self._lines: dict[Hashable, deque[T]] = {}  # in the order of their turns; none is empty
        self._sending = Counter[Hashable]()
        self._waiting = self._at_work = 0
        self._closed = False
        self._change = threading.Condition()

    @property
    def unfinished(self) -> int:
        """Items that wait or are at work."""
        return self._waiting + self._at_work

    def put(self, item: T, client: Hashable) -> T | None:
        """Let an item wait; the item that finds no room: this one, or the last of the longest line, or none.

        A client of a longer line than the others' loses its own item, so who asks seldom is never turned away for
        who asks a lot.
        """
        with self._change:
            if self._closed:
                return item
            line = self._lines.get(client, deque[T]())
            displaced: T | None = None
            if self._waiting == self.size:
                longest = max(self._lines, key=lambda name: len(self._lines[name]))
                if len(line) + 1 >= len(self._lines[longest]):
                    return item
                displaced = self._lines[longest].pop()
                self._waiting -= 1
            line.append(item)
            self._lines[client] = line  # a new line is the last to have its turn
            self._waiting += 1
            self._change.notify()
            return displaced

    def get(self) -> T | None:
        """The next item, awaited; say `done` after the work. None when the queue is closed and empty."""
        with self._change:
            self._change.wait_for(lambda: self._turn() is not None or (self._closed and not self._waiting))
            client = self._turn()
            if client is None:
                return None
            line = self._lines.pop(client)
            item = line.popleft()
            if line:
                self._lines[client] = line
            self._waiting -= 1
            self._at_work += 1
            return item

    def done(self) -> None:
        """The work on one item has ended."""
        with self._change:
            self._at_work -= 1

    @contextmanager
    def sending(self, client: Hashable) -> Iterator[None]:
        """An answer is on its way, after `done`."""
        with self._change:
            self._sending[client] += 1
        try:
            yield
        finally:
            with self._change:
                self._sending[client] -= 1
                if not self._sending[client]:
                    del self._sending[client]
                self._change.notify_all()

    def _turn(self) -> Hashable | None:
        """The client whose turn it is."""
        return next((client for client in self._lines if self._sending[client] < MOST_SENDING), None)

    def close(self) -> None:
        """Take no more; what waits is still given out."""
        with self._change:
            self._closed = True
            self._change.notify_all()

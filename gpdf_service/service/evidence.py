"""What of an exchange goes into the log: its bytes, or what proves which bytes they were.

Plans and distances are kept whole: they are asked again from the log. Of a cloud, a file or a refused request its
hash, size and first bytes say as much as anybody will ask; and who sends a lot is not to wash away what others did.
"""

from __future__ import annotations

import hashlib
import threading
import time
from collections import Counter, OrderedDict
from collections.abc import Callable

import msgspec
from gpdf_schemas import Status, keys

WHOLE_BYTES = 1024
"""A body of so much is kept as it is: its hash would not be much shorter."""
HEAD_BYTES = 64
"""Of a longer one: enough to see what it began as."""
REFUSED = frozenset({Status.INVALID_REQUEST, Status.BUSY, Status.UNAVAILABLE})
"""Answers that no plan was made for."""
RATE = 1e6
"""[B/s] Kept whole of one client: ten plans a second, of 60 kB each, and half as much again."""
BURST_S = 300.0
"""[s] Of that rate that it may keep at once."""
REFUSALS = 20.0
"""[1/s] Refused requests that are kept of one client; the others are counted."""
CLIENTS = 1000
"""That are known at once; who has asked for nothing for longest is forgotten."""
Clock = Callable[[], float]


def digest_of(body: bytes) -> bytes:
    """What stands for a body: how many bytes, their SHA-256, the first of them; short ones as they are."""
    if len(body) <= WHOLE_BYTES:
        return body
    facts = {"bytes": len(body), "sha256": hashlib.sha256(body).hexdigest(), "head": body[:HEAD_BYTES]}
    return msgspec.msgpack.encode(facts)


class _Bucket:
    """So much a second, and a reserve."""

    def __init__(self, rate: float, now: float) -> None:
        self._rate, self._most = rate, rate * BURST_S
        self._left, self._at = self._most, now

    def take(self, amount: float, now: float) -> bool:
        """Whether so much is left; then it is gone."""
        self._left, self._at = min(self._most, self._left + self._rate * (now - self._at)), now
        if amount > self._left:
            return False
        self._left -= amount
        return True


class Evidence:
    """Decides what is kept of an exchange; safe for many threads.

    Args:
        clock: Monotonic seconds.

    Attributes:
        thrifty: Whether the log has no room for bodies at all.
    """

    def __init__(self, clock: Clock = time.monotonic) -> None:
        self._clock, self.thrifty = clock, False
        self._buckets: OrderedDict[str, tuple[_Bucket, _Bucket]] = OrderedDict()
        self._everybody = _Bucket(10.0 * REFUSALS, clock())
        self._muted = Counter[str]()
        self._lock = threading.Lock()

    def of(
        self, client: str, key: str, status: Status, request: bytes, reply: bytes
    ) -> tuple[str, bytes, bytes] | None:
        """What to write of an exchange.

        Args:
            client: What it calls itself.
            key: What it asked.
            status: How that ended.
            request: Its bytes.
            reply: Its bytes.

        Returns:
            The topic, and what stands for request and reply; None if it is only counted.
        """
        if key == keys.SCENE_DRAW and status not in REFUSED:  # the scene's digest, which is in the log, stands for it
            return None
        with self._lock:
            now = self._clock()
            size = len(request) + len(reply)
            if status in REFUSED:  # a new name is had for nothing: so there is a rate of all together, too
                if self._of(client, now)[1].take(1.0, now) and self._everybody.take(1.0, now):
                    return _short(key, request, reply)
                self._muted[client] += 1
                return None
            if key not in (keys.PLAN, keys.DISTANCE) or self.thrifty or not self._of(client, now)[0].take(size, now):
                return _short(key, request, reply)
        return key, request, reply

    def publication(self, key: str, data: bytes) -> tuple[str, bytes]:
        """What to write of something that was published, and its topic: nobody says who published it."""
        with self._lock:
            if self.thrifty or not self._of(key, now := self._clock())[0].take(len(data), now):
                return f"{key}/digest", digest_of(data)
        return key, data

    def muted(self) -> dict[str, int]:
        """How many refused requests of each client were only counted, since this was asked."""
        with self._lock:
            found, self._muted = dict(self._muted), Counter()
        return found

    def _of(self, client: str, now: float) -> tuple[_Bucket, _Bucket]:
        if client not in self._buckets:
            self._buckets[client] = _Bucket(RATE, now), _Bucket(REFUSALS, now)
        self._buckets.move_to_end(client)
        while len(self._buckets) > CLIENTS:
            self._buckets.popitem(last=False)
        return self._buckets[client]


def _short(key: str, request: bytes, reply: bytes) -> tuple[str, bytes, bytes]:
    """Under a topic of its own where something is left out, so that nobody takes a hash for a message."""
    short = digest_of(request), digest_of(reply)
    return (key if short == (request, reply) else f"{key}/digest"), *short

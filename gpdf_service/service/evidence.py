"""What of an exchange goes into the log: its bytes, what proves which bytes they were, or that there was one.

Plans and distances are kept whole: they are asked again from the log. Of a cloud, a file or a refused request its
hash, size and first bytes say as much as anybody will ask; and who sends a lot is not to wash away what others did.
So each kind of record has a rate of its own, whoever asks, and what is beyond it is counted.
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
SHORT_RATE = 1e4
"""[B/s] Of hashes and other short records, under each key: 25 a second. Under all together it is 10 GB a day."""
PICTURE_RATE = 2.5e5
"""[B/s] Of what viewers draw of scenes and of what moves in them: a person, ten times a second."""
MUTED_NAMES = 100
"""Clients that are named when what they sent is only counted; the others share a name."""
MUTED_S = 10.0
"""[s] Between two such counts."""
OTHERS = "others"
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
        if amount > self.left(now):
            return False
        self._left -= amount
        return True

    def left(self, now: float) -> float:
        """What may be taken; less than nothing after a `charge`."""
        self._left, self._at = min(self._most, self._left + self._rate * (now - self._at)), now
        return self._left

    def charge(self, amount: float) -> None:
        """So much is gone, whether it was left or not."""
        self._left -= amount


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
        self._everybody, self._pictures = _Bucket(10.0 * REFUSALS, clock()), _Bucket(PICTURE_RATE, clock())
        self._short: dict[str, _Bucket] = {}  # by key
        self._muted, self._muted_told = Counter[str](), -float("inf")
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
            if status in REFUSED:  # a new name is had for nothing: so there is a rate of all together, too
                if not (self._of(client, now)[1].take(1.0, now) and self._everybody.take(1.0, now)):
                    self._mute(client)
                    return None
            elif key in (keys.PLAN, keys.DISTANCE) and self._is_kept_whole(client, len(request) + len(reply), now):
                return key, request, reply
            short = digest_of(request), digest_of(reply)
            if not self._may_be_short(key, sum(map(len, short)), now):
                self._mute(client)
                return None
        # under a topic of its own where something is left out, so that nobody takes a hash for a message
        return (key if short == (request, reply) else f"{key}/digest"), *short

    def publication(self, key: str, data: bytes) -> tuple[str, bytes] | None:
        """What to write of something that was published, and its topic; None if it is only counted.

        Nobody says who published it: so each key has a share, as a client has.
        """
        with self._lock:
            now = self._clock()
            if self._is_kept_whole(key, len(data), now):
                return key, data
            short = digest_of(data)
            if self._may_be_short("", len(short), now):
                return f"{key}/digest", short
            self._mute(key)
            return None

    @property
    def may_draw(self) -> bool:
        """Whether there is room for one more picture; say with `drawn` what it took."""
        with self._lock:
            return not self.thrifty and self._pictures.left(self._clock()) > 0.0

    def drawn(self, size: int) -> None:
        """A picture of so many bytes was recorded."""
        with self._lock:
            self._pictures.charge(size)

    def muted(self, *, at_once: bool = False) -> dict[str, int]:
        """How much of each client was only counted, since this was asked; nothing if that was just now."""
        with self._lock:
            now = self._clock()
            if not self._muted or not (at_once or now - self._muted_told >= MUTED_S):
                return {}
            found, self._muted, self._muted_told = dict(self._muted), Counter(), now
        return found

    def _is_kept_whole(self, client: str, size: int, now: float) -> bool:
        return not self.thrifty and self._of(client, now)[0].take(size, now)

    def _may_be_short(self, key: str, size: int, now: float) -> bool:
        return self._short.setdefault(key, _Bucket(SHORT_RATE, now)).take(size, now)

    def _mute(self, client: str) -> None:
        named = client in self._muted or len(self._muted) < MUTED_NAMES
        self._muted[client if named else OTHERS] += 1

    def _of(self, client: str, now: float) -> tuple[_Bucket, _Bucket]:
        if client not in self._buckets:
            self._buckets[client] = _Bucket(RATE, now), _Bucket(REFUSALS, now)
        self._buckets.move_to_end(client)
        while len(self._buckets) > CLIENTS:
            self._buckets.popitem(last=False)
        return self._buckets[client]

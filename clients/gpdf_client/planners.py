"""Which planner to ask: the least loaded of those that are alive, as far as this client knows."""

from __future__ import annotations

import contextlib
import random
import threading
from collections.abc import Collection

import zenoh
from gpdf_schemas import keys


class Planners:
    """Follows the planners' liveliness tokens; safe for many threads.

    Args:
        session: A session that leads to them.
        rng: Chooses between planners that are as loaded as each other, so that clients do not all ask the same.
    """

    def __init__(self, session: zenoh.Session, rng: random.Random) -> None:
        self._load: dict[str, float] = {}
        self._rng = rng
        self._lock = threading.Lock()
        self._subscriber = session.liveliness().declare_subscriber(f"{keys.ALIVE}/*", history=True)
        # Zenoh's own thread for a callback would keep an interpreter from ending.
        self._thread = threading.Thread(target=self._follow, name="gpdf-planners", daemon=True)
        self._thread.start()

    def join(self) -> None:
        """Wait for the thread, once the session is closed: one that is inside Zenoh when Python ends aborts it."""
        self._thread.join()

    def alive(self) -> list[str]:
        """Ids of those that are there."""
        with self._lock:
            return list(self._load)

    def pick(self, avoid: Collection[str] = ()) -> str | None:
        """The least loaded one that is not to be avoided; None if there is none."""
        with self._lock:
            known = [(load, self._rng.random(), planner) for planner, load in self._load.items()]
        return min((item for item in known if item[2] not in avoid), default=(0.0, 0.0, None))[2]

    def learn(self, planner: str, load: float) -> None:
        """Remember how loaded a planner said it was."""
        with self._lock:
            if planner in self._load:
                self._load[planner] = load

    def _follow(self) -> None:
        with contextlib.suppress(zenoh.ZError):  # the session has ended
            for sample in self._subscriber:
                self._seen(sample)

    def _seen(self, sample: zenoh.Sample) -> None:
        planner = str(sample.key_expr).rpartition("/")[2]
        with self._lock:
            if sample.kind == zenoh.SampleKind.PUT:
                self._load.setdefault(planner, 0.0)
            else:
                self._load.pop(planner, None)

"""How soon a guided person feels it: from a pose to its cue, from an obstacle to the stop, in real time."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import numpy as np
import zenoh
from gpdf_client import Client
from gpdf_guidance import Guide, Planner
from gpdf_guidance.live import LiveGuide
from gpdf_schemas import (
    Array,
    CueAction,
    CueMessage,
    MovingObstacle,
    MovingObstacles,
    PoseMessage,
    decode,
    encode,
    keys,
)

from gpdf_service.bench.report import Row
from gpdf_service.types import FloatArray

NAME = "bench"
POSES_PER_S = 20
"""Of an indoor localiser."""
POSE_EVERY_S = 1.0 / POSES_PER_S
AHEAD = 1.0
"""[m] On the path an obstacle appears: it stops from 2 m."""
LONGEST_S = 10.0
"""[s] A cue that takes longer is lost."""
TOLD_S = 60.0
"""[s] Who stands is told of the way, or of what stopped him, before he goes."""
OBSTACLES = 20


class Body:
    """Stands at a place, sends poses, and keeps when each cue came."""

    def __init__(self, session: zenoh.Session, pose: FloatArray) -> None:
        self._session, self._pose = session, pose
        self.cues: list[tuple[CueMessage, float]] = []
        self._halt = threading.Event()
        self._thread = threading.Thread(target=self._send, daemon=True)
        self._subscriber = session.declare_subscriber(f"{keys.CUE}/{NAME}", self._feel)

    def __enter__(self) -> Body:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._halt.set()
        self._thread.join()
        self._subscriber.undeclare()  # type: ignore[no-untyped-call]

    def wait_to_go(self) -> None:
        """Until he may go: a stop that is measured from then on is a new one.

        Raises:
            TimeoutError: he stands for longer than he is told of anything.
        """
        if np.isinf(self.wait_for(lambda cue: cue.action is not CueAction.STOP, TOLD_S)):
            raise TimeoutError(f"the guide lets nobody go for {TOLD_S:.0f} s")

    def wait_for(self, wanted: Callable[[CueMessage], bool], longest_s: float = LONGEST_S) -> float:
        """Until a cue that was not there before; when it came [s], infinity for never."""
        seen, until = len(self.cues), time.time() + longest_s
        while time.time() < until:
            for cue, came in self.cues[seen:]:
                if wanted(cue):
                    return came
            time.sleep(0.001)
        return float("inf")

    def _send(self) -> None:
        while not self._halt.wait(POSE_EVERY_S):
            x, y, z, heading = self._pose.tolist()
            message = PoseMessage(position=[x, y, z], heading=heading, stamp=time.time(), accuracy=0.02)
            self._session.put(f"{keys.POSE}/{NAME}", encode(message))

    def _feel(self, sample: zenoh.Sample) -> None:
        self.cues.append((decode(sample.payload.to_bytes(), CueMessage), time.time()))


def measure_cues(client: Client, endpoint: str, scene: str, start: FloatArray, goal: FloatArray, seconds: float) -> Row:
    """Poses for `seconds`, then obstacles that come and go; over Zenoh, each party with a session of its own."""
    path = client.plan(scene, start.tolist(), goal.tolist()).trajectory
    assert path is not None
    here = np.append(path.ground[0], path.headings[0])
    with Client.connect(endpoint) as other, Body(other.session, here) as body, guiding(endpoint, scene, goal) as guide:
        body.wait_to_go()
        body.cues.clear()
        time.sleep(seconds)
        felt = list(body.cues)
        late = _latencies(felt)
        stops = [_stop_after(other, scene, body, guide) for _ in range(OBSTACLES)]
    return {
        "cues": len(late),
        "cues_per_s": len(felt) / seconds,
        "pose_to_cue_ms_p50": 1e3 * float(np.quantile(late, 0.5)),
        "pose_to_cue_ms_p99": 1e3 * float(np.quantile(late, 0.99)),
        "obstacles": len(stops),
        "obstacle_to_stop_ms_p50": 1e3 * float(np.quantile(stops, 0.5)),
        "obstacle_to_stop_ms_max": 1e3 * max(stops),
    }


@contextmanager
def guiding(endpoint: str, scene: str, goal: FloatArray) -> Iterator[Guide]:
    """A guide at work, in a thread."""
    stop = threading.Event()
    with Client.connect(endpoint) as client, ThreadPoolExecutor(1) as pool:
        guide = Guide(Planner(client, scene), goal.tolist())
        running = pool.submit(LiveGuide(client.session, guide, NAME, lambda *_: None).run, stop.is_set)
        try:
            yield guide
        finally:
            stop.set()
            running.result()


def _latencies(cues: list[tuple[CueMessage, float]]) -> FloatArray:
    """From each pose to the first cue that knows it [s]."""
    first: dict[float, float] = {}
    for cue, came in cues:
        first.setdefault(cue.pose_stamp, came)
    return np.array([came - stamp for stamp, came in first.items()])


def _stop_after(client: Client, scene: str, body: Body, guide: Guide) -> float:
    """From an obstacle on the path to the first cue that says stop [s]; it is gone again afterwards."""
    assert guide.route is not None
    place = guide.route.at(AHEAD)
    column = np.column_stack([np.tile(place[:2], (9, 1)), place[2] + np.linspace(0.1, 1.9, 9)])
    seen = MovingObstacle(id=NAME, points=Array.pack(column), lifetime_s=60.0)
    told = time.time()
    client.session.put(keys.obstacles(scene), encode(MovingObstacles(obstacles=[seen])))
    came = body.wait_for(lambda cue: cue.action is CueAction.STOP)
    client.session.put(
        keys.obstacles(scene), encode(MovingObstacles(obstacles=[MovingObstacle(id=NAME, lifetime_s=0.0)]))
    )
    body.wait_to_go()
    return came - told

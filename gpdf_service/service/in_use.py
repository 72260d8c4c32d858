"""Trajectories that somebody may be following, and whether what moves is in their way."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from gpdf_schemas import TrajectoryCut
from scipy.spatial import cKDTree

from gpdf_service.ground.foot import LEAST_OBSTACLE
from gpdf_service.planning.footprint import disc_places
from gpdf_service.types import Agent, FloatArray, Trajectory

log = logging.getLogger(__name__)

PATIENCE, GRACE_S = 3.0, 60.0
"""A trajectory counts as in use for so many times its duration and so long [s]: guided people stop on their way."""
MOST, MOST_PLACES = 1000, 4_000_000
"""Trajectories that are remembered, and places of discs along them, 0.1 kB each once something moves; the oldest go."""
SPACING = 0.04
"""[m] Between looks along a trajectory: it passes a point at most 1 mm closer between them than at them, at 0.2 m."""
TOUCH = 0.002
"""[m] What is closer than the radius by more touches: a trajectory planned round something is not cut by it."""
Clock = Callable[[], float]


@dataclass(frozen=True)
class _Swept:
    ground: FloatArray  # contact points, closely spaced, (n, 3)
    discs: FloatArray  # the body's discs there, (n, k, 3)
    times: FloatArray  # since the start [s], (n,)
    until: float

    @cached_property
    def places(self) -> cKDTree:
        """The discs' centres in plan."""
        return cKDTree(self.discs.reshape(-1, 3)[:, :2])

    @cached_property
    def box(self) -> tuple[FloatArray, FloatArray]:
        """Around the discs' centres."""
        discs = self.discs.reshape(-1, 3)
        return discs.min(axis=0), discs.max(axis=0)


@dataclass(frozen=True)
class _InUse:
    scene: str
    request_id: str
    agent: Agent
    given: float
    trajectory: Trajectory

    @cached_property
    def places(self) -> int:
        """Of discs that `swept` has."""
        return self.agent.discs * (1 + int(_pieces(self.trajectory, self.agent).sum()))

    @cached_property
    def swept(self) -> _Swept:
        """Reckoned on first use: where nothing moves, a plan pays little for it."""
        return _Swept(*_dense(self.trajectory, self.agent), self.given + PATIENCE * self.trajectory.duration + GRACE_S)


class InUse:
    """What this planner gave out; safe for many threads. One thread looks, at the newest state of a scene only.

    Args:
        points_of: Points of what moves in a scene now, by id.
        on_cut: Told of each trajectory that is cut, each time that something is published.
        planner: Id of the planner.
        clock: Monotonic seconds.
    """

    def __init__(
        self,
        points_of: Callable[[str], Mapping[str, FloatArray]],
        on_cut: Callable[[TrajectoryCut], None],
        planner: str = "",
        clock: Clock = time.monotonic,
    ) -> None:
        self._points_of, self._on_cut, self._planner, self._clock = points_of, on_cut, planner, clock
        self._known, self._places = deque[_InUse](), 0
        self._asked: dict[str, list[_InUse] | None] = {}  # in which scenes to look, and at which: None for all
        self._ended = False
        self._lock = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="gpdf-cuts", daemon=True)

    def start(self) -> None:
        """Look from now on."""
        self._thread.start()

    def close(self) -> None:
        """Look no more."""
        with self._lock:
            self._ended = True
            self._lock.notify_all()
        if self._thread.ident is not None:
            self._thread.join()

    def remember(self, scene: str, request_id: str, agent: Agent, trajectory: Trajectory) -> None:
        """A trajectory was given out; what came while it was planned counts, too."""
        used, moves = _InUse(scene, request_id, agent, self._clock(), trajectory), bool(self._points_of(scene))
        with self._lock:
            self._known.append(used)
            self._places += used.places
            while len(self._known) > MOST or (self._places > MOST_PLACES and len(self._known) > 1):
                self._places -= self._known.popleft().places
            if moves and (asked := self._asked.setdefault(scene, [])) is not None:
                asked.append(used)  # the others were looked at when it came
                self._lock.notify_all()

    def look(self, scene: str) -> None:
        """Something has changed in a scene; returns at once."""
        with self._lock:
            self._asked[scene] = None
            self._lock.notify_all()

    def cuts(self, scene: str, among: Sequence[_InUse] | None = None) -> list[TrajectoryCut]:
        """The trajectories of a scene that are cut now, of all or of those `among` them."""
        with self._lock:
            known = [used for used in self._known if used.scene == scene] if among is None else among
        now, points = self._clock(), self._points_of(scene) if known else {}
        found = (self._cut(used, points) for used in known if points and used.swept.until > now)
        return [cut for cut in found if cut is not None]

    def _cut(self, used: _InUse, obstacles: Mapping[str, FloatArray]) -> TrajectoryCut | None:
        swept = used.swept
        first = {id_: _first_touch(swept, used.agent, points) for id_, points in obstacles.items()}
        met = {id_: index for id_, index in first.items() if index is not None}
        if not met:
            return None
        index = min(met.values())
        return TrajectoryCut(
            scene=used.scene,
            request_id=used.request_id,
            planner=self._planner,
            obstacles=sorted(met),
            time=float(swept.times[index]),
            at=swept.ground[index].tolist(),
        )

    def _run(self) -> None:
        while True:
            with self._lock:
                self._lock.wait_for(lambda: self._asked or self._ended)
                if self._ended:
                    return
                scene, among = self._asked.popitem()
            try:
                for cut in self.cuts(scene, among):
                    self._on_cut(cut)
            except Exception:
                log.exception("trajectories in use in scene %s", scene)


def _dense(trajectory: Trajectory, agent: Agent) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Contact points and discs such that none moves further than `SPACING` between two, and their times."""
    poses = np.column_stack([trajectory.ground, np.unwrap(trajectory.headings)])
    knots = np.concatenate([[0.0], np.cumsum(_pieces(trajectory, agent))])
    at = np.arange(knots[-1] + 1)
    dense = np.column_stack([np.interp(at, knots, column) for column in poses.T])
    places = [disc_places(dense[:, [0, 1, 3]], offset) for offset in agent.offsets]
    discs = np.stack([np.column_stack([place, dense[:, 2]]) for place in places], axis=1)
    return dense[:, :3], discs, np.interp(at, knots, trajectory.times)


def _pieces(trajectory: Trajectory, agent: Agent) -> FloatArray:
    """In how many pieces what lies between two waypoints is looked at, (n - 1,)."""
    turned = np.abs(np.diff(np.unwrap(trajectory.headings)))
    moved = np.linalg.norm(np.diff(trajectory.ground[:, :2], axis=0), axis=1) + agent.offsets[-1] * turned
    pieces: FloatArray = np.maximum(1, np.ceil(moved / SPACING))
    return pieces


def _first_touch(swept: _Swept, agent: Agent, points: FloatArray) -> int | None:
    """Where the body, upright on its contact point, first meets one of the points (k, 3)."""
    radius, (low, high) = agent.disc_radius, swept.box
    points = points[
        ((points >= low - radius) & (points <= high + np.array([radius, radius, agent.height]))).all(axis=1)
    ]
    if not len(points):
        return None
    pairs = swept.places.sparse_distance_matrix(cKDTree(points[:, :2]), radius - TOUCH, output_type="ndarray")
    above = points[pairs["j"], 2] - swept.discs.reshape(-1, 3)[pairs["i"], 2]
    touching = pairs["i"][(above > LEAST_OBSTACLE) & (above < agent.height)]
    return int(touching.min()) // agent.discs if len(touching) else None

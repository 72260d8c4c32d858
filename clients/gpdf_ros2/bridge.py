"""The bridge: a ROS 2 robot sends its pose and a goal, and receives a path; a cloud from a topic becomes the scene."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType
from typing import Any

import zenoh
from gpdf_client import Client, ClientError, PlanResult, Status
from gpdf_client.trajectory import FloatArray

from gpdf_ros2 import messages
from gpdf_ros2.topics import Dialect, Topic, attachment, node_token, publisher_id

log = logging.getLogger(__name__)

POSE_OLD_S = 2.0
"""[s] An older pose is no start: the robot may be elsewhere. AMCL and SLAM publish at 1 Hz and more."""
UPLOAD_S = 300.0
"""[s] For a cloud to become a scene."""


@dataclass(frozen=True, slots=True)
class Names:
    """Names on ROS's side.

    Attributes:
        goal: Topic on which goals come (PoseStamped).
        pose: Topic on which the robot's pose comes (PoseStamped).
        path: Topic on which paths go (Path); an empty one where there is none.
        cloud: Topic on which clouds come that become the scene (PointCloud2); empty for none.
        frame: The scene's frame; what comes in another one is refused.
    """

    goal: str = "/goal_pose"
    pose: str = "/robot_pose"
    path: str = "/plan"
    cloud: str = ""
    frame: str = "map"


class Bridge:
    """Answers goals of one robot. A context manager; everything is answered by one thread, the newest first.

    Args:
        client: Connection to the service.
        session: Connection to ROS 2's side; may be the client's own.
        scene: Name of the scene.
        agent: The robot's body.
        names: Topics and frame.
        dialect: How ROS 2 comes to Zenoh.
        domain: ROS_DOMAIN_ID.
    """

    def __init__(
        self,
        client: Client,
        session: zenoh.Session,
        scene: str,
        agent: str | dict[str, Any] = "human",
        *,
        names: Names | None = None,
        dialect: Dialect = Dialect.RMW_ZENOH,
        domain: int = 0,
    ) -> None:
        self.client, self.session, self.scene, self.agent = client, session, scene, agent
        self.names, self.dialect, self.domain = names or Names(), dialect, domain
        self._start: tuple[FloatArray, float] | None = None
        self._waiting: dict[str, bytes] = {}
        self._wake, self._ended, self._sequence = threading.Condition(), False, 0
        self._thread = threading.Thread(target=self._work, name="gpdf-ros2", daemon=True)
        self._declared: list[Any] = []

    def __enter__(self) -> Bridge:
        zid = str(self.session.zid())
        self._path = messages.topic(self.names.path, messages.PATH)
        self._token = self._path.token("MP", zid, 1, self.domain)
        self._publisher = self.session.declare_publisher(self._path.key(self.dialect, self.domain))
        self._declared.append(self._publisher)
        tokens = [node_token(zid, self.domain), self._token]
        hear: list[tuple[str, str, Callable[[zenoh.Sample], None]]] = [
            (self.names.pose, messages.POSE, self._take_pose),
            (self.names.goal, messages.POSE, lambda sample: self._hand_over("goal", sample)),
        ]
        if self.names.cloud:
            hear.append((self.names.cloud, messages.CLOUD, lambda sample: self._hand_over("cloud", sample)))
        for number, (name, kind, act) in enumerate(hear, start=2):
            heard: Topic = messages.topic(name, kind)
            self._declared.append(self.session.declare_subscriber(heard.key(self.dialect, self.domain), act))
            tokens.append(heard.token("MS", zid, number, self.domain))
        if self.dialect is Dialect.RMW_ZENOH:
            self._declared += [self.session.liveliness().declare_token(token) for token in tokens]
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._wake:
            self._ended = True
            self._wake.notify()
        self._thread.join()
        for entity in self._declared:
            entity.undeclare()

    def _take_pose(self, sample: zenoh.Sample) -> None:
        try:
            frame, position, _ = messages.decode_pose(sample.payload.to_bytes())
        except ClientError as error:
            log.warning("%s: %s", sample.key_expr, error)
            return
        if frame != self.names.frame:
            log.warning("a pose in frame %r, not %r, is not used", frame, self.names.frame)
            return
        self._start = position, time.monotonic()

    def _hand_over(self, what: str, sample: zenoh.Sample) -> None:
        """Zenoh's callback only hands over; a newer goal or cloud takes the place of one that waits."""
        with self._wake:
            self._waiting[what] = sample.payload.to_bytes()
            self._wake.notify()

    def _work(self) -> None:
        while True:
            with self._wake:
                self._wake.wait_for(lambda: self._ended or self._waiting)
                if self._ended:
                    return
                what = "cloud" if "cloud" in self._waiting else "goal"
                data = self._waiting.pop(what)
            try:
                (self._load if what == "cloud" else self._answer)(data)
            except Exception:
                log.exception("%s of %d bytes", what, len(data))

    def _load(self, data: bytes) -> None:
        try:
            frame, points = messages.decode_cloud(data)
            if frame != self.names.frame:
                log.warning("a cloud in frame %r, not %r, is not used", frame, self.names.frame)
                return
            self.client.load_scene(self.scene, upload=points, timeout_s=UPLOAD_S)
            log.info("%d points are the scene %s now", len(points), self.scene)
        except ClientError as error:
            log.warning("a cloud is not used: %s", error)

    def _answer(self, data: bytes) -> None:
        """Plan to a goal, and send the path; an empty one where there is none, so that no robot follows an old one."""
        trajectory = None
        try:
            result = self._plan(data)
            trajectory = result.trajectory
            log.info("%s %s", result.status, result.message)
        except ClientError as error:
            log.warning("no path: %s", error)
        except Exception:
            log.exception("no path")
        self._send(messages.encode_path(self.names.frame, trajectory, time.time_ns()))

    def _plan(self, data: bytes) -> PlanResult:
        frame, goal, _ = messages.decode_pose(data)
        if frame != self.names.frame:
            raise ClientError(f"the goal is in frame {frame!r}, not in {self.names.frame!r}")
        if self._start is None:
            raise ClientError(f"no pose has come on {self.names.pose}")
        start, came = self._start
        if time.monotonic() - came > POSE_OLD_S:
            raise ClientError(f"the last pose on {self.names.pose} came {time.monotonic() - came:.1f} s ago")
        # Tools that click goals on a flat map send z = 0; a height counts only where there is more than one storey.
        result = self.client.plan(self.scene, start[:2].tolist(), goal[:2].tolist(), self.agent)
        if result.status is Status.AMBIGUOUS_LEVEL:
            result = self.client.plan(self.scene, start.tolist(), goal.tolist(), self.agent)
        return result

    def _send(self, data: bytes) -> None:
        self._sequence += 1
        if self.dialect is Dialect.ROS2DDS:
            self._publisher.put(data)
            return
        beside = attachment(self._sequence, time.time_ns(), publisher_id(self._token))
        self._publisher.put(data, attachment=beside)

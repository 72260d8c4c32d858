"""Guided people and robots that are on their way now, as they say themselves over Zenoh."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import viser
import viser.transforms as vtf
import zenoh
from gpdf_client import Client
from gpdf_schemas import CueAction, CueMessage, DecodeError, PoseMessage, VelocityMessage, decode, keys

from gpdf_service.viewer import colours
from gpdf_service.viewer.frame import Frame

OLD_S = 3.0
"""[s] A pose older than this is shown no more: a body walks several metres in that time."""
MOST = 100
"""Bodies that are shown at once."""
RADIUS, HEIGHT = 0.15, 0.1
"""[m] Of a marker's disc."""
LIFT = np.array([0.0, 0.0, 0.5 * HEIGHT])
"""[m] A disc is placed by its middle."""
NOSE = np.array([[LIFT, LIFT + np.array([0.55, 0.0, 0.0])]])
"""[m] The arrow from a marker's middle to where the body faces."""
Sent = PoseMessage | CueMessage | VelocityMessage
STREAMS: dict[str, type[Sent]] = {keys.POSE: PoseMessage, keys.CUE: CueMessage, keys.VELOCITY: VelocityMessage}


class Heard:
    """The newest pose, cue and velocity of each body by name; safe for many threads.

    Args:
        clock: Seconds since 1970, as the stamps are.
    """

    def __init__(self, clock: Callable[[], float] = time.time) -> None:
        self._clock = clock
        self._newest: dict[type[Sent], dict[str, Sent]] = {kind: {} for kind in STREAMS.values()}
        self._lock = threading.Lock()

    def take(self, key: str, payload: bytes) -> None:
        """Keep what was published on `key`, if it can be read and is newer than what is known."""
        stream, _, name = key.rpartition("/")
        try:
            message = decode(payload, STREAMS[stream])
        except DecodeError:
            return  # what cannot be read is no pose: the last one grows old, and is gone
        if isinstance(message, PoseMessage) and len(message.position) != 3:
            return
        with self._lock:
            known = self._newest[type(message)]
            before = known.get(name)
            if self._fresh(message) and (before is None or message.stamp >= before.stamp):
                known[name] = message

    def now(self) -> dict[str, tuple[PoseMessage, str]]:
        """Fresh poses by name, with what the body is told to do in words; what is old is forgotten."""
        with self._lock:
            for kind, known in self._newest.items():
                self._newest[kind] = {name: message for name, message in known.items() if self._fresh(message)}
            poses, *told = self._newest.values()
            orders = {name: _order(message) for known in told for name, message in known.items()}
            named = list(poses.items())[:MOST]
        return {name: (pose, orders.get(name, "")) for name, pose in named if isinstance(pose, PoseMessage)}

    def _fresh(self, message: Sent) -> bool:
        return abs(self._clock() - message.stamp) <= OLD_S


@dataclass(frozen=True, slots=True)
class _Marker:
    disc: viser.CylinderHandle
    label: viser.LabelHandle


class LiveLayers:
    """A marker with name and heading for each body; poses are in the frame of the scene that is shown."""

    def __init__(self, scene: viser.SceneApi, frame: Frame) -> None:
        self._scene, self._frame = scene, frame
        self.heard = Heard()
        self._markers: dict[str, _Marker] = {}
        self._session: zenoh.Session | None = None
        self._subscribers: list[zenoh.Subscriber[None]] = []
        self._made = 0

    @property
    def names(self) -> frozenset[str]:
        """Bodies that are on the page."""
        return frozenset(self._markers)

    def listen(self, client: Client) -> None:
        """Hear of all bodies on this connection, once."""
        if self._session is client.session:
            return
        try:
            self._subscribers = [client.session.declare_subscriber(f"{key}/*", self._hear) for key in STREAMS]
        except zenoh.ZError:  # it was closed meanwhile, as when the page ends
            return
        self._session = client.session

    def draw(self) -> None:
        """Put every marker where its body is, and take away those that nobody has heard of for a while."""
        now = self.heard.now()
        for name in self._markers.keys() - now.keys():
            self._markers.pop(name).disc.remove()
        for name, (pose, order) in now.items():
            marker = self._markers.get(name) or self._add(name)
            marker.disc.position = self._frame.to_page(np.array(pose.position)) + LIFT
            marker.disc.wxyz = vtf.SO3.from_z_radians(pose.heading).wxyz
            text = f"{name}: {order}" if order else name
            if marker.label.text != text:
                marker.label.text = text

    def _hear(self, sample: zenoh.Sample) -> None:
        self.heard.take(str(sample.key_expr), sample.payload.to_bytes())

    def _add(self, name: str) -> _Marker:
        node, self._made = f"/live/{self._made}", self._made + 1  # a name may be any text
        disc = self._scene.add_cylinder(node, RADIUS, HEIGHT, colours.LIVE, cast_shadow=False)
        self._scene.add_arrows(f"{node}/nose", NOSE, colours.LIVE, shaft_radius=0.04, head_radius=0.1, head_length=0.2)
        label = self._scene.add_label(f"{node}/name", name, position=(0.0, 0.0, 0.4))
        self._markers[name] = _Marker(disc, label)
        return self._markers[name]


def _order(message: Sent) -> str:
    """What a body is told to do."""
    if isinstance(message, VelocityMessage):
        return f"{message.state} {math.hypot(message.forward, message.left):.1f} m/s".strip()
    if not isinstance(message, CueMessage):
        return ""
    if message.action in (CueAction.STOP, CueAction.ARRIVED):
        return message.action.value
    turn = math.degrees(message.direction)
    side = f" {abs(turn):.0f}° {'left' if turn > 0 else 'right'}" if abs(turn) >= 1.0 else ""
    return f"{message.action.value}{side}, {message.distance:.1f} m to go"

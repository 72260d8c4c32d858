"""Message types. Units: m, rad, s; frame: the scene's, z up. See CONVENTIONS.md."""

from __future__ import annotations

from enum import StrEnum
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray


class Status(StrEnum):
    """How a request ended: the planner's answers, then the service's."""

    OK = "OK"
    START_OUTSIDE_MAP = "START_OUTSIDE_MAP"
    GOAL_OUTSIDE_MAP = "GOAL_OUTSIDE_MAP"
    START_OCCUPIED = "START_OCCUPIED"
    GOAL_OCCUPIED = "GOAL_OCCUPIED"
    TIMEOUT = "TIMEOUT"
    NO_VALID_PATH = "NO_VALID_PATH"
    AMBIGUOUS_LEVEL = "AMBIGUOUS_LEVEL"
    UNCERTIFIED = "UNCERTIFIED"
    INVALID_REQUEST = "INVALID_REQUEST"
    UNKNOWN_SCENE = "UNKNOWN_SCENE"
    BUILDING = "BUILDING"
    BUILD_FAILED = "BUILD_FAILED"
    BUSY = "BUSY"
    UNAVAILABLE = "UNAVAILABLE"
    INTERNAL = "INTERNAL"


class Array(msgspec.Struct, frozen=True, array_like=False):
    """A matrix as one binary blob, row by row, little-endian.

    Attributes:
        shape: Rows, or rows and columns.
        dtype: "f8" or "f4".
        data: The bytes.
    """

    shape: tuple[int, ...]
    dtype: str
    data: bytes

    @classmethod
    def pack(cls, values: NDArray[Any], dtype: str = "f8") -> Array:
        """From an array."""
        made = np.ascontiguousarray(values, dtype=f"<{dtype}")
        return cls(made.shape, dtype, made.tobytes())

    def unpack(self) -> NDArray[np.float64]:
        """To an array of float64.

        Raises:
            ValueError: the bytes do not fit the shape, or a number is not finite.
        """
        if self.dtype not in ("f4", "f8"):
            raise ValueError(f"dtype {self.dtype!r} is neither 'f4' nor 'f8'")
        if len(self.shape) not in (1, 2) or any(n < 0 for n in self.shape):
            raise ValueError(f"shape {self.shape} is neither (n,) nor (n, k)")
        count = 1
        for n in self.shape:
            count *= n
        if count * int(self.dtype[1]) != len(self.data):
            raise ValueError(f"{len(self.data)} bytes do not fill shape {self.shape} of {self.dtype}")
        made = np.frombuffer(self.data, f"<{self.dtype}").reshape(self.shape).astype(np.float64)
        if not np.isfinite(made).all():
            raise ValueError("it holds numbers that are not finite")
        return made


class PlanRequest(msgspec.Struct, frozen=True, kw_only=True):
    """Ask for a trajectory on `keys.PLAN`.

    Attributes:
        scene: Name of a loaded scene.
        start: (x, y) or (x, y, z of the ground there) [m].
        goal: The same.
        agent: Name of a known body, or its measures as a map (the fields of `gpdf_service.Agent`).
        method: dual_gpdf, or one of the paper's baselines: single_gpdf, astar, prm.
        via: Places that the path goes through, in this order.
        other_goals: More goals; the one with the shortest way is taken; its number is `details["goal"]`, 0 the first.
        snap: How far a place where the body cannot be may be moved to the nearest one where it can [m]; 0 refuses it.
        warm_start: Contact points (n, 3) of a trajectory from before: taken up from where the start is near it if it
            is still clear and ends near the goal; not with `via`.
        deadline_s: Seconds that the answer may take.
        request_id: Chosen by the client; the same id asks the same thing again.
    """

    scene: str
    start: list[float]
    goal: list[float]
    agent: str | dict[str, Any] = "human"
    method: str = "dual_gpdf"
    via: list[list[float]] = []
    other_goals: list[list[float]] = []
    snap: float = 0.0
    warm_start: Array | None = None
    deadline_s: float = 30.0
    request_id: str = ""


class TrajectoryMessage(msgspec.Struct, frozen=True):
    """A trajectory: positions (n, 3) of the body's top, ground (n, 3) below, times (n,) s, headings (n,) rad."""

    positions: Array
    ground: Array
    times: Array
    headings: Array


class CertificateMessage(msgspec.Struct, frozen=True):
    """What was proven of a trajectory; the fields of `gpdf_service.Certificate`."""

    min_clearance: float
    min_clearance_at: list[float]
    max_height_deviation: float
    max_height_deviation_at: list[float]
    max_step: float
    max_slope: float
    holds: bool
    reason: str = ""


class Reply(msgspec.Struct, frozen=True, kw_only=True):
    """What every reply carries.

    Attributes:
        request_id: That of the request; empty when it could not be read.
        status: How it ended.
        message: The same in words, with what to try.
        scene: Name of the scene.
        scene_version: Version of the scene that answered.
        planner: Id of the service that answered.
        timings: Seconds by stage.
    """

    request_id: str = ""
    status: Status = Status.OK
    message: str = ""
    scene: str = ""
    scene_version: int = 0
    planner: str = ""
    timings: dict[str, float] = {}


class PlanReply(Reply, frozen=True, kw_only=True):
    """Answer to a `PlanRequest`.

    Attributes:
        trajectory: There when `status` is OK. A baseline that was asked for by name also sends a path that is
            UNCERTIFIED, to be measured and drawn: follow a trajectory only if `status` is OK.
        certificate: There when the trajectory is.
        details: Numbers for the curious, by name: iterations, converged (0 or 1), goal, warm (0 or 1), nodes; where
            there is no path, largest_radius and cut_x, cut_y, cut_z; where a place is not valid, nearest_x, nearest_y,
            nearest_z.
        costs: Cost of the optimiser before and after each of its steps, (k,).
    """

    trajectory: TrajectoryMessage | None = None
    certificate: CertificateMessage | None = None
    details: dict[str, float] = {}
    costs: Array | None = None


class DistanceRequest(msgspec.Struct, frozen=True, kw_only=True):
    """Ask a field on `keys.DISTANCE`: "ground" with points (m, 3), or "obstacle" with (m, 2) or (m, 3)."""

    scene: str
    field: str
    points: Array
    agent: str | dict[str, Any] = "human"
    deadline_s: float = 30.0
    request_id: str = ""


class DistanceReply(Reply, frozen=True, kw_only=True):
    """Distances (m,) [m], gradients (m, 2 or 3), and validity as 0 or 1 (m,); where not valid the distance is 0."""

    distance: Array | None = None
    gradient: Array | None = None
    valid: Array | None = None


class SceneRequest(msgspec.Struct, frozen=True, kw_only=True):
    """Name a scene, on `keys.SCENE_INFO` or `keys.SCENE_UNLOAD`; any name on `keys.SCENES`."""

    scene: str = ""
    deadline_s: float = 30.0
    request_id: str = ""


class LoadRequest(msgspec.Struct, frozen=True, kw_only=True):
    """Load a file of the service's scenes folder, on `keys.SCENE_LOAD`; the build goes on after the reply."""

    scene: str
    file: str
    deadline_s: float = 30.0
    request_id: str = ""


class UploadRequest(msgspec.Struct, frozen=True, kw_only=True):
    """One part of a cloud, on `keys.SCENE_UPLOAD`; the build starts when all parts are there.

    Attributes:
        scene: Name to give it.
        upload_id: The same for all parts.
        part: Number of this part, from 0.
        parts: How many there are.
        points: (n, 3) [m].
        ground: 1 where a point is ground, (n,); none lets the service segment.
    """

    scene: str
    upload_id: str
    part: int
    parts: int
    points: Array
    ground: Array | None = None
    deadline_s: float = 30.0
    request_id: str = ""


class SceneReply(Reply, frozen=True, kw_only=True):
    """Facts of one scene; BUILDING while it is being built."""

    info: dict[str, Any] = {}


class ScenesReply(Reply, frozen=True, kw_only=True):
    """Facts of every scene by name."""

    scenes: dict[str, dict[str, Any]] = {}


class PoseMessage(msgspec.Struct, frozen=True, kw_only=True):
    """Where a body is, as a stream on `keys.POSE`/NAME.

    Attributes:
        position: (x, y, z of the ground under it) [m].
        heading: Direction that it faces, counter-clockwise from +x [rad].
        stamp: When that was measured, since 1970 [s].
        accuracy: One standard deviation of the position in plan [m].
    """

    position: list[float]
    heading: float
    stamp: float
    accuracy: float = 0.0


class CueAction(StrEnum):
    """What a haptic cue asks for."""

    GO = "go"
    SLOW = "slow"
    TURN = "turn"
    STOP = "stop"
    ARRIVED = "arrived"


class CueMessage(msgspec.Struct, frozen=True, kw_only=True):
    """A cue for a haptic device, as a stream of at least 5 Hz on `keys.CUE`/NAME; a device that hears none says stop.

    Attributes:
        action: Walk, walk slowly, turn on the spot, stop, or be there.
        direction: Where to go, from the direction that the body faces, counter-clockwise, -π to π [rad].
        urgency: 0 as it should be, to 1 at once.
        pace: Fastest pace that lets the body stop in time [m/s].
        distance: Left to the goal along the path [m].
        stamp: When it was made, since 1970 [s].
        pose_stamp: Stamp of the pose that it answers [s]; 0 where there was none yet.
    """

    action: CueAction
    direction: float
    urgency: float
    pace: float = 0.0
    distance: float = 0.0
    stamp: float = 0.0
    pose_stamp: float = 0.0


class VelocityMessage(msgspec.Struct, frozen=True, kw_only=True):
    """What a robot shall do now, as a stream of 20 Hz on `keys.VELOCITY`/NAME; a robot that hears none stops.

    Attributes:
        forward: Along its nose [m/s].
        left: To its left [m/s]; 0 for a differential drive.
        turn: Counter-clockwise [rad/s].
        stamp: When it was decided, since 1970 [s].
        valid_s: After this it is no command any more: stop [s].
        state: What the driver does, in a word.
    """

    forward: float
    left: float
    turn: float
    stamp: float
    valid_s: float = 0.5
    state: str = ""

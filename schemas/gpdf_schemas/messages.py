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
    UNKNOWN_PLACE = "UNKNOWN_PLACE"
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


class Cylinder(msgspec.Struct, frozen=True):
    """An upright cylinder: (x, y, z) of the middle of its base, radius and height [m]."""

    base: tuple[float, float, float]
    radius: float
    height: float


class MovingObstacle(msgspec.Struct, frozen=True, kw_only=True):
    """Something that the scan does not know, as points, as a cylinder, or both.

    Attributes:
        id: Chosen by who sees it; a newer one of the same id takes its place.
        points: (k, 3) [m], dense enough that no body fits between two of them.
        cylinder: [m]
        lifetime_s: Seconds after which it is forgotten; 0 removes it at once. Not looked at within a request.
    """

    id: str = ""
    points: Array | None = None
    cylinder: Cylinder | None = None
    lifetime_s: float = 1.0


class MovingObstacles(msgspec.Struct, frozen=True, kw_only=True):
    """Published on `keys.obstacles`: what moves in a scene, or stands in it and is not on its map."""

    obstacles: list[MovingObstacle]


class PlanRequest(msgspec.Struct, frozen=True, kw_only=True):
    """Ask for a trajectory on `keys.PLAN`.

    Attributes:
        scene: Name of a loaded scene.
        start: (x, y) or (x, y, z of the ground there) [m].
        goal: The same.
        agent: Name of a known body, or its measures as a map (the fields of `gpdf_service.Agent`; `discs` if any).
        method: dual_gpdf, or one of the paper's baselines: single_gpdf, astar, prm.
        via: Places that the path goes through, in this order.
        other_goals: More goals; the one with the shortest way is taken; its number is `details["goal"]`, 0 the first.
        snap: How far a place where the body cannot be may be moved to the nearest one where it can [m]; 0 refuses it.
        warm_start: Contact points (n, 3) of a trajectory from before: taken up from where the start is near it if it
            is still clear and ends near the goal; not with `via`.
        start_heading: Where a body of discs faces at the start [rad], to turn there if it must; free when not given.
        goal_heading: The same at the goal.
        prefer: quickest, level (no steps where there is another way) or wide (room beside the body); empty for the way
            that a sighted companion would take.
        alternatives: How many more ways are wanted that differ.
        deadline_s: Seconds that the answer may take.
        request_id: Chosen by the client; the same id asks the same thing again.
        obstacles: What else is in the way, for this plan alone; what was published for the scene counts as well.
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
    start_heading: float | None = None
    goal_heading: float | None = None
    prefer: str = ""
    alternatives: int = 0
    deadline_s: float = 30.0
    request_id: str = ""
    obstacles: list[MovingObstacle] = []


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
    hidden_height: float = 0.0
    ground_spacing: float = 0.0


class Reply(msgspec.Struct, frozen=True, kw_only=True):
    """What every reply carries.

    Attributes:
        request_id: That of the request; empty when it could not be read.
        status: How it ended.
        message: The same in words, with what to try.
        scene: Name of the scene.
        scene_version: Version of the scene that answered.
        planner: Id of the service that answered.
        timings: Seconds by stage; `waited` and `looked` (at what moves) count from the request's arrival.
        load: Requests that wait or are at work in the service, over its workers: above 1 a new one waits.
    """

    request_id: str = ""
    status: Status = Status.OK
    message: str = ""
    scene: str = ""
    scene_version: int = 0
    planner: str = ""
    timings: dict[str, float] = {}
    load: float = 0.0


class Alternative(msgspec.Struct, frozen=True, kw_only=True):
    """One more way, which is OK: its trajectory, its certificate, and its `details` as in `PlanReply`."""

    trajectory: TrajectoryMessage
    certificate: CertificateMessage
    details: dict[str, float] = {}


class PlanReply(Reply, frozen=True, kw_only=True):
    """Answer to a `PlanRequest`.

    Attributes:
        trajectory: There when `status` is OK. A baseline that was asked for by name also sends a path that is
            UNCERTIFIED, to be measured and drawn: follow a trajectory only if `status` is OK.
        certificate: There when the trajectory is.
        details: Numbers for the curious, by name: iterations, converged (0 or 1), goal, warm (0 or 1), nodes; cost
            (time and effort [s]), steps (how many) and stepped (their rise and fall together [m]) of the way; where
            there is no path, largest_radius, cut_x, cut_y, cut_z and short_width, short_height, short_step [m] or
            short_slope [rad], by how much the body is beyond what the way allows; where a place is not valid,
            nearest_x, nearest_y, nearest_z.
        costs: Cost of the optimiser before and after each of its steps, (k,).
        alternatives: More ways that differ, where they were asked for, the best first.
    """

    trajectory: TrajectoryMessage | None = None
    certificate: CertificateMessage | None = None
    details: dict[str, float] = {}
    costs: Array | None = None
    alternatives: list[Alternative] = []


class DistanceRequest(msgspec.Struct, frozen=True, kw_only=True):
    """Ask a field on `keys.DISTANCE`: "ground" with points (m, 3), or "obstacle" with (m, 2) or (m, 3)."""

    scene: str
    field: str
    points: Array
    agent: str | dict[str, Any] = "human"
    deadline_s: float = 30.0
    request_id: str = ""


class DistanceReply(Reply, frozen=True, kw_only=True):
    """Distances (m,) [m], gradients (m, 2 or 3), validity as 0 or 1 (m,), and standard deviations (m,) [m].

    Where it is not valid distance and deviation are 0 and say nothing; elsewhere the truth lies within two deviations.
    """

    distance: Array | None = None
    gradient: Array | None = None
    valid: Array | None = None
    deviation: Array | None = None


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
        points: (n, 3) [m], or (n, 6) with red, green and blue of 0 to 255, which pictures show.
        ground: 1 where a point is ground, (n,); none lets the service segment.
        origins: Where the rays to the points began [m]: (1, 3) for all of the part, or (n, 3); none where not known.
    """

    scene: str
    upload_id: str
    part: int
    parts: int
    points: Array
    ground: Array | None = None
    deadline_s: float = 30.0
    request_id: str = ""
    origins: Array | None = None


class SceneReply(Reply, frozen=True, kw_only=True):
    """Facts of one scene; BUILDING while it is being built."""

    info: dict[str, Any] = {}


class ScenesReply(Reply, frozen=True, kw_only=True):
    """Facts of every scene by name."""

    scenes: dict[str, dict[str, Any]] = {}


class UpdateRequest(msgspec.Struct, frozen=True, kw_only=True):
    """One part of a change to a scene, on `keys.SCENE_UPDATE`; when all parts are there, its next version is built.

    Plans are answered from the version before until then. Changes that wait while one is built become one version.

    Attributes:
        scene: Name of the scene.
        upload_id: The same for all parts.
        part: Number of this part, from 0.
        parts: How many there are.
        points: (n, 3) [m], in the scene's frame.
        gone: 1 where a point says that nothing is there any more, 0 where it is new, (n,).
        radius: What was within this of such a point is gone [m].
        origins: Where the rays to the points began [m]: (1, 3) for all of the part, or (n, 3); none where not known.
            They count in a scene that was built with some.
        thin: Of the new points only those are taken, one each, in whose voxel of this width [m] no point is; all if it
            is 0.
    """

    scene: str
    upload_id: str
    part: int
    parts: int
    points: Array
    gone: Array
    radius: float = 0.05
    deadline_s: float = 30.0
    request_id: str = ""
    origins: Array | None = None
    thin: float = 0.0


class PlaceRequest(msgspec.Struct, frozen=True, kw_only=True):
    """Name a place of a scene, anew or no more, on `keys.SCENE_PLACE`; all of them are asked by a `SceneRequest`.

    Attributes:
        scene: Name of a loaded scene; its places stay when it gets a new version, and go when it is unloaded.
        name: At most 64 letters, without a comma.
        position: (x, y) or (x, y, z of the ground there) [m]; none forgets the place.
    """

    scene: str
    name: str
    position: list[float] | None = None
    deadline_s: float = 30.0
    request_id: str = ""


class PlacesReply(Reply, frozen=True, kw_only=True):
    """All places of the scene by name, as they are now; (x, y) or (x, y, z of the ground there) [m]."""

    places: dict[str, list[float]] = {}


class PoseMessage(msgspec.Struct, frozen=True, kw_only=True):
    """Where a body is, as a stream on `keys.POSE`/NAME.

    Attributes:
        position: (x, y, z of the ground under it) [m].
        heading: Direction that it faces, counter-clockwise from +x [rad].
        stamp: When that was measured, since 1970 [s].
        accuracy: One standard deviation of the position in plan [m].
        steps: That a person has made since the stream began, where something counts them.
    """

    position: list[float]
    heading: float
    stamp: float
    accuracy: float = 0.0
    steps: int | None = None


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


class FileRequest(msgspec.Struct, frozen=True, kw_only=True):
    """A part of a ready scene's file, on `keys.SCENE_FILE`; for planners on other machines.

    Attributes:
        scene: Its name.
        version: Its version; another one is refused, so that no file is put together from two.
        offset: First byte.
    """

    scene: str
    version: int
    offset: int = 0
    deadline_s: float = 30.0
    request_id: str = ""


class DrawRequest(msgspec.Struct, frozen=True, kw_only=True):
    """Ask on `keys.SCENE_DRAW` for one part of what a picture of a scene shows.

    Attributes:
        scene: Name of a loaded scene.
        what: "cloud", "ground" (centres of its cells), "obstacles" or "leaves" (of the free space) of an agent.
        agent: Name of a known body, or its measures; only "obstacles" and "leaves" depend on it.
        limit: Most rows of all parts together: points are thinned evenly, of the leaves the largest are kept.
        part: Number of this part, from 0; points are shuffled, so that the first part shows all that is drawn.
        near: Places (k, 2) or (k, 3) [m]: only what is near one of them in plan is drawn; none: everything.
        reach: How near [m].
        deadline_s: Seconds that the answer may take.
        request_id: Chosen by the client.
    """

    scene: str
    what: str
    agent: str | dict[str, Any] = "human"
    limit: int = 300_000
    part: int = 0
    near: Array | None = None
    reach: float = 0.0
    deadline_s: float = 30.0
    request_id: str = ""


class FileReply(Reply, frozen=True, kw_only=True):
    """At most 1 MB of the file from the offset on, and the size of the whole [bytes]."""

    data: bytes = b""
    size: int = 0


class StatusReply(Reply, frozen=True, kw_only=True):
    """Health, readiness and metrics of a service, on `keys.status_of`; answered also when its queue is full.

    Attributes:
        role: "both", "map" or "planner".
        software: Version of the program.
        healthy: Whether it does its work, and loses nothing of what it is told to keep.
        state: "configured" (it opens), "warming" (its first scenes are built or taken into memory, kernels loaded),
            "active" or "draining" (what waits is answered, nothing new is taken).
        ready: Whether it is active: a plan takes what plans take. What is built later does not change that; each
            scene says of itself whether it is being built.
        problems: What is wrong, in words; a log that cannot be written is one, and plans go on.
        metrics: Numbers by name.
    """

    role: str = ""
    software: str = ""
    state: str = ""
    healthy: bool = False
    ready: bool = False
    problems: list[str] = []
    metrics: dict[str, float] = {}


class SceneChanged(msgspec.Struct, frozen=True, kw_only=True):
    """Published on `keys.changed` when a scene has a new version, or is unloaded (version 0)."""

    scene: str
    version: int
    digest: str = ""


class TrajectoryCut(msgspec.Struct, frozen=True, kw_only=True):
    """Published on `keys.cut` when what moves in a scene is in the way of a trajectory that a planner gave out.

    It is told for a while after the plan, three times the trajectory's duration and a minute, each time that something
    is published for the scene while the way is cut. No such message is no promise: only a new plan is one.

    Attributes:
        scene: Name of the scene.
        request_id: Of the request that the trajectory answered.
        planner: Id of the planner.
        obstacles: Ids of what is in the way.
        time: When the body would first touch one, since the trajectory's start [s].
        at: Its contact point then, (x, y, z) [m].
    """

    scene: str
    request_id: str
    planner: str
    obstacles: list[str]
    time: float
    at: list[float]


class DrawReply(Reply, frozen=True, kw_only=True):
    """One part of a drawing, at most 1 MB.

    Attributes:
        part: Number of this part.
        parts: How many there are; all of one drawing have the same `scene_version`.
        origin: (x, y, z) [m] to add to the rows' places, which are relative to it so that f4 is exact to 0.1 mm.
        columns: What the rows hold: x, y, z, level (-1: over no known ground), then of the cloud "ground" (0 or 1) and
            "above", its height over that level's ground (over the lowest where level is -1) [m], of the ground
            "inferred" (0 or 1), of both "colour" where `coloured` is true in the scene's facts (65536 red + 256 green
            + blue, -1 for none), of the obstacles "kind" (0 material, 1 step, 2 slope, 3 unknown ground), of the leaves
            "half_size" and "clearance" [m].
        rows: (n, columns), f4.
    """

    part: int = 0
    parts: int = 0
    origin: list[float] = []
    columns: list[str] = []
    rows: Array | None = None

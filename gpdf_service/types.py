"""Data that the stages hand to each other: agents, field samples, statuses, trajectories, certificates.

Frames: everything is in the scene frame, z up. Units: m, rad, s.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import lru_cache
from math import hypot, isfinite, radians
from numbers import Integral, Real
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from gpdf_service.errors import RequestError, UnknownAgentError

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
Float32Array = NDArray[np.float32]
ByteArray = NDArray[np.uint8]

SMALLEST_BODY, LARGEST_BODY = 0.05, 5.0
"""[m] Of a body that can be planned for: the finest cell of the ground, and a lorry. Free space of a body a tenth as
wide costs a hundred times the memory, so that one request could take all there is."""
SLOWEST, FASTEST = 0.01, 100.0
"""[m/s], [m/s²], [rad/s] Of such a body: a snail, and a racing car. Time stamps of 5 m at a micrometre a second would
take 8 GB."""
_LIMITS = {
    **dict.fromkeys(("height", "width", "length"), (SMALLEST_BODY, LARGEST_BODY)),
    **dict.fromkeys(("speed", "acceleration", "turn_rate"), (SLOWEST, FASTEST)),
}
_EFFORTS = "climb_time", "comfortable_step", "ledge_time"
MOST_DISCS = 32
"""Each costs a query of the field at every waypoint; a body 16 times as long as wide is covered twice as finely."""


def is_number(value: object) -> bool:
    """Whether it is a finite real number; True and False are none."""
    return isinstance(value, Real) and not isinstance(value, bool) and isfinite(value)


@lru_cache(maxsize=64)
def _offsets(length: float, discs: int) -> FloatArray:
    """`Agent.offsets`: asked for several times a plan, always the same."""
    return length * ((np.arange(discs) + 0.5) / discs - 0.5)


@dataclass(frozen=True, slots=True)
class Agent:
    """A body that moves on the ground, modelled as an upright cylinder, or as a row of them.

    The cylinder's radius is half the longer side of the footprint, Uttsha et al. 2024, Table 1. With more `discs`, the
    footprint is cut across its length into as many equal pieces, each covered by its circumscribed disc, and the body
    faces where it goes: so it passes where its cylinder does not.

    Attributes:
        name: Name for messages and logs.
        height: Height of the body above its contact point [m].
        width: Footprint across the direction of travel [m].
        length: Footprint along the direction of travel [m].
        max_step: Highest step that it climbs or descends in one go [m].
        max_slope: Steepest ground that it stands on [rad].
        speed: Cruising speed [m/s].
        acceleration: Highest acceleration along the path and across it [m/s²].
        turn_rate: Highest yaw rate [rad/s].
        discs: Discs along the body that cover its footprint; 1 is the upright cylinder, length / width a good number.
        climb_time: Seconds that a metre of rise or fall costs beyond the length of the way [s/m].
        comfortable_step: Highest step that it takes gladly [m]; of a higher one it would rather go round.
        ledge_time: Seconds that it would rather go round than take a metre of such higher steps [s/m].
    """

    name: str
    height: float
    width: float
    length: float
    max_step: float
    max_slope: float
    speed: float
    acceleration: float
    turn_rate: float
    discs: int = 1
    climb_time: float = 6.0
    comfortable_step: float = 0.2
    ledge_time: float = 100.0

    def __post_init__(self) -> None:
        for key in (*_LIMITS, "max_step", "max_slope", *_EFFORTS):
            value = getattr(self, key)
            if not is_number(value) or value < 0 or (value == 0 and key in _LIMITS):
                least = "more than 0" if key in _LIMITS else "0 or more"
                raise RequestError(
                    f"agent {self.name!r}", f"{key} = {value!r}", f"It must be a finite number, {least}."
                )
            object.__setattr__(self, key, float(value))  # to compiled code an integer is another type
        if self.max_slope >= np.pi / 2:
            raise RequestError(f"agent {self.name!r}", f"max_slope = {self.max_slope!r}", "It is in radians, 0 to π/2.")
        if not (isinstance(self.discs, Integral) and is_number(self.discs) and 1 <= self.discs <= MOST_DISCS):
            raise RequestError(f"agent {self.name!r}", f"discs = {self.discs!r}", f"Give 1 to {MOST_DISCS}.")

    @property
    def radius(self) -> float:
        """Radius of the cylinder [m]."""
        return 0.5 * max(self.width, self.length)

    @property
    def disc_radius(self) -> float:
        """Radius of each disc [m]; that of the cylinder where there is only one."""
        return self.radius if self.discs == 1 else 0.5 * hypot(self.length / self.discs, self.width)

    @property
    def offsets(self) -> FloatArray:
        """Where the discs' centres are, forward of the body's [m], shape (discs,)."""
        return _offsets(self.length, self.discs)

    @property
    def cylinder(self) -> Agent:
        """The upright cylinder that holds all discs, however the body is turned."""
        reach = 2.0 * (float(self.offsets[-1]) + self.disc_radius)
        return self if self.discs == 1 else replace(self, width=reach, length=reach, discs=1)


# Measures: Uttsha et al. 2024, Table 1. Steps: 0.35 m is what the paper lets humans and quadrupeds take (its
# platform), with 2 cm over it so that a step of exactly that height is not refused for the last millimetre of noise;
# a Roomba's wheels take a 2 cm sill, Pepper's 1.5 cm. Slopes: a quadruped's data sheet says 30°, wheels 5° to 10°.
# Speeds: walking pace with a cane 0.7 to 1.0 m/s; the robots' data sheets.
# Effort: a metre of rise costs 6 s (Naismith 1892: an hour for 2000 ft). Steps up to 0.2 m are what building codes let
# a stair have; a quadruped's data sheet says 0.3 m. Of higher ones a person would rather walk 28 m than take one of
# 0.35 m unseen, which is a choice of ours, a quadruped a fifth of it: it may stumble, it does not get hurt.
Method = Literal["dual_gpdf", "single_gpdf", "astar", "prm"]
Preference = Literal["quickest", "level", "wide"]
AGENTS: dict[str, Agent] = {
    agent.name: agent
    for agent in (
        Agent("roomba", 0.1, 0.34, 0.35, 0.02, radians(10), 0.3, 0.5, 2.0),
        Agent("spot", 0.7, 0.19, 1.1, 0.37, radians(30), 1.0, 1.0, 1.5, comfortable_step=0.3, ledge_time=20.0),
        Agent("pepper", 1.2, 0.48, 0.42, 0.015, radians(5), 0.55, 0.5, 1.0),
        Agent("human", 2.0, 0.5, 0.32, 0.37, radians(30), 0.8, 0.6, 1.5),
    )
}


def resolve_agent(agent: str | Agent) -> Agent:
    """Look an agent up by name; an `Agent` passes through, if it is one that can be planned for.

    Raises:
        RequestError: its measures are beyond what can be planned for.
        UnknownAgentError: no agent has that name.
    """
    if not isinstance(agent, Agent):
        if not isinstance(agent, str) or agent not in AGENTS:
            raise UnknownAgentError(agent, AGENTS)
        return AGENTS[agent]
    for key, (least, most) in _LIMITS.items():
        if not least <= getattr(agent, key) <= most:
            raise RequestError(f"agent {agent.name!r}", f"{key} = {getattr(agent, key)!r}", f"Give {least} to {most}.")
    return agent


@dataclass(frozen=True, slots=True)
class FieldSample:
    """What a distance field says at m places.

    Attributes:
        distance: Distance to the nearest surface [m], shape (m,); where not `valid` it is 0, which never reads as free.
        gradient: Gradient of the distance, shape (m, dim); 0 where not `valid`.
        valid: Whether the data supports an answer there, shape (m,).
        deviation: Standard deviation of the distance [m], shape (m,): the truth lies within two of them in at least
            95 % of queries, from the noise left in the points and the gaps between them; inf where not `valid`.
    """

    distance: FloatArray
    gradient: FloatArray
    valid: BoolArray
    deviation: FloatArray


class DistanceField(Protocol):
    """Anything that answers distance and gradient; planning knows no more than this."""

    def query(self, queries: FloatArray) -> FieldSample:
        """Distance and gradient at `queries`, shape (m, dim) [m]."""
        ...


class Status(StrEnum):
    """How a planning request ended. Robots' people know Nav2's numbers: see `code`."""

    OK = "OK"
    START_OUTSIDE_MAP = "START_OUTSIDE_MAP"
    GOAL_OUTSIDE_MAP = "GOAL_OUTSIDE_MAP"
    START_OCCUPIED = "START_OCCUPIED"
    GOAL_OCCUPIED = "GOAL_OCCUPIED"
    TIMEOUT = "TIMEOUT"
    NO_VALID_PATH = "NO_VALID_PATH"
    AMBIGUOUS_LEVEL = "AMBIGUOUS_LEVEL"
    UNCERTIFIED = "UNCERTIFIED"

    @property
    def code(self) -> int:
        """Nav2's error code (ComputePathToPose), or a number of ours from 290 on."""
        return _CODES[self]


_CODES = {
    Status.OK: 0,
    Status.START_OUTSIDE_MAP: 203,
    Status.GOAL_OUTSIDE_MAP: 204,
    Status.START_OCCUPIED: 205,
    Status.GOAL_OCCUPIED: 206,
    Status.TIMEOUT: 207,
    Status.NO_VALID_PATH: 208,
    Status.AMBIGUOUS_LEVEL: 290,
    Status.UNCERTIFIED: 291,
}


@dataclass(frozen=True, slots=True)
class Trajectory:
    """A time-stamped path of a body's contact with the ground, and of its top.

    Attributes:
        ground: The contact point: what one follows [m], shape (n, 3).
        positions: The top of the upright rigid body that stands there, contact + height [m], shape (n, 3).
        times: Time since the start [s], strictly increasing, shape (n,).
        headings: Direction of travel, counter-clockwise from +x [rad], shape (n,); a body of discs faces there, turning
            evenly between two waypoints, and on the spot where two have the same place.
    """

    positions: FloatArray
    ground: FloatArray
    times: FloatArray
    headings: FloatArray

    @property
    def length(self) -> float:
        """Length of the path of the body's top [m]."""
        return float(np.linalg.norm(np.diff(self.positions, axis=0), axis=1).sum())

    @property
    def duration(self) -> float:
        """Time from start to goal [s]."""
        return float(self.times[-1])

    def __repr__(self) -> str:
        """One line."""
        ends = " to ".join(f"({', '.join(f'{v:.2f}' for v in self.ground[row])})" for row in (0, -1))
        return f"Trajectory({self.length:.2f} m in {self.duration:.1f} s, {len(self.times)} waypoints, {ends})"


@dataclass(frozen=True, slots=True)
class Certificate:
    """What was proven of a trajectory over its whole continuous length, against the measured points themselves.

    Attributes:
        min_clearance: A lower bound of the room between the body's cylinder and the nearest obstacle, drop,
            forbidden step or unknown ground [m].
        min_clearance_at: Where on the path that is (x, y, z of the ground) [m], shape (3,).
        max_height_deviation: How far the line over the path that keeps the paper's d_g = h, as the optimiser's ground
            cost asks, is off the body height h [m]: | d_g - h |, d_g being its distance to the nearest ground, or its
            height over the contact point less h, whichever is smaller: beside a flight, or under another storey, the
            nearest ground is not the one stood on.
        max_height_deviation_at: Where that is [m], shape (3,).
        max_step: Largest step taken [m].
        max_slope: Steepest ground stood on [rad].
        holds: Whether every limit of the body is kept; a result is OK only if it does.
        reason: In words, the first limit that is broken; empty when `holds`.
        hidden_height: What stands no higher than this over the ground may be on the way unseen [m]: where our own
            segmentation found the ground, low things look like its scatter, and single points like its noise; in a
            noisy cloud with labels, low things beside a step look like its face; on a flight they look like its wear.
        ground_spacing: Coarsest spacing of the samples that the ground under the path rests on, to the width of a cell
            [m]: what is narrower than this may be there unseen, a gap in the ground as well.
    """

    min_clearance: float
    min_clearance_at: FloatArray
    max_height_deviation: float
    max_height_deviation_at: FloatArray
    max_step: float
    max_slope: float
    holds: bool
    reason: str = ""
    hidden_height: float = 0.0
    ground_spacing: float = 0.0

    def __repr__(self) -> str:
        """One line."""
        facts = f"clearance {self.min_clearance:.3f} m, step {self.max_step:.2f} m, slope {self.max_slope:.2f} rad"
        return f"Certificate({'holds' if self.holds else self.reason}: {facts})"


@dataclass(frozen=True, slots=True)
class PlanOptions:
    """What a request may ask for beside start and goal.

    Attributes:
        via: Places that the path goes through, in this order; (x, y) or (x, y, z of the ground) [m].
        other_goals: More goals; the one with the shortest way is taken.
        snap: How far a place that is not valid may be moved to the nearest one that is [m]; 0 refuses it.
        warm_start: Contact points of a trajectory from before, shape (n, 3) [m]: taken up where it is near and clear.
        start_heading: Where a body of discs faces at the start [rad]; None leaves it free; a cylinder has none.
        goal_heading: The same at the goal.
        prefer: "quickest", "level" or "wide"; None is what a sighted companion would take.
        alternatives: How many more ways are wanted that differ.
    """

    via: tuple[FloatArray, ...] = ()
    other_goals: tuple[FloatArray, ...] = ()
    snap: float = 0.0
    warm_start: FloatArray | None = None
    start_heading: float | None = None
    goal_heading: float | None = None
    prefer: str | None = None
    alternatives: int = 0


@dataclass(frozen=True, slots=True)
class PlanResult:
    """The answer to one planning request.

    Attributes:
        status: `Status.OK`, or the reason why there is no trajectory.
        message: The same in words, with what to try; of an OK result, which place was moved where.
        trajectory: Present exactly when `status` is OK; but a baseline that was asked for by name also hands out a path
            that is UNCERTIFIED, to be measured and drawn. So follow a trajectory only if `status` is OK.
        certificate: Present when `trajectory` is; for UNCERTIFIED it says what failed.
        timings: Seconds that each stage took, by name.
        details: Numbers for the curious, by name: iterations, evaluations, converged (0 or 1), nodes of the graph, goal
            (its number, 0 the first), warm (1 if the trajectory from before was taken up), cost (time and effort of the
            way [s]), steps (how many it takes) and stepped (their rise and fall together [m]); where there is no path,
            largest_radius, cut_x, cut_y, cut_z, and short_width, short_height, short_step [m] or short_slope [rad], by
            how much the body is beyond what the way allows; where a place is not valid, nearest_x, nearest_y and
            nearest_z; where the body does not fit there, room, needed (from its centre) and noise_margin, which is
            among that [m].
        costs: Cost of the optimiser before and after each of its steps, all pieces of the path together.
        alternatives: More ways that differ, if they were asked for, the best first: each OK, with what it costs in its
            `details`.
    """

    status: Status
    message: str
    trajectory: Trajectory | None = None
    certificate: Certificate | None = None
    timings: dict[str, float] = field(default_factory=dict)
    details: dict[str, float] = field(default_factory=dict)
    costs: FloatArray = field(default_factory=lambda: np.zeros(0))
    alternatives: tuple[PlanResult, ...] = ()

    def __repr__(self) -> str:
        """One line."""
        parts = [self.status.value, self.message, "" if self.trajectory is None else repr(self.trajectory)]
        others = f"{len(self.alternatives)} alternatives" if self.alternatives else ""
        return f"PlanResult({', '.join(part for part in (*parts, others) if part)})"

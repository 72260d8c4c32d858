"""The bodies that a robot can have: measures for the planner, limits and kind of drive for the controller."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from math import radians
from typing import Any


@dataclass(frozen=True, slots=True)
class Body:
    """A robot's body, an upright cylinder to the planner.

    Attributes:
        name: Name for messages and logs.
        height: Above the ground [m].
        width: Across the direction of travel [m].
        length: Along the direction of travel [m].
        max_step: Highest step that it takes [m].
        max_slope: Steepest ground that it stands on [rad].
        speed: Cruising speed [m/s].
        acceleration: Highest acceleration [m/s²].
        turn_rate: Highest yaw rate [rad/s].
        omnidirectional: It moves sideways as well; False for a differential drive.
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
    omnidirectional: bool = False

    @property
    def radius(self) -> float:
        """Radius of the cylinder [m]."""
        return 0.5 * max(self.width, self.length)

    def agent(self, margin: float) -> dict[str, Any]:
        """The body as a plan request takes it, `margin` [m] wider on every side: room for the error of following."""
        measures = asdict(self)
        del measures["omnidirectional"]
        return measures | {"width": self.width + 2 * margin, "length": self.length + 2 * margin}


# The service's own measures of these names, which a client cannot import; a test compares them.
BODIES = {
    body.name: body
    for body in (
        Body("roomba", 0.1, 0.34, 0.35, 0.02, radians(10), 0.3, 0.5, 2.0),
        Body("spot", 0.7, 0.19, 1.1, 0.37, radians(30), 1.0, 1.0, 1.5, omnidirectional=True),
        Body("pepper", 1.2, 0.48, 0.42, 0.015, radians(5), 0.55, 0.5, 1.0, omnidirectional=True),
    )
}

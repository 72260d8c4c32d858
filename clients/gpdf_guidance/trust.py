"""Which poses can be true: of now, known well enough, and where the person can have got to since the last one."""

from __future__ import annotations

from math import hypot

from gpdf_guidance.advice import BLIND, PACES, UNRELIABLE, distrust
from gpdf_guidance.instruction import Instruction, Kind, Urgency
from gpdf_guidance.route import Pose

HURRY = 1.5
"""[m/s] Nobody who is guided is faster."""
NOISE = 2 * UNRELIABLE
"""[m] Two poses may differ by this without a movement: two standard deviations of the worst one that counts."""
STRAYS = PACES[0] * BLIND
"""[m] Who gets no cue stands after this, however long the last pose is ago."""


def doubt(pose: Pose, trusted: Pose | None, now: float) -> Instruction | None:
    """Why a pose cannot be true; None if it can.

    Args:
        pose: The newest one.
        trusted: The last one that could be true; None before the first.
        now: On the clock of their stamps [s].
    """
    if trusted is not None and not _follows(pose, trusted):
        return Instruction(Kind.STOP_UNRELIABLE, Urgency.DANGER)
    return distrust(pose, now)


def _follows(pose: Pose, trusted: Pose) -> bool:
    """Whether time went on between two poses, and the person could get from one to the other."""
    seconds = pose.stamp - trusted.stamp
    away = hypot(*(a - b for a, b in zip(pose.position, trusted.position, strict=True)))
    return seconds >= 0.0 and away <= NOISE + min(HURRY * seconds, STRAYS)

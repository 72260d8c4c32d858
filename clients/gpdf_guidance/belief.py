"""Where a person is, from poses that scatter: a Kalman filter that knows how little one who walks slowly moves aside.

In a narrow passage a pose that scatters by 2 cm would say "off the way" at every second cue.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import cos, hypot, sin

from gpdf_guidance.advice import PACES, SWAY
from gpdf_guidance.route import Pose

SURPRISE = 4.0
"""[σ] A pose further than this from what is believed shows that it was wrong (of good poses one in 3000 does)."""


@dataclass(frozen=True, slots=True)
class Belief:
    """A pose, and the variances of its place along and across its heading [m²]."""

    pose: Pose
    along: float
    across: float


def believe(before: Belief | None, pose: Pose, pace: float) -> Belief:
    """What is believed after a pose.

    Nobody says how far the person went: he stays where he was, give or take what `pace` allows. So a belief is late by
    a centimetre or two along the way, and still across it.

    Args:
        before: The belief until now; None before the first pose.
        pose: A newer pose, with the deviation that it says it has.
        pace: That the person was told to walk at most of late [m/s].
    """
    noise = pose.accuracy**2
    if before is None or noise == 0.0:
        return Belief(pose, noise, noise)
    way = max(pace, PACES[-1]) * (pose.stamp - before.pose.stamp)
    along, across = before.along + way**2, before.across + (way * sin(SWAY)) ** 2
    dx, dy = (new - old for new, old in zip(pose.position[:2], before.pose.position[:2], strict=True))
    c, s = cos(pose.heading), sin(pose.heading)
    forward, left = c * dx + s * dy, c * dy - s * dx
    if hypot(forward / (along + noise) ** 0.5, left / (across + noise) ** 0.5) > SURPRISE:
        return Belief(pose, noise, noise)
    u, v = along / (along + noise), across / (across + noise)
    x, y = (
        before.pose.position[0] + u * forward * c - v * left * s,
        before.pose.position[1] + u * forward * s + v * left * c,
    )
    return Belief(replace(pose, position=(x, y, pose.position[2])), u * noise, v * noise)

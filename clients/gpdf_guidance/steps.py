"""The length of a person's own steps, learned on the way from a count of them and the way that they made."""

from __future__ import annotations

from dataclasses import dataclass, replace

from gpdf_guidance.manner import STEP_LENGTH

KNOWN = 10.0
"""Steps that the length which one begins with is worth: after ten steps the person's own counts as much."""
LEAST = 4
"""Steps at which a stretch is long enough to count: two poses' errors are then 3 % of it."""
HUMAN = (0.25, 1.0)
"""[m] Steps of another length are none: a counter that missed some, or shook."""


@dataclass(frozen=True, slots=True)
class StepLength:
    """What is known of it.

    Attributes:
        metres: That were walked in counted steps.
        steps: That they took.
        since: Arc length [m] and count where the stretch began that is being walked; None on stairs and on other ways.
    """

    metres: float = KNOWN * STEP_LENGTH
    steps: float = KNOWN
    since: tuple[float, int] | None = None

    @property
    def length(self) -> float:
        """Of a step [m]."""
        return self.metres / self.steps


def learn(known: StepLength, s: float, steps: int | None, *, level: bool) -> StepLength:
    """What is known after a pose.

    Args:
        known: Until now.
        s: How far along the way the person is [m].
        steps: Counted so far; None where nothing counts them.
        level: Whether he walks on the level, straight on: steps on stairs and turns on the spot have no length.
    """
    if steps is None or not level:
        return replace(known, since=None)
    if known.since is None or steps < known.since[1] or s < known.since[0]:
        return replace(known, since=(s, steps))
    made, way = steps - known.since[1], s - known.since[0]
    if made < LEAST:
        return known
    if not HUMAN[0] <= way / made <= HUMAN[1]:
        return replace(known, since=(s, steps))
    return StepLength(known.metres + way, known.steps + made, (s, steps))

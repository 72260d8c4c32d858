"""What is said of all that could be said: most urgent first, nothing twice, within a budget of words."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from gpdf_guidance.advice import Instruction, Urgency

PER_MINUTE = 7.0
"""[1/min] Instructions that the budget earns: under the 8 that people bear for long."""
SAVED = 1.5
"""Instructions that can be saved up."""
DEBT = -3.0
"""Instructions that urgent ones can borrow."""
AGAIN = {Urgency.DANGER: 8.0, Urgency.ACT: 12.0}
"""[s] What is dangerous or to be done now is said again after this if it is still so; the rest is said once."""
WORD = 0.33
"""[s] A spoken word takes."""


class Announcer:
    """Chooses what to say now.

    Args:
        say: Puts an instruction into words.
    """

    def __init__(self, say: Callable[[Instruction], str]) -> None:
        self._say = say
        self._said: dict[str, float] = {}
        self._tokens, self._then, self._quiet_at = SAVED, 0.0, -float("inf")

    def choose(self, instructions: Sequence[Instruction], now: float) -> tuple[Instruction, str] | None:
        """The most urgent that is due, in words; None to be silent.

        Args:
            instructions: Most urgent first.
            now: Clock [s].
        """
        self._earn(now)
        for instruction in instructions:
            urgent = instruction.urgency >= Urgency.ACT
            affordable = self._tokens >= 1.0 or urgent
            silent = now >= self._quiet_at or instruction.urgency is Urgency.DANGER
            if affordable and silent and self._due(instruction, now):
                return self._speak(instruction, now)
        return None

    def _earn(self, now: float) -> None:
        if self._said:
            self._tokens = min(SAVED, self._tokens + (now - self._then) * PER_MINUTE / 60.0)
        self._then = now

    def _due(self, instruction: Instruction, now: float) -> bool:
        last = self._said.get(instruction.key)
        return last is None or now - last >= AGAIN.get(instruction.urgency, float("inf"))

    def _speak(self, instruction: Instruction, now: float) -> tuple[Instruction, str]:
        text = self._say(instruction)
        self._said[instruction.key] = now
        self._tokens = max(DEBT, self._tokens - 1.0)
        self._quiet_at = now + WORD * len(text.split())
        return instruction, text

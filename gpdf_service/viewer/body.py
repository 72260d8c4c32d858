"""The body that is planned for: a known one, or one with measures of its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from math import degrees, radians
from typing import Any

import viser

from gpdf_service.types import AGENTS, MOST_DISCS, Agent
from gpdf_service.viewer.widgets import by_hand, put

OWN = "own"
"""Name of a body whose measures somebody has changed."""
FIRST = "human"


@dataclass(frozen=True, slots=True)
class Measure:
    """A number field: what it is called, its range and step."""

    label: str
    low: float
    high: float
    step: float


MEASURES = {
    "height": Measure("Height [m]", 0.05, 3.0, 0.01),
    "width": Measure("Width [m]", 0.05, 3.0, 0.01),
    "length": Measure("Length [m]", 0.05, 3.0, 0.01),
    "max_step": Measure("Highest step [m]", 0.0, 1.0, 0.005),
    "max_slope": Measure("Steepest slope [°]", 0.0, 60.0, 0.5),
    "speed": Measure("Speed [m/s]", 0.05, 5.0, 0.05),
    "discs": Measure("Discs along it", 1, MOST_DISCS, 1),
}


class Body:
    """Its widgets, and what they say: a known body fills the fields, a changed field makes it `OWN`."""

    def __init__(self, gui: viser.GuiApi) -> None:
        self.chosen = gui.add_dropdown("Body", (*AGENTS, OWN), initial_value=FIRST)
        self._agent, self._told = AGENTS[FIRST], _nobody
        with gui.add_folder("Its measures", expand_by_default=False):
            self._fields = {
                name: gui.add_number(
                    measure.label, _shown(self._agent, name), min=measure.low, max=measure.high, step=measure.step
                )
                for name, measure in MEASURES.items()
            }
        self.chosen.on_update(by_hand(self._choose))
        for handle in self._fields.values():
            handle.on_update(by_hand(self._change))

    @property
    def agent(self) -> Agent:
        """As it is now."""
        return self._agent

    @property
    def wire(self) -> str | dict[str, Any]:
        """As a request names it."""
        return self._agent.name if self._agent == AGENTS.get(self._agent.name) else asdict(self._agent)

    def on_change(self, tell: Callable[[], None]) -> None:
        """Call this when a person has chosen or changed the body."""
        self._told = tell

    def show(self, agent: Agent) -> None:
        """Put a body into the fields, for instance that of a recorded request."""
        self._agent = agent
        put(self.chosen, agent.name if agent == AGENTS.get(agent.name) else OWN)
        for name, handle in self._fields.items():
            put(handle, _shown(agent, name))

    def _choose(self) -> None:
        self.show(AGENTS.get(self.chosen.value, replace(self._agent, name=OWN)))
        self._told()

    def _change(self) -> None:
        said: dict[str, Any] = {name: handle.value for name, handle in self._fields.items()}
        said |= {"max_slope": radians(said["max_slope"]), "discs": int(said["discs"])}
        self.show(replace(self._agent, name=OWN, **said))
        self._told()


def _shown(agent: Agent, name: str) -> float:
    value: float = getattr(agent, name)
    return round(degrees(value), 1) if name == "max_slope" else value


def _nobody() -> None:
    """Is told nothing."""

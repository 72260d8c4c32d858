"""A recorded log, stepped through on the page."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import viser
from gpdf_client.results import to_result
from gpdf_schemas import PlanReply, PlanRequest

from gpdf_service.types import AGENTS, Agent
from gpdf_service.viewer import words
from gpdf_service.viewer.desk import Desk
from gpdf_service.viewer.map_control import MapControl
from gpdf_service.viewer.planning import Plans
from gpdf_service.viewer.scenes import Scenes
from gpdf_service.viewer.widgets import by_hand, put, with_file


class Logs:
    """Shows each recorded plan on the scene that it was planned in, if the service still has it."""

    def __init__(self, desk: Desk, map_control: MapControl, scenes: Scenes, plans: Plans) -> None:
        self._desk, self._map, self._scenes, self._plans = desk, map_control, scenes, plans
        self.recorded: list[tuple[PlanRequest, PlanReply]] = []
        self._digests: dict[tuple[str, int], str] = {}  # of the recorded scenes, by name and version
        tab = self._tab = desk.panel.log
        tab.open.on_upload(lambda event: self._open_upload(event.target.value))
        tab.step.on_update(by_hand(self._show_soon))
        tab.sides.on_click(lambda event: self._step(1 if event.target.value == "on" else -1))
        tab.again.on_click(lambda _: plans.plan_soon())

    def open(self, path: Path) -> None:
        """Read a log, and show its first plan."""
        from gpdf_service.service.replay import recorded_plans, recorded_scenes

        self.recorded, self._digests = list(recorded_plans(path)), recorded_scenes(path)
        tab = self._tab
        if not self.recorded:
            tab.text.content = f"There is no plan in `{path.name}`."
            return
        tab.text.content = f"{len(self.recorded)} plans in `{path.name}`."
        tab.step.max = max(2, len(self.recorded))
        tab.step.visible = tab.sides.visible = tab.again.visible = True
        put(tab.step, 1)
        self._show()

    def _open_upload(self, file: viser.UploadedFile) -> None:
        self._desk.plans.do("log", lambda: with_file(file, self.open))

    def _step(self, by: int) -> None:
        put(self._tab.step, min(max(1, self._tab.step.value + by), len(self.recorded)))
        self._show_soon()

    def _show_soon(self) -> None:
        self._desk.plans.do("plan", self._show)

    def _show(self) -> None:
        index = min(self._tab.step.value, len(self.recorded)) - 1
        request, reply = self.recorded[index]
        facts = self._scenes.facts.get(request.scene, {})
        if request.scene != self._scenes.shown[0] and facts.get("state") == "ready":
            self._scenes.turn_to(request.scene, self._show_soon)
            return
        agent = AGENTS[request.agent] if isinstance(request.agent, str) else Agent(**request.agent)
        self._tab.text.content = (
            f"**{index + 1} of {len(self.recorded)}** · `{request.request_id}`\n\n"
            f"{request.scene}, {agent.name}, {request.method}: {_place(request.start)} → {_place(request.goal)}\n\n"
            + words.answer(to_result(reply))
            + self._leave_wrong_scene(request, reply)
        )
        for name, place in (("start", request.start), ("goal", request.goal)):
            self._plans.set_end(name, self._map.on_ground(place))
        self._plans.drops.replace(request.obstacles)
        self._desk.body.show(agent)
        self._plans.show(to_result(reply), request.scene, agent, None)

    def _leave_wrong_scene(self, request: PlanRequest, reply: PlanReply) -> str:
        """Show no map where the service has not the scene that the plan was made in; a warning about it."""
        digest = self._digests.get((request.scene, reply.scene_version), "")
        if self._scenes.facts.get(request.scene, {}).get("digest") == digest:
            return ""
        self._scenes.leave(np.array([*request.start, 0.0][:3]))
        return f"\n\n**The service has no such scene** (`{digest or 'unknown'}`): the path is drawn without a map."


def _place(place: list[float]) -> str:
    return "(" + ", ".join(f"{value:.2f}" for value in place) + ")"

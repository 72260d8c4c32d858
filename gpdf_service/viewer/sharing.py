"""What the page's address holds: a link to it opens the same scene, view and plan, elsewhere or after a reload.

viser tells nobody the address, but it reads and writes the browser's storage: `front.py` lets one entry of that, `KEY`,
stand for the part of the address after the "#", which no server and no log ever gets. The link holds no token. Whoever
sends one chooses its text, so none of that is shown: a panel's words may be HTML.
"""

from __future__ import annotations

import time
from base64 import urlsafe_b64decode, urlsafe_b64encode
from html import escape
from typing import Any

import msgspec
import numpy as np
from gpdf_schemas import DecodeError, MovingObstacle, decode, encode

from gpdf_service.errors import GpdfError
from gpdf_service.types import Agent, FloatArray, resolve_agent
from gpdf_service.viewer.body import FIRST, OWN
from gpdf_service.viewer.desk import Desk
from gpdf_service.viewer.map_control import MapControl
from gpdf_service.viewer.map_layers import View
from gpdf_service.viewer.panel import METHODS
from gpdf_service.viewer.planning import Place, Plans
from gpdf_service.viewer.scenes import Scenes
from gpdf_service.viewer.widgets import put

KEY = "link"
MOST_BYTES = 16_384
"""Of a link: all browsers take so much, and a proxy need not."""
READ_S = 5.0
"""[s] A browser answers by then, or shows the page as it is at first."""
STILL_S = 1.0
"""[s] After the last change it is written: the browser draws a frame for each, and Safari takes 100 in 30 s."""


class Shared(msgspec.Struct, frozen=True, omit_defaults=True):
    """What a link says; places are the scene's [m].

    Attributes:
        scene: Its name.
        view: What is shown of it.
        eye: Where the camera is.
        target: What it looks at.
        agent: The body, as a request names it.
        method: How to plan.
        start: Of the plan, if it is set.
        goal: The same.
        obstacles: That the operator has dropped.
    """

    scene: str
    view: View
    eye: Place
    target: Place
    agent: str | dict[str, Any] = FIRST
    method: str = METHODS[0]
    start: Place | None = None
    goal: Place | None = None
    obstacles: tuple[MovingObstacle, ...] = ()

    def to_link(self) -> str:
        """As letters that no program takes for the end of a link."""
        return urlsafe_b64encode(encode(self)).decode().rstrip("=")

    @classmethod
    def from_link(cls, link: str) -> Shared:
        """What a link says.

        Raises:
            ValueError: it says nothing that can be shown.
        """
        try:
            shared = decode(urlsafe_b64decode(link + "=" * (-len(link) % 4)), cls, limit=MOST_BYTES)
            shared.body  # noqa: B018 - whether there is one
        except (ValueError, TypeError, DecodeError, GpdfError) as error:
            raise ValueError(f"The link of this page cannot be read: {escape(str(error))}") from error
        if shared.method not in METHODS:
            raise ValueError("The link of this page names no method that there is.")
        return shared

    @property
    def body(self) -> Agent:
        """The body that is planned for; one with measures of its own has no name of its own."""
        return resolve_agent(self.agent if isinstance(self.agent, str) else Agent(**{**self.agent, "name": OWN}))

    @property
    def dropped(self) -> list[MovingObstacle]:
        """The obstacles, numbered."""
        named = enumerate((one.cylinder for one in self.obstacles if one.cylinder is not None), 1)
        return [MovingObstacle(id=str(number), cylinder=cylinder) for number, cylinder in named]


class Sharing:
    """Opens what the link says, once, and from then on keeps the link as the page is."""

    def __init__(self, desk: Desk, map_control: MapControl, scenes: Scenes, plans: Plans) -> None:
        self._desk, self._map, self._scenes, self._plans = desk, map_control, scenes, plans
        self._told: str | None = None  # None: what the link says was not looked at yet
        self._seen, self._seen_at = "", 0.0
        desk.panel.plan.share.on_click(lambda _: self._say())

    def look(self) -> None:
        """The first time show what the link says; after that, or where it says nothing, the scene that is chosen."""
        if self._told is not None:
            self._scenes.look()
            return
        try:
            link = self._desk.browser.local_storage.get_item(KEY, READ_S)
        except (RuntimeError, TimeoutError):  # a browser that keeps nothing
            link = None
        try:
            if link:
                self._open(Shared.from_link(link))
            else:
                self._scenes.look()
        except ValueError as error:
            self._scenes.look()
            self._desk.panel.say_answer(str(error))
        self._told = ""

    def tick(self) -> None:
        """Keep the link as the page is."""
        if self._told is None or not self._scenes.shown[0]:
            return
        now, link = time.monotonic(), self._now().to_link()
        if link != self._seen:
            self._seen, self._seen_at = link, now
        if link != self._told and now - self._seen_at >= STILL_S and len(link) <= MOST_BYTES:
            self._desk.browser.local_storage.set_item(KEY, link)
            self._told = link

    def _now(self) -> Shared:
        camera, origin, plans = self._desk.browser.camera, self._desk.frame.origin, self._plans
        return Shared(
            scene=self._scenes.shown[0],
            view=self._map.layers.view,
            eye=_place(origin + camera.position),
            target=_place(origin + camera.look_at),
            agent=self._desk.body.wire,
            method=self._desk.panel.plan.method.value,
            **{name: _place(place) for name, place in plans.ends.items() if place is not None},
            obstacles=tuple(one for one in tuple(plans.drops.obstacles.values()) if one.points is None),
        )

    def _open(self, shared: Shared) -> None:
        """On the maps' worker; the plan is made on its own."""
        self._desk.body.show(shared.body)
        put(self._desk.panel.plan.method, shared.method)
        self._map.want(shared.view)
        self._scenes.show(shared.scene)
        if self._scenes.shown[0] != shared.scene:
            raise ValueError("The scene that the link of this page is to is not here.")
        self._map.want(shared.view)  # again: the cloud may be shown as it was scanned, which not each scene offers
        self._map.want_storey(shared.view.levels, shared.view.apart)
        self._desk.maps.do("camera", lambda: self._look_from(shared))  # after the map is drawn so
        ends = {"start": shared.start, "goal": shared.goal}
        self._desk.plans.do("plan", lambda: self._plans.open(ends, shared.dropped))

    def _look_from(self, shared: Shared) -> None:
        camera, origin = self._desk.browser.camera, self._desk.frame.origin
        camera.position, camera.look_at = np.array(shared.eye) - origin, np.array(shared.target) - origin

    def _say(self) -> None:
        self._desk.browser.add_notification(
            "Link to this page",
            "The address holds scene, view, body, start, goal and what you dropped. Who opens it needs the token of "
            "`gpdf view`, too.",
            auto_close_seconds=6.0,
        )


def _place(place: FloatArray) -> Place:
    """To the millimetre: a camera that trembles in its last digits is the same one."""
    x, y, z = (round(float(value), 3) for value in place)
    return x, y, z

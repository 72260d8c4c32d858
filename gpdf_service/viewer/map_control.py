"""The map of the scene that is shown: which layers, which level, which slice, and what a click meets."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from gpdf_service.types import FloatArray
from gpdf_service.viewer import colours, words
from gpdf_service.viewer.desk import Desk
from gpdf_service.viewer.fit import fitted, free_of
from gpdf_service.viewer.map_layers import MapLayers, View
from gpdf_service.viewer.panel import (
    ALL_STOREYS,
    AS_SCANNED,
    CLOUD_COLOURS,
    MOST_APART,
    SLICES,
    gradient,
    key_of,
    legend,
)
from gpdf_service.viewer.scale import add_scale
from gpdf_service.viewer.widgets import put

CAMERA = np.array([0.0, -0.25, 0.55])
"""From the ground to the camera: from above and the south."""
STACK = np.array([0.0, -0.75, 0.35])
"""The same for storeys that are pulled apart: from lower, to see between them."""
SLICE_OVER_GROUND = 0.6
"""[m]"""
DOWN = np.array([0.0, 0.0, -1.0])


class MapControl:
    """Fetches and draws what the Map tab asks for."""

    def __init__(self, desk: Desk) -> None:
        self._desk, self._tab = desk, desk.panel.map
        self.layers = MapLayers(desk.browser.scene, desk.frame)
        self._scene, self._cell_width = "", 0.0
        self._stale: set[str] = set()  # layers that the view has changed since they were drawn
        for box in self._tab.layers.values():
            box.on_update(lambda _: self._change_view())
        self._levels: dict[str, frozenset[int]] = {}  # that are shown, by the storey's name
        self._on_lift: Callable[[], None] = lambda: None
        for handle in (self._tab.colour, desk.panel.storey, desk.panel.apart, self._tab.below, self._tab.size):
            handle.on_update(lambda _: self._change_view())
        for handle in (self._tab.slice, self._tab.height):
            handle.on_update(lambda _: desk.maps.do("slice", self._slice))

    def on_lift(self, tell: Callable[[], None]) -> None:
        """Call this when the storeys are pulled apart or put together again, after the map is drawn so."""
        self._on_lift = tell

    def show(self, name: str, facts: dict[str, Any]) -> None:
        """Show the ground of a scene that is ready, on a page that shows none."""
        self._scene, self._cell_width = name, facts["levels"][0]["cell_width"]
        self.say_facts(facts)
        self._tab.colour.options = (*CLOUD_COLOURS, *[AS_SCANNED] * bool(facts.get("coloured")))
        self._fetch("ground")
        self._offer_storeys()
        self._look_at_ground()
        if self.layers.ground is not None:
            step = add_scale(self._desk.browser.scene, self._desk.frame, *self.layers.ground.box)
            self._tab.legend.content = legend(len(facts["levels"]), step)
        self._offer_heights(facts)

    def want(self, view: View) -> None:
        """Show what a view asks for, as if somebody had chosen it; a value that there is not stays as it is."""
        tab = self._tab
        for name, box in tab.layers.items():
            put(box, name in view.shown)
        if view.colour in tab.colour.options:
            put(tab.colour, view.colour)
        for slider, value in ((tab.below, view.below), (tab.size, view.point_size)):
            put(slider, min(slider.max, max(slider.min, value)))

    def want_storey(self, levels: frozenset[int] | None, apart: float) -> None:
        """Show these levels, if they are a storey of the scene that is shown; None: all, `apart` [m]."""
        named = {shown: name for name, shown in self._levels.items()}
        storey = ALL_STOREYS if levels is None else named.get(levels)
        if storey in self._desk.panel.storey.options:
            put(self._desk.panel.storey, storey)
        put(self._desk.panel.apart, min(MOST_APART, max(0.0, apart)))

    def fill(self) -> None:
        """Fetch and draw all that the Map tab asks for."""
        self._fetch(*self.layers.view.shown)

    def say_facts(self, facts: dict[str, Any]) -> None:
        """Sizes, version and digest of the scene."""
        self._tab.facts.content = words.facts(facts)

    def clear(self) -> None:
        """Show no scene."""
        self._scene = ""
        self.layers.clear()
        self._desk.browser.scene.remove_by_name("/scale")

    def prepare(self) -> None:
        """Let the service find out where the body fits before the first plan needs it."""
        if self._scene:
            self._desk.link.client.draw(self._scene, "leaves", self._desk.body.wire, limit=1)

    def change_body(self) -> None:
        """Fetch again what the body decides."""
        self._desk.maps.do("view", self._refetch)

    def hit(self, ray_origin: FloatArray, direction: FloatArray) -> FloatArray | None:
        """Where a ray of the page meets ground that is shown, in the scene's frame; None if it does not."""
        ground = self.layers.drawn_ground
        found = None if ground is None else ground.hit(ray_origin, direction, self.layers.view.levels)
        return None if found is None else self._desk.frame.to_scene(found)

    def on_ground(self, place: list[float]) -> FloatArray:
        """A place with the height of the ground that is shown there."""
        ground, frame = self.layers.drawn_ground, self._desk.frame
        if len(place) == 3 or ground is None:
            return np.array([*place, 0.0][:3])
        over = frame.to_page(np.array([*place, 0.0]))
        over[2] = float(np.nanmax(ground.heights)) + 1.0
        hit = ground.hit(over, DOWN, self.layers.view.levels)
        if hit is None:  # as high as the floor that is shown
            over[2] = ground.middle(self.layers.view.levels)
        return frame.to_scene(over if hit is None else hit)

    def _offer_storeys(self) -> None:
        """Storeys by their height; the lowest alone at first, for over it the others would hide it."""
        ground, storey = self.layers.ground, self._desk.panel.storey
        if ground is None:
            return
        found = ground.storeys
        joining = frozenset(range(len(ground.heights))) - frozenset(found)
        high = self._desk.frame.origin[2]
        by_height = sorted(found.items(), key=lambda one: one[1])
        names = [f"{i}: floor at {height + high:.1f} m" for i, (_, height) in enumerate(by_height)]
        self._levels = {name: joining | {level} for name, (level, _) in zip(names, by_height, strict=True)}
        several = len(names) > 1
        self._desk.frame.floors = np.array([height for _, height in by_height])
        storey.options = (*names, ALL_STOREYS) if several else (ALL_STOREYS,)
        storey.visible = several
        put(storey, storey.options[0])
        put(self._desk.panel.apart, 0.0)
        self.layers.view = replace(self.layers.view, levels=self._levels[names[0]] if several else None)

    def _look_at_ground(self) -> None:
        """So that all known ground is seen beside the panel, with the things on it as far as they are shown."""
        ground = self.layers.drawn_ground
        if ground is None:
            return
        low, high = ground.box
        camera, top = self._desk.browser.camera, high + np.array([0.0, 0.0, self.layers.view.below])
        toward, free = STACK if self._desk.frame.apart > 0.0 else CAMERA, free_of(camera.image_width)
        camera.position, camera.look_at = fitted(low, top, toward, camera.fov, camera.aspect, free)

    def _offer_heights(self, facts: dict[str, Any]) -> None:
        """Slices from the scene's lowest point to its highest; at first over the lowest ground."""
        low, high = facts["extent"]
        self._tab.height.max = round(high[2] - low[2], 2)
        lowest = min(level["height"][0] for level in facts["levels"])
        put(self._tab.height, round(lowest - low[2] + SLICE_OVER_GROUND, 2))

    def _fetch(self, *whats: str) -> None:
        if not self._scene:
            return
        panel, client = self._desk.panel, self._desk.link.client
        for what in whats:

            def progress(share: float, what: str = what) -> None:
                panel.say_work(f"{self._scene}: {what} …", share)

            self.layers.fetch(client, self._scene, what, self._desk.body.wire, self._cell_width, progress)
            self.layers.draw(what)
        panel.say_work("")

    def _refetch(self) -> None:
        self.layers.forget("obstacles", "leaves")
        self._fetch(*self.layers.view.shown)
        self.prepare()
        if SLICES[self._tab.slice.value] == "obstacle":
            self._slice()

    def _change_view(self) -> None:
        tab, before = self._tab, self.layers.view
        panel = self._desk.panel
        panel.apart.visible = panel.storey.visible and panel.storey.value == ALL_STOREYS
        self.layers.view = View(
            shown=frozenset(name for name, box in tab.layers.items() if box.value),
            colour=tab.colour.value,
            below=tab.below.value,
            point_size=tab.size.value,
            levels=self._levels.get(panel.storey.value),
            apart=panel.apart.value if panel.apart.visible else 0.0,
        )
        panel.key.content = key_of(tab.colour.value, tab.below.value)
        self._stale |= self.layers.view.touched(before)
        self._desk.maps.do("view", self._renew)

    def _renew(self) -> None:
        """Hide what is not wanted, then fetch and draw what is."""
        frame, apart = self._desk.frame, self.layers.view.apart
        before, frame.apart = frame.apart, apart
        while self._stale:
            self.layers.draw(self._stale.pop())
        self._fetch(*(self.layers.view.shown - self.layers.there))
        if apart != before:
            if not (apart and before):
                self._look_at_ground()
            if "slice" in self.layers.drawn:
                self._slice()
            self._on_lift()

    def _slice(self) -> None:
        field, scale = SLICES[self._tab.slice.value], self._tab.slice_legend
        if not field:
            self.layers.no_slice()
            scale.visible = False
            return
        agent, height = self._desk.body.wire, self._tab.height.value
        low, high = self.layers.slice(self._desk.link.client, self._scene, field, agent, height)
        scale.content = gradient(colours.VIRIDIS, f"{low:.0f} m", f"{high:.1f} m, a line each 0.25 m")
        scale.visible = True

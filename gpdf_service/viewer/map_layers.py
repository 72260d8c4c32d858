"""What the page shows of a scene: cloud, ground, obstacles, leaves, and slices of the distance fields."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import viser
from gpdf_client import Client, Drawing

from gpdf_service.types import BoolArray, FloatArray
from gpdf_service.viewer import colours
from gpdf_service.viewer.frame import Frame
from gpdf_service.viewer.ground import Ground
from gpdf_service.viewer.panel import AS_SCANNED

LIMITS = {"cloud": 300_000, "ground": 2_000_000, "obstacles": 60_000, "leaves": 12_000}
"""Most rows that are fetched. Browsers bear 300 k points; clicks need all the ground; smaller leaves are not seen."""
SHOWN_GROUND = 150_000
"""Cells of the ground that are drawn."""
SLICE_POINTS = 40_000
"""Places that a slice asks a field at: 5 cm apart in an office."""
SLICE_STEP = 0.05
"""[m] Between them at least: the fields are fitted no finer."""
ASK_AT_ONCE = 20_000
"""Places in one request: its reply is 0.7 MB."""
ISO_STEP, ISO_DARKER = 0.25, 0.6
"""[m], [-] Lines of equal distance in a slice: how far apart, and how much darker."""
LIFT = 0.02
"""[m] Leaves and the ground's cells are drawn this far apart, so that they do not flicker."""


@dataclass(frozen=True, slots=True)
class View:
    """What the operator wants to see.

    Attributes:
        shown: Layers that are on.
        colour: Of the cloud: "height", "level", "ground" or `AS_SCANNED`.
        below: Points higher over their ground are left out, so that a ceiling hides nothing [m].
        point_size: [m].
        levels: Only these; all of them if None.
        apart: How far the storeys are pulled apart, where all are shown [m].
    """

    shown: frozenset[str] = frozenset({"cloud", "ground"})
    colour: str = "height"
    below: float = 1.5
    point_size: float = 0.02
    levels: frozenset[int] | None = None
    apart: float = 0.0

    def touched(self, before: View) -> set[str]:
        """Layers that look different than in the view `before`."""
        layers = set(self.shown ^ before.shown)
        if (self.levels, self.apart) != (before.levels, before.apart):
            layers |= self.shown
        if self.colour != before.colour and {self.colour, before.colour} & {"level", AS_SCANNED}:
            layers |= {"ground"} & self.shown
        if (self.colour, self.below) != (before.colour, before.below) or "ground" in layers:
            layers.add("cloud")
        if self.point_size != before.point_size:
            layers |= {"cloud", "obstacles"}
        return layers


class MapLayers:
    """Fetches and draws the layers; the newest layer's origin becomes the page's `frame`."""

    def __init__(self, scene: viser.SceneApi, frame: Frame) -> None:
        self._scene, self._frame = scene, frame
        self.view = View()
        self.ground: Ground | None = None
        self._drawings: dict[str, Drawing] = {}
        self._handles: dict[str, viser.SceneNodeHandle] = {}

    @property
    def drawn_ground(self) -> Ground | None:
        """The ground as it lies on the page, where the storeys may be pulled apart."""
        if self.ground is None or self._frame.apart == 0.0:
            return self.ground
        return replace(self.ground, heights=self._frame.lifted_heights(self.ground.heights))

    @property
    def there(self) -> frozenset[str]:
        """Layers that were fetched."""
        return frozenset(self._drawings)

    @property
    def drawn(self) -> frozenset[str]:
        """Layers that are on the page, "slice" among them."""
        return frozenset(self._handles)

    def clear(self) -> None:
        """Forget the scene."""
        for handle in self._handles.values():
            handle.remove()
        self._handles, self._drawings, self.ground = {}, {}, None

    def forget(self, *whats: str) -> None:
        """Drop layers, to be fetched again."""
        for what in whats:
            self._drawings.pop(what, None)
            if what in self._handles:
                self._handles.pop(what).remove()

    def fetch(
        self,
        client: Client,
        scene: str,
        what: str,
        agent: str | dict[str, Any],
        cell_width: float,
        progress: Callable[[float], None],
    ) -> None:
        """Get one layer from the service, unless it is there."""
        if what in self._drawings:
            return
        drawing = client.draw(scene, what, agent, limit=LIMITS[what], progress=progress)
        self._drawings[what], self._frame.origin = drawing, drawing.origin
        if what == "ground":
            self.ground = Ground.of(drawing, cell_width)

    def draw(self, what: str) -> None:
        """Draw one layer as the view wants it, or hide it."""
        drawing = self._drawings.get(what)
        if what in self._handles:
            self._handles.pop(what).remove()
        if drawing is None or what not in self.view.shown:
            return
        level = drawing.columns["level"]
        levels = self.view.levels
        wanted = np.ones(len(level), dtype=bool) if levels is None else np.isin(level, sorted(levels))
        made = getattr(self, f"_{what}")(drawing, wanted)
        if made is not None:
            self._handles[what] = made

    def _points(
        self, what: str, places: FloatArray, shades: colours.Colours, size: float
    ) -> viser.PointCloudHandle | None:
        if len(places) == 0:
            return None
        return self._scene.add_point_cloud(
            f"/map/{what}",
            self._frame.lifted(places).astype(np.float32),
            shades,
            point_size=size,
            precision="float32",
            point_shading="flat",
        )

    def _cloud(self, drawing: Drawing, wanted: BoolArray) -> viser.PointCloudHandle | None:
        wanted = wanted & (drawing.columns["above"] <= self.view.below)
        if "ground" in self.view.shown:
            wanted &= drawing.columns["ground"] == 0  # its cells are drawn
        places = drawing.places[wanted]
        if len(places) == 0:
            return None
        if self.view.colour == AS_SCANNED and "colour" in drawing.columns:
            shades = colours.unpacked(drawing.columns["colour"][wanted])
        elif self.view.colour == "level":
            shades = colours.of_levels(drawing.columns["level"][wanted])
        elif self.view.colour == "ground":
            is_ground = drawing.columns["ground"][wanted, None] > 0
            shades = np.where(is_ground, colours.SEEN, colours.KINDS[0])
        else:
            shades = colours.ramp(drawing.columns["above"][wanted], 0.0, self.view.below, colours.PALE)
        return self._points("cloud", places, shades, self.view.point_size)

    def _ground(self, drawing: Drawing, wanted: BoolArray) -> viser.PointCloudHandle | None:
        chosen = np.flatnonzero(wanted)[:SHOWN_GROUND]  # shuffled by the service: the first show all, thinner
        inferred = drawing.columns["inferred"][chosen, None] > 0
        seen = colours.SEEN
        if self.view.colour == "level":
            seen = colours.pale(colours.of_levels(drawing.columns["level"][chosen]))
        elif self.view.colour == AS_SCANNED and "colour" in drawing.columns:
            seen = colours.unpacked(drawing.columns["colour"][chosen])
        shades = np.where(inferred, colours.INFERRED, seen)
        size = self.ground.cell_width if self.ground is not None else self.view.point_size
        return self._points("ground", drawing.places[chosen], shades, size)

    def _obstacles(self, drawing: Drawing, wanted: BoolArray) -> viser.PointCloudHandle | None:
        shades = colours.KINDS[drawing.columns["kind"][wanted].astype(np.int64)]
        return self._points("obstacles", drawing.places[wanted], shades, 1.5 * self.view.point_size)

    def _leaves(self, drawing: Drawing, wanted: BoolArray) -> viser.LineSegmentsHandle | None:
        if not wanted.any():
            return None
        half = drawing.columns["half_size"][wanted]
        around = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)])
        corners = np.repeat(self._frame.lifted(drawing.places[wanted])[:, None], 5, axis=1)
        corners[:, :, :2] += around * half[:, None, None]
        corners[:, :, 2] += LIFT
        sides = np.stack([corners[:, :-1], corners[:, 1:]], axis=2).reshape(-1, 2, 3)
        shades = colours.of_lines(colours.ramp(drawing.columns["clearance"][wanted], 0.0, 1.0))
        each = np.repeat(shades, 4, axis=0)[:, None].repeat(2, axis=1)
        return self._scene.add_line_segments("/map/leaves", sides, each, thickness=1.0, thickness_units="screen")

    def slice(
        self, client: Client, scene: str, field: str, agent: str | dict[str, Any], height: float
    ) -> tuple[float, float]:
        """Ask a field on a level plane, and show it as a coloured image with a line each `ISO_STEP`.

        Args:
            client: The service.
            scene: Name of the scene.
            field: "ground" or "obstacle".
            agent: The body, for "obstacle".
            height: Of the plane over the scene's lowest point [m].

        Returns:
            The distances that the two ends of the colours stand for [m].
        """
        self.no_slice()
        if self.ground is None:
            return 0.0, 0.0
        size = self.ground.cell_width * np.array(self.ground.heights.shape[1:])
        step = max(SLICE_STEP, float(np.sqrt(size.prod() / SLICE_POINTS)))
        nx, ny = np.maximum(1, np.ceil(size / step)).astype(int)
        x, y = self.ground.low[0] + (np.arange(nx) + 0.5) * step, self.ground.low[1] + (np.arange(ny) + 0.5) * step
        grid = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
        places = np.column_stack([grid, np.full(len(grid), height)]) + self._frame.origin
        answers = [
            client.distance(scene, field, places[i : i + ASK_AT_ONCE], agent)
            for i in range(0, len(places), ASK_AT_ONCE)
        ]
        distance = np.concatenate([answer.distance for answer in answers])
        valid = np.concatenate([answer.valid for answer in answers])
        if not valid.any():
            return 0.0, 0.0
        high = max(1.0, float(np.quantile(distance[valid], 0.98)))
        shades = colours.ramp(distance, 0.0, high).astype(np.float64)
        beside = np.abs(distance - ISO_STEP * np.round(distance / ISO_STEP))
        line = np.where(distance > 0.5 * ISO_STEP, np.clip(1.0 - beside / step, 0.0, 1.0), 0.0)
        shades *= 1.0 - ISO_DARKER * line[:, None]
        image = np.concatenate([shades, np.where(valid, 215, 0)[:, None]], axis=1).astype(np.uint8).reshape(nx, ny, 4)
        lifted = float(self._frame.lifted_heights(np.array(height)))
        centre = (*(self.ground.low + 0.5 * step * np.array([nx, ny])), lifted)
        self._handles["slice"] = self._scene.add_image(
            "/map/slice", _upright(image), nx * step, ny * step, format="png", position=centre, wxyz=_FLAT
        )
        return 0.0, high

    def no_slice(self) -> None:
        """Take the slice away."""
        if "slice" in self._handles:
            self._handles.pop("slice").remove()


_FLAT = (0.0, 1.0, 0.0, 0.0)
"""Half a turn about x: viser's images have y downwards."""


def _upright(image: np.ndarray) -> np.ndarray:  # type: ignore[type-arg]
    """From (x, y, channel) to rows from the top."""
    return np.ascontiguousarray(image.transpose(1, 0, 2)[::-1])

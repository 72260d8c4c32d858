"""What the page shows of a plan: start and goal, the path with its clearance as colour, the body swept along it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Literal

import numpy as np
import viser
from gpdf_client import Trajectory
from numpy.typing import NDArray

from gpdf_service.types import Agent, FloatArray
from gpdf_service.viewer import colours
from gpdf_service.viewer.frame import Frame

Faces = NDArray[np.uint32]
Anchor = Literal["bottom-center", "bottom-left", "top-right"]
LINE_LIFT = 0.04
"""[m] The path is drawn over the ground and the leaves."""
LIFTED = np.array([0.0, 0.0, LINE_LIFT])
LINE_WIDTH = 6.0
"""[px] Seen in a hall as in an office."""
THROUGH_WIDTH = 5.0
"""[px] Lines of this width are drawn faded through all that covers them (`front`); within the path's, unseen on it."""
DASH = 0.12
"""[m] Length of a dash, and of the gap after it."""
GHOST_STEP = 0.4
"""[m] Between two bodies of the sweep at least; wide ones stand further apart."""
GHOST_OPACITY = 0.07
GHOST_SHARE = 0.97
"""[-] Of the radius: the solid body's side must not coincide with a ghost's."""
CORNERS = 24
"""Of a cylinder's rim."""
MARKS = {"start": (0, 158, 115), "goal": (204, 121, 167), "nearest": (0, 114, 178), "cut": (213, 94, 0)}
MARK_RADIUS = 0.12
"""[m]"""
SAID = {"start": "start", "goal": "goal", "nearest": "nearest place that fits", "cut": "the way is cut here"}
ANCHORS: dict[str, Anchor] = {
    "start": "bottom-center",
    "goal": "bottom-center",
    "nearest": "bottom-left",
    "cut": "top-right",
}
"""Which side of its place a label is on: what is refused and the nearest place that fits are often close."""
LABELS = {"start": 0.25, "goal": 0.25, "nearest": 0.7, "cut": 0.25}
"""[m] Over their places: so the nearest one's does not hide that of the goal that was refused."""
BODY = (0, 114, 178)


class PathLayers:
    """Draws plans; places are given in the scene's frame."""

    def __init__(self, scene: viser.SceneApi, frame: Frame) -> None:
        self._scene, self._frame = scene, frame
        self._marks: dict[str, list[viser.SceneNodeHandle]] = {}
        self._paths: dict[str, viser.SceneNodeHandle] = {}
        self._body: viser.MeshHandle | None = None
        self._moving: Trajectory | None = None
        self._again: dict[str, Callable[[], None]] = {}  # what draws each thing
        self._keep_programs()

    def _keep_programs(self) -> None:
        """Things of no size: a browser compiles its graphics programs for the first, and forgets them with the last."""
        points, faces, one = np.zeros((3, 3)), np.array([[0, 1, 2]], np.uint32), np.array(BODY, np.uint8)
        self._add_segments("/spare/line", points[None, :2], np.broadcast_to(one, (1, 2, 3)))
        self._add_ghosts("/spare/sweep", (points, faces), np.eye(1, 4), points[:1], one)
        self._scene.add_mesh_simple("/spare/body", points, faces, color=BODY, cast_shadow=False)

    @property
    def shown(self) -> Trajectory | None:
        """The path that the body is swept along."""
        return self._moving

    @property
    def drawn(self) -> tuple[str, ...]:
        """What stands of paths in the scene: their lines, the sweep, the body."""
        return tuple(node.removeprefix("/plan/") for node in self._paths)

    def mark(self, name: str, place: FloatArray | None) -> None:
        """Show the start or the goal; None takes it away."""
        for handle in self._marks.pop(name, []):
            handle.remove()
        self._again.pop(name, None)
        if place is None:
            return
        self._again[name] = partial(self.mark, name, place)
        at = self._frame.to_page(place) + LIFTED
        disc = self._scene.add_cylinder(f"/plan/{name}", MARK_RADIUS, 0.03, MARKS[name], position=at, cast_shadow=False)
        label = self._scene.add_label(
            f"/plan/{name}/label", SAID[name], position=(0, 0, LABELS[name]), anchor=ANCHORS[name]
        )
        self._marks[name] = [label, disc]

    def clear(self) -> None:
        """Take all paths away; the marks stay."""
        for node, handle in self._paths.items():
            handle.remove()
            self._again.pop(node, None)
        self._paths, self._body, self._moving = {}, None, None

    def draw_again(self) -> None:
        """Draw all that stands, where the frame has it now."""
        for draw in tuple(self._again.values()):
            draw()

    def add_line(
        self, name: str, path: Trajectory, shades: colours.Colours, *, dashed: bool = False, storey: int = 0
    ) -> None:
        """Draw a path on the ground.

        Args:
            name: A later one of that name takes its place.
            path: To draw.
            shades: One colour (3,), or one a waypoint (n, 3).
            dashed: It is not proven.
            storey: Lines of another number are drawn over or under it, so that one does not hide the other.
        """
        node = f"/plan/line_{name}"
        self._again[node] = partial(self.add_line, name, path, shades, dashed=dashed, storey=storey)
        points = self._frame.to_page(path.ground) + (1 + storey) * LIFTED
        segments = dashes(points) if dashed else np.stack([points[:-1], points[1:]], axis=1)
        ends = np.broadcast_to(shades, points.shape)
        each = np.broadcast_to(shades, segments.shape) if dashed else np.stack([ends[:-1], ends[1:]], axis=1)
        self._paths[node] = self._add_segments(node, segments, each)
        self._add_segments(f"{node}/through", segments, each, THROUGH_WIDTH)  # goes with its parent

    def add_sweep(self, path: Trajectory, agent: Agent, shades: colours.Colours) -> None:
        """Draw the body at even steps along a path, and a solid one that `move` moves."""
        self._again["/plan/sweep"] = partial(self.add_sweep, path, agent, shades)
        points = self._frame.to_page(path.ground)
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        count = max(2, int(along[-1] / max(GHOST_STEP, 1.5 * agent.radius)) + 1)
        rows = np.searchsorted(along, np.linspace(0.0, along[-1], count)).clip(0, len(along) - 1)
        vertices, faces = _outline(agent)
        turns = np.zeros((count, 4))
        turns[:, 0], turns[:, 3] = np.cos(0.5 * path.headings[rows]), np.sin(0.5 * path.headings[rows])
        ghost = vertices * [GHOST_SHARE, GHOST_SHARE, 1.0], faces
        node, each = "/plan/sweep", shades if shades.ndim == 1 else shades[rows]
        self._paths[node] = self._add_ghosts(node, ghost, turns, points[rows], each)
        self._body = self._scene.add_mesh_simple("/plan/body", vertices, faces, color=BODY, cast_shadow=False)
        self._paths["/plan/body"] = self._body
        self._moving = path
        self.move(0.0)

    def _add_segments(
        self, node: str, segments: FloatArray, shades: colours.Colours, width: float = LINE_WIDTH
    ) -> viser.SceneNodeHandle:
        return self._scene.add_line_segments(
            node, segments, colours.of_lines(shades), thickness=width, thickness_units="screen"
        )

    def _add_ghosts(
        self, node: str, ghost: tuple[FloatArray, Faces], turns: FloatArray, places: FloatArray, shades: colours.Colours
    ) -> viser.SceneNodeHandle:
        return self._scene.add_batched_meshes_simple(
            node,
            *ghost,
            turns,
            places,
            batched_colors=shades,
            opacity=GHOST_OPACITY,
            cast_shadow=False,
            receive_shadow=False,
            lod="off",
        )

    def move(self, time: float) -> None:
        """Put the solid body where it is after `time` [s]."""
        path, body = self._moving, self._body
        if path is None or body is None:
            return
        place = np.array([np.interp(time, path.times, path.ground[:, k]) for k in range(3)])
        body.position = self._frame.to_page(place)
        heading = np.interp(time, path.times, np.unwrap(path.headings))
        body.wxyz = (float(np.cos(0.5 * heading)), 0.0, 0.0, float(np.sin(0.5 * heading)))


def dashes(points: FloatArray) -> FloatArray:
    """Every second piece of `DASH` along a line (n, 3), as segments (k, 2, 3)."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    ends = np.linspace(0.0, along[-1], 2 * max(1, round(along[-1] / (2 * DASH))) + 2)
    places = np.column_stack([np.interp(ends, along, channel) for channel in points.T])
    return places.reshape(-1, 2, 3)


def disc_centres(path: Trajectory, agent: Agent) -> FloatArray:
    """Where the centres of the body's discs are on the ground at each waypoint [m], shape (discs, n, 3)."""
    forward = np.column_stack([np.cos(path.headings), np.sin(path.headings), np.zeros(len(path.headings))])
    places: FloatArray = path.ground + agent.offsets[:, None, None] * forward
    return places


def _outline(agent: Agent) -> tuple[FloatArray, np.ndarray]:  # type: ignore[type-arg]
    """Vertices [m] and faces of a body that faces along x: a cylinder a disc."""
    vertices, faces = _cylinder()
    size = np.array([agent.disc_radius, agent.disc_radius, agent.height])
    discs = [vertices * size + [offset, 0.0, 0.0] for offset in agent.offsets]
    return np.concatenate(discs), np.concatenate([faces + i * len(vertices) for i in range(len(discs))])


def _cylinder() -> tuple[FloatArray, np.ndarray]:  # type: ignore[type-arg]
    """Vertices and faces of a cylinder of radius 1 from z = 0 to 1: the side, and a lid with its own rim (an edge)."""
    turn = np.linspace(0, 2 * np.pi, CORNERS, endpoint=False)
    rim = np.column_stack([np.cos(turn), np.sin(turn)])
    low, high = np.insert(rim, 2, 0.0, axis=1), np.insert(rim, 2, 1.0, axis=1)
    i = np.arange(CORNERS)
    j = (i + 1) % CORNERS
    side = np.concatenate([np.column_stack([i, j, j + CORNERS]), np.column_stack([i, j + CORNERS, i + CORNERS])])
    lid = np.column_stack([i + 2 * CORNERS, j + 2 * CORNERS, np.full(CORNERS, 3 * CORNERS)])
    return np.concatenate([low, high, high, [[0.0, 0.0, 1.0]]]), np.concatenate([side, lid])

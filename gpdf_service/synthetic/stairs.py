"""Stairs of many kinds, tread by tread: straight, with a landing, round a corner, there and back, winding, spiral."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from gpdf_service.synthetic.solids import Solid, board, post, prism
from gpdf_service.types import FloatArray

NEWEL = 0.05
"""[m] Half width of a post where a stair turns."""
RAIL = 0.05
"""[m] Width and height of a handrail."""


@dataclass(frozen=True, slots=True)
class Style:
    """How a stair is made.

    Attributes:
        rise: Of each step [m].
        going: Depth of a straight tread from edge to edge [m].
        width: Of the stair [m].
        under: "massive" down to the floor, "soffit" (closed risers over an inclined underside), or "open" boards.
        nosing: How far a tread juts out over the one below [m].
        thickness: Of a tread's board [m].
        boards: Sides with an inclined board along them: "left", "right".
        rails: Sides with a handrail on balusters.
        walls: Sides with a wall up to the next storey.
    """

    rise: float
    going: float
    width: float
    under: str = "massive"
    nosing: float = 0.0
    thickness: float = 0.04
    boards: tuple[str, ...] = ()
    rails: tuple[str, ...] = ()
    walls: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Tread:
    """One tread or landing: its left and right side in plan, each from its front edge to its back edge, (k, 2) [m]."""

    left: FloatArray
    right: FloatArray
    is_landing: bool = False

    @property
    def outline(self) -> FloatArray:
        """Corners in order, shape (k, 2)."""
        corners = [self.left[0], *self.right, *self.left[:0:-1]]
        after = [*corners[1:], corners[0]]
        return np.array([p for p, q in zip(corners, after, strict=True) if np.hypot(*(p - q)) > 1e-6])

    @property
    def middle(self) -> FloatArray:
        """Where one walks on it, (2,) [m]: between the middles of its front and back edge, or of a landing's turn."""
        if self.is_landing and len(self.right) > 2:
            turn: FloatArray = 0.5 * (self.left.mean(axis=0) + self.right[1:-1].mean(axis=0))
            return turn
        ends = self.left[0] + self.right[0] + self.left[-1] + self.right[-1]
        made: FloatArray = 0.25 * ends
        return made


@dataclass
class Layout:
    """Treads one after another, from the middle of the first front edge at (0, 0), going up along +x at first.

    Attributes:
        width: Of the stair [m].
        going: Of a straight tread [m].
        treads: What has been laid.
    """

    width: float
    going: float
    treads: list[Tread] = field(default_factory=list)
    left: FloatArray = field(init=False)
    right: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        self.left, self.right = np.array([0.0, 0.5 * self.width]), np.array([0.0, -0.5 * self.width])

    @property
    def ahead(self) -> FloatArray:
        """Unit vector in which one goes on."""
        across = (self.left - self.right) / np.hypot(*(self.left - self.right))
        return np.array([across[1], -across[0]])

    def straight(self, count: int) -> Layout:
        """Lay `count` straight treads."""
        for _ in range(count):
            step = self.going * self.ahead
            self._lay(np.array([self.left, self.left + step]), np.array([self.right, self.right + step]))
        return self

    def quarter_landing(self) -> Layout:
        """Lay a square landing, and go on to the left."""
        corner, end = self.right + self.width * self.ahead, self.left + self.width * self.ahead
        self._lay(np.array([self.left, self.left]), np.array([self.right, corner, end]), is_landing=True)
        return self

    def landing(self, depth: float) -> Layout:
        """Lay a landing, and go straight on."""
        step = depth * self.ahead
        self._lay(np.array([self.left, self.left + step]), np.array([self.right, self.right + step]), is_landing=True)
        return self

    def half_landing(self, gap: float) -> Layout:
        """Lay a landing as wide as both flights and the gap between them, and go back on the left."""
        ahead, aside = self.width * self.ahead, (self.left - self.right) / self.width
        inner = self.left + gap * aside
        outer = inner + self.width * aside
        right = np.array([self.right, self.right + ahead, outer + ahead, outer])
        self._lay(np.array([self.left, inner]), right, is_landing=True)
        return self

    def winder(self, count: int) -> Layout:
        """Lay `count` wedges that turn by a quarter to the left in a square."""
        u, across, pivot = self.ahead, self.right - self.left, self.left.copy()
        angles = np.linspace(0.0, 0.5 * np.pi, count + 1)

        def rim(angle: float) -> FloatArray:
            c, s = np.cos(angle), np.sin(angle)
            made: FloatArray = pivot + (c * across + s * self.width * u) / max(c, s)
            return made

        for a, b in itertools.pairwise(angles):
            corner = [rim(0.25 * np.pi)] if a < 0.25 * np.pi - 1e-9 < b - 2e-9 else []
            self._lay(np.array([pivot, pivot]), np.array([rim(a), *corner, rim(b)]))
        return self

    def round(self, count: int, inner: float, angle: float) -> Layout:
        """Lay `count` wedges of a ring around a middle on the left, `inner` away [m], over `angle` in all [rad]."""
        across = (self.right - self.left) / self.width
        center, u = self.left - inner * across, self.ahead
        outer = inner + self.width

        def at(radius: float, turn: float) -> FloatArray:
            made: FloatArray = center + radius * (np.cos(turn) * across + np.sin(turn) * u)
            return made

        for i in range(count):
            a, b = angle * i / count, angle * (i + 1) / count
            self._lay(np.array([at(inner, a), at(inner, b)]), np.array([at(outer, a), at(outer, b)]))
        return self

    def _lay(self, left: FloatArray, right: FloatArray, *, is_landing: bool = False) -> None:
        self.treads.append(Tread(left, right, is_landing))
        self.left, self.right = left[-1], right[-1]


@dataclass(frozen=True, slots=True)
class Stair:
    """A stair from height 0 up; the step after its last tread is the floor above.

    Attributes:
        name: Its kind.
        style: How it is made.
        treads: From the lowest up.
        turning: Posts in plan about which it turns, (x, y, radius) [m].
    """

    name: str
    style: Style
    treads: tuple[Tread, ...]
    turning: tuple[tuple[float, float, float], ...] = ()

    @property
    def storey(self) -> float:
        """Height of the floor above [m]."""
        return self.style.rise * (len(self.treads) + 1)

    @property
    def height(self) -> FloatArray:
        """Height of each tread [m], shape (n,)."""
        made: FloatArray = self.style.rise * np.arange(1.0, len(self.treads) + 1.0)
        return made

    def way(self) -> FloatArray:
        """Where one walks, from before the first edge to beyond the last one, (n, 3) [m]."""
        first, last = self.treads[0], self.treads[-1]
        began, ended = 0.5 * (first.left[0] + first.right[0]), 0.5 * (last.left[-1] + last.right[-1])
        before, beyond = began - _ahead(first.left[0], first.right[0]), ended + _ahead(last.left[-1], last.right[-1])
        on = [np.append(tread.middle, z) for tread, z in zip(self.treads, self.height, strict=True)]
        return np.array([np.append(before, 0.0), *on, np.append(beyond, self.storey)])

    def solids(self) -> list[Solid]:
        """The stair, with all that belongs to it."""
        made: list[Solid] = []
        for tread, z in zip(self.treads, self.height, strict=True):
            made += self._tread(tread, float(z))
            for side, line in (("left", tread.left), ("right", tread.right)):
                made += self._along(side, line, float(z), tread.is_landing)
        for x, y, radius in self.turning:
            made.append(post("newel", (x, y, 0.0), radius, self.storey + 1.0))
        return made

    def _tread(self, tread: Tread, z: float) -> list[Solid]:
        style, kind = self.style, "landing" if tread.is_landing else "tread"
        outline = tread.outline.copy()
        outline[:2] -= style.nosing * _ahead(outline[0], outline[1])
        made = [prism(kind, outline, z - style.thickness, z, walkable=True)]
        if style.under != "open":
            low = 0.0 if style.under == "massive" else max(0.0, z - style.rise - 0.15)
            made.append(prism("riser", tread.outline, low, z - style.thickness))
        return made

    def _along(self, side: str, line: FloatArray, z: float, is_landing: bool) -> list[Solid]:
        """What stands along one side of a tread: board, handrail with balusters, wall."""
        style, made = self.style, []
        pieces = np.hypot(*np.diff(line, axis=0).T)
        length = pieces.sum()
        if length < 1e-6:
            return []
        risen = np.concatenate([[0.0], np.cumsum(pieces)]) / length
        height = np.full(len(line), z) if is_landing else z - style.rise * (1.0 - risen)
        path = np.column_stack([line, height])
        for a, b in itertools.pairwise(path):
            if np.hypot(*(b - a)[:2]) < 1e-6:
                continue
            if side in style.boards:
                made.append(board("stringer", a, b, 0.04, 0.1, style.rise + 0.06))
            if side in style.rails:
                made.append(board("handrail", a, b, RAIL, -0.95, 0.95 + RAIL))
                made.append(post("baluster", (*a[:2], z - style.rise), 0.012, a[2] + 0.95 - z + style.rise, 8))
            if side in style.walls:
                made.append(board("wall", (*a[:2], 0.0), (*b[:2], 0.0), 0.08, 0.0, self.storey + 1.0))
        return made


def _ahead(left: FloatArray, right: FloatArray) -> FloatArray:
    """Unit vector across an edge, up the stair; an edge of a wedge may have its left end at the pivot."""
    across = (left - right) / np.hypot(*(left - right))
    return np.array([across[1], -across[0]])


def _straight(rng: np.random.Generator, style: Style, treads: int) -> Stair:
    return Stair("straight", style, tuple(Layout(style.width, style.going).straight(treads).treads))


def _landing(rng: np.random.Generator, style: Style, treads: int) -> Stair:
    half = treads // 2
    laid = Layout(style.width, style.going).straight(half).landing(float(rng.uniform(0.8, 1.2)))
    return Stair("landing", style, tuple(laid.straight(treads - half - 1).treads))


def _corner(rng: np.random.Generator, style: Style, treads: int) -> Stair:
    first = int(rng.integers(3, treads - 4))
    laid = Layout(style.width, style.going).straight(first).quarter_landing()
    return Stair("corner", style, tuple(laid.straight(treads - first - 1).treads))


def _return(rng: np.random.Generator, style: Style, treads: int) -> Stair:
    half = treads // 2
    laid = Layout(style.width, style.going).straight(half).half_landing(float(rng.uniform(0.02, 0.4)))
    return Stair("return", style, tuple(laid.straight(treads - half - 1).treads))


def _winder(rng: np.random.Generator, style: Style, treads: int) -> Stair:
    first, wedges = int(rng.integers(2, 6)), int(rng.integers(3, 5))
    laid = Layout(style.width, style.going).straight(first)
    x, y = laid.left
    laid.winder(wedges).straight(treads - first - wedges)
    return Stair("winder", style, tuple(laid.treads), ((float(x), float(y), NEWEL),))


def _half_winder(rng: np.random.Generator, style: Style, treads: int) -> Stair:
    first = (treads - 6) // 2
    laid = Layout(style.width, style.going).straight(first)
    x, y = laid.left
    laid.winder(3).winder(3).straight(treads - 6 - first)
    return Stair("half_winder", style, tuple(laid.treads), ((float(x), float(y), NEWEL),))


def _helical(rng: np.random.Generator, style: Style, treads: int) -> Stair:
    inner = treads * style.going / np.pi - 0.5 * style.width
    return Stair("helical", style, tuple(Layout(style.width, style.going).round(treads, inner, np.pi).treads))


def _spiral(rng: np.random.Generator, style: Style, treads: int) -> Stair:
    inner = 0.06
    laid = Layout(style.width, style.going).round(treads, inner, 1.5 * np.pi)
    return Stair("spiral", style, tuple(laid.treads), ((0.0, float(0.5 * style.width + inner), inner),))


STAIRS: dict[str, Callable[[np.random.Generator, Style, int], Stair]] = {
    "straight": _straight,
    "spiral": _spiral,
    "corner": _corner,
    "return": _return,
    "winder": _winder,
    "landing": _landing,
    "helical": _helical,
    "half_winder": _half_winder,
}
"""Kinds of stairs: how each lays so many treads in a style."""


def random_stair(kind: str, rng: np.random.Generator) -> Stair:
    """A stair of that kind, of random measures, made in a random way."""
    spiral = kind == "spiral"
    rise = float(rng.uniform(0.195, 0.215) if spiral else rng.uniform(0.16, 0.19))
    storey = float(rng.uniform(2.7, 3.0))
    treads = max(round(storey / rise) - 1, 12 if spiral else 13)
    under = "open" if spiral else str(rng.choice(["massive", "soffit", "open"]))
    sides = {name: _sides(rng, spiral, name) for name in ("boards", "rails")}
    style = Style(
        rise,
        going=float(rng.uniform(0.24, 0.3)),
        width=float(rng.uniform(0.85, 1.1) if spiral else rng.uniform(0.9, 1.25)),
        under=under,
        nosing=float(rng.choice([0.0, rng.uniform(0.01, 0.04)])),
        thickness=float(rng.uniform(0.03, 0.06)),
        walls=() if kind in ("spiral", "helical", "return", "half_winder") or rng.random() < 0.6 else ("left",),
        **sides,
    )
    return STAIRS[kind](rng, style, treads)


def _sides(rng: np.random.Generator, spiral: bool, name: str) -> tuple[str, ...]:
    if spiral:
        return ("right",) if name == "rails" or rng.random() < 0.5 else ()
    return tuple(side for side in ("left", "right") if rng.random() < 0.5)

"""A scene: the cloud, its levels, a Ground GPDF for each, and for each body its obstacles and free space."""

from __future__ import annotations

import dataclasses
import hashlib
import os
import threading
from collections import OrderedDict
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import binary_fill_holes

from gpdf_service.clouds import check_finite, check_labels, check_points
from gpdf_service.clouds.stream import rows_in_new_voxels
from gpdf_service.config import Config
from gpdf_service.denoise import FAR
from gpdf_service.errors import CloudError, SceneFileError
from gpdf_service.fields import Gpdf, Nearer, check_queries, fit_gpdf
from gpdf_service.fields.lattice import Lattice, fit_lattice, lattice_of, restore_lattice
from gpdf_service.fields.spacing import estimate_spacing, thin
from gpdf_service.fields.threads import run_parallel
from gpdf_service.ground import GroundLevel, Levels, Scan, Touched, voxel_pitch
from gpdf_service.ground.foot import LEAST_OBSTACLE
from gpdf_service.kernel_cache import load_kept
from gpdf_service.perception import (
    Perceived,
    Rays,
    Sampling,
    WholeError,
    change,
    check_origins,
    count_undecided,
    cure_and_segment,
    levels_from_arrays,
    levels_to_arrays,
    rays_of,
    survey_levels,
)
from gpdf_service.perception.budget import give_back
from gpdf_service.perception.noisy import NOISE_STEP
from gpdf_service.perception.segment import ANY, LEAST_SCATTER, Grain
from gpdf_service.search.change import change_free_space
from gpdf_service.search.free_space import FreeSpace, Setup, build_free_space
from gpdf_service.search.keep import from_arrays, to_arrays
from gpdf_service.search.moved import add_moving
from gpdf_service.search.ways import Prefer, Ways, find_ways, level_body
from gpdf_service.shades import Shades
from gpdf_service.store import Arrays, flatten, read_arrays, restore, write_arrays
from gpdf_service.tiles import HeightMap
from gpdf_service.tiles.points import Points, points_of
from gpdf_service.tiles.rows import chosen_rows
from gpdf_service.tiles.surface import INFERRED, UNKNOWN, first_cell, is_same_ground
from gpdf_service.tiles.told import moved
from gpdf_service.tiles.width import in_steps
from gpdf_service.types import Agent, BoolArray, FieldSample, FloatArray, IntArray, resolve_agent

Progress = Callable[[str, float], None]
"""Told the name of a stage and the share of the work that is done, 0 to 1."""
MAX_CACHED_AGENTS = 16
"""Free spaces kept for one scene; the least recently used goes first. A fleet has few kinds of body."""
MAX_DRIFT = 0.05
"""[-] Share of the points that may change before spacing and noise, medians over the whole cloud, are measured anew."""
SUNK = 2.0
"""[-] Standard deviations that noise can have sunk a point: further once in forty times."""

LEAST_WHOLE_SPACING = 0.05
"""[m] Of a field over a whole cloud: that of the waypoints which ask it."""
MAX_WHOLE_POINTS = 50_000
"""Points of a field over a whole cloud: its fit then takes seconds."""

_ALPHA = "ground_fields/{}/alpha"
"""Name in a file of what was solved for of a level's field; the rest follows from the ground."""
RISER = 0.3
"""[m] A contact point that is interpolated along a step's face lies this much under the ground there at most; storeys
are further apart by far."""


def level_under(surfaces: tuple[HeightMap, ...], points: FloatArray) -> IntArray:
    """The level whose ground is the highest one under each point.

    Args:
        surfaces: The levels' ground.
        points: Shape (m, 3) [m]. A point within one cell width under a ground still counts as standing on it.

    Returns:
        Level index, shape (m,); the lowest level there for a point under all ground, -1 where no ground is known.
    """
    heights = np.stack([surface.height_at(points[:, :2]) for surface in surfaces])
    tolerance = np.array([[surface.cell_width] for surface in surfaces])
    below = np.where(heights <= points[:, 2] + tolerance, heights, -np.inf)
    lowest = np.where(np.isnan(heights), np.inf, heights).argmin(axis=0)
    chosen = np.where(np.isfinite(below).any(axis=0), below.argmax(axis=0), lowest)
    return np.where(np.isnan(heights).all(axis=0), -1, chosen).astype(np.int64)


def levels_at(surfaces: tuple[HeightMap, ...], points: FloatArray) -> BoolArray:
    """Which levels each contact is on, shape (levels, m): several where their sheets are the same ground."""
    level = np.where(np.isfinite(points).all(axis=1), level_under(surfaces, points + np.array([0.0, 0.0, RISER])), -1)
    heights = np.stack([surface.height_at(points[:, :2]) for surface in surfaces])
    chosen = np.take_along_axis(heights, np.maximum(level, 0)[None], axis=0)
    same: BoolArray = (level >= 0) & is_same_ground(heights, chosen, surfaces[0].cell_width)
    return same


def whole_spacing(points: FloatArray) -> float:
    """Spacing of a field over a whole cloud [m]: the cloud's own, grown until `MAX_WHOLE_POINTS` are left."""
    spacing = max(estimate_spacing(points), LEAST_WHOLE_SPACING)
    while len(thin(points, spacing)) > MAX_WHOLE_POINTS:
        spacing *= 1.3
    return spacing


@dataclass(frozen=True, slots=True)
class GroundField:
    """Distance d_g to the ground of the level that a point is over; a `DistanceField` in 3D."""

    surfaces: tuple[HeightMap, ...]
    fields: tuple[Gpdf, ...]

    def query(self, queries: FloatArray) -> FieldSample:
        """Distance to the ground, gradient (m, 3) and validity at `queries`, shape (m, 3) [m]."""
        queries = check_queries(queries, (3,))
        if len(self.fields) == 1:
            return self.fields[0].query(queries)
        level = np.where(np.isfinite(queries).all(axis=1), level_under(self.surfaces, queries), -1)
        return _gather(queries, self.fields, level == np.arange(len(self.fields))[:, None])


@dataclass(frozen=True, slots=True)
class ObstacleField:
    """Distance d_o in plan to what stops one kind of body; a `DistanceField` over all levels."""

    surfaces: tuple[HeightMap, ...]
    fields: tuple[Nearer, ...]

    def query(self, queries: FloatArray) -> FieldSample:
        """Distance, gradient (m, 2) and validity at `queries`.

        Args:
            queries: Shape (m, 2), or (m, 3) with the height of the ground there, which says the level [m]. Without a
                height the answer is the smallest over the levels there: it never claims more room than there is.
                Where two levels are the same ground, each is clear on its own, so the larger answer counts: a sheet
                ends in the middle of a stair that the other one goes on.
        """
        queries = check_queries(queries, (2, 3))
        if queries.shape[1] == 3:
            return _gather(queries[:, :2], self.fields, levels_at(self.surfaces, queries))
        return _gather(queries, self.fields, np.ones((len(self.fields), len(queries)), dtype=bool), np.less)


def _gather(
    queries: FloatArray, fields: Sequence[Gpdf | Nearer], on: BoolArray, better: np.ufunc = np.greater_equal
) -> FieldSample:
    """The largest answer of those levels that each query is `on`, shape (levels, m), or the one that is `better`."""
    count = len(queries)
    made = FieldSample(np.zeros(count), np.zeros_like(queries), np.zeros(count, dtype=bool), np.full(count, np.inf))
    for mask, field in zip(on, fields, strict=True):
        if mask.any():
            sample = field.query(queries[mask])
            taken = sample.valid & (~made.valid[mask] | better(sample.distance, made.distance[mask]))
            rows = np.flatnonzero(mask)[taken]
            made.distance[rows], made.gradient[rows] = sample.distance[taken], sample.gradient[taken]
            made.valid[rows], made.deviation[rows] = True, sample.deviation[taken]
    return made


def _since(
    earlier: Touched, k: int, cells: BoolArray | None, grounds: tuple[HeightMap, HeightMap]
) -> tuple[int, BoolArray | None]:
    """What of a level is another than two versions ago: in these `cells` than level `k` of the version between.

    The `grounds` are that level's, and its own.
    """
    if k < 0:
        return k, cells
    source, other = earlier[k]
    if other is not None:
        other = moved(other, first_cell(grounds[0], grounds[1].origin), grounds[1].state.shape, fill=False)
    return source, (cells if other is None else other) if cells is None or other is None else cells | other


class Scene:
    """What is known of one place. Built by `build_scene`; safe to share between threads.

    Attributes:
        points: The cloud [m], shape (n, 3).
        ground: Which points are ground, shape (n,).
        levels: The ground as single-valued sheets, with what stands on them, and where they meet.
        ground_fields: One Ground GPDF a level.
        config: What it was built with.
        version: Counts the changes of this scene, from 1.
        noise: Standard deviation of the cloud's points [m], which plans keep away from as well; 0 when negligible.
        labelled: Whether `ground` was given with the cloud, and not found by our segmentation.
        perceived: What a change starts from; None after loading.
        drift: Share of the points that changed since noise and spacing were measured.
        moving: What is there beside what was scanned [m], shape (k, 3).
        rays: Those of the scan, where it is known where they began.
        shades: The scan's own colours, for pictures; those of later scans are not kept.
    """

    def __init__(
        self,
        points: FloatArray | Points,
        ground: BoolArray,
        levels: Levels,
        ground_fields: tuple[Gpdf, ...],
        config: Config,
        version: int = 1,
        noise: float = 0.0,
        labelled: bool = False,
        perceived: Perceived | None = None,
        drift: float = 0.0,
        rays: Rays | None = None,
    ) -> None:
        self._cloud, self._ground = points if isinstance(points, Points) else points_of(points), ground
        self.levels, self.ground_fields, self.config = levels, ground_fields, config
        self.version, self.noise, self.labelled = version, noise, labelled
        self.perceived, self.drift, self.rays = perceived, drift, rays
        self.moving: FloatArray = np.zeros((0, 3))
        self.shades: Shades | None = None
        self._standing: Scene | None = None  # the scene without what moves, whose free spaces serve
        self._spaces: OrderedDict[Agent, FreeSpace] = OrderedDict()
        self._ways: OrderedDict[tuple[Agent, Prefer], tuple[FreeSpace, Ways]] = OrderedDict()
        self._former: dict[Agent, tuple[FreeSpace, Touched]] = {}
        self._stored: dict[Agent, Callable[[], Arrays]] = {}  # read from the scene's file
        self._lock = threading.Lock()
        self._building: dict[Agent, threading.Lock] = {}

    @cached_property
    def points(self) -> FloatArray:  # noqa: D102 - an attribute of the class's docstring
        return self._cloud.present

    @cached_property
    def ground(self) -> BoolArray:  # noqa: D102
        return self._ground if self._cloud.untouched else self._ground[self._cloud.there]

    @property
    def surfaces(self) -> tuple[HeightMap, ...]:
        """The ground of each level as a height map."""
        return tuple(level.surface for level in self.levels.levels)

    @property
    def sampling(self) -> Sampling | None:
        """What the next versions keep; none where each is measured anew.

        They keep it until `MAX_DRIFT` of the points have changed: what is measured has steps, and a cloud beside one
        must not take another grid with each chair that is moved, nor be noisy with one and clean with the next.
        """
        if self.perceived is None:
            return None
        found = self.perceived.found
        grain = found.grain or Grain(self.surfaces[0].cell_width)
        return Sampling(grain, self.noise, None if found.noisy is None else found.noisy.tiles)

    @property
    def hidden_height(self) -> float:
        """How high over the ground a thing can stand without being seen [m].

        Labels tell a thing from the ground however low it is, but beside a step what is within a deviation of the
        ground is its face, and noise can have sunk it. Without labels what lies within the ground's scatter is ground,
        and so are single points that noise can have lifted off it; it can have sunk these, too.
        """
        least, lifted = (LEAST_OBSTACLE, 1.0) if self.labelled else (LEAST_SCATTER, FAR)
        return max(least, (lifted + SUNK) * self.noise)

    @cached_property
    def scan(self) -> Scan:
        """What obstacles need to know of the cloud."""
        if self._standing is not None:
            return self._standing.scan
        return Scan(self.noise, self.hidden_height, voxel_pitch(self._cloud) > 0.0)

    @property
    def ground_field(self) -> GroundField:
        """Distance to the ground, in 3D."""
        return GroundField(self.surfaces, self.ground_fields)

    def obstacle_field(self, agent: str | Agent) -> ObstacleField:
        """Distance in plan to what stops `agent`; built on first use."""
        levels = self.free_space(agent).levels
        return ObstacleField(self.surfaces, tuple(own.obstacle_field for own in levels))

    def free_space(self, agent: str | Agent) -> FreeSpace:
        """Where `agent` can be, and how those places connect; built on first use and kept."""
        body = resolve_agent(agent)
        with self._lock:
            if body in self._spaces:
                self._spaces.move_to_end(body)
                return self._spaces[body]
            building = self._building.setdefault(body, threading.Lock())
        with building:  # a second caller waits for the first one's result; other bodies and plans go on
            with self._lock:
                if body in self._spaces:
                    return self._spaces[body]
            space = self._make_space(body)
            with self._lock:
                self._spaces[body] = space
                self._former.pop(body, None)
                self._stored.pop(body, None)
                self._building.pop(body, None)
                while len(self._spaces) > MAX_CACHED_AGENTS:
                    self._spaces.popitem(last=False)
            return space

    def ways(self, agent: str | Agent, prefer: Prefer) -> Ways:
        """All ways of `agent`, at what they cost it as one prefers them; built on first use and kept."""
        body = resolve_agent(agent)
        able, key, same = self.free_space(body), (body, prefer), level_body(body)
        with self._lock:
            kept = self._ways.get(key)
            if same is not None and same in self._spaces:
                self._spaces.move_to_end(same)
        if kept is None or kept[0] is not able:
            stand = self._standing.ways(body, prefer) if self._standing is not None else None
            kept = able, find_ways(able, None if same is None else self.free_space(same), prefer, stand)
            with self._lock:
                self._ways[key] = kept
                while len(self._ways) > MAX_CACHED_AGENTS:
                    self._ways.popitem(last=False)
        return kept[1]

    def prepare(self, agent: str | Agent) -> None:
        """Build what plans for `agent` read, and load what they run, so that the first one takes what plans take."""
        load_kept("search", "planning")
        self.ways(agent, Prefer.COMPANION)
        for field, surface in zip(self.ground_fields, self.surfaces, strict=True):
            _ = field.discs, surface.ends, surface.inferred  # told on first use

    def _make_space(self, body: Agent) -> FreeSpace:
        parts = self.levels, self.ground_fields
        if (stored := self._stored.get(body)) is not None:
            return from_arrays(stored(), body, *parts, self.config.search, self.noise)
        setup = Setup(self.config.search, self.config.fields, self.scan)
        if self._standing is not None:
            stands = self._standing.free_space(body)
            return add_moving(stands, self.levels, self.moving, setup)
        former = self._former.get(body)
        if former is None or self.perceived is None:
            return build_free_space(*parts, body, setup)
        (space, touched), first = former, [made.first for made in self.perceived.survey.made]
        return change_free_space(space, *parts, touched, first, setup)

    def _spaces_before(
        self, touched: Touched, grounds: tuple[HeightMap, ...]
    ) -> dict[Agent, tuple[FreeSpace, Touched]]:
        """For each body the free space that the next version's, on these `grounds`, is made from, and what changed."""
        with self._lock:
            before = {body: (space, touched) for body, space in self._spaces.items()}
            for body, (space, earlier) in list(self._former.items())[: MAX_CACHED_AGENTS - len(before)]:
                both = zip(touched, grounds, strict=True)
                then = [_since(earlier, k, cells, (self.surfaces[k], ground)) for (k, cells), ground in both]
                before[body] = space, tuple(then)
        return before

    def with_obstacles(self, points: ArrayLike) -> Scene:
        """This scene with more in it than was scanned: people, doors, whatever moves.

        The ground stays as it is, and so does what stands: both are shared. Of a free space only what the points touch
        is made again, on first use, so that field, search and certificate all know of them at once.

        Args:
            points: Where something is [m], shape (k, 3), dense enough that no body fits between two. As with what was
                scanned, each level looks at all that is in reach of its ground: where two sheets are the same ground,
                what stands there stands on both.

        Raises:
            CloudError: points of another shape, or not finite: where they are dropped nothing would be in the way.
        """
        asked = check_finite(points)
        fixed = self.ground_fields, self.config, self.version, self.noise, self.labelled
        made = Scene(self._cloud, self._ground, self.levels, *fixed, rays=self.rays)
        made.moving, made._standing = np.concatenate([self.moving, asked]), self._standing or self
        made.shades = self.shades
        return made

    def update(
        self,
        insert: ArrayLike | None = None,
        remove: ArrayLike | None = None,
        *,
        ground: ArrayLike | None = None,
        origins: ArrayLike | None = None,
        thin: float | None = None,
        progress: Progress = lambda stage, done: None,
    ) -> Scene:
        """The next version of this scene, after a further scan, or with something taken away; this one stays as it is.

        The Ground GPDFs are solved again only around the ground that changed. Free spaces are built on first use. What
        moves in this version does so in the next one.

        Args:
            insert: Points that are new [m], shape (k, 3).
            remove: Which of `points` are gone: a mask of shape (n,), or row numbers.
            ground: Which of the new points are ground, shape (k,). Where it is not given they are segmented together
                with the points that are there; labels that the scene was built with stay.
            origins: Where the rays to the new points began [m], (3,) or (k, 3); kept if the scene was built with some.
            thin: Of the new points only those are taken, one each, in whose voxel of this width [m] no point is: what
                is scanned over and over does not grow. All where it is not given.
            progress: Called as the work goes on.

        Raises:
            CloudError: points, rows or labels that cannot be used.
            NoGroundError: no ground would be left.
        """
        if self._standing is not None:
            then = self._standing.update(insert, remove, ground=ground, origins=origins, thin=thin, progress=progress)
            return then.with_obstacles(self.moving)
        keep = np.ones(self._cloud.count, dtype=bool)
        try:
            if remove is not None and np.size(remove):
                keep[np.asarray(remove)] = False
        except IndexError as error:
            raise CloudError("remove", f"rows that are not there ({error})", "Name rows of `points`.") from error
        fresh, gone = np.zeros((0, 3)) if insert is None else check_points(insert), np.flatnonzero(~keep)
        labels, began = None if ground is None else check_labels(ground, len(fresh)), self._began_at(fresh, origins)
        if thin is not None:
            rows = rows_in_new_voxels(fresh, thin, chosen_rows(self.points, keep))
            fresh, labels = fresh[rows], None if labels is None else labels[rows]
            began = None if began is None else began[rows]
        count = len(keep) - len(gone) + len(fresh)
        if not count:
            raise CloudError("update", "no point would be left", "Keep some, or build another scene.")
        drift = self.drift + (len(gone) + len(fresh)) / count
        if self.perceived is not None and drift <= MAX_DRIFT and (self.labelled or labels is None):
            with suppress(WholeError):
                progress("change levels", 0.0)
                now = change(self.perceived, self._cloud.numbers(gone), fresh, labels, self.config.perception, began)
                return self._changed(now, drift, progress)
        cloud = chosen_rows(self.points, keep, fresh)
        if self.labelled or labels is not None:
            fresh_labels = self._labels_of(cloud, len(fresh)) if labels is None else labels
            labels = np.concatenate([self.ground[keep], fresh_labels])
        known = self.sampling if drift <= MAX_DRIFT else None
        began = None if began is None or self.rays is None else self.rays.began_at(keep, began)
        scene = assemble_scene(cloud, labels, self.config, like=self, known=known, origins=began, progress=progress)
        scene.drift, scene.shades = 0.0 if known is None else drift, self.shades
        return scene

    def _changed(self, now: Perceived, drift: float, progress: Progress) -> Scene:
        progress("change ground fields", 0.5)
        fields = _fit_grounds(now.levels, self.config, self, now.survey.former)
        progress("ready", 1.0)
        known = self.version + 1, self.noise, self.labelled
        points, own = now.found.cloud
        scene = Scene(points, own, now.levels, fields, self.config, *known, now, drift, now.rays)
        scene.shades = self.shades
        if scene.scan == self.scan and now.touched:  # else all that stops a body may be another
            scene._former = self._spaces_before(now.touched, scene.surfaces)
        return scene

    def _began_at(self, fresh: FloatArray, origins: ArrayLike | None) -> FloatArray | None:
        """Where the rays to new points began; those without origins have none that are known."""
        if self.rays is None:
            return None
        return np.broadcast_to(np.nan if origins is None else check_origins(origins, fresh), fresh.shape).copy()

    def _labels_of(self, cloud: FloatArray, count: int) -> BoolArray:
        """Which of the last points of a cloud, so many, are ground."""
        if count == 0:
            return np.zeros(0, dtype=bool)
        return cure_and_segment(cloud, None, self.config.perception).cloud[1][-count:]

    def forget_agents(self) -> None:
        """Drop what was built for single kinds of body; it is built again on use."""
        with self._lock:
            self._spaces.clear()
            self._ways.clear()
            self._former.clear()
            self._stored.clear()

    def forget_oldest_agent(self) -> bool:
        """Drop what was built for the kind of body that was least recently used; whether there was one."""
        with self._lock:
            if not self._spaces:
                return False
            _, gone = self._spaces.popitem(last=False)
            held = [key for key, (_, ways) in self._ways.items() if any(space is gone for space in ways.spaces)]
            for key in held:
                del self._ways[key]
            return True

    @cached_property
    def whole_field(self) -> Gpdf:
        """One 3D field over all points, ground or not, for the single_gpdf baseline; fitted on first use."""
        return fit_gpdf(self.points, config=self.config.fields, spacing=whole_spacing(self.points))

    @cached_property
    def digest(self) -> str:
        """Hash of the cloud and its labels: the same place gives the same digest on any machine."""
        digest = hashlib.sha256(np.ascontiguousarray(self.points, dtype="<f8").tobytes())
        digest.update(np.packbits(self.ground).tobytes())
        return digest.hexdigest()[:16]

    def info(self) -> dict[str, Any]:
        """Facts about the scene, ready for JSON."""
        with self._lock:
            ready = list(dict.fromkeys(agent.name for agent in {**self._stored, **self._spaces}))
        coloured = self.shades is not None
        return {**self._lasting_facts, "version": self.version, "agents_ready": ready, "coloured": coloured}

    @cached_property
    def _lasting_facts(self) -> dict[str, Any]:
        """What one pass over the points tells; asked several times a second while a client waits."""
        low, high = self.points.min(axis=0), self.points.max(axis=0)
        undecided = sum(count_undecided(level, self.noise) for level in self.levels.levels)
        return {
            "points": len(self.points),
            "ground_points": int(self.ground.sum()),
            "ground_confidence": float(self.ground.sum() / (self.ground.sum() + undecided)),
            "undecided_points": undecided,
            "extent": [low.tolist(), high.tolist()],
            "digest": self.digest,
            "levels": [_level_info(i, self.levels.levels[i], self.ground_fields[i]) for i in range(len(self.surfaces))],
            "portals": len(self.levels.portals),
            "noise": self.noise,
            "hidden_height": self.hidden_height,
        }

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the scene to one file, atomically, with the free spaces that are ready: `MAX_CACHED_AGENTS` at most.

        What moves is not written.
        """
        if self._standing is not None:
            self._standing.save(path)
            return
        points = self._cloud.present  # not kept: a builder's scene shares them with the version before
        levels = levels_to_arrays(self.levels, points, self.config.perception.max_step)
        arrays = {"points": points, "ground": self.ground, **levels}
        if self.rays is not None:
            arrays["origins"] = self.rays.began
        if self.shades is not None:
            arrays |= flatten(self.shades, "shades")
        arrays |= {_ALPHA.format(i): field.alpha for i, field in enumerate(self.ground_fields)}
        with self._lock:
            spaces, stored = dict(self._spaces), dict(self._stored)
        agents = list({**stored, **spaces})[-MAX_CACHED_AGENTS:]
        for i, agent in enumerate(agents):
            found = to_arrays(spaces[agent]) if agent in spaces else stored[agent]()
            arrays |= {f"agents/{i}/{key}": value for key, value in found.items()}
        known = {"version": self.version, "noise": self.noise, "labelled": self.labelled}
        bodies = [dataclasses.asdict(agent) for agent in agents]
        write_arrays(path, arrays, {**known, "config": dataclasses.asdict(self.config), "agents": bodies})


def _level_info(index: int, level: GroundLevel, field: Gpdf) -> dict[str, Any]:
    """Facts about one level, ready for JSON: areas in m², lengths in m."""
    surface = level.surface
    cell_area = surface.cell_width**2
    known = surface.state != UNKNOWN
    return {
        "level": index,
        "height": [float(np.nanmin(surface.height)), float(np.nanmax(surface.height))],
        "cell_width": float(surface.cell_width),
        "known_area": float(known.sum() * cell_area),
        "inferred_area": float((surface.state == INFERRED).sum() * cell_area),
        "undecided_area": float((binary_fill_holes(known) & ~known).sum() * cell_area),
        "other_points": len(level.other_points),
        "limits": len(level.limits.points),
        "field_points": len(field.points),
        "length_scale": float(field.length_scale),
    }


def _restore_ground(level: GroundLevel, alpha: FloatArray, config: Config) -> Gpdf:
    """The level's Ground GPDF from a file."""
    lattice = _lattice(level, config)
    if alpha.shape != (count := np.count_nonzero(~np.isnan(lattice.height)),):
        found = f"a ground field of {len(alpha)} cells, over a level of {count}"
        raise SceneFileError("scene file", found, "Build the scene again from its cloud.")
    return restore_lattice(lattice, alpha, level.surface)


def load_scene(path: str | os.PathLike[str]) -> Scene:
    """Read a scene that `Scene.save` wrote; nothing is fitted again.

    Raises:
        SceneFileError: the file is missing, damaged, or of another version.
    """
    arrays, meta, later = read_arrays(path, later="agents/")
    config = Config.from_kept(meta["config"])
    levels = levels_from_arrays(arrays, arrays["points"], config.perception.max_step)
    fields = [
        _restore_ground(level, restore(FloatArray, arrays, _ALPHA.format(i)), config)
        for i, level in enumerate(levels.levels)
    ]
    known = int(meta["version"]), float(meta["noise"]), bool(meta["labelled"])
    points = points_of(arrays["points"])
    rays = rays_of(points, arrays["origins"]) if "origins" in arrays else None
    scene = Scene(points, arrays["ground"], levels, tuple(fields), config, *known, rays=rays)
    if "shades/cells" in arrays:
        scene.shades = restore(Shades, arrays, "shades")
    bodies = enumerate(meta.get("agents", ()))
    scene._stored = {Agent(**body): partial(later.under, f"agents/{i}/") for i, body in bodies}
    return scene


def assemble_scene(
    cloud: FloatArray,
    labels: BoolArray | None,
    config: Config,
    *,
    like: Scene | None = None,
    known: Sampling | None = None,
    origins: FloatArray | None = None,
    progress: Progress = lambda stage, done: None,
) -> Scene:
    """Ground, levels and Ground GPDFs of a cloud; what is as it was in the scene `like` is taken over from it.

    What is not `known` of its sampling is measured. Where rays began, at `origins`, shape (1, 3) or (n, 3), they tell
    what was seen of inferred ground.
    """
    progress("segment ground", 0.0)
    found = cure_and_segment(cloud, labels, config.perception, known)
    give_back(len(cloud))
    progress("build levels", 0.4)
    grain = found.grain or (ANY if known is None else known.grain)
    measured, ground = found.cloud
    rays = None if origins is None else rays_of(measured, origins)
    own = found.points, found.ground, config.perception
    levels, survey = survey_levels(*own, width=grain.width, noise=found.spread, rays=rays)
    give_back(len(cloud))
    progress("fit ground fields", 0.7)
    fields = _fit_grounds(levels, config, like, range(len(like.surfaces)) if like is not None else ())
    progress("ready", 1.0)
    noise = found.measured if found.measured > config.perception.negligible_noise else 0.0
    facts = 1 if like is None else like.version + 1, in_steps(noise, NOISE_STEP), labels is not None
    perceived = Perceived(found, levels, survey, rays=rays).lasting()
    return Scene(measured, ground, levels, fields, config, *facts, perceived, rays=rays)


def _fit_grounds(levels: Levels, config: Config, like: Scene | None, former: Sequence[int]) -> tuple[Gpdf, ...]:
    """The Ground GPDF of each level, solved where the ground is another than in the scene `like`.

    Each was the `former` level there, −1 for none; those beyond its end were none, too.
    """

    def fit(i: int) -> Gpdf:
        level, k, before = levels.levels[i], former[i] if i < len(former) else -1, None
        if like is not None and k >= 0:
            field, old = like.ground_fields[k], like.levels.levels[k]
            if level.surface is old.surface:
                return field
            before = field, _lattice(old, config)
        return fit_lattice(_lattice(level, config), level.surface, before)

    return tuple(run_parallel(fit, range(len(levels.levels))))


def _lattice(level: GroundLevel, config: Config) -> Lattice:
    """The lattice of a level's ground."""
    surface = level.surface
    height = np.where(surface.state != UNKNOWN, surface.height, np.nan)
    return lattice_of(height, surface.origin, surface.cell_width, config.fields)

"""Gaussian-process distance field with the squared exponential kernel and its reverting function.

Occupancy ô(x) = k_xX (K_XX + σ² I)⁻¹ 1, distance d(x) = r(ô(x)) = √(−2 l² log ô(x)); Uttsha et al. 2024, equations 1, 2
and 8. K is cut at `CUT_RADIUS` length scales, so it is sparse.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gpdf_service.config import FieldConfig
from gpdf_service.errors import FieldError
from gpdf_service.fields.order import corners_of, spatial_order
from gpdf_service.fields.solve import HALO, solve_all, solve_rows, within
from gpdf_service.fields.spacing import REACH, estimate_spacing, local_shape, thin
from gpdf_service.fields.threads import run_chunked
from gpdf_service.fields.traversal import FieldArrays, NearerArrays, by_leaf, nearest_only, nearest_range, sample_range
from gpdf_service.fields.tree import NO_POINTS, Tree, build_tree, change_tree, tree_of
from gpdf_service.types import BoolArray, FieldSample, FloatArray, IntArray

_CELLS = 2**20
"""Spacings across all points: 20 km at 2 cm. More is a stray, and the cells of a thinning could not be counted."""
_FARTHEST = 1e9
"""[m] Largest coordinate: beyond, a double no longer holds tenths of a millimetre."""
_TREE = "points", "order", "begin"
"""What the rest of a tree follows from."""


class Domain(Protocol):
    """Where the data supports an answer."""

    def contains(self, queries: FloatArray) -> BoolArray:
        """Whether each query, shape (m, dim) [m], lies inside; shape (m,)."""
        ...


class Box:
    """The data's bounding box, grown by its own largest side: beyond, the data says nothing about what is near."""

    def __init__(self, points: FloatArray) -> None:
        self.low, self.high = points.min(axis=0), points.max(axis=0)
        margin = float((self.high - self.low).max())
        self.low, self.high = self.low - margin, self.high + margin

    def contains(self, queries: FloatArray) -> BoolArray:
        """Whether each query lies in the grown box."""
        inside = np.ones(len(queries), dtype=bool)
        for column, low, high in zip(queries.T, self.low, self.high, strict=True):
            inside &= (column >= low) & (column <= high)
        return inside


class Gpdf:
    """A fitted field; a `DistanceField` in 2D or 3D. It never changes: `replace` gives another one.

    Attributes:
        tree: The points that it was fitted to, in a k-d tree [m].
        alpha: (K + σ² I)⁻¹ 1, in the tree's order, shape (n,).
        discs: The surface that each point stands for, shape (n, 6): `local_shape`; told on first use if need be.
        noise: Standard deviation of each point along the surface's normal [m], shape (n,).
        kernel: The three numbers that come next.
        length_scale: l of the kernel [m].
        noise_variance: σ² of the occupancy [-].
        spacing: Distance between neighbouring points that the field resolves [m].
        domain: Where the field answers.
    """

    def __init__(
        self,
        tree: Tree,
        alpha: FloatArray,
        discs: FloatArray | Callable[[], FloatArray],
        noise: FloatArray,
        kernel: tuple[float, float, float],
        domain: Domain | None = None,
    ) -> None:
        self.tree, self.alpha, self._discs, self.noise, self.kernel = tree, alpha, discs, noise, kernel
        self.length_scale, self.noise_variance, self.spacing = kernel
        self.domain: Domain = Box(tree.points) if domain is None else domain
        self._weights, self._off = by_leaf(tree, alpha), np.zeros(0)

    @property
    def discs(self) -> FloatArray:  # noqa: D102 - an attribute of the class's docstring
        if callable(self._discs):
            self._discs = self._discs()  # two threads that tell it at once tell the same
        return self._discs

    @property
    def shaped(self) -> bool:
        """Whether the discs were told."""
        return not callable(self._discs)

    @property
    def points(self) -> FloatArray:
        """The points that the field was fitted to [m], shape (n, dim)."""
        return self.tree.points

    @property
    def arrays(self) -> NearerArrays:
        """What a compiled loop needs for `traversal.sample_at`."""
        tree = self.tree
        return (FieldArrays(tree.begin, tree.blocks, tree.boxes, self._weights, self.discs, self.length_scale),)

    @property
    def nbytes(self) -> int:
        """Memory that the field holds [bytes]."""
        held = [*self.tree, self._weights, self.alpha, self.noise]
        discs = 7 * len(self.points) * self.alpha.itemsize  # with what `query` keeps; they may not be there yet
        return discs + sum({id(array): array.nbytes for array in held}.values())

    def query(self, queries: ArrayLike) -> FieldSample:
        """Distance to the surface, its gradient, validity and standard deviation.

        The distance lies between √(δ − g²), where δ is the squared distance to the nearest point and g the gap around
        that point, and the distance to the disc of half a gap around it: it never claims more room than there is to the
        nearest measured point. The standard deviation is that point's noise, how far the surface bends there, and half
        of what the bracket leaves open.

        Args:
            queries: Shape (m, dim) [m]. A row that is not finite is not valid.

        Raises:
            FieldError: the queries have another shape.
        """
        asked, finite = self._check(queries)
        count = len(asked)
        distance, deviation, gradient = np.empty(count), np.empty(count), np.empty_like(asked)
        order, made = spatial_order(asked), (distance, gradient, deviation)
        (field,), off = self.arrays, self._off_surface()
        run_chunked(lambda a, b: sample_range(field, asked, order[a:b], off, made), count)
        valid = finite & self.domain.contains(asked) & np.isfinite(deviation)
        distance[~valid], gradient[~valid], deviation[~valid] = 0.0, 0.0, np.inf
        return FieldSample(distance, gradient, valid, deviation)

    def replace(self, gone: BoolArray, points: FloatArray) -> Gpdf:
        """The field without the points where `gone`, shape (n,), and with `points`, (k, dim) [m], solved around them.

        The new points must be half the spacing or more from all that stay, and from each other.

        Raises:
            FieldError: nothing would be kept.
        """
        if gone.all():
            raise FieldError("replace", "all points", "A field that keeps nothing is a new one; fit it.")
        if len(points) == 0 and not gone.any():
            return self
        tree, source = change_tree(self.tree, ~gone, points)
        old, at = source >= 0, np.maximum(source, 0)  # what is taken for a new point is overwritten
        alpha, own, discs = (np.take(each, at, axis=0) for each in (self.alpha, self.noise, self.discs))
        alpha[~old], own[~old] = np.nan, 0.0

        def around(radius: float) -> IntArray:
            """Rows within the radius of a point that came or went."""
            lost = np.zeros(len(self.points), dtype=bool)
            lost[within(self.tree, np.flatnonzero(gone), radius)] = True
            felt = lost[at] | ~old
            felt[within(tree, np.flatnonzero(~old), radius)] = True
            return np.flatnonzero(felt)

        rows, shaped = around(HALO * self.length_scale), around(REACH * self.spacing)
        if len(rows):
            alpha[rows] = solve_rows(tree, rows, alpha, self.length_scale, self.noise_variance)
        discs[shaped] = local_shape(tree, shaped, self.spacing, own[shaped])
        return Gpdf(tree, alpha, discs, own, self.kernel, self.domain)

    def over(self, domain: Domain) -> Gpdf:
        """The same field with another domain."""
        made = copy(self)
        made.domain = domain
        return made

    def _off_surface(self) -> FloatArray:
        """How far each point may be from the surface by its noise and a bend [m], shape (n,)."""
        if len(self._off) < len(self.points):
            self._off = np.hypot(self.noise, self.discs[:, 5])
        return self._off

    def _check(self, queries: ArrayLike) -> tuple[FloatArray, BoolArray]:
        asked = check_queries(queries, (self.points.shape[1],))
        if np.isfinite(asked).all():
            return asked, np.ones(len(asked), dtype=bool)
        finite: BoolArray = np.logical_and.reduce(np.isfinite(asked), axis=1)
        return np.where(finite[:, None], asked, 0.0), finite

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """All that `from_arrays` needs, as arrays."""
        own = {"alpha": self.alpha, "discs": self.discs, "noise": self.noise}
        lasting = {key: getattr(self.tree, key) for key in _TREE}
        return {**lasting, **own, "scalars": np.array(self.kernel)}

    @classmethod
    def from_arrays(cls, arrays: dict[str, NDArray[Any]], domain: Domain | None = None) -> Gpdf:
        """Restore a field; nothing is fitted."""
        points, order, begin = (arrays[key] for key in _TREE)
        tree = tree_of(points, order, begin)
        length_scale, noise_variance, spacing = (float(value) for value in arrays["scalars"])
        own = arrays["alpha"], arrays["discs"], arrays["noise"]
        return cls(tree, *own, (length_scale, noise_variance, spacing), domain)


def find_nearest(tree: Tree, queries: FloatArray) -> tuple[FloatArray, IntArray]:
    """Exact nearest point of each query, shape (m, dim): distance [m] and row in `tree.points`, shape (m,)."""
    distance, index = np.zeros(len(queries)), np.zeros(len(queries), np.int64)
    run_chunked(lambda a, b: nearest_range(tree, queries[a:b], distance[a:b], index[a:b]), len(queries))
    return distance, index


def fit_gpdf(
    points: ArrayLike,
    *,
    noise: ArrayLike = 0.0,
    config: FieldConfig | None = None,
    domain: Domain | None = None,
    spacing: float | None = None,
) -> Gpdf:
    """Fit a field to surface points.

    Args:
        points: Shape (n, 2) or (n, 3), n ≥ 1 [m]. Noisy ones are cured first: `denoise`.
        noise: Standard deviation of the points along the surface's normal [m], one number or shape (n,).
        config: Length scale factor and noise variance.
        domain: Where the field may answer; a box around the data when not given.
        spacing: Distance between points that the field resolves [m]; estimated when not given. Closer points are
            thinned (one real point a cell), which can hide at most √dim × spacing of a surface's relief.

    Raises:
        FieldError: wrong shape, not finite, or no points.
    """
    config = config or FieldConfig()
    data = _check_points(points)
    if len(data) == 0:
        raise FieldError("fit", "no points", "A field needs at least one point on a surface.")
    own = _check_noise(noise, len(data))
    estimated = spacing is None
    tree = build_tree(data) if spacing is None else None
    spacing = estimate_spacing(data, tree) if spacing is None else float(spacing)
    if not (estimated or spacing > 0.0):
        raise FieldError("fit", f"a spacing of {spacing:g} m", "Pass a positive one, or none.")
    _check_extent(data, spacing)
    rows = thin(data, spacing * (0.5 if estimated else 0.95))  # a grid of that spacing keeps all its points
    if spacing <= 0.0:
        spacing = 1e-3  # [m] a single place has no spacing; a millimetre is below what any scanner resolves
    tree = build_tree(data[rows]) if tree is None or len(rows) < len(data) else tree
    length_scale = config.length_scale_factor * spacing
    alpha = solve_all(tree, length_scale, config.noise_variance)
    own = own[rows][tree.order]
    discs = local_shape(tree, np.arange(len(rows)), spacing, own)
    return Gpdf(tree, alpha, discs, own, (length_scale, config.noise_variance, spacing), domain)


def _real(asked: str, values: ArrayLike) -> FloatArray:
    """Real numbers in rows, as compiled code needs them."""
    try:
        made = np.asarray(values)
        if made.dtype.kind not in "buif":
            raise TypeError(f"numbers of type {made.dtype}")
        return np.asarray(made, dtype=np.float64, order="C")
    except (TypeError, ValueError) as error:
        raise FieldError(asked, f"what is no array of numbers ({error})", "Pass an array of real numbers.") from error


def check_queries(queries: ArrayLike, dims: tuple[int, ...]) -> FloatArray:
    """Queries of any of these dimensions as floats, shape (m, dim).

    Raises:
        FieldError: another shape, or no numbers.
    """
    asked = _real("field query", queries)
    if asked.ndim != 2 or asked.shape[1] not in dims:
        shapes = " or ".join(f"(m, {dim})" for dim in dims)
        raise FieldError("field query", f"queries of shape {asked.shape}", f"Pass an array of shape {shapes}.")
    return asked


def _check_points(points: ArrayLike) -> FloatArray:
    data = _real("fit", points)
    if data.ndim != 2 or data.shape[1] not in (2, 3):
        raise FieldError("fit", f"points of shape {data.shape}", "Pass an array of shape (n, 2) or (n, 3).")
    if not np.isfinite(data).all():
        raise FieldError("fit", "points that are not finite", "Remove NaN and infinite coordinates.")
    if len(data) and np.abs(data).max() > _FARTHEST:
        raise FieldError("fit", f"a coordinate beyond {_FARTHEST:g} m", "Move the origin, or take the point out.")
    return data


def _check_noise(noise: ArrayLike, count: int) -> FloatArray:
    own = _real("fit", noise)
    if own.shape not in ((), (count,)) or not (np.isfinite(own) & (own >= 0.0)).all():
        found = f"noise of shape {own.shape}, or not finite, or negative"
        raise FieldError("fit", found, "Pass one number ≥ 0, or one for each point.")
    return np.broadcast_to(own, count)


def _check_extent(data: FloatArray, spacing: float) -> None:
    low, high = corners_of(data)
    extent = float((high - low).max())
    if extent > _CELLS * spacing > 0.0:
        found = f"points {extent:g} m apart with a spacing of {spacing:g} m"
        raise FieldError("fit", found, "Take out what is far from everything else.")


_NOTHING = (nearest_only(NO_POINTS),)
"""A field of no points, in compiled form."""


@dataclass(frozen=True, slots=True)
class Nearer:
    """Two fields in one, a `DistanceField`: what stands, and what moves, if anything does. The nearer one answers.

    Each brackets the distance to its own nearest point, so their least brackets that to the nearest of all points.
    """

    standing: Gpdf
    moving: Gpdf | None = None

    @property
    def arrays(self) -> NearerArrays:
        """What a compiled loop needs for `traversal.sample_at`."""
        return self.standing.arrays + (_NOTHING if self.moving is None else self.moving.arrays)

    def query(self, queries: ArrayLike) -> FieldSample:
        """Distance, gradient, validity and standard deviation of the nearer one: see `Gpdf.query`."""
        stands = self.standing.query(queries)
        if self.moving is None:
            return stands
        moves = self.moving.query(queries)
        nearer = moves.valid & (~stands.valid | (moves.distance < stands.distance))
        return FieldSample(
            np.where(nearer, moves.distance, stands.distance),
            np.where(nearer[:, None], moves.gradient, stands.gradient),
            stands.valid | moves.valid,
            np.where(nearer, moves.deviation, stands.deviation),
        )

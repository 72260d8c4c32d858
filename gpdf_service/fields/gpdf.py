"""Gaussian-process distance field with the squared exponential kernel and its reverting function.

Occupancy ô(x) = k_xX (K_XX + σ² I)⁻¹ 1, distance d(x) = r(ô(x)) = √(−2 l² log ô(x)); Uttsha et al. 2024, equations 1, 2
and 8. K is cut at `CUT_RADIUS` length scales, so it is sparse, and solved by conjugate gradients.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_matrix, identity
from scipy.sparse.linalg import cg
from scipy.spatial import cKDTree

from gpdf_service.config import FieldConfig
from gpdf_service.errors import FieldError
from gpdf_service.fields.spacing import estimate_spacing, thin
from gpdf_service.fields.threads import run_chunked
from gpdf_service.fields.traversal import CUT_RADIUS, FieldArrays, nearest_range, sample_range
from gpdf_service.fields.tree import Tree, build_tree
from gpdf_service.types import BoolArray, FieldSample, FloatArray, IntArray

_TOLERANCE = 1e-3
"""Relative residual of the solve: the logarithm forgives errors in α; 1e-3 moves the distance by under 0.1 mm."""


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
        inside: BoolArray = ((queries >= self.low) & (queries <= self.high)).all(axis=1)
        return inside


class Gpdf:
    """A fitted field; a `DistanceField` in 2D or 3D.

    Attributes:
        tree: The points that it was fitted to, in a k-d tree [m].
        alpha: (K + σ² I)⁻¹ 1, in the tree's order, shape (n,).
        length_scale: l of the kernel [m].
        noise_variance: σ² of the occupancy [-].
        spacing: Distance between neighbouring points [m].
        domain: Where the field answers.
    """

    def __init__(
        self,
        tree: Tree,
        alpha: FloatArray,
        length_scale: float,
        noise_variance: float,
        spacing: float,
        domain: Domain | None = None,
    ) -> None:
        self.tree, self.alpha = tree, alpha
        self.length_scale, self.noise_variance, self.spacing = length_scale, noise_variance, spacing
        self.domain: Domain = Box(tree.points) if domain is None else domain

    @property
    def points(self) -> FloatArray:
        """The points that the field was fitted to [m], shape (n, dim)."""
        return self.tree.points

    @property
    def arrays(self) -> FieldArrays:
        """What a compiled loop needs for `traversal.sample_one`."""
        tree = self.tree
        return FieldArrays(
            tree.points, self.alpha, tree.begin, tree.end, tree.low, tree.high, self.length_scale, self.spacing**2
        )

    def query(self, queries: ArrayLike) -> FieldSample:
        """Distance to the surface, its gradient and validity.

        The distance lies between √(δ − s²) and √δ, where δ is the squared distance to the nearest point and s the
        spacing: it never claims more room than there is to the nearest measured point.

        Args:
            queries: Shape (m, dim) [m]. A row that is not finite is not valid.

        Raises:
            FieldError: the queries have another shape.
        """
        asked, finite = self._check(queries)
        distance, gradient = np.zeros(len(asked)), np.zeros_like(asked)
        arrays = self.arrays
        run_chunked(lambda a, b: sample_range(arrays, asked, a, b, distance, gradient), len(asked))
        valid = finite & self.domain.contains(asked)
        return FieldSample(np.where(valid, distance, 0.0), gradient * valid[:, None], valid)

    def nearest(self, queries: ArrayLike) -> FloatArray:
        """Exact distance to the nearest fitted point [m], shape (m,); 0 for a row that is not finite."""
        asked, finite = self._check(queries)
        return np.where(finite, find_nearest(self.tree, asked)[0], 0.0)

    def _check(self, queries: ArrayLike) -> tuple[FloatArray, BoolArray]:
        asked = np.array(queries, dtype=np.float64)
        dim = self.points.shape[1]
        if asked.ndim != 2 or asked.shape[1] != dim:
            raise FieldError("field query", f"queries of shape {asked.shape}", f"Pass an array of shape (m, {dim}).")
        finite: BoolArray = np.logical_and.reduce(np.isfinite(asked), axis=1)
        asked[~finite] = 0.0
        return asked, finite

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """All that `from_arrays` needs, as arrays."""
        scalars = np.array([self.length_scale, self.noise_variance, self.spacing])
        return {**self.tree._asdict(), "alpha": self.alpha, "scalars": scalars}

    @classmethod
    def from_arrays(cls, arrays: dict[str, NDArray[Any]], domain: Domain | None = None) -> Gpdf:
        """Restore a field; nothing is fitted."""
        tree = Tree(*(arrays[key] for key in Tree._fields))
        length_scale, noise_variance, spacing = (float(value) for value in arrays["scalars"])
        return cls(tree, arrays["alpha"], length_scale, noise_variance, spacing, domain)


def find_nearest(tree: Tree, queries: FloatArray) -> tuple[FloatArray, IntArray]:
    """Exact nearest point of each query, shape (m, dim): distance [m] and row in `tree.points`, shape (m,)."""
    distance, index = np.zeros(len(queries)), np.zeros(len(queries), np.int64)
    run_chunked(lambda a, b: nearest_range(tree, queries, a, b, distance, index), len(queries))
    return distance, index


def fit_gpdf(
    points: ArrayLike,
    *,
    config: FieldConfig | None = None,
    domain: Domain | None = None,
    spacing: float | None = None,
) -> Gpdf:
    """Fit a field to surface points.

    Args:
        points: Shape (n, 2) or (n, 3), n ≥ 1 [m].
        config: Length scale factor and noise variance.
        domain: Where the field may answer; a box around the data when not given.
        spacing: Distance between points that the field resolves [m]; estimated when not given. Closer points are
            thinned (one real point a cell), which can hide at most √dim × spacing of a surface's relief.

    Raises:
        FieldError: wrong shape, not finite, or no points.
    """
    config = config or FieldConfig()
    data = np.ascontiguousarray(points, dtype=np.float64)
    if data.ndim != 2 or data.shape[1] not in (2, 3):
        raise FieldError("fit", f"points of shape {data.shape}", "Pass an array of shape (n, 2) or (n, 3).")
    if len(data) == 0:
        raise FieldError("fit", "no points", "A field needs at least one point on a surface.")
    if not np.isfinite(data).all():
        raise FieldError("fit", "points that are not finite", "Remove NaN and infinite coordinates.")
    estimated = spacing is None
    spacing = estimate_spacing(data) if spacing is None else float(spacing)
    data = data[thin(data, spacing * (0.5 if estimated else 0.95))]  # a grid of that spacing keeps all its points
    if spacing <= 0.0:
        spacing = 1e-3  # [m] a single place has no spacing; a millimetre is below what any scanner resolves
    tree = build_tree(data)
    length_scale = config.length_scale_factor * spacing
    alpha = _solve(tree.points, length_scale, config.noise_variance)
    return Gpdf(tree, alpha, length_scale, config.noise_variance, spacing, domain)


def _solve(X: FloatArray, length_scale: float, noise_variance: float) -> FloatArray:
    """α = (K + σ² I)⁻¹ 1 with K_ij = exp(−‖x_i − x_j‖² / 2l²), sparse."""
    kdtree = cKDTree(X)
    pairs = kdtree.query_pairs(CUT_RADIUS * length_scale, output_type="ndarray")
    distance2 = ((X[pairs[:, 0]] - X[pairs[:, 1]]) ** 2).sum(axis=1)
    n = len(X)
    upper = csr_matrix((np.exp(-distance2 / (2 * length_scale**2)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    K = upper + upper.T + (1.0 + noise_variance) * identity(n, format="csr")
    alpha, info = cg(K, np.ones(n), rtol=_TOLERANCE, maxiter=20 * int(np.sqrt(n)) + 200)
    if info != 0 or not np.isfinite(alpha).all():
        raise FieldError("fit", f"the solve did not converge ({info})", "Raise fields.noise_variance.")
    return np.asarray(alpha, dtype=np.float64)

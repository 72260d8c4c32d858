"""Other distance fields, each as well as it can be done: what ours is measured against."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from gpdf_service.denoise import denoise, estimate_noise
from gpdf_service.fields import estimate_spacing, fit_gpdf
from gpdf_service.types import FloatArray

Answer = tuple[FloatArray, FloatArray]
"""Distance [m], shape (m,), NaN where the method has no number to give; gradient, shape (m, 3), of any length."""
EXACT = 2_500
"""Points beyond which a dense matrix is not solved here: 50 MB."""
_VOXELS = 30_000_000
"""Cells of the Euclidean distance transform: 0.5 GB."""


class Field(Protocol):
    """What is measured."""

    bytes: float
    """Memory that it keeps for each point."""

    def query(self, queries: FloatArray) -> Answer:
        """Distance and gradient at queries, shape (m, 3)."""


class Ours:
    """The field of this project, with the points cured first."""

    def __init__(self, points: FloatArray) -> None:
        spacing = estimate_spacing(points)
        cured = denoise(points, estimate_noise(points, spacing), spacing)
        kept = ~cured.stray
        self.field = fit_gpdf(cured.points[kept], noise=cured.noise[kept])
        self.bytes = self.field.nbytes / len(self.field.points)
        self.spacing = self.field.spacing

    def query(self, queries: FloatArray) -> Answer:
        """Distance and gradient where they are valid."""
        sample = self.field.query(queries)
        return np.where(sample.valid, sample.distance, np.nan), sample.gradient


class Nearest:
    """SciPy's k-d tree on the points as they are."""

    def __init__(self, points: FloatArray, spacing: float) -> None:
        self.points, self.tree = points, cKDTree(points)
        self.bytes = (points.nbytes + self.tree.indices.nbytes) / len(points)

    def query(self, queries: FloatArray) -> Answer:
        """Distance to the nearest point, and the way from it."""
        distance, nearest = self.tree.query(queries, workers=2)
        return distance, queries - self.points[nearest]


class _Dense:
    """What the exact methods share: a dense kernel matrix over all points."""

    noise_variance = 0.09

    def __init__(self, points: FloatArray, spacing: float) -> None:
        self.points, self.l = points, 1.5 * spacing
        self.bytes = 8.0 * (len(points) + 4)  # a row of the factor, the place and its weight
        self.fit()

    def kernel(self, d: FloatArray) -> FloatArray:
        """Squared exponential."""
        k: FloatArray = np.exp(-(d**2) / (2 * self.l**2))
        return k

    def fall(self, d: FloatArray) -> FloatArray:
        """−(dk/dd) / d, up to a factor: what the points weigh in the gradient."""
        return self.kernel(d)

    def fit(self) -> None:
        """α = (K + σ² I)⁻¹ 1."""
        K = self.kernel(cdist(self.points, self.points))
        self.alpha = np.linalg.solve(K + self.noise_variance * np.eye(len(K)), np.ones(len(K)))

    def occupancy(self, queries: FloatArray) -> FloatArray:
        """The posterior mean."""
        o: FloatArray = self.kernel(cdist(queries, self.points)) @ self.alpha
        return o

    def revert(self, o: FloatArray) -> FloatArray:
        """Distance from an occupancy above 0."""
        distance: FloatArray = np.sqrt(np.maximum(-2 * self.l**2 * np.log(o), 0))
        return distance

    def query(self, queries: FloatArray) -> Answer:
        """Distance and gradient, in parts that fit into memory."""
        parts = np.array_split(queries, max(1, len(queries) // 500))
        o = np.concatenate([self.occupancy(part) for part in parts])
        distance = np.full(len(o), np.nan)  # at and below 0 the logarithm has no number
        distance[o > 0] = self.revert(o[o > 0])
        return distance, np.concatenate([self.gradient(part) for part in parts])

    def gradient(self, queries: FloatArray) -> FloatArray:
        """Against the occupancy's, which is the distance's up to its length."""
        weight = self.fall(cdist(queries, self.points)) * self.alpha
        gradient: FloatArray = weight.sum(axis=1)[:, None] * queries - weight @ self.points
        return gradient


class Plain(_Dense):
    """The paper's formula as printed, dense, no log domain."""


class ScikitLearn(_Dense):
    """The same Gaussian process by scikit-learn."""

    def fit(self) -> None:
        """Fixed kernel: no optimiser."""
        from sklearn.gaussian_process import GaussianProcessRegressor
        from sklearn.gaussian_process.kernels import RBF

        self.model: Any = GaussianProcessRegressor(RBF(self.l), alpha=self.noise_variance, optimizer=None)
        self.model.fit(self.points, np.ones(len(self.points)))
        self.alpha = self.model.alpha_

    def occupancy(self, queries: FloatArray) -> FloatArray:
        """The posterior mean."""
        return np.asarray(self.model.predict(queries))


class LogGpis(_Dense):
    """Log-GPIS: Matérn 3/2 and d = −log(o) / λ with λ = √3 / l; Wu, Lee, Le Gentil and Vidal-Calleja 2021."""

    def kernel(self, d: FloatArray) -> FloatArray:
        """Matérn 3/2."""
        r = np.sqrt(3) * d / self.l
        k: FloatArray = (1 + r) * np.exp(-r)
        return k

    def fall(self, d: FloatArray) -> FloatArray:
        """Of Matérn 3/2."""
        fall: FloatArray = np.exp(-np.sqrt(3) * d / self.l)
        return fall

    def revert(self, o: FloatArray) -> FloatArray:
        """Equation 7 of its paper."""
        distance: FloatArray = np.maximum(-np.log(o) * self.l / np.sqrt(3), 0)
        return distance


class Voxels:
    """Euclidean distance transform at the points' spacing, with trilinear interpolation."""

    def __init__(self, points: FloatArray, spacing: float) -> None:
        low, high = points.min(axis=0) - 5.0, points.max(axis=0) + 5.0
        self.width = max(spacing, float((np.prod(high - low) / _VOXELS) ** (1 / 3)))
        self.low = low
        full = np.ones(np.ceil((high - low) / self.width).astype(int) + 1, dtype=bool)
        full[tuple(np.round((points - low) / self.width).astype(int).T)] = False
        self.grid = ndimage.distance_transform_edt(full).astype(np.float32) * self.width
        self.bytes = self.grid.nbytes / len(points)

    def query(self, queries: FloatArray) -> Answer:
        """Interpolated distance, and its central differences over a cell."""
        half = np.eye(3) * self.width / 2
        return self.at(queries), np.column_stack([self.at(queries + e) - self.at(queries - e) for e in half])

    def at(self, queries: FloatArray) -> FloatArray:
        """The distance between the cells' centres."""
        place = ((queries - self.low) / self.width).T
        distance: FloatArray = ndimage.map_coordinates(self.grid, place, float, order=1, mode="nearest")
        return distance


PEERS: dict[str, Callable[[FloatArray, float], Field]] = {
    "nearest": Nearest,
    "voxels": Voxels,
    "plain": Plain,
    "scikit_learn": ScikitLearn,
    "log_gpis": LogGpis,
}
DENSE = {"plain", "scikit_learn", "log_gpis"}

"""Other distance fields, each as well as it can be done: what ours is measured against."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from gpdf_service.fields import denoise, fit_gpdf
from gpdf_service.types import FloatArray

Answer = tuple[FloatArray, FloatArray | None]
"""Distance [m], shape (m,), and gradient, shape (m, 3)."""
EXACT = 2_500
"""Points beyond which a dense matrix is not solved here: 50 MB."""
_VOXELS = 30_000_000
"""Cells of the Euclidean distance transform: 0.5 GB."""


class Ours:
    """The field of this project, with the points cured first."""

    def __init__(self, points: FloatArray) -> None:
        cured = denoise(points)
        kept = ~cured.stray
        self.field = fit_gpdf(cured.points[kept], noise=cured.noise[kept])
        self.bytes = self.field.nbytes / len(self.field.points)
        self.spacing = self.field.spacing

    def query(self, queries: FloatArray) -> Answer:
        """Distance and gradient, 0 where not valid."""
        sample = self.field.query(queries)
        return sample.distance, sample.gradient


class Nearest:
    """SciPy's k-d tree on the points as they are."""

    def __init__(self, points: FloatArray, spacing: float) -> None:
        self.points, self.tree = points, cKDTree(points)

    def query(self, queries: FloatArray) -> Answer:
        """Distance alone."""
        return self.tree.query(queries, workers=2)[0], None


class _Dense:
    """What the exact methods share: a dense kernel matrix over all points."""

    noise_variance = 0.09

    def __init__(self, points: FloatArray, spacing: float) -> None:
        self.points, self.l = points, 1.5 * spacing
        self.fit()

    def kernel(self, d: FloatArray) -> FloatArray:
        """Squared exponential."""
        k: FloatArray = np.exp(-(d**2) / (2 * self.l**2))
        return k

    def fit(self) -> None:
        """α = (K + σ² I)⁻¹ 1."""
        K = self.kernel(cdist(self.points, self.points))
        self.alpha = np.linalg.solve(K + self.noise_variance * np.eye(len(K)), np.ones(len(K)))

    def occupancy(self, queries: FloatArray) -> FloatArray:
        """The posterior mean."""
        o: FloatArray = self.kernel(cdist(queries, self.points)) @ self.alpha
        return o

    def revert(self, o: FloatArray) -> FloatArray:
        """Distance from occupancy; 0 where it is not in (0, 1]: there is no number to give."""
        return np.where(o > 0, np.sqrt(np.maximum(-2 * self.l**2 * np.log(np.maximum(o, 1e-300)), 0)), 0.0)

    def query(self, queries: FloatArray) -> Answer:
        """Distance, in parts that fit into memory."""
        parts = np.array_split(queries, max(1, len(queries) // 500))
        return self.revert(np.concatenate([self.occupancy(part) for part in parts])), None


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

    def revert(self, o: FloatArray) -> FloatArray:
        """Equation 7 of its paper."""
        return np.where(o > 0, np.maximum(-np.log(np.maximum(o, 1e-300)) * self.l / np.sqrt(3), 0), 0.0)


class Voxels:
    """Euclidean distance transform at the points' spacing, with trilinear interpolation."""

    def __init__(self, points: FloatArray, spacing: float) -> None:
        low, high = points.min(axis=0) - 5.0, points.max(axis=0) + 5.0
        self.width = max(spacing, float((np.prod(high - low) / _VOXELS) ** (1 / 3)))
        self.low = low
        full = np.ones(np.ceil((high - low) / self.width).astype(int) + 1, dtype=bool)
        full[tuple(np.round((points - low) / self.width).astype(int).T)] = False
        self.grid = ndimage.distance_transform_edt(full).astype(np.float32) * self.width

    def query(self, queries: FloatArray) -> Answer:
        """Distance alone."""
        place = ((queries - self.low) / self.width).T
        return ndimage.map_coordinates(self.grid, place, order=1, mode="nearest").astype(np.float64), None


PEERS = {"nearest": Nearest, "voxels": Voxels, "plain": Plain, "scikit_learn": ScikitLearn, "log_gpis": LogGpis}
DENSE = {"plain", "scikit_learn", "log_gpis"}

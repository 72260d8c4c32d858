"""`gpdf bench field`: error and time of a field on closed-form surfaces, beside SciPy's nearest point."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from gpdf_service.bench.report import Row, show
from gpdf_service.fields import fit_gpdf
from gpdf_service.types import FloatArray

BANDS = (0.02, 0.1, 0.5, 2.0, 5.0)
"""[m] Edges of the distance bands."""
Truth = Callable[[FloatArray], FloatArray]


def plane(n: int, rng: np.random.Generator) -> tuple[FloatArray, Truth]:
    """A floor of 10 × 10 m."""
    points = np.column_stack([rng.uniform(-5, 5, (n, 2)), np.zeros(n)])
    return points, lambda q: np.abs(q[:, 2])


def sphere(n: int, rng: np.random.Generator) -> tuple[FloatArray, Truth]:
    """A ball of radius 1 m."""
    points = rng.normal(size=(n, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    return points, lambda q: np.abs(np.linalg.norm(q, axis=1) - 1.0)


def step_edge(n: int, rng: np.random.Generator) -> tuple[FloatArray, Truth]:
    """A floor with a step of 0.35 m along x = 0: both treads and the face."""
    points = np.column_stack([rng.uniform(-5, 5, (n, 2)), np.zeros(n)])
    points[points[:, 0] > 0, 2] = 0.35
    face = np.column_stack([np.zeros(n // 28), rng.uniform(-5, 5, n // 28), rng.uniform(0, 0.35, n // 28)])

    def truth(q: FloatArray) -> FloatArray:
        low = np.hypot(np.maximum(q[:, 0], 0.0), q[:, 2])
        high = np.hypot(np.maximum(-q[:, 0], 0.0), q[:, 2] - 0.35)
        wall = np.hypot(q[:, 0], q[:, 2] - np.clip(q[:, 2], 0.0, 0.35))
        nearest: FloatArray = np.minimum.reduce([low, high, wall])
        return nearest

    return np.concatenate([points, face]), truth


SURFACES = {"plane": plane, "sphere": sphere, "step_edge": step_edge}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    parser.add_argument("--points", type=int, default=20_000, help="points on each surface")
    parser.add_argument("--queries", type=int, default=5_000, help="queries in each distance band")
    parser.add_argument("--noise", type=float, default=0.0, help="standard deviation of each coordinate [m]")
    parser.add_argument("--plot", type=Path, help="draw the errors by distance")
    parser.add_argument("--json", action="store_true", help="print the rows as JSON")


def run(args: argparse.Namespace) -> int:
    """Measure every surface and band."""
    rows: list[Row] = []
    for name, make in SURFACES.items():
        rows += measure(name, make, args.points, args.queries, args.noise)
    show(rows, as_json=args.json)
    if args.plot:
        _plot(rows, args.plot)
    return 0


def measure(
    name: str, make: Callable[[int, np.random.Generator], tuple[FloatArray, Truth]], n: int, m: int, noise: float
) -> list[Row]:
    """Errors of the field and of the nearest point against the truth, by distance band."""
    rng = np.random.default_rng(0)
    points, truth = make(n, rng)
    points = points + rng.normal(size=points.shape) * noise
    began = time.perf_counter()
    field = fit_gpdf(points)
    fit = time.perf_counter() - began
    tree = cKDTree(points)
    rows = []
    for low, high in zip(BANDS[:-1], BANDS[1:], strict=True):  # noqa: RUF007 - the bands
        base = points[rng.integers(len(points), size=20 * m)]
        away = rng.normal(size=base.shape)
        queries = base + away / np.linalg.norm(away, axis=1, keepdims=True) * rng.uniform(low, high, (len(base), 1))
        real = truth(queries)
        inside = (np.abs(queries[:, :2]) < 4.0).all(axis=1) & (real >= low) & (real < high)  # off the sample's rim
        queries, real = queries[inside][:m], real[inside][:m]
        if len(queries) == 0 or not field.domain.contains(queries).any():
            continue
        field.query(queries[:8])
        began = time.perf_counter()
        sample = field.query(queries)
        ours = time.perf_counter() - began
        error = (sample.distance - real)[sample.valid]
        began = time.perf_counter()
        other = tree.query(queries, workers=2)[0] - real
        peer = time.perf_counter() - began
        rows.append(
            {"surface": name, "band_m": f"{low}-{high}", "queries": len(queries), "spacing_m": field.spacing}
            | {"rmse_m": _rms(error), "worst_over_m": float(error.max()), "nearest_rmse_m": _rms(other)}
            | {"us": 1e6 * ours / len(queries), "nearest_us": 1e6 * peer / len(queries), "time_ratio": ours / peer}
            | {"invalid": float(np.mean(~sample.valid)), "fit_s": fit}
        )
    return rows


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _plot(rows: list[Row], path: Path) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 5), layout="constrained")
    axes = figure.subplots()
    labels = [f"{row['surface']} {row['band_m']} m" for row in rows]
    place = np.arange(len(rows))
    axes.bar(place - 0.2, [row["rmse_m"] for row in rows], 0.4, label="GPDF", color="#0072B2")
    axes.bar(place + 0.2, [row["nearest_rmse_m"] for row in rows], 0.4, label="nearest point", color="#E69F00")
    axes.set(ylabel="root mean square error [m]", yscale="log", xticks=place)
    axes.set_xticklabels(labels, rotation=60, ha="right", fontsize=8)
    axes.legend()
    path.parent.mkdir(parents=True, exist_ok=True)
    FigureCanvasAgg(figure).print_png(str(path))  # type: ignore[no-untyped-call]

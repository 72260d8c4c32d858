"""`gpdf bench field`: error, honesty and time of the field on closed-form surfaces, beside its peers."""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from itertools import product
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from gpdf_service.bench.field_peers import DENSE, EXACT, PEERS, Field, Ours
from gpdf_service.bench.report import Row, each, show
from gpdf_service.bench.surfaces import SURFACES, Surface
from gpdf_service.fields import fit_gpdf, thin
from gpdf_service.types import FloatArray

BANDS = (0.02, 0.1, 0.5, 2.0, 5.0)
"""[m] Edges of the distance bands."""
NOISES = (0.0, 0.01, 0.02, 0.05)
"""[m] Standard deviation of each coordinate."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    parser.add_argument("--surface", action="append", choices=sorted(SURFACES), help="all when not given")
    parser.add_argument(
        "--noise", action="append", type=float, help="standard deviation [m]; 0, 1, 2 and 5 cm if not given"
    )
    parser.add_argument("--points", type=int, default=40_000, help="points on each surface")
    parser.add_argument("--queries", type=int, default=2_000, help="queries in each distance band")
    parser.add_argument("--dense", action="store_true", help=f"the exact peers too; at most {EXACT} points then")
    parser.add_argument(
        "--scale", type=int, nargs="*", help="time against the number of points instead: 10000 100000 …"
    )
    parser.add_argument("--plot", type=Path, help="draw the errors by distance")
    parser.add_argument("--json", action="store_true", help="print the rows as JSON")


def run(args: argparse.Namespace) -> int:
    """Measure every surface, noise and band; or the time over the number of points."""
    if args.scale is not None:
        show([measure_time(n) for n in each(args.scale or (10_000, 100_000, 1_000_000), "field")], as_json=args.json)
        return 0
    points = min(args.points, EXACT) if args.dense else args.points
    peers = [name for name in PEERS if args.dense or name not in DENSE]
    rows: list[Row] = []
    cases = list(product(args.surface or SURFACES, args.noise or NOISES))
    for name, noise in each(cases, "field"):
        rows += measure(name, points, args.queries, noise, peers)
    show(rows, as_json=args.json)
    if args.plot:
        _plot(rows, args.plot)
    return 0


def measure(name: str, count: int, queries: int, noise: float, peers: list[str]) -> list[Row]:
    """One surface with one noise: a row for each distance band and method."""
    rng = np.random.default_rng(0)
    surface = SURFACES[name]
    clean = surface.sample(count, rng)
    points = clean + rng.normal(size=clean.shape) * noise
    fit_gpdf(points[:100]).query(points[:100])  # compiled before the clock starts
    began = time.perf_counter()
    ours = Ours(points)
    fields: dict[str, Field] = {"gpdf": ours}
    fit = {"gpdf": time.perf_counter() - began}
    for method in peers:
        began = time.perf_counter()
        fields[method] = PEERS[method](points, ours.spacing)
        fit[method] = time.perf_counter() - began
    rows = []
    for band, asked, real in in_bands(surface, clean, queries, rng):
        true = slope(surface, asked)
        for method, field in fields.items():
            began = time.perf_counter()
            distance, gradient = field.query(asked)
            took = time.perf_counter() - began
            row = {"surface": name, "noise_m": noise, "band_m": band, "method": method, "queries": len(asked)}
            row |= errors(distance - real, angle(gradient, true))
            row |= {"us": 1e6 * took / len(asked), "fit_s": fit[method], "bytes_a_point": field.bytes}
            if field is ours:
                deviation = ours.field.query(asked).deviation
                told = np.isfinite(distance)
                row |= {
                    "spacing_m": ours.spacing,
                    "within_2_sigma": float(np.mean(np.abs(distance - real)[told] <= 2 * deviation[told])),
                }
            rows.append(row)
    return rows


def in_bands(
    surface: Surface, points: FloatArray, count: int, rng: np.random.Generator
) -> Iterator[tuple[str, FloatArray, FloatArray]]:
    """Queries whose true distance lies in each band, away from the sample's rim."""
    low, high = np.asarray(surface.core)
    for near, far in zip(BANDS[:-1], BANDS[1:], strict=True):  # noqa: RUF007 - the bands
        base = points[rng.integers(len(points), size=40 * count)]
        away = rng.normal(size=base.shape)
        away *= rng.uniform(near, far, (len(base), 1)) / np.linalg.norm(away, axis=1, keepdims=True)
        asked = base + away
        asked = asked[np.logical_and.reduce((asked > low) & (asked < high), axis=1)][: 8 * count]
        real = surface.distance(asked)
        inside = np.flatnonzero((real >= near) & (real < far))[:count]
        if len(inside) >= count // 10:
            yield f"{near}-{far}", asked[inside], real[inside]


def errors(error: FloatArray, angles: FloatArray) -> Row:
    """What is said of a method: of its answers' errors [m], NaN where it gave none, and of its gradients' [deg]."""
    told = np.isfinite(error)
    row: Row = {"invalid": float(np.mean(~told))}
    if told.any():
        error = error[told]
        row |= {
            "rmse_m": float(np.sqrt(np.mean(error**2))),
            "bias_m": float(error.mean()),
            "p99_m": float(np.quantile(np.abs(error), 0.99)),
            "worst_over_m": float(error.max()),
            "angle_deg": float(np.median(angles[told])),
        }
    return row


def slope(surface: Surface, asked: FloatArray) -> FloatArray:
    """Gradient of the true distance, shape (m, 3)."""
    h = 1e-5  # [m] central differences of a closed form: errors of 1e-9
    return np.column_stack(
        [(surface.distance(asked + e) - surface.distance(asked - e)) / (2 * h) for e in np.eye(3) * h]
    )


def angle(gradient: FloatArray, true: FloatArray) -> FloatArray:
    """Angle between two gradients, shape (m,) [deg]."""
    cosine = np.einsum("ij,ij->i", gradient, true)
    cosine /= np.maximum(np.linalg.norm(gradient, axis=1) * np.linalg.norm(true, axis=1), np.finfo(float).tiny)
    degrees: FloatArray = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    return degrees


def measure_time(count: int) -> Row:
    """Fit, query and change of a floor with two walls of about `count` points, beside SciPy's nearest point."""
    rng = np.random.default_rng(0)
    side = np.sqrt(count) * 0.02  # [m] at one point every 2 cm
    points = np.column_stack([rng.uniform(0, side, (count, 2)), np.zeros(count)])
    walls = count // 3
    points[:walls, 2] = rng.uniform(0, 2.5, walls)
    points[: walls // 2, 0] = 0.0
    points[walls // 2 : walls, 1] = 0.0
    fit_gpdf(points[:100])
    began = time.perf_counter()
    field = fit_gpdf(points)
    row: Row = {"points": len(field.points), "fit_s": time.perf_counter() - began}
    tree = cKDTree(field.points)
    total = {"gpdf": 0.0, "nearest": 0.0}
    for near, far in zip(BANDS[:-1], BANDS[1:], strict=True):  # noqa: RUF007 - the bands
        away = rng.normal(size=(20_000, 3))
        away *= rng.uniform(near, far, (len(away), 1)) / np.linalg.norm(away, axis=1, keepdims=True)
        asked = points[rng.integers(len(points), size=len(away))] + away
        best = {"gpdf": np.inf, "nearest": np.inf}
        for _ in range(3):
            began = time.perf_counter()
            field.query(asked)
            best["gpdf"] = min(best["gpdf"], time.perf_counter() - began)
            began = time.perf_counter()
            tree.query(asked, workers=2)
            best["nearest"] = min(best["nearest"], time.perf_counter() - began)
        row[f"ratio_{near}-{far}"] = best["gpdf"] / best["nearest"]
        total = {name: total[name] + best[name] for name in total}
    row |= {"us": 1e6 * total["gpdf"] / 80_000, "nearest_us": 1e6 * total["nearest"] / 80_000}
    row["ratio"] = total["gpdf"] / total["nearest"]
    box = rng.uniform(0, 0.5, (500, 3)) + np.array([side / 2, side / 2, field.spacing])
    gone, fresh = np.arange(len(field.points)) < 200, box[thin(box, field.spacing)]
    field.replace(gone, fresh[:10])
    began = time.perf_counter()
    field.replace(gone, fresh)
    row["replace_s"] = time.perf_counter() - began
    return row


def _plot(rows: list[Row], path: Path) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    surfaces = list(dict.fromkeys(row["surface"] for row in rows))
    noises = list(dict.fromkeys(row["noise_m"] for row in rows))
    figure = Figure(figsize=(3.2 * len(noises), 2.2 * len(surfaces)), layout="constrained")
    grid = figure.subplots(len(surfaces), len(noises), squeeze=False, sharex=True)
    colours = {"gpdf": "#0072B2", "nearest": "#E69F00", "voxels": "#009E73"}
    colours |= {"plain": "#CC79A7", "scikit_learn": "#56B4E9", "log_gpis": "#D55E00"}
    for line, surface in zip(grid, surfaces, strict=True):
        for axes, noise in zip(line, noises, strict=True):
            here = [row for row in rows if row["surface"] == surface and row["noise_m"] == noise]
            for method in dict.fromkeys(row["method"] for row in here):
                mine = [row for row in here if row["method"] == method]
                middle = [float(np.mean([float(edge) for edge in row["band_m"].split("-")])) for row in mine]
                axes.plot(
                    middle, [row.get("rmse_m", np.nan) for row in mine], "o-", label=method, color=colours[method], ms=3
                )
            axes.set(xscale="log", yscale="log", title=f"{surface}, noise {100 * noise:g} cm")
            axes.grid(alpha=0.3)
    for axes in grid[-1]:
        axes.set_xlabel("distance [m]")
    for line in grid:
        line[0].set_ylabel("RMSE [m]")
    grid[0][0].legend(fontsize=7)
    path.parent.mkdir(parents=True, exist_ok=True)
    FigureCanvasAgg(figure).print_png(str(path))  # type: ignore[no-untyped-call]

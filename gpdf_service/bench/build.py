"""`gpdf bench build`: time from cloud to scene, beside Open3D's normals of the same cloud in the same run."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np

from gpdf_service.bench.build_changes import measure_changes
from gpdf_service.bench.build_scale import hall_of, measure
from gpdf_service.bench.plotting import add_plot_argument, draw_rows
from gpdf_service.bench.report import Row, Subject, add_scene_arguments, clouds, each, show
from gpdf_service.clouds.formats import import_open3d
from gpdf_service.pipeline import build_scene
from gpdf_service.types import FloatArray

NEIGHBOURS = 20
"""Neighbours for a normal: Open3D's own tutorial takes 20 to 30."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    add_scene_arguments(parser, ["office", "cluttered_office"])
    parser.add_argument("--agent", default="human", help="the body whose free space is built too")
    add_plot_argument(parser)
    parser.add_argument(
        "--scale", type=int, nargs="*", help="time and memory against the number of points instead: N …"
    )
    parser.add_argument(
        "--noise",
        type=float,
        nargs="+",
        help="CPU time in random rooms, or of --changes, with these deviations instead [m]: 0 0.01 …",
    )
    parser.add_argument(
        "--changes", type=int, help="CPU time of so many changes of 1 m² instead, each beside a build from scratch"
    )
    parser.add_argument("--checked", type=int, default=16, help="with --changes: how many are built from scratch")
    parser.add_argument(
        "--wild", type=int, help="so many random places instead, each changed in any way, beside builds from scratch"
    )
    parser.add_argument("--seed", type=int, default=0, help="with --wild: other places")
    parser.add_argument("--hall", type=int, help="with --changes: a hall of so many points in place of scenes")
    parser.add_argument("--rooms", type=int, default=2, help="with --noise: how many, of 0.3 to 0.5 M points")
    parser.add_argument("--tiles", action="store_true", help="with --scale: the points in files, thinned while read")
    parser.add_argument("--repeat", type=int, default=3, help="the median of this many, after one to warm up")


def run(args: argparse.Namespace) -> int:
    """Measure every scene, or every size."""
    rows: list[Row] = []
    if args.scale is not None:
        counts = args.scale or (300_000, 1_000_000, 3_000_000)
        show([measure(count, tiled=args.tiles) for count in each(counts, "build")], as_json=args.json)
        return 0
    if args.wild is not None:
        from gpdf_service.bench.build_wild import CHANGES, wild_rows

        rows = list(each(wild_rows(args.wild, args.changes or CHANGES, args.seed), "places", args.wild))
        show(rows, as_json=args.json)
        return 0
    if args.changes is not None:
        scenes = [Subject("hall", hall_of(args.hall))] if args.hall else clouds(args)
        noisy = [(scene, noise) for scene in scenes for noise in args.noise or (0.0,)]
        show([measure_changes(*scene, args.changes, args.checked) for scene in noisy], as_json=args.json)
        return 0
    if args.noise is not None:
        from gpdf_service.bench.build_noise import measure_noise

        rows = list(each(measure_noise(args.noise, args.rooms), "build", 2 * args.rooms * len(args.noise)))
        show(rows, as_json=args.json)
        return 0
    for name, points, *_ in each(clouds(args), "build"):
        build = _median(lambda points=points: build_scene(points), args.repeat)  # type: ignore[misc]
        scene = build_scene(points)

        def space(scene=scene) -> None:  # type: ignore[no-untyped-def]  # noqa: ANN001
            scene.forget_agents()
            scene.free_space(args.agent)

        free, peer = _median(space, args.repeat), _median(lambda points=points: find_normals(points), args.repeat)  # type: ignore[misc]
        ready = build + free
        rows.append(
            {"scene": name, "points": len(points), "build_s": build, "free_space_s": free, "ready_s": ready}
            | {"open3d_normals_s": peer, "ratio": ready / peer}
        )
    show(rows, as_json=args.json)
    if args.plot:
        panels = {"time [s]": ("build_s", "free_space_s", "ready_s", "open3d_normals_s")}
        draw_rows(args.plot, rows, panels, by=("scene", "points"), title="From cloud to scene, beside Open3D's normals")
    return 0


def _median(work: Callable[[], object], repeat: int) -> float:
    seconds = []
    for _ in range(repeat + 1):
        began = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - began)
    return float(np.median(seconds[1:]))


def find_normals(points: FloatArray) -> None:
    """Open3D's normals of a cloud."""
    open3d = import_open3d()
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    cloud.estimate_normals(open3d.geometry.KDTreeSearchParamKNN(NEIGHBOURS))

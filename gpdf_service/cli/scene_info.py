"""`gpdf scene info FILE`."""

from __future__ import annotations

import argparse
import dataclasses
import json
from pathlib import Path

import numpy as np

from gpdf_service.cli.inputs import add_cloud_arguments, open_scene
from gpdf_service.search import find_reach
from gpdf_service.types import resolve_agent


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    add_cloud_arguments(parser)
    parser.add_argument("--png", type=Path, help="draw the levels: ground, inferred ground, obstacles, quadtree")
    parser.add_argument("--agent", help="how much of it this body reaches, and two places to try; human in the picture")
    parser.add_argument("--json", action="store_true", help="print the facts as JSON")


def run(args: argparse.Namespace) -> int:
    """Print facts about the scene; draw it when asked."""
    scene = open_scene(args)
    if args.png:
        from gpdf_service.viewer.picture import draw_scene

        draw_scene(scene, args.agent or "human", args.png)
    info = scene.info()
    reach = find_reach(scene.free_space(resolve_agent(args.agent))) if args.agent else None
    if reach is not None:
        info["reach"] = {"agent": args.agent, **dataclasses.asdict(reach)}
    if args.json:
        print(json.dumps(info, default=np.ndarray.tolist))
        return 0
    low, high = info["extent"]
    print(f"points   {info['points']} ({info['ground_points']} ground), digest {info['digest']}")
    print(f"ground   confidence {info['ground_confidence']:.2f}, {info['undecided_points']} points undecided")
    print("extent   " + " x ".join(f"{b - a:.1f}" for a, b in zip(low, high, strict=True)) + " m")
    for level in info["levels"]:
        bottom, top = level["height"]
        print(
            f"level {level['level']}  z {bottom:.2f} to {top:.2f} m, {level['known_area']:.1f} m² of ground "
            f"({level['inferred_area']:.1f} m² inferred, {level['undecided_area']:.1f} m² undecided within), "
            f"length scale {level['length_scale']:.3f} m"
        )
    if reach is not None:
        print(
            f"{args.agent:<8} free {reach.free_area:.1f} m² in {reach.pieces} piece(s), "
            f"the largest {reach.largest_area:.1f} m²"
        )
    if reach is not None and reach.start is not None and reach.goal is not None:
        start, goal = (",".join(f"{value:.2f}" for value in place) for place in (reach.start, reach.goal))
        print(f"try      gpdf plan {args.input} --start {start} --goal {goal} --agent {args.agent} --png plan.png")
    return 0

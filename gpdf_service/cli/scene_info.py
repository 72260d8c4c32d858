"""`gpdf scene info FILE`."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from gpdf_service.cli.inputs import add_cloud_arguments, open_scene


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    add_cloud_arguments(parser)
    parser.add_argument("--png", type=Path, help="draw the levels: ground, inferred ground, obstacles, quadtree")
    parser.add_argument("--agent", default="human", help="the body whose free space the picture shows")
    parser.add_argument("--json", action="store_true", help="print the facts as JSON")


def run(args: argparse.Namespace) -> int:
    """Print facts about the scene; draw it when asked."""
    scene = open_scene(args)
    if args.png:
        from gpdf_service.viewer.picture import draw_scene

        draw_scene(scene, args.agent, args.png)
    info = scene.info()
    if args.json:
        print(json.dumps(info))
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
    return 0

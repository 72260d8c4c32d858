"""`gpdf scene info FILE`."""

from __future__ import annotations

import argparse
import dataclasses
import json
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gpdf_service.cli.bodies import FLAGS, add_body_arguments, body_of
from gpdf_service.cli.inputs import BUILDING, add_cloud_arguments, check_in, check_out, open_with_cloud
from gpdf_service.cli.work import Work
from gpdf_service.types import Agent, resolve_agent

if TYPE_CHECKING:
    from gpdf_service.clouds import PointCloud
    from gpdf_service.scene import Scene
    from gpdf_service.search.free_space import Reach


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    add_cloud_arguments(parser)
    parser.add_argument("--png", type=Path, help="draw the levels: ground, inferred ground, obstacles, quadtree")
    add_body_arguments(parser, None)
    parser.add_argument("--json", action="store_true", help="print the facts as JSON")


def run(args: argparse.Namespace) -> int:
    """Print facts about the scene; draw it when asked."""
    agent = body_of(args)
    if args.png:
        check_out(args.png, "--png")
    check_in(args)
    scene, cloud, reach = _look(args, agent)
    info = scene.info()
    if cloud is not None:
        told = ("scale", "up", "dropped", "remarks")
        info["cloud"] = {name: getattr(cloud, name) for name in told}
    if reach is not None:
        info["reach"] = {"agent": agent.name if agent else None, **dataclasses.asdict(reach)}
    if args.json:
        print(json.dumps(info, default=np.ndarray.tolist))
        return 0
    low, high = info["extent"]
    if cloud is not None:
        unit = "metres" if cloud.scale == 1.0 else f"units of {cloud.scale:g} m"
        print("; ".join([f"cloud    taken in {unit}, {cloud.up} up", *cloud.remarks]))
    print(f"points   {info['points']} ({info['ground_points']} ground), digest {info['digest']}")
    print(f"colours  {'as scanned, for pictures' if info['coloured'] else 'none came with the cloud'}")
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
            f"{agent.name if agent else '':<8} free {reach.free_area:.1f} m² in {reach.pieces} piece(s), "
            f"the largest {reach.largest_area:.1f} m²"
        )
    if reach is not None and reach.start is not None and reach.goal is not None:
        start, goal = (",".join(f"{value:.2f}" for value in place) for place in (reach.start, reach.goal))
        print(f"try      gpdf plan {args.input} --start {start} --goal {goal} {_named(args)} --png plan.png")
    return 0


def _look(args: argparse.Namespace, agent: Agent | None) -> tuple[Scene, PointCloud | None, Reach | None]:
    """The scene, its cloud, and where the body can go; it is drawn if that was asked."""
    with Work("read", "build", *["fit"] * bool(agent or args.png), *["draw"] * bool(args.png)) as work:
        scene, cloud = open_with_cloud(args.input, args, work)
        reach = None
        if agent or args.png:
            with work.step("fit"):
                from gpdf_service.search.free_space import find_reach

                space = scene.free_space(agent or "human")
                reach = find_reach(space) if agent else None
        if args.png:
            with work.step("draw"):
                from gpdf_service.viewer.picture import draw_scene

                draw_scene(scene, agent or resolve_agent("human"), args.png)
    return scene, cloud, reach


def _named(args: argparse.Namespace) -> str:
    """The options that name the body, and those that say how the cloud is taken, once more."""
    asked = ("agent_file", "agent", *FLAGS, *BUILDING)
    given = {name: value for name in asked if (value := getattr(args, name)) is not None and value is not False}
    if "agent_file" in given:
        given.pop("agent", None)
    flags = {f"--{name.replace('_', '-')}": value for name, value in given.items()}
    return " ".join(flag if value is True else f"{flag}={shlex.quote(str(value))}" for flag, value in flags.items())

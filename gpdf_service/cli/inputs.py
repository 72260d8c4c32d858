"""What several verbs share: reading a cloud or scene from the command line, agents, progress."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from tqdm import tqdm

from gpdf_service.config import Config
from gpdf_service.perception import read_cloud
from gpdf_service.pipeline import build_scene
from gpdf_service.scene import Scene, load_scene

SCENE_SUFFIX = ".gpdf"


def add_cloud_arguments(parser: argparse.ArgumentParser) -> None:
    """The input: a cloud, or a scene that was built before."""
    parser.add_argument(
        "input", type=Path, help=f"a cloud (.ply .pcd .xyz .npz .las .laz; ROS bags) or a scene ({SCENE_SUFFIX})"
    )
    parser.add_argument("--ground-label", type=int, help="the label that means ground in the file")
    parser.add_argument("--topic", help="of the PointCloud2 in a ROS bag that has several")
    parser.add_argument("--ignore-labels", action="store_true", help="segment the ground even if the file has labels")
    parser.add_argument("--config", type=Path, help="a TOML file with settings")


def read_config(path: Path | None) -> Config:
    """Settings from a TOML file; the defaults without one."""
    import tomllib

    return Config() if path is None else Config.from_mapping(tomllib.loads(path.read_text()))


def open_scene(args: argparse.Namespace) -> Scene:
    """Load a scene file, or read a cloud and build its scene with a progress bar on a terminal."""
    if args.input.suffix == SCENE_SUFFIX:
        return load_scene(args.input)
    with tqdm(total=1.0, desc="read", disable=not sys.stderr.isatty(), bar_format="{desc:22}{bar} {elapsed}") as bar:

        def progress(stage: str, done: float) -> None:
            bar.set_description(stage)
            bar.update(done - bar.n)

        cloud = read_cloud(args.input, ground_label=args.ground_label, topic=args.topic)
        ground = None if args.ignore_labels else cloud.ground
        return build_scene(cloud.points, ground, read_config(args.config), progress=progress)


def place(text: str) -> tuple[float, ...]:
    """Parse `x,y` or `x,y,z`."""
    try:
        parts = tuple(float(part) for part in text.split(","))
    except ValueError:
        parts = ()
    if len(parts) not in (2, 3):
        raise argparse.ArgumentTypeError(f"{text!r} is no place: write x,y or x,y,z in metres")
    return parts

"""What several verbs share: reading a cloud or scene from the command line, agents, progress."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tqdm import tqdm

from gpdf_service.config import SERVICE_TABLE, Config, read_tables
from gpdf_service.errors import ConfigError
from gpdf_service.perception import read_cloud
from gpdf_service.pipeline import build_scene
from gpdf_service.scene import Progress, Scene, load_scene

SCENE_SUFFIX = ".gpdf"
BUILDING = ("ground_label", "topic", "thin", "ignore_labels", "config")
"""Options that say how a cloud is read and built: a scene file knows nothing of them any more."""


def add_cloud_arguments(parser: argparse.ArgumentParser) -> None:
    """The input: a cloud, or a scene that was built before."""
    parser.add_argument(
        "input", type=Path, help=f"a cloud (.ply .pcd .xyz .npz .las .laz; ROS bags) or a scene ({SCENE_SUFFIX})"
    )
    add_build_arguments(parser)


def add_build_arguments(parser: argparse.ArgumentParser) -> None:
    """How a cloud is read and built."""
    parser.add_argument("--ground-label", type=int, help="the label that means ground in the file")
    parser.add_argument("--topic", help="of the PointCloud2 in a ROS bag that has several")
    parser.add_argument(
        "--thin",
        type=float,
        help="keep one point of each voxel of this width [m], read in chunks; for tiles in a folder",
    )
    parser.add_argument("--ignore-labels", action="store_true", help="segment the ground even if the file has labels")
    parser.add_argument("--config", type=Path, help="a TOML file with settings")


def read_config(path: Path | None) -> Config:
    """Settings from a TOML file, the service's own too; the defaults without one."""
    tables = {} if path is None else read_tables(path)
    tables.pop(SERVICE_TABLE, None)
    return Config.from_mapping(tables)


@contextmanager
def progress_bar() -> Iterator[Progress]:
    """A bar on a terminal, moved by what is called with a stage and the share that is done."""
    with tqdm(total=1.0, desc="read", disable=not sys.stderr.isatty(), bar_format="{desc:22}{bar} {elapsed}") as bar:

        def progress(stage: str, done: float) -> None:
            bar.set_description(stage)
            bar.update(done - bar.n)

        yield progress


def open_scene(args: argparse.Namespace) -> Scene:
    """Load the scene file, or read the cloud and build its scene, that the arguments name.

    Raises:
        ConfigError: the input is a scene file, and the arguments say how to build one.
    """
    asked = [name for name in BUILDING if getattr(args, name) is not None and getattr(args, name) is not False]
    if asked and args.input.suffix == SCENE_SUFFIX:
        flag = f"--{asked[0].replace('_', '-')}"
        raise ConfigError(flag, f"the scene {args.input} is built already", "Give its cloud instead.")
    return open_one(args.input, args)


def open_one(path: Path, args: argparse.Namespace) -> Scene:
    """Load a scene file, or read a cloud and build its scene with a progress bar on a terminal."""
    if path.suffix == SCENE_SUFFIX:
        return load_scene(path)
    with progress_bar() as progress:
        cloud = read_cloud(path, ground_label=args.ground_label, topic=args.topic, thin=args.thin)
        ground = None if args.ignore_labels else cloud.ground
        return build_scene(cloud.points, ground, read_config(args.config), progress=progress)


def check_out(path: Path) -> None:
    """Refuse a file that cannot be written before the work on it.

    Raises:
        ConfigError: its folder is not there.
    """
    if not path.absolute().parent.is_dir():
        raise ConfigError(f"--out {path}", "its folder is not there", "Make it, or name another.")


def save_scene(scene: Scene, path: Path, *, as_json: bool) -> int:
    """Save a scene that was made, and say what is in it; returns the exit code."""
    scene.save(path)
    info = scene.info()
    if as_json:
        print(json.dumps({"file": str(path), **info}))
    else:
        print(f"{path}: {info['points']} points ({info['ground_points']} ground), {len(info['levels'])} level(s)")
    return 0

"""What several verbs share: reading a cloud or scene from the command line, agents, progress."""

from __future__ import annotations

import argparse
import json
import math
import os
from pathlib import Path
from typing import TYPE_CHECKING

from gpdf_service.cli.work import Work
from gpdf_service.config import SERVICE_TABLE, Config, read_tables
from gpdf_service.errors import CloudError, ConfigError, SceneFileError

if TYPE_CHECKING:  # what builds and plans takes a second to load: `load`, when there is something to do
    from gpdf_service.clouds import PointCloud
    from gpdf_service.scene import Scene

SCENE_SUFFIX = ".gpdf"
CLOUDS, MESHES = ".ply .pcd .xyz .txt .asc .pts .csv .npy .npz .las .laz .e57", ".obj .stl .off .dae .glb .gltf"
"""Suffixes of the files that `clouds.read` takes."""
UP = ("z", "y", "x", "-z", "-y", "-x")
BUILDING = ("ground_label", "topic", "thin", "scale", "up", "ignore_labels", "config")
"""Options that say how a cloud is read and built: a scene file knows nothing of them any more."""


def add_cloud_arguments(parser: argparse.ArgumentParser) -> None:
    """The input: a cloud, or a scene that was built before."""
    kinds = f"a cloud ({CLOUDS}; ROS bags; folders of tiles with --thin), a mesh ({MESHES})"
    parser.add_argument("input", type=Path, help=f"{kinds} or a scene ({SCENE_SUFFIX})")
    add_build_arguments(parser)


def add_build_arguments(parser: argparse.ArgumentParser) -> None:
    """How a cloud is read and built."""
    parser.add_argument("--ground-label", type=int, help="the label that means ground in the file")
    parser.add_argument("--topic", help="of the PointCloud2 in a ROS bag that has several")
    parser.add_argument(
        "--thin",
        type=positive,
        help="keep one point of each voxel of this width [m], read in chunks; for tiles in a folder",
    )
    parser.add_argument("--scale", type=positive, help="metres of the file's unit: 0.001, 0.01, 0.3048, …")
    parser.add_argument("--up", choices=UP, help="the axis of the file that points up (write --up=-z)")
    parser.add_argument("--ignore-labels", action="store_true", help="segment the ground even if the file has labels")
    parser.add_argument("--config", type=Path, help="a TOML file with settings")


def positive(text: str) -> float:
    """Parse a finite number over 0."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"{text!r} is no number over 0")
    return value


def read_config(path: Path | None) -> Config:
    """Settings from a TOML file, the service's own too; the defaults without one."""
    tables = {} if path is None else read_tables(path)
    tables.pop(SERVICE_TABLE, None)
    return Config.from_mapping(tables)


def open_scene(path: Path, args: argparse.Namespace, work: Work) -> Scene:
    """Load a scene file, or read a cloud and build its scene; say what was odd about it."""
    scene, cloud = open_with_cloud(path, args, work)
    for remark in () if cloud is None else cloud.remarks:
        work.say(f"{path}: {remark}")
    return scene


def open_with_cloud(path: Path, args: argparse.Namespace, work: Work) -> tuple[Scene, PointCloud | None]:
    """The scene, and the cloud that it was built of, if it was: the steps "read" and "build"."""
    from gpdf_service.clouds import read_cloud
    from gpdf_service.pipeline import build_scene
    from gpdf_service.scene import load_scene

    if path.suffix == SCENE_SUFFIX:
        with work.step("read"):
            return load_scene(path), None
    config = read_config(args.config)
    with work.step("read"):
        how = {name: getattr(args, name) for name in ("ground_label", "topic", "thin", "scale", "up")}
        cloud = read_cloud(path, **how)
    ground = None if args.ignore_labels else cloud.ground
    with work.step("build") as progress:
        more = {"origins": cloud.origins, "colours": cloud.colours}
        return build_scene(cloud.points, ground, config, **more, progress=progress), cloud


def check_in(args: argparse.Namespace) -> None:
    """Refuse an input that `open_scene` cannot open before what opens it is loaded, which takes a second.

    Raises:
        CloudError: there is no such cloud.
        ConfigError: the input is a scene file, and the arguments say how to build one.
        SceneFileError: there is no such scene file.
    """
    asked = [name for name in BUILDING if getattr(args, name) is not None and getattr(args, name) is not False]
    if asked and args.input.suffix == SCENE_SUFFIX:
        flag = f"--{asked[0].replace('_', '-')}"
        raise ConfigError(flag, f"the scene {args.input} is built already", "Give its cloud instead.")
    check_there(args.input)


def check_there(path: Path) -> None:
    """Refuse a cloud or a scene file that is not there before the work on it.

    Raises:
        CloudError: there is no such cloud.
        SceneFileError: there is no such scene file.
    """
    if path.exists():
        return
    if path.suffix == SCENE_SUFFIX:
        hint = "Build it first: gpdf scene build CLOUD --out FILE."
        raise SceneFileError(f"scene file {path}", "there is no such file", hint)
    raise CloudError(f"cloud {path}", "there is no such file", "Check the path.")


def is_file_name(text: str) -> bool:
    """Whether this is more likely the name of a file than of a scene of a service."""
    return "/" in text or Path(text).suffix in {SCENE_SUFFIX, *CLOUDS.split(), *MESHES.split()}


def check_out(path: Path, option: str = "--out") -> None:
    """Refuse a file that cannot be written before the work on it.

    Raises:
        ConfigError: its folder is not there, or may not be written into.
    """
    folder = path.absolute().parent
    if not folder.is_dir():
        raise ConfigError(f"{option} {path}", "its folder is not there", "Make it, or name another.")
    if path.is_dir() or not os.access(path if path.exists() else folder, os.W_OK):
        raise ConfigError(f"{option} {path}", "it may not be written", "Name another file, or allow it.")


def save_scene(scene: Scene, path: Path, *, as_json: bool) -> int:
    """Save a scene that was made, and say what is in it; returns the exit code."""
    scene.save(path)
    info = scene.info()
    if as_json:
        print(json.dumps({"file": str(path), **info}))
    else:
        print(f"{path}: {info['points']} points ({info['ground_points']} ground), {len(info['levels'])} level(s)")
    return 0

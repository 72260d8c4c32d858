"""`gpdf scene merge FILE FILE … --out FILE`."""

from __future__ import annotations

import argparse
from pathlib import Path

from gpdf_service.cli.inputs import add_build_arguments, check_out, check_there, open_scene, read_config, save_scene
from gpdf_service.cli.work import Work
from gpdf_service.errors import CloudError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    parser.add_argument("inputs", type=Path, nargs="+", help="clouds or scenes in one frame; two or more")
    add_build_arguments(parser)
    parser.add_argument("--out", type=Path, required=True, help="the scene file to write")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


def run(args: argparse.Namespace) -> int:
    """Put together, build, save, say what is in it."""
    if len(args.inputs) < 2:
        raise CloudError("merge", f"{len(args.inputs)} input", "Name two clouds or scenes, or more.")
    check_out(args.out)
    for path in args.inputs:
        check_there(path)
    config = None if args.config is None else read_config(args.config)
    with Work("read", "build", "again") as work:
        from gpdf_service.combine import merge_scenes

        scenes = [open_scene(path, args, work) for path in args.inputs]
        with work.step("again") as progress:
            made = merge_scenes(scenes, config, progress)
    return save_scene(made, args.out, as_json=args.json)

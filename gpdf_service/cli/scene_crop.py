"""`gpdf scene crop FILE --box … | --polygon … --out FILE`."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from gpdf_service.cli.inputs import add_cloud_arguments, check_in, check_out, open_scene, save_scene
from gpdf_service.cli.work import Work
from gpdf_service.types import FloatArray


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    add_cloud_arguments(parser)
    shape = parser.add_mutually_exclusive_group(required=True)
    shape.add_argument("--box", type=_box, help="x0,y0,x1,y1 or x0,y0,z0,x1,y1,z1 in metres, the least corner first")
    shape.add_argument("--polygon", type=_polygon, help="'x,y x,y x,y …' in metres: the corners, at any height")
    parser.add_argument("--out", type=Path, required=True, help="the scene file to write")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


def run(args: argparse.Namespace) -> int:
    """Cut out, build, save, say what is in it."""
    check_out(args.out)
    check_in(args)
    with Work("read", "build", "again") as work:
        from gpdf_service.combine import crop_scene, within_box, within_polygon

        scene = open_scene(args.input, args, work)
        if args.box:
            half = len(args.box) // 2
            inside = within_box(scene.points, args.box[:half], args.box[half:])
        else:
            inside = within_polygon(scene.points, args.polygon)
        with work.step("again") as progress:
            part = crop_scene(scene, inside, progress)
    return save_scene(part, args.out, as_json=args.json)


def _numbers(text: str) -> list[float]:
    try:
        made = [float(part) for part in text.split(",")]
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text!r}: write numbers in metres with commas between") from error
    if not np.isfinite(made).all():
        raise argparse.ArgumentTypeError(f"{text!r}: the numbers must be finite")
    return made


def _box(text: str) -> list[float]:
    made = _numbers(text)
    if len(made) not in (4, 6):
        raise argparse.ArgumentTypeError(f"{text!r} is no box: write x0,y0,x1,y1 or x0,y0,z0,x1,y1,z1")
    return made


def _polygon(text: str) -> FloatArray:
    corners = [_numbers(part) for part in text.split()]
    if not all(len(corner) == 2 for corner in corners):
        raise argparse.ArgumentTypeError(f"{text!r} is no polygon: write 'x,y x,y x,y …'")
    return np.array(corners)

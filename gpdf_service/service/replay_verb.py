"""`gpdf replay LOG`: ask a running service again, or plan in process, and compare."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from gpdf_client.cli import add_connection

from gpdf_service.service.record import is_log


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    parser.add_argument("log", type=Path, help="a log (.mcap)")
    add_connection(parser)
    parser.add_argument("--scene", action="append", default=[], metavar="NAME=CLOUD", help="plan in process with it")
    parser.add_argument(
        "--scenes-dir", type=Path, help="plan in process with this folder's scenes (.gpdf) of the same hash"
    )
    parser.add_argument(
        "--recorded-speed", action="store_true", help="ask the service as fast as it was asked, no faster"
    )
    parser.add_argument("--request", help="only the request with this id")
    parser.add_argument(
        "--png", type=Path, help="draw the first plan that differs (or the first), was and is; with --scene"
    )
    parser.add_argument("--json", action="store_true", help="print the comparisons as JSON")


def run(args: argparse.Namespace) -> int:
    """Exit code 0 if the log is as it was written, every plan was asked again and every answer is the same."""
    if not args.log.is_file():
        print(f"gpdf: there is no log {args.log}", file=sys.stderr)
        return 1
    if not is_log(args.log):
        print(f"gpdf: {args.log} is no log", file=sys.stderr)
        return 1
    if args.png and not (args.scene or args.scenes_dir):
        print("gpdf: --png draws on a scene: name it with --scene NAME=CLOUD or --scenes-dir", file=sys.stderr)
        return 1
    from gpdf_service.service.replay_again import replay  # a second to load

    return replay(args)

"""`gpdf record check FILE`."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from gpdf_service.service.record import check, repair


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    parser.add_argument("log", type=Path, help="a log (.mcap)")
    parser.add_argument("--repair", action="store_true", help="mend a log that a crash cut short, in its place")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


def run(args: argparse.Namespace) -> int:
    """Exit code 0 if the log is (now) complete."""
    if not args.log.is_file():
        print(f"gpdf: there is no log {args.log}")
        return 1
    found = check(args.log)
    if args.repair and not found.complete:
        found = repair(args.log)
    if args.json:
        print(json.dumps({"log": str(found.path), "messages": found.messages, "complete": found.complete}))
    else:
        state = "complete" if found.complete else "cut short (mend it with --repair)"
        print(f"{found.path}: {found.messages} messages, {state}")
    return 0 if found.complete else 1

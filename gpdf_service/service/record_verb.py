"""`gpdf record check LOG…`: files, or folders of them."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from gpdf_service.service.record import check, is_live, is_log, repair

LOGS = "*.mcap"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    parser.add_argument("logs", type=Path, nargs="+", metavar="log", help="a log (.mcap), or a folder of logs")
    parser.add_argument("--repair", action="store_true", help="mend a log that a crash cut short, in its place")
    parser.add_argument("--json", action="store_true", help="print the results as JSON, one a line")


def run(args: argparse.Namespace) -> int:
    """Exit code 0 if each log is (now) complete and as it was written, or is being written."""
    logs = [log for path in args.logs for log in _logs(path)]
    fine = [_check(log, mend=args.repair, as_json=args.json) for log in logs]
    return 0 if all(fine) else 1


def _logs(path: Path) -> list[Path]:
    """The log, or those of the folder."""
    return (sorted(path.glob(LOGS)) or [path / LOGS]) if path.is_dir() else [path]


def _check(log: Path, *, mend: bool, as_json: bool) -> bool:
    if not log.is_file():
        print(f"gpdf: there is no log {log}", file=sys.stderr)
        return False
    if not is_log(log):  # --repair must not put an empty log in the place of somebody's file
        print(f"gpdf: {log} is no log", file=sys.stderr)
        return False
    live, found = is_live(log), check(log)  # never mended while a service writes it: it would write on beside
    if mend and not live and not found.whole:
        found = repair(log)
    if as_json:
        facts = {"messages": found.messages, "complete": found.complete, "live": live, "damage": found.damage}
        print(json.dumps({"log": str(log), **facts}))
    else:
        cut = "being written by a service" if live else "cut short (mend it with --repair)"
        state = "DAMAGED" if found.damage else "complete" if found.complete else cut
        print("\n  ".join([f"{log}: {found.messages} messages, {state}", *found.damage]))
    return (live or found.complete) and not found.damage

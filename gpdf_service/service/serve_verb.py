"""`gpdf serve NAME=CLOUD …`."""

from __future__ import annotations

import argparse
import logging
import signal
import threading
from pathlib import Path

import zenoh

from gpdf_service.fields.threads import worker_count
from gpdf_service.service.record import repair_folder
from gpdf_service.service.server import DEFAULT_ENDPOINT, Options, Server

log = logging.getLogger("gpdf_service")
WAKE_S = 0.5
"""[s] A signal that the kernel gives to another thread is handled when the main thread wakes; without this, never."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    parser.add_argument("scenes", nargs="*", metavar="NAME=CLOUD", type=_named, help="clouds or scene files to load")
    parser.add_argument("--endpoint", default=DEFAULT_ENDPOINT, help="where to listen")
    parser.add_argument(
        "--scenes-dir", type=Path, default=Path("scenes"), help="folder of the files that clients may load"
    )
    parser.add_argument("--log-dir", type=Path, default=Path("log"), help="folder for the logs")
    parser.add_argument("--workers", type=int, default=worker_count(), help="threads that answer requests")


def run(args: argparse.Namespace) -> int:
    """Serve until SIGINT or SIGTERM; then answer what waits, close the log, end."""
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(name)s: %(message)s")
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    args.log_dir.mkdir(parents=True, exist_ok=True)
    for path in repair_folder(args.log_dir):
        log.warning("the log %s was cut short by a crash; it is readable again", path)
    options = Options(args.endpoint, args.scenes_dir, args.log_dir, max(1, args.workers))
    try:
        with Server(options, args.scenes):
            while not stop.wait(WAKE_S):
                pass
    except zenoh.ZError as error:
        log.error("cannot listen on %s: %s. Is another service running there?", args.endpoint, error)
        return 1
    except ValueError as error:
        log.error("%s", error)
        return 1
    return 0


def _named(text: str) -> tuple[str, Path]:
    name, equals, path = text.partition("=")
    if not (name and equals and path):
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=CLOUD")
    return name, Path(path)

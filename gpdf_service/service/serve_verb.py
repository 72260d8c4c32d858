"""`gpdf serve NAME=CLOUD …`."""

from __future__ import annotations

import argparse
import logging
import os
import re
import signal
import sys
import threading
from pathlib import Path

import zenoh

from gpdf_service import ports
from gpdf_service.errors import ConfigError, GpdfError
from gpdf_service.service.logs import set_up
from gpdf_service.service.options import ENVIRONMENT, Options, descriptions, gather, plain, to_toml

log = logging.getLogger("gpdf_service")
WAKE_S = 1.0
"""[s] A signal that the system gave to one of the other threads is seen when this one wakes."""
BUSY = "cannot listen on %s: %s. Is another service running there?"
ADDRESS = re.compile(r"(?:tcp|tls)/\[?(?P<host>[^\[\]/]+?)\]?:(?P<port>\d+)(?:[?#].*)?")
"""Zenoh's endpoints that are a place for TCP to listen on."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options: one flag for each field of `Options`."""
    parser.add_argument("scenes", nargs="*", metavar="NAME=CLOUD", type=_named, help="clouds or scene files to load")
    parser.add_argument("--config", type=Path, help=f"a TOML file; {ENVIRONMENT}CONFIG names it as well")
    parser.add_argument(
        "--until-eof", action="store_true", help="end also when standard input does: with whoever began the service"
    )
    parser.add_argument("--print-config", action="store_true", help="print the effective configuration and end")
    roles = parser.add_mutually_exclusive_group()
    for role, text in (("map", "run the map service alone"), ("planner", "run a planner service alone")):
        roles.add_argument(f"--{role}", dest="role", action="store_const", const=role, help=text)
    for name, text in descriptions().items():
        if name != "role":
            parser.add_argument(f"--{name.replace('_', '-')}", help=f"{text} ({ENVIRONMENT}{name.upper()})")


def run(args: argparse.Namespace) -> int:
    """Serve until SIGINT or SIGTERM; then answer what waits, close the log, end."""
    named = os.environ.get(f"{ENVIRONMENT}CONFIG")
    file = args.config or (Path(named) if named else None)
    options, config = gather(file, os.environ, {name: getattr(args, name) for name in Options.__struct_fields__})
    if args.print_config:
        print(to_toml(plain(options, config)))
        return 0
    if options.role == "planner" and args.scenes:
        raise ConfigError("scenes", "a planner was given clouds", "It takes its scenes from the map service.")
    set_up(options.log_format)
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    if trouble := trouble_at(options.endpoint):  # before processes begin and scenes are built
        log.error(BUSY, options.endpoint, trouble.rstrip("."))
        return 1
    if gone := [str(file) for _, file in args.scenes if not file.is_file()]:
        log.error("file %r is not there.", gone[0])
        return 1
    from gpdf_service.service.child import NURSERY
    from gpdf_service.service.memory import share_one_arena
    from gpdf_service.service.record import repair_folder  # these take a second to load
    from gpdf_service.service.server import Server

    NURSERY.fork()  # ahead of the first thread
    share_one_arena()
    if args.until_eof:
        threading.Thread(target=_await_eof, args=(stop,), name="gpdf-eof", daemon=True).start()
    options.log_dir.mkdir(parents=True, exist_ok=True)
    for path in repair_folder(options.log_dir):
        log.warning("the log %s was cut short by a crash; it is readable again", path)
    try:
        with Server(options, args.scenes, config):
            while not stop.wait(WAKE_S):
                pass
    except zenoh.ZError as error:
        log.error(BUSY, options.endpoint, error)
        return 1
    except (GpdfError, ValueError) as error:
        log.error("%s", error)
        return 1
    finally:
        NURSERY.end()
    return 0


def trouble_at(endpoint: str) -> str:
    """Why a service cannot listen there, in the system's words; empty if it can, or if only Zenoh can tell."""
    found = ADDRESS.fullmatch(endpoint)
    return "" if found is None else ports.trouble_at(found["host"], int(found["port"]))


def _await_eof(stop: threading.Event) -> None:
    while os.read(sys.stdin.fileno(), 1 << 12):  # not through a buffer, whose lock would be held when Python ends
        pass
    stop.set()


def _named(text: str) -> tuple[str, Path]:
    name, equals, path = text.partition("=")
    if not (name and equals and path):
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=CLOUD")
    return name, Path(path)

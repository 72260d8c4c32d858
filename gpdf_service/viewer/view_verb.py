"""`gpdf view`: the operator's page."""

from __future__ import annotations

import argparse
import contextlib
import io
import logging
import secrets
import signal
import sys
import threading
from pathlib import Path

from gpdf_client import ClientError
from gpdf_client.cli import add_connection, read_credentials

from gpdf_service.ports import trouble_at

DEFAULT_PORT = 8080
WAKE_S = 0.5
"""[s] A signal that the kernel gives to another thread is handled when the main thread wakes; without this, never."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    add_connection(parser)
    parser.add_argument("--host", default="127.0.0.1", help="address to serve the page on; %(default)s if not given")
    parser.add_argument(
        "--name", action="append", default=[], help="a name by which browsers ask for the page, beside its address"
    )
    parser.add_argument(
        "--port", type=int, default=DEFAULT_PORT, help="port to serve the page on; %(default)s if not given"
    )
    parser.add_argument("--log", type=Path, help="a log (.mcap) to open at once")


def run(args: argparse.Namespace) -> int:
    """Serve the page until SIGINT or SIGTERM."""
    if args.log is not None and not args.log.is_file():
        print(f"gpdf: there is no log {args.log}", file=sys.stderr)
        return 1
    from gpdf_service.viewer.front import front_page
    from gpdf_service.viewer.gate import Gate, hidden_address
    from gpdf_service.viewer.page import Pages, Server

    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(name)s: %(message)s")
    logging.getLogger("websockets").setLevel(logging.WARNING)
    try:
        config = read_credentials(args)
    except ClientError as error:
        print(f"gpdf: {error}", file=sys.stderr)
        return 1
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    if trouble := trouble_at(args.host, args.port):
        told = f"gpdf: cannot listen on {args.host}:{args.port}: {trouble}. Is another page running there? Try --port."
        print(told, file=sys.stderr)
        return 1
    hidden = hidden_address()
    with contextlib.redirect_stdout(io.StringIO()):  # viser tells its own address, which the gate hides
        server = Server(hidden, 0, label="gpdf", verbose=False)  # a port of its own choice
    pages = Pages(server, args.endpoint, args.log, config)
    token = secrets.token_urlsafe()
    gate = Gate(args.host, args.port, (hidden, server.get_port()), token, args.name, front_page())
    shown = f"[{args.host}]" if ":" in args.host else args.host
    print(f"open http://{shown}:{args.port}/?token={token}", flush=True)
    while not stop.wait(WAKE_S):
        pass
    pages.close()
    gate.close()
    with contextlib.redirect_stdout(io.StringIO()):  # viser tells that it ended
        server.stop()
    return 0

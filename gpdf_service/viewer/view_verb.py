"""`gpdf view`: the operator's page."""

from __future__ import annotations

import argparse
import ipaddress
import logging
import secrets
import signal
import socket
import sys
import threading
from pathlib import Path

from gpdf_client import ClientError
from gpdf_client.cli import add_connection, read_credentials

DEFAULT_PORT = 8080
WAKE_S = 0.5
"""[s] A signal that the kernel gives to another thread is handled when the main thread wakes; without this, never."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    add_connection(parser)
    parser.add_argument("--host", default="127.0.0.1", help="address to serve the page on; any other needs the link")
    parser.add_argument("--port", type=int, default=DEFAULT_PORT, help="port to serve the page on")
    parser.add_argument("--log", type=Path, help="a log (.mcap) to open at once")


def run(args: argparse.Namespace) -> int:
    """Serve the page until SIGINT or SIGTERM."""
    from gpdf_service.viewer.gate import Gate
    from gpdf_service.viewer.page import Page, Server

    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(name)s: %(message)s")
    logging.getLogger("websockets").setLevel(logging.WARNING)
    if args.log is not None and not args.log.is_file():
        print(f"gpdf: there is no log {args.log}", file=sys.stderr)
        return 1
    try:
        config = read_credentials(args)
    except ClientError as error:
        print(f"gpdf: {error}", file=sys.stderr)
        return 1
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    if not _is_free(args.host, args.port):
        told = f"gpdf: cannot listen on {args.host}:{args.port}. Is another page running there? Try --port."
        print(told, file=sys.stderr)
        return 1
    gated = not _is_loopback(args.host)
    server = Server("127.0.0.1", _free_port() if gated else args.port, label="gpdf", verbose=False)
    page = Page(server, args.endpoint, args.log, config)
    link = f"http://{args.host}:{args.port}/"
    gate = None
    if gated:
        token = secrets.token_urlsafe()
        gate = Gate(args.host, args.port, server.get_port(), token)
        link += f"?token={token}"
    print(f"open {link}", flush=True)
    while not stop.wait(WAKE_S):
        pass
    page.close()
    if gate is not None:
        gate.close()
    server.stop()
    return 0


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _is_free(host: str, port: int) -> bool:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError:
            return False
    return True


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])

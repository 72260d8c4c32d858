"""`gpdf belt PORT`: a naviBelt lets a guided person feel the cues. Runs with the light install and the extra `belt`."""

from __future__ import annotations

import argparse
import signal
import sys
import threading

from gpdf_client import ClientError
from gpdf_client.cli import add_connection
from gpdf_client.cli import connect as connect_service
from gpdf_guidance.belt import Belt, BeltError, connect
from gpdf_guidance.belt import run as feel


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    parser.add_argument("port", help="serial port of the belt, for example /dev/ttyUSB0 or COM3")
    parser.add_argument("--name", default="person", help="of the stream of cues: gpdf/v1/cue/NAME")
    add_connection(parser)


def run(args: argparse.Namespace) -> int:
    """Exit code 1 where there is no belt or no service, or the belt goes."""
    stop, belt = threading.Event(), None
    try:
        belt = connect(args.port)  # nothing vibrates yet: a signal ends it at once, whatever the line waits for
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: stop.set())
        with connect_service(args) as client:
            print(f"The belt at {args.port} feels the cues of {args.name}.", flush=True)
            feel(client.session, args.name, Belt(belt, args.port), stop.is_set)
    except (ClientError, BeltError) as error:
        print(f"gpdf belt: {error}", file=sys.stderr)
        return 1
    finally:
        if belt is not None:
            belt.disconnect_belt()
    return 0

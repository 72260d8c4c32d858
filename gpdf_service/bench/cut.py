"""`gpdf bench cut`: a link that lets nothing through for a while, and how soon a client is answered again after it."""

from __future__ import annotations

import argparse
import contextlib
import socket
import sys
import tempfile
import threading
import time
from pathlib import Path

from gpdf_client import Client
from tqdm import tqdm

from gpdf_service.bench.report import Row, show
from gpdf_service.bench.running import Running, serving

PIECE_BYTES = 65_536
PATIENCE_S = 60.0
"""[s] For a plan after the cut."""


class Cable:
    """Listens, and passes bytes on to a service of this machine while it is whole.

    Args:
        port: Of the service.

    Attributes:
        endpoint: Where it listens.
    """

    def __init__(self, port: int) -> None:
        self._port, self._ends = port, list[socket.socket]()
        self._whole = threading.Event()
        self._whole.set()
        self._socket = socket.create_server(("127.0.0.1", 0))
        self.endpoint = f"tcp/127.0.0.1:{self._socket.getsockname()[1]}"
        threading.Thread(target=self._listen, daemon=True).start()

    def cut(self, *, closes: bool) -> None:
        """From now on nothing passes; the ends see it at once, or hear nothing of it."""
        self._whole.clear()
        if closes:
            for end in self._ends:
                with contextlib.suppress(OSError):
                    end.shutdown(socket.SHUT_RDWR)

    def mend(self) -> None:
        """What waited passes, and what comes."""
        self._whole.set()

    def close(self) -> None:
        """Listen no more."""
        self.mend()
        self._socket.close()

    def _listen(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                near, _ = self._socket.accept()
                if not self._whole.is_set():
                    near.close()
                    continue
                far = socket.create_connection(("127.0.0.1", self._port))
                self._ends += [near, far]
                for ends in ((near, far), (far, near)):
                    threading.Thread(target=self._pass, args=ends, daemon=True).start()

    def _pass(self, one: socket.socket, other: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while data := one.recv(PIECE_BYTES):
                self._whole.wait()
                other.sendall(data)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    parser.add_argument("--seconds", type=float, nargs="+", default=[1.5, 4.0, 10.0], help="how long the cuts last")
    parser.add_argument("--json", action="store_true", help="print the rows as JSON")


def run(args: argparse.Namespace) -> int:
    """Measure and print; fails if a client is not answered again."""
    with tempfile.TemporaryDirectory() as folder, serving(Path(folder), "--workers", "1") as service:
        cuts = [(closes, seconds) for closes in (True, False) for seconds in args.seconds]
        rows = [
            _after(service, seconds, closes=closes)
            for closes, seconds in tqdm(cuts, desc="cut", disable=not sys.stderr.isatty())
        ]
    show(rows, as_json=args.json)
    return 0 if all(row["status"] == "OK" for row in rows) else 1


def _after(service: Running, seconds: float, *, closes: bool) -> Row:
    cable = Cable(int(service.endpoint.rpartition(":")[2]))
    with contextlib.closing(cable), Client.connect(cable.endpoint) as client:
        client.plan("office", service.start, service.goal)
        cable.cut(closes=closes)
        time.sleep(seconds)
        cable.mend()
        began = time.perf_counter()
        result = client.plan("office", service.start, service.goal, deadline_s=PATIENCE_S)
        back = time.perf_counter() - began
    return {"link": "closed" if closes else "silent", "cut_s": seconds, "status": str(result.status), "back_s": back}

"""The real service as its own process, for benches that must not share one with it."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import psutil
from gpdf_client import Client

from gpdf_service.synthetic import SCENES

EPHEMERAL = Path("/proc/sys/net/ipv4/ip_local_port_range")
FIRST_PORT, LAST_PORT = 10_000, 65_535
"""Ports that no system service has of old."""
_claims: list[socket.socket] = []
"""Ports that were given out."""
ENDS_S = 30.0
"""[s] A service that drains and closes its log needs less."""


@dataclass(frozen=True)
class Running:
    """A service under test: its endpoint, its process, and a place to start from and to go to in its office."""

    endpoint: str
    process: subprocess.Popen[bytes]
    start: tuple[float, ...]
    goal: tuple[float, ...]

    def usage(self) -> dict[str, float]:
        """Memory [MB], threads, open files and CPU time [s] of the process and of those that plan for it, now."""
        main = psutil.Process(self.process.pid)
        return dict(sum((Counter(_usage(seen)) for seen in (main, *main.children())), Counter()))


def _usage(seen: psutil.Process) -> dict[str, float]:
    with seen.oneshot():
        cpu = seen.cpu_times()
        return {
            "rss_mb": seen.memory_info().rss / 1e6,
            "threads": seen.num_threads(),
            "files": seen.num_fds(),
            "cpu_s": cpu.user + cpu.system,
        }


def free_port() -> int:
    """A port on this machine that nobody listens on, and that nobody else who asks here is given while we live.

    None of those that the system gives to connections: one of them could take it before anybody listens there.
    """
    low, high = map(int, EPHEMERAL.read_text().split())
    ports = [port for port in range(FIRST_PORT, LAST_PORT + 1) if not low <= port <= high]
    begin = os.getpid() % len(ports)
    for port in ports[begin:] + ports[:begin]:
        claim = socket.socket(socket.AF_UNIX)
        with contextlib.suppress(OSError), socket.socket() as probe:
            claim.bind(f"\0gpdf port {port}")  # Linux's abstract names end with their process
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(("127.0.0.1", port))
            _claims.append(claim)
            return port
        claim.close()
    raise OSError("every port of this machine is taken")


def free_endpoint() -> str:
    """Where a service can listen: `free_port`."""
    return f"tcp/127.0.0.1:{free_port()}"


@contextmanager
def serving(folder: Path, *flags: str) -> Iterator[Running]:
    """`gpdf serve` with a synthetic office, its files in `folder`, ended by SIGTERM."""
    office = SCENES["office"](np.random.default_rng(0))
    label = office.ground.astype(np.int32)
    np.savez(folder / "office.npz", xyz=office.points, label=label, classes=np.array(["other", "ground"]))
    endpoint = free_endpoint()
    words = [sys.executable, "-m", "gpdf_service.cli", "serve", f"office={folder / 'office.npz'}"]
    words += ["--endpoint", endpoint, "--scenes-dir", str(folder), "--log-dir", str(folder / "log"), *flags]
    with (folder / "serve.log").open("wb") as log, subprocess.Popen(words, stderr=log) as process:
        try:
            with Client.connect(endpoint, timeout_s=60) as client:
                client.wait_for_scene("office")
                while not all(service.ready for service in client.status()):  # its processes are there, too
                    time.sleep(0.05)
            yield Running(endpoint, process, tuple(office.start), tuple(office.goal))
        finally:
            process.send_signal(signal.SIGTERM)
            try:
                process.wait(ENDS_S)
            except subprocess.TimeoutExpired:
                process.kill()
                raise

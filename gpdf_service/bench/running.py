"""A service with an office, for benches that must not share a process with it."""

from __future__ import annotations

import subprocess
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import psutil
from gpdf_client import Client

from gpdf_service.ports import free_endpoint
from gpdf_service.service.begun import begun
from gpdf_service.synthetic import SCENES


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
        return dict(sum((Counter(_usage(seen)) for seen in (main, *main.children(recursive=True))), Counter()))


def _usage(seen: psutil.Process) -> dict[str, float]:
    with seen.oneshot():
        cpu = seen.cpu_times()
        return {
            "rss_mb": seen.memory_info().rss / 1e6,
            "threads": seen.num_threads(),
            "files": seen.num_fds(),
            "cpu_s": cpu.user + cpu.system,
        }


@contextmanager
def serving(folder: Path, *flags: str) -> Iterator[Running]:
    """`gpdf serve` with a synthetic office, its files in `folder`."""
    office = SCENES["office"](np.random.default_rng(0))
    label = office.ground.astype(np.int32)
    np.savez(folder / "office.npz", xyz=office.points, label=label, classes=np.array(["other", "ground"]))
    endpoint = free_endpoint()
    words = [f"office={folder / 'office.npz'}", "--endpoint", endpoint]
    words += ["--scenes-dir", str(folder), "--log-dir", str(folder / "log"), *flags]
    with begun(folder / "serve.log", *words) as process:
        with Client.connect(endpoint, timeout_s=60) as client:
            client.wait_for_scene("office")
            while not all(service.ready for service in client.status()):  # its processes are there, too
                time.sleep(0.05)
        yield Running(endpoint, process, tuple(office.start), tuple(office.goal))
